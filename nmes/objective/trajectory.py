"""The trajectory of an episode, and the quantities that objectives name, computed from it.

Hides the formulas behind `nmes.objective.QUANTITIES`. There are two ways to the same figures, bit for bit: a
`Trajectory` keeps every row and computes whatever is asked at the end, many rows at a time; `RunningQuantities` is told
each row as it comes and keeps only what its quantities need, for worlds that run for ever.

Invariants: row 0 is the start, and there is one row a tick. A quantity of a row depends on that row and the start alone
(but `time_upright`, which counts rows), and every sum is taken in order, so that how many rows are computed at a time
changes no bit.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from math import fsum
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from nmes.backend import Array, Contact
from nmes.backend.shapes import Shape, axis
from nmes.errors import WorldError
from nmes.objective.expression import Condition, Objective
from nmes.objective.quantities import Quantity

__all__ = [
    "UPRIGHT",
    "Block",
    "Flags",
    "ObservedBodies",
    "QuantityRows",
    "Rows",
    "RunningQuantities",
    "Trajectory",
    "beyond",
    "duty_of",
    "earliest",
    "in_order",
    "lengths",
    "touches",
]

Flags = npt.NDArray[np.bool_]

UPRIGHT: Final = 0.5  # uprightness from which on a body counts as upright


@dataclass(frozen=True, eq=False, slots=True)
class ObservedBodies:
    """The bodies that a trajectory is about: all that stays the same from row to row.

    Attributes:
        cubes: Ids, as expressions name them: those of the body first, then others that are named.
        body: How many of them are the body, 1 or more.
        sizes: Edge lengths, array (n, 3), m.
        masses: Array (n,), kg.
        tick_rate: Rows in a second.
        target: Where `distance` is measured from: a point, m, or the id of a cube; None: from the start.
        shapes: One each of `nmes.backend.shapes`; empty where all are boxes.
    """

    cubes: tuple[str, ...]
    body: int
    sizes: Array
    masses: Array
    tick_rate: int
    target: tuple[float, float, float] | str | None = None
    shapes: tuple[Shape, ...] = ()

    def columns(self, cube: str | None) -> slice:
        """Returns the columns of a cube, or of the body where `cube` is None.

        Raises:
            KeyError: No cube has that id.
        """
        if cube is None:
            return slice(0, self.body)
        if cube not in self.cubes:
            raise KeyError(cube)
        column = self.cubes.index(cube)
        return slice(column, column + 1)


class Rows(ABC):
    """What the quantities are row by row, and what becomes of them over the rows.

    Attributes:
        rows: How many rows are written.
    """

    rows: int

    @abstractmethod
    def series(self, quantity: Quantity, begin: int = 0, end: int | None = None) -> Array:
        """Returns a quantity row by row, array (end - begin,), whatever its fold.

        Args:
            quantity: What is asked.
            begin: The first row.
            end: The row after the last, or None for all that are written.
        """

    def values(self, quantities: Iterable[Quantity]) -> dict[Quantity, float]:
        """Returns the values of quantities over all rows that are written."""
        return {quantity: self._fold(quantity) for quantity in quantities}

    def _fold(self, quantity: Quantity) -> float:
        if quantity.fold in ("start", "final"):
            row = 0 if quantity.fold == "start" else self.rows - 1
            return float(self.series(quantity, row, row + 1)[0])
        series = self.series(quantity)
        if quantity.fold == "mean":
            return float(np.add.accumulate(series)[-1] / len(series))
        return float(series.min() if quantity.fold == "min" else series.max())

    def value(self, objective: Objective) -> float:
        """Returns an objective's value over all rows that are written.

        Raises:
            WorldError: `bad_expression`: it is no finite number.
        """
        return objective.value(self.values(objective.needs))

    def values_so_far(self, objective: Objective) -> Array:
        """Returns an objective's value at each row, over the rows up to there, array (rows,); NaN: no finite number."""
        columns = [self._so_far(quantity, 0, self.rows).tolist() for quantity in objective.needs]
        scores = np.full(self.rows, np.nan)
        for row in range(self.rows):
            values = dict(zip(objective.needs, [column[row] for column in columns], strict=True))
            with suppress(WorldError):
                scores[row] = objective.value(values)
        return scores

    def first(self, condition: Condition, begin: int, end: int) -> int | None:
        """Returns the first row at which a condition holds.

        Args:
            condition: It sees the episode as it was at that row; folds are over the rows up to there.
            begin: The first row to look at.
            end: The row after the last.
        """
        if begin >= end:
            return None
        columns = [self._so_far(quantity, begin, end).tolist() for quantity in condition.needs]
        rows = zip(*columns, strict=True) if columns else ((),) * (end - begin)
        for row, values in enumerate(rows, begin):
            if condition.holds(dict(zip(condition.needs, values, strict=True))):
                return row
        return None

    def _so_far(self, quantity: Quantity, begin: int, end: int) -> Array:
        if quantity.fold == "final":
            return self.series(quantity, begin, end)
        if quantity.fold == "start":
            return np.repeat(self.series(quantity, 0, 1), end - begin)
        series = self.series(quantity, 0, end)
        if quantity.fold == "mean":
            folded = np.add.accumulate(series) / np.arange(1, len(series) + 1)
        else:
            folded = (np.minimum if quantity.fold == "min" else np.maximum).accumulate(series)
        return folded[begin:]


