"""Processes that are started whole, or not at all, however often somebody presses Ctrl-C meanwhile.

Hides how signals are held back. A thread that blocks one is not enough: the system gives it to another thread, as
libraries for linear algebra have some, and Python then raises KeyboardInterrupt in the main thread all the same.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any, Final

__all__ = ["signals_deferred", "start_process"]

_ENDING: Final = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def signals_deferred() -> Iterator[None]:
    """Keeps Ctrl-C and SIGTERM until the end of the block: in the midst of starting a process they would spoil it.

    In another thread than the main one there is nothing to do, since Python handles signals in that one alone.
    """
    came: list[int] = []
    main = threading.current_thread() is threading.main_thread()
    before = {number: signal.signal(number, lambda number, _: came.append(number)) for number in _ENDING if main}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for late in came:
            signal.raise_signal(late)


def start_process(function: Callable[..., None], *arguments: Any) -> tuple[BaseProcess, Connection]:
    """Starts an interpreter of its own that calls a function with one end of a pipe and what else is given.

    It never sees Ctrl-C, and is killed when this process ends.

    Returns:
        The process, and the other end of the pipe, which breaks off when the process ends.
    """
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=function, args=(theirs, *arguments), daemon=True)
    try:
        with signals_deferred():
            resource_tracker.ensure_running()  # when the first process starts it, it lets Ctrl-C through again
            mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # which the process inherits
            try:
                process.start()
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, mask)
    except BaseException:  # it is there by now, and nobody will know of it
        if process.is_alive():
            process.kill()
            process.join()
        raise
    theirs.close()
    return process, ours
