"""The auditor of episodes: he sees what evaluating sees, finds honest work in balance, and energy from nowhere."""

from __future__ import annotations

from itertools import count

import pytest

from energy_audit import audited
from nmes.evaluation import Task, evaluate
from nmes.genome import Genome
from nmes.world import World

HONEST = [
    ("walker", "walk"),
    ("jumper", "jump-high"),
    ("juggler", "pole"),
    ("inchworm", "planar-walk"),
    ("seeker", "reach"),
    ("galloper", "injury"),
    ("gecko", "injury"),
]


@pytest.mark.parametrize(("genome", "name"), HONEST)
def test_the_auditor_sees_the_same_episode_and_finds_honest_work_in_balance(genome: str, name: str) -> None:
    task, creature = Task.load(name), Genome.load(genome)
    audit = audited(creature, task, 1)
    assert (audit.result,) == evaluate(creature, task, seeds=[1]).results
    assert audit.work > 1.0 and 0.0 < audit.fastest < 15.0
    assert audit.balanced


@pytest.mark.parametrize(("genome", "name"), [("walker", "walk"), ("inchworm", "planar-walk")])
def test_the_auditor_finds_a_push_that_no_motor_gave(genome: str, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    task, creature = Task.load(name), Genome.load(genome)
    ticks, tick = count(), World.tick

    def pushing(world: World) -> None:
        if next(ticks) == 120:
            for cube in creature.body.cubes:  # all of it alike, 5 m/s upwards
                push = {"type": "apply_physics", "cube_name": f"creature.{cube.id}", "impulse": [0, 5 * cube.mass, 0]}
                assert world.execute(1, push)["type"] == "physics_applied"
        tick(world)

    honest = audited(creature, task, 1)
    monkeypatch.setattr(World, "tick", pushing)
    pushed = audited(creature, task, 1)
    assert honest.balanced and not pushed.balanced
    assert pushed.unearned > honest.unearned + 0.5 * creature.body.mass
