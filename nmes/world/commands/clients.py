"""The commands about the client itself: its subscription, and its objectives and rewards."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nmes import protocol
from nmes.errors import WorldError
from nmes.objective import Objective
from nmes.schemas.documents import JsonObject
from nmes.world.client_objectives import metric
from nmes.world.clients import Client
from nmes.world.commands.cubes import named_or_own_cube
from nmes.world.entities import Cube
from nmes.world.rights import Right, Touched, nothing
from nmes.world.subscription import Subscription

if TYPE_CHECKING:
    from nmes.world.world import World

__all__ = ["COMMANDS", "RIGHTS", "observed_cubes"]


def subscribe(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Sends the client events from now on, in place of those that it has subscribed to before."""
    default = protocol.COMMANDS["subscribe"].defaults
    client.subscription = subscription = Subscription(
        events=tuple(dict.fromkeys(command.get("events", default["events"]))),
        every=command.get("every", default["every"]),
        position_threshold=float(command.get("position_threshold", default["position_threshold"])),
        rotation_threshold=float(command.get("rotation_threshold", default["rotation_threshold"])),
    )
    return {
        "type": "subscribed",
        "events": subscription.events,
        "every": subscription.every,
        "position_threshold": subscription.position_threshold,
        "rotation_threshold": subscription.rotation_threshold,
    }


def unsubscribe(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Sends the client no more events."""
    client.subscription = None
    return {"type": "unsubscribed"}


def set_objective(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Sets an objective over a creature, over some cubes, or over the client's own cube."""
    return client.objectives.set(world.entities, world.frame, observed_cubes(world, client, command), command)


def observed_cubes(world: World, client: Client, command: JsonObject) -> dict[str, Cube]:
    """Returns the cubes that a `set_objective` command is about, by the ids that its expression may use for them.

    Raises:
        WorldError: `cube_not_found`, `creature_not_found`, `nothing_owned`; `invalid`: it names cubes and a creature.
    """
    entities = world.entities
    if "creature" in command:
        if "cubes" in command:
            raise WorldError("invalid", "cubes: either cubes or a creature, not both", "cubes")
        parts = world.creature(command["creature"]).cubes
        return {part: entities.cube(name) for part, name in parts.items()}
    if "cubes" in command:
        return {name: entities.cube(name, f"cubes/{i}") for i, name in enumerate(command["cubes"])}
    own = named_or_own_cube(world, client, None)
    return {own.name: own}


def compute_reward(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Computes a metric of a cube, or the value of one of the client's objectives."""
    if "metric" not in command:
        return client.objectives.value(world.entities, world.frame, command.get("objective"))
    if "objective" in command:
        raise WorldError("invalid", "objective: either a metric or an objective, not both", "objective")
    own = "cube" not in command
    cube = named_or_own_cube(world, client, None) if own else world.entities.cube(command["cube"], "cube")
    return metric(world.entities, cube, command)


COMMANDS = {
    "subscribe": subscribe,
    "unsubscribe": unsubscribe,
    "set_objective": set_objective,
    "compute_reward": compute_reward,
}


def _events(world: World, client: Client, command: JsonObject) -> Touched:
    return () if command.get("events") == ["tick"] else None  # the others are about all cubes


def _observed(world: World, client: Client, command: JsonObject) -> Touched:
    """The cubes of an objective, and those that its expression names besides."""
    cubes = observed_cubes(world, client, command)
    needs = Objective(command["expression"]).needs
    others = dict.fromkeys(need.cube for need in needs if need.cube is not None and need.cube not in cubes)
    return [*cubes.values(), *(world.entities.cube(name, "expression") for name in others)]


def _rewarded(world: World, client: Client, command: JsonObject) -> Touched:
    if "metric" not in command:
        return client.objectives.cubes(command.get("objective"))
    if "cube" in command:
        return [world.entities.cube(command["cube"], "cube")]
    return [named_or_own_cube(world, client, None)]


RIGHTS = {
    "subscribe": Right("look", _events),
    "unsubscribe": Right(None, nothing),
    "set_objective": Right("look", _observed),
    "compute_reward": Right("look", _rewarded),
}
