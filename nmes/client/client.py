"""Programs that drive a served world: `Client` blocks, `AsyncClient` awaits; what both can say is in `commands`.

Hides the json dialect: framing, authentication, numbering of commands and matching of replies.

Invariants: every command carries an `id`, so an error without one speaks of the connection, never of a command; replies
come in the order of the commands, so a reply that comes too late for a caller that gave up is dropped, not mistaken for
another's; a failed command raises `CommandFailed` with the server's code, a lost connection raises `Disconnected`. One
client is for one thread (or one event loop).
"""

from __future__ import annotations

import asyncio
import selectors
import socket
import ssl
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager, contextmanager
from types import TracebackType
from typing import Any, Self, cast

import orjson

from nmes.client.commands import AsyncCommands, BlockingCommands, Pipeline
from nmes.client.declaration import Pending
from nmes.client.replies import AuthSuccess, Event, WorldSummary
from nmes.errors import CommandFailed, Disconnected, RejectedMessage
from nmes.protocol import DELIMITER, FrameSplitter, encode

__all__ = ["AsyncClient", "Client"]

# A world of 10,000 cubes is a reply of some megabytes; a server is trusted more than its clients are.
REPLY_LIMIT = 256 << 20
# Read at once. More is slower: for more than 128 KiB the memory is asked of the system, each time.
READ = 64 << 10
# Events that nobody takes are forgotten from the oldest on, so that who subscribes and never looks stays small.
EVENT_BACKLOG = 10_000
# What a socket that does not block raises in place of waiting.
_NOT_NOW = (BlockingIOError, ssl.SSLWantReadError, ssl.SSLWantWriteError)


# -- the connection, without I/O --------------------------------------------------------------------------------------


class _Conversation:
    """One connection as its client sees it: bytes out for commands, bytes in for replies and events."""

    def __init__(self, events: deque[Event]) -> None:
        self._splitter = FrameSplitter(REPLY_LIMIT)
        self._events = events
        self._waiting: deque[tuple[int | None, Pending[Any]]] = deque()
        self._sent = 0
        self.lost: Disconnected | None = None
        self.world_closed = False

    def authenticate(self, password: str, **wishes: Any) -> tuple[bytes, Pending[Any]]:
        wished = {name: value for name, value in wishes.items() if value is not None}
        message = {"type": "auth", "password": password, **wished}
        pending: Pending[Any] = Pending({"type": "auth"})
        self._waiting.append((None, pending))
        return encode(message) + DELIMITER, pending

    def ask(self, calls: Sequence[Pending[Any]]) -> bytes:
        if self.lost is not None:
            raise self.lost
        # All are encoded before any is counted as sent, so that one that cannot be does not put the rest out of step.
        frames = [encode({**call.message, "id": self._sent + n}) for n, call in enumerate(calls)]
        for call in calls:
            self._waiting.append((self._sent, call))
            self._sent += 1
        return b"".join([frame + DELIMITER for frame in frames])

    def hear(self, data: bytes) -> None:
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
        number = message.pop("id", None)
        if self._waiting and self._waiting[0][0] == number:
            self._waiting.popleft()[1].settle(message)
        elif number is not None:
            self.lose(Disconnected("bad_reply", f"the server answered a command that was not next in line: {number!r}"))
        elif message.get("type") == "error":
            self.lose(Disconnected(str(message.get("code")), str(message.get("message"))))
        else:
            self.world_closed |= message.get("type") == "world_closed"
            self._events.append(cast(Event, message))

    def lose(self, error: Disconnected) -> None:
        self.lost = self.lost or error
        while self._waiting:
            self._waiting.popleft()[1].fail(self.lost)

    def end(self) -> None:
        """Takes note that the server closed the connection."""
        if self.world_closed:
            self.lose(Disconnected("world_closed", "the server closed the world"))
        else:
            self.lose(Disconnected("disconnected", "the server closed the connection"))


