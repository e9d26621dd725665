"""The arithmetic of learners on whole arrays, with the same bits on every processor.

As in `nmes.brain.arithmetic`, sums are those of numpy's `einsum` in C, which calls no BLAS. Functions are made of
additions, products and divisions, which IEEE 754 rounds in one way only: number by number, as brains do it, a network
that sees hundreds of rows at once would wait for its activations most of the time. What they give differs from the C
library's in the last bits, by less than 1e-15.

The exponential function is Cephes's (S. L. Moshier, "Methods and programs for mathematical functions", 1989).
"""

from __future__ import annotations

import numpy as np
from numpy._core.multiarray import c_einsum  # a private name, as in `nmes.brain.arithmetic`

from nmes.brain.arithmetic import weigh
from nmes.brain.base import Array

__all__ = ["average", "dot", "exp", "gathered", "spread", "tanh", "weighed"]

_LOG2_E = 1.4426950408889634
_LN2_HIGH, _LN2_LOW = 6.93145751953125e-1, 1.42860682030941723212e-6
_P = (1.26177193074810590878e-4, 3.02994407707441961300e-2, 9.99999999999999999910e-1)
_Q = (3.00198505138664455042e-6, 2.52448340349684104192e-3, 2.27265548208155028766e-1, 2.0)
_FLAT = 20.0  # from here on tanh is 1
_BIAS, _SHIFT = 1023, 52  # of the exponent of a double


def weighed(rows: Array, weights: Array) -> Array:
    """Returns the weighted sums of each row: shape (n, units) from (n, inputs) and (units, inputs)."""
    sums = np.empty((len(rows), len(weights)))
    weigh(weights, rows, sums)
    return sums


def spread(sums: Array, weights: Array) -> Array:
    """Returns the gradient of inputs (n, inputs), given that of sums (n, units) and weights (units, inputs)."""
    return np.asarray(c_einsum("bo,oi->bi", sums, weights))


def gathered(sums: Array, rows: Array) -> Array:
    """Returns the products of sums and inputs, added up over all rows: shape (units, inputs)."""
    return np.asarray(c_einsum("bo,bi->oi", sums, rows))


def dot(one: Array, other: Array) -> float:
    """Returns the sum of the products of two arrays of one shape."""
    return float(c_einsum("i,i->", one.reshape(-1), other.reshape(-1)))


def average(values: Array) -> float:
    """Returns the mean of all numbers; 0 of none."""
    return float(np.add.reduce(values.reshape(-1))) / values.size if values.size else 0.0


def exp(values: Array) -> Array:
    """Returns e to the power of each number, which is kept within -700 to 700."""
    values = np.minimum(np.maximum(values, -700.0), 700.0)
    power = np.rint(values * _LOG2_E)
    rest = (values - power * _LN2_HIGH) - power * _LN2_LOW
    square = rest * rest
    top = rest * ((_P[0] * square + _P[1]) * square + _P[2])
    bottom = ((_Q[0] * square + _Q[1]) * square + _Q[2]) * square + _Q[3]
    part = 1.0 + 2.0 * (top / (bottom - top))
    scale = ((power.astype(np.int64) + _BIAS) << _SHIFT).view(np.float64)
    return np.asarray(part * scale)


def tanh(values: Array) -> Array:
    """Returns the hyperbolic tangent of each number."""
    grown = exp(2.0 * np.minimum(np.abs(values), _FLAT))
    return np.copysign(1.0 - 2.0 / (grown + 1.0), values)
