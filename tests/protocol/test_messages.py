"""One message of the protocol: strictness and schemas; laws as property tests, cases as examples."""

from __future__ import annotations

import copy
import json
import math
from typing import Any

import jsonschema
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from creatures import snake
from nmes import protocol, schemas
from nmes.errors import RejectedMessage, WorldError
from nmes.protocol import (
    COMMANDS,
    DELIMITER,
    NO_ID,
    decode,
    encode,
    parse,
)

PING = b'{"type":"ping"}'

json_values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(10**30), 10**30)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(exclude_categories=["Cs"]))
    | st.just(DELIMITER.decode()),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(st.characters(exclude_categories=["Cs"])), inner)
    ),
    max_leaves=8,
)


def code(raw: bytes) -> str | None:
    """The code of the error with which a frame is refused."""
    request = parse(raw)
    assert (request.command is None) != (request.error is None)
    return None if request.error is None else request.error.code


def blame(command: dict[str, Any]) -> tuple[str, str | None]:
    """Code and field of the error with which a command is refused."""
    error = parse(encode(command)).error
    assert error is not None
    return error.code, error.path


def test_the_largest_brain_is_no_message_of_too_many_keys() -> None:
    nodes = [{"id": f"n{i}", "activation": "tanh", "bias": 0.5} for i in range(1024)]
    links = [{"from": f"n{i % 1024}", "to": f"n{i // 16}", "weight": 0.5} for i in range(16_384)]
    genome = {**snake(), "brain": {"kind": "graph", "nodes": nodes, "links": links}}
    assert code(encode({"type": "spawn_creature", "genome": genome})) is None


# -- laws -------------------------------------------------------------------------------------------------------------


@given(json_values, json_values)
def test_encoded_messages_parse_to_the_same_and_never_hold_a_delimiter(identity: Any, extra: Any) -> None:
    command = {"type": "ping", "id": identity, "extra": extra}
    raw = encode(command)
    assert b"<" not in raw
    request = parse(raw)
    assert request.command == command and request.error is None
    assert request.raw == raw and request.type == "ping" and request.id == identity
    assert decode(raw) == command == json.loads(raw)
    assert protocol.request_from(command).command == command


@given(st.data())
def test_validity_is_what_the_reference_implementation_of_json_schema_says(data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(sorted(COMMANDS.keys() - {"batch"})))
    command = copy.deepcopy(COMMANDS[name].schema["examples"][0])
    # Anything anywhere, and often a number near a bound.
    bounds = st.sampled_from([-1e15, -1e6, -1e5, 0, 1e-6, 1e-3, 1, 10, 1000, 10_000, 1e5, 1e6, 1e9, 1e15, 2**53, 2**63])
    near = st.builds(lambda bound, step: bound * (1 + step), bounds, st.sampled_from([0, -1e-12, 1e-12, -0.5, 1e-3]))
    value = data.draw(json_values | near | st.lists(near, min_size=2, max_size=4) | bounds.map(int))
    field = data.draw(st.sampled_from(sorted(COMMANDS[name].schema["properties"].keys() - {"type"})))
    old = command.get(field)
    if isinstance(old, list) and old and data.draw(st.booleans()):
        old[data.draw(st.integers(0, len(old) - 1))] = value
    else:
        command[field] = value
    if any(isinstance(item, str) and item.endswith("\n") for item in (value, *(value if type(value) is list else ()))):
        return  # Python's `$` also matches before a last newline; the standard's does not
    expected = jsonschema.Draft202012Validator(COMMANDS[name].schema).is_valid(command)
    request = parse(encode(command))
    assert (request.error is None) == expected, request.error
    if request.error is not None:
        assert request.error.code == "invalid"
        assert request.error.path is not None and request.error.path.split("/")[0] == field
        assert request.error.message.startswith(f"{request.error.path}: ")
        assert len(request.error.message) < 500


@given(st.binary() | st.text().map(str.encode) | json_values.map(encode))
@example(b"")
@example(b"\xef\xbb\xbf" + PING)
@example(b'{"type":{"type":[]}}')
@example(b'{"type":"batch","commands":[1]}')
@example(b'{"type":"batch","commands":[{"type":["batch"]}]}')
@example(b"[" * 100_000)
@example(b'{"a":' * 100_000)
def test_no_bytes_make_parse_raise(raw: bytes) -> None:
    request = parse(raw)
    assert (request.command is None) != (request.error is None)
    if request.error is not None:
        assert request.error.code in protocol.ERROR_CODES
        assert len(request.error.message) < 500
        encode(protocol.error_reply(request.error, request.type))


