"""Cases about how a client comes in, and about the bytes of both directions."""

from __future__ import annotations

import time

from nmes.conformance.case import Finding
from nmes.conformance.clients.case import Group
from nmes.conformance.clients.stage import Stage, frame, tick
from nmes.conformance.wire import clip
from nmes.protocol import DELIMITER

__all__ = ["COMING", "GOING", "LOGIN"]

_PAUSE = 0.003  # s between two pieces, so that the client gets them one by one
_STRANGE = 'a"\\<???DONE???---\u00fc\u6f22\U0001f419'  # what JSON escapes, the delimiter, characters of 2 to 4 bytes
_NUMBERS = [0.30000000000000004, -1e-12, 123456.789012345]

LOGIN = Group(1, "login")


@LOGIN.case("2.1.1")
def _json_auth(t: Stage) -> None:
    """The first frame is an auth with the password, and the client is in when auth_success has come."""
    peer = t.connect()
    t.auth(peer)
    t.waits()
    peer.say(t.welcome())
    t.opened(t.welcome()["world"])
    t.ping(peer)


@LOGIN.case("1.2.2")
def _strange_password(t: Stage) -> None:
    """A password may hold any characters."""
    peer = t.connect(password=_STRANGE)
    t.auth(peer, _STRANGE)
    peer.say(t.welcome())
    t.opened(t.welcome()["world"])


@LOGIN.case("2.2.1")
def _named_world(t: Stage) -> None:
    """The world that the program asks for is named in auth."""
    peer = t.connect(world="reef")
    message = t.auth(peer)
    t.true(message.get("world") == "reef", "auth with the world reef", message)
    peer.say(t.welcome() | {"world": "reef"})
    t.opened("reef")


@LOGIN.case("2.2.2")
def _wrong_password(t: Stage) -> None:
    """A password that is refused, after a second, is told the program, and nothing more is sent."""
    peer = t.connect()
    t.auth(peer)
    t.waits(1.0)
    peer.say({"type": "error", "code": "auth_failed", "message": "wrong password", "command": "auth"})
    t.refused(t.hear("open"), "auth_failed", "wrong password")
    t.tell("close")
    rest = peer.rest()
    t.true(not rest, "nothing more after a password that was refused", rest)
    t.hear("close")


@LOGIN.case("4.error.world_not_found")
def _refused_world(t: Stage) -> None:
    """Whatever else an auth is refused for is told with its code."""
    peer = t.connect()
    t.auth(peer)
    peer.say({"type": "error", "code": "world_not_found", "message": "there is no such world", "command": "auth"})
    t.refused(t.hear("open"), "world_not_found", "there is no such world")


@LOGIN.case("2.2.1")
def _no_answer(t: Stage) -> None:
    """A server that hangs up without an answer to auth is a loss."""
    peer = t.connect()
    t.auth(peer)
    peer.close()
    t.lost(t.hear("open"))


COMING = Group(2, "frames that come")


@COMING.case("1.2.1")
def _every_split(t: Stage) -> None:
    """A reply may be split at any byte."""
    peer = t.enter()
    place = 1
    while True:
        command = t.ask(peer, {"type": "step"})
        data = frame(peer.reply(command, "stepped", frame=place, t=place / 60))
        peer.send(data[:place])
        time.sleep(_PAUSE)
        peer.send(data[place:])
        t.got({"frame": place})
        place += 1
        if place >= len(data):
            return


@COMING.case("1.2.1")
def _byte_by_byte(t: Stage) -> None:
    """Bytes may come one by one, from auth_success on."""
    peer = t.connect()
    t.auth(peer)
    for byte in frame(t.welcome()):
        peer.send(bytes([byte]))
        time.sleep(_PAUSE / 10)
    t.opened(t.welcome()["world"])
    command = t.ask(peer, {"type": "step"})
    for byte in frame(peer.reply(command, "stepped", frame=7, t=7 / 60)):
        peer.send(bytes([byte]))
        time.sleep(_PAUSE / 10)
    t.got({"frame": 7})


@COMING.case("1.1.2")
def _several_in_a_packet(t: Stage) -> None:
    """Several frames may come in one packet, the first of them with auth_success."""
    peer = t.connect()
    t.auth(peer)
    peer.say(t.welcome(), tick(1), tick(2))
    t.opened(t.welcome()["world"])
    command = t.ask(peer, {"type": "step"})
    peer.say(tick(3), peer.reply(command, "stepped", frame=3, t=3 / 60), tick(4))
    t.got({"frame": 3})
    t.events([tick(1), tick(2), tick(3), tick(4)])


@COMING.case("1.1.2")
def _half_a_frame_more(t: Stage) -> None:
    """A packet may end within the frame after a reply, at any of its bytes."""
    peer = t.enter()
    event = frame(tick(1))
    for place in range(1, len(event)):
        command = t.ask(peer, {"type": "ping"})
        peer.send(frame(peer.reply(command, "pong")) + event[:place])
        t.got({})
        command = t.ask(peer, {"type": "step"})
        peer.send(event[place:] + frame(peer.reply(command, "stepped", frame=place, t=place / 60)))
        t.got({"frame": place})


@COMING.case("1.1.3")
def _white_space(t: Stage) -> None:
    """White space around messages and empty frames are ignored."""
    peer = t.enter()
    command = t.ask(peer, {"type": "step"})
    reply = frame(peer.reply(command, "stepped", frame=5, t=5 / 60)).removesuffix(DELIMITER)
    peer.send(DELIMITER + b" \n" + DELIMITER + b"\r\n \t" + reply + b" \n" + DELIMITER + b"\n" + DELIMITER)
    t.got({"frame": 5})
    t.ping(peer)


