"""What a command writes never takes the place of what it reads, or of what is somebody else's."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from boards import DASH, key_in, signed
from command_line import run
from creatures import snake
from disks import full_disk
from learning_runs import begin
from made_up_runs import SHORT, genomes, make_run, real
from nmes.errors import RecordingError
from nmes.evaluation import Task
from nmes.evaluation.evaluator import recorded
from nmes.genome import Genome
from nmes.server.access_log import AccessLog
from nmes.world import World


@pytest.mark.parametrize("command", [("mutate", "walker"), ("cross", "walker", "inchworm")], ids=lambda words: words[0])
def test_a_genome_is_not_written_over_the_task_that_it_is_for(tmp_path: Path, command: tuple[str, ...]) -> None:
    (task := tmp_path / "task.json").write_text(json.dumps(DASH))
    before = task.read_bytes()
    result = run("genome", *command, "--task", str(task), "-o", str(task))
    assert result.exit_code != 0 and task.read_bytes() == before


@pytest.mark.parametrize("name", ["genome.json", "states"])
def test_what_is_learned_is_not_written_over_what_is_there(tmp_path: Path, name: str) -> None:
    (genome := tmp_path / "genome.json").write_text(json.dumps(snake()))
    if name == "states":
        genome = genome.rename(tmp_path / "mine.json")
        (tmp_path / "states").symlink_to(tmp_path.parent)
    before = genome.read_bytes()
    result = run("learn", str(genome), "--steps", "100", "-o", str(tmp_path))
    assert result.exit_code != 0 and f"there is another {name} in" in result.output
    assert genome.read_bytes() == before and not (tmp_path / "run.json").exists()


def test_a_run_does_not_begin_where_its_index_would_take_the_place_of_something(tmp_path: Path) -> None:
    (mine := tmp_path / "index.sqlite").write_text("mine")
    result = run("evolve", "random", "--budget", "1", "-o", str(tmp_path))
    assert result.exit_code != 0 and "there is another index.sqlite in" in result.output
    assert mine.read_text() == "mine"


def test_what_is_said_besides_a_push_is_not_kept() -> None:
    world = World({"backend": "ballistic", "mode": "lockstep"})
    client = world.join()
    world.execute(client, {"type": "spawn_cube", "cube_name": "a"})
    world.execute(client, {"type": "apply_physics", "cube_name": "a", "force": [1, 0, 0], "x": [[]] * 1000})
    assert world.pushes.commands == {"a": {"type": "apply_physics", "cube_name": "a", "force": [1, 0, 0]}}


@pytest.mark.parametrize("room", [4_000, 30_000, 60_000])
def test_a_match_that_cannot_be_recorded_is_told_and_not_void(tmp_path: Path, room: int) -> None:
    asked = ("walker", "roller", "--task", "sumo", "--seeds", "1", "--jobs", "1", "-o", str(tmp_path / "cup"))
    with full_disk(room):
        result = run("tournament", *asked)
    assert result.exit_code == 1 and "cannot write" in result.output


def test_a_genome_with_an_odd_brain_is_compared(tmp_path: Path) -> None:
    document = json.loads(json.dumps(Genome.load("walker").document))
    document["brain"]["links"][0] = 0.5
    (odd := tmp_path / "odd.json").write_text(json.dumps(document))
    result = run("genome", "diff", str(odd), "walker")
    assert result.exit_code == 1 and "0.5" in result.output


def test_pictures_are_not_drawn_into_a_folder_that_has_something_in_it(tmp_path: Path) -> None:
    make_run(tmp_path / "run", [real(genomes()[0], Task(SHORT))])
    begin(tmp_path / "learning")
    asked = ("--task", "walk", "--worlds", "1", "-o", tmp_path / "survey", "--jobs", "1")
    assert run("survey", "walker", *asked).exit_code == 0
    (theirs := tmp_path / "theirs").mkdir()
    (theirs / "index.html").write_text("mine")
    for command, folder in (("evolve", "run"), ("learn", "learning"), ("survey", "survey")):
        result = run(command, "show", tmp_path / folder, "-o", theirs)
        assert result.exit_code == 2 and "name a folder that is not there yet" in result.output
    assert [path.read_text() for path in theirs.iterdir()] == ["mine"]


def test_pictures_are_drawn_into_the_empty_folder_in_which_one_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin(tmp_path / "learning")
    (empty := tmp_path / "empty").mkdir()
    monkeypatch.chdir(empty)
    before = empty.stat().st_ino
    for named in (Path("."), empty):
        assert run("learn", "show", tmp_path / "learning", "-o", named).exit_code == 0
        assert empty.stat().st_ino == before and (empty / "index.html").is_file()  # a mounted one cannot be replaced
        assert not [path for path in empty.iterdir() if path.name.startswith(".")]
        for path in empty.iterdir():
            path.unlink()
    assert {path.name for path in tmp_path.iterdir()} == {"learning", "empty"}


def test_an_empty_folder_stays_empty_where_its_content_cannot_be_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin(tmp_path / "learning")
    (empty := tmp_path / "empty").mkdir()
    monkeypatch.chdir(empty)
    with full_disk(100):
        result = run("learn", "show", tmp_path / "learning", "-o", ".")
    assert result.exit_code == 1 and "cannot write" in result.output
    assert not [*empty.iterdir()]


def test_a_plot_does_not_take_the_place_of_what_the_same_evaluation_writes(tmp_path: Path) -> None:
    (genome := tmp_path / "snake.json").write_text(json.dumps(snake()))
    (task := tmp_path / "task.json").write_text(json.dumps(DASH))
    asked: list[str | Path] = ["eval", genome, "--task", task, "--jobs", "1", "--record", tmp_path / "r"]
    results = tmp_path / "results.svg"
    assert run(*asked, "--resume", results, "--plot", results).exit_code == 2 and not results.exists()
    assert run(*asked, "--resume", results).exit_code == 0
    recording = next((tmp_path / "r").iterdir())
    (link := tmp_path / "plot.svg").symlink_to(recording)
    before = recording.read_bytes(), results.read_bytes()
    for plot in (results, recording, link):
        assert run(*asked, "--resume", results, "--plot", plot).exit_code == 2
        assert (recording.read_bytes(), results.read_bytes()) == before


def test_an_access_log_is_not_appended_to_something_else(tmp_path: Path) -> None:
    AccessLog(log := tmp_path / "access.log").write("listed", stranger=False)
    AccessLog(log).write("listed", stranger=False)
    assert len(log.read_bytes().splitlines()) == 2
    (config := tmp_path / "config.json").write_text('{"backend": "ballistic"}')
    with pytest.raises(OSError, match="it is no access log"):
        AccessLog(config)
    assert config.read_text() == '{"backend": "ballistic"}'


def test_a_recording_that_is_signed_is_not_replaced(tmp_path: Path) -> None:
    (genome := tmp_path / "snake.json").write_text(json.dumps(snake()))
    (task := tmp_path / "task.json").write_text(json.dumps(DASH))
    evolved, survey = tmp_path / "run", tmp_path / "survey"
    make_run(evolved, [real(genomes()[0], Task(SHORT))])
    assert run("survey", genome, "--task", task, "--worlds", "1", "-o", survey, "--jobs", "1").exit_code == 0
    commands: list[list[str | Path]] = [
        ["eval", genome, "--task", task, "--jobs", "1", "--record"],
        ["eval", genome, "--task", task, "--jobs", "1", "--record-best", "1", "--record"],
        ["eval", "walker", "roller", "--task", "sumo", "--seeds", "1", "--jobs", "1", "--record"],
        ["evolve", "best", evolved, "-o"],
        ["survey", "best", survey, "-o"],
    ]
    for number, command in enumerate(commands):
        folder = tmp_path / f"{number}"
        assert run(*command, folder).exit_code == 0
        recording = sorted(folder.glob("*.mcap"))[-1]
        signed([str(recording)], key_in(tmp_path / "key.pem", 1))
        before = {path: (path.stat().st_mtime_ns, path.read_bytes()) for path in folder.iterdir()}
        result = run(*command, folder)
        assert result.exit_code in (1, 2) and f"{recording} is signed" in result.output, result.output
        assert "another folder" in result.output
        assert {path: (path.stat().st_mtime_ns, path.read_bytes()) for path in folder.iterdir()} == before


def test_a_recording_of_an_environment_does_not_replace_a_signed_one(tmp_path: Path) -> None:
    (path := tmp_path / "mine.mcap").write_text("mine")
    (tmp_path / "mine.mcap.sig").write_text("signed")
    with pytest.raises(RecordingError, match="is signed"), recorded(path, {}):
        pass
    assert path.read_text() == "mine"
