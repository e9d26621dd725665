"""What counts as the same creature, and which tasks ship: a name makes nothing new, and nothing ours.

A creature is what it does: its body as it has grown, how that develops, its sensors, voices and brain. Names, authors,
words, parents and colours are not, nor are the ids of parts, where the whole stands, what is left out because it is the
default or the task's, how an ONNX model is written down, and differences below a billionth. What is changed by more, or
put into another order, is another creature. The conditions of its development are compared word by word, with the
places of what they name.
"""

from __future__ import annotations

import hashlib
import json
import re
from base64 import b64decode
from collections.abc import Mapping, Sequence
from dataclasses import astuple
from functools import cache
from typing import Any, Final

import numpy as np
import orjson

from nmes.brain.base import Brain, Findings
from nmes.brain.model_graph import computation
from nmes.evaluation.match_task import MatchTask
from nmes.evaluation.setting import MATCHES, SHIPPED, Setting
from nmes.evaluation.task import Task
from nmes.genome import Genome
from nmes.genome.body import Body, BodyJoint
from nmes.genome.development import Rule
from nmes.genome.sensors import Flaws
from nmes.schemas.documents import parse_document

__all__ = ["borrows_name", "creature_hash", "shipped_hash", "shipped_task", "task_title"]

_DIGITS: Final = 9  # behind the point: what differs by less is the same
_AXES: Final = {"hinge": (0.0, 0.0, 1.0), "slide": (1.0, 0.0, 0.0)}  # of joints that name none
_MOTORS, _SENSORS = ("motor", "motors", "outputs"), ("sensor", "inputs")
_WORD: Final = re.compile(
    r"""(?P<string>"[^"]*"|'[^']*')|(?P<number>(?:[0-9]+(?:\.[0-9]+)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)"""
    r"""|(?P<other>[A-Za-z_][A-Za-z0-9_]*|[<>=!]=|&&|\|\||[^ \t\r\n])"""
)  # of a condition that was read


def creature_hash(genome: Genome, task: Setting | None = None) -> str:
    """Returns a SHA-256 over all of a creature that acts: its body and its development, its sensors, voices and brain.

    It has 64 hexadecimal digits.

    Args:
        genome: The creature.
        task: On which it acts: a cube that writes out what all of its worlds have is like one that does not. None: in
            worlds that do not bounce.

    Raises:
        DocumentError: Its brain is not a good one for its body.
        MissingPackage: Its brain needs a package that is not installed.
    """
    brain = _brain(genome.brain()) if "brain" in genome.document else None
    surface = {"restitution": 0.0} if task is None else task.surface
    return hashlib.sha256(orjson.dumps(_rounded([*_body(genome.body, surface), brain]))).hexdigest()


def _body(body: Body, surface: Mapping[str, float]) -> list[Any]:
    """Returns cubes, joints and sensors with places in the body for ids, and the root in the origin."""
    cubes = {cube.id: index for index, cube in enumerate(body.cubes)}
    joints = {joint.id: index for index, joint in enumerate(body.joints)}
    origin = np.array(body.cubes[0].position)
    shapes, bonds = [], []
    for cube in body.cubes:
        place = np.array(cube.position) - origin, _half(cube.quaternion)
        shape = [] if cube.shape == "box" else [cube.shape]
        # A group is one of the world's, which says by its name through what its cubes pass.
        group = [] if cube.group is None else [{"group": cube.group}]
        own = [_own(getattr(cube, name), surface.get(name)) for name in ("friction", "restitution")]
        shapes.append((cube.size, cube.mass, *place, *own, *shape, *group))
    for joint in body.joints:
        motor = joint.motor
        drive = None if motor is None else (motor.mode, motor.low, motor.high, motor.max_effort, *_flaws(motor.flaws))
        ends = cubes[joint.cube1], cubes[joint.cube2], np.array(joint.anchor) - origin
        bonds.append((joint.kind, *ends, _axis(joint), joint.limits, joint.stiffness, joint.damping, drive))
    senses = [
        (
            *(sensor.type, sensor.axis, (cubes if sensor.of == "cube" else joints)[sensor.target]),
            *([] if sensor.range is None else [sensor.range]),
            *([] if sensor.channel is None else [sensor.channel, sensor.number]),
            *([] if sensor.face is None else [sensor.face]),
            *([] if sensor.direction is None else [np.array(sensor.direction)]),
            *([] if sensor.camera is None else [*astuple(sensor.camera), sensor.number]),
            *_flaws(sensor.flaws),
        )
        for sensor in body.sensors
    ]
    voices = [(voice.channel, voice.number) for voice in body.voices]
    # What few have is there only where they have it: so the hashes of all others are those of before there was such.
    changes: dict[str, Any] = {"later": sorted(cubes[name] for name in body.later)} if body.later else {}
    if body.development:
        names = {"sense": {sensor.id: index for index, sensor in enumerate(body.sensors)}, "has": cubes}
        changes["development"] = [_rule(rule, names) for rule in body.development]
    return [shapes, bonds, senses, *([voices] if voices else []), *([changes] if changes else [])]


