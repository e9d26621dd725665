"""A host among clients that mean it no good: it keeps serving the others, and keeps what was acknowledged."""

from __future__ import annotations

import asyncio
import errno
import gc
import json
import logging
import os
import resource
import shutil
import signal
import socket
import ssl
import threading
from asyncio.sslproto import SSLProtocol
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest
import trustme
from click.testing import CliRunner

from nmes.cli import _logs, main
from nmes.playback import replay
from nmes.protocol import DELIMITER, Limits, Request, parse
from nmes.recording import Kind, Recorder, Recording
from nmes.server.connection import Connection
from nmes.server.door import Door, Guesses, address_of
from nmes.server.hosted_world import HostedWorld
from nmes.server.world_recorder import WorldRecorder
from nmes.world import World
from processes import process, ready, signal_handler
from servers import PASSWORD, PATIENCE, Peer, served, until


@contextmanager
def stuck(hosted: HostedWorld) -> Iterator[threading.Event]:
    """Holds a world in its next tick; yields what is set when it is there."""
    entered, leave = threading.Event(), threading.Event()
    simulation: Any = hosted.world.simulation
    step: Callable[[int], None] = simulation.step

    def wait(substeps: int) -> None:
        entered.set()
        assert leave.wait(PATIENCE)
        step(substeps)

    simulation.step = wait
    try:
        yield entered
    finally:
        leave.set()


# -- recordings ------------------------------------------------------------------------------------------------------


def test_any_number_of_clients_may_come_and_go_while_a_world_is_recorded(tmp_path: Path) -> None:
    clients = 22_000  # with three channels each, as once, over the 65,535 that a file may have
    world = World({"backend": "ballistic", "mode": "lockstep"})
    world.journal = recorder = Recorder(tmp_path / "x.mcap", world)
    ping, nonsense = parse(b'{"type":"ping"}'), parse(b"nonsense")
    for number in range(1, clients + 1):
        assert world.join() == number
        world.handle(number, ping)
        world.handle(number, nonsense)
        world.leave(number)
    assert world.fault is None
    recorder.close()
    records = list(Recording(recorder.path))
    for kind in (Kind.COMMAND, Kind.REFUSED):
        assert [record.client for record in records if record.kind is kind] == list(range(1, clients + 1))
    assert {record.data for record in records if record.kind is Kind.REFUSED} == {b"nonsense"}
    assert replay(recorder.path).verdict == "reproduced"


def test_what_was_acknowledged_reaches_the_disk_while_a_tick_takes_long(tmp_path: Path) -> None:
    with served({"name": "slow"}, record_to=tmp_path, flush_interval=0.05) as server, server.peer() as peer:
        with stuck(server.hosted) as entered:
            batch = {"type": "batch", "commands": [{"type": "spawn_cube", "cube_name": f"c{n}"} for n in range(600)]}
            assert peer.ask(batch)["type"] == "batch_result"
            peer.say({"type": "step", "ticks": 1})
            assert entered.wait(PATIENCE)
            (path,) = tmp_path.iterdir()
            until(lambda: b"c599" in b"".join(record.data for record in Recording(path)))
        assert peer.hear()["type"] == "stepped"
    assert replay(path).verdict == "reproduced"


@pytest.mark.parametrize("dialect", ["json", "raw"])
@pytest.mark.parametrize(
    "said",
    [
        {"type": "auth", "password": PASSWORD},
        {"type": "auth", "password": "another that is secret"},
        {"type": PASSWORD},
        {"type": "ping", "ticks": 1, "password": PASSWORD, "id": {"p": PASSWORD}, "position": {}, "type ": 1},
        {"type": "step", "ticks": PASSWORD},
        PASSWORD,
        f"{PASSWORD} and more",
        json.dumps(PASSWORD),
    ],
    ids=repr,
)
def test_a_password_said_twice_is_not_kept(
    tmp_path: Path, dialect: str, said: Any, caplog: pytest.LogCaptureFixture
) -> None:
    frame = said.encode() if isinstance(said, str) else json.dumps(said).encode()
    with served(record_to=tmp_path) as server, server.peer(dialect) as peer:
        peer.send(frame + DELIMITER)
        answer = peer.frame()
        assert json.loads(answer)["type"] in ("error", "pong")
    (path,) = tmp_path.iterdir()
    if json.loads(answer)["type"] == "pong":  # a command that is obeyed is kept as it is: it is what happened
        return
    kept = [record.data for record in Recording(path)]
    for secret in (PASSWORD.encode(), b"another that is secret"):
        assert not any(secret in data for data in [*kept, answer, caplog.text.encode()])
    assert any(b"not kept" in data for data in kept)
    assert replay(path).verdict == "reproduced"


