"""A creature that does nothing scores exactly 0 on every task that ships, or is refused with a reason."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from itertools import count, islice

import pytest

from nmes.evaluation import Task, evaluate
from nmes.genome import Genome
from random_bodies import INERT, still, valid_genomes


@pytest.mark.parametrize("name", Task.names())
@pytest.mark.parametrize("bodies", [10, pytest.param(10_000, marks=[pytest.mark.long, pytest.mark.timeout(20_000)])])
def test_a_creature_that_does_nothing_scores_nothing(
    name: str, bodies: int, record_property: Callable[[str, object], None]
) -> None:
    task = Task.load(name)
    outcomes: Counter[str] = Counter()
    drawn = valid_genomes(count(Task.names().index(name) * 1_000_000), Counter(), planar=name.startswith("planar"))
    for place, (seed, document) in enumerate(islice(drawn, bodies)):
        way = INERT[place % len(INERT)]
        evaluation = evaluate(Genome(still(document, way)), task, seeds=[task.seeds[seed % len(task.seeds)]])
        (result,) = evaluation.results or [None]
        if result is None:
            assert evaluation.error
            outcomes["refused"] += 1
        elif result.score is None:
            assert result.fault
            outcomes[result.fault.partition(":")[0]] += 1
        else:
            assert result.score == 0.0, f"body {seed}, {way}: {result}"
            outcomes["ran"] += 1
    record_property(f"{name}: inert bodies", dict(outcomes))
    assert outcomes["ran"] >= bodies // 3, f"too few ran for this to say much: {outcomes}"
