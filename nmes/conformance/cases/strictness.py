"""Strict JSON: what is refused, and what must not be."""

from __future__ import annotations

from typing import Any

from nmes.conformance.case import Category, Row
from nmes.conformance.trial import Trial
from nmes.conformance.wire import frame_of
from nmes.protocol import DELIMITER

JSON = Category(4, "json")
case, table = JSON.case, JSON.table

REFUSED = [
    Row("nan", b'{"type":"ping","x":NaN}', clause="1.3.2"),
    Row("infinity", b'{"type":"ping","x":Infinity}', clause="1.3.2"),
    Row("minus-infinity", b'{"type":"ping","x":-Infinity}', clause="1.3.2"),
    Row("1e400", b'{"type":"ping","x":1e400}', clause="1.3.2"),
    Row("minus-1e400", b'{"type":"ping","x":-1e400}', clause="1.3.2"),
    Row("nan-deep-inside", b'{"type":"ping","x":[{"y":[NaN]}]}', clause="1.3.2"),
    Row("duplicate-key", b'{"type":"ping","type":"ping"}', clause="1.3.3"),
    Row("duplicate-key-inside", b'{"type":"ping","x":{"a":1,"a":1}}', clause="1.3.3"),
    Row("duplicate-key-escaped", b'{"type":"ping","x":{"a":1,"\\u0061":2}}', clause="1.3.3"),
    Row("lone-high-surrogate", b'{"type":"ping","id":"\\ud800"}', clause="1.3.4"),
    Row("lone-low-surrogate", b'{"type":"ping","id":"\\udc00x"}', clause="1.3.4"),
    Row("lone-surrogate-in-a-key", b'{"type":"ping","\\ud800":1}', clause="1.3.4"),
    Row("bytes-that-are-no-utf8", b'{"type":"ping","id":"\xff"}', clause="1.3.5"),
    Row("overlong-utf8", b'{"type":"ping","id":"\xc0\xaf"}', clause="1.3.5"),
    Row("surrogate-as-utf8", b'{"type":"ping","id":"\xed\xa0\x80"}', clause="1.3.5"),
    Row("cut-utf8", b'{"type":"ping","id":"\xe2\x82"}', clause="1.3.5"),
    Row("latin1", "{'type':'ping','id':'é'}".replace("'", '"').encode("latin-1"), clause="1.3.5"),
    Row("utf16", '{"type":"ping"}'.encode("utf-16"), clause="1.3.5"),
    Row("nested-201-deep", b'{"type":"ping","x":' + b"[" * 200 + b"]" * 200 + b"}", clause="1.3.6"),
    Row("nested-100000-deep", b'{"type":"ping","x":' + b"[" * 100_000 + b"]" * 100_000 + b"}", clause="1.3.6"),
    Row("objects-nested-300-deep", b'{"type":"ping","x":' + b'{"a":' * 300 + b"1" + b"}" * 300 + b"}", clause="1.3.6"),
    Row("trailing-comma", b'{"type":"ping",}'),
    Row("single-quotes", b"{'type':'ping'}"),
    Row("no-quotes", b'{type:"ping"}'),
    Row("comment", b'{"type":"ping"/* hello */}'),
    Row("line-comment", b'{"type":"ping"} // hello'),
    Row("two-objects", b'{"type":"ping"}{"type":"ping"}'),
    Row("rubbish-behind", b'{"type":"ping"}x'),
    Row("unfinished", b'{"type":"ping"'),
    Row("unfinished-string", b'{"type":"ping}'),
    Row("leading-zero", b'{"type":"ping","x":01}'),
    Row("plus-sign", b'{"type":"ping","x":+1}'),
    Row("bare-point", b'{"type":"ping","x":.5}'),
    Row("point-at-the-end", b'{"type":"ping","x":1.}'),
    Row("hexadecimal", b'{"type":"ping","x":0x10}'),
    Row("capital-true", b'{"type":"ping","x":True}'),
    Row("undefined", b'{"type":"ping","x":undefined}'),
    Row("bare-newline-in-a-string", b'{"type":"ping","id":"a\nb"}'),
    Row("bare-nul-in-a-string", b'{"type":"ping","id":"a\0b"}'),
    Row("unknown-escape", b'{"type":"ping","id":"\\x41"}'),
    Row("short-unicode-escape", b'{"type":"ping","id":"\\u12"}'),
    Row("byte-order-mark", b'\xef\xbb\xbf{"type":"ping"}'),
    Row("missing-colon", b'{"type" "ping"}'),
    Row("missing-value", b'{"type":}'),
    Row("nul-byte", b"\0"),
    Row("plain-text", b"hello"),
]


@table(1, "1.3.1", REFUSED)
def what_is_no_strict_json_is_refused(t: Trial, frame: bytes) -> None:
    """A frame that is not strict JSON gets bad_json or bad_frame, and the connection goes on."""
    wire = t.join()
    wire.send(frame + DELIMITER)
    t.error(wire.reply("an error"), {"bad_json", "bad_frame"})
    t.fence(wire)