def test_servers_that_start_at_once_in_one_folder_record_to_files_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Path, "exists", lambda path: False)  # as it is to all who look before any has begun
    worlds = [World({"backend": "ballistic"}) for _ in range(4)]
    recorders = [WorldRecorder(world, tmp_path, 1.0, None) for world in worlds]
    for recorder in recorders:
        recorder.close()
    assert len(list(tmp_path.iterdir())) == 4


def test_serve_says_that_a_recording_is_not_whole_and_ends_with_status_1(tmp_path: Path) -> None:
    options = ["--port", "0", "--backend", "ballistic", "--mode", "lockstep", "--record", str(tmp_path)]
    environment = {"NMES_PASSWORD": PASSWORD, "PYTHONDONTWRITEBYTECODE": "1"}  # see `disks.full_disk`
    with process("serve", "--json", *options, "--flush-interval", "0", **environment) as server:
        info = ready(server)
        resource.prlimit(server.pid, resource.RLIMIT_FSIZE, (100_000, 100_000))  # a full disk
        with Peer(info["port"]) as peer:
            peer.ask({"type": "auth", "password": PASSWORD})
            peer.say(*[{"type": "ping", "id": os.urandom(500).hex()} for _ in range(400)])
            assert json.loads(peer.rest()[-1])["code"] == "recording_failed"
        server.send_signal(signal.SIGTERM)
        _, log = server.communicate(timeout=PATIENCE)
    assert server.returncode == 1
    assert "the recording of world 'main' is not whole: cannot write" in log
    assert "Traceback" not in log


@pytest.mark.parametrize("interval", ["0", "0.02"])
def test_serve_says_that_its_recording_was_removed_and_ends_with_status_1(tmp_path: Path, interval: str) -> None:
    options = ["--port", "0", "--backend", "ballistic", "--mode", "lockstep", "--record", str(tmp_path / "kept")]
    with process("serve", "--json", *options, "--flush-interval", interval, NMES_PASSWORD=PASSWORD) as server:
        info = ready(server)
        with Peer(info["port"]) as peer:
            peer.ask({"type": "auth", "password": PASSWORD})
            assert peer.ask({"type": "subscribe"})["type"] == "subscribed"
            shutil.rmtree(tmp_path / "kept")
            peer.say({"type": "ping"})
            if interval == "0":  # nobody is told what is not on disk
                assert json.loads(peer.rest()[-1])["code"] == "recording_failed"
            else:
                heard = [peer.hear(), peer.hear()]
                assert "was removed" in next(each for each in heard if each["type"] != "pong")["message"]
        server.send_signal(signal.SIGTERM)
        _, log = server.communicate(timeout=PATIENCE)
    assert server.returncode == 1
    assert "the recording of world 'main' is not whole: cannot write" in log and "was removed" in log
    assert "Traceback" not in log


