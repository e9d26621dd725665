"""Evaluations of genomes that come up one by one, as in a run of evolution: workers have work while there is any.

Hides how what waits is cut into portions for a pool of workers, and what becomes of a portion whose process dies.
Results come as they are ready; where and beside which others a genome was evaluated is nothing that shows in them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable, Sequence
from typing import Any, Final, TypeAlias

import orjson

from nmes.errors import MachineError
from nmes.evaluation.contest import Contest, Rivals, evaluate_contests
from nmes.evaluation.evaluation import Evaluation
from nmes.evaluation.evaluator import Job, evaluate_portion
from nmes.evaluation.match_task import MatchTask
from nmes.evaluation.parallel import Lost, Pool
from nmes.evaluation.portions import kind_of, portion_size
from nmes.evaluation.task import Task
from nmes.genome import Genome

__all__ = ["CRASHES", "EvaluationQueue"]

CRASHES: Final = ("SIGSEGV", "SIGABRT", "SIGBUS", "SIGFPE", "SIGILL")
"""What a process does to itself."""
_TRIES: Final = 2
_ENOUGH: Final = 8  # genomes a process that wait, with which one that is free may begin

Work: TypeAlias = "Job | Contest"


class EvaluationQueue:
    """Genomes go in, and evaluations come out as they are ready.

    Args:
        task: What the creatures are asked to do; one with roles is played against rivals.
        seeds: One episode each; the matches of a creature take turns with them.
        pool: Who does it.
    """

    def __init__(self, task: Task | MatchTask, seeds: Sequence[int], pool: Pool) -> None:
        self._task, self._seeds, self._pool = orjson.dumps(task.document), tuple(seeds), pool
        self._matches = isinstance(task, MatchTask)
        self._duty = isinstance(task, Task) and task.duty
        self._waiting: dict[Hashable, deque[tuple[int, Work]]] = {}  # by their kind
        self._alone: deque[tuple[int, Work]] = deque()  # of portions that were lost: each by itself
        self._lost: dict[int, int] = {}  # how often by itself
        self._given: dict[int, dict[int, Work]] = {}  # portions that are being worked on, by their number
        self._portions = 0
        self._count = 0  # of those that wait

    def put(self, number: int, genome: Genome, rivals: Rivals | None = None) -> None:
        """Has a genome evaluated; the evaluation comes with this number, which is above those before.

        Args:
            number: The number.
            genome: The genome.
            rivals: Whom it meets, where the task has roles, and only there.
        """
        document = orjson.dumps(genome.document)
        job: Work
        if rivals is None:
            job = Job(genome.name, document, self._task, self._seeds, duty=self._duty)
        else:
            lineups = tuple(tuple(orjson.dumps(each.document) for each in lineup) for lineup in rivals.lineups)
            job = Contest(genome.name, document, self._task, self._seeds, rivals.role, lineups)
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
            evaluate: Callable[[Any], Any] = evaluate_contests if self._matches else evaluate_portion
            self._pool.give(self._portions, evaluate, list(jobs.values()))
            self._portions += 1

    def _portion(self) -> list[tuple[int, Work]]:
        """Takes some of the kind of what has waited longest, since that is what the order of a run waits for.

        Matches gain nothing by being played beside others, so that of those it is one creature's.
        """
        kind = min(self._waiting, key=lambda kind: self._waiting[kind][0][0])
        jobs = self._waiting[kind]
        size = 1 if self._matches else portion_size(self._count, len(self._seeds), self._pool.jobs)
        portion = [jobs.popleft() for _ in range(min(size, len(jobs)))]
        if not jobs:
            del self._waiting[kind]
        self._count -= len(portion)
        return portion

    def _taken(self, jobs: dict[int, Work], results: list[Evaluation] | Lost) -> list[tuple[int, Evaluation]]:
        if not isinstance(results, Lost):
            return list(zip(jobs, results, strict=True))
        if len(jobs) == 1:
            ((number, job),) = jobs.items()
            self._lost[number] = self._lost.get(number, 0) + 1
            if self._lost[number] == _TRIES:
                if not any(crash in results.reason for crash in CRASHES):
                    # It may be the machine's doing, as where memory is short: then it says nothing of the creature.
                    what = f"over {job.name!r} {results.reason}, {_TRIES} times"
                    raise MachineError("worker_killed", f"{what}: is there memory enough, with fewer jobs?")
                return [(number, job.failed(results.reason))]
        self._alone.extend(jobs.items())  # one of them did it; the others are done again without it
        return []
