"""Creatures: bodies of genomes that live in a world, driven and sensed as a whole.

Hides which cubes and joints of the world a creature is, and how controls become targets of motors. A creature is
nothing but its cubes and joints: whoever moves, pushes or retunes those by their own names does it to the creature.
What is taken away or cut off is lost to it: sensors there read 0, and motors there do nothing; without its root it is a
creature no more, and what is left stays.

Invariants: `spawn` makes all of a body or changes nothing; `drive` does what `set_joint_param` of each motor's target
would, in order; `sense` changes nothing; creatures are in order of creation.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import orjson

from nmes import protocol
from nmes.backend import Array, StaticBox, Vector
from nmes.backend.arrays import ArrayLike
from nmes.backend.rotation import minus, plus
from nmes.errors import WorldError
from nmes.genome import Genome
from nmes.genome.body import Body, Motor
from nmes.genome.sensor_entries import count_rays
from nmes.genome.sensors import NEEDED, Flaws, Sensor
from nmes.protocol import Request
from nmes.schemas.documents import JsonObject
from nmes.world import joint_params
from nmes.world.building import cube_command, joint_command
from nmes.world.channels import Channels
from nmes.world.disturbance import Disturbance
from nmes.world.entities import Cube, Entities, Joint
from nmes.world.limbs import attached, beyond
from nmes.world.mind import Mind, require_mind
from nmes.world.nearby import Nearby
from nmes.world.senses import Senses
from nmes.world.sights import Surroundings

__all__ = ["Creature", "Creatures"]

_NAME_LENGTH = 128


class Creature:
    """One creature. Made by `Creatures.spawn`; valid until its world resets or its root is taken away.

    Attributes:
        name: Unique among the creatures of its world.
        genome: What it was made from; `body` is the genome's.
        target: What its target sensors point to: a point (m) or the name of a cube; None: nothing.
        root: The number of its root in the engine: where others see it, and where it speaks.
        bodies: The numbers of all its cubes.
        cubes: The names of its cubes in the world by the ids in its body, of those that are there; `joints` likewise.
        layout: Rises with each part, a cube or a joint, that it loses or grows; 1 while it is whole and always was.
        motors: In the order of controls, those that are lost too.
        sensors: In the order of values, likewise.
        controls: What it was driven with last, shape (m + v,); None until it is driven, or since it was restored.
        senses: What its sensors read.
        flaws: Of all its sensors and of all its motors, besides those of the genome, as `spawn_creature` has them.
        disturbance: What flaws do; None where it has none.
        mind: Its brain, where the world runs it; None where a client drives it.
    """

    def __init__(
        self,
        entities: Entities,
        name: str,
        genome: Genome,
        cubes: dict[str, Cube],
        joints: dict[str, Joint],
        target: Vector | str | None,
        others: Nearby,
        channels: Channels,
        mind: Mind | None = None,
        flaws: JsonObject | None = None,
        grown: int = 0,
    ) -> None:
        self._grown = grown  # cubes and joints that were added so far
        self._entities, self._simulation = entities, entities.simulation
        self._channels, self._others = channels, others
        self.name, self.genome, self.body = name, genome, (body := genome.body)
        self.target, self.mind, self.flaws = target, mind, flaws
        self.motors: tuple[Motor, ...] = body.motors
        self.sensors: tuple[Sensor, ...] = body.sensors
        self.controls: Array | None = None
        self._shape = (len(body.outputs),)
        self.root = cubes[body.cubes[0].id].body
        self._low = np.array([motor.low for motor in self.motors])
        self._half = np.array([(motor.high - motor.low) / 2.0 for motor in self.motors])
        self._ones, self._wanted = np.ones(len(self.motors)), np.empty(len(self.motors))
        self._spoken = _by_channel(body, channels)
        self._drive_head = protocol.encode({"type": "drive", "creature": name, "controls": []}).removesuffix(b"[]}")
        self.disturbance = self._disturbance()
        entities.rays = max(entities.rays, count_rays(self.sensors))
        self._bind(cubes, joints)

    def _bind(self, cubes: dict[str, Cube], joints: dict[str, Joint]) -> None:
        """Finds all that follows from the parts that are there."""
        body = self.body
        self._cubes, self._joints = cubes, joints
        self.bodies = tuple(cube.body for cube in cubes.values())
        self.cubes: dict[str, str] = {part: cube.name for part, cube in cubes.items()}
        self.joints: dict[str, str] = {part: joint.name for part, joint in joints.items()}
        # Whatever is lost or grows makes it more, and when that is noticed does not matter.
        self.layout = 1 + len(body.cubes) - len(cubes) + len(body.joints) - len(joints) + 2 * self._grown
        there = [row for row, motor in enumerate(self.motors) if motor.id in joints]
        self._there = None if len(there) == len(self.motors) else np.array(there, np.intp)
        self._moved = tuple(self.motors[row] for row in there)
        self._driven = tuple(joints[motor.id] for motor in self._moved)
        self._numbers = tuple(joint.number for joint in self._driven)
        self._fields = tuple(
            "target_position" if motor.mode == "position" else "motor_target_velocity" for motor in self._moved
        )
        self._tuned = -1  # the entities', when the joints' parameters were looked at last
        self._targets: list[tuple[JsonObject, str]] = []
        self._params: list[Any] = []
        self._driven_reply = protocol.encode({"type": "driven", "creature": self.name, **self.changed})
        around = Surroundings(self._entities, self._others, self._channels, self.target, self.bodies)
        self.senses = Senses(body, cubes, joints, around)

    @property
    def solitary(self) -> bool:
        """Whether it lives only in a world of its own, and never as a row of an engine."""
        changed = self.layout > 1 or self.disturbance is not None
        return changed or any(sensor.solitary for sensor in self.sensors)

    @property
    def plan(self) -> Hashable:
        """What creatures must have in common to be run as rows of one `CreatureRows`."""
        body = self.body
        parts = tuple(cube.id for cube in body.cubes), tuple((joint.id, joint.kind) for joint in body.joints)
        return (*parts, body.outputs, self.sensors)

    @property
    def changed(self) -> JsonObject:
        """What replies about it tell besides: its `layout`, unless it is whole."""
        return {"layout": self.layout} if self.layout > 1 else {}

    @property
    def lost(self) -> tuple[list[str], list[str]]:
        """The ids of the cubes and of the joints of its body that it has no more."""
        cubes = [part.id for part in self.body.cubes if part.id not in self._cubes]
        return cubes, [part.id for part in self.body.joints if part.id not in self._joints]

    def settle(self) -> bool:
        """Takes note of parts that were taken away or cut off; returns whether its root is still there."""
        cubes, joints = attached(self._entities, self._cubes, self._joints)
        if cubes and (len(cubes), len(joints)) != (len(self._cubes), len(self._joints)):
            self._bind(cubes, joints)
        return bool(cubes)

    def shed(self, part: str) -> list[Cube]:
        """Cuts off a part and all that hangs on it alone; returns their cubes, which stay where they are.

        Raises:
            WorldError: It has no such part (`cube_not_found`), or that is its root (`invalid`).
        """
        if part not in self._cubes:
            raise WorldError("cube_not_found", f"{self.name!r} has no part {part!r} now", "part")
        if self._cubes[part].body == self.root:
            raise WorldError("invalid", f"part: {part!r} is the root of {self.name!r}, on which all hangs", "part")
        cut = beyond(self._cubes, self._joints, part)
        numbers = {cube.body for cube in cut}
        for joint in list(self._joints.values()):
            if (joint.cube1.body in numbers) != (joint.cube2.body in numbers):
                self._entities.cut(joint)
        return cut

    @property
    def present(self) -> Body:
        """The part of its body that is there, with the sensors and voices of all of it."""
        if self.layout == 1:
            return self.body
        cubes = tuple(each for each in self.body.cubes if each.id in self._cubes)
        joints = tuple(each for each in self.body.joints if each.id in self._joints)
        return replace(self.body, cubes=cubes, joints=joints, later=())

    @property
    def there(self) -> tuple[dict[str, Cube], dict[str, Joint]]:
        """Its cubes and joints that are there, by their ids, in the body's order."""
        return self._cubes, self._joints

    def extend(self, cubes: Mapping[str, Cube], joints: Mapping[str, Joint]) -> None:
        """Takes cubes and joints of the world as parts that were not there, by their ids in the body."""
        self._grown += len(cubes) + len(joints)
        cubes, joints = {**self._cubes, **cubes}, {**self._joints, **joints}
        in_order = {each.id: cubes[each.id] for each in self.body.cubes if each.id in cubes}
        self._bind(in_order, {each.id: joints[each.id] for each in self.body.joints if each.id in joints})

    @property
    def added(self) -> list[JsonObject]:
        """What a snapshot tells of parts that were added, how many ever and their names; nothing where none were."""
        if not self._grown:
            return []
        names = {"cubes": self.cubes, "joints": self.joints}
        others = {kind: _renamed(self.name, parts) for kind, parts in names.items()}
        return [{"count": self._grown, **others}]

    def _disturbance(self) -> Disturbance | None:
        """Returns what its flaws do: of each of the genome's and of all the worse."""
        every = {name: Flaws.read((self.flaws or {}).get(name)) for name in ("sensors", "motors")}
        sensors = [Flaws.worse(sensor.flaws, every["sensors"]) for sensor in self.sensors]
        motors = [Flaws.worse(motor.flaws, every["motors"]) for motor in self.motors]
        if not any(sensors) and not any(motors):
            return None
        rest = np.clip(-self._low / self._half - 1.0, -1.0, 1.0)
        return Disturbance(sensors, motors, rest, f"{self._entities.seed}:{self.root}")

    def accepts(self, controls: ArrayLike) -> bool:
        """Whether a client may `drive` it with this: doubles in a row, of the right shape, and from -1 to 1."""
        if (
            self.mind is not None
            or not isinstance(controls, np.ndarray)
            or controls.shape != self._shape
            or controls.dtype != np.float64
        ):
            return False
        if not controls.flags.c_contiguous:
            return False
        for control in controls.tolist():  # of a few numbers faster than by arrays
            if not -1.0 <= control <= 1.0:  # also where it is no number
                return False
        return True

    def message(self, controls: Array) -> tuple[Request, bytes]:
        """Returns the command `drive` as it would come over the wire, and its encoded reply."""
        raw = self._drive_head + orjson.dumps(controls, option=orjson.OPT_SERIALIZE_NUMPY) + b"}"
        command = {"type": "drive", "creature": self.name, "controls": controls.tolist()}
        return Request(raw, command, None, "drive"), self._driven_reply

    # -- motors and voices ----------------------------------------------------------------------------------------

    def drive(self, controls: Array) -> None:
        """Sets the motors' targets and what the voices say, until it is driven again.

        A motor that was switched off or made one of the other mode since is what it was made as again.

        Args:
            controls: Shape (m + v,), each from -1 to 1, in the order of `motors`, then of the body's voices; -1 is a
                motor's `low`, 1 its `high`.
        """
        motors = controls
        if self.body.voices:
            motors = controls[: len(self._wanted)]
            for channel, size, said in self._spoken:
                values = [0.0] * size
                for number, at in said:
                    values[number] = float(controls[at])
                self._channels.say(self.root, channel, tuple(values))
        if self.disturbance is not None and self.disturbance.drives:
            self.disturbance.ask(motors)
        else:
            self._aim(motors)
        self.controls = controls.copy()  # whose they are may use the array again

    def disturb(self) -> None:
        """Lets what is flawed go on by a tick, which begins now."""
        assert self.disturbance is not None
        controls = self.disturbance.tick(self.senses.read)
        if controls is not None:
            self._aim(controls)

    def _aim(self, controls: Array) -> None:
        """Sets the motors' targets."""
        targets = self._wanted
        np.add(controls, self._ones, out=targets)  # of arrays alone: a float would be made one each time
        np.multiply(targets, self._half, out=targets)
        np.add(targets, self._low, out=targets)
        if self._there is not None:
            targets = targets.take(self._there)
        if self._tuned != self._entities.tuned:
            self._prepare_motors(targets)
        self._simulation.set_motor_targets(self._numbers, self._params, targets)
        for (params, field), target in zip(self._targets, targets.tolist(), strict=True):
            params[field] = target

    def _prepare_motors(self, targets: Array) -> None:
        """Has all motors run in the mode that they were made for, and keeps their parameters at hand for `drive`."""
        for joint, motor, field, target in zip(self._driven, self._moved, self._fields, targets.tolist(), strict=True):
            servo = joint.params["target_position"] is not None
            if not joint.params["motor_enabled"] or servo != (motor.mode == "position"):
                self._entities.set_params(joint, {field: target}, "value")
        self._params = [joint_params.engine_params(joint.params) for joint in self._driven]
        self._targets = [(joint.params, field) for joint, field in zip(self._driven, self._fields, strict=True)]
        self._tuned = self._entities.tuned

    def sense(self) -> Array:
        """Returns the sensors' values now: a new array, shape (s,), in the order of `sensors`.

        Units are those of `schemas/genome.json`.
        """
        values = self.senses.read()
        if self.disturbance is not None:
            values = self.disturbance.sensed(values)
            values[self.senses.missing] = 0.0  # what is not there does not err
        return values


