"""Pictures of a run over time: scores with bands, and how many candidates each species or emitter had."""

from __future__ import annotations

from collections.abc import Sequence

from nmes.evolution.history import History, Window
from nmes.view.chart import SERIES, WIDTH, Chart, Picture, number, short, text

__all__ = ["fitness_curves", "groups_over_time"]

_SHOWN = len(SERIES) - 1  # groups with a colour of their own; the last is for all others
_POINTS = 400  # of a line, at most
_LEGEND = 190  # pixels
_LINE = 18  # of a legend, pixels


def fitness_curves(history: History, what: str) -> Picture:
    """Returns the scores of a run: the best so far, and the median of windows with their quartiles as a band.

    Args:
        history: Of a run in which one candidate or more has a score.
        what: What a score is, for its axis.
    """
    champions, windows = history.champions(), history.windows()
    bands = [window for window in windows if window.quartiles is not None]
    best = [(row.index + 1, row.score) for row in champions if row.score is not None]
    lows = [window.quartiles[0] for window in bands if window.quartiles is not None]
    values = [score for _, score in best] + lows
    count = len(history.rows)
    chart = Chart((0, count), (min(values), max(values)), right=_LEGEND)
    parts = list(chart.axes("candidates evaluated", what))
    parts += _band(chart, bands)
    steps = [
        place
        for (index, score), after in zip(best, [*best[1:], (count, 0.0)], strict=True)
        for place in ((index, score), (after[0], score))
    ]
    parts.append(f'<polyline class="s1" stroke-width="2" points="{chart.path(steps)}"/>')
    index, score = best[-1]
    parts.append(f'<circle class="f1" cx="{chart.x(index):.1f}" cy="{chart.y(score):.1f}" r="4"/>')
    names = [("f1", "best so far", 1.0), ("f0", "median", 1.0), ("f0", "half of all", 0.25)]
    parts += _legend(names if bands else names[:1])
    told = f"The best score rises from {number(best[0][1])} to {number(score)}, which candidate {index - 1} reached."
    return Picture("scores", "Scores", told, chart.width, chart.height, "\n".join(parts))


def _band(chart: Chart, windows: Sequence[Window]) -> list[str]:
    """Returns the median of windows as a line and their quartiles as a band; where there is none, none."""
    low: list[tuple[float, float]] = []
    middle: list[tuple[float, float]] = []
    high: list[tuple[float, float]] = []
    for window in windows:
        assert window.quartiles is not None
        place = (window.begin + window.end) / 2
        for line, value in zip((low, middle, high), window.quartiles, strict=True):
            line.append((place, value))
    if not middle:
        return []
    return [
        f'<polygon class="f0" opacity="0.25" points="{chart.path([*low, *high[::-1]])}"/>',
        f'<polyline class="s0" stroke-width="1.5" points="{chart.path(middle)}"/>',
    ]


def _legend(names: Sequence[tuple[str, str, float]]) -> list[str]:
    """Draws the classes of colours, what each stands for, and how opaque it is, on the right."""
    left, parts = WIDTH - _LEGEND + 20, []
    for place, (color, name, opacity) in enumerate(names):
        y = 26 + _LINE * place
        parts.append(f'<rect class="{color}" opacity="{opacity}" x="{left}" y="{y - 10}" width="12" height="12"/>')
        parts.append(f'<text class="ink" x="{left + 18}" y="{y}">{text(short(name, 22))}</text>')
    return parts


def groups_over_time(history: History) -> Picture | None:
    """Returns the parts that species, emitters or islands had of the candidates, stacked; None with fewer than two."""
    windows = history.windows()
    total: dict[str, int] = {}
    for window in windows:
        for name, count in window.groups.items():
            total[name] = total.get(name, 0) + count
    if len(total) < 2:
        return None
    shown = sorted(sorted(total, key=lambda name: (-total[name], name))[:_SHOWN], key=list(total).index)
    chart = Chart((0, len(history.rows)), (0.0, 100.0), right=_LEGEND, height=240)
    parts = list(chart.axes("candidates evaluated", "% of the candidates"))
    floors = [0.0] * len(windows)
    others = [name for name in total if name not in shown]
    for color, names in [*enumerate([name] for name in shown), (len(SERIES) - 1, others)]:
        tops = [low + _percent(window, names) for low, window in zip(floors, windows, strict=True)]
        if tops != floors:
            outline = [*_stairs(windows, floors), *_stairs(windows, tops)[::-1]]
            parts.append(f'<polygon class="f{color}" points="{chart.path(outline)}"/>')
        floors = tops
    legend = [(f"f{place}", name or "none", 1.0) for place, name in enumerate(shown)]
    parts += _legend(legend + ([(f"f{len(SERIES) - 1}", f"{len(others)} others", 1.0)] if others else []))
    largest = max(total, key=total.__getitem__)
    told = f"{len(total)} groups; most candidates, {total[largest]:,}, were of group {largest!r}."
    return Picture("groups", "Species and other groups over time", told, chart.width, chart.height, "\n".join(parts))


def _percent(window: Window, names: Sequence[str]) -> float:
    """Returns the part that some groups had of a window."""
    return 100.0 * sum(window.groups.get(name, 0) for name in names) / (window.end - window.begin)


def _stairs(windows: Sequence[Window], values: Sequence[float]) -> list[tuple[float, float]]:
    return [
        point
        for window, value in zip(windows, values, strict=True)
        for point in ((window.begin, value), (window.end, value))
    ]
