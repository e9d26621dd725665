"""Random creatures are good genomes that may take part, of many shapes, and a good part of them can move."""

from __future__ import annotations

from collections import Counter

import numpy as np
import orjson
import pytest

from nmes.errors import VariationError
from nmes.evaluation import Evaluator, Task
from nmes.evolution import Draw, mutate
from nmes.genome import Genome
from nmes.variation.random_genomes import random_genome

SHORT, LONG = 6, 20_000
"""How many creatures of each task."""


def creatures(task: Task, count: int) -> list[Genome]:
    return [
        random_genome(Draw(19, task.name, number), task.requirements, f"random-{number}") for number in range(count)
    ]


def narrow(**limits: float) -> Task:
    return Task({**Task.load("walk").document, "limits": limits})


@pytest.mark.parametrize("name", Task.names())
@pytest.mark.parametrize("count", [SHORT, pytest.param(LONG, marks=[pytest.mark.long, pytest.mark.timeout(20_000)])])
def test_random_creatures_are_good_genomes_that_may_take_part(name: str, count: int) -> None:
    task = Task.load(name)
    for genome in creatures(task, count):
        read = Genome.parse(orjson.dumps(genome.document))  # as from a file
        assert read.hash == genome.hash
        assert task.check(read.body) == []
        assert read.body.motors and read.brain().outputs
        assert name != "planar-walk" or read.body.planar


def test_they_are_symmetric_and_in_segments_and_have_brains_of_several_kinds() -> None:
    drawn = creatures(Task.load("walk"), 60)
    assert len({genome.hash for genome in drawn}) == 60
    connections = [genome.document["body"]["graph"]["connections"] for genome in drawn]
    mirrored = sum(any("mirror" in each for each in graph) for graph in connections)
    repeated = sum(any(each["from"] == each["to"] for each in graph) for graph in connections)
    assert mirrored > 30 and 12 < repeated < 48
    kinds = Counter(genome.document["brain"]["kind"] for genome in drawn)
    assert set(kinds) == {"sine", "cpg", "graph", "ctrnn"} and kinds["sine"] + kinds["cpg"] > 36
    assert max(len(genome.body.cubes) for genome in drawn) > 9


def test_a_good_part_of_them_moves() -> None:
    task = Task({**Task.load("walk").document, "duration": 4, "seeds": [1]})
    evaluations = Evaluator(1).evaluate_population(creatures(task, 16), task)
    assert sum(evaluation.score is not None for evaluation in evaluations) >= 14
    assert sum((evaluation.distance or 0.0) > 0.1 for evaluation in evaluations) >= 4


def test_motors_are_driven_and_most_swing() -> None:
    """Each motor belongs to an output of the brain: one that none owned would rest for ever."""
    swinging = []
    for genome in creatures(Task.load("walk"), 30):
        brain = genome.brain()
        brain.reset(0, 1 / 60)
        rows = np.array([brain.step(np.full(len(brain.inputs), 0.1)).copy() for _ in range(180)])
        swinging += (np.ptp(rows, axis=0) > 0.1).tolist()
    assert len(swinging) > 60 and sum(swinging) > 0.8 * len(swinging)


def test_they_keep_within_narrow_limits() -> None:
    task = narrow(cubes=3, mass=2.0, size=0.5, density=800.0, effort=2.0)
    assert all(len(genome.body.cubes) <= 3 and genome.body.mass <= 2.0 for genome in creatures(task, 20))


def test_a_task_that_allows_none_says_why() -> None:
    with pytest.raises(VariationError) as caught:
        random_genome(Draw(1), narrow(cubes=1).requirements, "nobody")
    assert caught.value.code == "no_offspring" and "at most 1 are allowed" in caught.value.message


def test_the_draw_decides_and_nothing_else() -> None:
    task = Task.load("walk")
    one, same, other = (random_genome(Draw(seed, "x"), task.requirements, "it") for seed in (1, 1, 2))
    assert one.hash == same.hash != other.hash
    assert one.name == "it" and "parents" not in one.document


def test_they_can_be_mutated() -> None:
    task = Task.load("walk")
    for number, genome in enumerate(creatures(task, 30)):
        assert mutate(genome, Draw(5, number), requirements=task.requirements).genome.hash != genome.hash


def test_parts_can_be_told_apart_by_colour_and_new_ones_have_another() -> None:
    genome = random_genome(Draw(4, "colours"), Task.load("walk").requirements, "colourful")
    colours = [tuple(part["color"]) for part in genome.document["body"]["graph"]["parts"]]
    assert len(set(colours)) == len(colours) > 1
    child = mutate(genome, Draw(5, "one more"), kind="add-part").genome
    assert all(part["color"] for part in child.document["body"]["graph"]["parts"])
    assert len(child.document["body"]["graph"]["parts"]) > len(colours)
