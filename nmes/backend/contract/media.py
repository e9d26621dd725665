"""What a medium does to bodies: how fast they sink in it, and how deep they float."""

from __future__ import annotations

import math

from nmes.backend import Medium, Vector
from nmes.backend.contract.base import SUBSTEPS, ZERO, Checks, G, about_z, assert_close, box, kinetic, run
from nmes.backend.shapes import ROUND, Shape

_SIZES: dict[Shape, Vector] = {"sphere": (0.5, 0.5, 0.5), "capsule": (0.3, 0.9, 0.3), "cylinder": (0.6, 0.2, 0.6)}


class MediumChecks(Checks):
    """Checks of `medium`."""

    def test_sinks_at_the_terminal_velocity(self) -> None:
        """What is heavier than the medium sinks as fast as its drag balances its weight, thin or thick."""
        self.need("medium")
        shapes: dict[Shape, Vector] = {"box": (0.5, 0.4, 0.6)}
        shapes |= {shape: size for shape, size in _SIZES.items() if self.can(f"shape.{shape}")}
        for level in (None, 1000.0):
            for density, viscosity in ((1000.0, 0.0), (50.0, 200.0)):
                for shape, size in shapes.items():
                    filled, edges = _solid(shape, size)
                    mass = 3.0 * density * filled + 20.0
                    sim = self.sim(ground=False, medium=Medium(density, viscosity, level))
                    sim.add_body(0, box(ZERO, size=size, mass=mass, shape=shape))
                    run(sim, 5.0)
                    quadratic = density * edges[0] * edges[2] / 2.0
                    linear = 3.0 * math.pi * viscosity * sum(edges) / 3.0
                    weight = (mass - density * filled) * G
                    speed = (math.sqrt(linear * linear + 4.0 * quadratic * weight) - linear) / (2.0 * quadratic)
                    what = f"speed of a {shape} in a medium of {density}, {viscosity}, up to {level}"
                    assert_close([-sim.states([0])[0, 8]], [speed], 0.01 * speed, what)

    def test_floats_as_deep_as_it_is_heavy(self) -> None:
        """A box floats with the part of its height beneath the level that its density is; a ball of half, to half."""
        self.need("medium")
        floats: list[tuple[Shape, Vector, float, float]] = [
            ("box", (1.0, 0.4, 1.0), 0.25, 0.1),
            ("box", (1.0, 0.4, 1.0), 0.8, -0.12),
        ]
        floats += [(shape, _SIZES[shape], 0.5, 0.0) for shape in ROUND if self.can(f"shape.{shape}")]
        for shape, size, ratio, height in floats:
            sim = self.sim(ground=False, medium=Medium(1000.0, 300.0, 2.0))
            mass = 1000.0 * ratio * _solid(shape, size)[0]
            sim.add_body(0, box((0.0, 2.3, 0.0), size=size, mass=mass, shape=shape))
            run(sim, 6.0)
            assert_close([sim.body_state(0).position[1]], [2.0 + height], 0.004, f"a {shape} of density {ratio}")

    def test_a_level_rights_what_floats(self) -> None:
        """A plank that was tilted comes to lie flat on the level, and nothing gains energy by that."""
        self.need("medium")
        sim = self.sim(ground=False, medium=Medium(1000.0, 50.0, 0.0))
        spec = box(ZERO, size=(2.0, 0.2, 1.0), mass=200.0, quaternion=about_z(0.5))
        sim.add_body(0, spec)
        highest = 0.0
        for _ in range(60 * 10):
            sim.step(SUBSTEPS)
            highest = max(highest, kinetic(sim, {0: spec}))
        assert_close(sim.body_state(0).quaternion, about_z(0.0), 0.01, "how it lies")
        assert highest < 200.0 * G * 0.5, f"it had {highest} J, more than it was lifted by"

    def test_is_free_above_the_level(self) -> None:
        """What is above the level falls as if there were no medium."""
        self.need("medium")
        sims = [self.sim(ground=False), self.sim(ground=False, medium=Medium(1000.0, 10.0, 0.0))]
        for sim in sims:
            sim.add_body(0, box((0.0, 30.0, 0.0), linear_velocity=(1.0, 0.0, 0.0), angular_velocity=(0.0, 0.0, 2.0)))
            run(sim, 1.0)
        assert_close(sims[1].states([0]), sims[0].states([0]), 1e-9, "state above the level")


def _solid(shape: Shape, size: Vector) -> tuple[float, Vector]:
    """Returns the volume of a shape that lies along y, and the edges of the box of its moments of inertia."""
    across, along = size[0], size[1]
    if shape == "box":
        return size[0] * size[1] * size[2], size
    if shape == "sphere":
        edge = across * math.sqrt(0.6)
        return math.pi / 6.0 * across**3, (edge, edge, edge)
    wide = across * math.sqrt(0.75)  # 12 <x^2> of a disc is 3 r^2
    if shape == "cylinder":
        return math.pi / 4.0 * across**2 * along, (wide, along, wide)
    count, radius = 20_000, across / 2.0
    heights = [(i + 0.5) / count * along - along / 2.0 for i in range(count)]
    squares = [radius**2 - max(0.0, abs(height) - (along / 2.0 - radius)) ** 2 for height in heights]
    whole = math.fsum(squares)
    wide = math.sqrt(3.0 * math.fsum(square * square for square in squares) / whole)
    length = math.sqrt(12.0 * math.fsum(s * h * h for s, h in zip(squares, heights, strict=True)) / whole)
    return math.pi * whole * along / count, (wide, length, wide)
