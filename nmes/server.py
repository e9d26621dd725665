"""Serving worlds over TCP: the sequencer that orders what sockets bring.

It hides sockets, time-outs and back-pressure. A `Host` listens and keeps the connections' limits and the worlds; a
`Connection` moves bytes between one socket and one hosted world.

Invariants:

- What a socket brings is executed as it arrives; what has to wait, for its world or for others, keeps its place, and
  nothing more is read from that socket meanwhile.
- All replies to what one read brought leave in one write, in the order of the requests; events keep their place.
- Nobody waits for long: commands run in slices of `SLICE` s, then others have their turn.
- What a peer does not read is bounded: over half the limit its commands wait, over the limit it is cut.
- The password is kept only as a digest.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import logging
import ssl
from collections import deque
from collections.abc import Mapping
from hashlib import blake2b
from pathlib import Path
from time import monotonic
from types import TracebackType
from typing import Any, Self, cast

from nmes.errors import NmesError, RejectedMessage, WorldError
from nmes.hosting import SLICE, Crew, HostedWorld
from nmes.metrics import CONTENT_TYPE, Figures, Metrics
from nmes.protocol import Auth, Limits, Request, Session, complete_config
from nmes.recording import Recording

__all__ = ["Host"]

logger = logging.getLogger(__name__)

LINGER = 2.0  # s: how long a connection that we end may take to read our last words and hang up
SPARE = 64  # connections over the limit that are told so; any more are dropped without a word
READ = 256 << 10  # bytes that are read at once; fresh memory for each read would cost more than all of asyncio
CHUNK = 256 << 10  # bytes of replies that are handed to the socket before the rest of a read is executed


class Connection(asyncio.BufferedProtocol):
    """One socket: its authentication, its requests, its output, and when it has to go."""

    _transport: asyncio.Transport

    def __init__(self, host: Host, default_world: str | None) -> None:
        """Serves `default_world` to a client that names none."""
        self._host = host
        self._limits = host.limits
        self._default_world = default_world
        self._session = Session(host.limits)
        self._wanted: HostedWorld | None = None  # the world to join
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
        self._transport = cast(asyncio.Transport, transport)
        self._transport.set_write_buffer_limits(high=self._limits.pending // 2)
        self._active_at = self._taken_at = monotonic()
        over = self._host.admit(self) - self._limits.connections
        if over <= 0:
            loop = asyncio.get_running_loop()
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
                self._authenticate(messages)
            else:
                self._take(messages)
                self._work()
        except Exception:
            self._failed()

    def _failed(self) -> None:
        """A mistake of ours must neither reach the peer as a traceback nor hurt anybody else."""
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

    def _authenticate(self, messages: list[Auth | Request]) -> None:
        """Deals with the first frame, if it has come."""
        if not messages:
            if self._session.violation is not None:
                self._end(self._session.violation)
            return
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
                self._wanted = self._host.find(auth.world or self._default_world)
            except WorldError as error:
                self._end(error)
                return
            self._transport.pause_reading()
            self._join()

    def _join(self) -> None:
        """Joins the world as soon as it can be joined, and executes what came behind the password."""
        world = self._wanted
        if world is not None and world.admits(self):
            self._wanted, self._world = None, world
            self._client, welcome = world.join(self)
            self._put(self._session.accept(welcome))
            self._take(self._session.receive(b""))
            self._work()

    def _refuse(self, error: NmesError) -> None:
        """Says no after a while, so that guessing passwords is slow; what comes meanwhile is not even read."""
        logger.warning("%s failed to authenticate: %s", self._peer, error.code)
        self._transport.pause_reading()
        self._timer = asyncio.get_running_loop().call_later(self._host.auth_delay, self._end, error)

    def _auth_timed_out(self) -> None:
        self._end(RejectedMessage("auth_timeout", f"no authentication within {self._limits.auth_timeout:g} s"))

    # -- commands --------------------------------------------------------------------------------------------------

    def _take(self, messages: list[Auth | Request]) -> None:
        """Queues what came."""
        if messages:
            self._active_at = monotonic()
            self._backlog.extend(cast(list[Request], messages))
        if self._session.violation is not None:
            # It goes through the world, so that the recording tells of it; of the frame itself nothing is kept.
            self._backlog.append(Request(b"", None, self._session.violation))

    def go_on(self) -> None:
        """Goes on with what had to wait for others."""
        try:
            self._join()
            if self._backlog:
                self._work()
        except Exception:
            self._failed()

    def _work(self) -> None:
        """Executes what is in the backlog for one slice."""
        world, session, backlog = self._world, self._session, self._backlog
        if world is None:
            return
        until = monotonic() + SLICE
        held = False
        while backlog and not self._full:
            held = world.holds(self._client, backlog[0])
            if held:
                break
            request = backlog.popleft()
            reply = session.reply(request, world.handle(self._client, request))
            if reply:
                self._put(reply)
                if self._output_size > CHUNK:
                    self.flush()
            if request.error is not None and request.error is session.violation:
                self._end(None)
            if monotonic() >= until:
                break
        world.settle()
        if backlog:
            self._transport.pause_reading()
            if not self._full and not held:
                asyncio.get_running_loop().call_soon(self._work)
        elif self._lost:
            self._leave()
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
                self._active_at = monotonic()
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
        elif self._backlog:
            self._active_at = now  # it waits for us
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
        self._wanted = None
        self._backlog.clear()
        self._cancel_timer()
        if error is not None:
            self._output.append(self._session.refuse(error))
        self.flush()
        self._leave()
        self._taken_at = monotonic()
        self._timer = asyncio.get_running_loop().call_later(self._limits.idle_timeout, self._transport.abort)
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
        self._crew = Crew()
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

    def resume(self, recording: Recording, frame: int | None = None) -> HostedWorld:
        """Hosts the world of a recording, which goes on from a frame of it; those who were in it are gone.

        Args:
            recording: The recording.
            frame: The frame, counted on through resets; None: where it ends.

        Raises:
            RecordingError: There is no such frame, a tick on the way to it does not come out as recorded, or the new
                recording cannot be written.
            BackendNotFound: No such engine.
            WorldError: There is a world of that name (`world_exists`).
        """
        name = self.offer(recording.config)
        try:
            return self._create(name, (recording, frame))
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

    def _create(self, name: str, resume: tuple[Recording, int | None] | None = None) -> HostedWorld:
        hosted = self.worlds[name] = HostedWorld(
            self._offered[name], self._crew, self.record_to, self._flush_interval, self._metrics, resume
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

    async def close(self) -> None:
        """Stops listening, closes the worlds and their recordings, tells the clients, and hangs up."""
        for server in (*self._servers, *self._tellers):
            server.close()
        for chore in self._chores:
            chore.cancel()
        await asyncio.gather(*self._chores, return_exceptions=True)
        self._chores.clear()
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
        self._crew.close()


def _digest(password: str) -> bytes:
    return blake2b(password.encode("utf-8", "surrogatepass")).digest()
