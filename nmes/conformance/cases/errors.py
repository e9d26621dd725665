"""Errors: the right code for each refusal, and a connection that goes on."""

from __future__ import annotations

from typing import Any

from nmes.conformance.case import Category, Row
from nmes.conformance.trial import Trial
from nmes.conformance.values import command_needs

ERRORS = Category(7, "errors")
case, table = ERRORS.case, ERRORS.table


ABOUT_A_CUBE: dict[str, dict[str, Any]] = {
    "despawn_cube": {},
    "apply_physics": {"force": [0, 1, 0]},
    "apply_force": {"force": [0, 1, 0]},
    "set_cube_state": {},
    "freeze_cube": {"freeze": True},
    "get_cube_info": {},
    "get_cube_state": {},
}
ABOUT_A_JOINT: dict[str, dict[str, Any]] = {
    "remove_joint": {},
    "set_joint_param": {"param_name": "damping", "value": 1},
    "get_joint_info": {},
}


@table(1, "4.error.cube_not_found", [Row(kind, kind, command_needs(kind)) for kind in ABOUT_A_CUBE])
def cubes_that_there_are_not(t: Trial, kind: str) -> None:
    """A command about a cube that there is not gets cube_not_found."""
    wire = t.join()
    t.refused(wire, {"type": kind, "cube_name": t.name(), **ABOUT_A_CUBE[kind]}, "cube_not_found", "cube_name")
    t.fence(wire)


@table(2, "4.error.cube_not_found", [Row(kind, kind, command_needs(kind)) for kind in ABOUT_A_CUBE])
def cubes_that_are_gone(t: Trial, kind: str) -> None:
    """A command about a cube that was despawned gets cube_not_found."""
    wire = t.join()
    name = t.spawn(wire)
    t.ask(wire, {"type": "despawn_cube", "cube_name": name}, "cube_despawned")
    t.refused(wire, {"type": kind, "cube_name": name, **ABOUT_A_CUBE[kind]}, "cube_not_found", "cube_name")


@table(3, "4.error.joint_not_found", [Row(kind, kind, command_needs(kind)) for kind in ABOUT_A_JOINT])
def joints_that_there_are_not(t: Trial, kind: str) -> None:
    """A command about a joint that there is not gets joint_not_found."""
    wire = t.join()
    t.refused(wire, {"type": kind, "joint_name": t.name(), **ABOUT_A_JOINT[kind]}, "joint_not_found", "joint_name")
    t.fence(wire)


@table(4, "4.error.cube_not_found", [Row("cube1", "cube1"), Row("cube2", "cube2")])
def joints_to_cubes_that_there_are_not(t: Trial, field: str) -> None:
    """A joint to a cube that there is not gets cube_not_found."""
    wire = t.join()
    cubes = {"cube1": t.spawn(wire), "cube2": t.spawn(wire, position=t.at(1.5)), field: t.name()}
    t.refused(wire, {"type": "create_joint", "joint_type": "fixed", **cubes}, "cube_not_found", field)


@case(5, "4.error.cube_exists")
def names_that_are_taken(t: Trial) -> None:
    """A cube of a name that is taken gets cube_exists, and the first cube stays as it is."""
    wire = t.join()
    name = t.spawn(wire, mass=2.0, is_base=True, position=t.at(1))
    before = t.info(wire, name)
    stem = name.removesuffix("_BASE")
    command = {"type": "spawn_cube", "cube_name": stem, "is_base": True, "mass": 5, "position": t.at(2)}
    t.refused(wire, command, "cube_exists", "cube_name")
    after = t.info(wire, name)
    t.equal([after["mass"], after["position"]], [before["mass"], before["position"]], "mass and position of the first")
    t.equal(t.cubes(wire).count(name), 1, "the number of cubes of that name")


@case(6, "4.error.self_joint")
def a_joint_to_itself(t: Trial) -> None:
    """A joint from a cube to itself gets self_joint."""
    wire = t.join()
    name = t.spawn(wire)
    command = {"type": "create_joint", "cube1": name, "cube2": name, "joint_type": "fixed"}
    t.refused(wire, command, "self_joint")


