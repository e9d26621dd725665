"""Fields: for each one of each command, what it must refuse and what it must take, generated from the schemas."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from nmes.conformance.case import Category, Finding, Row
from nmes.conformance.trial import Trial
from nmes.conformance.values import FIELD_NEEDS, command_needs, edges, fields, wrong
from nmes.conformance.wire import Wire, clip
from nmes.protocol import COMMANDS

FIELDS = Category(6, "fields")
case, table = FIELDS.case, FIELDS.table

HIGH = 50_000.0  # m up, where even a cube of 1 km is in nobody's way
CHANGES_THE_WORLD = frozenset({"reset", "set_mode", "step", "pause", "resume"})
SEEN = frozenset({"position", "size", "mass", "friction", "restitution", "color", "linear_velocity"})


def needs(kind: str, field: str) -> tuple[str, ...]:
    """Returns the needs of a case about a field of a command."""
    joint = ("joint.fixed",) if "joint_name" in COMMANDS[kind].schema["properties"] or kind == "create_joint" else ()
    return (*command_needs(kind), *joint, *FIELD_NEEDS.get((kind, field), ()))


def rows_of_wrong_values() -> Iterator[Row]:
    """Yields a row for each field of each command."""
    for kind in COMMANDS:
        for name, part in fields(kind):
            if wrong(part):
                yield Row(f"{kind}.{name}", (kind, name, part), needs(kind, name), f"4.{kind}")


def rows_of_missing_fields() -> Iterator[Row]:
    """Yields a row for each field that a command must have."""
    for kind, command in COMMANDS.items():
        for name in command.schema["required"]:
            if name != "type":
                yield Row(f"{kind}.{name}", (kind, name), needs(kind, name), f"4.{kind}")


def rows_of_bounds() -> Iterator[Row]:
    """Yields a row for each field with bounds of commands that leave others alone."""
    for kind in ("spawn_cube", "set_cube_state", "apply_physics", "apply_force", "subscribe"):
        for name, part in fields(kind):
            if edges(part) and name != "list":
                yield Row(f"{kind}.{name}", (kind, name, part), needs(kind, name), f"4.{kind}")


def valid(t: Trial, wire: Wire, kind: str) -> dict[str, Any]:
    """Returns a command of that type, about cubes and joints that there are."""
    command: dict[str, Any] = dict(COMMANDS[kind].schema["examples"][0])
    properties = COMMANDS[kind].schema["properties"]
    if kind == "spawn_cube":
        return {"type": kind, "cube_name": t.name(), "position": t.at(y=HIGH), "is_base": True, "list": False}
    if "cube_name" in properties:
        command["cube_name"] = t.base(wire)
    if "cube1" in properties:
        command |= {"cube1": t.base(wire), "cube2": t.base(wire, position=t.at(1.5))}
    if "joint_name" in properties:
        command["joint_name"] = t.join_cubes(wire, t.base(wire), t.base(wire, position=t.at(1.5)))
    if kind == "create_joint":
        command |= {"joint_type": "hinge" if t.probe.claims("joint.hinge") else "fixed"}
    if kind == "spawn_creature":
        command |= {"name": t.name(), "position": t.at()}
    if kind == "get_world_state":
        command["cubes"] = [t.base(wire)]
    return command


def about(field: Any, name: str) -> bool:
    """Whether an error's `field` names a field, or a value in it."""
    return isinstance(field, str) and (field == name or field.startswith(name + "/"))


@table(1, "3.3.1", rows_of_wrong_values())
def wrong_values_are_refused(t: Trial, row: tuple[str, str, Any]) -> None:
    """A value that a field's schema does not allow gets invalid with the field's name, and changes nothing."""
    kind, name, part = row
    wire = t.join()
    command = valid(t, wire, kind)
    before = t.cubes(wire)
    for value in wrong(part):
        reply = wire.ask({**command, name: value})
        try:
            t.error(reply, "invalid")
        except Finding as finding:
            raise Finding(f"error invalid for {name} {clip(value)}", finding.received) from finding
        t.should(about(reply.get("field"), name), f"field {name!r} for {name} {clip(value)}", reply)
    if kind in ("spawn_cube", "despawn_cube"):
        mine = [cube for cube in before if cube.startswith(f"{t.probe.tag}-{t.plot}-")]
        now = [cube for cube in t.cubes(wire) if cube.startswith(f"{t.probe.tag}-{t.plot}-")]
        t.equal(now, mine, "the case's cubes")


