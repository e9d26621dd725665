"""Authentication: who is let in, what they are told, and how the others are turned away."""

from __future__ import annotations

import time
from typing import Any

from nmes.conformance.case import Category, Finding, Level, Row
from nmes.conformance.trial import Trial
from nmes.conformance.wire import clip, read_json, read_message
from nmes.protocol import DELIMITER

AUTH = Category(2, "auth")
case, table = AUTH.case, AUTH.table

AUTH_TIMEOUT = 5.0  # s
AUTH_DELAY = 1.0  # s
SLACK = 3.0  # s that a busy machine may add


def only_error(t: Trial, frames: list[bytes], codes: str | set[str]) -> None:
    """Makes sure that one error was the server's last and only word."""
    t.true(len(frames) == 1, "one frame before the end", f"{len(frames)}: {frames[:3]}")
    t.error(read_message(frames[0]), codes)


@case(1, "2.2.1")
def the_password_lets_in(t: Trial) -> None:
    """The right password gets auth_success, as its schema says."""
    wire = t.connect()
    wire.say({"type": "auth", "password": t.target.password})
    welcome = wire.hear(what="auth_success")
    t.equal(welcome["type"], "auth_success", "the reply")
    t.equal(welcome["protocol"], 1, "the protocol's version")
    t.close(welcome["timestep"], 1 / welcome["tick_rate"], 1e-9, "timestep, 1 / tick_rate")
    t.fence(wire)


@table(
    2,
    "3.2.2",
    [
        Row(name, value)
        for name, value in {"number": 7, "text": "x", "null": None, "list": [1, [None]], "object": {"a": 1}}.items()
    ],
)
def auth_echoes_its_id(t: Trial, value: Any) -> None:
    """The auth_success carries the id of auth."""
    wire = t.connect()
    wire.say({"type": "auth", "password": t.target.password, "id": value})
    welcome = wire.hear(what="auth_success")
    t.true("id" in welcome, "an id", welcome)
    t.equal(welcome["id"], value, "the id")


@case(3, "4.ping")
def auth_without_id_has_none(t: Trial) -> None:
    """Without an id, auth_success has none."""
    wire = t.connect()
    wire.say({"type": "auth", "password": t.target.password})
    welcome = wire.hear(what="auth_success")
    t.should("id" not in welcome, "no id", welcome)


@case(4, "2.2.2", wait=1.0)
def a_wrong_password(t: Trial) -> None:
    """A wrong password gets error auth_failed with auth's id, and the connection is closed."""
    wire = t.connect()
    wire.say({"type": "auth", "password": t.target.password + "x", "id": 5})
    frames = wire.rest(t.target.timeout + AUTH_DELAY)
    only_error(t, frames, "auth_failed")
    t.should(read_json(frames[0]).get("id") == 5, "id 5", frames[0])


@case(5, "2.4.3", wait=1.0)
def a_wrong_password_costs_a_second(t: Trial) -> None:
    """A failed auth is answered after 1 s, not before."""
    wire = t.connect()
    wire.say({"type": "auth", "password": t.wrong_password})
    began = time.monotonic()
    frame = wire.frame(t.target.timeout + AUTH_DELAY, "error auth_failed")
    took = time.monotonic() - began
    t.error(read_message(frame), "auth_failed")
    t.true(took >= 0.9 * AUTH_DELAY, f"an answer after {AUTH_DELAY:g} s", f"one after {took:.3f} s")
    t.should(took <= AUTH_DELAY + SLACK, f"an answer after {AUTH_DELAY:g} s", f"one after {took:.3f} s")


@table(
    6,
    "2.2.2",
    [
        Row("empty", ""),
        Row("prefix", -1),
        Row("longer", 1),
        Row("other-case", "swapcase"),
        Row("trailing-newline", "\n"),
    ],
    wait=1.0,
)
def nearly_the_password(t: Trial, how: Any) -> None:
    """What is nearly the password is not the password."""
    password = t.target.password
    guess = {
        "": "",
        -1: password[:-1],
        1: password + password[-1:],
        "swapcase": password.swapcase(),
        "\n": password + "\n",
    }[how]
    if guess == password:  # it has no letters
        guess = password + password
    wire = t.connect()
    wire.say({"type": "auth", "password": guess})
    only_error(t, wire.rest(t.target.timeout + AUTH_DELAY), "auth_failed")


