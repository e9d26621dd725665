"""Generative bodies: a directed graph of parts grows into cubes and joints, in the manner of Sims.

After K. Sims, "Evolving Virtual Creatures" (SIGGRAPH 1994): parts may be grown again and again along the cycles of the
graph, up to a limit; connections say where on the parent and how turned and scaled a part grows, whether it is
reflected, and whether it grows only at the end of a chain.

Hides frames: each part grows along its own +x, away from the face that it stands on, and a reflection has all that
grows with the first. Invariants: growth is a function of the graph alone, in plain floats rounded to 1e-9, so that the
body written out is the body grown; it stops, with an error, before it has more cubes than a body may have; the lowest
corner of the body is at y = 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import sqrt
from typing import Any

from nmes.backend import Quaternion, Vector
from nmes.backend.rotation import multiply, normalize, plus, quaternion_from_euler, rotate
from nmes.errors import DocumentError

__all__ = ["MOST_CUBES", "grow"]

MOST_CUBES = 256
"""How many cubes a body may have."""

JsonObject = Mapping[str, Any]

ZERO: Vector = (0.0, 0.0, 0.0)
UPRIGHT: Quaternion = (0.0, 0.0, 0.0, 1.0)
_QUARTER = sqrt(0.5)
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


@dataclass(frozen=True, slots=True)
class _Name:
    """The name of a grown cube: the `number`-th of a part, or that one's reflection."""

    part: str
    number: int = 1
    mirrored: bool = False

    def __str__(self) -> str:
        return self.part + (f".{self.number}" if self.number > 1 else "") + (".mirror" if self.mirrored else "")


@dataclass(frozen=True, slots=True)
class _Grown:
    """One cube and the joint by which it hangs on its parent, in the frame of the part that grows now."""

    name: _Name
    part: JsonObject
    scale: float
    position: Vector
    quaternion: Quaternion
    anchor: Vector = ZERO
    axis: Vector = ZERO
    parent: _Name | None = None

    def carried(self, shift: Vector, turn: Quaternion) -> _Grown:
        """Returns the same cube, seen from a frame in which this one's is shifted and turned."""
        return replace(
            self,
            position=plus(rotate(turn, self.position), shift),
            quaternion=multiply(turn, self.quaternion),
            anchor=plus(rotate(turn, self.anchor), shift),
            axis=rotate(turn, self.axis),
        )

    def reflected(self, axis: int) -> _Grown:
        """Returns the mirror image across the plane through the origin that an axis is normal to."""
        x, y, z, w = self.quaternion
        turned = [-x, -y, -z]
        turned[axis] = -turned[axis]
        # A hinge's axis is that of a turn, which a mirror turns round: then reflections move as mirror images.
        about = [-part for part in self.axis] if self._kind == "hinge" else list(self.axis)
        about[axis] = -about[axis]
        parent = self.parent
        return replace(
            self,
            name=replace(self.name, mirrored=not self.name.mirrored),
            parent=None if parent is None else replace(parent, mirrored=not parent.mirrored),
            position=_across(self.position, axis),
            quaternion=(turned[0], turned[1], turned[2], w),
            anchor=_across(self.anchor, axis),
            axis=(about[0], about[1], about[2]),
        )

    @property
    def _kind(self) -> str:
        return str(self.part.get("joint", {"type": "fixed"})["type"])

    def renamed(self, shifts: Mapping[str, int]) -> _Grown:
        """Returns the same cube with the numbers of some parts shifted."""

        def shifted(name: _Name) -> _Name:
            return replace(name, number=name.number + shifts.get(name.part, 0))

        return replace(self, name=shifted(self.name), parent=None if self.parent is None else shifted(self.parent))


