"""The program `nmes`, run in a process of its own as users run it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from servers import PATIENCE

NMES = str(Path(sys.executable).parent / "nmes")


@contextmanager
def process(*arguments: str, **environment: str) -> Iterator[subprocess.Popen[str]]:
    """Runs a command, and kills it in the end; a password of the caller's environment is not passed on."""
    inherited = {name: value for name, value in os.environ.items() if name != "NMES_PASSWORD"}
    with subprocess.Popen(
        [NMES, *arguments],
        env={**inherited, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as running:
        try:
            yield running
        finally:
            running.kill()


def ready(server: subprocess.Popen[str]) -> dict[str, Any]:
    """Returns the line that `nmes serve --json` prints once it is ready: addresses, worlds and recordings."""
    assert server.stdout is not None
    line = server.stdout.readline()
    assert line, server.communicate(timeout=PATIENCE)
    document = json.loads(line)
    assert isinstance(document, dict)
    return document


@contextmanager
def signal_handler(number: signal.Signals, handler: Callable[..., Any] | signal.Handlers) -> Iterator[None]:
    """Sets how this process handles a signal for the length of a block, however it was started.

    What a script runs in the background, or under `nohup`, ignores some signals, and so do the processes it starts.
    """
    before = signal.signal(number, handler)
    try:
        yield
    finally:
        signal.signal(number, before)
