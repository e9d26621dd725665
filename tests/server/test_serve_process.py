"""`nmes serve` as an administrator meets it: what it leaves behind, what it tells, and how it ends."""

from __future__ import annotations

import os
import pty
import re
import shlex
import signal
import socket
import subprocess
from pathlib import Path

import pytest

from layout import ROOT
from nmes.cli.serve import command
from nmes.recording import Recording
from processes import NMES, process, ready
from servers import PASSWORD, PATIENCE, Peer, types

STEPPED = ["--backend", "ballistic", "--mode", "lockstep"]


# -- a port that is taken ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("option", ["--port", "--metrics-port"])
def test_a_taken_port_leaves_no_recording_and_names_the_way_out(option: str, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = str(other.getsockname()[1])
        ports = {"--port": "0", option: port}
        arguments = [argument for pair in ports.items() for argument in pair]
        with process("serve", *STEPPED, *arguments, "--record", str(tmp_path / "kept"), NMES_PASSWORD="x") as server:
            out, err = server.communicate(timeout=PATIENCE)
    assert (server.returncode, out) == (1, "")
    assert err == f"Error: cannot listen on 127.0.0.1:{port}: Address already in use; {option} 0 finds a free port\n"
    assert not (tmp_path / "kept").exists()


def test_a_taken_port_among_many_worlds_leaves_no_recording(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1] - 1
        arguments = ["--worlds", "2", "--port", str(port), "--record", str(tmp_path / "kept")]
        with process("serve", *STEPPED, *arguments, NMES_PASSWORD="x") as server:
            _, err = server.communicate(timeout=PATIENCE)
    assert server.returncode == 1 and "cannot listen" in err
    assert not (tmp_path / "kept").exists()


# -- signals ----------------------------------------------------------------------------------------------------------


def test_a_host_that_is_told_to_stop_again_still_ends_whole(tmp_path: Path) -> None:
    with process(
        "serve", "--json", "--port", "0", *STEPPED, "--record", str(tmp_path), NMES_PASSWORD=PASSWORD
    ) as server:
        info = ready(server)
        with Peer(info["port"]) as watcher, Peer(info["port"], receive_buffer=4096) as deaf:
            for peer in (watcher, deaf):
                assert peer.ask({"type": "auth", "password": PASSWORD})["type"] == "auth_success"
            watcher.ask({"type": "subscribe"})
            deaf.say(*[{"type": "get_world_info"}] * 5000)  # for whom the host waits a while at its end
            server.send_signal(signal.SIGINT)
            assert types(watcher.rest())[-1] == "world_closed"
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
                server.send_signal(number)
            _, err = server.communicate(timeout=PATIENCE)
    assert (server.returncode, "Traceback" in err) == (0, False)
    assert Recording(info["recording"]).complete


def test_a_host_whose_terminal_is_gone_completes_its_recording_and_ends_with_status_0(tmp_path: Path) -> None:
    """Not only the signal comes: whatever is written to the terminal from then on fails."""
    arguments = [NMES, "serve", "--port", "0", *STEPPED, "--flush-interval", "60", "--record", str(tmp_path)]
    terminal, other_end = pty.openpty()
    environment = {**os.environ, "NMES_PASSWORD": PASSWORD}
    server = subprocess.Popen(arguments, env=environment, stdin=other_end, stdout=other_end, stderr=other_end)
    os.close(other_end)
    shown = b""
    while b"Ctrl-C stops" not in shown:
        shown += os.read(terminal, 4096)
    port = int(shown.split(b"Listening on 127.0.0.1:")[1].split()[0])
    with Peer(port) as peer:
        assert peer.ask({"type": "auth", "password": PASSWORD})["type"] == "auth_success"
        peer.ask({"type": "spawn_cube", "cube_name": "kept"})
        os.close(terminal)
        server.send_signal(signal.SIGHUP)
        peer.rest()
    assert server.wait(PATIENCE) == 0
    (path,) = tmp_path.iterdir()
    recording = Recording(path)
    assert recording.complete and b'"kept"' in b"".join(record.data for record in recording)


# -- as a service -----------------------------------------------------------------------------------------------------


def test_the_units_of_the_page_start_what_there_is() -> None:
    text = (ROOT / "docs" / "hosting.md").read_text().replace("\\\n", " ")
    lines = re.findall(r"^ExecStart=/opt/nmes/bin/nmes serve (.*)$", text, re.MULTILINE)
    assert len(lines) == 2
    known = {name for option in command.params for name in option.opts}
    for line in lines:
        given = {word for word in shlex.split(line) if word.startswith("--")}
        assert len(given) >= 5 and given <= known
    service = text[text.index("[Service]") :]
    assert "StateDirectory=nmes\n" in service and "--record /var/lib/nmes/" in lines[0]
    assert "LogsDirectory=nmes\n" in service and "--access-log /var/log/nmes/" in lines[0]
