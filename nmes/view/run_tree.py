"""The lineage of a candidate as a picture: who it comes from, by which operators, each with a portrait.

A line of descent is as long as the run had patience. So it is told like a story in pictures, row by row, by those who
got further than all before them in the line; what lies between two of them is counted on the edge between them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from nmes.evolution.history import History, Origin, milestones
from nmes.view.chart import WIDTH, Picture, number, short, text

__all__ = ["Portrait", "lineage_tree"]

Portrait = Callable[[int, int, int], str]
"""Returns the picture of a candidate, by index, width and height in pixels, as an address that holds all of it."""

_SHOWN = 25  # portraits of the line, at most
_COLUMNS = 5
_WIDE, _HIGH = 108, 81  # of a portrait, pixels
_SMALL = (48, 36)  # of the other parent's
_ROW = 166  # from one row to the next
_STEP = WIDTH / _COLUMNS
_LINES = 3  # of text below an edge


def lineage_tree(history: History, index: int, portrait: Portrait) -> Picture:
    """Returns the line of descent of a candidate, from the eldest on, with the other parents of those bred from two."""
    line = history.lineage(index)
    shown = milestones(line, _SHOWN)
    parts = []
    for place, row in enumerate(shown):
        left, top = place % _COLUMNS * _STEP, place // _COLUMNS * _ROW
        if place:
            begin = line.index(shown[place - 1]) + 1
            parts += _edge(line[begin : line.index(row) + 1], left, top, portrait)
        parts += _node(row, left + _STEP - _WIDE - 4, top + 24, portrait, last=row is shown[-1])
    rows = -(-len(shown) // _COLUMNS)
    eldest = shown[0]
    told = f"Candidate {index}, with score {number(line[-1].score)}, "
    if len(line) == 1:
        told += f"has no parents: it came about by {eldest.operator}."
    else:
        steps = "1 step" if len(line) == 2 else f"{len(line) - 1} steps"
        told += f"comes from candidate {eldest.index} ({eldest.operator}) in {steps}"
        told += "." if len(shown) == len(line) else f", of which {len(shown) - 1} that gained are shown."
    return Picture("lineage", f"Where candidate {index} comes from", told, WIDTH, rows * _ROW, "\n".join(parts))


def _node(row: Origin, x: float, y: float, portrait: Portrait, *, last: bool) -> list[str]:
    """Draws a candidate, its index and its score; (x, y) is the upper left corner."""
    middle = x + _WIDE / 2
    name = f"candidate {row.index}, score {number(row.score)}"
    box = f'x="{x}" y="{y}" width="{_WIDE}" height="{_HIGH}" rx="6"'
    return [
        f'<g><title>{name}, {text(row.operator)}</title><rect class="plate" {box}/>',
        *([f'<rect class="s1" stroke-width="3" {box}/>'] if last else []),
        _image(portrait(row.index, _WIDE, _HIGH), x, y, _WIDE, _HIGH),
        f'<text class="ink" x="{middle}" y="{y + _HIGH + 16}" text-anchor="middle" font-weight="600">'
        f"{number(row.score)}</text>",
        f'<text class="soft" x="{middle}" y="{y + _HIGH + 31}" text-anchor="middle">#{row.index}</text></g>',
    ]


def _image(source: str, x: float, y: float, width: float, height: float) -> str:
    return f'<image x="{x}" y="{y}" width="{width}" height="{height}" href="{source}"/>'


def _edge(steps: Sequence[Origin], x: float, y: float, portrait: Portrait) -> list[str]:
    """Draws the arrow to a candidate from the one before it, with what changed on the way, and who else had part."""
    level, end = y + 24 + _HIGH / 2, x + _STEP - _WIDE - 8
    parts = [f'<path class="edge" d="M{x + 2} {level}H{end}m-7 -4l7 4l-7 4"/>']
    middle = (x + end) / 2
    for line, words in enumerate(_changes(steps)):
        place = f'x="{middle}" y="{level + 14 + 13 * line}" text-anchor="middle" font-size="10"'
        parts.append(f'<text class="soft" {place}>{text(words)}</text>')
    others = [parent for row in steps for parent in row.parents[1:]]
    if others:
        width, height = _SMALL
        left, top = middle - width / 2, level - height - 6
        more = f" +{len(others) - 1}" if len(others) > 1 else ""
        parts += [
            f'<rect class="plate" x="{left}" y="{top}" width="{width}" height="{height}" rx="4"/>',
            _image(portrait(others[-1], width, height), left, top, width, height),
            f'<path class="edge" d="M{middle} {top + height}V{level}"/>',
            f'<text class="soft" x="{middle}" y="{top - 4}" text-anchor="middle" font-size="10">'
            f"#{others[-1]}{more}</text>",
        ]
    return parts


def _changes(steps: Sequence[Origin]) -> list[str]:
    """Returns the operators of some steps with how often each was used, as lines; the most frequent first."""
    counts: dict[str, int] = {}
    for name in (name for row in steps for name in row.operator.split("+")):
        counts[name] = counts.get(name, 0) + 1
    names = sorted(counts, key=lambda name: -counts[name])
    words = [short(name, 12) + (f" x{counts[name]}" if counts[name] > 1 else "") for name in names]
    left = sum(counts[name] for name in names[_LINES - 1 :])
    return words if len(words) <= _LINES else [*words[: _LINES - 1], f"{left} others"]
