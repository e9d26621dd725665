"""Creatures whose brains a world runs: as an outside driver would, and the same again from every keyframe."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nmes import World
from nmes.errors import WorldError
from nmes.evaluation import Task
from nmes.genome import Genome
from nmes.playback import replay
from nmes.recording import Recorder
from nmes.variation import Draw, random_genome
from nmes.world.snapshot import pack, unpack

CONFIG: dict[str, Any] = {"mode": "lockstep", "tick_rate": 30, "seed": 5, "keyframes": 0.5}
NAMES = ("walker", "seeker", "centipede", "lurcher")  # sine, graph, cpg, mlp or the like


def spawn(world: World, client: int, genome: dict[str, Any], place: int, **more: Any) -> dict[str, Any]:
    position = [3.0 * place, 0.0, 0.0]
    return world.execute(client, {"type": "spawn_creature", "genome": genome, "position": position, **more})


def world_of_many(path: Path | None = None) -> World:
    world = World(CONFIG)
    if path is not None:
        world.journal = Recorder(path, world)
    client = world.join()
    genomes = [Genome.load(name) for name in NAMES]
    genomes += [random_genome(Draw(7, number), Task.load("walk").requirements, "drawn") for number in range(6)]
    for place, genome in enumerate(genomes):
        reply = spawn(world, client, genome.document, place, autonomous=True, target=[9.0, 0.0, 9.0])
        assert reply["type"] == "creature_spawned", reply
    return world


@pytest.mark.parametrize("name", NAMES)
def test_a_world_drives_a_creature_as_somebody_outside_does_with_the_same_brain(name: str) -> None:
    genome, states = Genome.load(name), []
    for autonomous in (True, False):
        world = World(CONFIG)
        client = world.join()
        spawned = spawn(world, client, genome.document, 0, name="it", autonomous=autonomous)
        assert spawned["type"] == "creature_spawned"
        brain = genome.brain()
        brain.reset(0, 1.0 / 30)
        for _ in range(45):
            if not autonomous:
                world.drive(client, "it", np.array(brain.step(world.creature("it").sense())))
            world.tick()
        states.append(world.poses()[1])
    assert states[0].tobytes() == states[1].tobytes()


@pytest.mark.parametrize("frame", [0, 1, 40, 64, 71])
def test_a_world_that_was_saved_and_one_restored_from_that_go_on_alike(frame: int) -> None:
    world, other = world_of_many(), World(CONFIG)
    for _ in range(frame):
        world.tick()
    other.restore(world.snapshot())
    for _ in range(70):
        world.tick()
        other.tick()
        assert other.digest() == world.digest()


def test_what_brains_did_is_replayed_from_the_start_and_from_a_keyframe(tmp_path: Path) -> None:
    world = world_of_many(tmp_path / "minds.mcap")
    for _ in range(90):
        world.tick()
    world.close()
    assert isinstance(world.journal, Recorder)
    world.journal.close()
    assert replay(tmp_path / "minds.mcap").verdict == "reproduced"
    part = replay(tmp_path / "minds.mcap", first=50)
    assert part.verdict == "reproduced" and part.frames[0] >= 45


def test_the_digest_tells_what_brains_remember() -> None:
    world = world_of_many()
    for _ in range(10):
        world.tick()
    before = world.digest()
    mind = world.creature(world.creatures()[1]).mind
    assert mind is not None
    mind._brain.recall(mind.memory() + 0.25)
    assert world.digest() != before


def test_a_creature_with_a_brain_of_its_own_takes_no_drive() -> None:
    world = World(CONFIG)
    client = world.join()
    spawn(world, client, Genome.load("walker").document, 0, name="it", autonomous=True)
    controls = [0.0] * len(world.creature("it").motors)
    reply = world.execute(client, {"type": "drive", "creature": "it", "controls": controls})
    assert (reply["code"], reply["field"]) == ("invalid", "creature")


@pytest.mark.parametrize("brain", [None, {"kind": "onnx", "model": "AAAA"}, {"kind": "sine", "oscillators": []}])
def test_a_world_runs_no_brain_that_is_none(brain: dict[str, Any] | None) -> None:
    world = World(CONFIG)
    document = Genome.load("walker").document
    document.pop("brain")
    reply = spawn(world, world.join(), document | ({} if brain is None else {"brain": brain}), 0, autonomous=True)
    assert (reply["type"], reply["code"], reply["field"]) == ("error", "invalid", "genome/brain")
    assert world.cubes() == [] and world.creatures() == []


def test_a_creature_that_lost_its_root_is_driven_no_more() -> None:
    world = World(CONFIG)
    client = world.join()
    spawned = spawn(world, client, Genome.load("walker").document, 0, name="it", autonomous=True)
    world.tick()
    world.execute(client, {"type": "despawn_cube", "cube_name": next(iter(spawned["cubes"].values()))})
    engine = world.simulation.digest()
    world.tick()
    assert world.fault is None and world.creatures() == []
    assert world.digest() == world.simulation.digest() != engine


def test_a_creature_is_taken_out_as_the_genome_that_it_came_from() -> None:
    world = World(CONFIG)
    client = world.join()
    genome = Genome.load("walker")
    spawn(world, client, genome.document, 0, name="it")
    reply = world.execute(client, {"type": "get_genome", "creature": "it"})
    assert Genome(reply["genome"]).hash == genome.hash and reply["creature"] == "it"
    reply = world.execute(client, {"type": "get_genome", "creature": "nobody"})
    assert (reply["code"], reply["field"]) == ("creature_not_found", "creature")


@pytest.mark.parametrize("mind", ["", "AAAA", "not base64", "AAAAAAAA+H8="])
def test_a_keyframe_with_a_mind_of_another_brain_is_refused(mind: str) -> None:
    world = World(CONFIG)
    spawn(world, world.join(), Genome.load("seeker").document, 0, autonomous=True)
    state, engine = unpack(world.snapshot(), world.config)
    del state["version"], state["config"]
    state["creatures"]["creatures"][0]["mind"] = mind
    with pytest.raises(WorldError, match="snapshot") as caught:
        World(CONFIG).restore(pack(world.config, state, engine))
    assert caught.value.code == "bad_snapshot"
