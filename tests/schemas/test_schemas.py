"""The schemas: valid, bounded, described, and in step with the world's handlers and the reference pages."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import referencing

from layout import ROOT
from nmes import protocol, schemas
from nmes.schemas.__main__ import page
from nmes.world.commands import COMMANDS

FILES = {path.relative_to(ROOT / "schemas").as_posix(): path for path in sorted((ROOT / "schemas").rglob("*.json"))}
MESSAGES = {
    path: schemas.load(path) for path in FILES if path.split("/")[0] in ("commands", "replies", "events", "auth.json")
}
READ_FROM_CLIENTS = ("commands/", "auth.json", "genome.json", "world_config.json", "brain-")


def parts(schema: Any, description: str = "") -> Iterator[tuple[dict[str, Any], str]]:
    """Yields every subschema with the description nearest to it."""
    if isinstance(schema, list):
        for item in schema:
            yield from parts(item, description)
    elif isinstance(schema, dict):
        description = schema.get("description", description)
        yield schema, description
        for key, value in schema.items():
            if key == "properties":
                for item in value.values():
                    yield from parts(item, description)
            elif key not in ("default", "examples", "enum", "const", "required"):
                yield from parts(value, description)


# -- each file by itself ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", FILES)
def test_each_file_is_a_valid_schema_of_2020_12(path: str) -> None:
    raw = json.loads(FILES[path].read_bytes())
    assert raw["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    jsonschema.Draft202012Validator.check_schema(raw)
    jsonschema.Draft202012Validator.check_schema(schemas.load(path))


@pytest.mark.parametrize(
    "path", [path for path in FILES if path != "common.json" and not path.startswith("recording/")]
)
def test_examples_are_valid_for_two_validators(path: str) -> None:
    resources = [
        (name, referencing.Resource.from_contents(json.loads(file.read_bytes()))) for name, file in FILES.items()
    ]
    registry: Any = referencing.Registry().with_resources(
        [(f"file:///{name}", resource) for name, resource in resources]
    )
    judge = jsonschema.Draft202012Validator({"$ref": f"file:///{path}"}, registry=registry)
    examples = schemas.load(path)["examples"]
    assert examples
    for example in examples:
        judge.validate(example)
        assert jsonschema.Draft202012Validator(schemas.load(path)).is_valid(example)


@pytest.mark.parametrize("path", MESSAGES)
def test_each_schema_is_named_after_its_type_and_describes_every_field(path: str) -> None:
    schema = MESSAGES[path]
    name = Path(path).stem
    assert schema["title"] == name
    assert schema["properties"]["type"]["const"] == name
    assert "type" in schema["required"]
    assert schema["description"].endswith(".")
    assert set(schema["required"]) <= set(schema["properties"])
    for part, _ in parts(schema):
        if "if" in part or "then" in part:
            continue
        for field, value in part.get("properties", {}).items():
            assert value.get("description") or "if" in schema or "allOf" in schema, f"{field} has no description"


@pytest.mark.parametrize("path", [path for path in FILES if path.startswith(READ_FROM_CLIENTS)])
def test_numbers_from_clients_have_bounds_and_units(path: str) -> None:
    for part, description in parts(schemas.load(path)):
        if part.get("type") not in ("number", "integer"):
            continue
        # The bounds are also what keeps an integer of 400 digits out: jsonschema-rs is content with "a number".
        for bound in {abs(part["minimum"]), abs(part["maximum"])} - {0}:
            assert schemas.number(bound) in description, f"{description!r} does not tell the bound {bound}"
        for unit in part.get("x-unit", "").split(" or "):
            assert unit in description, f"{description!r} does not tell the unit {unit}"


@pytest.mark.parametrize("path", [path for path in FILES if path.startswith(READ_FROM_CLIENTS)])
def test_defaults_are_valid(path: str) -> None:
    for part, _ in parts(schemas.load(path)):
        if "default" in part:
            jsonschema.Draft202012Validator(part).validate(part["default"])


@pytest.mark.parametrize("name", protocol.COMMANDS)
def test_commands_ignore_fields_that_they_do_not_know(name: str) -> None:
    command = protocol.COMMANDS[name]
    example = {**command.schema["examples"][0], "from the future": {"x": [None]}}
    assert command.validator.is_valid(example)


# -- schemas, handlers and documentation are in step ------------------------------------------------------------------


def test_commands_schemas_handlers_and_documentation_match() -> None:
    reference = (ROOT / "docs" / "messages.md").read_text()
    section = re.search(r"^## Commands\n(.*?)^## ", reference, flags=re.DOTALL | re.MULTILINE)
    assert section is not None
    documented = re.findall(r"^### (\w+)$", section[1], flags=re.MULTILINE)
    assert set(protocol.COMMANDS) == set(COMMANDS) == set(documented)


def test_every_reply_answers_a_command_and_every_command_has_a_reply() -> None:
    answers = {command.reply for command in protocol.COMMANDS.values()}
    assert set(protocol.REPLIES) == answers | {"auth_success", "world_list", "error"}


def test_the_required_commands_are_those_of_section_5() -> None:
    assert {name for name, command in protocol.COMMANDS.items() if command.required} == {
        "spawn_cube", "despawn_cube", "create_joint", "set_joint_param", "apply_physics",
        "get_cube_list", "get_cube_info", "ping",
    }  # fmt: skip


def test_the_reference_page_is_generated_from_the_schemas() -> None:
    committed = (ROOT / "docs" / "messages.md").read_text(encoding="utf-8")
    assert committed == page(), "run: python -m nmes.schemas > docs/messages.md"


def test_every_type_is_documented_once() -> None:
    headings = re.findall(r"^### (\w+)$", page(), flags=re.MULTILINE)
    messages = [*protocol.COMMANDS, *protocol.REPLIES, *protocol.EVENTS]
    assert sorted(headings) == sorted([*messages, "auth", "genome", "world_config", "recording_metadata"])


def test_every_error_code_is_documented_and_only_documented_codes_are_sent() -> None:
    for code, meaning in protocol.ERROR_CODES.items():
        assert f"| `{code}` | {meaning} |" in page()
    raised = {
        call.args[0].value
        for folder in ("nmes", "backends")
        for path in (ROOT / folder).rglob("*.py")
        for call in ast.walk(ast.parse(path.read_text()))
        if isinstance(call, ast.Call)
        and isinstance(call.func, ast.Name)
        and call.func.id in ("RejectedMessage", "WorldError")
        and isinstance(call.args[0], ast.Constant)
    }
    # These never go over the wire: what a host is told of its own, and what an environment finds of a server's world.
    unsent = {"bad_snapshot", "wrong_world", "too_few_worlds", "disturbed"}
    assert {"bad_json", "cube_not_found"} <= raised <= set(protocol.ERROR_CODES) | unsent


def test_the_protocol_page_names_only_codes_that_exist() -> None:
    text = (ROOT / "docs" / "protocol.md").read_text()
    named = set(re.findall(r"`([a-z]+_[a-z_]*[a-z])`", text))
    known = {
        *protocol.ERROR_CODES,
        *protocol.COMMANDS,
        *protocol.REPLIES,
        *protocol.EVENTS,
        "tick_rate",
        "collision_groups",
    }
    fields = {name for command in protocol.COMMANDS.values() for name in command.schema["properties"]}
    joints = set(protocol.COMMANDS["create_joint"].schema["properties"]["joint_params"]["properties"])
    originals = set(re.findall(r'"([a-z]+_[a-z_]+)"', (ROOT / "nmes" / "protocol" / "original.py").read_text()))
    assert named - known - fields - joints - originals == set()


# -- the loader -------------------------------------------------------------------------------------------------------


def test_loaded_schemas_have_their_references_resolved() -> None:
    spawn = schemas.load("commands/spawn_cube.json")
    assert "$ref" not in json.dumps(spawn)
    assert spawn["properties"]["position"]["default"] == [0, 1, 0]
    assert spawn["properties"]["position"]["items"]["maximum"] == 1_000_000


def test_the_hash_covers_names_and_contents(monkeypatch: pytest.MonkeyPatch) -> None:
    texts = dict(schemas._texts())
    assert set(texts) == set(FILES)

    def hash_of(changed: dict[str, bytes]) -> str:
        monkeypatch.setattr(schemas, "_texts", lambda: changed)
        return schemas.schema_hash.__wrapped__()

    was = hash_of(texts)
    assert was == schemas.schema_hash() == protocol.schema_hash()
    assert re.fullmatch("[0-9a-f]{64}", was)
    one, other = "commands/pause.json", "commands/resume.json"
    assert hash_of({**texts, one: texts[one] + b"\n"}) != was
    assert hash_of({**texts, one: texts[other], other: texts[one]}) != was


@pytest.mark.parametrize(
    ("schema", "words"),
    [
        (
            {"type": "number", "minimum": 0.000001, "maximum": 10**9, "x-unit": "kg"},
            "a number from 0.000001 to 1,000,000,000 kg",
        ),
        ({"type": "number", "minimum": -(10**15), "maximum": 10**15}, "a number from -1e15 to 1e15"),
        ({"type": "integer", "minimum": 1, "maximum": 10_000}, "a whole number from 1 to 10,000"),
        ({"type": "number", "minimum": 0, "x-unit": "s"}, "a number of at least 0 s"),
        ({"type": "number", "exclusiveMinimum": 0}, "a number above 0"),
        ({"type": "number", "x-unit": "N"}, "a number (N)"),
        ({"type": ["number", "boolean"]}, "a number or true or false"),
        ({"type": "array", "minItems": 3, "maxItems": 4, "items": {"type": "number"}}, "3 to 4 numbers"),
        ({"type": "array", "items": {"type": "string"}}, "an array, each a string"),
        ({"enum": ["tick", "state"]}, '"tick" or "state"'),
        ({"enum": [1, 2, 3, 4]}, "one of 1, 2, 3, 4"),
        ({"anyOf": [{"type": "object"}, {"type": "null"}]}, "an object or null"),
        ({"const": 0}, "0"),
        ({}, "any JSON value"),
    ],
)
def test_describe_names_types_bounds_and_defaults(schema: schemas.Schema, words: str) -> None:
    assert schemas.describe(schema) == words
