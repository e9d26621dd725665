"""Gradients by differences: what an analytic one is held against."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

__all__ = ["slopes"]

_STEP = 1e-6


def slopes(function: Callable[[NDArray[np.float64]], float], point: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the gradient of a function of an array at a point, by central differences."""
    found = np.empty_like(point)
    for place in np.ndindex(point.shape):
        there = point.copy()
        there[place] += _STEP
        above = function(there)
        there[place] -= 2 * _STEP
        found[place] = (above - function(there)) / (2 * _STEP)
    return found
