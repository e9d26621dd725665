"""Weighted sums and functions of one number, with the same bits on every processor and in every batch.

What numpy offers for it mostly has not: its products of matrices are BLAS's, which adds up in an order that suits the
processor, and its elementary functions have one variant for each set of vector instructions. Here sums are those of
numpy's `einsum` in C, which calls no BLAS, has no variants to choose from, and adds up along a row in an order that
follows from the row's length alone. Functions are the C library's, number by number: from numpy's additions and
products they would take a dozen calls or more, and one creature alone could not pay for them. Both are part of the
probe by which machines are compared (`nmes.backend.probe`): the library has variants too, and numpy may be built for
another processor.
"""

from __future__ import annotations

from collections.abc import Callable
from struct import Struct

import numpy as np

# A private name: what `np.einsum` calls in the end. By way of that a sum takes 2.3 us in place of 1.3, and two of them
# in a tick are 1.5 % of the episode of a small network.
from numpy._core.multiarray import c_einsum
from numpy.typing import NDArray

__all__ = ["each", "on_each", "weigh"]

Array = NDArray[np.float64]


def weigh(weights: Array, row: Array, out: Array) -> None:
    """Writes the weighted sums of a row of numbers.

    Args:
        weights: Shape (*lead, sums, columns), or (sums, columns) for all rows alike; its rows contiguous.
        row: Shape (*lead, columns), contiguous along the last axis.
        out: Shape (*lead, sums).
    """
    c_einsum("...ij,...j->...i", weights, row, out=out)


def on_each(function: Callable[[float], float], source: Array, target: Array) -> Callable[[], None]:
    """Returns a call that writes a function of each number of one array to another; both must stay where they are.

    Args:
        function: The function.
        source: Contiguous; what is in it may be lost.
        target: Of the same shape; may be the source.
    """
    flat, there = source.reshape(-1), bool(target.flags.c_contiguous)
    place = (target if there else source).data
    write = Struct(f"{source.size}d").pack_into  # of all ways from floats to an array the fastest

    def apply() -> None:
        write(place, 0, *map(function, flat.tolist()))
        if not there:
            target[...] = source

    return apply


def each(function: Callable[[float], float], values: Array) -> None:
    """Puts a function of each number of a contiguous array in the place of that number."""
    on_each(function, values, values)()
