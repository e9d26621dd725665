"""The differences between a recorded history and what comes out of it now: values, replies, poses."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import orjson

from nmes import protocol
from nmes.recording.viewer_messages import POSE_FIELDS, decode_poses

__all__ = [
    "VOLATILE",
    "Difference",
    "Divergence",
    "equal_replies",
    "json_difference",
    "message_or_text",
    "pose_difference",
    "reply_difference",
]

VOLATILE = tuple(kind for kind, reply in protocol.REPLIES.items() if reply.schema.get("x-volatile"))
"""Types of replies whose content may differ between machines that agree on everything else: pictures.

Where one of them could be made, and where none could, is not a divergence either.
"""
_VOLATILE_FIELDS = {
    kind: fields
    for kind, reply in protocol.REPLIES.items()
    if (fields := {name for name, part in reply.schema["properties"].items() if part.get("x-volatile")})
}
"""By type of reply, the fields that tell of the program rather than of the world: its versions, what it can do."""
_LOOKED_INTO = tuple(f'"type":"{kind}"'.encode() for kind in (*VOLATILE, *_VOLATILE_FIELDS))


@dataclass(frozen=True, slots=True)
class Difference:
    """One value that differs.

    Attributes:
        cube: The name of the cube that it is about, if it is about one.
        field: Its path in the reply, or the component of a pose; empty where all of a reply differs.
        expected: The recorded value.
        actual: The value that came out now.
    """

    cube: str | None
    field: str
    expected: Any
    actual: Any

    @property
    def amount(self) -> float | None:
        """The distance between the two if they are numbers, else None."""
        values = (self.expected, self.actual)
        if any(isinstance(value, bool) or not isinstance(value, int | float) for value in values):
            return None
        return abs(float(self.actual) - float(self.expected))


@dataclass(slots=True)
class Divergence:
    """The first difference between a recording and its replay.

    Attributes:
        kind: The kind of thing that differs: the `digest` of a tick, a `reply`, the `poses`, a `keyframe`, a `fault`,
            the number of a `client`, or the `order` in which things happen.
        frame: The frame at which the world was.
        record: The number of the record in the recording.
        message: The difference in a sentence.
        client: Of a reply, the number of the client whose command it answers.
        command: That command's type.
        value: The first value that shows it, if any does. Digests do not: for them it is the first recorded reply or
            pose that comes out differently from then on.
        seen: The frame at which that value was seen.
    """

    kind: str
    frame: int
    record: int
    message: str
    client: int | None = None
    command: str | None = None
    value: Difference | None = None
    seen: int | None = None

    def to_json(self) -> dict[str, Any]:
        """Makes a dict of it for JSON, with the fields of the value among the others."""
        plain = asdict(self)
        del plain["value"]
        if self.value is not None:
            plain |= {**asdict(self.value), "difference": self.value.amount}
        return plain


def equal_replies(expected: bytes, actual: bytes) -> bool:
    """Tells whether two replies are equal but for what is volatile, alone or in a batch."""
    if expected == actual:
        return True
    volatile = any(kind in reply for kind in _LOOKED_INTO for reply in (expected, actual))
    return volatile and reply_difference(expected, actual) is None


def reply_difference(expected: bytes, actual: bytes) -> Difference | None:
    """Finds the first value in which two encoded replies differ; None where only volatile ones do."""
    return json_difference(message_or_text(expected), message_or_text(actual))


def message_or_text(data: bytes) -> Any:
    """Returns the JSON of a message; its text where it is none, or is nested deeper than JSON can be written."""
    try:
        message = orjson.loads(data)
        orjson.dumps(message)  # it writes no such depth as it reads
        return message
    except (ValueError, TypeError):
        return data.decode(errors="replace")


def json_difference(expected: Any, actual: Any, cube: str | None = None, path: str = "") -> Difference | None:
    """Finds the first value in which two JSON documents differ; its path begins at the cube that it is about."""
    if isinstance(expected, dict) and isinstance(actual, dict):
        return _object_difference(expected, actual, cube, path)
    if isinstance(expected, list) and isinstance(actual, list):
        return _list_difference(expected, actual, cube, path)
    # As text, so that 0.0 and -0.0 are two things, as they are to the engine.
    if orjson.dumps(expected) == orjson.dumps(actual):
        return None
    return Difference(cube, path.rstrip("/"), expected, actual)


def _object_difference(
    expected: dict[str, Any], actual: dict[str, Any], cube: str | None, path: str
) -> Difference | None:
    if expected.get("type") in VOLATILE or actual.get("type") in VOLATILE:
        return None
    name = expected.get("cube_name")
    if isinstance(name, str) and name == actual.get("cube_name"):
        cube, path = name, ""
    volatile = _VOLATILE_FIELDS.get(str(expected.get("type")), ())
    for key in {**expected, **actual}:
        if key in volatile:
            continue
        if key not in expected or key not in actual:
            return Difference(cube, f"{path}{key}", expected.get(key), actual.get(key))
        if difference := json_difference(expected[key], actual[key], cube, f"{path}{key}/"):
            return difference
    return None


def _list_difference(expected: list[Any], actual: list[Any], cube: str | None, path: str) -> Difference | None:
    for i, (one, other) in enumerate(zip(expected, actual, strict=False)):
        if difference := json_difference(one, other, cube, f"{path}{i}/"):
            return difference
    if len(expected) == len(actual):
        return None
    return Difference(cube, path.rstrip("/"), f"{len(expected)} items", f"{len(actual)} items")


def pose_difference(recorded: bytes, now: bytes) -> Difference | None:
    """Finds the value in which the poses of two transforms messages differ most."""
    actual = decode_poses(now)
    try:
        expected = decode_poses(recorded)
    except ValueError as error:
        return Difference(None, "cubes", str(error), list(actual))
    if list(expected) != list(actual):
        return Difference(None, "cubes", list(expected), list(actual))
    differences = [
        Difference(cube, name, one, other)
        for cube in expected
        for name, one, other in zip(POSE_FIELDS, expected[cube], actual[cube], strict=True)
        if one != other
    ]
    return max(differences, key=lambda difference: difference.amount or 0.0, default=None)
