"""Whose commands a world executes next: its connections share one slice in each turn of the event loop.

If each had its own, as many slices would follow each other as there are connections with something to do, and whoever
is in another world would wait for all of them.
"""

from __future__ import annotations

import asyncio
from time import monotonic
from typing import Protocol

__all__ = ["Turns"]


class _Waiter(Protocol):
    def resume(self) -> None:
        """Goes on with what had to wait."""


class Turns:
    """The turns of the connections of one world, of which none is passed over.

    Attributes:
        end: When the slice is over that has begun in this turn of the loop (as `monotonic`); empty where none has.
            Whoever begins one has it emptied with the next turn.
    """

    def __init__(self) -> None:
        self.end: list[float] = []
        self._queue: dict[_Waiter, None] = {}  # in the order in which they go on
        self._called = False  # whether `_go_on` is to be called

    def wait(self, waiter: _Waiter) -> None:
        """Has a connection resumed when those that wait already have had their turn."""
        self._queue.setdefault(waiter)
        self._go_on_soon()

    def _go_on_soon(self) -> None:
        if self._queue and not self._called:
            self._called = True
            asyncio.get_running_loop().call_soon(self._go_on)

    def _go_on(self) -> None:
        """Resumes those that wait, for one slice; who is not done by then waits again, behind the others."""
        self._called = False
        for waiter in list(self._queue):
            if self.end and monotonic() >= self.end[0]:
                break
            del self._queue[waiter]
            waiter.resume()
        self._go_on_soon()
