"""The planar engine: pymunk (Chipmunk), for quick tests and experiments that stay in the XY plane.

It hides how NMES's joints are put together from Chipmunk's constraints, and what Chipmunk does not do by itself: a
motor along a line, joints between frozen bodies, faults instead of infinities. Motion along z and rotation about x
and y do not exist: they are 0 in every answer and ignored in every argument.

Invariants: one thread; everything is added to Chipmunk and iterated in an order that follows from the calls alone
(its only table keyed by addresses holds cached contacts, whose order has no consequence; a test of a thousand
programs in fresh processes holds it to that). There are no snapshots, for Chipmunk's contact cache cannot be saved;
for the same reason a digest covers what can be read of the engine: whatever it does not cover (warm starts, idle
times) moves a body, and so the digest, one step later.
"""

from __future__ import annotations

import ctypes
import functools
import itertools
import math
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from hashlib import blake2b, sha256
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pymunk
import pymunk.batch
from pymunk._chipmunk_cffi import ffi

from nmes.backend import (
    Array,
    Backend,
    BodySpec,
    BodyState,
    Contact,
    JointParams,
    JointSpec,
    JointState,
    Quaternion,
    SceneSpec,
    Simulation,
    Vector,
)
from nmes.errors import SimulationFault, WorldError

__all__ = ["PymunkBackend"]

TOO_FAR = 1e10  # m, m/s or rad/s: beyond it a simulation has diverged, as in MuJoCo
OVERLAP = 0.0005  # m that touching bodies may overlap: without it contacts flicker
SLEEP_SPEED, SLEEP_TIME = 0.005, 0.5  # m/s and s: what is slower for longer sleeps
GROUND = 1e6, 1000.0  # m: half the ground's length, and how deep a body may be in it and still be pushed up
CORRECTION = 0.2  # of a joint's position error that one engine step takes away
SERVO_RATE = 15.0  # 1/s: a servo closes in like exp(-rate t), so it does not overshoot unless its effort is short
FAR = 1e5  # m behind the anchor of a slide, where the rod that drives it along its axis is held
NUDGE = 1e-7  # m by which bodies in exactly the same place are moved apart
FOREVER = 1e9  # rad or m: a target that no motor reaches
ROW = pymunk.batch.BodyFields
FIELDS = ROW.BODY_ID | ROW.POSITION | ROW.ANGLE | ROW.VELOCITY | ROW.ANGULAR_VELOCITY
# Where Chipmunk keeps the signed impulse of these constraints, in doubles from their beginning: its accessor gives
# the magnitude only, and the effort of a motor has a sign.
SIGNED_IMPULSE = {pymunk.GearJoint: 18, pymunk.PinJoint: 25}

KINDS = ("fixed", "hinge", "slide", "pin", "conetwist")

Point = tuple[float, float]


@dataclass(slots=True, eq=False)
class _Body:
    """A body, and the wrench that acts on it during the next step."""

    number: int
    spec: BodySpec
    body: pymunk.Body
    shape: pymunk.Shape
    frozen: bool
    joints: dict[int, _Joint] = field(default_factory=dict)
    force: Point = (0.0, 0.0)
    torque: float = 0.0
    impulse: Point = (0.0, 0.0)
    spin: float = 0.0