@table(
    7,
    "2.2.2",
    [
        Row("ping", {"type": "ping"}),
        Row("spawn", {"type": "spawn_cube"}),
        Row("no-type", {"password": "x"}),
        Row("unknown", {"type": "hello"}),
        Row("empty-object", {}),
    ],
    wait=1.0,
)
def something_else_first(t: Trial, first: dict[str, Any]) -> None:
    """A first message that is not auth is refused, and the connection is closed."""
    wire = t.connect()
    wire.say(first)
    only_error(t, wire.rest(t.target.timeout + AUTH_DELAY), {"auth_failed", "invalid"})


@table(
    8,
    "2.2.2",
    [
        Row("no-password", {"type": "auth"}),
        Row("number", {"type": "auth", "password": 7}),
        Row("null", {"type": "auth", "password": None}),
        Row("list", {"type": "auth", "password": ["x"]}),
        Row("world-is-no-name", {"type": "auth", "password": True, "world": 3}),
    ],
    wait=1.0,
)
def auth_that_is_not_as_its_schema_says(t: Trial, first: dict[str, Any]) -> None:
    """An auth whose fields are not right is refused, and the connection is closed."""
    wire = t.connect()
    wire.say(first)
    only_error(t, wire.rest(t.target.timeout + AUTH_DELAY), {"invalid", "auth_failed"})


@case(9, "2.2.2", wait=1.0)
def broken_json_first(t: Trial) -> None:
    """A first frame that begins like JSON and is none is refused, and the connection is closed."""
    wire = t.connect()
    wire.send(b'{"type":"auth","password":"x",}' + DELIMITER)
    only_error(t, wire.rest(t.target.timeout + AUTH_DELAY), {"bad_json", "bad_frame", "auth_failed"})


@case(10, "1.4.3", wait=AUTH_TIMEOUT)
def silence(t: Trial) -> None:
    """Who says nothing gets auth_timeout after 5 s, and the connection is closed."""
    wire = t.connect()
    began = time.monotonic()
    frames = wire.rest(AUTH_TIMEOUT + SLACK + t.target.timeout)
    took = time.monotonic() - began
    only_error(t, frames, "auth_timeout")
    t.should(AUTH_TIMEOUT - 0.5 <= took <= AUTH_TIMEOUT + SLACK, "the end after 5 s", f"the end after {took:.1f} s")


@table(11, "1.4.3", [Row("json", b'{"type":"auth"'), Row("bare", None)], wait=AUTH_TIMEOUT)
def half_an_auth(t: Trial, beginning: bytes | None) -> None:
    """Who only begins to say the password gets auth_timeout, and the connection is closed."""
    wire = t.connect()
    wire.send(beginning or t.target.password.encode())
    only_error(t, wire.rest(AUTH_TIMEOUT + SLACK + t.target.timeout), "auth_timeout")


@case(12, "1.4.3", wait=AUTH_TIMEOUT)
def dribbling(t: Trial) -> None:
    """Bytes now and then do not put off the time-out."""
    wire = t.connect()
    began = time.monotonic()
    for byte in b'{"type":"':  # for longer than the time-out, so that one that is put off at all is put off far
        if wire.ready(0.2):
            break
        wire.send(bytes([byte]))
        t.sleep(0.6)
    only_error(t, wire.rest(AUTH_TIMEOUT + SLACK + t.target.timeout), "auth_timeout")
    took = time.monotonic() - began
    t.true(took <= AUTH_TIMEOUT + SLACK, "the end after 5 s", f"the end after {took:.1f} s")


@case(13, "1.4.1", wait=1.0)
def a_long_first_frame(t: Trial) -> None:
    """A first frame of more than 16 KiB gets frame_too_large, and the connection is closed."""
    wire = t.connect()
    wire.send(b'{"type":"auth","password":"' + b"x" * (17 << 10))
    only_error(t, wire.rest(t.target.timeout + AUTH_DELAY), "frame_too_large")


@case(14, "1.4.1")
def a_first_frame_that_is_long_enough(t: Trial) -> None:
    """A first frame of nearly 16 KiB is read."""
    wire = t.connect()
    wire.say({"type": "auth", "password": t.target.password, "padding": "x" * (15 << 10)})
    t.equal(wire.hear(what="auth_success")["type"], "auth_success", "the reply")


@case(15, "4.error.world_not_found")
def a_world_that_there_is_not(t: Trial) -> None:
    """Who names a world that there is not gets world_not_found, and the connection is closed."""
    wire = t.connect()
    wire.say({"type": "auth", "password": t.target.password, "world": "no-such-world-0f3a"})
    only_error(t, wire.rest(t.target.timeout + AUTH_DELAY), {"world_not_found"})


