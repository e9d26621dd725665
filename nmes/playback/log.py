"""Logs: an experiment as lines of JSON, read line by line.

Two kinds of lines are understood. `nmes export --to jsonl` writes rows, each with its `kind`; they hold a whole
history. The other kind is bare messages, a line each: commands, and the replies where somebody kept them. Such a log is
what the paper on NMES calls a complete history, replayed "by sending the same commands to a fresh server".
`nmes.playback.log_replay` runs both.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jsonschema_rs
import orjson

from nmes import protocol
from nmes.errors import NmesError, RecordingError
from nmes.recording import Kind
from nmes.schemas import load

__all__ = ["BEGINNING", "Line", "Log"]

BEGINNING = "recording"  # the kind of a row that says how the world began, with the recording's metadata
_DEFAULT = {"mode": "lockstep"}  # the config of a world that the log does not describe
_AT_ONCE = 256  # lines
_LONGEST = 256 << 20  # bytes of a line
_SHAPES: dict[Any, jsonschema_rs.Draft202012Validator] = {
    Kind.JOINED: jsonschema_rs.Draft202012Validator(load("recording/clients.json")),
    Kind.TICKS: jsonschema_rs.Draft202012Validator(load("recording/ticks.json")),
    Kind.FAULT: jsonschema_rs.Draft202012Validator(load("recording/faults.json")),
    Kind.HIBERNATED: jsonschema_rs.Draft202012Validator(load("recording/hibernation.json")),
    Kind.REPLY: jsonschema_rs.Draft202012Validator({"type": "object"}),
    Kind.KEYFRAME: jsonschema_rs.Draft202012Validator(
        {"type": "object", "required": ["snapshot"], "properties": {"snapshot": {"type": "string"}}}
    ),
    BEGINNING: jsonschema_rs.Draft202012Validator({"type": "object"}),
}


class Line(NamedTuple):
    """A line of a log.

    Attributes:
        number: Its number in the file, from 1.
        kind: Of a row its `kind`; of a message `command`, `reply`, or the type of an event.
        client: The number of the client that it is about; 1 where the line names none.
        message: The message, or the content of the row, as JSON.
    """

    number: int
    kind: str
    client: int
    message: Any


class Log:
    """A log to run again.

    Attributes:
        path: The file.
        size: The size of the file in bytes.
        config: The config of its world: as the log states it, or that of a new world in lockstep.
        fingerprint: The versions, binaries and processor that its numbers depended on, if it states them.

    Raises:
        RecordingError: It cannot be read, or what it states of its beginning is wrong.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        try:
            self.size = self.path.stat().st_size
        except OSError as error:
            raise RecordingError("recording_unreadable", f"cannot read {path}: {error.strerror}") from error
        self.config: dict[str, Any] = dict(_DEFAULT)
        self.fingerprint: dict[str, str] | None = None
        first = next((line for _, lines in self.chunks(at_once=1) for line in lines), None)
        if first is not None and first.kind == BEGINNING:
            self._begin(first)

    def _begin(self, line: Line) -> None:
        try:
            protocol.validate_metadata(line.message)
            self.config = protocol.complete_config(orjson.loads(line.message["nmes.world"]["config"]))
        except (NmesError, ValueError) as error:
            raise self.wrong(line.number, f"does not say how its world began: {error}") from None
        self.fingerprint = line.message["nmes.fingerprint"]

    def wrong(self, number: int, what: str) -> RecordingError:
        """Makes the error for a line that cannot be read or run; `what` is wrong with it."""
        return RecordingError("not_a_recording", f"{self.path}: line {number} {what}")

    def chunks(self, at_once: int = _AT_ONCE) -> Iterator[tuple[int, list[Line]]]:
        """Yields the lines but for blank ones, some at a time, with how many bytes of the file that reaches.

        Raises:
            RecordingError: The file or a line of it cannot be read.
        """
        reached = 0
        lines: list[Line] = []
        try:
            with self.path.open("rb") as file:
                for number, text in enumerate(iter(lambda: file.readline(_LONGEST), b""), 1):
                    reached += len(text)
                    if text.strip():
                        try:
                            lines.append(self._line(number, text))
                        except RecordingError:
                            yield reached, lines  # the lines before a wrong one can be run
                            raise
                    if number % at_once == 0:
                        yield reached, lines
                        lines = []
        except OSError as error:
            raise RecordingError("recording_unreadable", f"cannot read {self.path}: {error.strerror}") from error
        yield reached, lines

    def _line(self, number: int, text: bytes) -> Line:
        try:
            row = orjson.loads(text)
            orjson.dumps(row)  # it writes no such depth as it reads
        except (ValueError, TypeError) as error:
            raise self.wrong(number, f"is not JSON: {error}") from None
        if not isinstance(row, dict):
            raise self.wrong(number, "is no JSON object")
        if "kind" in row and "message" in row:
            client, kind = row.get("client"), row["kind"]
            if not isinstance(kind, str):
                raise self.wrong(number, "has a kind that is no text")
            shape = _SHAPES.get(kind)
            if shape is not None and not shape.is_valid(row["message"]):
                raise self.wrong(number, f"does not have the shape of {kind}")
            if client is not None and (not isinstance(client, int) or client < 1):
                raise self.wrong(number, f"has no number of a client: {client!r}")
            return Line(number, kind, client or 1, row["message"])
        kind = row.get("type")
        if not isinstance(kind, str):
            raise self.wrong(number, "is neither a message, which has a type, nor a row, which has a kind")
        if kind in ("auth", "auth_success") or kind in protocol.EVENTS:
            return Line(number, kind, 1, row)
        return Line(number, Kind.REPLY if kind in protocol.REPLIES else Kind.COMMAND, 1, row)
