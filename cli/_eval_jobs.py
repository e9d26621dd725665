"""The evaluations of `nmes eval`: run with a progress bar, kept in a file, taken up again after Ctrl-C."""

from __future__ import annotations

import os
import re
import shlex
import signal
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import IO

import click

from nmes.cli._interruptions import interruptions
from nmes.cli._progress import progress_bars
from nmes.errors import visible
from nmes.evaluation import Evaluation, Evaluator, Job
from nmes.evaluation.kept_lines import ChangedLine, sealed, unsealed
from nmes.schemas.files import lock_kept, open_kept

__all__ = ["run_jobs"]

_BEGIN = re.compile(rb'\{"key":"[0-9a-f]{64}",')  # of a line


def run_jobs(
    work: list[Job],
    jobs: int | None,
    ray: str | None,
    resume: Path | None,
    earlier: Iterable[tuple[Job, Evaluation]] = (),
) -> dict[int, Evaluation]:
    """Runs jobs, unless the file of `--resume` has the results, and the recordings are where they belong.

    Args:
        work: The jobs.
        jobs: How many processes.
        ray: The address of a cluster instead.
        resume: The file of `--resume`.
        earlier: Jobs that were run before, which are kept too where this is stopped, and no file has them.

    Returns:
        The evaluations by the index of their job, in the order of the work; after Ctrl-C some are missing.
    """
    with _opened(resume) as file:
        done = {} if resume is None else _results(work, resume)
        left = [i for i in range(len(work)) if i not in done]
        try:
            with (
                progress_bars() as progress,
                interruptions(signal.SIGINT, signal.SIGTERM) as interrupted,
                Evaluator(jobs, ray=ray) as evaluator,
            ):

                def show(count: int, total: int) -> None:
                    progress("evaluating", count, total)
                    if interrupted():
                        raise KeyboardInterrupt

                for place, evaluation in evaluator.run([work[i] for i in left], progress=show):
                    if file is not None:
                        file.write(_line(work[left[place]], evaluation))
                        file.flush()
                    done[left[place]] = evaluation
        except KeyboardInterrupt:
            if file is not None and resume is not None:
                file.close()
                done = _results(work, resume)  # the count is of what the file has, wherever it was interrupted
            _tell_how_to_resume(work, done, resume, earlier)
    return {i: done[i] for i in sorted(done)}


@contextmanager
def _opened(path: Path | None) -> Iterator[IO[bytes] | None]:
    """Gives the file of results to append to, and lets nobody else have it meanwhile: two would spoil it."""
    if path is None:
        yield None
        return
    try:
        descriptor = open_kept(path)
    except OSError as error:
        raise click.UsageError(f"{path} is no file that results could be kept in: {error.strerror}") from error
    with os.fdopen(descriptor, "ab") as file:
        try:
            lock_kept(descriptor, path)
        except BlockingIOError as error:
            raise click.UsageError(f"another nmes eval keeps its results in {path}") from error
        except OSError as error:
            raise click.UsageError(f"results cannot be kept in {path}: {error.strerror}") from error
        yield file


def _results(work: Sequence[Job], path: Path) -> dict[int, Evaluation]:
    """Returns the evaluations that a file has, by the index of their job; what is to be recorded again it has not."""
    results = _read(path)
    done = {i: results[job.key] for i, job in enumerate(work) if job.key in results}
    for i, evaluation in [*done.items()]:
        places = {seed: place for seed, place in work[i].places().items() if place.is_file()}
        if places:
            done[i] = replace(evaluation, recordings=tuple(map(str, places.values())))
        if work[i].record is not None and {each.seed for each in evaluation.results if each.fault is None} - {*places}:
            del done[i]
    return done


def _line(job: Job, evaluation: Evaluation) -> bytes:
    return sealed({"key": job.key, **evaluation.to_json()})


def _read(path: Path) -> dict[str, Evaluation]:
    """Reads the file of an earlier run; a last line of ours that was cut off is taken away, and nothing else ever."""
    content = path.read_bytes()
    *lines, rest = content.split(b"\n")
    results: dict[str, Evaluation] = {}
    for number, line in enumerate(lines, 1):
        try:
            fields = unsealed(line)
            key, evaluation = fields.pop("key"), Evaluation.from_json(fields)
        except ChangedLine as error:
            what = f"{path}, line {number}: not as `nmes eval --resume` wrote it"
            raise click.UsageError(f"{what}: take the line out, and it is done again") from error
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise _foreign(path, number) from error
        before = results.get(key, evaluation)
        # One that could not be evaluated has no results, and may have another name.
        if before.results and evaluation.results and before.results != evaluation.results:
            raise click.UsageError(f"{path}, line {number}: {evaluation.genome} came out otherwise than before")
        results[key] = evaluation
    if rest:
        # A few letters are not known for ours unless there are whole lines before them.
        if not _BEGIN.match(rest) and not (lines and _could_begin(rest)):
            raise _foreign(path, len(lines) + 1)
        os.truncate(path, len(content) - len(rest))
    return results


def _foreign(path: Path, line: int) -> click.UsageError:
    return click.UsageError(f"{path}, line {line}: not what `nmes eval --resume` writes")


def _could_begin(text: bytes) -> bool:
    """Whether a line of ours could begin so."""
    example = b'{"key":"' + b"0" * 64 + b'",'
    return _BEGIN.match(text + example[len(text) :]) is not None


def _tell_how_to_resume(
    work: Sequence[Job],
    done: dict[int, Evaluation],
    resume: Path | None,
    earlier: Iterable[tuple[Job, Evaluation]],
) -> None:
    """Tells the user how to go on; keeps the results where no file has them."""
    click.echo(f"stopped: {len(done)} of {len(work)} done", err=True)
    if resume is not None:
        click.echo("the same command goes on", err=True)
        return
    kept = [*earlier, *((work[i], done[i]) for i in sorted(done))]
    if not kept:
        return
    path = Path(f"eval-{time.strftime('%Y%m%d-%H%M%S')}.jsonl")
    with path.open("xb") as file:
        file.writelines(_line(job, evaluation) for job, evaluation in kept)
    arguments = shlex.join(sys.argv[1:])
    click.echo(visible(f"go on with: nmes {arguments} --resume {path}"), err=True)