@table(7, "4.error.joint_exists", [Row("same-order", False), Row("other-order", True)], needs=("joint.fixed",))
def two_joints_of_a_pair(t: Trial, swap: bool) -> None:
    """A second joint between two cubes is made with joint.several, else gets joint_exists, whichever is named first."""
    wire = t.join()
    one, two = t.spawn(wire), t.spawn(wire, position=t.at(1.5))
    joints = [t.join_cubes(wire, one, two)]
    one, two = (two, one) if swap else (one, two)
    command = {"type": "create_joint", "cube1": one, "cube2": two, "joint_type": "fixed"}
    if t.probe.claims("joint.several"):
        joints.append(t.ask(wire, command, "joint_created")["joint_name"])
    else:
        t.refused(wire, command, "joint_exists")
    t.equal(t.info(wire, one)["joints"], joints, "joints of both")


@case(8, "4.error.joint_not_found", needs=("joint.fixed", "remove_joint"))
def joints_that_are_gone(t: Trial) -> None:
    """A joint that was removed is not found, and its cubes can be joined again."""
    wire = t.join()
    one, two = t.spawn(wire), t.spawn(wire, position=t.at(1.5))
    joint = t.join_cubes(wire, one, two)
    t.ask(wire, {"type": "remove_joint", "joint_name": joint}, "joint_removed")
    t.refused(wire, {"type": "remove_joint", "joint_name": joint}, "joint_not_found", "joint_name")
    again = t.join_cubes(wire, one, two)
    t.true(again != joint, "a new name", again)


@table(9, "4.error.nothing_owned", [Row(kind, kind, command_needs(kind)) for kind in ("apply_physics", "apply_force")])
def forces_on_nothing(t: Trial, kind: str) -> None:
    """A force without a cube's name, on a connection that has spawned none, gets nothing_owned."""
    wire = t.join()
    t.refused(wire, {"type": kind, "force": [0, 1, 0]}, "nothing_owned")
    t.fence(wire)


@table(
    10,
    "3.2.2",
    [
        Row("cube_not_found", {"type": "get_cube_info", "cube_name": "nobody-0f3a"}),
        Row("unknown_type", {"type": "fly"}),
        Row("invalid", {"type": "spawn_cube", "mass": "heavy"}),
        Row("joint_not_found", {"type": "set_joint_param", "joint_name": "x0f3a", "param_name": "damping", "value": 1}),
    ],
)
def errors_carry_the_id(t: Trial, command: dict[str, Any]) -> None:
    """An error carries the id of the command that failed, whatever it is, and only if it has one."""
    wire = t.join()
    for id in (7, "x", None, [1], {"a": None}, 0, False):
        reply = wire.ask({**command, "id": id})
        t.equal(reply["type"], "error", "the reply")
    wire.say(command)
    reply = wire.reply("an error")
    t.true("id" not in reply, "no id", reply)


@case(11, "4.error.invalid")
def errors_say_what_is_wrong(t: Trial) -> None:
    """An error has a message for people."""
    wire = t.join()
    for command in ({"type": "fly"}, {"type": "spawn_cube", "mass": -1}, {"type": "get_cube_info", "cube_name": "no0"}):
        reply = wire.ask(command)
        t.equal(reply["type"], "error", "the reply")
        t.true(len(reply["message"].strip()) > 3, "a message", reply)


@case(12, "3.3.1")
def errors_in_a_row_of_commands(t: Trial) -> None:
    """Errors take their places among the replies: one for each command, in order."""
    wire = t.join()
    name = t.name()
    cube = {"cube_name": name, "position": t.at(), "list": False}
    wire.say(
        {"type": "ping", "id": 0},
        {"type": "fly", "id": 1},
        {"type": "spawn_cube", **cube, "id": 2},
        {"type": "spawn_cube", **cube, "id": 3},
        {"type": "spawn_cube", "mass": [], "id": 4},
        {"type": "get_cube_info", "cube_name": name, "id": 5},
        {"type": "despawn_cube", "cube_name": name, "id": 6},
        {"type": "despawn_cube", "cube_name": name, "id": 7},
        {"type": "ping", "id": 8},
    )
    replies = [wire.reply(f"reply {n}") for n in range(9)]
    t.equal([reply.get("id") for reply in replies], list(range(9)), "the ids in order")
    expected = ["pong", "unknown_type", "cube_list", "cube_exists", "invalid", "cube_info", "cube_despawned"]
    outcomes = [reply["code"] if reply["type"] == "error" else reply["type"] for reply in replies]
    t.equal(outcomes, [*expected, "cube_not_found", "pong"], "the replies")


