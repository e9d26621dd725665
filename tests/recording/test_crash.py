"""What is left of a recording when its host is killed in the midst of things, and when its disk fails."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from nmes import protocol
from nmes.errors import CommandFailed, Disconnected, NmesError, RecordingError
from nmes.playback import replay, world_at
from nmes.recording import Kind, Recorder, Recording
from nmes.world import World
from recordings import record, send
from servers import PATIENCE, Peer, served

NMES = str(Path(sys.executable).parent / "nmes")


class Talker(threading.Thread):
    """A client that talks on and on, with a rest after each command (s), and notes when which of them was answered."""

    def __init__(self, port: int, number: int, rest: float) -> None:
        super().__init__(daemon=True)
        self.number = number
        self.rest = rest
        self.answered: list[tuple[str, float]] = []
        self._peer = Peer(port)

    def run(self) -> None:
        rng = random.Random(self.number)
        with self._peer as peer:
            try:
                peer.ask({"type": "auth", "password": "crash"})
                for i in range(1_000_000):
                    commands: list[dict[str, object]] = [
                        {"type": "spawn_cube", "position": [rng.uniform(-9, 9), 5, 0]},
                        {"type": "step", "ticks": rng.randrange(1, 5)},
                        {"type": "get_world_info"},
                        {"type": "apply_physics", "force": [1, 2, 3]},
                    ]
                    command = rng.choice(commands)
                    name = f"{self.number}/{i}"
                    assert peer.ask({**command, "id": name})["id"] == name
                    self.answered.append((name, time.monotonic()))
                    time.sleep(self.rest)
            except (OSError, AssertionError):
                return  # it was killed


def crash(folder: Path, interval: float, seed: int) -> None:
    """Kills a busy host at a random moment and looks at what is left."""
    rng = random.Random(seed)
    mode = rng.choice(["realtime", "lockstep"])
    options = ["--backend", "ballistic", "--mode", mode, "--port", "0", "--record", str(folder)]
    with subprocess.Popen(
        [NMES, "serve", "--json", *options, "--flush-interval", str(interval)],
        env={**os.environ, "NMES_PASSWORD": "crash"},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    ) as server:
        assert server.stdout is not None
        announcement = json.loads(server.stdout.readline())
        # Where there is an interval, less than makes the host write because there is so much.
        talkers = [Talker(announcement["port"], number, 0.02 * interval) for number in range(2)]
        for talker in talkers:
            talker.start()
        time.sleep(rng.uniform(0, 2.5 * interval + 0.5))
        server.kill()
        killed = time.monotonic()
        server.wait()
    for talker in talkers:
        talker.join(PATIENCE)
        assert not talker.is_alive()
    recording = Recording(announcement["recording"])
    recorded_ids = {str(protocol.parse(item.data).id) for item in recording if item.kind is Kind.COMMAND}
    assert recording.damage is not None and recording.damage.cut
    # A host flushes twice in each interval, so that it keeps it where it comes to that half an interval late.
    for talker in talkers:
        due = {name for name, at in talker.answered if at < killed - interval or not interval}
        assert due <= recorded_ids, f"seed {seed}: lost {sorted(due - recorded_ids)[:5]} of {len(due)}"
    report = replay(recording)
    assert (report.verdict, report.cut) == ("reproduced", True)
    assert report.ticks == report.frames[1] == recording.summary().ticks
    world = world_at(recording)
    assert world.ticks == report.ticks
    world.close()


# The host keeps to half its interval. Two seconds leave a second for a machine that is busy with other tests.
@pytest.mark.parametrize(("interval", "seed"), [(0, 1), (0, 2), (2, 3)])
def test_a_killed_host_leaves_the_records_it_promised(tmp_path: Path, interval: float, seed: int) -> None:
    crash(tmp_path, interval, seed)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(100, 300))
def test_a_host_killed_at_any_moment_leaves_the_records_it_promised(tmp_path: Path, seed: int) -> None:
    crash(tmp_path, seed % 2, seed)


def test_no_reply_is_sent_before_its_record_is_on_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[int] = []  # the size of the recording whenever the disk had all of it

    def fsync(number: int) -> None:
        synced.append(os.fstat(number).st_size)

    monkeypatch.setattr("nmes.recording.mcap_writer.os.fsync", fsync)
    with served(record_to=tmp_path, flush_interval=0) as server, server.peer() as peer:
        (path,) = tmp_path.iterdir()
        for i in range(5):
            peer.say({"type": "ping", "id": i}, {"type": "step", "id": -i})
            peer.hear()
            peer.hear()
            data = path.read_bytes()
            assert len(data) == synced[-1]  # nothing was written since the disk last had all
            ids = [protocol.parse(r.data).id for r in Recording(path) if r.kind is Kind.COMMAND]
            assert ids[-2:] == [i, -i]
        count = len(synced)
        assert count <= 12  # once for all that one read brought


def test_by_default_replies_do_not_wait_for_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nmes.recording.mcap_writer.os.fsync", None)
    with served(record_to=tmp_path) as server, server.client() as client:
        assert client.ping()


def test_a_reply_whose_record_cannot_be_written_is_not_sent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with served(record_to=tmp_path, flush_interval=0) as server, server.client() as client, server.peer() as other:
        client.spawn_cube("a")
        other.ask({"type": "subscribe"})

        def fails(number: int) -> None:
            raise OSError(5, "Input/output error")

        monkeypatch.setattr("nmes.recording.mcap_writer.os.fsync", fails)
        with pytest.raises((CommandFailed, Disconnected)) as info:
            client.spawn_cube("b")
        assert info.value.code == "recording_failed"
        assert "Input/output error" in info.value.message
        frames = other.rest()
        assert [json.loads(frame)["type"] for frame in frames] == ["world_fault", "error"]
        assert {json.loads(frame)["code"] for frame in frames} == {"recording_failed"}
        world = server.hosted.world
        assert world.fault is not None and world.fault.code == "recording_failed"
        with server.client() as late, pytest.raises(NmesError) as refused:
            late.spawn_cube("c")
        assert refused.value.code == "world_faulted"


def test_a_recorder_flushes_at_its_interval(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = 1_800_000_000 * 10**9
    monkeypatch.setattr("nmes.recording.recorder.time_ns", lambda: now)
    for interval in (0.25, 20.0):
        path = tmp_path / f"{interval}.mcap"
        world = World({"backend": "ballistic"})
        world.journal = Recorder(path, world, pose_rate=0, flush_interval=interval)
        size = path.stat().st_size
        world.tick()
        now += int(interval * 1e9) - 1
        world.tick()
        world.journal.commit()
        assert path.stat().st_size == size
        now += 1
        world.tick()
        assert path.stat().st_size > size
        world.journal.close()


def test_commit_writes_all_records_to_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []
    monkeypatch.setattr("nmes.recording.mcap_writer.os.fsync", calls.append)
    world = World({"backend": "ballistic", "mode": "lockstep"})
    recorder = world.journal = Recorder(tmp_path / "x.mcap", world, flush_interval=0)
    client = world.join()
    recorder.commit()
    assert len(calls) == 2  # the file and its folder
    recorder.commit()
    assert len(calls) == 2  # nothing new
    send(world, client, type="step", ticks=3)
    recorder.commit()
    assert len(calls) == 3
    assert [r.kind for r in Recording(tmp_path / "x.mcap")][-1] is Kind.REPLY
    recorder.close()
    assert len(calls) == 4
    with pytest.raises(RecordingError, match="is closed"):
        recorder.commit()
    monkeypatch.undo()
    assert Recording(record(tmp_path / "y.mcap", lambda world, client: None)).complete
