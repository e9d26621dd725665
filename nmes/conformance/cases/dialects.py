"""The raw dialect: a bare password, and silence after most commands."""

from __future__ import annotations

import time
from typing import Any

from nmes.conformance.case import Category, Row
from nmes.conformance.cases.auth import AUTH_DELAY, only_error
from nmes.conformance.trial import Trial
from nmes.conformance.values import command_needs
from nmes.conformance.wire import Wire, frame_of, read_json
from nmes.protocol import COMMANDS, DELIMITER

DIALECTS = Category(3, "dialects")
case, table = DIALECTS.case, DIALECTS.table

SILENT = [kind for kind, command in COMMANDS.items() if command.silent]


def silent_command(t: Trial, kind: str, cube: str) -> dict[str, Any]:
    """Returns a command that will succeed."""
    commands: dict[str, dict[str, Any]] = {
        "spawn_cube": {"type": kind, "cube_name": t.name(), "position": t.at(2)},
        "despawn_cube": {"type": kind, "cube_name": cube},
        "apply_force": {"type": kind, "cube_name": cube, "force": [0, 1, 0]},
        "apply_physics": {"type": kind, "cube_name": cube, "force": [0, 1, 0]},
        "freeze_cube": {"type": kind, "cube_name": cube, "freeze": True},
        "set_color": {"type": kind, "cube_name": cube, "color": [1, 1, 0]},
    }
    return commands[kind]


def pong(t: Trial, wire: Wire, id: object) -> None:
    """Makes sure that the next frame is the pong to the ping with that id."""
    t.equal(wire.hear(what="pong"), {"type": "pong", "id": id}, "the next frame")


@case(1, "2.1.1")
def the_bare_password(t: Trial) -> None:
    """The bare password gets the bare text auth_success."""
    wire = t.raw()
    wire.say({"type": "ping", "id": 1})
    pong(t, wire, 1)


@case(2, "2.2.2", wait=1.0)
def a_wrong_bare_password(t: Trial) -> None:
    """A wrong bare password gets the bare text auth_failed, and the connection is closed."""
    wire = t.connect()
    wire.send(t.wrong_password.encode() + DELIMITER)
    t.equal(wire.rest(t.target.timeout + AUTH_DELAY), [b"auth_failed"], "all that is said")


@case(3, "2.4.3", wait=1.0)
def a_wrong_bare_password_costs_a_second(t: Trial) -> None:
    """The bare text auth_failed comes after 1 s, not before."""
    wire = t.connect()
    wire.send(t.wrong_password.encode() + DELIMITER)
    began = time.monotonic()
    t.equal(wire.frame(t.target.timeout + AUTH_DELAY), b"auth_failed", "the answer")
    took = time.monotonic() - began
    t.true(took >= 0.9 * AUTH_DELAY, f"an answer after {AUTH_DELAY:g} s", f"one after {took:.3f} s")


@case(4, "2.1.1")
def the_bare_password_with_white_space(t: Trial) -> None:
    """White space around the bare password is ignored."""
    wire = t.connect()
    wire.send(b"\n" + t.target.password.encode() + b"\r\n" + DELIMITER)
    t.equal(wire.frame(what="auth_success"), b"auth_success", "the answer")


@table(5, "2.1.1", [Row("string", b'"%s"'), Row("list", b'["%s"]')], wait=1.0)
def json_that_is_no_object_is_a_bare_password(t: Trial, form: bytes) -> None:
    """A first frame that does not begin with a brace is a bare password, and a wrong one."""
    wire = t.connect()
    wire.send(form % t.target.password.encode() + DELIMITER)
    t.equal(wire.rest(t.target.timeout + AUTH_DELAY), [b"auth_failed"], "all that is said")


@table(6, "2.2.4", [Row(kind, kind, command_needs(kind)) for kind in SILENT])
def silence_after_success(t: Trial, kind: str) -> None:
    """A command that the raw dialect keeps silent about gets no reply when it succeeds."""
    json_wire, wire = t.join(), t.raw()
    cube = t.spawn(json_wire)
    wire.say(silent_command(t, kind, cube), {"type": "ping", "id": "next"})
    pong(t, wire, "next")


