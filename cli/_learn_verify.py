"""`nmes learn verify`: prove a run of learning."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path

import click

from nmes.cli._json import print_json
from nmes.cli._learn_run import THREADS, cores
from nmes.cli._progress import QUIET, progress_bars
from nmes.cli._sample import SEED, drawn_by
from nmes.cli._tasks import borrowed_names
from nmes.errors import visible

__all__ = ["command"]

_STATUS = {"holds": 0, "broken": 1, "not_comparable": 3}


@click.command("verify")
@click.argument("folder", metavar="RUN", type=click.Path(path_type=Path))
@click.option(
    "--sample", metavar="N", type=click.IntRange(0), default=3, show_default=True, help="How many beside the best leg."
)
@click.option("--all", "everything", is_flag=True, help="Do all of it again, from the beginning.")
@SEED
@THREADS
@click.option("--json", "as_json", is_flag=True, help="Print the verdict as JSON.")
@QUIET
def command(folder: Path, sample: int, everything: bool, seed: int | None, threads: int | None, as_json: bool) -> None:
    """Prove a run of learning: what its log says comes out again.

    The log's chain of digests is followed. The best leg, the last, the first and others, drawn anew each time, are done
    again, each with all since the last state that the run kept: every figure, and all that the learner knows after it,
    must be the same to the last bit. One false leg is enough to put in a brain from elsewhere: --all does every one.

    Exit status: 0 it holds, 1 it is broken, 2 wrong usage, 3 it does not come out the same here, where other numbers
    come out than where it was begun.

    For example:

    \b
        nmes learn verify runs/walk-ppo-0
        nmes learn verify runs/walk-ppo-0 --all --threads 2
    """
    from nmes.evolution.run_folder import open_run
    from nmes.learning.run_verify import verify_learning
    from nmes.learning.settings import FORMAT, LearningSettings

    with progress_bars() as progress:
        found = verify_learning(folder, cores(threads), None if everything else sample, progress, seed)
    if as_json:
        print_json(asdict(found))
    else:
        words = {"holds": "holds", "broken": "broken", "not_comparable": "not comparable here"}[found.verdict]
        for finding in found.findings:
            click.echo(visible(finding))
        # Not of the run, which does not open where its log is damaged.
        task = open_run(folder, FORMAT, lambda _, document: LearningSettings.reopen(document)).task
        for line in borrowed_names({task.hash: task.name}):
            click.echo(line)
        again = f"{found.again:,} of {found.legs:,} legs done again"
        click.echo(f"{words}: {again}{drawn_by(found.seed, found.again, found.legs)}")
        click.echo(f"digest: {found.digest}")
    sys.exit(_STATUS[found.verdict])
