"""What is odd in files, on command lines and in the answers of servers: each is refused in words, and costs little."""

from __future__ import annotations

import logging
import socket
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import zstandard

from command_line import run
from hostile_servers import listening
from nmes.cli import _logs
from nmes.client import Client
from nmes.client.address import read_address
from nmes.errors import CommandFailed, CorpusError, Disconnected, RejectedMessage
from nmes.evolution.corpus import Corpus
from nmes.fleet.agones import PORT
from nmes.protocol import DELIMITER
from nmes.schemas.documents import VALUES, parse_json, write_json
from nmes.schemas.files import open_regular, read_regular
from studies import make_study

# -- files ------------------------------------------------------------------------------------------------------------


def test_json_of_very_many_small_values_is_not_read() -> None:
    assert len(parse_json(b"[" + b"0," * 1000 + b"0]")) == 1001
    with pytest.raises(RejectedMessage, match=f"more than {VALUES:,} values"):
        parse_json(b'{"x":[' + b"0," * (VALUES + 1) + b"0]}")


def test_a_corpus_that_unpacks_to_a_very_long_line_is_not_read(tmp_path: Path) -> None:
    head = write_json({"format": "nmes-corpus/1", "tasks": [], "runs": []})
    content = head + b"\n" + b'{"x":[' + b"0," * 3_000_000 + b"0]}\n"
    (file := tmp_path / "corpus.zst").write_bytes(zstandard.ZstdCompressor().compress(content))
    assert file.stat().st_size < 5_000
    with pytest.raises(CorpusError, match="line 2: it has over 4 MiB"):
        Corpus.read(file)
    content = head[:-1] + b',"x":[' + b"0," * (VALUES + 1) + b"0]}\n"
    file.write_bytes(zstandard.ZstdCompressor().compress(content))
    with pytest.raises(CorpusError, match="line 1: more than"):
        Corpus.read(file)


def test_a_study_with_a_key_of_very_many_parts_is_not_read(tmp_path: Path) -> None:
    folder = make_study(tmp_path / "deep")
    file = folder / "study.toml"
    file.write_text(f"{'.'.join('a' * 20_000)} = 1\n{file.read_text()}")
    result = run("study", "report", folder)
    assert result.exit_code == 2 and "a line has over 200 points" in result.output


@pytest.mark.parametrize("row", [b'{"kind":[],"message":1}', b'{"kind":{},"message":{}}', b'{"kind":1,"message":1}'])
def test_a_row_of_an_exported_log_has_a_kind_that_is_a_text(row: bytes, tmp_path: Path) -> None:
    (log := tmp_path / "log.jsonl").write_bytes(row + b"\n")
    result = run("replay", log)
    assert result.exit_code in (1, 2) and "has a kind that is no text" in result.output


def test_only_regular_files_of_so_many_bytes_are_read(tmp_path: Path) -> None:
    (file := tmp_path / "file").write_bytes(b"12345")
    assert read_regular(file, 5) == b"12345"
    with pytest.raises(OSError, match="it has over 4 bytes"):
        read_regular(file, 4)
    for path in (tmp_path, Path("/dev/null")):
        with pytest.raises(OSError):
            open_regular(path)


def test_a_small_file_takes_little_memory_however_large_it_may_be(tmp_path: Path) -> None:
    (file := tmp_path / "file").write_bytes(b"12345")
    tracemalloc.start()
    try:
        assert read_regular(file, 1 << 30) == b"12345"
        assert tracemalloc.get_traced_memory()[1] < 10 << 20
    finally:
        tracemalloc.stop()


# -- command lines ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "",
        ":5",
        "a",
        "a:",
        "a:0",
        "a:65536",
        f"a:{'9' * 5000}",
        "a:-1",
        "a:٣",
        "[]:5",
        "::1:5",
        f"{'a' * 70}.x:5",
        "....:5",
        "a\x00b:5",
        "a b:5",
        "a\n:5",
        "\x1b[2J:5",
    ],
)
def test_what_is_no_address_is_refused_in_words(text: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError):
        read_address(text)
    if "\0" not in text:  # which no command line has
        result = run("worlds", "--password", "x", "--", text)
        assert result.exit_code == 2 and "expected HOST:PORT" in result.output
    if text not in ("", "a"):
        (hosts := tmp_path / "hosts").write_text(f"127.0.0.1:1\n{text}\n".replace("\n:", ":"))
        assert run("fleet", "status", "--hosts", hosts, "--password", "x", "--timeout", "1").exit_code in (1, 2)


