"""Framing: how bytes become messages."""

from __future__ import annotations

from nmes.conformance.case import Category, Level, NotTried, Row
from nmes.conformance.trial import Trial
from nmes.conformance.wire import frame_of
from nmes.protocol import DELIMITER

FRAMING = Category(1, "framing")
case, table = FRAMING.case, FRAMING.table

WHITE = {"newline": b"\n", "carriage-return": b"\r\n", "spaces": b"   ", "tab": b"\t"}

_APART = 0.005  # s between pieces, so that a server most likely reads each by itself


@case(1, "1.1.2")
def replies_end_with_the_delimiter(t: Trial) -> None:
    """A reply is a JSON object followed by the 14 bytes of the delimiter."""
    wire = t.join()
    t.equal(wire.ask({"type": "ping"})["type"], "pong", "the reply to ping")


@table(
    2,
    "1.1.3",
    [Row(f"{name}-{where}", (white, where)) for name, white in WHITE.items() for where in ("before", "after")],
)
def white_space_is_ignored(t: Trial, how: tuple[bytes, str]) -> None:
    """White space around a message is ignored."""
    white, where = how
    wire = t.join()
    ping = b'{"type":"ping","id":1}'
    wire.send((white + ping if where == "before" else ping + white) + DELIMITER)
    t.equal(wire.reply("pong"), {"type": "pong", "id": 1}, "the reply")
    t.fence(wire)


@table(
    3,
    "1.1.3",
    [Row("one", DELIMITER), Row("many", DELIMITER * 50), Row("only-white-space", b" \n\t" + DELIMITER + b"\r\n")],
)
def empty_frames_are_ignored(t: Trial, empty: bytes) -> None:
    """An empty frame is ignored: no reply, no error."""
    wire = t.join()
    wire.send(empty)
    t.fence(wire)
    wire.send(empty)
    t.fence(wire)


@case(4, "1.1.3")
def white_space_inside_json_is_allowed(t: Trial) -> None:
    """White space within a message is JSON's own."""
    wire = t.join()
    wire.send(b'{ "type" :\n\t"ping" ,\r\n "id" : 7 }' + DELIMITER)
    t.equal(wire.reply("pong"), {"type": "pong", "id": 7}, "the reply")


@case(5, "1.2.1")
def one_byte_at_a_time(t: Trial) -> None:
    """A message that comes byte by byte is the same message."""
    wire = t.join()
    for byte in frame_of({"type": "ping", "id": "slow"}):
        wire.quiet(_APART)
        wire.send(bytes([byte]))
    t.equal(wire.reply("pong").get("id"), "slow", "the id of the reply")


@case(6, "1.2.1")
def the_delimiter_in_two_pieces(t: Trial) -> None:
    """A delimiter that comes in two pieces, cut anywhere, is a delimiter."""
    wire = t.join()
    for cut in range(1, len(DELIMITER)):
        whole = frame_of({"type": "ping", "id": cut})
        wire.send(whole[: cut - len(DELIMITER)])
        wire.quiet(_APART)
        wire.send(whole[cut - len(DELIMITER) :])
        t.equal(wire.reply("pong").get("id"), cut, f"the id of the reply with the delimiter cut after {cut} bytes")


@case(7, "1.2.1")
def many_messages_in_one_write(t: Trial) -> None:
    """A thousand messages in one write get a thousand replies, in order."""
    wire = t.join()
    wire.say(*({"type": "ping", "id": n} for n in range(1000)))
    for n in range(1000):
        t.equal(wire.reply(f"pong {n}").get("id"), n, "the id of the next reply")
    t.fence(wire)


@case(8, "1.2.1")
def two_and_a_half_messages(t: Trial) -> None:
    """What is left of a write is the beginning of the next message."""
    wire = t.join()
    frames = b"".join(frame_of({"type": "ping", "id": n}) for n in range(3))
    wire.send(frames[:-20])
    t.equal([wire.reply("pong").get("id") for _ in range(2)], [0, 1], "the ids of the first replies")
    wire.send(frames[-20:])
    t.equal(wire.reply("pong").get("id"), 2, "the id of the last reply")


@table(
    9,
    "1.2.1",
    [Row(str(length), DELIMITER[:length]) for length in (1, 5, 10, 13)],
)
def a_part_of_the_delimiter_is_content(t: Trial, part: bytes) -> None:
    """The beginning of a delimiter inside a string is part of the string."""
    wire = t.join()
    text = part.decode() + "x"
    wire.send(b'{"type":"ping","id":"' + text.encode() + b'"}' + DELIMITER)
    t.equal(wire.reply("pong").get("id"), text, "the id of the reply")
    t.fence(wire)


