"""The commands about channels: what cubes and creatures say, and what they hear."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nmes.errors import WorldError
from nmes.schemas.documents import JsonObject
from nmes.world.clients import Client
from nmes.world.commands.cubes import named_or_own_cube
from nmes.world.rights import Right, Touched

if TYPE_CHECKING:
    from nmes.world.world import World

__all__ = ["COMMANDS", "RIGHTS"]

_MOST_HEARD = 100  # voices in one reply


def say(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Has a cube, or the root of a creature, say something on a channel, or fall silent there."""
    name, value = command["channel"], command.get("value")
    channel = world.channels.require(name, "channel")
    body, _ = _ears(world, client, command)
    values = None if value is None else tuple(map(float, value if isinstance(value, list) else [value]))
    if values is not None and len(values) != channel.size:
        expected = "1 number" if channel.size == 1 else f"{channel.size} numbers"
        raise WorldError("invalid", f"value: a voice on {name!r} has {expected}, got {len(values)}", "value")
    world.channels.say(body, name, values)
    return {"type": "said", "channel": name, "cube_name": world.entities.body_names[body]}


def hear(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Tells what a cube, or a creature at its root, hears on a channel."""
    name, names = command["channel"], world.entities.body_names
    world.channels.require(name, "channel")
    body, own = _ears(world, client, command)
    place = world.simulation.body_state(body).position
    heard = [
        {"cube_name": names[voice.body], "value": list(voice.values), "distance": voice.distance}
        for voice in world.channels.hear(name, place, own, _MOST_HEARD)
    ]
    return {"type": "heard", "channel": name, "voices": heard}


def _ears(world: World, client: Client, command: JsonObject) -> tuple[int, tuple[int, ...]]:
    """Returns the number of the cube that speaks or hears, and those of all cubes that it does not hear."""
    if "creature" in command:
        creature = world.creature(command["creature"])
        return creature.root, creature.bodies
    body = named_or_own_cube(world, client, command.get("cube_name")).body
    return body, (body,)


COMMANDS = {"say": say, "hear": hear}


def _of_whom(world: World, client: Client, command: JsonObject) -> Touched:
    """The cube, or all cubes of the creature, that speaks or hears."""
    if "creature" in command:
        return [world.entities.cube(name) for name in world.creature(command["creature"]).cubes.values()]
    return [named_or_own_cube(world, client, command.get("cube_name"))]


RIGHTS = {"say": Right("act", _of_whom), "hear": Right("look", _of_whom)}
