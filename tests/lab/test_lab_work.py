"""Genomes, tasks, runs, scores and leaderboards of a lab: the same as from the command line."""

from __future__ import annotations

import asyncio
import json
import sqlite3
import subprocess
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from labs import RunningLab, running_lab
from nmes.cli import main
from nmes.evaluation import Task, evaluate
from nmes.evaluation.episode import METADATA
from nmes.evaluation.leaderboard import Leaderboard
from nmes.evaluation.match import play
from nmes.evolution.run import Run
from nmes.genome import Genome
from nmes.lab.folder import Folder
from nmes.lab.index import Index
from nmes.world import World
from processes import NMES
from recordings import busy, record, rewrite, send
from servers import PATIENCE, until

WALKER: Any = Genome.load("walker").document
SETTINGS = {"task": "walk", "algorithm": "ga", "budget": 24, "seed": 3, "seeds": [1], "starts": ["mine"]}


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningLab]:
    with running_lab(tmp_path_factory.mktemp("lab")) as running:
        running.good("/api/genomes/mine", json.dumps(WALKER).encode(), "PUT")  # with which `SETTINGS` begins
        yield running


def test_a_genome_that_is_saved_is_the_file_that_the_command_line_reads(lab: RunningLab) -> None:
    text = json.dumps({**WALKER, "name": "<script>alert(1)</script>"}, indent=1).encode()
    saved = lab.good("/api/genomes/mine", text, "PUT")
    file = lab.folder / "genomes" / "mine.json"
    assert file.read_bytes() == text and saved["hash"] == Genome.load(file).hash
    assert saved["command"] == f"nmes genome check {file}"
    assert lab.good("/api/genomes/mine")["name"] == "<script>alert(1)</script>"
    listed = {each["name"]: each["ships"] for each in lab.good("/api/genomes")["items"]}
    assert listed["mine"] is False and listed["walker"] is True
    status, answer = lab.ask("/api/genomes/bad", b'{"format": "nmes-genome/1"}', "PUT")
    assert status == 422 and answer["error"]["problems"] and lab.ask("/api/genomes/bad")[0] == 404
    assert lab.ask("/api/genomes/walker", text, "PUT")[1]["error"]["code"] == "name_taken"
    assert lab.good("/api/genomes/walker") == WALKER
    lab.good("/api/genomes/gone", text, "PUT")
    assert lab.ask("/api/genomes/gone", method="DELETE")[0] == 200 and lab.ask("/api/genomes/gone")[0] == 404


def test_a_genome_is_checked_as_the_command_line_checks_it(lab: RunningLab, tmp_path: Path) -> None:
    broken = json.loads(json.dumps(WALKER))
    broken["body"]["cubes"][1]["size"] = [0, 1]
    broken["body"]["joints"][0]["cube2"] = "<b>nobody</b>"
    for document in (WALKER, broken, {"format": "nmes-genome/1", "name": "x", "body": {}}):
        file = tmp_path / "x.json"
        file.write_text(json.dumps(document))
        (row,) = json.loads(CliRunner().invoke(main, ["genome", "check", "--json", str(file)]).output)
        answer = lab.good("/api/genomes/check", document)
        assert (answer["problems"], answer["hash"]) == (row["problems"], row["hash"])
    body = lab.good("/api/genomes/check", WALKER)["body"]
    assert [cube["id"] for cube in body["cubes"]] == [cube.id for cube in Genome.load("walker").body.cubes]
    assert lab.good("/api/genomes/check", {"format": "x"})["body"] is None


def test_every_genome_that_ships_can_be_drawn(lab: RunningLab) -> None:
    for name in Genome.names():
        answer = lab.good("/api/genomes/check", Genome.load(name).document)
        assert not answer["problems"] and len(answer["body"]["cubes"]) == len(Genome.load(name).body.cubes)


def test_a_mutant_is_that_of_the_command_line(lab: RunningLab) -> None:
    asked: dict[str, Any]
    options: list[str]
    for asked, options in (
        ({}, []),
        ({"kind": "add-part", "task": "walk", "seed": 7}, ["--kind", "add-part", "--task", "walk"]),
    ):
        answer = lab.good("/api/genomes/mutate", {"genome": WALKER, **asked})
        seed = str(asked.get("seed", 0))
        printed = CliRunner().invoke(main, ["genome", "mutate", "walker", *options, "--seed", seed]).output
        assert answer["genome"] == json.loads(printed)
        assert answer["command"] == " ".join(["nmes genome mutate walker.json", *options, "--seed", seed])
    for asked, code in (
        ({"kind": "<b>"}, "unknown_mutation"),
        ({"seed": -1}, "invalid"),
        ({"task": "../x"}, "unknown_name"),
    ):
        assert lab.ask("/api/genomes/mutate", {"genome": WALKER, **asked})[1]["error"]["code"] == code


