"""Mutants are good genomes, differ from their parents as the kind says, and follow from the seed."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from fnmatch import fnmatchcase
from functools import partial
from itertools import count, islice
from typing import Any, NamedTuple

import numpy as np
import orjson
import pytest

from nmes.brain import load_brain
from nmes.errors import VariationError
from nmes.evaluation import MatchTask, Task, evaluate
from nmes.evolution import KINDS, Draw, Mutant, mutate
from nmes.genome import Genome
from nmes.genome.body import Body
from nmes.genome.sensors import OF_OTHERS
from nmes.variation import Requirements
from nmes.variation.brains import motor_names, sensor_names
from random_bodies import valid_genomes

Json = dict[str, Any]

BODY = ["add-part", "remove-part", "resize-part", "move-part", "joint", "limits", "axis", "motor", "symmetry"]
SHORT, LONG = 24, 100_000
"""How many mutants of each kind."""
NEVER = {
    "recursion": "there is nothing of that kind to change",  # of a body that is written out
    "weights": "there is nothing of that kind to change",  # of oscillators
    "oscillators": "there is nothing of that kind to change",  # of networks
    "voices": "there is nothing of that kind to change",  # where there are no channels
    "shape": "there is nothing of that kind to change",  # where tasks name no shapes
}
OWN = {"voices": ("voices",), "development": ("later", "development")}
"""What of a genome a kind changes besides body, sensors and brain."""


class Place(NamedTuple):
    """Where mutants are to live."""

    requirements: Requirements
    check: Callable[[Body], Sequence[str]]


def place(kind: str) -> Place:
    """Returns a task in which mutations of a kind may change something: most may in any."""
    if kind == "voices":
        match = MatchTask.load("scout")
        return Place(match.requirements("scout"), partial(match.check, "scout"))
    task = Task.load({"shape": "swim", "development": "growth"}.get(kind, "walk"))
    return Place(task.requirements, task.check)


def line(kind: str, parent: Genome, number: int, where: Place) -> Mutant | None:
    try:
        return mutate(parent, Draw(14, kind, number), kind=kind, requirements=where.requirements)
    except VariationError as error:
        assert error.code == "no_offspring"
        return None


def lines_of_descent(kind: str, where: Place) -> Iterator[tuple[Genome, Genome]]:
    """Yields parents and mutants without end: of shipped and random genomes that may take part, and of their children.

    A founder that has no mutant of this kind is not tried again: a hundred tries cost as much as a hundred mutants.
    """
    numbers = count()
    founders: list[Genome] = [Genome.load(name) for name in Genome.names()]
    founders += [Genome(document) for _, document in islice(valid_genomes(count(7_000), Counter(), planar=False), 12)]
    founders = [founder for founder in founders if not where.check(founder.body)]
    while founders:
        barren = []
        for founder in founders:
            parent = founder
            for _ in range(4):
                mutant = line(kind, parent, next(numbers), where)
                if mutant is None:
                    break
                yield parent, mutant.genome
                parent = mutant.genome
            if parent is founder:
                barren.append(founder)
        founders = [founder for founder in founders if founder not in barren]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("mutants", [SHORT, pytest.param(LONG, marks=[pytest.mark.long, pytest.mark.timeout(20_000)])])
def test_mutants_are_good_genomes_that_may_take_part(kind: str, mutants: int) -> None:
    where, seen = place(kind), 0
    for parent, child in islice(lines_of_descent(kind, where), mutants):
        seen += 1
        read = Genome.parse(orjson.dumps(child.document))  # as from a file
        assert read.hash == child.hash
        assert list(where.check(read.body)) == []
        if "brain" in read.document:
            assert read.brain().outputs == tuple(motor_names(read.body))
        assert child.document["parents"] == [parent.hash]
        parts = ("body", "sensors", "brain", *OWN.get(kind, ()))
        assert any(child.document.get(part) != parent.document.get(part) for part in parts), "nothing has changed"
    assert seen == mutants


def sizes(genome: Genome) -> list[tuple[float, ...]]:
    return sorted(cube.size for cube in genome.body.cubes)


@pytest.mark.parametrize("name", ["walker", "centipede"])
def test_each_kind_changes_what_it_says(name: str) -> None:
    parent = Genome.load(name)

    def mutants(kind: str) -> list[Genome]:
        return [mutate(parent, Draw(3, kind, number), kind=kind).genome for number in range(8)]

    assert all(len(child.body.cubes) > len(parent.body.cubes) for child in mutants("add-part"))
    assert all(len(child.body.cubes) < len(parent.body.cubes) for child in mutants("remove-part"))
    for child in mutants("resize-part"):
        assert len(child.body.cubes) == len(parent.body.cubes)
        assert sizes(child) != sizes(parent) or child.body.mass != parent.body.mass
    for child in mutants("move-part"):
        places = {cube.id: (cube.position, cube.quaternion) for cube in child.body.cubes}
        assert any(places[cube.id] != (cube.position, cube.quaternion) for cube in parent.body.cubes)
    for kind, field in (("joint", "kind"), ("limits", "limits"), ("axis", "axis")):
        for child in mutants(kind):
            before, after = ({j.id: getattr(j, field) for j in g.body.joints} for g in (parent, child))
            assert before != after and before.keys() == after.keys(), kind
    for child in mutants("motor"):
        assert child.body.joints != parent.body.joints and child.body.cubes == parent.body.cubes
    for child in mutants("symmetry"):
        assert child.body.cubes != parent.body.cubes
    for child in mutants("sensors"):
        assert sensor_names(child.body) != sensor_names(parent.body) and child.body.cubes == parent.body.cubes
    for kind in ("oscillators", "topology"):
        for child in mutants(kind):
            assert child.body == parent.body and child.document["brain"] != parent.document["brain"]


def test_a_written_out_limb_is_mirrored_across_its_parent() -> None:
    one_leg = Genome(
        {
            "format": "nmes-genome/1",
            "name": "one leg",
            "body": {
                "cubes": [
                    {"id": "torso", "size": [0.6, 0.2, 0.4], "mass": 6, "position": [0, 0.6, 0]},
                    {"id": "leg", "size": [0.1, 0.4, 0.1], "mass": 1, "position": [0.2, 0.3, 0.26]},
                ],
                "joints": [
                    {
                        "id": "hip",
                        "cube1": "torso",
                        "cube2": "leg",
                        "type": "hinge",
                        "anchor": [0.2, 0.5, 0.2],
                        "axis": [1, 0, 0],
                        "motor": {"mode": "position", "range": [-1, 1], "max_effort": 10},
                    }
                ],
            },
            "brain": {"kind": "sine", "oscillators": [{"motor": "hip"}]},
        }
    )
    children = [mutate(one_leg, Draw(seed), kind="symmetry").genome for seed in range(12)]
    child = next(each for each in children if each.body.cubes[2].position[2] == -0.26)
    assert [cube.id for cube in child.body.cubes] == ["torso", "leg", "leg.mirror"]
    assert child.body.cubes[2].position == (0.2, 0.3, -0.26)
    mirrored = child.body.joints[1]
    assert (mirrored.cube1, mirrored.cube2, mirrored.anchor) == ("torso", "leg.mirror", (0.2, 0.5, -0.2))
    assert mirrored.axis == (-1.0, 0.0, 0.0)  # so that both legs swing outwards together
    assert [each["motor"] for each in child.document["brain"]["oscillators"]] == ["hip", "hip.mirror"]


@pytest.mark.parametrize("name", Genome.names())
def test_what_keeps_its_name_keeps_its_part_of_the_brain(name: str) -> None:
    parent, compared = Genome.load(name), 0
    for number in range(6):
        child = mutate(parent, Draw(5, number), kind="add-part").genome
        kept = set(motor_names(parent.body)) & set(motor_names(child.body))
        brain, after = parent.document["brain"], child.document["brain"]
        assert kept and after["kind"] == brain["kind"]
        for each in brain.get("oscillators", ()):
            if any(fnmatchcase(motor, each["motor"]) for motor in kept):
                assert each in after["oscillators"]
        shared = set(sensor_names(parent.body)) & set(sensor_names(child.body))
        was, now = driven(parent, shared), driven(child, shared)
        for motor in kept:
            assert now[motor] == pytest.approx(was[motor], abs=1e-12), motor
            compared += len(set(was[motor])) > 1 or was[motor][0] != 0.0
    assert compared >= 6, "no motor did anything that could be compared"


def driven(genome: Genome, sensed: Collection[str]) -> dict[str, list[float]]:
    """Returns what motors are told in half a second in which only these sensors read anything but 0.

    What one oscillator drives swings in step, as a motor that is new may take a place in the row of the others.
    """
    document = genome.document["brain"]
    if "oscillators" in document:
        document["oscillators"] = [{**each, "step": 0.0} for each in document["oscillators"]]
    brain = load_brain(document, sensor_names(genome.body), motor_names(genome.body))
    brain.reset(0, 1 / 60)
    readings = dict(zip(sorted(sensed), np.linspace(-1.0, 1.0, len(sensed)).tolist(), strict=True))
    inputs = np.array([readings.get(each, 0.0) for each in brain.inputs])
    steps = [brain.step(inputs).tolist() for _ in range(30)]
    return {motor: [step[place] for step in steps] for place, motor in enumerate(brain.outputs)}


def test_mutants_of_planar_tasks_stay_in_the_plane() -> None:
    task = Task.load("planar-walk")
    genome = Genome.load("inchworm")
    for number in range(30):
        genome = mutate(genome, Draw(9, number), requirements=task.requirements).genome
        assert genome.body.planar
    assert evaluate(genome, task, seeds=[1]).error is None


def test_a_split_link_has_the_same_name_in_two_lines_of_descent() -> None:
    def split(genome: Genome) -> set[str]:
        found: set[str] = set()
        for number in range(60):
            child = mutate(genome, Draw(2, genome.name, number), kind="topology").genome
            found |= {node["id"] for node in child.document["brain"]["nodes"] if node["id"].startswith("split.")}
        return found

    seeker = Genome.load("seeker")
    cousin = mutate(seeker, Draw(1), kind="weights").genome
    assert len(split(seeker) & split(cousin)) >= 2


@pytest.mark.parametrize("name", ["seeker", "walker", "tumbler"])
def test_who_has_others_and_channels_comes_to_sense_and_speak(name: str) -> None:
    requirements = Requirements(senses=OF_OTHERS, channels=(("lead", 2), ("alarm", 1)))
    genome, alone = Genome.load(name), Genome.load(name)
    sensed = Counter[str]()
    for number in range(90):
        kind = (None, "sensors", "voices")[number % 3]
        genome = mutate(genome, Draw(5, number), kind=kind, requirements=requirements).genome
        if "brain" in genome.document:
            assert genome.brain().outputs == genome.body.outputs
        assert {(voice.channel, voice.number) for voice in genome.body.voices} <= {
            ("lead", 1), ("lead", 2), ("alarm", 1),
        }  # fmt: skip
        sensed.update(sensor.type for sensor in genome.body.sensors)
        alone = mutate(alone, Draw(5, number)).genome
        assert not alone.body.voices and not {sensor.type for sensor in alone.body.sensors} & {"hear", *OF_OTHERS}
    assert genome.body.voices and sensed["hear"] and any(sensed[kind] for kind in OF_OTHERS)


AROUND = ("touch", "acceleration", "range", "camera", "target_smell")


def test_where_senses_of_what_is_around_are_of_use_they_come_and_turn() -> None:
    requirements, genome = Requirements(senses=AROUND), Genome.load("seeker")
    sensed, directions = Counter[str](), set()
    for number in range(80):
        genome = mutate(genome, Draw(7, number), kind="sensors", requirements=requirements).genome
        assert genome.brain().inputs == tuple(sensor.id for sensor in genome.body.sensors)
        sensed.update(sensor.type for sensor in genome.body.sensors if sensor.solitary)
        directions |= {(sensor.id, sensor.direction) for sensor in genome.body.sensors if sensor.type == "range"}
    assert sensed.keys() == set(AROUND)
    assert len(directions) > len({sensor for sensor, _ in directions})  # some have turned
    alone = mutate(Genome.load("seeker"), Draw(7, 1), kind="sensors").genome
    assert not any(sensor.solitary for sensor in alone.body.sensors)


def test_in_a_plane_new_sensors_look_along_it() -> None:
    genome, requirements = Genome.load("inchworm"), Requirements(planar=True, senses=("range", "camera", "touch"))
    looks, faces = list[Any](), set[str | None]()
    for number in range(90):
        genome = mutate(genome, Draw(8, number), kind="sensors", requirements=requirements).genome
        looks += [sensor.direction for sensor in genome.body.sensors if sensor.direction is not None]
        faces |= {sensor.face for sensor in genome.body.sensors}
    assert looks and all(look[2] == 0 for look in looks)
    assert {None} < faces <= {None, "+x", "-x", "+y", "-y"}


def test_a_body_that_changes_keeps_its_voices() -> None:
    brain = {"kind": "sine", "oscillators": [{"motor": name, "frequency": 1} for name in ("*axle", "say.lead")]}
    parent = Genome({**Genome.load("roller").document, "voices": [{"channel": "lead"}], "brain": brain})
    for number in range(12):
        child = mutate(parent, Draw(6, number), kind="add-part").genome
        assert [voice.id for voice in child.body.voices] == ["say.lead"]
        assert child.document["brain"]["oscillators"][1] == brain["oscillators"][1]


def test_an_unknown_kind_is_refused_with_a_hint() -> None:
    with pytest.raises(VariationError) as caught:
        mutate(Genome.load("walker"), Draw(1), kind="add-prt")
    assert caught.value.code == "unknown_mutation" and "add-part" in caught.value.message


@pytest.mark.parametrize("kind", NEVER)
def test_a_kind_that_has_nothing_to_change_is_refused(kind: str) -> None:
    genome = Genome.load("balancer" if kind != "weights" else "walker")
    with pytest.raises(VariationError) as caught:
        mutate(genome, Draw(1), kind=kind)
    assert caught.value.code == "no_offspring" and NEVER[kind] in caught.value.message


PROGRAM = """
from nmes.evolution import Draw, cross, mutate
from nmes.genome import Genome
for name in ("walker", "centipede", "roller", "lurcher"):
    genome = Genome.load(name)
    for number in range(6):
        genome = mutate(genome, Draw(11, number)).genome
    print(genome.hash, cross(genome, Genome.load("seeker"), Draw(12)).hash)
