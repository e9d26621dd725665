"""The energy balance of an episode: what a body gained beyond what its motors gave it.

Hides the formulas of kinetic energy, of weight, of springs, and where the line is drawn. A body's mechanical energy
less the work of its motors can only fall, by friction, impacts and dampers; where it rises the solver has made energy
of nothing. It is held against the lowest that it ever was, so that nobody falls far in order to be flung again.

Contacts and limits give way like stiff springs, in which energy is for some hundredths of a second: so what counts at a
tick is the most within the last tenth of a second.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from nmes.backend import Array, Places
from nmes.backend.medium import Immersion
from nmes.backend.shapes import Shape, moments
from nmes.objective.trajectory import ObservedBodies
from nmes.world.fields import vector
from nmes.world.scenery import medium_of, planet_list

__all__ = ["PART", "RISE", "Balance", "BalanceRows", "Excess"]

PART: Final = 0.01
"""What part of its motors' work, counted without signs, a body may gain beyond it: too little to buy by shaking."""
RISE: Final = 0.05
"""By how much more: the energy that lifts the body by so many metres at 9.81 m/s^2."""
_GRAVITY = 9.81
_MOMENT = 0.1  # s for which contacts may hold energy


@dataclass(frozen=True, slots=True)
class Excess:
    """The first tick at which a body had gained more than it may.

    Attributes:
        time: s since the start.
        gain: Energy beyond the work of the motors, J.
        allowed: How much it might have been, J.
    """

    time: float
    gain: float
    allowed: float

    def __str__(self) -> str:
        """Returns it in words."""
        return (
            f"energy: by {self.time:.2f} s the body had {self.gain:.3g} J that its motors did not give it, and "
            f"{self.allowed:.3g} J are allowed"
        )


