"""How `nmes replay --backend` shows what it found: a table, and a plot as SVG."""

from __future__ import annotations

import html
import math
from collections.abc import Iterator
from pathlib import Path

from rich.console import Console
from rich.table import Table

from nmes.drift import Drift, DriftReport

__all__ = ["plot", "show"]

TIMES = 5  # columns of the table
CUBES = 20  # rows of the table: those that drift most
FLOOR = 1e-6  # m: recorded poses are rounded to float32, so less than this is nothing
COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
WIDTH, HEIGHT, LEFT, BOTTOM, TOP, RIGHT = 900, 480, 70, 50, 40, 150


def show(report: DriftReport, console: Console) -> None:
    """Prints a row for each cube: how far it is from where it was recorded, over time."""
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
            table.add_row(name, *(at.get(time, "") for time in times), f"{_worst(drifts):.4f}", turned)
        console.print(table)
        if len(cubes) > CUBES:
            console.print(f"and {len(cubes) - CUBES} cubes that drift less")
    else:
        console.print("the recording shows no poses to compare with")
    for code, count in report.refused.items():
        console.print(f"{count:,} commands that were good on {report.recorded} are refused here: {code}")
    if report.ended is not None:
        console.print(f"ended early: {report.ended}")


def plot(report: DriftReport, path: Path) -> None:
    """Writes each cube's distance over time as an SVG, on a logarithmic scale."""
    path.write_text("\n".join(_svg(report)) + "\n")


def _svg(report: DriftReport) -> Iterator[str]:
    drifts = [drift for line in report.cubes.values() for drift in line]
    end = max((drift.time for drift in drifts), default=0.0) or 1.0
    low = math.floor(math.log10(FLOOR))
    high = max(low + 1, math.ceil(math.log10(max((drift.distance for drift in drifts), default=0.0) or FLOOR)))

    def x(time: float) -> float:
        return LEFT + (WIDTH - LEFT - RIGHT) * time / end

    def y(distance: float) -> float:
        part = (math.log10(max(distance, FLOOR)) - low) / (high - low)
        return HEIGHT - BOTTOM - (HEIGHT - BOTTOM - TOP) * part

    yield f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif">'
    yield f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/><g font-size="12" stroke-width="1.5">'
    title = f"Drift of {report.backend} from the recording on {report.recorded}"
    yield f'<text x="{LEFT}" y="24" font-size="16">{html.escape(title)}</text>'
    for power in range(low, high + 1):
        level = y(10.0**power)
        yield f'<path d="M{LEFT} {level:.1f}H{WIDTH - RIGHT}" stroke="#ddd"/>'
        yield f'<text x="{LEFT - 6}" y="{level + 4:.1f}" text-anchor="end">1e{power} m</text>'
    for part in range(6):
        time = end * part / 5
        yield f'<text x="{x(time):.1f}" y="{HEIGHT - BOTTOM + 18}" text-anchor="middle">{time:.3g} s</text>'
    for i, (name, line) in enumerate(report.cubes.items()):
        color = COLORS[i % len(COLORS)]
        points = " ".join(f"{x(drift.time):.1f},{y(drift.distance):.1f}" for drift in line)
        yield f'<polyline points="{points}" fill="none" stroke="{color}"/>'
        if i < (HEIGHT - TOP - BOTTOM) // 16:
            label = f'<text x="{WIDTH - RIGHT + 8}" y="{TOP + 16 * i + 12}" fill="{color}">'
            yield f"{label}{html.escape(name)}</text>"
    yield "</g></svg>"


def _worst(drifts: list[Drift]) -> float:
    return max(drift.distance for drift in drifts)


def _times(times: list[float]) -> list[float]:
    """Returns some of the times at which there is something to show, evenly spread, the last one among them."""
    distinct = sorted(set(times))
    count = min(TIMES, len(distinct))
    return sorted({distinct[round((i + 1) * len(distinct) / count) - 1] for i in range(count)})
