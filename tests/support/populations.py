"""Mixed populations: creatures of which some can be run together, and some for one reason or another cannot."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import numpy as np

from creatures import SINE, cpg, exploding, mlp, snake
from nmes.errors import DocumentError
from nmes.genome import Genome
from random_bodies import draw_genome

__all__ = ["draw_population"]

_ALL_SENSORS = [
    {"type": kind, "cube": cube}
    for kind in ("height", "up", "velocity", "spin", "touch", "target_direction", "target_distance", "target_velocity")
    for cube in ("c0", "c2")
] + [{"type": kind, "joint": "*"} for kind in ("position", "velocity", "effort")]


def draw_population(seed: int, size: int) -> list[Genome]:
    """Draws creatures, among which each kind of hindrance to being run together is likely to be found."""
    draw = np.random.default_rng(seed)
    makers = [_same_body, _other_numbers, _sensing, _idle, _odd, _random]
    found: list[Genome] = []
    while len(found) < size:
        maker = makers[int(draw.choice(len(makers), p=[0.25, 0.25, 0.2, 0.1, 0.1, 0.1]))]
        try:
            found.append(Genome(maker(draw, f"g{len(found)}")))
        except DocumentError:
            continue
    return found


def _same_body(draw: np.random.Generator, name: str) -> dict[str, Any]:
    """One body, with a brain of one of the kinds; some draw where they begin from the seed."""
    wave = {
        "motor": "*",
        "frequency": float(draw.uniform(0.5, 3.0)),
        "amplitude": 0.9,
        "step": float(draw.uniform(0, 2)),
    }
    brains: list[dict[str, Any]] = [
        {"kind": "sine", "oscillators": [wave]},
        {**cpg(4), "oscillators": [wave], "start_jitter": 2.0},
        mlp(4, seed=int(draw.integers(1000))),
    ]
    return snake(brains[int(draw.integers(3))], name=name)


def _other_numbers(draw: np.random.Generator, name: str) -> dict[str, Any]:
    """The same plan with other sizes, masses, springs and motors, of which a few have no strength."""
    genome = deepcopy(snake(mlp(4, hidden=4, seed=int(draw.integers(1000))), name=name))
    for cube in genome["body"]["cubes"]:
        cube["mass"] = float(draw.uniform(0.2, 1.0))
        cube["size"] = [0.26, 0.14, float(draw.uniform(0.1, 0.5))]
    for joint in genome["body"]["joints"]:
        joint["motor"]["max_effort"] = float(draw.choice([0.0, 2.0, 6.0, 20.0], p=[0.1, 0.3, 0.3, 0.3]))
        wide = float(draw.uniform(0.2, 1.0))
        joint["motor"]["range"] = [-wide / 2.0, wide]
        joint["motor"]["mode"] = str(draw.choice(["position", "velocity"]))
        if draw.random() < 0.2:
            joint["stiffness"] = float(draw.choice([0.0, 5.0]))
    return genome


def _sensing(draw: np.random.Generator, name: str) -> dict[str, Any]:
    """A snake that feels touch and sees a target, and moves by all that it senses."""
    weights = draw.normal(0.0, 0.4, (3, 3 * 3 + 2 * 18)).tolist()
    layer = {"weights": weights, "biases": [0.0] * 3}
    genome = snake({"kind": "mlp", "layers": [layer]}, name=name)
    return {**genome, "sensors": _ALL_SENSORS}


def _idle(draw: np.random.Generator, name: str) -> dict[str, Any]:
    """A snake that does nothing, or has nothing to do it with, and so may sleep."""
    still = {"kind": "sine", "oscillators": [{"motor": "*", "amplitude": 0.0}]}
    genome = snake(None if draw.random() < 0.5 else still, name=name)
    if "brain" not in genome and draw.random() < 0.5:
        for joint in genome["body"]["joints"]:
            del joint["motor"]
    return genome


def _odd(draw: np.random.Generator, name: str) -> dict[str, Any]:
    """What faults, is refused, does not come to rest, or is of another plan."""
    kind = int(draw.integers(4))
    if kind == 0:
        return {**exploding(), "name": name}
    if kind == 1:
        return snake(name=name, segments=9)
    if kind == 2:  # rolls for as long as it is let
        ball = [{"id": f"c{i}", "size": [0.2, 0.2, 0.2], "mass": 1, "position": [0.3 * i, 2.5, 0]} for i in range(2)]
        joint = {"id": "j0", "cube1": "c0", "cube2": "c1", "type": "hinge", "anchor": [0.15, 2.5, 0], "axis": [0, 0, 1]}
        return {"format": "nmes-genome/1", "name": name, "body": {"cubes": ball, "joints": [joint]}}
    return snake({**SINE, "oscillators": [{"motor": "nobody"}]}, name=name)


def _random(draw: np.random.Generator, name: str) -> dict[str, Any]:
    return {**draw_genome(int(draw.integers(1_000_000)))[0], "name": name}
