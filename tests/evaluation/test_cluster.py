"""One function over many items on a Ray cluster: what is lost on the way is done again, and shows in no result."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from creatures import snake
from nmes.errors import MachineError
from nmes.evaluation import Task
from nmes.evaluation.evaluation import Evaluation
from nmes.evaluation.parallel import Cluster, Here, Lost, Pool
from nmes.evaluation.queue import EvaluationQueue
from nmes.genome import Genome
from servers import PATIENCE

pytest.importorskip("ray")


def actor_and_process(_: int) -> tuple[int, int, str | None]:
    time.sleep(0.2)  # so that nobody does all
    return os.getppid(), os.getpid(), os.environ.get("OMP_NUM_THREADS")


def die_over_three(number: int) -> int:
    if number == 3:
        os.kill(os.getpid(), signal.SIGSEGV)
    return number


def lose_the_actor_once(mark: str) -> str:
    path = Path(mark)
    if path.exists():
        return path.read_text()
    path.write_text("done again")
    os.kill(os.getppid(), signal.SIGKILL)
    return "nobody hears this"


def lose_every_actor(number: int) -> int:
    if number == 0:
        os.kill(os.getppid(), signal.SIGKILL)
    return number


def raise_over_one(number: int) -> int:
    return 1 // (number - 1)


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    """A cluster of this machine's cores, whose processes find this module."""
    before = os.environ.get("PYTHONPATH")
    here = Path(__file__).parent
    os.environ["PYTHONPATH"] = os.pathsep.join([str(here), str(here.parent / "support"), *([before] if before else [])])
    try:
        with Cluster("local") as opened:
            yield opened
    finally:
        if before is None:
            del os.environ["PYTHONPATH"]
        else:
            os.environ["PYTHONPATH"] = before


def actors(cluster: Cluster) -> set[int]:
    """Returns the processes of the actors, when all have begun."""
    until = time.monotonic() + PATIENCE
    while True:
        results = dict(cluster.run(actor_and_process, range(3 * cluster.jobs))).values()
        assert {result[2] for result in results if not isinstance(result, Lost)} == {"1"}
        found = {result[0] for result in results if not isinstance(result, Lost)}
        if len(found) >= cluster.jobs or time.monotonic() > until:
            return found


def test_there_is_one_actor_a_core_and_it_stays(cluster: Cluster) -> None:
    first = actors(cluster)
    assert len(first) == cluster.jobs and os.getpid() not in first
    assert actors(cluster) == first


def test_what_kills_its_process_is_lost_alone_and_the_actor_is_not(cluster: Cluster) -> None:
    before = actors(cluster)
    outcomes = dict(cluster.run(die_over_three, range(6)))
    assert outcomes.pop(3) == Lost("the process that worked on it was killed by SIGSEGV")
    assert outcomes == {i: i for i in (0, 1, 2, 4, 5)}
    assert actors(cluster) == before


def test_what_a_lost_actor_worked_on_is_done_again(cluster: Cluster, tmp_path: Path) -> None:
    before = actors(cluster)
    outcomes = dict(cluster.run(lose_the_actor_once, [str(tmp_path / "first"), str(tmp_path / "second")]))
    assert outcomes == {0: "done again", 1: "done again"}
    assert not actors(cluster) & before


def test_a_machine_that_computes_otherwise_is_not_worked_on(cluster: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    actors(cluster)
    actor = cluster._idle[0]
    monkeypatch.setitem(cluster._here, "mujoco", {**cluster._here["mujoco"], "probe": "another"})
    done = actor.ready.remote()
    cluster._starting[done] = actor, False
    with pytest.raises(MachineError, match=r"probe of mujoco is [0-9a-f]{32}, here another") as error:
        cluster._started(done)
    assert error.value.code == "cluster_differs"


@pytest.mark.long
def test_an_item_that_takes_actor_after_actor_along_is_given_up(cluster: Cluster) -> None:
    outcomes = dict(cluster.run(lose_every_actor, range(4)))
    lost = outcomes.pop(0)
    assert isinstance(lost, Lost) and lost.reason.startswith("3 processes of the cluster were lost over it: ")
    assert outcomes == {1: 1, 2: 2, 3: 3}


def test_an_exception_in_an_actor_is_raised_in_the_caller(cluster: Cluster) -> None:
    with pytest.raises(RuntimeError, match="ZeroDivisionError"):
        list(cluster.run(raise_over_one, range(3)))
    assert dict(cluster.run(die_over_three, range(3))) == {0: 0, 1: 1, 2: 2}


def evaluated(pool: Pool, *, losing: int | None = None) -> dict[int, Evaluation]:
    queue = EvaluationQueue(Task.load("walk"), (1, 2), pool)
    found: dict[int, Evaluation] = {}
    count = 8
    for number in range(count):
        document = {**snake(segments=number % 3 + 2), "name": f"snake-{number}"}
        queue.put(number, Genome(document))
    while len(found) < count:
        found.update(queue.take())
        if losing is not None:
            os.kill(losing, signal.SIGKILL)
            losing = None
    return found


def test_a_population_comes_out_to_the_bit_as_here_though_an_actor_is_killed(cluster: Cluster) -> None:
    assert evaluated(cluster, losing=min(actors(cluster))) == evaluated(Here())
