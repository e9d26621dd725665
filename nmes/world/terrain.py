"""Where the ground of a scene is, for bodies that are put somewhere: none of them begins inside of it.

Hides what counts as inside, which way is out, and how far. A body that stands in the ground is set down on the surface
above it: straight up, or away from the nearest planet. What is only a little inside is left to the engine, and so is a
body beside an obstacle whose side it is pressed into, for on top of it would be far away. Arenas are not known here.
What is round counts as inside of an obstacle where its box's faces or the obstacle's do not tell them apart, and of
landscapes and planets where its box is.

Sums, products and square roots only, so that it is the same everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from math import inf, sqrt

import numpy as np

from nmes.backend import Array, Heightfield, Planet, Quaternion, SceneSpec, StaticBox, Vector
from nmes.backend.rotation import conjugate, cross, dot, minus, plus, rotate, total

__all__ = ["Terrain"]

_UP: Vector = (0.0, 1.0, 0.0)
_ZERO: Vector = (0.0, 0.0, 0.0)
_AXES: tuple[Vector, Vector, Vector] = ((1.0, 0.0, 0.0), _UP, (0.0, 0.0, 1.0))
_SHALLOW = 0.01  # part of a box's shortest edge: what is less deep is not inside
_LAYERS = 1000  # obstacles on top of each other, at most, that a body is lifted out of
_POINT = 0.001  # m: the box that stands for a point
_HALVINGS = 60  # of the way out of a planet: to the last bit


class Terrain:
    """The ground, the landscape, the obstacles and the planets of one scene.

    Args:
        scene: The scene.
        planar: Whether the engine knows only the XY plane, where boxes have no extent along z.
    """

    def __init__(self, scene: SceneSpec, planar: bool) -> None:
        self._scene, self._planar, self._landscape = scene, planar, scene.heightfield
        if planar and scene.heightfield is not None:  # the slice at z = 0, wherever its rows are
            line = [height for _, height in scene.heightfield.profile()]
            self._landscape = Heightfield(scene.heightfield.size, np.array([line] * 3))
        self._obstacles = [box for box in scene.boxes if box.section()] if planar else scene.boxes
        corners = np.array([_extent(box) for box in self._obstacles]).reshape(-1, 2, 3)
        self._low, self._high = corners[:, 0], corners[:, 1]

    def surface(self, x: float, z: float) -> Vector:
        """Returns the point of the ground at a place, m: on top of obstacles; with planets, of the first one's top."""
        scene = self._scene
        if scene.planets:
            planet = scene.planets[0]
            length = sqrt(x * x + planet.radius * planet.radius + z * z)
            part = planet.radius / length
            return plus(planet.position, (x * part, planet.radius * part, z * part))
        field, y = self._landscape, 0.0
        if field is not None:
            # Beyond its edges as low as it is anywhere. Which of 0.0 and -0.0 is found depends on the processor.
            y = max(_height(field, x, z), float(field.heights.min())) + 0.0
        (_, y, _) = self.outside([StaticBox((_POINT,) * 3, (x, y + _POINT / 2.0, z))])[0]
        return x, y - _POINT / 2.0, z

    def outside(self, boxes: Sequence[StaticBox]) -> list[Vector]:
        """Returns where boxes are to be, m: as they are where none of them is in the ground, else all shifted alike."""
        shift = self._way_out(boxes)
        return [plus(box.position, shift) if shift != _ZERO else box.position for box in boxes]

    def _way_out(self, boxes: Sequence[StaticBox]) -> Vector:
        planet = self._nearest_planet(boxes[0].position)
        up = _UP if planet is None else _direction(planet, boxes)
        if self._planar:
            boxes = [replace(box, size=(box.size[0], box.size[1], 0.0)) if box.shape == "box" else box for box in boxes]
        lift, shift = 0.0, _ZERO
        for _ in range(_LAYERS):
            moved = [replace(box, position=plus(box.position, shift)) for box in boxes] if lift else boxes
            depth = max(self._depth(box, up, planet) for box in moved)
            if depth == 0.0:
                break
            lift += depth
            shift = (up[0] * lift, up[1] * lift, up[2] * lift)
        return shift

    def _nearest_planet(self, position: Vector) -> Planet | None:
        return min(self._scene.planets, key=lambda planet: _distance(planet.position, position), default=None)

    def _depth(self, box: StaticBox, up: Vector, planet: Planet | None) -> float:
        """Returns how far (m) a box must go up to be out of what it is in; 0 where that is nothing."""
        scene, shallow, depths = self._scene, _SHALLOW * min(box.size[:2] if self._planar else box.size), [0.0]
        if scene.ground:
            depths.append(box.reach(_UP) - box.position[1])
        if self._landscape is not None:
            depths.append(_depth_in_landscape(box, self._landscape))
        if planet is not None:
            depths.append(_depth_in_planet(box, planet, up))
        if self._obstacles:
            low, high = _extent(box)
            near = np.flatnonzero(((self._low < high) & (self._high > low)).all(axis=1))
            depths += [_depth_in_obstacle(box, self._obstacles[number], up, shallow) for number in near.tolist()]
        deepest = max(depths)
        return deepest if deepest > shallow else 0.0


