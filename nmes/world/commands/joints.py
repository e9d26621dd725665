"""The commands about joints and bones."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nmes import protocol
from nmes.schemas.documents import JsonObject
from nmes.world.clients import Client
from nmes.world.entities import identity

if TYPE_CHECKING:
    from nmes.world.world import World

__all__ = ["COMMANDS"]


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
    world.entities.set_param(joint, name, value)
    return {"type": "joint_param_set", "joint_name": joint.name, "param_name": name, "value": value}


def get_joint_list(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Lists the joints with their types and cubes, in order of creation."""
    return {"type": "joint_list", "joints": [identity(joint) for joint in world.entities.joints.values()]}


def get_joint_info(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Reads all that is known of a joint."""
    return {"type": "joint_info", **world.entities.joint_info(world.entities.joint(command["joint_name"]))}


COMMANDS = {
    "create_joint": create_joint,
    "create_bone": create_bone,
    "remove_joint": remove_joint,
    "set_joint_param": set_joint_param,
    "get_joint_list": get_joint_list,
    "get_joint_info": get_joint_info,
}
