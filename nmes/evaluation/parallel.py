"""One function over many items, on all cores or on a Ray cluster.

It hides processes: how they are started, fed, watched and ended. Results come as they are ready, each with the place
of its item, so that whoever wants an order makes it.

Invariants:

- Where an item is worked on, and beside which others, is nothing the function can see: every worker is an interpreter
  of its own, given one item at a time, with one thread for linear algebra, and without a screen.
- A worker that dies takes only its own item with it: that one's result is a `Lost`, and a new worker goes on.
- A machine of a cluster that is lost takes nothing with it: what was worked on there is done again elsewhere. One that
  computes otherwise than this one is not worked on at all.
- Workers never see Ctrl-C. Whoever stops taking results ends them.
- A function that raises is a mistake: its error comes out here, with the worker's traceback. What may go wrong with
  an item is for the function to return. But where the machine lacks something, the item is a `Lost` too: that says
  nothing of it, and may pass. A package that is not installed will not come by itself: `MissingPackage` comes out.
"""

from __future__ import annotations

import logging
import operator
import os
import signal
import traceback
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from multiprocessing.connection import Connection, wait
from typing import Any, Self, TypeVar

from nmes.backend.fingerprint import decisive, differences, fingerprint
from nmes.backend.registry import entry_points_by_name, load_backend
from nmes.errors import MACHINE_ERRORS, BackendNotFound, MachineError, MissingPackage
from nmes.evaluation.processes import start_process

__all__ = ["Cluster", "Here", "Lost", "Pool", "Workers", "in_processes", "open_pool"]

logger = logging.getLogger(__name__)

Item = TypeVar("Item")
Result = TypeVar("Result")

# Workers share the cores among themselves already, and one thread adds numbers up in one order. Nor do they draw: what
# MuJoCo would load for that starts a process of its own, which complains aloud when its worker is ended meanwhile.
_LEAN = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL", "VECLIB_MAXIMUM", "NUMEXPR")}
_LEAN["MUJOCO_GL"] = "disable"
_DEATHS = 3  # actors of a cluster that one item may take along


@dataclass(frozen=True, slots=True)
class Lost:
    """An item whose worker died over it, or came to lack something of its machine: why."""

    reason: str


class Pool(ABC):
    """Where functions are called: a few at once, each result as it is ready. Leaving its context ends it.

    Attributes:
        jobs: How many at most are at work at once.
    """

    jobs: int

    def __enter__(self) -> Self:
        return self

    @abstractmethod
    def __exit__(self, *_: object) -> None: ...

    @property
    @abstractmethod
    def free(self) -> int:
        """The number of items that it can be given now."""

    @property
    @abstractmethod
    def busy(self) -> bool:
        """Whether it has work whose result has not been taken."""

    @abstractmethod
    def give(self, number: int, function: Callable[[Any], Any], item: object) -> None:
        """Has a function called with an item; the result comes with this number."""

    @abstractmethod
    def take(self) -> list[tuple[int, Any]]:
        """Waits until something is ready, and returns the numbers and results; a `Lost` for an item that is lost.

        Raises:
            RuntimeError: A function raised; with its traceback.
            MissingPackage: A function needs a package that is not installed.
        """

    @abstractmethod
    def stop(self) -> None:
        """Ends what is being worked on; its results are never taken."""

    def run(
        self, function: Callable[[Item], Result], items: Sequence[Item]
    ) -> Generator[tuple[int, Result | Lost], None, None]:
        """Calls a function with every item, in the order of the items as processes are free.

        Args:
            function: A function of a module (workers import it), of which arguments and results can be pickled.
            items: What to call it with.

        Yields:
            The index of an item and its result, as they are ready. Whoever takes no more ends what is being worked on.

        Raises:
            RuntimeError: The function raised; with the worker's traceback.
            MissingPackage: It needs a package that is not installed.
        """
        waiting = iter(enumerate(items))
        try:
            while True:
                for index, item in islice(waiting, self.free):
                    self.give(index, function, item)
                if not self.busy:
                    return
                done = self.take()
                for index, item in islice(waiting, self.free):
                    self.give(index, function, item)
                yield from done
        finally:
            self.stop()


