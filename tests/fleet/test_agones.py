"""What a host tells the sidecar of Agones, to a sidecar that is played by an HTTP server."""

from __future__ import annotations

import json
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from nmes import Client
from nmes.cli import main
from nmes.recording import Recording
from processes import process, ready
from servers import PASSWORD, PATIENCE, until

Call = tuple[str, str, Any]
HEALTH: Call = ("POST", "/health", {})
READY: Call = ("POST", "/ready", {})
ALLOCATE: Call = ("POST", "/allocate", {})
SHUTDOWN: Call = ("POST", "/shutdown", {})
MOST = 50


def rooms(count: int) -> Call:
    return "PATCH", "/v1beta1/counters/rooms", {"count": str(count), "capacity": str(MOST)}


class FakeSidecar:
    """Writes down what it is told, and refuses some of it."""

    def __init__(self, port: int) -> None:
        self.port = port
        self.calls: list[Call] = []
        self.refused: dict[str, int] = {}  # how often a path is still refused

    @property
    def told(self) -> list[Call]:
        """What it was told, but for the beats of health behind the first one."""
        first = [HEALTH] if HEALTH in self.calls else []
        return first + [call for call in self.calls if call != HEALTH]


@contextmanager
def sidecar(port: int = 0) -> Iterator[FakeSidecar]:
    class Handler(BaseHTTPRequestHandler):
        def answer(self) -> None:
            body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            assert self.headers["Content-Type"] == "application/json"
            if fake.refused.get(self.path, 0) > 0:
                fake.refused[self.path] -= 1
                self.send_error(404, "no such counter")
                return
            fake.calls.append((self.command, self.path, body))
            self.send_response(200)
            self.end_headers()
            self.wfile.write(b"{}")

        do_POST = do_PATCH = do_PUT = do_GET = answer

        def log_message(self, format: str, *args: Any) -> None:
            """Says nothing."""

    with ThreadingHTTPServer(("127.0.0.1", port), Handler) as server:
        fake = FakeSidecar(server.server_port)
        thread = threading.Thread(target=server.serve_forever, args=(0.02,))
        thread.start()
        try:
            yield fake
        finally:
            server.shutdown()
            thread.join(PATIENCE)


def options(folder: Path, *more: str) -> list[str]:
    flags = ["--backend", "ballistic", "--mode", "lockstep", "--record", str(folder), "--max-worlds", str(MOST)]
    return ["serve", "--json", "--agones", "--port", "0", *flags, *more]


def client(port: int) -> Client:
    return Client(port=port, password=PASSWORD, timeout=PATIENCE)


def test_the_life_of_a_host_is_told_in_order(tmp_path: Path) -> None:
    with sidecar() as fake:
        environment = {"NMES_PASSWORD": PASSWORD, "AGONES_SDK_HTTP_PORT": str(fake.port)}
        with process(*options(tmp_path), **environment) as server:
            port = ready(server)["port"]
            expected = [HEALTH, rooms(1), READY]
            until(lambda: fake.told == expected)
            client(port).worlds()  # who only looks allocates nothing
            with client(port):
                expected += [ALLOCATE]
                until(lambda: fake.told == expected)
                client(port).create_world("second")
                expected += [rooms(2)]
                until(lambda: fake.told == expected)
                client(port).close_world("second")
                expected += [rooms(1)]
                until(lambda: fake.told == expected)
                with client(port):  # it is allocated already
                    beats = fake.calls.count(HEALTH)
                    until(lambda: fake.calls.count(HEALTH) > beats)
            server.send_signal(signal.SIGTERM)
            assert server.wait(PATIENCE) == 0, server.communicate()
        assert fake.told == [*expected, SHUTDOWN]
        assert fake.calls[-1] == SHUTDOWN
    (path, _) = sorted(tmp_path.glob("*.mcap"))
    assert Recording(path).complete


def test_a_host_that_drains_is_healthy_until_it_is_shut_down(tmp_path: Path) -> None:
    with sidecar() as fake:
        environment = {"NMES_PASSWORD": PASSWORD, "AGONES_SDK_HTTP_PORT": str(fake.port)}
        with process(*options(tmp_path, "--drain", "60"), **environment) as server:
            with client(ready(server)["port"]):
                until(lambda: ALLOCATE in fake.calls)
                server.send_signal(signal.SIGTERM)
                beats = fake.calls.count(HEALTH)
                until(lambda: fake.calls.count(HEALTH) > beats + 1)
                assert SHUTDOWN not in fake.calls
            assert server.wait(PATIENCE) == 0, server.communicate()
        assert fake.told == [HEALTH, rooms(1), READY, ALLOCATE, SHUTDOWN]


def test_what_is_refused_is_told_again_and_holds_nothing_else_up(tmp_path: Path) -> None:
    with sidecar() as fake:
        fake.refused["/v1beta1/counters/rooms"] = 1
        environment = {"NMES_PASSWORD": PASSWORD, "AGONES_SDK_HTTP_PORT": str(fake.port)}
        with process(*options(tmp_path), **environment) as server:
            ready(server)
            until(lambda: rooms(1) in fake.calls)
            assert fake.told == [HEALTH, READY, rooms(1)]
            server.send_signal(signal.SIGTERM)
            _, log = server.communicate(timeout=PATIENCE)
    assert log.count("the sidecar of Agones does not take PATCH /v1beta1/counters/rooms") == 1
    assert "status 404" in log and "answers again" in log


def test_worlds_go_on_without_a_sidecar_and_one_that_comes_late_is_told(tmp_path: Path) -> None:
    reserved = socket.socket()  # nobody else gets the port, and who connects is refused until one listens
    reserved.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    reserved.bind(("127.0.0.1", 0))
    port = reserved.getsockname()[1]
    environment = {"NMES_PASSWORD": PASSWORD, "AGONES_SDK_HTTP_PORT": str(port)}
    with reserved, process(*options(tmp_path), **environment) as server:
        with client(ready(server)["port"]) as inside:
            inside.step(5)
            with sidecar(port) as late:
                until(lambda: len(late.told) == 4)
                assert all(call in late.told for call in (HEALTH, rooms(1), READY, ALLOCATE)), late.told
            inside.step(5)
        server.send_signal(signal.SIGTERM)
        _, log = server.communicate(timeout=PATIENCE)
        assert server.returncode == 0, log
    assert "Traceback" not in log and "Connection refused" in log
    (path,) = tmp_path.iterdir()
    assert Recording(path).complete and Recording(path).summary().ticks == 10


@pytest.mark.parametrize("port", ["no port", "0", "65536", "-1"])
def test_a_port_that_is_none_is_wrong_usage(port: str) -> None:
    environment = {"NMES_PASSWORD": PASSWORD, "AGONES_SDK_HTTP_PORT": port}
    result = CliRunner().invoke(main, ["serve", "--no-record", "--agones", "--port", "0"], env=environment)
    assert result.exit_code == 2 and "AGONES_SDK_HTTP_PORT: expected a port" in result.output
