"""A recording played to somebody else's server, and its answers compared with the recorded ones.

The server may run another engine, or be another's work altogether: all that is asked of it is the protocol, over
connections that whoever calls makes. Every recorded client has one of its own. Commands are sent one by one in the
recorded order, and where the recording has ticks the server is told to `step`.

Invariants:

- What is compared was asked at the same tick on both sides. Where the server cannot be brought there, the comparison
  ends and says so.
- A recorded command is either sent, and its answer compared, or counted among what was kept back, with the reason.
- Names are the server's own: what it calls a cube or a joint that the recording calls otherwise is learnt from the
  answer that made it, and no difference.
"""

from __future__ import annotations

import math
import operator
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal, Protocol

import orjson

from nmes import protocol
from nmes.backend.rotation import angle_between, quaternion_from_euler
from nmes.errors import CommandFailed, Disconnected
from nmes.playback.inputs import RecordedInput, recorded_inputs
from nmes.recording import Recording
from nmes.recording.records import Kind, Record

__all__ = ["Connection", "FieldReport", "Mismatch", "RemoteReplayReport", "replay_remotely"]

# Replies of which the content may differ between machines that agree on everything else: pictures.
_VOLATILE = {kind for kind, reply in protocol.REPLIES.items() if reply.schema.get("x-volatile")}
# What a reply says of the server rather than of the world, or of the command; and words for people.
_PECULIAR = {"id", "message", "world", "backend", "versions", "config", "limits", "skeletons", "capabilities"}
_PECULIAR |= {"mode", "rate", "command"}
_UNSUPPORTED = ("unknown_type", "unsupported")
_NAMES = ("cube_name", "cube1", "cube2", "joint_name")  # of a command: the names that it refers to
_MADE = ("spawned", "joint_name", "bone_name")  # of a reply that something was made: what it is called
_MAKERS = ("cube_list", "joint_created", "bone_created")
_ROTATIONS = {"quaternion": 4, "rotation": 3}  # fields that are one, and of how many numbers
_AT_ONCE: int = protocol.COMMANDS["step"].schema["properties"]["ticks"]["maximum"]

Progress = Callable[[int, int], None]
Verdict = Literal["equal", "different", "incomplete"]


class Connection(Protocol):
    """What is asked of a connection, such as `nmes.Client`."""

    def request(self, message: Mapping[str, Any]) -> Any:
        """Sends a command and returns its reply; raises CommandFailed for an error, Disconnected, TimeoutError."""

    def close(self) -> None:
        """Hangs up."""


@dataclass(frozen=True, slots=True)
class Mismatch:
    """One value that differs.

    Attributes:
        frame: Where the recorded world was.
        record: The number of the reply in the recording.
        client: Whose command was answered.
        cube: Which cube it is about, as the recording calls it, if it is one.
        field: Where in the reply it stands.
        expected: What was recorded.
        actual: What the server answered; None also where it answered nothing of the kind.
        difference: Their distance, of two numbers.
    """

    frame: int
    record: int
    client: int | None
    cube: str | None
    field: str
    expected: Any
    actual: Any
    difference: float | None


@dataclass(slots=True)
class FieldReport:
    """How one field of the answers to one command differs: how often, where first, and where most."""

    command: str
    field: str
    count: int
    first: Mismatch
    worst: Mismatch


@dataclass(slots=True)
class RemoteReplayReport:
    """What a replay against a server came to.

    Attributes:
        verdict: `equal`: every answer is, within the tolerance. `incomplete`: what could be compared is, but commands
            are not supported, or the comparison ended early.
        tolerance: By how much numbers may differ: absolutely, and of larger ones than 1 relatively.
        commands: How many were sent and compared.
        equal: How many of their answers were equal.
        values: How many values were compared.
        ticks: How many the server made.
        fields: What differed, field by field, in the order in which it was first seen.
        unsupported: Commands that the recorded server executed and this one does not know, with how often.
        kept_back: What was not sent, and why, with how often.
        renamed: What the server calls otherwise: recorded name, its name.
        unlike: In what the server's world was made otherwise, as far as it says: recorded, there.
        ended: Why it ended before the recording does, if so.
        damage: Why the recording ends early, if it does.
        wall_seconds: How long it took, s.
    """

    verdict: Verdict = "equal"
    tolerance: float = 0.0
    commands: int = 0
    equal: int = 0
    values: int = 0
    ticks: int = 0
    fields: list[FieldReport] = field(default_factory=list)
    unsupported: dict[str, int] = field(default_factory=dict)
    kept_back: dict[str, int] = field(default_factory=dict)
    renamed: dict[str, str] = field(default_factory=dict)
    unlike: dict[str, tuple[Any, Any]] = field(default_factory=dict)
    ended: str | None = None
    damage: str | None = None
    wall_seconds: float = 0.0

    def to_json(self) -> dict[str, Any]:
        """Returns it as plain data."""
        return asdict(self)


