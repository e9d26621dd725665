"""Serving worlds over TCP: the sequencer that orders what sockets bring.

A `Host` keeps the worlds that live in this process; a `Connection` moves bytes between one socket and one hosted world.
Who is let in is the `Reception`'s matter.
"""

from __future__ import annotations

import asyncio
import logging
import ssl
from collections.abc import Collection, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from time import monotonic
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from nmes.errors import NmesError, RecordingError, RejectedMessage, WorldError
from nmes.protocol import Limits
from nmes.recording import Recording
from nmes.server.access_log import AccessLog
from nmes.server.catalog import Catalog
from nmes.server.connection import Connection
from nmes.server.hosted_world import HostedWorld
from nmes.server.keys import Keys
from nmes.server.memory import Memory
from nmes.server.metrics import Figures, Metrics
from nmes.server.reception import Reception, keep_on
from nmes.server.retention import Retention
from nmes.server.threads import WorkerPool
from nmes.server.world_recorder import Origin

if TYPE_CHECKING:
    from starlette.types import ASGIApp

    from nmes.server.http import HttpServer

__all__ = ["Host"]

logger = logging.getLogger(__name__)

SLEEPERS = 4  # worlds that are put to sleep at once where none keeps pace with the wall's clock: else one is
SWEEP = 60.0  # s: how often it is looked for recordings that are to be removed