class Here(Pool):
    """This process: functions are called one at a time, while somebody waits for a result. What kills it kills all."""

    jobs = 1

    def __init__(self) -> None:
        self._given: list[tuple[int, Callable[[Any], Any], object]] = []

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def free(self) -> int:
        """As `Pool.free`."""
        return self.jobs - len(self._given)

    @property
    def busy(self) -> bool:
        """As `Pool.busy`."""
        return bool(self._given)

    def give(self, number: int, function: Callable[[Any], Any], item: object) -> None:
        """As `Pool.give`."""
        self._given.append((number, function, item))

    def take(self) -> list[tuple[int, Any]]:
        """As `Pool.take`; what a function raises comes out as it is, but for what the machine lacks."""
        number, function, item = self._given.pop()
        return [(number, _called(function, item))]

    def stop(self) -> None:
        """As `Pool.stop`."""
        self._given.clear()


class Workers(Pool):
    """Processes that stay, so that call after call of a function finds them started; leaving the context ends them.

    They are started when the first call has work for them. Only one call runs at a time.

    Args:
        jobs: How many at most.
    """

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs
        self._idle: list[_Worker] = []
        self._busy: dict[Connection, _Worker] = {}

    def __exit__(self, *_: object) -> None:
        self.stop()
        while self._idle:
            self._idle.pop().end()

    @property
    def free(self) -> int:
        """As `Pool.free`."""
        return self.jobs - len(self._busy)

    @property
    def busy(self) -> bool:
        """As `Pool.busy`."""
        return bool(self._busy)

    def give(self, number: int, function: Callable[[Any], Any], item: object) -> None:
        """As `Pool.give`: to a process that is idle and has not died since, or a new one."""
        worker = self._idle.pop() if self._idle else _Worker()
        if not worker.alive:
            worker.end()
            worker = _Worker()
        self._busy[worker.pipe] = worker
        worker.give(number, function, item)

    def take(self) -> list[tuple[int, Any]]:
        """As `Pool.take`."""
        return [self._taken(pipe) for pipe in wait(list(self._busy)) if isinstance(pipe, Connection)]

    def _taken(self, pipe: Connection) -> tuple[int, Any]:
        worker = self._busy.pop(pipe)
        number, error, result = worker.take()
        if isinstance(result, Lost):
            worker.end()
        else:
            self._idle.append(worker)
        return number, _given_back(error, result)

    def stop(self) -> None:
        """As `Pool.stop`."""
        while self._busy:
            self._busy.popitem()[1].end()


def open_pool(jobs: int | None, ray: str | None = None) -> Pool:
    """Returns where functions are called.

    Args:
        jobs: How many processes at most; 1 is this process. None: one a core.
        ray: The address of a Ray cluster to use instead: `HOST:PORT`, `auto` or `local`.

    Raises:
        TypeError: The number of jobs is no whole number.
        ValueError: There is no job.
        MissingPackage: Ray is not installed.
        MachineError: There is no cluster (`no_cluster`).
    """
    jobs = os.cpu_count() or 1 if jobs is None else operator.index(jobs)
    if jobs < 1:
        raise ValueError(f"jobs must be 1 or more, not {jobs}")
    return Cluster(ray) if ray is not None else Workers(jobs) if jobs > 1 else Here()


def in_processes(
    function: Callable[[Item], Result], items: Sequence[Item], jobs: int
) -> Generator[tuple[int, Result | Lost], None, None]:
    """Calls a function with every item, in so many processes at once, for whoever does so but once.

    With one job that is this process.
    """
    with Workers(jobs) if jobs > 1 else Here() as pool:
        yield from pool.run(function, items)


class _Worker:
    """A process that works on one item after the other."""

    def __init__(self) -> None:
        self._index = -1
        with _lean():
            self._process, self.pipe = start_process(_work)

    @property
    def alive(self) -> bool:
        """Whether the process is still there."""
        return self._process.is_alive()

    def give(self, index: int, function: Callable[[Any], Any], item: object) -> None:
        """Sends an item, and what to do with it."""
        self._index = index
        try:
            self.pipe.send((function, item))
        except BrokenPipeError:
            pass  # it died; `take` says so

    def take(self) -> tuple[int, str, Any]:
        """Receives the index of the item at hand, the traceback of the error that it raised if it did, its result."""
        try:
            error, result = self.pipe.recv()
        except (EOFError, ConnectionError):
            self._process.join()
            code = self._process.exitcode or 0
            how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with status {code}"
            return self._index, "", Lost(f"the process that worked on it {how}")
        return self._index, error, result

    def end(self) -> None:
        """Ends the process, whatever it is doing."""
        self._process.kill()  # before its pipe ends, over which it would complain
        self._process.join()
        self.pipe.close()


