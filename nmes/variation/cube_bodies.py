"""How bodies of cubes and joints are changed: each function makes one small change to a `body`, in place.

Hides the tree that hangs on the root, and the geometry by which what hangs on a cube goes along when it moves. Each
returns False where the body has nothing that it could change. What comes out fits its schema and stands where the body
stood, but may overlap, or may not meet the requirements: whoever mutates looks and draws again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import pi
from typing import Final

import numpy as np

from nmes.backend import Array, Quaternion
from nmes.backend.rotation import conjugate, multiply, quaternion_from_euler, rotate
from nmes.backend.shapes import Shape, volume
from nmes.genome.body import Body, BodyCube, BodyJoint, corners, read_cube
from nmes.schemas.documents import JsonObject
from nmes.variation.draw import Draw
from nmes.variation.joints import CHANGES_OF_JOINTS, JointChange, draw_joint
from nmes.variation.shapes import fit

__all__ = ["CHANGES", "graft", "stand"]

_Change = Callable[[JsonObject, Body, Draw, bool], bool]

_MOST_CUBES, _MOST_JOINTS = 256, 512
_SMALLEST, _LARGEST = 0.02, 5.0  # m: edges that are drawn; a schema allows more
_LIGHTEST, _HEAVIEST = 0.001, 10_000.0  # kg


@dataclass(frozen=True, slots=True)
class _Limb:
    """A cube and all that hangs on it.

    Attributes:
        root: The cube.
        joint: By which it hangs on another cube.
        parent: That cube.
        cubes: Its ids, the root's among them.
    """

    root: BodyCube
    joint: BodyJoint
    parent: BodyCube
    cubes: frozenset[str]


def _limbs(body: Body) -> list[_Limb]:
    """Returns each cube but the body's root as a limb: the tree is what a walk from the root meets first."""
    cubes = {cube.id: cube for cube in body.cubes}
    ways: dict[str, list[tuple[BodyJoint, str]]] = {name: [] for name in cubes}
    for joint in body.joints:
        ways[joint.cube1].append((joint, joint.cube2))
        ways[joint.cube2].append((joint, joint.cube1))
    hangs: dict[str, tuple[BodyJoint, str]] = {}
    order = [body.cubes[0].id]
    for name in order:
        for joint, other in ways[name]:
            if other not in hangs and other != order[0]:
                hangs[other] = joint, name
                order.append(other)
    members: dict[str, set[str]] = {name: {name} for name in order}
    for name in reversed(order[1:]):
        members[hangs[name][1]] |= members[name]
    return [_Limb(cubes[name], hangs[name][0], cubes[hangs[name][1]], frozenset(members[name])) for name in order[1:]]


def _place(values: Iterable[float]) -> list[float]:
    return [round(min(max(float(value), -1000.0), 1000.0), 9) + 0.0 for value in values]


def _edge(value: float) -> float:
    return round(min(max(value, _SMALLEST), _LARGEST), 6)


def _mass(value: float) -> float:
    return round(min(max(value, _LIGHTEST), _HEAVIEST), 9)


def _turned(turn: Quaternion, vector: Iterable[float]) -> Array:
    x, y, z = vector
    return np.array(rotate(turn, (float(x), float(y), float(z))))


def _fresh(body: JsonObject, name: str) -> str:
    """Returns an id that neither a cube nor a joint has: the name, or with the lowest free number behind it."""
    taken = {each["id"] for kind in ("cubes", "joints") for each in body[kind]}
    stem, number, free = name[:56], 1, name
    while free in taken:
        number += 1
        free = f"{stem}.{number}"
    return free


def stand(body: JsonObject, before: Body) -> None:
    """Lifts or lowers a whole body to where its lowest point was."""
    lowest = min(float(corners(read_cube(cube))[:, 1].min()) for cube in body["cubes"])
    by = np.array([0.0, before.bounds[0][1] - lowest, 0.0])
    for cube in body["cubes"]:
        cube["position"] = _place(cube["position"] + by)
    for joint in body["joints"]:
        joint["anchor"] = _place(joint["anchor"] + by)