def _rule(rule: Rule, names: Mapping[str, Mapping[str, int]]) -> list[Any]:
    """Returns a rule of development with places for ids; `names` has those of what a condition may ask of each kind."""
    cubes = names["has"]
    parts = [[cubes[name] for name in each] for each in (rule.shed, rule.adopt, rule.grow)]
    sizes = [(cubes[each.part], each.scale) for each in rule.resize]
    return [_condition(rule.when, names), rule.stage, *parts, sizes, rule.enter, rule.every, rule.times]


def _condition(text: str, names: Mapping[str, Mapping[str, int]]) -> list[Any]:
    """Returns the words of a condition that was read: a number for every number, and a place for every id."""
    words: list[Any] = []
    for word in _WORD.finditer(text):
        if word["number"]:
            words.append(float(word["number"]))
        elif word["string"]:
            kind = words[-2]  # before the bracket
            words.append(names[kind][word["string"][1:-1]])
        else:
            words.append(word["other"])
    return words


def _flaws(flaws: Flaws | None) -> tuple[float, ...]:
    return () if flaws is None else astuple(flaws)


def _half(quaternion: Sequence[float]) -> np.ndarray[Any, Any]:
    """Returns the one of the two quaternions of a rotation whose last number that is not zero is positive."""
    rounded = [number for number in _rounded(quaternion) if number]
    return np.array(quaternion) * (-1.0 if rounded[-1] < 0.0 else 1.0)


def _own(value: float | None, default: float | None) -> float | None:
    """Returns a number that a cube writes out; None where that is the default."""
    return None if _rounded(value) == _rounded(default) else value


def _axis(joint: BodyJoint) -> Any:
    """Returns an axis of length 1; None for joints that need none, or take theirs from where their cubes are."""
    axis = _AXES.get(joint.kind) if joint.axis is None else joint.axis
    return None if axis is None or joint.kind in ("fixed", "pin") else np.array(axis) / np.sqrt(np.square(axis).sum())


def _brain(brain: Brain) -> list[Any]:
    """Returns a brain whose names are the places of the motors, sensors and nodes that they stand for."""
    sensors, motors, document = json.loads(brain.form())
    if brain.kind == "onnx":
        document["model"] = computation(b64decode(brain.document["model"]), len(document.get("inputs", sensors)))
    nodes = [node["id"] for node in document.get("nodes", ())]
    placed = _places(document, sensors, motors, nodes)
    sides = {"inputs": sensors, "outputs": motors}
    every = {side: [[place] for place in range(len(names))] for side, names in sides.items()}
    lists = {side: placed.get(side, every[side]) for side in sides}
    if lists == every:  # as where neither is listed, and most brains list none
        lists = {side: [[*range(len(names))]] for side, names in sides.items()}
    return [dict(sorted({**placed, **lists}.items())), [] if brain.kind == "onnx" else brain.to_vector()]


def _places(value: Any, sensors: list[str], motors: list[str], nodes: list[str], names: list[str] | None = None) -> Any:
    """Replaces names and wildcards by the list of places that they stand for; `names` are those that a text is of."""
    if isinstance(value, dict):
        ends = nodes or motors  # what the links of a brain link
        kinds = dict.fromkeys(_SENSORS, sensors) | dict.fromkeys(_MOTORS, motors)
        kinds |= {"from": ends, "to": ends, "id": nodes}
        return {key: _places(item, sensors, motors, nodes, kinds.get(key)) for key, item in sorted(value.items())}
    if isinstance(value, list):
        return [_places(item, sensors, motors, nodes, names) for item in value]
    if isinstance(value, str) and names is not None:
        return Findings("").match(value, names, "", "")
    return value


def _rounded(value: Any) -> Any:
    """Returns plain data with every number rounded; whole ones look alike, whichever type they have."""
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _rounded(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_rounded(item) for item in value]
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return round(float(value), _DIGITS) + 0.0  # which makes -0.0 to 0.0
    return value


@cache
def shipped_task(name: str) -> Task | MatchTask:
    """Returns the shipped task of a name, with roles or without; there must be one."""
    # Not Task.load, to which a file of that name comes first.
    place = MATCHES if name in MATCHES.names() else SHIPPED
    document = parse_document(place.shipped(name))
    return MatchTask(document) if place is MATCHES else Task(document)


def shipped_hash(task: str) -> str | None:
    """Returns the hash of the task of that name that ships with the package, with roles or without; None: none does."""
    return shipped_task(task).hash if task in (*Task.names(), *MATCHES.names()) else None


def borrows_name(task: str, task_hash: str) -> bool:
    """Tells whether a task has the name of one that ships, but is another."""
    return shipped_hash(task) not in (None, task_hash)


def task_title(task: str, task_hash: str) -> str:
    """Returns a task's name and, where it is that of a task that ships and this is another, that it is."""
    return f"{task} (not the one that ships)" if borrows_name(task, task_hash) else task
