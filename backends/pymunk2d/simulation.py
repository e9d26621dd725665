"""A running Chipmunk space that is edited while it lives.

Invariants: one thread; everything is added to Chipmunk and iterated in an order that follows from the calls alone
(its only table keyed by addresses holds cached contacts, whose order has no consequence; a test of a thousand
programs in fresh processes holds it to that). There are no snapshots, for Chipmunk's contact cache cannot be saved;
for the same reason a digest covers what can be read of the engine: whatever it does not cover (warm starts, idle
times) moves a body, and so the digest, one step later.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from hashlib import blake2b
from typing import Any

import numpy as np
import numpy.typing as npt
import pymunk
import pymunk.batch

from nmes.backend import (
    Array,
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
from nmes.backend.shapes import axis, moments
from nmes.backends.pymunk2d.fluid import Fluid
from nmes.backends.pymunk2d.joints import Body, Joint, MotorWork
from nmes.backends.pymunk2d.scenery import add_scenery
from nmes.errors import SimulationFault, WorldError

__all__ = ["PymunkSimulation"]

TOO_FAR = 1e10  # m, m/s or rad/s: beyond it a simulation has diverged, as in MuJoCo
OVERLAP = 0.0005  # m that touching bodies may overlap: without it contacts flicker
SLEEP_SPEED, SLEEP_TIME = 0.005, 0.5  # m/s and s: what is slower for longer sleeps
CORRECTION = 0.2  # of a joint's position error that one engine step takes away
NUDGE = 1e-7  # m by which bodies in exactly the same place are moved apart
_ALL = pymunk.ShapeFilter.ALL_MASKS()
ROW = pymunk.batch.BodyFields
FIELDS = ROW.BODY_ID | ROW.POSITION | ROW.ANGLE | ROW.VELOCITY | ROW.ANGULAR_VELOCITY

KINDS = ("fixed", "hinge", "slide", "pin", "conetwist")


class PymunkSimulation(Simulation):
    """A Chipmunk space."""

    def __init__(self, scene: SceneSpec) -> None:
        self._timestep = self._elapsed = scene.timestep  # of an engine step, and of the last `step`
        self._space = space = pymunk.Space()
        space.gravity = scene.gravity[:2]
        space.collision_slop = OVERLAP
        space.idle_speed_threshold, space.sleep_time_threshold = SLEEP_SPEED, SLEEP_TIME
        self._passes, self._fluid = scene.passes, Fluid(scene)
        self._bodies: dict[int, Body] = {}
        self._joints: dict[int, Joint] = {}
        self._numbers: dict[pymunk.Shape, int] = {}
        self._placed: dict[int, Body] = {}  # what was put somewhere since the last step
        self._pushed: dict[int, Body] = {}  # what something acts on in the next step
        self._buffer = pymunk.batch.Buffer()
        self._order_key = b""
        self._order: npt.NDArray[np.intp] = np.zeros(0, dtype=np.intp)  # for each body its place in the engine's order
        self._ranks: dict[int, int] | None = None  # each body's row; None: to be found
        self._rows: Array | None = None  # x, y, angle, vx, vy, w of each body; None: to be read
        self._motors: MotorWork | None = None  # None: they are to be looked up
        self._work = MotorWork({}, {})  # in the last step
        self._packed_specs: bytes | None = None  # what the digest says of specs and parameters; None: to be packed
        space.damping = math.exp(-scene.linear_damping)  # what a second leaves of all velocities, angular ones too
        self._kept_spin = math.exp((scene.linear_damping - scene.angular_damping) * scene.timestep)
        _set_options(space, scene.options)
        add_scenery(space, scene)

    # -- structure ----------------------------------------------------------------------------------------------

    def add_body(self, body: int, spec: BodySpec) -> None:
        """Adds a body; the space has it at once."""
        kind = pymunk.Body.STATIC if spec.frozen else pymunk.Body.DYNAMIC
        b = pymunk.Body(spec.mass, _moment(spec), kind)
        b.position = spec.position[:2]
        b.angle = _angle(spec.quaternion)
        if not spec.frozen:
            b.velocity, b.angular_velocity = spec.linear_velocity[:2], spec.angular_velocity[2]
        shape = _shape(b, spec)
        shape.friction, shape.elasticity = spec.friction, spec.restitution
        if spec.group:  # all others are of all categories
            shape.filter = pymunk.ShapeFilter(categories=1 << spec.group, mask=~self._passes[spec.group - 1] & _ALL)
        self._space.add(b, shape)
        self._bodies[body] = self._placed[body] = Body(body, spec, b, shape, spec.frozen)
        self._numbers[shape] = body
        self._ranks = self._rows = self._motors = self._packed_specs = None
        self._fluid.forget()

    def remove_body(self, body: int) -> None:
        """Removes a body; Chipmunk wakes what touched it."""
        b = self._bodies.pop(body)
        self._placed.pop(body, None)
        self._pushed.pop(body, None)
        del self._numbers[b.shape]
        self._space.remove(b.shape, b.body)
        self._ranks = self._rows = self._motors = self._packed_specs = None
        self._fluid.forget()

    def add_joint(self, joint: int, spec: JointSpec) -> None:
        """Joins two bodies.

        Raises:
            WorldError: `unsupported`, of a kind or about an axis that the plane does not have.
        """
        one, two = self._bodies[spec.body1], self._bodies[spec.body2]
        a, b = one.body, two.body
        along, about = pymunk.Vec2d(*spec.axis[:2]), spec.axis[2]
        if spec.kind not in KINDS:
            raise WorldError("unsupported", f"pymunk has no {spec.kind!r} joints", "joint_type")
        if spec.kind == "hinge" and abs(about) < 1e-6:
            raise WorldError("unsupported", "a planar world has hinges about z only", "axis")
        if spec.kind == "slide" and along.length < 1e-6:
            raise WorldError("unsupported", "a planar world has no slide along z", "axis")
        j = Joint(
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
        """Cuts a joint."""
        j = self._joints.pop(joint)
        self._detach(j)
        del j.one.joints[joint], j.two.joints[joint]
        self._packed_specs = None

    def set_joint_params(self, joint: int, params: JointParams) -> None:
        """Sets motor, spring and limits; constraints are made anew only where one comes or goes."""
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
        """Makes a body immovable, or movable again with zero velocity."""
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

    def _attach(self, j: Joint) -> None:
        """Makes a joint's constraints, unless both bodies are frozen, which Chipmunk cannot solve for."""
        if not (j.one.frozen and j.two.frozen):
            j.build()
            for constraint in j.structure:
                constraint.error_bias = (1.0 - CORRECTION) ** (1.0 / self._timestep)
            self._space.add(*j.constraints())
        self._motors = self._packed_specs = None

    def _detach(self, j: Joint) -> None:
        self._space.remove(*j.constraints())
        j.structure, j.spring, j.motor = [], None, None
        self._motors = None

    # -- state --------------------------------------------------------------------------------------------------

    def set_body_state(self, body: int, state: BodyState) -> None:
        """Moves a body."""
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
        """Adds to what acts on a body during the next step."""
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
        """Returns one body's pose and velocity."""
        row = self.states([body])[0].tolist()
        return BodyState(tuple(row[:3]), tuple(row[3:7]), tuple(row[7:10]), tuple(row[10:]))

    def states(self, bodies: Sequence[int]) -> Array:
        """Returns a new array (n, 13): position, quaternion, linear and angular velocity."""
        ranks = self._rank_bodies()
        rows = self._read()[[ranks[body] for body in bodies]]
        states = np.zeros((len(bodies), 13))
        states[:, 0:2] = rows[:, 0:2]
        halves = (rows[:, 2] / 2).tolist()
        # The C library's, as Chipmunk's own are; numpy has others for other processors.
        states[:, 5], states[:, 6] = list(map(math.sin, halves)), list(map(math.cos, halves))
        states[:, 7:9] = rows[:, 3:5]
        states[:, 12] = rows[:, 5]
        return states

    def sleeping(self, body: int) -> bool:
        """Tells whether the body sleeps."""
        return self._bodies[body].body.is_sleeping

    def joint_state(self, joint: int) -> JointState:
        """Returns one joint's reading; the effort is that of the last engine step."""
        j = self._joints[joint]
        anchor, axis = j.where()
        world_axis = (axis.x, axis.y, 0.0) if j.kind == "slide" else (0.0, 0.0, j.sign)
        position = velocity = 0.0
        if j.kind in ("hinge", "slide"):
            position, velocity = j.measure()
        elif j.kind == "conetwist" and j.twists:
            turned, velocity = j.measure()
            position = math.remainder(turned, math.tau)
        return JointState(position, velocity, self._effort(j), (anchor.x, anchor.y, 0.0), world_axis)

    def powers(self, joints: Sequence[int], out: Array) -> None:
        """Writes powers, from the motors' impulses in each engine step."""
        for column, joint in enumerate(joints):
            out[:, column] = self._work.of(joint)
        out /= self._elapsed

    def joint_readings(self, joints: Sequence[int]) -> Array:
        """Returns a new array (n, 3) of positions, velocities and efforts."""
        readings = ((*j.measure(), self._effort(j)) for j in map(self._joints.__getitem__, joints))
        return np.array(list(readings)).reshape(-1, 3)

    def contacts(self, body: int) -> list[Contact]:
        """Returns the body's contacts in the last step, each the mean of its points, ordered by partner."""
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
        """Advances the space, in which wrenches act that then are gone."""
        before = self._read()
        self._separate_coincident()
        for b in self._pushed.values():
            b.body.velocity += pymunk.Vec2d(*b.impulse) / b.spec.mass
            b.body.angular_velocity += b.spin / b.body.moment
        if self._pushed:
            self._rows = None
        self._work = work = self._find_motors()
        work.begin(self._read()[:, 5])
        for j in work.joints:
            if j.motor is not None and j.is_driving():
                j.motor.activate_bodies()
        for _ in range(substeps):
            for b in self._pushed.values():
                b.body.force, b.body.torque = b.force, b.torque
            if self._fluid.acts:
                self._fluid.act(self._bodies, self.states(list(self._bodies)))
            if self._kept_spin != 1.0:
                self._damp_spins()
            self._space.step(self._timestep)
            # After every engine step: an infinity must never come into the next, which could hang or abort on it.
            self._rows = None
            rows = self._read()
            if not np.abs(rows).max(initial=0.0) < TOO_FAR:
                extent = np.abs(np.nan_to_num(rows, nan=np.inf)).max(axis=1)
                self._rows = before
                worst = list(self._bodies)[int(np.argmax(extent))]
                raise SimulationFault("diverged", "a body moves too fast or is too far away", worst)
            if work.joints:
                work.keep(rows[:, 5])
        self._elapsed = substeps * self._timestep
        for b in list(self._pushed.values()):
            self._clear_wrench(b)

    def _damp_spins(self) -> None:
        """Scales angular velocities by what Chipmunk, which damps all alike, takes too little or too much of them."""
        for b in self._bodies.values():
            body = b.body
            # To set a velocity is to wake a body: one that is slow enough to fall asleep is left to do so.
            speed, spin = body.velocity, body.angular_velocity
            energy = b.spec.mass * speed.dot(speed) + body.moment * spin * spin
            if spin and not b.frozen and energy > b.spec.mass * SLEEP_SPEED * SLEEP_SPEED:
                body.angular_velocity = spin * self._kept_spin

    def digest(self) -> bytes:
        """Returns the digest over specs, states, the order of solving, wrenches and the impulses of joints."""
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
                state.update(struct.pack("<d", j.impulse.value))
        return state.digest()

    def close(self) -> None:
        """Takes the space apart, so that its memory is given back."""
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

    def _find_motors(self) -> MotorWork:
        if self._motors is None:
            driven = {number: j for number, j in self._joints.items() if j.motor is not None}
            self._motors = MotorWork(driven, self._rank_bodies())
        return self._motors

    def _effort(self, j: Joint) -> float:
        """Returns the effort of a joint's motor in the last engine step, N m or N."""
        return 0.0 if j.motor is None else j.sign * j.impulse.value / self._timestep

    def _clear_wrench(self, b: Body) -> None:
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
            if spec.group:
                yield struct.pack("<d", spec.group)
            if spec.shape != "box":
                yield spec.shape.encode()
        for number, j in self._joints.items():
            p = j.params
            fields = (number, j.one.number, j.two.number, *j.anchor1, *j.anchor2, *j.axis, j.sign, j.twists, j.zero)
            limits = p.limits or (math.nan, math.nan)
            effort = (p.target_velocity, p.target_position, p.max_effort, p.stiffness, p.damping, *limits)
            yield f"{j.kind} {p.motor}".encode() + struct.pack("<19d", *fields, *effort)