@COMING.case("1.3.5")
def _split_characters(t: Stage) -> None:
    """A character of several bytes may come in pieces."""
    peer = t.enter()
    name = "\u00fc\u6f22\U0001f419"
    for place in range(1, len(name.encode())):
        command = t.ask(peer, {"type": "get_cube_list"})
        data = frame(peer.reply(command, "cube_list", cubes=[name]))
        at = data.index(name.encode()) + place
        peer.send(data[:at])
        time.sleep(_PAUSE)
        peer.send(data[at:])
        t.got({"cubes": [name]})


@COMING.case("1.2.2")
def _delimiter_in_a_name(t: Stage) -> None:
    """A string may hold the delimiter, its < written as an escape, and what only looks like it."""
    peer = t.enter()
    names = ["<???DONE???---", "???DONE???---", "a<b", "\\u003c", _STRANGE]
    command = t.ask(peer, {"type": "get_cube_list"})
    peer.answer(command, "cube_list", cubes=names)
    t.got({"cubes": names})
    t.ping(peer)


@COMING.case("1.4.7")
def _big_reply(t: Stage) -> None:
    """A reply may be as large as the names of 10,000 cubes, some megabytes."""
    peer = t.enter()
    names = [f"{number:05}{chr(0x6F22) * 123}" for number in range(10_000)]
    command = t.ask(peer, {"type": "get_cube_list"})
    peer.answer(command, "cube_list", cubes=names)
    t.got({"cubes": names})
    t.ping(peer)


@COMING.case("3.2.1")
def _unknown_fields(t: Stage) -> None:
    """Fields that the client does not know are ignored, in auth_success and in replies."""
    peer = t.connect()
    t.auth(peer)
    peer.say({"weather": {"rain": [1, None]}, **t.welcome()})
    t.opened(t.welcome()["world"])
    command = t.ask(peer, {"type": "step"})
    peer.answer(command, "stepped", novel=[{}], frame=5, t=5 / 60, ignored=["colour"])
    t.got({"frame": 5})


@COMING.case("1.3.1")
def _exact_numbers(t: Stage) -> None:
    """Numbers reach the program to the last bit."""
    peer = t.enter()
    command = t.ask(peer, {"type": "get_cube_state", "cube_name": "a"})
    rest = {"rotation": [0, 0, 0], "quaternion": [0, 0, 0, 1], "linear_velocity": [1e15, 5e-324, -0.1]}
    peer.answer(command, "cube_state", cube_name="a", position=_NUMBERS, angular_velocity=[0, 0, 0], **rest)
    t.got({"position": _NUMBERS, "linear_velocity": rest["linear_velocity"]})


GOING = Group(3, "frames that go")


@GOING.case("1.1.2")
def _left_out(t: Stage) -> None:
    """A command is a frame of what the program gave and an id, and nothing for what it left out."""
    peer = t.enter()
    replies = {"ping": {"kind": "pong"}, "spawn_cube": {"kind": "cube_list", "spawned": "a"}}
    for kind, reply in replies.items():
        command = t.ask(peer, {"type": kind})
        extra = {*command} - {"type", "id"}
        t.true(not extra, f"a command {kind} without fields", command)
        peer.answer(command, **reply)
        t.got({})


@GOING.case("1.2.2")
def _escaped_delimiter(t: Stage) -> None:
    """The < of strings is written as an escape, so that a name may hold the delimiter."""
    _arrives(t, {"type": "spawn_cube", "cube_name": "<???DONE???---"})


@GOING.case("1.3.5")
def _utf8(t: Stage) -> None:
    """Names of any characters arrive as they are."""
    _arrives(t, {"type": "spawn_cube", "cube_name": _STRANGE})


@GOING.case("1.3.1")
def _exact_numbers_out(t: Stage) -> None:
    """Numbers arrive to the last bit."""
    _arrives(t, {"type": "spawn_cube", "position": _NUMBERS, "mass": 0.1, "linear_velocity": [1e-300, -1 / 3, 1e4]})


@GOING.case("1.1.2")
def _zeros(t: Stage) -> None:
    """Zeros that the program gives are sent, as they may not be the default."""
    _arrives(t, {"type": "spawn_cube", "position": [0, 0, 0], "friction": 0, "restitution": 0})


@GOING.case("2.2.3")
def _distinct_ids(t: Stage) -> None:
    """Commands whose replies are awaited have different ids."""
    peer = t.enter()
    t.pipeline([{"type": "step"}] * 50)
    commands = [peer.command("step") for _ in range(50)]
    ids = [repr(command["id"]) for command in commands if "id" in command]
    t.true(len({*ids}) == len(ids), "50 different ids", ids)
    for number, command in enumerate(commands):
        peer.answer(command, "stepped", frame=number, t=number / 60)
    t.outcomes("pipeline", 50)


def _arrives(t: Stage, given: dict[str, object]) -> None:
    """Makes sure that a command arrives with all that was given."""
    peer = t.enter()
    command = t.ask(peer, given)
    if any(command.get(name) != value for name, value in given.items()):
        raise Finding(clip(given), clip(command), "a command that is not the program's")
    peer.answer(command, "cube_list", spawned=command.get("cube_name", "cube_1_0badcafe"), cubes=[])
    t.got({"spawned": command.get("cube_name", "cube_1_0badcafe")})
    t.ping(peer)
