"""Serving worlds over TCP: the sequencer that orders what sockets bring, and the clock that makes worlds tick.

It hides sockets, time-outs, back-pressure and the pace of `realtime` and `fast`. A `Host` listens and keeps the
connections' limits; each `HostedWorld` holds one world with its recorder, clients and clock, and is the only door to
that world; a `Connection` moves bytes between one socket and one hosted world.

Invariants:

- A world is touched by one thread, in one order: what a socket brings is executed as it arrives, ticks come between.
- All replies to what one read brought leave in one write, in the order of the requests; events keep their place.
- Nobody waits for long: commands and ticks run in slices of `SLICE` s, then others have their turn.
- What a peer does not read is bounded: over half the limit its commands wait, over the limit it is cut.
- The password is kept only as a digest.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import logging
import math
import re
import ssl
from collections import deque
from collections.abc import Mapping
from datetime import UTC, datetime
from hashlib import blake2b
from pathlib import Path
from time import monotonic
from types import TracebackType
from typing import Any, Self, cast

from nmes.errors import NmesError, RecordingError, RejectedMessage, WorldError
from nmes.metrics import CONTENT_TYPE, Figures, Metrics, WorldFigures
from nmes.protocol import DELIMITER, Auth, Limits, Request, Session, complete_config, encode, error_reply
from nmes.recording import Recorder
from nmes.world import Barrier, World

__all__ = ["Host", "HostedWorld"]

logger = logging.getLogger(__name__)

SLICE = 0.005  # s: how long one connection's commands or one world's ticks may keep the others waiting
CATCH_UP = 0.25  # s: a realtime world that fell further behind than this lets the rest go
LINGER = 2.0  # s: how long a connection that we end may take to read our last words and hang up
SPARE = 64  # connections over the limit that are told so; any more are dropped without a word
READ = 256 << 10  # bytes that are read at once; fresh memory for each read would cost more than all of asyncio
CHUNK = 256 << 10  # bytes of replies that are handed to the socket before the rest of a read is executed


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
        self._connections: dict[int, Connection] = {}
        self._speaking: list[Connection] = []  # those with output that is not yet handed to their sockets
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

    def join(self, connection: Connection) -> int:
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

    def holds(self, connection: Connection, request: Request) -> bool:
        """Whether a request has to wait: a `step`, until all others who control the world have said it too.

        `Connection.go_on` is called when it need not wait any more.
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

    def speak(self, connection: Connection) -> None:
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
        self.waiting: dict[Connection, int] = {}
        self._controlling: set[Connection] = set()
        self._released: set[Connection] = set()  # had their ticks, and their `step` is executed next
        self._barrier: Barrier | None = None
        self._begun = False

    def arrive(self, barrier: Barrier, connection: Connection, ticks: int) -> bool:
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

    def ticked(self) -> list[Connection]:
        """Counts a tick; returns those that have now had all that they said."""
        self._begun = True
        done = [connection for connection, ticks in self.waiting.items() if ticks == 1]
        self.waiting = {connection: ticks - 1 for connection, ticks in self.waiting.items() if ticks > 1}
        self._released.update(done)
        return done

    def is_late(self, connection: Connection) -> bool:
        """Whether others wait for this one."""
        return connection in self._controlling and connection not in self.waiting

    def give_up(self) -> None:
        """Waits no longer for those that are late, nor for more to come."""
        self._controlling &= self.waiting.keys()
        self._begun = True

    def forget(self, connection: Connection) -> None:
        """Waits no longer for a connection that leaves."""
        self._controlling.discard(connection)
        self._released.discard(connection)
        self.waiting.pop(connection, None)


