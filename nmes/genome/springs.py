"""Springs and dampers in joints: how fast they may move a body, and whether an engine can follow that in its steps.

Hides the bounds of that. Engines integrate springs explicitly: beyond two radians a step a spring takes more energy out
of a swing than there is in it, and the swing grows out of nothing; below, what energy there seems to be only wavers,
the less the farther below. Dampers an engine may integrate explicitly, too: by Runge and Kutta's method of fourth order
one that by its rate would take 2.785 times a velocity in a step, or more, makes it grow, and below it shrinks.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import sqrt
from typing import Final

from nmes.backend import Vector
from nmes.backend.rotation import conjugate, cross, dot, minus, rotate, total
from nmes.backend.shapes import moments
from nmes.genome.body import Body, BodyCube, BodyJoint
from nmes.genome.development import resized, scales

__all__ = ["MOST", "slowing", "swing", "too_stiff"]

MOST: Final = 1.0
"""How many radians a spring may let a body swing in an engine step."""
_SLOWED: Final = 2.5  # how many times a velocity a damper may take, by its rate at the beginning of an engine step
_AXES: Final[dict[str, Vector]] = {"hinge": (0.0, 0.0, 1.0), "slide": (1.0, 0.0, 0.0)}  # where the document has none


def too_stiff(body: Body, step: float, *, dampers: bool = False) -> list[str]:
    """Returns the reasons why an engine cannot integrate the springs and dampers of a body, in words; none if it can.

    Args:
        body: The whole one; of one that develops, each part counts as small as its rules may make it.
        step: The engine's, s.
        dampers: Whether it integrates dampers explicitly, too, by Runge and Kutta's method of fourth order.
    """
    small = resized(body, scales(body)[0])
    may = " as the body may develop" if body.development else ""
    kinds = [("spring", "swing at", "rad/s", MOST, swing(small))]
    kinds += [("damper", "slow down by", "times a second", _SLOWED, slowing(small))] if dampers else []
    return [
        f"the {what} of joint {joint!r} may {does} {rate:.4g} {unit}{may}, at most {most / step:.4g} are allowed: the "
        f"engine's steps are of {step:.3g} s"
        for what, does, unit, most, (rate, joint) in kinds
        if rate * step > most * (1.0 + 1e-9)
    ]


def swing(body: Body) -> tuple[float, str]:
    """Returns a bound of the frequency at which springs let a body swing, rad/s, and the joint that does most of it.

    It holds in every pose and whatever else joins the cubes. For a velocity of all cubes, each free of the others, let
    T be twice its kinetic energy and K the sum over the springs of stiffness times the joint's velocity squared. The
    square of the highest frequency is the most that K / T can be; joints let the cubes have only some of these
    velocities, of which K / T can only be less. The velocity of a joint is the difference of what it is at either
    cube, so its square is at most twice the sum of theirs; and by Cauchy and Schwarz the square at a cube is at most
    that cube's part of T times its `_mobility` along the joint. So K / T is at most the greatest, of all cubes, of
    twice the sum over the springs at it of stiffness times mobility.
    """
    most, joint = _most(body, {joint.id: joint.stiffness for joint in body.joints})
    return sqrt(most), joint


def slowing(body: Body) -> tuple[float, str]:
    """Returns a bound of how fast dampers slow a body down, 1/s, and the joint that does most of it.

    It is that of `swing` with dampers for springs, where K / T is a rate itself.
    """
    return _most(body, {joint.id: joint.damping for joint in body.joints})


def _most(body: Body, strengths: Mapping[str, float]) -> tuple[float, str]:
    """Returns the bound of K / T for joints of such strengths, and the joint that does most of it."""
    cubes = {cube.id: cube for cube in body.cubes}
    pulls: dict[str, list[tuple[float, str]]] = {}
    for joint in body.joints:
        if strengths[joint.id]:
            for name in (joint.cube1, joint.cube2):
                pull = 2.0 * strengths[joint.id] * _mobility(cubes[name], joint)
                pulls.setdefault(name, []).append((pull, joint.id))
    worst = max(pulls.values(), default=[(0.0, "")], key=lambda each: total(pull for pull, _ in each))
    return total(pull for pull, _ in worst), max(worst)[1]


def _mobility(cube: BodyCube, joint: BodyJoint) -> float:
    """Returns how much a joint's generalized force of 1 accelerates a free cube along it, 1/kg or 1/(kg m^2).

    A hinge turns the cube about its axis, which lies in the cube as it does at rest in every pose. A slide pushes it
    along its axis, and turns it, as it is some way beside that; the cube keeps that distance wherever it slides to.
    """
    axis = _AXES[joint.kind] if joint.axis is None else joint.axis
    length = sqrt(dot(axis, axis))
    axis = axis[0] / length, axis[1] / length, axis[2] / length
    slides = joint.kind == "slide"
    turn = cross(minus(joint.anchor, cube.position), axis) if slides else axis
    own = rotate(conjugate(cube.quaternion), turn)
    turned = total(x * x / moment for x, moment in zip(own, moments(cube.shape, cube.size), strict=True)) / cube.mass
    return turned + 1.0 / cube.mass if slides else turned
