"""WebSockets: each text frame is a message, and all else is as over TCP."""

from __future__ import annotations

import asyncio
import json
import socket
import ssl
import threading
from pathlib import Path
from typing import Any

import pytest
import trustme
from click.testing import CliRunner
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus
from websockets.frames import Frame, Opcode
from websockets.typing import Origin

from browsers import doors, get, socket_to, web_port
from nmes.cli import main
from nmes.conformance import Options, Target, Verdict, run
from nmes.playback import replay
from nmes.protocol import DELIMITER, Limits
from nmes.recording import Kind, Recording
from nmes.server.door import Guesses
from nmes.server.http import PIECE
from nmes.server.websocket import Carrier
from processes import process, ready
from servers import PASSWORD, PATIENCE, served, until

PROGRAM = [
    {"type": "spawn_cube", "cube_name": "<b>&", "position": [0, 2, 0], "list": False},
    {"type": "apply_physics", "cube_name": "<b>&", "force": [1, 0, 0], "id": [1, "<???DONE???---"]},
    {"type": "step", "ticks": 3},
    {"type": "get_cube_state", "cube_name": "<b>&"},
    {"type": "nonsense"},
    {"type": "step", "ticks": "many"},
]


def test_messages_are_answered_recorded_and_replayed_as_over_tcp(tmp_path: Path) -> None:
    answers: list[list[Any]] = []
    for way in ("tcp", "ws"):
        with served(record_to=tmp_path / way) as server:
            texts = [json.dumps(one).replace("<", "\\u003c") for one in PROGRAM]
            if way == "tcp":
                with server.peer() as peer:
                    answers.append([])
                    for text in texts:
                        peer.send(text.encode() + DELIMITER)
                        answers[-1].append(peer.hear())
            else:
                with socket_to(web_port(server)) as browser:
                    assert browser.enter()["type"] == "auth_success"
                    answers.append([])
                    for text in texts:
                        browser.say(text)
                        answers[-1].append(browser.hear())
    assert answers[0] == answers[1]
    histories = []
    for way in ("tcp", "ws"):
        (path,) = (tmp_path / way).iterdir()
        assert replay(path).verdict == "reproduced"
        records = [(each.kind, each.data, each.digests) for each in Recording(path) if each.kind != Kind.POSES]
        histories.append(records)
    assert histories[0] == histories[1]