def test_a_run_that_was_paused_and_resumed_is_that_of_the_command_line(lab: RunningLab, tmp_path: Path) -> None:
    lab.good("/api/genomes/mine", json.dumps(WALKER).encode(), "PUT")  # a test above saves another
    genome, folder = str(lab.folder / "genomes" / "mine.json"), str(tmp_path / "run")
    endless = {**SETTINGS, "budget": 100_000}  # so that it can be paused, however late that is asked for
    job = lab.good("/api/runs", {"kind": "evolve", "name": "first", "settings": endless})
    assert job["command"] == (
        f"nmes evolve --settings {lab.folder}/settings/first.json -o {lab.folder}/runs/first --json"
    )
    until(lambda: (lab.folder / "runs/first/log.jsonl").is_file() and lab.good("/api/runs/first")["told"] > 0, 6000)
    assert lab.ask("/api/runs/first/resume", {})[1]["error"]["code"] == "busy"
    lab.good("/api/runs/first/pause", {})
    ended = lab.ended(job["id"])
    about = lab.good("/api/runs/first")
    assert ended["status"] == 1 and about["state"] == "paused", ended
    total = about["told"] + 8
    assert lab.ask("/api/runs/first/pause", {})[1]["error"]["code"] == "not_running"
    resumed = lab.ended(lab.good("/api/runs/first/resume", {"budget": total})["id"])
    assert resumed["status"] == 0, resumed
    about = lab.good("/api/runs/first")
    assert (about["state"], about["told"]) == ("finished", total)
    options = ["--task", "walk", "--budget", str(total), "--seed", "3", "--seeds", "1", "--jobs", "1", "-o", folder]
    command = [NMES, "evolve", genome, *options, "--json"]
    expected = subprocess.run(command, capture_output=True, check=True, timeout=4 * PATIENCE)
    assert about["digest"] == resumed["result"]["digest"] == json.loads(expected.stdout)["digest"]
    again = lab.ended(lab.good("/api/runs/first/resume", {})["id"])  # with the budget that it has
    assert (again["status"], again["result"]["digest"]) == (0, about["digest"])
    run = Run.open(tmp_path / "run")
    assert run.best is not None and about["best"] == {"index": run.best.index, "score": run.best.score}
    assert about["curve"][-1]["best"] == run.best.score and about["lineage"][-1]["index"] == run.best.index
    for budget in (total - 1, 0, -1, "x", True, 1.5, 1 << 40):
        assert lab.ask("/api/runs/first/resume", {"budget": budget})[1]["error"]["path"] == "budget", budget
    for number in (str(run.best.index), "best"):
        assert lab.good(f"/api/runs/first/candidates/{number}/genome") == run.genome(run.best.index).document
    for number in (str(total), "-1", "x", "%2e%2e"):
        assert lab.ask(f"/api/runs/first/candidates/{number}/genome")[0] == 404
    until(lambda: any(item["details"] for item in lab.good("/api/runs")["items"]))  # the folder is listed beside it
    (item,) = lab.good("/api/runs")["items"]
    assert (item["name"], item["details"]["kind"], item["details"]["told"]) == ("first", "evolve", total)


def test_settings_that_are_none_start_nothing(lab: RunningLab) -> None:
    for settings in (
        {**SETTINGS, "budget": 0},
        {**SETTINGS, "algorithm": "<b>"},
        {**SETTINGS, "options": {"x": 1}},
        {},
    ):
        status, answer = lab.ask("/api/runs", {"kind": "evolve", "name": "none", "settings": settings})
        assert status == 422 and answer["error"]["problems"]
    for learn in (
        {"genome": "walker", "options": {"x": 1}},
        {"genome": "walker", "steps": 0},
        {"genome": "x"},
        {"genome": "walker", "task": {}},
        {"a": 1},
        {"algorithm": "clone"},
        {"algorithm": "clone", "recordings": []},
        {"algorithm": "clone", "recordings": ["x"] * 101},
        {"algorithm": "clone", "recordings": "x"},
        {"algorithm": "clone", "recordings": ["x"], "genome": "walker"},
    ):
        assert lab.ask("/api/runs", {"kind": "learn", "name": "none", "settings": learn})[0] == 422
    missing = {"kind": "learn", "name": "none", "settings": {"algorithm": "clone", "recordings": ["../x"]}}
    assert lab.ask("/api/runs", missing)[0] in (400, 404)
    for asked in ({"kind": "rm", "name": "x", "settings": {}}, {"kind": "evolve", "name": 1, "settings": {}}, {}):
        assert lab.ask("/api/runs", asked)[0] == 422
    assert lab.ask("/api/runs", {"kind": "evolve", "name": "../x", "settings": SETTINGS})[0] == 400
    assert not (lab.folder / "runs" / "none").exists()
    assert lab.ask("/api/runs/none")[0] == 404 and lab.ask("/api/runs/none/resume", {})[0] == 404