def _shift(body: JsonObject, cubes: frozenset[str], by: Array) -> None:
    """Moves cubes, and the anchors of the joints between them."""
    for cube in body["cubes"]:
        if cube["id"] in cubes:
            cube["position"] = _place(cube["position"] + by)
    for joint in body["joints"]:
        if joint["cube1"] in cubes and joint["cube2"] in cubes:
            joint["anchor"] = _place(joint["anchor"] + by)


def _find(body: JsonObject, kind: str, name: str) -> JsonObject:
    found: JsonObject = next(each for each in body[kind] if each["id"] == name)
    return found


def _add_part(body: JsonObject, before: Body, draw: Draw, planar: bool) -> bool:
    """Hangs a new cube on a face of one that is there."""
    if len(body["cubes"]) >= _MOST_CUBES or len(body["joints"]) >= _MOST_JOINTS:
        return False
    parent = draw.one_of(before.cubes)
    axis, sign = draw.count(0, 1 if planar else 2), draw.one_of((-1.0, 1.0))
    size = np.array([_edge(edge * draw.uniform(0.3, 1.1)) for edge in parent.size])
    local = np.array([draw.uniform(-0.4, 0.4) for _ in range(3)]) * parent.size
    local[axis] = sign * parent.size[axis] / 2.0
    if planar:
        local[2] = 0.0
    outward = np.array([sign * size[i] / 2.0 if i == axis else 0.0 for i in range(3)])
    anchor = parent.position + _turned(parent.quaternion, local)
    name, volume = _fresh(body, "part"), float(np.prod(parent.size))
    cube: JsonObject = {"id": name, "size": size.tolist(), "mass": _mass(parent.mass / volume * float(size.prod()))}
    cube["position"] = _place(anchor + _turned(parent.quaternion, outward))
    if parent.quaternion != (0.0, 0.0, 0.0, 1.0):
        cube["rotation"] = list(parent.quaternion)
    joint = {"id": name, "cube1": parent.id, "cube2": name, "anchor": _place(anchor)}
    joint |= draw_joint(draw, before.mass, float(size.max()), planar)
    body["cubes"].append(cube)
    body["joints"].append(joint)
    stand(body, before)
    return True


def _remove_part(body: JsonObject, before: Body, draw: Draw, planar: bool) -> bool:
    """Takes a limb away, rather a small one."""
    limbs = _limbs(before)
    if not limbs:
        return False
    gone = draw.one_of(limbs, [1.0 / len(limb.cubes) for limb in limbs]).cubes
    _cut(body, gone)
    stand(body, before)
    return True


def _cut(body: JsonObject, gone: frozenset[str]) -> None:
    """Takes cubes away, with the joints that hold them."""
    body["cubes"] = [cube for cube in body["cubes"] if cube["id"] not in gone]
    body["joints"] = [joint for joint in body["joints"] if not {joint["cube1"], joint["cube2"]} & gone]


def _resize_part(body: JsonObject, before: Body, draw: Draw, planar: bool) -> bool:
    """Changes the edges of a cube about the joint that it hangs on; what hangs on it goes along."""
    chosen = draw.one_of(before.cubes)
    limbs = _limbs(before)
    hung = next((limb for limb in limbs if limb.root.id == chosen.id), None)
    pivot = np.array(chosen.position if hung is None else hung.joint.anchor)
    whole, alike = draw.factor(0.25), draw.chance(0.4)
    wanted = [_edge(edge * (whole if alike else draw.factor(0.25))) for edge in chosen.size]
    if chosen.shape != "box":
        wanted = fit(chosen.shape, wanted)
    factors = np.array(wanted) / chosen.size

    def scaled(point: Iterable[float]) -> Array:
        local = _turned(conjugate(chosen.quaternion), np.array(list(point)) - pivot)
        return pivot + _turned(chosen.quaternion, local * factors)

    cube = _find(body, "cubes", chosen.id)
    larger = float(factors.prod()) if chosen.shape == "box" else _volume(chosen.shape, wanted) / chosen.volume
    cube |= {"size": wanted, "mass": _mass(chosen.mass * larger)}
    cube["position"] = _place(scaled(chosen.position))
    for limb in limbs:
        if limb.parent.id == chosen.id:
            anchor = scaled(limb.joint.anchor)
            _shift(body, limb.cubes, anchor - limb.joint.anchor)
            _find(body, "joints", limb.joint.id)["anchor"] = _place(anchor)
    stand(body, before)
    return True


