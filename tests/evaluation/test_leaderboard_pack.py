"""`nmes leaderboard pack` and `import`: entries with their proofs in one file, which may be of anybody."""

from __future__ import annotations

import json
import random
import shutil
import struct
import zipfile
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest

from boards import DASH, key_in, proofs_of, run, signed, verdicts
from creatures import SINE, cpg, snake
from nmes.evaluation import Task
from nmes.evaluation.leaderboard import Leaderboard
from recordings import Line, commands_of, rewrite

Members = dict[str, bytes]
SPRINT: dict[str, Any] = {**DASH, "name": "sprint", "seeds": [5], "unit": "m"}


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A leaderboard with two creatures on a task of its own, one of them signed, and one of these on another."""
    folder = tmp_path_factory.mktemp("board")
    path = folder / "board.sqlite"
    with Leaderboard(path, create=True) as made:
        for task in (DASH, SPRINT):
            made.allow(Task(task))
    wave, chain = snake(SINE, name="wave", author="Ada"), snake(cpg(4), name="chain", author="")
    proofs = signed(proofs_of(folder / "wave", wave), key_in(folder / "ada.pem", 1))
    proofs += [*proofs_of(folder / "chain", chain), *proofs_of(folder / "sprint", {**wave, "author": ""}, SPRINT)]
    added = run("add", path, *proofs)
    assert added.exit_code == 0, added.output
    return path


@pytest.fixture(scope="module")
def packed(board: Path) -> Path:
    path = board.with_suffix(".zip")
    done = run("pack", board, "-o", path)
    assert (done.exit_code, done.stdout) == (0, f"{path}: 3 entries\n")
    return path


def shown(board: Path) -> list[dict[str, Any]]:
    entries: list[dict[str, Any]] = json.loads(run("show", board, "--json").stdout)
    return [{name: value for name, value in entry.items() if name != "id"} for entry in entries]


def members(packed: Path) -> Members:
    with zipfile.ZipFile(packed) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def written(path: Path, contents: Members, method: int = zipfile.ZIP_STORED) -> Path:
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, content in contents.items():
            archive.writestr(zipfile.ZipInfo(name), content, compress_type=method)
    return path


def test_two_commands_lead_from_a_packed_file_to_holds(board: Path, packed: Path, tmp_path: Path) -> None:
    theirs = tmp_path / "theirs.zip"
    shutil.copyfile(packed, theirs)
    done = run("import", tmp_path / "mine.sqlite", theirs, "--allow")
    assert done.exit_code == 0 and done.stdout.splitlines()[-1] == f"3 entries of 3 new to {tmp_path / 'mine.sqlite'}"
    status, found = verdicts(tmp_path / "mine.sqlite")
    assert status == 0 and {verdict for verdict, _ in found.values()} == {"holds"}
    assert shown(tmp_path / "mine.sqlite") == shown(board)
    assert {(entry["task"], entry["unit"]) for entry in shown(board)} == {("dash", ""), ("sprint", "m")}
    (signed_one,) = {entry["key"] for entry in shown(tmp_path / "mine.sqlite")} - {""}
    assert signed_one and " m " in run("show", tmp_path / "mine.sqlite").stdout


def test_a_packed_file_is_a_plain_zip_and_the_same_each_time(board: Path, packed: Path, tmp_path: Path) -> None:
    assert run("pack", board, "-o", tmp_path / "again.zip").exit_code == 0
    assert (tmp_path / "again.zip").read_bytes() == packed.read_bytes()
    listed = json.loads(members(packed)["entries.json"])
    assert [len(entry["recordings"]) for entry in listed["entries"]] == [2, 2, 1]
    assert len(members(packed)) == 1 + 5 + 2


def test_some_entries_are_packed(board: Path, tmp_path: Path) -> None:
    assert run("pack", board, "-o", tmp_path / "some.zip", "--task", "dash", "--top", "1").exit_code == 0
    assert len(json.loads(members(tmp_path / "some.zip")["entries.json"])["entries"]) == 1
    nothing = run("pack", board, "-o", tmp_path / "none.zip", "--task", "walk")
    assert nothing.exit_code == 1 and "no such entry" in nothing.stderr and not (tmp_path / "none.zip").exists()


def test_what_is_listed_already_stays_as_it_is(packed: Path, tmp_path: Path) -> None:
    mine = tmp_path / "mine.sqlite"
    assert run("import", mine, packed, "--allow").exit_code == 0
    before = shown(mine)
    done = run("import", mine, packed)
    assert done.exit_code == 0 and done.stdout == f"0 entries of 3 new to {mine}\n"
    assert shown(mine) == before


def test_an_entry_that_was_found_broken_is_taken_anew(packed: Path, tmp_path: Path) -> None:
    board = tmp_path / "board.sqlite"
    assert run("import", board, packed, "--allow").exit_code == 0
    whole = shown(board)
    for recording in board.with_suffix(".recordings").glob("*.mcap"):
        recording.unlink()
    assert run("verify", board, "--write").exit_code == 1 and shown(board) == []
    imported = run("import", board, packed)
    assert imported.exit_code == 0 and imported.stdout.endswith(f"3 entries of 3 new to {board}\n")
    assert shown(board) == whole


def test_tasks_are_taken_only_where_that_is_asked_for(packed: Path, tmp_path: Path) -> None:
    done = run("import", tmp_path / "mine.sqlite", packed)
    assert done.exit_code == 1 and done.stderr.count("does not take the task") == 3
    assert shown(tmp_path / "mine.sqlite") == []


def test_an_entry_that_does_not_hold_is_refused_and_the_others_are_listed(packed: Path, tmp_path: Path) -> None:
    contents = members(packed)
    listed = json.loads(contents["entries.json"])
    name = listed["entries"][2]["recordings"][0]
    (tmp_path / "x.mcap").write_bytes(contents.pop(f"{name}.mcap"))

    def harder(lines: list[Line]) -> list[Line]:
        last = commands_of(lines)[-1]
        changed = lines[last]._replace(data=lines[last].data.replace(b'"controls":[', b'"controls":[0.125,'))
        return [changed if i == last else line for i, line in enumerate(lines)]

    forged = rewrite(tmp_path / "x.mcap", tmp_path / "y.mcap", harder).read_bytes()
    digest = sha256(forged).hexdigest()
    listed["entries"][2]["recordings"] = [digest]
    contents |= {f"{digest}.mcap": forged, "entries.json": json.dumps(listed).encode()}
    done = run("import", tmp_path / "mine.sqlite", written(tmp_path / "forged.zip", contents), "--allow")
    assert done.exit_code == 1 and "refused: " in done.stderr and len(shown(tmp_path / "mine.sqlite")) == 2
    unasked = run("import", tmp_path / "theirs.sqlite", tmp_path / "forged.zip")  # nothing of which is run
    assert unasked.exit_code == 1 and unasked.stderr.count("does not take the task") == 3


def test_the_task_of_an_entry_that_is_refused_is_not_taken(packed: Path, tmp_path: Path) -> None:
    contents, mine = members(packed), tmp_path / "mine.sqlite"
    (first, _) = json.loads(contents["entries.json"])["entries"][0]["recordings"]  # one seed of two
    half = {"entries.json": entries_json(first), f"{first}.mcap": contents[f"{first}.mcap"]}
    done = run("import", mine, written(tmp_path / "half.zip", half), "--allow")
    assert done.exit_code == 1 and "refused: " in done.stderr and shown(mine) == []
    assert "dash" not in run("tasks", mine).stdout
    assert run("import", mine, packed, "--allow").exit_code == 0 and "dash" in run("tasks", mine).stdout


def entries_json(*recordings: str, **more: Any) -> bytes:
    entries = [{"recordings": list(recordings)}] if recordings else []
    return json.dumps({"format": "nmes-leaderboard-pack/1", "entries": entries, **more}).encode()


HASH = "0" * 64
CONTENTS: dict[str, tuple[Members, str]] = {
    "a path out of the folder": ({"entries.json": entries_json(), "../evil.mcap": b"x"}, "'../evil.mcap'"),
    "an absolute path": ({"entries.json": entries_json(), "/tmp/evil.mcap": b"x"}, "'/tmp/evil.mcap'"),
    "a folder": ({"entries.json": entries_json(), "a/": b""}, "'a/'"),
    "no list": ({f"{HASH}.mcap": b"x"}, "has no entries.json"),
    "no JSON": ({"entries.json": b"{"}, "entries.json: not strict JSON"),
    "deep JSON": ({"entries.json": b"[" * 100_000}, "entries.json: "),
    "another format": ({"entries.json": b'{"format": "x", "entries": []}'}, "format: expected"),
    "an unknown field": ({"entries.json": entries_json(score=9)}, "score: there is no such field"),
    "a name that is no hash": ({"entries.json": entries_json("../../x")}, "a hash of 64"),
    "a recording that is not in it": ({"entries.json": entries_json(HASH)}, "which is not in it"),
    "a recording of two entries": (
        {
            "entries.json": entries_json(HASH).replace(b"}]", b'}, {"recordings": ["' + HASH.encode() + b'"]}]'),
            f"{HASH}.mcap": b"x",
        },
        "for two entries",
    ),
    "a large list": ({"entries.json": entries_json() + b" " * (17 << 20)}, "entries.json is too large"),
    "a large signature": (
        {"entries.json": entries_json(), f"{HASH}.mcap.sig": bytes(1 << 17)},
        ".sig is too large",
    ),
}


def refused(packed: Path, word: str, folder: Path) -> None:
    """Checks that a file is refused in a sentence, and that nothing comes of it."""
    before = {path.name for path in folder.rglob("*")}
    done = run("import", folder / "mine.sqlite", packed)
    assert done.exit_code == 2 and word in done.stderr.replace("\n", " "), done.output
    assert {path.name for path in folder.rglob("*")} == before
    assert not Path("/tmp/evil.mcap").exists()


@pytest.mark.parametrize(("contents", "word"), CONTENTS.values(), ids=CONTENTS)
def test_a_file_that_holds_something_else_is_refused(contents: Members, word: str, tmp_path: Path) -> None:
    refused(written(tmp_path / "x.zip", contents), word, tmp_path)


def test_a_compressed_file_is_refused_before_it_is_read(tmp_path: Path) -> None:
    bomb = {"entries.json": entries_json(), f"{HASH}.mcap": bytes(1 << 24)}
    refused(written(tmp_path / "bomb.zip", bomb, zipfile.ZIP_DEFLATED), "is compressed", tmp_path)


def overlapping(data: bytes) -> bytes:
    """Has the list of members name the largest one many times over, each time under another name."""
    start, length = struct.unpack("<LL", data[-10:-2])[1], struct.unpack("<L", data[-10:-6])[0]
    directory = data[start : start + length]
    last = directory[directory.rindex(b"PK\x01\x02") :]
    copies = [last.replace(HASH.encode(), f"{i:064x}".encode()) for i in range(2000)]
    body = data[:start] + b"".join(copies) + directory[: -len(last)]
    return body + struct.pack("<4s4H2LH", b"PK\x05\x06", 0, 0, 2001, 2001, len(body) - start, start, 0)


def announced(data: bytes) -> bytes:
    """Announces a larger list of members elsewhere, as a zip of over 4 GiB does."""
    locator = struct.pack("<4sLQL", b"PK\x06\x07", 0, 0, 1)
    return data[:-22] + locator + data[-22:]


EDITS: dict[str, tuple[Callable[[bytes], bytes], str]] = {
    "nothing": (lambda data: b"", "was cut"),
    "cut": (lambda data: data[:-1], "was cut"),
    "cut in the middle": (lambda data: data[: len(data) // 2], "was cut"),
    "more behind it": (lambda data: data + b"x", "was cut"),
    "a comment": (lambda data: data[:-2] + b"\x01\x00x", "was cut"),
    "more before it": (lambda data: b"x" * 100 + data, "list of files"),
    "many members": (lambda data: data[:-14] + b"\xff\xff\xff\xff" + data[-10:], "list of files"),
    "members in one place": (overlapping, "in the same place"),
    "a list elsewhere": (announced, "list of files"),
}


@pytest.mark.parametrize(("edit", "word"), EDITS.values(), ids=EDITS)
def test_a_file_that_is_not_as_it_was_written_is_refused(
    edit: Callable[[bytes], bytes], word: str, tmp_path: Path
) -> None:
    path = written(tmp_path / "x.zip", {"entries.json": entries_json(), f"{HASH}.mcap": bytes(100_000)})
    path.write_bytes(edit(path.read_bytes()))
    refused(path, word, tmp_path)


def test_a_recording_of_another_content_is_refused(packed: Path, tmp_path: Path) -> None:
    contents = members(packed)
    first = json.loads(contents["entries.json"])["entries"][0]["recordings"][0]
    contents[f"{first}.mcap"] = contents[f"{first}.mcap"][:-1] + b"x"
    done = run("import", tmp_path / "mine.sqlite", written(tmp_path / "x.zip", contents), "--allow")
    assert done.exit_code == 1 and "has another content" in done.stderr and len(shown(tmp_path / "mine.sqlite")) == 2


def test_changed_bytes_anywhere_end_in_a_sentence(tmp_path: Path) -> None:
    whole = written(tmp_path / "x.zip", {"entries.json": entries_json(HASH), f"{HASH}.mcap": b"y" * 50}).read_bytes()
    draw = random.Random(3)
    for _ in range(150):
        data = bytearray(whole)
        for _ in range(draw.choice((1, 1, 4))):
            data[draw.randrange(len(data))] = draw.randrange(256)
        (tmp_path / "x.zip").write_bytes(data)
        done = run("import", tmp_path / "mine.sqlite", tmp_path / "x.zip")  # a traceback is a failure
        assert done.exit_code in (1, 2) and ("refused" in done.stderr or "no packed leaderboard" in done.stderr)
