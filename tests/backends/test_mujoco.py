"""The MuJoCo engine against physics: free bodies, collisions, joints, motors and loops."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pytest

from nmes.backend import Array, BodySpec, BodyState, JointParams, JointSpec, SceneSpec, Simulation, Vector
from nmes.backend.rotation import quaternion_from_euler, rotate
from nmes.backends.mujoco3d import MujocoBackend, MujocoSimulation

STEP = 1 / 240
NONE: Vector = (0.0, 0.0, 0.0)
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
G = 9.81
Mode = Literal["position", "velocity"]


def scene(gravity: float = -G, **options: Any) -> MujocoSimulation:
    simulation = MujocoBackend().create(SceneSpec(timestep=STEP, gravity=(0.0, gravity, 0.0), options=options))
    assert isinstance(simulation, MujocoSimulation)
    return simulation


def box(
    position: Vector,
    size: Vector = (1.0, 1.0, 1.0),
    mass: float = 1.0,
    friction: float = 1.0,
    restitution: float = 0.0,
    euler: Vector = NONE,
    velocity: Vector = NONE,
    spin: Vector = NONE,
    frozen: bool = False,
) -> BodySpec:
    q = quaternion_from_euler(*euler)
    return BodySpec(size, mass, friction, restitution, position, q, velocity, spin, frozen)


def vector(values: npt.ArrayLike) -> Vector:
    x, y, z = np.asarray(values, float).tolist()
    return (x, y, z)


def momentum(simulation: Simulation, masses: dict[int, float], edge: float = 1.0) -> tuple[Array, Array]:
    linear, angular = np.zeros(3), np.zeros(3)
    for body, mass in masses.items():
        state = simulation.body_state(body)
        v, w = np.array(state.linear_velocity), np.array(state.angular_velocity)
        linear += mass * v
        angular += mass * np.cross(state.position, v) + mass * edge * edge / 6 * w
    return linear, angular


def kinetic_energy(simulation: Simulation, masses: dict[int, float], edge: float = 1.0) -> float:
    total = 0.0
    for body, mass in masses.items():
        state = simulation.body_state(body)
        v, w = np.array(state.linear_velocity), np.array(state.angular_velocity)
        total += 0.5 * mass * float(v @ v) + 0.5 * mass * edge * edge / 6 * float(w @ w)
    return total


def anchor_error(
    simulation: MujocoSimulation, joints: dict[int, JointSpec], made: dict[int, tuple[Vector, Vector]]
) -> float:
    """How far apart the two ends of any joint are, m; `made` holds the anchors in the frames of both bodies."""
    worst = 0.0
    for number, spec in joints.items():
        ends = []
        for body, anchor in zip((spec.body1, spec.body2), made[number], strict=True):
            state = simulation.body_state(body)
            ends.append(np.add(state.position, rotate(state.quaternion, anchor)))
        worst = max(worst, float(np.abs(ends[0] - ends[1]).max()))
    return worst


Made = tuple[dict[int, JointSpec], dict[int, tuple[Vector, Vector]]]
"""Joints, and their anchors in the frames of both bodies."""


def grid(simulation: Simulation, height: float = 0.5) -> Made:
    """A flat 3x3 grid of unit cubes, 0.1 m apart, with 12 hinges between neighbours."""
    where = {1 + 3 * i + k: (1.1 * i, height, 1.1 * k) for i in range(3) for k in range(3)}
    for body, position in where.items():
        simulation.add_body(body, box(position))
    joints: dict[int, JointSpec] = {}
    made: dict[int, tuple[Vector, Vector]] = {}
    for body, position in where.items():
        for other, axis in ((body + 3, (0.0, 0.0, 1.0)), (body + 1, (1.0, 0.0, 0.0))):
            if other in where and (other == body + 3 or body % 3):
                far = where[other]
                anchor = vector(np.add(position, far) / 2)
                number = len(joints) + 1
                spec = JointSpec("hinge", body, other, anchor, axis)
                simulation.add_joint(number, spec)
                joints[number] = spec
                made[number] = (vector(np.subtract(anchor, position)), vector(np.subtract(anchor, far)))
    return joints, made


# -- free bodies -----------------------------------------------------------------------------------------------------


def test_a_projectile_flies_the_parabola() -> None:
    simulation = scene()
    simulation.add_body(1, box((0.0, 10.0, 0.0), velocity=(3.0, 4.0, -1.0)))
    for tick in range(1, 61):
        simulation.step(4)
        t = tick / 60
        # Semi-implicit Euler is exact in velocity, and in position late by half a step of fall.
        late = G * t * STEP / 2
        expected = (3 * t, 10 + 4 * t - G * t * t / 2 - late, -t)
        assert simulation.body_state(1).position == pytest.approx(expected, abs=1e-9)
    assert simulation.body_state(1).linear_velocity == pytest.approx((3.0, 4 - G, -1.0))


@pytest.mark.parametrize("restitution", [0.0, 0.25, 0.5, 0.8])
def test_a_cube_bounces_with_its_restitution(restitution: float) -> None:
    simulation = scene()
    simulation.add_body(1, box((0.0, 1.5, 0.0), restitution=restitution))
    fastest_up = down = 0.0
    for _ in range(400):
        simulation.step(1)
        v = simulation.body_state(1).linear_velocity[1]
        down, fastest_up = min(down, v), max(fastest_up, v)
        if fastest_up > 0.05 and v < fastest_up - 0.2:
            break
    assert fastest_up / -down == pytest.approx(restitution, abs=0.1)


@pytest.mark.parametrize(("slope", "slides"), [(0.9, False), (1.1, True)])
def test_friction_holds_below_the_critical_slope_and_slides_above(slope: float, slides: bool) -> None:
    friction = 0.5
    angle = math.atan(friction) * slope
    simulation = scene()
    turn = quaternion_from_euler(0, 0, angle)
    slab = (0.0, 20.0, 0.0)
    simulation.add_body(1, box(slab, size=(20.0, 1.0, 20.0), friction=friction, euler=(0, 0, angle), frozen=True))
    lift = rotate(turn, (0.0, 0.7, 0.0))
    up = (lift[0], lift[1] + 20.0, lift[2])
    simulation.add_body(2, box(up, size=(0.4, 0.4, 0.4), friction=friction, euler=(0, 0, angle)))
    for _ in range(180):
        simulation.step(4)
    moved = math.dist(simulation.body_state(2).position, up)
    if slides:
        expected = 0.5 * G * (math.sin(angle) - friction * math.cos(angle)) * 9
        assert moved == pytest.approx(expected, rel=0.15)
    else:
        assert moved < 0.02


def test_momentum_and_energy_in_a_collision() -> None:
    simulation = scene(gravity=0)
    masses = {1: 2.0, 2: 1.0}
    simulation.add_body(1, box((-2.0, 5.0, 0.0), mass=2.0, restitution=1.0, velocity=(3.0, 0.0, 0.0)))
    simulation.add_body(2, box((2.0, 5.0, 0.0), mass=1.0, restitution=1.0))
    before, energy = momentum(simulation, masses), kinetic_energy(simulation, masses)
    for _ in range(480):
        simulation.step(1)
    after = momentum(simulation, masses)
    assert after[0] == pytest.approx(before[0], abs=1e-6)
    assert after[1] == pytest.approx(before[1], abs=1e-5)
    assert simulation.body_state(2).linear_velocity[0] > 3.0
    assert kinetic_energy(simulation, masses) == pytest.approx(energy, rel=0.1)


def test_a_stack_of_ten_stands_for_a_minute() -> None:
    simulation = scene()
    for i in range(10):
        simulation.add_body(i + 1, box((0.0, 0.5 + i, 0.0)))
    for _ in range(3600):
        simulation.step(4)
    for i in range(10):
        assert simulation.body_state(i + 1).position == pytest.approx((0.0, 0.5 + i, 0.0), abs=0.02)
        assert simulation.sleeping(i + 1)


def test_a_frozen_cube_stays_whatever_hits_it() -> None:
    simulation = scene()
    simulation.add_body(1, box((0.0, 3.0, 0.0), frozen=True))
    simulation.add_body(2, box((0.1, 6.0, 0.0), mass=50.0))
    simulation.apply(1, (1e6, 0.0, 0.0), NONE, (1e6, 0.0, 0.0), NONE)
    for _ in range(120):
        simulation.step(4)
    assert simulation.body_state(1) == BodyState((0.0, 3.0, 0.0), UPRIGHT, NONE, NONE)
    assert simulation.body_state(2).position[1] == pytest.approx(4.0, abs=0.02)
    assert {contact.other for contact in simulation.contacts(2)} == {1}


# -- joints ----------------------------------------------------------------------------------------------------------


def test_a_pendulum_swings_with_the_period_of_the_formula() -> None:
    simulation = scene()
    edge, arm = 0.2, 1.0
    simulation.add_body(1, box((0.0, 5.0, 0.0), size=(0.1, 0.1, 0.1), frozen=True))
    angle = 0.05
    simulation.add_body(
        2, box((arm * math.sin(angle), 5 - arm * math.cos(angle), 0.0), size=(edge,) * 3, euler=(0, 0, angle))
    )
    simulation.add_joint(1, JointSpec("hinge", 1, 2, (0.0, 5.0, 0.0), (0.0, 0.0, 1.0)))
    crossings, last = [], 0.0
    for step in range(4 * 240):
        simulation.step(1)
        x = simulation.body_state(2).position[0]
        if last > 0 >= x or last < 0 <= x:
            crossings.append((step + 1 - x / (x - last) if x != last else step + 1) * STEP)
        last = x
    periods = np.diff(crossings)[::1] * 2
    inertia = arm * arm + edge * edge / 6
    expected = 2 * math.pi * math.sqrt(inertia / (G * arm))
    assert periods.mean() == pytest.approx(expected, rel=0.01)


def test_a_mass_on_a_spring_swings_with_the_period_of_the_formula() -> None:
    simulation = scene(gravity=0)
    simulation.add_body(1, box((0.0, 5.0, 0.0), frozen=True))
    simulation.add_body(2, box((2.0, 5.0, 0.0), mass=2.0))
    simulation.add_joint(1, JointSpec("slide", 1, 2, (1.0, 5.0, 0.0), (1.0, 0.0, 0.0), JointParams(stiffness=50.0)))
    simulation.apply(2, NONE, NONE, (1.0, 0.0, 0.0), NONE)
    positions = []
    for _ in range(480):
        simulation.step(1)
        positions.append(simulation.joint_state(1).position)
    signs = np.flatnonzero(np.diff(np.sign(positions)))
    assert 2 * np.diff(signs).mean() * STEP == pytest.approx(2 * math.pi * math.sqrt(2 / 50), rel=0.01)
    assert max(positions) == pytest.approx(0.5 / math.sqrt(50 / 2), rel=0.02)


@pytest.mark.parametrize("kind", ["hinge", "slide"])
def test_a_motor_reaches_its_velocity_and_never_exceeds_its_effort(kind: str) -> None:
    simulation = scene(gravity=0)
    simulation.add_body(1, box((0.0, 5.0, 0.0), frozen=True))
    simulation.add_body(2, box((1.2, 5.0, 0.0)))
    params = JointParams(motor="velocity", target_velocity=3.0, max_effort=2.0)
    simulation.add_joint(1, JointSpec(kind, 1, 2, (0.6, 5.0, 0.0), (0.0, 0.0, 1.0), params))
    inertia = 1 / 6 + 0.36 if kind == "hinge" else 1.0
    velocity = 0.0
    for step in range(1, 720):
        simulation.step(1)
        reading = simulation.joint_state(1)
        assert abs(reading.effort) <= 2.0 + 1e-12
        if step * STEP < 0.5 * 3.0 * inertia / 2:
            assert reading.velocity == pytest.approx(step * STEP * 2.0 / inertia, rel=0.02)
        assert reading.velocity <= 3.0 * 1.01
        velocity = reading.velocity
    assert velocity == pytest.approx(3.0, abs=1e-6)


SERVO = JointParams("position", max_effort=5.0)


def driven_chain(motor: JointParams = SERVO, **options: Any) -> MujocoSimulation:
    """Makes four cubes in the air, a motor between any two."""
    simulation = scene(0.0, **options)
    for number in range(4):
        simulation.add_body(number, box((1.5 * number, 1.0, 0.0)))
    for number in range(3):
        anchor = (1.5 * number + 0.75, 1.0, 0.0)
        simulation.add_joint(number, JointSpec("hinge", number, number + 1, anchor, (0.0, 0.0, 1.0), motor))
    return simulation


@pytest.mark.parametrize("effort", [0.5, 5.0, 500.0])
@pytest.mark.parametrize("kind", ["position", "velocity"])
@pytest.mark.parametrize(
    ("integrator", "error"), [("implicitfast", 1e-9), ("implicit", 1e-9), ("euler", 1e-9), ("rk4", 0.02)]
)
def test_what_a_motor_gives_is_the_energy_of_the_cube(integrator: str, error: float, kind: Mode, effort: float) -> None:
    simulation = scene(0.0, integrator=integrator, sleep=False)
    simulation.add_body(1, box((0.0, 5.0, 0.0), frozen=True))
    simulation.add_body(2, box((1.2, 5.0, 0.0)))
    joint = JointSpec("hinge", 1, 2, (0.6, 5.0, 0.0), (0.0, 0.0, 1.0), JointParams(kind, max_effort=effort))
    simulation.add_joint(1, joint)
    work, size, powers = 0.0, 0.0, np.zeros((2, 1))
    for tick in range(120):
        if tick % 30 == 0:
            target = 0.4 * (-1.0) ** (tick // 30)
            params = JointParams(kind, target_position=target, target_velocity=target, max_effort=effort)
            simulation.set_motor_targets((1,), [params], np.array([target]))
        simulation.step(4)
        simulation.powers((1,), powers)
        work, size = work + powers[0, 0] / 60, size + powers[1, 0] / 60
        assert work == pytest.approx(kinetic_energy(simulation, {2: 1.0}), abs=error * size)
    assert size > 0.15


@pytest.mark.parametrize("kind", ["position", "velocity"])
@pytest.mark.parametrize("integrator", ["implicitfast", "implicit", "euler", "rk4"])
def test_a_chain_of_strong_motors_does_as_told_whatever_the_integrator(integrator: str, kind: Mode) -> None:
    motor, targets = JointParams(kind, max_effort=500.0), np.array([0.4, -0.4, 0.4])
    simulation = driven_chain(motor, integrator=integrator, sleep=False)
    simulation.set_motor_targets((0, 1, 2), [replace(motor, target_velocity=0.4)] * 3, targets)
    simulation.step(240 if kind == "position" else 120)  # at last, what oscillates may come to rest
    for _ in range(2):
        told = simulation.joint_readings((0, 1, 2))[:, ("position", "velocity").index(kind)]
        assert told == pytest.approx(targets, abs=0.01)
        simulation.step(1)


def test_powers_of_many_ticks_are_those_of_each_engine_step() -> None:
    kept, stepped, joints, rows, late = driven_chain(), driven_chain(), (0, 1, 2), 700, 300
    tracks = [kept.track([], [], joints, rows), kept.track([1], [2], [2, 0], rows - late)]
    powers = np.zeros((rows, 2, 3))
    for row in range(rows):
        steps = 6 if 520 <= row < 560 else 4
        for simulation in (kept, stepped):
            if row % 50 == 0:
                simulation.set_motor_targets((0, 2), [SERVO] * 2, np.array([0.5, 0.2]) * (-1.0) ** (row // 50))
            if row == 270:
                simulation.set_joint_params(1, JointParams("position", target_position=0.1, max_effort=1.0))
            if row == 410:
                simulation.add_body(9, box((0.0, 9.0, 0.0)))
        kept.step(steps)
        for track in tracks[: 1 if row < late else 2]:
            track.note()
        for _ in range(steps):
            before = stepped.joint_readings(joints)[:, 1]
            stepped.step(1)
            model, (_, after, effort) = stepped.running.model, stepped.joint_readings(joints).T
            bounded = np.abs(effort) >= model.actuator_forcerange[:, 1]
            effort = effort + np.where(bounded, 0.0, model.actuator_biasprm[:, 2] * (after - before))
            power = effort * (before + after) / 2.0
            powers[row] += power, np.abs(power)
        powers[row] /= steps
    assert np.array_equal(tracks[0].powers(0, rows), powers)
    assert np.array_equal(tracks[1].powers(0, rows - late), powers[late:, :, [2, 0]])
    assert (powers[:, 1].max(axis=1) > 1e-9).mean() > 0.5


def test_a_servo_goes_to_its_target_and_holds_a_load_there() -> None:
    simulation = scene()
    simulation.add_body(1, box((0.0, 5.0, 0.0), frozen=True))
    simulation.add_body(2, box((1.2, 5.0, 0.0)))
    params = JointParams(motor="position", target_position=0.5, max_effort=100.0)
    simulation.add_joint(1, JointSpec("hinge", 1, 2, (0.6, 5.0, 0.0), (0.0, 0.0, 1.0), params))
    for _ in range(120):
        simulation.step(4)
    reading = simulation.joint_state(1)
    assert reading.position == pytest.approx(0.5, abs=0.01) and abs(reading.velocity) < 1e-3
    assert reading.effort == pytest.approx(0.6 * math.cos(reading.position) * G, rel=0.01)


@pytest.mark.parametrize("effort", [1.0, 5.0, 25.0, 240.0])
@pytest.mark.parametrize("frozen", [True, False])
def test_a_servo_does_not_overshoot_however_weak_it_is(effort: float, frozen: bool) -> None:
    simulation = scene(gravity=0)
    simulation.add_body(1, box((0.0, 5.0, 0.0), frozen=frozen))
    simulation.add_body(2, box((1.2, 5.0, 0.0)))
    params = JointParams(motor="position", target_position=0.8, max_effort=effort)
    simulation.add_joint(1, JointSpec("hinge", 1, 2, (0.6, 5.0, 0.0), (0.0, 0.0, 1.0), params))
    furthest = 0.0
    for _ in range(480):
        simulation.step(4)
        furthest = max(furthest, simulation.joint_state(1).position)
    assert furthest < 0.8 * 1.03
    assert simulation.joint_state(1).position == pytest.approx(0.8, abs=0.005)


@pytest.mark.parametrize("flipped", [False, True])
@pytest.mark.parametrize("loop", [False, True])
def test_a_conetwist_swings_within_a_cone_and_twists_within_its_limit(flipped: bool, loop: bool) -> None:
    simulation = scene()
    simulation.add_body(1, box((0.0, 5.0, 0.0), frozen=True))
    simulation.add_body(2, box((0.0, 3.8, 0.0)))
    if loop:  # an older joint takes the tree's place: the cone closes a loop and is welded to its cube by a proxy
        simulation.add_body(3, box((0.0, 5.0, 9.0), size=(0.1, 0.1, 0.1), frozen=True))
        simulation.add_joint(1, JointSpec("pin", 3, 2, (0.0, 4.4, 0.0), (1.0, 0.0, 0.0)))
    ends = (2, 1) if flipped else (1, 2)
    params = JointParams(limits=(0.4, 0.3))
    simulation.add_joint(2, JointSpec("conetwist", *ends, (0.0, 4.4, 0.0), (0.0, -1.0, 0.0), params))
    swing = twist = 0.0
    directions = set()
    for tick in range(600):
        push = (20 * math.sin(tick / 20), 0.0, 15 * math.cos(tick / 33))
        simulation.apply(2, push, (0.0, 2.0 * math.sin(tick / 25), 0.0), NONE, NONE)
        simulation.step(4)
        axis = rotate(simulation.body_state(2).quaternion, (0.0, -1.0, 0.0))
        swing = max(swing, math.acos(-axis[1]))
        twist = max(twist, abs(simulation.joint_state(2).position))
        if -axis[1] < math.cos(0.35):
            directions.add((axis[0] > 0, axis[2] > 0))
    assert swing == pytest.approx(0.4, abs=0.06) and twist == pytest.approx(0.3, abs=0.08)
    assert len(directions) == 4


def test_a_ball_that_gets_limits_stays_where_it_is() -> None:
    simulation = scene()
    simulation.add_body(1, box((0.0, 5.0, 0.0), frozen=True))
    simulation.add_body(2, box((0.0, 3.8, 0.0)))
    simulation.add_joint(1, JointSpec("conetwist", 1, 2, (0.0, 4.4, 0.0), (0.0, -1.0, 0.0)))
    simulation.apply(2, NONE, NONE, (0.3, 0.0, 0.2), (0.0, 0.05, 0.0))
    for _ in range(10):
        simulation.step(4)
    before, reading = simulation.states([2]), simulation.joint_state(1)
    for limits in ((0.8, 0.8), (1.0, 0.5), None):
        simulation.set_joint_params(1, JointParams(limits=limits))
        simulation.snapshot()
        assert simulation.states([2]) == pytest.approx(before, abs=1e-9)
        assert simulation.joint_state(1).position == pytest.approx(reading.position, abs=1e-9)


def test_joint_limits_hold() -> None:
    simulation = scene()
    simulation.add_body(1, box((0.0, 5.0, 0.0), frozen=True))
    simulation.add_body(2, box((1.2, 5.0, 0.0)))
    simulation.add_joint(1, JointSpec("hinge", 1, 2, (0.6, 5.0, 0.0), (0.0, 0.0, 1.0), JointParams(limits=(-0.4, 0.2))))
    for _ in range(240):
        simulation.step(4)
    assert simulation.joint_state(1).position == pytest.approx(-0.4, abs=0.01)


def test_jointed_cubes_do_not_collide_and_others_do() -> None:
    simulation = scene(gravity=0)
    simulation.add_body(1, box((0.0, 5.0, 0.0), frozen=True))
    simulation.add_body(2, box((0.5, 5.0, 0.0)))
    simulation.add_joint(1, JointSpec("hinge", 1, 2, (0.25, 5.0, 0.0), (0.0, 0.0, 1.0)))
    simulation.add_body(3, box((5.0, 5.0, 0.0), frozen=True))
    simulation.add_body(4, box((5.5, 5.0, 0.0)))
    for _ in range(30):
        simulation.step(4)
    assert simulation.body_state(2).position == (0.5, 5.0, 0.0)
    assert simulation.body_state(4).position[0] > 5.9


def test_a_grid_with_loops_holds_together_and_gains_no_energy() -> None:
    simulation = scene(gravity=0)
    joints, made = grid(simulation, height=20.0)
    masses = dict.fromkeys(range(1, 10), 1.0)
    simulation.apply(1, NONE, NONE, (0.5, 1.0, 0.0), (0.1, 0.2, 0.3))
    simulation.apply(5, NONE, NONE, (0.5, -1.0, 1.0), NONE)
    simulation.step(4)
    energy, worst = kinetic_energy(simulation, masses), 0.0
    for _ in range(3599):
        simulation.step(4)
        worst = max(worst, anchor_error(simulation, joints, made))
    assert worst < 0.005
    assert kinetic_energy(simulation, masses) < 1.05 * energy
    assert momentum(simulation, masses)[0] == pytest.approx([1.0, 0.0, 1.0], abs=0.05)


def test_a_hopping_grid_holds_together() -> None:
    simulation = scene()
    joints, made = grid(simulation)
    worst = 0.0
    for tick in range(600):
        if tick % 120 == 0:
            for body in range(1, 10):
                simulation.apply(body, NONE, NONE, (0.0, 3.0, 0.0), NONE)
        simulation.step(4)
        worst = max(worst, anchor_error(simulation, joints, made))
    assert worst < 0.005


def ring(simulation: Simulation, kind: str, count: int = 8) -> Made:
    """A closed chain of cubes in an upright circle, joined all around."""
    radius = 0.6 / math.sin(math.pi / count)
    places = [
        (radius * math.cos(2 * math.pi * i / count), 9 + radius * math.sin(2 * math.pi * i / count), 0.0)
        for i in range(count)
    ]
    return joined(simulation, kind, places, [(i, (i + 1) % count) for i in range(count)])


def cage(simulation: Simulation, kind: str) -> Made:
    """Eight cubes at the corners of a cube, joined along its twelve edges."""
    corners = [(x, y, z) for x in (0.0, 1.5) for y in (8.0, 9.5) for z in (0.0, 1.5)]
    edges = [(i, k) for i in range(8) for k in range(i + 1, 8) if math.dist(corners[i], corners[k]) < 1.6]
    return joined(simulation, kind, corners, edges)


def joined(simulation: Simulation, kind: str, places: list[Vector], pairs: list[tuple[int, int]]) -> Made:
    for i, place in enumerate(places):
        simulation.add_body(i + 1, box(place))
    joints: dict[int, JointSpec] = {}
    made: dict[int, tuple[Vector, Vector]] = {}
    for number, (i, k) in enumerate(pairs, 1):
        anchor = vector(np.add(places[i], places[k]) / 2)
        joints[number] = JointSpec(kind, i + 1, k + 1, anchor, (0.0, 0.0, 1.0))
        made[number] = (vector(np.subtract(anchor, places[i])), vector(np.subtract(anchor, places[k])))
        simulation.add_joint(number, joints[number])
    return joints, made


@pytest.mark.parametrize("kind", ["hinge", "pin", "fixed", "conetwist"])
@pytest.mark.parametrize("build_loops", [ring, cage])
def test_loops_hold_together_for_a_minute_and_gain_no_energy(
    build_loops: Callable[[Simulation, str], Made], kind: str
) -> None:
    simulation = scene(gravity=0)
    joints, made = build_loops(simulation, kind)
    masses = dict.fromkeys(range(1, 9), 1.0)
    simulation.apply(1, NONE, NONE, (0.5, 1.0, 0.2), (0.1, 0.2, 0.3))
    simulation.apply(5, NONE, NONE, (0.5, -1.0, 0.5), NONE)
    for _ in range(30):
        simulation.step(4)
    energy, worst = kinetic_energy(simulation, masses), 0.0
    for tick in range(3600):
        simulation.step(4)
        if tick % 10 == 0:
            worst = max(worst, anchor_error(simulation, joints, made))
    assert worst < 0.005
    assert kinetic_energy(simulation, masses) < 1.05 * energy
    assert momentum(simulation, masses)[0] == pytest.approx([1.0, 0.0, 0.7], abs=0.07)


@pytest.mark.parametrize("kind", ["fixed", "hinge", "slide", "pin"])
def test_every_kind_of_joint_closes_a_loop(kind: str) -> None:
    simulation = scene()
    corners = [(0.0, 5.0, 0.0), (1.5, 5.0, 0.0), (1.5, 3.5, 0.0), (0.0, 3.5, 0.0)]
    for body, corner in enumerate(corners, 1):
        simulation.add_body(body, box(corner, frozen=body == 1))
    joints: dict[int, JointSpec] = {}
    made: dict[int, tuple[Vector, Vector]] = {}
    for number, (a, b, k) in enumerate([(1, 2, "hinge"), (2, 3, "hinge"), (3, 4, "hinge"), (4, 1, kind)], 1):
        here, there = corners[a - 1], corners[b - 1]
        anchor = vector(np.add(here, there) / 2)
        joints[number] = JointSpec(k, a, b, anchor, (0.0, 1.0, 0.0) if k == "slide" else (0.0, 0.0, 1.0))
        made[number] = (vector(np.subtract(anchor, here)), vector(np.subtract(anchor, there)))
        simulation.add_joint(number, joints[number])
    for _ in range(300):
        simulation.step(4)
    if kind == "slide":
        del joints[4]  # its ends do move apart, along the axis only
        state, reading = simulation.body_state(4), simulation.joint_state(4)
        assert state.position[0] == pytest.approx(0.0, abs=0.005)
        assert state.position[1] == pytest.approx(3.5 - reading.position, abs=0.005)
    assert anchor_error(simulation, joints, made) < 0.005
