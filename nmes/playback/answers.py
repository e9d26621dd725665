"""The answers of another server, compared with the recorded ones value by value.

Names are the server's own: when it calls a cube or a joint otherwise than the recording does, its name is learnt from
the answer that made it, and is no difference.
"""

from __future__ import annotations

import math
import operator
from dataclasses import dataclass
from typing import Any

from nmes.backend.rotation import angle_between, quaternion_from_euler
from nmes.playback.divergence import VOLATILE
from nmes.recording import Record

__all__ = ["AnswerComparison", "FieldReport", "Mismatch"]

# Fields of a reply that are about the server rather than the world, or about the command; and words for people.
_PECULIAR = {"id", "message", "world", "backend", "versions", "config", "limits", "skeletons", "capabilities"}
_PECULIAR |= {"mode", "rate", "command"}
_NAMES = ("cube_name", "cube1", "cube2", "joint_name")  # of a command: the names that it refers to
_MADE = ("spawned", "joint_name", "bone_name")  # of a reply that something was made: its name
_MAKERS = ("cube_list", "joint_created", "bone_created")
_ROTATIONS = {"quaternion": 4, "rotation": 3}  # fields that are one, and of how many numbers


@dataclass(frozen=True, slots=True)
class Mismatch:
    """One value that differs.

    Attributes:
        frame: The frame at which the recorded world was.
        record: The number of the reply in the recording.
        client: The number of the client whose command was answered.
        cube: The name of the cube that it is about, as the recording calls it, if it is about one.
        field: Its path in the reply.
        expected: The recorded value.
        actual: The server's value; None also where its answer has nothing of the kind.
        difference: The distance of the two, if they are numbers.
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


class AnswerComparison:
    """The comparison of all answers of one server, with the names that it gives to cubes and joints.

    Attributes:
        frame: The frame of the recorded world, which whoever walks through the recording sets.
        values: How many values were compared.
        mismatches: How many of them differed.
        renamed: The names that the server gave otherwise: recorded name, its name.
    """

    def __init__(self, tolerance: float) -> None:
        """Begins with nothing compared; numbers may differ by the tolerance, of larger ones than 1 relatively."""
        self.frame = 0
        self.values = 0
        self.mismatches = 0
        self.renamed: dict[str, str] = {}
        self._tolerance = tolerance
        self._fields: dict[tuple[str, str], FieldReport] = {}

    @property
    def fields(self) -> list[FieldReport]:
        """The fields that differed, in the order in which they were first seen."""
        return list(self._fields.values())

    def rename(self, value: Any, key: str = "", kind: str = "") -> Any:
        """Returns a command with the server's names in place of the recorded ones."""
        if isinstance(value, dict):
            kind = value.get("type", "")
            return {name: self.rename(part, name, kind) for name, part in value.items()}
        if isinstance(value, list):
            return [self.rename(part, key, kind) for part in value]
        if isinstance(value, str) and key in _NAMES and kind != "spawn_cube":
            return self.renamed.get(value, value)
        return value

    def compare(
        self, command: str, record: Record, expected: Any, actual: Any, path: str = "", cube: str | None = None
    ) -> None:
        """Compares the answer to a command, or a part of it.

        Args:
            command: The type of the command.
            record: The recorded reply, or the record that stands for it.
            expected: The recorded value.
            actual: The server's value.
            path: The path of the value in the reply; that of an object or a list ends with a slash.
            cube: The cube that the value is about, if it is about one.
        """
        if isinstance(expected, dict) and isinstance(actual, dict):
            self._compare_objects(command, record, expected, actual, path, cube)
        elif isinstance(expected, list) and isinstance(actual, list):
            self._compare_lists(command, record, expected, actual, path, cube)
        else:
            self.values += 1
            if not self.same(expected, actual, exact=path.rpartition("/")[2] == "frame"):
                self.add(command, record, cube, path, expected, actual)

    def _compare_objects(
        self, command: str, record: Record, expected: Any, actual: Any, path: str, cube: str | None
    ) -> None:
        kind = expected.get("type")
        if kind in VOLATILE:
            return
        if kind in _MAKERS and actual.get("type") == kind:
            self._learn_names(expected, actual)
        if isinstance(expected.get("cube_name"), str):
            cube = expected["cube_name"]
        for key, value in expected.items():
            if key in _PECULIAR or (kind == "error" and value is None):
                continue
            if key not in actual:
                self.add(command, record, cube, f"{path}{key}", value, None)
                continue
            other = actual[key]
            if key in _ROTATIONS and _numbers(value, _ROTATIONS[key]) and _numbers(other, _ROTATIONS[key]):
                other = self._nearest(key, value, other)
            deeper = isinstance(value, dict | list)
            self.compare(command, record, value, other, f"{path}{key}{'/' if deeper else ''}", cube)

    def _nearest(self, key: str, ours: list[float], theirs: list[float]) -> list[float]:
        """Returns their rotation in those numbers that are nearest to ours; ours, where they turn by as much.

        Of one rotation there are two quaternions, and many Euler angles: y and z come round at pi, and where x is a
        right angle only their sum or difference means anything.
        """
        if key == "quaternion":
            return [-x for x in theirs] if sum(map(operator.mul, ours, theirs)) < 0 else theirs
        one, two = quaternion_from_euler(*ours), quaternion_from_euler(*theirs)
        if angle_between(one, two) <= self._tolerance:
            return ours
        return [x + math.tau * round((at - x) / math.tau) for at, x in zip(ours, theirs, strict=True)]

    def _compare_lists(
        self, command: str, record: Record, expected: list[Any], actual: list[Any], path: str, cube: str | None
    ) -> None:
        if expected and all(
            isinstance(one, dict) and isinstance(one.get("cube_name"), str) for one in (*expected, *actual)
        ):
            self._compare_cubes(command, record, expected, actual, path)
            return
        if len(expected) != len(actual):
            self.add(command, record, cube, path.rstrip("/"), expected, actual)
            return
        for number, (one, other) in enumerate(zip(expected, actual, strict=True)):
            deeper = isinstance(one, dict | list)
            self.compare(command, record, one, other, f"{path}{number}{'/' if deeper else ''}", cube)

    def _compare_cubes(self, command: str, record: Record, expected: list[Any], actual: list[Any], path: str) -> None:
        """Compares two lists of cubes, which may be in another order."""
        others = {other["cube_name"]: other for other in actual}
        names = [self.renamed.get(one["cube_name"], one["cube_name"]) for one in expected]
        for one, name in zip(expected, names, strict=True):
            if name in others:
                self.compare(command, record, one, others[name], path, one["cube_name"])
            else:
                self.add(command, record, one["cube_name"], path.rstrip("/"), "there", None)
        for name in [name for name in others if name not in names]:
            self.add(command, record, None, path.rstrip("/"), None, name)

    def _learn_names(self, expected: dict[str, Any], actual: dict[str, Any]) -> None:
        for key in _MADE:
            ours, theirs = expected.get(key), actual.get(key)
            if not isinstance(ours, str) or not isinstance(theirs, str):
                continue
            if ours != theirs:
                self.renamed[ours] = theirs
            else:
                self.renamed.pop(ours, None)

    def same(self, expected: Any, actual: Any, *, exact: bool = False) -> bool:
        """Tells whether two values are equal, numbers within the tolerance unless they are to be exact."""
        if _number(expected) and _number(actual):
            allowed = 0.0 if exact else self._tolerance * max(1.0, abs(expected))
            return math.isclose(expected, actual, rel_tol=0.0, abs_tol=allowed)
        if isinstance(expected, str):
            return bool(actual == expected or actual == self.renamed.get(expected))
        return bool(expected == actual and isinstance(expected, bool) == isinstance(actual, bool))

    def add(self, command: str, record: Record, cube: str | None, path: str, expected: Any, actual: Any) -> None:
        """Adds a difference to the reports of the fields; the arguments are those of `compare`."""
        amount = abs(float(actual) - float(expected)) if _number(expected) and _number(actual) else None
        mismatch = Mismatch(self.frame, record.sequence, record.client, cube, path, expected, actual, amount)
        report = self._fields.setdefault((command, path), FieldReport(command, path, 0, mismatch, mismatch))
        report.count += 1
        self.mismatches += 1
        if (amount or 0.0) > (report.worst.difference or 0.0):
            report.worst = mismatch


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _numbers(value: Any, count: int) -> bool:
    return isinstance(value, list) and len(value) == count and all(map(_number, value))
