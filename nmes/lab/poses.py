"""Poses of what is watched: a world is looked at up to 60 times a second, once for all who watch it.

Hides when a world may be looked at (between its ticks, and not while it is in a thread), and what is left out for a
slow reader. Invariants: who watches changes nothing and holds up nobody; a frame is sent only after its scene.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Collection
from time import monotonic
from typing import Final

from starlette.websockets import WebSocket, WebSocketDisconnect

from nmes.errors import WorldError
from nmes.lab.scene import FORCES, food_text, force_text, frame_bytes, mind_text, scene_text
from nmes.server import Host
from nmes.server.hosted_world import HostedWorld
from nmes.world import World

__all__ = ["Reader", "Watchers", "send_until_gone"]

logger = logging.getLogger(__name__)

INTERVAL: Final = 1 / 60  # s between two looks
SCENES: Final = 0.1  # s between two scenes of a world whose cubes come and go
ACCOUNTS: Final = 0.1  # s between two accounts of food, of contacts, of motors, and of pushes
_PART: Final = 0.1  # of the time that scenes or accounts of a large world may take
PAUSE: Final = 10.0  # s after which a world that could not be looked at is looked at again
MOST: Final = 64  # that may watch at once
UNKNOWN_WORLD, TOO_MANY = 4404, 4429  # codes with which a WebSocket is closed


class Reader:
    """Somebody who watches. What he has not read when there is something newer is left out."""

    def __init__(self, wants: Collection[str] = (), mind: str | None = None) -> None:
        self.wants = wants  # kinds of texts that only those are told who ask for them
        self.mind = mind  # the creature whose brain he watches, instead of poses
        self._texts: dict[str, str] = {}  # by kind: of each the newest
        self._told: dict[str, str] = {}  # likewise
        self._frame: bytes | None = None
        self._news = asyncio.Event()
        self._over = False

    def end(self) -> None:
        """Has `send` come to its end: what was watched is no more."""
        self._over = True
        self._news.set()

    def tell(self, kind: str, text: str) -> None:
        """Replaces the text of that kind which is to be sent, unless it is the last that he was told."""
        if self._told.get(kind) == text:
            return
        self._texts[kind] = self._told[kind] = text
        if kind == "scene":
            self._frame = None
        self._news.set()

    def show(self, frame: bytes) -> None:
        """Replaces the frame that is to be sent, unless he watches a brain."""
        if self.mind is None:
            self._frame = frame
            self._news.set()

    async def send(self, websocket: WebSocket) -> None:
        """Sends what there is, until `end`, and closes the WebSocket then."""
        while True:
            await self._news.wait()
            if self._over:
                await websocket.close(UNKNOWN_WORLD, "world_not_found")
                return
            self._news.clear()
            texts, self._texts, frame, self._frame = self._texts, {}, self._frame, None
            for text in texts.values():
                await websocket.send_text(text)
            if frame is not None:
                await websocket.send_bytes(frame)


async def send_until_gone(websocket: WebSocket, reader: Reader) -> None:
    """Sends what a reader is to see until he hangs up; what he says is not minded."""

    async def listen() -> None:
        while (await websocket.receive())["type"] != "websocket.disconnect":
            pass

    tasks = [asyncio.create_task(listen()), asyncio.create_task(reader.send(websocket))]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        results = await asyncio.gather(*tasks, return_exceptions=True)
    for result in results:
        if isinstance(result, Exception) and not isinstance(result, WebSocketDisconnect):
            raise result


class Watchers:
    """All who watch the worlds of a host."""

    def __init__(self, host: Host) -> None:
        """Begins with nobody."""
        self._host = host
        self._watched: dict[str, _Watched] = {}

    async def serve(self, websocket: WebSocket) -> None:
        """Shows a world to whoever asks for it, until he hangs up."""
        await websocket.accept()
        try:
            name = self._host.world_name(websocket.query_params.get("world"))
        except WorldError as error:
            await websocket.close(UNKNOWN_WORLD, error.code)
            return
        if sum(len(watched.readers) for watched in self._watched.values()) >= MOST:
            await websocket.close(TOO_MANY, "too_many_watchers")
            return
        watched = self._watched.setdefault(name, _Watched(self._host, name))
        asked = websocket.query_params
        reader = Reader({kind for kind in FORCES if asked.get(kind) == "1"}, asked.get("mind"))
        watched.add(reader)
        try:
            await send_until_gone(websocket, reader)
        finally:
            watched.remove(reader)
            if not watched.readers and self._watched.get(name) is watched:
                del self._watched[name]


def _next(began: float, interval: float) -> float:
    """Returns when something is due again, so that of a large world it takes no more than a part of the time."""
    return began + max(interval, (monotonic() - began) / _PART)


class _Watched:
    """A world that is watched."""

    def __init__(self, host: Host, name: str) -> None:
        self.readers: dict[Reader, None] = {}
        self._host, self._name = host, name
        self._hosted: HostedWorld | None = None
        self._number = 0  # of the scene
        self._version = -1  # of the structure that it tells
        self._scene: str | None = None
        self._frame = b""
        self._food: str | None = None
        self._due = self._described = self._told = 0.0  # when there is more to look at, or to tell
        self._task: asyncio.Task[None] | None = None

    def add(self, reader: Reader) -> None:
        self.readers[reader] = None
        if self._scene is not None:
            reader.tell("scene", self._scene)
            self._feed(reader)
            reader.show(self._frame)
        if self._task is None:
            self._task = asyncio.create_task(self._watch())

    def _feed(self, reader: Reader) -> None:
        """Tells where food is, as far as is known, to whoever watches no brain."""
        if self._food is not None and reader.mind is None:
            reader.tell("food", self._food)

    def remove(self, reader: Reader) -> None:
        del self.readers[reader]
        if not self.readers and self._task is not None:
            self._task.cancel()
            self._attach(None)

    def _attach(self, hosted: HostedWorld | None) -> None:
        """Looks at another world, or none."""
        if self._hosted is not None:
            self._hosted.onlookers.pop(self._look, None)
        self._hosted, self._version = hosted, -1
        if hosted is not None:
            hosted.onlookers[self._look] = None

    async def _watch(self) -> None:
        """Looks again and again; a world that is mostly in a thread has `_look` called when it is back."""
        due = monotonic()
        while True:
            hosted = self._host.worlds.get(self._name)
            if hosted is not self._hosted:
                self._attach(hosted)
            try:
                self._host.world_name(self._name)
            except WorldError:  # it is closed
                for reader in self.readers:
                    reader.end()
                return
            self._look()
            due = max(due + INTERVAL, monotonic())
            await asyncio.sleep(due - monotonic())

    def _look(self) -> None:
        """Shows the world as it is now, unless it was looked at just before or cannot be looked at.

        It is called in the middle of what a host does: what fails here must not fail there.
        """
        hosted, now = self._hosted, monotonic()
        if hosted is None or not hosted.readable or now < self._due - INTERVAL / 8:
            return
        self._due = max(self._due + INTERVAL, now)
        try:
            self._tell(hosted.world, now)
        except Exception:
            logger.exception("world %r cannot be watched", self._name)
            self._due = now + PAUSE

    def _tell(self, world: World, now: float) -> None:
        if world.structure_version != self._version:
            if now < self._described:
                return
            self._version = world.structure_version
            self._number += 1
            self._scene, self._frame = scene_text(world, self._number), b""
            self._described = _next(now, SCENES)
            for reader in self.readers:
                reader.tell("scene", self._scene)
        frame = frame_bytes(world, self._number, world.frame)
        if frame[8:] != self._frame[8:] or not self._frame:
            self._frame = frame
            for reader in self.readers:
                reader.show(frame)
        if now >= self._told:
            self._tell_more(world)
            self._told = _next(now, ACCOUNTS)

    def _tell_more(self, world: World) -> None:
        """Tells where food is, where that is new, and forces and minds to those who asked for them."""
        self._food = food_text(world)
        for reader in self.readers:
            self._feed(reader)
        if world.fault is not None:
            return
        for kind in FORCES:
            curious = [reader for reader in self.readers if kind in reader.wants]
            if curious and (text := force_text(kind, world, self._number)) is not None:
                for reader in curious:
                    reader.tell(kind, text)
        for reader in self.readers:
            mind = None if reader.mind is None else mind_text(world, self._number, reader.mind)
            if mind is not None:
                reader.tell("mind", mind)
