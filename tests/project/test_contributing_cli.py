"""The examples of CONTRIBUTING.md for tasks, algorithms and commands, added to a copy of the package."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest

from layout import ROOT, lay_out
from nmes.evaluation import Limits, Task

PAGE = (ROOT / "CONTRIBUTING.md").read_text()


def section(title: str) -> str:
    """Returns a section's text."""
    (text,) = re.findall(rf"^## {title}\n(.*?)(?=^## |\Z)", PAGE, flags=re.DOTALL | re.MULTILINE)
    assert isinstance(text, str)
    return text


def files(text: str) -> list[str]:
    """Returns the files in the table of a section, at most four."""
    table, _, _ = text.partition("For example, ")
    names = re.findall(r"^\| `([^`]+)` \|", table, flags=re.MULTILINE)
    assert len(names) <= 4
    return names


def block(text: str, path: str) -> str:
    """Returns the code that follows the mention of a file in a section's example."""
    _, _, example = text.partition("For example, ")
    code = re.search(r"^```[a-z]+\n(.*?)^```", example[example.index(f"`{path}`") :], re.DOTALL | re.MULTILINE)
    assert code is not None, f"no code for {path}"
    return code[1]


class Copy:
    """A copy of the package, laid out as it is once installed, in which programs are run."""

    def __init__(self, root: Path) -> None:
        lay_out(root, copy=True)
        self.root = root

    def add(self, path: str, content: str) -> None:
        """Adds a file, whose path is that in the repository."""
        target = self.root / path if path.startswith("nmes/") else self.root / "nmes" / path
        assert not target.exists()
        target.write_text(content)

    def python(self, *arguments: str) -> str:
        """Runs Python with this copy as the package; returns what it prints."""
        result = subprocess.run(
            [sys.executable, *arguments],
            cwd=self.root,
            env={**os.environ, "PYTHONPATH": str(self.root), "COLUMNS": "200"},
            capture_output=True,
            text=True,
            check=False,
        )
        assert result.returncode == 0, result.stdout + result.stderr
        return result.stdout

    def nmes(self, *arguments: str) -> str:
        """Runs `nmes`; returns what it prints."""
        return self.python("-c", "from nmes.cli import main; main()", *arguments)


@pytest.fixture(scope="module")
def with_task(tmp_path_factory: pytest.TempPathFactory) -> Copy:
    """A copy with the task of the page."""
    copy = Copy(tmp_path_factory.mktemp("task"))
    path = "nmes/evaluation/tasks/backwards.json"
    copy.add(path, block(section("Adding a task"), path))
    return copy


@pytest.fixture(scope="module")
def with_command(tmp_path_factory: pytest.TempPathFactory) -> Copy:
    """A copy with the command of the page."""
    copy = Copy(tmp_path_factory.mktemp("command"))
    text = section("Adding a command to the command line")
    copy.add("cli/clients.py", block(text, "cli/clients.py"))
    table = copy.root / "nmes" / "cli" / "__init__.py"
    head = "SUBCOMMANDS = {\n"
    assert head in table.read_text()
    table.write_text(table.read_text().replace(head, head + block(text, "cli/__init__.py")))
    return copy


@pytest.fixture(scope="module")
def with_algorithm(tmp_path_factory: pytest.TempPathFactory) -> Copy:
    """A copy with the evolutionary algorithm of the page."""
    copy = Copy(tmp_path_factory.mktemp("algorithm"))
    text = section("Adding an evolutionary algorithm")
    copy.add("nmes/evolution/algorithms/climber.py", block(text, "nmes/evolution/algorithms/climber.py"))
    table = copy.root / "nmes" / "evolution" / "algorithms" / "__init__.py"
    head = "_PLACES: Final[Mapping[str, str]] = {\n"
    assert head in table.read_text()
    table.write_text(table.read_text().replace(head, head + block(text, "nmes/evolution/algorithms/__init__.py")))
    return copy


# -- a task -----------------------------------------------------------------------------------------------------------


