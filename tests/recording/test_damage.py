from __future__ import annotations

import os
import random
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer as McapWriter

from nmes.errors import RecordingError
from nmes.recording import Kind, Record, Recorder, Recording
from nmes.recording.mcap_format import MAGIC, DamagedFile, Message, skim_chunk, split_chunk
from nmes.recording.mcap_reader import Reader
from nmes.recording.mcap_writer import Writer
from nmes.world import World
from recordings import busy, record, rewrite, send, told_by


@pytest.fixture(scope="module")
def busy_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("recording") / "busy.mcap", busy)


def chunked(path: Path) -> list[Record]:
    """Records with a flush here and there; returns the records."""
    world = World({"backend": "ballistic", "mode": "lockstep"})
    recorder = world.journal = Recorder(path, world)
    client = world.join()
    send(world, client, type="spawn_cube", position=[0, 50, 0])
    for i in range(12):
        send(world, client, type="step", ticks=1 + i % 4)
        if i % 3 == 0:
            recorder.flush()
    recorder.close()
    return list(Recording(path))


def test_flushed_records_survive_a_crash(tmp_path: Path) -> None:
    world = World({"backend": "ballistic", "mode": "lockstep"})
    recorder = world.journal = Recorder(tmp_path / "x.mcap", world)
    client = world.join()
    for ticks in range(1, 5):
        send(world, client, type="step", ticks=ticks)
        recorder.flush()
        recording = Recording(tmp_path / "x.mcap")  # as a kill -9 leaves it
        assert not recording.complete
        assert recording.damage is not None and recording.damage.cut
        assert "after its last whole record; read up to record" in recording.damage.message
        assert [item for item in told_by(recording) if item[0] == "tick"][-1][1] == world.frame
    recorder.close()


