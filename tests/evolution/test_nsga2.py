"""The algorithm `nsga2`: its sorting, known problems, and what it does with genomes."""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice
from math import inf
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nmes.errors import DocumentError
from nmes.evolution.algorithm import Algorithm, Candidate, Measure, Problem, Score
from nmes.evolution.algorithms import load_algorithm
from nmes.evolution.algorithms.nsga2 import crowding, fronts, survivors
from nmes.genome import Genome
from vectors import WALK, feed

Array = npt.NDArray[np.float64]
Function = Callable[[Array], Array]

# -- sorting ----------------------------------------------------------------------------------------------------------

POINTS = st.lists(st.tuples(*[st.integers(0, 4).map(float)] * 2), min_size=1, max_size=20)


def dominates(one: Array, other: Array) -> bool:
    return bool((one >= other).all() and (one > other).any())


@given(POINTS)
@settings(max_examples=100, derandomize=True, deadline=None)
def test_a_front_is_dominated_by_those_before_and_by_none_of_its_own(points: list[tuple[float, ...]]) -> None:
    objectives = np.array(points)
    found = fronts(objectives)
    assert sorted(place for front in found for place in front) == list(range(len(points)))
    for number, front in enumerate(found):
        assert front == sorted(front)
        for place in front:
            rivals = [other for later in found[number:] for other in later]
            assert not any(dominates(objectives[other], objectives[place]) for other in rivals)
            if number:
                assert any(dominates(objectives[other], objectives[place]) for other in found[number - 1])


def test_crowding_is_the_way_around_a_member_in_parts_of_the_front() -> None:
    front = np.array([[0.0, 10.0], [1.0, 8.0], [4.0, 0.0], [2.0, 5.0]])
    assert crowding(front).tolist() == [inf, 2 / 4 + 5 / 10, inf, 3 / 4 + 8 / 10]
    assert crowding(np.array([[1.0, 1.0]] * 3)).tolist() == [inf, 0.0, inf]
    assert crowding(np.array([[1.0, 1.0]])).tolist() == [inf]


def test_of_the_front_that_does_not_fit_those_with_room_survive() -> None:
    objectives = np.array([[0.0, 0.0], [1.0, 9.0], [9.0, 1.0], [4.0, 4.0], [4.5, 3.9], [6.0, 3.0], [5.0, 0.5]])
    chosen = survivors(objectives, 4)
    assert [place for place, _, _ in chosen] == [1, 2, 3, 5]
    assert {front for _, front, _ in chosen} == {0}
    assert [(place, front) for place, front, _ in survivors(objectives, 6)][4:] == [(4, 0), (6, 1)]
    assert len(survivors(objectives, 100)) == 7


# -- known problems ---------------------------------------------------------------------------------------------------


def zdt1(x: Array) -> Array:
    """Returns the objectives of ZDT1, to be minimised, of vectors (n, 30)."""
    g = 1.0 + 9.0 * x[:, 1:].mean(axis=1)
    return np.stack([x[:, 0], g * (1.0 - np.sqrt(x[:, 0] / g))], axis=1)


def zdt2(x: Array) -> Array:
    """Returns those of ZDT2."""
    g = 1.0 + 9.0 * x[:, 1:].mean(axis=1)
    return np.stack([x[:, 0], g * (1.0 - (x[:, 0] / g) ** 2)], axis=1)


def offspring(parents: Array, draw: np.random.Generator) -> Array:
    """Returns children of pairs by simulated binary crossover and polynomial mutation, as Deb et al. have them."""
    one, other = parents[::2], parents[1::2]
    u = draw.random(one.shape)
    spread = np.where(u <= 0.5, (2.0 * u) ** (1 / 21), (0.5 / (1.0 - u)) ** (1 / 21))
    crossed = (draw.random(one.shape) < 0.5) & (draw.random((len(one), 1)) < 0.9)
    spread = np.where(crossed, spread, 1.0)
    spread = np.where(crossed & (draw.random(one.shape) < 0.5), -spread, spread)  # which child is nearer to which
    children = np.concatenate([(1 + spread) * one + (1 - spread) * other, (1 - spread) * one + (1 + spread) * other])
    u = draw.random(children.shape)
    step = np.where(u < 0.5, (2.0 * u) ** (1 / 21) - 1.0, 1.0 - (2.0 * (1.0 - u)) ** (1 / 21))
    mutated = draw.random(children.shape) < 1 / children.shape[1]
    return np.clip(children / 2.0 + np.where(mutated, step, 0.0), 0.0, 1.0)