@pytest.mark.long
def test_a_run_of_learning_is_begun_by_the_command_that_is_shown(lab: RunningLab) -> None:
    settings = {"genome": "walker", "task": "walk", "algorithm": "ppo", "steps": 64, "seed": 2, "every": 1}
    options = {"rows": 2, "ticks": 16, "rate": 0.001}
    begun = {"kind": "learn", "name": "learned", "settings": {**settings, "options": options, "reward": "-velocity.x"}}
    job = lab.good("/api/runs", begun)
    assert job["command"].startswith("nmes learn walker --task walk --algorithm ppo --every 1 --reward -velocity.x")
    ended = lab.ended(job["id"])
    assert ended["status"] == 0, ended
    about = lab.good("/api/runs/learned")
    assert (about["kind"], about["state"]) == ("learn", "finished")
    assert about["digest"] == ended["result"]["digest"] and about["legs"]
    refused = lab.ask("/api/runs/learned/resume", {"budget": 128})
    assert refused[0] == 422 and "begin another like it" in refused[1]["error"]["message"]


def test_no_more_commands_run_at_once_than_may(lab: RunningLab) -> None:
    long = {**Task.load("walk").document, "name": "long", "seeds": list(range(1, 1001))}
    (lab.folder / "tasks").mkdir(exist_ok=True)
    (lab.folder / "tasks/long.json").write_text(json.dumps(long))
    started = [lab.ask("/api/scores", {"genome": "walker", "task": task}) for task in ("walk", *["long"] * 5)]
    assert 429 in {status for status, _ in started}
    jobs = [job["id"] for status, job in started if status == 200]
    for job in jobs[1:]:
        lab.good(f"/api/jobs/{job}/stop", {})
    scored = lab.ended(jobs[0])
    assert scored["status"] == 0 and json.dumps(scored["result"]).count("score") > 0
    assert all(lab.ended(job)["status"] != 0 for job in jobs[1:])
    assert {job["id"] for job in lab.good("/api/jobs")["items"]} >= set(jobs)


def test_a_leaderboard_is_listed_and_verified(lab: RunningLab) -> None:
    Leaderboard(lab.folder / "leaderboards" / "board.sqlite", create=True).close()
    (lab.folder / "leaderboards" / "torn.sqlite").write_bytes(b"no leaderboard")
    assert [each["name"] for each in lab.good("/api/leaderboards")["items"]] == ["board", "torn"]
    board = lab.good("/api/leaderboards/board")
    assert board["items"] == [] and "walk" in {task["name"] for task in board["tasks"]}
    assert lab.ask("/api/leaderboards/torn")[1]["error"]["code"] == "no_leaderboard"
    assert lab.ended(lab.good("/api/leaderboards/board/verify", {})["id"])["result"] == []
    job = lab.good("/api/leaderboards/board/verify", {"entry": 3})
    assert job["command"].endswith("board.sqlite 3 --json") and lab.ended(job["id"])["status"] == 2
    for number in (3, 0, "3", None):
        assert lab.ask("/api/leaderboards/board/film", {"entry": number})[0] == 404
    assert lab.ask("/api/films/board-3/file")[0] == 404
    for entry in (0, "3", [3], "--write", True, 1.5):
        status, told = lab.ask("/api/leaderboards/board/verify", {"entry": entry})
        assert status == 422 and told["error"]["code"] == "invalid", entry


