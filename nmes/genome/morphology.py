"""Generative bodies: a directed graph of parts grows into cubes and joints, in the manner of Sims.

After K. Sims, "Evolving Virtual Creatures" (SIGGRAPH 1994): parts may be grown again and again along the cycles of the
graph, up to a limit; connections say where on the parent and how turned and scaled a part grows, whether it is
reflected, and whether it grows only at the end of a chain.

Hides frames: each part grows along its own +x, away from the face that it stands on, and a reflection has all that
grows with the first. Invariants: growth is a function of the graph alone, in plain floats rounded to 1e-9, so that the
body written out is the body grown; it stops, with an error, before it has more cubes than a body may have, and at the
first cube of a size that none may have; the lowest corner of the body is at y = 0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import sqrt
from typing import Any, cast

import numpy as np

from nmes.backend import Array, Quaternion, Vector
from nmes.backend.rotation import multiply, normalize, quaternion_from_euler, rotate, total
from nmes.backend.shapes import misfit, volume
from nmes.errors import DocumentError
from nmes.schemas.documents import did_you_mean, nor_at

__all__ = ["MOST_CUBES", "grow"]

MOST_CUBES = 256
"""How many cubes a body may have."""
_SMALLEST, _LARGEST = 0.01, 10.0  # m: the edges of a cube, as the schema of genomes has them

JsonObject = Mapping[str, Any]

ZERO: Vector = (0.0, 0.0, 0.0)
UPRIGHT: Quaternion = (0.0, 0.0, 0.0, 1.0)
_POSITION, _ANCHOR, _AXIS = range(3)  # rows of a cube's vectors
_QUARTER = sqrt(0.5)
# The same formulas for arrays of coordinates.
_rotated = cast(Callable[[Quaternion, Array], tuple[Array, Array, Array]], rotate)
_multiplied = cast(Callable[[Quaternion, Array], tuple[Array, Array, Array, Array]], multiply)
# How a part is turned that grows straight away from a face: its +x is where the face looks to.
_AWAY: dict[str, Quaternion] = {
    "+x": UPRIGHT,
    "-x": (0.0, 1.0, 0.0, 0.0),
    "+y": (0.0, 0.0, _QUARTER, _QUARTER),
    "-y": (0.0, 0.0, -_QUARTER, _QUARTER),
    "+z": (0.0, -_QUARTER, 0.0, _QUARTER),
    "-z": (0.0, _QUARTER, 0.0, _QUARTER),
}
_DEFAULT_AXIS = {"hinge": (0.0, 0.0, 1.0), "slide": (1.0, 0.0, 0.0), "conetwist": (1.0, 0.0, 0.0)}
_DIGITS = 9


@dataclass(eq=False, slots=True)
class _Grown:
    """One cube: the `number`-th of its part, or that one's reflection, and the cube that its joint hangs on."""

    part: JsonObject
    scale: float
    number: int = 1
    mirrored: bool = False
    parent: _Grown | None = None

    @property
    def key(self) -> tuple[str, int, bool]:
        """What tells it from others."""
        return self.part["id"], self.number, self.mirrored

    @property
    def name(self) -> str:
        """Its name in the body."""
        number = f".{self.number}" if self.number > 1 else ""
        return f"{self.part['id']}{number}{'.mirror' if self.mirrored else ''}"

    @property
    def joint(self) -> JsonObject:
        """The joint by which it hangs on its parent, as its part has it."""
        joint: JsonObject = self.part.get("joint", {"type": "fixed"})
        return joint


