"""A run of evolution from the command line: gone on with until its budget is spent, or somebody stops it."""

from __future__ import annotations

import shlex
import sys
import time
from collections import Counter, deque
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from nmes.cli._json import print_json
from nmes.cli._pool import advance_in_pool
from nmes.cli._progress import progress_bars
from nmes.cli._tasks import borrowed_names
from nmes.errors import visible

if TYPE_CHECKING:
    from nmes.evaluation.parallel import Cluster, Workers
    from nmes.evolution.run import Run
    from nmes.evolution.run_index import Record

__all__ = ["JSON", "go_on", "tell"]

_SHOWN: Final = 50  # candidates of the log after which the progress is shown again
_RECENT: Final = 100  # candidates of which the progress tells the mean and the diversity

JSON = click.option("--json", "as_json", is_flag=True, help="End with an object with digest and best.")


def go_on(find: Callable[[], Run], jobs: int | None, ray: str | None, as_json: bool) -> None:
    """Goes on with a run, says how it came out, and ends the program: status 1 where it was interrupted.

    Args:
        find: Returns the run, which it may begin: where there are no processes and no cluster, none is begun.
        jobs: As `open_pool`.
        ray: As `open_pool`.
        as_json: Whether to end with JSON.
    """
    run, interrupted = advance_in_pool(find, jobs, ray, _advance)
    budget = run.settings.budget
    run = type(run).open(run.folder)  # wherever it was interrupted, this is what is there
    stopped = interrupted and len(run) < budget
    if stopped:
        click.echo(visible(f"stopped: {len(run):,} of {budget:,} done"), err=True)
        more = "" if run.settings.budget == budget else f" --budget {budget}"  # that was not kept yet
        click.echo(visible(f"go on with: nmes evolve resume {shlex.quote(str(run.folder))}{more}"), err=True)
    tell(run, as_json)
    sys.exit(1 if stopped else 0)


def _advance(run: Run, pool: Workers | Cluster, interrupted: Callable[[], bool]) -> None:
    recent = deque(run.records[-_RECENT:], _RECENT)
    best = run.best
    begin, first = time.monotonic(), len(run)
    total = run.settings.budget
    with progress_bars() as progress:

        def tell_log(done: int, known: int) -> None:
            nonlocal begin
            begin = time.monotonic()
            if done % _SHOWN == 0 or done == known:
                progress("reading the log", done, known)
            if interrupted():
                raise KeyboardInterrupt

        if not first:
            progress("evolving", first, total)
        for record in run.advance(pool, tell_log):
            recent.append(record)
            if record.score is not None and (best is None or record.score > (best.score or 0.0)):
                best = record
            rate = (record.index + 1 - first) / max(1e-9, time.monotonic() - begin)
            note = _populations_note(recent) if run.settings.populations else _note(recent, best)
            progress("evolving", record.index + 1, total, f"{note}, {rate:.1f}/s")
            if interrupted():
                raise KeyboardInterrupt


def _note(recent: deque[Record], best: Record | None) -> str:
    """Returns best score, mean of the recent ones, and how many of these have bodies of different plans."""
    scores = [record.score for record in recent if record.score is not None]
    plans = len({record.plan for record in recent})
    mean = f"{sum(scores) / len(scores):.4g}" if scores else "none"
    return f"best {'none' if best is None else f'{best.score:.4g}'}, mean {mean}, diversity {plans / len(recent):.0%}"


def _populations_note(recent: deque[Record]) -> str:
    """Returns the mean of the recent scores of each population."""
    scores: dict[str, list[float]] = {}
    for record in recent:
        scores.setdefault(record.group, []).extend([] if record.score is None else [record.score])
    means = [f"{role} {sum(each) / len(each):.4g}" if each else f"{role} none" for role, each in sorted(scores.items())]
    return f"mean of {', '.join(means)}"


def tell(run: Run, as_json: bool) -> None:
    """Prints how a run has come out so far."""
    best = run.best
    if as_json:
        print_json(_summary(run))
        return
    click.echo(visible(f"{run.folder}: {len(run):,} of {run.settings.budget:,} candidates"))
    if best is not None:
        click.echo(visible(f"best: {best.score:.6g}, candidate {best.index} ({best.genome})"))
    for role, champion in run.champions().items():
        click.echo(visible(f"champion of {role}: candidate {champion.index} ({champion.genome}), {champion.score:.6g}"))
    if run.records and _without_score(run) == len(run):
        click.echo(visible(f"no candidate has a score: {_reason(run)}"))
    for line in borrowed_names({run.settings.task.hash: run.settings.task.name}):
        click.echo(line)
    click.echo(f"digest: {run.digest}")


def _without_score(run: Run) -> int:
    return len([record for record in run.records if record.score is None])


def _reason(run: Run) -> str:
    """Returns why most candidates have no score, as the first of them says it, and how many these are."""
    reasons = [record.error or "" for record in run.records]
    kinds = [reason.partition(":")[0] for reason in reasons]  # a reason goes on with figures of its candidate
    [(kind, count)] = Counter(kinds).most_common(1)
    return f"{reasons[kinds.index(kind)]} ({count:,} of {len(run):,} are like this)"


def _summary(run: Run) -> dict[str, Any]:
    named = ("index", "score", "genome", "genome_hash", "operator", "generation")

    def told(record: Record) -> dict[str, Any]:
        return {name: getattr(record, name) for name in named}

    champions = {role: told(champion) for role, champion in run.champions().items()}
    return {
        "run": str(Path(run.folder)),
        "told": len(run),
        "budget": run.settings.budget,
        "finished": run.finished,
        "without_score": _without_score(run),
        "elites": len(run.elites()),
        "figures": dict(run.figures()),
        "best": None if run.best is None else told(run.best),
        **({"champions": champions} if run.settings.populations else {}),
        "digest": run.digest,
    }
