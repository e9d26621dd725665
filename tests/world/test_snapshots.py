"""Worlds saved and taken up again: whatever was said and done goes on bit for bit, here and in a fresh process."""

from __future__ import annotations

import json
import subprocess
import sys
from itertools import groupby
from typing import Any

import orjson
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import programs
from histories import FRAMES, histories, play_history
from layout import SUPPORT
from nmes.backends import ballistic
from nmes.errors import RejectedMessage, SimulationFault, WorldError
from nmes.world import World
from recordings import Script

Seen = list[tuple[Any, ...]]


def watched(world: World) -> Seen:
    """Returns the list that all goes into that a world does and says from now on."""
    script = world.journal = Script()
    world.emit = lambda client, event: script.entries.append(("event", client, event))
    return script.entries


@settings(max_examples=60, deadline=None)
@given(histories, st.integers(0, 40), st.sampled_from(["ballistic", "mujoco"]), st.sampled_from([0, 0.05]))
def test_a_restored_world_continues_with_the_same_replies_and_digests(
    what: list[Any], cut: int, backend: str, keyframes: float
) -> None:
    config = {"backend": backend, "mode": "lockstep", "seed": 4, "keyframes": keyframes}
    first = World(config)
    first.join()
    first.join()
    play_history(first, [("say", 0, FRAMES[0]), ("say", 0, FRAMES[6]), ("tick", 3, None), *what[:cut]])
    snapshot = first.snapshot()
    second = World(config)
    play_history(second, [("join", 0, None), ("tick", 3, None), ("say", 0, FRAMES[0])])  # it has a past of its own
    second.restore(snapshot)
    assert second.snapshot() == snapshot
    one, other = watched(first), watched(second)
    assert (first.digest(), first.cubes(), first.clients()) == (second.digest(), second.cubes(), second.clients())
    play_history(first, what[cut:])
    play_history(second, what[cut:])
    assert one == other
    assert first.fault == second.fault
    if first.fault is None:
        assert first.snapshot() == second.snapshot()


CHILD = """
import sys, json
import programs
from nmes.world import World
from recordings import Script
number, cut = int(sys.argv[1]), int(sys.argv[2])
world = World({"backend": sys.argv[3], "mode": "lockstep", "seed": number})
world.restore(sys.stdin.buffer.read())
replies, digests = programs.play(world, programs.draw(number, 80)[cut:])
print(json.dumps([replies, [digest.hex() for digest in digests]]))
"""


@pytest.mark.parametrize(("backend", "number", "cut"), [("mujoco", 61, 40), ("mujoco", 62, 23), ("ballistic", 63, 55)])
def test_a_restored_structure_continues_in_a_fresh_process(backend: str, number: int, cut: int) -> None:
    program = programs.draw(number, 80)
    world = World({"backend": backend, "mode": "lockstep", "seed": number})
    programs.play(world, program[:cut])
    snapshot = world.snapshot()
    replies, digests = programs.play(world, program[cut:])
    child = subprocess.run(
        [sys.executable, "-c", CHILD, str(number), str(cut), backend],
        input=snapshot,
        capture_output=True,
        cwd=SUPPORT,
        timeout=120,
    )
    assert child.returncode == 0, child.stderr.decode()
    assert json.loads(child.stdout) == [replies, [digest.hex() for digest in digests]]
    assert len(digests) == 80 - cut


@pytest.mark.parametrize("number", range(200, 212))
def test_a_restored_structure_continues_the_same(number: int) -> None:
    config = {"mode": "lockstep", "seed": number}
    program, cut = programs.draw(number, 110), 65 + number % 12
    first, second = World(config), World(config)
    programs.play(first, program[:cut])
    second.restore(first.snapshot())
    assert first.joints() == second.joints()
    assert programs.play(first, program[cut:]) == programs.play(second, program[cut:])


def test_a_snapshot_names_its_format_and_engine() -> None:
    world = World({"backend": "ballistic", "name": "w"})
    world.execute(world.join(), {"type": "spawn_cube", "cube_name": "c"})
    line, _, engine = world.snapshot().partition(b"\n")
    state = json.loads(line)
    assert (state["version"], state["frame"], state["ticks"], state["next_client"]) == (1, 0, 0, 2)
    assert [cube["name"] for cube in state["assembly"]["cubes"]] == ["c"]
    assert json.loads(engine)


