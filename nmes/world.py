"""The world: a deterministic state machine of cubes, joints, clients and frames over any physics engine.

It hides the engine, and keeps all that must mean the same over every engine: names, order, ownership, error codes,
joint parameters, modes, subscriptions. Commands and ticks go in, replies and events come out; each of them is told
to the journal, in the one order that makes up the world's history.

Invariants:

- The same config and the same inputs in the same order give the same replies, events and digests. Nothing here
  reads a clock, a socket, a file or an unseeded random number; the host decides when `tick` is called.
- Each command gets exactly one reply. One that is refused changes nothing; only in a `batch` do the parts before a
  refused one stand.
- Nothing a client sends makes `handle` raise. An engine that fails faults this world alone, until `reset`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from hashlib import blake2b
from importlib.metadata import version
from math import hypot, inf
from typing import Any, ClassVar, Protocol

import numpy as np

from nmes import protocol
from nmes.backend import (
    Array,
    Backend,
    BodySpec,
    BodyState,
    JointParams,
    JointSpec,
    Quaternion,
    SceneSpec,
    Simulation,
    Vector,
    load_backend,
)
from nmes.errors import NmesError, RecordingError, SimulationFault, WorldError
from nmes.protocol import Request
from nmes.rotation import (
    conjugate,
    cross,
    euler_from_quaternion,
    multiply,
    normalize,
    quaternion_from_euler,
    rotate,
)

__all__ = ["Fault", "Journal", "World"]

logger = logging.getLogger(__name__)

JsonObject = dict[str, Any]

ZERO: Vector = (0.0, 0.0, 0.0)

# The wire's joint parameters, and the capability that an engine must have for each.
_PARAM_CAPABILITY = {
    "motor_target_velocity": "motor",
    "motor_max_impulse": "motor",
    "motor_max_force": "motor",
    "motor_enabled": "motor",
    "target_position": "servo",
    "stiffness": "spring",
    "damping": "spring",
    "limit_lower": "limits",
    "limit_upper": "limits",
    "limit_enabled": "limits",
}
_SWITCHES = frozenset({"motor_enabled", "limit_enabled"})
_NOT_NEGATIVE = frozenset({"motor_max_impulse", "motor_max_force", "stiffness", "damping"})

# A faulted world still answers these: they ask nothing of the engine.
_WHEN_FAULTED = frozenset({"ping", "get_world_info", "reset", "subscribe", "unsubscribe"})


class Journal(Protocol):
    """Where a world's history goes: a recorder, or a replay that compares. Called in the order of the history.

    A journal that cannot keep what it is told raises RecordingError, and the world faults with its code.
    """

    def joined(self, client: int) -> None:
        """A client came."""

    def left(self, client: int) -> None:
        """A client went."""

    def received(self, client: int, request: Request) -> None:
        """A frame came from a client; it is executed next."""

    def replied(self, client: int, request: Request, reply: bytes) -> None:
        """The frame was executed; `reply` is encoded, without delimiter."""

    def ticked(self, frame: int, digest: bytes) -> None:
        """The world reached `frame`."""

    def faulted(self, frame: int, code: str, message: str) -> None:
        """The world stopped at `frame`."""


@dataclass(frozen=True, slots=True)
class Fault:
    """Why a world has stopped: a code of `world_fault`, a message for a person, the last good frame."""

    code: str
    message: str
    frame: int


@dataclass(slots=True)
class _Cube:
    name: str
    body: int
    size: Vector
    mass: float
    friction: float
    restitution: float
    color: tuple[float, float, float, float]
    frozen: bool
    joints: dict[str, None] = field(default_factory=dict)  # in order of creation


@dataclass(slots=True)
class _Joint:
    name: str
    number: int
    kind: str
    cube1: _Cube
    cube2: _Cube
    params: JsonObject  # the wire's parameters, all of them


@dataclass(slots=True)
class _Subscription:
    events: tuple[str, ...]
    every: int
    position_threshold: float
    rotation_threshold: float
    version: int = -1  # of the structure that `bodies` and `sent` are aligned with
    names: list[str] = field(default_factory=list)
    sent: Array = field(default_factory=lambda: np.empty((0, 7)))  # poses as last sent; NaN: never
    removed: list[str] = field(default_factory=list)


@dataclass(slots=True)
class _Client:
    number: int
    owned: str | None = None
    subscription: _Subscription | None = None


class World:
    """One simulated place.

    Args:
        config: A world config (schemas/world_config.json); what is left out has its default.
        journal: Where the history goes. May be set later, before the first input that it should see.
        emit: Called with a client's number and an encoded event (no delimiter) for each event to a subscriber.

    Raises:
        RejectedMessage: The config is not valid; `path` names the field.
        BackendNotFound: No such engine.
    """

    def __init__(
        self,
        config: Mapping[str, Any] | None = None,
        *,
        journal: Journal | None = None,
        emit: Callable[[int, bytes], None] | None = None,
    ) -> None:
        self.config: JsonObject = protocol.complete_config(config or {})
        self.journal = journal
        self.emit = emit
        self.backend: Backend = load_backend(self.config["backend"])
        self.mode: str = self.config["mode"]
        self.rate = float(self.config["rate"])
        self.paused = False
        self.structure_version = 0
        self._planar = self.backend.dims == 2
        self._tick_rate: int = self.config["tick_rate"]
        self._substeps: int = self.config["substeps"]
        self._engine_step = 1.0 / (self._tick_rate * self._substeps)
        self._scene = SceneSpec(
            timestep=self._engine_step,
            gravity=_vector(self.config["gravity"]),
            max_bodies=self.config["limits"]["cubes"],
            options=self.config["engine"],
        )
        self._clients: dict[int, _Client] = {}
        self._next_client = 1
        self._simulation: Simulation | None = None
        self._begin(self.config["seed"])

    def _begin(self, seed: int) -> None:
        """Makes the empty world of frame 0."""
        if self._simulation is not None:
            self._simulation.close()
        self._simulation = self.backend.create(self._scene)
        self.seed = seed
        self.frame = 0
        self.fault: Fault | None = None
        self.structure_version += 1
        self._cubes: dict[str, _Cube] = {}
        self._joints: dict[str, _Joint] = {}
        self._pairs: dict[tuple[int, int], str] = {}
        self._names_by_body: dict[int, str] = {}
        self._spawned = 0
        self._joined = 0

    # -- what hosts, recorders and scripts ask -------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Simulation time in s."""
        return self.frame / self._tick_rate

    @property
    def running(self) -> bool:
        """Whether the world ticks by itself now: not in lockstep, not paused, not faulted."""
        return self.mode != "lockstep" and not self.paused and self.fault is None

    @property
    def simulation(self) -> Simulation:
        """The running scene, for benchmarks and tests; whoever edits it breaks the world's promises."""
        assert self._simulation is not None
        return self._simulation

    def digest(self) -> bytes:
        """Returns the 16 bytes that stand for the engine's whole state."""
        return self.simulation.digest()

    def cubes(self) -> list[str]:
        """Returns the cubes' names in order of creation."""
        return list(self._cubes)

    def poses(self) -> tuple[list[str], Array]:
        """Returns the names and a new array (n, 13) of positions, quaternions, linear and angular velocities."""
        return list(self._cubes), self.simulation.states(list(self._names_by_body))

    def cube_shape(self, name: str) -> tuple[Vector, tuple[float, float, float, float]]:
        """Returns a cube's edge lengths (m) and colour (RGBA, 0 to 1)."""
        cube = self._cubes[name]
        return cube.size, cube.color

    def welcome(self, client: int) -> JsonObject:
        """Returns the `auth_success` message for a client that has joined."""
        return {
            "type": "auth_success",
            "protocol": protocol.PROTOCOL_VERSION,
            "client": client,
            "world": self.config["name"],
            "backend": self.backend.name,
            "dims": self.backend.dims,
            "timestep": 1.0 / self._tick_rate,
            "tick_rate": self._tick_rate,
            "mode": self.mode,
        }

    # -- inputs --------------------------------------------------------------------------------------------------

    def join(self) -> int:
        """Lets a client in and returns its number, never used before in this world."""
        number = self._next_client
        self._next_client += 1
        self._clients[number] = _Client(number)
        self._tell(lambda journal: journal.joined(number))
        return number

    def leave(self, client: int) -> None:
        """Forgets a client's ownership and subscription; its cubes stay."""
        del self._clients[client]
        self._tell(lambda journal: journal.left(client))

    def handle(self, client: int, request: Request) -> bytes:
        """Executes one frame and returns the encoded reply, without delimiter. The one door for commands."""
        journal = self.journal
        if journal is None:
            return protocol.encode(self._answer(self._clients[client], request))
        try:
            journal.received(client, request)
            reply = self._answer(self._clients[client], request)
            encoded = protocol.encode(reply)
            journal.replied(client, request, encoded)
        except RecordingError as error:
            self._lose_journal(error)
            return protocol.encode(self._answer(self._clients[client], request))
        return encoded

    def execute(self, client: int, command: Mapping[str, Any]) -> JsonObject:
        """Executes a command given as a dict and returns the reply as one; else the same as `handle`."""
        return protocol.decode(self.handle(client, protocol.request_from(dict(command))))

    def tick(self) -> None:
        """Advances by one tick of `1 / tick_rate` s. Does nothing in a faulted world."""
        if self.fault is not None:
            return
        simulation = self._simulation
        assert simulation is not None
        try:
            simulation.step(self._substeps)
            digest = simulation.digest()
        except SimulationFault as fault:
            self._stop(fault.code, fault.message, fault.body)
            return
        except Exception as error:
            # An adapter's own mistake must not take the host down with all its other worlds, but it must be loud.
            logger.exception("the engine of world %r failed", self.config["name"])
            self._stop("engine_failed", f"{type(error).__name__}: {error}", None)
            return
        self.frame += 1
        if self.journal is not None:
            try:
                self.journal.ticked(self.frame, digest)
            except RecordingError as error:
                self._lose_journal(error)
                return
        if self._clients:
            self._send_events()

    def stop_recording(self, error: RecordingError) -> None:
        """Faults the world because its history can no longer be kept; for hosts that flush on a timer."""
        self._lose_journal(error)

    def close(self) -> None:
        """Tells subscribers that the world is closed and releases the engine."""
        self._emit_to_subscribers({"type": "world_closed"})
        if self._simulation is not None:
            self._simulation.close()
            self._simulation = None

    # -- faults and events ---------------------------------------------------------------------------------------

    def _tell(self, call: Callable[[Journal], None]) -> None:
        if self.journal is not None:
            try:
                call(self.journal)
            except RecordingError as error:
                self._lose_journal(error)

    def _lose_journal(self, error: RecordingError) -> None:
        # Never on unrecorded: this fault stays, `reset` does not lift it.
        self.journal = None
        self._stop("recording_failed", error.message, None)

    def _stop(self, code: str, message: str, body: int | None) -> None:
        if body is not None and body in self._names_by_body:
            message = f"{message} (cube {self._names_by_body[body]})"
        self.fault = fault = Fault(code, message, self.frame)
        self._tell(lambda journal: journal.faulted(fault.frame, code, message))
        self._emit_to_subscribers({"type": "world_fault", "code": code, "frame": fault.frame, "message": message})

    def _emit_to_subscribers(self, event: JsonObject) -> None:
        if self.emit is not None:
            encoded = protocol.encode(event)
            for client in self._clients.values():
                if client.subscription is not None:
                    self.emit(client.number, encoded)

    def _send_events(self) -> None:
        emit, frame, tick, states = self.emit, self.frame, b"", None
        for client in self._clients.values():
            subscription = client.subscription
            if subscription is None or emit is None or frame % subscription.every:
                continue
            if "tick" in subscription.events:
                tick = tick or protocol.encode({"type": "tick", "t": self.time, "frame": frame})
                emit(client.number, tick)
            if "state" in subscription.events:
                if states is None:
                    states = self.simulation.states(list(self._names_by_body))
                event = self._state_event(subscription, states)
                if event is not None:
                    emit(client.number, protocol.encode(event))

    def _state_event(self, subscription: _Subscription, states: Array) -> JsonObject | None:
        if subscription.version != self.structure_version:
            self._align(subscription)
        poses, sent = states[:, :7], subscription.sent
        distance = np.sqrt(np.sum((poses[:, :3] - sent[:, :3]) ** 2, axis=1))
        # The chord between two unit quaternions: exactly 0 when nothing turned, unlike the arc cosine of their dot.
        chord = np.minimum(
            np.sqrt(np.sum((poses[:, 3:] - sent[:, 3:]) ** 2, axis=1)),
            np.sqrt(np.sum((poses[:, 3:] + sent[:, 3:]) ** 2, axis=1)),
        )
        angle = 4.0 * np.arcsin(np.minimum(1.0, chord / 2.0))
        # Written as "not within", so that NaN (never sent) counts as moved.
        within = (distance <= subscription.position_threshold) & (angle <= subscription.rotation_threshold)
        moved = np.flatnonzero(~within)
        removed, subscription.removed = subscription.removed, []
        if not len(moved) and not removed:
            return None
        sent[moved] = poses[moved]
        return {
            "type": "state",
            "t": self.time,
            "frame": self.frame,
            "cubes": [_moving_part(subscription.names[i], states[i].tolist()) for i in moved.tolist()],
            "removed": removed,
        }

    def _align(self, subscription: _Subscription) -> None:
        """Brings what a subscriber was sent in line with the cubes that there are now."""
        rows = {name: i for i, name in enumerate(subscription.names)}
        names = list(self._cubes)
        sent = np.full((len(names), 7), np.nan)
        for i, name in enumerate(names):
            row = rows.pop(name, None)
            if row is not None:
                sent[i] = subscription.sent[row]
        subscription.removed += [name for name, row in rows.items() if not np.isnan(subscription.sent[row, 0])]
        subscription.names, subscription.sent, subscription.version = names, sent, self.structure_version

    # -- commands ------------------------------------------------------------------------------------------------

    def _answer(self, client: _Client, request: Request) -> JsonObject:
        command = request.command
        if command is None:
            assert request.error is not None
            reply = protocol.error_reply(request.error, request.type)
            if request.id is not protocol.NO_ID:
                reply["id"] = request.id
            return reply
        reply = self._perform(client, command)
        if "id" in command:
            reply["id"] = command["id"]
        return reply

    def _perform(self, client: _Client, command: JsonObject) -> JsonObject:
        kind: str = command["type"]
        try:
            if self.fault is not None and (
                kind not in _WHEN_FAULTED or (kind == "reset" and self.fault.code == "recording_failed")
            ):
                raise WorldError(
                    "world_faulted", f"the world stopped at frame {self.fault.frame}: {self.fault.message}"
                )
            return self.COMMANDS[kind](self, client, command)
        except NmesError as error:
            if isinstance(error, RecordingError):
                raise
            if isinstance(error, SimulationFault):
                self._stop(error.code, error.message, error.body)
                error = WorldError("world_faulted", error.message)
            return protocol.error_reply(error, kind)
        except Exception as error:
            logger.exception("command %r of world %r failed", kind, self.config["name"])
            self._stop("internal", f"{type(error).__name__}: {error}", None)
            return protocol.error_reply(WorldError("internal", "the world failed; see the server's log"), kind)

    def _require(self, capability: str, what: str) -> None:
        if capability not in self.backend.capabilities:
            raise WorldError("unsupported", f"the {self.backend.name} backend has no {what}")

    def _cube(self, name: str, path: str = "cube_name") -> _Cube:
        cube = self._cubes.get(name)
        if cube is None:
            raise WorldError("cube_not_found", f"there is no cube {name!r}", path)
        return cube

    def _cube_or_own(self, client: _Client, command: JsonObject) -> _Cube:
        name = command.get("cube_name")
        if name is not None:
            return self._cube(name)
        if client.owned is None:
            raise WorldError("nothing_owned", "no cube_name given, and this connection has spawned no cube")
        cube = self._cubes.get(client.owned)
        if cube is None:
            raise WorldError("nothing_owned", f"the cube of this connection, {client.owned!r}, is gone")
        return cube

    def _joint(self, name: str) -> _Joint:
        joint = self._joints.get(name)
        if joint is None:
            raise WorldError("joint_not_found", f"there is no joint {name!r}", "joint_name")
        return joint

    def _draw(self, prefix: str, count: int) -> str:
        """Draws the name of the `count`-th thing of its kind from the seed."""
        digits = blake2b(f"{self.seed}:{prefix}:{count}".encode(), digest_size=4).hexdigest()
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

    # -- commands: cubes -----------------------------------------------------------------------------------------

    def _spawn_cube(self, client: _Client, c: JsonObject, listed: bool = True) -> JsonObject:
        if len(self._cubes) >= self.config["limits"]["cubes"]:
            raise WorldError("limit_reached", f"the world holds its {len(self._cubes)} cubes already")
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
            while (name := self._draw("cube", count) + suffix) in self._cubes:
                count += 1
        size = c.get("size", default["size"])
        friction, restitution = self.config["friction"], self.config["restitution"]
        color = [float(x) for x in c.get("color", default["color"])]
        cube = _Cube(
            name=name,
            body=count,
            size=_vector(size) if isinstance(size, list) else (float(size),) * 3,
            mass=float(c.get("mass", default["mass"])),
            friction=float(c.get("friction", friction)),
            restitution=float(c.get("restitution", restitution)),
            color=(color[0], color[1], color[2], color[3] if len(color) == 4 else 1.0),
            frozen=bool(suffix),
        )
        self.simulation.add_body(
            cube.body,
            BodySpec(
                size=cube.size,
                mass=cube.mass,
                friction=cube.friction,
                restitution=cube.restitution,
                position=self._position(c.get("position", default["position"])),
                quaternion=self._rotation(c.get("rotation", default["rotation"])),
                linear_velocity=self._position(c.get("linear_velocity", ZERO)),
                angular_velocity=self._turn(c.get("angular_velocity", ZERO)),
                frozen=cube.frozen,
            ),
        )
        self._spawned = count
        self._cubes[name] = cube
        self._names_by_body[cube.body] = name
        self.structure_version += 1
        client.owned = name
        reply: JsonObject = {"type": "cube_list", "spawned": name}
        if c.get("list", listed):
            reply["cubes"] = list(self._cubes)
        return reply

    def _despawn_cube(self, client: _Client, c: JsonObject) -> JsonObject:
        cube = self._cube(c["cube_name"])
        joints = list(cube.joints)
        for name in joints:
            self._cut(self._joints[name])
        self.simulation.remove_body(cube.body)
        del self._cubes[cube.name], self._names_by_body[cube.body]
        self.structure_version += 1
        return {"type": "cube_despawned", "cube_name": cube.name, "joints": joints}

    def _apply_physics(self, client: _Client, c: JsonObject) -> JsonObject:
        cube = self._cube_or_own(client, c)
        force = self._position(c["force"]) if "force" in c else ZERO
        impulse = self._position(c["impulse"]) if "impulse" in c else ZERO
        torque = self._turn(c["torque"]) if "torque" in c else ZERO
        spin = self._turn(c["angular_impulse"]) if "angular_impulse" in c else ZERO
        if "at" in c:
            arm = _minus(self._position(c["at"]), self.simulation.body_state(cube.body).position)
            torque = _plus(torque, cross(arm, force))
            spin = _plus(spin, cross(arm, impulse))
        self.simulation.apply(cube.body, force, torque, impulse, spin)
        return {"type": "physics_applied", "cube_name": cube.name}

    def _set_cube_state(self, client: _Client, c: JsonObject) -> JsonObject:
        cube = self._cube(c["cube_name"])
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
        for other in self._structure(cube):
            if other is cube:
                continue
            state = simulation.body_state(other.body)
            arm = _minus(state.position, old.position)
            arm = rotate(turn, arm) if "rotation" in c else arm
            if rigid:
                v, w = _plus(linear, cross(angular, arm)), angular
            else:
                v = _plus(linear, rotate(turn, _minus(state.linear_velocity, old.linear_velocity)))
                w = _plus(angular, rotate(turn, _minus(state.angular_velocity, old.angular_velocity)))
            q = normalize(multiply(turn, state.quaternion)) if "rotation" in c else state.quaternion
            simulation.set_body_state(other.body, BodyState(_plus(position, arm), q, v, w))
        simulation.set_body_state(cube.body, BodyState(position, quaternion, linear, angular))
        return {"type": "cube_state_set", "cube_name": cube.name}

    def _structure(self, cube: _Cube) -> list[_Cube]:
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

    def _freeze_cube(self, client: _Client, c: JsonObject) -> JsonObject:
        cube = self._cube(c["cube_name"])
        if cube.frozen != c["freeze"]:
            self.simulation.set_frozen(cube.body, c["freeze"])
            cube.frozen = c["freeze"]
            self.structure_version += 1
        return {"type": "cube_frozen", "cube_name": cube.name, "freeze": cube.frozen}

    def _get_cube_list(self, client: _Client, c: JsonObject) -> JsonObject:
        return {"type": "cube_list", "cubes": list(self._cubes)}

    def _get_cube_state(self, client: _Client, c: JsonObject) -> JsonObject:
        cube = self._cube_or_own(client, c)
        return {"type": "cube_state", **self._state(cube)}

    def _get_cube_info(self, client: _Client, c: JsonObject) -> JsonObject:
        cube = self._cube(c["cube_name"])
        reply = {"type": "cube_info", **self._state(cube)}
        reply["size"] = cube.size
        reply["mass"] = cube.mass
        reply["friction"] = cube.friction
        reply["restitution"] = cube.restitution
        reply["color"] = cube.color
        reply["frozen"] = cube.frozen
        reply["sleeping"] = self.simulation.sleeping(cube.body)
        reply["joints"] = list(cube.joints)
        reply["contacts"] = [
            {
                "cube_name": None if contact.other is None else self._names_by_body[contact.other],
                "position": contact.position,
                "normal": contact.normal,
                "force": contact.force,
            }
            for contact in self.simulation.contacts(cube.body)
        ]
        return reply

    def _state(self, cube: _Cube) -> JsonObject:
        state = self.simulation.body_state(cube.body)
        return {
            "cube_name": cube.name,
            "position": state.position,
            "rotation": euler_from_quaternion(state.quaternion),
            "quaternion": state.quaternion,
            "linear_velocity": state.linear_velocity,
            "angular_velocity": state.angular_velocity,
        }

    # -- commands: joints ----------------------------------------------------------------------------------------

    def _create_joint(self, client: _Client, c: JsonObject) -> JsonObject:
        return {"type": "joint_created", "joint_name": self._connect(c, c["joint_type"], "joint")}

    def _create_bone(self, client: _Client, c: JsonObject) -> JsonObject:
        return {"type": "bone_created", "bone_name": self._connect(c, "conetwist", "bone")}

    def _connect(self, c: JsonObject, kind: str, prefix: str) -> str:
        kind = "slide" if kind == "slider" else kind
        self._require(f"joint.{kind}", f"joints of type {kind}")
        cube1, cube2 = self._cube(c["cube1"], "cube1"), self._cube(c["cube2"], "cube2")
        if cube1 is cube2:
            raise WorldError("self_joint", f"a joint needs two cubes; both are {cube1.name!r}", "cube2")
        pair = (min(cube1.body, cube2.body), max(cube1.body, cube2.body))
        if pair in self._pairs:
            raise WorldError("joint_exists", f"these cubes are joined by {self._pairs[pair]!r} already")
        if len(self._joints) >= self.config["limits"]["joints"]:
            raise WorldError("limit_reached", f"the world holds its {len(self._joints)} joints already")
        here, there = (self.simulation.body_state(cube.body).position for cube in (cube1, cube2))
        if "position" in c:
            anchor = self._position(c["position"])
        else:
            anchor = ((here[0] + there[0]) / 2, (here[1] + there[1]) / 2, (here[2] + there[2]) / 2)
        if "axis" in c:
            axis = self._axis(kind, c["axis"])
        elif kind == "conetwist":
            axis = _unit(_minus(there, here)) or (1.0, 0.0, 0.0)
        else:
            axis = (1.0, 0.0, 0.0) if kind == "slide" else (0.0, 0.0, 1.0)
        params: JsonObject = {
            "motor_target_velocity": 0.0,
            "motor_max_impulse": 1.0,
            "motor_max_force": 1.0 / self._engine_step,
            "motor_enabled": False,
            "target_position": None,
            "stiffness": 0.0,
            "damping": 0.0,
            "limit_lower": 0.0,
            "limit_upper": 0.0,
            "limit_enabled": False,
        }
        given = [(name, c[name]) for name in _PARAM_CAPABILITY if name in c]
        if "limits" in c:
            lower, upper = c["limits"]
            given += [("limit_lower", lower), ("limit_upper", upper), ("limit_enabled", True)]
        for name, value in given:
            self._check_param(kind, name, value, name)
            _put(params, name, value, self._engine_step)
        _check_limits(params, "limits")
        count = self._joined + 1
        while (name := self._draw(prefix, count)) in self._joints:
            count += 1
        self.simulation.add_joint(
            count, JointSpec(kind, cube1.body, cube2.body, anchor, axis, _engine_params(params))
        )
        self._joined = count
        self._joints[name] = _Joint(name, count, kind, cube1, cube2, params)
        self._pairs[pair] = name
        cube1.joints[name] = cube2.joints[name] = None
        self.structure_version += 1
        return name

    def _axis(self, kind: str, value: list[float]) -> Vector:
        axis = self._turn(value) if kind == "hinge" else self._position(value)
        unit = _unit(axis)
        if unit is None:
            raise WorldError("invalid", "axis: must have a direction, and in a planar world one in it", "axis")
        return unit

    def _cut(self, joint: _Joint) -> None:
        self.simulation.remove_joint(joint.number)
        bodies = joint.cube1.body, joint.cube2.body
        del self._joints[joint.name], self._pairs[min(bodies), max(bodies)]
        del joint.cube1.joints[joint.name], joint.cube2.joints[joint.name]
        self.structure_version += 1

    def _remove_joint(self, client: _Client, c: JsonObject) -> JsonObject:
        joint = self._joint(c["joint_name"])
        self._cut(joint)
        return {"type": "joint_removed", "joint_name": joint.name}

    def _set_joint_param(self, client: _Client, c: JsonObject) -> JsonObject:
        joint = self._joint(c["joint_name"])
        name, value = c["param_name"], c["value"]
        self._check_param(joint.kind, name, value, "value")
        params = dict(joint.params)
        _put(params, name, value, self._engine_step)
        _check_limits(params, "value")
        self.simulation.set_joint_params(joint.number, _engine_params(params))
        joint.params = params
        return {"type": "joint_param_set", "joint_name": joint.name, "param_name": name, "value": value}

    def _check_param(self, kind: str, name: str, value: float | bool, path: str) -> None:
        if kind not in ("hinge", "slide") and not (kind == "conetwist" and name.startswith("limit")):
            raise WorldError("unsupported", f"a {kind} joint has no {name}", "param_name")
        self._require(_PARAM_CAPABILITY[name], f"{name} for joints")
        if isinstance(value, bool) != (name in _SWITCHES):
            wanted = "true or false" if name in _SWITCHES else "a number"
            raise WorldError("invalid", f"{path}: {name} must be {wanted}, not {value}", path)
        if name in _NOT_NEGATIVE and value < 0:
            raise WorldError("invalid", f"{path}: {name} must not be negative, but is {value}", path)

    def _get_joint_list(self, client: _Client, c: JsonObject) -> JsonObject:
        return {"type": "joint_list", "joints": [_identity(joint) for joint in self._joints.values()]}

    def _get_joint_info(self, client: _Client, c: JsonObject) -> JsonObject:
        joint = self._joint(c["joint_name"])
        reading = self.simulation.joint_state(joint.number)
        return {
            "type": "joint_info",
            **_identity(joint),
            "anchor": reading.anchor,
            "axis": reading.axis,
            "position": reading.position,
            "velocity": reading.velocity,
            "effort": reading.effort,
            "params": joint.params,
        }

    # -- commands: the world -------------------------------------------------------------------------------------

    def _get_world_state(self, client: _Client, c: JsonObject) -> JsonObject:
        if "cubes" in c:
            cubes = [self._cube(name, f"cubes/{i}") for i, name in enumerate(c["cubes"])]
        else:
            cubes = list(self._cubes.values())
        states = self.simulation.states([cube.body for cube in cubes]).tolist()
        moving = [_moving_part(cube.name, state) for cube, state in zip(cubes, states, strict=True)]
        return {"type": "world_state", "frame": self.frame, "t": self.time, "cubes": moving}

    def _get_world_info(self, client: _Client, c: JsonObject) -> JsonObject:
        fault = self.fault
        return {
            "type": "world_info",
            "world": self.config["name"],
            "backend": self.backend.name,
            "versions": {
                "nmes": version("nmes"),
                "protocol": protocol.PROTOCOL_VERSION,
                "engine": self.backend.version(),
            },
            "dims": self.backend.dims,
            "seed": self.seed,
            "config": self.config,
            "mode": self.mode,
            "rate": self.rate,
            "paused": self.paused,
            "frame": self.frame,
            "t": self.time,
            "counts": {"cubes": len(self._cubes), "joints": len(self._joints), "clients": len(self._clients)},
            "limits": self.config["limits"],
            "capabilities": self.capabilities(),
            "fault": None
            if fault is None
            else {"code": fault.code, "frame": fault.frame, "message": fault.message},
        }

    def capabilities(self) -> list[str]:
        """Returns the optional commands that this world serves and what its engine can do, sorted."""
        optional = {kind for kind in self.COMMANDS if not protocol.COMMANDS[kind].required}
        if "joint.conetwist" not in self.backend.capabilities:
            optional.discard("create_bone")
        return sorted(optional | self.backend.capabilities)

    def _reset(self, client: _Client, c: JsonObject) -> JsonObject:
        self._begin(c.get("seed", self.seed))
        for other in self._clients.values():
            other.owned = None
        return {"type": "world_reset", "frame": 0, "seed": self.seed}

    def _step(self, client: _Client, c: JsonObject) -> JsonObject:
        if self.mode != "lockstep" and not self.paused:
            raise WorldError("wrong_mode", f"step works in lockstep or in a paused world, not in {self.mode}")
        for _ in range(c.get("ticks", 1)):
            self.tick()
            if self.fault is not None:
                if self.fault.code == "recording_failed":
                    raise RecordingError("recording_failed", self.fault.message)
                raise WorldError("world_faulted", f"stopped at frame {self.fault.frame}: {self.fault.message}")
        return {"type": "stepped", "frame": self.frame, "t": self.time}

    def _pause(self, client: _Client, c: JsonObject) -> JsonObject:
        self.paused = True
        return {"type": "paused", "frame": self.frame}

    def _resume(self, client: _Client, c: JsonObject) -> JsonObject:
        self.paused = False
        return {"type": "resumed", "frame": self.frame}

    def _set_mode(self, client: _Client, c: JsonObject) -> JsonObject:
        self.mode = c["mode"]
        self.rate = float(c.get("rate", self.rate))
        return {"type": "mode_set", "mode": self.mode, "rate": self.rate}

    def _subscribe(self, client: _Client, c: JsonObject) -> JsonObject:
        default = protocol.COMMANDS["subscribe"].defaults
        client.subscription = s = _Subscription(
            events=tuple(dict.fromkeys(c.get("events", default["events"]))),
            every=c.get("every", default["every"]),
            position_threshold=float(c.get("position_threshold", default["position_threshold"])),
            rotation_threshold=float(c.get("rotation_threshold", default["rotation_threshold"])),
        )
        return {
            "type": "subscribed",
            "events": s.events,
            "every": s.every,
            "position_threshold": s.position_threshold,
            "rotation_threshold": s.rotation_threshold,
        }

    def _unsubscribe(self, client: _Client, c: JsonObject) -> JsonObject:
        client.subscription = None
        return {"type": "unsubscribed"}

    def _batch(self, client: _Client, c: JsonObject) -> JsonObject:
        results = []
        for command in c["commands"]:
            if command["type"] == "spawn_cube" and "list" not in command:
                command = {**command, "list": False}
            results.append(self._answer(client, protocol.request_from(command)))
        return {"type": "batch_result", "results": results}

    def _ping(self, client: _Client, c: JsonObject) -> JsonObject:
        return {"type": "pong"}

    COMMANDS: ClassVar[dict[str, Callable[[World, _Client, JsonObject], JsonObject]]] = {
        "spawn_cube": _spawn_cube,
        "despawn_cube": _despawn_cube,
        "create_joint": _create_joint,
        "create_bone": _create_bone,
        "remove_joint": _remove_joint,
        "set_joint_param": _set_joint_param,
        "get_joint_list": _get_joint_list,
        "get_joint_info": _get_joint_info,
        "apply_physics": _apply_physics,
        "apply_force": _apply_physics,
        "set_cube_state": _set_cube_state,
        "freeze_cube": _freeze_cube,
        "get_cube_list": _get_cube_list,
        "get_cube_info": _get_cube_info,
        "get_cube_state": _get_cube_state,
        "get_world_state": _get_world_state,
        "get_world_info": _get_world_info,
        "reset": _reset,
        "step": _step,
        "pause": _pause,
        "resume": _resume,
        "set_mode": _set_mode,
        "subscribe": _subscribe,
        "unsubscribe": _unsubscribe,
        "batch": _batch,
        "ping": _ping,
    }


