"""WebSockets as connections of a host: each text frame is a message of the protocol, in both directions.

It hides from a `Connection` that its transport is no socket. All that it does with one, passwords, limits, recording,
order, back-pressure, the end, it does here too.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Collection
from time import monotonic
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect

from nmes.errors import RejectedMessage
from nmes.protocol import DELIMITER, encode
from nmes.schemas.documents import parse_json
from nmes.server.connection import LINGER, Connection
from nmes.server.host import Host
from nmes.server.http import SOCKET, OwnPages
from nmes.server.threads import SLICE

__all__ = ["Carrier", "carry", "health", "worlds_application"]

NO_TEXT = 1003  # the code of a WebSocket that is closed since it sent what is no text


def worlds_application(host: Host, names: Collection[str], origins: Collection[str]) -> ASGIApp:
    """Returns the application that serves a host's worlds at `/ws`, and `/health`.

    Args:
        host: The host.
        names: What this machine is called.
        origins: Whose pages may connect, beside its own.
    """

    async def connect(websocket: WebSocket) -> None:
        await carry(host, websocket)

    return OwnPages(Starlette(routes=[Route("/health", health), WebSocketRoute("/ws", connect)]), names, origins)


async def health(_: Request) -> JSONResponse:
    """Tells that the server runs."""
    return JSONResponse({"status": "ok"})


async def carry(host: Host, websocket: WebSocket, password: str | None = None) -> None:
    """Serves a WebSocket as a connection of a host, until it has ended.

    Args:
        host: The host.
        websocket: The WebSocket, which is not accepted yet.
        password: What stands for the password where `auth` has none; None: nothing does.
    """
    await websocket.accept()
    await Carrier(websocket, Connection(host, None), password).run()


class Carrier(asyncio.Transport):
    """What a connection takes for its socket.

    One that translates overrides `hear` and `tell`.
    """

    def __init__(self, websocket: WebSocket, connection: Connection, password: str | None = None) -> None:
        super().__init__()
        self._websocket = websocket
        self._socket: asyncio.Transport = websocket.scope["extensions"][SOCKET]
        self._protocol: asyncio.BaseProtocol = connection
        self._password = password
        self._queue: deque[bytes] = deque()  # messages to be sent
        self._size = 0  # of them, bytes
        self._most = 64 << 10  # bytes that may wait before the connection is told to pause
        self._paused = False  # it was told to
        self._held = False  # it asked for nothing to be read
        self._closing = False
        self._code = 1000
        self._more = asyncio.Event()  # something is to be sent, or it is to be closed
        self._reads = asyncio.Event()
        self._reads.set()

    async def run(self) -> None:
        """Carries messages until the WebSocket is closed."""
        connection = self._protocol
        assert isinstance(connection, Connection)
        connection.connection_made(self)
        self.begin()
        tasks = [asyncio.create_task(self._send()), asyncio.create_task(self._receive(connection))]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._closing = True
            for task in tasks:
                task.cancel()
            results = await asyncio.gather(*tasks, return_exceptions=True)
            connection.connection_lost(None)
            asyncio.get_running_loop().call_later(LINGER, self._socket.abort)  # unless the peer hangs up before
        for result in results:
            if isinstance(result, Exception) and not isinstance(result, WebSocketDisconnect):
                raise result

    async def _receive(self, connection: Connection) -> None:
        """Hands messages to the connection, while it reads, until the peer hangs up.

        To the connection each is a read of its own; so it cannot tell that it has kept the others waiting for a slice.
        """
        until = monotonic() + SLICE
        while True:
            if not self._reads.is_set():
                await self._reads.wait()
            if monotonic() >= until:
                await asyncio.sleep(0)
                until = monotonic() + SLICE
            message = await self._websocket.receive()
            if message["type"] == "websocket.disconnect":
                return
            text = message.get("text")
            if text is None:
                self._code = NO_TEXT
                connection.hang_up(RejectedMessage("bad_frame", "a message is a text frame of the WebSocket"))
            else:
                await self.hear(text)

    def begin(self) -> None:
        """Is called before anything is read."""

    async def hear(self, text: str) -> None:
        """Takes in what the peer says; he is read no further before that is done."""
        self.feed(self._with_password(text).encode())

    def tell(self, frame: bytes) -> None:
        """Takes in what the connection says, a message."""
        self.say(frame)

    def feed(self, message: bytes) -> None:
        """Hands the connection a message."""
        connection, data = self._protocol, message + DELIMITER
        assert isinstance(connection, Connection)
        begin = 0
        while begin < len(data):
            room = connection.get_buffer(-1)
            piece = data[begin : begin + len(room)]
            room[: len(piece)] = piece
            connection.buffer_updated(len(piece))
            begin += len(piece)

    def _with_password(self, text: str) -> str:
        """Returns a message, the first one with the password where there is one for it and it has none."""
        password, self._password = self._password, None
        if password is None:
            return text
        try:
            message = parse_json(text.encode())
        except RejectedMessage:  # which its connection tells
            return text
        if not isinstance(message, dict) or message.get("type") != "auth" or message.get("password"):
            return text
        return encode({**message, "password": password}).decode()

    async def _send(self) -> None:
        """Sends what is queued, until that is all and there will be no more."""
        while True:
            while self._queue:
                frame = self._queue.popleft()
                await self._websocket.send({"type": "websocket.send", "text": frame.decode()})
                self._size -= len(frame)
                if self._paused and self._size <= self._most // 4:
                    self._paused = False
                    self._protocol.resume_writing()
                    self._read_or_wait()
            if self._closing:
                await self._websocket.close(self._code)
                return
            self._more.clear()
            await self._more.wait()

    # -- what a connection asks of a socket ------------------------------------------------------------------------

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        """Returns information about the socket beneath."""
        return self._socket.get_extra_info(name, default)

    def set_protocol(self, protocol: asyncio.BaseProtocol) -> None:
        """Replaces the connection."""
        self._protocol = protocol

    def get_protocol(self) -> asyncio.BaseProtocol:
        """Returns the connection."""
        return self._protocol

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        """Sets how much (bytes) may wait before the connection is told to pause."""
        if high is not None:
            self._most = high

    def get_write_buffer_size(self) -> int:
        """Returns how much (bytes) the peer has not been sent yet."""
        return self._size + self._socket.get_write_buffer_size()

    def write(self, data: Any) -> None:
        """Sends whole messages, each with its delimiter."""
        for frame in bytes(data).split(DELIMITER)[:-1]:
            self.tell(frame)

    def say(self, frame: bytes) -> None:
        """Sends the peer a text frame."""
        self._queue.append(frame)
        self._size += len(frame)
        self._more.set()
        if self._size > self._most and not self._paused:
            self._paused = True
            self._protocol.pause_writing()
            self._read_or_wait()

    def _read_or_wait(self) -> None:
        """Reads on unless the connection asked for a pause, or the peer does not read himself."""
        if self._held or self._paused:
            self._reads.clear()
        else:
            self._reads.set()

    def can_write_eof(self) -> bool:
        """Tells that one side alone cannot be closed."""
        return False

    def pause_reading(self) -> None:
        """Reads nothing more for now."""
        self._held = True
        self._read_or_wait()

    def resume_reading(self) -> None:
        """Reads on."""
        self._held = False
        self._read_or_wait()

    def is_closing(self) -> bool:
        """Whether it is to be closed."""
        return self._closing

    def close(self) -> None:
        """Closes it when all that is queued was sent."""
        self._closing = True
        self._more.set()

    def abort(self) -> None:
        """Ends it at once."""
        self._socket.abort()
        self._reads.set()  # whereupon its end is read
