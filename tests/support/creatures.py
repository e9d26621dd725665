"""Creatures for tests: a snake of jointed cubes, with a brain of any kind."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

WAVE = [{"motor": "*", "frequency": 1.2, "amplitude": 0.8, "step": 0.9}]
SINE = {"kind": "sine", "oscillators": WAVE}


def cpg(segments: int) -> dict[str, Any]:
    """Returns a chain of oscillators, each of which pulls at the next."""
    links = [{"from": f"j{i}", "to": f"j{i + 1}", "lag": 0.9} for i in range(segments - 2)]
    return {"kind": "cpg", "oscillators": WAVE, "links": links}


def mlp(segments: int, hidden: int = 32, seed: int = 0) -> dict[str, Any]:
    """Returns a network from all sensors that a snake has by default to all its motors."""
    draw, motors = np.random.default_rng(seed), segments - 1
    shapes = (hidden, 2 * motors + 10), (motors, hidden)
    return {
        "kind": "mlp",
        "layers": [{"weights": draw.normal(0.0, 0.8, shape).tolist(), "biases": [0.0] * shape[0]} for shape in shapes],
    }


def snake(brain: dict[str, Any] | None = SINE, segments: int = 4, **changes: Any) -> dict[str, Any]:
    """Returns the genome of a snake along x with a servo between any two of its segments."""
    cubes = [
        {"id": f"c{i}", "size": [0.26, 0.14, 0.26], "mass": 0.5, "position": [0.36 * i, 0.07, 0]}
        for i in range(segments)
    ]
    joints = [
        {
            "id": f"j{i}",
            "cube1": f"c{i}",
            "cube2": f"c{i + 1}",
            "type": "hinge",
            "anchor": [0.36 * i + 0.18, 0.07, 0],
            "motor": {"mode": "position", "range": [-0.6, 0.6], "max_effort": 6},
        }
        for i in range(segments - 1)
    ]
    genome = {"format": "nmes-genome/1", "name": "snake", "author": "Ada", "body": {"cubes": cubes, "joints": joints}}
    return {**genome, **({} if brain is None else {"brain": brain}), **changes}


def seedling() -> dict[str, Any]:
    """Returns the genome of two small cubes with a servo between them, which is about as small as a creature gets."""
    genome = snake(segments=2, name="seedling")
    for i, cube in enumerate(genome["body"]["cubes"]):
        cube |= {"size": 0.14, "position": [0.2 * i, 0.07, 0]}
    genome["body"]["joints"][0]["anchor"] = [0.1, 0.07, 0]
    return genome


def exploding() -> dict[str, Any]:
    """Returns the genome of a snake that no engine can follow: motors of a million newton metres on a gram."""
    genome = snake(name="bang")
    for cube in genome["body"]["cubes"]:
        cube["mass"] = 0.001
    for joint in genome["body"]["joints"]:
        joint["motor"] = {"mode": "velocity", "range": [-1000, 1000], "max_effort": 1e6}
    return genome


def able(task: str) -> str | dict[str, Any]:
    """Returns a creature that may take part in a task that ships."""
    special = {"carry": "juggler", "pole": "juggler", "planar-walk": "inchworm", "reach": "seeker"}
    return seedling() if task == "growth" else special.get(task, "walker")


def renamed(document: dict[str, Any]) -> dict[str, Any]:
    """Renames every cube and joint of a snake, wherever they are named."""
    text = json.dumps(document)
    for i in range(9):
        text = text.replace(f'"c{i}"', f'"part-{9 - i}"').replace(f'"j{i}"', f'"bend-{9 - i}"')
    changed: dict[str, Any] = json.loads(text)
    return changed
