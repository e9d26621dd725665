from __future__ import annotations

import json
import random
import struct
import zlib
from pathlib import Path

import pytest
import zstandard
from click.testing import CliRunner
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, generate_private_key
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat

from nmes.cli import main
from nmes.errors import RecordingError, SigningError
from nmes.recording import Kind, Recording
from nmes.recording.mcap_format import Message, message_checksums, split_chunk
from nmes.recording.mcap_reader import Reader
from nmes.recording.signing import check_signature, private_key, public_key, sign
from recordings import Line, busy, commands_of, record, rewrite


@pytest.fixture(scope="module")
def busy_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("verify") / "busy.mcap", busy)


def run(*arguments: str | Path) -> tuple[int, str]:
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.output


def repacked(source: Path, target: Path, change: bytes, to: bytes, *, checksum: bool) -> Path:
    """Changes bytes within the one chunk of a recording; its checksum is made anew or not, the chain is not."""
    data = source.read_bytes()
    (block,) = [block for block in Reader(source).blocks() if block.metadata is None]
    assert block.content.count(change) == 1
    assert len(change) == len(to)
    content = block.content.replace(change, to)
    old = data[block.offset : block.offset + block.size]
    times = old[9:25]
    crc = zlib.crc32(content) if checksum else struct.unpack_from("<I", old, 33)[0]
    packed = zstandard.ZstdCompressor().compress(content)
    body = times + struct.pack("<QII4sQ", len(content), crc, 4, b"zstd", len(packed)) + packed
    chunk = struct.pack("<BQ", 6, len(body)) + body
    target.write_bytes(data[: block.offset] + chunk + data[block.offset + block.size :])
    return target


# -- what is as it was written ---------------------------------------------------------------------------------------


def test_an_intact_recording_verifies(busy_file: Path) -> None:
    code, output = run("verify", busy_file)
    assert code == 0
    assert output.startswith("sound: ")
    code, output = run("verify", busy_file, "--json")
    report = json.loads(output)
    recording = Recording(busy_file)
    assert recording.complete
    assert code == 0
    assert (report["verdict"], report["head"], report["own_schemas"]) == ("sound", recording.end["head"], True)
    assert report["records"] == int(recording.end["records"]) > list(recording)[-1].sequence
    assert (report["signed"], report["damage"], report["record"]) == (None, None, None)


@pytest.mark.parametrize("checksum", [True, False])
def test_the_first_bad_record_is_named(busy_file: Path, tmp_path: Path, checksum: bool) -> None:
    # Somebody changes one digit of a command, and sets the chunk's checksum right, or not.
    at = next(r for r in Recording(busy_file) if r.kind is Kind.COMMAND and b"0.25" in r.data)
    path = repacked(busy_file, tmp_path / "x.mcap", at.data, at.data.replace(b"0.25", b"0.35"), checksum=checksum)
    damage = Recording(path).damage
    assert damage is not None
    assert damage.record == at.sequence
    assert f"record {at.sequence} is not as it was written" in damage.message
    code, output = run("verify", path, "--json")
    assert code == 1
    assert (json.loads(output)["verdict"], json.loads(output)["record"]) == ("damaged", at.sequence)
    code, output = run("verify", path)
    assert code == 1
    assert output.startswith("DAMAGED: ") and f"record {at.sequence} " in output
    reading = Recording(path)
    assert list(reading) == []  # reading finds the same
    assert reading.damage is not None and reading.damage.message == damage.message


def test_any_changed_byte_of_any_record_is_named(busy_file: Path, tmp_path: Path) -> None:
    (block,) = [block for block in Reader(busy_file).blocks() if block.metadata is None]
    starts, messages = [], []
    position = 0
    while position < len(block.content):
        opcode, length = struct.unpack_from("<BQ", block.content, position)
        if opcode == 5:
            starts.append(position)
            messages.append(position + 9 + length)
        position += 9 + length
    rng = random.Random(4)
    for _ in range(40):
        number = rng.randrange(len(starts) - 2)  # the checksums and the chain's head come last
        at = rng.randrange(starts[number], messages[number])
        content = bytearray(block.content)
        content[at] ^= 1 << rng.randrange(8)
        path = tmp_path / "x.mcap"
        path.unlink(missing_ok=True)
        repacked(busy_file, path, block.content, bytes(content), checksum=rng.random() < 0.5)
        damage = Recording(path).damage
        assert damage is not None and damage.record == number, f"byte {at}"


