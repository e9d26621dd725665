from __future__ import annotations

import hashlib
import os
import struct
from pathlib import Path
from typing import Any

import jsonschema_rs
import orjson
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.data_stream import ReadDataStream
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Chunk, MessageIndex
from mcap_protobuf.decoder import DecoderFactory

from disks import full_disk
from nmes import protocol
from nmes.backend.fingerprint import DECISIVE, differences
from nmes.errors import RecordingError
from nmes.recording import REFUSED_LIMIT, Kind, Recorder, Recording
from nmes.recording.mcap_format import encode_records, split_chunk
from nmes.recording.mcap_reader import Reader
from nmes.recording.mcap_writer import Writer
from nmes.recording.viewer_messages import ROOT, decode_poses
from nmes.world import World
from recordings import Script, busy, record, send, told_by


@pytest.fixture(scope="module")
def busy_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("recording") / "busy.mcap", busy)


# -- what is kept ----------------------------------------------------------------------------------------------------


def test_a_recording_holds_all_calls_of_the_journal_in_order(busy_file: Path) -> None:
    world = World({"backend": "ballistic", "mode": "lockstep"}, journal=(script := Script()))
    busy(world, world.join())
    recording = Recording(busy_file)
    assert told_by(recording) == script.entries
    assert recording.complete
    assert [item.sequence for item in recording] == sorted({item.sequence for item in recording})


def test_client_messages_are_kept_byte_for_byte(tmp_path: Path) -> None:
    raw = b'{ "id" : [1.50, null],\t"unknown":1e2 , "type":"ping" }'
    path = record(tmp_path / "x.mcap", lambda world, client: world.handle(client, protocol.parse(raw)))
    assert [item.data for item in Recording(path) if item.kind is Kind.COMMAND] == [raw]


def test_long_refused_frames_are_cut_with_a_note(tmp_path: Path) -> None:
    raw = b"x" * (REFUSED_LIMIT + 5)
    path = record(tmp_path / "x.mcap", lambda world, client: world.handle(client, protocol.parse(raw)))
    (frame,) = [item.data for item in Recording(path) if item.kind is Kind.REFUSED]
    assert frame == b"x" * REFUSED_LIMIT + b"... (65541 bytes in all)"


def test_records_have_simulation_time_and_wall_clock_time(busy_file: Path) -> None:
    frame = 0
    for item in Recording(busy_file):
        if item.kind is Kind.TICKS and item.about is not None:
            frame = item.about["frame"] + len(item.about["digests"]) - 1
        assert item.time == round(frame * 1_000_000_000 / 60)
    walls = [item.wall for item in Recording(busy_file)]
    assert walls == sorted(walls)
    assert walls[0] > 1_700_000_000 * 10**9


def test_metadata_say_how_to_run_the_world_again(busy_file: Path) -> None:
    recording = Recording(busy_file)
    protocol.validate_metadata(recording.metadata)
    assert recording.config == World({"backend": "ballistic", "mode": "lockstep"}).config
    assert set(DECISIVE) <= set(recording.fingerprint)
    assert any(name.startswith("engine.") for name in recording.fingerprint)
    assert recording.metadata["nmes.recording"]["schemas"] == protocol.schema_hash()


def test_only_what_affects_results_makes_fingerprints_differ(busy_file: Path) -> None:
    here = Recording(busy_file).fingerprint
    names = ("architecture", "simd", "libc", "cpu", "cpu_flags", "python", "os")
    assert differences(here, {**here, **dict.fromkeys(names, "another")}) == {}
    assert differences(here, {**here, "probe": "another"}) == {"probe": (here["probe"], "another")}
    assert differences(here, {**here, "engine.new": "1"}) == {"engine.new": ("", "1")}


def test_the_summary_counts_records(busy_file: Path) -> None:
    summary = Recording(busy_file).summary()
    assert (summary.clients, summary.refused, summary.errors, summary.ticks, summary.faults) == (2, 9, 9, 40, 0)
    assert summary.commands == {
        "apply_physics": 16,
        "step": 9,
        "get_cube_info": 8,
        "spawn_cube": 2,
        "pause": 1,
        "ping": 1,
        "get_world_state": 1,
    }