def test_a_server_whose_terminal_is_closed_keeps_what_it_acknowledged(tmp_path: Path) -> None:
    options = ["--port", "0", "--backend", "ballistic", "--mode", "lockstep", "--record", str(tmp_path)]
    with (
        signal_handler(signal.SIGHUP, signal.SIG_DFL),
        process("serve", "--json", *options, "--flush-interval", "60", NMES_PASSWORD=PASSWORD) as server,
    ):
        info = ready(server)
        with Peer(info["port"]) as peer:
            peer.ask({"type": "auth", "password": PASSWORD})
            peer.ask({"type": "spawn_cube", "cube_name": "kept"})
            server.send_signal(signal.SIGHUP)
            assert server.wait(PATIENCE) == 0
    recording = Recording(info["recording"])
    assert recording.complete and b'"kept"' in b"".join(record.data for record in recording)


def test_a_server_that_is_to_outlive_its_terminal_goes_on() -> None:
    with (
        signal_handler(signal.SIGHUP, signal.SIG_IGN),  # what nohup does
        process("serve", "--json", "--port", "0", "--no-record", NMES_PASSWORD=PASSWORD) as server,
    ):
        info = ready(server)
        server.send_signal(signal.SIGHUP)
        with Peer(info["port"]) as peer:
            assert peer.ask({"type": "auth", "password": PASSWORD})["type"] == "auth_success"
            assert peer.ask({"type": "ping"})["type"] == "pong"


@pytest.mark.parametrize("secure", [False, True], ids=["plain", "TLS"])
def test_nothing_is_left_of_connections_that_are_gone(secure: bool) -> None:
    """Each has buffers, with TLS of 256 KiB: thousands of them may come and go before garbage is collected."""
    authority, identity, trust = trustme.CA(), ssl.create_default_context(ssl.Purpose.CLIENT_AUTH), None
    if secure:
        authority.issue_cert("127.0.0.1").configure_cert(identity)
        authority.configure_trust(trust := ssl.create_default_context())

    def left() -> list[object]:
        return [each for each in gc.get_objects() if isinstance(each, Connection | SSLProtocol)]

    gc.collect()
    gc.disable()
    try:
        with served(tls=identity if secure else None) as server:
            for _ in range(3):
                with server.client(tls=trust) as client:
                    client.ping()
            until(lambda: server.host.connections == 0)
            for _ in range(5):
                server.call(lambda: None)  # a turn of the loop
            assert left() == []
    finally:
        gc.enable()


async def test_a_door_without_descriptors_does_not_ask_again_and_again(monkeypatch: pytest.MonkeyPatch) -> None:
    attempts, create = 0, socket.create_server

    class Full(socket.socket):
        def accept(self) -> Any:
            nonlocal attempts
            attempts += 1
            raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(socket, "create_server", lambda *given, **named: Full(fileno=create(*given, **named).detach()))
    door = Door(4, None, 5.0, 2.0)
    _, port = await door.listen("127.0.0.1", 0, asyncio.Protocol)
    with socket.create_connection(("127.0.0.1", port)):
        for _ in range(1000):
            await asyncio.sleep(0)
    await door.close()
    assert 1 <= attempts < 100


def test_the_log_stays_small_whatever_is_done_again_and_again() -> None:
    options = ["--port", "0", "--backend", "ballistic", "--mode", "lockstep", "--no-record"]
    with process("serve", "--json", *options, NMES_PASSWORD=PASSWORD) as server:
        port = ready(server)["port"]
        with ExitStack() as stack:
            guessers = [stack.enter_context(Peer(port)) for _ in range(50)]
            for peer in guessers:
                peer.send(b"guess" + DELIMITER)
            assert all(b"auth_failed" in peer.frame() for peer in guessers)
        server.send_signal(signal.SIGTERM)
        _, log = server.communicate(timeout=PATIENCE)
    lines = log.splitlines()
    assert server.returncode == 0 and 1 <= len(lines) <= _logs.AT_ONCE
    assert all("wrong password" in line for line in lines)


