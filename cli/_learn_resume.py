"""`nmes learn resume`: go on with a run of learning."""

from __future__ import annotations

from pathlib import Path

import click

from nmes.cli._learn_run import JSON, THREADS, go_on, tell
from nmes.cli._progress import QUIET

__all__ = ["command"]


@click.command("resume")
@click.argument("folder", metavar="RUN", type=click.Path(path_type=Path))
@THREADS
@JSON
@QUIET
def command(folder: Path, threads: int | None, as_json: bool) -> None:
    """Go on with a run of learning that was interrupted.

    It comes out as if it had never been interrupted: the digest is the same. It begins at the last state that was kept.
    Where genome.json was lost, it is written anew.

    Exit status: 0 all steps are done, 1 it was interrupted again, 2 wrong usage, 3 other numbers would come out here.

    For example:

    \b
        nmes learn resume runs/walk-ppo-0
        nmes learn resume runs/walk-ppo-0 --threads 2
    """
    from nmes.learning.run import LearningRun

    run = LearningRun.open(folder)
    if run.finished and (run.best is None or run.has_genome()):
        click.echo("the run is finished", err=True)
        tell(run, as_json)
        return
    go_on(run, threads, as_json)
