"""A client whose commands are awaited.

It hides the transport. A client is for one event loop, many tasks of which may use it at once.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from functools import cached_property
from types import TracebackType
from typing import Any, Self, cast

from nmes.client.commands import AsyncCommands, Pipeline
from nmes.client.conversation import READ, ClientBase, Conversation, created, world_list
from nmes.client.declaration import Pending
from nmes.client.replies import Event, WorldSummary
from nmes.errors import Disconnected

__all__ = ["AsyncClient"]


class AsyncClient(ClientBase, AsyncCommands):
    """A connection whose commands are awaited; many tasks may use it at once.

    ```python
    async with nmes.AsyncClient(password="...") as client:
        await client.subscribe(events=["state"])
        async for event in client.events():
            print(event)
    ```
    """

    _link: _Link | None = None
    _closes = 0  # how many times it was closed: who enters, and finds that it was meanwhile, leaves again

    @cached_property
    def _entering(self) -> asyncio.Lock:
        """Held by the task that enters the world: to connect takes several turns of the loop, in which others run."""
        return asyncio.Lock()

    async def __aenter__(self) -> Self:
        return self if self._link is not None else await self.connect()

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def connect(self) -> Self:
        """Connects and authenticates.

        Returns:
            The client itself.

        Raises:
            CommandFailed: The server refused it: `auth_failed`, `invalid`, `role_not_found`, `too_many_connections`,
                `host_draining`, `world_not_found` or `world_unavailable`.
            Disconnected: Nothing listens there (`unreachable`), the server closed the connection, or `close` was called
                meanwhile (`not_connected`).
            RuntimeError: The client is connected already.
            TimeoutError: No reply came in time.
        """
        closes = self._closes
        async with self._entering:
            return await self._join(closes)

    async def _join(self, closes: int) -> Self:
        self._entered(await self._enter(closes, world=self.world, role=self.role, token=self.token))
        return self

    async def worlds(self) -> list[WorldSummary]:
        """Lists the worlds of the server, over another connection, which joins none of them.

        Raises:
            CommandFailed: The server refused it: `auth_failed` or `too_many_connections`; or it cannot list its worlds
                (`unsupported`).
            Disconnected: Nothing listens there (`unreachable`), or the server closed the connection.
            TimeoutError: No reply came in time.
        """
        return await self._ask_host("list", True)

    async def create_world(self, name: str, *, template: str | None = None, seed: int | None = None) -> WorldSummary:
        """Creates a world of the server, over another connection, which does not enter it; returns what is told of it.

        The password must be the host's own, or that of a maker, which then opens this world too.

        Args:
            name: The world's.
            template: The template that its config is taken from. Default: the config that the host was started with.
            seed: Seed of all that the world draws. Default: that of the template.

        Raises:
            CommandFailed: The server refused it: `auth_failed`, `limit_reached`, `template_not_found`, `world_exists`,
                `world_unavailable`, `host_draining`; or it cannot create worlds (`unsupported`).
            Disconnected: Nothing listens there (`unreachable`), or the server closed the connection.
            TimeoutError: No reply came in time.
        """
        asked = {"world": name, "template": template, "seed": seed}
        worlds = await self._ask_host("create", {key: value for key, value in asked.items() if value is not None})
        return created(worlds, name)

    async def close_world(self, name: str) -> list[WorldSummary]:
        """Closes a world of the server for good, over another connection; returns the worlds that are left.

        Its clients are told `world_closed`, and its recording ends whole. The password must be the host's own, or
        that of the maker who created it.

        Args:
            name: The world's.

        Raises:
            CommandFailed: The server refused it: `auth_failed`, `too_many_connections`, `world_not_found`; or it cannot
                close worlds (`unsupported`).
            Disconnected: Nothing listens there (`unreachable`), or the server closed the connection.
            TimeoutError: No reply came in time.
        """
        return await self._ask_host("close", name)

    async def _ask_host(self, verb: str, value: Any) -> list[WorldSummary]:
        """Asks the host for something that is of no single world; returns the worlds that it answers with."""
        worlds, following = await self._ask_host_once(**{verb: value})
        start = -1
        while following is not None and following > start:  # else a server could keep us for ever
            start = following
            page, following = await self._ask_host_once(list=True, start=start)
            worlds += page
        return worlds

    async def _ask_host_once(self, **options: Any) -> tuple[list[WorldSummary], int | None]:
        other = AsyncClient(self.host, self.port, password=self._password, timeout=self.timeout, tls=self._tls or False)
        try:
            return world_list(await other._enter(other._closes, **options), next(iter(options)))
        finally:
            await other.close()

    async def _enter(self, closes: int, **options: Any) -> Any:
        """Connects and authenticates, unless the client is closed more often than that; returns the server's answer."""
        if self._link is not None:
            raise RuntimeError("the client is connected already; reconnect() starts anew")
        self._unless_closed(closes)
        conversation = self._new_conversation()
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout(self.timeout):
                _, self._link = await loop.create_connection(
                    lambda: _Link(self, conversation), self.host, self.port, ssl=self._tls
                )
        except TimeoutError as error:
            raise self._late() from error
        except (OSError, UnicodeError) as error:  # a name that cannot be looked up is the latter
            raise self._unreachable(error) from error
        self._conversation = conversation
        data, answer = conversation.authenticate(self._password, **options)
        try:
            self._unless_closed(closes)
            self._link.transport.write(data)
            await self._reply(answer)
            return answer.result()
        except BaseException:
            await self._leave()
            raise

    def _unless_closed(self, closes: int) -> None:
        if self._closes != closes:
            raise _closed()

    async def reconnect(self) -> Self:
        """Closes the connection and connects anew, as another client of the world; with roles, as the same player.

        Subscriptions, objectives and events that were not yet read are gone. Of the tasks that call it at once, one
        connects, and the others share its connection.

        Raises:
            CommandFailed: The server refused it, as at `connect`.
            Disconnected: Nothing listens there (`unreachable`), the server closed the connection, or `close` was called
                meanwhile (`not_connected`).
            TimeoutError: No reply came in time.
        """
        before, closes = self._welcome, self._closes
        async with self._entering:
            if self._link is not None and self._welcome is not before:
                return self
            await self._leave()
            return await self._join(closes)

    async def close(self) -> None:
        """Closes the connection; the cubes that this client spawned stay in the world.

        Tasks that connect or reconnect meanwhile come to nothing.
        """
        self._closes += 1
        await self._leave()

    async def _leave(self) -> None:
        if self._link is not None:
            link, self._link = self._link, None
            self._conversation.lose(_closed())
            link.transport.abort()  # else a server that does not read, or says no farewell in TLS, would keep us
            await link.closed.wait()

    async def request(self, message: Mapping[str, Any]) -> Any:
        """Sends a command given as a dict, and returns its reply.

        Args:
            message: The command with its `type`; it needs no `id`, which the client adds.

        Returns:
            The reply, a dict without its `id`.

        Raises:
            CommandFailed: The server refused it; `code` says why.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        pending: Pending[Any] = Pending(dict(message))
        await self._exchange([pending])
        return pending.result()

    @asynccontextmanager
    async def pipeline(self) -> AsyncIterator[Pipeline]:
        """Collects commands; when the block ends, sends them in one write and awaits all replies.

        The block gets a `Pipeline`, whose methods are the commands. Each returns a `Pending`, whose `result()` is the
        reply once the block has ended. A block that raises sends nothing.

        Raises:
            CommandFailed: The server refused a command: the first one of those refused. The results of the others are
                there all the same.
            Disconnected: The connection was lost.
            TimeoutError: The replies did not all come in time.
        """
        pipeline = Pipeline()
        yield pipeline
        await self._exchange(pipeline.calls)
        for call in pipeline.calls:
            call.result()

    async def events(self, timeout: float | None = None) -> AsyncIterator[Event]:
        """Yields events in the order in which they came, and waits for more.

        Ends after the event `world_closed`, or when none came for `timeout`.

        Args:
            timeout: How long to wait for each event, in s. Default: for ever.

        Raises:
            Disconnected: The connection was lost while its world was open.
        """
        while True:
            while self._queue:
                yield self._queue.popleft()
            if self._conversation.lost is not None:
                self._no_more_events()
                return
            assert self._link is not None
            self._link.arrival.clear()
            try:
                async with asyncio.timeout(timeout):
                    await self._link.arrival.wait()
            except TimeoutError:
                return

    def deliver(self) -> None:
        """Hands the events received so far to `on_event`; what that raises, the loop's exception handler is told.

        No task has called, and asyncio would take the error for one of the connection, and end that.
        """
        while self.on_event is not None and self._queue:
            try:
                super().deliver()
            except (Exception, asyncio.CancelledError) as error:
                told = {"message": "on_event of an AsyncClient has raised", "exception": error}
                asyncio.get_running_loop().call_exception_handler(told)

    async def _exchange(self, calls: Sequence[Pending[Any]]) -> None:
        if calls:
            data = self._conversation.request(calls)
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


def _closed() -> Disconnected:
    return Disconnected("not_connected", "the client was closed")


class _Link(asyncio.BufferedProtocol):
    """The transport of an AsyncClient: it carries bytes between a socket and a conversation, and signals arrivals."""

    transport: asyncio.Transport

    def __init__(self, client: AsyncClient, conversation: Conversation) -> None:
        self._client = client
        self._conversation = conversation
        self._buffer = memoryview(bytearray(READ))
        self.arrival = asyncio.Event()
        self.closed = asyncio.Event()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.Transport, transport)

    def get_buffer(self, sizehint: int) -> memoryview:
        return self._buffer

    def buffer_updated(self, nbytes: int) -> None:
        self._conversation.receive(bytes(self._buffer[:nbytes]))
        self.arrival.set()
        self._client.deliver()

    def connection_lost(self, error: Exception | None) -> None:
        self._conversation.end()
        self.arrival.set()
        self.closed.set()