def test_lines_that_were_left_out_are_told_a_minute_later() -> None:
    seldom = _logs.Seldom()

    def line(at: float, number: int = 7) -> str | None:
        record = logging.LogRecord("x", logging.WARNING, "door.py", number, "%s guesses", ("100 %",), None)
        record.created = at
        return record.getMessage() if seldom.filter(record) else None

    assert [line(100.0) for _ in range(1000)] == ["100 % guesses"] * 20 + [None] * 980
    assert line(100.0, 8) == "100 % guesses"  # another place in the code
    left = "100 % guesses (981 more like this were left out)"
    assert [line(159.0), line(161.0), line(162.0)] == [None, left, None]
    assert sum(line(200.0 + second) is not None for second in range(86_400)) <= 1441


def test_a_host_ends_though_a_tick_takes_long_and_its_recording_is_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nmes.server.hosted_world.PATIENCE", 0.05)
    with served({"name": "slow"}, record_to=tmp_path) as server, server.peer() as peer:
        (path,) = tmp_path.iterdir()
        with stuck(server.hosted) as entered:
            peer.ask({"type": "spawn_cube", "cube_name": "a"})
            peer.say({"type": "step", "ticks": 10_000})
            assert entered.wait(PATIENCE)
            server.close()
            assert peer.rest() == []
            assert server.host.abandoned
            recording = Recording(path)
            assert recording.complete
            assert b'"a"' in b"".join(record.data for record in recording)
            assert replay(recording).verdict == "reproduced"


def test_nobody_else_waits_while_the_disk_takes_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    entered, leave = threading.Event(), threading.Event()

    def slow(number: int) -> None:
        entered.set()
        assert leave.wait(PATIENCE)

    configs = {"name": "slow"}, {"name": "quick"}
    with served(*configs, record_to=tmp_path, flush_interval=0) as server, ExitStack() as stack:
        slow_one, quick = (stack.enter_context(server.peer(None)) for _ in range(2))
        for peer, world in ((slow_one, "slow"), (quick, "quick")):
            peer.ask({"type": "auth", "password": PASSWORD, "world": world})
        recording, fsync = server.host.worlds["slow"].recording, os.fsync
        assert recording is not None
        watched = stack.enter_context(recording.open("rb")).fileno()
        monkeypatch.setattr(
            "nmes.recording.mcap_writer.os.fsync",
            lambda number: slow(number) if os.path.sameopenfile(number, watched) else fsync(number),
        )
        slow_one.say({"type": "ping", "id": 1})
        assert entered.wait(PATIENCE)
        slow_one.say({"type": "ping", "id": 2}, {"type": "ping", "id": 3})
        slow_one.hang_up()
        assert [quick.ask({"type": "ping", "id": n})["id"] for n in range(20)] == list(range(20))
        slow_one.socket.setblocking(False)
        with pytest.raises(BlockingIOError):  # what is not on disk is not told
            slow_one.socket.recv(1)
        slow_one.socket.settimeout(PATIENCE)
        leave.set()
        assert [json.loads(frame)["id"] for frame in slow_one.rest()] == [1, 2, 3]


def test_a_world_does_not_tick_away_from_its_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    entered, leave = threading.Event(), threading.Event()

    def slow(number: int) -> None:
        entered.set()
        assert leave.wait(PATIENCE)

    with served({"mode": "fast"}, record_to=tmp_path, flush_interval=0) as server, server.peer() as peer:
        peer.ask({"type": "pause"})
        monkeypatch.setattr("nmes.recording.mcap_writer.os.fsync", slow)
        peer.say({"type": "resume"})
        assert entered.wait(PATIENCE)
        frame = server.call(lambda: server.hosted.world.frame)
        for _ in range(50):
            server.call(lambda: None)  # a turn of the loop
        assert server.call(lambda: server.hosted.world.frame) == frame
        leave.set()
        assert peer.hear()["type"] != "error"
        until(lambda: server.call(lambda: server.hosted.world.frame) > frame)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL], ids=lambda number: number.name)
