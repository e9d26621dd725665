"""`nmes eval` on tasks with roles: the scores of each, in tables, files and processes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from command_line import run
from creatures import snake
from duels import DUEL, push, roles
from nmes.evaluation import MatchTask, play

NMES = str(Path(sys.executable).parent / "nmes")
SWAPPED = {**DUEL, "name": "swapped", "interchangeable": True}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with two tasks and three creatures."""
    for task in (DUEL, SWAPPED):
        (tmp_path / f"{task['name']}.json").write_text(json.dumps(task))
    for genome in (snake(), push(), push(name="fast", description="Faster.")):
        (tmp_path / f"{genome['name']}.json").write_text(json.dumps(genome))
    return tmp_path


def timeless(output: str) -> list[dict[str, Any]]:
    return [
        {key: value for key, value in each.items() if key not in ("wall_seconds", "recordings")}
        for each in json.loads(output)
    ]


def test_each_has_its_score_and_role_however_many_processes_play(folder: Path) -> None:
    command = ("eval", folder / "snake.json", folder / "cart.json", "--task", folder / "duel.json", "--json")
    alone, two = run(*command, "--jobs", "1"), run(*command, "--jobs", "2", "--record", folder / "proofs")
    assert (alone.exit_code, two.exit_code) == (0, 0), alone.output
    red, blue = timeless(alone.stdout)
    assert timeless(two.stdout) == [red, blue]
    matches = play(DUEL, {"red": snake(), "blue": push()})
    for each, role in ((red, "red"), (blue, "blue")):
        assert each["roles"] == [role, role]
        assert [result["score"] for result in each["results"]] == [match.results[role].score for match in matches]
    recordings = [path for path in json.loads(two.stdout)[0]["recordings"]]
    assert len(recordings) == 2 and recordings == json.loads(two.stdout)[1]["recordings"]
    # In a fresh process, from nothing but the recordings.
    again = subprocess.run([NMES, "eval", "--json", "--from-recording", *recordings], capture_output=True, check=True)
    assert timeless(again.stdout.decode()) == [red, blue]
    assert run("verify", *recordings).exit_code == 0


def test_where_roles_are_interchangeable_each_is_in_each(folder: Path) -> None:
    command = ("eval", folder / "snake.json", folder / "cart.json", "--task", folder / "swapped.json", "--jobs", "1")
    snakes, carts = timeless(run(*command, "--json").stdout)
    order = [role for seed in DUEL["seeds"] for side in MatchTask(SWAPPED).sides(seed) for role in [side.index(0)]]
    assert snakes["roles"] == [("red", "blue")[place] for place in order]
    assert carts["roles"] == [("blue", "red")[place] for place in order]
    assert "blue, red" in run(*command).stdout


def test_a_creature_that_plays_itself_in_both_places_has_the_same_score_twice(folder: Path) -> None:
    command = ("eval", folder / "cart.json", folder / "cart.json", "--task", folder / "swapped.json", "--jobs", "1")
    first, second = timeless(run(*command, "--json").stdout)
    assert first["score"] == second["score"] and first["roles"] != second["roles"]


def test_who_loses_by_rule_is_told_and_the_status_says_so(folder: Path) -> None:
    (folder / "weak.json").write_text(json.dumps({**DUEL, **roles({}, {"limits": {"energy": 0.5}})}))
    result = run("eval", folder / "snake.json", folder / "cart.json", "--task", folder / "weak.json", "--jobs", "1")
    assert result.exit_code == 1
    assert "cart as blue, seed 3, tick" in result.stdout and "beyond its limit of energy" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["cart.json"], "duel has the roles red, blue: it takes 2 genomes, and 1 is named"),
        (["cart.json", "snake.json", "fast.json"], "it takes 2 genomes, and 3 are named"),
        (["cart.json", "snake.json", "--resume", "x"], "duel has roles, and --resume is for tasks of one creature"),
        (["cart.json", "snake.json", "--record", "r", "--record-best", "1"], "--record-best is for tasks of one"),
        (["cart.json", "duel.json"], "duel.json:"),
    ],
    ids=str,
)
def test_what_cannot_be_played_is_refused(arguments: list[str], said: str, folder: Path) -> None:
    places = [str(folder / each) if each.endswith(".json") else each for each in arguments]
    result = run("eval", *places, "--task", folder / "duel.json")
    assert result.exit_code in (1, 2) and said in " ".join(result.stderr.split())


def test_a_creature_that_may_not_play_is_refused_with_the_reason(folder: Path) -> None:
    (folder / "small.json").write_text(json.dumps({**DUEL, "limits": {"cubes": 4}}))
    result = run("eval", folder / "snake.json", folder / "cart.json", "--task", folder / "small.json")
    assert result.exit_code == 1 and "duel: blue: the body has 5 cubes, at most 4 are allowed" in result.stderr


def test_one_match_counts_once(folder: Path) -> None:
    (match,) = play(DUEL, {"red": snake(), "blue": push()}, seeds=[3], record=folder)
    assert match.recording is not None
    copy = folder / "copy.mcap"
    copy.write_bytes(Path(match.recording).read_bytes())
    result = run("eval", "--from-recording", match.recording, copy)
    assert result.exit_code == 2 and "of the same match: it counts once" in " ".join(result.stderr.split())


def test_the_plot_of_a_match_has_a_curve_for_each_role(folder: Path) -> None:
    (match,) = play(DUEL, {"red": snake(), "blue": push()}, seeds=[3], record=folder)
    assert match.recording is not None
    result = run("eval", "--from-recording", match.recording, "--plot", folder / "plot.svg")
    assert result.exit_code == 0
    picture = (folder / "plot.svg").read_text()
    assert ">red, " in picture and ">blue, " in picture and "score so far" in picture


def test_tasks_with_roles_are_listed_and_shown() -> None:
    listed = run("tasks").stdout
    assert "sumo" in listed and "of each role: red, blue" in listed
    shown = run("tasks", "chase").stdout
    assert "objective of hunter" in shown and "objective of prey" in shown
    assert {task["name"] for task in json.loads(run("tasks", "--json").stdout)} >= {"walk", "sumo"}
