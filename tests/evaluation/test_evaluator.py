"""The front door of evaluation: what may be named, workers that stay, work that is cut by episode."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import pytest

import nmes
from creatures import mlp, snake
from nmes.errors import DocumentError
from nmes.evaluation import Evaluation, Evaluator, Job, Result, Task, evaluate, evaluator, portions
from nmes.genome import Genome

SHORT = {
    "format": "nmes-task/1",
    "name": "short",
    "description": "A test.",
    "duration": 0.3,
    "settle_limit": 0.6,
    "objective": "displacement.x + 0.1 * energy",
    "seeds": [3, 4],
    "vary": {"yaw": [-1, 1]},
    "limits": {"cubes": 8},
}


def test_names_paths_documents_and_objects_are_the_same_to_evaluate(tmp_path: Path) -> None:
    genome, task = snake(mlp(4)), {**SHORT}
    (tmp_path / "snake.json").write_text(json.dumps(genome))
    (tmp_path / "short.json").write_text(json.dumps(task))
    expected = evaluate(Genome(genome), Task(task))
    assert expected.score is not None
    assert nmes.evaluate(genome, task) == expected
    assert nmes.evaluate(tmp_path / "snake.json", str(tmp_path / "short.json")) == expected
    assert nmes.evaluate(str(tmp_path / "snake.json"), tmp_path / "short.json") == expected
    with Evaluator(1) as here:
        assert here.evaluate(tmp_path / "snake.json", task) == expected
        assert here.evaluate_population([genome, tmp_path / "snake.json", Genome(genome)], task) == [expected] * 3
    assert nmes.evaluate("walker", task).genome == Genome.load("walker").name
    assert nmes.evaluate(genome, "reach", seeds=[1]).task_hash == Task.load("reach").hash


def test_the_duty_factor_that_a_task_object_asks_for_is_told_by_every_door() -> None:
    genome, task = Genome(snake(mlp(4))), Task(SHORT).with_duty()
    expected = evaluate(genome, task)
    assert expected.duty is not None
    with Evaluator(1) as here:
        assert here.evaluate(genome, task) == expected


@pytest.mark.parametrize("wrong", [("no such", "walk"), ("walker", "no such"), ({}, "walk"), ("walker", {"format": 1})])
def test_what_is_no_genome_or_task_is_refused_before_anything_runs(wrong: tuple[Any, Any]) -> None:
    with pytest.raises(DocumentError) as alone:
        nmes.evaluate(*wrong)
    with Evaluator(1) as here, pytest.raises(DocumentError) as population:
        here.evaluate_population(["walker", wrong[0]], wrong[1])
    assert alone.value.message in population.value.message


@pytest.mark.parametrize("wrong", [[1.5], ["1"], [True, None], 3.0, "12"])
def test_seeds_that_are_no_whole_numbers_are_refused(wrong: Any) -> None:
    with pytest.raises(TypeError, match="seed"):
        nmes.evaluate(snake(), SHORT, seeds=wrong)
    with Evaluator(1) as here, pytest.raises(TypeError, match="seed"):
        here.evaluate(snake(), SHORT, seeds=wrong)


def test_seeds_are_any_whole_numbers_in_a_row() -> None:
    expected = evaluate(snake(), SHORT, seeds=[5, 3])
    forms: list[Any] = [(5, 3), np.array([5, 3], np.uint8), [np.int64(5), np.array(3)], iter([5, 3])]
    for seeds in forms:
        assert evaluate(snake(), SHORT, seeds=seeds) == expected
    with Evaluator(1) as here:
        assert here.evaluate(snake(), SHORT, seeds=np.array([5, 3], np.int32)) == expected


def test_an_evaluator_has_one_job_or_more() -> None:
    for jobs in (0, -1):
        with pytest.raises(ValueError, match="1 or more"):
            Evaluator(jobs)
    halves: Any = 2.5
    with pytest.raises(TypeError, match="float"):
        Evaluator(halves)


def with_pid(portion: Sequence[Job]) -> list[Evaluation]:
    """Tells of each episode the process that ran it, as the work of its motors, and its portion as the distance."""
    first = portion[0].seeds
    assert first is not None
    results = [tuple(Result(seed, 0.0, float(os.getpid()), float(first[0]), 1) for seed in first)] * len(portion)
    return [Evaluation(job.name, "", "", "", each) for job, each in zip(portion, results, strict=True)]


def test_the_episodes_of_one_creature_are_shared_among_processes_that_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evaluator, "evaluate_portion", with_pid)
    seen = []
    told: list[tuple[int, int]] = []
    with Evaluator(2) as workers:
        for _ in range(2):
            work = [Job("one", orjson.dumps(snake()), orjson.dumps(Task.load("walk").document), tuple(range(60)))]
            ((index, found),) = workers.run(work, progress=lambda done, total: told.append((done, total)))
            assert index == 0 and [result.seed for result in found.results] == list(range(60))
            seen.append({result.energy for result in found.results})
    assert len(seen[0]) == 2 and float(os.getpid()) not in seen[0]
    assert seen[0] == seen[1]  # the same processes
    assert told[0] == (0, 60) and (60, 60) in told and len(told) >= 6  # it moves before all is done
    assert [done for done, _ in told[: len(told) // 2]] == sorted(done for done, _ in told[: len(told) // 2])


def test_a_few_short_episodes_start_no_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evaluator, "evaluate_portion", with_pid)
    with Evaluator(2) as workers:
        found = workers.evaluate("walker", "walk")
    assert {result.energy for result in found.results} == {float(os.getpid())}


def test_every_way_to_cut_the_work_gives_the_same_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(portions, "_WORTH", 60)  # so that little work is cut, too
    task, seeds = {**SHORT, "duration": 0.1, "seeds": [1]}, [*range(30), 7]
    genomes = [snake(mlp(4, seed=i)) for i in range(3)]
    expected = [evaluate(genome, task, seeds=seeds) for genome in genomes]
    assert len({result.score for result in expected[0].results}) == 30
    with Evaluator(2) as workers:
        assert workers.evaluate(genomes[0], task, seeds=seeds) == expected[0]
        assert workers.evaluate_population(genomes, task, seeds=seeds) == expected
    for jobs in (1, 2, 3, 5, 40):
        cut = portions.cut([orjson.dumps(genomes[0])], 31, 6, jobs)
        parts = [evaluate(genomes[0], task, seeds=seeds[part.seeds.start : part.seeds.stop]) for part in cut]
        assert Evaluation.joined(parts) == expected[0]
    assert len(cut) == 3


def test_recorded_episodes_are_those_that_one_process_records(tmp_path: Path) -> None:
    folders = [tmp_path / "one", tmp_path / "two"]
    found = []
    for folder, jobs in zip(folders, (1, 2), strict=True):
        folder.mkdir()
        with Evaluator(jobs) as workers:
            found.append(workers.evaluate(snake(mlp(4)), {**SHORT, "duration": 60}, seeds=[8, 2], record=folder))
    assert found[0] == found[1]
    names = [[Path(path).name for path in each.recordings] for each in found]
    assert names[0] == names[1] and [name.rsplit("-", 1)[1] for name in names[0]] == ["8.mcap", "2.mcap"]
    assert sorted(path.name for path in folders[1].iterdir()) == sorted(names[1])
    for name in names[0]:
        one, two = (nmes.Recording(folder / name) for folder in folders)
        assert [record.digests for record in one] == [record.digests for record in two]


def refuse_seed_two(portion: Sequence[Job]) -> list[Evaluation]:
    return [Evaluation("g", "", "", "", (), "two") if 2 in (job.seeds or ()) else with_pid([job])[0] for job in portion]


def test_a_creature_that_one_part_refuses_has_that_as_its_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evaluator, "evaluate_portion", refuse_seed_two)
    with Evaluator(1) as here:
        found = here.evaluate(snake(), "walk", seeds=range(200))
    assert found.error == "two" and found.results == () and found.recordings == ()
