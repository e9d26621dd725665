"""The supervisor of workers: who listens, lets in, and knows which worlds there are, and whose they are.

It hides that there are several processes: clients meet one host. A world comes back anywhere from its recording, which
is the one way by which worlds move. Invariants: a world is brought up in a worker only when the one that had it has
given it away, or its process is no more; it comes back from the recording that was told of it last.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import ssl
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Any, Self, cast

from nmes.errors import NmesError, WorldError
from nmes.fleet.control import LineEnded, Message
from nmes.fleet.visitor import Visitor
from nmes.fleet.worker_processes import WorkerProcess, WorkerProcesses
from nmes.server.access_log import AccessLog
from nmes.server.catalog import Catalog
from nmes.server.connection import Connection
from nmes.server.door import Guesses
from nmes.server.host import SWEEP
from nmes.server.keys import Keys
from nmes.server.metrics import merged_pages
from nmes.server.reception import Reception, keep_on, spawn
from nmes.server.retention import Retention

__all__ = ["Supervisor", "shares_of_guesses"]

logger = logging.getLogger(__name__)

ATTEMPTS = 3  # workers that may end while they bring up a world: it may be the world that ends them
BALANCE = 2.0  # s: how often it is looked whether one has more to do than another
DIRECT = 0.25  # of all wrong passwords, how many may come to the workers' own ports
LEAST = 1.0 / Guesses.ADDRESS[0]  # for each worker: an address that did not guess lately is heard everywhere


@dataclass(slots=True)
class _Place:
    """Where a world is.

    Attributes:
        worker: The worker that has it; None: none.
        former: The worker that had it, and may not have ended yet; None: there is none.
        recording: What it comes back from; None: it was never brought up.
        failure: Why it could not come back when that was tried last.
    """

    worker: WorkerProcess | None = None
    former: WorkerProcess | None = None
    recording: Path | None = None
    failure: str | None = None


def shares_of_guesses(workers: int) -> tuple[float, float]:
    """Returns which part of all wrong passwords may come to the host's own port, and which to that of each worker.

    All together are one budget, as no port knows what comes to the others. Of very many workers, of which each must
    hear a first guess, it is more than one by what the host's own port needs.
    """
    each = max(DIRECT / workers, LEAST)
    return max(DIRECT, 1.0 - workers * each), each


class Supervisor(Reception):
    """Serves worlds in worker processes: `offer` them, `start`, `listen`, and in the end `close`."""

    def __init__(
        self,
        keys: Keys,
        command: Sequence[str],
        *,
        record_to: Path,
        address: str,
        catalog: Catalog | None = None,
        hibernate_after: float | None = None,
        flush_interval: float = 1.0,
        tls: ssl.SSLContext | None = None,
        tls_files: tuple[Path, Path] | None = None,
        metrics: bool = False,
        access_log: Path | None = None,
        retention: Retention | None = None,
    ) -> None:
        """Makes a supervisor without workers.

        Args:
            keys: What opens which world.
            command: What starts a worker; the number of a descriptor is added.
            record_to: Directory for the recordings of all worlds.
            address: The address at which workers have ports of their own.
            catalog: Holds the templates of worlds, and how many there may be; no world yet.
            hibernate_after: How long (s) a world is idle before it hibernates; None: none ever does.
            flush_interval: How much (s) of a recording a crash may lose; with 0 nothing is told before it is on disk.
            tls: Holds the host's certificate; None: all goes over the wire as it is.
            tls_files: The certificate and its key, for the workers' own ports.
            metrics: Whether workers count what they do.
            access_log: Where who comes and goes is written; None: nowhere.
            retention: Which recordings are removed; None: none.
        """
        log = None if access_log is None else AccessLog(access_log)
        super().__init__(keys, catalog=catalog, tls=tls, access_log=log)
        begin = {
            "keys": keys.shared(),
            "record_to": str(record_to),
            "address": address,
            "hibernate_after": hibernate_after,
            "flush_interval": flush_interval,
            "tls": None if tls_files is None else [str(file) for file in tls_files],
            "metrics": metrics,
            "access_log": None if access_log is None else str(access_log),
            "engines": self._catalog.engines,
        }
        self._begin = begin
        self.workers = WorkerProcesses(command, begin, self._hear, self._lose)
        self.lost: list[tuple[str, str]] = []  # worlds whose recordings are not whole, and why, of workers that ended
        self._places: dict[str, _Place] = {}
        self._numbers = count(1)  # of connections
        self._moves = 0
        self._retention = retention
        self._tasks: list[asyncio.Task[None]] = []
        self._closing = False

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def start(self, workers: int) -> None:
        """Starts so many workers.

        Raises:
            MachineError: One does not start (`worker_failed`).
        """
        self.most_connections = workers * self.limits.connections
        own, each = shares_of_guesses(workers)
        self.guesses, self._begin["guesses"] = Guesses(own), each
        await self.workers.start(workers)
        self._running = True
        self._tasks = [keep_on(self._inspect, self.limits.inspection), keep_on(self._balance, BALANCE)]
        if self._retention is not None:
            self._tasks.append(keep_on(partial(self._sweep, self._retention), SWEEP))

    async def close(self) -> None:
        """Stops listening, has the workers close their worlds and end, and hangs up."""
        self._closing = self.draining = True
        await self._stop_listening()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        lost = await self.workers.close()
        for opening in (*self._opening.values(), *self._makers):
            opening.cancel()
        await asyncio.gather(*self._opening.values(), *self._makers, return_exceptions=True)
        self.lost = sorted({*self.lost, *lost})  # a worker that drains may tell twice
        await self._hang_up_on_all()

    # -- worlds ----------------------------------------------------------------------------------------------------

    def recording(self, name: str) -> Path | None:
        """Returns the recording from which a world comes back; None: it was never brought up."""
        place = self._places.get(name)
        return None if place is None else place.recording

    def find(self, name: str, connection: Connection) -> None:
        """Hands a connection to the worker that has its world, when there is one."""
        place = self._places.get(name)
        worker = None if place is None else place.worker
        if worker is None or not worker.takes or name in self._opening:
            self._wait_for(name, connection)
            self.workers.hurry(name)
        else:
            cast(Visitor, connection).hand_over(worker, name, next(self._numbers))

    async def _open(self, name: str) -> NmesError | None:
        """Brings a world up in the worker that has the least to do: a new one, or from its recording."""
        if name not in self._places:
            self._places[name] = _Place(recording=self._kept.pop(name, None))
        place = self._places[name]
        for _ in range(ATTEMPTS):
            try:
                worker = await self.workers.reserve(name, urgent=name in self._waiting)
            except WorldError as error:
                return error
            try:
                failure = await self._open_in(worker, name, place)
            except LineEnded:
                place.former = worker
                continue
            finally:
                self.workers.free(worker)
            if failure is not None or place.worker is not None:
                return failure
        logger.error("world %r is left where it is: workers ended while they brought it up", name)
        place.failure = "worker_ended"
        return WorldError("world_unavailable", f"world {name!r} could not be brought up; see the server's log")

    async def _open_in(self, worker: WorkerProcess, name: str, place: _Place) -> NmesError | None:
        """Brings a world up in a worker; one that ends meanwhile, or drains, does not have it then.

        Raises:
            LineEnded: The worker has ended.
        """
        if place.worker is not None:
            place.former, place.worker = place.worker, None
            with contextlib.suppress(LineEnded):
                await place.former.line.ask("release", world=name)
                place.former = None
                self._moves += 1
        if place.former is not None:
            await place.former.ended.wait()
            place.former = None
        offer = self._catalog[name]
        told = await worker.line.ask(
            "host",
            world=name,
            config=offer.config,
            maker=offer.maker,
            keys=self.keys.share_world(name),
            recording=None if place.recording is None else str(place.recording),
        )
        if "error" in told.body:
            logger.error("world %r could not be brought up: %s", name, told.body["error"])
            place.failure = told.body["code"]
            return WorldError("world_unavailable", told.body["error"])
        place.recording, place.failure = Path(told.body["recording"]), None
        if worker.gone:
            place.former = worker
        else:
            place.worker = worker
            worker.awake.setdefault(name, 0)
            if worker.draining:
                return await self._open(name)
        return None

    async def _close(self, name: str) -> Path | None:
        place = self._places.pop(name, None) or _Place(recording=self._kept.pop(name, None))
        if place.worker is not None:
            with contextlib.suppress(LineEnded):
                await place.worker.line.ask("close_world", world=name)
        return place.recording

    def show_worlds(self, connection: Connection, only: Collection[str] | None, start: int = 0) -> None:
        """Answers a client with a page of the worlds, of all if not of some. Creates none."""

        async def show() -> None:
            page, following = self._catalog.page(start, only)
            states = await self._states([offer.name for offer in page])
            connection.answer(self._world_list(connection.port, page, following, states))

        spawn(show(), self._makers)

    async def _states(self, names: Iterable[str]) -> dict[str, Mapping[str, Any]]:
        """Asks the workers for what a list tells of worlds."""
        by_worker: dict[WorkerProcess, list[str]] = {}
        states: dict[str, Mapping[str, Any]] = {}
        for name in names:
            place = self._places.get(name)
            if name in self._kept:
                states[name] = {"asleep": True}
            elif place is not None:  # as it is in no worker, also where one dies before it has answered
                states[name] = {"fault": place.failure, "asleep": place.recording is not None and not place.failure}
                if place.worker is not None:
                    by_worker.setdefault(place.worker, []).append(name)

        async def ask(worker: WorkerProcess, worlds: list[str]) -> None:
            with contextlib.suppress(LineEnded):
                told: dict[str, dict[str, Any]] = (await worker.line.ask("states", worlds=worlds)).body["states"]
                states.update({name: {**state, "worker_port": worker.port} for name, state in told.items()})
                for name, state in told.items():
                    if state["asleep"]:  # sooner than the worker's next report
                        worker.awake.pop(name, None)

        await asyncio.gather(*(ask(worker, worlds) for worker, worlds in by_worker.items()))
        return states

    @property
    def occupied(self) -> bool:
        """Whether somebody is in, also by a worker's own port."""
        awake = (worker.awake for worker in self.workers.running)
        return super().occupied or any(clients for worlds in awake for clients in worlds.values())

    async def announce(self, event: Mapping[str, Any]) -> None:
        """Sends subscribers in all worlds an event, and has the workers' own ports let nobody in that may not here."""

        async def tell(worker: WorkerProcess) -> None:
            with contextlib.suppress(LineEnded):
                await worker.line.ask("announce", event=event, draining=self.draining)

        await asyncio.gather(*(tell(worker) for worker in self.workers.running))

    # -- workers ---------------------------------------------------------------------------------------------------

    def _greet(self, world: str | None) -> Connection:
        return Visitor(self, world)

    def _hear(self, worker: WorkerProcess, message: Message) -> None:
        match message.body["order"]:
            case "left":
                visitor = worker.visitors.get(message.body["number"])
                if visitor is not None:
                    visitor.leave()
            case "awake":
                worker.awake = message.body["worlds"]
            case "drain" if not self._closing and not self.draining and not worker.draining:
                spawn(self._drain(worker), self._makers)

    def _lose(self, worker: WorkerProcess) -> None:
        """Tells the clients of a worker that is gone, and has its worlds brought up elsewhere.

        Those that slept come back when somebody enters them: nothing is lost by it, and no other has to wait for them.
        """
        for visitor in list(worker.visitors.values()):
            visitor.leave(WorldError("world_moved", "a process of this host has ended: connect again"))
        for name, place in self._places.items():
            if place.worker is worker:
                place.worker, place.former = None, worker
                if name in worker.awake:
                    self._begin_opening(name)

    async def _drain(self, worker: WorkerProcess) -> None:
        """Moves the worlds of a worker that was told to end, and lets it end."""
        logger.warning("worker %d was told to end; its worlds go to others", worker.number)
        self.workers.replace(worker)
        with contextlib.suppress(LineEnded):
            here = [name for name, place in self._places.items() if place.worker is worker and name in worker.awake]
            await asyncio.gather(*(self.open(name) for name in here))
            for place in self._places.values():
                if place.worker is worker:  # they sleep, and are complete when it has ended
                    place.worker, place.former = None, worker
            self.lost += await worker.close()

    async def _balance(self) -> None:
        """Moves worlds from a worker that has many more awake than another, those with the fewest clients first."""
        uneven = self.workers.uneven()
        if uneven is None or self._opening:
            return
        worker, number = uneven
        for name, _ in sorted(worker.awake.items(), key=lambda item: (item[1], item[0]))[:number]:
            place = self._places.get(name)
            if place is not None and place.worker is worker and worker.takes:
                await self.open(name)

    async def _sweep(self, retention: Retention) -> None:
        await retention.tidy([*(place.recording for place in self._places.values()), *self._kept.values()])

    async def metrics_page(self) -> bytes:
        """Makes one page of those of all workers, each figure with the number of its worker."""
        pages: dict[str, bytes] = {}

        async def ask(worker: WorkerProcess) -> None:
            with contextlib.suppress(LineEnded):
                pages[str(worker.number)] = (await worker.line.ask("metrics")).data

        running = self.workers.running
        await asyncio.gather(*(ask(worker) for worker in running))
        own = {
            "nmes_workers": ("Worker processes that run", len(running)),
            "nmes_worker_restarts_total": ("Workers that were started again", self.workers.restarts),
            "nmes_worlds_moved_total": ("Worlds that one worker gave to another", self._moves),
        }
        return merged_pages(dict(sorted(pages.items())), own)
