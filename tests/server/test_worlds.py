"""Many worlds in one process: created when first used, listed, and without effect on each other."""

from __future__ import annotations

import asyncio
import json
import socket
import threading
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from nmes import AsyncClient, Client
from nmes.cli import main
from nmes.errors import CommandFailed, Disconnected, RecordingError, RejectedMessage, WorldError
from nmes.playback import replay
from nmes.protocol import validate_reply
from nmes.protocol.session import Session
from nmes.recording import Kind, Recording
from nmes.server import Host
from nmes.server.hosted_world import HostedWorld
from nmes.server.threads import Worker
from nmes.world import World
from processes import process, ready
from servers import PASSWORD, PATIENCE, Served, served, types, until


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Served]:
    with served({"name": "red"}, {"name": "green"}, {"name": "blue"}, record_to=tmp_path, lazy=True) as running:
        yield running


def run(*arguments: str, **environment: str | None) -> Result:
    return CliRunner().invoke(main, arguments, env={"NMES_PASSWORD": PASSWORD, **environment})


# -- created when first used -----------------------------------------------------------------------------------------


def test_a_world_and_its_recording_begin_when_it_is_first_used(server: Served, tmp_path: Path) -> None:
    assert list(tmp_path.iterdir()) == []
    with server.client(world="green") as client:
        assert client.step(3)["frame"] == 3
    assert [path.name.split("-")[0] for path in tmp_path.iterdir()] == ["green"]
    with server.client() as client:  # who names none gets the first
        assert client.welcome["world"] == "red"
    with server.client(world="green") as client:  # it is still the same
        assert client.step()["frame"] == 4
    assert sorted(path.name.split("-")[0] for path in tmp_path.iterdir()) == ["green", "red"]


def test_a_realtime_world_ticks_once_it_is_used() -> None:
    with served({"name": "red", "mode": "fast"}, lazy=True) as server, server.client() as client:
        until(lambda: client.get_world_info()["frame"] > 100)


