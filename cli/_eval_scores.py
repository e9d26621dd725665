"""Evaluations on standard output: as a table, as JSON, as CSV."""

from __future__ import annotations

import csv
import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from nmes.cli._json import print_json
from nmes.cli._tasks import borrowed_names
from nmes.errors import visible
from nmes.evaluation import Evaluation

if TYPE_CHECKING:
    from rich.table import Table

__all__ = ["format_seeds", "print_csv", "print_results", "print_table"]

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
_WIDE = 1e9  # beyond which a number is written with its power of ten, so that the table stays one


def print_results(evaluations: Sequence[Evaluation]) -> None:
    """Prints evaluations as a JSON list."""
    print_json([each.to_json() for each in evaluations])


def print_csv(evaluations: Sequence[Evaluation]) -> None:
    """Prints evaluations as CSV, a line each."""
    writer = csv.DictWriter(sys.stdout, _CSV, lineterminator="\n")
    writer.writeheader()
    for each in evaluations:
        row = each.to_json()
        writer.writerow({name: visible(row[name]) if isinstance(row[name], str) else row[name] for name in _CSV})


def print_table(evaluations: Sequence[Evaluation]) -> None:
    """Prints evaluations as a table; below it which tasks have borrowed names, and why there is no score."""
    from rich.console import Console

    console = Console(markup=False, highlight=False)
    console.print(_table(evaluations))
    borrowed = borrowed_names({each.task_hash: each.task for each in evaluations})
    if borrowed or any(each.error is not None or each.faults for each in evaluations):
        console.print()
    for line in borrowed:
        console.print(line, soft_wrap=True)
    for each in evaluations:
        if each.error is not None:
            reason = visible(each.error, keep="\n").replace("\n", "\n  ")
            console.print(f"{visible(each.genome)}: {reason}", soft_wrap=True)
        for role, result in zip(each.roles or [""] * len(each.results), each.results, strict=True):
            if result.fault is not None:
                place = f"{each.genome}{role and f' as {role}'}, seed {result.seed}, tick {result.ticks}"
                console.print(visible(f"{place}: {result.fault}"), soft_wrap=True)


def _table(evaluations: Sequence[Evaluation]) -> Table:
    from rich.table import Table

    table = Table("genome", "task", box=None, pad_edge=False)
    table.columns[0].overflow = "fold"
    with_roles = any(each.roles for each in evaluations)
    if with_roles:
        table.add_column("role")
    for title in ("seeds", "score", "spread", "energy\n(J)", "distance\n(m)", "faults", "time\n(s)"):
        table.add_column(title, justify="right", no_wrap=True)
    names = Counter(each.genome for each in evaluations)
    for each in evaluations:
        name, ambiguous = visible(each.genome), names[each.genome] > 1 and each.genome_hash
        table.add_row(
            f"{name}\n{each.genome_hash[:16]}" if ambiguous else name,
            each.task,
            *([", ".join(sorted({*each.roles}))] if with_roles else []),
            format_seeds({result.seed for result in each.results}),
            _number(each.score, 3),
            _number(each.spread, 3),
            _number(each.energy, 1),
            _number(each.distance, 2),
            "" if each.error else str(each.faults),
            f"{each.wall_seconds:.2f}",
        )
    return table


def format_seeds(seeds: Iterable[int]) -> str:
    """Writes seeds as `--seeds` reads them: `1-3,7`."""
    runs: list[list[int]] = []
    for seed in sorted(seeds):
        if runs and seed == runs[-1][-1] + 1:
            runs[-1].append(seed)
        else:
            runs.append([seed])
    return ",".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else str(run[0]) for run in runs)


def _number(value: float | None, digits: int) -> str:
    if value is None:
        return "-"
    return f"{value:.{digits}f}" if abs(value) < _WIDE else f"{value:.4g}"
