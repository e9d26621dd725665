"""What the types of messages and services are made of, as ROS 1 writes it.

It hides how those who ask /rosapi are told: as lists of fields (`typedefs`), or as text (`full_text`).
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Final, NamedTuple

from nmes.ros.messages import RosError, plain_type
from nmes.schemas.documents import JsonObject

__all__ = ["MESSAGES", "SERVICES", "Field", "fields", "full_text", "parts", "typedefs"]

MESSAGES: Final[dict[str, str]] = {
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Pose": "Point position\nQuaternion orientation",
    "geometry_msgs/PoseStamped": "Header header\nPose pose",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Transform": "Vector3 translation\nQuaternion rotation",
    "geometry_msgs/TransformStamped": "Header header\nstring child_frame_id\nTransform transform",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "rosapi/TypeDef": (
        "string type\nstring[] fieldnames\nstring[] fieldtypes\nint32[] fieldarraylen\nstring[] examples\n"
        "string[] constnames\nstring[] constvalues"
    ),
    "rosgraph_msgs/Clock": "time clock",
    "sensor_msgs/JointState": "Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort",
    "std_msgs/Float64": "float64 data",
    "std_msgs/Float64MultiArray": "MultiArrayLayout layout\nfloat64[] data",
    "std_msgs/Header": "uint32 seq\ntime stamp\nstring frame_id",
    "std_msgs/MultiArrayDimension": "string label\nuint32 size\nuint32 stride",
    "std_msgs/MultiArrayLayout": "MultiArrayDimension[] dim\nuint32 data_offset",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
}

SERVICES: Final[dict[str, tuple[str, str]]] = {
    "gazebo_msgs/SpawnModel": (
        "string model_name\nstring model_xml\nstring robot_namespace\ngeometry_msgs/Pose initial_pose\n"
        "string reference_frame",
        "bool success\nstring status_message",
    ),
    "nmes_msgs/Command": ("string command", "string reply"),
    "nmes_msgs/Step": ("int64 ticks", "int64 frame"),
    "rosapi/DeleteParam": ("string name", ""),
    "rosapi/GetActionServers": ("", "string[] action_servers"),
    "rosapi/GetParam": ("string name\nstring default", "string value"),
    "rosapi/GetParamNames": ("", "string[] names"),
    "rosapi/GetTime": ("", "time time"),
    "rosapi/HasParam": ("string name", "bool exists"),
    "rosapi/MessageDetails": ("string type", "TypeDef[] typedefs"),
    "rosapi/NodeDetails": ("string node", "string[] subscribing\nstring[] publishing\nstring[] services"),
    "rosapi/Nodes": ("", "string[] nodes"),
    "rosapi/Publishers": ("string topic", "string[] publishers"),
    "rosapi/ServiceNode": ("string service", "string node"),
    "rosapi/ServiceRequestDetails": ("string type", "TypeDef[] typedefs"),
    "rosapi/ServiceResponseDetails": ("string type", "TypeDef[] typedefs"),
    "rosapi/ServiceType": ("string service", "string type"),
    "rosapi/Services": ("", "string[] services"),
    "rosapi/ServicesForType": ("string type", "string[] services"),
    "rosapi/SetParam": ("string name\nstring value", ""),
    "rosapi/Subscribers": ("string topic", "string[] subscribers"),
    "rosapi/TopicType": ("string topic", "string type"),
    "rosapi/Topics": ("", "string[] topics\nstring[] types"),
    "rosapi/TopicsAndRawTypes": ("", "string[] topics\nstring[] types\nstring[] typedefs_full_text"),
    "rosapi/TopicsForType": ("string type", "string[] topics"),
    "std_srvs/Empty": ("", ""),
}

_ATOMS: Final = {
    "bool": "False", "float64": "0.0", "int32": "0", "int64": "0", "string": "", "time": "{}", "uint32": "0"
}  # fmt: skip
_TIME: Final = "int32 secs\nint32 nsecs"  # which /rosapi lists as if it were a message
_RULE: Final = "=" * 80


class Field(NamedTuple):
    """One field of a type.

    Attributes:
        name: Its name.
        type: An atom of ROS, or a message's type in full.
        array: Whether it is an array of them, of any length.
    """

    name: str
    type: str
    array: bool


@cache
def fields(kind: str) -> dict[str, Field]:
    """Returns the fields of a type by name: a message's, or of a service's `Request` or `Response`.

    Raises:
        RosError: Nothing here is of that type.
    """
    package, read = kind.partition("/")[0], {}
    for line in _text(kind).splitlines():
        type, name = line.split(" ")
        item, array = type.removesuffix("[]"), type.endswith("[]")
        if item not in _ATOMS and "/" not in item:
            item = "std_msgs/Header" if item == "Header" else f"{package}/{item}"
        read[name] = Field(name, item, array)
    return read


def _text(kind: str) -> str:
    for half, ending in enumerate(("Request", "Response")):
        if kind.endswith(ending) and kind.removesuffix(ending) in SERVICES:
            return SERVICES[kind.removesuffix(ending)][half]
    text = _TIME if kind == "time" else MESSAGES.get(kind)
    if text is None:
        raise RosError(f"type: nothing here is of type {kind!r}")
    return text


@cache
def parts(kind: str) -> tuple[str, ...]:
    """Returns a type and all that it is made of, each once, as they come, with `time` but no other atom."""

    def walk(kind: str) -> Iterator[str]:
        yield kind
        for field in fields(kind).values():
            if field.type not in _ATOMS or field.type == "time":
                yield from walk(field.type)

    return tuple(dict.fromkeys(walk(kind)))


def typedefs(kind: str, half: str = "") -> list[JsonObject]:
    """Returns the rosapi/TypeDef of a type and of all that it is made of.

    Args:
        kind: The type, as ROS 1 or ROS 2 writes it.
        half: `Request` or `Response` of a service; nothing of a message.

    Raises:
        RosError: Nothing here is of that type.
    """
    return [_typedef(part) for part in parts(plain_type(kind)[0] + half)]


def _typedef(kind: str) -> JsonObject:
    listed = list(fields(kind).values())
    return {
        "type": kind,
        "fieldnames": [field.name for field in listed],
        "fieldtypes": [field.type for field in listed],
        "fieldarraylen": [0 if field.array else -1 for field in listed],
        "examples": ["[]" if field.array else _ATOMS.get(field.type, "{}") for field in listed],
        "constnames": [],
        "constvalues": [],
    }


@cache
def full_text(kind: str) -> str:
    """Returns a message's type as text, and below it all that it is made of, as bag files have it."""
    below = (f"\n{_RULE}\nMSG: {part}\n{_text(part)}\n" for part in parts(kind)[1:] if part != "time")
    return f"{_text(kind)}\n{''.join(below)}"