class _Base:
    """What both clients are, whichever way they wait."""

    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = 14000,
        *,
        password: str,
        world: str | None = None,
        timeout: float | None = 10.0,
        tls: bool | ssl.SSLContext = False,
        on_event: Callable[[Event], None] | None = None,
    ) -> None:
        """Remembers where to connect to; `connect` (or a `with` block) does it.

        Args:
            host: Name or address of the server.
            port: Its port.
            password: The server's password.
            world: Which of the server's worlds; its first when left out.
            tls: Whether to speak TLS, with a server whose certificate the system trusts; or the context that says whom
                to trust, `ssl.create_default_context(cafile="cert.pem")` for a certificate of one's own.
            timeout: How long a reply may take (s; None: for ever) before `TimeoutError` is raised. May be changed.
            on_event: Called with each event as it is received, in place of the queue that `events` reads.
        """
        self.host = host
        self.port = port
        self.world = world
        self.timeout = timeout
        self.on_event = on_event
        self._tls = ssl.create_default_context() if tls is True else tls or None
        self._password = password
        self._queue: deque[Event] = deque(maxlen=EVENT_BACKLOG)
        self._conversation = self._new_conversation()
        self._conversation.lose(Disconnected("not_connected", "the client is not connected"))
        self._welcome: AuthSuccess | None = None

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.host!r}, {self.port}, world={self.world!r})"

    @property
    def welcome(self) -> AuthSuccess:
        """What the server said when it let this client in: world, engine, tick rate, this client's number."""
        if self._welcome is None:
            raise Disconnected("not_connected", "the client has not connected yet")
        return self._welcome

    def _new_conversation(self) -> _Conversation:
        self._queue.clear()
        return _Conversation(self._queue)

    def deliver(self) -> None:
        """Hands the events received so far to `on_event`; once a read is dealt with, so that it may raise."""
        while self.on_event is not None and self._queue:
            self.on_event(self._queue.popleft())

    def _unreachable(self, error: OSError) -> Disconnected:
        return Disconnected("unreachable", f"cannot connect to {self.host}:{self.port}: {error}")

    def _late(self) -> TimeoutError:
        return TimeoutError(f"{self.host}:{self.port} did not answer within {self.timeout} s")

    def _no_more_events(self) -> None:
        """Ends an iteration over events quietly when the world was closed, else with the reason of the loss."""
        if self._conversation.lost is not None and not self._conversation.world_closed:
            raise self._conversation.lost


def _listed(answer: Any) -> list[WorldSummary]:
    if answer["type"] != "world_list":
        raise CommandFailed("unsupported", "this server does not list its worlds")
    return cast(list[WorldSummary], answer["worlds"])


# -- the clients ------------------------------------------------------------------------------------------------------