def _require_body(body: Body, cubes: Mapping[str, Cube], joints: Mapping[str, Joint]) -> None:
    """Raises `bad_snapshot` unless joints hold the cubes together as in the body, no cube twice."""
    ends = {each.id: (each.cube1, each.cube2) for each in body.joints}
    held = all(
        joint.cube1 is cubes.get(ends[part][0]) and joint.cube2 is cubes.get(ends[part][1])
        for part, joint in joints.items()
    )
    if not held or len({cube.body for cube in cubes.values()}) < len(cubes):
        raise WorldError("bad_snapshot", "the parts of a creature are not joined as in its body")


def _renamed(creature: str, names: Mapping[str, str]) -> dict[str, str]:
    """Returns the names of the parts that are not called as at birth."""
    return {part: name for part, name in names.items() if name != f"{creature}.{part}"}


def _by_channel(body: Body, channels: Channels) -> list[tuple[str, int, list[tuple[int, int]]]]:
    """Returns the channels of a world on which a body has voices.

    Of each its name, its size, and pairs: which of its numbers, from 0, and the place of that voice among the outputs.
    """
    places = list(enumerate(body.voices, len(body.motors)))
    return [
        (name, channel.size, said)
        for name, channel in channels.channels.items()
        if (said := [(voice.number - 1, place) for place, voice in places if voice.channel == name])
    ]


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
        self._lessened: list[Creature] = []  # those that have lost parts
        self._changed: dict[str, None] = {}  # the names of those that lost parts since `changes` was called
        self._count = 0
        self._version = entities.version
        self._nearby = Nearby(entities, lambda: [creature.root for creature in self._present().values()])

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
                self._changed[name] = None
        self._minds = [creature for creature in self._creatures.values() if creature.mind is not None]
        self._flawed = [creature for creature in self._creatures.values() if creature.disturbance is not None]
        self._lessened = [creature for creature in self._creatures.values() if creature.layout > 1]
        self._version = self._entities.version

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

    def memory(self) -> bytes:
        """Returns what the brains that the world runs and flaws remember, and who lost which parts, as bytes."""
        if self._creatures and self._version != self._entities.version:
            self._forget_dissolved()
        lost = [orjson.dumps([each.name, *each.lost, *each.added]) for each in self._lessened]
        minds = [each.mind.memory().tobytes() for each in self._minds if each.mind is not None]
        flaws = [each.disturbance.memory() for each in self._flawed if each.disturbance is not None]
        return b"".join(minds + flaws + lost)

    def changes(self, frame: int) -> list[JsonObject]:
        """Returns which creatures have lost parts since this was asked last, as events."""
        if self._creatures and self._version != self._entities.version:
            self._forget_dissolved()
        if not self._changed:
            return []
        names, self._changed = [name for name in self._changed if name in self._creatures], {}
        return [self._change(self._creatures[name], frame) for name in names]

    def note_growth(self, creature: Creature) -> None:
        """Takes note that a creature has more parts than it had, to tell of it."""
        self._changed[creature.name] = None

    def _change(self, creature: Creature, frame: int) -> JsonObject:
        cubes, joints = creature.lost
        head = {"type": "creature_changed", "frame": frame, "creature": creature.name, "layout": creature.layout}
        return {**head, "lost_cubes": cubes, "lost_joints": joints}

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
        """Returns what the brain of a creature of these cubes begins with: seed, number, and length of a tick (s)."""
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
                self._entities.require("motor" if joint.motor.mode == "velocity" else "servo", "such motors", path)
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
