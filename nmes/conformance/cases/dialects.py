"""The raw dialect: a bare password, and silence after most commands."""

from __future__ import annotations

import time
from math import pi
from typing import Any

from nmes.conformance.case import Category, Row, Scope
from nmes.conformance.cases.auth import AUTH_DELAY, only_error
from nmes.conformance.trial import Trial
from nmes.conformance.values import command_needs
from nmes.conformance.wire import Message, Wire, frame_of, read_json
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


PUSHES = ("apply_force", "apply_physics")  # whose effect takes time: see 3.20 and 3.21


@table(9, "2.2.4", [Row(kind, kind, command_needs(kind)) for kind in SILENT if kind not in PUSHES])
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
    elif kind == "set_color":
        t.close(t.info(json_wire, cube)["color"], [1, 1, 0, 1], 1e-6, "color")


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


# -- the words of the original ----------------------------------------------------------------------------------------


def said(t: Trial, wire: Wire, command: dict[str, Any], expected: str) -> Message:
    """Returns the reply to a command, of that type and with its id, in whichever words."""
    wire.say({**command, "id": "said"})
    reply = read_json(wire.frame(what=expected))
    t.equal([reply["type"], reply["id"]], [expected, "said"], "type and id of the reply")
    return reply


def pair(t: Trial) -> tuple[str, str]:
    """Returns two new frozen cubes beside each other."""
    wire = t.join()
    return t.base(wire), t.base(wire, position=t.at(1.5))


@table(20, "2.5.1", [Row("1-kg", 1.0), Row("2-kg", 2.0)], needs=("time", "apply_force"), scope=Scope.TIME)
def a_force_is_an_impulse(t: Trial, mass: float) -> None:
    """In the raw dialect apply_force changes the velocity at once by force / mass."""
    pushed_in_the_words_of_the_original(t, {"type": "apply_force", "force": [3 * mass, 0, 0]}, mass)


@case(21, "2.5.2", needs=("time",), scope=Scope.TIME)
def central_impulses(t: Trial) -> None:
    """In the raw dialect the central_impulse of apply_physics is its impulse."""
    pushed_in_the_words_of_the_original(t, {"type": "apply_physics", "central_impulse": [6, 0, 0]}, 2.0)


def pushed_in_the_words_of_the_original(t: Trial, push: dict[str, Any], mass: float) -> None:
    """Makes sure that a push gives a cube of that mass 3 m/s along x, and no more later."""
    json_wire, wire = t.join(), t.raw()
    name = t.spawn(json_wire, position=t.at(-3, 20), mass=mass)
    wire.say({**push, "cube_name": name}, {"type": "ping", "id": "next"})
    pong(t, wire, "next")
    t.until(json_wire, name, 0.1, lambda info: info["linear_velocity"][0] > 1, "a velocity along x")
    for info in t.watch(json_wire, name, 0.2):
        t.close(info["linear_velocity"][0], 3.0, 0.1, "velocity along x")


@table(
    22,
    "2.5.3",
    [Row(kind, kind, (f"joint.{'slide' if kind == 'slider' else kind}",)) for kind in ("fixed", "hinge", "slider")],
)
def joints_are_called_after_their_cubes(t: Trial, kind: str) -> None:
    """In the raw dialect a joint without a name is called after its type and cubes, as the client calls them."""
    wire = t.raw()
    one, two = pair(t)
    t.equal(t.join_cubes(wire, one, two, kind), f"joint_{kind}_{one}_{two}", "joint_name")


@case(23, "2.5.4", needs=("joint.fixed",))
def joints_of_a_name_that_is_taken(t: Trial) -> None:
    """In the raw dialect a joint of a name that is taken is made, with a number behind its name."""
    wire, name = t.raw(), t.name("hip")
    names = [t.join_cubes(wire, *pair(t), joint_name=name) for _ in range(3)]
    t.equal(names, [name, f"{name}_2", f"{name}_3"], "the names of three joints")


