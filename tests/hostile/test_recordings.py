"""Recordings that somebody has tampered with, and commands that must lose nothing."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from click.testing import CliRunner
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from nmes.cli import main
from recordings import busy, record


@pytest.fixture(scope="module")
def busy_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("hostile") / "busy.mcap", busy)


def run(*arguments: str | Path) -> tuple[int, str]:
    """Runs `nmes` with arguments, and returns its exit status and what it printed; no exception may come out of it."""
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), (arguments, result.exception)
    return result.exit_code, result.output


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


@contextmanager
def full_disk(room: int) -> Iterator[None]:
    """Lets no file grow over `room` bytes meanwhile."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("command", [name for name in WRITERS if not name.startswith("view")])
def test_a_full_disk_costs_no_older_file_and_leaves_no_half_one(
    command: str, busy_file: Path, tmp_path: Path, key: Path
) -> None:
    output = tmp_path / "older.gif"
    if command not in ("fork", "sign"):  # which never write to a file that is there
        output.write_bytes(b"older")
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    with full_disk(100):
        code, text = write(command, busy_file, output, busy_file, key)
    assert code == 1
    assert "cannot write" in text and "older.gif" in text
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


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
