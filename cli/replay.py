"""`nmes replay`: run a recording again and compare."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import click
import orjson
from rich.console import Console

from nmes.cli import _against
from nmes.cli._address import split_address
from nmes.cli._connection import connection_options, connector
from nmes.cli._drift import plot, show
from nmes.cli._progress import progress_bars
from nmes.cli.info import open_recording
from nmes.errors import NmesError, RecordingError
from nmes.playback.compare import Divergence, ReplayReport, replay
from nmes.playback.drift import measure_drift
from nmes.playback.log import Log, LogReport, replay_log
from nmes.playback.remote import replay_remotely
from nmes.recording import Recording

__all__ = ["command"]

_LONG = 1 << 20  # bytes of recording from which on it is worth showing how far it is


def _open(context: click.Context, parameter: click.Parameter, value: str) -> Recording | Log:
    """Opens the file that an argument names: a recording, or a log, which begins as JSON does."""
    try:
        # Opening a pipe or a device could wait for ever.
        with open(value if Path(value).is_file() else os.devnull, "rb") as file:
            begins = file.read(64).lstrip()
        return Log(value) if begins.startswith(b"{") else open_recording(context, parameter, value)
    except OSError as error:
        raise click.BadParameter(f"cannot read {value}: {error.strerror}", param=parameter) from error
    except RecordingError as error:
        raise click.BadParameter(error.message, param=parameter) from error


@click.command("replay")
@click.argument("recording", metavar="FILE", callback=_open)
@click.option("--backend", metavar="NAME", help="Run it on this engine instead, and show how far each cube drifts.")
@click.option("--plot", "plot_to", type=click.Path(dir_okay=False, path_type=Path), help="Write the drift to an SVG.")
@click.option("--from", "first", type=click.IntRange(0), help="Begin at the last keyframe before this frame.")
@click.option("--to", "last", type=click.IntRange(0), help="End at this frame.")
@click.option("--anyway", is_flag=True, help="Run it also where engine or machine differ, and measure the drift.")
@click.option("--against", metavar="HOST:PORT", callback=split_address, help="Play it to this server, and compare.")
@click.option("--world", metavar="NAME", help="With --against: which of the server's worlds; the first if left out.")
@click.option(
    "--tolerance",
    type=click.FloatRange(min=0),
    help="With --against: by how much numbers may differ, of larger ones than 1 relatively.  [default: 1e-6]",
)
@connection_options
@click.option("--json", "as_json", is_flag=True, help="Print the report as JSON.")
def command(
    recording: Recording | Log,
    backend: str | None,
    plot_to: Path | None,
    first: int | None,
    last: int | None,
    anyway: bool,
    against: tuple[str, int] | None,
    world: str | None,
    tolerance: float | None,
    as_json: bool,
    **connection: Any,
) -> None:
    """Run a recording again and compare.

    The recorded commands and ticks are fed to a fresh world, and every tick's digest and every reply is compared with
    what was recorded. Prints the verdict, or the first difference.

    With --from and --to only a part is run, bit for bit as it would be if all were. What stands before the keyframe at
    which it begins is not even read. Frames are counted on through resets.

    FILE may be a log too: JSON lines as of nmes export, or bare commands, as of a program that wrote down what it sent.
    Of a log that is no whole history as much is compared as it holds.

    With --backend it is run on another engine, and instead of a verdict a table shows how far each cube is, over time,
    from where it was recorded.

    With --against the commands are sent to a server, whoever wrote it, at the same ticks, and its answers are compared
    field by field. Its world is set to lockstep and reset first.

    Exit status: 0 reproduced, or equal answers; 1 diverged, different or not comparable; 2 wrong usage or an unreadable
    file (for a damaged file, after replaying what comes before the damage).

    For example:

    \b
        nmes replay run.mcap
        nmes replay run.mcap --from 36000 --to 36600
        nmes replay run.mcap --backend pymunk --plot drift.svg
        nmes replay run.mcap --against 127.0.0.1:14000 --tolerance 1e-3
    """
    if isinstance(recording, Log):
        others = (backend, plot_to, against, world, *connection.values())
        if any(others) or (first, last, tolerance) != (None, None, None):
            raise click.UsageError("of the options, a log goes with --anyway and --json only")
        sys.exit(_log(recording, anyway, as_json))
    if first is not None and last is not None and last < first:
        raise click.UsageError(f"--to {last} is before --from {first}")
    if against is not None:
        if backend is not None or plot_to is not None or anyway or (first, last) != (None, None):
            raise click.UsageError("--against goes with none of --backend, --plot, --from, --to and --anyway")
        connection["world"] = world
        sys.exit(_played(recording, against, 1e-6 if tolerance is None else tolerance, as_json, connection))
    if tolerance is not None or world is not None or any(connection.values()):
        raise click.UsageError("--tolerance, --world and what is said of a connection need --against")
    if backend is not None and (first, last) != (None, None):
        raise click.UsageError("--from and --to: another engine cannot take up a keyframe")
    if backend is not None:
        sys.exit(_drift(recording, backend, plot_to, as_json))
    if plot_to is not None:
        raise click.UsageError("--plot shows the drift between two engines: it needs --backend")
    with _progress(recording) as progress:
        report = replay(recording, anyway=anyway, progress=progress, first=first, last=last)
    drift = None
    if report.verdict == "not_comparable" and report.divergence is not None and not report.part:
        with _progress(recording) as progress:
            drift = measure_drift(recording, recording.config["backend"], progress=progress)
    if as_json:
        plain = report.to_json() | {"drift": None if drift is None else drift.to_json()}
        click.echo(orjson.dumps(plain, option=orjson.OPT_INDENT_2))
    else:
        for line in _lines(report):
            click.echo(line)
        if drift is not None:
            show(drift, Console(highlight=False, markup=False))
    if report.damage is not None and not report.cut:
        sys.exit(2)
    sys.exit(0 if report.verdict == "reproduced" else 1)


def _drift(recording: Recording, backend: str, plot_to: Path | None, as_json: bool) -> int:
    with _progress(recording) as progress:
        report = measure_drift(recording, backend, progress=progress)
    if plot_to is not None:
        plot(report, plot_to)
    if as_json:
        click.echo(orjson.dumps(report.to_json(), option=orjson.OPT_INDENT_2))
    else:
        show(report, Console(highlight=False, markup=False))
    return 0 if report.ended is None else 1


def _log(log: Log, anyway: bool, as_json: bool) -> int:
    with _progress(log) as progress:
        try:
            report = replay_log(log, anyway=anyway, progress=progress)
        except RecordingError as error:
            click.echo(f"Error: {error}", err=True)
            return 2
    if as_json:
        click.echo(orjson.dumps(report.to_json(), option=orjson.OPT_INDENT_2))
    else:
        for line in _log_lines(report):
            click.echo(line)
    return 0 if report.verdict in ("reproduced", "agrees", "ran") else 1


def _log_lines(report: LogReport) -> list[str]:
    amount = (
        f"{report.commands:,} commands, {report.replies:,} replies compared; "
        f"{report.ticks:,} ticks, {report.digests:,} digests compared"
    )
    verdict = "not comparable" if report.verdict == "not_comparable" else report.verdict
    lines = [f"{verdict}: {amount}"]
    lines += _unlike_lines(report.differences)
    if not report.whole:
        lines.append("  the log does not say how its world began: it was run in a new one, in lockstep")
        if not report.digests:
            lines.append("  it holds no digests: that the world went through the same states is not known")
        if not report.replies:
            lines.append("  it holds no answers to its commands: nothing could be compared")
    lines += [f"  passed over: {count} {what}" for what, count in report.passed_over.items()]
    lines += [f"  refused, {line}" for line in report.refused]
    if report.divergence is not None:
        lines += _divergence_lines(report.divergence)
    return lines


def _unlike_lines(differences: dict[str, tuple[str, str]]) -> list[str]:
    return [
        f"  {name}: {recorded or 'none'} (here: {here or 'none'})" for name, (recorded, here) in differences.items()
    ]


def _played(
    recording: Recording, address: tuple[str, int], tolerance: float, as_json: bool, connection: dict[str, Any]
) -> int:
    client = connector(address, **connection, timeout=60.0)
    with _progress(recording) as progress:
        try:
            report = replay_remotely(recording, lambda: client().connect(), tolerance=tolerance, progress=progress)
        except (NmesError, TimeoutError) as error:
            # Usage, or a file that cannot be read: nothing was compared.
            click.echo(f"Error: {error}", err=True)
            return 2
    if as_json:
        click.echo(orjson.dumps(report.to_json(), option=orjson.OPT_INDENT_2))
    else:
        _against.show(report, Console(highlight=False, markup=False))
    return 0 if report.verdict == "equal" else 1


@contextmanager
def _progress(recording: Recording | Log) -> Iterator[Callable[[int, int], None]]:
    with progress_bars(recording.size > _LONG) as progress:
        yield partial(progress, "replaying")


def _lines(report: ReplayReport) -> list[str]:
    amount = f"{report.ticks:,} ticks, {report.commands:,} commands"
    if report.part:
        amount += f", from frame {report.frames[0]:,} to frame {report.frames[1]:,}"
    speed = f"{report.speed:,.0f} times faster than real time" if report.ticks else "no simulation time"
    if report.verdict == "not_comparable":
        lines = ["not comparable: it was recorded with another"]
        lines += _unlike_lines(report.differences)
        if report.wall_seconds:
            how_far = "as far as" if report.divergence else "all the same:"
            lines.append(f"run anyway, it agrees {how_far} {amount}")
    elif report.divergence is None:
        lines = [f"reproduced: {amount}, {speed}"]
    else:
        lines = [f"diverged at frame {report.divergence.frame}, after {amount}"]
    if report.divergence is not None:
        lines += _divergence_lines(report.divergence, f" (record {report.divergence.record})")
    if report.damage is not None:
        lines.append(f"{'incomplete' if report.cut else 'DAMAGED'}: {report.damage}")
    return lines


def _divergence_lines(divergence: Divergence, where: str = "") -> list[str]:
    lines = [f"  {divergence.message}{where}"]
    value = divergence.value
    if value is None:
        lines.append("  no recorded reply or pose shows the difference")
        return lines
    place = f"cube {value.cube}: " if value.cube is not None else ""
    if divergence.seen != divergence.frame:
        place = f"at frame {divergence.seen}, {place}"
    by = f" (differs by {value.amount:.6g})" if value.amount is not None else ""
    recorded, now = _short(value.expected), _short(value.actual)
    lines.append(f"  {place}{value.field or 'reply'}: recorded {recorded}, now {now}{by}")
    return lines


def _short(value: object) -> str:
    text = orjson.dumps(value).decode()
    return text if len(text) <= 200 else f"{text[:200]}..."
