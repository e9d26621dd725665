"""Writes a manual page for each command, from what its --help says: `python tools/man.py FOLDER`, then `man -l`."""

from __future__ import annotations

import inspect
import re
import sys
from pathlib import Path

import click
from click_man.core import write_man_pages

import nmes
from nmes.cli import SUBCOMMANDS, main


def write_all(folder: Path) -> None:
    """Writes `nmes.1`, `nmes-serve.1`, `nmes-evolve-best.1` and so on, over what is there."""
    folder.mkdir(parents=True, exist_ok=True)
    pages = click.Group("nmes", help=main.help, params=main.params)
    for name in SUBCOMMANDS:  # which `main` loads one at a time
        command = main.get_command(click.Context(main), name)
        assert command is not None
        pages.add_command(command)
    prepare(pages)
    write_man_pages("nmes", pages, version=nmes.__version__, target_dir=str(folder))


def prepare(command: click.Command) -> None:
    """Gives a command, and those in it, what the pages are to say of it."""
    if isinstance(command, click.Group):
        if "" in command.commands:  # what is done where no subcommand is named
            nameless = command.commands[""]
            command.help, command.subcommand_metavar = nameless.help, "WHAT... | COMMAND [ARGS]..."
            command.params = [each for each in nameless.params if isinstance(each, click.Option)]
        for inner in command.commands.values():
            prepare(inner)
    command.short_help = command.get_short_help_str(1000)
    # To roff a dot or an apostrophe that begins a line is a request; examples stay as lines, by a mark of click's here.
    text = re.sub(r"^(?=[.'])", r"\&", inspect.cleandoc(command.help or ""), flags=re.MULTILINE)
    command.help = re.sub(r"^\x08\n((?:.+\n?)+)", r".nf\n\1\n.fi\n", text, flags=re.MULTILINE)


if __name__ == "__main__":
    write_all(Path(sys.argv[1]))
