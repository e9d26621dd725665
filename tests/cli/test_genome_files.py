"""`nmes genome list`, `new`, `copy` and `show`: the genomes that ship, files to begin from, and what is in them."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from layout import ROOT
from nmes.cli import main
from nmes.genome import Genome


def run(*arguments: str | Path) -> Result:
    result = CliRunner().invoke(main, ["genome", *map(str, arguments)])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


def test_list_has_a_row_for_each_genome_that_ships() -> None:
    header, *rows = run("list").stdout.splitlines()
    assert header.split()[:1] == ["genome"]
    assert [row.split()[0] for row in rows] == list(Genome.names())
    (walker,) = (row for row in rows if row.startswith("walker "))
    assert re.search(r" 0\.\d+ x 0\.\d+ x 0\.\d+ ", walker) and walker.split()[-1] == "cpg"
    about = {each["name"]: each for each in json.loads(run("list", "--json").stdout)}
    assert list(about) == list(Genome.names())
    assert about["walker"]["brain"] == "cpg" and len(about["walker"]["motors"]) == 8


def test_new_writes_the_worked_example_under_the_name_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "hopper.json"
    done = run("new", path)
    assert done.exit_code == 0 and done.stdout.startswith(f"wrote {path}")
    assert Genome.problems(json.loads(path.read_text())) == []
    page = (ROOT / "docs" / "genomes.md").read_text().split("## A worked example")[1]
    assert json.loads(page.split("```json\n")[1].split("```")[0]) == json.loads(path.read_text())
    assert run("new", tmp_path / "Ada's beast.json").exit_code == 0
    assert Genome.load(tmp_path / "Ada's beast.json").name == "Ada's beast"
    assert run("check", path).exit_code == 0


def test_copy_gives_a_creature_another_name_and_tells_where_it_is_from(tmp_path: Path) -> None:
    path = tmp_path / "mine.json"
    assert run("copy", "walker", path).exit_code == 0
    copy, original = Genome.load(path), Genome.load("walker")
    assert copy.name == "mine" and copy.document["parents"] == [original.hash]
    assert copy.document == {**original.document, "name": "mine", "parents": [original.hash]}
    assert run("copy", path, tmp_path / "other.json").exit_code == 0
    assert Genome.load(tmp_path / "other.json").document["parents"] == [copy.hash]


@pytest.mark.parametrize("arguments", [("new",), ("copy", "walker")])
def test_nothing_that_is_there_is_written_over(tmp_path: Path, arguments: tuple[str, ...]) -> None:
    path = tmp_path / "mine.json"
    path.write_text("precious")
    refused = run(*arguments, path)
    assert refused.exit_code == 2 and "there is" in refused.stderr and path.read_text() == "precious"
    refused = run(*arguments, tmp_path / ("x" * 120 + ".json"))
    assert refused.exit_code == 2 and "a name of 1 to 100" in refused.stderr


def test_a_genome_that_is_none_is_not_copied(tmp_path: Path) -> None:
    (tmp_path / "bad.json").write_text("{}")
    assert run("copy", tmp_path / "bad.json", tmp_path / "new.json").exit_code == 1
    missing = run("copy", "walkr", tmp_path / "new.json")
    assert missing.exit_code == 1 and "did you mean walker?" in missing.stderr
    assert not (tmp_path / "new.json").exists()


def test_show_tells_the_voices_of_a_creature_that_has_some(tmp_path: Path) -> None:
    path = tmp_path / "caller.json"
    path.write_text(json.dumps({**Genome.load("roller").document, "voices": [{"channel": "lead", "number": 2}]}))
    assert run("show", path).stdout.splitlines()[-1] == "voices: say.lead.2"
    assert json.loads(run("show", path, "--json").stdout)[0]["voices"] == ["say.lead.2"]
    assert "voices" not in run("show", "roller").stdout


def test_show_tells_how_a_creature_develops(tmp_path: Path) -> None:
    path = tmp_path / "late.json"
    rules = [
        {"when": "age > 2", "grow": ["foot"], "enter": 2},
        {"when": 'has("foot") < 1', "stage": 2, "grow": ["foot"], "every": 3, "times": 5},
    ]
    path.write_text(json.dumps({**Genome.load("jumper").document, "later": ["foot"], "development": rules}))
    *_, born, _, _, first, second = [line.split() for line in run("show", path).stdout.splitlines()]
    assert " ".join(born) == "not there at birth: foot"
    assert " ".join(first) == "0 age > 2 any grow foot; enter stage 2 once 1 s"
    assert " ".join(second) == '1 has("foot") < 1 2 grow foot 5 times 3 s'
    (shown,) = json.loads(run("show", path, "--json").stdout)
    assert shown["later"] == ["foot"] and shown["development"] == rules
    assert "birth" not in run("show", "jumper").stdout


def test_what_is_wrong_with_rules_is_told(tmp_path: Path) -> None:
    path = tmp_path / "wrong.json"
    rules = [{"when": "agge > 2", "grow": ["log"]}, {"when": "age > 1"}]
    path.write_text(json.dumps({**Genome.load("jumper").document, "later": ["log"], "development": rules}))
    told = run("check", path).stdout
    for words in (
        "later/0: there is no cube 'log'; did you mean leg?",
        "development/0/grow/0: there is no cube 'log'; did you mean leg?",
        "development/0/when: line 1, column 1: there is no quantity 'agge'; did you mean age?",
        "development/1: it does nothing; expected shed, adopt, grow, resize or enter",
    ):
        assert words in told
