"""How the work of a population is cut into portions, so that no core waits long for another at the end.

Hides what makes creatures likely to be run together, and how long one is guessed to take. Nothing here has a say in
what comes out: a genome is looked at as it lies there, good or not.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import orjson

from nmes.evaluation.population import ROWS

__all__ = ["cut"]

_LEAST = 4  # genomes; in smaller portions the costs of a tick would be paid for too few
_RESERVE: Final = 2  # portions a process that are still to come when one is handed out


def cut(genomes: Sequence[bytes], seeds: int, jobs: int) -> list[list[int]]:
    """Cuts a population into portions, to be handed out in this order to whichever process is free.

    What takes longest comes first, like beside like; portions become smaller towards the end.

    Args:
        genomes: Their documents.
        seeds: How many episodes each is run for.
        jobs: How many processes there are.

    Returns:
        The indices of the genomes in each portion.
    """
    looks = [_look(genome) for genome in genomes]
    order = sorted(range(len(genomes)), key=lambda index: (-looks[index][0], looks[index][1], index))
    most = max(1, ROWS // seeds)
    portions, begin = [], 0
    while begin < len(order):
        left = len(order) - begin
        count = most if jobs == 1 else min(most, max(_LEAST, left // (_RESERVE * jobs)))
        portions.append(order[begin : begin + count])
        begin += count
    return portions


def _look(genome: bytes) -> tuple[int, bytes]:
    """Returns the number of cubes that a document names, and all of its body but the numbers."""
    try:
        document = orjson.loads(genome)
        parts = [document.get(name) for name in ("body", "sensors")]
        return len(parts[0]["cubes"]), orjson.dumps(_shape(parts))
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return 0, b""  # a graph, of which nobody knows the cubes before it has grown; or no genome


def _shape(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _shape(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_shape(item) for item in value]
    return value if isinstance(value, str) else None
