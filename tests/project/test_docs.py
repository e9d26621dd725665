"""What the documents say exists, and what exists is documented."""

from __future__ import annotations

import importlib
import json
import re
import shlex
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import pytest

import demo
import reference_docs
from layout import PROJECT, ROOT
from nmes import objective
from nmes.cli import SUBCOMMANDS
from nmes.evaluation import Task
from nmes.protocol import COMMANDS, DELIMITER

DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
README = (ROOT / "README.md").read_text()
CONSOLE = [
    line.removeprefix("$ ").split("#")[0].strip()
    for document in DOCUMENTS
    for block in re.findall(r"^```console\n(.*?)^```", document.read_text(), flags=re.DOTALL | re.MULTILINE)
    for line in block.splitlines()
    if line.startswith("$ ")
]


def subcommand(name: str) -> click.Command:
    command = importlib.import_module(f"nmes.cli.{name.replace('-', '_')}").command
    assert isinstance(command, click.Command)
    return command


def test_every_file_of_the_command_line_is_a_listed_subcommand() -> None:
    assert {path.stem.replace("_", "-") for path in (ROOT / "cli").glob("[!_]*.py")} == set(SUBCOMMANDS)


@pytest.mark.parametrize("name", SUBCOMMANDS)
def test_every_subcommand_has_the_help_of_the_list(name: str) -> None:
    assert subcommand(name).get_short_help_str(100) == SUBCOMMANDS[name]


def leaves(name: str) -> list[tuple[str, click.Command]]:
    """Returns a subcommand or, for a group, its commands, each with its full name."""
    command = subcommand(name)
    if isinstance(command, click.Group):
        return [(f"nmes {name} {inner}".strip(), each) for inner, each in command.commands.items()]
    return [(f"nmes {name}", command)]


@pytest.mark.parametrize("name", SUBCOMMANDS)
def test_every_help_ends_with_examples_on_lines_of_their_own(name: str) -> None:
    for usage, command in leaves(name):
        help_text = command.get_help(click.Context(command, info_name=usage))
        _, examples = help_text.partition("Options:")[0].split("For example:")
        lines = examples.split("\n\n")[1].splitlines()
        assert lines and all(line.strip().startswith(usage) for line in lines), help_text
        for line in lines:
            words = shlex.split(line)[len(usage.split()) :]
            command.make_parser(click.Context(command)).parse_args(words)  # raises where an option is unknown


@pytest.mark.parametrize("line", [line for line in CONSOLE if line.startswith("nmes ")])
def test_commands_shown_exist(line: str) -> None:
    _, name, *arguments = shlex.split(line)
    assert name in SUBCOMMANDS
    command = subcommand(name)
    if isinstance(command, click.Group):
        _, found, arguments = command.resolve_command(click.Context(command), arguments)
        assert found is not None
        command = found
    options = {option for parameter in command.params for option in parameter.opts} | {"--help"}
    used = {argument.split("=")[0] for argument in arguments if argument.startswith("-")}
    assert used <= options


@pytest.mark.parametrize("path", reference_docs.PAGES, ids=lambda path: path.stem)
def test_the_references_list_every_command_every_public_name_and_every_option(path: Path) -> None:
    page = path.read_text()
    titles, expected = reference_docs.PAGES[path]
    written = reference_docs.rewrite(page, titles, expected())
    assert page == written, "out of date: .venv/bin/python tools/reference_docs.py"
    listed = rows(path.name)
    assert {name for name, *_ in listed} >= {name for name, *_ in expected()}


def test_make_targets_shown_exist_and_are_listed() -> None:
    makefile = (ROOT / "Makefile").read_text()
    targets = set(re.findall(r"^([a-z-]+):", makefile, flags=re.MULTILINE))
    phony = set(re.search(r"^\.PHONY: (.*)$", makefile, flags=re.MULTILINE)[1].split())  # type: ignore[index]
    shown = {target for line in CONSOLE if line.startswith("make ") for target in line.split()[1:]}
    helped = set(re.findall(r'@echo "make ([a-z-]+)', makefile))
    assert shown and shown <= targets
    assert helped <= targets
    assert targets == phony


