"""Genetic algorithms keep whom they say, breed from those alone, and find more than chance does."""

from __future__ import annotations

from typing import Any

import pytest

from nmes.errors import DocumentError
from nmes.evaluation import Task
from nmes.evolution.algorithm import Algorithm, Candidate, Problem, Score
from nmes.evolution.algorithms import load_algorithm
from nmes.genome import Genome
from nmes.variation.draw import Draw
from nmes.variation.mutation import OF_BRAINS, mutate


def new(name: str, seed: int = 1, *starts: Genome, task: Task | None = None, **options: Any) -> Algorithm:
    return load_algorithm(name, Problem(task or Task.load("walk"), seed, starts), options)


def run(algorithm: Algorithm, scores: list[float | None]) -> list[Candidate]:
    """Has candidates scored one after the other, whoever they are; returns them."""
    told = []
    for index, score in enumerate(scores):
        told.append(algorithm.ask(index))
        algorithm.tell(index, told[-1], Score(score))
    return told


def test_parents_are_the_youngest_with_a_score() -> None:
    scores = [None if index % 5 == 0 else 100.0 - index for index in range(60)]  # the oldest are the best
    told = run(new("ga", founders=8, population=8, window=1, elites=0), scores)
    assert {candidate.operator for candidate in told[:8]} == {"random"}
    for index in range(8, 60):
        young = [place for place in range(index) if scores[place] is not None][-8:]
        assert told[index].parents and set(told[index].parents) <= set(young)
    assert len({parent for candidate in told for parent in candidate.parents}) > 20  # not some of them alone


def test_the_window_and_no_more_is_left_out() -> None:
    for name in ("ga", "afpo"):
        assert [new(name, window=4).needs(index) for index in (0, 2, 3, 4, 50)] == [0, 0, 0, 1, 47]


def test_elites_stay_parents_for_good() -> None:
    scores: list[float | None] = [5.0, 4.0, *(1.0 for _ in range(58))]
    algorithm = new("ga", founders=8, population=8, window=1, elites=2, tournament=2)
    told = run(algorithm, scores)
    assert sum(bool({0, 1} & set(candidate.parents)) for candidate in told[20:]) > 10
    assert list(algorithm.elites())[:2] == [0, 1] and len(algorithm.elites()) == 10


def test_the_winners_of_tournaments_have_the_offspring() -> None:
    def mean_of_parents(tournament: int) -> float:
        scores: list[float | None] = [float(index * 7 % 20) for index in range(50)]
        told = run(new("ga", founders=20, population=20, window=1, elites=0, tournament=tournament), scores)
        ranks = [scores[parent] or 0.0 for candidate in told[20:] for parent in candidate.parents]
        return sum(ranks) / len(ranks)

    assert mean_of_parents(1) < 11.0 < 14.0 < mean_of_parents(5)


def test_crossover_has_two_parents_and_mutation_one() -> None:
    none = run(new("ga", founders=6, population=6, window=1, crossover=0.0), [1.0] * 20)[6:]
    most = run(new("ga", founders=6, population=6, window=1, crossover=1.0), [1.0] * 30)[6:]
    assert all(len(candidate.parents) == 1 and "cross" not in candidate.operator for candidate in none)
    crossed = [candidate for candidate in most if candidate.operator.startswith("cross")]
    assert len(crossed) > 12 and all(len(set(candidate.parents)) == 2 for candidate in crossed)
    assert {candidate.operator for candidate in crossed} > {"cross"}  # some are mutated too


def test_a_document_names_the_candidates_it_was_bred_from() -> None:
    told = run(new("afpo", founders=6, population=6, window=1), [float(index % 4) for index in range(24)])
    for candidate in told:
        hashes = [told[parent].genome.hash for parent in candidate.parents]
        assert candidate.genome.document.get("parents", []) == list(dict.fromkeys(hashes))


def test_start_genomes_are_the_founders() -> None:
    walker, roller = Genome.load("walker"), Genome.load("roller")
    told = run(new("ga", 1, walker, roller, founders=6, population=6, window=6), [1.0] * 6)
    assert [candidate.operator for candidate in told[:2]] == ["start", "start"]
    assert [candidate.genome.hash for candidate in told[:2]] == [walker.hash, roller.hash]
    assert [candidate.parents for candidate in told[2:]] == [(0,), (1,), (0,), (1,)]


