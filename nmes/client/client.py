"""A client that blocks until replies come.

It hides the socket: a call sends and receives at once, so that neither side waits for the other to read. A client is
for one thread.
"""

from __future__ import annotations

import selectors
import socket
import ssl
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import TracebackType
from typing import Any, Self

from nmes.client.commands import BlockingCommands, Pipeline
from nmes.client.conversation import READ, ClientBase, created, world_list
from nmes.client.declaration import Pending
from nmes.client.replies import Event, WorldSummary
from nmes.errors import Disconnected

__all__ = ["Client"]

# Raised by a socket that does not block, in place of waiting.
_WOULD_BLOCK = (BlockingIOError, ssl.SSLWantReadError, ssl.SSLWantWriteError)


class Client(ClientBase, BlockingCommands):
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

        Returns:
            The client itself.

        Raises:
            CommandFailed: The server refused it: `auth_failed`, `invalid`, `role_not_found`, `too_many_connections`,
                `host_draining`, `world_not_found` or `world_unavailable`.
            Disconnected: Nothing listens there (`unreachable`), or the server closed the connection.
            RuntimeError: The client is connected already.
            TimeoutError: No reply came in time.
        """
        self._entered(self._enter(world=self.world, role=self.role, token=self.token))
        return self

    def worlds(self) -> list[WorldSummary]:
        """Lists the worlds of the server, over another connection, which joins none of them.

        Raises:
            CommandFailed: The server refused it: `auth_failed` or `too_many_connections`; or it cannot list its worlds
                (`unsupported`).
            Disconnected: Nothing listens there (`unreachable`), or the server closed the connection.
            TimeoutError: No reply came in time.
        """
        return self._ask_host("list", True)

    def create_world(self, name: str, *, template: str | None = None, seed: int | None = None) -> WorldSummary:
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
        worlds = self._ask_host("create", {key: value for key, value in asked.items() if value is not None})
        return created(worlds, name)

    def close_world(self, name: str) -> list[WorldSummary]:
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
        return self._ask_host("close", name)

    def _ask_host(self, verb: str, value: Any) -> list[WorldSummary]:
        """Asks the host for something that is of no single world; returns the worlds that it answers with."""
        worlds, following = self._ask_host_once(**{verb: value})
        start = -1
        while following is not None and following > start:  # else a server could keep us for ever
            start = following
            page, following = self._ask_host_once(list=True, start=start)
            worlds += page
        return worlds

    def _ask_host_once(self, **options: Any) -> tuple[list[WorldSummary], int | None]:
        other = Client(self.host, self.port, password=self._password, timeout=self.timeout, tls=self._tls or False)
        try:
            return world_list(other._enter(**options), next(iter(options)))
        finally:
            other.close()

    def _enter(self, **options: Any) -> Any:
        """Connects and authenticates; returns the server's answer."""
        if self._socket is not None:
            raise RuntimeError("the client is connected already; reconnect() starts anew")
        try:
            connection = socket.create_connection((self.host, self.port), self.timeout)
            self._socket = self._tls.wrap_socket(connection, server_hostname=self.host) if self._tls else connection
        except (OSError, UnicodeError) as error:  # a name that cannot be looked up is the latter
            raise self._unreachable(error) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._socket, selectors.EVENT_READ)
        self._conversation = self._new_conversation()
        self._unsent, answer = self._conversation.authenticate(self._password, **options)
        try:
            self._wait(lambda: answer.done, self.timeout)
            return answer.result()
        except BaseException:
            self.close()
            raise

    def reconnect(self) -> Self:
        """Closes the connection and connects anew, as another client of the world; with roles, as the same player.

        Subscriptions, objectives and events that were not yet read are gone.

        Raises:
            CommandFailed: The server refused it, as at `connect`.
            Disconnected: Nothing listens there (`unreachable`), or the server closed the connection.
            TimeoutError: No reply came in time.
        """
        self.close()
        return self.connect()

    def close(self) -> None:
        """Closes the connection; the cubes that this client spawned stay in the world."""
        if self._socket is not None:
            self._selector.close()
            self._socket.close()
            self._socket = None
            self._unsent = b""
            self._conversation.lose(Disconnected("not_connected", "the client was closed"))

    def request(self, message: Mapping[str, Any]) -> Any:
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
        self._exchange([pending])
        return pending.result()

    def post(self, message: Mapping[str, Any]) -> Pending[Any]:
        """Sends a command given as a dict, and does not wait for its reply: for whoever talks to many worlds at once.

        Args:
            message: The command with its `type`; it needs no `id`, which the client adds.

        Returns:
            The reply to come, for `wait`.

        Raises:
            Disconnected: The connection was lost.
        """
        pending: Pending[Any] = Pending(dict(message))
        self._unsent += self._conversation.request([pending])
        self._send()
        return pending

    def wait(self, pending: Pending[Any]) -> Any:
        """Waits for the reply to a command that was posted, and returns it, as `request` does.

        Args:
            pending: What `post` returned.

        Raises:
            CommandFailed: The server refused it; `code` says why.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        self._wait(lambda: pending.done, self.timeout)
        return pending.result()

    @contextmanager
    def pipeline(self) -> Iterator[Pipeline]:
        """Collects commands; when the block ends, sends them in one write and waits for all replies.

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
        self._exchange(pipeline.calls)
        for call in pipeline.calls:
            call.result()

    def events(self, timeout: float | None = None) -> Iterator[Event]:
        """Yields events in the order in which they came, and waits for more.

        Ends after the event `world_closed`, or when none came for `timeout`.

        Args:
            timeout: How long to wait for each event, in s; 0 takes those that are there. Default: for ever.

        Raises:
            Disconnected: The connection was lost while its world was open.
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
            self._unsent += self._conversation.request(calls)
            self._wait(lambda: calls[-1].done, self.timeout)  # replies come in order: the last is the last

    def _wait(self, done: Callable[[], bool], timeout: float | None) -> None:
        """Sends and receives until `done`; both at once, so that neither side waits for the other to read."""
        assert self._socket is not None
        deadline = None if timeout is None else time.monotonic() + timeout
        while not done():
            self._send()
            self._selector.modify(self._socket, selectors.EVENT_READ | (selectors.EVENT_WRITE if self._unsent else 0))
            left = None if deadline is None else max(deadline - time.monotonic(), 0.0)
            if not self._selector.select(left):
                raise self._late()
            try:
                data = self._socket.recv(READ)
            except _WOULD_BLOCK:
                continue
            except OSError:
                data = b""
            if data:
                self._conversation.receive(data)
                self.deliver()
            else:
                self._conversation.end()

    def _send(self) -> None:
        """Hands to the socket what it takes now."""
        assert self._socket is not None
        try:
            if self._unsent:
                self._unsent = self._unsent[self._socket.send(self._unsent) :]
        except _WOULD_BLOCK:
            pass
        except OSError:
            # The server closed; what it said before is still to be read.
            self._unsent = b""
