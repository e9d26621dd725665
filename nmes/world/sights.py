"""What a body perceives around it with range finders, cameras, faces that feel, accelerometers and noses.

Hides how a picture is made of rays, and what has which colour. A picture is a function of what the engine says that
rays meet, so that it has the same bits wherever the engine has: no graphics driver draws it. Invariant: to look
changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import inf, sqrt, tan
from typing import Any, Final, TypeAlias

import numpy as np

from nmes.backend import Array, Hit, Vector
from nmes.backend.rotation import cross, dot, minus, rotate, total
from nmes.genome.sensors import ACCELERATION, Camera, Sensor
from nmes.world.channels import Channels
from nmes.world.entities import Cube, Entities
from nmes.world.nearby import Nearby
from nmes.world.readings import face_of, own_axes

__all__ = ["Reader", "Surroundings", "look_around", "looks_around"]

Reader: TypeAlias = Callable[[Array], None]
"""Writes some sensors' values into those of all, shape (s,)."""
_Rows: TypeAlias = list[tuple[int, Sensor]]  # sensors with their places among all

_SKY: Final = (0.7, 0.8, 0.9)
_GROUND: Final = (0.4, 0.4, 0.4)  # and scenery
_LUMA: Final = (0.299, 0.587, 0.114)  # of red, green and blue in brightness, as in ITU-R BT.601
_STILL: Final[Vector] = (0.0, 0.0, 0.0)
_UP: Final[Vector] = (0.0, 1.0, 0.0)
_UPRIGHT: Final = 0.999  # of a direction along the cube's own y, whose picture has x upwards


@dataclass(frozen=True, eq=False, slots=True)
class Surroundings:
    """What a body may sense besides itself.

    Attributes:
        entities: The world's cubes and food.
        others: The roots of all creatures of the world.
        channels: Where it hears.
        target: What its target sensors point to: a point (m) or the name of a cube; None: nothing.
        bodies: The numbers of its own cubes, whose voices it does not hear, the root's first.
    """

    entities: Entities
    others: Nearby
    channels: Channels
    target: Vector | str | None
    bodies: tuple[int, ...]

    def aim(self) -> tuple[Vector, Vector] | None:
        """Returns where the target is (m) and how it moves (m/s); None where there is none."""
        target = self.target
        if not isinstance(target, str):
            return None if target is None else (target, _STILL)
        cube = self.entities.cubes.get(target)
        if cube is None:
            return None
        state = self.entities.simulation.body_state(cube.body)
        return state.position, state.linear_velocity


def looks_around(sensor: Sensor) -> bool:
    """Whether a sensor is one that `look_around` takes."""
    return sensor.type in _READERS and (sensor.type != "touch" or sensor.face is not None)


def look_around(sensors: Iterable[tuple[int, Sensor]], cubes: Mapping[str, Cube], around: Surroundings) -> list[Reader]:
    """Returns readers of those sensors of cubes that are about rays, touch of single faces, or smell.

    Args:
        sensors: Sensors with their places among all.
        cubes: The cubes that they are on, by their ids.
        around: What they perceive.
    """
    groups: dict[tuple[Any, ...], _Rows] = {}
    for row, sensor in sensors:
        direction = None if sensor.camera is None else sensor.direction
        key = sensor.type, sensor.target, sensor.range, sensor.camera, direction
        groups.setdefault(key, []).append((row, sensor))
    return [_READERS[kind](group, cubes[part].body, around) for (kind, part, *_), group in groups.items()]


class _Faces:
    """Whether single faces of one cube are touched."""

    def __init__(self, group: _Rows, body: int, around: Surroundings) -> None:
        self._body, self._simulation = body, around.entities.simulation
        self._faces = [(row, sensor.face) for row, sensor in group]

    def __call__(self, out: Array) -> None:
        quaternion = self._simulation.body_state(self._body).quaternion
        contacts = self._simulation.contacts(self._body)
        touched = {face_of(own_axes(quaternion, contact.normal)) for contact in contacts}
        for row, face in self._faces:
            out[row] = face in touched


class _Accelerometer:
    """What an accelerometer at one cube's centre feels."""

    def __init__(self, group: _Rows, body: int, around: Surroundings) -> None:
        self._body, self._simulation = body, around.entities.simulation
        self._axes = [(row, "xyz".index(sensor.axis or "x")) for row, sensor in group]

    def __call__(self, out: Array) -> None:
        x, y, z = self._simulation.proper_accelerations([self._body])[0].tolist()
        felt = own_axes(self._simulation.body_state(self._body).quaternion, (x, y, z))
        for row, axis in self._axes:
            out[row] = ACCELERATION * felt[axis]


