"""The cubes and joints of a world, by name, over one simulation of its engine.

Hides what a command's fields become: defaults, names drawn from the seed, Euler angles and the planar world's missing
axis, the midpoint as anchor, the wrench of a force at a point, the rigid motion of a structure, the limits on how many
there may be. It knows nothing of clients, time, modes or faults: those are the World's.

Invariants: cubes and joints are in order of creation; numbers given to the engine are never used twice; a command
that raises WorldError has changed nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from hashlib import blake2b
from math import hypot, inf
from typing import Any

import numpy as np

from nmes import protocol
from nmes.backend import (
    Array,
    Backend,
    BodySpec,
    BodyState,
    CameraSpec,
    JointSpec,
    Quaternion,
    Simulation,
    Vector,
)
from nmes.backend.rotation import (
    conjugate,
    cross,
    euler_from_quaternion,
    minus,
    multiply,
    normalize,
    plus,
    quaternion_from_euler,
    rotate,
)
from nmes.errors import WorldError
from nmes.world import joint_params as jointparams
from nmes.world import scenery
from nmes.world.energy import EnergyMeter
from nmes.world.readings import contact_list, own_axes, png
from nmes.world.subscription import moving_part

__all__ = ["Cube", "Entities", "Joint", "identity"]

JsonObject = dict[str, Any]

ZERO: Vector = (0.0, 0.0, 0.0)
_NAME_LENGTH = 128


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
    joints: dict[str, None] = field(default_factory=dict)  # in order of creation


@dataclass(slots=True)
class Joint:
    """One joint. `params` are the wire's parameters, all of them; `number` is its number in the engine."""

    name: str
    number: int
    kind: str
    cube1: Cube
    cube2: Cube
    params: JsonObject  # the wire's parameters, all of them
    skeleton: str | int | None = None


