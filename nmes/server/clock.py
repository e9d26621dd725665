"""The pace of a world that ticks by itself: `realtime` keeps to the wall's clock, `fast` ticks whenever it can."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from time import monotonic

from nmes.world import World

__all__ = ["Clock"]

CATCH_UP = 0.25  # s: a realtime world that fell further behind than this lets the rest go


class Clock:
    """Says when a world ticks by itself, and how often. It runs while the world does."""

    def __init__(self, world: World, turn: Callable[[], None]) -> None:
        """Makes a clock that stands still until `adjust` is called.

        Args:
            world: The world that ticks.
            turn: Called in the event loop whenever ticks may be due. It has `due` ticks done, and calls `ticked`.
        """
        self._world = world
        self._turn = turn
        self._handle: asyncio.Handle | None = None  # of the next turn, or of the one that is taken now
        self._pace: tuple[str, float] | None = None  # mode and rate that it was set for; None: not ticking
        self._frame = 0  # where it left the world
        self._start = 0.0  # the wall's time and the frame from which the pace of `realtime` is reckoned
        self._start_frame = 0

    @property
    def _speed(self) -> float:
        """Ticks per second of the wall's clock."""
        return float(self._world.rate * self._world.config["tick_rate"])

    def adjust(self) -> None:
        """Starts, stops or sets the clock anew where mode, rate, pause or frame are not what it was set for."""
        world = self._world
        if not world.running:
            self.stop()
        elif (world.mode, world.rate) != self._pace or world.frame != self._frame:
            self.stop()
            self._pace = (world.mode, world.rate)
            self._frame = self._start_frame = world.frame
            self._start = monotonic()
            self.turn_soon()

    def due(self) -> float:
        """Returns the number of ticks that are due, infinite in `fast`."""
        if self._world.mode != "realtime":
            return math.inf
        now, done = monotonic(), self._world.frame - self._start_frame
        self._start += max(now - self._start - done / self._speed - CATCH_UP, 0.0)
        return math.floor((now - self._start) * self._speed) - done

    def ticked(self, due: float, ticks: int) -> None:
        """Sets the next turn, after so many of the ticks that were due."""
        self._frame = self._world.frame
        if due > ticks:
            self.turn_soon()
        else:
            at = self._start + (self._frame + 1 - self._start_frame) / self._speed
            self._handle = asyncio.get_running_loop().call_at(at, self._turn)

    def turn_soon(self) -> None:
        """Sets the next turn as soon as others have had theirs."""
        self._handle = asyncio.get_running_loop().call_soon(self._turn)

    def stop(self) -> None:
        """Takes no further turn."""
        if self._handle is not None:
            self._handle.cancel()
            self._handle = self._pace = None