def replay_remotely(
    recording: Recording,
    connect: Callable[[], Connection],
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
    run = _Run(recording, connect, tolerance)
    report = run.report
    try:
        run.begin()
        run.play(_records(recording, progress))
    except _Ended as end:
        report.ended = str(end)
    finally:
        run.close()
    damage = recording.damage
    report.damage = None if damage is None else damage.message
    if report.fields:
        report.verdict = "different"
    elif report.unsupported or report.ended is not None:
        report.verdict = "incomplete"
    report.wall_seconds = time.perf_counter() - began
    return report


def _records(recording: Recording, progress: Progress | None) -> Iterator[Record]:
    for reached, records in recording.chunks():
        yield from records
        if progress is not None:
            progress(reached, recording.size)


class _Ended(Exception):
    """Nothing more can be compared; says why."""


class _Run:
    """One comparison."""

    def __init__(self, recording: Recording, connect: Callable[[], Connection], tolerance: float) -> None:
        self.report = RemoteReplayReport(tolerance=tolerance)
        self._config = recording.config
        self._connect = connect
        self._connections: dict[int, Connection] = {}
        self._spare: Connection | None = None  # where the recording has nobody, and yet there is something to be said
        self._frame = 0  # of the recorded world
        self._fields: dict[tuple[str, str], FieldReport] = {}
        self._differing = 0  # values so far

    def begin(self) -> None:
        """Brings the server's world to where a recording begins, and looks how it was made."""
        self._spare = self._connect()
        for message in ({"type": "set_mode", "mode": "lockstep"}, {"type": "reset", "seed": self._config["seed"]}):
            answer = self._ask(self._spare, message)
            if answer["type"] == "error":
                kind, why = message["type"], f"{answer['code']}: {answer['message']}"
                _count(self.report.kept_back, f"{kind} at the beginning, which the server refuses ({why})")
        about = self._ask(self._spare, {"type": "get_world_info"})
        there = about.get("config")
        there = there if isinstance(there, dict) else {}
        for name, recorded in self._config.items():
            if name in there and name not in ("name", "mode", "rate", "seed") and not self._same(recorded, there[name]):
                self.report.unlike[name] = (recorded, there[name])

    def close(self) -> None:
        """Hangs up."""
        for connection in (*self._connections.values(), *filter(None, [self._spare])):
            connection.close()

    def play(self, records: Iterator[Record]) -> None:
        """Sends and compares until the recording ends or the two can no longer be at the same tick."""
        for recorded in recorded_inputs(records):
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
                    _count(self.report.kept_back, "a frame that is no valid command")
                case Kind.TICKS if record.about is not None:
                    ticks = len(record.about["digests"])
                    self._frame = record.about["frame"] + ticks - 1
                    self._tick(record, ticks, None)
                case Kind.FAULT if record.about is not None:
                    self._tick(record, 1, record.about["code"])

    def _enter(self) -> Connection:
        try:
            return self._connect()
        except (CommandFailed, Disconnected, TimeoutError) as error:
            raise _Ended(f"at frame {self._frame} the server lets no other client in: {error}") from error

    def _ask(self, connection: Connection, message: Mapping[str, Any]) -> dict[str, Any]:
        """Returns a command's answer, an error too."""
        try:
            answer = connection.request(message)
        except CommandFailed as error:
            return {"type": "error", "code": error.code, "message": error.message, "field": error.path}
        except (Disconnected, TimeoutError) as error:
            raise _Ended(f"at frame {self._frame}, asked to {message.get('type')}: {error}") from error
        return answer if isinstance(answer, dict) else {"type": None}

    # -- ticks -----------------------------------------------------------------------------------------------------

    def _tick(self, record: Record, ticks: int, fault: str | None) -> None:
        """Has the server make ticks that the recorded world made by its clock, the last of which may stop it."""
        connection = next(iter(self._connections.values()), None)
        if connection is None:
            connection = self._spare = self._spare or self._enter()
        answer: dict[str, Any] = {}
        for begun in range(0, ticks, _AT_ONCE):
            now = min(ticks - begun, _AT_ONCE)
            answer = self._ask(connection, {"type": "step", "ticks": now})
            if answer["type"] == "error":
                break
            self.report.ticks += now
        if answer["type"] == "error" and fault is None:
            raise _Ended(f"at frame {self._frame} the server does not step: {answer['code']}: {answer['message']}")
        if answer["type"] != "error" and fault is None:
            self._compare("step", record, {"frame": self._frame}, {"frame": answer.get("frame")})
        elif answer["type"] != "error":
            self._differs("step", record, None, "fault", fault, None)

    # -- commands --------------------------------------------------------------------------------------------------

    def _command(self, recorded: RecordedInput) -> None:
        record, reply = recorded.record, recorded.reply
        if reply is None or record.client is None:
            return  # cut in the midst of it
        message, expected = orjson.loads(record.data), orjson.loads(reply.data)
        reason = self._reason(message, recorded)
        if reason is not None:
            _count(self.report.kept_back, reason)
            return
        for effect in recorded.effects:
            if effect.kind is Kind.TICKS and effect.about is not None:
                self._frame = effect.about["frame"] + len(effect.about["digests"]) - 1
        if message["type"] == "reset" and expected["type"] != "error":
            self._frame = 0
        message.pop("id", None)
        actual = self._ask(self._connections[record.client], self._renamed(message))
        kind = message["type"]
        if actual["type"] == "error":
            if expected["type"] != "error" and actual["code"] in _UNSUPPORTED:
                _count(self.report.unsupported, kind)
                if recorded.digests:
                    raise _Ended(f"at frame {self._frame} the server does not know {kind}, which made the world tick")
                return
        else:
            self.report.ticks += len(recorded.digests)
        before = self._differing
        self._compare(kind, reply, expected, actual)
        self.report.commands += 1
        self.report.equal += before == self._differing
        if recorded.digests and actual["type"] == "error" and expected["type"] != "error":
            raise _Ended(f"at frame {self._frame} the server did not tick: {actual['code']}: {actual['message']}")

    def _reason(self, message: dict[str, Any], recorded: RecordedInput) -> str | None:
        """Returns why a command is not to be sent, if it is not."""
        parts = message["commands"] if message["type"] == "batch" else [message]
        kinds = {part.get("type") for part in parts if isinstance(part, dict)}
        if "set_mode" in kinds:
            return "set_mode: here the server is told when to tick"
        if "step" in kinds and not recorded.digests:
            # It waited for others, whose ticks stand before it; or it was refused, as by a world with a clock.
            return "a step that made no tick of its own"
        return None

    def _renamed(self, value: Any, key: str = "", kind: str = "") -> Any:
        """Returns a command with the server's names in place of the recorded ones."""
        if isinstance(value, dict):
            kind = value.get("type", "")
            return {name: self._renamed(part, name, kind) for name, part in value.items()}
        if isinstance(value, list):
            return [self._renamed(part, key, kind) for part in value]
        if isinstance(value, str) and key in _NAMES and kind != "spawn_cube":
            return self.report.renamed.get(value, value)
        return value

    # -- what differs ----------------------------------------------------------------------------------------------

    def _compare(
        self, command: str, record: Record, expected: Any, actual: Any, path: str = "", cube: str | None = None
    ) -> None:
        if isinstance(expected, dict) and isinstance(actual, dict):
            self._compare_objects(command, record, expected, actual, path, cube)
        elif isinstance(expected, list) and isinstance(actual, list):
            self._compare_lists(command, record, expected, actual, path, cube)
        else:
            self.report.values += 1
            if not self._same(expected, actual, exact=path.rpartition("/")[2] == "frame"):
                self._differs(command, record, cube, path, expected, actual)

    def _compare_objects(
        self, command: str, record: Record, expected: Any, actual: Any, path: str, cube: str | None
    ) -> None:
        kind = expected.get("type")
        if kind in _VOLATILE:
            return
        if kind in _MAKERS and actual.get("type") == kind:
            for key in _MADE:
                ours, theirs = expected.get(key), actual.get(key)
                if isinstance(ours, str) and isinstance(theirs, str):
                    self._learn(ours, theirs)
        if isinstance(expected.get("cube_name"), str):
            cube = expected["cube_name"]
        for key, value in expected.items():
            if key in _PECULIAR or (kind == "error" and value is None):
                continue
            if key not in actual:
                self._differs(command, record, cube, f"{path}{key}", value, None)
                continue
            other = actual[key]
            if key in _ROTATIONS and _numbers(value, _ROTATIONS[key]) and _numbers(other, _ROTATIONS[key]):
                other = self._nearest(key, value, other)
            deeper = isinstance(value, dict | list)
            self._compare(command, record, value, other, f"{path}{key}{'/' if deeper else ''}", cube)

    def _nearest(self, key: str, ours: list[float], theirs: list[float]) -> list[float]:
        """Returns the same rotation in those numbers that are most like ours; ours, where they turn by as much.

        Of one rotation there are two quaternions, and many Euler angles: y and z come round at pi, and where x is a
        right angle only their sum or difference means anything.
        """
        if key == "quaternion":
            return [-x for x in theirs] if sum(map(operator.mul, ours, theirs)) < 0 else theirs
        one, two = quaternion_from_euler(*ours), quaternion_from_euler(*theirs)
        if angle_between(one, two) <= self.report.tolerance:
            return ours
        return [x + math.tau * round((at - x) / math.tau) for at, x in zip(ours, theirs, strict=True)]

    def _compare_lists(
        self, command: str, record: Record, expected: list[Any], actual: list[Any], path: str, cube: str | None
    ) -> None:
        if expected and all(isinstance(one, dict) and "cube_name" in one for one in (*expected, *actual)):
            # Cubes may come in another order.
            there = {one["cube_name"]: one for one in actual}
            names = [self.report.renamed.get(one["cube_name"], one["cube_name"]) for one in expected]
            for one, name in zip(expected, names, strict=True):
                if name in there:
                    self._compare(command, record, one, there[name], path, one["cube_name"])
                else:
                    self._differs(command, record, one["cube_name"], path.rstrip("/"), "there", None)
            for name in [name for name in there if name not in names]:
                self._differs(command, record, None, path.rstrip("/"), None, name)
            return
        if len(expected) != len(actual):
            self._differs(command, record, cube, path.rstrip("/"), expected, actual)
            return
        for number, (one, other) in enumerate(zip(expected, actual, strict=True)):
            deeper = isinstance(one, dict | list)
            self._compare(command, record, one, other, f"{path}{number}{'/' if deeper else ''}", cube)

    def _learn(self, ours: str, theirs: str) -> None:
        if ours != theirs:
            self.report.renamed[ours] = theirs
        else:
            self.report.renamed.pop(ours, None)

    def _same(self, expected: Any, actual: Any, *, exact: bool = False) -> bool:
        if _number(expected) and _number(actual):
            allowed = 0.0 if exact else self.report.tolerance * max(1.0, abs(expected))
            return math.isclose(expected, actual, rel_tol=0.0, abs_tol=allowed)
        if isinstance(expected, str):
            return bool(actual == expected or actual == self.report.renamed.get(expected))
        return bool(expected == actual and isinstance(expected, bool) == isinstance(actual, bool))

    def _differs(self, command: str, record: Record, cube: str | None, where: str, expected: Any, actual: Any) -> None:
        amount = abs(float(actual) - float(expected)) if _number(expected) and _number(actual) else None
        seen = Mismatch(self._frame, record.sequence, record.client, cube, where, expected, actual, amount)
        found = self._fields.get((command, where))
        if found is None:
            found = self._fields[command, where] = FieldReport(command, where, 0, seen, seen)
            self.report.fields.append(found)
        found.count += 1
        self._differing += 1
        if (amount or 0.0) > (found.worst.difference or 0.0):
            found.worst = seen


def _count(counts: dict[str, int], what: str) -> None:
    counts[what] = counts.get(what, 0) + 1


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _numbers(value: Any, count: int) -> bool:
    return isinstance(value, list) and len(value) == count and all(map(_number, value))
