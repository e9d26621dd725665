"""Seeds as callers give them; and rows that are driven from outside: their episodes' seeds, and the actions taken.

Invariant: which scene an episode has follows from its row's seed and the number of the row's episodes before.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from operator import index
from typing import SupportsIndex, TypeVar

import numpy as np

from nmes.backend import Array
from nmes.backend.arrays import ArrayLike, floats

__all__ = ["RowSeeds", "check_actions", "read_seeds"]

T = TypeVar("T")


def read_seeds(seeds: Iterable[SupportsIndex]) -> tuple[int, ...]:
    """Returns seeds as plain whole numbers, whichever kinds of whole numbers they are.

    Raises:
        TypeError: One is no whole number, or they are no row of them.
    """
    try:
        return tuple(index(seed) for seed in seeds)
    except TypeError as error:
        raise TypeError(f"seeds must be a row of whole numbers: {error}") from None


class RowSeeds:
    """The seed of each row, and how many episodes it has begun with it.

    Args:
        count: The number of rows, none of which has a seed yet.
    """

    def __init__(self, count: int) -> None:
        self._seeds: list[int | None] = [None] * count
        self._numbers = [0] * count

    @property
    def complete(self) -> bool:
        """Whether every row has a seed."""
        return None not in self._seeds

    def take(self, seed: SupportsIndex | Iterable[SupportsIndex | None] | None, places: Sequence[int]) -> None:
        """Gives some rows new seeds.

        Args:
            seed: A number, from 0, is that of the first of all rows, and each has one more than the row before; or one
                for each. None: the row keeps its own.
            places: Which rows.

        Raises:
            TypeError: One is no whole number.
            ValueError: A row would have none, there are not as many seeds as rows, or one is below 0; none has changed.
        """
        count = len(self._seeds)
        seeds = _one_a_row(seed, count)
        if len(seeds) != count:
            raise ValueError(f"there are {count} rows, not {len(seeds)} seeds")
        wrong = [given for given in seeds if given is not None and given < 0]
        if wrong:
            raise ValueError(f"a seed is 0 or more, not {wrong[0]}")
        if any(seeds[place] is None and self._seeds[place] is None for place in places):
            raise ValueError("the first reset of a row needs a seed")
        for place in places:
            if seeds[place] is not None:
                self._seeds[place], self._numbers[place] = seeds[place], 0

    def draw(self, place: int, scenes: Sequence[T]) -> T:
        """Returns the scene of a row's next episode, until `count` says that this has begun."""
        seed = self._seeds[place]
        assert seed is not None
        draw = np.random.SeedSequence(seed, spawn_key=(self._numbers[place],))
        return scenes[int(draw.generate_state(1)[0]) % len(scenes)]

    def count(self, place: int) -> None:
        """Counts an episode that has begun."""
        self._numbers[place] += 1

    def forget(self) -> None:
        """Takes the seeds of all rows away."""
        self._seeds = [None] * len(self._seeds)


def _one_a_row(seed: SupportsIndex | Iterable[SupportsIndex | None] | None, count: int) -> list[int | None]:
    """Returns the seeds of rows, told as `RowSeeds.take` takes them."""
    if seed is None:
        return [None] * count
    try:
        first = index(seed)  # type: ignore[arg-type]  # which a row of them is not
    except TypeError:
        try:
            return [None if each is None else index(each) for each in seed]  # type: ignore[union-attr]
        except TypeError as error:
            raise TypeError(f"a seed is a whole number, or one for each row: {error}") from None
    return [first + row for row in range(count)]


def check_actions(actions: ArrayLike, count: int, motors: Sequence[str]) -> Array:
    """Returns actions as an array, if they are for each row and motor, and each from -1 to 1.

    Raises:
        ValueError: They are not.
    """
    numbers = floats(actions, "actions")
    if numbers.shape != (count, len(motors)):
        raise ValueError(f"actions have the shape {(count, len(motors))}, for each row and motor, not {numbers.shape}")
    kept = np.abs(numbers) <= 1.0
    if not kept.all():
        row, motor = np.argwhere(~kept)[0].tolist()
        value = numbers[row, motor]
        raise ValueError(f"actions are from -1 to 1; that of row {row} for {motors[motor]!r} is {value}")
    return numbers
