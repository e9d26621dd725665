"""Worlds that are away, in a thread of their own: nobody waits for them, and what they do is the same."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

import nmes.server.threads
from nmes.errors import RecordingError
from nmes.playback import replay
from nmes.protocol import Limits, Request
from nmes.recording import Kind, Recorder, Recording
from nmes.recording.mcap_writer import Writer
from nmes.server.connection import Connection
from nmes.server.hosted_world import HostedWorld
from nmes.server.threads import Worker
from nmes.world import World
from servers import PASSWORD, PATIENCE, Peer, Served, served, until

LONG = {"type": "step", "ticks": 10_000}
STEP = {"type": "step"}


class Gate:
    """Stops a world's engine at each tick until it is opened."""

    def __init__(self, hosted: HostedWorld) -> None:
        self._entered = threading.Semaphore(0)
        self._open = threading.Semaphore(0)
        self._wide = False
        self.threads: set[threading.Thread] = set()
        simulation: Any = hosted.world.simulation
        self._step: Callable[[int], None] = simulation.step
        simulation.step = self._tick

    def _tick(self, substeps: int) -> None:
        if not self._wide:
            self.threads.add(threading.current_thread())
            self._entered.release()
            assert self._open.acquire(timeout=PATIENCE)
        self._step(substeps)

    def wait(self) -> None:
        """Returns when the world has come to a tick."""
        assert self._entered.acquire(timeout=PATIENCE)

    def open(self) -> None:
        """Lets the world go on for good."""
        self._wide = True
        self._open.release()


def enter(server: Served, world: str) -> Peer:
    peer = server.peer(None)
    welcome = peer.ask({"type": "auth", "password": PASSWORD, "world": world})
    assert welcome["world"] == world
    return peer


