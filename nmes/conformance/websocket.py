"""A WebSocket in place of a socket, for a `Wire`: each of its text frames is a message, in both directions.

It hides the library. Invariant: no call waits for longer than the time-out that was set, whatever the server sends
meanwhile that is no message. What a stream of bytes can do and a WebSocket cannot, parts of messages, is not tried.
"""

from __future__ import annotations

import socket
import time

from websockets.client import ClientProtocol
from websockets.exceptions import InvalidHandshake, WebSocketException
from websockets.frames import Frame, Opcode
from websockets.protocol import State
from websockets.uri import parse_uri

from nmes.conformance.case import NotTried
from nmes.protocol import DELIMITER

__all__ = ["WebSocketSocket"]

_READ = 64 << 10
_LONGEST = 64 << 20  # bytes of a message of the server's


class WebSocketSocket:
    """What a wire uses of a socket, carried by a WebSocket at `/ws`."""

    def __init__(self, host: str, port: int, timeout: float) -> None:
        """Connects.

        Raises:
            OSError: Nobody answers, or not with a WebSocket.
        """
        name = f"[{host}]" if ":" in host else host
        self._protocol = ClientProtocol(parse_uri(f"ws://{name}:{port}/ws"), max_size=_LONGEST)
        self._received = bytearray()
        self._over = False
        self._timeout = timeout
        self._socket = socket.create_connection((host, port), timeout)
        try:
            self._protocol.send_request(self._protocol.connect())
            self._flush()
            until = time.monotonic() + timeout
            while self._protocol.state is State.CONNECTING:
                self._read(until)
            if self._protocol.handshake_exc is not None:
                raise self._protocol.handshake_exc
        except (WebSocketException, InvalidHandshake) as error:
            self._socket.close()
            raise OSError(f"no WebSocket: {error}") from error
        except OSError:
            self._socket.close()
            raise

    # -- out -------------------------------------------------------------------------------------------------------

    def sendall(self, data: bytes) -> None:
        """Sends messages, each with its delimiter.

        Raises:
            NotTried: There is a part of one among them, or what is no text.
        """
        *messages, rest = data.split(DELIMITER)
        if rest.strip(b" \t\r\n"):
            raise NotTried("over WebSockets a message is a frame: it cannot be sent in parts")
        for message in messages:
            try:
                message.decode()
            except UnicodeDecodeError:
                raise NotTried("over WebSockets a message is a text frame, which is UTF-8") from None
            if self._protocol.state is not State.OPEN:
                raise BrokenPipeError("the WebSocket is closed")
            self._protocol.send_text(message)
        self._flush()

    def send(self, data: bytes) -> int:
        """Sends messages; returns how many bytes that were."""
        self.sendall(data)
        return len(data)

    def shutdown(self, how: int) -> None:
        """Says goodbye; of the whole connection, breaks it off."""
        if how == socket.SHUT_RDWR:
            self._socket.shutdown(how)
        elif self._protocol.state is State.OPEN:
            self._protocol.send_close(1000)
            self._flush()

    def _flush(self) -> None:
        for data in self._protocol.data_to_send():
            if data:
                self._socket.sendall(data)

    # -- in --------------------------------------------------------------------------------------------------------

    def recv(self, count: int, flags: int = 0) -> bytes:
        """Returns the bytes received, a delimiter behind each message; nothing when the server has hung up."""
        until = time.monotonic() + self._timeout
        while not self._received and not self._over:
            self._read(until)
        data = bytes(self._received[:count])
        if not flags & socket.MSG_PEEK:
            del self._received[:count]
        return data

    def _read(self, until: float) -> None:
        """Reads once; raises TimeoutError where nothing comes in time."""
        left = until - time.monotonic()
        if left <= 0:
            raise TimeoutError("timed out")
        self._socket.settimeout(left)
        data = self._socket.recv(_READ)
        if data:
            self._protocol.receive_data(data)
        else:
            self._protocol.receive_eof()
            self._over = True
        for event in self._protocol.events_received():
            if not isinstance(event, Frame):
                continue
            if event.opcode in (Opcode.TEXT, Opcode.CONT):
                self._received += bytes(event.data) + (DELIMITER if event.fin else b"")
            elif event.opcode is Opcode.CLOSE:
                self._over = True
        if not self._over:
            self._flush()

    # -- all else --------------------------------------------------------------------------------------------------

    def settimeout(self, seconds: float) -> None:
        """Says how long each call may take."""
        self._timeout = seconds
        self._socket.settimeout(seconds)

    def setsockopt(self, level: int, option: int, value: int | bytes) -> None:
        """Sets an option of the socket beneath."""
        self._socket.setsockopt(level, option, value)

    def close(self) -> None:
        """Closes the socket."""
        self._socket.close()
