"""The report of `nmes replay --backend`: a table, and a plot."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from nmes.cli._plot import Curves, write_plot
from nmes.errors import visible
from nmes.playback.drift import Drift, DriftReport

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["plot", "show"]

TIMES = 5  # columns of the table
CUBES = 20  # rows of the table: those that drift most
FLOOR = 1e-6  # m: recorded poses are rounded to float32, so less than this is nothing


def show(report: DriftReport, console: Console) -> None:
    """Prints a row for each cube: how far it is from where it was recorded, over time."""
    from rich.table import Table

    amount = f"{report.ticks:,} ticks ({report.sim_seconds:,.2f} s), {report.commands:,} commands"
    console.print(f"recorded on {report.recorded}, run on {report.backend}: {amount}")
    if report.cubes:
        cubes = sorted(report.cubes.items(), key=lambda item: -_worst(item[1]))
        times = _times([drift.time for _, drifts in cubes for drift in drifts])
        console.print("metres from where each cube was recorded, at some times and at most; and how far it is turned:")
        table = Table("cube", *(f"{time:.2f} s" for time in times), "most", "turned", box=None, pad_edge=False)
        for column in table.columns[1:]:
            column.justify = "right"
        for name, drifts in cubes[:CUBES]:
            at = {drift.time: f"{drift.distance:.4f}" for drift in drifts}
            turned = f"{math.degrees(drifts[-1].angle):.2f}°"
            table.add_row(visible(name), *(at.get(time, "") for time in times), f"{_worst(drifts):.4f}", turned)
        console.print(table)
        if len(cubes) > CUBES:
            console.print(f"and {len(cubes) - CUBES} cubes that drift less")
    else:
        console.print("the recording shows no poses to compare with")
    for code, count in report.refused.items():
        console.print(visible(f"{count:,} commands that were good on {report.recorded} are refused here: {code}"))
    if report.ended is not None:
        console.print(visible(f"ended early: {report.ended}"))


def plot(title: str, cubes: Mapping[str, list[Drift]], path: Path) -> None:
    """Writes each cube's distance over time as an SVG or PNG, on a logarithmic scale."""
    lines = {name: [(drift.time, drift.distance) for drift in drifts] for name, drifts in cubes.items()}
    write_plot(path, title, [Curves("distance (m)", lines, floor=FLOOR, height=380)])


def _worst(drifts: list[Drift]) -> float:
    return max(drift.distance for drift in drifts)


def _times(times: list[float]) -> list[float]:
    """Chooses the times for the columns, evenly spread, the last one among them."""
    distinct = sorted(set(times))
    count = min(TIMES, len(distinct))
    return sorted({distinct[round((i + 1) * len(distinct) / count) - 1] for i in range(count)})
