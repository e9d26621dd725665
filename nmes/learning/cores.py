"""What environments stand on: rows of one creature on one task, here or on another machine.

Hides where recordings go.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from hashlib import blake2b
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from nmes.backend import Array
from nmes.errors import RecordingError
from nmes.evaluation import Result, Task
from nmes.genome import Genome
from nmes.objective.trajectory import Flags

__all__ = ["Core", "Records", "closed_on_failure", "folder_of", "told"]


class Core(Protocol):
    """Rows of one creature on one task; `nmes.evaluation.Environments` says what each of these is."""

    genome: Genome
    task: Task
    sensors: tuple[str, ...]
    motors: tuple[str, ...]
    observations: Array
    last_observations: Array
    rewards: Array
    terminated: Flags
    truncated: Flags
    results: list[Result | None]

    @property
    def seeds(self) -> list[int]:
        """Of each row, the seed of its scene."""

    def reset(self, seed: int | Sequence[int | None] | None = None, rows: Flags | None = None) -> Array:
        """Begins an episode in every row, or in some."""

    def step(self, actions: Array) -> tuple[Array, Array, Flags, Flags]:
        """Goes one tick on in every row."""

    def record(self, row: int, path: str | os.PathLike[str]) -> None:
        """Records the episode that a row's last step belonged to."""

    def close(self) -> None:
        """Ends all episodes."""


@contextmanager
def closed_on_failure(core: Core) -> Iterator[None]:
    """Closes a core where what is made of it fails: one of worlds elsewhere has stopped their clocks."""
    try:
        yield
    except BaseException:
        core.close()
        raise


def told(result: Result) -> dict[str, Any]:
    """Returns how an episode came out as what `info` says of it: the fields of a `Result`."""
    return result.to_json()


def folder_of(path: str | os.PathLike[str]) -> Path:
    """Returns a folder for recordings, which is made where there is none.

    Raises:
        RecordingError: It cannot be made.
    """
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordingError("recording_failed", f"cannot make the folder {folder}: {error.strerror}") from error
    return folder


class Records:
    """A folder in which each episode of an environment is recorded; the same episode has the same file.

    Args:
        folder: It is made where there is none.
        rows: The number of rows.

    Raises:
        RecordingError: It cannot be made.
    """

    def __init__(self, folder: str | os.PathLike[str], rows: int) -> None:
        self._folder = folder_of(folder)
        self._done = [blake2b(digest_size=8) for _ in range(rows)]  # of the actions of each row's episode

    def begin(self, row: int) -> None:
        """Tells that an episode begins in a row."""
        self._done[row] = blake2b(digest_size=8)

    def note(self, row: int, action: Array) -> None:
        """Tells what is done in a row."""
        self._done[row].update(np.ascontiguousarray(action, np.float64).tobytes())

    def keep(self, core: Core, row: int) -> str:
        """Records the episode that has just ended in a row; returns the file.

        Raises:
            RecordingError: It cannot be written.
        """
        result = core.results[row]
        assert result is not None
        names = (
            core.genome.hash[:16],
            core.task.name,
            core.task.hash[:16],
            str(result.seed),
            self._done[row].hexdigest(),
        )
        path = self._folder / f"{'-'.join(names)}.mcap"
        core.record(row, path)
        self.begin(row)
        return str(path)