@case(10, "1.2.1")
def almost_a_delimiter_before_one(t: Trial) -> None:
    """A delimiter right after the beginning of one is found."""
    wire = t.join()
    wire.send(b'{"type":"ping","id":1}' + DELIMITER[:8] + DELIMITER)
    t.error(wire.reply("an error"), {"bad_json", "bad_frame"})
    t.fence(wire)


@case(11, "1.2.2")
def a_delimiter_inside_a_string_splits(t: Trial) -> None:
    """A delimiter inside a string splits the frame: two parse errors, and the connection goes on."""
    wire = t.join()
    wire.send(b'{"type":"ping","id":"' + DELIMITER + b'"}' + DELIMITER)
    t.error(wire.reply("an error for the first half"), {"bad_json", "bad_frame"})
    t.error(wire.reply("an error for the second half"), {"bad_json", "bad_frame"})
    t.fence(wire)


@case(12, "1.2.2")
def the_delimiter_escaped_comes_back(t: Trial) -> None:
    """An id that holds the delimiter, its < escaped, comes back whole."""
    wire = t.join()
    text = DELIMITER.decode()
    wire.send(b'{"type":"ping","id":"' + DELIMITER.replace(b"<", b"\\u003c") + b'"}' + DELIMITER)
    t.equal(wire.reply("pong").get("id"), text, "the id of the reply")
    t.fence(wire)


@case(13, "1.2.2", level=Level.SHOULD)
def less_than_is_escaped_in_replies(t: Trial) -> None:
    """A server escapes < in every string that it sends."""
    wire = t.join()
    wire.say({"type": "ping", "id": "a<b"})
    frame = wire.frame(what="pong")
    t.true(b"<" not in frame, "no bare < in the reply", frame)


@case(14, "1.2.2")
def an_error_that_repeats_the_delimiter(t: Trial) -> None:
    """An error about a value that holds the delimiter is one frame."""
    wire = t.join()
    for type_ in ("<???DONE???---", "a<???DONE???---b"):
        t.refused(wire, {"type": type_}, "unknown_type")
    t.fence(wire)


@case(15, "1.2.1")
def messages_right_behind_auth(t: Trial) -> None:
    """Commands in the same write as auth are executed after it."""
    wire = t.connect()
    wire.say({"type": "auth", "password": t.target.password}, *({"type": "ping", "id": n} for n in range(3)))
    t.equal(wire.hear(what="auth_success")["type"], "auth_success", "the first reply")
    t.equal([wire.reply("pong").get("id") for _ in range(3)], [0, 1, 2], "the ids of the replies")


@case(16, "1.1.3")
def white_space_around_auth(t: Trial) -> None:
    """White space and empty frames before auth are ignored."""
    wire = t.connect()
    wire.send(b"\r\n" + DELIMITER + b"\n")
    wire.say({"type": "auth", "password": t.target.password})
    t.equal(wire.hear(what="auth_success")["type"], "auth_success", "the reply")


@case(17, "1.2.1")
def the_end_after_the_last_message(t: Trial) -> None:
    """A client that half-closes its socket gets the replies to all it said."""
    wire = t.join()
    if not wire.half_closes:
        raise NotTried("a WebSocket is closed as a whole")
    wire.say(*({"type": "ping", "id": n} for n in range(50)))
    wire.hang_up()
    t.equal(len(wire.rest()), 50, "the number of replies before the end")


@case(18, "1.2.1")
def an_unfinished_message_is_not_obeyed(t: Trial) -> None:
    """A message without its delimiter, cut off by the end of the connection, is not executed."""
    wire, other = t.join(), t.join()
    name = t.name()
    wire.send(frame_of({"type": "spawn_cube", "cube_name": name, "position": t.at()})[: -len(DELIMITER)])
    wire.hang_up()
    t.equal(wire.rest(), [], "replies to half a message")
    t.true(name not in t.cubes(other), "no cube", name)


@case(19, "1.1.2")
def a_long_message(t: Trial) -> None:
    """A message of 500 KB is read, and its long id comes back."""
    wire = t.join()
    text = "x" * 500_000
    wire.say({"type": "ping", "id": text})
    reply = wire.reply("pong")
    t.true(reply.get("id") == text, "the same id of 500,000 characters", reply)


@case(20, "1.2.1")
def replies_while_a_message_is_on_its_way(t: Trial) -> None:
    """A reply does not wait for the message that has only begun to come."""
    wire = t.join()
    wire.send(frame_of({"type": "ping", "id": 1}) + b'{"type":')
    t.equal(wire.reply("pong").get("id"), 1, "the id of the first reply")
    wire.send(b'"ping","id":2}' + DELIMITER)
    t.equal(wire.reply("pong").get("id"), 2, "the id of the second reply")
