"""The folder of a lab: where recordings, runs, genomes, tasks and leaderboards lie, by names that strangers may send.

Invariant: what is found under a name lies in the folder itself. A name is one part of a path, and no link is followed.
"""

from __future__ import annotations

import os
import re
import secrets
from contextlib import suppress
from pathlib import Path
from stat import S_ISDIR, S_ISREG
from typing import Final, Literal

from nmes.errors import NmesError

__all__ = ["Folder", "Kind", "LabError"]

Kind = Literal["recordings", "runs", "genomes", "tasks", "leaderboards", "settings", "films", "tables"]

_NAME: Final = re.compile(r"\w[\w.-]{0,199}")
_STATUSES: Final = {
    "not_a_name": 400,
    "not_found": 404,
    "name_taken": 409,
    "run_exists": 409,
    "busy": 409,
    "not_running": 409,
    "request_too_large": 413,
    "invalid": 422,
    "unknown_name": 422,
    "too_many_jobs": 429,
    "not_yet": 503,
    "cannot_write": 507,
}
_SUFFIXES: Final[dict[Kind, str]] = {
    "recordings": ".mcap",
    "runs": "",
    "genomes": ".json",
    "tasks": ".json",
    "leaderboards": ".sqlite",
    "settings": ".json",
    "films": ".gif",
    "tables": ".json",
}


class LabError(NmesError):
    """What a page asks for is not there, or cannot be done."""

    @property
    def status(self) -> int:
        """Of the answer, HTTP."""
        return _STATUSES[self.code]


class Folder:
    """A lab's folder.

    Args:
        path: The folder, which is made.

    Raises:
        OSError: It cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        for kind in _SUFFIXES:
            (path / kind).mkdir(parents=True, exist_ok=True)

    def place(self, kind: Kind, name: str) -> Path:
        """Returns the path of a thing that may be there or not.

        Raises:
            LabError: That is no name.
        """
        if not _NAME.fullmatch(name):
            reason = (
                "a name has letters, digits, _ . and -, begins with neither of the last two, and is no longer than 200"
            )
            raise LabError("not_a_name", reason, "name")
        return self.path / kind / f"{name}{_SUFFIXES[kind]}"

    def find(self, kind: Kind, name: str) -> Path:
        """Returns the path of a thing that is there.

        Raises:
            LabError: It is not, or it is a link, or that is no name.
        """
        path = self.place(kind, name)
        try:
            mode = path.lstat().st_mode
        except OSError:
            mode = 0
        if not (S_ISDIR(mode) if kind == "runs" else S_ISREG(mode)):
            raise LabError("not_found", f"there is nothing called {name!r} among the {kind} here", "name")
        return path

    def scan(self, kind: Kind) -> dict[str, os.stat_result]:
        """Returns the names of all that is there, each with its size and times; of a run those of its log."""
        found = {}
        suffix = _SUFFIXES[kind]
        with os.scandir(self.path / kind) as entries:
            for entry in entries:
                name = entry.name.removesuffix(suffix) if suffix else entry.name
                if not entry.name.endswith(suffix) or not _NAME.fullmatch(name):
                    continue
                try:
                    if kind == "runs":
                        status = _of_run(entry.path) if entry.is_dir(follow_symlinks=False) else None
                        if status is not None:
                            found[name] = status
                    elif entry.is_file(follow_symlinks=False):
                        found[name] = entry.stat(follow_symlinks=False)
                except OSError:  # it went while we looked
                    continue
        return found

    def names(self, kind: Kind) -> list[str]:
        """Returns the names of all that is there, sorted."""
        return sorted(self.scan(kind))

    def write(self, kind: Kind, name: str, text: bytes) -> Path:
        """Writes a file, whole or not at all.

        Raises:
            LabError: That is no name, or it cannot be written.
        """
        path = self.place(kind, name)
        part = path.with_name(f".{secrets.token_hex(8)}")
        try:
            part.write_bytes(text)
            part.replace(path)
        except OSError as error:
            part.unlink(missing_ok=True)
            raise LabError("cannot_write", f"{path} cannot be written: {error.strerror}") from error
        return path


def _of_run(path: str) -> os.stat_result | None:
    """Returns size and times of a run's log, or of its settings before it has one; None where it is no run."""
    # By plain strings: a list of 10,000 runs waits for this.
    settings = os.stat(f"{path}/run.json")
    if not S_ISREG(settings.st_mode):
        return None
    with suppress(FileNotFoundError):
        log = os.stat(f"{path}/log.jsonl")
        return log if S_ISREG(log.st_mode) else settings
    return settings