def test_a_browser_may_come_only_from_a_page_of_the_server_itself() -> None:
    with served() as server:
        port = web_port(server, "https://lab.example.org")
        for origin, whose in {**doors(port), "https://lab.example.org": "own"}.items():
            if whose == "own":
                with socket_to(port, origin=origin) as browser:
                    assert browser.enter()["type"] == "auth_success"
                continue
            with pytest.raises(InvalidStatus) as refused, socket_to(port, origin=origin):
                pass
            assert refused.value.response.status_code == 403
            assert get(port, "/health", Origin=origin)[0] == 403


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example:80", "", "@", "[::1", "a b"])
def test_a_name_that_somebody_lets_point_here_is_not_the_servers(host: str) -> None:
    with served() as server:
        status, _, body = get(web_port(server), "/health", Host=host)
    assert status in (400, 403) and b"ok" not in body


def test_the_health_page_wants_no_password() -> None:
    with served() as server:
        port = web_port(server)
        for name in (f"127.0.0.1:{port}", "localhost", f"[::1]:{port}"):
            assert get(port, "/health", Host=name)[::2] == (200, b'{"status":"ok"}')
        assert get(port, "/nothing")[0] == 404
        assert get(port, "/ws")[0] == 404


def test_a_binary_frame_is_refused_with_words() -> None:
    with served() as server, socket_to(web_port(server)) as browser:
        browser.enter()
        browser.say(b'{"type":"ping"}')
        (error,), code = browser.rest()
        assert (error["code"], code) == ("bad_frame", 1003)


def test_a_message_that_is_too_long_is_refused() -> None:
    limits = Limits(frame=100_000, auth_frame=1000)
    with served(limits=limits) as server:
        port = web_port(server)
        for entered, length in ((False, 1001), (True, 100_001)):
            with socket_to(port) as browser:
                if entered:
                    browser.enter()
                browser.say("x" * length)
                (error,), code = browser.rest()
                assert (error["code"], code) == ("frame_too_large", 1000)
        with socket_to(port) as browser:
            browser.enter()
            browser.say("x" * 300_000)
            assert browser.rest() == ([], 1009)


def test_who_does_not_read_is_cut_off_and_others_are_served() -> None:
    limits = Limits(pending=200_000, stall_timeout=0.5)
    with served(limits=limits) as server:
        port = web_port(server)
        with socket_to(port) as other, socket.create_connection(("127.0.0.1", port)) as rude:
            other.enter()
            rude.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            rude.settimeout(PATIENCE)
            key = b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n\r\n"
            rude.sendall(b"GET /ws HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n" + key)
            assert rude.recv(4096).startswith(b"HTTP/1.1 101")

            def frame(text: bytes) -> bytes:
                head = (
                    bytes([0x81, 0x80 | len(text)]) if len(text) < 126 else bytes([0x81, 0xFE]) + len(text).to_bytes(2)
                )
                return head + bytes(4) + text

            rude.sendall(frame(json.dumps({"type": "auth", "password": PASSWORD}).encode()))
            until(lambda: server.clients() == 2)
            with pytest.raises(OSError):
                while True:
                    rude.sendall(frame(b'{"type":"get_world_info"}') * 100)
            until(lambda: server.clients() == 1)
            assert other.ask({"type": "ping"})["type"] == "pong"


def test_wrong_passwords_are_throttled_together_with_those_over_tcp(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Guesses, "ADDRESS", (5, 0.001))  # one more in a quarter of an hour
    with served(auth_delay=0.0) as server:
        port = web_port(server)
        for _ in range(5):
            with socket_to(port) as browser:
                assert browser.enter(password="wrong")["code"] == "auth_failed"
        with server.peer(None) as peer:
            assert "too many" in peer.ask({"type": "auth", "password": PASSWORD})["message"]


def test_a_request_that_does_not_come_is_not_waited_for() -> None:
    with served(limits=Limits(auth_timeout=1.0)) as server:
        port = web_port(server)
        for said in (b"", b"GET /health HT", b"POST /health HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\n\r\nx"):
            with socket.create_connection(("127.0.0.1", port)) as slow:
                slow.settimeout(PATIENCE)
                slow.sendall(said)
                while slow.recv(1000):
                    pass
        with socket_to(port) as patient:  # but for what it may say
            patient.enter()
            threading.Event().wait(1.5)
            assert patient.ask({"type": "ping"})["type"] == "pong"
        with socket_to(port) as silent:
            (error,), _ = silent.rest()
            assert error["code"] == "auth_timeout"


def test_strangers_who_wait_are_put_out_before_those_who_speak_are_kept_out() -> None:
    with served(limits=Limits(unauthenticated=4)) as server:
        port = web_port(server)
        crowd = [socket.create_connection(("127.0.0.1", port)) for _ in range(12)]
        try:
            with socket_to(port) as late:
                assert late.enter()["type"] == "auth_success"
            assert server.call(lambda: len(server.host._door)) <= 4
        finally:
            for one in crowd:
                one.close()


def test_events_and_a_worlds_end_reach_a_browser() -> None:
    with served() as server:
        with socket_to(web_port(server)) as browser:
            browser.enter()
            browser.ask({"type": "subscribe", "events": ["tick"]})
            browser.say({"type": "step", "ticks": 2})
            kinds = [browser.hear()["type"] for _ in range(3)]
            assert sorted(kinds) == ["stepped", "tick", "tick"]
            server.close()
            messages, code = browser.rest()
            assert ([message["type"] for message in messages], code) == (["world_closed"], 1000)


def test_what_does_not_apply_to_websockets_is_skipped_by_the_suite_and_all_else_passes() -> None:
    with served(auth_delay=0.0) as server:
        target = Target("127.0.0.1", web_port(server), PASSWORD, scheme="ws")
        report = run(target, Options(only=("1.*", "4.1:*", "5.*")))
    assert not [
        (each.case.number, each.received) for each in report.results if each.verdict in (Verdict.FAILED, Verdict.FAULT)
    ]
    skipped = {each.case.number for each in report.results if "WebSocket" in (each.reason or "")}
    assert {"1.5", "1.17", "4.1:latin1"} <= skipped
    assert report.counts[Verdict.OK] > 50


def test_who_says_much_at_once_lets_others_have_their_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    counts = {"frames": 0, "messages": 0}
    most = dict.fromkeys(counts, 0)  # in one turn of the event loop

    def counted(kind: type, method: str, what: str) -> None:
        original = getattr(kind, method)

        def count(self: Any, given: Any) -> Any:
            counts[what] += 1
            return original(self, given)

        monkeypatch.setattr(kind, method, count)

    counted(WebSocketsSansIOProtocol, "handle_text", "frames")
    counted(Carrier, "hear", "messages")
    monkeypatch.setattr("nmes.server.websocket.SLICE", 0.0)
    ping = Frame(Opcode.TEXT, b'{"type":"ping"}').serialize(mask=True)
    with served() as server, socket_to(web_port(server)) as browser:
        assert browser.enter()["type"] == "auth_success"
        last = dict(counts)
        over = False

        def turn() -> None:
            for what in counts:
                most[what] = max(most[what], counts[what] - last[what])
            last.update(counts)
            if not over:
                asyncio.get_running_loop().call_soon(turn)

        server.call(turn)
        browser.connection.socket.sendall(ping * 6000)
        for _ in range(6000):
            assert browser.hear() == {"type": "pong"}
        over = True
        server.call(lambda: None)
    assert counts["messages"] == 6001
    assert 0 < most["frames"] <= PIECE // len(ping) + 1 and 0 < most["messages"] <= 2


def test_a_long_frame_and_what_comes_behind_it_arrive_whole() -> None:
    spawns = [{"type": "spawn_cube", "cube_name": f"{n:0100}", "position": [0, 2 * n, 0]} for n in range(250)]
    batch = {"type": "batch", "commands": spawns}
    with served() as server, socket_to(web_port(server), max_size=None) as browser:
        assert browser.enter()["type"] == "auth_success"
        frames = [json.dumps(each).encode() for each in (batch, {"type": "ping"}, {"type": "get_world_info"})]
        assert len(frames[0]) > 4 * PIECE
        browser.connection.socket.sendall(b"".join(Frame(Opcode.TEXT, frame).serialize(mask=True) for frame in frames))
        assert len(browser.hear()["results"]) == 250
        assert browser.hear() == {"type": "pong"}
        assert browser.hear()["counts"]["cubes"] == 250


async def _enter(port: int, context: ssl.SSLContext) -> Any:
    """Says the password over TLS, in one thread.

    The `websockets` client with threads reads and writes at once, which OpenSSL forbids and Python does not keep apart:
    one handshake in 800 broke on a busy machine.
    """
    address = f"127.0.0.1:{port}"
    origin = Origin(f"https://{address}")
    async with connect(f"wss://{address}/ws", ssl=context, origin=origin, open_timeout=PATIENCE) as browser:
        await browser.send(json.dumps({"type": "auth", "password": PASSWORD}))
        return json.loads(await browser.recv())


def test_serve_says_where_its_websockets_are(tmp_path: Path) -> None:
    authority = trustme.CA()
    certificate = authority.issue_cert("127.0.0.1")
    cert, key = tmp_path / "cert", tmp_path / "key"
    certificate.private_key_pem.write_to_path(str(key))
    cert.write_bytes(b"".join(blob.bytes() for blob in certificate.cert_chain_pems))
    context = ssl.create_default_context()
    authority.configure_trust(context)
    options = ["--port", "0", "--http", "0", "--no-record", "--json", "--mode", "lockstep"]
    with process("serve", *options, "--tls-cert", str(cert), "--tls-key", str(key), NMES_PASSWORD=PASSWORD) as server:
        port = ready(server)["http_port"]
        assert asyncio.run(_enter(port, context))["type"] == "auth_success"
        assert get(port, "/health", tls=context)[0] == 200
        server.terminate()
        assert server.wait(PATIENCE) == 0
        assert server.stderr is not None and server.stderr.read() == ""


@pytest.mark.parametrize("origin", ["lab.example.org", "https://lab.example.org/", "*", "http://a b"])
def test_an_origin_that_is_none_is_wrong_usage(origin: str) -> None:
    arguments = ["serve", "--http", "0", "--http-origin", origin]
    result = CliRunner().invoke(main, arguments, env={"NMES_PASSWORD": PASSWORD})
    assert result.exit_code == 2 and "an origin is" in result.output
