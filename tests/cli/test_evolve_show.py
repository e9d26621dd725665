"""`nmes evolve show`, `best` and `film`, run as a person would."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from PIL import Image

from command_line import run
from made_up_runs import SHORT, candidates, genomes, make_run, real
from nmes.cli import main
from nmes.evaluation import Task
from nmes.evolution.run_settings import RunSettings
from nmes.genome import Genome

MEASURES = [
    {"expression": "mass", "low": 0, "high": 1, "cells": 4},
    {"expression": "legs", "low": 0, "high": 1, "cells": 3},
]


def evolve(*arguments: str | Path) -> Result:
    return run("evolve", *arguments)


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of 200 made-up candidates with an archive, objectives and species."""
    folder = tmp_path_factory.mktemp("runs") / "made"
    records = candidates(200, objectives=2, measures=2, groups=3)
    best = [index for index, record in enumerate(records) if record["score"] is not None][-7:]
    settings = {
        "measures": MEASURES,
        "objectives": ["distance", "-energy"],
        "starts": [Genome.load("walker").document],
        "seed": 5,
    }
    make_run(folder, records, elites=best, algorithm="map-elites", options={"window": 16}, **settings)
    return folder


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of four creatures that were really evaluated."""
    folder, task = tmp_path_factory.mktemp("runs") / "walk", Task(SHORT)
    records = [real(genome, task) for genome in genomes()[:4]]
    document = {"format": "nmes-run/1", "task": SHORT, "algorithm": "random", "budget": 9}
    make_run(folder, records, fingerprint=RunSettings.reopen(document).fingerprint(), budget=9)
    return folder


def test_show_draws_a_run_whose_scores_are_as_great_as_numbers_get(tmp_path: Path) -> None:
    records = candidates(40, measures=2)
    for index, record in enumerate(records):
        if record["score"] is not None:
            record["score"] = [-1.7e308, 1.7e308][index % 2]
    settings: dict[str, Any] = {"measures": MEASURES, "starts": [Genome.load("walker").document]}
    make_run(tmp_path / "run", records, elites=[5, 6, 7, 8], algorithm="map-elites", **settings)
    result = evolve("show", tmp_path / "run", "-o", tmp_path / "page")
    assert result.exit_code == 0, result.output
    for picture in ("archive", "scores"):
        assert not re.search(r"[\", ](nan|inf)[\", ]", (tmp_path / "page" / f"{picture}.svg").read_text())


def best_of(folder: Path) -> dict[str, Any]:
    lines = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    best: dict[str, Any] = max(lines, key=lambda line: -9.0 if line["score"] is None else line["score"])
    return best


def test_show_tells_how_far_a_run_is_and_what_came_out(archive: Path) -> None:
    result = evolve("show", archive)
    assert result.exit_code == 0
    best = best_of(archive)
    lines = (archive / "log.jsonl").read_text().splitlines()
    refused = sum(json.loads(line)["score"] is None for line in lines)
    for words in (
        "made: map-elites on short-walk, seed 5",
        f"200 of 1,000, {refused} without a score",
        f"{best['score']:.4g} (candidate {best['index']}: {best['operator']}, generation {best['generation']})",
        json.loads(lines[-1])["digest"],
        "coverage",
        "window=16",
        "mass, 0 to 1 in 4 cells",
        "-energy",
        "walker",
    ):
        assert words in result.output
    counts = [line.split() for line in result.output.splitlines() if line.startswith("add-part ")]
    assert int(counts[0][1]) == sum(json.loads(line)["operator"] == "add-part" for line in lines)


def test_show_as_json_has_the_same(archive: Path) -> None:
    told = json.loads(evolve("show", archive, "--json").stdout)
    best = best_of(archive)
    assert told["best"] == {"index": best["index"], "score": best["score"]}
    assert told["told"] == 200 and told["settings"]["algorithm"] == "map-elites" and len(told["top"]) == 10
    assert told["digest"] in (archive / "log.jsonl").read_text().splitlines()[-1]
    lines = (archive / "log.jsonl").read_text().splitlines()
    operators = [json.loads(line)["operator"] for line in lines]
    assert {record["name"]: record["candidates"] for record in told["operators"]} == {
        name: sum(name in operator.split("+") for operator in operators)
        for name in ("random", "weights", "oscillators", "add-part", "cross", "joint")
    }
    assert len(told["elites"]) == 7


class Page(HTMLParser):
    """Collects what a page fetches, its headings, and what has no name for who cannot see."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.nameless: list[str] = []
        self.scripts = 0
        self.tags: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        attributes = dict(attrs)
        self.tags.append(tag)
        self.scripts += tag == "script"
        self.fetched += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href")]
        if (tag == "img" and not attributes.get("alt")) or (tag == "svg" and "aria-labelledby" not in attributes):
            self.nameless.append(tag)


