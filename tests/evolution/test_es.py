"""The algorithm `es`: pairs, ranks and steps, and how far it comes on known functions."""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice
from typing import Any

import numpy as np
import pytest

from nmes.errors import DocumentError
from nmes.evolution.algorithm import Algorithm, Candidate, Measure, Problem, Score
from nmes.evolution.algorithms import load_algorithm
from nmes.genome import Genome
from vectors import WALK, Vector, feed, sphere, vector_genome, vector_of, vector_problem

ONES = [1.0] * 10


def es(problem: Problem | None = None, **options: Any) -> Algorithm:
    return load_algorithm("es", problem or vector_problem(ONES), options)


def judge(function: Callable[[Vector], float]) -> Callable[[Candidate], Score]:
    return lambda candidate: Score(-function(vector_of(candidate.genome)))


def middle(algorithm: Algorithm, index: int) -> Vector:
    """Returns the point that a generation is about."""
    return (vector_of(algorithm.ask(index).genome) + vector_of(algorithm.ask(index + 1).genome)) / 2.0


def test_candidates_are_pairs_on_opposite_sides_of_a_point() -> None:
    algorithm = es(population=8, sigma=0.5)
    assert [algorithm.needs(index) for index in (0, 7, 8, 17)] == [0, 0, 8, 16]
    for index in range(0, 8, 2):
        assert middle(algorithm, index) == pytest.approx(np.array(ONES))
    ways = np.array([vector_of(algorithm.ask(index).genome) - ONES for index in range(0, 8, 2)])
    assert len(np.unique(ways)) == ways.size
    assert 0.3 < ways.std() < 0.7


def test_scores_count_by_their_ranks_alone() -> None:
    plain, bent = es(population=8), es(population=8)
    list(islice(feed(plain, judge(sphere)), 80))
    list(islice(feed(bent, judge(lambda vector: float(np.exp(3.0 * sphere(vector))) - 7.0)), 80))
    assert vector_of(plain.ask(80).genome).tolist() == vector_of(bent.ask(80).genome).tolist()


def test_the_first_step_is_as_long_as_the_rate_and_goes_up() -> None:
    algorithm = es(population=200, rate=0.125)
    list(islice(feed(algorithm, judge(lambda vector: float(vector[3] - 2.0 * vector[7]))), 200))
    step = middle(algorithm, 200) - ONES
    assert np.abs(step) == pytest.approx(0.125, rel=1e-3)  # of Adam's first step all are
    assert step[3] < 0.0 < step[7]


def test_equal_scores_move_nothing_and_none_is_the_least() -> None:
    still = es(population=8)
    list(islice(feed(still, lambda _: Score(4.0)), 16))
    assert middle(still, 16).tolist() == pytest.approx(ONES)
    none, least = es(population=8), es(population=8)
    list(islice(feed(none, lambda each: Score(None if vector_of(each.genome)[0] > 1.0 else 1.0)), 80))
    list(islice(feed(least, lambda each: Score(-9.0 if vector_of(each.genome)[0] > 1.0 else 1.0)), 80))
    assert middle(none, 80).tolist() == middle(least, 80).tolist()
    assert middle(none, 80)[0] < 1.0


def test_equal_scores_share_the_mean_of_their_ranks() -> None:
    # So that to turn all scores around turns all steps around.
    steps = []
    for sign in (1.0, -1.0):
        algorithm = es(population=8)
        for index, score in enumerate([0.0, 1.0, 2.0, 1.0, 0.0, 2.0, 0.0, 0.0] + [2.0, 0.0] * 4):
            algorithm.tell(index, algorithm.ask(index), Score(sign * score))
        steps.append(middle(algorithm, 16) - ONES)
    assert steps[0] == pytest.approx(-steps[1])


def test_decay_brings_the_point_back_to_the_start() -> None:
    farthest = []
    for decay in (0.0, 0.2):
        algorithm = es(population=8, decay=decay)
        list(islice(feed(algorithm, judge(lambda vector: float(-vector.sum()))), 240))
        farthest.append(algorithm.figures()["way"])
    assert 0.0 < farthest[1] < 0.4 * farthest[0]


def test_it_comes_down_a_sphere() -> None:
    algorithm = es()
    list(islice(feed(algorithm, judge(sphere)), 2_000))
    assert sphere(middle(algorithm, algorithm.needs(2_000))) < 0.02


def test_elites_are_the_best_that_were_told() -> None:
    algorithm = es(population=8)
    told = list(islice(feed(algorithm, judge(sphere)), 100))
    best = sorted(told, key=lambda each: (-(each[2].score or 0.0), each[0]))[:10]
    assert algorithm.elites() == [index for index, _, _ in best]


@pytest.mark.parametrize(
    ("problem", "options", "place", "words"),
    [
        (Problem(WALK, 1), {}, "starts", "one to begin with, such as walker"),
        (Problem(WALK, 1, (vector_genome(ONES),), ("a", "b")), {}, "objectives", "the task's score alone"),
        (vector_problem(ONES, 1, Measure("legs", 0, 1, 1)), {}, "measures", "no archive"),
        (vector_problem(ONES), {"population": 7}, "options.population", "must be even"),
        (vector_problem(ONES), {"population": 0}, "options.population", "must be from"),
        (vector_problem(ONES), {"rate": -1.0}, "options.rate", "must be from"),
        (vector_problem(ONES), {"decay": 1.5}, "options.decay", "must be from"),
    ],
)
def test_problems_that_are_none_for_it_are_refused(
    problem: Problem, options: dict[str, Any], place: str, words: str
) -> None:
    with pytest.raises(DocumentError) as caught:
        es(problem, **options)
    assert caught.value.path == place
    assert words in caught.value.message


def test_a_population_that_would_fill_the_memory_with_directions_is_refused() -> None:
    wide = [{"weights": [[0.0] * 100] * 100, "biases": [0.0] * 100} for _ in range(2)]
    document = vector_genome([1.0] * 301).document
    first, last = document["brain"]["layers"]
    genome = Genome({**document, "brain": {"kind": "mlp", "layers": [first, *wide, last]}})
    with pytest.raises(DocumentError, match=r"options\.population: makes 102,505,000 numbers to be kept in memory"):
        es(Problem(WALK, 1, (genome,)), population=10_000)
