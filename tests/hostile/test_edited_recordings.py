"""Recordings whose messages somebody has edited, run again here and on others' servers."""

from __future__ import annotations

import csv
import io
import json
import os
import pty
import random
import socket
import subprocess
import sys
import threading
from contextlib import AbstractContextManager
from pathlib import Path

import pytest
from click.testing import CliRunner

from hostile_servers import listening
from nmes.cli import main
from nmes.protocol import DELIMITER, parse
from nmes.recording import Kind, Recorder, Recording
from nmes.world import World
from recordings import Line, record, rewrite, send
from servers import PASSWORD, served

HOSTILE = "\x1b[2J\n\u202e\x9b"


def run(*arguments: str | Path) -> tuple[int, str]:
    """Runs `nmes` with arguments, and returns its exit status and what it printed; no exception may come out of it."""
    given = [str(argument) for argument in arguments]
    result = CliRunner().invoke(main, given, env={"NMES_PASSWORD": PASSWORD})
    assert result.exception is None or isinstance(result.exception, SystemExit), (arguments, result.exception)
    return result.exit_code, result.output


def despawning(world: World, client: int) -> None:
    """Three cubes, two of them hinged, of which one goes before the others are pushed."""
    for name in ("one", "two", "three"):
        send(world, client, type="spawn_cube", cube_name=name, position=[3 * len(name), 5, 0])
    send(world, client, type="create_joint", cube1="one", cube2="two", joint_type="hinge")
    send(world, client, type="step", ticks=6)
    send(world, client, type="despawn_cube", cube_name="two")
    send(world, client, type="step", ticks=6)
    send(world, client, type="apply_physics", cube_name="one", force=[1.5, 0.25, 0])
    send(world, client, type="batch", commands=[{"type": "ping"}, {"type": "step", "ticks": 2}])
    send(world, client, type="get_cube_info", cube_name="two")
    world.handle(client, parse(b"no frame"))
    send(world, client, type="get_world_state")
    send(world, client, type="get_cube_info", cube_name="one")


@pytest.fixture(scope="module")
def despawn_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("edited") / "despawn.mcap", despawning, {"keyframes": 0.1})


ODD = {
    "a list for a type": b'{"type":[]}',
    "an object for a type": b'{"type":{}}',
    "no type": b"{}",
    "no object": b"[1]",
    "no JSON": b"\xff{",
    "lists for names": b'{"type":"world_state","cubes":[{"cube_name":[]}],"spawned":[],"joint_name":{}}',
    "an error without words": b'{"type":"error"}',
    "lists for words": b'{"type":"error","code":[],"message":{},"field":[]}',
    "a batch without results": b'{"type":"batch_result","results":[1]}',
    "a far rotation": b'{"type":"cube_info","quaternion":[1e308,1e308,0,-1e308],"rotation":[1e308,0,0],"frame":1e308}',
    "a deep one": b'{"type":' + b"[" * 300 + b"]" * 300 + b"}",
}
RUNS = [
    "export {path} --to jsonl -o {output}",
    "export {path} --to csv --what messages -o {output}",
    "export {path} --to parquet --what messages -o {output}",
    "replay {path}",
    "replay {path} --json",
    "replay {path} --from 14",
    "replay {path} --backend pymunk",
    "diff {path} {other} --keep-going",
]


def with_words(source: Path, target: Path, topic: str, word: bytes) -> Path:
    """Writes a recording again with every other message of its clients, or every answer, in somebody's words."""

    def edit(lines: list[Line]) -> list[Line]:
        said = b'{"client":1,"message":%b}' % word
        at = [i for i, line in enumerate(lines) if line.topic == topic][1::2]
        return [line._replace(data=said) if i in at else line for i, line in enumerate(lines)]

    return rewrite(source, target, edit)


@pytest.mark.parametrize("topic", ["commands", "replies"])
@pytest.mark.parametrize("odd", ODD)
def test_odd_messages_are_told_of_in_words(odd: str, topic: str, despawn_file: Path, tmp_path: Path) -> None:
    path = with_words(despawn_file, tmp_path / "x.mcap", topic, ODD[odd])
    for command in RUNS:
        places = {"path": path, "other": despawn_file, "output": tmp_path / "output"}
        code, _ = run(*(word.format(**places) for word in command.split()))
        assert code in (0, 1) or "export" not in command
    assert run("replay", path)[0] == 1


