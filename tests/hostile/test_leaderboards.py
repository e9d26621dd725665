"""Leaderboards under attack: files that were edited, copies, borrowed names; each entry is judged by itself."""

from __future__ import annotations

import json
import os
import random
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

import learning_runs
from boards import DASH, edit, entries_of, entry, proofs_of, recording_of, run, verdicts
from creatures import SINE, cpg, renamed, snake
from journals import write_naming_journal
from made_up_runs import genomes, make_run, real
from nmes.cli import main
from nmes.errors import BackendNotFound, MissingPackage, ProofError, RecordingError
from nmes.evaluation import Task, leaderboard, leaderboard_entry, prove
from nmes.evaluation.leaderboard import Leaderboard
from nmes.evaluation.match_task import MatchTask
from nmes.evaluation.parallel import Lost
from nmes.evaluation.setting import MATCHES
from nmes.evolution.corpus import Corpus, CorpusTask
from nmes.genome import Genome
from recordings import Line, changed, rewrite
from runs import begin, finish

COLUMNS = ("task", "task_hash", "name", "genome_hash", "creature_hash", "author", "key", "score", "spread", "recorded")


@pytest.fixture(scope="module")
def proofs(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Recordings of two creatures, two episodes each."""
    folder = tmp_path_factory.mktemp("proofs")
    creatures = (snake(SINE, name="wave"), snake(cpg(4), name="chain"))
    return [path for creature in creatures for path in proofs_of(folder, creature)]


@pytest.fixture(scope="module")
def dash(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The task's file."""
    path = tmp_path_factory.mktemp("task") / "dash.json"
    path.write_text(json.dumps(DASH))
    return path


@pytest.fixture
def board(tmp_path: Path, proofs: list[str], dash: Path) -> Path:
    """A leaderboard with both."""
    path = tmp_path / "board.sqlite"
    assert run("tasks", path, "--allow", dash).exit_code == 0
    assert run("add", path, *proofs).exit_code == 0
    return path


# -- what a row says --------------------------------------------------------------------------------------------------


def test_an_entry_with_its_best_seed_twice_is_broken(board: Path) -> None:
    wave = entry(board)
    paths = {each: recording_of(board, each) for each in wave.recordings}
    scores = {prove(path).result.score: each for each, path in paths.items()}
    best = max(score for score in scores if score is not None)
    twice = json.dumps([scores[best]] * 2)
    edit(board, f"UPDATE entries SET recordings = '{twice}', score = {best!r} WHERE name = 'wave'")
    status, found = verdicts(board)
    assert status == 1 and found["wave"] == ("broken", "it names a recording twice")
    assert found["chain"] == ("holds", "")
    once = json.dumps([scores[best]])
    edit(board, f"UPDATE entries SET recordings = '{once}' WHERE name = 'wave'")
    status, found = verdicts(board)
    assert status == 1 and "one recording for each of the seeds 3, 4" in found["wave"][1]


def test_an_entry_takes_one_recording_for_each_seed(tmp_path: Path, dash: Path, proofs: list[str]) -> None:
    board = tmp_path / "board.sqlite"
    run("tasks", board, "--allow", dash)
    for given in (proofs[:1], [proofs[0], proofs[0]], [*proofs[:2], proofs[0]], [proofs[0], proofs[2]]):
        refused = run("add", board, *given)
        assert refused.exit_code == 1 and "one recording for each of the seeds 3, 4" in refused.stderr
        assert entries_of(board) == []


@pytest.mark.parametrize("column", COLUMNS)
def test_every_column_is_compared_with_what_the_recordings_prove(board: Path, column: str) -> None:
    new = {
        "task": "sprint", "name": "mine", "author": "Eve", "key": "ab" * 32, "recorded": "2001-02-03T04:05:06+00:00",
        "score": 99.5, "spread": 0.25,
    }.get(column, "cd" * 32)  # fmt: skip
    number = entry(board).id
    edit(board, f"UPDATE entries SET {column} = {new!r} WHERE id = {number}")
    result = run("verify", board, "--jobs", "1", "--json")
    rows = {row["id"]: row for row in json.loads(result.stdout)}
    assert result.exit_code == 1 and rows.pop(number)["verdict"] == "broken"
    assert [row["verdict"] for row in rows.values()] == ["holds"]
    text = run("verify", board, "--jobs", "1").stdout
    assert f"{column}: listed " in text or (column == "task_hash" and "does not take" in text)


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("recordings", "'[]'"),
        ("recordings", "'garbage'"),
        ("recordings", "'{}'"),
        ("recordings", "''"),
        ("recordings", "'[1, null]'"),
        ("recordings", """'["../../board", "../../board"]'"""),
        ("recordings", """'["/dev/zero", "/dev/zero"]'"""),
        ("recordings", "'[' || substr(replace(hex(zeroblob(30000)), '00', '\"x\",'), 2) || '1]'"),
        ("recordings", "CAST(zeroblob(100000000) AS TEXT)"),
        ("recordings", "CAST(x'ff5b5d' AS TEXT)"),
        ("score", "9e999"),
        ("score", "-9e999"),
        ("name", "printf('%.2000000c', 'x')"),
        ("name", "CAST(x'fffe00' AS TEXT)"),
        ("task_hash", "'x'"),
        ("creature_hash", "''"),
        ("author", "char(0) || char(27) || '[2J' || char(10) || 'row'"),
        ("recorded", "'yesterday'"),
    ],
)
def test_a_hostile_row_is_broken_and_the_others_are_judged(board: Path, column: str, value: str) -> None:
    number = entry(board).id
    edit(board, f"UPDATE entries SET {column} = {value} WHERE id = {number}")
    result = run("verify", board, "--jobs", "1", "--json", "--write")
    rows = {row["id"]: row for row in json.loads(result.stdout)}
    assert result.exit_code == 1 and rows.pop(number)["verdict"] == "broken"
    assert [row["verdict"] for row in rows.values()] == ["holds"]
    assert [each.name for each in entries_of(board)] == ["chain"]
    for arguments in (("show", board), ("show", board, "--broken"), ("verify", board, "--jobs", "1")):
        run(*arguments)
    assert run("export", board, "-o", board.with_suffix(".html")).exit_code == 0


