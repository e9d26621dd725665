"""The best candidates that were told, by their scores."""

from __future__ import annotations

from bisect import insort
from typing import Final

__all__ = ["Best"]

_KEPT: Final = 10


class Best:
    """The ten best candidates of a run; of equals, those that were told first."""

    def __init__(self) -> None:
        self._ranks: list[tuple[float, int]] = []  # minus the score, and the index

    def add(self, index: int, score: float | None) -> None:
        """Takes in a candidate's score, if it has one."""
        if score is not None:
            insort(self._ranks, (-score, index))
            del self._ranks[_KEPT:]

    @property
    def indices(self) -> list[int]:
        """Their indices, the best first."""
        return [index for _, index in self._ranks]
