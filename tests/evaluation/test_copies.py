"""Copies of creatures that ask to be new ones: what is the same by another name is known again."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import pytest

from creatures import SINE, WAVE, cpg, mlp, renamed, snake
from nmes.evaluation.identity import creature_hash
from nmes.genome import Genome


def shifted(document: dict[str, Any]) -> dict[str, Any]:
    changed = copy.deepcopy(document)
    for cube in changed["body"]["cubes"]:
        cube["position"] = [cube["position"][0] + 3.5, cube["position"][1] + 0.25, cube["position"][2] - 1.25]
    for joint in changed["body"]["joints"]:
        joint["anchor"] = [joint["anchor"][0] + 3.5, joint["anchor"][1] + 0.25, joint["anchor"][2] - 1.25]
    return changed


def with_parts(document: dict[str, Any], **changes: Any) -> dict[str, Any]:
    changed = copy.deepcopy(document)
    for cube in changed["body"]["cubes"]:
        cube.update(changes)
    return changed


def written_out(document: dict[str, Any]) -> dict[str, Any]:
    """Writes out what a document leaves out: axes, zeros, the brain's defaults."""
    changed = copy.deepcopy(document)
    for cube in changed["body"]["cubes"]:
        cube["rotation"] = [0, 0, 0, -2]
    for joint in changed["body"]["joints"]:
        joint.update(axis=[0, 0, 2], stiffness=0, damping=0)
    brain = changed["brain"]
    for oscillator in brain.get("oscillators", ()):
        oscillator.setdefault("phase", 0)
    return changed


COPIES: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    "names": lambda genome: {**genome, "name": "mine", "author": "Eve", "description": "mine", "parents": ["ab" * 32]},
    "licence": lambda genome: {**genome, "license": "MIT"},
    "colours": lambda genome: with_parts(genome, color=[1, 0, 0]),
    "ids": renamed,
    "elsewhere": shifted,
    "defaults": written_out,
    "noise": lambda genome: with_parts(genome, mass=0.5 + 1e-13),
}


@pytest.mark.parametrize("change", COPIES.values(), ids=COPIES)
@pytest.mark.parametrize("brain", [SINE, cpg(4), mlp(4)], ids=["sine", "cpg", "mlp"])
def test_a_copy_is_the_same_creature(brain: dict[str, Any], change: Callable[[Any], Any]) -> None:
    original = snake(brain)
    copied = Genome(change(original))
    assert copied.hash != Genome(original).hash
    assert creature_hash(copied) == creature_hash(Genome(original))


@pytest.mark.parametrize("name", Genome.names())
def test_a_creature_that_ships_is_none_of_the_others_and_the_same_when_expanded(name: str) -> None:
    genome = Genome.load(name)
    assert creature_hash(genome.expanded()) == creature_hash(genome)
    assert sum(creature_hash(Genome.load(other)) == creature_hash(genome) for other in Genome.names()) == 1


OTHERS: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    "mass": lambda genome: with_parts(genome, mass=0.5001),
    "friction": lambda genome: with_parts(genome, friction=0.9),
    "brain": lambda genome: {**genome, "brain": cpg(4)},
    "no brain": lambda genome: {key: value for key, value in genome.items() if key != "brain"},
    "amplitude": lambda genome: {**genome, "brain": {"kind": "sine", "oscillators": [{**WAVE[0], "amplitude": 0.7}]}},
    "one motor": lambda genome: {**genome, "brain": {"kind": "sine", "oscillators": [{**WAVE[0], "motor": "j0"}]}},
    "sensors": lambda genome: {**genome, "sensors": [{"type": "height", "cube": "c0"}]},
}


@pytest.mark.parametrize("change", OTHERS.values(), ids=OTHERS)
def test_a_change_of_body_sensors_or_brain_makes_another_creature(change: Callable[[Any], Any]) -> None:
    assert creature_hash(Genome(change(snake()))) != creature_hash(Genome(snake()))
