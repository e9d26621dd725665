"""`nmes survey`: thousands of worlds scored, the same however often and wherever it was interrupted, and provable."""

from __future__ import annotations

import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from multiprocessing import parent_process
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import orjson
import pytest
from PIL import Image

from command_line import run
from creatures import seedling
from disks import full_disk
from modelled import modelled
from nmes.backend import load_backend
from nmes.backend.fingerprint import fingerprint
from nmes.errors import MachineError, MissingPackage
from nmes.evaluation import Workers, evaluate, parallel
from nmes.evaluation.evaluator import Job, evaluate_portion
from nmes.evaluation.parallel import Here
from nmes.evaluation.task import Task
from nmes.fleet.atlas import GRAVITIES, HEIGHTS, atlas
from nmes.fleet.survey import Survey, SurveySettings, verify_survey
from nmes.genome import Genome
from processes import NMES
from runs import TASK, forge

FLAT = {**TASK, "name": "flat", "limits": {}}
HILLS = {
    **FLAT,
    "name": "hills",
    "world": {"scene": {"type": "heightfield", "heightfield": {"size": [10, 10], "samples": [21, 21], "height": 0.3}}},
}
NAMES = ("inchworm", "walker")


def settings(worlds: int = 24, seed: int = 5, names: tuple[str, ...] = NAMES) -> SurveySettings:
    tasks = [Task(FLAT), Task(HILLS)]
    return SurveySettings.of([Genome.load(name) for name in names], tasks, worlds, seed)


def finish(survey: Survey, jobs: int = 1) -> Survey:
    with Workers(jobs) if jobs > 1 else Here() as pool:
        for _ in survey.advance(pool, lambda done, total: None):
            pass
    return survey


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Survey:
    return finish(Survey.create(tmp_path_factory.mktemp("survey") / "whole", settings()))


def nothing(done: int, total: int) -> None:
    pass


def lines(folder: Path) -> int:
    log = folder / "log.jsonl"
    return log.read_bytes().count(b"\n") if log.exists() else 0


def test_each_world_has_what_an_evaluation_of_it_gives(whole: Survey) -> None:
    about = whole.settings
    seeds = {about.seed_of(world.world) for world in whole.worlds}
    assert len(seeds) == len(whole) == 24
    for world in whole.worlds:
        again = evaluate(about.genome(world.world), about.task(world.world), seeds=[about.seed_of(world.world)])
        assert (again.results[0], again.genome_hash) == (world.result, world.genome_hash)
    pairs = {(about.task(number).name, about.genome(number).name) for number in range(4)}
    assert pairs == {(task, name) for task in ("flat", "hills") for name in ("inchworm", "walker")}


@pytest.mark.parametrize("jobs", [2, 3])
def test_a_survey_is_the_same_for_any_number_of_workers(jobs: int, whole: Survey, tmp_path: Path) -> None:
    survey = finish(Survey.create(tmp_path / "again", settings()), jobs)
    assert survey.digest == whole.digest
    assert (survey.folder / "log.jsonl").read_bytes() == (whole.folder / "log.jsonl").read_bytes()


def test_kills_do_not_show_in_a_survey(whole: Survey, tmp_path: Path) -> None:
    folder, draw = tmp_path / "killed", random.Random(1)
    Survey.create(folder, settings())
    for jobs in "121":
        # So that lines come at more moments than one: a world at a time is written as soon as those before it are.
        before = lines(folder)
        with subprocess.Popen([NMES, "survey", "resume", str(folder), "--jobs", jobs], stdout=-3, stderr=-3) as child:
            while lines(folder) == before and child.poll() is None:
                time.sleep(0.001)
            time.sleep(draw.uniform(0.0, 0.01))
            child.kill()
    assert finish(Survey.open(folder)).digest == whole.digest
    assert (folder / "log.jsonl").read_bytes() == (whole.folder / "log.jsonl").read_bytes()


