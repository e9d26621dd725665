"""Makes a 3x3 grid of cubes hop: nine connections, a cube each, twelve hinges between neighbours.

Every connection owns the cube that it spawned, so that it may leave the cube's name out when it pushes.
"""

from __future__ import annotations

from contextlib import ExitStack

import numpy as np

import nmes
from common import Connect, Figure, main

SPACING = 1.2  # m, between the centres of cubes of 1 m
IMPULSE = 4.0  # N s upwards on each cube of 1 kg: 4 m/s, so that they should rise by v^2 / 2g = 0.82 m
SETTLE, HOP = 60, 120  # ticks


def measure(connect: Connect) -> list[Figure]:
    """Runs the example; each call of `connect` is a new connection to the world."""
    with ExitStack() as stack:
        clients = [stack.enter_context(connect()) for _ in range(9)]
        leader = clients[0]
        leader.set_mode("lockstep")
        leader.reset()
        names = [
            client.spawn_cube(position=[SPACING * (i % 3 - 1), 0.5, SPACING * (i // 3 - 1)], list=False)["spawned"]
            for i, client in enumerate(clients)
        ]
        hinges = 0
        for i, client in enumerate(clients):
            if i % 3 < 2:  # to the neighbour along x, about z
                client.create_joint(names[i], names[i + 1], "hinge", axis=[0, 0, 1])
                hinges += 1
            if i // 3 < 2:  # to the neighbour along z, about x
                client.create_joint(names[i], names[i + 3], "hinge", axis=[1, 0, 0])
                hinges += 1
        leader.step(SETTLE)
        rest = heights(leader, names)
        for client in clients:
            client.apply_physics(impulse=[0, IMPULSE, 0])
        highest = rest
        for _ in range(HOP):
            leader.step()
            highest = np.maximum(highest, heights(leader, names))
        landed = heights(leader, names)
    return [
        Figure("hinges", hinges, "", at_least=12, at_most=12),
        Figure("hop height", float(np.min(highest - rest)), "m", at_least=0.6, at_most=1.0),
        Figure("height after landing", float(np.max(np.abs(landed - rest))), "m", at_most=0.1),
    ]


def heights(client: nmes.Client, names: list[str]) -> np.ndarray:
    """Returns the cubes' heights, all of one frame."""
    return np.array([cube["position"][1] for cube in client.get_world_state(cubes=names)["cubes"]])


if __name__ == "__main__":
    main(measure, __doc__)
