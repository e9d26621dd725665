"""Tables of what a recording holds: joints, controls, sensors and scores beside the states of cubes."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
from click.testing import CliRunner

import nmes
from creatures import cpg, mlp, snake
from nmes.cli import main
from nmes.errors import MissingPackage, ProofError
from nmes.evaluation import retrace
from nmes.playback.export import TABLES, messages
from nmes.recording import Recorder, Recording
from nmes.world import World

TASK = {
    "format": "nmes-task/1",
    "name": "short",
    "description": "A test.",
    "duration": 0.5,
    "settle_limit": 2,
    "objective": "displacement.x",
    "seeds": [3],
    "limits": {"cubes": 8},
}


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("proofs")
    return Path(nmes.evaluate(snake(mlp(4)), TASK, record=folder).recordings[0])


def rows_of(path: Path, what: str) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = Recording(path).to_arrow(what).to_pylist()
    assert rows and all(tuple(row) == TABLES[what] for row in rows)
    return rows


def test_controls_sensors_and_scores_are_those_of_the_episode(path: Path) -> None:
    episode = retrace(path)
    ticks, begin = len(episode.controls), round(episode.begin * 60)
    assert ticks == 30
    controls = np.array([row["control"] for row in rows_of(path, "controls")], float).reshape(-1, 3)
    assert np.isnan(controls[:begin]).all() and np.array_equal(controls[begin:], episode.controls)
    sensors = rows_of(path, "sensors")
    ids = [sensor.id for sensor in episode.genome.body.sensors]
    assert [row["sensor"] for row in sensors[: len(ids)]] == ids and {row["creature"] for row in sensors} == {
        "creature"
    }
    values = np.array([row["value"] for row in sensors]).reshape(-1, len(ids))
    assert np.array_equal(values[begin - 1 :], episode.sensed)
    scores = rows_of(path, "scores")
    assert [row["frame"] for row in scores] == list(range(begin, begin + ticks + 1))
    assert [row["t"] for row in scores] == [row["frame"] / 60 for row in scores]
    assert np.array_equal([row["score"] for row in scores[:-1]], episode.worth)
    assert scores[-1]["score"] == episode.result.score


def test_joints_are_as_the_world_tells_them(tmp_path: Path) -> None:
    world = World({"mode": "lockstep"})
    recorder = world.journal = Recorder(tmp_path / "x.mcap", world)
    client = world.join()
    world.execute(client, {"type": "spawn_creature", "genome": snake(cpg(4)), "name": "c"})
    for name in "ab":
        world.execute(client, {"type": "spawn_cube", "cube_name": name, "position": [0, 3, "ab".index(name)]})
    ball = {"type": "create_joint", "joint_type": "fixed", "joint_name": "weld", "cube1": "a", "cube2": "b"}
    assert world.execute(client, {**ball, "position": [0, 3, 0.5]})["type"] != "error"
    told = []
    for number in range(4):
        world.drive(client, "c", [0.5, -0.25, number / 4])
        if number == 2:
            off = {"type": "set_joint_param", "joint_name": "c.j0", "param_name": "motor_enabled", "value": False}
            assert world.execute(client, off)["type"] == "joint_param_set"
        world.tick()
        told.append([world.execute(client, {"type": "get_joint_info", "joint_name": f"c.j{i}"}) for i in range(3)])
    recorder.close()
    rows = rows_of(tmp_path / "x.mcap", "joints")
    assert [(row["frame"], row["joint_name"]) for row in rows] == [
        (n, f"c.j{i}") for n in range(1, 5) for i in range(3)
    ]
    for row, info in zip(rows, [info for tick in told for info in tick], strict=True):
        assert [row["position"], row["velocity"]] == [info["position"], info["velocity"]]
    targets = [row["target"] for row in rows if row["joint_name"] == "c.j0"]
    assert targets[2] is None and len(set(targets)) == 2
    assert [row["control"] for row in rows_of(tmp_path / "x.mcap", "controls")][2::3] == [0.0, 0.25, 0.5, 0.75]


@pytest.mark.parametrize("what", TABLES)
def test_every_table_is_written_as_it_is_told(path: Path, what: str, tmp_path: Path) -> None:
    def run(*arguments: str) -> None:
        result = CliRunner().invoke(main, ["export", str(path), "--what", what, *arguments])
        assert result.exit_code == 0, result.output

    table = Recording(path).to_arrow(what)
    run("--to", "parquet", "-o", str(tmp_path / "x.parquet"))
    assert pyarrow.parquet.read_table(tmp_path / "x.parquet").equals(table)
    run("--to", "csv", "-o", str(tmp_path / "x.csv"))
    with (tmp_path / "x.csv").open(newline="") as file:
        assert tuple(next(csv.reader(file))) == TABLES[what]
        assert len(list(file)) == table.num_rows
    run("--to", "jsonl", "-o", str(tmp_path / "x.jsonl"))
    lines = [json.loads(line) for line in (tmp_path / "x.jsonl").read_text().splitlines()]
    assert len(lines) == table.num_rows
    if what == "messages":
        assert lines == list(messages(Recording(path)))
    else:
        assert lines == table.to_pylist()


def test_a_table_without_rows_has_its_columns(tmp_path: Path) -> None:
    world = World({"mode": "lockstep", "backend": "ballistic"})
    world.journal = Recorder(tmp_path / "x.mcap", world)
    world.tick()
    world.journal.close()
    for what in ("states", "joints", "controls", "sensors"):
        table = Recording(tmp_path / "x.mcap").to_arrow(what)
        assert table.num_rows == 0 and tuple(table.column_names) == TABLES[what]
    with pytest.raises(ProofError):
        Recording(tmp_path / "x.mcap").to_arrow("scores")


def test_what_is_missing_or_unknown_is_said(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match="scores; there is no 'poses'"):
        Recording(path).to_arrow("poses")
    result = CliRunner().invoke(main, ["export", str(path), "--to", "csv", "--what", "scores", "--keep-going"])
    assert result.exit_code == 2 and "--keep-going is not for scores" in result.output
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingPackage, match="needs pandas"):
        Recording(path).to_pandas()
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(MissingPackage, match=r"nmes\[arrow\]"):
        Recording(path).to_arrow()


def test_a_data_frame_has_what_the_table_has(path: Path) -> None:
    pytest.importorskip("pandas")
    frame = Recording(path).to_pandas("joints")
    assert list(frame.columns) == list(TABLES["joints"])
    assert frame["position"].tolist() == Recording(path).to_arrow("joints").column("position").to_pylist()