@dataclass(slots=True, eq=False)
class _Joint:
    """A joint and its constraints: those that are always there, and those that its parameters need.

    Position is `sign * (angle2 - angle1 - zero)` about z, or the way of `anchor2` from `anchor1` along `axis`; anchors
    and axis are in the bodies' frames (`anchor1` and `axis` in that of the first).
    """

    kind: str
    one: _Body
    two: _Body
    anchor1: Point
    anchor2: Point
    axis: Point
    sign: float
    twists: bool
    zero: float
    params: JointParams
    structure: list[pymunk.Constraint] = field(default_factory=list)
    spring: pymunk.DampedRotarySpring | pymunk.DampedSpring | None = None
    motor: pymunk.GearJoint | pymunk.PinJoint | None = None

    def constraints(self) -> list[pymunk.Constraint]:
        """Returns all constraints, in the order in which they are added to the space; none while it is not built."""
        return [*self.structure, *(c for c in (self.spring, self.motor) if c is not None)]

    def needs(self) -> tuple[bool, bool, bool]:
        """Tells whether the parameters need a limit, a spring and a motor."""
        p = self.params
        return p.limits is not None, p.stiffness != 0.0 or p.damping != 0.0, p.motor != "off"

    def build(self) -> None:
        """Makes the constraints."""
        a, b, slides = self.one.body, self.two.body, self.kind == "slide"
        has_limit, has_spring, has_motor = self.needs()
        rod = (a, b, self.along(-FAR), self.anchor2)  # lies along the axis of a slide
        if slides:
            groove = pymunk.GrooveJoint(a, b, self.anchor1, self.along(1.0), self.anchor2)
            self.structure = [groove, pymunk.GearJoint(a, b, self.zero, 1.0)]
        else:
            self.structure = [pymunk.PivotJoint(a, b, self.anchor1, self.anchor2)]
            if self.kind == "fixed":
                self.structure.append(pymunk.GearJoint(a, b, self.zero, 1.0))
            elif has_limit:
                self.structure.append(pymunk.RotaryLimitJoint(a, b, 0.0, 0.0))
        if has_spring:
            rest = -self.zero
            self.spring = (
                pymunk.DampedSpring(*rod, FAR, 0.0, 0.0) if slides else pymunk.DampedRotarySpring(a, b, rest, 0.0, 0.0)
            )
        if has_motor:
            self.motor = pymunk.PinJoint(*rod) if slides else pymunk.GearJoint(a, b, 0.0, 1.0)
        for constraint in self.constraints():
            constraint.collide_bodies = False
        self.adjust()

    def adjust(self) -> None:
        """Sets the constraints to the parameters."""
        p = self.params
        bounds = p.limits
        if bounds is not None and self.kind == "conetwist":
            # It can only turn about z, which is its twist where its axis is z, and else its swing.
            widest = bounds[1] if self.twists else bounds[0]
            bounds = -widest, widest
        for constraint in self.structure:
            if isinstance(constraint, pymunk.GrooveJoint):
                lower, upper = bounds or (-FAR / 2, FAR / 2)
                # A groove without length would have no direction.
                constraint.groove_a, constraint.groove_b = self.along(lower), self.along(max(upper, lower + 1e-6))
            elif isinstance(constraint, pymunk.RotaryLimitJoint) and bounds is not None:
                constraint.min, constraint.max = sorted(self.zero + self.sign * bound for bound in bounds)
        if self.spring is not None:
            self.spring.stiffness, self.spring.damping = p.stiffness, p.damping
        if self.motor is not None:
            # A position constraint of bounded force, so that the solver itself holds the bound: to a position, or to
            # one that is never reached, at a bounded speed.
            if p.motor == "position":
                target, self.motor.max_bias = p.target_position, math.inf
            else:
                target, self.motor.max_bias = math.copysign(FOREVER, p.target_velocity), abs(p.target_velocity)
            self.motor.max_force = p.max_effort
            self.motor.error_bias = math.exp(-SERVO_RATE)
            if isinstance(self.motor, pymunk.PinJoint):
                self.motor.distance = FAR + target
            else:
                self.motor.phase = self.zero + self.sign * target

    def along(self, distance: float) -> Point:
        """Returns a point on the axis of a slide, in the first body's frame."""
        return self.anchor1[0] + self.axis[0] * distance, self.anchor1[1] + self.axis[1] * distance

    def where(self) -> tuple[pymunk.Vec2d, pymunk.Vec2d]:
        """Returns the anchor and the axis in world coordinates."""
        return self.one.body.local_to_world(self.anchor1), pymunk.Vec2d(*self.axis).rotated(self.one.body.angle)

    def measure(self) -> tuple[float, float]:
        """Returns the joint's position and velocity, rad and rad/s or m and m/s."""
        a, b = self.one.body, self.two.body
        if self.kind != "slide":
            return self.sign * (b.angle - a.angle - self.zero), self.sign * (b.angular_velocity - a.angular_velocity)
        anchor, axis = self.where()
        here = b.local_to_world(self.anchor2)
        velocity = b.velocity_at_world_point(here) - a.velocity_at_world_point(here)
        return axis.dot(here - anchor), axis.dot(velocity)

    def is_driving(self) -> bool:
        """Tells whether the motor still has something to do, so that the bodies must not fall asleep."""
        if self.params.motor == "velocity":
            return self.params.target_velocity != 0.0
        return self.params.motor == "position" and abs(self.measure()[0] - self.params.target_position) > 1e-3


