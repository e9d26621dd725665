"""Logs: an experiment as lines of JSON, run again.

Two kinds of lines are understood. `nmes export --to jsonl` writes rows, each with its `kind`; they hold a whole
history, so that a log of them can be `reproduced` as a recording can. The other kind is bare messages, a line each:
commands, and what they were answered where somebody kept that. Such a log is what the paper on NMES calls a complete
history, replayed "by sending the same commands to a fresh server"; of it as much is compared as it holds.

Invariants:

- Lines are taken in order. Every line is done, compared, or counted among what was passed over.
- `reproduced` is said only of a whole history on an equal fingerprint whose replies and ticks all came out the same.
"""

from __future__ import annotations

import base64
import os
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jsonschema_rs
import orjson

from nmes import protocol
from nmes.backend import load_backend
from nmes.backend.fingerprint import differences, fingerprint
from nmes.errors import BackendNotFound, NmesError, RecordingError, WorldError
from nmes.playback.compare import Difference, Divergence, difference
from nmes.protocol import Request
from nmes.recording.records import Kind
from nmes.schemas import load
from nmes.world import World

__all__ = ["BEGINNING", "Log", "LogReport", "replay_log"]

BEGINNING = "recording"  # the kind of a row that says how the world began, with the recording's metadata
_DEFAULT = {"mode": "lockstep"}  # the world of a log that does not say
_SHOWN = 5  # refused commands that are reported
_LONGEST = 256 << 20  # bytes of a line
_SHAPES: dict[Any, jsonschema_rs.Draft202012Validator] = {
    Kind.TICKS: jsonschema_rs.Draft202012Validator(load("recording/ticks.json")),
    Kind.FAULT: jsonschema_rs.Draft202012Validator(load("recording/faults.json")),
    Kind.REPLY: jsonschema_rs.Draft202012Validator({"type": "object"}),
    Kind.KEYFRAME: jsonschema_rs.Draft202012Validator(
        {"type": "object", "required": ["snapshot"], "properties": {"snapshot": {"type": "string"}}}
    ),
    BEGINNING: jsonschema_rs.Draft202012Validator({"type": "object"}),
}

Verdict = Literal["reproduced", "agrees", "ran", "diverged", "not_comparable"]


class _Line(NamedTuple):
    """A line that was read: where, what it tells, of whom."""

    number: int
    kind: str
    client: int
    message: Any


@dataclass(slots=True)
class LogReport:
    """What running a log again came to.

    Attributes:
        verdict: `reproduced`; `agrees`, where the log is not a whole history, but all that it holds came out the same;
            `ran`, where it holds nothing to compare; `diverged`; `not_comparable`, whatever came out.
        commands: How many were executed.
        replies: How many replies were compared and equal.
        ticks: How many the world made.
        digests: How many of them were compared and equal.
        whole: Whether the log says how its world began, and so is a whole history.
        passed_over: Lines that were neither done nor compared, by what they are, with how many.
        refused: Commands that the world refused and whose answer the log does not hold, the first few.
        divergence: The first difference, if there is any; its `record` is the number of a line, from 1.
        differences: The items of the fingerprint that differ: recorded, here.
        wall_seconds: How long it took, s.
    """

    verdict: Verdict = "ran"
    commands: int = 0
    replies: int = 0
    ticks: int = 0
    digests: int = 0
    whole: bool = False
    passed_over: dict[str, int] = field(default_factory=dict)
    refused: list[str] = field(default_factory=list)
    divergence: Divergence | None = None
    differences: dict[str, tuple[str, str]] = field(default_factory=dict)
    wall_seconds: float = 0.0

    def to_json(self) -> dict[str, Any]:
        """Returns it as plain data."""
        divergence = None if self.divergence is None else self.divergence.to_json()
        return {**asdict(self), "divergence": divergence}