# -- strict JSON ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "number", ["1e400", "-1e400", "1E+0400", "1e0000000400", "9" * 400, "0." + "9" * 4, "9" * 5000]
)
@pytest.mark.parametrize(
    "frame",
    [
        '{"type":"ping","unknown":%s}',
        '{"type":"ping","id":%s}',
        '{"type":"ping","a":{"b":[[{"c":%s}]]}}',
        '{"type":"apply_force","force":[0,%s,0]}',
        '{"type":"spawn_cube","mass":%s}',
        '{"type":"batch","commands":[{"type":"ping","x":%s}]}',
    ],
)
def test_no_number_is_infinite_as_a_double(frame: str, number: str) -> None:
    request = parse((frame % number).encode())
    if number.startswith("0."):
        assert request.error is None
    else:
        assert request.error is not None and request.error.code == "bad_json"


def test_a_long_whole_number_is_kept_exactly_where_it_is_allowed() -> None:
    long = int("7" * 300)
    raw = b'{"type":"ping","id":%d}' % long
    request = parse(raw)
    assert request.id == long
    assert encode({"id": request.id}) == b'{"id":%d}' % long
    assert blame({"type": "spawn_cube", "mass": long}) == ("invalid", "mass")
    assert blame({"type": "step", "ticks": long}) == ("invalid", "ticks")


@pytest.mark.parametrize(
    "text",
    [
        "NaN", "Infinity", "-Infinity", "01", "1.", ".5", "+1", "-", "0x10", "1e", "'a'", "tru", "[1,]", '{"a":1,}',
        "{a:1}",
        '"\x01"', r'"\x41"', r'"\u12"', "// comment", '{"a":1,"a":2}', r'{"a":1,"\u0061":2}', '{"b":[{"a":1,"a":1}]}',
        r'"\ud800"', r'"\udc00"', r'"\ud800x"', r'"\ud800\u0041"', r'{"\ud800":1}', "1 2", "",
    ],
)  # fmt: skip
def test_json_is_strict(text: str) -> None:
    assert code(b'{"type":"ping","x":%s}' % text.encode()) == "bad_json"


@pytest.mark.parametrize(
    "text", [r'"\ud83d\ude00"', '"\x7f"', r'"\u0000"', "-0", "1E5", "1e-400", '"\\t"', " [ [ ],{}]\t"]
)
def test_unusual_but_valid_json_is_accepted(text: str) -> None:
    assert code(b'{"type":"ping","x":%s}' % text.encode()) is None


def test_a_duplicate_type_is_refused() -> None:
    assert code(b'{"type":"ping","type":"spawn_cube","mass":-1}') == "bad_json"


@pytest.mark.parametrize("broken", [b"\xff", b"\xc0\xaf", b"\xed\xa0\x80", b"\xf5\x80\x80\x80", b"\xe2\x82"])
@pytest.mark.parametrize("frame", [b'{"type":"ping","x":"%s"}', b'{"%s":1}', b'{"type":"ping"}%s', b"%s"])
def test_invalid_utf_8_is_a_bad_frame(frame: bytes, broken: bytes) -> None:
    assert code(frame % broken) == "bad_frame"


@pytest.mark.parametrize("raw", [b"[]", b'"ping"', b"1", b"null", b"true", b'[{"type":"ping"}]'])
def test_json_that_is_no_object_is_a_bad_frame(raw: bytes) -> None:
    assert code(raw) == "bad_frame"


@pytest.mark.parametrize(
    ("opening", "innermost", "closing"),
    [(b"[", b"[]", b"]"), (b"[", b"[1]", b"]"), (b'{"a":', b"{}", b"}"), (b'{"a":', b'{"a":1}', b"}")],
)
def test_nesting_of_200_is_read_and_of_201_is_not(opening: bytes, innermost: bytes, closing: bytes) -> None:
    def nested(depth: int) -> bytes:
        between = depth - 2  # beside the message itself and the innermost
        return b'{"type":"ping","id":' + opening * between + innermost + closing * between + b"}"

    request = parse(nested(200))
    assert request.error is None
    assert encode({"type": "pong", "id": request.id}).count(opening[:1]) >= 199
    assert encode({"type": "batch_result", "results": [{"type": "pong", "id": request.id}]})
    assert code(nested(201)) == code(nested(202)) == code(nested(5000)) == "bad_json"


def test_wide_messages_are_not_refused_as_deep() -> None:
    assert code(b'{"type":"ping","x":[' + b"[]," * 5000 + b'"' + b"[" * 500 + b'"]}') is None


