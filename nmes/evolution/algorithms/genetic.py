"""Genetic algorithms over whole genomes: `ga`, tournaments among the young and the best; `afpo`, age against fitness.

Both are steady-state: a candidate is bred as soon as the window allows, from whoever is told by then, so that no worker
waits for the last of a generation. "Generation" counts candidates by the size of the population, from 0, the founders.
"""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from nmes.errors import DocumentError
from nmes.evolution.algorithm import Algorithm, Candidate, Problem, Score
from nmes.evolution.algorithms.bounds import within_bounds
from nmes.evolution.algorithms.breeding import Parent, breed, found, newcomer
from nmes.evolution.algorithms.requirements import check_problem
from nmes.schemas.documents import canonical_hash
from nmes.variation.draw import Draw
from nmes.variation.mutation import KINDS, OF_BRAINS

__all__ = ["AgeFitness", "Genetic", "SteadyStateOptions"]


@dataclass(frozen=True, slots=True, eq=False)
class _Member:
    """A candidate of a population."""

    parent: Parent
    score: float


def _sorted(members: Iterable[_Member]) -> list[_Member]:
    """Returns members with the best first, of equals the first that was told."""
    return sorted(members, key=lambda member: (-member.score, member.parent.index))


@dataclass(frozen=True)
class SteadyStateOptions:
    """What all genetic algorithms are told.

    Attributes:
        founders: How many candidates a run begins with: start genomes and mutants of these, or random creatures.
        population: How many may be parents, and how many candidates are called a generation.
        tournament: Of how many, drawn at random, the best becomes a parent.
        crossover: The part of the offspring that have two parents.
        window: How many candidates may be evaluated at once.
        bodies: Whether bodies vary. Where they do not, or brains do not, nobody is crossed, and start genomes take the
            place of random creatures.
        brains: Whether brains vary, beyond going along with a body.
    """

    founders: int = 200
    population: int = 100
    tournament: int = 5
    crossover: float = 0.25
    window: int = 32
    bodies: bool = True
    brains: bool = True

    def __post_init__(self) -> None:
        many = dict.fromkeys(("founders", "population", "window"), (1, 100_000))
        within_bounds(self, {**many, "tournament": (1, 1_000), "crossover": (0, 1)})
        if not (self.bodies or self.brains):
            raise DocumentError([("options.brains", "either bodies or brains must vary")])

    @property
    def among(self) -> Collection[str]:
        """The kinds of mutation that may be drawn."""
        return [kind for kind in KINDS if (self.brains if kind in OF_BRAINS else self.bodies)]


class _SteadyState(Algorithm):
    """A population that changes with every candidate that is told, and those who are bred from it."""

    def __init__(self, problem: Problem, options: SteadyStateOptions) -> None:
        check_problem(problem)
        self._problem, self._options = problem, options
        self._among = options.among
        self._whole = len(self._among) == len(KINDS)  # whether bodies and brains vary
        if not self._whole and not problem.starts:
            raise DocumentError([("starts", "what does not vary must be given: name a genome to begin with")])
        self._members: Sequence[_Member] = ()

    @abstractmethod
    def _with(self, newcomer: _Member) -> Sequence[_Member]:
        """Returns the population once somebody has come and, where it is full, somebody else has gone."""

    def needs(self, index: int) -> int:
        """Returns how many candidates must be told before: all but the window's."""
        return max(0, index - self._options.window + 1)

    def ask(self, index: int) -> Candidate:
        """Returns the candidate of this index; see `Algorithm`."""
        options, generation = self._options, self._generation(index)
        if generation == 0:
            return found(self._problem, index, self._among)
        if not self._members:
            return newcomer(self._problem, index, generation, self._among)
        crossover = options.crossover if self._whole else 0.0
        return breed(self._problem, index, self._chosen, crossover, generation, self._among)

    def _generation(self, index: int) -> int:
        """Returns 0 for founders, and then how many populations there would have been."""
        return (
            (index - self._options.founders) // self._options.population + 1 if index >= self._options.founders else 0
        )

    def _chosen(self, draw: Draw) -> Parent:
        """Returns the winner of a tournament; of equals, any is as likely."""
        rivals = [draw.one_of(self._members) for _ in range(self._options.tournament)]
        return max(rivals, key=lambda member: member.score).parent

    def tell(self, index: int, candidate: Candidate, score: Score) -> None:
        """Takes a candidate's score in; see `Algorithm`. One without a score has no offspring."""
        if score.score is not None:
            self._members = self._with(_Member(Parent(index, candidate.genome), score.score))

    def elites(self) -> Sequence[int]:
        """Returns the population, the best first."""
        return [member.parent.index for member in _sorted(self._members)]


