from __future__ import annotations

import csv
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest
from click.testing import CliRunner

from nmes.cli import main
from nmes.errors import RecordingError
from nmes.playback import states
from nmes.playback.export import COLUMNS, messages
from nmes.recording import Kind, Recorder, Recording
from nmes.world import World
from recordings import Line, busy, record, rewrite, send


def run(*arguments: str | Path) -> tuple[int, str]:
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.output


class Seen(Recorder):
    """A recorder that also keeps what its world looks like after each tick."""

    def __init__(self, path: Path, world: World) -> None:
        super().__init__(path, world, pose_rate=0)
        self.world = world
        self.states: list[tuple[int, list[str], Any]] = []

    def ticked(self, frame: int, digest: bytes) -> None:
        super().ticked(frame, digest)
        self.states.append((frame, *self.world.poses()))


def fault(world: World, client: int) -> None:
    send(world, client, type="spawn_cube", cube_name="far")
    send(world, client, type="step", ticks=3)
    send(world, client, type="apply_physics", cube_name="far", impulse=[1e15, 0, 0])
    while world.fault is None:
        send(world, client, type="apply_physics", cube_name="far", impulse=[1e15, 0, 0])
        world.tick()
    send(world, client, type="reset")
    busy(world, client)


@pytest.mark.parametrize("backend", ["ballistic", "mujoco", "pymunk"])
def test_exported_states_are_those_of_the_run(tmp_path: Path, backend: str) -> None:
    world = World({"backend": backend, "mode": "lockstep"})
    recorder = world.journal = Seen(tmp_path / "x.mcap", world)
    client = world.join()
    if backend == "ballistic":
        fault(world, client)
    else:
        busy(world, client)
    recorder.close()
    ticks = list(states(Recording(tmp_path / "x.mcap")))
    assert len(ticks) == len(recorder.states) >= 40
    for one, (frame, names, values) in zip(ticks, recorder.states, strict=True):
        assert (one.frame, one.names, one.time) == (frame, names, frame / 60)
        assert np.array_equal(one.values, values)  # to the last bit


def test_states_that_differ_from_the_recording_are_not_exported(tmp_path: Path) -> None:
    path = record(tmp_path / "x.mcap", busy)

    def push_harder(lines: list[Line]) -> list[Line]:
        return [line._replace(data=line.data.replace(b"[1.5,0.25,0]", b"[1.5,0.26,0]")) for line in lines]

    edited = rewrite(path, tmp_path / "edited.mcap", push_harder)
    with pytest.raises(RecordingError, match="tick 2 does not come out as recorded") as info:
        list(states(Recording(edited)))
    assert info.value.code == "diverged"
    assert len(list(states(Recording(edited), keep_going=True))) == 40

    def never_step(lines: list[Line]) -> list[Line]:
        return [line._replace(data=line.data.replace(b'"ticks":10', b'"ticks":9')) for line in lines]

    with pytest.raises(RecordingError, match="fewer ticks than recorded"):
        list(states(Recording(rewrite(path, tmp_path / "fewer.mcap", never_step))))
    code, output = run("export", edited, "--to", "csv")
    assert code == 1 and "does not come out as recorded" in output


def test_a_cut_recording_is_exported_up_to_the_cut(tmp_path: Path) -> None:
    world = World({"backend": "ballistic", "mode": "lockstep"})
    recorder = world.journal = Recorder(tmp_path / "x.mcap", world)
    client = world.join()
    send(world, client, type="spawn_cube", cube_name="a")
    send(world, client, type="step", ticks=4)
    recorder.flush()
    send(world, client, type="step", ticks=4)
    assert [one.frame for one in states(Recording(tmp_path / "x.mcap"))] == [1, 2, 3, 4]
    recorder.close()


def test_messages_are_exported_as_lines_of_json(tmp_path: Path) -> None:
    path = record(tmp_path / "x.mcap", busy)
    code, output = run("export", path, "--to", "jsonl")
    assert code == 0
    rows = [json.loads(line) for line in output.splitlines()]
    recording = Recording(path)
    assert rows == list(messages(recording))
    beginning = rows.pop(0)
    assert (beginning["kind"], beginning["message"]) == ("recording", recording.metadata)
    assert [row["record"] for row in rows] == [
        item.sequence for item in recording if item.kind not in (Kind.POSES, Kind.SCENE, Kind.BOX)
    ]
    commands = [row for row in rows if row["kind"] == "command"]
    assert commands[0]["message"]["type"] == "spawn_cube" and commands[0]["client"] == 1
    assert any(row["kind"] == "refused" and "not even text" in row["message"] for row in rows)


def test_exported_tables_hold_every_cube_after_every_tick(tmp_path: Path) -> None:
    path = record(tmp_path / "x.mcap", busy)
    expected = [
        [one.frame, one.time, name, *value]
        for one in states(Recording(path))
        for name, value in zip(one.names, one.values.tolist(), strict=True)
    ]
    assert run("export", path, "--to", "csv", "--output", tmp_path / "x.csv") == (0, "")
    with (tmp_path / "x.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    assert header == ["frame", "t", "cube_name", *COLUMNS]
    assert [[int(r[0]), float(r[1]), r[2], *map(float, r[3:])] for r in rows] == expected
    assert run("export", path, "--to", "parquet", "--output", tmp_path / "x.parquet") == (0, "")
    table = pyarrow.parquet.read_table(tmp_path / "x.parquet").to_pylist()
    assert [list(row.values()) for row in table] == expected
    for kind in ("csv", "parquet"):
        target = tmp_path / f"messages.{kind}"
        assert run("export", path, "--to", kind, "--what", "messages", "--output", target)[0] == 0
    rows = pyarrow.parquet.read_table(tmp_path / "messages.parquet").to_pylist()
    assert [{**row, "message": json.loads(row["message"])} for row in rows] == list(messages(Recording(path)))
    code, output = run("export", path, "--to", "jsonl", "--what", "states")
    assert code == 0
    assert [list(json.loads(line).values()) for line in output.splitlines()] == expected


def test_wrong_usage_is_explained(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = record(tmp_path / "x.mcap", lambda world, client: None)
    code, output = run("export", path, "--to", "parquet")
    assert code == 2 and "parquet needs --output" in output
    code, output = run("export", path, "--to", "parquet", "--output", tmp_path / "x")
    assert code == 1 and "holds no such rows" in output
    assert run("export", path, "--to", "csv") == (0, "")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    code, output = run("export", path, "--to", "parquet", "--output", tmp_path / "x")
    assert code == 1 and "nmes[arrow]" in output
