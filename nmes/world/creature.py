"""A creature: the body of a genome that lives in a world, driven and sensed as a whole.

Hides which cubes and joints of the world a creature is, and how controls become targets of motors. A creature is
nothing but its cubes and joints: whoever moves, pushes or retunes those by their own names does it to the creature.
What is taken away or cut off is lost to it: sensors there read 0, and motors there do nothing; without its root it is a
creature no more, and what is left stays.

Invariants: `drive` does what `set_joint_param` of each motor's target would, in order; `sense` changes nothing.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import orjson

from nmes import protocol
from nmes.backend import Array, Vector
from nmes.backend.arrays import ArrayLike
from nmes.errors import WorldError
from nmes.genome import Genome
from nmes.genome.body import Body, Motor
from nmes.genome.sensor_entries import count_rays
from nmes.genome.sensors import Flaws, Sensor
from nmes.protocol import Request
from nmes.schemas.documents import JsonObject
from nmes.world import joint_params
from nmes.world.channels import Channels
from nmes.world.development import Development
from nmes.world.disturbance import Disturbance
from nmes.world.entities import Cube, Entities, Joint
from nmes.world.limbs import attached, beyond
from nmes.world.mind import Mind
from nmes.world.nearby import Nearby
from nmes.world.senses import Senses
from nmes.world.sights import Surroundings

__all__ = ["Creature"]


class Creature:
    """One creature. Made by `nmes.world.creatures`; valid until its world resets or its root is taken away.

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
        development: How it develops; None where its genome has no rules.
        jolted: How much energy of motion its parts that were there got by others that grew, J, since it was made here.
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
        self.jolted = 0.0
        self._shape = (len(body.outputs),)
        self.root = cubes[body.cubes[0].id].body
        self._low = np.array([motor.low for motor in self.motors])
        self._half = np.array([(motor.high - motor.low) / 2.0 for motor in self.motors])
        self._ones, self._wanted = np.ones(len(self.motors)), np.empty(len(self.motors))
        self._spoken = _by_channel(body, channels)
        self._drive_head = protocol.encode({"type": "drive", "creature": name, "controls": []}).removesuffix(b"[]}")
        self.disturbance = self._disturbance()
        self.development = Development(body, entities.tick_rate) if body.development else None
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
        changed = self.layout > 1 or self.disturbance is not None or self.development is not None
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

    def limb(self, part: str) -> list[Cube]:
        """Returns the cubes of a part and of all that hangs on it alone.

        Raises:
            WorldError: It has no such part (`cube_not_found`), or that is its root (`invalid`).
        """
        if part not in self._cubes:
            raise WorldError("cube_not_found", f"{self.name!r} has no part {part!r} now", "part")
        if self._cubes[part].body == self.root:
            raise WorldError("invalid", f"part: {part!r} is the root of {self.name!r}, on which all hangs", "part")
        return beyond(self._cubes, self._joints, part)

    def shed(self, part: str) -> list[Cube]:
        """Cuts off a `limb`; returns its cubes, which stay where they are.

        Raises:
            WorldError: As by `limb`.
        """
        cut = self.limb(part)
        numbers = {cube.body for cube in cut}
        for joint in list(self._joints.values()):
            if (joint.cube1.body in numbers) != (joint.cube2.body in numbers):
                self._entities.cut(joint)
        return cut

    @property
    def present(self) -> Body:
        """The part of its body that is there, with the sensors and voices of all of it.

        What was adopted has the size, mass and shape of the cube that it is.
        """
        if self.layout == 1:
            return self.body
        form = self.form
        cubes = tuple(
            replace(each, size=cube.size, mass=cube.mass, shape=cube.shape)
            for each in form.cubes
            if (cube := self._cubes.get(each.id)) is not None
        )
        joints = tuple(each for each in form.joints if each.id in self._joints)
        return replace(form, cubes=cubes, joints=joints, later=())

    @property
    def form(self) -> Body:
        """Its whole body, with each part in the size that it has come to."""
        return self.body if self.development is None else self.development.form

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
        """Returns the disturbance by flaws: of each part the worse of its own and of those that all share."""
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
        if self.development is not None:
            self.development.begun = True
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
