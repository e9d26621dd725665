"""Weighted sums and functions of one number, with the same bits on every processor and in every batch.

What numpy offers for it has not: its products of matrices are BLAS's, which adds up in an order that suits the
processor, and its elementary functions have one variant for each set of vector instructions. Here products are taken
element by element, numpy's `add.reduce` adds each row up in an order that follows from the row's length alone, and
functions are the C library's, number by number. The library has variants too, but engines rest on the same ones, and a
fingerprint tells them apart (`nmes.backend.probe`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

__all__ = ["each", "weigh"]

Array = NDArray[np.float64]


def weigh(weights: Array, row: Array, out: Array) -> None:
    """Writes the weighted sums of a row of numbers.

    Args:
        weights: Shape (*lead, sums, columns).
        row: Shape (*lead, 1, columns).
        out: Shape (*lead, sums).
    """
    np.add.reduce(np.multiply(weights, row, order="C"), axis=-1, out=out)


def each(function: Callable[[float], float], values: Array) -> None:
    """Puts a function of each number in the place of that number."""
    values[...] = np.fromiter(map(function, values.ravel().tolist()), np.float64, values.size).reshape(values.shape)
