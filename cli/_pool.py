"""Where candidates and worlds are evaluated: the options that say so, and long work there that may be interrupted."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from typing import TYPE_CHECKING, Final, TypeVar

import click

from nmes.cli._interruptions import interruptions

if TYPE_CHECKING:
    from nmes.evaluation.parallel import Cluster, Workers

__all__ = ["JOBS", "RAY", "advance_in_pool", "check_pool", "open_pool"]

JOBS: Final = click.option("--jobs", type=click.IntRange(1), help="How many processes.  [default: one a core]")
RAY: Final = click.option("--ray", metavar="ADDRESS", help="Use a Ray cluster instead: HOST:PORT, auto, or local.")

Kept = TypeVar("Kept")
"""What is kept in a folder and gone on with: a run of evolution, a survey."""


def check_pool(jobs: int | None, ray: str | None) -> None:
    """Refuses options that do not go together."""
    if jobs is not None and ray is not None:
        raise click.UsageError("either --jobs or --ray")


def open_pool(jobs: int | None, ray: str | None) -> Workers | Cluster:
    """Opens the processes or the cluster that the options mean.

    One job, too, has a process of its own: an engine that crashes ends that, and not the run.

    Raises:
        MissingPackage: Ray is not installed.
        MachineError: There is no cluster.
    """
    from nmes.evaluation.parallel import Cluster, Workers

    return Workers(jobs or os.cpu_count() or 1) if ray is None else Cluster(ray)


def advance_in_pool(
    find: Callable[[], Kept],
    jobs: int | None,
    ray: str | None,
    advance: Callable[[Kept, Workers | Cluster, Callable[[], bool]], None],
) -> tuple[Kept, bool]:
    """Goes on with what is kept in a folder, until it is done or somebody stops it.

    Args:
        find: Returns it, and may begin it: where there are no processes and no cluster, nothing is begun.
        jobs: As `open_pool`.
        ray: As `open_pool`.
        advance: Goes on with it in a pool; the function that it is given tells whether it is to stop, by
            `KeyboardInterrupt`.

    Returns:
        What was found, and whether somebody has stopped it.

    Raises:
        KeyboardInterrupt: It was interrupted before there was anything.
        MissingPackage, MachineError: As `open_pool`.
    """
    found: Kept | None = None
    with interruptions(signal.SIGINT, signal.SIGTERM) as interrupted:
        try:
            with open_pool(jobs, ray) as pool:
                found = find()
                advance(found, pool, interrupted)
        except KeyboardInterrupt:
            if found is None:
                raise
    return found, interrupted()
