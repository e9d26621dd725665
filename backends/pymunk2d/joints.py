"""Bodies and joints as Chipmunk has them: each of NMES's joints is put together from a few constraints."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pymunk
from pymunk._chipmunk_cffi import ffi

from nmes.backend import Array, BodySpec, JointParams

__all__ = ["Body", "Joint", "MotorWork", "Point"]

_SERVO_RATE = 15.0  # 1/s: a servo closes in like exp(-rate t), so it does not overshoot unless its effort is short
_FAR = 1e5  # m behind the anchor of a slide, where the rod that drives it along its axis is held
_FOREVER = 1e9  # rad or m: a target that no motor reaches
# Where Chipmunk keeps the signed impulse of these constraints, in doubles from their beginning: its accessor gives
# the magnitude only, and the effort of a motor has a sign.
_SIGNED_IMPULSE = {pymunk.GearJoint: 18, pymunk.PinJoint: 25}

Point = tuple[float, float]


@dataclass(slots=True, eq=False)
class Body:
    """A body, and the wrench that acts on it during the next step."""

    number: int
    spec: BodySpec
    body: pymunk.Body
    shape: pymunk.Shape
    frozen: bool
    joints: dict[int, Joint] = field(default_factory=dict)
    force: Point = (0.0, 0.0)
    torque: float = 0.0
    impulse: Point = (0.0, 0.0)
    spin: float = 0.0


@dataclass(slots=True, eq=False)
class Joint:
    """A joint and its constraints: those that are always there, and those that its parameters need.

    Position is `sign * (angle2 - angle1 - zero)` about z, or the way of `anchor2` from `anchor1` along `axis`; anchors
    and axis are in the bodies' frames (`anchor1` and `axis` in that of the first).
    """

    kind: str
    one: Body
    two: Body
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
    impulse: ctypes.c_double = field(default_factory=ctypes.c_double)  # of the motor in the last engine step

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
        rod = (a, b, self.along(-_FAR), self.anchor2)  # lies along the axis of a slide
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
                pymunk.DampedSpring(*rod, _FAR, 0.0, 0.0) if slides else pymunk.DampedRotarySpring(a, b, rest, 0.0, 0.0)
            )
        if has_motor:
            self.motor = pymunk.PinJoint(*rod) if slides else pymunk.GearJoint(a, b, 0.0, 1.0)
            self.impulse = _signed_impulse(self.motor)
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
                lower, upper = bounds or (-_FAR / 2, _FAR / 2)
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
                target, self.motor.max_bias = math.copysign(_FOREVER, p.target_velocity), abs(p.target_velocity)
            self.motor.max_force = p.max_effort
            self.motor.error_bias = math.exp(-_SERVO_RATE)
            if isinstance(self.motor, pymunk.PinJoint):
                self.motor.distance = _FAR + target
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


class MotorWork:
    """What motors work in a step: kept as the engine has it in every engine step, computed when it is asked for.

    Args:
        driven: The joints with motors, by number.
        ranks: Of each body, by number, its row among the angular velocities.
    """

    def __init__(self, driven: Mapping[int, Joint], ranks: Mapping[int, int]) -> None:
        self.joints = list(driven.values())
        self._columns = {number: column for column, number in enumerate(driven)}
        self._slides = [(column, j) for column, j in enumerate(self.joints) if j.kind == "slide"]
        self._ends = np.array([(ranks[j.one.number], ranks[j.two.number]) for j in self.joints], np.intp).reshape(-1, 2)
        self._signs = np.array([j.sign for j in self.joints])
        self._speeds: list[Array] = []  # before the first engine step and after each
        self._impulses: list[list[float]] = []
        self._works: Array | None = None

    def begin(self, spins: Array) -> None:
        """Begins a step, at these angular velocities of the bodies, shape (n,), rad/s."""
        self._speeds, self._impulses, self._works = [self._measured(spins)], [], None

    def keep(self, spins: Array) -> None:
        """Keeps what the motors gave in an engine step that ended at these angular velocities."""
        self._speeds.append(self._measured(spins))
        self._impulses.append([j.impulse.value for j in self.joints])

    def of(self, joint: int) -> Array:
        """Returns the work of a joint's motor in the last step, and the sum of its sizes, J; array (2,)."""
        if joint not in self._columns or not self._impulses:
            return np.zeros(2)
        if self._works is None:
            speeds = np.array(self._speeds)
            each = self._signs * np.array(self._impulses) * (speeds[:-1] + speeds[1:]) / 2.0
            self._works = np.add.accumulate(np.stack([each, np.abs(each)]), axis=1)[:, -1].T
        works: Array = self._works[self._columns[joint]]
        return works

    def _measured(self, spins: Array) -> Array:
        """Returns the velocities of the joints, rad/s or m/s."""
        ends = spins[self._ends]
        speeds = self._signs * (ends[:, 1] - ends[:, 0])
        for column, j in self._slides:
            speeds[column] = j.measure()[1]
        return speeds


def _signed_impulse(motor: pymunk.GearJoint | pymunk.PinJoint) -> ctypes.c_double:
    """Returns the impulse of the last engine step on the second body, as long as the motor lives."""
    address = int(ffi.cast("uintptr_t", motor._constraint)) + 8 * _SIGNED_IMPULSE[type(motor)]
    return ctypes.c_double.from_address(address)
