"""An archive that keeps candidates apart by what they are: a grid of cells over some measures, the best in each cell.

It is the archive of MAP-Elites (J.-B. Mouret and J. Clune, "Illuminating search spaces by mapping elites", 2015).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod

from nmes.backend.rotation import total
from nmes.evolution.algorithm import Measure
from nmes.genome import Genome

__all__ = ["Archive", "Elite", "cell"]


def cell(measures: Sequence[Measure], values: Sequence[float]) -> tuple[int, ...]:
    """Returns the cell of some values, by the place along each measure, from 0.

    What is outside a range is in the cell at its end, and what is on the border between two cells in the upper one.
    """
    return tuple(_place(measure, value) for measure, value in zip(measures, values, strict=True))


def _place(measure: Measure, value: float) -> int:
    part = (min(max(value, measure.low), measure.high) - measure.low) / (measure.high - measure.low)
    return min(int(part * measure.cells), measure.cells - 1)


@dataclass(frozen=True, slots=True)
class Elite:
    """The best candidate of a cell.

    Attributes:
        index: Its index in the run.
        genome: Its genome.
        score: Its score.
    """

    index: int
    genome: Genome
    score: float


class Archive:
    """The elites by cell, in the order in which cells were first reached.

    Args:
        measures: What the cells are of.
    """

    def __init__(self, measures: Sequence[Measure]) -> None:
        self._measures = tuple(measures)
        self._cells: dict[tuple[int, ...], Elite] = {}
        self._order: list[tuple[int, ...]] = []

    def __len__(self) -> int:
        """Returns how many cells are occupied."""
        return len(self._order)

    def __getitem__(self, number: int) -> Elite:
        """Returns the elite of the cell that was reached as this one, from 0."""
        return self._cells[self._order[number]]

    def add(self, elite: Elite, values: Sequence[float]) -> float | None:
        """Takes in a candidate, if it is the first in its cell or better than the one there.

        Args:
            elite: The candidate.
            values: Of the measures.

        Returns:
            By how much its score is greater than that of the one there; None where the cell was empty.
        """
        place = cell(self._measures, values)
        there = self._cells.get(place)
        if there is None:
            self._order.append(place)
        if there is None or elite.score > there.score:
            self._cells[place] = elite
        return None if there is None else elite.score - there.score

    @property
    def coverage(self) -> float:
        """The part of the cells that are occupied, 0 to 1."""
        return len(self) / prod(measure.cells for measure in self._measures)

    @property
    def quality(self) -> float:
        """The QD score: the sum of the elites' scores (J. K. Pugh et al., 2015)."""
        return total(elite.score for elite in self._cells.values())

    def indices(self) -> list[int]:
        """Returns the indices of the elites, the best first; of equals, the first that was told."""
        return [elite.index for elite in sorted(self._cells.values(), key=lambda elite: (-elite.score, elite.index))]
