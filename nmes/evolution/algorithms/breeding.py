"""How candidates are made of others: where a run begins, and offspring of parents that are told.

Hides what happens when an operator finds no offspring: another parent or operator is drawn, and in the end a random
creature takes the place. So no run fails for want of offspring where there are random creatures at all.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Final

from nmes.errors import VariationError
from nmes.evolution.algorithm import Candidate, Problem
from nmes.genome import Genome
from nmes.variation.crossover import cross
from nmes.variation.draw import Draw
from nmes.variation.mutation import KINDS, mutate
from nmes.variation.random_genomes import random_genome

__all__ = ["Parent", "breed", "found", "newcomer"]

_TRIES: Final = 5
_MORE: Final = 0.3  # chance of one more mutation, and of another after that
_MOST: Final = 4  # mutations at once


@dataclass(frozen=True, slots=True, eq=False)
class Parent:
    """A candidate that was told: its index, and its genome."""

    index: int
    genome: Genome


def newcomer(problem: Problem, index: int, generation: int = 0, among: Collection[str] = KINDS) -> Candidate:
    """Returns a random creature; a start genome where not all kinds of mutation may be drawn, since something stays.

    Raises:
        VariationError: `no_offspring`: the task allows none.
    """
    if len(among) < len(KINDS):
        return Candidate(problem.starts[index % len(problem.starts)], "start", (), generation)
    genome = random_genome(problem.draw("candidate", index, "random"), problem.requirements, f"random-{index}")
    return Candidate(genome, "random", (), generation)


def found(problem: Problem, index: int, among: Collection[str] = KINDS) -> Candidate:
    """Returns a candidate to begin with: a start genome, then mutants of these in turn; or a random creature.

    Args:
        problem: What the run is about.
        index: The candidate's.
        among: The kinds of mutation that may be drawn.

    Raises:
        VariationError: `no_offspring`: the task allows no random creature.
    """
    if not problem.starts:
        return newcomer(problem, index)
    place = index % len(problem.starts)
    start = Parent(place, problem.starts[place])
    if index == place:
        return Candidate(start.genome, "start")
    return breed(problem, index, lambda _: start, 0.0, 0, among)


def breed(
    problem: Problem,
    index: int,
    choose: Callable[[Draw], Parent],
    crossover: float,
    generation: int,
    among: Collection[str] = KINDS,
) -> Candidate:
    """Returns an offspring.

    Args:
        problem: What the run is about.
        index: The candidate's, from which all choices follow.
        choose: Draws a parent.
        crossover: In which part of the cases two parents are crossed, from 0 to 1; a child is mutated too in half of
            these, and in all others.
        generation: The candidate's.
        among: The kinds of mutation that may be drawn.

    Raises:
        VariationError: `no_offspring`: no parent has offspring, and the task allows no random creature.
    """
    draw = problem.draw("candidate", index)
    for _ in range(_TRIES):
        parent = choose(draw)
        try:
            other = choose(draw) if draw.chance(crossover) else None
            return _offspring(problem, draw, parent, other, generation, among)
        except VariationError:
            continue  # another parent, or another operator
    return newcomer(problem, index, generation, among)


def _offspring(
    problem: Problem, draw: Draw, parent: Parent, other: Parent | None, generation: int, among: Collection[str]
) -> Candidate:
    """Returns a child of one parent or two.

    Raises:
        VariationError: None was found.
    """
    genome, operators, parents = parent.genome, list[str](), [parent]
    if other is not None and other.index != parent.index:
        genome = cross(genome, other.genome, draw, requirements=problem.requirements)
        operators.append("cross")
        parents.append(other)
    mutations = 0 if operators and draw.chance(0.5) else 1
    while mutations and mutations < _MOST and draw.chance(_MORE):
        mutations += 1
    for _ in range(mutations):
        genome, kind = _mutated(genome, draw, problem, among)
        operators.append(kind)
    document = {**genome.document, "parents": list(dict.fromkeys(each.genome.hash for each in parents))}
    return Candidate(Genome(document), "+".join(operators), tuple(each.index for each in parents), generation)


def _mutated(genome: Genome, draw: Draw, problem: Problem, among: Collection[str]) -> tuple[Genome, str]:
    mutant = mutate(genome, draw, among=among, requirements=problem.requirements)
    return mutant.genome, mutant.kind
