"""`nmes study`: run a study, write its report, prove it."""

from __future__ import annotations

import os
import shlex
import signal
import sys
from collections.abc import Mapping
from dataclasses import asdict

import click

from nmes.cli._interruptions import interruptions
from nmes.cli._json import print_json
from nmes.cli._progress import QUIET, progress_bars
from nmes.cli._sample import SEED, drawn_by
from nmes.errors import visible

__all__ = ["command"]

_STATUS = {"holds": 0, "broken": 1, "not_comparable": 3}
_WORDS = {"holds": "holds", "broken": "broken", "not_comparable": "not comparable here"}
_NAME = click.argument("name", metavar="STUDY", type=click.Path())
_BUDGET = click.option(
    "--budget", type=click.Choice(["small", "full"]), default="small", show_default=True, help="How much is run."
)
_JOBS = click.option("--jobs", type=click.IntRange(1), help="How many runs at once.  [default: one a core]")


@click.group("study")
def command() -> None:
    """Test claims in studies that anyone can repeat."""


@command.command("run")
@_NAME
@_BUDGET
@_JOBS
@QUIET
def run(name: str, budget: str, jobs: int | None) -> None:
    """Do all runs of a study, and write its results and its report.

    STUDY is its folder, or the name of one in `studies`. Runs that were done before, of this very study, are not done
    again: Ctrl-C or a kill costs those that were under way. The results are the same for any number of processes.

    A study runs commands that its study.toml names: run those of people whom you trust.

    Exit status: 0 all is done, 1 it was interrupted or a command failed, 2 wrong usage.

    For example:

    \b
        nmes study run determinism
        nmes study run studies/upright --budget full --jobs 8
    """
    from nmes.study import Study, run_study, write_report
    from nmes.study.run import count_done

    plan = Study.load(name).plan(budget)
    with interruptions(signal.SIGINT, signal.SIGTERM) as interrupted:
        try:
            with progress_bars() as progress:

                def tell(done: int, total: int) -> None:
                    progress("running", done, total)
                    if interrupted():
                        raise KeyboardInterrupt

                run_study(plan, jobs or os.cpu_count() or 1, tell)
        except KeyboardInterrupt:
            click.echo(f"stopped: {count_done(plan):,} of {len(plan.runs):,} runs done", err=True)
            click.echo(visible(f"go on with: nmes study run {shlex.quote(name)} --budget {budget}"), err=True)
            sys.exit(1)
    _tell(write_report(plan))
    click.echo(visible(f"wrote {plan.folder}"))


@command.command("report")
@_NAME
@_BUDGET
def report(name: str, budget: str) -> None:
    """Write the report of a study anew, from the results that are there.

    STUDY is its folder, or the name of one in `studies`. This is for whoever has changed the discussion.

    For example:

    \b
        nmes study report determinism
    """
    from nmes.study import Study, write_report

    plan = Study.load(name).plan(budget)
    _tell(write_report(plan))
    click.echo(visible(f"wrote {plan.folder}"))


@command.command("verify")
@_NAME
@_BUDGET
@click.option("--sample", metavar="N", type=click.IntRange(0), default=3, show_default=True, help="How many runs.")
@click.option("--all", "everything", is_flag=True, help="Do all runs again.")
@SEED
@_JOBS
@click.option("--json", "as_json", is_flag=True, help="Print the verdict as JSON.")
@QUIET
def verify(
    name: str, budget: str, sample: int, everything: bool, seed: int | None, jobs: int | None, as_json: bool
) -> None:
    """Prove a study: its report says what its results say, and its runs come out again.

    STUDY is its folder, or the name of one in `studies`. The report and its figures are made again, and must have the
    same bytes. Some runs, drawn anew each time, are done again: every column must be the same to the last bit. Arms and
    columns in which clocks have a part are not judged, and it is told which these are; with --all these runs are done
    again too, and every claim must get the same verdict by what comes of it.

    Exit status: 0 it holds, 1 it is broken, 2 wrong usage, 3 runs do not come out the same here, where other numbers
    come out than where the results were made or an ONNX brain may round otherwise, or what is measured here leads to
    another verdict.

    For example:

    \b
        nmes study verify determinism
        nmes study verify codesign --budget full --all
    """
    from nmes.study import Study, verify_study

    plan = Study.load(name).plan(budget)
    with interruptions(signal.SIGINT, signal.SIGTERM) as interrupted, progress_bars() as progress:

        def tell(done: int, total: int) -> None:
            progress("verifying", done, total)
            if interrupted():
                raise KeyboardInterrupt

        found = verify_study(plan, None if everything else sample, jobs or os.cpu_count() or 1, tell, seed)
    if as_json:
        print_json(asdict(found))
    else:
        for finding in found.findings:
            click.echo(visible(finding))
        _tell(found.verdicts)
        again = f"{found.again:,} of {found.runs:,} runs done again{drawn_by(found.seed, found.again, found.runs)}"
        click.echo(f"{_WORDS[found.verdict]}: {again}")
        if found.measured:
            click.echo(f"not judged: {found.measured:,} runs in which clocks have a part")
        if found.not_judged:
            click.echo(f"not judged: columns in which clocks have a part ({', '.join(found.not_judged)})")
        click.echo(f"digest: {found.digest}")
    sys.exit(_STATUS[found.verdict])


def _tell(verdicts: Mapping[str, str]) -> None:
    """Prints the verdict on each claim."""
    for claim, verdict in verdicts.items():
        click.echo(visible(f"{claim}: {verdict}"))
