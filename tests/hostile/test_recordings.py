"""Recordings that somebody has tampered with, and commands that must lose nothing."""

from __future__ import annotations

import json
import os
import random
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import zstandard
from click.testing import CliRunner
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat

from disks import full_disk
from nmes.cli import main
from nmes.protocol import parse
from nmes.recording import Kind, Recording
from nmes.world import World
from opengl import with_opengl
from recordings import Line, busy, record, rewrite, send


@pytest.fixture(scope="module")
def busy_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("hostile") / "busy.mcap", busy)


@pytest.fixture(scope="module")
def lighter_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same where less pulls: recordings that are equal have no difference to draw."""
    return record(tmp_path_factory.mktemp("hostile") / "lighter.mcap", busy, {"gravity": [0, -5, 0]})


def run(*arguments: str | Path) -> tuple[int, str]:
    """Runs `nmes` with arguments, and returns its exit status and what it printed; no exception may come out of it."""
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), (arguments, result.exception)
    return result.exit_code, result.output


def long(world: World, client: int) -> None:
    """Two clients that push two cubes, for so long that there are many keyframes."""
    other = world.join()
    send(world, client, type="spawn_cube", cube_name="one", position=[0, 5, 0])
    send(world, other, type="spawn_cube", cube_name="two", position=[3, 7, 0])
    for i in range(20):
        send(world, client, type="apply_physics", cube_name="one", force=[1.5, 0.25 * i, 0])
        send(world, other, type="apply_physics", cube_name="two", force=[0, 0, 0.125 + i])
        send(world, client, type="step", ticks=4)


@pytest.fixture(scope="module")
def long_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("hostile") / "long.mcap", long, {"keyframes": 0.1})


# -- what is written -------------------------------------------------------------------------------------------------

# Every command that makes a file of recordings, with where the recording and the output stand.
WRITERS = {
    "export jsonl": "export {recording} --to jsonl -o {output}",
    "export csv": "export {recording} --to csv -o {output}",
    "export parquet": "export {recording} --to parquet -o {output}",
    "info": "info {recording} --plot {output}",
    "diff first": "diff {recording} {other} --plot {output}",
    "diff second": "diff {other} {recording} --plot {output}",
    "replay": "replay {recording} --backend pymunk --plot {output}",
    "render": "render {recording} -o {output} --size 64x64 --fps 2",
    "view": "view {recording} --save {output}",
    "view two": "view {other} {recording} --save {output}",
    "fork": "fork {recording} -o {output}",
    "sign": "sign {recording} --key {key} -o {output}",
}


@pytest.fixture
def key(tmp_path: Path) -> Path:
    path = tmp_path / "key.pem"
    private = Ed25519PrivateKey.from_private_bytes(bytes(32))
    path.write_bytes(private.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    return path


def write(command: str, recording: Path, output: Path, other: Path, key: Path) -> tuple[int, str]:
    words = WRITERS[command].split()
    return run(*(word.format(recording=recording, output=output, other=other, key=key) for word in words))


@pytest.mark.parametrize("way", ["itself", "a symbolic link", "a hard link"])
@pytest.mark.parametrize("command", WRITERS)
def test_no_command_writes_over_what_it_reads(
    command: str, way: str, busy_file: Path, tmp_path: Path, key: Path
) -> None:
    recording = tmp_path / "run.gif"  # an ending that `render` takes
    recording.write_bytes(busy_file.read_bytes())
    output = recording
    if way == "a symbolic link":
        (output := tmp_path / "link.gif").symlink_to(recording)
    elif way == "a hard link":
        os.link(recording, output := tmp_path / "link.gif")
    code, text = write(command, recording, output, busy_file, key)
    assert code in (1, 2) and ("is what is read" in text or "exists already" in text)
    assert recording.read_bytes() == busy_file.read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {"run.gif", "key.pem", output.name}


@pytest.mark.parametrize(
    "command", [pytest.param(each, marks=with_opengl) if each == "render" else each for each in WRITERS]
)
def test_a_full_disk_costs_no_older_file_and_leaves_no_half_one(
    command: str, busy_file: Path, lighter_file: Path, tmp_path: Path, key: Path
) -> None:
    output = tmp_path / "older.gif"
    if command not in ("fork", "sign"):  # which never write to a file that is there
        output.write_bytes(b"older")
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    with full_disk(100):
        code, text = write(command, busy_file, output, lighter_file, key)
    assert code == 1
    assert "cannot write" in text and "older.gif" in text
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_disk_that_becomes_full_ends_what_the_viewer_writes(busy_file: Path, tmp_path: Path) -> None:
    assert run("view", busy_file, "--save", tmp_path / "whole.rrd")[0] == 0
    assert (tmp_path / "whole.rrd").stat().st_size > 90_000
    with full_disk(66_000):
        code, text = run("view", busy_file, "--save", tmp_path / "x.rrd")
    assert code == 1 and "cannot write" in text
    assert [path.name for path in tmp_path.iterdir()] == ["whole.rrd"]


@pytest.mark.parametrize("room", [0, 100, 2000])
def test_a_fork_that_finds_no_room_leaves_nothing(room: int, busy_file: Path, tmp_path: Path) -> None:
    with full_disk(room):
        code, text = run("fork", busy_file, "-o", tmp_path / "fork.mcap")
    assert code == 1 and "cannot write" in text
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_regular_file_is_written_to_and_not_replaced(busy_file: Path, tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        assert run("info", busy_file, "--plot", pipe)[0] == 0
        assert os.read(reader, 4) == b"<svg"
    finally:
        os.close(reader)
    assert pipe.is_fifo()


def test_an_output_keeps_its_permissions_and_its_link(busy_file: Path, tmp_path: Path) -> None:
    (target := tmp_path / "target").write_text("older")
    target.chmod(0o640)
    (link := tmp_path / "link").symlink_to(target)
    assert run("export", busy_file, "--to", "jsonl", "-o", link) == (0, "")
    assert link.is_symlink() and target.read_bytes().startswith(b'{"record":null')
    assert target.stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize("what", ["--to jsonl", "--to csv", "--to parquet"])
@pytest.mark.parametrize("kind", ["cut", "damaged"])
def test_an_export_of_a_part_says_so(kind: str, what: str, busy_file: Path, tmp_path: Path) -> None:
    data = bytearray(busy_file.read_bytes())
    if kind == "cut":
        del data[-50:]
    else:
        data[-50] ^= 1
    (path := tmp_path / "part.mcap").write_bytes(data)
    code, text = run("export", path, *what.split(), "-o", tmp_path / "whole")
    assert code == 1
    assert "ends early, and so does what was written" in text and "summary" in text
    assert run("export", busy_file, *what.split(), "-o", tmp_path / "other")[0] == 0
    if what != "--to jsonl":
        assert (tmp_path / "whole").read_bytes() == (tmp_path / "other").read_bytes()
    else:
        assert (tmp_path / "whole").read_bytes().count(b"\n") == (tmp_path / "other").read_bytes().count(b"\n")


@pytest.mark.parametrize("command", ["info", "export --to jsonl", "export --to csv --what messages", "verify --json"])
def test_a_full_standard_output_is_an_error_in_words(command: str, busy_file: Path) -> None:
    program = [sys.executable, "-c", "from nmes.cli import main; main()", *command.split(), str(busy_file)]
    with open("/dev/full", "wb") as full:
        done = subprocess.run(program, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.stderr == "Error: cannot write: No space left on device\n"
    assert done.returncode == 1


# -- what stands outside the chain -----------------------------------------------------------------------------------

MESSAGE_INDEX = 7  # the type of the record
FOOTER = 37  # bytes of the footer and the magic at a file's end


def summary_of(data: bytes | bytearray) -> int:
    """Returns where a file's summary begins."""
    return int(struct.unpack_from("<Q", data, len(data) - FOOTER + 9)[0])


