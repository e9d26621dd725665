"""What a world tells and hears, as messages of ROS: their types, their frames of reference and their time.

A world's y points up. In ROS z does (REP 103): x forward, y left, z up. So the world is turned by a quarter about x,
and all that has a direction is turned with it; what is told of joints is the same in both.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from orjson import OPT_SERIALIZE_NUMPY, Fragment, dumps

from nmes.schemas.documents import JsonObject, write_json
from nmes.world import World

__all__ = [
    "WORLD_FRAME",
    "RosError",
    "clock",
    "frames_of",
    "from_ros",
    "joint_state",
    "joint_targets",
    "number",
    "plain_type",
    "pose_stamped",
    "ros_name",
    "stamp",
    "to_ros",
    "transforms",
]

WORLD_FRAME: Final = "world"  # the frame of reference that poses are told in
_ODD = re.compile(r"[^A-Za-z0-9_/]+")
_ROS_AXES: Final = [0, 2, 1, 3, 5, 4, 6]  # of a row of states, in the order in which ROS tells them
_ROS_SIGNS: Final = np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0, 1.0])
_TRANSFORM: Final = (
    b'{"header":%b,"child_frame_id":%b,"transform":{"translation":{"x":%b,"y":%b,"z":%b},'
    b'"rotation":{"x":%b,"y":%b,"z":%b,"w":%b}}}'
)
MOST_JOINTS: Final = 4096  # that one message may name


class RosError(Exception):
    """What a client of the bridge said cannot be done."""

    def __init__(self, message: str) -> None:
        """Makes an error whose message a client is told."""
        super().__init__(message)
        self.message = message


def ros_name(name: str) -> str:
    """Returns the name of a cube, a joint or a creature as a part of a topic's: `rocker.torso` is `rocker/torso`."""
    return _ODD.sub("_", name.replace(".", "/")).strip("/") or "_"


def plain_type(name: str) -> tuple[str, bool]:
    """Returns a type's name as ROS 1 writes it, and whether it was written as in ROS 2: `std_msgs/msg/Float64`."""
    package, _, rest = name.partition("/")
    kind, _, base = rest.partition("/")
    return (f"{package}/{base}", True) if base and kind in ("msg", "srv") else (name, False)


def to_ros(vector: Sequence[float]) -> JsonObject:
    """Returns a vector of the world (m, m/s), or the vector part of a quaternion, along the axes of ROS."""
    x, y, z = vector
    return {"x": x, "y": -z, "z": y}


def from_ros(point: Mapping[str, Any]) -> tuple[float, float, float]:
    """Returns a vector of ROS along the axes of the world.

    Raises:
        RosError: It has a component that is no number.
    """
    x, y, z = (number(point.get(axis, 0.0), axis) for axis in "xyz")
    return x, z, -y


def number(value: Any, what: str) -> float:
    """Returns a number of a message.

    Raises:
        RosError: It is none.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise RosError(f"{what} is no number")
    return float(value)


def stamp(world: World, ros2: bool) -> JsonObject:
    """Returns the time of a world: since it was created or reset."""
    seconds, rest = divmod(round(1e9 * world.frame / world.config["tick_rate"]), 1_000_000_000)
    return {"sec": seconds, "nanosec": rest} if ros2 else {"secs": seconds, "nsecs": rest}


def _header(world: World, ros2: bool, frame: str = WORLD_FRAME) -> JsonObject:
    head: JsonObject = {"stamp": stamp(world, ros2), "frame_id": frame}
    return head if ros2 else {"seq": world.frame & 0xFFFFFFFF, **head}


def clock(world: World, ros2: bool) -> JsonObject:
    """Returns a world's time as rosgraph_msgs/Clock."""
    return {"clock": stamp(world, ros2)}


def joint_state(world: World, joints: Mapping[str, str], ros2: bool) -> JsonObject:
    """Returns sensor_msgs/JointState of hinges (rad, rad/s, N m) and slides (m, m/s, N).

    Args:
        world: The world.
        joints: The joints' names in the message, and in the world.
        ros2: Whether times are written as in ROS 2.
    """
    entities = world.entities
    numbers = [entities.joint(name).number for name in joints.values()]
    readings = entities.simulation.joint_readings(numbers).T.tolist()
    head, names = _header(world, ros2, ""), list(joints)
    return {"header": head, "name": names, "position": readings[0], "velocity": readings[1], "effort": readings[2]}


def _placed(state: Sequence[float]) -> tuple[JsonObject, JsonObject]:
    """Returns where a cube is and how it is turned, of its row of states."""
    return to_ros(state[:3]), {**to_ros(state[3:6]), "w": state[6]}


def pose_stamped(world: World, cube: str, ros2: bool) -> JsonObject:
    """Returns geometry_msgs/PoseStamped of a cube: its centre, m."""
    entities = world.entities
    position, orientation = _placed(entities.simulation.states([entities.cube(cube).body])[0].tolist())
    return {"header": _header(world, ros2), "pose": {"position": position, "orientation": orientation}}


def frames_of(world: World) -> list[bytes | None]:
    """Returns the names of the frames of a world's cubes, as JSON; None where another, or the world, has it too."""
    names = [ros_name(name) for name in world.cubes()]
    counts = Counter([WORLD_FRAME, *names])
    return [write_json(name) if counts[name] == 1 else None for name in names]


def transforms(world: World, ros2: bool, frames: Sequence[bytes | None]) -> JsonObject:
    """Returns tf2_msgs/TFMessage: from the world to each of its cubes that has a frame, of `frames_of`.

    The list is JSON already: of 5,000 cubes it is made after each tick, and making objects first takes five times as
    long.
    """
    head, states = write_json(_header(world, ros2)), world.entities.states()
    turned = np.ascontiguousarray(states[:, _ROS_AXES] * _ROS_SIGNS)
    rows = dumps(turned, option=OPT_SERIALIZE_NUMPY)[2:-2].split(b"],[")
    told = [_TRANSFORM % (head, frame, *row.split(b",")) for frame, row in zip(frames, rows, strict=False) if frame]
    return {"transforms": Fragment(b"[%b]" % b",".join(told))}


def joint_targets(message: Mapping[str, Any]) -> list[tuple[str, JsonObject]]:
    """Returns the joints that a sensor_msgs/JointState names, each with the parameters of `set_joint_params`.

    `position` is what a servo aims at, `velocity` what a motor aims at, `effort` the most that it may give. An array
    that is empty asks nothing.

    Raises:
        RosError: The arrays do not fit together, or hold something else.
    """
    names = message.get("name")
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise RosError("name: the joints' names are to be listed")
    if len(names) > MOST_JOINTS:
        raise RosError(f"name: {len(names):,} joints; the most is {MOST_JOINTS:,}")
    asked: list[JsonObject] = [{} for _ in names]
    meanings = (("position", "target_position"), ("velocity", "motor_target_velocity"), ("effort", "motor_max_force"))
    for field, parameter in meanings:
        values = message.get(field) or []
        if not isinstance(values, list) or len(values) not in (0, len(names)):
            raise RosError(f"{field}: one number for each of {len(names)} joints, or none at all")
        for params, value in zip(asked, values, strict=False):
            params[parameter] = number(value, field)
    if not asked[0]:
        raise RosError("position, velocity and effort are all empty: nothing is asked of the joints")
    return list(zip(names, asked, strict=True))
