"""A model of a world, as far as the protocol alone decides its answers: names, joints, ownership, frozen, frame.

Commands with their replies go in, `Finding`s come out. A `Script` is a list of commands, each with the client that
sends it; its names are symbols (`{c0}` a cube that the script names, `{u0}` one that the server named, `{j0}` a joint),
so that it can be played again in any world. Invariant: what the protocol leaves open (the cubes of others, whether a
name can be used again, all motion) makes no finding.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import jsonschema_rs

from nmes.conformance.case import Finding
from nmes.conformance.trial import Trial
from nmes.conformance.wire import Message, Wire, clip
from nmes.errors import DocumentError, RejectedMessage
from nmes.protocol import COMMANDS, parse_json, request_from
from nmes.schemas import Schema

__all__ = ["Player", "Script", "load_script", "play_script", "write_script"]

Script = list[dict[str, Any]]
CLIENTS = 2
FORMAT = "nmes.conform.case"
_SYMBOL = re.compile(r"\{([cuj])(\d+)\}")
_CASE: Schema = {
    "type": "object",
    "required": [FORMAT, "script"],
    "properties": {
        FORMAT: {"const": 1},
        "script": {
            "type": "array",
            "items": {
                "type": "object",
                "required": ["client", "command"],
                "properties": {
                    "client": {"type": "integer", "minimum": 0, "maximum": CLIENTS - 1},
                    "command": {"type": "object", "required": ["type"], "properties": {"type": {"type": "string"}}},
                },
            },
        },
    },
}


@dataclass(slots=True)
class _Cube:
    frozen: bool
    joints: list[str] = field(default_factory=list)


class Player:
    """Sends the commands of a script one by one, and judges the replies by the model."""

    def __init__(self, trial: Trial, wires: Sequence[Wire]) -> None:
        self._trial = trial
        self._wires = wires
        self._named: dict[str, str] = {}  # by symbol
        self._cubes: dict[str, _Cube] = {}
        self._used: set[str] = set()
        self._joints: dict[str, tuple[str, str]] = {}
        self._owned: dict[int, str | None] = dict.fromkeys(range(CLIENTS))
        self._frame: int | None = None
        self._judges: dict[str, Callable[[int, dict[str, Any], Message], None]] = {
            "spawn_cube": self._judge_spawn,
            "despawn_cube": self._judge_despawn,
            "create_joint": self._judge_joint,
            "remove_joint": self._judge_cut,
            "apply_physics": self._judge_own_cube,
            "set_cube_state": self._judge_own_cube,
            "freeze_cube": self._judge_freeze,
            "get_cube_info": self._judge_info,
            "get_cube_state": self._judge_own_cube,
            "get_cube_list": self._judge_list,
            "get_joint_list": self._judge_joint_list,
            "get_world_state": self._judge_world_state,
            "step": self._judge_step,
        }

    def say(self, client: int, command: Mapping[str, Any]) -> None:
        """Sends one command and judges its reply.

        Raises:
            Finding: The answer is not one that the world must give.
        """
        resolved = self._resolve(dict(command))
        reply = self._wires[client].ask(resolved)
        error = request_from({**resolved, "id": 0}).error
        if error is not None:
            # Where two things are wrong, the error may tell of either.
            self._error(reply, error.code, "cube_not_found", "joint_not_found", "nothing_owned")
        elif resolved["type"] in self._judges:
            self._judges[resolved["type"]](client, resolved, reply)
        else:
            self._ok(resolved, reply)

    # -- names -----------------------------------------------------------------------------------------------------

    def _resolve(self, value: Any) -> Any:
        """Replaces symbols by the names that they have in this play."""
        if isinstance(value, dict):
            return {key: self._resolve(item) for key, item in value.items()}
        if isinstance(value, list):
            return [self._resolve(item) for item in value]
        if isinstance(value, str):
            return _SYMBOL.sub(self._name, value)
        return value

    def _name(self, match: re.Match[str]) -> str:
        symbol = match[0]
        if symbol not in self._named:  # a cube that the script names, or something that is not there yet
            self._named[symbol] = self._trial.name(match[1] + match[2])
        return self._named[symbol]

    def _remember(self, kind: str, name: str) -> None:
        """Gives a name that the server chose the next symbol of its kind."""
        number = 0
        while f"{{{kind}{number}}}" in self._named:
            number += 1
        self._named[f"{{{kind}{number}}}"] = name

    # -- judging ---------------------------------------------------------------------------------------------------

    def _error(self, reply: Message, *codes: str) -> None:
        if reply["type"] != "error" or reply["code"] not in codes:
            raise Finding(f"error {' or '.join(codes)}", clip(reply))

    def _ok(self, command: Mapping[str, Any], reply: Message) -> None:
        expected = COMMANDS[command["type"]].reply
        if reply["type"] != expected:
            raise Finding(f"{expected} in reply to {clip(command)}", clip(reply))

    def _judge_spawn(self, client: int, command: dict[str, Any], reply: Message) -> None:
        stem = command.get("cube_name")
        name = None if stem is None else stem + ("_BASE" if command.get("is_base") else "")
        shape = command.get("shape", "box")
        wrong = [] if shape == "box" or self._trial.probe.claims(f"shape.{shape}") else ["unsupported"]
        wrong += [] if _fits(shape, command.get("size", 1.0)) else ["invalid"]
        # Where two things are wrong, the error may tell of either; and a server need not accept a name again.
        if name in self._cubes or (name in self._used and reply["type"] == "error"):
            return self._error(reply, "cube_exists", *wrong)
        if wrong:
            return self._error(reply, *wrong)
        self._ok(command, reply)
        spawned = str(reply["spawned"])
        self._trial.adopt(spawned)
        if name is None:
            self._trial.true(spawned not in self._used, "a name that was never used", spawned)
            self._remember("u", spawned)
        else:
            self._trial.equal(spawned, name, "spawned")
        self._cubes[spawned] = _Cube(bool(command.get("is_base")))
        self._used.add(spawned)
        self._owned[client] = spawned
        if "cubes" in reply:
            self._order(reply["cubes"])

    def _judge_despawn(self, client: int, command: dict[str, Any], reply: Message) -> None:
        name = command["cube_name"]
        if name not in self._cubes:
            return self._error(reply, "cube_not_found")
        self._ok(command, reply)
        joints = self._cubes[name].joints
        self._trial.equal(sorted(reply["joints"]), sorted(joints), "the joints that went with the cube")
        for joint in list(joints):
            self._forget(joint)
        del self._cubes[name]

    def _forget(self, joint: str) -> None:
        for cube in self._joints.pop(joint):
            self._cubes[cube].joints.remove(joint)

    def _judge_joint(self, client: int, command: dict[str, Any], reply: Message) -> None:
        one, two = command["cube1"], command["cube2"]
        codes = [] if {one, two} <= self._cubes.keys() else ["cube_not_found"]
        codes += ["self_joint"] if one == two else []
        several = self._trial.probe.claims("joint.several")
        if not codes and not several and any({one, two} == set(pair) for pair in self._joints.values()):
            codes.append("joint_exists")
        if codes:
            return self._error(reply, *codes)
        self._ok(command, reply)
        joint = str(reply["joint_name"])
        self._trial.true(joint not in self._used, "a name that was never used", joint)
        self._used.add(joint)
        self._remember("j", joint)
        self._joints[joint] = (one, two)
        for cube in (one, two):
            self._cubes[cube].joints.append(joint)

    def _judge_cut(self, client: int, command: dict[str, Any], reply: Message) -> None:
        if command["joint_name"] not in self._joints:
            return self._error(reply, "joint_not_found")
        self._ok(command, reply)
        self._forget(command["joint_name"])

    def _own(self, client: int, command: dict[str, Any], reply: Message) -> str | None:
        """Judges a reply about the command's cube, or the client's own; returns its name, None after a right error."""
        name: str | None = command.get("cube_name", self._owned[client])
        if name in self._cubes:
            self._ok(command, reply)
            self._trial.equal(reply["cube_name"], name, "cube_name")
            return name
        self._error(reply, "cube_not_found" if "cube_name" in command else "nothing_owned")
        return None

    def _judge_own_cube(self, client: int, command: dict[str, Any], reply: Message) -> None:
        self._own(client, command, reply)

    def _judge_freeze(self, client: int, command: dict[str, Any], reply: Message) -> None:
        name = self._own(client, command, reply)
        if name is not None:
            self._trial.equal(reply["freeze"], command["freeze"], "freeze")
            self._cubes[name].frozen = command["freeze"]

    def _judge_info(self, client: int, command: dict[str, Any], reply: Message) -> None:
        name = self._own(client, command, reply)
        if name is not None:
            self._trial.equal(reply["frozen"], self._cubes[name].frozen, "frozen")
            self._trial.equal(sorted(reply["joints"]), sorted(self._cubes[name].joints), "joints")

    def _judge_list(self, client: int, command: dict[str, Any], reply: Message) -> None:
        self._ok(command, reply)
        self._order(reply["cubes"])

    def _order(self, cubes: list[str]) -> None:
        mine = [name for name in cubes if name in self._used]
        self._trial.equal(mine, list(self._cubes), "the script's cubes in the list")

    def _judge_joint_list(self, client: int, command: dict[str, Any], reply: Message) -> None:
        self._ok(command, reply)
        mine = {
            joint["joint_name"]: (joint["cube1"], joint["cube2"])
            for joint in reply["joints"]
            if joint["joint_name"] in self._used
        }
        self._trial.equal(mine, self._joints, "the script's joints in the list")

    def _judge_world_state(self, client: int, command: dict[str, Any], reply: Message) -> None:
        names = command.get("cubes")
        if names is not None and not set(names) <= self._cubes.keys():
            return self._error(reply, "cube_not_found")
        self._ok(command, reply)
        cubes = [cube["cube_name"] for cube in reply["cubes"]]
        if names is None:
            self._order(cubes)
        else:
            self._trial.equal(cubes, names, "the cubes that were asked for")

    def _judge_step(self, client: int, command: dict[str, Any], reply: Message) -> None:
        self._ok(command, reply)
        if self._frame is not None:
            self._trial.equal(reply["frame"], self._frame + command.get("ticks", 1), "frame")
        self._frame = reply["frame"]


def play_script(trial: Trial, script: Script) -> None:
    """Plays a whole script.

    Raises:
        Finding: An answer is not one that the world must give; `expected` says to which command.
    """
    player = Player(trial, [trial.join() for _ in range(CLIENTS)])
    for number, step in enumerate(script, 1):
        try:
            player.say(step["client"], step["command"])
        except Finding as finding:
            where = f"command {number} of {len(script)} ({step['command']['type']}, client {step['client']})"
            raise Finding(f"{finding.expected}, in answer to {where}", finding.received, finding.cause) from finding


def write_script(script: Script, **about: Any) -> str:
    """Returns a script as the text of a CASE file, one command a line."""
    head = "".join(f" {json.dumps(key)}: {json.dumps(value)},\n" for key, value in {FORMAT: 1, **about}.items())
    lines = ",\n".join(f"  {json.dumps(step)}" for step in script)
    return f'{{\n{head} "script": [\n{lines}\n ]\n}}\n'


def load_script(text: bytes) -> Script:
    """Reads a CASE file.

    Raises:
        DocumentError: It is no such file.
    """
    try:
        case = parse_json(text)
        jsonschema_rs.validate(_CASE, case)
    except (RejectedMessage, jsonschema_rs.ValidationError) as error:
        raise DocumentError([("", f"no case of nmes conform: {str(error).splitlines()[0]}")]) from error
    return list(case["script"])


def _fits(shape: str, size: Any) -> bool:
    """Whether a shape can fill a box of this size."""
    edges = sorted(size) if isinstance(size, list) else [size] * 3
    if shape == "sphere":
        return bool(edges[0] == edges[2])
    if shape == "capsule":
        return bool(edges[0] == edges[1] < edges[2])
    return shape == "box" or edges[1] in (edges[0], edges[2])
