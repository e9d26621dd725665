"""What the commands that make and remove cubes do: their replies, and their effects as other commands see them."""

from __future__ import annotations

import math
from typing import Any

from nmes.conformance.case import Category, Row
from nmes.conformance.rotation import euler, same_turn
from nmes.conformance.trial import Trial
from nmes.protocol import COMMANDS

CUBE_COMMANDS = Category(5, "commands")
case, table = CUBE_COMMANDS.case, CUBE_COMMANDS.table


@case(1, "4.ping")
def ping(t: Trial) -> None:
    """The command ping is answered by pong, and nothing else comes."""
    wire = t.join()
    for id in range(5):
        t.equal(wire.ask({"type": "ping", "id": id}), {"type": "pong", "id": id}, "the reply")
    t.fence(wire)


@case(2, "4.spawn_cube")
def spawning(t: Trial) -> None:
    """A spawn is answered by a list of all cubes, the new one last, and `spawned` tells its name."""
    wire = t.join()
    one, two = t.name(), t.name()
    for name in (one, two):
        reply = t.ask(wire, {"type": "spawn_cube", "cube_name": name, "position": t.at()}, "cube_list")
        t.equal(reply["spawned"], name, "spawned")
        t.true(name in reply["cubes"], f"{name} in the list", reply)
    cubes = [name for name in reply["cubes"] if name in (one, two)]
    t.equal(cubes, [one, two], "the case's cubes in the list")


@case(3, "4.spawn_cube")
def spawning_without_the_list(t: Trial) -> None:
    """With list false, the reply to a spawn has no list; with true it has one."""
    wire = t.join()
    command = {"type": "spawn_cube", "position": t.at()}
    reply = t.ask(wire, {**command, "cube_name": t.name(), "list": False}, "cube_list")
    t.true("cubes" not in reply, "no list", reply)
    reply = t.ask(wire, {**command, "cube_name": t.name(), "list": True}, "cube_list")
    t.true(reply["spawned"] in reply["cubes"], "a list with the cube", reply)


@table(
    4,
    "4.spawn_cube",
    [
        Row("edge", {"size": 0.5}),
        Row("edges", {"size": [0.5, 1, 2]}),
        Row("mass", {"mass": 2.5}),
        Row("friction", {"friction": 0.25}),
        Row("restitution", {"restitution": 0.75}),
        Row("color", {"color": [0.25, 0.5, 0.75]}),
        Row("color-with-opacity", {"color": [0.25, 0.5, 0.75, 0.5]}),
    ],
)
def what_is_spawned_is_seen(t: Trial, fields: dict[str, Any]) -> None:
    """What a cube is spawned with, get_cube_info tells."""
    wire = t.join()
    info = t.info(wire, t.base(wire, **fields))
    ((name, value),) = fields.items()
    if name == "size" and not isinstance(value, list):
        value = [value] * 3
    if name == "color" and len(value) == 3:
        value = [*value, 1.0]
    t.close(info[name], value, 1e-6, name)


@case(5, "4.spawn_cube")
def defaults(t: Trial) -> None:
    """What is not said has its default: at (0, 1, 0), 1 m, 1 kg, unturned, at rest, not frozen."""
    wire = t.join()
    reply = t.ask(wire, {"type": "spawn_cube", "cube_name": t.name(), "is_base": True, "list": False}, "cube_list")
    t.adopt(reply["spawned"])
    info = t.info(wire, reply["spawned"])
    default = COMMANDS["spawn_cube"].defaults
    t.close(info["position"], default["position"], 1e-6, "position")
    t.close(info["size"], [default["size"]] * 3, 1e-6, "size")
    t.close(info["mass"], default["mass"], 1e-6, "mass")
    t.close(info["color"], default["color"], 1e-6, "color")
    t.close(info["rotation"], [0.0] * 3, 1e-6, "rotation")
    t.close(info["linear_velocity"], [0.0] * 3, 1e-6, "linear_velocity")


@case(6, "4.get_cube_info")
def a_cube_that_stands_alone(t: Trial) -> None:
    """A new frozen cube in the air has no joints, no velocity, and is where it was put."""
    wire = t.join()
    info = t.info(wire, t.base(wire, position=t.at(1, 4)))
    t.close(info["position"], t.at(1, 4), 1e-6, "position")
    t.close(info["linear_velocity"], [0.0] * 3, 1e-9, "linear_velocity")
    t.close(info["angular_velocity"], [0.0] * 3, 1e-9, "angular_velocity")
    t.equal([info["joints"], info["frozen"]], [[], True], "joints and frozen")


