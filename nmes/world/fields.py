"""Geometry in the fields of commands: what positions, angular vectors, rotations and axes mean to an engine.

Hides Euler angles, quaternions that are not of unit length, and the missing axis of a planar world.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot, inf

from nmes.backend import Quaternion, Vector
from nmes.backend.rotation import euler_from_quaternion, normalize, quaternion_from_euler
from nmes.errors import WorldError

__all__ = ["FieldReader", "unit_vector", "vector"]


class FieldReader:
    """Reads the geometric fields of commands for one world.

    Args:
        planar: Whether the engine knows only the XY plane: z of positions, and x and y of angular vectors, become 0.
    """

    def __init__(self, planar: bool) -> None:
        self._planar = planar

    def position(self, value: Sequence[float]) -> Vector:
        """Reads a linear vector: a position, force, impulse or velocity."""
        x, y, z = value
        return (float(x), float(y), 0.0 if self._planar else float(z))

    def turn(self, value: Sequence[float]) -> Vector:
        """Reads an angular vector: a torque, angular velocity, angular impulse or Euler angles."""
        x, y, z = value
        return (0.0, 0.0, float(z)) if self._planar else (float(x), float(y), float(z))

    def rotation(self, value: Sequence[float]) -> Quaternion:
        """Reads three Euler angles (rad) or a quaternion (x, y, z, w) of any length as a unit quaternion.

        Raises:
            WorldError: `invalid`: the quaternion is zero.
        """
        if len(value) == 3:
            return quaternion_from_euler(*self.turn(value))
        try:
            quaternion = normalize((float(value[0]), float(value[1]), float(value[2]), float(value[3])))
        except (ZeroDivisionError, OverflowError):
            raise WorldError("invalid", "rotation: a quaternion must not be zero", "rotation") from None
        if self._planar:
            return quaternion_from_euler(*self.turn(euler_from_quaternion(quaternion)))
        return quaternion

    def axis(self, kind: str, value: Sequence[float]) -> Vector:
        """Reads the axis of a joint of some type as a unit vector.

        In a planar world a hinge turns about z, and the axes of others are in the plane where they have a part in it. A
        slide needs that; along z a conetwist twists, and the rest do nothing with it.

        Raises:
            WorldError: `invalid`: it has no direction.
        """
        unit = unit_vector(self.turn(value) if kind == "hinge" else self.position(value))
        if unit is None and kind not in ("hinge", "slide"):
            unit = unit_vector(vector(value))
        if unit is None:
            raise WorldError("invalid", "axis: must have a direction, and in a planar world one in it", "axis")
        return unit


def vector(value: Sequence[float]) -> Vector:
    """Returns three numbers as a tuple of floats."""
    x, y, z = value
    return (float(x), float(y), float(z))


def unit_vector(value: Vector) -> Vector | None:
    """Returns the vector of length 1 in the same direction; None where the length is next to 0, or infinite."""
    length = hypot(*value)
    return (value[0] / length, value[1] / length, value[2] / length) if 1e-9 < length < inf else None