def _direction(planet: Planet, boxes: Sequence[StaticBox]) -> Vector:
    """Returns the way that is up for boxes on a planet: away from its centre, through the middle of theirs."""
    x, y, z = (total(box.position[i] for box in boxes) / len(boxes) - planet.position[i] for i in range(3))
    length = sqrt(x * x + y * y + z * z)
    return (x / length, y / length, z / length) if length > 1e-9 else _UP


def _distance(a: Vector, b: Vector) -> float:
    x, y, z = minus(a, b)
    return sqrt(x * x + y * y + z * z)


def _axes(quaternion: Quaternion) -> list[Vector]:
    return [rotate(quaternion, axis) for axis in _AXES]


def _extent(box: StaticBox) -> tuple[Vector, Vector]:
    """Returns the corners of the upright box around a box."""
    x, y, z = (box.reach(axis) for axis in _AXES)
    return minus(box.position, (x, y, z)), plus(box.position, (x, y, z))


def _depth_in_obstacle(box: StaticBox, obstacle: StaticBox, up: Vector, shallow: float) -> float:
    """Returns how far up a box must go to leave an obstacle, 0 where it is outside of it or only in its side.

    What is less than `shallow` inside counts as outside.

    Two boxes are apart exactly if they are along one of 15 directions: the axes of both, and the cross products of
    these (Gottschalk, Lin and Manocha: OBBTree, SIGGRAPH 1996).
    """
    ours, theirs = _axes(box.quaternion), _axes(obstacle.quaternion)
    way = minus(box.position, obstacle.position)
    lift = inf
    for axis in (*ours, *theirs, *(cross(one, other) for one in ours for other in theirs)):
        square = dot(axis, axis)
        if square < 1e-9:
            continue  # the cross product of parallel axes
        length = sqrt(square)
        distance, rise = dot(way, axis) / length, dot(up, axis) / length
        reach = (box.reach(axis) + obstacle.reach(axis)) / length
        if reach - abs(distance) <= shallow:
            return 0.0
        if abs(rise) > 1e-9:
            lift = min(lift, (reach - distance) / rise if rise > 0.0 else (reach + distance) / -rise)
    middle = rotate(conjugate(obstacle.quaternion), way)
    buried = all(abs(part) < edge / 2.0 for part, edge in zip(middle, obstacle.size, strict=True))
    return lift if buried or lift < box.reach(up) else 0.0


