"""Ecosystems go on for hours, so no creature that the engine cannot follow may stop one: it dies of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from creatures import exploding
from ecosystems import config, of, run, watched
from nmes import World
from nmes.backends.mujoco3d import compiler
from nmes.playback import replay
from nmes.recording import Recorder, Recording

Json = dict[str, Any]


def bang(world: World, client: int, name: str) -> None:
    """Sets down a creature that makes the engine fail as soon as it is driven."""
    genome = {**exploding(), "name": name}
    place = [40 + 5 * len(name), 0.5, 40]
    world.execute(client, {"type": "spawn_creature", "name": name, "genome": genome, "position": place})
    run(world, 1)  # it is counted among the living
    world.execute(client, {"type": "drive", "creature": name, "controls": [1.0, -1.0, 1.0]})


@pytest.mark.parametrize("names", [("one",), ("one", "three")])
def test_a_creature_that_the_engine_cannot_follow_dies_and_the_others_live_on(names: tuple[str, ...]) -> None:
    world, client, events = watched(config())
    run(world, 30)
    for name in names:
        bang(world, client, name)
    run(world, 200)
    died = {each["creature"]: each["cause"] for each in of(events, "creature_died") if each["creature"] in names}
    assert died == dict.fromkeys(names, "diverged")
    life = world.execute(client, {"type": "get_life"})
    assert len(life["living"]) > 3 and not {each["creature"] for each in life["living"]} & {*names}
    assert not [cube for cube in world.entities.cubes if cube.partition(".")[0] in names]


def test_a_creature_with_more_contacts_than_there_is_room_for_dies_and_the_others_live_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiler, "arena_bytes", lambda bodies: 120 << 10)
    monkeypatch.setattr(compiler, "_SMALL", -1)  # no models with more room from before
    world, client, events = watched(config())
    recorder = world.journal = Recorder(tmp_path / "raft.mcap", world)
    run(world, 30)
    places = [(i, j) for i in range(6) for j in range(6)]
    cubes = [{"id": f"c{i}{j}", "size": 0.3, "mass": 0.5, "position": [0.32 * i, 0.15, 0.32 * j]} for i, j in places]
    joints = [
        {
            **{"id": f"j{i}{j}", "type": "fixed", "anchor": [0.32 * i, 0.15, 0.32 * j], "cube2": f"c{i}{j}"},
            "cube1": f"c{i - 1}{j}" if i else f"c0{j - 1}",
        }
        for i, j in places[1:]
    ]
    raft = {"format": "nmes-genome/1", "name": "raft", "body": {"cubes": cubes, "joints": joints}}
    world.execute(client, {"type": "spawn_creature", "name": "raft", "genome": raft, "position": [40, 0.16, 40]})
    run(world, 100)
    assert [(each["creature"], each["cause"]) for each in of(events, "creature_died")] == [("raft", "diverged")]
    recorder.close()
    for begin in (None, 31, 35):
        assert replay(Recording(tmp_path / "raft.mcap"), first=begin).verdict == "reproduced", begin


def test_what_was_lost_is_lost_again_in_a_replay_from_any_keyframe(tmp_path: Path) -> None:
    world, client, events = watched(config())
    recorder = world.journal = Recorder(tmp_path / "lost.mcap", world)
    run(world, 10)
    bang(world, client, "one")
    run(world, 130)
    (frame,) = (each["frame"] for each in of(events, "creature_died") if each["cause"] == "diverged")
    recorder.close()
    recording = Recording(tmp_path / "lost.mcap")
    for begin in (None, frame - 1, frame, frame + 50):
        assert replay(recording, first=begin).verdict == "reproduced", begin


def test_a_cube_that_lives_not_stops_its_world_as_ever() -> None:
    world, client, _ = watched(config())
    world.execute(client, {"type": "spawn_cube", "cube_name": "stone", "position": [60, 2, 60]})
    run(world, 5)
    for _ in range(40):
        world.execute(client, {"type": "apply_force", "cube_name": "stone", "force": [1e9, 1e9, 0]})
        world.tick()
    if world.fault is None:
        world.execute(client, {"type": "set_cube_state", "cube_name": "stone", "linear_velocity": [1e9, 1e9, 0]})
        for _ in range(2000):
            world.tick()
    assert world.fault is not None and world.fault.cube == "stone"
