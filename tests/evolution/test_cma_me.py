"""The algorithm `cma-me`: as much of an archive as pyribs fills, in blocks that do not wait for each other."""

from __future__ import annotations

from itertools import islice
from typing import Any

import numpy as np
import pytest

from nmes.errors import DocumentError
from nmes.evolution.algorithm import Algorithm, Candidate, Measure, Problem, Score
from nmes.evolution.algorithms import load_algorithm
from nmes.evolution.archive import cell
from vectors import WALK, feed, vector_genome, vector_of, vector_problem

ZEROS = [0.0] * 10


def grid(dimension: int, cells: int) -> tuple[Measure, Measure]:
    end = 5.12 * (dimension // 2)
    return Measure("a", -end, end, cells), Measure("b", -end, end, cells)


def projected(candidate: Candidate) -> Score:
    """Scores the sphere of the linear projection benchmark (Fontaine et al., 2020): 0 at its worst, 100 at its best."""
    vector = vector_of(candidate.genome)
    best = 0.4 * 5.12
    worst = (5.12 + best) ** 2 * vector.size
    score = 100.0 * (worst - float(((vector - best) ** 2).sum())) / worst
    folded = [x if abs(x) <= 5.12 else 5.12 / x for x in vector.tolist()]
    half = len(folded) // 2
    return Score(score, measures=(sum(folded[:half]), sum(folded[half:])))


def cma_me(*measures: Measure, seed: int = 1, **options: Any) -> Algorithm:
    return load_algorithm("cma-me", vector_problem(ZEROS, seed, *(measures or grid(10, 50))), options)


def filled(size: int, emitters: int, batch: int, blocks: int, seed: int) -> tuple[float, float]:
    """Returns coverage and QD score after so many blocks of each emitter, over 50 x 50 cells."""
    problem = vector_problem([0.0] * size, seed, *grid(size, 50))
    algorithm = load_algorithm("cma-me", problem, {"emitters": emitters, "batch": batch, "sigma": 0.5})
    list(islice(feed(algorithm, projected), emitters * batch * blocks))
    figures = algorithm.figures()
    return figures["coverage"], figures["qd score"]


# What the emitters of pyribs 0.12 (EvolutionStrategyEmitter, two-stage improvement ranking, selection of the better
# half, restarts where nothing improves) fill on the same problems with as many evaluations: means of three runs.
@pytest.mark.parametrize(
    ("sizes", "seeds", "coverage", "quality"),
    [
        ((10, 3, 24, 30), [1], 0.233, 52_500),
        pytest.param((22, 5, 36, 150), [1, 2, 3], 0.5645, 114_900, marks=pytest.mark.long),
    ],
)
def test_the_archive_is_filled_as_by_pyribs(
    sizes: tuple[int, int, int, int], seeds: list[int], coverage: float, quality: float
) -> None:
    covered, qualities = np.mean([filled(*sizes, seed) for seed in seeds], axis=0)
    assert 0.95 * coverage < covered < 1.2 * coverage
    assert 0.95 * quality < qualities < 1.2 * quality


def test_emitters_take_turns_and_each_waits_for_its_own_block_alone() -> None:
    algorithm = cma_me(emitters=3, batch=4)
    needs = [algorithm.needs(index) for index in range(32)]
    assert needs == [0] * 12 + [4] * 4 + [8] * 4 + [12] * 4 + [16] * 4 + [20] * 4
    groups = [algorithm.ask(index).group for index in (0, 3, 4, 8)]
    assert groups == ["emitter 1", "emitter 1", "emitter 2", "emitter 3"]
    told = list(islice(feed(algorithm, projected), 30))
    assert [candidate.group for _, candidate, _ in told[12:20]] == ["emitter 1"] * 4 + ["emitter 2"] * 4
    assert [candidate.generation for _, candidate, _ in told[::6]] == [0, 0, 1, 1, 2]


def test_the_archive_has_the_best_of_each_cell_that_was_told() -> None:
    measures = grid(10, 8)
    algorithm = cma_me(*measures, sigma=1.0)
    best: dict[tuple[int, ...], tuple[float, int]] = {}
    for index, _, score in islice(feed(algorithm, projected), 300):
        assert score.score is not None
        place = cell(measures, score.measures)
        best[place] = max(best.get(place, (-9.0, 0)), (score.score, -index))
    assert algorithm.elites() == [-index for _, index in sorted(best.values(), reverse=True)]


def test_an_emitter_goes_to_where_cells_are_empty_and_not_to_where_scores_are_good() -> None:
    # Scores are best at the start, and the measure is one parameter: only what is far from it is new.
    def judged(candidate: Candidate) -> Score:
        far = abs(float(vector_of(candidate.genome)[2]))
        return Score(-far, measures=(far,))

    algorithm = cma_me(Measure("far", 0.0, 10.0, 100), emitters=1, batch=12)
    told = list(islice(feed(algorithm, judged), 600))
    assert max(score.measures[0] for _, _, score in told) > 4.0


def test_an_emitter_that_improves_nothing_begins_anew_at_an_elite() -> None:
    algorithm = cma_me(emitters=1, batch=8, sigma=0.1)
    told = list(islice(feed(algorithm, projected), 40))
    before = algorithm.figures()["restarts"]
    waiting = [algorithm.ask(index) for index in range(40, 48)]
    for index, candidate in zip(range(40, 48), waiting, strict=True):
        algorithm.tell(index, candidate, Score(None))
    assert algorithm.figures()["restarts"] == before + 1
    elites = np.array([vector_of(told[index][1].genome) for index in algorithm.elites()])
    center = np.mean([vector_of(algorithm.ask(index).genome) for index in range(48, 56)], axis=0)
    nearest = np.abs(elites - center).max(axis=1).min()
    assert nearest < 0.2


def test_where_nothing_has_a_score_it_stays_at_the_start() -> None:
    algorithm = cma_me(emitters=2, batch=4)
    told = list(islice(feed(algorithm, lambda _: Score(None)), 80))
    assert algorithm.elites() == []
    assert max(np.abs(vector_of(candidate.genome)).max() for _, candidate, _ in told) < 0.6


@pytest.mark.parametrize(
    ("problem", "options", "place", "words"),
    [
        (Problem(WALK, 1, measures=grid(10, 5)), {}, "starts", "one to begin with, such as walker"),
        (vector_problem(ZEROS), {}, "measures", "needs 1 or more; none given"),
        (Problem(WALK, 1, (vector_genome(ZEROS),), ("a",), grid(10, 5)), {}, "objectives", "no use for objectives"),
        (vector_problem([0.0] * 301, 1, *grid(10, 5)), {}, "starts/0/brain", "this algorithm takes 300 at most"),
        (vector_problem(ZEROS, 1, *grid(10, 5)), {"batch": 1}, "options.batch", "2 and more"),
        (vector_problem(ZEROS, 1, *grid(10, 5)), {"emitters": 0}, "options.emitters", "must be from"),
    ],
)
def test_problems_that_are_none_for_it_are_refused(
    problem: Problem, options: dict[str, Any], place: str, words: str
) -> None:
    with pytest.raises(DocumentError) as caught:
        load_algorithm("cma-me", problem, options)
    assert caught.value.path == place
    assert words in caught.value.message


@pytest.mark.parametrize(("size", "options"), [(10, {"batch": 10_000, "emitters": 101}), (100, {"emitters": 334})])
def test_emitters_that_would_fill_the_memory_are_refused(size: int, options: dict[str, int]) -> None:
    with pytest.raises(DocumentError, match=r"options\.emitters: makes 10,.* numbers to be kept in memory"):
        load_algorithm("cma-me", vector_problem([0.0] * size, 1, *grid(size, 9)), options)
