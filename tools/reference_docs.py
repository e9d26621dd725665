"""Writes the tables of docs/reference-cli.md and docs/reference-python.md: every command and every public name.

On the site both pages go on with all that each of them says; as files, they at least list them.
"""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Iterator
from pathlib import Path

import click

from nmes.cli import SUBCOMMANDS, main

__all__ = ["PACKAGES", "PAGES", "commands", "names", "rewrite"]

DOCS = Path(__file__).parent.parent / "docs"
PACKAGES = (
    *("client", "world", "genome", "brain", "objective", "evaluation", "evolution", "learning"),
    *("recording", "playback"),
)
"""The packages whose public names are listed after those at the top of `nmes`."""
_TABLE = re.compile(r"<!-- written by tools/reference_docs.py -->\n.*?<!-- end -->\n", re.DOTALL)


def commands() -> Iterator[tuple[str, str]]:
    """Yields each command that can be typed, and what it does."""
    context = click.Context(main)
    for name in SUBCOMMANDS:
        command = main.get_command(context, name)
        assert command is not None
        if isinstance(command, click.Group):
            for inner, each in command.commands.items():
                yield f"nmes {name} {inner}".strip(), each.get_short_help_str(200)
        else:
            yield f"nmes {name}", command.get_short_help_str(200)


def names() -> Iterator[tuple[str, str]]:
    """Yields each public class and function by its full name, and what it is; those at the top of `nmes` first."""
    for package in ("nmes", *(f"nmes.{name}" for name in PACKAGES)):
        module = importlib.import_module(package)
        for name in module.__all__:
            value = getattr(module, name)
            if (inspect.isclass(value) or inspect.isroutine(value)) and (package == "nmes" or not _at_top(name, value)):
                yield f"{package}.{name}", (inspect.getdoc(value) or "").split("\n")[0]


def _at_top(name: str, value: object) -> bool:
    top = importlib.import_module("nmes")
    return name in top.__all__ and getattr(top, name) is value


def rewrite(page: str, rows: Iterator[tuple[str, str]]) -> str:
    """Returns a page with its table written anew."""
    lines = "".join(f"| `{name}` | {words} |\n" for name, words in rows)
    table = f"<!-- written by tools/reference_docs.py -->\n\n| | |\n|---|---|\n{lines}\n<!-- end -->\n"
    return _TABLE.sub(lambda _: table, page)


PAGES = {DOCS / "reference-cli.md": commands, DOCS / "reference-python.md": names}

if __name__ == "__main__":
    for path, rows in PAGES.items():
        path.write_text(rewrite(path.read_text(), rows()))
