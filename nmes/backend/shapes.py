"""The shapes that bodies and scenery may have, each in the box that it just fills.

A `sphere` has three equal edges. A `capsule` and a `cylinder` have two equal edges, across them, and lie along the
third one; where all three of a cylinder are equal it lies along y. Lengths are in m, axes are the shape's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import pi, sqrt
from typing import Final, Literal, TypeAlias

__all__ = ["ROUND", "SHAPES", "Shape", "axis", "fitted", "lying", "misfit", "moments", "reach", "volume"]

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  # x, y, z, w
Shape: TypeAlias = Literal["box", "sphere", "capsule", "cylinder"]

SHAPES: Final[tuple[Shape, ...]] = ("box", "sphere", "capsule", "cylinder")
ROUND: Final = SHAPES[1:]
"""The shapes that an engine need not have: its capabilities say which it has, as `shape.sphere`."""

_QUARTER = sqrt(0.5)
# How z is turned to x, to y and to itself.
_LYING: Final[tuple[Quaternion, Quaternion, Quaternion]] = (
    (0.0, _QUARTER, 0.0, _QUARTER),
    (-_QUARTER, 0.0, 0.0, _QUARTER),
    (0.0, 0.0, 0.0, 1.0),
)
_LONGER = 1.01  # than it is wide: the least that a capsule which is made to fit is


def misfit(shape: str, size: Sequence[float]) -> str | None:
    """Returns in words what is wrong with the edges of a shape; None where nothing is."""
    x, y, z = size
    if shape == "sphere" and not x == y == z:
        return f"a sphere has three equal edges, not {x:g}, {y:g} and {z:g}"
    if shape in ("capsule", "cylinder"):
        along = axis(size)
        across = size[along - 1]
        if across != size[along - 2]:
            return f"a {shape} has two equal edges, across it; {x:g}, {y:g} and {z:g} all differ"
        if shape == "capsule" and not size[along] > across:
            return f"a capsule is longer than it is wide, and {size[along]:g} is not more than {across:g}"
    return None


def axis(size: Sequence[float]) -> int:
    """Returns the own axis (0, 1, 2) along which a capsule or a cylinder of this size lies."""
    x, y, z = size
    return 1 if x == z else 0 if y == z else 2


def lying(size: Sequence[float]) -> Quaternion:
    """Returns the rotation that takes what lies along z to the axis along which a shape of this size lies."""
    return _LYING[axis(size)]


def volume(shape: Shape, size: Vector) -> float:
    """Returns the volume, m^3."""
    if shape == "box":
        return size[0] * size[1] * size[2]
    across, along = size[axis(size) - 1], size[axis(size)]
    if shape == "sphere":
        return pi / 6.0 * across * across * across
    if shape == "cylinder":
        return pi / 4.0 * across * across * along
    return pi / 4.0 * across * across * (along - across) + pi / 6.0 * across * across * across


def moments(shape: Shape, size: Vector) -> Vector:
    """Returns the moments of inertia about the own axes of a solid of 1 kg, even throughout, m^2."""
    if shape == "box":
        x, y, z = (edge * edge for edge in size)
        return ((y + z) / 12.0, (x + z) / 12.0, (x + y) / 12.0)
    lies = axis(size)
    radius, along = size[lies - 1] / 2.0, size[lies]
    square = radius * radius
    if shape == "sphere":
        return (0.4 * square,) * 3
    if shape == "cylinder":
        about, aside = square / 2.0, (3.0 * square + along * along) / 12.0
    else:  # a cylinder, and half a ball at each end of it
        length = along - 2.0 * radius
        ends = 4.0 * radius / (4.0 * radius + 3.0 * length)  # the part of the mass that is in them
        about = ends * 0.4 * square + (1.0 - ends) * square / 2.0
        aside = ends * (0.4 * square + length * length / 4.0 + 3.0 * length * radius / 8.0)
        aside += (1.0 - ends) * (3.0 * square + length * length) / 12.0
    return (about if lies == 0 else aside, about if lies == 1 else aside, about if lies == 2 else aside)


def reach(shape: Shape, size: Vector, direction: Vector) -> float:
    """Returns how far a shape reaches from its middle in a direction along its own axes, times that one's length."""
    x, y, z = direction
    if shape == "box":
        a, b, c = size
        return (abs(x) * a + abs(y) * b + abs(z) * c) / 2.0
    lies = axis(size)
    radius, square, part = size[lies - 1] / 2.0, x * x + y * y + z * z, abs(direction[lies])
    if shape == "cylinder":
        return part * size[lies] / 2.0 + radius * sqrt(max(0.0, square - part * part))
    return part * (size[lies] / 2.0 - radius) + radius * sqrt(square)


def fitted(shape: Shape, size: Vector) -> Vector:
    """Returns the size that a shape may have which is nearest to one that it may not have, of about its volume."""
    if misfit(shape, size) is None:
        return size
    low, middle, high = sorted(range(3), key=lambda i: size[i])
    if shape == "sphere":  # by roots that every machine computes alike
        return (sqrt(sqrt(size[low] * size[high]) * size[middle]),) * 3
    # A cylinder may be flat: it lies along the edge that differs most from the other two.
    flat = shape == "cylinder" and size[middle] * size[middle] > size[low] * size[high]
    lies = low if flat else high
    across = sqrt(size[middle] * size[high if flat else low])
    along = max(size[lies], _LONGER * across) if shape == "capsule" else size[lies]
    return (along if lies == 0 else across, along if lies == 1 else across, along if lies == 2 else across)
