"""What a world's history is told to, as it happens: a recorder that keeps it, a replay that compares it, a watcher.

It hides nothing: it is the order and the words in which a history is told. A world calls in the order of its history;
whoever listens sees every input before it acts, and every digest after its tick.
"""

from __future__ import annotations

from typing import Protocol

from nmes.protocol import Request

__all__ = ["Journal"]


class Journal(Protocol):
    """Where a world's history goes: a recorder, or a replay that compares. Called in the order of the history.

    A journal that cannot keep what it is told raises RecordingError, and the world faults with its code.
    """

    def joined(self, client: int) -> None:
        """A client came."""

    def left(self, client: int) -> None:
        """A client went."""

    def received(self, client: int, request: Request) -> None:
        """A frame came from a client; it is executed next."""

    def replied(self, client: int, request: Request, reply: bytes) -> None:
        """The frame was executed; `reply` is encoded, without delimiter."""

    def ticked(self, frame: int, digest: bytes) -> None:
        """The world reached `frame`."""

    def keyframe(self, snapshot: bytes) -> None:
        """The world was saved, as its config says that it is now and then."""

    def faulted(self, frame: int, code: str, message: str) -> None:
        """The world stopped at `frame`."""
