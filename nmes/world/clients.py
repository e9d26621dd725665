"""The clients of a world: what each one owns, its subscription and objectives, and the events that it is sent.

It hides how an event is encoded once for all who get it, and what a snapshot must hold of clients. It knows no
sockets: where events go is the caller's.

Invariants: numbers are never used twice; what counts as sent does not depend on whether anybody listened.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from nmes import protocol
from nmes.backend import Array
from nmes.world.client_objectives import ClientObjectives
from nmes.world.entities import Entities
from nmes.world.subscription import Subscription

__all__ = ["Client", "Clients", "Emit"]

logger = logging.getLogger(__name__)

Emit = Callable[[int, bytes], None]  # takes a client's number and an encoded event


@dataclass(slots=True)
class Client:
    """One connection to a world: the name of the cube that it spawned last, its subscription, its objectives."""

    number: int
    owned: str | None = None
    subscription: Subscription | None = None
    objectives: ClientObjectives = field(default_factory=ClientObjectives)


class Clients(dict[int, Client]):
    """The clients that are in, by number, in order of arrival."""

    _next = 1

    def join(self) -> int:
        """Adds a client; returns its number."""
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
        """Updates all objectives after a tick."""
        for client in self.values():
            if client.objectives:
                client.objectives.tick(entities)

    def tick(self, emit: Emit | None, frame: int, entities: Entities) -> None:
        """Sends subscribers the events of a frame whose turn it is; with no `emit` they only count as sent."""
        tick = b""
        names: list[str] = []
        states: Array | None = None
        for client in self.values():
            subscription = client.subscription
            if subscription is None or frame % subscription.every:
                continue
            time = frame / entities.tick_rate
            if "tick" in subscription.events and emit is not None:
                tick = tick or protocol.encode({"type": "tick", "t": time, "frame": frame})
                emit(client.number, tick)
            if "state" in subscription.events:
                if states is None:
                    names, states = list(entities.cubes), entities.states()
                try:
                    cubes, removed = subscription.changes(entities.version, names, states)
                except Exception as error:  # a mistake of ours in what one client is told: no other need know
                    logger.error("the subscription of client %d failed, and ends", client.number, exc_info=error)
                    client.subscription = None
                    continue
                if (cubes or removed) and emit is not None:
                    head = protocol.encode({"type": "state", "t": time, "frame": frame})[:-1]
                    tail = protocol.encode(removed)
                    emit(client.number, b'%b,"cubes":%b,"removed":%b}' % (head, cubes or b"[]", tail))

    def snapshot(self, entities: Entities) -> dict[str, Any]:
        """Returns the clients as plain JSON data; `entities` are those of their world."""
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
        """Rebuilds the clients of a snapshot, in a world with these entities.

        Raises:
            ValueError: A subscription does not fit together.
            WorldError: An objective does not fit the cubes.
        """
        clients = cls()
        clients._next = state["next_client"]
        for values in state["clients"]:
            subscription = values["subscription"]
            clients[values["client"]] = Client(
                values["client"],
                values["owned"],
                None if subscription is None else Subscription.restored(subscription),
                ClientObjectives.restored(values["objectives"], entities),
            )
        return clients
