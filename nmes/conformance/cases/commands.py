"""What each command does: its reply, and its effect as other commands see it."""

from __future__ import annotations

import itertools
import math
from typing import Any

from nmes.conformance.case import Category, Level, Row
from nmes.conformance.trial import Trial
from nmes.protocol import COMMANDS

CONTRACTS = Category(5, "commands")
case, table = CONTRACTS.case, CONTRACTS.table

MOVING = ("position", "rotation", "quaternion", "linear_velocity", "angular_velocity")


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
def what_is_spawned_is_seen(t: Trial, given: dict[str, Any]) -> None:
    """What a cube is spawned with, get_cube_info tells."""
    wire = t.join()
    info = t.info(wire, t.base(wire, **given))
    ((name, value),) = given.items()
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


def euler(x: float, y: float, z: float) -> list[float]:
    """Returns the quaternion of Euler angles applied in the order Y, X, Z, as intrinsic turns."""

    def times(a: list[float], b: list[float]) -> list[float]:
        ax, ay, az, aw = a
        bx, by, bz, bw = b
        return [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ]

    about_x = [math.sin(x / 2), 0.0, 0.0, math.cos(x / 2)]
    about_y = [0.0, math.sin(y / 2), 0.0, math.cos(y / 2)]
    about_z = [0.0, 0.0, math.sin(z / 2), math.cos(z / 2)]
    return times(times(about_y, about_x), about_z)


def same_turn(t: Trial, got: list[float], wanted: list[float]) -> None:
    """Makes sure that two quaternions mean the same rotation."""
    sign = 1.0 if sum(a * b for a, b in zip(got, wanted, strict=True)) >= 0 else -1.0
    t.close(got, [sign * value for value in wanted], 1e-5, "quaternion")


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
    12,
    "4.create_joint",
    [
        Row(kind, kind, (f"joint.{'slide' if kind == 'slider' else kind}",))
        for kind in ("fixed", "hinge", "slide", "slider", "pin", "conetwist")
    ],
)
def joining(t: Trial, kind: str) -> None:
    """A joint is made, and both its cubes tell its name."""
    wire = t.join()
    one, two, other = (t.base(wire, position=t.at(x)) for x in (0, 1.5, 3))
    joint = t.join_cubes(wire, one, two, kind)
    for cube, joints in ((one, [joint]), (two, [joint]), (other, [])):
        t.equal(t.info(wire, cube)["joints"], joints, f"joints of {cube}")


@table(
    13,
    "4.get_joint_info",
    [
        Row(kind, kind, (f"joint.{'slide' if kind == 'slider' else kind}",))
        for kind in ("fixed", "hinge", "slide", "slider", "pin", "conetwist")
    ],
    needs=("get_joint_info",),
)
def joint_info(t: Trial, kind: str) -> None:
    """A new joint tells its cubes in their order, its type, its anchor halfway, and position 0."""
    wire = t.join()
    one, two = t.base(wire, position=t.at(0, 3)), t.base(wire, position=t.at(2, 4))
    joint = t.join_cubes(wire, one, two, kind)
    info = t.ask(wire, {"type": "get_joint_info", "joint_name": joint}, "joint_info")
    t.equal([info["joint_name"], info["cube1"], info["cube2"]], [joint, one, two], "joint_name, cube1, cube2")
    t.equal(info["joint_type"], "slide" if kind == "slider" else kind, "joint_type")
    t.close(info["anchor"], t.at(1, 3.5), 0.01, "anchor")
    t.close([info["position"], info["velocity"]], [0.0, 0.0], 0.01, "position and velocity")
    if kind in ("hinge", "slide", "slider"):
        wanted = [0.0, 0.0, 1.0] if kind == "hinge" else [1.0, 0.0, 0.0]
        t.close(info["axis"], wanted, 1e-4, "axis")


@case(14, "4.create_joint", needs=("joint.hinge", "get_joint_info"))
def an_anchor_that_is_given(t: Trial) -> None:
    """A joint has the anchor that it is given."""
    wire = t.join()
    one, two = t.base(wire, position=t.at(0)), t.base(wire, position=t.at(2))
    joint = t.join_cubes(wire, one, two, "hinge", position=t.at(0.5, 3.5))
    info = t.ask(wire, {"type": "get_joint_info", "joint_name": joint}, "joint_info")
    t.close(info["anchor"], t.at(0.5, 3.5), 0.01, "anchor")


