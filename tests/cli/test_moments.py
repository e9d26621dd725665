"""`--from`, `--to` and `--at` take frames, or seconds with their unit, in every command that has them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from PIL import Image, ImageSequence

from command_line import run
from nmes.recording import Recording
from nmes.world import World
from opengl import with_opengl
from recordings import record, send


def falling(world: World, client: int) -> None:
    send(world, client, type="spawn_cube", cube_name="one", position=[0, 50, 0])
    for _ in range(12):
        send(world, client, type="step", ticks=10)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seconds of 60 ticks, saved ten times."""
    return record(tmp_path_factory.mktemp("moments") / "x.mcap", falling, {"backend": "mujoco", "keyframes": 0.2})


@pytest.mark.parametrize(
    ("first", "last", "frames"),
    [("60", "80", [60, 80]), ("1s", "80", [60, 80]), ("1.0s", "1.5s", [60, 90]), ("0.51s", "40", [30, 40])],
)
def test_a_part_is_named_by_frames_or_seconds(recording: Path, first: str, last: str, frames: list[int]) -> None:
    done = run("replay", recording, "--from", first, "--to", last, "--json")
    assert done.exit_code == 0 and json.loads(done.stdout)["frames"] == frames


def test_a_world_is_taken_out_at_a_frame_or_a_time(recording: Path, tmp_path: Path) -> None:
    for at, frame in (("30", 30), ("0.5s", 30), ("1.25s", 75)):
        done = run("fork", recording, "--at", at, "-o", tmp_path / f"{at}.mcap", "--json")
        assert done.exit_code == 0 and json.loads(done.stdout)["frame"] == frame
    # Seconds count from where a recording begins, frames on from its parent's.
    assert Recording(tmp_path / "30.mcap").start().frame == 30


def test_seconds_count_from_the_beginning_of_a_recording(recording: Path, tmp_path: Path) -> None:
    late = tmp_path / "late.mcap"
    assert run("fork", recording, "--at", "1s", "-o", late).exit_code == 0
    done = run("replay", late, "--from", "0s", "--json")
    assert done.exit_code == 0 and json.loads(done.stdout)["frames"] == [60, 60]
    for option in ("--from", "--to"):
        done = run("replay", late, option, "59")
        assert done.exit_code == 1 and "begins at frame 60; it has no frame 59" in done.stderr
    assert run("replay", late, "--to", "60").stdout.startswith("reproduced: 0 ticks")


@with_opengl
def test_films_are_cut_at_frames_and_at_seconds(recording: Path, tmp_path: Path) -> None:
    pictures = []
    for name, last in (("frames.gif", "30"), ("seconds.gif", "0.5s")):
        options = ["--from", "0", "--to", last, "--size", "32x32", "--fps", "10"]
        assert run("render", recording, "-o", tmp_path / name, *options).exit_code == 0
        with Image.open(tmp_path / name) as film:
            pictures.append(sum(1 for _ in ImageSequence.Iterator(film)))
    assert pictures[0] == pictures[1] > 1


@with_opengl
def test_a_frame_that_is_another_moment_in_each_recording_is_refused(recording: Path, tmp_path: Path) -> None:
    slow = record(tmp_path / "slow.mcap", falling, {"tick_rate": 30})
    refused = run("render", recording, slow, "-o", tmp_path / "x.png", "--to", "30")
    assert refused.exit_code == 2 and "give seconds" in refused.stderr
    assert run("render", recording, slow, "-o", tmp_path / "x.png", "--to", "0.5s", "--size", "32x32").exit_code == 0


@pytest.mark.parametrize("text", ["1.5", "-1", "s", "1e3s", "nan", "infs", "2 m", "9" * 30, "9" * 5000 + "s", ""])
def test_what_is_neither_is_refused_with_both_forms(recording: Path, text: str, tmp_path: Path) -> None:
    output = "-o", str(tmp_path / "x.png")
    commands: list[tuple[str, ...]] = [
        ("replay", str(recording), f"--from={text}"),
        ("replay", str(recording), f"--to={text}"),
        ("fork", str(recording), f"--at={text}", *output),
        ("render", str(recording), f"--to={text}", *output),
        ("serve", f"--at={text}"),
    ]
    for command in commands:
        refused = run(*command)
        assert refused.exit_code == 2 and "120 or 2.0s" in refused.stderr
    assert "did you mean 1.5s?" in run("replay", recording, "--from", "1.5").stderr
    assert "--to 1s is before --from 61" in run("replay", recording, "--from", "61", "--to", "1s").stderr
