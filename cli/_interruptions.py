"""Ctrl-C and SIGTERM, as a reason to stop in good order."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NoReturn

__all__ = ["interruptions"]


@contextmanager
def interruptions(*signals: signal.Signals) -> Iterator[Callable[[], bool]]:
    """Lets signals raise `KeyboardInterrupt`, and gives a function that tells whether one came.

    The exception is lost where the signal comes while a destructor runs, or one of the extensions that drop errors (the
    validator of JSON Schema does): whoever works in a loop asks now and then.

    Args:
        signals: Which.
    """
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