class Trajectory(Rows):
    """The states, motor work and contacts of an episode, row by row.

    Whoever runs the episode writes the rows into the arrays and sets `rows`; nothing is computed until it is asked for.

    Attributes:
        bodies: The cubes that it is about.
        states: Array (rows, n, 13) of the states of the bodies, as `Simulation.states` has them.
        work: Array (rows, m): what each motor of the body has worked since the start, J; see `meter`.
        touches: Array (rows, n, 2), whether a cube touches anything, and anything that is not of the body; where no
            quantity of the episode is about contacts, it may have no rows.
        rows: How many rows are written.
    """

    def __init__(self, bodies: ObservedBodies, ticks: int, motors: int, *, contacts: bool = False) -> None:
        """Makes room for the start and so many ticks."""
        n = len(bodies.cubes)
        self.bodies = bodies
        self.states: Array = np.zeros((ticks + 1, n, 13))
        self.work: Array = np.zeros((ticks + 1, motors))
        self.touches: Flags = np.zeros((ticks + 1 if contacts else 0, n, 2), np.bool_)
        self.rows = 0
        self._watts: Array = np.zeros(motors)  # the sum of each motor's power over the rows of which the work is known

    def meter(self, begin: int, powers: Array) -> None:
        """Writes `work` of some rows, given what the motors gave; of all rows in order, many at a time or few.

        Args:
            begin: The first row.
            powers: The mean size of each motor's power in the tick of each row, shape (k, m), W.
        """
        powers = powers.copy()
        if begin == 0:
            powers[:1] = 0.0  # what they gave before the start
            self._watts = np.zeros(powers.shape[1])
        if len(powers):
            powers[0] += self._watts
            sums: Array = np.add.accumulate(powers)
            self._watts = sums[-1]
            self.work[begin : begin + len(sums)] = sums / self.bodies.tick_rate

    def series(self, quantity: Quantity, begin: int = 0, end: int | None = None) -> Array:
        """As `Rows.series`."""
        end = self.rows if end is None else end
        if quantity.name == "time_upright":
            upright = self.series(Quantity("uprightness"), 1, end) >= UPRIGHT
            return np.concatenate([[0.0], np.cumsum(upright) / self.bodies.tick_rate])[begin:end]
        work = in_order(self.work[begin:end])
        rows = self.states[begin:end], work, self.touches[begin:end]
        block = Block(self.bodies, self.states[:1], self.bodies.target, begin, *rows)
        return block.series(quantity)

    def duty(self) -> float:
        """Returns the duty factor of whatever the body goes on, from 0 to 1.

        Of its cubes that touch something outside it at all, the part of the rows after the start in which each does,
        and of these parts the mean; 0 where none does. What a leg's duty factor is in works on gaits, of all feet.
        """
        return duty_of(self.touches[1 : self.rows, : self.bodies.body, 1].sum(axis=0).tolist(), self.rows - 1)

    def first_beyond(self, begin: int, end: int, **limits: float) -> tuple[int, str] | None:
        """Returns the first row at which the body is beyond a limit, and which: the first of those that `beyond` names.

        Args:
            begin: The first row to look at.
            end: The row after the last.
            limits: As `beyond` takes them.
        """
        flagged = beyond(self.bodies, self.states[begin:end], self.work[begin:end], **limits)
        return earliest(flagged, begin)