def test_a_task_touches_the_files_that_its_example_shows() -> None:
    text = section("Adding a task")
    assert files(text) == ["nmes/evaluation/tasks/NAME.json", "docs/tasks.md", "tests/evaluation/test_tasks.py"]
    tests = (ROOT / "tests/evaluation/test_tasks.py").read_text()
    assert all(f'"{name}"' in tests for name in Task.names())


def test_the_task_is_listed_and_shown_as_its_row_says(with_task: Copy) -> None:
    assert re.search(r"^backwards +mujoco +5 +3 +max\(0, -displacement\.x", with_task.nmes("tasks"), re.MULTILINE)
    (document,) = [task for task in json.loads(with_task.nmes("tasks", "--json")) if task["name"] == "backwards"]
    row = f"| `backwards` | {document['duration']:g} s | {document['description']} |\n"
    assert block(section("Adding a task"), "docs/tasks.md") == row


def test_an_episode_of_the_task_runs(with_task: Copy) -> None:
    printed = with_task.nmes("eval", "walker", "--task", "backwards", "--seeds", "1", "--jobs", "1", "--json")
    assert '"backwards"' in printed and '"score"' in printed


def test_the_task_keeps_the_rules_of_tasks_that_ship(with_task: Copy) -> None:
    (document,) = [task for task in json.loads(with_task.nmes("tasks", "--json")) if task["name"] == "backwards"]
    assert len(document["seeds"]) >= 3
    # That of friction is meant where none is stated.
    assert set(document["limits"]) == {field.name for field in fields(Limits)} - {"friction"}


# -- an algorithm -----------------------------------------------------------------------------------------------------


def test_a_run_of_the_algorithm_is_resumed_and_verified(with_algorithm: Copy, tmp_path: Path) -> None:
    folder, options = str(tmp_path / "run"), ["--seeds", "1", "--jobs", "1", "--json"]
    begun = with_algorithm.nmes(
        "evolve", "inchworm", "--task", "walk", "--algorithm", "climber", "--budget", "14", "-o", folder, *options
    )
    assert json.loads(begun)["best"]["index"] >= 0
    with_algorithm.nmes("evolve", "verify", folder, "--jobs", "1")


def test_the_algorithm_keeps_the_laws_of_all(with_algorithm: Copy) -> None:
    laws = ROOT / "tests" / "evolution" / "test_algorithm_laws.py"
    (with_algorithm.root / "test_laws.py").write_text(laws.read_text())
    options = ["-q", "-p", "no:cacheprovider", "-c", os.devnull, "--rootdir=.", "-k", "climber"]
    assert " passed" in with_algorithm.python("-m", "pytest", *options, "test_laws.py")


# -- a command --------------------------------------------------------------------------------------------------------


def test_a_command_touches_the_files_that_its_example_shows() -> None:
    text = section("Adding a command to the command line")
    assert files(text) == ["cli/NAME.py", "cli/__init__.py", "docs/cli.md", "tests/cli/test_NAME.py"]
    assert "`nmes clients" in block(text, "docs/cli.md")


def test_help_lists_the_command_and_the_command_shows_its_own(with_command: Copy) -> None:
    assert re.search(r"^  clients +List the clients of a recording\.$", with_command.nmes("--help"), re.MULTILINE)
    own = with_command.nmes("clients", "--help")
    assert "List the clients of a recording." in own
    assert "      nmes clients run.mcap\n" in own


def test_the_command_runs(with_command: Copy) -> None:
    printed = with_command.nmes("clients", str(ROOT / "replays" / "mujoco-clients.mcap"))
    assert printed.splitlines() == ["2: 10 commands", "1: 7 commands", "3: 2 commands"]


def test_the_tests_of_the_command_pass(with_command: Copy) -> None:
    code = block(section("Adding a command to the command line"), "tests/cli/test_clients.py")
    (with_command.root / "test_clients.py").write_text(code)
    options = ["-q", "-p", "no:cacheprovider", "-c", os.devnull, "--rootdir=.", "-o", f"pythonpath={ROOT / 'tools'}"]
    assert "2 passed" in with_command.python("-m", "pytest", *options, "test_clients.py")
