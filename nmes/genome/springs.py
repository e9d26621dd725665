"""Springs in joints: how fast they may let a body swing, and whether an engine can follow that in its steps.

Hides the bound of that frequency. Engines integrate springs explicitly: beyond two radians a step a spring takes more
energy out of a swing than there is in it, and the swing grows out of nothing; below, what energy there seems to be only
wavers, the less the farther below.
"""

from __future__ import annotations

from math import sqrt
from typing import Final

from nmes.backend import Vector
from nmes.backend.rotation import conjugate, cross, dot, minus, rotate, total
from nmes.backend.shapes import moments
from nmes.genome.body import Body, BodyCube, BodyJoint
from nmes.genome.development import resized, scales

__all__ = ["MOST", "swing", "too_stiff"]

MOST: Final = 1.0
"""How many radians a spring may let a body swing in an engine step."""
_AXES: Final[dict[str, Vector]] = {"hinge": (0.0, 0.0, 1.0), "slide": (1.0, 0.0, 0.0)}  # where the document has none


def too_stiff(body: Body, step: float) -> list[str]:
    """Returns the reasons why an engine cannot integrate the springs of a body, in words; none if it can.

    Args:
        body: The whole one; of one that develops, each part counts as small as its rules may make it.
        step: The engine's, s.
    """
    small = resized(body, scales(body)[0])
    most = MOST / step
    swings, joint = swing(small)
    if swings <= most * (1.0 + 1e-9):
        return []
    may = " as the body may develop" if body.development else ""
    return [
        f"the spring of joint {joint!r} may swing at {swings:.4g} rad/s{may}, at most {most:.4g} are allowed: the "
        f"engine's steps are of {step:.3g} s"
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
    cubes = {cube.id: cube for cube in body.cubes}
    pulls: dict[str, list[tuple[float, str]]] = {}
    for joint in body.joints:
        if joint.stiffness:
            for name in (joint.cube1, joint.cube2):
                pull = 2.0 * joint.stiffness * _mobility(cubes[name], joint)
                pulls.setdefault(name, []).append((pull, joint.id))
    worst = max(pulls.values(), default=[(0.0, "")], key=lambda each: total(pull for pull, _ in each))
    return sqrt(total(pull for pull, _ in worst)), max(worst)[1]


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
