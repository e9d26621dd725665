"""The schemas of messages as the writers of clients read them: `tools/go_messages.py`, `tools/ts_messages.py`."""

from __future__ import annotations

import json
from typing import Any

from layout import ROOT

__all__ = ["BY_HAND", "about", "messages", "resolved"]

BY_HAND = {"batch", "batch_result", "error"}
"""Messages that clients write by hand."""

_COMMON = json.loads((ROOT / "schemas" / "common.json").read_text())["$defs"]


def messages(folder: str) -> dict[str, dict[str, Any]]:
    """Returns the schemas of `commands`, `replies` or `events`, by name."""
    paths = sorted((ROOT / "schemas" / folder).glob("*.json"))
    return {path.stem: json.loads(path.read_text()) for path in paths}


def resolved(schema: dict[str, Any]) -> dict[str, Any]:
    """Returns a schema with what it refers to, its own words first; a document of its own (a genome) is any value."""
    path, _, name = schema.get("$ref", "").partition("#/$defs/")
    if not path and not name:
        return schema
    found = resolved(_COMMON[name]) if name else {}
    return {**found, **{key: value for key, value in schema.items() if key != "$ref"}}


def about(schema: dict[str, Any]) -> str:
    """Returns what a field means: its description, what it may be, its default."""
    found = resolved(schema)
    told = str(found.get("description", ""))
    if "enum" in found:
        told += f" One of {', '.join(str(each) for each in found['enum'])}."
    default = found.get("default")
    return told if default in (None, False) else f"{told} Default: {default}."
