"""Workers: one host of many processes, whose worlds outlive any of them."""

from __future__ import annotations

import asyncio
import errno
import json
import os
import random
import signal
import socket
import ssl
import sys
import threading
import time
import urllib.request
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping
from contextlib import ExitStack, asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import trustme
from click.testing import CliRunner

from fleets import PLAIN, Driver, Fleet, fleet, kill, settle
from nmes import AsyncClient
from nmes.cli import main
from nmes.cli._serve_worker import command_of_worker
from nmes.errors import CommandFailed, Disconnected, MachineError
from nmes.fleet.supervisor import Supervisor, shares_of_guesses
from nmes.playback import replay
from nmes.protocol import DELIMITER, Limits
from nmes.recording import Recording
from nmes.server.door import Guesses
from nmes.server.keys import Keys
from processes import process, ready
from servers import PASSWORD, PATIENCE, Peer, types

Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]

BALLISTIC = {"backend": "ballistic", "mode": "lockstep"}
DURABLE = ("--flush-interval", "0")
MAKER = "the word of ann"


@pytest.fixture(scope="module")
def host(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    """A host of two workers for tests that end none of them."""
    folder = tmp_path_factory.mktemp("fleet")
    makers = folder / "makers"
    makers.mkdir()
    (makers / "ann").write_text(MAKER)
    templates = folder / "templates"
    templates.mkdir()
    (templates / "broken.json").write_text(json.dumps({**BALLISTIC, "scene": {"type": "heightfield"}}))
    folders = ["--makers", str(makers), "--templates", str(templates)]
    options = ["--worlds", "red,green,blue", "--metrics-port", "0", *folders]
    with fleet(folder / "kept", *PLAIN, *options, "--access-log", str(folder / "access.log")) as running:
        yield running
        running.stop()


# -- one host --------------------------------------------------------------------------------------------------------


def test_clients_meet_one_host_whichever_worker_has_their_world(host: Fleet) -> None:
    frames: dict[str, int] = {}
    for name in ("red", "green", "blue"):
        with host.client(name) as client:
            assert client.welcome["world"] == name
            frames[name] = client.get_world_info()["frame"] + 2
            assert client.step(2)["frame"] == frames[name]
    with host.client() as client:
        assert client.welcome["world"] == "red"  # who names none gets the first
    listed = host.worlds()
    assert [(name, listed[name]["frame"]) for name in listed] == list(frames.items())
    assert {world["port"] for world in listed.values()} == {host.port}
    assert listed["red"]["worker_port"] == listed["blue"]["worker_port"] != listed["green"]["worker_port"]
    assert len(host.homes()) == 2


def test_all_that_was_sent_with_the_password_is_done_in_order(host: Fleet) -> None:
    spawns = [{"type": "spawn_cube", "cube_name": f"c{number}", "id": number} for number in range(4000)]
    with Peer(host.port) as peer:
        peer.say({"type": "auth", "password": PASSWORD, "world": "green", "id": "in"}, *spawns)
        assert peer.hear()["id"] == "in"
        assert [peer.hear()["id"] for _ in spawns] == list(range(4000))
        assert peer.ask({"type": "reset"})["type"] != "error"
    with Peer(host.port) as peer:
        peer.send(b"".join(bytes([byte]) for byte in PASSWORD.encode()) + DELIMITER)
        assert peer.frame() == b"auth_success"


def test_what_is_refused_is_refused_as_by_one_process(host: Fleet) -> None:
    for options, code in (
        ({"world": "pink"}, "world_not_found"),
        ({"world": "red", "password": "guess"}, "auth_failed"),
        ({"world": "red", "password": MAKER}, "auth_failed"),
        ({"world": "red", "token": "1-" + "0" * 64}, "auth_failed"),
    ):
        with pytest.raises(CommandFailed) as refused:
            host.client(**options).connect()
        assert refused.value.code == code


def test_worlds_are_created_where_there_are_fewest_and_closed_for_good(host: Fleet) -> None:
    ann = host.client(password=MAKER)
    made = [ann.create_world(f"made-{number}") for number in range(4)]
    ports = [world["worker_port"] for world in made]
    assert {ports.count(port) for port in ports} == {2}
    with pytest.raises(CommandFailed, match="a world 'red' already"):
        ann.create_world("red")
    with host.client("made-1", password=MAKER) as inside:
        inside.subscribe(events=["tick"])
        assert [world["world"] for world in ann.close_world("made-1")] == ["made-0", "made-2", "made-3"]
        assert [event["type"] for event in inside.events(PATIENCE)] == ["world_closed"]
    (recording,) = host.folder.glob("made-1-*.mcap")
    assert Recording(recording).complete and replay(recording).verdict == "reproduced"
    for name in ("made-0", "made-2", "made-3"):
        ann.close_world(name)
    assert sorted(host.worlds()) == ["blue", "green", "red"]


def test_a_workers_own_port_is_for_entering_its_worlds(host: Fleet) -> None:
    with host.client("red") as client:
        client.ping()
    own = host.worlds()["red"]["worker_port"]
    with host.client("red", port=own) as client:
        assert client.welcome["world"] == "red"
    with pytest.raises(CommandFailed, match="ask the host's own"):
        host.client(port=own).create_world("x")
    with pytest.raises(CommandFailed, match="ask the host's own"):
        host.client(port=own).close_world("red")
    with pytest.raises(CommandFailed, match="not the password"):
        host.client("red", port=own, password="guess").connect()


def test_wrong_passwords_at_a_workers_own_port_are_few(host: Fleet) -> None:
    with host.client("red") as client:
        client.ping()
    own = host.worlds()["red"]["worker_port"]
    with ExitStack() as stack:
        peers = [stack.enter_context(Peer(own, source="127.0.0.9")) for _ in range(40)]
        for peer in peers:
            peer.say({"type": "auth", "password": "guess", "world": "red"})
        said = [json.loads(peer.rest()[-1])["message"] for peer in peers]
    assert any(each.startswith("too many wrong passwords") for each in said)
    assert said[0] == "that is not the password"


@pytest.mark.parametrize("workers", [1, 2, 4, 7, 15, 16, 30, 45])
def test_all_ports_together_hear_an_address_as_often_as_one(workers: int) -> None:
    own, each = shares_of_guesses(workers)
    ports = [Guesses(part) for part in (own, *[each] * workers)]
    heard, (size, rate), seconds = [0] * len(ports), Guesses.ADDRESS, 240
    for now in range(1000, 1000 + seconds):
        for number, port in enumerate(ports):
            while port.wait("a", float(now)) == 0.0:
                port.wrong("a", float(now))
                heard[number] += 1
        assert sum(heard) <= size + rate * (now - 1000)
    assert min(heard) >= 1 and sum(heard) >= seconds // 2


def test_one_page_has_the_figures_of_all_workers(host: Fleet) -> None:
    for name in ("red", "green"):
        with host.client(name) as client:
            client.step()
    url = f"http://127.0.0.1:{host.info['metrics_port']}/metrics"
    page = urllib.request.urlopen(url, timeout=PATIENCE).read().decode()
    assert 'nmes_worlds{worker="1"}' in page and 'nmes_worlds{worker="2"}' in page
    assert "nmes_workers 2.0" in page and "nmes_worker_restarts_total 0.0" in page
    assert page.count("# TYPE nmes_tick_seconds histogram") == 1


def test_the_access_log_has_one_line_for_each_coming_and_going(host: Fleet) -> None:
    log = host.folder.parent / "access.log"
    with host.client("red") as client:
        port = client._socket.getsockname()[1]  # type: ignore[union-attr]
        client.ping()

    def lines() -> list[Any]:
        return [line for line in map(json.loads, log.read_text().splitlines()) if line["from"] == f"127.0.0.1:{port}"]

    settle(lambda: len(lines()) >= 2)
    assert [(line["event"], line["world"]) for line in lines()] == [("entered", "red"), ("left", "red")]


def test_a_client_that_hangs_up_is_counted_out_and_its_socket_closed(host: Fleet) -> None:
    before = len(os.listdir(f"/proc/{host.server.pid}/fd"))
    peers = [Peer(host.port) for _ in range(20)]
    for peer in peers:
        assert peer.ask({"type": "auth", "password": PASSWORD, "world": "blue"})["type"] == "auth_success"
    assert host.worlds()["blue"]["clients"] == 20
    for number, peer in enumerate(peers):
        if number % 2:
            peer.hang_up()
            assert peer.rest() == []  # and the host closes its side
        peer.socket.close()
    settle(lambda: host.worlds()["blue"]["clients"] == 0)
    settle(lambda: len(os.listdir(f"/proc/{host.server.pid}/fd")) <= before + 1)


# -- a worker that ends ----------------------------------------------------------------------------------------------


def test_worlds_of_a_worker_that_is_killed_go_on_and_nothing_acknowledged_is_lost(tmp_path: Path) -> None:
    with fleet(tmp_path, *PLAIN, *DURABLE, "--worlds", "red,green") as host, ExitStack() as peers:
        drivers = [Driver(host, name, BALLISTIC) for name in ("red", "green")]
        for number in range(10):
            for driver in drivers:
                driver.push(number)
        peer, raw = (peers.enter_context(Peer(host.port)) for _ in range(2))
        assert peer.ask({"type": "auth", "password": PASSWORD, "id": 7})["id"] == 7
        raw.send(PASSWORD.encode() + DELIMITER)
        assert raw.frame() == b"auth_success"
        kill(host.workers()[0])
        (error,) = map(json.loads, peer.rest())
        assert error == {"type": "error", "code": "world_moved", "message": error["message"]}
        assert "connect again" in error["message"]
        assert types(raw.rest()) == ["error"]
        for number in range(10, 30):
            for driver in drivers:
                driver.push(number)
        (first, second) = drivers
        assert len(first.pauses) == 1 and first.told <= {"world_moved", "disconnected"}
        assert second.pauses == []  # others are not touched
        settle(lambda: len(host.workers()) == 2)
        for driver in drivers:
            driver.close()
        host.stop()
        for name, driver in zip(("red", "green"), drivers, strict=True):
            assert host.digests(name) == driver.digests
        old, new = sorted(tmp_path.glob("red-*.mcap"))
        assert Recording(new).metadata["nmes.parent"]["file"] == old.name
        assert Recording(new).complete and replay(new).verdict == "reproduced"


def test_players_come_back_with_their_tokens_wherever_their_world_is(tmp_path: Path) -> None:
    (tmp_path / "arena.json").write_text(json.dumps({**BALLISTIC, "roles": {"player": {}}}))
    secret = tmp_path / "player"
    secret.write_text("of players")
    options = ["--config", str(tmp_path / "arena.json"), "--role", f"player={secret}", *DURABLE]
    with fleet(tmp_path / "kept", *options) as host, host.client(password="of players") as client:
        player, token = client.welcome["player"], client.token
        client.spawn_cube("mine")
        for number in (signal.SIGKILL, signal.SIGTERM):
            for worker in host.workers():
                os.kill(worker, number)
            with pytest.raises(Disconnected):
                while True:
                    client.ping()
                    time.sleep(0.01)
            client.reconnect()
            assert (client.welcome["player"], client.token) == (player, token)
            client.despawn_cube("mine")  # what belongs to another he could not
            client.spawn_cube("mine")
        with pytest.raises(CommandFailed, match="token"):
            host.client(password="of players", token=f"{player}-{'0' * 64}").connect()


def test_a_world_that_slept_in_a_worker_that_died_wakes_in_another(tmp_path: Path) -> None:
    with fleet(tmp_path, *PLAIN, "--hibernate-after", "0.2") as host:
        with host.client() as client:
            client.spawn_cube("a", position=[0, 3, 0])
            client.step(5)
        settle(lambda: bool(host.worlds()["main"]["asleep"]))
        for worker in host.workers():
            kill(worker)
        settle(lambda: len(host.workers()) == 2)
        world = host.worlds()["main"]
        assert (world["asleep"], world.get("worker_port")) == (True, None)
        with host.client() as client:
            assert client.step()["frame"] == 6
        host.stop()
        assert len(host.digests("main")) == 6


@pytest.mark.long
def test_worlds_outlive_all_workers_at_once_and_one_that_was_alone(tmp_path: Path) -> None:
    with fleet(tmp_path, *PLAIN, *DURABLE, workers=1) as host:
        driver = Driver(host, "main", BALLISTIC)
        for number in range(12):
            if number % 4 == 3:
                for worker in host.workers():
                    kill(worker)
            driver.push(number)
        driver.close()
        host.stop()
        assert host.digests("main") == driver.digests and len(driver.pauses) == 3


# -- moved -----------------------------------------------------------------------------------------------------------

CONTACTS = {"backend": "mujoco", "mode": "lockstep"}


@pytest.mark.parametrize(
    "config", [pytest.param(BALLISTIC, id="ballistic", marks=pytest.mark.long), pytest.param(CONTACTS, id="mujoco")]
)
def test_a_world_that_moves_under_load_goes_on_as_one_that_does_not(config: dict[str, Any], tmp_path: Path) -> None:
    """Workers are told to end again and again, while a client drives the world and others stay in it."""
    options = ["--backend", config["backend"], "--mode", "lockstep"]
    with fleet(tmp_path, *options, "--worlds", "red,green") as host:
        driver, other = Driver(host, "red", config), Driver(host, "green", config)
        told: list[int] = []
        number = 0
        while len(driver.pauses) + len(other.pauses) < 3:
            workers = host.workers()
            if len(workers) == 2 and len(told) == len(driver.pauses) + len(other.pauses):
                told.append(workers[0])
                os.kill(workers[0], signal.SIGTERM)
            driver.push(number)
            other.push(number)
            number += 1
            assert number < 20_000
        assert driver.told | other.told == {"world_moved"}
        driver.close()
        other.close()
        assert sorted(name for names in host.homes().values() for name in names) == ["green", "red"]
        host.stop()
        assert host.digests("red") == driver.digests
        assert host.digests("green") == other.digests
        for path in tmp_path.glob("*.mcap"):
            assert Recording(path).complete and replay(path).verdict == "reproduced", path


@pytest.mark.long
def test_worlds_are_shared_anew_when_a_worker_is_back(tmp_path: Path) -> None:
    names = [f"w{number}" for number in range(8)]
    with fleet(tmp_path, *PLAIN, *DURABLE, "--worlds", ",".join(names)) as host:
        drivers = [Driver(host, name, BALLISTIC) for name in names]
        for driver in drivers:
            driver.push(0)
        kill(host.workers()[0])
        number = 1

        def shared() -> bool:
            nonlocal number
            for driver in drivers:
                driver.push(number)
            number += 1
            return sorted(map(len, host.homes().values())) in ([3, 5], [4, 4])

        settle(shared)
        for driver in drivers:
            driver.close()
        host.stop()
        assert [host.digests(name) for name in names] == [driver.digests for driver in drivers]


# -- the end ---------------------------------------------------------------------------------------------------------


def test_a_host_that_is_told_to_stop_has_all_workers_end_whole(tmp_path: Path) -> None:
    with fleet(tmp_path, *PLAIN, "--worlds", "red,green", "--flush-interval", "60") as host:
        watchers = [host.client(name).connect() for name in ("red", "green")]
        for client in watchers:
            client.subscribe(events=["tick"])
            client.spawn_cube("kept")
        workers = host.workers()
        for pid in workers:  # as a service manager does, which tells all processes at once
            os.kill(pid, signal.SIGTERM)
        host.stop()
        for client in watchers:
            with pytest.raises(Disconnected) as over:
                while True:
                    client.ping()
            assert over.value.code in ("world_closed", "world_moved")
            client.close()
        for pid in workers:
            assert not Path(f"/proc/{pid}").exists()
        for name in ("red", "green"):
            paths = list(tmp_path.glob(f"{name}-*.mcap"))
            assert paths and all(Recording(path).complete for path in paths)


def test_workers_whose_supervisor_is_killed_complete_their_recordings_and_end(tmp_path: Path) -> None:
    with fleet(tmp_path, *PLAIN, "--worlds", "red,green", "--flush-interval", "60") as host:
        clients = [host.client(name).connect() for name in ("red", "green")]
        for client in clients:
            client.spawn_cube("kept")
            client.step(7)
        workers = host.workers()
        kill(host.server.pid)
        host.server.wait(PATIENCE)
        settle(lambda: not any(_runs(pid) for pid in workers))
        for client in clients:
            client.close()
        paths = sorted(tmp_path.glob("*.mcap"))
        assert len(paths) == 2
        for path in paths:
            recording = Recording(path)
            assert recording.complete and recording.last_frame == 7


def _runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


# -- what does not go ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--no-record"], "--workers does not go with --no-record: worlds come back from their recordings"),
        (["--workers", "0"], "0 is not in the range 1<=x<=256"),
        (["--config", "missing.json"], "missing.json"),
        (["--backend", "none"], "none"),
        (["--worlds", "30", "--max-worlds", "20", "--port-step", "0"], "30 worlds are more than --max-worlds 20"),
    ],
)
def test_options_that_do_not_fit_are_refused(arguments: list[str], says: str, tmp_path: Path) -> None:
    options = ["serve", "--port", "0", "--workers", "2", "--record", str(tmp_path / "kept"), *arguments]
    outcome = CliRunner().invoke(main, options, env={"NMES_PASSWORD": PASSWORD})
    assert outcome.exit_code in (1, 2) and says in outcome.output and "Traceback" not in outcome.output


