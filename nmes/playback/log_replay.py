"""Running a log again in a fresh world, and comparing what it holds.

Of a log that is no whole history as much is compared as it holds.

Invariants:

- Lines are taken in order. Every line is done, compared, or counted among those that were passed over.
- `reproduced` is said only of a whole history whose replies and ticks all came out the same.
"""

from __future__ import annotations

import base64
import time
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import orjson

from nmes import protocol
from nmes.errors import BackendNotFound, WorldError
from nmes.playback.divergence import Difference, Divergence, json_difference
from nmes.playback.inputs import Progress, Walk
from nmes.playback.log import BEGINNING, Line, Log
from nmes.playback.report import RunReport, fingerprint_differences
from nmes.protocol import Request
from nmes.recording import Kind
from nmes.recording.records import numbered_ticks
from nmes.world import World
from nmes.world.journal import Journal

__all__ = ["LogReport", "replay_log"]

_SHOWN = 5  # refused commands that are reported
_CLIENTS = 65_536  # that a log need not say of that they came


@dataclass(slots=True)
class LogReport(RunReport):
    """The result of running a log again; `ticks` and `commands` count all, compared or not.

    Attributes:
        verdict: `reproduced`; `agrees`, where the log is not a whole history, but all that it holds came out the same;
            `ran`, where it holds nothing to compare; `diverged`; or `not_comparable`, where something came out
            differently, or the engine is not there, and the fingerprints differ, in the items that are `differences`.
        replies: How many replies were compared and equal.
        digests: How many digests of ticks were compared and equal.
        whole: Whether the log says how its world began, and so is a whole history.
        passed_over: Lines that were neither done nor compared, by what they are, with how many.
        refused: Commands that the world refused and whose answer the log does not hold, the first few.
        divergence: The first difference, if there is any; its `record` is the number of a line, from 1.
    """

    replies: int = 0
    digests: int = 0
    whole: bool = False
    passed_over: dict[str, int] = field(default_factory=dict)
    refused: list[str] = field(default_factory=list)
    divergence: Divergence | None = None


def replay_log(log: Log, *, progress: Progress | None = None) -> LogReport:
    """Runs a log again in a fresh world, and compares what it holds.

    Args:
        log: The log.
        progress: Called now and then with how many bytes of the file are done, and its size.

    Raises:
        RecordingError: A line of the file cannot be read.
        BackendNotFound: Its engine is not there, and the log does not say what it was made with.
    """
    began = time.perf_counter()
    whole = log.fingerprint is not None
    differences = fingerprint_differences(log.config["backend"], log.fingerprint) if log.fingerprint is not None else {}
    try:
        run = _LogReplay(log)
    except BackendNotFound:
        if not whole:
            raise
        return LogReport("not_comparable", whole=whole, differences=differences)
    try:
        run.play(Walk(log.chunks(), log.size, progress))
    finally:
        run.world.close()
    report = run.report
    report.differences = differences
    report.verdict = _verdict(report)
    report.wall_seconds = time.perf_counter() - began
    return report


def _verdict(report: LogReport) -> str:
    if report.divergence is not None:
        return "not_comparable" if report.differences else "diverged"
    if report.whole:
        return "reproduced"
    return "agrees" if report.replies or report.digests else "ran"