def _depth_in_planet(box: StaticBox, planet: Planet, up: Vector) -> float:
    """Returns how far up a box must go until its nearest point is at the planet's surface, 0 where it is outside."""
    way, back = minus(box.position, planet.position), conjugate(box.quaternion)
    start, rise = rotate(back, way), rotate(back, up)

    def gap(lift: float) -> float:
        """Returns the distance of the planet's centre from the box; along a line it falls, and then rises."""
        parts = (
            max(0.0, abs(at + lift * step) - edge / 2.0) for at, step, edge in zip(start, rise, box.size, strict=True)
        )
        return sqrt(total(part * part for part in parts))

    if gap(0.0) >= planet.radius:
        return 0.0
    inside, outside = 0.0, planet.radius + sqrt(dot(way, way)) + sqrt(dot(box.size, box.size))
    for _ in range(_HALVINGS):
        middle = (inside + outside) / 2.0
        if gap(middle) < planet.radius:
            inside = middle
        else:
            outside = middle
    return outside


def _depth_in_landscape(box: StaticBox, field: Heightfield) -> float:
    """Returns how far up a box must go to be above a landscape, 0 where it is.

    Where two surfaces of flat pieces meet first is a corner of one of them, or where two edges cross: the latter, which
    would be a few centimetres, is left to the engine.
    """
    rows, columns = field.heights.shape
    xs = (np.arange(columns) / (columns - 1) - 0.5) * field.size[0]
    zs = (np.arange(rows) / (rows - 1) - 0.5) * field.size[1]
    low, high = _extent(box)
    in_x, in_z = np.flatnonzero((xs >= low[0]) & (xs <= high[0])), np.flatnonzero((zs >= low[2]) & (zs <= high[2]))
    depth = 0.0
    if len(in_x) and len(in_z):
        bottom = _underside(box, xs[in_x][None, :], zs[in_z][:, None])
        depth = max(depth, float((field.heights[np.ix_(in_z, in_x)] - bottom).max()))
    edges = [(axis, edge / 2.0) for axis, edge in zip(_axes(box.quaternion), box.size, strict=True)]
    for signs in product((-1.0, 1.0), repeat=3):
        x, y, z = box.position
        for sign, ((ax, ay, az), half) in zip(signs, edges, strict=True):
            x, y, z = x + sign * half * ax, y + sign * half * ay, z + sign * half * az
        depth = max(depth, _height(field, x, z) - y)
    return depth


def _underside(box: StaticBox, x: Array, z: Array) -> Array:
    """Returns the heights at which upright lines enter a box from below; infinity where they miss it."""
    right, upward, ahead = _axes(conjugate(box.quaternion))  # the world's axes, as the box has them
    px, py, pz = box.position
    enter, leave = np.full(np.broadcast(x, z).shape, -inf), np.full(np.broadcast(x, z).shape, inf)
    for i in range(3):
        start, half = right[i] * (x - px) + ahead[i] * (z - pz), box.size[i] / 2.0
        if abs(upward[i]) < 1e-9:
            leave = np.where(abs(start) <= half, leave, -inf)
            continue
        one, other = (-half - start) / upward[i], (half - start) / upward[i]
        enter, leave = np.maximum(enter, np.minimum(one, other)), np.minimum(leave, np.maximum(one, other))
    return np.where(enter <= leave, enter + py, inf)


def _height(field: Heightfield, x: float, z: float) -> float:
    """Returns the height of a landscape at a place; minus infinity beyond its edges."""
    rows, columns = field.heights.shape
    u, v = (x / field.size[0] + 0.5) * (columns - 1), (z / field.size[1] + 0.5) * (rows - 1)
    if not (0.0 <= u <= columns - 1 and 0.0 <= v <= rows - 1):
        return -inf
    column, row = min(int(u), columns - 2), min(int(v), rows - 2)
    u, v = u - column, v - row
    (a, b), (c, d) = field.heights[row : row + 2, column : column + 2].tolist()
    height: float = (a * (1.0 - u) + b * u) * (1.0 - v) + (c * (1.0 - u) + d * u) * v
    return height