class Client(_Base, BlockingCommands):
    """A connection that blocks until replies come.

    ```python
    with nmes.Client(password="...") as client:
        name = client.spawn_cube(position=[0, 2, 0])["spawned"]
        with client.pipeline() as together:
            together.apply_physics(name, force=[5, 0, 0])
            together.step()
            seen = together.get_cube_info(name)
        print(seen.result()["position"])
    ```
    """

    _socket: socket.socket | None = None
    _selector: selectors.BaseSelector
    _unsent = b""

    def __enter__(self) -> Self:
        return self if self._socket is not None else self.connect()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def connect(self) -> Self:
        """Connects and authenticates.

        Raises:
            Disconnected: Nothing listens there, or it hung up.
            CommandFailed: The server said no (`auth_failed`, `world_not_found`, `too_many_connections`, ...).
            TimeoutError: No answer came in time.
        """
        self._welcome = self._enter(world=self.world)
        return self

    def worlds(self) -> list[WorldSummary]:
        """Asks which worlds the server has, over a connection that joins none of them; raises as `connect` does."""
        asking = Client(self.host, self.port, password=self._password, timeout=self.timeout, tls=self._tls or False)
        try:
            return _listed(asking._enter(list=True))
        finally:
            asking.close()

    def _enter(self, **wishes: Any) -> Any:
        """Connects and authenticates; returns the server's answer."""
        if self._socket is not None:
            raise RuntimeError("the client is connected already; reconnect() starts anew")
        try:
            connection = socket.create_connection((self.host, self.port), self.timeout)
            self._socket = self._tls.wrap_socket(connection, server_hostname=self.host) if self._tls else connection
        except OSError as error:
            raise self._unreachable(error) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._socket, selectors.EVENT_READ)
        self._conversation = self._new_conversation()
        self._unsent, answer = self._conversation.authenticate(self._password, **wishes)
        try:
            self._wait(lambda: answer.done, self.timeout)
            return answer.result()
        except BaseException:
            self.close()
            raise

    def reconnect(self) -> Self:
        """Connects anew, as another client of the world: subscriptions and events not yet taken are gone."""
        self.close()
        return self.connect()

    def close(self) -> None:
        """Closes the connection; what this client spawned lives on."""
        if self._socket is not None:
            self._selector.close()
            self._socket.close()
            self._socket = None
            self._unsent = b""
            self._conversation.lose(Disconnected("not_connected", "the client was closed"))

    def request(self, message: Mapping[str, Any]) -> Any:
        """Sends a command given as a dict, and returns its reply."""
        pending: Pending[Any] = Pending(dict(message))
        self._exchange([pending])
        return pending.result()

    @contextmanager
    def pipeline(self) -> Iterator[Pipeline]:
        """Collects commands; when the block ends, sends them in one write and waits for all replies.

        Raises:
            CommandFailed: The first failure among them; the others' results can be had all the same.
        """
        pipeline = Pipeline()
        yield pipeline
        self._exchange(pipeline.calls)
        for call in pipeline.calls:
            call.result()

    def events(self, timeout: float | None = None) -> Iterator[Event]:
        """Yields events in the order in which they came, waiting for more.

        Ends when none came for `timeout` s, or after `world_closed`.

        Raises:
            Disconnected: The connection was lost.
        """
        while True:
            while self._queue:
                yield self._queue.popleft()
            if self._conversation.lost is not None:
                return self._no_more_events()
            try:
                self._wait(lambda: bool(self._queue) or self._conversation.lost is not None, timeout)
            except TimeoutError:
                return

    def _exchange(self, calls: Sequence[Pending[Any]]) -> None:
        if calls:
            self._unsent += self._conversation.ask(calls)
            self._wait(lambda: calls[-1].done, self.timeout)  # replies come in order: the last is the last

    def _wait(self, done: Callable[[], bool], timeout: float | None) -> None:
        """Sends and receives until `done`; both at once, so that neither side waits for the other to read."""
        assert self._socket is not None
        deadline = None if timeout is None else time.monotonic() + timeout
        while not done():
            try:
                if self._unsent:
                    self._unsent = self._unsent[self._socket.send(self._unsent) :]
            except _NOT_NOW:
                pass
            except OSError:
                # The server closed; what it said before is still to be read.
                self._unsent = b""
            self._selector.modify(self._socket, selectors.EVENT_READ | (selectors.EVENT_WRITE if self._unsent else 0))
            left = None if deadline is None else max(deadline - time.monotonic(), 0.0)
            if not self._selector.select(left):
                raise self._late()
            try:
                data = self._socket.recv(READ)
            except _NOT_NOW:
                continue
            except OSError:
                data = b""
            if data:
                self._conversation.hear(data)
                self.deliver()
            else:
                self._conversation.end()


