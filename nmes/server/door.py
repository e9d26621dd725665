"""The door of a host: where sockets come in, and how many may wait there before they have said the password.

It accepts by itself, since asyncio counts neither a TLS handshake nor a socket that says nothing, and asks again and
again when the system has no more descriptors.

Invariants:

- Of those that are not in yet there are never more than `Limits.unauthenticated`. One that comes over the limit puts
  out the oldest one of the address that has the most, so whoever comes and speaks is heard.
- A wrong password costs its address a token, and all of them together another one. An address without a token is not
  heard for a while, nor is one that guessed lately while all of them have none; one that never did always is.
- An address is an IPv4 address, or the 64 bits of an IPv6 address that its owner can choose no other than.
"""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import logging
import os
import socket
import ssl
from collections import OrderedDict
from collections.abc import Callable
from time import monotonic
from typing import Protocol

from nmes.errors import MachineError

__all__ = ["Bucket", "Door", "Entrant", "Guesses", "address_of", "cannot_listen"]

logger = logging.getLogger(__name__)

BACKLOG = 1024  # sockets that the system keeps for us
AT_ONCE = 4  # of these that are accepted before others have their turn
AT_ONCE_TLS = 1  # the same where there is TLS: for each asyncio fills a buffer of 256 KiB, for half a ms or more
PAUSE = 0.2  # s: for how long none is accepted where the system has no more descriptors
SILENCE = 60.0  # s: for how long that is not logged again


class Entrant(Protocol):
    """A socket that has not authenticated yet."""

    def abort(self) -> None:
        """Ends it at once."""


class Bucket:
    """Tokens that come back with time, up to so many."""

    def __init__(self, size: float, rate: float) -> None:
        """Begins full; `rate` tokens come back in a second."""
        self.size, self.rate = size, rate
        self._tokens, self._at = size, 0.0

    def tokens(self, now: float) -> float:
        """Returns how many there are."""
        return min(self.size, self._tokens + (now - self._at) * self.rate)

    def delay(self, now: float) -> float:
        """Returns for how long (s) there is no token."""
        return max(0.0, (1.0 - self.tokens(now)) / self.rate)

    def take(self, now: float) -> None:
        """Takes one."""
        self._tokens, self._at = self.tokens(now) - 1.0, now


class Guesses:
    """The wrong passwords of late, by address and in common: they say whose next one is not even looked at.

    It reads no clock: whoever asks says what time it is (s).

    Args:
        part: Which part of all guesses are allowed here, as others count the rest; one at once is at least.
    """

    ADDRESS = (60, 1.0)  # an address may guess so often at once (`nmes conform` does, 30 times), and so often a second
    COMMON = (200, 5.0)  # and all of them together
    ADDRESSES = 65_536  # that are remembered

    def __init__(self, part: float = 1.0) -> None:
        self._buckets: OrderedDict[str, Bucket] = OrderedDict()
        self._part = part
        self._common = Bucket(*(part * value for value in self.COMMON))

    def wait(self, address: str, now: float) -> float:
        """Returns for how long (s) a password from there is not looked at; 0 where it is."""
        own = self._buckets.get(address)
        if own is None or own.tokens(now) >= own.size:
            return 0.0
        return max(own.delay(now), self._common.delay(now))

    def wrong(self, address: str, now: float) -> None:
        """Counts a wrong password."""
        size, rate = self.ADDRESS
        own = self._buckets.setdefault(address, Bucket(max(1.0, self._part * size), self._part * rate))
        self._buckets.move_to_end(address)
        own.take(now)
        if self._common.tokens(now) >= 1.0:
            self._common.take(now)
        if len(self._buckets) > self.ADDRESSES:
            self._buckets.popitem(last=False)


def address_of(peername: object) -> str:
    """Returns whose a socket is: the address, or the network of an IPv6 address, of what it calls its peer."""
    name = str(peername[0]) if isinstance(peername, tuple) and peername else "?"
    try:
        address = ipaddress.ip_address(name.partition("%")[0])
    except ValueError:
        return name
    if isinstance(address, ipaddress.IPv6Address):
        if address.ipv4_mapped is not None:
            return str(address.ipv4_mapped)
        return str(ipaddress.ip_network((int(address) >> 64 << 64, 64)))
    return str(address)


def cannot_listen(host: str, port: int, error: Exception) -> MachineError:
    """Returns the error to raise where an address cannot be listened on, in the system's words for the reason."""
    number = error.errno if isinstance(error, OSError) and not isinstance(error, socket.gaierror) else None
    reason = os.strerror(number) if number else getattr(error, "strerror", None) or error  # asyncio adds the address
    return MachineError("cannot_listen", f"cannot listen on {host}:{port}: {reason}")