def test_an_error_message_repeats_little_of_what_came() -> None:
    for raw in (
        b'{"%s":1,"%s":2}' % (b"k" * 9999, b"k" * 9999),
        b'{"type":"%s"}' % (b"k" * 9999),
        b'{"type":"spawn_cube","mass":"%s"}' % (b"k" * 9999),
        b'{"type":"spawn_cube","cube_name":"%s"}' % (b"\xf0\x9f\x98\x80" * 9999),
    ):
        error = parse(raw).error
        assert error is not None and len(error.message) < 300


# -- schemas ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", COMMANDS)
def test_the_example_of_each_command_is_valid(name: str) -> None:
    command = COMMANDS[name].schema["examples"][0]
    request = parse(encode(command))
    assert request.command == command and request.type == name and request.id is NO_ID


@pytest.mark.parametrize(("name", "field"), [(n, f) for n, c in COMMANDS.items() for f in c.schema["required"][1:]])
def test_a_missing_field_is_named(name: str, field: str) -> None:
    command = {**COMMANDS[name].schema["examples"][0], "id": None}
    del command[field]
    request = parse(encode(command))
    assert request.error is not None
    assert (request.error.code, request.error.path) == ("invalid", field)
    assert request.error.message.startswith(f"{field}: is missing; expected ")
    assert request.type == name and request.id is None


@pytest.mark.parametrize(
    ("command", "field", "message"),
    [
        ({"type": "spawn_cube", "mass": 0}, "mass", "mass: expected a number from 0.000001 to 1,000,000,000 kg, got 0"),
        ({"type": "spawn_cube", "mass": 0, "position": [0, "x", 0]}, "position/1", None),
        ({"type": "spawn_cube", "color": [0, 0, 9], "mass": 0}, "color/2", None),
        ({"type": "spawn_cube", "mass": True}, "mass", None),
        ({"type": "spawn_cube", "mass": "1"}, "mass", None),
        ({"type": "spawn_cube", "mass": None}, "mass", None),
        (
            {"type": "spawn_cube", "position": [0, "x", 0]},
            "position/1",
            'position/1: expected a number from -1,000,000 to 1,000,000 m, got "x"',
        ),
        ({"type": "spawn_cube", "position": [0, 1]}, "position", None),
        ({"type": "spawn_cube", "position": {"x": 0, "y": 1, "z": 0}}, "position", None),
        ({"type": "spawn_cube", "position": [0, 1000000.0000001, 0]}, "position/1", None),
        ({"type": "spawn_cube", "size": [1, 0, 1]}, "size", None),
        ({"type": "spawn_cube", "color": [0, 0.5, 1, 1.01]}, "color/3", None),
        ({"type": "spawn_cube", "color": [0, 0, 0, 0, 0]}, "color", None),
        ({"type": "spawn_cube", "rotation": [0, 0, 0, 0]}, "rotation", None),
        ({"type": "spawn_cube", "rotation": [0, 0]}, "rotation", None),
        ({"type": "spawn_cube", "cube_name": ""}, "cube_name", None),
        ({"type": "spawn_cube", "cube_name": "a b"}, "cube_name", None),
        ({"type": "spawn_cube", "cube_name": "a\n"}, "cube_name", None),
        ({"type": "spawn_cube", "cube_name": "a\u200bb"}, "cube_name", None),
        ({"type": "spawn_cube", "cube_name": "a" * 129}, "cube_name", None),
        ({"type": "spawn_cube", "cube_name": "a" * 124, "is_base": True}, "cube_name", None),
        ({"type": "spawn_cube", "is_base": 1}, "is_base", "is_base: expected true or false, got 1"),
        (
            {"type": "create_joint", "cube1": "a", "cube2": "b", "joint_type": "weld"},
            "joint_type",
            'joint_type: expected one of "fixed", "hinge", "slide", "slider", "pin", "conetwist", got "weld"',
        ),
        (
            {"type": "create_joint", "cube1": "a", "cube2": "b", "joint_type": "hinge", "axis": [0, 0, 0.0]},
            "axis",
            None,
        ),
        ({"type": "set_joint_param", "joint_name": "j", "param_name": "damping", "value": -1}, "value", None),
        ({"type": "set_joint_param", "joint_name": "j", "param_name": "limit_enabled", "value": 1}, "value", None),
        ({"type": "set_joint_param", "joint_name": "j", "param_name": "target_position", "value": True}, "value", None),
        ({"type": "set_joint_param", "joint_name": "j", "param_name": "target_position", "value": 2e6}, "value", None),
        ({"type": "set_joint_param", "joint_name": "j", "param_name": "colour", "value": 1}, "param_name", None),
        ({"type": "step", "ticks": 0}, "ticks", "ticks: expected a whole number from 1 to 10,000 ticks, got 0"),
        ({"type": "step", "ticks": 1.5}, "ticks", None),
        ({"type": "reset", "seed": 2**63}, "seed", None),
        ({"type": "subscribe", "events": ["tick", "tock"]}, "events/1", None),
        ({"type": "subscribe", "events": []}, "events", None),
        ({"type": "subscribe", "events": ["tick", "tick"]}, "events", None),
        ({"type": "get_world_state", "cubes": ["a", 7]}, "cubes/1", None),
        ({"type": "batch", "commands": {"type": "ping"}}, "commands", None),
        ({"type": "batch", "commands": ["ping"]}, "commands/0", None),
        ({"type": "batch", "commands": [{"type": "ping"}, {}]}, "commands/1/type", None),
        ({"type": "batch", "commands": [{"type": "ping"}, {"type": 1}]}, "commands/1/type", None),
        ({"type": "batch", "commands": [{"type": "batch", "commands": []}]}, "commands/0/type", None),
        (
            {"type": "batch", "commands": [{"type": "ping"}, {"type": "apply_force", "force": [0, 0, "x"]}]},
            "commands/1/force/2",
            None,
        ),
        ({"type": "batch", "commands": [{"type": "apply_force"}]}, "commands/0/force", None),
        ({"type": None}, "type", "type: expected a string, got null"),
        ({"type": ["ping"]}, "type", None),
        ({"no": "type"}, "type", "type: is missing"),
    ],
)
def test_an_ill_typed_field_is_named(command: dict[str, Any], field: str, message: str | None) -> None:
    assert blame(command) == ("invalid", field)
    error = parse(encode(command)).error
    assert error is not None and (message is None or error.message == message)