class PymunkSimulation(Simulation):
    """A Chipmunk space."""

    def __init__(self, scene: SceneSpec) -> None:
        self._timestep = scene.timestep
        self._space = space = pymunk.Space()
        space.gravity = scene.gravity[:2]
        space.collision_slop = OVERLAP
        space.idle_speed_threshold, space.sleep_time_threshold = SLEEP_SPEED, SLEEP_TIME
        self._bodies: dict[int, _Body] = {}
        self._joints: dict[int, _Joint] = {}
        self._numbers: dict[pymunk.Shape, int] = {}
        self._placed: dict[int, _Body] = {}  # what was put somewhere since the last step
        self._pushed: dict[int, _Body] = {}  # what something acts on in the next step
        self._buffer = pymunk.batch.Buffer()
        self._order_key = b""
        self._order: npt.NDArray[np.intp] = np.zeros(0, dtype=np.intp)  # for each body its place in the engine's order
        self._ranks: dict[int, int] | None = None  # each body's row; None: to be found
        self._rows: Array | None = None  # x, y, angle, vx, vy, w of each body; None: to be read
        self._packed_specs: bytes | None = None  # what the digest says of specs and parameters; None: to be packed
        for option, value in scene.options.items():
            if option != "iterations":
                raise WorldError("invalid", f"pymunk has no setting {option!r}", f"engine/{option}")
            if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= 1000:
                raise WorldError("invalid", "iterations: must be a whole number from 1 to 1000", "engine/iterations")
            space.iterations = value
        if scene.ground:
            half, depth = GROUND
            _add_scenery(space, [pymunk.Segment(space.static_body, (-half, -depth), (half, -depth), depth)])
        if scene.heightfield is not None:
            _add_scenery(space, _landscape(space, scene.heightfield.profile()))
        corners = [box.section() for box in scene.boxes]
        _add_scenery(space, [pymunk.Poly(space.static_body, section) for section in corners if section])

    # -- structure ----------------------------------------------------------------------------------------------

    def add_body(self, body: int, spec: BodySpec) -> None:
        width, height = spec.size[:2]
        kind = pymunk.Body.STATIC if spec.frozen else pymunk.Body.DYNAMIC
        b = pymunk.Body(spec.mass, _moment(spec), kind)
        b.position = spec.position[:2]
        b.angle = _angle(spec.quaternion)
        if not spec.frozen:
            b.velocity, b.angular_velocity = spec.linear_velocity[:2], spec.angular_velocity[2]
        shape = pymunk.Poly.create_box(b, (width, height))
        shape.friction, shape.elasticity = spec.friction, spec.restitution
        self._space.add(b, shape)
        self._bodies[body] = self._placed[body] = _Body(body, spec, b, shape, spec.frozen)
        self._numbers[shape] = body
        self._ranks = self._rows = self._packed_specs = None

    def remove_body(self, body: int) -> None:
        b = self._bodies.pop(body)
        self._placed.pop(body, None)
        self._pushed.pop(body, None)
        del self._numbers[b.shape]
        self._space.remove(b.shape, b.body)
        self._ranks = self._rows = self._packed_specs = None

    def add_joint(self, joint: int, spec: JointSpec) -> None:
        one, two = self._bodies[spec.body1], self._bodies[spec.body2]
        a, b = one.body, two.body
        along, about = pymunk.Vec2d(*spec.axis[:2]), spec.axis[2]
        if spec.kind not in KINDS:
            raise WorldError("unsupported", f"pymunk has no {spec.kind!r} joints", "joint_type")
        if spec.kind == "hinge" and abs(about) < 1e-6:
            raise WorldError("unsupported", "a planar world has hinges about z only", "axis")
        if spec.kind == "slide" and along.length < 1e-6:
            raise WorldError("unsupported", "a planar world has no slide along z", "axis")
        j = _Joint(
            kind=spec.kind,
            one=one,
            two=two,
            anchor1=a.world_to_local(spec.anchor[:2]),
            anchor2=b.world_to_local(spec.anchor[:2]),
            axis=along.normalized().rotated(-a.angle),
            sign=-1.0 if spec.kind != "slide" and about < 0.0 else 1.0,
            twists=abs(about) > 0.5,
            zero=b.angle - a.angle,
            params=spec.params,
        )
        self._joints[joint] = one.joints[joint] = two.joints[joint] = j
        self._attach(j)

    def remove_joint(self, joint: int) -> None:
        j = self._joints.pop(joint)
        self._detach(j)
        del j.one.joints[joint], j.two.joints[joint]
        self._packed_specs = None

    def set_joint_params(self, joint: int, params: JointParams) -> None:
        j = self._joints[joint]
        needed = j.needs()
        j.params = params
        if j.needs() == needed:
            j.adjust()  # what stays remembers the impulse that it needed last
        else:
            self._detach(j)
            self._attach(j)
        self._packed_specs = None

    def set_frozen(self, body: int, frozen: bool) -> None:
        b = self._bodies[body]
        if b.frozen == frozen:
            return
        # Taken apart and put together again: only that wakes what sleeps on it or hangs on it, either way.
        for j in b.joints.values():
            self._detach(j)
        self._space.remove(b.shape)
        b.frozen = frozen
        b.body.body_type = pymunk.Body.STATIC if frozen else pymunk.Body.DYNAMIC
        if not frozen:
            b.body.mass, b.body.moment = b.spec.mass, _moment(b.spec)
        self._space.add(b.shape)
        for j in b.joints.values():
            self._attach(j)
        self._clear_wrench(b)
        self._rows = self._packed_specs = None

    def _attach(self, j: _Joint) -> None:
        """Makes a joint's constraints, unless both bodies are frozen, which Chipmunk cannot solve for."""
        if not (j.one.frozen and j.two.frozen):
            j.build()
            for constraint in j.structure:
                constraint.error_bias = (1.0 - CORRECTION) ** (1.0 / self._timestep)
            self._space.add(*j.constraints())
        self._packed_specs = None

    def _detach(self, j: _Joint) -> None:
        self._space.remove(*j.constraints())
        j.structure, j.spring, j.motor = [], None, None

    # -- state --------------------------------------------------------------------------------------------------

    def set_body_state(self, body: int, state: BodyState) -> None:
        b = self._bodies[body]
        b.body.position = state.position[:2]
        # The way round that is nearer, and always the same way for half a turn: joints between bodies that are moved
        # as a whole keep their turns.
        turn = math.remainder(_angle(state.quaternion) - b.body.angle, math.tau)
        b.body.angle += turn if turn > 1e-9 - math.pi else turn + math.tau
        if b.frozen:
            self._space.remove(b.shape)  # wakes what was in touch with it
            self._space.add(b.shape)
        else:
            b.body.velocity, b.body.angular_velocity = state.linear_velocity[:2], state.angular_velocity[2]
        self._placed[body] = b
        self._rows = None

    def apply(self, body: int, force: Vector, torque: Vector, impulse: Vector, angular_impulse: Vector) -> None:
        b = self._bodies[body]
        acts = any((*force[:2], torque[2], *impulse[:2], angular_impulse[2]))
        if b.frozen or not acts:  # what acts would wake it
            return
        b.force = b.force[0] + force[0], b.force[1] + force[1]
        b.impulse = b.impulse[0] + impulse[0], b.impulse[1] + impulse[1]
        b.torque += torque[2]
        b.spin += angular_impulse[2]
        self._pushed[body] = b

    def body_state(self, body: int) -> BodyState:
        row = self.states([body])[0].tolist()
        return BodyState(tuple(row[:3]), tuple(row[3:7]), tuple(row[7:10]), tuple(row[10:]))

    def states(self, bodies: Sequence[int]) -> Array:
        ranks = self._rank_bodies()
        rows = self._read()[[ranks[body] for body in bodies]]
        states = np.zeros((len(bodies), 13))
        states[:, 0:2] = rows[:, 0:2]
        states[:, 5], states[:, 6] = np.sin(rows[:, 2] / 2), np.cos(rows[:, 2] / 2)
        states[:, 7:9] = rows[:, 3:5]
        states[:, 12] = rows[:, 5]
        return states

    def sleeping(self, body: int) -> bool:
        return self._bodies[body].body.is_sleeping

    def joint_state(self, joint: int) -> JointState:
        j = self._joints[joint]
        anchor, axis = j.where()
        world_axis = (axis.x, axis.y, 0.0) if j.kind == "slide" else (0.0, 0.0, j.sign)
        position, velocity = j.measure() if j.kind in ("hinge", "slide") else (0.0, 0.0)
        effort = 0.0 if j.motor is None else j.sign * _signed_impulse(j.motor) / self._timestep
        return JointState(position, velocity, effort, (anchor.x, anchor.y, 0.0), world_axis)

    def contacts(self, body: int) -> list[Contact]:
        contacts: list[Contact] = []

        def add_contact(arbiter: pymunk.Arbiter) -> None:
            points, away = arbiter.contact_point_set.points, arbiter.normal
            if points:
                x, y = sum((p.point_a + p.point_b for p in points), pymunk.Vec2d(0, 0)) / (2 * len(points))
                force = max(0.0, -arbiter.total_impulse.dot(away) / self._timestep)
                other = self._numbers.get(arbiter.shapes[1])
                contacts.append(Contact(other, (x, y, 0.0), (-away.x, -away.y, 0.0), force))

        self._bodies[body].body.each_arbiter(add_contact)
        return sorted(contacts, key=lambda contact: (contact.other is None, contact.other or 0, contact.position))

    # -- time ---------------------------------------------------------------------------------------------------

    def step(self, substeps: int) -> None:
        before = self._read()
        self._separate_coincident()
        for b in self._pushed.values():
            b.body.velocity += pymunk.Vec2d(*b.impulse) / b.spec.mass
            b.body.angular_velocity += b.spin / b.body.moment
        for j in self._joints.values():
            if j.motor is not None and j.is_driving():
                j.motor.activate_bodies()
        for _ in range(substeps):
            for b in self._pushed.values():
                b.body.force, b.body.torque = b.force, b.torque
            self._space.step(self._timestep)
            # After every engine step: an infinity must never come into the next, which could hang or abort on it.
            self._rows = None
            if not np.abs(self._fetch()).max(initial=0.0) < TOO_FAR:
                extent = np.abs(np.nan_to_num(self._read(), nan=np.inf)).max(axis=1)
                self._rows = before
                worst = list(self._bodies)[int(np.argmax(extent))]
                raise SimulationFault("diverged", "a body moves too fast or is too far away", worst)
        for b in list(self._pushed.values()):
            self._clear_wrench(b)

    def digest(self) -> bytes:
        if self._packed_specs is None:
            self._packed_specs = b"".join(self._pack_specs())
        state = blake2b(self._packed_specs, digest_size=16)
        state.update(self._read().tobytes())
        # The order in which the engine solves; what falls asleep goes to its end.
        state.update(self._order.tobytes())
        for b in self._pushed.values():
            state.update(struct.pack("<7d", b.number, *b.force, b.torque, *b.impulse, b.spin))
        for j in self._joints.values():
            state.update(struct.pack(f"<{len(j.structure)}d", *(c.impulse for c in j.structure)))
            if j.motor is not None:
                state.update(struct.pack("<d", _signed_impulse(j.motor)))
        return state.digest()

    def close(self) -> None:
        space = self._space
        space.remove(*space.constraints)
        space.remove(*space.shapes)
        space.remove(*space.bodies)
        for b in self._bodies.values():
            b.joints.clear()
        self._bodies.clear()
        self._joints.clear()
        self._numbers.clear()
        self._placed.clear()
        self._pushed.clear()

    def _separate_coincident(self) -> None:
        """Moves bodies that were put exactly onto others a little, which Chipmunk cannot part."""
        if not self._placed:
            return
        occupied = {tuple(b.body.position) for number, b in self._bodies.items() if number not in self._placed}
        for b in self._placed.values():
            place = start = b.body.position
            turn = 0.0
            while tuple(place) in occupied:
                turn += 2.4  # the golden angle: no two ways out are alike
                place = start + pymunk.Vec2d(NUDGE * turn, 0.0).rotated(turn)
            if place is not start and not b.frozen:
                b.body.position = place
            occupied.add(tuple(place))
        self._placed.clear()
        self._rows = None

    def _clear_wrench(self, b: _Body) -> None:
        """Drops the wrench that acts on a body."""
        self._pushed.pop(b.number, None)
        b.force = b.impulse = (0.0, 0.0)
        b.torque = b.spin = 0.0

    def _rank_bodies(self) -> dict[int, int]:
        if self._ranks is None:
            self._ranks = {number: rank for rank, number in enumerate(self._bodies)}
            self._order_key = b""
        return self._ranks

    def _fetch(self) -> Array:
        """Reads position, angle and velocities of all bodies, in the engine's order: a view until the next call."""
        self._buffer.clear()
        pymunk.batch.get_space_bodies(self._space, FIELDS, self._buffer)
        return np.frombuffer(self._buffer.float_buf(), dtype=np.float64).reshape(-1, 6)

    def _read(self) -> Array:
        """Returns position, angle and velocities of all bodies, in order of creation."""
        if self._rows is None:
            rows = self._fetch()
            ids = bytes(self._buffer.int_buf())
            self._rank_bodies()
            if ids != self._order_key:
                place = {id: i for i, id in enumerate(np.frombuffer(ids, dtype=np.uintp).tolist())}
                self._order = np.array([place[b.body.id] for b in self._bodies.values()], dtype=np.intp)
                self._order_key = ids
            self._rows = rows[self._order]
        return self._rows

    def _pack_specs(self) -> Iterator[bytes]:
        for b in self._bodies.values():
            spec = b.spec
            yield struct.pack("<8d", b.number, *spec.size, spec.mass, spec.friction, spec.restitution, b.frozen)
        for number, j in self._joints.items():
            p = j.params
            fields = (number, j.one.number, j.two.number, *j.anchor1, *j.anchor2, *j.axis, j.sign, j.twists, j.zero)
            limits = p.limits or (math.nan, math.nan)
            effort = (p.target_velocity, p.target_position, p.max_effort, p.stiffness, p.damping, *limits)
            yield f"{j.kind} {p.motor}".encode() + struct.pack("<19d", *fields, *effort)