def test_a_recording_never_overwrites_a_file(busy_file: Path) -> None:
    with pytest.raises(RecordingError, match="exists already"):
        Recorder(busy_file, World({"backend": "ballistic"}))
    assert Recording(busy_file).complete


def test_after_close_a_world_refuses_unrecorded_commands(tmp_path: Path) -> None:
    world = World({"backend": "ballistic", "mode": "lockstep"})
    recorder = world.journal = Recorder(tmp_path / "x.mcap", world)
    client = world.join()
    recorder.close()
    recorder.close()
    assert send(world, client, type="ping")["type"] == "pong"
    assert world.fault is not None
    assert send(world, client, type="spawn_cube")["code"] == "world_faulted"


# -- for other readers -----------------------------------------------------------------------------------------------


def test_the_mcap_library_reads_a_recording(busy_file: Path) -> None:
    with busy_file.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "nmes"
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        messages = list(reader.iter_messages(log_time_order=False))
        assert len(messages) == summary.statistics.message_count
        assert [message.sequence for _, _, message in messages] == list(range(len(messages)))
        by_topic: dict[str, int] = {}
        for schema, channel, message in messages:
            by_topic[channel.topic] = by_topic.get(channel.topic, 0) + 1
            if schema is not None and schema.encoding == "jsonschema":
                jsonschema_rs.Draft202012Validator(orjson.loads(schema.data)).validate(orjson.loads(message.data))
            else:
                assert channel.message_encoding == ("protobuf" if schema else "application/octet-stream")
        assert {"commands", "replies", "refused", "ticks", "clients"} <= set(by_topic)
        for topic, count in by_topic.items():
            assert len(list(reader.iter_messages(topics=[topic]))) == count
        assert {item.name for item in reader.iter_metadata()} == {
            *Recording(busy_file).metadata,
            "nmes.end",
        }
        data = busy_file.read_bytes()  # the package writes the summary's records as they stand here
        for record in (*summary.schemas.values(), *summary.channels.values(), *summary.chunk_indexes):
            assert encode_records(record) in data
        for chunk in summary.chunk_indexes:
            for channel_id, offset in chunk.message_index_offsets.items():
                file.seek(offset + 9)
                index = MessageIndex.read(ReadDataStream(file))
                assert index.channel_id == channel_id
                expected = by_topic[summary.channels[channel_id].topic]
                assert len(index.records) == expected  # there is one chunk
                file.seek(chunk.chunk_start_offset + 9)
                content = zstandard.decompress(Chunk.read(ReadDataStream(file)).data)
                for time, at in index.records:
                    assert struct.unpack_from("<BQHIQ", content, at)[::2] == (5, channel_id, time)
    with busy_file.open("rb") as file:
        assert len(list(NonSeekingReader(file, validate_crcs=True).iter_messages())) == len(messages)


def test_viewers_get_poses_and_shapes(tmp_path: Path) -> None:
    positions: dict[int, dict[str, list[float]]] = {}

    def play(world: World, client: int) -> None:
        send(world, client, type="spawn_cube", cube_name="a", size=[1, 2, 3], color=[1, 0, 0.5, 1])
        send(world, client, type="spawn_cube", cube_name="b", position=[2, 9, 0])
        for i in range(30):
            if i == 10:
                send(world, client, type="despawn_cube", cube_name="a")
                send(world, client, type="spawn_cube", cube_name="c")
            send(world, client, type="step")
            names, states = world.poses()
            positions[world.frame] = {name: list(state[:3]) for name, state in zip(names, states, strict=True)}

    path = record(tmp_path / "x.mcap", play, pose_rate=20)
    scenes: list[Any] = []
    transforms: dict[int, dict[str, list[float]]] = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages(topics=["/tf", "/scene"]):
            if channel.topic == "/scene":
                scenes.append(decoded)
                continue
            frame = round(message.log_time * 60 / 1e9)
            transforms[frame] = {
                t.child_frame_id: [t.translation.x, t.translation.y, t.translation.z] for t in decoded.transforms
            }
            assert {t.parent_frame_id for t in decoded.transforms} == {ROOT}
            stamp = decoded.transforms[0].timestamp
            assert stamp.seconds * 10**9 + stamp.nanos == pytest.approx(message.log_time, abs=1)
    assert sorted(transforms) == list(range(3, 31, 3))
    for frame, poses in transforms.items():
        assert list(poses) == list(positions[frame])
        for name, position in poses.items():
            assert position == pytest.approx(positions[frame][name], rel=1e-6, abs=1e-6)
    first, second = scenes
    assert [entity.id for entity in first.entities] == ["a", "b"]
    box = first.entities[0].cubes[0]
    assert [box.size.x, box.size.y, box.size.z] == [1, 2, 3]
    assert [box.color.r, box.color.g, box.color.b, box.color.a] == [1, 0, 0.5, 1]
    assert first.entities[0].frame_id == "a"
    assert [gone.id for gone in second.deletions] == ["a"]
    assert [entity.id for entity in second.entities] == ["c"]