@table(2, "4.error.invalid", rows_of_missing_fields())
def missing_fields_are_refused(t: Trial, row: tuple[str, str]) -> None:
    """A command without a field that it must have gets invalid with the field's name."""
    kind, name = row
    wire = t.join()
    command = {key: value for key, value in valid(t, wire, kind).items() if key != name}
    reply = t.error(wire.ask(command), "invalid")
    t.should(reply.get("field") == name, f"field {name!r}", reply)
    t.fence(wire)


@table(3, "4.spawn_cube", rows_of_bounds())
def bounds_are_taken(t: Trial, row: tuple[str, str, Any]) -> None:
    """A value at the bound of a field is taken, and seen where it can be."""
    kind, name, part = row
    wire = t.join()
    for value in edges(part):
        command = {**valid(t, wire, kind), name: value}
        reply = t.ask(wire, command, COMMANDS[kind].reply)
        if kind == "spawn_cube" and name in SEEN:
            t.adopt(reply["spawned"])
            info = t.info(wire, reply["spawned"])
            expected = value if isinstance(value, list) else [value] * 3 if name == "size" else value
            if name == "color" and len(value) == 3:
                expected = [*value, 1.0]
            if t.probe.planar and name in ("position", "linear_velocity"):
                expected = [*expected[:2], 0.0]
            if name != "linear_velocity":  # a frozen cube has none
                size = max(map(abs, expected)) if isinstance(expected, list) else abs(expected)
                t.close(info[name], expected, 1e-6 * max(size, 1e-6), name)
        elif kind == "spawn_cube":
            t.adopt(reply["spawned"])
    t.fence(wire)


@case(4, "4.error.invalid")
def is_base_leaves_room_for_its_suffix(t: Trial) -> None:
    """With is_base, a name that is longer than 128 with _BASE appended is invalid."""
    wire = t.join()
    name = t.name().ljust(124, "x")
    command = {"type": "spawn_cube", "cube_name": name, "is_base": True, "position": t.at()}
    t.refused(wire, command, "invalid", "cube_name")
    t.base(wire, position=t.at(), cube_name=name[:123])


@case(5, "3.3.2", needs=("batch",))
def the_field_inside_a_batch(t: Trial) -> None:
    """The field of an invalid command in a batch is a pointer into the batch."""
    wire = t.join()
    inner = [{"type": "ping"}, {"type": "spawn_cube", "mass": -1}]
    t.refused(wire, {"type": "batch", "commands": inner}, "invalid", "commands/1/mass")
    inner = [{"type": "spawn_cube", "position": [0, "up", 0]}]
    t.refused(wire, {"type": "batch", "commands": inner}, "invalid", "commands/0/position/1")


@case(6, "3.3.2")
def the_field_inside_a_vector(t: Trial) -> None:
    """The field of an error is a pointer to the number that is wrong."""
    wire = t.join()
    for index in range(3):
        position: list[Any] = [0, 1, 0]
        position[index] = "x"
        t.refused(wire, {"type": "spawn_cube", "position": position}, "invalid", f"position/{index}")
    t.refused(wire, {"type": "spawn_cube", "color": [0.5, 0.5, 7]}, "invalid", "color/2")


@case(7, "4.spawn_cube")
def whole_numbers_may_have_a_point(t: Trial) -> None:
    """A number is a number however it is written: 1, 1.0, 1e0."""
    wire = t.join()
    for text in (b"2", b"2.0", b"2e0", b"0.2E+1"):
        name = t.name()
        wire.say({"type": "ping", "id": 0})
        t.equal(wire.reply("pong")["id"], 0, "the id")
        where = ",".join(map(str, t.at())).encode()
        wire.send(
            b'{"type":"spawn_cube","list":false,"cube_name":"%s","position":[%s],"mass":%s}<???DONE???---'
            % (name.encode(), where, text)
        )
        t.equal(wire.reply("cube_list")["type"], "cube_list", f"the reply to mass {text.decode()}")
        t.close(t.info(wire, name)["mass"], 2.0, 1e-9, "mass")
