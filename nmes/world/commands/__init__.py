"""The command table: one plain function for each type of command, and what it needs where there are roles.

A command function takes the world, the client that sent the command and the command itself, which its schema has found
valid, and returns the reply as a dict without `id`. It knows the fields of its command and nothing of sockets,
recordings. A new command is one function here, its line in two tables, and its two schemas; CONTRIBUTING.md shows it.

Invariant: a function that raises WorldError has changed nothing; but `step` has ticked until the world stopped.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from nmes.world.clients import Client
from nmes.world.commands import clients, creatures, cubes, general, joints, life, ownership, timing, voices
from nmes.world.rights import Right

if TYPE_CHECKING:
    from nmes.world.world import World

__all__ = ["COMMANDS", "HARMLESS", "RIGHTS", "CommandFunction"]

CommandFunction = Callable[["World", Client, dict[str, Any]], dict[str, Any]]

COMMANDS: dict[str, CommandFunction] = {
    **cubes.COMMANDS,
    **joints.COMMANDS,
    **creatures.COMMANDS,
    **life.COMMANDS,
    **ownership.COMMANDS,
    **voices.COMMANDS,
    **clients.COMMANDS,
    **timing.COMMANDS,
    **general.COMMANDS,
}
"""The function of every command, by the command's type."""

RIGHTS: dict[str, Right] = {
    **cubes.RIGHTS,
    **joints.RIGHTS,
    **creatures.RIGHTS,
    **life.RIGHTS,
    **ownership.RIGHTS,
    **voices.RIGHTS,
    **clients.RIGHTS,
    **timing.RIGHTS,
    **general.RIGHTS,
}
"""What every command needs in a world with roles; one that is left out is allowed to nobody there."""

HARMLESS = frozenset(
    {"ping", "sense", "hear", "subscribe", "unsubscribe", "set_objective", "compute_reward"}
    | {kind for kind in COMMANDS if kind.startswith("get_")}
)
"""The commands that change nothing but what their own client is told: a mistake in one leaves the world as it was."""