@case(16, "2.2.1")
def its_own_world_by_name(t: Trial) -> None:
    """The world that auth_success tells can be named."""
    world = t.probe.banner.get("world")
    wire = t.connect()
    wire.say({"type": "auth", "password": t.target.password, "world": world})
    welcome = wire.hear(what="auth_success")
    t.equal(welcome["type"], "auth_success", "the reply")
    t.equal(welcome["world"], world, "the world")


@case(17, "4.error.unknown_type")
def auth_again(t: Trial) -> None:
    """A second auth is no command: unknown_type, and the connection goes on."""
    wire = t.join()
    t.refused(wire, {"type": "auth", "password": t.target.password}, {"unknown_type", "invalid"})
    t.fence(wire)


@case(18, "2.2.1")
def unknown_fields_of_auth(t: Trial) -> None:
    """Fields of auth that are not known are ignored."""
    wire = t.connect()
    wire.say({"type": "auth", "password": t.target.password, "colour": "green", "version": 17})
    t.equal(wire.hear(what="auth_success")["type"], "auth_success", "the reply")


@case(19, "2.2.1")
def connections_have_numbers_of_their_own(t: Trial) -> None:
    """Connections that are open together have different client numbers."""
    numbers = []
    for _ in range(3):
        wire = t.connect()
        wire.say({"type": "auth", "password": t.target.password})
        numbers.append(wire.hear(what="auth_success")["client"])
    t.equal(len(set(numbers)), 3, "different numbers")


@case(20, "2.2.1")
def the_banner_is_that_of_the_world(t: Trial) -> None:
    """What auth_success says of the world is what get_world_info says."""
    wire = t.connect()
    wire.say({"type": "auth", "password": t.target.password})
    welcome = wire.hear(what="auth_success")
    reply = wire.ask({"type": "get_world_info"})
    if reply["type"] == "world_info":
        for name in ("world", "backend", "dims", "mode"):
            t.equal(reply[name], welcome[name], name)


@case(21, "2.4.2", level=Level.SHOULD, wait=1.0)
def errors_do_not_repeat_passwords(t: Trial) -> None:
    """No error repeats what was given for a password."""
    secret = "hunter2-" + t.name("secret")
    for first in ({"type": "auth", "password": secret}, {"type": "auth", "password": [secret]}):
        wire = t.connect()
        wire.say(first)
        for frame in wire.rest(t.target.timeout + AUTH_DELAY):
            t.true(secret.encode() not in frame, "an error without the password in it", frame)


@case(22, "2.3.1", level=Level.SHOULD)
def the_worlds_are_listed(t: Trial) -> None:
    """Auth with list gets world_list, which names the world, and the connection is closed."""
    wire = t.connect()
    wire.say({"type": "auth", "password": t.target.password, "list": True})
    reply = wire.hear(what="world_list")
    t.equal(reply["type"], "world_list", "the reply")
    t.true(
        any(world["world"] == t.probe.banner.get("world") for world in reply["worlds"]),
        f"the world {t.probe.banner.get('world')!r} in the list",
        clip(reply),
    )
    t.equal(wire.rest(), [], "what comes after the list")


@case(23, "2.2.2", wait=1.0)
def a_failed_auth_executes_nothing(t: Trial) -> None:
    """Commands behind a wrong password are not executed."""
    wire, other = t.connect(), t.join()
    name = t.name()
    wire.say(
        {"type": "auth", "password": t.wrong_password}, {"type": "spawn_cube", "cube_name": name, "position": t.at()}
    )
    only_error(t, wire.rest(t.target.timeout + AUTH_DELAY), "auth_failed")
    t.true(name not in t.cubes(other), "no cube", name)


@case(24, "2.4.3", wait=1.0)
def a_failed_auth_keeps_nobody_waiting(t: Trial) -> None:
    """While one connection waits for its refusal, others are served."""
    other = t.join()
    for _attempt in range(3):
        wire = t.connect()
        wire.say({"type": "auth", "password": t.wrong_password})
        t.sleep(0.1)  # until the server has read that
        t.fence(other)
        overtaken = not wire.ready(0.05)
        only_error(t, wire.rest(t.target.timeout + AUTH_DELAY), "auth_failed")
        if overtaken:
            return
        # A busy machine may need a second for a pong, but not again and again.
    raise Finding("a pong before the refusal", "pongs only after the refusals")
