"""What a sensor says besides its type and its cube: drawn where it is new, and changed a little where it is not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import sqrt
from typing import Any, Final

from nmes.genome.sensors import SMELLS
from nmes.schemas.documents import JsonObject
from nmes.variation.draw import Draw

__all__ = ["POINTED", "draw_details", "point_anew"]

POINTED: Final = frozenset({"range", "camera"})
"""The types of sensors that look in a direction."""
_FACES: Final = ("+x", "-x", "+y", "-y", "+z", "-z")
_WIDTH: Final = (4, 8)  # pixels
_TURN: Final = 0.3  # of a direction of length 1: how far each of its numbers is moved
_RANGES: Final = {"range": 5.0, **dict.fromkeys(SMELLS, 1.0)}  # m, times a factor


def draw_details(kind: str, cube: str, others: Sequence[Mapping[str, Any]], draw: Draw, *, planar: bool) -> JsonObject:
    """Draws what else a document says of a new sensor that is of use only in some places.

    Args:
        kind: Its type.
        cube: The id of the cube that it is on.
        others: The sensors that there are.
        draw: All choices.
        planar: Whether it looks along the plane z = 0.
    """
    if kind == "touch":
        return {"face": draw.one_of(_FACES[:4] if planar else _FACES)}
    details: JsonObject = {"id": _unused(f"{cube}.{kind}", others)} if kind in (*POINTED, *SMELLS) else {}
    if kind in _RANGES:
        details["range"] = round(_RANGES[kind] * draw.factor(0.5), 6)
    if kind == "camera":
        details |= {"width": draw.count(*_WIDTH), "height": 1, "colors": draw.one_of(("grey", "rgb"))}
        details["fov"] = round(draw.uniform(0.1, 0.4), 6)
    if kind in POINTED:
        details["direction"] = _turned((1.0, 0.0, 0.0), draw, planar=planar)
    return details


def point_anew(sensor: JsonObject, draw: Draw, *, planar: bool) -> None:
    """Turns where a sensor looks a little, and changes how far."""
    sensor["direction"] = _turned(sensor.get("direction", (1.0, 0.0, 0.0)), draw, planar=planar)
    if sensor["type"] == "range":
        sensor["range"] = round(min(1e6, max(1e-3, sensor.get("range", 10.0) * draw.factor(0.3))), 6)


def _turned(direction: Sequence[float], draw: Draw, *, planar: bool) -> list[float]:
    x, y, z = direction
    length = sqrt(x * x + y * y + z * z)
    parts = [part / length + draw.normal(_TURN) for part in direction]
    return [round(part, 6) for part in (*parts[:2], 0.0 if planar else parts[2])]


def _unused(name: str, others: Sequence[Mapping[str, Any]]) -> str:
    """Returns a name that no sensor has as its id."""
    taken = {sensor.get("id") for sensor in others}
    number = 1
    while f"{name}.{number}" in taken:
        number += 1
    return f"{name}.{number}"
