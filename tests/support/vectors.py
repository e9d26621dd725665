"""Genomes that stand for a vector: the parameters of their brain, to try algorithms on functions of numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from nmes.evaluation import Task
from nmes.evolution.algorithm import Algorithm, Candidate, Measure, Problem, Score
from nmes.evolution.algorithms import load_algorithm
from nmes.genome import Genome

Vector = npt.NDArray[np.float64]

AHEAD = 1_000
"""How many candidates may wait: there are algorithms that need no scores."""
WALK = Task.load("walk")


def vector_genome(values: Any) -> Genome:
    """Returns a genome with these parameters, of which there must be 4, 7, 10, ...: a network with one hidden layer."""
    numbers = list(map(float, values))
    units = (len(numbers) - 1) // 3
    assert len(numbers) == 3 * units + 1
    first, biases, second = (numbers[at * units : (at + 1) * units] for at in range(3))
    layers = [
        {"weights": [[weight] for weight in first], "biases": biases},
        {"weights": [second], "biases": numbers[-1:]},
    ]
    cubes = [
        {"id": name, "size": [0.5] * 3, "mass": 1, "position": [0, y, 0]} for name, y in (("a", 0.25), ("b", 0.75))
    ]
    motor = {"mode": "position", "range": [-1, 1], "max_effort": 5}
    joint = {"id": "j", "cube1": "a", "cube2": "b", "type": "hinge", "anchor": [0, 0.5, 0], "motor": motor}
    document = {
        **{"format": "nmes-genome/1", "name": "vector", "body": {"cubes": cubes, "joints": [joint]}},
        **{"sensors": [{"type": "height", "cube": "b"}], "brain": {"kind": "mlp", "layers": layers}},
    }
    genome = Genome(document)
    assert vector_of(genome).tolist() == genome.brain().to_vector().tolist() == numbers
    return genome


def vector_of(genome: Genome) -> Vector:
    """Returns the vector that a genome of `vector_genome`, or one with other numbers, stands for."""
    first, second = genome.document["brain"]["layers"]
    (weights,), biases = second["weights"], second["biases"]
    return np.array([*(row[0] for row in first["weights"]), *first["biases"], *weights, *biases])


def vector_problem(start: Any, seed: int = 1, *measures: Measure) -> Problem:
    """Returns a problem that begins at a vector."""
    return Problem(WALK, seed, (vector_genome(start),), measures=measures)


def feed(algorithm: Algorithm, judge: Callable[[Candidate], Score]) -> Iterator[tuple[int, Candidate, Score]]:
    """Asks for candidates without end, each as early as it may be asked for, and tells their scores in order.

    Yields:
        Each candidate that was told, with its index and score.
    """
    waiting: dict[int, Candidate] = {}
    told = asked = 0
    while True:
        while asked < told + AHEAD and algorithm.needs(asked) <= told:
            waiting[asked] = algorithm.ask(asked)
            asked += 1
        candidate = waiting.pop(told)
        score = judge(candidate)
        algorithm.tell(told, candidate, score)
        yield told, candidate, score
        told += 1


def sphere(vector: Vector) -> float:
    """Returns the sum of the squares."""
    return float((vector * vector).sum())


def rosenbrock(vector: Vector) -> float:
    """Returns Rosenbrock's function, whose least value, 0, is where all numbers are 1."""
    first, second = vector[:-1], vector[1:]
    return float((100.0 * (second - first * first) ** 2 + (1.0 - first) ** 2).sum())


def evaluations(
    name: str, problem: Problem, options: dict[str, Any], function: Callable[[Vector], float], goal: float, most: int
) -> int:
    """Returns after how many evaluations a function is no greater than a goal; `most` if it is not by then."""
    algorithm = load_algorithm(name, problem, options)
    for index, _, score in feed(algorithm, lambda candidate: Score(-function(vector_of(candidate.genome)))):
        assert score.score is not None
        if -score.score <= goal or index + 1 == most:
            return index + 1
    raise AssertionError
