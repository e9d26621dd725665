"""What the Python clients declare of commands, replies and events is what the schemas say."""

from __future__ import annotations

import inspect
import typing
from typing import Any

import pytest

from nmes import protocol
from nmes.client import declaration, replies
from nmes.client.commands import Commands
from nmes.client.replies import Event


def declared() -> dict[str, Any]:
    return {name: value.__wrapped__ for name, value in inspect.getmembers_static(Commands, is_command)}


def is_command(member: object) -> bool:
    return isinstance(member, declaration.command)


def check_shape(typed: Any, schema: Any) -> None:
    """Compares a TypedDict with a schema, all the way down."""
    hints = typing.get_type_hints(typed, include_extras=True)
    assert set(hints) == set(schema["properties"]) - {"id"}
    required = {
        name for name, kind in hints.items() if typing.get_origin(kind) is not typing.NotRequired and typed.__total__
    }
    assert required == set(schema.get("required", ()))
    for name, kind in hints.items():
        part = schema["properties"][name]
        if typing.is_typeddict(kind):
            check_shape(kind, part)
        elif typing.get_origin(kind) is list and typing.is_typeddict(typing.get_args(kind)[0]):
            check_shape(typing.get_args(kind)[0], part["items"])
        elif typing.get_origin(kind) is typing.Literal:
            assert typing.get_args(kind) == (tuple(part["enum"]) if "enum" in part else (part["const"],))


# The commands that clients have a method for; a new one gets its own when somebody writes it.
TYPED = """
adopt apply_force apply_physics batch compute_reward create_bone create_joint despawn_cube drive freeze_cube
get_camera get_cube_info get_cube_list get_cube_state get_genome get_joint_info get_joint_list get_joints_for_cube
get_planets get_world_info get_world_state give grow hear link_body_cubes link_cube_chains pause ping remove_joint
reset resume say sense set_color set_cube_state set_joint_param set_joint_params set_mode set_objective shed
spawn_creature spawn_cube step subscribe unsubscribe
""".split()


def test_no_command_has_lost_its_method() -> None:
    assert len(TYPED) == 45 and set(TYPED) <= set(declared())


@pytest.mark.parametrize("name", sorted(declared()))
def test_every_command_is_declared_as_its_schema_says(name: str) -> None:
    schema = protocol.COMMANDS[name]
    method = declared()[name]
    parameters = list(inspect.signature(method).parameters.values())[1:]
    required = set(schema.schema["required"]) - {"type"}
    assert {parameter.name for parameter in parameters} == set(schema.schema["properties"]) - {"type", "id"}
    assert {parameter.name for parameter in parameters if parameter.default is parameter.empty} == required
    (reply,) = typing.get_args(typing.get_type_hints(method)["return"])
    check_shape(reply, protocol.REPLIES[schema.reply].schema)


@pytest.mark.parametrize("name", sorted(protocol.EVENTS))
def test_every_event_is_declared_as_its_schema_says(name: str) -> None:
    kinds = {typing.get_args(typing.get_type_hints(kind)["type"])[0]: kind for kind in typing.get_args(Event)}
    assert set(kinds) == set(protocol.EVENTS)
    check_shape(kinds[name], protocol.EVENTS[name].schema)


def test_the_welcome_and_the_choices_are_declared_as_their_schemas_say() -> None:
    check_shape(replies.AuthSuccess, protocol.REPLIES["auth_success"].schema)
    check_shape(replies.WorldList, protocol.REPLIES["world_list"].schema)
    create_joint, set_mode = protocol.COMMANDS["create_joint"].schema, protocol.COMMANDS["set_mode"].schema
    assert set(typing.get_args(replies.JointType)) == set(create_joint["properties"]["joint_type"]["enum"])
    assert set(typing.get_args(replies.Mode)) == set(set_mode["properties"]["mode"]["enum"])
