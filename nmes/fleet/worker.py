"""A worker: a process that hosts the worlds it is given, for clients that are handed to it, or come to its own port.

It hides how orders and connections reach a `Host`. Invariants: it has a world from the order to host it until the order
to give it away is answered, and no other process has it meanwhile; when its supervisor is gone, it completes the
recordings and ends.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import signal
import socket
import ssl
import sys
from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from nmes.backend import load_backend
from nmes.backend.fingerprint import fingerprint
from nmes.errors import BackendNotFound, NmesError, RejectedMessage, WorldError
from nmes.fleet.control import Line, Message
from nmes.server import Host
from nmes.server.access_log import AccessLog
from nmes.server.catalog import Catalog
from nmes.server.connection import READ, Connection
from nmes.server.door import Guesses
from nmes.server.keys import Keys
from nmes.server.metrics import Metrics

__all__ = ["moved", "work"]

logger = logging.getLogger(__name__)

REPORT = 0.5  # s: how often it tells which worlds are awake
MOST = 1 << 30  # worlds: it is the supervisor that counts them


def moved(name: str) -> WorldError:
    """Returns the error for clients of a world that goes on in another process."""
    return WorldError("world_moved", f"the world {name!r} goes on in another process of this host: connect again")


async def work(end: socket.socket) -> None:
    """Works until the supervisor at the other end of the line says that it is over, or is gone."""
    await _Worker(end).run()


class _Guest(Connection):
    """A connection that the supervisor has let in, and handed over with all that it had read."""

    def __init__(self, host: Host, take: Message, left: Callable[[], None]) -> None:
        super().__init__(host, take.body["world"], tuple(take.body["peer"]))
        self._said = take.data
        self._left = left

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Hears what was said to the supervisor, before all else."""
        super().connection_made(transport)
        said, self._said = self._said, b""
        for start in range(0, len(said), READ):
            part = said[start : start + READ]
            self._host.buffer[: len(part)] = part
            self.buffer_updated(len(part))

    def hang_up(self, error: NmesError | None = None) -> None:
        """Tells a client whose world was given away while it was handed over that it is elsewhere: the host has it."""
        if error is not None and error.code == "world_not_found" and self._default_world is not None:
            error = moved(self._default_world)
        super().hang_up(error)

    def connection_lost(self, error: Exception | None) -> None:
        """Tells the supervisor, who has the socket too: only then it is closed."""
        super().connection_lost(error)
        self._left()

    def _wrong_password(self, right: bool) -> RejectedMessage | None:
        return None if right else super()._wrong_password(right)  # the supervisor has counted guesses already


class _WorkerHost(Host):
    """A host whose own port is for entering worlds: which there are is the supervisor's matter."""

    def create_world(self, asked: Mapping[str, Any], maker: str | None, connection: Connection) -> None:
        """Refuses to create a world."""
        connection.hang_up(_elsewhere("create"))

    def close_world(self, name: str, maker: str | None, connection: Connection) -> None:
        """Refuses to close a world."""
        connection.hang_up(_elsewhere("close"))

    def take(self, name: str, keys: Mapping[str, Any], config: Mapping[str, Any], maker: str | None) -> None:
        """Offers a world that the supervisor has let in."""
        self._catalog.add(config, maker, new=False)
        self.keys.take_world(name, keys)

    def forget_world(self, name: str) -> None:
        """Offers a world no more that could not be brought up."""
        self._forget(name)

    async def close_one(self, name: str) -> None:
        """Closes a world for good."""
        while name in self._opening:
            await asyncio.sleep(0.01)
        if name in self._catalog:
            self._forget(name)
            await self._close(name)

    async def listen_no_more(self) -> None:
        """Closes its port."""
        await self._stop_listening()


def _warm(engines: list[str]) -> None:
    """Loads engines, and what recordings tell of them, before somebody waits for it."""
    for name in engines:
        with contextlib.suppress(BackendNotFound):  # it is said when a world is to be made with it
            fingerprint(load_backend(name))


def _elsewhere(verb: str) -> WorldError:
    return WorldError(
        "unsupported", f"this is the port of a worker, which cannot {verb} worlds: ask the host's own", verb
    )


