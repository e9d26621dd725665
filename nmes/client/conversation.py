"""The common part of both clients: a connection's protocol without I/O, their settings, and their errors.

Hides the json dialect: framing, authentication, numbering of commands and matching of replies.

Invariants: every command carries an `id`, so an error without one speaks of the connection, never of a command; replies
come in the order of the commands, so a reply that comes too late for a caller that gave up is dropped, not mistaken for
another's; a failed command raises `CommandFailed` with the server's code, a lost connection raises `Disconnected`.
"""

from __future__ import annotations

import os
import ssl
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, cast

import orjson

from nmes.client.declaration import Pending
from nmes.client.replies import AuthSuccess, Event, WorldSummary
from nmes.errors import CommandFailed, Disconnected, RejectedMessage
from nmes.protocol import DELIMITER, PASSWORD_VARIABLE, FrameSplitter, encode
from nmes.schemas.documents import unwritable_number

__all__ = ["EVENT_BACKLOG", "READ", "ClientBase", "Conversation", "created", "understood", "world_list"]

# Bytes. A world of 10,000 cubes is a reply of some megabytes; a server is trusted more than its clients are.
REPLY_LIMIT = 256 << 20
# Bytes of one read. More is slower: for more than 128 KiB the memory is asked of the system, each time.
READ = 64 << 10
# Events that nobody reads are dropped, the oldest first, so that a client which subscribes and never reads stays small.
EVENT_BACKLOG = 10_000


class Conversation:
    """One connection as its client sees it: bytes out for commands, bytes in for replies and events."""

    def __init__(self, events: deque[Event], tls: bool) -> None:
        self._tls = tls
        self._answered = False
        self._splitter = FrameSplitter(REPLY_LIMIT)
        self._events = events
        self._waiting: deque[tuple[int | None, Pending[Any]]] = deque()
        self._sent = 0
        self.lost: Disconnected | None = None
        self.world_closed = False

    def authenticate(self, password: str, **options: Any) -> tuple[bytes, Pending[Any]]:
        """Returns the bytes of an `auth` message with the options that are not None, and its reply to come."""
        fields = {name: value for name, value in options.items() if value is not None}
        message = {"type": "auth", "password": password, **fields}
        pending: Pending[Any] = Pending({"type": "auth"})
        self._waiting.append((None, pending))
        return encode(message) + DELIMITER, pending

    def request(self, calls: Sequence[Pending[Any]]) -> bytes:
        """Numbers commands and returns their bytes.

        Raises:
            Disconnected: The connection is lost.
            ValueError: A command has a number that is none (nan, inf), or that JSON cannot; none is sent.
        """
        if self.lost is not None:
            raise self.lost
        # All are encoded before any is counted as sent, so that one that cannot be does not put the rest out of step.
        frames = [encode({**call.message, "id": self._sent + n}) for n, call in enumerate(calls)]
        for call, frame in zip(calls, frames, strict=True):
            wrong = unwritable_number(call.message, frame)
            if wrong is not None:
                raise ValueError(f"{call.message.get('type')}: {wrong[0]}: {wrong[1]}")
        for call in calls:
            self._waiting.append((self._sent, call))
            self._sent += 1
        return b"".join([frame + DELIMITER for frame in frames])

    def receive(self, data: bytes) -> None:
        """Takes bytes that came: replies go to the calls that wait for them, events to the queue."""
        try:
            for frame in self._splitter.feed(data):
                self._take(orjson.loads(frame))
            if self._splitter.exceeded:
                raise RejectedMessage("frame_too_large", f"longer than {REPLY_LIMIT} bytes")
        except (orjson.JSONDecodeError, RejectedMessage) as error:
            self.lose(Disconnected("bad_reply", f"the server sent what is not a message: {error}"))

    def _take(self, message: Any) -> None:
        if not isinstance(message, dict):
            raise RejectedMessage("bad_frame", f"not an object: {message!r}")
        self._answered = True
        number = message.pop("id", None)
        if self._waiting and self._waiting[0][0] == number:
            self._waiting.popleft()[1].resolve(message)
        elif number is not None:
            self.lose(Disconnected("bad_reply", f"the server answered a command that was not next in line: {number!r}"))
        elif message.get("type") == "error":
            self.lose(Disconnected(str(message.get("code")), str(message.get("message"))))
        else:
            self.world_closed |= message.get("type") == "world_closed"
            self._events.append(cast(Event, message))

    def lose(self, error: Disconnected) -> None:
        """Fails every call that still waits; the first error is the one that counts."""
        self.lost = self.lost or error
        while self._waiting:
            self._waiting.popleft()[1].fail(self.lost)

    def end(self) -> None:
        """Notes that the server closed the connection."""
        if self.world_closed:
            self.lose(Disconnected("world_closed", "the server closed the world"))
        elif not (self._answered or self._tls):
            hint = "if it speaks TLS, so must you: tls=True, or --tls"
            self.lose(Disconnected("disconnected", f"the server hung up without an answer; {hint}"))
        else:
            self.lose(Disconnected("disconnected", "the server closed the connection"))


