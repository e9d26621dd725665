"""Creatures that are run together: every figure is that of the creature alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from creatures import cpg, exploding, mlp, snake
from nmes.backend import Rows
from nmes.backends.mujoco3d import rows
from nmes.backends.mujoco3d.rows import MujocoRows
from nmes.evaluation import Evaluation, Evaluator, Task, evaluate, evaluator, population
from nmes.evaluation.episode import Episode, Handover
from nmes.genome import Genome
from nmes.world import World
from populations import draw_population

LOOSE = {"cubes": 8}
TASKS: dict[str, dict[str, Any]] = {
    "run": {"objective": "displacement.x - 0.01 * energy", "vary": {"yaw": [-1, 1], "drop": [0.0, 0.1]}},
    "ends": {
        "objective": "mean.speed + contacts",
        "ends": [{"name": "gone", "when": "displacement.horizontal > 0.05"}, {"name": "up", "when": "contacts < 1"}],
        "limits": {**LOOSE, "speed": 8, "energy": 20},
    },
    "cargo": {
        "objective": 'time + cube("cargo").height',
        "props": [{"id": "cargo", "size": [0.1, 0.1, 0.1], "mass": 0.2, "target": True}],
        "ends": [{"name": "dropped", "when": 'cube("cargo").lowest < 0.02'}],
    },
    "pole": {
        "objective": "time",
        "props": [{"id": "pole", "size": [0.05, 0.5, 0.05], "mass": 0.2, "hinge": True, "lean": [-0.3, 0.3]}],
    },
    "reach": {"objective": "0 - distance", "target": {"distance": [1, 2], "bearing": [-1, 1], "height": 0.2}},
    "planet": {
        "objective": "displacement.x",
        "world": {"scene": {"type": "planets", "planets": {"count": 1}}},
    },
    "damped": {"objective": "displacement.x", "world": {"damping": {"linear": 0.5, "angular": 0.5}}},
    "hills": {
        "objective": "displacement.x",
        "world": {
            "scene": {"type": "heightfield", "heightfield": {"height": 0.2, "size": [20, 20]}},
            "substeps": 3,
            "tick_rate": 50,
        },
    },
    "awake": {"objective": "displacement.x", "world": {"engine": {"sleep": False, "integrator": "euler"}}},
    "water": {
        "objective": "displacement.x + max.reach + mean.velocity.x",
        "world": {"engine": {"sleep": False, "integrator": "rk4"}, "gravity": [0, 0, 0], "medium": {}},
    },
}


def task(name: str, **changes: Any) -> Task:
    head = {"format": "nmes-task/1", "name": name, "description": "A test.", "duration": 1.3, "seeds": [3, 4]}
    return Task({**head, "settle_limit": 2, "limits": LOOSE, **TASKS[name], **changes})


@pytest.fixture(autouse=True)
def rows_do_not_fail(caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    """Sees that no episode went on in a world since rows raised an error, which would cost only speed and a warning."""
    yield
    assert not [record for record in caplog.get_records("call") if "as rows they fail" in record.getMessage()]


def in_worlds(genome: Genome, asked: Task) -> Evaluation:
    """Evaluates a creature in worlds of its own, all of each episode."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluator, "run_alone", population.run_in_world)
        return evaluate(genome, asked)


def assert_alike(genomes: Sequence[Genome], asked: Task, found: Sequence[Evaluation]) -> None:
    for genome, together in zip(genomes, found, strict=True):
        expected = in_worlds(genome, asked)
        assert together == expected, f"{genome!r} on {asked.name}"
        assert evaluate(genome, asked) == expected, f"{genome!r} on {asked.name}, alone"


def draw_and_compare(seed: int, name: str, size: int, **changes: Any) -> Counter[str]:
    """Compares a drawn population with each of it alone; returns how its episodes came out."""
    genomes, asked = draw_population(seed, size), task(name, **changes)
    found = Evaluator(1).evaluate_population(genomes, asked)
    assert_alike(genomes, asked, found)
    results = [result for each in found for result in each.results]
    return Counter((result.fault or result.ended or "whole").split(":")[0] for result in results)


@pytest.mark.parametrize("name", ["run", "ends", "cargo", "reach", "damped"])
def test_a_population_scores_what_each_scores_alone(name: str) -> None:
    assert draw_and_compare(9, name, 12, duration=0.6, settle_limit=0.6).total()


@pytest.mark.long
@pytest.mark.parametrize("name", TASKS)
@pytest.mark.parametrize("seed", range(100, 130))
def test_many_populations_score_what_each_scores_alone(seed: int, name: str) -> None:
    draw_and_compare(seed, name, 16)


@pytest.mark.long
@pytest.mark.parametrize("name", Task.names())
def test_populations_on_the_shipped_tasks_score_what_each_scores_alone(name: str) -> None:
    asked = Task({**Task.load(name).document, "duration": 3, "seeds": [1, 5]})
    genomes = [*draw_population(2, 12), *map(Genome.load, Genome.names())]
    assert_alike(genomes, asked, Evaluator(1).evaluate_population(genomes, asked))


def test_one_body_with_many_brains_and_many_sizes_of_it_run_as_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise AssertionError("an episode was run alone")

    many = [Genome(snake(mlp(4, seed=i), name=f"m{i}")) for i in range(3)]
    many += [Genome(snake(cpg(4), name=f"c{i}")) for i in range(2)]
    sized = snake(cpg(4), name="sized")
    for cube in sized["body"]["cubes"]:
        cube["mass"] = 0.9
    for joint in sized["body"]["joints"]:
        joint["motor"] = {"mode": "position", "range": [-0.3, 0.8], "max_effort": 4}
    asked = task("run", duration=0.5)
    genomes = [*many, Genome(sized)]
    with monkeypatch.context() as patch:
        patch.setattr(population, "run_alone", refuse)
        patch.setattr(population, "run_in_world", refuse)
        found = Evaluator(1).evaluate_population(genomes, asked)
    assert len({each.score for each in found}) == 5  # the two of equal brains score alike
    assert_alike(genomes, asked, found)