class AsyncClient(_Base, AsyncCommands):
    """A connection whose commands are awaited; many tasks may use it at once.

    ```python
    async with nmes.AsyncClient(password="...") as client:
        await client.subscribe(events=["state"])
        async for event in client.events():
            print(event)
    ```
    """

    _link: _Link | None = None

    async def __aenter__(self) -> Self:
        return self if self._link is not None else await self.connect()

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def connect(self) -> Self:
        """Connects and authenticates; raises as `Client.connect` does."""
        self._welcome = await self._enter(world=self.world)
        return self

    async def worlds(self) -> list[WorldSummary]:
        """Asks which worlds the server has, over a connection that joins none of them; raises as `connect` does."""
        asking = AsyncClient(
            self.host, self.port, password=self._password, timeout=self.timeout, tls=self._tls or False
        )
        try:
            return _listed(await asking._enter(list=True))
        finally:
            await asking.close()

    async def _enter(self, **wishes: Any) -> Any:
        """Connects and authenticates; returns the server's answer."""
        if self._link is not None:
            raise RuntimeError("the client is connected already; reconnect() starts anew")
        conversation = self._new_conversation()
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout(self.timeout):
                _, self._link = await loop.create_connection(
                    lambda: _Link(self, conversation), self.host, self.port, ssl=self._tls
                )
        except TimeoutError as error:
            raise self._late() from error
        except OSError as error:
            raise self._unreachable(error) from error
        self._conversation = conversation
        data, answer = conversation.authenticate(self._password, **wishes)
        self._link.transport.write(data)
        try:
            await self._reply(answer)
            return answer.result()
        except BaseException:
            await self.close()
            raise

    async def reconnect(self) -> Self:
        """Connects anew, as another client of the world: subscriptions and events not yet taken are gone."""
        await self.close()
        return await self.connect()

    async def close(self) -> None:
        """Closes the connection; what this client spawned lives on."""
        if self._link is not None:
            link, self._link = self._link, None
            self._conversation.lose(Disconnected("not_connected", "the client was closed"))
            link.transport.close()
            await link.closed.wait()

    async def request(self, message: Mapping[str, Any]) -> Any:
        """Sends a command given as a dict, and returns its reply."""
        pending: Pending[Any] = Pending(dict(message))
        await self._exchange([pending])
        return pending.result()

    @asynccontextmanager
    async def pipeline(self) -> AsyncIterator[Pipeline]:
        """Collects commands, to send them in one write; as `Client.pipeline`."""
        pipeline = Pipeline()
        yield pipeline
        await self._exchange(pipeline.calls)
        for call in pipeline.calls:
            call.result()

    async def events(self, timeout: float | None = None) -> AsyncIterator[Event]:
        """Yields events in the order in which they came, waiting for more; as `Client.events`."""
        while True:
            while self._queue:
                yield self._queue.popleft()
            if self._conversation.lost is not None:
                self._no_more_events()
                return
            assert self._link is not None
            self._link.news.clear()
            try:
                async with asyncio.timeout(timeout):
                    await self._link.news.wait()
            except TimeoutError:
                return

    async def _exchange(self, calls: Sequence[Pending[Any]]) -> None:
        if calls:
            data = self._conversation.ask(calls)
            assert self._link is not None
            self._link.transport.write(data)
            await self._reply(calls[-1])

    async def _reply(self, call: Pending[Any]) -> None:
        future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        call.when_done(lambda: None if future.done() else future.set_result(None))
        try:
            async with asyncio.timeout(self.timeout):
                await future
        except TimeoutError as error:
            raise self._late() from error


class _Link(asyncio.BufferedProtocol):
    """Carries bytes between a socket and a conversation, and says when there is news."""

    transport: asyncio.Transport

    def __init__(self, client: AsyncClient, conversation: _Conversation) -> None:
        self._client = client
        self._conversation = conversation
        self._buffer = memoryview(bytearray(READ))
        self.news = asyncio.Event()
        self.closed = asyncio.Event()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.Transport, transport)

    def get_buffer(self, sizehint: int) -> memoryview:
        return self._buffer

    def buffer_updated(self, nbytes: int) -> None:
        self._conversation.hear(bytes(self._buffer[:nbytes]))
        self.news.set()
        self._client.deliver()

    def connection_lost(self, error: Exception | None) -> None:
        self._conversation.end()
        self.news.set()
        self.closed.set()