class ClientBase:
    """The base of both clients: settings, the event queue, and errors.

    Attributes:
        host: Name or address of the server.
        port: Its TCP port.
        world: The name of the world; None: the server's first.
        role: The role that is asked for; None: the first that the password opens.
        token: In a world with roles, the secret that makes the next connection the same player's, while the server
            runs; None: the next one is somebody new.
        timeout: How long a reply may take, s; None: for ever.
        on_event: What is called with each event.
    """

    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = 14000,
        *,
        password: str | None = None,
        world: str | None = None,
        role: str | None = None,
        token: str | None = None,
        timeout: float | None = 10.0,
        tls: bool | ssl.SSLContext = False,
        tls_ca: str | os.PathLike[str] | None = None,
        on_event: Callable[[Event], None] | None = None,
    ) -> None:
        """Remembers where to connect to; `connect` (or a `with` block) does it.

        Args:
            host: Name or address of the server. Default: this machine.
            port: Its TCP port. Default: 14000.
            password: The server's password. Default: what the environment's variable `NMES_PASSWORD` says.
            world: The name of one of the server's worlds. Default: its first.
            role: In a world with roles, one that the password opens. Default: the first of those.
            token: That of an earlier connection (`token`), to be its player again. Default: somebody new.
            timeout: How long a reply may take, in s, before `TimeoutError` is raised; None waits for ever. May be
                changed later. Default: 10.
            tls: True speaks TLS with a server whose certificate the system trusts; an SSL context says more than that.
                Default: plain TCP.
            tls_ca: A PEM file of certificates: speak TLS, and trust these.
            on_event: Called with each event when it is received, in place of the queue that `events` reads. What it
                raises, the call raises that reads; of an AsyncClient, the loop's exception handler is told. Default:
                the queue, which keeps the last 10,000 events.

        Raises:
            ValueError: There is no password, or `tls_ca` has no certificates, or stands beside an SSL context.
            OSError: The file of certificates cannot be read.
        """
        self.host = host
        self.port = port
        self.world = world
        self.role = role
        self.token = token
        self.timeout = timeout
        self.on_event = on_event
        self._tls = _trust(tls, tls_ca)
        self._password = _password(password)
        self._queue: deque[Event] = deque(maxlen=EVENT_BACKLOG)
        self._conversation = self._new_conversation()
        self._conversation.lose(Disconnected("not_connected", "the client is not connected"))
        self._welcome: AuthSuccess | None = None

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.host!r}, {self.port}, world={self.world!r})"

    @property
    def welcome(self) -> AuthSuccess:
        """The server's reply to this client's authentication: world, engine, tick rate (1/s), this client's number.

        Raises:
            Disconnected: `not_connected`: the client has not connected yet.
        """
        if self._welcome is None:
            raise Disconnected("not_connected", "the client has not connected yet")
        return self._welcome

    def _entered(self, welcome: AuthSuccess) -> None:
        """Keeps the server's answer, and the token in it, with which the next connection is the same player's."""
        self._welcome = welcome
        self.token = welcome.get("token", self.token)

    def _new_conversation(self) -> Conversation:
        self._queue.clear()
        return Conversation(self._queue, self._tls is not None)

    def deliver(self) -> None:
        """Hands the events received so far to `on_event`, which may raise: the read that brought them is complete."""
        while self.on_event is not None and self._queue:
            self.on_event(self._queue.popleft())

    def _unreachable(self, error: Exception) -> Disconnected:
        plain = isinstance(error, ssl.SSLError) and error.reason in ("WRONG_VERSION_NUMBER", "RECORD_LAYER_FAILURE")
        hint = "; it may speak no TLS" if plain else ""
        return Disconnected("unreachable", f"cannot connect to {self.host}:{self.port}: {error}{hint}")

    def _late(self) -> TimeoutError:
        return TimeoutError(f"{self.host}:{self.port} did not answer within {self.timeout} s")

    def _no_more_events(self) -> None:
        """Ends an iteration over events quietly when the world was closed, else with the reason of the loss."""
        if self._conversation.lost is not None and not self._conversation.world_closed:
            raise self._conversation.lost


def _password(given: str | None) -> str:
    password = os.environ.get(PASSWORD_VARIABLE) if given is None else given
    if not password:
        raise ValueError(f"a client needs the server's password: give password=, or set {PASSWORD_VARIABLE}")
    return password


def _trust(tls: bool | ssl.SSLContext, authority: str | os.PathLike[str] | None) -> ssl.SSLContext | None:
    """Returns the context that knows which certificates are trusted; None for plain TCP."""
    if authority is None:
        return ssl.create_default_context() if tls is True else tls or None
    if isinstance(tls, ssl.SSLContext):
        raise ValueError("give tls_ca, or an SSL context as tls, which says itself what it trusts; not both")
    try:
        return ssl.create_default_context(cafile=authority)
    except ssl.SSLError as error:
        raise ValueError(f"{os.fspath(authority)} has no certificates in PEM: {error}") from None
    except OSError as error:
        raise OSError(error.errno, error.strerror, os.fspath(authority)) from None


def world_list(answer: Any, verb: str) -> tuple[list[WorldSummary], int | None]:
    """Returns the worlds of a server's answer to an `auth` that asks it to `list` them, or to `create` or `close` one.

    With them comes where the next page starts; None: there is none.

    Raises:
        CommandFailed: `unsupported`: the server accepted the `auth`, but did not do what it asks.
    """
    if answer["type"] != "world_list" or "worlds" not in answer:
        raise CommandFailed("unsupported", f"this server does not {verb} its worlds")
    return cast(list[WorldSummary], answer["worlds"]), answer.get("next")


def created(worlds: list[WorldSummary], name: str) -> WorldSummary:
    """Returns the world of a name of a server's answer to an `auth` that asks it to create that.

    Raises:
        CommandFailed: `unsupported`: it is not there.
    """
    for world in worlds:
        if world["world"] == name:
            return world
    raise CommandFailed("unsupported", f"this server did not create {name!r}: its answer does not tell of it")


@contextmanager
def understood() -> Iterator[None]:
    """Raises Disconnected (`bad_reply`) where what a server answers is not what the protocol says."""
    try:
        yield
    except (LookupError, TypeError, ValueError) as error:
        what = f"{type(error).__name__}: {error}"
        raise Disconnected("bad_reply", f"the server sent what is no answer: {what}") from error