class PymunkBackend(Backend):
    """The engine as `nmes serve --backend pymunk` finds it."""

    name = "pymunk"
    dims = 2
    capabilities = frozenset(
        {"joint.fixed", "joint.hinge", "joint.slide", "joint.pin", "joint.conetwist", "motor", "servo", "limits"}
        | {"spring", "friction", "restitution", "contacts", "collisions", "sleep"}
        | {"scene.obstacles", "scene.heightfield"}
    )

    def version(self) -> str:
        """Returns pymunk's version."""
        return pymunk.version

    def fingerprint(self) -> dict[str, str]:
        """Returns the versions of pymunk and of its Chipmunk, and the SHA-256 of the compiled engine."""
        return {
            "version": pymunk.version,
            "chipmunk": pymunk.chipmunk_version,
            "numpy": np.__version__,
            "binary_sha256": _binary_hash(),
        }

    def create(self, scene: SceneSpec) -> PymunkSimulation:
        """Creates a space with the scene's ground, obstacles and heightfield."""
        return PymunkSimulation(scene)


@functools.cache
def _binary_hash() -> str:
    (binary,) = Path(pymunk.__file__).parent.glob("_chipmunk.*")
    return sha256(binary.read_bytes()).hexdigest()


def _angle(quaternion: Quaternion) -> float:
    """Returns the part of a rotation that is about z, between -pi and pi."""
    return math.remainder(2.0 * math.atan2(quaternion[2], quaternion[3]), math.tau)


