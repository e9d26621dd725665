"""One world being served: the world, its recorder, those who are in it, its clock, and who waits for whom.

It hides the pace of `realtime` and `fast`, the barrier of lockstep, and when a recording is flushed. A `HostedWorld` is
the only door to its world; it knows no sockets, only `Peer`s.

Invariants:

- A world is touched by one thread, in one order: requests are executed as they are handed in, ticks come between.
- Nobody waits for long: ticks run in slices of `SLICE` s, then others have their turn.
- Nothing is told to anybody that a recording which waits for the disk does not hold.
"""

from __future__ import annotations

import asyncio
import logging
import math
import re
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from time import monotonic
from typing import Any, Protocol

from nmes.errors import NmesError, RecordingError, WorldError
from nmes.metrics import Metrics, WorldFigures
from nmes.protocol import Request, encode, error_reply
from nmes.recording import Recorder
from nmes.world import Barrier, World

__all__ = ["SLICE", "HostedWorld", "Peer"]

logger = logging.getLogger(__name__)

SLICE = 0.005  # s: how long one connection's commands or one world's ticks may keep the others waiting
CATCH_UP = 0.25  # s: a realtime world that fell further behind than this lets the rest go


class Peer(Protocol):
    """What a hosted world asks of a connection."""

    def send_event(self, event: bytes) -> None:
        """Sends an event, without delimiter, when the slice ends."""

    def flush(self) -> None:
        """Hands what there is to the socket."""

    def go_on(self) -> None:
        """Executes what had to wait."""

    def unsay(self) -> None:
        """Takes back what is not yet handed to the socket."""

    def hang_up(self, error: NmesError) -> None:
        """Tells the error and closes."""


class HostedWorld:
    """One world being served: the world, its recorder, its connections and its clock."""

    def __init__(
        self,
        config: Mapping[str, Any],
        record_to: Path | None = None,
        flush_interval: float = 1.0,
        metrics: Metrics | None = None,
    ) -> None:
        """Creates the world and begins its recording, a new file in the directory `record_to`, if one is given."""
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
            self._recorder = self.world.journal = Recorder(self.recording, self.world, flush_interval=flush_interval)
        self._flushed = monotonic()
        self._connections: dict[int, Peer] = {}
        self._speaking: list[Peer] = []  # those with output that is not yet handed to their sockets
        self._closed = False
        self._fault_logged: object = None
        self._clock: asyncio.Handle | None = None
        self._pace: tuple[str, float] | None = None  # mode and rate that the clock was set for; None: not ticking
        self._frame = 0  # where the clock left the world
        self._began = 0.0  # the wall's time and the frame from which the pace of `realtime` is reckoned
        self._began_frame = 0
        self._rendezvous = _Rendezvous()
        self._alarm: asyncio.TimerHandle | None = None  # when those that wait for others have waited enough
        self._alarm_frame = 0

    def __repr__(self) -> str:
        return f"HostedWorld({self.name!r}, frame {self.world.frame}, {len(self._connections)} clients)"

    @property
    def clients(self) -> int:
        """How many connections are in this world."""
        return len(self._connections)

    def join(self, connection: Peer) -> int:
        """Lets a connection in; returns its client number."""
        client = self.world.join()
        self._connections[client] = connection
        return client

    def leave(self, client: int) -> None:
        """Lets a client go; its cubes stay."""
        connection = self._connections.pop(client)
        self._rendezvous.forget(connection)
        if not self._closed:
            self.world.leave(client)

    def handle(self, client: int, request: Request) -> bytes:
        """Executes one request; returns the encoded reply. Call `settle` after the last of a row."""
        if self._closed:
            return encode(error_reply(WorldError("internal", "the world is closed"), request.type))
        return self.world.handle(client, request)

    def holds(self, connection: Peer, request: Request) -> bool:
        """Whether a request has to wait: a `step`, until all others who control the world have said it too.

        `Peer.go_on` is called when it need not wait any more.
        """
        world = self.world
        if world.barrier is None or request.type != "step" or request.command is None:
            return False
        if world.fault is not None or self._closed:
            return False
        return self._rendezvous.arrive(world.barrier, connection, request.command.get("ticks", 1))

    def _meet(self) -> None:
        """Ticks while all who control the world have said `step`, and lets those go on that have had their ticks."""
        world, rendezvous = self.world, self._rendezvous
        if not rendezvous.waiting and self._alarm is None:
            return
        loop = asyncio.get_running_loop()
        until = loop.time() + SLICE
        while rendezvous.complete(world.barrier) and world.fault is None and not self._closed:
            world.tick()
            for connection in rendezvous.ticked():
                loop.call_soon(connection.go_on)
            if loop.time() >= until:
                loop.call_soon(self.settle)
                break
        if world.barrier is None or world.fault is not None or self._closed:
            for connection in rendezvous.waiting:
                loop.call_soon(connection.go_on)
            self._rendezvous = _Rendezvous()
        self._set_alarm()

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
        late = [number for number, connection in self._connections.items() if self._rendezvous.is_late(connection)]
        self._rendezvous.give_up()
        logger.warning("world %r goes on at frame %d without clients %s", self.name, self.world.frame, late)
        self.world.announce({"type": "barrier_timeout", "frame": self.world.frame, "clients": late})
        self.settle()

    def _emit(self, client: int, event: bytes) -> None:
        self._connections[client].send_event(event)

    def speak(self, connection: Peer) -> None:
        """Takes note that a connection has something to hand to its socket when the slice ends."""
        self._speaking.append(connection)

    def settle(self) -> None:
        """Ends a slice: hands output to the sockets, and sets the clock by what the commands changed."""
        world = self.world
        self._meet()
        if world.fault is not self._fault_logged:
            # Its clients were told; whoever runs the host must learn of it too.
            self._fault_logged = fault = world.fault
            if fault is not None:
                logger.error("world %r stopped at frame %d: %s: %s", self.name, fault.frame, fault.code, fault.message)
        speaking, self._speaking = self._speaking, []
        for connection in speaking:
            connection.flush()
        if self._clock is not None or world.running:
            self._wind()

    # -- the clock -------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Starts the clock, where the world ticks by itself."""
        self._wind()

    def _wind(self) -> None:
        """Starts, stops or sets the clock anew where mode, rate, pause or frame are not what it was set for."""
        world = self.world
        if not world.running or self._closed:
            if self._clock is not None:
                self._clock.cancel()
                self._clock = self._pace = None
        elif (world.mode, world.rate) != self._pace or world.frame != self._frame:
            if self._clock is not None:
                self._clock.cancel()
            loop = asyncio.get_running_loop()
            self._pace = (world.mode, world.rate)
            self._frame = self._began_frame = world.frame
            self._began = loop.time()
            self._clock = loop.call_soon(self._advance)

    def _advance(self) -> None:
        loop, world = asyncio.get_running_loop(), self.world
        now = loop.time()
        until = now + SLICE
        speed = world.rate * world.config["tick_rate"]  # ticks per second of the wall's clock
        due = math.inf
        if world.mode == "realtime":
            behind = now - self._began - (world.frame - self._began_frame) / speed
            self._began += max(behind - CATCH_UP, 0.0)
            due = math.floor((now - self._began) * speed) - (world.frame - self._began_frame)
        while due > 0 and world.running:
            world.tick()
            due -= 1
            if loop.time() >= until:
                break
        self._frame = world.frame
        if due > 0:
            self._clock = loop.call_soon(self._advance)
        else:
            self._clock = loop.call_at(self._began + (world.frame + 1 - self._began_frame) / speed, self._advance)
        self.settle()

    # -- the recording ---------------------------------------------------------------------------------------------

    def flush(self) -> None:
        """Brings the recording to disk, as far as the world has gone; a failure to do so stops the world."""
        if self._recorder is not None and self.world.journal is not None:
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
        return WorldFigures(self.name, self.clients, self.world.fault is not None, lag)

    def commit(self) -> None:
        """Waits for the disk, if that was asked for: called before anything is told to anybody.

        Where it fails, what is about to be told may be of what is lost: nobody hears it, and the world stops.
        """
        if self._recorder is not None and self.world.journal is not None and not self._closed:
            try:
                self._recorder.commit()
            except RecordingError as error:
                connections = list(self._connections.values())
                for connection in connections:
                    connection.unsay()
                self.world.stop_recording(error)
                for connection in connections:
                    connection.hang_up(error)

    def close(self) -> None:
        """Stops the clock, tells subscribers that the world is closed, and completes the recording."""
        if self._closed:
            return
        self.world.close()
        self._closed = True
        self.settle()
        self._wind()
        if self._recorder is not None:
            try:
                self._recorder.close()
            except RecordingError as error:
                logger.error("the recording %s could not be completed: %s", self.recording, error.message)


