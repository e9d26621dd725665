"""One function over many items, on all cores or on a Ray cluster.

It hides processes: how they are started, fed, watched and ended. Results come as they are ready, each with the place
of its item, so that whoever wants an order makes it.

Invariants:

- Where an item is worked on, and beside which others, is nothing the function can see: every worker is a fresh
  interpreter, given one item at a time, with one thread for linear algebra, and without a screen.
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
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

from nmes.errors import MachineError, MissingPackage

__all__ = ["Lost", "in_processes", "on_ray"]

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


def in_processes(
    function: Callable[[Item], Result], items: Sequence[Item], jobs: int
) -> Generator[tuple[int, Result | Lost], None, None]:
    """Calls a function with every item, in so many processes at once.

    Args:
        function: A function of a module (workers import it), of which arguments and results can be pickled.
        items: What to call it with.
        jobs: How many processes. With 1, or with a single item, it is called in this one.

    Yields:
        The index of an item and its result, as they are ready.
    """
    if min(jobs, len(items)) <= 1:
        for index, item in enumerate(items):
            yield index, function(item)
        return
    pool: dict[Connection, _Worker] = {}
    waiting = iter(enumerate(items))
    try:
        for _ in range(min(jobs, len(items))):
            worker = _Worker(function)
            pool[worker.pipe] = worker
            worker.give(*next(waiting))
        while pool:
            for pipe in wait(list(pool)):
                assert isinstance(pipe, Connection)
                worker = pool.pop(pipe)
                index, result = worker.take()
                following = next(waiting, None)
                if isinstance(result, Lost) and following is not None:
                    worker = _Worker(function)
                if following is None:
                    worker.end()
                else:
                    pool[worker.pipe] = worker
                    worker.give(*following)
                yield index, result
    finally:
        for worker in pool.values():
            worker.end()


class _Worker:
    """A process that works on one item after the other."""

    def __init__(self, function: Callable[[Any], Any]) -> None:
        context = get_context("spawn")
        self.pipe, other = context.Pipe()
        self._process: BaseProcess = context.Process(target=_work, args=(function, other), daemon=True)
        self._index = -1
        with _quiet():
            self._process.start()
        other.close()  # so that the pipe ends when the process does

    def give(self, index: int, item: object) -> None:
        """Sends an item."""
        self._index = index
        try:
            self.pipe.send(item)
        except BrokenPipeError:
            pass  # it died; `take` says so

    def take(self) -> tuple[int, Any]:
        """Receives the result of the item at hand."""
        try:
            error, result = self.pipe.recv()
        except (EOFError, ConnectionError):
            self._process.join()
            code = self._process.exitcode or 0
            how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with status {code}"
            self.end()
            return self._index, Lost(f"the process that worked on it {how}")
        if error:
            raise RuntimeError(f"a worker failed:\n{error}")
        return self._index, result

    def end(self) -> None:
        """Ends the process, whatever it is doing."""
        self.pipe.close()
        self._process.kill()
        self._process.join()


def _work(function: Callable[[Any], Any], pipe: Connection) -> None:
    while True:
        try:
            item = pipe.recv()
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
