"""Serving worlds over TCP: the sequencer that orders what sockets bring.

A `Host` listens and keeps the connections' limits and the worlds; a `Connection` moves bytes between one socket and one
hosted world.

Invariant: the password is kept only as a digest.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import logging
import ssl
from collections.abc import Mapping
from hashlib import blake2b
from pathlib import Path
from time import monotonic
from types import TracebackType
from typing import Any, Self

from nmes.errors import MachineError, NmesError, WorldError
from nmes.protocol import Limits, complete_config
from nmes.recording import Recording
from nmes.server.connection import LINGER, READ, Connection
from nmes.server.hosted_world import HostedWorld
from nmes.server.metrics import CONTENT_TYPE, Figures, Metrics
from nmes.server.threads import WorkerPool
from nmes.server.world_recorder import Origin

__all__ = ["Host"]

logger = logging.getLogger(__name__)


class Host:
    """Serves worlds: `add` or `offer` them, `listen`, and in the end `close`.

    ```python
    async with Host(password) as host:
        host.add({"name": "main"})
        address, port = await host.listen("127.0.0.1", 14000)
        ...
    ```
    """

    def __init__(
        self,
        password: str,
        *,
        limits: Limits | None = None,
        auth_delay: float = 1.0,
        record_to: Path | None = None,
        flush_interval: float = 1.0,
        tls: ssl.SSLContext | None = None,
        metrics: Metrics | None = None,
    ) -> None:
        """Makes a host that serves nothing yet.

        Args:
            password: What clients must say. Only its digest is kept.
            limits: The protocol's limits of a connection.
            auth_delay: How long a client that failed to authenticate waits for the answer, s.
            record_to: Directory for the recordings of all worlds; None: nothing is recorded.
            flush_interval: How much (s) of a recording a crash may lose; with 0 nothing is told before it is on disk.
            tls: Holds the host's certificate; None: all goes over the wire as it is.
            metrics: What counts what the host does; None: nothing is counted.
        """
        self.limits = limits or Limits()
        self.auth_delay = auth_delay
        self._flush_interval = flush_interval
        self._pool = WorkerPool()
        self.worlds: dict[str, HostedWorld] = {}  # those that were created
        self._offered: dict[str, dict[str, Any]] = {}  # the configs of all, by name
        self._ports: dict[str, int] = {}  # the port whose clients get a world without naming it
        self.buffer = memoryview(bytearray(READ))
        self._password = _digest(password)
        self.record_to = record_to
        self._tls = tls
        self._metrics = metrics
        if metrics is not None:
            metrics.watch(self._figures)
        self.received = 0  # bytes
        self.sent = 0
        self._servers: list[asyncio.Server] = []
        self._metrics_servers: list[asyncio.Server] = []
        self._connections: set[Connection] = set()
        self._tasks: list[asyncio.Task[None]] = []

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    # -- worlds ----------------------------------------------------------------------------------------------------

    def add(self, config: Mapping[str, Any]) -> HostedWorld:
        """Creates a world from its config and hosts it; the first one is for clients that name none.

        Raises:
            RejectedMessage: The config is not valid.
            BackendNotFound: No such engine.
            RecordingError: Its recording cannot be written.
            WorldError: There is a world of that name (`world_exists`).
        """
        return self._add(config, None)

    def resume(self, recording: Recording, frame: int | None = None) -> HostedWorld:
        """Hosts the world of a recording, which goes on from a frame of it; its recorded clients are gone.

        Args:
            recording: The recording.
            frame: The frame, counted on through resets; None: where it ends.

        Raises:
            RecordingError: There is no such frame, a tick on the way to it does not come out as recorded, or the new
                recording cannot be written.
            BackendNotFound: No such engine.
            WorldError: There is a world of that name (`world_exists`).
        """
        return self._add(recording.config, Origin(recording, recording.last_frame if frame is None else frame))

    def _add(self, config: Mapping[str, Any], origin: Origin | None) -> HostedWorld:
        name = self.offer(config)
        try:
            return self._create(name, origin)
        except NmesError:
            del self._offered[name]
            raise

    def offer(self, config: Mapping[str, Any]) -> str:
        """Hosts a world that is created when a client first joins it; returns its name.

        Raises:
            RejectedMessage: The config is not valid. Whether its engine can do it is seen when the world is created.
            WorldError: There is a world of that name (`world_exists`).
        """
        complete = complete_config(config)
        name: str = complete["name"]
        if name in self._offered:
            raise WorldError("world_exists", f"two worlds are called {name!r}", "name")
        self._offered[name] = complete
        return name

    def _create(self, name: str, origin: Origin | None = None) -> HostedWorld:
        hosted = self.worlds[name] = HostedWorld(
            self._offered[name], self._pool, self.record_to, self._flush_interval, self._metrics, origin
        )
        if self._servers:
            hosted.start()
        return hosted

    def find(self, name: str | None) -> HostedWorld:
        """Returns the world of a name, or the first one if the name is None; creates it if need be.

        Raises:
            WorldError: `world_not_found`, or `world_unavailable` where it cannot be created.
        """
        if name is None:
            name = next(iter(self._offered), None)
        if name not in self._offered:
            raise WorldError("world_not_found", f"this host has no world {name!r}", "world")
        if name in self.worlds:
            return self.worlds[name]
        try:
            return self._create(name)
        except NmesError as error:
            logger.error("world %r could not be created: %s", name, error.message)
            raise WorldError(
                "world_unavailable", f"world {name!r} could not be created; see the server's log"
            ) from error

    def list_worlds(self, port: int) -> dict[str, Any]:
        """Returns the `world_list` message for a client of a port. Creates none of the worlds."""
        listed = []
        for name, config in self._offered.items():
            hosted = self.worlds.get(name)
            status = hosted.status if hosted is not None else None
            listed.append(
                {
                    "world": name,
                    "port": self._ports.get(name, port),
                    "backend": config["backend"],
                    "mode": status.mode if status is not None else config["mode"],
                    "frame": status.frame if status is not None else None,
                    "clients": hosted.clients if hosted is not None else 0,
                    "fault": status.fault.code if status is not None and status.fault is not None else None,
                }
            )
        return {"type": "world_list", "worlds": listed}

    def _figures(self) -> Figures:
        worlds = [hosted.figures for hosted in self.worlds.values()]
        return Figures(len(self._connections), self.received, self.sent, worlds)

    # -- connections -----------------------------------------------------------------------------------------------

    def accepts(self, password: str) -> bool:
        """Compares a password in a time that does not depend on how much of it is right."""
        return hmac.compare_digest(self._password, _digest(password))

    @property
    def connections(self) -> int:
        """The number of connections, those that are ending included."""
        return len(self._connections)

    def admit(self, connection: Connection) -> int:
        """Counts a connection in; returns the number of connections."""
        self._connections.add(connection)
        return len(self._connections)

    def forget(self, connection: Connection) -> None:
        """Counts a connection out."""
        self._connections.discard(connection)

    async def listen(self, host: str, port: int, world: str | None = None) -> tuple[str, int]:
        """Listens on an address. The worlds' clocks start with the first port.

        Args:
            host: The address or its name.
            port: The port; 0 finds a free one.
            world: The world of those clients that name none; None: the first one.

        Returns:
            The address and the port that it listens on.

        Raises:
            MachineError: `cannot_listen`: the address is taken, or not of this machine.
        """
        loop = asyncio.get_running_loop()
        try:
            server = await loop.create_server(
                lambda: Connection(self, world),
                host,
                port,
                backlog=1024,
                ssl=self._tls,
                ssl_handshake_timeout=self.limits.auth_timeout if self._tls else None,
                ssl_shutdown_timeout=LINGER if self._tls else None,
            )
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise MachineError("cannot_listen", f"cannot listen on {host}:{port}: {reason}") from error
        if not self._servers:
            self._tasks = [loop.create_task(self._inspect()), loop.create_task(self._flush())]
            for hosted in self.worlds.values():
                hosted.start()
        self._servers.append(server)
        address = server.sockets[0].getsockname()
        default = world or next(iter(self._offered), None)
        if default is not None:
            self._ports.setdefault(default, address[1])
        return address[0], address[1]

    async def serve_metrics(self, host: str, port: int) -> int:
        """Serves the page of metrics over HTTP, without a password; returns the port.

        Raises:
            MachineError: `cannot_listen`, as `listen`.
        """
        assert self._metrics is not None
        metrics = self._metrics

        async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            # Whatever is asked, this is the answer: there is one page.
            with contextlib.suppress(OSError, EOFError, TimeoutError, asyncio.LimitOverrunError):
                async with asyncio.timeout(self.limits.auth_timeout):
                    await reader.readuntil(b"\r\n\r\n")
                    page = metrics.page()
                    head = f"HTTP/1.1 200 OK\r\nContent-Type: {CONTENT_TYPE}\r\nContent-Length: {len(page)}"
                    writer.write(f"{head}\r\nConnection: close\r\n\r\n".encode() + page)
                    await writer.drain()
            writer.close()

        try:
            server = await asyncio.start_server(answer, host, port)
        except OSError as error:
            raise MachineError("cannot_listen", f"cannot listen on {host}:{port}: {error.strerror}") from error
        self._metrics_servers.append(server)
        return int(server.sockets[0].getsockname()[1])

    async def _inspect(self) -> None:
        interval = min(1.0, self.limits.stall_timeout / 4, self.limits.idle_timeout / 4)
        while True:
            await asyncio.sleep(interval)
            now = monotonic()
            for connection in list(self._connections):
                connection.inspect(now)

    async def _flush(self) -> None:
        # Twice as often as is promised: a slice or a long step may come between.
        interval = (self._flush_interval or 1.0) / 2
        while True:
            await asyncio.sleep(interval)
            for hosted in self.worlds.values():
                hosted.flush()

    async def _stop_listening(self) -> None:
        """Closes the listening sockets; clients that were accepted before become connections."""
        loop = asyncio.get_running_loop()
        for server in (*self._servers, *self._metrics_servers):
            for listener in server.sockets:
                with contextlib.suppress(NotImplementedError):  # a loop that waits for completions has no readers
                    loop.remove_reader(listener)
        # asyncio needs two turns to make a connection of an accepted socket. Closing the server before that leaves the
        # socket open, with nobody to close it.
        for _ in range(2):
            await asyncio.sleep(0)
        for server in (*self._servers, *self._metrics_servers):
            server.close()

    async def close(self) -> None:
        """Stops listening, closes the worlds and their recordings, tells the clients, and hangs up."""
        await self._stop_listening()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._tasks.clear()
        await asyncio.gather(*(hosted.close() for hosted in self.worlds.values()))
        for connection in list(self._connections):
            connection.hang_up()
        # Peers get a moment to hang up themselves, and those that still read get some more.
        began = monotonic()
        while self._connections and monotonic() - began < LINGER:
            if monotonic() - began > LINGER / 8 and not any(connection.draining for connection in self._connections):
                break
            await asyncio.sleep(0.01)
        for connection in list(self._connections):
            connection.abort()
        while self._connections:
            await asyncio.sleep(0)
        with contextlib.suppress(TimeoutError):  # a TLS handshake that stalls is not waited for
            async with asyncio.timeout(LINGER):
                for server in self._servers:
                    await server.wait_closed()
        self._servers.clear()
        self._pool.close()


def _digest(password: str) -> bytes:
    return blake2b(password.encode("utf-8", "surrogatepass")).digest()
