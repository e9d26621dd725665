"""What one command does with thousands of cubes is done for all of them at once, and comes to the same."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import nmes.genome.body
import nmes.world.nearby
from nmes import World
from nmes.genome.body import BodyCube, overlap, overlaps
from nmes.world.nearby import Nearby, Neighbour

Json = dict[str, Any]

PAIR: Json = {
    "format": "nmes-genome/1",
    "name": "pair",
    "body": {
        "cubes": [
            {"id": "a", "size": 0.2, "mass": 1, "position": [0, 0.1, 0]},
            {"id": "b", "size": 0.2, "mass": 1, "position": [0.25, 0.1, 0]},
        ],
        "joints": [{"id": "j", "type": "fixed", "cube1": "a", "cube2": "b", "anchor": [0.125, 0.1, 0]}],
    },
}


def world_of(cubes: list[Json], **config: Any) -> tuple[World, int]:
    """Returns a world in which nothing moves, of some cubes and a creature `x` that has lost its part `b`."""
    world = World({"mode": "lockstep", "backend": "ballistic", "gravity": [0, 0, 0], **config})
    client = world.join()
    world.execute(client, {"type": "spawn_creature", "genome": PAIR, "name": "x", "position": [0, 5, 0]})
    world.execute(client, {"type": "shed", "creature": "x", "part": "b", "remove": True})
    for number, cube in enumerate(cubes):
        world.execute(client, {"type": "spawn_cube", "cube_name": f"c{number}", "list": False, **cube})
    return world, client


def box(draw: np.random.Generator, number: int) -> BodyCube:
    turn = draw.normal(size=4) if number % 3 else np.array([0.0, 0.0, 0.0, 1.0])  # parallel edges too
    size, place = draw.uniform(0.05, 0.6, 3).tolist(), draw.uniform(-0.4, 0.4, 3).tolist()
    turn /= np.sqrt((turn * turn).sum())
    plain: Json = dict.fromkeys(("friction", "restitution", "color"))
    return BodyCube(str(number), tuple(size), 1.0, tuple(place), tuple(turn.tolist()), **plain)


def test_many_overlaps_at_once_have_the_bits_of_each() -> None:
    draw = np.random.default_rng(4)
    boxes = [box(draw, number) for number in range(300)]
    sizes = np.array([each.size for each in boxes])
    places = np.array([[*each.position, *each.quaternion] for each in boxes])
    for one in boxes[:7]:
        assert overlaps(one, sizes, places).tolist() == [overlap(one, other) for other in boxes]


def test_a_part_that_grows_is_compared_with_thousands_of_cubes_in_a_few_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    # They are in the ball about the part, and not in its box.
    near = [{"size": 0.02, "position": [0.25 + 0.001 * (i % 40), 5.215, 0.0005 * (i // 40)]} for i in range(1200)]
    world, client = world_of(near)
    depths, calls = nmes.genome.body._depths, []

    def counted(arms: Any, *rest: Any) -> Any:
        calls.append(len(arms))
        return depths(arms, *rest)

    monkeypatch.setattr(nmes.genome.body, "_depths", counted)
    assert world.execute(client, {"type": "grow", "creature": "x", "part": "b"})["type"] == "part_grown"
    assert sum(calls) >= 1200 and len(calls) < 10


def test_the_first_cube_in_the_way_is_named_however_many_there_are() -> None:
    near = [{"size": 0.02, "position": [0.25, 5.215, 0.0002 * i]} for i in range(400)]
    within = [{"size": 0.02, "position": [0.25, 5.12, 0]}, {"size": 0.02, "position": [0.25, 5.1, 0]}]
    world, client = world_of([*near, *within])
    refused = world.execute(client, {"type": "grow", "creature": "x", "part": "b"})
    assert refused["code"] == "no_room" and "'c400'" in refused["message"]


def test_who_hears_thousands_builds_no_more_voices_than_the_reply_has(monkeypatch: pytest.MonkeyPatch) -> None:
    places = [{"size": 0.1, "position": [1.0 + (i * 7 % 300) // 2, 5, 0]} for i in range(300)]
    world, client = world_of(places, channels={"talk": {"range": 140}})
    for number in range(300):
        world.execute(client, {"type": "say", "channel": "talk", "cube_name": f"c{number}", "value": number / 300})
    world.tick()
    whole = world.channels.hear("talk", (0.0, 5.0, 0.0), (), 1000)
    built = []

    def counted(*values: Any) -> Neighbour:
        built.append(values)
        return Neighbour(*values)

    monkeypatch.setattr(nmes.world.nearby, "Neighbour", counted)
    heard = world.execute(client, {"type": "hear", "channel": "talk", "creature": "x"})["voices"]
    assert len(heard) == len(built) == 100
    names = world.entities.body_names
    assert [each["cube_name"] for each in heard] == [names[voice.body] for voice in whole[:100]]
    distances = [voice.distance for voice in whole]
    assert len(whole) == 280 and distances == sorted(distances)
    ties = [(one.body, two.body) for one, two in pairwise(whole) if one.distance == two.distance]
    assert len(ties) > 100 and all(one < two for one, two in ties)


def test_those_nearby_are_the_same_however_many_are_asked_for() -> None:
    world, _ = world_of([{"size": 0.1, "position": [1.0 + i % 5, 5, i % 3]} for i in range(40)])
    near = Nearby(world.entities, lambda: list(world.entities.body_names))
    everybody = near.all((0.3, 5.0, 0.1), 4.0)
    assert 1 < len(everybody) < 40
    for most in (0, 1, 7, 100):
        assert near.all((0.3, 5.0, 0.1), 4.0, most=most) == everybody[:most]
    state = world.simulation.body_state(everybody[0].body)
    assert (everybody[0].position, everybody[0].velocity) == (state.position, state.linear_velocity)
    assert near.nearest((0.3, 5.0, 0.1), 4.0) == everybody[0]
