"""The limits of a creature's body, and of what it does: what a task or a world allows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from nmes.genome.body import Body
from nmes.genome.development import lightest, scales

__all__ = ["Limits"]

_GRAVITY = 9.81  # m/s^2, by which efforts are judged, wherever a body is


@dataclass(frozen=True, slots=True)
class Limits:
    """The limits of a creature's body and of what it does; None is no limit.

    Attributes:
        cubes: How many cubes.
        mass: Of all of them, kg.
        size: Longest edge of the box around the body at rest, m; later no cube's centre may be farther from the body's
            than the corners of such a box are from each other.
        density: Of each cube, kg/m^3.
        neighbours: Mass of a cube, of that of another to which a joint joins it.
        effort: Of each motor: of a slide's, of the body's weight at 9.81 m/s^2; of a hinge's, of weight times size.
        restitution: Of each cube.
        friction: Least and most of each cube that sets its own; others have that of the ground.
        energy: Work of its motors, J.
        speed: Of the centre of each cube, m/s.
        spin: Of each cube, rad/s.
    """

    cubes: int | None = None
    mass: float | None = None
    size: float | None = None
    density: float | None = None
    neighbours: float | None = None
    effort: float | None = None
    restitution: float | None = None
    friction: tuple[float, float] | None = None
    energy: float | None = None
    speed: float | None = None
    spin: float | None = None

    def check(self, body: Body) -> list[str]:
        """Returns the reasons why a body is not within the limits, in words; none if it is."""
        reasons = []
        for limit, value, words in (
            (self.cubes, len(body.cubes), "{} cubes, at most {} are allowed"),
            (self.mass, body.mass, "{:g} kg, at most {:g} are allowed"),
            (self.size, body.size, "{:g} m from end to end, at most {:g} are allowed"),
        ):
            if limit is not None and value > limit * (1.0 + 1e-9):
                reasons.append(f"the body has {words.format(value, limit)}")
        reasons += self._unbuildable(body)
        reasons += self._slippery(body)
        return reasons

    def _unbuildable(self, body: Body) -> Iterator[str]:
        """Yields the reasons why nothing of this kind could be built: the worst of its cubes, pairs and motors.

        Of one that develops, pairs are judged in the sizes to which its rules may bring them, and a motor by the
        lightest body that they can leave it.
        """
        small, large = scales(body)
        may = " as the body may develop" if body.development else ""
        least = {cube.id: cube.mass * small.get(cube.id, 1.0) ** 3 for cube in body.cubes}
        most = {cube.id: cube.mass * large.get(cube.id, 1.0) ** 3 for cube in body.cubes}
        densities = [(cube.mass / cube.volume, cube.id) for cube in body.cubes]
        bounces = [(cube.restitution or 0.0, cube.id) for cube in body.cubes]
        ends = [(joint.cube1, joint.cube2, joint.id) for joint in body.joints]
        pairs = [(most[one] / least[two], joint) for one, two, joint in ends]
        pairs += [(most[two] / least[one], joint) for one, two, joint in ends]
        efforts = [
            (
                joint.motor.max_effort / (_GRAVITY * light.mass * (1.0 if joint.kind == "slide" else light.size)),
                joint.id,
            )
            for joint, light in lightest(body)
            if joint.motor is not None
        ]
        for limit, values, words in (
            (self.density, densities, "cube {!r} has {:g} kg/m^3, at most {:g} are allowed"),
            (self.neighbours, pairs, f"joint {{!r}} joins masses of 1 to {{:g}}{may}, at most 1 to {{:g}} are allowed"),
            (self.restitution, bounces, "cube {!r} has a restitution of {:g}, at most {:g} is allowed"),
            (
                self.effort,
                efforts,
                f"the motor of joint {{!r}} has an effort of {{:g}}{may}, at most {{:g}} is allowed",
            ),
        ):
            value, name = max(values, default=(0.0, ""), key=lambda each: each[0])
            if limit is not None and value > limit * (1.0 + 1e-9):
                yield words.format(name, value, limit)

    def _slippery(self, body: Body) -> Iterator[str]:
        """Yields why the surfaces of a body are none: the cube whose own friction is farthest below or above."""
        if self.friction is None:
            return
        low, high = self.friction
        own = [(cube.friction, cube.id) for cube in body.cubes if cube.friction is not None]
        value, name = max(own, default=(low, ""), key=lambda each: max(low - each[0], each[0] - high))
        if not low <= value <= high:
            yield f"cube {name!r} has a friction of {value:g}, from {low:g} to {high:g} is allowed"
