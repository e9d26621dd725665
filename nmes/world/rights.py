"""What commands need, in a world with roles: a kind of permission, and that for all that they touch.

Beside each table `COMMANDS` stands one `RIGHTS`, in the words of this module; `nmes.world.roles` judges by them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, NamedTuple

from nmes.schemas.documents import JsonObject
from nmes.world.clients import Client
from nmes.world.entities import Cube

if TYPE_CHECKING:
    from nmes.world.world import World

__all__ = ["Right", "Touched", "Touches", "everything", "named", "nothing"]

Touched = Iterable[Cube] | None
"""The cubes that a command is about; None: it is about the world as a whole."""
Touches = Callable[["World", Client, JsonObject], Touched]


class Right(NamedTuple):
    """What a command needs.

    Attributes:
        kind: The kind of permission: `look`, `build`, `act`, `give`, `time` or `reset`; None: whoever is in may do it.
        touches: Returns the cubes that a command of this type is about. Raises what the command's function would raise
            where there is no such cube.
    """

    kind: str | None
    touches: Touches


def nothing(world: World, client: Client, command: JsonObject) -> Touched:
    """Touches nothing that is there."""
    return ()


def everything(world: World, client: Client, command: JsonObject) -> Touched:
    """Touches the world as a whole, which is nobody's own."""
    return None


def named(*fields: str) -> Touches:
    """Returns a function that names the cubes a command touches: those whose names stand in these fields."""

    def touches(world: World, client: Client, command: JsonObject) -> Touched:
        return [world.entities.cube(command[field], field) for field in fields]

    return touches
