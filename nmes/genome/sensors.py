"""The sensors that a creature may have, by type: how many numbers each reads, and of what.

A new sensor of a cube is one more function of the cube's state, listed in `CUBE_READINGS`; `schemas/genome.json` says
which types a document may name. CONTRIBUTING.md shows it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from nmes.backend import BodyState

__all__ = ["OF_CUBE", "OF_FOOD", "OF_JOINT", "OF_OTHERS", "READING_OF", "TURNING", "VECTORS", "CubeReading", "Read"]

Read = Callable[[BodyState], tuple[float, ...]]

TURNING = 0.1
"""Sensors read turning in 10 rad/s."""


@dataclass(frozen=True, eq=False)
class CubeReading:
    """Sensors of a cube that one function reads of its state.

    Attributes:
        types: Their types in the order in which `read` returns them, each with its axes: "xyz" of a vector, "" of a
            number.
        read: Returns their numbers.
    """

    types: dict[str, str]
    read: Read

    def first(self, sensor_type: str) -> int:
        """Returns where the first number of a type is among those that `read` returns."""
        names = list(self.types)
        return sum(len(self.types[name]) or 1 for name in names[: names.index(sensor_type)])

    @property
    def count(self) -> int:
        """The number of numbers that `read` returns."""
        return sum(len(axes) or 1 for axes in self.types.values())


def _motion(state: BodyState) -> tuple[float, ...]:
    """Returns a cube's height, and in its own axes the way up, its velocity and its spin (in 10 rad/s)."""
    x, y, z, w = state.quaternion
    vx, vy, vz = state.linear_velocity
    wx, wy, wz = state.angular_velocity
    # The rows of the matrix that turns into the cube's own axes. Of three vectors that is less than turning each.
    ax, ay, az = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)
    bx, by, bz = 2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)
    cx, cy, cz = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)
    return (
        state.position[1],
        ay,
        by,
        cy,
        ax * vx + ay * vy + az * vz,
        bx * vx + by * vy + bz * vz,
        cx * vx + cy * vy + cz * vz,
        TURNING * (ax * wx + ay * wy + az * wz),
        TURNING * (bx * wx + by * wy + bz * wz),
        TURNING * (cx * wx + cy * wy + cz * wz),
    )


CUBE_READINGS = (CubeReading({"height": "", "up": "xyz", "velocity": "xyz", "spin": "xyz"}, _motion),)

READING_OF = {name: reading for reading in CUBE_READINGS for name in reading.types}
"""The reading of each type that follows from a cube's state alone."""

_STATE_AXES = {name: reading.types[name] for name, reading in READING_OF.items()}
_TARGET_AXES = {"target_direction": "xyz", "target_distance": "", "target_velocity": "xyz"}
_OTHER_AXES = {"other_direction": "xyz", "other_distance": "", "other_velocity": "xyz"}
_FOOD_AXES = {"food_direction": "xyz", "food_distance": ""}
_AXES = {**_STATE_AXES, "touch": "", **_TARGET_AXES, **_OTHER_AXES, "hear": "", **_FOOD_AXES}

OF_JOINT = ("position", "velocity", "effort")
OF_CUBE = tuple(_AXES)
OF_FOOD = tuple(_FOOD_AXES)
"""The types of sensors of a cube that are about the nearest food."""
OF_OTHERS = tuple(_OTHER_AXES)
"""The types of sensors of a cube that are about the nearest other creature."""
VECTORS = tuple(name for name, axes in _AXES.items() if axes)
