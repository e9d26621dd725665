"""`nmes evolve verify`: prove a run."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path

import click

from nmes.cli._json import print_json
from nmes.cli._pool import JOBS, RAY, check_pool, open_pool
from nmes.cli._progress import QUIET, progress_bars
from nmes.cli._sample import SEED, drawn_by
from nmes.cli._tasks import borrowed_names
from nmes.errors import visible

__all__ = ["command"]

_STATUS = {"holds": 0, "broken": 1, "not_comparable": 3}


@click.command("verify")
@click.argument("folder", metavar="RUN", type=click.Path(path_type=Path))
@click.option(
    "--sample",
    metavar="N",
    type=click.IntRange(0),
    default=100,
    show_default=True,
    help="How many beside the elites and the best.",
)
@click.option("--all", "everything", is_flag=True, help="Evaluate all candidates again.")
@SEED
@JOBS
@RAY
@click.option("--json", "as_json", is_flag=True, help="Print the verdict as JSON.")
@QUIET
def command(
    folder: Path, sample: int, everything: bool, seed: int | None, jobs: int | None, ray: str | None, as_json: bool
) -> None:
    """Prove a run: what its log says comes out again.

    The log's chain of digests is followed; the algorithm is told the log again and must ask for the same candidates;
    the elites, the best and others, drawn anew each time, are evaluated again, and every figure must be the same to the
    last bit.

    Exit status: 0 it holds, 1 it is broken, 2 wrong usage, 3 it does not come out the same here, where other numbers
    come out than where it was begun, or an ONNX brain may round otherwise.

    For example:

    \b
        nmes evolve verify runs/walk-ga-0
        nmes evolve verify runs/walk-ga-0 --all --jobs 4
    """
    from nmes.evolution.run_folder import open_run
    from nmes.evolution.run_settings import FORMAT, RunSettings
    from nmes.evolution.run_verify import verify_run

    check_pool(jobs, ray)
    with progress_bars() as progress, open_pool(jobs, ray) as pool:
        found = verify_run(folder, pool, None if everything else sample, progress, seed)
    if as_json:
        print_json(asdict(found))
    else:
        words = {"holds": "holds", "broken": "broken", "not_comparable": "not comparable here"}[found.verdict]
        for finding in found.findings:
            click.echo(visible(finding))
        # Not of the run, which does not open where its log is damaged.
        task = open_run(folder, FORMAT, lambda _, document: RunSettings.reopen(document)).task
        for line in borrowed_names({task.hash: task.name}):
            click.echo(line)
        again = f"{found.asked:,} of {found.told:,} candidates asked for again, {found.evaluated:,} evaluated again"
        click.echo(f"{words}: {again}{drawn_by(found.seed, found.evaluated, found.told)}")
        click.echo(f"digest: {found.digest}")
    sys.exit(_STATUS[found.verdict])
