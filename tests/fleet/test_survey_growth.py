"""`nmes survey growth`: parts of a survey are told as surveys that might have been."""

from __future__ import annotations

import json
from itertools import combinations
from math import isclose
from pathlib import Path
from typing import Any

import pytest

from command_line import run
from nmes.evaluation.judge import Result
from nmes.evaluation.parallel import Here
from nmes.evaluation.task import Task
from nmes.fleet.growth import behaviour
from nmes.fleet.survey import Survey, SurveySettings
from nmes.genome import Genome
from runs import TASK

WORLDS = 12


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Survey:
    task = Task({**TASK, "name": "flat", "limits": {}, "vary": {"friction": [0.4, 1.2], "yaw": [-3.0, 3.0]}})
    settings = SurveySettings.of([Genome.load(name) for name in ("inchworm", "walker")], [task], WORLDS, 5)
    made = Survey.create(tmp_path_factory.mktemp("growth") / "survey", settings)
    with Here() as pool:
        for _ in made.advance(pool, lambda done, total: None):
            pass
    return made


def growth(folder: Path, draws: int = 2000) -> Any:
    result = run("survey", "growth", folder, "--draws", str(draws), "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def scores(survey: Survey) -> list[float]:
    return [world.score for world in survey.worlds if world.score is not None]


def test_all_worlds_come_to_what_the_survey_came_to(survey: Survey) -> None:
    found = growth(survey.folder)
    whole, best = found["sizes"][-1], survey.best
    assert best is not None
    assert (found["worlds"], whole["worlds"], found["part"]) == (WORLDS, WORLDS, len(scores(survey)) / WORLDS)
    assert whole["best"] == whole["best_low"] == whole["best_high"] == best.score
    kinds = {behaviour(world.result) for world in survey.worlds if world.result is not None}
    assert whole["behaviours"] == len(kinds)
    assert [size["worlds"] for size in found["sizes"]] == [1, 3, 6, 12]


def test_parts_come_to_what_probability_says(survey: Survey) -> None:
    """Of one world, the mean score; of a half, what the greatest of so many without replacement is expected to be."""
    found, every = growth(survey.folder), scores(survey)
    assert len(every) == WORLDS
    for size in found["sizes"]:
        groups = list(combinations(every, size["worlds"]))
        exact = sum(map(max, groups)) / len(groups)
        assert isclose(size["best"], exact, rel_tol=0.05, abs_tol=0.02)
        assert min(map(max, groups)) <= size["best_low"] <= size["best"] <= size["best_high"] <= max(every)
    quarter = next(size for size in found["sizes"] if size["worlds"] == WORLDS // 4)
    assert found["best_gain"] == found["sizes"][-1]["best"] - quarter["best"]
    assert found["behaviours_ratio"] == found["sizes"][-1]["behaviours"] / quarter["behaviours"] >= 1


def test_growth_follows_from_the_log(survey: Survey) -> None:
    assert growth(survey.folder, 50) == growth(survey.folder, 50)
    assert growth(survey.folder, 50)["digest"] == survey.digest


def test_behaviours_are_alike_within_a_factor_of_four() -> None:
    def of(distance: float, energy: float) -> tuple[int, int]:
        return behaviour(Result(1, 0.0, energy, distance, 60))

    assert of(2.1, 100) == of(7.9, 100) != of(8.1, 100)
    assert of(1.1, 33) == of(1.1, 127) != of(1.1, 129)
    assert of(0.0, 0.0) == of(0.003, 0.001)  # neither moves


def test_the_table_has_a_line_for_each_size(survey: Survey, tmp_path: Path) -> None:
    lines = run("survey", "growth", survey.folder).output.splitlines()
    assert lines[0].split() == ["worlds", "best", "from", "to", "behaviours", "from", "to"]
    assert [line.split()[0] for line in lines[1:-1]] == ["1", "3", "6", "12"]
    settings = SurveySettings.of([Genome.load("walker")], [Task(TASK)], 5, 1)
    empty = Survey.create(tmp_path / "empty", settings)
    result = run("survey", "growth", empty.folder)
    assert result.exit_code == 2 and "fewer than four worlds" in result.output
