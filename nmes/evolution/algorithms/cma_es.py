"""CMA-ES over the parameters of a brain: the algorithm of `cma`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from nmes.errors import DocumentError
from nmes.evolution.algorithm import Algorithm, Candidate, Problem, Score
from nmes.evolution.algorithms.best import Best
from nmes.evolution.algorithms.bounds import within_bounds
from nmes.evolution.algorithms.covariance import CovarianceAdaptation, adaptable_brain, probe
from nmes.evolution.algorithms.requirements import check_problem

__all__ = ["CmaEs"]


class CmaEs(Algorithm):
    """Generations of brains from a normal distribution that adapts its mean, step size and covariance.

    N. Hansen and A. Ostermeier, "Completely Derandomized Self-Adaptation in Evolution Strategies" (Evolutionary
    Computation 9, 2001). Where a distribution has converged, another begins at the best brain so far; in co-evolution
    at the best of the last generation, since earlier scores are of other opponents.

    Args:
        problem: What the run is about: one start genome, with a brain.
        options: See `Options`.

    Raises:
        DocumentError: The problem is another, or the brain has too many parameters.
        MissingPackage: `cma` is not installed.
    """

    @dataclass(frozen=True)
    class Options:
        """The options.

        Attributes:
            sigma: The standard deviation at first, in each parameter's unit.
            population: How many candidates a generation has; 0 for 4 + 3 ln n for n parameters.
        """

        sigma: float = 0.1
        population: int = 0

        def __post_init__(self) -> None:
            within_bounds(self, {"sigma": (1e-9, 1_000_000), "population": (0, 10_000)})
            if self.population == 1:
                raise DocumentError([("options.population", "must be 0, or 2 and more")])

    def __init__(self, problem: Problem, options: Options) -> None:
        check_problem(problem, brain=True)
        self._problem, self._options, self._space = problem, options, adaptable_brain(problem, instead="es")
        self._generation = self._restarts = 0
        self._best = Best()
        self._top: tuple[float, list[float]] | None = None
        self._begin([0.0] * self._space.dimension)

    def _begin(self, mean: list[float]) -> None:
        self._strategy = CovarianceAdaptation(mean, self._options.sigma, self._options.population)
        self._sample()

    def _sample(self) -> None:
        self._points = self._strategy.sample(self._problem.draw("generation", self._generation))
        self._scores: list[float | None] = []

    def needs(self, index: int) -> int:
        """Returns the first index of the candidate's generation."""
        return index - index % self._strategy.population

    def ask(self, index: int) -> Candidate:
        """Returns the candidate of this index; see `Algorithm`."""
        point = self._points[index % len(self._points)]
        return Candidate(self._space.genome(point), "sample", (), self._generation)

    def tell(self, index: int, candidate: Candidate, score: Score) -> None:
        """Takes a candidate's score in; the last of a generation moves the distribution."""
        self._best.add(index, score.score)
        self._scores.append(score.score)
        if score.score is not None and (self._top is None or score.score > self._top[0]):
            self._top = score.score, self._points[index % len(self._points)]
        if len(self._scores) == len(self._points):
            self._strategy.learn(self._points, self._scores)
            self._generation += 1
            if self._strategy.converged and self._top is not None:
                self._restarts += 1
                self._begin(self._top[1])
            else:
                self._sample()
            if self._problem.role:
                self._top = None

    def elites(self) -> Sequence[int]:
        """Returns the best of all that were told."""
        return self._best.indices

    def probe(self) -> str:
        """Returns a digest of what `cma` computes here."""
        return probe()

    def figures(self) -> Mapping[str, float]:
        """Returns the step size and how often the search has begun anew."""
        return {"step size": self._strategy.sigma, "restarts": self._restarts}
