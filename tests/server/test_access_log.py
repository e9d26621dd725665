"""The access log: who came from where, to which world, how it went, and how it ended."""

from __future__ import annotations

import json
import socket
import struct
from pathlib import Path
from typing import Any

import pytest

from nmes.protocol import DELIMITER, Limits
from nmes.server import access_log
from processes import process, ready
from servers import PASSWORD, PATIENCE, Peer, Served, served, until


def lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def last(server: Served, path: Path) -> dict[str, Any]:
    """Returns the last line once nobody is connected any more."""
    until(lambda: server.call(lambda: server.host.connections) == 0)
    return server.call(lambda: lines(path)[-1])


def test_a_client_that_comes_and_goes_has_two_lines(tmp_path: Path) -> None:
    path = tmp_path / "access.log"
    with served({"name": "red"}, {"name": "green"}, access_log=path, lazy=True) as server:
        with server.client(world="green") as client:
            client.spawn_cube()
            client.step(3)
            address = client._socket.getsockname()  # type: ignore[union-attr]
            (entered,) = lines(path)
        left = last(server, path)
    assert entered.pop("time") <= left.pop("time")
    peer = f"{address[0]}:{address[1]}"
    assert entered == {"event": "entered", "from": peer, "world": "green", "client": 1, "dialect": "json"}
    assert left.pop("seconds") >= 0
    assert left == {
        "event": "left", "from": peer, "world": "green", "client": 1, "commands": 2, "reason": "hung_up",
    }  # fmt: skip


def test_passwords_are_never_logged_and_every_refusal_is_with_its_reason(tmp_path: Path) -> None:
    path = tmp_path / "access.log"
    reasons = []
    with served(access_log=path, limits=Limits(auth_timeout=0.2, connections=1)) as server:
        for first in (
            b'{"type":"auth","password":"guess-one"}',
            b"guess-two",
            f'{{"type":"auth","password":"{PASSWORD}","world":"secret-name"}}'.encode(),
            f'{{"type":"auth","password":"{PASSWORD}","list":true}}'.encode(),
            b'{"type":"auth"}',
            None,  # says nothing
        ):
            with Peer(server.port) as peer:
                if first is not None:
                    peer.send(first + DELIMITER)
                peer.rest()
            line = last(server, path)
            reasons.append((line["event"], line["reason"]))
        with server.peer(), Peer(server.port) as peer:
            assert peer.ask({"type": "auth", "password": PASSWORD})["code"] == "too_many_connections"
            peer.rest()
        last(server, path)
        ended = [(line["event"], line["reason"]) for line in lines(path) if "reason" in line]
        reasons.append(next(each for each in ended if each not in reasons))
    assert reasons == [
        ("refused", "auth_failed"),
        ("refused", "auth_failed"),
        ("refused", "world_not_found"),
        ("listed", "listed"),
        ("refused", "invalid"),
        ("refused", "auth_timeout"),
        ("refused", "too_many_connections"),
    ]
    text = path.read_text()
    assert "guess" not in text and PASSWORD not in text and "secret-name" not in text


@pytest.mark.parametrize(
    ("how", "reason"), [("idle", "idle"), ("long", "frame_too_large"), ("reset", "reset"), ("host", "closed")]
)
def test_a_line_says_how_a_connection_ended(how: str, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "access.log"
    limits = Limits(idle_timeout=0.2) if how == "idle" else Limits(frame=1000)
    with served(access_log=path, limits=limits) as server, server.peer() as peer:
        match how:
            case "idle":
                peer.rest()
            case "long":
                peer.send(b"x" * 2000)
                peer.rest()
                peer.socket.close()
            case "reset":
                peer.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                peer.socket.close()
            case "host":
                server.close()
        if how != "host":
            last(server, path)
    assert [line["event"] for line in lines(path)] == ["entered", "left"]
    assert lines(path)[-1]["reason"] == reason


def test_a_log_that_is_renamed_is_begun_anew(tmp_path: Path) -> None:
    path = tmp_path / "access.log"
    with served(access_log=path) as server, server.client():
        path.rename(tmp_path / "access.log.1")
        with server.client():
            pass
    assert [line["event"] for line in lines(tmp_path / "access.log.1")] == ["entered"]
    assert {line["event"] for line in lines(path)} == {"entered", "left"}


def test_strangers_cannot_make_it_grow_and_what_is_left_out_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(access_log, "STRANGERS", (3, 1e-9))
    path = tmp_path / "access.log"
    with served(access_log=path) as server:
        for _ in range(8):
            with Peer(server.port) as peer:
                peer.send(b'{"type":"auth"}' + DELIMITER)
                peer.rest()
            last(server, path)
        with server.client():
            pass
        last(server, path)
    assert [(line["event"], line.get("left_out")) for line in lines(path)] == [
        *[("refused", None)] * 3,
        ("entered", 5),
        ("left", None),
    ]


def test_a_log_that_cannot_be_written_is_told_and_the_world_goes_on(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    with served(access_log=folder / "access.log") as server:
        (folder / "access.log").unlink()
        folder.rmdir()
        with server.client() as client:
            assert client.step()["frame"] == 1
    assert "the access log cannot be written" in caplog.text


def test_nmes_serve_writes_an_access_log(tmp_path: Path) -> None:
    path = tmp_path / "access.log"
    options = ["--port", "0", "--backend", "ballistic", "--mode", "lockstep", "--no-record", "--access-log", str(path)]
    with process("serve", "--json", *options, NMES_PASSWORD=PASSWORD) as server:
        with Peer(ready(server)["port"]) as peer:
            peer.ask({"type": "auth", "password": PASSWORD})
            server.terminate()
            peer.rest()
        assert server.wait(PATIENCE) == 0
    assert [line["event"] for line in lines(path)] == ["entered", "left"]
    with process("serve", *options[:-1], str(tmp_path / "no" / "access.log"), NMES_PASSWORD=PASSWORD) as server:
        _, err = server.communicate(timeout=PATIENCE)
    assert server.returncode == 1
    assert err == f"Error: {tmp_path / 'no' / 'access.log'}: No such file or directory\n"