def crash_over_world_three(portion: Sequence[Job]) -> list[Any]:
    if any(settings().seed_of(3) in (job.seeds or ()) for job in portion):
        assert parent_process() is not None, "this would have been the process of the survey"
        os.kill(os.getpid(), signal.SIGSEGV)
    return [*evaluate_portion(portion)]


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_world_over_which_the_engine_crashes_says_so_and_the_survey_goes_on(
    jobs: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nmes.fleet.survey.evaluate_portion", crash_over_world_three)
    with Workers(jobs) as pool:
        survey = Survey.create(tmp_path / "survey", settings(6))
        for _ in survey.advance(pool, nothing):
            pass
    assert survey.finished
    assert {world.world for world in survey.worlds if world.error is not None} == {3}
    assert "SIGSEGV" in str(survey.worlds[3].error)


def test_ctrl_c_leaves_a_survey_that_can_be_gone_on_with(tmp_path: Path) -> None:
    folder = tmp_path / "stopped"
    arguments = ["galloper", "--task", "walk", "--worlds", "400", "-o", str(folder), "--jobs", "1", "--json"]
    with subprocess.Popen([NMES, "survey", *arguments], stdout=-1, stderr=-1, text=True) as child:
        while not lines(folder) and child.poll() is None:
            time.sleep(0.01)
        child.send_signal(signal.SIGINT)
        out, err = child.communicate(timeout=60)
    told = json.loads(out)
    assert child.returncode == 1
    assert 0 < told["worlds"] == lines(folder) < told["of"] == 400
    assert f"go on with: nmes survey resume {folder}" in err
    assert verify_survey(folder, Here(), 2, nothing).verdict == "holds"


def test_random_creatures_are_others_in_each_world(tmp_path: Path) -> None:
    survey = finish(Survey.create(tmp_path / "random", settings(6, names=())))
    assert len({world.genome_hash for world in survey.worlds}) == 6
    assert verify_survey(survey.folder, Here(), None, nothing).verdict == "holds"


def test_the_atlas_has_a_task_for_each_height_and_gravity() -> None:
    tasks = [Task(document) for document in atlas()]
    assert len({task.hash for task in tasks}) == len(GRAVITIES) * len(HEIGHTS) == 25
    configs = [task.world_config(1) for task in tasks]
    assert [config["gravity"][1] for config in configs[::5]] == [-gravity for gravity in GRAVITIES]
    assert [config["scene"]["heightfield"]["height"] for config in configs[:5]] == list(HEIGHTS)


@pytest.mark.parametrize("task", [0, 14, 20])
def test_creatures_walk_in_the_worlds_of_the_atlas(task: int) -> None:
    result = evaluate("roller", atlas()[task], seeds=[3]).results[0]
    assert result.fault is None
    assert result.score is not None and result.score > 0.5


def changed(field: str, value: Any) -> Callable[[list[dict[str, Any]]], None]:
    return lambda records: records[3]["result"].update({field: value})


@pytest.mark.parametrize(
    ("change", "finding"),
    [
        (changed("score", 7.0), "world 3: score is "),
        (changed("energy", 7.0), "world 3: energy is "),
        (changed("seed", 7), "world 3: seed is "),
        (lambda records: records[3].update(genome_hash=64 * "0"), "world 3: its creature is another"),
        (lambda records: records[3].update(result=None, error="no"), "world 3: it has a result, where the log has no"),
    ],
)
def test_what_a_log_has_otherwise_is_found(
    change: Callable[[list[dict[str, Any]]], None], finding: str, whole: Survey, tmp_path: Path
) -> None:
    folder = tmp_path / "forged"
    shutil.copytree(whole.folder, folder)
    forge(folder, change)
    found = verify_survey(folder, Here(), None, nothing)
    assert (found.verdict, found.evaluated) == ("broken", 24)
    assert len(found.findings) == 1 and found.findings[0].startswith(finding)
    assert run("survey", "verify", folder, "--all").exit_code == 1


def test_the_best_world_is_among_those_that_are_done_again_and_the_others_are_drawn_each_time(
    whole: Survey, tmp_path: Path
) -> None:
    folder = tmp_path / "forged"
    shutil.copytree(whole.folder, folder)
    forge(folder, changed("score", 99.0))
    found = verify_survey(folder, Here(), 0, nothing)
    assert (found.verdict, found.evaluated) == ("broken", 1) and found.findings[0].startswith("world 3: score is ")
    one, other = (run("survey", "verify", whole.folder, "--sample", "2", "--jobs", "1") for _ in range(2))
    assert one.exit_code == 0 and one.output != other.output
    seed = one.output.partition("3 of 24 worlds evaluated again, drawn by --seed ")[2].split()[0]
    told = json.loads(run("survey", "verify", whole.folder, "--sample", "2", "--seed", seed, "--json").output)
    assert (told["seed"], told["evaluated"]) == (int(seed), 3)


def test_which_worlds_are_done_again_follows_from_the_seed(whole: Survey, monkeypatch: pytest.MonkeyPatch) -> None:
    chosen: list[tuple[int, ...]] = []

    def worlds(about: SurveySettings, numbers: list[int], *_: Any) -> list[Any]:
        chosen.append(tuple(numbers))
        return []

    monkeypatch.setattr("nmes.fleet.survey.survey_worlds", worlds)
    for seed in [*range(10), 0]:
        verify_survey(whole.folder, Here(), 3, nothing, seed)
    assert whole.best is not None
    assert len({*chosen[:10]}) > 5 and chosen[0] == chosen[10]
    assert all(whole.best.world in numbers and len(numbers) == 4 for numbers in chosen)


def test_what_a_model_rounds_otherwise_is_not_comparable(tmp_path: Path) -> None:
    about = SurveySettings.of([Genome(modelled()), Genome(seedling())], [Task(FLAT)], 4, 5)
    folder = finish(Survey.create(tmp_path / "models", about)).folder
    forge(folder, lambda records: records[2]["result"].update(energy=7.0))
    found = verify_survey(folder, Here(), None, nothing)
    assert found.verdict == "not_comparable" and "it has an ONNX brain" in found.findings[0]
    forge(folder, lambda records: records[3]["result"].update(energy=7.0))
    found = verify_survey(folder, Here(), None, nothing)
    assert found.verdict == "broken" and "ONNX" not in found.findings[1]


def test_a_package_that_is_missing_is_not_written_down_as_a_fault_of_the_creature(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = Survey.create(tmp_path / "begun", SurveySettings.of([Genome(modelled())], [Task(FLAT)], 4, 5))
    (file := tmp_path / "model.json").write_bytes(orjson.dumps(modelled()))
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(MissingPackage):
        finish(begun)
    assert not lines(begun.folder)
    refused = run("survey", file, "-o", tmp_path / "survey")
    assert refused.exit_code == 1 and "pip install 'nmes[onnx]'" in refused.output
    assert not (tmp_path / "survey").exists()


def test_a_best_world_that_comes_out_otherwise_is_only_comparable_where_it_was_scored(
    whole: Survey, tmp_path: Path
) -> None:
    folder = tmp_path / "elsewhere"
    shutil.copytree(whole.folder, folder)
    assert whole.best is not None
    number = whole.best.world
    forge(folder, lambda records: records[number]["result"].update(energy=7.0))
    said = "world .* does not come out again"
    refused = run("survey", "best", folder)
    assert refused.exit_code == 1 and re.search(said, refused.output) and "other numbers" not in refused.output
    assert [*(folder / f"world-{number}").iterdir()] == []
    document = orjson.loads((folder / "run.json").read_bytes())
    document["fingerprint"]["probe"] = "of another machine"
    (folder / "run.json").write_bytes(orjson.dumps(document))
    refused = run("survey", "best", folder)
    assert refused.exit_code == 3 and "it was begun where other numbers come out" in refused.output


def test_each_engine_of_a_survey_has_its_probe() -> None:
    flat = {**FLAT, "name": "planar", "world": {"backend": "pymunk"}}
    about = SurveySettings.of([Genome.load("inchworm")], [Task(FLAT), Task(flat)], 4, 5)
    kept = about.fingerprint()
    for engine in ("mujoco", "pymunk"):
        here = fingerprint(load_backend(engine))
        assert kept[f"engine.{engine}.probe"] == here["probe"]
        assert kept[f"engine.{engine}.version"] == here["engine.version"]
    assert settings().fingerprint() == fingerprint(load_backend("mujoco"))


def test_a_log_that_was_edited_is_found(whole: Survey, tmp_path: Path) -> None:
    folder = tmp_path / "edited"
    shutil.copytree(whole.folder, folder)
    log = (folder / "log.jsonl").read_bytes()
    (folder / "log.jsonl").write_bytes(log.replace(b'"world":3,', b'"world":4,'))
    found = verify_survey(folder, Here(), 3, nothing)
    assert found.verdict == "broken" and "line 4: it is not as it was written" in found.findings[0]
    forge(folder, lambda records: records[3].update(world=4))
    assert "it is no record of world 3" in verify_survey(folder, Here(), 3, nothing).findings[0]


def test_a_survey_is_shown_drawn_and_its_best_world_proved(whole: Survey, tmp_path: Path) -> None:
    shown = run("survey", "show", whole.folder, "-o", tmp_path / "pictures")
    assert shown.exit_code == 0, shown.output
    assert "24 of 24 worlds, 18 with a score" in shown.output and whole.digest in shown.output
    picture = ElementTree.parse(tmp_path / "pictures" / "map.svg").getroot()
    words = " ".join(element.text or "" for element in picture.iter("{http://www.w3.org/2000/svg}text"))
    assert "flat" in words and "hills" in words and "mean" in words
    with Image.open(tmp_path / "pictures" / "map.png") as drawn:
        assert drawn.size[0] > 600
    told = json.loads(run("survey", "show", whole.folder, "--json").output)
    best = max(world.score or 0.0 for world in whole.worlds)
    assert told["best"]["score"] == best and told["tasks"][0]["worlds"] == 12

    written = json.loads(run("survey", "best", whole.folder, "-o", tmp_path / "best", "--json").output)
    assert (written["world"], written["score"]) == (told["best"]["world"], best)
    (recording,) = written["recordings"]
    rescored = run("eval", "--from-recording", recording, "--json")
    assert rescored.exit_code == 0, rescored.output
    assert str(best) in rescored.output


def test_a_best_world_is_not_written_over_a_run_or_another_genome(whole: Survey, tmp_path: Path) -> None:
    (run_folder := tmp_path / "run").mkdir()
    (run_folder / "run.json").write_text("{}")
    (other := tmp_path / "other").mkdir()
    (other / "genome.json").write_text("{}")
    for folder, said in ((run_folder, "holds a run"), (whole.folder, "holds a run"), (other, "another genome.json")):
        before = {path: path.read_bytes() for path in folder.iterdir() if path.is_file()}
        refused = run("survey", "best", whole.folder, "-o", folder)
        assert refused.exit_code == 2 and said in refused.output
        assert {path: path.read_bytes() for path in folder.iterdir() if path.is_file()} == before
    for _ in range(2):
        assert run("survey", "best", whole.folder, "-o", tmp_path / "best").exit_code == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["inchworm", "--worlds", "0"], "0 is not in the range"),
        (["inchworm", "--task", "wlak"], "wlak"),
        (["inchworm", "--task", "sumo"], "this is a match of red, blue"),
        (["random", "inchworm"], "either `random` or genomes"),
        (["nobody"], "no genome of that name ships"),
        ([], "Missing argument"),
    ],
)
def test_wrong_usage_is_refused_and_leaves_no_folder(arguments: list[str], words: str, tmp_path: Path) -> None:
    refused = run("survey", *arguments, "-o", tmp_path / "survey")
    assert refused.exit_code == 2
    assert words in refused.output
    assert not (tmp_path / "survey").exists()


