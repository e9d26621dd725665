"""The evaluations of `nmes eval`: run with a progress bar, kept in a file, taken up again after Ctrl-C."""

from __future__ import annotations

import os
import shlex
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

import click
import orjson

from nmes.cli._progress import progress_bars
from nmes.evaluation import Evaluation, Job, evaluate_all

__all__ = ["run_jobs"]


def run_jobs(work: list[Job], jobs: int, ray: str | None, resume: Path | None) -> tuple[list[Evaluation], bool]:
    """Runs jobs, but for those whose results the file of `--resume` has.

    Returns:
        The evaluations in the order of the work, and whether that is all of them.
    """
    done: dict[int, Evaluation] = {}
    file = None
    if resume is not None:
        done = _results(work, resume)
        file = resume.open("ab")
    left = [i for i in range(len(work)) if i not in done]
    try:
        with progress_bars(len(work) > 1) as progress, _interruptions() as interrupted:
            progress("evaluating", len(done), len(work))
            for place, evaluation in evaluate_all([work[i] for i in left], jobs=jobs, ray=ray):
                if file is not None:
                    file.write(_line(work[left[place]], evaluation))
                    file.flush()
                done[left[place]] = evaluation
                progress("evaluating", len(done), len(work))
                if interrupted():
                    raise KeyboardInterrupt
    except KeyboardInterrupt:
        if file is not None and resume is not None:
            file.close()
            done = _results(work, resume)  # the count is of what the file has, wherever it was interrupted
        _tell_how_to_resume(work, done, resume)
    finally:
        if file is not None:
            file.close()
    return [done[i] for i in sorted(done)], len(done) == len(work)


@contextmanager
def _interruptions() -> Iterator[Callable[[], bool]]:
    """Gives a function that tells whether Ctrl-C was pressed.

    Python loses the exception if that was while a destructor ran.
    """
    pressed = False

    def interrupt(*_: object) -> NoReturn:
        nonlocal pressed
        pressed = True
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, interrupt)
    try:
        yield lambda: pressed
    finally:
        signal.signal(signal.SIGINT, before)


def _results(work: Sequence[Job], path: Path) -> dict[int, Evaluation]:
    """Returns the evaluations that a file has, by the index of their job."""
    results = _read(path)
    return {i: results[job.key] for i, job in enumerate(work) if job.key in results}


def _line(job: Job, evaluation: Evaluation) -> bytes:
    return orjson.dumps({"key": job.key, **evaluation.to_json()}, option=orjson.OPT_APPEND_NEWLINE)


def _read(path: Path) -> dict[str, Evaluation]:
    """Reads the file of an earlier run; a last line that was cut off is taken away."""
    if not path.exists():
        return {}
    content = path.read_bytes()
    whole = content[: content.rfind(b"\n") + 1]
    results = {}
    for number, line in enumerate(whole.splitlines(), 1):
        try:
            fields = orjson.loads(line)
            results[fields.pop("key")] = Evaluation.from_json(fields)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise click.UsageError(f"{path}, line {number}: not what `nmes eval --resume` writes") from error
    if len(whole) < len(content):
        os.truncate(path, len(whole))
    return results


def _tell_how_to_resume(work: Sequence[Job], done: dict[int, Evaluation], resume: Path | None) -> None:
    """Tells the user how to go on; keeps the results where no file has them."""
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
