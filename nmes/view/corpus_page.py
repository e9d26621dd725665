"""The best creatures of a corpus as a page for a browser: one file with a picture of each, and nothing to fetch.

Invariant: whatever names and descriptions hold, they are text on it and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from nmes.evolution.corpus import Corpus, CorpusCreature
from nmes.genome import Genome
from nmes.genome.preview import render_cutout
from nmes.view.chart import number, png_source, text
from nmes.view.run_page import facts_list, page

__all__ = ["write_page"]

_WIDE, _HIGH = 200, 150  # of a picture on the page, pixels
_FINE = 1.5  # pixels of a picture for each of the page, across and down
_COLORS = 24


def write_page(
    corpus: Corpus, creatures: Sequence[CorpusCreature], path: Path, progress: Callable[[str, int, int], None]
) -> None:
    """Writes a page.

    Args:
        corpus: The corpus.
        creatures: Those of its creatures that are shown, in its order.
        path: The file.
        progress: Called with what is being done, how much of it is done, and how much there is.

    Raises:
        DocumentError: A genome is none.
    """
    items: dict[str, list[str]] = {digest: [] for digest in corpus.tasks}
    for done, each in enumerate(creatures):
        progress("drawing", done, len(creatures))
        cards = items.setdefault(each.task, [])
        cards.append(_card(corpus, each, len(cards) + 1))
    facts = [
        ("creatures", f"{len(corpus.creatures):,}, of which the best of each task are here"),
        ("tasks", f"{len(corpus.tasks):,}"),
        ("runs", f"{len(corpus.runs):,}"),
        ("digest", corpus.digest),
        ("prove it", "nmes corpus verify"),
        ("take one", "nmes corpus export NAME -o creature.json"),
        ("watch it", "nmes play creature.json --task TASK"),
    ]
    parts = [facts_list(facts), *(_section(corpus, digest, cards) for digest, cards in items.items() if cards)]
    path.write_text(page("A gallery of evolved creatures", parts), encoding="utf-8")


def _section(corpus: Corpus, digest: str, cards: Sequence[str]) -> str:
    """Returns the cards of a task, with what it asks."""
    known = corpus.tasks.get(digest)
    if known is None:
        return f"<h2>{digest[:16]}</h2>\n<ol>\n" + "\n".join(cards) + "\n</ol>"
    task, count = known.task, sum(each.task == digest for each in corpus.creatures)
    unit = f" Scores are in {text(task.unit)}." if task.unit else ""
    about = f'<p class="soft">{text(task.description)}{unit} The best {len(cards)} of {count:,}.</p>'
    return f"<h2>{text(task.name)}</h2>\n{about}\n<ol>\n" + "\n".join(cards) + "\n</ol>"


def _card(corpus: Corpus, each: CorpusCreature, rank: int) -> str:
    """Returns the card of a creature on the page."""
    pixels = render_cutout(Genome(each.genome).body, round(_FINE * _WIDE), round(_FINE * _HIGH))
    name = text(corpus.name_of(each))
    image = f'<img width="{_WIDE}" height="{_HIGH}" alt="{name}" src="{png_source(pixels, _COLORS)}">'
    steps = f"{each.generation:,} {'step' if each.generation == 1 else 'steps'} from a founder"
    return (
        f'<li>{image}<div><b>{rank}</b> <span class="score">{number(each.score)}</span><br>{name}<br>'
        f'<span class="soft">of the line of {text(each.name)}, {steps}</span></div></li>'
    )