def grow(graph: JsonObject) -> dict[str, Any]:
    """Grows a graph that its schema has accepted; returns a body of `cubes` and `joints`, as a document has them.

    Raises:
        DocumentError: It names parts that are not there, or grows into more than `MOST_CUBES` cubes.
    """
    plant = _Plant(graph)
    grown = plant.grow(graph["root"], 1.0, {})
    lowest = min(_lowest(each) for each in grown)
    grown = [each.carried((0.0, -lowest, 0.0), UPRIGHT) for each in grown]
    return {
        "cubes": [_cube(each) for each in grown],
        "joints": [_joint(each) for each in grown if each.parent is not None],
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
        problems += [(path, f"there is no part {name!r}") for path, name in places if name not in self.parts]
        if problems:
            raise DocumentError(problems)

    def grow(self, name: str, scale: float, before: Mapping[str, int]) -> list[_Grown]:
        """Grows a part and all that grows on it, in the frame of the middle of its -x face.

        Args:
            name: The part.
            scale: How much larger than the graph says.
            before: How often each part has been grown on the way here.
        """
        self.count += 1
        self._bound(name)
        part = self.parts[name]
        way = {**before, name: before.get(name, 0) + 1}
        half = tuple(edge * scale / 2.0 for edge in _edges(part))
        middle = (half[0], 0.0, 0.0)
        joint = part.get("joint", {"type": "fixed"})
        axis = tuple(map(float, joint.get("axis", _DEFAULT_AXIS.get(joint["type"], (1.0, 0.0, 0.0)))))
        grown = [_Grown(_Name(name), part, scale, middle, UPRIGHT, ZERO, (axis[0], axis[1], axis[2]))]
        ended = way[name] >= part.get("recursive_limit", 1)
        for connection in self.growing[name]:
            child = connection["to"]
            if way.get(child, 0) >= self.parts[child].get("recursive_limit", 1):
                continue
            if connection.get("terminal", False) and not ended:
                continue
            branch = self.grow(child, scale * float(connection.get("scale", 1.0)), way)
            place, turn = _place(connection, (half[0], half[1], half[2]))
            branch = [each.carried(place, turn) for each in branch]  # now as seen from the middle of this part
            reflections = []
            if "mirror" in connection:
                self.count += len(branch)
                self._bound(name)
                reflections = [each.reflected("xyz".index(connection["mirror"])) for each in branch]
            shifts = _free(grown, branch)
            for side in (branch, reflections):
                side = [each.renamed(shifts) for each in side]
                further = _free(grown, side)
                side = [each.renamed(further).carried(middle, UPRIGHT) for each in side]
                grown += [replace(side[0], parent=grown[0].name), *side[1:]] if side else []
        return grown

    def _bound(self, name: str) -> None:
        if self.count > MOST_CUBES:
            message = f"grows into more than {MOST_CUBES} cubes, by way of part {name!r}: lower a recursive_limit"
            raise DocumentError([("body/graph", message)])


def _free(grown: Sequence[_Grown], branch: Sequence[_Grown]) -> dict[str, int]:
    """Returns the shifts of the numbers of a branch's parts that keep every name unique."""
    taken = {each.name for each in grown}
    clashing = {each.name.part: None for each in branch if each.name in taken}
    return {part: max(each.name.number for each in grown if each.name.part == part) for part in clashing}


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


def _cube(grown: _Grown) -> dict[str, Any]:
    part, size = grown.part, [edge * grown.scale for edge in _edges(grown.part)]
    return {
        "id": str(grown.name),
        "size": _rounded(size),
        "mass": round(float(part.get("density", 500.0)) * size[0] * size[1] * size[2], _DIGITS),
        "position": _rounded(grown.position),
        "rotation": _rounded(grown.quaternion),
        **{name: part[name] for name in ("friction", "restitution", "color") if name in part},
    }


def _joint(grown: _Grown) -> dict[str, Any]:
    document, kind, scale = grown.part.get("joint", {"type": "fixed"}), grown._kind, grown.scale
    joint: dict[str, Any] = {
        "id": str(grown.name),
        "cube1": str(grown.parent),
        "cube2": str(grown.name),
        "type": kind,
        "anchor": _rounded(grown.anchor),
    }
    if kind in _DEFAULT_AXIS:
        joint["axis"] = _rounded(grown.axis)
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
        }
    return joint


def _lowest(grown: _Grown) -> float:
    half = [edge * grown.scale / 2.0 for edge in _edges(grown.part)]
    axes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    reach = sum(abs(rotate(grown.quaternion, axis)[1]) * h for axis, h in zip(axes, half, strict=True))
    return grown.position[1] - reach


def _edges(part: JsonObject) -> tuple[float, float, float]:
    size = part["size"]
    x, y, z = size if isinstance(size, Sequence) else (size, size, size)
    return float(x), float(y), float(z)


def _rounded(values: Sequence[float]) -> list[float]:
    return [round(value, _DIGITS) + 0.0 for value in values]  # 0.0 and -0.0 are one


def _across(v: Vector, axis: int) -> Vector:
    mirrored = list(v)
    mirrored[axis] = -mirrored[axis]
    return (mirrored[0], mirrored[1], mirrored[2])
