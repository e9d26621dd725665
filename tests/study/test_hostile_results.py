"""Results of a study that somebody made up: refused with a reason, whatever is in the file."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path
from typing import Any

import pyarrow
import pyarrow.parquet
import pytest

from command_line import run
from nmes.study import Results, Study
from studies import make_study


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small study with results that nobody computed."""
    folder = make_study(tmp_path_factory.mktemp("studies") / "whole")
    plan = Study.load(folder).plan("small")
    rows = [
        {"arm": run.arm["name"], "seed": run.seed, "measured": False, "score": float(run.number), "hash": "x"}
        for run in plan.runs
    ]
    Results.here(plan, rows).write(plan)
    assert run("study", "report", folder).exit_code == 0
    return folder


@pytest.mark.parametrize(
    ("about", "column", "words"),
    [
        ({"fingerprint": []}, {}, "[] is no fingerprint"),
        ({"fingerprint": {"probe": 7}}, {}, "7 is no text"),
        ({"asked": None}, {}, "None is no text"),
        ({"digest": 1}, {}, "1 is no text"),
        ({}, {"score": [math.nan] * 6}, "the rows are not those that the study plans"),
        ({}, {"score": [math.inf] * 6}, "the rows are not those that the study plans"),
        ({}, {"score": [1e308, -1e308] * 3}, "the rows are not those that the study plans"),
        ({}, {"hash": [b"x"] * 6}, "a column has neither numbers nor texts nor truths"),
        ({}, {"hash": [["x"]] * 6}, "a column has neither numbers nor texts nor truths"),
        ({}, {"more": [1.0] * 6}, "the rows are not those that the study plans"),
        ({}, {"seed": [1] * 6}, "the rows are not those that the study plans"),
        ({}, {"score": [9.0] * 6}, "the rows do not have the digest that the file names"),
    ],
)
def test_results_that_a_study_cannot_have_are_refused_with_the_reason(
    about: dict[str, Any], column: dict[str, list[Any]], words: str, whole: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "whole"
    shutil.copytree(whole, folder)
    path = folder / "small" / "results.parquet"
    table = pyarrow.parquet.read_table(path)
    told = json.loads(table.schema.metadata[b"nmes.study"]) | about
    made = pyarrow.table({name: table[name] for name in table.column_names} | column)
    pyarrow.parquet.write_table(made.replace_schema_metadata({"nmes.study": json.dumps(told)}), path)
    for command in ("report", "verify"):
        result = run("study", command, folder)
        assert result.exit_code == 1 and words in result.output, result.output


def test_numbers_that_cannot_be_computed_with_are_told_by_their_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = make_study(tmp_path / "great")
    scores: tuple[object, ...] = (math.nan, math.inf, 1e101, [])
    for printed in scores:

        def told(text: bytes, score: object = printed) -> object:
            return [{"score": score}]

        with monkeypatch.context() as patched:
            patched.setattr("json.loads", told)
            result = run("study", "run", folder, "--jobs", "1")
        assert result.exit_code == 1 and "no number up to 1e+100 at /0/score" in result.output
