"""Candidates of runs in live worlds like those of their tasks, over the lab's API."""

from __future__ import annotations

import shlex
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from labs import RunningLab, running_lab
from nmes.evaluation import evaluate
from nmes.genome import Genome
from processes import NMES

TASKS = {"rough": "walker", "swim": "walker", "pole": "walker", "reach": "seeker"}
SEED = 2


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningLab]:
    """A lab with a run of one candidate a task."""
    folder = tmp_path_factory.mktemp("lab")
    (folder / "runs").mkdir()
    for task, genome in TASKS.items():
        options = ["--task", task, "--budget", "1", "--seeds", str(SEED), "--jobs", "1", "-q"]
        subprocess.run([NMES, "evolve", genome, *options, "-o", str(folder / "runs" / task)], check=True)
    with running_lab(folder) as running:
        yield running


def first_scene(lab: RunningLab, path: str, *asked: dict[str, int]) -> Any:
    """Returns the first scene that a WebSocket of the lab tells."""
    with lab.socket(path) as watcher:
        watcher.say(*asked)
        while (message := watcher.hear())["type"] != "scene":
            pass
        return message


def staged(lab: RunningLab, task: str, world: str, **asked: int) -> Any:
    """Puts the best of a run into a world of its task, and returns what the lab said of it."""
    told = lab.good(f"/api/runs/{task}/candidates/best/world", {"world": world, **asked})
    with lab.world(world=world) as joined:
        for command in told["commands"]:
            assert joined.ask(command)["type"] != "error"
    return told


@pytest.mark.parametrize("task", TASKS)
def test_the_world_of_a_champion_is_that_of_an_episode(lab: RunningLab, task: str) -> None:
    proofs = lab.folder / "recordings"
    (recording,) = evaluate(Genome.load(TASKS[task]), task, seeds=[SEED], record=proofs).recordings
    episode = first_scene(lab, f"/ws/recording?name={Path(recording).stem}", {"frame": 60})
    told = staged(lab, task, f"like-{task}")
    assert (told["world"], told["task"], told["seed"]) == (f"like-{task}", task, SEED)
    live = first_scene(lab, f"/ws/poses?world=like-{task}")
    assert live["scenery"] == episode["scenery"]
    for what in ("cubes", "joints"):
        names = [[each["name"] for each in scene[what]] for scene in (live, episode)]
        assert names[0] == names[1], what
    targets = [[each["target"] for each in scene["creatures"]] for scene in (live, episode)]
    assert targets[0] == targets[1]
    assert live["tick_rate"] == episode["tick_rate"]


def test_another_seed_is_another_landscape_and_the_task_says_which_medium(lab: RunningLab) -> None:
    for world, seed in (("one", 1), ("two", 2)):
        staged(lab, "rough", world, seed=seed)
    one, two = (first_scene(lab, f"/ws/poses?world={world}")["scenery"]["landscape"] for world in ("one", "two"))
    assert one["heights"] != two["heights"] and one["size"] == two["size"] == [60, 60]
    staged(lab, "swim", "deep")
    assert first_scene(lab, "/ws/poses?world=deep")["scenery"]["medium"] == {"density": 1000, "level": None}


def test_the_command_that_is_shown_plays_the_same_creature(lab: RunningLab, tmp_path: Path) -> None:
    told = lab.good("/api/runs/pole/candidates/0/world", {"world": "shown", "seed": 3})
    best, play = (shlex.split(line) for line in told["command"].split(" && "))
    subprocess.run([NMES, *best[1:]], check=True, capture_output=True)
    assert play[:2] == ["nmes", "play"] and play[3:] == ["--task", "pole", "--seed", "3"]
    assert Genome.load(play[2]).hash == Genome.load("walker").hash


def test_what_cannot_be_staged_is_refused(lab: RunningLab) -> None:
    lab.good("/api/runs/rough/candidates/0/world", {"world": "there"})
    for path, asked, status, code in (
        ("rough/candidates/0", {"world": "there"}, 409, "world_exists"),
        ("rough/candidates/0", {"world": "a b"}, 409, "invalid"),
        ("rough/candidates/0", {"world": 3}, 422, "invalid"),
        ("rough/candidates/0", {}, 422, "invalid"),
        ("rough/candidates/0", {"world": "x", "seed": -1}, 422, "invalid"),
        ("rough/candidates/0", {"world": "x", "seed": True}, 422, "invalid"),
        ("rough/candidates/9", {"world": "x"}, 404, "not_found"),
        ("rough/candidates/-1", {"world": "x"}, 404, "not_found"),
        ("none/candidates/0", {"world": "x"}, 404, "not_found"),
    ):
        got, answer = lab.ask(f"/api/runs/{path}/world", asked)
        assert (got, answer["error"]["code"]) == (status, code), (path, asked)
