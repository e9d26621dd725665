"""HTTP for whoever watches a host: `/health`, `/ready` and `/metrics`, without a password.

It hides HTTP. Who asks is heard for a while only, and of those that keep a connection open there are never more than
`MOST`: one that comes over the limit ends the oldest, so a probe is always answered.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from http import HTTPStatus

from nmes.server.door import cannot_listen
from nmes.server.metrics import CONTENT_TYPE

__all__ = ["Probes"]

MOST = 64  # connections at once
LONGEST = 16 << 10  # bytes of a request's head
TIMEOUT = 10.0  # s: how long a request and its answer may take
TEXT = "text/plain; charset=utf-8"


class Probes:
    """Answers probes of a host, from `listen` to `close`."""

    def __init__(self, page: Callable[[], Awaitable[bytes]], unready: Callable[[], str | None]) -> None:
        """Makes probes that listen nowhere yet.

        Args:
            page: Makes the page of metrics.
            unready: Tells in a word why nobody new is let in; None: somebody is.
        """
        self._page, self._unready = page, unready
        self._servers: list[asyncio.Server] = []
        self._callers: dict[asyncio.StreamWriter, None] = {}  # in the order in which they came

    async def listen(self, host: str, port: int) -> int:
        """Listens on an address; returns the port, which is found where 0 is given.

        Raises:
            MachineError: `cannot_listen`.
        """
        try:
            server = await asyncio.start_server(self._serve, host, port, limit=LONGEST)
        except (OSError, OverflowError, UnicodeError) as error:
            raise cannot_listen(host, port, error) from error
        self._servers.append(server)
        return int(server.sockets[0].getsockname()[1])

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answers one request, and hangs up."""
        self._callers[writer] = None
        staying = [caller for caller in self._callers if not caller.transport.is_closing()]
        if len(staying) > MOST:
            staying[0].transport.abort()
        with contextlib.suppress(OSError, EOFError, TimeoutError, asyncio.LimitOverrunError):
            async with asyncio.timeout(TIMEOUT):
                head = await reader.readuntil(b"\r\n\r\n")
                writer.write(await self._answer(head))
                await writer.drain()
        del self._callers[writer]
        writer.close()

    async def _answer(self, head: bytes) -> bytes:
        """Returns the response to a request."""
        words = head.split(b"\r\n", 1)[0].split(b" ")
        if len(words) != 3 or not words[2].startswith(b"HTTP/1."):
            return _response(HTTPStatus.BAD_REQUEST, b"this is not HTTP/1.1\n")
        method, target, _ = words
        if method not in (b"GET", b"HEAD"):
            return _response(HTTPStatus.METHOD_NOT_ALLOWED, b"only GET and HEAD\n", more="Allow: GET, HEAD\r\n")
        status, kind, body = await self._look_up(target.partition(b"?")[0])
        return _response(status, body, kind, bare=method == b"HEAD")

    async def _look_up(self, path: bytes) -> tuple[HTTPStatus, str, bytes]:
        """Returns the status, the media type and the content of a path."""
        if path in (b"/", b"/metrics"):
            return HTTPStatus.OK, CONTENT_TYPE, await self._page()
        if path == b"/health":
            return HTTPStatus.OK, TEXT, b"alive\n"
        if path == b"/ready":
            reason = self._unready()
            status = HTTPStatus.OK if reason is None else HTTPStatus.SERVICE_UNAVAILABLE
            return status, TEXT, f"{reason or 'ready'}\n".encode()
        return HTTPStatus.NOT_FOUND, TEXT, b"there are /health, /ready and /metrics\n"

    async def close(self) -> None:
        """Listens no more, and ends the connections that are left."""
        loop = asyncio.get_running_loop()
        for server in self._servers:
            for listener in server.sockets:
                with contextlib.suppress(NotImplementedError):  # a loop that waits for completions has no readers
                    loop.remove_reader(listener)
        # asyncio needs two turns to make a connection of an accepted socket. Closing the server before that leaves the
        # socket open, with nobody to close it.
        for _ in range(2):
            await asyncio.sleep(0)
        for server in self._servers:
            server.close()
        for caller in self._callers:
            caller.transport.abort()
        while self._callers:
            await asyncio.sleep(0.01)


def _response(status: HTTPStatus, body: bytes, kind: str = TEXT, *, bare: bool = False, more: str = "") -> bytes:
    """Returns a response; a bare one has the head alone."""
    head = f"HTTP/1.1 {status.value} {status.phrase}\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\n{more}"
    return f"{head}Connection: close\r\n\r\n".encode() + (b"" if bare else body)