def cores(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    monkeypatch.setattr("nmes.server.threads.os.sched_getaffinity", lambda _: set(range(count)), raising=False)


@contextmanager
def gated(*configs: dict[str, Any], **options: Any) -> Iterator[tuple[Served, Gate]]:
    """Serves worlds; the first is stopped at its next tick."""
    with served({"name": "slow"}, *configs, **options) as server:
        gate = Gate(server.call(lambda: server.host.worlds["slow"]))
        try:
            yield server, gate
        finally:
            gate.open()


def frames(path: Path) -> list[str]:
    """Returns the kinds of a recording's inputs, ticks and replies, in order."""
    return [record.kind.value for record in Recording(path) if record.kind not in (Kind.POSES, Kind.SCENE)]


# -- nobody waits for it ----------------------------------------------------------------------------------------------


def test_sensing_with_many_rays_is_done_away_from_the_event_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = {"type": "camera", "cube": "a", "width": 16, "height": 16, "direction": [1, 0, 0]}
    eyes = {
        **{"format": "nmes-genome/1", "name": "eyes"},
        "body": {"cubes": [{"id": "a", "size": 0.4, "mass": 1, "position": [0, 0.2, 0]}]},
        "sensors": [{**camera, "id": f"eye-{number}"} for number in range(4)],
    }
    handle, threads = World.handle, []

    def watched(world: World, client: int, request: Request) -> bytes:
        threads.append(threading.current_thread())
        return handle(world, client, request)

    with served({"backend": "mujoco"}) as server, server.peer() as peer:
        assert peer.ask({"type": "spawn_creature", "genome": eyes, "name": "eyes"})["type"] == "creature_spawned"
        monkeypatch.setattr(World, "handle", watched)
        assert peer.ask({"type": "sense", "creature": "eyes"})["type"] == "senses"
        assert len(threads) == 1 and threads[0] is not server.call(threading.current_thread)


@pytest.mark.parametrize(
    "command", [LONG, {"type": "batch", "commands": [{"type": "ping"}, LONG]}], ids=lambda command: command["type"]
)
def test_a_long_step_does_not_delay_other_worlds(command: dict[str, Any]) -> None:
    with gated({"name": "other"}) as (server, gate), enter(server, "slow") as slow:
        with enter(server, "other") as before:
            slow.say(command)
            gate.wait()
            assert before.ask({"type": "ping"})["type"] == "pong"
            assert before.ask({"type": "step", "ticks": 50})["frame"] == 50
            with enter(server, "other") as late:
                assert late.ask({"type": "get_world_info"})["counts"]["clients"] == 2
            worlds = server.client().worlds()
            assert [(world["world"], world["frame"], world["clients"]) for world in worlds] == [
                ("slow", 0, 1),
                ("other", 50, 1),
            ]
        gate.open()
        assert slow.hear()["type"] in ("stepped", "batch_result")
        assert slow.ask(STEP)["frame"] == 10_001
        assert gate.threads.isdisjoint({threading.current_thread()})
        loop_thread = server.call(threading.current_thread)
        assert loop_thread not in gate.threads


def test_commands_during_a_long_step_keep_their_order(tmp_path: Path) -> None:
    with (
        gated(record_to=tmp_path) as (server, gate),
        server.peer() as one,
        server.peer() as two,
        server.peer() as three,
    ):
        one.say({"type": "spawn_cube", "cube_name": "a"}, LONG, {"type": "ping", "id": 1})
        assert one.hear()["spawned"] == "a"  # what was answered before is told at once
        gate.wait()
        two.say({"type": "spawn_cube", "cube_name": "b"}, {"type": "ping", "id": 2})
        until(lambda: server.call(lambda: len(server.hosted._waiting)) == 1)
        three.say({"type": "despawn_cube", "cube_name": "b"})
        until(lambda: server.call(lambda: len(server.hosted._waiting)) == 2)
        with server.peer(None) as newcomer:
            newcomer.say({"type": "auth", "password": PASSWORD}, {"type": "get_cube_list"})
            until(lambda: server.call(lambda: len(server.hosted._waiting)) == 3)
            gate.open()
            assert newcomer.hear()["client"] == 4
            assert newcomer.hear()["cubes"] == ["a"]
        assert [one.hear()["type"] for _ in range(2)] == ["stepped", "pong"]
        assert [two.hear()["type"] for _ in range(2)] == ["cube_list", "pong"]
        assert three.hear()["type"] == "cube_despawned"
    (path,) = tmp_path.iterdir()
    assert replay(path).verdict == "reproduced"


def test_a_client_that_leaves_during_a_long_step_has_left_after_it(tmp_path: Path) -> None:
    with gated(record_to=tmp_path) as (server, gate), server.peer() as watcher:
        with server.peer() as one, server.peer("raw") as two:
            one.say({"type": "subscribe", "events": ["tick"]}, LONG)
            assert one.hear()["type"] == "subscribed"
            gate.wait()
            two.say({"type": "spawn_cube", "cube_name": "b"})
        with server.peer(None) as never_in:  # and who comes and goes meanwhile is obeyed all the same
            never_in.send(PASSWORD.encode() + nmes.protocol.DELIMITER)
            never_in.say({"type": "spawn_cube", "cube_name": "c"})
            until(lambda: server.call(lambda: len(server.hosted._waiting)) == 2)
        gate.open()
        until(lambda: watcher.ask({"type": "get_world_info"})["counts"]["clients"] == 1)
        assert watcher.ask({"type": "get_cube_list"})["cubes"] == ["b", "c"]
    (path,) = tmp_path.iterdir()
    assert replay(path).verdict == "reproduced"
    assert frames(path).count("left") == 4


def test_events_come_during_a_long_step_and_before_its_reply(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nmes.server.threads, "SLICE", 0.0)
    monkeypatch.setattr(nmes.server.threads, "BRIEF", 0.0)
    with gated() as (server, gate), server.peer() as peer, server.peer() as watcher:
        for each in (peer, watcher):
            each.ask({"type": "subscribe", "events": ["tick"]})
        peer.say({"type": "step", "ticks": 3})
        for frame in (1, 2):
            gate.wait()
            gate._open.release()
            assert [each.hear()["frame"] for each in (peer, watcher)] == [frame, frame]
        gate.open()
        assert [peer.hear()["type"] for _ in range(2)] == ["tick", "stepped"]


def test_a_subscriber_that_never_reads_is_cut_during_a_long_step() -> None:
    with served(limits=Limits(pending=64 << 10, stall_timeout=1000)) as server, server.peer() as peer:
        with server.peer(receive_buffer=4096) as deaf:
            deaf.say({"type": "subscribe", "events": ["tick"]})
            until(lambda: server.clients() == 2)
            stepped: list[int] = []

            def cut() -> bool:  # 600 KB of events a step, and the system takes some MB before any wait in the host
                stepped.append(peer.ask(LONG)["frame"])
                return server.clients() == 1

            until(cut, attempts=100)
            assert stepped == [10_000 * (number + 1) for number in range(len(stepped))]
            messages = [json.loads(frame) for frame in deaf.rest()]
        assert messages[-1]["code"] == "slow_consumer"
        assert [event["frame"] for event in messages[1:-1]] == list(range(1, len(messages) - 1))


# -- worlds side by side ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["lockstep", "fast"])
def test_two_worlds_tick_at_the_same_time(monkeypatch: pytest.MonkeyPatch, mode: str) -> None:
    cores(monkeypatch, 2)
    together = threading.Barrier(2)
    with (
        served({"name": "red"}, {"name": "green"}) as server,
        enter(server, "red") as red,
        enter(server, "green") as green,
    ):
        for hosted in server.host.worlds.values():
            simulation: Any = hosted.world.simulation

            def meet(substeps: int, step: Callable[[int], None] = simulation.step) -> None:
                together.wait(PATIENCE)  # for the other one: each is in the middle of a tick
                step(substeps)

            simulation.step = meet
        if mode == "fast":
            for peer in (red, green):
                peer.say({"type": "set_mode", "mode": "fast"})
            assert red.hear()["type"] == green.hear()["type"] == "mode_set"
            until(lambda: min(p.ask({"type": "get_world_info"})["frame"] for p in (red, green)) > 50)
            together.abort()
        else:
            for peer in (red, green):
                peer.say({"type": "step", "ticks": 200})
            assert red.hear()["frame"] == green.hear()["frame"] == 200


def test_as_many_worlds_run_at_once_as_cores_and_all_have_their_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    cores(monkeypatch, 1)
    inside: list[str] = []
    most = 0
    history: list[str] = []
    names = ("red", "green", "blue")
    with served(*({"name": name} for name in names)) as server:
        peers = [enter(server, name) for name in names]
        for name, hosted in server.host.worlds.items():
            simulation: Any = hosted.world.simulation

            def tick(substeps: int, name: str = name, step: Callable[[int], None] = simulation.step) -> None:
                nonlocal most
                inside.append(name)
                most = max(most, len(inside))
                threading.Event().wait(0.002)
                history.append(name)
                step(substeps)
                inside.remove(name)

            simulation.step = tick
        # The first two would take a minute: the third has its turn between theirs.
        peers[0].say(LONG)
        peers[1].say(LONG)
        peers[2].say({"type": "step", "ticks": 100})
        assert peers[2].hear()["frame"] == 100
        server.close()
        for peer in peers:
            assert peer.rest() == []
            peer.socket.close()
    assert most == 1
    turns = [a for a, b in pairwise(history) if a != b]
    assert len(turns) > 20 and set(turns) == set(names)


@pytest.mark.parametrize("light", [True, False])
def test_worlds_of_light_ticks_that_are_behind_catch_up_in_the_loop(
    monkeypatch: pytest.MonkeyPatch, light: bool
) -> None:
    spent, each = [0.0], 1e-4 if light else 1e-3  # s, of the processor's time: in all, and what a tick takes
    monkeypatch.setattr(nmes.server.threads, "thread_time", lambda: spent[0])
    names = ("red", "green")
    with served(*({"name": name, "mode": "realtime", "rate": 20} for name in names)) as server:
        threads: dict[str, set[threading.Thread]] = {name: set() for name in names}
        for name, hosted in server.host.worlds.items():
            simulation: Any = hosted.world.simulation

            def tick(substeps: int, name: str = name, step: Callable[[int], None] = simulation.step) -> None:
                threads[name].add(threading.current_thread())
                spent[0] += each
                step(substeps)

            def meter(worker: Any = hosted._worker, simulation: Any = simulation, tick: Any = tick) -> None:
                worker._cost, simulation.step = each, tick

            server.call(meter)
        frames = [hosted.status.frame for hosted in server.host.worlds.values()]
        server.call(lambda: threading.Event().wait(0.2))  # 240 ticks become due
        for hosted, frame in zip(server.host.worlds.values(), frames, strict=True):
            until(lambda hosted=hosted, frame=frame: server.call(lambda: hosted.status.frame) > frame + 240)  # type: ignore[misc]
        loop = server.call(threading.current_thread)
    assert all((used == {loop}) is light for used in threads.values())


def test_how_long_a_tick_takes_does_not_count_what_others_do_meanwhile() -> None:
    with served({"mode": "realtime"}) as server:
        simulation: Any = server.hosted.world.simulation
        step = simulation.step

        def waits(substeps: int) -> None:
            threading.Event().wait(0.01)  # as for Python's lock, or for a core
            step(substeps)

        simulation.step = waits
        frame = server.call(lambda: server.hosted.status.frame)
        until(lambda: server.call(lambda: server.hosted.status.frame) > frame + 20)
        assert server.call(lambda: server.hosted._worker._cost) < 0.005


def test_worlds_in_parallel_have_the_same_digests_as_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cores(monkeypatch, 2)
    names = ("red", "green", "blue")

    def experiment(server: Served, name: str, results: dict[str, list[Any]]) -> None:
        with server.client(world=name) as client:
            client.subscribe(events=["tick", "state"], every=7)
            for n in range(10):
                client.spawn_cube(position=[0.3 * n, 3 + 1.5 * n, 0.1 * n], rotation=[n, 0, 0.5])
            results[name] = [client.get_world_state()]
            for ticks in (1, 60, 250, 3):
                client.apply_force(force=[20, 0, 5])
                client.step(ticks)
                results[name].append(client.get_world_state())
            results[name] += client.events(timeout=0.05)

    def run(worlds: tuple[str, ...], folder: Path) -> dict[str, list[Any]]:
        results: dict[str, list[Any]] = {}
        busy = {"name": "busy", "mode": "fast", "backend": "mujoco"}
        configs = [{"name": name, "backend": "mujoco", "seed": 5} for name in worlds]
        with served(*configs, *([busy] if len(worlds) > 1 else []), record_to=folder) as server:
            threads = [threading.Thread(target=experiment, args=(server, name, results)) for name in worlds]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join(PATIENCE)
        return results

    together = run(names, tmp_path / "together")
    for name in names:
        alone = run((name,), tmp_path / name)
        assert together[name] == alone[name]
        (one,), (other,) = (tmp_path / "together").glob(f"{name}-*"), (tmp_path / name).glob("*")
        assert digests(one) == digests(other)
        assert len(digests(one)) == 314
        assert replay(one).verdict == "reproduced"


def digests(path: Path) -> list[str]:
    return [
        digest
        for record in Recording(path)
        if record.kind is Kind.TICKS and record.about
        for digest in record.about["digests"]
    ]


# -- faults, disks and the end ----------------------------------------------------------------------------------------


def test_a_fault_during_a_long_step_is_reported(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with gated(record_to=tmp_path) as (server, gate), server.peer() as peer, server.peer() as watcher:
        watcher.ask({"type": "subscribe", "events": ["tick"], "every": 1000})
        peer.ask({"type": "spawn_cube", "cube_name": "a", "mass": 1e-6})
        peer.ask({"type": "apply_force", "cube_name": "a", "force": [1e15, 0, 0]})
        peer.say(LONG, {"type": "ping"})
        gate.open()
        assert [peer.hear()["code"], peer.hear()["type"]] == ["world_faulted", "pong"]
        assert watcher.hear()["type"] == "world_fault"
        assert caplog.text.count("world 'slow' stopped") == 1
        assert peer.ask({"type": "reset"})["frame"] == 0
        assert peer.ask(LONG)["frame"] == 10_000
    (path,) = tmp_path.iterdir()
    assert replay(path).verdict == "reproduced"


def test_closing_ends_a_long_step_and_completes_the_recording(tmp_path: Path) -> None:
    with served(record_to=tmp_path) as server, server.peer() as peer, server.peer() as watcher, server.peer() as gone:
        watcher.ask({"type": "subscribe", "events": ["tick"]})
        simulation: Any = server.hosted.world.simulation
        step = simulation.step

        def slow(substeps: int) -> None:
            threading.Event().wait(0.01)
            step(substeps)

        simulation.step = slow
        peer.say(LONG, {"type": "spawn_cube"})  # for 100 s
        assert watcher.hear()["frame"] == 1
        gone.socket.close()
        with server.peer(None) as newcomer:
            newcomer.say({"type": "auth", "password": PASSWORD})
            until(lambda: server.call(lambda: len(server.hosted._waiting)) == 1)
            server.close()
            assert newcomer.rest() == []
        assert peer.rest() == []
        messages = [json.loads(frame) for frame in watcher.rest()]
        assert messages[-1] == {"type": "world_closed"}
        assert [event["frame"] for event in messages[:-1]] == list(range(2, len(messages) + 1))
    (path,) = tmp_path.iterdir()
    recording = Recording(path)
    assert recording.complete
    assert frames(path)[-1] == "ticks"  # it ends in the middle of the step: nobody left after that
    report = replay(recording)
    assert (report.verdict, report.damage) == ("reproduced", None)
    assert 0 < recording.summary().ticks < 10_000


def test_ticks_of_a_long_step_are_on_disk_before_their_events(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nmes.server.threads, "SLICE", 0.0)
    monkeypatch.setattr(nmes.server.threads, "BRIEF", 0.0)
    syncs: list[tuple[int, threading.Thread]] = []

    def fsync(number: int) -> None:
        syncs.append((len(digests(path)), threading.current_thread()))

    with gated(record_to=tmp_path, flush_interval=0) as (server, gate), server.peer() as peer:
        (path,) = tmp_path.iterdir()
        peer.ask({"type": "subscribe", "events": ["tick"]})
        monkeypatch.setattr("nmes.recording.mcap_writer.os.fsync", fsync)
        peer.say({"type": "step", "ticks": 4})
        for frame in (1, 2, 3):
            gate.wait()
            gate._open.release()
            assert peer.hear()["frame"] == frame
            assert max(ticks for ticks, _ in syncs) >= frame
        assert syncs[-1][1] is not server.call(threading.current_thread)  # nobody else waits for the disk
        gate.open()
        assert [peer.hear()["type"] for _ in range(2)] == ["tick", "stepped"]
        assert frames(path)[-1] == "reply"


def test_events_whose_records_cannot_be_written_are_not_sent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nmes.server.threads, "SLICE", 0.0)
    monkeypatch.setattr(nmes.server.threads, "BRIEF", 0.0)
    with gated(record_to=tmp_path, flush_interval=0) as (server, gate), server.peer() as peer, server.peer() as watcher:
        watcher.ask({"type": "subscribe", "events": ["tick"]})
        peer.say({"type": "step", "ticks": 100})
        gate.wait()

        def fails(number: int) -> None:
            raise OSError(5, "Input/output error")

        monkeypatch.setattr("nmes.recording.mcap_writer.os.fsync", fails)
        gate.open()
        messages = [json.loads(frame) for frame in watcher.rest()]
        assert [(message["type"], message["code"]) for message in messages] == [("error", "recording_failed")]
        assert {json.loads(frame)["code"] for frame in peer.rest()} == {"recording_failed"}
        with server.peer() as late:
            assert late.ask(STEP)["code"] == "world_faulted"


def test_a_flush_that_fails_during_a_long_step_faults_the_world(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: Writer) -> None:
        raise RecordingError("recording_failed", "the disk is full")

    with gated(record_to=tmp_path, flush_interval=1000.0) as (server, gate), server.peer() as peer:
        peer.say(LONG)
        gate.wait()
        monkeypatch.setattr(Writer, "flush", full)
        server.run(server.hosted.flush())  # as the host does now and then
        gate.open()
        answer = peer.hear()
        assert (answer["code"], "the disk is full" in answer["message"]) == ("world_faulted", True)
        assert server.call(lambda: server.hosted.world.frame) < 10_000
        monkeypatch.undo()


def test_events_before_a_flush_that_fails_are_not_sent_where_they_must_be_on_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: Writer) -> None:
        raise RecordingError("recording_failed", "the disk is full")

    with gated(record_to=tmp_path, flush_interval=0) as (server, gate), server.peer() as peer, server.peer() as watcher:
        watcher.ask({"type": "subscribe", "events": ["tick"]})
        peer.say(LONG)
        gate.wait()
        monkeypatch.setattr(Writer, "flush", full)
        server.run(server.hosted.flush())
        monkeypatch.setattr(nmes.server.threads, "SLICE", 0.0)
        server.hosted._worker._until = 0.0
        gate.open()
        for each in (watcher, peer):
            told = [json.loads(frame) for frame in each.rest()]
            assert [(message["type"], message["code"]) for message in told] == [("error", "recording_failed")]
        monkeypatch.undo()