@case(13, "3.3.1")
def a_hundred_errors(t: Trial) -> None:
    """A hundred errors do not end a connection."""
    wire = t.join()
    for n in range(100):
        wire.say({"type": "fly", "id": n})
    for n in range(100):
        t.equal(wire.reply("an error").get("id"), n, "the id")
    t.fence(wire)


@case(14, "3.3.1")
def a_failed_spawn_is_not_owned(t: Trial) -> None:
    """A spawn that fails changes nothing of what the connection owns."""
    wire = t.join()
    t.refused(wire, {"type": "spawn_cube", "cube_name": t.name(), "mass": 0}, "invalid", "mass")
    t.refused(wire, {"type": "apply_physics", "force": [0, 1, 0]}, "nothing_owned")
    mine = t.spawn(wire)
    t.refused(wire, {"type": "spawn_cube", "cube_name": mine}, "cube_exists", "cube_name")
    t.equal(
        t.ask(wire, {"type": "apply_physics", "force": [0, 0, 0]}, "physics_applied")["cube_name"],
        mine,
        "the cube that is owned",
    )


@case(15, "4.error.invalid", needs=("joint.fixed",))
def a_joint_of_a_type_that_there_is_not(t: Trial) -> None:
    """A joint_type that there is not is invalid, and joins nothing."""
    wire = t.join()
    one, two = t.spawn(wire), t.spawn(wire, position=t.at(1.5))
    command = {"type": "create_joint", "cube1": one, "cube2": two, "joint_type": "glue"}
    t.refused(wire, command, "invalid", "joint_type")
    t.equal(t.info(wire, one)["joints"], [], "joints")


@case(16, "4.error.invalid", needs=("joint.hinge", "motor"))
def a_parameter_of_the_wrong_kind(t: Trial) -> None:
    """A switch wants true or false and a number a number; what is refused is not set."""
    wire = t.join()
    joint = t.join_cubes(wire, t.base(wire), t.spawn(wire, position=t.at(1.5)), "hinge")
    base = {"type": "set_joint_param", "joint_name": joint}
    for name, value in (("motor_enabled", 1), ("motor_target_velocity", True), ("motor_max_force", -1.0)):
        t.refused(wire, {**base, "param_name": name, "value": value}, "invalid", "value")
    t.refused(wire, {**base, "param_name": "no_such_param", "value": 1}, "invalid", "param_name")


@case(17, "4.error.invalid", needs=("joint.hinge", "limits", "get_joint_info"))
def limits_the_wrong_way_round(t: Trial) -> None:
    """A lower limit above the upper one is invalid, and sets neither."""
    wire = t.join()
    one, two = t.base(wire), t.spawn(wire, position=t.at(1.5))
    command = {"type": "create_joint", "cube1": one, "cube2": two, "joint_type": "hinge"}
    t.refused(wire, {**command, "limits": [1, -1]}, "invalid")
    t.equal(t.info(wire, one)["joints"], [], "joints after the refusal")
    joint = t.join_cubes(wire, one, two, "hinge", limits=[-1, 1])
    wrong = {"type": "set_joint_param", "joint_name": joint, "param_name": "limit_lower", "value": 2}
    t.refused(wire, wrong, "invalid")
    params = t.ask(wire, {"type": "get_joint_info", "joint_name": joint}, "joint_info")["params"]
    t.equal([params["limit_lower"], params["limit_upper"]], [-1, 1], "the limits after the refusal")


@case(18, "4.error.joint_exists", needs=("joint.fixed", "joint.several", "set_joint_params"))
def joint_names_that_are_taken(t: Trial) -> None:
    """A joint has the name that it is given; a second one of that name gets joint_exists, or a number if it asks."""
    wire = t.join()
    one, two = t.spawn(wire), t.spawn(wire, position=t.at(1.5))
    name = t.name()
    t.equal(t.join_cubes(wire, one, two, joint_name=name), name, "joint_name")
    command = {"type": "create_joint", "cube1": one, "cube2": two, "joint_type": "fixed", "joint_name": name}
    t.refused(wire, command, "joint_exists", "joint_name")
    numbered = t.ask(wire, {**command, "number_if_taken": True}, "joint_created")["joint_name"]
    t.equal(numbered, f"{name}_2", "the name with a number")
    t.equal(t.info(wire, one)["joints"], [name, numbered], "joints of the first")
