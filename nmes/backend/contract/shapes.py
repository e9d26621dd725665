"""What round bodies weigh against each other: inertia, rest, rolling, and what they roll over."""

from __future__ import annotations

import math
import unittest
from collections.abc import Iterator

import numpy as np

from nmes.backend import StaticBox, Vector
from nmes.backend.contract.base import SUBSTEPS, TICK, UPRIGHT, ZERO, Checks, G, about_z, assert_close, box, run
from nmes.backend.shapes import ROUND, Shape

_SIZES: dict[Shape, tuple[Vector, ...]] = {
    "sphere": ((0.8, 0.8, 0.8),),
    "capsule": ((0.5, 1.2, 0.5), (1.2, 0.5, 0.5), (0.5, 0.5, 1.2)),
    "cylinder": ((0.5, 1.2, 0.5), (1.2, 0.5, 0.5), (0.5, 0.5, 1.2), (0.8, 0.3, 0.8)),
}
_DISCS = 20_000


class ShapeChecks(Checks):
    """Checks of bodies that are no boxes."""

    def shapes(self) -> Iterator[tuple[Shape, Vector]]:
        """Yields the round shapes that the backend promises, each in some sizes; skips where there are none."""
        able = [shape for shape in ROUND if self.can(f"shape.{shape}")]
        if not able:
            raise unittest.SkipTest("no shape.*")
        for shape in able:
            for size in _SIZES[shape]:
                yield shape, size

    def test_turns_shapes_by_their_inertia(self) -> None:
        """A solid of each shape resists turning about its own axes as one made of thin discs does."""
        for shape, size in self.shapes():
            for axis in range(3) if self.dims == 3 else (2,):
                sim = self.space()
                sim.add_body(0, box(ZERO, mass=3.0, size=size, shape=shape))
                torque = [0.0, 0.0, 0.0]
                torque[axis] = 1.0
                sim.apply(0, ZERO, ZERO, ZERO, (torque[0], torque[1], torque[2]))
                sim.step(SUBSTEPS)
                expected = 1.0 / (3.0 * _moments(shape, size)[axis])
                what = f"angular velocity about {'xyz'[axis]} of a {shape} of {size}"
                assert_close([sim.states([0])[0, 10 + axis]], [expected], 1e-4 * expected, what)

    def test_moves_shapes_by_their_mass(self) -> None:
        """A push gives a body of each shape the velocity that its mass says."""
        for shape, size in self.shapes():
            sim = self.space()
            sim.add_body(0, box(ZERO, mass=3.0, size=size, shape=shape))
            sim.apply(0, ZERO, ZERO, (6.0, 0.0, 0.0), ZERO)
            sim.step(SUBSTEPS)
            assert_close([sim.states([0])[0, 7]], [2.0], 1e-9, f"velocity of a {shape} of {size}")

    def test_rests_on_the_lowest_point_of_a_shape(self) -> None:
        """A dropped body of each shape comes to rest on its surface, not on that of the box around it."""
        for shape, size in self.shapes():
            sim = self.sim()
            sim.add_body(0, box((0.0, size[1] / 2.0 + 0.1, 0.0), size=size, shape=shape))
            run(sim, 1.0)
            assert_close([sim.body_state(0).position[1]], [size[1] / 2.0], self.rest_error, f"a {shape} of {size}")
        if self.can("shape.sphere"):
            sim = self.sim()
            sim.add_body(0, box((0.0, 0.6, 0.0), shape="sphere", quaternion=about_z(0.8)))
            run(sim, 1.0)
            assert_close([sim.body_state(0).position[1]], [0.5], self.rest_error, "a sphere that was turned")

    def test_rolls_down_a_slope(self) -> None:
        """A solid sphere rolls at 5/7 of what slides freely, a solid cylinder at 2/3, a box at none."""
        self.need("collisions")
        self.need("friction")
        for shape, part, size in (
            ("sphere", 5.0 / 7.0, (1.0, 1.0, 1.0)),
            ("cylinder", 2.0 / 3.0, (1.0, 1.0, 0.6)),
            ("box", 0.0, (1.0, 1.0, 1.0)),
        ):
            if shape == "box" or self.can(f"shape.{shape}"):
                angle = math.radians(15.0)
                sim = self.sim(gravity=(G * math.sin(angle), -G * math.cos(angle), 0.0))
                sim.add_body(0, box((0.0, 0.5, 0.0), size=size, shape=shape, friction=1.0))
                run(sim, 0.25)
                before = sim.states([0])[0]
                run(sim, 1.0)
                row = sim.states([0])[0]
                expected = part * G * math.sin(angle)
                assert_close([row[7] - before[7]], [expected], 0.02 * G, f"speed that a {shape} gains in 1 s")
                if part:
                    assert_close([-row[12] * 0.5], [row[7]], 0.02 * row[7], f"speed of the rim of a {shape}")

    def test_stands_on_round_scenery(self) -> None:
        """A box lies on a lying cylinder and on a lying capsule, and one on the top of a ball, where its surface is."""
        self.need("scene.obstacles")
        for shape, size in self.shapes():
            if shape == "sphere" or size[0] > size[1]:
                sim = self.sim(ground=False, boxes=(StaticBox(size, (1.0, 2.0, 0.0), UPRIGHT, shape),))
                height = 2.0 + size[1] / 2.0 + 0.25
                sim.add_body(0, box((1.0, height + 0.02, 0.0), size=(0.5, 0.5, 0.5)))
                run(sim, 0.5)
                assert_close(sim.body_state(0).position[:2], (1.0, height), 2 * self.rest_error, f"on a {shape} {size}")

    def test_passes_the_corner_that_a_shape_lacks(self) -> None:
        """What falls past a ball, within the box around it, is not stopped."""
        self.need("scene.obstacles")
        self.need("shape.sphere")
        sim = self.sim(ground=False, boxes=(StaticBox((2.0, 2.0, 2.0), ZERO, UPRIGHT, "sphere"),))
        sim.add_body(0, box((0.95, 0.95, 0.0), size=(0.1, 0.1, 0.1), linear_velocity=(0.0, -4.0, 0.0)))
        sim.step(SUBSTEPS)
        assert_close([sim.states([0])[0, 8]], [-4.0 - G * TICK], 1e-6, "velocity beside a ball")


def _moments(shape: Shape, size: Vector) -> Vector:
    """Returns the moments of inertia about the own axes of a solid of 1 kg that is cut into thin discs."""
    odd = [i for i in range(3) if size[i - 1] == size[i - 2]]
    lies = 1 if len(odd) == 3 else odd[0]
    radius, half = size[lies - 1] / 2.0, size[lies] / 2.0
    at = (np.arange(_DISCS) + 0.5) / _DISCS * 2.0 * half - half
    squares = np.full(_DISCS, radius * radius)
    if shape != "cylinder":
        beyond = np.maximum(np.abs(at) - (half - radius), 0.0)
        squares -= beyond * beyond
    part = squares / squares.sum()
    about = float((part * squares / 2.0).sum())
    aside = float((part * (squares / 4.0 + at * at)).sum())
    return (about if lies == 0 else aside, about if lies == 1 else aside, about if lies == 2 else aside)
