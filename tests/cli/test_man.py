"""Manual pages: one a command, with all that its --help says."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Iterator

import click
import pytest

from layout import ROOT
from nmes.cli import SUBCOMMANDS, main


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("man")
    subprocess.run([sys.executable, str(ROOT / "tools" / "man.py"), str(folder)], check=True)
    return {path.stem: path.read_text() for path in folder.glob("*.1")}


def commands(group: click.Group, name: str) -> Iterator[tuple[str, click.Command]]:
    for inner in group.list_commands(click.Context(group)):
        command = group.get_command(click.Context(group), inner)
        assert command is not None
        yield f"{name}-{inner}".strip("-"), command
        if isinstance(command, click.Group):
            yield from commands(command, f"{name}-{inner}")


def test_every_command_has_a_page_with_its_options(pages: dict[str, str]) -> None:
    found = dict(commands(main, "nmes"))
    assert pages.keys() == {"nmes", *(name for name in found)}
    for name, command in found.items():
        for parameter in command.params:
            if isinstance(parameter, click.Option) and not parameter.hidden:
                assert parameter.opts[-1].replace("-", r"\-") in pages[name], (name, parameter.opts)


def test_the_first_page_lists_the_commands_in_whole_sentences(pages: dict[str, str]) -> None:
    for name, about in SUBCOMMANDS.items():
        assert f"\\fB{name}\\fP\n  {about}\n" in pages["nmes"]
        assert f"\\- {about}\n" in pages[f"nmes-{name}"]


def test_what_runs_begin_with_is_on_the_page_of_the_group(pages: dict[str, str]) -> None:
    assert r"\-\-budget" in pages["nmes-evolve"] and r"\-\-steps" in pages["nmes-learn"]


def test_examples_keep_their_lines(pages: dict[str, str]) -> None:
    (examples,) = re.findall(r"^\.nf\n(.*?)^\.fi$", pages["nmes-render"], flags=re.DOTALL | re.MULTILINE)
    assert len(examples.split("nmes render ")) > 3 and "\b" not in "".join(pages.values())


@pytest.mark.skipif(shutil.which("groff") is None, reason="there is no groff")
def test_the_pages_are_sound_for_groff(pages: dict[str, str]) -> None:
    # At this width no table or word is too long; each dot at the beginning of a line would be a request.
    result = subprocess.run(
        ["groff", "-man", "-Tutf8", "-ww", "-rLL=200n", "-"],
        input="\n".join(pages.values()),
        capture_output=True,
        text=True,
        check=True,
    )
    assert result.stderr == ""
