"""To fall is worth nothing: towers that lean as far as it takes, towards a target, that bounce, that shake a wheel."""

from __future__ import annotations

from typing import Any

import pytest

from nmes.evaluation import Task, evaluate, play
from nmes.genome import Genome

BLOCK: dict[str, Any] = {
    "format": "nmes-genome/1",
    "name": "block",
    "body": {"cubes": [{"id": "root", "size": [0.4, 0.4, 0.4], "mass": 10, "position": [0, 0.2, 0]}]},
}
MLP = {
    "kind": "mlp",
    "inputs": ["foot.target_direction.x", "foot.target_direction.z"],
    "outputs": ["lean_z", "lean_x"],
    "layers": [{"weights": [[-4, 0], [0, 4]], "biases": [0, 0]}],
}
"""Leans towards the target."""
FORWARD = {"kind": "sine", "oscillators": [{"motor": "lean_z", "amplitude": 0, "offset": -1}]}
"""Leans along x."""


def tower(size: float, brain: dict[str, Any], *, restitution: float = 0.0, effort: float = 120.0) -> Genome:
    """Returns a tower of a height in m: a foot, a pole that can lean on it in any direction, a heavy head."""
    pole = size - 0.6
    cubes: list[dict[str, Any]] = [
        {"id": "foot", "size": [0.7, 0.1, 0.7], "mass": 4, "position": [0, 0.05, 0]},
        {"id": "ankle", "size": [0.1, 0.1, 0.1], "mass": 1, "position": [0, 0.15, 0]},
        {"id": "pole", "size": [0.1, pole, 0.1], "mass": 2, "position": [0, 0.2 + pole / 2, 0]},
        {"id": "head", "size": [0.4, 0.4, 0.4], "mass": 40, "position": [0, size - 0.2, 0]},
    ]
    motor = {"mode": "position", "range": [-1.7, 1.7], "max_effort": effort}
    lean = {"type": "hinge", "anchor": [0, 0.15, 0], "motor": motor}
    joints = [
        {"id": "lean_z", "cube1": "foot", "cube2": "ankle", "axis": [0, 0, 1], **lean},
        {"id": "lean_x", "cube1": "ankle", "cube2": "pole", "axis": [1, 0, 0], **lean},
        {"id": "neck", "cube1": "pole", "cube2": "head", "type": "fixed", "anchor": [0, size - 0.4, 0]},
    ]
    body = {"cubes": [{**cube, "restitution": restitution} for cube in cubes], "joints": joints}
    sensors = [{"type": "target_direction", "cube": "foot"}]
    return Genome({"format": "nmes-genome/1", "name": "tower", "body": body, "sensors": sensors, "brain": brain})


@pytest.mark.parametrize("size", [1.95, 3.99])
@pytest.mark.parametrize("restitution", [0.0, 0.5])
@pytest.mark.parametrize("name", ["walk", "jump-high", "jump-far", "stairs", "rough"])
def test_a_tower_that_falls_scores_nothing(name: str, restitution: float, size: float) -> None:
    evaluation = evaluate(tower(size, FORWARD, restitution=restitution), Task.load(name), seeds=[1])
    assert evaluation.error is None
    assert not any(result.score for result in evaluation.results), evaluation.results


@pytest.mark.parametrize(("size", "effort"), [(1.95, 120.0), (3.99, 60.0), (3.99, 120.0), (3.99, 150.0)])
def test_a_tower_that_falls_onto_its_target_scores_nothing(size: float, effort: float) -> None:
    task = Task.load("reach")
    evaluation = evaluate(tower(size, MLP, effort=effort), task)
    assert not any(result.score for result in evaluation.results), evaluation.results
    assert evaluation.error is None or size > 2.0


