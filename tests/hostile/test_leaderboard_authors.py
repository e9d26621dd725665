"""Whose an entry is: names belong to the keys that signed under them, however they are written."""

from __future__ import annotations

import json
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from boards import DASH, edit, entries_of, entry, key_in, proofs_of, recording_of, run, signed, verdicts
from creatures import SINE, cpg, mlp, snake
from nmes.evaluation.authors import author_forms


@pytest.fixture(scope="module")
def dash(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The task's file."""
    path = tmp_path_factory.mktemp("task") / "dash.json"
    path.write_text(json.dumps(DASH))
    return path


def test_an_author_counts_when_all_recordings_are_signed_by_one_key(tmp_path: Path, dash: Path) -> None:
    board, ada, eve = tmp_path / "board.sqlite", key_in(tmp_path / "ada.pem", 1), key_in(tmp_path / "eve.pem", 2)
    run("tasks", board, "--allow", dash)
    claimed = proofs_of(tmp_path / "1", snake(SINE, name="claimed", author="Bob"))
    assert run("add", board, *claimed).exit_code == 0
    mine = signed(proofs_of(tmp_path / "2", snake(cpg(4), name="mine")), ada)
    assert run("add", board, *mine).exit_code == 0
    listed = entry(board, "mine")
    assert len(listed.key) == 64 and entry(board, "claimed").key == ""
    table = run("show", board).stdout
    assert f"Ada (key {listed.key[:16]})" in table and "Bob (unsigned)" in table
    page = tmp_path / "board.html"
    run("export", board, "-o", page)
    assert f"Ada (key {listed.key[:16]})" in page.read_text() and "Bob (unsigned)" in page.read_text()
    # The name is that key's now: however it is written, and whoever would like it.
    for number, (author, key) in enumerate((("Ada", eve), ("Ada", None), ("ADA ", eve), ("\uff21da", None))):
        other = proofs_of(tmp_path / f"x{number}", snake(mlp(4, seed=number), name="other", author=author))
        refused = run("add", board, *(other if key is None else signed(other, key)))
        assert refused.exit_code == 1 and "another key" in refused.stderr
    half = proofs_of(tmp_path / "5", snake(mlp(4, seed=9), name="half", author="Cleo"))
    signed(half[:1], eve)
    assert run("add", board, *half).exit_code == 0 and entry(board, "half").key == ""
    mixed = proofs_of(tmp_path / "6", snake(mlp(4, seed=8), name="mixed", author="Dora"))
    signed(mixed[:1], ada)
    signed(mixed[1:], eve)
    assert run("add", board, *mixed).exit_code == 0 and entry(board, "mixed").key == ""
    more = signed(proofs_of(tmp_path / "7", snake(mlp(4, seed=7), name="more")), ada)
    assert run("add", board, *more).exit_code == 0 and entry(board, "more").key == listed.key
    assert verdicts(board)[0] == 0


def test_a_signature_that_is_gone_or_of_another_recording_is_found(tmp_path: Path, dash: Path) -> None:
    board, ada = tmp_path / "board.sqlite", key_in(tmp_path / "ada.pem", 1)
    run("tasks", board, "--allow", dash)
    mine = signed(proofs_of(tmp_path / "1", snake(name="mine")), ada)
    wrong = proofs_of(tmp_path / "2", snake(cpg(4), name="wrong"))
    for path, other in zip(wrong, mine, strict=True):
        Path(f"{path}.sig").write_bytes(Path(f"{other}.sig").read_bytes())
    refused = run("add", board, *wrong)
    assert refused.exit_code == 1 and "signature" in refused.stderr
    assert run("add", board, *mine).exit_code == 0
    signature = Path(f"{recording_of(board, entry(board, 'mine').recordings[0])}.sig")
    content = signature.read_bytes()
    signature.unlink()
    status, found = verdicts(board)
    assert status == 1 and "key: listed " in found["mine"][1]
    signature.write_bytes(content[:100])
    assert verdicts(board)[0] == 1
    for nonsense in (b"", b"[]", b'{"signature": 1}', b'{"signature": "", "public_key": "AAAA"}', b"\xff" * 99):
        signature.write_bytes(nonsense)
        assert verdicts(board)[0] == 1


def test_a_signature_that_another_listing_left_beside_a_recording_goes(tmp_path: Path, dash: Path) -> None:
    board, ada = tmp_path / "board.sqlite", key_in(tmp_path / "ada.pem", 1)
    run("tasks", board, "--allow", dash)
    mine = signed(proofs_of(tmp_path / "1", snake(name="mine")), ada)
    assert run("add", board, *mine).exit_code == 0
    edit(board, "DELETE FROM entries")
    for path in mine:
        Path(f"{path}.sig").unlink()
    assert run("add", board, *mine).exit_code == 0 and entry(board, "mine").key == ""
    assert verdicts(board) == (0, {"mine": ("holds", "")})


ALIKE = [
    "\u0410da",  # A is Cyrillic
    "Ad\u0430",  # and here a
    "\u0391da",  # Greek
    "Ada\ufe0f",  # what follows is not seen
    "A\u034fda",
    "Ad\u3164a",
    "Ada\U000e0041",
    "\uff21da",
]


@pytest.mark.parametrize("author", ALIKE, ids=ascii)
def test_a_name_that_looks_like_anothers_is_not_listed(tmp_path: Path, dash: Path, author: str) -> None:
    board, eve = tmp_path / "board.sqlite", key_in(tmp_path / "eve.pem", 2)
    run("tasks", board, "--allow", dash)
    mine = signed(proofs_of(tmp_path / "1", snake(name="mine")), key_in(tmp_path / "ada.pem", 1))
    assert run("add", board, *mine).exit_code == 0
    other = signed(proofs_of(tmp_path / "2", snake(cpg(4), name="other", author=author)), eve)
    refused = run("add", board, *other)
    assert refused.exit_code == 1 and "another key" in refused.stderr


def alike(one: str, other: str) -> bool:
    return not set(author_forms(one)).isdisjoint(author_forms(other))


def test_names_that_do_not_look_alike_are_several() -> None:
    names = ["Ada", "Adam", "Ali", "All", "AI", "Ad\u00e4", "\u0410\u0434\u0430", "\u5c0f\u6797", "Bo 1", "Bo 2"]
    for one in names:
        assert [other for other in names if alike(one, other)] == [one]
    assert alike("Al", "A\u0406") and alike("Bob", "B0b") and alike("ALI", "ali") and not alike("", "")


@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("Ada", "\u13aada"),  # Cherokee
        ("Bella", "\u13fcella"),  # and its small letters
        ("Ada", "\ua4eeda"),  # Lisu
        ("Ada", "\u1d00\u1d05\u1d00"),  # small capitals
        ("Ian", "\u026aan"),
        ("Cora", "\u2ca4ora"),  # Coptic
        ("Cora", "C\U0001042cra"),  # Deseret
        ("Osa", "\U000104c2sa"),  # Osage
        ("Max", "\u15f0ax"),  # Canadian syllabics
        ("Max", "Ma\u2d5d"),  # Tifinagh
        ("Max", "\u16d6ax"),  # runes
        ("Cora", "\u03f9ora"),  # Greek, where NFKC has another letter
        ("Ada", "\U0001d400da"),  # mathematical
        ("Ada", "A\U00016fe4da"),  # what is not seen
        ("Ada", "Ada\U0001d159"),
    ],
    ids=ascii,
)
def test_letters_of_other_scripts_that_look_like_latin_ones_make_no_other_name(name: str, other: str) -> None:
    assert alike(name, other) and not alike(name, f"{other}m")