def test_an_engine_without_snapshots_says_so() -> None:
    world = World({"backend": "pymunk", "keyframes": 0.1})
    with pytest.raises(WorldError) as caught:
        world.snapshot()
    assert caught.value.code == "unsupported"
    for _ in range(20):
        world.tick()
    assert world.fault is None


def test_a_faulted_world_has_no_snapshot() -> None:
    world = World({"backend": "ballistic", "keyframes": 0.1})
    client = world.join()
    world.execute(client, {"type": "spawn_cube"})
    seen = watched(world)
    while world.fault is None:
        world.execute(client, {"type": "apply_physics", "impulse": [1e15, 0, 0]})
        world.tick()
    with pytest.raises(WorldError, match="stopped at frame"):
        world.snapshot()
    keyframes = sum(what[0] == "keyframe" for what in seen)
    for _ in range(20):
        world.tick()
    assert sum(what[0] == "keyframe" for what in seen) == keyframes


def damaged(snapshot: bytes, **changes: object) -> bytes:
    line, _, engine = snapshot.partition(b"\n")
    return orjson.dumps({**json.loads(line), **changes}) + b"\n" + engine


def test_an_invalid_snapshot_is_refused_and_changes_nothing() -> None:
    for backend in ("ballistic", "mujoco"):
        world, other = World({"backend": backend}), World({"backend": backend, "seed": 2})
        client = world.join()
        for command in (
            {"type": "spawn_cube", "cube_name": "a"},
            {"type": "spawn_cube", "cube_name": "b", "position": [0, 3, 0]},
            {"type": "create_joint", "cube1": "a", "cube2": "b", "joint_type": "fixed"},
            {"type": "subscribe"},
        ):
            assert world.execute(client, command)["type"] != "error"
        world.tick()
        snapshot = world.snapshot()
        state = json.loads(snapshot.partition(b"\n")[0])
        lame = {**state["clients"][0], "subscription": {**state["clients"][0]["subscription"], "sent": "AAAA"}}
        loose = {**state["assembly"], "cubes": []}
        for bad, why in (
            (b"", "no snapshot"),
            (b"[]\n", "no snapshot"),
            (b"\xff\n{}", "no snapshot"),
            (damaged(snapshot, version=2), "version 2"),
            (damaged(snapshot, frame="7"), "not a snapshot"),
            (damaged(snapshot, sensors=[]), "not a snapshot"),
            (other.snapshot(), "another config"),
            (damaged(snapshot, clients=[lame]), "does not fit together"),
            (damaged(snapshot, assembly=loose), "does not fit together"),
            (snapshot[:-9], "does not fit together"),
            (snapshot.partition(b"\n")[0] + b"\n", "does not fit together"),
        ):
            with pytest.raises(WorldError, match=why) as caught:
                world.restore(bad)
            assert caught.value.code == "bad_snapshot"
        assert world.snapshot() == snapshot


# -- keyframes -------------------------------------------------------------------------------------------------------


def test_keyframes_are_taken_at_their_interval_between_inputs() -> None:
    world = World({"backend": "ballistic", "mode": "lockstep", "keyframes": 0.1})
    client, seen = world.join(), watched(world)
    batch = {"type": "batch", "commands": [{"type": "step", "ticks": 4}, {"type": "spawn_cube", "cube_name": "c"}]}
    world.execute(client, {"type": "step", "ticks": 14})
    for _ in range(7):
        world.tick()
    world.execute(client, batch)
    world.execute(client, {"type": "reset"})
    world.execute(client, {"type": "step", "ticks": 4})
    world.execute(client, {"type": "step", "ticks": 1})
    runs = [(kind, len(list(row))) for kind, row in groupby(what[0] for what in seen if what[0] != "command")]
    assert runs == [
        *[("tick", 14), ("reply", 1), ("keyframe", 1)],  # due at 6 and at 12, it waits for the command's end
        *[("tick", 4), ("keyframe", 1), ("tick", 3 + 4)],  # at 18, by the clock
        *[("reply", 1), ("keyframe", 1)],
        *[("reply", 1), ("tick", 4), ("reply", 1), ("tick", 1), ("reply", 1)],  # a reset, from which they count anew
    ]
    seen.clear()
    world.execute(client, {"type": "reset"})
    world.execute(client, {"type": "step", "ticks": 5})
    world.execute(client, {"type": "reset"})
    world.execute(client, {"type": "step", "ticks": 6})
    runs = [(kind, len(list(row))) for kind, row in groupby(what[0] for what in seen if what[0] != "command")]
    assert runs == [
        *[("reply", 1), ("keyframe", 1), ("tick", 5)],  # 25 to 30: of an episode that is over
        *[("reply", 2), ("tick", 6), ("reply", 1), ("keyframe", 1)],
    ]


