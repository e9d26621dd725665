"""Folders of runs that strangers made: what they hold is judged, and nothing outside of them is read or written."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from command_line import run
from labs import running_lab
from nmes.evaluation import Task
from nmes.evaluation.setting import task_identity
from nmes.evolution.run_log import RunLog, RunWriter
from nmes.evolution.run_settings import RunSettings
from nmes.genome import Genome
from nmes.learning.settings import LearningSettings
from nmes.schemas.documents import canonical_hash, write_json
from nmes.server.kept_worlds import kept_worlds

Json = dict[str, Any]

EVOLUTION: Json = {"format": "nmes-run/1", "task": "walk", "algorithm": "random", "budget": 1, "starts": ["walker"]}
LEARNING: Json = {"format": "nmes-learning/1", "task": "walk", "algorithm": "ppo", "genome": "walker", "steps": 1000}
RECORD: Json = {
    **{"index": 0, "operator": "start", "parents": [], "generation": 0, "group": "", "error": "it fell"},
    **{"genome": Genome.load("walker").document, "genome_hash": Genome.load("walker").hash},
    **{"results": [], "score": None, "objectives": [], "measures": []},
}


def evolution(folder: Path, *records: Json, **settings: Any) -> Path:
    """Makes the folder of a run of evolution whose log has these records."""
    folder.mkdir()
    found = RunSettings.read({**EVOLUTION, **settings})
    document = {**found.document, "fingerprint": found.fingerprint()}
    (folder / "run.json").write_bytes(write_json(document))
    decisive = {name: value for name, value in document.items() if name not in ("budget", "fingerprint")}
    origin = canonical_hash({**decisive, "task": task_identity(document["task"])})
    writer = RunWriter(RunLog(folder / "log.jsonl", origin))
    writer.append(records)
    writer.close()
    return folder


def learning(folder: Path) -> Path:
    """Makes the folder of a run of learning that has not begun."""
    folder.mkdir()
    found = LearningSettings.read(LEARNING)
    (folder / "run.json").write_bytes(write_json({**found.document, "fingerprint": found.fingerprint()}))
    return folder


def unchanged(arguments: list[str | Path], file: Path, *words: str) -> None:
    """Runs a command that is to fail, with these words, and to leave a file alone."""
    before = file.read_bytes()
    result = run(*arguments)
    assert result.exit_code in (1, 2) and all(word in result.output for word in words), result.output
    assert file.read_bytes() == before


# -- names that lead elsewhere ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("place", ["task", "starts"])
def test_a_run_holds_its_documents_and_names_none(place: str, tmp_path: Path) -> None:
    folder = evolution(tmp_path / "run", RECORD)
    document = json.loads((folder / "run.json").read_bytes())
    document[place] = "walk" if place == "task" else ["walker"]
    (folder / "run.json").write_bytes(write_json(document))
    for command in ("show", "resume", "verify", "best"):
        result = run("evolve", command, folder)
        assert result.exit_code == 2 and "must be the document itself" in result.output


@pytest.mark.parametrize("place", ["task", "genome"])
def test_a_run_of_learning_holds_its_documents_and_names_none(place: str, tmp_path: Path) -> None:
    folder = learning(tmp_path / "run")
    document = json.loads((folder / "run.json").read_bytes())
    (folder / "run.json").write_bytes(write_json({**document, place: LEARNING[place]}))
    for command in ("show", "resume", "verify"):
        result = run("learn", command, folder)
        assert result.exit_code == 2 and f"{place}: must be the document itself" in result.output


@pytest.mark.parametrize("content", [b"notes that nobody else has", b'{"mine":1}', b""])
def test_a_log_that_is_a_link_is_not_written_to(content: bytes, tmp_path: Path) -> None:
    (notes := tmp_path / "notes").write_bytes(content)
    for kind, folder in (("evolve", evolution(tmp_path / "run")), ("learn", learning(tmp_path / "learning"))):
        (folder / "log.jsonl").unlink(missing_ok=True)
        (folder / "log.jsonl").symlink_to(notes)
        unchanged([kind, "resume", folder], notes, "it is a link")


@pytest.mark.parametrize("content", [b"notes that nobody else has", b'{"mine":1', b'{"index":1,"operator":"start'])
def test_what_is_no_torn_line_of_a_log_is_not_cut_off(content: bytes, tmp_path: Path) -> None:
    folder = evolution(tmp_path / "run")
    (folder / "log.jsonl").write_bytes(content)
    unchanged(["evolve", "resume", folder], folder / "log.jsonl", "is no line of a run")


@pytest.mark.parametrize("torn", [b"{", b'{"ind', b'{"index":0,', b'{"index":0,"operator":"start","par'])
def test_a_torn_line_is_cut_off(torn: bytes, tmp_path: Path) -> None:
    whole, folder = evolution(tmp_path / "whole"), evolution(tmp_path / "run")
    (folder / "log.jsonl").write_bytes(torn)
    assert run("evolve", "resume", whole, "--jobs", "1").exit_code == 0
    assert run("evolve", "resume", folder, "--jobs", "1").exit_code == 0
    assert (folder / "log.jsonl").read_bytes() == (whole / "log.jsonl").read_bytes()


@pytest.mark.parametrize("name", ["run.json", "log.jsonl"])
@pytest.mark.parametrize("way", ["itself", "a symbolic link", "a hard link"])
def test_a_page_of_a_run_is_not_written_over_a_file_of_it(name: str, way: str, tmp_path: Path) -> None:
    folder = evolution(tmp_path / "run", RECORD)
    page = tmp_path / "page.html"
    if way == "a symbolic link":
        page.symlink_to(folder / name)
    elif way == "a hard link":
        os.link(folder / name, page)
    else:
        (folder / name).rename(page := folder / "page.html")
        (folder / name).symlink_to(page)
    unchanged(["evolve", "show", folder, "-o", page], folder / name, "is what is read")


# -- pipes and devices ------------------------------------------------------------------------------------------------


def pipe(path: Path) -> None:
    path.unlink(missing_ok=True)
    os.mkfifo(path)


def endless(path: Path) -> None:
    path.unlink(missing_ok=True)
    path.symlink_to("/dev/zero")


@pytest.mark.parametrize("make", [pipe, endless])
@pytest.mark.parametrize("name", ["run.json", "log.jsonl"])
def test_a_run_of_what_is_no_file_is_not_waited_for(make: Callable[[Path], None], name: str, tmp_path: Path) -> None:
    for kind, folder in (("evolve", evolution(tmp_path / "run")), ("learn", learning(tmp_path / "learning"))):
        make(folder / name)
        for command in ("show", "resume", "verify"):
            result = run(kind, command, folder)
            assert result.exit_code == 2 and "it is no regular file" in result.output


@pytest.mark.parametrize("make", [pipe, endless])
def test_a_host_does_not_wait_for_what_is_no_file(make: Callable[[Path], None], tmp_path: Path) -> None:
    (tmp_path / "worlds").mkdir()
    make(tmp_path / "worlds" / "closed-worlds.txt")
    result = run("serve", "--resume", tmp_path / "worlds")
    assert result.exit_code == 2 and "it is no regular file" in result.output
    make(tmp_path / "hills.png")
    config = {"scene": {"type": "heightfield", "heightfield": {"image_file": "hills.png"}}}
    (tmp_path / "world.json").write_bytes(write_json(config))
    result = run("serve", "--config", tmp_path / "world.json")
    assert result.exit_code == 2 and "it is no regular file" in result.output


def test_files_that_a_host_reads_may_hold_anything(tmp_path: Path) -> None:
    config = {"scene": {"type": "heightfield", "heightfield": {"image_file": "a\0b"}}}
    (tmp_path / "world.json").write_bytes(write_json(config))
    assert "image_file" in run("serve", "--config", tmp_path / "world.json").output
    (tmp_path / "closed-worlds.txt").write_bytes(b"\xff\xfe\n")
    assert kept_worlds(tmp_path) == {}


def test_no_run_holds_up_a_lab(tmp_path: Path) -> None:
    with running_lab(tmp_path) as lab:
        for number in range(3):
            pipe(evolution(lab.folder / "runs" / f"pipe-{number}") / "log.jsonl")
        odd = lab.folder / "runs" / "odd"
        odd.mkdir()
        settings = {"format": "nmes-run/1", "task": "walk", "seed": 10**30, "algorithm": "x" * 10_000, "budget": [1]}
        (odd / "run.json").write_bytes(write_json(settings))
        (odd / "log.jsonl").write_bytes(b"")
        listed: list[Json] = [{"details": None}]
        while any(each["details"] is None for each in listed):
            listed = lab.good("/api/runs")["items"]
        told = {each["name"]: each["details"] for each in listed}
        assert "it is no regular file" in told["pipe-0"]["error"]
        assert (told["odd"]["seed"], told["odd"]["budget"], len(told["odd"]["algorithm"])) == (None, None, 200)
        assert lab.good("/api/recordings")["items"] == []
        for number in range(3):
            assert lab.ask(f"/api/runs/pipe-{number}")[0] in (409, 422, 500)
        assert lab.good("/api/tasks")["items"]


# -- candidates that nobody asked for --------------------------------------------------------------------------------


def scored(index: int, **changes: Any) -> Json:
    result = {"seed": 1, "score": 1.0, "energy": 1.0, "distance": 1.0, "ticks": 1, "ended": None, "fault": None}
    return {**RECORD, "index": index, "error": None, "score": 1.0, "results": [result], **changes}


def of(name: str, **changes: Any) -> Json:
    genome = Genome.load(name)
    return {"genome": genome.document, "genome_hash": genome.hash, **changes}


MEASURES = [{"expression": "mass", "low": 0, "high": 9, "cells": 3}]


@pytest.mark.parametrize(
    ("settings", "records"),
    [
        ({"algorithm": "neat", "starts": ["roller"], "options": {"population": 2}}, [scored(0, **of("inchworm"))]),
        (
            {"algorithm": "islands", "starts": ["walker"], "options": {"islands": 2}},
            [scored(0), scored(1), scored(2), scored(3, parents=[2])],
        ),
        (
            {"algorithm": "cma-me", "starts": ["inchworm"], "measures": MEASURES, "options": {"emitters": 1}},
            [scored(0, measures=[1.0], **of("walker"))],
        ),
    ],
    ids=["neat", "islands", "cma-me"],
)
def test_a_log_of_candidates_that_its_algorithm_cannot_have_asked_for_is_damaged(
    settings: Json, records: list[Json], tmp_path: Path
) -> None:
    folder = evolution(tmp_path / "run", *records, budget=len(records) + 1, seeds=[1], **settings)
    result = run("evolve", "verify", folder, "--jobs", "1", "--sample", "0")
    assert result.exit_code == 1 and f"candidate {len(records) - 1}: " in result.output, result.output
    for command in ("resume", "show"):
        result = (
            run("evolve", command, folder, "-o", tmp_path / "x.html")
            if command == "show"
            else run("evolve", command, folder, "--jobs", "1")
        )
        assert result.exit_code == 1 and f"line {len(records)}: " in result.output, result.output


# -- numbers ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("change", [{"index": 0.0}, {"generation": 2.0}, {"parents": []}])
def test_a_whole_number_may_be_written_with_a_point(change: Json, tmp_path: Path) -> None:
    folder = evolution(tmp_path / "run", {**RECORD, **change})
    assert run("evolve", "show", folder).exit_code == run("evolve", "show", folder, "--json").exit_code == 0


def test_parents_may_be_written_with_a_point(tmp_path: Path) -> None:
    folder = evolution(tmp_path / "run", RECORD, {**RECORD, "index": 1, "parents": [0.0], "generation": 1}, budget=2)
    result = run("evolve", "show", folder, "--json")
    assert result.exit_code == 0, result.output
    assert run("evolve", "show", folder, "-o", tmp_path / "page.html").exit_code == 0


@pytest.mark.parametrize("change", [{"generation": 1e300}, {"generation": 2**60}, {"index": 0.5}])
def test_a_number_beyond_all_measure_is_told_as_damage(change: Json, tmp_path: Path) -> None:
    folder = evolution(tmp_path / "run", {**RECORD, **change})
    for command in ("show", "resume", "verify"):
        result = run("evolve", command, folder)
        assert result.exit_code == 1 and "it is no record of candidate 0" in result.output


def test_scores_as_great_as_numbers_get_are_drawn(tmp_path: Path) -> None:
    records = []
    for index, score in enumerate((1.7e308, -1.7e308, 1.7e308)):
        result = {"seed": 1, "score": score, "energy": 1.0, "distance": 1.0, "ticks": 1, "ended": None, "fault": None}
        scores = {"error": None, "score": score, "results": [result]}
        records.append({**RECORD, **scores, "index": index})
    folder = evolution(tmp_path / "run", *records, budget=3, seeds=[1])
    assert run("evolve", "show", folder).exit_code == 0
    assert run("evolve", "show", folder, "-o", tmp_path / "page.html").exit_code == 0


def test_a_task_in_settings_may_be_called_anything(tmp_path: Path) -> None:
    (tmp_path / "settings.json").write_bytes(write_json({**EVOLUTION, "task": "a\0b"}))
    result = run("evolve", "--settings", tmp_path / "settings.json", "-o", tmp_path / "run")
    assert result.exit_code in (1, 2) and "there is no task" in result.output
    assert Task.load("walk").name == "walk"
