"""What each command does: its reply, and its effect as other commands see it.

Those that make and remove cubes, and those about joints, have files of their own.
"""

from __future__ import annotations

import math
from typing import Any

from nmes.conformance.case import Category, Level, Row
from nmes.conformance.cases.cube_commands import CUBE_COMMANDS
from nmes.conformance.cases.joint_commands import JOINT_COMMANDS
from nmes.conformance.rotation import euler, same_turn
from nmes.conformance.trial import Trial

CONTRACTS = Category(5, "commands", parts=(CUBE_COMMANDS, JOINT_COMMANDS))
case, table = CONTRACTS.case, CONTRACTS.table

MOVING = ("position", "rotation", "quaternion", "linear_velocity", "angular_velocity")


@table(
    20,
    "4.apply_physics",
    [
        Row(name, fields)
        for name, fields in {
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
    t.equal([cube["cube_name"] for cube in state["cubes"] if cube["cube_name"] in names], names, "the case's cubes")
    selection = [names[2], names[0]]
    some = t.ask(wire, {"type": "get_world_state", "cubes": selection}, "world_state")
    t.equal([cube["cube_name"] for cube in some["cubes"]], selection, "the cubes that were asked for")
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
    if not t.probe.claims("joint.several"):
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
    outcomes = [result["code"] if result["type"] == "error" else result["type"] for result in results]
    t.equal(outcomes, ["cube_list", "cube_not_found", "cube_exists", "cube_list"], "results")
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
    commands = [
        {"type": "spawn_cube", "cube_name": name, "position": t.at()},
        {"type": "apply_physics", "force": [0, 0, 0]},
    ]
    results = t.ask(wire, {"type": "batch", "commands": commands}, "batch_result")["results"]
    t.equal(results[1].get("cube_name"), name, "the cube that the force acted on")


@case(38, "4.subscribe", needs=("subscribe", "unsubscribe"))
def subscribing(t: Trial) -> None:
    """The reply to subscribe tells what was asked for, with the defaults of what was not."""
    wire = t.join()
    command = {"type": "subscribe", "events": ["tick"], "every": 1000, "position_threshold": 0.5}
    fields = {"events": ["tick"], "every": 1000, "position_threshold": 0.5, "rotation_threshold": 0}
    reply = t.ask(wire, command, "subscribed")
    t.equal({name: reply[name] for name in fields}, fields, "the reply")
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
    types = ["pong", "cube_info", "cube_list", "physics_applied", "error"]
    for n in range(200):
        reply = wire.reply(f"reply {n}")
        t.equal([reply.get("id"), reply["type"]], [n, types[n % len(kinds)]], f"reply {n}")
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
        reply = t.ask(wire, {"type": "get_cube_list"}, "cube_list")
        t.true("spawned" not in reply, "nothing spawned by looking", reply)
        t.equal([name for name in reply["cubes"] if name.startswith(f"{t.probe.tag}-{t.plot}-")], mine, "the list")


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
