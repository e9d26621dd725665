"""Evaluations on standard output: as a table, as JSON, as CSV."""

from __future__ import annotations

import csv
import sys
from collections import Counter
from collections.abc import Sequence

import click
import orjson
from rich.console import Console
from rich.table import Table

from nmes.evaluation import Evaluation

__all__ = ["print_csv", "print_json", "print_table"]

_CSV = (
    "genome",
    "genome_hash",
    "task",
    "task_hash",
    "score",
    "spread",
    "energy",
    "distance",
    "faults",
    "error",
    "wall_seconds",
)


def print_json(evaluations: Sequence[Evaluation]) -> None:
    """Prints evaluations as a JSON list."""
    click.echo(orjson.dumps([each.to_json() for each in evaluations], option=orjson.OPT_INDENT_2))


def print_csv(evaluations: Sequence[Evaluation]) -> None:
    """Prints evaluations as CSV, a line each."""
    writer = csv.DictWriter(sys.stdout, _CSV, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(each.to_json() for each in evaluations)


def print_table(evaluations: Sequence[Evaluation]) -> None:
    """Prints evaluations as a table, and below it why creatures or episodes have no score."""
    console = Console(markup=False, highlight=False)
    console.print(_table(evaluations))
    if any(each.error is not None or each.faults for each in evaluations):
        console.print()
    for each in evaluations:
        if each.error is not None:
            reason = each.error.replace("\n", "\n  ")
            console.print(f"{each.genome}: {reason}", soft_wrap=True)
        for result in each.results:
            if result.fault is not None:
                console.print(f"{each.genome}, seed {result.seed}, tick {result.ticks}: {result.fault}", soft_wrap=True)


def _table(evaluations: Sequence[Evaluation]) -> Table:
    table = Table("genome", "task", box=None, pad_edge=False)
    table.columns[0].overflow = "fold"
    for title in ("seeds", "score", "spread", "energy\n(J)", "distance\n(m)", "faults", "time\n(s)"):
        table.add_column(title, justify="right", no_wrap=True)
    names = Counter(each.genome for each in evaluations)
    for each in evaluations:
        ambiguous = names[each.genome] > 1 and each.genome_hash
        table.add_row(
            f"{each.genome} {each.genome_hash[:4]}" if ambiguous else each.genome,
            each.task,
            _runs([result.seed for result in each.results]),
            _number(each.score, 3),
            _number(each.spread, 3),
            _number(each.energy, 1),
            _number(each.distance, 2),
            "" if each.error else str(each.faults),
            f"{each.wall_seconds:.2f}",
        )
    return table


def _runs(seeds: Sequence[int]) -> str:
    """Writes seeds as `--seeds` reads them: `1-3,7`."""
    runs: list[list[int]] = []
    for seed in sorted(seeds):
        if runs and seed == runs[-1][-1] + 1:
            runs[-1].append(seed)
        else:
            runs.append([seed])
    return ",".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else str(run[0]) for run in runs)


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
