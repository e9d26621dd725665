"""Pushes one cube to a target with a proportional controller.

Each tick the program sees where the cube is and how fast, and pushes it with a force in proportion to what is
left of the way, less a share of its speed. The world runs in lockstep: it waits for the program, so that the run
is the same every time and as fast as the machine allows.
"""

from __future__ import annotations

import numpy as np

from common import Connect, Figure, main

TARGET = np.array([6.0, 0.5, -4.0])
STIFFNESS = 12.0  # N/m
DAMPING = 6.0  # N s/m
STRONGEST = 15.0  # N
TICKS = 480  # 8 s


def measure(connect: Connect) -> list[Figure]:
    """Runs the example; each call of `connect` is a new connection to the world."""
    with connect() as client:
        client.set_mode("lockstep")
        client.reset()
        name = client.spawn_cube(position=[0, 0.5, 0], friction=0.05, color=[0.2, 0.6, 1.0])["spawned"]
        state = client.get_cube_state(name)
        start = TARGET - state["position"]
        for _ in range(TICKS):
            force = STIFFNESS * (TARGET - state["position"]) - DAMPING * np.array(state["linear_velocity"])
            force[1] = 0.0  # along the ground
            force *= min(1.0, STRONGEST / max(float(np.linalg.norm(force)), 1e-9))
            # Three commands, one write, one tick: act, step, observe.
            with client.pipeline() as together:
                together.apply_physics(name, force=force)
                together.step()
                observed = together.get_cube_state(name)
            state = observed.result()
    return [
        Figure("distance at the start", float(np.linalg.norm(start)), "m"),
        Figure("final distance", float(np.linalg.norm(TARGET - state["position"])), "m", at_most=0.1),
        Figure("final speed", float(np.linalg.norm(state["linear_velocity"])), "m/s", at_most=0.05),
    ]


if __name__ == "__main__":
    main(measure, __doc__)