def test_an_author_with_two_keys_holds_with_the_first(tmp_path: Path, dash: Path) -> None:
    """Somebody wrote the second entry into the file by hand, beside recordings that prove it."""
    board = tmp_path / "board.sqlite"
    for number, name in ((1, "mine"), (2, "other"), (3, "unsigned")):
        path = board if number == 1 else tmp_path / f"{number}.sqlite"
        run("tasks", path, "--allow", dash)
        made = proofs_of(tmp_path / name, snake(mlp(4, seed=number), name=name))
        listed = made if number == 3 else signed(made, key_in(tmp_path / f"{number}.pem", number))
        assert run("add", path, *listed).exit_code == 0
        for file in path.with_suffix(".recordings").iterdir():
            file.rename(board.with_suffix(".recordings") / file.name)
        if number > 1:
            with closing(sqlite3.connect(board)) as database, database:
                database.execute("ATTACH ? AS other", (str(path),))
                row = "task, task_hash, name, genome_hash, creature_hash, author, key, score, spread"
                row += ", players, recordings, recorded"
                database.execute(f"INSERT INTO entries ({row}) SELECT {row} FROM other.entries")
    status, found = verdicts(board, "--write")
    assert status == 1 and found["mine"] == ("holds", "")
    for name in ("other", "unsigned"):
        assert found[name][0] == "broken" and "another key" in found[name][1]
    assert [each.name for each in entries_of(board)] == ["mine"]
    # A name belongs to nobody by an entry that does not hold.
    edit(board, "UPDATE entries SET score = 7.0 WHERE name = 'mine'")
    found = verdicts(board)[1]
    assert {name: verdict for name, (verdict, _) in found.items()} == {
        "mine": "broken", "other": "holds", "unsigned": "broken"
    }  # fmt: skip
