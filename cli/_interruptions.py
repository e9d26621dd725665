"""Ctrl-C and SIGTERM, as a reason to stop in good order."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NoReturn

__all__ = ["interruptions", "keep_in_mind"]

_kept: list[int] = []  # what came before somebody asked for interruptions


def keep_in_mind() -> None:
    """Lets `interruptions` know of a Ctrl-C that came before: the exception may be dropped as a module is loaded.

    Whoever begins this program with Ctrl-C held back, so that none is dropped before, has it let through here.

    Raises:
        KeyboardInterrupt: One was held back.
    """

    def interrupt(number: int, _: object) -> NoReturn:
        _kept.append(number)
        raise KeyboardInterrupt

    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # else it is ignored, as `nohup ... &` has it
        signal.signal(signal.SIGINT, interrupt)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


@contextmanager
def interruptions(*signals: signal.Signals) -> Iterator[Callable[[], bool]]:
    """Lets signals raise `KeyboardInterrupt`, and gives a function that tells whether one came.

    The exception is lost where the signal comes while a destructor runs, or one of the extensions that drop errors (the
    validator of JSON Schema does): whoever works in a loop asks now and then.

    Args:
        signals: Which.

    Raises:
        KeyboardInterrupt: One came already, and was lost.
    """
    if _kept:
        raise KeyboardInterrupt
    came = False

    def interrupt(*_: object) -> NoReturn:
        nonlocal came
        came = True
        raise KeyboardInterrupt

    before = {number: signal.signal(number, interrupt) for number in signals}
    try:
        yield lambda: came
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
