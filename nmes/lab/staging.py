"""A candidate of a run in a live world like that of its task: its ground, obstacles, medium, gravity and props.

Hides what a task and a seed make of a world. The world runs by the clock, and its creature by its own brain from the
moment it is set down; an episode waits until it is at rest, and ends when the task says so.
"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from nmes.backend.rotation import multiply, quaternion_from_euler
from nmes.evaluation.identity import shipped_hash
from nmes.evaluation.task import CREATURE, Task
from nmes.evolution.run import Run
from nmes.genome import Genome
from nmes.lab.folder import Folder, LabError
from nmes.lab.runs import candidate_index, is_learning
from nmes.learning.run import LearningRun
from nmes.schemas.documents import JsonObject

__all__ = ["Staging", "stage"]

_SEEDS: Final = 1 << 63


class Staging(NamedTuple):
    """A scene that is to be played.

    Attributes:
        config: Of its world.
        creature: What it is called there.
        commands: What sets it, in order, as messages.
        task: The name of the task.
        seed: What the task draws by.
        command: The command line that shows the same creature in an episode of the task.
    """

    config: JsonObject
    creature: str
    commands: list[JsonObject]
    task: str
    seed: int
    command: str


def stage(folder: Folder, name: str, number: str, world: object, seed: object) -> Staging:
    """Returns the world, the messages and the command by which a candidate of a run is put into a world of its task.

    Args:
        folder: The lab's.
        name: The run's.
        number: The candidate's index, or `best`.
        world: What the world is to be called.
        seed: What the task draws by; None: the first of the run's seeds.

    Raises:
        LabError: There is no such candidate, it played against others, or these are no world and no seed.
        RunError: The run is damaged.
    """
    if not isinstance(world, str) or not (seed is None or (type(seed) is int and 0 <= seed < _SEEDS)):
        raise LabError("invalid", "a scene has the name of its world, and may have a seed from 0 on", "world")
    path = folder.find("runs", name)
    if is_learning(path):
        learned = LearningRun.open(path)
        candidate_index(folder, name, number)
        task, genome, seeds = learned.settings.task, Genome.load(path / "genome.json"), learned.settings.task.seeds
        lines, played = [], path
    else:
        run = Run.open(path)
        if not isinstance(run.settings.task, Task):
            raise LabError(
                "invalid", f"{name!r} is a run of matches: its candidates are measured by each other", "name"
            )
        index = candidate_index(folder, name, number)
        task, genome, seeds = run.settings.task, run.genome(index), run.settings.seeds
        lines, played = [["nmes", "evolve", "best", str(path), "--index", str(index)]], path / f"best-{index}"
    drawn = seeds[0] if seed is None else seed
    means = task.name if task.hash == shipped_hash(task.name) else str(_file(folder, task, played))
    lines.append(["nmes", "play", str(played / "genome.json"), "--task", means, "--seed", str(drawn)])
    config = {**task.world_config(drawn), "name": world, "mode": "realtime"}
    command = " && ".join(map(shlex.join, lines))
    return Staging(config, CREATURE, _commands(task, drawn, genome), task.name, drawn, command)


def _file(folder: Folder, task: Task, played: Path) -> Path:
    """Returns where a task lies that does not ship: in the lab's folder, or beside what `nmes evolve best` writes."""
    own = folder.place("tasks", task.name) if task.name in folder.scan("tasks") else None
    return played / "task.json" if own is None or Task.load(own).hash != task.hash else own


def _commands(task: Task, seed: int, genome: Genome) -> list[JsonObject]:
    """Returns the messages that set the scene: the creature as it is dropped, and the props as if it stood so."""
    spawn, *turns = task.entry(seed, genome.document, genome.body)
    if "brain" in genome.document and genome.document["brain"]["kind"] != "onnx":  # which no world runs by itself
        spawn["autonomous"] = True
    root = genome.body.born.cubes[0]
    position = [one + other for one, other in zip(spawn["position"], root.position, strict=True)]
    turn = multiply(
        quaternion_from_euler(0.0, task.draw(seed, "yaw", task.document["vary"]["yaw"]), 0.0), root.quaternion
    )
    state = np.array([*position, *turn, *[0.0] * 6])
    return [spawn, *turns, *task.props(seed, genome.body, state)]
