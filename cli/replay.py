"""`nmes replay`: run a recording again and compare."""

from __future__ import annotations

import sys

import click
import orjson
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from nmes.cli.info import open_recording
from nmes.recording import Recording
from nmes.replay import Divergence, ReplayReport, replay

__all__ = ["command"]

_LONG = 1 << 20  # bytes of recording from which on it is worth showing how far it is


@click.command("replay")
@click.argument("recording", metavar="FILE", callback=open_recording)
@click.option("--anyway", is_flag=True, help="Run it also where engine or machine differ, to see how far it agrees.")
@click.option("--json", "as_json", is_flag=True, help="Print the report as JSON.")
def command(recording: Recording, anyway: bool, as_json: bool) -> None:
    """Run a recording again and compare.

    The recorded commands and ticks are fed to a fresh world, and every tick's digest and every reply is compared with
    what was recorded. Prints the verdict, or the first difference.

    Exit status: 0 reproduced, 1 diverged or not comparable, 2 wrong usage or an unreadable file (for a damaged file,
    after replaying what comes before the damage).
    """
    report = _replay(recording, anyway)
    if as_json:
        click.echo(orjson.dumps(report.to_json(), option=orjson.OPT_INDENT_2))
    else:
        for line in _lines(report):
            click.echo(line)
    if report.damage is not None and not report.cut:
        sys.exit(2)
    sys.exit(0 if report.verdict == "reproduced" else 1)


def _replay(recording: Recording, anyway: bool) -> ReplayReport:
    console = Console(stderr=True)
    columns = (TextColumn("replaying"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    shown = console.is_terminal and recording.size > _LONG
    with Progress(*columns, console=console, transient=True, disable=not shown) as progress:
        task = progress.add_task("", total=recording.size)
        return replay(recording, anyway=anyway, progress=lambda done, _: progress.update(task, completed=done))


def _lines(report: ReplayReport) -> list[str]:
    amount = f"{report.ticks:,} ticks, {report.commands:,} commands"
    speed = f"{report.speed:,.0f} times faster than real time" if report.ticks else "no simulation time"
    if report.verdict == "not_comparable":
        lines = ["not comparable: it was recorded with another"]
        for name, (recorded, here) in report.differences.items():
            lines.append(f"  {name}: {recorded or 'none'} (here: {here or 'none'})")
        if report.wall_seconds:
            how_far = "as far as" if report.divergence else "all the same:"
            lines.append(f"run anyway, it agrees {how_far} {amount}")
    elif report.divergence is None:
        lines = [f"reproduced: {amount}, {speed}"]
    else:
        lines = [f"diverged at frame {report.divergence.frame}, after {amount}"]
    if report.divergence is not None:
        lines += _divergence_lines(report.divergence)
    if report.damage is not None:
        lines.append(f"{'incomplete' if report.cut else 'DAMAGED'}: {report.damage}")
    return lines


def _divergence_lines(divergence: Divergence) -> list[str]:
    lines = [f"  {divergence.message} (record {divergence.record})"]
    value = divergence.value
    if value is None:
        lines.append("  no recorded reply or pose shows the difference")
        return lines
    where = f"cube {value.cube}: " if value.cube is not None else ""
    if divergence.seen != divergence.frame:
        where = f"at frame {divergence.seen}, {where}"
    by = f" (differs by {value.amount:.6g})" if value.amount is not None else ""
    recorded, now = _short(value.expected), _short(value.actual)
    lines.append(f"  {where}{value.field or 'reply'}: recorded {recorded}, now {now}{by}")
    return lines


def _short(value: object) -> str:
    text = orjson.dumps(value).decode()
    return text if len(text) <= 200 else f"{text[:200]}..."
