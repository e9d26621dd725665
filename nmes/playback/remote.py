"""A recording played to somebody else's server, and its answers compared with the recorded ones.

The server may run another engine, or be another's work altogether: all that is asked of it is the protocol, over
connections that whoever calls makes. Every recorded client has one of its own. Commands are sent one by one in the
recorded order, and where the recording has ticks the server is told to `step`.

Invariants:

- What is compared was asked at the same tick on both sides. Where the server cannot be brought there, the comparison
  ends and says so.
- A recorded command is either sent, and its answer compared, or counted among those that were kept back, with the
  reason.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import orjson

from nmes import protocol
from nmes.errors import CommandFailed, Disconnected
from nmes.playback.answers import AnswerComparison, FieldReport
from nmes.playback.divergence import message_or_text
from nmes.playback.inputs import Progress, RecordedInput, recorded_inputs, walk
from nmes.playback.report import RunReport
from nmes.recording import Kind, Record, Recording

__all__ = ["RemoteConnection", "RemoteReplayReport", "replay_remotely"]

_UNSUPPORTED = ("unknown_type", "unsupported")
_OF_THE_HOST = ("name", "mode", "rate", "seed")  # items of a world's config that need not be equal
_AT_ONCE: int = protocol.COMMANDS["step"].schema["properties"]["ticks"]["maximum"]


class RemoteConnection(Protocol):
    """A connection to the server's world, such as `nmes.Client`."""

    def request(self, message: Mapping[str, Any]) -> Any:
        """Sends a command and returns its reply; raises CommandFailed for an error, Disconnected, TimeoutError."""

    def close(self) -> None:
        """Hangs up."""


@dataclass(slots=True)
class RemoteReplayReport(RunReport):
    """The result of a replay on a server; `commands` were sent and compared, `ticks` were made by it.

    Attributes:
        verdict: `equal`: every answer is, within the tolerance. `different`. `incomplete`: what could be compared is
            equal, but commands are not supported, or the comparison ended early. The `differences` are those of the
            configs of the two worlds, as far as the server states its own.
        tolerance: By how much numbers may differ: absolutely, and of larger ones than 1 relatively.
        equal: How many of the answers were equal.
        values: How many values were compared.
        fields: The fields that differed, in the order in which they were first seen.
        unsupported: Commands that the recorded server executed and this one does not know, with how often.
        kept_back: Commands that were not sent, by the reason, with how often.
        renamed: The names that the server gave otherwise: recorded name, its name.
        ended: Why it ended before the recording does, if so.
    """

    tolerance: float = 0.0
    equal: int = 0
    values: int = 0
    fields: list[FieldReport] = field(default_factory=list)
    unsupported: Counter[str] = field(default_factory=Counter)
    kept_back: Counter[str] = field(default_factory=Counter)
    renamed: dict[str, str] = field(default_factory=dict)
    ended: str | None = None


def replay_remotely(
    recording: Recording,
    connect: Callable[[], RemoteConnection],
    *,
    tolerance: float = 1e-6,
    progress: Progress | None = None,
) -> RemoteReplayReport:
    """Plays a recording to a server. Its world is set to lockstep and reset first.

    Args:
        recording: The recording.
        connect: Makes one more connection to the server's world.
        tolerance: By how much numbers may differ: absolutely, and relatively where they are larger than 1.
        progress: Called now and then with how many bytes of the file are done, and its size.

    Raises:
        RecordingError: The file cannot be read as a recording, or begins at a keyframe.
        Disconnected: The server cannot be reached at all.
        CommandFailed: It lets nobody in.
    """
    began = time.perf_counter()
    recording.require_beginning("another server")
    report = RemoteReplayReport("equal", tolerance=tolerance)
    answers = AnswerComparison(tolerance)
    run = _RemoteReplay(recording.config, connect, answers, report)
    try:
        run.begin()
        run.play(recorded_inputs(walk(recording, progress=progress)))
    except _CannotGoOn as end:
        report.ended = str(end)
    finally:
        run.close()
    damage = recording.damage
    report.damage = None if damage is None else damage.message
    report.values, report.fields, report.renamed = answers.values, answers.fields, answers.renamed
    if report.fields:
        report.verdict = "different"
    elif report.unsupported or report.ended is not None:
        report.verdict = "incomplete"
    report.wall_seconds = time.perf_counter() - began
    return report


class _CannotGoOn(Exception):
    """Nothing more can be compared; says why."""


