"""`nmes survey`: score creatures in thousands of worlds; go on with it, look at it, prove it."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import click

from nmes.cli._columns import columns
from nmes.cli._genomes import find_genomes
from nmes.cli._json import print_json
from nmes.cli._options import BeginningGroup
from nmes.cli._output import whole_folder
from nmes.cli._pictures import write_picture
from nmes.cli._pool import JOBS, RAY, advance_in_pool, check_pool, open_pool
from nmes.cli._progress import QUIET, progress_bars
from nmes.cli._proof_files import check_place, write_documents
from nmes.cli._sample import SEED, drawn_by
from nmes.cli._tasks import require_own_name
from nmes.errors import DocumentError, RunError, visible
from nmes.objective.means import mean

if TYPE_CHECKING:
    from nmes.evaluation.parallel import Cluster, Workers
    from nmes.fleet.survey import Survey, SurveyedWorld

__all__ = ["command"]

_STATUS = {"holds": 0, "broken": 1, "not_comparable": 3}
_WORDS = {"holds": "holds", "broken": "broken", "not_comparable": "not comparable here"}
_FOLDER = click.argument("folder", metavar="SURVEY", type=click.Path(path_type=Path))
_JSON = click.option("--json", "as_json", is_flag=True, help="End with an object with digest and figures.")


@click.group("survey", cls=BeginningGroup, context_settings={"ignore_unknown_options": True})
def command() -> None:
    """Score creatures in thousands of worlds."""


@command.command("", hidden=True)
@click.argument("what", metavar="WHAT...", nargs=-1, required=True)
@click.option(
    "--worlds",
    metavar="N",
    type=click.IntRange(1, 1_000_000),
    default=27_000,
    show_default=True,
    help="How many, at most 1,000,000.",
)
@click.option(
    "--task",
    "tasks",
    metavar="T",
    multiple=True,
    help="A file, or the name of a task that ships; several take turns.  [default: an atlas of 25]",
)
@click.option(
    "--seed",
    metavar="S",
    type=click.IntRange(0, 1_000_000_000),
    default=0,
    show_default=True,
    help="Of which the seeds of all worlds follow.",
)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="The survey's folder.  [default: surveys/SEED]")
@JOBS
@RAY
@_JSON
@QUIET
def begin(
    what: Sequence[str],
    worlds: int,
    tasks: Sequence[str],
    seed: int,
    output: Path | None,
    jobs: int | None,
    ray: str | None,
    as_json: bool,
) -> None:
    """Score creatures in thousands of worlds.

    Each world is a landscape or planet of its own seed. WHAT are the creatures, of which each has one: files,
    directories, patterns, or names of genomes that ship, which take turns; or `random`, for another random one in each.
    Without --task the worlds are those of an atlas: hills of five heights under five gravities.

    The survey is kept in a folder: its settings and a log of all worlds. It comes out the same for any number of
    processes, and also if it was interrupted in between: the digest that is printed at the end proves it. Any world can
    be evaluated again by itself.

    Ctrl-C leaves a survey that `nmes survey resume` goes on with, and says so.

    Exit status: 0 all worlds are scored, 1 it was interrupted, 2 wrong usage.

    For example:

    \b
        nmes survey galloper
        nmes survey galloper rambler walker --worlds 3000 -o surveys/three
        nmes survey random --worlds 2500 --task rough --task stairs --seed 7
    """
    from nmes.evaluation.task import Task
    from nmes.evolution.run_folder import require_no_run
    from nmes.fleet.survey import Survey, SurveySettings
    from nmes.genome import Genome

    check_pool(jobs, ray)
    if "random" in what and len(what) > 1:
        raise click.UsageError("either `random` or genomes")
    names = [] if "random" in what else find_genomes(what)
    try:
        settings = SurveySettings.of([Genome.load(name) for name in names], [Task.load(t) for t in tasks], worlds, seed)
    except DocumentError as error:
        raise click.UsageError(error.message) from error
    for source, task in zip(tasks, settings.tasks, strict=False):  # those of the atlas have no source
        require_own_name(task, source)
    folder = output or Path("surveys", str(seed))
    require_no_run(folder)
    _go_on(lambda: Survey.create(folder, settings), jobs, ray, as_json)


@command.command("resume")
@_FOLDER
@JOBS
@RAY
@_JSON
@QUIET
def resume(folder: Path, jobs: int | None, ray: str | None, as_json: bool) -> None:
    """Go on with a survey that was interrupted.

    It comes out as if it had never been interrupted: the digest is the same. Worlds that are in the log are not
    evaluated again. A survey that is finished stays as it is.

    Exit status: 0 all worlds are scored, 1 it was interrupted again, 2 wrong usage, 3 other numbers would come out
    here.

    For example:

    \b
        nmes survey resume surveys/0
    """
    from nmes.fleet.survey import Survey

    check_pool(jobs, ray)
    found = Survey.open(folder)
    if found.finished:
        click.echo("the survey is finished", err=True)
        _print(found, as_json)
        return
    _go_on(lambda: found, jobs, ray, as_json)


@command.command("show")
@_FOLDER
@click.option(
    "-o",
    "--output",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="FOLDER",
    help="Draw its map into this new folder, as map.svg and map.png.",
)
@click.option("--json", "as_json", is_flag=True, help="Print it as JSON.")
def show(folder: Path, output: Path | None, as_json: bool) -> None:
    """Show what a survey has come to: scores by task, and the best and the worst worlds.

    One that is still going on is shown as far as it is. With -o its map is drawn: a square a world, in the colour of
    its score.

    For example:

    \b
        nmes survey show surveys/0
        nmes survey show surveys/0 -o pictures/
    """
    from nmes.fleet.survey import Survey
    from nmes.view.survey_map import survey_map

    survey = Survey.open(folder)
    settings = survey.settings
    if output is not None:
        units = {task.unit for task in settings.tasks}
        unit = units.pop() if len(units) == 1 else ""
        with whole_folder(output) as drawn:
            write_picture(survey_map(_by_task(survey), settings.rows, settings.columns, unit), drawn)
    _print(survey, as_json)
    if output is not None and not as_json:
        click.echo(visible(f"wrote {output / 'map.svg'} and {output / 'map.png'}"))


@command.command("growth")
@_FOLDER
@click.option(
    "--draws",
    metavar="N",
    type=click.IntRange(1, 100_000),
    default=500,
    show_default=True,
    help="How many parts of each size.",
)
@click.option("--json", "as_json", is_flag=True, help="Print it as JSON.")
def growth(folder: Path, draws: int, as_json: bool) -> None:
    """Tell how best score and diversity grow with the number of worlds.

    Parts of the survey are drawn, of all its worlds, half of them, a quarter and so on: each is a survey that might
    have been. Told are their best scores, and how many different behaviours they have: two are alike that got as far
    over the ground and worked as much, each within a factor of four.

    For example:

    \b
        nmes survey growth surveys/0
        nmes survey growth surveys/0 --draws 2000 --json
    """
    from nmes.fleet.growth import survey_growth
    from nmes.fleet.survey import Survey

    found = survey_growth(Survey.open(folder), draws)
    if found is None:
        raise click.UsageError(f"fewer than four worlds of {folder} are done")
    if as_json:
        print_json(asdict(found))
        return
    rows: list[tuple[str, ...]] = [("worlds", "best", "from", "to", "behaviours", "from", "to")]
    for each in found.sizes:
        numbers = (each.best, each.best_low, each.best_high, each.behaviours, each.behaviours_low, each.behaviours_high)
        rows.append((f"{each.worlds:,}", *("none" if number is None else f"{number:.4g}" for number in numbers)))
    for line in columns(rows, tuple(range(len(rows[0])))):
        click.echo(line)
    click.echo(f"digest: {found.digest}")


@command.command("verify")
@_FOLDER
@click.option(
    "--sample", metavar="N", type=click.IntRange(0), default=100, show_default=True, help="How many beside the best."
)
@click.option("--all", "everything", is_flag=True, help="Evaluate all worlds again.")
@SEED
@JOBS
@RAY
@click.option("--json", "as_json", is_flag=True, help="Print the verdict as JSON.")
@QUIET
def verify(
    folder: Path, sample: int, everything: bool, seed: int | None, jobs: int | None, ray: str | None, as_json: bool
) -> None:
    """Prove a survey: what its log says comes out again.

    The log's chain of digests is followed. The best world and others, drawn anew each time, are evaluated again: every
    figure must be the same to the last bit.

    Exit status: 0 it holds, 1 it is broken, 2 wrong usage, 3 it does not come out the same here, where other numbers
    come out than where it was begun, or an ONNX brain may round otherwise.

    For example:

    \b
        nmes survey verify surveys/0
        nmes survey verify surveys/0 --all
    """
    from nmes.fleet.survey import verify_survey

    check_pool(jobs, ray)
    with progress_bars() as progress, open_pool(jobs, ray) as pool:
        found = verify_survey(
            folder, pool, None if everything else sample, lambda done, total: progress("verifying", done, total), seed
        )
    if as_json:
        print_json(asdict(found))
    else:
        for finding in found.findings:
            click.echo(visible(finding))
        again = f"{found.evaluated:,} of {found.worlds:,} worlds evaluated again"
        click.echo(f"{_WORDS[found.verdict]}: {again}{drawn_by(found.seed, found.evaluated, found.worlds)}")
        click.echo(f"digest: {found.digest}")
    sys.exit(_STATUS[found.verdict])


@command.command("best")
@_FOLDER
@click.option("--world", type=click.IntRange(min=0), help="This world, instead of that with the best score.")
@click.option(
    "-o",
    "--output",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="FOLDER",
    help="Where to write it.  [default: world-NUMBER in SURVEY]",
)
@click.option("--json", "as_json", is_flag=True, help="Print what was written as JSON.")
def best(folder: Path, world: int | None, output: Path | None, as_json: bool) -> None:
    """Write the best world of a survey: its genome and task, and the recording that proves its score.

    It is run again, and every figure must be that of the log. A folder that holds a run, another genome or task, or a
    recording that is signed, is refused.

    Exit status: 0 it is written, 1 it is not, 2 wrong usage, 3 it does not come out the same here, where other numbers
    come out or an ONNX brain may round otherwise.

    For example:

    \b
        nmes survey best surveys/0
        nmes survey best surveys/0 --world 1234 -o proof
    """
    from nmes.evaluation import evaluate
    from nmes.fleet.survey import Survey

    survey = Survey.open(folder)
    if world is not None and world >= len(survey):
        raise click.UsageError(f"there is no world {world}: the survey has {len(survey):,} so far")
    chosen = survey.best if world is None else survey.worlds[world]
    if chosen is None:
        raise RunError("no_score", f"no world of {folder} has a score")
    settings, number = survey.settings, chosen.world
    genome, task, target = settings.genome(number), settings.task(number), output or folder / f"world-{number}"
    documents = {"genome.json": genome.document, "task.json": task.document}
    check_place(target, documents)
    target.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=target, prefix=".") as unfinished:
        found = evaluate(genome, task, seeds=[settings.seed_of(number)], record=unfinished)
        result = found.results[0] if found.results else None
        if result != chosen.result or found.error != chosen.error:
            raise survey.departure(number)
        recordings = [str(Path(path).replace(target / Path(path).name)) for path in found.recordings]
    files = write_documents(target, documents)
    written = {
        "world": number,
        "seed": settings.seed_of(number),
        "task": task.name,
        "score": chosen.score,
        "files": [str(path) for path in files],
        "recordings": recordings,
    }
    if as_json:
        print_json(written)
        return
    click.echo(visible(f"world {number}: {_scored(survey, chosen)}, again as the log says"))
    for path in (*files, *recordings):
        click.echo(visible(f"wrote {path}"))


def _go_on(find: Callable[[], Survey], jobs: int | None, ray: str | None, as_json: bool) -> None:
    """Goes on with a survey, says how it came out, and ends the program: status 1 where it was interrupted.

    Args:
        find: Returns the survey, which it may begin: where there are no processes and no cluster, none is begun.
        jobs: As `open_pool`.
        ray: As `open_pool`.
        as_json: Whether to end with JSON.
    """
    survey, interrupted = advance_in_pool(find, jobs, ray, _advance)
    survey = type(survey).open(survey.folder)  # wherever it was interrupted, this is what is there
    stopped = interrupted and not survey.finished
    if stopped:
        click.echo(f"stopped: {len(survey):,} of {survey.settings.worlds:,} worlds done", err=True)
        click.echo(visible(f"go on with: nmes survey resume {shlex.quote(str(survey.folder))}"), err=True)
    _print(survey, as_json)
    sys.exit(1 if stopped else 0)


def _advance(survey: Survey, pool: Workers | Cluster, interrupted: Callable[[], bool]) -> None:
    start, first = time.monotonic(), len(survey)
    with progress_bars() as progress:

        def tell(done: int, total: int) -> None:
            rate = (done - first) / max(1e-9, time.monotonic() - start)
            progress("surveying", done, total, f"{rate:.1f} worlds/s")
            if interrupted():
                raise KeyboardInterrupt

        tell(first, survey.settings.worlds)
        for _ in survey.advance(pool, tell):
            pass


def _by_task(survey: Survey) -> list[list[float | None]]:
    """Returns the scores of the worlds of each task."""
    blocks: list[list[float | None]] = [[] for _ in survey.settings.tasks]
    for world in survey.worlds:
        blocks[world.world % len(blocks)].append(world.score)
    return blocks


def _summary(survey: Survey) -> dict[str, Any]:
    best, settings = survey.best, survey.settings
    tasks = []
    for task, block in zip(settings.tasks, _by_task(survey), strict=True):
        scores = [score for score in block if score is not None]
        found = mean(scores) if scores else None
        tasks.append({"task": task.name, "worlds": len(block), "scored": len(scores), "mean": found})
    return {
        "survey": str(survey.folder),
        "worlds": len(survey),
        "of": settings.worlds,
        "scored": sum(task["scored"] for task in tasks),
        "best": None if best is None else {"world": best.world, "score": best.score},
        "tasks": tasks,
        "digest": survey.digest,
    }


def _print(survey: Survey, as_json: bool) -> None:
    """Prints what a survey has come to."""
    if as_json:
        print_json(_summary(survey))
    else:
        _tell(survey)


def _tell(survey: Survey) -> None:
    told, settings = _summary(survey), survey.settings
    click.echo(
        visible(f"{survey.folder}: {told['worlds']:,} of {told['of']:,} worlds, {told['scored']:,} with a score")
    )
    best = survey.best
    if best is not None:
        worst = min(
            (world for world in survey.worlds if world.score is not None), key=lambda each: (each.score, each.world)
        )
        click.echo(visible(f"best:  world {best.world}, {_scored(survey, best)}"))
        click.echo(visible(f"worst: world {worst.world}, {_scored(survey, worst)}"))
        means = ["none" if task["mean"] is None else f"{task['mean']:.3g}" for task in told["tasks"]]
        wide = len(settings.columns)
        rows = [(row, *means[place * wide : (place + 1) * wide]) for place, row in enumerate(settings.rows)]
        right = tuple(range(1, wide + 1))
        click.echo("mean scores:")
        for line in columns([("", *settings.columns), *rows], right):
            click.echo(visible(f"  {line}"))
    click.echo(f"digest: {survey.digest}")


def _scored(survey: Survey, world: SurveyedWorld) -> str:
    task = survey.settings.task(world.world)
    if world.score is None:
        return f"no score on {task.name}"
    return f"{world.score:.4g}{' ' + task.unit if task.unit else ''} on {task.name}"
