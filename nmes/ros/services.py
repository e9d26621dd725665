"""The services of a world: what a call becomes as a command of the protocol, and what its reply becomes for the caller.

Those under /rosapi answer at once, from what there is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from orjson import Fragment

from nmes.errors import RejectedMessage
from nmes.ros.definitions import fields, full_text, typedefs
from nmes.ros.graph import NODE, Graph, full_name
from nmes.ros.messages import WORLD_FRAME, RosError, from_ros, number, plain_type, stamp
from nmes.schemas.documents import JsonObject, parse_json, write_json
from nmes.world import World

__all__ = ["LOOKED_UP", "SERVICES", "Asked", "Service", "check_args", "look_up"]

Args = Mapping[str, Any]


class Service(NamedTuple):
    """A service that is a command of the protocol.

    Attributes:
        type: As ROS 1 writes it.
        command: Makes the command of the arguments; it raises RosError.
        values: Makes what is returned of the reply, which is no error.
        told: Whether an error is told in the values, as `success` and `status_message`; else the call fails.
    """

    type: str
    command: Callable[[Args], JsonObject]
    values: Callable[[JsonObject], JsonObject]
    told: bool = False


def _nothing(_: JsonObject) -> JsonObject:
    return {}


def _bare(kind: str) -> Service:
    """Returns a service without arguments and values, as std_srvs/Empty."""
    return Service("std_srvs/Empty", lambda _: {"type": kind}, _nothing)


def _text(args: Args, field: str, default: str | None = None) -> str:
    value = args.get(field, default)
    if not isinstance(value, str):
        raise RosError(f"{field}: a string is missing")
    return value


def _document(text: str, what: str) -> JsonObject:
    try:
        document = parse_json(text.encode())
    except (RejectedMessage, UnicodeEncodeError) as error:
        raise RosError(f"{what}: it is no JSON: {error}") from error
    if not isinstance(document, dict):
        raise RosError(f"{what}: it is no JSON object")
    return document


def _spawn(args: Args) -> JsonObject:
    """Makes `spawn_creature` of gazebo_msgs/SpawnModel, whose model is a genome here."""
    pose = args.get("initial_pose") or {}
    position = pose.get("position") or {} if isinstance(pose, dict) else None
    if not isinstance(pose, dict) or not isinstance(position, dict):
        raise RosError("initial_pose: a position, with x, y and z")
    turn = pose.get("orientation") or {}
    if not isinstance(turn, dict) or any(number(turn.get(axis, 0.0), axis) != 0.0 for axis in "xyz"):
        raise RosError("initial_pose: a creature is not turned when it is spawned: leave x, y, z of orientation at 0")
    name = _text(args, "model_name", "")
    if _text(args, "robot_namespace", "").strip("/") not in ("", name):
        raise RosError("robot_namespace: a creature's topics are under its model_name; leave it empty")
    if _text(args, "reference_frame", "") not in ("", WORLD_FRAME):
        raise RosError(f"reference_frame: a creature is spawned in the frame {WORLD_FRAME!r} alone")
    genome = _document(_text(args, "model_xml"), "model_xml, which holds a genome as JSON")
    named = {"name": name} if name else {}
    return {"type": "spawn_creature", "genome": genome, "position": from_ros(position), **named}


def _step(args: Args) -> JsonObject:
    ticks = args.get("ticks", 1)
    if isinstance(ticks, bool) or not isinstance(ticks, int):
        raise RosError("ticks: a whole number")
    return {"type": "step", "ticks": ticks}


def _command(args: Args) -> JsonObject:
    command = _document(_text(args, "command"), "command")
    inner = command.get("commands")
    for each in (command, *(inner if isinstance(inner, list) else ())):
        if isinstance(each, dict) and each.get("type") in ("subscribe", "unsubscribe"):
            raise RosError("command: events of the protocol are not told here; subscribe to topics")
    return command


SERVICES: Final[dict[str, Service]] = {
    "/spawn": Service(
        "gazebo_msgs/SpawnModel",
        _spawn,
        lambda reply: {"success": True, "status_message": f"spawned {reply['creature']}"},
        told=True,
    ),
    "/reset": _bare("reset"),
    "/pause": _bare("pause"),
    "/resume": _bare("resume"),
    "/step": Service("nmes_msgs/Step", _step, lambda reply: {"frame": reply["frame"]}),
    "/command": Service("nmes_msgs/Command", _command, lambda reply: {"reply": write_json(reply).decode()}),
}


# -- /rosapi -------------------------------------------------------------------------------------------------------


class Asked(NamedTuple):
    """A call of a service under /rosapi, and what answers it."""

    graph: Graph
    world: World
    args: Args


def _topics(asked: Asked) -> JsonObject:
    topics = asked.graph.topics
    return {"topics": list(topics), "types": [topic.type for topic in topics.values()]}


def _topic_type(asked: Asked) -> JsonObject:
    topic = asked.graph.find(_text(asked.args, "topic"))
    return {"type": "" if topic is None else topic.type}


def _topics_for_type(asked: Asked) -> JsonObject:
    kind = plain_type(_text(asked.args, "type"))[0]
    return {"topics": [name for name, topic in asked.graph.topics.items() if topic.type == kind]}


def _service_types() -> dict[str, str]:
    return {name: each.type for name, each in SERVICES.items()} | {name: each[0] for name, each in LOOKED_UP.items()}


def _services_for_type(asked: Asked) -> JsonObject:
    kind = plain_type(_text(asked.args, "type"))[0]
    return {"services": [name for name, each in _service_types().items() if each == kind]}


def _node_details(asked: Asked) -> JsonObject:
    topics = asked.graph.topics if full_name(_text(asked.args, "node")) == NODE else {}
    return {
        "subscribing": [name for name, topic in topics.items() if topic.hear is not None],
        "publishing": [name for name, topic in topics.items() if topic.read is not None],
        "services": list(_service_types()) if topics else [],
    }


def _get_time(asked: Asked) -> JsonObject:
    """Returns the world's time, as ROS 1 and as ROS 2 write it: nothing in the call says which is meant."""
    return {"time": {**stamp(asked.world, False), **stamp(asked.world, True)}}