"""


def test_mutants_and_children_are_the_same_in_fresh_processes() -> None:
    seen = {
        subprocess.run(
            [sys.executable, "-c", PROGRAM],
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            check=True,
        ).stdout
        for seed in ("1", "2")
    }
    assert len(seen) == 1
    # Runs of evolution are asked again by those who verify them: what a seed gives must never change.
    assert seen.pop().split()[0] == b"5cbb39a57c5258b95236115077c4f119c14dadcb16bca60578838846421b4e72"


@pytest.mark.parametrize("name", ["walker", "centipede", "tumbler"])
def test_shapes_come_where_a_task_names_them_and_stay_sound_when_parts_change(name: str) -> None:
    requirements = Requirements(shapes=("capsule", "cylinder", "sphere"))
    seen: Counter[str] = Counter()
    for number in range(3):
        child = Genome.load(name)
        for step, kind in enumerate(("shape", "resize-part", "shape", "resize-part", "resize-part", "shape")):
            before = child
            child = mutate(child, Draw(5, kind, 10 * number + step), kind=kind, requirements=requirements).genome
            if kind == "shape":
                old = {cube.id: cube.shape for cube in before.body.cubes}
                assert any(old[cube.id] != cube.shape for cube in child.body.cubes)
                assert child.body.mass < 3 * before.body.mass
        seen.update(cube.shape for cube in child.body.cubes)
    assert set(seen) > {"box"}


def test_swimmers_may_become_round_and_walkers_may_not() -> None:
    swim, walk = Task.load("swim").requirements, Task.load("walk").requirements
    assert set(swim.shapes) == {"sphere", "capsule", "cylinder"} and not walk.shapes
    parent = Genome.load("walker")
    kinds = Counter(mutate(parent, Draw(6, number), requirements=swim).kind for number in range(60))
    assert kinds["shape"] > 0
    assert not any(mutate(parent, Draw(6, number), requirements=walk).kind == "shape" for number in range(60))
