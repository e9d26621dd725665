"""The drawing of one world with Rerun: its scenery, cubes, joints, contacts, forces, log and curves.

It hides Rerun's archetypes and entities. All cubes are one entity, so that a picture of a
thousand is one message; a planar world is drawn in two dimensions.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import atan2, cos, inf, sin
from typing import TYPE_CHECKING, Any

import numpy as np

from nmes.backend import Array, Heightfield, SceneSpec, StaticBox, Vector
from nmes.backend.rotation import cross, multiply, normalize, rotate
from nmes.backend.shapes import SHAPES, axis, lying
from nmes.errors import MissingPackage
from nmes.recording.viewer_messages import Shape
from nmes.view.part_colors import visible_shapes

if TYPE_CHECKING:
    import rerun as rr

__all__ = ["Canvas", "load_rerun"]

_MOVED = 1e-4  # m, and parts of a unit quaternion: smaller changes cannot be seen
_NEWTON = 0.002  # m of arrow for 1 N
_LONGEST = 0.6  # m of arrow: what carries a heavy creature must not hide it
_ARC = 16  # points along the limits of a hinge
_REACH = 0.75  # of an axis that is drawn, as a part of the smaller cube's size: it sticks out of it on both sides
_FIRST = 2.0  # s after the first cubes, in which their extent decides where the eye is
_PLAIN = 1000.0  # m: how far the ground of a plane is drawn
_COLORS = {"hinge": (240, 200, 60), "slide": (90, 200, 240), "fixed": (150, 150, 150)}
_OTHER = (200, 120, 240)
_FORCE, _CONTACT, _SCENERY = (255, 90, 60), (210, 60, 190), (120, 125, 130)
_THIN, _THICK = -1.5, -2.0  # radii of lines; Rerun takes negative ones as points of the screen


def load_rerun() -> Any:
    """Imports Rerun, which takes half a second and is an extra, and returns it.

    Raises:
        MissingPackage: It is not installed.
    """
    try:
        import rerun
        import rerun.blueprint
    except ImportError as error:
        raise MissingPackage("viewing needs Rerun: pip install 'nmes[view]'") from error
    return rerun


class Canvas:
    """The drawing of one world, under one entity of a Rerun recording.

    Args:
        stream: The Rerun stream to draw to.
        root: The name of the entity under which all of it stands.
        planar: Whether it is drawn in two dimensions, as outlines.

    Attributes:
        planar: Whether it is drawn in two dimensions.
        entity: The path of the entity, as Rerun writes it.
    """

    def __init__(self, stream: rr.RecordingStream, root: str, planar: bool) -> None:
        self._rr = load_rerun()
        self._stream, self.planar = stream, planar
        self.entity: str = self._rr.escape_entity_path_part(root)
        self._shapes: dict[str, Shape] = {}
        self._poses = np.zeros((0, 7))
        self._drawn: set[str] = set()
        self._root = root
        self.curves: dict[str, str] = {}
        """The entities of curves, by name."""
        self._now, self._until = 0.0, inf
        self.extent: tuple[Array, Array] | None = None
        """The corners of the box around all cubes in their first seconds, arrays (3,), m; None without cubes."""
        if not planar:
            self._log("scene", self._rr.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)

    def at(self, seconds: float) -> None:
        """Sets the time (s) at which the following calls draw."""
        self._now = seconds
        self._stream.set_time("time", duration=seconds)

    def _log(self, path: str, what: Any, static: bool = False) -> None:
        self._stream.log(f"{self.entity}/{path}", what, static=static)

    def scenery(self, scene: SceneSpec) -> None:
        """Draws the scenery: obstacles, landscape, planets."""
        rr = self._rr
        if self.planar:
            lines = [[*_hull(box.section())] for box in scene.boxes]
            lines += [scene.heightfield.profile()] if scene.heightfield is not None else []
            lines += [[(-_PLAIN, 0.0), (_PLAIN, 0.0)]] if scene.ground else []
            strips = [[(x, -y) for x, y in line] for line in lines]
            self._log("scene/ground", rr.LineStrips2D(strips, colors=[_SCENERY]), static=True)
            return
        if scene.boxes:
            for kind in SHAPES:
                things = [box for box in scene.boxes if box.shape == kind]
                if things:
                    poses = np.array([[*box.position, *box.quaternion] for box in things])
                    solids = _solids(rr, kind, [box.size for box in things], poses, colors=[_SCENERY])
                    self._log("scene/obstacles" if kind == "box" else f"scene/{kind}s", solids, static=True)
        if scene.heightfield is not None:
            self._log("scene/landscape", self._landscape(scene.heightfield), static=True)
        if scene.planets:
            self._log(
                "scene/planets",
                rr.Ellipsoids3D(
                    half_sizes=[(planet.radius,) * 3 for planet in scene.planets],
                    centers=[planet.position for planet in scene.planets],
                    colors=[(90, 115, 80)],
                    fill_mode="solid",
                ),
                static=True,
            )

    def _landscape(self, field: Heightfield) -> Any:
        rows, columns = field.heights.shape
        x = np.linspace(-field.size[0] / 2.0, field.size[0] / 2.0, columns)
        z = np.linspace(-field.size[1] / 2.0, field.size[1] / 2.0, rows)
        points = np.stack([np.tile(x, rows), field.heights.ravel(), np.repeat(z, columns)], axis=1)
        corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
        right, below = corner + 1, corner + columns
        triangles = np.concatenate([np.stack([corner, below, right], 1), np.stack([right, below, below + 1], 1)])
        shade = 0.6 + 0.4 * (points[:, 1] - points[:, 1].min()) / max(float(np.ptp(points[:, 1])), 1e-9)
        colors = (shade[:, None] * np.array([[105, 135, 90]])).astype(np.uint8)
        return self._rr.Mesh3D(vertex_positions=points, triangle_indices=triangles, vertex_colors=colors)

    def cubes(self, shapes: Mapping[str, Shape], poses: Array) -> bool:
        """Draws the cubes; returns whether any had changed by as much as can be seen, else nothing is sent.

        Args:
            shapes: Their edge lengths (m), colours and shapes, by name.
            poses: Array (n, 7), in the same order: positions (m) and quaternions (x, y, z, w).
        """
        rr = self._rr
        shapes = visible_shapes(shapes)
        same = list(shapes.items()) == list(self._shapes.items())
        if same and not (np.abs(poses - self._poses) > _MOVED).any():
            return False
        self._poses = poses.copy()
        self._reach_out(shapes, poses)
        if self.planar:
            corners = [_outline(shape, pose) for shape, pose in zip(shapes.values(), poses.tolist(), strict=True)]
            colors = [_bytes(color) for _, color, _ in shapes.values()]
            self._log(
                "cubes", rr.LineStrips2D(corners, colors=colors, radii=_THICK, labels=list(shapes), show_labels=False)
            )
        else:
            for kind in SHAPES:
                self._solids(kind, shapes, poses, same)
        self._shapes = shapes
        return True

    def _solids(self, kind: str, shapes: Mapping[str, Shape], poses: Array, same: bool) -> None:
        """Draws the cubes of one shape; of those that were drawn before the poses alone."""
        path = "cubes" if kind == "box" else f"{kind}s"
        names = [name for name, shape in shapes.items() if shape[2] == kind]
        if not names and kind != "box":
            self._erase(path)
            return
        rows = [row for row, shape in enumerate(shapes.values()) if shape[2] == kind]
        sizes = [shapes[name][0] for name in names]
        looks: dict[str, Any] = {}
        if not same:
            looks = {"colors": [_bytes(shapes[name][1]) for name in names], "labels": names, "show_labels": False}
        self._log(path, _solids(self._rr, kind, sizes, poses[rows], moved=same, **looks))
        if kind != "box":
            self._drawn.add(path)

    def _reach_out(self, shapes: Mapping[str, Shape], poses: Array) -> None:
        if not shapes or self._now > self._until:
            return
        # However a cube is turned, it is in the ball round it.
        around = np.array([[np.linalg.norm(size) / 2.0] for size, _, _ in shapes.values()])
        low, high = (poses[:, :3] - around).min(axis=0), (poses[:, :3] + around).max(axis=0)
        if self.extent is None:
            self._until = self._now + _FIRST
        else:
            low, high = np.minimum(low, self.extent[0]), np.maximum(high, self.extent[1])
        self.extent = low, high

    def joints(self, infos: Sequence[Mapping[str, Any]]) -> None:
        """Draws joints from their `joint_info`: the axis at the anchor, and the range between the limits."""
        strips: list[list[tuple[float, float, float]]] = []
        colors: list[tuple[int, int, int]] = []
        names: list[str] = []
        for info in infos:
            sizes = [min(self._shapes[info[cube]][0]) for cube in ("cube1", "cube2") if info[cube] in self._shapes]
            reach = _REACH * min(sizes, default=1.0)
            for strip in _joint_lines(info, reach, self.planar):
                strips.append(strip)
                colors.append(_COLORS.get(info["joint_type"], _OTHER))
                names.append(info["joint_name"])
        self._lines("joints", strips, colors, names)

    def contacts(self, points: Array, forces: Array) -> None:
        """Draws contacts: arrays (n, 3) of points and of the forces that act there, N."""
        self._arrows("contacts", points, forces, _CONTACT)

    def forces(self, points: Array, forces: Array, names: Sequence[str] = ()) -> None:
        """Draws the forces that clients applied: arrays (n, 3) of points and of forces, N."""
        self._arrows("forces", points, forces, _FORCE, names)

    def say(self, text: str, level: str = "INFO", where: str = "log") -> None:
        """Writes a line of the log beside the time line; the level TRACE is hidden at first."""
        self._log(where, self._rr.TextLog(text, level=level))

    def curve(self, name: str, times: Array, values: Array) -> None:
        """Draws a curve: arrays (n,) of times (s) and values; it has gaps where values are not finite."""
        rr = self._rr
        finite = np.isfinite(values)
        path = f"{self.entity}/plots/{rr.escape_entity_path_part(name)}"
        self.curves[name] = path
        self._stream.log(path, rr.SeriesLines(names=self._root), static=True)
        index = rr.TimeColumn("time", duration=times[finite])
        self._stream.send_columns(path, [index], rr.Scalars.columns(scalars=values[finite]))

    def _arrows(
        self, path: str, points: Array, forces: Array, color: tuple[int, int, int], names: Sequence[str] = ()
    ) -> None:
        if not len(points):
            self._erase(path)
            return
        length = np.linalg.norm(forces, axis=1, keepdims=True)
        vectors = forces * np.minimum(_NEWTON, _LONGEST / np.maximum(length, 1e-9))
        labels = {"labels": list(names), "show_labels": False} if names else {}
        if self.planar:
            flip = np.array([1.0, -1.0])
            arrows = self._rr.Arrows2D(
                vectors=vectors[:, :2] * flip, origins=points[:, :2] * flip, colors=[color], radii=_THICK, **labels
            )
        else:
            arrows = self._rr.Arrows3D(vectors=vectors, origins=points, colors=[color], radii=_THICK, **labels)
        self._log(path, arrows)
        self._drawn.add(path)

    def _lines(self, path: str, strips: list[Any], colors: list[tuple[int, int, int]], names: list[str]) -> None:
        if not strips:
            self._erase(path)
            return
        fields = {"colors": colors, "labels": names, "show_labels": False, "radii": _THIN}
        if self.planar:
            flat = [[(x, -y) for x, y, _ in strip] for strip in strips]
            self._log(path, self._rr.LineStrips2D(flat, **fields))
        else:
            self._log(path, self._rr.LineStrips3D(strips, **fields))
        self._drawn.add(path)

    def _erase(self, path: str) -> None:
        if path in self._drawn:
            self._drawn.discard(path)
            self._log(path, self._rr.Clear(recursive=False))


def _hull(points: Sequence[tuple[float, float]]) -> Iterator[tuple[float, float]]:
    """Yields the corners of a convex shape in order around it, and the first again."""
    x, y = (sum(point[i] for point in points) / max(len(points), 1) for i in (0, 1))
    round_it = sorted(points, key=lambda point: atan2(point[1] - y, point[0] - x))
    yield from (*round_it, *round_it[:1])


def _bytes(color: Sequence[float]) -> tuple[int, ...]:
    return tuple(round(255 * part) for part in color)


def _solids(rr: Any, kind: str, sizes: Sequence[Vector], poses: Array, moved: bool = False, **looks: Any) -> Any:
    """Returns the Rerun archetype of things of one shape: all of it, or its poses alone where they only `moved`.

    Args:
        rr: Rerun.
        kind: The shape.
        sizes: Edge lengths, m.
        poses: Array (n, 7): positions (m) and quaternions (x, y, z, w).
        moved: See above.
        looks: Colours and labels.
    """
    places, turns = poses[:, :3], poses[:, 3:]
    lengths = np.array([size[axis(size)] for size in sizes])
    radii = np.array([size[axis(size) - 1] / 2.0 for size in sizes])
    if kind in ("capsule", "cylinder"):  # which are drawn along z
        turned = [multiply(tuple(turn), lying(size)) for turn, size in zip(turns.tolist(), sizes, strict=True)]
        turns = np.array(turned)
        if kind == "capsule":  # and from one end
            lengths = lengths - 2.0 * radii
            ways = [rotate(turn, (0.0, 0.0, 0.5)) for turn in turned]
            places = places - np.array(ways) * lengths[:, None]
    kinds: dict[str, tuple[Any, str, dict[str, Any]]] = {
        "box": (rr.Boxes3D, "centers", {"sizes": sizes}),
        "sphere": (rr.Ellipsoids3D, "centers", {"half_sizes": np.repeat(radii[:, None], 3, axis=1)}),
        "capsule": (rr.Capsules3D, "translations", {"lengths": lengths, "radii": radii}),
        "cylinder": (rr.Cylinders3D, "centers", {"lengths": lengths, "radii": radii}),
    }
    archetype, where, form = kinds[kind]
    if moved:
        return archetype.from_fields(**{where: places}, quaternions=turns)
    return archetype(**form, **{where: places}, quaternions=turns, **looks, fill_mode="solid")


def _outline(shape: Shape, pose: Sequence[float]) -> list[tuple[float, float]]:
    """Returns the corners of a cube of the plane; Rerun's second axis points downwards."""
    turn, (size, _, kind) = (pose[3], pose[4], pose[5], pose[6]), shape
    if kind != "box":
        thing = StaticBox(size, (pose[0], pose[1], 0.0), turn, kind)
        return [(x, -y) for x, y in _hull(thing.section())]
    corners = []
    for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1), (1, 1)):
        across, up, _ = rotate(turn, (x * size[0] / 2.0, y * size[1] / 2.0, 0.0))
        corners.append((pose[0] + across, -pose[1] - up))
    return corners[:5]