def _set_options(space: pymunk.Space, options: Mapping[str, Any]) -> None:
    for option, value in options.items():
        if option != "iterations":
            raise WorldError("invalid", f"pymunk has no setting {option!r}", f"engine/{option}")
        if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= 1000:
            raise WorldError("invalid", "iterations: must be a whole number from 1 to 1000", "engine/iterations")
        space.iterations = value


def _angle(quaternion: Quaternion) -> float:
    """Returns the part of a rotation that is about z, between -pi and pi."""
    return math.remainder(2.0 * math.atan2(quaternion[2], quaternion[3]), math.tau)


def _shape(body: pymunk.Body, spec: BodySpec) -> pymunk.Shape:
    """Returns the slice of a body in the plane: a circle, a capsule as a thick line, or a rectangle."""
    width, height = spec.size[:2]
    lies = axis(spec.size)
    if spec.shape == "sphere" or (spec.shape != "box" and lies == 2):
        return pymunk.Circle(body, width / 2.0)
    if spec.shape == "capsule":
        radius = min(width, height) / 2.0
        x, y = width / 2.0 - radius, height / 2.0 - radius
        return pymunk.Segment(body, (-x, -y), (x, y), radius)
    return pymunk.Poly.create_box(body, (width, height))


def _moment(spec: BodySpec) -> float:
    if spec.shape != "box":
        return spec.mass * moments(spec.shape, spec.size)[2]
    return spec.mass * (spec.size[0] ** 2 + spec.size[1] ** 2) / 12.0
