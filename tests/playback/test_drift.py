"""A recording on another engine: how far its cubes drift from where they were."""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from nmes import World
from nmes.cli import main
from nmes.errors import BackendNotFound, RejectedMessage
from nmes.playback.drift import measure_drift
from nmes.recording import Recorder

G = 9.81
STEP = 1 / 240

HEAD = {"verdict", "commands", "ticks", "wall_seconds", "differences", "damage"}  # keys of all reports of a replay


class Session:
    """A recorded world with one client."""

    def __init__(self, path: Path, pose_rate: float = 10.0, **config: Any) -> None:
        self.path = path
        self.world = World({"mode": "lockstep", **config})
        self.world.journal = self.recorder = Recorder(path, self.world, pose_rate=pose_rate)
        self.client = self.world.join()

    def __call__(self, type: str, **fields: Any) -> dict[str, Any]:
        return self.world.execute(self.client, {"type": type, **fields})

    def close(self) -> Path:
        self.recorder.close()
        self.world.close()
        return self.path


@pytest.fixture
def falling(tmp_path: Path) -> Path:
    """A cube in free fall on the reference engine, ticked by steps and by the clock."""
    session = Session(tmp_path / "falling.mcap", backend="ballistic")
    session("spawn_cube", cube_name="stone", position=[0, 100, 0], linear_velocity=[3, 0, 0])
    session("step", ticks=90)
    for _ in range(60):
        session.world.tick()
    session("step", ticks=30)
    return session.close()


def test_on_the_same_engine_nothing_drifts(falling: Path) -> None:
    report = measure_drift(falling, "ballistic")
    assert (report.ticks, report.commands, report.ended, report.refused) == (180, 3, None, {})
    assert (report.verdict, report.differences, report.damage) == ("ran", {}, None)
    (drifts,) = report.cubes.values()
    assert len(drifts) > 25
    assert all(drift.distance < 1e-5 and drift.angle < 1e-6 for drift in drifts)


def test_the_drift_is_what_the_engines_integrate_differently(falling: Path) -> None:
    report = measure_drift(falling, "pymunk")
    assert (report.recorded, report.backend) == ("ballistic", "pymunk")
    assert report.differences["backend"] == ("ballistic", "pymunk")
    assert list(report.cubes) == ["stone"]
    times = [drift.time for drift in report.cubes["stone"]]
    assert times == sorted(times) and times[-1] == 3.0
    for drift in report.cubes["stone"]:
        # It moves by the velocity of before each step, so it lags behind the parabola by half a step's fall.
        assert drift.distance == pytest.approx(G * drift.time * STEP / 2, abs=1e-4)


def test_commands_that_the_other_engine_refuses_are_counted(tmp_path: Path) -> None:
    session = Session(tmp_path / "joined.mcap", backend="pymunk")
    session("spawn_cube", cube_name="one", position=[0, 5, 0], is_base=True)
    session("spawn_cube", cube_name="two", position=[1.5, 5, 0])
    name = session("create_joint", cube1="one_BASE", cube2="two", joint_type="hinge")["joint_name"]
    session("set_joint_param", joint_name=name, param_name="target_position", value=1.0)
    session("remove_joint", joint_name="never was")
    session("step", ticks=60)
    report = measure_drift(session.close(), "ballistic")
    assert report.refused == {"unsupported": 1, "joint_not_found": 1}
    assert report.cubes["one_BASE"][-1].distance < 1e-6
    assert report.cubes["two"][-1].distance > 1.0


def test_rotation_drifts_too(tmp_path: Path) -> None:
    session = Session(tmp_path / "turning.mcap", backend="ballistic", gravity=[0, 0, 0])
    session("spawn_cube", cube_name="top", position=[0, 5, 0], angular_velocity=[1, 0, 0])
    session("step", ticks=60)
    report = measure_drift(session.close(), "pymunk")
    drift = report.cubes["top"][-1]
    assert drift.angle == pytest.approx(drift.time, abs=1e-3), "the plane has no rotation about x"