def test_a_row_that_faults_or_ends_early_leaves_the_others_as_they_were() -> None:
    bang = exploding()
    calm = [snake(cpg(4), name=f"calm{i}") for i in range(3)]
    for document in calm:  # the plan of what explodes, so that all are rows of one batch
        for joint in document["body"]["joints"]:
            joint["motor"]["mode"] = "velocity"
    genomes = [Genome({**bang, "name": f"bang{i}"}) if i % 2 else Genome(calm[i // 2]) for i in range(6)]
    asked = task("run", duration=0.5)
    found = Evaluator(1).evaluate_population(genomes, asked)
    assert [each.faults for each in found] == [0, 2, 0, 2, 0, 2]
    assert_alike(genomes, asked, found)


def test_the_duty_factor_is_told_where_it_is_asked_for_and_changes_nothing_else() -> None:
    genomes, asked = draw_population(9, 6), task("run", duration=0.5)
    found = Evaluator(1).evaluate_population(genomes, asked.with_duty())
    assert_alike(genomes, asked.with_duty(), found)
    plain = Evaluator(1).evaluate_population(genomes, asked)
    for each, other in zip(found, plain, strict=True):
        assert [replace(result, duty=None) for result in each.results] == list(other.results)
    duties = {result.duty for each in found for result in each.results if result.fault is None}
    assert len(duties) > 3 and all(duty is not None and 0 <= duty <= 1 for duty in duties)


def test_ticks_in_one_call_are_kept_as_ticks_one_by_one() -> None:
    document = snake(name="sprung")
    for joint in document["body"]["joints"]:
        joint["stiffness"] = 0.5
    asked = task("run", settle_limit=0.6)
    start = Episode(World(asked.world_config(3)), Genome(document), None, asked, 3).begin()
    assert isinstance(start, Handover)
    joints, ticks = start.watched.motors, 9
    targets = np.random.default_rng(0).uniform(-0.5, 0.5, (ticks, 2, len(joints)))
    kept = []
    for run in (Rows.run, MujocoRows.run):
        places = start.row.rows(3)
        places.put([0, 2], [start.row, start.row])
        track = places.track(*start.watched, ticks + 1, 4)
        assert isinstance(places, MujocoRows)
        for some in (targets[:2], targets[2:]):
            assert run(places, np.array([0, 2]), joints, some, 4, track) == []
        kept.append([values[[0, 2]] for values in (track.states(), track.positions(), track.powers(), places.qpos)])
    for one_by_one, at_once in zip(*kept, strict=True):
        assert at_once.size and np.array_equal(one_by_one, at_once)
        assert not np.array_equal(at_once[0], at_once[1])


@pytest.mark.parametrize(("name", "room", "way"), [("run", 1, 0.1), ("run", 5_000, 0.1), ("water", 500_000, 1.0)])
def test_how_many_ticks_are_taken_in_one_call_changes_nothing(
    name: str, room: int, way: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    brains = [{"kind": "sine", "oscillators": [{"motor": "*", "frequency": 0.5 + 0.3 * i}]} for i in range(5)]
    waves = [snake(brain) for brain in brains]
    for document in waves:
        for joint in document["body"]["joints"]:
            joint["stiffness"] = 0.5
    ends = [{"name": "off", "when": f"displacement.horizontal > {way}"}]
    asked = task(name, duration=1.2, settle_limit=0.6, ends=ends)
    genomes = [Genome(document) for document in waves]
    expected = [in_worlds(genome, asked) for genome in genomes]
    assert len({each.score for each in expected}) == 5
    monkeypatch.setattr(rows, "_ROOM", room)
    assert Evaluator(1).evaluate_population(genomes, asked) == expected


def test_processes_and_order_change_nothing() -> None:
    genomes, asked = draw_population(5, 8), task("run", duration=0.3, seeds=[3], settle_limit=0.6)
    here = Evaluator(1).evaluate_population(genomes, asked)
    with Evaluator(2) as workers:
        for order in (range(8), [7, 3, 0, 5, 1, 2, 4, 6]):
            found = workers.evaluate_population([genomes[i] for i in order], asked)
            assert found == [here[i] for i in order]


def test_seeds_are_those_that_are_asked_for_in_their_order() -> None:
    genomes, asked = [Genome(snake(mlp(4, seed=i))) for i in range(2)], task("run", duration=0.5)
    found = Evaluator(1).evaluate_population(genomes, asked, seeds=[9, 3, 9])
    assert [[result.seed for result in each.results] for each in found] == [[9, 3, 9]] * 2
    assert found == [evaluate(genome, asked, seeds=[9, 3, 9]) for genome in genomes]
    assert Evaluator(1).evaluate_population([], asked) == []


def test_an_engine_without_rows_gives_the_same_figures() -> None:
    asked = task("run", world={"backend": "pymunk"}, duration=0.5, vary={}, seeds=[1])
    documents = [snake(cpg(4), name=f"p{i}") for i in range(4)]
    for i, document in enumerate(documents):
        for joint in document["body"]["joints"]:
            joint["axis"] = [0, 0, 1]
        document["body"]["cubes"][0]["mass"] = 0.5 + 0.1 * i
    genomes = [Genome(document) for document in documents]
    found = Evaluator(1).evaluate_population(genomes, asked)
    assert all(each.score is not None for each in found), found[0]
    assert_alike(genomes, asked, found)
