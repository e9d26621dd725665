"""How long recordings are kept: the oldest ones that nobody holds on to are removed.

It hides how a folder is gone through. Invariants: nothing but recordings (`*.mcap`, files of the folder itself) is
removed; none that is being written, none that is held by a file beside it that is named after it (a signature,
`NAME.mcap.keep`); always the oldest first, by when they were last written, then by name.
"""

from __future__ import annotations

import asyncio
import logging
import os
import stat
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from time import time
from typing import NamedTuple

from nmes.recording.mcap_format import MAGIC

__all__ = ["Retention"]

logger = logging.getLogger(__name__)

DAY = 86_400.0  # s
# A recording that was not closed may be one that another host writes, until it was not written to for so long.
UNFINISHED = DAY


class _File(NamedTuple):
    """A recording of the folder; sorted, the oldest is first."""

    written: float
    name: str
    size: int


class Retention:
    """The rules of one folder."""

    def __init__(self, folder: Path, days: float | None, size: int | None) -> None:
        """Makes rules; nothing is removed yet.

        Args:
            folder: Where the recordings lie.
            days: How long they are kept after they were last written; None: for ever.
            size: How many bytes all of them may take; None: any number.
        """
        self._folder = folder
        self._days = days
        self._size = size
        self._over = False  # the log was told that all that is left is held

    async def tidy(self, writing: Iterable[Path | None]) -> None:
        """Sweeps in a thread, by the time that it is; if the folder cannot be gone through, the log tells.

        Args:
            writing: The recordings that are being written; None of a world that has none.
        """
        try:
            await asyncio.to_thread(self.sweep, time(), {path for path in writing if path is not None})
        except OSError as error:
            logger.warning("the folder of recordings cannot be gone through: %s", error)

    def sweep(self, now: float, writing: Collection[Path]) -> list[Path]:
        """Removes what is too old, or too much; returns what was removed, in that order, and logs it.

        May be called in any thread.

        Args:
            now: The time by the clock of the file system, s.
            writing: The recordings that are being written.
        """
        files, held = self._look()
        folder, parents = self._folder.resolve(), {path.parent for path in writing}
        here = {parent for parent in parents if parent.resolve() == folder}  # whoever writes may call it otherwise
        spared = {path.name for path in writing if path.parent in here}
        total, freed = sum(file.size for file in files), 0
        removed: list[Path] = []
        for file in files:
            old = self._days is not None and now - file.written > self._days * DAY
            if not (old or self._exceeds(total - freed)):
                continue
            path = self._folder / file.name
            if file.name in spared or file.name in held or not _finished(path, file, now):
                continue
            try:
                path.unlink()
            except OSError as error:
                logger.warning("cannot remove the recording %s: %s", path, error.strerror)
                continue
            removed.append(path)
            freed += file.size
        if removed:
            names = ", ".join(path.name for path in removed)
            logger.info("removed %.1f MB of recordings, the oldest first: %s", freed / 1e6, names)
        self._tell_excess(total - freed)
        return removed

    def _look(self) -> tuple[list[_File], set[str]]:
        """Returns the recordings, the oldest first, and the names of those that are held."""
        files, held = [], set()
        for entry in self._entries():
            recording, mark, _ = entry.name.partition(".mcap.")
            if mark:
                held.add(f"{recording}.mcap")
            elif entry.name.endswith(".mcap"):
                status = entry.stat(follow_symlinks=False)
                if stat.S_ISREG(status.st_mode):
                    files.append(_File(status.st_mtime, entry.name, status.st_size))
        return sorted(files), held

    def _entries(self) -> Iterator[os.DirEntry[str]]:
        try:
            with os.scandir(self._folder) as entries:
                yield from entries
        except FileNotFoundError:  # nothing was recorded yet
            return

    def _exceeds(self, total: int) -> bool:
        return self._size is not None and total > self._size

    def _tell_excess(self, total: int) -> None:
        """Logs, once, that recordings take more than they may, and all that is left is held."""
        over = self._exceeds(total)
        if over and not self._over:
            logger.warning(
                "the recordings in %s take %.1f MB, more than the %.1f MB of --keep: "
                "those left are being written, or held by a file beside them",
                self._folder,
                total / 1e6,
                (self._size or 0) / 1e6,
            )
        self._over = over


def _finished(path: Path, file: _File, now: float) -> bool:
    """Whether a recording was closed, or was not written to for so long that nobody writes it any more."""
    if now - file.written > UNFINISHED:
        return True
    with path.open("rb") as stream:
        stream.seek(max(0, file.size - len(MAGIC)))
        return file.size > 2 * len(MAGIC) and stream.read() == MAGIC
