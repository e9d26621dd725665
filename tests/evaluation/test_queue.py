"""Genomes that come up one by one: evaluated as all together, by workers that always have something to do."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any

import pytest

from creatures import snake
from duels import duel, push
from modelled import modelled
from nmes.errors import MachineError, MissingPackage
from nmes.evaluation import Evaluation, Evaluator, Job, Task, evaluate, population
from nmes.evaluation.bouts import Bout, play_bouts
from nmes.evaluation.contest import Rivals
from nmes.evaluation.parallel import Here, Lost, Workers
from nmes.evaluation.queue import EvaluationQueue
from nmes.genome import Genome
from nmes.world import World
from populations import draw_population

TASK = Task(
    {
        "format": "nmes-task/1",
        "name": "moment",
        "description": "Get far in a moment.",
        "duration": 0.2,
        "settle": 0,
        "settle_limit": 0.25,
        "seeds": [1, 2],
        "objective": "displacement.horizontal",
    }
)


class Notes(Workers):
    """Workers in this process that note the sizes of portions, and have a fate for each creature."""

    def __init__(self, jobs: int, fates: dict[str, list[str]] | None = None) -> None:
        super().__init__(jobs)
        self.given: list[list[str]] = []
        self._fates = fates or {}
        self._work: list[tuple[int, Callable[[Any], Any], Sequence[Job]]] = []

    @property
    def free(self) -> int:
        return self.jobs - len(self._work)

    def give(self, number: int, function: Callable[[Any], Any], item: object) -> None:
        assert isinstance(item, list)
        self.given.append([job.name for job in item])
        self._work.append((number, function, item))

    def take(self) -> list[tuple[int, Any]]:
        number, function, portion = self._work.pop(0)
        for job in portion:
            if self._fates.get(job.name):
                return [(number, Lost(f"the process was killed by {self._fates[job.name].pop(0)}"))]
        return [(number, function(portion))]


def all_of(queue: EvaluationQueue) -> dict[int, Evaluation]:
    found: dict[int, Evaluation] = {}
    while ready := queue.take():
        assert not found.keys() & dict(ready).keys()
        found.update(ready)
    return found


def test_evaluations_are_those_of_all_together_whenever_their_genomes_came() -> None:
    genomes = draw_population(5, 9)
    together = Evaluator(1).evaluate_population(genomes, TASK)
    queue = EvaluationQueue(TASK, TASK.seeds, Here())
    found: dict[int, Evaluation] = {}
    for number, genome in enumerate(genomes):
        queue.put(number, genome)
        if number % 4 == 3:
            found.update(queue.take())
    found.update(all_of(queue))
    assert [found[number] for number in range(len(genomes))] == together
    assert queue.take() == []


def test_workers_are_given_something_as_soon_as_there_is_enough_and_kinds_stay_together() -> None:
    pool = Notes(2)
    queue = EvaluationQueue(TASK, (1,), pool)
    for number in range(40):
        segments = 2 + number % 2
        queue.put(number, Genome(snake(segments=segments, name=f"{segments} {number}")))
    assert len(pool.given) == 2  # before anybody waits for a result
    all_of(queue)
    names = [name for portion in pool.given for name in portion]
    assert sorted(names) == sorted(f"{2 + number % 2} {number}" for number in range(40))
    assert all(len({name.split()[0] for name in portion}) == 1 for portion in pool.given)
    assert pool.given[0][0] == "2 0" and pool.given[1][0] == "3 1"  # what has waited longest comes first
    assert max(map(len, pool.given)) <= 10  # no worker has so much that another has to wait for it


def test_of_a_portion_that_is_lost_only_who_crashes_its_process_has_an_error() -> None:
    genomes = [Genome(snake(name=name)) for name in ("a", "killer", "b", "c")]
    pool = Notes(1, {"killer": ["SIGSEGV", "SIGSEGV", "SIGSEGV"]})
    queue = EvaluationQueue(TASK, (1,), pool)
    for number, genome in enumerate(genomes):
        queue.put(number, genome)
    found = all_of(queue)
    assert "SIGSEGV" in str(found[1].error) and [found[number].error for number in (0, 2, 3)] == [None] * 3
    assert pool.given == [["a", "killer", "b", "c"], ["a"], ["killer"], ["b"], ["c"], ["killer"]]


@pytest.mark.parametrize(("kills", "lost"), [(1, False), (2, True)])
def test_a_kill_from_outside_is_no_fault_of_the_creature(kills: int, lost: bool) -> None:
    pool = Notes(1, {"victim": ["SIGKILL"] * kills})
    queue = EvaluationQueue(TASK, (1,), pool)
    queue.put(0, Genome(snake(name="victim")))
    if lost:
        with pytest.raises(MachineError) as error:
            all_of(queue)
        assert error.value.code == "worker_killed"
    else:
        assert all_of(queue)[0].error is None


@pytest.mark.parametrize("error", [MemoryError(), OSError(24, "too many open files")])
@pytest.mark.parametrize("place", [(population, "_begin"), (World, "_advance")], ids=["before", "in the engine"])
def test_what_a_machine_lacks_once_is_no_fault_of_the_creature(
    monkeypatch: pytest.MonkeyPatch, place: tuple[object, str], error: Exception
) -> None:
    genome = Genome(snake(name="victim"))
    untroubled = Evaluator(1).evaluate_population([genome], TASK, seeds=(1,))[0]
    proper, errors = getattr(*place), [error]

    def troubled(*arguments: Any) -> Any:
        if errors:
            raise errors.pop()
        return proper(*arguments)

    monkeypatch.setattr(*place, troubled)
    queue = EvaluationQueue(TASK, (1,), Here())
    queue.put(0, genome)
    assert all_of(queue)[0] == untroubled
    errors += [error] * 2
    queue.put(1, genome)
    with pytest.raises(MachineError, match=f"{type(error).__name__}.*2 times") as info:
        all_of(queue)
    assert info.value.code == "worker_killed"


def test_a_package_that_is_missing_is_no_fault_of_the_creature(monkeypatch: pytest.MonkeyPatch) -> None:
    genome = Genome(modelled())
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    queue = EvaluationQueue(TASK, (1,), Here())
    queue.put(0, genome)
    evaluator = Evaluator(1)
    for evaluated in (queue.take, lambda: evaluate(genome, TASK), lambda: evaluator.evaluate(genome, TASK)):
        with pytest.raises(MissingPackage, match=r"pip install 'nmes\[onnx\]'"):
            evaluated()


def test_a_package_that_is_missing_is_no_fault_of_those_in_a_match(monkeypatch: pytest.MonkeyPatch) -> None:
    def lacking(_: Genome) -> None:
        raise MissingPackage("a brain needs a package")

    monkeypatch.setattr("nmes.evaluation.match.brain_of", lacking)
    task, cart = duel(), Genome(push())
    queue = EvaluationQueue(task, task.seeds, Here())
    queue.put(0, cart, Rivals("red", ((cart,),)))
    with pytest.raises(MissingPackage):
        queue.take()
    with pytest.raises(MissingPackage):
        list(play_bouts(Here(), [Bout.of(task, {"red": cart, "blue": cart}, 1)]))
