"""Recordings of episodes that are driven from outside, with whatever controls."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from nmes.backend import Array
from nmes.evaluation import Episode, Result, Task
from nmes.evaluation.episode import METADATA
from nmes.genome import Genome
from nmes.recording import Recorder
from nmes.world import World

__all__ = ["record_driven"]


class Player:
    """In the place of a brain: does what is written."""

    open_loop = False

    def __init__(self, actions: Iterator[Array]) -> None:
        self._actions = actions

    def reset(self, seed: int, dt: float) -> None:
        """Has nothing to forget."""

    def step(self, inputs: Array) -> Array:
        return next(self._actions)


def record_driven(path: Path, genome: Genome, task: Task, seed: int, actions: Iterator[Array] | None) -> Result:
    """Records an episode of a creature that does what it is told, or that nobody drives; as `nmes eval` records."""
    world = World(task.world_config(seed))
    about = {"task": json.dumps(task.document), "genome": genome.hash, "seed": str(seed)}
    recorder = world.journal = Recorder(path, world, pose_rate=0.0, about={METADATA: about})
    player = None if actions is None else Player(actions)
    try:
        return Episode(world, genome, player, task, seed).run()  # type: ignore[arg-type]
    finally:
        world.close()
        recorder.close()
