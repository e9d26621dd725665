"""TLS, from both sides."""

from __future__ import annotations

import asyncio
import json
import socket
import ssl
import threading
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import pytest
import trustme
from click.testing import CliRunner

from nmes import AsyncClient, Client
from nmes.cli import main
from nmes.errors import Disconnected
from nmes.protocol import DELIMITER, Limits, Request
from nmes.server.connection import Connection
from nmes.server.threads import SLICE
from nmes.world import World
from processes import process, ready
from servers import PASSWORD, PATIENCE, Served, served, until


@pytest.fixture(scope="module")
def authority() -> trustme.CA:
    return trustme.CA()


@pytest.fixture(scope="module")
def trust(authority: trustme.CA) -> ssl.SSLContext:
    context = ssl.create_default_context()
    authority.configure_trust(context)
    return context


@pytest.fixture(scope="module")
def identity(authority: trustme.CA) -> ssl.SSLContext:
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    authority.issue_cert("127.0.0.1").configure_cert(context)
    return context


@pytest.fixture
def server(identity: ssl.SSLContext) -> Iterator[Served]:
    with served(tls=identity) as running:
        yield running


def test_a_blocking_client_reads_megabytes_over_tls(server: Served, trust: ssl.SSLContext) -> None:
    with server.client(tls=trust) as client:
        with client.pipeline() as many:
            for _ in range(1000):
                many.spawn_cube(list=False)
            for _ in range(20):
                many.get_world_state()
        assert {len(call.result()["cubes"]) for call in many.calls[1000:]} == {1000}
        assert client.worlds()[0]["world"] == "main"
        client.subscribe(events=["tick"])
        client.step(3)
        assert [cast(Any, event)["frame"] for _, event in zip(range(3), client.events(PATIENCE), strict=False)] == [
            1,
            2,
            3,
        ]


async def test_an_awaiting_client_connects_over_tls(server: Served, trust: ssl.SSLContext) -> None:
    async with AsyncClient(port=server.port, password=PASSWORD, timeout=PATIENCE, tls=trust) as client:
        assert (await client.step(3))["frame"] == 3


async def test_an_awaiting_client_closes_without_the_leave_of_a_server_that_says_nothing(
    identity: ssl.SSLContext, trust: ssl.SSLContext
) -> None:
    closed = threading.Event()

    def serve(listener: socket.socket) -> None:
        connection, _ = listener.accept()
        with identity.wrap_socket(connection, server_side=True) as secure:
            secure.recv(1 << 16)
            secure.sendall(b'{"type":"auth_success"}' + DELIMITER)
            closed.wait()

    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=serve, args=[listener])
        thread.start()
        port = listener.getsockname()[1]
        try:
            client = await AsyncClient(port=port, password="x", timeout=PATIENCE, tls=trust).connect()
            async with asyncio.timeout(PATIENCE / 2):  # asyncio by itself would ask for 30 s
                await client.close()
        finally:
            closed.set()
            thread.join(PATIENCE)


async def test_a_client_without_tls_is_told_that_the_server_may_speak_it(server: Served) -> None:
    hint = r"hung up without an answer; if it speaks TLS, so must you: tls=True, or --tls"
    with pytest.raises(Disconnected, match=hint):
        server.client().connect()
    with pytest.raises(Disconnected, match=hint):
        await AsyncClient(port=server.port, password=PASSWORD, timeout=PATIENCE).connect()
    listing = ["worlds", f"127.0.0.1:{server.port}"]
    outcome = CliRunner().invoke(main, listing, env={"NMES_PASSWORD": PASSWORD})
    assert outcome.exit_code == 1 and "so must you: tls=True, or --tls" in outcome.output


def test_a_judged_server_that_speaks_tls_is_told_apart_from_one_that_errs(server: Served) -> None:
    judging = ["conform", f"127.0.0.1:{server.port}", "--only", "4.3:object", "--only", "8.14"]
    outcome = CliRunner().invoke(main, judging, env={"NMES_PASSWORD": PASSWORD})
    assert outcome.exit_code == 1 and "if it speaks TLS, judge it without" in outcome.output
    with served() as plain:
        judging[1] = f"127.0.0.1:{plain.port}"
        assert "TLS" not in CliRunner().invoke(main, judging, env={"NMES_PASSWORD": PASSWORD}).output


