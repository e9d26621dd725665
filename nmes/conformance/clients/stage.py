"""One case being played against a client: the driver on one side, the server's end of its connections on the other.

It hides sockets and the driver's lines. A case tells the driver what to have the client do, plays the server, and
judges what the client sent and what the driver says that it got. Invariants: no call waits for longer than the
time-out; what the client does wrong is a `Finding`, never another exception; every command that `Peer.command` returns
is valid.
"""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

from nmes.conformance.case import Finding, NotTried
from nmes.conformance.clients.driver import Driver
from nmes.conformance.wire import Log, clip, read_json
from nmes.protocol import DELIMITER, FrameSplitter, parse

__all__ = ["PASSWORD", "Peer", "Stage", "frame", "tick"]

PASSWORD = "sesame"
WORLD = "arena"
_WELCOME = {
    "type": "auth_success", "protocol": 1, "client": 1, "world": WORLD, "backend": "none", "dims": 3,
    "timestep": 1 / 60, "tick_rate": 60, "mode": "lockstep",
}  # fmt: skip
_READ = 64 << 10
_FRAME_LIMIT = 1 << 20  # bytes: what a server accepts
_REST_LIMIT = 64 << 20  # bytes: a client that sends more before it hangs up will not hang up


def frame(message: Mapping[str, Any]) -> bytes:
    """Returns a message as bytes of UTF-8, delimiter included."""
    text = json.dumps(message, ensure_ascii=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").encode() + DELIMITER


def tick(number: int) -> dict[str, Any]:
    """Returns the event of a tick."""
    return {"type": "tick", "frame": number, "t": number / 60}


class Peer:
    """The server's end of a connection of the client."""

    def __init__(self, connection: socket.socket, log: Log, name: str, timeout: float) -> None:
        self._socket, self._log, self._name, self._timeout = connection, log, name, timeout
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.settimeout(timeout)
        self._splitter = FrameSplitter(_FRAME_LIMIT)
        self._frames: list[bytes] = []

    # -- in --------------------------------------------------------------------------------------------------------

    def frame(self, what: str) -> bytes:
        """Returns the client's next frame, without white space around it.

        Raises:
            Finding: None comes in time, or the client hangs up.
        """
        until = time.monotonic() + self._timeout
        while not self._frames:
            data = self._receive(until, what)
            if not data:
                raise Finding(what, "the end of the connection", "a client that hangs up")
            self._frames += reversed(self._splitter.feed(data))
            if self._splitter.exceeded:
                raise Finding(f"{what} of at most {_FRAME_LIMIT:,} bytes", "a longer one", "a frame that does not end")
        return self._frames.pop()

    def command(self, kind: str) -> dict[str, Any]:
        """Returns the client's next command, which must be valid and of a type."""
        request = parse(self.frame(f"the command {kind}"))
        if request.command is None:
            reason = request.error.message if request.error else "not a command"
            raise Finding(f"a valid command {kind} ({reason})", clip(request.raw), "an invalid command")
        if request.ignored:
            raise Finding(f"a command {kind} of fields that it has", ", ".join(request.ignored), "unknown fields")
        if request.command["type"] != kind:
            raise Finding(f"the command {kind}", clip(request.raw), "another command than the program's")
        return dict(request.command)

    def rest(self) -> bytes:
        """Waits until the client hangs up; returns what it sent before.

        Raises:
            Finding: It does not hang up in time, or sends without end.
        """
        until, rest = time.monotonic() + self._timeout, bytearray(b"".join(reversed(self._frames)))
        while data := self._receive(until, "the end of the connection"):
            rest += data
            if len(rest) > _REST_LIMIT:
                raise Finding("the end of the connection", f"over {_REST_LIMIT:,} bytes", "a client that sends on")
        return bytes(rest)

    def _receive(self, until: float, what: str) -> bytes:
        """Reads once; empty at the end of the connection."""
        left = until - time.monotonic()
        try:
            if left <= 0:
                raise TimeoutError
            self._socket.settimeout(left)
            data = self._socket.recv(_READ)
        except TimeoutError:
            raise Finding(f"{what} in time", "nothing", "nothing in time") from None
        except OSError:  # reset by the client, which is an end too
            data = b""
        self._log.add(self._name, "received", data)
        return data

    # -- out -------------------------------------------------------------------------------------------------------

    def send(self, data: bytes) -> None:
        """Sends bytes as they are.

        Raises:
            Finding: The client does not read them, or has hung up.
        """
        self._log.add(self._name, "sent", data)
        self._socket.settimeout(self._timeout)
        try:
            self._socket.sendall(data)
        except TimeoutError:
            raise Finding("a client that reads what comes", "it does not", "a client that does not read") from None
        except OSError as error:
            raise Finding("an open connection", str(error), "a client that hangs up") from error

    def say(self, *messages: Mapping[str, Any]) -> None:
        """Sends messages, all in one write."""
        self.send(b"".join(map(frame, messages)))

    def answer(self, command: Mapping[str, Any], kind: str, **fields: Any) -> None:
        """Sends the reply to a command."""
        self.say(self.reply(command, kind, **fields))

    def reply(self, command: Mapping[str, Any], kind: str, **fields: Any) -> dict[str, Any]:
        """Returns the reply to a command, with the command's id if it has one."""
        return {"type": kind, **fields, **({"id": command["id"]} if "id" in command else {})}

    def close(self) -> None:
        """Hangs up."""
        self._socket.close()

    def reset(self) -> None:
        """Breaks the connection off without a goodbye."""
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        self._socket.close()


class Stage:
    """The context of one case."""

    def __init__(self, listener: socket.socket, driver: Driver, timeout: float) -> None:
        self.log = Log()
        self.timeout = timeout
        self._listener = listener
        self._driver = driver
        self._peers: list[Peer] = []

    def close(self) -> None:
        """Closes the connections of the case, and those that nobody asked for."""
        for peer in self._peers:
            peer.close()
        self._listener.setblocking(False)
        with suppress(BlockingIOError):
            while True:
                self._listener.accept()[0].close()

    # -- the driver ------------------------------------------------------------------------------------------------

    def tell(self, do: str, **fields: Any) -> None:
        """Gives the driver an instruction."""
        self._driver.tell(self.log, self.timeout, {"do": do, **fields})

    def hear(self, what: str) -> dict[str, Any]:
        """Returns the driver's answer."""
        return self._driver.hear(self.log, self.timeout, what)

    def waits(self, seconds: float = 0.05) -> None:
        """Makes sure that the driver does not answer yet."""
        if not self._driver.silent(seconds):
            raise Finding("no answer yet", clip(self.hear("something that is not done yet")), "an answer too early")

    # -- connections -----------------------------------------------------------------------------------------------

    def connect(self, password: str = PASSWORD, **options: Any) -> Peer:
        """Has the client connect; returns the connection before anything was read of it."""
        host, port = self._listener.getsockname()[:2]
        self.tell("open", host=host, port=port, password=password, **options)
        return self.accept()

    def accept(self) -> Peer:
        """Returns the next connection."""
        self._listener.settimeout(self.timeout)
        try:
            connection, _ = self._listener.accept()
        except TimeoutError:
            if not self._driver.silent(0):
                answer = self.hear("open")
                raise Finding("a connection", clip(answer), "no connection") from None
            raise Finding("a connection in time", "none", "no connection") from None
        peer = Peer(connection, self.log, f"connection {len(self._peers) + 1}", self.timeout)
        self._peers.append(peer)
        return peer

    def auth(self, peer: Peer, password: str = PASSWORD) -> dict[str, Any]:
        """Reads the first frame, which must say the password."""
        message = read_json(peer.frame("auth"))
        if message.get("type") != "auth" or message.get("password") != password:
            raise Finding(f"auth with the password {password!r}", clip(message), "wrong auth")
        return message

    def enter(self, **options: Any) -> Peer:
        """Has the client connect, and lets it in."""
        peer = self.connect(**options)
        self.auth(peer)
        peer.say(_WELCOME)
        self.opened(WORLD)
        return peer

    def welcome(self) -> dict[str, Any]:
        """Returns the reply that lets a client in."""
        return dict(_WELCOME)

    def opened(self, world: str) -> None:
        """Makes sure that the client is in."""
        opened = self.hear("open").get("opened")
        if not isinstance(opened, dict) or opened.get("world") != world:
            raise Finding(f"opened, with the world {world}", clip(opened), "a client that is not in")

    def free_port(self) -> int:
        """Returns a port on which nobody listens."""
        with socket.create_server((self._listener.getsockname()[0], 0)) as other:
            return int(other.getsockname()[1])

    # -- what the client got ---------------------------------------------------------------------------------------

    def ask(self, peer: Peer, command: Mapping[str, Any]) -> dict[str, Any]:
        """Has the client send a command; returns it as it came."""
        self.tell("send", command=command)
        return peer.command(command["type"])

    def ping(self, peer: Peer) -> None:
        """Makes sure that the client still works."""
        peer.answer(self.ask(peer, {"type": "ping"}), "pong")
        self.got({})

    def got(self, fields: Mapping[str, Any]) -> None:
        """Makes sure that the client has got the reply, with these fields."""
        self.outcome(self.hear("send"), fields)

    def outcome(self, outcome: Any, fields: Mapping[str, Any]) -> None:
        """Makes sure that an outcome is a reply with these fields."""
        reply = outcome.get("reply") if isinstance(outcome, dict) else None
        if not isinstance(reply, dict) or any(reply.get(name) != value for name, value in fields.items()):
            raise Finding(f"a reply with {clip(fields)}", clip(outcome), "a wrong reply")

    def refused(self, outcome: Any, code: str, message: str, field: str | None = None) -> None:
        """Makes sure that an outcome is an error of the server's."""
        told = outcome.get("error") if isinstance(outcome, dict) else None
        wanted = {"code": code, "message": message} | ({} if field is None else {"field": field})
        if not isinstance(told, dict) or any(told.get(name) != value for name, value in wanted.items()):
            raise Finding(f"error {clip(wanted)}", clip(outcome), "a wrong error")

    def lost(self, outcome: Any, code: str = "") -> None:
        """Makes sure that an outcome is the loss of the connection, told with a code if the server gave one."""
        words = outcome.get("lost") if isinstance(outcome, dict) else None
        if not isinstance(words, str) or code not in words:
            raise Finding(f"lost{', with ' + code if code else ''}", clip(outcome), "a loss that is not told")

    def pipeline(self, commands: Sequence[Mapping[str, Any]]) -> None:
        """Has the client send commands without waiting for replies."""
        self.tell("pipeline", commands=commands)

    def outcomes(self, what: str, count: int) -> list[Any]:
        """Returns the outcomes of the commands of a pipeline or a batch."""
        answer = self.hear(what).get("outcomes")
        if not isinstance(answer, list) or len(answer) != count:
            raise Finding(f"outcomes, {count} of them", clip(answer), "a wrong number of outcomes")
        return answer

    def events(self, expected: Sequence[Mapping[str, Any]]) -> None:
        """Makes sure that the client has these events next, with these fields."""
        self.tell("events", count=len(expected))
        told = self.hear("events").get("events")
        same = isinstance(told, list) and len(told) == len(expected)
        if same:
            same = all(
                isinstance(one, dict) and all(one.get(name) == value for name, value in wanted.items())
                for one, wanted in zip(told or (), expected, strict=True)
            )
        if not same:
            raise Finding(f"the events {clip(list(expected))}", clip(told), "wrong events")

    def true(self, condition: bool, expected: str, received: Any) -> None:
        """Makes sure of something."""
        if not condition:
            raise Finding(expected, clip(received))

    def skip(self, reason: str) -> None:
        """Ends the case, which makes no sense against this client.

        Raises:
            NotTried: Always.
        """
        raise NotTried(reason)
