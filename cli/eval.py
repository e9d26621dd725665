"""`nmes eval`: the scores of creatures on a task."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import click
import orjson
from click.core import ParameterSource

from nmes.cli._eval_jobs import run_jobs
from nmes.cli._eval_matches import score_matches, score_recorded_matches
from nmes.cli._eval_scores import format_seeds, print_csv, print_results, print_table
from nmes.cli._genomes import find_genomes
from nmes.cli._output import check_output
from nmes.cli._pool import JOBS, RAY
from nmes.cli._progress import QUIET
from nmes.cli._recording_plot import plot_recordings
from nmes.cli._seeds import read_seeds
from nmes.cli._tasks import require_own_name
from nmes.errors import DocumentError, visible
from nmes.evaluation import Evaluation, Job, MatchTask, Proof, Task, prove
from nmes.evaluation.match_proof import is_match
from nmes.evaluation.match_task import load_task
from nmes.genome.genome import SHIPPED
from nmes.recording import Recording
from nmes.recording.signed import require_unsigned

__all__ = ["command"]


@click.command("eval")
@click.argument("genomes", metavar="GENOME...", nargs=-1)
@click.option(
    "--task", metavar="T", default="walk", show_default=True, help="A file, or the name of a task that ships."
)
@click.option("--seeds", metavar="LIST", callback=read_seeds, help="Such as 1,2,3 or 0-9.  [default: the task's]")
@click.option("--record", type=click.Path(file_okay=False, path_type=Path), help="Leave a recording of each here.")
@click.option("--record-best", metavar="K", type=click.IntRange(1), help="Record but the K best, alone, afterwards.")
@click.option(
    "--from-recording",
    "recordings",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    multiple=True,
    help="Score recordings again, from their logs alone; what follows are recordings too.",
)
@JOBS
@RAY
@click.option("--resume", type=click.Path(dir_okay=False, path_type=Path), help="Keep results here; skip what it has.")
@click.option(
    "--plot",
    "plot_to",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write score, height, energy and gait over time to an .svg or .png; with --record or --from-recording.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the results as JSON.")
@click.option("--csv", "as_csv", is_flag=True, help="Print the results as CSV.")
@QUIET
@click.pass_context
def command(
    context: click.Context,
    genomes: tuple[str, ...],
    task: str,
    seeds: tuple[int, ...] | None,
    record: Path | None,
    record_best: int | None,
    recordings: tuple[Path, ...],
    jobs: int | None,
    ray: str | None,
    resume: Path | None,
    plot_to: Path | None,
    as_json: bool,
    as_csv: bool,
) -> None:
    """Score creatures on a task.

    GENOME is a file, a directory of them, a pattern, or the name of a genome that ships. Each is run once a seed of
    the task; the score is the mean over them, the spread their standard deviation. The figures are the same every
    time, whatever --jobs says. A task with roles, such as sumo, takes a genome for each role, and they play each other.

    Ctrl-C keeps what is done: the results so far go to the file of --resume, or to a new one that is named, from which
    the same command goes on.

    Exit status: 0 good, 1 a creature could not be evaluated, its world faulted, or a recording proves nothing, 2 wrong
    usage, 3 a recording is not comparable here.

    For example:

    \b
        nmes eval walker
        nmes eval walker 'evolved/*.json' --task walk --seeds 1-5 --record proofs
        nmes eval --from-recording proofs/walker-*.mcap --json
        nmes eval walker --seeds 1-3 --record proofs --plot walker.svg
        nmes eval 'generation/*.json' --record proofs --record-best 3
        nmes eval walker seeker --task sumo
    """
    _check_usage(context)
    asked = None if recordings else _task(task)
    if recordings:
        # Those behind the options too, where a shell's *.mcap leaves them.
        paths = [*recordings, *map(Path, genomes)]
        check_output(plot_to, *paths)
        evaluations, whole = _score(paths), True
    elif isinstance(asked, MatchTask):
        _check_match(context, asked)
        files = find_genomes(genomes, repeated=True)
        check_output(plot_to, task, *files)
        evaluations, whole = score_matches(files, asked, seeds, record, jobs, ray)
    else:
        assert asked is not None
        files = find_genomes(genomes)
        check_output(plot_to, task, *files, *filter(None, [resume]))
        work = _jobs(files, asked, seeds, record if record_best is None else None)
        if record is not None:
            _open_folder(record, [] if record_best is None else work)
        done = run_jobs(work, jobs, ray, resume)
        evaluations, whole = [*done.values()], len(done) == len(work)
        if record_best is not None and whole:
            evaluations, whole = _record_best(work, evaluations, record_best, str(record), jobs, ray, resume)
    (print_results if as_json else print_csv if as_csv else print_table)(evaluations)
    if plot_to is not None:
        _plot(evaluations, plot_to)
    sys.exit(0 if whole and all(each.error is None and not each.faults for each in evaluations) else 1)


def _check_usage(context: click.Context) -> None:
    """Refuses options that do not go together."""
    options = context.params
    used = {name for name in options if context.get_parameter_source(name) is ParameterSource.COMMANDLINE}
    recordings = options["recordings"]
    for wrong, message in (
        (
            recordings and used - {"recordings", "genomes", "as_json", "as_csv", "plot_to"},
            "--from-recording scores what recordings hold: only --json, --csv and --plot go with it",
        ),
        (not recordings and not options["genomes"], "name a genome to score, or a recording with --from-recording"),
        (options["as_json"] and options["as_csv"], "either --json or --csv"),
        (
            options["record_best"] is not None and options["record"] is None,
            "--record-best says how many are recorded: say where with --record",
        ),
        (
            options["plot_to"] is not None and not recordings and options["record"] is None,
            "--plot is drawn from recordings: give --record, or --from-recording",
        ),
        (
            options["plot_to"] is not None and options["record"] is not None and _among_recordings(**options),
            "--plot would be among the recordings: name an .svg or a .png",
        ),
        (options["jobs"] is not None and options["ray"] is not None, "either --jobs or --ray"),
    ):
        if wrong:
            raise click.UsageError(message)


def _among_recordings(plot_to: Path, record: Path, **_: object) -> bool:
    """Tells whether a plot would have a name that recordings in their folder have."""
    plot = Path(os.path.realpath(plot_to))
    return plot.suffix == ".mcap" and plot.parent == Path(os.path.realpath(record))


def _task(name: str) -> Task | MatchTask:
    """Returns the task of `--task`."""
    try:
        asked = load_task(name)
    except DocumentError as error:
        raise click.BadParameter(f"{visible(name)}:\n{error.message}", param_hint="--task") from error
    require_own_name(asked, name)
    return asked


def _check_match(context: click.Context, task: MatchTask) -> None:
    """Refuses options that mean nothing where creatures play each other."""
    for option, value in (("--resume", context.params["resume"]), ("--record-best", context.params["record_best"])):
        if value is not None:
            raise click.UsageError(f"{task.name} has roles, and {option} is for tasks of one creature")


def _jobs(files: Sequence[str], asked: Task, seeds: tuple[int, ...] | None, record: Path | None) -> list[Job]:
    """Returns a job for each genome."""
    document = orjson.dumps(asked.document)
    folder = None if record is None else str(record)
    return [Job(Path(name).stem, _read_genome(name), document, seeds, folder) for name in files]


def _open_folder(record: Path, work: Sequence[Job]) -> None:
    """Makes the folder of recordings, unless that of a creature which may be among the best lies there signed.

    Raises:
        RecordingError: One does (`signed`).
    """
    record.mkdir(parents=True, exist_ok=True)
    for place in (place for job in work for place in replace(job, record=str(record)).places().values()):
        require_unsigned(place)


def _record_best(
    work: Sequence[Job],
    evaluations: Sequence[Evaluation],
    count: int,
    folder: str,
    jobs: int | None,
    ray: str | None,
    resume: Path | None,
) -> tuple[list[Evaluation], bool]:
    """Runs the best creatures again, each alone, and records them.

    Returns:
        All evaluations, and whether none is missing.

    Raises:
        ClickException: One of them came out otherwise than beside the others.
    """
    scores = {index: each.score for index, each in enumerate(evaluations) if each.score is not None}
    best = sorted(scores, key=lambda index: (-scores[index], index))[:count]
    alone = [replace(work[index], record=folder) for index in best]
    recorded = run_jobs(alone, jobs, ray, resume, zip(work, evaluations, strict=True))
    found = list(evaluations)
    for place, again in recorded.items():
        index = best[place]
        if again != evaluations[index]:
            scores_then = f"{evaluations[index].score!r}, then {again.score!r}"
            what = f"{again.genome} came out otherwise alone than beside others (score {scores_then})"
            raise click.ClickException(visible(f"{what}: please report this as a mistake in NMES"))
        found[index] = again
    return found, len(recorded) == len(best)


def _read_genome(name: str) -> bytes:
    try:
        return SHIPPED.read(name)
    except DocumentError as error:
        raise click.UsageError(error.message) from error


def _score(recordings: Sequence[Path]) -> list[Evaluation]:
    """Returns the evaluations that recordings prove: those of one genome and task together, in order of their seeds."""
    matches = [path for path in recordings if is_match(Recording(path))]
    return [*_score_episodes([path for path in recordings if path not in matches]), *score_recorded_matches(matches)]


def _score_episodes(recordings: Sequence[Path]) -> list[Evaluation]:
    groups: dict[tuple[str, str], list[Proof]] = {}
    seconds: dict[tuple[str, str], float] = {}
    for path in recordings:
        begin = time.perf_counter()
        proof = prove(path)
        key, seed = (proof.genome.hash, proof.task.hash), proof.result.seed
        group = groups.setdefault(key, [])
        for other in group:
            if other.result.seed == seed:
                what = f"{other.path} and {path} are both of {proof.genome.name!r} on {proof.task.name}, seed {seed}"
                raise click.UsageError(f"{what}: a seed counts once")
        group.append(proof)
        seconds[key] = seconds.get(key, 0.0) + time.perf_counter() - begin
    for proofs in groups.values():
        task, given = proofs[0].task, [proof.result.seed for proof in proofs]
        if sorted(given) != sorted(task.seeds):
            what = f"{proofs[0].genome.name}: this is the mean over the seeds {format_seeds(given)}"
            click.echo(visible(f"{what}; the seeds of {task.name} are {format_seeds(task.seeds)}"), err=True)
    return [Evaluation.of(proofs, wall_seconds=seconds[key]) for key, proofs in groups.items()]


def _plot(evaluations: Sequence[Evaluation], path: Path) -> None:
    recordings = [Recording(recording) for each in evaluations for recording in each.recordings]
    if not recordings:
        raise click.ClickException("there is no recording to plot")
    plot_recordings(recordings, path)