class RunningQuantities:
    """The quantities of a world that runs for ever: no row is kept but the start.

    Args:
        bodies: The cubes that it is about.
        quantities: What will be asked.
        states: At the start, array (n, 13).
        touches: At the start, array (n, 2); as in `Trajectory`.
    """

    def __init__(self, bodies: ObservedBodies, quantities: Iterable[Quantity], states: Array, touches: Flags) -> None:
        self.bodies = bodies
        self.ticks = 0
        """Rows that came after the start."""
        self._quantities = tuple(quantities)
        self._start = states
        self._upright = 0
        self._counts = any(quantity.name == "time_upright" for quantity in self._quantities)
        self._folds = {quantity: 0.0 for quantity in self._quantities if quantity.fold != "final"}
        self.watches = self._counts or any(quantity.fold != "start" for quantity in self._folds)
        """Whether it must be told every row; else only how many ticks have passed."""
        if self._folds:
            row = self._row(states, np.zeros(0), touches)
            self._folds = {quantity: self._now(quantity, row) for quantity in self._folds}

    def add(self, states: Array, work: Array, touches: Flags) -> None:
        """Takes the row of the next tick.

        Args:
            states: Array (n, 13).
            work: Of each of the body's motors since the start, array (m,), J.
            touches: Array (n, 2); as in `Trajectory`.
        """
        self.ticks += 1
        row = self._row(states, work, touches)
        if self._counts and row.series(Quantity("uprightness"))[0] >= UPRIGHT:
            self._upright += 1
        for quantity, before in self._folds.items():
            now = self._now(quantity, row)
            if quantity.fold == "mean":  # the sum, until somebody asks
                self._folds[quantity] = before + now
            elif quantity.fold != "start":
                self._folds[quantity] = min(before, now) if quantity.fold == "min" else max(before, now)

    def values(self, states: Array, work: Array, touches: Flags) -> dict[Quantity, float]:
        """Returns the values of the quantities, with `states`, `work` and `touches` as they are now (see `add`)."""
        row = self._row(states, work, touches)
        values = {}
        for quantity in self._quantities:
            if quantity.fold == "final":
                values[quantity] = self._now(quantity, row)
            else:
                values[quantity] = self._folds[quantity] / (self.ticks + 1 if quantity.fold == "mean" else 1)
        return values

    def _row(self, states: Array, work: Array, touches: Flags) -> Block:
        rows = states[np.newaxis], in_order(work[np.newaxis]), touches[np.newaxis]
        return Block(self.bodies, self._start[np.newaxis], self.bodies.target, self.ticks, *rows)

    def _now(self, quantity: Quantity, row: Block) -> float:
        if quantity.name == "time_upright":
            return self._upright / self.bodies.tick_rate
        return float(row.series(quantity)[0])

    def state(self) -> dict[str, object]:
        """Returns the sums and extremes so far as plain JSON data, for `resume`."""
        return {
            "start": self._start.tolist(),
            "ticks": self.ticks,
            "upright": self._upright,
            "folds": list(self._folds.values()),
        }

    def resume(self, state: Mapping[str, object]) -> None:
        """Goes on from the `state` of another one of the same quantities."""
        self._start = np.array(state["start"], np.float64).reshape(-1, 13)
        ticks, upright, folds = state["ticks"], state["upright"], state["folds"]
        assert isinstance(ticks, int) and isinstance(upright, int) and isinstance(folds, Sequence)
        self.ticks, self._upright = ticks, upright
        self._folds = dict(zip(self._folds, map(float, folds), strict=True))