@pytest.mark.parametrize("value", ["'much'", "x'00'", "NULL"])
def test_a_value_of_another_type_is_broken(board: Path, value: str) -> None:
    select = "SELECT sql FROM sqlite_schema WHERE name = 'entries'"
    with sqlite3.connect(board) as database:  # makes the table take anything, and hides that afterwards
        (sql,) = database.execute(select).fetchone()
        database.execute("PRAGMA writable_schema = ON")
        loose = sql.replace("REAL NOT NULL", "BLOB").replace(") STRICT", ")")
        database.execute("UPDATE sqlite_schema SET sql = ? WHERE name = 'entries'", (loose,))
    database.close()
    edit(board, f"UPDATE entries SET score = {value} WHERE name = 'wave'")
    assert run("verify", board).exit_code == 2
    with sqlite3.connect(board) as database:
        database.execute("PRAGMA writable_schema = ON")
        database.execute("UPDATE sqlite_schema SET sql = ? WHERE name = 'entries'", (sql,))
    database.close()
    status, found = verdicts(board)
    assert status == 1 and found[""][0] == "broken" and found["chain"][0] == "holds"


@pytest.mark.parametrize(
    "statements",
    [
        ["CREATE TRIGGER t AFTER UPDATE ON entries BEGIN DELETE FROM entries; END"],
        ["ALTER TABLE entries RENAME TO e", "CREATE VIEW entries AS SELECT * FROM e"],
        ["ALTER TABLE entries ADD COLUMN more TEXT DEFAULT 'x'"],
        ["DROP TABLE tasks"],
        ["CREATE TABLE more (x)"],
        ["DROP TABLE entries", "CREATE TABLE entries (id, task)"],
        ["PRAGMA user_version = 1"],
        ["PRAGMA user_version = 99"],
        ["PRAGMA application_id = 7"],
    ],
)
def test_a_database_of_other_tables_is_no_leaderboard(board: Path, proofs: list[str], statements: list[str]) -> None:
    edit(board, *statements)
    before = board.read_bytes()
    page = board.with_suffix(".html")
    commands: list[list[str]] = [["show"], ["verify", "--write"], ["export", "-o", str(page)], ["add"], ["tasks"]]
    for command in commands:
        result = run(command[0], board, *command[1:], *(proofs if command == ["add"] else ()))
        assert result.exit_code == 2 and "board.sqlite is " in result.stderr
    assert board.read_bytes() == before


