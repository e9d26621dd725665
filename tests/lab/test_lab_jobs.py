"""What a lab keeps of the commands that it has started."""

from __future__ import annotations

import asyncio
import signal
from pathlib import Path

import orjson
import pytest

from nmes.lab import jobs
from nmes.lab.jobs import Job, Jobs

REPLAY = str(Path(__file__).parents[2] / "replays" / "mujoco-edits.mcap")


async def ended(kept: Jobs, *arguments: str) -> Job:
    job = await kept.start(arguments)
    await job.ended
    return job


def test_what_a_job_printed_is_told_of_it_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    async def check() -> None:
        kept = Jobs(1)
        job = await ended(kept, "info", REPLAY, "--json")
        monkeypatch.setattr(orjson, "loads", pytest.fail)  # by nothing that the event loop asks for
        assert [each.to_json()["result"] for each in kept.all()] == [None]
        monkeypatch.undo()
        assert orjson.loads(orjson.dumps(job.result()))["world"]
        assert job.result() is not None
        failed = await ended(kept, "info", "/nowhere", "--json")
        assert failed.status != 0 and failed.result() is None

    asyncio.run(check())


def test_of_all_that_was_printed_the_newest_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    async def check() -> None:
        kept = Jobs(1)
        first = await ended(kept, "info", REPLAY, "--json")
        monkeypatch.setattr(jobs, "_ALL", first.kept + 1)
        second = await ended(kept, "info", REPLAY, "--json")
        assert first.result() is not None
        third = await ended(kept, "info", REPLAY, "--json")
        assert first.result() is None
        assert second.result() is not None and third.result() is not None

    asyncio.run(check())


def test_a_job_that_is_paused_while_it_begins_ends(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    # An exception out of a destructor is dropped by Python, as many are where modules are loaded.
    lines = "import os, signal\nclass Gone:\n  def __del__(self):\n    os.kill(os.getpid(), signal.SIGINT)\nGone()\n"
    (tmp_path / "sitecustomize.py").write_text(lines)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))

    async def check() -> None:
        kept = Jobs(2)
        before = signal.pthread_sigmask(signal.SIG_BLOCK, ())
        both = await asyncio.gather(*(ended(kept, "info", REPLAY, "--json") for _ in range(2)))
        assert [job.status for job in both] == [1, 1]
        assert [job.to_json()["lines"] for job in both] == [["Aborted!"]] * 2
        assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == before

    asyncio.run(check())