def test_a_world_that_cannot_be_created_is_reported_and_the_others_are_served(
    server: Served, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    create = HostedWorld.__init__

    def no_room(self: HostedWorld, config: Any, *more: Any) -> None:
        if config["name"] == "green":
            raise RecordingError("recording_failed", "the disk of /secret/place is full")
        create(self, config, *more)

    monkeypatch.setattr(HostedWorld, "__init__", no_room)
    with server.peer(None) as peer:
        peer.say({"type": "auth", "password": PASSWORD, "world": "green"})
        (answer,) = peer.rest()
    validate_reply(json.loads(answer))
    assert json.loads(answer)["code"] == "world_unavailable"
    assert b"secret" not in answer
    assert "the disk of /secret/place is full" in caplog.text
    with server.client() as client:
        assert client.step()["frame"] == 1


async def test_world_names_are_unique_and_configs_are_checked_at_once() -> None:
    async with Host("x") as host:
        assert host.offer({"name": "red"}) == "red"
        with pytest.raises(WorldError, match="two worlds are called 'red'"):
            host.offer({"name": "red", "backend": "ballistic"})
        with pytest.raises(RejectedMessage, match="substeps"):
            host.offer({"name": "green", "substeps": 0})
        assert host.worlds == {}


async def test_a_name_whose_world_could_not_be_added_is_free_again() -> None:
    async with Host("x") as host:
        with pytest.raises(RejectedMessage, match="no scenery"):
            host.add({"backend": "ballistic", "scene": {"type": "heightfield"}})
        assert host.add({"backend": "ballistic"}).name == "main"


# -- one port each ---------------------------------------------------------------------------------------------------


async def test_each_port_has_its_world_and_all_are_found_by_name_on_each() -> None:
    async with Host(PASSWORD) as host:
        ports = []
        for name in ("red", "green"):
            host.offer({"name": name, "backend": "ballistic", "mode": "lockstep"})
            ports.append((await host.listen("127.0.0.1", 0, name))[1])

        def look() -> list[str]:
            names = []
            for port in ports:
                for world in (None, "red"):
                    with Client(port=port, password=PASSWORD, world=world, timeout=PATIENCE) as client:
                        names.append(client.welcome["world"])
            return names

        assert await asyncio.to_thread(look) == ["red", "red", "green", "red"]
        assert [entry["port"] for entry in host.list_worlds(1)["worlds"]] == ports


# -- they are listed -------------------------------------------------------------------------------------------------


def test_listing_worlds_creates_and_joins_none(server: Served, tmp_path: Path) -> None:
    unused = {
        "port": server.port,
        "backend": "ballistic",
        "mode": "lockstep",
        "frame": None,
        "clients": 0,
        "fault": None,
        "asleep": False,
        "ratio": None,
    }
    asker = server.client()
    assert asker.worlds() == [{"world": name, **unused} for name in ("red", "green", "blue")]
    assert list(tmp_path.iterdir()) == []
    with server.client(world="green") as client:
        client.set_mode("realtime")
        client.pause()
        client.step(2)
        used = {"mode": "realtime", "frame": 2, "clients": 1}
        assert asker.worlds()[1].items() >= used.items()
        client.spawn_cube("a", mass=1e-6)
        client.apply_force("a", force=[1e15, 0, 0])
        with pytest.raises(CommandFailed):
            client.step(100)
        assert asker.worlds()[1]["fault"] is not None


def test_a_list_of_worlds_is_one_valid_message_and_then_the_connection_ends(server: Served) -> None:
    with server.peer(None) as peer:
        peer.say({"type": "auth", "password": PASSWORD, "list": True, "id": 5}, {"type": "ping"})
        (answer,) = peer.rest()
        message = json.loads(answer)
        validate_reply(message)
        assert (message["type"], message["id"]) == ("world_list", 5)
    with server.peer(None) as peer:
        peer.say({"type": "auth", "password": "guess", "list": True})
        assert types(peer.rest()) == ["error"]
    assert server.call(lambda: server.host.worlds) == {}


async def test_an_awaiting_client_lists_worlds(server: Served) -> None:
    asker = AsyncClient(port=server.port, password=PASSWORD, timeout=PATIENCE)
    assert await asker.worlds() == server.client().worlds()
    async with asker:
        assert [world["clients"] for world in await asker.worlds()] == [1, 0, 0]
        assert (await asker.ping())["type"] == "pong"  # it is in its world as before
    with pytest.raises(CommandFailed) as refused:
        await AsyncClient(port=server.port, password="guess", timeout=PATIENCE).worlds()
    assert refused.value.code == "auth_failed"


async def test_a_server_that_cannot_list_worlds_is_an_error(server: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    entered = World({"backend": "ballistic"})
    welcome = entered.welcome(entered.join())
    monkeypatch.setattr(Host, "list_worlds", lambda self, port, only, start: welcome)
    with pytest.raises(CommandFailed) as failed:
        server.client().worlds()
    assert failed.value.code == "unsupported"
    with pytest.raises(CommandFailed) as failed:
        await AsyncClient(port=server.port, password=PASSWORD, timeout=PATIENCE).worlds()
    assert failed.value.code == "unsupported"


def test_nmes_worlds_prints_the_list(server: Served) -> None:
    with server.client(world="green") as client:
        client.step(7)
        address = f"127.0.0.1:{server.port}"
        shown = run("worlds", address)
        assert shown.exit_code == 0
        assert [line.split() for line in shown.output.splitlines()] == [
            ["WORLD", "PORT", "ENGINE", "MODE", "FRAME", "CLIENTS"],
            ["red", str(server.port), "ballistic", "lockstep", "not", "used", "yet", "0"],
            ["green", str(server.port), "ballistic", "lockstep", "7", "1"],
            ["blue", str(server.port), "ballistic", "lockstep", "not", "used", "yet", "0"],
        ]
        printed = run("worlds", address, "--json")
        assert json.loads(printed.output) == server.client().worlds()
    assert run("worlds", address, NMES_PASSWORD="guess").exit_code == 1
    assert run("worlds", address, NMES_PASSWORD=None).exit_code == 2
    for wrong in ("127.0.0.1", ":14000", "127.0.0.1:0", "127.0.0.1:70000", "127.0.0.1:x"):
        assert run("worlds", wrong).exit_code == 2
    with socket.create_server(("127.0.0.1", 0)) as mute:
        free = mute.getsockname()[1]
    assert "cannot connect" in run("worlds", f"127.0.0.1:{free}").output
    with pytest.raises(Disconnected):
        Client(port=free, password=PASSWORD).worlds()


# -- closed while the host goes on -----------------------------------------------------------------------------------


def test_a_world_that_is_closed_ends_whole_and_alone(server: Served, tmp_path: Path) -> None:
    with server.client(world="red") as other, server.client(world="green") as client:
        client.step(3)
        other.step(2)
        assert [world["world"] for world in server.client().close_world("green")] == ["red", "blue"]
        with pytest.raises(Disconnected):
            client.step()
        assert other.step()["frame"] == 3
        with pytest.raises(CommandFailed) as gone:
            server.client(world="green").connect()
        assert gone.value.code == "world_not_found"
    (recording,) = tmp_path.glob("green-*.mcap")
    report = replay(recording)  # while the host goes on
    assert (report.verdict, report.ticks) == ("reproduced", 3) and Recording(recording).damage is None


def test_whoever_subscribed_is_told_that_the_world_closes(server: Served) -> None:
    with server.peer() as peer:
        peer.say({"type": "subscribe", "events": ["tick"]})
        assert json.loads(peer.frame())["type"] == "subscribed"
        server.client().close_world("red")
        assert types(peer.rest()) == ["world_closed"]


def test_a_world_is_closed_that_nobody_has_used_and_none_that_there_is_not(server: Served) -> None:
    assert len(server.client().close_world("blue")) == 2
    for name in ("blue", "black"):
        with pytest.raises(CommandFailed) as refused:
            server.client().close_world(name)
        assert refused.value.code == "world_not_found"
    with pytest.raises(CommandFailed) as refused:
        Client(port=server.port, password="guess", timeout=PATIENCE).close_world("red")
    assert refused.value.code == "auth_failed" and len(server.client().worlds()) == 2


async def test_an_awaiting_client_closes_a_world(server: Served) -> None:
    asker = AsyncClient(port=server.port, password=PASSWORD, timeout=PATIENCE)
    assert [world["world"] for world in await asker.close_world("red")] == ["green", "blue"]
    async with asker:  # who names none gets the first of those that are left
        assert asker.welcome["world"] == "green"


async def test_a_server_that_cannot_close_worlds_is_an_error(server: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    read = Session._read_auth  # as of a server that does not know the field
    monkeypatch.setattr(Session, "_read_auth", lambda self, frame: replace(read(self, frame), close=None))
    with pytest.raises(CommandFailed) as failed:
        server.client().close_world("red")
    assert failed.value.code == "unsupported" and len(server.client().worlds()) == 3


def test_nmes_worlds_closes_a_world(server: Served) -> None:
    address = f"127.0.0.1:{server.port}"
    assert "say with --world" in run("worlds", address, "--close").output
    assert run("worlds", address, "--close", "--reset", "--world", "red").exit_code == 2
    shown = run("worlds", address, "--close", "--world", "red", "--world", "blue")
    assert shown.exit_code == 0 and [line.split()[0] for line in shown.output.splitlines()[1:]] == ["green"]
    assert "no world 'red'" in run("worlds", address, "--close", "--world", "red").output


# -- nmes serve ------------------------------------------------------------------------------------------------------


def test_nmes_serve_gives_each_world_a_port(tmp_path: Path) -> None:
    options = ["--json", "--port", "0", "--backend", "ballistic", "--mode", "lockstep", "--record", str(tmp_path)]
    with process("serve", "--worlds", "3", *options, NMES_PASSWORD=PASSWORD) as server:
        info = ready(server)
        assert [entry["world"] for entry in info["worlds"]] == ["main-1", "main-2", "main-3"]
        assert info["recordings"] == str(tmp_path)
        assert len({entry["port"] for entry in info["worlds"]}) == 3
        for number, entry in enumerate(info["worlds"][:2]):
            with Client(port=entry["port"], password=PASSWORD, timeout=PATIENCE) as client:
                assert client.welcome["world"] == entry["world"]
                client.step(number + 1)
        with Client(port=info["port"], password=PASSWORD, timeout=PATIENCE) as client:
            listed = [(entry["port"], entry["frame"]) for entry in client.worlds()]
        assert listed == list(zip((entry["port"] for entry in info["worlds"]), (1, 2, None), strict=True))
        server.terminate()
        assert server.wait(PATIENCE) == 0
    reports = [replay(path) for path in sorted(tmp_path.iterdir())]
    assert [(report.verdict, report.ticks) for report in reports] == [("reproduced", 1), ("reproduced", 2)]


def test_nmes_serve_prints_named_worlds_for_people() -> None:
    options = ["--port", "0", "--backend", "ballistic", "--mode", "lockstep", "--no-record"]
    with process("serve", "--worlds", "red,green", *options, NMES_PASSWORD=PASSWORD) as server:
        assert server.stdout is not None
        lines = [server.stdout.readline() for _ in range(5)]
        assert lines[0].startswith("World 'red' on 127.0.0.1:")
        port = int(lines[1].split(":")[1])
        with Client(port=port, password=PASSWORD, world="green", timeout=PATIENCE) as client:
            client.step(5)
        server.terminate()
        out, _ = server.communicate(timeout=PATIENCE)
    assert out == "World 'green' stopped at frame 5\n"


def test_ports_of_worlds_are_port_step_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[int, str | None]] = []

    async def listen(self: Host, host: str, port: int, world: str | None = None) -> tuple[str, int]:
        asked.append((port, world))
        if len(asked) == 3:
            raise RejectedMessage("enough", "seen enough")
        return host, port

    monkeypatch.setattr(Host, "listen", listen)
    run("serve", "--worlds", "4", "--port", "10002", "--port-step", "3", "--backend", "ballistic", "--no-record")
    assert asked == [(10002, "main-1"), (10005, "main-2"), (10008, "main-3")]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--worlds", "0"], "from 1 to"),
        (["--worlds", "100001"], "from 1 to"),
        (["--worlds", "a,,b"], "name: "),
        (["--worlds", "a,b,a"], "two worlds are called 'a'"),
        (["--worlds", "3", "--port", "65530", "--port-step", "3"], "beyond port 65535"),
        (["--worlds", "a,b", "--port-step", "3"], "--port-step goes with a number"),
        (["--port-step", "3"], "--port-step goes with a number"),
    ],
)
def test_wrong_usage_is_explained(options: list[str], says: str) -> None:
    result = run("serve", "--no-record", "--backend", "ballistic", *options)
    assert result.exit_code == 2
    assert says in result.output


