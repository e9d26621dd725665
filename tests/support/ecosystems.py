"""Ecosystems for tests: a cart that seeks food, and worlds in which it lives."""

from __future__ import annotations

from typing import Any

import orjson

from nmes.world import World

Json = dict[str, Any]


def cart(name: str = "cart", forward: float = 0.5) -> Json:
    """A trunk on four cubes for wheels, whose brain steers to the side on which food is."""
    wheels = {"left.front": (0.2, -1), "left.back": (-0.2, -1), "right.front": (0.2, 1), "right.back": (-0.2, 1)}
    cubes: list[Json] = [{"id": "trunk", "size": [0.5, 0.16, 0.34], "mass": 6, "position": [0, 0.2, 0]}]
    joints: list[Json] = []
    for wheel, (x, side) in wheels.items():
        place = [x, 0.2, side * 0.23]
        cubes.append({"id": wheel, "size": [0.24, 0.24, 0.08], "mass": 0.8, "position": place})
        motor = {"mode": "velocity", "range": [-16, 16], "max_effort": 15}
        ends = {"cube1": "trunk", "cube2": wheel, "anchor": place}
        joints.append({"id": wheel, "type": "hinge", **ends, "axis": [0, 0, -1], "motor": motor})
    nodes = [{"id": side, "motor": f"{side}.*", "bias": forward} for side in ("left", "right")]
    links = [
        {"sensor": "trunk.food_direction.z", "to": side, "weight": weight}
        for side, weight in (("left", 3), ("right", -3))
    ]
    return {
        "format": "nmes-genome/1",
        "name": name,
        "body": {"cubes": cubes, "joints": joints},
        "sensors": [{"type": "food_direction", "cube": "trunk"}],
        "brain": {"kind": "graph", "nodes": nodes, "links": links},
    }


def config(**life: Any) -> Json:
    """A world of a few carts that are fed well, so that much happens in a short time."""
    rules: Json = {
        "food": {"places": [{"radius": 6}], "start": 30, "rate": 4, "most": 60, "energy": 300},
        "cost": "20 + mass + power",
        "birth": {"start": 300, "energy": 500, "gift": 250, "mutation": 0.8, "crossover": 0.5},
        "population": {"start": 6, "most": 12},
        "death": {"age": 30},
        "genomes": [cart()],
        "species": 0.1,
    }
    rules |= life
    return {"mode": "lockstep", "tick_rate": 20, "seed": 3, "keyframes": 2, "life": rules}


def watched(settings: Json) -> tuple[World, int, list[Json]]:
    """Returns a world, the number of a client that is subscribed to its life, and the list to which its events go."""
    events: list[Json] = []
    world = World(settings, emit=lambda _, event: events.append(orjson.loads(event)))
    client = world.join()
    world.execute(client, {"type": "subscribe", "events": ["life"]})
    return world, client, events


def run(world: World, ticks: int) -> None:
    for _ in range(ticks):
        world.tick()
        assert world.fault is None, world.fault


def of(events: list[Json], kind: str) -> list[Json]:
    return [event for event in events if event["type"] == kind]