@table(
    2,
    "4.error.bad_frame",
    [
        Row("list", b'[{"type":"ping"}]'),
        Row("string", b'"ping"'),
        Row("number", b"1"),
        Row("true", b"true"),
        Row("null", b"null"),
        Row("empty-list", b"[]"),
    ],
)
def what_is_no_object_is_refused(t: Trial, frame: bytes) -> None:
    """A frame that is JSON but no object gets bad_frame, and the connection goes on."""
    wire = t.join()
    wire.send(frame + DELIMITER)
    reply = t.error(wire.reply("an error"), {"bad_json", "bad_frame"})
    t.should(reply["code"] == "bad_frame", "code bad_frame", reply)
    t.fence(wire)


@table(
    3,
    "3.2.2",
    [
        Row(name, value)
        for name, value in {
            "zero": 0,
            "negative": -17,
            "fraction": 0.1,
            "large": 2**53 - 1,
            "true": True,
            "false": False,
            "null": None,
            "empty-text": "",
            "unicode": "żółć 漢字 🦎",
            "escapes": 'quote " backslash \\ tab \t newline \n nul \0',
            "list": [1, "two", None, [3.5]],
            "empty-list": [],
            "object": {"a": {"b": [True]}},
            "empty-object": {},
            "keys": {"": 1, "type": "x", "id": 2},
        }.items()
    ],
)
def any_json_is_an_id(t: Trial, value: Any) -> None:
    """Any JSON value is allowed as id and comes back as it was."""
    wire = t.join()
    reply = wire.ask({"type": "ping", "id": value})
    t.equal(reply["type"], "pong", "the reply")
    t.true(type(reply["id"]) is type(value) or type(value) is dict, f"an id of the kind of {value!r}", reply)


@table(4, "3.2.2", [Row("2**53+1", 2**53 + 1), Row("20-digits", 10**19 + 7), Row("-2**63", -(2**63))])
def long_integers_as_ids(t: Trial, value: int) -> None:
    """An integer that a double cannot hold comes back exactly, or is refused; it is never changed."""
    wire = t.join()
    wire.say({"type": "ping", "id": value})
    reply = wire.reply()
    if reply["type"] == "pong":
        t.should(reply.get("id") == value, f"id {value}", reply)
    else:
        t.error(reply, {"bad_json", "bad_frame", "invalid"})


@case(5, "3.2.2")
def no_id_no_id(t: Trial) -> None:
    """A command without an id gets a reply without one."""
    wire = t.join()
    wire.say({"type": "ping"})
    reply = wire.reply("pong")
    t.true("id" not in reply, "no id", reply)


@case(6, "1.3.6")
def nesting_that_is_allowed(t: Trial) -> None:
    """Nesting 200 deep is allowed: an id 199 deep inside the command comes back."""
    wire = t.join()
    deep = b"[" * 199 + b"]" * 199
    wire.send(b'{"type":"ping","id":' + deep + b"}" + DELIMITER)
    frame = wire.frame(what="pong").replace(b" ", b"")
    t.true(deep in frame, "the id 199 deep", frame)


@case(7, "1.3.1")
def escapes_are_characters(t: Trial) -> None:
    """Escaped characters mean what they stand for, in keys too."""
    wire = t.join()
    wire.send(b'{"\\u0074ype":"p\\u0069ng","id":"\\ud83e\\udd8e\\/"}' + DELIMITER)
    t.equal(wire.reply("pong").get("id"), "🦎/", "the id")


@case(8, "1.3.2")
def numbers_that_are_only_long(t: Trial) -> None:
    """Large and tiny numbers that a double can hold are read."""
    wire = t.join()
    wire.send(b'{"type":"ping","x":1.7e308,"y":5e-324,"z":-0.0,"n":1e-400,"id":1}' + DELIMITER)
    t.equal(wire.reply("pong").get("id"), 1, "the id")


@case(9, "3.2.1")
def unknown_fields_are_ignored(t: Trial) -> None:
    """Fields that are not known are ignored, whatever is in them; a server that tells which tells them all."""
    wire = t.join()
    command = {"type": "spawn_cube", "cube_name": t.name(), "position": t.at(), "flavour": {"deep": [1]}, "": None}
    reply = t.ask(wire, command, "cube_list")
    t.equal(reply.get("ignored", ["flavour", ""]), ["flavour", ""], "ignored")


@table(
    10,
    "3.3.1",
    [Row("nan", b"NaN"), Row("1e400", b"1e400"), Row("text", b'"heavy"'), Row("null", b"null")],
)
def what_is_refused_changes_nothing(t: Trial, mass: bytes) -> None:
    """A command with a number that is none spawns nothing."""
    wire = t.join()
    name = t.name()
    wire.send(frame_of({"type": "spawn_cube", "cube_name": name}).replace(b'"}', b'","mass":' + mass + b"}"))
    t.error(wire.reply("an error"), {"bad_json", "bad_frame", "invalid"})
    t.true(name not in t.cubes(wire), "no cube", name)


@case(11, "4.error.unknown_type")
def types_that_there_are_not(t: Trial) -> None:
    """A type that is not known gets unknown_type; one that is no string is invalid."""
    wire = t.join()
    for kind in ("fly", "", "PING", "ping ", "cube_list", "auth_success", "__class__"):
        t.refused(wire, {"type": kind}, "unknown_type")
    for value in (7, None, ["ping"], {"type": "ping"}, True):
        t.error(wire.ask({"type": value}), {"invalid", "unknown_type"})
    t.error(wire.ask({"type": "ping", "id": 1} | {"type": "fly"}), "unknown_type")
    wire.say({"id": 9})
    t.error(wire.reply("an error"), {"invalid", "unknown_type"})
