"""`nmes evolve film`: the champions of a run, side by side."""

from __future__ import annotations

from pathlib import Path

import click

from nmes.cli._options import FiniteRange
from nmes.cli._output import check_output
from nmes.cli._progress import QUIET, progress_bars
from nmes.cli._size import size_option
from nmes.errors import visible

__all__ = ["command"]


@click.command("film")
@click.argument("folder", metavar="RUN", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(dir_okay=False, path_type=Path),
    help="The film (.mp4, .gif), or a picture of its end (.png).",
)
@click.option(
    "--seconds",
    type=FiniteRange(0.1, 1000),
    default=6.0,
    show_default=True,
    help="Of each episode, from when it begins to count.",
)
@click.option("--fps", type=click.IntRange(1, 120), default=12, show_default=True, help="Pictures a second.")
@size_option("720x360")
@QUIET
def command(folder: Path, output: Path, seconds: float, fps: int, size: tuple[int, int]) -> None:
    """Film the champions of each era of a run, side by side.

    They are at most six of those that were better than all before them: the first, the last, and those that gained
    most. Each is run again for it, in its first episode, and must come out as the log says.

    For example:

    \b
        nmes evolve film runs/walk-ga-1 -o evolution.mp4
        nmes evolve film runs/walk-ga-1 -o evolution.gif --seconds 10 --size 480x240
    """
    from nmes.evolution.run import Run
    from nmes.view.run_film import film_run

    run = Run.open(folder)
    check_output(output, *folder.iterdir())
    with progress_bars() as progress:
        shown = film_run(run, output, seconds=seconds, fps=fps, size=size, progress=progress)
    click.echo(visible(f"wrote {output}: candidates {', '.join(map(str, shown))}"))
