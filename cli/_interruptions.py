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

    Python loses the exception if that was while a destructor ran.

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
