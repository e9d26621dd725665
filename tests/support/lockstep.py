"""A world in lockstep, and a client that says commands to it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nmes import World, protocol

__all__ = ["Say", "ask", "joined", "refused", "world_of"]

Say = Callable[..., dict[str, Any]]


def world_of(**config: Any) -> tuple[World, Say]:
    """Returns a world in lockstep, and what says commands to it."""
    world = World({"mode": "lockstep", **config})
    client = world.join()
    return world, lambda kind, **fields: world.execute(client, {"type": kind, **fields})


def joined(backend: str = "mujoco", **config: Any) -> tuple[World, int]:
    """Returns a world in lockstep, and the number of a client in it."""
    world = World({"mode": "lockstep", "backend": backend, **config})
    return world, world.join()


def ask(world: World, client: int, kind: str, **fields: Any) -> dict[str, Any]:
    """Says a command, which must not be refused; returns the reply, once its schema has taken it."""
    reply = _said(world, client, kind, fields)
    assert reply["type"] != "error", reply
    return reply


def refused(world: World, client: int, kind: str, **fields: Any) -> dict[str, Any]:
    """Says a command, which must be refused; returns the error, once its schema has taken it."""
    reply = _said(world, client, kind, fields)
    assert reply["type"] == "error", reply
    return reply


def _said(world: World, client: int, kind: str, fields: dict[str, Any]) -> dict[str, Any]:
    reply = world.execute(client, {"type": kind, **fields})
    protocol.validate_reply(reply)
    return reply