class _LogReplay(Journal):
    """One run: it repeats the lines in a world, and it is that world's journal."""

    def __init__(self, log: Log) -> None:
        self._log = log
        self.report = LogReport("ran", whole=log.fingerprint is not None)
        self.world = World(log.config, journal=self)
        self._ticks: deque[tuple[int, str]] = deque()  # that the world made, not compared with a line yet
        self._replies: dict[
            int, deque[tuple[int, Any]]
        ] = {}  # by client, the same; with the number of the command's line
        self._refused: dict[int, int] = {}  # by client: frames that were refused, whose answers are still to come
        self._number = 0  # of the line at hand
        self._faults: deque[tuple[int, str, str]] = deque()

    def play(self, lines: Iterable[Line]) -> None:
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
                case Kind.JOINED:
                    self._join(line)
                case Kind.KEYFRAME:
                    self._restore(line)
                case Kind.HIBERNATED:
                    self._hibernate()
                case Kind.LEFT if line.client in self.world.clients():
                    self.world.leave(line.client)
                case Kind.LEFT:
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

    def _join(self, line: Line) -> None:
        try:
            client = self.world.join(line.message.get("role"), line.message.get("player"))
        except WorldError as error:
            return self._diverge("client", f"client {line.client} joined; now it cannot: {error.message}")
        if client != line.client:
            self._diverge("client", f"client {line.client} joined; now it has another number")

    def _hibernate(self) -> None:
        """Saves the world, and goes on from that."""
        if self.world.clients() or self.world.fault is not None or "snapshot" not in self.world.backend.capabilities:
            return self._diverge("order", "the world was put to sleep; now it cannot be")
        self.world.hibernate()
        if self.world.asleep:
            self.world.wake()

    def _pass_over(self, what: str) -> None:
        if what != "the beginning":
            self.report.passed_over[what] = self.report.passed_over.get(what, 0) + 1

    def _restore(self, line: Line) -> None:
        """Goes on from the keyframe with which a recording began, of a world that has a past."""
        if not self.world.untouched:
            return self._diverge("order", "a keyframe, which only ever stands at the beginning")
        try:
            self.world.restore(base64.b64decode(line.message["snapshot"], validate=True))
        except (ValueError, WorldError) as error:
            raise self._log.wrong(line.number, f"is no keyframe of such a world: {error}") from None

    def _command(self, line: Line) -> None:
        self._drop_ticks()
        if self.report.whole and self._replies.get(line.client):
            return self._diverge("order", "a command, and the one before it has no answer")
        if line.client not in self.world.clients() and not self._let_in(line):
            return self._diverge("order", f"client {line.client} says something, and is not there")
        self.report.commands += 1
        self.world.handle(line.client, protocol.parse(orjson.dumps(line.message)))

    def _let_in(self, line: Line) -> bool:
        """Lets clients in up to that of a line; tells whether it could be, as where the log need not say who came."""
        if self.report.whole:
            return False
        if line.client > _CLIENTS:
            raise self._log.wrong(line.number, f"is of client {line.client:,}; there may be {_CLIENTS:,}")
        while (number := self.world.join()) < line.client:
            pass
        return number == line.client

    def _reply(self, line: Line) -> None:
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
        difference = json_difference(line.message, reply)
        if difference is None:
            self.report.replies += 1
            return
        self._diverge("reply", f"the command of line {number} is answered differently", difference)

    def _tick(self, line: Line) -> None:
        for frame, digest in numbered_ticks(line.message):
            if not self._ticks:
                self.world.tick()
            if not self._ticks:
                return self._diverge("order", f"tick {frame}; now the world has stopped")
            actual_frame, actual_digest = self._ticks.popleft()
            if (actual_frame, actual_digest) != (frame, digest):
                reason = "its digest differs" if actual_frame == frame else f"now it is tick {actual_frame}"
                return self._diverge("digest", f"tick {frame} does not come out the same: {reason}")
            self.report.digests += 1

    def _fault(self, line: Line) -> None:
        if not self._faults:
            self.world.tick()
        fault = (line.message["frame"], line.message["code"], line.message["message"])
        if not self._faults or self._faults.popleft() != fault:
            self._diverge("fault", f"a fault at frame {fault[0]} ({fault[1]}); now there is none such")

    def _drop_ticks(self) -> None:
        """Forgets the ticks that no line tells of before the next command; in a whole history there are none."""
        if self._ticks and self.report.whole:
            self._diverge("order", f"now the world ticks to frame {self._ticks[0][0]}, of which no line tells")
        self._ticks.clear()

    def _end(self) -> None:
        if any(self._replies.values()):
            self._ticks.clear()  # it ends in the midst of a command
        self._drop_ticks()
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
            sentence = f"line {self._number}: {message}" if kind != "order" else f"line {self._number} has {message}"
            self.report.divergence = Divergence(kind, self.world.frame, self._number, sentence)
            if value is not None:
                self.report.divergence.value, self.report.divergence.seen = value, self.world.frame

    # -- the journal -----------------------------------------------------------------------------------------------

    def replied(self, client: int, request: Request, reply: bytes) -> None:
        """A frame was answered."""
        self._replies.setdefault(client, deque()).append((self._number, orjson.loads(reply)))

    def ticked(self, frame: int, digest: bytes) -> None:
        """The world reached a frame."""
        self.report.ticks += 1
        self._ticks.append((frame, digest.hex()))

    def faulted(self, frame: int, code: str, message: str) -> None:
        """The world stopped."""
        self._faults.append((frame, code, message))


def _alike(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Tells whether two replies have the same type and id."""
    return (one.get("type"), one.get("id")) == (other.get("type"), other.get("id"))