class QuantityRows:
    """The quantities of many episodes of the same bodies that go on in step, each from a start of its own.

    Args:
        bodies: The cubes that they are about; the target is each episode's own.
        quantities: What will be asked.
        count: The number of places for episodes.
    """

    def __init__(self, bodies: ObservedBodies, quantities: Iterable[Quantity], count: int) -> None:
        self.bodies, self._quantities = bodies, tuple(quantities)
        n = len(bodies.cubes)
        self._starts: Array = np.zeros((count, n, 13))
        self._targets: Array | str | None = np.zeros((count, 3)) if isinstance(bodies.target, tuple) else bodies.target
        self._ticks, self._upright = np.zeros(count), np.zeros(count)
        self._origins: dict[str | None, Array] = {}
        self._folds = {quantity: np.zeros(count) for quantity in self._quantities if quantity.fold != "final"}

    def begin(
        self, place: int, states: Array, touches: Flags, target: tuple[float, float, float] | str | None
    ) -> dict[Quantity, float]:
        """Begins an episode in a place, whatever was there; returns the values of the quantities at its start.

        Args:
            place: Which.
            states: At the start, array (n, 13).
            touches: At the start, array (n, 2), or without rows; as in `Trajectory`.
            target: As in `ObservedBodies`.
        """
        self._starts[place], self._ticks[place], self._upright[place] = states, 0.0, 0.0
        self._origins.clear()
        if isinstance(self._targets, np.ndarray):
            self._targets[place] = target
        rows = states[np.newaxis], np.zeros(1), touches[np.newaxis]
        block = Block(self.bodies, self._starts[place : place + 1], target, 0, *rows)
        values = {
            quantity: 0.0 if quantity.name == "time_upright" else float(block.series(quantity)[0])
            for quantity in self._quantities
        }
        for quantity, fold in self._folds.items():
            fold[place] = values[quantity]
        return values

    def add(self, states: Array, work: Array, touches: Flags) -> dict[Quantity, Array]:
        """Takes the rows of the next tick, and returns the values of the quantities, each an array (count,).

        Args:
            states: Array (count, n, 13).
            work: Of each of the bodies' motors since the start, array (count, m), J.
            touches: Array (count, n, 2), or (count, 0, 2); as in `Trajectory`.
        """
        self._ticks += 1.0
        rows = states, in_order(work), touches
        block = Block(self.bodies, self._starts, self._targets, self._ticks, *rows, self._origins)
        if any(quantity.name == "time_upright" for quantity in self._quantities):
            self._upright += block.series(Quantity("uprightness")) >= UPRIGHT
        values = {}
        for quantity in self._quantities:
            upright = quantity.name == "time_upright"
            now = self._upright / self.bodies.tick_rate if upright else block.series(quantity)
            values[quantity] = now if quantity.fold == "final" else self._folded(quantity, now)
        return values

    def _folded(self, quantity: Quantity, now: Array) -> Array:
        fold = self._folds[quantity]
        if quantity.fold == "mean":
            fold += now
            return fold / (self._ticks + 1.0)
        if quantity.fold == "min":
            np.minimum(fold, now, out=fold)
        elif quantity.fold == "max":
            np.maximum(fold, now, out=fold)
        return fold.copy()


def duty_of(counts: Sequence[int], ticks: int) -> float:
    """Returns the duty factor where each cube of a body touched something outside it at so many of the ticks."""
    feet = [count for count in counts if count]
    return fsum(feet) / (len(feet) * ticks) if feet else 0.0


class HasContacts(Protocol):
    """A scene that tells what a body touches: a `Simulation`, or one of many rows."""

    def contacts(self, body: int) -> list[Contact]:
        """Returns the contacts of a body, as `Simulation.contacts`."""


def touches(simulation: HasContacts, bodies: Sequence[int], body: int) -> Flags:
    """Returns a row of `Trajectory.touches`, array (n, 2).

    Args:
        simulation: The scene.
        bodies: The cubes' numbers in the engine.
        body: How many of them, from the first on, are the body.
    """
    own = set(bodies[:body])
    partners = [[contact.other for contact in simulation.contacts(number)] for number in bodies]
    return np.array([(bool(others), any(other not in own for other in others)) for others in partners]).reshape(-1, 2)


