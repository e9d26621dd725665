"""Short runs of learning: episodes of a fifth of a second."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from nmes.learning.run import LearningRun
from nmes.learning.settings import LearningSettings
from runs import TASK

__all__ = ["MOMENT", "OPTIONS", "SETTINGS", "begin", "finish"]

MOMENT: dict[str, Any] = {**TASK, "limits": {}, "seeds": [1, 2]}

OPTIONS = {"rows": 3, "ticks": 20, "units": 8, "epochs": 2, "batch": 30}
SETTINGS: dict[str, Any] = {
    "format": "nmes-learning/1",
    "algorithm": "ppo",
    "options": OPTIONS,
    "genome": "inchworm",
    "task": MOMENT,
    "steps": 8 * 60,
    "seed": 5,
    "every": 3,
}


def begin(folder: Path, **changes: Any) -> LearningRun:
    """Begins a run with some settings that differ from the usual ones."""
    return LearningRun.create(folder, LearningSettings.read({**SETTINGS, **changes}))


def finish(run: LearningRun, threads: int = 1) -> LearningRun:
    """Goes on with a run to its end."""
    for _ in run.advance(threads):
        pass
    return run
