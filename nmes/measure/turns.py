"""How measurements compare: trials that take turns, and medians of the ratios of the same round."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping

Trial = Callable[[], float]
Samples = dict[str, list[float]]


def in_turns(trials: Mapping[str, Trial], rounds: int) -> Samples:
    """Runs each trial once a round, first once for warmth, every other round backwards; returns what they returned."""
    samples: Samples = {name: [] for name in trials}
    for trial in trials.values():
        trial()
    for number in range(rounds):
        for name in sorted(trials, reverse=number % 2 == 1):
            samples[name].append(trials[name]())
    return samples


def ratio(samples: Samples, over: str, under: str) -> float:
    """Returns the median of the ratios of the same round."""
    return statistics.median(a / b for a, b in zip(samples[over], samples[under], strict=True))
