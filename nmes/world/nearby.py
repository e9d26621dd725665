"""Which of some bodies are near a place, and how far: what a creature sees of others, and whom it hears.

Hides that all asked in one moment share one reading of the engine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from math import inf
from typing import NamedTuple

import numpy as np

from nmes.backend import Array, Vector
from nmes.world.entities import Entities

__all__ = ["Nearby", "Neighbour"]


class Neighbour(NamedTuple):
    """A body that is near: its number in the engine, how far it is (m), where it is (m) and how it moves (m/s)."""

    body: int
    distance: float
    position: Vector
    velocity: Vector


class Nearby:
    """Some bodies of a world, by their distances from a place.

    Args:
        entities: Whose bodies they are.
        bodies: Returns their numbers: of those equally far the first comes first.
    """

    def __init__(self, entities: Entities, bodies: Callable[[], list[int]]) -> None:
        self._entities, self._list = entities, bodies
        self._moment: tuple[int, int] | None = None
        self._bodies: list[int] = []
        self._rows: dict[int, int] = {}
        self._states: Array = np.empty((0, 13))

    def forget(self) -> None:
        """Forgets what was read, since there are other bodies than there were."""
        self._moment = None

    def nearest(self, place: Vector, within: float = inf, but: Iterable[int] = ()) -> Neighbour | None:
        """Returns the body whose centre is nearest to a place; None where there is none.

        Args:
            place: The place, m.
            within: How far it may be, m.
            but: Bodies that do not count.
        """
        distances = self._distances(place, but)
        if not len(distances):
            return None
        row = int(distances.argmin())
        distance = float(distances[row])
        return self._neighbour(row, distance) if distance <= within and distance < inf else None

    def all(
        self, place: Vector, within: float = inf, but: Iterable[int] = (), most: int | None = None
    ) -> list[Neighbour]:
        """Returns all bodies that are so near to a place, the nearest first, or so many of them; as `nearest` else."""
        distances = self._distances(place, but)
        near = np.flatnonzero((distances <= within) & (distances < inf))
        rows = near[distances[near].argsort(kind="stable")][:most].tolist()  # those of equally far ones stay in order
        states = self._states[rows].tolist()
        return [
            Neighbour(self._bodies[row], distance, (x, y, z), (vx, vy, vz))
            for row, distance, (x, y, z, _, _, _, _, vx, vy, vz, _, _, _) in zip(
                rows, distances[rows].tolist(), states, strict=True
            )
        ]

    def _neighbour(self, row: int, distance: float) -> Neighbour:
        x, y, z = self._states[row, :3].tolist()
        vx, vy, vz = self._states[row, 7:10].tolist()
        return Neighbour(self._bodies[row], distance, (x, y, z), (vx, vy, vz))

    def _distances(self, place: Vector, but: Iterable[int]) -> Array:
        """Returns how far each body is, m; infinitely far those that do not count."""
        moment = self._entities.moments, self._entities.edits  # another whenever a body may have come, gone or moved
        if self._moment != moment:
            self._bodies = self._list()
            self._rows = {body: row for row, body in enumerate(self._bodies)}
            self._states = self._entities.simulation.states(self._bodies)
            self._moment = moment
        x, y, z = (self._states[:, :3] - place).T
        # Of roots and products alone, in one order: the same bits on every machine.
        distances: Array = np.sqrt(x * x + y * y + z * z)
        for body in but:
            row = self._rows.get(body)
            if row is not None:
                distances[row] = inf
        return distances
