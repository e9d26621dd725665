"""A leaderboard as a page for a browser: one file, with a picture of each creature, a film of the best, and its proofs.

Invariants: whatever names, authors and reasons hold, they are text on the page and nothing else. Nothing is fetched to
show it; its links lead to the recordings that lie beside the leaderboard.
"""

from __future__ import annotations

import base64
import io
import os
import shlex
from collections.abc import Callable, Sequence
from hashlib import file_digest
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import quote

from PIL import Image

from nmes.errors import LeaderboardError, NmesError, WorldError
from nmes.evaluation.leaderboard import Leaderboard
from nmes.evaluation.leaderboard_entry import Entry, told
from nmes.evaluation.setting import Setting
from nmes.genome import Genome
from nmes.genome.preview import render_body
from nmes.recording import Recording
from nmes.view.chart import text
from nmes.view.film import Cut, film

__all__ = ["write_page"]

_SIZE = (240, 180)  # of a picture, pixels
_COLORS = 48  # of its palette: a third of the bytes
_SECONDS, _FPS = 5.0, 10  # of a film
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
.score {{ float: right; text-align: right; font-variant-numeric: tabular-nums; font-weight: 600; }}
.score small {{ display: block; font-weight: 400; }}
code {{ font-size: .8em; }}
pre {{ border: 1px solid var(--line); border-radius: .4rem; padding: .6rem .8rem; overflow-x: auto; }}
</style>
</head>
<body>
<h1>{title}</h1>
<p class="soft">Every score was computed from a recording that was run again, tick by tick. {count}</p>
{tasks}
<h2>Check it yourself</h2>
<p>With the leaderboard <code>{board}</code> and the folder <code>{folder}</code> beside it:</p>
<pre>nmes leaderboard verify {board}
nmes eval --from-recording {folder}/RECORDING.mcap
nmes view {folder}/RECORDING.mcap</pre>
<p>The first runs every recording of every entry again, and says whether all that is listed holds; the second scores one
episode from its log alone; the third shows it. The links <i>seed N</i> lead to the recordings.</p>
</body>
</html>
"""


def write_page(
    board: Leaderboard,
    path: str | os.PathLike[str],
    *,
    task: str | None = None,
    top: int | None = None,
    progress: Callable[[str, int, int], None] = lambda doing, done, total: None,
) -> int:
    """Writes the entries of a leaderboard as HTML; returns how many.

    Args:
        board: The leaderboard.
        path: The file to write.
        task: Only those of the task with this name.
        top: Only so many of each task.
        progress: Called with what is being done, how much of it is done, and how much there is.
    """
    entries = board.entries(task=task, top=top)
    folder = os.path.relpath(board.recordings, Path(path).parent)
    sections: dict[tuple[str, str], list[str]] = {}
    notes: dict[tuple[str, str], str] = {}
    for done, entry in enumerate(entries, start=1):
        items = sections.setdefault(key := (entry.task_title, entry.task_hash), [])
        card = _Card(board, entry, len(items) + 1)
        if not items:
            notes[key] = card.about_task()
        items.append(card.html(folder))
        progress("drawing", done, len(entries))
    parts = [
        f"<h2>{text(name)} <small><code>{digest[:16]}</code></small></h2>\n{notes[name, digest]}"
        f"<ol>\n{''.join(items)}</ol>"
        for (name, digest), items in sections.items()
    ]
    count = f"{len(entries):,} {'entry' if len(entries) == 1 else 'entries'}."
    page = _PAGE.format(
        title=text(board.path.stem),
        board=text(shlex.quote(board.path.name)),
        folder=text(shlex.quote(board.recordings.name)),
        count=count,
        tasks="\n".join(parts),
    )
    Path(path).write_text(page, encoding="utf-8")
    return len(entries)


class _Card:
    """What a page shows of one entry; the first of a task is filmed."""

    def __init__(self, board: Leaderboard, entry: Entry, rank: int) -> None:
        self._board, self._entry, self._rank = board, entry, rank
        self._task: Setting | None = None
        self._picture = ""
        try:
            self._draw()
        except (NmesError, OSError) as error:  # a file was edited by hand, or is gone
            self._picture = f"<div>no picture: {text(str(error))}</div>"

    def _draw(self) -> None:
        path = self._board.recording(self._entry.recordings[0])
        if not path.is_file():  # a pipe or a device would never end
            raise LeaderboardError("changed", f"there is no recording {path.name}")
        with path.open("rb") as file:
            if file_digest(file, "sha256").hexdigest() != self._entry.recordings[0]:
                raise LeaderboardError("changed", f"{path.name} is not the recording that was listed")
        recording = Recording(path)
        genomes = self._board.genomes(self._entry)
        self._task = told(path)[0]
        moving = _film(recording, self._task) if self._rank == 1 else None
        if moving is None:
            still = io.BytesIO()
            _drawn(genomes).quantize(_COLORS).save(still, "PNG", optimize=True)
            self._picture = self._image("png", still.getvalue())
        else:
            self._picture = self._image("gif", moving)

    def _image(self, kind: str, data: bytes) -> str:
        size = f'width="{_SIZE[0]}" height="{_SIZE[1]}"'
        source = f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
        return f'<img {size} alt="{text(self._entry.name)}" src="{source}">'

    @property
    def _unit(self) -> str:
        """The unit of the score with a space before it; empty where the task says none."""
        unit = "" if self._task is None else str(self._task.document.get("unit", ""))
        return f" {unit}" if unit else ""

    def about_task(self) -> str:
        """Returns the task's description, as HTML."""
        if self._task is None or self._task.hash != self._entry.task_hash:
            return ""
        unit = f" Scores are in{text(self._unit)}." if self._unit else ""
        return f"<p>{text(self._task.description)}{unit}</p>\n"

    def html(self, folder: str) -> str:
        """Returns the card; `folder` is where the recordings are, from the page."""
        entry = self._entry
        by = f" by {text(entry.signed_author)}" if entry.signed_author else ""
        proofs = ", ".join(
            f'<a href="{text(quote(f"{folder}/{recording}.mcap"))}">{self._seed(place)}</a>'
            for place, recording in enumerate(entry.recordings)
        )
        hashes = f"genome <code>{entry.genome_hash[:16]}</code>, recording <code>{entry.recording_hash[:16]}</code>"
        score = f"{entry.score:.6g}{text(self._unit)}<small>± {entry.spread:.3g}</small>"
        return (
            f'<li>{self._picture}<div><span class="score">{score}</span>'
            f"<b>{self._rank}. {text(entry.title)}</b>{by}<br><small>{hashes}<br>recorded {text(entry.recorded[:10])}"
            f"<br>proofs: {proofs}</small></div></li>\n"
        )

    def _seed(self, place: int) -> str:
        """Returns the seed of a recording, as a link is called."""
        seeds = () if self._task is None else self._task.seeds
        each = max(len(self._entry.recordings) // max(len(seeds), 1), 1)  # of matches, from how many sides
        if place >= each * len(seeds):
            return f"recording {place + 1}"
        return f"seed {seeds[place // each]}" + (f", side {place % each + 1}" if each > 1 else "")


def _drawn(genomes: Sequence[Genome]) -> Image.Image:
    """Returns a picture of creatures, side by side."""
    width, height = _SIZE
    picture = Image.new("RGB", _SIZE)
    for place, genome in enumerate(genomes):
        left, right = width * place // len(genomes), width * (place + 1) // len(genomes)
        picture.paste(Image.fromarray(render_body(genome.body, right - left, height)), (left, 0))
    return picture


def _film(recording: Recording, task: Setting) -> bytes | None:
    """Returns the first seconds of an episode as a GIF; None where this machine cannot draw."""
    with TemporaryDirectory() as folder:
        path, begin = Path(folder, "film.gif"), task.settle_ticks / task.tick_rate
        try:
            film([recording], path, Cut(begin=begin, end=begin + _SECONDS), titles=[""], fps=_FPS, size=_SIZE)
        except WorldError as error:
            if error.code != "unsupported":
                raise
            return None
        return path.read_bytes()
