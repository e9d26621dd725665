"""One function over many items, in processes: nothing about the processes shows in the results."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterable, Sequence
from multiprocessing import Pipe, parent_process
from pathlib import Path

import orjson
import pytest

from creatures import snake
from nmes.errors import MissingPackage
from nmes.evaluation import Evaluation, Evaluator, Job, Task, Workers, evaluator
from nmes.evaluation.parallel import Lost, _work, in_processes


def square(number: int) -> tuple[int, int, str | None]:
    return number * number, os.getpid(), os.environ.get("OMP_NUM_THREADS")


def die_over_three(number: int) -> int:
    if number == 3 and parent_process() is not None:
        os.kill(os.getpid(), signal.SIGSEGV)
    return number


def raise_over_one(number: int) -> int:
    return 1 // (number - 1)


def lack_over_three(number: int) -> tuple[int, int]:
    if number == 3:
        raise MemoryError("no room")
    return number, os.getpid()


def lack_a_package(number: int) -> int:
    raise MissingPackage(f"number {number} needs a package")


def wait_or_raise(number: int) -> int:
    if number == 0:
        signal.pause()
    return 1 // (number - 1)


def interrupt_all(number: int) -> int:
    os.kill(os.getpid(), signal.SIGINT)
    return number


def test_every_item_is_worked_on_once_by_workers_with_one_thread() -> None:
    outcomes = dict(in_processes(square, range(7), 3))
    results = [outcomes[i] for i in range(7)]
    assert [result[0] for result in results if not isinstance(result, Lost)] == [i * i for i in range(7)]
    assert {result[2] for result in results if not isinstance(result, Lost)} == {"1"}
    pids = {result[1] for result in results if not isinstance(result, Lost)}
    assert len(pids) == 3 and os.getpid() not in pids
    assert os.environ.get("OMP_NUM_THREADS") != "1"


def test_one_job_runs_in_the_calling_process() -> None:
    here = os.getpid(), os.environ.get("OMP_NUM_THREADS")
    assert list(in_processes(square, [5, 6], 1)) == [(0, (25, *here)), (1, (36, *here))]


def test_a_single_item_that_kills_its_process_kills_no_other() -> None:
    ((place, lost),) = in_processes(die_over_three, [3], 2)
    assert place == 0 and isinstance(lost, Lost) and "SIGSEGV" in lost.reason


def test_a_worker_that_dies_loses_one_item_only() -> None:
    outcomes = dict(in_processes(die_over_three, range(6), 2))
    lost = outcomes.pop(3)
    assert isinstance(lost, Lost) and "SIGSEGV" in lost.reason
    assert outcomes == {i: i for i in (0, 1, 2, 4, 5)}


def test_an_exception_in_a_worker_is_raised_in_the_caller() -> None:
    with pytest.raises(RuntimeError, match="ZeroDivisionError"):
        list(in_processes(raise_over_one, range(3), 2))


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_a_machine_lacks_loses_one_item_only(jobs: int) -> None:
    with Workers(jobs) as workers:
        outcomes = dict(workers.run(lack_over_three, range(6)))
        lost = outcomes.pop(3)
        assert isinstance(lost, Lost) and lost.reason.endswith("MemoryError: no room")
        numbers = {place: outcome[0] for place, outcome in outcomes.items() if not isinstance(outcome, Lost)}
        assert numbers == {i: i for i in (0, 1, 2, 4, 5)}
        assert isinstance(dict(workers.run(lack_over_three, [3]))[0], Lost)


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_package_that_is_missing_is_told_as_that(jobs: int) -> None:
    with pytest.raises(MissingPackage, match="number 7 needs a package"):
        list(in_processes(lack_a_package, [7], jobs))


def test_a_worker_says_nothing_where_its_pipe_ends() -> None:
    ours, workers = Pipe()
    workers.send("an answer that nobody reads")
    ours.close()  # to the worker it is a reset now, not an end
    _work(workers)


def test_workers_ignore_ctrl_c() -> None:
    assert dict(in_processes(interrupt_all, range(3), 2)) == {0: 0, 1: 1, 2: 2}


def test_the_first_worker_of_a_program_ignores_ctrl_c() -> None:
    program = "from test_parallel import *; print(json.dumps(sorted(in_processes(interrupt_all, range(3), 2))))"
    here = Path(__file__).parent
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(here), str(here.parent / "support")])}
    command = [sys.executable, "-c", program]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert json.loads(result.stdout) == [[0, 0], [1, 1], [2, 2]]


def test_workers_end_when_their_results_are_no_longer_taken() -> None:
    results = in_processes(square, range(100), 2)
    _, first = next(results)
    results.close()
    assert not isinstance(first, Lost)
    with pytest.raises(ProcessLookupError):
        os.kill(first[1], 0)


def pids(outcomes: Iterable[tuple[int, tuple[int, int, str | None] | Lost]]) -> set[int]:
    return {result[1] for _, result in outcomes if not isinstance(result, Lost)}


def test_workers_stay_from_call_to_call_and_those_that_died_are_replaced() -> None:
    with Workers(2) as workers:
        first = pids(workers.run(square, range(6)))
        assert pids(workers.run(square, range(6))) == first and len(first) == 2 and os.getpid() not in first
        with pytest.raises(RuntimeError, match="ZeroDivisionError"):
            list(workers.run(wait_or_raise, range(2)))
        second = pids(workers.run(square, range(6)))  # whoever was at work when another raised was ended
        assert len(second) == 2 and len(second & first) == 1
        killed = min(second)
        os.kill(killed, signal.SIGKILL)
        # Nobody looks whether it has died already: either it is replaced, or found dead over an item.
        outcomes = dict(workers.run(square, range(6)))
        results = workers.run(square, range(100))
        next(results)
        results.close()  # whoever takes no more results may go on with other work
        last = pids(workers.run(square, range(6)))
        assert len(outcomes) == 6 and killed not in last
    for pid in first | second | last:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def deadly(portion: Sequence[Job]) -> list[Evaluation]:
    if any(job.name == "killer" for job in portion):
        os.kill(os.getpid(), signal.SIGKILL)
    return [job.failed("alive") for job in portion]


def test_of_creatures_that_run_together_only_the_one_that_kills_its_process_is_lost(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(evaluator, "evaluate_portion", deadly)
    document, task = orjson.dumps(snake()), orjson.dumps(Task.load("walk").document)
    work = [Job("killer" if i == 5 else f"g{i}", document, task) for i in range(12)]
    with Evaluator(2) as workers:
        found = dict(workers.run(work))
    assert "SIGKILL" in str(found.pop(5).error)
    assert len(found) == 11 and {each.error for each in found.values()} == {"alive"}