class _RemoteReplay:
    """One replay: it sends the recorded inputs to a server, each client's over a connection of its own."""

    def __init__(
        self,
        config: Mapping[str, Any],
        connect: Callable[[], RemoteConnection],
        answers: AnswerComparison,
        report: RemoteReplayReport,
    ) -> None:
        self._config = config
        self._connect = connect
        self._answers = answers
        self._report = report
        self._connections: dict[int, RemoteConnection] = {}
        self._spare: RemoteConnection | None = None  # where the recording has no clients, and yet the world must tick

    def begin(self) -> None:
        """Brings the server's world to where a recording begins, and compares its config."""
        self._spare = self._connect()
        for message in ({"type": "set_mode", "mode": "lockstep"}, {"type": "reset", "seed": self._config["seed"]}):
            answer = self._ask(self._spare, message)
            if answer["type"] == "error":
                kind, reason = message["type"], f"{answer['code']}: {answer['message']}"
                self._report.kept_back[f"{kind} at the beginning, which the server refuses ({reason})"] += 1
        config = self._ask(self._spare, {"type": "get_world_info"}).get("config")
        config = config if isinstance(config, dict) else {}
        for name, recorded in self._config.items():
            if name in config and name not in _OF_THE_HOST and not self._answers.same(recorded, config[name]):
                self._report.differences[name] = (recorded, config[name])

    def close(self) -> None:
        """Hangs up."""
        for connection in (*self._connections.values(), *filter(None, [self._spare])):
            connection.close()

    def play(self, inputs: Iterable[RecordedInput]) -> None:
        """Sends and compares until the recording ends or the two can no longer be at the same tick."""
        for recorded in inputs:
            record = recorded.record
            match record.kind:
                case Kind.JOINED if record.client is not None:
                    self._connections[record.client] = self._spare or self._enter()
                    self._spare = None
                case Kind.LEFT if record.client in self._connections:
                    self._connections.pop(record.client).close()
                case Kind.COMMAND if record.client in self._connections:
                    self._command(recorded)
                case Kind.REFUSED:
                    self._report.kept_back["a frame that is no valid command"] += 1
                case Kind.TICKS:
                    self._answers.frame = record.last_frame
                    self._tick(record, len(record.digests), None)
                case Kind.FAULT if record.about is not None:
                    self._tick(record, 1, record.about["code"])

    def _enter(self) -> RemoteConnection:
        try:
            return self._connect()
        except (CommandFailed, Disconnected, TimeoutError) as error:
            raise self._cannot_go_on(f"the server lets no other client in: {error}") from error

    def _ask(self, connection: RemoteConnection, message: Mapping[str, Any]) -> dict[str, Any]:
        """Sends a command and returns the answer, an error too."""
        try:
            answer = connection.request(message)
        except CommandFailed as error:
            answer = {"type": "error", "code": error.code, "message": error.message, "field": error.path}
        except (Disconnected, TimeoutError) as error:
            raise _CannotGoOn(f"at frame {self._answers.frame}, asked to {message.get('type')}: {error}") from error
        try:
            orjson.dumps(answer)
        except TypeError as error:
            raise self._cannot_go_on(f"the answer to {message.get('type')} is nested too deep") from error
        return {"type": None, **answer} if isinstance(answer, dict) else {"type": None}

    def _cannot_go_on(self, reason: str) -> _CannotGoOn:
        return _CannotGoOn(f"at frame {self._answers.frame} {reason}")

    # -- ticks -----------------------------------------------------------------------------------------------------

    def _tick(self, record: Record, ticks: int, fault: str | None) -> None:
        """Has the server make the ticks of the recorded world's clock; with a fault, the last of them is to stop it."""
        connection = next(iter(self._connections.values()), None)
        if connection is None:
            connection = self._spare = self._spare or self._enter()
        answer: dict[str, Any] = {}
        for done in range(0, ticks, _AT_ONCE):
            count = min(ticks - done, _AT_ONCE)
            answer = self._ask(connection, {"type": "step", "ticks": count})
            if answer["type"] == "error":
                break
            self._report.ticks += count
        stopped = answer["type"] == "error"
        if stopped and fault is None:
            raise self._cannot_go_on(f"the server does not step: {answer['code']}: {answer['message']}")
        if not stopped and fault is None:
            self._answers.compare("step", record, {"frame": self._answers.frame}, {"frame": answer.get("frame")})
        elif not stopped:
            self._answers.add("step", record, None, "fault", fault, None)

    # -- commands --------------------------------------------------------------------------------------------------

    def _command(self, recorded: RecordedInput) -> None:
        record, reply = recorded.record, recorded.reply
        if reply is None or record.client is None:
            return  # cut in the midst of it
        message, expected = protocol.parse(record.data).command, message_or_text(reply.data)
        if message is None:
            self._report.kept_back["a frame that is no valid command"] += 1
            return
        if not isinstance(expected, dict):
            expected = {"type": None, "message": expected}
        reason = _reason_to_keep_back(message, recorded)
        if reason is not None:
            self._report.kept_back[reason] += 1
            return
        self._follow(recorded, reset=message["type"] == "reset" and expected.get("type") != "error")
        message.pop("id", None)
        actual = self._ask(self._connections[record.client], self._answers.rename(message))
        failed = actual["type"] == "error" and expected.get("type") != "error"
        if failed and actual["code"] in _UNSUPPORTED:
            self._unsupported(message["type"], recorded)
            return
        self._compare(message["type"], recorded, expected, actual)
        if recorded.digests and failed:
            raise self._cannot_go_on(f"the server did not tick: {actual['code']}: {actual['message']}")

    def _follow(self, recorded: RecordedInput, *, reset: bool) -> None:
        """Goes on to the frame of the recorded world after a command."""
        for effect in recorded.effects:
            if effect.kind is Kind.TICKS:
                self._answers.frame = effect.last_frame
        if reset:
            self._answers.frame = 0

    def _unsupported(self, kind: str, recorded: RecordedInput) -> None:
        self._report.unsupported[kind] += 1
        if recorded.digests:
            raise self._cannot_go_on(f"the server does not know {kind}, which made the world tick")

    def _compare(self, kind: str, recorded: RecordedInput, expected: Any, actual: Any) -> None:
        assert recorded.reply is not None
        if actual["type"] != "error":
            self._report.ticks += len(recorded.digests)
        mismatches = self._answers.mismatches
        self._answers.compare(kind, recorded.reply, expected, actual)
        self._report.commands += 1
        self._report.equal += mismatches == self._answers.mismatches


def _reason_to_keep_back(message: dict[str, Any], recorded: RecordedInput) -> str | None:
    """Tells why a command is not to be sent, if it is not."""
    parts = message["commands"] if message["type"] == "batch" else [message]
    kinds = {part.get("type") for part in parts if isinstance(part, dict)}
    if "set_mode" in kinds:
        return "set_mode: here the server is told when to tick"
    if "step" in kinds and not recorded.digests:
        # It waited for others, whose ticks stand before it; or it was refused, as by a world with a clock.
        return "a step that made no tick of its own"
    return None
