"""The colours in which cubes are shown: their own, or where they were given none, one that tells parts apart.

It hides the choice: the parts of a creature are as in its portrait, other cubes have a colour of their name's.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from zlib import crc32

from nmes import protocol
from nmes.genome.body import PALETTE
from nmes.recording.viewer_messages import Shape

__all__ = ["visible_shapes"]

_GIVEN_NONE = (*map(float, protocol.COMMANDS["spawn_cube"].defaults["color"]), 1.0)[:4]


def visible_shapes(shapes: Mapping[str, Shape]) -> dict[str, Shape]:
    """Returns the cubes of a world, by name, with the colours in which they are shown."""
    visible: dict[str, Shape] = {}
    parts: Counter[str] = Counter()
    for name, (size, color, kind) in shapes.items():
        creature, dot, _ = name.rpartition(".")
        number = parts[creature] if dot else crc32(name.encode())
        parts[creature] += 1
        plain = color == _GIVEN_NONE
        visible[name] = size, (*PALETTE[number % len(PALETTE)], 1.0) if plain else color, kind
    return visible
