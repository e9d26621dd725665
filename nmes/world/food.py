"""The food of an ecosystem: points on the ground that grow, are smelled, and are eaten.

Hides where the next one grows. Food is no body: it costs an engine nothing, and nobody stumbles over it. Invariants:
where the n-th grows follows from the world's seed and n alone; there is never more than the config allows.
"""

from __future__ import annotations

from math import cos, pi, sin, sqrt
from typing import TYPE_CHECKING

import numpy as np

from nmes.backend import Array, Vector
from nmes.schemas.documents import JsonObject
from nmes.variation import Draw
from nmes.world.snapshot import pack_array, unpack_array

if TYPE_CHECKING:
    from nmes.world.entities import Entities

__all__ = ["Food", "nearest"]


def nearest(places: Array, position: Vector) -> tuple[int, float] | None:
    """Returns which of some places (n, 3) is nearest to a position, and how far it is, m; None where there is none."""
    if not len(places):
        return None
    apart = places - np.array(position)
    squares = apart[:, 0] * apart[:, 0] + apart[:, 1] * apart[:, 1] + apart[:, 2] * apart[:, 2]
    place = int(squares.argmin())
    return place, sqrt(float(squares[place]))


class Food:
    """All food of a world.

    Args:
        config: `life/food` of the world's config, complete.
        entities: On whose ground it grows, and whose creatures smell it.
        planar: Whether it grows in the plane z = 0 alone.

    Attributes:
        items: What there is, the oldest first, array (n, 4): x, y, z (m), and energy (J). To be read only.
        grown: How many ever grew.
    """

    def __init__(self, config: JsonObject, entities: Entities, planar: bool) -> None:
        self._config, self._entities, self._planar = config, entities, planar
        self._areas = [place["radius"] ** 2 for place in config["places"]]
        self.items = np.empty((0, 4))
        self.grown = 0
        self._show()

    def _show(self) -> None:
        self._entities.food = self.items[:, :3]

    def grow(self, frame: int) -> None:
        """Lets grow what is due in a tick; what finds no room is lost."""
        rate = self._config["rate"] / self._entities.tick_rate
        for _ in range(self._config["start"] if frame == 1 else 0):
            self._grow_one()
        for _ in range(int(frame * rate) - int((frame - 1) * rate)):
            self._grow_one()

    def _grow_one(self) -> None:
        self.grown += 1
        self.put(self.somewhere(Draw(self._entities.seed, "food", self.grown)), self._config["energy"])

    def somewhere(self, draw: Draw) -> Vector:
        """Draws a point of the ground where food grows, m."""
        place = draw.one_of(self._config["places"], self._areas)
        far, bearing = place["radius"] * sqrt(draw.uniform(0.0, 1.0)), draw.uniform(-pi, pi)
        x, z = place["position"]
        return self._entities.terrain.surface(x + far * cos(bearing), 0.0 if self._planar else z - far * sin(bearing))

    def put(self, place: Vector, energy: float) -> bool:
        """Puts food somewhere; returns False where there is too much already."""
        if len(self.items) >= self._config["most"]:
            return False
        self.items = np.append(self.items, [[*place, energy]], axis=0)
        self._show()
        return True

    def eat(self, mouths: Array) -> list[tuple[int, Vector, float]]:
        """Has everybody whose mouth reaches some eat the nearest, one after another.

        Args:
            mouths: Where they are, array (k, 3), m.

        Returns:
            Of each meal who has it, where it was, and its energy, J.
        """
        if not len(self.items):
            return []
        apart = mouths[:, None] - self.items[None, :, :3]
        near = (apart * apart).sum(axis=2).min(axis=1) <= self._config["reach"] ** 2
        meals = []
        for eater in np.flatnonzero(near).tolist():
            x, y, z = mouths[eater].tolist()
            found = nearest(self.items[:, :3], (x, y, z))
            if found is not None and found[1] <= self._config["reach"]:
                at = self.items[found[0]].tolist()
                meals.append((eater, (at[0], at[1], at[2]), at[3]))
                self.items = np.delete(self.items, found[0], axis=0)
        self._show()
        return meals

    def state(self) -> JsonObject:
        """Returns it as plain JSON data."""
        return {"grown": self.grown, "items": pack_array(self.items)}

    def restore(self, state: JsonObject) -> None:
        """Takes up what `state` returned.

        Raises:
            ValueError: It is no food, or too much.
        """
        items = unpack_array(state["items"], 4)
        if len(items) > self._config["most"] or not np.isfinite(items).all():
            raise ValueError("the food of the snapshot is none, or too much")
        self.items, self.grown = items, state["grown"]
        self._show()
