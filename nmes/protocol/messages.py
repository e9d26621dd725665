"""The wire protocol without I/O: bytes in, commands out; replies in, bytes out.

This module hides framing, strict JSON, validation against the schemas, and the two dialects. `parse` turns one frame
into a `Request`; a `Session` is one connection's protocol state. Neither ever raises for what a peer sends: a frame
that is no valid command becomes a Request with an `error`, and a stream that can no longer be trusted is a
`Session.violation`. Invariants: how bytes are cut into pieces changes nothing; every number in a valid command is
finite and within its schema's bounds; what `encode` returns never contains the delimiter.
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Final, Literal

import jiter
import jsonschema_rs
import orjson

from nmes.errors import NmesError, RejectedMessage
from nmes.schemas import Schema, describe, load, load_all, schema_hash

__all__ = [
    "COMMANDS",
    "DELIMITER",
    "ERROR_CODES",
    "EVENTS",
    "NO_ID",
    "PROTOCOL_VERSION",
    "REPLIES",
    "Auth",
    "CommandSchema",
    "FrameSplitter",
    "Limits",
    "MessageSchema",
    "Problem",
    "Request",
    "Session",
    "bundled_schema",
    "complete_config",
    "decode",
    "did_you_mean",
    "document_schema",
    "encode",
    "error_reply",
    "parse",
    "parse_json",
    "problems",
    "request_from",
    "schema_hash",
    "validate_event",
    "validate_metadata",
    "validate_reply",
]

PROTOCOL_VERSION: Final = 1
DELIMITER: Final = b"<???DONE???---"
NESTING: Final = 200
_WHITE: Final = b" \t\r\n"
_MENTIONED: Final = 80  # how many characters of a peer's value an error message repeats


class _NoId(Enum):
    NO_ID = "no id"


NO_ID: Final = _NoId.NO_ID
"""Marks a command without an `id`: null is an id like any other."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What a host allows one peer, and how many peers.

    Attributes:
        frame: Longest frame after auth, bytes.
        auth_frame: Longest first frame, bytes.
        auth_timeout: Time until the first frame must be there, s.
        idle_timeout: Time without a frame in either direction after which a connection is closed, s.
        pending: How much may wait to be read by a peer, or to be looked at by the host, bytes.
        stall_timeout: Time for which a peer may leave unread what waits for it, s.
        connections: How many connections a host holds.
    """

    frame: int = 1 << 20
    auth_frame: int = 16 << 10
    auth_timeout: float = 5.0
    idle_timeout: float = 300.0
    pending: int = 8 << 20
    stall_timeout: float = 10.0
    connections: int = 1024


@dataclass(slots=True)
class Request:
    """One frame of a client: exactly one of `command` and `error` is set.

    Attributes:
        raw: The frame as it came, without white space around it.
        command: The valid command.
        error: Why it is none.
        type: The command's type, where it could be read.
        id: The command's id, where there is one and it could be read, else `NO_ID`.
    """

    raw: bytes
    command: dict[str, Any] | None
    error: RejectedMessage | None = None
    type: str | None = None
    id: Any = NO_ID


@dataclass(frozen=True, slots=True)
class Auth:
    """The first frame of a connection; with an `error`, nothing but `dialect` and `id` means anything."""

    dialect: Literal["json", "raw"]
    password: str = field(default="", repr=False)
    world: str | None = None
    error: RejectedMessage | None = None
    id: Any = NO_ID
    list: bool = False


# -- schemas ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class MessageSchema:
    """The shape of one message, free of references, and its compiled validator."""

    type: str
    schema: Schema
    validator: jsonschema_rs.Draft202012Validator = field(repr=False)


@dataclass(frozen=True, slots=True)
class CommandSchema(MessageSchema):
    """The shape of a command.

    Attributes:
        reply: Type of its reply.
        required: Whether every conforming server must have it (section 5).
        silent: Whether the raw dialect leaves it unanswered.
        bare: Whether in the raw dialect its reply has neither `type` nor `id`.
        defaults: Default values by field.
        integers: Fields that hold a whole number.
        batches: Fields that hold an array of commands.
    """

    reply: str
    required: bool
    silent: bool
    bare: bool
    defaults: Mapping[str, Any]
    integers: tuple[str, ...]
    batches: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Problem:
    """What is wrong with one value of a document: `where` are the keys that lead to it, `said` is for a person."""

    where: tuple[str | int, ...]
    said: str

    @property
    def pointer(self) -> str:
        """The JSON Pointer of the value, without its leading slash."""
        return "/".join(str(key).replace("~", "~0").replace("/", "~1") for key in self.where)


def document_schema(path: str) -> MessageSchema:
    """Returns the compiled schema of a kind of document, by its file's path under `schemas/`, for `problems`."""
    return _message(path.removesuffix(".json"), load(path))


