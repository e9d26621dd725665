"""What a world may be besides its cubes: stopped by a fault, or waiting at a barrier."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Barrier", "Fault"]


@dataclass(frozen=True, slots=True)
class Fault:
    """Why a world has stopped: a code of `world_fault`, a message for a person, the last good frame.

    `cube` is the cube over which the engine failed, where it says which; `cause` the exception, where there was one.
    """

    code: str
    message: str
    frame: int
    cube: str | None = None
    cause: Exception | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Barrier:
    """The wish that the world tick when all who control it have said `step`. It is the host that waits and ticks.

    Attributes:
        agents: How many clients must have said `step` before the first tick.
        timeout: How long those that wait for others wait, s.
    """

    agents: int
    timeout: float
