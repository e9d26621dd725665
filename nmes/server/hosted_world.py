"""One world being served: the world, its recorder, those who are in it, its clock, and who waits for whom.

It hides the pace of `realtime` and `fast`, the barrier of lockstep, when a recording is flushed, and in which thread
the world is. A `HostedWorld` is the only door to its world; it knows no sockets, only `Peer`s.

Short work is done where it is asked for, in the event loop. For what may take long, and where several worlds have work,
the world goes away: into a thread of the host's `WorkerPool`. How long work will take is guessed from the clock, which
so decides where it is done, and never what comes of it.

Invariants:

- A world is touched by one thread at a time, in one order: requests are executed as they are handed in, ticks come
  between. While it is away, nobody else touches it: requests wait in the order in which they came.
- Nobody waits for long: ticks run in slices of `SLICE` s, then others have their turn, in the loop and in the crew.
- Nothing is told to anybody that a recording which waits for the disk does not hold.
"""

from __future__ import annotations

import asyncio
import logging
import math
import os
import re
import threading
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple, Protocol, TypeVar

from nmes.errors import NmesError, RecordingError
from nmes.playback.fork import fork
from nmes.playback.restore import restore_into
from nmes.protocol import Request
from nmes.recording import Recorder, Recording
from nmes.server.metrics import Metrics, WorldFigures
from nmes.world import Barrier, Fault, World

__all__ = ["SLICE", "HostedWorld", "Peer", "Status", "WorkerPool"]

logger = logging.getLogger(__name__)

SLICE = 0.005  # s: how long one connection's commands or one world's ticks may keep the others waiting
BRIEF = 0.0005  # s: what is not worth the way to another thread and back
CATCH_UP = 0.25  # s: a realtime world that fell further behind than this lets the rest go
THREADS = 1000  # worlds that can be away; no more of them run at once than there are cores

_TICK = 1e-4  # s: what a tick is taken to cost before one was measured
_COMMAND = 2e-5  # s: about what a command of a batch costs
_PICTURE = 0.01  # s: about what a picture costs

_LONG = frozenset({"step", "batch", "get_camera"})  # the commands that may take long

T = TypeVar("T")


class WorkerPool:
    """The threads for worlds that are away: as many run at once as there are cores, each in its turn.

    Attributes:
        last: The world that ticked last: another one that comes now is not alone in having work.
    """

    def __init__(self) -> None:
        self.last: object = None
        self._pool = ThreadPoolExecutor(THREADS, "nmes-world")  # makes them when they are needed
        self._lock = threading.Lock()
        self._free = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        self._queue: deque[threading.Lock] = deque()  # of those that wait for their turn

    def run(self, work: Callable[[], T]) -> Future[T]:
        """Has something done in a thread."""
        return self._pool.submit(self._in_turn, work)

    def _in_turn(self, work: Callable[[], T]) -> T:
        self._begin()
        try:
            return work()
        finally:
            self._end()

    def give_way(self) -> None:
        """Lets those that wait go first: called by what is running, now and then."""
        if self._queue:
            self._end()
            self._begin()

    def _begin(self) -> None:
        with self._lock:
            if self._free:
                self._free -= 1
                return
            turn = threading.Lock()
            turn.acquire()
            self._queue.append(turn)
        turn.acquire()

    def _end(self) -> None:
        with self._lock:
            if self._queue:
                self._queue.popleft().release()
            else:
                self._free += 1

    def close(self) -> None:
        """Lets the threads go, when their work is done."""
        self._pool.shutdown()


class Peer(Protocol):
    """What a hosted world asks of a connection."""

    def send_event(self, event: bytes) -> None:
        """Sends an event, without delimiter, when the slice ends."""

    def flush(self) -> None:
        """Hands what there is to the socket."""

    def go_on(self) -> None:
        """Does what had to wait."""

    def unsay(self) -> None:
        """Takes back what is not yet handed to the socket."""

    def hang_up(self, error: NmesError) -> None:
        """Tells the error and closes."""