def _message(kind: str, schema: Schema) -> MessageSchema:
    return MessageSchema(kind, schema, jsonschema_rs.Draft202012Validator(schema))


def _command(kind: str, schema: Schema) -> CommandSchema:
    fields = schema["properties"].items()
    return CommandSchema(
        kind,
        schema,
        jsonschema_rs.Draft202012Validator(schema),
        reply=schema["x-reply"],
        required=schema["x-required"],
        silent=schema["x-silent"],
        bare=schema.get("x-bare", False),
        defaults={name: part["default"] for name, part in fields if "default" in part},
        integers=tuple(name for name, part in fields if part.get("type") == "integer"),
        batches=tuple(name for name, part in fields if part.get("items", {}).get("x-message") == "command"),
    )


COMMANDS: Final = {kind: _command(kind, schema) for kind, schema in load_all("commands").items()}
REPLIES: Final = {kind: _message(kind, schema) for kind, schema in load_all("replies").items()}
EVENTS: Final = {kind: _message(kind, schema) for kind, schema in load_all("events").items()}
ERROR_CODES: Final[Mapping[str, str]] = {
    choice["const"]: choice["description"] for choice in REPLIES["error"].schema["properties"]["code"]["oneOf"]
}
"""Every code of an `error` reply, and what it means."""
_AUTH: Final = _message("auth", load("auth.json"))
_CONFIG: Final = _message("world_config", load("world_config.json"))
_METADATA: Final = _message("recording_metadata", load("recording_metadata.json"))


_PROSE = {"$schema", "x-message", "description", "examples"}  # what a bundle does without


def bundled_schema(kind: Literal["command", "reply"]) -> Schema:
    """Returns one self-contained JSON Schema of any command, or of any reply, without its prose."""
    messages: Mapping[str, MessageSchema] = COMMANDS if kind == "command" else REPLIES

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
    _validate(REPLIES, reply, "")
    for index, result in enumerate(reply.get("results", ()) if reply["type"] == "batch_result" else ()):
        _validate(REPLIES, result, f"results/{index}/")


def validate_event(event: Mapping[str, Any]) -> None:
    """Checks an event.

    Raises:
        RejectedMessage: It is not as its schema says.
    """
    _validate(EVENTS, event, "")


def validate_metadata(metadata: Mapping[str, Any]) -> None:
    """Checks a recording's metadata.

    Raises:
        RejectedMessage: It is not as `recording_metadata.json` says.
    """
    _validate({"recording_metadata": _METADATA}, metadata, "", "recording_metadata")


def complete_config(config: Mapping[str, Any]) -> dict[str, Any]:
    """Returns a world config with every default filled in, as new plain JSON data.

    Raises:
        RejectedMessage: It is not as `world_config.json` says; `path` names the value.
    """
    try:
        plain = orjson.loads(encode(config))
    except (TypeError, ValueError) as error:
        raise RejectedMessage("invalid", f"the world config is not JSON data: {error}") from None
    _validate({"world_config": _CONFIG}, plain, "", "world_config")
    return _completed(_CONFIG.schema, plain)


def _completed(schema: Schema, value: dict[str, Any], path: str = "") -> dict[str, Any]:
    """Fills in defaults. A property with `x-when` exists only where `type` is one of those; then it must."""
    complete = dict(value)
    for name, part in schema.get("properties", {}).items():
        here, kinds = path + name, part.get("x-when")
        if kinds is not None and complete["type"] not in kinds:
            if name in value:
                raise RejectedMessage("invalid", f"{here}: only where type is {' or '.join(kinds)}", here)
            continue
        if name not in complete:
            if "default" in part:
                complete[name] = json.loads(json.dumps(part["default"]))  # a copy, all the way down
            elif kinds is not None:
                raise RejectedMessage("invalid", f"{here}: is missing; expected {describe(part)}", here)
            else:
                continue
        if part.get("type") == "object":
            complete[name] = _completed(part, complete[name], f"{here}/")
        elif part.get("type") == "integer":
            complete[name] = int(complete[name])
        elif part.get("items", {}).get("type") == "object":
            complete[name] = [
                _completed(part["items"], item, f"{here}/{index}/") for index, item in enumerate(complete[name])
            ]
    return complete