@table(
    15,
    "4.create_joint",
    [
        Row("hinge-x", ("hinge", [2, 0, 0]), ("3d", "joint.hinge")),
        Row("hinge-y", ("hinge", [0, 0.5, 0]), ("3d", "joint.hinge")),
        Row("hinge-minus-z", ("hinge", [0, 0, -3]), ("joint.hinge",)),
        Row("slide-y", ("slide", [0, 7, 0]), ("joint.slide",)),
        Row("slide-oblique", ("slide", [1, 1, 0]), ("joint.slide",)),
        Row("slide-z", ("slide", [0, 0, 1]), ("3d", "joint.slide")),
    ],
    needs=("get_joint_info",),
)
def an_axis_that_is_given(t: Trial, row: tuple[str, list[float]]) -> None:
    """A joint has the axis that it is given, of unit length."""
    kind, axis = row
    wire = t.join()
    one, two = t.base(wire, position=t.at(0)), t.base(wire, position=t.at(2))
    joint = t.join_cubes(wire, one, two, kind, axis=axis)
    info = t.ask(wire, {"type": "get_joint_info", "joint_name": joint}, "joint_info")
    length = math.hypot(*axis)
    t.close(info["axis"], [value / length for value in axis], 1e-4, "axis")


@case(16, "4.get_joint_list", needs=("joint.fixed", "get_joint_list"))
def joint_list(t: Trial) -> None:
    """The list of joints has each with type and cubes, in order of creation, and only while it is there."""
    wire = t.join()
    cubes = [t.base(wire, position=t.at(n - 2)) for n in range(4)]
    joints = [t.join_cubes(wire, one, two) for one, two in itertools.pairwise(cubes)]
    listed = t.ask(wire, {"type": "get_joint_list"}, "joint_list")["joints"]
    mine = [joint for joint in listed if joint["joint_name"] in joints]
    wanted = [
        {"joint_name": joint, "joint_type": "fixed", "cube1": one, "cube2": two}
        for joint, one, two in zip(joints, cubes, cubes[1:], strict=False)
    ]
    said = [{name: joint[name] for name in wanted[0]} for joint in mine]
    t.equal(said, wanted, "the case's joints in the list")
    t.ask(wire, {"type": "despawn_cube", "cube_name": cubes[1]}, "cube_despawned")
    listed = t.ask(wire, {"type": "get_joint_list"}, "joint_list")["joints"]
    left = [joint["joint_name"] for joint in listed if joint["joint_name"] in joints]
    t.equal(left, joints[2:], "what is left of them")


@case(17, "4.remove_joint", needs=("joint.fixed", "remove_joint"))
def removing_a_joint(t: Trial) -> None:
    """A removed joint is gone from both cubes, which stay."""
    wire = t.join()
    one, two = t.base(wire), t.base(wire, position=t.at(1.5))
    joint = t.join_cubes(wire, one, two)
    reply = t.ask(wire, {"type": "remove_joint", "joint_name": joint}, "joint_removed")
    t.equal(reply["joint_name"], joint, "joint_name")
    for cube in (one, two):
        t.equal(t.info(wire, cube)["joints"], [], f"joints of {cube}")


PARAMETERS: dict[str, tuple[str, Any]] = {
    "motor_target_velocity": ("motor", 2.5),
    "motor_max_force": ("motor", 40.0),
    "motor_enabled": ("motor", True),
    "target_position": ("servo", 0.5),
    "stiffness": ("spring", 30.0),
    "damping": ("spring", 2.0),
    "limit_lower": ("limits", -1.0),
    "limit_upper": ("limits", 1.0),
    "limit_enabled": ("limits", True),
    "motor_max_impulse": ("motor", 0.5),
}


