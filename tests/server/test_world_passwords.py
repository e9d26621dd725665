"""Passwords that open one world of a host, and no other."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from nmes import Client
from nmes.cli import main
from nmes.errors import CommandFailed
from nmes.protocol import DELIMITER
from nmes.recording import Recording
from nmes.server import Host
from processes import process, ready
from servers import PASSWORD, PATIENCE, Peer

OWN = {"red": "for red only", "green": "for green only"}


async def enter(password: str, world: str | None = None, *, port: int) -> str:
    """Returns the world that a password leads to, or the code of the refusal."""

    def ask() -> str:
        with Peer(port) as peer:
            auth = {"type": "auth", "password": password, **({} if world is None else {"world": world})}
            answer = peer.ask(auth)
            return str(answer.get("world") or answer.get("code"))

    return await asyncio.to_thread(ask)


async def listening(host: Host) -> tuple[int, int]:
    """Serves three worlds, and returns the port of all, whose clients get the first, and that of `green`."""
    for name in ("red", "green", "blue"):
        host.offer({"backend": "ballistic", "mode": "lockstep", "name": name}, OWN.get(name))
    return (await host.listen("127.0.0.1", 0))[1], (await host.listen("127.0.0.1", 0, "green"))[1]


@pytest.mark.parametrize(
    ("password", "world", "leads_to"),
    [
        (PASSWORD, None, "red"),
        (PASSWORD, "green", "green"),
        (PASSWORD, "blue", "blue"),
        (PASSWORD, "pink", "world_not_found"),
        (OWN["red"], "red", "red"),
        (OWN["red"], None, "red"),
        (OWN["red"], "green", "auth_failed"),
        (OWN["red"], "blue", "auth_failed"),
        (OWN["red"], "pink", "auth_failed"),
        (OWN["green"], None, "green"),
        (OWN["green"], "green", "green"),
        (OWN["green"], "red", "auth_failed"),
        ("for green", "green", "auth_failed"),
        ("", "green", "auth_failed"),
    ],
)
async def test_a_worlds_own_password_opens_that_world_alone(password: str, world: str | None, leads_to: str) -> None:
    async with Host(PASSWORD, auth_delay=0.0) as host:
        port, _ = await listening(host)
        assert await enter(password, world, port=port) == leads_to


async def test_the_port_of_a_world_is_for_its_own_password() -> None:
    async with Host(PASSWORD, auth_delay=0.0) as host:
        _, port = await listening(host)
        assert await enter(OWN["green"], port=port) == "green"
        assert await enter(OWN["red"], port=port) == "auth_failed"
        assert await enter(OWN["red"], "red", port=port) == "red"
        assert await enter(PASSWORD, port=port) == "green"


def test_nmes_serve_takes_a_folder_of_passwords_and_lists_only_what_they_open(tmp_path: Path) -> None:
    for name, password in OWN.items():
        (tmp_path / name).write_text(f"{password}\nnot this line")
    options = [
        "--worlds",
        "red,green,blue",
        "--port",
        "0",
        "--backend",
        "ballistic",
        "--mode",
        "lockstep",
        "--no-record",
    ]
    with process("serve", "--json", *options, "--world-passwords", str(tmp_path), NMES_PASSWORD=PASSWORD) as server:
        line = ready(server)
        assert not any(password in json.dumps(line) for password in OWN.values())

        def names(password: str) -> list[str]:
            listing = ["worlds", f"127.0.0.1:{line['port']}", "--json"]
            outcome = CliRunner().invoke(main, listing, env={"NMES_PASSWORD": password})
            return [world["world"] for world in json.loads(outcome.output)] if outcome.exit_code == 0 else []

        assert [names(PASSWORD), names(OWN["green"]), names("neither")] == [["red", "green", "blue"], ["green"], []]
        with Peer(line["port"]) as old:
            old.send(OWN["red"].encode() + DELIMITER)  # the raw dialect
            assert old.frame() == b"auth_success"
        with pytest.raises(CommandFailed, match="not the password"):
            Client(port=line["port"], password=OWN["red"], world="blue", timeout=PATIENCE).connect()
        with pytest.raises(CommandFailed, match="not the password"):  # of the host, which closing takes
            Client(port=line["port"], password=OWN["red"], timeout=PATIENCE).close_world("red")
        assert names(PASSWORD) == ["red", "green", "blue"]


@pytest.mark.parametrize(("file", "text", "says"), [("pink", "x", "no world 'pink'"), ("main", "\n", "is empty")])
def test_a_folder_that_does_not_fit_is_refused(file: str, text: str, says: str, tmp_path: Path) -> None:
    folder = tmp_path / "passwords"
    folder.mkdir()
    (folder / file).write_text(text)
    arguments = ["serve", "--port", "0", "--record", str(tmp_path / "kept"), "--world-passwords", str(folder)]
    outcome = CliRunner().invoke(main, arguments, env={"NMES_PASSWORD": PASSWORD})
    assert outcome.exit_code == 2 and says in outcome.output and str(folder / file) in outcome.output
    assert not (tmp_path / "kept").exists()


def test_a_single_world_has_its_own_password_too_and_no_recording_holds_one(tmp_path: Path) -> None:
    folder = tmp_path / "passwords"
    folder.mkdir()
    (folder / "..data").mkdir()  # as Kubernetes mounts a Secret
    (folder / "..data" / "main").write_text("for main only")
    (folder / "main").symlink_to("..data/main")
    (folder / ".keep").touch()
    options = ["--port", "0", "--backend", "ballistic", "--mode", "lockstep", "--record", str(tmp_path / "kept")]
    with process("serve", "--json", *options, "--world-passwords", str(folder), NMES_PASSWORD=PASSWORD) as server:
        line = ready(server)
        for password in (PASSWORD, "for main only"):
            with Client(port=line["port"], password=password, timeout=PATIENCE) as client:
                client.step()
        server.terminate()
        assert server.wait(PATIENCE) == 0
    assert Recording(line["recording"]).complete
    assert b"for main only" not in Path(line["recording"]).read_bytes()
