"""A leaderboard as a page for a browser: one file, with a picture of each creature and nothing to fetch.

Invariant: whatever names, authors and reasons hold, they are text on the page and nothing else.
"""

from __future__ import annotations

import base64
import io
import os
from html import escape
from pathlib import Path

from PIL import Image

from nmes.errors import NmesError, visible
from nmes.evaluation.leaderboard import Leaderboard
from nmes.evaluation.leaderboard_entry import Entry
from nmes.genome.preview import render_body

__all__ = ["write_page"]

_WIDTH, _HEIGHT = 240, 180  # of a picture, pixels
_COLORS = 48  # of its palette: a third of the bytes
_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
:root {{ color-scheme: light dark; --line: #8884; --soft: #888; }}
body {{ font: 16px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 76rem; padding: 0 1rem; }}
h2 {{ margin-top: 2.5rem; }}
small, .soft {{ color: var(--soft); }}
ol {{ list-style: none; padding: 0; display: grid; grid-template-columns: repeat(auto-fill, minmax(15rem, 1fr));
 gap: 1rem; }}
li {{ border: 1px solid var(--line); border-radius: .6rem; overflow: hidden; }}
li img {{ display: block; width: 100%; height: auto; }}
li div {{ padding: .6rem .8rem; overflow-wrap: anywhere; }}
.score {{ float: right; font-variant-numeric: tabular-nums; font-weight: 600; }}
code {{ font-size: .8em; }}
</style>
</head>
<body>
<h1>{title}</h1>
<p class="soft">Every score was computed from a recording that was run again, tick by tick. {count}</p>
{tasks}
</body>
</html>
"""


def write_page(
    board: Leaderboard, path: str | os.PathLike[str], *, task: str | None = None, top: int | None = None
) -> int:
    """Writes the entries of a leaderboard as HTML; returns how many.

    Args:
        board: The leaderboard.
        path: The file to write.
        task: Only those of the task with this name.
        top: Only so many of each task.
    """
    entries = board.entries(task=task, top=top)
    sections: dict[tuple[str, str], list[str]] = {}
    for entry in entries:
        items = sections.setdefault((entry.task_title, entry.task_hash), [])
        items.append(_item(entry, len(items) + 1, _picture(entry, board)))
    parts = [
        f"<h2>{_text(name)} <small><code>{digest[:16]}</code></small></h2>\n<ol>\n{''.join(items)}</ol>"
        for (name, digest), items in sections.items()
    ]
    count = f"{len(entries):,} {'entry' if len(entries) == 1 else 'entries'}."
    page = _PAGE.format(title=_text(board.path.stem), count=count, tasks="\n".join(parts))
    Path(path).write_text(page, encoding="utf-8")
    return len(entries)


def _text(text: str) -> str:
    return escape(visible(text), quote=True)


def _item(entry: Entry, rank: int, picture: str) -> str:
    by = f" by {_text(entry.signed_author)}" if entry.signed_author else ""
    hashes = f"genome <code>{entry.genome_hash[:16]}</code>, recording <code>{entry.recording_hash[:16]}</code>"
    return (
        f'<li>{picture}<div><span class="score">{entry.score:.6g}</span>'
        f"<b>{rank}. {_text(entry.name)}</b>{by}<br><small>{hashes}<br>recorded {_text(entry.recorded[:10])}</small>"
        "</div></li>\n"
    )


def _picture(entry: Entry, board: Leaderboard) -> str:
    try:
        body = board.genome(entry).body
    except (NmesError, OSError) as error:  # a file was edited by hand, or is gone
        return f"<div>no picture: {_text(str(error))}</div>"
    image = Image.fromarray(render_body(body, _WIDTH, _HEIGHT)).quantize(_COLORS)
    file = io.BytesIO()
    image.save(file, "PNG", optimize=True)
    source = base64.b64encode(file.getvalue()).decode()
    size = f'width="{_WIDTH}" height="{_HEIGHT}"'
    return f'<img {size} alt="{_text(entry.name)}" src="data:image/png;base64,{source}">'
