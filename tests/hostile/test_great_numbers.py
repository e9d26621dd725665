"""Scores as great as numbers get: their sum is greater than any number, and their mean is not."""

from __future__ import annotations

import json
from math import fsum, inf, isfinite, nextafter
from pathlib import Path
from statistics import quantiles
from sys import float_info

from hypothesis import example, given
from hypothesis import strategies as st

from command_line import run
from nmes.objective.means import mean, mean_of_all, quartiles
from nmes.schemas.documents import write_json

TASK = {
    **{"format": "nmes-task/1", "name": "great", "description": "Have as great a score as there is."},
    **{"duration": 0.1, "seeds": [1, 2], "objective": "1.7e308", "settle": 0, "settle_limit": 2},
}


@example([float_info.max] * 3)
@example([-float_info.max] * 7)
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=20))
def test_a_mean_is_between_the_least_and_the_greatest_in_whatever_order(values: list[float]) -> None:
    found = mean(values)
    assert nextafter(min(values), -inf) <= found <= nextafter(max(values), inf)  # the sum is rounded before the mean
    assert isfinite(found)
    assert mean(values[::-1]) == mean(sorted(values)) == found
    if all(abs(value) < 1e300 for value in values):
        assert found == fsum(values) / len(values)
    assert mean_of_all([*values, None]) is None and mean_of_all(values) == found


@example([-float_info.max, float_info.max, float_info.max])
@example([float_info.max] * 3)
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=2, max_size=20))
def test_quartiles_are_in_order_between_the_least_and_the_greatest(values: list[float]) -> None:
    low, middle, high = quartiles(values)
    assert nextafter(min(values), -inf) <= low <= nextafter(middle, inf)
    assert nextafter(middle, -inf) <= high <= nextafter(max(values), inf)
    assert all(map(isfinite, (low, middle, high)))
    if all(abs(value) < 1e300 for value in values):
        assert [low, middle, high] == quantiles(values, n=4, method="inclusive")


def test_the_score_so_far_of_an_episode_is_drawn_from_one_end_of_the_numbers_to_the_other(tmp_path: Path) -> None:
    task = {**TASK, "duration": 0.3, "objective": "time < 0.15 ? -1.7e308 : 1.7e308"}
    (file := tmp_path / "ends.json").write_bytes(write_json(task))
    plot = tmp_path / "ends.svg"
    done = run("eval", "walker", "--task", file, "--seeds", "1", "--record", tmp_path / "proofs", "--plot", plot)
    assert done.exit_code == 0, done.output
    assert ">1e+300<" in plot.read_text() and ">-1e+300<" in plot.read_text()


def test_the_greatest_scores_have_a_mean_wherever_there_is_one(tmp_path: Path) -> None:
    (file := tmp_path / "great.json").write_bytes(write_json(TASK))
    proofs, board = tmp_path / "proofs", tmp_path / "board.sqlite"
    told = json.loads(run("eval", "walker", "--task", file, "--record", proofs, "--json").stdout)
    assert told[0]["score"] == 1.7e308
    assert "  1.7e+308  " in run("eval", "walker", "--task", file).output
    recordings = sorted(proofs.iterdir())
    assert run("eval", "--from-recording", *recordings).exit_code == 0
    assert run("leaderboard", "tasks", board, "--allow", file).exit_code == 0
    assert "score 1.7e+308" in run("leaderboard", "add", board, *recordings).output
    assert run("leaderboard", "verify", board).output == "1 of 1 entries hold\n"
    survey = run("survey", "walker", "--task", file, "--worlds", "4", "-o", tmp_path / "survey", "--jobs", "1")
    assert survey.exit_code == 0 and "1.7e+308" in survey.output
    assert run("survey", "show", tmp_path / "survey", "-o", tmp_path / "map").exit_code == 0
    assert run("survey", "growth", tmp_path / "survey").exit_code == 0