def _vector(value: list[float]) -> Vector:
    x, y, z = value
    return (float(x), float(y), float(z))


def _plus(a: Vector, b: Vector) -> Vector:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def _minus(a: Vector, b: Vector) -> Vector:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _unit(v: Vector) -> Vector | None:
    length = hypot(*v)
    return (v[0] / length, v[1] / length, v[2] / length) if 1e-9 < length < inf else None


def _moving_part(name: str, state: list[float]) -> JsonObject:
    quaternion = state[3:7]
    return {
        "cube_name": name,
        "position": state[0:3],
        "rotation": euler_from_quaternion((quaternion[0], quaternion[1], quaternion[2], quaternion[3])),
        "quaternion": quaternion,
        "linear_velocity": state[7:10],
        "angular_velocity": state[10:13],
    }


def _identity(joint: _Joint) -> JsonObject:
    return {
        "joint_name": joint.name,
        "joint_type": joint.kind,
        "cube1": joint.cube1.name,
        "cube2": joint.cube2.name,
    }


def _put(params: JsonObject, name: str, value: float | bool, engine_step: float) -> None:
    """Sets one of the wire's joint parameters and what follows from it."""
    params[name] = value if isinstance(value, bool) else float(value)
    if name == "motor_target_velocity":
        params["motor_enabled"], params["target_position"] = True, None
    elif name == "target_position":
        params["motor_enabled"] = True
    elif name == "motor_max_impulse":  # per engine step, the deployed clients' unit
        params["motor_max_force"] = float(value) / engine_step
    elif name == "motor_max_force":
        params["motor_max_impulse"] = float(value) * engine_step


def _check_limits(params: JsonObject, path: str) -> None:
    if params["limit_enabled"] and params["limit_lower"] > params["limit_upper"]:
        raise WorldError(
            "invalid", f"{path}: limit_lower {params['limit_lower']} is above limit_upper {params['limit_upper']}", path
        )


def _engine_params(params: JsonObject) -> JointParams:
    result = JointParams(
        target_velocity=params["motor_target_velocity"],
        max_effort=params["motor_max_force"],
        stiffness=params["stiffness"],
        damping=params["damping"],
        limits=(params["limit_lower"], params["limit_upper"]) if params["limit_enabled"] else None,
    )
    if not params["motor_enabled"]:
        return result
    if params["target_position"] is None:
        return replace(result, motor="velocity")
    return replace(result, motor="position", target_position=params["target_position"])
