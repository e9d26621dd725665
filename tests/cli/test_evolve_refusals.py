"""`nmes evolve` where it cannot begin, where nobody has a score, and of folders that no run left so."""

from __future__ import annotations

import json
import shutil
import signal
import sqlite3
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import orjson
import pytest
from click.testing import CliRunner, Result

from nmes.cli import main
from nmes.errors import MachineError
from nmes.evaluation import parallel
from nmes.evolution.run import Run
from runs import SETTINGS, TASK, begin, finish, forge


def nmes(*arguments: str | Path) -> Result:
    result = CliRunner().invoke(main, ["evolve", *map(str, arguments)])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


@pytest.fixture
def settings(tmp_path: Path) -> Path:
    (tmp_path / "settings.json").write_bytes(orjson.dumps({**SETTINGS, "budget": 3}))
    return tmp_path / "settings.json"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a finished run."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    finish(begin(folder))
    return folder


@pytest.fixture
def run(whole: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    shutil.copytree(whole, tmp_path / "run")
    return tmp_path / "run"


# -- processes and clusters that there are not ------------------------------------------------------------------------


def test_without_ray_no_run_is_begun(settings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    refused = nmes("--settings", settings, "-o", tmp_path / "run", "--ray", "auto")
    assert refused.exit_code == 1 and "nmes[ray]" in refused.output and not (tmp_path / "run").exists()
    assert nmes("--settings", settings, "-o", tmp_path / "run", "--jobs", "1").exit_code == 0


@pytest.mark.parametrize("reason", [MachineError("no_cluster", "no Ray cluster at 'nowhere:1'"), KeyboardInterrupt()])
def test_without_a_cluster_no_run_is_begun(
    settings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reason: BaseException
) -> None:
    def refuse(*_: object) -> None:
        raise reason

    monkeypatch.setattr(parallel, "Cluster", refuse)
    assert nmes("--settings", settings, "-o", tmp_path / "run", "--ray", "nowhere:1").exit_code == 1
    assert not (tmp_path / "run").exists()


def test_a_folder_that_holds_a_run_is_refused_before_a_cluster_is_asked_for(run: Path, settings: Path) -> None:
    refused = nmes("--settings", settings, "-o", run, "--ray", "nowhere:1")
    assert refused.exit_code == 1 and "there is a run" in refused.output


# -- a budget that is not kept yet ------------------------------------------------------------------------------------


def test_who_stops_before_a_greater_budget_is_kept_hears_how_to_go_on(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    replay = Run.replay

    def interrupted(self: Run, order: Any, ask: Callable[[], None]) -> Any:
        signal.raise_signal(signal.SIGINT)
        yield from replay(self, order, ask)

    monkeypatch.setattr(Run, "replay", interrupted)
    stopped = nmes("resume", run, "--budget", "30", "--jobs", "1")
    assert stopped.exit_code == 1 and f"nmes evolve resume {run} --budget 30" in stopped.stderr
    assert "stopped: 24 of 30 done" in stopped.stderr and Run.open(run).settings.budget == 24


# -- nobody has a score -----------------------------------------------------------------------------------------------


def test_a_run_in_which_nobody_has_a_score_says_why(tmp_path: Path) -> None:
    task = {**TASK, "objective": "1 / 0"}
    (tmp_path / "settings.json").write_bytes(orjson.dumps({**SETTINGS, "task": task, "budget": 5}))
    ended = nmes("--settings", tmp_path / "settings.json", "-o", tmp_path / "run", "--jobs", "1")
    reasons = [str(record.error) for record in Run.open(tmp_path / "run").records]
    restless = [reason for reason in reasons if reason.startswith("restless: ")]
    assert ended.exit_code == 0 and 3 == len(restless) == len(set(restless))  # each moved at a speed of its own
    assert f"no candidate has a score: {restless[0]} (3 of 5 are like this)\ndigest: " in ended.stdout
    told = json.loads(nmes("resume", tmp_path / "run", "--json").stdout)
    assert told["without_score"] == told["told"] == 5


def test_the_most_frequent_reason_is_told(run: Path) -> None:
    def fail(records: list[dict[str, Any]]) -> None:
        for record in records:
            why = "too\nheavy" if record["index"] % 3 else "too large"
            record.update(score=None, results=[], error=why)

    forge(run, fail)
    ended = nmes("resume", run)
    assert r"no candidate has a score: too\nheavy (16 of 24 are like this)" in ended.stdout, ended.output


def test_a_run_in_which_somebody_has_a_score_says_how_many_have_none(run: Path) -> None:
    forge(run, lambda records: records[3].update(score=None, results=[], error="it would not"))
    assert "no candidate" not in nmes("resume", run).stdout
    told = json.loads(nmes("resume", run, "--json").stdout)
    none = [record for record in Run.open(run).records if record.score is None]
    assert told["without_score"] == len(none) > 0


# -- what strangers write ---------------------------------------------------------------------------------------------


def test_a_figure_that_is_no_number_is_shown_as_a_dash(run: Path, tmp_path: Path) -> None:
    with closing(sqlite3.connect(run / "index.sqlite")) as db, db:
        db.execute("UPDATE state SET figures = ?", ('{"way": null}',))
    shown = nmes("show", run, "-o", tmp_path / "page.html")
    assert shown.exit_code == 0 and "<dt>way</dt><dd>-</dd>" in (tmp_path / "page.html").read_text()
    assert json.loads(nmes("show", run, "--json").stdout)["figures"] == {"way": None}


def test_a_figure_that_became_too_large_is_shown_and_goes_on(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nmes.evolution.algorithms.genetic.Genetic.figures", lambda self: {"way": float("inf")})
    resumed = nmes("resume", run, "--budget", "25", "--jobs", "1", "--json")
    assert json.loads(resumed.stdout)["figures"] == {"way": None}
    assert ["way", "-"] in [line.split() for line in nmes("show", run).stdout.splitlines()]