@dataclass(eq=False, slots=True)
class _Branch:
    """Cubes that grow together, and where they are in the frame of the part that grows now.

    A cube is carried as often as there are parts before it, so all of a branch are at once: the numbers are those of
    `multiply`, `rotate` and `plus`.

    Attributes:
        cubes: The cubes, `n` of them; the one on which all others grow is the first.
        vectors: Array (3, n, 3): x, y and z of the position, the anchor and the axis of each.
        turns: Array (4, n): quaternion of each.
        last: The greatest number of each part.
    """

    cubes: list[_Grown]
    vectors: Array
    turns: Array
    last: dict[str, int]

    def shift(self, by: Vector) -> None:
        """Takes it to a frame in which this one's is shifted."""
        self.vectors[:, :, :_AXIS] += np.array(by)[:, np.newaxis, np.newaxis]

    def carry(self, by: Vector, turn: Quaternion) -> None:
        """Takes it to a frame in which this one's is shifted and turned."""
        self.vectors = np.array(_rotated(turn, self.vectors))
        self.turns = np.array(_multiplied(turn, self.turns))
        self.shift(by)

    def reflected(self, axis: int) -> _Branch:
        """Returns the mirror image across the plane through the origin that an axis is normal to."""
        images = {id(each): replace(each, mirrored=not each.mirrored) for each in self.cubes}
        for image in images.values():
            image.parent = images.get(id(image.parent))
        across, along = [each for each in range(3) if each != axis], [axis]
        vectors, turns = self.vectors.copy(), self.turns.copy()
        vectors[along, :, :_AXIS] *= -1.0
        turns[across] *= -1.0
        # A hinge's axis is that of a turn, which a mirror turns round: then reflections move as mirror images.
        for row, each in enumerate(self.cubes):
            vectors[across if each.joint["type"] == "hinge" else along, row, _AXIS] *= -1.0
        return _Branch(list(images.values()), vectors, turns, dict(self.last))

    def clashes(self, beside: _Branch) -> dict[str, int]:
        """Returns the shifts of the numbers of its parts that make every name in both branches unique."""
        if self.last.keys().isdisjoint(beside.last):
            return {}
        taken = {each.key for each in beside.cubes}
        clashing = {each.part["id"] for each in self.cubes if each.part["id"] in beside.last and each.key in taken}
        return {part: beside.last[part] for part in clashing}

    def renumber(self, shifts: Mapping[str, int]) -> None:
        """Shifts the numbers of some parts."""
        if shifts:
            for each in self.cubes:
                each.number += shifts.get(each.part["id"], 0)
            for part, shift in shifts.items():
                self.last[part] += shift

    def add(self, other: _Branch) -> None:
        """Lets another branch grow on the first cube."""
        other.cubes[0].parent = self.cubes[0]
        self.cubes += other.cubes
        self.vectors = np.concatenate([self.vectors, other.vectors], axis=1)
        self.turns = np.concatenate([self.turns, other.turns], axis=1)
        for part, number in other.last.items():
            self.last[part] = max(number, self.last.get(part, 0))


def grow(graph: JsonObject) -> dict[str, Any]:
    """Grows a graph that its schema has accepted; returns a body of `cubes` and `joints`, as a document has them.

    Raises:
        DocumentError: It names parts that are not there, or grows into more than `MOST_CUBES` cubes, or into one of a
            size that none may have.
    """
    grown = _Plant(graph).grow(graph["root"], 1.0, {})
    places, turns = grown.vectors[:, :, _POSITION].T.tolist(), grown.turns.T.tolist()
    lowest = min(map(_lowest, grown.cubes, places, turns))
    grown.shift((0.0, -lowest, 0.0))
    vectors = grown.vectors.transpose(1, 2, 0).tolist()
    return {
        "cubes": [
            _cube(each, rows[_POSITION], turn) for each, rows, turn in zip(grown.cubes, vectors, turns, strict=True)
        ],
        "joints": [
            _joint(each, each.parent, rows[_ANCHOR], rows[_AXIS])
            for each, rows in zip(grown.cubes, vectors, strict=True)
            if each.parent is not None
        ],
    }