@dataclass(frozen=True, eq=False)
class Balance:
    """What the energy of some bodies follows from, besides their states.

    Attributes:
        bodies: The bodies, props included.
        gravity: m/s^2, array (3,).
        planets: Their centres, array (p, 3), m: where there are any, the nearest pulls as strongly as gravity would.
        stiffnesses: Of the springs, array (s,), N m/rad or N/m.
        immersion: The bodies in the medium that is about them, if there is one: it lifts them, and else only slows.
    """

    bodies: ObservedBodies
    gravity: Array
    planets: Array
    stiffnesses: Array
    immersion: Immersion | None = None

    @classmethod
    def of(cls, bodies: ObservedBodies, config: Mapping[str, Any], stiffnesses: Sequence[float]) -> Balance:
        """Returns the balance of bodies in a world of a complete config."""
        centres = [list(planet["Position"].values()) for planet in planet_list(config, 0)]
        gravity = np.array(vector(config["gravity"]))
        springs = np.array(stiffnesses, float)
        return cls(bodies, gravity, np.array(centres, float).reshape(-1, 3), springs, _immersion(bodies, config))

    def excess(self, states: Array, powers: Array, positions: Array) -> Excess | None:
        """Returns where the body first gained more than it may; None if it never did.

        Args:
            states: In each row, shape (k, n, 13).
            powers: Mean power of each motor in the tick of each row, and its mean size, shape (k, 2, m), W.
            positions: Of the joints with springs, shape (k, s), rad or m.
        """
        return self.excess_of(self.energy(states, positions), powers, self.rise)

    def excess_of(self, energy: Array, powers: Array, rise: float) -> Excess | None:
        """Returns the same, of a body whose energy in each row is known, shape (k,), J, as is its `rise`."""
        gain, allowed = self._gains(energy, powers, rise)
        broken = np.flatnonzero(~(gain <= allowed))
        if not len(broken):
            return None
        row = int(broken[0])
        return Excess(row / self.bodies.tick_rate, float(gain[row]), float(allowed[row]))

    def gains(self, states: Array, powers: Array, positions: Array) -> tuple[Array, Array]:
        """Returns the energy that the body gained beyond its motors' work at each row, and the bound, each (k,), J.

        The arguments are those of `excess`.
        """
        return self._gains(self.energy(states, positions), powers, self.rise)

    def free(self, states: Array, powers: Array, positions: Array) -> Array:
        """Returns the energy less the work of the motors since the start in each row, shape (k,), J.

        The arguments are those of `excess`.
        """
        return np.asarray(self.energy(states, positions) - self._work(powers)[0])

    def _work(self, powers: Array) -> Array:
        """Returns the work of the motors up to each row, and how much it was without signs, shape (2, k), J."""
        sums = _sums(powers)
        sums[0] = 0.0  # what they gave before the start
        return np.asarray(np.add.accumulate(sums, axis=0).T / self.bodies.tick_rate)

    def _gains(self, energy: Array, powers: Array, rise: float) -> tuple[Array, Array]:
        work, effort = self._work(powers)
        held = _highest(energy - work, self.moment)
        return held - np.minimum.accumulate(held), PART * effort + rise

    @property
    def moment(self) -> int:
        """The number of ticks for which contacts may hold energy."""
        return max(1, round(_MOMENT * self.bodies.tick_rate))

    @property
    def rise(self) -> float:
        """What a body may gain however little its motors work, J."""
        return RISE * _GRAVITY * float(self.bodies.masses[: self.bodies.body].sum())

    def energy(self, states: Array, positions: Array) -> Array:
        """Returns the mechanical energy in each row, shape (k,), J; the arguments are those of `excess`."""
        # Of rows of some size, numbers that lie side by side are computed with several times faster.
        columns = np.ascontiguousarray(np.moveaxis(states, 2, 0))
        energy = self._kinetic(columns) + self._potential(columns)
        if self.immersion is not None:
            energy = energy + self.immersion.potentials(columns).sum(axis=1)
        return np.asarray(energy + (self.stiffnesses * positions * positions).sum(axis=1) / 2.0)

    def kinetic(self, states: Array) -> Array:
        """Returns the kinetic energy of each body in each row, shape (k, n), J, from states, shape (k, n, 13)."""
        return np.asarray(self._motion(np.ascontiguousarray(np.moveaxis(states, 2, 0))).sum(axis=2) / 2.0)

    def _kinetic(self, columns: Array) -> Array:
        return np.asarray(self._motion(columns).sum(axis=(1, 2)) / 2.0)

    def _motion(self, columns: Array) -> Array:
        """Returns twice the kinetic energy of each body along each of its axes, shape (k, n, 3), J."""
        masses = self.bodies.masses
        a, b, c = (self.bodies.sizes * self.bodies.sizes).T
        own = np.stack([b + c, a + c, a + b], axis=1) * masses[:, None] / 12.0
        for row, shape in enumerate(self.bodies.shapes):
            if shape != "box":
                own[row] = masses[row] * np.array(moments(shape, tuple(self.bodies.sizes[row].tolist())))
        each = np.empty((*columns.shape[1:], 3))
        for axis, (velocity, spin) in enumerate(zip(columns[7:10], _own(columns), strict=True)):
            np.add(masses * velocity * velocity, own[:, axis] * spin * spin, out=each[..., axis])
        return each

    def _potential(self, columns: Array) -> Array:
        """Returns the energy of the bodies' weight: gravity's, or that of the nearest planet, which pulls evenly."""
        gravity, masses, places = self.gravity, self.bodies.masses, np.moveaxis(columns[0:3], 0, 2)
        if not len(self.planets):
            each = np.empty((*columns.shape[1:], 3))
            for axis in range(3):
                np.multiply(masses * columns[axis], gravity[axis], out=each[..., axis])
            return np.asarray(-each.sum(axis=(1, 2)))
        away = places[:, :, None] - self.planets
        nearest = np.sqrt((away * away).sum(axis=3)).min(axis=2)
        return np.asarray((masses * nearest).sum(axis=1) * np.sqrt((gravity * gravity).sum()))


