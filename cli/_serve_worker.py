"""The process of a worker of `nmes serve --workers`, which the supervisor starts."""

from __future__ import annotations

import asyncio
import gc
import socket
import sys

from nmes.cli import _logs
from nmes.cli._serve_process import COLLECTIONS, SWITCH, raise_open_files_limit
from nmes.fleet.worker import work

__all__ = ["command_of_worker"]


def command_of_worker(log_format: str, max_worlds: int) -> list[str]:
    """Returns the command that starts a worker; files of the working folder are not in its way."""
    return [sys.executable, "-P", "-m", __name__, log_format, str(max_worlds)]


def _main(log_format: str, max_worlds: str, descriptor: str) -> None:
    sys.setswitchinterval(SWITCH)
    gc.set_threshold(*COLLECTIONS)
    _logs.set_up(log_format)
    raise_open_files_limit(int(max_worlds))
    asyncio.run(work(socket.socket(fileno=int(descriptor))))


if __name__ == "__main__":
    _main(*sys.argv[1:])
