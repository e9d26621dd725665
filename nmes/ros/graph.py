"""The topics and services of a world, by name; which there are follows from the cubes, joints and creatures in it.

It hides how what is told on a topic is read from the world, and which commands of the protocol what is heard becomes.
Reading changes nothing. Names that two things would share belong to neither: `ambiguous` says so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final, NamedTuple
from weakref import ref

from orjson import Fragment

from nmes.ros import messages
from nmes.ros.messages import RosError, number, ros_name
from nmes.schemas.documents import JsonObject, write_json
from nmes.world import World
from nmes.world.entities import Entities, Joint

__all__ = ["NODE", "Graph", "Topic", "Views", "full_name"]

NODE: Final = "/nmes"  # the node that the world is, for those who ask

_STATES = "sensor_msgs/JointState"
_MOVING = frozenset({"hinge", "slide"})  # the joints that have a position

Read = Callable[[World, bool], JsonObject]
Hear = Callable[[Mapping[str, Any]], JsonObject]


def full_name(name: str) -> str:
    """Returns the name of a topic or a service with its leading slash."""
    return name if name.startswith("/") else f"/{name}"


class Topic(NamedTuple):
    """A topic: what the world tells, or what it listens to; one of both is None.

    Attributes:
        type: As ROS 1 writes it.
        read: Makes the message that is told; its second argument is whether times are written as in ROS 2.
        hear: Makes the command of the protocol of a message; it raises RosError.
    """

    type: str
    read: Read | None = None
    hear: Hear | None = None


class Graph:
    """The topics of a world as it was when this was made.

    Attributes:
        topics: By name.
        ambiguous: Names that several things would have.
        listed: What services have told of all topics, which stays the same; by the service.
        version: The world's `structure_version`.
    """

    def __init__(self, world: World) -> None:
        """Looks at a world, which must be readable."""
        self.version = world.structure_version
        self.topics: dict[str, Topic] = {}
        self.ambiguous: set[str] = set()
        self.listed: dict[str, Fragment] = {}
        joints = {name: joint for name, joint in world.entities.joints.items() if joint.kind in _MOVING}
        self._add("clock", Topic("rosgraph_msgs/Clock", messages.clock))
        self._add("tf", Topic("tf2_msgs/TFMessage", partial(messages.transforms, frames=messages.frames_of(world))))
        every = {name: name for name in joints}
        self._add_joints("", every)
        for name in world.cubes():
            read = partial(_pose, cube=name)
            self._add(f"{ros_name(name)}/pose", Topic("geometry_msgs/PoseStamped", read))
        for name, joint in joints.items():
            hear = partial(_turn, joint=joint)
            self._add(f"{ros_name(name)}/command", Topic("std_msgs/Float64", None, hear))
        for name in world.creatures():
            creature = world.creature(name)
            own = {each: str(joint) for each, joint in creature.joints.items() if str(joint) in joints}
            self._add_joints(f"{ros_name(name)}/", own)
            drive = partial(_drive, creature=name, most=len(creature.body.outputs))
            self._add(f"{ros_name(name)}/command", Topic("std_msgs/Float64MultiArray", None, drive))

    def find(self, name: str) -> Topic | None:
        """Returns the topic of a name, which may lack its leading slash."""
        return self.topics.get(full_name(name))

    def _add_joints(self, prefix: str, joints: Mapping[str, str]) -> None:
        self._add(f"{prefix}joint_states", Topic(_STATES, partial(_joints, joints=joints)))
        self._add(f"{prefix}joint_command", Topic(_STATES, None, partial(_targets, joints=joints)))

    def _add(self, name: str, topic: Topic) -> None:
        name = f"/{name}"
        if name in self.topics or name in self.ambiguous:
            self.topics.pop(name, None)
            self.ambiguous.add(name)
        else:
            self.topics[name] = topic


def _pose(world: World, ros2: bool, *, cube: str) -> JsonObject:
    return messages.pose_stamped(world, cube, ros2)


def _joints(world: World, ros2: bool, *, joints: Mapping[str, str]) -> JsonObject:
    return messages.joint_state(world, joints, ros2)


def _turn(message: Mapping[str, Any], *, joint: Joint) -> JsonObject:
    value, servo = number(message.get("data"), "data"), joint.params["target_position"] is not None
    parameter = "target_position" if servo else "motor_target_velocity"
    return {"type": "set_joint_param", "joint_name": joint.name, "param_name": parameter, "value": value}


def _drive(message: Mapping[str, Any], *, creature: str, most: int) -> JsonObject:
    data = message.get("data")
    if not isinstance(data, list):
        raise RosError("data: one number for each motor, from -1 to 1")
    if len(data) > most:  # before each is looked at; that there are too few, the command says
        raise RosError(f"data: {creature!r} takes {most:,} controls, got {len(data):,}")
    return {"type": "drive", "creature": creature, "controls": [number(value, "data") for value in data]}


def _targets(message: Mapping[str, Any], *, joints: Mapping[str, str]) -> JsonObject:
    commands = []
    for name, params in messages.joint_targets(message):
        if name not in joints:
            raise RosError(f"name: there is no joint {name!r} here")
        commands.append({"type": "set_joint_params", "joint_name": joints[name], "params": params})
    return commands[0] if len(commands) == 1 else {"type": "batch", "commands": commands}


class Views:
    """What one world tells on its topics now: each message is made once, for all who listen.

    Attributes:
        latest: The topics when they were looked at last; None: they never were.
    """

    def __init__(self) -> None:
        """Begins with nothing."""
        self.latest: Graph | None = None
        self._moment: tuple[int, int] | None = None
        self._made: dict[tuple[str, bool], bytes] = {}
        self._entities: Callable[[], Entities | None] = lambda: None  # of which they are: those that woke are others

    def graph(self, world: World) -> Graph:
        """Returns the topics of a world, which must be readable."""
        graph = self.latest
        if graph is None or self._entities() is not world.entities or graph.version != world.structure_version:
            graph = self.latest = Graph(world)
            self._entities, self._moment = ref(world.entities), None
        return graph

    def text(self, world: World, name: str, ros2: bool) -> bytes | None:
        """Returns the `publish` of a topic as it is now; None: there is no such topic, or nothing is told there."""
        topic = self.graph(world).find(name)
        if topic is None or topic.read is None:
            return None
        moment = world.entities.moments, world.entities.edits
        if moment != self._moment:
            self._moment = moment
            self._made.clear()
        text = self._made.get((name, ros2))
        if text is None:
            message = {"op": "publish", "topic": name, "msg": topic.read(world, ros2)}
            text = self._made[name, ros2] = write_json(message)
        return text