def _get_param(asked: Asked) -> JsonObject:
    known = _PARAMS.get(full_name(_text(asked.args, "name")))
    return {"value": known or _text(asked.args, "default", "") or "null"}


def _no_params(_: Asked) -> JsonObject:
    raise RosError("there are no parameters here that could be set or deleted: commands change a world (/command)")


def _nodes_of(asked: Asked, field: str, way: str) -> JsonObject:
    topic = asked.graph.find(_text(asked.args, "topic"))
    return {field: [NODE] if topic is not None and getattr(topic, way) is not None else []}


def _topics_and_raw_types(asked: Asked) -> Fragment:
    """Returns the topics with what their types are made of: megabytes of a large world, which are written once."""
    listed = asked.graph.listed
    if "topics_and_raw_types" not in listed:
        told = _topics(asked)
        told["typedefs_full_text"] = [full_text(kind) for kind in told["types"]]
        listed["topics_and_raw_types"] = Fragment(write_json(told))
    return listed["topics_and_raw_types"]


def _service_node(asked: Asked) -> JsonObject:
    return {"node": NODE if full_name(_text(asked.args, "service")) in _service_types() else ""}


def _details(half: str) -> Callable[[Asked], JsonObject]:
    return lambda asked: {"typedefs": typedefs(_text(asked.args, "type"), half)}


_PARAMS: Final = {"/use_sim_time": "true"}  # their values, as JSON

LOOKED_UP: Final[dict[str, tuple[str, Callable[[Asked], JsonObject | Fragment]]]] = {
    "/rosapi/topics": ("rosapi/Topics", _topics),
    "/rosapi/topic_type": ("rosapi/TopicType", _topic_type),
    "/rosapi/topics_for_type": ("rosapi/TopicsForType", _topics_for_type),
    "/rosapi/services": ("rosapi/Services", lambda _: {"services": list(_service_types())}),
    "/rosapi/service_type": (
        "rosapi/ServiceType",
        lambda asked: {"type": _service_types().get(full_name(_text(asked.args, "service")), "")},
    ),
    "/rosapi/services_for_type": ("rosapi/ServicesForType", _services_for_type),
    "/rosapi/nodes": ("rosapi/Nodes", lambda _: {"nodes": [NODE]}),
    "/rosapi/node_details": ("rosapi/NodeDetails", _node_details),
    "/rosapi/get_time": ("rosapi/GetTime", _get_time),
    "/rosapi/topics_and_raw_types": ("rosapi/TopicsAndRawTypes", _topics_and_raw_types),
    "/rosapi/publishers": ("rosapi/Publishers", lambda asked: _nodes_of(asked, "publishers", "read")),
    "/rosapi/subscribers": ("rosapi/Subscribers", lambda asked: _nodes_of(asked, "subscribers", "hear")),
    "/rosapi/service_node": ("rosapi/ServiceNode", _service_node),
    "/rosapi/message_details": ("rosapi/MessageDetails", _details("")),
    "/rosapi/service_request_details": ("rosapi/ServiceRequestDetails", _details("Request")),
    "/rosapi/service_response_details": ("rosapi/ServiceResponseDetails", _details("Response")),
    "/rosapi/action_servers": ("rosapi/GetActionServers", lambda _: {"action_servers": []}),
    "/rosapi/get_param_names": ("rosapi/GetParamNames", lambda _: {"names": list(_PARAMS)}),
    "/rosapi/get_param": ("rosapi/GetParam", _get_param),
    "/rosapi/has_param": (
        "rosapi/HasParam",
        lambda asked: {"exists": full_name(_text(asked.args, "name")) in _PARAMS},
    ),
    "/rosapi/set_param": ("rosapi/SetParam", _no_params),
    "/rosapi/delete_param": ("rosapi/DeleteParam", _no_params),
}


def check_args(name: str, args: Args) -> None:
    """Raises RosError where a call of a service of that name says something that it does not take."""
    kind = SERVICES[name].type if name in SERVICES else LOOKED_UP[name][0]
    known = fields(f"{kind}Request")
    unknown = next((field for field in args if field not in known), None)
    if unknown is not None:
        takes = ", ".join(known) or "nothing"
        raise RosError(f"args: {kind} has no {unknown[:64]!r}; it takes {takes}")


def look_up(name: str, asked: Asked) -> JsonObject | Fragment:
    """Returns the answer of a service under /rosapi, as an object or as JSON.

    Raises:
        RosError: The arguments are not those that it takes.
    """
    return LOOKED_UP[name][1](asked)
