"""One function over many items, on all cores or on a Ray cluster.

It hides processes: how they are started, fed, watched and ended. Results come as they are ready, each with the place
of its item, so that whoever wants an order makes it.

Invariants:

- Where an item is worked on, and beside which others, is nothing the function can see: every worker is an interpreter
  of its own, given one item at a time, with one thread for linear algebra, and without a screen.
- A worker that dies takes only its own item with it: that one's result is a `Lost`, and a new worker goes on.
- Workers never see Ctrl-C. Whoever stops taking results ends them.
- A function that raises is a mistake: its error comes out here, with the worker's traceback. What may go wrong with
  an item is for the function to return.
"""

from __future__ import annotations

import logging
import os
import signal
import traceback
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

from nmes.errors import MachineError, MissingPackage

__all__ = ["Lost", "Workers", "in_processes", "on_ray"]

Item = TypeVar("Item")
Result = TypeVar("Result")

# Workers share the cores among themselves already, and one thread adds numbers up in one order. Nor do they draw: what
# MuJoCo would load for that starts a process of its own, which complains aloud when its worker is ended meanwhile.
_LEAN = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL", "VECLIB_MAXIMUM", "NUMEXPR")}
_LEAN["MUJOCO_GL"] = "disable"
_AHEAD = 4  # items a core that wait in a Ray cluster


@dataclass(frozen=True, slots=True)
class Lost:
    """An item whose worker died over it: why."""

    reason: str


class Workers:
    """Processes that stay, so that call after call of a function finds them started; leaving the context ends them.

    They are started when the first call has work for them. Only one call runs at a time.

    Args:
        jobs: How many at most. With 1, or for a single item, functions are called in this process.
    """

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs
        self._idle: list[_Worker] = []

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        while self._idle:
            self._idle.pop().end()

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
        """
        if min(self.jobs, len(items)) <= 1:
            for index, item in enumerate(items):
                yield index, function(item)
            return
        waiting = iter(enumerate(items))
        busy: dict[Connection, _Worker] = {}
        try:
            for index, item in islice(waiting, self.jobs):
                self._give(busy, index, function, item)
            while busy:
                for pipe in wait(list(busy)):
                    assert isinstance(pipe, Connection)
                    index, error, result = self._take(busy.pop(pipe))
                    if error:
                        raise RuntimeError(f"a worker failed:\n{error}")
                    for following in islice(waiting, 1):
                        self._give(busy, following[0], function, following[1])
                    yield index, result
        finally:
            for worker in busy.values():
                worker.end()

    def _give(self, busy: dict[Connection, _Worker], index: int, function: Callable[[Any], Any], item: object) -> None:
        """Has a worker begin with an item: one that is idle and has not died since, or a new one."""
        worker = self._idle.pop() if self._idle else _Worker()
        if not worker.alive:
            worker.end()
            worker = _Worker()
        busy[worker.pipe] = worker
        worker.give(index, function, item)

    def _take(self, worker: _Worker) -> tuple[int, str, Any]:
        answer = worker.take()
        if isinstance(answer[2], Lost):
            worker.end()
        else:
            self._idle.append(worker)
        return answer


def in_processes(
    function: Callable[[Item], Result], items: Sequence[Item], jobs: int
) -> Generator[tuple[int, Result | Lost], None, None]:
    """Calls a function with every item, in so many processes at once, for whoever does so but once: see `Workers`."""
    with Workers(jobs) as workers:
        yield from workers.run(function, items)


class _Worker:
    """A process that works on one item after the other."""

    def __init__(self) -> None:
        context = get_context("spawn")
        self.pipe, other = context.Pipe()
        self._process: BaseProcess = context.Process(target=_work, args=(other,), daemon=True)
        self._index = -1
        with _quiet():
            self._process.start()
        other.close()  # so that the pipe ends when the process does

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
        self.pipe.close()
        self._process.kill()
        self._process.join()


def _work(pipe: Connection) -> None:
    while True:
        try:
            function, item = pipe.recv()
        except EOFError:
            return
        try:
            answer = "", function(item)
        except Exception:
            answer = traceback.format_exc(), None
        pipe.send(answer)


@contextmanager
def _quiet() -> Iterator[None]:
    """Lets processes that are started meanwhile use one thread, load no renderer, and ignore Ctrl-C."""
    before = {name: os.environ.get(name) for name in _LEAN}
    os.environ.update(_LEAN)
    resource_tracker.ensure_running()  # when the first worker starts it, it lets Ctrl-C through again
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def on_ray(
    function: Callable[[Item], Result], items: Sequence[Item], address: str
) -> Generator[tuple[int, Result | Lost], None, None]:
    """Calls a function with every item, on the machines of a Ray cluster, a core each.

    Args:
        function: As for `in_processes`; its module must be installed on every machine.
        items: What to call it with.
        address: The cluster's: `HOST:PORT`, `auto`, or `local` for one that is started here.

    Yields:
        The index of an item and its result, as they are ready.

    Raises:
        MissingPackage: Ray is not installed.
        MachineError: There is no cluster (`no_cluster`).
    """
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
    try:
        remote = ray.remote(num_cpus=1, max_retries=0)(function)
        ahead = _AHEAD * max(1, int(ray.cluster_resources().get("CPU", 1)))  # type: ignore[no-untyped-call]
        waiting = iter(enumerate(items))
        running: dict[Any, int] = {}
        while True:
            while len(running) < ahead and (following := next(waiting, None)) is not None:
                running[remote.remote(following[1])] = following[0]
            if not running:
                return
            for done in ray.wait(list(running))[0]:
                try:
                    result = ray.get(done)
                except ray.exceptions.WorkerCrashedError as error:
                    result = Lost(str(error).split(". ")[0])
                yield running.pop(done), result
    finally:
        ray.shutdown()
