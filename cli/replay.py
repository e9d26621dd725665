"""`nmes replay`: run a recording again and compare."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from nmes.cli import _against, _drift
from nmes.cli._address import split_address
from nmes.cli._connection import connection_options, connector
from nmes.cli._each_file import File, Finding, files_argument, report_each
from nmes.cli._json import print_json
from nmes.cli._options import MOMENT, FiniteRange, Moment
from nmes.cli._output import check_output
from nmes.cli._progress import QUIET, progress_bars
from nmes.cli._replay_report import log_lines, replay_lines
from nmes.cli.info import open_recording
from nmes.errors import NmesError, RecordingError, visible
from nmes.playback import ReplayReport, replay
from nmes.playback.drift import measure_drift
from nmes.playback.log import Log
from nmes.playback.log_replay import replay_log
from nmes.playback.remote import replay_remotely
from nmes.recording import Recording

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["command"]

_LONG = 1 << 20  # bytes of recording from which on it is worth showing how far it is
_TOLERANCE = 1e-6
_STATUSES = {"reproduced": 0, "agrees": 0, "ran": 0, "diverged": 1, "not_comparable": 3}  # by verdict


class _Unreadable(click.ClickException):
    exit_code = 2


def _open(context: click.Context, parameter: click.Parameter, value: str) -> Recording | Log:
    """Opens the file that an argument names: a recording, or a log, which begins as JSON does."""
    try:
        # Opening a pipe or a device could wait for ever.
        with open(value if Path(value).is_file() else os.devnull, "rb") as file:
            begins = file.read(64).lstrip()
        return Log(value) if begins.startswith(b"{") else open_recording(context, parameter, value)
    except OSError as error:
        raise click.BadParameter(f"cannot read {value}: {error.strerror}", ctx=context, param=parameter) from error
    except RecordingError as error:
        raise click.BadParameter(error.message, ctx=context, param=parameter) from error


@click.command("replay")
@files_argument(_open)
@click.option("--backend", metavar="NAME", help="Run it on this engine instead, and show how far each cube drifts.")
@click.option(
    "--plot", "plot_to", type=click.Path(dir_okay=False, path_type=Path), help="Write the drift to .svg or .png."
)
@click.option("--from", "first", type=MOMENT, help="Begin at the last keyframe before this, as 120 or 2.0s.")
@click.option("--to", "last", type=MOMENT, help="End at this frame or time.")
@click.option("--against", metavar="HOST:PORT", callback=split_address, help="Play it to this server, and compare.")
@click.option("--world", metavar="NAME", help="With --against: which of the server's worlds; the first if left out.")
@click.option(
    "--tolerance",
    type=FiniteRange(min=0),
    help="With --against: by how much numbers may differ, of larger ones than 1 relatively.  [default: 1e-6]",
)
@connection_options
@click.option("--json", "as_json", is_flag=True, help="Print the report as JSON.")
@QUIET
def command(files: list[File[Recording | Log]], **options: Any) -> None:
    """Run a recording again and compare.

    The recorded commands and ticks are fed to a fresh world, and every tick's digest and every reply is compared with
    what was recorded. Prints the verdict, or the first difference.

    With --from and --to only a part is run, bit for bit as it would be if all were. What stands before the keyframe at
    which it begins is not even read. Frames are counted on through resets, seconds from the beginning of the file.

    FILE may be a log too: JSON lines as of nmes export, or bare commands, as of a program that wrote down what it sent.
    Of a log that is no whole history as much is compared as it holds.

    With --backend it is run on another engine, and instead of a verdict a table shows how far each cube is, over time,
    from where it was recorded.

    With --against the commands are sent to a server, whoever wrote it, at the same ticks, and its answers are compared
    field by field. Its world is set to lockstep and reset first.

    Equal digests are reproduced, on whatever machine. Where they differ, and engine or machine compute otherwise than
    those of the recording, the two are not comparable, and it is shown how far each cube drifts.

    Several files get a line each, and one that cannot be read does not stop the others; as JSON one object, or a list
    of them.

    Exit status: 0 reproduced, or equal answers; 1 diverged or different; 2 wrong usage or an unreadable file (for a
    damaged file, after replaying what comes before the damage); 3 not comparable; of several files the worst, in the
    order 1, 2, 3.

    For example:

    \b
        nmes replay run.mcap
        nmes replay recordings/*.mcap
        nmes replay run.mcap --from 36000 --to 610s
        nmes replay run.mcap --backend pymunk --plot drift.svg
        nmes replay run.mcap --against 127.0.0.1:14000 --tolerance 1e-3
    """
    as_json: bool = options.pop("as_json")
    used = {name for name, value in options.items() if value is not None and value is not False}
    _check(options, used)
    if not used & {"against", "backend"}:
        several = len(files) > 1
        first, last = options["first"], options["last"]
        sys.exit(report_each(files, lambda opened: _judge(opened, used, first, last, several), as_json))
    if len(files) > 1:
        raise click.UsageError("--against and --backend take one file")
    recording = _recording(files[0].open(), used)
    check_output(options["plot_to"], recording.path)
    if options["against"] is not None:
        sys.exit(_run_remotely(recording, as_json, **options))
    sys.exit(_run_elsewhere(recording, options["backend"], options["plot_to"], as_json))


def _recording(opened: Recording | Log, used: set[str]) -> Recording:
    """Returns the recording, for options that do not go with a log."""
    if isinstance(opened, Log):
        raise click.UsageError(f"{opened.path}: of the options, a log goes with --json only")
    return opened


def _check(options: dict[str, Any], used: set[str]) -> None:
    """Refuses options of a recording's replay that do not go together."""
    if "against" in used:
        if used & {"backend", "plot_to", "first", "last"}:
            raise click.UsageError("--against goes with none of --backend, --plot, --from and --to")
    elif used - {"backend", "plot_to", "first", "last"}:
        raise click.UsageError("--tolerance, --world and what is said of a connection need --against")
    elif "backend" in used and used & {"first", "last"}:
        raise click.UsageError("--from and --to: another engine cannot take up a keyframe")
    elif "plot_to" in used and "backend" not in used:
        raise click.UsageError("--plot shows the drift between two engines: it needs --backend")


def _judge(opened: Recording | Log, used: set[str], begin: Moment | None, end: Moment | None, several: bool) -> Finding:
    """Replays a recording or a log; of one of several that is not comparable here, no drift is told."""
    if isinstance(opened, Log) and not used:
        return _judge_log(opened)
    recording = _recording(opened, used)
    first, last = (None if moment is None else moment.frame(recording) for moment in (begin, end))
    if begin is not None and end is not None and begin.frame(recording) > end.frame(recording):
        raise click.UsageError(f"--to {end.text} is before --from {begin.text}")
    with _progress(recording) as progress:
        report = replay(recording, progress=progress, first=first, last=last)
    lines, drift = replay_lines(report), None
    if report.verdict == "not_comparable" and report.divergence is not None and not report.part and not several:
        with _progress(recording) as progress:
            drift = measure_drift(recording, recording.config["backend"], progress=progress)
        console = _console(force_terminal=False)  # lines without marks for a terminal
        with console.capture() as told:
            _drift.show(drift, console)
        lines += told.get().splitlines()
    more = {} if several else {"drift": None if drift is None else drift.to_json()}
    return Finding(report.to_json() | more, lines, _status(report))


def _status(report: ReplayReport) -> int:
    if report.damage is not None and not report.cut:
        return 2
    return _STATUSES[report.verdict]


def _run_elsewhere(recording: Recording, backend: str, plot_to: Path | None, as_json: bool) -> int:
    """Runs a recording on another engine, prints the drift and returns the exit status."""
    with _progress(recording) as progress:
        report = measure_drift(recording, backend, progress=progress)
    if plot_to is not None:
        _drift.plot(f"Drift of {report.backend} from the recording on {report.recorded}", report.cubes, plot_to)
    if as_json:
        print_json({"file": str(recording.path)} | report.to_json())
    else:
        _drift.show(report, _console())
    return 0 if report.ended is None else 1


def _judge_log(log: Log) -> Finding:
    with _progress(log) as progress:
        try:
            report = replay_log(log, progress=progress)
        except RecordingError as error:
            raise _Unreadable(error.message) from error
    return Finding(report.to_json(), log_lines(report), _STATUSES[report.verdict])


def _run_remotely(
    recording: Recording, as_json: bool, *, against: tuple[str, int], tolerance: float | None, **options: Any
) -> int:
    """Plays a recording to a server, prints the report and returns the exit status."""
    connection = {name: value for name, value in options.items() if name not in ("backend", "plot_to", "first", "last")}
    client = connector(against, **connection, timeout=60.0)
    with _progress(recording) as progress:
        try:
            report = replay_remotely(
                recording,
                lambda: client().connect(),
                tolerance=_TOLERANCE if tolerance is None else tolerance,
                progress=progress,
            )
        except (NmesError, TimeoutError) as error:
            # Usage, or a file that cannot be read: nothing was compared.
            click.echo(visible(f"Error: {error}"), err=True)
            return 2
    if as_json:
        print_json({"file": str(recording.path)} | report.to_json())
    else:
        _against.show(report, _console())
    return 0 if report.verdict == "equal" else 1


@contextmanager
def _progress(recording: Recording | Log) -> Iterator[Callable[[int, int], None]]:
    with progress_bars(recording.size > _LONG) as progress:
        yield partial(progress, "replaying")


def _console(**options: Any) -> Console:
    from rich.console import Console

    return Console(highlight=False, markup=False, **options)
