"""The adjustable parameters of a joint: the wire's names, units and rules, and an engine's parameters from them.

Hides how the wire's parameters depend on each other (a target switches the motor on, the bound on the motor's
effort has two units, a position target makes the motor a servo), so that no engine needs to know.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from nmes.backend import JointParams
from nmes.errors import WorldError

__all__ = ["CAPABILITY", "adjust", "changed_params", "engine_params", "first_params", "is_complete"]

Params = dict[str, Any]
Require = Callable[[str, str, str], None]
"""Raises `unsupported` unless an engine has a capability, for what is told in words; then the field to blame."""

CAPABILITY = {
    "motor_target_velocity": "motor",
    "motor_max_impulse": "motor",
    "motor_max_force": "motor",
    "motor_enabled": "motor",
    "target_position": "servo",
    "stiffness": "spring",
    "damping": "spring",
    "limit_lower": "limits",
    "limit_upper": "limits",
    "limit_enabled": "limits",
}
"""The parameters that `set_joint_param` knows, and the capability that an engine must have for each."""

_SWITCHES = frozenset({"motor_enabled", "limit_enabled"})
_NOT_NEGATIVE = frozenset({"motor_max_impulse", "motor_max_force", "stiffness", "damping"})
_DEFAULT_MAX_IMPULSE = 1.0  # N m s or N s per engine step


def _default_params(engine_step: float) -> Params:
    """Returns the parameters of a new joint; `engine_step` is the length of one engine step in s."""
    return {
        "motor_target_velocity": 0.0,
        "motor_max_impulse": _DEFAULT_MAX_IMPULSE,
        "motor_max_force": _DEFAULT_MAX_IMPULSE / engine_step,
        "motor_enabled": False,
        "target_position": None,
        "stiffness": 0.0,
        "damping": 0.0,
        "limit_lower": 0.0,
        "limit_upper": 0.0,
        "limit_enabled": False,
    }


def is_complete(params: Mapping[str, Any]) -> bool:
    """Tells whether these are all the parameters of a joint, each of its type."""
    types = {name: {type(value)} for name, value in _default_params(1.0).items()}
    types["target_position"].add(float)
    return params.keys() == types.keys() and all(type(params[name]) in types[name] for name in types)


def first_params(kind: str, command: Mapping[str, Any], engine_step: float, require: Require) -> Params:
    """Returns the parameters that a new joint begins with.

    Args:
        kind: Its type.
        command: What makes it: fields that are parameters, `limits`, and over these `joint_params`.
        engine_step: Length of one engine step, s.
        require: See `Require`.

    Raises:
        WorldError: As by `changed_params`.
    """
    changes = {name: command[name] for name in CAPABILITY if name in command}
    if "limits" in command:
        changes["limit_lower"], changes["limit_upper"] = command["limits"]
        changes["limit_enabled"] = True
    params = changed_params(kind, _default_params(engine_step), changes, engine_step, "{}", require)
    return changed_params(kind, params, command.get("joint_params", {}), engine_step, "joint_params/{}", require)


def changed_params(
    kind: str,
    params: Mapping[str, Any],
    changes: Mapping[str, Any],
    engine_step: float,
    path: str,
    require: Require,
) -> Params:
    """Returns parameters with changes made, in the order in which they act whatever theirs is, all of them or none.

    Args:
        kind: The joint's type.
        params: What the joint has now.
        changes: New values; what is no parameter is passed over.
        engine_step: Length of one engine step, s.
        path: The field to blame, with `{}` for the parameter's name.
        require: See `Require`.

    Raises:
        WorldError: `unsupported`: joints of this type, or the engine's, have no such parameter. `invalid`: of the wrong
            type, negative, or the limits are the wrong way round. A `conetwist` has its largest swing for lower limit
            and its largest twist for upper one, neither of them negative.
    """
    known = {name: changes[name] for name in CAPABILITY if name in changes}
    for name in known:
        field = "param_name" if path == "value" else path.format(name)
        if kind not in ("hinge", "slide") and not (kind == "conetwist" and name.startswith("limit")):
            raise WorldError("unsupported", f"a {kind} joint has no {name}", field)
        require(CAPABILITY[name], f"{name} for joints", field)
    return adjust(kind, params, known, engine_step, path)


def adjust(
    kind: str, params: Mapping[str, Any], changes: Mapping[str, float | bool], engine_step: float, path: str
) -> Params:
    """Returns parameters with changes made in this order."""
    result = dict(params)
    for name, value in changes.items():
        field = path.format(name)
        if isinstance(value, bool) != (name in _SWITCHES):
            expected = "true or false" if name in _SWITCHES else "a number"
            raise WorldError("invalid", f"{field}: {name} must be {expected}, not {value}", field)
        if name in _NOT_NEGATIVE and value < 0:
            raise WorldError("invalid", f"{field}: {name} must not be negative, but is {value}", field)
        result[name] = value if isinstance(value, bool) else float(value)
        if name == "motor_target_velocity":
            result["motor_enabled"], result["target_position"] = True, None
        elif name == "target_position":
            result["motor_enabled"] = True
        elif name == "motor_max_impulse":  # per engine step, the deployed clients' unit
            result["motor_max_force"] = float(value) / engine_step
        elif name == "motor_max_force":
            result["motor_max_impulse"] = float(value) * engine_step
    lower, upper = result["limit_lower"], result["limit_upper"]
    field = "limits" if path == "{}" else path.format("limit_lower")
    if result["limit_enabled"] and kind == "conetwist":
        if lower < 0.0 or upper < 0.0:
            raise WorldError(
                "invalid", f"{field}: the largest swing {lower} and twist {upper} must not be negative", field
            )
    elif result["limit_enabled"] and lower > upper:
        raise WorldError("invalid", f"{field}: limit_lower {lower} is above limit_upper {upper}", field)
    return result


def engine_params(params: Mapping[str, Any]) -> JointParams:
    """Returns an engine's parameters for a joint with these parameters of the wire."""
    result = JointParams(
        target_velocity=params["motor_target_velocity"],
        max_effort=params["motor_max_force"],
        stiffness=params["stiffness"],
        damping=params["damping"],
        limits=(params["limit_lower"], params["limit_upper"]) if params["limit_enabled"] else None,
    )
    if not params["motor_enabled"]:
        return result
    if params["target_position"] is None:
        return replace(result, motor="velocity")
    return replace(result, motor="position", target_position=params["target_position"])
