"""`nmes learn`: train the brain of a creature, go on with it, look at it, prove it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from nmes.cli import _learn_cube, _learn_resume, _learn_show, _learn_verify
from nmes.cli._learn_run import JSON, THREADS, go_on
from nmes.cli._options import BeginningGroup, read_values
from nmes.cli._progress import QUIET
from nmes.cli._tasks import require_own_name
from nmes.errors import DocumentError

if TYPE_CHECKING:
    from nmes.learning.settings import LearningSettings

__all__ = ["command"]


@click.group("learn", cls=BeginningGroup, context_settings={"ignore_unknown_options": True})
def command() -> None:
    """Train a creature's brain, in runs that anyone can repeat."""


for _each in (_learn_cube, _learn_resume, _learn_show, _learn_verify):
    command.add_command(_each.command)


@command.command("", hidden=True)
@click.argument("what", metavar="WHAT...", nargs=-1)
@click.option("--task", metavar="T", help="A file, or the name of a task that ships.  [default: walk; the recordings']")
@click.option("--algorithm", metavar="A", default="ppo", show_default=True, help="Its name, one of those above.")
@click.option(
    "--steps", metavar="N", type=click.IntRange(1), default=1_000_000, show_default=True, help="Learn from at least N."
)
@click.option(
    "--seed", metavar="S", type=click.IntRange(0), default=0, show_default=True, help="Of all that the run draws."
)
@click.option("--set", "options", metavar="NAME=VALUE", multiple=True, help="An option of the algorithm.")
@click.option("--reward", metavar="EXPR", help="Of a tick.  [default: by how much the task's objective grew]")
@click.option(
    "--every", metavar="N", type=click.IntRange(1), default=5, show_default=True, help="Score in every so many legs."
)
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), help="The run's folder.  [default: runs/TASK-ALGORITHM-SEED]"
)
@THREADS
@JSON
@QUIET
def begin(output: Path | None, threads: int | None, as_json: bool, **options: Any) -> None:
    """Train a creature's brain, in runs that anyone can repeat.

    WHAT is a genome: a file, or the name of one that ships. Its brain is replaced by a network of layers over all its
    sensors and motors; where it has such a network, learning goes on from it. For `clone`, WHAT are recordings: the
    brain learns to do what was done in them.

    The algorithms: ppo (proximal policy optimisation), reinforce, and clone (behaviour cloning).

    The run is kept in a folder: its settings, a log of its legs, states to go on from, and the best brain so far as
    genome.json, which `nmes eval` scores. It comes out the same for any number of threads, and also if it was
    interrupted in between: the digest that is printed at the end proves it.

    Ctrl-C leaves a run that `nmes learn resume` goes on with, and says so.

    Exit status: 0 all steps are done, 1 it was interrupted, 2 wrong usage.

    For example:

    \b
        nmes learn eel --task swim --steps 100000 --seed 1 -o runs/swim
        nmes learn walker --task walk --steps 1000000 --seed 1 -o runs/walk
        nmes learn walker --set rows=64 --set rate=0.001 --reward 'velocity.x - 0.1 * abs(velocity.z)'
        nmes learn runs/walk/genome.json --task stairs --steps 2000000
        nmes learn --algorithm clone recordings/*.mcap --steps 100000
    """
    from nmes.learning.run import LearningRun

    try:
        settings = _settings(options)
    except DocumentError as error:
        raise click.UsageError(error.message) from error
    require_own_name(settings.task, options["task"] or "what the recordings are of")
    folder = output or Path("runs", f"{settings.task.name}-{settings.algorithm}-{settings.seed}")
    go_on(LearningRun.create(folder, settings), threads, as_json)


def _settings(options: dict[str, Any]) -> LearningSettings:
    """Returns the settings that arguments and options mean.

    Raises:
        DocumentError: They are none, with all that is wrong.
    """
    from nmes.learning.settings import FORMAT, LearningSettings, read_lessons

    what: Sequence[str] = options["what"]
    if not what:
        raise click.UsageError("say what learns: a genome, or recordings for `clone`")
    document = {
        "format": FORMAT,
        "algorithm": options["algorithm"],
        "options": read_values(options["options"]),
        "steps": options["steps"],
        "seed": options["seed"],
        "every": options["every"],
    }
    if options["reward"] is not None:
        document["reward"] = options["reward"]
    if options["algorithm"] == "clone":
        lessons = read_lessons(tuple(what))
        learned = {"recordings": list(what), "episodes": lessons.digest, "genome": lessons.genome.document}
        return LearningSettings.read({**document, **learned, "task": options["task"] or lessons.task.document})
    if len(what) > 1:
        raise click.UsageError(f"one creature learns, not {len(what)}; only `clone` takes several recordings")
    return LearningSettings.read({**document, "genome": what[0], "task": options["task"] or "walk"})