@dataclass(slots=True)
class _Plant:
    """One graph while it grows."""

    graph: JsonObject
    parts: dict[str, JsonObject] = field(init=False)
    growing: dict[str, list[JsonObject]] = field(init=False)  # connections by the part that they begin at
    count: int = 0

    def __post_init__(self) -> None:
        graph = self.graph
        self.parts = {part["id"]: part for part in graph["parts"]}
        self.growing = {name: [] for name in self.parts}
        problems = []
        for i, part in enumerate(graph["parts"]):
            problem = misfit(part.get("shape", "box"), _edges(part))
            if problem is not None:
                problems.append((f"body/graph/parts/{i}/size", f"part {part['id']!r}: {problem}"))
        if len(self.parts) < len(graph["parts"]):
            seen: set[str] = set()
            for i, part in enumerate(graph["parts"]):
                if part["id"] in seen:
                    problems.append((f"body/graph/parts/{i}/id", f"there is a part {part['id']!r} already"))
                seen.add(part["id"])
        places = [("body/graph/root", graph["root"])]
        for i, connection in enumerate(graph.get("connections", ())):
            places += [(f"body/graph/connections/{i}/{end}", connection[end]) for end in ("from", "to")]
            self.growing.setdefault(connection["from"], []).append(connection)
        nowhere: dict[str, list[str]] = {}
        for path, name in places:
            if name not in self.parts:
                nowhere.setdefault(name, []).append(path)
        for name, (first, *others) in nowhere.items():
            problems.append((first, f"there is no part {name!r}{nor_at(others)}{did_you_mean(name, self.parts)}"))
        if problems:
            raise DocumentError(problems)

    def grow(self, name: str, scale: float, before: Mapping[str, int]) -> _Branch:
        """Grows a part and all that grows on it, in the frame of the middle of its -x face.

        Args:
            name: The part.
            scale: How much larger than the graph says.
            before: How often each part has been grown on the way here.
        """
        part = self.parts[name]
        self._add(1, name)
        way = {**before, name: before.get(name, 0) + 1}
        _bound(part, scale, way[name])
        half = tuple(edge * scale / 2.0 for edge in _edges(part))
        middle = (half[0], 0.0, 0.0)
        cube = _Grown(part, scale)
        axis = cube.joint.get("axis", _DEFAULT_AXIS.get(cube.joint["type"], (1.0, 0.0, 0.0)))
        vectors = np.array([middle, ZERO, axis], float).T[:, np.newaxis]
        grown = _Branch([cube], vectors, np.array(UPRIGHT)[:, np.newaxis], {name: 1})
        ended = way[name] >= part.get("recursive_limit", 1)
        for connection in self.growing[name]:
            child = connection["to"]
            if way.get(child, 0) >= self.parts[child].get("recursive_limit", 1):
                continue
            if connection.get("terminal", False) and not ended:
                continue
            branch = self.grow(child, scale * float(connection.get("scale", 1.0)), way)
            place, turn = _place(connection, (half[0], half[1], half[2]))
            branch.carry(place, turn)  # now as seen from the middle of this part
            sides = [branch]
            if "mirror" in connection:
                self._add(len(branch.cubes), name)
                sides.append(branch.reflected("xyz".index(connection["mirror"])))
            shifts = branch.clashes(grown)  # for both sides, so that a reflection has the number of what it reflects
            for side in sides:
                side.renumber(shifts)
                if side is not branch:
                    side.renumber(side.clashes(grown))
                side.shift(middle)
                grown.add(side)
        return grown

    def _add(self, count: int, name: str) -> None:
        self.count += count
        if self.count > MOST_CUBES:
            message = f"grows into more than {MOST_CUBES} cubes, by way of part {name!r}: lower a recursive_limit"
            raise DocumentError([("body/graph", message)])


def _bound(part: JsonObject, scale: float, times: int) -> None:
    """Refuses a cube of a size that none may have, before more grows on it."""
    edges = _rounded([edge * scale for edge in _edges(part)])
    worst = max(edges) if max(edges) > _LARGEST else min(edges)
    if not _SMALLEST <= worst <= _LARGEST:
        words = f"grows part {part['id']!r}, {times} times over, to an edge of {worst:.3g} m"
        raise DocumentError([("body/graph", f"{words}; it must be from {_SMALLEST:g} to {_LARGEST:g} m")])