class Host(Reception):
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
        password: str | Keys,
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
            password: What opens all worlds, in any role; or all that opens anything, as another process has it too.
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
        keys = password if isinstance(password, Keys) else Keys(password, role_passwords or {}, makers or {})
        super().__init__(keys, catalog=catalog, limits=limits, auth_delay=auth_delay, tls=tls, access_log=access_log)
        self._retention = retention
        self._flush_interval = flush_interval
        self._hibernate_after = hibernate_after
        self._memory = Memory()
        self._pool = WorkerPool()
        self.worlds: dict[str, HostedWorld] = {}  # those that were created
        self.closed: list[HostedWorld] = []  # those that ended badly while the host goes on
        self._origins: dict[str, Origin] = {}  # where worlds go on from that are to be created
        self.record_to = record_to
        self._metrics = metrics
        if metrics is not None:
            metrics.watch(self._figures)
        self._awake: set[HostedWorld] = set()  # those of the worlds that may have something to do
        self._tasks: list[asyncio.Task[None]] = []
        self._http_servers: list[HttpServer] = []

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

    def resume(
        self,
        recording: Recording,
        frame: int | None = None,
        password: str | None = None,
        maker: str | None = None,
    ) -> HostedWorld:
        """Hosts the world of a recording, which goes on from a frame of it; its recorded clients are gone.

        Args:
            recording: The recording.
            frame: The frame, counted on through resets; None: where it ends.
            password: What opens this world alone; None: only the host's does.
            maker: Who created it over the wire, one of the host's makers; None: the host.

        Raises:
            RecordingError: There is no such frame, a tick on the way to it does not come out as recorded, or the new
                recording cannot be written.
            BackendNotFound: No such engine.
            WorldError: As `offer`.
        """
        origin = Origin(recording, recording.last_frame if frame is None else frame)
        return self._add(recording.config, origin, password, maker)

    def _add(
        self, config: Mapping[str, Any], origin: Origin | None, password: str | None, maker: str | None = None
    ) -> HostedWorld:
        name = self.offer(config, password, maker=maker)
        try:
            hosted = self.worlds[name] = self._make(name, origin)
        except NmesError:
            self._forget(name)
            raise
        self._awake.add(hosted)
        if self._running:
            hosted.start()
        return hosted

    def _make(self, name: str, origin: Origin | None = None) -> HostedWorld:
        offer = self._catalog[name]
        about = self.record_to, self._flush_interval, self._metrics, origin, offer.maker
        return HostedWorld(offer.config, self._pool, *about)

    def find(self, name: str, connection: Connection) -> HostedWorld | None:
        """Returns a world, or None while it is being created, in a thread."""
        if name in self.worlds:
            self._awake.add(self.worlds[name])
            return self.worlds[name]
        self._wait_for(name, connection)
        return None

    async def _open(self, name: str) -> NmesError | None:
        def make(origin: Origin | None, kept: Path | None) -> HostedWorld:
            return self._make(name, origin if kept is None else Origin.end(kept))

        try:
            hosted = await asyncio.to_thread(make, self._origins.pop(name, None), self._kept.get(name))
        except RejectedMessage as error:  # the config is to blame, in which there are no secrets
            logger.error("world %r could not be created: %s", name, error.message)
            return WorldError("world_unavailable", f"world {name!r} could not be created: {error.message}")
        except NmesError as error:
            logger.error("world %r could not be created: %s", name, error.message)
            return WorldError("world_unavailable", f"world {name!r} could not be created; see the server's log")
        except Exception:
            logger.exception("world %r could not be created", name)
            return NmesError("internal", "the server failed; see its log")
        self._kept.pop(name, None)
        self.worlds[name] = hosted
        self._awake.add(hosted)
        hosted.start()
        return None

    async def _close(self, name: str) -> Path | None:
        if (hosted := self._take_out(name)) is None:
            return self._kept.pop(name, None)
        await hosted.close()
        self._note_end(hosted)
        hosted.hang_up()
        return hosted.recording

    def _take_out(self, name: str) -> HostedWorld | None:
        hosted = self.worlds.pop(name, None)
        if hosted is not None:
            self._awake.discard(hosted)
        return hosted

    def _note_end(self, hosted: HostedWorld) -> None:
        if hosted.abandoned or hosted.lost is not None:
            self.closed.append(hosted)

    async def bring(self, name: str, path: Path) -> NmesError | None:
        """Brings up a world that goes on from where its recording ends; returns why it cannot be, or None."""
        try:
            self._origins[name] = await asyncio.to_thread(Origin.end, path)
        except NmesError as error:
            return error
        return await self.open(name)

    async def fork(self, recording: Recording, frame: int | None, name: str) -> HostedWorld:
        """Hosts a world that goes on from a frame of a recording, as `resume`, under another name; made in a thread.

        Raises:
            RecordingError: There is no such frame.
            RejectedMessage, WorldError: As `offer`; or it cannot be created (`world_unavailable`).
        """
        last = await asyncio.to_thread(lambda: recording.last_frame)
        if frame is not None and frame > last:
            raise RecordingError("no_such_frame", f"{recording.path} ends at frame {last}; it has no frame {frame}")
        return await self.create(
            {**recording.config, "name": name}, Origin(recording, last if frame is None else frame)
        )

    async def create(self, config: Mapping[str, Any], origin: Origin | None = None) -> HostedWorld:
        """Creates a world and hosts it, as `add`; made in a thread.

        Args:
            config: Its config.
            origin: Where it goes on from; None: it is new.

        Raises:
            RejectedMessage, WorldError: As `offer`; or it cannot be created (`world_unavailable`).
        """
        name = self.offer(config)
        if origin is not None:
            self._origins[name] = origin
        failure = await self.open(name)
        if failure is not None:
            self._forget(name)
            raise failure
        return self.worlds[name]

    async def release(self, name: str, farewell: NmesError) -> None:
        """Gives a world away to another process, which goes on from its recording: here it is forgotten."""
        while name in self._opening:
            await asyncio.sleep(0.01)
        self._forget(name)
        self._turn_away(name, farewell)
        if (hosted := self._take_out(name)) is not None:
            await hosted.close(farewell)
            self._note_end(hosted)

    def show_worlds(self, connection: Connection, only: Collection[str] | None, start: int = 0) -> None:
        """Answers a client with a page of the worlds, of all if not of some. Creates none."""
        connection.answer(self.list_worlds(connection.port, only, start))

    def list_worlds(self, port: int, only: Collection[str] | None = None, start: int = 0) -> dict[str, Any]:
        """Returns the `world_list` message for a client of a port, of all worlds if not of some."""
        page, following = self._catalog.page(start, only)
        return self._world_list(port, page, following, self.states(offer.name for offer in page))

    def states(self, names: Iterable[str]) -> dict[str, dict[str, Any]]:
        """Returns the entries of live worlds in a list of worlds, by name."""
        return {
            name: _state(self.worlds[name]) if name in self.worlds else {"asleep": True}
            for name in names
            if name in self.worlds or name in self._kept
        }

    @property
    def awake(self) -> dict[str, int]:
        """The worlds that take time, with the numbers of their clients."""
        worlds = [hosted for hosted in self._awake if not hosted.hibernation.resting and hosted.status.fault is None]
        return {hosted.name: hosted.clients for hosted in sorted(worlds, key=lambda hosted: hosted.name)}

    def _figures(self) -> Figures:
        awake = [hosted.figures for hosted in self.worlds.values() if not hosted.world.asleep]
        ready = self.unready is None
        return Figures(len(self._connections), self.received, self.sent, ready, len(self.worlds), awake)

    async def announce(self, event: Mapping[str, Any]) -> None:
        """Sends subscribers in all worlds an event of the host."""
        await asyncio.gather(*(hosted.announce(event) for hosted in self._awake))

    # -- the host at work ----------------------------------------------------------------------------------------------

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
        found = await super().listen(host, port, world)
        if not self._running:
            self._running = True
            flushing = (self._flush_interval or 1.0) / 2  # of what is promised: a slice or a long step may come between
            self._tasks = [keep_on(self._inspect, self.limits.inspection), keep_on(self._flush, flushing)]
            if (idle := self._hibernate_after) is not None:
                self._tasks.append(keep_on(partial(self._hibernate, idle), min(max(idle / 4, 0.01), 5.0)))
            if self._retention is not None:
                self._tasks.append(keep_on(partial(self._sweep, self._retention), SWEEP))
            for hosted in self.worlds.values():
                hosted.start()
        return found

    async def serve_http(self, host: str, port: int, application: ASGIApp) -> tuple[str, int]:
        """Serves an application over HTTP and WebSockets, such as `worlds_application`, to those at the door.

        Returns:
            The address and the port that it listens on.

        Raises:
            MachineError: `cannot_listen`, as `listen`.
        """
        from nmes.server.http import HttpServer  # which takes a while to load

        server = HttpServer(application, self._door, self.limits)
        self._http_servers.append(server)
        return await server.listen(host, port)

    async def metrics_page(self) -> bytes:
        """Makes the page of metrics."""
        assert self._metrics is not None
        return self._metrics.page()

    async def _flush(self) -> None:
        for hosted in list(self._awake):
            try:
                await hosted.flush()
            except Exception:  # of one, which must not keep the others from the disk
                logger.exception("the recording of world %r cannot be flushed", hosted.name)

    async def _hibernate(self, idle: float) -> None:
        """Has worlds hibernate that nobody uses, a few at once: else they could be made faster than they sleep.

        Beside worlds that keep pace with the wall's clock it is one at a time, with pauses: threads would take Python's
        lock from the loop, in which those tick.
        """

        async def put_to_sleep(worlds: Iterator[HostedWorld], gently: bool) -> int:
            asleep = 0
            for hosted in worlds:
                began = monotonic()
                try:
                    await hosted.hibernation.begin(idle)
                except Exception:  # of one, which must not keep the others awake
                    logger.exception("world %r cannot be put to sleep", hosted.name)
                if hosted.hibernation.resting:
                    self._awake.discard(hosted)
                    asleep += 1
                    if gently:
                        await asyncio.sleep(monotonic() - began)
            return asleep

        paced = any(hosted.status.mode == "realtime" and not hosted.hibernation.resting for hosted in self._awake)
        worlds = iter(list(self._awake))
        lanes = (put_to_sleep(worlds, paced) for _ in range(1 if paced else SLEEPERS))
        let_go = sum(await asyncio.gather(*lanes))
        await self._memory.tidy(len(self.worlds), let_go, idle=not self._awake, paced=paced)

    async def _sweep(self, retention: Retention) -> None:
        await retention.tidy([*(hosted.recording for hosted in self.worlds.values()), *self._kept.values()])

    @property
    def abandoned(self) -> bool:
        """Whether a world was left in the middle of a tick when the host closed: its thread goes on until that ends."""
        return any(hosted.abandoned for hosted in (*self.worlds.values(), *self.closed))

    async def close(self) -> None:
        """Stops listening, closes the worlds and their recordings, tells the clients, and hangs up."""
        self.draining = True  # else those who are at the door could have worlds opened that nobody closes
        await self._stop_listening()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, *self._makers, *self._opening.values(), return_exceptions=True)
        self._tasks.clear()
        await asyncio.gather(*(hosted.close() for hosted in self.worlds.values()))
        await self._hang_up_on_all()
        for server in self._http_servers:
            await server.close()
        self._running = False
        self._pool.close(wait=not self.abandoned)


def _state(hosted: HostedWorld) -> dict[str, Any]:
    status = hosted.status
    return {
        "mode": status.mode,
        "frame": status.frame,
        "clients": hosted.clients,
        "fault": None if status.fault is None else status.fault.code,
        "asleep": hosted.hibernation.resting,  # until its recording is whole, it is not
        "ratio": None if status.lag is None else round(status.lag.ratio, 3),
    }
