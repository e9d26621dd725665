"""Datasets of Minari: recorded episodes in the format of offline reinforcement learning that Gymnasium's makers keep.

Hides which parts of the package `minari` write a dataset. What is written is read by `minari.load_dataset`, or as
`minari.MinariDataset(folder / "data")`, and equals what `nmes.learning.read_episodes` gives, bit for bit. The same
recordings make the same bytes.

Source: O. Younis et al., "Minari" (2024), storage format `arrow`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from nmes.errors import MissingPackage, RecordingError, visible
from nmes.learning.episodes import RecordedEpisode, read_episodes

__all__ = ["check_name", "write_minari"]

_BODY: Final = ("body", "sensors")  # what of a genome is there without its brain
_NAME: Final = re.compile(r"[A-Za-z0-9_][-A-Za-z0-9_]{0,99}-v[0-9]{1,6}")


def check_name(name: str) -> None:
    """Refuses what is no name of a dataset.

    Raises:
        RecordingError: It is none (`bad_name`).
    """
    if not _NAME.fullmatch(name):
        what = f"a dataset of Minari is called like walker-v0: letters, digits, '-', '_', and its version; not {name!r}"
        raise RecordingError("bad_name", visible(what))


def write_minari(
    recordings: Iterable[str | os.PathLike[str]], folder: str | os.PathLike[str], name: str
) -> tuple[int, int]:
    """Writes recordings of episodes as a dataset.

    Args:
        recordings: The files, of creatures with the same sensors and motors; each becomes an episode, in their order.
        folder: Where the dataset will be, empty. So that `minari.load_dataset(name)` finds it, it must have that name
            and be in the folder that `MINARI_DATASETS_PATH` names.
        name: The dataset's.

    Returns:
        How many episodes and how many ticks there are.

    Raises:
        MissingPackage: Minari is not installed, or pyarrow.
        RecordingError, ProofError, DocumentError: As by `nmes.learning.read_episodes`; or `name` is none
            (`bad_name`), or there are no recordings (`nothing_to_export`).
    """
    try:
        import minari.dataset._storages.arrow_storage  # noqa: F401 (that pyarrow is there too)
        from gymnasium.envs.registration import EnvSpec
        from gymnasium.spaces import Box
        from minari import __version__
        from minari.dataset.minari_storage import MinariStorage

        from nmes.learning import spaces
    except ImportError as error:
        raise MissingPackage("datasets of Minari need minari and pyarrow: pip install 'nmes[gym]'") from error
    check_name(name)
    episodes = _Episodes(read_episodes(recordings))
    # Observations are the environment's; actions too, but in the 64 bits in which a recording has them.
    observations, _ = spaces.of(episodes.first.genome)
    actions = Box(-1.0, 1.0, (len(episodes.first.motors),), np.float64)
    data = Path(folder, "data")
    data.mkdir(parents=True)
    storage = MinariStorage.new(data, observations, actions, data_format="arrow")
    storage.update_metadata({"dataset_id": name, "minari_version": __version__})
    storage.update_episodes(episodes)
    storage.update_episode_metadata(episodes.about)
    storage.update_metadata(episodes.summary())
    if episodes.environment is not None:
        entry = "nmes.learning.environment:TaskEnv"
        storage.update_metadata({"env_spec": EnvSpec("nmes/creature-v0", entry, kwargs=episodes.environment).to_json()})
    return len(episodes.about), storage.total_steps


class _Episodes:
    """Episodes on their way into a dataset, one at a time, and what the dataset says of them.

    Attributes:
        first: The first of them.
        about: Of each that has gone by, what is told of it beside its arrays.
    """

    def __init__(self, episodes: Iterator[RecordedEpisode]) -> None:
        first = next(episodes, None)
        if first is None:
            raise RecordingError("nothing_to_export", "there are no recordings")
        self.first, self._others = first, episodes
        self.about: list[dict[str, Any]] = []
        self._tasks: dict[str, Any] = {}
        self._genomes: dict[str, Any] = {}
        self._authors: set[str] = set()

    def __iter__(self) -> Iterator[Any]:
        yield self._buffer(self.first)
        for episode in self._others:
            yield self._buffer(episode)

    def _buffer(self, episode: RecordedEpisode) -> Any:
        from minari.data_collector import EpisodeBuffer

        genome, task, result = episode.genome, episode.task, episode.result
        told = {"score": result.score, "ended": result.ended, "fault": result.fault}
        of = {"task": task.hash, "genome": genome.hash, "recording": Path(episode.path).name}
        self.about.append(told | of)
        self._tasks[task.hash], self._genomes[genome.hash] = task.document, genome.document
        self._authors |= {genome.document["author"]} if genome.document.get("author") else set()
        return EpisodeBuffer(
            id=len(self.about) - 1,
            seed=result.seed,
            observations=episode.observations,
            actions=episode.actions,
            rewards=episode.rewards,
            terminations=episode.terminated,
            truncations=episode.truncated,
        )

    @property
    def environment(self) -> dict[str, Any] | None:
        """Of what the environment of all episodes is made: a task, and a creature; None where there are several."""
        task, genome = self.first.task, self.first.genome
        bodies = [{key: value for key, value in each.items() if key in _BODY} for each in self._genomes.values()]
        if len(self._tasks) > 1 or any(body != bodies[0] for body in bodies):
            return None
        return {"task": task.document, "genome": genome.document}

    def summary(self) -> dict[str, Any]:
        """Returns the metadata of the dataset as a whole."""
        first = self.first
        names = " and ".join(sorted({task["name"] for task in self._tasks.values()}))
        told: dict[str, Any] = {
            "description": f"Creatures of NMES on {names}, from recordings that were run again, every digest compared",
            "nmes": {
                "sensors": first.sensors,
                "motors": first.motors,
                "tick_rate": first.task.tick_rate,
                "tasks": self._tasks,
                "genomes": self._genomes,
            },
        }
        return told | ({"author": {", ".join(sorted(self._authors))}} if self._authors else {})
