"""`python -m nmes.schemas > docs/messages.md`: the reference page of all messages, written from their schemas."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from typing import Any

from nmes.schemas import Schema, describe, load, load_all

_INTRODUCTION = """\
# Messages

Generated from the JSON Schemas in `schemas/` by `python -m nmes.schemas > docs/messages.md`; edit those. How messages
travel, and the conventions that all of them keep, stand in [protocol.md](protocol.md).

Every message is a JSON object whose `type` is the heading under which it stands here. A command may have an `id`, any
JSON value, which its reply carries back. Fields that are not listed are ignored in commands, and told in `ignored`, an
array of their paths that any reply may have; others may occur in answers.
"""


def page() -> str:
    """Returns the reference page."""
    sections = {
        "Auth": {"auth": load("auth.json")},
        "Commands": load_all("commands"),
        "Replies": load_all("replies"),
        "Events": load_all("events"),
        "Files": {kind: load(f"{kind}.json") for kind in ("genome", "world_config", "recording_metadata")},
    }
    parts = [_INTRODUCTION]
    for heading, schemas in sections.items():
        parts += [f"## {heading}\n", *(_message(kind, schema) for kind, schema in schemas.items())]
    return "\n".join(parts)


def _message(kind: str, schema: Schema) -> str:
    lines = [f"### {kind}", "", schema["description"] + _nature(schema), ""]
    rows = [row for row in _rows(schema, "") if row[0] not in ("type", "id")]
    if rows:
        lines += ["| field | | value | meaning |", "|---|---|---|---|"]
        lines += [f"| `{name}` | {need} | {value} | {meaning} |" for name, need, value, meaning in rows]
        lines.append("")
    if kind == "error":
        lines += ["| code | meaning |", "|---|---|"]
        lines += [f"| `{code['const']}` | {code['description']} |" for code in schema["properties"]["code"]["oneOf"]]
        lines.append("")
    for example in schema["examples"]:
        lines += ["```json", json.dumps(example, ensure_ascii=False), "```", ""]
    return "\n".join(lines)


def _nature(schema: Schema) -> str:
    if "x-reply" not in schema:
        return ""
    need = "Every server must have it." if schema["x-required"] else "Optional for a server."
    silence = " Silent in the raw dialect." if schema.get("x-silent") else ""
    return f" Answered by [{schema['x-reply']}](#{schema['x-reply']}). {need}{silence}"


def _rows(schema: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, str, str, str]]:
    """Yields a row for each field, those of objects inside too (`versions.nmes`, `joints[].cube1`)."""
    for name, part in schema.get("properties", {}).items():
        need = "required" if name in schema.get("required", ()) else "optional"
        if "default" in part and part.get("type") != "object":
            need = f"default {json.dumps(part['default'])}"
        if "x-when" in part:
            need = "for " + ", ".join(part["x-when"]) + need.replace("optional", "").replace("default", "; default")
        # The codes of an error have a table of their own.
        value = "a code, see below" if "oneOf" in part else describe(part).replace("|", "\\|")
        yield prefix + name, need, value, part.get("description", "")
        yield from _rows(part, f"{prefix}{name}.")
        yield from _rows(part.get("items", {}), f"{prefix}{name}[].")
        for choice in part.get("anyOf", ()):
            yield from _rows(choice, f"{prefix}{name}.")


if __name__ == "__main__":
    sys.stdout.write(page())
