"""A host's memory: given back when engines were let go, and looked through no more than it must be."""

from __future__ import annotations

import asyncio
import gc
import multiprocessing
import os
import resource
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from nmes.server.memory import Memory

BLOCK = 16 << 10  # bytes: few enough that the C library keeps them among others, and does not map them alone

linux_alone = pytest.mark.skipif(sys.platform != "linux", reason="the system tells no process how much memory it has")


@pytest.fixture(autouse=True)
def unfrozen() -> Iterator[None]:
    yield
    gc.unfreeze()


def resident() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def fragments(size: int) -> list[bytes]:
    """Returns blocks between which as many lie free, so that they cannot be given back from the end."""
    blocks = [bytes(BLOCK) for _ in range(2 * size // BLOCK)]
    return blocks[::2]


@linux_alone
def test_memory_of_engines_that_were_let_go_is_given_back() -> None:
    memory = Memory()
    kept = fragments(128 << 20)
    before = resident()
    asyncio.run(memory.tidy(10, 1, idle=True, paced=False))
    assert resident() < before - (64 << 20)
    assert kept


@linux_alone
def test_beside_worlds_in_real_time_it_is_given_back_only_when_the_process_has_grown() -> None:
    # In a small process, since a share of what it has decides: one that ran thousands of tests has gigabytes.
    process = multiprocessing.get_context("spawn").Process(target=grow)
    process.start()
    process.join()
    assert process.exitcode == 0


def grow() -> None:
    """Lets a process grow a little, which gives nothing back, and then much."""
    memory = Memory()
    first = fragments(128 << 20)
    asyncio.run(memory.tidy(10, 1, idle=True, paced=False))
    again = fragments(32 << 20)
    before = resident()
    asyncio.run(memory.tidy(10, 1000, idle=False, paced=True))
    assert resident() > before - (8 << 20)
    more = fragments(256 << 20)
    before = resident()
    asyncio.run(memory.tidy(10, 1, idle=False, paced=True))
    assert resident() < before - (128 << 20)
    assert first and again and more


def test_a_process_that_may_open_no_more_files_gives_memory_back_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[int] = []
    monkeypatch.setattr("nmes.server.memory._give_back", lambda: called.append(1))
    memory, limits = Memory(), resource.getrlimit(resource.RLIMIT_NOFILE)

    async def tidy() -> None:
        resource.setrlimit(resource.RLIMIT_NOFILE, (0, limits[1]))
        try:
            for paced in (True, False):
                await memory.tidy(10, 1, idle=True, paced=paced)
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, limits)

    asyncio.run(tidy())
    assert called


def test_nothing_is_given_back_where_no_engine_was_let_go(monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[int] = []
    monkeypatch.setattr("nmes.server.memory._give_back", lambda: called.append(1))
    memory = Memory()
    asyncio.run(memory.tidy(10, 0, idle=True, paced=False))
    assert not called
    asyncio.run(memory.tidy(10, 1, idle=True, paced=False))
    assert called


def test_objects_of_many_worlds_are_passed_over_by_the_collector_until_most_are_gone() -> None:
    memory = Memory()
    asyncio.run(memory.tidy(300, 0, idle=False, paced=False))
    assert gc.get_freeze_count() == 0
    asyncio.run(memory.tidy(1000, 0, idle=False, paced=False))
    first = gc.get_freeze_count()
    assert first > 0
    kept = [[n] for n in range(1000)]
    asyncio.run(memory.tidy(1200, 0, idle=False, paced=False))
    assert gc.get_freeze_count() <= first  # not for every few
    asyncio.run(memory.tidy(2500, 0, idle=False, paced=False))
    assert gc.get_freeze_count() > first + len(kept) / 2
    asyncio.run(memory.tidy(1100, 0, idle=False, paced=False))
    assert gc.get_freeze_count() == 0
