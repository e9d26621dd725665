"""Which parts of a body are there: those that still hang on its root, by the body's own joints.

What is cut off is no part of a creature any more, whatever it is joined to later.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from nmes.world.entities import Cube, Entities, Joint

__all__ = ["attached", "beyond"]


def attached(
    entities: Entities, cubes: Mapping[str, Cube], joints: Mapping[str, Joint]
) -> tuple[dict[str, Cube], dict[str, Joint]]:
    """Returns the parts of a body that are there, by their ids, in its order; none where its root is gone.

    Args:
        entities: The world's cubes and joints.
        cubes: Those that were there, the root first.
        joints: Those that were there.
    """
    live = {part: cube for part, cube in cubes.items() if entities.cubes.get(cube.name) is cube}
    holding = {part: joint for part, joint in joints.items() if entities.joints.get(joint.name) is joint}
    root = next(iter(cubes))
    if root not in live:
        return {}, {}
    numbers = _hanging(live[root].body, holding.values())
    there = {part: cube for part, cube in live.items() if cube.body in numbers}
    return there, {part: joint for part, joint in holding.items() if joint.cube1.body in numbers}


def beyond(cubes: Mapping[str, Cube], joints: Mapping[str, Joint], part: str) -> list[Cube]:
    """Returns a part and all that hangs on the root through it alone; the first of the cubes is the root."""
    root, gone = next(iter(cubes.values())), cubes[part].body
    others = [joint for joint in joints.values() if gone not in (joint.cube1.body, joint.cube2.body)]
    kept = _hanging(root.body, others)
    return [cube for cube in cubes.values() if cube.body not in kept]


def _hanging(root: int, joints: Collection[Joint]) -> set[int]:
    """Returns the numbers of the cubes that joints connect to a root, and its own."""
    joined: dict[int, list[int]] = {}
    for joint in joints:
        one, other = joint.cube1.body, joint.cube2.body
        joined.setdefault(one, []).append(other)
        joined.setdefault(other, []).append(one)
    found, fresh = {root}, [root]
    while fresh:
        for other in joined.get(fresh.pop(), ()):
            if other not in found:
                found.add(other)
                fresh.append(other)
    return found
