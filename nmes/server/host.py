"""Serving worlds over TCP: the sequencer that orders what sockets bring.

A `Host` listens and keeps the connections' limits and the worlds; a `Connection` moves bytes between one socket and one
hosted world.

Invariant: nothing is served to who has not said a password, of which `Keys` knows what it opens.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import logging
import ssl
import sys
from collections.abc import Collection, Coroutine, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from time import monotonic, time
from types import TracebackType
from typing import Any, Self

from nmes.errors import NmesError, RejectedMessage, WorldError
from nmes.protocol import Limits, Request, Session
from nmes.recording import Recording
from nmes.server.access_log import AccessLog
from nmes.server.catalog import DEFAULT, Catalog
from nmes.server.connection import LINGER, READ, Connection
from nmes.server.door import Door, cannot_listen
from nmes.server.hosted_world import HostedWorld
from nmes.server.keys import Keys
from nmes.server.metrics import CONTENT_TYPE, Figures, Metrics
from nmes.server.retention import Retention
from nmes.server.threads import WorkerPool
from nmes.server.world_recorder import Origin

__all__ = ["Host"]

logger = logging.getLogger(__name__)

SWEEP = 60.0  # s: how often it is looked for recordings that are to be removed


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
        role_passwords: Mapping[str, str] | None = None,
        makers: Mapping[str, str] | None = None,
        catalog: Catalog | None = None,
        hibernate_after: float | None = None,
        limits: Limits | None = None,
        auth_delay: float = 1.0,
        record_to: Path | None = None,
        flush_interval: float = 1.0,
        tls: ssl.SSLContext | None = None,
        metrics: Metrics | None = None,
        access_log: AccessLog | None = None,
        retention: Retention | None = None,
    ) -> None:
        """Makes a host that serves nothing yet.

        Args:
            password: What opens all worlds, in any role.
            role_passwords: What opens, in one role alone, all worlds whose configs name it, by the role's name.
            makers: Passwords of those who may create worlds, and close them, by their names.
            catalog: Holds the templates of worlds, and how many there may be; no world yet.
            hibernate_after: How long (s) a world is idle before it hibernates; None: none ever does.
            limits: The protocol's limits of a connection.
            auth_delay: How long a client that failed to authenticate waits for the answer, s.
            record_to: Directory for the recordings of all worlds; None: nothing is recorded.
            flush_interval: How much (s) of a recording a crash may lose; with 0 nothing is told before it is on disk.
            tls: Holds the host's certificate; None: all goes over the wire as it is.
            metrics: What counts what the host does; None: nothing is counted.
            access_log: Where who comes and goes is written; None: nowhere.
            retention: Which recordings are removed; None: none.
        """
        self._retention = retention
        self.access_log = access_log
        self.limits = limits or Limits()
        self.auth_delay = auth_delay
        self._flush_interval = flush_interval
        self._hibernate_after = hibernate_after
        self._pool = WorkerPool()
        self.worlds: dict[str, HostedWorld] = {}  # those that were created
        self.closed: list[HostedWorld] = []  # those that ended badly while the host goes on
        self._catalog = Catalog() if catalog is None else catalog
        self._ports: dict[str, int] = {}  # the port whose clients get a world without naming it
        self.buffer = memoryview(bytearray(READ))
        self.keys = Keys(password, role_passwords or {}, makers or {})
        self.record_to = record_to
        self._metrics = metrics
        if metrics is not None:
            metrics.watch(self._figures)
        self.received = 0  # bytes
        self.sent = 0
        self._door = Door(self.limits.unauthenticated, tls, self.limits.auth_timeout, LINGER)
        self.guesses = self._door.guesses
        self._reader = ThreadPoolExecutor(1, "nmes-reader")  # one: a frame is read without a pause for others
        self._awake: set[HostedWorld] = set()  # those of the worlds that may have something to do
        self._creating: dict[str, dict[Connection, None]] = {}  # worlds made in a thread now, and who waits for them
        self._makers: set[asyncio.Task[None]] = set()  # that create and close them
        self._open = False  # whether it listens
        self._metrics_servers: list[asyncio.Server] = []
        self._connections: set[Connection] = set()
        self._inside: set[Connection] = set()  # those that authenticated
        self._tasks: list[asyncio.Task[None]] = []

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    # -- worlds ----------------------------------------------------------------------------------------------------

    def add(self, config: Mapping[str, Any], password: str | None = None) -> HostedWorld:
        """Creates a world from its config and hosts it; the first one is for clients that name none.

        Args:
            config: Its config.
            password: What opens this world alone; None: only the host's does.

        Raises:
            RejectedMessage: The config is not valid.
            BackendNotFound: No such engine.
            RecordingError: Its recording cannot be written.
            WorldError: As `offer`.
        """
        return self._add(config, None, password)

    def resume(self, recording: Recording, frame: int | None = None, password: str | None = None) -> HostedWorld:
        """Hosts the world of a recording, which goes on from a frame of it; its recorded clients are gone.

        Args:
            recording: The recording.
            frame: The frame, counted on through resets; None: where it ends.
            password: What opens this world alone; None: only the host's does.

        Raises:
            RecordingError: There is no such frame, a tick on the way to it does not come out as recorded, or the new
                recording cannot be written.
            BackendNotFound: No such engine.
            WorldError: As `offer`.
        """
        origin = Origin(recording, recording.last_frame if frame is None else frame)
        return self._add(recording.config, origin, password)

    def _add(self, config: Mapping[str, Any], origin: Origin | None, password: str | None) -> HostedWorld:
        name = self.offer(config, password)
        try:
            hosted = self.worlds[name] = self._make(name, origin)
        except NmesError:
            self._forget(name)
            raise
        self._awake.add(hosted)
        if self._open:
            hosted.start()
        return hosted

    def offer(self, config: Mapping[str, Any], password: str | None = None) -> str:
        """Hosts a world that is created when a client first joins it; returns its name.

        Args:
            config: Its config.
            password: What opens this world alone; None: only the host's does.

        Raises:
            RejectedMessage: The config is not valid. Whether its engine can do it is seen when the world is created.
            WorldError: There is a world of that name (`world_exists`), or as many as there may be (`limit_reached`).
        """
        offer = self._catalog.add(config)
        self.keys.add(offer.name, offer.config.get("roles", {}), password)
        return offer.name

    def _forget(self, name: str) -> None:
        self._catalog.remove(name)
        self.keys.remove(name)
        self._ports.pop(name, None)

    def _make(self, name: str, origin: Origin | None = None) -> HostedWorld:
        config = self._catalog[name].config
        return HostedWorld(config, self._pool, self.record_to, self._flush_interval, self._metrics, origin)

    def world_name(self, name: str | None) -> str:
        """Returns the name of one of the worlds: the first one's if it is None.

        Raises:
            WorldError: `world_not_found`.
        """
        if name is None:
            name = self._catalog.first
        if name is None or name not in self._catalog:
            raise WorldError("world_not_found", f"this host has no world {name!r}", "world")
        return name

    def find(self, name: str, connection: Connection) -> HostedWorld | None:
        """Returns a world, or None while it is being created, in a thread.

        The connection's `resume` is called when it is there; where it cannot be created, its `hang_up`.
        """
        if name in self.worlds:
            self._awake.add(self.worlds[name])
            return self.worlds[name]
        if name not in self._creating:
            self._creating[name] = {}
            _spawn(self._create_in_thread(name), self._makers)
        self._creating[name][connection] = None
        return None

    async def _create_in_thread(self, name: str) -> None:
        """Creates a world for those who wait for it, or tells them that it cannot be."""
        failure: NmesError | None = None
        try:
            hosted = await asyncio.to_thread(self._make, name)
        except RejectedMessage as error:  # the config is to blame, in which there are no secrets
            logger.error("world %r could not be created: %s", name, error.message)
            failure = WorldError("world_unavailable", f"world {name!r} could not be created: {error.message}")
        except NmesError as error:
            logger.error("world %r could not be created: %s", name, error.message)
            failure = WorldError("world_unavailable", f"world {name!r} could not be created; see the server's log")
        except Exception:
            logger.exception("world %r could not be created", name)
            failure = NmesError("internal", "the server failed; see its log")
        else:
            self.worlds[name] = hosted
            self._awake.add(hosted)
            hosted.start()
        for connection in self._creating.pop(name):
            if failure is None:
                connection.resume()
            else:
                connection.hang_up(failure)

    def create_world(self, asked: Mapping[str, Any], maker: str | None, connection: Connection) -> None:
        """Creates a world and hosts it.

        Args:
            asked: What `create` of an `auth` says.
            maker: Whose world it is; None: whoever has the host's password.
            connection: Who asked for it; it is shown that world then, or told why there is none.
        """
        name: str = asked["world"]
        try:
            config = self._catalog.config(name, asked.get("template", DEFAULT), asked.get("seed"))
            self.keys.add(name, self._catalog.add(config, maker).config.get("roles", {}), maker=maker)
        except (RejectedMessage, WorldError) as error:
            connection.hang_up(error)
            return

        self._creating[name] = {connection: None}

        async def create() -> None:
            await self._create_in_thread(name)
            if name in self.worlds:
                connection.show_worlds({name: None})
            else:
                self._forget(name)

        _spawn(create(), self._makers)

    def close_world(self, name: str, maker: str | None, connection: Connection) -> None:
        """Closes a world for good: it stops, its clients are told and hung up on, its recording is completed.

        Args:
            name: The world's.
            maker: Who may close only what he created; None: whoever has the host's password.
            connection: Who asked for it; it is shown the others then, or told that there is no such world.
        """

        async def close() -> None:
            while name in self._creating:
                await asyncio.sleep(0.01)
            if name not in self._catalog or (maker is not None and self._catalog[name].maker != maker):
                whose = "" if maker is None else " that you have created"
                connection.hang_up(WorldError("world_not_found", f"this host has no world {name!r}{whose}", "close"))
                return
            self._forget(name)
            hosted = self.worlds.pop(name, None)
            if hosted is not None:
                self._awake.discard(hosted)
                await hosted.close()
                if hosted.abandoned or hosted.lost is not None:
                    self.closed.append(hosted)
                hosted.hang_up()
                if self._metrics is not None:
                    self._metrics.forget(name)
            connection.show_worlds(None if maker is None else self.keys.made_by(maker))

        _spawn(close(), self._makers)

    def list_worlds(self, port: int, only: Collection[str] | None = None, start: int = 0) -> dict[str, Any]:
        """Returns the `world_list` message for a client of a port, of all worlds if not of some. Creates none.

        It is the page that begins with the world of number `start`, or the first one behind that.
        """
        listed = []
        page, following = self._catalog.page(start, only)
        for name, config, *_ in page:
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
                    "asleep": hosted is not None and hosted.world.asleep,
                    "ratio": round(status.lag.ratio, 3) if status is not None and status.lag is not None else None,
                }
            )
        return {"type": "world_list", "worlds": listed, "next": following}

    def _figures(self) -> Figures:
        worlds = [hosted.figures for hosted in self.worlds.values()]
        return Figures(len(self._connections), self.received, self.sent, worlds)

    # -- connections -----------------------------------------------------------------------------------------------

    @property
    def connections(self) -> int:
        """The number of connections, those that are ending included."""
        return len(self._connections)

    def admit(self, connection: Connection, address: str) -> None:
        """Lets a connection from an address wait at the door, until it is let in."""
        self._connections.add(connection)
        self._door.wait(connection, address)

    def let_in(self, connection: Connection) -> bool:
        """Counts a connection among those that have authenticated; returns False where the host is full."""
        if len(self._inside) >= self.limits.connections:
            return False
        self._door.forget(connection)
        self._inside.add(connection)
        return True

    def forget(self, connection: Connection) -> None:
        """Counts a connection out."""
        self._connections.discard(connection)
        self._inside.discard(connection)
        self._door.forget(connection)

    def parse(self, session: Session, frame: bytes) -> Future[Request]:
        """Reads a frame of a session in a thread."""
        return self._reader.submit(session.parse, frame)

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
        address, port = await self._door.listen(host, port, lambda: Connection(self, world))
        if not self._open:
            self._open = True
            loop = asyncio.get_running_loop()
            self._tasks = [
                loop.create_task(work()) for work in (self._inspect, self._flush, self._hibernate, self._sweep)
            ]
            for hosted in self.worlds.values():
                hosted.start()
        default = world or self._catalog.first
        if default is not None:
            self._ports.setdefault(default, port)
        return address, port

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
            raise cannot_listen(host, port, error) from error
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
            for hosted in list(self._awake):
                await hosted.flush()

    async def _hibernate(self) -> None:
        """Has worlds hibernate that nobody uses, one after the other."""
        idle = self._hibernate_after
        while idle is not None:
            await asyncio.sleep(min(max(idle / 4, 0.01), 5.0))
            before = len(self._awake)
            for hosted in list(self._awake):
                await hosted.hibernation.begin(idle)
                if hosted.hibernation.resting:
                    self._awake.discard(hosted)
            if len(self._awake) < before:
                await asyncio.to_thread(_give_back_memory)

    async def _sweep(self) -> None:
        while self._retention is not None:
            writing = {hosted.recording for hosted in self.worlds.values() if hosted.recording is not None}
            try:
                await asyncio.to_thread(self._retention.sweep, time(), writing)
            except OSError as error:
                logger.warning("the folder of recordings cannot be gone through: %s", error)
            await asyncio.sleep(SWEEP)

    async def _stop_listening(self) -> None:
        """Closes the listening sockets; clients that were accepted before become connections."""
        loop = asyncio.get_running_loop()
        for server in self._metrics_servers:
            for listener in server.sockets:
                with contextlib.suppress(NotImplementedError):  # a loop that waits for completions has no readers
                    loop.remove_reader(listener)
        # asyncio needs two turns to make a connection of an accepted socket. Closing the server before that leaves the
        # socket open, with nobody to close it.
        for _ in range(2):
            await asyncio.sleep(0)
        for server in self._metrics_servers:
            server.close()
        await self._door.close()

    @property
    def abandoned(self) -> bool:
        """Whether a world was left in the middle of a tick when the host closed: its thread goes on until that ends."""
        return any(hosted.abandoned for hosted in (*self.worlds.values(), *self.closed))

    async def close(self) -> None:
        """Stops listening, closes the worlds and their recordings, tells the clients, and hangs up."""
        await self._stop_listening()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, *self._makers, return_exceptions=True)
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
        self._open = False
        self._reader.shutdown()
        self._pool.close(wait=not self.abandoned)


def _give_back_memory() -> None:
    """Has the C library give the system what it keeps of freed memory, where it can: glibc keeps most of an engine."""
    if sys.platform == "linux" and (trim := getattr(ctypes.CDLL(None), "malloc_trim", None)) is not None:
        trim(0)


def _spawn(work: Coroutine[Any, Any, None], among: set[asyncio.Task[None]]) -> None:
    """Has work done beside all else; it is among the tasks until it is over."""
    task = asyncio.get_running_loop().create_task(work)
    among.add(task)
    task.add_done_callback(among.discard)
