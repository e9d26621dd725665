"""What holds for every evolutionary algorithm, so that a run follows from settings and scores and can be resumed."""

from __future__ import annotations

from typing import Any

import orjson
import pytest

from nmes.errors import DocumentError
from nmes.evaluation import Task
from nmes.evaluation.match_task import MatchTask
from nmes.evolution.algorithm import Algorithm, Candidate, Measure, Problem, Score
from nmes.evolution.algorithms import ALGORITHMS, algorithm_options, load_algorithm
from nmes.evolution.algorithms.random_search import RandomSearch
from nmes.genome import Genome

LENGTH = 40
SMALL = {"founders": 8, "population": 8, "window": 4, "initial": 8, "batch": 4, "emitters": 2, "islands": 3, "rung": 4}
"""Options that let an algorithm go through several generations in so many candidates, where it has them."""
STARTS = {"neat": "roller", "es": "inchworm", "cma": "inchworm", "cma-me": "inchworm"}
"""Start genomes of the algorithms that need one."""
MEASURES = (Measure("cubes", 0.0, 32.0, 8), Measure("mass", 0.0, 100.0, 5))

Asked = tuple[str, str, tuple[int, ...], int, str]


def new(name: str, seed: int = 3, **options: Any) -> Algorithm:
    starts = (Genome.load(STARTS[name]),) if name in STARTS else ()
    objectives = ("score", "-mass") if name == "nsga2" else ()
    measures = MEASURES if name in ("map-elites", "cma-me") else ()
    known = algorithm_options(name)
    chosen = {option: value for option, value in SMALL.items() if option in known} | options
    return load_algorithm(name, Problem(Task.load("walk"), seed, starts, objectives, measures), chosen)


def shown(candidate: Candidate) -> Asked:
    return candidate.genome.hash, candidate.operator, candidate.parents, candidate.generation, candidate.group


def scored(candidate: Candidate, index: int) -> Score:
    """A score that follows from the genome: several are equal, every seventh candidate has none."""
    number = int(candidate.genome.hash[:8], 16)
    if index % 7 == 3:
        return Score(None)
    value = float(number % 13)
    return Score(value, (value, -float(number % 5)), (float(number % 33), float(number % 101)))


def driven(algorithm: Algorithm, length: int = LENGTH, first: int = 0) -> list[tuple[Candidate, Score]]:
    """Runs an algorithm as a run does, each candidate asked for as soon as it may be; returns what it was told."""
    asked: list[Candidate] = []
    log = []
    for index in range(first, length):
        while first + len(asked) < length and algorithm.needs(first + len(asked)) <= index:
            asked.append(algorithm.ask(first + len(asked)))
        candidate = asked[index - first]
        log.append((candidate, scored(candidate, index)))
        algorithm.tell(index, *log[-1])
    return log


@pytest.fixture(scope="module")
def logs() -> dict[str, list[tuple[Candidate, Score]]]:
    return {}


@pytest.fixture
def log(name: str, logs: dict[str, list[tuple[Candidate, Score]]]) -> list[tuple[Candidate, Score]]:
    """What an algorithm is told in a run."""
    if name not in logs:
        logs[name] = driven(new(name))
    return logs[name]


Log = list[tuple[Candidate, Score]]


@pytest.mark.parametrize("name", ALGORITHMS)
def test_to_ask_twice_or_again_changes_nothing(name: str, log: Log) -> None:
    algorithm = new(name)
    for index, (candidate, score) in enumerate(log):
        latest = index
        while latest + 1 < LENGTH and algorithm.needs(latest + 1) <= index:
            latest += 1
        for place in (latest, index, latest):  # in another order than a run asks, and again
            if algorithm.needs(place) == index or place == index == 0:
                assert shown(algorithm.ask(place)) == shown(log[place][0]), place
        algorithm.tell(index, candidate, score)