def test_drift_ends_where_the_other_engine_faults(tmp_path: Path) -> None:
    session = Session(tmp_path / "stopping.mcap", backend="ballistic")
    session("spawn_cube", cube_name="bullet", position=[0, 5, 0])
    session("step", ticks=30)
    session("apply_physics", cube_name="bullet", impulse=[1e15, 0, 0])
    session("step", ticks=30)
    report = measure_drift(session.close(), "pymunk")
    assert report.ended is not None and "pymunk stopped at frame 30" in report.ended
    assert report.verdict == "incomplete"
    assert report.ticks == 30


def test_an_unknown_engine_is_an_error(falling: Path) -> None:
    with pytest.raises(BackendNotFound, match="did you mean 'pymunk'"):
        measure_drift(falling, "pymonk")


def test_the_settings_of_one_engine_are_not_given_to_another(tmp_path: Path) -> None:
    session = Session(tmp_path / "settings.mcap", backend="pymunk", engine={"iterations": 20})
    session("spawn_cube", position=[0, 5, 0])
    session("step", ticks=10)
    path = session.close()
    assert measure_drift(path, "ballistic").ticks == 10
    assert measure_drift(path, "pymunk").cubes


# -- the command ------------------------------------------------------------------------------------------------------


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["replay", *map(str, arguments)])


def test_the_table_of_drift_shows_each_cube(falling: Path) -> None:
    result = run(falling, "--backend", "pymunk")
    assert result.exit_code == 0, result.output
    first, *rest = result.output.splitlines()
    assert first == "recorded on ballistic, run on pymunk: 180 ticks (3.00 s), 3 commands"
    (row,) = [line.split() for line in rest if line.startswith("stone")]
    assert row[-2:] == [f"{G * 3.0 * STEP / 2:.4f}", "0.00°"]


def test_the_plot_of_drift_is_a_picture(falling: Path, tmp_path: Path) -> None:
    result = run(falling, "--backend", "pymunk", "--plot", tmp_path / "drift.svg")
    assert result.exit_code == 0, result.output
    picture = ElementTree.parse(tmp_path / "drift.svg").getroot()
    (line,) = picture.iter("{http://www.w3.org/2000/svg}polyline")
    heights = [float(point.split(",")[1]) for point in line.attrib["points"].split()]
    assert heights == sorted(heights, reverse=True), "the drift grows, so the line goes up"
    assert "stone" in [text.text for text in picture.iter("{http://www.w3.org/2000/svg}text")]


def test_drift_is_printed_as_json(falling: Path) -> None:
    document = json.loads(run(falling, "--backend", "pymunk", "--json").output)
    assert document["cubes"]["stone"][-1]["time"] == 3.0
    assert math.isfinite(document["wall_seconds"])
    assert HEAD <= set(document)
    path = falling.with_suffix(".jsonl")
    path.write_text('{"type":"ping"}\n')
    for options in ([falling], [path]):
        assert HEAD <= set(json.loads(run(*options, "--json").output))


def test_without_poses_there_is_nothing_to_compare(tmp_path: Path) -> None:
    session = Session(tmp_path / "blind.mcap", pose_rate=0, backend="ballistic")
    session("spawn_cube")
    session("step", ticks=10)
    result = run(session.close(), "--backend", "pymunk")
    assert result.exit_code == 0
    assert "no poses" in result.output


def test_wrong_usage_is_explained(falling: Path, tmp_path: Path) -> None:
    assert run(falling, "--plot", tmp_path / "drift.svg").exit_code == 2
    result = run(falling, "--backend", "pymonk")
    assert result.exit_code == 1
    assert "did you mean" in result.output


def test_a_config_that_the_other_engine_refuses_is_an_error(tmp_path: Path) -> None:
    session = Session(tmp_path / "hills.mcap", backend="pymunk", scene={"type": "heightfield"})
    session("step", ticks=1)
    with pytest.raises(RejectedMessage, match="scenery"):
        measure_drift(session.close(), "ballistic")
