"""Whose commands a world executes next, and whose long frame is read next: its connections take turns.

They share one slice of `SLICE` s in each turn of the event loop. If each had its own, as many slices would follow each
other as there are connections with something to do, and whoever is in another world would wait for all of them.

Invariants: nobody who waits is passed over; `next` is to be called by the loop as long as a slice is open or somebody
waits for one.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from time import monotonic
from typing import Protocol

__all__ = ["Turns"]


class _Waiter(Protocol):
    def resume(self) -> None:
        """Goes on with what had to wait."""


class Turns:
    """The turns of the connections of one world.

    Args:
        busy: Tells whether the world is in a thread or closes; `read_on` is to be called when it is back.

    Attributes:
        end: When the slice is over that is open in this turn of the loop, as `monotonic`; empty where none is. Whoever
            opens one has `next` called, unless it is `called` already.
        called: Whether `next` is to be called by the loop.
    """

    def __init__(self, busy: Callable[[], bool]) -> None:
        self._busy = busy
        self.end: list[float] = []
        self.called = False
        self._queue: dict[_Waiter, None] = {}  # in the order in which they go on
        self._reading = False  # a long frame of somebody
        self._readers: dict[_Waiter, None] = {}  # those with a long frame, in the order in which these are read

    def wait(self, waiter: _Waiter) -> None:
        """Has a connection resumed when those that wait already have had their turn."""
        self._queue.setdefault(waiter)
        self._call()

    def _call(self) -> None:
        if self._queue and not self.called:
            self.called = True
            asyncio.get_running_loop().call_soon(self.next)

    def next(self) -> None:
        """Begins a turn of the loop: resumes those that wait, until a slice is over."""
        self.called = False
        self.end.clear()
        for waiter in list(self._queue):
            if self.end and monotonic() >= self.end[0]:
                break
            if waiter in self._queue:
                del self._queue[waiter]
                waiter.resume()
        self._call()

    # -- long frames -----------------------------------------------------------------------------------------------

    def begin_reading(self, waiter: _Waiter) -> bool:
        """Begins to read a long frame of a connection, until `end_reading`; returns whether it may: it is next.

        One is read at a time, and none while the world is busy: what was read takes many times the room of its bytes,
        and would only wait. Who may not is resumed when it is next, and has to begin then, or to be forgotten.
        """
        self._readers.setdefault(waiter)
        if self._reading or self._busy() or next(iter(self._readers)) is not waiter:
            return False
        del self._readers[waiter]
        self._reading = True
        return True

    def end_reading(self) -> None:
        """Ends to read a long frame; the next is read then."""
        self._reading = False
        self.read_on()

    def forget_reader(self, waiter: _Waiter) -> None:
        """Lets others pass a connection that cannot go on for now, or is gone."""
        if waiter in self._readers:
            del self._readers[waiter]
            self.read_on()

    def read_on(self) -> None:
        """Resumes whose long frame is next."""
        if self._readers and not self._reading:
            self.wait(next(iter(self._readers)))
