"""`nmes eval`: what creatures score on a task."""

from __future__ import annotations

import csv
import os
import shlex
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

import click
import orjson
from click.core import ParameterSource
from rich.console import Console
from rich.table import Table

from nmes.cli._course import plot_courses
from nmes.cli._genomes import find_genomes
from nmes.cli._progress import progress_bars
from nmes.errors import DocumentError
from nmes.evaluation import Evaluation, Job, Proof, evaluate_all, prove
from nmes.evaluation.task import Task
from nmes.genome import Genome
from nmes.recording import Recording

__all__ = ["command"]

_CSV = (
    "genome",
    "genome_hash",
    "task",
    "task_hash",
    "score",
    "spread",
    "energy",
    "distance",
    "faults",
    "error",
    "wall_seconds",
)


def _seeds(_: click.Context, parameter: click.Parameter, value: str | None) -> tuple[int, ...] | None:
    """Reads `1,2,3` and `0-9`."""
    if value is None:
        return None
    seeds: list[int] = []
    try:
        for part in value.split(","):
            first, _dash, last = part.strip().partition("-")
            seeds += range(int(first), int(last or first) + 1)
    except ValueError:
        raise click.BadParameter(
            f"{value!r} is no list of seeds; expected such as 1,2,3 or 0-9", param=parameter
        ) from None
    if not seeds or len(set(seeds)) < len(seeds):
        raise click.BadParameter("expected one seed or more, each once", param=parameter)
    return tuple(seeds)


