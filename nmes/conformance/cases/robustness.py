"""Robustness: after each bad input the server still serves, and nothing has changed."""

from __future__ import annotations

from collections.abc import Callable

from nmes.conformance.case import Category, Row
from nmes.conformance.trial import Trial
from nmes.conformance.wire import frame_of, read_message
from nmes.protocol import DELIMITER

ROBUSTNESS = Category(15, "robustness")
case, table = ROBUSTNESS.case, ROBUSTNESS.table

PING = frame_of({"type": "ping", "id": 1})


def still_serves(t: Trial, before: str) -> None:
    """Makes sure that the server serves a new connection, and that a cube from before is there."""
    t.sleep(0.1)  # until the server has noticed what became of the last one
    wire = t.join()
    t.fence(wire)
    t.true(before in t.cubes(wire), f"{before} still there", before)


BEGINNINGS: dict[str, bytes] = {
    "nothing": b"",
    "half-a-command": b'{"type":"spawn_cube","cube_na',
    "half-a-delimiter": PING[:-5],
    "zeros": b"\0" * 10_000,
    "ones": b"\xff" * 10_000,
    "brackets": b"[" * 100_000,
    "delimiters": DELIMITER * 10_000,
    "http": b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n",
    "tls": b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + bytes(range(256)),
    "a-frame-and-a-half": PING + PING[:9],
}


@table(1, "3.3.1", [Row(name, data) for name, data in BEGINNINGS.items()])
def breaking_off(t: Trial, data: bytes) -> None:
    """A client that breaks off in the middle hurts nobody."""
    before = t.base(t.join())
    wire = t.join()
    wire.send(data)
    wire.reset()
    still_serves(t, before)


@table(2, "3.3.1", [Row(name, data) for name, data in BEGINNINGS.items() if data])
def strange_first_bytes(t: Trial, data: bytes) -> None:
    """A client that says strange things before auth, and breaks off, hurts nobody."""
    before = t.base(t.join())
    wire = t.connect()
    wire.send(data)
    wire.reset()
    still_serves(t, before)


@table(3, "3.3.1", [Row(str(n), n) for n in range(4)])
def random_bytes(t: Trial, number: int) -> None:
    """Frames of random bytes each get an error, and the connection goes on."""
    before = t.base(t.join())
    wire = t.join()
    sent = 0
    for _ in range(100):
        frame = t.random.randbytes(t.random.randint(1, 60)).replace(b"<", b"-")
        if frame.strip(b" \t\r\n"):
            wire.send(frame + DELIMITER)
            sent += 1
    for _ in range(sent):
        t.error(wire.reply("an error"), {"bad_json", "bad_frame"})
    t.fence(wire)
    still_serves(t, before)


@table(4, "3.3.1", [Row(str(n), n) for n in range(4)])
def mutilated_commands(t: Trial, number: int) -> None:
    """Commands with a byte changed are answered, one answer each, and the connection goes on."""
    before = t.base(t.join())
    wire = t.join()
    good = frame_of({"type": "get_cube_info", "cube_name": before, "id": {"a": [1, None]}})[: -len(DELIMITER)]
    frames = []
    for _ in range(100):
        changed = bytearray(good)
        changed[t.random.randrange(len(changed))] = t.random.choice(b'\x00\x7f\xff{}[]",:0123456789aeE+-. \\')
        frames.append(bytes(changed))
    wire.send(b"".join(frame + DELIMITER for frame in frames))
    for frame in frames:
        reply = read_message(wire.frame(what=f"an answer to {frame!r}"))
        t.true(reply["type"] in ("error", "cube_info", "pong"), "an error or an answer", reply)
    t.fence(wire)
    still_serves(t, before)


@case(5, "3.3.1")
def cut_commands(t: Trial) -> None:
    """A command cut off anywhere gets an error, and the connection goes on."""
    wire = t.join()
    good = frame_of({"type": "ping", "id": [1, {"a": "bc"}]})[: -len(DELIMITER)]
    for length in range(1, len(good)):
        wire.send(good[:length] + DELIMITER)
        t.error(wire.reply(f"an error to {good[:length]!r}"), {"bad_json", "bad_frame"})
    t.fence(wire)


