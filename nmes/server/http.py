"""The HTTP server of a host: who may ask it at all, how long a request may take, and how it ends.

It hides uvicorn, whose protocols are used without its server: sockets come in by the host's door, which counts them,
shakes hands where there is TLS, and puts out the oldest where too many wait; signals are left alone.

Invariants:

- A request that a foreign page makes is refused: its `Origin` must be the server's own address, or one that was named.
  Nor does a name that somebody lets point to this machine count as the server's own: `Host` must be an IP address,
  `localhost`, or a name that was given.
- A request is there within `Limits.auth_timeout`, and its head is no longer than `Limits.auth_frame`.
- What a stranger sends makes no traceback.
- Frames of a WebSocket are read in pieces of `PIECE`, the next once the application has taken those before: a read of
  256 KiB may be 40,000 frames, and nobody else has a turn while they are taken apart.
"""

from __future__ import annotations

import asyncio
import ipaddress
import logging
from collections.abc import Collection
from typing import Any, cast
from urllib.parse import urlsplit

import h11
from starlette.responses import JSONResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn import Config
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from uvicorn.server import ServerState
from websockets.http11 import Request

from nmes.protocol import Limits
from nmes.server.door import Door, address_of

__all__ = ["PIECE", "SOCKET", "HttpServer", "OwnPages", "refusal"]

logger = logging.getLogger(__name__)

SOCKET = "nmes.socket"  # the extension of a WebSocket's scope that is its socket, an `asyncio.Transport`
PIECE = 8 << 10  # bytes of frames that are taken apart at once
FIRST_PIECE = 512  # until there is a message: of empty frames, 85
PINGS = 50  # of a WebSocket in a second, or it is ended
KEEP_ALIVE = 15  # s: how long a connection may wait for its next request
GRACE = 0.5  # s: for which requests go on when the server closes


def refusal(status: int, code: str, message: str, path: str | None = None) -> Response:
    """Returns the answer to what is refused: an error as JSON."""
    return JSONResponse({"error": {"code": code, "message": message, "path": path}}, status)


class OwnPages:
    """Lets those requests through that a page of the server's own makes, or a program; see the module."""

    def __init__(self, app: ASGIApp, names: Collection[str] = (), origins: Collection[str] = ()) -> None:
        """Guards an application.

        Args:
            app: The application.
            names: Names of this machine, beside its addresses and `localhost`.
            origins: Further origins, as browsers write them: `https://lab.example.org`.
        """
        self._app = app
        self._origins = frozenset(origins)
        self._names = frozenset({"localhost", *names, *(str(urlsplit(origin).hostname) for origin in origins)})

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answers a request, or refuses it with 403."""
        headers = {name: value.decode("latin-1") for name, value in scope["headers"]}
        host, origin = headers.get(b"host", ""), headers.get(b"origin")
        if not self._is_own(host):
            reason = f"this server is not called {host!r}; name it when it is started"
            await refusal(403, "wrong_host", reason)(scope, receive, send)
        elif origin is not None and origin not in self._origins and origin != _origin(scope, host):
            await refusal(403, "wrong_origin", f"pages of {origin!r} may not ask this server")(scope, receive, send)
        else:
            await self._app(scope, receive, send)

    def _is_own(self, host: str) -> bool:
        try:
            name = urlsplit(f"//{host}").hostname or ""
            if name in self._names:
                return True
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True


def _origin(scope: Scope, host: str) -> str:
    """Returns the origin of the pages that a server gives out under that name."""
    return f"{'https' if scope['scheme'] in ('https', 'wss') else 'http'}://{host}"


class HttpServer:
    """Serves an application, over HTTP and WebSockets, to those whom a door lets in."""

    def __init__(self, app: ASGIApp, door: Door, limits: Limits) -> None:
        """Makes a server that does not listen yet."""
        self.door, self.limits = door, limits
        self.config = Config(
            _Logged(app),
            http=_Http,
            ws=_Socket,
            lifespan="off",
            log_config=None,
            log_level=logging.CRITICAL,  # all that it would log is the doing of strangers; `_Logged` tells the rest
            access_log=False,
            proxy_headers=False,
            server_header=False,
            date_header=False,
            timeout_keep_alive=KEEP_ALIVE,
            ws_max_size=limits.frame + (64 << 10),  # a little more: what is too long is told in words
            ws_per_message_deflate=False,
            ws_ping_interval=None,  # a world may be busy for longer than a pong may take
            h11_max_incomplete_event_size=limits.auth_frame,
        )
        self.config.load()
        self.state = ServerState()

    async def listen(self, host: str, port: int) -> tuple[str, int]:
        """Listens on an address; returns it and its port.

        Raises:
            MachineError: `cannot_listen`.
        """
        return await self.door.listen(host, port, lambda: _Http(self))

    async def close(self) -> None:
        """Ends all that still goes on; the door listens no more."""
        for connection in list(self.state.connections):
            connection.shutdown()
        until = asyncio.get_running_loop().time() + GRACE
        while (self.state.connections or self.state.tasks) and asyncio.get_running_loop().time() < until:
            await asyncio.sleep(0.01)
        for task in list(self.state.tasks):
            task.cancel()
        for connection in list(self.state.connections):
            connection.transport.abort()
        while self.state.connections or self.state.tasks:
            await asyncio.sleep(0)


class _Logged:
    """Logs what goes wrong in an application, in our words."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        begun = False

        async def sending(message: Message) -> None:
            nonlocal begun
            begun = True
            await send(message)

        try:
            await self._app(scope, receive, sending)
        except Exception:
            logger.exception("a request of %s failed", scope["path"])
            if not begun:
                await refusal(500, "internal", "the server failed; see its log")(scope, receive, send)