@pytest.mark.parametrize("kind", ["fly", "", "PING", "pong", "auth", "ping ", "spawn_creatures"])
def test_unknown_types_are_refused(kind: str) -> None:
    request = parse(encode({"type": kind, "id": 3}))
    assert request.error is not None and request.error.code == "unknown_type" and request.error.path == "type"
    assert request.type == kind and request.id == 3
    assert blame({"type": "batch", "commands": [{"type": kind}]}) == ("unknown_type", "commands/0/type")


def test_unknown_types_that_are_nearly_right_get_a_hint() -> None:
    error = parse(b'{"type":"spawn_cubes"}').error
    assert error is not None and error.message == 'there is no command "spawn_cubes"; did you mean spawn_cube?'


def test_whole_numbers_are_ints_even_when_written_as_1_0() -> None:
    command = parse(b'{"type":"batch","commands":[{"type":"step","ticks":3.0},{"type":"step","ticks":2}]}').command
    assert command is not None
    assert [type(inner["ticks"]) for inner in command["commands"]] == [int, int]


def test_names_of_all_scripts_are_allowed() -> None:
    for name in ("cube_1_0badcafe", "würfel", "立方体", "😀", "a" * 128, "<???DONE???---"):
        assert code(encode({"type": "despawn_cube", "cube_name": name})) is None


def test_commands_from_python_are_validated_like_those_from_sockets() -> None:
    request = protocol.request_from({"type": "apply_force", "force": np.array([0.0, 1.5, 0.0]), "id": ("a", 1)})
    assert request.command == {"type": "apply_force", "force": [0.0, 1.5, 0.0], "id": ["a", 1]}
    circular: list[Any] = []
    circular.append(circular)
    for impossible in (object(), "\ud800", circular, {1, 2}):
        error = protocol.request_from({"type": "ping", "id": impossible}).error
        assert error is not None and error.code == "bad_json"
    error = protocol.request_from({"type": "spawn_cube", "mass": math.nan}).error
    assert error is not None and (error.code, error.path) == ("invalid", "mass")


def test_defaults_are_filled_in() -> None:
    assert COMMANDS["spawn_cube"].defaults["position"] == [0, 1, 0]
    assert COMMANDS["subscribe"].defaults["every"] == 1


# -- other messages ---------------------------------------------------------------------------------------------------


def test_an_error_reply_has_the_fields_that_are_known() -> None:
    error = RejectedMessage("invalid", "mass: no", "mass")
    assert protocol.error_reply(error, "spawn_cube") == {
        "type": "error", "code": "invalid", "message": "mass: no", "command": "spawn_cube", "field": "mass",
    }  # fmt: skip
    bare = protocol.error_reply(WorldError("internal", "oh"))
    assert bare == {"type": "error", "code": "internal", "message": "oh"}
    protocol.validate_reply(bare)


