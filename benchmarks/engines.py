"""What ticks cost on the engines beside MuJoCo: a hundred cubes in the plane, and one cube on the reference engine.

The bare loop steps the very same pymunk space from the same beginning, so that both solve the same contacts.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

from measure import Figure, in_turns, ratio, summary
from nmes import World

ROUNDS = 15
TICKS = 90  # long enough to fall, tumble and pile up, too short to fall asleep


def hundred() -> World:
    """Returns a planar world in which a hundred cubes are about to fall into a heap."""
    world = World({"mode": "lockstep", "backend": "pymunk"})
    client = world.join()
    for i in range(100):
        column, row = i % 20, i // 20
        position = [1.2 * column + 0.1 * row, 0.6 + 1.2 * row, 0.0]
        spawn = {"type": "spawn_cube", "position": position, "linear_velocity": [2.0 - row, 0.0, 0.0], "list": False}
        assert world.execute(client, spawn)["type"] == "cube_list"
    world.tick()
    return world


def planar() -> float:
    """Ticks the heap through World; returns the seconds that a tick took."""
    tick = hundred().tick
    began = time.perf_counter()
    for _ in range(TICKS):
        tick()
    return (time.perf_counter() - began) / TICKS


def bare() -> float:
    """Steps the same heap with nothing around `Space.step`; returns the seconds that a tick took."""
    world = hundred()
    substeps, step = world.config["substeps"], world.simulation._space.step  # type: ignore[attr-defined]
    timestep = 1.0 / world.config["tick_rate"] / substeps
    began = time.perf_counter()
    for _ in range(TICKS):
        for _ in range(substeps):
            step(timestep)
    return (time.perf_counter() - began) / TICKS


def single() -> float:
    """Ticks a world of one cube on the reference engine, flying, landing and at rest; returns the seconds a tick."""
    world = World({"mode": "lockstep", "backend": "ballistic"})
    client = world.join()
    world.execute(client, {"type": "spawn_cube", "position": [0, 5, 0], "linear_velocity": [3, 0, 0]})
    began = time.perf_counter()
    for _ in range(1000):
        world.tick()
    return (time.perf_counter() - began) / 1000


def figures() -> Iterator[Figure]:
    """Measures."""
    samples = in_turns({"bare": bare, "world": planar, "ballistic": single}, ROUNDS)
    times = {"microseconds a tick": summary(samples, 1e-6)}
    name = "pymunk, 100 cubes: a tick of World / of bare pymunk"
    yield Figure(name, ratio(samples, "world", "bare"), "x", at_most=1.3, details=times)
    rates = sorted(1 / seconds for seconds in samples["ballistic"])
    yield Figure("ballistic, one cube", rates[len(rates) // 2], "ticks/s", at_least=20_000, details=times)