def test_one_recording_is_of_one_process(tmp_path: Path) -> None:
    with process("serve", "--json", "--port", "0", *PLAIN, "--record", str(tmp_path), NMES_PASSWORD="x") as server:
        recording = ready(server)["recording"]
        server.terminate()
        server.wait(PATIENCE)
    outcome = CliRunner().invoke(main, ["serve", "--workers", "2", "--resume", recording])
    assert outcome.exit_code == 2 and "--workers goes with --resume FOLDER" in outcome.output


@pytest.mark.parametrize(
    ("command", "says"),
    [
        ([sys.executable, "-c", "raise SystemExit(3)"], "worker 1 did not start: it ended with status 3"),
        (["no such program"], "worker 1 cannot be started: No such file"),
    ],
)
async def test_a_worker_that_does_not_start_is_told_of(command: list[str], says: str, tmp_path: Path) -> None:
    async with Supervisor(Keys("x", {}, {}), command, record_to=tmp_path, address="127.0.0.1") as host:
        with pytest.raises(MachineError, match=says):
            await host.start(2)


async def test_a_client_that_is_handed_over_while_its_world_goes_elsewhere_is_told_so(
    tmp_path: Path,
) -> None:
    options: dict[str, Any] = {"record_to": tmp_path, "address": "127.0.0.1"}
    async with Supervisor(Keys(PASSWORD, {}, {}), command_of_worker("text", 10), **options) as host:
        host.offer({"name": "red", **BALLISTIC})
        await host.start(1)
        _, port = await host.listen("127.0.0.1", 0)
        assert await host.open("red") is None
        (worker,) = host.workers.running
        await worker.line.ask("release", world="red")  # as where it comes between a client and its worker
        with pytest.raises(CommandFailed) as refused:
            await AsyncClient(port=port, password=PASSWORD, world="red", timeout=PATIENCE).connect()
        assert refused.value.code == "world_moved" and "'red'" in refused.value.message


