"""How the benchmarks measure: side by side, in turns, by medians, so that a noisy machine is noisy to all alike."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import inf
from typing import Any

Trial = Callable[[], float]
Samples = dict[str, list[float]]


@dataclass(frozen=True)
class Figure:
    """One measured number, the range that it should be in, and what it was made of."""

    name: str
    value: float
    unit: str
    at_least: float = -inf
    at_most: float = inf
    details: Mapping[str, Any] = field(default_factory=dict)

    @property
    def ok(self) -> bool:
        """Whether the aim was reached."""
        return self.at_least <= self.value <= self.at_most

    @property
    def aim(self) -> str:
        """The range in words."""
        low = f"at least {self.at_least:g}" if self.at_least > -inf else ""
        high = f"at most {self.at_most:g}" if self.at_most < inf else ""
        return " and ".join(filter(None, (low, high)))


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


def summary(samples: Samples, unit: float) -> dict[str, dict[str, float]]:
    """Returns the median and the quartiles of each trial, in `unit`s."""
    result = {}
    for name, values in samples.items():
        low, middle, high = statistics.quantiles(values, n=4)
        result[name] = {"median": middle / unit, "q1": low / unit, "q3": high / unit}
    return result
