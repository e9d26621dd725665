"""What proofs have in common that do a sample again: how it is drawn.

A sample that can be known beforehand proves nothing. Who makes results up would change them until what their digest
draws is true; so the seed is another each time, and nobody can foresee it.
"""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from typing import TypeVar

from nmes.variation.draw import Draw

__all__ = ["drawn", "unforeseen"]

T = TypeVar("T")


def unforeseen(seed: int | None) -> int:
    """Returns the seed that somebody gave; where nobody did, one that nobody can have foreseen."""
    return secrets.randbits(32) if seed is None else seed


def drawn(items: Sequence[T], count: int, draw: Draw) -> list[T]:
    """Returns so many of some items, all alike, in their order."""
    return [items[place] for place in sorted(draw.order(len(items))[:count].tolist())]
