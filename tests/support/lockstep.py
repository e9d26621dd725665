"""A world in lockstep, and a client that says commands to it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nmes import World

__all__ = ["Say", "world_of"]

Say = Callable[..., dict[str, Any]]


def world_of(**config: Any) -> tuple[World, Say]:
    """Returns a world in lockstep, and what says commands to it."""
    world = World({"mode": "lockstep", **config})
    client = world.join()
    return world, lambda kind, **fields: world.execute(client, {"type": kind, **fields})
