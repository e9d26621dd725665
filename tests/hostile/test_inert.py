"""A creature that does nothing scores exactly 0 on every task that ships, or is refused with a reason."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from itertools import count, islice
from typing import Any

import pytest

from nmes.evaluation import Evaluation, Evaluator, Task
from nmes.genome import Genome
from random_bodies import INERT, rounded, still, valid_genomes

CHUNK = 250
"""Bodies that are drawn before any is evaluated."""
CORES = os.cpu_count() or 1


@pytest.mark.parametrize("name", Task.names())
@pytest.mark.parametrize(
    ("bodies", "jobs"), [(10, 1), pytest.param(1000, CORES, marks=[pytest.mark.long, pytest.mark.timeout(20_000)])]
)
def test_a_creature_that_does_nothing_scores_nothing(
    name: str, bodies: int, jobs: int, record_property: Callable[[str, object], None]
) -> None:
    task = Task.load(name)
    outcomes: Counter[str] = Counter()
    planar = name.startswith("planar")
    drawn = valid_genomes(count(Task.names().index(name) * 1_000_000), Counter(), planar=planar)
    shaped = ((seed, document if seed % 2 or planar else rounded(document, seed)) for seed, document in drawn)
    inert = ((seed, still(document, INERT[place % len(INERT)])) for place, (seed, document) in enumerate(shaped))
    with Evaluator(jobs) as evaluator:
        for done in range(0, bodies, CHUNK):
            by_seed: dict[int, list[tuple[int, Genome]]] = {}
            for seed, document in islice(inert, min(CHUNK, bodies - done)):
                by_seed.setdefault(task.seeds[seed % len(task.seeds)], []).append((seed, body(task, document)))
            for task_seed, chunk in by_seed.items():
                genomes = [genome for _, genome in chunk]
                evaluations = evaluator.evaluate_population(genomes, task, seeds=[task_seed])
                for (seed, _), evaluation in zip(chunk, evaluations, strict=True):
                    outcomes[judged(evaluation, f"body {seed}")] += 1
    record_property(f"{name}: inert bodies", dict(outcomes))
    assert sum(outcomes.values()) == bodies
    assert outcomes["ran"] >= bodies // (10 if "newborn" in task.document else 3), (
        f"too few ran for this to say much: {outcomes}"
    )


def body(task: Task, document: dict[str, Any]) -> Genome:
    """Returns a genome; where a newborn must be small, one of which all but the root is later."""
    genome = Genome(document)
    if "newborn" not in task.document:
        return genome
    document = genome.expanded().document
    root, *later = document["body"]["cubes"]
    return Genome({**document, "later": [cube["id"] for cube in later if root is not cube]})


def judged(evaluation: Evaluation, which: str) -> str:
    """Fails where an inert body has scored; returns how it fared."""
    (result,) = evaluation.results or [None]
    if result is None:
        assert evaluation.error
        return "refused"
    if result.score is None:
        assert result.fault
        return result.fault.partition(":")[0]
    assert result.score == 0.0, f"{which}: {result}"
    return "ran"
