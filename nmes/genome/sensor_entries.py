"""How an entry of a document's sensors becomes single readings of a body.

Hides which fields each type has, their defaults, and how patterns, vectors and cameras are named one by one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import sqrt
from typing import Any, Final, Literal, Protocol

from nmes.backend import Vector
from nmes.genome.sensors import OF_CUBE, OF_JOINT, OF_OTHERS, SMELLS, VECTORS, Camera, Flaws, Sensor
from nmes.schemas.documents import fits

JsonObject = Mapping[str, Any]

__all__ = ["MOST_RAYS", "Notes", "count_rays", "read_sensor"]

MOST_RAYS: Final = 1024
"""How many rays the range finders and cameras of one body may send in a tick."""
_TURNING: Final = ("hinge", "slide")
_OWNERS: Final = {
    "axis": VECTORS,
    "range": (*OF_OTHERS, "range", "camera", *SMELLS),
    "channel": ("hear",),
    "number": ("hear",),
    "face": ("touch",),
    "direction": ("range", "camera"),
    **dict.fromkeys(("width", "height", "fov", "colors"), ("camera",)),
}
"""The types of sensors that have each field."""
_RANGES: Final = {"range": 10.0, "camera": 100.0, **dict.fromkeys(SMELLS, 1.0)}
_AHEAD: Final = (1.0, 0.0, 0.0)


class _Part(Protocol):
    @property
    def id(self) -> str: ...


class _Joint(_Part, Protocol):
    @property
    def kind(self) -> str: ...
    @property
    def motor(self) -> object | None: ...


class Notes(Protocol):
    """Where problems are noted."""

    def note(self, path: str, message: str) -> None:
        """Notes a problem with its place."""

    def may_be_absent(self, pattern: str) -> bool:
        """Whether a pattern may stand for what was left out."""

    def hint(self, name: str, known: Sequence[str]) -> str:
        """Returns a suggestion."""


def read_sensor(
    entry: JsonObject, path: str, cubes: Sequence[_Part], joints: Sequence[_Joint], notes: Notes
) -> list[Sensor]:
    """Returns the single readings of one entry of a document that its schema has accepted.

    Args:
        entry: The entry.
        path: Its place.
        cubes: What it may be on.
        joints: What it may be on, likewise.
        notes: Where its problems are noted; it then has no readings.
    """
    if ("joint" in entry) == ("cube" in entry):
        notes.note(path, "must have either a joint or a cube that it is on")
        return []
    of: Literal["joint", "cube"] = "joint" if "joint" in entry else "cube"
    problem = _problem(entry, of)
    if problem is not None:
        field, message = problem
        notes.note(f"{path}/{field}".rstrip("/"), message)
        return []
    targets = _targets(entry, of, f"{path}/{of}", cubes, joints, notes)
    if "id" in entry and len(targets) > 1:
        message = f"{entry[of]!r} fits {len(targets)} {of}s, so that one id is not enough: leave it out"
        notes.note(f"{path}/id", message)
        return []
    return [sensor for target in targets for sensor in _singles(entry, of, target)]


def count_rays(sensors: Sequence[Sensor]) -> int:
    """Returns how many rays sensors send, the readings of one pixel being one ray."""
    return sum(each.type == "range" or (each.camera is not None and _first_of_pixel(each)) for each in sensors)


def _first_of_pixel(sensor: Sensor) -> bool:
    assert sensor.camera is not None
    return not sensor.camera.rgb or sensor.number % 3 == 1


def _problem(entry: JsonObject, of: str) -> tuple[str, str] | None:
    """Returns the field that is wrong with an entry by itself, and why."""
    kind = entry["type"]
    kinds = OF_JOINT if of == "joint" else OF_CUBE
    if kind not in kinds:
        return "type", f"a {of} has no sensor {kind!r}, only {', '.join(kinds)}"
    for field, owners in _OWNERS.items():
        if field in entry and (of == "joint" or kind not in owners):
            return field, _no_field(kind, field, owners)
    if kind == "hear" and "channel" not in entry:
        return "", "hear needs a channel"
    return None


def _no_field(kind: str, field: str, owners: Sequence[str]) -> str:
    if field == "axis":
        return f"{kind} is one number and has no axis"
    return f"{kind} has no {field}; only {', '.join(owners)} {'have' if len(owners) > 1 else 'has'}"


def _singles(entry: JsonObject, of: Literal["joint", "cube"], target: str) -> Iterator[Sensor]:
    """Yields the readings that an entry has of one cube or joint."""
    kind: str = entry["type"]
    reach = float(entry["range"]) if "range" in entry else _RANGES.get(kind)
    name = entry.get("id", f"{target}.{kind}")
    flaws = Flaws.read(entry.get("flaws"))
    sensor = Sensor(name, kind, of, target, None, None if of == "joint" else reach, flaws=flaws)
    if of == "cube" and kind in VECTORS:
        axis = entry.get("axis")
        for each in "xyz" if axis is None else axis:
            own = name if axis is not None and "id" in entry else f"{name}.{each}"
            yield replace(sensor, id=own, axis=each)
    elif kind == "hear":
        channel, number = entry["channel"], int(entry.get("number", 1))
        heard = f"{name}.{channel}" if number == 1 else f"{name}.{channel}.{number}"
        yield replace(sensor, id=entry.get("id", heard), channel=channel, number=number)
    elif kind == "touch" and "face" in entry:
        face = entry["face"]
        yield replace(sensor, id=entry.get("id", f"{name}.{face.removeprefix('+')}"), face=face)
    elif kind == "range" and of == "cube":
        yield replace(sensor, direction=_unit(entry.get("direction", _AHEAD)))
    elif kind == "camera":
        yield from _pixels(sensor, entry)
    else:
        yield sensor


def _pixels(sensor: Sensor, entry: JsonObject) -> Iterator[Sensor]:
    """Yields the readings of a camera, row by row from the upper left."""
    rgb = entry.get("colors") == "rgb"
    width, height = int(entry.get("width", 8)), int(entry.get("height", 8))
    camera, direction = Camera(width, height, float(entry.get("fov", 1.0)), rgb), _unit(entry.get("direction", _AHEAD))
    tones = ("r", "g", "b") if rgb else ("",)
    names = (
        f"{sensor.id}.{row}.{column}.{tone}".rstrip(".")
        for row in range(1, height + 1)
        for column in range(1, width + 1)
        for tone in tones
    )
    for number, name in enumerate(names, 1):
        yield replace(sensor, id=name, number=number, direction=direction, camera=camera)


def _unit(direction: Sequence[float]) -> Vector:
    x, y, z = map(float, direction)
    length = sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


def _targets(
    entry: JsonObject, of: str, path: str, cubes: Sequence[_Part], joints: Sequence[_Joint], notes: Notes
) -> list[str]:
    """Returns the ids of the cubes or joints that fit an entry's pattern and have such a reading."""
    pattern, kind = entry[of], entry["type"]
    names = [part.id for part in (joints if of == "joint" else cubes)]
    fitting = list(filter(fits(pattern), names))
    if not fitting and not notes.may_be_absent(pattern):
        plain = not set(pattern) & set("*?")
        missing = f"there is no {of} {pattern!r}{notes.hint(pattern, names)}"
        notes.note(path, missing if plain else f"no {of} fits {pattern!r}")
    if of == "cube":
        return fitting
    able = {joint.id for joint in joints if (joint.motor is not None if kind == "effort" else joint.kind in _TURNING)}
    readable = [name for name in fitting if name in able]
    if fitting and not readable:
        what = "have a motor" if kind == "effort" else "are hinges or slides"
        notes.note(path, f"{kind} is only of joints that {what}; of {', '.join(map(repr, fitting[:5]))} none is one")
    return readable
