"""One world being served: the only door to the world, for the connections of its clients and for its host.

A connection submits the requests of its client one by one. Each is answered at once, or has to wait; then `resume` of
the connection is called when it may be submitted again. The world knows no sockets, only `Peer`s.

A world in which nobody is and nothing moves may hibernate: it is saved, its engine and its recording's file are let go,
and it takes neither time nor much memory until somebody joins, which wakes it (`Hibernation`).

The rest is done by parts: the `Clock` ticks in `realtime` and `fast`, the `StepBarrier` lets agents wait for each
other, the `Worker` takes long work to a thread, the `WorldRecorder` flushes, and `Peers` send events. After a tick, and
after a request that left events, agents that wait or a fault behind, `_settle` sees to all of them.

Invariants:

- A world is touched by one thread at a time, in one order: requests are executed as they are submitted, ticks come
  between. While it is in a thread, requests wait in the order in which they came.
- With a flush interval of 0, nothing reaches a socket before it is on disk. The loop does not wait for it, the world
  does: it ticks on when its last output is there.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple

from nmes.errors import NmesError, RecordingError
from nmes.playback import restore_into
from nmes.protocol import Request
from nmes.server.barrier import StepBarrier
from nmes.server.clock import Clock, Lag
from nmes.server.hibernation import Hibernation
from nmes.server.metrics import Metrics, Spent, WorldFigures
from nmes.server.outbox import Outbox
from nmes.server.peers import Peer, Peers
from nmes.server.threads import LONG_COMMANDS, Tell, Worker, WorkerPool
from nmes.server.turns import Turns
from nmes.server.world_recorder import Origin, WorldRecorder
from nmes.world import Fault, World

__all__ = ["HostedWorld", "Status"]

logger = logging.getLogger(__name__)

LAG_LOGGED = 60.0  # s: the log tells of a world that lags once in so long
PATIENCE = 2.0  # s: how long a host that closes waits for the tick that a world is at

# The commands that may start, stop or re-pace the clock.
_STEERING = frozenset({"set_mode", "pause", "resume", "reset", "batch"})


class Status(NamedTuple):
    """How a world is doing."""

    mode: str
    frame: int
    fault: Fault | None
    lag: Lag | None


class HostedWorld:
    """One world being served, and those who are in it.

    All methods are called in the event loop's thread, except those that say so.
    """

    _loop: asyncio.AbstractEventLoop  # that events come to from a thread

    def __init__(
        self,
        config: Mapping[str, Any],
        pool: WorkerPool,
        record_to: Path | None = None,
        flush_interval: float = 1.0,
        metrics: Metrics | None = None,
        origin: Origin | None = None,
        maker: str | None = None,
    ) -> None:
        """Creates the world and begins its recording, a new file in the directory `record_to`, if one is given.

        The world is a new one, or goes on from its origin, a frame of a recording, whose config is `config` then. Its
        maker is who created it over the wire, if anybody did.
        """
        self._spent = Spent()
        self.world = World(config) if metrics is None else metrics.world(config, self._spent)
        self.name: str = self.world.config["name"]
        self._recorder = _begin(self.world, record_to, flush_interval, origin, maker)
        self.durable = self._recorder is not None and flush_interval == 0  # whether output waits for the disk
        self._peers = Peers()
        self.turns = Turns(lambda: self._worker.away or self._closing)  # of its connections
        self.world.emit = self._peers.send
        self._settling: asyncio.Handle | None = None  # where `_settle` is to be called
        self._uncommitted: dict[Outbox, None] = {}  # output that is to be on disk first
        self._committing: asyncio.Task[None] | None = None  # that sees to it
        self._closing = False
        self.abandoned = False  # closed while it is in a thread still, in the middle of a tick
        self.lost: str | None = None  # why its recording is not whole, once it is closed
        self._fault: Fault | None = None  # the one that was logged
        self._lag_logged = -LAG_LOGGED  # when the log last told that the world lags
        self._clock = Clock(self.world, self._turn, self._tell_lag, None if metrics is None else metrics.lose)
        self._worker = Worker(self.world, pool, self)
        self._barrier = StepBarrier(
            self.world, self._worker.advance, self._peers.resume, self._settle_soon, self._pass_over_late
        )
        self.hibernation = Hibernation(
            self.world,
            self._worker,
            self._recorder,
            lambda: not self._peers and not self._closing and self._committing is None,
        )
        # For while the world is in a thread:
        self._status = self.status  # before it went
        self._events: list[tuple[int, bytes]] = []  # of clients
        self._waiting: dict[Peer, None] = {}  # those that are to `resume` when it is back
        self._leavers: list[int] = []  # clients that are to leave then
        self._results: dict[int, Future[bytes]] = {}  # replies to requests that were executed there
        self._loss: RecordingError | None = None  # why its recording ended
        self.onlookers: dict[Callable[[], None], None] = {}  # called when the world is back from a thread

    def __repr__(self) -> str:
        return f"HostedWorld({self.name!r}, frame {self.status.frame}, {len(self._peers)} clients)"

    @property
    def recording(self) -> Path | None:
        """The world's recording; None: it is not recorded."""
        return None if self._recorder is None else self._recorder.path

    @property
    def readable(self) -> bool:
        """Whether the world may be looked at now: it is not in a thread, and there is an engine."""
        return not (self._worker.away or self._closing or self.world.asleep)

    @property
    def clients(self) -> int:
        """The number of connections that are in this world."""
        return len(self._peers)

    @property
    def status(self) -> Status:
        """How the world is doing; while it is in a thread, how it was when it went."""
        if self._worker.away:
            return self._status
        return Status(self.world.mode, self.world.frame, self.world.fault, self._clock.lag)

    @property
    def figures(self) -> WorldFigures:
        """The metrics of this world, while it is awake."""
        ratio = 1.0 if self._clock.lag is None else self._clock.lag.ratio
        return WorldFigures(
            self.name,
            self.clients,
            self.status.fault is not None,
            None if self._recorder is None else self._recorder.lag,
            ratio,
            self._clock.lost,
            self._spent.ticks,
            self._spent.seconds,
        )

    # -- requests --------------------------------------------------------------------------------------------------

    def join(
        self, connection: Peer, role: str | None = None, player: int | None = None
    ) -> tuple[int, dict[str, Any]] | None:
        """Lets a connection in, in a role and as a player as `World.join` says.

        Returns:
            Its client number and its `auth_success`; or None if it has to wait: its `resume` is called when it may try
            again.
        """
        if self.hibernation.failure is not None:
            raise self.hibernation.failure
        if self._worker.away or self._closing:
            self._waiting[connection] = None
            return None
        if self.world.asleep:
            self._waiting[connection] = None
            if not self.hibernation.wake():
                self._end_waiting()
            return None
        client = self.world.join(role, player)
        self._peers[client] = connection
        self._settle_soon()
        return client, self.world.welcome(client)

    def leave(self, client: int) -> None:
        """Lets a client go; its cubes stay."""
        connection = self._peers.pop(client)
        self._barrier.forget(client)
        self._results.pop(client, None)
        self._waiting.pop(connection, None)
        self.turns.forget_reader(connection)
        if self._worker.away:
            self._leavers.append(client)
        elif not self._closing:
            self.world.leave(client)
            self._settle_soon()
        self.hibernation.put_off()

    def submit(self, client: int, request: Request, tell: Tell) -> bytes | None:
        """Executes a client's request.

        Args:
            client: Whose it is.
            request: What is asked.
            tell: Makes what is sent of the request and the encoded reply to it; called where the request is executed.

        Returns:
            What `tell` returned; or None if the request has to wait: the connection's `resume` is
            called when it may be submitted again, before any other request of that client. It waits while the world is
            in a thread, also for its own sake; and where there is a barrier, a `step` waits for those of all others who
            control the world.
        """
        if self._worker.away or self._closing:
            self._waiting[self._peers[client]] = None
            return None
        if request.type in LONG_COMMANDS:
            reply = self._submit_long(client, request, tell)
            if reply is None:
                return None
        else:
            reply = tell(request, self.world.handle(client, request))
        if request.type in _STEERING:
            self._clock.adjust()  # at once: its next turn may come before all else
        if self._peers.unsent or self._barrier.waiting or self.world.fault is not self._fault:
            self._settle_soon()
        return reply

    def _submit_long(self, client: int, request: Request, tell: Tell) -> bytes | None:
        """Executes a request that may take long; returns None if it has to wait."""
        command, world = request.command, self.world
        if (result := self._results.pop(client, None)) is not None:
            return result.result()
        if command is None or world.fault is not None:
            return tell(request, world.handle(client, request))
        if world.barrier is not None and request.type == "step" and world.may(client, "step"):
            waits = self._barrier.arrive(client, command.get("ticks", 1))
            return None if waits else tell(request, world.handle(client, request))
        worker = self._worker
        if worker.takes_long(command):
            execute = partial(worker.execute, client, request, tell)
            if worker.run(execute, partial(self._executed, client)):
                return None
        return worker.execute(client, request, tell)

    def _executed(self, client: int, reply: Future[bytes]) -> None:
        """Keeps a reply from a thread until the client submits its request again."""
        if client in self._peers:
            self._results[client] = reply
            self._peers.resume(client)
        else:
            reply.result()  # nobody hears it, but a mistake of ours must be logged

    # -- after a request, a tick or a client's end -----------------------------------------------------------------

    def start(self) -> None:
        """Starts the clock, where the world ticks by itself."""
        self._clock.adjust()

    def _settle_soon(self) -> None:
        """Has `_settle` called when what happens now is over."""
        if self._settling is None:
            self._settling = asyncio.get_running_loop().call_soon(self._settle)

    def _settle(self) -> None:
        """Sees to all that may follow from what has happened to the world."""
        if self._settling is not None:
            self._settling.cancel()
            self._settling = None
        if not self._worker.away and not self._closing:
            self._barrier.update()
        self._peers.flush()
        if not self._worker.away and not self._closing:
            self._fault = _log_fault(self.world, self._fault)
            self._clock.adjust()

    def _turn(self) -> None:
        """Ticks as often as the clock says, for one slice."""
        if self._closing:
            return
        if self._worker.away or self._committing is not None:
            self._clock.put_off()
            return
        if self.world.asleep:
            return
        due = self._clock.due()
        self._worker.advance(due, partial(self._clock.ticked, due))
        self._settle()

    def _tell_lag(self, lag: Lag, over: bool) -> None:
        """Tells subscribers, and now and then the log, that the world falls behind the clock, or does no longer."""
        ratio, behind = round(lag.ratio, 3), round(lag.behind, 3)
        event = {"type": "lagging", "frame": self.world.frame, "ratio": ratio, "behind": behind, "over": over}
        self.world.announce(event)
        self._settle_soon()
        if not over and (now := monotonic()) >= self._lag_logged + LAG_LOGGED:
            self._lag_logged = now
            logger.warning(
                "world %r falls behind: it runs at %.2f of its pace, and is %.1f s behind", self.name, ratio, behind
            )

    async def announce(self, event: Mapping[str, Any]) -> None:
        """Sends subscribers an event of the host, once the world is in no thread."""
        while self._worker.away:
            await self._worker.wait()
        if not self._closing and not self.world.asleep:
            self.world.announce(event)
            self._settle_soon()

    def _pass_over_late(self) -> None:
        """Ticks without those who are late at the barrier."""
        if self._worker.away:
            return  # the time is taken anew when the world is back
        late = self._barrier.give_up()
        logger.warning("world %r goes on at frame %d without clients %s", self.name, self.world.frame, late)
        self.world.announce({"type": "barrier_timeout", "frame": self.world.frame, "clients": late})
        self._settle()

    # -- in a thread -----------------------------------------------------------------------------------------------

    def prepare_thread(self) -> bool:
        """Prepares for the world to go to a thread; returns whether it may."""
        if self.world.fault is not None:
            return False
        self._status = self.status
        self._loop = asyncio.get_running_loop()
        self.world.emit = lambda client, event: self._events.append((client, event))
        return True

    def end_slice(self) -> None:
        """Sends events; called in the world's thread."""
        if self._events:
            if self._recorder is not None:
                with contextlib.suppress(RecordingError):  # which the loop meets too, and tells
                    self._recorder.commit()  # here as well: a world does not run away from its disk
            events, self._events = self._events, []
            self._loop.call_soon_threadsafe(self._peers.deliver, events)

    def take_back(self, finish: Callable[[], None]) -> None:
        """Goes on with a world that is back from a thread: first those who waited, then it itself."""
        self.world.emit = self._peers.send
        events, self._events = self._events, []
        if self._closing:
            self._peers.deliver(events)
            return
        self._end_waiting()
        self._peers.deliver(events)
        for look in list(self.onlookers):
            look()
        if self._loss is not None:
            self.world.stop_recording(self._loss)
        self._clock.take_put_off()
        try:
            finish()
        finally:
            self._settle()

    def _end_waiting(self) -> None:
        """Resumes the connections that waited, and lets those clients go that left meanwhile."""
        waiting, self._waiting = self._waiting, {}
        for connection in waiting:
            self.turns.wait(connection)
        self.turns.read_on()
        leavers, self._leavers = self._leavers, []
        for client in leavers:
            self.world.leave(client)

    # -- the recording ---------------------------------------------------------------------------------------------

    async def flush(self) -> None:
        """Hands the recording to the system, as far as the world has gone; a failure to do so stops the world.

        It is done in a thread, and the world need not wait for it, nor it for the world, however long a tick takes.
        """
        if self._recorder is not None and not self._recorder.settle():
            try:
                await asyncio.to_thread(self._recorder.flush)
            except RecordingError as error:
                if not self._worker.away and not self._closing:  # else it meets the error at its next record
                    self.world.stop_recording(error)
                    self._settle_soon()

    def commit(self, output: Outbox) -> None:
        """Has `committed` of some output called when all that was recorded so far is on disk.

        It is waited for in a thread, once for all that one turn of the loop brings, and the world does not tick
        meanwhile. Where it fails, nobody may hear of what is lost: all output is dropped, the world stops, and its
        clients are hung up on.
        """
        self._uncommitted[output] = None
        if self._committing is None:
            self._committing = asyncio.get_running_loop().create_task(self._commit())

    async def _commit(self) -> None:
        while self._uncommitted:
            outputs, self._uncommitted = self._uncommitted, {}
            if self.durable:
                try:
                    await self._sync()
                except RecordingError as error:
                    self._lose(error, outputs)
            for output in outputs:
                output.committed()
        self._committing = None
        if not self._worker.away and not self._closing:
            self._clock.take_put_off()

    async def _sync(self) -> None:
        """Returns when all that was recorded so far is on disk."""
        assert self._recorder is not None
        if self._worker.away:
            await asyncio.to_thread(self._recorder.commit)
        else:  # a command is flushed as a whole, with its ticks and its reply
            self._recorder.flush()
            await asyncio.to_thread(self._recorder.sync)

    def _lose(self, error: RecordingError, outputs: Iterable[Outbox]) -> None:
        """Drops all output, stops the world, and hangs up on its clients: what is recorded may not be on disk."""
        for output in outputs:
            output.discard()
        self._peers.discard_output()
        self.durable = False  # what follows tells of nothing but the error
        self._loss = error
        if not self._worker.away:
            self.world.stop_recording(error)
        self._peers.hang_up(error)
        if not self._closing:
            self._settle_soon()

    # -- the end ---------------------------------------------------------------------------------------------------

    async def close(self, farewell: NmesError | None = None) -> None:
        """Stops the world where it is, tells subscribers that it is closed, and completes the recording.

        A world whose tick takes longer than `PATIENCE` is left where it is: its recording ends before that tick.

        Args:
            farewell: What all clients are told, and hung up on, where the world goes on from its recording in another
                process: it is saved then as if it were to hibernate. A command that is being executed may be over,
                but is not answered.
        """
        if self._closing:
            return
        self._closing = True
        if farewell is not None and self._worker.away:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(PATIENCE):
                    await self._worker.wait()
        self.abandoned = not await self._worker.stop(PATIENCE)
        self._clock.stop()
        self._barrier.stop()
        self._fault = _log_fault(self.world, self._fault)
        if farewell is not None:
            self._peers.hang_up(farewell)
        if self.abandoned:
            logger.warning("world %r is left in the middle of a tick, before which its recording ends", self.name)
            self.world.emit = self._peers.send
            self.world.announce({"type": "world_closed"})
        elif farewell is None or not await asyncio.to_thread(_save, self.world):
            self.world.close()
        if self._committing is not None:
            await self._committing
        if self.world.fault is not None and self.world.fault.code == "recording_failed":
            self.lost = self.world.fault.message
        if self._recorder is not None:
            try:
                self._recorder.close()
            except RecordingError as error:
                self.lost = error.message
                logger.error("the recording %s could not be completed: %s", self.recording, error.message)
                if self.durable:
                    self._lose(error, ())
        self.durable = False
        self._peers.flush()

    def hang_up(self) -> None:
        """Hangs up on all clients, once the world is closed."""
        self._peers.hang_up()


def _save(world: World) -> bool:
    """Saves a world that goes on elsewhere as if it were to hibernate; returns whether its engine is let go."""
    if not world.asleep:
        for client in world.clients():
            world.leave(client)
        if world.fault is None and "snapshot" in world.backend.capabilities:
            world.hibernate()
    return world.asleep


def _begin(
    world: World, record_to: Path | None, flush_interval: float, origin: Origin | None, maker: str | None
) -> WorldRecorder | None:
    """Brings a new world to where it begins; returns the recorder of what follows, if it is to be recorded."""
    recorder = None
    if record_to is not None:
        recorder = WorldRecorder(world, record_to, flush_interval, origin, maker)
    elif origin is not None:
        restore_into(world, origin.recording, origin.frame)
    for client in world.clients():  # their connections are gone
        world.leave(client)
    return recorder


def _log_fault(world: World, before: Fault | None) -> Fault | None:
    """Logs a fault that is new for whoever runs the host, and returns it; the world's clients have an event of it."""
    if world.fault is not None and world.fault is not before:
        name, fault = world.config["name"], world.fault
        logger.error("world %r stopped at frame %d: %s: %s", name, fault.frame, fault.code, fault.message)
    return world.fault
