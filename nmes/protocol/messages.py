"""One message: a frame's bytes into a command, a reply into bytes, and what the schemas have to say about either.

Invariants: `parse` never raises for what a peer sends, a frame that is no valid command becomes a Request with an
`error`; every number in a valid command is finite and within its schema's bounds; what `encode` returns never contains
the delimiter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from itertools import islice
from typing import Any, Final, Literal

import jiter
import orjson

from nmes.errors import DocumentError, NmesError, RejectedMessage
from nmes.schemas import Schema
from nmes.schemas.documents import (
    CompiledSchema,
    Problem,
    compile_folder,
    compile_schema,
    complete,
    did_you_mean,
    excerpt,
    parse_json,
    plain,
    plain_numbers,
    problems,
    unwritable_number,
    write_json,
)

__all__ = [
    "AUTH",
    "COMMANDS",
    "DELIMITER",
    "ERROR_CODES",
    "EVENTS",
    "NO_ID",
    "PROTOCOL_VERSION",
    "REPLIES",
    "CommandSchema",
    "Request",
    "bundled_schema",
    "complete_config",
    "decode",
    "encode",
    "error_reply",
    "find_error",
    "parse",
    "request_from",
    "validate_event",
    "validate_metadata",
    "validate_reply",
]

PROTOCOL_VERSION: Final = 1
DELIMITER: Final = b"<???DONE???---"
_TYPE_LENGTH: Final = 128  # characters of an unknown type that an error repeats
_MOST_IGNORED, _KEY_LENGTH = 20, 64  # unknown fields of a command that are told, and characters of their names


class _NoId(Enum):
    NO_ID = "no id"


NO_ID: Final = _NoId.NO_ID
"""Marks a command without an `id`: null is an id like any other."""


@dataclass(slots=True)
class Request:
    """One frame of a client: exactly one of `command` and `error` is set.

    Attributes:
        raw: The frame as it came, without white space around it; where it was translated, the translation's bytes.
        command: The valid command.
        error: Why it is none.
        type: The command's type, where it could be read.
        id: The command's id, where there is one and it could be read, else `NO_ID`.
        said: The message as its client wrote it, where it was translated.
        ignored: The paths of fields that a valid command has and nobody knows, at most 20.
    """

    raw: bytes
    command: dict[str, Any] | None
    error: RejectedMessage | None = None
    type: str | None = None
    id: Any = NO_ID
    said: dict[str, Any] | None = None
    ignored: tuple[str, ...] = ()


# -- schemas ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class CommandSchema(CompiledSchema):
    """The shape of a command.

    Attributes:
        reply: Type of its reply.
        required: Whether every conforming server must have it (section 5).
        silent: Whether the raw dialect leaves it unanswered.
        defaults: Default values by field.
        plain: Its fields, but for those that hold fields of their own: `objects` and `batches`.
        objects: Fields that hold an object, with the names that are known there.
        integers: Fields that hold a whole number.
        batches: Fields that hold an array of commands.
    """

    reply: str
    required: bool
    silent: bool
    defaults: Mapping[str, Any]
    plain: frozenset[str]
    objects: Mapping[str, frozenset[str]]
    integers: tuple[str, ...]
    batches: tuple[str, ...]


def _command(compiled: CompiledSchema) -> CommandSchema:
    schema = compiled.schema
    fields = schema["properties"].items()
    batches = tuple(name for name, part in fields if part.get("items", {}).get("x-message") == "command")
    # Where no other fields may stand, the validator has looked already.
    objects = {
        name: frozenset(part["properties"])
        for name, part in fields
        if "properties" in part and part.get("additionalProperties") is not False
    }
    return CommandSchema(
        compiled.type,
        schema,
        compiled.validator,
        compiled.conditional,
        reply=schema["x-reply"],
        required=schema["x-required"],
        silent=schema["x-silent"],
        defaults={name: part["default"] for name, part in fields if "default" in part},
        plain=frozenset(name for name, _ in fields).difference(objects, batches),
        objects=objects,
        integers=tuple(name for name, part in fields if part.get("type") == "integer"),
        batches=batches,
    )


COMMANDS: Final = {kind: _command(schema) for kind, schema in compile_folder("commands").items()}
REPLIES: Final = compile_folder("replies")
EVENTS: Final = compile_folder("events")
ERROR_CODES: Final[Mapping[str, str]] = {
    choice["const"]: choice["description"] for choice in REPLIES["error"].schema["properties"]["code"]["oneOf"]
}
"""Every code of an `error` reply, and what it means."""
AUTH: Final = compile_schema("auth.json")
_CONFIG: Final = compile_schema("world_config.json")
_METADATA: Final = compile_schema("recording_metadata.json")


_PROSE = {"$schema", "x-message", "description", "examples"}  # what a bundle does without


def bundled_schema(kind: Literal["command", "reply"]) -> Schema:
    """Returns one self-contained JSON Schema of any command, or of any reply, without its prose."""
    messages: Mapping[str, CompiledSchema] = COMMANDS if kind == "command" else REPLIES

    def tied(value: Any) -> Any:  # in the bundle, "any command" is the bundle itself
        if isinstance(value, list):
            return [tied(item) for item in value]
        if not isinstance(value, dict):
            return value
        parts = {key: tied(item) for key, item in value.items() if key not in _PROSE or isinstance(item, dict)}
        return {**parts, "$ref": "#"} if value.get("x-message") == kind else parts

    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"nmes.{kind}",
        "type": "object",
        "anyOf": [tied(message.schema) for message in messages.values()],
    }


def validate_reply(reply: Mapping[str, Any]) -> None:
    """Checks a reply, and the replies inside a batch's.

    Raises:
        RejectedMessage: It is not as its schema says.
    """
    _raise(_message_error(REPLIES, reply))
    for index, result in enumerate(reply.get("results", ()) if reply["type"] == "batch_result" else ()):
        _raise(_message_error(REPLIES, result, f"results/{index}/"))


def validate_event(event: Mapping[str, Any]) -> None:
    """Checks an event.

    Raises:
        RejectedMessage: It is not as its schema says.
    """
    _raise(_message_error(EVENTS, event))


def validate_metadata(metadata: Mapping[str, Any]) -> None:
    """Checks a recording's metadata.

    Raises:
        RejectedMessage: It is not as `recording_metadata.json` says.
    """
    _raise(find_error(_METADATA, metadata))


def complete_config(config: Mapping[str, Any]) -> dict[str, Any]:
    """Returns a world config with every default filled in, as new plain JSON data.

    Raises:
        RejectedMessage: It is not as `world_config.json` says; `path` names the value.
    """
    try:
        document = plain(config)
    except DocumentError as error:
        raise RejectedMessage("invalid", f"the world config: {error.message}", error.problems[0][0] or None) from None
    _raise(find_error(_CONFIG, document))
    return complete(_CONFIG.schema, document)


def _raise(error: RejectedMessage | None) -> None:
    if error is not None:
        raise error


def _message_error(schemas: Mapping[str, CompiledSchema], message: Any, path: str = "") -> RejectedMessage | None:
    """Returns the reason why a message is none of these; `path` is where the message itself is found."""
    if not isinstance(message, Mapping):
        return RejectedMessage("invalid", f"expected an object, got {excerpt(message)}", path.rstrip("/") or None)
    kind = message.get("type")
    if not isinstance(kind, str):
        reason = f"expected a string, got {excerpt(kind)}" if "type" in message else "is missing"
        return RejectedMessage("invalid", f"{path}type: {reason}", f"{path}type")
    schema = schemas.get(kind)
    if schema is None:
        return RejectedMessage("unknown_type", _unknown_type(kind, schemas), f"{path}type")
    return find_error(schema, message, path)


def find_error(schema: CompiledSchema, message: Any, path: str = "") -> RejectedMessage | None:
    """Returns the problem that a schema has with a message or document, the deepest where there are several."""
    if not isinstance(message, Mapping):
        return RejectedMessage("invalid", f"expected an object, got {excerpt(message)}", path.rstrip("/") or None)
    worst: Problem | None = None
    for problem in problems(schema, message):
        if worst is None or len(problem.keys) > len(worst.keys):  # the deepest is the most to the point
            worst = problem
    if worst is None:
        return None
    pointer = path + worst.pointer
    return RejectedMessage("invalid", f"{pointer}: {worst.message}", pointer)


def _unknown_type(kind: str, known: Iterable[str]) -> str:
    if kind == "auth":
        return "auth is only the first message of a connection"
    return f"there is no command {excerpt(kind)}{did_you_mean(kind, known)}"


# Counted by their commas and colons, those in strings too: reading so many keeps all other threads waiting for 30 ms.
# The largest brains have 50,000 keys, and their bodies 15,000.
_MOST_VALUES, _MOST_KEYS = 100_000, 65_536


# -- one message ------------------------------------------------------------------------------------------------------


def encode(message: Any) -> bytes:
    """Writes a message, without the delimiter; arrays and scalars of numpy become numbers.

    Raises:
        TypeError: It holds something that JSON cannot.
        ValueError: It holds a lone surrogate, or a number that JSON cannot.
    """
    try:  # the hot half of `write_json`, without a call
        text = orjson.dumps(message, default=plain_numbers)
    except TypeError:  # also an integer of more than 64 bits, as an id may be
        text = write_json(message)
    return text.replace(b"<", b"\\u003c")  # outside strings, JSON has no `<`


def decode(message: bytes) -> dict[str, Any]:
    """Reads a message that is trusted to be one: a reply or an event, without the delimiter.

    Raises:
        ValueError: It is not a JSON object.
    """
    value = jiter.from_json(message)
    if type(value) is not dict:
        raise ValueError("the message is not a JSON object")
    return value


def error_reply(error: NmesError, command_type: str | None = None) -> dict[str, Any]:
    """Returns the `error` reply that tells of an error."""
    reply = {"type": "error", "code": error.code, "message": error.message}
    if command_type is not None:
        reply["command"] = command_type
    if error.path is not None:
        reply["field"] = error.path
    return reply


def parse(raw: bytes, translate: Callable[[dict[str, Any]], dict[str, Any]] | None = None) -> Request:
    """Reads one frame. Never raises.

    Args:
        raw: The frame.
        translate: Makes a message of this protocol of one in another dialect; returns the same one where it need not.
    """
    if len(raw) > _MOST_KEYS:
        for what, mark, most in (("values", b",", _MOST_VALUES), ("keys", b":", _MOST_KEYS)):
            if raw.count(mark) > most:
                return Request(raw, None, RejectedMessage("invalid", f"a message holds at most {most:,} {what}"))
    try:
        message = parse_json(raw)
    except RejectedMessage as rejection:
        return Request(raw, None, rejection)
    if type(message) is not dict:
        return Request(raw, None, RejectedMessage("bad_frame", f"expected a JSON object, got {excerpt(message)}"))
    if translate is not None and (translated := translate(message)) is not message:
        request = parse(encode(translated))  # read anew, within all limits, as a replay of what is recorded reads it
        request.said = message
        return request
    kind = message.get("type")
    error = _check(message)
    if error is None:
        plain = COMMANDS[message["type"]].plain
        ignored = () if plain.issuperset(message) else tuple(islice(_unknown(message), _MOST_IGNORED))
        return Request(raw, message, None, kind, message.get("id", NO_ID), None, ignored)
    known = kind if isinstance(kind, str) and len(kind) <= _TYPE_LENGTH else None
    return Request(raw, None, error, known, message.get("id", NO_ID))


def _unknown(command: Mapping[str, Any], path: str = "") -> Iterator[str]:
    """Yields the paths of the fields of a valid command that nobody knows."""
    schema = COMMANDS[command["type"]]
    for name, value in command.items():
        if name in schema.objects:
            yield from (f"{path}{name}/{_key(key)}" for key in value if key not in schema.objects[name])
        elif name in schema.batches:
            for index, inner in enumerate(value):
                yield from _unknown(inner, f"{path}{name}/{index}/")
        elif name not in schema.plain:
            yield path + _key(name)


def _key(name: str) -> str:
    """Returns a key as a JSON Pointer has it, the beginning of a long one."""
    return name[:_KEY_LENGTH].replace("~", "~0").replace("/", "~1")


def request_from(command: Mapping[str, Any]) -> Request:
    """Makes a request of a Python caller's command, which is judged as if it had come over the wire. Never raises."""
    try:
        raw = encode(command)
    except (TypeError, ValueError, RecursionError) as error:
        return Request(b"", None, RejectedMessage("bad_json", f"this cannot be written as JSON: {error}"))
    request, wrong = parse(raw), unwritable_number(command, raw)
    if wrong is None:
        return request
    # Recorded without its bytes: these say null, which a replay would judge otherwise.
    path, words = wrong
    return Request(b"", None, RejectedMessage("invalid", f"{path}: {words}", path), request.type, request.id)


def _check(command: dict[str, Any], path: str = "") -> RejectedMessage | None:
    """Validates a command, and makes its whole numbers ints: to JSON Schema 1.0 is an integer too."""
    kind = command.get("type")
    schema = COMMANDS.get(kind) if type(kind) is str else None
    if schema is None or not schema.validator.is_valid(command):
        return _message_error(COMMANDS, command, path)
    for name in schema.integers:
        if type(command.get(name)) is float:
            command[name] = int(command[name])
    for name in schema.batches:
        for index, inner in enumerate(command[name]):
            error = _check(inner, f"{path}{name}/{index}/")
            if error is not None:
                return error
    return None
