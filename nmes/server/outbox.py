"""The output of one socket, on its way out: queued, on disk where that was asked for, written.

It hides when it is written. What waits for the disk waits in a thread, so that nobody else does.

Invariant: what a recorded world tells goes to the socket when the disk has it, in the order in which it was queued.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING
from weakref import WeakMethod

if TYPE_CHECKING:
    from nmes.server.hosted_world import HostedWorld
    from nmes.server.reception import Reception

__all__ = ["Outbox"]


class Outbox:
    """The output of one socket.

    Attributes:
        queue: What `flush` is to hand to the socket; whoever appends to it adds to `size`.
        world: Whose output it is; None: nobody's yet. It stays when the client has left.
        size: What is queued, or waits for the disk, bytes.
        written: What was handed to the socket, bytes.
        waits: Whether something waits for the disk. Only then is there more to come without `flush`.
    """

    def __init__(self, host: Reception, transport: asyncio.Transport, resume: Callable[[], None]) -> None:
        """Begins empty; `resume` is called when what waited for the disk was handed over, or dropped."""
        self.world: HostedWorld | None = None
        self.size = self.written = 0
        self.waits = False
        self._host = host
        self._resume = WeakMethod(resume)  # else the two would keep each other when all is over
        self._transport = transport
        self.queue: list[bytes] = []
        self._uncommitted = b""

    def put(self, data: bytes) -> None:
        """Queues output."""
        self.queue.append(data)
        self.size += len(data)

    def flush(self) -> None:
        """Hands what is queued to the socket, in one write, as soon as it is on disk."""
        if not self.queue or self.waits:
            return
        data = b"".join(self.queue)
        self.queue.clear()
        if self.world is not None and self.world.durable:
            self._uncommitted, self.waits = data, True
            self.world.commit(self)
        else:  # written here, and not by a function: this is done for every command
            self.size -= len(data)
            self.written += len(data)
            self._host.sent += len(data)
            if not self._transport.is_closing():
                self._transport.write(data)

    def committed(self) -> None:
        """Hands over what waited for the disk; what was queued meanwhile is next."""
        data, self._uncommitted, self.waits = self._uncommitted, b"", False
        self.size -= len(data)
        self.written += len(data)
        self._host.sent += len(data)
        if data and not self._transport.is_closing():
            self._transport.write(data)
        self.flush()
        resume = self._resume()
        if resume is not None:
            resume()

    def discard(self) -> None:
        """Drops what was not yet handed to the socket."""
        self.queue.clear()
        self.size, self._uncommitted = 0, b""
