"""Leaderboards: nothing is listed that its recordings do not prove."""

from __future__ import annotations

import base64
import hashlib
import io
import json
import re
import sqlite3
import subprocess
import sys
import time
from pathlib import Path
from statistics import pstdev
from typing import Any
from urllib.parse import unquote

import orjson
import pytest
from click.testing import CliRunner, Result
from PIL import Image, ImageSequence
from test_evaluation import task

from boards import entries_of, recording_of
from creatures import SINE, cpg, snake
from nmes.cli import main
from nmes.errors import LeaderboardError, ProofError
from nmes.evaluation import Task, evaluate, prove
from nmes.evaluation.leaderboard import Leaderboard
from nmes.evaluation.leaderboard_entry import Verdict
from nmes.evaluation.task import CREATURE
from nmes.genome import Genome
from nmes.protocol import parse, request_from
from nmes.recording import Recorder, Recording
from nmes.world import World
from opengl import with_opengl
from recordings import Line, rewrite

NMES = str(Path(sys.executable).parent / "nmes")


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["leaderboard", *map(str, arguments)])


@pytest.fixture(scope="module")
def proofs(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Recordings of two creatures, of two episodes each."""
    folder = tmp_path_factory.mktemp("proofs")
    return [
        path
        for brain, name in ((SINE, "wave"), (cpg(4), "<b>chain</b>"))
        for path in evaluate(Genome(snake(brain, name=name, author="Ada & Co")), task(), record=folder).recordings
    ]


@pytest.fixture
def board(tmp_path: Path, proofs: list[str]) -> Path:
    """A leaderboard with both."""
    path = new_board(tmp_path / "board.sqlite", task())
    result = run("add", path, *proofs)
    assert result.exit_code == 0, result.output
    return path


def new_board(path: Path, *tasks: Task) -> Path:
    """Makes a leaderboard that takes these tasks."""
    with Leaderboard(path, create=True) as board:
        for each in tasks:
            board.allow(each)
    return path


def test_proved_entries_are_listed_best_first(board: Path, proofs: list[str]) -> None:
    shown = json.loads(run("show", board, "--json").stdout)
    expected = {prove(path).genome.hash for path in proofs}
    assert {entry["genome_hash"] for entry in shown} == expected and len(shown) == 2
    assert shown[0]["score"] >= shown[1]["score"]
    scores = [prove(path).result.score for path in proofs[:2]]
    (wave,) = (entry for entry in shown if entry["name"] == "wave")
    assert wave["score"] == pytest.approx(sum(score for score in scores if score is not None) / 2, abs=0)
    assert wave["author"] == "Ada & Co" and wave["task"] == "dash" and wave["key"] == ""
    for digest in wave["recordings"]:
        assert Recording(board.with_suffix(".recordings") / f"{digest}.mcap").complete
    closed = max(prove(path).recorded for path in proofs[:2])
    assert wave["recorded"] == closed and closed.endswith("+00:00")
    lines = run("show", board).stdout.splitlines()
    assert len(lines) == 3 and "wave" in lines[1] + lines[2] and lines[1].split()[2] == "1"
    assert run("show", board, "--task", "walk").stdout.count("\n") == 1
    assert run("show", board, "--top", "1").stdout.count("\n") == 2
    assert run("verify", board, "--jobs", "2").stdout == "2 of 2 entries hold\n"


def test_one_entry_can_be_verified_alone(board: Path, tmp_path: Path) -> None:
    entries = {entry["name"]: entry for entry in json.loads(run("show", board, "--json").stdout)}
    (other,) = {*entries} - {"wave"}
    for digest in entries["wave"]["recordings"]:
        (board.with_suffix(".recordings") / f"{digest}.mcap").unlink()
    one, gone = str(entries[other]["id"]), str(entries["wave"]["id"])
    assert run("verify", board, one, "--jobs", "1").stdout == "1 of 1 entries hold\n"
    (verdict,) = json.loads(run("verify", board, gone, "--json").stdout)
    assert (verdict["id"], verdict["verdict"]) == (int(gone), "broken")
    assert run("verify", board, gone, one, "--jobs", "1").stdout.endswith("1 of 2 entries hold, 1 broken\n")
    missing = run("verify", board, one, "77")
    assert missing.exit_code == 2 and "has no entry 77" in missing.stderr


def test_a_name_that_is_anothers_is_found_in_one_entry(board: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with sqlite3.connect(board) as database:
        database.execute("UPDATE entries SET author = 'Ada', key = CASE id WHEN 1 THEN 'a' ELSE 'b' END")
    database.close()
    monkeypatch.setattr(
        "nmes.evaluation.leaderboard.examine",
        lambda work: Verdict(work[0].id, work[0].task, work[0].name, "holds", None),
    )
    with Leaderboard(board) as opened:
        (second,), (first,) = opened.verify(only=[2]), opened.verify(only=[1])
    assert (second.id, second.verdict) == (2, "broken") and "another key" in str(second.reason)
    assert (first.id, first.verdict) == (1, "holds")


def test_entries_are_listed_once_and_whole(board: Path, proofs: list[str], tmp_path: Path) -> None:
    again = run("add", board, *proofs[:2])
    assert again.exit_code == 1 and "listed for the task dash already" in again.stderr
    new_board(tmp_path / "other.sqlite", task())
    part = run("add", tmp_path / "other.sqlite", proofs[0])
    assert part.exit_code == 1 and "one recording for each of the seeds 3, 4" in part.stderr
    assert entries_of(tmp_path / "other.sqlite") == []


def forged(source: str, target: Path, change: Any) -> Path:
    """Rewrites the 40th `drive` of a recording; its chain and checksums are in order."""
    seen = 0

    def edit(lines: list[Line]) -> list[Line]:
        nonlocal seen
        for i, line in enumerate(lines):
            if line.topic == "commands" and b'"drive"' in line.data:
                seen += 1
                if seen == 40:
                    said = orjson.loads(line.data)
                    said["message"] = change(said["message"])
                    lines[i] = line._replace(data=orjson.dumps(said))
        # The checksums of single records are only believed where a chunk is not as its chain says.
        return lines

    path = rewrite(Path(source), target, edit)
    assert seen >= 40 and Recording(path).complete
    return path


def test_a_forged_command_is_refused_with_the_first_frame_that_differs(proofs: list[str], tmp_path: Path) -> None:
    path = forged(proofs[0], tmp_path / "forged.mcap", lambda drive: {**drive, "controls": [1.0, 1.0, 1.0]})
    frame = task().settle_ticks + 40
    with pytest.raises(ProofError, match=rf"diverges at frame {frame}: tick {frame} does not come out") as caught:
        prove(path)
    assert caught.value.code == "diverged"
    with Leaderboard(tmp_path / "board.sqlite", create=True) as made:
        made.allow(task())
    refused = run("add", tmp_path / "board.sqlite", path, proofs[1])
    assert refused.exit_code == 1 and f"frame {frame - 1}" in refused.stderr  # the brain would not have said that
    assert entries_of(tmp_path / "board.sqlite") == []


def played(target: Path, seed: int, meddle: Any) -> Path:
    """Records an honest run of dishonest commands: `meddle` is shown each tick, and may do what it likes."""
    genome, dash = Genome(snake()), task()
    world = World(dash.world_config(seed))
    about = {"task": json.dumps(dash.document), "genome": genome.hash, "seed": str(seed)}
    recorder = world.journal = Recorder(target, world, about={"nmes.evaluation": about})
    client = world.join()
    for command in dash.entry(seed, genome.document, genome.body):
        world.handle(client, parse(orjson.dumps(command)))
    for _ in range(dash.settle_ticks):
        world.tick()
    for tick in range(dash.ticks):
        meddle(world, client, tick)
        world.tick()
    world.leave(client)
    recorder.close()
    world.close()
    return target


def drive(world: World, client: int, controls: list[float]) -> None:
    world.handle(client, request_from({"type": "drive", "creature": CREATURE, "controls": controls}))


def test_commands_that_the_brain_did_not_give_are_refused(tmp_path: Path) -> None:
    path = played(tmp_path / "by-hand.mcap", 3, lambda world, client, tick: drive(world, client, [0.5, -0.5, 0.5]))
    assert prove(path).result.score is not None  # the log alone does not say who drove
    with pytest.raises(ProofError, match=r"at frame 30 it has the command drive where there should be what the br"):
        prove(path, brain=True)


def test_a_recording_in_which_somebody_pushes_the_creature_is_refused(tmp_path: Path) -> None:
    def push(world: World, client: int, tick: int) -> None:
        if tick == 7:
            force = {"type": "apply_physics", "cube_name": f"{CREATURE}.c0", "impulse": [9, 0, 0]}
            world.handle(client, request_from(force))
        drive(world, client, [0.0, 0.0, 0.0])

    with pytest.raises(ProofError, match="at frame 37 it has the command apply_physics"):
        prove(played(tmp_path / "pushed.mcap", 3, push))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ("UPDATE entries SET score = score + 1 WHERE name = 'wave'", "score: listed "),
        ("UPDATE entries SET task_hash = genome_hash WHERE name = 'wave'", "does not take its task"),
    ],
)
def test_a_forged_entry_is_found_and_hidden(board: Path, change: str, reason: str) -> None:
    with sqlite3.connect(board) as database:
        true = database.execute("SELECT score, task_hash FROM entries WHERE name = 'wave'").fetchone()
        database.execute(change)
    database.close()
    result = run("verify", board, "--jobs", "1", "--write")
    assert result.exit_code == 1 and reason in result.stdout and "1 of 2 entries hold" in result.stdout
    assert [entry.name for entry in entries_of(board)] == ["<b>chain</b>"]
    assert "(broken: " in run("show", board, "--broken").stdout
    with sqlite3.connect(board) as database:
        database.execute("UPDATE entries SET score = ?, task_hash = ? WHERE name = 'wave'", true)
    database.close()
    assert run("verify", board, "--jobs", "1", "--write").exit_code == 0 and len(entries_of(board)) == 2


def test_a_forged_or_missing_recording_is_found(board: Path, tmp_path: Path) -> None:
    wave = next(entry for entry in entries_of(board) if entry.name == "wave")
    file = recording_of(board, wave.recordings[1])
    content = file.read_bytes()
    file.unlink()
    assert file.name in run("verify", board, "--jobs", "1").stdout
    file.write_bytes(
        content[: len(content) // 2] + bytes([content[len(content) // 2] ^ 1]) + content[len(content) // 2 + 1 :]
    )
    assert run("verify", board, "--jobs", "1").exit_code == 1
    file.write_bytes(content)
    new = forged(str(file), tmp_path / "new.mcap", lambda drive: {**drive, "controls": [0.0, 0.0, 0.0]})
    file.write_bytes(new.read_bytes())
    assert "is not the recording that was listed" in run("verify", board, "--jobs", "1").stdout
    digest = hashlib.sha256(new.read_bytes()).hexdigest()
    file.rename(file.with_stem(digest))
    with sqlite3.connect(board) as database:
        recordings = json.dumps([wave.recordings[0], digest])
        database.execute("UPDATE entries SET recordings = ? WHERE name = 'wave'", (recordings,))
    database.close()
    result = run("verify", board, "--jobs", "1")
    assert result.exit_code == 1 and "frame" in result.stdout


def test_a_file_that_is_no_leaderboard_is_an_error(tmp_path: Path) -> None:
    assert "there is no leaderboard" in run("show", tmp_path / "none.sqlite").stderr
    (tmp_path / "empty.sqlite").touch()
    for command in (("show",), ("verify",), ("export", "-o", tmp_path / "x.html")):
        result = run(*command, tmp_path / "empty.sqlite")
        assert result.exit_code == 2 and "empty.sqlite is empty" in result.stderr
    assert (tmp_path / "empty.sqlite").stat().st_size == 0
    (tmp_path / "text.sqlite").write_text("hello, this is no database at all")
    assert "text.sqlite" in run("show", tmp_path / "text.sqlite").stderr
    sqlite3.connect(tmp_path / "other.sqlite").execute("CREATE TABLE t (x)").connection.close()
    assert "no leaderboard" in run("show", tmp_path / "other.sqlite").stderr


def test_ten_thousand_entries_are_shown_whole(board: Path) -> None:
    with sqlite3.connect(board) as database:
        database.execute(
            "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 10000)"
            " INSERT INTO entries SELECT NULL, task, task_hash, name || i, genome_hash, printf('%064x', i), author,"
            " key, score - i, spread, players, recordings, recorded, NULL FROM entries, n WHERE name = 'wave'"
        )
    database.close()
    began = time.perf_counter()
    shown = subprocess.run([NMES, "leaderboard", "show", str(board)], capture_output=True, check=True)
    seconds = time.perf_counter() - began
    lines = shown.stdout.decode().splitlines()
    assert len(lines) == 10_003 and len(set(map(len, lines))) < 20
    print(f"10,002 entries shown in {seconds:.2f} s")


@with_opengl
def test_a_leaderboard_page_is_one_file_with_a_picture_of_each_creature(board: Path, tmp_path: Path) -> None:
    page = tmp_path / "board.html"
    result = run("export", board, "-o", page)
    assert result.exit_code == 0 and "2 entries" in result.stdout
    text = page.read_text()
    assert text.count("<li>") == 2
    assert text.count('src="data:image/gif;base64,') == 1, "the best is filmed"
    assert text.count('src="data:image/png;base64,') == 1
    film = base64.b64decode(re.findall('src="data:image/gif;base64,([^"]*)"', text)[0])
    with Image.open(io.BytesIO(film)) as image:
        assert image.size == (240, 180) and len(list(ImageSequence.Iterator(image))) > 4
    entries = entries_of(board)
    for entry in entries:
        scores = [prove(recording_of(board, each)).result.score or 0.0 for each in entry.recordings]
        assert entry.spread == pstdev(scores) > 0 and f"{entry.score:.6g}<small>± {entry.spread:.3g}</small>" in text
    links = re.findall('<a href="([^"]*)">(seed [0-9]+)</a>', text)
    assert [name for _, name in links] == ["seed 3", "seed 4"] * 2
    assert [Path(link).stem for link, _ in links] == [each for entry in entries for each in entry.recordings]
    assert all((page.parent / unquote(link)).is_file() for link, _ in links)
    assert f"nmes leaderboard verify {board.name}" in text and task().description in text
    assert "spread" in run("show", board).stdout.splitlines()[0]
    assert "&lt;b&gt;chain&lt;/b&gt;" in text and "<b>chain</b>" not in text and "Ada &amp; Co" in text
    assert "http" not in text and "<script" not in text


def test_a_task_that_is_edited_is_another_task(board: Path, proofs: list[str], tmp_path: Path) -> None:
    easier = Task({**task().document, "objective": "10 + displacement.horizontal"})
    evaluation = evaluate(Genome(snake(name="wave")), easier, record=tmp_path)
    assert run("add", board, *evaluation.recordings).exit_code == 1
    new_board(board, easier)
    assert run("add", board, *evaluation.recordings).exit_code == 0
    shown = entries_of(board)
    assert len(shown) == 3 and len({entry.task_hash for entry in shown}) == 2
    with Leaderboard(board) as opened, pytest.raises(LeaderboardError, match="one recording for each"):
        opened.add([prove(evaluation.recordings[0]), prove(proofs[1])])


def test_a_forked_recording_is_refused(proofs: list[str], tmp_path: Path) -> None:
    ahead = tmp_path / "ahead.mcap"
    forked = CliRunner().invoke(main, ["fork", proofs[0], "--at", "0", "-o", str(ahead)])
    assert forked.exit_code == 0, forked.output
    with pytest.raises(ProofError, match="no recording of `nmes eval`"):
        prove(ahead)
