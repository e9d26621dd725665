"""One connection's side of the protocol: framing, auth, and the two dialects.

Invariants: how bytes are cut into pieces changes nothing; a stream that can no longer be trusted is a
`Session.violation`, and nothing more comes out of it.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final, Literal, cast

from nmes.errors import NmesError, RejectedMessage
from nmes.protocol import original
from nmes.protocol.messages import (
    AUTH,
    COMMANDS,
    DELIMITER,
    NO_ID,
    Request,
    encode,
    error_reply,
    find_error,
    parse,
)
from nmes.schemas.documents import parse_json

__all__ = ["PASSWORD_VARIABLE", "REDACTED", "Auth", "FrameSplitter", "Limits", "Session"]

PASSWORD_VARIABLE: Final = "NMES_PASSWORD"
"""The environment's variable that has the password, of a server or a client, where none is given."""
REDACTED: Final = b"(a frame with a password, which is not kept)"
"""What is recorded of a refused frame with the password, or a token, in it."""
_WHITE: Final = b" \t\r\n"
_MOST_TOLD: Final = 200  # things of a session's frames that do nothing
_ROW: Final = 128  # frames that are read in a row, which takes a millisecond or two if each is refused


@dataclass(frozen=True, slots=True)
class Limits:
    """The limits that a host sets its connections.

    Attributes:
        frame: Longest frame after auth, bytes.
        auth_frame: Longest first frame, bytes.
        auth_timeout: Time until the first frame must be there, s.
        idle_timeout: Time without a frame in either direction after which a connection is closed, s.
        pending: How much may wait to be read by a peer, or to be looked at by the host, bytes.
        stall_timeout: Time for which a peer may leave unread what waits for it, s.
        connections: How many connections a host holds.
        unauthenticated: How many more may be there that have not authenticated yet, or have failed to.
    """

    frame: int = 1 << 20
    auth_frame: int = 16 << 10
    auth_timeout: float = 5.0
    idle_timeout: float = 300.0
    pending: int = 8 << 20
    stall_timeout: float = 10.0
    connections: int = 1024
    unauthenticated: int = 128

    @property
    def inspection(self) -> float:
        """How often it is looked whether one of these times is over, s."""
        return min(1.0, self.stall_timeout / 4, self.idle_timeout / 4)


@dataclass(frozen=True, slots=True)
class Auth:
    """The first frame of a connection; with an `error`, nothing but `dialect` and `id` means anything."""

    dialect: Literal["json", "raw"]
    password: str = field(default="", repr=False)
    world: str | None = None
    error: RejectedMessage | None = None
    id: Any = NO_ID
    list: bool = False
    start: int = 0
    create: Mapping[str, Any] | None = None
    close: str | None = None
    role: str | None = None
    token: str | None = field(default=None, repr=False)


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

    def feed(self, data: bytes, most: int | None = None) -> list[bytes]:
        """Takes bytes and returns the frames that are complete, without the empty ones and white space around.

        Args:
            data: The bytes; none may be given to go on with what waits.
            most: How many frames to return at most; the others wait.
        """
        if self.exceeded:
            return []
        if self._start:
            del self._buffer[: self._start]
            self._scanned -= self._start
            self._start = 0
        frames: list[bytes] = []
        if not self._buffer and most is None and len(data) <= self.limit:  # as nearly always: nothing can be too long
            *pieces, rest = data.split(DELIMITER)
            self._buffer += rest
            self._scanned = max(0, len(rest) - len(DELIMITER) + 1)
            for piece in pieces:
                if frame := piece.strip(_WHITE):
                    frames.append(frame)
            return frames
        self._buffer += data
        while len(frames) != most:
            end = self._buffer.find(DELIMITER, self._scanned)
            if end < 0:
                self._scanned = max(self._start, len(self._buffer) - len(DELIMITER) + 1)
                # Only what can no longer become a frame of the permitted length is too long, whatever comes next.
                self.exceeded = self._scanned - self._start > self.limit
                break
            frame = bytes(self._buffer[self._start : end])
            if len(frame) > self.limit:
                self.exceeded = True
                break
            self._start = self._scanned = end + len(DELIMITER)
            if frame := frame.strip(_WHITE):
                frames.append(frame)
        if self.exceeded:  # its connection may stay for a while
            self._buffer, self._start, self._scanned = bytearray(), 0, 0
        return frames


def _secret_forms(password: str) -> tuple[bytes, ...]:
    """Returns a password as it stands in frames: as it is, and as JSON writes it, with and without other letters."""
    if not password:
        return ()
    forms = [password, *(json.dumps(password, ensure_ascii=ascii)[1:-1] for ascii in (True, False))]
    forms += [form.replace("<", "\\u003c") for form in forms]  # as `encode` writes what was translated
    return tuple(dict.fromkeys(form.encode("utf-8", "surrogatepass") for form in forms))


