"""A live world in Rerun, seen through a client of any server.

It hides the questions to the server: as few as can be, since a world must not become slower for being looked at.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from colorsys import hls_to_rgb
from contextlib import suppress
from math import inf
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from nmes import protocol
from nmes.backend.rotation import conjugate, multiply, rotate
from nmes.client import Client
from nmes.client.conversation import understood
from nmes.errors import CommandFailed, Disconnected, NmesError
from nmes.recording.viewer_messages import Shape
from nmes.view.canvas import Canvas
from nmes.view.screen import lay_out
from nmes.world.scenery import scene_spec

if TYPE_CHECKING:
    import rerun as rr

__all__ = ["SHIFT", "TURN", "show_live"]

SHIFT, TURN = 1e-3, 1e-2  # m, rad: thresholds of the subscription
_ASK_AGAIN = 1.0  # s between two questions for the joints
_GONE = frozenset({"cube_not_found", "joint_not_found", "world_faulted", "world_closed"})
_LACKING = frozenset({"unsupported", "unknown_type"})  # a server may leave out the commands about joints
_GOLDEN = 0.618034  # of the circle of colours, from one cube to the next


def show_live(client: Client, stream: rr.RecordingStream, fps: float) -> None:
    """Draws the world of a client until the world is closed.

    The world sends only what moved, and is asked for nothing else but the shapes of cubes that are new and, once a
    second, its joints.

    Args:
        client: A client of any server that offers `subscribe`.
        stream: The Rerun stream to draw to.
        fps: How often the world sends states, in Hz of its time.

    Raises:
        CommandFailed: The server does not offer what is needed.
        Disconnected: The connection was lost.
    """
    with understood():
        _show(client, stream, fps)


def _show(client: Client, stream: rr.RecordingStream, fps: float) -> None:
    info = client.get_world_info()
    canvas = Canvas(stream, info["world"], info["dims"] == 2)
    canvas.at(info["t"])
    _draw_scenery(canvas, info)
    lay_out(stream, {info["world"]: canvas}, live=True)
    every = max(1, round(client.welcome["tick_rate"] / fps))
    client.subscribe(events=["state"], every=every, position_threshold=SHIFT, rotation_threshold=TURN)
    _follow(client, canvas, info["t"], lambda: lay_out(stream, {info["world"]: canvas}, live=True))
    canvas.say("the world was closed")


def _follow(client: Client, canvas: Canvas, last: float, look: Callable[[], None]) -> None:
    """Draws the events of a client; calls `look` when there is something to see for the first time."""
    states: dict[str, list[float]] = {}
    shapes: dict[str, Shape] = {}
    hinges: list[_Hinge] = []
    last_question, before = -inf, 0.0
    for event in client.events():
        if event["type"] == "world_fault":
            canvas.say(f"fault: {event['message']}", "ERROR")
        if event["type"] != "state":
            continue
        if event["t"] < last:
            before += last
            canvas.at(before)
            canvas.say("the world was reset")
            for info in filter(None, _ask(client, [{"type": "get_world_info"}])):
                _draw_scenery(canvas, info)
            shapes.clear()  # those of the same name may be others
        last = event["t"]
        canvas.at(before + last)
        for name in event["removed"]:
            states.pop(name, None)
            shapes.pop(name, None)
        for cube in event["cubes"]:
            states[cube["cube_name"]] = [*cube["position"], *cube["quaternion"]]
        strangers = [name for name in states if name not in shapes]
        shapes |= _ask_shapes(client, strangers, len(shapes))
        names = [name for name in states if name in shapes]
        poses = np.array([states[name] for name in names]).reshape(-1, 7)
        first, moved = canvas.extent is None, canvas.cubes({name: shapes[name] for name in names}, poses)
        if first and canvas.extent is not None:
            look()
        if strangers or time.monotonic() - last_question > _ASK_AGAIN:
            last_question = time.monotonic()
            hinges = _ask_joints(client)
        if moved:
            canvas.joints([hinge.now(states) for hinge in hinges if hinge.info["cube1"] in states])


def _draw_scenery(canvas: Canvas, info: Any) -> None:
    """Draws the scenery, as far as the server's config can be read."""
    try:
        canvas.scenery(scene_spec(protocol.complete_config(info["config"]), info["seed"]))
    except NmesError as error:
        canvas.say(f"the scenery cannot be drawn: {error.message}", "WARN")


def _ask(client: Client, commands: Sequence[dict[str, Any]]) -> list[Any]:
    """Asks in one exchange; returns the replies, None for each cube, joint or world that is not there any more.

    What the server has still to say then comes as an event.
    """
    if not commands:
        return []
    try:
        with suppress(CommandFailed), client.pipeline() as together:  # each of them is looked at below
            for command in commands:
                together.request(command)
    except Disconnected as error:
        if error.code not in _GONE:
            raise
        return [None] * len(commands)
    replies = []
    for call in together.calls:
        try:
            replies.append(call.result())
        except CommandFailed as error:
            if error.code not in _GONE | _LACKING:
                raise
            replies.append(None)
    return replies


def _ask_shapes(client: Client, names: Sequence[str], count: int) -> dict[str, Shape]:
    """Asks for the shapes of cubes; a colour that the server leaves out is made up."""
    shapes: dict[str, Shape] = {}
    infos = _ask(client, [{"type": "get_cube_info", "cube_name": name} for name in names])
    for i, (name, info) in enumerate(zip(names, infos, strict=True), start=count):
        if info is not None:
            x, y, z = info["size"]
            red, green, blue, alpha = info.get("color") or (*hls_to_rgb(i * _GOLDEN % 1.0, 0.6, 0.5), 1.0)
            shapes[name] = (x, y, z), (red, green, blue, alpha), info.get("shape", "box")
    return shapes


class _Hinge(NamedTuple):
    """A joint's `joint_info`, with the pose that its first cube had then."""

    info: dict[str, Any]
    pose: list[float]

    def now(self, states: Mapping[str, Sequence[float]]) -> dict[str, Any]:
        """Returns the `joint_info` as it is now, anchor and axis carried along by the first cube."""
        x, y, z, *turn = states[self.info["cube1"]]
        back = conjugate((self.pose[3], self.pose[4], self.pose[5], self.pose[6]))
        turned = multiply((turn[0], turn[1], turn[2], turn[3]), back)
        arm = [now - then for now, then in zip(self.info["anchor"], self.pose, strict=False)]
        ax, ay, az = rotate(turned, (arm[0], arm[1], arm[2]))
        return {**self.info, "anchor": (x + ax, y + ay, z + az), "axis": rotate(turned, tuple(self.info["axis"]))}


def _ask_joints(client: Client) -> list[_Hinge]:
    """Asks for all joints, each together with its first cube, so that both are of one moment."""
    hinges = []
    (listed,) = _ask(client, [{"type": "get_joint_list"}])
    joints = [] if listed is None else listed["joints"]
    moments = [
        [
            {"type": "get_cube_info", "cube_name": joint["cube1"]},
            {"type": "get_joint_info", "joint_name": joint["joint_name"]},
        ]
        for joint in joints
    ]
    for pair in filter(None, _ask(client, [{"type": "batch", "commands": commands} for commands in moments])):
        cube, joint = pair["results"]
        if cube["type"] == "cube_info" and joint["type"] == "joint_info":
            hinges.append(_Hinge(joint, [*cube["position"], *cube["quaternion"]]))
    return hinges
