"""The listener to a world's history: a recorder that keeps it, a replay that compares it, a watcher.

A world calls its journal in the order of its history: every input before it acts, every digest after its tick.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from nmes.protocol import Request
from nmes.schemas.documents import JsonObject

__all__ = ["Journal"]


class Journal(Protocol):
    """Base of all listeners to a world's history; each method does nothing unless it is overridden.

    A journal that cannot keep what happened raises RecordingError, and the world faults with that error's code. The
    recorder does not inherit from it, but has the same methods: reading recordings must not load worlds.
    """

    # `return` makes each method a default that subclasses inherit; without it a type checker takes it for abstract.

    def joined(self, client: int, role: str | None, player: int | None) -> None:
        """A client came; in a world with roles, in a role and as a player."""
        return

    def left(self, client: int) -> None:
        """A client went."""
        return

    def received(self, client: int, request: Request) -> None:
        """A frame came from a client; it is executed next."""
        return

    def replied(self, client: int, request: Request, reply: bytes) -> None:
        """The frame was executed; `reply` is encoded, without delimiter."""
        return

    def ticked(self, frame: int, digest: bytes) -> None:
        """The world reached `frame`; the digest is of its whole state."""
        return

    def lived(self, frame: int, events: Sequence[JsonObject]) -> None:
        """The ecosystem's events of the tick that led to `frame`; there is at least one."""
        return

    def keyframe(self, snapshot: bytes) -> None:
        """The world was saved, as its config says that it is now and then."""
        return

    def hibernated(self, frame: int) -> None:
        """The world is saved next, which `keyframe` tells, and sleeps until somebody comes."""
        return

    def faulted(self, frame: int, code: str, message: str) -> None:
        """The world stopped at `frame`."""
        return