def test_a_journal_that_would_have_another_file_removed_is_not_believed(board: Path, tmp_path: Path) -> None:
    (precious := tmp_path / "thesis.txt").write_text("years of work")
    write_naming_journal(board, precious)
    (link := tmp_path / "link.sqlite").symlink_to(board)
    for path in (board, link):
        result = run("show", path)
        assert result.exit_code == 2 and "names another file" in result.output
    assert precious.exists()


def test_a_damaged_database_gives_no_traceback(tmp_path: Path, dash: Path) -> None:
    board, page = tmp_path / "board.sqlite", tmp_path / "board.html"
    assert run("tasks", board, "--allow", dash).exit_code == 0
    hashes = "printf('%064x', i), printf('%064x', i)"
    row = f"NULL, 'dash', '{{0}}', 'wave', {hashes}, 'Ada', '', i, 0.5, '[]', '[\"{{0}}\"]', '', NULL"
    numbers = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 12)"
    edit(board, f"{numbers} INSERT INTO entries SELECT {row.format(Task(DASH).hash)} FROM n")
    whole = board.read_bytes()
    for seed in range(80):
        draw, content = random.Random(seed), bytearray(whole)
        for _ in range(draw.choice((1, 3, 30))):
            begin = draw.randrange(100 if draw.random() < 0.2 else len(content))
            harm = draw.choice((bytes([draw.randrange(256)]), bytes(draw.randrange(1, 64)), draw.randbytes(16)))
            content[begin : begin + len(harm)] = harm
        size = draw.choice((len(content), len(content), draw.randrange(len(content))))
        commands = ("show", "--broken"), ("tasks",), ("verify", "--jobs", "1", "--write"), ("export", "-o", str(page))
        for command, *options in commands:
            board.write_bytes(content[:size])
            assert run(command, board, *options).exit_code in (0, 1, 2, 3), seed


def test_two_rows_of_one_creature_are_not_both_held(board: Path) -> None:
    columns = (
        "task, task_hash, name, genome_hash, creature_hash, author, key, score, spread, players, recordings, recorded"
    )
    index = "SELECT type, name, tbl_name, rootpage, sql FROM sqlite_schema WHERE name = 'sqlite_autoindex_entries_1'"
    with sqlite3.connect(board) as database:  # takes the index away, adds a row, and puts the index back
        (kept,) = database.execute(index).fetchall()
        (sql,) = database.execute("SELECT sql FROM sqlite_schema WHERE name = 'entries'").fetchone()
        database.execute("PRAGMA writable_schema = ON")
        database.execute("DELETE FROM sqlite_schema WHERE name = 'sqlite_autoindex_entries_1'")
        other = sql.replace("UNIQUE (task_hash, creature_hash)", "CHECK (1)")
        database.execute("UPDATE sqlite_schema SET sql = ? WHERE name = 'entries'", (other,))
    database.close()
    edit(board, f"INSERT INTO entries ({columns}) SELECT {columns} FROM entries WHERE name = 'wave'")
    with sqlite3.connect(board) as database:
        database.execute("PRAGMA writable_schema = ON")
        database.execute("UPDATE sqlite_schema SET sql = ? WHERE name = 'entries'", (sql,))
        database.execute("INSERT INTO sqlite_schema VALUES (?, ?, ?, ?, ?)", kept)
    database.close()
    result = run("verify", board, "--jobs", "1", "--json")
    assert [row["verdict"] for row in json.loads(result.stdout)] == ["holds", "holds", "broken"]


def test_a_broken_entry_does_not_keep_its_creature_out(board: Path, proofs: list[str]) -> None:
    refused = run("add", board, *proofs[:2])
    assert refused.exit_code == 1 and "is listed for the task dash already" in refused.stderr
    for recording in entry(board).recordings:
        recording_of(board, recording).unlink()
    assert verdicts(board, "--write")[0] == 1 and entry(board).broken
    assert run("add", board, *proofs[:2]).exit_code == 0
    assert verdicts(board) == (0, {"wave": ("holds", ""), "chain": ("holds", "")})
    edit(board, "UPDATE entries SET recordings = 'garbage' WHERE name = 'wave'")
    assert run("add", board, *proofs[:2]).exit_code == 0
    assert verdicts(board) == (0, {"wave": ("holds", ""), "chain": ("holds", "")})


