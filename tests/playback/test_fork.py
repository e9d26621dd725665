"""Branches: worlds that go on from a frame of a recording, in scripts and on a server, in a recording of their own."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any, NoReturn
from unittest.mock import Mock

import pytest
from click.testing import CliRunner, Result

import programs
from nmes import Client
from nmes.cli import main
from nmes.errors import RecordingError
from nmes.playback import replay, world_at
from nmes.playback.diff import compare
from nmes.playback.fork import fork
from nmes.protocol import Request
from nmes.recording import Kind, Recorder, Recording
from nmes.world import World
from processes import process, ready
from recordings import record, send

BACKENDS = pytest.mark.parametrize("backend", ["mujoco", "ballistic", "pymunk"])


def play(world: World, client: int) -> None:
    for step in programs.draw(77, 100):
        for command in programs.commands(world, step):
            world.execute(client, command)


def parent(tmp_path: Path, backend: str = "ballistic") -> Recording:
    return Recording(record(tmp_path / "parent.mcap", play, {"backend": backend, "keyframes": 1.0}))


def digests(recording: Recording) -> list[str]:
    return [d for r in recording if r.kind is Kind.TICKS and r.about is not None for d in r.about["digests"]]


@BACKENDS
def test_a_fork_continues_and_replays_without_its_parent(tmp_path: Path, backend: str) -> None:
    recording = parent(tmp_path, backend)
    total = recording.last_frame
    for frame in (0, total // 3, total):
        path = tmp_path / f"{frame}.mcap"
        world = World(recording.config)
        recorder = fork(recording, world, path, frame)
        assert world.ticks == frame and world.clients() == [1] and world.journal is recorder
        send(world, 1, type="spawn_cube", position=[0, 30, 0])
        send(world, world.join(), type="step", ticks=20)
        send(world, 1, type="get_world_state")
        recorder.close()
        child = Recording(path)
        pointer = child.metadata["nmes.parent"]
        assert (pointer["frame"], pointer["file"]) == (str(frame), "parent.mcap")
        report = replay(child)
        assert report.verdict == "reproduced", report.divergence
        assert report.frames == (0 if backend == "pymunk" else frame, frame + 20)
        assert child.last_frame == frame + 20
        # A fork of a fork.
        assert world_at(child, frame + 7).ticks == frame + 7


def test_the_lineage_identifies_the_parent_and_its_frame(tmp_path: Path) -> None:
    recording, other = parent(tmp_path), tmp_path / "other"
    other.mkdir()
    total = recording.last_frame
    pointer, again = recording.lineage(total), parent(other).lineage(total)
    assert recording.complete and pointer["head"] == recording.end["head"]
    assert pointer["recording"] != again["recording"]
    assert recording.lineage(1)["head"] != pointer["head"]
    assert recording.lineage(1)["recording"] == pointer["recording"]


@BACKENDS
def test_a_fork_with_the_same_inputs_has_the_same_digests(tmp_path: Path, backend: str) -> None:
    recording = parent(tmp_path, backend)
    program = programs.draw(5, 40)

    def go_on(world: World) -> tuple[Any, bytes]:
        replies = [world.execute(1, command) for step in program for command in programs.commands(world, step)]
        return replies, world.digest()

    for frame in (20, recording.last_frame):
        worlds = [World(recording.config), World(recording.config)]
        recorders = [fork(recording, world, tmp_path / f"{frame}-{i}.mcap", frame) for i, world in enumerate(worlds)]
        first, second = (go_on(world) for world in worlds)
        assert first == second
        for recorder in recorders:
            recorder.close()
        assert compare(*(Recording(recorder.path) for recorder in recorders)).same


@BACKENDS
@pytest.mark.parametrize("interval", [0, 60])
def test_a_fork_has_its_past_in_the_file_before_anything_happens_in_it(
    tmp_path: Path, backend: str, interval: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[int] = []
    monkeypatch.setattr("nmes.recording.mcap_writer.os.fsync", synced.append)
    recording = parent(tmp_path, backend)
    world = World(recording.config)
    recorder = fork(recording, world, tmp_path / "x.mcap", flush_interval=interval)
    restored = world_at(Recording(recorder.path))  # as a kill would leave the file
    assert (restored.ticks, restored.digest()) == (recording.last_frame, world.digest())
    assert bool(synced) == (interval == 0)
    recorder.close()


@BACKENDS
def test_a_fork_that_fails_leaves_no_file(tmp_path: Path, backend: str) -> None:
    recording = parent(tmp_path, backend)
    with pytest.raises(RecordingError, match="no frame"):
        fork(recording, World(recording.config), tmp_path / "x.mcap", 10**6)
    assert list(tmp_path.iterdir()) == [recording.path]
    with pytest.raises(RecordingError, match="exists already"):
        fork(recording, World(recording.config), recording.path, 3)
    assert recording.complete and replay(recording).verdict == "reproduced"


class Interrupted(World):
    """A world in which somebody presses Ctrl-C after a while."""

    def handle(self, client: int, request: Request) -> bytes:
        """Executes a frame, unless it is late."""
        if self.ticks > 20:
            raise KeyboardInterrupt
        return super().handle(client, request)


@BACKENDS
def test_a_fork_that_is_interrupted_leaves_no_file(
    tmp_path: Path, backend: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording, path = parent(tmp_path, backend), tmp_path / "x.mcap"
    with pytest.raises(KeyboardInterrupt):
        fork(recording, Interrupted(recording.config), path)
    assert list(tmp_path.iterdir()) == [recording.path]
    close = Recorder.close

    def interrupted(recorder: Recorder) -> NoReturn:
        close(recorder)
        raise KeyboardInterrupt

    monkeypatch.setattr(Recorder, "close", interrupted)
    assert run("fork", recording.path, "-o", path).exit_code == 1
    assert list(tmp_path.iterdir()) == [recording.path]


def test_a_faulted_world_is_restored_at_the_frame_before_its_fault(tmp_path: Path) -> None:
    def fail(world: World, client: int) -> None:
        send(world, client, type="spawn_cube", cube_name="far")
        send(world, client, type="step", ticks=9)
        send(world, client, type="apply_physics", cube_name="far", impulse=[1e15, 0, 0])
        send(world, client, type="step", ticks=99)
        assert world.fault is not None

    recording = Recording(record(tmp_path / "x.mcap", fail))
    world = world_at(recording)
    assert world.fault is None and world.ticks == recording.last_frame < 108
    world.tick()
    assert world.fault is not None


@pytest.mark.parametrize("how", ["step", "clock", "batch"])
def test_a_world_that_was_reset_after_its_fault_is_restored_with_what_came_then(tmp_path: Path, how: str) -> None:
    setting_up = [{"type": "reset"}, {"type": "spawn_cube", "cube_name": "new"}]

    def fail(world: World, client: int) -> None:
        send(world, client, type="spawn_cube", cube_name="far")
        send(world, client, type="step", ticks=9)
        send(world, client, type="apply_physics", cube_name="far", impulse=[1e15, 0, 0])
        if how == "batch":
            send(world, client, type="batch", commands=[{"type": "step", "ticks": 99}, *setting_up])
            return
        if how == "clock":
            for _ in range(99):
                world.tick()
        else:
            send(world, client, type="step", ticks=99)
        assert world.fault is not None
        for command in ({"type": "get_world_info"}, *setting_up):
            world.execute(client, command)

    recording = Recording(record(tmp_path / "x.mcap", fail))
    world = world_at(recording)
    assert world.fault is None and world.cubes() == ["new"] and world.frame == 0
    assert world.ticks == recording.last_frame >= 9


def test_a_world_whose_reset_was_refused_or_that_stopped_again_is_restored_at_the_frame_before(tmp_path: Path) -> None:
    def fail(world: World, client: int) -> None:
        for seed in (-1, 3):
            send(world, client, type="spawn_cube", cube_name="far")
            send(world, client, type="apply_physics", cube_name="far", impulse=[1e15, 0, 0])
            send(world, client, type="step", ticks=99)
            assert world.fault is not None
            send(world, client, type="reset", seed=seed)
        send(world, client, type="spawn_cube", cube_name="last")
        send(world, client, type="apply_physics", cube_name="last", impulse=[1e15, 0, 0])
        send(world, client, type="step", ticks=99)

    world = world_at(Recording(record(tmp_path / "x.mcap", fail)))
    assert (world.fault, world.cubes()) == (None, ["last"])
    world.tick()
    assert world.fault is not None


def test_a_world_stopped_and_reset_again_and_again_at_one_frame_is_restored_in_one_pass_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(world: World, client: int) -> None:
        for cycle in range(20):
            send(world, client, type="spawn_cube", cube_name=f"far{cycle}")
            for _ in range(3):
                send(world, client, type="apply_physics", cube_name=f"far{cycle}", impulse=[1e15, 0, 0])
            send(world, client, type="step")
            assert world.fault is not None and world.ticks == 0
            send(world, client, type="reset")
        send(world, client, type="spawn_cube", cube_name="new")

    recording = Recording(record(tmp_path / "x.mcap", fail))
    monkeypatch.setattr(Recording, "records", counted := Mock(wraps=recording.records))
    assert world_at(recording, 0).cubes() == ["new"]
    assert counted.call_count == 1


def test_a_fork_that_is_interrupted_while_its_keyframe_is_written_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(_: Recorder) -> NoReturn:
        raise KeyboardInterrupt

    recording = parent(tmp_path, "mujoco")
    monkeypatch.setattr(Recorder, "flush", interrupted)
    with pytest.raises(KeyboardInterrupt):
        fork(recording, World(recording.config), tmp_path / "x.mcap")
    assert list(tmp_path.iterdir()) == [recording.path]


def test_a_parent_and_its_fork_are_compared_from_the_frame_of_the_fork(tmp_path: Path) -> None:
    recording = parent(tmp_path, "mujoco")
    frame, path = recording.last_frame // 2, tmp_path / "x.mcap"
    world = World(recording.config)
    recorder = fork(recording, world, path, frame)
    for _ in range(10):
        world.tick()
    recorder.close()
    for pair in ((recording, Recording(path)), (Recording(path), recording)):
        comparison = compare(*pair)
        assert comparison.inputs is not None and comparison.inputs.ticks >= frame
        assert comparison.states is not None and comparison.states.tick > frame


# -- the command line ------------------------------------------------------------------------------------------------


def run(*options: str | Path) -> Result:
    return CliRunner().invoke(main, list(map(str, options)))


def test_nmes_fork_writes_a_fork(tmp_path: Path) -> None:
    recording, path = parent(tmp_path, "mujoco"), tmp_path / "fork.mcap"
    frame = recording.last_frame // 2
    result = run("fork", recording.path, "--at", str(frame), "-o", path)
    assert result.exit_code == 0 and f"frame {frame:,} of" in result.stdout
    assert Recording(path).last_frame == frame and world_at(Recording(path)).clients() == [1]
    about = json.loads(run("info", path, "--json").stdout)
    assert (about["first_frame"], about["keyframes"], about["ticks"]) == (frame, 1, 0)
    assert about["parent"]["file"] == "parent.mcap" and about["complete"]
    assert f"parent.mcap, frame {frame}" in run("info", path).stdout
    assert run("verify", path).exit_code == 0
    assert run("replay", path).exit_code == 0
    result = run("export", path, "--to", "jsonl", "--output", tmp_path / "log.jsonl")
    assert result.exit_code == 0 and run("replay", tmp_path / "log.jsonl").stdout.startswith("reproduced: ")
    again = run("fork", path, "-o", tmp_path / "again.mcap", "--json")
    assert json.loads(again.stdout)["frame"] == frame
    for options, why in (
        ((path, "--at", "3", "-o", tmp_path / "y"), f"begins at frame {frame}"),
        ((recording.path, "--at", "99999999", "-o", tmp_path / "y"), "no frame"),
        ((recording.path, "-o", path), "exists already"),
    ):
        result = run("fork", *options)
        assert result.exit_code == 1 and why in result.stderr, result.stderr
    result = run("replay", path, "--backend", "ballistic")
    assert result.exit_code == 1 and "a running world of mujoco" in result.stderr
    assert run("replay", path, "--backend", "mujoco").exit_code == 0
    result = run("replay", path, "--against", "127.0.0.1:1", "--password", "password")
    assert result.exit_code == 2 and "a running world of mujoco" in result.stderr


def test_a_served_world_is_resumed(tmp_path: Path) -> None:
    recording = parent(tmp_path, "mujoco")
    frame = recording.last_frame // 2
    before = world_at(recording, frame).cubes()
    options = ["--json", "--port", "0", "--record", str(tmp_path / "on"), "--resume", str(recording.path)]
    for at in ([], ["--at", str(frame)]):
        expected = frame if at else recording.last_frame
        with process("serve", *options, *at, NMES_PASSWORD="password") as server:
            announcement = ready(server)
            assert announcement["resumed"] == {"file": str(recording.path), "frame": expected}
            with Client(port=announcement["port"], password="password") as client:
                info = client.get_world_info()
                assert info["counts"]["clients"] == 1 and info["mode"] == "lockstep"
                if at:
                    assert client.get_cube_list()["cubes"] == before
                client.spawn_cube()
                client.step(30)
            server.send_signal(signal.SIGTERM)
            assert server.wait(60) == 0
        child = Recording(announcement["recording"])
        assert child.complete and child.start().frame == expected and child.last_frame == expected + 30
        assert next(r.client for r in child if r.kind is Kind.LEFT) == 1
        assert [r.client for r in child if r.kind is Kind.JOINED] == [2]
        assert replay(child).verdict == "reproduced"


def test_invalid_resume_options_are_wrong_usage(tmp_path: Path) -> None:
    recording = parent(tmp_path)
    for options, why in (
        (["--resume", recording.path, "--seed", "3"], "--seed does not go with"),
        (["--resume", recording.path, "--worlds", "3"], "--worlds does not go with"),
        (["--at", "3"], "--resume"),
        (["--resume", tmp_path / "nothing.mcap"], "No such file"),
    ):
        result = run("serve", "--port", "0", "--no-record", *options)
        assert result.exit_code == 2 and why in result.stderr, result.stderr
    result = run("serve", "--port", "0", "--no-record", "--resume", recording.path, "--at", "9999999")
    assert result.exit_code == 1 and "no frame" in result.stderr


def test_a_recorder_of_a_world_at_its_beginning_writes_no_keyframe(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "x.mcap", World({"backend": "ballistic"}))
    recorder.close()
    assert list(Recording(tmp_path / "x.mcap")) == []
