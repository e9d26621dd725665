"""`nmes play`: one episode of a creature, scored and filmed."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from PIL import Image, ImageSequence

from nmes.cli import main
from nmes.evaluation import Task, evaluate
from nmes.genome import Genome


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(main, ["play", *map(str, arguments)])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    if "no OpenGL" in result.output:
        pytest.skip(f"no picture to judge: {result.output}")
    return result.exit_code, result.output


@pytest.fixture
def task(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A task of two seconds with two seeds, in the folder where the command is run."""
    monkeypatch.chdir(tmp_path)
    document = {**Task.load("walk").document, "name": "short", "duration": 2, "seeds": [4, 5]}
    path = tmp_path / "short-walk.json"
    path.write_text(json.dumps(document))
    return path


def test_a_creature_is_scored_and_filmed(task: Path) -> None:
    score = evaluate(Genome.load("walker"), Task.load(task), seeds=[5]).score
    status, output = run("walker", "--task", task, "--seed", 5, "-o", "x.gif", "--size", "64x48")
    assert (status, output) == (0, f"walker on short, seed 5: score {score:.4g}\nwrote x.gif\n")
    assert score is not None and score > 0
    with Image.open("x.gif") as image:
        assert image.size == (64, 48)
        assert 60 < len(list(ImageSequence.Iterator(image))) < 120  # of two seconds and coming to rest


def test_the_film_is_named_after_what_is_seen(task: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    genome = task.with_name("my one.json")
    genome.write_bytes(json.dumps({**Genome.load("roller").document, "name": "../../else"}).encode())
    status, output = run(genome, "--task", task, "--size", "32x32")
    assert (status, output.splitlines()[1]) == (0, "wrote my one-short-walk-4.mp4")
    assert Path("my one-short-walk-4.mp4").stat().st_size > 500
    monkeypatch.setitem(sys.modules, "av", None)
    assert run("walker", "--task", task, "--size", "32x32")[1].endswith("wrote walker-short-walk-4.gif\n")


def test_an_early_end_is_told(task: Path) -> None:
    document = {**json.loads(task.read_text()), "ends": [{"name": "gone", "when": "time > 1"}]}
    task.write_text(json.dumps(document))
    status, output = run("walker", "--task", task, "-o", "x.png", "--size", "32x32")
    assert status == 0 and "(gone after 1.0" in output


def test_a_creature_that_cannot_be_put_to_a_task_leaves_no_film(task: Path) -> None:
    status, output = run("balancer", "--task", "pole", "-o", "x.gif")
    assert status == 1 and output.startswith("Error: balancer cannot be put to pole: the task puts a cube 'pole'")
    assert not Path("x.gif").exists()


def test_wrong_usage_is_explained_before_anything_is_run(task: Path) -> None:
    for arguments, status, words in (
        (["nobody"], 2, "there is no genome 'nobody'"),
        (["walker", "--task", "nothing"], 2, "there is no task 'nothing'"),
        (["walker", "--task", task, "-o", "x.avi"], 1, "a film ends in .mp4 or .gif, a picture in .png"),
        (["walker", "--seed", -1], 2, "-1 is not in the range"),
    ):
        found, output = run(*arguments)
        assert found == status and words in output and "score" not in output
    film = Path("film.gif")
    film.write_text(task.read_text())
    status, output = run("walker", "--task", film, "-o", film)
    assert status == 2 and "film.gif is what is read" in output
    assert film.read_text() == task.read_text()
