"""The sensors that a creature may have: how many numbers each type reads, and of what; and single readings.

A new sensor of a cube is one more function of the cube's state, listed in `CUBE_READINGS`; `schemas/genome.json` says
which types a document may name. CONTRIBUTING.md shows it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from nmes.backend import BodyState, Vector

__all__ = [
    "ACCELERATION",
    "NEEDED",
    "OF_CUBE",
    "OF_FOOD",
    "OF_JOINT",
    "OF_OTHERS",
    "READING_OF",
    "SMELLS",
    "SURROUNDED",
    "TURNING",
    "VECTORS",
    "Camera",
    "CubeReading",
    "Flaws",
    "Read",
    "Sensor",
]

Read = Callable[[BodyState], tuple[float, ...]]

TURNING = 0.1
"""Sensors read turning in 10 rad/s."""
ACCELERATION = 0.1
"""Sensors read acceleration in 10 m/s²."""


@dataclass(frozen=True, slots=True)
class Flaws:
    """How a sensor or motor errs.

    Attributes:
        noise: Standard deviation of what is added, in the unit of the reading or control.
        delay: How many ticks ago what is read or done was.
        drop_out: How likely it fails in a tick, from 0 to 1.
    """

    noise: float = 0.0
    delay: int = 0
    drop_out: float = 0.0

    @classmethod
    def read(cls, document: Mapping[str, Any] | None) -> Flaws | None:
        """Returns the flaws of a document that its schema has accepted; None where there are none."""
        document = document or {}
        noise, drop_out = (float(document.get(name, 0.0)) for name in ("noise", "drop_out"))
        flaws = cls(noise, int(document.get("delay", 0)), drop_out)
        return None if flaws == _FLAWLESS else flaws

    @staticmethod
    def worse(one: Flaws | None, other: Flaws | None) -> Flaws | None:
        """Returns the larger of each number of two; None where neither has any."""
        if one is None or other is None:
            return one or other
        noise, drop_out = max(one.noise, other.noise), max(one.drop_out, other.drop_out)
        return Flaws(noise, max(one.delay, other.delay), drop_out)


_FLAWLESS = Flaws()


@dataclass(frozen=True, slots=True)
class Camera:
    """A camera at a cube's centre.

    Attributes:
        width: Pixels of a row.
        height: Rows.
        fov: Vertical field of view, rad.
        rgb: Whether a pixel is three numbers, red, green and blue, and not one.
    """

    width: int
    height: int
    fov: float
    rgb: bool


@dataclass(frozen=True, slots=True)
class Sensor:
    """One reading of a body.

    Attributes:
        id: Its name, unique in the body.
        type: As in the document.
        of: Whether it is on a joint or a cube.
        target: The id of that.
        axis: `x`, `y` or `z` of a vector, else None.
        range: In m. Of another creature: how far it is seen; None: at any distance. Of `range` and a camera: how far it
            looks; of a smell: where it is half as strong.
        channel: What `hear` hears, else None.
        number: Which of the channel's, or of the camera's numbers that is, from 1.
        face: Of `touch`, the only face that counts (`+x` to `-z`); None: all.
        direction: Where `range` and a camera look, in the cube's own directions, of length 1; else None.
        camera: The camera whose reading it is, else None.
        flaws: How it errs; None: it does not.
    """

    id: str
    type: str
    of: Literal["joint", "cube"]
    target: str
    axis: str | None
    range: float | None = None
    channel: str | None = None
    number: int = 1
    face: str | None = None
    direction: Vector | None = None
    camera: Camera | None = None
    flaws: Flaws | None = None

    @property
    def solitary(self) -> bool:
        """Whether only a world of its own can read it, and no row of an engine."""
        return self.type in SURROUNDED or self.face is not None or self.flaws is not None


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
SMELLS = ("food_smell", "other_smell", "target_smell")
"""The types of sensors of a cube that tell how near sources are, but not where."""
_SMELL_AXES = dict.fromkeys(SMELLS, "")
NEEDED = {
    "touch": ("contacts", "sense of touch"),
    "acceleration": ("sensors.inertial", "accelerometers"),
    "range": ("sensors.range", "range finders"),
    "camera": ("sensors.range", "rays, of which creatures' cameras are made"),
}
"""The capability that an engine must have for types of sensors, and what to call it."""
SURROUNDED = ("acceleration", "range", "camera", *SMELLS)
"""The types of sensors of a cube that only a world of its own can read, and no row of an engine."""
_FURTHER_AXES = {"acceleration": "xyz", "range": "", "camera": "", **_SMELL_AXES}
_AXES = {**_STATE_AXES, "touch": "", **_TARGET_AXES, **_OTHER_AXES, "hear": "", **_FOOD_AXES, **_FURTHER_AXES}

OF_JOINT = ("position", "velocity", "effort")
OF_CUBE = tuple(_AXES)
OF_FOOD = tuple(_FOOD_AXES)
"""The types of sensors of a cube that are about the nearest food."""
OF_OTHERS = tuple(_OTHER_AXES)
"""The types of sensors of a cube that are about the nearest other creature."""
VECTORS = tuple(name for name, axes in _AXES.items() if axes)