def test_poses_can_be_left_out(tmp_path: Path) -> None:
    path = record(tmp_path / "x.mcap", busy, pose_rate=0)
    kinds = {item.kind for item in Recording(path)}
    assert Kind.TICKS in kinds
    assert not kinds & {Kind.POSES, Kind.SCENE, Kind.BOX}


def test_an_hour_of_ticks_takes_at_most_10_mb(tmp_path: Path) -> None:
    # A minute of it, flushed each second as a server does; digests do not compress, so no other world is smaller.
    world = World({"backend": "ballistic"})
    recorder = Recorder(tmp_path / "x.mcap", world, pose_rate=0)
    recorder.flush()
    empty = os.path.getsize(tmp_path / "x.mcap")
    for frame in range(1, 3601):
        recorder.ticked(frame, hashlib.blake2b(frame.to_bytes(4, "big"), digest_size=16).digest())
        if frame % 60 == 0:
            recorder.flush()
    recorder.close()
    assert (os.path.getsize(tmp_path / "x.mcap") - empty) * 60 < 10e6


# -- faults and failures ---------------------------------------------------------------------------------------------


def fault(world: World, client: int) -> None:
    send(world, client, type="spawn_cube", cube_name="far")
    for _ in range(200):
        send(world, client, type="apply_physics", cube_name="far", impulse=[1e15, 0, 0])
        send(world, client, type="step")
        if world.fault is not None:
            return
    raise AssertionError("the engine bears everything")


