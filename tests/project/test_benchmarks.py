"""The table of the benchmarks shows figures as they are named."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from layout import ROOT
from nmes.evaluation import Task

PROGRAM = """
import bench
from measure import Figure
bench.SUITES.clear()
bench.SUITES["one"] = lambda: [Figure("ants [8]", 0.0, "(not installed: pip install 'nmes[bench]')", at_least=1.0)]
bench.main()
"""


def test_brackets_of_names_and_units_are_shown(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, "--output", str(tmp_path / "bench.json")],
        cwd=ROOT / "benchmarks",
        env={**os.environ, "COLUMNS": "160"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "ants [8]" in done.stdout
    assert "pip install 'nmes[bench]'" in done.stdout
    assert "missed" in done.stdout and "[red]" not in done.stdout


@pytest.mark.parametrize("path", sorted((ROOT / "benchmarks" / "tasks").iterdir()), ids=lambda path: path.stem)
def test_tasks_of_the_benchmarks_differ_from_those_that_ship_in_their_score_alone(path: Path) -> None:
    task = Task.load(path)
    ground = Task.load({"ascent": "stairs"}[task.name])
    own = ("name", "description", "objective")
    assert {**task.document, **{key: ground.document[key] for key in own}} == ground.document
    assert task.document["objective"].startswith(f"({ground.document['objective']}) + ")
