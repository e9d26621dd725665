"""Servers that do what no server should, for those who must not be misled by one."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from typing import Any

from nmes.protocol import DELIMITER, FrameSplitter

WELCOME: dict[str, Any] = {
    "type": "auth_success", "protocol": 1, "client": 1, "world": "w", "backend": "x", "dims": 3,
    "timestep": 1 / 60, "tick_rate": 60, "mode": "lockstep",
}  # fmt: skip
ANSWERS: dict[str, dict[str, Any]] = {
    "auth": WELCOME,
    "get_world_info": {
        "type": "world_info", "mode": "lockstep", "capabilities": ["get_world_info", "step", "subscribe", "unsubscribe"]
    },
    "get_cube_list": {"type": "cube_list", "cubes": []},
    "ping": {"type": "pong"},
}  # fmt: skip

Answer = Mapping[str, Any] | Iterable[bytes]


@contextmanager
def listening(answer: Callable[[socket.socket], None]) -> Iterator[int]:
    """Runs a server that does with each connection what `answer` says, and keeps it open; yields its port."""
    with socket.create_server(("127.0.0.1", 0), backlog=200) as server:
        connections: list[socket.socket] = []
        threads: list[threading.Thread] = []

        def meet(connection: socket.socket) -> None:
            with suppress(OSError):  # the other side has hung up
                answer(connection)

        def serve() -> None:
            while True:
                try:
                    connection, _ = server.accept()
                except OSError:
                    return
                connections.append(connection)
                threads.append(threading.Thread(target=meet, args=(connection,), daemon=True))
                threads[-1].start()

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        try:
            yield server.getsockname()[1]
        finally:
            server.shutdown(socket.SHUT_RDWR)
            thread.join()
            for connection in connections:
                with suppress(OSError):  # it is closed already
                    connection.shutdown(socket.SHUT_RDWR)
            for each in threads:
                each.join()
            for connection in connections:
                connection.close()


def answering(answer: Callable[[dict[str, Any]], Answer | None]) -> AbstractContextManager[int]:
    """Runs a server that gives each command the message, or the bytes, that `answer` says, or else one of `ANSWERS`."""

    def serve(connection: socket.socket) -> None:
        splitter = FrameSplitter()
        while data := connection.recv(1 << 16):
            for frame in splitter.feed(data):
                try:
                    said = json.loads(frame)
                except ValueError:
                    continue
                kind = said.get("type")
                ours = answer(said) or ANSWERS.get(kind, {"type": "error", "code": "unknown_type", "message": kind})
                if isinstance(ours, Mapping):
                    number = {"id": said["id"]} if "id" in said else {}
                    ours = [json.dumps({**ours, **number}).encode() + DELIMITER]
                for part in ours:
                    connection.sendall(part)

    return listening(serve)
