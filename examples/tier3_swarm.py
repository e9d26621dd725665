"""Five connections drive their cubes apart; then a sixth one's heavy cube hunts them down and rams each.

Six programs in one, as six processes would do it: each knows only its own connection, and sees the others through the
world.
"""

from __future__ import annotations

from contextlib import ExitStack
from math import cos, pi, sin

import numpy as np

import nmes
from common import Connect, Figure, main

Vector = np.ndarray

SWARM = 5
APART = 4.0  # m from the middle
FLEE = 120  # ticks that the cubes drive apart for
HUNT = 1200  # ticks that the hunter has
PUSH = 8.0  # N at most, on a cube of 1 kg
HUNTER_MASS = 5.0  # kg
HUNTER_PUSH = 120.0  # N at most


def measure(connect: Connect) -> list[Figure]:
    """Runs the example; each call of `connect` is a new connection to the world."""
    with ExitStack() as stack:
        swarm = [stack.enter_context(connect()) for _ in range(SWARM)]
        leader = swarm[0]
        leader.set_mode("lockstep")
        leader.reset()
        ring = [2 * pi * i / SWARM for i in range(SWARM)]
        prey = [
            client.spawn_cube(position=[1.2 * cos(a), 0.5, 1.2 * sin(a)], friction=0.1, list=False)["spawned"]
            for client, a in zip(swarm, ring, strict=True)
        ]
        crowded = spread(positions(leader, prey))
        for _ in range(FLEE):
            places = positions(leader, prey)
            middle = places.mean(axis=0)
            for client, name, position in zip(swarm, prey, places, strict=True):
                away = position - middle
                radius = float(np.linalg.norm(away))
                velocity = np.array(client.get_cube_state(name)["linear_velocity"])
                client.apply_physics(force=limited(12.0 * (APART - radius) * away / radius - 6.0 * velocity, PUSH))
            leader.step()
        start = positions(leader, prey)
        apart = spread(start)

        hunter = stack.enter_context(connect())
        ram = hunter.spawn_cube(
            position=[0, 0.5, 0], mass=HUNTER_MASS, friction=0.1, color=[1.0, 0.2, 0.1], list=False
        )["spawned"]
        rammed: set[str] = set()
        for _ in range(HUNT):
            info = hunter.get_cube_info(ram)
            rammed |= set(prey) & {touch["cube_name"] for touch in info["contacts"]}
            left = [name for name in prey if name not in rammed]
            if not left:
                break
            here = np.array(info["position"])
            nearest = min(positions(hunter, left) - here, key=lambda way: float(np.linalg.norm(way)))
            chase = 6.0 * nearest / float(np.linalg.norm(nearest))
            hunter.apply_physics(force=limited(40.0 * (chase - np.array(info["linear_velocity"])), HUNTER_PUSH))
            hunter.step()
        hunter.step(60)
        knocked = np.linalg.norm(positions(leader, prey) - start, axis=1)
    return [
        Figure("spread at the start", crowded, "m"),
        Figure("spread once driven apart", apart, "m", at_least=3.0, at_most=5.0),
        Figure("cubes rammed", len(rammed), "", at_least=SWARM),
        Figure("least knocked away", float(knocked.min()), "m", at_least=0.2),
    ]


def positions(client: nmes.Client, names: list[str]) -> Vector:
    """Returns where the cubes are, all at one frame."""
    return np.array([cube["position"] for cube in client.get_world_state(cubes=names)["cubes"]])


def spread(positions: Vector) -> float:
    """Returns the mean distance from the middle."""
    return float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).mean())


def limited(force: Vector, most: float) -> Vector:
    """Returns the force along the ground, shortened to `most`."""
    force = force * [1.0, 0.0, 1.0]
    return force * min(1.0, most / max(float(np.linalg.norm(force)), 1e-9))


if __name__ == "__main__":
    main(measure, __doc__)
