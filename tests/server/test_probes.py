"""What a host answers to those who watch it over HTTP."""

from __future__ import annotations

import http.client
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import pytest

from nmes.protocol import Limits
from nmes.server import Host
from nmes.server import probes as probes_module
from nmes.server.metrics import Metrics
from nmes.server.reception import drain
from servers import PATIENCE, Served, served, until


class Watched:
    """The probes of a host in another thread."""

    def __init__(self, server: Served, port: int) -> None:
        self.server, self.port = server, port

    def ask(self, path: str, method: str = "GET") -> tuple[int, str, bytes]:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE)
        try:
            connection.request(method, path)
            answer = connection.getresponse()
            return answer.status, answer.headers["Content-Type"], answer.read()
        finally:
            connection.close()

    def caller(self) -> socket.socket:
        return socket.create_connection(("127.0.0.1", self.port), PATIENCE)


@contextmanager
def watched(limits: Limits | None = None) -> Iterator[Watched]:
    metrics = Metrics()
    with served(metrics=metrics, limits=limits) as server:
        yield Watched(server, server.run(server.host.probes.listen("127.0.0.1", 0)))


def test_health_readiness_and_metrics_have_a_page_each() -> None:
    with watched() as host:
        assert host.ask("/health") == (200, "text/plain; charset=utf-8", b"alive\n")
        assert host.ask("/ready")[::2] == (200, b"ready\n")
        for path in ("/metrics", "/", "/metrics?name[]=nmes_worlds"):
            status, kind, page = host.ask(path)
            assert status == 200 and "version=" in kind and b"\nnmes_worlds 1.0\n" in page
        assert host.ask("/metrics/x")[0] == host.ask("/ready/")[0] == host.ask("/favicon.ico")[0] == 404
    with pytest.raises(OSError):
        host.ask("/health")


def test_only_looking_is_allowed() -> None:
    with watched() as host:
        for method in ("POST", "DELETE", "OPTIONS", "get"):
            assert host.ask("/health", method)[0] == 405
        status, _, page = host.ask("/metrics", "HEAD")
        assert (status, page) == (200, b"")


def test_a_host_that_is_full_or_draining_is_alive_but_not_ready() -> None:
    with watched(Limits(connections=1)) as host:
        with host.server.client():
            assert host.ask("/ready")[::2] == (503, b"full\n")
            assert host.ask("/health")[0] == 200
            assert b"\nnmes_ready 0.0\n" in host.ask("/metrics")[2]
        until(lambda: host.ask("/ready")[0] == 200)
        host.server.run(drain(host.server.host, 0.0))
        assert host.ask("/ready")[::2] == (503, b"draining\n")
        assert host.ask("/health")[0] == 200


async def test_a_host_that_does_not_listen_yet_is_starting() -> None:
    async with Host("x") as host:
        assert host.unready == "starting"
        await host.listen("127.0.0.1", 0)
        assert host.unready is None


@pytest.mark.parametrize(
    "head", [b"nonsense", b"GET /health", b"\x00\xff", b"", b"GET / HTTP/1.1 x", b"GET / SPDY/3", b" / HTTP/1.1 "]
)
def test_what_is_no_request_is_refused(head: bytes) -> None:
    with watched() as host, host.caller() as caller:
        caller.sendall(head + b"\r\n\r\n")
        assert caller.recv(1000).startswith(b"HTTP/1.1 400 ")


def test_neither_long_heads_nor_idle_callers_keep_a_probe_from_its_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probes_module, "MOST", 4)
    with watched() as host:
        with ExitStack() as open_:
            idle = [open_.enter_context(host.caller()) for _ in range(6)]
            assert host.ask("/health")[0] == 200
            assert [caller.recv(1) for caller in idle[:3]] == [b""] * 3  # the oldest, one for each over the limit
        with host.caller() as caller:
            caller.sendall(b"GET /health HTTP/1.1\r\nX: " + b"x" * 40_000)
            try:
                answer = caller.recv(1000)
            except ConnectionResetError:  # what it sent was not read to its end
                answer = b""
            assert answer == b""


def test_callers_that_come_at_once_end_as_many_of_the_oldest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probes_module, "MOST", 4)
    monkeypatch.setattr(probes_module, "TIMEOUT", 10 * PATIENCE)
    with watched() as host, ExitStack() as open_:
        # All wait to be accepted, as the host does nothing else meanwhile.
        idle = host.server.call(lambda: [open_.enter_context(host.caller()) for _ in range(9)])
        assert [caller.recv(1) for caller in idle[:5]] == [b""] * 5
        assert host.ask("/health")[0] == 200


def test_who_says_nothing_is_hung_up_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probes_module, "TIMEOUT", 0.1)
    with watched() as host, host.caller() as caller:
        caller.sendall(b"GET /health HTTP/1.1\r\n")
        assert caller.recv(1) == b""
