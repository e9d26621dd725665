"""How the benchmarks measure: side by side, in turns, by medians, so that a noisy machine is noisy to all alike."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf
from typing import Any

from nmes.measure.turns import Samples, Trial, in_turns, ratio

__all__ = ["Figure", "Samples", "Trial", "in_turns", "ratio", "summary"]


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


def summary(samples: Samples, unit: float) -> dict[str, dict[str, float]]:
    """Returns the median and the quartiles of each trial, in `unit`s."""
    result = {}
    for name, values in samples.items():
        low, middle, high = statistics.quantiles(values, n=4)
        result[name] = {"median": middle / unit, "q1": low / unit, "q3": high / unit}
    return result
