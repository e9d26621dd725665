"""Roles: what those who are in a world may do, and on whose things.

Hides what the shipped roles mean, and how a command is judged by what it touches (`nmes.world.rights`). A thing belongs
to the *player* who made it, or was given it. Only cubes have owners: a joint is whose its two cubes are, a creature and
a structure whose all their cubes are.

Invariants: a world whose config names no roles judges nothing; a command that is not in `RIGHTS` is allowed to nobody;
who may not do a command to all that it touches has changed nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from nmes.errors import WorldError
from nmes.schemas.documents import JsonObject, did_you_mean
from nmes.world.clients import Client
from nmes.world.commands import RIGHTS
from nmes.world.rights import Touched, Touches, everything

if TYPE_CHECKING:
    from nmes.world.world import World

__all__ = ["OWNER", "Role", "read_roles"]

OWNER: Final = "owner"
"""The role that may do everything, which every world with roles has."""


@dataclass(frozen=True, slots=True)
class Role:
    """One role of a world.

    Attributes:
        name: Its name.
        own: The types of commands that it may do to what belongs to its player, each with what it touches.
        everywhere: Those that it may do to anything.
    """

    name: str
    own: Mapping[str, Touches]
    everywhere: frozenset[str]

    def allows(self, kind: str, player: int | None, touched: Touched) -> bool:
        """Whether a player of this role may do a type of command to all that it touches."""
        if kind in self.everywhere:
            return True
        return kind in self.own and touched is not None and all(cube.player == player for cube in touched)

    def require(self, world: World, client: Client, command: JsonObject) -> None:
        """Raises unless a client of this role may do a command that is not among those `everywhere`.

        Raises:
            WorldError: `not_allowed`, with what may not be done and whose it is; or what the command's function would
                raise, where a thing that it names is not there.
        """
        touches = self.own.get(command["type"])
        if touches is None:
            raise WorldError("not_allowed", f"the role {self.name!r} may not {command['type']}")
        touched, player = touches(world, client, command), client.player
        if touched is None:
            raise self._refusal(command, "this is about all that is in the world")
        for cube in touched:
            if cube.player != player:
                owner = "nobody" if cube.player is None else f"player {cube.player}"
                raise self._refusal(command, f"the cube {cube.name!r} belongs to {owner}")

    def _refusal(self, command: JsonObject, reason: str) -> WorldError:
        return WorldError(
            "not_allowed", f"the role {self.name!r} may {command['type']} only what is its own, and {reason}"
        )


def read_roles(config: Mapping[str, Any] | None) -> dict[str, Role]:
    """Returns the roles of a world by name, `owner` first; none where the config names none.

    Args:
        config: What the world's config says of them, or None.

    Raises:
        WorldError: `invalid`: one names what is no command, or says nothing and is none of those with a meaning of
            their own; `path` names the place.
    """
    if config is None:
        return {}
    roles = {OWNER: Role(OWNER, {}, frozenset(RIGHTS))}
    for name, permissions in config.items():
        if name != OWNER:
            roles[name] = _role(name, permissions)
    return roles


def _role(name: str, permissions: Mapping[str, Sequence[str]]) -> Role:
    path = f"roles/{name.replace('~', '~0').replace('/', '~1')}"
    if not permissions and name not in _SHIPPED:
        shipped = ", ".join((OWNER, *_SHIPPED))
        message = f"{path}: say what it may do under own and all; only {shipped} mean something by themselves"
        raise WorldError("invalid", message, path)
    permissions = permissions or _SHIPPED[name]
    free = {kind for kind, right in RIGHTS.items() if right.kind is None}
    own, everywhere = (_commands(permissions.get(whose, ()), f"{path}/{whose}") for whose in ("own", "all"))
    return Role(name, {kind: RIGHTS[kind].touches for kind in own}, everywhere | free)


def _commands(items: Sequence[str], path: str) -> frozenset[str]:
    """Returns the types of commands that a list of kinds and commands means."""
    commands: set[str] = set()
    for index, item in enumerate(items):
        meant = {kind for kind, right in RIGHTS.items() if item in (kind, right.kind)}
        if not meant:
            guess = did_you_mean(item, (*_KINDS, *RIGHTS))
            message = f"{path}/{index}: {item!r} is no command and no kind of them ({', '.join(_KINDS)}){guess}"
            raise WorldError("invalid", message, f"{path}/{index}")
        if path.endswith("/own") and all(RIGHTS[kind].touches is everything for kind in meant):
            message = f"{path}/{index}: {item} is about the world as a whole, which is nobody's own: put it under all"
            raise WorldError("invalid", message, f"{path}/{index}")
        commands |= meant
    return frozenset(commands)


_KINDS: Final = tuple(dict.fromkeys(right.kind for right in RIGHTS.values() if right.kind is not None))
_SHIPPED: Final[Mapping[str, Mapping[str, Sequence[str]]]] = {
    "player": {"own": ["build", "act", "give"], "all": ["look"]},
    "viewer": {"all": ["look"]},
    "referee": {"all": ["look", "time", "reset"]},
}
