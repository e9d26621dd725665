"""Writes the docstrings of the client's commands from the schemas, so that an editor shows what every field means.

`python tools/client_docs.py` rewrites the modules of `nmes/client` that declare commands; a test compares them with
what it would write. Descriptions, units, bounds and defaults come from `schemas/`. Which errors a command can meet
follows from its fields and from the tables below.
"""

from __future__ import annotations

import ast
import textwrap
from collections.abc import Iterator
from typing import Any

from layout import ROOT
from nmes.protocol import COMMANDS, REPLIES
from nmes.schemas import Schema

MODULES = sorted((ROOT / "nmes" / "client").glob("*_commands.py"))
WIDTH = 120
INDENT = " " * 8
_SPACE = "\N{NO-BREAK SPACE}"  # stands for a space at which no line is broken

# The error of a field that names something which is not there.
_MISSING = {
    "cube_name": "cube_not_found",
    "cube": "cube_not_found",
    "cubes": "cube_not_found",
    "cube1": "cube_not_found",
    "cube2": "cube_not_found",
    "joint_name": "joint_not_found",
    "chains": "cube_not_found",
    "prefix": "cube_not_found",
    "creature": "creature_not_found",
}
# Errors that do not follow from the fields of a command.
_MORE = {
    "batch": ["unknown_type"],
    "compute_reward": ["bad_expression", "nothing_owned"],
    "create_bone": ["joint_exists", "limit_reached", "self_joint"],
    "create_joint": ["joint_exists", "limit_reached", "self_joint", "unsupported"],
    "get_cube_info": ["unsupported"],
    "give": ["player_not_found", "unsupported"],
    "link_body_cubes": ["limit_reached"],
    "link_cube_chains": ["limit_reached", "self_joint"],
    "set_joint_param": ["unsupported"],
    "set_joint_params": ["limit_reached"],
    "set_mode": ["wrong_mode"],
    "set_objective": ["bad_expression", "limit_reached", "nothing_owned"],
    "spawn_creature": ["creature_exists", "cube_exists", "limit_reached"],
    "spawn_cube": ["cube_exists", "limit_reached"],
    "step": ["wrong_mode"],
}
# Fields that name what is not there yet.
_NEW = {("spawn_cube", "cube_name"), ("create_joint", "joint_name"), ("create_bone", "joint_name")}
# Commands that must name a cube or a creature, and never mean the one that is owned.
_NAMING = {"give"}
# Commands that every role may do.
_FREE = {"batch", "get_planets", "get_world_info", "ping", "unsubscribe"}
# Commands that a world answers after its engine has failed.
_WHEN_FAULTED = {"get_world_info", "ping", "subscribe", "unsubscribe"}


def error_codes(kind: str) -> list[str]:
    """Returns the codes with which a server can refuse a valid connection's command, sorted."""
    command = COMMANDS[kind]
    fields = _fields(command.schema)
    codes = set(_MORE.get(kind, ()))
    if fields:
        codes.add("invalid")
    if not command.required:
        codes.add("unsupported")
    if kind not in _WHEN_FAULTED:
        codes.add("world_faulted")
    codes |= {_MISSING[name] for name in fields if name in _MISSING and (kind, name) not in _NEW}
    if kind not in _FREE:
        codes.add("not_allowed")
    own = "cube_name" in fields and "cube_name" not in command.schema["required"] and kind not in _NAMING
    if own and (kind, "cube_name") not in _NEW:
        codes.add("nothing_owned")
    return sorted(codes)


def docstring(kind: str, parameters: list[str], reply: str) -> str:
    """Returns the docstring of a command's method, indented and in quotes.

    Args:
        kind: The command's type.
        parameters: Its fields, in the order of the method's parameters.
        reply: The name of the reply's class.
    """
    command = COMMANDS[kind]
    summary, _, rest = command.schema["description"].partition(". ")
    lines = [f'{INDENT}"""{summary.rstrip(".")}.']
    if rest:
        lines += ["", *_wrap(rest, INDENT, INDENT)]
    if parameters:
        fields = _fields(command.schema)
        lines += ["", f"{INDENT}Args:", *(line for name in parameters for line in _entry(name, _meaning(fields[name])))]
    lines += ["", f"{INDENT}Returns:", *_entry(reply, REPLIES[command.reply].schema["description"])]
    lines += ["", f"{INDENT}Raises:"]
    codes = [f"`{code}`" for code in error_codes(kind)]
    if codes:
        either = " or ".join(filter(None, (", ".join(codes[:-1]), codes[-1])))
        lines += _entry("CommandFailed", f"The server refused it: {either}.")
    lines += _entry("Disconnected", "The connection was lost.")
    lines += _entry("TimeoutError", "No reply came in time.")
    return "\n".join([*lines, f'{INDENT}"""'])


def rewrite(source: str) -> str:
    """Returns the source of a module with the docstrings of its commands written anew."""
    lines = source.splitlines()
    for method in reversed(list(_declarations(ast.parse(source)))):
        old = method.body[0]
        assert isinstance(old, ast.Expr) and old.end_lineno is not None
        parameters = [argument.arg for argument in (*method.args.args, *method.args.kwonlyargs)][1:]
        reply = ast.unparse(method.returns or old).removeprefix("type[").removesuffix("]")
        lines[old.lineno - 1 : old.end_lineno] = docstring(method.name, parameters, reply).splitlines()
    return "\n".join(lines) + "\n"


def _declarations(module: ast.Module) -> Iterator[ast.FunctionDef]:
    """Yields the methods that declare commands, in order."""
    for node in ast.walk(module):
        if isinstance(node, ast.FunctionDef) and [ast.unparse(each) for each in node.decorator_list] == ["command"]:
            yield node


def _fields(schema: Schema) -> dict[str, Any]:
    return {name: part for name, part in schema["properties"].items() if name not in ("type", "id")}


def _meaning(part: Schema) -> str:
    """Returns a field's description, which tells units and bounds, with its choices and its default."""
    text: str = part["description"]
    if "enum" in part and not all(str(choice) in text for choice in part["enum"]):
        text += f" One of {', '.join(map(repr, part['enum']))}."
    if "default" in part:
        text += f" Default: {part['default']!r}.".replace(", ", f",{_SPACE}")
    return text


def _entry(name: str, text: str) -> list[str]:
    return _wrap(f"{name}: {text}", INDENT + " " * 4, INDENT + " " * 8)


def _wrap(text: str, first: str, following: str) -> list[str]:
    wrapper = textwrap.TextWrapper(WIDTH, first, following, break_long_words=False, break_on_hyphens=False)
    return [line.replace(_SPACE, " ") for line in wrapper.wrap(text)]


if __name__ == "__main__":
    for path in MODULES:
        path.write_text(rewrite(path.read_text()))