@table(
    24,
    "2.5.5",
    [
        Row("limit_enable", ("limit_enable", 1.0, {"limit_enabled": True}), ("limits",)),
        Row("motor_enable", ("motor_enable", 1, {"motor_enabled": True}), ("motor",)),
        Row("motor_max_impulse", ("motor_max_impulse", 0.5, {"motor_max_force": 30.0}), ("motor",)),
    ],
    needs=("joint.hinge",),
)
def parameters_in_the_words_of_the_original(t: Trial, row: tuple[str, Any, dict[str, Any]]) -> None:
    """In the raw dialect parameters have the original's names, which the answer repeats, and mean ours."""
    name, value, ours = row
    json_wire, wire = t.join(), t.raw()
    joint = t.join_cubes(json_wire, *pair(t), "hinge", limits=[-1, 1], motor_enabled=False)
    one = {"type": "set_joint_param", "joint_name": joint, "param_name": name, "value": value}
    reply = said(t, wire, one, "joint_param_set")
    t.equal([reply["joint_name"], reply["param_name"], reply["value"]], [joint, name, value], "the reply")
    if t.probe.claims("set_joint_params"):
        several = {"type": "set_joint_params", "joint_name": joint, "params": {name: value}}
        t.equal(said(t, wire, several, "joint_param_set")["params"], {name: value}, "params of the reply")
    if t.probe.claims("get_joint_info"):
        params = t.ask(json_wire, {"type": "get_joint_info", "joint_name": joint}, "joint_info")["params"]
        t.equal({each: params[each] for each in ours}, ours, "the parameter in the json dialect")


HINGE = {
    "limit_lower": -pi / 2, "limit_upper": pi / 2, "limit_enable": 0.0, "motor_enable": 0.0,
    "motor_target_velocity": 0.0, "motor_max_impulse": 1.0,
}  # fmt: skip


@table(
    25,
    "2.5.6",
    [
        Row("hinge", ("hinge", HINGE), ("joint.hinge", "limits", "motor")),
        Row("slider", ("slider", {"linear_limit_lower": -1.0, "linear_limit_upper": 1.0}), ("joint.slide", "limits")),
        Row("conetwist", ("conetwist", {"swing_span": pi / 4, "twist_span": pi}), ("joint.conetwist", "limits")),
    ],
    needs=("get_joint_info",),
)
def a_joint_has_the_defaults_of_the_original(t: Trial, row: tuple[str, dict[str, float]]) -> None:
    """In the raw dialect a new joint has the original's defaults, told in the original's words, numbers all."""
    kind, expected = row
    wire = t.raw()
    joint = t.join_cubes(wire, *pair(t), kind)
    params = said(t, wire, {"type": "get_joint_info", "joint_name": joint}, "joint_info")["params"]
    t.true(not any(isinstance(value, bool) for value in params.values()), "numbers", params)
    t.close([params[name] for name in expected], list(expected.values()), 1e-6, f"params {', '.join(expected)}")


@table(
    26,
    "2.5.7",
    [Row("opaque", ("#FF0033", [1, 0, 0.2, 1])), Row("with-opacity", ("#00FF6633", [0, 1, 0.4, 0.2]))],
    needs=("set_color",),
)
def colours_in_hex(t: Trial, row: tuple[str, list[float]]) -> None:
    """In the raw dialect a colour may be written as hex, with or without opacity."""
    text, color = row
    json_wire, wire = t.join(), t.raw()
    cube = t.base(json_wire)
    wire.say({"type": "set_color", "cube_name": cube, "hex": text}, {"type": "ping", "id": "next"})
    pong(t, wire, "next")
    t.close(t.info(json_wire, cube)["color"], color, 1e-6, "color")


@case(27, "2.5.8", needs=("joint.hinge", "get_joint_info"))
def parameters_without_effect(t: Trial) -> None:
    """In the raw dialect parameters without effect are kept with the joint, and told back."""
    wire = t.raw()
    joint = t.join_cubes(wire, *pair(t), "hinge", joint_params={"bias": 0.25, "softness": 0.75})
    command = {"type": "set_joint_param", "joint_name": joint, "param_name": "softness", "value": 0.5}
    reply = said(t, wire, command, "joint_param_set")
    t.equal([reply["param_name"], reply["value"]], ["softness", 0.5], "the reply")
    params = said(t, wire, {"type": "get_joint_info", "joint_name": joint}, "joint_info")["params"]
    t.equal([params["bias"], params["softness"]], [0.25, 0.5], "bias and softness")