# Deb et al. (2002), table II: the mean distance of the real-coded algorithm's front from the true one after 250
# generations of 100.
@pytest.mark.parametrize(("function", "published"), [(zdt1, 0.033482), (zdt2, 0.072391)])
def test_fronts_come_as_close_to_the_true_one_as_published(function: Function, published: float) -> None:
    draw = np.random.default_rng(2)
    members = draw.random((100, 30))
    ranks = [rank[1:] for rank in survivors(-function(members), 100)]
    for _ in range(250):
        pairs = draw.integers(0, 100, (100, 2))
        winners = [min(pair, key=lambda place: (ranks[place][0], -ranks[place][1])) for pair in pairs.tolist()]
        everybody = np.concatenate([members, offspring(members[winners], draw)])
        chosen = survivors(-function(everybody), 100)
        members, ranks = everybody[[place for place, _, _ in chosen]], [rank[1:] for rank in chosen]
    first = np.linspace(0.0, 1.0, 500)
    true = function(np.concatenate([first[:, None], np.zeros((500, 29))], axis=1))
    found = function(members)
    distances = np.sqrt(((found[:, None] - true[None]) ** 2).sum(axis=2)).min(axis=1)
    assert distances.mean() <= published
    assert np.ptp(found[:, 0]) > 0.95, "it is a part of the front"


# -- genomes ----------------------------------------------------------------------------------------------------------

OBJECTIVES = ("mass", "-length")
WALKER = Genome.load("walker")


def heavy_and_short(candidate: Candidate) -> Score:
    body = candidate.genome.body
    return Score(1.0, (body.mass, body.bounds[0][0] - body.bounds[1][0]))


def nsga2(problem: Problem | None = None, **options: Any) -> Algorithm:
    return load_algorithm("nsga2", problem or Problem(WALK, 3, (WALKER,), OBJECTIVES), options)


def test_generations_of_genomes_come_to_dominate_those_before() -> None:
    algorithm = nsga2(population=20)
    assert [algorithm.needs(index) for index in (0, 19, 20, 59)] == [0, 0, 20, 40]
    told = list(islice(feed(algorithm, heavy_and_short), 160))
    objectives = np.array([score.objectives for _, _, score in told])
    elites = algorithm.elites()
    # The outcome is the first front of all: what was best is never lost, as long as the front is no larger than a
    # generation.
    first = fronts(objectives)[0]
    assert len(first) <= 20
    assert set(elites) <= set(first)
    assert {tuple(objectives[place]) for place in elites} == {tuple(objectives[place]) for place in first}
    assert objectives[elites].max(axis=0)[0] > objectives[:20].max(axis=0)[0]
    assert algorithm.figures() == {"front": len(elites)}
    assert {candidate.generation for _, candidate, _ in told} == set(range(8))


def test_parents_are_the_survivors_of_the_generation_before() -> None:
    algorithm = nsga2(population=10)
    told = list(islice(feed(algorithm, heavy_and_short), 20))
    objectives = np.array([score.objectives for _, _, score in told])
    alive = {place for place, _, _ in survivors(objectives, 10)}
    parents = {parent for index in range(20, 30) for parent in algorithm.ask(index).parents}
    assert parents and parents <= alive


def test_who_has_no_score_is_no_parent() -> None:
    algorithm = nsga2(population=10)

    def scores(candidate: Candidate) -> Score:
        return Score(None) if candidate.genome.body.mass > WALKER.body.mass else heavy_and_short(candidate)

    told = list(islice(feed(algorithm, scores), 30))
    dead = {index for index, _, score in told if score.score is None}
    assert dead and dead.isdisjoint(algorithm.elites())
    assert dead.isdisjoint({parent for index in range(30, 40) for parent in algorithm.ask(index).parents})
    nobody = nsga2(population=2)
    assert len(list(islice(feed(nobody, lambda _: Score(None)), 6))) == 6
    assert nobody.elites() == []


@pytest.mark.parametrize(
    ("problem", "options", "place", "words"),
    [
        (Problem(WALK, 1), {}, "objectives", "needs 2 or more; none given"),
        (Problem(WALK, 1, (), ("score",)), {}, "objectives", "needs 2 or more; 1 given"),
        (Problem(WALK, 1, (), OBJECTIVES, (Measure("legs", 0, 1, 1),)), {}, "measures", "no use for measures"),
        (Problem(WALK, 1, (), OBJECTIVES), {"population": 1}, "options.population", "must be from"),
    ],
)
def test_problems_that_are_none_for_it_are_refused(
    problem: Problem, options: dict[str, Any], place: str, words: str
) -> None:
    with pytest.raises(DocumentError) as caught:
        nsga2(problem, **options)
    assert caught.value.path == place
    assert words in caught.value.message
