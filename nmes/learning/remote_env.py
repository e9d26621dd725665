"""A creature in a world of a live host, as an environment of Gymnasium; or in several worlds, as a vector of them.

    env = Remote("127.0.0.1:14000", task="walk", genome="walker", password="...")
    envs = RemoteVector("127.0.0.1:14000", count=8, task="walk", genome="walker", password="...")

They are the environments of this machine over another core. What happens is recorded by the host.
"""

from __future__ import annotations

import ssl
from collections.abc import Sequence

from gymnasium.vector import AutoresetMode

from nmes.evaluation.task import Task, TaskLike
from nmes.genome import Genome
from nmes.genome.genome import GenomeLike
from nmes.learning.environment import CreatureEnv
from nmes.learning.remote import RemoteEnvironments
from nmes.learning.vector import AUTORESET, CreatureVectorEnv

__all__ = ["Remote", "RemoteVector"]


class Remote(CreatureEnv):
    """A creature on a task in a world of a live host, which is emptied for it.

    A `step` or `reset` raises `Disconnected` or `TimeoutError` where the host is gone, `CommandFailed` where it refuses
    the creature, and `WorldError` (`disturbed`) where somebody else steps or resets the world. The next `reset` then
    connects anew and begins another episode.
    """

    def __init__(
        self,
        address: str,
        *,
        task: TaskLike,
        genome: GenomeLike,
        password: str,
        world: str | None = None,
        tls: bool | ssl.SSLContext = False,
        timeout: float | None = 10.0,
        reward: str | None = None,
        seeds: Sequence[int] | None = None,
        render_mode: str | None = None,
    ) -> None:
        """Connects, and looks whether the world can be one of the task.

        Args:
            address: `HOST:PORT` of the host, or `[HOST]:PORT` where the host is an IPv6 address.
            task: What the creature is asked to do: the name of a task that ships, a file, a document, or a `Task`.
            genome: The creature, likewise.
            password: The host's.
            world: The name of the world; the host's first if left out.
            tls: As for `nmes.Client`.
            timeout: How long a reply may take, s; None waits for ever.
            reward: An expression whose value at a tick is its reward; None: by how much the task's objective grew.
            seeds: Of the scenes that episodes take; the task's if left out.
            render_mode: As for `CreatureEnv`: the pictures are those of a world here that is driven with the same
                actions.

        Raises:
            ValueError: It is no address, there are no seeds, or no such mode.
            DocumentError: Genome or task cannot be read, or is not as it must be.
            Disconnected, TimeoutError: The host cannot be reached.
            CommandFailed: It lets nobody in, or has no such world.
            WorldError: The creature does not fit the task, the reward is no expression, or the world is not one of the
                task (`wrong_world`, `unsupported`).
        """
        core = RemoteEnvironments(
            address,
            Genome.load(genome),
            Task.load(task),
            password=password,
            worlds=None if world is None else [world],
            tls=tls,
            timeout=timeout,
            seeds=seeds,
            reward=reward,
            autoreset="disabled",
        )
        super().__init__(core, render_mode=render_mode)


class RemoteVector(CreatureVectorEnv):
    """Copies of a creature on a task, each in a world of its own of one live host; errors are those of `Remote`."""

    def __init__(
        self,
        address: str,
        *,
        count: int,
        task: TaskLike,
        genome: GenomeLike,
        password: str,
        worlds: Sequence[str] | None = None,
        tls: bool | ssl.SSLContext = False,
        timeout: float | None = 10.0,
        reward: str | None = None,
        seeds: Sequence[int] | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        copy: bool = True,
    ) -> None:
        """Connects, once a world, and looks whether the worlds can be those of the task.

        Args:
            address: As for `Remote`.
            count: The number of copies.
            task: As for `Remote`.
            genome: As for `Remote`.
            password: The host's.
            worlds: The names of the worlds, one a copy; the first ones of the host if left out.
            tls: As for `nmes.Client`.
            timeout: How long a reply may take, s; None waits for ever.
            reward: As for `Remote`.
            seeds: As for `Remote`.
            autoreset_mode: As for `CreatureVectorEnv`.
            copy: As for `CreatureVectorEnv`.

        Raises:
            ValueError: As by `Remote`, or there are not as many worlds as copies.
            DocumentError, Disconnected, TimeoutError, CommandFailed: As by `Remote`.
            WorldError: As by `Remote`, or the host has too few worlds (`too_few_worlds`).
        """
        mode = AutoresetMode(autoreset_mode)
        core = RemoteEnvironments(
            address,
            Genome.load(genome),
            Task.load(task),
            count,
            password=password,
            worlds=worlds,
            tls=tls,
            timeout=timeout,
            seeds=seeds,
            reward=reward,
            autoreset=AUTORESET[mode],
        )
        super().__init__(core, mode, copy=copy)
