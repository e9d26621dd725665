"""The commands about the world as a whole, and `batch`, which holds other commands."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nmes import protocol
from nmes.backend.fingerprint import VERSION
from nmes.errors import RejectedMessage, WorldError
from nmes.protocol import Request
from nmes.schemas.documents import JsonObject
from nmes.world import readings
from nmes.world.clients import Client
from nmes.world.rights import Right, Touched, nothing
from nmes.world.scenery import planet_list

if TYPE_CHECKING:
    from nmes.backend import Backend
    from nmes.world.entities import Entities
    from nmes.world.world import World

__all__ = ["COMMANDS", "RIGHTS", "capabilities"]

_BATCH_TICKS = 10_000  # as many as one `step` may ask for: others wait meanwhile
_BATCH_REPLY = 8 << 20  # bytes of replies after which the rest of a batch is refused

# Capabilities, of the engine or of what the world's config asks for, by command.
_NEEDED = {
    "create_bone": "joint.conetwist",
    "get_camera": "camera",
    "give": "roles",
    "get_life": "life",
    "feed": "life",
}


def ping(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Answers, and does nothing else."""
    return {"type": "pong"}


def get_world_state(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Reads the poses and velocities of all cubes, or of those that are named."""
    entities, names = world.entities, command.get("cubes")
    if names is None:
        cubes = list(entities.cubes.values())
    else:
        cubes = [entities.cube(name, f"cubes/{i}") for i, name in enumerate(names)]
    states = readings.cube_states(entities, cubes, sensors=bool(command.get("sensors")))
    return {"type": "world_state", "frame": world.frame, "t": world.time, "cubes": states}


def get_world_info(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Reads what the world is: its engine, config, mode, limits, capabilities and fault."""
    fault, entities, backend = world.fault, world.entities, world.backend
    return {
        "type": "world_info",
        "world": world.config["name"],
        "backend": backend.name,
        "versions": {"nmes": VERSION, "protocol": protocol.PROTOCOL_VERSION, "engine": backend.version()},
        "dims": backend.dims,
        "seed": world.seed,
        "config": world.config,
        "mode": world.mode,
        "rate": world.rate,
        "paused": world.paused,
        "frame": world.frame,
        "t": world.time,
        "counts": {
            "cubes": len(entities.cubes),
            "joints": len(entities.joints),
            "clients": len(world.clients()),
        },
        "limits": world.config["limits"],
        "skeletons": _skeletons(entities, client),
        "capabilities": capabilities(backend, _features(world)),
        "fault": None if fault is None else {"code": fault.code, "frame": fault.frame, "message": fault.message},
    }


def _skeletons(entities: Entities, client: Client) -> list[JsonObject]:
    """Returns the skeletons in order of their oldest bones, without bones that the client may not look at."""
    role, bones = client.role, dict[str | int, list[str]]()
    for joint in entities.joints.values():
        ends = joint.cube1, joint.cube2
        if joint.skeleton is not None and (role is None or role.allows("get_joint_info", client.player, ends)):
            bones.setdefault(joint.skeleton, []).append(joint.name)
    return [{"snake_id": snake, "bones": names} for snake, names in bones.items()]


def _features(world: World) -> frozenset[str]:
    """Returns which of `roles` and `life` the world's config asks for."""
    asked = {"roles": bool(world.roles), "life": world.life is not None}
    return frozenset(name for name, there in asked.items() if there)


def capabilities(backend: Backend, features: frozenset[str]) -> list[str]:
    """Returns the optional commands that a world serves and what it and its engine can do, sorted.

    Args:
        backend: The engine.
        features: What the world has beside: `roles`, `life`.
    """
    optional = {kind for kind, schema in protocol.COMMANDS.items() if not schema.required}
    able = backend.capabilities | features
    lacking = {kind for kind, capability in _NEEDED.items() if capability not in able}
    return sorted((optional - lacking) | able)


def get_planets(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Lists the planets of the scene."""
    planets = planet_list(world.config, world.seed)
    if planets and world.life is not None:
        planets = [{**planets[0], "ResourceLocations": _resources(world, planets[0]["Position"])}, *planets[1:]]
    return {"type": "planets", "planets": planets}


def _resources(world: World, centre: JsonObject) -> list[JsonObject]:
    """Returns where food is, from the centre of the first planet, as if its diameter were 1."""
    diameter = 2.0 * world.config["scene"]["planets"]["radius"]
    places = (world.entities.food - tuple(centre.values())) / diameter
    return [dict(zip("xyz", place, strict=True)) for place in places.tolist()]


def batch(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Executes commands one after another, also where one of them is refused."""
    commands = command["commands"]
    ticks = sum(inner.get("ticks", 1) for inner in commands if inner["type"] == "step")
    if ticks > _BATCH_TICKS:
        raise WorldError("invalid", f"commands: {ticks} ticks in one batch, at most {_BATCH_TICKS}", "commands")
    results: list[JsonObject] = []
    size = 0
    for inner in commands:
        request = _inner_request(inner, full=size > _BATCH_REPLY)
        world.in_batch = True
        try:
            results.append(world.answer(client, request))
        finally:
            world.in_batch = False
        size += len(protocol.encode(results[-1]))
    return {"type": "batch_result", "results": results}


def _inner_request(command: JsonObject, full: bool) -> Request:
    """Makes a request of a command of a batch, which was validated with it; where the reply is full, one to refuse."""
    if command["type"] == "spawn_cube" and "list" not in command:
        command = {**command, "list": False}
    kind, number = command["type"], command.get("id", protocol.NO_ID)
    if full:
        message = f"the replies of this batch are over {_BATCH_REPLY >> 20} MiB; send the rest anew"
        return Request(b"", None, RejectedMessage("limit_reached", message), kind, number)
    return Request(b"", command, None, kind, number)


COMMANDS = {
    "ping": ping,
    "get_world_state": get_world_state,
    "get_world_info": get_world_info,
    "get_planets": get_planets,
    "batch": batch,
}


def _listed(world: World, client: Client, command: JsonObject) -> Touched:
    names = command.get("cubes")
    return None if names is None else [world.entities.cube(name, f"cubes/{i}") for i, name in enumerate(names)]


RIGHTS = {
    "ping": Right(None, nothing),
    "get_world_state": Right("look", _listed),
    "get_world_info": Right(None, nothing),
    "get_planets": Right(None, nothing),
    "batch": Right(None, nothing),  # its parts are judged one by one
}