class _Rendezvous:
    """Who controls a world with a barrier, who of them has said `step`, and for how many ticks."""

    def __init__(self) -> None:
        self.waiting: dict[Peer, int] = {}
        self._controlling: set[Peer] = set()
        self._released: set[Peer] = set()  # had their ticks, and their `step` is executed next
        self._barrier: Barrier | None = None
        self._begun = False

    def arrive(self, barrier: Barrier, connection: Peer, ticks: int) -> bool:
        """Takes note of a `step`; returns whether it has to wait."""
        if connection in self._released:
            self._released.discard(connection)
            return False
        self._begin(barrier)
        self._controlling.add(connection)
        self.waiting.setdefault(connection, ticks)
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

    def ticked(self) -> list[Peer]:
        """Counts a tick; returns those that have now had all that they said."""
        self._begun = True
        done = [connection for connection, ticks in self.waiting.items() if ticks == 1]
        self.waiting = {connection: ticks - 1 for connection, ticks in self.waiting.items() if ticks > 1}
        self._released.update(done)
        return done

    def is_late(self, connection: Peer) -> bool:
        """Whether others wait for this one."""
        return connection in self._controlling and connection not in self.waiting

    def give_up(self) -> None:
        """Waits no longer for those that are late, nor for more to come."""
        self._controlling &= self.waiting.keys()
        self._begun = True

    def forget(self, connection: Peer) -> None:
        """Waits no longer for a connection that leaves."""
        self._controlling.discard(connection)
        self._released.discard(connection)
        self.waiting.pop(connection, None)


def _new_recording_path(directory: Path, world: str) -> Path:
    """Returns a path that names the world and the time, and that does not exist."""
    name = re.sub(r"[^\w.-]", "_", world)
    stem = f"{name}-{datetime.now(UTC):%Y%m%dT%H%M%SZ}"
    path, count = directory / f"{stem}.mcap", 1
    while path.exists():
        count += 1
        path = directory / f"{stem}-{count}.mcap"
    return path
