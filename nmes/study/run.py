"""All runs of a study: several at once, each kept whole as soon as it is done.

Hides the folder in which they are kept, one for each hash of what is asked, of the tasks and genomes that ship, which
commands may name, and of what computes alike. A kill costs what was under way: whoever comes next does that again, and
since runs depend on nothing else, nobody sees that there was a kill.
"""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Final

import orjson

from nmes.backend import load_backend
from nmes.backend.fingerprint import decisive, fingerprint
from nmes.errors import StudyError
from nmes.evaluation.setting import MATCHES
from nmes.evaluation.setting import SHIPPED as TASKS
from nmes.genome.genome import SHIPPED as GENOMES
from nmes.schemas.documents import JsonObject, canonical_hash
from nmes.schemas.files import lock_kept
from nmes.study.commands import Stopped, Stopper, perform
from nmes.study.document import Plan, PlannedRun
from nmes.study.results import Results, is_row, row_of, write_file

__all__ = ["Progress", "count_done", "do_runs", "run_study"]

_LOOK: Final = 0.2  # s between looks at whether somebody has pressed Ctrl-C

Progress = Callable[[int, int], None]


def run_study(plan: Plan, jobs: int, progress: Progress) -> Results:
    """Does all runs of a plan that are not done yet, and writes the results.

    Args:
        plan: Which.
        jobs: How many at once; of a study that measures, one, whatever it says: runs would disturb each other.
        progress: Called now and then with how many are done, and how many there are.

    Raises:
        StudyError: A command fails (`command_failed`), another process does this study (`study_busy`), or something
            cannot be written (`cannot_write`). What is done is kept.
        MissingPackage: pyarrow is not installed.
    """
    work = _work(plan)
    with _locked(work):
        done = {run.number: row for run in plan.runs if (row := _kept(plan, work, run)) is not None}
        missing = [run for run in plan.runs if run.number not in done]
        before = len(done)

        def tell(count: int) -> None:
            progress(before + count, len(plan.runs))

        with closing(do_runs(plan, missing, jobs, work / "under-way", tell)) as under_way:
            for run, columns in under_way:
                done[run.number] = row_of(run, columns)
                write_file(_place(work, run), orjson.dumps(done[run.number]))
    results = Results.here(plan, [done[run.number] for run in plan.runs])
    results.write(plan)
    return results


def do_runs(
    plan: Plan, runs: Iterable[PlannedRun], jobs: int, folder: Path, tell: Callable[[int], None]
) -> Generator[tuple[PlannedRun, JsonObject], None, None]:
    """Does some runs; whoever takes no more, or is interrupted, ends those that are under way.

    Args:
        plan: Of which plan.
        runs: Which.
        jobs: As of `run_study`.
        folder: In which they write; what they wrote goes when they are done.
        tell: Called now and then with how many are done.

    Yields:
        Each with its columns, as soon as it is done.

    Raises:
        StudyError: As of `perform`, once none is under way any more: those that were done meanwhile are yielded before.
    """
    shutil.rmtree(folder, ignore_errors=True)  # what a kill has left
    stopper, waiting, count = Stopper(), list(reversed(list(runs))), 0
    jobs = 1 if plan.study.document["measured"] else jobs

    def do(run: PlannedRun) -> JsonObject:
        own = folder / f"{run.number}-{secrets.token_hex(4)}"
        own.mkdir(parents=True)
        try:
            return perform(plan.study, run, own, stopper)
        finally:
            shutil.rmtree(own, ignore_errors=True)

    with ThreadPoolExecutor(jobs) as pool:
        under_way: dict[Future[JsonObject], PlannedRun] = {}
        failures: list[BaseException] = []
        try:
            tell(0)
            while under_way or (waiting and not failures):
                while waiting and not failures and len(under_way) < jobs:
                    run = waiting.pop()
                    under_way[pool.submit(do, run)] = run
                ended = wait(under_way, _LOOK, FIRST_COMPLETED).done
                for future in sorted(ended, key=lambda each: under_way[each].number):
                    run, failure = under_way.pop(future), future.exception()
                    if failure is None:
                        count += 1
                        yield run, future.result()
                    elif not isinstance(failure, Stopped):
                        failures.append(failure)
                if failures:
                    stopper.stop()
                tell(count)
            if failures:
                raise failures[0]
        finally:
            stopper.stop()
            for future in under_way:
                future.exception()  # waits until it is cut off
    shutil.rmtree(folder, ignore_errors=True)


def count_done(plan: Plan) -> int:
    """Counts the runs of a plan that are done here, and kept."""
    work = _work(plan)
    return sum(_place(work, run).exists() for run in plan.runs)


def _work(plan: Plan) -> Path:
    """Returns where runs are kept: those of this very plan, and of what computes alike."""
    shipped = [{name: place.shipped(name).decode() for name in place.names()} for place in (TASKS, MATCHES, GENOMES)]
    here = canonical_hash({"here": decisive(fingerprint(load_backend("mujoco"))), "shipped": shipped})
    return plan.study.folder / "work" / f"{plan.budget}-{plan.asked[:16]}-{here[:8]}"


def _place(work: Path, run: PlannedRun) -> Path:
    return work / "done" / f"{run.number:06}.json"


def _kept(plan: Plan, work: Path, run: PlannedRun) -> JsonObject | None:
    """Returns the row of a run that was done before; None if there is none."""
    path = _place(work, run)
    try:
        row: JsonObject = orjson.loads(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise StudyError("no_results", f"cannot read {path}: {error}; remove it, and that run is done again") from error
    if not is_row(plan, run, row):
        raise StudyError("no_results", f"{path} is no row of {run}: remove it, and that run is done again")
    return row


@contextmanager
def _locked(work: Path) -> Iterator[None]:
    """Keeps other processes from doing the same study meanwhile."""
    try:
        work.mkdir(parents=True, exist_ok=True)
        file = os.open(work / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except OSError as error:
        raise StudyError("cannot_write", f"cannot write {work}: {error.strerror}") from error
    try:
        try:
            lock_kept(file, work / "lock")
        except BlockingIOError as error:
            raise StudyError("study_busy", f"another process does the study in {work}") from error
        except OSError as error:
            raise StudyError("cannot_write", f"cannot write {work}: {error.strerror}") from error
        yield
    finally:
        os.close(file)
