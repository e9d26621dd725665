"""One socket of a host: its authentication, its requests, its output, and when it has to go.

Invariants:

- What a socket brings is executed as it arrives; what has to wait, for its world or for others, keeps its place, and
  nothing more is read from that socket meanwhile.
- All replies to what one read brought leave in one write, in the order of the requests; events keep their place.
- Nobody waits for long: commands are read and run in slices of `SLICE` s, which the connections of a world share (see
  `Turns`), then others have their turn; a long frame is read in a thread.
- What has to be on disk is on it before it is handed to the socket: the `Outbox` is the only way out. What this socket
  asks next waits with it.
- What a peer does not read is bounded: over half the limit its commands wait, over the limit it is cut.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from math import ceil
from time import monotonic
from typing import TYPE_CHECKING, Any, cast

from nmes.errors import NmesError, RejectedMessage, WorldError, visible
from nmes.protocol import Auth, Request, Session
from nmes.server.access_log import Visit
from nmes.server.door import address_of
from nmes.server.hosted_world import HostedWorld
from nmes.server.keys import Seat
from nmes.server.outbox import Outbox
from nmes.server.threads import SLICE

if TYPE_CHECKING:
    from nmes.server.reception import Reception

__all__ = ["LINGER", "LONG", "READ", "Connection"]

logger = logging.getLogger(__name__)

LINGER = 2.0  # s: how long a connection that we end may take to read the rest and hang up
READ = 256 << 10  # bytes that are read at once; fresh memory for each read would cost more than all of asyncio
LITTLE = 4 << 10  # bytes that are read where commands have to wait anyway
LONG = 8 << 10  # bytes of a frame that may take a millisecond to read
CHUNK = 256 << 10  # bytes of replies that are handed to the socket before the rest of a read is executed


class Connection(asyncio.BufferedProtocol):
    """One socket: its authentication, its requests, its output, and when it has to go.

    Attributes:
        destination: The world that it waits to join; None: none.
        port: The port that it came to; 0 where it came to none of this process.
    """

    _transport: asyncio.Transport
    _output: Outbox

    def __init__(self, host: Reception, default_world: str | None, peername: tuple[str, int] | None = None) -> None:
        """Serves `default_world` to a client that names none; `peername` is his address, if it is not the socket's."""
        self._host = host
        self._limits = host.limits
        self._default_world = default_world
        self._peername = peername
        self._session = Session(host.limits)
        self._address = ""
        self._peer = "a client"
        self._visit = Visit(host.access_log, self._peer)
        self.destination: str | None = None
        self.port = 0
        self._seat = Seat(None, None)  # as what
        self._world: HostedWorld | None = None  # the world joined
        self._client = 0
        self._timer: asyncio.TimerHandle | None = None  # the deadline that applies: auth, its answer, hanging up
        self._backlog: deque[bytes | Request] = deque()  # yet to be read and executed; the socket waits meanwhile
        self._reading: Future[Request] | None = None  # the first of them, where it is read in a thread
        self._full = False  # the peer does not read: its commands wait
        self._overflowed = False  # it did not read for so long that events were dropped: it must go
        self._ended = False  # the peer sends nothing more
        self._closing = False  # we send nothing more
        self._lost = False
        self._sent = 0  # bytes of output at the last look
        self._progress = 0  # how much of that the peer had read at the last look, and when it last read some
        self._progress_at = 0.0
        self._active_at = 0.0

    # -- what the event loop calls ---------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Waits for authentication."""
        self._transport = cast(asyncio.Transport, transport)
        self._output = Outbox(self._host, self._transport, self.resume)
        self._transport.set_write_buffer_limits(high=self._limits.pending // 2)
        self._active_at = self._progress_at = monotonic()
        own = self._transport.get_extra_info("sockname")
        self.port = int(own[1]) if isinstance(own, tuple) else 0
        if peer := self._peername or self._transport.get_extra_info("peername"):
            self._peer = f"{peer[0]}:{peer[1]}"
        self._address, self._visit = address_of(peer), Visit(self._host.access_log, self._peer)
        loop = asyncio.get_running_loop()
        limit = self._limits.auth_timeout
        late = RejectedMessage("auth_timeout", f"no authentication within {limit:g} s")
        self._timer = loop.call_later(limit, self.hang_up, late)
        self._host.admit(self, self._address)

    def get_buffer(self, sizehint: int) -> memoryview:
        """Lends the host's one buffer: it is read into and emptied without anything else happening in between.

        Where its world's slice is over, only a little of it, since what comes is taken apart even so; but for TLS,
        which drops what is left at the end of the connection.
        """
        if self._world is not None and (end := self._world.turns.end) and monotonic() >= end[0]:
            return self._host.buffer[:LITTLE] if self._transport.can_write_eof() else self._host.buffer
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
                self._work(messages)
        except Exception:
            self._failed()

    def _failed(self) -> None:
        """Ends the connection after a mistake of ours, which must not reach the peer as a traceback nor hurt others."""
        logger.exception("a connection failed")
        self.hang_up(NmesError("internal", "the server failed; see its log"))
        self._leave()  # also where it is ending already

    def eof_received(self) -> bool:
        """Hangs up: everything is answered, or waits for the disk; for while anything else waits nothing is read.

        But over TLS: there the rest is executed once the connection is lost.
        """
        self._ended = True
        self._visit.ends("hung_up")
        if self._backlog and not self._transport.can_write_eof():
            self._transport.close()  # so nothing more is written to it
            return False
        self.hang_up()
        return self._output.waits and self._transport.can_write_eof()  # where it returns False, the socket is closed

    def connection_lost(self, error: Exception | None) -> None:
        """Leaves the world when the rest of the requests are done."""
        if self._lost:  # the host has cut it off and waits for no end
            return
        self._lost = self._closing = True
        # That of TLS keeps a protocol for good, and a buffer of 256 KiB: it and this one would keep each other.
        with contextlib.suppress(AttributeError):  # from Python 3.11 where that was closed twice
            self._transport.set_protocol(asyncio.BufferedProtocol())
        self._full = False
        self._cancel_timer()
        self._host.forget(self)
        self._visit.ends("hung_up" if error is None else "reset")
        try:
            self._work()
        except Exception:
            self._failed()
        self._visit.end()

    def pause_writing(self) -> None:
        """Lets this peer's commands wait until it reads."""
        self._full = True
        if self._world is not None:
            self._world.turns.forget_reader(self)

    def resume_writing(self) -> None:
        """Goes on with the commands that waited."""
        self._full = False
        if self._world is not None and self._backlog:
            self._world.turns.wait(self)

    # -- authentication --------------------------------------------------------------------------------------------

    def _authenticate(self, messages: Sequence[Auth | bytes]) -> None:
        """Deals with the first frame, if it has come."""
        if not messages:
            if self._session.violation is not None:
                self.hang_up(self._session.violation)
            return
        self._cancel_timer()
        auth = cast(Auth, messages[0])
        default = self._default_world
        keys = self._host.keys
        every, own, maker = keys.accepts(auth.password), keys.opened_by(auth.password), keys.maker(auth.password)
        if not every and own and default is None:
            default = next(iter(own))
        if auth.close is not None or auth.create is not None:
            right = every or maker is not None
        elif auth.list:
            right = every or maker is not None or bool(own)
        else:
            right = every or (auth.world or default) in own
        error = auth.error or self._wrong_password(right)
        if error is not None:
            self._refuse(error)
        elif auth.close is not None:
            logger.info("%s closes world %r", self._peer, auth.close)
            self._transport.pause_reading()
            self._host.close_world(auth.close, None if every else maker, self)
        elif auth.create is not None and not self._host.draining:
            logger.info("%s creates world %r", self._peer, auth.create["world"])
            self._transport.pause_reading()
            self._host.create_world(auth.create, None if every else maker, self)
        elif auth.list:
            self._transport.pause_reading()
            self._host.show_worlds(self, None if every else own, auth.start)
        else:
            try:
                self._host.let_in(self)
                name = self._host.world_name(auth.world or default)
                self._seat = self._host.keys.seat(name, auth)
            except (WorldError, RejectedMessage) as error:
                self.hang_up(error)
                return
            self.destination = name
            self._transport.pause_reading()
            self._join()

    def answer(self, message: Mapping[str, Any]) -> None:
        """Answers the authentication, and hangs up."""
        if not self._closing:
            self._output.put(self._session.accept(message))
            self._visit.ends("listed")
            self.hang_up()

    def _wrong_password(self, right: bool) -> RejectedMessage | None:
        """Returns why a password does not let anybody in: it is wrong, or there were too many guesses of late."""
        guesses, now = self._host.guesses, monotonic()
        wait = guesses.wait(self._address, now)
        if wait > 0.0:
            reason = f"too many wrong passwords came from your address; try again in {ceil(wait)} s"
            return RejectedMessage("auth_failed", reason)
        if right:
            return None
        guesses.wrong(self._address, now)
        logger.warning("%s failed to authenticate: wrong password", self._peer)  # as often as guesses are heard
        return RejectedMessage("auth_failed", "that is not the password")

    def _join(self) -> None:
        """Joins the world as soon as it can be joined, and executes what came behind the password."""
        if self.destination is None:
            return
        world = self._host.find(self.destination, self)
        if world is not None and (joined := world.join(self, *self._seat)) is not None:
            self.destination, self._world, self._output.world = None, world, world
            self._client, welcome = joined
            if "player" in welcome:
                welcome["token"] = self._host.keys.token(world.name, welcome["role"], welcome["player"])
            self._visit.enter(world.name, self._client, self._session.dialect)
            self._output.put(self._session.accept(welcome))
            self._work(self._session.receive(b""))

    def _refuse(self, error: NmesError) -> None:
        """Refuses after a while, so that guessing passwords is slow; what comes meanwhile is not even read."""
        self._visit.ends(error.code)
        self._transport.pause_reading()
        self._timer = asyncio.get_running_loop().call_later(self._host.auth_delay, self.hang_up, error)

    # -- commands --------------------------------------------------------------------------------------------------

    def resume(self) -> None:
        """Goes on with what had to wait."""
        try:
            if self._closing and not self._backlog:
                self._end()
            elif self._world is None:
                self._join()
            elif self._backlog:
                self._work()
        except Exception:
            self._failed()

    def _work(self, messages: Sequence[Auth | bytes] = ()) -> None:
        """Queues what came, and executes what is queued for what is left of its world's slice."""
        world, session, backlog, output = self._world, self._session, self._backlog, self._output
        if world is None:
            return
        now, turns = monotonic(), world.turns
        if not turns.end:  # written here, and not by a function: this is done for every command
            turns.end.append(now + SLICE)
            if not turns.called:
                turns.called = True
                asyncio.get_running_loop().call_soon(turns.next)
        until = turns.end[0]
        if messages:
            self._active_at = now
            backlog.extend(cast(Sequence[bytes], messages))
        if session.violation is not None:
            self._queue_violation(session.violation)
        waits = self._reading is not None
        while backlog and now < until and not self._full and not waits and not output.waits:
            first = backlog[0]
            if isinstance(first, Request):
                request = first
            elif len(first) > LONG:
                if world.turns.begin_reading(self):
                    self._read_in_thread(first, world)
                waits = True
                break
            else:
                request = session.read(backlog, LONG)
            if request.ignored or request.said is not None:
                _log_without_effect(session, request, self._peer)
            reply = world.submit(self._client, request, session.reply)
            waits = reply is None
            if reply is None or not backlog:  # it waits, or its connection was ended meanwhile
                break
            backlog.popleft()
            self._visit.commands += 1
            if reply:
                output.queue.append(reply)
                output.size += len(reply)
                if output.size > CHUNK:
                    output.flush()
            if request.error is not None and request.error is session.violation:
                self._visit.ends(request.error.code)
                self.hang_up()
            now = monotonic()
        output.flush()
        if self._overflowed:
            self._cut()
        if backlog or self._lost:
            self._wait_or_leave(waits or output.waits)
        else:
            self._transport.resume_reading()

    def _read_in_thread(self, frame: bytes, world: HostedWorld) -> None:
        """Reads the first frame of the backlog in a thread; what came behind it waits."""
        loop = asyncio.get_running_loop()
        self._reading = self._host.read(self._session.parse, frame)

        # Given the future: one that it were to find by itself would keep itself, and with it what was read.
        def go_on(done: Future[Request]) -> None:
            self._reading = None
            world.turns.end_reading()
            if self._backlog:  # else the connection was ended meanwhile
                self._backlog[0] = self._session.redacted(done.result())
            self.resume()

        self._reading.add_done_callback(lambda done: loop.call_soon_threadsafe(go_on, done))

    def _wait_or_leave(self, waits: bool) -> None:
        """Has the rest executed when others have had their turn, or after `resume`; leaves if none is left."""
        if not self._backlog:
            self._leave()
            return
        self._transport.pause_reading()
        if self._world is not None and not self._full and not waits:
            self._world.turns.wait(self)

    def _queue_violation(self, violation: RejectedMessage) -> None:
        """Queues a frame that ends the session, once.

        It goes through the world, so that the recording tells of it; of the frame itself nothing is kept.
        """
        last = self._backlog[-1] if self._backlog else None
        if not isinstance(last, Request) or last.error is not violation:
            self._backlog.append(Request(b"", None, violation))

    # -- output ----------------------------------------------------------------------------------------------------

    def send_event(self, event: bytes) -> None:
        """Queues an event, unless the peer is too far behind: then `flush` ends the connection."""
        if self._closing or self._overflowed:
            return
        if self._output.size + self._transport.get_write_buffer_size() > self._limits.pending:
            self._overflowed = True  # `flush` ends it: the world is in the middle of telling its clients
        else:
            self._output.put(self._session.event(event))

    def discard_output(self) -> None:
        """Drops what was not yet handed to the socket."""
        self._output.discard()

    def flush(self) -> None:
        """Hands what is queued to the socket, in one write, when it is on disk."""
        self._output.flush()
        if self._overflowed:
            self._cut()

    def inspect(self, now: float) -> None:
        """Ends the connection where nothing has moved for too long; called now and then."""
        buffered = self._transport.get_write_buffer_size()
        if self._output.written != self._sent:
            self._sent, self._active_at = self._output.written, now
        progress = self._output.written - buffered  # less where others, such as a WebSocket's pongs, are in the way
        if progress > self._progress or not (buffered or self._closing):
            self._progress, self._progress_at = progress, now
        if self._closing:
            if now - self._progress_at >= LINGER:
                self._transport.abort()
        elif now - self._progress_at >= self._limits.stall_timeout:
            self._cut()
        elif self._backlog:
            self._active_at = now  # it waits for us
        elif self._world is not None and now - self._active_at >= self._limits.idle_timeout:
            logger.info("%s was idle for %g s", self._peer, self._limits.idle_timeout)
            self._visit.ends("idle")
            self.hang_up()

    def _cut(self) -> None:
        logger.warning("%s does not read what it is sent and is cut off", self._peer)
        self.hang_up(RejectedMessage("slow_consumer", "you do not read what you are sent"))

    # -- the end ---------------------------------------------------------------------------------------------------

    @property
    def draining(self) -> bool:
        """Whether there is output that the peer has not read yet."""
        return self._output.waits or self._transport.get_write_buffer_size() > 0

    def abort(self) -> None:
        """Ends the connection at once."""
        self._visit.ends("cut")
        self._transport.abort()

    def hang_up(self, error: NmesError | None = None) -> None:
        """Sends an error, if any, and leaves the world; the socket is closed when the peer has hung up too, or soon."""
        if self._closing:
            return
        self._closing = True
        self._visit.ends("closed" if error is None else error.code)
        self._overflowed = False
        self.destination = None
        self._backlog.clear()
        self._cancel_timer()
        if error is not None:
            self._output.put(self._session.refuse(error))
        self.flush()
        self._leave()
        self._progress_at = monotonic()
        self._timer = asyncio.get_running_loop().call_later(self._limits.idle_timeout, self._transport.abort)
        self._end()

    def _end(self) -> None:
        """Closes this side of the socket when all output was handed to it."""
        if self._output.waits or self._lost or self._transport.is_closing():  # that of TLS is closed only once
            return
        if self._ended or not self._transport.can_write_eof():
            self._transport.close()
        else:
            # Closing a socket while the peer still sends resets it, and may take our last output away from the peer. So
            # this side is closed only, and what still comes is read and thrown away.
            with contextlib.suppress(OSError):  # the peer is gone already
                self._transport.write_eof()
            self._transport.resume_reading()

    def _leave(self) -> None:
        world, self._world = self._world, None
        if world is not None:
            world.leave(self._client)

    def _cancel_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


def _log_without_effect(session: Session, request: Request, peer: str) -> None:
    """Logs what of a command does nothing here and no reply tells, once a connection."""
    for thing in session.without_effect(request):
        logger.info("%s says %s", peer, visible(thing))