def test_a_record_is_flushed_within_a_second_while_records_come(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 1_800_000_000 * 10**9
    monkeypatch.setattr("nmes.recording.recorder.time_ns", lambda: now)
    path = tmp_path / "x.mcap"
    world = World({"backend": "ballistic"})
    world.journal = Recorder(path, world, pose_rate=0)
    client = world.join()
    inputs: list[Callable[[], object]] = [world.tick, lambda: send(world, client, type="ping")]
    for happen in inputs:
        for later in (1_000_000_000, -5):  # clocks are set back, too
            size = path.stat().st_size
            happen()
            now += 999_999_999
            happen()
            assert path.stat().st_size == size
            now += later - 999_999_999
            happen()
            assert path.stat().st_size > size
    assert list(Recording(path))[-1].kind is Kind.REPLY
    world.journal.close()


@pytest.mark.parametrize("count", [300, pytest.param(1 << 20, marks=pytest.mark.long)])
def test_a_file_cut_anywhere_is_read_up_to_the_cut(tmp_path: Path, count: int) -> None:
    whole = chunked(tmp_path / "x.mcap")
    data = (tmp_path / "x.mcap").read_bytes()
    chunks = {block.offset + block.size for block in Reader(tmp_path / "x.mcap").blocks() if block.metadata is None}
    cut = tmp_path / "cut.mcap"
    before = 0
    rng = random.Random(1)
    around = {end + by for end in chunks for by in (-1, 0, 1)}
    drawn = rng.sample(range(len(data)), min(count, len(data)))
    for length in sorted({*range(0, 200), *around, *drawn, len(data) - 1}):
        cut.write_bytes(data[:length])
        try:
            recording = Recording(cut)
        except RecordingError as error:
            assert before == 0
            assert str(cut) in error.message
            continue
        records = list(recording)
        assert records == whole[: len(records)]
        assert len(records) >= before
        before = len(records)
        assert recording.damage is not None and recording.damage.cut
        assert 0 < recording.damage.offset <= length
    assert before == len(whole)


@pytest.mark.parametrize("count", [800, pytest.param(10_000, marks=pytest.mark.long)])
def test_no_flipped_bit_goes_unnoticed(tmp_path: Path, count: int) -> None:
    whole = chunked(tmp_path / "x.mcap")
    data = bytearray((tmp_path / "x.mcap").read_bytes())
    rng = random.Random(2)
    flipped = tmp_path / "flipped.mcap"
    for _ in range(count):
        bit = rng.randrange(8 * len(data))
        data[bit // 8] ^= 1 << bit % 8
        flipped.write_bytes(data)
        try:
            recording = Recording(flipped)
            records = list(recording)
            assert recording.damage is not None, f"bit {bit}"
            assert records == whole[: len(records)], f"bit {bit}"
        except RecordingError as error:
            assert error.code in ("not_a_recording", "unknown_format"), f"bit {bit}"
        data[bit // 8] ^= 1 << bit % 8


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=300), st.booleans())
def test_any_bytes_make_the_reader_report_damage_or_succeed(
    tmp_path_factory: pytest.TempPathFactory, data: bytes, mcap: bool
) -> None:
    path = tmp_path_factory.mktemp("any") / "x.mcap"
    path.write_bytes(MAGIC + data if mcap else data)
    with pytest.raises(RecordingError):
        Recording(path)


@given(st.binary(max_size=200))
def test_any_bytes_make_a_chunk_report_damage_or_succeed(content: bytes) -> None:
    try:
        list(split_chunk(content))
    except (ValueError, DamagedFile):
        pass


def message(channel: int, sequence: int, data: bytes) -> bytes:
    return struct.pack("<BQHIQQ", 5, 22 + len(data), channel, sequence, 1, 2) + data


record_bytes = st.one_of(
    st.builds(message, st.integers(0, 3), st.integers(0, 9), st.binary(max_size=20)),
    st.builds(lambda kind, body: struct.pack("<BQ", kind, len(body)) + body, st.integers(3, 9), st.binary(max_size=20)),
)


@given(st.lists(record_bytes, max_size=8).map(b"".join), st.data())
def test_skimming_a_chunk_finds_the_records_that_reading_finds(content: bytes, data: st.DataObject) -> None:
    if content and data.draw(st.booleans()):
        at, byte = data.draw(st.tuples(st.integers(0, len(content) - 1), st.integers(0, 255)))
        content = content[:at] + bytes([byte]) + content[at + 1 :]
    try:
        skim = skim_chunk(content)
    except (ValueError, DamagedFile):
        return
    read = [item for item in split_chunk(content) if isinstance(item, Message)]
    assert [(item.channel, item.sequence) for item in read] == list(zip(skim.channels, skim.sequences, strict=True))
    assert [item.data for item in read] == [skim.data(content, number) for number in range(len(read))]


def test_lengths_beyond_the_file_are_damage(busy_file: Path, tmp_path: Path) -> None:
    header = MAGIC + struct.pack("<BQ", 1, 12) + struct.pack("<I4sI", 4, b"nmes", 0)
    lie = tmp_path / "lie.mcap"
    for length in (2**62, 2**31, 2**63 + 5):
        lie.write_bytes(header + struct.pack("<BQ", 6, length) + b"x" * 100)
        with pytest.raises(RecordingError, match="the file ends at byte"):
            Recording(lie)
    # A chunk whose unpacked size is a lie, in its record and in the packed data, or in the latter alone.
    bomb = b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", 2**40) + b"\x00" * 50
    good = busy_file.read_bytes()
    first = next(block for block in Reader(busy_file).blocks() if block.metadata is None)
    for size, reason in ((2**40, "says that it holds 1099511627776 bytes"), (100, "does not match its checksum")):
        chunk = struct.pack("<QQQII4sQ", 0, 0, size, 0, 4, b"zstd", len(bomb)) + bomb
        lie.write_bytes(good[: first.offset] + struct.pack("<BQ", 6, len(chunk)) + chunk)
        damage = Recording(lie).damage
        assert damage is not None and reason in damage.message


def test_a_file_that_is_cut_or_removed_while_it_is_read_is_damaged(busy_file: Path, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(busy_file.read_bytes())
    shrunk, gone = Recording(path), Recording(path)
    os.truncate(path, 5000)
    assert shrunk.damage is not None and shrunk.damage.cut
    path.unlink()
    assert gone.damage is not None and "can no longer be read: No such file" in gone.damage.message


def test_a_file_that_is_no_recording_is_refused_with_a_reason(tmp_path: Path) -> None:
    def reason(path: Path) -> str:
        with pytest.raises(RecordingError) as info:
            Recording(path)
        assert str(path) in info.value.message
        return info.value.message

    path = tmp_path / "x"
    assert "No such file" in reason(path)
    path.write_bytes(b"")
    assert reason(path).endswith("it is empty")
    path.write_bytes(MAGIC[:5])
    assert reason(path).endswith("it is cut short")
    path.write_text("a text, long enough\n")
    assert reason(path).endswith("it is no MCAP file")
    assert reason(tmp_path).endswith("is not a regular file")
    os.mkfifo(tmp_path / "pipe")
    assert reason(tmp_path / "pipe").endswith("is not a regular file")
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros2")
        writer.finish()  # type: ignore[no-untyped-call]
    assert "profile 'ros2'" in reason(path)
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="nmes")
        writer.finish()  # type: ignore[no-untyped-call]
    assert "how its world began" in reason(path)
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="nmes")
        writer.add_metadata("nmes.recording", {"format": "99"})
        writer.finish()  # type: ignore[no-untyped-call]
    assert "of format 99; this nmes reads formats 1 and 2" in reason(path)