def _validate(
    schemas: Mapping[str, MessageSchema], message: Mapping[str, Any], path: str, kind: str | None = None
) -> None:
    error = _find_error(schemas, message, path, kind)
    if error is not None:
        raise error


def _find_error(
    schemas: Mapping[str, MessageSchema], message: Any, path: str, kind: str | None = None
) -> RejectedMessage | None:
    """Says what is wrong with a message, if anything is. `path` is where the message itself is found."""
    if not isinstance(message, Mapping):
        return RejectedMessage("invalid", f"expected an object, got {_short(message)}", path.rstrip("/") or None)
    if kind is None:
        kind = message.get("type")
        if not isinstance(kind, str):
            said = f"expected a string, got {_short(kind)}" if "type" in message else "is missing"
            return RejectedMessage("invalid", f"{path}type: {said}", f"{path}type")
    found = schemas.get(kind)
    if found is None:
        return RejectedMessage("unknown_type", _unknown_type(kind, schemas), f"{path}type")
    worst: Problem | None = None
    for problem in problems(found, message):
        if worst is None or len(problem.where) > len(worst.where):  # the deepest is the most to the point
            worst = problem
    if worst is None:
        return None
    pointer = path + worst.pointer
    return RejectedMessage("invalid", f"{pointer}: {worst.said}", pointer)


def problems(shape: MessageSchema, value: Any) -> Iterator[Problem]:
    """Yields what a schema has to say against a value, in words for people."""
    for error in shape.validator.iter_errors(value):
        where = tuple(error.instance_path)
        if isinstance(error.kind, jsonschema_rs.ValidationErrorKind.Required):
            missing = error.kind.property
            said = f"is missing; expected {_expected(shape.schema, error.schema_path, missing)}"
            yield Problem((*where, missing), said)
        elif isinstance(error.kind, jsonschema_rs.ValidationErrorKind.AdditionalProperties):
            known = _at(shape.schema, error.schema_path[:-1])["properties"]
            for name in error.kind.unexpected:
                yield Problem((*where, name), "there is no such field" + did_you_mean(name, known))
        else:
            said = f"expected {_expected(shape.schema, error.schema_path)}"
            if "x-secret" not in _at(shape.schema, error.schema_path[:-1]):
                said += f", got {_short(_at(value, where))}"
            yield Problem(where, said)


def _expected(schema: Schema, keyword: Iterable[str | int], missing: str | None = None) -> str:
    """Describes what the schema around a failed keyword asks for."""
    around = _at(schema, list(keyword)[:-1])
    return describe(around if missing is None else around.get("properties", {}).get(missing, {}))


def _at(value: Any, path: Iterable[str | int]) -> Any:
    for key in path:
        value = value[key]
    return value


def _unknown_type(kind: str, known: Iterable[str]) -> str:
    if kind == "auth":
        return "auth is only the first message of a connection"
    return f"there is no command {_short(kind)}{did_you_mean(kind, known)}"


def did_you_mean(name: str | int, known: Iterable[str]) -> str:
    """Returns `; did you mean leg?`, to stand behind what is said of an unknown name, or nothing if none is near."""
    near = difflib.get_close_matches(str(name)[:_MENTIONED], known, n=1)
    return f"; did you mean {near[0]}?" if near else ""


def _short(value: Any) -> str:
    return _cut(encode(value).decode())


def _cut(text: str) -> str:
    return text if len(text) <= _MENTIONED else text[: _MENTIONED - 3] + "..."


# -- one message ------------------------------------------------------------------------------------------------------


