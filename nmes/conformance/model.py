"""What a world must answer, as far as the protocol alone decides it: names, joints, ownership, frozen, frame.

It hides no connection: commands with their replies go in, `Finding`s come out. A `Script` is what was said, and by
which client, with names that stand for those of one play (`{c0}` a cube named by the script, `{u0}` one that the server
named, `{j0}` a joint), so that it can be played again in any world. Invariant: what the protocol leaves open (another's
cubes, whether a name can be had again, all motion) makes no finding.
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
from nmes.errors import NmesError, RejectedMessage
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
    """Says a script's commands one by one, and judges the answers by the model."""

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
            "spawn_cube": self._spawned,
            "despawn_cube": self._despawned,
            "create_joint": self._joined,
            "remove_joint": self._cut,
            "apply_physics": self._applied,
            "set_cube_state": self._about_cube,
            "freeze_cube": self._froze,
            "get_cube_info": self._told,
            "get_cube_state": self._about_own_cube,
            "get_cube_list": self._listed,
            "get_joint_list": self._joints_listed,
            "get_world_state": self._state_told,
            "step": self._stepped,
        }

    def say(self, client: int, command: Mapping[str, Any]) -> None:
        """Says one command.

        Raises:
            Finding: The answer is not one that the world must give.
        """
        said = self._resolve(dict(command))
        reply = self._wires[client].ask(said)
        error = request_from({**said, "id": 0}).error
        if error is not None:
            # Where two things are wrong, either may be told.
            self._error(reply, error.code, "cube_not_found", "joint_not_found", "nothing_owned")
        elif said["type"] in self._judges:
            self._judges[said["type"]](client, said, reply)
        else:
            self._ok(said, reply)

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
        """Gives a name of the server's the next symbol of its kind."""
        number = 0
        while f"{{{kind}{number}}}" in self._named:
            number += 1
        self._named[f"{{{kind}{number}}}"] = name

    # -- judging ---------------------------------------------------------------------------------------------------

    def _error(self, reply: Message, *codes: str) -> None:
        if reply["type"] != "error" or reply["code"] not in codes:
            raise Finding(f"error {' or '.join(codes)}", clip(reply))

    def _ok(self, said: Mapping[str, Any], reply: Message) -> None:
        wanted = COMMANDS[said["type"]].reply
        if reply["type"] != wanted:
            raise Finding(f"{wanted} in reply to {clip(said)}", clip(reply))

    def _spawned(self, client: int, said: dict[str, Any], reply: Message) -> None:
        given = said.get("cube_name")
        name = None if given is None else given + ("_BASE" if said.get("is_base") else "")
        if name in self._cubes:
            return self._error(reply, "cube_exists")
        if name in self._used and reply["type"] == "error":  # a server need not let a name be had again
            return self._error(reply, "cube_exists")
        self._ok(said, reply)
        spawned = str(reply["spawned"])
        self._trial.adopt(spawned)
        if name is None:
            self._trial.true(spawned not in self._used, "a name that was never used", spawned)
            self._remember("u", spawned)
        else:
            self._trial.equal(spawned, name, "spawned")
        self._cubes[spawned] = _Cube(bool(said.get("is_base")))
        self._used.add(spawned)
        self._owned[client] = spawned
        if "cubes" in reply:
            self._order(reply["cubes"])

    def _despawned(self, client: int, said: dict[str, Any], reply: Message) -> None:
        name = said["cube_name"]
        if name not in self._cubes:
            return self._error(reply, "cube_not_found")
        self._ok(said, reply)
        joints = self._cubes[name].joints
        self._trial.equal(sorted(reply["joints"]), sorted(joints), "the joints that went with the cube")
        for joint in list(joints):
            self._forget(joint)
        del self._cubes[name]

    def _forget(self, joint: str) -> None:
        for cube in self._joints.pop(joint):
            self._cubes[cube].joints.remove(joint)

    def _joined(self, client: int, said: dict[str, Any], reply: Message) -> None:
        one, two = said["cube1"], said["cube2"]
        codes = [] if {one, two} <= self._cubes.keys() else ["cube_not_found"]
        codes += ["self_joint"] if one == two else []
        if not codes and any({one, two} == set(pair) for pair in self._joints.values()):
            codes.append("joint_exists")
        if codes:
            return self._error(reply, *codes)
        self._ok(said, reply)
        joint = str(reply["joint_name"])
        self._trial.true(joint not in self._used, "a name that was never used", joint)
        self._used.add(joint)
        self._remember("j", joint)
        self._joints[joint] = (one, two)
        for cube in (one, two):
            self._cubes[cube].joints.append(joint)

    def _cut(self, client: int, said: dict[str, Any], reply: Message) -> None:
        if said["joint_name"] not in self._joints:
            return self._error(reply, "joint_not_found")
        self._ok(said, reply)
        self._forget(said["joint_name"])

    def _own(self, client: int, said: dict[str, Any], reply: Message) -> str | None:
        """Returns the cube that a command means, or None where there is none and the error was right."""
        name: str | None = said.get("cube_name", self._owned[client])
        if name in self._cubes:
            self._ok(said, reply)
            self._trial.equal(reply["cube_name"], name, "cube_name")
            return name
        self._error(reply, "cube_not_found" if "cube_name" in said else "nothing_owned")
        return None

    def _applied(self, client: int, said: dict[str, Any], reply: Message) -> None:
        self._own(client, said, reply)

    def _about_own_cube(self, client: int, said: dict[str, Any], reply: Message) -> None:
        self._own(client, said, reply)

    def _about_cube(self, client: int, said: dict[str, Any], reply: Message) -> None:
        self._own(client, said, reply)

    def _froze(self, client: int, said: dict[str, Any], reply: Message) -> None:
        name = self._own(client, said, reply)
        if name is not None:
            self._trial.equal(reply["freeze"], said["freeze"], "freeze")
            self._cubes[name].frozen = said["freeze"]

    def _told(self, client: int, said: dict[str, Any], reply: Message) -> None:
        name = self._own(client, said, reply)
        if name is not None:
            self._trial.equal(reply["frozen"], self._cubes[name].frozen, "frozen")
            self._trial.equal(sorted(reply["joints"]), sorted(self._cubes[name].joints), "joints")

    def _listed(self, client: int, said: dict[str, Any], reply: Message) -> None:
        self._ok(said, reply)
        self._order(reply["cubes"])

    def _order(self, cubes: list[str]) -> None:
        mine = [name for name in cubes if name in self._used]
        self._trial.equal(mine, list(self._cubes), "the script's cubes in the list")

    def _joints_listed(self, client: int, said: dict[str, Any], reply: Message) -> None:
        self._ok(said, reply)
        mine = {
            joint["joint_name"]: (joint["cube1"], joint["cube2"])
            for joint in reply["joints"]
            if joint["joint_name"] in self._used
        }
        self._trial.equal(mine, self._joints, "the script's joints in the list")

    def _state_told(self, client: int, said: dict[str, Any], reply: Message) -> None:
        names = said.get("cubes")
        if names is not None and not set(names) <= self._cubes.keys():
            return self._error(reply, "cube_not_found")
        self._ok(said, reply)
        told = [cube["cube_name"] for cube in reply["cubes"]]
        if names is None:
            self._order(told)
        else:
            self._trial.equal(told, names, "the cubes that were asked for")

    def _stepped(self, client: int, said: dict[str, Any], reply: Message) -> None:
        self._ok(said, reply)
        if self._frame is not None:
            self._trial.equal(reply["frame"], self._frame + said.get("ticks", 1), "frame")
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
            raise Finding(f"{finding.expected}, in answer to {where}", finding.received) from finding


def write_script(script: Script, **about: Any) -> str:
    """Returns a script as the text of a CASE file, one command a line."""
    head = "".join(f" {json.dumps(key)}: {json.dumps(value)},\n" for key, value in {FORMAT: 1, **about}.items())
    lines = ",\n".join(f"  {json.dumps(step)}" for step in script)
    return f'{{\n{head} "script": [\n{lines}\n ]\n}}\n'


def load_script(text: bytes) -> Script:
    """Reads a CASE file.

    Raises:
        NmesError: It is none.
    """
    try:
        case = parse_json(text)
        jsonschema_rs.validate(_CASE, case)
    except (RejectedMessage, jsonschema_rs.ValidationError) as error:
        raise NmesError("invalid", f"no case of nmes conform: {str(error).splitlines()[0]}") from error
    return list(case["script"])
