"""How a process that serves worlds is set up, be it the one host or a worker: files, garbage, threads."""

from __future__ import annotations

import click

__all__ = ["COLLECTIONS", "SWITCH", "raise_open_files_limit"]

SWITCH = 0.0005  # s: for how long a world's thread keeps Python's lock from the event loop; 0.005 would be usual
# A full collection of garbage holds that lock for some 15 us a cube of a world: it is done less often than usual.
COLLECTIONS = (10_000, 20, 20)
FILES = 32  # that a host has open with a client or two: sockets, a recording, what asyncio and the engine need


def raise_open_files_limit(worlds: int) -> None:
    """Makes room for as many sockets and recordings as the system allows: 1,024 are too few for 1,024 clients.

    Raises:
        ClickException: It allows too few to begin with; asyncio would end with tracebacks.
    """
    try:
        import resource
    except ImportError:  # Windows has no such limit
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = 4096 + worlds if hard == resource.RLIM_INFINITY else min(4096 + worlds, hard)
    if wanted < FILES:
        raise click.ClickException(f"a host needs {FILES} open files, {hard} are allowed: see `ulimit -n`")
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
