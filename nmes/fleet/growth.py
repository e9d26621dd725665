"""How what a survey comes to grows with the number of its worlds: the best score, and how many behaviours there are.

Of a survey of many worlds each part is one that might have been: sizes that halve, and of each size many parts, drawn
without replacement. Invariant: what is told follows from the survey's log alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import frexp
from typing import Final

from nmes.evaluation.judge import Result
from nmes.fleet.survey import Survey
from nmes.objective.means import mean
from nmes.variation.draw import Draw

__all__ = ["Growth", "Size", "behaviour", "survey_growth"]

_HALVINGS: Final = 6
_TAIL: Final = 0.025  # of the parts of a size that are below the low end, and above the high one
_LEAST: Final = 2.0**-7  # m or J: less is no motion


@dataclass(frozen=True, slots=True)
class Size:
    """What parts of a survey come to that have so many worlds.

    Attributes:
        worlds: How many.
        best: The mean of their best scores; None where a part has no score at all.
        best_low: The lower end of what 95 of 100 of them come to; None likewise.
        best_high: The upper end; None likewise.
        behaviours: The mean of how many different behaviours there are.
        behaviours_low: The lower end likewise.
        behaviours_high: The upper end.
    """

    worlds: int
    best: float | None
    best_low: float | None
    best_high: float | None
    behaviours: float
    behaviours_low: float
    behaviours_high: float


@dataclass(frozen=True, slots=True)
class Growth:
    """How a survey grows with its worlds.

    Attributes:
        worlds: How many are done.
        part: The part of them in which the creature has a score.
        sizes: From the least to all worlds.
        best_gain: By how much the best score of all is above the mean best of a quarter; None where one has none.
        behaviours_ratio: How many times as many behaviours all have as a quarter.
        digest: The survey's.
    """

    worlds: int
    part: float
    sizes: tuple[Size, ...]
    best_gain: float | None
    behaviours_ratio: float
    digest: str


def behaviour(result: Result) -> tuple[int, int]:
    """Returns the behaviour of an episode: how far it got and what that took, each in fourfold steps.

    Two that are alike got as far over the ground, and worked as much with their motors, within a factor of four.
    """
    (_, far), (_, work) = frexp(max(_LEAST, result.distance)), frexp(max(_LEAST, result.energy))
    return far // 2, work // 2


def survey_growth(survey: Survey, draws: int) -> Growth | None:
    """Returns how a survey grows with its worlds; None where fewer than four are done.

    Args:
        survey: The survey.
        draws: How many parts of each size.
    """
    count = len(survey)
    if count < 4:
        return None
    scores = [world.score for world in survey.worlds]
    kinds = [
        None if world.result is None or world.score is None else behaviour(world.result) for world in survey.worlds
    ]
    counts = sorted({max(1, count >> halving) for halving in range(_HALVINGS)})
    sizes = tuple(_size(survey, scores, kinds, each, draws) for each in counts)
    quarter, whole = next(each for each in sizes if each.worlds == count >> 2), sizes[-1]
    gain = None if whole.best is None or quarter.best is None else whole.best - quarter.best
    part = sum(score is not None for score in scores) / count
    times = whole.behaviours / quarter.behaviours if quarter.behaviours else 1.0
    return Growth(count, part, sizes, gain, times, survey.digest)


def _size(
    survey: Survey,
    scores: Sequence[float | None],
    kinds: Sequence[tuple[int, int] | None],
    count: int,
    draws: int,
) -> Size:
    draw = Draw(0, "growth", survey.digest, count)
    bests, behaviours = list[float | None](), list[float]()
    for _ in range(draws if count < len(scores) else 1):
        part = draw.order(len(scores))[:count].tolist()
        found = [score for place in part if (score := scores[place]) is not None]
        bests.append(max(found, default=None))
        behaviours.append(float(len({kinds[place] for place in part} - {None})))
    every = [best for best in bests if best is not None]
    best, low, high = _ends(every) if len(every) == len(bests) else (None, None, None)
    return Size(count, best, low, high, *_ends(behaviours))


def _ends(values: Sequence[float]) -> tuple[float, float, float]:
    """Returns the mean of some numbers, and between which two of them 95 of 100 lie."""
    ordered = sorted(values)
    cut = int(_TAIL * len(ordered))
    return mean(ordered), ordered[cut], ordered[-1 - cut]