@case(6, "3.3.1")
def coming_and_going(t: Trial) -> None:
    """A hundred connections that come and go at once leave the server as it was."""
    before = t.base(t.join())
    for n in range(100):
        wire = t.connect()
        if n % 3 == 1:
            wire.send(t.target.password.encode()[:3])
        if n % 3 == 2:
            wire.say({"type": "auth", "password": t.target.password})
        wire.reset()
    still_serves(t, before)


def tall(depth: int) -> bytes:
    """Returns a command with deeply nested content."""
    return b'{"type":"ping","id":' + b'{"a":[' * depth + b"1" + b"]}" * depth + b"}"


DEMANDS: dict[str, Callable[[], bytes]] = {
    "a-long-name": lambda: b'{"type":"get_cube_info","cube_name":"' + b"x" * 900_000 + b'"}',
    "a-long-type": lambda: b'{"type":"' + b"x" * 900_000 + b'"}',
    "many-fields": lambda: b'{"type":"fly"' + b"".join(b',"k%d":1' % n for n in range(50_000)) + b"}",
    "a-long-list": lambda: b'{"type":"spawn_cube","position":[' + b"1," * 200_000 + b"1]}",
    "a-long-number": lambda: b'{"type":"spawn_cube","mass":' + b"9" * 100_000 + b"}",
    "a-precise-number": lambda: b'{"type":"spawn_cube","mass":-0.' + b"1" * 100_000 + b"}",
    "a-large-exponent": lambda: b'{"type":"spawn_cube","mass":1e999999999}',
    "deep-objects": lambda: tall(30_000),
    "a-list-of-types": lambda: b'{"type":["ping","ping"]}',
    "many-escapes": lambda: b'{"type":"' + b"\\u0041" * 100_000 + b'"}',
}


@table(7, "3.3.1", [Row(name, demand) for name, demand in DEMANDS.items()])
def unreasonable_commands(t: Trial, demand: Callable[[], bytes]) -> None:
    """An unreasonable command gets an error soon, and the connection goes on."""
    before = t.base(t.join())
    wire = t.join()
    wire.send(demand() + DELIMITER)
    reply = wire.reply("an error")
    t.equal(reply["type"], "error", "the reply")
    t.fence(wire)
    still_serves(t, before)


@case(8, "2.2.3")
def ten_thousand_pings(t: Trial) -> None:
    """Ten thousand pings in one write are answered."""
    wire = t.join()
    wire.send(b"".join(frame_of({"type": "ping", "id": n}) for n in range(10_000)))
    for n in range(10_000):
        if wire.reply("pong")["id"] != n:
            t.equal(n, None, f"pong {n}")
    t.fence(wire)


@case(9, "3.3.1")
def many_cubes_come_and_go(t: Trial) -> None:
    """Three hundred cubes come and go in one write, and none is left."""
    wire = t.join()
    before = len(t.cubes(wire))
    names = [t.name() for _ in range(300)]
    for n, name in enumerate(names):  # apart, for a crowd in one place is another matter
        wire.say({"type": "spawn_cube", "cube_name": name, "position": t.at(y=1000 + 2 * n), "list": False})
    for name in names:
        wire.say({"type": "despawn_cube", "cube_name": name})
    types = [wire.reply("a reply")["type"] for _ in range(600)]
    t.equal(types, ["cube_list"] * 300 + ["cube_despawned"] * 300, "the replies")
    t.true(not set(names) & set(t.cubes(wire)), "none of them left", before)


@case(10, "3.3.1")
def a_client_that_leaves_its_last_words(t: Trial) -> None:
    """What a client said before it hung up is done."""
    wire, witness = t.join(), t.join()
    names = [t.name() for _ in range(20)]
    cube = {"type": "spawn_cube", "list": False}
    wire.say(*({**cube, "cube_name": name, "position": t.at(y=3 + 2 * n)} for n, name in enumerate(names)))
    wire.hang_up()
    replies = wire.rest()
    if wire.half_closes:
        t.equal(len(replies), 20, "the replies before the end")
    t.true(set(names) <= set(t.cubes(witness)), "all of the cubes", names)


@case(11, "3.3.1")
def reading_slowly(t: Trial) -> None:
    """A client that reads its replies late gets all of them."""
    wire = t.join()
    wire.say(*({"type": "ping", "id": f"{n}{'x' * 1000}"} for n in range(500)))
    t.sleep(1.0)
    for n in range(500):
        t.true(wire.reply("pong")["id"].startswith(f"{n}x"), f"pong {n}", n)
