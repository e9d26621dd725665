"""Numbers as callers give them: lists, tuples, scalars and arrays of any type, made doubles in one place.

JSON data have a place of their own for this, `nmes.schemas.documents`; both give a single (float32) as the double that
it is.
"""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import numpy as np

from nmes.backend.specs import Array

__all__ = ["ArrayLike", "finite", "floats"]

ArrayLike: TypeAlias = Any
"""Whatever numpy makes an array of real numbers of."""
_NUMBERS = "fiu"


def floats(values: ArrayLike, what: str) -> Array:
    """Returns numbers as an array of doubles; one that is such an array already is returned as it is.

    Args:
        values: The numbers; text, truth values and complex numbers are none.
        what: What they are, for the message of an error.

    Raises:
        ValueError: They are no numbers, or make no array.
    """
    if isinstance(values, np.ndarray) and values.dtype == np.float64:
        return values
    try:
        array = np.asarray(values)
    except ValueError as error:  # of rows of different lengths
        raise ValueError(f"{what} must be numbers: {error}") from None
    if array.dtype.kind not in _NUMBERS:
        raise ValueError(f"{what} must be numbers, not {array.dtype}")
    return array.astype(np.float64)


def finite(value: ArrayLike, what: str) -> float:
    """Returns one number as a float.

    Raises:
        ValueError: It is not finite.
    """
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{what} must be a finite number, not {number}")
    return number