class _Rays:
    """Rays from one cube's centre, in its own directions."""

    def __init__(self, body: int, entities: Entities, directions: Sequence[Vector], reach: float) -> None:
        self._body, self._simulation, self._reach = body, entities.simulation, reach
        self._x, self._y, self._z = np.array(directions).reshape(-1, 3).T[:, :, np.newaxis]

    def hits(self) -> list[Hit | None]:
        """Returns the hits, one for each ray; None where it meets nothing."""
        turn = self._simulation.body_state(self._body).quaternion
        x, y, z = (np.array(rotate(turn, axis)) for axis in ((1.0, 0.0, 0.0), _UP, (0.0, 0.0, 1.0)))
        ways = self._x * x + self._y * y + self._z * z  # products and sums alone, in one order
        return self._simulation.hits(self._body, ways, self._reach)


class _RangeFinders:
    """Range finders of one reach on one cube."""

    def __init__(self, group: _Rows, body: int, around: Surroundings) -> None:
        self._rows, self._reach = [row for row, _ in group], _reach(group)
        self._rays = _Rays(body, around.entities, [sensor.direction or _UP for _, sensor in group], self._reach)

    def __call__(self, out: Array) -> None:
        out[self._rows] = [self._reach if hit is None else hit.distance for hit in self._rays.hits()]


class _CameraPicture:
    """The picture of one camera, or those of its pixels that are sensors."""

    def __init__(self, group: _Rows, body: int, around: Surroundings) -> None:
        first = group[0][1]
        assert first.camera is not None and first.direction is not None
        # Arrays, since there may be a thousand of a creature: of as many numbers a list would take five times the room.
        self._entities, self._rows = around.entities, np.array([row for row, _ in group])
        self._rgb = first.camera.rgb
        self._rays = _Rays(body, around.entities, _directions(first.camera, first.direction), _reach(group))
        self._picked = np.array([sensor.number - 1 for _, sensor in group])

    def __call__(self, out: Array) -> None:
        entities = self._entities
        picture = [tone for hit in self._rays.hits() for tone in self._shades(entities, hit)]
        out[self._rows] = np.array(picture)[self._picked]

    def _shades(self, entities: Entities, hit: Hit | None) -> Sequence[float]:
        color: Sequence[float] = _SKY if hit is None else _GROUND
        if hit is not None and hit.other is not None:
            name = entities.body_names.get(hit.other)
            color = _GROUND if name is None else entities.cubes[name].color
        red, green, blue = color[:3]
        return (red, green, blue) if self._rgb else (_LUMA[0] * red + _LUMA[1] * green + _LUMA[2] * blue,)


class _Nose:
    """How strongly something smells at one cube."""

    def __init__(self, group: _Rows, body: int, around: Surroundings) -> None:
        first = group[0][1]
        self._body, self._around, self._half = body, around, _reach(group)
        self._rows = [row for row, _ in group]
        self._squares = _SOURCES[first.type]

    def __call__(self, out: Array) -> None:
        place = self._around.entities.simulation.body_state(self._body).position
        square = self._half * self._half
        out[self._rows] = total(square / (square + apart) for apart in self._squares(self._around, place))


def _to_food(around: Surroundings, place: Vector) -> list[float]:
    x, y, z = (around.entities.food - np.array(place)).T
    squares: list[float] = (x * x + y * y + z * z).tolist()
    return squares


def _to_others(around: Surroundings, place: Vector) -> list[float]:
    return [near.distance * near.distance for near in around.others.all(place, but=around.bodies[:1])]


def _to_target(around: Surroundings, place: Vector) -> list[float]:
    aim = around.aim()
    if aim is None:
        return []
    arm = minus(aim[0], place)
    return [dot(arm, arm)]


_SOURCES: Final[Mapping[str, Callable[[Surroundings, Vector], list[float]]]] = {
    "food_smell": _to_food,
    "other_smell": _to_others,
    "target_smell": _to_target,
}
"""What returns the squares of how far away sources are, m²."""
_READERS: Final[Mapping[str, Callable[[_Rows, int, Surroundings], Reader]]] = {
    "touch": _Faces,
    "acceleration": _Accelerometer,
    "range": _RangeFinders,
    "camera": _CameraPicture,
    **dict.fromkeys(_SOURCES, _Nose),
}


def _reach(group: _Rows) -> float:
    return group[0][1].range or inf


def _directions(camera: Camera, ahead: Vector) -> list[Vector]:
    """Returns the directions of a camera's pixels in its cube's own axes, row by row from the upper left."""
    up = _UP if abs(dot(ahead, _UP)) < _UPRIGHT else (1.0, 0.0, 0.0)
    right = _unit(cross(ahead, up))
    above = cross(right, ahead)
    half = tan(camera.fov / 2.0)
    step = 2.0 * half / camera.height  # pixels are square
    return [
        _unit(_sum(ahead, right, step * (column + 0.5 - camera.width / 2.0), above, half - step * (row + 0.5)))
        for row in range(camera.height)
        for column in range(camera.width)
    ]


def _sum(ahead: Vector, right: Vector, x: float, above: Vector, y: float) -> Vector:
    a, b, c = (a + x * r + y * u for a, r, u in zip(ahead, right, above, strict=True))
    return a, b, c


def _unit(vector: Vector) -> Vector:
    x, y, z = vector
    length = sqrt(dot(vector, vector))
    return x / length, y / length, z / length