class Entities:
    """All cubes and joints of a world.

    Args:
        backend: The engine.
        config: The world's complete config.
        seed: What names are drawn from.
        version: The first structure version; it increases with every change of cubes, joints or frozenness, and
            `tuned` with every `set_param`.

    Raises:
        WorldError: The engine cannot make the config's scene, or does not know its settings.
    """

    def __init__(self, backend: Backend, config: Mapping[str, Any], seed: int, version: int) -> None:
        self.version = version
        self.tuned = 0
        self._backend = backend
        self._config = config
        self._seed = seed
        self._planar = backend.dims == 2
        for capability, path in scenery.needs(config).items():
            self.require(capability, f"scenery of this kind ({capability})", path)
        scene = scenery.scene_spec(config, seed)
        self._engine_step = scene.timestep
        self.simulation: Simulation = backend.create(scene)
        self._cubes: dict[str, Cube] = {}
        self._joints: dict[str, Joint] = {}
        self._pairs: dict[tuple[int, int], str] = {}
        self._names: dict[int, str] = {}  # by body number
        self._spawned = 0
        self._joined = 0
        self.tick_rate: int = config["tick_rate"]
        self.meter = EnergyMeter(self.simulation)

    # -- snapshots -----------------------------------------------------------------------------------------------

    def snapshot(self) -> tuple[JsonObject, bytes]:
        """Returns what the cubes and joints are as plain JSON data, and the engine's snapshot.

        Raises:
            WorldError: The engine has no snapshots (`unsupported`).
            SimulationFault: It cannot take up what was edited since the last tick.
        """
        self.require("snapshot", "snapshots")
        engine = self.simulation.snapshot()
        cubes = [
            {name: getattr(cube, name) for name in Cube.__slots__ if name != "joints"} for cube in self._cubes.values()
        ]
        joints = [
            {
                **{name: getattr(joint, name) for name in Joint.__slots__},
                "cube1": joint.cube1.name,
                "cube2": joint.cube2.name,
                "watts": self.meter.watts(joint.number),
            }
            for joint in self._joints.values()
        ]
        state = {
            "version": self.version,
            "spawned": self._spawned,
            "joined": self._joined,
            "cubes": cubes,
            "joints": joints,
        }
        return state, engine

    def restore(self, state: JsonObject, engine: bytes) -> None:
        """Takes up in a world without cubes what `snapshot` of another one returned, of the same config and seed."""
        self.version, self._spawned, self._joined = state["version"], state["spawned"], state["joined"]
        for given in state["cubes"]:
            vectors = {name: _vector(given[name]) for name in ("size", "origin")}
            cube = Cube(**{**given, **vectors, "color": tuple(given["color"])})
            self._cubes[cube.name] = cube
            self._names[cube.body] = cube.name
        for given in state["joints"]:
            ends = self._cubes[given["cube1"]], self._cubes[given["cube2"]]
            watts = given["watts"]
            joint = Joint(**{**{k: v for k, v in given.items() if k != "watts"}, "cube1": ends[0], "cube2": ends[1]})
            if watts is not None:
                self.meter.add(joint.number, watts)
            self._joints[joint.name] = joint
            self._pairs[min(end.body for end in ends), max(end.body for end in ends)] = joint.name
            for end in ends:
                end.joints[joint.name] = None
        self.simulation.restore(engine)

    # -- looking up ----------------------------------------------------------------------------------------------

    def names(self) -> list[str]:
        """Returns the cubes' names in order of creation."""
        return list(self._cubes)

    def joints(self) -> list[Joint]:
        """Returns the joints in order of creation."""
        return list(self._joints.values())

    def skeletons(self) -> list[JsonObject]:
        """Returns the skeletons in order of their oldest bones, as `world_info` has them."""
        bones: dict[str | int, list[str]] = {}
        for joint in self._joints.values():
            if joint.skeleton is not None:
                bones.setdefault(joint.skeleton, []).append(joint.name)
        return [{"snake_id": snake, "bones": names} for snake, names in bones.items()]

    def name_of(self, body: int) -> str | None:
        """Returns the name of a body of the engine, or None if it is no cube of ours."""
        return self._names.get(body)

    def states(self) -> Array:
        """Returns a new array (n, 13), a row for each of `names()`; see `Simulation.states`."""
        return self.simulation.states(list(self._names))

    def find(self, name: str) -> Cube | None:
        """Returns a cube, or None."""
        return self._cubes.get(name)

    def cube(self, name: str, path: str = "cube_name") -> Cube:
        """Returns a cube; `path` is the field to blame if there is none.

        Raises:
            WorldError: `cube_not_found`.
        """
        cube = self._cubes.get(name)
        if cube is None:
            raise WorldError("cube_not_found", f"there is no cube {name!r}", path)
        return cube

    def joint(self, name: str) -> Joint:
        """Returns a joint.

        Raises:
            WorldError: `joint_not_found`.
        """
        joint = self._joints.get(name)
        if joint is None:
            raise WorldError("joint_not_found", f"there is no joint {name!r}", "joint_name")
        return joint

    def find_joint(self, name: str) -> Joint | None:
        """Returns a joint, or None."""
        return self._joints.get(name)

    def planets(self) -> list[JsonObject]:
        """Returns the planets as `get_planets` tells them."""
        return scenery.planet_list(self._config, self._seed)

    def require(self, capability: str, what: str, path: str | None = None) -> None:
        """Raises `unsupported` unless the engine has the capability; `path` is the field that asks for it."""
        if capability not in self._backend.capabilities:
            raise WorldError("unsupported", f"the {self._backend.name} backend has no {what}", path)

    # -- cubes ---------------------------------------------------------------------------------------------------

    def require_room(self, cubes: int = 0, joints: int = 0) -> None:
        """Raises `limit_reached` unless the world may hold so many more."""
        for held, more, what in ((self._cubes, cubes, "cubes"), (self._joints, joints, "joints")):
            most = self._config["limits"][what]
            if len(held) + more > most:
                raise WorldError("limit_reached", f"the world holds {len(held)} of its {most} {what} already")

    def require_plane(self, planar: bool, what: str, path: str) -> None:
        """Raises `unsupported` where the engine is one of the XY plane and the thing is not in it."""
        if self._planar and not planar:
            raise WorldError("unsupported", f"the {self._backend.name} backend is planar and takes no {what}", path)

    def spawn(self, c: JsonObject) -> Cube:
        """Makes the cube that a `spawn_cube` command describes."""
        self.require_room(cubes=1)
        default = protocol.COMMANDS["spawn_cube"].defaults
        suffix = "_BASE" if c.get("is_base") else ""
        count = self._spawned + 1
        if "cube_name" in c:
            name = c["cube_name"] + suffix
            if len(name) > 128:
                raise WorldError("invalid", "cube_name: with _BASE appended it is longer than 128", "cube_name")
            if name in self._cubes:
                raise WorldError("cube_exists", f"there is a cube {name!r} already", "cube_name")
        else:
            # A client may have given its cube the very name that comes next.
            while (name := self.draw("cube", count) + suffix) in self._cubes:
                count += 1
        size = c.get("size", default["size"])
        friction, restitution = self._config["friction"], self._config["restitution"]
        color = [float(x) for x in c.get("color", default["color"])]
        cube = Cube(
            name=name,
            body=count,
            size=_vector(size) if isinstance(size, list) else (float(size),) * 3,
            mass=float(c.get("mass", default["mass"])),
            friction=float(c.get("friction", friction)),
            restitution=float(c.get("restitution", restitution)),
            color=(color[0], color[1], color[2], color[3] if len(color) == 4 else 1.0),
            frozen=bool(suffix),
            origin=self._position(c.get("position", default["position"])),
        )
        self.simulation.add_body(
            cube.body,
            BodySpec(
                size=cube.size,
                mass=cube.mass,
                friction=cube.friction,
                restitution=cube.restitution,
                position=cube.origin,
                quaternion=self._rotation(c.get("rotation", default["rotation"])),
                linear_velocity=self._position(c.get("linear_velocity", ZERO)),
                angular_velocity=self._turn(c.get("angular_velocity", ZERO)),
                frozen=cube.frozen,
            ),
        )
        self._spawned = count
        self._cubes[name] = cube
        self._names[cube.body] = name
        self.version += 1
        return cube

    def despawn(self, cube: Cube) -> list[str]:
        """Removes a cube and the joints that it carries; returns their names."""
        joints = list(cube.joints)
        for name in joints:
            self.cut(self._joints[name])
        self.simulation.remove_body(cube.body)
        del self._cubes[cube.name], self._names[cube.body]
        self.version += 1
        return joints

    def apply(self, cube: Cube, c: JsonObject) -> None:
        """Applies the forces, torques and impulses of an `apply_physics` command during the next tick."""
        force = self._position(c["force"]) if "force" in c else ZERO
        impulse = self._position(c["impulse"]) if "impulse" in c else ZERO
        torque = self._turn(c["torque"]) if "torque" in c else ZERO
        spin = self._turn(c["angular_impulse"]) if "angular_impulse" in c else ZERO
        if "at" in c:
            arm = minus(self._position(c["at"]), self.simulation.body_state(cube.body).position)
            torque = plus(torque, cross(arm, force))
            spin = plus(spin, cross(arm, impulse))
        self.simulation.apply(cube.body, force, torque, impulse, spin)

    def move(self, cube: Cube, c: JsonObject) -> None:
        """Puts a cube, and with it what joints connect to it, where a `set_cube_state` command says."""
        simulation = self.simulation
        old = simulation.body_state(cube.body)
        position = self._position(c["position"]) if "position" in c else old.position
        quaternion = self._rotation(c["rotation"]) if "rotation" in c else old.quaternion
        turn = multiply(quaternion, conjugate(old.quaternion)) if "rotation" in c else (0.0, 0.0, 0.0, 1.0)
        linear = self._position(c["linear_velocity"]) if "linear_velocity" in c else old.linear_velocity
        angular = self._turn(c["angular_velocity"]) if "angular_velocity" in c else old.angular_velocity
        rigid = "linear_velocity" in c or "angular_velocity" in c
        # Joints hold, so the whole structure moves as one: by the same turn and shift, and, where a velocity is
        # given, with the velocity field of a rigid body that has it.
        for other in self._connected(cube):
            if other is cube:
                continue
            state = simulation.body_state(other.body)
            arm = minus(state.position, old.position)
            arm = rotate(turn, arm) if "rotation" in c else arm
            if rigid:
                v, w = plus(linear, cross(angular, arm)), angular
            else:
                v = plus(linear, rotate(turn, minus(state.linear_velocity, old.linear_velocity)))
                w = plus(angular, rotate(turn, minus(state.angular_velocity, old.angular_velocity)))
            q = normalize(multiply(turn, state.quaternion)) if "rotation" in c else state.quaternion
            simulation.set_body_state(other.body, BodyState(plus(position, arm), q, v, w))
        simulation.set_body_state(cube.body, BodyState(position, quaternion, linear, angular))

    def _connected(self, cube: Cube) -> list[Cube]:
        """Returns the cubes that joints connect with this one, itself first."""
        found, at = {cube.body: cube}, [cube]
        for here in at:
            for name in here.joints:
                joint = self._joints[name]
                other = joint.cube2 if joint.cube1 is here else joint.cube1
                if other.body not in found:
                    found[other.body] = other
                    at.append(other)
        return at

    def freeze(self, cube: Cube, frozen: bool) -> None:
        """Makes a cube immovable, or lets it go at rest."""
        if cube.frozen != frozen:
            self.simulation.set_frozen(cube.body, frozen)
            cube.frozen = frozen
            self.version += 1

    def cube_info(self, cube: Cube) -> JsonObject:
        """Returns all there is to know about a cube, as `cube_info` has it."""
        reply = self.cube_state(cube)
        reply["size"] = cube.size
        reply["mass"] = cube.mass
        reply["friction"] = cube.friction
        reply["restitution"] = cube.restitution
        reply["color"] = cube.color
        reply["frozen"] = cube.frozen
        reply["sleeping"] = self.simulation.sleeping(cube.body)
        reply["joints"] = list(cube.joints)
        reply["contacts"] = contact_list(self.simulation.contacts(cube.body), reply["quaternion"], self._names)
        return reply

    def inertial(self, cubes: list[Cube]) -> list[JsonObject]:
        """Returns what the accelerometers and gyros of cubes read."""
        self.require("sensors.inertial", "accelerometers and gyros", "sensors")
        bodies = [cube.body for cube in cubes]
        states, felt = self.simulation.states(bodies).tolist(), self.simulation.proper_accelerations(bodies).tolist()
        return [
            {"accelerometer": own_axes(state[3:7], acceleration), "gyro": own_axes(state[3:7], state[10:13])}
            for state, acceleration in zip(states, felt, strict=True)
        ]

    def ranges(self, cube: Cube, rays: list[list[float]], limit: float) -> list[float | None]:
        """Returns the distances from a cube's centre along directions in its own frame."""
        self.require("sensors.range", "range finder", "rays")
        quaternion = self.simulation.body_state(cube.body).quaternion
        directions = []
        for i, ray in enumerate(rays):
            unit = _unit(self._position(ray))
            if unit is None:
                raise WorldError(
                    "invalid", f"rays/{i}: must have a direction, and in a planar world one in it", f"rays/{i}"
                )
            directions.append(rotate(quaternion, unit))
        return self.simulation.ranges(cube.body, np.array(directions).reshape(-1, 3), limit) if directions else []

    def camera(self, cube: Cube, c: JsonObject) -> JsonObject:
        """Returns what the camera of a `get_camera` command sees, as `camera_image` has it."""
        self.require("camera", "cameras")
        c = {**protocol.COMMANDS["get_camera"].defaults, **c}
        state = self.simulation.body_state(cube.body)
        image = self.simulation.draw(
            CameraSpec(
                width=c["width"],
                height=c["height"],
                fov=float(c["fov"]),
                position=plus(state.position, rotate(state.quaternion, self._position(c["position"]))),
                quaternion=normalize(multiply(state.quaternion, self._rotation(c["rotation"]))),
            ),
            {other.body: other.color for other in self._cubes.values()},
        )
        return {"cube_name": cube.name, "width": c["width"], "height": c["height"], "image": png(image)}

    def cube_state(self, cube: Cube) -> JsonObject:
        """Returns the moving part of a cube's info."""
        state = self.simulation.body_state(cube.body)
        return {
            "cube_name": cube.name,
            "position": state.position,
            "rotation": euler_from_quaternion(state.quaternion),
            "quaternion": state.quaternion,
            "linear_velocity": state.linear_velocity,
            "angular_velocity": state.angular_velocity,
        }

    def moving(self, cubes: list[Cube], sensors: bool = False) -> list[JsonObject]:
        """Returns the moving part of several cubes, and what their `sensors` read."""
        states = self.simulation.states([cube.body for cube in cubes]).tolist()
        parts = [moving_part(cube.name, state) for cube, state in zip(cubes, states, strict=True)]
        if sensors:
            for cube, part, inertial in zip(cubes, parts, self.inertial(cubes), strict=True):
                touched = self.simulation.contacts(cube.body)
                part["contacts"] = contact_list(touched, part["quaternion"], self._names)
                part.update(inertial)
        return parts

    # -- joints --------------------------------------------------------------------------------------------------

    def connect(
        self, c: JsonObject, kind: str, prefix: str, skeleton: str | int | None = None, name: str | None = None
    ) -> str:
        """Makes the joint that a `create_joint` or `create_bone` command describes; returns its name.

        A bone belongs to a `skeleton`. A `name` that is not given is drawn; one that is must not be taken.
        """
        kind = "slide" if kind == "slider" else kind
        self.require(f"joint.{kind}", f"joints of type {kind}")
        cube1, cube2 = self.cube(c["cube1"], "cube1"), self.cube(c["cube2"], "cube2")
        if cube1 is cube2:
            raise WorldError("self_joint", f"a joint needs two cubes; both are {cube1.name!r}", "cube2")
        pair = (min(cube1.body, cube2.body), max(cube1.body, cube2.body))
        if pair in self._pairs:
            raise WorldError("joint_exists", f"these cubes are joined by {self._pairs[pair]!r} already")
        self.require_room(joints=1)
        here, there = (self.simulation.body_state(cube.body).position for cube in (cube1, cube2))
        if "position" in c:
            anchor = self._position(c["position"])
        else:
            anchor = ((here[0] + there[0]) / 2, (here[1] + there[1]) / 2, (here[2] + there[2]) / 2)
        if "axis" in c:
            axis = self._axis(kind, c["axis"])
        elif kind == "conetwist":
            axis = _unit(minus(there, here)) or (1.0, 0.0, 0.0)
        else:
            axis = (1.0, 0.0, 0.0) if kind == "slide" else (0.0, 0.0, 1.0)
        given = {name: c[name] for name in jointparams.CAPABILITY if name in c}
        if "limits" in c:
            given["limit_lower"], given["limit_upper"] = c["limits"]
            given["limit_enabled"] = True
        for parameter in given:
            self._require_param(kind, parameter, parameter)
        params = jointparams.adjust(
            kind, jointparams.default_params(self._engine_step), given, self._engine_step, path=None
        )
        count = self._joined + 1
        while name is None and self.draw(prefix, count) in self._joints:
            count += 1
        drawn = name or self.draw(prefix, count)
        self.simulation.add_joint(
            count, JointSpec(kind, cube1.body, cube2.body, anchor, axis, jointparams.engine_params(params))
        )
        self._joined = count
        self._joints[drawn] = Joint(drawn, count, kind, cube1, cube2, params, skeleton)
        self._pairs[pair] = drawn
        cube1.joints[drawn] = cube2.joints[drawn] = None
        if params["motor_enabled"]:
            self.meter.add(count)
        self.version += 1
        return drawn

    def _axis(self, kind: str, value: list[float]) -> Vector:
        axis = self._turn(value) if kind == "hinge" else self._position(value)
        unit = _unit(axis)
        if unit is None:
            raise WorldError("invalid", "axis: must have a direction, and in a planar world one in it", "axis")
        return unit

    def cut(self, joint: Joint) -> None:
        """Removes a joint; its cubes keep their motion."""
        self.simulation.remove_joint(joint.number)
        work = self.meter.remove(joint.number) / self.tick_rate
        joint.cube1.past_work += work
        joint.cube2.past_work += work
        bodies = joint.cube1.body, joint.cube2.body
        del self._joints[joint.name], self._pairs[min(bodies), max(bodies)]
        del joint.cube1.joints[joint.name], joint.cube2.joints[joint.name]
        self.version += 1

    def set_param(self, joint: Joint, name: str, value: float | bool) -> None:
        """Sets one parameter of a joint."""
        self._require_param(joint.kind, name, "param_name")
        params = jointparams.adjust(joint.kind, joint.params, {name: value}, self._engine_step, path="value")
        self.simulation.set_joint_params(joint.number, jointparams.engine_params(params))
        joint.params = params
        if params["motor_enabled"]:
            self.meter.add(joint.number)
        self.tuned += 1

    def _require_param(self, kind: str, name: str, path: str) -> None:
        if kind not in ("hinge", "slide") and not (kind == "conetwist" and name.startswith("limit")):
            raise WorldError("unsupported", f"a {kind} joint has no {name}", path)
        self.require(jointparams.CAPABILITY[name], f"{name} for joints")

    def joint_info(self, joint: Joint) -> JsonObject:
        """Returns all there is to know about a joint, as `joint_info` has it."""
        reading = self.simulation.joint_state(joint.number)
        return {
            **identity(joint),
            "anchor": reading.anchor,
            "axis": reading.axis,
            "position": reading.position,
            "velocity": reading.velocity,
            "effort": reading.effort,
            "params": joint.params,
        }

    def work(self, cube: Cube) -> float:
        """Returns what the motors of all joints that a cube has, or had, have worked so far, J."""
        sums = (self.meter.watts(self._joints[name].number) for name in cube.joints)
        return cube.past_work + sum(watts for watts in sums if watts is not None) / self.tick_rate

    # -- reading fields ------------------------------------------------------------------------------------------

    def draw(self, prefix: str, count: int) -> str:
        """Draws the name of the `count`-th thing of its kind from the seed."""
        digits = blake2b(f"{self._seed}:{prefix}:{count}".encode(), digest_size=4).hexdigest()
        return f"{prefix}_{count}_{digits}"

    def _position(self, value: list[float]) -> Vector:
        x, y, z = value
        return (float(x), float(y), 0.0 if self._planar else float(z))

    def _turn(self, value: list[float]) -> Vector:
        """Reads an angular vector: torque, angular velocity, angular impulse."""
        x, y, z = value
        return (0.0, 0.0, float(z)) if self._planar else (float(x), float(y), float(z))

    def _rotation(self, value: list[float]) -> Quaternion:
        if len(value) == 3:
            return quaternion_from_euler(*self._turn(value))
        try:
            q = normalize((float(value[0]), float(value[1]), float(value[2]), float(value[3])))
        except (ZeroDivisionError, OverflowError):
            raise WorldError("invalid", "rotation: a quaternion must not be zero", "rotation") from None
        return quaternion_from_euler(*self._turn(list(euler_from_quaternion(q)))) if self._planar else q


def _vector(value: list[float]) -> Vector:
    x, y, z = value
    return (float(x), float(y), float(z))


def _unit(v: Vector) -> Vector | None:
    length = hypot(*v)
    return (v[0] / length, v[1] / length, v[2] / length) if 1e-9 < length < inf else None


def identity(joint: Joint) -> JsonObject:
    """Returns what `joint_list` says of a joint."""
    return {
        "joint_name": joint.name,
        "joint_type": joint.kind,
        "cube1": joint.cube1.name,
        "cube2": joint.cube2.name,
    }
