"""What the motors of a world have worked.

Hides where the sums are kept and that the engine is asked for all motors at once. The work of a motor in a tick is the
size of its effort times its joint's velocity, both as they are when the tick ends, times the tick: a motor that brakes
works too, and what a motor gives for less than a tick counts as far as it lasts to its end.

Invariants: a motor counts from the tick after it was first switched on, whether it runs or not; sums are taken tick by
tick, in watts, so that neither asking nor saving changes a bit of them.
"""

from __future__ import annotations

import numpy as np

from nmes.backend import Array, Simulation

__all__ = ["Meter"]


class Meter:
    """The work of motors, which are known by the numbers of their joints.

    Attributes:
        powers: Size of the power of each in the last tick, array (m,), W, in the order of `numbers`.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._watts: dict[int, float] = {}  # the sums, as of when joints came or went last
        self._numbers: tuple[int, ...] | None = ()  # None while joints come and go: then the sums are all above
        self._rows: dict[int, int] = {}
        self._sums: Array = np.zeros(0)
        self.powers: Array = np.zeros(0)

    @property
    def numbers(self) -> tuple[int, ...]:
        """The joints that are metered, in the order in which they came: the same tuple until that changes."""
        if self._numbers is None:
            self._numbers = tuple(self._watts)
            self._rows = {joint: row for row, joint in enumerate(self._numbers)}
            self._sums, self.powers = np.array(list(self._watts.values())), np.zeros(len(self._watts))
        return self._numbers

    def _open(self) -> None:
        if self._numbers is not None:
            self._watts = dict(zip(self._numbers, self._sums.tolist(), strict=True))
            self._numbers = None

    def add(self, joint: int, watts: float = 0.0) -> None:
        """Meters a joint from now on, if it is not yet; `watts` is the sum that it has."""
        if self.watts(joint) is None:
            self._open()
            self._watts[joint] = watts

    def remove(self, joint: int) -> float:
        """Forgets a joint, and returns its sum."""
        if self.watts(joint) is None:
            return 0.0
        self._open()
        return self._watts.pop(joint)

    def watts(self, joint: int) -> float | None:
        """Returns the sum of a joint's power over all ticks, W; divided by the tick rate that is its work in J."""
        if self._numbers is None:
            return self._watts.get(joint)
        row = self._rows.get(joint)
        return None if row is None else float(self._sums[row])

    def tick(self) -> None:
        """Takes the power of a tick that has just ended."""
        numbers = self._numbers if self._numbers is not None else self.numbers
        if numbers:
            powers = self._simulation.powers(numbers)
            self.powers = np.abs(powers, out=powers)
            self._sums += powers
