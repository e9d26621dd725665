"""The clients of a world: what each one owns, its subscription and objectives, and the events that it is sent.

It hides how an event is encoded once for all who get it, and what a snapshot must hold of clients. It knows no
sockets: where events go is the caller's.

Invariants: numbers are never used twice; what counts as sent does not depend on whether anybody listened.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from nmes import protocol
from nmes.backend import Array
from nmes.errors import WorldError
from nmes.world.client_objectives import ClientObjectives
from nmes.world.entities import Entities
from nmes.world.subscription import Subscription

if TYPE_CHECKING:
    from nmes.world.roles import Role

__all__ = ["Client", "Clients", "Emit"]

logger = logging.getLogger(__name__)

Emit = Callable[[int, bytes], None]  # takes a client's number and an encoded event


@dataclass(slots=True)
class Client:
    """One connection to a world: the name of the cube that it spawned last, its subscription, its objectives.

    In a world with roles it has a role, and is that of a player, who may have others, and may come back.
    """

    number: int
    owned: str | None = None
    subscription: Subscription | None = None
    objectives: ClientObjectives = field(default_factory=ClientObjectives)
    role: Role | None = None
    player: int | None = None


class Clients(dict[int, Client]):
    """The clients that are in, by number, in order of arrival.

    Args:
        roles: The roles of their world, by name; none where it has no roles.

    Attributes:
        players: How many players came so far: they are numbered from 1.
    """

    def __init__(self, roles: Mapping[str, Role]) -> None:
        super().__init__()
        self.players = 0
        self._next = 1
        self._roles = roles

    def join(self, name: str | None, player: int | None) -> Client:
        """Adds a client.

        Args:
            name: That of its role; None where there are no roles.
            player: The number of a player who comes back, or of the next one; None: the next one.

        Raises:
            WorldError: `role_not_found`, `player_not_found`.
        """
        if name is not None and name not in self._roles:
            known = ", ".join(map(repr, self._roles)) or "none"
            raise WorldError("role_not_found", f"there is no role {name!r} in this world, which has {known}", "role")
        if player is not None and not 1 <= player <= (self.players + 1 if self._roles else 0):
            raise WorldError("player_not_found", f"there is no player {player}", "player")
        client = Client(self._next)
        if name is not None:
            client.role, client.player = self._roles[name], self.players + 1 if player is None else player
            self.players = max(self.players, client.player)
        self._next += 1
        self[client.number] = client
        return client

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

    def tell(self, emit: Emit | None, kind: str, events: Sequence[Mapping[str, Any]]) -> None:
        """Sends events to those who are subscribed to their kind."""
        hearers = [each for each in self.values() if each.subscription and kind in each.subscription.events]
        if emit is not None and hearers:
            for encoded in map(protocol.encode, events):
                for client in hearers:
                    emit(client.number, encoded)

    def measure(self, entities: Entities) -> None:
        """Updates all objectives after a tick."""
        for client in self.values():
            if client.objectives:
                client.objectives.tick(entities)

    def heard(self, frame: int, ticks: float) -> int:
        """Returns how many subscribers are told of something in the next of so many ticks after a frame."""
        everyone = [client.subscription for client in self.values() if client.subscription is not None]
        return sum(frame % each.every + ticks >= each.every for each in everyone)

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
        """Returns the clients, and with roles whose is what, as plain JSON data; `entities` are their world's."""
        return {
            **({"roles": self._ownership(entities)} if self._roles else {}),
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

    def _ownership(self, entities: Entities) -> dict[str, Any]:
        """Returns who plays in which role, and whose each cube is, as plain JSON data."""
        return {
            "players": self.players,
            "clients": [
                {"role": client.role.name, "player": client.player}
                for client in self.values()
                if client.role is not None
            ],
            "cubes": [cube.player for cube in entities.cubes.values()],
        }

    def _restore_ownership(self, state: Mapping[str, Any], entities: Entities) -> None:
        self.players = state["players"]
        for client, values in zip(self.values(), state["clients"], strict=True):
            client.role, client.player = self._roles[values["role"]], values["player"]
        for cube, player in zip(entities.cubes.values(), state["cubes"], strict=True):
            cube.player = player
        players = [client.player for client in self.values()], [cube.player for cube in entities.cubes.values()]
        if any(player is not None and player > self.players for numbers in players for player in numbers):
            raise ValueError("a player has a number that nobody has")

    @classmethod
    def restored(cls, state: Mapping[str, Any], entities: Entities, roles: Mapping[str, Role]) -> Clients:
        """Rebuilds the clients of a snapshot, in a world with these entities and roles, and whose each cube is.

        Raises:
            ValueError: A subscription, or who plays, does not fit together.
            KeyError: There is no such role.
            WorldError: An objective does not fit the cubes.
        """
        clients = cls(roles)
        clients._next = state["next_client"]
        for values in state["clients"]:
            subscription = values["subscription"]
            clients[values["client"]] = Client(
                values["client"],
                values["owned"],
                None if subscription is None else Subscription.restored(subscription),
                ClientObjectives.restored(values["objectives"], entities),
            )
        if roles:
            clients._restore_ownership(state["roles"], entities)
        return clients