def encode(message: Any) -> bytes:
    """Writes a message, without the delimiter; numpy arrays become arrays.

    Raises:
        TypeError: It holds something that JSON cannot.
        ValueError: It holds a lone surrogate, or a number that JSON cannot.
    """
    try:
        text = orjson.dumps(message, option=orjson.OPT_SERIALIZE_NUMPY)
    except TypeError:  # also an integer of more than 64 bits, as an id may be
        text = json.dumps(message, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()
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


def parse(raw: bytes) -> Request:
    """Reads one frame. Never raises."""
    value = _parse_json(raw)
    if isinstance(value, RejectedMessage):
        return Request(raw, None, value)
    if type(value) is not dict:
        return Request(raw, None, RejectedMessage("bad_frame", f"expected a JSON object, got {_short(value)}"))
    kind = value.get("type")
    error = _check(value)
    if error is None:
        return Request(raw, value, None, kind, value.get("id", NO_ID))
    return Request(raw, None, error, kind if isinstance(kind, str) else None, value.get("id", NO_ID))


def request_from(command: Mapping[str, Any]) -> Request:
    """Makes a request of a Python caller's command, which is judged as if it had come over the wire. Never raises."""
    try:
        raw = encode(command)
    except (TypeError, ValueError, RecursionError) as error:
        return Request(b"", None, RejectedMessage("bad_json", f"this cannot be written as JSON: {error}"))
    return parse(raw)


def parse_json(text: bytes) -> Any:
    """Reads strict JSON that is no message: a document of a person's.

    Raises:
        RejectedMessage: It is not strict JSON.
    """
    value = _parse_json(text)
    if isinstance(value, RejectedMessage):
        raise value
    return value


def _parse_json(raw: bytes) -> Any:
    """Returns the value, or the RejectedMessage that says why there is none."""
    try:
        # jiter alone finds duplicate keys and keeps long integers exact; orjson alone refuses numbers that are
        # infinite as a double (1e400). Both together cost less than looking for such numbers ourselves.
        value = jiter.from_json(raw, catch_duplicate_keys=True, allow_inf_nan=False)
        orjson.loads(raw)
    except ValueError as error:
        try:
            raw.decode()
        except UnicodeDecodeError as broken:
            return RejectedMessage("bad_frame", f"invalid UTF-8 at byte {broken.start}")
        return RejectedMessage("bad_json", f"not strict JSON: {_cut(str(error))}")  # it may repeat a key of any length
    if len(raw) > 2 * NESTING and _too_deep(raw, value):
        return RejectedMessage("bad_json", f"nested more than {NESTING} deep")
    return value


def _too_deep(raw: bytes, value: Any) -> bool:
    if raw.count(b"[") + raw.count(b"{") <= NESTING:
        return False
    level: list[Any] = [value]
    for _ in range(NESTING):
        level = [
            inner
            for outer in level
            if isinstance(outer, (list, dict))
            for inner in (outer.values() if isinstance(outer, dict) else outer)
        ]
    return any(isinstance(inner, (list, dict)) for inner in level)


def _check(command: dict[str, Any], path: str = "") -> RejectedMessage | None:
    """Validates a command, and makes its whole numbers ints: to JSON Schema 1.0 is an integer too."""
    kind = command.get("type")
    schema = COMMANDS.get(kind) if type(kind) is str else None
    if schema is None or not schema.validator.is_valid(command):
        return _find_error(COMMANDS, command, path)
    for name in schema.integers:
        if type(command.get(name)) is float:
            command[name] = int(command[name])
    for name in schema.batches:
        for index, inner in enumerate(command[name]):
            error = _check(inner, f"{path}{name}/{index}/")
            if error is not None:
                return error
    return None


# -- a stream of messages ---------------------------------------------------------------------------------------------


class FrameSplitter:
    """Cuts a stream of bytes into frames, in time linear in the stream however small the pieces.

    Attributes:
        limit: Longest frame, bytes; may be changed between frames.
        exceeded: Whether a frame was longer. Nothing more comes out then.
    """

    def __init__(self, limit: int = Limits().frame) -> None:
        self.limit = limit
        self.exceeded = False
        self._buffer = bytearray()
        self._start = 0  # where the next frame begins
        self._scanned = 0  # no delimiter begins before this

    @property
    def waiting(self) -> int:
        """How many bytes wait to become frames."""
        return len(self._buffer) - self._start

    def feed(self, data: bytes) -> list[bytes]:
        """Takes bytes and returns the frames that they complete, without the empty ones and white space around."""
        self.push(data)
        return list(self.frames())

    def push(self, data: bytes) -> None:
        """Takes bytes without looking at them."""
        if self._start:
            del self._buffer[: self._start]
            self._scanned -= self._start
            self._start = 0
        self._buffer += data

    def frames(self) -> Iterator[bytes]:
        """Yields the frames one by one; stopping half way leaves the rest for later."""
        while not self.exceeded:
            end = self._buffer.find(DELIMITER, self._scanned)
            if end < 0:
                self._scanned = max(self._start, len(self._buffer) - len(DELIMITER) + 1)
                # Only what can no longer become a frame of the permitted length is too long, whatever comes next.
                self.exceeded = self._scanned - self._start > self.limit
                return
            frame = bytes(self._buffer[self._start : end])
            if len(frame) > self.limit:
                self.exceeded = True
                return
            self._start = self._scanned = end + len(DELIMITER)
            if frame := frame.strip(_WHITE):
                yield frame


class Session:
    """The protocol's side of one connection: framing, auth, dialect.

    The first frame comes out as an `Auth`; then the session waits, whatever else is received, until the host has
    said `accept` or `refuse`. From then on Requests come out. After a `violation` nothing does.
    """

    def __init__(self, limits: Limits | None = None) -> None:
        self.violation: RejectedMessage | None = None
        self.dialect: Literal["json", "raw"] | None = None
        self._limits = limits or Limits()
        self._splitter = FrameSplitter(self._limits.auth_frame)
        self._state: Literal["new", "waiting", "open", "closed"] = "new"
        self._auth_id: Any = NO_ID

    def receive(self, data: bytes) -> list[Auth | Request]:
        """Takes what came in and returns what it means. Never raises; see `violation` afterwards.

        What was received while waiting comes out of the next call after `accept`, which may be `receive(b"")`.
        """
        if self._state == "closed" or self.violation is not None:
            return []
        received: list[Auth | Request] = []
        self._splitter.push(data)
        if self._state == "open":
            received += map(parse, self._splitter.frames())
        elif self._state == "new":
            for frame in self._splitter.frames():
                received.append(self._read_auth(frame))
                self._state = "waiting"
                break
        if self._splitter.exceeded:
            self._violate(f"a frame is longer than {self._splitter.limit:,} bytes")
        elif self._state == "waiting" and self._splitter.waiting > self._limits.pending:
            self._violate(f"more than {self._limits.pending:,} bytes came before the answer to auth")
        return received

    def _violate(self, message: str) -> None:
        self.violation = RejectedMessage("frame_too_large", message)

    def _read_auth(self, frame: bytes) -> Auth:
        if not frame.startswith(b"{"):
            self.dialect = "raw"
            try:
                return Auth("raw", frame.decode())
            except UnicodeDecodeError:
                return Auth("raw", error=RejectedMessage("auth_failed", "the password is not valid UTF-8"))
        self.dialect = "json"
        message = _parse_json(frame)
        if isinstance(message, RejectedMessage):
            # A key is repeated in quotation marks, and may be a password that got into the wrong place.
            return Auth("json", error=RejectedMessage(message.code, message.message.split('"')[0].rstrip()))
        self._auth_id = message.get("id", NO_ID)
        if message.get("type") != "auth":
            error: RejectedMessage | None = RejectedMessage("auth_failed", "the first message must be auth")
        else:
            error = _find_error({"auth": _AUTH}, message, "")
        if error is not None:
            return Auth("json", error=error, id=self._auth_id)
        return Auth("json", message["password"], message.get("world"), None, self._auth_id, message.get("list", False))

    def accept(self, welcome: Mapping[str, Any]) -> bytes:
        """Opens the session and returns the bytes that say so; `welcome` is `auth_success`, or `world_list`."""
        self._state = "open"
        self._splitter.limit = self._limits.frame
        if self.dialect == "raw":
            return b"auth_success" + DELIMITER
        return encode(self._with_auth_id(dict(welcome))) + DELIMITER

    def refuse(self, error: NmesError) -> bytes:
        """Ends the session, opened or not, and returns the bytes that say why; the host sends them and closes."""
        opened = self._state == "open"
        self._state = "closed"
        if self.dialect == "raw" and not opened:
            return b"auth_failed" + DELIMITER
        if opened or self.dialect is None:
            return encode(error_reply(error)) + DELIMITER
        return encode(self._with_auth_id(error_reply(error, "auth"))) + DELIMITER

    def _with_auth_id(self, message: dict[str, Any]) -> dict[str, Any]:
        return message if self._auth_id is NO_ID else {**message, "id": self._auth_id}

    def reply(self, request: Request, reply: bytes) -> bytes:
        """Returns the bytes to send for an encoded reply: none where the raw dialect is silent."""
        command = COMMANDS.get(request.type) if self.dialect == "raw" and request.type is not None else None
        if command is not None and command.silent:
            return b""
        if command is not None and command.bare:
            message = decode(reply)
            if message.get("type") == command.reply:
                reply = encode({key: value for key, value in message.items() if key not in ("type", "id")})
        return reply + DELIMITER

    def event(self, event: bytes) -> bytes:
        """Returns the bytes to send for an encoded event."""
        return event + DELIMITER