def test_a_folder_gets_each_picture_and_the_page_of_all_which_needs_nothing_from_elsewhere(
    archive: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "new" / "pictures"
    assert evolve("show", archive, "-o", folder).exit_code == 0
    pictures = {"scores", "lineage", "archive", "front", "groups"}
    files = {f"{name}.{ending}" for name in pictures for ending in ("svg", "png")}
    assert {path.name for path in folder.iterdir()} == {"index.html", *files}
    for name in pictures:
        with Image.open(folder / f"{name}.png") as image:
            box = re.search('viewBox="0 0 ([0-9.]+) ([0-9.]+)"', (folder / f"{name}.svg").read_text())
            assert box is not None and image.size == tuple(2 * round(float(size)) for size in box.groups())
            assert len(image.getcolors(1 << 20) or ()) > 20, "text, at least, has smooth edges"
    text = (folder / "index.html").read_text()
    page = Page(text)
    assert page.scripts == 0 and page.nameless == []
    assert text.count(">made: map-elites on short-walk, seed 5</") == 2  # the page's title, and the first heading
    assert page.fetched and all(address.startswith("data:image/png;base64,") for address in page.fetched)
    assert "http" not in text.replace('xmlns="http://www.w3.org/2000/svg"', "") and "url(" not in text
    assert page.tags.count("svg") == 5 and page.tags.count("img") == 10
    assert all(f'id="{name}-title"' in text for name in pictures) and "prefers-color-scheme: dark" in text


def test_a_page_alone_has_only_what_there_is(walk: Path, tmp_path: Path) -> None:
    assert evolve("show", walk, "-o", tmp_path / "run.html").exit_code == 0
    page = Page((tmp_path / "run.html").read_text())
    assert page.tags.count("svg") == 2 and page.tags.count("img") == 4
    assert [path.name for path in tmp_path.iterdir()] == ["run.html"]


def test_a_run_that_has_not_begun_or_has_no_score_is_shown(tmp_path: Path) -> None:
    make_run(tmp_path / "empty", [])
    assert "0 of 1,000" in evolve("show", tmp_path / "empty").output
    unlucky = [{**record, "score": None} for record in candidates(3)]
    make_run(tmp_path / "unlucky", unlucky)
    shown = evolve("show", tmp_path / "unlucky")
    assert shown.exit_code == 0 and "3 of 1,000, 3 without a score" in shown.output
    for name in ("empty", "unlucky"):
        assert evolve("show", tmp_path / name, "-o", tmp_path / f"{name}.html").exit_code == 0
        assert "<svg" not in (tmp_path / f"{name}.html").read_text()
        for command in (("best",), ("film", "-o", tmp_path / "x.gif")):
            result = evolve(command[0], tmp_path / name, *command[1:])
            assert result.exit_code == 1 and "no candidate" in result.output and "has a score" in result.output
    assert not list(tmp_path.glob("*/best-*")) and not (tmp_path / "x.gif").exists()


def test_a_run_is_shown_while_its_log_is_being_written(archive: Path, tmp_path: Path) -> None:
    make_run(tmp_path / "run", candidates(40))
    log = tmp_path / "run" / "log.jsonl"
    whole = log.read_bytes()
    log.write_bytes(whole + b'{"index":40,"operator":"weig')
    before = {path: path.read_bytes() for path in (tmp_path / "run").iterdir()}
    assert "40 of 1,000" in evolve("show", tmp_path / "run").output
    assert {path: path.read_bytes() for path in (tmp_path / "run").iterdir()} == before


@pytest.mark.parametrize("command", ["show", "best", "film"])
def test_what_is_no_run_is_refused_in_words(command: str, tmp_path: Path) -> None:
    output = ("-o", tmp_path / "out.gif") if command == "film" else ()
    (tmp_path / "empty").mkdir()
    (tmp_path / "damaged").mkdir()
    (tmp_path / "damaged" / "run.json").write_text("{")
    for name in ("nothing", "empty", "damaged"):
        result = evolve(command, tmp_path / name, *output)
        assert result.exit_code == 2 and str(tmp_path / name) in result.output and "Traceback" not in result.output
    assert sorted(path.name for path in tmp_path.iterdir()) == ["damaged", "empty"]


def test_what_strangers_named_is_shown_as_text(tmp_path: Path) -> None:
    hostile = '\x1b[2J<script>alert("x")</script>'
    make_run(tmp_path / "run", [{**record, "operator": hostile, "group": hostile} for record in candidates(30)])
    shown = evolve("show", tmp_path / "run", "-o", tmp_path / "run.html")
    text = (tmp_path / "run.html").read_text() + evolve("show", tmp_path / "run").output + shown.output
    assert "\x1b" not in text and "\\x1b" in text and Page((tmp_path / "run.html").read_text()).scripts == 0


def test_best_writes_a_champion_that_a_leaderboard_takes(walk: Path, tmp_path: Path) -> None:
    key = tmp_path / "key.pem"
    pem = Ed25519PrivateKey.from_private_bytes(bytes(32)).private_bytes(
        Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()
    )
    key.write_bytes(pem)
    told = json.loads(evolve("best", walk, "-o", tmp_path / "champion", "--sign", key, "--json").stdout)
    best = best_of(walk)
    assert (told["index"], told["score"]) == (best["index"], best["score"])
    assert Genome.load(told["files"][0]).document == best["genome"]
    assert len(told["recordings"]) == len(told["signatures"]) == 2
    for line in told["leaderboard"]:
        done = CliRunner().invoke(main, line.replace("board.sqlite", str(tmp_path / "board.sqlite")).split()[1:])
        assert done.exit_code == 0, done.output
    listed = json.loads(CliRunner().invoke(main, ["leaderboard", "show", f"{tmp_path}/board.sqlite", "--json"]).stdout)
    assert [entry["score"] for entry in listed] == [best["score"]] and listed[0]["key"]
    again = evolve("best", walk, "-o", tmp_path / "again")
    assert again.exit_code == 0 and f"candidate {best['index']}" in again.output
    assert "nmes leaderboard add board.sqlite" in again.output


def test_best_is_not_written_over_a_run_or_another_genome(walk: Path, tmp_path: Path) -> None:
    (other := tmp_path / "other").mkdir()
    (other / "genome.json").write_text("{}")
    for folder, said in ((walk, "holds a run"), (other, "another genome.json")):
        before = sorted(folder.iterdir())
        result = evolve("best", walk, "-o", folder)
        assert result.exit_code == 2 and said in result.output
        assert sorted(folder.iterdir()) == before
    assert (other / "genome.json").read_text() == "{}"


def test_best_writes_into_the_run_and_another_candidate_if_asked(walk: Path) -> None:
    told = json.loads(evolve("best", walk, "--index", "1", "--json").stdout)
    assert told["index"] == 1 and Path(told["files"][0]).parent == walk / "best-1"
    assert Genome.load(told["files"][0]).hash == genomes()[1].hash
    result = evolve("best", walk, "--index", "4")
    assert result.exit_code == 2 and "no candidate 4" in result.output
    result = evolve("best", walk, "--cell", "0,0")
    assert result.exit_code == 2 and "no such cell" in result.output
    assert evolve("best", walk, "--index", "1", "--cell", "0").exit_code == 2
    assert evolve("best", walk, "--cell", "a").exit_code == 2


def test_best_of_a_cell_is_its_elite(tmp_path: Path) -> None:
    task = Task(SHORT)
    records = [{**real(genome, task), "measures": [0.1 + 0.3 * i, 0.5]} for i, genome in enumerate(genomes()[:2])]
    make_run(tmp_path / "run", records, elites=(1, 0), algorithm="map-elites", measures=MEASURES)
    told = json.loads(evolve("best", tmp_path / "run", "--cell", "1,1", "-o", tmp_path / "elite", "--json").stdout)
    assert told["index"] == 1
    result = evolve("best", tmp_path / "run", "--cell", "3,2")
    assert result.exit_code == 2 and "is empty" in result.output
    assert evolve("best", tmp_path / "run", "--cell", "4,0").exit_code == 2


@pytest.mark.parametrize("elsewhere", [False, True])
def test_a_score_that_does_not_come_out_again_is_not_proved(tmp_path: Path, elsewhere: bool) -> None:
    record = real(genomes()[0], Task(SHORT))
    record["results"][1]["energy"] += 1e-9
    document = {"format": "nmes-run/1", "task": SHORT, "algorithm": "random", "budget": 9}
    here = RunSettings.reopen(document).fingerprint()
    make_run(tmp_path / "run", [record], fingerprint={**here, "probe": "0ff"} if elsewhere else here, budget=9)
    result = evolve("best", tmp_path / "run", "-o", tmp_path / "champion")
    assert result.exit_code == (3 if elsewhere else 1)
    assert "candidate 0" in result.output and ("other numbers come out" in result.output) == elsewhere
    assert list((tmp_path / "champion").iterdir()) == []


@pytest.mark.parametrize("falsehood", ["score", "a seed is missing"])
def test_a_score_that_does_not_follow_from_its_episodes_is_not_proved(tmp_path: Path, falsehood: str) -> None:
    record = real(genomes()[0], Task(SHORT))
    if falsehood == "score":
        record["score"] += 1.0
    else:
        record |= {"results": record["results"][:1], "score": record["results"][0]["score"]}
    document = {"format": "nmes-run/1", "task": SHORT, "algorithm": "random", "budget": 9}
    make_run(tmp_path / "run", [record], fingerprint=RunSettings.reopen(document).fingerprint(), budget=9)
    result = evolve("best", tmp_path / "run", "-o", tmp_path / "champion")
    assert result.exit_code == 1 and "candidate 0" in result.output
    assert list((tmp_path / "champion").iterdir()) == []


def test_a_film_shows_the_champions(walk: Path, tmp_path: Path) -> None:
    result = evolve("film", walk, "-o", tmp_path / "film.gif", "--size", "160x120", "--fps", "2")
    if "no OpenGL that works without a display" in result.output:
        pytest.skip(f"no picture to judge: {result.output}")
    assert result.exit_code == 0
    scores = [json.loads(line)["score"] for line in (walk / "log.jsonl").read_text().splitlines()]
    champions = [i for i, score in enumerate(scores) if score is not None and score > max([-9.0, *scores[:i]])]
    assert re.findall(r"\d+", result.output.rpartition("candidates")[2]) == [str(index) for index in champions]
    assert (tmp_path / "film.gif").stat().st_size > 1000


def test_outputs_that_cannot_be_are_refused_before_the_work(
    walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nmes.view.run_film.record_candidate", None)
    for name, words in (("film.txt", ".mp4 or .gif"), ("nowhere/film.gif", "no folder")):
        result = evolve("film", walk, "-o", tmp_path / name)
        assert result.exit_code == 1 and words in result.output
    before = (walk / "log.jsonl").read_bytes()
    for command in ("show", "best"):
        result = evolve(command, walk, "-o", walk / "log.jsonl")
        assert result.exit_code == 2 and "log.jsonl" in result.output
    assert (walk / "log.jsonl").read_bytes() == before


def test_the_words_of_a_run_come_without_delay(tmp_path: Path) -> None:
    """Of 10,000 candidates in under 2 s of a core: here, that no genome is read and that nothing is done twice."""
    make_run(tmp_path / "run", candidates(300))
    code = (
        "import sys\nfrom nmes.genome import Genome\nfrom nmes.cli import main\n"
        "Genome.__init__ = None\nmain(['evolve', 'show', sys.argv[1]])"
    )
    shown = subprocess.run([sys.executable, "-c", code, tmp_path / "run"], capture_output=True, text=True)
    assert shown.returncode == 0 and "300 of 1,000" in shown.stdout, shown.stderr
