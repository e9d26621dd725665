"""An ecosystem: creatures of a world spend energy, eat, starve and breed by the rules of its config.

Hides how a tick goes: who came and went since the last one is called up, food grows, everybody pays for what it is
and does, eats, and is caught; once in a second the dead are taken away, then children are born, then newcomers come.
So an engine compiles its model anew once a second at most, however many come and go.

Invariants: all that happens follows from the config, the world's seed, the frame and the state, in the order in which
creatures came; a birth is whole or does not happen; there are never more creatures, cubes and food than the config
allows; a snapshot holds all that decides what comes.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import cos, isfinite, pi, sin, sqrt
from typing import TYPE_CHECKING

import numpy as np

from nmes.backend import Array, Vector
from nmes.backend.rotation import total
from nmes.errors import VariationError, WorldError
from nmes.genome import Genome
from nmes.genome.body import Body
from nmes.schemas.documents import JsonObject
from nmes.variation import Draw, cross, mutate, random_genome
from nmes.variation.distance import distance
from nmes.world.costs import life_cost
from nmes.world.food import Food
from nmes.world.inhabitants import Inhabitant, Roll, traits_of
from nmes.world.life_rules import Price, founding_genomes, requirements

if TYPE_CHECKING:
    from nmes.backend import Backend
    from nmes.world.creature import Creature
    from nmes.world.creatures import Creatures
    from nmes.world.entities import Entities

__all__ = ["Life"]

_TRIES = 24  # places that are looked at for one body
_BIRTHS = 4  # children that are tried for in one second: each may take a while to find
_REST = 10  # s after a try for a child that failed
_GAP = 0.05  # m between a newborn body and what is about it
_DROP = 0.002  # m above the ground


class Life:
    """The ecosystem of one world.

    Args:
        rules: `life` of the world's complete config.
        backend: The engine.
        entities: The world's cubes and joints.
        creatures: Its creatures.

    Attributes:
        food: What there is to eat.
        born: How many were born of parents so far.
        died: How many died so far.

    Raises:
        WorldError: An expression or a genome of the rules is none.
    """

    def __init__(self, rules: JsonObject, backend: Backend, entities: Entities, creatures: Creatures) -> None:
        self._rules, self._entities, self._creatures = rules, entities, creatures
        self._needs = requirements(rules, backend)
        self._founders = founding_genomes(rules, self._needs)
        self._cost = Price(rules, "cost")
        self._catch = Price(rules, "catch") if "catch" in rules else None
        self.food = Food(rules["food"], entities, self._needs.planar)
        self.born = self.died = 0
        self._came = self._kinds = 0  # newcomers, and species, so far
        self._living: dict[str, Inhabitant] = {}
        self._species: dict[int, Genome] = {}  # who founded each that still lives
        self._roll: Roll | None = None  # of nobody yet

    @property
    def living(self) -> list[Inhabitant]:
        """Who lives now, in the order in which they came."""
        return list(self._living.values())

    def energy_of(self, name: str) -> float:
        """Returns the energy of a creature, J; 0 of one that is not among the living."""
        each = self._living.get(name)
        return 0.0 if each is None else each.energy

    def cost(self, frame: int, ticks: float) -> float:
        """Returns about how much longer (s) ticks after a frame take than most others: a guess for hosts, and cheap.

        In some of them creatures come, die and are born. Of many ticks it is the guess for the next second.
        """
        return life_cost(self._rules, self._entities.tick_rate, frame, ticks)

    # -- a tick --------------------------------------------------------------------------------------------------

    def tick(self, frame: int) -> list[JsonObject]:
        """Lives through a tick whose engine steps are done; returns what happened, as events."""
        events: list[JsonObject] = []
        roll = self._roll
        if roll is None or not roll.valid:
            events += self._call_up(frame)
            roll = self._roll = Roll(self._entities, [self._creatures.find(name) for name in self._living])
        self.food.grow(frame)
        if self._living:
            unpriced = self._pay(roll, frame)
            events += self._eat(roll, frame)
            events += [self._take_apart(name, frame, "unpriced") for name in unpriced]
        if frame % self._entities.tick_rate == 0 or frame == 1:
            events += self._bury(frame)
            events += self._breed(frame)
            events += self._receive(frame)
            events.append(self._census(frame))
        return events

    def _call_up(self, frame: int) -> Iterator[JsonObject]:
        """Takes in those whom clients brought, and forgets those who were taken apart."""
        for each in self.living:
            if not each.lives(self._creatures):
                yield self._leave(each.name, frame, "gone")
        for name in self._creatures.names():
            if name not in self._living:
                yield self._enter(self._creatures.find(name), frame, "entered")

    def _history(self, frame: int) -> dict[str, Array]:
        """Returns of the living, in their order, what changes from tick to tick."""
        living = self._living.values()
        age = np.array([(frame - each.born) / self._entities.tick_rate for each in living])
        return {"age": age, "energy": np.array([each.energy for each in living])}

    def _pay(self, roll: Roll, frame: int) -> list[str]:
        """Has everybody pay for what it is and does; returns the names of those who have no finite price."""
        traits, rate = {**roll.traits, **self._history(frame), "power": roll.powers()}, self._entities.tick_rate
        watts, unpriced = self._cost.watts(traits, len(self._living)).tolist(), list[str]()
        for each, price in zip(self._living.values(), watts, strict=True):
            if isfinite(price):
                each.energy -= price / rate
            else:
                unpriced.append(each.name)
        if self._catch is not None:
            self._hunt(self._catch, roll.touching(), traits)
        return unpriced

    def _hunt(self, catch: Price, pairs: list[tuple[int, int]], traits: dict[str, Array]) -> None:
        """Moves energy between those who touch each other, no more than the prey has."""
        if not pairs:
            return
        hunters, prey = (np.array(side, np.intp) for side in zip(*pairs, strict=True))
        own = {name: column[hunters] for name, column in traits.items()}
        other = {f"prey_{name}": column[prey] for name, column in traits.items()}
        watts = catch.watts({**own, **other}, len(pairs))
        watts = np.where(np.isfinite(watts), watts, 0.0)  # the prey may lack what the rule divides by
        living = list(self._living.values())
        for (hunter, victim), amount in zip(pairs, (watts / self._entities.tick_rate).tolist(), strict=True):
            taken = min(max(amount, 0.0), max(living[victim].energy, 0.0))
            living[hunter].energy += taken
            living[victim].energy -= taken

    def _eat(self, roll: Roll, frame: int) -> Iterator[JsonObject]:
        living = list(self._living.values())
        for eater, place, energy in self.food.eat(roll.places()):
            living[eater].energy += energy
            living[eater].meals += 1
            name = living[eater].name
            yield {"type": "food_eaten", "frame": frame, "creature": name, "position": list(place), "energy": energy}

    # -- death ---------------------------------------------------------------------------------------------------

    def _bury(self, frame: int) -> Iterator[JsonObject]:
        """Takes away who has no energy left, or is too old; its body becomes food where the rules say so."""
        oldest = self._rules["death"]["age"] * self._entities.tick_rate
        carrion = self._rules["death"]["carrion"]
        for each in self.living:
            starved = each.energy <= 0.0
            if not starved and frame - each.born < oldest:
                continue
            creature = self._creatures.find(each.name)
            x, _, z = self._middle(creature)
            event = self._take_apart(each.name, frame, "starved" if starved else "old")
            if carrion:
                self.food.put(self._entities.terrain.surface(x, z), carrion * creature.present.mass)
            yield event

    def lose(self, body: int, frame: int) -> list[JsonObject]:
        """Takes away the creature that the engine cannot follow.

        Args:
            body: The number in the engine of the cube over which it failed.
            frame: Of the tick that failed.

        Returns:
            What happened, as events; none, and nothing has changed, where the cube is no living creature's.
        """
        for each in self.living:
            if each.lives(self._creatures) and body in self._creatures.find(each.name).bodies:
                return [self._take_apart(each.name, frame, "diverged")]
        return []

    def _take_apart(self, name: str, frame: int, cause: str) -> JsonObject:
        """Takes a creature away with its cubes; returns its death, as an event."""
        for cube in self._creatures.find(name).cubes.values():
            self._entities.despawn(self._entities.cube(cube))
        return self._leave(name, frame, cause)

    def _leave(self, name: str, frame: int, cause: str) -> JsonObject:
        gone = self._living.pop(name)
        self.died += 1
        if all(each.species != gone.species for each in self._living.values()):
            del self._species[gone.species]
        age = (frame - gone.born) / self._entities.tick_rate
        facts = {"generation": gone.generation, "species": gone.species, "meals": gone.meals, "age": age}
        return {"type": "creature_died", "frame": frame, "creature": name, "cause": cause, **facts}

    # -- birth ---------------------------------------------------------------------------------------------------

    def _breed(self, frame: int) -> Iterator[JsonObject]:
        """Has those with energy enough try for a child, the longest here first."""
        birth, tries = self._rules["birth"], 0
        for each in self.living:
            if tries == _BIRTHS or len(self._living) >= self._rules["population"]["most"]:
                return
            parent = self._creatures.find(each.name)
            if each.energy < birth["energy"] or frame < each.barren or parent.mind is None:
                continue
            tries += 1
            event = self._have_child(each, parent, frame)
            if event is None:
                each.barren = frame + _REST * self._entities.tick_rate
            else:
                yield event

    def _have_child(self, parent: Inhabitant, body: Creature, frame: int) -> JsonObject | None:
        """Returns the birth of a child; None, and nothing has changed, where it has no genome or no room."""
        draw, birth = Draw(self._entities.seed, "birth", frame, parent.name), self._rules["birth"]
        mate = self._mate(body) if draw.chance(birth["crossover"]) else None
        try:
            genome = body.genome
            if mate is not None:
                genome = cross(genome, mate.genome, draw, requirements=self._needs)
            if draw.chance(birth["mutation"]):
                genome = mutate(genome, draw, requirements=self._needs).genome
        except VariationError:
            return None
        parents = [parent, *([] if mate is None else [self._living[mate.name]])]
        place = self._place_beside(body, genome.body, draw)
        child = None if place is None else self._spawn(genome, place)
        if child is None:
            return None
        parent.energy -= birth["gift"]
        self.born += 1
        return self._enter(child, frame, "birth", parents)

    def _mate(self, creature: Creature) -> Creature | None:
        """Returns the nearest other creature that can breed, where one is in reach."""
        here, reach = self._middle(creature), self._rules["birth"]["reach"]
        found, least = None, reach * reach
        for name in self._living:
            other = self._creatures.find(name)
            if other is not creature and other.mind is not None:
                x, y, z = (a - b for a, b in zip(self._middle(other), here, strict=True))
                if x * x + y * y + z * z < least:
                    found, least = other, x * x + y * y + z * z
        return found

    def _middle(self, creature: Creature) -> Vector:
        first = next(iter(creature.cubes.values()))
        return self._entities.simulation.body_state(self._entities.cube(first).body).position

    def _spawn(self, genome: Genome, place: Vector) -> Creature | None:
        """Returns a creature that begins to live by itself; None where the world has no room for it."""
        try:
            return self._creatures.spawn(genome, self._creatures.place(genome.body, place), None, autonomous=True)
        except WorldError:
            return None

    def _enter(self, creature: Creature, frame: int, cause: str, parents: list[Inhabitant] | None = None) -> JsonObject:
        """Counts a creature among the living; one that is born has parents."""
        parents = parents or []
        birth = self._rules["birth"]
        species = self._species_of(creature.genome, parents[0].species if parents else None)
        energy = float(birth["gift"] if parents else birth["start"])
        generation = parents[0].generation + 1 if parents else 0
        names = [each.name for each in parents]
        each = Inhabitant(creature.name, creature.root, frame, energy, generation, species, names)
        self._living[creature.name] = each
        facts = {"parents": names, "genome": creature.genome.hash, "generation": generation, "species": species}
        return {"type": "creature_born", "frame": frame, "creature": creature.name, "cause": cause, **facts}

    def _species_of(self, genome: Genome, first: int | None) -> int:
        """Returns the species of a genome: its parent's, or the first whose founder is near enough, or a new one."""
        known = list(self._species) if first is None else [first, *self._species]
        for number in known:
            if distance(self._species[number].body, genome.body) < self._rules["species"]:
                return number
        self._kinds += 1
        self._species[self._kinds] = genome
        return self._kinds

    # -- newcomers -----------------------------------------------------------------------------------------------

    def _receive(self, frame: int) -> Iterator[JsonObject]:
        """Lets the first come, all at once, and later one a second where there are too few."""
        population = self._rules["population"]
        wanted = population["start"] if frame == 1 else min(1, population["least"] - len(self._living))
        for _ in range(wanted):
            self._came += 1
            draw = Draw(self._entities.seed, "newcomer", self._came)
            genome = self._newcomer(draw)
            place = None if genome is None else self._place_somewhere(genome.body, draw)
            creature = None if genome is None or place is None else self._spawn(genome, place)
            if creature is not None:
                yield self._enter(creature, frame, "founder" if frame == 1 else "newcomer")

    def _newcomer(self, draw: Draw) -> Genome | None:
        if self._founders:
            return self._founders[(self._came - 1) % len(self._founders)]
        try:
            return random_genome(draw, self._needs, f"newcomer-{self._came}")
        except VariationError:
            return None

    # -- room ----------------------------------------------------------------------------------------------------

    def _place_beside(self, parent: Creature, body: Body, draw: Draw) -> Vector | None:
        x, _, z = self._middle(parent)
        far = _radius(parent.body) + _radius(body) + _GAP
        for number in range(_TRIES):
            bearing, away = draw.uniform(-pi, pi), far * (1.0 + number / _TRIES)
            place = self._fitted(x + away * cos(bearing), z - away * sin(bearing), body)
            if place is not None:
                return place
        return None

    def _place_somewhere(self, body: Body, draw: Draw) -> Vector | None:
        for _ in range(_TRIES):
            x, _, z = self.food.somewhere(draw)
            place = self._fitted(x, z, body)
            if place is not None:
                return place
        return None

    def _fitted(self, x: float, z: float, body: Body) -> Vector | None:
        """Returns where a body's origin must be to stand at a place; None where something is in its way."""
        ground, (low, high) = self._entities.terrain.surface(x, 0.0 if self._needs.planar else z), body.bounds
        middle = [(a + b) / 2.0 for a, b in zip(low, high, strict=True)]
        x, y, z = ground[0] - middle[0], ground[1] - low[1] + _DROP, ground[2] - middle[2]
        if self._entities.cubes:
            cubes = self._entities.cubes.values()
            reach = np.array([sqrt(a * a + b * b + c * c) / 2.0 for a, b, c in (cube.size for cube in cubes)])
            apart = self._entities.states()[:, :3] - (x + middle[0], y + middle[1], z + middle[2])
            if ((apart * apart).sum(axis=1) < (reach + _radius(body) + _GAP) ** 2).any():
                return None
        return x, y, z

    # -- what there is -------------------------------------------------------------------------------------------

    def _census(self, frame: int) -> JsonObject:
        living = self.living
        columns = {
            **traits_of([self._creatures.find(each.name).present for each in living]),
            **self._history(frame),
            "generation": np.array([float(each.generation) for each in living]),
        }
        means = {name: total(column.tolist()) / len(living) for name, column in columns.items()} if living else {}
        counts = {"population": len(living), "species": len(self._species), "food": len(self.food.items)}
        return {"type": "census", "frame": frame, **counts, "born": self.born, "died": self.died, "means": means}

    def digest(self) -> bytes:
        """Returns bytes that differ wherever what decides the future does."""
        counts = [self.food.grown, self.born, self.died, self._came, self._kinds]
        for each in self._living.values():
            counts += [each.born, each.barren, each.species, each.generation]
        counts += [each.root or 0 for each in self._living.values() if not each.lives(self._creatures)]
        energies = np.array([each.energy for each in self._living.values()])
        return np.array(counts, np.int64).tobytes() + energies.tobytes() + self.food.items.tobytes()

    def snapshot(self) -> JsonObject:
        """Returns it as plain JSON data, but for the config."""
        return {
            "food": self.food.state(),
            "born": self.born,
            "died": self.died,
            "came": self._came,
            "kinds": self._kinds,
            "species": [{"number": number, "genome": each.document} for number, each in self._species.items()],
            "living": [each.state(self._creatures) for each in self.living],
        }

    def restore(self, state: JsonObject) -> None:
        """Takes up a `snapshot`, over creatures that are rebuilt already.

        Raises:
            ValueError: It does not fit together; or any other error.
        """
        self.food.restore(state["food"])
        self.born, self.died, self._came, self._kinds = (state[name] for name in ("born", "died", "came", "kinds"))
        self._species = {each["number"]: Genome(each["genome"]) for each in state["species"]}
        self._living = {each["name"]: Inhabitant.restored(each, self._creatures) for each in state["living"]}
        if {each.species for each in self.living} != self._species.keys():
            raise ValueError("its species are not those of the living")


def _radius(body: Body) -> float:
    """Returns the radius of the ball about the box around a body, m."""
    low, high = body.bounds
    x, y, z = (b - a for a, b in zip(low, high, strict=True))
    return sqrt(x * x + y * y + z * z) / 2.0