def _volume(shape: Shape, size: Sequence[float]) -> float:
    return volume(shape, (size[0], size[1], size[2]))


def _move_part(body: JsonObject, before: Body, draw: Draw, planar: bool) -> bool:
    """Shifts a limb over the cube that it hangs on, or turns it about its joint."""
    limbs = _limbs(before)
    if not limbs:
        return False
    limb = draw.one_of(limbs)
    if draw.chance(0.5):
        shift = np.array([draw.normal(0.15) for _ in range(3)]) * limb.parent.size
        if planar:
            shift[2] = 0.0
        by = _turned(limb.parent.quaternion, shift)
        _shift(body, limb.cubes, by)
        _find(body, "joints", limb.joint.id)["anchor"] = _place(limb.joint.anchor + by)
    else:
        angles = [0.0, 0.0, draw.normal(0.3)] if planar else [draw.normal(0.3) for _ in range(3)]
        _turn(body, before, limb, quaternion_from_euler(*angles))
    stand(body, before)
    return True


def _turn(body: JsonObject, before: Body, limb: _Limb, turn: Quaternion) -> None:
    """Turns a limb about the anchor by which it hangs."""
    pivot = np.array(limb.joint.anchor)
    for cube in before.cubes:
        if cube.id in limb.cubes:
            place = _place(pivot + _turned(turn, cube.position - pivot))
            _find(body, "cubes", cube.id).update(position=place, rotation=list(multiply(turn, cube.quaternion)))
    for joint in before.joints:
        if joint.cube1 in limb.cubes and joint.cube2 in limb.cubes:
            entry = _find(body, "joints", joint.id)
            entry["anchor"] = _place(pivot + _turned(turn, joint.anchor - pivot))
            _aim(entry, joint, lambda axis: _turned(turn, axis))


def _aim(entry: JsonObject, joint: BodyJoint, turned: Callable[[Array], Array]) -> None:
    """Turns a joint's axis, which may be that of its kind; that of a cone leads from cube to cube by itself."""
    axis = joint.axis or {"hinge": (0.0, 0.0, 1.0), "slide": (1.0, 0.0, 0.0)}.get(joint.kind)
    if axis is not None:
        entry["axis"] = _place(turned(np.array(axis)))


def _of_joints(change: JointChange) -> _Change:
    """Returns the change of a body that changes one of its joints."""

    def changed(body: JsonObject, before: Body, draw: Draw, planar: bool) -> bool:
        if not before.joints:
            return False
        chosen = draw.one_of(before.joints)
        moved = next(cube for cube in before.cubes if cube.id == chosen.cube2)
        return change(_find(body, "joints", chosen.id), draw, before.mass, max(moved.size), planar)

    return changed


