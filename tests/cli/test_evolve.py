"""`nmes evolve`, its runs interrupted, resumed and proved, as a person would."""

from __future__ import annotations

import json
import os
import pty
import re
import shutil
import signal
import sqlite3
import subprocess
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import orjson
import pytest
from click.testing import CliRunner, Result

from disks import full_disk
from nmes.cli import main
from nmes.cli._evolve_run import _note, _populations_note
from nmes.evolution.run import Run
from nmes.evolution.run_index import Record
from nmes.genome import Genome
from processes import NMES, process
from runs import SETTINGS, TASK

OPTIONS = [word for name, value in SETTINGS["options"].items() for word in ("--set", f"{name}={value}")]
BEGIN = ("--budget", str(SETTINGS["budget"]), "--seed", str(SETTINGS["seed"]), *OPTIONS)


def nmes(*arguments: str | Path) -> Result:
    result = CliRunner().invoke(main, ["evolve", *map(str, arguments)])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


def told(result: Result) -> dict[str, Any]:
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    assert isinstance(document, dict)
    return document


@pytest.fixture(scope="module")
def task(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("task") / "moment.json"
    path.write_bytes(orjson.dumps(TASK))
    return path


@pytest.fixture(scope="module")
def whole(task: Path) -> Path:
    """The folder of a finished run."""
    folder = task.parent / "whole"
    assert nmes("random", "--task", task, *BEGIN, "-o", folder, "--jobs", "1").exit_code == 0
    return folder


@pytest.fixture
def run(whole: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    shutil.copytree(whole, tmp_path / "run")
    return tmp_path / "run"


# -- begin and resume -------------------------------------------------------------------------------------------------


def test_a_run_ends_with_its_best_and_its_digest(whole: Path, tmp_path: Path) -> None:
    ended = nmes("resume", whole)
    assert ended.exit_code == 0 and "finished" in ended.stderr
    summary = told(nmes("resume", whole, "--json", "--jobs", "1"))
    assert summary["told"] == summary["budget"] == 24 and summary["finished"]
    assert summary["best"]["score"] > 0.0 and summary["best"]["index"] < 24
    assert f"digest: {summary['digest']}" in ended.stdout and f"candidate {summary['best']['index']}" in ended.stdout
    lines = (whole / "log.jsonl").read_bytes().splitlines()
    assert orjson.loads(lines[-1])["digest"] == summary["digest"]
    (tmp_path / "settings.json").write_bytes(orjson.dumps(SETTINGS))
    other = nmes("--settings", tmp_path / "settings.json", "-o", tmp_path / "other", "--jobs", "1", "--json")
    assert told(other)["digest"] == summary["digest"]


def test_a_run_can_be_given_a_greater_budget(run: Path, task: Path, tmp_path: Path) -> None:
    longer = told(nmes("resume", run, "--budget", "30", "--jobs", "1", "--json"))
    settings = orjson.dumps({**SETTINGS, "budget": 30})
    (tmp_path / "settings.json").write_bytes(settings)
    at_once = told(nmes("--settings", tmp_path / "settings.json", "-o", tmp_path / "b", "--jobs", "1", "--json"))
    assert longer["digest"] == at_once["digest"] and longer["told"] == 30
    result = nmes("resume", run, "--budget", "29")
    assert result.exit_code == 1 and "30" in result.output
    before = (run / "run.json").read_bytes()
    assert nmes("resume", run, "--budget", str(2 * 10**9)).exit_code == 2 and (run / "run.json").read_bytes() == before


def test_who_resumes_a_run_whose_index_lags_brings_it_up_to_date(run: Path, whole: Path) -> None:
    db = sqlite3.connect(run / "index.sqlite")
    with db:  # as a kill just before the end leaves it
        db.execute("UPDATE state SET told = 12, elites = '[3]', figures = '{}'")
    as_it_was = told(nmes("resume", whole, "--json"))
    assert told(nmes("resume", run, "--jobs", "1", "--json")) == {**as_it_was, "run": str(run)}
    assert db.execute("SELECT told FROM state").fetchall() == [(24,)]
    db.close()


def test_where_a_run_lies_unless_said_otherwise(task: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = nmes("random", "--task", task, "--algorithm", "random", "--budget", "1", "--seed", "5", "--jobs", "1")
    assert result.exit_code == 0 and "runs/moment-random-5: 1 of 1" in result.stdout
    assert Path("runs/moment-random-5/log.jsonl").is_file()


def test_genomes_to_begin_with_are_files_folders_and_names(task: Path, tmp_path: Path) -> None:
    folder = tmp_path / "genomes"
    folder.mkdir()
    for name in ("roller", "inchworm"):
        (folder / f"{name}.json").write_bytes(orjson.dumps(Genome.load(name).document))
    result = nmes(folder, "walker", "--budget", "1", "--seeds", "2-3", "-o", tmp_path / "run", "--jobs", "1")
    assert result.exit_code == 0, result.output
    settings = orjson.loads((tmp_path / "run" / "run.json").read_bytes())
    assert [start["name"] for start in settings["starts"]] == ["inchworm", "roller", "walker"]
    assert settings["seeds"] == [2, 3] and settings["fingerprint"]["probe"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("random", "--algorithm", "gaa"), "did you mean ga"),
        (("random", "--algorithm", "cma-es"), "did you mean cma?"),
        (("random", "--budget", "0"), "0"),
        (("random", "--task", "wlk"), "did you mean walk"),
        (("random", "walker"), "either"),
        (("nobody",), "nobody"),
        ((), "WHAT"),
        (("random", "--set", "window"), "NAME=VALUE"),
        (("random", "--set", "window=wide"), "NAME=VALUE"),
        (("random", "--set", "window=1", "--set", "window=2"), "twice"),
        (("random", "--set", "windw=1"), "did you mean window"),
        (("random", "--set", "window=0"), "window"),
        (("random", "--set", "window=1e3"), "without point or exponent, not 1000.0"),
        (("random", "--set", "brains=1"), "true or false, not 1"),
        (("random", "--measure", "legs"), "from LOW to HIGH"),
        (("random", "--measure", "legs from a to b"), "from LOW to HIGH"),
        (("random", "--measure", "legs from 0 to nan"), "from LOW to HIGH"),
        (("random", "--jobs", "1", "--ray", "auto"), "either"),
        (("random", "--settings", "SETTINGS"), "--settings"),
        (("--settings", "SETTINGS", "--seed", "1"), "--settings"),
        (("--settings", "BROKEN"), "budget"),
        (("random", "--bugdet", "1"), "--budget"),
        (("resume", "nowhere"), "nowhere"),
        (("verify", "nowhere"), "nowhere"),
        (("resume", "nowhere", "--jobs", "0"), "0"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else value,
)
def test_wrong_usage_is_told_and_makes_nothing(
    arguments: tuple[str, ...], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("SETTINGS").write_bytes(orjson.dumps(SETTINGS))
    Path("BROKEN").write_bytes(orjson.dumps({**SETTINGS, "budget": "much"}))
    result = nmes(*arguments)
    assert result.exit_code == 2 and words in result.output, result.output
    assert sorted(path.name for path in tmp_path.iterdir()) == ["BROKEN", "SETTINGS"]


def test_measures_may_hold_any_expression(task: Path, tmp_path: Path) -> None:
    measures = ("legs > 2.0 ? mass : 2 * mass from 0 to 1e2 in 7", "height from -1 to 2")
    options = [text for measure in measures for text in ("--measure", measure)]
    arguments = ("random", "--task", task, "--algorithm", "map-elites", "--budget", "3", "--jobs", "1")
    result = nmes(*arguments, *options, "-o", tmp_path / "run")
    assert result.exit_code == 0, result.output
    assert orjson.loads((tmp_path / "run" / "run.json").read_bytes())["measures"] == [
        {"expression": "legs > 2.0 ? mass : 2 * mass", "low": 0, "high": 100, "cells": 7},
        {"expression": "height", "low": -1, "high": 2, "cells": 50},
    ]


def test_a_folder_that_holds_a_run_is_refused(run: Path, task: Path) -> None:
    before = (run / "log.jsonl").read_bytes()
    result = nmes("random", "--task", task, *BEGIN, "-o", run)
    assert result.exit_code == 1 and "resume" in result.output
    assert (run / "log.jsonl").read_bytes() == before


# -- interruptions ----------------------------------------------------------------------------------------------------


def until(condition: Callable[[], bool], running: subprocess.Popen[str]) -> None:
    while not condition():
        assert running.poll() is None, running.communicate()
        time.sleep(0.01)


@pytest.mark.parametrize(("number", "jobs"), [(signal.SIGINT, "2"), (signal.SIGTERM, "1")])
def test_a_run_that_is_stopped_says_how_to_go_on(number: signal.Signals, jobs: str, task: Path, tmp_path: Path) -> None:
    folder, log = tmp_path / "run", tmp_path / "run" / "log.jsonl"
    arguments = ("evolve", "random", "--task", str(task), *BEGIN, "--budget", "100000", "-o", str(folder))
    with process(*arguments, "--jobs", jobs, "--json") as running:
        until(lambda: log.is_file() and log.read_bytes().count(b"\n") > 8, running)  # children of founders are bred
        running.send_signal(number)
        out, err = running.communicate()
    assert running.returncode == 1 and f"nmes evolve resume {folder}" in err and "Traceback" not in err
    stopped = json.loads(out)
    assert 8 < stopped["told"] < 100000 and not stopped["finished"]
    assert f"stopped: {stopped['told']:,} of 100,000 done" in err
    lines = log.read_bytes().splitlines()
    assert len(lines) == stopped["told"] and orjson.loads(lines[-1])["digest"] == stopped["digest"]
    more = stopped["told"] + 5
    rest = ("--budget", str(more), "--jobs", "1", "--json")
    resumed = told(nmes("resume", folder, *rest))
    at_once = nmes("random", "--task", task, *BEGIN, "-o", tmp_path / "b", *rest)
    assert resumed["told"] == more and resumed["digest"] == told(at_once)["digest"]


def test_on_a_terminal_a_run_shows_how_much_of_its_log_was_read_and_how_it_fares(run: Path) -> None:
    terminal, end = pty.openpty()
    arguments, wide = [NMES, "evolve", "resume", str(run), "--budget", "25", "--jobs", "1"], {"COLUMNS": "200"}
    with subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=end, env={**os.environ, **wide}) as resumed:
        os.close(end)
        shown = b""
        with suppress(OSError):  # as Linux says that nobody has the other end any more
            while text := os.read(terminal, 4096):
                shown += text
    os.close(terminal)
    assert resumed.returncode == 0
    lines = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", shown.decode())
    assert re.search(r"reading the log \S+ +100%", lines)
    records = Run.open(run).records
    scores = [record.score for record in records if record.score is not None]
    diversity = len({record.plan for record in records}) / 25
    note = f"best {max(scores):.4g}, mean {sum(scores) / len(scores):.4g}, diversity {diversity:.0%}, "
    ended = re.search(rf"evolving +\S+ +100% (\S+) {re.escape(note)}(\d+\.\d)/s\s*$", lines)
    assert ended is not None, lines[-500:]
    assert ended[1] == "0:00:00" and float(ended[2]) > 0.0  # the time left, and candidates a second


def made_up(score: float | None, plan: str, group: str = "") -> Record:
    return Record(0, 0, 0, "", score, "random", (), 0, group, (), (), "", "", plan, None)


def test_the_progress_of_a_run_tells_its_best_the_mean_and_the_diversity() -> None:
    recent = deque([made_up(1.0, "a"), made_up(None, "b"), made_up(2.0, "a"), made_up(0.5, "c")])
    assert _note(recent, made_up(3.25, "d")) == "best 3.25, mean 1.167, diversity 75%"
    assert _note(deque([made_up(None, "a")]), None) == "best none, mean none, diversity 100%"
    meeting = deque([made_up(1.0, "a", "prey"), made_up(None, "a", "hunter"), made_up(2.0, "a", "prey")])
    assert _populations_note(meeting) == "mean of hunter none, prey 1.5"


def test_a_signal_whose_exception_is_lost_stops_a_run_too(
    task: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    advance = Run.advance

    def losing(self: Run, *arguments: Any) -> Iterator[Record]:
        for record in advance(self, *arguments):
            if record.index == 3:
                with suppress(KeyboardInterrupt):  # as an extension does that drops errors
                    signal.raise_signal(signal.SIGTERM)
            yield record

    monkeypatch.setattr(Run, "advance", losing)
    result = nmes(
        "random", "--task", task, "--budget", "24", "--set", "window=1", "-o", tmp_path / "run", "--jobs", "1"
    )
    assert result.exit_code == 1 and "resume" in result.stderr
    assert len(Run.open(tmp_path / "run")) == 4


def test_a_full_disk_stops_a_run_that_goes_on_once_there_is_room(task: Path, tmp_path: Path, whole: Path) -> None:
    folder = tmp_path / "run"
    enough = len((whole / "log.jsonl").read_bytes()) // 2
    arguments = [NMES, "evolve", "random", "--task", str(task), *BEGIN, "-o", str(folder), "--jobs", "1"]
    with full_disk(enough):
        result = subprocess.run(arguments, capture_output=True, text=True)
    assert result.returncode == 1 and "make room" in result.stderr and "Traceback" not in result.stderr
    text = (folder / "log.jsonl").read_bytes()
    assert 0 < len(text) <= enough and text.endswith(b"\n")
    assert nmes("resume", folder, "--jobs", "1").exit_code == 0
    assert (folder / "log.jsonl").read_bytes() == (whole / "log.jsonl").read_bytes()


def test_an_extra_that_is_missing_is_named(tmp_path: Path) -> None:
    program = "import sys; sys.modules['cma'] = None; from nmes.cli import main; main()"
    arguments = [os.path.join(os.path.dirname(NMES), "python"), "-c", program, "evolve", "walker", "--algorithm", "cma"]
    result = subprocess.run([*arguments, "-o", str(tmp_path / "run")], capture_output=True, text=True)
    assert result.returncode == 1 and "pip install 'nmes[evolve]'" in result.stderr, result.stderr
    assert not (tmp_path / "run").exists()


def test_the_unit_of_a_task_changes_no_digest(tmp_path: Path) -> None:
    digests = []
    for name, more in (("with", {"unit": "m"}), ("without", {})):
        (tmp_path / f"{name}.json").write_text(json.dumps({**TASK, **more}))
        task, folder = str(tmp_path / f"{name}.json"), str(tmp_path / name)
        options = ["--task", task, "--budget", "2", "--jobs", "1", "--json", "-o", folder]
        done = CliRunner().invoke(main, ["evolve", "random", *options])
        assert done.exit_code == 0, done.output
        digests.append(json.loads(done.stdout)["digest"])
    assert digests[0] == digests[1]
