"""Random choices that follow from a seed and a path of names, and from nothing else.

Hides the generator. Two draws with another seed or another path have nothing to do with each other, so that what one
part of a run draws never shifts what another does.
"""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import blake2b
from math import exp
from operator import index
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from nmes.backend import Array
from nmes.backend.arrays import finite
from nmes.backend.rotation import total
from nmes.schemas.documents import write_json

__all__ = ["Draw"]

T = TypeVar("T")


class Draw:
    """A stream of random choices.

    Args:
        seed: The run's, or whatever is to be repeated.
        path: What the choices are for, as `"candidate", 12, "mutate"`.
    """

    def __init__(self, seed: int, *path: str | int) -> None:
        entropy = blake2b(write_json([str(index(seed)), *path]), digest_size=16).digest()
        self._generator = np.random.Generator(np.random.PCG64(int.from_bytes(entropy, "little")))

    def chance(self, part: float) -> bool:
        """Returns True in this part of the cases, from 0 to 1."""
        return self._generator.random() < finite(part, "a chance")

    def uniform(self, low: float, high: float) -> float:
        """Returns a number between the two, all alike."""
        low, high = finite(low, "a bound"), finite(high, "a bound")
        return low + (high - low) * self._generator.random()

    def count(self, low: int, high: int) -> int:
        """Returns a whole number from `low` to `high`, both included."""
        return int(self._generator.integers(low, high + 1))

    def normal(self, spread: float = 1.0) -> float:
        """Returns a normally distributed number with mean 0 and this standard deviation."""
        return finite(spread, "a spread") * self._generator.standard_normal()

    def normals(self, count: int) -> Array:
        """Returns normally distributed numbers with mean 0 and standard deviation 1, shape (count,)."""
        return self._generator.standard_normal(count)

    def order(self, count: int) -> NDArray[np.intp]:
        """Returns the numbers from 0 to below `count` in any order, all orders alike; shape (count,)."""
        return np.argsort(self._generator.random(count), kind="stable")

    def factor(self, spread: float) -> float:
        """Returns a positive factor whose logarithm has this standard deviation: x and 1 / x are as likely."""
        return exp(self.normal(spread))

    def one_of(self, values: Sequence[T], weights: Sequence[float] | None = None) -> T:
        """Returns one of some values: all alike, or by weights that need not sum to 1."""
        if weights is None:
            return values[self.count(0, len(values) - 1)]
        weights = [finite(weight, "a weight") for weight in weights]
        place = self.uniform(0.0, total(weights))
        for value, weight in zip(values, weights, strict=True):
            place -= weight
            if place < 0.0:
                return value
        return values[-1]

    def direction(self) -> list[float]:
        """Returns a vector of length 1: one of the three axes mostly, else any."""
        if self.chance(0.75):
            axis = self.count(0, 2)
            return [1.0 if i == axis else 0.0 for i in range(3)]
        while True:
            vector = [self.uniform(-1.0, 1.0) for _ in range(3)]
            square = total(part * part for part in vector)
            if 0.01 < square <= 1.0:
                return [round(part / square**0.5, 6) for part in vector]
