"""Learning: environments by the doors that learners know, learners of our own, and datasets; `docs/learning.md`."""

from __future__ import annotations

import importlib
import sys
from typing import TYPE_CHECKING, Any

from nmes.errors import MissingPackage

if TYPE_CHECKING:
    from nmes.learning.determinism import check_determinism
    from nmes.learning.dm import dm_environment
    from nmes.learning.environment import CreatureEnv, TaskEnv
    from nmes.learning.episodes import RecordedEpisode, read_episode, read_episodes
    from nmes.learning.learners.cloning import Cloning
    from nmes.learning.learners.novelty import ForwardModel
    from nmes.learning.learners.pca import principal_components
    from nmes.learning.learners.ppo import Ppo
    from nmes.learning.learners.q_learning import QLearning
    from nmes.learning.learners.reinforce import Reinforce
    from nmes.learning.registration import register
    from nmes.learning.remote import RemoteEnvironments
    from nmes.learning.remote_env import Remote, RemoteVector
    from nmes.learning.run import LearningRun
    from nmes.learning.settings import LearningSettings
    from nmes.learning.several import CreaturesEnv, parallel_env
    from nmes.learning.vector import CreatureVectorEnv, TaskVectorEnv

__all__ = [
    "Cloning",
    "CreatureEnv",
    "CreatureVectorEnv",
    "CreaturesEnv",
    "ForwardModel",
    "LearningRun",
    "LearningSettings",
    "Ppo",
    "QLearning",
    "RecordedEpisode",
    "Reinforce",
    "Remote",
    "RemoteEnvironments",
    "RemoteVector",
    "TaskEnv",
    "TaskVectorEnv",
    "check_determinism",
    "dm_environment",
    "parallel_env",
    "principal_components",
    "read_episode",
    "read_episodes",
    "register",
]

_HOMES = {
    "Cloning": "nmes.learning.learners.cloning",
    "CreatureEnv": "nmes.learning.environment",
    "CreatureVectorEnv": "nmes.learning.vector",
    "CreaturesEnv": "nmes.learning.several",
    "ForwardModel": "nmes.learning.learners.novelty",
    "LearningRun": "nmes.learning.run",
    "LearningSettings": "nmes.learning.settings",
    "Ppo": "nmes.learning.learners.ppo",
    "QLearning": "nmes.learning.learners.q_learning",
    "RecordedEpisode": "nmes.learning.episodes",
    "Reinforce": "nmes.learning.learners.reinforce",
    "Remote": "nmes.learning.remote_env",
    "RemoteEnvironments": "nmes.learning.remote",
    "RemoteVector": "nmes.learning.remote_env",
    "TaskEnv": "nmes.learning.environment",
    "TaskVectorEnv": "nmes.learning.vector",
    "check_determinism": "nmes.learning.determinism",
    "dm_environment": "nmes.learning.dm",
    "parallel_env": "nmes.learning.several",
    "principal_components": "nmes.learning.learners.pca",
    "read_episode": "nmes.learning.episodes",
    "read_episodes": "nmes.learning.episodes",
    "register": "nmes.learning.registration",
}

# Packages of others, and the extra that brings them.
_EXTRAS = {"dm_env": "gym", "gymnasium": "gym", "pettingzoo": "gym"}


def __getattr__(name: str) -> Any:
    # Loaded when first used: learners in numpy need none of the packages that environments do.
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        return getattr(importlib.import_module(_HOMES[name]), name)
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package not in _EXTRAS:
            raise
        raise MissingPackage(f"{name} needs {package}: pip install 'nmes[{_EXTRAS[package]}]'") from error


def __dir__() -> list[str]:
    return sorted([*__all__, *(name for name in globals() if name.startswith("__"))])


# Who imports both gets the environments by their names; nobody else pays for it.
if sys.modules.get("gymnasium") is not None:
    importlib.import_module("nmes.learning.registration")
