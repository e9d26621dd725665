"""`nmes genome mutate`, `cross` and `diff`, run as a person would."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from nmes.cli import main
from nmes.evaluation import MatchTask
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


@pytest.mark.parametrize("place", [0, 1])
def test_what_cannot_be_compared_has_another_status_than_what_differs(place: int, tmp_path: Path) -> None:
    broken = tmp_path / "broken.json"
    broken.write_text(json.dumps({**Genome.load("walker").document, "body": {}}))
    for name, words in (("walkr", "walker"), (broken, "cubes"), (tmp_path, "directory")):
        arguments: list[str | Path] = ["walker", "walker"]
        arguments[place] = name
        result = run("diff", *arguments)
        assert result.exit_code == 2 and words in result.stderr and not result.stdout, result.output


@pytest.mark.parametrize(
    ("task", "role"), [("chase", "prey"), ("chase", "hunter"), ("sumo", None), ("interference-alone", None)]
)
def test_mutants_and_children_may_be_bred_for_a_role(task: str, role: str | None, tmp_path: Path) -> None:
    match = MatchTask.load(task)
    part = [] if role is None else ["--role", role]
    for what in (["mutate", "walker"], ["cross", "walker", "roller"]):
        result = run(*what, "--task", task, *part, "-n", "3", "-o", tmp_path / what[0])
        assert result.exit_code == 0, result.output
        bred = [Genome.load(path) for path in sorted((tmp_path / what[0]).iterdir())]
        assert len(bred) == 3
        assert all(match.check(role or next(iter(match.roles)), genome.body) == [] for genome in bred)


def test_what_a_role_allows_decides_what_is_bred(tmp_path: Path) -> None:
    document = MatchTask.load("chase").document
    document["roles"][0]["limits"] = {"cubes": 9}  # a walker's
    task = tmp_path / "task.json"
    task.write_text(json.dumps(document))
    for role, status in (("hunter", 1), ("prey", 0)):
        result = run("mutate", "walker", "--kind", "add-part", "--task", task, "--role", role)
        assert result.exit_code == status, result.output


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
        (("mutate", "walker", "--task", "chase"), "--role hunter or --role prey"),
        (("cross", "walker", "roller", "--task", "chase", "--role", "huntr"), "did you mean hunter"),
        (("mutate", "walker", "--task", "walk", "--role", "prey"), "walk has no roles"),
        (("mutate", "walker", "--role", "prey"), "--task"),
    ):
        result = run(*arguments)
        assert result.exit_code in (1, 2) and words in result.output, result.output
    file = tmp_path / "own.json"
    file.write_text(json.dumps(Genome.load("walker").document))
    before = file.read_bytes()
    assert run("mutate", file, "-o", file).exit_code != 0
    assert file.read_bytes() == before
