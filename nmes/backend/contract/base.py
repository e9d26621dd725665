"""The common ground of all checks of the contract: tolerances, scenes, and the physics to compare with."""

from __future__ import annotations

import math
import unittest
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np

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
)

TIMESTEP = 1 / 240  # s, an engine step
SUBSTEPS = 4  # engine steps a tick
TICK = TIMESTEP * SUBSTEPS
G = 9.81
ZERO: Vector = (0.0, 0.0, 0.0)
UPRIGHT: Quaternion = (0.0, 0.0, 0.0, 1.0)
KINDS = ("fixed", "hinge", "slide", "pin", "conetwist")


class Checks:
    """A set of checks on one backend.

    Attributes:
        backend: The Backend's class, importable by its module and name from a fresh process.
        programs: How many random programs run in each of two fresh processes.
        fall_error: m by which 1 s of free fall may miss the parabola.
        rest_error: m by which a body at rest may sink into the ground, or hover above it.
        period_error: Relative, of a pendulum and of a mass on a spring.
        bounce_error: Relative, of the height to which a body bounces.
        slide_error: Relative, of the way that a body slides down a slope.
        joint_error: m by which a joint's halves may part while it moves.
        motor_error: Relative, of a motor's speed, a servo's position and an effort reading.
        momentum_error: Relative, of total momentum through a collision.
        joint_momentum_error: Relative, of the total momentum of a jointed pair in free flight for 5 s.
        energy_error: Relative, by which energy may grow.
        crowd: How many bodies appear in one point and must part.
        crowd_speed: m/s that none of them may exceed.
        stand: s that a stack of ten must stand.
    """

    backend: ClassVar[type[Backend]]
    programs: ClassVar[int] = 3
    fall_error: ClassVar[float] = 0.03
    rest_error: ClassVar[float] = 0.005
    period_error: ClassVar[float] = 0.01
    bounce_error: ClassVar[float] = 0.15
    slide_error: ClassVar[float] = 0.1
    joint_error: ClassVar[float] = 0.005
    motor_error: ClassVar[float] = 0.02
    momentum_error: ClassVar[float] = 1e-6
    joint_momentum_error: ClassVar[float] = 1e-6
    energy_error: ClassVar[float] = 0.01
    crowd: ClassVar[int] = 20
    crowd_speed: ClassVar[float] = 30.0
    stand: ClassVar[float] = 60.0

    @property
    def dims(self) -> int:
        """Dimensions of the engine."""
        return self.backend().dims

    def can(self, capability: str) -> bool:
        """Tells whether the backend promises a capability."""
        return capability in self.backend().capabilities

    def need(self, capability: str) -> None:
        """Skips the check where the backend does not promise a capability."""
        if not self.can(capability):
            raise unittest.SkipTest(f"no {capability}")

    def a_joint(self, *kinds: str) -> str:
        """Returns the first of some kinds of joints that the backend promises, or skips the check."""
        for kind in kinds:
            if self.can(f"joint.{kind}"):
                return kind
        raise unittest.SkipTest(f"none of {', '.join(kinds)}")

    def sim(self, gravity: Vector = (0.0, -G, 0.0), ground: bool = True, **scenery: Any) -> Simulation:
        """Returns a scene without bodies."""
        return self.backend().create(SceneSpec(TIMESTEP, gravity=gravity, ground=ground, **scenery))

    def space(self) -> Simulation:
        """Returns an empty scene without ground and gravity."""
        return self.sim(gravity=ZERO, ground=False)

    def pair(self) -> Simulation:
        """Returns two cubes side by side in empty space."""
        sim = self.space()
        sim.add_body(0, box((-0.5, 3.0, 0.0)))
        sim.add_body(1, box((0.5, 3.0, 0.0)))
        return sim

    def mixed(self) -> Simulation:
        """Returns three falling bodies."""
        sim = self.sim()
        sim.add_body(0, box((0.0, 3.0, 0.0), linear_velocity=(1.0, 0.0, 0.0)))
        sim.add_body(1, box((3.0, 4.0, 0.0), size=(0.5, 1.0, 1.0), mass=2.0))
        sim.add_body(2, box((6.0, 6.0, 0.0), quaternion=about_z(0.4), angular_velocity=(0.0, 0.0, 1.0)))
        return sim

    def machine(
        self, kind: str, params: JointParams, gravity: Vector = ZERO, hanging: bool = False, **scenery: Any
    ) -> Simulation:
        """Returns a cube on a frozen base: on its own centre, or `hanging` from its side, or up and down."""
        sim = self.sim(gravity=gravity, ground=False, **scenery)
        sim.add_body(0, box((-5.0, 0.0, 0.0), frozen=True))
        sim.add_body(1, box(ZERO))
        anchor = (-0.5, 0.0, 0.0) if hanging else ZERO
        axis = (0.0, 0.0, 1.0) if kind == "hinge" else (0.0, 1.0, 0.0) if hanging else (1.0, 0.0, 0.0)
        sim.add_joint(0, JointSpec(kind, 0, 1, anchor, axis, params))
        return sim

    def drive(self, sim: Simulation, kind: str, amount: float) -> None:
        """Gives the cube of `machine` an impulse along, or about, its joint's axis."""
        if kind == "hinge":
            sim.apply(1, ZERO, ZERO, ZERO, (0.0, 0.0, amount))
        else:
            sim.apply(1, ZERO, ZERO, (amount, 0.0, 0.0), ZERO)

    def swings(self, sim: Simulation, reading: Callable[[], float], expected: float, what: str) -> None:
        """Compares a period, measured between upward passes through zero."""
        passes: list[float] = []
        last = reading()
        for tick in range(1, round(6 * expected / TICK)):
            sim.step(SUBSTEPS)
            now = reading()
            if last < 0.0 <= now:
                passes.append((tick - now / (now - last)) * TICK)
            last = now
        assert len(passes) > 2, f"{what}: does not swing"
        period = (passes[-1] - passes[0]) / (len(passes) - 1)
        assert_close([period], [expected], self.period_error * expected, f"{what}: period")

    def expect(self, sim: Simulation, body: int, expected: BodySpec | BodyState) -> None:
        """Compares a body's state with the expected one."""
        state = sim.body_state(body)
        for name in ("position", "quaternion", "linear_velocity", "angular_velocity"):
            assert_close(getattr(state, name), getattr(expected, name), 1e-9, f"{name} of body {body}")


