"""Writes the messages of the TypeScript client from the schemas, so that it never lags behind them.

`python tools/ts_messages.py` writes `clients/typescript/src/messages.ts`; a test compares that with what it would
write. A command is an interface of its fields and a method of the client; replies and events are interfaces whose
`type` tells them apart.
"""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterator
from typing import Any

from layout import ROOT
from message_schemas import BY_HAND, about, messages, resolved

PATH = ROOT / "clients" / "typescript" / "src" / "messages.ts"
_WIDTH = 112
_SCALARS = {"number": "number", "integer": "number", "string": "string", "boolean": "boolean", "null": "null"}
_TUPLES = {3: "Vector", 4: "Quaternion"}  # arrays of so many numbers


def written() -> str:
    """Returns the file as it should be."""
    return "\n".join([*_Writer().file(), ""])


class _Writer:
    """TypeScript for all messages; interfaces that several share are written once."""

    def __init__(self) -> None:
        self._shared: dict[str, list[str]] = {}

    def file(self) -> Iterator[str]:
        """Yields the lines of the file."""
        commands, replies, events = (messages(folder) for folder in ("commands", "replies", "events"))
        body: list[str] = []
        for title, schema in replies.items():
            if title not in BY_HAND:
                extends = "" if title == "error" else " extends Reply"
                body += ["", *self._interface(f"{_camel(title)}{extends}", schema, kind=title)]
        for title, schema in events.items():
            body += ["", *self._interface(f"{_camel(title)}Event", schema, kind=title)]
        for title, schema in commands.items():
            if title not in BY_HAND:
                body += ["", *self._interface(_camel(title), schema, kind="")]
        yield "// Written by tools/ts_messages.py from schemas/; do not edit."
        yield ""
        yield "/** x, y (up), z. */"
        yield "export type Vector = readonly [number, number, number];"
        yield ""
        yield "/** x, y, z, w. */"
        yield "export type Quaternion = readonly [number, number, number, number];"
        yield ""
        yield "/** What is in every reply. */"
        yield "export interface Reply {"
        yield "  /** The paths of fields of the command that the server, perhaps an older one, does not know. */"
        yield "  readonly ignored?: readonly string[];"
        yield "}"
        for name in sorted(self._shared):
            yield ""
            yield from self._shared[name]
        yield from body
        kept = [title for title in commands if title not in BY_HAND]
        yield ""
        yield "/** A command as it is written: its type and its fields. */"
        yield from _union("Command", [f'({{ type: "{title}" }} & {_camel(title)})' for title in kept])
        yield ""
        yield "/** What the server tells those who subscribed. */"
        yield from _union("KnownEvent", [f"{_camel(title)}Event" for title in events])
        yield ""
        yield "/** The types of those. */"
        yield "export const EVENT_TYPES: ReadonlySet<string> = new Set(["
        yield from (f'  "{title}",' for title in events)
        yield "]);"
        yield ""
        yield "/** The reply to each command. */"
        yield "export interface Replies {"
        for title in kept:
            yield f"  {title}: {_camel(commands[title]['x-reply'])};"
        yield "}"
        yield ""
        yield "/** Every command of the protocol as a method. What may be left out is left to the server's default. */"
        yield "export abstract class Commands {"
        yield "  /** Sends a command, and waits for its reply. */"
        yield '  abstract request<C extends Command>(command: C): Promise<Replies[C["type"]]>;'
        for title in kept:
            yield from _method(title, commands[title])
        yield "}"

    def _interface(self, head: str, schema: dict[str, Any], *, kind: str) -> Iterator[str]:
        yield from _comment(schema.get("description", ""), "")
        yield f"export interface {head} {{"
        if kind:
            yield f'  readonly type: "{kind}";'
        yield from self._fields(schema, "  ")
        yield "}"

    def _fields(self, schema: dict[str, Any], indent: str) -> Iterator[str]:
        """Yields the fields of an object."""
        required = schema.get("required", ())
        for field, value in schema.get("properties", {}).items():
            if field in ("type", "id"):
                continue
            mark = "" if field in required else "?"
            yield from _comment(about(value), indent)
            yield f"{indent}readonly {field}{mark}: {self._type(value, indent)};"

    def _type(self, schema: dict[str, Any], indent: str) -> str:
        """Returns the type of the values of a schema."""
        if "$ref" in schema:
            shared = schema["$ref"].partition("#/$defs/")[2]
            found = resolved(schema)
            if not shared:
                return "{ readonly [name: string]: unknown }"
            if found.get("type") == "object" and found.get("properties"):
                name = _camel(shared)
                if name not in self._shared:
                    self._shared[name] = []  # before its fields, which may come to it again
                    self._shared[name] = list(self._interface(name, found, kind=""))
                return name
            return self._type(found, indent)
        alternatives = schema.get("anyOf") or schema.get("oneOf")
        if alternatives and "properties" not in schema and all("required" not in each for each in alternatives):
            return " | ".join(dict.fromkeys(self._type(each, indent) for each in alternatives))
        for key, values in (("enum", schema.get("enum")), ("const", [schema.get("const")])):
            if key in schema:
                return " | ".join(json.dumps(value) for value in values or ())
        kinds = schema.get("type", ())
        kinds = [kinds] if isinstance(kinds, str) else list(kinds)
        return " | ".join(self._one(kind, schema, indent) for kind in kinds) or "unknown"

    def _one(self, kind: str, schema: dict[str, Any], indent: str) -> str:
        if kind in _SCALARS:
            return _SCALARS[kind]
        if kind == "array":
            items, size = schema.get("items", {}), schema.get("minItems")
            if size == schema.get("maxItems") and size in _TUPLES and items.get("type") == "number":
                return _TUPLES[size]
            inner = self._type(items, indent)
            return f"readonly ({inner})[]" if " " in inner else f"readonly {inner}[]"
        if schema.get("properties"):
            return "\n".join(["{", *self._fields(schema, f"{indent}  "), f"{indent}}}"])
        extra = schema.get("additionalProperties")
        inner = self._type(extra, indent) if isinstance(extra, dict) else "unknown"
        return f"{{ readonly [name: string]: {inner} }}"


def _camel(name: str) -> str:
    return "".join(word[:1].upper() + word[1:] for word in name.replace("-", "_").split("_"))


def _union(name: str, members: list[str]) -> Iterator[str]:
    yield f"export type {name} ="
    yield from (f"  | {member}" for member in members[:-1])
    yield f"  | {members[-1]};"


def _comment(told: str, indent: str) -> Iterator[str]:
    lines = textwrap.wrap(told.replace("*/", "* /"), _WIDTH - len(indent))
    if len(lines) == 1:
        yield f"{indent}/** {lines[0]} */"
    elif lines:
        yield f"{indent}/**"
        yield from (f"{indent} * {line}" for line in lines)
        yield f"{indent} */"


def _method(title: str, schema: dict[str, Any]) -> Iterator[str]:
    """Yields the method of a command."""
    name, reply = _camel(title), _camel(schema["x-reply"])
    needed = {*schema.get("required", ())} - {"type", "id"}
    empty = not {*schema["properties"]} - {"type", "id"}
    parameter = "" if empty else f"command: {name}" if needed else f"command: {name} = {{}}"
    fields = "" if empty else ", ...command"
    yield ""
    yield from _comment(schema["description"], "  ")
    yield f"  {name[:1].lower()}{name[1:]}({parameter}): Promise<{reply}> {{"
    yield f'    return this.request({{ type: "{title}"{fields} }});'
    yield "  }"


if __name__ == "__main__":
    PATH.parent.mkdir(parents=True, exist_ok=True)
    PATH.write_text(written())
