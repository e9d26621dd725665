"""Random programs of growth, loss, adoption and development: no fault, exact replays, forks from anywhere."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest

from creatures import SINE, mlp, snake
from nmes import World, protocol
from nmes.playback import replay
from nmes.recording import Recorder

Json = dict[str, Any]
PARTS = ["c0", "c1", "c2", "c3", "c4"]


def any_command(draw: random.Random, world: World) -> Json:
    """Returns a command that changes what hangs on what, about whatever is there; some of them are refused."""
    cube = draw.choice(world.cubes() or ["none"])
    joint = draw.choice(world.joints() or ["none"])
    about = {"creature": draw.choice(world.creatures() or ["none"]), "part": draw.choice(PARTS[1:])}
    kinds: list[Json] = [
        {"type": "grow", **about},
        {"type": "grow", **about},
        {"type": "shed", **about, "remove": draw.random() < 0.5},
        {"type": "adopt", **about, "cube_name": cube},
        {"type": "remove_joint", "joint_name": joint},
        {"type": "despawn_cube", "cube_name": cube},
        {"type": "create_joint", "joint_type": "fixed", "cube1": cube, "cube2": draw.choice(world.cubes() or ["none"])},
        {"type": "set_cube_state", "cube_name": cube, "position": [draw.uniform(-4, 4), draw.uniform(1, 4), 0]},
        {"type": "spawn_cube", "size": 0.2, "position": [draw.uniform(-3, 3), 3, 0], "list": False},
        {"type": "sense", "creature": about["creature"]},
    ]
    return draw.choice(kinds)


def any_rules(draw: random.Random) -> list[Json]:
    """Returns rules of development for a snake; some of them will find nothing to do, or no room."""

    def some() -> list[str]:
        return draw.sample(PARTS[1:], draw.randrange(1, 3))

    kinds: list[Json] = [
        {"shed": some()},
        {"grow": some()},
        {"adopt": some()},
        {"resize": [{"part": part, "scale": draw.choice([0.5, 1, 1.3])} for part in some()]},
        {"enter": draw.randrange(1, 4)},
    ]
    conditions = [
        f"age > {draw.uniform(0, 2):.3f}",
        'has("c2") < 1',
        "cubes < 4",
        "stage > 1",
        'sense("c0.up.y") > 0.9',
    ]
    return [
        {
            "when": draw.choice(conditions),
            **{name: value for kind in draw.sample(kinds, 2) for name, value in kind.items()},
            "every": draw.choice([0.1, 0.5]),
            "times": draw.randrange(1, 9),
        }
        for _ in range(draw.randrange(1, 6))
    ]


def run(seed: int, backend: str, recording: Path | None = None) -> set[str]:
    """Runs a program of forty commands, and replays it or goes on from some place in it; returns the replies' types.

    A snapshot is an event of a history: a world that is recorded is not saved on the way.
    """
    draw, gravity = random.Random(f"growth {seed}"), [0.0, -9.81 * (seed % 2), 0.0]
    world = World({"mode": "lockstep", "seed": seed, "backend": backend, "gravity": gravity})
    recorder = None if recording is None else Recorder(recording, world)
    world.journal = recorder
    client, replies, tail, digests = world.join(), set[str](), list[Json](), list[bytes]()
    for place, name in enumerate("ab"):
        brain = draw.choice([SINE, mlp(5, hidden=4, seed=seed)])
        genome = {**snake(brain, 5), "later": draw.choice([[], ["c4"], ["c2", "c3", "c4"]])}
        if draw.random() < 0.6:
            genome["development"] = any_rules(draw)
        spawn = {"type": "spawn_creature", "genome": genome, "name": name, "position": [0, 1 + 2 * place, 0]}
        assert world.execute(client, {**spawn, "autonomous": True})["type"] == "creature_spawned"
    fork, saved = draw.randrange(30), b""
    for number in range(40):
        if number == fork and recorder is None:
            saved = world.snapshot()
        command = any_command(draw, world)
        before = world.digest()
        reply = world.execute(client, command)
        protocol.validate_reply(reply)
        replies.add(str(reply.get("code", reply["type"])))
        assert reply["type"] != "error" or world.digest() == before, (seed, command, reply)
        step = {"type": "step", "ticks": draw.randrange(1, 4)}
        world.execute(client, step)
        assert world.fault is None, (seed, command, world.fault)
        if saved:
            tail += [command, step]
            digests.append(world.digest())
        for creature in map(world.creature, world.creatures()):
            assert len(creature.sense()) == len(creature.sensors) and {*creature.cubes.values()} <= {*world.cubes()}
    world.close()
    if recorder is not None and recording is not None:
        recorder.close()
        assert replay(recording).verdict == "reproduced", seed
    else:
        other = World(world.config)
        other.restore(saved)
        for command in tail:
            other.execute(client, command)
            assert command["type"] != "step" or other.digest() == digests.pop(0), (seed, command)
        other.close()
    assert not {"internal", "world_faulted"} & replies
    return replies


ENGINES = ("mujoco", "pymunk")  # of the others none has hinges; pymunk has no snapshots, so nothing to go on from


def test_programs_of_growth_go_on_from_anywhere() -> None:
    replies = set[str]().union(*(run(seed, "mujoco") for seed in range(10)))
    assert {"part_grown", "part_shed", "no_room", "cube_not_found", "invalid"} <= replies


@pytest.mark.parametrize("backend", ENGINES)
def test_programs_of_growth_replay(tmp_path: Path, backend: str) -> None:
    for seed in range(20, 26):
        run(seed, backend, tmp_path / f"{seed}.mcap")


@pytest.mark.long
@pytest.mark.parametrize("backend", ENGINES)
def test_many_programs_of_growth(tmp_path: Path, backend: str) -> None:
    for seed in range(1000, 1300):
        run(seed, backend, tmp_path / f"{seed}.mcap")


@pytest.mark.long
def test_many_programs_of_growth_go_on_from_anywhere() -> None:
    for seed in range(2000, 2400):
        run(seed, "mujoco")