@table(7, "2.2.4", [Row(kind, kind, command_needs(kind)) for kind in SILENT])
def silence_after_failure(t: Trial, kind: str) -> None:
    """A command that the raw dialect keeps silent about gets no error when it fails."""
    wire = t.raw()
    command = silent_command(t, kind, "nobody-" + t.name())
    if kind == "spawn_cube":
        wire.say(command)
    wire.say(command, {"type": "ping", "id": "next"})
    pong(t, wire, "next")


@table(8, "2.2.4", [Row(kind, kind, command_needs(kind)) for kind in SILENT])
def silence_after_an_invalid_command(t: Trial, kind: str) -> None:
    """A command that the raw dialect keeps silent about gets no error when its fields are not valid."""
    wire = t.raw()
    wire.say({"type": kind, "cube_name": 7, "force": "strong", "freeze": 3}, {"type": "ping", "id": "next"})
    pong(t, wire, "next")


@table(9, "2.2.4", [Row(kind, kind, command_needs(kind)) for kind in SILENT if kind != "apply_physics"])
def what_is_silent_is_done(t: Trial, kind: str) -> None:
    """A command without a reply has its effect."""
    json_wire, wire = t.join(), t.raw()
    cube = t.spawn(json_wire)
    command = silent_command(t, kind, cube)
    wire.say(command, {"type": "ping", "id": "next"})
    pong(t, wire, "next")
    cubes = t.cubes(json_wire)
    if kind == "spawn_cube":
        t.true(command["cube_name"] in cubes, f"{command['cube_name']} among the cubes", cubes)
    elif kind == "despawn_cube":
        t.true(cube not in cubes, f"no {cube} among the cubes", cubes)
    elif kind == "freeze_cube":
        t.equal(t.info(json_wire, cube)["frozen"], True, "frozen")


@table(
    10,
    "2.2.4",
    [
        Row("get_cube_list", {"type": "get_cube_list"}),
        Row("ping", {"type": "ping"}),
        Row("get_world_info", {"type": "get_world_info"}, ("get_world_info",)),
        Row("get_joint_list", {"type": "get_joint_list"}, ("get_joint_list",)),
        Row("unsubscribe", {"type": "unsubscribe"}, ("unsubscribe",)),
        Row("batch", {"type": "batch", "commands": []}, ("batch",)),
    ],
)
def everything_else_is_answered(t: Trial, command: dict[str, Any]) -> None:
    """A command that is not silent gets its reply in the raw dialect, with its id."""
    wire = t.raw()
    reply = wire.ask(command)
    t.equal(reply["type"], COMMANDS[command["type"]].reply, "the type of the reply")


@case(11, "4.create_joint", needs=("joint.fixed",))
def joints_are_answered(t: Trial) -> None:
    """The commands create_joint and set_joint_param are answered in the raw dialect, success or failure."""
    json_wire, wire = t.join(), t.raw()
    one, two = t.spawn(json_wire), t.spawn(json_wire, position=t.at(1.5))
    t.join_cubes(wire, one, two)
    t.error(wire.ask({"type": "create_joint", "cube1": one, "cube2": one, "joint_type": "fixed"}), "self_joint")
    command = {"type": "set_joint_param", "joint_name": "nothing", "param_name": "damping", "value": 1}
    t.error(wire.ask(command), "joint_not_found")


@case(12, "2.2.4")
def failures_of_what_is_answered(t: Trial) -> None:
    """A command that is not silent gets its error in the raw dialect."""
    wire = t.raw()
    t.error(wire.ask({"type": "get_cube_info", "cube_name": "nobody-" + t.name()}), "cube_not_found")
    t.error(wire.ask({"type": "no_such_command"}), "unknown_type")