@table(
    18,
    "4.set_joint_param",
    [Row(name, name, (need,)) for name, (need, _) in PARAMETERS.items()],
    needs=("joint.hinge",),
)
def setting_a_parameter(t: Trial, name: str) -> None:
    """The reply to set_joint_param repeats joint, parameter and value, and get_joint_info tells it."""
    wire = t.join()
    joint = t.join_cubes(wire, t.base(wire), t.base(wire, position=t.at(1.5)), "hinge")
    value = PARAMETERS[name][1]
    command = {"type": "set_joint_param", "joint_name": joint, "param_name": name, "value": value}
    reply = t.ask(wire, command, "joint_param_set")
    t.equal([reply["joint_name"], reply["param_name"], reply["value"]], [joint, name, value], "the reply")
    if t.probe.claims("get_joint_info"):
        params = t.ask(wire, {"type": "get_joint_info", "joint_name": joint}, "joint_info")["params"]
        t.true(name in params, f"{name} among the parameters", params)
        t.equal(params[name], value, name)


@case(19, "4.set_joint_param", needs=("joint.hinge", "motor", "get_joint_info"))
def a_target_enables_the_motor(t: Trial) -> None:
    """Setting motor_target_velocity enables the motor, when joining too."""
    wire = t.join()
    one, two, three = (t.base(wire, position=t.at(x)) for x in (0, 1.5, 3))
    plain = t.join_cubes(wire, one, two, "hinge")
    driven = t.join_cubes(wire, two, three, "hinge", motor_target_velocity=1.0)

    def enabled(joint: str) -> Any:
        return t.ask(wire, {"type": "get_joint_info", "joint_name": joint}, "joint_info")["params"]["motor_enabled"]

    t.equal([enabled(plain), enabled(driven)], [False, True], "motor_enabled")
    command = {"type": "set_joint_param", "joint_name": plain, "param_name": "motor_target_velocity", "value": 1}
    t.ask(wire, command, "joint_param_set")
    t.equal(enabled(plain), True, "motor_enabled afterwards")


@table(
    20,
    "4.apply_physics",
    [
        Row(name, fields)
        for name, fields in {
            "nothing": {},
            "force": {"force": [1, 2, 3]},
            "torque": {"torque": [0, 0, 1]},
            "impulse": {"impulse": [0.1, 0, 0]},
            "angular_impulse": {"angular_impulse": [0, 0, 0.1]},
            "all": {"force": [1, 0, 0], "torque": [0, 0, 1], "impulse": [0, 0.1, 0], "angular_impulse": [0, 0, 0.1]},
            "at": {"force": [0, 1, 0], "at": [0, 1, 0]},
        }.items()
    ],
)
def applying(t: Trial, fields: dict[str, Any]) -> None:
    """The reply to apply_physics names the cube, whatever of force, torque and impulses is given."""
    wire = t.join()
    name = t.base(wire)
    reply = t.ask(wire, {"type": "apply_physics", "cube_name": name, **fields}, "physics_applied")
    t.equal(reply["cube_name"], name, "cube_name")
    t.close(t.info(wire, name)["position"], t.at(), 1e-6, "position of the frozen cube")


@case(21, "4.apply_force", needs=("apply_force",))
def applying_a_force(t: Trial) -> None:
    """The reply to apply_force is that to apply_physics."""
    wire = t.join()
    name = t.base(wire)
    reply = t.ask(wire, {"type": "apply_force", "cube_name": name, "force": [1, 0, 0]}, "physics_applied")
    t.equal(reply["cube_name"], name, "cube_name")
    t.equal(t.ask(wire, {"type": "apply_force", "force": [1, 0, 0]}, "physics_applied")["cube_name"], name, "the owned")


@case(22, "4.set_cube_state", needs=("set_cube_state",))
def putting_a_cube_somewhere(t: Trial) -> None:
    """A cube is where set_cube_state puts it, turned as it says; what is left out stays."""
    wire = t.join()
    name = t.base(wire)
    reply = t.ask(wire, {"type": "set_cube_state", "cube_name": name, "position": t.at(2, 5)}, "cube_state_set")
    t.equal(reply["cube_name"], name, "cube_name")
    t.close(t.info(wire, name)["position"], t.at(2, 5), 1e-6, "position")
    t.ask(wire, {"type": "set_cube_state", "cube_name": name, "rotation": [0, 0, 0.5]}, "cube_state_set")
    info = t.info(wire, name)
    t.close(info["position"], t.at(2, 5), 1e-6, "position afterwards")
    same_turn(t, info["quaternion"], euler(0, 0, 0.5))
    t.ask(wire, {"type": "set_cube_state", "cube_name": name}, "cube_state_set")
    t.close(t.info(wire, name)["position"], t.at(2, 5), 1e-6, "position after nothing was said")


