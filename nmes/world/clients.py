"""Who is in a world: what each client owns and wants to be told, and the events that subscribers are sent.

It hides how an event is made once for all who get it, and what must outlive a snapshot. It knows no sockets: where
events go is the caller's.

Invariants: numbers are never used twice; what subscribers were told does not depend on whether anybody listened.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from nmes import protocol
from nmes.backend import Array
from nmes.world.client_objectives import ClientObjectives
from nmes.world.entities import Entities
from nmes.world.subscription import Subscription

__all__ = ["Client", "Clients", "Emit"]

Emit = Callable[[int, bytes], None]  # takes a client's number and an encoded event


@dataclass(slots=True)
class Client:
    """One connection to a world: the cube that it spawned last, what it is told unasked, and its objectives."""

    number: int
    owned: str | None = None
    subscription: Subscription | None = None
    objectives: ClientObjectives = field(default_factory=ClientObjectives)


class Clients(dict[int, Client]):
    """Those who are in, by number, in order of arrival."""

    _next = 1

    def join(self) -> int:
        """Lets one in; returns its number."""
        number = self._next
        self._next += 1
        self[number] = Client(number)
        return number

    @property
    def ever(self) -> int:
        """How many came so far."""
        return self._next - 1

    def announce(self, emit: Emit | None, event: Mapping[str, Any]) -> None:
        """Sends an event to all subscribers."""
        if emit is not None:
            encoded = protocol.encode(event)
            for client in self.values():
                if client.subscription is not None:
                    emit(client.number, encoded)

    def measure(self, entities: Entities) -> None:
        """Has all objectives note what they must of a tick that has just ended."""
        for client in self.values():
            if client.objectives:
                client.objectives.tick(entities)

    def tick(
        self, emit: Emit | None, frame: int, time: float, version: int, poses: Callable[[], tuple[list[str], Array]]
    ) -> None:
        """Sends subscribers the events of a frame whose turn it is.

        Args:
            emit: Where they go; None: nowhere, but they count as sent.
            frame: The frame.
            time: The same in s.
            version: The structure version.
            poses: Returns names and states of the cubes; asked only when somebody is to be told of them.
        """
        tick = b""
        names: list[str] = []
        states: Array | None = None
        for client in self.values():
            subscription = client.subscription
            if subscription is None or frame % subscription.every:
                continue
            if "tick" in subscription.events and emit is not None:
                tick = tick or protocol.encode({"type": "tick", "t": time, "frame": frame})
                emit(client.number, tick)
            if "state" in subscription.events:
                if states is None:
                    names, states = poses()
                cubes, removed = subscription.changes(version, names, states)
                if (cubes or removed) and emit is not None:
                    head = protocol.encode({"type": "state", "t": time, "frame": frame})[:-1]
                    gone = protocol.encode(removed)
                    emit(client.number, b'%b,"cubes":%b,"removed":%b}' % (head, cubes or b"[]", gone))

    def snapshot(self, entities: Entities) -> dict[str, Any]:
        """Returns all of it as plain JSON data, in a world of these cubes."""
        return {
            "next_client": self._next,
            "clients": [
                {
                    "client": client.number,
                    "owned": client.owned,
                    "subscription": None if client.subscription is None else client.subscription.state(),
                    "objectives": client.objectives.state(entities),
                }
                for client in self.values()
            ],
        }

    @classmethod
    def restored(cls, state: Mapping[str, Any], entities: Entities) -> Clients:
        """Returns those of whom `snapshot` told, in a world of these cubes.

        Raises:
            ValueError: What they were told does not fit together.
            WorldError: Their objectives do not fit the cubes.
        """
        clients = cls()
        clients._next = state["next_client"]
        for given in state["clients"]:
            told = given["subscription"]
            subscription = None if told is None else Subscription.restored(told)
            clients[given["client"]] = Client(
                given["client"], given["owned"], subscription, ClientObjectives.restored(given["objectives"], entities)
            )
        return clients
