"""A run of learning from the command line: gone on with until all steps are done, or somebody stops it."""

from __future__ import annotations

import os
import shlex
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from nmes.cli._interruptions import interruptions
from nmes.cli._json import print_json
from nmes.cli._progress import progress_bars
from nmes.cli._tasks import borrowed_names
from nmes.errors import visible

if TYPE_CHECKING:
    from nmes.learning.run import LearningRun, Leg

__all__ = ["JSON", "THREADS", "cores", "go_on", "tell"]

THREADS = click.option(
    "--threads", type=click.IntRange(1, 1024), help="How many step the engine.  [default: one a core]"
)
JSON = click.option("--json", "as_json", is_flag=True, help="End with an object with digest and best.")


def cores(threads: int | None) -> int:
    """Returns how many threads an option means."""
    return threads or os.cpu_count() or 1


def go_on(run: LearningRun, threads: int | None, as_json: bool) -> None:
    """Goes on with a run, says how it came out, and ends the program: status 1 where it was interrupted."""
    with interruptions(signal.SIGINT, signal.SIGTERM) as interrupted:
        try:
            _advance(run, cores(threads), interrupted)
        except KeyboardInterrupt:
            pass
    run = type(run).open(run.folder)  # wherever it was interrupted, this is what is there
    stopped = interrupted() and not run.finished
    if stopped:
        click.echo(visible(f"stopped: {run.progress} steps done"), err=True)
        click.echo(visible(f"go on with: nmes learn resume {shlex.quote(str(run.folder))}"), err=True)
    tell(run, as_json)
    sys.exit(1 if stopped else 0)


def _advance(run: LearningRun, threads: int, interrupted: Callable[[], bool]) -> None:
    begin, first = time.monotonic(), run.steps
    total = run.settings.steps
    with progress_bars() as progress:
        progress("learning", first, total)
        for leg in run.advance(threads):
            rate = (leg.steps - first) / max(1e-9, time.monotonic() - begin)
            progress("learning", min(leg.steps, total), total, f"{_note(leg, run.best)}, {rate:,.0f} steps/s")
            if interrupted():
                raise KeyboardInterrupt


def _note(leg: Leg, best: Leg | None) -> str:
    """Returns the best score and the mean return of the last leg."""
    score = "none" if best is None else f"{best.score:.4g}"
    return f"best {score}" + ("" if leg.returned is None else f", return {leg.returned:.4g}")


def tell(run: LearningRun, as_json: bool) -> None:
    """Prints how a run has come out so far."""
    best = run.best
    if as_json:
        print_json(_summary(run))
        return
    legs = "1 leg" if len(run.legs) == 1 else f"{len(run.legs):,} legs"
    click.echo(visible(f"{run.folder}: {run.progress} steps in {legs}"))
    if best is not None:
        click.echo(visible(f"best: {best.score:.6g}, after leg {best.leg}: {run.folder / 'genome.json'}"))
    for line in borrowed_names({run.settings.task.hash: run.settings.task.name}):
        click.echo(line)
    click.echo(f"digest: {run.digest}")


def _summary(run: LearningRun) -> dict[str, Any]:
    best = run.best
    named = ("leg", "steps", "score", "genome_hash")
    return {
        "run": str(Path(run.folder)),
        "steps": run.steps,
        "legs": len(run.legs),
        "finished": run.finished,
        "best": None if best is None else {name: best.content[name] for name in named},
        "genome": None if best is None else str(run.folder / "genome.json"),
        "digest": run.digest,
    }