@case(23, "4.set_cube_state", needs=("set_cube_state", "joint.fixed"))
def putting_a_structure_somewhere(t: Trial) -> None:
    """The cubes joined to a cube move with it, as a rigid whole."""
    wire = t.join()
    one, two, three = (t.base(wire, position=t.at(x)) for x in (0, 1.5, 3))
    t.join_cubes(wire, one, two)
    t.join_cubes(wire, two, three)
    t.ask(wire, {"type": "set_cube_state", "cube_name": one, "position": t.at(-1, 5)}, "cube_state_set")
    for name, x in ((one, -1.0), (two, 0.5), (three, 2.0)):
        t.close(t.info(wire, name)["position"], t.at(x, 5), 1e-4, f"position of {name}")
    turn = {"type": "set_cube_state", "cube_name": one, "rotation": [0, 0, math.pi / 2]}
    t.ask(wire, turn, "cube_state_set")
    for name, y in ((one, 5.0), (two, 6.5), (three, 8.0)):
        t.close(t.info(wire, name)["position"], t.at(-1, y), 1e-4, f"position of {name} after the turn")


@case(24, "4.freeze_cube", needs=("freeze_cube",))
def freezing(t: Trial) -> None:
    """A cube is frozen and let go, as often as one likes, and the reply says which."""
    wire = t.join()
    name = t.base(wire)
    for frozen in (True, False, True, True):
        command = {"type": "freeze_cube", "cube_name": name, "freeze": frozen}
        reply = t.ask(wire, command, "cube_frozen")
        t.equal([reply["cube_name"], reply["freeze"]], [name, frozen], "cube_name and freeze")
        t.equal(t.info(wire, name)["frozen"], frozen, "frozen")


@case(25, "4.get_cube_state", needs=("get_cube_state",))
def cube_state_is_part_of_cube_info(t: Trial) -> None:
    """What get_cube_state tells, get_cube_info tells too."""
    wire = t.join()
    name = t.base(wire, rotation=[0, 0, 0.3])
    state = t.ask(wire, {"type": "get_cube_state", "cube_name": name}, "cube_state")
    info = t.info(wire, name)
    t.equal(state["cube_name"], name, "cube_name")
    for part in MOVING:
        t.close(state[part], info[part], 1e-9, part)


@case(26, "4.get_world_state", needs=("get_world_state",))
def world_state(t: Trial) -> None:
    """The world's state has all cubes in order of creation, or those that are asked for, in the order asked."""
    wire = t.join()
    names = [t.base(wire, position=t.at(n), rotation=[0, 0, 0.1 * n]) for n in range(3)]
    state = t.ask(wire, {"type": "get_world_state"}, "world_state")
    t.equal([c["cube_name"] for c in state["cubes"] if c["cube_name"] in names], names, "the case's cubes")
    wanted = [names[2], names[0]]
    some = t.ask(wire, {"type": "get_world_state", "cubes": wanted}, "world_state")
    t.equal([cube["cube_name"] for cube in some["cubes"]], wanted, "the cubes that were asked for")
    for cube in some["cubes"]:
        info = t.info(wire, cube["cube_name"])
        for part in MOVING:
            t.close(cube[part], info[part], 1e-9, part)
    t.equal(t.ask(wire, {"type": "get_world_state", "cubes": []}, "world_state")["cubes"], [], "no cubes")


@case(27, "4.get_world_state", needs=("get_world_state",))
def world_state_of_cubes_that_there_are_not(t: Trial) -> None:
    """The state of a cube that there is not is cube_not_found, with its place in the list."""
    wire = t.join()
    names = [t.base(wire), t.name()]
    t.refused(wire, {"type": "get_world_state", "cubes": names}, "cube_not_found", "cubes/1")


