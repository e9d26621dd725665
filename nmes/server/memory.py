"""The memory of a process that hosts many worlds: what is given back to the system, and what is not looked through.

Both are about pauses. The C library gives freed memory back only when it is asked to go through all there is, which
keeps everybody waiting who needs some; and Python's collector, which looks for garbage that refers to itself, goes
through all objects that have lived for long, those of sleeping worlds too: 0.05 ms a world, and so most of a second for
13,000.
"""

from __future__ import annotations

import asyncio
import ctypes
import gc
import os
import sys
from pathlib import Path
from time import monotonic

__all__ = ["Memory"]

LET_GO = 32  # engines let go, at least, after which memory is given back,
SHARE = 16  # and at least one for so many worlds that are here,
LONGEST = 30.0  # or in so long, s
GROWTH = 1.5  # how much a process has grown, and worlds have become more, until it is seen to again
SLACK = 64 << 20  # bytes: that nobody minds
FEW = 500  # worlds: of so few objects the collector is quick to go through all


class Memory:
    """What a host's process does about memory, now and then."""

    def __init__(self) -> None:
        """Begins with a process that hosts nothing."""
        self._let_go = 0  # engines, since memory was given back
        self._given_back = monotonic()  # when that was
        self._resident = 0  # bytes there were then
        self._passed_over = 0  # worlds whose objects the collector does not look through

    async def tidy(self, worlds: int, let_go: int, *, idle: bool, paced: bool) -> None:
        """Gives memory back where that is worth a pause.

        Args:
            worlds: How many are here.
            let_go: How many engines were let go since the last call.
            idle: Whether no world is awake.
            paced: Whether some keep pace with the wall's clock, and would be late: then memory is given back only when
                the process has grown, else it is used again by those that wake next.
        """
        self._let_go += let_go
        self._pass_over(worlds)
        if not self._let_go:
            return
        if paced:
            due = _resident() > GROWTH * self._resident + SLACK
        else:
            due = idle or self._let_go >= max(LET_GO, worlds // SHARE) or monotonic() > self._given_back + LONGEST
        if due:
            await asyncio.to_thread(_give_back)
            self._let_go, self._given_back, self._resident = 0, monotonic(), _resident()

    def _pass_over(self, worlds: int) -> None:
        """Has the collector pass over what there is, when there are many more worlds than last time.

        Garbage that refers to itself and is older than that stays, so it is done only so often, and undone when most of
        the worlds are gone.
        """
        if worlds > GROWTH * self._passed_over + FEW:
            gc.freeze()
            self._passed_over = worlds
        elif worlds < self._passed_over / 2:
            gc.unfreeze()
            self._passed_over = 0


def _give_back() -> None:
    """Has the C library give the system what it keeps of freed memory, where it can: glibc keeps most of an engine."""
    if sys.platform == "linux" and (trim := getattr(ctypes.CDLL(None), "malloc_trim", None)) is not None:
        trim(0)


def _resident() -> int:
    """Returns how much memory (bytes) this process has, where the system tells and a file may be opened; else 0."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0