class _Worker:
    def __init__(self, end: socket.socket) -> None:
        self._over = asyncio.Event()
        self._ending: asyncio.Task[None] | None = None
        self._orders: dict[str, Callable[[Message], Awaitable[None]]] = {
            "begin": self._begin,
            "host": self._host_world,
            "release": self._release,
            "close_world": self._close_world,
            "states": self._states,
            "metrics": self._metrics,
            "announce": self._announce,
            "close": self._close,
        }
        self._tasks: set[asyncio.Task[None]] = set()
        self._line = Line(end, self._hear, self._over.set)
        self._host: _WorkerHost

    async def run(self) -> None:
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGHUP):  # of the terminal: they are meant for the supervisor
            loop.add_signal_handler(number, lambda: None)
        loop.add_signal_handler(signal.SIGTERM, self._drain)
        reporting = loop.create_task(self._report())
        await self._over.wait()
        reporting.cancel()
        if hasattr(self, "_host"):
            await self._end()
            if self._host.abandoned:  # else Python waits at its end for the thread, until the engine is done
                sys.stderr.flush()
                os._exit(0)

    def _hear(self, message: Message) -> None:
        if self._ending is not None and message.body["order"] != "close":
            message.discard()
        elif message.body["order"] == "take":
            self._spawn(self._take(message))
        else:
            self._spawn(self._obey(message))

    def _spawn(self, work: Any) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _obey(self, message: Message) -> None:
        try:
            await self._orders[message.body["order"]](message)
        except NmesError as error:
            self._line.answer(message, error=error.message, code=error.code)
        except Exception:
            logger.exception("an order could not be followed: %s", message.body["order"])
            self._line.answer(message, error="a worker failed; see its log", code="internal")

    # -- orders ----------------------------------------------------------------------------------------------------

    async def _begin(self, message: Message) -> None:
        about = message.body
        tls = None
        if about["tls"] is not None:
            tls = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
            certificate, key = about["tls"]
            tls.load_cert_chain(certificate, key, password="")
        self._host = _WorkerHost(
            Keys.of(about["keys"]),
            catalog=Catalog(most=MOST),
            hibernate_after=about["hibernate_after"],
            record_to=Path(about["record_to"]),
            flush_interval=about["flush_interval"],
            tls=tls,
            metrics=Metrics() if about["metrics"] else None,
            access_log=None if about["access_log"] is None else AccessLog(Path(about["access_log"])),
        )
        self._host.guesses = Guesses(about["guesses"])
        await asyncio.to_thread(_warm, about["engines"])
        _, port = await self._host.listen(about["address"], 0)
        self._line.answer(message, port=port)

    async def _host_world(self, message: Message) -> None:
        """Hosts a world: a new one, or one that goes on from where a recording ends."""
        name, path = message.body["world"], message.body["recording"]
        self._host.take(name, message.body["keys"], message.body["config"], message.body["maker"])
        failure = await (self._host.open(name) if path is None else self._host.bring(name, Path(path)))
        if failure is not None:
            self._host.forget_world(name)
            raise failure
        self._line.answer(message, recording=str(self._host.worlds[name].recording))

    async def _release(self, message: Message) -> None:
        name = message.body["world"]
        await self._host.release(name, moved(name))
        self._line.answer(message)

    async def _close_world(self, message: Message) -> None:
        await self._host.close_one(message.body["world"])
        self._line.answer(message)

    async def _states(self, message: Message) -> None:
        self._line.answer(message, states=self._host.states(message.body["worlds"]))

    async def _metrics(self, message: Message) -> None:
        self._line.answer(message, data=await self._host.metrics_page())

    async def _announce(self, message: Message) -> None:
        self._host.draining = message.body["draining"]
        await self._host.announce(message.body["event"])
        self._line.answer(message)

    async def _end(self) -> None:
        """Closes the host, once, when what was asked before is done; what is asked from now on is not."""

        async def end(orders: set[asyncio.Task[None]]) -> None:
            await asyncio.gather(*orders, return_exceptions=True)
            await self._host.close()

        if self._ending is None:
            self._ending = asyncio.get_running_loop().create_task(end(self._tasks - {asyncio.current_task()}))
        await asyncio.shield(self._ending)

    async def _close(self, message: Message) -> None:
        await self._end()
        ended = (*self._host.worlds.values(), *self._host.closed)
        lost = [[hosted.name, hosted.lost] for hosted in ended if hosted.lost is not None]
        self._line.answer(message, lost=lost)
        await self._line.drained()
        self._over.set()

    # -- connections -----------------------------------------------------------------------------------------------

    async def _take(self, message: Message) -> None:
        """Goes on with a connection that is handed over."""
        left = partial(self._line.tell, "left", number=message.body["number"])
        if message.socket is None:
            logger.error("a connection could not be taken over: this process has as many open files as it may")
            left()
            return
        message.socket.setblocking(False)
        try:
            guest = partial(_Guest, self._host, message, left)
            await asyncio.get_running_loop().connect_accepted_socket(guest, message.socket)
        except OSError:  # the peer is gone
            left()

    # -- by itself -------------------------------------------------------------------------------------------------

    async def _report(self) -> None:
        """Tells now and then which worlds take time, and how many clients are in each."""
        while True:
            await asyncio.sleep(REPORT)
            if hasattr(self, "_host"):
                self._line.tell("awake", worlds=self._host.awake)

    def _drain(self) -> None:
        """Has the supervisor give its worlds to other workers: it was told to end."""

        async def drain() -> None:
            if hasattr(self, "_host"):
                await self._host.listen_no_more()
            self._line.tell("drain")

        self._spawn(drain())
