"""Worlds that nobody uses sleep, and wake up as they were: nothing of it shows in what they compute."""

from __future__ import annotations

import gc
import json
import os
import random
import signal
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nmes import Client
from nmes.backends import ballistic
from nmes.errors import CommandFailed, RecordingError, WorldError
from nmes.playback import replay
from nmes.playback.drift import measure_drift
from nmes.playback.export import messages, write_jsonl
from nmes.playback.log import Log
from nmes.playback.log_replay import replay_log
from nmes.recording import Kind, Recorder, Recording
from nmes.recording.summary import summarize
from nmes.server.metrics import Metrics
from nmes.world import World
from processes import process, ready
from recordings import told_by
from servers import PASSWORD, PATIENCE, Served, served, until

SOON = 0.05  # s: after which an idle world hibernates here
TOWER = [{"type": "spawn_cube", "cube_name": f"c{n}", "position": [0.1 * n, 0.6 + 1.2 * n, 0]} for n in range(3)]


@pytest.fixture(params=["mujoco", "ballistic"])
def engine(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def asleep(server: Served, name: str = "main") -> bool:
    return server.call(lambda: server.host.worlds[name].world.asleep)


def sleeps(server: Served, name: str = "main") -> None:
    until(lambda: server.call(lambda: server.host.worlds[name].hibernation.resting))


def digests(path: Path) -> list[str]:
    return [digest for record in Recording(path) for digest in record.digests]


def session(server: Served, commands: list[dict[str, Any]]) -> None:
    with server.client() as client:
        for command in commands:
            client.request(command)


SESSIONS: list[list[dict[str, Any]]] = [
    [*TOWER, {"type": "step", "ticks": 20}],
    [{"type": "apply_physics", "cube_name": "c2", "impulse": [0.3, 0, 0.1]}],  # acts when somebody ticks on
    [{"type": "step", "ticks": 15}, {"type": "get_world_state"}],
    [{"type": "create_joint", "cube1": "c0", "cube2": "c1", "joint_type": "fixed"}, {"type": "spawn_cube"}],
    [{"type": "step", "ticks": 30}, {"type": "reset", "seed": 4}],
    [{"type": "spawn_cube", "cube_name": "new", "position": [0, 3, 0]}, {"type": "step", "ticks": 10}],
]


def test_digests_go_on_as_if_nothing_had_been_and_the_recording_replays(engine: str, tmp_path: Path) -> None:
    kept = {}
    for name, after in (("awake", None), ("slept", SOON)):
        config = {"backend": engine}
        with served(config, record_to=tmp_path / name, hibernate_after=after, flush_interval=0.0) as server:
            for commands in SESSIONS:
                session(server, commands)
                if after is not None:
                    sleeps(server)
        (kept[name],) = (tmp_path / name).glob("*.mcap")
    kinds = [record.kind for record in Recording(kept["slept"])]
    assert kinds.count(Kind.HIBERNATED) >= len(SESSIONS) and Kind.HIBERNATED not in [
        r.kind for r in Recording(kept["awake"])
    ]
    assert digests(kept["slept"]) == digests(kept["awake"]) and len(digests(kept["awake"])) == 75
    report = replay(kept["slept"])
    assert (report.verdict, report.divergence, report.damage) == ("reproduced", None, None)
    assert replay(kept["slept"], first=30).verdict == "reproduced"  # from where it slept


def test_clients_and_players_keep_their_numbers_and_tokens(tmp_path: Path) -> None:
    config = {"roles": {"player": {}}, "backend": "mujoco"}
    with served(config, record_to=tmp_path, hibernate_after=SOON, role_passwords={"player": "of players"}) as server:
        with server.client(password="of players") as first:
            token, player = first.token, first.welcome["player"]
            first.spawn_cube("mine")
        sleeps(server)
        with server.client(password="of players", token=token) as again, server.client(password="of players") as other:
            assert (again.welcome["player"], other.welcome["player"], again.welcome["client"]) == (
                player,
                player + 1,
                2,
            )
            again.apply_force("mine", force=[1, 0, 0])
            with pytest.raises(CommandFailed):
                other.apply_force("mine", force=[1, 0, 0])
    (recording,) = tmp_path.iterdir()
    assert replay(recording).verdict == "reproduced"


# -- which worlds sleep ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("config", "commands", "sleepy"),
    [
        ({"mode": "realtime"}, [], True),
        ({"mode": "fast"}, [], True),
        ({"mode": "lockstep"}, TOWER, True),
        ({"mode": "realtime"}, [*TOWER, {"type": "pause"}], True),
        ({"mode": "realtime"}, [{"type": "spawn_cube", "is_base": True}], True),
        ({"mode": "realtime", "rate": 20}, TOWER, True),  # once they have come to rest
        ({"mode": "realtime"}, [{"type": "spawn_cube", "position": [0, 9e5, 0]}], False),  # it falls
        ({"mode": "realtime", "life": {}}, [], False),
        ({"mode": "lockstep", "life": {}}, [], True),
    ],
)
def test_a_world_sleeps_where_time_stands_still_or_nothing_moves(
    config: dict[str, Any], commands: list[dict[str, Any]], sleepy: bool
) -> None:
    with served({"backend": "mujoco", **config}, hibernate_after=SOON) as server:
        session(server, commands)
        if sleepy:
            sleeps(server)
            frame = server.hosted.world.frame
            time.sleep(3 * SOON)
            assert asleep(server) and server.hosted.world.frame == frame
            with server.client() as client:
                assert frame <= client.get_world_info()["frame"] < frame + 2000
        else:
            time.sleep(0.3)
            assert not asleep(server)


