"""A run of evolution: one history, whoever computes it and however often it is interrupted."""

from __future__ import annotations

import os
import random
import shutil
import signal
import sqlite3
import sys
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import orjson
import pytest

from modelled import modelled
from nmes.errors import DocumentError, MissingPackage, RunError
from nmes.evaluation import Job, Task, Workers, evaluate, queue
from nmes.evaluation.evaluator import evaluate_portion
from nmes.evaluation.parallel import Here
from nmes.evolution.algorithm import Algorithm, Candidate, Score
from nmes.evolution.run import Order, Run
from nmes.evolution.run_log import RunLog, RunWriter
from nmes.evolution.run_settings import RunSettings
from nmes.genome import Genome
from runs import SETTINGS, TASK, begin, finish


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run that was finished in one go."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    finish(begin(folder))
    return folder


def copied(whole: Path, folder: Path) -> Path:
    shutil.copytree(whole, folder / "run")
    return folder / "run"


def log(folder: Path) -> bytes:
    return (folder / "log.jsonl").read_bytes()


def test_a_package_that_is_missing_is_no_fault_of_a_genome_to_begin_with(monkeypatch: pytest.MonkeyPatch) -> None:
    document = {**SETTINGS, "starts": [modelled()]}
    assert RunSettings.read(document).starts
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(MissingPackage, match=r"pip install 'nmes\[onnx\]'"):
        RunSettings.read(document)


# -- one history ------------------------------------------------------------------------------------------------------


def test_a_run_keeps_what_each_candidate_was_and_how_it_came_out(whole: Path) -> None:
    run = Run.open(whole)
    assert len(run) == len(run.records) == run.settings.budget and run.finished
    assert [record.index for record in run.records] == list(range(24))
    for index in (0, 7, 23):
        genome = run.genome(index)
        again = evaluate(genome, Task(TASK))
        assert run.evaluation(index) == again
        record = run.records[index]
        assert (record.score, record.genome, record.genome_hash) == (again.score, genome.name, genome.hash)
        assert all(parent < index for parent in record.parents)
    assert any(record.parents for record in run.records)
    best = run.best
    assert best is not None and best.score == max(record.score or 0.0 for record in run.records)
    assert run.elites()[0] == best.index


def test_workers_do_not_show_in_the_log(whole: Path, tmp_path: Path) -> None:
    with Workers(3) as workers:
        assert [record.index for record in begin(tmp_path / "run").advance(workers)] == list(range(24))
    assert log(tmp_path / "run") == log(whole)


def deadly(portion: Sequence[Job]) -> list[Any]:
    if any(job.name == "random-5" for job in portion):
        os.kill(os.getpid(), signal.SIGSEGV)
    return evaluate_portion(portion)