class BalanceRows:
    """The balance of many episodes of the same bodies that go on in step, a block of ticks at a time.

    Each comes out as `Balance.excess` of all of its rows would.

    Args:
        balance: Of any of them.
        count: The number of places for episodes.
    """

    def __init__(self, balance: Balance, count: int) -> None:
        self._balance = balance
        # Of all blocks before: sums of powers (W), what was held in the last ticks, and the least that was ever held.
        self._sums, self._held = np.zeros((count, 2)), np.full((count, balance.moment), -np.inf)
        self._least = np.full(count, np.inf)
        self._excess: dict[int, Excess] = {}

    def begin(self, place: int, energy: float) -> None:
        """Begins an episode in a place, with so much energy (J) at its start."""
        self._sums[place], self._held[place], self._least[place] = 0.0, -np.inf, energy
        self._held[place, -1] = energy
        self._excess.pop(place, None)

    def take(self, states: Array, powers: Array, positions: Array, ticks: Places) -> None:
        """Takes the next rows of all places.

        Args:
            states: Shape (k, places, n, 13), as by `excess`; before its start, an episode is as it is at the start.
            powers: Shape (k, places, 2, m); zero before the start.
            positions: Shape (k, places, s).
            ticks: The number of the last row in each place, shape (places,).
        """
        everybody = np.arange(len(self._least))
        self._excess = self.excesses(everybody, states, powers, positions, ticks, keep=True)

    def excesses(
        self, places: Places, states: Array, powers: Array, positions: Array, ticks: Places, *, keep: bool = False
    ) -> dict[int, Excess]:
        """Returns, of those places where a body gained more than it may, the first tick at which it had.

        Args:
            places: Which; the arrays are of these alone.
            states: As by `take`.
            powers: As by `take`.
            positions: As by `take`.
            ticks: As by `take`.
            keep: Whether other rows come after these.
        """
        balance, rate, rows = self._balance, self._balance.bodies.tick_rate, len(states)
        excess = {place: self._excess[place] for place in places.tolist() if place in self._excess}
        if not rows or not len(places):
            return excess
        count = rows * len(places)
        flat = states.reshape(count, *states.shape[2:]), positions.reshape(count, positions.shape[2])
        energy = balance.energy(*flat).reshape(rows, -1)
        sums = np.add.accumulate(np.concatenate([self._sums[places][None], _sums(powers)]), axis=0)
        work = sums[1:] / rate
        free = np.concatenate([self._held[places].T, energy - work[..., 0]])
        held = np.lib.stride_tricks.sliding_window_view(free[1:], balance.moment, axis=0).max(axis=-1)
        least = np.minimum.accumulate(np.concatenate([self._least[places][None], held]), axis=0)
        gain, allowed = held - least[1:], PART * work[..., 1] + balance.rise
        broken = ~(gain <= allowed)
        for column in np.flatnonzero(broken.any(axis=0)).tolist():
            row = int(broken[:, column].argmax())
            time = (int(ticks[column]) - (rows - 1 - row)) / rate
            found = Excess(time, float(gain[row, column]), float(allowed[row, column]))
            excess.setdefault(int(places[column]), found)
        if keep:
            self._sums[places], self._held[places], self._least[places] = sums[-1], free[-balance.moment :].T, least[-1]
        return excess


def _immersion(bodies: ObservedBodies, config: Mapping[str, Any]) -> Immersion | None:
    medium = medium_of(config)
    if medium is None:
        return None
    sizes = [(x, y, z) for x, y, z in bodies.sizes.tolist()]
    shapes: list[Shape] = [*bodies.shapes]
    shapes += ["box"] * (len(sizes) - len(shapes))
    return Immersion(medium, vector(config["gravity"]), 1.0 / config["tick_rate"], shapes, sizes, bodies.masses)


def _sums(powers: Array) -> Array:
    """Returns the sums of motors' powers, over the last axis from left to right."""
    return np.add.accumulate(powers, axis=-1)[..., -1] if powers.shape[-1] else np.zeros(powers.shape[:-1])


def _own(columns: Array) -> tuple[Array, Array, Array]:
    """Returns the angular velocities along the boxes' own axes, each of shape (k, n), from states, shape (13, k, n)."""
    x, y, z, w = columns[3:7]
    a, b, c = columns[10:13]
    xx, yy, zz, xy, xz, yz, wx, wy, wz = x * x, y * y, z * z, x * y, x * z, y * z, w * x, w * y, w * z
    return (
        a * (1.0 - 2.0 * (yy + zz)) + b * (2.0 * (xy + wz)) + c * (2.0 * (xz - wy)),
        a * (2.0 * (xy - wz)) + b * (1.0 - 2.0 * (xx + zz)) + c * (2.0 * (yz + wx)),
        a * (2.0 * (xz + wy)) + b * (2.0 * (yz - wx)) + c * (1.0 - 2.0 * (xx + yy)),
    )


def _highest(values: Array, rows: int) -> Array:
    """Returns at each row the highest of so many values up to there."""
    padded = np.concatenate([np.full(rows - 1, -np.inf), values])
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, rows).max(axis=1))