async def test_recordings_that_a_worker_lost_before_it_was_drained_are_told_of_in_the_end(tmp_path: Path) -> None:
    options: dict[str, Any] = {"record_to": tmp_path, "address": "127.0.0.1", "flush_interval": 0.0}
    async with Supervisor(Keys(PASSWORD, {}, {}), command_of_worker("text", 10), **options) as host:
        host.offer({"name": "red", **BALLISTIC})
        await host.start(1)
        _, port = await host.listen("127.0.0.1", 0)
        assert await host.open("red") is None
        (recording,) = tmp_path.iterdir()
        recording.unlink()
        with pytest.raises((CommandFailed, Disconnected)):
            async with AsyncClient(port=port, password=PASSWORD, world="red", timeout=PATIENCE) as client:
                await client.step()
        (worker,) = host.workers.running
        worker.process.terminate()
        async with asyncio.timeout(PATIENCE):
            await worker.ended.wait()
    ((name, why),) = host.lost
    assert name == "red" and "it was removed while it was written" in why


async def test_a_worker_is_started_again_once_there_are_descriptors_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nmes.fleet.worker_processes.RETRY", (0.01, 0.01))
    options: dict[str, Any] = {"record_to": tmp_path, "address": "127.0.0.1"}
    async with Supervisor(Keys(PASSWORD, {}, {}), command_of_worker("text", 10), **options) as host:
        await host.start(1)
        pair, refused = socket.socketpair, 0

        def refuse() -> tuple[socket.socket, socket.socket]:
            nonlocal refused
            refused += 1
            if refused < 3:
                raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
            return pair()

        monkeypatch.setattr("nmes.fleet.worker_processes.socket.socketpair", refuse)
        host.workers.running[0].process.kill()
        async with asyncio.timeout(PATIENCE):
            while host.workers.restarts < 1:
                await asyncio.sleep(0.01)
        assert refused == 3 and len(host.workers.running) == 1