@pytest.mark.parametrize("restitution", [0.0, 0.5, 0.8, 0.85, 0.9])
def test_a_wheel_that_is_shaken_pays_for_no_bounce(restitution: float) -> None:
    document = tower(1.5, FORWARD, restitution=restitution).document
    wheel = {"id": "wheel", "size": [0.3, 0.06, 0.3], "mass": 4, "position": [0, 1.53, 0], "restitution": restitution}
    motor = {"mode": "velocity", "range": [-60, 60], "max_effort": 200}
    axle = {"id": "axle", "cube1": "head", "cube2": "wheel", "type": "hinge", "anchor": [0, 1.5, 0], "axis": [0, 1, 0]}
    document["body"]["cubes"].append(wheel)
    document["body"]["joints"].append({**axle, "motor": motor})
    document["brain"]["oscillators"] = [
        {"motor": "lean*", "frequency": 0.02, "amplitude": 1},
        {"motor": "axle", "frequency": 5, "amplitude": 10},
    ]
    evaluation = evaluate(Genome(document), Task.load("walk"), seeds=[1])
    assert evaluation.error is None or (restitution > 0.5 and "restitution" in evaluation.error)
    assert not any(result.score for result in evaluation.results), evaluation.results


def test_a_hop_beside_the_stairs_is_no_climb() -> None:
    """The jumper hops on the spot, and is in the air when its time is over."""
    evaluation = evaluate(Genome.load("jumper"), Task.load("stairs"), seeds=[1])
    assert [result.score for result in evaluation.results] == [0.0]


def heavy_tower(ahead: bool) -> dict[str, Any]:
    """Returns a tower that topples once, ahead or to its right, while a wheel is shaken that pays for the fall."""

    def along(x: float, y: float, z: float) -> list[float]:
        return [x, y, z] if ahead else [z, y, x]

    cubes: list[dict[str, Any]] = [
        {"id": "foot", "size": [0.6, 0.1, 0.6], "mass": 60, "position": [0, 0.05, 0]},
        {"id": "column", "size": along(0.2, 1.7, 0.5), "mass": 40, "position": [0, 0.96, 0]},
        {"id": "head", "size": along(0.2, 0.18, 1.4), "mass": 320, "position": [0, 1.9, 0]},
        {"id": "wheel", "size": [0.2, 0.2, 0.2], "mass": 20, "position": along(0, 1.55, -0.37)},
    ]
    hinge = {"type": "hinge", "axis": [0, 0, 1] if ahead else [-1, 0, 0]}
    topple = {"mode": "velocity", "range": [-3, 3], "max_effort": 30000}
    shake = {"mode": "velocity", "range": [-60, 60], "max_effort": 15000}
    joints: list[dict[str, Any]] = [
        {"id": "topple", "cube1": "foot", "cube2": "column", **hinge, "anchor": along(0.1, 0.1, 0), "motor": topple},
        {"id": "neck", "cube1": "column", "cube2": "head", "type": "fixed", "anchor": [0, 1.81, 0]},
        {"id": "shake", "cube1": "column", "cube2": "wheel", **hinge, "anchor": along(0, 1.55, -0.26), "motor": shake},
    ]
    joints[0]["limits"] = [-1.3, 0]
    oscillators = [
        {"motor": "topple", "frequency": 0, "amplitude": 0, "offset": -1},
        {"motor": "shake", "frequency": 2, "amplitude": 1},
    ]
    brain = {"kind": "sine", "oscillators": oscillators}
    return {"format": "nmes-genome/1", "name": "t", "body": {"cubes": cubes, "joints": joints}, "brain": brain}


@pytest.mark.parametrize(
    ("name", "role", "others"),
    [
        ("sumo", "red", {"blue": BLOCK}),
        ("foraging", "red", {"blue": BLOCK}),
        ("chase", "hunter", {"prey": BLOCK}),
        ("interference", "robot", {"interferer": BLOCK}),
        ("interference-alone", "robot", {}),
        ("scout", "runner", {"scout": BLOCK}),
    ],
)
@pytest.mark.parametrize("ahead", [True, False])
def test_to_topple_over_is_worth_nothing_in_a_match(name: str, role: str, others: dict[str, Any], ahead: bool) -> None:
    for match in play(name, {role: heavy_tower(ahead), **others}):
        result = match.results[role]
        assert result.fault is None and result.score is not None and result.energy > 1000.0
        assert result.score <= 0.0, match
