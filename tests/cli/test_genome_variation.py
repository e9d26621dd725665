"""`nmes genome mutate`, `cross` and `diff`, run as a person would."""

from __future__ import annotations

import json
from pathlib import Path

from click.testing import CliRunner, Result

from nmes.cli import main
from nmes.genome import Genome


def run(*arguments: str | Path) -> Result:
    result = CliRunner().invoke(main, ["genome", *map(str, arguments)])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


def test_a_mutant_is_written_and_differs_from_its_parent(tmp_path: Path) -> None:
    file = tmp_path / "mutant.json"
    result = run("mutate", "walker", "--kind", "resize-part", "--seed", "3", "--task", "walk", "-o", file)
    assert result.exit_code == 0 and "resize-part" in result.output
    assert run("check", file).exit_code == 0
    difference = run("diff", "walker", file)
    assert difference.exit_code == 1 and "body / cubes / " in difference.output
    listed = json.loads(run("diff", "walker", file, "--json").stdout)
    assert {"path", "before", "after", "kind"} == set(listed[0])
    assert run("diff", file, file).exit_code == 0


def test_many_mutants_go_to_a_directory_and_follow_from_the_seed(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        assert run("mutate", "centipede", "-n", "4", "--seed", "9", "-o", tmp_path / folder).exit_code == 0
    names = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert names == [f"centipede-9-{number}.json" for number in range(4)]
    assert all((tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes() for name in names)
    assert len({Genome.load(tmp_path / "a" / name).hash for name in names}) == 4


def test_without_an_output_documents_are_printed() -> None:
    document = json.loads(run("cross", "walker", "roller", "--seed", "2").stdout)
    parents = [Genome.load(name).hash for name in ("walker", "roller")]
    assert document["parents"] == parents


def test_bad_input_is_refused_in_words(tmp_path: Path) -> None:
    for arguments, words in (
        (("mutate", "walkr"), "walker"),
        (("mutate", "walker", "--kind", "add-prt"), "add-part"),
        (("mutate", "walker", "--kind", "weights"), "nothing of that kind"),
        (("mutate", "walker", "--task", "wlk"), "walk"),
        (("mutate", "walker", "-n", "0"), "0"),
        (("cross", "walker", "nobody"), "nobody"),
    ):
        result = run(*arguments)
        assert result.exit_code in (1, 2) and words in result.output, result.output
    file = tmp_path / "own.json"
    file.write_text(json.dumps(Genome.load("walker").document))
    before = file.read_bytes()
    assert run("mutate", file, "-o", file).exit_code != 0
    assert file.read_bytes() == before