def test_whoever_has_no_offspring_gives_way_to_a_random_creature() -> None:
    light = Task({**Task.load("walk").document, "limits": {"mass": 1.0}})  # and nothing makes the walker so light
    told = run(new("ga", 1, Genome.load("walker"), task=light, founders=1, population=1), [None] * 3)
    assert told[0].operator == "start"
    assert all(candidate.operator == "random" and not light.check(candidate.genome.body) for candidate in told[1:])


def test_new_bodies_are_kept_from_better_ones_that_are_older() -> None:
    algorithm = new("afpo", founders=12, population=12, window=1)
    told = run(algorithm, [50.0, *[0.0] * 11, 1.0])  # a good founder, eleven bad ones, and a newcomer
    assert told[12].operator == "random" and list(algorithm.elites())[:2] == [0, 12]
    best, newcomer = told[0].genome, told[12].genome
    algorithm.tell(13, Candidate(best, "weights", (0,)), Score(0.5))
    assert 13 not in algorithm.elites()  # with the oldest body, with which the first is better
    algorithm.tell(14, Candidate(newcomer, "weights", (12,)), Score(0.5))
    assert 14 in algorithm.elites() and algorithm.figures()["bodies"] == 11  # as bad, but with the newest
    changed = mutate(best, Draw(1), kind="resize-part").genome
    algorithm.tell(15, Candidate(changed, "resize-part", (0,)), Score(0.25))
    assert 15 in algorithm.elites()  # its body is newer than any
    bodies = algorithm.figures()["bodies"]
    algorithm.tell(16, Candidate(changed, "weights", (15,)), Score(0.125))  # the same body again
    algorithm.tell(17, Candidate(newcomer, "cross", (12, 15)), Score(0.125))
    assert algorithm.figures()["bodies"] == bodies - 2  # for they take the places of two


def test_one_random_creature_comes_with_each_generation() -> None:
    told = run(new("afpo", founders=10, population=10, window=1), [float(index % 9) for index in range(35)])
    assert [index for index in range(10, 35) if told[index].operator == "random"] == [10, 20, 30]


def test_evolution_finds_more_than_chance() -> None:
    """What is sought is a body of certain figures: a score without an episode."""

    def score(candidate: Candidate) -> float:
        body = candidate.genome.body
        low, high = body.bounds
        figures = (len(body.cubes), 14), (body.mass, 20), (high[0] - low[0], 1.5), (len(body.sensors), 40)
        return -sum(abs(value / wanted - 1.0) for value, wanted in figures)

    def best(name: str, **options: Any) -> float:
        algorithm = new(name, 1, **options)
        scores = []
        for index in range(80):
            candidate = algorithm.ask(index)
            scores.append(score(candidate))
            algorithm.tell(index, candidate, Score(scores[-1]))
        assert scores[algorithm.elites()[0]] == max(scores)
        return max(scores)

    chance = best("random")
    assert best("ga", founders=30, population=30, window=4, elites=5) > 0.7 * chance


@pytest.mark.parametrize("name", ["ga", "afpo"])
def test_brains_alone_vary_and_nobody_else_comes(name: str) -> None:
    walker, biped = Genome.load("walker"), Genome.load("biped")
    told = run(new(name, 1, walker, biped, founders=6, population=6, window=1, crossover=1.0, bodies=False), [1.0] * 40)
    for candidate in told:
        assert candidate.genome.document["body"] in (walker.document["body"], biped.document["body"])
        assert set(candidate.operator.split("+")) <= {"start", *OF_BRAINS}
    assert len({candidate.genome.hash for candidate in told}) > 30


@pytest.mark.parametrize("name", ["ga", "afpo"])
def test_bodies_alone_vary_and_brains_go_along(name: str) -> None:
    walker = Genome.load("walker")
    told = run(new(name, 1, walker, founders=6, population=6, window=1, crossover=1.0, brains=False), [1.0] * 40)
    assert not {kind for candidate in told for kind in candidate.operator.split("+")} & {*OF_BRAINS, "cross", "random"}
    given = {each["motor"]: each for each in walker.document["brain"]["oscillators"]}
    for candidate in told:
        for each in candidate.genome.document["brain"]["oscillators"]:
            assert given.get(each["motor"], each) == each
    assert len({candidate.genome.body.mass for candidate in told}) > 10


def test_what_does_not_vary_must_be_given() -> None:
    with pytest.raises(DocumentError, match="starts: what does not vary must be given"):
        new("ga", bodies=False)
    with pytest.raises(DocumentError, match="either bodies or brains must vary"):
        new("afpo", 1, Genome.load("walker"), bodies=False, brains=False)