def _called(function: Callable[[Any], Any], item: object) -> Any:
    """Calls a function with an item; where the machine lacks something for it, the item is lost."""
    try:
        return function(item)
    except MACHINE_ERRORS as error:
        logger.warning("an item is lost, since the machine lacks something", exc_info=error)
        return Lost(f"the process that worked on it came to an end: {type(error).__name__}: {error}")


def _given_back(error: str, result: Any) -> Any:
    """Returns the result that a worker gave.

    Raises:
        RuntimeError: The function raised, with this traceback.
        MissingPackage: It is this.
    """
    if error:
        raise RuntimeError(f"a worker failed:\n{error}")
    if isinstance(result, MissingPackage):
        raise result
    return result


def _work(pipe: Connection) -> None:
    while True:
        try:
            function, item = pipe.recv()
        except (EOFError, ConnectionError):
            return
        try:
            answer = "", _called(function, item)
        except MissingPackage as missing:
            answer = "", missing
        except Exception:
            answer = traceback.format_exc(), None
        try:
            pipe.send(answer)
        except ConnectionError:
            return  # whoever gave it is gone


@contextmanager
def _lean() -> Iterator[None]:
    """Lets processes that are started meanwhile use one thread, and load no renderer."""
    before = {name: os.environ.get(name) for name in _LEAN}
    os.environ.update(_LEAN)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


class Hand:
    """What an actor of a cluster is: a process of its own beside it, which works on one item after the other.

    So what an item does to the process is known, as on one machine; and where the actor goes, it was no item.
    """

    def __init__(self) -> None:
        self._worker = _Worker()

    def work(self, function: Callable[[Any], Any], item: object) -> tuple[str, Any]:
        """Returns the traceback of the error that a function raised over an item, if it did, and its result."""
        if not self._worker.alive:
            self._worker.end()
            self._worker = _Worker()
        self._worker.give(0, function, item)
        _, error, result = self._worker.take()
        if isinstance(result, Lost):
            self._worker.end()
        return error, result

    def ready(self) -> dict[str, dict[str, str]]:
        """Returns, once the actor is there, what decides what its machine computes; see `_computes`."""
        return _computes()


def _computes() -> dict[str, dict[str, str]]:
    """Returns the decisive items of the fingerprint of each engine that can be loaded here, by its name."""
    found = {}
    for name in entry_points_by_name():
        with suppress(BackendNotFound):
            found[name] = decisive(fingerprint(load_backend(name)))
    return found


@dataclass(slots=True)
class _Given:
    """An item that a cluster was given.

    Attributes:
        number: Of the item.
        function: What is called with it.
        item: The item.
        actor: Who works on it; None where nobody does yet.
        deaths: How many actors were lost over it.
    """

    number: int
    function: Callable[[Any], Any]
    item: object
    actor: Any = None
    deaths: int = 0