@case(28, "4.get_world_info", needs=("get_world_info",))
def world_info(t: Trial) -> None:
    """The world tells its protocol and its time, which fit together."""
    info = t.ask(t.join(), {"type": "get_world_info"}, "world_info")
    t.equal(info["versions"]["protocol"], 1, "version of the protocol")
    t.close(info["t"], info["frame"] / t.probe.tick_rate, 1e-6, "t, frame / tick_rate")
    t.equal(len(set(info["capabilities"])), len(info["capabilities"]), "the number of different capabilities")


@case(29, "4.get_planets", needs=("get_planets",))
def planets(t: Trial) -> None:
    """The planets are listed, and the list is the same when asked again."""
    wire = t.join()
    first = t.ask(wire, {"type": "get_planets"}, "planets")["planets"]
    t.equal(t.ask(wire, {"type": "get_planets"}, "planets")["planets"], first, "the second answer")


@case(30, "4.create_bone", needs=("create_bone", "joint.conetwist"))
def bones(t: Trial) -> None:
    """A bone is a conetwist joint of a skeleton, and the pair is joined then."""
    wire = t.join()
    one, two = t.base(wire), t.base(wire, position=t.at(1.5))
    command = {"type": "create_bone", "cube1": one, "cube2": two, "snake_id": "spine"}
    bone = t.ask(wire, command, "bone_created")["bone_name"]
    t.equal(t.info(wire, one)["joints"], [bone], "joints of the first")
    t.refused(wire, command, "joint_exists")
    if t.probe.claims("get_joint_info"):
        info = t.ask(wire, {"type": "get_joint_info", "joint_name": bone}, "joint_info")
        t.equal(info["joint_type"], "conetwist", "joint_type")


@table(
    31,
    "4.create_bone",
    [Row("name", "tail"), Row("number", 7), Row("zero", 0)],
    needs=("create_bone", "joint.conetwist"),
)
def skeletons(t: Trial, snake: Any) -> None:
    """A skeleton has a name or a whole number."""
    wire = t.join()
    one, two = t.base(wire), t.base(wire, position=t.at(1.5))
    t.ask(wire, {"type": "create_bone", "cube1": one, "cube2": two, "snake_id": snake}, "bone_created")


@case(32, "4.batch", needs=("batch",))
def batches(t: Trial) -> None:
    """A batch is answered by the replies to its commands, in order, each with its own id."""
    wire = t.join()
    name = t.name()
    commands = [
        {"type": "ping", "id": "a"},
        {"type": "spawn_cube", "cube_name": name, "position": t.at(), "is_base": True},
        {"type": "get_cube_info", "cube_name": name + "_BASE", "id": None},
        {"type": "despawn_cube", "cube_name": name + "_BASE", "id": 3},
    ]
    results = t.ask(wire, {"type": "batch", "commands": commands}, "batch_result")["results"]
    t.equal([result["type"] for result in results], ["pong", "cube_list", "cube_info", "cube_despawned"], "results")
    ids = [result.get("id", "none") for result in results]
    t.equal(ids, ["a", "none", None, 3], "the ids of the results")
    t.true("cubes" not in results[1], "no list of cubes from a spawn in a batch", results[1])
    t.fence(wire)


@case(33, "4.batch", needs=("batch",))
def empty_batches(t: Trial) -> None:
    """An empty batch has empty results."""
    t.equal(t.ask(t.join(), {"type": "batch", "commands": []}, "batch_result")["results"], [], "results")


@case(34, "3.3.3", needs=("batch",))
def batches_that_fail_in_part(t: Trial) -> None:
    """A command of a batch that fails does not undo the earlier nor stop the later."""
    wire = t.join()
    one, two = t.name(), t.name()
    cube = {"type": "spawn_cube", "position": t.at(), "is_base": False}
    commands = [
        {**cube, "cube_name": one},
        {"type": "get_cube_info", "cube_name": two},
        {**cube, "cube_name": one},
        {**cube, "cube_name": two},
    ]
    results = t.ask(wire, {"type": "batch", "commands": commands}, "batch_result")["results"]
    said = [result["code"] if result["type"] == "error" else result["type"] for result in results]
    t.equal(said, ["cube_list", "cube_not_found", "cube_exists", "cube_list"], "results")
    t.true({one, two} <= set(t.cubes(wire)), "both cubes", results)


