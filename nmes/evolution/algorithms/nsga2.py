"""NSGA-II: bodies and brains for several objectives at once: the algorithm of `nsga2`.

K. Deb, A. Pratap, S. Agarwal and T. Meyarivan, "A Fast and Elitist Multiobjective Genetic Algorithm: NSGA-II" (IEEE
Transactions on Evolutionary Computation 6, 2002). Objectives are maximised here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from nmes.backend import Array
from nmes.evolution.algorithm import Algorithm, Candidate, Problem, Score
from nmes.evolution.algorithms.bounds import within_bounds
from nmes.evolution.algorithms.breeding import Parent, breed, found
from nmes.evolution.algorithms.requirements import check_problem
from nmes.variation.draw import Draw

__all__ = ["Nsga2", "crowding", "fronts", "survivors"]


def fronts(objectives: Array) -> list[list[int]]:
    """Sorts by domination: a member is in the first front if no other is as good in all objectives and better in one.

    Args:
        objectives: Shape (members, objectives), to be maximised.

    Returns:
        The places of the members of each front, ascending; the members of each are dominated only by those before.
    """
    no_less = np.asarray((objectives[:, None, :] >= objectives[None, :, :]).all(axis=2))
    dominates = no_less & ~no_less.T
    left = dominates.sum(axis=0)  # how many dominate each
    found: list[list[int]] = []
    while (left >= 0).any():
        front = np.flatnonzero(left == 0)
        left = left - dominates[front].sum(axis=0)
        left[front] = -1
        found.append(front.tolist())
    return found


def crowding(objectives: Array) -> Array:
    """Returns how far from its neighbours each member of a front is: along each objective, in parts of its range.

    Args:
        objectives: Shape (members, objectives), of one front.

    Returns:
        Shape (members,); infinite for the ends of the front.
    """
    distances = np.zeros(len(objectives))
    for values in objectives.T:
        order = np.argsort(values, kind="stable")
        distances[order[[0, -1]]] = inf
        extent = values[order[-1]] - values[order[0]]
        if extent > 0.0:
            distances[order[1:-1]] += (values[order[2:]] - values[order[:-2]]) / extent
    return distances


def survivors(objectives: Array, count: int) -> list[tuple[int, int, float]]:
    """Selects members: the first fronts as far as they fit, and of the next those with the most room.

    Args:
        objectives: Shape (members, objectives), to be maximised.
        count: How many to select.

    Returns:
        At most `count` of them, the best first: the place, the number of the front, and the crowding distance in it.
    """
    selected: list[tuple[int, int, float]] = []
    for number, front in enumerate(fronts(objectives)):
        distances = crowding(objectives[front]).tolist()
        ranked = sorted(zip(front, distances, strict=True), key=lambda each: (-each[1], each[0]))
        selected += [(place, number, distance) for place, distance in ranked[: count - len(selected)]]
        if len(selected) == count:
            break
    return selected


@dataclass(frozen=True, slots=True, eq=False)
class _Member:
    parent: Parent
    objectives: tuple[float, ...]
    rank: tuple[int, float]  # the front, and minus the distance: less is better


class Nsga2(Algorithm):
    """Generations that are selected, parents and offspring together, by fronts and by how much room they have.

    Args:
        problem: What the run is about, with two objectives or more. Without start genomes it begins with random
            creatures.
        options: See `Options`.

    Raises:
        DocumentError: The problem is another.
    """

    @dataclass(frozen=True)
    class Options:
        """The options.

        Attributes:
            population: How many candidates a generation has, and how many of them and of their parents live on.
            crossover: In which part of the cases two parents are crossed.
        """

        population: int = 100
        crossover: float = 0.3

        def __post_init__(self) -> None:
            within_bounds(self, {"population": (2, 2_000), "crossover": (0, 1)})

    def __init__(self, problem: Problem, options: Options) -> None:
        check_problem(problem, objectives=2)
        self._problem, self._options = problem, options
        self._members: list[_Member] = []  # the best first
        self._offspring: list[_Member] = []
        self._told = 0

    def needs(self, index: int) -> int:
        """Returns the first index of the candidate's generation."""
        return index - index % self._options.population

    def ask(self, index: int) -> Candidate:
        """Returns the candidate of this index; see `Algorithm`."""
        generation = index // self._options.population
        if generation == 0 or not self._members:
            return found(self._problem, index)
        return breed(self._problem, index, self._parent, self._options.crossover, generation)

    def _parent(self, draw: Draw) -> Parent:
        """Returns the better of two: by fronts, then by room; of equals the first that was drawn."""
        return min(draw.one_of(self._members), draw.one_of(self._members), key=lambda member: member.rank).parent

    def tell(self, index: int, candidate: Candidate, score: Score) -> None:
        """Takes a candidate's objectives in; with the last of a generation those who live on are selected."""
        self._told = index + 1
        if score.score is not None:
            self._offspring.append(_Member(Parent(index, candidate.genome), score.objectives, (0, 0.0)))
        if self._told % self._options.population == 0:
            self._members = self._selected(self._options.population)
            self._offspring = []

    def _selected(self, count: int) -> list[_Member]:
        """Returns the best of the parents and the offspring that were told."""
        everybody = sorted([*self._members, *self._offspring], key=lambda member: member.parent.index)
        if not everybody:
            return []
        chosen = survivors(np.array([member.objectives for member in everybody]), count)
        return [
            _Member(everybody[place].parent, everybody[place].objectives, (front, -distance))
            for place, front, distance in chosen
        ]

    def elites(self) -> Sequence[int]:
        """Returns the first front of all that live or were told since, the ends first, then those with most room."""
        everybody = self._selected(len(self._members) + len(self._offspring))
        return [member.parent.index for member in everybody if member.rank[0] == 0]

    def figures(self) -> Mapping[str, float]:
        """Returns how large the first front is."""
        return {"front": len(self.elites())}
