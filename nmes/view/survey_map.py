"""The map of a survey as a picture: a block of squares a task, a square a world, in the colour of its score."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import ceil, sqrt

import numpy as np

from nmes.backend import Image as Pixels
from nmes.objective.means import mean
from nmes.view.chart import Picture, between, number, png_source, text

__all__ = ["Block", "survey_map"]

# Dark to bright, and as bright to who does not see all colours: "viridis" of Matplotlib, every eighth of its length.
_RAMP = (
    (68, 1, 84),
    (71, 44, 122),
    (59, 81, 139),
    (44, 113, 142),
    (33, 144, 141),
    (39, 173, 129),
    (92, 200, 99),
    (170, 220, 50),
    (253, 231, 37),
)
_NOTHING = (150, 156, 164)  # of a world without a score
_WIDE = 1000  # pixels of the picture
_LABEL, _GAP, _WORDS, _HEAD, _FOOT = 104, 12, 22, 44, 76  # pixels
_LARGEST = 180  # pixels of a block, across
_LEAST = 120  # pixels of its squares' picture: smaller ones would be blurred

Block = Sequence["float | None"]
"""The scores of the worlds of a task; None where a world has none."""


def survey_map(blocks: Sequence[Block], rows: Sequence[str], columns: Sequence[str], unit: str) -> Picture:
    """Returns the map of a survey.

    Args:
        blocks: Scores by task, row by row; within a block the best are above.
        rows: What rows have in common.
        columns: What columns have.
        unit: Of scores; empty where they have none.
    """
    scores = sorted(score for block in blocks for score in block if score is not None)
    low, high = (scores[0], scores[-1]) if scores else (0.0, 0.0)
    # A few outliers would leave one colour to all others: the ramp ends where all but one in two hundred are.
    top = scores[-1 - len(scores) // 200] if scores else 0.0
    label = _LABEL if any(rows) else 16
    edge = min(_LARGEST, (_WIDE - label - 16) / len(columns) - _GAP)
    step = edge + _GAP
    parts: list[str] = []
    for place, name in enumerate(columns):
        x = label + place * step + edge / 2
        parts.append(f'<text class="ink" x="{x:.1f}" y="{_HEAD - 12}" text-anchor="middle">{text(name)}</text>')
    for index, block in enumerate(blocks):
        row, column = divmod(index, len(columns))
        x, y = label + column * step, _HEAD + row * (step + _WORDS)
        if not column and rows[row]:
            middle = y + edge / 2 + 4
            parts.append(
                f'<text class="ink" x="{label - 12}" y="{middle:.1f}" text-anchor="end">{text(rows[row])}</text>'
            )
        source = png_source(_squares(block, low, top), 256)
        parts.append(f'<image x="{x:.1f}" y="{y:.1f}" width="{edge:.1f}" height="{edge:.1f}" href="{source}"/>')
        told = text(_told(block, unit))
        parts.append(
            f'<text class="soft" x="{x + edge / 2:.1f}" y="{y + edge + 16:.1f}" text-anchor="middle">{told}</text>'
        )
    height = _HEAD + len(rows) * (step + _WORDS) + _FOOT
    parts += _key(label, height - _FOOT + 16, low, top, high, unit)
    width = max(label + len(columns) * step + 4, 640)
    counted = (
        f"{sum(map(len, blocks)):,} worlds, each a square in the colour of its creature's score, in a block a task."
    )
    return Picture("map", "The worlds of the survey", counted, width, height, "\n".join(parts), fine=True)


def _squares(block: Block, low: float, top: float) -> Pixels:
    """Returns a block as pixels (height, width, 4): a square a world, the best first; without worlds transparent."""
    side = max(1, ceil(sqrt(len(block))))
    pixels: Pixels = np.zeros((side * side, 4), np.uint8)
    scored = sorted((score for score in block if score is not None), reverse=True)
    for place in range(len(block)):
        color = _color(scored[place], low, top) if place < len(scored) else _NOTHING
        pixels[place] = (*color, 255)
    larger = max(1, ceil(_LEAST / side))
    return pixels.reshape(side, side, 4).repeat(larger, axis=0).repeat(larger, axis=1)


def _color(score: float, low: float, top: float) -> tuple[int, int, int]:
    place = min(1.0, between(score, low, top)) * (len(_RAMP) - 1)
    index = min(int(place), len(_RAMP) - 2)
    red, green, blue = (
        round(a + (b - a) * (place - index)) for a, b in zip(_RAMP[index], _RAMP[index + 1], strict=True)
    )
    return red, green, blue


def _told(block: Block, unit: str) -> str:
    scored = [score for score in block if score is not None]
    if not scored:
        return "no scores" if block else "no worlds"
    return f"mean {number(mean(scored))}{_of(unit)}"


def _of(unit: str) -> str:
    return f" {unit}" if unit else ""


def _key(x: float, y: float, low: float, top: float, high: float, unit: str) -> Iterator[str]:
    """Yields what the colours mean, below."""
    steps, wide = 64, 320.0
    for step in range(steps):
        part = step / (steps - 1)
        red, green, blue = _color(low * (1.0 - part) + top * part, low, top)
        place = f'x="{x + wide * step / steps:.2f}" y="{y}" width="{wide / steps + 0.5:.2f}" height="14"'
        yield f'<rect {place} fill="#{red:02x}{green:02x}{blue:02x}"/>'
    beyond = " and more" if top < high else ""
    yield f'<text class="soft" x="{x}" y="{y + 30}">{number(low)}{text(_of(unit))}</text>'
    most = f"{number(top)}{text(_of(unit) + beyond)}"
    yield f'<text class="soft" x="{x + wide}" y="{y + 30}" text-anchor="end">{most}</text>'
    red, green, blue = _NOTHING
    yield f'<rect x="{x + wide + 28}" y="{y}" width="14" height="14" fill="#{red:02x}{green:02x}{blue:02x}"/>'
    yield f'<text class="soft" x="{x + wide + 50}" y="{y + 11}">no score: never at rest, beyond a limit</text>'
