"""Names of strangers: they forge no row of a table, and no command of theirs reaches a terminal."""

from __future__ import annotations

import csv
import io
import json
import os
import subprocess
from pathlib import Path

import pytest
from click.testing import CliRunner
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from hypothesis import given
from hypothesis import strategies as st

from boards import DASH
from creatures import snake
from layout import ROOT
from made_up_runs import make_run
from nmes.cli import main
from nmes.errors import DocumentError, visible
from nmes.genome import Genome
from processes import NMES

HOSTILE = "walker\n  1  99.9  forged\r\x1b[31m\x9b2J\u202egnp\u2028\u200b\x7f\ufeff"
SAFE = r"walker\n  1  99.9  forged\r\x1b[31m\x9b2J\u202egnp\u2028\u200b\x7f\ufeff"


def printable(text: str) -> bool:
    return all(line.isprintable() for line in text.split("\n"))


def output(*arguments: str | Path) -> str:
    """Runs a command; returns all that it wrote, in which nothing may be that does not print."""
    result = CliRunner().invoke(main, [*map(str, arguments)])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    assert printable(result.output), ascii(result.output)
    return result.output


@given(st.text())
def test_what_does_not_print_is_escaped_and_all_else_is_left(text: str) -> None:
    shown = visible(text)
    assert shown.isprintable()
    assert text.isprintable() == (shown == text)
    assert visible(text, keep="\n").split("\n") == [visible(line) for line in text.split("\n")]


def test_a_hostile_name_is_escaped_whole() -> None:
    assert visible(HOSTILE) == SAFE
    assert visible("Zoë's 蛇 (2)") == "Zoë's 蛇 (2)"


@pytest.mark.parametrize("field", ["name", "author", "license"])
@pytest.mark.parametrize("sign", ["\n", "\t", "\x00", "\x1b", "\x7f", "\x9b", "\u202e", "\u2028", "\u200b", "\ufeff"])
def test_a_genome_with_signs_that_do_not_print_in_its_names_is_refused(field: str, sign: str) -> None:
    for text in (f"a{sign}b", f"ab{sign}"):
        with pytest.raises(DocumentError, match=f"{field}: expected a .* printable characters"):
            Genome({**snake(), field: text})


@pytest.fixture
def genome(tmp_path: Path) -> Path:
    """A good genome with hostile text wherever a schema allows it, in a file with a hostile name."""
    path = tmp_path / f"{HOSTILE}.json"
    path.write_text(json.dumps(snake(description=HOSTILE)))
    return path


@pytest.fixture
def ill(tmp_path: Path) -> Path:
    """A genome with a hostile name, and fields that there are not."""
    path = tmp_path / "ill" / f"{HOSTILE}.json"
    path.parent.mkdir()
    path.write_text(json.dumps({**snake(name=HOSTILE, author=HOSTILE), HOSTILE: 1}))
    return path


@pytest.fixture
def task(tmp_path: Path) -> Path:
    """A task with a hostile description, and conditions that are laid out with line feeds."""
    path = tmp_path / "task.json"
    document = {
        "format": "nmes-task/1",
        "name": "dash",
        "description": HOSTILE,
        "duration": 0.1,
        "seeds": [1],
        "objective": "displacement.horizontal\r\n+ 0.0",
        "ends": [{"name": "up", "when": "height\r\n> 100.0"}],
    }
    path.write_text(json.dumps(document))
    return path


def test_nmes_genome_shows_hostile_names(genome: Path, ill: Path, tmp_path: Path) -> None:
    assert SAFE in output("genome", "check", genome)
    assert SAFE in output("genome", "check", ill) and "\\u202e" in output("genome", "check", ill, "--json")
    assert "\\x1b" in output("genome", "show", genome)
    assert json.loads(output("genome", "show", genome, "--json"))[0]["description"] == HOSTILE
    assert json.loads(output("genome", "expand", genome))["description"] == HOSTILE
    assert SAFE in output("genome", "expand", genome, "-o", tmp_path / HOSTILE)
    assert "\\x1b" in output("genome", "show", ill)
    output("genome", "show", genome, "-o", tmp_path / f"{HOSTILE}.png")


def test_nmes_tasks_shows_hostile_text(task: Path) -> None:
    assert "\\x1b" in output("tasks", task)
    assert json.loads(output("tasks", task, "--json"))["description"] == HOSTILE
    assert SAFE in output("tasks", HOSTILE)


def test_nmes_eval_shows_hostile_names(ill: Path, task: Path, tmp_path: Path) -> None:
    arguments = ("eval", ill, "--task", task, "--jobs", "1")
    table = output(*arguments)
    assert "\\x1b" in table and sum("forged" in line for line in table.splitlines() if line.startswith("  1")) == 0
    (row,) = json.loads(output(*arguments, "--json"))
    assert row["genome"] == HOSTILE
    (row,) = csv.DictReader(io.StringIO(output(*arguments, "--csv")))
    assert row["genome"] == SAFE
    assert SAFE in output("eval", ill.with_suffix(""), "--task", task)
    assert SAFE in output("eval", "walker", "--task", tmp_path / HOSTILE)
    assert "\\x1b" in output("eval", "--from-recording", ill)


def test_names_of_files_are_escaped(tmp_path: Path) -> None:
    recording = tmp_path / "x\x1b]0;pwn\x07\n.mcap"
    recording.write_bytes((ROOT / "replays" / "pymunk-pole.mcap").read_bytes())
    told = output("fork", recording, "-o", tmp_path / "\x1b[2J.mcap")
    assert r"x\x1b]0;pwn\x07\n.mcap" in told and r"\x1b[2J.mcap" in told
    key = Ed25519PrivateKey.generate()
    (file := tmp_path / "key.pem").write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    assert r"x\x1b]0;pwn" in output("sign", recording, "--key", file)


def test_names_of_films_and_of_drivers_of_clients_are_escaped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_run(tmp_path / "run", [])
    monkeypatch.setattr("nmes.view.run_film.film_run", lambda *_, **__: [1])
    assert SAFE in output("evolve", "film", tmp_path / "run", "-o", tmp_path / f"{HOSTILE}.gif")
    assert SAFE in output("conform-client", HOSTILE)


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp1251"])
def test_what_an_encoding_of_output_lacks_is_escaped(tmp_path: Path, encoding: str) -> None:
    (genome := tmp_path / "snake.json").write_text(json.dumps(snake(name="Zoë 蛇", description="🐍")))
    (task := tmp_path / "task.json").write_text(json.dumps(DASH))

    def told(*words: str | Path) -> str:
        environment = {**os.environ, "PYTHONIOENCODING": encoding}
        done = subprocess.run([NMES, *words], env=environment, capture_output=True, timeout=60)
        assert (done.returncode, done.stderr) == (0, b"")
        return done.stdout.decode("utf-8" if encoding == "ascii" else encoding)

    (document,) = json.loads(told("genome", "show", genome, "--json"))
    assert (document["name"], document["description"]) == ("Zoë 蛇", "🐍")
    table = told("eval", genome, "--task", task, "--seeds", "1", "--jobs", "1")
    assert ("Zoë 蛇" if encoding == "ascii" else "\\u86c7") in table
