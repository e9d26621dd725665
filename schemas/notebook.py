"""How data show themselves in a notebook: a small table of facts, with a picture beside it.

Hides HTML, and that names and messages come from strangers: all text is escaped and cut, and nothing is fetched or run.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape

from nmes.errors import visible

__all__ = ["card"]

_LONGEST = 400  # characters of one fact
_ROWS = 20  # of a table


def card(
    title: str,
    facts: Mapping[str, object],
    *,
    picture: bytes | None = None,
    header: Sequence[str] = (),
    rows: Sequence[Sequence[object]] = (),
) -> str:
    """Returns HTML that shows what something is.

    Args:
        title: What it is.
        facts: What is to be said of it, by name; None is left out.
        picture: A PNG.
        header: Of the columns of a table.
        rows: Of the table, of which the first 20 are shown.
    """
    cells = [(f"<b>{_text(name)}</b>", _text(value)) for name, value in facts.items() if value is not None]
    parts = [f"<p><b>{_text(title)}</b></p>", _table(cells)]
    if rows:
        shown = [[f"<b>{_text(name)}</b>" for name in header]]
        shown += [[_text(value) for value in row] for row in rows[:_ROWS]]
        parts.append(_table(shown))
        if len(rows) > _ROWS:
            parts.append(f"<p>and {len(rows) - _ROWS:,} more</p>")
    image = ""
    if picture is not None:
        data = base64.b64encode(picture).decode()
        image = f'<img alt="" src="data:image/png;base64,{data}" style="max-width:240px">'
    return f'<div style="display:flex;gap:1em;align-items:flex-start">{image}<div>{"".join(parts)}</div></div>'


def _table(rows: Sequence[Sequence[str]]) -> str:
    """Returns a table of cells that are HTML already."""
    lines = ("".join(f'<td style="text-align:left">{cell}</td>' for cell in row) for row in rows)
    return "<table>" + "".join(f"<tr>{line}</tr>" for line in lines) + "</table>"


def _text(value: object) -> str:
    if value is None:
        return ""
    text = f"{value:.6g}" if isinstance(value, float) else visible(str(value), keep="\n")
    return escape(text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "...")