@pytest.mark.parametrize("reason", [MachineError("no_cluster", "no Ray cluster at 'nowhere:1'"), KeyboardInterrupt()])
def test_without_a_cluster_no_survey_is_begun(
    whole: Survey, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reason: BaseException
) -> None:
    def refuse(*_: object) -> None:
        raise reason

    monkeypatch.setattr(parallel, "Cluster", refuse)
    assert run("survey", "inchworm", "-o", tmp_path / "survey", "--ray", "nowhere:1").exit_code == 1
    assert not (tmp_path / "survey").exists()
    again = run("survey", "inchworm", "-o", whole.folder, "--ray", "nowhere:1")
    assert again.exit_code == 1 and "there is a run in" in again.output  # and no cluster was asked for


def test_folders_that_are_none_of_a_survey_are_refused(whole: Survey, tmp_path: Path) -> None:
    assert "there is no run in" in run("survey", "show", tmp_path).output
    again = run("survey", "inchworm", "-o", whole.folder)
    assert again.exit_code == 1 and "there is a run in" in again.output
    document = orjson.loads((whole.folder / "run.json").read_bytes())
    for change, words in (
        ({"format": "nmes-survey/2"}, "of the format nmes-survey/2"),
        ({"rows": ["a", "b"]}, "2 rows of 2 columns are not 2 tasks"),
        ({"tasks": [{}, {}]}, "is not as it must be"),
        ({"worlds": 10**9}, "worlds"),
    ):
        (tmp_path / "run.json").write_bytes(orjson.dumps({**document, **change}))
        refused = run("survey", "resume", tmp_path)
        assert refused.exit_code == 2 and words in refused.output
    elsewhere = {**document["fingerprint"], "probe": "of another machine"}
    (tmp_path / "run.json").write_bytes(orjson.dumps({**document, "fingerprint": elsewhere}))
    refused = run("survey", "resume", tmp_path)
    assert refused.exit_code != 0 and "was begun where other numbers come out" in refused.output