class Status(NamedTuple):
    """How a world is doing."""

    mode: str
    frame: int
    fault: Fault | None


class _Stopped(BaseException):
    """The host closes: what a world is doing ends in the middle, after a tick."""


class HostedWorld:
    """One world being served: the world, its recorder, its connections and its clock.

    All methods are called in the event loop's thread, except those that say so.
    """

    _loop: asyncio.AbstractEventLoop  # that the world comes back to

    def __init__(
        self,
        config: Mapping[str, Any],
        crew: WorkerPool,
        record_to: Path | None = None,
        flush_interval: float = 1.0,
        metrics: Metrics | None = None,
        resume: tuple[Recording, int | None] | None = None,
    ) -> None:
        """Creates the world and begins its recording, a new file in the directory `record_to`, if one is given.

        The world is a new one, or with `resume` goes on from a frame of a recording, of which `config` is.
        """
        self.world = World(config, emit=self._emit) if metrics is None else metrics.world(config, self._emit)
        self.name: str = self.world.config["name"]
        self.recording: Path | None = None
        self._recorder: Recorder | None = None
        if record_to is not None:
            try:
                record_to.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise RecordingError("recording_failed", f"cannot make {record_to}: {error.strerror}") from error
            self.recording = _new_recording_path(record_to, self.name)
            if resume is None:
                self._recorder = Recorder(self.recording, self.world, flush_interval=flush_interval)
                self.world.journal = self._recorder
            else:
                recording, frame = resume
                self._recorder = fork(recording, self.world, self.recording, frame, flush_interval=flush_interval)
        elif resume is not None:
            recording, frame = resume
            restore_into(self.world, recording, recording.last_frame if frame is None else frame)
        for client in self.world.clients():  # their connections are gone
            self.world.leave(client)
        self._flushed = monotonic()
        self._flush_due = False
        self._connections: dict[int, Peer] = {}
        self._speaking: list[Peer] = []  # those with output that is not yet handed to their sockets
        self._settling = False
        self._closing = False
        self._fault_logged: object = None
        # Where the world is.
        self._crew = crew
        self._cost = _TICK  # s: what a tick has cost of late
        self._next: tuple[Callable[[], Any], Callable[[Any], None]] | None = None  # for what the world goes away next
        self._away = False
        self._until = 0.0  # when the slice ends of what it does there
        self._idle = 0.0  # s: for how long it had to wait there
        self._returned = asyncio.Event()
        self._status = self._look()  # before it went
        self._events: list[tuple[int, bytes]] = []  # that it had to tell there
        self._waiting: dict[Peer, None] = {}  # those that found it away
        self._left: list[int] = []  # clients that went meanwhile
        self._replies: dict[int, Future[bytes]] = {}  # to requests that were executed there
        self._lost: RecordingError | None = None  # why what it had to tell may be of what is lost
        # The clock.
        self._clock: asyncio.Handle | None = None
        self._clock_due = False
        self._pace: tuple[str, float] | None = None  # mode and rate that the clock was set for; None: not ticking
        self._frame = 0  # where the clock left the world
        self._began = 0.0  # the wall's time and the frame from which the pace of `realtime` is reckoned
        self._began_frame = 0
        self._rendezvous = _Rendezvous()
        self._alarm: asyncio.TimerHandle | None = None  # when those that wait for others have waited enough
        self._alarm_frame = 0

    def __repr__(self) -> str:
        return f"HostedWorld({self.name!r}, frame {self.status.frame}, {len(self._connections)} clients)"

    @property
    def clients(self) -> int:
        """How many connections are in this world."""
        return len(self._connections)

    @property
    def status(self) -> Status:
        """How the world is doing; while it is away, how it was when it went."""
        return self._status if self._away else self._look()

    def _look(self) -> Status:
        return Status(self.world.mode, self.world.frame, self.world.fault)

    # -- those who are in it ---------------------------------------------------------------------------------------

    def admits(self, connection: Peer) -> bool:
        """Whether a connection may `join` now; if not, its `go_on` is called when it may try again."""
        if self._away:
            self._waiting[connection] = None
        return not self._away and not self._closing

    def join(self, connection: Peer) -> tuple[int, dict[str, Any]]:
        """Lets a connection in that is admitted; returns its client number and its `auth_success`."""
        client = self.world.join()
        self._connections[client] = connection
        return client, self.world.welcome(client)

    def leave(self, client: int) -> None:
        """Lets a client go; its cubes stay."""
        connection = self._connections.pop(client)
        self._rendezvous.forget(client)
        self._replies.pop(client, None)
        self._waiting.pop(connection, None)
        if self._away:
            self._left.append(client)
        elif not self._closing:
            self.world.leave(client)

    def holds(self, client: int, request: Request) -> bool:
        """Whether a client's request has to wait; its `go_on` is called when it may try again.

        It waits while the world is away, also for its own sake; and where there is a barrier, a `step` waits until all
        others who control the world have said it too.
        """
        if self._away or self._closing:
            self._waiting[self._connections[client]] = None
            return True
        if request.type not in _LONG or client in self._replies:
            return False
        command, world = request.command, self.world
        if command is None or world.fault is not None:
            return False
        if world.barrier is not None and request.type == "step":
            return self._rendezvous.arrive(world.barrier, client, command.get("ticks", 1))
        if self._is_short(self._expected(command)):
            return False
        execute = self._step if request.type == "step" else world.handle
        self._next = partial(execute, client, request), partial(self._executed, client)
        return True

    def handle(self, client: int, request: Request) -> bytes:
        """Executes a request that need not wait; returns the encoded reply. Call `settle` after the last of a row."""
        if self._replies and (reply := self._replies.pop(client, None)) is not None:
            return reply.result()
        return self._step(client, request) if request.type == "step" else self.world.handle(client, request)

    def _step(self, client: int, request: Request) -> bytes:
        """Executes a `step` and measures it, in the thread in which the world is."""
        began, frame, self._idle = monotonic(), self.world.frame, 0.0
        reply = self.world.handle(client, request)
        self._measure(self.world.frame - frame, monotonic() - began - self._idle)
        return reply

    def _executed(self, client: int, reply: Future[bytes]) -> None:
        """Keeps the reply until the client asks again."""
        if (connection := self._connections.get(client)) is not None:
            self._replies[client] = reply
            asyncio.get_running_loop().call_soon(connection.go_on)
        else:
            reply.result()  # nobody hears it, but a mistake of ours must be

    def _emit(self, client: int, event: bytes) -> None:
        """Tells an event, in the thread in which the world is; those who left meanwhile hear it no more."""
        if self._away:
            self._events.append((client, event))
        elif (connection := self._connections.get(client)) is not None:
            connection.send_event(event)

    def speak(self, connection: Peer) -> None:
        """Takes note that a connection has something to hand to its socket when the slice ends."""
        self._speaking.append(connection)

    def settle(self) -> None:
        """Ends a slice: hands output to the sockets, and sees to what the world does next."""
        if self._away or self._closing:
            return
        if self._settling:  # a connection ended while it was handed its output
            asyncio.get_running_loop().call_soon(self.settle)
            return
        self._settling = True
        try:
            if self._rendezvous.waiting or self._alarm is not None:
                self._meet()
            if self.world.fault is not self._fault_logged:
                self._log_fault()
            self._hand_over()
        finally:
            self._settling = False
        if self._next is not None:
            self._go(*self._next)
        elif self._clock is not None or self.world.running:
            self._wind()

    def _log_fault(self) -> None:
        """Tells whoever runs the host what the world's clients were told."""
        self._fault_logged = fault = self.world.fault
        if fault is not None:
            logger.error("world %r stopped at frame %d: %s: %s", self.name, fault.frame, fault.code, fault.message)

    def _hand_over(self) -> None:
        while self._speaking:
            speaking, self._speaking = self._speaking, []
            for connection in speaking:
                connection.flush()

    # -- where it is -----------------------------------------------------------------------------------------------

    def _is_short(self, expected: float) -> bool:
        """Whether what will take as long (s) is done in the loop."""
        return expected <= (SLICE if self._crew.last is self else BRIEF)

    def _expected(self, command: Mapping[str, Any]) -> float:
        """Returns how long (s) a command will take, as far as one can tell."""
        kind = command["type"]
        if kind == "step":
            return float(command.get("ticks", 1) * self._cost)
        if kind == "batch":
            inner = command["commands"]
            return len(inner) * _COMMAND + sum(map(self._expected, inner))
        return _PICTURE if kind == "get_camera" else 0.0

    def _measure(self, ticks: int, took: float) -> None:
        self._crew.last = self
        if ticks > 0:
            self._cost += (took / ticks - self._cost) / 4

    def _tick(self, most: float) -> int:
        """Ticks for one slice, in the thread in which the world is; returns how often."""
        world, began, ticks = self.world, monotonic(), 0
        while ticks < most and world.fault is None:
            world.tick()
            ticks += 1
            if (took := monotonic() - began) >= SLICE:
                break
        if ticks:
            self._measure(ticks, took)
        return ticks

    def _advance(self, most: float, then: Callable[[int], None]) -> None:
        """Ticks for one slice, here, or away as soon as this slice ends; `then` is told how often."""
        if self._is_short(most * self._cost):
            then(self._tick(most))
        else:
            self._next = partial(self._tick, most), lambda ticks: then(ticks.result())

    def _go(self, work: Callable[[], T], then: Callable[[Future[T]], None]) -> None:
        """Sends the world away to do something; `then` gets what came of it when the world is back."""
        self._next = None
        self._status = self._look()
        self._away = True
        self.world.between = self._between
        self._until = monotonic() + SLICE
        self._returned.clear()
        self._loop = loop = asyncio.get_running_loop()
        done = self._crew.run(work)
        done.add_done_callback(lambda done: loop.call_soon_threadsafe(self._come_back, then, done))

    def _between(self) -> None:
        """Lets others have their turn after a slice of ticks; called by the world, in the thread in which it is."""
        if self._closing:
            raise _Stopped
        if monotonic() < self._until:
            return
        if self._recorder is not None and self.world.journal is not None:
            if self._flush_due:
                self._flush_due = False
                self._recorder.flush()
                self._flushed = monotonic()
            if self._events:
                try:
                    self._recorder.commit()
                except RecordingError as error:
                    self._events.clear()
                    self._lost = error
                    raise
        if self._events:
            events, self._events = self._events, []
            self._loop.call_soon_threadsafe(self._deliver, events)
        stopped = monotonic()
        self._crew.give_way()
        now = monotonic()
        self._idle += now - stopped
        self._until = now + SLICE

    def _deliver(self, events: list[tuple[int, bytes]]) -> None:
        """Hands over what a world had to tell; where that waits for the disk, it is there."""
        for client, event in events:
            if (connection := self._connections.get(client)) is not None:
                connection.send_event(event)
        self._hand_over()

    def _come_back(self, then: Callable[[Future[T]], None], done: Future[T]) -> None:
        """Goes on with a world that was away: first those who waited, then it itself."""
        loop = asyncio.get_running_loop()
        self._away, self.world.between = False, None
        events, self._events = self._events, []
        self._returned.set()
        if self._closing:
            self._deliver(events)
            return
        waiting, self._waiting = self._waiting, {}
        for connection in waiting:
            loop.call_soon(connection.go_on)
        left, self._left = self._left, []
        for client in left:
            self.world.leave(client)
        self._deliver(events)
        if self._lost is not None:
            for connection in list(self._connections.values()):
                connection.hang_up(self._lost)
            self._lost = None
        if self._flush_due:
            self.flush()
        if self._clock_due:
            self._clock_due = False
            self._clock = loop.call_soon(self._turn)
        try:
            then(done)
        finally:
            self.settle()

    # -- the barrier -----------------------------------------------------------------------------------------------

    def _meet(self) -> None:
        """Ticks while all who control the world have said `step`, and lets those go on that have had their ticks."""
        world, rendezvous = self.world, self._rendezvous
        if world.barrier is None or world.fault is not None:
            self._let_go(rendezvous.waiting)
            self._rendezvous = _Rendezvous()
        elif self._next is None and rendezvous.complete(world.barrier):
            self._advance(min(rendezvous.waiting.values()), self._met)
        self._set_alarm()

    def _met(self, ticks: int) -> None:
        self._let_go(self._rendezvous.ticked(ticks))
        if self._rendezvous.complete(self.world.barrier):  # the slice was over before
            asyncio.get_running_loop().call_soon(self.settle)

    def _let_go(self, clients: Iterable[int]) -> None:
        for client in clients:
            asyncio.get_running_loop().call_soon(self._connections[client].go_on)

    def _set_alarm(self) -> None:
        """Sets the time-out of those that wait, from the last tick on; none where nobody waits."""
        barrier, now = self.world.barrier, self.world.frame
        waits = barrier is not None and bool(self._rendezvous.waiting)
        if self._alarm is not None and (not waits or self._alarm_frame != now):
            self._alarm.cancel()
            self._alarm = None
        if barrier is not None and waits and self._alarm is None:
            self._alarm = asyncio.get_running_loop().call_later(barrier.timeout, self._go_without)
            self._alarm_frame = now

    def _go_without(self) -> None:
        self._alarm = None
        if self._away:
            return  # it is set anew when the world is back
        late = [client for client in self._connections if self._rendezvous.is_late(client)]
        self._rendezvous.give_up()
        logger.warning("world %r goes on at frame %d without clients %s", self.name, self.world.frame, late)
        self.world.announce({"type": "barrier_timeout", "frame": self.world.frame, "clients": late})
        self.settle()

    # -- the clock -------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Starts the clock, where the world ticks by itself."""
        self._wind()

    def _wind(self) -> None:
        """Starts, stops or sets the clock anew where mode, rate, pause or frame are not what it was set for."""
        world = self.world
        if not world.running:
            if self._clock is not None:
                self._clock.cancel()
                self._clock = self._pace = None
        elif (world.mode, world.rate) != self._pace or world.frame != self._frame:
            if self._clock is not None:
                self._clock.cancel()
            self._pace = (world.mode, world.rate)
            self._frame = self._began_frame = world.frame
            self._began = monotonic()
            self._clock = asyncio.get_running_loop().call_soon(self._turn)

    @property
    def _speed(self) -> float:
        """Ticks per second of the wall's clock."""
        return float(self.world.rate * self.world.config["tick_rate"])

    def _turn(self) -> None:
        """Ticks as often as is due, for one slice."""
        if self._away:
            self._clock_due = True
            return
        due = math.inf
        if self.world.mode == "realtime":
            now, gone = monotonic(), self.world.frame - self._began_frame
            self._began += max(now - self._began - gone / self._speed - CATCH_UP, 0.0)
            due = math.floor((now - self._began) * self._speed) - gone
        self._advance(due, partial(self._turned, due))
        self.settle()

    def _turned(self, due: float, ticks: int) -> None:
        loop = asyncio.get_running_loop()
        self._frame = self.world.frame
        if due > ticks:
            self._clock = loop.call_soon(self._turn)
        else:
            self._clock = loop.call_at(self._began + (self._frame + 1 - self._began_frame) / self._speed, self._turn)

    # -- the recording ---------------------------------------------------------------------------------------------

    def flush(self) -> None:
        """Brings the recording to disk, as far as the world has gone; a failure to do so stops the world."""
        self._flush_due = self._away  # then it is done there, after the slice
        if self._recorder is not None and not self._away and self.world.journal is not None:
            try:
                self._recorder.flush()
            except RecordingError as error:
                self.world.stop_recording(error)
                self.settle()
            else:
                self._flushed = monotonic()

    @property
    def figures(self) -> WorldFigures:
        """What metrics tell of this world."""
        lag = None if self._recorder is None else monotonic() - self._flushed
        return WorldFigures(self.name, self.clients, self.status.fault is not None, lag)

    def commit(self) -> None:
        """Waits for the disk, if that was asked for: called before anything is told to anybody.

        Where it fails, what is about to be told may be of what is lost: nobody hears it, and the world stops. Of what a
        world tells while it is away, it waits for the disk itself; what it told before is on disk since it went.
        """
        if self._recorder is not None and not self._away and self.world.journal is not None:
            try:
                self._recorder.commit()
            except RecordingError as error:
                connections = list(self._connections.values())
                for connection in connections:
                    connection.unsay()
                self.world.stop_recording(error)
                for connection in connections:
                    connection.hang_up(error)

    async def close(self) -> None:
        """Stops the world where it is, tells subscribers that it is closed, and completes the recording."""
        if self._closing:
            return
        self._closing = True
        if self._away:
            await self._returned.wait()
        for timer in (self._clock, self._alarm):
            if timer is not None:
                timer.cancel()
        if self.world.fault is not self._fault_logged:
            self._log_fault()
        self.world.close()
        self._hand_over()
        if self._recorder is not None:
            try:
                self._recorder.close()
            except RecordingError as error:
                logger.error("the recording %s could not be completed: %s", self.recording, error.message)
            self._recorder = None


