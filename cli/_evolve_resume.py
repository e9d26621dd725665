"""`nmes evolve resume`: go on with a run."""

from __future__ import annotations

from pathlib import Path

import click

from nmes.cli._evolve_run import JSON, go_on, tell
from nmes.cli._pool import JOBS, RAY, check_pool
from nmes.cli._progress import QUIET

__all__ = ["command"]


@click.command("resume")
@click.argument("folder", metavar="RUN", type=click.Path(path_type=Path))
@click.option("--budget", metavar="N", type=click.IntRange(1, 10**9), help="Of candidates, another than the run has.")
@JOBS
@RAY
@JSON
@QUIET
def command(folder: Path, budget: int | None, jobs: int | None, ray: str | None, as_json: bool) -> None:
    """Go on with a run that was interrupted, or give a run a greater budget.

    It comes out as if it had never been interrupted: the digest is the same. What was told before is read from the log
    and not evaluated again. A run that is finished stays as it is.

    Exit status: 0 the budget is spent, 1 it was interrupted again, 2 wrong usage, 3 other numbers would come out here.

    For example:

    \b
        nmes evolve resume runs/walk-ga-0
        nmes evolve resume runs/walk-ga-0 --budget 5000
    """
    from nmes.evolution.run import Run

    check_pool(jobs, ray)
    run = Run.open(folder)
    if budget is not None and budget != run.settings.budget:
        run.extend(budget)
    elif run.finished and (run.up_to_date or run.differences()):  # else the index is brought up to date
        click.echo("the run is finished", err=True)
        tell(run, as_json)
        return
    go_on(lambda: run, jobs, ray, as_json)