# -- without effect on each other ------------------------------------------------------------------------------------


def _experiment(client: Client) -> None:
    for n in range(20):
        client.spawn_cube(position=[n, 1 + n, 0], linear_velocity=[1, 0, 0])
        client.apply_force(force=[0, n, 0])
        client.step(5)


def _digests(directory: Path) -> list[str]:
    (path,) = directory.glob("third-*")
    return [
        digest
        for record in Recording(path)
        if record.kind is Kind.TICKS and record.about
        for digest in record.about["digests"]
    ]


def test_a_faulted_and_a_flooded_world_do_not_change_a_third(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    away: Counter[str] = Counter()
    run = Worker.run

    def count(worker: Worker, work: Any, then: Any) -> bool:
        away[worker._world.config["name"]] += 1
        return run(worker, work, then)

    monkeypatch.setattr(Worker, "run", count)
    with served({"name": "third"}, record_to=tmp_path / "alone") as server, server.client() as client:
        _experiment(client)
    away.clear()
    monkeypatch.setattr(Worker, "_is_short", lambda *_: False)  # from now on all is done in threads

    over = threading.Event()
    faults = []
    flooded = {"name": "flooded", "mode": "fast", "limits": {"cubes": 50}}
    with served({"name": "faulted"}, flooded, {"name": "third"}, record_to=tmp_path / "together") as server:

        def fault() -> None:
            with server.client(world="faulted") as client:
                while not over.is_set():
                    client.spawn_cube("a", mass=1e-6)
                    client.apply_force("a", force=[1e15, 0, 0])
                    with pytest.raises(CommandFailed) as failed:
                        client.step(100)
                    faults.append(failed.value.code)
                    client.reset()

        def flood() -> None:
            with server.peer(None) as peer:
                peer.ask({"type": "auth", "password": PASSWORD, "world": "flooded"})
                while not over.is_set():
                    peer.say(*[{"type": "spawn_cube", "position": [0, n, 0]} for n in range(100)])
                    for _ in range(100):
                        peer.hear()

        others = [threading.Thread(target=each) for each in (fault, flood)]
        for other in others:
            other.start()
        with server.client(world="third") as client:
            _experiment(client)
        over.set()
        for other in others:
            other.join(PATIENCE)
            assert not other.is_alive()
        states = server.call(lambda: {name: hosted.world.fault for name, hosted in server.host.worlds.items()})
        assert states == {"faulted": None, "flooded": None, "third": None}
    assert len(faults) > 1 and set(faults) == {"world_faulted"}
    assert away["third"] == 40 and away["flooded"] > 10  # each spawn and each step
    assert len(_digests(tmp_path / "together")) == 100
    assert _digests(tmp_path / "together") == _digests(tmp_path / "alone")


# -- steering them from a prompt -------------------------------------------------------------------------------------


def test_nmes_worlds_pauses_steps_resumes_and_resets(server: Served) -> None:
    address = f"127.0.0.1:{server.port}"
    with server.client(world="red") as red, server.client(world="green") as green:
        for client in (red, green):
            client.set_mode("realtime")
            client.spawn_cube("there")
        paused = run("worlds", address, "--world", "red", "--pause", "--json")
        assert (red.get_world_info()["paused"], green.get_world_info()["paused"]) == (True, False)
        before = red.get_world_info()["frame"]
        stepped = run("worlds", address, "--world", "red", "--step", "7", "--json")
        assert [outcome.exit_code for outcome in (paused, stepped)] == [0, 0]
        assert [(world["world"], world["frame"]) for world in json.loads(stepped.output)] == [("red", before + 7)]
        assert run("worlds", address, "--world", "green", "--world", "red", "--reset").exit_code == 0
        assert [client.get_cube_list()["cubes"] for client in (red, green)] == [[], []]
        assert run("worlds", address, "--world", "red", "--resume").exit_code == 0
        assert not red.get_world_info()["paused"]


def test_what_nmes_worlds_does_is_in_the_recording(server: Served, tmp_path: Path) -> None:
    assert run("worlds", f"127.0.0.1:{server.port}", "--world", "blue", "--step", "3").exit_code == 0
    server.close()
    (path,) = tmp_path.iterdir()
    assert (Recording(path).summary().commands, Recording(path).summary().ticks) == (Counter({"step": 1}), 3)


@pytest.mark.parametrize(
    ("options", "status", "says"),
    [
        (["--pause"], 2, "there are 3 worlds: say with --world which is meant"),
        (["--world", "red", "--world", "pink", "--reset"], 1, "there is no world 'pink' that this password opens"),
        (["--pause", "--reset", "--world", "red"], 2, "exclude each other"),
        (["--step", "0", "--world", "red"], 2, "--step"),
    ],
)
def test_nothing_is_done_where_it_is_not_clear_what(
    options: list[str], status: int, says: str, server: Served, tmp_path: Path
) -> None:
    outcome = run("worlds", f"127.0.0.1:{server.port}", *options)
    assert (outcome.exit_code, says in outcome.output) == (status, True), outcome.output
    assert list(tmp_path.iterdir()) == []  # no world was entered


def test_a_world_that_refuses_is_named() -> None:
    with served({"name": "red", "mode": "realtime"}) as server:
        outcome = run("worlds", f"127.0.0.1:{server.port}", "--step", "1")  # the only one need not be named
    assert outcome.exit_code == 1
    assert outcome.output.startswith("Error: world 'red': step")
