"""Folders of runs that a power cut, a disk or a stranger left otherwise than a run leaves them."""

from __future__ import annotations

import errno
import fcntl
import random
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import orjson
import pytest

from coevolution_runs import begin_duel
from nmes.errors import RunError
from nmes.evaluation.parallel import Here
from nmes.evolution.run import Run
from runs import begin, finish, forge

MEASURES = [{"expression": name, "low": 0, "high": 9, "cells": 3} for name in ("legs", "mass")]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a finished run."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    finish(begin(folder))
    return folder


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a finished run that has measures."""
    folder = tmp_path_factory.mktemp("archive") / "run"
    finish(begin(folder, algorithm="map-elites", options={"initial": 6, "window": 6}, measures=MEASURES))
    return folder


@pytest.fixture(scope="module")
def duel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a finished run of two populations."""
    folder = tmp_path_factory.mktemp("duel") / "run"
    finish(begin_duel(folder))
    return folder


def copied(run: Path, folder: Path) -> Path:
    shutil.copytree(run, folder / "run")
    return folder / "run"


def log(folder: Path) -> bytes:
    return (folder / "log.jsonl").read_bytes()


def say(folder: Path, statement: str) -> None:
    """Makes the index of a run do this."""
    with closing(sqlite3.connect(folder / "index.sqlite")) as db, db:
        db.execute(statement)


# -- what a power cut leaves ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
def test_a_log_whose_last_bytes_became_zeros_is_gone_on_with(whole: Path, tmp_path: Path, seed: int) -> None:
    folder, text, draw = copied(whole, tmp_path), log(whole), random.Random(seed)
    end = draw.choice([0, *(index + 1 for index, byte in enumerate(text[:-1]) if byte == ord("\n"))])
    cut = end + draw.choice([0, draw.randrange(1, 12), draw.randrange(12, 400)])
    zeros = draw.choice([1, draw.randrange(1, 40), 4096, 3 << 20])
    (folder / "log.jsonl").write_bytes(text[:cut] + bytes(zeros))
    run = Run.open(folder)
    assert len(run) == text[:cut].count(b"\n")
    assert finish(run).digest == Run.open(whole).digest
    assert log(folder) == text


@pytest.mark.parametrize(
    "tail", [b"\0\0x", b'{"ind\0\0e', b'{"indez', bytes(2 << 20) + b"x", b"\0\n"], ids=lambda tail: repr(tail[:9])
)
def test_what_no_power_cut_leaves_is_not_cut_off(whole: Path, tmp_path: Path, tail: bytes) -> None:
    folder, text = copied(whole, tmp_path), log(whole) + tail
    (folder / "log.jsonl").write_bytes(text)
    with pytest.raises(RunError) as error:
        run = Run.open(folder)
        run.extend(25)
        finish(run)
    assert error.value.code == "log_damaged" and log(folder) == text


def test_who_has_a_damaged_log_hears_what_of_it_can_be_kept(whole: Path, tmp_path: Path) -> None:
    folder, lines = copied(whole, tmp_path), log(whole).splitlines(keepends=True)
    for number in (3, 11):
        lines[number] = lines[number].replace(b'"score"', b'"scoer"')
    (folder / "log.jsonl").write_bytes(b"".join(lines))
    with pytest.raises(RunError, match=r"line 12: .*head -n 3\)"):
        Run.open(folder).genome(11)  # by the index, which knows nothing of what is before
    (folder / "index.sqlite").unlink()
    with pytest.raises(RunError, match=r"line 4: .*head -n 3\)"):
        Run.open(folder)
    (folder / "log.jsonl").write_bytes(b"".join(lines[:3]))
    assert finish(Run.open(folder)).digest == Run.open(whole).digest


def test_who_has_a_foreign_end_of_a_log_hears_what_is_before_it(whole: Path, tmp_path: Path) -> None:
    folder, size = copied(whole, tmp_path), len(log(whole))
    (folder / "log.jsonl").write_bytes(log(whole) + b"what")
    run = Run.open(folder)
    run.extend(25)
    with pytest.raises(RunError, match=rf"head -c {size}\)"):
        finish(run)


@pytest.mark.parametrize("damage", ["a line", "the end"])
def test_a_budget_is_not_kept_where_the_log_is_damaged(whole: Path, tmp_path: Path, damage: str) -> None:
    folder, before = copied(whole, tmp_path), (whole / "run.json").read_bytes()
    run = Run.open(folder)
    text = log(whole)
    changed = {"a line": text.replace(b'"index":5', b'"index":6', 1), "the end": text + b"what"}
    (folder / "log.jsonl").write_bytes(changed[damage])
    run.extend(30)
    with pytest.raises(RunError) as error:
        finish(run)
    assert error.value.code == "log_damaged" and (folder / "run.json").read_bytes() == before


