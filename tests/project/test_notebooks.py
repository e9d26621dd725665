"""What a notebook shows of genomes, tasks, evaluations and recordings: small, and no markup of a stranger."""

from __future__ import annotations

import base64
import json
import re
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

import nmes
from creatures import snake
from nmes.evaluation import Evaluation, Result

EVIL = "<img src=x onerror=alert(1)>\u202e\"'&\n</td></table><script>"
TASK = {
    "format": "nmes-task/1",
    "name": "short",
    "description": EVIL,
    "duration": 0.1,
    "objective": "displacement.x < 1 ? 1.0 : 2.0",
    "seeds": [3],
    "limits": {"cubes": 8},
    "ends": [{"name": "far", "when": "displacement.x > 5 && 1 < 2"}],
}
TAGS = {"div", "p", "b", "table", "tr", "td", "img"}


class Shown(HTMLParser):
    """Reads HTML, of which every tag must be one of ours and closed."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text, self.pictures = "", list[bytes]()
        self.feed(html)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert tag in TAGS and {name for name, _ in attrs} <= {"style", "src", "alt"}
        if tag == "img":
            kind, _, data = (dict(attrs)["src"] or "").partition(",")
            assert kind == "data:image/png;base64"
            self.pictures.append(base64.b64decode(data))
        else:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += f" {data}"


def shown(value: Any) -> Shown:
    html = value._repr_html_()
    assert len(html) < 40_000
    return Shown(html)


def test_a_genome_shows_its_body_and_what_it_is_made_of() -> None:
    genome = nmes.Genome(snake(name="snake <b>&"))
    page = shown(genome)
    for fact in ("Genome snake <b>&", "cubes 4", "motors 3", "brain sine", genome.hash[:16]):
        assert fact in re.sub(r"\s+", " ", page.text)
    assert page.pictures == [genome._repr_png_()]
    picture = Image.open(BytesIO(page.pictures[0]))
    assert picture.format == "PNG" and picture.size == (480, 360) and len(picture.getcolors(1 << 20) or ()) > 50
    without = {name: value for name, value in snake().items() if name != "brain"}
    assert "brain none" in re.sub(r"\s+", " ", shown(nmes.Genome(without)).text)


@pytest.mark.parametrize("name", nmes.Task.names())
def test_every_task_that_ships_shows_what_is_asked(name: str) -> None:
    task = nmes.Task.load(name)
    text = shown(task).text
    assert task.description[:300] in text and task.name in text and task.hash[:16] in text


def test_an_evaluation_shows_each_seed_and_no_markup_of_a_stranger() -> None:
    results = tuple(Result(seed, seed / 3, 1.5, 0.25, 60, None, EVIL if seed == 2 else None) for seed in range(300))
    page = shown(Evaluation(EVIL, "ab", EVIL, "cd", results, EVIL * 1000))
    assert "0.333333" in page.text and "and 280 more" in page.text
    assert "\\u202e" in page.text and "onerror=alert(1)" in page.text  # as text
    assert "score" in shown(nmes.evaluate(snake(), {**TASK, "settle_limit": 2})).text


def test_a_task_and_a_recording_of_a_stranger_show_no_markup(tmp_path: Path) -> None:
    task = nmes.Task(TASK)
    text = shown(task).text
    assert "displacement.x > 5 && 1 < 2" in text and "<script>" in text
    found = nmes.evaluate(snake(), {**TASK, "settle_limit": 2}, record=tmp_path)
    recording = nmes.Recording(found.recordings[0])
    text = shown(recording).text
    assert recording.path.name in text and "mujoco" in text and nmes.Genome(snake()).hash in text
    assert repr(recording) == f"Recording({str(recording.path)!r})"
    recording.config["name"] = EVIL
    assert json.dumps(EVIL)[1:5] in shown(recording).text


def test_a_result_without_score_shows_why() -> None:
    page = shown(nmes.evaluate(snake(segments=9), TASK))
    assert "9 cubes, at most 8 are allowed" in page.text
