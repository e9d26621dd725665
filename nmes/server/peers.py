"""The connections of one world, and the events on their way to them."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from time import monotonic
from typing import Protocol

from nmes.errors import NmesError
from nmes.server.threads import SLICE

__all__ = ["Peer", "Peers"]


class Peer(Protocol):
    """The connection of one client, as a hosted world sees it."""

    def resume(self) -> None:
        """Goes on with what had to wait: to join, or to submit a request."""

    def send_event(self, event: bytes) -> None:
        """Queues an event, without delimiter; `flush` follows soon."""

    def flush(self) -> None:
        """Hands what is queued to the socket."""

    def discard_output(self) -> None:
        """Drops what is queued."""

    def hang_up(self, error: NmesError | None = None) -> None:
        """Sends the error, if there is one, and closes."""


class Peers(dict[int, Peer]):
    """The connections of one world by client number.

    Attributes:
        unsent: Those with events that `flush` is to hand to their sockets.
    """

    def __init__(self) -> None:
        """Begins with none."""
        super().__init__()
        self.unsent: dict[Peer, None] = {}
        self._flushes = False  # soon, what is left

    def send(self, client: int, event: bytes) -> None:
        """Queues an event for a client, unless it has left."""
        if (peer := self.get(client)) is not None:
            peer.send_event(event)
            self.unsent[peer] = None

    def deliver(self, events: Iterable[tuple[int, bytes]]) -> None:
        """Sends events, each to its client."""
        for client, event in events:
            self.send(client, event)
        self.flush()

    def flush(self) -> None:
        """Hands all queued events to the sockets, for one slice: the rest of them follow when others had their turn."""
        if self._flushes:
            return
        until = monotonic() + SLICE
        while self.unsent:  # a recording that fails meanwhile brings more
            peer = next(iter(self.unsent))
            del self.unsent[peer]
            peer.flush()
            if self.unsent and monotonic() >= until:
                self._flushes = True
                asyncio.get_running_loop().call_soon(self._flush_more)
                break

    def _flush_more(self) -> None:
        self._flushes = False
        self.flush()

    def resume(self, client: int) -> None:
        """Lets a client go on soon."""
        asyncio.get_running_loop().call_soon(self[client].resume)

    def discard_output(self) -> None:
        """Drops what is queued for all."""
        for peer in self.values():
            peer.discard_output()

    def hang_up(self, error: NmesError | None = None) -> None:
        """Sends an error, if there is one, to all and closes their connections."""
        for peer in list(self.values()):
            peer.hang_up(error)
