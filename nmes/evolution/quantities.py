"""Expressions over the quantities of a genome and its evaluation, in which a run's objectives and measures are written.

Hides what each quantity is and how it is computed. An expression is one of `nmes.objective`, with other names. What a
creature is follows from its body at rest, as its document has it; what it did is the mean over the evaluation's seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import fsum
from typing import Final

import numpy as np

from nmes.errors import DocumentError, WorldError
from nmes.evaluation import Evaluation
from nmes.evaluation.setting import Setting
from nmes.genome import Genome
from nmes.genome.body import Body, corners
from nmes.objective import Objective

__all__ = ["QUANTITIES", "evaluate_quantities", "read_expressions"]

_STANDING = 0.2  # of a body's height above its lowest point: what ends no higher can stand on the ground
_ALIKE = 1e-3  # m by which a cube and the mirror image of another may differ


def _edge(body: Body, axis: int) -> float:
    low, high = body.bounds
    return high[axis] - low[axis]


def _legs(body: Body) -> float:
    """Returns how many limbs end on the ground: cubes with one joint, not the first, whose lowest point is low."""
    ends = [end for joint in body.joints for end in (joint.cube1, joint.cube2)]
    highest = body.bounds[0][1] + _STANDING * _edge(body, 1)
    limbs = (cube for cube in body.cubes[1:] if ends.count(cube.id) == 1)
    return float(len([cube for cube in limbs if float(corners(cube)[:, 1].min()) <= highest]))


def _symmetry(body: Body) -> float:
    """Returns the part of the mass that has a mirror image, across the better upright plane through the first cube."""
    boxes = np.array([[points.min(axis=0), points.max(axis=0)] for points in map(corners, body.cubes)])
    parts = []
    for axis in (0, 2):
        images = boxes.copy()
        images[:, ::-1, axis] = 2.0 * body.cubes[0].position[axis] - boxes[:, :, axis]
        mass = [
            cube.mass
            for cube, image in zip(body.cubes, images, strict=True)
            if (np.abs(boxes - image) <= _ALIKE).all(axis=(1, 2)).any()
        ]
        parts.append(fsum(mass) / body.mass)
    return max(parts)


def _parameters(genome: Genome) -> float:
    return float(genome.brain().to_vector().size) if "brain" in genome.document else 0.0


def _ticks(evaluation: Evaluation) -> float:
    return fsum(result.ticks for result in evaluation.results) / len(evaluation.results)


def _speed(evaluation: Evaluation, tick_rate: int) -> float:
    ticks = _ticks(evaluation)
    return _known(evaluation.distance) * tick_rate / ticks if ticks else 0.0


def _known(value: float | None) -> float:
    assert value is not None  # of an evaluation that has a score
    return value


_OF_GENOME: Final[Mapping[str, tuple[str, str, Callable[[Genome], float]]]] = {
    "cubes": ("how many cubes the body has", "", lambda genome: len(genome.body.cubes)),
    "joints": ("how many joints", "", lambda genome: len(genome.body.joints)),
    "motors": ("how many motors", "", lambda genome: len(genome.body.motors)),
    "sensors": ("how many readings its sensors give", "", lambda genome: len(genome.body.sensors)),
    "legs": (
        "how many limbs stand on the ground: cubes but the first that have one joint, and end no more than a fifth "
        "of the body's height above its lowest point",
        "",
        lambda genome: _legs(genome.body),
    ),
    "mass": ("of all cubes", "kg", lambda genome: genome.body.mass),
    "length": ("of the box around the body, along x", "m", lambda genome: _edge(genome.body, 0)),
    "height": ("of that box, upwards", "m", lambda genome: _edge(genome.body, 1)),
    "width": ("of that box, along z", "m", lambda genome: _edge(genome.body, 2)),
    "symmetry": (
        "part of the mass, 0 to 1, in cubes whose mirror image is a cube of the body too, across the upright plane "
        "through the first cube's centre, along x or z, that gives more",
        "",
        lambda genome: _symmetry(genome.body),
    ),
    "later": ("how many cubes are not there at birth", "", lambda genome: len(genome.body.later)),
    "rules": ("how many rules of development there are", "", lambda genome: len(genome.body.development)),
    "parameters": ("how many numbers the brain has that can be varied; 0 without a brain", "", _parameters),
}
_OF_EVALUATION: Final[Mapping[str, tuple[str, str, Callable[[Evaluation, int], float]]]] = {
    "score": ("the task's, the mean over the seeds", "", lambda evaluation, _: _known(evaluation.score)),
    "energy": ("work of the motors in an episode", "J", lambda evaluation, _: _known(evaluation.energy)),
    "distance": ("from start to end over the ground", "m", lambda evaluation, _: _known(evaluation.distance)),
    "ticks": ("how many an episode was scored for", "", lambda evaluation, _: _ticks(evaluation)),
    "seconds": ("how long an episode was scored for", "s", lambda evaluation, rate: _ticks(evaluation) / rate),
    "speed": ("that distance in that time", "m/s", _speed),
    "duty": (
        "the duty factor of the feet, 0 to 1: of the cubes that touch the ground, or a thing, at all, the part of the "
        "time that each does, the mean; 0 where none does",
        "",
        lambda evaluation, _: _known(evaluation.duty),
    ),
}
QUANTITIES: Final[Mapping[str, tuple[str, str]]] = {
    name: (meaning, unit) for name, (meaning, unit, _) in [*_OF_GENOME.items(), *_OF_EVALUATION.items()]
}
"""What an expression may name: each name with its meaning and unit. Those of an episode are means over the seeds."""


def read_expressions(texts: Sequence[str], path: str) -> tuple[Objective, ...]:
    """Reads expressions over `QUANTITIES`.

    Args:
        texts: The expressions.
        path: The field that has them; the one to blame is `path/0`, `path/1`, ...

    Raises:
        DocumentError: Some cannot be read, with the reason and place of each.
    """
    expressions, problems = [], []
    for number, text in enumerate(texts):
        place = f"{path}/{number}"
        try:
            expressions.append(Objective(text, place, names=QUANTITIES))
        except WorldError as error:
            problems.append((place, error.message.removeprefix(f"{place}: ")))
    if problems:
        raise DocumentError(problems)
    return tuple(expressions)


def evaluate_quantities(
    expressions: Sequence[Objective], genome: Genome, evaluation: Evaluation, task: Setting
) -> tuple[float, ...] | None:
    """Returns the values of expressions that `read_expressions` has read, in their order, for one creature.

    Args:
        expressions: The expressions.
        genome: The creature.
        evaluation: How it came out.
        task: On what.

    Returns:
        None where the evaluation has no score, or some expression no finite value: such a candidate has no score.
    """
    if evaluation.score is None:
        return None
    values = {
        quantity: _value(quantity.name, genome, evaluation, task.tick_rate)
        for quantity in dict.fromkeys(need for expression in expressions for need in expression.needs)
    }
    try:
        return tuple(expression.value(values) for expression in expressions)
    except WorldError:  # no finite value
        return None


def _value(name: str, genome: Genome, evaluation: Evaluation, tick_rate: int) -> float:
    if name in _OF_GENOME:
        return float(_OF_GENOME[name][2](genome))
    return float(_OF_EVALUATION[name][2](evaluation, tick_rate))