class _Rendezvous:
    """Who controls a world with a barrier, who of them has said `step`, and for how many ticks."""

    def __init__(self) -> None:
        self.waiting: dict[int, int] = {}  # clients, and the ticks that they still wait for
        self._controlling: set[int] = set()
        self._released: set[int] = set()  # had their ticks, and their `step` is executed next
        self._barrier: Barrier | None = None
        self._begun = False

    def arrive(self, barrier: Barrier, client: int, ticks: int) -> bool:
        """Takes note of a `step`; returns whether it has to wait."""
        if client in self._released:
            self._released.discard(client)
            return False
        self._begin(barrier)
        self._controlling.add(client)
        self.waiting.setdefault(client, ticks)
        return True

    def _begin(self, barrier: Barrier) -> None:
        """Counts anew where the barrier is a new one; those that wait already take part in it."""
        if barrier is not self._barrier:
            self._barrier, self._begun = barrier, False
            self._controlling = set(self.waiting)

    def complete(self, barrier: Barrier | None) -> bool:
        """Whether all have said `step`."""
        if barrier is None or not self.waiting:
            return False
        self._begin(barrier)
        enough = self._begun or len(self._controlling) >= barrier.agents
        return enough and self._controlling <= self.waiting.keys()

    def ticked(self, count: int) -> list[int]:
        """Counts ticks, no more than anybody waits for; returns those that have now had all that they said."""
        self._begun = self._begun or count > 0
        done = [client for client, ticks in self.waiting.items() if ticks == count]
        self.waiting = {client: ticks - count for client, ticks in self.waiting.items() if ticks > count}
        self._released.update(done)
        return done

    def is_late(self, client: int) -> bool:
        """Whether others wait for this one."""
        return client in self._controlling and client not in self.waiting

    def give_up(self) -> None:
        """Waits no longer for those that are late, nor for more to come."""
        self._controlling &= self.waiting.keys()
        self._begun = True

    def forget(self, client: int) -> None:
        """Waits no longer for a connection that leaves."""
        self._controlling.discard(client)
        self._released.discard(client)
        self.waiting.pop(client, None)


def _new_recording_path(directory: Path, world: str) -> Path:
    """Returns a path that names the world and the time, and that does not exist."""
    name = re.sub(r"[^\w.-]", "_", world)
    stem = f"{name}-{datetime.now(UTC):%Y%m%dT%H%M%SZ}"
    path, count = directory / f"{stem}.mcap", 1
    while path.exists():
        count += 1
        path = directory / f"{stem}-{count}.mcap"
    return path
