"""The words of the original server, which the raw dialect speaks: its commands into ours.

Hides what the original's words meant there. A client that logs in with the bare password gets that meaning; the world,
its recording and its replay know only our commands. What is not in this table is understood as it stands, and a field
that is not known passes through, so that it is told of like every other.

Invariants: a translation depends on the command alone, never on a world; nothing that a client wrote is left out.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

__all__ = ["command"]

Message = dict[str, Any]


def command(said: Message) -> Message:
    """Returns a command of ours that does what a command did at the original; the same object where it is ours."""
    kind = said.get("type")
    translate = _COMMANDS.get(kind) if type(kind) is str else None
    return said if translate is None else translate(said)


def _renamed(message: Message, old: str, new: str) -> Message:
    """Returns a message with a field renamed in its place; as it is where the new name is there already."""
    if old not in message or new in message:
        return message
    return {new if name == old else name: value for name, value in message.items()}


def _apply_force(said: Message) -> Message:
    """Translates what was an impulse there: the velocity changes at once by force / mass."""
    return _renamed({**said, "type": "apply_physics"}, "force", "impulse")


def _apply_physics(said: Message) -> Message:
    return _renamed(said, "central_impulse", "impulse")


def _batch(said: Message) -> Message:
    commands = said.get("commands")
    if not isinstance(commands, list):
        return said
    return {**said, "commands": [command(inner) if isinstance(inner, dict) else inner for inner in commands]}


_COMMANDS: Final[dict[str, Callable[[Message], Message]]] = {
    "apply_force": _apply_force,
    "apply_physics": _apply_physics,
    "batch": _batch,
}
