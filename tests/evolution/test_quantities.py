"""Expressions over the quantities of genomes and evaluations: what each is, and what is refused."""

from __future__ import annotations

import math
from typing import Any

import pytest

from layout import ROOT
from nmes.errors import DocumentError
from nmes.evaluation import Evaluation, Result, Task
from nmes.evolution.quantities import QUANTITIES, evaluate_quantities, read_expressions
from nmes.genome import Genome

TASK = Task.load("walk")
RESULTS = (Result(1, 4.0, 30.0, 2.0, 60, duty=0.5), Result(2, 6.0, 50.0, 4.0, 180, ended="fell", duty=0.25))


def values(*texts: str, genome: str = "walker", results: tuple[Result, ...] = RESULTS) -> tuple[float, ...] | None:
    creature = Genome.load(genome)
    evaluation = Evaluation(creature.name, creature.hash, TASK.name, TASK.hash, results)
    return evaluate_quantities(read_expressions(texts, "measures"), creature, evaluation, TASK)


def refused(*texts: str) -> DocumentError:
    with pytest.raises(DocumentError) as caught:
        read_expressions(texts, "measures")
    return caught.value


def test_what_a_creature_did_is_the_mean_over_the_seeds() -> None:
    assert TASK.tick_rate == 60
    names = ("score", "energy", "distance", "ticks", "seconds", "speed", "duty")
    assert values(*names) == (5.0, 40.0, 3.0, 120.0, 2.0, 1.5, 0.375)


def test_what_a_creature_is_follows_from_its_body() -> None:
    walker = Genome.load("walker")
    names = ("cubes", "joints", "motors", "sensors", "legs", "mass", "parameters", "symmetry")
    body = walker.body
    sizes = (len(body.cubes), len(body.joints), len(body.motors), len(body.sensors), 4.0, body.mass, 40.0, 1.0)
    assert values(*names) == sizes
    length, height, width = (high - low for low, high in zip(*body.bounds, strict=True))
    assert values("length", "height", "width") == (length, height, width)
    assert length > width > 0.3


LEGS = {"walker": 4, "biped": 2, "centipede": 8, "tumbler": 0}


@pytest.mark.parametrize("name", LEGS)
def test_legs_are_limbs_that_end_on_the_ground(name: str) -> None:
    assert values("legs", genome=name) == (LEGS[name],)


def block_with_arms(**changes: Any) -> Genome:
    """Returns a block with an arm on each side, of which one may be another."""
    arms: list[dict[str, Any]] = [{"id": "left", "position": [0, 0.5, 0.5]}, {"id": "right", **changes}]
    cubes = [{"id": "block", "size": [1, 1, 0.6], "mass": 2, "position": [0, 0.5, 0]}]
    cubes += [{"size": [0.4, 0.4, 0.4], "mass": 1, **arm} for arm in arms]
    joints = [
        {"id": arm["id"], "cube1": "block", "cube2": arm["id"], "type": "fixed", "anchor": [0, 0.5, 0.3]}
        for arm in arms
    ]
    return Genome({"format": "nmes-genome/1", "name": "block", "body": {"cubes": cubes, "joints": joints}})


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({}, 1.0),
        ({"size": [0.4, 0.5, 0.4]}, 1.0),  # across the plane along z each cube is its own image
        ({"position": [0.1, 0.5, -0.5]}, 0.75),
        ({"position": [0.1, 0.5, -0.5], "size": [0.4, 0.5, 0.4]}, 0.75),
    ],
)
def test_symmetry_is_the_part_of_the_mass_that_has_a_mirror_image(changes: dict[str, Any], part: float) -> None:
    genome = block_with_arms(**{"position": [0, 0.5, -0.5]} | changes)
    evaluation = Evaluation("block", genome.hash, TASK.name, TASK.hash, RESULTS)
    assert evaluate_quantities(read_expressions(["symmetry"], "measures"), genome, evaluation, TASK) == (part,)


def test_expressions_compute_with_quantities() -> None:
    assert values("legs * 2 + (mass > 0 ? 1 : 0)", "score / max(1, energy)") == (9.0, 0.125)
    assert values() == ()


def test_without_a_score_or_a_finite_value_there_is_none() -> None:
    assert values("legs", results=(RESULTS[0], Result(2, None, 1.0, 1.0, 5, fault="restless: so"))) is None
    assert values("legs", results=()) is None
    assert values("score", "1 / (legs - 4)") is None
    assert values("log(legs - 5)") is None


def test_speed_is_nothing_where_no_time_passed() -> None:
    assert values("speed", "seconds", results=(Result(1, 1.0, 0.0, 0.0, 0),)) == (0.0, 0.0)


@pytest.mark.parametrize("name", QUANTITIES)
def test_every_quantity_has_a_value_and_is_described(name: str) -> None:
    found = values(name)
    assert found is not None and math.isfinite(found[0])
    meaning, unit = QUANTITIES[name]
    assert f"| `{name}` | {unit} | {meaning} |".replace("|  |", "| |") in (ROOT / "docs/evolution.md").read_text()


def test_every_expression_that_cannot_be_read_is_named_with_a_hint() -> None:
    error = refused("legs", "leg", "mass +", "max.height", 'cube("torso").height')
    assert [path for path, _ in error.problems] == ["measures/1", "measures/2", "measures/3", "measures/4"]
    words = [words for _, words in error.problems]
    assert words[0] == "line 1, column 1: there is no quantity 'leg'; did you mean legs?"
    assert "found the end" in words[1]
    assert "there is no quantity 'max'" in words[2]
    assert "there is no function 'cube'" in words[3]
    assert "cubes, joints, motors" in refused("zzz").message


@pytest.mark.parametrize("text", ["(" * 5000, "legs + " * 600 + "1", "legs > 1", '"legs"', "legs.legs", "9" * 2001])
def test_expressions_of_strangers_are_bounded(text: str) -> None:
    assert refused(text).path == "measures/0"
