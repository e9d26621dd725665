"""The words of the original server, which the raw dialect speaks: its commands into ours.

Hides what the original's words meant there. A client that logs in with the bare password gets that meaning; the world,
its recording and its replay know only our commands. What is not in this table is understood as it stands, and a field
that is not known passes through, so that it is told of like every other.

Invariants: a translation depends on the command alone, never on a world; nothing that a client wrote is left out.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from math import pi
from typing import Any, Final

import numpy as np

from nmes.protocol.messages import Request, decode, encode

__all__ = ["answer", "command"]

Message = dict[str, Any]


def command(said: Message) -> Message:
    """Returns a command of ours that does what a command did at the original; the same object where it is ours."""
    kind = said.get("type")
    translate = _COMMANDS.get(kind) if type(kind) is str else None
    return said if translate is None else translate(said)


def _renamed(message: Message, old: str, new: str) -> Message:
    """Returns a message with a field renamed in its place; as it is where the new name is there already."""
    if old not in message or new in message:
        return message
    return {new if name == old else name: value for name, value in message.items()}


def _apply_force(said: Message) -> Message:
    """Translates what was an impulse there: the velocity changes at once by force / mass."""
    return _renamed({**said, "type": "apply_physics"}, "force", "impulse")


def _apply_physics(said: Message) -> Message:
    return _renamed(said, "central_impulse", "impulse")


# -- joints -----------------------------------------------------------------------------------------------------------


def _create_joint(said: Message) -> Message:
    """Translates a new joint: it has the original's defaults, and a name after its cubes where it is given none."""
    ours = _with_params(said, "joint_params", _DEFAULTS.get(_text(said.get("joint_type")), {}))
    name = f"joint_{said.get('joint_type')}_{said.get('cube1')}_{said.get('cube2')}"
    if "joint_name" not in said and len(name) <= _NAME_LENGTH:
        ours["joint_name"] = name
    return {**ours, "number_if_taken": True}


def _create_bone(said: Message) -> Message:
    return {**_with_params(said, "joint_params", _DEFAULTS["conetwist"]), "number_if_taken": True}


def _link(said: Message) -> Message:
    return _with_params(said, "joint_params", _DEFAULTS.get(_text(said.get("joint_type")), {}))


def _set_joint_param(said: Message) -> Message:
    """Translates one parameter, which may be several of ours, or one without effect."""
    name, value = _text(said.get("param_name")), said.get("value")
    params, notes = _params({name: value})
    if not notes and params == {name: value}:
        return said
    others = {field: content for field, content in said.items() if field not in ("param_name", "value")}
    return {**others, "type": "set_joint_params", "params": params, **({"notes": notes} if notes else {})}


def _set_joint_params(said: Message) -> Message:
    return _with_params(said, "params", {})


def _with_params(said: Message, field: str, defaults: Message) -> Message:
    """Returns a command with its object of parameters translated, over defaults of ours; as it is if that is none."""
    given = said.get(field, {})
    if not isinstance(given, dict):
        return dict(said)
    params, notes = _params(given)
    ours = dict(said)
    if defaults or field in said:
        ours[field] = {**defaults, **params}
    if notes:
        ours["notes"] = {**said["notes"], **notes} if isinstance(said.get("notes"), dict) else notes
    return ours


def _params(given: Message) -> tuple[Message, Message]:
    """Returns the parameters in our words, and those that have no effect here; what is not known stays as it is."""
    params: Message = {}
    notes: Message = {}
    for name, value in given.items():
        ours = _PARAMS.get(name, name)
        if name in _WITHOUT_EFFECT:
            notes[name] = value
        elif name == "motor_max_impulse" and type(value) in (int, float):
            params[ours] = value * _RATE
        elif ours in _SWITCHES and type(value) in (int, float):
            params[ours] = value != 0
        else:
            params[ours] = value
        if name in _ALWAYS_IN_FORCE:
            params["limit_enabled"] = True
    return params, notes


def _text(value: Any) -> str:
    return value if isinstance(value, str) else ""


