"""The front of a run with several objectives as a picture: what can be had of one only by giving up of another."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

from nmes.evolution.history import History, Origin
from nmes.view.chart import Chart, Picture, number, text
from nmes.view.run_tree import Portrait

__all__ = ["front_plot"]

_DOTS = 3000  # candidates that are no part of the front, at most
_PORTRAITS = 6
_WIDE, _HIGH = 84, 63  # of a portrait, pixels


def front_plot(history: History, elites: Sequence[Origin], objectives: Sequence[str], portrait: Portrait) -> Picture:
    """Returns all candidates and the front over the first two objectives, with portraits along it.

    Args:
        history: Of the run.
        elites: The front, one candidate or more.
        objectives: Their expressions, two or more.
        portrait: Draws a candidate.
    """
    front = sorted(elites, key=lambda elite: (elite.objectives[0], elite.objectives[1], elite.index))
    told_rows = [row for row in history.rows if len(row.objectives) > 1 and all(map(isfinite, row.objectives))]
    shown = told_rows[:: -(-len(told_rows) // _DOTS)]
    points = [(row.objectives[0], row.objectives[1]) for row in [*shown, *front]]
    xs, ys = [x for x, _ in points], [y for _, y in points]
    chart = Chart((min(xs), max(xs)), (min(ys), max(ys)), height=380, right=24)
    parts = list(chart.axes(objectives[0], objectives[1]))
    for row in shown:
        place = f'cx="{chart.x(row.objectives[0]):.1f}" cy="{chart.y(row.objectives[1]):.1f}"'
        parts.append(f'<circle class="dots" opacity="0.45" {place} r="2"/>')
    line = [(row.objectives[0], row.objectives[1]) for row in front]
    if len(objectives) == 2:
        parts.append(f'<polyline class="s1" stroke-width="1.5" points="{chart.path(line)}"/>')
    for row in front:
        x, y = chart.x(row.objectives[0]), chart.y(row.objectives[1])
        values = ", ".join(f"{name} {number(value)}" for name, value in zip(objectives, row.objectives, strict=True))
        name = f"<title>candidate {row.index}: {text(values)}</title>"
        parts.append(f'<circle class="f1" cx="{x:.1f}" cy="{y:.1f}" r="4.5">{name}</circle>')
    for row in _spread(chart, front):
        parts += _portrait(chart, row, portrait)
    told = f"{len(front)} candidates are beaten by no other in all of {len(objectives)} objectives at once."
    return Picture("front", "The front", told, chart.width, chart.height, "\n".join(parts))


def _spread(chart: Chart, front: Sequence[Origin]) -> list[Origin]:
    """Returns candidates along the front whose portraits do not hide each other."""
    chosen: list[Origin] = []
    for row in front:
        place = chart.x(row.objectives[0]), chart.y(row.objectives[1])
        others = [(chart.x(other.objectives[0]), chart.y(other.objectives[1])) for other in chosen]
        if all(abs(place[0] - x) > _WIDE + 16 or abs(place[1] - y) > _HIGH + 30 for x, y in others):
            chosen.append(row)
    step = -(-len(chosen) // _PORTRAITS)
    return chosen[::step] if chosen else []


def _portrait(chart: Chart, row: Origin, portrait: Portrait) -> list[str]:
    """Draws a candidate beside its point, towards the middle of the plane."""
    x, y = chart.x(row.objectives[0]), chart.y(row.objectives[1])
    left = min(max(x - _WIDE - 14, chart.left + 4), chart.left + chart.plane_width - _WIDE)
    top = min(max(y + 12, chart.top), chart.top + chart.plane_height - _HIGH - 4)
    plate = f'x="{left:.1f}" y="{top:.1f}" width="{_WIDE}" height="{_HIGH}"'
    return [
        f'<path class="edge" d="M{x:.1f} {y:.1f}L{left + _WIDE / 2:.1f} {top + _HIGH / 2:.1f}"/>',
        f'<rect class="plate" {plate} rx="5"/><image {plate} href="{portrait(row.index, _WIDE, _HIGH)}"/>',
        f'<text class="soft halo" x="{left + _WIDE / 2:.1f}" y="{top + _HIGH + 13:.1f}" text-anchor="middle">'
        f"#{row.index}</text>",
    ]
