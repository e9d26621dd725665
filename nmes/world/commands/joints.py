"""The commands about joints and bones."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nmes import protocol
from nmes.schemas.documents import JsonObject
from nmes.world import linking, readings
from nmes.world.clients import Client
from nmes.world.entities import identity
from nmes.world.rights import Right, Touched, everything, named

if TYPE_CHECKING:
    from nmes.world.world import World

__all__ = ["COMMANDS", "RIGHTS"]


def create_joint(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Joins two cubes."""
    return {"type": "joint_created", "joint_name": world.entities.connect(command, command["joint_type"], "joint")}


def create_bone(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Joins two cubes by a bone of a skeleton."""
    skeleton = command.get("snake_id", protocol.COMMANDS["create_bone"].defaults["snake_id"])
    return {"type": "bone_created", "bone_name": world.entities.connect(command, "conetwist", "bone", skeleton)}


def remove_joint(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Removes a joint; its cubes stay."""
    joint = world.entities.joint(command["joint_name"])
    world.entities.cut(joint)
    return {"type": "joint_removed", "joint_name": joint.name}


def set_joint_param(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Sets one parameter of a joint."""
    joint, name, value = world.entities.joint(command["joint_name"]), command["param_name"], command["value"]
    world.entities.set_params(joint, {name: value}, "value")
    return {"type": "joint_param_set", "joint_name": joint.name, "param_name": name, "value": value}


def set_joint_params(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Sets several parameters of a joint at once, and what is to be kept with it."""
    joint, params = world.entities.joint(command["joint_name"]), command["params"]
    world.entities.set_params(joint, params, "params/{}", command.get("notes"))
    known = {name: value for name, value in params.items() if name in joint.params}
    return {"type": "joint_params_set", "joint_name": joint.name, "params": known}


def get_joint_list(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Lists the joints with their types and cubes, in order of creation."""
    return {"type": "joint_list", "joints": [identity(joint) for joint in world.entities.joints.values()]}


def get_joint_info(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Reads all that is known of a joint."""
    return {"type": "joint_info", **readings.joint_info(world.entities, world.entities.joint(command["joint_name"]))}


def get_joints_for_cube(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Lists the names of a cube's joints, in order of creation."""
    cube = world.entities.cube(command["cube_name"])
    return {"type": "joints_for_cube", "cube_name": cube.name, "joints": list(cube.joints)}


def link_cube_chains(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Joins the neighbours in each of several chains of cubes."""
    return {"type": "cubes_linked", "joints": linking.link_chains(world.entities, command)}


def link_body_cubes(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Joins those of the cubes with some prefix that touch or nearly touch, and are not joined yet."""
    return {"type": "cubes_linked", "joints": linking.link_neighbours(world.entities, command)}


COMMANDS = {
    "create_joint": create_joint,
    "create_bone": create_bone,
    "remove_joint": remove_joint,
    "set_joint_param": set_joint_param,
    "set_joint_params": set_joint_params,
    "get_joint_list": get_joint_list,
    "get_joint_info": get_joint_info,
    "get_joints_for_cube": get_joints_for_cube,
    "link_body_cubes": link_body_cubes,
    "link_cube_chains": link_cube_chains,
}


def _ends(world: World, client: Client, command: JsonObject) -> Touched:
    joint = world.entities.joint(command["joint_name"])
    return [joint.cube1, joint.cube2]


def _chains(world: World, client: Client, command: JsonObject) -> Touched:
    chains = enumerate(command["chains"])
    return [world.entities.cube(name, f"chains/{i}/{j}") for i, chain in chains for j, name in enumerate(chain)]


def _prefixed(world: World, client: Client, command: JsonObject) -> Touched:
    return [cube for name, cube in world.entities.cubes.items() if name.startswith(command["prefix"])]


RIGHTS = {
    "create_joint": Right("build", named("cube1", "cube2")),
    "create_bone": Right("build", named("cube1", "cube2")),
    "remove_joint": Right("build", _ends),
    "set_joint_param": Right("act", _ends),
    "set_joint_params": Right("act", _ends),
    "get_joint_list": Right("look", everything),
    "get_joint_info": Right("look", _ends),
    "get_joints_for_cube": Right("look", named("cube_name")),
    "link_body_cubes": Right("build", _prefixed),
    "link_cube_chains": Right("build", _chains),
}