def box(position: Vector, **changes: Any) -> BodySpec:
    """Returns a cube of 1 m and 1 kg."""
    plain: dict[str, Any] = {"size": (1.0, 1.0, 1.0), "mass": 1.0, "friction": 0.5, "restitution": 0.0}
    return BodySpec(**{**plain, "position": position, "quaternion": UPRIGHT, **changes})


def joint(kind: str, height: float = 3.0, limits: tuple[float, float] | None = None) -> JointSpec:
    """Returns a joint between the two cubes of `pair`, or of a like pair at another height."""
    axis = (1.0, 0.0, 0.0) if kind == "slide" else (0.0, 0.0, 1.0)
    return JointSpec(kind, 0, 1, (0.0, height, 0.0), axis, JointParams(limits=limits))


def run(sim: Simulation, seconds: float) -> None:
    """Advances a scene by a time, in ticks."""
    for _ in range(round(seconds / TICK)):
        sim.step(SUBSTEPS)


def about_z(angle: float) -> Quaternion:
    """Returns a rotation in the plane."""
    return (0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2))


def vector(values: Any) -> Vector:
    """Returns three numbers as plain floats."""
    x, y, z = values
    return float(x), float(y), float(z)


def assert_close(values: Any, expected: Any, error: float, what: str) -> None:
    """Fails, with the numbers, where any differs by more than `error`."""
    difference = float(np.abs(np.subtract(values, expected)).max())
    if not difference <= error:
        plain = np.asarray(values).tolist(), np.asarray(expected).tolist()
        raise AssertionError(f"{what}: {plain[0]}, not {plain[1]} (off by {difference:.3g}; {error:.3g} is allowed)")


def rotation(q: Sequence[float] | Array) -> Array:
    """Returns a quaternion's matrix."""
    x, y, z, w = q
    cross = np.array([(0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)])
    return np.asarray(np.eye(3) + 2 * w * cross + 2 * cross @ cross)


def momenta(sim: Simulation, specs: dict[int, BodySpec]) -> Array:
    """Returns total momentum and total angular momentum about the origin."""
    total = np.zeros(6)
    for row, spec in zip(sim.states(list(specs)), specs.values(), strict=True):
        total[:3] += spec.mass * row[7:10]
        total[3:] += spec.mass * np.cross(row[:3], row[7:10]) + inertia(row, spec) @ row[10:]
    return total


def kinetic(sim: Simulation, specs: dict[int, BodySpec]) -> float:
    """Returns the total kinetic energy."""
    energy = 0.0
    for row, spec in zip(sim.states(list(specs)), specs.values(), strict=True):
        energy += spec.mass * float(row[7:10] @ row[7:10]) / 2 + float(row[10:] @ inertia(row, spec) @ row[10:]) / 2
    return energy


def inertia(row: Array, spec: BodySpec) -> Array:
    """Returns a box's moment of inertia in world directions."""
    x, y, z = np.square(spec.size)
    turn = rotation(row[3:7])
    return np.asarray(turn @ np.diag((y + z, x + z, x + y)) @ turn.T * spec.mass / 12)


def carried_point(start: BodyState, now: BodyState, point: Vector) -> Array:
    """Returns the present place of a world point that was fixed to a body at the start."""
    local = rotation(start.quaternion).T @ np.subtract(point, start.position)
    return np.asarray(now.position + rotation(now.quaternion) @ local)


def joint_gap(sim: Simulation, kind: str) -> float:
    """Returns the gap, m, between the halves of the joint of two cubes that began at (-0.5, 0, 0) and (0.5, 0, 0)."""
    one, two = sim.body_state(0), sim.body_state(1)
    starts = [BodyState((x, 0.0, 0.0), UPRIGHT, ZERO, ZERO) for x in (-0.5, 0.5)]
    between = carried_point(starts[1], two, ZERO) - carried_point(starts[0], one, ZERO)
    turned = rotation(one.quaternion).T @ rotation(two.quaternion)
    if kind == "slide":
        between = rotation(one.quaternion).T @ between * (0.0, 1.0, 1.0)
    rigid = float(np.abs(turned - np.eye(3)).max()) / 2 if kind in ("fixed", "slide") else 0.0
    return max(float(np.linalg.norm(between)), rigid)
