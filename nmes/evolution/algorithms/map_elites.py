"""MAP-Elites: an archive of the best of every kind, bred from all of it alike: the algorithm of `map-elites`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from nmes.evolution.algorithm import Algorithm, Candidate, Problem, Score
from nmes.evolution.algorithms.bounds import within_bounds
from nmes.evolution.algorithms.breeding import Parent, breed, found
from nmes.evolution.algorithms.requirements import check_problem
from nmes.evolution.archive import Archive, Elite
from nmes.variation.draw import Draw

__all__ = ["MapElites"]


class MapElites(Algorithm):
    """Offspring of elites, each of which is as likely to be a parent; it goes into the archive if it is the best there.

    J.-B. Mouret and J. Clune, "Illuminating search spaces by mapping elites" (2015). It has no generations: a candidate
    is bred from the elites that are known when the window lets it be asked for.

    Args:
        problem: What the run is about, with measures. Without start genomes it begins with random creatures.
        options: See `Options`.

    Raises:
        DocumentError: The problem is another.
    """

    @dataclass(frozen=True)
    class Options:
        """The options.

        Attributes:
            initial: How many candidates to begin with, before there are offspring.
            crossover: In which part of the cases two elites are crossed.
            window: How many candidates may be under way at once.
        """

        initial: int = 200
        crossover: float = 0.2
        window: int = 64

        def __post_init__(self) -> None:
            within_bounds(self, {"initial": (1, 1_000_000), "crossover": (0, 1), "window": (1, 100_000)})

    def __init__(self, problem: Problem, options: Options) -> None:
        check_problem(problem, measures=1)
        self._problem, self._options, self._archive = problem, options, Archive(problem.measures)

    def needs(self, index: int) -> int:
        """Returns how many candidates must be told before: all but the window's."""
        return max(0, index - self._options.window + 1)

    def ask(self, index: int) -> Candidate:
        """Returns the candidate of this index; see `Algorithm`."""
        if index < self._options.initial or not len(self._archive):
            return found(self._problem, index)
        return breed(self._problem, index, self._parent, self._options.crossover, 0)

    def _parent(self, draw: Draw) -> Parent:
        elite = self._archive[draw.count(0, len(self._archive) - 1)]
        return Parent(elite.index, elite.genome)

    def tell(self, index: int, candidate: Candidate, score: Score) -> None:
        """Puts a candidate that has a score into the archive, where it is the best of its cell."""
        if score.score is not None:
            self._archive.add(Elite(index, candidate.genome, score.score), score.measures)

    def elites(self) -> Sequence[int]:
        """Returns the contents of the archive, the best first."""
        return self._archive.indices()

    def figures(self) -> Mapping[str, float]:
        """Returns how much of the archive is occupied, and the sum of the scores in it."""
        return {"coverage": self._archive.coverage, "qd score": self._archive.quality}
