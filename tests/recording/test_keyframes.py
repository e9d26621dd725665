"""Keyframes in recordings: beginning anywhere in one is the same as coming there from its beginning."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import orjson
import pytest
from click.testing import CliRunner, Result
from hypothesis import given, settings
from hypothesis import strategies as st

import programs
from histories import FRAMES, histories, play_history
from nmes.cli import main
from nmes.errors import RecordingError
from nmes.playback import replay, states, world_at
from nmes.recording import Kind, Recorder, Recording
from nmes.recording.mcap_format import skim_chunk
from nmes.world import World
from recordings import Line, record, rewrite, send


def digests(recording: Recording) -> list[str]:
    return [d for r in recording if r.kind is Kind.TICKS and r.about is not None for d in r.about["digests"]]


def keyframes(recording: Recording) -> list[int]:
    return [orjson.loads(r.data.partition(b"\n")[0])["ticks"] for r in recording if r.kind is Kind.KEYFRAME]


def structures(world: World, client: int) -> None:
    for step in programs.draw(31, 150):
        for command in programs.commands(world, step):
            world.execute(client, command)


def long(world: World, client: int) -> None:
    """Two cubes, pushed about, ticked by commands, by batches and by the clock."""
    send(world, client, type="spawn_cube", cube_name="one", position=[0, 50, 0])
    send(world, client, type="spawn_cube", cube_name="two", position=[3, 7, 0], linear_velocity=[0.1, 0, 0])
    send(world, client, type="subscribe", every=3)
    other = world.join()
    for i in range(30):
        send(world, other, type="apply_physics", cube_name="one", force=[1.5, 0.25 * i, 0])
        send(world, client, type="step", ticks=1 + i % 7)
        push = {"type": "apply_physics", "cube_name": "two", "force": [0, 9, i]}
        ticks = {"type": "step", "ticks": 1 + i % 3}
        spawn = {"type": "spawn_cube", "position": [i, 9, 0]}
        send(
            world,
            client,
            type="batch",
            commands=[push, ticks, {"type": "despawn_cube", "cube_name": "nobody"}, push, ticks, spawn],
        )
        if i == 20:
            send(world, other, type="reset", seed=3)
            send(world, client, type="spawn_cube", cube_name="one", position=[0, 5, 0])
        send(world, client, type="pause")
        for _ in range(i % 4):
            world.tick()


@pytest.fixture(scope="module")
def long_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("keyframes") / "long.mcap", long, {"keyframes": 0.25})


def cut(path: Path, target: Path) -> Path:
    """Cuts a recording before its end, in its last chunk but one."""
    reached = [offset for offset, _ in Recording(path).chunks()]
    target.write_bytes(path.read_bytes()[: reached[-2] - 5])
    return target


# -- what is there ---------------------------------------------------------------------------------------------------


def test_keyframes_are_recorded_and_each_begins_a_chunk(long_file: Path) -> None:
    recording = Recording(long_file)
    assert recording.complete
    frames, every = keyframes(recording), 15
    assert len(frames) >= 10
    heads = [orjson.loads(r.data.partition(b"\n")[0]) for r in recording if r.kind is Kind.KEYFRAME]
    places = [
        (head["ticks"] - head["frame"], head["frame"] // every) for head in heads
    ]  # since which reset, and how far
    assert places == sorted(set(places)) and len({reset for reset, _ in places}) == 2
    firsts = [records[0].kind for _, records in recording.chunks()]
    assert firsts.count(Kind.KEYFRAME) == len(frames)
    assert replay(long_file).verdict == "reproduced"


def test_a_changed_keyframe_is_found(long_file: Path, tmp_path: Path) -> None:
    def edit(lines: list[Line]) -> list[Line]:
        at = [i for i, line in enumerate(lines) if line.topic == "keyframes"][2]
        what = lines[at].data.replace(b'"mass":1.0', b'"mass":1.5', 1)
        assert what != lines[at].data
        return [*lines[:at], lines[at]._replace(data=what), *lines[at + 1 :]]

    # All in one chunk, the keyframes are no longer where they can be found; they are compared all the same.
    divergence = replay(rewrite(long_file, tmp_path / "x.mcap", edit)).divergence
    assert divergence is not None and divergence.kind == "keyframe"


def test_a_missing_or_additional_keyframe_is_found(long_file: Path, tmp_path: Path) -> None:
    def without(lines: list[Line]) -> list[Line]:
        at = next(i for i, line in enumerate(lines) if line.topic == "keyframes")
        return lines[:at] + lines[at + 1 :]

    def twice(lines: list[Line]) -> list[Line]:
        at = next(i for i, line in enumerate(lines) if line.topic == "keyframes")
        return [*lines[:at], lines[at], *lines[at:]]

    for number, edit in enumerate((without, twice)):
        divergence = replay(rewrite(long_file, tmp_path / f"{number}.mcap", edit)).divergence
        assert divergence is not None and divergence.kind == "order" and "keyframe" in divergence.message


# -- seeking ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("whole", [True, False])
def test_a_world_can_be_restored_at_every_frame(long_file: Path, tmp_path: Path, whole: bool) -> None:
    path = long_file if whole else cut(long_file, tmp_path / "cut.mcap")
    recording, tick_digests = Recording(path), digests(Recording(path))
    assert recording.complete == whole
    assert recording.last_frame == len(tick_digests) > 100
    for frame in (*range(0, len(tick_digests), 3), len(tick_digests)):
        start = recording.start(frame)
        assert start.frame == max([0, *(k for k in keyframes(recording) if k <= frame)])
        world = world_at(recording, frame)
        assert world.ticks == frame and world.fault is None
        if frame < len(tick_digests):  # the next tick is to come, and all before it has acted
            world.tick()
            assert world.digest().hex() == tick_digests[frame]
        world.close()
    world = world_at(recording)
    assert world.ticks == len(tick_digests)
    for frame in (-1, len(tick_digests) + 1, 10**6):
        with pytest.raises(RecordingError) as caught:
            world_at(recording, frame)
        assert caught.value.code == "no_such_frame"


@pytest.mark.parametrize("whole", [True, False])
def test_a_replay_of_a_part_compares_that_part(long_file: Path, tmp_path: Path, whole: bool) -> None:
    path = long_file if whole else cut(long_file, tmp_path / "cut.mcap")
    recording = Recording(path)
    total = recording.last_frame
    for first in range(0, total + 1, 13):
        report = replay(recording, first=first)
        assert report.verdict == "reproduced", report.divergence
        begin = recording.start(first).frame
        assert report.frames == (begin, total) and report.ticks == total - begin
        assert (report.damage is None) == whole
        report = replay(recording, first=first, last=min(first + 5, total - 1))
        assert report.verdict == "reproduced" and (report.damage is None or report.frames[1] == total)
        assert 0 <= report.frames[1] - min(first + 5, total - 1) < 7  # to the end of the command on the way
    with pytest.raises(RecordingError, match="no frame"):
        replay(recording, first=total + 1)


@settings(max_examples=25, deadline=None)
@given(histories, st.sampled_from(["ballistic", "mujoco"]), st.integers(0, 60), st.sampled_from([0.0, 10.0, 60.0]))
def test_a_replay_from_any_frame_equals_the_replay_from_the_beginning(
    tmp_path_factory: pytest.TempPathFactory, what: list[Any], backend: str, frame: int, pose_rate: float
) -> None:
    def play(world: World, client: int) -> None:
        play_history(
            world, [("join", 0, None), ("say", 0, FRAMES[0]), *what, ("say", 0, FRAMES[13]), *what, ("tick", 4, None)]
        )

    config = {"backend": backend, "keyframes": 0.08}
    path = record(tmp_path_factory.mktemp("any") / "x.mcap", play, config, pose_rate=pose_rate)
    recording = Recording(path)
    tick_digests = digests(recording)
    assert recording.last_frame == len(tick_digests)
    frame %= len(tick_digests) + 1
    report = replay(recording, first=frame)
    assert report.verdict == "reproduced", report.divergence
    assert replay(recording).verdict == "reproduced"
    world = world_at(recording, frame)
    assert world.ticks == frame
    world.close()


@pytest.mark.parametrize("number", range(3))
def test_structures_are_restored_at_every_frame(tmp_path: Path, number: int) -> None:
    def play(world: World, client: int) -> None:
        for step in programs.draw(300 + number, 120):
            for command in programs.commands(world, step):
                world.execute(client, command)

    path = record(tmp_path / "x.mcap", play, {"backend": "mujoco", "keyframes": 0.5})
    recording = Recording(path)
    tick_digests = digests(recording)
    for frame in range(1, len(tick_digests), 47):
        report = replay(recording, first=frame)
        assert report.verdict == "reproduced", (frame, report.divergence)
        # The frame before, and a tick: the state right after the tick, before anything else was sent.
        world = world_at(recording, frame - 1)
        if not world.execute(world.clients()[0], {"type": "ping"})["type"] == "error":
            world.tick()
            assert world.digest().hex() == tick_digests[frame - 1]
        world.close()


def test_damage_before_a_keyframe_is_not_looked_at_in_a_file_that_was_cut(long_file: Path, tmp_path: Path) -> None:
    data = bytearray(cut(long_file, tmp_path / "cut.mcap").read_bytes())
    blocks = [offset for offset, _ in Recording(long_file).chunks()]
    late = Recording(tmp_path / "cut.mcap").start(10**6).frame
    data[blocks[1] - 30] ^= 1
    path = tmp_path / "x.mcap"
    path.write_bytes(data)
    recording = Recording(path)
    assert recording.start(10**6).frame == late > 0 and not recording.complete
    world = world_at(recording)
    assert world.ticks == recording.last_frame > late
    world.close()


def test_damage_outside_the_replayed_part_is_not_reported(long_file: Path, tmp_path: Path) -> None:
    """Damage before the keyframe is none of its business; damage behind it is told."""
    data = bytearray(long_file.read_bytes())
    blocks = [offset for offset, _ in Recording(long_file).chunks()]
    data[blocks[1] - 30] ^= 1
    path = tmp_path / "x.mcap"
    path.write_bytes(data)
    recording = Recording(path)
    late, total = recording.start(10**6).frame, len(digests(Recording(long_file)))
    assert late > total / 2
    report = replay(recording, first=total)
    assert (report.verdict, report.damage) == ("reproduced", None)
    assert recording.damage is not None
    data[blocks[1] - 30] ^= 1
    data[blocks[-1] - 30] ^= 1
    path.write_bytes(data)
    recording = Recording(path)
    report = replay(recording, first=late - 1)
    assert report.damage is not None and report.verdict == "reproduced"
    assert 0 < report.frames[0] < late == report.frames[1]


@pytest.mark.parametrize("whole", [True, False])
def test_restoring_a_late_frame_reads_little_of_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: bool
) -> None:
    read: list[int] = []

    def count(content: bytes) -> Any:
        read.append(len(content))
        return skim_chunk(content)

    path = record(tmp_path / "x.mcap", long, {"keyframes": 1 / 60})
    recording = Recording(path if whole else cut(path, tmp_path / "cut.mcap"))
    chunks = len(list(recording.chunks()))
    monkeypatch.setattr("nmes.recording.mcap_reader.skim_chunk", count)
    assert 90 < recording.start(100).frame <= 100
    assert len(read) < 3 + math.log2(chunks) + (0 if whole else 2) < chunks / 8


def test_a_restored_world_accepts_commands(long_file: Path) -> None:
    recording = Recording(long_file)
    world = world_at(recording, 100)
    assert world.clients() == [1, 2]
    assert send(world, 1, type="get_cube_state", cube_name="one")["type"] == "cube_state"
    assert send(world, 2, type="step", ticks=5)["frame"] == 105
    assert world.join() == 3


def test_an_engine_without_snapshots_is_replayed_from_the_beginning(tmp_path: Path) -> None:
    path = record(tmp_path / "x.mcap", long, {"backend": "pymunk", "keyframes": 0.25})
    recording = Recording(path)
    tick_digests = digests(recording)
    assert not keyframes(recording)
    for frame in range(0, len(tick_digests), 17):
        world = world_at(recording, frame)
        assert world.ticks == frame
    report = replay(path, first=100)
    assert (report.verdict, report.frames, report.ticks) == ("reproduced", (0, len(tick_digests)), len(tick_digests))


def test_a_divergence_before_the_restored_frame_is_reported(long_file: Path, tmp_path: Path) -> None:
    def edit(lines: list[Line]) -> list[Line]:
        at = [i for i, line in enumerate(lines) if line.topic == "commands" and b"1.5" in line.data][3]
        what = lines[at].data.replace(b"1.5", b"1.25")
        return [*lines[:at], lines[at]._replace(data=what), *lines[at + 1 :]]

    recording = Recording(rewrite(long_file, tmp_path / "x.mcap", edit))
    with pytest.raises(RecordingError) as caught:
        world_at(recording, 90)
    assert caught.value.code == "diverged"


def test_nmes_replay_replays_a_part(long_file: Path) -> None:
    def run(*options: str) -> Result:
        return CliRunner().invoke(main, ["replay", str(long_file), *options])

    result = run("--from", "100", "--to", "120")
    assert result.exit_code == 0 and ", from frame 9" in result.stdout and " to frame 12" in result.stdout
    report = json.loads(run("--from", "100", "--json").stdout)
    assert report["verdict"] == "reproduced" and 90 <= report["frames"][0] <= 100
    for options, why in (
        (("--from", "9", "--to", "8"), "before --from"),
        (("--from", "9", "--backend", "pymunk"), "another engine"),
        (("--from", "-1"), "such as 120 or 2.0s"),
    ):
        result = run(*options)
        assert result.exit_code == 2 and why in result.stderr
    result = run("--from", "1000000")
    assert result.exit_code == 1 and "it has no frame" in result.stderr


# -- recordings that begin in the midst --------------------------------------------------------------------------------


def test_a_recording_begun_late_replays_by_itself(tmp_path: Path) -> None:
    world = World({"mode": "lockstep"})
    structures(world, world.join())
    before = world.ticks
    path = tmp_path / "x.mcap"
    recorder = world.journal = Recorder(path, world)
    structures(world, 1)
    recorder.close()
    recording = Recording(path)
    assert recording.start().frame == before > 100 and recording.last_frame == world.ticks
    report = replay(path)
    assert (report.verdict, report.frames) == ("reproduced", (before, world.ticks)), report.divergence
    assert report.ticks == len(list(states(Recording(path)))) == world.ticks - before
    with pytest.raises(RecordingError, match="begins at frame"):
        world_at(recording, before - 1)
    assert world_at(recording, before).cubes()


def test_a_recording_cannot_begin_late_on_an_engine_without_snapshots(tmp_path: Path) -> None:
    world = World({"backend": "pymunk"})
    world.tick()
    with pytest.raises(RecordingError, match="has a past") as caught:
        Recorder(tmp_path / "x.mcap", world)
    assert caught.value.code == "recording_failed" and not list(tmp_path.iterdir())