def _joint_lines(info: Mapping[str, Any], reach: float, planar: bool) -> Iterator[list[tuple[float, float, float]]]:
    ax, ay, az = info["anchor"]
    kind, params = info["joint_type"], info["params"]
    if kind in ("fixed", "pin") or (planar and kind == "hinge"):  # its axis points at the eye
        for x, y, z in ((reach, 0, 0), (0, reach, 0), (0, 0, reach)):
            yield [(ax - x / 2, ay - y / 2, az - z / 2), (ax + x / 2, ay + y / 2, az + z / 2)]
    if kind in ("fixed", "pin"):
        return
    axis = normalize((*info["axis"], 0.0))[:3]
    low, high = -reach, reach
    limited = bool(params.get("limit_enabled"))
    if kind == "slide" and limited:
        low, high = (params[name] - info["position"] for name in ("limit_lower", "limit_upper"))
    yield [(ax + axis[0] * part, ay + axis[1] * part, az + axis[2] * part) for part in (low, high)]
    if kind == "hinge" and limited:
        # An arc round the axis, from limit to limit; its spoke is where the joint stands.
        aside = normalize((*cross(axis, (0.0, 0.0, 1.0) if abs(axis[2]) < 0.9 else (1.0, 0.0, 0.0)), 0.0))[:3]
        third = cross(axis, aside)

        def point(angle: float, length: float) -> tuple[float, float, float]:
            cosine, sine = length * cos(angle), length * sin(angle)
            return (
                ax + cosine * aside[0] + sine * third[0],
                ay + cosine * aside[1] + sine * third[1],
                az + cosine * aside[2] + sine * third[2],
            )

        lower, upper = params["limit_lower"], params["limit_upper"]
        yield [point(lower + (upper - lower) * i / _ARC, reach) for i in range(_ARC + 1)]
        yield [(ax, ay, az), point(info["position"], reach)]
