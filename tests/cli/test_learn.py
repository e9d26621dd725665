"""`nmes learn`, its runs interrupted, resumed, shown and proved, as a person would."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import orjson
import pytest
from click.testing import CliRunner, Result

from learning_runs import MOMENT, OPTIONS
from nmes.cli import main
from nmes.evaluation import Task, evaluate
from nmes.genome import Genome
from nmes.learning.run import LearningRun
from processes import NMES

BEGIN = ("--seed", "5", "--every", "3", *(w for name, value in OPTIONS.items() for w in ("--set", f"{name}={value}")))


def nmes(*arguments: str | Path) -> Result:
    result = CliRunner().invoke(main, ["learn", *map(str, arguments)])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


def told(result: Result) -> dict[str, Any]:
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    assert isinstance(document, dict)
    return document


@pytest.fixture(scope="module")
def task(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("learn") / "moment.json"
    path.write_bytes(orjson.dumps(MOMENT))
    return path


@pytest.fixture(scope="module")
def whole(task: Path) -> Path:
    """The folder of a finished run."""
    folder = task.parent / "whole"
    result = nmes("inchworm", "--task", task, "--steps", "480", *BEGIN, "-o", folder, "--threads", "1")
    assert result.exit_code == 0, result.output
    return folder


def test_a_run_says_how_it_came_out(whole: Path, task: Path) -> None:
    run = LearningRun.open(whole)
    assert run.best is not None
    found = told(nmes("resume", whole, "--json"))
    assert found == {
        "run": str(whole),
        "steps": 480,
        "legs": 8,
        "finished": True,
        "best": {name: run.best.content[name] for name in ("leg", "steps", "score", "genome_hash")},
        "genome": str(whole / "genome.json"),
        "digest": run.digest,
    }
    words = nmes("resume", whole).output
    assert "the run is finished" in words and f"digest: {run.digest}" in words
    assert evaluate(Genome.load(whole / "genome.json"), Task.load(task)).score == run.best.score


@pytest.mark.parametrize(("steps", "done", "legs"), [(20, 60, "1 leg"), (70, 120, "2 legs")])
def test_a_run_whose_last_leg_goes_beyond_its_steps_says_so(
    task: Path, tmp_path: Path, steps: int, done: int, legs: str
) -> None:
    result = nmes("inchworm", "--task", task, "--steps", str(steps), *BEGIN, "-o", tmp_path / "run", "--threads", "1")
    assert f"{done} of at least {steps} steps in {legs}\n" in result.output
    assert f"{done} of at least {steps}" in nmes("show", tmp_path / "run").output


def test_a_run_is_stopped_and_gone_on_with_to_the_same_digest(whole: Path, task: Path, tmp_path: Path) -> None:
    folder, steps = tmp_path / "stopped", 60 * 2000
    begin = ["inchworm", "--task", str(task), "--steps", str(steps), *BEGIN, "-o", str(folder)]
    child = subprocess.Popen([NMES, "learn", *begin], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    log = folder / "log.jsonl"
    while not (log.exists() and log.read_bytes().count(b"\n") > 2):
        assert child.poll() is None, child.communicate()
        time.sleep(0.01)
    child.send_signal(signal.SIGINT)
    output, errors = child.communicate(timeout=60)
    assert child.returncode == 1, errors
    assert f"of {steps:,} steps done" in errors and f"go on with: nmes learn resume {folder}" in errors
    assert "digest: " in output
    done = len(LearningRun.open(folder).legs)
    run = LearningRun.open(folder)
    for _ in zip(range(3), run.advance(), strict=False):
        pass
    again = tmp_path / "again"
    shutil.copytree(folder, again, ignore=shutil.ignore_patterns("log.jsonl", "states", "genome.json"))
    (again / "states").mkdir()
    other = LearningRun.open(again)
    for _, leg in zip(range(done + 3), other.advance(threads=2), strict=False):
        assert leg.digest == run.legs[leg.leg - 1].digest


def test_a_run_is_proved(whole: Path, tmp_path: Path) -> None:
    found = told(nmes("verify", whole, "--json", "--seed", "7", "--threads", "1"))
    assert (found["verdict"], found["findings"], found["legs"]) == ("holds", [], 8)
    assert (found["again"], found["seed"]) == (4, 7)
    assert "holds: 8 of 8 legs done again" in nmes("verify", whole, "--all", "--threads", "2").output
    folder = tmp_path / "copy"
    shutil.copytree(whole, folder)
    (folder / "genome.json").unlink()
    result = nmes("verify", folder, "--seed", "7")
    assert result.exit_code == 1
    assert "genome.json is missing or damaged" in result.output
    assert "broken: 4 of 8 legs done again, drawn by --seed 7\n" in result.output
    assert nmes("resume", folder).exit_code == 0
    assert (folder / "genome.json").read_bytes() == (whole / "genome.json").read_bytes()


def test_a_run_is_shown_in_words_as_data_and_as_pages(whole: Path, tmp_path: Path) -> None:
    words = nmes("show", whole).output
    assert "inchworm learns moment by ppo" in words and "480 of 480" in words and "rows=3" in words
    found = told(nmes("show", whole, "--json"))
    assert [leg["leg"] for leg in found["legs"]] == list(range(1, 9))
    assert found["settings"]["options"]["ticks"] == 20
    page, folder = tmp_path / "run.html", tmp_path / "pictures"
    assert nmes("show", whole, "-o", page).exit_code == 0
    text = page.read_text()
    assert "Score on moment" in text and "Mean return" in text and "Policy loss" in text
    assert "<script" not in text and "http://" not in text.replace("http://www.w3.org/2000/svg", "")
    assert nmes("show", whole, "-o", folder).exit_code == 0
    names = {path.name for path in folder.iterdir()}
    assert {"index.html", "score.svg", "return.svg", "value-loss.svg"} <= names
    assert nmes("show", whole, "-o", whole / "run.json").exit_code == 2


def test_a_run_without_a_leg_is_shown(task: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LearningRun, "advance", lambda self, threads: iter(()))
    assert nmes("inchworm", "--task", task, *BEGIN, "-o", tmp_path / "run").exit_code == 0
    assert "0 of 1,000,000" in nmes("show", tmp_path / "run").output
    assert nmes("show", tmp_path / "run", "-o", tmp_path / "run.html").exit_code == 0
    assert "holds: 0 of 0" in nmes("verify", tmp_path / "run").output


@pytest.fixture(scope="module")
def recordings(task: Path) -> list[Path]:
    folder = task.parent / "recordings"
    result = CliRunner().invoke(main, ["eval", "inchworm", "--task", str(task), "--record", str(folder), "--jobs", "1"])
    assert result.exit_code == 0, result.output
    return sorted(folder.glob("*.mcap"))


def test_recordings_are_cloned(recordings: list[Path], task: Path, tmp_path: Path) -> None:
    folder = tmp_path / "clone"
    arguments: list[str | Path] = [
        "--algorithm",
        "clone",
        *recordings,
        "--steps",
        "2000",
        "--set",
        "rate=0.01",
        "--set",
        "units=16",
    ]
    found = told(nmes(*arguments, "-o", folder, "--json"))
    run = LearningRun.open(folder)
    assert found["finished"] and run.settings.task.hash == Task.load(task).hash
    errors = [leg.content["figures"]["error"] for leg in run.legs]
    assert errors[-1] < 0.2 * errors[0]
    assert told(nmes("verify", folder, "--json"))["verdict"] == "holds"
    again = told(nmes(*arguments, "-o", tmp_path / "again", "--json"))
    assert again["digest"] == found["digest"]
    assert "2 (" in nmes("show", folder).output


def test_recordings_that_are_others_than_they_were_are_not_gone_on_with(
    recordings: list[Path], whole: Path, task: Path, tmp_path: Path
) -> None:
    other = [
        "eval",
        str(whole / "genome.json"),
        "--task",
        str(task),
        "--record",
        str(tmp_path / "other"),
        "--jobs",
        "1",
    ]
    assert CliRunner().invoke(main, other).exit_code == 0
    mine = [tmp_path / path.name for path in recordings]
    for path, there in zip(recordings, mine, strict=True):
        shutil.copy(path, there)
    folder = tmp_path / "clone"
    assert nmes("--algorithm", "clone", *mine, "--steps", "100", "-o", folder).exit_code == 0
    shutil.copy(next((tmp_path / "other").glob("*.mcap")), mine[1])
    result = nmes("verify", folder)
    assert result.exit_code == 1 and "the recordings are others than those that the run began with" in result.output
    run = folder / "run.json"
    document = json.loads(run.read_bytes())
    run.write_text(json.dumps({**document, "fingerprint": {**document["fingerprint"], "probe": "of another machine"}}))
    result = nmes("verify", folder)
    assert result.exit_code == 3 and "was begun where other numbers come out" in result.output
    mine[1].write_bytes(b"nothing")
    result = nmes("verify", folder)
    assert result.exit_code == 1 and str(mine[1]) in result.output


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "say what learns"),
        (("nobody",), "there is no genome 'nobody'"),
        (("walker", "inchworm"), "one creature learns, not 2"),
        (("walker", "--task", "nothing"), "there is no task 'nothing'"),
        (("walker", "--algorithm", "clone"), "walker"),
        (("walker", "--algorithm", "sac"), "there is no algorithm 'sac'"),
        (("walker", "--steps", "0"), "--steps"),
        (("walker", "--set", "rows"), "NAME=VALUE"),
        (("walker", "--set", "rows=1", "--set", "rows=2"), "rows is set twice"),
        (("walker", "--set", "rows=0"), "options.rows: must be from 1 to 4,096"),
        (("walker", "--reward", "speed +"), "reward: "),
        (("walker", "--every", "0"), "--every"),
    ],
)
def test_what_is_wrong_is_told_and_nothing_is_begun(arguments: tuple[str, ...], words: str, tmp_path: Path) -> None:
    result = nmes(*arguments, "-o", tmp_path / "run")
    assert result.exit_code in (1, 2)
    assert words in result.output and "Traceback" not in result.output
    assert not (tmp_path / "run").exists()


def test_a_creature_that_cannot_begin_leaves_no_folder(tmp_path: Path) -> None:
    task = tmp_path / "hasty.json"
    task.write_bytes(orjson.dumps({**MOMENT, "vary": {"drop": [0.5, 0.5]}}))  # it is still falling
    result = nmes("walker", "--task", task, "-o", tmp_path / "run")
    assert result.exit_code == 1 and "not yet at rest" in result.output
    assert list(tmp_path.iterdir()) == [task]


def test_a_folder_of_something_else_is_told(whole: Path, tmp_path: Path) -> None:
    for command in ("resume", "show", "verify"):
        result = nmes(command, tmp_path)
        assert result.exit_code == 2 and "there is no run in" in result.output
    result = nmes("inchworm", "-o", whole)
    assert result.exit_code == 1 and "there is a run in" in result.output
    (tmp_path / "file").write_text("x")
    result = nmes("inchworm", "-o", tmp_path / "file" / "run")
    assert result.exit_code == 1 and "cannot make the folder" in result.output