def test_answers_after_a_reset_do_not_depend_on_the_history_before() -> None:
    def readings(world: World) -> list[Any]:
        world.execute(1, {"type": "reset", "seed": 8})
        for n, x in enumerate((0.0, 0.3, 2.0)):
            world.execute(1, {"type": "spawn_cube", "cube_name": f"c{n}", "position": [x, 1.0 + n, 0]})
        replies = []
        for _ in range(40):
            world.execute(1, {"type": "step"})
            replies.append([world.execute(1, {"type": "get_cube_info", "cube_name": f"c{n}"}) for n in range(3)])
        return replies

    fresh = World({"mode": "lockstep", "keyframes": 0.25})
    fresh.join()
    expected = readings(fresh)
    for ticks in (1, 4, 9):  # each time another part of the way to a keyframe
        fresh.execute(1, {"type": "reset"})
        fresh.execute(1, {"type": "step", "ticks": ticks})
        assert readings(fresh) == expected


def test_queries_do_not_change_keyframes() -> None:
    """With a journal or without, with listeners or without: the world goes the same way."""

    def play(world: World) -> tuple[Any, bytes]:
        world.join()
        world.execute(1, {"type": "subscribe"})
        return programs.play(world, programs.draw(5, 60)), world.snapshot()

    config = {"mode": "lockstep", "keyframes": 0.2}
    looked = World(config)
    seen = watched(looked)
    assert play(looked) == play(World(config))
    assert sum(what[0] == "keyframe" for what in seen) > 3


def test_a_snapshot_that_fails_faults_the_world(monkeypatch: pytest.MonkeyPatch) -> None:
    for error, code in ((SimulationFault("engine_failed", "oh"), "engine_failed"), (ValueError("oh"), "engine_failed")):

        def fail(self: object, error: Exception = error) -> bytes:
            raise error

        monkeypatch.setattr(ballistic.BallisticSimulation, "snapshot", fail)
        world = World({"backend": "ballistic", "keyframes": 0.1})
        for _ in range(10):
            world.tick()
        assert world.fault is not None and world.fault.code == code and world.fault.frame == 6


@pytest.mark.parametrize("seconds", [-1, 90_000, "often", None])
def test_invalid_keyframe_intervals_are_refused(seconds: Any) -> None:
    with pytest.raises(RejectedMessage) as caught:
        World({"backend": "ballistic", "keyframes": seconds})
    assert caught.value.path == "keyframes"


def test_a_cube_that_was_frozen_after_the_world_was_saved_can_be_saved_again() -> None:
    world = World({"mode": "lockstep"})
    client = world.join()
    world.execute(client, {"type": "spawn_cube", "cube_name": "a", "position": [0, 3, 0]})
    world.snapshot()  # the engine has taken it up, and not ticked yet
    world.execute(client, {"type": "freeze_cube", "cube_name": "a", "freeze": True})
    restored = World({"mode": "lockstep"})
    restored.restore(world.snapshot())
    for each in (world, restored):
        each.execute(client, {"type": "spawn_cube", "cube_name": "b", "position": [0, 3.5, 0]})
        each.execute(client, {"type": "freeze_cube", "cube_name": "a", "freeze": False})
        each.execute(client, {"type": "step", "ticks": 30})
    assert world.digest() == restored.digest()
