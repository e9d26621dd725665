"""What proofs have in common that do a sample again: how it is drawn, and what may come out otherwise in good faith.

A sample that can be known beforehand proves nothing. Who makes results up would change them until what their digest
draws is true; so the seed is another each time, and nobody can foresee it.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterable, Sequence
from typing import Final, TypeVar

from nmes.schemas.documents import JsonObject
from nmes.variation.draw import Draw

__all__ = ["MODEL", "drawn", "has_model", "unforeseen"]

T = TypeVar("T")

MODEL: Final = "it has an ONNX brain, which may round otherwise on another processor"
"""Why something came out otherwise that `has_model` tells of."""


def unforeseen(seed: int | None) -> int:
    """Returns the seed that somebody gave; where nobody did, one that nobody can have foreseen."""
    return secrets.randbits(32) if seed is None else seed


def drawn(items: Sequence[T], count: int, draw: Draw) -> list[T]:
    """Returns so many of some items, all alike, in their order."""
    return [items[place] for place in sorted(draw.order(len(items))[:count].tolist())]


def has_model(genomes: Iterable[JsonObject]) -> bool:
    """Tells whether a brain may do otherwise here though all fingerprints agree: onnxruntime is no part of them."""
    return any(genome.get("brain", {}).get("kind") == "onnx" for genome in genomes)
