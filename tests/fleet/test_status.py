"""`nmes fleet status`: how many hosts fare, some of which do not answer."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import threading
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from nmes.cli import main
from nmes.errors import CommandFailed
from nmes.protocol import DELIMITER
from nmes.server.catalog import Catalog
from processes import NMES
from servers import PASSWORD, PATIENCE, served, until


def status(*arguments: str | Path, password: str = PASSWORD) -> Result:
    words = ["fleet", "status", *map(str, arguments)]
    result = CliRunner().invoke(main, words, env={"NMES_PASSWORD": password})
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


def test_worlds_clients_sleep_and_faults_are_counted() -> None:
    configs = [{"name": "red"}, {"name": "green"}, {"name": "blue"}]
    with served(*configs, hibernate_after=0.05) as server:
        with server.client(world="red") as red, server.client(world="red"), server.client(world="green") as green:
            red.spawn_cube("a", mass=1e-6)
            red.apply_force("a", force=[1e15, 0, 0])
            with pytest.raises(CommandFailed):
                red.step(100)
            green.step(2)
            until(lambda: server.host.worlds["blue"].world.asleep)
            address = f"127.0.0.1:{server.port}"
            result = status(address, "--json")
            assert result.exit_code == 0
            assert json.loads(result.output) == [
                {
                    **{"host": "127.0.0.1", "port": server.port, "error": None, "worlds": 3, "awake": 2, "asleep": 1},
                    **{"clients": 3, "lagging": 0, "ratio": 1.0, "faulted": ["red"]},
                }
            ]
            lines = [line.split() for line in status(address).output.splitlines()]
            assert lines == [
                ["HOST", "WORLDS", "AWAKE", "ASLEEP", "CLIENTS", "SLOWEST", "BEHIND", "FAULTS"],
                [address, "3", "2", "1", "3", "1.00", "0", "1:", "red"],
            ]


def test_all_pages_of_a_host_are_counted() -> None:
    with served({"name": "first"}, catalog=Catalog(most=5000)) as server:
        server.call(lambda: [server.host.offer({"name": f"w{n}", "backend": "ballistic"}) for n in range(2300)])
        (host,) = json.loads(status(f"127.0.0.1:{server.port}", "--json").output)
    assert (host["worlds"], host["awake"], host["asleep"]) == (2301, 1, 0)


def refusing() -> str:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return f"127.0.0.1:{listener.getsockname()[1]}"


def test_a_host_that_does_not_answer_is_a_row_of_its_own() -> None:
    with served() as server, socket.create_server(("127.0.0.1", 0)) as silent:
        deaf, gone, good = f"127.0.0.1:{silent.getsockname()[1]}", refusing(), f"127.0.0.1:{server.port}"
        result = status(deaf, gone, good, good, "--timeout", "0.5")
    assert result.exit_code == 1
    _, first, second, third, last = result.output.splitlines()
    assert first.split(maxsplit=1) == [deaf, "no answer within 0.5 s"]
    assert second.startswith(gone) and "cannot connect" in second
    assert third.split()[:2] == [good, "1"]
    assert last.split()[:4] == ["1", "of", "3", "1"]


def test_a_wrong_password_is_an_error_of_that_host() -> None:
    with served() as server:
        result = status(f"127.0.0.1:{server.port}", password="a guess")
    assert result.exit_code == 1 and "that is not the password" in result.output


@pytest.mark.parametrize(
    "answer",
    [
        b"HTTP/1.1 400 Bad Request\r\n\r\n",
        b'{"type":"world_list"}' + DELIMITER,
        b'{"type":"world_list","worlds":[{"world":7}]}' + DELIMITER,
        b'{"type":"world_list","worlds":{"a":1}}' + DELIMITER,
        b'{"type":"world_list","worlds":[],"next":1}' + DELIMITER,
        b'{"type":"auth_success"}' + DELIMITER,
        b"[]" + DELIMITER,
        b"\xff\x00" + DELIMITER,
    ],
)
def test_what_is_no_answer_is_told_as_such(answer: bytes) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(PATIENCE)
        over = threading.Event()

        def serve() -> None:
            while not over.is_set():
                peer, _ = listener.accept()
                with peer:
                    peer.settimeout(PATIENCE)
                    peer.recv(1 << 16)
                    peer.sendall(answer)
                    while peer.recv(1 << 16):
                        pass

        thread = threading.Thread(target=serve)
        thread.start()
        port = listener.getsockname()[1]
        (host,) = json.loads(status(f"127.0.0.1:{port}", "--json", "--timeout", "1").output)
        over.set()
        socket.create_connection(("127.0.0.1", port), PATIENCE).close()
        thread.join(PATIENCE)
    if b'"next":1' in answer:  # the same page again and again is not read for ever
        assert (host["error"], host["worlds"]) == (None, 0)
    else:
        assert host["error"], host


def test_a_file_of_hosts_is_in_utf_8_whatever_the_locale(tmp_path: Path) -> None:
    (tmp_path / "hosts").write_text("# those in Zürich\n", "utf-8")
    ascii_alone = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    command = [NMES, "fleet", "status", "--hosts", str(tmp_path / "hosts")]
    asked = subprocess.run(command, env={**os.environ, **ascii_alone}, capture_output=True, text=True)
    assert asked.returncode == 2 and "say which hosts" in asked.stderr, asked.stderr


def test_hosts_come_from_a_file_too(tmp_path: Path) -> None:
    with served() as server:
        file = tmp_path / "hosts"
        file.write_text(f"# ours\n\n127.0.0.1:{server.port}  # the first\n127.0.0.1:{server.port}\n")
        result = status("--hosts", file)
        assert result.exit_code == 0 and len(result.output.splitlines()) == 2


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ([], "say which hosts"),
        (["a:b"], "a port is from 1 to 65535"),
        (["a:0"], "a port is from 1 to 65535"),
        ([":14000"], "expected HOST or HOST:PORT"),
        (["::1"], "expected HOST or HOST:PORT"),
        (["a b"], "expected HOST or HOST:PORT"),
        (["a", "--timeout", "0"], "0.01"),
    ],
)
def test_what_is_no_address_is_wrong_usage(arguments: list[Any], reason: str) -> None:
    result = status(*arguments)
    assert result.exit_code == 2 and reason in result.output, result.output


def test_a_wrong_line_of_a_file_is_named(tmp_path: Path) -> None:
    file = tmp_path / "hosts"
    file.write_text("127.0.0.1\n127.0.0.1:port\n")
    result = status("--hosts", file)
    assert result.exit_code == 2 and "line 2: expected HOST or HOST:PORT" in result.output
    assert "a port is from 1 to 65535" in result.output
    file.write_bytes(b"\xff\xfe")
    assert "not a text in UTF-8" in status("--hosts", file).output
