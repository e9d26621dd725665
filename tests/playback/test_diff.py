from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from nmes.backend.fingerprint import fingerprint
from nmes.cli import main
from nmes.errors import RecordingError
from nmes.playback.diff import compare
from nmes.recording import Recording
from nmes.world import World
from recordings import Line, busy, record, rewrite, send

Play = Callable[[World, int], None]


def run(*arguments: str | Path) -> tuple[int, str]:
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.output


def pushed(at: int, force: float, ticks: int = 30) -> Play:
    """Returns a play in which a cube is pushed once, before a tick."""

    def play(world: World, client: int) -> None:
        send(world, client, type="spawn_cube", cube_name="still", position=[5, 9, 0])
        send(world, client, type="spawn_cube", cube_name="pushed", position=[0, 9, 0])
        for tick in range(ticks):
            if tick == at:
                send(world, client, type="apply_physics", cube_name="pushed", force=[force, 0, 0])
            send(world, client, type="step")

    return play


def compared(folder: Path, one: Play, other: Play, **config: Any) -> Any:
    first = record(folder / "a.mcap", one)
    return compare(Recording(first), Recording(record(folder / "b.mcap", other, config)))


def test_equal_histories_do_not_differ(tmp_path: Path) -> None:
    comparison = compared(tmp_path, busy, busy)
    assert comparison.same and comparison.ticks == (40, 40) and comparison.drifts == {}
    assert run("diff", tmp_path / "a.mcap", tmp_path / "b.mcap") == (
        0,
        "inputs: the same\nstates: the same after each of 40 ticks\n",
    )


@pytest.mark.parametrize("at", [0, 7, 29])
def test_one_unit_in_the_last_place_is_found_at_its_tick(tmp_path: Path, at: int) -> None:
    comparison = compared(tmp_path, pushed(at, 3.0), pushed(at, math.nextafter(3.0, 4.0)))
    assert not comparison.same
    assert comparison.inputs is not None and comparison.inputs.ticks == at
    assert '"force":[3.0,0,0]' in comparison.inputs.first and "3.0000000000000004" in comparison.inputs.second
    part = comparison.states
    # So small a force may be rounded away; where it is not, it is found at the tick it acts in, on the cube it is of.
    if part is not None:
        assert part.tick >= at + 1 and part.cube in ("pushed", None)


def test_the_first_difference_of_states_is_shown_with_its_size(tmp_path: Path) -> None:
    comparison = compared(tmp_path, pushed(7, 3.0), pushed(7, 4.0))
    part = comparison.states
    assert (part.tick, part.cube, part.field) == (8, "pushed", "linear_x")
    assert part.second == pytest.approx(part.first * 4 / 3)
    assert [drift.distance for drift in comparison.drifts["still"]] == [0.0] * 6
    apart = [drift.distance for drift in comparison.drifts["pushed"]]
    assert apart == sorted(apart) and apart[0] == 0 < apart[1]
    assert comparison.drifts["pushed"][-1].time == 0.5
    code, output = run("diff", tmp_path / "a.mcap", tmp_path / "b.mcap", "--plot", tmp_path / "x.svg")
    assert code == 1
    assert "inputs part after 7 ticks\n  force/0: A 3.0, B 4.0\n  A: client 1 command" in output
    assert "states part at tick 8 (A has 30, B has 30)\n  cube pushed: linear_x: A " in output
    lines = output.splitlines()
    assert lines[-2].startswith("pushed ") and lines[-1].startswith("still ")
    assert "pushed</text>" in (tmp_path / "x.svg").read_text()
    code, output = run("diff", tmp_path / "a.mcap", tmp_path / "b.mcap", "--json")
    assert code == 1 and json.loads(output) == json.loads(json.dumps(comparison.to_json()))


def spawned(mass: float, model: str = "") -> Play:
    """Returns a play in which a creature of many cubes comes, of which one has this mass."""
    cubes = [{"id": f"c{i}", "size": 0.1, "mass": 1, "position": [0, 1 + 0.1 * i, 0]} for i in range(20)]
    cubes[17]["mass"] = mass
    joints = [
        {"id": f"j{i}", "cube1": f"c{i}", "cube2": f"c{i + 1}", "type": "fixed", "anchor": [0, 1, 0]} for i in range(19)
    ]
    genome = {
        "format": "nmes-genome/1",
        "name": "pile",
        "description": model,
        "body": {"cubes": cubes, "joints": joints},
    }

    def play(world: World, client: int) -> None:
        send(world, client, type="spawn_creature", genome=genome)
        send(world, client, type="step")

    return play