async def test_a_worker_that_hangs_is_ended_and_its_worlds_go_on_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nmes.fleet.worker_processes.WATCH", 0.5)
    monkeypatch.setattr("nmes.fleet.worker_processes.SILENT", 8)
    command = command_of_worker("text", 10)
    options: dict[str, Any] = {"record_to": tmp_path, "address": "127.0.0.1", "flush_interval": 0.0}
    async with Supervisor(Keys(PASSWORD, {}, {}), command, **options) as host:
        host.offer({"name": "red", **BALLISTIC})
        await host.start(2)
        _, port = await host.listen("127.0.0.1", 0)
        async with AsyncClient(port=port, password=PASSWORD, world="red") as client:
            assert (await client.step(ticks=3))["frame"] == 3
            (home,) = [worker for worker in host.workers.running if "red" in worker.awake]
            await asyncio.sleep(6.0)  # one that has nothing to do hangs not
            assert host.workers.restarts == 0
            os.kill(home.process.pid, signal.SIGSTOP)
            async with asyncio.timeout(PATIENCE):
                with pytest.raises((CommandFailed, Disconnected)):
                    await client.step()
                await client.reconnect()
            assert (await client.step())["frame"] == 4
        async with asyncio.timeout(PATIENCE):
            while host.workers.restarts < 1:
                await asyncio.sleep(0.05)


