"""`nmes render`: films and pictures of recordings."""

from __future__ import annotations

from pathlib import Path

import click

from nmes.cli._options import MOMENT, FiniteRange, Moment
from nmes.cli._output import check_output
from nmes.cli._progress import QUIET, progress_bars
from nmes.cli._size import size_option
from nmes.cli.info import open_recording
from nmes.errors import visible
from nmes.recording import Recording
from nmes.view.camera import Way
from nmes.view.film import Cut, film

__all__ = ["command"]


def _open(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> list[Recording]:
    return [open_recording(context, parameter, value) for value in values]


@click.command("render")
@click.argument("recordings", metavar="FILE...", nargs=-1, required=True, callback=_open)
@click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(dir_okay=False, path_type=Path),
    help="The film (.mp4, .gif) or picture (.png).",
)
@click.option(
    "--camera",
    type=click.Choice(["follow", "orbit", "fixed"]),
    default="follow",
    show_default=True,
    help="Keep what moves in view; go round it as well; or stand still and see the whole way.",
)
@click.option("--target", metavar="NAME", help="Look at this cube, or at those whose names begin so.")
@click.option("--from", "begin", type=MOMENT, default="0s", help="Begin at this frame or time, as 120 or 2.0s.")
@click.option("--to", "end", type=MOMENT, help="End at this frame or time; a .png shows it.")
@click.option(
    "--speed",
    type=FiniteRange(min=0.001, max=1000),
    default=1.0,
    show_default=True,
    help="Seconds of simulation in a second of film.",
)
@click.option("--fps", type=click.IntRange(1, 120), default=30, show_default=True, help="Pictures a second.")
@size_option("640x480")
@QUIET
def command(
    recordings: list[Recording],
    output: Path,
    camera: Way,
    target: str | None,
    begin: Moment,
    end: Moment | None,
    speed: float,
    fps: int,
    size: tuple[int, int],
) -> None:
    """Make a film or a picture of recordings.

    Works without a display, and for recordings of any engine. Several recordings are put side by side. Seconds count
    from the beginning of the recording, frames on through resets.

    For example:

    \b
        nmes render walk.mcap -o walk.mp4
        nmes render walk.mcap -o walk.gif --camera orbit --to 5s --size 320x240 --fps 20
        nmes render a.mcap b.mcap c.mcap -o all.mp4
        nmes render walk.mcap -o last.png
    """
    check_output(output, *(recording.path for recording in recordings))
    cut = Cut(camera, target, _time(begin, recordings), None if end is None else _time(end, recordings), speed)
    with progress_bars() as progress:
        film(recordings, output, cut, fps=fps, size=size, progress=progress)
    click.echo(f"wrote {visible(str(output))}")


def _time(moment: Moment, recordings: list[Recording]) -> float:
    """Returns how long after the beginning of the recordings a moment is, s."""
    times = {moment.time(recording) for recording in recordings}
    if len(times) > 1:
        raise click.UsageError(f"frame {moment.text} is another time in each recording: give seconds, as 2.0s")
    time = times.pop()
    if time < 0:
        raise click.UsageError(f"{recordings[0].path} begins after frame {moment.text}")
    return time