@table(
    13,
    "2.4.4",
    [
        Row("list", b"[1]"),
        Row("number", b"7"),
        Row("text", b"spawn a cube"),
        Row("broken", b'{"type":"spawn_cube"'),
        Row("not-utf8", b"\xff\xfe"),
    ],
)
def what_is_no_object_is_answered(t: Trial, frame: bytes) -> None:
    """A frame that is no JSON object gets an error in the raw dialect too."""
    wire = t.raw()
    wire.send(frame + DELIMITER)
    t.error(wire.hear(what="an error"), {"bad_json", "bad_frame"})
    t.fence(wire)


@case(14, "2.2.4", needs=("get_planets",))
def planets_by_name(t: Trial) -> None:
    """In the raw dialect the reply to get_planets has one key a planet, its name, and a list of that planet alone."""
    planets = t.ask(t.join(), {"type": "get_planets"}, "planets")["planets"]
    wire = t.raw()
    wire.say({"type": "get_planets", "id": 4})
    reply = read_json(wire.frame(what="planets"))
    t.equal(reply, {planet["Name"]: [planet] for planet in planets}, "the reply")


@case(15, "2.2.4")
def a_row_of_commands_in_one_write(t: Trial) -> None:
    """Of many commands in one write, those that are answered are answered in order, and nothing else comes."""
    wire = t.raw()
    name = t.name()
    wire.say(
        {"type": "spawn_cube", "cube_name": name, "position": t.at()},
        {"type": "ping", "id": 1},
        {"type": "spawn_cube", "cube_name": name, "position": t.at()},
        {"type": "apply_physics", "cube_name": name, "force": [0, 1, 0]},
        {"type": "get_cube_info", "cube_name": name, "id": 2},
        {"type": "despawn_cube", "cube_name": name},
        {"type": "despawn_cube", "cube_name": name},
        {"type": "ping", "id": 3},
    )
    t.equal([wire.hear()["id"] for _ in range(3)], [1, 2, 3], "the ids of the replies")
    t.fence(wire)


@case(16, "2.2.5")
def nothing_unasked_for(t: Trial) -> None:
    """Nothing is sent that was not asked for, in either dialect."""
    json_wire, wire = t.join(), t.raw()
    t.spawn(json_wire)
    wire.quiet(0.5)
    json_wire.quiet(0.05)


@case(17, "3.6.3")
def ownership_in_the_raw_dialect(t: Trial) -> None:
    """A connection of the raw dialect owns the cube that it spawned last."""
    wire = t.raw()
    name = t.name()
    wire.send(
        frame_of({"type": "spawn_cube", "cube_name": name, "position": t.at(), "is_base": True})
        + frame_of({"type": "apply_physics", "force": [0, 0, 0]})
    )
    t.fence(wire)
    t.adopt(name + "_BASE")
    t.equal(t.info(wire, name + "_BASE")["cube_name"], name + "_BASE", "the cube")
    if t.probe.claims("get_cube_state"):
        last = t.name()
        wire.say({"type": "spawn_cube", "cube_name": last, "position": t.at(2)})
        t.equal(t.ask(wire, {"type": "get_cube_state"}, "cube_state")["cube_name"], last, "the cube that is owned")


@case(18, "1.4.2", wait=1.0)
def too_long_a_frame_in_the_raw_dialect(t: Trial) -> None:
    """A frame over the limit ends a connection of the raw dialect with an error."""
    wire = t.raw()
    wire.send(b"x" * (1200 << 10))
    only_error(t, wire.rest(), "frame_too_large")


@case(19, "2.1.1", wait=1.0)
def auth_failed_is_bare_for_bytes_that_are_no_text(t: Trial) -> None:
    """A first frame that is not UTF-8 is a wrong bare password."""
    wire = t.connect()
    wire.send(b"\xff\xfe\x80" + DELIMITER)
    t.equal(wire.rest(t.target.timeout + AUTH_DELAY), [b"auth_failed"], "all that is said")
