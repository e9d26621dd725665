"""`kill -9` at random moments: a run comes out the same, however often and wherever it was killed."""

from __future__ import annotations

import multiprocessing
import random
import subprocess
import time
from pathlib import Path
from typing import Any

import orjson
import pytest

from nmes.evaluation import Workers
from nmes.evaluation.parallel import Here
from nmes.evolution.run import Run
from processes import NMES
from runs import SETTINGS, begin, finish

WALK = {"task": {**SETTINGS["task"], "limits": {}}, "starts": ["inchworm"]}
ALGORITHMS: dict[str, dict[str, Any]] = {
    "ga": {},
    "cma": {"options": {}, **WALK},
    "map-elites": {
        "options": {"window": 6, "initial": 6},
        "measures": [
            {"expression": "mass", "low": 0, "high": 50, "cells": 9},
            {"expression": "duty", "low": 0, "high": 1, "cells": 5},
        ],
    },
    "neat": {"options": {"population": 8}, **WALK},
    "nsga2": {"options": {"population": 6}, "objectives": ["distance", "-mass"]},
}


def advance(folder: Path, jobs: int) -> None:
    with Workers(jobs) if jobs > 1 else Here() as workers:
        for _ in Run.open(folder).advance(workers):
            pass


def lines(folder: Path) -> int:
    log = folder / "log.jsonl"
    return log.read_bytes().count(b"\n") if log.exists() else 0


def settings(algorithm: str, budget: int) -> dict[str, Any]:
    return {"algorithm": algorithm, "budget": budget, **ALGORITHMS[algorithm]}


@pytest.mark.parametrize(
    ("algorithm", "jobs"),
    [
        ("ga", (2, 1, 1)),
        ("cma", (1, 1, 1)),
        ("map-elites", (1, 1, 1)),
        ("neat", (1, 4, 1)),
        ("nsga2", (1, 1, 2)),
    ],
)
def test_kills_do_not_show_in_a_run(algorithm: str, jobs: tuple[int, ...], tmp_path: Path) -> None:
    whole = finish(begin(tmp_path / "whole", **settings(algorithm, 40)))
    folder, draw = tmp_path / "killed", random.Random(algorithm)
    begin(folder, **settings(algorithm, 40))
    for number, until in zip(jobs, (1, draw.randrange(2, 12), draw.randrange(12, 24)), strict=True):
        child = multiprocessing.get_context("fork").Process(target=advance, args=(folder, number))
        child.start()
        while lines(folder) < until and child.is_alive():
            time.sleep(0.001)
        time.sleep(draw.uniform(0.0, 0.01))
        child.kill()
        child.join()
    run = Run.open(folder)
    assert len(run) < 40
    assert finish(run).digest == whole.digest
    assert (folder / "log.jsonl").read_bytes() == (tmp_path / "whole" / "log.jsonl").read_bytes()


@pytest.mark.long
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_forty_kills_of_runs_with_one_two_and_four_workers_do_not_show(algorithm: str, tmp_path: Path) -> None:
    budget = 1000
    whole = finish(begin(tmp_path / "whole", **settings(algorithm, budget)))
    file = tmp_path / "settings.json"
    file.write_bytes(orjson.dumps({**SETTINGS, **settings(algorithm, budget)}))
    folder, draw, kills = tmp_path / "killed", random.Random(algorithm), 0
    while kills < 40:
        new = ["--settings", str(file), "-o", str(folder)]
        arguments = ["resume", str(folder)] if (folder / "run.json").exists() else new
        until, early = lines(folder) + draw.randrange(6), draw.random() < 0.25
        with subprocess.Popen([NMES, "evolve", *arguments, "--jobs", "124"[kills % 3]]) as running:
            while not early and lines(folder) < until and running.poll() is None:
                time.sleep(0.001)
            time.sleep(draw.uniform(0.0, 2.0 if early else 0.2))
            assert running.poll() is None, "the run was over too early"
            running.kill()
        kills += 1
    assert finish(Run.open(folder)).digest == whole.digest
    assert (folder / "log.jsonl").read_bytes() == (tmp_path / "whole" / "log.jsonl").read_bytes()
