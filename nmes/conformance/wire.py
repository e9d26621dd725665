"""One connection to a server under test, as the suite sees it: bytes both ways, written down, nothing assumed.

It hides sockets. A `Wire` sends what it is told, valid or not, and cuts what comes into frames; `Log` keeps both
directions with times, of long pieces the two ends. Invariants: no call waits for longer than the time-out it was given;
what the server does wrong (silence, hanging up, JSON that is none) is a `Finding`, never another exception; every
message that `hear` returns is strict JSON and as its schema says.
"""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NoReturn, Self

from nmes.conformance.case import Finding
from nmes.errors import NmesError
from nmes.protocol import DELIMITER, EVENTS, REPLIES, decode, validate_event, validate_reply

if TYPE_CHECKING:
    from nmes.conformance.websocket import WebSocketSocket

__all__ = ["Entry", "Log", "Message", "Wire", "clip", "frame_of", "is_event", "read_json", "read_message"]

READ = 64 << 10
SHOWN = 300  # characters of what was received that a finding repeats
NO_ID = "a reply without its id"  # a cause that cases find in several ways
KEPT = 4096  # bytes of one entry of a log that are kept
FRAME_LIMIT = 64 << 20  # a server that sends more without a delimiter will not send one


@dataclass(frozen=True, slots=True)
class Entry:
    """Something that happened on a wire.

    Attributes:
        at: Seconds since the case began.
        wire: Which connection of the case.
        kind: `sent`, `received` or `note`.
        data: The bytes, or the note; of long ones the beginning and the end, as much of the one as of the other.
        left_out: How many bytes there were between the two.
    """

    at: float
    wire: str
    kind: str
    data: bytes
    left_out: int = 0


