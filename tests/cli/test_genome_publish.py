"""`nmes genome publish` writes a folder that a stranger can check with one command."""

from __future__ import annotations

import json
import re
import shlex
import sys
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from boards import DASH
from command_line import run
from creatures import SINE, cpg, snake
from nmes.genome import Genome
from opengl import OPENGL

TASK: dict[str, Any] = {**DASH, "unit": "m"}


@pytest.fixture
def inputs(tmp_path: Path) -> tuple[Path, Path]:
    """A genome whose words are written to disturb a page, and a task."""
    genome, task = tmp_path / "mine.json", tmp_path / "dash.json"
    words = {"name": "<b>wave</b>", "author": "Ada | `rm`", "license": "CC0-1.0", "description": "Waves.\n# Big"}
    genome.write_text(json.dumps({**snake(SINE), **words}))
    task.write_text(json.dumps(TASK))
    return genome, task


def test_one_command_of_its_page_checks_a_published_creature(
    inputs: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    genome, task = inputs
    folder = tmp_path / "published"
    done = run("genome", "publish", genome, "--task", task, "-o", folder)
    assert done.exit_code == 0, done.output
    names = {path.name for path in folder.iterdir()}
    recordings = sorted(name for name in names if name.endswith(".mcap"))
    films = {"film.mp4"} if OPENGL else set()
    assert names == {"README.md", "genome.json", "task.json", "picture.png", *films, *recordings}
    assert len(recordings) == 2 and all((folder / name).stat().st_size > 1000 for name in films)
    assert Genome.load(folder / "genome.json").hash == Genome.load(genome).hash
    with Image.open(folder / "picture.png") as picture:
        assert picture.size == (720, 540)
    page = (folder / "README.md").read_text()
    # In the folder, as a stranger has it; a shell would put in the names.
    (line,) = re.findall(r"^\$ nmes (.*)$", page, flags=re.MULTILINE)
    monkeypatch.chdir(folder)
    words = [name for word in shlex.split(line) for name in (recordings if word == "*.mcap" else [word])]
    checked = run(*words, "--json")
    (evaluation,) = json.loads(checked.stdout)
    assert checked.exit_code == 0
    assert f"**{evaluation['score']:.6g} m**" in page and evaluation["genome_hash"] in page
    for result in evaluation["results"]:
        assert f"| {result['seed']} | {result['score']:.6g} |" in page
    assert "<b>" not in page and "\n# Big" not in page and "Ada \\| \\`rm\\`" in page


def test_without_the_extra_there_is_no_film(
    inputs: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    done = run("genome", "publish", inputs[0], "--task", inputs[1], "-o", tmp_path / "published")
    assert done.exit_code == 0 and "no film: " in done.stderr and "nmes[film]" in done.stderr
    assert not (tmp_path / "published" / "film.mp4").exists()
    assert "film" not in (tmp_path / "published" / "README.md").read_text()


def test_what_has_no_score_or_no_place_is_not_published(inputs: tuple[Path, Path], tmp_path: Path) -> None:
    genome, task = inputs
    (tmp_path / "still.json").write_text(json.dumps({**snake(cpg(4)), "brain": {"kind": "sine", "oscillators": [{}]}}))
    limited = tmp_path / "limited.json"
    limited.write_text(json.dumps({**TASK, "limits": {"cubes": 1}}))
    walk = tmp_path / "walk.json"
    walk.write_text(json.dumps({**TASK, "name": "walk"}))
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "file").touch()
    cases: list[tuple[list[str | Path], int, str]] = [
        ([tmp_path / "still.json", "--task", task, "-o", tmp_path / "x"], 1, "brain/oscillators/0"),
        ([genome, "--task", limited, "-o", tmp_path / "x"], 1, "at most 1"),
        ([genome, "--task", walk, "-o", tmp_path / "x"], 2, "another task than the walk that ships"),
        ([genome, "--task", "wlak", "-o", tmp_path / "x"], 2, "did you mean walk?"),
        (["walkr", "--task", task, "-o", tmp_path / "x"], 2, "did you mean walker?"),
        ([genome, "--task", task, "-o", tmp_path / "taken"], 2, "there is"),
    ]
    for arguments, status, word in cases:
        refused = run("genome", "publish", *arguments)
        assert refused.exit_code == status and word in refused.stderr, refused.output
        assert not (tmp_path / "x").exists()
    assert [path.name for path in (tmp_path / "taken").iterdir()] == ["file"]
