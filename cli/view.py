"""`nmes view`: look at worlds and recordings in Rerun."""

from __future__ import annotations

from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from nmes.cli._address import split_address
from nmes.cli._connection import connection_options, connector
from nmes.cli._options import FiniteRange
from nmes.cli._output import whole_file
from nmes.cli._progress import QUIET, progress_bars
from nmes.cli.info import open_recording
from nmes.errors import visible
from nmes.recording import Recording
from nmes.view.canvas import Canvas
from nmes.view.live import show_live
from nmes.view.recordings import Places, show_drift, show_recording
from nmes.view.screen import LOCAL, Screen, lay_out, screen

__all__ = ["command"]


@click.command("view", short_help="Look at live worlds and at recordings.")
@click.argument("what", metavar="HOST:PORT|FILE [FILE]", nargs=-1, required=True)
@click.option("--web", is_flag=True, help="Show it in a browser: prints a link, and serves it until Ctrl-C.")
@click.option("--save", type=click.Path(dir_okay=False, path_type=Path), help="Write it to this .rrd file instead.")
@click.option("--fps", type=FiniteRange(1, 1000), default=30.0, show_default=True, help="Pictures a second.")
@click.option("--host", default=LOCAL, show_default=True, help="The address on which Rerun listens.")
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Where --web listens.  [default: any free port]")
@click.option("--world", metavar="NAME", help="Which of a live host's worlds.  [default: its first]")
@connection_options
@QUIET
@click.pass_context
def command(
    context: click.Context,
    /,
    what: tuple[str, ...],
    web: bool,
    save: Path | None,
    fps: float,
    host: str,
    port: int,
    world: str | None,
    **connection: Any,
) -> None:
    """Look at live worlds and at recordings.

    A live world is one that any server of the protocol hosts. A recording is run again, and stands on a time line with
    the commands beside it, the forces they applied, the contacts, and where it diverges. Of two, the drift is shown.

    For example:

    \b
        nmes view 127.0.0.1:14000 --web
        nmes view walk.mcap
        nmes view walk.mcap again.mcap --web
        nmes view walk.mcap --save walk.rrd
    """
    live = len(what) == 1 and ":" in what[0] and not Path(what[0]).exists()
    _check_usage(context, live)
    argument = next(parameter for parameter in context.command.params if parameter.name == "what")
    with ExitStack() as opened:
        unfinished = None if save is None else opened.enter_context(whole_file(save, *what))
        show = partial(screen, web=web, save=unfinished, host=host, port=port)
        if live:
            address = split_address(context, argument, what[0])
            assert address is not None
            client = connector(address, world=world, **connection)()
            with client, show(f"{client.welcome.get('world', 'a world')} at {what[0]}") as display:
                _announce(display, save)
                try:
                    show_live(client, display.stream, fps)
                    click.echo("The world was closed")
                    _stay(display, web)
                except KeyboardInterrupt:
                    click.echo()
            return
        recordings = [open_recording(context, argument, one) for one in what]
        with show(" and ".join(recording.path.stem for recording in recordings)) as display:
            _announce(display, save)
            _show(recordings, display, fps)
            _stay(display, web)


def _check_usage(context: click.Context, live: bool) -> None:
    """Refuses options that do not go together, or with what is to be seen: a live world, or recordings."""
    options = context.params
    used = {name for name in options if context.get_parameter_source(name) is ParameterSource.COMMANDLINE}
    for wrong, message in (
        (options["web"] and options["save"] is not None, "give --web or --save, not both"),
        (len(options["what"]) > 2, "two recordings at most can be seen side by side; nmes render takes more"),
        ("port" in used and not options["web"], "--port is where --web listens"),
        ("host" in used and options["save"] is not None, "--save writes a file, and nothing listens on --host"),
        (
            not live and used & {"world", "password", "password_file", "tls", "tls_ca"},
            "--world and what is said of a connection (--password, --tls) are of a live world, at HOST:PORT",
        ),
    ):
        if wrong:
            raise click.UsageError(message)


def _show(recordings: list[Recording], display: Screen, fps: float) -> None:
    """Draws recordings, prints their verdicts, and plots the drift between two."""
    roots = [recording.path.stem for recording in recordings]
    if len(set(roots)) < len(roots):
        roots = [f"{place}: {root}" for place, root in zip("AB", roots, strict=False)]
    places: list[list[Places]] = []
    worlds: dict[str, Canvas] = {}
    for recording, root in zip(recordings, roots, strict=True):
        with progress_bars() as progress:
            done = partial(progress, f"running {recording.path.name}")
            sight = show_recording(
                recording, display.stream, root, fps=fps, keep_places=len(recordings) == 2, progress=done
            )
        worlds[root] = sight.canvas
        places.append(sight.places)
        click.echo(visible(f"{recording.path}: {sight.report.verdict}"))
    if len(places) == 2:
        show_drift(display.stream, *places)
    lay_out(display.stream, worlds, live=False)


def _announce(display: Screen, save: Path | None) -> None:
    """Prints where to look."""
    if display.address is not None:
        click.echo(f"Look at {display.address}")
    elif save is not None:
        click.echo(visible(f"Writing {save}: open it with rerun {save}"))


def _stay(display: Screen, web: bool) -> None:
    """Keeps the viewer for browsers running until Ctrl-C."""
    if web:
        click.echo("Ctrl-C stops")
        try:
            display.wait()
        except KeyboardInterrupt:
            click.echo()
