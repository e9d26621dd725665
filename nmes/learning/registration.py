"""The names under which Gymnasium knows our environments: `nmes/walk-v0` and so on; importing this registers them.

Hides nothing that runs: it costs next to nothing, and loads no engine.
"""

from __future__ import annotations

import json
from pathlib import Path

import gymnasium

__all__ = ["register"]

_TASKS = Path(__file__).parents[1] / "evaluation" / "tasks"


def register() -> None:
    """Registers an environment for each task that ships, and `nmes/creature-v0` for any other; again does nothing.

    A task that cuts limbs off has none: in an environment bodies keep their parts.
    """
    paths = [path for path in sorted(_TASKS.glob("*.json")) if "injury" not in json.loads(path.read_bytes())]
    names = {path.stem: {"task": path.stem} for path in paths}
    for name, settings in {**names, "creature": {}}.items():
        if f"nmes/{name}-v0" not in gymnasium.registry:
            gymnasium.register(
                f"nmes/{name}-v0",
                entry_point="nmes.learning.environment:TaskEnv",
                vector_entry_point="nmes.learning.vector:TaskVectorEnv",
                kwargs=dict(settings),
            )


register()