_NAME_LENGTH: Final = 128
_SOLVER: Final = ("softness", "restitution", "damping")
_MOTOR_FORCE: Final = {"motor_max_force": 60.0}  # of an impulse of 1
_SLIDER: Final = {"limit_lower": -1.0, "limit_upper": 1.0, "limit_enabled": True, **_MOTOR_FORCE}
_PARAMS: Final = {
    "limit_enable": "limit_enabled",
    "motor_enable": "motor_enabled",
    "motor_max_impulse": "motor_max_force",
    "linear_limit_lower": "limit_lower",
    "linear_limit_upper": "limit_upper",
    "swing_span": "limit_lower",
    "twist_span": "limit_upper",
}
"""The original's parameters that have another name here."""
_RATE: Final = 60.0  # engine steps a second there, of which each gave a motor's largest impulse
_SWITCHES: Final = frozenset({"limit_enabled", "motor_enabled"})
_ALWAYS_IN_FORCE: Final = frozenset({"linear_limit_lower", "linear_limit_upper", "swing_span", "twist_span"})
_WITHOUT_EFFECT: Final = frozenset(
    {"bias", "softness", "relaxation", "damping", "restitution", "impulse_clamp"}
    | {"limit_bias", "limit_softness", "limit_relaxation"}
    | {f"linear_{part}_{what}" for part in ("limit", "motion", "ortho") for what in _SOLVER}
    | {f"angular_{part}_{what}" for part in ("limit", "motion", "ortho") for what in _SOLVER}
    | {"angular_limit_lower", "angular_limit_upper"}
)
"""The original's parameters of its engine's solver. Each is kept with the joint as a note, and told back."""
_DEFAULTS: Final[dict[str, Message]] = {
    "hinge": {"limit_lower": -pi / 2.0, "limit_upper": pi / 2.0, **_MOTOR_FORCE},
    "slider": _SLIDER,
    "slide": _SLIDER,
    "conetwist": {"limit_lower": pi / 4.0, "limit_upper": pi, "limit_enabled": True},
}
"""The original's defaults, in our words, where they are not ours."""


# -- other commands ---------------------------------------------------------------------------------------------------


def _set_color(said: Message) -> Message:
    """Translates a colour like `#FFFF00`, with or without the opacity behind it; another text stays as it is."""
    match = _HEX.fullmatch(_text(said.get("hex")))
    if match is None or "color" in said:
        return said
    parts = [int(part, 16) / 255.0 for part in match.groups() if part]
    return {("color" if name == "hex" else name): (parts if name == "hex" else said[name]) for name in said}


def _batch(said: Message) -> Message:
    commands = said.get("commands")
    if not isinstance(commands, list):
        return said
    return {**said, "commands": [command(inner) if isinstance(inner, dict) else inner for inner in commands]}


_HEX: Final = re.compile("#?([0-9A-Fa-f]{2})([0-9A-Fa-f]{2})([0-9A-Fa-f]{2})([0-9A-Fa-f]{2})?")
_COMMANDS: Final[dict[str, Callable[[Message], Message]]] = {
    "apply_force": _apply_force,
    "apply_physics": _apply_physics,
    "batch": _batch,
    "create_bone": _create_bone,
    "create_joint": _create_joint,
    "link_body_cubes": _link,
    "link_cube_chains": _link,
    "set_color": _set_color,
    "set_joint_param": _set_joint_param,
    "set_joint_params": _set_joint_params,
}


# -- answers ----------------------------------------------------------------------------------------------------------


def answer(request: Request, reply: bytes) -> bytes:
    """Returns the original's answer for an encoded reply of ours; the same bytes where it is ours."""
    if request.said is None and request.type not in _TOLD_OTHERWISE:
        return reply
    said = request.said or {"type": request.type}
    if not reply.startswith(_RESULTS):
        return _answer(said, reply)
    commands = said["commands"]
    results = _results(reply, len(commands))
    told = [_answer(each, reply[part]) for each, part in zip(commands, results, strict=True)]
    return b"".join((_RESULTS, b",".join(told), reply[results[-1].stop if results else len(_RESULTS) :]))


