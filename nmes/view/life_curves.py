"""The curves of an ecosystem, from the censuses that its recording holds: nothing is run again."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

from nmes.recording import Kind, Recording

__all__ = ["life_curves"]

_PANELS: Final[Mapping[str, tuple[str, ...]]] = {
    "creatures, and food": ("population", "food"),
    "births and deaths in the last minute": ("births", "deaths"),
    "species": ("species",),
    "energy, mean (J)": ("energy",),
    "age, mean (s)": ("age",),
    "generation, mean": ("generation",),
    "mass, mean (kg)": ("mass",),
    "longest edge, mean (m)": ("size",),
    "parts, mean": ("cubes", "motors", "sensors"),
}
_MINUTE: Final = 60.0  # s
_POINTS: Final = 2000  # of a curve, more than a plot can show


def life_curves(recording: Recording) -> dict[str, dict[str, list[tuple[float, float]]]]:
    """Returns the curves of a recording of a world with life: points (s, value) by name, by the panel's title.

    A `reset` does not set time back.
    """
    curves = {title: {name: list[tuple[float, float]]() for name in names} for title, names in _PANELS.items()}
    censuses = list(_censuses(recording))
    for time, census in censuses[:: max(1, len(censuses) // _POINTS)]:
        for lines in curves.values():
            for name, line in lines.items():
                if name in census:
                    line.append((time, census[name]))
    return curves


def _censuses(recording: Recording) -> Iterator[tuple[float, dict[str, float]]]:
    """Yields each census with its time, its means among its counts, and what came and went in the minute before."""
    rate: int = recording.config["tick_rate"]
    ticks = recording.start().frame
    past: list[tuple[float, float, float]] = []
    for record in recording:
        ticks += len(record.digests)
        for event in record.about["events"] if record.kind is Kind.LIFE and record.about is not None else ():
            if event["type"] == "census":
                yield ticks / rate, _flat(event, ticks / rate, past)


def _flat(census: Mapping[str, Any], time: float, past: list[tuple[float, float, float]]) -> dict[str, float]:
    if past and census["born"] < past[-1][1]:
        past.clear()  # the world was reset
    past.append((time, census["born"], census["died"]))
    while past[0][0] < time - _MINUTE:
        past.pop(0)
    counts = {name: census[name] for name in ("population", "species", "food")}
    births, deaths = (past[-1][column] - past[0][column] for column in (1, 2))
    return {**counts, **census["means"], "births": births, "deaths": deaths}