def test_the_field_of_a_long_command_that_differs_is_named(tmp_path: Path) -> None:
    part = compared(tmp_path, spawned(1), spawned(2)).inputs
    assert (part.field, part.values) == ("genome/body/cubes/17/mass", (1, 2))
    assert part.first != part.second and len(part.first) < 400 > len(part.second)
    output = run("diff", tmp_path / "a.mcap", tmp_path / "b.mcap")[1]
    assert "inputs part after 0 ticks\n  genome/body/cubes/17/mass: A 1, B 2\n  A: client 1 command " in output
    lines = output.splitlines()
    assert '"mass":1' in lines[2] and '"mass":2' in lines[3]


def test_of_long_texts_what_stands_around_the_difference_is_shown(tmp_path: Path) -> None:
    one, other = "a" * 3000 + "b" + "a" * 3000, "a" * 3000 + "c" + "a" * 3000
    part = compared(tmp_path, spawned(1, one), spawned(1, other)).inputs
    assert part.field == "genome/description" and part.values == (one, other)
    (line,) = [
        line
        for line in run("diff", tmp_path / "a.mcap", tmp_path / "b.mcap")[1].splitlines()
        if line.startswith("  genome/description: ")
    ]
    assert "ab" in line and "ac" in line and len(line) < 700


def test_commands_of_two_types_differ_in_their_type(tmp_path: Path) -> None:
    def waiting(world: World, client: int) -> None:
        send(world, client, type="step")

    part = compared(tmp_path, spawned(1), waiting).inputs
    assert (part.field, part.values) == ("type", ("spawn_creature", "step"))
    assert json.loads(run("diff", tmp_path / "a.mcap", tmp_path / "b.mcap", "--json")[1])["inputs"]["field"] == "type"


def test_equal_recordings_have_no_drift_to_plot(tmp_path: Path) -> None:
    compared(tmp_path, pushed(7, 3.0), pushed(7, 3.0))
    code, output = run("diff", tmp_path / "a.mcap", tmp_path / "b.mcap", "--plot", tmp_path / "x.svg")
    assert code == 0 and "nothing to plot: there is no distance (m);" in output and "states: the same" in output
    assert not (tmp_path / "x.svg").exists()


def test_one_ends_before_the_other(tmp_path: Path) -> None:
    comparison = compared(tmp_path, pushed(2, 1.0), pushed(2, 1.0, ticks=20))
    assert (comparison.inputs.ticks, comparison.inputs.second) == (20, "the end")
    assert comparison.inputs.field is None
    assert comparison.states.tick == 21 and comparison.states.field is None


def test_cubes_that_only_one_recording_has_are_listed(tmp_path: Path) -> None:
    def more(world: World, client: int) -> None:
        send(world, client, type="spawn_cube", cube_name="more")
        pushed(3, 1.0)(world, client)

    part = compared(tmp_path, pushed(3, 1.0), more).states
    assert (part.tick, part.cube, part.field) == (1, None, "cubes")
    assert part.second == ["more", "still", "pushed"]
    assert "cubes: A ['still', 'pushed'], B" in run("diff", tmp_path / "a.mcap", tmp_path / "b.mcap")[1]


def test_worlds_of_another_gravity_differ_at_the_first_tick(tmp_path: Path) -> None:
    comparison = compared(tmp_path, busy, busy, gravity=[0, -1, 0])
    assert comparison.inputs is None
    assert (comparison.states.tick, comparison.states.field) == (1, "linear_y")


def test_a_recording_that_does_not_replay_is_compared_only_if_told_to_keep_going(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def harder(lines: list[Line]) -> list[Line]:
        return [line._replace(data=line.data.replace(b"[3.0,0,0]", b"[9.0,0,0]")) for line in lines]

    path = rewrite(record(tmp_path / "a.mcap", pushed(7, 3.0)), tmp_path / "edited.mcap", harder)
    other = Recording(record(tmp_path / "b.mcap", pushed(7, 4.0)))
    with pytest.raises(RecordingError, match="does not come out as recorded"):
        compare(Recording(path), other)
    assert compare(Recording(path), other, keep_going=True).states is not None
    monkeypatch.setattr("nmes.playback.report.fingerprint", lambda backend: {**fingerprint(backend), "probe": "0ff"})
    code, output = run("diff", path, other.path)
    assert code == 3 and "recorded with another probe" in output
    assert "3 a recording does not come out the same here" in " ".join(run("diff", "--help")[1].split())
    assert run("diff", path, other.path, "--keep-going")[0] == 1
