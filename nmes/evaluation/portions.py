"""How the work of a population is cut into portions, so that no core waits long for another at the end.

Hides what makes creatures likely to be run together, and how long one is guessed to take. Nothing here has a say in
what comes out: a genome is looked at as it lies there, good or not.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import orjson

from nmes.evaluation.population import ROWS

__all__ = ["Portion", "cut", "kind_of", "portion_size"]

_LEAST = 4  # genomes; in smaller portions what a tick costs at all would be paid for too few
_RESERVE = 2  # portions a process that are still to come when one is handed out
_WORTH = 4_800  # ticks of a creature; about as long as it takes to start a process


class Portion(NamedTuple):
    """What one process takes at once.

    Attributes:
        genomes: Their indices.
        seeds: Which of the seeds, by their place.
    """

    genomes: list[int]
    seeds: range


def cut(genomes: Sequence[bytes], seeds: int, ticks: int, jobs: int, *, together: bool = True) -> list[Portion]:
    """Cuts a population into portions, to be handed out in this order to whichever process is free.

    Each is of one kind. What takes longest comes first, and portions become smaller towards the end. A creature of
    which a process has more to do than to start takes another is shared among them by its seeds.

    Args:
        genomes: Their documents.
        seeds: How many episodes each is run for.
        ticks: How many an episode has.
        jobs: How many processes there are.
        together: Whether several genomes may be run together.
    """
    kinds: dict[tuple[int, Hashable], list[int]] = {}
    for index, genome in enumerate(genomes):
        kinds.setdefault(kind_of(genome), []).append(index)
    portions, left = [], len(genomes)
    least = min(_LEAST, -(-len(genomes) // jobs))
    for _, kind in sorted(kinds.items(), key=lambda item: (-item[0][0], item[1])):
        begin = 0
        while begin < len(kind):
            count = _size(left, seeds, jobs, least) if together else 1
            taken = kind[begin : begin + count]
            pieces = _pieces(left, seeds, ticks, jobs) if count == 1 else [range(seeds)]
            portions += [Portion(taken, piece) for piece in pieces]
            begin += count
            left -= len(taken)
    return portions


def _pieces(left: int, seeds: int, ticks: int, jobs: int) -> list[range]:
    """Cuts the seeds of one of the genomes that are left into pieces of about one size."""
    share = left * seeds // (1 if jobs == 1 else _RESERVE * jobs)
    count = max(1, seeds // max(-(-_WORTH // ticks), min(ROWS, share)))
    ends = [seeds * number // count for number in range(count + 1)]
    return [range(begin, end) for begin, end in pairwise(ends)]


def portion_size(waiting: int, seeds: int, jobs: int) -> int:
    """Returns how many genomes of one kind the next portion takes at most, where others may come up later.

    Args:
        waiting: How many wait.
        seeds: As for `cut`.
        jobs: As for `cut`.
    """
    return _size(waiting, seeds, jobs, min(_LEAST, -(-waiting // jobs)))


def _size(left: int, seeds: int, jobs: int, least: int) -> int:
    most = max(1, ROWS // max(1, seeds))
    return most if jobs == 1 else min(most, max(least, left // (_RESERVE * jobs)))


def kind_of(genome: bytes) -> tuple[int, Hashable]:
    """Returns the number of cubes or parts that a document names, and all of its body but the numbers."""
    try:
        document = orjson.loads(genome)
        body = document["body"]
        parts = body["cubes"] if "cubes" in body else body["graph"]["parts"]
        return len(parts), orjson.dumps(_shape([body, document.get("sensors")]))
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return 0, None  # no genome, which takes no time


def _shape(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _shape(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_shape(item) for item in value]
    return value if isinstance(value, str) else None