@click.command("eval")
@click.argument("genomes", metavar="GENOME...", nargs=-1)
@click.option(
    "--task", metavar="T", default="walk", show_default=True, help="A file, or the name of a task that ships."
)
@click.option("--seeds", metavar="LIST", callback=_seeds, help="Such as 1,2,3 or 0-9.  [default: the task's]")
@click.option("--record", type=click.Path(file_okay=False, path_type=Path), help="Leave a recording of each here.")
@click.option(
    "--from-recording",
    "recordings",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    multiple=True,
    help="Score recordings again, from their logs alone; what follows are recordings too.",
)
@click.option("--jobs", type=click.IntRange(1), help="How many processes.  [default: one a core]")
@click.option("--ray", metavar="ADDRESS", help="Use a Ray cluster instead: HOST:PORT, auto, or local.")
@click.option("--resume", type=click.Path(dir_okay=False, path_type=Path), help="Keep results here; skip what it has.")
@click.option(
    "--plot",
    "plot_to",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write score, height, energy and gait over time to an SVG; with --record or --from-recording.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the results as JSON.")
@click.option("--csv", "as_csv", is_flag=True, help="Print the results as CSV.")
@click.pass_context
def command(
    context: click.Context,
    genomes: tuple[str, ...],
    task: str,
    seeds: tuple[int, ...] | None,
    record: Path | None,
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
    time, whatever --jobs says.

    Ctrl-C keeps what is done: the results so far go to the file of --resume, or to a new one that is named, from which
    the same command goes on.

    Exit status: 0 good, 1 a creature could not be evaluated, its world faulted, or a recording proves nothing, 2 wrong
    usage.

    For example:

    \b
        nmes eval walker
        nmes eval walker 'evolved/*.json' --task walk --seeds 1-5 --record proofs
        nmes eval --from-recording proofs/walk-walker-1.mcap --json
        nmes eval walker --seeds 1-3 --record proofs --plot walker.svg
    """
    given = {name for name in context.params if context.get_parameter_source(name) is ParameterSource.COMMANDLINE}
    if recordings and given - {"recordings", "genomes", "as_json", "as_csv", "plot_to"}:
        raise click.UsageError("--from-recording scores what recordings hold: only --json, --csv and --plot go with it")
    if not recordings and not genomes:
        raise click.UsageError("name a genome to score, or a recording with --from-recording")
    if as_json and as_csv:
        raise click.UsageError("either --json or --csv")
    if plot_to is not None and not recordings and record is None:
        raise click.UsageError("--plot is drawn from recordings: give --record, or --from-recording")
    if jobs is not None and ray is not None:
        raise click.UsageError("either --jobs or --ray")
    if recordings:
        more = (Path(name) for name in genomes)  # as a shell's *.mcap leaves them
        found, whole = _score([*recordings, *more]), True
    else:
        try:
            asked = orjson.dumps(Task.load(task).document)
        except DocumentError as error:
            raise click.BadParameter(f"{task}:\n{error.message}", param_hint="--task") from error
        into = None if record is None else str(record)
        work = [Job(Path(name).stem, _read_genome(name), asked, seeds, into) for name in find_genomes(genomes)]
        if record is not None:
            record.mkdir(parents=True, exist_ok=True)
        found, whole = _evaluate(work, jobs or os.cpu_count() or 1, ray, resume)
    _print(found, as_json, as_csv)
    if plot_to is not None:
        made = [path for each in found for path in each.recordings]
        if not made:
            raise click.ClickException("there is no recording to plot")
        plot_courses([Recording(path) for path in made], plot_to)
    sys.exit(0 if whole and all(each.error is None and not each.faults for each in found) else 1)


def _read_genome(name: str) -> bytes:
    """Returns the bytes of a file or of a genome that ships."""
    if not os.path.exists(name):
        return orjson.dumps(Genome.load(name).document)
    try:
        return Path(name).read_bytes()
    except OSError as error:
        raise click.UsageError(f"cannot read {name}: {error.strerror}") from error


def _score(recordings: Sequence[Path]) -> list[Evaluation]:
    """Returns what recordings prove, those of one genome and task together, in order of their seeds."""
    groups: dict[tuple[str, str], list[Proof]] = {}
    took: dict[tuple[str, str], float] = {}
    for path in recordings:
        began = time.perf_counter()
        proof = prove(path)
        key = proof.genome.hash, proof.task.hash
        groups.setdefault(key, []).append(proof)
        took[key] = took.get(key, 0.0) + time.perf_counter() - began
    return [Evaluation.of(proofs, wall_seconds=took[key]) for key, proofs in groups.items()]


# -- the run ----------------------------------------------------------------------------------------------------------


def _evaluate(work: list[Job], jobs: int, ray: str | None, resume: Path | None) -> tuple[list[Evaluation], bool]:
    """Returns the evaluations in the order of the work, and whether that is all of them."""
    done: dict[int, Evaluation] = {}
    keep = None
    if resume is not None:
        done = _held(work, resume)
        keep = resume.open("ab")
    left = [i for i in range(len(work)) if i not in done]
    try:
        with progress_bars(len(work) > 1) as progress, _listening() as pressed:
            progress("evaluating", len(done), len(work))
            for place, evaluation in evaluate_all([work[i] for i in left], jobs=jobs, ray=ray):
                if keep is not None:
                    keep.write(_line(work[left[place]], evaluation))
                    keep.flush()
                done[left[place]] = evaluation
                progress("evaluating", len(done), len(work))
                if pressed():
                    raise KeyboardInterrupt
    except KeyboardInterrupt:
        if keep is not None and resume is not None:
            keep.close()
            done = _held(work, resume)  # what is told is what is kept, wherever it was interrupted
        _interrupted(work, done, resume)
    finally:
        if keep is not None:
            keep.close()
    return [done[i] for i in sorted(done)], len(done) == len(work)


@contextmanager
def _listening() -> Iterator[Callable[[], bool]]:
    """Gives what tells whether Ctrl-C was pressed: Python loses the exception if that was while a destructor ran."""
    heard = False

    def hear(*_: object) -> NoReturn:
        nonlocal heard
        heard = True
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, hear)
    try:
        yield lambda: heard
    finally:
        signal.signal(signal.SIGINT, before)


def _held(work: Sequence[Job], path: Path) -> dict[int, Evaluation]:
    kept = _read(path)
    return {i: kept[job.key] for i, job in enumerate(work) if job.key in kept}


def _line(job: Job, evaluation: Evaluation) -> bytes:
    return orjson.dumps({"key": job.key, **evaluation.to_json()}, option=orjson.OPT_APPEND_NEWLINE)


def _read(path: Path) -> dict[str, Evaluation]:
    """Reads what an earlier run left; a last line that was cut off is taken away."""
    if not path.exists():
        return {}
    held = path.read_bytes()
    whole = held[: held.rfind(b"\n") + 1]
    kept = {}
    for number, line in enumerate(whole.splitlines(), 1):
        try:
            fields = orjson.loads(line)
            kept[fields.pop("key")] = Evaluation.from_json(fields)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise click.UsageError(f"{path}, line {number}: not what `nmes eval --resume` writes") from error
    if len(whole) < len(held):
        os.truncate(path, len(whole))
    return kept


def _interrupted(work: Sequence[Job], done: dict[int, Evaluation], resume: Path | None) -> None:
    """Says how to go on, and keeps what is done where nothing else does."""
    click.echo(f"stopped: {len(done)} of {len(work)} done", err=True)
    if resume is not None:
        click.echo("the same command goes on", err=True)
        return
    if not done:
        return
    path = Path(f"eval-{time.strftime('%Y%m%d-%H%M%S')}.jsonl")
    with path.open("xb") as file:
        file.writelines(_line(work[i], done[i]) for i in sorted(done))
    arguments = shlex.join(sys.argv[1:])
    click.echo(f"go on with: nmes {arguments} --resume {path}", err=True)


# -- what comes out ---------------------------------------------------------------------------------------------------


def _print(found: Sequence[Evaluation], as_json: bool, as_csv: bool) -> None:
    if as_json:
        click.echo(orjson.dumps([each.to_json() for each in found], option=orjson.OPT_INDENT_2))
    elif as_csv:
        writer = csv.DictWriter(sys.stdout, _CSV, extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        writer.writerows(each.to_json() for each in found)
    else:
        _table(found)


def _table(found: Sequence[Evaluation]) -> None:
    columns = ("seeds", "score", "spread", "energy\n(J)", "distance\n(m)", "faults", "time\n(s)")
    table = Table("genome", "task", box=None, pad_edge=False)
    table.columns[0].overflow = "fold"
    for title in columns:
        table.add_column(title, justify="right", no_wrap=True)
    names = Counter(each.genome for each in found)
    for each in found:
        same = names[each.genome] > 1 and each.genome_hash
        table.add_row(
            f"{each.genome} {each.genome_hash[:4]}" if same else each.genome,
            each.task,
            _runs([result.seed for result in each.results]),
            _number(each.score, 3),
            _number(each.spread, 3),
            _number(each.energy, 1),
            _number(each.distance, 2),
            "" if each.error else str(each.faults),
            f"{each.wall_seconds:.2f}",
        )
    console = Console(markup=False, highlight=False)
    console.print(table)
    if any(each.error is not None or each.faults for each in found):
        console.print()
    for each in found:
        if each.error is not None:
            told = each.error.replace("\n", "\n  ")
            console.print(f"{each.genome}: {told}", soft_wrap=True)
        for result in each.results:
            if result.fault is not None:
                console.print(f"{each.genome}, seed {result.seed}, tick {result.ticks}: {result.fault}", soft_wrap=True)


def _runs(seeds: Sequence[int]) -> str:
    """Writes seeds as `--seeds` reads them: `1-3,7`."""
    runs: list[list[int]] = []
    for seed in sorted(seeds):
        if runs and seed == runs[-1][-1] + 1:
            runs[-1].append(seed)
        else:
            runs.append([seed])
    return ",".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else str(run[0]) for run in runs)


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
