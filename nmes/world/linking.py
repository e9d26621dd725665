"""Joining many cubes by one command: neighbours in chains, and neighbours in space.

Hides which boxes count as neighbours, and how a command is judged as a whole before any joint is made: all of them are
made, or none. A joint made here is called after its cubes, `joint_<type>_<cube1>_<cube2>`, with a number behind it
where that name is taken; where it would be too long, a name is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from nmes import protocol
from nmes.backend import Array
from nmes.errors import WorldError
from nmes.schemas.documents import JsonObject
from nmes.world.entities import Cube, Entities

__all__ = ["MOST_CUBES", "MOST_LINKS", "link_chains", "link_neighbours"]

MOST_LINKS = 1000
"""How many joints one command makes at most."""
MOST_CUBES = 1000
"""How many cubes one command compares with each other at most."""
_LONGEST_NAME = 120  # characters, so that a number may follow
_OVERLAP = 0.1  # of an edge: how much of it two boxes must share to face each other

_Pairs = list[tuple[Cube, Cube]]


def link_chains(entities: Entities, command: JsonObject) -> list[str]:
    """Joins neighbours in each of the chains of a `link_cube_chains` command; returns the joints' names.

    Raises:
        WorldError: `cube_not_found`, `self_joint`, `limit_reached`, or as `Entities.connect`.
    """
    links = sum(len(chain) - 1 for chain in command["chains"])
    _require_few(links, MOST_LINKS, "joints", "chains")
    pairs: _Pairs = []
    for number, chain in enumerate(command["chains"]):
        cubes = [entities.cube(name, f"chains/{number}/{place}") for place, name in enumerate(chain)]
        for one, two in pairwise(cubes):
            if one is two:
                raise WorldError("self_joint", f"a joint needs two cubes; both are {one.name!r}", f"chains/{number}")
            pairs.append((one, two))
    return _link(entities, pairs, command, "chains")


def link_neighbours(entities: Entities, command: JsonObject) -> list[str]:
    """Joins those of the cubes of a `link_body_cubes` command that are near each other and not joined yet.

    Returns:
        The joints' names.

    Raises:
        WorldError: `cube_not_found`, `limit_reached`, or as `Entities.connect`.
    """
    prefix = command["prefix"]
    cubes = [cube for name, cube in entities.cubes.items() if name.startswith(prefix)]
    if not cubes:
        raise WorldError("cube_not_found", f"there is no cube whose name begins with {prefix!r}", "prefix")
    _require_few(len(cubes), MOST_CUBES, "cubes", "prefix")
    gap = float(command.get("gap", protocol.COMMANDS["link_body_cubes"].defaults["gap"]))
    near = _neighbours(entities, cubes, gap)
    pairs = [(one, two) for one, two in near if one.joints.keys().isdisjoint(two.joints)]
    _require_few(len(pairs), MOST_LINKS, "joints", "prefix")
    return _link(entities, pairs, command, "prefix")


def _require_few(count: int, most: int, what: str, path: str) -> None:
    if count > most:
        raise WorldError("limit_reached", f"{path}: {count:,} {what}, and one command has at most {most:,}", path)


def _link(entities: Entities, pairs: _Pairs, command: JsonObject, path: str) -> list[str]:
    """Joins pairs of cubes. What may fail does so before the first joint or with it."""
    entities.require_room(joints=len(pairs))
    entities.require_joinable(pairs, path)
    kind = command.get("joint_type", protocol.COMMANDS[command["type"]].defaults["joint_type"])
    about: JsonObject = {name: command[name] for name in ("joint_params", "notes") if name in command}
    names = []
    for one, two in pairs:
        joint: JsonObject = {"cube1": one.name, "cube2": two.name, **about}
        name = f"joint_{kind}_{one.name}_{two.name}"
        if len(name) <= _LONGEST_NAME:
            joint.update(joint_name=name, number_if_taken=True)
        names.append(entities.connect(joint, kind, "joint"))
    return names


def _neighbours(entities: Entities, cubes: Sequence[Cube], gap: float) -> _Pairs:
    """Returns the pairs of boxes that face each other at most `gap` (m) apart, in order of creation.

    Two boxes face each other where, seen along the axes of the older one, they overlap on at least two axes by a tenth
    of the shorter one there. So the diagonal neighbours in a grid do not.
    """
    states = entities.simulation.states([cube.body for cube in cubes])
    places, axes = states[:, :3], _own_axes(states[:, 3:7])
    halves = np.array([cube.size for cube in cubes]) / 2.0
    pairs: _Pairs = []
    for i, one in enumerate(cubes):
        gaps, deep = np.empty((2, 3, len(cubes) - i - 1))
        for axis in range(3):
            along = np.abs(_along(places[i + 1 :] - places[i], axes[i, axis]))
            a, b, c = (halves[i + 1 :, k] * np.abs(_along(axes[i + 1 :, k], axes[i, axis])) for k in range(3))
            reach = a + b + c
            gaps[axis] = along - halves[i, axis] - reach
            deep[axis] = gaps[axis] < -2.0 * _OVERLAP * np.minimum(halves[i, axis], reach)
        facing = (deep.sum(axis=0) >= 2.0) & (gaps.max(axis=0) <= gap)
        pairs += [(one, cubes[i + 1 + j]) for j in np.flatnonzero(facing).tolist()]
    return pairs


def _own_axes(quaternions: Array) -> Array:
    """Returns the directions of the boxes' own axes, shape (n, 3, 3): box, axis, world coordinate."""
    x, y, z, w = quaternions.T
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)],
            [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)],
            [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)


def _along(vectors: Array, axis: Array) -> Array:
    """Returns the dot products of vectors (n, 3) with one axis, in a fixed order of sums."""
    products: Array = vectors[:, 0] * axis[0] + vectors[:, 1] * axis[1] + vectors[:, 2] * axis[2]
    return products
