"""What the candidates of a run tell together: who was best when, who comes from whom, which operators helped.

It hides how that is found from the rows of a run alone: no genome is read and nothing is evaluated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

from nmes.objective.means import quartiles

__all__ = ["History", "OperatorRecord", "Origin", "Window", "milestones"]

_WINDOWS = 80  # of a curve, at most: more cannot be told apart
_FEWEST = 10  # candidates of a window, so that it has quartiles


class Origin(Protocol):
    """A candidate that was told, without its genome."""

    @property
    def index(self) -> int:
        """Its place in the order of asking, from 0 on."""

    @property
    def score(self) -> float | None:
        """The mean over the seeds; None where it has none."""

    @property
    def operator(self) -> str:
        """How it came about."""

    @property
    def parents(self) -> Sequence[int]:
        """The indices of those that it comes from, the one that it is mostly like first."""

    @property
    def generation(self) -> int:
        """Of the algorithm's count."""

    @property
    def group(self) -> str:
        """The species, emitter or island that it belongs to, or an empty text."""

    @property
    def objectives(self) -> Sequence[float]:
        """The values of the run's objectives; empty where there are none."""

    @property
    def measures(self) -> Sequence[float]:
        """The values of the run's measures; empty where there are none."""


@dataclass(frozen=True, slots=True)
class Window:
    """Candidates that follow each other.

    Attributes:
        begin: The index of the first.
        end: The index after the last.
        quartiles: Of their scores: a quarter, half and three quarters are below; None where fewer than two have one.
        groups: How many are of each group, by its name.
    """

    begin: int
    end: int
    quartiles: tuple[float, float, float] | None
    groups: dict[str, int]


@dataclass(frozen=True, slots=True)
class OperatorRecord:
    """The success of an operator: of the candidates that it made, or had part in.

    Attributes:
        name: The operator's.
        candidates: How many there are.
        without_score: How many of them have no score.
        better: How many of them beat the parent that they are mostly like; those without a parent count for none.
        champions: How many of them were the best of the run so far.
    """

    name: str
    candidates: int
    without_score: int
    better: int
    champions: int


def milestones(rows: Sequence[Origin], count: int) -> list[Origin]:
    """Returns the first and the last candidate, and of those that were the best so far the ones that gained most.

    Args:
        rows: One candidate or more, in order.
        count: How many are returned at most, two or more.
    """
    best, gains = rows[0].score, {}
    for row in rows[1:-1]:
        if row.score is not None and (best is None or row.score > best):
            gains[row.index] = row.score - (row.score if best is None else best)
            best = row.score
    most = sorted(gains, key=lambda index: (-gains[index], index))[: count - 2]
    kept = {rows[0].index, *most, rows[-1].index}
    return [row for row in rows if row.index in kept]


class History:
    """The candidates of a run that were told.

    Args:
        rows: In the order of their indices, from 0 on, none left out.
    """

    def __init__(self, rows: Sequence[Origin]) -> None:
        self.rows = rows

    def champions(self) -> list[Origin]:
        """Returns the candidates that were better than all before them, in order."""
        found: list[Origin] = []
        best = None
        for row in self.rows:
            if row.score is not None and (best is None or row.score > best):
                best = row.score
                found.append(row)
        return found

    def top(self, count: int) -> list[Origin]:
        """Returns the candidates with the highest scores, the earlier of two equal ones first."""
        scores = [(-row.score, row.index) for row in self.rows if row.score is not None]
        return [self.rows[index] for _, index in sorted(scores)[:count]]

    def operators(self) -> list[OperatorRecord]:
        """Returns the record of each operator, most candidates first; a candidate made by several counts for each."""
        champions = {row.index for row in self.champions()}
        members: dict[str, list[Origin]] = {}
        for row in self.rows:
            for name in dict.fromkeys(row.operator.split("+")):
                members.setdefault(name, []).append(row)
        records = [
            OperatorRecord(
                name,
                len(rows),
                len([row for row in rows if row.score is None]),
                len([row for row in rows if self._beats_parent(row)]),
                len([row for row in rows if row.index in champions]),
            )
            for name, rows in members.items()
        ]
        return sorted(records, key=lambda record: (-record.candidates, record.name))

    def _beats_parent(self, row: Origin) -> bool:
        parent = self._parent(row)
        scores = row.score, None if parent is None else parent.score
        return scores[0] is not None and scores[1] is not None and scores[0] > scores[1]

    def _parent(self, row: Origin) -> Origin | None:
        """Returns the parent that a candidate is mostly like; None where a log names none that was before it."""
        return self.rows[row.parents[0]] if row.parents and row.parents[0] < row.index else None

    def lineage(self, index: int) -> list[Origin]:
        """Returns a candidate and, before it, those that it comes from: of each the parent that it is mostly like."""
        line = [self.rows[index]]
        while (parent := self._parent(line[-1])) is not None:
            line.append(parent)
        return line[::-1]

    def windows(self) -> list[Window]:
        """Returns the candidates by generation where each follows the one before, else cut into equal parts."""
        bounds = self._generations() or self._equal_parts()
        return [self._window(begin, end) for begin, end in pairwise(bounds)]

    def _generations(self) -> list[int]:
        """Returns where generations begin, and the end; none where they mix, or are too many to be told apart."""
        numbers = [row.generation for row in self.rows]
        begins = [index for index in range(1, len(numbers)) if numbers[index] != numbers[index - 1]]
        mixed = any(numbers[index] < numbers[index - 1] for index in begins)
        few = len(numbers) < _FEWEST * (len(begins) + 1)
        return [] if mixed or few or not 0 < len(begins) < 3 * _WINDOWS else [0, *begins, len(numbers)]

    def _equal_parts(self) -> list[int]:
        parts = max(1, min(_WINDOWS, len(self.rows) // _FEWEST))
        return [len(self.rows) * part // parts for part in range(parts + 1)]

    def _window(self, begin: int, end: int) -> Window:
        rows = self.rows[begin:end]
        scores = [row.score for row in rows if row.score is not None]
        groups: dict[str, int] = {}
        for row in rows:
            groups[row.group] = groups.get(row.group, 0) + 1
        return Window(begin, end, quartiles(scores) if len(scores) > 1 else None, groups)