class _Http(H11Protocol):
    """One HTTP connection. It waits at the door, as all do who have not said a password, while it is one."""

    def __init__(self, server: HttpServer) -> None:
        super().__init__(server.config, server.state, {}, asyncio.get_running_loop())
        self._server = server
        self._deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._watch()
        self._server.door.wait(self, address_of(transport.get_extra_info("peername")))

    def connection_lost(self, exc: Exception | None) -> None:
        self._server.door.forget(self)
        self._unwatch()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        if self in self.connections and self.conn.their_state in (h11.IDLE, h11.SEND_BODY):  # else it is upgraded
            self._watch()
        else:
            self._unwatch()

    def send_400_response(self, msg: str) -> None:
        """Answers what is no HTTP, unless something is being answered: then the connection ends, and that with it."""
        if self.conn.our_state in (h11.IDLE, h11.SEND_RESPONSE):
            super().send_400_response(msg)
        else:
            self.abort()
        if self.cycle is not None:
            self.cycle.disconnected = True

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        self._server.door.forget(self)
        self._unwatch()
        super().handle_websocket_upgrade(event)

    def abort(self) -> None:
        """Ends it at once."""
        self.transport.abort()

    def _watch(self) -> None:
        """Ends the connection where its request is not there in time."""
        if self._deadline is None:
            self._deadline = self.loop.call_later(self._server.limits.auth_timeout, self.abort)

    def _unwatch(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None


class _Socket(WebSocketsSansIOProtocol):
    """One WebSocket, whose application may see its socket too, and which is read in pieces.

    What comes before the application has taken what came before waits, and nothing more is read then. By itself uvicorn
    stops reading after each message and begins again, which takes two calls of the system and as long as to parse it.
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._unread = bytearray()  # what came and waits for its turn; nothing more is read from the socket meanwhile
        self.read_paused = True  # as uvicorn takes it, who leaves reading alone then
        self._piece = FIRST_PIECE
        self._pings, self._counted_from = 0, 0.0

    def handle_connect(self, event: Request) -> None:
        super().handle_connect(event)
        if not self.handshake_complete:  # else it is refused, and no application hears of it
            extensions = cast(dict[str, Any], self.scope["extensions"])
            extensions[SOCKET] = self.transport

    def connection_lost(self, exc: Exception | None) -> None:
        self._unread.clear()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        if len(data) <= self._piece and not self._unread and self._wanted:
            super().data_received(data)
        else:
            self._unread += data
            self._read_on()

    async def receive(self) -> Any:
        message = await super().receive()
        self.read_paused = True
        if message["type"] == "websocket.receive":
            self._piece = PIECE
        if self._unread:
            self._read_on()
        return message

    def handle_ping(self) -> None:
        """Answers a ping; many of them end the connection: each is work for us and none for who is heard by nobody."""
        if (now := self.loop.time()) >= self._counted_from + 1.0:
            self._pings, self._counted_from = 0, now
        self._pings += 1
        if self._pings <= PINGS:
            super().handle_ping()
        else:
            self.transport.abort()

    @property
    def _wanted(self) -> bool:
        """Whether the application waits for more, or for nothing but the end, which is to be read then."""
        return self.queue.empty() or self.close_sent

    def _read_on(self) -> None:
        """Reads the next piece when others have had their turn; nothing else is read before all pieces are."""
        if self._unread:
            self.transport.pause_reading()
            if self._wanted:
                self.loop.call_soon(self._read_piece)
        else:
            self.transport.resume_reading()

    def _read_piece(self) -> None:
        piece = bytes(self._unread[: self._piece])
        del self._unread[: self._piece]
        if piece:
            super().data_received(piece)
            self._read_on()
