"""The auditor of momentum: he finds little that nothing gave in honest work, and much in what shakes."""

from __future__ import annotations

import numpy as np
import pytest

from momentum_audit import momentum_of_nothing
from nmes.evaluation import Task, evaluate
from nmes.genome import Genome
from nmes.world import World
from shakers import lead_shaker

HONEST = [
    ("walker", "walk", 0.03),
    ("galloper", "walk", 0.03),
    ("jumper", "jump-high", 0.03),
    ("seeker", "reach", 0.03),
]
"""Who, on what, and how much momentum of nothing each kilogram may have a second, m/s^2."""


@pytest.mark.parametrize(("genome", "name", "most"), HONEST)
def test_honest_creatures_have_little_momentum_that_nothing_gave(genome: str, name: str, most: float) -> None:
    task = Task.load(name)
    made = momentum_of_nothing(Genome.load(genome), task, 1)
    assert len(made) > task.tick_rate
    assert np.linalg.norm(made[-1]) < most * len(made) / task.tick_rate


def test_what_shakes_on_coarse_steps_has_much() -> None:
    swim = Task.load("swim").document
    limits, world = {**swim["limits"], "density": 20000}, {**swim["world"], "substeps": 4, "engine": {}}
    task = Task({**swim, "name": "coarse", "limits": limits, "world": world})
    made = momentum_of_nothing(lead_shaker(), task, 1)
    assert np.linalg.norm(made[-1]) > 3.0 * len(made) / task.tick_rate


@pytest.mark.parametrize(("genome", "coarse"), [("eel", 1.0), ("sidewinder", 0.1)])
def test_without_water_a_swimmer_stays_where_it_is(genome: str, coarse: float) -> None:
    """With forces computed once a step it comes farther than `coarse`, m."""
    swim = Task.load("swim").document
    world = {name: value for name, value in swim["world"].items() if name != "medium"}
    limits = {name: value for name, value in swim["limits"].items() if name not in ("speed", "spin")}
    way = "max(abs(displacement.x), max(abs(displacement.y), abs(displacement.z)))"
    still = {**swim, "name": "still", "limits": limits, "objective": way, "duration": 2}
    tasks = (Task({**still, "world": each}) for each in (world, {**world, "engine": {}}))
    stays, drifts = (evaluate(Genome.load(genome), task, seeds=[1]).results[0] for task in tasks)
    assert stays.score is not None and stays.score < 0.02
    assert drifts.score is not None and drifts.score > coarse
    assert stays.ticks == drifts.ticks == 120


def test_a_push_that_the_engine_applies_is_no_momentum_of_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    tick, creature, task = World.tick, Genome.load("walker"), Task.load("walk")

    def pushing(world: World) -> None:
        push = {"type": "apply_physics", "cube_name": "creature.torso", "impulse": [0.5, 0, 0]}
        if world.frame > 120:
            assert world.execute(1, push)["type"] == "physics_applied"
        tick(world)

    monkeypatch.setattr(World, "tick", pushing)
    made = momentum_of_nothing(creature, task, 1)
    assert len(made) > 60 and np.linalg.norm(made[-1]) < 0.03 * len(made) / task.tick_rate
