"""Who lives in an ecosystem: what each creature has and came from, and what of it the rules of life look at.

Hides how creatures become rows of arrays. Invariant: inhabitants are in the order in which they came.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from nmes.backend import Array
from nmes.genome.body import Body
from nmes.schemas.documents import JsonObject
from nmes.world.creature import Creature
from nmes.world.creatures import Creatures
from nmes.world.entities import Entities

__all__ = ["Inhabitant", "Roll", "traits_of"]


@dataclass(slots=True)
class Inhabitant:
    """One living creature.

    Attributes:
        name: The creature's.
        root: The number of its root in the engine, by which it is known, since its name may be another's by now. None:
            a keyframe of old does not tell, and it is gone.
        born: The frame in which it came.
        energy: What it has, J.
        generation: 0 of those who were not born here; else one more than the first parent's.
        species: The number of its species.
        parents: The names of those it was born of.
        meals: How often it ate.
        barren: The frame before which it does not try to have offspring again.
    """

    name: str
    root: int | None
    born: int
    energy: float
    generation: int
    species: int
    parents: list[str]
    meals: int = 0
    barren: int = 0

    def lives(self, creatures: Creatures) -> bool:
        """Whether it is there still: itself, and not another of its name."""
        creature = creatures.get(self.name)
        return creature is not None and creature.root == self.root

    def state(self, creatures: Creatures) -> JsonObject:
        """Returns it as plain JSON data, with its root only where the creature of its name does not tell that."""
        told = {each.name: getattr(self, each.name) for each in fields(self)}
        if self.root is None or self.lives(creatures):
            del told["root"]
        return told

    @classmethod
    def restored(cls, state: JsonObject, creatures: Creatures) -> Inhabitant:
        """Rebuilds one from its `state`."""
        creature = creatures.get(state["name"])
        root = {"root": None if creature is None else creature.root}
        values: dict[str, Any] = {**root, **state, "energy": float(state["energy"]), "parents": list(state["parents"])}
        return cls(**values)


def traits_of(bodies: Sequence[Body]) -> dict[str, Array]:
    """Returns traits of bodies by name, each an array (n,), in the units of the rules."""
    return {
        "mass": np.array([body.mass for body in bodies]),
        "size": np.array([_longest_edge(body) for body in bodies]),
        "cubes": np.array([float(len(body.cubes)) for body in bodies]),
        "motors": np.array([float(len(body.motors)) for body in bodies]),
        "sensors": np.array([float(len(body.sensors)) for body in bodies]),
    }


def _longest_edge(body: Body) -> float:
    low, high = body.bounds
    return max(b - a for a, b in zip(low, high, strict=True))


class Roll:
    """The creatures of a moment as rows: valid until cubes or joints come or go.

    Args:
        entities: The world's.
        creatures: The living, in order.

    Attributes:
        creatures: The living.
        traits: What does not change while they live, each an array (n,).
        mouths: The numbers of their first cubes, with which they eat.
    """

    def __init__(self, entities: Entities, creatures: Sequence[Creature]) -> None:
        self._entities = entities
        self._version, self._motors = entities.version, entities.meter.numbers
        self.creatures = list(creatures)
        self.traits = traits_of([creature.present for creature in creatures])
        self.mouths = [entities.cube(next(iter(creature.cubes.values()))).body for creature in creatures]
        owners = {
            entities.joint(name).number: row
            for row, creature in enumerate(creatures)
            for name in creature.joints.values()
        }
        # By number, since a restored world meters them in another order, in which their sum has other bits.
        self._order = np.argsort(np.array(self._motors, np.intp), kind="stable")
        numbers = [self._motors[place] for place in self._order.tolist()]
        self._owners = np.array([owners.get(number, len(creatures)) for number in numbers], np.intp)

    @property
    def valid(self) -> bool:
        """Whether cubes, joints and metered motors are still those that it was made of."""
        return self._version == self._entities.version and self._motors is self._entities.meter.numbers

    def places(self) -> Array:
        """Returns where their mouths are, array (n, 3), m."""
        return self._entities.simulation.states(self.mouths)[:, :3]

    def touching(self) -> list[tuple[int, int]]:
        """Returns the pairs of rows of creatures that touched in the last engine step, each way round, in order."""
        entities, pairs = self._entities, dict[tuple[int, int], None]()
        rows = {
            entities.cube(name).body: row
            for row, creature in enumerate(self.creatures)
            for name in creature.cubes.values()
        }
        for body, row in rows.items():
            for contact in entities.simulation.contacts(body):
                other = row if contact.other is None else rows.get(contact.other, row)
                if other != row:
                    pairs[row, other] = None
        return list(pairs)

    def powers(self) -> Array:
        """Returns the power of their motors in the tick that has just ended, array (n,), W."""
        count = len(self.creatures)
        watts = self._entities.meter.powers()[self._order]
        sums = np.bincount(self._owners, weights=watts, minlength=count + 1)
        return np.asarray(sums[:count], np.float64)