@pytest.mark.parametrize("name", ALGORITHMS)
@pytest.mark.parametrize("told", [1, 9, 17, 30])
def test_a_run_that_is_told_its_log_goes_on_as_in_one_go(name: str, told: int, log: Log) -> None:
    algorithm = new(name)
    waiting = {}
    for index in range(told):
        for place in range(index, LENGTH):  # what was in the window when the run was killed is asked for at its time
            if algorithm.needs(place) == index and place >= told:
                waiting[place] = shown(algorithm.ask(place))
        algorithm.tell(index, *log[index])
    assert waiting == {place: shown(log[place][0]) for place in waiting}
    for index in range(told, LENGTH):
        for place in range(index, LENGTH):
            if algorithm.needs(place) == index and place not in waiting:
                waiting[place] = shown(algorithm.ask(place))
        assert waiting[index] == shown(log[index][0])
        algorithm.tell(index, *log[index])
    whole = new(name)
    for index in range(LENGTH):
        whole.tell(index, *log[index])
    assert list(algorithm.elites()) == list(whole.elites()) and dict(algorithm.figures()) == dict(whole.figures())


@pytest.mark.parametrize("name", ALGORITHMS)
def test_what_a_candidate_needs_comes_before_it(name: str) -> None:
    algorithm = new(name)
    needs = [algorithm.needs(index) for index in range(200)]
    assert needs == sorted(needs) and all(0 <= need <= index for index, need in enumerate(needs))


@pytest.mark.parametrize("name", ALGORITHMS)
def test_every_candidate_is_a_good_genome_that_may_take_part(name: str, log: Log) -> None:
    task = Task.load("walk")
    for index, (candidate, _) in enumerate(log):
        read = Genome.parse(orjson.dumps(candidate.genome.document))  # as from a file
        assert read.hash == candidate.genome.hash
        assert task.check(read.body) == []
        assert read.brain() is not None
        assert all(0 <= parent < index for parent in candidate.parents) and candidate.operator


@pytest.mark.parametrize("name", ALGORITHMS)
def test_elites_are_candidates_that_were_told_and_have_a_score(name: str, log: Log) -> None:
    algorithm = new(name)
    assert list(algorithm.elites()) == []
    for index, (candidate, score) in enumerate(log):
        algorithm.tell(index, candidate, score)
        elites = list(algorithm.elites())
        assert len(set(elites)) == len(elites)
        assert all(place <= index and log[place][1].score is not None for place in elites)
    assert algorithm.elites()


@pytest.mark.parametrize("name", ALGORITHMS)
def test_a_run_in_which_nobody_has_a_score_goes_on(name: str) -> None:
    algorithm = new(name)
    for index in range(24):
        candidate = algorithm.ask(index)
        algorithm.tell(index, candidate, Score(None))
    assert list(algorithm.elites()) == []


@pytest.mark.parametrize("name", ALGORITHMS)
def test_another_seed_has_other_candidates(name: str, log: Log) -> None:
    others = {candidate.genome.hash for candidate, _ in driven(new(name, seed=4), 12)}
    starts = {Genome.load(STARTS[name]).hash} if name in STARTS else set()
    assert not others & {candidate.genome.hash for candidate, _ in log} - starts


@pytest.mark.parametrize("name", [name for name in ALGORITHMS if name != "random"])  # which has none
def test_options_out_of_their_bounds_are_refused_by_name(name: str) -> None:
    bounded = {option: value for option, value in algorithm_options(name).items() if not isinstance(value, bool)}
    assert bounded
    for option, default in bounded.items():
        wrong: dict[str, Any] = {option: type(default)(-1_000_000)}
        with pytest.raises(DocumentError) as caught:
            new(name, **wrong)
        assert any(path == f"options.{option}" for path, _ in caught.value.problems)


def test_random_search_has_no_more_than_a_window_of_candidates_under_way() -> None:
    algorithm = new("random")
    assert [algorithm.needs(index) for index in (0, 1023, 1024, 10**9)] == [0, 0, 1, 10**9 - 1023]


def test_the_eras_of_random_search_in_co_evolution_are_as_long_as_they_are_said_to_be() -> None:
    task = MatchTask.load("sumo")
    search = RandomSearch(Problem(task, 1, role=next(iter(task.roles))), RandomSearch.Options())
    assert search.needs(100_000) == 0