def test_a_changed_record_breaks_the_chain(busy_file: Path, tmp_path: Path) -> None:
    assert Recording(rewrite(busy_file, tmp_path / "same.mcap", lambda lines: lines)).complete
    path = rewrite(busy_file, tmp_path / "x.mcap", lambda lines: [*lines[:5], *lines[6:]], chained=False)
    damage = Recording(path).damage
    assert damage is not None and "does not continue the hash chain" in damage.message


def test_records_missing_at_the_end_are_reported(busy_file: Path, tmp_path: Path) -> None:
    recording = Recording(rewrite(busy_file, tmp_path / "x.mcap", lambda lines: lines[:-4], missing=4))
    damage = recording.damage
    assert damage is not None and "closing metadata do not belong to its records" in damage.message
    assert list(recording)


def test_records_out_of_order_are_found(busy_file: Path, tmp_path: Path) -> None:
    damage = Recording(rewrite(busy_file, tmp_path / "x.mcap", lambda lines: lines, skip=1)).damage
    assert damage is not None and "is out of its place" in damage.message


def test_changed_metadata_break_the_chain(busy_file: Path, tmp_path: Path) -> None:
    # The fingerprint stands in plain bytes in front of the first chunk. Set the checksum of the data section right.
    data = bytearray(busy_file.read_bytes())
    at = data.index(b"x86-64") if b"x86-64" in data else data.index(b"libc") + 8
    data[at] ^= 1
    end = data.rindex(struct.pack("<BQ", 15, 4))
    data[end + 9 : end + 13] = struct.pack("<I", zlib.crc32(data[:end]))
    path = tmp_path / "x.mcap"
    path.write_bytes(data)
    damage = Recording(path).damage
    assert damage is not None and "does not continue the hash chain" in damage.message


def test_records_in_the_wrong_place_are_damage(busy_file: Path, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    data = busy_file.read_bytes()
    first = next(block for block in Reader(busy_file).blocks() if block.metadata is None)
    message = struct.pack("<BQHIQQ", 5, 22, 1, 0, 0, 0)
    path.write_bytes(data[: first.offset] + message + data[first.offset :])
    damage = Recording(path).damage
    assert damage is not None
    assert damage.message == f"a record of type 5 at byte {first.offset} does not belong there; no record can be read"
    path.write_bytes(MAGIC + message)
    with pytest.raises(RecordingError, match="does not begin with a header"):
        Recording(path)
    # A footer that speaks of another place, its checksum in order.
    footer = data[-8 - 29 : -8]
    opcode, length, start, offsets, _ = struct.unpack("<BQQQI", footer)
    end = data.rindex(struct.pack("<BQ", 15, 4)) + 13
    wrong = struct.pack("<BQQQ", opcode, length, start - 1, offsets)
    path.write_bytes(data[: -8 - 29] + wrong + struct.pack("<I", zlib.crc32(data[end : -8 - 29] + wrong)) + MAGIC)
    damage = Recording(path).damage
    assert damage is not None and "the footer is damaged" in damage.message


def test_records_over_the_size_limit_are_neither_written_nor_read(
    busy_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nmes.recording.mcap_reader.MAX_RECORD", 2000)
    monkeypatch.setattr("nmes.recording.mcap_writer.MAX_RECORD", 2000)
    damage = Recording(busy_file).damage
    assert damage is not None and "says that it is" in damage.message
    writer = Writer(tmp_path / "x.mcap", profile="test", library="")
    writer.add(writer.channel("topic", ""), 0, 0, 0, bytes(3000))
    with pytest.raises(RecordingError, match="is more than a reader takes"):
        writer.flush()
    writer.close()