@dataclass(slots=True)
class Log:
    """The log of all connections of one case."""

    entries: list[Entry] = field(default_factory=list)
    began: float = field(default_factory=time.monotonic)

    def add(self, wire: str, kind: str, data: bytes) -> None:
        """Adds an entry of this moment."""
        left_out = max(len(data) - KEPT, 0)
        kept = data[: KEPT // 2] + data[-KEPT // 2 :] if left_out else data
        self.entries.append(Entry(time.monotonic() - self.began, wire, kind, kept, left_out))


class Message(dict[str, Any]):
    """A JSON object of the server's. To read a field that is not there is a finding, not a mistake of the suite."""

    def __missing__(self, key: str) -> NoReturn:
        raise Finding(f"a field {key!r}", clip(self), f"a message without {key!r}")


class Wire:
    """A connection. Frames that `hear` finds are kept in order until asked for."""

    def __init__(self, host: str, port: int, timeout: float, log: Log, name: str, scheme: str = "tcp") -> None:
        """Connects, over TCP or by a WebSocket (`ws`).

        Raises:
            Finding: Nobody answers.
        """
        self.timeout = timeout
        self.name = name
        self.half_closes = scheme == "tcp"  # whether reading can go on where nothing more is sent
        self.ending = "open"
        self._log = log
        self._buffer = bytearray()
        self._said = 0
        try:
            self._socket = self._connect(host, port, timeout, scheme)
        except OSError as error:
            log.add(name, "note", f"cannot connect: {error}".encode())
            raise Finding("a connection", str(error), "no connection") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    @staticmethod
    def _connect(host: str, port: int, timeout: float, scheme: str) -> socket.socket | WebSocketSocket:
        if scheme == "tcp":
            return socket.create_connection((host, port), timeout)
        from nmes.conformance.websocket import WebSocketSocket  # whose library takes a while to load

        return WebSocketSocket(host, port, timeout)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # -- out -------------------------------------------------------------------------------------------------------

    def send(self, data: bytes) -> None:
        """Sends bytes; that the server has hung up is noted, and the next read reports it."""
        self._log.add(self.name, "sent", data)
        self._socket.settimeout(self.timeout)
        try:
            self._socket.sendall(data)
        except TimeoutError:
            expected = f"a server that reads, within {self.timeout:g} s"
            raise Finding(expected, "nothing is read", "the server does not read") from None
        except OSError as error:
            self._end("reset by the server", f"sending failed: {error}")

    def say(self, *messages: Mapping[str, Any]) -> None:
        """Sends messages in one write."""
        self.send(b"".join(map(frame_of, messages)))

    def stuff(self, data: bytes, most: int, patience: float) -> int:
        """Sends the same bytes again and again, reading nothing, until the server takes no more; returns how many.

        Ends after `most` bytes, when nothing was taken for `patience` s, or when the time-out is over.
        """
        until = time.monotonic() + self.timeout
        self._socket.settimeout(patience)
        sent = 0
        try:
            while sent < most and time.monotonic() < until:
                sent += self._socket.send(data[sent % len(data) :])
        except OSError as error:  # also when it takes no more: that is the point
            self._log.add(self.name, "note", f"stopped sending: {error}".encode())
        self._log.add(self.name, "note", f"sent {sent} bytes, the same {len(data)} again and again".encode())
        return sent

    def ready(self, timeout: float | None = None) -> bool:
        """Whether there is something to read, be it the end, within the time-out."""
        self._socket.settimeout(self.timeout if timeout is None else timeout)
        try:
            self._socket.recv(1, socket.MSG_PEEK)
        except TimeoutError:
            return False
        except OSError:  # it was reset: the next read tells
            return True
        return True

    def hang_up(self) -> None:
        """Closes the sending side of the connection; reading goes on, where there are two sides (`half_closes`)."""
        self._log.add(self.name, "note", b"nothing more will be sent")
        self._socket.settimeout(self.timeout)
        try:
            self._socket.shutdown(socket.SHUT_WR)
        except OSError as error:
            self._end("reset by the server", str(error))

    def reset(self) -> None:
        """Breaks the connection off without a goodbye."""
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        self.close()

    def cut(self) -> None:
        """Ends the connection for whoever waits on it in another thread."""
        with suppress(OSError):  # it has ended already
            self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Closes the connection."""
        self._socket.close()
        self._end("closed by the suite", "closed by the suite")

    def _end(self, ending: str, note: str) -> None:
        if self.ending == "open":
            self.ending = ending
            self._log.add(self.name, "note", note.encode())

    # -- in --------------------------------------------------------------------------------------------------------

    def frame(self, timeout: float | None = None, what: str = "a frame") -> bytes:
        """Returns the next frame that is not empty, without white space around it."""
        until = time.monotonic() + (self.timeout if timeout is None else timeout)
        while True:
            end = self._buffer.find(DELIMITER)
            if end >= 0:
                frame = bytes(self._buffer[:end]).strip(b" \t\r\n")
                del self._buffer[: end + len(DELIMITER)]
                if frame:
                    return frame
            elif not self._receive(until, what):
                rest = f" with {bytes(self._buffer[:SHOWN])!r} and no delimiter" if self._buffer else ""
                raise self._ended(what, rest)

    def hear(self, timeout: float | None = None, what: str = "a message") -> Message:
        """Returns the next message, strict JSON that its schema allows."""
        return read_message(self.frame(timeout, what))

    def messages(self, what: str, timeout: float | None = None) -> Iterator[Message]:
        """Yields the messages that come, without end; all that are taken must come within one time-out."""
        until = time.monotonic() + (self.timeout if timeout is None else timeout)
        while True:
            yield self.hear(until - time.monotonic(), what)

    def reply(self, what: str = "a reply", timeout: float | None = None) -> Message:
        """Returns the next message that is no event."""
        return next(message for message in self.messages(what, timeout) if not is_event(message))

    def ask(self, command: Mapping[str, Any], timeout: float | None = None) -> Message:
        """Sends a command, with an `id` if it has none, and returns the next message, be it reply or error.

        Raises:
            Finding: Nothing comes, it is no valid message, or its `id` is not the command's.
        """
        if "id" not in command:
            self._said += 1
            command = {**command, "id": f"{self.name}-{self._said}"}
        self.say(command)
        reply = self.reply(f"a reply to {command['type']}", timeout)
        if "id" not in reply or reply["id"] != command["id"]:
            cause = "a reply with another id than the command's" if "id" in reply else NO_ID
            raise Finding(f"a reply with id {json.dumps(command['id'])}", clip(reply), cause)
        return reply

    def rest(self, timeout: float | None = None, whole: bool = True) -> list[bytes]:
        """Waits until the server hangs up; returns the frames that came before, `whole` ones or also a part of one.

        Raises:
            Finding: It does not hang up in time.
        """
        until = time.monotonic() + (self.timeout if timeout is None else timeout)
        while self._receive(until, "the end of the connection"):
            pass
        frames = [frame.strip(b" \t\r\n") for frame in bytes(self._buffer).split(DELIMITER)]
        self._buffer.clear()
        if whole and frames.pop():
            raise Finding("whole frames before the end of the connection", "one without its delimiter")
        return [frame for frame in frames if frame]

    def quiet(self, seconds: float) -> None:
        """Makes sure that nothing comes for a while.

        Raises:
            Finding: Something does.
        """
        until, came = time.monotonic() + seconds, False
        while DELIMITER not in self._buffer:
            left = until - time.monotonic()
            if len(self._buffer) >= FRAME_LIMIT or (came and left <= 0):
                break  # it goes on and on, be it without a delimiter
            self._socket.settimeout(max(left, 0.001))
            try:
                data = self._socket.recv(READ)
            except TimeoutError:
                return
            except OSError as error:
                self._end("reset by the server", str(error))
                data = b""
            if not data:
                self._end("closed by the server", "closed by the server")
                raise self._ended("silence and an open connection")
            self._take(data)
            came = True
        raise Finding("no frame", clip(bytes(self._buffer)))

    def _receive(self, until: float, what: str) -> bool:
        """Reads once; returns False at the end of the connection."""
        left = until - time.monotonic()
        if left > 0 and len(self._buffer) < FRAME_LIMIT:
            self._socket.settimeout(left)
            try:
                data = self._socket.recv(READ)
            except TimeoutError:
                pass
            except OSError as error:
                self._end("reset by the server", str(error))
                return False
            else:
                if not data:
                    self._end("closed by the server", "closed by the server")
                    return False
                self._take(data)
                return True
        self._log.add(self.name, "note", b"time is up")
        self.ending = "timed out" if self.ending == "open" else self.ending
        rest = f"only {clip(bytes(self._buffer))}" if self._buffer else "nothing"
        raise Finding(f"{what} in time", rest, "a frame that does not end" if self._buffer else "nothing in time")

    def _ended(self, expected: str, rest: str = "") -> Finding:
        """Returns the finding that the connection has ended where it should not have."""
        return Finding(expected, f"the end of the connection{rest} ({self.ending})", f"a connection {self.ending}")

    def _take(self, data: bytes) -> None:
        self._log.add(self.name, "received", data)
        self._buffer += data


def frame_of(message: Mapping[str, Any]) -> bytes:
    """Returns a message as its bytes, delimiter included."""
    return json.dumps(message, separators=(",", ":")).replace("<", "\\u003c").encode() + DELIMITER


def clip(value: Any) -> str:
    """Returns a value as short text."""
    text = value if isinstance(value, str) else value.decode("utf-8", "replace") if isinstance(value, bytes) else ""
    text = text or json.dumps(value, default=repr)
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}... ({len(text)} characters)"


def read_message(frame: bytes) -> Message:
    """Reads a frame of a server as a message: a JSON object of a known type that fits its schema.

    Raises:
        Finding: It is not.
    """
    message = read_json(frame)
    try:
        if is_event(message):
            validate_event(message)
        else:
            validate_reply(message)
    except NmesError as error:
        expected = f"a message as its schema says ({error.message})"
        kind = message.get("type")
        known = kind if isinstance(kind, str) and (kind in REPLIES or kind in EVENTS) else "of no known type"
        raise Finding(expected, clip(frame), f"a message {known} against its schema") from error
    return message


def is_event(message: Mapping[str, Any]) -> bool:
    """Whether a message was not asked for."""
    kind = message.get("type")
    return isinstance(kind, str) and kind in EVENTS


def read_json(frame: bytes) -> Message:
    """Reads a frame as a strict JSON object.

    Raises:
        Finding: It is not one.
    """

    def refuse(constant: str) -> NoReturn:
        raise ValueError(f"{constant} is not JSON")

    def number(text: str) -> float:
        value = float(text)
        if value in (float("inf"), float("-inf")):
            raise ValueError(f"{text[:SHOWN]} is infinite")
        return value

    def whole(text: str) -> int:
        number(text)
        return int(text)

    def pairs(items: list[tuple[str, Any]]) -> Message:
        message = Message(items)
        if len(message) != len(items):
            raise ValueError("a key occurs twice")
        return message

    try:
        text = frame.decode()
        value = json.loads(text, object_pairs_hook=pairs, parse_constant=refuse, parse_float=number, parse_int=whole)
        if "\\u" in text:
            json.dumps(value, ensure_ascii=False).encode()  # refuses lone surrogates
        if isinstance(value, Message):
            decode(frame)  # refuses what is nested too deep
    except (ValueError, RecursionError) as error:
        raise Finding(f"strict JSON ({error})", clip(frame), "no strict JSON") from error
    if not isinstance(value, Message):
        raise Finding("a JSON object", clip(frame))
    return value