def test_a_server_that_ends_while_a_structure_is_compiled_keeps_what_it_acknowledged(
    tmp_path: Path, number: signal.Signals
) -> None:
    options = ["--port", "0", "--backend", "mujoco", "--mode", "lockstep", "--record", str(tmp_path)]
    with process("serve", "--json", *options, "--flush-interval", "0", NMES_PASSWORD=PASSWORD) as server:
        with Peer(ready(server)["port"]) as peer:
            peer.ask({"type": "auth", "password": PASSWORD})
            cubes = [{"type": "spawn_cube", "cube_name": f"c{n}", "position": [2 * n, 1, 0]} for n in range(1000)]
            assert peer.ask({"type": "batch", "commands": cubes})["type"] == "batch_result"
            peer.say({"type": "step"})
            server.send_signal(number)
            _, log = server.communicate(timeout=PATIENCE)
    assert server.returncode == (0 if number == signal.SIGTERM else -signal.SIGKILL)
    assert "Traceback" not in log
    (path,) = tmp_path.iterdir()
    recording = Recording(path)
    assert recording.complete == (number == signal.SIGTERM)
    assert b'"c999"' in b"".join(record.data for record in recording)
    assert replay(recording).verdict == "reproduced"


# -- nobody waits for what takes long --------------------------------------------------------------------------------

GENOME = json.loads((files("nmes.genome") / "shipped/walker.json").read_text())
LONG_WORK: dict[str, dict[str, Any]] = {
    "spawn_creature": {"type": "spawn_creature", "genome": GENOME},
    "reset": {"type": "reset"},
    "get_world_state": {"type": "get_world_state"},
    "a batch that builds and steps": {
        "type": "batch",
        "commands": [{"type": "spawn_cube", "position": [0, 3, 0]}, {"type": "step"}],
    },
    "the step after cubes came": {"type": "step"},
}


