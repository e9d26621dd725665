"""Commands that a lab has started: each is a process of `nmes`, with the very command line that a page shows.

Hides processes. A job belongs to the lab, not to the page that asked for it. When the lab ends, each is sent what
Ctrl-C sends, so that runs can be gone on with.
"""

from __future__ import annotations

import asyncio
import os
import shlex
import signal
import sys
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from itertools import count
from typing import Final

import orjson

from nmes.lab.folder import LabError
from nmes.schemas.documents import JsonObject

__all__ = ["Job", "Jobs"]

_LINES: Final = 100  # of what a job says that are kept
_LONGEST: Final = 2000  # characters of each
_OUTPUT: Final = 16 << 20  # bytes of standard output that are kept, which is JSON
_ALL: Final = 64 << 20  # bytes of standard output of all jobs that have ended
_ENDED: Final = 1000  # jobs that are remembered when they have ended
_PATIENCE: Final = 10.0  # s that a job has to end when it is told to


class Job:
    """A command that runs, or has ended.

    Attributes:
        id: Its number.
        arguments: What follows `nmes`.
        about: What it goes on with: the name of a run, or nothing.
        status: Its exit status; None while it runs.
    """

    def __init__(self, number: int, arguments: Sequence[str], about: str, process: asyncio.subprocess.Process) -> None:
        self.id = number
        self.arguments = list(arguments)
        self.about = about
        self.status: int | None = None
        self._process = process
        self._lines: deque[str] = deque(maxlen=_LINES)
        self._output: bytes | bytearray = bytearray()
        self._judged = False  # whether what it printed is known to be JSON
        self.ended = asyncio.create_task(self._follow())

    @property
    def command(self) -> str:
        """The command line."""
        return shlex.join(["nmes", *self.arguments])

    def interrupt(self) -> None:
        """Does what Ctrl-C does."""
        if self.status is None:
            with suppress(ProcessLookupError):
                self._process.send_signal(signal.SIGINT)

    async def end(self) -> None:
        """Interrupts it, and ends it where it does not end by itself in time."""
        self.interrupt()
        try:
            async with asyncio.timeout(_PATIENCE):
                await asyncio.shield(self.ended)
        except TimeoutError:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
            await self.ended

    @property
    def kept(self) -> int:
        """How many bytes of what it printed are kept."""
        return len(self._output)

    def forget(self) -> None:
        """Keeps no more what it printed."""
        self._output, self._judged = b"", False

    def result(self) -> orjson.Fragment | None:
        """Returns its output, which is JSON; None while it runs, and where the output is something else or is not kept.

        It takes a while when it is asked the first time, and is for a thread.
        """
        if self.status is None:
            return None
        if not self._judged:
            output = bytes(self._output)
            try:
                orjson.loads(output)
            except orjson.JSONDecodeError:  # it failed, and its last lines tell why
                output = b""
            self._output, self._judged = output, True
        return orjson.Fragment(self._output) if self._output else None

    def to_json(self) -> JsonObject:
        """Returns how it fares, without what it printed."""
        return {
            "id": self.id,
            "state": "running" if self.status is None else "ended",
            "status": self.status,
            "about": self.about or None,
            "lines": list(self._lines),
            "result": None,
            "command": self.command,
        }

    async def _follow(self) -> None:
        """Reads what it says until it has ended."""
        assert self._process.stdout is not None and self._process.stderr is not None
        await asyncio.gather(self._keep_output(self._process.stdout), self._keep_lines(self._process.stderr))
        self.status = await self._process.wait()

    async def _keep_output(self, stream: asyncio.StreamReader) -> None:
        while data := await stream.read(1 << 16):
            self._output += data[: max(0, _OUTPUT - self.kept)]

    async def _keep_lines(self, stream: asyncio.StreamReader) -> None:
        rest = ""
        while data := await stream.read(1 << 16):
            *lines, rest = (rest + data.decode(errors="replace")).replace("\r", "\n").split("\n")
            self._lines.extend(line[:_LONGEST] for line in lines if line.strip())
            rest = rest[-_LONGEST:]
        if rest.strip():
            self._lines.append(rest)


class Jobs:
    """The jobs of a lab.

    Args:
        most: How many may run at once.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._numbers = count(1)
        self._jobs: dict[int, Job] = {}
        self._starting = 0
        self._mask: set[signal.Signals | int] = set()  # the signals that were held back before any was starting

    async def start(self, arguments: Sequence[str], about: str = "") -> Job:
        """Starts `nmes` with arguments.

        Raises:
            LabError: As many run as may, or one goes on with the same thing.
        """
        running = [job for job in self._jobs.values() if job.status is None]
        if about and any(job.about == about for job in running):
            raise LabError("busy", f"{about!r} is running already", "name")
        if len(running) + self._starting >= self._most:
            reason = f"{self._most} commands are running, as many as may at once: wait, or pause one"
            raise LabError("too_many_jobs", reason)
        if self._starting == 0:
            # It begins with Ctrl-C held back, and takes it when it is ready: a Python that loads modules may drop it.
            self._mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        self._starting += 1
        try:
            process = await asyncio.create_subprocess_exec(
                sys.executable,
                "-P",  # files of the working folder are not in its way
                "-m",
                "nmes",
                *arguments,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.PIPE,
                start_new_session=True,  # Ctrl-C is for the lab, which tells its jobs
            )
        finally:
            self._starting -= 1
            if self._starting == 0:
                signal.pthread_sigmask(signal.SIG_SETMASK, self._mask)
        job = Job(next(self._numbers), arguments, about, process)
        self._jobs[job.id] = job
        self._forget()
        return job

    def _forget(self) -> None:
        """Forgets the jobs that have ended longest ago, and before that what they printed."""
        ended = [job for job in self._jobs.values() if job.status is not None]
        for job in ended[:-_ENDED]:
            del self._jobs[job.id]
        room = _ALL
        for job in ended[::-1]:
            room -= job.kept
            if room < 0:
                job.forget()

    def get(self, number: int) -> Job:
        """Returns a job.

        Raises:
            LabError: There is none of that number.
        """
        if number not in self._jobs:
            raise LabError("not_found", f"there is no job {number}", "id")
        return self._jobs[number]

    def all(self) -> list[Job]:
        """Returns all jobs, the newest first."""
        return list(self._jobs.values())[::-1]

    def of(self, about: str) -> Job | None:
        """Returns the job that goes on with a thing now, or None."""
        return next((job for job in self._jobs.values() if job.about == about and job.status is None), None)

    async def close(self) -> None:
        """Ends all jobs as Ctrl-C does."""
        await asyncio.gather(*(job.end() for job in self._jobs.values() if job.status is None))