def test_a_world_that_is_long_in_falling_asleep_keeps_no_other_awake(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nmes.server.threads.os.sched_getaffinity", lambda _: {0, 1}, raising=False)
    names = [f"w{number}" for number in range(6)]
    hold, slow, hibernate = threading.Event(), list[str](), World.hibernate

    def hibernate_slowly(world: World) -> None:
        slow.append(world.config["name"])
        if len(slow) == 1:
            hold.wait()
        hibernate(world)

    monkeypatch.setattr(World, "hibernate", hibernate_slowly)
    with served(*({"name": name} for name in names), hibernate_after=2.0) as server:

        def put_off() -> None:  # so that all are due at the same time
            for hosted in server.host.worlds.values():
                hosted.hibernation.put_off()

        server.call(put_off)
        try:
            until(lambda: len(slow) == len(names))
            for name in set(names) - {slow[0]}:
                sleeps(server, name)
            assert server.call(lambda: server.host.awake) == {slow[0]: 0}
        finally:
            hold.set()
        sleeps(server, slow[0])
        assert server.call(lambda: server.host.awake) == {}
        with server.client(world="w3"):
            assert server.call(lambda: server.host.awake) == {"w3": 1}


def test_nobody_is_put_to_sleep_under_a_client_and_a_world_sleeps_again_and_again() -> None:
    with served({"backend": "mujoco"}, hibernate_after=SOON) as server:
        for _ in range(5):
            with server.client() as client:
                time.sleep(3 * SOON)
                assert not asleep(server)
                client.step()
            sleeps(server)
        assert server.hosted.world.frame == 5


def test_a_faulted_world_stays_awake_and_one_that_shall_never_sleep_does() -> None:
    with served({"backend": "mujoco"}, hibernate_after=SOON) as server:
        with server.client() as client:
            client.spawn_cube("a", mass=1e-6)
            client.apply_force("a", force=[1e15, 0, 0])
            with pytest.raises(CommandFailed):
                client.step(100)
        time.sleep(4 * SOON)
        assert not asleep(server)
        with server.client() as client:
            client.reset()
        sleeps(server)
    with served({"backend": "mujoco"}) as server:
        time.sleep(4 * SOON)
        assert not asleep(server)


def test_lists_and_metrics_tell_who_sleeps_and_wake_nobody() -> None:
    metrics = Metrics()
    configs = ({"name": "red"}, {"name": "green"})
    with served(*configs, hibernate_after=SOON, metrics=metrics) as server, server.client(world="green"):
        sleeps(server, "red")
        for _ in range(3):
            assert [world["asleep"] for world in server.client().worlds()] == [True, False]
        page = server.call(metrics.page).decode()
        assert "nmes_worlds_asleep 1.0" in page and "nmes_worlds 2.0" in page
        assert asleep(server, "red")


# -- files -----------------------------------------------------------------------------------------------------------


def open_files(folder: Path) -> list[str]:
    targets = []
    for number in os.listdir("/proc/self/fd"):
        with suppress(FileNotFoundError):  # the host closes files meanwhile
            targets.append(os.readlink(f"/proc/self/fd/{number}"))
    return [target for target in targets if target.startswith(str(folder))]


def test_a_sleeping_world_has_no_file_open_and_its_recording_is_whole(tmp_path: Path) -> None:
    with served({"backend": "mujoco"}, record_to=tmp_path, hibernate_after=SOON) as server:
        session(server, SESSIONS[0])
        sleeps(server)
        (path,) = tmp_path.iterdir()
        until(lambda: open_files(tmp_path) == [])
        assert Recording(path).complete and replay(path).verdict == "reproduced"
        session(server, SESSIONS[2])
        assert len(open_files(tmp_path)) <= 1
        sleeps(server)
        assert Recording(path).complete and len(digests(path)) == 35
    assert Recording(path).complete and replay(path).verdict == "reproduced"


def test_a_world_is_told_to_be_asleep_once_its_recording_is_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate, rest = threading.Event(), Recorder.rest

    def wait(recorder: Recorder) -> None:
        assert gate.wait(PATIENCE)
        rest(recorder)

    monkeypatch.setattr(Recorder, "rest", wait)
    with served({"backend": "ballistic"}, record_to=tmp_path, hibernate_after=SOON) as server:
        session(server, [{"type": "step"}])
        until(lambda: asleep(server))  # its engine is let go, and its recording not yet complete
        told = [world["asleep"] for world in server.client().worlds()]
        gate.set()
        assert told == [False]
        until(lambda: [world["asleep"] for world in server.client().worlds()] == [True])
        (path,) = tmp_path.iterdir()
        assert Recording(path).complete


@pytest.mark.parametrize("harm", [Path.unlink, lambda path: os.truncate(path, 999), lambda path: path.write_bytes(b"")])
def test_a_recording_that_was_harmed_in_its_sleep_stops_the_world_and_says_so(
    harm: Callable[[Path], None], tmp_path: Path
) -> None:
    with served({"backend": "mujoco"}, record_to=tmp_path, hibernate_after=SOON, flush_interval=0.0) as server:
        sleeps(server)
        until(lambda: open_files(tmp_path) == [])
        (path,) = tmp_path.iterdir()
        harm(path)
        with pytest.raises((CommandFailed, OSError)) as refused, server.client() as client:
            client.step()
            client.step()
        assert getattr(refused.value, "code", "") in ("recording_failed", "world_faulted", "disconnected")
        assert "recording" in str(server.call(lambda: server.hosted.status.fault))


def test_what_was_told_before_a_kill_is_in_the_recording_whether_it_slept_or_not(tmp_path: Path) -> None:
    options = ["--port", "0", "--mode", "lockstep", "--flush-interval", "0", "--hibernate-after", "0.05"]
    options += ["--worlds", "red,green,blue", "--record", str(tmp_path)]
    told: dict[str, int] = {}
    with process("serve", "--json", *options, NMES_PASSWORD=PASSWORD) as server:
        port = ready(server)["port"]
        asker = Client(port=port, password=PASSWORD, timeout=PATIENCE)
        for turn in range(3):
            for name in ("red", "green", "blue"):
                with Client(port=port, password=PASSWORD, world=name, timeout=PATIENCE) as client:
                    if turn == 0:
                        client.spawn_cube("a", position=[0, 3, 0])
                    told[name] = client.step(7)["frame"]
            if turn < 2:
                until(lambda: all(world["asleep"] for world in asker.worlds()))
        server.send_signal(signal.SIGKILL)
        server.wait(PATIENCE)
    assert told == dict.fromkeys(told, 21)
    for path in tmp_path.iterdir():
        report = replay(path)
        assert (report.verdict, report.ticks) == ("reproduced", 21)


def test_a_world_that_slept_can_be_resumed_after_a_kill(tmp_path: Path) -> None:
    options = ["--port", "0", "--mode", "lockstep", "--flush-interval", "0", "--hibernate-after", "0.05"]
    with process("serve", "--json", *options, "--record", str(tmp_path), NMES_PASSWORD=PASSWORD) as server:
        line = ready(server)
        with Client(port=line["port"], password=PASSWORD, timeout=PATIENCE) as client:
            client.spawn_cube("a", position=[0, 3, 0])
            client.step(9)
            state = client.get_cube_state("a")
        until(lambda: Client(port=line["port"], password=PASSWORD, timeout=PATIENCE).worlds()[0]["asleep"])
        server.kill()
        server.wait(PATIENCE)
    again = ["--port", "0", "--no-record", "--resume", line["recording"]]
    with process("serve", "--json", *again, NMES_PASSWORD=PASSWORD) as server:
        with Client(port=ready(server)["port"], password=PASSWORD, timeout=PATIENCE) as client:
            assert client.get_world_info()["frame"] == 9 and client.get_cube_state("a") == state


# -- a world by itself -----------------------------------------------------------------------------------------------


def act(world: World, draw: random.Random) -> None:
    """Somebody comes, does something and goes."""
    client = world.join()
    cubes = world.cubes()
    choices: list[dict[str, Any]] = [
        {"type": "spawn_cube", "position": [draw.uniform(-3, 3), draw.uniform(1, 4), draw.uniform(-3, 3)]},
        {"type": "step", "ticks": draw.randint(1, 25)},
        {"type": "set_mode", "mode": "lockstep"},
        {"type": "reset", "seed": draw.randint(0, 9)},
    ]
    if cubes:
        name = draw.choice(cubes)
        choices += [
            {"type": "apply_physics", "cube_name": name, "impulse": [draw.uniform(-2, 2), 1, 0]},
            {"type": "freeze_cube", "cube_name": name, "freeze": draw.random() < 0.5},
            {"type": "set_cube_state", "cube_name": name, "position": [0, 5, 0]},
            {"type": "despawn_cube", "cube_name": name},
            {"type": "create_joint", "cube1": name, "cube2": draw.choice(cubes), "joint_type": "hinge"},
        ]
    for _ in range(draw.randint(1, 4)):
        world.execute(client, draw.choice(choices))
    world.leave(client)


@settings(max_examples=15)
@given(seed=st.integers(0, 2**32), naps=st.lists(st.booleans(), min_size=8, max_size=8))
def test_whenever_a_world_sleeps_it_is_the_same_world(
    tmp_path_factory: pytest.TempPathFactory, seed: int, naps: list[bool]
) -> None:
    """One sleeps and is taken up anew; the other is only saved at the same places, and lives on."""
    config = {"backend": "mujoco", "mode": "lockstep", "keyframes": 0.2}
    path = tmp_path_factory.mktemp("naps") / "a.mcap"
    world, other = World(config), World(config)
    world.journal = recorder = Recorder(path, world, flush_interval=0)
    draws = random.Random(seed), random.Random(seed)
    for nap in naps:
        act(world, draws[0])
        act(other, draws[1])
        if nap:
            world.hibernate()
            recorder.rest()
            other.snapshot()
            assert (world.asleep, world.running, Recording(path).complete) == (True, False, True)
            world.wake()
        assert world.digest() == other.digest() and world.frame == other.frame and world.seed == other.seed
    recorder.close()
    assert replay(path).verdict == "reproduced"
    world.close()
    other.close()


def test_what_happens_after_a_world_wakes_is_recorded_however_soon_it_is_closed(tmp_path: Path) -> None:
    world = World({"backend": "ballistic", "mode": "lockstep"})
    world.journal = recorder = Recorder(tmp_path / "a.mcap", world, flush_interval=60)
    act(world, random.Random(1))
    world.hibernate()
    recorder.rest()
    world.wake()
    client = world.join()
    world.execute(client, {"type": "step", "ticks": 3})
    world.journal = None
    recorder.close()
    recording = Recording(recorder.path)
    assert recording.complete and recording.last_frame == world.ticks
    world.close()


def test_only_an_empty_world_that_can_be_saved_hibernates() -> None:
    world = World({"backend": "ballistic", "mode": "lockstep"})
    client = world.join()
    occupied = world.idle
    with pytest.raises(WorldError) as refused:
        world.hibernate()
    assert refused.value.code == "wrong_mode"
    world.leave(client)
    assert (occupied, world.idle) == (False, True)
    world.hibernate()
    world.close()


def test_the_engine_of_a_sleeping_world_is_gone_without_a_collection_of_garbage() -> None:
    world = World({"backend": "mujoco", "mode": "lockstep"})
    act(world, random.Random(1))
    left = [weakref.ref(thing) for thing in (world.entities, world.all_creatures)]
    gc.collect()
    gc.disable()
    try:
        world.hibernate()
        assert [thing() for thing in left] == [None, None]
    finally:
        gc.enable()
    world.close()


def test_a_world_whose_engine_has_no_snapshots_stays_awake() -> None:
    world = World({"backend": "pymunk", "mode": "lockstep"})
    assert not world.idle
    with pytest.raises(WorldError) as refused:
        world.hibernate()
    assert refused.value.code == "unsupported"
    with served({"backend": "pymunk"}, hibernate_after=SOON) as server:
        time.sleep(4 * SOON)
        assert not asleep(server)


def test_a_fault_that_comes_in_its_sleep_is_there_when_a_world_wakes() -> None:
    world = World({"backend": "ballistic", "mode": "lockstep"})
    world.hibernate()
    world.stop_recording(RecordingError("recording_failed", "the disk is full"))
    world.wake()
    assert world.fault is not None and world.fault.code == "recording_failed"
    world.close()


def test_where_the_recording_cannot_be_kept_the_world_faults_and_stays(tmp_path: Path) -> None:
    world = World({"backend": "ballistic", "mode": "lockstep"})
    world.journal = recorder = Recorder(tmp_path / "a.mcap", world, flush_interval=0)
    recorder.close()
    world.hibernate()
    assert world.fault is not None and world.fault.code == "recording_failed"
    assert not world.asleep


def test_a_world_whose_snapshot_is_not_sound_stays_awake_and_loses_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def refuse(self: Any, snapshot: bytes) -> None:
        raise ValueError("planted")

    monkeypatch.setattr(ballistic.BallisticSimulation, "restore", refuse)

    def tried() -> int:
        """Returns how often it tried to sleep since its only tick; before that it may have, too."""
        (path,) = tmp_path.iterdir()
        server.run(server.hosted.flush())
        kinds = [record.kind for record in Recording(path)]
        return kinds[kinds.index(Kind.TICKS) :].count(Kind.HIBERNATED)

    with served({"backend": "ballistic"}, record_to=tmp_path, hibernate_after=SOON) as server:
        session(server, [{"type": "spawn_cube", "cube_name": "a", "position": [0, 3, 0]}, {"type": "step"}])
        until(lambda: tried() > 0)
        assert not asleep(server)
        with server.client() as client:
            assert client.get_world_info()["frame"] == 1 and client.get_cube_list()["cubes"] == ["a"]
        time.sleep(4 * SOON)
        assert not asleep(server)
        assert tried() == 1  # and not on and on


# -- what else runs it again -----------------------------------------------------------------------------------------


@pytest.fixture
def slept(tmp_path: Path) -> Iterator[Path]:
    looks = [{"type": "get_cube_info", "cube_name": name} for name in ("c0", "c1", "c2")]  # contacts: only of a state
    with served({"backend": "mujoco"}, record_to=tmp_path, hibernate_after=SOON) as server:
        for commands in (*SESSIONS[:3], looks):
            session(server, commands)
            sleeps(server)
    (path,) = tmp_path.glob("*.mcap")
    yield path


def test_every_way_to_run_a_recording_again_knows_of_sleep(slept: Path, tmp_path: Path) -> None:
    recording = Recording(slept)
    assert ("hibernated", 20) in told_by(recording)
    log = tmp_path / "log.jsonl"
    with log.open("w") as file:
        write_jsonl(messages(recording), file)
    assert any(json.loads(line)["kind"] == "hibernated" for line in log.read_text().splitlines())
    assert replay_log(Log(log)).verdict == "reproduced"
    assert measure_drift(recording, "ballistic").ended is None
    assert measure_drift(recording, "mujoco").ended is None
    slept_so_often = [entry[0] for entry in told_by(recording)].count("hibernated")
    assert summarize(recording).hibernations == slept_so_often >= 4  # also before the first client, if that was late
