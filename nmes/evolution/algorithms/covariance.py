"""Covariance matrix adaptation: a normal distribution that moves to where the values are better, of the package `cma`.

Hides the package. It is `cma.purecma` that is used, the CMA-ES (N. Hansen, "The CMA Evolution Strategy: A Tutorial",
2016) by its author in plain Python numbers, which is the same to the last bit on every processor: what the package's
main class computes with numpy depends on BLAS, and draws from a generator that all instances share. It costs some
milliseconds a generation up to a hundred dimensions, and grows with their cube: hence `_MOST_DIMENSIONS`.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import cache
from hashlib import blake2b
from itertools import pairwise
from math import inf
from typing import Any, Final

import orjson

from nmes.backend.rotation import total
from nmes.errors import DocumentError, MissingPackage
from nmes.evolution.algorithm import Problem
from nmes.evolution.algorithms.brain_space import BrainSpace
from nmes.variation.draw import Draw

__all__ = ["CovarianceAdaptation", "adaptable_brain", "probe"]

_MOST_DIMENSIONS: Final = 300  # there a generation takes some seconds
_WIDENED: Final = 1e6  # of the first step size: nothing that is found there is ever small again


@cache
def _purecma() -> Any:
    """Returns the package's module.

    Raises:
        MissingPackage: It is not installed.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # that nothing can be plotted
            from cma import purecma
    except ImportError as error:
        raise MissingPackage("this algorithm needs cma: pip install 'nmes[evolve]'") from error
    return purecma


def adaptable_brain(problem: Problem, *, instead: str) -> BrainSpace:
    """Returns the space of the start genome's brain, which a distribution can adapt to.

    Args:
        problem: What a run is about: one start genome, with a brain.
        instead: The algorithm for brains that are too large.

    Raises:
        DocumentError: The brain has too many parameters.
    """
    space = BrainSpace(problem.starts[0])
    if space.dimension > _MOST_DIMENSIONS:
        size = f"the brain has {space.dimension:,} parameters, and this algorithm takes {_MOST_DIMENSIONS} at most"
        raise DocumentError([("starts/0/brain", f"{size}; {instead} takes any number")])
    return space


class CovarianceAdaptation:
    """A normal distribution that adapts.

    Args:
        mean: Where it begins.
        sigma: The standard deviation along each axis at first.
        population: How many points a generation has; 0 for 4 + 3 ln n in n dimensions.

    Raises:
        MissingPackage: `cma` is not installed.
    """

    def __init__(self, mean: Sequence[float], sigma: float, population: int) -> None:
        self._first = sigma
        self._strategy = _purecma().CMAES(list(map(float, mean)), sigma, popsize=population or None)

    @property
    def population(self) -> int:
        """How many points a generation has."""
        return int(self._strategy.params.lam)

    @property
    def sigma(self) -> float:
        """The step size."""
        return float(self._strategy.sigma)

    @property
    def converged(self) -> bool:
        """Whether nothing is to be gained from going on: it is too narrow, too wide, too long, or all are alike."""
        return bool(self._strategy.stop()) or self.sigma > _WIDENED * self._first

    def sample(self, draw: Draw) -> list[list[float]]:
        """Draws the points of a generation."""
        self._strategy.randn = lambda mean, spread: mean + draw.normal(spread)
        points: list[list[float]] = self._strategy.ask()
        return points

    def learn(self, points: Sequence[list[float]], values: Sequence[float | None]) -> None:
        """Adapts to the values of a generation's points: greater is better, None the worst of all."""
        self._strategy.tell(list(points), [inf if value is None else -value for value in values])


@cache
def probe() -> str:
    """Returns a digest of what the package computes here: a few generations on a valley that bends.

    Raises:
        MissingPackage: `cma` is not installed.
    """
    strategy, draw = CovarianceAdaptation([0.5] * 8, 0.3, 0), Draw(0, "probe")
    for _ in range(20):
        points = strategy.sample(draw)
        strategy.learn(points, list(map(_valley, points)))
    return blake2b(orjson.dumps(strategy.sample(draw)), digest_size=16).hexdigest()


def _valley(point: Sequence[float]) -> float:
    """Returns Rosenbrock's function, to be maximised."""
    return -total(100.0 * (b - a * a) ** 2 + (1.0 - a) ** 2 for a, b in pairwise(point))