def _symmetry(body: JsonObject, before: Body, draw: Draw, planar: bool) -> bool:
    """Gives a limb a mirror image, across a middle plane of the cube that it hangs on."""
    limbs = _limbs(before)
    if not limbs:
        return False
    limb = draw.one_of(limbs)
    axis = draw.count(0, 1) if planar else draw.one_of((2, 2, 0, 1))
    normal = _turned(limb.parent.quaternion, [1.0 if i == axis else 0.0 for i in range(3)])
    if len(body["cubes"]) + len(limb.cubes) > _MOST_CUBES or 2 * len(body["joints"]) > _MOST_JOINTS:
        return False

    def mirrored(vector: Array) -> Array:
        return np.asarray(vector - 2.0 * float((vector * normal).sum()) * normal)

    def opposite(vector: Array) -> Array:
        return -mirrored(vector)

    centre, names = np.array(limb.parent.position), {limb.parent.id: limb.parent.id}
    for cube in before.cubes:
        if cube.id in limb.cubes:
            names[cube.id] = _fresh(body, f"{cube.id}.mirror"[:64])
            x, y, z, w = cube.quaternion
            turn = -mirrored(np.array([x, y, z]))  # the axis of a turn is one that a mirror turns round
            place = _place(centre + mirrored(cube.position - centre))
            entry = {**_find(body, "cubes", cube.id), "id": names[cube.id], "position": place}
            body["cubes"].append({**entry, "rotation": [*turn.tolist(), w]})
    for joint in before.joints:
        if joint.cube1 in names and joint.cube2 in names and {joint.cube1, joint.cube2} & limb.cubes:
            ends = {"cube1": names[joint.cube1], "cube2": names[joint.cube2]}
            anchor = _place(centre + mirrored(joint.anchor - centre))
            entry = {**_find(body, "joints", joint.id), "id": _fresh(body, f"{joint.id}.mirror"[:64])}
            # A hinge's axis is that of a turn, which a mirror turns round: then both sides move as mirror images.
            _aim(entry, joint, opposite if joint.kind == "hinge" else mirrored)
            body["joints"].append({**entry, **ends, "anchor": anchor})
    stand(body, before)
    return True


def graft(body: JsonObject, before: Body, donor: JsonObject, donor_body: Body, draw: Draw) -> dict[str, str]:
    """Hangs a limb of another body on a cube of this one: in the place of a limb, or as it hung on its own.

    Args:
        body: Is changed.
        before: The same, read.
        donor: The other.
        donor_body: The other, read.
        draw: The choices.

    Returns:
        The ids in the donor of the joints that were taken, each with its id here; empty where there was no room.
    """
    limbs, own = _limbs(donor_body), _limbs(before)
    if not limbs:
        return {}
    limb, side = draw.one_of(limbs), quaternion_from_euler(0.0, draw.count(0, 3) * pi / 2.0, 0.0)
    local = _turned(conjugate(limb.parent.quaternion), np.array(limb.joint.anchor) - limb.parent.position)
    if own and draw.chance(0.6):
        gone = draw.one_of(own)
        _cut(body, gone.cubes)
        place, anchor = gone.parent, np.array(gone.joint.anchor)
    else:
        place = draw.one_of(before.cubes)
        anchor = place.position + _turned(place.quaternion, _turned(side, local / limb.parent.size) * place.size)
    turn = multiply(multiply(place.quaternion, side), conjugate(limb.parent.quaternion))
    inner = [each for each in donor_body.joints if each.cube1 in limb.cubes and each.cube2 in limb.cubes]
    room = len(body["cubes"]) + len(limb.cubes) <= _MOST_CUBES
    if not room or len(body["joints"]) + len(inner) >= _MOST_JOINTS:
        return {}

    def moved(point: Iterable[float]) -> list[float]:
        return _place(anchor + _turned(turn, np.array(list(point)) - limb.joint.anchor))

    cubes, taken = {limb.parent.id: place.id}, {}
    for cube in donor_body.cubes:
        if cube.id in limb.cubes:
            cubes[cube.id] = _fresh(body, cube.id)
            entry = {**_find(donor, "cubes", cube.id), "id": cubes[cube.id], "position": moved(cube.position)}
            body["cubes"].append({**entry, "rotation": list(multiply(turn, cube.quaternion))})
    for joint in (limb.joint, *inner):
        taken[joint.id] = _fresh(body, joint.id)
        entry = {**_find(donor, "joints", joint.id), "id": taken[joint.id], "anchor": moved(joint.anchor)}
        _aim(entry, joint, lambda axis: _turned(turn, axis))
        body["joints"].append({**entry, "cube1": cubes[joint.cube1], "cube2": cubes[joint.cube2]})
    stand(body, before)
    return taken


CHANGES: Final[Mapping[str, _Change]] = {
    "add-part": _add_part,
    "remove-part": _remove_part,
    "resize-part": _resize_part,
    "move-part": _move_part,
    **{name: _of_joints(change) for name, change in CHANGES_OF_JOINTS.items()},
    "symmetry": _symmetry,
}
"""The changes of a body by name: functions of the body as a document, the body as it was read, a draw,
and whether they must stay in the plane z = 0."""
