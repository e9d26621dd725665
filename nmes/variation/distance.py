"""How different two bodies are, for species: who is built alike.

As the compatibility distance of K. O. Stanley and R. Miikkulainen, "Evolving Neural Networks through Augmenting
Topologies" (2002), it adds what only one of the two has to how far apart is what both have; but of bodies: cubes and
joints have names that are kept from parent to child.
"""

from __future__ import annotations

from math import log

from nmes.backend.rotation import total
from nmes.genome.body import Body

__all__ = ["distance"]


def distance(one: Body, other: Body) -> float:
    """Returns the distance of two bodies, from 0 for equal ones on.

    Args:
        one: A body.
        other: Another.

    Returns:
        The part of all their cubes and joints, told apart by their ids, and of what their rules do to which cubes, that
        only one of them has; and the mean, over the cubes that both have, of how far apart the logarithms of their
        edges are.
    """
    mine, theirs = _ids(one), _ids(other)
    sizes = {cube.id: cube.size for cube in other.cubes}
    shared = [(cube.size, sizes[cube.id]) for cube in one.cubes if cube.id in sizes]
    apart = [abs(log(a / b)) for size, match in shared for a, b in zip(size, match, strict=True)]
    alone = len(mine ^ theirs) / len(mine | theirs)
    return alone + (total(apart) / len(apart) if apart else 0.0)


def _ids(body: Body) -> set[tuple[str, str]]:
    ids = {("cube", cube.id) for cube in body.cubes} | {("joint", joint.id) for joint in body.joints}
    ids |= {("later", name) for name in body.later}
    for rule in body.development:
        lists = {"shed": rule.shed, "adopt": rule.adopt, "grow": rule.grow}
        ids |= {(kind, name) for kind, names in lists.items() for name in names}
        ids |= {("resize", each.part) for each in rule.resize}
    return ids
