"""WebSockets as browsers and programs open them, and bare HTTP, to a host within a test."""

from __future__ import annotations

import http.client
import json
import ssl
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from nmes.server.websocket import worlds_application
from servers import PASSWORD, PATIENCE, Served

__all__ = ["Socket", "doors", "get", "socket_to", "web_port"]


class Socket:
    """A WebSocket that speaks the protocol."""

    def __init__(self, connection: ClientConnection) -> None:
        self.connection = connection

    def say(self, *messages: Mapping[str, Any] | str | bytes) -> None:
        for message in messages:
            self.connection.send(message if isinstance(message, str | bytes) else json.dumps(message))

    def hear(self) -> Any:
        """Returns the next message: a text parsed where it is an object, else as it is; so a binary one."""
        message = self.connection.recv(PATIENCE)
        return json.loads(message) if isinstance(message, str) and message.startswith("{") else message

    def ask(self, message: Mapping[str, Any]) -> Any:
        self.say(message)
        return self.hear()

    def enter(self, **fields: Any) -> Any:
        return self.ask({"type": "auth", "password": PASSWORD, **fields})

    def rest(self) -> tuple[list[Any], int | None]:
        """Returns all messages until the server closes, and the code with which it does."""
        messages = []
        try:
            while True:
                messages.append(self.hear())
        except ConnectionClosed as closed:
            return messages, None if closed.rcvd is None else closed.rcvd.code


@contextmanager
def socket_to(port: int, path: str = "/ws", **options: Any) -> Iterator[Socket]:
    """Opens a WebSocket without TLS to a port of this machine."""
    with connect(f"ws://127.0.0.1:{port}{path}", open_timeout=PATIENCE, close_timeout=1, **options) as connection:
        yield Socket(connection)


def web_port(server: Served, *origins: str) -> int:
    """Has a host serve its worlds over WebSockets too; returns the port."""
    application = worlds_application(server.host, ["127.0.0.1"], origins)
    return server.run(server.host.serve_http("127.0.0.1", 0, application))[1]


def get(
    port: int,
    path: str,
    method: str = "GET",
    body: bytes | None = None,
    tls: ssl.SSLContext | None = None,
    **headers: str,
) -> tuple[int, dict[str, str], bytes]:
    """Asks once over HTTP, under the name that the header `Host` says; returns status, headers and body."""
    connection = (
        http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE)
        if tls is None
        else http.client.HTTPSConnection("127.0.0.1", port, timeout=PATIENCE, context=tls)
    )
    try:
        connection.putrequest(method, path, skip_host="Host" in headers)
        for name, value in headers.items():
            connection.putheader(name.replace("_", "-"), value)
        if body is not None:
            connection.putheader("Content-Length", str(len(body)))
        connection.endheaders(body)
        response = connection.getresponse()
        return response.status, {name.lower(): value for name, value in response.getheaders()}, response.read()
    finally:
        connection.close()


def doors(port: int) -> dict[str, str]:
    """Returns the origins that a server on a port must let in, and must not, with which is which."""
    return {
        f"http://127.0.0.1:{port}": "own",
        f"http://127.0.0.1:{port + 1}": "foreign",
        "http://127.0.0.1": "foreign",
        f"https://127.0.0.1:{port}": "foreign",
        "http://evil.example": "foreign",
        f"http://127.0.0.1:{port}.evil.example": "foreign",
        "null": "foreign",
    }