@case(35, "3.3.3", needs=("batch",))
def batches_that_are_invalid(t: Trial) -> None:
    """A batch that holds an invalid command is refused as a whole."""
    wire = t.join()
    name = t.name()
    good = {"type": "spawn_cube", "cube_name": name, "position": t.at()}
    for bad in ({"type": "spawn_cube", "mass": "x"}, {"type": "fly"}, {"cube_name": "x"}, 7, {"type": "despawn_cube"}):
        t.error(wire.ask({"type": "batch", "commands": [good, bad]}), {"invalid", "unknown_type"})
        t.true(name not in t.cubes(wire), "no cube", name)


@case(36, "4.batch", needs=("batch",))
def batches_in_batches(t: Trial) -> None:
    """A batch holds no batch."""
    wire = t.join()
    command = {"type": "batch", "commands": [{"type": "batch", "commands": []}]}
    t.error(wire.ask(command), {"invalid", "unknown_type"})


@case(37, "3.6.3", needs=("batch",))
def ownership_in_batches(t: Trial) -> None:
    """What a batch spawns is owned by the next of its commands."""
    wire = t.join()
    name = t.name()
    commands = [{"type": "spawn_cube", "cube_name": name, "position": t.at()}, {"type": "apply_physics"}]
    results = t.ask(wire, {"type": "batch", "commands": commands}, "batch_result")["results"]
    t.equal(results[1].get("cube_name"), name, "the cube that the force acted on")


@case(38, "4.subscribe", needs=("subscribe", "unsubscribe"))
def subscribing(t: Trial) -> None:
    """The reply to subscribe tells what was asked for, with the defaults of what was not."""
    wire = t.join()
    command = {"type": "subscribe", "events": ["tick"], "every": 1000, "position_threshold": 0.5}
    wanted = {"events": ["tick"], "every": 1000, "position_threshold": 0.5, "rotation_threshold": 0}
    reply = t.ask(wire, command, "subscribed")
    t.equal({name: reply[name] for name in wanted}, wanted, "the reply")
    reply = t.ask(wire, {"type": "subscribe", "every": 1000}, "subscribed")
    t.equal(sorted(reply["events"]), ["state", "tick"], "events where none are named")
    t.ask(wire, {"type": "unsubscribe"}, "unsubscribed")
    t.ask(wire, {"type": "unsubscribe"}, "unsubscribed")


@case(39, "4.get_cube_info", needs=("sensors.inertial",))
def sensors_when_asked_for(t: Trial) -> None:
    """Sensors are read when that is asked for, and only then."""
    wire = t.join()
    name = t.base(wire)
    plain = t.info(wire, name)
    t.true("accelerometer" not in plain and "gyro" not in plain, "no readings", plain)
    info = t.ask(wire, {"type": "get_cube_info", "cube_name": name, "sensors": True}, "cube_info")
    t.equal([len(info["accelerometer"]), len(info["gyro"])], [3, 3], "readings")


@case(40, "4.get_cube_info", needs=("sensors.range",))
def rays(t: Trial) -> None:
    """A range finder tells the distance to the ground along each ray, and null where there is nothing."""
    wire = t.join()
    name = t.base(wire, position=t.at(y=4))
    command = {"type": "get_cube_info", "cube_name": name, "rays": [[0, -1, 0], [0, 1, 0]], "max_range": 50}
    ranges = t.ask(wire, command, "cube_info")["ranges"]
    t.true(ranges[0] is not None, "the distance to the ground", ranges)
    t.close(ranges[0], 4.0, 0.05, "the distance to the ground")
    t.equal(ranges[1], None, "the distance upwards")