class Session:
    """The protocol's side of one connection: framing, auth, dialect.

    The first frame comes out as an `Auth`; then the session waits, whatever else is received, until the host has
    said `accept` or `refuse`. From then on frames come out, for `parse`. After a `violation` nothing does.

    Attributes:
        violation: Why the stream can no longer be trusted, once it cannot.
        dialect: What the first frame was written in, once it has come.
        parse: Reads a frame of this dialect as a Request in our own words; never raises, in any thread.
    """

    parse: Callable[[bytes], Request]  # of the instance, so that a frame costs no call more than `messages.parse`

    def __init__(self, limits: Limits | None = None) -> None:
        self.violation: RejectedMessage | None = None
        self.dialect: Literal["json", "raw"] | None = None
        self.parse = parse
        self._limits = limits or Limits()
        self._splitter = FrameSplitter(self._limits.auth_frame)
        self._state: Literal["new", "waiting", "open", "closed"] = "new"
        self._auth_id: Any = NO_ID
        self._secrets: tuple[bytes, ...] = ()  # the forms that the password and tokens take in frames
        self._told: set[str] = set()  # what `without_effect` has returned

    def receive(self, data: bytes) -> list[Auth | bytes]:
        """Takes bytes and returns the frames that they complete. Never raises; see `violation` afterwards.

        Bytes received while waiting come out of the next call after `accept`, which may be `receive(b"")`.
        """
        if self._state == "closed" or self.violation is not None:
            return []
        received: list[Auth | bytes] = []
        if self._state == "open":
            received += self._splitter.feed(data)
        elif self._state == "new":
            for frame in self._splitter.feed(data, 1):
                auth = self._read_auth(frame)
                self._secrets = _secret_forms(auth.password) + _secret_forms(auth.token or "")
                received.append(auth)
                self._state = "waiting"
        else:
            self._splitter.feed(data, 0)
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
            self.parse = partial(parse, translate=original.command)
            try:
                return Auth("raw", frame.decode())
            except UnicodeDecodeError:
                return Auth("raw", error=RejectedMessage("auth_failed", "the password is not valid UTF-8"))
        self.dialect = "json"
        try:
            message = parse_json(frame)
        except RejectedMessage as rejection:
            # A key is repeated in quotation marks, and may be a password that got into the wrong place.
            return Auth("json", error=RejectedMessage(rejection.code, rejection.message.split('"')[0].rstrip()))
        self._auth_id = message.get("id", NO_ID)
        if message.get("type") != "auth":
            error: RejectedMessage | None = RejectedMessage("auth_failed", "the first message must be auth")
        else:
            error = find_error(AUTH, message)
        if error is not None:
            return Auth("json", error=error, id=self._auth_id)
        asked = {
            name: message[name]
            for name in ("world", "list", "start", "create", "close", "role", "token")
            if name in message
        }
        return Auth("json", message["password"], id=self._auth_id, **asked)

    def accept(self, welcome: Mapping[str, Any]) -> bytes:
        """Opens the session and returns the bytes that say so; `welcome` is `auth_success`, or `world_list`."""
        self._state = "open"
        self._secrets += _secret_forms(welcome.get("token", ""))
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

    def read(self, backlog: deque[bytes | Request], most: int) -> Request:
        """Reads the first frames of a backlog, in place; returns the first, in which no password is, as in all others.

        They are read in a row because code that has just run runs faster: read one by one, between commands that are
        executed, a command of a long row takes a tenth longer.

        Args:
            backlog: Frames, of which the first is not longer than `most`, and requests that were read.
            most: How much is read, bytes.
        """
        for index in range(min(len(backlog), _ROW)):
            frame = backlog[index]
            if isinstance(frame, Request) or (most := most - len(frame)) < 0:
                break
            request = self.parse(frame)
            backlog[index] = request if request.error is None else self.redacted(request)
        return cast(Request, backlog[0])

    def redacted(self, request: Request) -> Request:
        """Returns a request in which no secret is, be it said once more: for logs, recordings and replies.

        A second `auth` never comes through, nor any frame that is refused and holds the password or a token, be it by
        itself.
        """
        if request.error is None:
            return request
        if request.type != "auth" and not any(secret in request.raw for secret in self._secrets):
            return request
        kind, error = request.type, request.error
        if kind != "auth":
            kind = kind if kind in COMMANDS else None  # the raw dialect is silent by it
            error = RejectedMessage(error.code, "this frame is no command, and holds the password")
        number = request.id
        if number is not NO_ID and any(secret in encode(number) for secret in self._secrets):
            number = NO_ID
        return Request(REDACTED, None, error, kind, number)

    def _with_auth_id(self, message: dict[str, Any]) -> dict[str, Any]:
        return message if self._auth_id is NO_ID else {**message, "id": self._auth_id}

    def reply(self, request: Request, reply: bytes) -> bytes:
        """Returns the bytes to send for an encoded reply: none where the raw dialect is silent."""
        if self.dialect == "raw":
            command = COMMANDS.get(request.type) if request.type is not None else None
            if command is not None and command.silent:
                return b""
            reply = original.answer(request, reply)
        elif request.ignored:
            reply = b'%s,"ignored":%s}' % (reply[:-1], encode(request.ignored))
        return reply + DELIMITER

    def without_effect(self, request: Request) -> list[str]:
        """Returns log lines on the fields of a frame that have no effect, each once a session.

        In the JSON dialect that is nothing: there the reply tells. Of the original's parameters, which are kept as
        notes of a joint, the log does.
        """
        if self.dialect != "raw" or request.command is None:
            return []
        kind = (request.said or request.command)["type"]
        found = [f"{kind}: {path} is not understood" for path in request.ignored]
        notes = request.command.get("notes", ()) if request.said is not None else ()
        found += [f"{kind}: {name} is kept and told back, and has no effect" for name in notes]
        new = [text for text in found if text not in self._told] if len(self._told) < _MOST_TOLD else []
        self._told.update(new)
        return new

    def event(self, event: bytes) -> bytes:
        """Returns the bytes to send for an encoded event."""
        return event + DELIMITER
