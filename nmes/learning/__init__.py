"""Learning: environments by the doors that learners know, learners of our own, and datasets; `docs/learning.md`."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nmes.learning.episodes import RecordedEpisode, read_episode, read_episodes

__all__ = ["RecordedEpisode", "read_episode", "read_episodes"]

_HOMES = {
    "RecordedEpisode": "nmes.learning.episodes",
    "read_episode": "nmes.learning.episodes",
    "read_episodes": "nmes.learning.episodes",
}


def __getattr__(name: str) -> Any:
    # Loaded when first used: learners in numpy need none of the packages that environments do.
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, *(name for name in globals() if name.startswith("__"))])
