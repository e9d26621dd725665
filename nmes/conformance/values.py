"""Values from schemas: those at the bounds of a field, and those that it must refuse.

It hides JSON Schema. What is offered as wrong has been found wrong by the schema itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import jsonschema_rs

from nmes.protocol import COMMANDS
from nmes.schemas import Schema

__all__ = ["FIELD_NEEDS", "command_needs", "edges", "fields", "wrong"]

_HUGE = 1e300
# What a field needs that not every server which has the command must have: elsewhere it is an unknown field.
FIELD_NEEDS: dict[tuple[str, str], tuple[str, ...]] = {
    ("spawn_cube", "group"): ("collision_groups",),
    ("get_cube_info", "sensors"): ("sensors.inertial",),
    ("get_world_state", "sensors"): ("sensors.inertial",),
    ("get_cube_info", "rays"): ("sensors.range",),
    ("get_cube_info", "max_range"): ("sensors.range",),
    **{
        ("create_joint", name): ("joint.hinge", capability)
        for capability, names in {
            "motor": ("motor_target_velocity", "motor_max_impulse", "motor_max_force", "motor_enabled"),
            "servo": ("target_position",),
            "spring": ("stiffness", "damping"),
            "limits": ("limits", "limit_lower", "limit_upper", "limit_enabled"),
        }.items()
        for name in names
    },
}


def command_needs(kind: str) -> tuple[str, ...]:
    """Returns the needs of a case about a command: the command itself, where a server may leave it out."""
    return () if COMMANDS[kind].required else (kind,)


def fields(kind: str) -> Iterator[tuple[str, Schema]]:
    """Yields the fields of a command that have a shape of their own."""
    for name, part in COMMANDS[kind].schema["properties"].items():
        if name not in ("type", "id") and part.keys() - {"description", "title"}:
            yield name, part


def wrong(part: Schema) -> list[Any]:
    """Returns values that a field must refuse: of another type, out of bounds, too short, too long."""
    validator = jsonschema_rs.Draft202012Validator(part)
    candidates: list[Any] = [None, True, 7, 1.5, "", "no such thing", "a" * 129, [], {}, [[]], {"a": 1}]
    for choice in (part, *part.get("anyOf", ())):
        candidates += [*_beyond(choice), -_HUGE, _HUGE]
        items = choice.get("items", {})
        if items.get("type") == "number":
            good = [1.0] * choice.get("minItems", 1)
            candidates += [good[:-1], [*good, *good, 1.0], ["1", *good[1:]], [*good[:-1], None], [*good[:-1], [1.0]]]
            candidates += [[*good[:-1], value] for value in (*_beyond(items), _HUGE, -_HUGE)]
            candidates.append([0.0] * len(good))
        elif items:
            candidates += [[None], [7], [""], [{}], [[]], ["tick", "tick"], ["no such thing", 7]]
    unique = {repr(value): value for value in candidates}
    return [value for value in unique.values() if not validator.is_valid(value)]


def _beyond(part: Schema) -> list[float]:
    """Returns the numbers just beyond the bounds of one."""
    beyond = []
    for bound, outwards in (("minimum", -1), ("maximum", 1)):
        if bound in part:
            limit = part[bound]
            beyond.append(limit + outwards * (max(abs(limit), 1) * 0.01 + 1))
    return beyond


def edges(part: Schema) -> list[Any]:
    """Returns values at the bounds of a field."""
    values: list[Any] = []
    for choice in (part, *part.get("anyOf", ())):
        items = choice.get("items", {})
        if choice.get("type") in ("number", "integer"):
            values += [choice[bound] for bound in ("minimum", "maximum") if bound in choice]
        elif choice.get("type") == "boolean":
            values += [True, False]
        elif items.get("type") == "number" and "minimum" in items:
            for count in {choice["minItems"], choice["maxItems"]}:
                values += [[items["minimum"]] * count, [items["maximum"]] * count]
        elif items.get("enum"):
            values += [[value] for value in items["enum"]] + [items["enum"]]
    validator = jsonschema_rs.Draft202012Validator(part)
    return [value for value in values if validator.is_valid(value)]