def _place(connection: JsonObject, half: Vector) -> tuple[Vector, Quaternion]:
    """Returns where a connection attaches, from the middle of the parent, and how the child is turned there."""
    face = connection["face"]
    normal = "xyz".index(face[1])
    place = [0.0, 0.0, 0.0]
    place[normal] = half[normal] if face[0] == "+" else -half[normal]
    for axis, part in zip((a for a in range(3) if a != normal), connection.get("at", (0.0, 0.0)), strict=True):
        place[axis] = float(part) * half[axis]
    turn = [float(each) for each in connection.get("rotation", ZERO)]
    own = quaternion_from_euler(*turn) if len(turn) == 3 else normalize((turn[0], turn[1], turn[2], turn[3]))
    return (place[0], place[1], place[2]), multiply(_AWAY[face], own)


def _cube(grown: _Grown, position: Sequence[float], turn: Sequence[float]) -> dict[str, Any]:
    part, size = grown.part, [edge * grown.scale for edge in _edges(grown.part)]
    return {
        "id": grown.name,
        "size": _rounded(size),
        "mass": round(_mass(part, size), _DIGITS),
        "position": _rounded(position),
        "rotation": _rounded(turn),
        **{name: part[name] for name in ("shape", "friction", "restitution", "color", "group") if name in part},
    }


def _mass(part: JsonObject, size: Sequence[float]) -> float:
    density, shape = float(part.get("density", 500.0)), part.get("shape", "box")
    if shape == "box":
        return density * size[0] * size[1] * size[2]
    return density * volume(shape, (size[0], size[1], size[2]))


def _joint(grown: _Grown, parent: _Grown, anchor: Sequence[float], axis: Sequence[float]) -> dict[str, Any]:
    document, scale = grown.joint, grown.scale
    kind = document["type"]
    joint: dict[str, Any] = {
        "id": grown.name,
        "cube1": parent.name,
        "cube2": grown.name,
        "type": kind,
        "anchor": _rounded(anchor),
    }
    if kind in _DEFAULT_AXIS:
        joint["axis"] = _rounded(axis)
    # Positions of a slide are lengths. Efforts go with weight (and, about a hinge, with the arm), so that what is
    # grown at another scale can move itself as well.
    length = scale if kind == "slide" else 1.0
    effort = scale**3 if kind == "slide" else scale**4
    if "limits" in document:
        joint["limits"] = _rounded([length * float(limit) for limit in document["limits"]])
    for name in ("stiffness", "damping"):
        if name in document:
            joint[name] = round(effort * float(document[name]), _DIGITS)
    if "motor" in document:
        motor = document["motor"]
        joint["motor"] = {
            "mode": motor["mode"],
            "range": _rounded([length * float(end) for end in motor["range"]]),
            "max_effort": round(effort * float(motor["max_effort"]), _DIGITS),
            **({"flaws": motor["flaws"]} if "flaws" in motor else {}),  # of outputs of the brain: alike at any scale
        }
    return joint


def _lowest(grown: _Grown, position: Vector, turn: Quaternion) -> float:
    half = [edge * grown.scale / 2.0 for edge in _edges(grown.part)]
    axes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    reach = total(abs(rotate(turn, axis)[1]) * h for axis, h in zip(axes, half, strict=True))
    return position[1] - reach


def _edges(part: JsonObject) -> tuple[float, float, float]:
    size = part["size"]
    x, y, z = size if isinstance(size, Sequence) else (size, size, size)
    return float(x), float(y), float(z)


def _rounded(values: Sequence[float]) -> list[float]:
    return [round(value, _DIGITS) + 0.0 for value in values]  # 0.0 and -0.0 are one