def test_a_port_that_is_taken_leaves_no_worker_behind(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = str(other.getsockname()[1])
        arguments = ["serve", "--workers", "2", "--port", port, "--record", str(tmp_path / "kept"), *PLAIN]
        with process(*arguments, NMES_PASSWORD="x") as server:
            _, err = server.communicate(timeout=PATIENCE)
    assert server.returncode == 1 and "cannot listen" in err and "Traceback" not in err


def test_a_world_that_cannot_be_is_told_of_and_others_are_not_touched(host: Fleet) -> None:
    with host.client("red") as client:
        with pytest.raises(CommandFailed) as refused:
            host.client().create_world("pink", template="broken")
        assert refused.value.code == "world_unavailable" and "no scenery" in refused.value.message
        assert host.client().create_world("pink")["frame"] == 0  # the name is free
        host.client().close_world("pink")
        client.ping()


@pytest.mark.long
def test_a_world_whose_recording_is_gone_is_told_of_and_others_come_back(tmp_path: Path) -> None:
    with fleet(tmp_path, *PLAIN, *DURABLE, "--worlds", "red,green", workers=1) as host:
        for name in ("red", "green"):
            with host.client(name) as client:
                client.step()
        (recording,) = tmp_path.glob("red-*.mcap")
        recording.unlink()
        kill(host.workers()[0])
        settle(lambda: host.worlds()["red"]["fault"] is not None)
        with host.client("green") as client:
            assert client.step()["frame"] == 2
        with pytest.raises(CommandFailed) as refused:
            host.client("red").connect()
        assert refused.value.code == "world_unavailable"


# -- TLS -------------------------------------------------------------------------------------------------------------


def test_bytes_are_carried_where_there_is_tls_and_clients_are_told_all_the_same(tmp_path: Path) -> None:
    authority = trustme.CA()
    files = tmp_path / "cert.pem", tmp_path / "key.pem"
    certificate = authority.issue_cert("127.0.0.1")
    certificate.cert_chain_pems[0].write_to_path(files[0])
    certificate.private_key_pem.write_to_path(files[1])
    trusted = tmp_path / "authority.pem"
    authority.cert_pem.write_to_path(trusted)
    options = ["--tls-cert", str(files[0]), "--tls-key", str(files[1]), *DURABLE]
    with fleet(tmp_path / "kept", *PLAIN, *options) as host:
        with host.client(tls_ca=trusted) as client:
            with client.pipeline() as many:
                for _ in range(1000):
                    many.spawn_cube(list=False)
                for _ in range(20):
                    many.get_world_state()
            assert {len(call.result()["cubes"]) for call in many.calls[1000:]} == {1000}
            own = client.worlds()[0]["worker_port"]
            with host.client(tls_ca=trusted, port=own) as beside:
                assert beside.welcome["world"] == "main"
            kill(host.workers()[0])
            with pytest.raises(Disconnected) as lost:
                while True:
                    client.ping()
            assert lost.value.code == "world_moved"
            client.reconnect()
            assert client.get_world_info()["counts"]["cubes"] == 1000
        host.stop()


@asynccontextmanager
async def over_tls(folder: Path) -> AsyncIterator[tuple[Supervisor, Callable[[], Awaitable[Streams]]]]:
    """Runs a host of one worker; yields it, and what opens connections to it whose clients have not said anything."""
    authority, identity = trustme.CA(), ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    authority.issue_cert("127.0.0.1").configure_cert(identity)
    trust = ssl.create_default_context()
    authority.configure_trust(trust)
    options: dict[str, Any] = {"record_to": folder, "address": "127.0.0.1", "tls": identity}
    async with Supervisor(Keys(PASSWORD, {}, {}), command_of_worker("text", 10), **options) as host:
        host.offer({"name": "red", **BALLISTIC})
        host.limits = Limits(pending=1 << 20)
        await host.start(1)
        _, port = await host.listen("127.0.0.1", 0)
        yield host, partial(asyncio.open_connection, "127.0.0.1", port, ssl=trust)


async def ask(streams: Streams, *messages: Mapping[str, Any]) -> list[Any]:
    """Says messages in one write, and returns as many."""
    reader, writer = streams
    writer.write(b"".join(json.dumps(message).encode() + DELIMITER for message in messages))
    return [json.loads((await reader.readuntil(DELIMITER)).removesuffix(DELIMITER)) for _ in messages]


async def test_who_reads_slowly_over_tls_is_not_cut_off_but_who_stops_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    looks, now = 0, time.monotonic()

    def clock() -> float:
        nonlocal looks
        looks += 1
        return now

    async with over_tls(tmp_path) as (host, connect):
        reader, writer = streams = await connect()
        spawns = [{"type": "spawn_cube", "cube_name": f"c{number}"} for number in range(300)]
        await ask(streams, {"type": "auth", "password": PASSWORD}, {"type": "batch", "commands": spawns})
        (visitor,) = host.workers.running[0].visitors.values()
        writer.write(1500 * (b'{"type":"get_world_state"}' + DELIMITER))
        with monkeypatch.context() as patched:
            patched.setattr("nmes.server.reception.monotonic", clock)
            for rest in (*[0.6] * 6, 1.2):  # of the time for which one may read nothing
                async with asyncio.timeout(PATIENCE):
                    if rest < 1:
                        await reader.readexactly(2 << 20)
                    while not visitor.draining:
                        await asyncio.sleep(0.01)
                    now += rest * host.limits.stall_timeout
                    seen = looks
                    while looks == seen:
                        await asyncio.sleep(0.01)
                assert (rest > 1) == ("is cut off" in caplog.text)
        writer.transport.abort()


async def test_who_leaves_over_tls_leaves_nothing_in_the_log(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    async with over_tls(tmp_path) as (host, connect):
        streams = await connect()
        await ask(streams, {"type": "auth", "password": PASSWORD})
        streams[1].close()
        await streams[1].wait_closed()
        async with asyncio.timeout(PATIENCE):
            while host.connections:
                await asyncio.sleep(0.01)
    assert caplog.text == ""


# -- again and again -------------------------------------------------------------------------------------------------


def kill_at_random(host: Fleet, kills: int, draw: random.Random, over: Callable[[], bool]) -> None:
    """Kills a worker, whichever, again and again, before and after those that died are back."""
    for _ in range(kills):
        time.sleep(draw.uniform(0.05, 1.2))
        settle(lambda: bool(host.workers()))
        kill(draw.choice(host.workers()))
        if over():
            return


def survive(folder: Path, kills: int, seed: int) -> list[float]:
    """Kills workers at random moments while clients drive worlds; returns the pauses of the worlds (s)."""
    names = [f"w{number}" for number in range(4)]
    draw = random.Random(seed)
    with fleet(folder, *PLAIN, *DURABLE, "--worlds", ",".join(names)) as host:
        drivers = [Driver(host, name, BALLISTIC) for name in names]
        failed: list[BaseException] = []
        stop = threading.Event()

        def drive(driver: Driver) -> None:
            try:
                number = 0
                while not stop.is_set():
                    driver.push(number)
                    number += 1
            except BaseException as error:
                failed.append(error)

        threads = [threading.Thread(target=drive, args=[driver]) for driver in drivers]
        for thread in threads:
            thread.start()
        try:
            kill_at_random(host, kills, draw, lambda: bool(failed))
            time.sleep(1.0)
        finally:
            stop.set()
            for thread in threads:
                thread.join(PATIENCE)
        assert not failed, failed
        assert sorted(host.worlds()) == names
        # Those that are moved to a worker that is back are nowhere for a moment.
        settle(lambda: sorted(name for here in host.homes().values() for name in here) == names)
        for driver in drivers:
            driver.close()
        host.stop()
        for name, driver in zip(names, drivers, strict=True):
            assert host.digests(name) == driver.digests
        return sorted(pause for driver in drivers for pause in driver.pauses)


def note(pauses: list[float], record_property: Callable[[str, object], None]) -> None:
    p50, p99 = (1000 * pauses[min(len(pauses) - 1, int(part * len(pauses)))] for part in (0.5, 0.99))
    record_property("pause of a world whose worker is killed", f"p50 {p50:.0f} ms, p99 {p99:.0f} ms ({len(pauses)})")


def test_no_world_is_lost_nor_twice_when_workers_are_killed_at_random(
    tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    pauses = survive(tmp_path, 4, 1)
    assert len(pauses) >= 4
    note(pauses, record_property)


@pytest.mark.long
def test_a_hundred_kills(tmp_path: Path, record_property: Callable[[str, object], None]) -> None:
    note(survive(tmp_path, 100, 2), record_property)
