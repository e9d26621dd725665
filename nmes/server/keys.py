"""What opens which world of a host, and in which role: passwords, and the tokens by which players come back.

Hides how secrets are kept and compared, and who may create and close worlds: whoever has the host's password, and its
*makers*, each of whom has a password that opens, in any role, the worlds that he created, and no others. A token is the
player's number and a code for it, made with a key that is drawn for each world when it is offered, and that nobody
sees: so no token need be kept, and none outlives the host.

Invariants: passwords are kept only as digests, made with a key that nobody knows; secrets are compared in a time that
does not depend on how much of one is right; nor does any of it on how many worlds there are.
"""

from __future__ import annotations

import hmac
import re
import secrets
from collections import defaultdict
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from hashlib import blake2b
from typing import Any, NamedTuple, Self

from nmes.errors import RejectedMessage
from nmes.protocol import Auth
from nmes.world.roles import OWNER

__all__ = ["Keys", "Seat"]

_TOKEN = re.compile(r"([1-9][0-9]{0,15})-([0-9a-f]{64})")


class Seat(NamedTuple):
    """As what somebody joins a world.

    Attributes:
        role: The role; None in a world without roles.
        player: The number of the player who comes back; None: somebody new.
    """

    role: str | None
    player: int | None


@dataclass(frozen=True, slots=True)
class _World:
    """What opens one world: its roles by name, none where it has none; digests of its own passwords; its key.

    Its maker's password is one of its own.
    """

    roles: tuple[str, ...]
    passwords: tuple[bytes, ...]
    key: bytes

    def is_own(self, digest: bytes) -> bool:
        """Tells whether a digest is that of a password of its own."""
        return any([hmac.compare_digest(own, digest) for own in self.passwords])