class Door:
    """Listens, lets sockets in, and knows those that have not authenticated.

    Attributes:
        guesses: The wrong passwords of late.
    """

    def __init__(self, most: int, tls: ssl.SSLContext | None, handshake_timeout: float, linger: float) -> None:
        """Makes a door that is closed.

        Args:
            most: How many may wait at it.
            tls: Holds the host's certificate; None: no TLS.
            handshake_timeout: How long a TLS handshake may take, s.
            linger: How long a TLS connection may take to end, s.
        """
        self.guesses = Guesses()
        self._most = most
        self._tls = tls
        self._handshake_timeout, self._linger = handshake_timeout, linger
        self._listeners: list[socket.socket] = []
        self._waiting: dict[Entrant, str] = {}  # in the order in which they came, with their addresses
        self._tasks: set[asyncio.Task[None]] = set()
        self._pauses: set[asyncio.TimerHandle] = set()
        self._silent_until = 0.0

    def __len__(self) -> int:
        return len(self._waiting)

    # -- who waits -------------------------------------------------------------------------------------------------

    def wait(self, entrant: Entrant, address: str) -> None:
        """Counts one in; it may put another one out."""
        self._waiting[entrant] = address
        if len(self._waiting) > self._most:
            counts: dict[str, int] = {}
            for each in self._waiting.values():
                counts[each] = counts.get(each, 0) + 1
            most = max(counts.values())
            oldest = next(one for one, each in self._waiting.items() if counts[each] == most)
            del self._waiting[oldest]
            oldest.abort()

    def forget(self, entrant: Entrant) -> None:
        """Counts one out: it is in, or gone."""
        self._waiting.pop(entrant, None)

    # -- sockets ---------------------------------------------------------------------------------------------------

    async def listen(self, host: str, port: int, protocol: Callable[[], asyncio.BaseProtocol]) -> tuple[str, int]:
        """Listens on an address, on all that a name stands for; returns the first and its port.

        Raises:
            MachineError: `cannot_listen`.
        """
        loop = asyncio.get_running_loop()
        bound: list[socket.socket] = []
        try:
            found = await loop.getaddrinfo(host or None, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
            for family, address in dict.fromkeys((entry[0], entry[4]) for entry in found):
                bound.append(socket.create_server(address[:2], family=family, backlog=BACKLOG))
        except (OSError, OverflowError, UnicodeError) as error:
            for listener in bound:
                listener.close()
            raise cannot_listen(host, port, error) from error
        for listener in bound:
            listener.setblocking(False)
            loop.add_reader(listener, self._accept, listener, protocol)
        self._listeners += bound
        name = bound[0].getsockname()
        return name[0], name[1]

    def _accept(self, listener: socket.socket, protocol: Callable[[], asyncio.BaseProtocol]) -> None:
        """Lets in those that have come; called when there are some."""
        for _ in range(AT_ONCE if self._tls is None else AT_ONCE_TLS):
            try:
                peer, address = listener.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                return
            except OSError as error:
                self._pause(listener, protocol, error)
                return
            peer.setblocking(False)
            try:
                # asyncio does this to sockets that it has made itself. Without it an event that follows a reply waits
                # for the other side to acknowledge the reply, which it does after 40 ms if it has nothing to say.
                peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            except OSError:  # some systems say so where it is gone already
                peer.close()
                continue
            task = asyncio.get_running_loop().create_task(self._open(peer, address_of(address), protocol))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    def _pause(self, listener: socket.socket, protocol: Callable[[], asyncio.BaseProtocol], error: OSError) -> None:
        """Accepts nobody for a while: the system has no more descriptors or memory for us."""
        loop = asyncio.get_running_loop()
        if monotonic() >= self._silent_until:
            self._silent_until = monotonic() + SILENCE
            logger.error("no connection can be accepted for now: %s; those who come wait", error.strerror)
        loop.remove_reader(listener)

        def again() -> None:
            self._pauses.discard(timer)
            loop.add_reader(listener, self._accept, listener, protocol)

        timer = loop.call_later(PAUSE, again)
        self._pauses.add(timer)

    async def _open(self, peer: socket.socket, address: str, protocol: Callable[[], asyncio.BaseProtocol]) -> None:
        """Makes a connection of a socket; a TLS handshake waits at the door like all that comes before a password."""
        handshake = _Handshake(asyncio.current_task())
        if self._tls is not None:
            self.wait(handshake, address)
        with contextlib.suppress(OSError, asyncio.CancelledError):  # ssl.SSLError is an OSError
            try:
                await asyncio.get_running_loop().connect_accepted_socket(
                    protocol,
                    peer,
                    ssl=self._tls,
                    ssl_handshake_timeout=self._handshake_timeout if self._tls else None,
                    ssl_shutdown_timeout=self._linger if self._tls else None,
                )
            finally:
                self.forget(handshake)

    async def close(self) -> None:
        """Listens no more. Those that were accepted before become connections, but for TLS handshakes."""
        loop = asyncio.get_running_loop()
        for timer in self._pauses:
            timer.cancel()
        self._pauses.clear()
        for listener in self._listeners:
            loop.remove_reader(listener)
            listener.close()
        self._listeners.clear()
        if self._tls is not None:
            for entrant in list(self._waiting):
                if isinstance(entrant, _Handshake):
                    entrant.abort()
        await asyncio.gather(*self._tasks, return_exceptions=True)


class _Handshake:
    """A TLS handshake."""

    def __init__(self, task: asyncio.Task[None] | None) -> None:
        self._task = task

    def abort(self) -> None:
        if self._task is not None:
            self._task.cancel()
