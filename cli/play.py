"""`nmes play`: a creature on a task, scored and filmed."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import click

from nmes.cli._output import check_output
from nmes.cli._progress import QUIET, progress_bars
from nmes.cli._size import size_option
from nmes.cli._tasks import require_own_name
from nmes.errors import DocumentError, visible
from nmes.evaluation import Evaluation, Task, evaluate
from nmes.genome import Genome
from nmes.recording import Recording
from nmes.view.film import check_path, film

__all__ = ["command"]

_SEEDS = 2**63 - 1  # of worlds


@click.command("play")
@click.argument("genome", metavar="GENOME")
@click.option(
    "--task", metavar="T", default="walk", show_default=True, help="A file, or the name of a task that ships."
)
@click.option("--seed", type=click.IntRange(0, _SEEDS), help="Of the episode.  [default: the task's first]")
@click.option(
    "-o",
    "--output",
    type=click.Path(dir_okay=False, path_type=Path),
    help="The film (.mp4, .gif), or a picture of its end (.png).  [default: named after genome, task and seed]",
)
@size_option("640x480")
@QUIET
def command(genome: str, task: str, seed: int | None, output: Path | None, size: tuple[int, int]) -> None:
    """Run a creature on a task and film it.

    GENOME is a file, or the name of a genome that ships. The score is that of the one episode that is seen; nmes eval
    gives that of the task, over all its seeds. Without the extra film, the film is a .gif unless you name another.

    Exit status: 0 good, 1 it could not be run or filmed, or its world faulted, 2 wrong usage.

    For example:

    \b
        nmes play walker
        nmes play seeker --task reach --seed 3 -o seeker.gif --size 320x240
    """
    try:
        player, asked = Genome.load(genome), Task.load(task)
    except DocumentError as error:
        raise click.UsageError(error.message) from error
    require_own_name(asked, task)
    seed = asked.seeds[0] if seed is None else seed
    if output is None:
        ending = "mp4" if find_spec("av") else "gif"
        output = Path(f"{Path(genome).stem}-{Path(task).stem}-{seed}.{ending}")
    check_path(output)
    check_output(output, genome, task)
    with TemporaryDirectory() as folder:
        evaluation = evaluate(player, asked, seeds=[seed], record=folder)
        click.echo(
            f"{visible(evaluation.genome)} on {visible(evaluation.task)}, seed {seed}: {_outcome(evaluation, asked)}"
        )
        with progress_bars() as progress:
            film([Recording(evaluation.recordings[0])], output, size=size, progress=progress)
    click.echo(f"wrote {visible(str(output))}")
    if evaluation.faults:
        raise click.ClickException(visible(f"the episode has no score: {evaluation.results[0].fault}"))


def _outcome(evaluation: Evaluation, asked: Task) -> str:
    """Returns a line about the one episode: its score.

    Raises:
        ClickException: The creature could not be evaluated.
    """
    if evaluation.error is not None:
        raise click.ClickException(f"{evaluation.genome} cannot be put to {evaluation.task}: {evaluation.error}")
    result = evaluation.results[0]
    score = "no score" if result.score is None else f"score {result.score:.4g}"
    return f"{score} ({result.ended} after {result.ticks / asked.tick_rate:.2f} s)" if result.ended else score
