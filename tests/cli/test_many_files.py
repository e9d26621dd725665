"""`nmes verify`, `replay` and `info` take many files: a line or an object each, and the worst exit status."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from command_line import run
from nmes.world import World
from recordings import Line, busy, commands_of, record, rewrite, send


def falling(world: World, client: int) -> None:
    send(world, client, type="spawn_cube", cube_name="one", position=[0, 9, 0])
    send(world, client, type="step", ticks=7)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Two whole recordings, one in which a command was edited, one that is cut, one that is damaged, and none."""
    folder = tmp_path_factory.mktemp("files")
    paths = {name: folder / f"{name}.mcap" for name in ("busy", "falling", "edited", "cut", "damaged", "noise")}
    record(paths["busy"], busy)
    record(paths["falling"], falling)

    def harder(lines: list[Line]) -> list[Line]:
        first = commands_of(lines)[2]
        changed = lines[first]._replace(data=lines[first].data.replace(b"[1.5,", b"[9.5,"))
        return [changed if i == first else line for i, line in enumerate(lines)]

    rewrite(paths["busy"], paths["edited"], harder)
    whole = paths["busy"].read_bytes()
    paths["cut"].write_bytes(whole[: len(whole) // 2])
    middle = len(whole) // 2
    paths["damaged"].write_bytes(whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :])
    paths["noise"].write_bytes(b"no recording")
    return paths


def judged(command: str, files: dict[str, Path], *names: str) -> tuple[int, list[str], list[dict[str, Any]]]:
    """Runs a command over files; returns the exit status, the lines, and the objects of `--json`."""
    told = run(command, *(files[name] for name in names))
    data = run(command, *(files[name] for name in names), "--json")
    assert data.exit_code == told.exit_code
    objects = json.loads(data.stdout)
    assert [Path(each["file"]).stem for each in objects] == list(names)
    return told.exit_code, told.stdout.splitlines(), objects


def test_many_files_are_verified_a_line_each(files: dict[str, Path]) -> None:
    status, lines, objects = judged("verify", files, "busy", "noise", "damaged", "falling", "cut")
    assert status == 1 and len(lines) == 5
    assert lines[0].startswith(f"{files['busy']}: sound: ") and lines[3].startswith(f"{files['falling']}: sound: ")
    assert lines[1].startswith(f"{files['noise']}: cannot be read: ") and "not a recording" in lines[1]
    assert lines[2].startswith(f"{files['damaged']}: DAMAGED: ") and f"{files['cut']}: incomplete: " in lines[4]
    assert [each.get("verdict") for each in objects] == ["sound", None, "damaged", "sound", "cut"]
    assert "not a recording" in objects[1]["error"]


def test_many_files_are_replayed_a_line_each(files: dict[str, Path]) -> None:
    status, lines, objects = judged("replay", files, "busy", "edited", "falling")
    assert status == 1 and len(lines) == 3
    assert lines[0].startswith(f"{files['busy']}: reproduced: 40 ticks")
    assert lines[1].startswith(f"{files['edited']}: diverged at frame 1") and "recorded" in lines[1]
    assert lines[2].startswith(f"{files['falling']}: reproduced: 7 ticks, 2 commands")
    assert [each["verdict"] for each in objects] == ["reproduced", "diverged", "reproduced"]


def test_what_is_in_many_files_is_a_table(files: dict[str, Path]) -> None:
    status, lines, objects = judged("info", files, "busy", "falling", "cut")
    assert status == 0 and len(lines) == 4
    assert lines[0].split()[:2] == ["file", "world"]
    assert lines[1].split()[0] == str(files["busy"]) and " 40 " in lines[1] and lines[1].endswith("yes")
    assert lines[2].split()[0] == str(files["falling"]) and " 7 " in lines[2]
    assert [each["ticks"] for each in objects[:2]] == [40, 7] and "no: " in lines[3]


@pytest.mark.parametrize(
    ("command", "names", "status"),
    [
        ("verify", ["busy", "falling"], 0),
        ("verify", ["busy", "noise"], 2),
        ("verify", ["noise", "cut"], 1),
        ("replay", ["busy", "falling"], 0),
        ("replay", ["busy", "noise"], 2),
        ("replay", ["noise", "edited", "busy"], 1),
        ("replay", ["busy", "cut", "damaged"], 2),
        ("info", ["busy", "cut"], 0),
        ("info", ["noise", "busy"], 2),
    ],
)
def test_the_exit_status_is_the_worst(files: dict[str, Path], command: str, names: list[str], status: int) -> None:
    assert run(command, *(files[name] for name in names)).exit_code == status


def test_a_file_by_itself_is_told_as_before_and_is_one_object(files: dict[str, Path]) -> None:
    for command in ("verify", "replay", "info"):
        assert json.loads(run(command, files["busy"], "--json").stdout)["file"] == str(files["busy"])
        assert not run(command, files["busy"]).stdout.startswith(str(files["busy"]))
        assert run(command).exit_code == 2
    alone = run("replay", files["noise"])
    assert alone.exit_code == 2 and "Invalid value for 'FILE...'" in alone.stderr and not alone.stdout


def test_what_is_about_one_file_is_refused_for_many(files: dict[str, Path], tmp_path: Path) -> None:
    for options in (["--backend", "ballistic"], ["--against", "127.0.0.1:1"]):
        refused = run("replay", files["busy"], files["falling"], *options)
        assert refused.exit_code == 2 and "one file" in refused.stderr
    (tmp_path / "key").write_text("x")
    refused = run("verify", files["busy"], files["cut"], "--verify-key", tmp_path / "key", "--signature", "a.sig")
    assert refused.exit_code == 2 and "one file" in refused.stderr


def test_a_part_is_replayed_of_each_file_and_one_that_lacks_it_does_not_stop_the_others(files: dict[str, Path]) -> None:
    done = run("replay", files["falling"], files["busy"], "--from", "20", "--to", "30")
    assert done.exit_code == 1
    first, second = done.stdout.splitlines()
    assert "it has no frame 20" in first and "from frame 0 to frame 30" in second


def test_a_damaged_file_is_not_said_to_be_reproduced(files: dict[str, Path]) -> None:
    done = run("replay", files["damaged"])
    assert done.exit_code == 2 and done.stdout.startswith("DAMAGED: ")
    assert "reproduced" not in done.stdout.splitlines()[0]
    (line,) = [line for line in run("replay", files["damaged"], files["busy"]).stdout.splitlines() if "DAMAGED" in line]
    assert line.startswith(f"{files['damaged']}: DAMAGED: ")
