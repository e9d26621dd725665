"""A client at the supervisor: let in as by any host, and then handed over to the worker that has the world.

It hides how: the socket itself goes to the worker, with what was read of it; where there is TLS, one end of a pair of
sockets, and bytes are carried between the two. Invariant: the supervisor keeps the socket until the worker has left it,
so that it can tell the client where the worker ends first.
"""

from __future__ import annotations

import asyncio
import socket
from typing import TYPE_CHECKING

from nmes.errors import NmesError
from nmes.server.access_log import Visit
from nmes.server.connection import Connection

if TYPE_CHECKING:
    from nmes.fleet.supervisor import Supervisor
    from nmes.fleet.worker_processes import WorkerProcess

__all__ = ["Visitor"]


class Visitor(Connection):
    """A connection that comes to the supervisor."""

    def __init__(self, host: Supervisor, default_world: str | None) -> None:
        super().__init__(host, default_world)
        self._said = bytearray()  # what was read of it, until it is handed over
        self._worker: WorkerProcess | None = None  # that it was handed to
        self._number = 0
        self._carrying: asyncio.Task[None] | None = None
        self._far: asyncio.Transport | None = None  # our end of the pair, where bytes are carried
        self._far_ended = False
        self._verdict: tuple[NmesError | None] | None = None  # how it is to end, when all was carried that came before

    # -- handed over -----------------------------------------------------------------------------------------------

    def hand_over(self, worker: WorkerProcess, world: str, number: int) -> None:
        """Hands the connection to the worker that has its world, under a number."""
        self.destination = None
        self._visit = Visit(None, self._peer)  # the worker writes the log
        self._session.accept({})  # the worker says so; what we may say at the end is no answer to `auth`
        self._worker, self._number = worker, number
        worker.visitors[number] = self
        said, self._said = bytes(self._said), bytearray()
        peer = list((self._transport.get_extra_info("peername") or ("?", 0))[:2])
        fields = {"number": number, "world": world, "peer": peer}
        if self._transport.get_extra_info("sslcontext") is None:
            own: socket.socket = self._transport.get_extra_info("socket")
            worker.line.tell("take", data=said, descriptor=own.fileno(), **fields)
            return
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        worker.line.tell("take", data=said, descriptor=theirs.fileno(), **fields)
        theirs.close()
        self._carrying = asyncio.get_running_loop().create_task(self._carry(ours))

    def leave(self, error: NmesError | None = None) -> None:
        """Ends the connection, which the worker has left, or with which it has ended: then an error says so."""
        self._verdict = (error,)
        if self._carrying is None or self._far_ended:
            self._finish()

    def _finish(self) -> None:
        if self._verdict is None:
            return
        if self._verdict[0] is not None:
            self.hang_up(self._verdict[0])
        elif self._carrying is None:
            self._transport.abort()
        elif not self._transport.is_closing():  # that of TLS is closed only once, by us or by the client's end
            self._transport.close()  # it writes first what was carried

    def connection_lost(self, error: Exception | None) -> None:
        """Counts the client out."""
        super().connection_lost(error)
        if self._worker is not None:
            self._worker.visitors.pop(self._number, None)
        if self._far is not None:
            self._far.close()

    # -- carried between -------------------------------------------------------------------------------------------

    async def _carry(self, ours: socket.socket) -> None:
        far, _ = await asyncio.get_running_loop().create_connection(lambda: _Far(self), sock=ours)
        self._far = far
        if self._lost:
            self._far.close()
        else:
            self._transport.resume_reading()

    def buffer_updated(self, nbytes: int) -> None:
        """Reads what comes before the world is entered, and carries what comes then."""
        if self._worker is None:
            self._said += self._host.buffer[:nbytes]
            super().buffer_updated(nbytes)
        elif self._far is not None and not self._closing:
            self._host.received += nbytes
            self._far.write(bytes(self._host.buffer[:nbytes]))

    def pause_writing(self) -> None:
        """Lets the worker wait until the client reads."""
        super().pause_writing()
        if self._far is not None:
            self._far.pause_reading()

    def resume_writing(self) -> None:
        """Lets the worker go on."""
        super().resume_writing()
        if self._far is not None and not self._far.is_closing():
            self._far.resume_reading()

    def eof_received(self) -> bool:
        """Tells the worker that the client says no more."""
        if self._worker is None or self._closing:
            return super().eof_received()
        if self._far is not None:
            self._far.write_eof()
        return self._transport.can_write_eof()  # over TLS the connection ends all the same, and asyncio warns of True

    def carried(self, data: bytes) -> None:
        """Sends the client what the worker says."""
        self._host.sent += len(data)
        self._output.written += len(data)  # by which it is seen that the client reads
        if not self._transport.is_closing():
            self._transport.write(data)

    def ask_to_wait(self, waits: bool) -> None:
        """Lets the client wait until the worker reads."""
        if not self._transport.is_closing():
            (self._transport.pause_reading if waits else self._transport.resume_reading)()

    def far_end(self) -> None:
        """Ends it, as soon as it is known why: the worker says nothing more."""
        self._far_ended = True
        self._finish()


class _Far(asyncio.Protocol):
    """Our end of the pair of which the worker has the other one."""

    def __init__(self, visitor: Visitor) -> None:
        self._visitor = visitor

    def data_received(self, data: bytes) -> None:
        self._visitor.carried(data)

    def pause_writing(self) -> None:
        self._visitor.ask_to_wait(True)

    def resume_writing(self) -> None:
        self._visitor.ask_to_wait(False)

    def connection_lost(self, error: Exception | None) -> None:
        self._visitor.far_end()
