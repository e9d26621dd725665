"""The command by which cubes and creatures pass from one player to another."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nmes.errors import WorldError
from nmes.schemas.documents import JsonObject
from nmes.world.clients import Client
from nmes.world.entities import Cube
from nmes.world.rights import Right
from nmes.world.structure import connected_cubes

if TYPE_CHECKING:
    from nmes.world.world import World

__all__ = ["COMMANDS", "RIGHTS", "given_cubes"]


def given_cubes(world: World, command: JsonObject) -> list[Cube]:
    """Returns the cubes that a `give` command is about: what it names, with all that joints connect to it.

    So joints never come to lie between what is mine and what was mine.

    Raises:
        WorldError: `cube_not_found`, `creature_not_found`; `invalid`: it names both, or neither.
    """
    if ("cube_name" in command) == ("creature" in command):
        raise WorldError("invalid", "cube_name: give either a cube or a creature", "cube_name")
    if "cube_name" in command:
        name = command["cube_name"]
    else:  # joints connect all cubes of a creature
        name = next(iter(world.creature(command["creature"]).cubes.values()))
    return connected_cubes(world.entities.cube(name), world.entities.joints)


def give(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Makes cubes belong to another player."""
    if not world.roles:
        raise WorldError("unsupported", "this world has no roles: nothing in it belongs to anybody")
    player = command["player"]
    cubes = given_cubes(world, command)
    world.require_player(player)
    for cube in cubes:
        cube.player = player
    return {"type": "given", "player": player, "cubes": [cube.name for cube in cubes]}


COMMANDS = {"give": give}
RIGHTS = {"give": Right("give", lambda world, client, command: given_cubes(world, command))}