def test_a_recording_that_a_row_names_many_times_is_not_run(board: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runs: list[Path] = []
    monkeypatch.setattr(leaderboard_entry, "proved", runs.append)
    names = json.dumps(entry(board).recordings[:1] * 1000)
    edit(board, f"UPDATE entries SET recordings = '{names}' WHERE name = 'wave'", "DELETE FROM entries WHERE id > 1")
    with Leaderboard(board) as opened:
        assert [each.verdict for each in opened.verify()] == ["broken"]
    assert not runs


def test_a_verdict_on_an_entry_that_made_room_is_of_no_other(board: Path, proofs: list[str]) -> None:
    edit(board, "DELETE FROM entries WHERE name = 'chain'", "UPDATE entries SET recordings = 'garbage'")
    with Leaderboard(board) as opened:
        (verdict,) = opened.verify()
        added = opened.add([prove(proof, brain=True) for proof in proofs[:2]])
        assert verdict.verdict == "broken" and verdict.id != added.id
        opened.mark([verdict])
        assert [each.id for each in opened.entries()] == [added.id]


def test_the_highest_number_of_a_row_is_no_end(board: Path, proofs: list[str]) -> None:
    edit(board, "DELETE FROM entries WHERE name = 'wave'", f"UPDATE entries SET id = {2**63 - 1}")
    assert run("add", board, *proofs[:2]).exit_code == 0 and len(entries_of(board)) == 2


# -- recordings -------------------------------------------------------------------------------------------------------


def _empty(path: Path) -> None:
    path.write_bytes(b"")


def _garbage(path: Path) -> None:
    path.write_bytes(b"\x89MCAP0\r\n" + bytes(range(256)) * 40)


def _folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def _pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def _endless(path: Path) -> None:
    path.unlink()
    path.symlink_to("/dev/zero")


def _circle(path: Path) -> None:
    path.unlink()
    path.symlink_to(path)


@pytest.mark.parametrize("harm", [Path.unlink, _empty, _garbage, _folder, _pipe, _endless, _circle])
def test_a_recording_that_is_none_breaks_its_entry_alone(board: Path, harm: Callable[[Path], None]) -> None:
    harm(recording_of(board, entry(board).recordings[0]))
    status, found = verdicts(board)
    assert status == 1 and found["wave"][0] == "broken" and found["chain"][0] == "holds"
    assert run("export", board, "-o", board.with_suffix(".html")).exit_code == 0


def test_a_recording_of_another_entry_is_no_proof(board: Path) -> None:
    other = json.dumps(entry(board, "chain").recordings)
    edit(board, f"UPDATE entries SET recordings = '{other}' WHERE name = 'wave'")
    status, found = verdicts(board)
    assert status == 1 and found["wave"][0] == "broken" and "name: listed 'wave'" in found["wave"][1]


@pytest.mark.parametrize("closed", ["2026-01-01", "2026-01-01T00:00:00", "20260101T000000"])
def test_a_time_that_depends_on_where_it_is_read_is_none(proofs: list[str], tmp_path: Path, closed: str) -> None:
    made = rewrite(Path(proofs[0]), tmp_path / "x.mcap", lambda lines: lines, closed=closed)
    with pytest.raises(ProofError, match="does not say when it was closed"):
        prove(made)


REASONS: list[Exception] = [
    ProofError("not_comparable", "it comes out otherwise on this machine"),
    BackendNotFound("there is no engine 'mujoco' here"),
    MissingPackage("an ONNX brain needs onnxruntime"),
    RecordingError("recording_unreadable", "cannot read it: Input/output error"),
    RecordingError("unknown_format", "a recording of format 99"),
    MemoryError(),
    OSError(5, "Input/output error"),
    KeyError("frame"),
    RecursionError("maximum recursion depth exceeded"),
]


@pytest.mark.parametrize("reason", REASONS, ids=lambda reason: getattr(reason, "code", type(reason).__name__))
def test_what_cannot_be_judged_here_is_neither_held_nor_broken_nor_marked(
    board: Path, monkeypatch: pytest.MonkeyPatch, reason: Exception
) -> None:
    first = entry(board).recordings[0]

    def refuse(path: Path, **options: Any) -> Any:
        if Path(path).stem == first:
            raise reason
        return prove(path, **options)

    monkeypatch.setattr(leaderboard_entry, "prove", refuse)
    before = board.read_bytes()
    status, found = verdicts(board, "--write")
    assert status == 3 and found["wave"][0] == "not_judged" and found["chain"][0] == "holds"
    assert board.read_bytes() == before
    assert "could not be judged here" in run("verify", board, "--jobs", "1").stdout
    edit(board, "UPDATE entries SET score = 7.0 WHERE name = 'chain'")
    status, found = verdicts(board, "--write")
    assert status == 1 and found["wave"][0] == "not_judged" and found["chain"][0] == "broken"
    assert [each.name for each in entries_of(board)] == ["wave"]


def test_a_row_that_is_locked_is_not_judged(board: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    number = entry(board).id
    edit(board, f"UPDATE entries SET recordings = '' WHERE id = {number}")
    monkeypatch.setattr(sqlite3, "connect", partial(sqlite3.connect, timeout=0.0))
    with Leaderboard(board) as opened:
        verdicts = opened.verify()
        assert next(verdicts).verdict == "broken"  # of the first row; now somebody else takes the file
        with closing(sqlite3.connect(board, isolation_level=None)) as other:
            other.execute("BEGIN EXCLUSIVE")
            left = list(verdicts)
            assert [(each.verdict, each.reason) for each in left] == [
                ("not_judged", "its row cannot be read: database is locked")
            ]
            for command in (("show", board), ("verify", board), ("export", board, "-o", board.with_suffix(".html"))):
                refused = run(*command)
                assert refused.exit_code != 0 and "database is locked" in refused.stderr and refused.stdout == ""
        assert [each.verdict for each in opened.verify()] == ["broken", "holds"]


def test_what_cannot_be_read_is_not_left_out_of_what_is_shown(board: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def busy(*_: Any) -> Any:
        raise sqlite3.OperationalError("disk I/O error")

    monkeypatch.setattr(leaderboard, "read_row", busy)
    refused = run("show", board)
    assert refused.exit_code == 1 and "disk I/O error" in refused.stderr and refused.stdout == ""


def test_a_board_that_somebody_else_makes_meanwhile_is_taken(
    tmp_path: Path, dash: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    board, create = tmp_path / "board.sqlite", Leaderboard._create

    def late(self: Leaderboard) -> None:
        monkeypatch.undo()
        assert run("tasks", board, "--allow", dash).exit_code == 0
        create(self)

    monkeypatch.setattr(Leaderboard, "_create", late)
    with Leaderboard(board, create=True) as made:
        assert ("dash", Task(DASH).hash) in made.tasks()


def test_an_entry_whose_worker_was_killed_is_not_judged(board: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def killed(function: Any, work: list[Any], jobs: int) -> Iterator[tuple[int, Any]]:
        for index, item in enumerate(work):
            yield index, Lost("the process that worked on it was killed by SIGKILL") if index == 0 else function(item)

    monkeypatch.setattr(leaderboard, "in_processes", killed)
    status, found = verdicts(board, "--write")
    assert status == 3 and sorted(verdict for verdict, _ in found.values()) == ["holds", "not_judged"]
    assert len(entries_of(board)) == 2


def test_verify_writes_only_when_it_is_told_to(board: Path) -> None:
    edit(board, "UPDATE entries SET score = 7.0 WHERE name = 'wave'")
    before = board.read_bytes()
    assert run("verify", board, "--jobs", "1").exit_code == 1
    assert board.read_bytes() == before and len(entries_of(board)) == 2
    assert run("verify", board, "--jobs", "1", "--write").exit_code == 1
    assert [each.name for each in entries_of(board)] == ["chain"]
    assert "wave (broken: score: listed 7.0" in run("show", board, "--broken").stdout
    proved = [prove(recording_of(board, each)) for each in entry(board).recordings]
    true = leaderboard_entry.facts(proved)["score"]
    edit(board, f"UPDATE entries SET score = {true!r} WHERE name = 'wave'")
    assert run("verify", board, "--jobs", "1", "--write").exit_code == 0 and len(entries_of(board)) == 2


# -- copies -----------------------------------------------------------------------------------------------------------


def test_a_renamed_copy_is_not_listed(board: Path, tmp_path: Path) -> None:
    copied = {**renamed(snake(SINE, name="wave")), "name": "mine", "author": "Eve"}
    result = run("add", board, *proofs_of(tmp_path / "copy", copied))
    assert result.exit_code == 1 and "'wave' by 'Ada (unsigned)'" in result.stderr
    assert len(entries_of(board)) == 2


# -- tasks ------------------------------------------------------------------------------------------------------------


def borrowed(path: Path) -> Path:
    document = {**Task.load("walk").document, "objective": "1000000.0", "duration": 0.2, "seeds": [1], "settle": 0.1}
    path.write_text(json.dumps(document))
    return path


def test_a_task_with_a_borrowed_name_is_refused(board: Path, tmp_path: Path) -> None:
    path = borrowed(tmp_path / "mine.json")
    evaluated = CliRunner().invoke(main, ["eval", "walker", "--task", str(path)])
    assert evaluated.exit_code == 2 and "walk" in evaluated.stderr and "ships" in evaluated.stderr
    refused = run("tasks", board, "--allow", path)
    assert refused.exit_code == 2 and "ships" in refused.stderr
    recorded = proofs_of(tmp_path / "forged", Genome.load("walker").document, json.loads(path.read_text()))
    added = run("add", board, *recorded)
    assert added.exit_code == 1 and "does not take" in added.stderr
    # And in the table of tasks, by hand.
    task = Task.load(path)
    edit(board, f"INSERT INTO tasks VALUES ('{task.hash}', 'walk')")
    assert run("add", board, *recorded).exit_code == 1
    assert f"walk is not the task of that name that ships: its hash is {task.hash[:16]}" in run("tasks", board).stdout
    rescored = CliRunner().invoke(main, ["eval", "--from-recording", *recorded])
    assert rescored.exit_code == 0 and task.hash[:16] in rescored.stdout


@pytest.mark.parametrize(
    "command",
    [
        ["play", "walker"],
        ["evolve", "walker", "--algorithm", "ga", "--budget", "1"],
        ["learn", "walker", "--steps", "1"],
        ["survey", "walker", "--worlds", "1", "--task", "walk"],
    ],
    ids=lambda words: words[0],
)
def test_nothing_is_begun_on_a_task_with_a_borrowed_name(command: list[str], tmp_path: Path) -> None:
    path = borrowed(tmp_path / "mine.json")
    result = CliRunner().invoke(main, [*command, "--task", str(path), "-o", str(tmp_path / "made.png")])
    assert result.exit_code == 2 and "mine.json is another task than the walk that ships" in result.stderr
    assert [each.name for each in tmp_path.iterdir()] == ["mine.json"]


def test_settings_and_recordings_with_a_borrowed_name_begin_nothing(tmp_path: Path) -> None:
    task = json.loads(borrowed(tmp_path / "mine.json").read_bytes())
    document = {"format": "nmes-run/1", "task": task, "algorithm": "ga", "budget": 1, "starts": ["walker"]}
    (settings := tmp_path / "settings.json").write_text(json.dumps(document))
    recorded = proofs_of(tmp_path / "forged", Genome.load("walker").document, task)
    for words in (["evolve", "--settings", str(settings)], ["learn", "--algorithm", "clone", *recorded]):
        result = CliRunner().invoke(main, [*words, "-o", str(tmp_path / "run")])
        assert result.exit_code == 2 and "is another task than the walk that ships" in result.stderr, result.output


def test_a_corpus_takes_no_run_on_a_task_with_a_borrowed_name(tmp_path: Path) -> None:
    task = Task.load(borrowed(tmp_path / "mine.json"))
    make_run(tmp_path / "run", [real(genomes()[0], task)], task=task.document)
    refused = CliRunner().invoke(main, ["corpus", "add", str(tmp_path / "mine.jsonl.zst"), str(tmp_path / "run")])
    assert refused.exit_code == 1 and "another task than the walk that ships" in refused.stderr
    (corpus := tmp_path / "theirs.jsonl.zst").touch()
    Corpus({task.hash: CorpusTask(task, task.hash, {})}, (), ()).write(corpus)
    shown = CliRunner().invoke(main, ["corpus", "show", str(corpus)])
    assert shown.exit_code == 0 and f"its hash is {task.hash[:16]}" in shown.stdout


def test_it_is_said_of_runs_that_their_task_has_a_borrowed_name(tmp_path: Path) -> None:
    task = Task.load(borrowed(tmp_path / "mine.json"))
    evolved, learned = tmp_path / "evolved", tmp_path / "learned"
    finish(begin(evolved, task=task.document, budget=2, options={"founders": 2, "population": 2, "window": 2}))
    learning_runs.finish(learning_runs.begin(learned, task=task.document, steps=60))
    line = f"walk is not the task of that name that ships: its hash is {task.hash[:16]}"
    for kind, folder, words in (("evolve", evolved, ["--jobs", "1"]), ("learn", learned, ["--threads", "1"])):
        for command in (["verify", *words], ["resume", *words], ["show"], *([["best"]] if kind == "evolve" else [])):
            told = CliRunner().invoke(main, [kind, command[0], str(folder), *command[1:]])
            said = "walk (not the one that ships)" if command == ["show"] else line
            assert told.exit_code == 0 and said in told.stdout, told.output
        page = tmp_path / f"{kind}.html"
        assert CliRunner().invoke(main, [kind, "show", str(folder), "-o", str(page)]).exit_code == 0
        assert "walk (not the one that ships)" in page.read_text()
        (folder / "log.jsonl").write_text("{}\n")
        told = CliRunner().invoke(main, [kind, "verify", str(folder), *words])
        assert told.exit_code == 1 and line in told.stdout, told.output


def test_an_entry_on_another_version_of_a_shipped_task_is_not_judged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    board, path = tmp_path / "board.sqlite", borrowed(tmp_path / "mine.json")
    recorded = proofs_of(tmp_path / "forged", Genome.load("walker").document, json.loads(path.read_text()))
    with monkeypatch.context() as patch:  # as a version does with which this one ships
        patch.setattr(leaderboard, "borrows_name", lambda *_: False)
        assert run("tasks", board, "--allow", path).exit_code == 0
        assert run("add", board, *recorded).exit_code == 0 and verdicts(board)[0] == 0
    status, found = verdicts(board, "--write")
    assert status == 3 and found["walker"][0] == "not_judged" and "another walk" in found["walker"][1]
    assert "walk (not the one that ships)" in run("show", board).stdout


def test_an_entry_on_a_task_with_a_borrowed_name_is_not_held(board: Path) -> None:
    edit(board, "UPDATE entries SET task = 'walk' WHERE name = 'wave'")
    status, found = verdicts(board)
    assert status == 1 and found["wave"][0] == "broken"
    task_hash = entry(board).task_hash
    assert f"walk (not the one that ships) {task_hash[:16]}" in run("show", board).stdout
    run("export", board, "-o", board.with_suffix(".html"))
    assert "walk (not the one that ships)" in board.with_suffix(".html").read_text()


def diverging(lines: list[Line]) -> list[Line]:
    """Returns the lines of a recording whose last tick comes out otherwise, which is found when it is run."""
    at = [number for number, line in enumerate(lines) if line.topic == "ticks"][-1]
    ticks = json.loads(lines[at].data)
    ticks["digests"][-1] = "0" * 32
    return changed(lines, at, json.dumps(ticks).encode())


def test_a_recording_of_a_task_that_is_not_taken_is_not_run(board: Path, proofs: list[str], tmp_path: Path) -> None:
    forged = [rewrite(Path(path), tmp_path / f"{number}.mcap", diverging) for number, path in enumerate(proofs[:2])]
    assert "it diverges at frame" in run("add", board, *forged).stderr
    refused = run("add", tmp_path / "other.sqlite", *forged)
    assert refused.exit_code == 1 and refused.stderr.count("does not take the task dash") == 2
    assert "diverges" not in refused.stderr


def test_an_entry_whose_recordings_are_of_another_task_is_found_before_they_are_run(
    board: Path, tmp_path: Path
) -> None:
    (sprint := tmp_path / "sprint.json").write_text(json.dumps({**DASH, "name": "sprint"}))
    assert run("tasks", board, "--allow", sprint).exit_code == 0
    forged = [
        rewrite(recording_of(board, each), tmp_path / f"{number}.mcap", diverging)
        for number, each in enumerate(entry(board).recordings)
    ]
    names = [sha256(path.read_bytes()).hexdigest() for path in forged]
    for name, path in zip(names, forged, strict=True):
        path.rename(recording_of(board, name))
    edit(board, f"UPDATE entries SET recordings = '{json.dumps(names)}' WHERE name = 'wave'")
    assert "it diverges at frame" in verdicts(board)[1]["wave"][1]
    edit(board, f"UPDATE entries SET task_hash = '{Task.load(sprint).hash}' WHERE name = 'wave'")
    status, found = verdicts(board)
    assert status == 1 and found["wave"][0] == "broken" and found["wave"][1].startswith("task_hash: listed ")


def test_a_board_takes_the_tasks_that_ship_and_those_it_is_told_to(
    tmp_path: Path, dash: Path, proofs: list[str]
) -> None:
    board = tmp_path / "board.sqlite"
    refused = run("add", board, *proofs)
    assert refused.exit_code == 1 and "does not take the task dash" in refused.stderr
    listed = json.loads(run("tasks", board, "--json").stdout)
    shipped = [*map(Task.load, Task.names()), *map(MatchTask.load, MATCHES.names())]
    assert listed == sorted(({"name": each.name, "hash": each.hash} for each in shipped), key=lambda each: each["name"])
    assert run("tasks", board, "--allow", dash).exit_code == 0
    assert ["dash", Task(DASH).hash] in [line.split() for line in run("tasks", board).stdout.splitlines()]
    assert run("add", board, *proofs).exit_code == 0
    edit(board, f"DELETE FROM tasks WHERE hash = '{Task(DASH).hash}'")
    assert verdicts(board)[0] == 1


def test_hashes_are_shown_with_16_digits(board: Path) -> None:
    wave, table, page = entry(board), run("show", board).stdout, board.with_suffix(".html")
    run("export", board, "-o", page)
    for text in (table, page.read_text()):
        for digest in (wave.task_hash, wave.genome_hash, wave.recording_hash):
            assert digest[:16] in text


# -- names and files --------------------------------------------------------------------------------------------------


def test_hostile_names_are_shown_and_forge_no_row(board: Path) -> None:
    hostile = "'x' || char(10) || 'forged' || char(27) || '[31m' || char(8238) || '<script>'"
    edit(
        board,
        *(f"UPDATE entries SET {column} = {hostile} WHERE name = 'chain'" for column in ("task", "author", "broken")),
    )
    edit(board, f"UPDATE entries SET name = {hostile} WHERE name = 'chain'")
    for arguments in (("show",), ("show", "--broken"), ("show", "--json"), ("verify", "--jobs", "1")):
        text = run(arguments[0], board, *arguments[1:]).stdout
        assert not any(line.startswith("forged") for line in text.splitlines())
    assert r"x\nforged\x1b[31m\u202e" in run("show", board, "--broken").stdout
    edit(board, "UPDATE entries SET broken = NULL")
    page = board.with_suffix(".html")
    run("export", board, "-o", page)
    text = page.read_text()
    assert "<script>" not in text and r"x\nforged\x1b[31m\u202e&lt;script&gt;" in text


@pytest.mark.parametrize("link", [None, Path.symlink_to, Path.hardlink_to])
def test_a_page_does_not_take_the_place_of_its_board(board: Path, link: Callable[[Path, Path], None] | None) -> None:
    page, before = board, board.read_bytes()
    if link is not None:
        page = board.with_name("page.html")
        link(page, board)
    result = run("export", board, "-o", page)
    assert result.exit_code == 2 and "board.sqlite" in result.stderr
    assert board.read_bytes() == before
