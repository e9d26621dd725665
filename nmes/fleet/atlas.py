"""The worlds of a survey for which no tasks are named: hills of five heights under each of five gravities."""

from __future__ import annotations

from typing import Any, Final

from nmes.evaluation.setting import read_task
from nmes.schemas.documents import JsonObject, parse_document

__all__ = ["GRAVITIES", "HEIGHTS", "atlas"]

HEIGHTS: Final = (0.2, 0.5, 1.0, 1.6, 2.4)
"""Of the hills, m, from valley to top; hills are three metres apart."""
GRAVITIES: Final = (1.62, 3.71, 6.5, 9.81, 15.0)
"""Accelerations of free fall, m/s^2: the first is the moon's, the second that of Mars, the fourth the earth's."""
_SAMPLES: Final = 81  # heights along an edge
_EDGE: Final = 40.0  # m
_DURATION: Final = 6.0  # s


def atlas() -> list[JsonObject]:
    """Returns the tasks, documents, row by row: rows are gravities, columns heights of hills.

    Each is the shipped task `rough` with other hills and another gravity, for six seconds instead of ten.
    """
    return [_task(height, gravity) for gravity in GRAVITIES for height in HEIGHTS]


def _task(height: float, gravity: float) -> JsonObject:
    rough: dict[str, Any] = dict(parse_document(read_task("rough")))
    heightfield = rough["world"]["scene"]["heightfield"]
    field = {**heightfield, "size": [_EDGE, _EDGE], "samples": [_SAMPLES, _SAMPLES], "height": height}
    return {
        **rough,
        "name": f"hills-{round(1000 * height)}mm-gravity-{round(1000 * gravity)}mm",
        "description": f"Get as far along x as you can over hills of {height:g} m under {gravity:g} m/s² of gravity: "
        "another landscape for each seed. The ground about the start is level.",
        "world": {"gravity": [0, -gravity, 0], "scene": {**rough["world"]["scene"], "heightfield": field}},
        "duration": _DURATION,
        "seeds": [1],
    }
