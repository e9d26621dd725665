"""How creatures develop: the rules of their genomes, followed while they live.

Hides when a rule is looked at, what it may be refused for, and what a snapshot holds of it. Invariants: what happens
follows from the genome, the world's state and how long the creature was driven; a refused change has changed nothing,
and is told; a creature changes a bounded number of times in its life.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from nmes.backend.rotation import minus, total
from nmes.errors import WorldError
from nmes.genome.body import Body
from nmes.genome.development import Resize, Rule, resized
from nmes.objective import Quantity
from nmes.schemas.documents import JsonObject
from nmes.world import growth
from nmes.world.building import joint_where

if TYPE_CHECKING:
    from nmes.world.creature import Creature
    from nmes.world.entities import Cube, Entities

__all__ = ["Development", "Habitat"]

_PERIOD: Final = 0.1  # s between two looks at the rules


@dataclass(frozen=True, slots=True)
class Habitat:
    """What a creature develops in.

    Attributes:
        entities: The world's cubes and joints.
        is_part: Tells whether a cube, by its number in the engine, is a part of some creature.
        energy_of: Tells how much energy a creature has, J, by its name; None where creatures have none.
    """

    entities: Entities
    is_part: Callable[[int], bool]
    energy_of: Callable[[str], float] | None


class Development:
    """The development of one creature, from when it is first driven.

    Args:
        body: The creature's, whole, as its genome has it.
        tick_rate: Ticks in a second.

    Attributes:
        begun: Whether it was driven.
        form: The body with each part in the size that it has come to.
        stage: Which it is in.
    """

    def __init__(self, body: Body, tick_rate: int) -> None:
        self._body, self._rules, self._rate = body, body.development, tick_rate
        self._period = max(1, round(_PERIOD * tick_rate))
        self._rows = {sensor.id: row for row, sensor in enumerate(body.sensors)}
        self._scales: dict[str, float] = {}
        self._age = 0  # ticks
        self._uses = [0] * len(self._rules)
        self._waits = [0] * len(self._rules)  # the ages from which on rules are looked at again, ticks
        self.begun, self.stage, self.form = False, 1, body

    def work(self, ticks: float) -> tuple[int, int]:
        """Returns the work of the next look at the rules, if it is within so many ticks: a guess for hosts, and cheap.

        Returns:
            How many rules may be looked at, and how many parts of the body those may change.
        """
        if not self.begun or self._age % self._period + ticks < self._period:
            return 0, 0
        left = [rule for rule, uses in zip(self._rules, self._uses, strict=True) if uses < rule.times]
        return len(left), sum(len([*rule.shed, *rule.adopt, *rule.grow, *rule.resize]) for rule in left)

    def tick(self, creature: Creature, around: Habitat) -> tuple[bool, list[JsonObject]]:
        """Ends a tick: follows the rules that apply now, in order.

        Returns:
            Whether the creature has changed, and what was refused.
        """
        if not self.begun:
            return False, []
        self._age += 1
        changed, refused = False, list[JsonObject]()
        if self._age % self._period:
            return False, []
        for number, rule in enumerate(self._rules):
            if self._uses[number] >= rule.times or self._age < self._waits[number]:
                continue
            if rule.stage not in (None, self.stage) or not self._applies(rule, creature, around):
                continue
            used, failures = self._follow(rule, creature, around)
            if used or failures:
                self._waits[number] = self._age + max(1, round(rule.every * self._rate))
            self._uses[number] += used
            changed = changed or used
            refused += [{"rule": number, **failure} for failure in failures]
        return changed, refused

    def _applies(self, rule: Rule, creature: Creature, around: Habitat) -> bool:
        needs = rule.condition.needs
        senses = creature.sense().tolist() if any(need.name == "sense" for need in needs) else []
        return rule.condition.holds({need: self._value(need, creature, around, senses) for need in needs})

    def _value(self, need: Quantity, creature: Creature, around: Habitat, senses: list[float]) -> float:
        if need.cube is not None:
            return senses[self._rows[need.cube]] if need.name == "sense" else float(need.cube in creature.cubes)
        match need.name:
            case "age":
                return self._age / self._rate
            case "energy":
                return 0.0 if around.energy_of is None else around.energy_of(creature.name)
            case "cubes":
                return float(len(creature.cubes))
            case "mass":
                return total(cube.mass for cube in creature.present.cubes)
            case "stage":
                return float(self.stage)
        raise KeyError(need.name)

    def _follow(self, rule: Rule, creature: Creature, around: Habitat) -> tuple[bool, list[JsonObject]]:
        """Does what a rule says, as far as there is anything to do; returns whether that was of use, and failures."""
        changed, failures = False, list[JsonObject]()
        for part in rule.shed:
            if part in creature.cubes:
                self._shed(creature, part, around)
                changed = True
        changes = [(part, self._adopt) for part in rule.adopt] + [(part, self._grow) for part in rule.grow]
        for part, change in changes:
            try:
                changed = change(creature, part, around) or changed
            except WorldError as error:
                failures.append({"part": part, "code": error.code})
        for each in rule.resize:
            try:
                changed = self._resize(creature, each, around.entities) or changed
            except WorldError as error:
                failures.append({"part": each.part, "code": error.code})
        if rule.enter not in (None, self.stage) and (changed or not failures):
            assert rule.enter is not None
            self.stage, changed = rule.enter, True
        return changed, failures

    def _shed(self, creature: Creature, part: str, around: Habitat) -> None:
        cut = creature.shed(part)
        if around.energy_of is not None:  # where nobody ever clears away, an ecosystem would fill up with them
            for cube in cut:
                around.entities.despawn(cube)
        creature.settle()

    def _grow(self, creature: Creature, part: str, around: Habitat) -> bool:
        if part in creature.cubes or not growth.may_hang(creature, part):
            return False
        growth.grow(around.entities, creature, part)
        return True

    def _adopt(self, creature: Creature, part: str, around: Habitat) -> bool:
        if part in creature.cubes or not growth.may_hang(creature, part):
            return False
        cube = self._lying(creature, part, around)
        if cube is None:
            return False
        growth.adopt(around.entities, creature, part, cube, around.is_part)
        return True

    def _lying(self, creature: Creature, part: str, around: Habitat) -> Cube | None:
        """Returns the cube that was a part once, where it is loose and lies no farther off than it is long."""
        joint, base, held = growth.hold(creature, part)
        shape = next(each for each in creature.form.cubes if each.id == part)
        owner = around.entities.cube(creature.cubes[creature.body.cubes[0].id]).player
        for name, cube in around.entities.cubes.items():
            own = _called(name, creature, part) and cube.player == owner and cube.size == shape.size
            if own and not around.is_part(cube.body):
                there, here = (around.entities.simulation.body_state(each.body) for each in (cube, held))
                gap = minus(joint_where(joint, shape, there).anchor, joint_where(joint, base, here).anchor)
                if total(each * each for each in gap) <= max(cube.size) ** 2:
                    return cube
        return None

    def _resize(self, creature: Creature, wanted: Resize, entities: Entities) -> bool:
        if wanted.part not in creature.cubes or self._scales.get(wanted.part, 1.0) == wanted.scale:
            return False
        scales = {**self._scales, wanted.part: wanted.scale}
        before, self.form = self.form, resized(self._body, scales)
        try:
            growth.regrow(entities, creature, wanted.part)
        except WorldError:
            self.form = before
            raise
        self._scales = scales
        return True

    # -- snapshots -----------------------------------------------------------------------------------------------

    def state(self) -> JsonObject:
        """Returns it as plain JSON data, for `recall`."""
        return {
            "begun": self.begun,
            "age": self._age,
            "stage": self.stage,
            "uses": list(self._uses),
            "waits": list(self._waits),
            "scales": dict(self._scales),
        }

    def recall(self, state: JsonObject) -> None:
        """Goes on from the `state` of another one of the same body.

        Raises:
            WorldError: `bad_snapshot`: it is none of such a body.
        """
        scales = {str(part): float(scale) for part, scale in state["scales"].items()}
        uses, waits = state["uses"], state["waits"]
        counts = [state["age"], state["stage"], *uses, *waits]
        allowed = {(each.part, each.scale) for rule in self._rules for each in rule.resize}
        if (
            any(type(count) is not int or count < 0 for count in counts)
            or not len(uses) == len(waits) == len(self._rules)
            or not {*scales.items()} <= allowed
            or type(state["begun"]) is not bool
        ):
            raise WorldError("bad_snapshot", "what it tells of a creature's development is none of its genome")
        self.begun, self._age, self.stage = state["begun"], state["age"], state["stage"]
        self._uses, self._waits, self._scales = list(uses), list(waits), scales
        self.form = resized(self._body, scales)


def _called(name: str, creature: Creature, part: str) -> bool:
    """Whether a cube is called as a part of a creature was once: as at birth, or with a number; as no other part."""
    first = f"{creature.name}.{part}"
    number = name.removeprefix(f"{first}.")
    numbered = number != name and number.isdecimal()
    return name == first or (numbered and all(name != f"{creature.name}.{each.id}" for each in creature.body.cubes))
