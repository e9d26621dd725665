"""The work of the motors of a world.

Hides where the sums are kept, and that they are taken of many ticks at once. The work of a motor in a tick is the
size of its effort times its joint's velocity, over all engine steps of the tick: a motor that brakes works too.

Invariants: a motor counts from the tick after it was first switched on, whether it runs or not; sums are taken tick by
tick, in watts, so that neither asking nor saving changes a bit of them.
"""

from __future__ import annotations

import numpy as np

from nmes.backend import Array, Simulation

__all__ = ["EnergyMeter"]

_ROWS = 256  # ticks of which the powers are kept before they are summed


class EnergyMeter:
    """The work of motors, which are known by the numbers of their joints."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._watts: dict[int, float] = {}  # the sums by joint, in the order in which they came, but for what is kept
        self._numbers: tuple[int, ...] | None = ()  # None while joints come and go: nothing is kept then
        self._track = simulation.track([], [], [], 0)
        self._latest: dict[int, Array] = {}  # the last row that was summed, if no tick came after it

    @property
    def numbers(self) -> tuple[int, ...]:
        """The joints that are metered, in the order in which they came: the same tuple until that changes."""
        if self._numbers is None:
            self._numbers = tuple(self._watts)
            self._track = self._simulation.track([], [], self._numbers, _ROWS)
        return self._numbers

    def powers(self) -> Array:
        """Returns the size of the power of each of `numbers`, array (m,), W; to be asked right after `tick`."""
        return self._track.powers(self._track.rows - 1, self._track.rows)[0, 1] if self.numbers else np.zeros(0)

    def latest(self, joint: int) -> Array:
        """Returns the power of a motor in the tick that ended last, and its size, array (2,), W.

        A joint that was cut at the end of that tick has it too; one that was cut before it, or is not metered, has 0.
        """
        self._settle()
        return self._latest.get(joint, np.zeros(2))

    def add(self, joint: int, watts: float = 0.0) -> None:
        """Meters a joint from now on, if it is not yet; `watts` is the sum that it has."""
        if joint not in self._watts:
            self._settle()
            self._numbers = None
            self._watts[joint] = watts

    def remove(self, joint: int) -> float:
        """Forgets a joint, and returns its sum."""
        self._settle()
        self._numbers = None
        return self._watts.pop(joint, 0.0)

    def watts(self, joint: int) -> float | None:
        """Returns the sum of a joint's power over all ticks, W; divided by the tick rate that is its work in J."""
        if joint not in self._watts:
            return None
        self._settle()
        return self._watts[joint]

    def tick(self) -> None:
        """Takes the power of a tick that has just ended."""
        numbers = self._numbers if self._numbers is not None else self.numbers
        if numbers:
            if self._track.rows == _ROWS:
                self._settle()
            self._track.note()
        self._latest = {}

    def _settle(self) -> None:
        """Adds what is kept to the sums, tick by tick."""
        if self._track.rows:
            rows = self._track.powers(0, self._track.rows)
            sums = np.add.accumulate(np.vstack([list(self._watts.values()), rows[:, 1]]))[-1]
            self._latest = dict(zip(self._watts, rows[-1].T, strict=True))
            self._watts = dict(zip(self._watts, sums.tolist(), strict=True))
            self._track = self._simulation.track([], [], self._numbers or (), _ROWS)