@pytest.mark.parametrize("target", ["conform-selftest", "goldens", "layout"])
def test_programs_that_make_runs_find_their_modules(target: str) -> None:
    plan = subprocess.run(["make", "--dry-run", target], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    ((command, program),) = re.findall(r"^(.*python )(tools/\w+\.py)", plan, flags=re.MULTILINE)
    load = f"import runpy, sys; sys.path[0] = 'tools'; runpy.run_path('{program}')"
    subprocess.run(f"{command} -c {shlex.quote(load)}", shell=True, cwd=ROOT, check=True)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_links_in_documents_point_to_existing_files(document: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", document.read_text()):
        if "://" not in target:
            assert (document.parent / target).exists(), f"{document} links to {target}"


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_files_that_documents_name_are_in_the_tree(document: Path) -> None:
    text = document.read_text()
    for path in re.findall(r"(?<![\w/.-])(?:benchmarks|examples|replays|tools)/[\w/-]+\.[a-z]+\b", text):
        assert (ROOT / path).exists(), f"{path} is not there, or not where git has it"


def rows(document: str) -> set[tuple[str, ...]]:
    """Returns the rows of all tables of a document whose first cell is code."""
    lines = (ROOT / "docs" / document).read_text().splitlines()
    cells = (tuple(cell.strip() for cell in line.strip("|").split("|")) for line in lines if line.startswith("| `"))
    return {(first.strip("`"), *others) for first, *others in cells}


def test_the_page_of_objectives_lists_every_quantity_and_function() -> None:
    documented = rows("objectives.md")
    expected: set[tuple[str, ...]] = {
        (name, unit, meaning)
        for name, (meaning, unit) in {**objective.QUANTITIES, **objective.MEETING_QUANTITIES}.items()
    }
    expected |= {(name, meaning) for table in (objective.FUNCTIONS, objective.FOLDS) for name, meaning in table.items()}
    assert documented >= expected
    metrics = COMMANDS["compute_reward"].schema["properties"]["metric"]["enum"]
    assert sorted(row[0] for row in documented - expected) == sorted(metrics)


def test_the_page_of_tasks_lists_the_shipped_tasks() -> None:
    assert rows("tasks.md") == {
        (name, f"{(task := Task.load(name)).duration:g} s", task.description) for name in Task.names()
    }
    (example,) = re.findall(r"^```json\n(.*?)^```", (ROOT / "docs" / "tasks.md").read_text(), re.DOTALL | re.MULTILINE)
    assert Task(json.loads(example)).seeds == (1, 2, 3)


def test_the_architecture_has_a_row_for_every_package_which_names_the_packages_in_it() -> None:
    text = (ROOT / "ARCHITECTURE.md").read_text()
    told = dict(re.findall(r"^\| `(nmes\.\w+)`[^|]*\| (.*) \|$", text, flags=re.MULTILINE))
    parts = [name.removeprefix("nmes.") for name in PROJECT["tool"]["setuptools"]["packages"] if name != "nmes"]
    tops = {part for part in parts if "." not in part} | {path.stem for path in (ROOT / "nmes").glob("[!_]*.py")}
    assert {f"nmes.{top}" for top in tops} == told.keys()
    # An engine is no part of the page, so that one can be added without it.
    inner = [part.split(".") for part in parts if "." in part and not part.startswith("backends.")]
    assert [(top, name) for top, name in inner if not re.search(rf"`{name}/?`", told[f"nmes.{top}"])] == []


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    with demo.served(tmp_path_factory.mktemp("recordings"), "--mode", "lockstep") as server:
        yield server


README_PROGRAMS = re.findall(r"^```python\n(.*?)^```", README, flags=re.DOTALL | re.MULTILINE)


def test_the_environments_of_the_readme_can_be_made() -> None:
    _, code = README_PROGRAMS
    shown = "print(env.reset(seed=1)[0].shape, envs.reset(seed=1)[0].shape)"
    result = subprocess.run([sys.executable, "-c", code + shown], capture_output=True, text=True, check=True)
    assert result.stdout == "(26,) (64, 26)\n"


def test_the_python_of_the_readme_works(served: dict[str, Any]) -> None:
    code, _ = README_PROGRAMS
    program = re.sub(r"password=\"[^\"]*\"", f"port={served['port']}, password={served['password']!r}", code)
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert json.loads(result.stdout)[0] > 1.0


def test_the_conversation_of_the_readme_works(served: dict[str, Any]) -> None:
    (talk,) = re.findall(r"^\$ nc .*?\n(.*?)^```", README, flags=re.DOTALL | re.MULTILINE)
    with socket.create_connection(("127.0.0.1", served["port"]), timeout=10) as connection:
        for line in talk.splitlines():
            if line.startswith("{"):
                connection.sendall(re.sub(r"(?<=password\":\")[^\"]*", served["password"], line).encode() + b"\n")
            else:
                reply = b""
                while not reply.endswith(DELIMITER):
                    reply += connection.recv(1)
                shown, got = line.strip().encode(), json.loads(reply.removesuffix(DELIMITER))
                fields = re.findall(rb'"([a-z_]+)":', shown)
                assert [name.decode() for name in fields] == list(got)[: len(fields)]
                assert f'"type":"{got["type"]}"'.encode() in shown
