"""Islands take turns, know nothing of each other, and the better half of them goes on."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any

import pytest

from nmes.errors import DocumentError
from nmes.evaluation import Task
from nmes.evolution.algorithm import Algorithm, Candidate, Problem, Score
from nmes.evolution.algorithms import load_algorithm
from nmes.genome import Genome

OPTIONS = {"founders": 5, "population": 5, "window": 1, "tournament": 2}
PROBLEM = Problem(Task.load("walk"), 2)


def new(**options: Any) -> Algorithm:
    return load_algorithm("islands", PROBLEM, {**OPTIONS, **options})


def run(algorithm: Algorithm, length: int, worth: dict[str, float | None]) -> list[Candidate]:
    """Has candidates scored by the island that they are of; returns them."""
    told = []
    for index in range(length):
        told.append(algorithm.ask(index))
        algorithm.tell(index, told[-1], Score(worth[told[-1].group]))
    return told


def test_the_better_half_goes_on_after_each_rung() -> None:
    worth = {f"island {place}": score for place, score in enumerate([3.0, 9.0, None, 5.0, 7.0], 1)}
    told = run(new(islands=5, rung=6), 100, worth)
    groups = [candidate.group for candidate in told]
    assert groups[:10] == [f"island {place}" for place in (1, 2, 3, 4, 5)] * 2
    assert groups[30:48] == ["island 2", "island 4", "island 5"] * 6
    assert groups[48:60] == ["island 2", "island 5"] * 6
    assert groups[60:] == ["island 2"] * 40


def test_of_equal_islands_the_first_goes_on_and_one_without_a_score_is_the_last() -> None:
    worth: dict[str, float | None] = {"island 1": None, "island 2": -4.0, "island 3": -4.0}
    algorithm = new(islands=3, rung=5)
    told = run(algorithm, 40, worth)
    assert Counter(candidate.group for candidate in told[15:25]) == {"island 2": 5, "island 3": 5}
    assert {candidate.group for candidate in told[25:]} == {"island 2"}
    assert algorithm.figures()["islands"] == 1


def test_parents_are_of_the_same_island_and_elites_of_those_that_go_on() -> None:
    algorithm = new(islands=4, rung=12)
    told: list[Candidate] = []
    for index in range(120):
        told.append(algorithm.ask(index))
        algorithm.tell(index, told[-1], Score(float(int(told[-1].genome.hash[:4], 16))))
        going = {told[place].group for place in algorithm.elites()}
        assert len(going) == (4 if index < 47 else 2 if index < 71 else 1) or index < 4
    born = [candidate for candidate in told if candidate.parents]
    assert len(born) > 60
    for candidate in born:
        assert {told[parent].group for parent in candidate.parents} == {candidate.group}
    for candidate in born:
        parents = candidate.genome.document["parents"]
        assert parents == list(dict.fromkeys(told[parent].genome.hash for parent in candidate.parents))


def test_an_island_is_a_population_of_afpo() -> None:
    told = run(new(islands=3, rung=20), 60, dict.fromkeys(("island 1", "island 2", "island 3"), 1.0))
    alone = load_algorithm("afpo", replace(PROBLEM, island=1), OPTIONS)
    for index, candidate in enumerate(candidate for candidate in told if candidate.group == "island 2"):
        expected = alone.ask(index)
        assert candidate.genome.hash == expected.genome.hash and candidate.operator == expected.operator
        alone.tell(index, expected, Score(1.0))
    assert len({candidate.genome.hash for candidate in told[:15]}) == 15  # founders of all islands differ


def test_nobody_is_asked_for_before_islands_are_chosen() -> None:
    algorithm = new(islands=3, rung=6, window=4)
    assert [algorithm.needs(index) for index in (0, 11, 12, 17)] == [0, 0, 3, 6]
    assert [algorithm.needs(index) for index in (18, 19, 20)] == [18, 18, 18]  # the second rung
    assert algorithm.needs(25) == 18 and algorithm.needs(27) == 20
    assert algorithm.needs(30) == 30 and algorithm.needs(40) == 37  # the last


def test_one_island_is_no_race_and_none_is_refused() -> None:
    told = run(new(islands=1, rung=2), 30, {"island 1": 1.0})
    assert len({candidate.genome.hash for candidate in told}) > 20
    with pytest.raises(DocumentError, match=r"options\.islands"):
        new(islands=0)
    with pytest.raises(DocumentError, match=r"options\.rung"):
        new(rung=0)


def test_start_genomes_begin_on_each_island() -> None:
    problem = replace(PROBLEM, starts=(Genome.load("walker"),))
    algorithm = load_algorithm("islands", problem, {**OPTIONS, "islands": 2})
    assert [algorithm.ask(index).operator for index in (0, 1)] == ["start", "start"]
    assert algorithm.ask(2).genome.hash != algorithm.ask(3).genome.hash
