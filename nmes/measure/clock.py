"""A world that ticks by the clock and waits for nobody, as a client far from it has it.

    with clock_world(rate=4.0) as world:
        world.do({"type": "spawn_cube", "position": [0, 0.5, 0]})
        world.tick()  # hears of the next tick

Hides the host, which is a process of its own, and the connection to it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from nmes.client import Client
from nmes.errors import MachineError
from nmes.measure.hosts import running_host
from nmes.schemas.documents import JsonObject

__all__ = ["ClockWorld", "clock_world"]


class ClockWorld:
    """A world of a host, over one connection.

    Attributes:
        frame: The tick that was heard of last.
    """

    def __init__(self, client: Client) -> None:
        self._client = client
        client.subscribe(events=["tick"])
        self.frame: int = client.get_world_info()["frame"]

    def do(self, command: JsonObject) -> JsonObject:
        """Sends a command, and returns the reply.

        Raises:
            CommandFailed: The world refuses it.
            Disconnected, TimeoutError: The host is gone.
        """
        reply: JsonObject = self._client.request(command)
        self._hear()
        return reply

    def tick(self) -> None:
        """Waits until the world has ticked again; where several ticks were missed, it is at the last one at once.

        Raises:
            Disconnected, TimeoutError: The host is gone.
            MachineError: The world was closed (`cannot_measure`).
        """
        for event in self._client.events(self._client.timeout):
            if event["type"] == "tick":
                self.frame = event["frame"]
                return self._hear()
        raise MachineError("cannot_measure", "the world ticks no more: its host has ended, or is held up")

    def close(self) -> None:
        """Leaves the host to whoever began it."""

    def _hear(self) -> None:
        """Takes what has come."""
        for event in self._client.events(0):
            if event["type"] == "tick":
                self.frame = event["frame"]


@contextmanager
def clock_world(rate: float) -> Iterator[ClockWorld]:
    """Runs a host of one world.

    Args:
        rate: How many seconds of the world there are in one of the clock.

    Raises:
        MachineError: No host begins (`cannot_measure`).
    """
    with running_host("realtime", rate) as host, host.connect() as client:
        yield ClockWorld(client)
