"""The trajectory of a body whose parts come and go.

Hides which cubes a quantity is computed from at which row: those that are there. Invariants: a body that never changes
has the same figures, bit for bit, as a plain `Trajectory`; no figure of a whole body jumps because its centre of mass
is another's when parts come or go, where it tells how far it has come.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from nmes.backend import Array
from nmes.objective.quantities import Quantity
from nmes.objective.trajectory import Block, ObservedBodies, Trajectory, beyond, earliest, in_order

__all__ = ["ChangingTrajectory"]

_OF_NO_CUBES = ("energy", "work", "time", "time_upright")  # quantities that are the same whatever is there


@dataclass(eq=False, slots=True)
class _Stage:
    """The rows in which a body has the same parts.

    Attributes:
        first: The first of them.
        bodies: What is there.
        columns: The columns of the whole trajectory in which that is.
        share: The mass of the body that is there, of that and of all that it has shed.
        stature: How high the centre of what is there of the body is above its lowest point in the document's pose, m.
        oversized: Whether that is larger at rest than it may be.
        origins: From where displacements are measured, of the body (None) and of cubes.
    """

    first: int
    bodies: ObservedBodies
    columns: npt.NDArray[np.intp]
    share: float
    stature: float
    oversized: bool
    origins: dict[str | None, Array] = field(default_factory=dict)


class ChangingTrajectory(Trajectory):
    """A trajectory with columns for all cubes that may be there; those of what is not there hold zeros.

    How far the body has come, its `displacement`, goes on through a change as if its centre had moved on in that
    tick at the velocity that it has then: to grow forwards, or to shed what is behind, is no way. What it has shed by
    itself counts as if it stayed where that was done, so that to kick off from it is no way either. What a part brings
    along in motion and height, when it comes, is in the last column of `work`, after the motors'.
    """

    def __init__(self, bodies: ObservedBodies, ticks: int, motors: int, *, contacts: bool = False) -> None:
        """Makes room for the start and so many ticks; `bodies` are all that may be there."""
        super().__init__(bodies, ticks, motors + 1, contacts=contacts)
        self._stages: list[_Stage] = []

    def change(
        self,
        bodies: ObservedBodies,
        columns: npt.NDArray[np.intp],
        *,
        shed: float = 0.0,
        stature: float = 0.0,
        oversized: bool = False,
    ) -> None:
        """Takes note of what is there from the next row on.

        Args:
            bodies: All of it, in the order of the columns.
            columns: Where that is in the rows.
            shed: The mass of what the body has shed by itself so far, kg.
            stature: How high the centre of mass of the body is above its lowest point in the pose of its document, m.
            oversized: Whether the body is larger in that pose than it may be: it is beyond its limit of size then.
        """
        if self._stages and self._stages[-1].first == self.rows:
            self._stages.pop()
        mass = float(in_order(bodies.masses[bodies.columns(None)]))
        self._stages.append(_Stage(self.rows, bodies, columns, mass / (mass + shed), stature, oversized))

    @property
    def there(self) -> npt.NDArray[np.intp]:
        """The columns of what is there at the last change."""
        return self._stages[-1].columns

    def series(self, quantity: Quantity, begin: int = 0, end: int | None = None) -> Array:
        """As `Rows.series`; of a cube that is not there it is no number."""
        end = self.rows if end is None else end
        if quantity.name == "work":
            return in_order(self.work[begin:end, :-1])
        if quantity.name in _OF_NO_CUBES:
            return super().series(quantity, begin, end)
        if quantity.name == "grown":
            return self._grown(begin, end)
        parts = [self._series(number, quantity, first, last) for number, first, last in self._pieces(begin, end)]
        return np.concatenate(parts) if parts else np.zeros(0)

    def _grown(self, begin: int, end: int) -> Array:
        """Returns how much higher the body is by what has grown: what flies, or is lifted, has not grown."""
        rises = self.series(Quantity("height"), begin, end) - self.series(Quantity("height"), 0, 1)
        born = self._stages[0].stature
        gained = [
            np.full(last - first, self._stages[at].stature - born) for at, first, last in self._pieces(begin, end)
        ]
        standing = self.series(Quantity("contacts"), begin, end) > 0.0
        return np.where(standing, np.maximum(np.minimum(rises, np.concatenate([np.zeros(0), *gained])), 0.0), 0.0)

    def first_beyond(self, begin: int, end: int, **limits: float) -> tuple[int, str] | None:
        """As `Trajectory.first_beyond`."""
        for number, first, last in self._pieces(begin, end):
            stage = self._stages[number]
            states = self.states[first:last, stage.columns]
            flagged = beyond(stage.bodies, states, self.work[first:last], **limits)
            flagged["size"] |= stage.oversized
            if (stop := earliest(flagged, first)) is not None:
                return stop
        return None

    def _pieces(self, begin: int, end: int) -> Iterator[tuple[int, int, int]]:
        """Yields the stages that have some of the rows: each its number, its first row of them and the one after."""
        ends = [*(stage.first for stage in self._stages[1:]), len(self.states)]
        for number, (stage, last) in enumerate(zip(self._stages, ends, strict=True)):
            if max(begin, stage.first) < min(end, last):
                yield number, max(begin, stage.first), min(end, last)

    def _series(self, number: int, quantity: Quantity, begin: int, end: int) -> Array:
        stage, cube = self._stages[number], quantity.cube
        if cube is not None and cube not in stage.bodies.cubes:
            return np.full(end - begin, np.nan)
        if cube is None:
            self._find_origins(number)
        elif cube not in stage.origins:
            stage.origins[cube] = self._first_place(cube)
        series = self._block(stage, begin, end).series(quantity)
        way = quantity.name.startswith("displacement") or (quantity.name == "distance" and self.bodies.target is None)
        return series * stage.share if cube is None and way else series

    def _block(self, stage: _Stage, begin: int, end: int) -> Block:
        rows = self.states[begin:end, stage.columns], np.zeros(end - begin), self.touches[begin:end, stage.columns]
        start = self.states[stage.first : stage.first + 1, stage.columns]
        return Block(stage.bodies, start, self.bodies.target, begin, *rows, stage.origins)

    def _centre(self, number: int, row: int, name: str = "position") -> Array:
        """Returns the body's centre of mass, or its velocity, in a row of a stage, array (3,)."""
        block = self._block(self._stages[number], row, row + 1)
        return np.array([block.series(Quantity(f"{name}.{axis}"))[0] for axis in "xyz"])

    def _find_origins(self, last: int) -> None:
        """Finds from where the displacement of the body is measured, array (1, 3), up to a stage."""
        for number, stage in enumerate(self._stages[: last + 1]):
            if None in stage.origins:
                continue
            here = self._centre(number, stage.first)
            if number:
                before, share = self._stages[number - 1], stage.share
                come = (self._centre(number - 1, stage.first - 1) - before.origins[None][0]) * before.share
                moved = self._centre(number, stage.first, "velocity") / self.bodies.tick_rate
                here = here - (come + moved * share) / share
            stage.origins[None] = here[np.newaxis]

    def _first_place(self, cube: str) -> Array:
        """Returns where a cube was when it was there first, array (1, 3)."""
        column = self.bodies.cubes.index(cube)
        row = next(stage.first for stage in self._stages if cube in stage.bodies.cubes)
        return self.states[row : row + 1, column, :3]