def with_checksums(data: bytearray) -> bytes:
    """Makes the checksums of the data section and of the summary anew."""
    start = summary_of(data)
    struct.pack_into("<I", data, start - 4, zlib.crc32(data[: start - 13]))
    struct.pack_into("<I", data, len(data) - 12, zlib.crc32(data[start:-12]))
    return bytes(data)


def parts(data: bytes | bytearray, begin: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Yields the records between two places: type, where the body begins, where it ends."""
    while begin < end:
        opcode, length = struct.unpack_from("<BQ", data, begin)
        yield opcode, begin + 9, begin + 9 + length
        begin += 9 + length


def readings(path: Path) -> list[Any]:
    """Returns what all ways to read a recording say of it."""
    recording = Recording(path)
    told: list[Any] = [list(recording), recording.metadata, recording.config, recording.last_frame, recording.summary()]
    for frame in range(0, recording.last_frame + 1, 9):
        start = recording.start(frame)
        told.append((start.frame, start.snapshot, list(recording.records(start))))
        told.append(recording.lineage(frame))
    return told


def swap(data: bytearray, opcode: int, offset: int, width: int) -> None:
    """Exchanges a field of the second and the last record of a type in the summary."""
    found = [begin for kind, begin, _ in parts(data, summary_of(data), len(data) - FOOTER) if kind == opcode]
    one, other = found[1] + offset, found[-1] + offset
    data[one : one + width], data[other : other + width] = data[other : other + width], data[one : one + width]


def exchange_topics(data: bytearray) -> None:
    begin = summary_of(data)
    one, other = (data.index(topic, begin) for topic in (b"clients", b"replies"))
    data[one : one + 7], data[other : other + 7] = data[other : other + 7], data[one : one + 7]


SUMMARIES: dict[str, Callable[[bytearray], None]] = {
    "places of chunks": lambda data: swap(data, 8, 16, 8),
    "channels of chunks": lambda data: swap(data, 8, 36, 20),
    "times of chunks": lambda data: swap(data, 8, 0, 16),
    "topics": exchange_topics,
    "numbers of channels": lambda data: swap(data, 4, 0, 2),
}


@pytest.mark.parametrize("edit", SUMMARIES)
def test_a_permuted_summary_is_found_and_leads_no_reader_astray(edit: str, long_file: Path, tmp_path: Path) -> None:
    data = bytearray(long_file.read_bytes())
    SUMMARIES[edit](data)
    assert with_checksums(bytearray(data)) != long_file.read_bytes()
    (path := tmp_path / "long.mcap").write_bytes(with_checksums(data))
    code, text = run("verify", path)
    assert code == 1 and "the summary does not say what is in the file" in text
    expected, told = readings(long_file), readings(path)
    for one, other in zip(expected[5::2], told[5::2], strict=True):
        # Where the summary is of no use all is read from the beginning, or from an earlier keyframe.
        assert other[0] <= one[0] and other[2][-len(one[2]) :] == one[2]
    assert run("replay", path, "--from", "60", "--to", "75")[0] == 0


def edited(data: bytes, place: int, by: int) -> bytes:
    changed = bytearray(data)
    changed[place] ^= by
    try:
        return with_checksums(changed)
    except (struct.error, IndexError):  # the footer no longer says where the summary is
        return bytes(changed)


@pytest.mark.parametrize("count", [60, pytest.param(20_000, marks=pytest.mark.long)])
def test_an_edit_of_a_signed_recording_is_found_or_changes_no_reading(
    count: int, long_file: Path, tmp_path: Path, key: Path
) -> None:
    path = tmp_path / "long.mcap"
    path.write_bytes(data := long_file.read_bytes())
    assert run("sign", path, "--key", key)[0] == 0
    private = Ed25519PrivateKey.from_private_bytes(bytes(32))
    (public := tmp_path / "public.pem").write_bytes(
        private.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    )
    assert run("verify", path, "--verify-key", public)[0] == 0
    expected = readings(path)
    source = random.Random(14)
    begins = [begin for _, begin, _ in parts(data, 8, summary_of(data))]
    heads = [place for begin in begins for place in range(begin - 9, begin + 30)]
    kinds: dict[int, list[int]] = {}  # of message indexes and of all records of the summary: their bytes
    for kind, begin, end in (*parts(data, 8, summary_of(data)), *parts(data, summary_of(data), len(data) - FOOTER)):
        if kind == MESSAGE_INDEX or begin > summary_of(data):
            kinds.setdefault(kind, []).extend(range(begin, end))
    assert {3, 4, MESSAGE_INDEX, 8, 11, 13, 14} <= set(kinds)  # and schemas, channels, chunks, statistics, metadata
    groups = [heads, list(range(len(data) - FOOTER, len(data))), *kinds.values()]
    for number in range(count):
        place = source.choice(groups[number % len(groups)])
        path.write_bytes(edited(data, place, 1 << source.randrange(8)))
        code, text = run("verify", path, "--verify-key", public)
        assert code != 0 or number % len(groups) < 2, f"byte {place}"  # other programs go by what is listed
        if code == 0:
            assert readings(path) == expected, f"byte {place}"
        assert code in (0, 1, 2), text


def test_a_keyframe_of_another_tick_is_found(long_file: Path, tmp_path: Path) -> None:
    def edit(lines: list[Line]) -> list[Line]:
        at = [i for i, line in enumerate(lines) if line.topic == "keyframes"][3]
        head, _, rest = lines[at].data.partition(b"\n")
        state = json.loads(head)
        forged = json.dumps({**state, "ticks": state["ticks"] + 4}).encode() + b"\n" + rest
        return [*lines[:at], lines[at]._replace(data=forged), *lines[at + 1 :]]

    path = rewrite(long_file, tmp_path / "x.mcap", edit)  # its chain is made anew
    code, text = run("verify", path)
    assert code == 1 and "is of tick" in text
    assert run("replay", path)[0] == 2


# -- what is small and would be large --------------------------------------------------------------------------------


def with_chunk(source: Path, target: Path, content: bytes) -> Path:
    """Writes the beginning of a recording, and a chunk of any content behind it."""
    data = source.read_bytes()
    end = next(begin - 9 for kind, begin, _ in parts(data, 8, len(data)) if kind == 6)
    packed = zstandard.ZstdCompressor(level=1).compress(content)
    body = struct.pack("<QQQII4sQ", 0, 0, len(content), zlib.crc32(content), 4, b"zstd", len(packed)) + packed
    target.write_bytes(data[:end] + struct.pack("<BQ", 6, len(body)) + body)
    return target


def empty_messages(count: int) -> bytes:
    return b"".join(struct.pack("<BQHIQQ", 5, 22, 1, number, 0, 0) for number in range(count))


BOMBS = {
    "many zeros": (bytes(80 << 20), "unpacks to more than a reader takes"),
    "zeros": (bytes(8 << 20), "a record of type 0 does not belong into a chunk|does not fit into its chunk"),
    "a large message": (struct.pack("<BQ", 5, 70 << 20) + bytes(70 << 20), "unpacks to more than a reader takes"),
    "messages": (empty_messages(300_000), "does not fit into its chunk"),
}


@pytest.mark.parametrize("bomb", BOMBS)
def test_a_small_file_is_not_unpacked_to_a_large_one(bomb: str, busy_file: Path, tmp_path: Path) -> None:
    content, reason = BOMBS[bomb]
    damage = Recording(with_chunk(busy_file, tmp_path / "x.mcap", content)).damage
    assert damage is not None and any(part in damage.message for part in reason.split("|"))


def test_what_packs_too_well_is_recorded_unpacked(tmp_path: Path) -> None:
    def play(world: World, client: int) -> None:
        for _ in range(6):
            world.handle(client, parse(b'{"type":"ping"' + b" " * 900_000 + b"}"))

    recording = Recording(record(tmp_path / "x.mcap", play))
    assert recording.size > 4_500_000 and recording.complete  # the first is packed with what packs less well
    assert [len(item.data) for item in recording if item.kind is Kind.COMMAND] == [900_015] * 6


# -- what is valid MCAP, and not ours --------------------------------------------------------------------------------


def despawning(world: World, client: int, force: float = 1.5) -> None:
    """A cube goes before another is pushed."""
    for name in ("one", "two", "three"):
        send(world, client, type="spawn_cube", cube_name=name, position=[3 * len(name), 5, 0])
    send(world, client, type="step", ticks=6)
    send(world, client, type="despawn_cube", cube_name="two")
    send(world, client, type="step", ticks=6)
    send(world, client, type="apply_physics", cube_name="one", force=[force, 0.25, 0])
    send(world, client, type="step", ticks=12)
    send(world, client, type="batch", commands=[{"type": "ping"}, {"type": "step", "ticks": 2}])
    world.handle(client, parse(b"no frame"))
    send(world, client, type="get_world_state")


READERS = [
    "info {path}",
    "info {path} --json",
    "info {path} --plot {output}",
    "verify {path}",
    "export {path} --to jsonl -o {output}",
    "export {path} --to csv -o {output} --keep-going",
    "replay {path}",
    "replay {path} --from 3 --to 9",
    "replay {path} --backend pymunk",
    "diff {path} {other} --keep-going",
    "diff {other} {path} --keep-going",
    "fork {path} --at 20 -o {fork}",
    "render {path} -o {picture} --size 16x16",
    "view {path} --save {output}",
]


def read_with(command: str, path: Path, other: Path, folder: Path) -> tuple[int, str]:
    (fork := folder / "fork.mcap").unlink(missing_ok=True)
    places = {"path": path, "other": other, "output": folder / "output", "picture": folder / "x.png", "fork": fork}
    return run(*(word.format(**places) for word in command.split()))


@pytest.fixture(scope="module")
def despawn_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("hostile") / "despawn.mcap", despawning, {"keyframes": 0.1})


METADATA: dict[str, tuple[str, dict[str, str]]] = {
    "no date": ("nmes.recording", {"created": "yesterday"}),
    "an early date": ("nmes.recording", {"created": "0001-01-01T00:00:00+14:00"}),
    "a large frame": ("nmes.parent", {"recording": "0" * 64, "head": "0" * 64, "frame": "9" * 5000, "file": "x"}),
    "no frame": ("nmes.parent", {"file": "x"}),
    "a foreign seed": ("nmes.world", {"seed": "9" * 5000}),
    "no config": ("nmes.world", {"config": "[]"}),
    "an unknown engine": ("nmes.fingerprint", {"backend": "x"}),
    "an evaluation": ("nmes.evaluation", {"task": "[]", "genome": "1"}),
    "a deep config": ("nmes.world", {"config": "[" * 100_000}),
}


@pytest.mark.parametrize("odd", METADATA)
def test_odd_metadata_are_an_error_in_words(odd: str, despawn_file: Path, tmp_path: Path) -> None:
    name, values = METADATA[odd]
    about = {name: {**Recording(despawn_file).metadata.get(name, {}), **values}}
    path = rewrite(despawn_file, tmp_path / "x.mcap", lambda lines: lines, about=about)
    for command in READERS[:-2]:
        read_with(command, path, despawn_file, tmp_path)


def test_a_despawn_before_a_divergence_is_no_matter(despawn_file: Path, tmp_path: Path) -> None:
    path = record(tmp_path / "x.mcap", lambda world, client: despawning(world, client, 2.0), {"keyframes": 0.1})
    for command in READERS:
        read_with(command, path, despawn_file, tmp_path)
    code, text = run("diff", path, despawn_file)
    assert code == 1 and "states part at tick 13" in text

    def push_harder(lines: list[Line]) -> list[Line]:
        return [line._replace(data=line.data.replace(b"[1.5,0.25,0]", b"[1.75,0.25,0]")) for line in lines]

    forged = rewrite(despawn_file, tmp_path / "forged.mcap", push_harder)
    for command in READERS:
        read_with(command, forged, path, tmp_path)


WORDS = [b"", b"{}", b"[]", b"1", b"null", b"\xff", b"x", b'{"type":1}']
FIELDS = [b'"step"', b'"ticks"', b'"type"', b'"results"', b'"cube_name"', b'"client":1', b'"code"', b'"frame"']


def mangled(lines: list[Line], source: random.Random) -> list[Line]:
    """Drops, repeats, moves or changes messages, or puts others' words into them."""
    lines = list(lines)
    for _ in range(source.randrange(1, 4)):
        at, other = source.randrange(len(lines)), source.randrange(len(lines))
        line = lines[at]
        match source.randrange(7):
            case 0:
                del lines[at]
            case 1:
                lines.insert(other, line)
            case 2:
                lines[at] = line._replace(data=lines[other].data)
            case 3:
                lines[at] = line._replace(data=source.choice(WORDS))
            case 4:
                data = bytearray(line.data or b"x")
                data[source.randrange(len(data))] = source.randrange(256)
                lines[at] = line._replace(data=bytes(data))
            case 5:
                lines[at] = line._replace(data=line.data.replace(source.choice(FIELDS), source.choice(FIELDS)))
            case _:
                lines[at] = line._replace(log_time=source.choice([0, 1, 2**63, 2**64 - 1]))
    return lines or [Line("clients", 0, b"")]


@pytest.mark.parametrize("seeds", [(10, 53, 65, 348), pytest.param(range(100, 3000), marks=pytest.mark.long)])
def test_an_edited_recording_makes_no_command_fail_but_in_words(
    seeds: Sequence[int], despawn_file: Path, tmp_path: Path
) -> None:
    for seed in seeds:
        source = random.Random(seed)
        path = tmp_path / f"{seed}.mcap"
        rewrite(despawn_file, path, partial(mangled, source=source))
        for command in READERS[:-2] if seed % 10 else READERS:
            read_with(command, path, despawn_file, tmp_path)
        path.unlink()


def test_poses_that_are_none_are_told_of_in_words(
    despawn_file: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    def spoil(lines: list[Line]) -> list[Line]:
        return [line._replace(data=b"\xff\xff") if line.topic == "/tf" else line for line in lines]

    path = rewrite(despawn_file, tmp_path / "x.mcap", spoil)
    code, text = run("replay", path, "--backend", "pymunk")
    assert code == 1 and "not a transforms message" in text, text
    assert not caplog.records


def test_ticks_behind_a_command_that_makes_none_are_a_departure(despawn_file: Path, tmp_path: Path) -> None:
    def ping_instead(lines: list[Line]) -> list[Line]:
        return [line._replace(data=line.data.replace(b'"step"', b'"ping"')) for line in lines]

    path = rewrite(despawn_file, tmp_path / "x.mcap", ping_instead)
    code, text = run("fork", path, "--at", "20", "-o", tmp_path / "fork.mcap")
    assert code == 1 and "does not come out as recorded" in text, text


def test_what_recordings_say_commands_no_terminal(despawn_file: Path, tmp_path: Path) -> None:
    hostile = "\x1b[2J\n\u202e\x9b"
    about = {
        "nmes.recording": {**Recording(despawn_file).metadata["nmes.recording"], "nmes": hostile, "created": hostile},
        "nmes.fingerprint": {**Recording(despawn_file).fingerprint, "cpu": hostile, "nmes": hostile},
        "nmes.parent": {"recording": "0" * 64, "head": "0" * 64, "frame": "1", "file": hostile},
    }

    def refuse(lines: list[Line]) -> list[Line]:
        return [line._replace(data=line.data.replace(b"no frame", hostile.encode())) for line in lines]

    path = rewrite(despawn_file, tmp_path / "x.mcap", refuse, about=about)
    for command in ("info {path}", "info {path} --json", "verify {path}", "diff {path} {other} --keep-going"):
        _, text = read_with(command, path, despawn_file, tmp_path)
        assert all(line.isprintable() for line in text.split("\n")), text