class Log:
    """A log to run.

    Attributes:
        path: The file.
        size: Of the file, in bytes.
        config: The config of its world: what it says, or a new world in lockstep.
        fingerprint: What its numbers depended on, if it says.

    Raises:
        RecordingError: It cannot be read, or says in vain how its world began.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        try:
            self.size = self.path.stat().st_size
        except OSError as error:
            raise RecordingError("recording_unreadable", f"cannot read {path}: {error.strerror}") from error
        self.config: dict[str, Any] = dict(_DEFAULT)
        self.fingerprint: dict[str, str] | None = None
        for line in self._lines(None):
            if line.kind == BEGINNING:
                self._begin(line)
            break

    def _begin(self, line: _Line) -> None:
        try:
            protocol.validate_metadata(line.message)
            self.config = protocol.complete_config(orjson.loads(line.message["nmes.world"]["config"]))
        except (NmesError, ValueError) as error:
            raise self._wrong(line.number, f"does not say how its world began: {error}") from None
        self.fingerprint = line.message["nmes.fingerprint"]

    def _wrong(self, number: int, what: str) -> RecordingError:
        return RecordingError("not_a_recording", f"{self.path}: line {number} {what}")

    def _lines(self, progress: Callable[[int, int], None] | None) -> Iterator[_Line]:
        """Yields what stands in the file; blank lines are nothing."""
        reached = 0
        try:
            with self.path.open("rb") as file:
                for number, text in enumerate(iter(lambda: file.readline(_LONGEST), b""), 1):
                    reached += len(text)
                    if text.strip():
                        yield self._line(number, text)
                    if progress is not None and number % 256 == 0:
                        progress(reached, self.size)
        except OSError as error:
            raise RecordingError("recording_unreadable", f"cannot read {self.path}: {error.strerror}") from error

    def _line(self, number: int, text: bytes) -> _Line:
        try:
            row = orjson.loads(text)
        except ValueError as error:
            raise self._wrong(number, f"is not JSON: {error}") from None
        if not isinstance(row, dict):
            raise self._wrong(number, "is no JSON object")
        if "kind" in row and "message" in row:
            client, shape = row.get("client"), _SHAPES.get(row["kind"])
            if shape is not None and not shape.is_valid(row["message"]):
                raise self._wrong(number, f"does not have the shape of {row['kind']}")
            if client is not None and (not isinstance(client, int) or client < 1):
                raise self._wrong(number, f"has no number of a client: {client!r}")
            return _Line(number, str(row["kind"]), client or 1, row["message"])
        kind = row.get("type")
        if not isinstance(kind, str):
            raise self._wrong(number, "is neither a message, which has a type, nor a row, which has a kind")
        if kind in ("auth", "auth_success") or kind in protocol.EVENTS:
            return _Line(number, kind, 1, row)
        return _Line(number, Kind.REPLY if kind in protocol.REPLIES else Kind.COMMAND, 1, row)


def replay_log(log: Log, *, anyway: bool = False, progress: Callable[[int, int], None] | None = None) -> LogReport:
    """Runs a log again in a fresh world, and compares what it holds.

    Args:
        log: The log.
        anyway: Run it also where the fingerprint differs, to see how far it agrees.
        progress: Called now and then with how many bytes of the file are done, and its size.

    Raises:
        RecordingError: A line of the file cannot be read.
        BackendNotFound: Its engine is not there, and it was to be run `anyway`.
    """
    began = time.perf_counter()
    unlike = {} if log.fingerprint is None else _differences(log)
    if unlike and not anyway:
        return LogReport("not_comparable", whole=True, differences=unlike)
    run = _Run(log)
    try:
        run.play(log._lines(progress))
    finally:
        run.world.close()
    report = run.report
    report.differences = unlike
    if unlike:
        report.verdict = "not_comparable"
    elif report.divergence is not None:
        report.verdict = "diverged"
    elif report.whole:
        report.verdict = "reproduced"
    elif report.replies or report.digests:
        report.verdict = "agrees"
    report.wall_seconds = time.perf_counter() - began
    return report


def _differences(log: Log) -> dict[str, tuple[str, str]]:
    try:
        backend = load_backend(log.config["backend"])
    except BackendNotFound:
        return {"backend": (log.config["backend"], "not installed")}
    return differences(log.fingerprint or {}, fingerprint(backend))


class _Run:
    """One run: it does what the lines say to a world, whose journal it is."""

    def __init__(self, log: Log) -> None:
        self._log = log
        self.report = LogReport(whole=log.fingerprint is not None)
        self.world = World(log.config, journal=self)
        self._ticks: deque[tuple[int, str]] = deque()  # that the world made, and no line has told of yet
        self._replies: dict[int, deque[tuple[int, Any]]] = {}  # by client, the same; with the line that was answered
        self._refused: dict[int, int] = {}  # by client: frames that were refused, whose answers are still to come
        self._number = 0  # of the line at hand
        self._faults: deque[tuple[int, str, str]] = deque()

    def play(self, lines: Iterator[_Line]) -> None:
        """Goes through the lines, or as far as it takes to see where the world parts from them."""
        for line in lines:
            self._number = line.number
            match line.kind:
                case Kind.COMMAND:
                    self._command(line)
                case Kind.REPLY:
                    self._reply(line)
                case Kind.TICKS:
                    self._tick(line)
                case Kind.FAULT:
                    self._fault(line)
                case Kind.JOINED if self.world.join() != line.client:
                    self._diverge("client", f"client {line.client} joined; now it has another number")
                case Kind.KEYFRAME:
                    self._take_up(line)
                case Kind.LEFT if line.client in self.world.clients():
                    self.world.leave(line.client)
                case Kind.JOINED | Kind.LEFT:
                    pass
                case Kind.REFUSED:
                    # What is no valid command changes nothing, and its bytes are not in the log.
                    self._refused[line.client] = self._refused.get(line.client, 0) + 1
                    self._pass_over("refused frames")
                case kind:
                    self._pass_over("the beginning" if kind == BEGINNING else f"{kind} messages")
            if self.report.divergence is not None:
                return
        self._end()

    def _pass_over(self, what: str) -> None:
        if what != "the beginning":
            self.report.passed_over[what] = self.report.passed_over.get(what, 0) + 1

    def _take_up(self, line: _Line) -> None:
        """Goes on from the keyframe with which a recording began, of a world that has a past."""
        if not self.world.untouched:
            return self._diverge("order", "a keyframe, which only ever stands at the beginning")
        try:
            self.world.restore(base64.b64decode(line.message["snapshot"], validate=True))
        except (ValueError, WorldError) as error:
            raise self._log._wrong(line.number, f"is no keyframe of such a world: {error}") from None

    def _command(self, line: _Line) -> None:
        self._settle()
        if self.report.whole and self._replies.get(line.client):
            return self._diverge("order", "a command, and the one before it has no answer")
        while line.client not in self.world.clients():
            if self.report.whole:
                return self._diverge("order", f"client {line.client} says something, and is not there")
            self.world.join()
        self.report.commands += 1
        self.world.handle(line.client, protocol.parse(orjson.dumps(line.message)))

    def _reply(self, line: _Line) -> None:
        if self._refused.get(line.client):
            self._refused[line.client] -= 1
            return
        waiting = self._replies.get(line.client)
        if not waiting:
            return self._diverge("order", "a reply, and no command was given that it could answer")
        if not self.report.whole:
            # Not every command need have an answer there. Where none of ours is like this one, the last is meant.
            like = [i for i, (_, reply) in enumerate(waiting) if _alike(reply, line.message)]
            for _ in range(like[0] if like else len(waiting) - 1):
                self._unanswered(*waiting.popleft())
        number, reply = waiting.popleft()
        found = difference(line.message, reply)
        if found is None:
            self.report.replies += 1
            return
        self._diverge("reply", f"the command of line {number} is answered differently", found)

    def _tick(self, line: _Line) -> None:
        first = line.message["frame"]
        for number, digest in enumerate(line.message["digests"]):
            if not self._ticks:
                self.world.tick()
            if not self._ticks:
                return self._diverge("order", f"tick {first + number}; now the world has stopped")
            if (made := self._ticks.popleft()) != (first + number, digest):
                what = "its digest differs" if made[0] == first + number else f"now it is tick {made[0]}"
                return self._diverge("digest", f"tick {first + number} does not come out the same: {what}")
            self.report.digests += 1

    def _fault(self, line: _Line) -> None:
        if not self._faults:
            self.world.tick()
        told = (line.message["frame"], line.message["code"], line.message["message"])
        if not self._faults or self._faults.popleft() != told:
            self._diverge("fault", f"a fault at frame {told[0]} ({told[1]}); now there is none such")

    def _settle(self) -> None:
        """Ticks that no line told of before the next command: of a whole history, each must be told of."""
        if self._ticks and self.report.whole:
            self._diverge("order", f"now the world ticks to frame {self._ticks[0][0]}, of which no line tells")
        self._ticks.clear()

    def _end(self) -> None:
        if any(self._replies.values()):
            self._ticks.clear()  # it ends in the midst of a command
        self._settle()
        for waiting in self._replies.values():
            for number, reply in waiting:
                self._unanswered(number, reply)
                if self.report.whole:
                    self._pass_over("commands without their answer")

    def _unanswered(self, number: int, reply: Any) -> None:
        if reply["type"] == "error" and len(self.report.refused) < _SHOWN:
            self.report.refused.append(f"line {number}: {reply['code']}: {reply['message']}")

    def _diverge(self, kind: str, message: str, value: Difference | None = None) -> None:
        if self.report.divergence is None:
            said = f"line {self._number}: {message}" if kind != "order" else f"line {self._number} has {message}"
            self.report.divergence = Divergence(kind, self.world.frame, self._number, said)
            if value is not None:
                self.report.divergence.value, self.report.divergence.seen = value, self.world.frame

    # -- the journal -----------------------------------------------------------------------------------------------

    def joined(self, client: int) -> None:
        """A client came."""

    def left(self, client: int) -> None:
        """A client went."""

    def received(self, client: int, request: Request) -> None:
        """A frame is executed next."""

    def replied(self, client: int, request: Request, reply: bytes) -> None:
        """A frame was answered."""
        self._replies.setdefault(client, deque()).append((self._number, orjson.loads(reply)))

    def ticked(self, frame: int, digest: bytes) -> None:
        """The world reached a frame."""
        self.report.ticks += 1
        self._ticks.append((frame, digest.hex()))

    def keyframe(self, snapshot: bytes) -> None:
        """The world was saved."""

    def faulted(self, frame: int, code: str, message: str) -> None:
        """The world stopped."""
        self._faults.append((frame, code, message))


def _alike(one: dict[str, Any], other: dict[str, Any]) -> bool:
    return (one.get("type"), one.get("id")) == (other.get("type"), other.get("id"))