async def test_a_client_with_tls_is_told_that_the_server_may_speak_none(trust: ssl.SSLContext) -> None:
    with served(limits=Limits(auth_timeout=0.2)) as plain:
        with pytest.raises(Disconnected, match="it may speak no TLS"):
            plain.client(tls=trust).connect()
        with pytest.raises(Disconnected, match="it may speak no TLS"):
            await AsyncClient(port=plain.port, password=PASSWORD, timeout=PATIENCE, tls=trust).connect()
        with pytest.raises(Disconnected) as failed, plain.client() as client:
            plain.close()
            client.ping()
    assert "TLS" not in failed.value.message


async def test_an_untrusted_server_is_sent_no_password(server: Served) -> None:
    with pytest.raises(Disconnected, match="certificate"):
        server.client(tls=True).connect()
    with pytest.raises(Disconnected, match="certificate"):
        await AsyncClient(port=server.port, password=PASSWORD, timeout=PATIENCE, tls=True).connect()
    assert server.call(lambda: server.host.connections) == 0


def test_a_peer_without_tls_is_sent_nothing(server: Served, trust: ssl.SSLContext) -> None:
    with server.peer(None) as peer:
        peer.send(PASSWORD.encode() + DELIMITER)
        assert DELIMITER not in peer.socket.recv(1000)
    with server.client(tls=trust) as client:
        assert client.ping()


def test_a_tls_handshake_that_stalls_is_ended(identity: ssl.SSLContext) -> None:
    with served(tls=identity, limits=Limits(auth_timeout=0.3)) as server, server.peer(None) as peer:
        assert peer.rest() == []


def test_handshakes_that_come_at_once_begin_one_a_turn_of_the_loop(server: Served) -> None:
    """Each takes a while to begin: between them others are answered."""
    with ExitStack() as stack:

        async def begun() -> list[int]:
            for _ in range(8):  # while the loop has no turn: the system keeps them
                stack.enter_context(socket.create_connection(("127.0.0.1", server.port), PATIENCE))
            counts = []
            for _ in range(50):
                await asyncio.sleep(0)
                counts.append(len(server.host._door))
            return counts

        counts = server.run(begun())
    assert counts[-1] == 8
    assert {after - before for before, after in pairwise(counts)} == {0, 1}


def test_refused_and_departed_tls_peers_are_treated_like_others(server: Served, trust: ssl.SSLContext) -> None:
    with socket.create_connection(("127.0.0.1", server.port), PATIENCE) as plain:
        with trust.wrap_socket(plain, server_hostname="127.0.0.1") as peer:
            peer.sendall(b"guess" + DELIMITER)
            assert peer.recv(1000) == b"auth_failed" + DELIMITER
            assert peer.recv(1000) == b""
    with socket.create_connection(("127.0.0.1", server.port), PATIENCE) as plain:
        with trust.wrap_socket(plain, server_hostname="127.0.0.1") as peer:
            spawn = json.dumps({"type": "spawn_cube"}).encode() + DELIMITER
            peer.sendall(PASSWORD.encode() + DELIMITER + spawn * 100)
    until(lambda: len(server.call(server.hosted.world.cubes)) == 100)
    until(lambda: server.call(lambda: server.host.connections) == 0)


