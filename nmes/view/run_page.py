"""A run as a page for a browser: one file with all its pictures, and nothing to fetch.

Invariants: the page is whole without a script; whatever names and expressions hold, they are text on it and nothing
else.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from nmes.evolution.history import History
from nmes.view.chart import STYLE, Picture, number, text
from nmes.view.run_pictures import Portraits
from nmes.view.run_summary import RunSummary

__all__ = ["facts_list", "figure", "page", "write_page"]

_WIDE, _HIGH = 200, 150  # of a portrait of the ten best, pixels
_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
:root {{ color-scheme: light dark; --line: #d8dee4; --soft: #59636e; --plate: #e6eaef; }}
body {{ font: 16px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 64rem; padding: 0 1rem;
 background: #fff; color: #1f2328; }}
h1 {{ overflow-wrap: anywhere; }}
h2 {{ margin-top: 2.5rem; }}
.soft, figcaption {{ color: var(--soft); }}
dl {{ display: grid; grid-template-columns: max-content 1fr; gap: .25rem 1.25rem; }}
dt {{ color: var(--soft); }}
dd {{ margin: 0; overflow-wrap: anywhere; }}
figure {{ margin: 1rem 0; overflow-x: auto; }}
figure svg {{ display: block; width: 100%; height: auto; }}
.large:checked ~ .map svg {{ width: 160rem; }}
ol {{ list-style: none; padding: 0; display: grid; grid-template-columns: repeat(auto-fill, minmax(11rem, 1fr));
 gap: 1rem; }}
li {{ border: 1px solid var(--line); border-radius: .6rem; overflow: hidden; }}
li img {{ display: block; width: 100%; height: auto; background: var(--plate); }}
li div {{ padding: .4rem .8rem .6rem; overflow-wrap: anywhere; }}
.score {{ float: right; font-variant-numeric: tabular-nums; font-weight: 600; }}
.scroll {{ overflow-x: auto; }}
table {{ border-collapse: collapse; }}
th, td {{ padding: .25rem .9rem .25rem 0; text-align: right; font-variant-numeric: tabular-nums; }}
th:first-child, td:first-child {{ text-align: left; }}
th {{ font-weight: 600; border-bottom: 1px solid var(--line); }}
@media (prefers-color-scheme: dark) {{
 :root {{ --line: #30363d; --soft: #9aa4af; --plate: #c3cad2; }}
 body {{ background: #0d1117; color: #e6edf3; }}
}}
{style}
</style>
</head>
<body>
<h1>{title}</h1>
{parts}
</body>
</html>
"""


def write_page(summary: RunSummary, path: Path, pictures: Iterable[Picture], portraits: Portraits) -> None:
    """Writes a page of a run.

    Args:
        summary: Of the run.
        path: The file.
        pictures: The run's, as `nmes.view.run_pictures.draw_run` gives them.
        portraits: Of its candidates.
    """
    parts = [facts_list(summary.facts()), *map(figure, pictures), _top(summary, portraits)]
    parts += ["<h2>Operators</h2>", _operators(summary.history), "<h2>Settings</h2>", facts_list(summary.settings())]
    path.write_text(page(summary.title, parts), encoding="utf-8")


def page(title: str, parts: Sequence[str]) -> str:
    """Returns a whole page of some parts, which are HTML; the title is text."""
    return _PAGE.format(title=text(title), style=STYLE, parts="\n".join(parts))


def facts_list(facts: Sequence[tuple[str, str]]) -> str:
    """Returns names and values as a list on a page."""
    rows = "\n".join(f"<dt>{text(name)}</dt><dd>{text(value)}</dd>" for name, value in facts)
    return f"<dl>\n{rows}\n</dl>"


def figure(picture: Picture) -> str:
    """Returns a picture with its title and what can be seen in it; small things can be enlarged."""
    head, shown = f"<h2>{text(picture.title)}</h2>", f"{picture.element()}\n<figcaption>{text(picture.description)}"
    if not picture.fine:
        return f"{head}\n<figure>{shown}</figcaption></figure>"
    box = f'<input type="checkbox" class="large" id="large-{picture.name}">'
    label = f'<label for="large-{picture.name}">large, to be moved about</label>'
    return f'<section>{head}\n{box}{label}\n<figure class="map">{shown}</figcaption></figure></section>'


def _top(summary: RunSummary, portraits: Portraits) -> str:
    """Returns the best candidates, each with its portrait."""
    items = []
    for rank, row in enumerate(summary.top, 1):
        size = f'width="{_WIDE}" height="{_HIGH}"'
        image = f'<img {size} alt="Candidate {row.index}" src="{portraits(row.index, _WIDE, _HIGH)}">'
        origin = f"generation {row.generation}, {row.operator}"
        origin = f"{row.group}, {origin}" if summary.champions else origin
        items.append(
            f'<li>{image}<div><b>{rank}</b> <span class="score">{number(row.score)}</span><br>'
            f'<span class="soft">#{row.index}, {text(origin)}</span></div></li>'
        )
    return f"<h2>{summary.outcome.capitalize()}</h2>\n<ol>\n" + "\n".join(items) + "\n</ol>"


def _operators(history: History) -> str:
    rows = [
        f"<tr><td>{text(each.name)}</td><td>{each.candidates:,}</td><td>{each.better:,}</td>"
        f"<td>{each.champions:,}</td><td>{each.without_score:,}</td></tr>"
        for each in history.operators()
    ]
    titles = ("operator", "candidates", "better than the parent", "best so far", "without a score")
    head = "".join(f'<th scope="col">{title}</th>' for title in titles)
    return (
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>\n'
        + "\n".join(rows)
        + "\n</tbody></table></div>"
    )