def _results(reply: bytes, count: int) -> list[slice]:
    """Returns where in an encoded reply the results of a batch are.

    They may have 8 MiB, most of which is told as it is. To read them as objects would take 0.1 s, in which nothing else
    can run; numpy lets others run.
    """
    text = np.frombuffer(reply, np.uint8)[len(_RESULTS) :]
    signs = (text == ord('"')) | (text == ord("{")) | (text == ord("}"))
    backslashes = np.flatnonzero(text == ord("\\"))
    if len(backslashes):  # of some in a row, each second one is itself meant, and of the others what comes after
        begins = np.diff(backslashes, prepend=-2) != 1
        begun = np.maximum.accumulate(np.where(begins, backslashes, 0))
        signs[backslashes[(backslashes - begun) % 2 == 0] + 1] = False
    places = np.flatnonzero(signs)
    found = text[places]
    quotes = found == ord('"')
    braces = ~quotes & ~np.logical_xor.accumulate(quotes)
    places, opens = places[braces] + len(_RESULTS), found[braces] == ord("{")
    depth = np.cumsum(np.where(opens, 1, -1))
    starts, ends = places[opens & (depth == 1)][:count].tolist(), places[~opens & (depth == 0)][:count].tolist()
    return [slice(start, end + 1) for start, end in zip(starts, ends, strict=True)]


def _answer(said: Message, reply: bytes) -> bytes:
    translate = _ANSWERS.get(reply[len(_TYPE) : reply.find(b'"', len(_TYPE))])
    return reply if translate is None else encode(translate(said, decode(reply)))


def _error(said: Message, reply: Message) -> Message:
    """Tells an error about the client's own command, and the parameter to blame by the client's own name."""
    told = {**reply, "command": said.get("type")}
    head, _, name = reply.get("field", "").rpartition("/")
    if head == "params" and "param_name" in said:
        told["field"] = "value"
    elif isinstance(said.get(head), dict) and name not in said[head]:
        theirs = next((given for given in said[head] if _PARAMS.get(given) == name), name)
        told |= {"field": f"{head}/{theirs}", "message": reply["message"].replace(name, theirs)}
    return told


def _planets(said: Message, reply: Message) -> Message:
    """Translates a list of planets: there each stands alone in a list, under its name."""
    return {planet["Name"]: [planet] for planet in reply["planets"]}


def _param_set(said: Message, reply: Message) -> Message:
    """Translates that parameters were set: there the answer repeats the command."""
    told: Message = {"type": "joint_param_set"}
    told.update((name, reply[name]) for name in ("joint_name", "id") if name in reply)
    told.update((name, said[name]) for name in ("param_name", "value", "params") if name in said)
    return told


def _joint_info(said: Message, reply: Message) -> Message:
    """Translates a reading: the parameters have their names there, and are numbers all."""
    names = _ORIGINAL_PARAMS.get(reply["joint_type"], {})
    params = {name: float(reply["params"][ours]) for name, ours in names.items()}
    if "motor_max_impulse" in params:
        params["motor_max_impulse"] /= _RATE
    about = {name: value for name, value in reply.items() if name != "notes"}
    return {**about, "params": {**params, **reply.get("notes", {})}}


_MOTOR: Final = {
    "motor_enable": "motor_enabled",
    "motor_target_velocity": "motor_target_velocity",
    "motor_max_impulse": "motor_max_force",
}
_ORIGINAL_PARAMS: Final[dict[str, dict[str, str]]] = {
    "hinge": {
        "limit_lower": "limit_lower",
        "limit_upper": "limit_upper",
        "limit_enable": "limit_enabled",
        **_MOTOR,
    },
    "slide": {"linear_limit_lower": "limit_lower", "linear_limit_upper": "limit_upper", **_MOTOR},
    "conetwist": {"swing_span": "limit_lower", "twist_span": "limit_upper"},
}
"""The parameters that the original had of a joint, by our joint types, with our names for them."""
_TOLD_OTHERWISE: Final = frozenset({"get_joint_info", "get_planets"})
"""The commands that are ours as they stand, and whose answers are not."""
_RESULTS: Final = b'{"type":"batch_result","results":['
"""What the reply to a batch begins with."""
_TYPE: Final = b'{"type":"'
"""What every reply of ours begins with."""
_ANSWERS: Final[dict[bytes, Callable[[Message, Message], Message]]] = {
    b"error": _error,
    b"joint_info": _joint_info,
    b"joint_params_set": _param_set,
    b"planets": _planets,
}