@pytest.mark.parametrize("name", protocol.REPLIES)
def test_replies_are_checked_for_what_they_must_hold(name: str) -> None:
    schema = protocol.REPLIES[name].schema
    reply = schema["examples"][0]
    protocol.validate_reply({**reply, "id": [1], "another": "field"})
    for field in schema["required"]:
        with pytest.raises(RejectedMessage):
            protocol.validate_reply({key: value for key, value in reply.items() if key != field})


def test_replies_inside_a_batch_are_checked_and_nan_is_no_number() -> None:
    good = {"type": "stepped", "frame": 1, "t": 0.5}
    protocol.validate_reply({"type": "batch_result", "results": [good]})
    with pytest.raises(RejectedMessage) as caught:
        protocol.validate_reply(
            {"type": "batch_result", "results": [good, {"type": "stepped", "frame": 1, "t": math.nan}]}
        )
    assert caught.value.path == "results/1/t"


def test_events_are_checked() -> None:
    protocol.validate_event({"type": "tick", "t": 0.5, "frame": 30})
    with pytest.raises(RejectedMessage):
        protocol.validate_event({"type": "tick", "t": 0.5})
    with pytest.raises(RejectedMessage):
        protocol.validate_event({"type": "pong"})


def test_bundled_schemas_stand_alone_and_validate_like_their_parts() -> None:
    commands = jsonschema.Draft202012Validator(dict(protocol.bundled_schema("command")))
    replies = jsonschema.Draft202012Validator(dict(protocol.bundled_schema("reply")))
    commands.check_schema(commands.schema)
    assert "x-message" not in json.dumps(commands.schema)
    for command in COMMANDS.values():
        assert commands.is_valid(command.schema["examples"][0])
    for reply in protocol.REPLIES.values():
        assert replies.is_valid(reply.schema["examples"][0])
    assert not commands.is_valid({"type": "step", "ticks": 0})
    assert not commands.is_valid({"type": "batch", "commands": [{"type": "step", "ticks": 0}]})
    assert not replies.is_valid({"type": "batch_result", "results": [{"type": "stepped"}]})


def test_a_config_is_completed_in_a_copy() -> None:
    given_config = {"seed": 7.0, "limits": {"joints": 5}, "engine": {"solver": "any"}}
    before = copy.deepcopy(given_config)
    config = protocol.complete_config(given_config)
    assert given_config == before
    assert config == {
        "name": "main", "backend": "mujoco", "seed": 7, "tick_rate": 60, "substeps": 4, "gravity": [0, -9.81, 0],
        "mode": "realtime", "rate": 1, "friction": 1, "restitution": 0, "limits": {"cubes": 10_000, "joints": 5},
        "scene": {"type": "flat", "obstacles": []}, "engine": {"solver": "any"},
    }  # fmt: skip
    assert type(config["seed"]) is int
    assert protocol.complete_config(config) == config
    config["gravity"][1] = config["limits"]["cubes"] = 1
    assert protocol.complete_config({})["gravity"] == [0, -9.81, 0]
    assert protocol.complete_config({})["limits"]["cubes"] == 10_000


@pytest.mark.parametrize(
    ("config", "field"),
    [
        ({"tickrate": 60}, "tickrate"),
        ({"limits": {"cube": 5}}, "limits/cube"),
        ({"tick_rate": 0}, "tick_rate"),
        ({"gravity": [0, -9.81]}, "gravity"),
        ({"scene": {"type": "moon"}}, "scene/type"),
        ({"name": "a b"}, "name"),
        ({"seed": -1}, "seed"),
    ],
)
def test_a_bad_config_is_refused(config: dict[str, Any], field: str) -> None:
    with pytest.raises(RejectedMessage) as caught:
        protocol.complete_config(config)
    assert (caught.value.code, caught.value.path) == ("invalid", field)


def test_a_config_that_is_no_json_is_refused() -> None:
    configs: list[Any] = [{"engine": {"x": object()}}, [], "main", None]
    for config in configs:
        with pytest.raises(RejectedMessage):
            protocol.complete_config(config)


def test_metadata_are_validated() -> None:
    (metadata,) = schemas.load("recording_metadata.json")["examples"]
    protocol.validate_metadata(metadata)
    with pytest.raises(RejectedMessage) as caught:
        protocol.validate_metadata({**metadata, "nmes.world": {"config": "{}"}})
    assert caught.value.path == "nmes.world/seed"


def test_decode_refuses_anything_but_an_object() -> None:
    for raw in (b"[]", b"", b"{", b"auth_success"):
        with pytest.raises(ValueError):
            decode(raw)
