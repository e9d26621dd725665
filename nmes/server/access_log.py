"""The access log of a host: who came from where and when, to which world, how it went, and how it ended.

It hides the file. Each line is a JSON object, appended by opening the file by its name: whoever rotates it renames it,
and the next line begins a new one; no signal is needed.

Invariants: no password, right or wrong, and nothing else that a client said is ever in it; those who were never let in
make it grow by no more than `STRANGERS` lines, and the next line says how many were left out.
"""

from __future__ import annotations

import errno
import logging
from datetime import UTC, datetime
from pathlib import Path
from time import monotonic
from typing import Final

import orjson

from nmes.server.door import Bucket

__all__ = ["AccessLog", "Visit"]

logger = logging.getLogger(__name__)

_BEGIN: Final = b'{"time":"'  # of every line
STRANGERS = (100, 1.0)  # lines at once about connections that were never let in, and so many a second


class AccessLog:
    """A file to which lines are appended."""

    def __init__(self, path: Path) -> None:
        """Makes the file if need be.

        Raises:
            OSError: It cannot be written, or is a file of something else.
        """
        if path.is_file():
            with path.open("rb") as file:
                begin = file.read(len(_BEGIN))
            if begin not in (b"", _BEGIN):
                what = "it is no access log, and stays as it is: name another file"
                raise FileExistsError(errno.EEXIST, what, str(path))
        self._path = path
        self._strangers = Bucket(*STRANGERS)
        self._left_out = 0
        self._append(b"")

    def write(self, event: str, stranger: bool, **fields: str | int | float | None) -> None:
        """Appends a line, unless it is of a stranger and there were too many of late."""
        now = monotonic()
        if stranger and self._strangers.tokens(now) < 1.0:
            self._left_out += 1
            return
        if stranger:
            self._strangers.take(now)
        line = {"time": datetime.now(UTC).isoformat(timespec="milliseconds"), "event": event, **fields}
        if self._left_out:
            line["left_out"], self._left_out = self._left_out, 0
        try:
            self._append(orjson.dumps(line, option=orjson.OPT_APPEND_NEWLINE))
        except OSError as error:
            logger.error("the access log cannot be written: %s: %s", self._path, error.strerror)

    def _append(self, data: bytes) -> None:
        with self._path.open("ab") as file:
            file.write(data)


class Visit:
    """One connection, for the access log, which has a line when it enters a world and one when it ends.

    Attributes:
        commands: How many commands of it were executed.
    """

    def __init__(self, log: AccessLog | None, peer: str) -> None:
        """Begins now; without a log nothing is written."""
        self.commands = 0
        self._log = log
        self._peer = peer
        self._began = monotonic()
        self._world: str | None = None
        self._client: int | None = None
        self._reason: str | None = None

    def enter(self, world: str, client: int, dialect: str | None) -> None:
        """Tells that it was let in, as that client of a world."""
        self._world, self._client = world, client
        if self._log is not None:
            self._log.write("entered", False, **{"from": self._peer}, world=world, client=client, dialect=dialect)

    def ends(self, reason: str) -> None:
        """Notes why it is about to end; the first reason counts."""
        self._reason = self._reason or reason

    def end(self) -> None:
        """Tells that it has ended, and how."""
        if self._log is None:
            return
        inside, seconds = self._world is not None, round(monotonic() - self._began, 3)
        fields = {"world": self._world, "client": self._client, "commands": self.commands} if inside else {}
        event = "left" if inside else "listed" if self._reason == "listed" else "refused"
        self._log.write(
            event, event == "refused", **{"from": self._peer}, **fields, seconds=seconds, reason=self._reason
        )