class Genetic(_SteadyState):
    """A genetic algorithm whose parents are the youngest, and a few who are the best of all.

    Parents are the `population` youngest. Whoever is old goes, however good, but for the elites: what E. Real et al.,
    "Regularized Evolution for Image Classifier Architecture Search" (2019) found to keep a population from being that
    of one ancestor.

    Args:
        problem: What the run is about.
        options: See `Options`.

    Raises:
        DocumentError: There are objectives or measures.
    """

    @dataclass(frozen=True)
    class Options(SteadyStateOptions):
        """Those of all genetic algorithms, and one more.

        Attributes:
            elites: How many of the best of all may be parents for good.
        """

        elites: int = 10

        def __post_init__(self) -> None:
            super().__post_init__()
            within_bounds(self, {"elites": (0, 100_000)})

    def __init__(self, problem: Problem, options: Options) -> None:
        super().__init__(problem, options)
        self._young: deque[_Member] = deque(maxlen=options.population)
        self._best: list[_Member] = []
        self._elites = options.elites

    def _with(self, newcomer: _Member) -> Sequence[_Member]:
        self._young.append(newcomer)
        self._best = _sorted([*self._best, newcomer])[: self._elites]
        return [*self._best, *(member for member in self._young if member not in self._best)]


class AgeFitness(_SteadyState):
    """Age-fitness Pareto optimisation: new bodies compete with the new, so that their brains have time to learn.

    After M. Schmidt and H. Lipson, "Age-Fitness Pareto Optimization" (2011): one random creature comes with each
    generation, and who is dominated, by somebody as young who is better, goes first. As in N. Cheney et al.,
    "Scalable co-optimization of morphology and control in embodied machines" (2018), a creature is as old as its
    body: a child whose body is its first parent's is as old as that one, any other is new. Here the one who is
    dominated by the most goes, of equals the worst, and nothing is drawn for it.

    Args:
        problem: What the run is about.
        options: See `Options`.

    Raises:
        DocumentError: There are objectives or measures.
    """

    @dataclass(frozen=True)
    class Options(SteadyStateOptions):
        """Those of all genetic algorithms, and one more.

        Attributes:
            newcomers: How many random creatures come with each generation, no more than its candidates.
        """

        newcomers: int = 1

        def __post_init__(self) -> None:
            super().__post_init__()
            within_bounds(self, {"newcomers": (0, self.population)})

    def __init__(self, problem: Problem, options: Options) -> None:
        super().__init__(problem, options)
        self._newcomers = options.newcomers
        self._bodies: list[str] = []  # digests, of every candidate that was told
        self._births: list[int] = []  # of their bodies: the index of the candidate in which each was new

    def ask(self, index: int) -> Candidate:
        """Returns the candidate of this index; see `Algorithm`."""
        place = (index - self._options.founders) % self._options.population
        if index >= self._options.founders and place * self._newcomers % self._options.population < self._newcomers:
            return newcomer(self._problem, index, self._generation(index), self._among)
        return super().ask(index)

    def tell(self, index: int, candidate: Candidate, score: Score) -> None:
        """Takes a candidate's score in, and how old its body is; see `Algorithm`."""
        body = canonical_hash(candidate.genome.document["body"])
        first = candidate.parents[0] if candidate.parents else None
        self._births.append(self._births[first] if first is not None and self._bodies[first] == body else index)
        self._bodies.append(body)
        super().tell(index, candidate, score)

    def _birth(self, member: _Member) -> int:
        return self._births[member.parent.index]

    def _with(self, newcomer: _Member) -> Sequence[_Member]:
        members = [*self._members, newcomer]
        if len(members) > self._options.population:
            del members[_least(members, [self._birth(member) for member in members])]
        return members

    def figures(self) -> Mapping[str, float]:
        """Returns how many bodies there are."""
        return {"bodies": len({self._birth(member) for member in self._members})}


def _least(members: Sequence[_Member], births: Sequence[int]) -> int:
    """Returns the place of the member that is dominated by the most; of equals the worst, then the first told."""
    scores = np.array([member.score for member in members])
    born = np.array(births)
    dominated = (scores[:, np.newaxis] > scores) & (born[:, np.newaxis] >= born)
    dominators = dominated.sum(axis=0).tolist()
    return max(range(len(members)), key=lambda i: (dominators[i], -members[i].score, -members[i].parent.index))