def test_odd_messages_are_exported_as_text(despawn_file: Path, tmp_path: Path) -> None:
    path = with_words(despawn_file, tmp_path / "x.mcap", "replies", ODD["a deep one"])
    assert run("export", path, "--to", "jsonl", "-o", tmp_path / "rows")[0] == 0
    rows = [json.loads(line) for line in (tmp_path / "rows").read_text().splitlines()]
    replies = [row["message"] for row in rows if row["kind"] == "reply"]
    assert replies[1::2] == [ODD["a deep one"].decode()] * (len(replies) // 2)
    assert replies[0]["type"] == "cube_list"


@pytest.mark.parametrize("topic", ["commands", "replies"])
def test_odd_messages_are_played_to_a_server(topic: str, despawn_file: Path, tmp_path: Path) -> None:
    with served({"backend": "ballistic"}) as server:
        for number, word in enumerate(ODD.values()):
            path = with_words(despawn_file, tmp_path / f"{number}.mcap", topic, word)
            for more in ((), ("--json",)):
                code, text = run("replay", path, "--against", f"127.0.0.1:{server.port}", *more)
                assert code == 1, (word, text)


def odd_server(word: bytes) -> AbstractContextManager[int]:
    """Runs a server that lets everybody in, and answers all else with the same words; gives its port."""

    def answer(peer: socket.socket) -> None:
        known, waiting = False, b""
        while data := peer.recv(1 << 16):
            *frames, waiting = (waiting + data).split(DELIMITER)
            for frame in frames:
                number = json.loads(frame).get("id")
                said = b'{"id":%d,%b' % (number, word[1:]) if known else b'{"type":"auth_success","client":1}'
                known = True
                peer.sendall(said.replace(b",}", b"}") + DELIMITER)

    return listening(answer)


@pytest.mark.parametrize("odd", [odd for odd in ODD if odd not in ("no object", "no JSON")])
def test_a_server_that_answers_oddly_is_told_of_in_words(odd: str, despawn_file: Path) -> None:
    with odd_server(ODD[odd]) as port:
        for more in ((), ("--json",)):
            code, text = run("replay", despawn_file, "--against", f"127.0.0.1:{port}", *more)
            assert code in (1, 2), text
            assert all(line.isprintable() for line in text.split("\n")), text


# -- what reaches a terminal -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def hostile_file(despawn_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording whose answers, frames and fingerprint hold what commands a terminal."""
    hostile = json.dumps(HOSTILE, ensure_ascii=False).encode()
    answer = b'{"client":1,"message":{"type":"cube_info","cube_name":%b,"mass":%b,%b:1}}' % (hostile, hostile, hostile)

    def edit(lines: list[Line]) -> list[Line]:
        last = [i for i, line in enumerate(lines) if line.topic == "replies"][-1]
        return [
            line._replace(data=answer if i == last else line.data.replace(b"no frame", HOSTILE.encode()))
            for i, line in enumerate(lines)
        ]

    about = {"nmes.fingerprint": {**Recording(despawn_file).fingerprint, "nmes": HOSTILE, "probe": HOSTILE}}
    return rewrite(despawn_file, tmp_path_factory.mktemp("hostile") / "x.mcap", edit, about=about)


@pytest.mark.parametrize("more", ["", "--json", "--backend pymunk", "--backend pymunk --json", "--to 3"])
def test_no_report_of_a_replay_commands_a_terminal(more: str, hostile_file: Path) -> None:
    _, text = run("replay", hostile_file, *more.split())
    assert all(line.isprintable() for line in text.split("\n")), ascii(text)


@pytest.mark.parametrize("more", ["", "--json"])
def test_no_report_of_answers_commands_a_terminal(more: str, hostile_file: Path) -> None:
    with served({"backend": "ballistic"}) as server:
        code, text = run("replay", hostile_file, "--against", f"127.0.0.1:{server.port}", *more.split())
    assert code == 1
    assert "x1b" in text or "u001b" in text
    assert all(line.isprintable() for line in text.split("\n")), ascii(text)


@pytest.mark.parametrize("more", ["--to jsonl", "--to csv --what messages"])
def test_an_export_commands_no_terminal_and_changes_nothing_elsewhere(more: str, hostile_file: Path) -> None:
    program = [sys.executable, "-c", "from nmes.cli import main; main()", "export", str(hostile_file), *more.split()]
    master, slave = pty.openpty()
    shown: list[bytes] = []

    def read() -> None:
        with open(master, "rb", buffering=0) as terminal:
            try:
                while data := terminal.read(1 << 16):
                    shown.append(data)
            except OSError:  # the other end was closed
                return

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    subprocess.run(program, stdout=slave, check=True)
    os.close(slave)
    reader.join()
    text = b"".join(shown).decode().replace("\r\n", "\n")
    assert "u202e" in text and all(line.isprintable() for line in text.split("\n")), ascii(text)
    plain = subprocess.run(program, stdout=subprocess.PIPE, check=True).stdout.decode()
    rows = map(json.loads, plain.splitlines()) if "jsonl" in more else csv.DictReader(io.StringIO(plain))
    messages = [str(row["message"]) for row in rows]
    assert any(HOSTILE[3:] in message or "\u202e\x9b" in message for message in messages)


# -- what our own recorder writes ------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [12, pytest.param(600, marks=pytest.mark.long)])
def test_large_replies_do_not_wait_in_memory(count: int, tmp_path: Path) -> None:
    world = World({"backend": "ballistic", "mode": "lockstep"})
    recorder = world.journal = Recorder(tmp_path / "x.mcap", world, flush_interval=3600.0)
    client, ping = world.join(), parse(b'{"type":"ping"}')
    reply = b'{"type":"pong","noise":"%b"}' % random.Random(1).randbytes(1 << 19).hex().encode()  # 1 MiB
    for number in range(1, count + 1):
        recorder.received(client, ping)
        recorder.replied(client, ping, reply)
        assert recorder.path.stat().st_size > (number - 1) << 19  # zstd makes a byte of two digits
    recorder.close()
    world.close()
    recording = Recording(tmp_path / "x.mcap")
    assert [len(record.data) for record in recording if record.kind is Kind.REPLY] == [len(reply)] * count
    assert recording.complete


def test_a_clock_before_1970_records_no_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nmes.recording.recorder.time_ns", lambda: -5_000_000_000)
    path = record(tmp_path / "x.mcap", despawning)
    assert {record.wall for record in Recording(path)} == {0}
    assert run("verify", path)[0] == run("info", path)[0] == run("replay", path)[0] == 0