class Cluster(Pool):
    """The machines of a Ray cluster, an actor a core, which stay; leaving the context parts from it.

    An actor that is lost, with its machine or alone, is replaced once the cluster has a core for another, and what it
    was working on is done again. Functions are those of modules that are installed on every machine.

    Args:
        address: The cluster's: `HOST:PORT`, `auto`, or `local` for one that is started here.

    Raises:
        MissingPackage: Ray is not installed.
        MachineError: There is no cluster (`no_cluster`).
    """

    def __init__(self, address: str) -> None:
        self._here = _computes()
        try:
            import ray
        except ImportError as error:
            raise MissingPackage("a cluster needs Ray: pip install 'nmes[ray]'") from error
        try:
            ray.init(
                address=address,
                log_to_driver=False,
                include_dashboard=False,
                logging_level=logging.ERROR,
                runtime_env={"env_vars": _LEAN},
            )
        except (ConnectionError, ValueError, RuntimeError) as error:
            raise MachineError("no_cluster", f"no Ray cluster at {address!r}: {error}") from error
        self._ray = ray
        self.jobs = max(1, int(ray.cluster_resources().get("CPU", 1)))  # type: ignore[no-untyped-call]
        self._actor: Any = ray.remote(num_cpus=1, max_restarts=0, max_task_retries=0)(Hand)
        self._starting: dict[Any, tuple[Any, bool]] = {}  # actors, and whether they are new; by what tells of them
        self._idle: list[Any] = []
        self._busy: dict[Any, _Given] = {}  # by what their results come with
        self._waiting: deque[_Given] = deque()
        self._failed = 0  # actors in a row that were lost before they were there

    def __exit__(self, *_: object) -> None:
        for kept in (self._starting, self._idle, self._busy, self._waiting):
            kept.clear()
        self._ray.shutdown()

    @property
    def free(self) -> int:
        """As `Pool.free`."""
        return self.jobs - len(self._busy) - len(self._waiting)

    @property
    def busy(self) -> bool:
        """As `Pool.busy`."""
        return bool(self._busy or self._waiting)

    def give(self, number: int, function: Callable[[Any], Any], item: object) -> None:
        """As `Pool.give`."""
        self._waiting.append(_Given(number, function, item))
        self._feed()

    def take(self) -> list[tuple[int, Any]]:
        """As `Pool.take`.

        Raises:
            MachineError: Actors do not start (`no_cluster`), or one computes otherwise than this machine does
                (`cluster_differs`).
        """
        taken: list[tuple[int, Any]] = []
        while not taken:
            for done in self._ray.wait([*self._busy, *self._starting])[0]:
                if done in self._starting:
                    self._started(done)
                else:
                    taken += self._taken(done)
            self._feed()
        return taken

    def _feed(self) -> None:
        """Hands what waits to actors that are idle, and starts others where there are too few."""
        while self._waiting and self._idle:
            given = self._waiting.popleft()
            given.actor = self._idle.pop()
            self._busy[given.actor.work.remote(given.function, given.item)] = given
        room = self.jobs - len(self._busy) - len(self._starting)
        for _ in range(min(len(self._waiting) - len(self._starting), room)):
            actor = self._actor.remote()
            self._starting[actor.ready.remote()] = actor, True

    def _started(self, done: Any) -> None:
        actor, new = self._starting.pop(done)
        try:
            there = self._ray.get(done)
        except self._ray.exceptions.RayError as error:
            self._failed += new
            if new and self._failed == _DEATHS:
                message = f"no process starts in the Ray cluster, which needs NMES on every machine: {_first(error)}"
                raise MachineError("no_cluster", message) from error
        else:
            self._require_alike(there)
            self._failed = 0
            self._idle.append(actor)

    def _require_alike(self, there: dict[str, dict[str, str]]) -> None:
        """Refuses an actor whose figures may be others than those of this machine: a run would mix the two."""
        for name, items in self._here.items():
            for item, (ours, theirs) in differences(items, there.get(name, {})).items():
                what = f"{item} of {name} is {theirs or 'not there'}, here {ours or 'not there'}"
                message = f"a machine of the Ray cluster computes otherwise than this one: {what}"
                raise MachineError("cluster_differs", message)

    def _taken(self, done: Any) -> list[tuple[int, Any]]:
        """Returns the result of an item with its number; nothing where it is to be done again."""
        given = self._busy.pop(done)
        try:
            error, result = self._ray.get(done)
        except self._ray.exceptions.RayTaskError:  # a mistake of ours
            raise
        except self._ray.exceptions.RayError as failure:  # the actor is lost, or what it said, with its machine
            self._ray.kill(given.actor)  # in case it is only out of reach
            for actor in self._idle:  # they may be gone with the same machine, over which no item is to blame
                self._starting[actor.ready.remote()] = actor, False
            self._idle.clear()
            given.deaths += 1
            if given.deaths == _DEATHS:
                why = f"{_DEATHS} processes of the cluster were lost over it: {_first(failure)}"
                return [(given.number, Lost(why))]
            self._waiting.appendleft(given)
            return []
        self._idle.append(given.actor)
        return [(given.number, _given_back(error, result))]

    def stop(self) -> None:
        """As `Pool.stop`."""
        for given in self._busy.values():
            self._ray.kill(given.actor)
        self._busy.clear()
        self._waiting.clear()


def _first(error: Exception) -> str:
    """Returns the first sentence of what Ray says, which may go on for pages."""
    return str(error).partition("\n")[0].split(". ")[0]
