"""The reception of a host: who is let in, which worlds there are, and who may create, close and list them.

Where worlds live is not its matter: a `Host` has them in its own process, and the supervisor of a fleet in others.

Invariant: nothing is served to who has not said a password, of which `Keys` knows what it opens.
"""

from __future__ import annotations

import asyncio
import logging
import ssl
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Coroutine, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from time import monotonic
from typing import Any, TypeVar

from nmes.errors import NmesError, RejectedMessage, WorldError
from nmes.protocol import Limits
from nmes.server.access_log import AccessLog
from nmes.server.catalog import DEFAULT, Catalog, Offer
from nmes.server.connection import LINGER, READ, Connection
from nmes.server.door import Door
from nmes.server.hosted_world import HostedWorld
from nmes.server.kept_worlds import note_closed
from nmes.server.keys import Keys
from nmes.server.probes import Probes

__all__ = ["Reception", "drain", "keep_on", "spawn"]

A = TypeVar("A")
T = TypeVar("T")

logger = logging.getLogger(__name__)


class Reception(ABC):
    """Lets clients in, and knows the worlds by name; what becomes of both is its subclass's matter."""

    def __init__(
        self,
        keys: Keys,
        *,
        catalog: Catalog | None = None,
        limits: Limits | None = None,
        auth_delay: float = 1.0,
        tls: ssl.SSLContext | None = None,
        access_log: AccessLog | None = None,
    ) -> None:
        """Makes one that listens nowhere yet; the arguments are those of a `Host`."""
        self.keys = keys
        self.access_log = access_log
        self.limits = limits or Limits()
        self.most_connections = self.limits.connections
        self.auth_delay = auth_delay
        self.buffer = memoryview(bytearray(READ))
        self.received = 0  # bytes
        self.sent = 0
        self._catalog = Catalog() if catalog is None else catalog
        self._kept: dict[str, Path] = {}  # the recordings from whose ends worlds go on that are not up yet
        self._ports: dict[str, int] = {}  # the port whose clients get a world without naming it
        self._door = Door(self.limits.unauthenticated, tls, self.limits.auth_timeout, LINGER)
        self.guesses = self._door.guesses
        self._reader = ThreadPoolExecutor(1, "nmes-reader")  # one: a frame is read without a pause for others
        self._opening: dict[str, asyncio.Task[NmesError | None]] = {}  # worlds that are brought up now
        self._waiting: dict[str, dict[Connection, None]] = {}  # and who waits for them
        self._makers: set[asyncio.Task[None]] = set()  # that create and close worlds
        self.probes = Probes(self.metrics_page, lambda: self.unready)
        self._running = False  # whether it has started
        self.draining = False  # whether it is about to end, and lets nobody in any more
        self._connections: set[Connection] = set()
        self._inside: set[Connection] = set()  # those that authenticated

    # -- worlds ----------------------------------------------------------------------------------------------------

    def offer(
        self,
        config: Mapping[str, Any],
        password: str | None = None,
        kept: Path | None = None,
        maker: str | None = None,
    ) -> str:
        """Hosts a world that is created when a client first joins it; returns its name.

        Args:
            config: Its config.
            password: What opens this world alone; None: only the host's does.
            kept: The recording of that config from whose end it goes on, without those who were in it; None: it is new.
            maker: Who created that over the wire, one of the host's makers; None: the host.

        Raises:
            RejectedMessage: The config is not valid. Whether its engine can do it is seen when the world is created.
            WorldError: There is a world of that name (`world_exists`), or as many as there may be (`limit_reached`).
        """
        offer = self._catalog.add(config, maker, new=kept is None)
        self.keys.add(offer.name, offer.config.get("roles", {}), password, maker)
        if kept is not None:
            self._kept[offer.name] = kept
        return offer.name

    def _forget(self, name: str) -> None:
        self._catalog.remove(name)
        self.keys.remove(name)
        self._ports.pop(name, None)

    def world_name(self, name: str | None) -> str:
        """Returns the name of one of the worlds: the first one's if it is None.

        Raises:
            WorldError: `world_not_found`.
        """
        if name is None:
            name = self._catalog.first
        if name is None or name not in self._catalog:
            raise WorldError("world_not_found", f"this host has no world {name!r}", "world")
        return name

    @abstractmethod
    def find(self, name: str, connection: Connection) -> HostedWorld | None:
        """Returns a world, or None where the connection has to wait, or is in other hands now.

        The connection's `resume` is called when the world is there; where it cannot be created, its `hang_up`.
        """

    def _wait_for(self, name: str, connection: Connection) -> None:
        """Has a connection resumed when a world is up."""
        self._waiting.setdefault(name, {})[connection] = None
        self._begin_opening(name)

    def _begin_opening(self, name: str) -> asyncio.Task[NmesError | None]:
        if name not in self._opening:
            self._opening[name] = asyncio.get_running_loop().create_task(self._open_for_all(name))
        return self._opening[name]

    async def open(self, name: str) -> NmesError | None:
        """Brings a world up; returns why it cannot be, or None."""
        return await asyncio.shield(self._begin_opening(name))

    async def _open_for_all(self, name: str) -> NmesError | None:
        """Brings a world up for those who wait for it, or tells them that it cannot be."""
        failure: NmesError | None = NmesError("internal", "the server failed; see its log")
        try:
            failure = await self._open(name)
        finally:
            del self._opening[name]
            for connection in self._waiting.pop(name, ()):
                if failure is None:
                    connection.resume()
                else:
                    connection.hang_up(failure)
        return failure

    @abstractmethod
    async def _open(self, name: str) -> NmesError | None:
        """Brings a world up that is not; returns why it cannot be, or None."""

    @abstractmethod
    async def _close(self, name: str) -> Path | None:
        """Closes a world that is forgotten already: its clients are told and hung up on, its recording is completed.

        Returns:
            The recording; None: there is none.
        """

    def create_world(self, asked: Mapping[str, Any], maker: str | None, connection: Connection) -> None:
        """Creates a world and hosts it.

        Args:
            asked: What `create` of an `auth` says.
            maker: Whose world it is; None: whoever has the host's password.
            connection: Who asked for it; it is shown that world then, or told why there is none.
        """
        name: str = asked["world"]
        try:
            config = self._catalog.config(name, asked.get("template", DEFAULT), asked.get("seed"))
            self.keys.add(name, self._catalog.add(config, maker).config.get("roles", {}), maker=maker)
        except (RejectedMessage, WorldError) as error:
            connection.hang_up(error)
            return
        opening = self._begin_opening(name)

        async def create() -> None:
            failure = await opening
            if failure is None:
                self.show_worlds(connection, {name: None})
            else:
                self._forget(name)
                connection.hang_up(failure)

        spawn(create(), self._makers)

    def close_world(self, name: str, maker: str | None, connection: Connection) -> None:
        """Closes a world for good: it stops, its clients are told and hung up on, its recording is completed.

        Args:
            name: The world's.
            maker: Who may close only what he created; None: whoever has the host's password.
            connection: Who asked for it; it is shown the others then, or told that there is no such world.
        """

        async def close() -> None:
            while name in self._opening:
                await asyncio.sleep(0.01)
            if name not in self._catalog or (maker is not None and self._catalog[name].maker != maker):
                whose = "" if maker is None else " that you have created"
                connection.hang_up(WorldError("world_not_found", f"this host has no world {name!r}{whose}", "close"))
                return
            self._forget(name)
            self._turn_away(name, WorldError("world_not_found", f"the world {name!r} is closed", "world"))
            recording = await self._close(name)
            if recording is not None:
                try:
                    await asyncio.to_thread(note_closed, recording)
                except OSError as error:
                    logger.error("a host that resumes %s will have world %r again: %s", recording, name, error)
            self.show_worlds(connection, None if maker is None else self.keys.made_by(maker))

        spawn(close(), self._makers)

    def _turn_away(self, name: str, error: NmesError) -> None:
        """Tells those who wait to join a world that they will not."""
        for connection in [each for each in self._inside if each.destination == name]:
            connection.hang_up(error)

    @abstractmethod
    def show_worlds(self, connection: Connection, only: Collection[str] | None, start: int = 0) -> None:
        """Answers a client with a page of the worlds, of all if not of some. Creates none.

        It is the page that begins with the world of number `start`, or the first one behind that.
        """

    def _world_list(
        self, port: int, page: Iterable[Offer], following: int | None, states: Mapping[str, Mapping[str, Any]]
    ) -> dict[str, Any]:
        """Returns the `world_list` message of a page, with the states of those of its worlds that are live."""
        listed = [
            {
                "world": offer.name,
                "port": self._ports.get(offer.name, port),
                "backend": offer.config["backend"],
                "mode": offer.config["mode"],
                "frame": None,
                "clients": 0,
                "fault": None,
                "asleep": False,
                "ratio": None,
                **states.get(offer.name, {}),
            }
            for offer in page
        ]
        return {"type": "world_list", "worlds": listed, "next": following}

    # -- connections -----------------------------------------------------------------------------------------------

    @property
    def connections(self) -> int:
        """The number of connections, those that are ending included."""
        return len(self._connections)

    def admit(self, connection: Connection, address: str) -> None:
        """Lets a connection from an address wait at the door, until it is let in."""
        self._connections.add(connection)
        self._door.wait(connection, address)

    @property
    def occupied(self) -> bool:
        """Whether somebody is in."""
        return bool(self._inside)

    @property
    def unready(self) -> str | None:
        """Why nobody new is let in, in a word: the host is `starting`, `draining` or `full`; None: somebody is."""
        if self.draining:
            return "draining"
        if not self._running:
            return "starting"
        return "full" if len(self._inside) >= self.most_connections else None

    def let_in(self, connection: Connection) -> None:
        """Counts a connection among those that have authenticated.

        Raises:
            RejectedMessage: The host is draining (`host_draining`) or full (`too_many_connections`).
        """
        if self.draining:
            raise RejectedMessage("host_draining", "this host is about to end and lets nobody in: come again later")
        if len(self._inside) >= self.most_connections:
            most = self.most_connections
            raise RejectedMessage("too_many_connections", f"this host serves {most} connections at once")
        self._door.forget(connection)
        self._inside.add(connection)

    def forget(self, connection: Connection) -> None:
        """Counts a connection out."""
        self._connections.discard(connection)
        self._inside.discard(connection)
        self._door.forget(connection)

    def read(self, reading: Callable[[A], T], what: A) -> Future[T]:
        """Has something long that a peer says read in a thread."""
        return self._reader.submit(reading, what)

    async def listen(self, host: str, port: int, world: str | None = None) -> tuple[str, int]:
        """Listens on an address.

        Args:
            host: The address or its name.
            port: The port; 0 finds a free one.
            world: The world of those clients that name none; None: the first one.

        Returns:
            The address and the port that it listens on.

        Raises:
            MachineError: `cannot_listen`: the address is taken, or not of this machine.
        """
        address, port = await self._door.listen(host, port, lambda: self._greet(world))
        default = world or self._catalog.first
        if default is not None:
            self._ports.setdefault(default, port)
        return address, port

    def _greet(self, world: str | None) -> Connection:
        """Makes the connection of a socket that comes in, to which `world` is served if it names none."""
        return Connection(self, world)

    @abstractmethod
    async def metrics_page(self) -> bytes:
        """Makes the page of metrics."""

    @abstractmethod
    async def announce(self, event: Mapping[str, Any]) -> None:
        """Sends subscribers in all worlds an event of the host."""

    async def _stop_listening(self) -> None:
        """Closes the listening sockets; clients that were accepted before become connections."""
        await self.probes.close()
        await self._door.close()

    async def _inspect(self) -> None:
        now = monotonic()
        _with_each(self._connections, lambda connection: connection.inspect(now))

    async def _hang_up_on_all(self) -> None:
        """Hangs up on all connections; returns when they are gone."""
        _with_each(self._connections, lambda connection: connection.hang_up())
        # Peers get a moment to hang up themselves, and those that still read get some more.
        began = monotonic()
        while self._connections and monotonic() - began < LINGER:
            if monotonic() - began > LINGER / 8:
                if not any(_with_each(self._connections, lambda connection: connection.draining)):
                    break
            await asyncio.sleep(0.01)
        _with_each(self._connections, lambda connection: connection.abort())
        began = monotonic()
        while self._connections and monotonic() - began < LINGER:
            await asyncio.sleep(0)
        _with_each(self._connections, _drop)
        self._reader.shutdown()