class Connection(asyncio.BufferedProtocol):
    """One socket: its authentication, its requests, its output, and when it has to go."""

    _transport: asyncio.Transport

    def __init__(self, host: Host, default_world: str | None) -> None:
        """Serves `default_world` to a client that names none."""
        self._host = host
        self._limits = host.limits
        self._default_world = default_world
        self._session = Session(host.limits)
        self._world: HostedWorld | None = None  # the world joined
        self._client = 0
        self._timer: asyncio.TimerHandle | None = None  # the deadline that applies: auth, its answer, hanging up
        self._backlog: deque[Request] = deque()  # what is yet to be executed; reading pauses meanwhile
        self._full = False  # the peer does not read: its commands wait
        self._overflowed = False  # it did not read for so long that events were dropped: it must go
        self._ended = False  # the peer has said its last word
        self._closing = False  # we have said ours
        self._lost = False
        self._output: list[bytes] = []
        self._output_size = 0
        self._written = 0
        self._taken = 0  # how much of that the peer had taken at the last look, and when it last took some
        self._taken_at = 0.0
        self._active_at = 0.0

    # -- what the event loop calls ---------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Waits for authentication; or says that the host is full."""
        loop = asyncio.get_running_loop()
        self._transport = cast(asyncio.Transport, transport)
        self._transport.set_write_buffer_limits(high=self._limits.pending // 2)
        self._active_at = self._taken_at = loop.time()
        over = self._host.admit(self) - self._limits.connections
        if over <= 0:
            self._timer = loop.call_later(self._limits.auth_timeout, self._auth_timed_out)
        elif over <= SPARE:
            most = self._limits.connections
            self._end(RejectedMessage("too_many_connections", f"this host serves {most} connections at once"))
        else:
            self._closing = True
            self._transport.abort()

    def get_buffer(self, sizehint: int) -> memoryview:
        """Lends the host's one buffer: it is read into and emptied without anything else happening in between."""
        return self._host.buffer

    def buffer_updated(self, nbytes: int) -> None:
        """Executes what came, and answers it in one write."""
        self._host.received += nbytes
        if self._closing:
            return
        try:
            messages = self._session.receive(bytes(self._host.buffer[:nbytes]))
            if self._world is None:
                messages = self._authenticate(messages)
            if messages:
                self._active_at = asyncio.get_running_loop().time()
                self._backlog.extend(cast(list[Request], messages))
            self._work()
        except Exception:
            # A mistake of ours must neither reach the peer as a traceback nor hurt anybody else.
            logger.exception("a connection failed")
            self._end(NmesError("internal", "the server failed; see its log"))

    def eof_received(self) -> bool:
        """Hangs up: everything is answered, for while something waits nothing is read."""
        self._ended = True
        self._end(None)
        return False

    def connection_lost(self, error: Exception | None) -> None:
        """Leaves the world, when the rest of what the peer had asked for is done."""
        self._lost = self._closing = True
        self._full = False
        self._cancel_timer()
        self._host.forget(self)
        self._work()

    def pause_writing(self) -> None:
        """Lets this peer's commands wait until it reads."""
        self._full = True

    def resume_writing(self) -> None:
        """Goes on with the commands that waited."""
        self._full = False
        if self._backlog:
            asyncio.get_running_loop().call_soon(self._work)

    # -- authentication --------------------------------------------------------------------------------------------

    def _authenticate(self, messages: list[Auth | Request]) -> list[Auth | Request]:
        """Deals with the first frame, if it has come; returns the requests that came after it."""
        if not messages:
            if self._session.violation is not None:
                self._end(self._session.violation)
            return []
        self._cancel_timer()
        auth = cast(Auth, messages[0])
        if auth.error is not None:
            self._refuse(auth.error)
        elif not self._host.accepts(auth.password):
            self._refuse(RejectedMessage("auth_failed", "that is not the password"))
        elif auth.list:
            self._output.append(self._session.accept(self._host.list_worlds(self._port)))
            self._end(None)
        else:
            try:
                self._world = self._host.find(auth.world or self._default_world)
            except WorldError as error:
                self._end(error)
                return []
            self._client = self._world.join(self)
            self._put(self._session.accept(self._world.world.welcome(self._client)))
            return self._session.receive(b"")
        return []

    def _refuse(self, error: NmesError) -> None:
        """Says no after a while, so that guessing passwords is slow; what comes meanwhile is not even read."""
        logger.warning("%s failed to authenticate: %s", self._peer, error.code)
        self._transport.pause_reading()
        self._timer = asyncio.get_running_loop().call_later(self._host.auth_delay, self._end, error)

    def _auth_timed_out(self) -> None:
        self._end(RejectedMessage("auth_timeout", f"no authentication within {self._limits.auth_timeout:g} s"))

    # -- commands --------------------------------------------------------------------------------------------------

    def go_on(self) -> None:
        """Goes on with what had to wait for others."""
        if self._backlog:
            self._work()

    def _work(self) -> None:
        """Executes what is in the backlog for one slice."""
        world, session, backlog = self._world, self._session, self._backlog
        if world is None:
            return
        clock = asyncio.get_running_loop().time
        until = clock() + SLICE
        held = False
        while backlog and not self._full:
            held = world.holds(self, backlog[0])
            if held:
                break
            request = backlog.popleft()
            reply = session.reply(request, world.handle(self._client, request))
            if reply:
                self._put(reply)
                if self._output_size > CHUNK:
                    self.flush()
            if clock() >= until:
                break
        world.settle()
        if backlog:
            self._transport.pause_reading()
            if not self._full and not held:
                asyncio.get_running_loop().call_soon(self._work)
        elif self._lost:
            self._leave()
        elif session.violation is not None:
            # It goes through the world, so that the recording tells of it; of the frame itself nothing is kept.
            self._put(world.handle(self._client, Request(b"", None, session.violation)) + DELIMITER)
            self._end(None)
        else:
            self._transport.resume_reading()

    # -- output ----------------------------------------------------------------------------------------------------

    def send_event(self, event: bytes) -> None:
        """Adds an event to what goes out when the slice ends, unless the peer is too far behind."""
        if self._closing or self._overflowed:
            return
        if self._output_size + self._transport.get_write_buffer_size() > self._limits.pending:
            # The world is in the middle of telling its clients, so this one goes when the slice ends.
            self._overflowed = True
            assert self._world is not None
            self._world.speak(self)
        else:
            self._put(self._session.event(event))

    def unsay(self) -> None:
        """Takes back what was not yet handed to the socket."""
        self._output.clear()
        self._output_size = 0

    def _put(self, data: bytes) -> None:
        if not self._output:
            assert self._world is not None
            self._world.speak(self)
        self._output.append(data)
        self._output_size += len(data)

    def flush(self) -> None:
        """Hands what there is to the socket, in one write."""
        if self._output and self._world is not None:
            self._world.commit()
        if self._output:
            data = b"".join(self._output)
            self._output.clear()
            self._output_size = 0
            if not self._lost:
                self._written += len(data)
                self._host.sent += len(data)
                self._active_at = asyncio.get_running_loop().time()
                self._transport.write(data)
        if self._overflowed:
            self._cut()

    def inspect(self, now: float) -> None:
        """Looks after a connection now and then: ends it when nothing moves any more."""
        buffered = self._transport.get_write_buffer_size()
        taken = self._written - buffered
        if taken != self._taken or not (buffered or self._closing):
            self._taken, self._taken_at = taken, now
        if self._closing:
            if now - self._taken_at >= LINGER:
                self._transport.abort()
        elif now - self._taken_at >= self._limits.stall_timeout:
            self._cut()
        elif self._world is not None and now - self._active_at >= self._limits.idle_timeout:
            logger.info("%s was idle for %g s", self._peer, self._limits.idle_timeout)
            self._end(None)

    def _cut(self) -> None:
        logger.warning("%s does not read what it is sent and is cut off", self._peer)
        self._end(RejectedMessage("slow_consumer", "you do not read what you are sent"))

    # -- the end ---------------------------------------------------------------------------------------------------

    def hang_up(self, error: NmesError | None = None) -> None:
        """Ends the connection from our side, and says why."""
        self._end(error)

    @property
    def draining(self) -> bool:
        """Whether there is output that the peer has not yet taken."""
        return self._transport.get_write_buffer_size() > 0

    def abort(self) -> None:
        """Ends the connection at once."""
        self._transport.abort()

    def _end(self, error: NmesError | None) -> None:
        """Says the last word and leaves the world; the socket is closed when the peer has hung up too, or soon."""
        if self._closing:
            return
        self._closing = True
        self._overflowed = False
        self._backlog.clear()
        self._cancel_timer()
        if error is not None:
            self._output.append(self._session.refuse(error))
        self.flush()
        self._leave()
        loop = asyncio.get_running_loop()
        self._taken_at = loop.time()
        self._timer = loop.call_later(self._limits.idle_timeout, self._transport.abort)
        if self._ended or not self._transport.can_write_eof():
            self._transport.close()
        else:
            # Closing a socket while the peer still sends resets it, and may take our last word away from the peer. So
            # this side is closed only, and what still comes is read and thrown away.
            with contextlib.suppress(OSError):  # the peer is gone already
                self._transport.write_eof()
            self._transport.resume_reading()

    def _leave(self) -> None:
        world, self._world = self._world, None
        if world is not None:
            world.leave(self._client)
            world.settle()

    def _cancel_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    @property
    def _port(self) -> int:
        """The port that the peer came to."""
        return int(self._transport.get_extra_info("sockname")[1])

    @property
    def _peer(self) -> str:
        address = self._transport.get_extra_info("peername")
        return f"{address[0]}:{address[1]}" if address else "a client"


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
        self.worlds: dict[str, HostedWorld] = {}  # those that there are
        self._offered: dict[str, dict[str, Any]] = {}  # the configs of all that there may be
        self._ports: dict[str, int] = {}  # where a client that names no world gets which
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
        self._tellers: list[asyncio.Server] = []  # of metrics
        self._connections: set[Connection] = set()
        self._chores: list[asyncio.Task[None]] = []

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
        name = self.offer(config)
        try:
            return self._create(name)
        except NmesError:
            del self._offered[name]
            raise

    def offer(self, config: Mapping[str, Any]) -> str:
        """Hosts a world that is created, and its recording begun, when it is first used; returns its name.

        Raises:
            RejectedMessage: The config does not have the shape of one. What its engine thinks of it comes out later.
            WorldError: There is a world of that name (`world_exists`).
        """
        complete = complete_config(config)
        name: str = complete["name"]
        if name in self._offered:
            raise WorldError("world_exists", f"two worlds are called {name!r}", "name")
        self._offered[name] = complete
        return name

    def _create(self, name: str) -> HostedWorld:
        hosted = self.worlds[name] = HostedWorld(
            self._offered[name], self.record_to, self._flush_interval, self._metrics
        )
        if self._servers:
            hosted.start()
        return hosted

    def find(self, name: str | None) -> HostedWorld:
        """Returns the world of that name, which may be created only now; the first where no name is given.

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
        """Returns the `world_list` message for a client that asks on a port. Creates none of the worlds."""
        listed = []
        for name, config in self._offered.items():
            hosted = self.worlds.get(name)
            world = hosted.world if hosted is not None else None
            listed.append(
                {
                    "world": name,
                    "port": self._ports.get(name, port),
                    "backend": config["backend"],
                    "mode": world.mode if world is not None else config["mode"],
                    "frame": world.frame if world is not None else None,
                    "clients": hosted.clients if hosted is not None else 0,
                    "fault": world.fault.code if world is not None and world.fault is not None else None,
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
        """How many connections there are, those that are ending included."""
        return len(self._connections)

    def admit(self, connection: Connection) -> int:
        """Counts a connection in; returns how many there are."""
        self._connections.add(connection)
        return len(self._connections)

    def forget(self, connection: Connection) -> None:
        """Counts a connection out."""
        self._connections.discard(connection)

    async def listen(self, host: str, port: int, world: str | None = None) -> tuple[str, int]:
        """Serves on an address; returns it, with the port that was found where `port` is 0.

        `world` is for the clients of this port that name none. The worlds' clocks start with the first port.

        Raises:
            NmesError: `cannot_listen`: the address is taken, or not of this machine.
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
            raise NmesError("cannot_listen", f"cannot listen on {host}:{port}: {reason}") from error
        if not self._servers:
            self._chores = [loop.create_task(self._inspect()), loop.create_task(self._flush())]
            for hosted in self.worlds.values():
                hosted.start()
        self._servers.append(server)
        address = server.sockets[0].getsockname()
        default = world or next(iter(self._offered), None)
        if default is not None:
            self._ports.setdefault(default, address[1])
        return address[0], address[1]

    async def tell_metrics(self, host: str, port: int) -> int:
        """Serves the page of metrics over HTTP, without a password; returns the port.

        Raises:
            NmesError: `cannot_listen`, as `listen`.
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
            raise NmesError("cannot_listen", f"cannot listen on {host}:{port}: {error.strerror}") from error
        self._tellers.append(server)
        return int(server.sockets[0].getsockname()[1])

    async def _inspect(self) -> None:
        interval = min(1.0, self.limits.stall_timeout / 4, self.limits.idle_timeout / 4)
        while True:
            await asyncio.sleep(interval)
            now = asyncio.get_running_loop().time()
            for connection in list(self._connections):
                connection.inspect(now)

    async def _flush(self) -> None:
        # Twice as often as is promised: a slice or a long step may come between.
        interval = (self._flush_interval or 1.0) / 2
        while True:
            await asyncio.sleep(interval)
            for hosted in self.worlds.values():
                hosted.flush()

    async def close(self) -> None:
        """Stops listening, closes the worlds and their recordings, tells the clients, and hangs up."""
        for server in (*self._servers, *self._tellers):
            server.close()
        for chore in self._chores:
            chore.cancel()
        await asyncio.gather(*self._chores, return_exceptions=True)
        self._chores.clear()
        for hosted in self.worlds.values():
            hosted.close()
        for connection in list(self._connections):
            connection.hang_up()
        # Peers get a moment to hang up themselves, and those that still read get some more.
        loop = asyncio.get_running_loop()
        began = loop.time()
        while self._connections and loop.time() - began < LINGER:
            if loop.time() - began > LINGER / 8 and not any(connection.draining for connection in self._connections):
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


def _digest(password: str) -> bytes:
    return blake2b(password.encode("utf-8", "surrogatepass")).digest()


def _new_recording_path(directory: Path, world: str) -> Path:
    """Returns a path that names the world and the time, and that does not exist."""
    name = re.sub(r"[^\w.-]", "_", world)
    stem = f"{name}-{datetime.now(UTC):%Y%m%dT%H%M%SZ}"
    path, count = directory / f"{stem}.mcap", 1
    while path.exists():
        count += 1
        path = directory / f"{stem}-{count}.mcap"
    return path
