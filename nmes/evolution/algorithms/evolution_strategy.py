"""A natural evolution strategy over the parameters of a brain: the algorithm of `es`.

T. Salimans, J. Ho, X. Chen, S. Sidor and I. Sutskever, "Evolution Strategies as a Scalable Alternative to Reinforcement
Learning" (2017), with the step of D. P. Kingma and J. Ba, "Adam: A Method for Stochastic Optimization" (2015). All sums
are taken in one order, element by element, so that they are the same on every processor.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from math import inf
from typing import Final

import numpy as np

from nmes.backend import Array
from nmes.errors import DocumentError
from nmes.evolution.algorithm import Algorithm, Candidate, Problem, Score
from nmes.evolution.algorithms.best import Best
from nmes.evolution.algorithms.bounds import within_bounds, within_memory
from nmes.evolution.algorithms.brain_space import BrainSpace
from nmes.evolution.algorithms.requirements import check_problem

__all__ = ["EvolutionStrategy"]

_FIRST, _SECOND, _SMALL = 0.9, 0.999, 1e-8  # of Adam: how slowly the two moments change, and what is added to a root
_LARGEST: Final = 10_000
_MOST_NUMBERS: Final = 50_000_000  # of directions; each has 8 bytes


class EvolutionStrategy(Algorithm):
    """A point that climbs: by what the scores of pairs on opposite sides of it tell of the slope.

    The scores of a generation count by their ranks alone, from -1/2 to 1/2.

    Args:
        problem: What the run is about: one start genome, with a brain.
        options: See `Options`.

    Raises:
        DocumentError: The problem is another, or the brain has too many parameters for such a population.
    """

    @dataclass(frozen=True)
    class Options:
        """The options.

        Attributes:
            population: How many candidates a generation has, two of each pair.
            sigma: How far from the point they are: the standard deviation, in each parameter's unit.
            rate: How far the point goes in a generation at first, in each parameter's unit.
            decay: By which part the way from the start genome is shortened in each generation.
        """

        population: int = 32
        sigma: float = 0.05
        rate: float = 0.02
        decay: float = 0.0

        def __post_init__(self) -> None:
            steps = {"sigma": (1e-9, 1_000_000), "rate": (1e-9, 1_000_000), "decay": (0, 1)}
            within_bounds(self, {"population": (2, _LARGEST), **steps})
            if self.population % 2:
                raise DocumentError([("options.population", f"must be even, for pairs, not {self.population}")])

    def __init__(self, problem: Problem, options: Options) -> None:
        check_problem(problem, brain=True)
        self._problem, self._options, self._space = problem, options, BrainSpace(problem.starts[0])
        within_memory("population", options.population // 2 * self._space.dimension, _MOST_NUMBERS)
        self._point, self._mean, self._square = np.zeros((3, self._space.dimension))
        self._generation = 0
        self._best = Best()
        self._scores: list[float | None] = []
        self._noise = self._drawn()

    def _drawn(self) -> list[Array]:
        """Returns the directions of a generation's pairs."""
        draw = self._problem.draw("generation", self._generation)
        return [draw.normals(self._space.dimension) for _ in range(self._options.population // 2)]

    def needs(self, index: int) -> int:
        """Returns the first index of the candidate's generation."""
        return index - index % self._options.population

    def ask(self, index: int) -> Candidate:
        """Returns the candidate of this index; see `Algorithm`."""
        pair, side = divmod(index % self._options.population, 2)
        way = self._options.sigma * self._noise[pair]
        genome = self._space.genome(self._point - way if side else self._point + way)
        return Candidate(genome, "sample", (), self._generation)

    def tell(self, index: int, candidate: Candidate, score: Score) -> None:
        """Takes a candidate's score in; the last of a generation moves the point."""
        self._best.add(index, score.score)
        self._scores.append(score.score)
        if len(self._scores) == self._options.population:
            self._climb(_ranks(self._scores))
            self._generation += 1
            self._scores, self._noise = [], self._drawn()

    def _climb(self, ranks: Sequence[float]) -> None:
        options, slope = self._options, np.zeros(self._space.dimension)
        for noise, up, down in zip(self._noise, ranks[::2], ranks[1::2], strict=True):
            slope += (up - down) * noise
        slope /= options.population * options.sigma
        self._mean = _FIRST * self._mean + (1.0 - _FIRST) * slope
        self._square = _SECOND * self._square + (1.0 - _SECOND) * slope * slope
        age = self._generation + 1
        mean, square = self._mean / (1.0 - _FIRST**age), self._square / (1.0 - _SECOND**age)
        self._point = (1.0 - options.decay) * self._point + options.rate * mean / (np.sqrt(square) + _SMALL)

    def elites(self) -> Sequence[int]:
        """Returns the best of all that were told."""
        return self._best.indices

    def figures(self) -> Mapping[str, float]:
        """Returns the greatest way that a parameter has come from the start genome."""
        return {"way": float(np.abs(self._point).max())}


def _ranks(scores: Sequence[float | None]) -> list[float]:
    """Returns the ranks of scores from -1/2, the least, to 1/2; equal scores share theirs, and None is the least."""
    values = [-inf if score is None else score for score in scores]
    ranks, below = [0.0] * len(values), 0
    for _, group in groupby(sorted(range(len(values)), key=values.__getitem__), key=values.__getitem__):
        places = list(group)
        for place in places:
            ranks[place] = (below + (len(places) - 1) / 2.0) / (len(values) - 1) - 0.5
        below += len(places)
    return ranks