def test_a_budget_is_not_kept_by_who_stops_before_the_log_is_told(whole: Path, tmp_path: Path) -> None:
    folder, before = copied(whole, tmp_path), (whole / "run.json").read_bytes()
    run = Run.open(folder)
    run.extend(25)

    def stop(done: int, known: int) -> None:
        raise KeyboardInterrupt

    with Here() as here, pytest.raises(KeyboardInterrupt):
        list(run.advance(here, stop))
    assert (folder / "run.json").read_bytes() == before
    run.extend(26)
    assert len(finish(run)) == 26 and Run.open(folder).settings.budget == 26


# -- disks ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "code"),
    [(errno.ENOLCK, "cannot_write"), (errno.ENOTSUP, "cannot_write"), (errno.EAGAIN, "run_busy")],
)
def test_a_log_that_cannot_be_locked_is_not_told_as_another_process(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, code: str
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(number, "said so")

    monkeypatch.setattr(fcntl, "flock", refuse)
    run = Run.open(copied(whole, tmp_path))
    run.extend(25)
    with pytest.raises(RunError) as error:
        finish(run)
    assert error.value.code == code
    assert ("said so" in error.value.message) == (code == "cannot_write")


# -- what strangers write ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE records SET measures = '[]'",
        "UPDATE records SET measures = '[1, 2, 3]' WHERE \"index\" = 7",
        "UPDATE records SET objectives = '[1]' WHERE \"index\" = 7",
        "UPDATE records SET score = 9e999",
        'UPDATE records SET score = -9e999 WHERE "index" = 7',
        "UPDATE records SET score = NULL",
        "UPDATE records SET score = NULL, measures = '[]' WHERE score IS NOT NULL AND \"index\" > 12",
        "UPDATE records SET score = NULL, measures = '[]', error = 'no'",  # but the elites have one
    ],
)
def test_an_index_of_what_no_run_comes_to_is_not_believed(archive: Path, tmp_path: Path, statement: str) -> None:
    folder = copied(archive, tmp_path)
    say(folder, statement)
    assert Run.open(folder).records == Run.open(archive).records


def test_an_index_of_a_population_that_there_is_not_is_not_believed(duel: Path, tmp_path: Path) -> None:
    for number, group in enumerate(("nobody", "red")):
        folder = copied(duel, tmp_path / str(number))
        say(folder, f"UPDATE records SET species = '{group}'")
        assert Run.open(folder).records == Run.open(duel).records


@pytest.mark.parametrize("group", ["nobody", "blue"])
def test_a_log_of_a_population_whose_turn_it_is_not_is_damaged(duel: Path, tmp_path: Path, group: str) -> None:
    folder = copied(duel, tmp_path)
    forge(folder, lambda records: records[4].update(group=group))
    with pytest.raises(RunError, match=r"line 5: .*group"):
        Run.open(folder)


def altered(folder: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    """Changes what a run is about."""
    document = orjson.loads((folder / "run.json").read_bytes())
    change(document)
    (folder / "run.json").write_bytes(orjson.dumps(document))
    return folder


def test_settings_that_are_not_those_of_the_log_are_noticed_by_who_reads_the_index(whole: Path, tmp_path: Path) -> None:
    folder = altered(copied(whole, tmp_path), lambda document: document.update(seed=4))
    with pytest.raises(RunError, match=r"line 1: .*settings") as error:
        Run.open(folder)
    assert error.value.code == "log_damaged"


def test_options_that_are_missing_are_at_their_defaults_where_the_log_allows_it(duel: Path, tmp_path: Path) -> None:
    folder = altered(copied(duel, tmp_path), lambda document: document["options"].pop("era"))
    with pytest.raises(RunError, match="line 1"):
        Run.open(folder)
    forge(folder, lambda records: None)  # the chain of a run that began without the option
    run = Run.open(folder)
    assert run.settings.options["era"] == 50 and run.settings.options["latest"] == 1
    assert run.settings.begin().needs(4) == 0


@pytest.mark.parametrize("era", [0, 1.5, True])
def test_an_era_that_is_none_is_refused(duel: Path, tmp_path: Path, era: float) -> None:
    folder = altered(copied(duel, tmp_path), lambda document: document["options"].update(era=era))
    with pytest.raises(RunError, match=r"options\.era: must be") as error:
        Run.open(folder)
    assert error.value.code == "no_run"


def test_measures_without_a_range_are_refused(archive: Path, tmp_path: Path) -> None:
    folder = altered(copied(archive, tmp_path), lambda document: document["measures"][0].update(high=0))
    with pytest.raises(RunError, match=r"measures/0.*greater") as error:
        Run.open(folder)
    assert error.value.code == "no_run"
