"""NMES, the Neural Morphogenetic Evolution System: deterministic worlds driven over TCP, recorded and reproduced."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nmes.client import AsyncClient, Client
    from nmes.evaluation import Episode, Evaluation, evaluate
    from nmes.genome import Genome
    from nmes.task import Task
    from nmes.world import World

__all__ = ["AsyncClient", "Client", "Episode", "Evaluation", "Genome", "Task", "World", "evaluate"]

_HOMES = {
    "AsyncClient": "nmes.client",
    "Client": "nmes.client",
    "Episode": "nmes.evaluation",
    "Evaluation": "nmes.evaluation",
    "Genome": "nmes.genome",
    "Task": "nmes.task",
    "World": "nmes.world",
    "evaluate": "nmes.evaluation",
}


def __getattr__(name: str) -> Any:
    # Loaded when first used, so that `import nmes`, and with it `nmes --help`, costs nothing.
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