def test_a_chunk_with_bad_checksums_is_named(busy_file: Path, tmp_path: Path) -> None:
    (block,) = [block for block in Reader(busy_file).blocks() if block.metadata is None]
    link = [item for item in split_chunk(block.content) if isinstance(item, Message)][-1]
    path = repacked(busy_file, tmp_path / "x.mcap", link.data, link.data.replace(b"head", b"heap"), checksum=True)
    damage = Recording(path).damage
    assert damage is not None and damage.record is None
    assert "does not continue the hash chain; no record can be read" in damage.message


def test_recordings_without_checksums_are_read(busy_file: Path, tmp_path: Path) -> None:
    # As they were first written.
    path = rewrite(busy_file, tmp_path / "x.mcap", lambda lines: [line for line in lines if line.topic != "checksums"])
    assert Recording(path).complete
    assert run("verify", path)[0] == 0
    path = rewrite(
        busy_file,
        tmp_path / "y.mcap",
        lambda lines: [line for line in lines if line.topic != "checksums"][1:],
        chained=False,
    )
    assert Recording(path).damage is not None


def test_verify_finds_the_damage_that_reading_finds(busy_file: Path, tmp_path: Path) -> None:
    def shapeless(lines: list[Line]) -> list[Line]:
        return [line._replace(data=b'{"frame":"x"}') if line.topic == "ticks" else line for line in lines]

    def short(lines: list[Line]) -> list[Line]:
        return lines[: commands_of(lines)[3]]

    paths = [
        rewrite(busy_file, tmp_path / "shape.mcap", shapeless),
        rewrite(busy_file, tmp_path / "place.mcap", lambda lines: lines, skip=2),
        rewrite(busy_file, tmp_path / "missing.mcap", short, missing=3),
        rewrite(busy_file, tmp_path / "chain.mcap", short, chained=False),
        rewrite(busy_file, tmp_path / "whole.mcap", short),
    ]
    data = bytearray(busy_file.read_bytes())
    rng = random.Random(5)
    for i in range(60):
        bit = rng.randrange(8 * 600, 8 * len(data))
        data[bit // 8] ^= 1 << bit % 8
        paths.append(tmp_path / f"{i}.mcap")
        paths[-1].write_bytes(data[: rng.randrange(700, len(data))] if i % 3 == 0 else data)
        data[bit // 8] ^= 1 << bit % 8
    damages = []
    for path in paths:
        try:
            read, checked = Recording(path), Recording(path)
        except RecordingError:
            continue
        list(read)
        damages.append(read.damage and (read.damage.message, read.damage.record, read.damage.cut))
        assert damages[-1] == (checked.damage and (checked.damage.message, checked.damage.record, checked.damage.cut))
        assert read.end == checked.end
    assert [damage for damage in damages[:5] if damage is None] == [None]
    assert len({damage for damage in damages if damage is not None}) > 20


def test_a_cut_recording_is_incomplete(busy_file: Path, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(busy_file.read_bytes()[:-50])
    code, output = run("verify", path)
    assert code == 1
    assert output.startswith("incomplete: the file ends in its summary")


def test_a_file_that_is_no_recording_is_wrong_usage(tmp_path: Path) -> None:
    (tmp_path / "x").write_text("no recording at all")
    assert run("verify", tmp_path / "x")[0] == 2
    assert run("verify", tmp_path / "nowhere")[0] == 2


def test_a_recording_with_other_schemas_is_reported(busy_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nmes.protocol.schema_hash", lambda: "0" * 64)
    code, output = run("verify", busy_file)
    assert code == 0
    assert "the schemas of another nmes (0.1.0)" in output


def test_checksums_of_cut_records_are_not_listed() -> None:
    assert list(message_checksums(b"")) == []
    assert list(message_checksums(b"\x05" + b"\xff" * 20)) == []


# -- who vouches for it ----------------------------------------------------------------------------------------------


@pytest.fixture
def keys(tmp_path: Path) -> tuple[Path, Path]:
    key = Ed25519PrivateKey.generate()
    private, public = tmp_path / "key.pem", tmp_path / "key.pub.pem"
    private.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    public.write_bytes(key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
    return private, public


def copied(source: Path, folder: Path) -> Path:
    path = folder / "copy.mcap"
    path.write_bytes(source.read_bytes())
    return path


def test_a_signature_is_checked(busy_file: Path, tmp_path: Path, keys: tuple[Path, Path]) -> None:
    private, public = keys
    path = copied(busy_file, tmp_path)
    code, output = run("verify", path, "--verify-key", public)
    assert code == 1
    assert "sound" in output and "NOT SIGNED with that key: cannot read" in output
    assert run("sign", path, "--key", private) == (0, f"signed: {path}.sig\n")
    assert path.read_bytes() == busy_file.read_bytes()
    code, output = run("verify", path, "--verify-key", public)
    assert code == 0
    assert output.endswith("signed with that key\n")
    code, output = run("verify", path, "--verify-key", public, "--json")
    assert (code, json.loads(output)["signed"]) == (0, True)
    code, output = run("sign", path, "--key", private)
    assert code == 1 and "exists already" in output
    elsewhere = tmp_path / "elsewhere"
    assert run("sign", path, "--key", private, "--output", elsewhere)[0] == 0
    assert run("verify", path, "--verify-key", public, "--signature", elsewhere)[0] == 0
    assert run("verify", path, "--signature", elsewhere)[0] == 2
    code, output = run("sign", path, "--key", private, "--output", tmp_path / "no" / "where")
    assert code == 1 and "cannot write" in output


def test_a_signature_by_another_key_is_refused(busy_file: Path, tmp_path: Path, keys: tuple[Path, Path]) -> None:
    path = copied(busy_file, tmp_path)
    sign(Recording(path), Ed25519PrivateKey.generate())
    code, output = run("verify", path, "--verify-key", keys[1])
    assert code == 1 and "is not this key's signature" in output


def test_a_forged_recording_does_not_keep_its_signature(
    busy_file: Path, tmp_path: Path, keys: tuple[Path, Path]
) -> None:
    # All made anew, chain and all: sound in itself, and not what was signed.
    signature = sign(Recording(busy_file), private_key(keys[0]), tmp_path / "signature")
    check_signature(Recording(busy_file), public_key(keys[1]), signature)

    def forge(lines: list[Line]) -> list[Line]:
        return [line._replace(data=line.data.replace(b"1.5", b"1.6")) for line in lines if line.topic != "checksums"]

    forged = rewrite(busy_file, tmp_path / "forged.mcap", forge)
    assert Recording(forged).complete
    with pytest.raises(SigningError, match="is not this key's signature of this recording") as info:
        check_signature(Recording(forged), public_key(keys[1]), signature)
    assert info.value.code == "bad_signature"
    again = rewrite(busy_file, tmp_path / "again.mcap", lambda lines: lines)  # the same, closed at another time
    with pytest.raises(SigningError):
        check_signature(Recording(again), public_key(keys[1]), signature)


def test_only_a_whole_recording_is_signed(busy_file: Path, tmp_path: Path, keys: tuple[Path, Path]) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(busy_file.read_bytes()[:-50])
    code, output = run("sign", path, "--key", keys[0])
    assert code == 1 and "only a whole recording can be signed" in output
    assert not Path(f"{path}.sig").exists()


@pytest.mark.parametrize(
    "text", [b"", b"{}", b"[]", b"\xff", b'{"signature":"***"}', b'{"signature":5}', b'{"signature":""}']
)
def test_invalid_signatures_are_refused(busy_file: Path, tmp_path: Path, keys: tuple[Path, Path], text: bytes) -> None:
    (tmp_path / "x").write_bytes(text)
    with pytest.raises(SigningError) as info:
        check_signature(Recording(busy_file), public_key(keys[1]), tmp_path / "x")
    assert info.value.code == "bad_signature"


def test_invalid_keys_are_refused(tmp_path: Path, keys: tuple[Path, Path]) -> None:
    private, public = keys
    other = generate_private_key(SECP256R1())
    (tmp_path / "ec").write_bytes(other.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    (tmp_path / "ec.pub").write_bytes(other.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
    for read, path in (
        (private_key, public),
        (private_key, tmp_path / "ec"),
        (public_key, private),
        (public_key, tmp_path / "ec.pub"),
    ):
        with pytest.raises(SigningError) as info:
            read(path)
        assert info.value.code == "bad_key"
    with pytest.raises(SigningError, match="cannot read"):
        private_key(tmp_path)
