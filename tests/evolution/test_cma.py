"""The algorithm `cma`: it needs what the package itself needs, shares nothing, and follows no processor."""

from __future__ import annotations

import os
import pickle
import random
import subprocess
import sys
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
import pytest

from nmes.errors import DocumentError
from nmes.evolution.algorithm import Algorithm, Candidate, Measure, Problem, Score
from nmes.evolution.algorithms import algorithm_options, load_algorithm
from nmes.genome import Genome
from vectors import WALK, evaluations, feed, rosenbrock, sphere, vector_genome, vector_of, vector_problem

TEN = [1.0] * 10


def cma(problem: Problem, **options: Any) -> Algorithm:
    return load_algorithm("cma", problem, options)


def digest(algorithm: Algorithm, count: int) -> list[str]:
    told = feed(algorithm, lambda candidate: Score(-rosenbrock(vector_of(candidate.genome))))
    return [candidate.genome.hash for _, candidate, _ in islice(told, count)]


# Evaluations to 1e-9 in ten dimensions. N. Hansen and A. Ostermeier (2001) and the data of BBOB-2009 have about 1,600
# for the sphere and 6,000 to 7,000 for Rosenbrock's function, some runs of which end in its other minimum first.
@pytest.mark.parametrize(
    ("function", "start", "seeds", "bounds"),
    [
        (sphere, 1.0, [0], (1_300, 2_000)),
        pytest.param(sphere, 1.0, range(15), (1_400, 1_800), marks=pytest.mark.long),
        pytest.param(rosenbrock, 0.0, range(15), (5_500, 7_500), marks=pytest.mark.long),
    ],
)
def test_about_as_many_evaluations_are_needed_as_by_the_main_class_of_the_package(
    function: Any, start: float, seeds: Any, bounds: tuple[int, int]
) -> None:
    problem = [vector_problem([start] * 10, seed) for seed in seeds]
    needed = sorted(evaluations("cma", each, {"sigma": 0.5}, function, 1e-9, 20_000) for each in problem)
    low, high = bounds
    assert low <= needed[len(needed) // 2] <= high, needed


def test_the_generation_follows_from_the_dimension_or_is_given() -> None:
    algorithm = cma(vector_problem(TEN))
    assert [algorithm.needs(index) for index in (0, 9, 10, 25)] == [0, 0, 10, 20]  # 4 + 3 ln 10
    algorithm = cma(vector_problem(TEN), population=6)
    assert [algorithm.needs(index) for index in (5, 6, 13)] == [0, 6, 12]
    assert algorithm.ask(3).genome.document["parents"] == [vector_genome(TEN).hash]


def test_instances_share_no_generator_and_leave_the_global_ones_alone() -> None:
    alone = digest(cma(vector_problem(TEN, 3)), 60)
    np.random.seed(8)
    random.seed(8)
    before = pickle.dumps(np.random.get_state()), random.getstate()
    first, second = cma(vector_problem(TEN, 3)), cma(vector_problem(TEN, 4))
    hashes: list[str] = []
    others = feed(second, lambda candidate: Score(-sphere(vector_of(candidate.genome))))
    for _, candidate, _ in islice(feed(first, lambda each: Score(-rosenbrock(vector_of(each.genome)))), 60):
        hashes.append(candidate.genome.hash)
        next(others)
    assert hashes == alone
    assert (pickle.dumps(np.random.get_state()), random.getstate()) == before
    assert digest(cma(vector_problem(TEN, 5)), 20) != alone[:20]


def test_what_leaves_the_bounds_of_a_parameter_is_evaluated_at_the_bound() -> None:
    algorithm = cma(Problem(WALK, 1, (Genome.load("sidewinder"),)), sigma=50.0)
    drawn = np.array([algorithm.ask(index).genome.brain().to_vector() for index in range(10)])
    frequencies = drawn[:, 0]
    assert frequencies.min() == 0.0 and frequencies.max() <= 100.0
    assert (frequencies == 0.0).sum() < 10


def test_a_search_that_has_converged_begins_anew_at_the_best() -> None:
    algorithm = cma(vector_problem(TEN, 2), population=8)
    best = 0.0
    for _, candidate, score in feed(algorithm, lambda each: Score(-sphere(vector_of(each.genome)))):
        assert score.score is not None
        if algorithm.figures()["restarts"] == 1:
            break
        best = float(np.abs(vector_of(candidate.genome)).max())
    assert algorithm.figures()["step size"] == pytest.approx(0.1)
    assert best < 1e-5
    spread = [np.abs(vector_of(algorithm.ask(index).genome)).max() for index in range(8)]
    assert 0.02 < max(spread) < 0.5


def test_in_co_evolution_scores_of_long_ago_do_not_say_where_a_search_begins_anew() -> None:
    algorithm, told = cma(replace(vector_problem(TEN, 2), role="red"), population=8), 0

    def judge(candidate: Candidate) -> Score:
        nonlocal told
        told += 1
        return Score(1000.0 * (told <= 8) - sphere(vector_of(candidate.genome)))  # the first opponents were weak

    for _ in feed(algorithm, judge):
        if algorithm.figures()["restarts"] == 1:
            break
    spread = [np.abs(vector_of(algorithm.ask(told + index).genome)).max() for index in range(8)]
    assert max(spread) < 0.5


def test_candidates_without_a_score_count_as_the_worst() -> None:
    def half(candidate: Any) -> Score:
        vector = vector_of(candidate.genome)
        return Score(None) if vector[0] > 1.0 else Score(0.0)

    algorithm = cma(vector_problem(TEN), population=10)
    firsts = [vector_of(candidate.genome)[0] for _, candidate, _ in islice(feed(algorithm, half), 200)]
    assert sum(first > 1.0 for first in firsts[:10]) >= 3
    assert sum(first > 1.0 for first in firsts[-50:]) < 15
    assert all(firsts[index] <= 1.0 for index in algorithm.elites())
    nothing = cma(vector_problem(TEN))
    list(islice(feed(nothing, lambda _: Score(None)), 100))
    assert nothing.elites() == []


def test_elites_are_the_best_that_were_told() -> None:
    algorithm = cma(vector_problem(TEN))
    told = list(islice(feed(algorithm, lambda each: Score(-sphere(vector_of(each.genome)))), 200))
    best = sorted(told, key=lambda each: (-(each[2].score or 0.0), each[0]))[:10]
    assert algorithm.elites() == [index for index, _, _ in best]


@pytest.mark.parametrize(
    ("problem", "options", "place", "words"),
    [
        (Problem(WALK, 1), {}, "starts", "one to begin with, such as walker"),
        (Problem(WALK, 1, (vector_genome(TEN),) * 2), {}, "starts", "one to begin with, not 2"),
        (Problem(WALK, 1, (vector_genome(TEN),), ("score", "-energy")), {}, "objectives", "the task's score alone"),
        (vector_problem(TEN, 1, Measure("legs", 0, 1, 1)), {}, "measures", "no archive"),
        (vector_problem([0.0] * 301), {}, "starts/0/brain", "301 parameters, and this algorithm takes 300 at most"),
        (vector_problem(TEN), {"sigma": 0.0}, "options.sigma", "must be from"),
        (vector_problem(TEN), {"sigma": float("nan")}, "options.sigma", "must be from"),
        (vector_problem(TEN), {"population": 1}, "options.population", "2 and more"),
        (vector_problem(TEN), {"population": 10**9}, "options.population", "must be from"),
    ],
)
def test_problems_that_are_none_for_it_are_refused(
    problem: Problem, options: dict[str, Any], place: str, words: str
) -> None:
    with pytest.raises(DocumentError) as caught:
        load_algorithm("cma", problem, options)
    assert caught.value.path == place
    assert words in caught.value.message


def test_a_genome_without_a_brain_or_with_one_that_is_none_is_refused() -> None:
    document = vector_genome(TEN).document
    bare = {name: value for name, value in document.items() if name != "brain"}
    for brain, words in ({}, "has no brain"), ({"brain": {"kind": "mlp", "layers": []}}, "1 to 16 layers"):
        with pytest.raises(DocumentError) as caught:
            cma(Problem(WALK, 1, (Genome({**bare, **brain}),)))
        assert caught.value.path is not None and caught.value.path.startswith("starts/0/")
        assert words in caught.value.message


def test_options_have_defaults() -> None:
    assert algorithm_options("cma") == {"sigma": 0.1, "population": 0}


WITHOUT = """
import sys
sys.modules["cma"] = None
from nmes.errors import MissingPackage
from vectors import load_algorithm, vector_problem
try:
    load_algorithm("cma", vector_problem([0.0] * 10))
except MissingPackage as error:
    print(error.message)
"""


def test_without_the_package_it_says_how_to_get_it() -> None:
    path = os.pathsep.join(sys.path)
    process = subprocess.run(
        [sys.executable, "-c", WITHOUT], capture_output=True, text=True, env={**os.environ, "PYTHONPATH": path}
    )
    assert process.stdout == "this algorithm needs cma: pip install 'nmes[evolve]'\n", process.stderr
