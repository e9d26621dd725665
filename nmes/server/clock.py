"""The pace of a world that ticks by itself: `realtime` keeps to the wall's clock, `fast` ticks whenever it can."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from time import monotonic
from typing import NamedTuple

from nmes.world import World

__all__ = ["Clock", "Lag"]

CATCH_UP = 0.25  # s: a realtime world that fell further behind than this lets the rest go
LATE = 0.5  # s: a world that let so much go lags; less is a stumble that nobody need hear of
PERIOD = 1.0  # s: over which it is seen whether a world keeps up


class Lag(NamedTuple):
    """How a realtime world falls behind: how fast it ran of late, as a part of its pace, and the time (s) let go."""

    ratio: float
    behind: float


class Clock:
    """Says when a world ticks by itself, and how often. It runs while the world does.

    Attributes:
        lag: How the world falls behind; None: it keeps up, or does not tick by the wall's clock.
        lost: The wall's time (s) that it has let go in all.
    """

    def __init__(
        self,
        world: World,
        turn: Callable[[], None],
        tell: Callable[[Lag, bool], None],
        lose: Callable[[float], None] | None = None,
    ) -> None:
        """Makes a clock that stands still until `adjust` is called.

        Args:
            world: The world that ticks.
            turn: Called in the event loop whenever ticks may be due. It has `due` ticks done, and calls `ticked`.
            tell: Called with `lag` after each period in which the world fell behind, and whether that is over.
            lose: Called with the wall's time (s) that it lets go, whenever it does; None: nothing is.
        """
        self.lag: Lag | None = None
        self.lost = 0.0
        self._world = world
        self._turn = turn
        self._tell = tell
        self._lose = lose
        self._handle: asyncio.Handle | None = None  # of the next turn, or of the one that is taken now
        self._pace: tuple[str, float] | None = None  # mode and rate that it was set for; None: not ticking
        self._frame = 0  # where it left the world
        self._start = 0.0  # the wall's time and the frame from which the pace of `realtime` is reckoned
        self._start_frame = 0
        self._since = 0.0  # the wall's time at which the period began; the frame, and what was lost by then
        self._since_frame = 0
        self._since_lost = 0.0
        self._put_off = False  # whether a turn is to be taken as soon as it can be
        self._kept_up = 0.0  # what was lost when the world last kept up

    @property
    def _speed(self) -> float:
        """Ticks per second of the wall's clock."""
        return float(self._world.rate * self._world.config["tick_rate"])

    def adjust(self) -> None:
        """Starts, stops or sets the clock anew where mode, rate, pause or frame are not what it was set for."""
        world = self._world
        if not world.running:
            self.stop()
            self._keep_up()
        elif (world.mode, world.rate) != self._pace or world.frame != self._frame:
            self.stop()
            self._keep_up()
            self._pace = (world.mode, world.rate)
            self._frame = self._start_frame = self._since_frame = world.frame
            self._start = self._since = monotonic()
            self.turn_soon()

    def due(self) -> float:
        """Returns the number of ticks that are due, infinite in `fast`."""
        if self._world.mode != "realtime":
            return math.inf
        now, done = monotonic(), self._world.frame - self._start_frame
        late = max(now - self._start - done / self._speed - CATCH_UP, 0.0)
        self._start += late
        self.lost += late
        if late > 0.0 and self._lose is not None:
            self._lose(late)
        if now >= self._since + PERIOD:
            self._look_back(now)
        return math.floor((now - self._start) * self._speed) - done

    def _look_back(self, now: float) -> None:
        """Sees whether the world kept up during the period that ends now."""
        frame = self._world.frame
        ratio = min((frame - self._since_frame) / ((now - self._since) * self._speed), 1.0)
        late = self.lost > self._since_lost
        self._since, self._since_frame, self._since_lost = now, frame, self.lost
        if not late:
            self._keep_up(ratio)
        elif self.lost - self._kept_up > LATE:
            self.lag = Lag(ratio, self.lost - self._kept_up)
            self._tell(self.lag, False)

    def _keep_up(self, ratio: float = 1.0) -> None:
        """Forgets what was lost; tells it where the world fell behind until now."""
        behind, self._kept_up = self.lost - self._kept_up, self.lost
        if self.lag is not None:
            self.lag = None
            self._tell(Lag(ratio, behind), True)

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

    def put_off(self) -> None:
        """Notes that a turn came while the world, or its disk, was busy."""
        self._put_off = True

    def take_put_off(self) -> None:
        """Sets the turn that was put off, if one was."""
        if self._put_off:
            self._put_off = False
            self.turn_soon()

    def stop(self) -> None:
        """Takes no further turn."""
        if self._handle is not None:
            self._handle.cancel()
            self._handle = self._pace = None
