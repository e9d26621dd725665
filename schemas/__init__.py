"""The shapes of all messages: the JSON Schema (2020-12) files in this folder, and what is derived from them alone.

This module hides where the files lie (`importlib.resources`) and that they refer to each other: `load` returns
schemas in which every `$ref` has been replaced by what it means, so that a schema can be handed on by itself.
Keywords of our own: `x-unit` (of a number), `x-reply`, `x-required` (section 5 of the protocol) and `x-silent` (in
the raw dialect) of a command, `x-volatile` of a reply or of a field of one (its content may differ from machine to
machine, or from version to version, so a replay does not compare it), `x-message` (any `command` or `reply`),
`x-secret` (never repeated in an error), `x-parameter` (of a number of a brain: part of its vector), `x-when` (of a
property of a document: it is there where `type` is one of these, and only there).
"""

from __future__ import annotations

import hashlib
import json
import posixpath
from collections.abc import Mapping
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from typing import Any

__all__ = ["Schema", "describe", "load", "load_all", "schema_hash"]

Schema = dict[str, Any]


@cache
def _texts() -> dict[str, bytes]:
    """Returns all schema files by their path in this folder, sorted."""
    texts: dict[str, bytes] = {}

    def collect(folder: Traversable, prefix: str) -> None:
        for entry in folder.iterdir():
            if entry.is_dir():
                collect(entry, f"{prefix}{entry.name}/")
            elif entry.name.endswith(".json"):
                texts[prefix + entry.name] = entry.read_bytes()

    collect(resources.files(__name__), "")  # the submodule `files` takes that name here
    return dict(sorted(texts.items()))


@cache
def _parsed(path: str) -> Any:
    """Returns what a schema file holds, never to be changed; read once, as many references lead into few files."""
    return json.loads(_texts()[path])


@cache
def schema_hash() -> str:
    """Returns the SHA-256 of all schema files, in hexadecimal: equal hashes, equal protocol."""
    total = hashlib.sha256()
    for path, text in _texts().items():
        total.update(f"{path}\0{len(text)}\0".encode() + text)
    return total.hexdigest()


def load(path: str) -> Schema:
    """Returns the schema in a file such as `commands/ping.json`, with no reference left in it."""
    schema = _inlined(_parsed(path), path)
    assert isinstance(schema, dict)
    return schema


def load_all(folder: str) -> dict[str, Schema]:
    """Returns the schemas of a folder (`commands`, `replies`, `events`) by message type, sorted."""
    paths = [path for path in _texts() if posixpath.dirname(path) == folder]
    return {posixpath.basename(path).removesuffix(".json"): load(path) for path in paths}


def _inlined(value: Any, path: str) -> Any:
    """Replaces references; what stands beside a `$ref` (a description, a default) takes precedence."""
    if isinstance(value, list):
        return [_inlined(item, path) for item in value]
    if not isinstance(value, dict):
        return value
    beside = {key: _inlined(item, path) for key, item in value.items() if key != "$ref"}
    if "$ref" not in value:
        return beside
    file, _, pointer = value["$ref"].partition("#")
    target_path = posixpath.normpath(posixpath.join(posixpath.dirname(path), file)) if file else path
    target = _parsed(target_path)
    for key in pointer.split("/")[1:]:
        target = target[key]
    return {**_inlined(target, target_path), **beside}


def describe(schema: Mapping[str, Any]) -> str:
    """Returns words for the values that a schema allows: `a number from 0 to 10`, `3 numbers from -1e15 to 1e15 N`."""
    if "title" in schema:
        return str(schema["title"])
    if "const" in schema:
        return json.dumps(schema["const"])
    if "enum" in schema:
        choices = [json.dumps(choice) for choice in schema["enum"]]
        return " or ".join(choices) if len(choices) < 4 else "one of " + ", ".join(choices)
    for alternatives in ("anyOf", "oneOf"):
        if any("const" in choice or "type" in choice for choice in schema.get(alternatives, ())):
            return " or ".join(describe(choice) for choice in schema[alternatives])
    kinds = schema.get("type", "any")
    if isinstance(kinds, list):
        return " or ".join(describe({**schema, "type": kind}) for kind in kinds)
    match kinds:
        case "boolean":
            return "true or false"
        case "null":
            return "null"
        case "number" | "integer":
            return ("a number" if kinds == "number" else "a whole number") + _range(schema)
        case "string":
            longest = schema.get("maxLength")
            return "a string" + (f" of at most {longest} characters" if longest is not None else "")
        case "array":
            return _describe_array(schema)
        case "object":
            return "an object"
    return "any JSON value"


def _describe_array(schema: Mapping[str, Any]) -> str:
    items = schema.get("items", {})
    least, most = schema.get("minItems", 0), schema.get("maxItems")
    if most is None or items.get("type") != "number":
        return f"an array{'' if most is None else f' of at most {most}'}, each {describe(items)}"
    count = str(most) if least == most else f"{least} to {most}"
    return f"{count} numbers{_range(items)}"


def _range(schema: Mapping[str, Any]) -> str:
    low, high = schema.get("minimum"), schema.get("maximum")
    text = ""
    if low is not None and high is not None:
        text = f" from {number(low)} to {number(high)}"
    elif low is not None:
        text = f" of at least {number(low)}"
    elif "exclusiveMinimum" in schema:
        text = f" above {number(schema['exclusiveMinimum'])}"
    unit = schema.get("x-unit")
    return text + (f" {unit}" if text else f" ({unit})") if unit else text


def number(value: float) -> str:
    """Writes a bound: `1,000,000`, `0.000001`, `1e15`."""
    if value != int(value):
        return f"{value:.9f}".rstrip("0")
    digits = str(abs(int(value)))
    if len(digits) > 10 and not digits[1:].strip("0"):
        return f"{'-' if value < 0 else ''}{digits[0]}e{len(digits) - 1}"
    return f"{int(value):,}"
