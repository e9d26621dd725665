"""Agones: its sidecar is told how a host is, by the REST interface of the SDK for game servers.

It hides HTTP and what is told when: `health` every few seconds; the counter `rooms`, whose count is the number of
worlds and whose capacity how many there may be; `ready` once; `allocate` when the first client comes; `shutdown` at the
end. A sidecar that does not answer is tried again, and no world minds.

What is told is the state of the host, and no difference to what was told before. So nothing is counted twice where an
answer was lost, nor where whoever allocates has already counted the room that a client is about to open.
"""

from __future__ import annotations

import asyncio
import http.client
import json
import logging
from collections.abc import Callable, Mapping
from time import monotonic
from types import TracebackType
from typing import Any, Final, Self

__all__ = ["PORT", "VARIABLE", "Sidecar"]

logger = logging.getLogger(__name__)

VARIABLE: Final = "AGONES_SDK_HTTP_PORT"
"""The variable in which Agones tells a game server the port of its sidecar."""
PORT: Final = 9358
"""The port where the variable says none."""

HEALTH = 2.0  # s: how often it is told that the host lives
AGAIN = 1.0  # s: after which what failed is told again
LOOK = 0.2  # s: how often it is looked for changes
TIMEOUT = 2.0  # s: how long an answer may take
LONGEST = 64 << 10  # bytes that are read of one


class Sidecar:
    """Tells a sidecar how a host is, from the beginning of an `async with` to its end."""

    def __init__(self, port: int, rooms: Callable[[], int], most: int, occupied: Callable[[], bool]) -> None:
        """Tells nothing yet.

        Args:
            port: The sidecar's, on this machine.
            rooms: Counts the worlds.
            most: How many there may be.
            occupied: Tells whether a client is in.
        """
        self._port = port
        self._rooms, self._most, self._occupied = rooms, most, occupied
        self._failing = False
        self._retry: dict[str, float] = {}  # when what failed is tried again, by path
        self._task: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Self:
        self._task = asyncio.create_task(self._watch())
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._task is not None
        self._task.cancel()
        await asyncio.wait([self._task])
        self._retry.clear()
        await self._tell("POST", "/shutdown")

    async def _watch(self) -> None:
        """Tells what has changed, in the order in which it matters."""
        beat, rooms, ready, allocated = 0.0, -1, False, False
        while True:
            if (now := monotonic()) >= beat:
                beat = now + HEALTH
                await self._tell("POST", "/health")
            count = self._rooms()
            if count != rooms:
                counter = {"count": str(count), "capacity": str(self._most)}  # int64 is a string in JSON of protobuf
                if await self._tell("PATCH", "/v1beta1/counters/rooms", counter):
                    rooms = count
            ready = ready or await self._tell("POST", "/ready")
            if ready and not allocated and self._occupied():
                allocated = await self._tell("POST", "/allocate")
            await asyncio.sleep(LOOK)

    async def _tell(self, method: str, path: str, body: Mapping[str, Any] | None = None) -> bool:
        """Tells the sidecar something; returns whether it has taken it. What failed is put off for a while."""
        if monotonic() < self._retry.get(path, 0.0):
            return False
        failure = await asyncio.to_thread(self._request, method, path, json.dumps(body or {}))
        if failure is None:
            self._retry.pop(path, None)
            if self._failing and not self._retry:
                self._failing = False
                logger.info("the sidecar of Agones at port %d answers again", self._port)
            return True
        self._retry[path] = monotonic() + AGAIN
        if not self._failing:
            self._failing = True
            logger.warning(
                "the sidecar of Agones does not take %s %s at port %d: %s; it is tried again, and worlds go on",
                *(method, path, self._port, failure),
            )
        return False

    def _request(self, method: str, path: str, body: str) -> str | None:
        """Makes a request; returns why it failed, or None. Called in a thread."""
        connection = http.client.HTTPConnection("localhost", self._port, timeout=TIMEOUT)
        try:
            connection.request(method, path, body, {"Content-Type": "application/json"})
            answer = connection.getresponse()
            text = answer.read(LONGEST)
        except (OSError, http.client.HTTPException) as error:
            return str(error) or type(error).__name__
        finally:
            connection.close()
        return None if answer.status == 200 else f"status {answer.status}: {text[:200]!r}"
