"""Rules of an ecosystem that have no finite value for somebody are the end of that creature, and of nobody else."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ecosystems import config, of, run, watched
from nmes import World, protocol
from nmes.playback import replay
from nmes.recording import Recorder, Recording

Json = dict[str, Any]

DEAR = "mass * 40 / motors"  # of a body without motors it is infinite
STILL: Json = {"food": {"start": 0, "rate": 0}, "population": {"start": 2, "most": 2}, "birth": {"start": 9000}}


def lump(size: float = 0.4, mass: float = 1.0) -> Json:
    """A genome of one cube, without a motor."""
    cube = {"id": "it", "size": size, "mass": mass, "position": [0, size / 2, 0]}
    return {"format": "nmes-genome/1", "name": "lump", "body": {"cubes": [cube]}}


def bring(world: World, client: int, name: str, **fields: Any) -> None:
    place = {"position": [40 + 2 * len(name), 0, 40], "genome": lump(), **fields}
    reply = world.execute(client, {"type": "spawn_creature", "name": name, **place})
    assert reply["type"] == "creature_spawned", reply


def energies(world: World, client: int) -> dict[str, float]:
    return {each["creature"]: each["energy"] for each in world.execute(client, {"type": "get_life"})["living"]}


@pytest.mark.parametrize("cost", [DEAR, "0 * mass / motors", "log(motors)", "20 - mass / motors"])
def test_whom_the_rules_have_no_price_for_dies_and_the_others_live_on(cost: str) -> None:
    world, client, events = watched(config(**{**STILL, "cost": cost, "death": {"carrion": 5}}))
    run(world, 7)
    others = energies(world, client)
    bring(world, client, "lump")
    run(world, 1)
    (death,) = of(events, "creature_died")
    protocol.validate_event(death)
    assert (death["creature"], death["cause"], death["frame"], death["age"]) == ("lump", "unpriced", 8, 0.0)
    assert others.keys() == energies(world, client).keys() and len(others) == 2
    assert not [cube for cube in world.cubes() if cube.startswith("lump")]
    assert world.execute(client, {"type": "get_life"})["food"] == []
    run(world, 60)
    assert others.keys() == energies(world, client).keys()


def test_who_loses_its_last_motor_dies_of_it() -> None:
    world, client, events = watched(config(**STILL, cost=DEAR))
    run(world, 5)
    first, second = world.creatures()
    for part in ("left.front", "left.back", "right.front", "right.back"):
        assert world.execute(client, {"type": "shed", "creature": first, "part": part})["type"] == "part_shed"
    run(world, 1)
    assert [(each["creature"], each["cause"]) for each in of(events, "creature_died")] == [(first, "unpriced")]
    assert world.creatures() == [second]


def test_others_pay_and_eat_in_the_tick_in_which_somebody_is_cast_out_as_ever() -> None:
    without, with_lump = (watched(config(cost=DEAR)) for _ in range(2))
    for world, client, _ in (without, with_lump):
        run(world, 4)
        if world is with_lump[0]:
            bring(world, client, "lump")
        run(world, 1)
    assert energies(*without[:2]) == energies(*with_lump[:2])


def test_of_several_all_die_in_the_order_in_which_they_came() -> None:
    world, client, events = watched(config(**STILL, cost=DEAR))
    run(world, 3)
    for name in ("one", "three", "eleven"):
        bring(world, client, name)
    run(world, 1)
    assert [each["creature"] for each in of(events, "creature_died")] == ["one", "three", "eleven"]
    assert world.life is not None and world.life.died == 3 and len(world.creatures()) == 2


def test_a_world_whose_rules_have_a_price_for_nobody_goes_on_empty() -> None:
    world, client, events = watched(
        config(**{**STILL, "cost": "1 / (cubes - 5)", "population": {"start": 2, "least": 1}})
    )
    run(world, 61)
    assert {each["cause"] for each in of(events, "creature_died")} == {"unpriced"}
    assert energies(world, client) == {}
    assert world.execute(client, {"type": "get_life"})["died"] == len(of(events, "creature_died")) == 5


@pytest.mark.parametrize("catch", ["40 * prey_mass / prey_motors", "0 * mass / motors", "log(prey_motors)"])
def test_nothing_is_caught_where_the_rule_has_no_value(catch: str) -> None:
    rules = {**STILL, "cost": "0", "catch": catch, "population": {"start": 0}, "birth": {"start": 300}}
    world, client, events = watched(config(**rules))
    for name, height in (("prey", 0.0), ("hunter", 0.41)):
        bring(world, client, name, genome=lump(), position=[0, height, 0])
    run(world, 60)
    assert energies(world, client) == {"prey": 300.0, "hunter": 300.0} and not of(events, "creature_died")


def test_a_replay_loses_the_same_from_any_keyframe(tmp_path: Path) -> None:
    world, client, events = watched(config(cost=DEAR))
    recorder = world.journal = Recorder(tmp_path / "dear.mcap", world)
    for name in ("one", "three", "eleven"):
        run(world, 35)
        bring(world, client, name)
    run(world, 35)
    recorder.close()
    died = [each["frame"] for each in of(events, "creature_died") if each["cause"] == "unpriced"]
    assert died[:3] == [36, 71, 106]
    recording = Recording(tmp_path / "dear.mcap")
    for begin in (None, died[0], died[1] - 1, died[2] + 5):
        assert replay(recording, first=begin).verdict == "reproduced", begin


def test_a_snapshot_goes_on_as_the_world_that_it_is_of() -> None:
    world, client, _ = watched(config(cost=DEAR))
    run(world, 30)
    bring(world, client, "lump")
    again = World(world.config)
    again.restore(world.snapshot())
    for one in (world, again):
        run(one, 25)
    assert world.digest() == again.digest() and "lump" not in again.creatures()
