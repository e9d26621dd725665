"""The trajectories of several bodies in one world, and the quantities that are between them.

Hides whose trajectory a quantity with a role is asked of, and how bodies that meet are measured. As in a `Trajectory`,
row 0 is the start, and how many rows are computed at a time changes no bit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from nmes.backend import Array
from nmes.objective.quantities import Quantity
from nmes.objective.trajectory import Flags, Rows, Trajectory

__all__ = ["Trajectories"]

_AXES = ("x", "y", "z")


class Trajectories(Rows):
    """The trajectories of the creatures of a match, row by row beside each other.

    Attributes:
        of: Each role's, in the order of the roles.
        others: The roles and the props, in the order of the columns of `touching`.
        touching: Array (rows, roles, others): whether a cube of the role touches one of the other; without rows where
            no quantity of the match is about that.
        rows: How many rows of all of them are written.
    """

    def __init__(
        self,
        of: Mapping[str, Trajectory],
        props: Trajectory | None,
        targets: Mapping[str, str],
        ticks: int,
        *,
        touches: bool,
    ) -> None:
        """Makes room for the start and so many ticks.

        Args:
            of: Each role's trajectory.
            props: That of the props, if there are any; what it calls its body means nothing.
            targets: Of the roles whose target is another role or a prop: which. Their `distance` is measured from it.
            ticks: How many.
            touches: Whether a quantity is about what touches what.
        """
        self.of, self._props, self._targets = dict(of), props, dict(targets)
        self.others = (*of, *(() if props is None else props.bodies.cubes))
        self.touching: Flags = np.zeros((ticks + 1 if touches else 0, len(of), len(self.others)), np.bool_)
        self.rows = 0

    def series(self, quantity: Quantity, begin: int = 0, end: int | None = None) -> Array:
        """As `Rows.series`."""
        end = self.rows if end is None else end
        role, plain = quantity.role, Quantity(quantity.name, quantity.cube)
        if role is None:
            trajectory = next(iter(self.of.values())) if quantity.cube is None else self._props
            assert trajectory is not None  # for the task has the props that it names
            return trajectory.series(plain, begin, end)
        name, *rest = quantity.name.split(".")
        if name == "distance" and role in self._targets:
            name, rest = "apart", [self._targets[role]]
        match name:
            case "apart":
                here, there = self._centres(role, quantity.cube, begin, end), self._centres(rest[0], None, begin, end)
                return _length([a - b for a, b in zip(here, there, strict=True)])
            case "touching":
                return self._touches(role, rest[0])[begin:end].astype(np.float64)
            case "after_touch":
                return self._after_touch(role, *rest, begin=begin, end=end)
        return self.of[role].series(plain, begin, end)

    def first_touch(self, role: str, other: str, end: int) -> int | None:
        """Returns the first row before `end` at which a role touches another, or a prop; None: it did at none."""
        rows = np.flatnonzero(self._touches(role, other)[:end])
        return int(rows[0]) if len(rows) else None

    def _touches(self, role: str, other: str) -> Flags:
        return self.touching[:, list(self.of).index(role), self.others.index(other)]

    def _centres(self, whose: str, cube: str | None, begin: int, end: int) -> list[Array]:
        """Returns where the centre of mass of a role, of a cube of it or of a prop is in each row, along x, y and z."""
        trajectory = self.of.get(whose, self._props)
        assert trajectory is not None  # as above
        if whose not in self.of:
            cube = whose
        return [trajectory.series(Quantity(f"position.{axis}", cube), begin, end) for axis in _AXES]

    def _after_touch(self, role: str, other: str, axis: str, *, begin: int, end: int) -> Array:
        first = self.first_touch(role, other, end)
        if first is None:
            return np.zeros(end - begin)
        way = [self._since(role, each, first, begin, end) for each in (("x", "z") if axis == "horizontal" else (axis,))]
        return np.where(np.arange(begin, end) < first, 0.0, _length(way) if axis == "horizontal" else way[0])

    def _since(self, role: str, axis: str, first: int, begin: int, end: int) -> Array:
        quantity = Quantity(f"position.{axis}")
        return self.of[role].series(quantity, begin, end) - self.of[role].series(quantity, first, first + 1)


def _length(parts: Sequence[Array]) -> Array:
    total = parts[0] * parts[0]
    for part in parts[1:]:
        total = total + part * part
    return np.asarray(np.sqrt(total))
