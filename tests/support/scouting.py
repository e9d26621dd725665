"""A scout and a runner for the task `scout`, made of few numbers, and a climb in the space of these."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from nmes.backend import Array
from nmes.evaluation import MatchTask, play

__all__ = ["WEIGHTS", "climb", "lookout", "mean_score", "rover", "without_channel"]

WEIGHTS = 14
"""How many numbers make the two: 8 the scout's brain, 6 the runner's."""
LOST = -10.0  # what a match without a score counts for


def lookout(weights: Array) -> dict[str, Any]:
    """Returns a post that sees in which direction the target is, and says two numbers, each of a unit over that."""
    return {
        "format": "nmes-genome/1",
        "name": "lookout",
        "body": {"cubes": [{"id": "post", "size": [0.4, 0.6, 0.4], "mass": 50, "position": [0, 0.3, 0]}]},
        "sensors": [{"type": "target_direction", "cube": "post"}],
        "voices": [{"channel": "lead", "number": number} for number in (1, 2)],
        "brain": _units(weights.reshape(2, 4)),
    }


def rover(weights: Array) -> dict[str, Any]:
    """Returns a cart on two wheels, each driven by a unit over the two numbers heard, and on two feet that slip."""
    cubes: list[dict[str, Any]] = [{"id": "hull", "size": [0.7, 0.1, 0.3], "mass": 5, "position": [0, 0.26, 0]}]
    joints: list[dict[str, Any]] = []
    for side, z in (("left", -0.21), ("right", 0.21)):
        at = {"mass": 0.8, "position": [0, 0.2, z], "friction": 1.5}
        cubes += [
            {"id": f"{side}_wheel", "size": [0.2828, 0.2828, 0.08], **at},
            {"id": f"{side}_rim", "size": [0.2828, 0.2828, 0.07], **at, "rotation": [0, 0, 0.785398]},
        ]
        axle = {"id": f"{side}_axle", "cube1": "hull", "cube2": f"{side}_wheel", "type": "hinge"}
        motor = {"mode": "velocity", "range": [-10, 10], "max_effort": 15}
        joints += [
            {**axle, "anchor": [0, 0.2, z], "axis": [0, 0, -1], "motor": motor},
            {**axle, "id": f"{side}_cross", "cube1": f"{side}_wheel", "cube2": f"{side}_rim", "type": "fixed",
             "anchor": [0, 0.2, z]},
        ]  # fmt: skip
    for end, x in (("front", 0.3), ("rear", -0.3)):
        cubes.append({"id": end, "size": [0.1, 0.19, 0.1], "mass": 0.5, "position": [x, 0.115, 0], "friction": 0.5})
        joint = {"id": f"{end}_foot", "cube1": "hull", "cube2": end, "type": "fixed", "anchor": [x, 0.21, 0]}
        joints.append(joint)
    ears = [{"type": "hear", "cube": "hull", "channel": "lead", "number": number} for number in (1, 2)]
    return {
        "format": "nmes-genome/1",
        "name": "rover",
        "body": {"cubes": cubes, "joints": joints},
        "sensors": ears,
        "brain": {**_units(weights.reshape(2, 3)), "outputs": ["left_axle", "right_axle"]},
    }


def _units(rows: Array) -> dict[str, Any]:
    """Returns the brain of one layer whose units have these weights, and last a bias."""
    return {"kind": "mlp", "layers": [{"weights": rows[:, :-1].tolist(), "biases": rows[:, -1].tolist()}]}


def without_channel(task: MatchTask) -> MatchTask:
    """Returns the same task in a world without its channel."""
    return MatchTask({**task.document, "world": {}})


def mean_score(weights: Sequence[float] | Array, task: MatchTask, seeds: Iterable[int]) -> float:
    """Returns the runner's mean score, m, of the two that the weights make."""
    numbers = np.array(weights, float)
    players = {"scout": lookout(numbers[:8]), "runner": rover(numbers[8:])}
    scores = [match.results["runner"].score for match in play(task, players, seeds=seeds)]
    return float(np.mean([LOST if score is None else score for score in scores]))


def climb(task: MatchTask, seed: int, budget: int) -> tuple[Array, list[float]]:
    """Climbs from small random weights: a third of them changes at each step, which stays if it is no worse.

    Args:
        task: What is played, on its own seeds.
        seed: Of what is drawn.
        budget: How many pairs are scored.

    Returns:
        The best weights, and the best score after each step.
    """
    draw = np.random.default_rng(seed)
    best = draw.normal(0.0, 0.3, WEIGHTS)
    score = mean_score(best, task, task.seeds)
    curve = [score]
    while len(curve) < budget:
        child = best + draw.normal(0.0, 0.8, WEIGHTS) * (draw.random(WEIGHTS) < 1 / 3)
        worth = mean_score(child, task, task.seeds)
        if worth >= score:
            best, score = child, worth
        curve.append(score)
    return best, curve