def test_nmes_serve_takes_a_certificate(authority: trustme.CA, tmp_path: Path) -> None:
    issued = authority.issue_cert("127.0.0.1")
    issued.private_key_pem.write_to_path(tmp_path / "key.pem")
    for blob in issued.cert_chain_pems:
        blob.write_to_path(tmp_path / "cert.pem", append=True)
    authority.cert_pem.write_to_path(tmp_path / "ca.pem")
    cert, key, ca = (str(tmp_path / name) for name in ("cert.pem", "key.pem", "ca.pem"))
    options = ["--json", "--port", "0", "--backend", "ballistic", "--no-record", "--tls-cert", cert, "--tls-key", key]
    with process("serve", *options, NMES_PASSWORD=PASSWORD) as server:
        port = ready(server)["port"]
        with Client(
            port=port, password=PASSWORD, timeout=PATIENCE, tls=ssl.create_default_context(cafile=ca)
        ) as client:
            assert client.ping()

        def run(*arguments: str) -> str:
            return CliRunner().invoke(main, arguments, env={"NMES_PASSWORD": PASSWORD}).output

        assert "ballistic" in run("worlds", f"127.0.0.1:{port}", "--tls-ca", ca)
        assert "certificate" in run("worlds", f"127.0.0.1:{port}", "--tls")
        assert "key.pem has no certificates" in run("worlds", f"127.0.0.1:{port}", "--tls-ca", key)
        server.terminate()
        assert server.wait(PATIENCE) == 0
    assert "go together" in run("serve", "--tls-cert", cert)
    assert "cannot use" in run("serve", "--tls-cert", key, "--tls-key", cert)


@pytest.mark.parametrize("notified", [True, False])
def test_what_is_said_before_a_hang_up_is_executed_and_the_connection_forgotten(
    notified: bool, identity: ssl.SSLContext, trust: ssl.SSLContext, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each command takes two fifths of a slice by the clock that they are measured with, so that most have to wait."""
    now, handle = 0.0, World.handle

    def timed(world: World, client: int, request: Request) -> bytes:
        nonlocal now
        now += 0.4 * SLICE
        return handle(world, client, request)

    said = [{"type": "auth", "password": PASSWORD}, *[{"type": "spawn_cube", "list": False}] * 600]
    with served(tls=identity, limits=Limits(connections=1)) as server:
        for module in ("connection", "turns"):
            monkeypatch.setattr(f"nmes.server.{module}.monotonic", lambda: now)
        monkeypatch.setattr(World, "handle", timed)
        for total in (600, 1200):  # the second is let in, so the first is forgotten
            with socket.create_connection(("127.0.0.1", server.port), PATIENCE) as plain:
                stream = trust.wrap_socket(plain, server_hostname="127.0.0.1", suppress_ragged_eofs=True)
                stream.sendall(b"".join(json.dumps(each).encode() + DELIMITER for each in said))
                if notified:
                    with suppress(OSError):
                        stream.unwrap()
                else:
                    plain_end(stream)
                until(partial(spawned, server, total))
                stream.close()
            until(lambda: server.call(lambda: server.hosted.clients) == 0)
        server.call(monkeypatch.undo)


def spawned(server: Served, count: int) -> bool:
    return server.call(lambda: len(server.hosted.world.entities.cubes)) == count


def plain_end(stream: ssl.SSLSocket) -> None:
    """Ends what a client says without a word of TLS."""
    socket.socket.shutdown(stream, socket.SHUT_WR)


def test_a_connection_whose_transport_was_closed_twice_is_cut_off(
    identity: ssl.SSLContext, trust: ssl.SSLContext, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    transports: list[asyncio.BaseTransport] = []
    made = Connection.connection_made

    def keep(connection: Connection, transport: asyncio.BaseTransport) -> None:
        transports.append(transport)
        made(connection, transport)

    def close_twice() -> None:
        for _ in range(2):  # after which that of Python 3.11 can do nothing, and says so at each question
            transports[0].close()

    monkeypatch.setattr(Connection, "connection_made", keep)
    with served(tls=identity, limits=Limits(stall_timeout=0.04)) as server:
        with server.client(tls=trust), server.client(tls=trust) as other:
            server.call(close_twice)
            until(lambda: server.host.connections == 1)
            assert other.get_world_info()["counts"]["clients"] == 1
            server.call(transports[1].close)
            server.call(transports[1].close)
            server.close()  # before anybody has looked at that one
            assert server.host.connections == 0
    assert caplog.text.count("a connection fails") <= 2