def _moment(spec: BodySpec) -> float:
    return spec.mass * (spec.size[0] ** 2 + spec.size[1] ** 2) / 12.0


def _signed_impulse(motor: pymunk.GearJoint | pymunk.PinJoint) -> float:
    """Returns the impulse of the last engine step on the second body."""
    address = int(ffi.cast("uintptr_t", motor._constraint)) + 8 * SIGNED_IMPULSE[type(motor)]
    return math.copysign(motor.impulse, ctypes.c_double.from_address(address).value)


# -- scenery ----------------------------------------------------------------------------------------------------


def _add_scenery(space: pymunk.Space, shapes: Sequence[pymunk.Shape]) -> None:
    for shape in shapes:
        # Chipmunk multiplies the values of the two surfaces: with 1 here, the body's own count.
        shape.friction = shape.elasticity = 1.0
        space.add(shape)


def _landscape(space: pymunk.Space, points: Sequence[Point]) -> list[pymunk.Segment]:
    """Returns thick segments whose upper sides are the line through the points."""
    line = np.array(points)
    ways = np.diff(line, axis=0)
    up = np.column_stack([-ways[:, 1], ways[:, 0]]) / np.linalg.norm(ways, axis=1)[:, None]
    before, after = np.vstack([up[:1], up]), np.vstack([up, up[-1:]])
    radius = float(ways[:, 0].min()) / 4
    middles = line - radius * (before + after) / (1.0 + np.sum(before * after, axis=1))[:, None]
    ends = [(float(x), float(y)) for x, y in middles]
    segments = [pymunk.Segment(space.static_body, a, b, radius) for a, b in itertools.pairwise(ends)]
    for i, segment in enumerate(segments):  # so that boxes do not catch on the seams
        segment.set_neighbors(ends[max(i - 1, 0)], ends[min(i + 2, len(ends) - 1)])
    return segments