class Keys:
    """The passwords of a host, and the tokens of those who play in its worlds.

    Args:
        password: The host's, which opens all worlds, in any role.
        roles: Passwords of roles, by their names: each opens all worlds that have such a role, in that role alone.
        makers: Passwords of those who may create worlds, by their names.
    """

    def __init__(self, password: str, roles: Mapping[str, str], makers: Mapping[str, str]) -> None:
        self._key = secrets.token_bytes(32)
        self._password = self._digest(password)
        self._roles = {role: self._digest(word) for role, word in roles.items()}
        self._makers = {maker: self._digest(word) for maker, word in makers.items()}
        self._worlds: dict[str, _World] = {}
        self._by_password: defaultdict[bytes, dict[str, None]] = defaultdict(dict)  # worlds by their own
        self._by_role: defaultdict[str, dict[str, None]] = defaultdict(dict)  # and by each of their roles

    def shared(self) -> dict[str, Any]:
        """Returns digests and key by which another process of the host knows the same passwords; of no world."""
        return {
            "key": self._key.hex(),
            "password": self._password.hex(),
            "roles": {role: digest.hex() for role, digest in self._roles.items()},
            "makers": {maker: digest.hex() for maker, digest in self._makers.items()},
        }

    @classmethod
    def of(cls, shared: Mapping[str, Any]) -> Self:
        """Returns the keys that another process of the host has `shared`."""
        keys = cls("", {}, {})
        keys._key, keys._password = bytes.fromhex(shared["key"]), bytes.fromhex(shared["password"])
        keys._roles = {role: bytes.fromhex(digest) for role, digest in shared["roles"].items()}
        keys._makers = {maker: bytes.fromhex(digest) for maker, digest in shared["makers"].items()}
        return keys

    def share_world(self, world: str) -> dict[str, Any]:
        """Returns the roles, passwords and token key of a world, for another process of the host."""
        about = self._worlds[world]
        own = [digest.hex() for digest in about.passwords]
        return {"roles": about.roles, "passwords": own, "key": about.key.hex()}

    def take_world(self, world: str, shared: Mapping[str, Any]) -> None:
        """Adds a world as another process of the host has shared it."""
        own = tuple(bytes.fromhex(digest) for digest in shared["passwords"])
        self._put(world, _World(tuple(shared["roles"]), own, bytes.fromhex(shared["key"])))

    def add(self, world: str, roles: Collection[str], password: str | None = None, maker: str | None = None) -> None:
        """Adds a world.

        Args:
            world: Its name.
            roles: Those that its config names; none where it is open.
            password: Its own, which opens it alone, in any role; None: it has none.
            maker: Who created it, whose password opens it too; None: the host.
        """
        names = tuple(dict.fromkeys((OWNER, *roles))) if roles else ()
        own = [] if password is None else [self._digest(password)]
        if maker is not None and maker in self._makers:
            own.append(self._makers[maker])
        self._put(world, _World(names, tuple(own), secrets.token_bytes(32)))

    def _put(self, world: str, about: _World) -> None:
        self._worlds[world] = about
        for password in about.passwords:
            self._by_password[password][world] = None
        for role in about.roles:
            self._by_role[role][world] = None

    def remove(self, world: str) -> None:
        """Forgets a world; what its tokens said is true no more."""
        about = self._worlds.pop(world)
        for password in set(about.passwords):  # a world's own may be its maker's
            del self._by_password[password][world]
        for role in about.roles:
            del self._by_role[role][world]

    def accepts(self, password: str) -> bool:
        """Tells whether a password is the host's."""
        return hmac.compare_digest(self._password, self._digest(password))

    def maker(self, password: str) -> str | None:
        """Returns whose password it is of those who may create worlds; None: nobody's of them."""
        digest = self._digest(password)
        own = [maker for maker, word in self._makers.items() if hmac.compare_digest(word, digest)]
        return own[0] if own else None

    def opened_by(self, password: str) -> Mapping[str, None]:
        """Returns the worlds, in order, that a password opens which is not the host's."""
        digest = self._digest(password)
        sources = [self._by_password.get(digest, {}), *(self._by_role[role] for role in self._roles_of(digest))]
        opened = [source for source in sources if source]
        return opened[0] if len(opened) == 1 else {world: None for source in opened for world in source}

    def made_by(self, maker: str) -> Mapping[str, None]:
        """Returns the worlds, in order, that a maker created, and those that have the same password."""
        return self._by_password.get(self._makers[maker], {})

    def seat(self, world: str, auth: Auth) -> Seat:
        """Returns as what somebody joins a world that the password of his `auth` opens.

        Raises:
            RejectedMessage: `role_not_found`: there is no such role, or the password does not open it; `auth_failed`:
                the token is none of a player of this world in such a role.
        """
        about = self._worlds[world]
        roles = self._opened(about, auth.password)
        if auth.role is not None:
            if auth.role not in roles:
                reason = f"this password opens no role {auth.role!r} of the world {world!r}"
                raise RejectedMessage("role_not_found", reason, "role")
            roles = (auth.role,)
        if auth.token is None:
            return Seat(roles[0] if roles else None, None)
        for role in roles:
            if (player := _player(about.key, role, auth.token)) is not None:
                return Seat(role, player)
        raise RejectedMessage(
            "auth_failed", "that token is of no player here, in a role that the password opens", "token"
        )

    def token(self, world: str, role: str, player: int) -> str:
        """Returns the secret by which a player comes back to a world in his role."""
        return f"{player}-{_code(self._worlds[world].key, role, player)}"

    def _opened(self, world: _World, password: str) -> tuple[str, ...]:
        """Returns the roles of a world that a password opens, the one first that it is for."""
        digest = self._digest(password)
        if self.accepts(password) or world.is_own(digest):
            return world.roles
        right = self._roles_of(digest)
        return tuple(role for role in world.roles if role in right)

    def _roles_of(self, digest: bytes) -> list[str]:
        """Returns the roles whose password it is, of whatever world."""
        return [role for role, own in self._roles.items() if hmac.compare_digest(own, digest)]

    def _digest(self, password: str) -> bytes:
        return blake2b(password.encode("utf-8", "surrogatepass"), key=self._key).digest()


def _player(key: bytes, role: str, token: str) -> int | None:
    """Returns the number of the player whose token it is; None: nobody's, in that role."""
    match = _TOKEN.fullmatch(token)
    if match is None:
        return None
    player = int(match[1])
    return player if hmac.compare_digest(_code(key, role, player), match[2]) else None


def _code(key: bytes, role: str, player: int) -> str:
    return blake2b(f"{player} {role}".encode(), key=key, digest_size=32).hexdigest()