def test_a_creature_that_crashes_the_only_worker_is_an_error_of_its_own(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(queue, "evaluate_portion", deadly)
    with Workers(1) as workers:
        records = list(begin(tmp_path / "run", budget=8).advance(workers))
    crashed = records.pop(5)
    assert crashed.genome == "random-5" and "SIGSEGV" in str(crashed.error)
    others = [record for record in Run.open(whole).records[:8] if record.index != 5]
    assert [(each.genome_hash, each.score) for each in records] == [(each.genome_hash, each.score) for each in others]


def test_who_goes_on_with_a_run_hears_how_much_of_its_log_was_told(tmp_path: Path) -> None:
    finish(begin(tmp_path / "run", budget=12))
    run, heard = Run.open(tmp_path / "run"), list[tuple[int, int]]()
    run.extend(13)
    with Here() as here:
        records = run.advance(here, lambda done, known: heard.append((done, known)))
        assert next(records).index == 12
        assert heard == [(done, 12) for done in range(1, 13)]
        assert list(records) == [] and len(heard) == 12


def test_another_seed_or_option_is_another_history(whole: Path, tmp_path: Path) -> None:
    digests = {Run.open(whole).digest}
    others: list[dict[str, Any]] = [{"seed": 4}, {"seeds": [2]}, {"options": {"crossover": 0.0}}]
    for number, settings in enumerate(others):
        digests.add(finish(begin(tmp_path / str(number), budget=3, **settings)).digest)
    digests.add(finish(begin(tmp_path / "same", budget=3)).digest)
    assert len(digests) == 5


def test_how_many_candidates_of_random_search_are_under_way_does_not_show_in_the_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    random_search = {"algorithm": "random", "options": {}}
    finish(begin(tmp_path / "whole", **random_search))
    monkeypatch.setattr("nmes.evolution.algorithms.random_search._WINDOW", 4)
    begun = begin(tmp_path / "run", **random_search)
    with Workers(3) as workers:
        assert len(list(islice(begun.advance(workers), 9))) == 9
    assert 9 <= len(Run.open(tmp_path / "run")) < 24
    monkeypatch.undo()
    finish(Run.open(tmp_path / "run"))
    assert log(tmp_path / "run") == log(tmp_path / "whole")


def test_a_run_that_is_interrupted_again_and_again_comes_out_the_same(whole: Path, tmp_path: Path) -> None:
    begin(tmp_path / "run")
    told: list[int] = []
    for take in (0, 1, 5, 2, 11, 100):
        run = Run.open(tmp_path / "run")
        with Here() as workers:
            records = run.advance(workers)
            told += [record.index for record in islice(records, take)]
            records.close()
    assert log(tmp_path / "run") == log(whole)
    assert Run.open(tmp_path / "run").records == Run.open(whole).records
    assert set(told) <= set(range(24)) and len(told) == len(set(told))


@pytest.mark.parametrize("seed", range(4))
def test_a_log_that_was_cut_at_any_byte_is_gone_on_with(whole: Path, tmp_path: Path, seed: int) -> None:
    folder, text = copied(whole, tmp_path), log(whole)
    ends = [index + 1 for index, byte in enumerate(text) if byte == ord("\n")]
    draw = random.Random(seed)
    cut = draw.choice([draw.randrange(len(text)), draw.choice(ends) - 1, draw.choice(ends)])
    (folder / "log.jsonl").write_bytes(text[:cut])
    run = Run.open(folder)
    assert len(run) == sum(end <= cut for end in ends)
    assert log(folder) == text[:cut]  # who only reads cuts nothing off: it may be just being written
    assert finish(run).digest == Run.open(whole).digest
    assert log(folder) == text
    assert Run.open(folder).records == Run.open(whole).records


def test_a_greater_budget_goes_on_as_if_it_had_been_so_from_the_beginning(whole: Path, tmp_path: Path) -> None:
    run = finish(begin(tmp_path / "run", budget=9))
    assert run.finished
    with pytest.raises(RunError) as error:
        run.extend(8)
    assert error.value.code == "budget_spent"
    run.extend(24)
    assert finish(run).digest == Run.open(whole).digest
    assert Run.open(tmp_path / "run").settings.budget == 24


class Watched(Algorithm):
    """Needs scores by a rule of its own, and notes how many it had been told when it was asked."""

    def __init__(self, needs: Sequence[int]) -> None:
        self._needs = needs
        self.asked: dict[int, int] = {}
        self._told = 0

    def needs(self, index: int) -> int:
        return self._needs[index]

    def ask(self, index: int) -> Candidate:
        self.asked[index] = self._told
        return Candidate(Genome.load("walker"), "start")

    def tell(self, index: int, candidate: Candidate, score: Score) -> None:
        assert index == self._told
        self._told += 1

    def elites(self) -> Sequence[int]:
        return ()


@pytest.mark.parametrize("first", [0, 17])
def test_each_candidate_is_asked_for_once_just_what_it_needs_is_told(first: int) -> None:
    needs = [max(0, index - 6) for index in range(20)] + [20] * 10 + [30] * 10
    algorithm = Watched(needs)
    order = Order(algorithm, 40, first)
    asked: list[int] = []
    while order.told < 40:
        asked += [index for index, _ in order.due()]
        order.tell(Candidate(Genome.load("walker"), "start"), Score(0.0))
    assert asked == list(range(first, 40))
    assert algorithm.asked == {index: needs[index] for index in range(first, 40)}


# -- files ------------------------------------------------------------------------------------------------------------


def test_a_damaged_line_is_named_and_nothing_is_dropped(whole: Path, tmp_path: Path) -> None:
    folder = copied(whole, tmp_path)
    lines = log(whole).splitlines(keepends=True)
    spoilt = {
        "a digit": (5, lines[5].replace(b'"index":5', b'"index":6')),
        "a score": (9, lines[9].replace(b'"score":', b'"score": ', 1)),
        "the digest": (11, lines[11][:-4] + (b"0" if lines[11][-4:-3] == b"1" else b"1") + lines[11][-3:]),
        "no JSON": (3, b"\n"),
        "nothing": (13, b""),
        "zeros": (23, b"\0" * 100 + b"\n"),
    }
    for what, (number, line) in spoilt.items():
        text = b"".join([*lines[:number], line, *lines[number + 1 :]])
        (folder / "log.jsonl").write_bytes(text)
        (folder / "index.sqlite").unlink(missing_ok=True)
        with pytest.raises(RunError) as error:
            Run.open(folder)
        assert error.value.code == "log_damaged" and f"line {number + 1}:" in error.value.message, what
        assert log(folder) == text
        # Where the index has it all, the log is read when the run is gone on with.
        shutil.copy(whole / "index.sqlite", folder)
        with pytest.raises(RunError, match=f"line {number + 1}:"):
            run = Run.open(folder)
            run.extend(25)
            finish(run)
        assert log(folder) == text


def spoil_nothing(index: Path) -> None:
    pass


def delete(index: Path) -> None:
    index.unlink()


def tear(index: Path) -> None:
    index.write_bytes(index.read_bytes()[:5000])


def garble(index: Path) -> None:
    index.write_bytes(b"no database at all" * 1000)


def saying(statement: str) -> Callable[[Path], None]:
    """Returns what makes an index do this."""

    def spoil(index: Path) -> None:
        with sqlite3.connect(index) as db:
            db.execute(statement)
        db.close()

    return spoil


age = saying("PRAGMA user_version = 99")
empty = saying("DELETE FROM records")
halve = saying('DELETE FROM records WHERE "index" > 12')
mix = saying("UPDATE records SET digest = 'ff' WHERE \"index\" = 23")


SPOILS = {
    "nothing": spoil_nothing,
    "delete": delete,
    "tear": tear,
    "garble": garble,
    "age": age,
    "empty": empty,
    "halve": halve,
    "mix": mix,
    "lag": saying("UPDATE state SET told = 12, elites = '[3]', figures = '{}'"),  # a kill leaves it so
    "elites that are none": saying("UPDATE state SET elites = '[24]'"),
    "elites that are no list": saying("UPDATE state SET elites = '\"0\"'"),
    "figures that are none": saying("UPDATE state SET figures = '[]'"),
    "figures that are no numbers": saying('UPDATE state SET figures = \'{"species": "many"}\''),
    "too much told": saying("UPDATE state SET told = 25"),
    "parents that are none": saying("UPDATE records SET parents = '[20]' WHERE \"index\" = 20"),
    "parents that are no list": saying("UPDATE records SET parents = '7' WHERE \"index\" = 20"),
    "objectives that are no numbers": saying("UPDATE records SET objectives = '[[]]' WHERE \"index\" = 20"),
    "lines that overlap": saying('UPDATE records SET "begin" = "begin" - 1 WHERE "index" = 20'),
}


@pytest.mark.parametrize("spoil", SPOILS.values(), ids=SPOILS)
def test_an_index_follows_from_the_log_whatever_became_of_it(
    whole: Path, tmp_path: Path, spoil: Callable[[Path], None]
) -> None:
    folder = copied(whole, tmp_path)
    spoil(folder / "index.sqlite")
    run, as_it_was = Run.open(folder), Run.open(whole)
    assert run.records == as_it_was.records
    assert (run.elites(), run.figures(), run.digest) == (as_it_was.elites(), as_it_was.figures(), as_it_was.digest)
    run.extend(25)
    finish(run)
    with sqlite3.connect(folder / "index.sqlite") as db:
        assert db.execute("SELECT count(*), sum(score) FROM records").fetchone()[0] == 25
    db.close()
    assert Run.open(folder).records == run.records


def test_an_index_of_before_the_run_went_on_is_no_other_run(whole: Path, tmp_path: Path) -> None:
    run = finish(begin(tmp_path / "run", budget=9))
    shutil.copy(tmp_path / "run" / "index.sqlite", tmp_path / "old")
    run.extend(24)
    finish(run)
    shutil.copy(tmp_path / "old", tmp_path / "run" / "index.sqlite")
    again, as_it_was = Run.open(tmp_path / "run"), Run.open(whole)
    assert (again.finished, again.up_to_date, as_it_was.up_to_date) == (True, False, True)
    assert (again.records, again.elites()) == (as_it_was.records, as_it_was.elites())
    finish(again)
    assert Run.open(tmp_path / "run").up_to_date


def test_a_line_that_was_changed_is_noticed_where_the_index_has_its_record(whole: Path, tmp_path: Path) -> None:
    folder = copied(whole, tmp_path)
    (folder / "log.jsonl").write_bytes(log(whole).replace(b'"index":17', b'"index":71'))
    run = Run.open(folder)
    assert run.genome(16).hash == run.records[16].genome_hash
    for read in (run.genome, run.evaluation, run.entry):
        with pytest.raises(RunError) as error:
            read(17)
        assert error.value.code == "log_damaged" and "line 18:" in error.value.message


def test_a_run_is_read_beside_who_goes_on_with_it_and_who_goes_on_is_one(tmp_path: Path) -> None:
    run = begin(tmp_path / "run")
    with Here() as workers:
        records = run.advance(workers)
        first = list(islice(records, 12))
        other = Run.open(tmp_path / "run")
        assert other.records[:12] == first and len(other.elites()) > 0
        with pytest.raises(RunError) as error:
            next(iter(other.advance(workers)))
        assert error.value.code == "run_busy"
        rest = list(records)
    assert [record.index for record in first + rest] == list(range(24))
    assert finish(other).records == run.records  # what the other process has added is read


# -- refusals ---------------------------------------------------------------------------------------------------------


def refused() -> Iterator[tuple[dict[str, object], str]]:
    """Yields settings that cannot be run, and a part of what must be said of them."""
    brainless = Genome.load("walker").document
    del brainless["brain"]
    yield {"algorithm": "gaa"}, "did you mean ga"
    yield {"budget": 0}, "budget"
    yield {"task": "wlk"}, "walk"
    yield {"task": {**TASK, "objective": "nonsense +"}}, "task/objective"
    yield {"options": {"windw": 1}}, "window"
    yield {"options": {"window": "wide"}}, "options/window"
    yield {"starts": ["nobody"]}, "starts/0"
    yield {"starts": ["walker"]}, "starts/0"  # more cubes than the task allows
    yield {"starts": [{**Genome.load("walker").document, "brain": {"kind": "mlp"}}], "task": "walk"}, "starts/0"
    yield {"measures": [{"expression": "legs", "low": 0, "high": 9, "cells": 3}]}, "measures"
    yield {"objectives": ["distance"]}, "objectives"
    yield {"algorithm": "map-elites"}, "measures"
    yield {"algorithm": "map-elites", "measures": [{"expression": "legz", "low": 0, "high": 9, "cells": 3}]}, "legs"
    yield {"algorithm": "map-elites", "measures": [{"expression": "legs", "low": 9, "high": 9, "cells": 3}]}, "greater"
    yield {"algorithm": "nsga2"}, "objectives"
    yield {"algorithm": "cma", "starts": [brainless], "task": "walk"}, "brain"
    yield {"algorithm": "cma", "task": "walk"}, "starts"
    yield {"format": "nmes-run/2"}, "nmes-run/1"
    yield {"seeds": []}, "seeds"
    yield {"sed": 1}, "did you mean seed"


@pytest.mark.parametrize(("settings", "words"), list(refused()), ids=lambda value: str(value)[:40])
def test_what_cannot_be_run_is_refused_in_words(settings: dict[str, object], words: str) -> None:
    with pytest.raises(DocumentError) as error:
        RunSettings.read({**SETTINGS, **({"options": {}} if "algorithm" in settings else {}), **settings})
    assert words in error.value.message


def test_a_folder_holds_one_run(whole: Path, tmp_path: Path) -> None:
    before = log(whole)
    with pytest.raises(RunError) as error:
        begin(whole)
    assert error.value.code == "run_exists" and log(whole) == before
    (tmp_path / "file").write_text("mine")
    with pytest.raises(RunError) as error:
        begin(tmp_path / "file")
    assert error.value.code == "cannot_write" and (tmp_path / "file").read_text() == "mine"


def test_what_is_no_run_is_said_to_be_none(whole: Path, tmp_path: Path) -> None:
    folder = copied(whole, tmp_path)
    document = orjson.loads((folder / "run.json").read_bytes())
    for text, words in (
        (None, "no run"),
        (b"", "run.json"),
        (b"[]", "run.json"),
        (b'{"format": "nmes-run/1"}', "task"),
        (orjson.dumps({**document, "format": "nmes-run/7"}), "nmes-run/7"),
        (orjson.dumps({**document, "budget": -1}), "budget"),
    ):
        (folder / "run.json").unlink(missing_ok=True)
        if text is not None:
            (folder / "run.json").write_bytes(text)
        with pytest.raises(RunError) as error:
            Run.open(folder)
        assert error.value.code == "no_run" and words in error.value.message


def test_a_run_is_not_gone_on_with_where_other_numbers_come_out(whole: Path, tmp_path: Path) -> None:
    folder = copied(whole, tmp_path)
    document = orjson.loads((folder / "run.json").read_bytes())
    for item in ("probe", "engine.version", "draws", "algorithm"):
        fingerprint = {**document["fingerprint"], item: "of elsewhere"}
        (folder / "run.json").write_bytes(orjson.dumps({**document, "budget": 25, "fingerprint": fingerprint}))
        run = Run.open(folder)
        assert len(run) == 24 and run.elites()  # to look at it is possible anywhere
        with pytest.raises(RunError) as error:
            finish(run)
        assert error.value.code == "not_comparable" and item in error.value.message
    assert log(folder) == log(whole)


def test_a_budget_is_kept_only_if_the_run_goes_on(whole: Path, tmp_path: Path) -> None:
    folder = copied(whole, tmp_path)
    before = (folder / "run.json").read_bytes()
    run = Run.open(folder)
    writing = RunWriter(RunLog(folder / "log.jsonl", ""))
    run.extend(30)
    with pytest.raises(RunError, match="another process"):
        finish(run)
    writing.close()
    assert (folder / "run.json").read_bytes() == before


@pytest.mark.parametrize("budget", [2 * 10**9, 10**30])
def test_a_budget_that_no_run_may_have_changes_nothing(whole: Path, tmp_path: Path, budget: int) -> None:
    folder = copied(whole, tmp_path)
    before = (folder / "run.json").read_bytes()
    with pytest.raises(DocumentError, match="budget"):
        Run.open(folder).extend(budget)
    assert (folder / "run.json").read_bytes() == before and Run.open(folder).finished


def test_an_index_that_cannot_be_written_is_named(whole: Path, tmp_path: Path) -> None:
    folder = copied(whole, tmp_path)
    (folder / "index.sqlite").unlink()
    (folder / "index.sqlite").mkdir()
    run = Run.open(folder)
    run.extend(25)
    with pytest.raises(RunError, match=r"index\.sqlite.*may be removed"):
        finish(run)
    (folder / "index.sqlite").rmdir()
    assert len(finish(Run.open(folder))) >= 24


def test_a_genome_of_a_folder_that_is_none_is_named(tmp_path: Path) -> None:
    for name, text in (("good.json", orjson.dumps(Genome.load("walker").document)), ("spoilt.json", b'{"body": 7}')):
        (tmp_path / name).write_bytes(text)
    starts = sorted(str(path) for path in tmp_path.iterdir())
    with pytest.raises(DocumentError, match=r"spoilt\.json") as error:
        RunSettings.read({**SETTINGS, "task": "walk", "starts": starts})
    assert "good.json" not in error.value.message


def test_starts_that_nobody_could_read_again_are_refused() -> None:
    many = [Genome.load("centipede").document] * 1500
    with pytest.raises(DocumentError) as error:
        RunSettings.read({**SETTINGS, "task": "walk", "starts": many})
    assert error.value.problems[0][0] == "starts"
