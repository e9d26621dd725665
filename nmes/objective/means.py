"""The mean and the quartiles of scores, which may be as great as numbers get."""

from __future__ import annotations

from collections.abc import Sequence
from math import fsum, isfinite, ldexp
from statistics import quantiles
from typing import Final

__all__ = ["mean", "mean_of_all", "quartiles"]

_SMALLER: Final = 64  # powers of two: there are no more numbers than 2 ** 64 to be added up


def mean(values: Sequence[float]) -> float:
    """Returns the mean of finite numbers, one or more: the same in whatever order they come, and finite."""
    try:
        return fsum(values) / len(values)
    except OverflowError:  # their sum is greater than any number, their mean is not
        smaller = _smaller(values)
        return _larger(fsum(smaller) / len(smaller), smaller)


def quartiles(values: Sequence[float]) -> tuple[float, float, float]:
    """Returns three numbers that a quarter, half and three quarters of two or more finite ones are below; finite."""
    low, middle, high = quantiles(values, n=4, method="inclusive")
    if all(map(isfinite, (low, middle, high))):
        return low, middle, high
    smaller = _smaller(values)  # four times one of them is greater than any number
    low, middle, high = (_larger(found, smaller) for found in quantiles(smaller, n=4, method="inclusive"))
    return low, middle, high


def _smaller(values: Sequence[float]) -> list[float]:
    return [ldexp(value, -_SMALLER) for value in values]


def _larger(found: float, smaller: Sequence[float]) -> float:
    """Returns a mean of `_smaller` numbers as one of the numbers: rounding may go beyond the greatest."""
    return ldexp(min(max(found, min(smaller)), max(smaller)), _SMALLER)


def mean_of_all(values: Sequence[float | None]) -> float | None:
    """Returns the mean; None where there are no numbers, or one is missing."""
    known = [value for value in values if value is not None]
    return mean(known) if known and len(known) == len(values) else None
