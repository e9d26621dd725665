"""All creatures of a world: made from genomes, found by name, and saved.

Hides what is checked before a body is made, who of them thinks, errs or develops, and what a snapshot tells of them.
Invariants: `spawn` makes all of a body or changes nothing; creatures are in order of creation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from weakref import ref

import orjson

from nmes.backend import StaticBox, Vector
from nmes.backend.rotation import minus, plus, total
from nmes.errors import WorldError
from nmes.genome import Genome
from nmes.genome.body import Body
from nmes.genome.sensors import NEEDED
from nmes.schemas.documents import JsonObject
from nmes.world.building import cube_command, joint_command
from nmes.world.channels import Channels
from nmes.world.costs import development_cost
from nmes.world.creature import Creature
from nmes.world.development import Habitat
from nmes.world.entities import Cube, Entities, Joint
from nmes.world.mind import Mind, require_mind
from nmes.world.nearby import Nearby

__all__ = ["Creatures"]

_NAME_LENGTH = 128


class Creatures:
    """All creatures of one world, over its cubes and joints.

    Args:
        entities: Where their cubes and joints are made.
        channels: Where they speak and hear.
    """

    def __init__(self, entities: Entities, channels: Channels) -> None:
        self._entities, self._channels = entities, channels
        self._creatures: dict[str, Creature] = {}
        self._minds: list[Creature] = []  # those whose brains the world runs
        self._flawed: list[Creature] = []
        self._developing: list[Creature] = []
        self._lessened: list[Creature] = []  # those that have lost parts
        # The names of those that lost or gained parts since `changes` was called, each with what it was refused.
        self._changed: dict[str, list[JsonObject]] = {}
        self._count = 0
        self._version = entities.version
        weak = ref(self)  # else the two would keep each other, and the engine, when their world has let go of them

        def roots() -> list[int]:
            creatures = weak()
            return [] if creatures is None else [creature.root for creature in creatures._present().values()]

        self._nearby = Nearby(entities, roots)

    def _present(self) -> dict[str, Creature]:
        if self._version != self._entities.version:
            self._forget_dissolved()
        return self._creatures

    def names(self) -> list[str]:
        """Returns the names of the creatures in order of creation."""
        return list(self._present())

    def find(self, name: str) -> Creature:
        """Returns a creature.

        Raises:
            WorldError: `creature_not_found`.
        """
        creature = self.get(name)
        if creature is None:
            raise WorldError("creature_not_found", f"there is no creature {name!r}", "creature")
        return creature

    def get(self, name: str) -> Creature | None:
        """Returns a creature, or None."""
        return self._present().get(name)

    def _forget_dissolved(self) -> None:
        for name, creature in list(self._creatures.items()):
            before = creature.layout
            if not creature.settle():
                del self._creatures[name]
            elif creature.layout != before:
                self._changed.setdefault(name, [])
        self._minds = [creature for creature in self._creatures.values() if creature.mind is not None]
        self._flawed = [creature for creature in self._creatures.values() if creature.disturbance is not None]
        self._developing = [creature for creature in self._creatures.values() if creature.development is not None]
        self._lessened = [creature for creature in self._creatures.values() if creature.layout > 1]
        self._version = self._entities.version

    @property
    def busy(self) -> bool:
        """Whether any of them does something by itself: its brain is run by the world, its body errs or develops."""
        self._present()
        return bool(self._minds or self._flawed or self._developing)

    def act(self) -> None:
        """Begins a tick: those whose brains the world runs sense and drive, then flaws do; in order of creation."""
        if not self._minds and not self._flawed:
            return
        if self._version != self._entities.version:
            self._forget_dissolved()
        for creature in self._minds:
            assert creature.mind is not None
            creature.mind.act(creature)
        for creature in self._flawed:
            creature.disturb()

    def develop(self, energy_of: Callable[[str], float] | None) -> None:
        """Ends a tick: those that develop follow their rules, in order of creation.

        Args:
            energy_of: Tells how much energy a creature has, J, by its name; None where creatures have none.
        """
        if not self._developing:
            return
        if self._version != self._entities.version:
            self._forget_dissolved()
        around = Habitat(self._entities, self.is_part, energy_of)
        for creature in self._developing:
            assert creature.development is not None
            changed, refused = creature.development.tick(creature, around)
            if changed or refused:
                self._changed.setdefault(creature.name, []).extend(refused)

    def development_cost(self, ticks: float) -> float:
        """Returns about how much longer (s) the next of so many ticks takes since creatures develop in it."""
        works = (each.development.work(ticks) for each in self._developing if each.development is not None)
        return total(development_cost(self._entities, *work) for work in works)

    def is_part(self, body: int) -> bool:
        """Whether a cube, by its number in the engine, is a part of some creature."""
        return any(body in creature.bodies for creature in self._creatures.values())

    def memory(self) -> bytes:
        """Returns the state of brains that the world runs, of flaws and development, and lost parts, as bytes."""
        if self._creatures and self._version != self._entities.version:
            self._forget_dissolved()
        lost = [orjson.dumps([each.name, *each.lost, *each.added]) for each in self._lessened]
        minds = [each.mind.memory().tobytes() for each in self._minds if each.mind is not None]
        flaws = [each.disturbance.memory() for each in self._flawed if each.disturbance is not None]
        grown = [orjson.dumps(each.development.state()) for each in self._developing if each.development is not None]
        return b"".join(minds + flaws + lost + grown)

    def changes(self, frame: int) -> list[JsonObject]:
        """Returns which creatures have lost or gained parts since this was asked last, as events."""
        if self._creatures and self._version != self._entities.version:
            self._forget_dissolved()
        if not self._changed:
            return []
        changed, self._changed = self._changed, {}
        return [
            self._change(self._creatures[name], refused, frame)
            for name, refused in changed.items()
            if name in self._creatures
        ]

    def note_growth(self, creature: Creature) -> None:
        """Takes note that a creature has more parts than it had, to tell of it."""
        self._changed.setdefault(creature.name, [])

    def _change(self, creature: Creature, refused: list[JsonObject], frame: int) -> JsonObject:
        cubes, joints = creature.lost
        head = {"type": "creature_changed", "frame": frame, "creature": creature.name, "layout": creature.layout}
        event = {**head, "lost_cubes": cubes, "lost_joints": joints}
        if creature.development is not None:
            event["stage"] = creature.development.stage
        return {**event, "refused": refused} if refused else event

    def spawn(
        self,
        genome: Genome,
        position: Vector,
        name: str | None,
        target: Vector | str | None = None,
        *,
        autonomous: bool = False,
        flaws: JsonObject | None = None,
    ) -> Creature:
        """Makes a creature from a genome, all of it or nothing.

        Args:
            genome: Whose body it is.
            position: Where the origin of its document comes to be, m.
            name: Of the creature; its cubes and joints are called `NAME.id`. Drawn from the world's seed if None.
            target: What its target sensors point to: a point (m) or the name of a cube, which need not be there yet.
            autonomous: Whether the world runs its brain.
            flaws: Of all its `sensors` and of all its `motors`, besides those of the genome.

        Raises:
            WorldError: The name is taken or too long, the world is full, the engine lacks what the body needs, or an
                autonomous creature has no brain that a world can run.
        """
        self._forget_dissolved()
        entities, body = self._entities, genome.body
        count = self._count
        if name is None:
            count += 1
            while self._taken(drawn := entities.draw("creature", count), body) is not None:
                count += 1
            name = drawn
        self._check(body, name)
        if autonomous:
            require_mind(genome)
        cubes = {part.id: entities.spawn(cube_command(part, name, position)) for part in body.born.cubes}
        joints = {}
        for joint in body.born.joints:
            command = joint_command(joint, name, position)
            joints[joint.id] = entities.joint(entities.connect(command, joint.kind, "joint"))
        self._count = count
        mind = Mind(genome, *self._beginning(cubes)) if autonomous else None
        around = self._nearby, self._channels
        self._creatures[name] = creature = Creature(entities, name, genome, cubes, joints, target, *around, mind, flaws)
        self._forget_dissolved()
        return creature

    def _beginning(self, cubes: dict[str, Cube]) -> tuple[int, int, float]:
        """Returns the seed, number, and length of a tick (s) of the brain of a creature of these cubes."""
        return self._entities.seed, next(iter(cubes.values())).body, 1.0 / self._entities.tick_rate

    def place(self, body: Body, position: Vector) -> Vector:
        """Returns where the origin of a body comes to be, m: there, or above, so that no part is in the ground."""
        parts = [
            StaticBox(part.size, plus(part.position, position), part.quaternion, part.shape) for part in body.cubes
        ]
        first = self._entities.terrain.outside(parts)[0]
        return position if first == parts[0].position else plus(position, minus(first, parts[0].position))

    def snapshot(self) -> JsonObject:
        """Returns the creatures as plain JSON data; their cubes and joints are part of the entities' snapshot."""
        self._forget_dissolved()
        creatures = [
            {
                "name": name,
                "genome": creature.genome.document,
                "target": creature.target,
                **({} if creature.mind is None else {"mind": creature.mind.state()}),
                **(
                    {} if creature.layout == 1 else {"lost": dict(zip(("cubes", "joints"), creature.lost, strict=True))}
                ),
                **({"grown": creature.added[0]} if creature.added else {}),
                **({} if creature.flaws is None else {"flaws": creature.flaws}),
                **({} if creature.disturbance is None else {"disturbance": creature.disturbance.state()}),
                **({} if creature.development is None else {"development": creature.development.state()}),
            }
            for name, creature in self._creatures.items()
        ]
        return {"count": self._count, "creatures": creatures}

    def restore(self, state: JsonObject) -> None:
        """Rebuilds the creatures of a snapshot, over entities that are rebuilt already."""
        entities, self._count, self._version = self._entities, state["count"], self._entities.version
        for values in state["creatures"]:
            name, genome = values["name"], Genome(values["genome"])
            lost = values.get("lost", {"cubes": [], "joints": []})
            body = genome.body
            grown = values.get("grown", {"count": 0, "cubes": {}, "joints": {}})
            there = (each.id for each in body.cubes if each.id not in lost["cubes"])
            cubes = {part: entities.cube(grown["cubes"].get(part, f"{name}.{part}")) for part in there}
            left = (each.id for each in body.joints if each.id not in lost["joints"])
            joints = {part: entities.joint(grown["joints"].get(part, f"{name}.{part}")) for part in left}
            _require_body(body, cubes, joints)
            target = values["target"]
            target = (target[0], target[1], target[2]) if isinstance(target, list) else target
            mind = Mind(genome, *self._beginning(cubes), values["mind"]) if "mind" in values else None
            around = self._nearby, self._channels
            parts = entities, name, genome, cubes, joints, target, *around, mind, values.get("flaws"), grown["count"]
            self._creatures[name] = creature = Creature(*parts)
            if creature.disturbance is not None:
                creature.disturbance.recall(values["disturbance"])
            if creature.development is not None:
                creature.development.recall(values["development"])
        self._forget_dissolved()

    def _taken(self, name: str, body: Body) -> WorldError | None:
        """Returns the error to raise where a name is taken that a creature of this name would need, else None."""
        if name in self._creatures:
            return WorldError("creature_exists", f"there is a creature {name!r} already", "name")
        for cube in body.cubes:
            if f"{name}.{cube.id}" in self._entities.cubes:
                return WorldError("cube_exists", f"there is a cube '{name}.{cube.id}' already", "name")
        for joint in body.joints:
            if f"{name}.{joint.id}" in self._entities.joints:
                return WorldError("joint_exists", f"there is a joint '{name}.{joint.id}' already", "name")
        return None

    def _check(self, body: Body, name: str) -> None:
        """Raises whatever would go wrong while the body is made: afterwards nothing can."""
        error = self._taken(name, body)
        if error is not None:
            raise error
        longest = max(len(part) for part in [*(cube.id for cube in body.cubes), *(joint.id for joint in body.joints)])
        if len(name) + 1 + longest > _NAME_LENGTH:
            most = _NAME_LENGTH - 1 - longest
            message = f"name: the names of this body's parts leave room for {most} characters"
            raise WorldError("invalid", message, "name")
        self._entities.require_room(len(body.born.cubes), len(body.born.joints))
        self._entities.require_connectable(len(body.born.cubes), "genome/body")
        self._entities.require_plane(body.planar, "body that leaves the XY plane", "genome/body")
        for cube in body.cubes:
            self._entities.groups.number(cube.group, "genome/body")
            if cube.shape != "box":
                self._entities.require(f"shape.{cube.shape}", f"bodies of the shape {cube.shape}", "genome/body")
        for joint in body.joints:
            path = "genome/body"
            self._entities.require(f"joint.{joint.kind}", f"joints of type {joint.kind}", path)
            if joint.limits is not None:
                self._entities.require("limits", "limits of joints", path)
            if joint.stiffness or joint.damping:
                self._entities.require("spring", "springs in joints", path)
            if joint.motor is not None:
                self._entities.require("motor", "motors in joints", path)  # a servo's too: it bounds their effort
                if joint.motor.mode == "position":
                    self._entities.require("servo", "servos in joints", path)
        for ear in body.sensors:
            self._check_number(ear.channel, ear.number, "genome/sensors")
        for voice in body.voices:
            self._check_number(voice.channel, voice.number, "genome/voices")
        types = {sensor.type for sensor in body.sensors}
        for sensor, (capability, what) in NEEDED.items():
            if sensor in types:
                self._entities.require(capability, what, "genome/sensors")

    def _check_number(self, name: str | None, number: int, path: str) -> None:
        """Raises `invalid` where the world has the channel, but not that number of it."""
        channel = None if name is None else self._channels.channels.get(name)
        if channel is not None and number > channel.size:
            message = f"the channel {name!r} of this world has {channel.size} numbers, and no number {number}"
            raise WorldError("invalid", message, path)


def _require_body(body: Body, cubes: Mapping[str, Cube], joints: Mapping[str, Joint]) -> None:
    """Raises `bad_snapshot` unless joints hold the cubes together as in the body, no cube twice."""
    ends = {each.id: (each.cube1, each.cube2) for each in body.joints}
    held = all(
        joint.cube1 is cubes.get(ends[part][0]) and joint.cube2 is cubes.get(ends[part][1])
        for part, joint in joints.items()
    )
    if not held or len({cube.body for cube in cubes.values()}) < len(cubes):
        raise WorldError("bad_snapshot", "the parts of a creature are not joined as in its body")
