"""Runs in folders whose candidates were made up instead of bred; their evaluations are made up too, or real."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import orjson

from nmes.evaluation import Evaluation, Task, evaluate
from nmes.evaluation.judge import Result
from nmes.evolution import Draw, mutate
from nmes.evolution.run import Run
from nmes.evolution.run_index import RunIndex, State
from nmes.evolution.run_log import RunLog, RunWriter
from nmes.evolution.run_settings import RunSettings
from nmes.genome import Genome

__all__ = ["SHORT", "candidates", "genomes", "make_run", "real"]

SHORT = {**Task.load("walk").document, "name": "short-walk", "duration": 0.3, "seeds": [1, 2]}
"""A task of a moment, with two seeds."""
_OPERATORS = ("weights", "oscillators", "add-part", "cross+joint")


@cache
def genomes() -> tuple[Genome, ...]:
    """Returns some different creatures that walk, as a run would breed them."""
    starts = [Genome.load(name) for name in ("inchworm", "lurcher", "walker")]
    return tuple(mutate(starts[index % 3], Draw(index, "made up")).genome for index in range(12))


def candidates(count: int, *, objectives: int = 0, measures: int = 0, groups: int = 0) -> list[dict[str, Any]]:
    """Returns records as logs have them, with made-up scores that mostly rise; some have none."""
    draw, records = Random(count), []
    for index in range(count):
        scored = index % 17 != 3
        parents = () if index < 5 else (index - draw.randint(1, 5), draw.randint(0, index - 1))
        operator = "random" if not parents else _OPERATORS[draw.randrange(4)]
        score = index / count + draw.gauss(0.0, 0.2) if scored else None
        records.append(
            {
                "operator": operator,
                "parents": list(parents[: 2 if operator.startswith("cross") else 1]),
                "generation": index // 50,
                "group": f"species {min(index * groups // count, groups - 1)}" if groups else "",
                "results": [Result(1, score, 10.0, 0.5, 18, None, None if scored else "restless: it rocks").to_json()],
                "error": None,
                "score": score,
                "objectives": [draw.random() for _ in range(objectives)] if scored else [],
                "measures": [draw.random() for _ in range(measures)] if scored else [],
            }
        )
    return records


def real(genome: Genome, task: Task) -> dict[str, Any]:
    """Returns a record of a genome that was really evaluated."""
    found: Evaluation = evaluate(genome, task)
    return {
        "operator": "random",
        "parents": [],
        "generation": 0,
        "group": "",
        "genome": genome.document,
        "genome_hash": genome.hash,
        "results": [result.to_json() for result in found.results],
        "error": found.error,
        "score": found.score,
        "objectives": [],
        "measures": [],
    }


def make_run(
    folder: Path,
    records: Sequence[dict[str, Any]],
    *,
    elites: Sequence[int] = (),
    fingerprint: Any = None,
    task: Any = None,
    **settings: Any,
) -> Run:
    """Writes a run and opens it.

    Args:
        folder: Its folder.
        records: Of its candidates; those without a genome get one.
        elites: The indices of the algorithm's elites.
        fingerprint: Of what has computed it; None: of nothing that is known.
        task: The task's document; None: `SHORT`.
        settings: Others than the budget's 1,000, the algorithm `random`, and so on.
    """
    document = {"format": "nmes-run/1", "task": task or SHORT, "algorithm": "random", "budget": 1000, **settings}
    begun = RunSettings.reopen(document)
    folder.mkdir(parents=True)
    (folder / "run.json").write_bytes(orjson.dumps({**begun.document, "fingerprint": fingerprint or {}}))
    pool = genomes()
    whole = [
        {"genome": (genome := pool[index % len(pool)]).document, "genome_hash": genome.hash, **record, "index": index}
        for index, record in enumerate(records)
    ]
    writer = RunWriter(RunLog(folder / "log.jsonl", begun.hash))
    writer.append(whole)
    writer.close()
    run = Run.open(folder)
    index = RunIndex(folder / "index.sqlite").write(anew=True)
    index.put(run.records, State(len(run), tuple(elites), {"coverage": 0.25}))
    index.close()
    return Run.open(folder)
