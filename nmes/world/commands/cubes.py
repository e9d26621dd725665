"""The commands about cubes: they come and go, are pushed, moved, frozen and looked at."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nmes import protocol
from nmes.errors import WorldError
from nmes.schemas.documents import JsonObject
from nmes.world import readings
from nmes.world.clients import Client
from nmes.world.entities import Cube, cube_not_found
from nmes.world.rights import Right, Touched, everything, named, nothing
from nmes.world.structure import connected_cubes, joined_cubes

if TYPE_CHECKING:
    from nmes.world.world import World

__all__ = ["COMMANDS", "RIGHTS", "named_or_own_cube"]

_ACTING = frozenset({"force", "torque", "impulse", "angular_impulse"})
_PUSH = frozenset({"type", "cube_name", "at", *_ACTING})


def named_or_own_cube(world: World, client: Client, name: str | None) -> Cube:
    """Returns the cube of that name, or, where a command names none, the one that its client spawned last.

    Raises:
        WorldError: `cube_not_found`, `nothing_owned`.
    """
    target = client.owned if name is None else name
    if target is None:
        raise WorldError("nothing_owned", "no cube_name given, and this connection has spawned no cube")
    cube = world.entities.cubes.get(target)
    if cube is None and name is not None:
        raise cube_not_found(name)
    if cube is None:
        raise WorldError("nothing_owned", f"the cube of this connection, {target!r}, is gone")
    return cube


def spawn_cube(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Makes a cube, which its client then owns."""
    cube = world.entities.spawn(command)
    cube.player, client.owned = client.player, cube.name
    reply: JsonObject = {"type": "cube_list", "spawned": cube.name}
    asked = command.get("position", protocol.COMMANDS["spawn_cube"].defaults["position"])
    if cube.origin != world.entities.fields.position(asked):
        reply["moved_to"] = cube.origin
    role = client.role
    if command.get("list", True) and (role is None or role.allows("get_cube_list", client.player, None)):
        reply["cubes"] = world.cubes()
    return reply


def despawn_cube(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Removes a cube, and the joints on it."""
    cube = world.entities.cube(command["cube_name"])
    return {"type": "cube_despawned", "cube_name": cube.name, "joints": world.entities.despawn(cube)}


def apply_physics(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Pushes and turns a cube during the next tick."""
    cube = named_or_own_cube(world, client, command.get("cube_name"))
    if _ACTING.isdisjoint(command):
        raise WorldError("invalid", "nothing acts: give a force, torque, impulse or angular_impulse")
    world.entities.apply(cube, command)
    pushes = world.pushes  # noted here, since each call counts in a command so frequent
    if pushes.frame != world.frame:
        pushes.frame, pushes.commands = world.frame, {}  # so there are never more than there are cubes
    if not command.keys() <= _PUSH:  # what is said besides is not kept
        command = {key: command[key] for key in _PUSH if key in command}
    pushes.commands[cube.name] = command
    return {"type": "physics_applied", "cube_name": cube.name}


def set_cube_state(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Puts a cube somewhere else, with all that is joined to it."""
    cube = world.entities.cube(command["cube_name"])
    moved_to = world.entities.move(cube, command)
    reply: JsonObject = {"type": "cube_state_set", "cube_name": cube.name}
    return reply if moved_to is None else {**reply, "moved_to": moved_to}


def freeze_cube(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Makes a cube immovable, or lets it go."""
    cube = world.entities.cube(command["cube_name"])
    world.entities.freeze(cube, command["freeze"])
    return {"type": "cube_frozen", "cube_name": cube.name, "freeze": cube.frozen}


def set_color(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Gives a cube another colour."""
    cube = world.entities.cube(command["cube_name"])
    world.entities.paint(cube, command["color"])
    return {"type": "color_set", "cube_name": cube.name, "color": cube.color}


def get_cube_list(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Lists the cubes' names in order of creation."""
    return {"type": "cube_list", "cubes": world.cubes()}


def get_cube_state(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Reads a cube's pose and velocities."""
    cube = named_or_own_cube(world, client, command.get("cube_name"))
    return {"type": "cube_state", **readings.cube_state(world.entities, cube)}


def get_cube_info(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Reads all that is known of a cube; its sensors and distances along rays where they are asked for."""
    entities = world.entities
    cube = entities.cube(command["cube_name"])
    reply = {"type": "cube_info", **readings.cube_info(entities, cube)}
    if world.roles:
        reply["player"] = cube.player
    if command.get("sensors"):
        reply.update(readings.inertial(entities, [cube])[0])
    if "rays" in command:
        default = protocol.COMMANDS["get_cube_info"].defaults
        limit = float(command.get("max_range", default["max_range"]))
        reply["ranges"] = readings.ranges(entities, cube, command["rays"], limit)
    return reply


def get_camera(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Takes a picture with a camera that is fixed to a cube."""
    cube = named_or_own_cube(world, client, command.get("cube_name"))
    return {"type": "camera_image", **readings.camera(world.entities, cube, command)}


COMMANDS = {
    "spawn_cube": spawn_cube,
    "despawn_cube": despawn_cube,
    "apply_physics": apply_physics,
    "apply_force": apply_physics,
    "set_color": set_color,
    "set_cube_state": set_cube_state,
    "freeze_cube": freeze_cube,
    "get_cube_list": get_cube_list,
    "get_cube_info": get_cube_info,
    "get_cube_state": get_cube_state,
    "get_camera": get_camera,
}


def _named_or_own(world: World, client: Client, command: JsonObject) -> Touched:
    return [named_or_own_cube(world, client, command.get("cube_name"))]


def _with_structure(world: World, client: Client, command: JsonObject) -> Touched:
    """All that joints connect with the cube: it is moved along."""
    return connected_cubes(world.entities.cube(command["cube_name"]), world.entities.joints)


def _with_neighbours(world: World, client: Client, command: JsonObject) -> Touched:
    """The cube, and those that it is joined to: they lose a joint."""
    return joined_cubes(world.entities.cube(command["cube_name"]), world.entities.joints)


RIGHTS = {
    "spawn_cube": Right("build", nothing),
    "despawn_cube": Right("build", _with_neighbours),
    "apply_physics": Right("act", _named_or_own),
    "apply_force": Right("act", _named_or_own),
    "set_color": Right("act", named("cube_name")),
    "set_cube_state": Right("act", _with_structure),
    "freeze_cube": Right("act", named("cube_name")),
    "get_cube_list": Right("look", everything),
    "get_cube_info": Right("look", named("cube_name")),
    "get_cube_state": Right("look", _named_or_own),
    "get_camera": Right("look", _named_or_own),
}
