"""What Rerun makes of a recording: its own converter run on one, and what comes out looked at."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from rerun.chunk import RrdReader

from nmes.world import World
from recordings import record, send

RERUN = str(Path(sys.executable).parent / "rerun")
RATE = 20  # poses per second
Rows = list[dict[str, Any]]


def play(world: World, client: int) -> None:
    """Two cubes from the beginning; one goes, one comes, one grows again in another colour."""
    send(world, client, type="spawn_cube", cube_name="a", size=[1, 2, 3], color=[1, 0, 0.5, 1])
    send(world, client, type="spawn_cube", cube_name="b", position=[2, 9, 0], angular_velocity=[0, 1, 0])
    send(world, client, type="spawn_cube", cube_name="middle", position=[0, 0, 0], frozen=True)
    for i in range(30):
        if i == 10:
            send(world, client, type="despawn_cube", cube_name="a")
            send(world, client, type="spawn_cube", cube_name="c")
        if i == 20:
            send(world, client, type="spawn_cube", cube_name="a", size=[4, 4, 4])
        send(world, client, type="step")
        names, states = world.poses()
        states_by_frame[world.frame] = {name: state.tolist() for name, state in zip(names, states, strict=True)}


states_by_frame: dict[int, dict[str, list[float]]] = {}


@pytest.fixture(scope="module")
def converted(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Rows]:
    """The components that Rerun finds, by entity, a row for each message; `frame` is the world's."""
    folder = tmp_path_factory.mktemp("rerun")
    source, target = record(folder / "x.mcap", play, pose_rate=RATE), folder / "x.rrd"
    # A home of its own: it asks whether it may collect statistics only where it was never run before, and waits.
    environment = {**os.environ, "HOME": str(folder), "XDG_CONFIG_HOME": str(folder)}
    subprocess.run(
        [RERUN, "mcap", "convert", str(source), "-o", str(target)],
        env=environment,
        check=True,
        capture_output=True,
        timeout=120,
    )
    entities: dict[str, Rows] = {}
    for chunk in RrdReader(target).stream():
        batch = chunk.to_record_batch()
        times = batch.schema.get_field_index("timestamp")
        if times < 0:
            continue
        columns = {name: batch.column(name).to_pylist() for name in batch.schema.names if ":" in name}
        for i, time in enumerate(batch.column(times)):
            row = {name: values[i] for name, values in columns.items()}
            entities.setdefault(chunk.entity_path, []).append(row | {"frame": round(time.value * 60 / 1e9)})
    return entities


def test_rerun_moves_every_cube(converted: dict[str, Rows]) -> None:
    moved: dict[int, dict[str, list[float]]] = {}
    for row in converted["/tf"]:
        assert row["Transform3D:parent_frame"] == ["world origin"]
        (name,), (place,), (turn,) = (
            row[f"Transform3D:{part}"] for part in ("child_frame", "translation", "quaternion")
        )
        moved.setdefault(row["frame"], {})[name] = [*place, *turn]
    assert moved.keys() == {frame for frame in states_by_frame if frame % (60 // RATE) == 0}
    for frame, poses in moved.items():
        assert poses.keys() == states_by_frame[frame].keys()
        for name, pose in poses.items():
            assert pose == pytest.approx(states_by_frame[frame][name][:7], abs=1e-6)
    assert len({tuple(poses["b"]) for poses in moved.values()}) == len(moved)


def test_rerun_gets_every_box_while_its_cube_lives(converted: dict[str, Rows]) -> None:
    def boxes(name: str) -> list[tuple[Any, ...]]:
        rows = sorted(converted[f"/boxes/{name}"], key=lambda row: row["frame"])
        assert {tuple(row["CoordinateFrame:frame"]) for row in rows} == {(name,)}
        return [
            (
                row["frame"],
                row["VoxelGridMap:voxel_indices"],
                row["VoxelGridMap:voxel_size"][0],
                row["VoxelGridMap:translation"][0],
                [f"{color:08x}" for color in row["VoxelGridMap:colors"]],
            )
            for row in rows
        ]

    one, grey = [[0, 0, 0]], ["ccccccff"]
    assert boxes("a") == [
        (3, one, [1, 2, 3], [-0.5, -1, -1.5], ["ff0080ff"]),
        (12, [], [1, 2, 3], [-0.5, -1, -1.5], []),
        (21, one, [4, 4, 4], [-2, -2, -2], grey),
    ]
    assert boxes("b") == [(3, one, [1, 1, 1], [-0.5, -0.5, -0.5], grey)]
    assert boxes("c") == [(12, one, [1, 1, 1], [-0.5, -0.5, -0.5], grey)]
