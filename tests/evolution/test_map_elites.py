"""The algorithm `map-elites`: what it breeds from, and what its archive comes to hold."""

from __future__ import annotations

from collections import Counter
from itertools import islice
from typing import Any

import pytest

from nmes.errors import DocumentError
from nmes.evolution.algorithm import Algorithm, Candidate, Measure, Problem, Score
from nmes.evolution.algorithms import load_algorithm
from nmes.evolution.archive import cell
from nmes.genome import Genome
from vectors import WALK, feed

MEASURES = (Measure("mass", 0.0, 40.0, 20), Measure("length", 0.0, 3.0, 20))
WALKER = Genome.load("walker")


def weighed(candidate: Candidate) -> Score:
    """Scores a body by how low it is, over its mass and length."""
    low, high = candidate.genome.body.bounds
    return Score(2.0 - high[1], measures=(candidate.genome.body.mass, high[0] - low[0]))


def map_elites(problem: Problem | None = None, **options: Any) -> Algorithm:
    return load_algorithm("map-elites", problem or Problem(WALK, 5, (WALKER,), measures=MEASURES), options)


def test_a_window_of_candidates_is_under_way() -> None:
    algorithm = map_elites(window=3)
    assert [algorithm.needs(index) for index in range(6)] == [0, 0, 0, 1, 2, 3]


def test_every_elite_has_offspring_and_nobody_else() -> None:
    algorithm = map_elites(initial=6, window=1)
    parents: Counter[int] = Counter()
    told = feed(algorithm, weighed)
    for index, candidate, _ in islice(told, 60):
        if index >= 6:
            parents.update(candidate.parents)
        elites = {*algorithm.elites()}
        assert elites <= set(range(index + 1))
    # From here on nothing that is told gets into the archive.
    elites = {*algorithm.elites()}
    assert len(elites) > 5
    parents.clear()
    for index in range(60, 160):
        candidate = algorithm.ask(index)
        assert {*candidate.parents} <= elites
        parents.update(candidate.parents)
        algorithm.tell(index, candidate, Score(None))
    assert {*parents} == elites
    assert max(parents.values()) < 100 / len(elites) * 6


def test_the_archive_has_the_best_of_each_cell_that_was_told() -> None:
    algorithm = map_elites(initial=10, crossover=0.5, window=8)
    best: dict[tuple[int, ...], tuple[float, int]] = {}
    for index, _, score in islice(feed(algorithm, weighed), 150):
        assert score.score is not None
        place = cell(MEASURES, score.measures)
        best[place] = max(best.get(place, (-9.0, 0)), (score.score, -index))
    assert algorithm.elites() == [-index for _, index in sorted(best.values(), reverse=True)]
    total = pytest.approx(sum(score for score, _ in best.values()))
    assert algorithm.figures() == {"coverage": len(best) / 400, "qd score": total}


def test_breeding_from_the_archive_reaches_kinds_that_mutants_of_the_start_do_not() -> None:
    fine = (Measure("mass", 5.0, 15.0, 100), Measure("length", 0.5, 1.5, 100))
    occupied = []
    for initial in (20, 200):
        algorithm = map_elites(Problem(WALK, 5, (WALKER,), measures=fine), initial=initial, window=4)
        list(islice(feed(algorithm, weighed), 200))
        occupied.append(algorithm.figures()["coverage"] * 10_000)
    assert occupied[0] > 1.5 * occupied[1], occupied


def test_with_no_score_at_all_it_goes_on() -> None:
    algorithm = map_elites(initial=2, window=1)
    told = list(islice(feed(algorithm, lambda _: Score(None)), 6))
    assert len({candidate.genome.hash for _, candidate, _ in told}) == 6
    assert algorithm.elites() == []


@pytest.mark.parametrize(
    ("problem", "options", "place", "words"),
    [
        (Problem(WALK, 1), {}, "measures", "needs 1 or more; none given"),
        (Problem(WALK, 1, (), ("score",), MEASURES), {}, "objectives", "no use for objectives"),
        (Problem(WALK, 1, measures=(Measure("legs", 2, 2, 3),)), {}, "measures/0", "from 2 to 2"),
        (Problem(WALK, 1, measures=(*MEASURES, Measure("legs", 0, float("inf"), 3))), {}, "measures/2", "to inf"),
        (Problem(WALK, 1, measures=(Measure("legs", 0, 1, 0),)), {}, "measures/0/cells", "not 0"),
        (Problem(WALK, 1, measures=MEASURES), {"window": 0}, "options.window", "must be from"),
        (Problem(WALK, 1, measures=MEASURES), {"crossover": 2}, "options.crossover", "must be from"),
        (Problem(WALK, 1, measures=MEASURES), {"initial": 0}, "options.initial", "must be from"),
    ],
)
def test_problems_that_are_none_for_it_are_refused(
    problem: Problem, options: dict[str, Any], place: str, words: str
) -> None:
    with pytest.raises(DocumentError) as caught:
        map_elites(problem, **options)
    assert caught.value.path == place
    assert words in caught.value.message