ANGLES = {"z": (0.0, 0.0, 0.5), "minus-z": (0.0, 0.0, -1.2)}
ANGLES_3D = {"x": (0.7, 0.0, 0.0), "y": (0.0, 1.1, 0.0), "all": (0.4, -0.8, 1.3), "large": (1.2, 2.5, -2.0)}


@table(
    7,
    "3.1.4",
    [Row(name, angles) for name, angles in ANGLES.items()]
    + [Row(name, angles, ("3d",)) for name, angles in ANGLES_3D.items()],
)
def three_angles(t: Trial, angles: tuple[float, float, float]) -> None:
    """Three numbers are Euler angles applied in the order Y, X, Z; the answer tells the same turn both ways."""
    wire = t.join()
    info = t.info(wire, t.base(wire, rotation=list(angles)))
    same_turn(t, info["quaternion"], euler(*angles))
    same_turn(t, euler(*info["rotation"]), euler(*angles))


@table(
    8,
    "3.1.4",
    [Row(name, (angles, 1.0)) for name, angles in ANGLES.items()]
    + [Row(name, (angles, 1.0), ("3d",)) for name, angles in ANGLES_3D.items()]
    + [Row("long", (ANGLES["z"], 700.0)), Row("short", (ANGLES["z"], 0.001)), Row("opposite", (ANGLES["z"], -1.0))],
)
def four_numbers(t: Trial, turn: tuple[tuple[float, float, float], float]) -> None:
    """Four numbers are a quaternion x, y, z, w of any length."""
    angles, length = turn
    wire = t.join()
    quaternion = euler(*angles)
    info = t.info(wire, t.base(wire, rotation=[length * value for value in quaternion]))
    same_turn(t, info["quaternion"], quaternion)
    t.close(math.hypot(*info["quaternion"]), 1.0, 1e-6, "length of the quaternion")


@case(9, "3.1.4")
def a_quaternion_that_is_zero(t: Trial) -> None:
    """A quaternion of zeros is no rotation: invalid."""
    wire = t.join()
    t.refused(wire, {"type": "spawn_cube", "rotation": [0, 0, 0, 0]}, "invalid", "rotation")


@case(10, "4.despawn_cube")
def despawning(t: Trial) -> None:
    """A despawned cube is gone from the list, and the reply names it."""
    wire, other = t.join(), t.join()
    name = t.spawn(wire)
    reply = t.ask(other, {"type": "despawn_cube", "cube_name": name}, "cube_despawned")
    t.equal([reply["cube_name"], reply["joints"]], [name, []], "cube_name and joints")
    t.true(name not in t.cubes(wire), f"no {name} in the list", name)


@case(11, "4.despawn_cube", needs=("joint.fixed",))
def despawning_a_joined_cube(t: Trial) -> None:
    """With a cube go its joints, which the reply names, and the other cube has them no more."""
    wire = t.join()
    cubes = [t.base(wire, position=t.at(n * 1.5)) for n in range(3)]
    joints = [t.join_cubes(wire, cubes[1], cubes[0]), t.join_cubes(wire, cubes[1], cubes[2])]
    reply = t.ask(wire, {"type": "despawn_cube", "cube_name": cubes[1]}, "cube_despawned")
    t.equal(sorted(reply["joints"]), sorted(joints), "joints")
    for cube in (cubes[0], cubes[2]):
        t.equal(t.info(wire, cube)["joints"], [], f"joints of {cube}")
    command = {"type": "set_joint_param", "joint_name": joints[0], "param_name": "damping", "value": 1}
    t.refused(wire, command, "joint_not_found", "joint_name")


@table(
    52, "4.set_color", [Row("opaque", [0.25, 0.5, 0.75]), Row("with-opacity", [1, 0, 0.5, 0.25])], needs=("set_color",)
)
def painting(t: Trial, color: list[float]) -> None:
    """A cube has the colour that set_color gives it, opaque where no opacity is given, and the reply tells it."""
    wire, other = t.join(), t.join()
    name = t.base(wire, color=[0, 0, 0, 0.5])
    reply = t.ask(other, {"type": "set_color", "cube_name": name, "color": color}, "color_set")
    expected = [*color, 1.0][:4]
    t.equal(reply["cube_name"], name, "cube_name")
    t.close(reply["color"], expected, 1e-6, "color of the reply")
    t.close(t.info(wire, name)["color"], expected, 1e-6, "color")
