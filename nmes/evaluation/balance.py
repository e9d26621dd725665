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

from nmes.backend import Array
from nmes.objective.trajectory import ObservedBodies
from nmes.world.fields import vector
from nmes.world.scenery import planet_list

__all__ = ["PART", "RISE", "Balance", "Excess"]

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


@dataclass(frozen=True, eq=False)
class Balance:
    """What the energy of some bodies follows from, besides their states.

    Attributes:
        bodies: The bodies, props included.
        gravity: m/s^2, array (3,).
        planets: Their centres, array (p, 3), m: where there are any, the nearest pulls as strongly as gravity would.
        stiffnesses: Of the springs, array (s,), N m/rad or N/m.
    """

    bodies: ObservedBodies
    gravity: Array
    planets: Array
    stiffnesses: Array

    @classmethod
    def of(cls, bodies: ObservedBodies, config: Mapping[str, Any], stiffnesses: Sequence[float]) -> Balance:
        """Returns the balance of bodies in a world of a complete config."""
        centres = [list(planet["Position"].values()) for planet in planet_list(config, 0)]
        gravity = np.array(vector(config["gravity"]))
        return cls(bodies, gravity, np.array(centres, float).reshape(-1, 3), np.array(stiffnesses, float))

    def excess(self, states: Array, powers: Array, positions: Array) -> Excess | None:
        """Returns where the body first gained more than it may; None if it never did.

        Args:
            states: In each row, shape (k, n, 13).
            powers: Mean power of each motor in the tick of each row, and its mean size, shape (k, 2, m), W.
            positions: Of the joints with springs, shape (k, s), rad or m.
        """
        rate, masses = self.bodies.tick_rate, self.bodies.masses
        sums = np.add.accumulate(powers, axis=2)[:, :, -1] if powers.shape[2] else np.zeros(powers.shape[:2])
        sums[0] = 0.0  # what they gave before the start
        work, effort = np.add.accumulate(sums, axis=0).T / rate
        energy = self._kinetic(states) + self._potential(states)
        energy = energy + (self.stiffnesses * positions * positions).sum(axis=1) / 2.0
        held = _highest(energy - work, max(1, round(_MOMENT * rate)))
        gain = held - np.minimum.accumulate(held)
        allowed = PART * effort + RISE * _GRAVITY * float(masses[: self.bodies.body].sum())
        broken = np.flatnonzero(~(gain <= allowed))
        if not len(broken):
            return None
        row = int(broken[0])
        return Excess(row / rate, float(gain[row]), float(allowed[row]))

    def _kinetic(self, states: Array) -> Array:
        velocity, masses = states[:, :, 7:10], self.bodies.masses
        a, b, c = (self.bodies.sizes * self.bodies.sizes).T
        moments = np.stack([b + c, a + c, a + b], axis=1) * masses[:, None] / 12.0
        spin = _own(states)
        return np.asarray(((masses[:, None] * velocity * velocity) + moments * spin * spin).sum(axis=(1, 2)) / 2.0)

    def _potential(self, states: Array) -> Array:
        """Returns the energy of the bodies' weight: gravity's, or that of the nearest planet, which pulls evenly."""
        gravity, masses, places = self.gravity, self.bodies.masses, states[:, :, 0:3]
        if not len(self.planets):
            return np.asarray(-(masses[:, None] * places * gravity).sum(axis=(1, 2)))
        away = places[:, :, None] - self.planets
        nearest = np.sqrt((away * away).sum(axis=3)).min(axis=2)
        return np.asarray((masses * nearest).sum(axis=1) * np.sqrt((gravity * gravity).sum()))


def _own(states: Array) -> Array:
    """Returns the angular velocities along the boxes' own axes, shape (k, n, 3)."""
    x, y, z, w = (states[:, :, i] for i in range(3, 7))
    a, b, c = (states[:, :, i] for i in range(10, 13))
    return np.stack(
        [
            a * (1.0 - 2.0 * (y * y + z * z)) + b * (2.0 * (x * y + w * z)) + c * (2.0 * (x * z - w * y)),
            a * (2.0 * (x * y - w * z)) + b * (1.0 - 2.0 * (x * x + z * z)) + c * (2.0 * (y * z + w * x)),
            a * (2.0 * (x * z + w * y)) + b * (2.0 * (y * z - w * x)) + c * (1.0 - 2.0 * (x * x + y * y)),
        ],
        axis=2,
    )


def _highest(values: Array, rows: int) -> Array:
    """Returns at each row the highest of so many values up to there."""
    padded = np.concatenate([np.full(rows - 1, -np.inf), values])
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, rows).max(axis=1))
