"""What joints do to bodies, for each kind of joint that a backend promises."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from nmes.backend import JointParams, JointSpec, Simulation, Vector
from nmes.backend.contract.base import (
    KINDS,
    SUBSTEPS,
    TICK,
    ZERO,
    Checks,
    G,
    about_z,
    assert_close,
    box,
    carried_point,
    joint,
    joint_gap,
    kinetic,
    momenta,
    run,
    vector,
)

Joints = dict[int, JointParams]


class JointChecks(Checks):
    """Checks of joints: how they hold, are read, driven and cut."""

    def test_holds_joints_together(self) -> None:
        """A thrown pair stays joined, keeps its momenta and gains no energy, for each kind of joint."""
        for kind in KINDS:
            if not self.can(f"joint.{kind}"):
                continue
            sim = self.space()
            specs = {0: box((-0.5, 0.0, 0.0), mass=1.0), 1: box((0.5, 0.0, 0.0), mass=2.0)}
            for body, spec in specs.items():
                sim.add_body(body, spec)
            limits = (-3.0, 3.0) if kind == "slide" and self.can("limits") else None
            sim.add_joint(0, joint(kind, 0.0, limits))
            sim.apply(0, ZERO, ZERO, (0.0, 1.0, 0.0), (0.0, 0.0, 0.2))
            sim.apply(1, ZERO, ZERO, (0.5, -2.0, 0.0), ZERO)
            sim.step(SUBSTEPS)
            energy = kinetic(sim, specs)
            before = np.array((0.5, -1.0, 0.0, 0.0, 0.0, -0.5 * 1.0 - 0.5 * 2.0 + 0.2))
            for _ in range(round(5.0 / TICK)):
                sim.step(SUBSTEPS)
                gap = joint_gap(sim, kind)
                assert gap <= self.joint_error, f"{kind}: the halves are {gap} m apart"
            after = momenta(sim, specs)
            scale = float(np.linalg.norm(before))
            assert_close(after[:3], before[:3], self.joint_momentum_error * scale, f"{kind}: momentum")
            assert_close(after[3:], before[3:], 0.02 * scale, f"{kind}: angular momentum")
            assert kinetic(sim, specs) <= energy * (1 + self.energy_error), f"{kind}: gained energy"

    def test_keeps_momentum_when_joined(self) -> None:
        """Two bodies that are joined while they fly apart go on together with the momenta that they had."""
        for kind in KINDS:
            if not self.can(f"joint.{kind}"):
                continue
            sim = self.space()
            specs = {
                0: box((-0.5, 0.0, 0.0), mass=1.0, linear_velocity=(0.0, 1.0, 0.0), angular_velocity=(0.0, 0.0, 1.0)),
                1: box((0.5, 0.0, 0.0), mass=2.0, linear_velocity=(0.5, -1.0, 0.0)),
            }
            for body, spec in specs.items():
                sim.add_body(body, spec)
            before, energy = momenta(sim, specs), kinetic(sim, specs)
            sim.add_joint(0, joint(kind, 0.0))
            run(sim, 0.2)
            after, scale = momenta(sim, specs), float(np.linalg.norm(before))
            assert_close(after[:3], before[:3], self.joint_momentum_error * scale, f"{kind}: momentum")
            assert_close(after[3:], before[3:], 0.02 * scale, f"{kind}: angular momentum")
            assert kinetic(sim, specs) <= energy * (1 + self.energy_error), f"{kind}: gained energy"

    def test_keeps_momentum_when_cut(self) -> None:
        """A spinning pair that is cut flies apart with the momenta that it had."""
        for kind in KINDS:
            if not self.can(f"joint.{kind}"):
                continue
            sim = self.space()
            specs = {
                0: box((-0.5, 0.0, 0.0), linear_velocity=(0.0, -1.0, 0.0), angular_velocity=(0.0, 0.0, 2.0)),
                1: box((0.5, 0.0, 0.0), linear_velocity=(0.0, 1.0, 0.0), angular_velocity=(0.0, 0.0, 2.0)),
            }
            for body, spec in specs.items():
                sim.add_body(body, spec)
            sim.add_joint(0, joint(kind, 0.0))
            run(sim, 0.25)
            before, rows = momenta(sim, specs), sim.states([0, 1])
            sim.remove_joint(0)
            assert_close(sim.states([0, 1]).ravel(), rows.ravel(), 1e-9, f"{kind}: states right after the cut")
            sim.step(1)
            assert_close(momenta(sim, specs), before, 1e-6 * float(np.linalg.norm(before)), f"{kind}: momenta")
            run(sim, 2.0)
            apart = float(np.linalg.norm(np.diff(sim.states([0, 1])[:, :3], axis=0)))
            assert apart > 1.5, f"{kind}: {apart} m from each other 2 s after the cut"

    def test_damps_joined_bodies(self) -> None:
        """Each body's own velocity is damped, as by a force at its centre, whatever joins it to others."""
        self.need("scene.damping")
        for kind in KINDS:
            if self.can(f"joint.{kind}"):
                for linear, angular in ((0.4, 0.4), (0.6, 0.2), (0.0, 0.5)):
                    self._damp_pair(kind, linear, angular)
                    self._damp_machine(kind, linear, angular)

    def _damp_pair(self, kind: str, linear: float, angular: float) -> None:
        """Momentum decays as that of free bodies would; a rigid pair's spin as its shares of motion and of turning."""
        sim = self.sim(gravity=ZERO, ground=False, linear_damping=linear, angular_damping=angular)
        specs = {
            0: box((-0.5, 0.0, 0.0), linear_velocity=(2.0, -0.5, 0.0), angular_velocity=(0.0, 0.0, 1.0)),
            1: box((0.5, 0.0, 0.0), linear_velocity=(2.0, 0.5, 0.0), angular_velocity=(0.0, 0.0, 1.0)),
        }
        for number, spec in specs.items():
            sim.add_body(number, spec)
        sim.add_joint(0, joint(kind, height=0.0))
        before = momenta(sim, specs)
        run(sim, 1.0)
        kept = before[:3] * math.exp(-linear)
        what = f"{kind}, damping {linear:g} and {angular:g} 1/s"
        assert_close(momenta(sim, specs)[:3], kept, 4.0 * max(self.joint_momentum_error, 1e-3), f"momentum: {what}")
        if kind == "fixed":
            rate = (0.5 * linear + angular / 3.0) / (0.5 + 1.0 / 3.0)  # m r^2, and a cube's own moment, of both
            spins = sim.states([0, 1])[:, 12]
            assert_close(spins, [math.exp(-rate)] * 2, 5e-3, f"spin: {what}")

    def _damp_machine(self, kind: str, linear: float, angular: float) -> None:
        """A cube on an immovable base keeps the part of its speed that its own damping leaves."""
        if kind not in ("hinge", "slide"):
            return
        sim = self.machine(kind, JointParams(), linear_damping=linear, angular_damping=angular)
        self.drive(sim, kind, 1.0 / 6.0 if kind == "hinge" else 1.0)
        run(sim, 1.0)
        rate = angular if kind == "hinge" else linear
        speed = sim.joint_state(0).velocity
        assert_close([speed], [math.exp(-rate)], 5e-3, f"speed of a {kind}, damping {linear:g} and {angular:g} 1/s")

    def test_holds_several_joints_of_one_pair(self) -> None:
        """A second joint between two bodies holds them too, of whatever kind, also when the first is cut."""
        self.need("joint.several")
        kinds = [kind for kind in KINDS if self.can(f"joint.{kind}")]
        for first, second in [*((kind, kind) for kind in kinds), (kinds[-1], kinds[0])]:
            sim = self.space()
            sim.add_body(0, box((-0.5, 0.0, 0.0), mass=1.0))
            sim.add_body(1, box((0.5, 0.0, 0.0), mass=2.0))
            for number, kind in enumerate((first, second)):
                limits = (-3.0, 3.0) if kind == "slide" and self.can("limits") else None
                sim.add_joint(number, joint(kind, 0.0, limits))
            sim.apply(0, ZERO, ZERO, (0.0, 1.0, 0.0), (0.0, 0.0, 0.2))
            sim.apply(1, ZERO, ZERO, (0.5, -2.0, 0.0), ZERO)
            for cut in (False, True):
                if cut:
                    sim.remove_joint(0)
                run(sim, 1.0)
                for kind in (second,) if cut else (first, second):
                    gap = joint_gap(sim, kind)
                    assert gap <= self.joint_error, f"{first} and {second}, cut {cut}: {gap} m apart as a {kind} joint"
            sim.remove_joint(1)
            apart = sim.states([1])[0, :3] - sim.states([0])[0, :3]
            sim.apply(1, ZERO, ZERO, vector(20.0 * apart), ZERO)
            run(sim, 0.5)
            distance = float(np.linalg.norm(np.diff(sim.states([0, 1])[:, :3], axis=0)))
            assert distance > 2.0, f"{first} and {second}: {distance} m from each other when both are cut"

    def test_lets_joined_bodies_overlap(self) -> None:
        """Jointed bodies do not collide with each other."""
        kind = self.a_joint("fixed", "hinge")
        sim = self.space()
        sim.add_body(0, box(ZERO))
        sim.add_body(1, box((0.5, 0.0, 0.0)))
        sim.add_joint(0, JointSpec(kind, 0, 1, (0.25, 0.0, 0.0), (0.0, 0.0, 1.0)))
        run(sim, 1.0)
        assert_close(sim.states([0, 1])[:, 0], (0.0, 0.5), 1e-6, "places of overlapping joined bodies")

    def test_reads_joints(self) -> None:
        """Position and velocity of hinge and slide: zero where they are made, signed by their axis, wherever rooted."""
        for kind, sign in (("hinge", 1), ("hinge", -1), ("slide", 1), ("slide", -1)):
            if not self.can(f"joint.{kind}"):
                continue
            sim = self.pair()
            axis = (0.0, 0.0, float(sign)) if kind == "hinge" else (float(sign), 0.0, 0.0)
            sim.set_frozen(0, True)
            sim.add_joint(0, replace(joint(kind), axis=axis))
            reading = sim.joint_state(0)
            assert_close(reading.anchor, (0.0, 3.0, 0.0), 1e-6, f"{kind}: anchor")
            assert_close(reading.axis, axis, 1e-6, f"{kind}: axis")
            assert reading.position == 0.0 and reading.velocity == 0.0 and reading.effort == 0.0, reading
            push = (0.0, 0.4, 0.0) if kind == "hinge" else (0.4, 0.0, 0.0)
            sim.apply(1, ZERO, ZERO, push, ZERO)
            run(sim, 0.5)
            reading, row = sim.joint_state(0), sim.states([1])[0]
            motion, speed = (2 * math.asin(row[5]), row[12]) if kind == "hinge" else (row[0] - 0.5, row[7])
            assert motion > 0.05, f"{kind}: hardly moves"
            assert_close([reading.position], [sign * motion], 1e-3, f"{kind}: position")
            assert_close([reading.velocity], [sign * speed], 1e-3, f"{kind}: velocity")
            sim.set_frozen(1, True)
            sim.set_frozen(0, False)
            assert_close([sim.joint_state(0).position], [sign * motion], 1e-3, f"{kind}: position, rooted elsewhere")
            sim.step(SUBSTEPS)
            assert_close([sim.joint_state(0).position], [sign * motion], 1e-2, f"{kind}: position, rooted elsewhere")

    def test_keeps_joints_that_are_frozen_at_both_ends(self) -> None:
        """A joint between two frozen bodies reads on where it is, and is there when either of them is released."""
        for kind, push in (("hinge", 0.1), ("hinge", -2.0), ("slide", 3.0)):  # the second one goes round and round
            for released in (0, 1):
                if not self.can(f"joint.{kind}"):
                    continue
                sim = self.machine(kind, JointParams())
                self.drive(sim, kind, push)
                run(sim, 1.0)
                there, what = sim.joint_state(0).position, f"{kind}, body {released} is released"
                assert abs(there) > (math.tau if push < 0.0 else 0.5), f"{what}: hardly moves"
                sim.set_frozen(1, True)
                run(sim, 0.1)
                rows = sim.states([0, 1])
                assert_close(sim.joint_readings((0,)), [[there, 0.0, 0.0]], 1e-6, f"{what}: while both are frozen")
                if self.can("snapshot"):
                    again = self.sim(gravity=ZERO, ground=False)
                    again.restore(sim.snapshot())
                    assert again.digest() == sim.digest(), f"{what}: restored, it is another world"
                    sim = again
                sim.set_frozen(released, False)
                for when in ("before the step", "after it"):
                    assert_close(sim.joint_readings((0,)), [[there, 0.0, 0.0]], 1e-6, f"{what}: {when}")
                    assert_close(sim.states([0, 1]), rows, 1e-6, f"{what}: states {when}")
                    sim.step(SUBSTEPS)

    def test_swings_a_pendulum(self) -> None:
        """A pendulum's period is that of its inertia."""
        self.need("joint.hinge")
        sim = self.sim(ground=False)
        lean = 0.1
        arm = box((0.5 * math.sin(lean), 9.5 - 0.5 * math.cos(lean), 0.0), size=(0.2, 1.0, 0.2))
        sim.add_body(0, box((0.0, 10.0, 0.0), frozen=True))
        sim.add_body(1, replace(arm, quaternion=about_z(lean)))
        sim.add_joint(0, JointSpec("hinge", 0, 1, (0.0, 9.5, 0.0), (0.0, 0.0, 1.0)))
        inertia = (0.2**2 + 1.0**2) / 12 + 0.5**2
        expected = math.tau * math.sqrt(inertia / (G * 0.5)) * (1 + lean**2 / 16)
        self.swings(sim, lambda: sim.states([1])[0, 0], expected, "pendulum")

    def test_hangs_a_mass_on_a_spring(self) -> None:
        """A known mass on a known spring, along a slide and about a hinge, swings as it should; damping damps it."""
        self.need("spring")
        for kind, inertia in (("slide", 1.0), ("hinge", 1 / 6)):
            if not self.can(f"joint.{kind}"):
                continue
            stiffness = 40.0 * inertia
            sim = self.machine(kind, JointParams(stiffness=stiffness))
            self.drive(sim, kind, 0.5 * inertia)
            period = math.tau * math.sqrt(inertia / stiffness)
            self.swings(sim, lambda s=sim: s.joint_state(0).position, period, f"{kind} spring")  # type: ignore[misc]
            sim = self.machine(kind, JointParams(damping=2.0 * inertia))
            self.drive(sim, kind, 0.5 * inertia)
            run(sim, 0.5)
            speed = sim.joint_state(0).velocity
            assert_close([speed], [0.5 * math.exp(-1.0)], 0.02, f"{kind}: velocity after damping")

    def test_drives_motors(self) -> None:
        """A motor accelerates as its effort allows, reaches its velocity, and never applies more than its bound."""
        self.need("motor")
        for kind, inertia in (("hinge", 1 / 6), ("slide", 1.0)):
            if not self.can(f"joint.{kind}"):
                continue
            for target in (3.0, -3.0):
                effort = 12.0 * inertia
                sim = self.machine(kind, JointParams("velocity", target_velocity=target, max_effort=effort))
                run(sim, 0.1)
                reading = sim.joint_state(0)
                sign = math.copysign(1.0, target)
                assert_close([reading.velocity], [sign * 1.2], 1.2 * 2 * self.motor_error, f"{kind}: speed on the way")
                assert_close([reading.effort], [sign * effort], effort * self.motor_error, f"{kind}: effort on the way")
                for _ in range(60):
                    sim.step(SUBSTEPS)
                    applied = abs(sim.joint_state(0).effort)
                    assert applied <= effort * 1.000001, f"{kind}: applies {applied} of at most {effort}"
                reading = sim.joint_state(0)
                assert_close([reading.velocity], [target], 3.0 * self.motor_error, f"{kind}: speed reached")
                row = sim.states([1])[0]
                assert_close(
                    [row[12] if kind == "hinge" else row[7]], [target], 3.0 * self.motor_error, f"{kind}: motion"
                )
                sim.set_joint_params(0, JointParams())
                run(sim, 0.2)
                after = sim.joint_state(0)
                assert_close([after.velocity, after.effort], [reading.velocity, 0.0], 1e-3, f"{kind}: coasting")

    def test_tells_power(self) -> None:
        """Motors have powers where joints have motors, of as many joints as are asked for, and of no other joint."""
        self.need("motor")
        kind = next(kind for kind in ("hinge", "slide") if self.can(f"joint.{kind}"))
        motor = JointParams("velocity", target_velocity=2.0, max_effort=1.0)
        sim = self.machine(kind, motor)
        for number, x in ((1, 5.0), (2, 10.0)):
            sim.add_body(10 * number, box((x, 0.0, 0.0), frozen=True))
            sim.add_body(10 * number + 1, box((x + 2.0, 0.0, 0.0)))
            params = JointParams() if number == 1 else replace(motor, max_effort=0.5)
            axis = (0.0, 0.0, 1.0) if kind == "hinge" else (1.0, 0.0, 0.0)
            spec = JointSpec(kind, 10 * number, 10 * number + 1, (x + 2.0, 0.0, 0.0), axis, params)
            sim.add_joint(number, spec)
        for tick, joints in enumerate([(0, 1, 2)] * 4 + [(2,), (1,), (2, 0), (), (0, 1, 2)]):
            if tick == 3:
                sim.set_joint_params(0, JointParams())
            sim.step(SUBSTEPS)
            powers, alone = np.full((2, len(joints)), np.nan), np.full((2, 1), np.nan)
            sim.powers(joints, powers)
            for column, number in enumerate(joints):
                sim.powers((number,), alone)
                assert powers[:, column].tolist() == alone[:, 0].tolist(), f"tick {tick}: joints {joints}"
                assert number != 1 or not alone.any(), "a joint without a motor has no power"
                assert number != 0 or tick < 3 or not alone.any(), "a motor that is off has no power"
            if 0 in joints and tick < 3:
                assert powers[0, 0] == powers[1, 0] > 0.0, "a motor that accelerates has power"

    def test_power_is_what_the_motor_gives_to_the_scene(self) -> None:
        """What a motor gives a cube is the cube's kinetic energy, however fast it reaches its velocity, and turns."""
        self.need("motor")
        for kind in ("hinge", "slide"):
            if not self.can(f"joint.{kind}"):
                continue
            for effort in (5.0, 500.0):  # at its bound, and far below it
                sim = self.machine(kind, JointParams("velocity", target_velocity=2.0, max_effort=effort))
                inertia, work, size, powers = (1.0 / 6.0 if kind == "hinge" else 1.0), 0.0, 0.0, np.zeros((2, 1))
                for target in (2.0, -2.0):
                    sim.set_joint_params(0, JointParams("velocity", target_velocity=target, max_effort=effort))
                    for _ in range(60):
                        sim.step(SUBSTEPS)
                        sim.powers((0,), powers)
                        work, size = work + powers[0, 0] * TICK, size + powers[1, 0] * TICK
                        given = inertia * sim.joint_state(0).velocity ** 2 / 2.0
                        assert_close([work], [given], 0.01 * inertia, f"{kind}: work at {effort}")
                        assert size >= abs(work) - 1e-9, f"{kind}: the size of the work at {effort}"
                assert effort > 5.0 or size > 1.5 * work, f"{kind}: braking counts in the size of the work"

    def test_keeps_track(self) -> None:
        """A track holds what states and readings said when its rows were kept, also while the structure changes."""
        self.need("motor")
        kind = next(kind for kind in ("hinge", "slide") if self.can(f"joint.{kind}"))
        sim = self.machine(kind, JointParams("velocity", target_velocity=2.0, max_effort=5.0), gravity=(0.0, -G, 0.0))
        bodies = [1, 0]
        track, records = sim.track(bodies, [0], [0], 9), []
        for row in range(9):
            if row == 4:
                sim.set_body_state(1, replace(sim.body_state(1), linear_velocity=(0.0, 0.1, 0.0)))
            if row == 6:
                sim.add_body(7, box((30.0, 0.5, 0.0)))
            track.note()
            powers = np.zeros((2, 1))
            sim.powers((0,), powers)
            records.append((sim.states(bodies), sim.joint_state(0).position, powers))
            sim.step(SUBSTEPS)
        assert track.rows == 9
        states, positions, tracked = track.states(0, 9), track.positions(2, 9), track.powers(2, 9)
        for row, (state, position, powers) in enumerate(records):
            assert np.array_equal(states[row], state), f"row {row}: states"
            if row >= 2:
                assert positions[row - 2, 0] == position, f"row {row}: position"
                assert np.array_equal(tracked[row - 2], powers), f"row {row}: powers"
        assert np.array_equal(track.states(3, 5), states[3:5])

    def test_holds_servos(self) -> None:
        """A servo goes to its position and holds it there against gravity, with the effort that this takes."""
        self.need("servo")
        for kind in ("hinge", "slide"):
            if not self.can(f"joint.{kind}"):
                continue
            sim = self.machine(kind, JointParams(), gravity=(0.0, -G, 0.0), hanging=True)
            for target in (0.5, -0.3):
                sim.set_joint_params(0, JointParams("position", target_position=target, max_effort=60.0))
                run(sim, 3.0)
                reading = sim.joint_state(0)
                assert_close([reading.position], [target], max(self.motor_error, 0.02), f"{kind}: position held")
                assert_close([reading.velocity], [0.0], 0.01, f"{kind}: velocity while holding")
                weight = G * 0.5 * math.cos(target) if kind == "hinge" else G
                assert_close([reading.effort], [weight], 0.05 * G, f"{kind}: effort while holding")

    def test_drives_and_reads_many_joints_at_once(self) -> None:
        """Many targets set, many joints read and many touches felt in one call are what one by one gives."""
        modes: tuple[tuple[Literal["position", "velocity"], str], ...] = (("position", "servo"), ("velocity", "motor"))
        for motor, capability in modes:
            kinds = [kind for kind in ("hinge", "slide") if self.can(f"joint.{kind}")]
            if not self.can(capability) or not kinds:
                continue
            one, many = self.chain(kinds, motor), self.chain(kinds, motor)
            params = [one[1][joint] for joint in sorted(one[1])]
            joints = tuple(sorted(one[1]))
            for tick in range(40):
                targets = np.array([0.4 * math.sin(0.3 * tick + joint) for joint in joints])
                if tick % 5 != 4:
                    many[0].set_motor_targets(joints, params, targets)
                    for joint, own, target in zip(joints, params, targets.tolist(), strict=True):
                        one[0].set_joint_params(joint, own.with_target(target))
                if tick == 20:  # a change of another kind finds the targets that were set
                    params[0] = replace(params[0], max_effort=3.0).with_target(float(targets[0]))
                    for sim in (one[0], many[0]):
                        sim.set_joint_params(joints[0], params[0])
                if tick == 30:  # and so does a change of structure
                    for sim in (one[0], many[0]):
                        sim.add_body(9, box((0.0, 9.0, 0.0)))
                assert one[0].digest() == many[0].digest(), f"{motor}: another digest before tick {tick}"
                for sim in (one[0], many[0]):
                    sim.step(SUBSTEPS)
                assert one[0].digest() == many[0].digest(), f"{motor}: another digest after tick {tick}"
                states = [many[0].joint_state(joint) for joint in reversed(joints)]
                expected = [(state.position, state.velocity, state.effort) for state in states]
                assert many[0].joint_readings(joints[::-1]).tolist() == [list(row) for row in expected]
                bodies = [3, 0, 1]
                assert many[0].touching(bodies).tolist() == [bool(many[0].contacts(body)) for body in bodies]
            if self.can("snapshot"):
                again = self.sim()
                again.restore(many[0].snapshot())
                for sim in (one[0], again):
                    sim.set_joint_params(joints[0], params[0].with_target(0.1))
                    sim.step(SUBSTEPS)
                assert_close(again.joint_readings(joints), one[0].joint_readings(joints), 1e-9, f"{motor}: restored")

    def chain(self, kinds: Sequence[str], motor: Literal["position", "velocity"]) -> tuple[Simulation, Joints]:
        """Returns four cubes on the ground in a row, and the parameters of the motors between them."""
        sim = self.sim()
        for i in range(4):
            sim.add_body(i, box((1.2 * i, 0.5 + (i == 3), 0.0)))
        params = {}
        for i in range(3):
            kind = kinds[i % len(kinds)]
            axis = (0.0, 0.0, 1.0) if kind == "hinge" else (1.0, 0.0, 0.0)
            params[i] = JointParams(motor, max_effort=20.0)
            sim.add_joint(i, JointSpec(kind, i, i + 1, (1.2 * i + 0.6, 0.5, 0.0), axis, params[i]))
        return sim, params

    def test_stops_at_limits(self) -> None:
        """What falls stops at the joint's limit; lifting the limit lets it go on."""
        self.need("limits")
        for kind in ("hinge", "slide"):
            if not self.can(f"joint.{kind}"):
                continue
            sim = self.machine(kind, JointParams(limits=(-0.4, 0.3)), gravity=(0.0, -G, 0.0), hanging=True)
            run(sim, 4.0)
            assert_close([sim.joint_state(0).position], [-0.4], 0.02, f"{kind}: position at the limit")
            sim.set_joint_params(0, JointParams(limits=(-0.4, -0.4)))
            run(sim, 1.0)
            assert_close([sim.joint_state(0).position], [-0.4], 0.02, f"{kind}: position between equal limits")
            sim.set_joint_params(0, JointParams())
            run(sim, 0.3)
            assert sim.joint_state(0).position < -0.5, f"{kind}: held by a limit that is gone"

    def test_swings_and_twists_within_a_cone(self) -> None:
        """A conetwist joint swings and twists as far as its two limits say."""
        self.need("joint.conetwist")
        self.need("limits")
        for axis, stop in (((1.0, 0.0, 0.0), 0.3), ((0.0, 0.0, 1.0), 0.7)):
            sim = self.sim(ground=False)
            sim.add_body(0, box((0.0, 5.0, 0.0), frozen=True))
            sim.add_body(1, box((1.0, 5.0, 0.0)))
            sim.add_joint(0, JointSpec("conetwist", 0, 1, (0.5, 5.0, 0.0), axis, JointParams(limits=(0.3, 0.7))))
            run(sim, 4.0)
            assert_close(sim.body_state(1).quaternion, about_z(-stop), 0.02, f"how far it hangs about {axis}")

    def test_reads_twists(self) -> None:
        """A conetwist joint reads its twist, signed by its axis, and no swing."""
        self.need("joint.conetwist")
        axes: tuple[tuple[Vector, int], ...] = (((0.0, 0.0, 1.0), 1), ((0.0, 0.0, -1.0), -1), ((1.0, 0.0, 0.0), 0))
        for axis, sign in axes:
            sim = self.space()
            sim.add_body(0, box((-5.0, 0.0, 0.0), frozen=True))
            sim.add_body(1, box(ZERO, angular_velocity=(0.0, 0.0, 1.5)))
            sim.add_joint(0, JointSpec("conetwist", 0, 1, ZERO, axis))
            for _ in range(240):  # round and round
                sim.step(SUBSTEPS)
                reading, row = sim.joint_state(0), sim.states([1])[0]
                turned = math.remainder(sign * 2.0 * math.atan2(row[5], row[6]), math.tau)
                assert_close([reading.velocity], [sign * row[12]], 1e-6, f"twist about {axis}: velocity")
                off = math.remainder(reading.position - turned, math.tau)
                assert_close([off], [0.0], 1e-6, f"twist about {axis}: position")
                assert abs(reading.position) <= math.pi + 1e-9, f"twist about {axis}: {reading.position} rad"

    def test_holds_loops(self) -> None:
        """A 3x3 grid of cubes with 12 hinges drops, holds together and comes to rest."""
        self.need("joint.hinge")
        sim = self.sim()
        for i in range(9):
            sim.add_body(i, box((1.2 * (i % 3), 1.0 + 1.2 * (i // 3), 0.0)))
        pairs = [(i, i + 1) for i in range(9) if i % 3 < 2] + [(i, i + 3) for i in range(6)]
        rows = sim.states(range(9))
        for number, (one, two) in enumerate(pairs):
            middle = (rows[one, :3] + rows[two, :3]) / 2
            sim.add_joint(number, JointSpec("hinge", one, two, vector(middle), (0.0, 0.0, 1.0)))
        arms = [(sim.body_state(a), sim.body_state(b), sim.joint_state(n).anchor) for n, (a, b) in enumerate(pairs)]
        run(sim, 10.0)
        worst = 0.0
        for (one, two), (start1, start2, anchor) in zip(pairs, arms, strict=True):
            here = carried_point(start1, sim.body_state(one), anchor)
            there = carried_point(start2, sim.body_state(two), anchor)
            worst = max(worst, float(np.linalg.norm(here - there)))
        assert worst <= self.joint_error, f"the halves of a hinge are {worst} m apart"
        fastest = float(np.abs(sim.states(range(9))[:, 7:]).max())
        assert fastest < 0.1, f"still moves at {fastest} m/s or rad/s after 10 s"
