"""Evaluations of genomes that come up one by one, as in a run of evolution: workers have work while there is any.

Hides how what waits is cut into portions for a pool of workers, and what becomes of a portion whose process dies.
Results come as they are ready; where and beside which others a genome was evaluated is nothing that shows in them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable, Sequence
from typing import Final

import orjson

from nmes.errors import MachineError
from nmes.evaluation.evaluation import Evaluation
from nmes.evaluation.evaluator import Job, evaluate_portion
from nmes.evaluation.parallel import Lost, Pool
from nmes.evaluation.portions import kind_of, portion_size
from nmes.evaluation.task import Task
from nmes.genome import Genome

__all__ = ["EvaluationQueue"]

_CRASHES: Final = ("SIGSEGV", "SIGABRT", "SIGBUS", "SIGFPE", "SIGILL")  # what a process does to itself
_TRIES: Final = 2
_ENOUGH: Final = 8  # genomes a process that wait, with which one that is free may begin


class EvaluationQueue:
    """Genomes go in, and evaluations come out as they are ready.

    Args:
        task: What the creatures are asked to do.
        seeds: One episode each.
        pool: Who does it.
    """

    def __init__(self, task: Task, seeds: Sequence[int], pool: Pool) -> None:
        self._task, self._seeds, self._pool = orjson.dumps(task.document), tuple(seeds), pool
        self._duty = task.duty
        self._waiting: dict[Hashable, deque[tuple[int, Job]]] = {}  # by their kind
        self._alone: deque[tuple[int, Job]] = deque()  # of portions that were lost: each by itself
        self._lost: dict[int, int] = {}  # how often by itself
        self._given: dict[int, dict[int, Job]] = {}  # portions that are being worked on, by their number
        self._portions = 0
        self._count = 0  # of those that wait

    def put(self, number: int, genome: Genome) -> None:
        """Has a genome evaluated; the evaluation comes with this number, which is above those before."""
        document = orjson.dumps(genome.document)
        job = Job(genome.name, document, self._task, self._seeds, duty=self._duty)
        self._waiting.setdefault(kind_of(document), deque()).append((number, job))
        self._count += 1
        # One process takes all there is at once; several should not idle while others come up.
        if self._pool.jobs > 1 and self._count >= _ENOUGH * self._pool.jobs:
            self._feed()

    def take(self) -> list[tuple[int, Evaluation]]:
        """Waits until something is ready, and returns the numbers and evaluations; none where nothing is left.

        A creature over which its process crashes has that as its `error`.

        Raises:
            MachineError: Something else ends the processes of workers (`worker_killed`).
        """
        found: list[tuple[int, Evaluation]] = []
        self._feed()
        while self._given and not found:
            for portion, results in self._pool.take():
                found += self._taken(self._given.pop(portion), results)
            self._feed()
        return found

    def _feed(self) -> None:
        while self._pool.free and (self._alone or self._waiting):
            jobs = dict([self._alone.popleft()] if self._alone else self._portion())
            self._given[self._portions] = jobs
            self._pool.give(self._portions, evaluate_portion, list(jobs.values()))
            self._portions += 1

    def _portion(self) -> list[tuple[int, Job]]:
        """Takes some of the kind of what has waited longest, since that is what the order of a run waits for."""
        kind = min(self._waiting, key=lambda kind: self._waiting[kind][0][0])
        jobs = self._waiting[kind]
        size = portion_size(self._count, len(self._seeds), self._pool.jobs)
        portion = [jobs.popleft() for _ in range(min(size, len(jobs)))]
        if not jobs:
            del self._waiting[kind]
        self._count -= len(portion)
        return portion

    def _taken(self, jobs: dict[int, Job], results: list[Evaluation] | Lost) -> list[tuple[int, Evaluation]]:
        if not isinstance(results, Lost):
            return list(zip(jobs, results, strict=True))
        if len(jobs) == 1:
            ((number, job),) = jobs.items()
            self._lost[number] = self._lost.get(number, 0) + 1
            if self._lost[number] == _TRIES:
                if not any(crash in results.reason for crash in _CRASHES):
                    # It may be the machine's doing, as where memory is short: then it says nothing of the creature.
                    what = f"over {job.name!r} {results.reason}, {_TRIES} times"
                    raise MachineError("worker_killed", f"{what}: is there memory enough, with fewer jobs?")
                return [(number, job.failed(results.reason))]
        self._alone.extend(jobs.items())  # one of them did it; the others are done again without it
        return []