def _with_each(connections: Collection[Connection], do: Callable[[Connection], T]) -> list[T]:
    """Does something with each of the connections; returns what comes of it.

    Those with which it fails are cut off: they must not keep the host from the others, nor from its end.
    """
    done = []
    for connection in list(connections):
        try:
            done.append(do(connection))
        except Exception:
            logger.exception("a connection fails and is cut off")
            _drop(connection)
    return done


def _drop(connection: Connection) -> None:
    """Cuts a connection off and counts it out, also where its transport tells of no end any more."""
    try:
        connection.abort()
    except Exception:
        logger.exception("a connection cannot be cut off")
    connection.connection_lost(None)


async def drain(host: Reception, seconds: float) -> None:
    """Has a host let nobody new in, and tells subscribers; returns when all have left, or the seconds are over."""
    host.draining = True
    telling = asyncio.ensure_future(host.announce({"type": "host_draining", "seconds": seconds}))
    try:
        async with asyncio.timeout(seconds):
            while host.occupied:
                await asyncio.sleep(0.02)
    except TimeoutError:
        logger.info("clients are still there after %g s", seconds)
    finally:
        telling.cancel()


def keep_on(work: Callable[[], Coroutine[Any, Any, None]], rest: float) -> asyncio.Task[None]:
    """Has work done again and again, each time after a rest (s), until the task is cancelled.

    What goes wrong in it is logged, and it goes on: a host must not end with what it lacked for a moment.
    """

    async def go_on() -> None:
        while True:
            try:
                await work()
            except Exception:
                logger.exception("the host failed in what it does now and then, and tries again")
            await asyncio.sleep(rest)

    return asyncio.get_running_loop().create_task(go_on())


def spawn(work: Coroutine[Any, Any, None], among: set[asyncio.Task[None]]) -> None:
    """Has work done beside all else; it is among the tasks until it is over."""
    task = asyncio.get_running_loop().create_task(work)
    among.add(task)
    task.add_done_callback(among.discard)
