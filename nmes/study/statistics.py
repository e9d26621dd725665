"""Statistics of runs: interquartile means, stratified bootstrap intervals, the probability of improvement.

Source: R. Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical Precipice" (NeurIPS 2021).

Everything is computed in one order from the runs and a path of names, so that it has the same bits wherever it is done
again. The generator's raw words are what numpy keeps from version to version.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from typing import Final

import numpy as np

from nmes.backend import Array
from nmes.schemas.documents import write_json

__all__ = ["RESAMPLES", "Estimate", "estimate", "improvement", "iqm", "mean", "median"]

RESAMPLES: Final = 5_000
_LEVEL: Final = 0.95
_BLOCK: Final = 500  # resamples at once: those of two arms with thousand seeds are compared in 4 GB otherwise

Strata = Sequence[Array]
"""The numbers of the runs of each cell, shape (seeds,), or of many resamples, (resamples, seeds)."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number that was estimated from runs.

    Attributes:
        value: The number.
        low: The lower end of its interval; the number itself where it is exact.
        high: The upper end.
        runs: Of how many runs.
        seeds: Of how many seeds.
    """

    value: float
    low: float
    high: float
    runs: int
    seeds: int


def iqm(strata: Strata) -> Array:
    """Returns the interquartile means: those of the middle half of all numbers, after a quarter at each end is cut."""
    every = np.sort(np.concatenate(strata, axis=-1), axis=-1)
    cut = every.shape[-1] // 4
    return mean([every[..., cut : every.shape[-1] - cut]])


def mean(strata: Strata) -> Array:
    """Returns the means of all numbers."""
    every = np.concatenate(strata, axis=-1)
    total = every[..., 0].copy()
    for place in range(1, every.shape[-1]):  # one order, whatever the processor
        total += every[..., place]
    return np.asarray(total / every.shape[-1], np.float64)


def median(strata: Strata) -> Array:
    """Returns the medians of all numbers."""
    every = np.sort(np.concatenate(strata, axis=-1), axis=-1)
    count = every.shape[-1]
    return np.asarray((every[..., (count - 1) // 2] + every[..., count // 2]) / 2.0, np.float64)


def improvement(strata: Strata, over: Strata) -> Array:
    """Returns the probability that a run is better than one of the others of its cell, the mean over the cells.

    Of equals, either is better in half of the cases.
    """
    parts = []
    for ours, theirs in zip(strata, over, strict=True):
        left, right = ours[..., :, np.newaxis], theirs[..., np.newaxis, :]
        better = (left > right).sum(axis=(-2, -1)) + 0.5 * (left == right).sum(axis=(-2, -1))
        parts.append(np.asarray(better / (ours.shape[-1] * theirs.shape[-1]), np.float64)[..., np.newaxis])
    return mean(parts)


def estimate(compute: Callable[..., Array], arms: Sequence[Strata], path: Sequence[str]) -> Estimate:
    """Computes a statistic and its interval.

    Args:
        compute: The statistic, of as many strata as there are arms.
        arms: The runs of each arm by cell.
        path: Of which names all draws follow.
    """
    value = float(compute(*arms))
    draws = []
    words = _words(path)
    for begin in range(0, RESAMPLES, _BLOCK):
        count = min(_BLOCK, RESAMPLES - begin)
        draws.append(compute(*[[_resampled(runs, count, words) for runs in strata] for strata in arms]))
    every = np.sort(np.concatenate(draws))
    tail = (1.0 - _LEVEL) / 2.0
    counts = [len(runs) for runs in arms[0]]
    return Estimate(value, _quantile(every, tail), _quantile(every, 1.0 - tail), sum(counts), max(counts))


def _words(path: Sequence[str]) -> np.random.PCG64:
    """Returns a stream of random words that follows from a path of names."""
    return np.random.PCG64(int.from_bytes(blake2b(write_json(list(path)), digest_size=16).digest(), "little"))


def _resampled(runs: Array, count: int, words: np.random.PCG64) -> Array:
    """Returns as many runs as there are, drawn with replacement, so many times; array (count, runs)."""
    size = len(runs)
    places = words.random_raw(count * size) % np.uint64(size)  # of 2^64 words: none is favoured
    return runs[places.astype(np.intp)].reshape(count, size)


def _quantile(every: Array, part: float) -> float:
    """Returns where this part of sorted numbers ends, between two of them in proportion."""
    place = part * (len(every) - 1)
    index = min(int(place), len(every) - 2)
    low, high = float(every[index]), float(every[index + 1])
    return low + (high - low) * (place - index)
