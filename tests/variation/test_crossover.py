"""Children are good genomes that have something of both parents."""

from __future__ import annotations

from itertools import combinations

import pytest

from nmes.errors import VariationError
from nmes.evaluation import Task
from nmes.evolution import Draw, cross, mutate
from nmes.genome import Genome
from nmes.variation.brains import motor_names

PAIRS = [("walker", "roller"), ("centipede", "inchworm"), ("centipede", "walker"), ("juggler", "lurcher")]


@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_children_are_good_genomes_of_two_parents(first: str, second: str) -> None:
    one, other, task = Genome.load(first), Genome.load(second), Task.load("walk")
    for number in range(6):
        child = cross(one, other, Draw(4, number), requirements=task.requirements)
        assert Genome(child.document).brain().outputs == tuple(motor_names(child.body))
        assert child.document["parents"] == [one.hash, other.hash]
        assert task.check(child.body) == []
        assert child.body != one.body or child.document["brain"] != one.document["brain"]


@pytest.mark.long
@pytest.mark.timeout(4_000)
def test_all_pairs_of_shipped_genomes_have_children() -> None:
    for first, second in combinations(Genome.names(), 2):
        for number in range(50):
            child = cross(Genome.load(first), Genome.load(second), Draw(5, number))
            Genome(child.document).brain()


def test_a_graft_brings_the_limb_of_the_second_parent_and_what_drives_it() -> None:
    one, other = Genome.load("walker"), Genome.load("biped")
    ways = other.document["brain"]["oscillators"]
    hips, knees, ankles = ways[:3]
    assert [each["motor"] for each in (hips, knees, ankles)] == ["*_hip", "*_knee", "*_ankle"]
    grafted = 0
    for number in range(12):
        child = cross(one, other, Draw(6, number))
        new = [cube for cube in child.body.cubes if cube.id not in {c.id for c in one.body.cubes}]
        assert {cube.size for cube in new} <= {cube.size for cube in other.body.cubes}
        waves = {each["motor"]: each for each in child.document["brain"]["oscillators"]}
        for side, place in (("left", 0), ("right", 1)):
            for kind, wave in (("hip", hips), ("knee", knees), ("ankle", ankles)):
                motor = f"{side}_{kind}"
                if motor in motor_names(child.body):
                    assert waves[motor]["frequency"] == wave["frequency"]
                    assert waves[motor]["phase"] == pytest.approx(wave["phase"] - place * wave["step"])
                    grafted += 1
    assert grafted >= 12


def test_numbers_of_brothers_are_mixed() -> None:
    parent = Genome.load("juggler")
    one, other = (mutate(parent, Draw(number), kind="weights").genome for number in (1, 2))
    vectors = [genome.brain().to_vector() for genome in (one, other)]
    mixed = 0
    for number in range(20):
        child = cross(one, other, Draw(7, number))
        if child.body == one.body:
            vector = child.brain().to_vector()
            assert ((vector == vectors[0]) | (vector == vectors[1])).all()
            mixed += 1
    assert mixed >= 5


def test_two_that_have_nothing_to_give_have_no_child() -> None:
    cube = {"id": "cube", "size": 0.5, "mass": 1, "position": [0, 0.25, 0]}
    lone = Genome({"format": "nmes-genome/1", "name": "lone", "body": {"cubes": [cube]}})
    with pytest.raises(VariationError) as caught:
        cross(lone, lone, Draw(1))
    assert caught.value.code == "no_offspring" and "nothing to give" in caught.value.message
