"""Commands of a study's runs: how they end, what they are given, and what is beside them; and runs that end badly."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from command_line import run
from nmes.study.commands import Stopper
from studies import make_bare_study

CHECK = "nmes genome check walker --json"

Begun = Callable[[list[str], subprocess.Popen[bytes]], None]
"""Is told the words of a process, and the process, before anything else happens."""


def watch(monkeypatch: pytest.MonkeyPatch, begun: Begun) -> None:
    """Has each process that a study begins told to a function."""

    class Watched(Stopper):
        def begin(self, words: list[str], *others: Any) -> subprocess.Popen[bytes]:
            process = super().begin(words, *others)
            begun(words, process)
            return process

    monkeypatch.setattr("nmes.study.run.Stopper", Watched)


# -- how commands end -------------------------------------------------------------------------------------------------


def test_a_column_of_statuses_takes_none_of_a_command_that_did_not_do_its_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    commands = {"check": "nmes genome check nobody --json"}
    folder = make_bare_study(tmp_path / "bare", commands, {"status": "check status"})
    told = "run 0 (arm only, seed 1): nmes genome check nobody --json\n"
    result = run("study", "run", folder, "--jobs", "1")
    assert result.exit_code == 1
    assert f"{told}ended with status 2: " in result.output and "there is no file nobody" in result.output
    watch(monkeypatch, lambda words, process: process.kill())
    result = run("study", "run", folder, "--jobs", "1")
    assert result.exit_code == 1 and f"{told}was killed by signal 9: it said nothing" in result.output
