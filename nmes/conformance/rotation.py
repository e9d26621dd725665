"""Rotations, as the protocol reads and writes them: for cases that compare one with another."""

from __future__ import annotations

import math

from nmes.conformance.trial import Trial

__all__ = ["euler", "same_turn"]


def euler(x: float, y: float, z: float) -> list[float]:
    """Returns the quaternion of Euler angles applied in the order Y, X, Z, as intrinsic turns."""

    def times(a: list[float], b: list[float]) -> list[float]:
        ax, ay, az, aw = a
        bx, by, bz, bw = b
        return [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ]

    about_x = [math.sin(x / 2), 0.0, 0.0, math.cos(x / 2)]
    about_y = [0.0, math.sin(y / 2), 0.0, math.cos(y / 2)]
    about_z = [0.0, 0.0, math.sin(z / 2), math.cos(z / 2)]
    return times(times(about_y, about_x), about_z)


def same_turn(t: Trial, got: list[float], expected: list[float]) -> None:
    """Makes sure that two quaternions mean the same rotation."""
    sign = 1.0 if sum(a * b for a, b in zip(got, expected, strict=True)) >= 0 else -1.0
    t.close(got, [sign * value for value in expected], 1e-5, "quaternion")
