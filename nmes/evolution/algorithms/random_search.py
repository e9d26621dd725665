"""Random search: nothing but random creatures, or mutants of the start genomes; what others must be better than."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from nmes.evolution.algorithm import Algorithm, Candidate, Problem, Score
from nmes.evolution.algorithms.bounds import within_bounds
from nmes.evolution.algorithms.breeding import found

__all__ = ["RandomSearch"]


class RandomSearch(Algorithm):
    """Candidates that have nothing to do with each other.

    Args:
        problem: What the run is about.
        options: See `Options`.
    """

    @dataclass(frozen=True)
    class Options:
        """The options.

        Attributes:
            elites: How many of the best count as the outcome.
        """

        elites: int = 10

        def __post_init__(self) -> None:
            """Raises a DocumentError where an option is out of its bounds."""
            within_bounds(self, {"elites": (1, 100_000)})

    def __init__(self, problem: Problem, options: Options) -> None:
        self._problem, self._options = problem, options
        self._best: list[tuple[float, int]] = []  # minus the score, and the index

    def needs(self, index: int) -> int:
        """Returns 0: no candidate depends on another."""
        return 0

    def ask(self, index: int) -> Candidate:
        """Returns the candidate of this index; see `Algorithm`."""
        return found(self._problem, index)

    def tell(self, index: int, candidate: Candidate, score: Score) -> None:
        """Takes a candidate's score in; see `Algorithm`."""
        if score.score is not None:
            self._best = sorted([*self._best, (-score.score, index)])[: self._options.elites]

    def elites(self) -> Sequence[int]:
        """Returns the best, of equals the first."""
        return [index for _, index in self._best]