def beyond(
    bodies: ObservedBodies, states: Array, work: Array, *, energy: float, speed: float, spin: float, size: float
) -> dict[str, Flags]:
    """Returns in which rows a body is beyond each limit, arrays (k,), energy before speed before spin before size.

    Args:
        bodies: What the rows are about.
        states: Array (k, n, 13).
        work: Array (k, m), as `Trajectory.work`.
        energy: Work of its motors, J.
        speed: Of the centre of each of its cubes, m/s.
        spin: Of each of its cubes, rad/s.
        size: From its centre of mass to the centre of each of its cubes, m.
    """
    body = bodies.columns(None)
    flags: dict[str, Flags] = {"energy": np.asarray(in_order(work) > energy)}
    for name, limit, first in (("speed", speed, 7), ("spin", spin, 10)):
        # What is no number is beyond every limit.
        flags[name] = np.asarray(~(lengths(states[:, body, first : first + 3]) <= limit).all(axis=1))
    places = states[:, body, :3]
    away = lengths(places - _centre(places, bodies.masses[body])[:, np.newaxis])
    return flags | {"size": np.asarray(~(away <= size).all(axis=1))}


def earliest(flagged: Mapping[str, Flags], begin: int) -> tuple[int, str] | None:
    """Returns the first row with a flag, of rows from `begin` on, and the name of the first flag that it has."""
    rows = [(begin + int(flags.argmax()), name) for name, flags in flagged.items() if flags.any()]
    return min(rows, key=lambda row: row[0], default=None)


# -- formulas ---------------------------------------------------------------------------------------------------------


def in_order(values: Array) -> Array:
    """Sums over the last axis from left to right: how numpy's own sum is grouped depends on the array's shape."""
    if not values.shape[-1]:
        return np.zeros(values.shape[:-1])
    sums: Array = np.add.accumulate(values, axis=-1)
    return sums[..., -1]


def lengths(vectors: Array) -> Array:
    """Returns the lengths of vectors, shape (..., 3), by one order of additions for any shape."""
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return np.sqrt(x * x + y * y + z * z)


def _centre(vectors: Array, masses: Array) -> Array:
    """Returns the mean of vectors, (k, n, 3), weighted by mass, (k, 3)."""
    if len(masses) == 1:
        return vectors[:, 0]
    weights = masses / in_order(masses)
    sums: Array = np.add.accumulate(vectors * weights[:, np.newaxis], axis=1)
    return sums[:, -1]


