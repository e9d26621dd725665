"""Spawns a caterpillar from a genome and runs its brain here, outside of the world: sense, think, drive, step.

The genome holds body and brain. The server makes the body live; the brain is a central pattern generator that this
program asks at every tick, as any program in any language might do in its place. A wave runs through the hinges from
tail to head, and feels by the hinges' positions how well the body follows.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from common import Connect, Figure, main
from nmes.brain import load_brain

CUBES = 6
SIZE = (0.24, 0.12, 0.24)  # m
SPACING = 0.3  # m
BEND = 0.7  # rad, of each hinge at most
TICKS = 600
SEED = 1


def genome() -> dict[str, Any]:
    """Returns the caterpillar: a row of boxes along x, hinges between them, and a brain."""
    return {
        "format": "nmes-genome/1",
        "name": "caterpillar",
        "body": {
            "cubes": [
                {"id": f"part{i}", "size": SIZE, "mass": 0.5, "friction": 1, "position": [i * SPACING, SIZE[1] / 2, 0]}
                for i in range(CUBES)
            ],
            "joints": [
                {
                    "id": f"hinge{i}",
                    "cube1": f"part{i}",
                    "cube2": f"part{i + 1}",
                    "type": "hinge",
                    "anchor": [(i + 0.5) * SPACING, SIZE[1] / 2, 0],
                    "axis": [0, 0, 1],
                    "motor": {"mode": "position", "range": [-BEND, BEND], "max_effort": 10},
                }
                for i in range(CUBES - 1)
            ],
        },
        "brain": {
            "kind": "cpg",
            "oscillators": [{"motor": "hinge*", "frequency": 1.2, "amplitude": 0.8}],
            "chains": [{"motors": "hinge*", "weight": 8, "lag": 1.3}],
            "feedback": [{"sensor": "hinge0.position", "motor": "hinge0", "rate": 0.5}],
        },
    }


def measure(connect: Connect) -> list[Figure]:
    """Runs the example; each call of `connect` is a new connection to the world."""
    with connect() as client:
        client.set_mode("lockstep")
        client.reset()
        tick_rate = client.get_world_info()["config"]["tick_rate"]
        body = client.spawn_creature(genome(), name="caterpillar")
        brain = load_brain(genome()["brain"], body["sensors"], body["motors"])
        brain.reset(SEED, 1 / tick_rate)
        parts = list(body["cubes"].values())

        def middle() -> Any:
            return np.mean([client.get_cube_state(part)["position"] for part in parts], axis=0)

        start = middle()
        values, highest = client.sense("caterpillar")["values"], 0.0
        for _ in range(TICKS):
            controls = brain.step(np.array(values))
            with client.pipeline() as together:
                together.drive("caterpillar", controls.tolist())
                together.step()
                sensed = together.sense("caterpillar")
            values = sensed.result()["values"]
            highest = max(highest, float(np.abs(controls).max()))
        crawled = middle() - start
    return [
        Figure("motors", len(body["motors"]), "", at_least=CUBES - 1, at_most=CUBES - 1),
        Figure("strongest control", highest, "", at_least=0.7, at_most=1.0),
        Figure("crawled forwards", crawled[0], "m", at_least=0.8),
        Figure("strayed sideways", abs(crawled[2]), "m", at_most=0.3),
    ]


if __name__ == "__main__":
    main(measure, __doc__)
