"""The figures of a study: each run of each arm as a dot, with the interquartile mean and its interval."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from nmes.backend import Array
from nmes.schemas.documents import canonical_hash
from nmes.study.claims import arm_numbers
from nmes.study.document import Plan
from nmes.study.results import Results
from nmes.study.statistics import Estimate, estimate, iqm
from nmes.view.chart import Picture, in_reach, number, round_numbers, short, text

__all__ = ["draw_figures"]

_WIDE: Final = 980  # pixels of the picture
_LABEL, _FIGURE, _TOP, _FOOT = 190, 190, 20, 54  # pixels: names at the left, numbers at the right, above, the axis
_ROW: Final = 44  # pixels of an arm
_JITTER: Final = (0.0, -7.0, 7.0, -3.5, 3.5, -10.5, 10.5)  # pixels by which dots are apart that would hide each other


def draw_figures(plan: Plan, results: Results) -> list[Picture]:
    """Returns the figures that a study asks for."""
    pictures = []
    for figure in plan.study.document["figures"]:
        source = plan.study.document["columns"][figure["column"]].partition(" ")[0]
        arms = [arm for arm in plan.study.document["arms"] if source in plan.study.arm_commands(arm)]
        where = figure.get("where", {})
        rows = []
        for arm in arms:
            strata = arm_numbers(plan, results, figure["column"], arm["name"], where)
            if not strata:
                continue  # the arm has no such cells
            asked = {"statistic": "iqm", "column": figure["column"], "arm": arm["name"]}
            asked |= {"where": where} if where else {}
            found = estimate(iqm, [strata], ("study", canonical_hash(asked)))
            rows.append((str(arm["name"]), np.concatenate(strata), found))
        pictures.append(_intervals(figure["name"], figure["title"], figure["unit"], rows))
    return pictures


def _intervals(name: str, title: str, unit: str, rows: Sequence[tuple[str, Array, Estimate]]) -> Picture:
    every = np.concatenate([runs for _, runs, _ in rows])
    steps = round_numbers(float(every.min()), float(every.max()))
    height = _TOP + _ROW * len(rows) + _FOOT
    parts = list(_axis(steps, height, unit))
    for place, (arm, runs, found) in enumerate(rows):
        parts += _row(_TOP + _ROW * place + _ROW / 2, arm, runs, found, steps)
    best = max(rows, key=lambda row: row[2].value)
    told = (
        f"{len(rows)} arms; dots are runs, bars 95 % intervals of the interquartile mean. "
        f"The highest is {best[0]}, {number(best[2].value)} ({number(best[2].low)} to {number(best[2].high)})."
    )
    return Picture(name, title, told, _WIDE, height, "\n".join(parts))


def _x(value: float, steps: Sequence[float]) -> float:
    """Returns the place of a number, pixels from the left."""
    return _LABEL + (_WIDE - _LABEL - _FIGURE) * (in_reach(value) - steps[0]) / (steps[-1] - steps[0])


def _axis(steps: Sequence[float], height: float, unit: str) -> Iterator[str]:
    bottom = height - _FOOT
    for step in steps:
        x = f"{_x(step, steps):.1f}"
        yield f'<path class="grid" d="M{x} {_TOP}V{bottom}"/>'
        yield f'<text class="soft" x="{x}" y="{bottom + 18}" text-anchor="middle">{step:g}</text>'
    middle = _LABEL + (_WIDE - _LABEL - _FIGURE) / 2
    yield f'<text class="ink" x="{middle}" y="{bottom + 40}" text-anchor="middle">{text(short(unit, 90))}</text>'


def _row(y: float, arm: str, runs: Array, found: Estimate, steps: Sequence[float]) -> Iterator[str]:
    name = text(short(arm.replace("_", " "), 26))
    yield f'<text class="ink" x="{_LABEL - 14}" y="{y + 4:.1f}" text-anchor="end">{name}</text>'
    for place, value in enumerate(runs.tolist()):
        level = y + _JITTER[place % len(_JITTER)]
        yield f'<circle class="dots" opacity="0.5" cx="{_x(value, steps):.1f}" cy="{level:.1f}" r="3"/>'
    low, high = _x(found.low, steps), _x(found.high, steps)
    yield f'<path class="s0" stroke-width="3" d="M{low:.1f} {y:.1f}H{high:.1f}"/>'
    yield f'<circle class="f1" cx="{_x(found.value, steps):.1f}" cy="{y:.1f}" r="5"/>'
    told = f"{number(found.value)} ({number(found.low)} to {number(found.high)})"
    yield f'<text class="soft" x="{_WIDE - _FIGURE + 16}" y="{y + 4:.1f}">{told}</text>'
