"""Serves worlds within a test: a host in a thread of its own, and a peer that speaks bytes."""

from __future__ import annotations

import asyncio
import json
import socket
import ssl
import threading
from collections.abc import Callable, Coroutine, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self, TypeVar

from nmes import Client
from nmes.protocol import DELIMITER, Limits
from nmes.server import Host
from nmes.server.access_log import AccessLog
from nmes.server.hosted_world import HostedWorld
from nmes.server.metrics import Metrics

T = TypeVar("T")

PASSWORD = "correct horse <battery> staple"
PATIENCE = 30.0  # s; nothing that works takes anywhere near as long, on however busy a machine


class Peer:
    """A bare socket that sends and reads frames, for behaviour that no client library has."""

    def __init__(self, port: int, *, receive_buffer: int | None = None, source: str = "127.0.0.1") -> None:
        self.socket = socket.socket()
        if receive_buffer is not None:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.socket.settimeout(PATIENCE)
        self._buffer = b""
        try:
            self.socket.bind((source, 0))
            self.socket.connect(("127.0.0.1", port))
        except OSError:
            self.socket.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def send(self, data: bytes) -> None:
        self.socket.sendall(data)

    def say(self, *messages: Mapping[str, Any]) -> None:
        """Sends messages in one write."""
        self.send(b"".join(json.dumps(message).encode() + DELIMITER for message in messages))

    def hang_up(self) -> None:
        """Says that nothing more will be sent."""
        self.socket.shutdown(socket.SHUT_WR)

    def frame(self) -> bytes:
        """Returns the next frame."""
        while DELIMITER not in self._buffer:
            data = self.socket.recv(1 << 16)
            assert data, f"the server hung up; last was {self._buffer!r}"
            self._buffer += data
        frame, self._buffer = self._buffer.split(DELIMITER, 1)
        return frame

    def hear(self) -> Any:
        """Returns the next message."""
        return json.loads(self.frame())

    def rest(self) -> list[bytes]:
        """Returns all frames until the server hangs up."""
        try:
            while data := self.socket.recv(1 << 16):
                self._buffer += data
        except ConnectionResetError:
            pass
        frames, self._buffer = self._buffer.split(DELIMITER), b""
        assert frames.pop() == b"", "the last frame is not whole"
        return frames

    def ask(self, message: Mapping[str, Any]) -> Any:
        self.say(message)
        return self.hear()


class Served:
    """A host that is running in another thread."""

    def __init__(self, host: Host, port: int, loop: asyncio.AbstractEventLoop) -> None:
        self.host = host
        self.port = port
        self._loop = loop

    @property
    def hosted(self) -> HostedWorld:
        return self.host.worlds[self.host.world_name(None)]

    def client(self, **options: Any) -> Client:
        return Client(port=self.port, **{"password": PASSWORD, "timeout": PATIENCE, **options})

    def clients(self) -> int:
        """Returns how many clients the world has."""
        with self.client() as client:
            counts: dict[str, int] = client.get_world_info()["counts"]
        return counts["clients"] - 1

    def peer(self, dialect: str | None = "json", **options: Any) -> Peer:
        """Returns a peer that is authenticated in the dialect, if one is given."""
        peer = Peer(self.port, **options)
        if dialect == "json":
            assert peer.ask({"type": "auth", "password": PASSWORD})["type"] == "auth_success"
        elif dialect == "raw":
            peer.send(PASSWORD.encode() + DELIMITER)
            assert peer.frame() == b"auth_success"
        return peer

    def call(self, function: Callable[[], T]) -> T:
        """Runs something in the host's thread, where worlds may be touched."""
        future: Future[T] = Future()
        self._loop.call_soon_threadsafe(lambda: future.set_result(function()))
        return future.result(PATIENCE)

    def run(self, coroutine: Coroutine[Any, Any, T]) -> T:
        """Awaits something in the host's thread."""
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop).result(PATIENCE)

    def close(self) -> None:
        self.run(self.host.close())


@contextmanager
def served(
    *configs: Mapping[str, Any],
    limits: Limits | None = None,
    auth_delay: float = 0.0,
    record_to: Path | None = None,
    flush_interval: float = 1.0,
    lazy: bool = False,
    tls: ssl.SSLContext | None = None,
    metrics: Metrics | None = None,
    access_log: Path | None = None,
    passwords: Mapping[str, str] | None = None,
    role_passwords: Mapping[str, str] | None = None,
    **options: Any,
) -> Iterator[Served]:
    """Runs a host with a world for each config; by default worlds are in lockstep on the `ballistic` engine.

    If `lazy`, worlds are created when first used. `passwords` are those of single worlds, by name. Further options are
    the host's.
    """
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, daemon=True)
    thread.start()

    async def start() -> tuple[Host, int]:
        host = Host(
            PASSWORD,
            role_passwords=role_passwords,
            limits=limits,
            auth_delay=auth_delay,
            record_to=record_to,
            flush_interval=flush_interval,
            tls=tls,
            metrics=metrics,
            access_log=None if access_log is None else AccessLog(access_log),
            **options,
        )
        for config in configs or [{}]:
            own = (passwords or {}).get(config.get("name", "main"))
            (host.offer if lazy else host.add)({"backend": "ballistic", "mode": "lockstep", **config}, own)
        return host, (await host.listen("127.0.0.1", 0))[1]

    host, port = asyncio.run_coroutine_threadsafe(start(), loop).result(PATIENCE)
    running = Served(host, port, loop)
    try:
        yield running
    finally:
        running.close()
        loop.call_soon_threadsafe(loop.stop)
        thread.join(PATIENCE)
        loop.close()


def until(condition: Callable[[], bool], attempts: int = 3000) -> None:
    """Waits until a condition holds that another thread or process brings about; fails after `attempts` / 100 s."""
    for _ in range(attempts):
        if condition():
            return
        threading.Event().wait(0.01)
    raise AssertionError(f"the condition did not hold within {attempts / 100:g} s")


def types(frames: Sequence[bytes]) -> list[str]:
    """Returns the types of messages."""
    return [json.loads(frame)["type"] for frame in frames]
