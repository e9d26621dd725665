"""What a host records of its worlds, and how recordings are completed when it closes."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from nmes.errors import Disconnected, NmesError, RecordingError
from nmes.playback import replay
from nmes.protocol import DELIMITER, Limits
from nmes.recording import Kind, Recorder, Recording
from nmes.server import Host
from servers import PASSWORD, PATIENCE, Peer, Served, served, types, until

PING = json.dumps({"type": "ping"}).encode() + DELIMITER


@pytest.fixture
def server() -> Iterator[Served]:
    with served() as running:
        yield running


# -- recordings -------------------------------------------------------------------------------------------------------


def test_everything_but_the_password_is_recorded(tmp_path: Path) -> None:
    with served(record_to=tmp_path / "deep" / "down") as server:
        with server.peer() as peer:
            peer.ask({"type": "spawn_cube", "cube_name": "a"})
            peer.ask({"type": "step", "ticks": 3})
            peer.send(b'{"type":' + DELIMITER)
            peer.hear()
        until(lambda: server.clients() == 0)
        assert PASSWORD not in repr(vars(server.host)) + repr(server.hosted)
    (path,) = (tmp_path / "deep" / "down").iterdir()
    assert path.name.startswith("main-")
    recording = Recording(path)
    assert recording.complete
    kinds = [record.kind for record in recording if record.client in (None, 1)]
    expected = [Kind.JOINED, Kind.COMMAND, Kind.REPLY, Kind.COMMAND, Kind.TICKS, Kind.REPLY, Kind.REFUSED, Kind.REPLY]
    assert kinds[: len(expected)] == expected
    assert Kind.LEFT in kinds
    assert b"correct horse" not in b"".join(record.data for record in recording) + path.read_bytes()


def test_an_oversize_frame_is_recorded_as_refused_and_does_not_spoil_the_replay(tmp_path: Path) -> None:
    with served(limits=Limits(frame=100), record_to=tmp_path) as server, server.peer() as peer:
        peer.send(PING + b"x" * 200)
        assert len(peer.rest()) == 2
    (path,) = tmp_path.iterdir()
    refused, answer = [record for record in Recording(path) if record.client == 1][3:5]
    assert (refused.kind, refused.data) == (Kind.REFUSED, b"")
    assert json.loads(answer.data)["code"] == "frame_too_large"
    report = replay(path)
    assert (report.verdict, report.commands) == ("reproduced", 2)


def test_recordings_never_overwrite_each_other(tmp_path: Path) -> None:
    for _ in range(3):
        with served({"name": "a/b"}, record_to=tmp_path):
            pass
    paths = list(tmp_path.iterdir())
    assert len(paths) == 3
    assert all(path.name.startswith("a_b-") for path in paths)


def test_a_recording_is_flushed_by_itself(tmp_path: Path) -> None:
    with served(record_to=tmp_path) as server, server.client() as client:
        client.spawn_cube("a")
        (path,) = tmp_path.iterdir()
        until(lambda: any(record.kind is Kind.COMMAND for record in Recording(path)))


def test_a_recording_that_cannot_be_written_faults_its_world(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(self: Recorder) -> None:
        raise RecordingError("recording_failed", "the disk is full")

    with served(record_to=tmp_path) as server, server.client() as client:
        client.subscribe(events=["tick"])
        monkeypatch.setattr(Recorder, "flush", full)
        fault = next(client.events(timeout=PATIENCE))
        assert fault["type"] == "world_fault"
        assert fault["code"] == "recording_failed"
        with pytest.raises(NmesError) as failed:
            client.spawn_cube()
        assert failed.value.code == "world_faulted"
        assert "the disk is full" in caplog.text


def test_a_recordings_directory_that_cannot_be_created_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(RecordingError, match="cannot make"):
        Host("x", record_to=tmp_path / "file" / "below").add({"backend": "ballistic"})


# -- the end ----------------------------------------------------------------------------------------------------------


def test_closing_tells_subscribers_and_completes_the_recording(tmp_path: Path) -> None:
    with served(record_to=tmp_path) as server:
        subscriber, client, idle = server.peer(), server.client().connect(), server.peer(None)
        subscriber.ask({"type": "subscribe"})
        server.close()
        assert types(subscriber.rest()) == ["world_closed"]
        with pytest.raises(Disconnected):
            client.ping()
        assert idle.rest() == []
        for closing in (subscriber.socket, client, idle.socket):
            closing.close()
        with pytest.raises(ConnectionRefusedError):
            Peer(server.port)
    (path,) = tmp_path.iterdir()
    assert Recording(path).complete


def test_closing_during_commands_of_a_client_that_left_completes_the_recording(tmp_path: Path) -> None:
    with served(record_to=tmp_path) as server:
        with server.peer("raw") as peer:
            peer.say(*[{"type": "step", "ticks": 200}] * 300)
        until(lambda: server.call(lambda: server.hosted.world.frame) > 0)
    (path,) = tmp_path.iterdir()
    assert Recording(path).complete


def test_a_recording_that_cannot_be_completed_is_logged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    close = Recorder.close

    def full(self: Recorder) -> None:
        close(self)
        raise RecordingError("recording_failed", "the disk is full")

    monkeypatch.setattr(Recorder, "close", full)
    with served(record_to=tmp_path):
        pass
    assert "could not be completed: the disk is full" in caplog.text
