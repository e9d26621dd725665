"""How joints and motors are drawn and changed: the same for a part of a graph and for a joint between two cubes.

Hides which fields a kind of joint may have, and how large limits, ranges and efforts usually are.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from nmes.schemas.documents import JsonObject
from nmes.variation.draw import Draw

__all__ = ["CHANGES_OF_JOINTS", "JointChange", "draw_joint"]

JointChange = Callable[[JsonObject, Draw, float, float, bool], bool]

_DRIVEN: Final = ("hinge", "slide")
_KINDS: Final = ("hinge", "slide", "fixed", "pin", "conetwist")
_USUAL: Final = (0.72, 0.12, 0.08, 0.04, 0.04)
_PLANAR: Final = 4  # so many of them stay in a plane
_REACH: Final = {"hinge": 1.2, "slide": 0.2}  # rad, m: how far the limits of a usual joint are from 0
_GRAVITY: Final = 9.81


def draw_joint(draw: Draw, weight: float, arm: float, planar: bool) -> JsonObject:
    """Draws what a joint is, but for where: `type`, `axis`, `limits`, `motor`.

    Args:
        draw: The choices.
        weight: Of the whole body, kg, to which its motor's effort is in proportion.
        arm: The length of what it moves, m.
        planar: Whether the body lies in the plane z = 0.
    """
    joint: JsonObject = {}
    _become(joint, draw.one_of(_KINDS[:_PLANAR], _USUAL[:_PLANAR]) if planar else draw.one_of(_KINDS, _USUAL))
    if joint["type"] in _DRIVEN:
        reach = _REACH[joint["type"]] * draw.uniform(0.4, 1.3)
        joint["limits"] = [round(-reach, 6), round(reach, 6)]
        _motorise(joint, draw, weight, arm)
    if joint["type"] in (*_DRIVEN, "conetwist"):
        _change_axis(joint, draw, weight, arm, planar)
    return joint


def _change_kind(joint: JsonObject, draw: Draw, weight: float, arm: float, planar: bool) -> bool:
    """Makes a joint one of another type, which keeps what it can of limits, motor and axis."""
    before = joint["type"]
    kinds = [kind for kind in (_KINDS[:_PLANAR] if planar else _KINDS) if kind != before]
    _become(joint, draw.one_of(kinds, [_USUAL[_KINDS.index(kind)] for kind in kinds]))
    if joint["type"] in _DRIVEN and "motor" not in joint:
        _motorise(joint, draw, weight, arm)
    if planar and joint["type"] in _DRIVEN:
        _change_axis(joint, draw, weight, arm, planar)
    return True


def _change_limits(joint: JsonObject, draw: Draw, weight: float, arm: float, planar: bool) -> bool:
    """Widens, narrows, shifts or takes away a joint's limits, or gives it some; False where it can have none."""
    kind = joint["type"]
    if kind not in (*_DRIVEN, "conetwist"):
        return False
    if "limits" in joint and draw.chance(0.1):
        del joint["limits"]
        return True
    if kind == "conetwist":
        swing, twist = joint.get("limits", (0.5, 0.5))
        joint["limits"] = [
            _within(limit * draw.factor(0.3) + abs(draw.normal(0.01)), 0.0, 3.14) for limit in (swing, twist)
        ]
        return True
    reach = _REACH[kind]
    low, high = joint.get("limits", (-reach, reach))
    low, high = (end * draw.factor(0.3) + draw.normal(0.05 * reach) for end in (low, high))
    joint["limits"] = [_within(min(low, 0.0), -1000.0, 0.0), _within(max(high, 0.0), 0.0, 1000.0)]
    return True


def _change_axis(joint: JsonObject, draw: Draw, weight: float, arm: float, planar: bool) -> bool:
    """Turns a joint's axis; False where it has none."""
    kind = joint["type"]
    if kind not in (*_DRIVEN, "conetwist"):
        return False
    if planar:
        x, y, _ = draw.direction()
        joint["axis"] = [0.0, 0.0, 1.0] if kind == "hinge" else [x, y, 0.0] if x or y else [1.0, 0.0, 0.0]
    else:
        joint["axis"] = draw.direction()
    return True


def _change_motor(joint: JsonObject, draw: Draw, weight: float, arm: float, planar: bool) -> bool:
    """Changes the mode, range or strength of a joint's motor, or gives it one; False where it can have none."""
    if joint["type"] not in _DRIVEN:
        return False
    if "motor" not in joint:
        _motorise(joint, draw, weight, arm)
        return True
    motor = joint["motor"]
    what = draw.one_of(("range", "effort", "mode", "spring"), (0.45, 0.35, 0.1, 0.1))
    if what == "mode":
        motor["mode"] = "velocity" if motor["mode"] == "position" else "position"
        motor["range"] = _range(motor["mode"], joint, draw)
    elif what == "effort":
        motor["max_effort"] = _within(motor["max_effort"] * draw.factor(0.4), 0.0, 1e6)
    elif what == "range":
        low, high = motor["range"]
        shift, width = draw.normal(0.1) * abs(high - low), draw.factor(0.3)
        ends = [_within(end * width + shift, -1000.0, 1000.0) for end in (low, high)]
        motor["range"] = ends if ends[0] != ends[1] else [low, high]
    else:
        name = draw.one_of(("stiffness", "damping"))
        usual = 0.1 * weight * (arm if joint["type"] == "hinge" else 10.0)
        joint[name] = _within(joint.get(name, usual) * draw.factor(0.5), 0.0, 1e6)
    return True


def _become(joint: JsonObject, kind: str) -> None:
    """Gives a joint a type, and takes away what one of that type may not have."""
    joint["type"] = kind
    joint.pop("limits", None)  # rad, m and the two numbers of a cone mean different things
    if kind not in _DRIVEN:
        for name in ("motor", "stiffness", "damping"):
            joint.pop(name, None)
    if kind in ("fixed", "pin"):
        joint.pop("axis", None)


def _motorise(joint: JsonObject, draw: Draw, weight: float, arm: float) -> None:
    """Gives a hinge or slide a motor that can lift a part of the body."""
    mode = draw.one_of(("position", "velocity"), (0.8, 0.2))
    strength = draw.uniform(0.2, 1.5) * _GRAVITY * weight
    joint["motor"] = {
        "mode": mode,
        "range": _range(mode, joint, draw),
        "max_effort": _within(strength * (arm if joint["type"] == "hinge" else 1.0), 0.001, 1e6),
    }


def _range(mode: str, joint: JsonObject, draw: Draw) -> list[float]:
    """Draws a motor's range: of a servo, up to the joint's limits."""
    reach = _REACH[joint["type"]]
    if mode == "velocity":
        speed = draw.uniform(1.0, 8.0) * reach
        return [round(-speed, 6), round(speed, 6)]
    low, high = joint.get("limits", (-reach, reach))
    part = draw.uniform(0.4, 1.0)
    ends = [round(part * low, 6), round(part * high, 6)]
    return ends if ends[0] != ends[1] else [round(-reach, 6), round(reach, 6)]


def _within(value: float, low: float, high: float) -> float:
    return round(min(max(value, low), high), 6)


CHANGES_OF_JOINTS: Final[Mapping[str, JointChange]] = {
    "joint": _change_kind,
    "limits": _change_limits,
    "axis": _change_axis,
    "motor": _change_motor,
}
"""The changes of a joint by name: functions of its document, a draw, the body's weight in kg, the length of what it
moves in m, and whether it must stay in the plane z = 0. They return False where there is nothing to change."""