@dataclass(eq=False, slots=True)
class Block:
    """Some rows: `states` (k, n, 13), `work` (k,), `touches` (k, n, 2).

    Of one episode in a row, `start` being (1, n, 13) and `number` that of the first; or each of another, with a start
    and a number of its own, (k, n, 13) and (k,), and a target too if it is a point, (k, 3).
    """

    bodies: ObservedBodies
    start: Array
    target: Array | tuple[float, float, float] | str | None
    number: Array | int
    states: Array
    work: Array
    touches: Flags
    origins: dict[str | None, Array] = field(default_factory=dict)  # of cubes and the body, at the start
    _centres: dict[str | None, Array] = field(default_factory=dict)

    def series(self, quantity: Quantity) -> Array:
        """Returns a quantity of each row."""
        name, _, axis = quantity.name.partition(".")
        columns = self.bodies.columns(quantity.cube)
        match name:
            case "time":
                first = self.number
                numbers = np.arange(first, first + len(self.states)) if isinstance(first, int) else first
                return numbers / self.bodies.tick_rate
            case "energy" | "work":
                return self.work
            case "cubes" | "mass":
                masses = self.bodies.masses[columns]
                value = float(len(masses)) if name == "cubes" else float(in_order(masses))
                return np.full(len(self.states), value)
            case "grown":
                return np.zeros(len(self.states))  # of a body that keeps its parts; see `ChangingTrajectory`
            case "contacts":
                count: Array = self.touches[:, columns, 0 if quantity.cube is not None else 1].sum(
                    axis=1, dtype=np.float64
                )
                return count
            case "uprightness":
                x, z = self.states[:, columns.start, 3], self.states[:, columns.start, 5]
                return 1.0 - 2.0 * (x * x + z * z)
            case "lowest" | "highest" | "reach":
                return self._extent(name, columns, quantity.cube)
            case "velocity" | "speed":
                vectors = self._mean(self.states, columns, 7)
            case "position" | "height":
                vectors, axis = self._centre(quantity.cube), axis or "y"
            case "displacement" | "distance":
                vectors = self._centre(quantity.cube)
                aim = self.target if name == "distance" else None
                if aim is None:
                    if quantity.cube not in self.origins:
                        self.origins[quantity.cube] = self._mean(self.start, columns, 0)
                    vectors = vectors - self.origins[quantity.cube]
                else:
                    vectors = vectors - (self._centre(aim) if isinstance(aim, str) else np.array(aim))
            case _:
                raise KeyError(name)
        if axis == "horizontal":
            vectors = vectors * np.array([1.0, 0.0, 1.0])
        return lengths(vectors) if axis in ("", "horizontal") else vectors[:, "xyz".index(axis)]

    def _centre(self, cube: str | None) -> Array:
        """Returns the centre of mass of a cube or the body in each row, (k, 3)."""
        if cube not in self._centres:
            self._centres[cube] = self._mean(self.states, self.bodies.columns(cube), 0)
        return self._centres[cube]

    def _mean(self, states: Array, columns: slice, first: int) -> Array:
        """Returns the mean, weighted by mass, of a vector that begins at number `first` of each state, (k, 3)."""
        return _centre(states[:, columns, first : first + 3], self.bodies.masses[columns])

    def _extent(self, name: str, columns: slice, cube: str | None) -> Array:
        states, halves = self.states[:, columns], self.bodies.sizes[columns] / 2.0
        if name != "reach":
            x, y, z, w = (states[:, :, i] for i in range(3, 7))
            # How far a turned box reaches up and down from its centre: its half edges along the world's y axis.
            rises = [
                np.abs(each) for each in (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x))
            ]
            up = rises[0] * halves[:, 0]
            up += rises[1] * halves[:, 1]
            up += rises[2] * halves[:, 2]
            middle = states[:, :, 1]
            for column, lies, radius, half, ball in self._rounds(columns):
                along = rises[lies][:, column]
                across = radius if ball else radius * np.sqrt(np.maximum(1.0 - along * along, 0.0))
                up[:, column] = along * half + across
            end: Array = np.min(middle - up, axis=1) if name == "lowest" else np.max(middle + up, axis=1)
            return end
        # The arm from the centre in the box's own axes; its farthest corner lies beyond its centre along each of them.
        a, b, c = (states[:, :, i] - self._centre(cube)[:, i : i + 1] for i in range(3))
        x, y, z, w = np.ascontiguousarray(np.moveaxis(states[:, :, 3:7], 2, 0))
        xx, yy, zz, xy, xz, yz, wx, wy, wz = x * x, y * y, z * z, x * y, x * z, y * z, w * x, w * y, w * z
        u = np.abs(a * (1.0 - 2.0 * (yy + zz)) + b * (2.0 * (xy + wz)) + c * (2.0 * (xz - wy))) + halves[:, 0]
        v = np.abs(a * (2.0 * (xy - wz)) + b * (1.0 - 2.0 * (xx + zz)) + c * (2.0 * (yz + wx))) + halves[:, 1]
        t = np.abs(a * (2.0 * (xz + wy)) + b * (2.0 * (yz - wx)) + c * (1.0 - 2.0 * (xx + yy))) + halves[:, 2]
        reaches = np.sqrt(u * u + v * v + t * t)
        for column, lies, radius, half, ball in self._rounds(columns):
            arm = [each[:, column] - edges[column] for each, edges in zip((u, v, t), halves.T, strict=True)]
            beyond, aside, off = arm[lies] + half, arm[lies - 1], arm[lies - 2]
            wide = np.sqrt(aside * aside + off * off)
            if ball:
                reaches[:, column] = np.sqrt(beyond * beyond + wide * wide) + radius
            else:
                reaches[:, column] = np.sqrt(beyond * beyond + (wide + radius) * (wide + radius))
        farthest: Array = np.max(reaches, axis=1)
        return farthest

    def _rounds(self, columns: slice) -> Iterator[tuple[int, int, float, float, bool]]:
        """Yields column, axis, radius (m) and half length (m) of each round cube, and whether it ends in balls.

        The length is then from the middle of one ball to that of the other.
        """
        for column, shape in enumerate(self.bodies.shapes[columns]):
            if shape != "box":
                size = self.bodies.sizes[columns][column].tolist()
                lies = axis(size)
                radius, half, ball = size[lies - 1] / 2.0, size[lies] / 2.0, shape != "cylinder"
                yield column, lies, radius, half - radius if ball else half, ball