def test_a_fault_completes_the_file_and_a_reset_appends_to_it(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    world = World({"backend": "ballistic", "mode": "lockstep"})
    recorder = world.journal = Recorder(path, world)
    client = world.join()
    fault(world, client)
    assert Recording(path).complete
    send(world, client, type="get_world_info")
    recorder.flush()  # still faulted, still sealed
    recording = Recording(path)
    assert recording.complete
    assert [item[0] for item in told_by(recording)][-2:] == ["command", "reply"]
    with path.open("rb") as file:
        assert make_reader(file, validate_crcs=True).get_summary() is not None
    send(world, client, type="reset")
    send(world, client, type="step", ticks=20)
    recorder.flush()
    assert not Recording(path).complete
    fault(world, client)
    assert Recording(path).complete
    recorder.close()
    summary = Recording(path).summary()
    assert (summary.faults, summary.commands["reset"]) == (2, 1)


def test_a_failed_write_faults_the_world_and_keeps_earlier_records(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    world = World({"backend": "ballistic", "mode": "lockstep"})
    recorder = world.journal = Recorder(path, world, pose_rate=0)
    client = world.join()
    send(world, client, type="step", ticks=5)
    recorder.flush()
    frame = world.frame
    with full_disk(path.stat().st_size + 100):
        reply = send(world, client, type="step", ticks=10_000)  # enough to flush by itself
    assert reply["code"] == "world_faulted"
    assert world.fault is not None and world.fault.code == "recording_failed"
    assert send(world, client, type="reset")["code"] == "world_faulted"
    for call in (recorder.flush, recorder.close):
        try:
            call()
        except RecordingError as error:
            assert error.code == "recording_failed"
    recording = Recording(path)
    assert recording.damage is not None and recording.damage.cut
    assert [item for item in told_by(recording) if item[0] == "tick"][-1][1] == frame


def test_a_failing_flush_stops_the_world_at_its_next_input(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    world = World({"backend": "ballistic", "mode": "lockstep"})
    recorder = world.journal = Recorder(path, world)
    client = world.join()
    with full_disk(path.stat().st_size + 10), pytest.raises(RecordingError, match="File too large"):
        recorder.flush()
    world.tick()
    assert world.fault is not None and world.fault.code == "recording_failed"
    assert send(world, client, type="spawn_cube")["code"] == "world_faulted"


def test_a_file_that_cannot_be_created_is_an_error(tmp_path: Path) -> None:
    world = World({"backend": "ballistic"})
    with pytest.raises(RecordingError, match="cannot create"):
        Recorder(tmp_path / "no such folder" / "x.mcap", world)
    with full_disk(100), pytest.raises(RecordingError, match="cannot write"):
        Recorder(tmp_path / "x.mcap", world)


def test_a_file_holds_more_clients_than_channels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nmes.recording.mcap_writer.MAX_CHANNELS", 20)
    world = World({"backend": "ballistic", "mode": "lockstep"})
    recorder = world.journal = Recorder(tmp_path / "x.mcap", world)
    for _ in range(50):
        client = world.join()
        send(world, client, type="ping")
        world.leave(client)
    recorder.close()
    assert world.fault is None
    assert {record.client for record in Recording(tmp_path / "x.mcap")} == set(range(1, 51))


def test_a_recording_that_cannot_be_completed_is_an_error(tmp_path: Path) -> None:
    world = World({"backend": "ballistic", "mode": "lockstep"})
    recorder = world.journal = Recorder(tmp_path / "x.mcap", world)
    world.join()
    with full_disk((tmp_path / "x.mcap").stat().st_size + 10), pytest.raises(RecordingError):
        recorder.close()
    recorder.close()


# -- the container ---------------------------------------------------------------------------------------------------

messages = st.lists(
    st.tuples(st.integers(0, 3), st.integers(0, 2**63), st.integers(0, 2**63), st.binary(max_size=40)), max_size=20
)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(messages, st.sampled_from(["flush", "seal", "go on"])), max_size=6))
def test_written_records_are_read_back(tmp_path_factory: pytest.TempPathFactory, program: list[Any]) -> None:
    path = tmp_path_factory.mktemp("mcap") / "x.mcap"
    writer = Writer(path, profile="test", library="")
    writer.metadata("first", {"a": "b"})
    schema = writer.schema("s", "jsonschema", b"{}")
    channels = [writer.channel(f"topic {i}", "json", schema) for i in range(4)]
    expected: list[tuple[str, int, int, int, bytes]] = []
    for batch, then in program:
        for i, log_time, publish_time, data in batch:
            expected.append((f"topic {i}", len(expected), log_time, publish_time, data))
            writer.add(channels[i], *expected[-1][1:])
        if then == "flush":
            writer.flush()
            assert not batch or path.stat().st_size == writer.size  # an end that was there is gone
        elif then == "seal":
            writer.seal("last", {"n": str(len(expected))})
    writer.seal("last", {"n": str(len(expected))})
    writer.close()
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        contents = [
            (channel.topic, m.sequence, m.log_time, m.publish_time, m.data)
            for _, channel, m in reader.iter_messages(log_time_order=False)
        ]
        assert contents == expected
        assert [(item.name, item.metadata) for item in reader.iter_metadata()] == [
            ("first", {"a": "b"}),
            ("last", {"n": str(len(expected))}),
        ]
    blocks = list(Reader(path).blocks())  # whole: no DamagedFile
    read = [item for block in blocks if block.metadata is None for item in split_chunk(block.content)]
    assert [tuple(item)[1:] for item in read if isinstance(item, tuple)] == [item[1:] for item in expected]


def test_invalid_poses_are_refused() -> None:
    with pytest.raises(ValueError, match="not a transforms message"):
        decode_poses(b"\xff\xff\xff")
