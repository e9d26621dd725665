"""The program that drives a client under test: it reads one instruction a line, and writes one answer a line.

It hides the process: how it is started, spoken with, and ended. Invariants: no call waits for longer than the time-out
it was given; whatever the program does wrong (silence, an early end, lines that are no JSON objects) is a `Finding`.
"""

from __future__ import annotations

import json
import os
import select
import subprocess
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

from nmes.conformance.case import Finding, NotTried
from nmes.conformance.wire import Log, clip
from nmes.errors import NmesError

__all__ = ["Driver", "NoDriver"]

_READ = 64 << 10
_PATIENCE = 2.0  # s in which a program that is told to end must end
_ANSWER_LIMIT = 64 << 20  # bytes of one answer


class NoDriver(NmesError):
    """The program cannot be started."""


class Driver:
    """A running driver."""

    def __init__(self, command: Sequence[str]) -> None:
        """Starts the program; what it writes on standard error is shown as it comes.

        Raises:
            NoDriver: It cannot be started.
        """
        try:
            self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        except OSError as error:
            raise NoDriver("unreachable", f"cannot start {command[0]}: {error.strerror}") from error
        assert self._process.stdin is not None and self._process.stdout is not None
        self._in, self._out = self._process.stdin, self._process.stdout
        os.set_blocking(self._in.fileno(), False)  # it takes what there is room for
        self._buffer = bytearray()
        self._scanned = 0  # no line ends before this

    def close(self) -> None:
        """Ends the program: it is told by the end of its input, and killed where it does not heed that."""
        with suppress(OSError):  # it has ended already
            self._in.close()
        try:
            self._process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            self.kill()
        self._out.close()

    def kill(self) -> None:
        """Ends the program at once, whatever it is doing."""
        self._process.kill()
        self._process.wait()

    def tell(self, log: Log, timeout: float, instruction: Mapping[str, Any]) -> None:
        """Writes an instruction.

        Raises:
            Finding: The program has ended, or does not read it in time.
        """
        until = time.monotonic() + timeout
        what = instruction["do"]
        unsent = memoryview(json.dumps(instruction).encode() + b"\n")
        log.add("driver", "sent", bytes(unsent))
        while unsent:
            left = max(until - time.monotonic(), 0.0)
            if not select.select([], [self._in], [], left)[1]:
                raise Finding(f"a driver that reads {what}, in time", "it does not", "a driver that does not read")
            try:
                unsent = unsent[os.write(self._in.fileno(), unsent) :]
            except OSError:
                raise self._ended(what) from None

    def hear(self, log: Log, timeout: float, what: str) -> dict[str, Any]:
        """Returns the answer to an instruction.

        Raises:
            Finding: None comes in time, or it is no JSON object on a line.
            NotTried: The client cannot do that.
        """
        line = self._line(time.monotonic() + timeout, what)
        log.add("driver", "received", line)
        try:
            answer = json.loads(line)
        except (ValueError, RecursionError):
            answer = None
        if not isinstance(answer, dict):
            raise Finding(f"an answer to {what}, a JSON object on a line", clip(line), "a driver that answers no JSON")
        if "unsupported" in answer:
            raise NotTried(f"the client cannot do that: {what}")
        return answer

    def silent(self, seconds: float) -> bool:
        """Whether the program says nothing for a while."""
        return b"\n" not in self._buffer and not select.select([self._out], [], [], seconds)[0]

    def _line(self, until: float, what: str) -> bytes:
        while (end := self._buffer.find(b"\n", self._scanned)) < 0:
            self._scanned = len(self._buffer)
            left = until - time.monotonic()
            if left <= 0 or self._scanned > _ANSWER_LIMIT or not select.select([self._out], [], [], left)[0]:
                raise Finding(f"an answer of the driver to {what}, in time", "none", "no answer in time")
            data = os.read(self._out.fileno(), _READ)
            if not data:
                raise self._ended(what)
            self._buffer += data
        line = bytes(self._buffer[:end])
        del self._buffer[: end + 1]
        self._scanned = 0
        return line

    def _ended(self, what: str) -> Finding:
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_PATIENCE)
        status = self._process.returncode
        return Finding(f"an answer of the driver to {what}", f"its end, with status {status}", "a driver that ended")