@pytest.mark.long
def test_runs_that_go_on_when_the_lab_ends_can_be_gone_on_with(tmp_path: Path) -> None:
    with running_lab(tmp_path / "lab") as lab:
        settings = {**SETTINGS, "budget": 100_000, "starts": ["walker"]}
        lab.good("/api/runs", {"kind": "evolve", "name": "long", "settings": settings})
        until(lambda: lab.ask("/api/runs/long")[0] == 200 and lab.good("/api/runs/long")["told"] > 0, 6000)
    told = len(Run.open(tmp_path / "lab/runs/long"))
    with running_lab(tmp_path / "lab") as lab:
        assert lab.good("/api/runs/long")["state"] == "paused" and lab.good("/api/runs/long")["told"] == told


def test_a_list_of_recordings_names_the_creatures_and_the_task_of_an_episode(tmp_path: Path) -> None:
    folder = tmp_path / "lab" / "recordings"
    folder.mkdir(parents=True)
    evaluate("walker", "walk", seeds=[1], record=folder)
    play("sumo", {"red": "walker", "blue": "seeker"}, seeds=[1], record=folder)
    record(folder / "plain.mcap", busy)
    with running_lab(tmp_path / "lab") as lab:
        until(lambda: all(each["details"] for each in lab.good("/api/recordings")["items"]))
        details = [each["details"] for each in lab.good("/api/recordings")["items"]]
        told = {(each["creature"], each["task"]) for each in details}
        assert told == {("walker", "walk"), ("walker, seeker", "sumo"), (None, None)}


def test_a_list_of_recordings_minds_no_odd_genome_in_one(tmp_path: Path) -> None:
    """Two genomes that no world takes, in what says that it is an episode."""

    def odd(world: World, client: int) -> None:
        for genome in ({}, {"name": ["x"]}, {"name": "a stranger"}):
            send(world, client, type="spawn_creature", genome=genome)
        send(world, client, type="step")

    folder = Folder(tmp_path / "lab")
    about = {METADATA: {"task": '{"name": "walk"}'}}
    plain = record(tmp_path / "plain.mcap", odd)
    rewrite(plain, folder.path / "recordings" / "odd.mcap", lambda lines: lines, about=about)

    async def read() -> Any:
        index = Index(folder)
        while (details := (await index.page("recordings"))["items"][0]["details"]) is None:
            pass
        await index.close()
        return details

    details = asyncio.run(read())
    assert (details["creature"], details["task"]) == ("a stranger", "walk")


def test_a_list_is_read_on_when_the_disk_has_room_again(tmp_path: Path) -> None:
    folder = Folder(tmp_path / "lab")
    record(folder.path / "recordings" / "plain.mcap", busy)

    async def read() -> Any:
        index = Index(folder)
        with closing(sqlite3.connect(folder.path / ".index.sqlite")) as disk:
            disk.execute("CREATE TRIGGER full BEFORE UPDATE ON things BEGIN SELECT RAISE(ABORT, 'full'); END")
            with pytest.raises(sqlite3.Error, match="full"):
                while True:
                    await index.page("recordings")
            disk.execute("DROP TRIGGER full")
        while (details := (await index.page("recordings"))["items"][0]["details"]) is None:
            pass
        await index.close()
        return details

    assert asyncio.run(read())["frames"] > 0


def test_a_long_list_comes_in_pages_the_newest_first(tmp_path: Path) -> None:
    folder = tmp_path / "lab" / "recordings"
    folder.mkdir(parents=True)
    for number in range(250):
        (folder / f"r{number:03}.mcap").write_bytes(b"no recording")
    with running_lab(tmp_path / "lab") as lab:
        seen, after, pages = [], "", 0
        while True:
            page = lab.good(f"/api/recordings?after={after}" if after else "/api/recordings")
            seen += [item["name"] for item in page["items"]]
            pages += 1
            if page["next"] is None:
                break
            after = page["next"]
        assert (pages, page["count"], len(seen), len(set(seen))) == (3, 250, 250, 250)
        until(lambda: lab.good("/api/recordings?name=r00")["items"][0]["details"] is not None)
        found = lab.good("/api/recordings?name=r00")["items"]
        assert {item["name"] for item in found} == {f"r00{digit}" for digit in range(10)}
        assert "error" in found[0]["details"]
        assert lab.good("/api/recordings?name=%25")["items"] == []
        assert lab.good("/api/recordings?after=<b>")["items"] == []
        for number in range(249):
            (folder / f"r{number:03}.mcap").unlink()
        # A list waits for no folder whose last look took long.
        until(lambda: [item["name"] for item in lab.good("/api/recordings")["items"]] == ["r249"])
