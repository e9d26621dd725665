"""CMA-ME: distributions of brains that adapt to where the archive grows: the algorithm of `cma-me`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Final

from nmes.errors import DocumentError
from nmes.evolution.algorithm import Algorithm, Candidate, Problem, Score
from nmes.evolution.algorithms.bounds import within_bounds, within_memory
from nmes.evolution.algorithms.covariance import CovarianceAdaptation, adaptable_brain, probe
from nmes.evolution.algorithms.requirements import check_problem
from nmes.evolution.archive import Archive, Elite

__all__ = ["CmaMe"]

_MOST_NUMBERS: Final = 10_000_000  # of points and covariances; each is an object of 32 bytes


@dataclass(slots=True, eq=False)
class _Emitter:
    """A distribution, its points that are being evaluated, and what each did for the archive: greater is better.

    The first number is 2 for a new cell, 1 for a better elite and 0 for nothing; the second is the score in a new cell,
    else by how much it is greater than that of the elite that was there.
    """

    strategy: CovarianceAdaptation
    points: list[list[float]]
    deeds: list[tuple[int, float]] = field(default_factory=list)


class CmaMe(Algorithm):
    """Emitters in turn, each a CMA-ES that ranks its candidates by how they improve the archive.

    M. C. Fontaine, J. Togelius, S. Nikolaidis and A. K. Hoover, "Covariance Matrix Adaptation for the Rapid
    Illumination of Behavior Space" (2020), with improvement emitters. An emitter of which no candidate has improved the
    archive, or that has converged, begins anew at an elite, each of which is as likely.

    Args:
        problem: What the run is about: one start genome with a brain, and measures.
        options: See `Options`.

    Raises:
        DocumentError: The problem is another, or the brain has too many parameters, or too many for so many emitters.
        MissingPackage: `cma` is not installed.
    """

    @dataclass(frozen=True)
    class Options:
        """The options.

        Attributes:
            emitters: How many distributions there are.
            batch: How many candidates each draws at a time; 0 for 4 + 3 ln n for n parameters.
            sigma: The standard deviation at first, in each parameter's unit.
        """

        emitters: int = 5
        batch: int = 0
        sigma: float = 0.1

        def __post_init__(self) -> None:
            within_bounds(self, {"emitters": (1, 1_000), "batch": (0, 10_000), "sigma": (1e-9, 1_000_000)})
            if self.batch == 1:
                raise DocumentError([("options.batch", "must be 0, or 2 and more")])

    def __init__(self, problem: Problem, options: Options) -> None:
        check_problem(problem, brain=True, measures=1)
        self._problem, self._options, self._space = problem, options, adaptable_brain(problem, instead="map-elites")
        size = self._space.dimension
        within_memory("emitters", options.emitters * size * (options.batch + 3 * size), _MOST_NUMBERS)
        self._archive, self._restarts = Archive(problem.measures), 0
        self._emitters = [self._begun(number, [0.0] * self._space.dimension) for number in range(options.emitters)]
        self._batch = self._emitters[0].strategy.population

    def _begun(self, block: int, mean: list[float]) -> _Emitter:
        """Returns an emitter that begins with a block of candidates: those of all emitters are counted as one."""
        strategy = CovarianceAdaptation(mean, self._options.sigma, self._options.batch)
        return _Emitter(strategy, strategy.sample(self._problem.draw("block", block)))

    def needs(self, index: int) -> int:
        """Returns the index after the block that the candidate's emitter had before."""
        return max(0, index // self._batch - self._options.emitters + 1) * self._batch

    def ask(self, index: int) -> Candidate:
        """Returns the candidate of this index; see `Algorithm`."""
        block, place = divmod(index, self._batch)
        generation, number = divmod(block, self._options.emitters)
        point = self._emitters[number].points[place]
        return Candidate(self._space.genome(point), "sample", (), generation, f"emitter {number + 1}")

    def tell(self, index: int, candidate: Candidate, score: Score) -> None:
        """Puts a candidate into the archive, if it is the best of its cell; the last of a block moves the emitter."""
        block = index // self._batch
        number = block % self._options.emitters
        emitter = self._emitters[number]
        emitter.deeds.append(self._added(index, candidate, score))
        if len(emitter.deeds) == self._batch:
            self._emitters[number] = self._moved(emitter, block + self._options.emitters)

    def _added(self, index: int, candidate: Candidate, score: Score) -> tuple[int, float]:
        if score.score is None:
            return 0, -inf
        self._space.point(candidate.genome)  # of a log it may be none: that is to be told now, not at some restart
        gain = self._archive.add(Elite(index, candidate.genome, score.score), score.measures)
        return (2, score.score) if gain is None else (int(gain > 0.0), gain)

    def _moved(self, emitter: _Emitter, block: int) -> _Emitter:
        """Returns an emitter after its block was told, with the next one."""
        if any(kind for kind, _ in emitter.deeds):
            order = sorted(range(self._batch), key=emitter.deeds.__getitem__)
            ranks = [0.0] * self._batch
            for rank, place in enumerate(order):
                ranks[place] = float(rank)
            emitter.strategy.learn(emitter.points, ranks)
            if not emitter.strategy.converged:
                return _Emitter(emitter.strategy, emitter.strategy.sample(self._problem.draw("block", block)))
        self._restarts += 1
        if not len(self._archive):
            return self._begun(block, [0.0] * self._space.dimension)
        elite = self._archive[self._problem.draw("elite", block).count(0, len(self._archive) - 1)]
        return self._begun(block, self._space.point(elite.genome))

    def elites(self) -> Sequence[int]:
        """Returns the contents of the archive, the best first."""
        return self._archive.indices()

    def probe(self) -> str:
        """Returns a digest of what `cma` computes here."""
        return probe()

    def figures(self) -> Mapping[str, float]:
        """Returns how much of the archive is occupied, the sum of its scores, and how often emitters began anew."""
        return {"coverage": self._archive.coverage, "qd score": self._archive.quality, "restarts": self._restarts}
