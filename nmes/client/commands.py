"""Every command of the protocol as a method, for clients that block, that await and that collect."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from nmes.client.creature_commands import CreatureCommands
from nmes.client.cube_commands import CubeCommands
from nmes.client.declaration import Pending
from nmes.client.joint_commands import JointCommands
from nmes.client.world_commands import WorldCommands

__all__ = ["AsyncCommands", "BlockingCommands", "Commands", "Pipeline"]


class Commands(CubeCommands, JointCommands, CreatureCommands, WorldCommands):
    """Every command of the protocol, as methods. Optional fields that are None are left to the server's default."""


class BlockingCommands(Commands):
    """Commands whose methods return the reply."""

    def request(self, message: Mapping[str, Any]) -> Any:
        """Sends a command given as a dict, and returns its reply."""
        raise NotImplementedError


class AsyncCommands(Commands):
    """Commands whose methods return an awaitable of the reply."""

    async def request(self, message: Mapping[str, Any]) -> Any:
        """Sends a command given as a dict, and returns its reply."""
        raise NotImplementedError


class Pipeline(Commands):
    """Commands that are sent together, in one write, when the block of `Client.pipeline` ends.

    Its methods return a `Pending`, whose `result` is there from then on.
    """

    def __init__(self) -> None:
        self.calls: list[Pending[Any]] = []

    def request(self, message: Mapping[str, Any]) -> Pending[Any]:
        """Adds a command given as a dict."""
        pending: Pending[Any] = Pending(dict(message))
        self.calls.append(pending)
        return pending
