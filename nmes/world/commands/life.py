"""The commands about an ecosystem: it is looked at, and fed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nmes.errors import WorldError
from nmes.schemas.documents import JsonObject
from nmes.world.clients import Client
from nmes.world.life import Life
from nmes.world.rights import Right, everything, nothing

if TYPE_CHECKING:
    from nmes.world.world import World

__all__ = ["COMMANDS", "RIGHTS"]


def _life(world: World) -> Life:
    if world.life is None:
        raise WorldError("unsupported", "this world has no life: its config says so, or not, in the field life")
    return world.life


def get_life(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Tells what there is to eat, and who lives."""
    life, rate = _life(world), world.entities.tick_rate
    living = [
        {
            "creature": each.name,
            "energy": each.energy,
            "age": (world.frame - each.born) / rate,
            "generation": each.generation,
            "species": each.species,
            "parents": each.parents,
            "meals": each.meals,
        }
        for each in life.living
    ]
    food = [{"position": [x, y, z], "energy": energy} for x, y, z, energy in life.food.items.tolist()]
    facts = {"frame": world.frame, "t": world.time, "born": life.born, "died": life.died}
    return {"type": "life", **facts, "food": food, "living": living}


def feed(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Puts food on the ground."""
    life = _life(world)
    x, _, z = world.entities.fields.position(command["position"])
    place = world.entities.terrain.surface(x, z)
    if not life.food.put(place, float(command.get("energy", world.config["life"]["food"]["energy"]))):
        raise WorldError("limit_reached", f"there is food at {len(life.food.items)} places already, as many as may be")
    return {"type": "fed", "position": list(place), "food": len(life.food.items)}


COMMANDS = {"get_life": get_life, "feed": feed}

RIGHTS = {"get_life": Right("look", everything), "feed": Right("build", nothing)}
