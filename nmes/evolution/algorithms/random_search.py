"""Random search: nothing but random creatures, or mutants of the start genomes; what others must be better than."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from nmes.evolution.algorithm import Algorithm, Candidate, Problem, Score
from nmes.evolution.algorithms.best import Best
from nmes.evolution.algorithms.breeding import found
from nmes.evolution.algorithms.requirements import check_problem

__all__ = ["RandomSearch"]

_WINDOW: Final = 1024  # candidates under way at once: all of a budget would be kept in memory, and in no log


class RandomSearch(Algorithm):
    """Candidates that have nothing to do with each other.

    Args:
        problem: What the run is about.
        options: None.

    Raises:
        DocumentError: There are objectives or measures.
    """

    @dataclass(frozen=True)
    class Options:
        """There are no options."""

    def __init__(self, problem: Problem, options: Options) -> None:
        check_problem(problem)
        self._problem, self._best = problem, Best()

    def needs(self, index: int) -> int:
        """Returns how many candidates must be told before: all but a window's, though none depends on another."""
        return 0 if self._problem.role else max(0, index - _WINDOW + 1)  # in co-evolution eras are windows

    def ask(self, index: int) -> Candidate:
        """Returns the candidate of this index; see `Algorithm`."""
        return found(self._problem, index)

    def tell(self, index: int, candidate: Candidate, score: Score) -> None:
        """Takes a candidate's score in; see `Algorithm`."""
        self._best.add(index, score.score)

    def elites(self) -> Sequence[int]:
        """Returns the ten best, of equals the first."""
        return self._best.indices
