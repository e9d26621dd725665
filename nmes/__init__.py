"""NMES, the Neural Morphogenetic Evolution System: deterministic worlds driven over TCP, recorded and reproduced."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nmes.backend import load_backend
    from nmes.client import AsyncClient, Client
    from nmes.evaluation import Episode, Evaluation, Task, evaluate
    from nmes.genome import Genome
    from nmes.playback import replay
    from nmes.recording import Recorder, Recording
    from nmes.world import World

    __version__: str

__all__ = [
    "AsyncClient",
    "Client",
    "Episode",
    "Evaluation",
    "Genome",
    "Recorder",
    "Recording",
    "Task",
    "World",
    "evaluate",
    "load_backend",
    "replay",
]

_HOMES = {
    "AsyncClient": "nmes.client",
    "Client": "nmes.client",
    "Episode": "nmes.evaluation",
    "Evaluation": "nmes.evaluation",
    "Genome": "nmes.genome",
    "Recorder": "nmes.recording",
    "Recording": "nmes.recording",
    "Task": "nmes.evaluation",
    "World": "nmes.world",
    "evaluate": "nmes.evaluation",
    "load_backend": "nmes.backend",
    "replay": "nmes.playback",
}


def __getattr__(name: str) -> Any:
    # Loaded when first used, so that `import nmes`, and with it `nmes --help`, costs nothing.
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version("nmes")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__", *(name for name in globals() if name.startswith("__"))])