@case(41, "4.get_camera", needs=("get_camera",))
def pictures(t: Trial) -> None:
    """A camera takes a picture of the size that is asked for."""
    wire = t.join()
    name = t.base(wire)
    command = {"type": "get_camera", "cube_name": name, "width": 16, "height": 8}
    reply = t.ask(wire, command, "camera_image")
    t.equal([reply["cube_name"], reply["width"], reply["height"]], [name, 16, 8], "cube_name, width and height")
    t.true(len(reply["image"]) > 20, "an image", reply)


@case(42, "2.2.3")
def a_reply_for_each_command(t: Trial) -> None:
    """Two hundred commands of many kinds in one write get two hundred replies, in order."""
    wire = t.join()
    name = t.base(wire)
    kinds: list[dict[str, Any]] = [
        {"type": "ping"},
        {"type": "get_cube_info", "cube_name": name},
        {"type": "get_cube_list"},
        {"type": "apply_physics", "cube_name": name, "force": [0, 1, 0]},
        {"type": "nothing"},
    ]
    wire.say(*({**kinds[n % len(kinds)], "id": n} for n in range(200)))
    wanted = ["pong", "cube_info", "cube_list", "physics_applied", "error"]
    for n in range(200):
        reply = wire.reply(f"reply {n}")
        t.equal([reply.get("id"), reply["type"]], [n, wanted[n % len(kinds)]], f"reply {n}")
    t.fence(wire)


@case(43, "3.1.3", needs=("planar",))
def the_plane(t: Trial) -> None:
    """In a planar world z, and turns about x and y, are ignored in commands and 0 in answers."""
    wire = t.join()
    where = [*t.at()[:2], 5.0]
    info = t.info(wire, t.base(wire, position=where, rotation=[0.4, 0.5, 0.6]))
    t.close(info["position"], t.at(), 1e-6, "position")
    t.close(info["rotation"], [0.0, 0.0, 0.6], 1e-5, "rotation")
    t.equal([info["quaternion"][0], info["quaternion"][1]], [0, 0], "x and y of the quaternion")


@case(44, "3.1.5")
def both_forms_of_rotation(t: Trial) -> None:
    """An answer has the rotation as 3 numbers and as 4."""
    wire = t.join()
    info = t.info(wire, t.base(wire, rotation=[0, 0, 0.25]))
    t.equal([len(info["rotation"]), len(info["quaternion"])], [3, 4], "the number of numbers")


@case(46, "4.get_cube_list")
def listing(t: Trial) -> None:
    """The list of cubes is what the last spawn told, and looking does not change it."""
    wire = t.join()
    reply = t.ask(wire, {"type": "spawn_cube", "cube_name": t.name(), "position": t.at()}, "cube_list")
    mine = [name for name in reply["cubes"] if name.startswith(f"{t.probe.tag}-{t.plot}-")]
    for _ in range(2):
        listed = t.ask(wire, {"type": "get_cube_list"}, "cube_list")
        t.true("spawned" not in listed, "nothing spawned by looking", listed)
        t.equal([name for name in listed["cubes"] if name.startswith(f"{t.probe.tag}-{t.plot}-")], mine, "the list")


@case(45, "4.get_world_info", needs=("get_world_info",), level=Level.SHOULD)
def the_limits_are_told(t: Trial) -> None:
    """The world tells how many cubes and joints it takes."""
    limits = t.ask(t.join(), {"type": "get_world_info"}, "world_info")["limits"]
    t.true(all(isinstance(limits[name], int) for name in ("cubes", "joints")), "two whole numbers", limits)


@case(47, "4.set_cube_state", needs=("set_cube_state",))
def putting_a_cube_that_moves(t: Trial) -> None:
    """A cube in flight that is put somewhere else flies on as before, where no velocity is given."""
    wire = t.join()
    name = t.spawn(wire, position=t.at(y=60), linear_velocity=[2, 0, 0], angular_velocity=[0, 0, 1])
    t.ask(wire, {"type": "set_cube_state", "cube_name": name, "position": t.at(y=90)}, "cube_state_set")
    info = t.info(wire, name)
    t.close(info["linear_velocity"][0], 2.0, 0.05, "velocity along x")
    t.close(info["angular_velocity"][2], 1.0, 0.05, "angular velocity about z")