@pytest.mark.parametrize(
    ("text", "found"),
    [("a:5", ("a", 5)), ("[::1]:65535", ("::1", 65535)), ("10.0.0.5:1", ("10.0.0.5", 1)), ("bücher.example:7", None)],
)
def test_an_address_is_read(text: str, found: tuple[str, int] | None) -> None:
    assert read_address(text) == (found or ("bücher.example", 7))
    host = text.rpartition(":")[0]
    assert read_address(host, PORT) == (read_address(text)[0], PORT)


def test_seeds_and_sizes_are_bounded_before_they_are_counted() -> None:
    for seeds in ("0-99999999999", f"0-{10**400}", "0-99999,100000"):
        result = run("eval", "walker", "--seeds", seeds)
        assert result.exit_code == 2 and "these are over 100,000 seeds" in result.output
    assert run("eval", "walker", "--seeds", "9" * 5000).exit_code == 2
    assert run("render", "x.mcap", "-o", "x.gif", "--size", f"{'9' * 5000}x5").exit_code == 2


def test_a_client_tells_of_a_host_whose_name_cannot_be_looked_up() -> None:
    with pytest.raises(Disconnected, match="cannot connect"):
        Client("a" * 70, 5, password="x").connect()


# -- what servers answer ----------------------------------------------------------------------------------------------


@contextmanager
def answering(*answers: object) -> Iterator[str]:
    """Serves each connection with the same answers to its first message; yields the address."""

    def answer(connection: socket.socket) -> None:
        connection.recv(1 << 16)
        connection.sendall(b"".join(write_json(each) + DELIMITER for each in answers))

    with listening(answer) as port:
        yield f"127.0.0.1:{port}"


WORLD = {
    **{"world": "red", "port": 1, "backend": "mujoco", "mode": "realtime", "frame": 1, "clients": 2**63 - 1},
    "fault": None,
}


@pytest.mark.parametrize("field", ["backend", "fault"])
def test_what_a_server_says_of_a_world_does_not_steer_the_terminal(field: str) -> None:
    with answering({"type": "world_list", "worlds": [{**WORLD, field: "x\x1b]0;pwn\x07"}] * 3}) as address:
        output = run("worlds", address, "--password", "x").output
    assert "\\x1b]0;pwn\\x07" in output and "\x1b" not in output and "\x07" not in output


def test_more_clients_than_there_are_numbers_are_told() -> None:
    with answering({"type": "world_list", "worlds": [WORLD] * 3}) as address:
        for command in (["worlds", address], ["fleet", "status", address]):
            assert run(*command, "--password", "x", "--json").exit_code == 0
        assert str(3 * (2**63 - 1)) in run("fleet", "status", address, "--password", "x", "--json").stdout


@pytest.mark.parametrize("worlds", [[], [WORLD], [WORLD] * 3])
def test_a_world_that_a_server_does_not_tell_of_was_not_created(worlds: list[object]) -> None:
    with answering({"type": "world_list", "worlds": worlds}) as address:
        result = run("worlds", address, "--password", "x", "--create", "blue")
        assert result.exit_code == 1 and "did not create 'blue'" in result.output
        with pytest.raises(CommandFailed, match="did not create 'blue'"):
            Client("127.0.0.1", int(address.rpartition(":")[2]), password="x").create_world("blue")


def test_a_server_that_lets_in_with_another_answer_is_not_viewed(tmp_path: Path) -> None:
    for answer in ({"type": "world_list", "worlds": []}, {"type": "auth_success"}):
        with answering(answer, {"type": "world_info", "id": 1}) as address:
            result = run("view", address, "--password", "x", "--save", tmp_path / "x.rrd")
            assert result.exit_code == 1 and "Error: the server" in result.output


# -- logs -------------------------------------------------------------------------------------------------------------


def test_no_name_begins_a_line_of_the_log_or_commands_the_terminal(capfd: pytest.CaptureFixture[str]) -> None:
    root = logging.getLogger()
    before, root.handlers = root.handlers, []
    try:
        _logs.set_up("text")
        logging.getLogger("nmes").warning("%s is left where it is", "evil\x1b[2J\n2026-01-01 ERROR forged.mcap")
    finally:
        root.handlers = before
    told = capfd.readouterr().err
    assert told.count("\n") == 1 and r"evil\x1b[2J\n2026-01-01 ERROR forged.mcap" in told
