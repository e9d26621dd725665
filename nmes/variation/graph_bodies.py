"""How graphs of parts are changed: each function makes one small change to a body's `graph`, in place.

The kinds of change are those of K. Sims, "Evolving Virtual Creatures" (SIGGRAPH 1994): parts and connections come, go
and change their numbers; a connection is mirrored or not; a part may be grown again. Each returns False where the
graph has nothing that it could change. What comes out fits its schema, but may grow into a body that overlaps, is too
large, or may not meet the requirements: whoever mutates looks and draws again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from nmes.genome.body import PALETTE, Body
from nmes.schemas.documents import JsonObject
from nmes.variation.draw import Draw
from nmes.variation.joints import CHANGES_OF_JOINTS, JointChange, draw_joint
from nmes.variation.shapes import fit

__all__ = ["CHANGES", "graft", "prune"]

_Change = Callable[[JsonObject, Body, Draw, bool], bool]

_FACES: Final = ("+x", "-x", "+y", "-y", "+z", "-z")
_MOST_PARTS, _MOST_CONNECTIONS = 64, 256
_SMALLEST, _LARGEST = 0.02, 5.0  # m: edges that are drawn; a schema allows more
_MOST_TIMES = 8  # how often a part is grown, at most


def _edges(part: JsonObject) -> list[float]:
    size = part["size"]
    return [float(edge) for edge in size] if isinstance(size, list) else [float(size)] * 3


def _edge(value: float) -> float:
    return round(min(max(value, _SMALLEST), _LARGEST), 6)


def _fresh(graph: JsonObject, stem: str = "part") -> str:
    """Returns an id that no part of a graph has: of the same stem, with the lowest free number."""
    taken = {part["id"] for part in graph["parts"]}
    number = 1
    while f"{stem}{number}" in taken:
        number += 1
    return f"{stem}{number}"


def _connection(parent: str, child: str, draw: Draw, planar: bool) -> JsonObject:
    """Draws where a part grows on another."""
    faces = _FACES[:4] if planar else _FACES
    at = [round(draw.uniform(-0.8, 0.8), 6), 0.0 if planar else round(draw.uniform(-0.8, 0.8), 6)]
    connection: JsonObject = {"from": parent, "to": child, "face": draw.one_of(faces), "at": at}
    if draw.chance(0.3):
        connection["rotation"] = _rotation([0.0, 0.0, 0.0], 0.5, draw, planar)
    if draw.chance(0.4):
        connection["mirror"] = draw.one_of(("x", "y") if planar else ("z", "z", "x", "y"))
    return connection


def _rotation(angles: list[float], spread: float, draw: Draw, planar: bool) -> list[float]:
    turned = [round(min(max(angle + draw.normal(spread), -3.2), 3.2), 6) for angle in angles]
    return [0.0, 0.0, turned[2]] if planar else turned


def _add_part(graph: JsonObject, body: Body, draw: Draw, planar: bool) -> bool:
    """Lets a new part grow on one that is there, or one that is there on another."""
    if len(graph["connections"]) >= _MOST_CONNECTIONS:
        return False
    parent = draw.one_of(graph["parts"])
    if len(graph["parts"]) < _MOST_PARTS and draw.chance(0.85):
        size = [_edge(edge * draw.uniform(0.3, 1.1)) for edge in _edges(parent)]
        child: JsonObject = {"id": _fresh(graph), "size": size, "density": parent.get("density", 500.0)}
        child["joint"] = draw_joint(draw, body.mass, max(size), planar)
        if "color" in parent:
            child["color"] = list(PALETTE[len(graph["parts"]) % len(PALETTE)])
        graph["parts"].append(child)
    else:
        child = draw.one_of(graph["parts"])
        child.setdefault("joint", draw_joint(draw, body.mass, max(_edges(child)), planar))
    graph["connections"].append(_connection(parent["id"], child["id"], draw, planar))
    return True


def _remove_part(graph: JsonObject, body: Body, draw: Draw, planar: bool) -> bool:
    """Takes a connection away or, rather, a part with all that leads to it; and what no longer grows."""
    others = [part["id"] for part in graph["parts"] if part["id"] != graph["root"]]
    if not graph["connections"] or not others:
        return False
    if draw.chance(0.3):
        graph["connections"].remove(draw.one_of(graph["connections"]))
    else:
        gone = draw.one_of(others)
        graph["parts"] = [part for part in graph["parts"] if part["id"] != gone]
        graph["connections"] = [each for each in graph["connections"] if gone not in (each["from"], each["to"])]
    prune(graph)
    return True


def prune(graph: JsonObject) -> None:
    """Takes away the parts that nothing leads to from the root, and their connections."""
    reached, waiting = {graph["root"]}, [graph["root"]]
    while waiting:
        part = waiting.pop()
        new = {each["to"] for each in graph["connections"] if each["from"] == part} - reached
        reached |= new
        waiting += sorted(new)
    graph["parts"] = [part for part in graph["parts"] if part["id"] in reached]
    graph["connections"] = [each for each in graph["connections"] if each["from"] in reached]


def _resize_part(graph: JsonObject, body: Body, draw: Draw, planar: bool) -> bool:
    """Changes the edges of a part, all alike or one by one, or what it weighs."""
    part = draw.one_of(graph["parts"])
    if draw.chance(0.15):
        part["density"] = round(min(max(part.get("density", 500.0) * draw.factor(0.3), 50.0), 5000.0), 3)
        return True
    whole = draw.factor(0.25)
    part["size"] = [_edge(edge * (whole if draw.chance(0.5) else draw.factor(0.25))) for edge in _edges(part)]
    if "shape" in part:
        part["size"] = fit(part["shape"], part["size"])
    return True


def _move_part(graph: JsonObject, body: Body, draw: Draw, planar: bool) -> bool:
    """Changes where a part grows on another: the face, the place on it, its direction or its scale."""
    if not graph["connections"]:
        return False
    connection = draw.one_of(graph["connections"])
    what = draw.one_of(("at", "rotation", "face", "scale"), (0.4, 0.3, 0.15, 0.15))
    if what == "face":
        connection["face"] = draw.one_of(_FACES[:4] if planar else _FACES)
    elif what == "scale":
        scale = connection.get("scale", 1.0) * draw.factor(0.15)
        connection["scale"] = round(min(max(scale, 0.3), 3.0), 6)
    elif what == "rotation":
        angles = connection.get("rotation", [0.0, 0.0, 0.0])
        connection["rotation"] = _rotation(angles if len(angles) == 3 else [0.0, 0.0, 0.0], 0.3, draw, planar)
    else:
        moved = [round(min(max(part + draw.normal(0.25), -1.0), 1.0), 6) for part in connection.get("at", (0.0, 0.0))]
        connection["at"] = [moved[0], 0.0] if planar else moved
    return True


def _of_joints(change: JointChange) -> _Change:
    """Returns the change of a graph that changes the joint of one of its parts."""

    def changed(graph: JsonObject, body: Body, draw: Draw, planar: bool) -> bool:
        parts = [part for part in graph["parts"] if "joint" in part]
        if not parts:
            return False
        part = draw.one_of(parts)
        return change(part["joint"], draw, body.mass, max(_edges(part)), planar)

    return changed


def _symmetry(graph: JsonObject, body: Body, draw: Draw, planar: bool) -> bool:
    """Lets what grows at a connection be mirrored, or no longer, or across another plane."""
    if not graph["connections"]:
        return False
    connection = draw.one_of(graph["connections"])
    if "mirror" in connection and draw.chance(0.6):
        del connection["mirror"]
    else:
        connection["mirror"] = draw.one_of(("x", "y") if planar else ("x", "y", "z"))
    return True


def _recursion(graph: JsonObject, body: Body, draw: Draw, planar: bool) -> bool:
    """Changes how often a part is grown on itself, and what grows at the end of the chain alone."""
    part = draw.one_of(graph["parts"])
    itself = [each for each in graph["connections"] if each["from"] == each["to"] == part["id"]]
    times = part.get("recursive_limit", 1)
    if itself and draw.chance(0.2):
        others = [each for each in graph["connections"] if each["from"] == part["id"] and each not in itself]
        if others:
            connection = draw.one_of(others)
            connection["terminal"] = not connection.get("terminal", False)
            return True
    wanted = times + draw.one_of((-1, 1))
    if not 1 <= wanted <= _MOST_TIMES:
        return False
    part["recursive_limit"] = wanted
    if wanted > 1 and not itself:
        if len(graph["connections"]) >= _MOST_CONNECTIONS:
            return False
        part.setdefault("joint", draw_joint(draw, body.mass, max(_edges(part)), planar))
        graph["connections"].append(_connection(part["id"], part["id"], draw, planar))
    return True


def graft(graph: JsonObject, donor: JsonObject, draw: Draw) -> dict[str, str]:
    """Lets a part of another graph grow on this one, with all that grows on it there.

    Args:
        graph: Is changed.
        donor: The other graph.
        draw: The choices.

    Returns:
        The ids in the donor of what was taken, each with its id here; empty where there was no room.
    """
    connections = [each for each in donor["connections"] if each["to"] != donor["root"]]
    if not connections:
        return {}
    taken = draw.one_of(connections)
    limb: JsonObject = {"root": taken["to"], "parts": list(donor["parts"]), "connections": list(donor["connections"])}
    limb["connections"] = [each for each in limb["connections"] if each["to"] != donor["root"]]
    prune(limb)
    room = len(graph["parts"]) + len(limb["parts"]) <= _MOST_PARTS
    if not room or len(graph["connections"]) + len(limb["connections"]) >= _MOST_CONNECTIONS:
        return {}
    place = draw.one_of(graph["parts"])["id"]
    names: dict[str, str] = {}
    for part in limb["parts"]:
        known = {each["id"] for each in graph["parts"]}
        names[part["id"]] = part["id"] if part["id"] not in known else _fresh(graph)
        graph["parts"].append({**part, "id": names[part["id"]]})
    graph["connections"].append({**taken, "from": place, "to": names[taken["to"]]})
    graph["connections"] += [_renamed(each, names) for each in limb["connections"]]
    return names


def _renamed(connection: JsonObject, names: Mapping[str, str]) -> JsonObject:
    return {**connection, "from": names[connection["from"]], "to": names[connection["to"]]}


CHANGES: Final[Mapping[str, _Change]] = {
    "add-part": _add_part,
    "remove-part": _remove_part,
    "resize-part": _resize_part,
    "move-part": _move_part,
    **{name: _of_joints(change) for name, change in CHANGES_OF_JOINTS.items()},
    "symmetry": _symmetry,
    "recursion": _recursion,
}
"""The changes of a graph by name: functions of the graph, the body that it grows into, a draw,
and whether they must stay in the plane z = 0."""
