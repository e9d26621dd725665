"""How bodies move: what an engine with nothing but bodies and a ground promises."""

from __future__ import annotations

import math
import unittest
from dataclasses import replace
from typing import Any

import numpy as np

from nmes.backend import Arena, BodyState, CameraSpec, Heightfield, JointSpec, Planet, StaticBox
from nmes.backend.contract.base import (
    SUBSTEPS,
    TICK,
    UPRIGHT,
    ZERO,
    Checks,
    G,
    about_z,
    assert_close,
    box,
    kinetic,
    momenta,
    run,
    vector,
)
from nmes.errors import WorldError


class BodyChecks(Checks):
    """Checks of bodies, of what acts on them, of the ground, and of bodies among themselves."""

    def test_shows_a_new_body_at_once(self) -> None:
        """Pose and velocity of a new body are what its spec says, before any step."""
        sim = self.sim()
        spec = box((1.5, 2.5, 0.0), quaternion=about_z(0.3), linear_velocity=(1.0, 2.0, 0.0))
        spec = replace(spec, angular_velocity=(0.0, 0.0, 3.0))
        if self.dims == 3:
            spec = replace(spec, position=(1.5, 2.5, 3.5), linear_velocity=(1.0, 2.0, 4.0))
            spec = replace(spec, angular_velocity=(1.0, 2.0, 3.0))
        sim.add_body(7, spec)
        self.expect(sim, 7, spec)

    def test_answers_states_as_rows(self) -> None:
        """`states` gives what `body_state` gives, in the order asked for, for none too."""
        sim = self.mixed()
        rows = sim.states([2, 0, 1])
        assert rows.shape == (3, 13) and rows.dtype == np.float64, (rows.shape, rows.dtype)
        for row, body in zip(rows, (2, 0, 1), strict=True):
            state = sim.body_state(body)
            one = (*state.position, *state.quaternion, *state.linear_velocity, *state.angular_velocity)
            assert tuple(row) == one, f"body {body}: {tuple(row)} is not {one}"
        assert sim.states([]).shape == (0, 13)

    def test_gives_arrays_away(self) -> None:
        """An answer is the caller's: writing to it changes nothing, and it does not change by itself."""
        sim, bodies = self.mixed(), (0, 1, 2)
        answer = sim.states(bodies)
        copy, digest = answer.copy(), sim.digest()
        sim.states(bodies)[:] = 1e3
        assert np.array_equal(sim.states(bodies), copy), "writing to an answer changed the next one"
        assert sim.digest() == digest, "writing to an answer changed the world"
        sim.step(SUBSTEPS)
        assert not np.array_equal(sim.states(bodies), copy), "a step changed nothing: a stale answer?"
        assert np.array_equal(answer, copy), "an answer that was given before has changed"

    def test_queries_change_nothing(self) -> None:
        """Of two equal worlds one is asked everything between any two ticks; they stay equal."""
        queried, undisturbed = self.mixed(), self.mixed()
        if self.can("joint.fixed"):
            for sim in (queried, undisturbed):
                sim.add_joint(0, JointSpec("fixed", 0, 1, ZERO, (0.0, 0.0, 1.0)))
        for _ in range(60):
            for body in (0, 1, 2):
                queried.body_state(body), queried.sleeping(body), queried.contacts(body)
            queried.states([0, 1, 2]), queried.digest(), queried.digest()
            if self.can("joint.fixed"):
                queried.joint_state(0)
            if self.can("snapshot"):
                queried.snapshot()
            queried.step(SUBSTEPS)
            undisturbed.step(SUBSTEPS)
        assert queried.digest() == undisturbed.digest()

    def test_moves_a_body_where_it_is_told(self) -> None:
        """`set_body_state` shows at once, and the motion goes on from there."""
        sim = self.space()
        sim.add_body(0, box(ZERO, linear_velocity=(5.0, 0.0, 0.0)))
        sim.step(SUBSTEPS)
        state = BodyState((3.0, -2.0, 0.0), about_z(0.5), (0.0, 1.0, 0.0), (0.0, 0.0, -2.0))
        sim.set_body_state(0, state)
        self.expect(sim, 0, state)
        run(sim, 0.5)
        after = sim.body_state(0)
        assert_close(after.position, (3.0, -1.5, 0.0), 0.01, "position")
        assert_close(after.quaternion, about_z(-0.5), 0.01, "quaternion")

    def test_forgets_a_removed_body(self) -> None:
        """The others stay, bit for bit, and nothing touches what is gone."""
        sim = self.mixed()
        run(sim, 0.5)
        before = sim.states([0, 2])
        sim.remove_body(1)
        assert np.array_equal(sim.states([0, 2]), before), "removing a body moved others"
        run(sim, 0.5)
        assert all(contact.other != 1 for body in (0, 2) for contact in sim.contacts(body))
        sim.add_body(9, box((30.0, 5.0, 0.0)))
        assert sim.states([9])[0, 0] == 30.0

    def test_leaves_alone_what_an_edit_does_not_touch(self) -> None:
        """Edits elsewhere keep a moving body's state bit for bit."""
        sim = self.mixed()
        sim.add_body(5, box((40.0, 8.0, 0.0), quaternion=about_z(0.2)))
        sim.apply(5, ZERO, ZERO, (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
        run(sim, 0.3)
        before = sim.states([5])
        sim.add_body(6, box((50.0, 3.0, 0.0)))
        if self.can("joint.fixed"):
            sim.add_joint(0, JointSpec("fixed", 0, 1, (0.0, 5.0, 0.0), (0.0, 0.0, 1.0)))
        sim.set_frozen(2, True)
        assert np.array_equal(sim.states([5]), before), "an edit elsewhere changed the body"
        run(sim, 0.1)
        expected = before[0, 0] + 0.1 * before[0, 7]
        assert_close([sim.states([5])[0, 0]], [expected], 1e-9, "its flight after the edit")

    def test_freezes(self) -> None:
        """A frozen body does not move for anything, can be put elsewhere, and starts from rest when it is released."""
        sim = self.sim()
        sim.add_body(0, box((0.0, 5.0, 0.0), frozen=True, linear_velocity=(1.0, 0.0, 0.0)))
        sim.add_body(1, box((5.0, 5.0, 0.0), linear_velocity=(1.0, 0.0, 0.0)))
        run(sim, 0.2)
        sim.set_frozen(1, True)
        stopped = sim.states([0, 1])
        assert not stopped[:, 7:].any(), "a frozen body has a velocity"
        sim.apply(1, (1e3, 0.0, 0.0), (0.0, 0.0, 10.0), (10.0, 0.0, 0.0), (0.0, 0.0, 10.0))
        run(sim, 0.5)
        assert np.array_equal(sim.states([0, 1]), stopped), "a frozen body moved"
        sim.set_body_state(0, BodyState((0.0, 7.0, 0.0), UPRIGHT, ZERO, ZERO))
        run(sim, 0.1)
        assert_close(sim.body_state(0).position, (0.0, 7.0, 0.0), 1e-9, "where the frozen body was put")
        sim.set_frozen(0, False)
        assert not sim.states([0])[0, 7:].any(), "a released body has a velocity before the step"
        run(sim, 1.0)
        assert_close(sim.body_state(0).position, (0.0, 7.0 - G / 2, 0.0), self.fall_error, "fall after release")

    def test_drops_what_acts_on_a_body_that_is_frozen(self) -> None:
        """What a body was pushed by before it was frozen is gone, also where it is released before the step."""
        sim = self.space()
        sim.add_body(0, box(ZERO))
        sim.apply(0, (6.0, 0.0, 0.0), (0.0, 0.0, 6.0), (2.0, 0.0, 0.0), (0.0, 0.0, 2.0))
        sim.set_frozen(0, True)
        sim.set_frozen(0, False)
        run(sim, 0.1)
        self.expect(sim, 0, box(ZERO))

    def test_applies_forces_and_impulses(self) -> None:
        """They change the momentum by what they should, add up, act in the next step only, and are not seen before."""
        axes = 3 if self.dims == 3 else 2
        for axis in range(axes):
            for name in ("force", "impulse"):
                self._push(name, 1.5, axis, mass=2.0, at=7 + axis)
        for axis in range(3) if axes == 3 else (2,):
            for name in ("torque", "angular_impulse"):
                self._push(name, 1.5, axis, mass=2.0, at=10 + axis)

    def _push(self, name: str, amount: float, axis: int, mass: float, at: int) -> None:
        sim = self.space()
        sim.add_body(0, box(ZERO, mass=mass))
        sim.add_body(1, box((10.0, 0.0, 0.0), mass=mass))
        acting = {"force": ZERO, "torque": ZERO, "impulse": ZERO, "angular_impulse": ZERO}
        acting[name] = vector(amount * (np.arange(3) == axis))
        sim.apply(0, *acting.values())
        sim.apply(0, *acting.values())
        assert not sim.states([0])[0, 7:].any(), f"{name}: acts before the step"
        time = TICK if name in ("force", "torque") else 1.0
        inertia = mass / 6 if at >= 10 else mass
        for when in ("in the step", "after it"):
            sim.step(SUBSTEPS)
            expected = np.zeros(6)
            expected[at - 7] = 2 * amount * time / inertia
            assert_close(sim.states([0])[0, 7:], expected, 1e-9, f"velocity by a {name}, {when}")
        assert not sim.states([1])[0, 7:].any(), f"{name}: acts on another body too"

    def test_turns_bodies_by_their_inertia(self) -> None:
        """A box resists turning by its mass and its edges."""
        sim = self.space()
        sim.add_body(0, box(ZERO, mass=3.0, size=(0.5, 2.0, 1.0)))
        sim.apply(0, ZERO, ZERO, ZERO, (0.0, 0.0, 1.0))
        sim.step(SUBSTEPS)
        inertia = 3.0 * (0.5**2 + 2.0**2) / 12
        assert_close([sim.states([0])[0, 12]], [1 / inertia], 1e-9, "angular velocity")
        run(sim, 1.0)
        angle = sim.states([0])[0, 12] * (1.0 + TICK)
        assert_close(sim.body_state(0).quaternion, about_z(angle), 0.02, "rotation after 1 s")

    def test_keeps_momentum_in_free_flight(self) -> None:
        """A tumbling box keeps velocity and angular momentum, and gains no energy."""
        sim = self.space()
        spin = (0.3, 4.0, 0.2) if self.dims == 3 else (0.0, 0.0, 4.0)
        spec = box(ZERO, mass=2.0, size=(0.4, 1.0, 1.6), linear_velocity=(1.0, 0.5, 0.0), angular_velocity=spin)
        sim.add_body(0, spec)
        before = momenta(sim, {0: spec})
        energy = kinetic(sim, {0: spec})
        run(sim, 2.0)
        after = momenta(sim, {0: spec})
        assert_close(after[:3], before[:3], 1e-9, "momentum")
        assert_close(after[3:], before[3:], 0.02 * float(np.linalg.norm(before[3:])), "angular momentum")
        assert kinetic(sim, {0: spec}) <= energy * (1 + self.energy_error), "gained energy in free flight"

    def test_falls_along_the_parabola(self) -> None:
        """Free fall and projectile, against the formula."""
        sim = self.sim()
        sim.add_body(0, box((0.0, 20.0, 0.0)))
        sim.add_body(1, box((5.0, 20.0, 0.0), mass=50.0, linear_velocity=(3.0, 2.0, 0.0)))
        run(sim, 1.0)
        rows = sim.states([0, 1])
        assert_close(rows[0, :3], (0.0, 20.0 - G / 2, 0.0), self.fall_error, "free fall")
        assert_close(rows[1, :3], (8.0, 22.0 - G / 2, 0.0), self.fall_error, "projectile")
        assert_close(rows[:, 8], (-G, 2.0 - G), 1e-6, "velocity of fall")
        if self.dims == 3:
            sim = self.sim(gravity=(0.0, 0.0, -2.0), ground=False)
            sim.add_body(0, box(ZERO))
            run(sim, 1.0)
            assert_close(sim.body_state(0).position, (0.0, 0.0, -1.0), self.fall_error, "fall along z")

    def test_rests_on_the_ground(self) -> None:
        """A dropped box comes to rest on its lower face; without a ground it falls on."""
        for ground in (True, False):
            sim = self.sim(ground=ground)
            sim.add_body(0, box((0.0, 2.0, 0.0), size=(1.0, 0.6, 1.0)))
            run(sim, 4.0)
            row = sim.states([0])[0]
            if ground:
                assert_close(row[:3], (0.0, 0.3, 0.0), self.rest_error, "where it rests")
                assert_close(row[7:], np.zeros(6), 0.01, "velocity at rest")
            else:
                assert row[1] < -50.0, f"stopped at {row[1]} m without a ground"

    def test_bounces(self) -> None:
        """A body of restitution e comes back to e squared of its height; none comes back higher than it was."""
        for restitution in (0.0, 0.6, 1.0):
            sim = self.sim()
            sim.add_body(0, box((0.0, 1.5, 0.0), restitution=restitution))
            heights: list[float] = []
            for _ in range(90):
                sim.step(SUBSTEPS)
                heights.append(sim.body_state(0).position[1])
            lowest = int(np.argmin(heights[:40]))
            bounce = max(heights[lowest:]) - 0.5
            assert bounce <= 1.0 + 0.05, f"bounces to {bounce} m from 1 m"
            if self.can("restitution"):
                expected = restitution**2
                allowed = self.bounce_error * expected + self.rest_error
                assert_close([bounce], [expected], allowed, f"height of bounce, e = {restitution}")

    def test_slides_only_beyond_the_critical_slope(self) -> None:
        """Friction holds below the critical slope, and above it the body slides as the formula says."""
        if not self.can("friction"):
            raise unittest.SkipTest("no friction")
        for slope, holds in ((0.4, True), (0.65, False)):
            angle = math.atan(slope)
            sim = self.sim(gravity=(G * math.sin(angle), -G * math.cos(angle), 0.0))
            sim.add_body(0, box((0.0, 0.25, 0.0), size=(1.0, 0.5, 1.0), friction=0.5))
            run(sim, 0.5)
            start = sim.states([0])[0]
            run(sim, 1.0)
            way = sim.states([0])[0, 0] - start[0]
            if holds:
                assert_close([way], [0.0], 0.02, "way on a slope below the critical one")
            else:
                pull = G * (math.sin(angle) - 0.5 * math.cos(angle))
                expected = start[7] + pull / 2
                assert_close([way], [expected], self.slide_error * expected, "way on a slope above the critical one")

    def test_stands_on_scenery(self) -> None:
        """What falls on an obstacle, a landscape or a planet comes to rest on it, and touches no body."""
        flat = Heightfield((40.0, 40.0), np.ones((5, 5)))
        scenes: dict[str, dict[str, Any]] = {
            "obstacles": {"boxes": (StaticBox((4.0, 2.0, 4.0), (0.0, 1.0, 0.0)),), "ground": True},
            "heightfield": {"heightfield": flat, "ground": False},
            "planets": {"planets": (Planet((0.0, -9.0, 0.0), 10.0),), "ground": False},
        }
        tops = {"obstacles": 2.0, "heightfield": 1.0, "planets": 1.0}
        for name, scene in scenes.items():
            if not self.can(f"scene.{name}"):
                continue
            sim = self.sim(**scene)
            sim.add_body(0, box((0.0, 4.0, 0.0)))
            run(sim, 3.0)
            state = sim.body_state(0)
            assert_close(state.position, (0.0, tops[name] + 0.5, 0.0), 0.02, f"where it rests on {name}")
            assert_close(state.linear_velocity, ZERO, 0.05, f"velocity at rest on {name}")
            if self.can("contacts"):
                partners = {contact.other for contact in sim.contacts(0)}
                assert partners == {None}, f"touches {partners} on {name}"
            if name == "planets":
                sim.add_body(1, box((13.0, -9.0, 0.0)))
                run(sim, 0.5)
                assert_close(
                    sim.body_state(1).position, (13.0 - G / 8, -9.0, 0.0), self.fall_error, "fall from the side"
                )

    def test_makes_arenas(self) -> None:
        """Each arena has something to stand on where it begins, and is the same for the same values."""
        self.need("scene.arena")
        for name in ("bowl", "corridor", "gaps", "walls", "maze"):
            digests = set()
            for _ in range(2):
                sim = self.sim(ground=False, arena=Arena(name, seed=1, length=40.0, width=4.0, cells=11))
                sim.add_body(0, box((0.0, 1.0, 0.0), size=(0.3, 0.3, 0.3)))
                run(sim, 2.0)
                assert sim.body_state(0).position[1] > -0.5, f"falls through what is where a {name} begins"
                digests.add(sim.digest())
            assert len(digests) == 1, f"{name}: the same values make two arenas"

    def test_draws_what_a_camera_sees(self) -> None:
        """A picture has the size that was asked for and shows bodies in their colours; to draw changes nothing.

        A machine without a renderer may refuse it as `unsupported`.
        """
        self.need("camera")
        sim = self.sim()
        sim.add_body(0, box((0.0, 0.5, 0.0)))
        sim.step(SUBSTEPS)
        before = sim.digest()
        for strong in (0, 2):
            color = (float(strong == 0), 0.0, float(strong == 2), 1.0)
            try:
                image = sim.draw(CameraSpec.looking_at((0.0, 0.5, 0.0), 0.5, (32, 24)), {0: color})
            except WorldError as error:
                assert error.code == "unsupported", f"refused with {error.code!r}"
                raise unittest.SkipTest(error.message) from error
            assert image.shape == (24, 32, 3) and image.dtype == np.uint8, f"{image.shape} of {image.dtype}"
            seen = image[12, 16].tolist()
            assert seen[strong] > seen[1] and seen[strong] > seen[2 - strong], f"of the colour {color} it shows {seen}"
        assert sim.digest() == before, "to draw changes the world"

    def test_damps_free_bodies(self) -> None:
        """Velocities decay as exp(-c t), each kind with its own c, and an impulse counts in full when it comes."""
        self.need("scene.damping")
        sim = self.sim(gravity=ZERO, ground=False, linear_damping=0.3, angular_damping=0.7)
        sim.add_body(0, box(ZERO, size=(0.4, 1.0, 1.6), mass=2.0, linear_velocity=(3.0, 1.0, 0.0)))
        sim.add_body(1, box((9.0, 0.0, 0.0), size=(0.4, 1.0, 1.6), angular_velocity=(0.0, 0.0, 2.0)))
        sim.add_body(2, box((18.0, 0.0, 0.0), mass=2.0))
        run(sim, 1.0)
        sim.apply(2, ZERO, ZERO, (4.0, 0.0, 0.0), ZERO)
        sim.step(SUBSTEPS)
        kept, spinning = math.exp(-0.3 * (1.0 + TICK)), math.exp(-0.7 * (1.0 + TICK))
        assert_close(sim.states([0])[0, 7:], (3.0 * kept, kept, 0.0, 0.0, 0.0, 0.0), 1e-3, "velocities of the first")
        assert_close(sim.states([1])[0, 7:], (0.0, 0.0, 0.0, 0.0, 0.0, 2.0 * spinning), 1e-3, "of the second")
        assert_close([sim.states([2])[0, 7]], [2.0], 2.0 * 0.3 * TICK, "velocity by an impulse of 4 N s on 2 kg")
        away = (3.0 * (1.0 - kept) / 0.3, (1.0 - kept) / 0.3, 0.0)
        assert_close(sim.body_state(0).position, away, 0.01, "the way of the first")

    def test_damps_a_fall(self) -> None:
        """A body falls towards the speed at which damping carries its weight."""
        self.need("scene.damping")
        sim = self.sim(ground=False, linear_damping=0.5)
        sim.add_body(0, box(ZERO))
        run(sim, 2.0)
        assert_close([sim.states([0])[0, 8]], [-G / 0.5 * (1.0 - math.exp(-1.0))], 0.05, "speed after 2 s")

    def test_damped_bodies_sleep(self) -> None:
        """Damping keeps nothing awake that rests, joined or not."""
        self.need("scene.damping")
        self.need("sleep")
        sim = self.sim(linear_damping=0.2, angular_damping=0.1)
        for number, x in enumerate((-5.0, -0.5, 0.5)):
            sim.add_body(number, box((x, 0.5, 0.0)))
        if self.can("joint.hinge"):
            sim.add_joint(0, JointSpec("hinge", 1, 2, (0.0, 0.5, 0.0), (0.0, 0.0, 1.0)))
        run(sim, 5.0)
        assert [sim.sleeping(body) for body in (0, 1, 2)] == [True] * 3

    def test_feels_accelerations(self) -> None:
        """An accelerometer feels nothing in free fall, gravity's opposite at rest, and what pushes the body."""
        self.need("sensors.inertial")
        sim = self.sim()
        sim.add_body(0, box((0.0, 0.5, 0.0)))
        sim.add_body(1, box((5.0, 50.0, 0.0)))
        sim.add_body(2, box((10.0, 5.0, 0.0), frozen=True))
        sim.add_body(3, box((15.0, 50.0, 0.0), mass=2.0))
        assert not sim.proper_accelerations([0, 1, 2, 3]).any(), "feels something before the first step"
        run(sim, 1.0)
        sim.apply(3, (6.0, 0.0, 0.0), ZERO, ZERO, ZERO)
        sim.step(SUBSTEPS)
        felt = sim.proper_accelerations([0, 1, 2, 3])
        assert_close(felt[0], (0.0, G, 0.0), 0.05 * G, "at rest")
        assert_close(felt[1], ZERO, 1e-6, "in free fall")
        assert_close(felt[2], (0.0, G, 0.0), 1e-6, "frozen")
        assert_close(felt[3], (3.0, 0.0, 0.0), 1e-6, "pushed in free fall")
        felt[:] = 7.0
        assert sim.proper_accelerations([1])[0, 0] != 7.0, "writing to an answer changed the next one"

    def test_measures_ranges(self) -> None:
        """A ray from a body's centre tells the next surface that is not the body's own, and whose it is."""
        self.need("sensors.range")
        sim = self.sim(gravity=ZERO)
        sim.add_body(0, box((0.0, 5.0, 0.0)))
        sim.add_body(1, box((4.0, 5.0, 0.0), size=(2.0, 1.0, 1.0)))
        sim.add_body(2, box((-300.0, 5.0, 250.0 if self.dims == 3 else 0.0)))
        sim.add_body(7, box((0.0, 9.0, 0.0), frozen=True))
        sim.step(SUBSTEPS)
        directions = np.array([(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.6, 0.8, 0.0)])
        before = sim.digest()
        ahead, below, above, behind, aslant = sim.hits(0, directions, 20.0)
        assert ahead is not None and below is not None and above is not None
        distances = [ahead.distance, below.distance, above.distance]
        assert_close(distances, [3.0, 5.0, 3.5], 1e-6, "distances to bodies and to the ground")
        assert [ahead.other, below.other, above.other] == [1, None, 7], "whose the surface is"
        assert behind is None and aslant is None
        (below,) = sim.hits(2, directions[1:2], 20.0)
        assert below is not None, "does not see the ground far from the origin"
        assert_close(below.distance, 5.0, 1e-6, "distance to the ground far from the origin")
        assert sim.hits(0, directions[:1], 2.5) == [None], "sees beyond its limit"
        assert sim.digest() == before, "looking changed the world"

    def test_reports_contacts(self) -> None:
        """A body at rest touches what it rests on, which carries its weight."""
        sim = self.sim()
        sim.add_body(0, box((0.0, 0.5, 0.0), mass=2.0))
        sim.add_body(1, box((20.0, 9.0, 0.0)))
        if self.can("collisions"):
            sim.add_body(2, box((0.0, 1.5, 0.0), mass=3.0))
        run(sim, 0.4)
        assert sim.contacts(1) == [], "a body in the air touches something"
        if not self.can("contacts"):
            return
        weight = G * (5.0 if self.can("collisions") else 2.0)
        below = [contact for contact in sim.contacts(0) if contact.other is None]
        assert below, "a body at rest touches nothing"
        assert_close([sum(c.force for c in below)], [weight], 0.05 * weight, "force on the ground")
        for contact in below:
            assert_close(contact.normal, (0.0, 1.0, 0.0), 1e-3, "normal")
            assert_close([contact.position[1]], [0.0], 2 * self.rest_error, "height of the contact")
        if self.can("collisions"):
            lower = [contact for contact in sim.contacts(2) if contact.other == 0]
            upper = [contact for contact in sim.contacts(0) if contact.other == 2]
            assert lower and upper, "stacked bodies do not touch"
            assert_close([sum(c.force for c in lower)], [3.0 * G], 0.05 * 3.0 * G, "force between bodies")
            assert_close(lower[0].normal, (0.0, 1.0, 0.0), 1e-3, "normal at the upper body")
            assert_close(upper[0].normal, (0.0, -1.0, 0.0), 1e-3, "normal at the lower body")

    def test_keeps_momentum_in_collisions(self) -> None:
        """Two bodies meet off centre: momenta stay, energy does not grow, and neither passes through."""
        self.need("collisions")
        sim = self.space()
        specs = {
            0: box((-2.0, 0.2, 0.0), mass=1.0, linear_velocity=(2.0, 0.0, 0.0)),
            1: box((2.0, 0.0, 0.0), mass=3.0, linear_velocity=(-1.0, 0.0, 0.0)),
        }
        for body, spec in specs.items():
            sim.add_body(body, spec)
        before, energy = momenta(sim, specs), kinetic(sim, specs)
        run(sim, 3.0)
        after = momenta(sim, specs)
        scale = float(np.linalg.norm(before))
        assert_close(after[:3], before[:3], self.momentum_error * scale, "momentum")
        assert_close(after[3:], before[3:], max(self.momentum_error, 0.02) * scale, "angular momentum")
        assert kinetic(sim, specs) <= energy * (1 + self.energy_error), "gained energy in a collision"
        left, right = sim.states([0, 1])[:, 0]
        assert left < right, "the bodies passed through each other"

    def test_lets_groups_pass_through_each_other(self) -> None:
        """Bodies of groups pass through those that the scene names, free or frozen, and meet all others."""
        self.need("collision_groups")
        # Group 1 passes through itself and through group 2, which meets its own.
        for lower, upper, passes in ((1, 1, True), (1, 2, True), (2, 1, True), (2, 2, False), (0, 1, False)):
            for frozen in (False, True):
                sim = self.sim(passes=(0b110, 0b010))
                sim.add_body(0, replace(box((0.0, 0.5, 0.0)), group=lower, frozen=frozen))
                sim.add_body(1, replace(box((0.0, 2.0, 0.0)), group=upper))
                run(sim, 2.0)
                height = 0.5 if passes else 1.5
                what = f"of group {upper} over one of {lower}"
                assert_close(sim.states([1])[:, 1], [height], 0.02, f"height of a body {what}")
                if self.can("contacts"):
                    assert {contact.other for contact in sim.contacts(1)} == {None if passes else 0}, what

    def test_stands_a_stack(self) -> None:
        """Ten cubes on each other stand."""
        self.need("collisions")
        sim = self.sim()
        for i in range(10):
            sim.add_body(i, box((0.0, i + 0.5, 0.0)))
        run(sim, self.stand)
        rows = sim.states(range(10))
        assert_close(rows[:, 1], np.arange(10) + 0.5, 10 * self.rest_error, "heights in the stack")
        assert_close(rows[:, 0], np.zeros(10), 0.05, "lean of the stack")

    def test_parts_a_crowd(self) -> None:
        """Bodies that appear in one point part without exploding."""
        self.need("collisions")
        sim = self.sim()
        for i in range(self.crowd):
            sim.add_body(i, box((0.0, 2.0, 0.0)))
        fastest = 0.0
        for _ in range(round(8.0 / TICK)):
            sim.step(SUBSTEPS)
            fastest = max(fastest, float(np.abs(sim.states(range(self.crowd))[:, 7:10]).max()))
        assert fastest < self.crowd_speed, f"up to {fastest} m/s"
        places = sim.states(range(self.crowd))[:, :3]
        gaps = np.linalg.norm(places[:, None] - places[None], axis=2) + 10.0 * np.eye(self.crowd)
        assert gaps.min() > 0.9, f"two of them are still {gaps.min()} m from each other"