def test_a_survey_that_is_finished_stays_as_it_is(whole: Survey, tmp_path: Path) -> None:
    folder = tmp_path / "finished"
    shutil.copytree(whole.folder, folder)
    document = orjson.loads((folder / "run.json").read_bytes())
    document["fingerprint"]["probe"] = "of another machine"
    (folder / "run.json").write_bytes(orjson.dumps(document))
    before = {path: path.stat().st_mtime_ns for path in [folder, *folder.iterdir()]}
    resumed = run("survey", "resume", folder)
    assert resumed.exit_code == 0 and "the survey is finished" in resumed.output and whole.digest in resumed.output
    assert json.loads(run("survey", "resume", folder, "--json").stdout)["digest"] == whole.digest
    assert {path: path.stat().st_mtime_ns for path in [folder, *folder.iterdir()]} == before


def test_a_disk_that_is_full_loses_nothing(whole: Survey, tmp_path: Path) -> None:
    folder = tmp_path / "full"
    Survey.create(folder, settings())
    enough = len((whole.folder / "log.jsonl").read_bytes()) // 2
    arguments = [NMES, "survey", "resume", str(folder), "--jobs", "1"]
    with full_disk(enough), subprocess.Popen(arguments, stdout=-1, stderr=-1, text=True) as child:
        _, err = child.communicate(timeout=100)
    assert child.returncode == 1 and "cannot write" in err and "Traceback" not in err
    assert finish(Survey.open(folder)).digest == whole.digest
