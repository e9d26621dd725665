"""The page of metrics, served over HTTP: whatever is asked, this is the answer."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable

from nmes.server.door import cannot_listen
from nmes.server.metrics import CONTENT_TYPE

__all__ = ["MetricsPage"]


class MetricsPage:
    """Listens on ports, and answers without a password.

    Args:
        make: Makes the page.
        timeout: How long a request may take, s.
    """

    def __init__(self, make: Callable[[], Awaitable[bytes]], timeout: float) -> None:
        self._make = make
        self._timeout = timeout
        self._servers: list[asyncio.Server] = []

    async def listen(self, host: str, port: int) -> int:
        """Listens on an address; returns the port.

        Raises:
            MachineError: `cannot_listen`: the address is taken, or not of this machine.
        """
        try:
            server = await asyncio.start_server(self._answer, host, port)
        except OSError as error:
            raise cannot_listen(host, port, error) from error
        self._servers.append(server)
        return int(server.sockets[0].getsockname()[1])

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError, EOFError, TimeoutError, asyncio.LimitOverrunError):
            async with asyncio.timeout(self._timeout):
                await reader.readuntil(b"\r\n\r\n")
                page = await self._make()
                head = f"HTTP/1.1 200 OK\r\nContent-Type: {CONTENT_TYPE}\r\nContent-Length: {len(page)}"
                writer.write(f"{head}\r\nConnection: close\r\n\r\n".encode() + page)
                await writer.drain()
        writer.close()

    async def close(self) -> None:
        """Listens no more; those that were accepted before are connections then."""
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
