"""`nmes completion`: what a shell is told, by the door by which shells ask."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from nmes.cli import SUBCOMMANDS, main
from nmes.evaluation import MatchTask, Task
from nmes.genome import Genome
from processes import NMES


def complete(line: str) -> list[str]:
    """Returns what completes the last word of a line: `file`, or a name."""
    words = shlex.split(line)
    environment = {"_NMES_COMPLETE": "bash_complete", "COMP_WORDS": line, "COMP_CWORD": str(len(words) - 1)}
    result = CliRunner().invoke(main, [], env=environment, prog_name="nmes")
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    answers = (answer.split(",", 1) for answer in result.stdout.splitlines() if answer)
    return [value if kind == "plain" else kind for kind, value in answers]


def test_commands_and_options_are_completed() -> None:
    assert complete("nmes di") == ["diff"]
    assert complete("nmes ''") == sorted(SUBCOMMANDS)
    assert complete("nmes evolve --bud") == ["--budget"]
    assert complete("nmes serve --mode l") == ["lockstep"]


@pytest.mark.parametrize(
    "line", ["eval", "genome show", "genome check", "genome mutate", "learn", "evolve", "tournament"]
)
def test_genomes_are_completed_by_name_and_as_files(line: str) -> None:
    assert complete(f"nmes {line} walk") == ["file", "walker"]
    assert set(complete(f"nmes {line} ''")) >= {"file", *Genome.names()}


@pytest.mark.parametrize(
    ("line", "names"),
    [
        ("evolve random --task", [*Task.names()]),
        ("learn walker --task", [*Task.names()]),
        ("eval walker --task", [*Task.names(), *MatchTask.names()]),
        ("tasks", [*Task.names(), *MatchTask.names()]),
        ("tournament walker --task", [*MatchTask.names()]),
    ],
)
def test_the_tasks_that_a_command_takes_are_completed_by_name_and_as_files(line: str, names: list[str]) -> None:
    assert complete(f"nmes {line} ''") == ["file", *names]


@pytest.mark.parametrize(
    "line", ["replay", "info", "verify", "render", "diff a.mcap", "export", "fork", "sign", "view"]
)
def test_recordings_are_completed_as_files(line: str) -> None:
    assert complete(f"nmes {line} re") == ["file"]


def first_arguments(group: click.Group, words: str) -> Iterator[tuple[str, str]]:
    """Yields the commands of a group that take an argument, each with the placeholder of its first."""
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        line = f"{words} {name}".strip()
        if isinstance(command, click.Group):
            yield from first_arguments(command, line)
        yield from [(line, each.make_metavar(context)) for each in command.params if isinstance(each, click.Argument)][
            :1
        ]


def test_every_first_argument_is_completed_but_addresses() -> None:
    found = list(first_arguments(main, "nmes"))
    assert len(found) > 25
    assert {placeholder for line, placeholder in found if not complete(f"{line} ''")} <= {
        "CREATURE",  # which are in a file
        "HOST:PORT",
        "[HOST:PORT|ws://HOST:PORT]",
        "[HOST[:PORT]...]",
        "[PACKAGES]...",  # whatever there is in the world
    }


def test_a_shell_that_does_not_ask_is_not_answered() -> None:
    assert "Usage: nmes" in CliRunner().invoke(main, ["--help"], prog_name="nmes").stdout


ASK = """
PATH="$1:$PATH"
eval "$(nmes completion bash)"
COMP_WORDS=(nmes eval walk); COMP_CWORD=2; compopt() { printf "compopt %s %s\n" "$@"; }
_nmes_completion nmes walk eval
echo "${COMPREPLY[@]}"
complete -p nmes
"""


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
def test_bash_completes_by_what_is_printed() -> None:
    command = ["bash", "-c", ASK, "bash", str(Path(NMES).parent)]
    result = subprocess.run(command, capture_output=True, text=True, check=True, env=dict(os.environ))
    assert result.stdout.splitlines() == [
        "compopt -o default",
        "walker",
        "complete -o nosort -F _nmes_completion nmes",
    ]


@pytest.mark.parametrize(("shell", "sign"), [("zsh", "compdef _nmes_completion nmes"), ("fish", "complete --no-files")])
def test_other_shells_get_theirs(shell: str, sign: str) -> None:
    result = CliRunner().invoke(main, ["completion", shell])
    assert result.exit_code == 0 and sign in result.stdout
    assert re.search(rf"_NMES_COMPLETE={shell}_complete", result.stdout)


def test_an_unknown_shell_is_wrong_usage() -> None:
    assert CliRunner().invoke(main, ["completion", "tcsh"]).exit_code == 2
