"""The cubes and joints of a world, by name, over one simulation of its engine.

Hides what a command's fields become: defaults, names drawn from the seed, the midpoint as anchor, the wrench of a force
at a point, the limits on how many there may be. It knows nothing of clients, time,
modes or faults: those are the World's.

Invariants: cubes and joints are in order of creation; numbers given to the engine are never used twice; a command
that raises WorldError has changed nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from hashlib import blake2b
from itertools import pairwise
from typing import Any

import numpy as np

from nmes import protocol
from nmes.backend import Array, Backend, BodySpec, BodyState, JointSpec, Simulation, StaticBox, Vector
from nmes.backend.rotation import cross, minus, plus, total
from nmes.backend.shapes import Shape, misfit
from nmes.errors import WorldError
from nmes.schemas.documents import JsonObject
from nmes.world import joint_params, scenery
from nmes.world.energy import EnergyMeter
from nmes.world.fields import FieldReader, unit_vector, vector
from nmes.world.groups import CollisionGroups
from nmes.world.structure import StructureMotion, connected_cubes, most_connected
from nmes.world.terrain import Terrain

__all__ = ["Cube", "Entities", "Joint", "cube_not_found", "identity"]

ZERO: Vector = (0.0, 0.0, 0.0)
_NAME_LENGTH = 128
_NOTES = 32  # of a joint
_LATER = frozenset({"joints", "group", "player", "shape"})  # of a cube: not in snapshots, or not in all


@dataclass(slots=True)
class Cube:
    """One cube: what does not change by itself. `body` is its number in the engine."""

    name: str
    body: int
    size: Vector
    mass: float
    friction: float
    restitution: float
    color: tuple[float, float, float, float]
    frozen: bool
    origin: Vector  # where it was spawned
    past_work: float = 0.0  # J that motors of joints which it had, and has no more, have worked
    group: str | None = None  # the collision group
    joints: dict[str, None] = field(default_factory=dict)  # in order of creation
    player: int | None = None  # whose it is; None: nobody's
    shape: Shape = "box"


@dataclass(slots=True)
class Joint:
    """One joint. `number` is its number in the engine."""

    name: str
    number: int
    kind: str
    cube1: Cube
    cube2: Cube
    params: JsonObject  # the wire's parameters, all of them
    skeleton: str | int | None = None
    notes: dict[str, float] = field(default_factory=dict)  # what clients keep with it; without effect


class Entities:
    """All cubes and joints of a world.

    Args:
        backend: The engine.
        config: The world's complete config.
        seed: What names are drawn from.
        version: The first structure version.

    Attributes:
        seed: The world's.
        cubes: The cubes by name, `joints` likewise, in order of creation. To be read only.
        body_names: The cubes' names by their numbers in the engine, in order of creation.
        simulation: The engine's scene.
        terrain: Where the ground is.
        groups: The collision groups.
        fields: Reads the geometric fields of commands.
        meter: The work of the joints' motors.
        tick_rate: Ticks per second.
        food: Where there is something to eat, array (n, 3), m.
        rays: As many rays take as long as all that the senses of one creature perceive around it: the most of any.
        version: Increases with every change of cubes, joints, frozenness or colours.
        tuned: Increases with every `set_params`.
        moments: Increases with every tick and snapshot: what the engine then tells of cubes may have other bits.

    Raises:
        WorldError: The engine cannot make the config's scene, or does not know its settings.
    """

    def __init__(self, backend: Backend, config: Mapping[str, Any], seed: int, version: int) -> None:
        self.version = version
        self.tuned = self.moments = 0
        self._reshaped = self._painted = 0
        self._backend = backend
        self._config = config
        self.seed = seed
        self.fields = FieldReader(backend.dims == 2)
        self.groups = CollisionGroups(config)
        for capability, path in scenery.needs(config).items():
            self.require(capability, f"scenery of this kind ({capability})", path)
        scene = scenery.scene_spec(config, seed)
        self._engine_step = scene.timestep
        self.simulation: Simulation = backend.create(scene)
        self.terrain = Terrain(scene, backend.dims == 2)
        self.cubes: dict[str, Cube] = {}
        self.joints: dict[str, Joint] = {}
        self.body_names: dict[int, str] = {}
        self._spawned = 0
        self._joined = 0
        self.food: Array = np.empty((0, 3))
        self.rays = 0
        self.tick_rate: int = config["tick_rate"]
        self.meter = EnergyMeter(self.simulation)

    @property
    def edits(self) -> int:
        """How often something was done that an engine may compile its model anew for."""
        return self.version + self._reshaped - self._painted

    # -- snapshots -----------------------------------------------------------------------------------------------

    def assembly(self) -> JsonObject:
        """Returns the cubes and joints as plain JSON data."""
        cubes = [
            {
                **{name: getattr(cube, name) for name in Cube.__slots__ if name not in _LATER},
                **({} if cube.group is None else {"group": cube.group}),
                **({} if cube.shape == "box" else {"shape": cube.shape}),
            }
            for cube in self.cubes.values()
        ]
        joints = [
            {
                **{name: getattr(joint, name) for name in Joint.__slots__ if name != "notes"},
                **({"notes": joint.notes} if joint.notes else {}),
                "cube1": joint.cube1.name,
                "cube2": joint.cube2.name,
                "watts": self.meter.watts(joint.number),
            }
            for joint in self.joints.values()
        ]
        return {
            "version": self.version,
            "spawned": self._spawned,
            "joined": self._joined,
            "cubes": cubes,
            "joints": joints,
        }

    def restore(self, state: JsonObject, engine: bytes) -> None:
        """Rebuilds the cubes and joints of a snapshot in a world without cubes, of the same config and seed.

        Args:
            state: The cubes and joints, as `assembly` returned them.
            engine: The engine's snapshot.

        Raises:
            WorldError: `bad_snapshot`, or another where the parts do not fit together; or any other error.
        """
        self._check_numbers(state)
        self.version, self._spawned, self._joined = state["version"], state["spawned"], state["joined"]
        for values in state["cubes"]:
            self.groups.number(values.get("group"), "group")
            vectors = {name: vector(values[name]) for name in ("size", "origin")}
            cube = Cube(**{**values, **vectors, "color": tuple(values["color"])})
            if misfit(cube.shape, cube.size) is not None:
                raise WorldError("bad_snapshot", f"the cube {cube.name!r} cannot have its shape and size")
            self._add_cube(cube)
        for values in state["joints"]:
            cubes = {name: self.cubes[values[name]] for name in ("cube1", "cube2")}
            if not joint_params.is_complete(values["params"]):
                raise WorldError("bad_snapshot", f"the joint {values['name']!r} lacks parameters, or they are none")
            watts = values["watts"]
            joint = Joint(**{**{name: value for name, value in values.items() if name != "watts"}, **cubes})
            if watts is not None:
                self.meter.add(joint.number, watts)
            self._add_joint(joint)
        self.simulation.restore(engine)
        bodies = {cube.body: cube.frozen for cube in self.cubes.values()}
        joints = {one.number: (one.kind, one.cube1.body, one.cube2.body) for one in self.joints.values()}
        if self.simulation.members() != (bodies, joints):
            raise WorldError("bad_snapshot", "its engine has other cubes or joints than its world")

    def _check_numbers(self, state: JsonObject) -> None:
        """Raises WorldError unless cubes and joints are in order of creation, and no more than there may be."""
        for things, key, last in (("cubes", "body", "spawned"), ("joints", "number", "joined")):
            numbers = [0, *(values[key] for values in state[things]), state[last] + 1]
            if any(one >= other for one, other in pairwise(numbers)):
                raise WorldError("bad_snapshot", f"its {things} are not numbered in order of creation")
        self.require_room(len(state["cubes"]), len(state["joints"]))

    def _add_cube(self, cube: Cube) -> None:
        self.cubes[cube.name] = cube
        self.body_names[cube.body] = cube.name

    def _add_joint(self, joint: Joint) -> None:
        self.joints[joint.name] = joint
        joint.cube1.joints[joint.name] = joint.cube2.joints[joint.name] = None

    # -- looking up ----------------------------------------------------------------------------------------------

    def states(self) -> Array:
        """Returns a new array (n, 13), a row for each cube in order of creation; see `Simulation.states`."""
        return self.simulation.states(list(self.body_names))

    def cube(self, name: str, path: str = "cube_name") -> Cube:
        """Returns a cube; `path` is the field to blame if there is none.

        Raises:
            WorldError: `cube_not_found`.
        """
        cube = self.cubes.get(name)
        if cube is None:
            raise cube_not_found(name, path)
        return cube

    def joint(self, name: str) -> Joint:
        """Returns a joint.

        Raises:
            WorldError: `joint_not_found`.
        """
        joint = self.joints.get(name)
        if joint is None:
            raise WorldError("joint_not_found", f"there is no joint {name!r}", "joint_name")
        return joint

    def require(self, capability: str, what: str, path: str | None = None) -> None:
        """Raises `unsupported` unless the engine has the capability; `path` is the field that asks for it."""
        if capability not in self._backend.capabilities:
            raise WorldError("unsupported", self._backend.refusal(capability, what), path)

    # -- cubes ---------------------------------------------------------------------------------------------------

    def require_room(self, cubes: int = 0, joints: int = 0) -> None:
        """Raises `limit_reached` unless the world may hold so many more."""
        for count, more, what in ((len(self.cubes), cubes, "cubes"), (len(self.joints), joints, "joints")):
            most = self._config["limits"][what]
            if count + more > most:
                raise WorldError("limit_reached", f"the world holds {count} of its {most} {what} already")

    def require_plane(self, planar: bool, what: str, path: str) -> None:
        """Raises `unsupported` where the engine is one of the XY plane and the thing is not in it."""
        if self._backend.dims == 2 and not planar:
            raise WorldError("unsupported", f"the {self._backend.name} backend is planar and takes no {what}", path)

    def spawn(self, command: JsonObject) -> Cube:
        """Makes the cube that a `spawn_cube` command describes; where that is in the ground, on top of it.

        Raises:
            WorldError: `limit_reached`, `cube_exists`, or `invalid` for a name, a group or a rotation.
        """
        self.require_room(cubes=1)
        group = self.groups.number(command.get("group"), "group")
        fields, default = self.fields, protocol.COMMANDS["spawn_cube"].defaults
        frozen = bool(command.get("is_base"))
        name, count = self._new_cube_name(command.get("cube_name"), "_BASE" if frozen else "")
        size, shape = command.get("size", default["size"]), self._shape(command)
        color = [float(part) for part in command.get("color", default["color"])]
        cube = Cube(
            name=name,
            body=count,
            size=vector(size) if isinstance(size, list) else (float(size),) * 3,
            mass=float(command.get("mass", default["mass"])),
            friction=float(command.get("friction", self._config["friction"])),
            restitution=float(command.get("restitution", self._config["restitution"])),
            color=(color[0], color[1], color[2], color[3] if len(color) == 4 else 1.0),
            frozen=frozen,
            group=command.get("group"),
            shape=shape,
            origin=fields.position(command.get("position", default["position"])),
        )
        quaternion = fields.rotation(command.get("rotation", default["rotation"]))
        if not frozen:
            cube.origin = self.terrain.outside([StaticBox(cube.size, cube.origin, quaternion, shape)])[0]
        self.simulation.add_body(
            cube.body,
            BodySpec(
                size=cube.size,
                mass=cube.mass,
                friction=cube.friction,
                restitution=cube.restitution,
                position=cube.origin,
                quaternion=quaternion,
                linear_velocity=fields.position(command.get("linear_velocity", ZERO)),
                angular_velocity=fields.turn(command.get("angular_velocity", ZERO)),
                frozen=cube.frozen,
                group=group,
                shape=shape,
            ),
        )
        self._spawned = count
        self._add_cube(cube)
        self.version += 1
        return cube

    def _shape(self, command: JsonObject) -> Shape:
        """Returns the shape that a `spawn_cube` command asks for.

        Raises:
            WorldError: `unsupported`, or `invalid` where it cannot have the size that is asked for.
        """
        shape: Shape = command.get("shape", "box")
        if shape != "box":
            self.require(f"shape.{shape}", f"bodies of the shape {shape}", "shape")
            size = command.get("size", 1.0)
            problem = misfit(shape, size if isinstance(size, list) else [size] * 3)
            if problem is not None:
                raise WorldError("invalid", f"size: {problem}", "size")
        return shape

    def _new_cube_name(self, name: str | None, suffix: str) -> tuple[str, int]:
        """Returns the name of the next cube, as wished or drawn, and its number in the engine."""
        count = self._spawned + 1
        if name is None:
            # A client may have called its cube by the very name that comes next.
            while (drawn := self.draw("cube", count) + suffix) in self.cubes:
                count += 1
            return drawn, count
        name += suffix
        if len(name) > _NAME_LENGTH:
            message = f"cube_name: with _BASE appended it is longer than {_NAME_LENGTH}"
            raise WorldError("invalid", message, "cube_name")
        if name in self.cubes:
            raise WorldError("cube_exists", f"there is a cube {name!r} already", "cube_name")
        return name, count

    def despawn(self, cube: Cube) -> list[str]:
        """Removes a cube and the joints that it carries; returns their names."""
        joints = list(cube.joints)
        for name in joints:
            self.cut(self.joints[name])
        self.simulation.remove_body(cube.body)
        del self.cubes[cube.name], self.body_names[cube.body]
        self.version += 1
        return joints

    def apply(self, cube: Cube, command: JsonObject) -> None:
        """Applies the forces, torques and impulses of an `apply_physics` command during the next tick."""
        fields = self.fields
        force = fields.position(command["force"]) if "force" in command else ZERO
        impulse = fields.position(command["impulse"]) if "impulse" in command else ZERO
        torque = fields.turn(command["torque"]) if "torque" in command else ZERO
        spin = fields.turn(command["angular_impulse"]) if "angular_impulse" in command else ZERO
        if "at" in command:
            arm = minus(fields.position(command["at"]), self.simulation.body_state(cube.body).position)
            torque = plus(torque, cross(arm, force))
            spin = plus(spin, cross(arm, impulse))
        self.simulation.apply(cube.body, force, torque, impulse, spin)

    def move(self, cube: Cube, command: JsonObject) -> Vector | None:
        """Puts a cube, and with it all that joints connect to it, where a `set_cube_state` command says.

        Where any of them would be in the ground, and none is frozen, all are put on top of it; returns where the cube
        is then, else None.

        Raises:
            WorldError: `invalid`: the rotation is none.
        """
        fields, old = self.fields, self.simulation.body_state(cube.body)
        new = BodyState(
            fields.position(command["position"]) if "position" in command else old.position,
            fields.rotation(command["rotation"]) if "rotation" in command else old.quaternion,
            fields.position(command["linear_velocity"]) if "linear_velocity" in command else old.linear_velocity,
            fields.turn(command["angular_velocity"]) if "angular_velocity" in command else old.angular_velocity,
        )
        rigid = "linear_velocity" in command or "angular_velocity" in command
        # Joints hold, so the whole structure moves as one.
        motion = StructureMotion(old, new, turns="rotation" in command, rigid=rigid)
        cubes = connected_cubes(cube, self.joints)
        states = [new, *(motion.moved(self.simulation.body_state(other.body)) for other in cubes[1:])]
        if ("position" in command or "rotation" in command) and not any(other.frozen for other in cubes):
            boxes = [
                StaticBox(one.size, at.position, at.quaternion, one.shape)
                for one, at in zip(cubes, states, strict=True)
            ]
            places = self.terrain.outside(boxes)
            states = [replace(state, position=place) for state, place in zip(states, places, strict=True)]
        placed = list(zip(cubes, states, strict=True))
        for other, state in (*placed[1:], placed[0]):
            self.simulation.set_body_state(other.body, state)
        self._reshaped += 1
        return None if states[0].position == new.position else states[0].position

    def paint(self, cube: Cube, color: Sequence[float]) -> None:
        """Gives a cube another colour: red, green, blue and perhaps opacity, each from 0 to 1."""
        red, green, blue, opacity = (*map(float, color), 1.0)[:4]
        cube.color = (red, green, blue, opacity)
        self._painted += 1
        self.version += 1

    def freeze(self, cube: Cube, frozen: bool) -> None:
        """Makes a cube immovable, or lets it go at rest."""
        if cube.frozen != frozen:
            self.simulation.set_frozen(cube.body, frozen)
            cube.frozen = frozen
            self.version += 1

    # -- joints --------------------------------------------------------------------------------------------------

    def connect(self, command: JsonObject, kind: str, prefix: str, skeleton: str | int | None = None) -> str:
        """Makes the joint that a `create_joint` or `create_bone` command describes; returns its name.

        Args:
            command: Its cubes, name, geometry, parameters and notes.
            kind: The joint's type, as the wire has it.
            prefix: What a drawn name begins with.
            skeleton: What a bone belongs to.

        Raises:
            WorldError: `unsupported`, `cube_not_found`, `self_joint`, `joint_exists`, `limit_reached`, or `invalid` for
                an axis, a parameter or a name.
        """
        kind = "slide" if kind == "slider" else kind
        self.require(f"joint.{kind}", f"joints of type {kind}")
        cube1, cube2 = self.cube(command["cube1"], "cube1"), self.cube(command["cube2"], "cube2")
        if cube1 is cube2:
            raise WorldError("self_joint", f"a joint needs two cubes; both are {cube1.name!r}", "cube2")
        self.require_room(joints=1)
        self.require_joinable([(cube1, cube2)], "cube2")
        anchor, axis = self._joint_geometry(command, kind, cube1, cube2)
        params = joint_params.first_params(kind, command, self._engine_step, self.require)
        notes = _notes(command.get("notes", {}))
        name, count = self._new_joint_name(command, prefix)
        spec = JointSpec(kind, cube1.body, cube2.body, anchor, axis, joint_params.engine_params(params))
        self.simulation.add_joint(count, spec)
        self._joined = count
        self._add_joint(Joint(name, count, kind, cube1, cube2, params, skeleton, notes))
        if params["motor_enabled"]:
            self.meter.add(count)
        self.version += 1
        return name

    def require_joinable(self, pairs: Sequence[tuple[Cube, Cube]], path: str) -> None:
        """Raises unless the engine takes a joint between each of these pairs; `path` is the field to blame.

        Raises:
            WorldError: `joint_exists`, where an engine has one joint a pair; `limit_reached`, where it takes no
                structure of as many cubes as would be connected.
        """
        if "joint.several" not in self._backend.capabilities:
            joined: set[frozenset[int]] = set()
            for one, two in pairs:
                pair = frozenset((one.body, two.body))
                if pair in joined or not one.joints.keys().isdisjoint(two.joints):
                    reason = f"{one.name!r} and {two.name!r} are joined already, and the {self._backend.name} backend"
                    raise WorldError("joint_exists", f"{reason} has one joint a pair", path)
                joined.add(pair)
        most = self._backend.most_joined
        if most is None or len(self.joints) + len(pairs) < most:  # so few joints connect no more
            return
        self.require_connectable(most_connected(pairs, self.joints), path)

    def require_connectable(self, cubes: int, path: str) -> None:
        """Raises `limit_reached` where the engine takes no structure of so many cubes."""
        most = self._backend.most_joined
        if most is not None and cubes > most:
            message = f"joints may connect at most {most} cubes on the {self._backend.name} backend"
            raise WorldError("limit_reached", f"{message}, and would be more here", path)

    def _new_joint_name(self, command: JsonObject, prefix: str) -> tuple[str, int]:
        """Returns the name of the next joint, as wished or drawn, and its number in the engine."""
        count, name = self._joined + 1, command.get("joint_name")
        if name is None:
            while (drawn := self.draw(prefix, count)) in self.joints:
                count += 1
            return drawn, count
        if name in self.joints:
            if not command.get("number_if_taken"):
                raise WorldError("joint_exists", f"there is a joint {name!r} already", "joint_name")
            number = 2
            while (numbered := f"{name}_{number}") in self.joints:
                number += 1
            name = numbered
            if len(name) > _NAME_LENGTH:
                message = f"joint_name: with a number appended it is longer than {_NAME_LENGTH}"
                raise WorldError("invalid", message, "joint_name")
        return name, count

    def _joint_geometry(self, command: JsonObject, kind: str, cube1: Cube, cube2: Cube) -> tuple[Vector, Vector]:
        """Returns the anchor and the axis of a new joint: the midpoint and the type's own axis where none is said."""
        here, there = (self.simulation.body_state(cube.body).position for cube in (cube1, cube2))
        if "position" in command:
            anchor = self.fields.position(command["position"])
        else:
            anchor = ((here[0] + there[0]) / 2, (here[1] + there[1]) / 2, (here[2] + there[2]) / 2)
        if "axis" in command:
            axis = self.fields.axis(kind, command["axis"])
        elif kind == "conetwist":
            axis = unit_vector(minus(there, here)) or (1.0, 0.0, 0.0)
        else:
            axis = (1.0, 0.0, 0.0) if kind == "slide" else (0.0, 0.0, 1.0)
        return anchor, axis

    def cut(self, joint: Joint) -> None:
        """Removes a joint; its cubes keep their motion."""
        self.simulation.remove_joint(joint.number)
        work = self.meter.remove(joint.number) / self.tick_rate
        joint.cube1.past_work += work
        joint.cube2.past_work += work
        del self.joints[joint.name]
        del joint.cube1.joints[joint.name], joint.cube2.joints[joint.name]
        self.version += 1

    def set_params(self, joint: Joint, changes: JsonObject, path: str, notes: JsonObject | None = None) -> None:
        """Sets parameters of a joint, all of them or none.

        Args:
            joint: The joint.
            changes: New values by name; what is no parameter is passed over.
            path: The field to blame, with `{}` for the name.
            notes: What to keep with the joint besides.

        Raises:
            WorldError: `unsupported`, `invalid`, or `limit_reached` for the notes.
        """
        now, step = joint.params, self._engine_step
        params = joint_params.changed_params(joint.kind, now, changes, step, path, self.require)
        kept = {**joint.notes, **_notes(notes or {})}
        if len(kept) > _NOTES:
            raise WorldError("limit_reached", f"a joint keeps at most {_NOTES} notes", "notes")
        joint.notes = kept
        if joint_params.CAPABILITY.keys().isdisjoint(changes):
            return
        self.simulation.set_joint_params(joint.number, joint_params.engine_params(params))
        if params["motor_enabled"] != joint.params["motor_enabled"]:
            self._reshaped += 1
        joint.params = params
        if params["motor_enabled"]:
            self.meter.add(joint.number)
        self.tuned += 1

    def work(self, cube: Cube) -> float:
        """Returns the work that the motors of all joints that a cube has, or had, have done so far, J."""
        sums = (self.meter.watts(self.joints[name].number) for name in cube.joints)
        return cube.past_work + total(watts for watts in sums if watts is not None) / self.tick_rate

    def draw(self, prefix: str, count: int) -> str:
        """Draws the name of the `count`-th thing of its kind from the seed."""
        digits = blake2b(f"{self.seed}:{prefix}:{count}".encode(), digest_size=4).hexdigest()
        return f"{prefix}_{count}_{digits}"


def _notes(notes: JsonObject) -> dict[str, float]:
    return {name: float(value) for name, value in notes.items()}


def cube_not_found(name: str, path: str = "cube_name") -> WorldError:
    """Returns the error to raise where there is no cube of that name; `path` is the field to blame."""
    return WorldError("cube_not_found", f"there is no cube {name!r}", path)


def identity(joint: Joint) -> JsonObject:
    """Returns a joint's name, type and cubes, as `joint_list` has them."""
    return {
        "joint_name": joint.name,
        "joint_type": joint.kind,
        "cube1": joint.cube1.name,
        "cube2": joint.cube2.name,
    }