def test_a_command_whose_commit_fails_is_answered_by_the_failed_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(self: Recorder) -> None:
        raise RecordingError("recording_failed", "the disk is full")

    with gated(record_to=tmp_path, flush_interval=0) as (server, gate), server.peer() as peer:
        gate.open()
        monkeypatch.setattr(Recorder, "sync", full)
        peer.say(LONG)
        assert {json.loads(frame)["code"] for frame in peer.rest()} == {"recording_failed"}
        assert "a connection failed" not in caplog.text
        monkeypatch.undo()


def test_a_mistake_on_a_lost_connection_leaves_no_client_behind(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with gated() as (server, gate), server.peer() as peer, server.peer() as lost:
        peer.say(LONG)
        gate.wait()
        lost.say({"type": "ping"})
        until(lambda: server.call(lambda: len(server.hosted._waiting)) == 1)
        (connection,) = server.call(lambda: list(server.hosted._waiting))
        assert isinstance(connection, Connection)
        server.call(connection.abort)
        monkeypatch.setattr(HostedWorld, "submit", lambda *_: 1 / 0)
        server.call(connection.resume)
        assert server.call(lambda: server.hosted.clients) == 1
        assert "ZeroDivisionError" in caplog.text
        monkeypatch.undo()
        gate.open()
        assert peer.hear()["type"] == "stepped"


def test_a_world_that_closes_goes_to_no_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    with gated() as (server, gate):
        gate.open()
        hosted = server.hosted

        def close_and_turn() -> bool:
            hosted._closing = True
            try:
                hosted._turn()
                return hosted._worker.away
            finally:
                hosted._closing = False

        monkeypatch.setattr(nmes.server.threads, "SLICE", -1.0)  # all work is long
        monkeypatch.setattr(nmes.server.threads, "BRIEF", -1.0)
        assert server.call(close_and_turn) is False


def test_an_exception_in_a_long_step_ends_one_connection_only(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with gated() as (server, gate), server.peer() as peer, server.peer() as good:
        peer.say(LONG)
        gate.wait()
        monkeypatch.setattr(Worker, "_measure", lambda *_: 1 / 0)
        gate.open()
        (answer,) = peer.rest()
        assert json.loads(answer)["code"] == "internal"
        assert "ZeroDivisionError" in caplog.text
        assert good.ask({"type": "get_world_info"})["counts"]["clients"] == 1
