"""Short matches for tests."""

from __future__ import annotations

from typing import Any

from nmes.evaluation import MatchTask

HALF_TURN = 3.141592653589793
DUEL: dict[str, Any] = {
    "format": "nmes-task/1",
    "name": "duel",
    "description": "Come near to the other.",
    "duration": 1.5,
    "settle": 0.2,
    "seeds": [3, 4],
    "vary": {"yaw": [-0.3, 0.3], "drop": [0, 0.02]},
    "roles": [
        {"name": "red", "position": [-1, 0, 0], "target": "blue", "objective": "start.red.distance - red.distance"},
        {
            "name": "blue",
            "position": [1, 0, 0],
            "heading": HALF_TURN,
            "target": "red",
            "objective": "start.blue.apart.red - blue.apart.red",
        },
    ],
}


def duel(**changes: Any) -> MatchTask:
    """Returns the task of a duel, changed."""
    return MatchTask({**DUEL, **changes})


def roles(red: dict[str, Any], blue: dict[str, Any]) -> dict[str, Any]:
    """Returns what the roles of a duel become where some of their fields are others."""
    return {"roles": [{**DUEL["roles"][0], **red}, {**DUEL["roles"][1], **blue}]}


def push(speed: float = 2.0, **changes: Any) -> dict[str, Any]:
    """Returns the genome of a cart of one long cube on four crossed wheels, that drives along its x."""
    wheels = [(x, z) for x in (-0.25, 0.25) for z in (-0.2, 0.2)]
    cubes = [{"id": "trunk", "size": [0.7, 0.1, 0.28], "mass": 4.0, "position": [0, 0.2, 0]}]
    joints = []
    for number, (x, z) in enumerate(wheels):
        cubes.append({"id": f"w{number}", "size": [0.2, 0.2, 0.08], "mass": 0.5, "position": [x, 0.16, z]})
        joints.append(
            {
                "id": f"a{number}",
                "cube1": "trunk",
                "cube2": f"w{number}",
                "type": "hinge",
                "anchor": [x, 0.16, z],
                "axis": [0, 0, -1],
                "motor": {"mode": "velocity", "range": [-10, 10], "max_effort": 10},
            }
        )
    brain = {"kind": "sine", "oscillators": [{"motor": "*", "frequency": 0.01, "amplitude": 0, "offset": speed / 10}]}
    genome = {"format": "nmes-genome/1", "name": "cart", "body": {"cubes": cubes, "joints": joints}, "brain": brain}
    return {**genome, **changes}
