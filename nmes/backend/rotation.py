"""Rotations: the protocol's Euler angles, quaternions `(x, y, z, w)`, and vectors to turn, in plain floats.

Plain Python on purpose: one rotation costs a microsecond, an array operation several; only `euler_angles` takes many at
once, with the same bits. Euler angles are radians `(x, y, z)` applied in the order Y, X, Z, Godot's convention: the
matrix is `Ry @ Rx @ Rz`. Quaternions that come out have unit length.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import reduce
from math import asin, atan2, cos, dist, sin, sqrt
from operator import add

import numpy as np
import numpy.typing as npt

__all__ = [
    "angle_between",
    "conjugate",
    "cross",
    "dot",
    "euler_angles",
    "euler_from_quaternion",
    "minus",
    "multiply",
    "normalize",
    "plus",
    "quaternion_from_euler",
    "rotate",
    "total",
]

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Array = npt.NDArray[np.float64]

# Beyond this sine of the X angle, Y and Z turn about the same line and only their sum is defined; Z is then 0.
_GIMBAL = 1.0 - 1e-12


def total(values: Iterable[float]) -> float:
    """Adds numbers up from the first to the last: `sum` does so in Python 3.11, and has other bits from 3.12 on."""
    return reduce(add, values, 0.0)


def normalize(q: Quaternion) -> Quaternion:
    """Scales to unit length; a zero quaternion raises ZeroDivisionError."""
    x, y, z, w = q
    n = sqrt(x * x + y * y + z * z + w * w)
    return (x / n, y / n, z / n, w / n)


def conjugate(q: Quaternion) -> Quaternion:
    """Returns the opposite rotation of a unit quaternion."""
    return (-q[0], -q[1], -q[2], q[3])


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Returns the rotation `b` followed by `a`."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def plus(a: Vector, b: Vector) -> Vector:
    """Returns the sum of two vectors."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def minus(a: Vector, b: Vector) -> Vector:
    """Returns the difference of two vectors."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def dot(a: Vector, b: Vector) -> float:
    """Returns the dot product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    """Returns the cross product of two vectors."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def angle_between(a: Sequence[float], b: Sequence[float]) -> float:
    """Returns the angle between two rotations, rad, 0 to pi."""
    # By the chord, which is exact for small angles; q and -q are the same rotation.
    return 4.0 * asin(min(1.0, min(dist(a, b), dist(a, [-x for x in b])) / 2.0))


def rotate(q: Quaternion, v: Vector) -> Vector:
    """Turns a vector by a unit quaternion."""
    x, y, z, w = q
    tx, ty, tz = 2.0 * (y * v[2] - z * v[1]), 2.0 * (z * v[0] - x * v[2]), 2.0 * (x * v[1] - y * v[0])
    return (
        v[0] + w * tx + y * tz - z * ty,
        v[1] + w * ty + z * tx - x * tz,
        v[2] + w * tz + x * ty - y * tx,
    )


def quaternion_from_euler(x: float, y: float, z: float) -> Quaternion:
    """Converts Euler angles (order Y, X, Z) to a quaternion."""
    cx, sx, cy, sy, cz, sz = cos(x / 2), sin(x / 2), cos(y / 2), sin(y / 2), cos(z / 2), sin(z / 2)
    return (
        cy * sx * cz + sy * cx * sz,
        sy * cx * cz - cy * sx * sz,
        cy * cx * sz - sy * sx * cz,
        cy * cx * cz + sy * sx * sz,
    )


def euler_from_quaternion(q: Quaternion) -> Vector:
    """Converts a unit quaternion to Euler angles: x in [-pi/2, pi/2], y and z in [-pi, pi]."""
    x, y, z, w = q
    sine = 2.0 * (w * x - y * z)
    if sine > _GIMBAL or sine < -_GIMBAL:
        return (asin(max(-1.0, min(1.0, sine))), atan2(2.0 * (w * y - x * z), 1.0 - 2.0 * (y * y + z * z)), 0.0)
    return (
        asin(sine),
        atan2(2.0 * (x * z + w * y), 1.0 - 2.0 * (x * x + y * y)),
        atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z)),
    )


def euler_angles(quaternions: Array) -> Array:
    """Converts unit quaternions (n, 4) to Euler angles (n, 3), as `euler_from_quaternion` does."""
    x, y, z, w = quaternions.T
    sine = 2.0 * (w * x - y * z)
    locked = (sine > _GIMBAL) | (sine < -_GIMBAL)
    about_y = np.where(locked, 2.0 * (w * y - x * z), 2.0 * (x * z + w * y))
    across_y = 1.0 - 2.0 * np.where(locked, y * y + z * z, x * x + y * y)
    about_z = np.where(locked, 0.0, 2.0 * (x * y + w * z))
    across_z = np.where(locked, 1.0, 1.0 - 2.0 * (x * x + z * z))
    # The library's functions of one number: numpy's own may differ from them in the last bit.
    return np.array(
        [
            list(map(asin, np.clip(sine, -1.0, 1.0).tolist())),
            list(map(atan2, about_y.tolist(), across_y.tolist())),
            list(map(atan2, about_z.tolist(), across_z.tolist())),
        ]
    ).T
