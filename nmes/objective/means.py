"""The mean of scores, which may be as great as numbers get."""

from __future__ import annotations

from collections.abc import Sequence
from math import fsum, ldexp
from typing import Final

__all__ = ["mean", "mean_of_all"]

_SMALLER: Final = 64  # powers of two: there are no more numbers than 2 ** 64 to be added up


def mean(values: Sequence[float]) -> float:
    """Returns the mean of finite numbers, one or more: the same in whatever order they come, and finite."""
    try:
        return fsum(values) / len(values)
    except OverflowError:  # their sum is greater than any number, their mean is not
        smaller = [ldexp(value, -_SMALLER) for value in values]
        found = fsum(smaller) / len(smaller)
        return ldexp(min(max(found, min(smaller)), max(smaller)), _SMALLER)  # rounding may go beyond the greatest


def mean_of_all(values: Sequence[float | None]) -> float | None:
    """Returns the mean; None where there are no numbers, or one is missing."""
    known = [value for value in values if value is not None]
    return mean(known) if known and len(known) == len(values) else None