@pytest.mark.parametrize("command", LONG_WORK.values(), ids=list(LONG_WORK))
def test_what_may_take_long_is_done_away_from_the_event_loop(
    command: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    threads: list[threading.Thread] = []
    handle = World.handle

    def watched(world: World, client: int, request: Request) -> bytes:
        threads.append(threading.current_thread())
        return handle(world, client, request)

    with served({"backend": "mujoco"}) as server, server.peer() as peer:
        for n in range(300):
            peer.ask({"type": "spawn_cube", "position": [2 * n, 1, 0], "list": False})
        monkeypatch.setattr(World, "handle", watched)
        assert peer.ask(command)["type"] != "error"
        assert len(threads) == 1 and threads[0] is not server.call(threading.current_thread)


def test_a_tick_of_the_clock_that_takes_up_cubes_is_done_away_from_the_event_loop() -> None:
    with served({"mode": "realtime"}) as server, server.peer() as peer:
        peer.ask({"type": "pause"})
        for _ in range(300):
            peer.ask({"type": "spawn_cube", "list": False})
        with stuck(server.hosted) as entered:
            peer.ask({"type": "resume"})
            assert entered.wait(PATIENCE)
            assert server.call(threading.current_thread) is not None  # the loop goes on


def test_a_long_frame_is_read_away_from_the_event_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    entered, leave = threading.Event(), threading.Event()

    def slow(frame: bytes) -> Request:
        if len(frame) > 100_000:
            entered.set()
            assert leave.wait(PATIENCE)
        return parse(frame)

    monkeypatch.setattr("nmes.protocol.session.parse", slow)
    with served() as server, server.peer() as long, server.peer() as other:
        names = [f"cube {n}" for n in range(20_000)]
        long.say(
            {"type": "spawn_cube", "cube_name": "a"}, {"type": "get_world_state", "cubes": names}, {"type": "ping"}
        )
        assert entered.wait(PATIENCE)
        assert other.ask({"type": "get_cube_list"})["cubes"] == ["a"]  # also of the same world
        leave.set()
        assert [long.hear()["type"] for _ in range(3)] == ["cube_list", "error", "pong"]


def test_a_world_is_created_away_from_the_event_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    entered, leave = threading.Event(), threading.Event()
    create = HostedWorld.__init__

    def slow(hosted: HostedWorld, config: Any, *more: Any) -> None:
        if config["name"] == "slow":
            entered.set()
            assert leave.wait(PATIENCE)
        create(hosted, config, *more)

    monkeypatch.setattr(HostedWorld, "__init__", slow)
    with served({"name": "quick"}, {"name": "slow"}, lazy=True) as server, server.peer() as quick:
        with server.peer(None) as one, server.peer(None) as two:
            for peer in (one, two):
                peer.say({"type": "auth", "password": PASSWORD, "world": "slow"}, {"type": "ping"})
            assert entered.wait(PATIENCE)
            assert quick.ask({"type": "ping"})["type"] == "pong"
            leave.set()
            assert [one.hear()["world"], two.hear()["world"]] == ["slow", "slow"]
            assert [one.hear()["type"], two.hear()["type"]] == ["pong", "pong"]


# -- the door --------------------------------------------------------------------------------------------------------


def test_silent_sockets_shut_nobody_out() -> None:
    with served(limits=Limits(unauthenticated=8, auth_timeout=1000)) as server, ExitStack() as stack:
        silent = [stack.enter_context(server.peer(None)) for _ in range(20)]
        for peer in silent[:12]:
            assert peer.rest() == []  # the oldest are put out
        for _ in range(3):
            assert stack.enter_context(server.peer()).ask({"type": "ping"})["type"] == "pong"
        assert server.call(lambda: len(server.host._door)) <= 8


def test_an_address_with_many_silent_sockets_puts_out_its_own_first() -> None:
    with served(limits=Limits(unauthenticated=8, auth_timeout=1000)) as server, ExitStack() as stack:
        slow = stack.enter_context(Peer(server.port, source="127.0.0.2"))
        for peer in [stack.enter_context(server.peer(None)) for _ in range(30)][:20]:
            assert peer.rest() == []
        assert slow.ask({"type": "auth", "password": PASSWORD})["type"] == "auth_success"


def test_tls_handshakes_are_counted() -> None:
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    trustme.CA().issue_cert("127.0.0.1").configure_cert(context)
    with served(tls=context, limits=Limits(unauthenticated=8, auth_timeout=1000)) as server, ExitStack() as stack:
        silent = [stack.enter_context(server.peer(None)) for _ in range(20)]
        for peer in silent[:12]:
            assert peer.rest() == []


def test_who_guesses_is_not_heard_for_a_while_and_others_are(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Guesses, "ADDRESS", (10, 0.001))
    with served() as server:
        wrong = {"type": "auth", "password": "guess"}
        for _ in range(Guesses.ADDRESS[0]):
            with server.peer(None) as peer:
                peer.say(wrong)
                assert json.loads(peer.rest()[-1])["message"] == "that is not the password"
        for word in ("guess", PASSWORD):  # the right one gets no other answer: else it would be a guess like others
            with server.peer(None) as peer:
                peer.say({**wrong, "password": word})
                assert "too many wrong passwords" in json.loads(peer.rest()[-1])["message"]
        with Peer(server.port, source="127.0.0.2") as other:
            assert other.ask({"type": "auth", "password": PASSWORD})["type"] == "auth_success"


def test_guesses_are_counted_by_address_and_in_common() -> None:
    guesses = Guesses()
    size, rate = Guesses.ADDRESS
    for _ in range(size):
        assert guesses.wait("a", 1000.0) == 0.0
        guesses.wrong("a", 1000.0)
    assert guesses.wait("a", 1000.0) == pytest.approx(1 / rate)
    assert guesses.wait("b", 1000.0) == 0.0
    assert guesses.wait("a", 1000.0 + 1 / rate) == 0.0
    for n in range(Guesses.COMMON[0]):
        guesses.wrong(f"bot {n}", 1001.0)
    assert guesses.wait("bot 1", 1001.0) > 0.0  # has guesses left of its own, but all together have none
    assert guesses.wait("b", 1001.0) == 0.0  # who never guessed is heard all the same
    assert guesses.wait("bot 1", 2000.0) == 0.0
    for n in range(Guesses.ADDRESSES + 10):
        guesses.wrong(f"more {n}", 3000.0)
    assert len(guesses._buckets) == Guesses.ADDRESSES


@pytest.mark.parametrize(
    ("name", "address"),
    [
        (("192.0.2.7", 1234), "192.0.2.7"),
        (("::ffff:192.0.2.7", 1, 0, 0), "192.0.2.7"),
        (("2001:db8:1:2:3:4:5:6", 1, 0, 0), "2001:db8:1:2::/64"),
        (("fe80::1%eth0", 1, 0, 3), "fe80::/64"),
        (None, "?"),
    ],
)
def test_the_address_of_a_socket(name: object, address: str) -> None:
    assert address_of(name) == address


def test_a_host_without_descriptors_says_so_once_and_recovers(tmp_path: Path) -> None:
    options = ["--port", "0", "--backend", "ballistic", "--no-record"]
    with process("serve", "--json", *options, NMES_PASSWORD=PASSWORD) as server, ExitStack() as stack:
        port = ready(server)["port"]
        used = max(map(int, os.listdir(f"/proc/{server.pid}/fd")))
        resource.prlimit(server.pid, resource.RLIMIT_NOFILE, (used + 6, used + 6))
        crowd = [stack.enter_context(Peer(port)) for _ in range(50)]
        auth = {"type": "auth", "password": PASSWORD}
        assert crowd[0].ask(auth)["type"] == "auth_success"
        for n in range(10):
            assert crowd[0].ask({"type": "ping", "id": n})["id"] == n
        for peer in crowd[1:]:
            peer.socket.close()
        with Peer(port) as late:
            assert late.ask(auth)["type"] == "auth_success"
        server.send_signal(signal.SIGTERM)
        _, log = server.communicate(timeout=PATIENCE)
    assert server.returncode == 0
    assert log.count("no connection can be accepted") == 1
    assert len(log.splitlines()) < 10 and "Traceback" not in log


@pytest.mark.parametrize(
    "answer",
    [
        b"HTTP/1.1 400 Bad Request\r\n\r\n",
        b'{"type":"world_list"}<???DONE???---',
        b'{"type":"world_list","worlds":7}<???DONE???---',
        b'{"type":"world_list","worlds":[{"world":"a"}]}<???DONE???---',
        b'{"type":"world_list","worlds":[[]]}<???DONE???---',
        b'{"type":"pong"}<???DONE???---',
        b"[1]<???DONE???---",
        b"x" * 1_000_000,
    ],
)
def test_nmes_worlds_says_what_is_wrong_with_an_odd_answer(answer: bytes) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def respond() -> None:
            peer, _ = listener.accept()
            with peer:
                peer.recv(1 << 16)
                peer.sendall(answer)

        thread = threading.Thread(target=respond)
        thread.start()
        address = f"127.0.0.1:{listener.getsockname()[1]}"
        result = CliRunner().invoke(main, ["worlds", address, "--password", "x"])
        thread.join(PATIENCE)
    assert result.exit_code == 1, result.output
    assert isinstance(result.exception, SystemExit), result.exception
    assert "Error: " in result.stderr and "Traceback" not in result.stderr


def test_a_frame_of_more_values_or_keys_than_a_message_has_is_refused_unread() -> None:
    with served() as server, server.peer() as peer:
        peer.send(b'{"type":"spawn_creature","genome":{"cubes":[' + b",".join([b"{}"] * 200_000) + b"]}}" + DELIMITER)
        assert peer.hear() == {"type": "error", "code": "invalid", "message": "a message holds at most 100,000 values"}
        keys = b",".join(b'"%d":0' % number for number in range(90_000))
        peer.send(b'{"type":"ping","id":{' + keys + b"}}" + DELIMITER)
        assert peer.hear() == {"type": "error", "code": "invalid", "message": "a message holds at most 65,536 keys"}
        most = [{"type": "ping"}] * 10_000
        assert len(peer.ask({"type": "batch", "commands": most})["results"]) == 10_000
