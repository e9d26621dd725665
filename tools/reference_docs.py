"""Writes the tables of docs/reference-cli.md, docs/reference-python.md and docs/evolution.md.

They list every command, every public name and every option of an algorithm. On the site the first two pages go on with
all that each of these says; as files, they at least list them.
"""

from __future__ import annotations

import importlib
import inspect
import math
import re
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import click

from nmes.cli import SUBCOMMANDS, main
from nmes.errors import DocumentError
from nmes.evolution.algorithms import ALGORITHMS, options_class

__all__ = ["PACKAGES", "PAGES", "commands", "names", "options", "rewrite"]

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


def options() -> Iterator[tuple[str, str, str, str, str]]:
    """Yields each option, which algorithms have it, its default, what it may be, and what it means."""
    of: dict[tuple[str, str, str, str], list[str]] = {}
    for algorithm in ALGORITHMS:
        kind = options_class(algorithm)
        meanings = _meanings(kind)
        for field in fields(kind):
            default = str(field.default).lower()
            alike = (field.name, default, _values(kind, field.name, field.default), meanings[field.name])
            of.setdefault(alike, []).append(f"`{algorithm}`")
    for (name, default, values, meaning), algorithms in of.items():
        yield name, ", ".join(algorithms), default, values, meaning


def _meanings(kind: type[Any]) -> dict[str, str]:
    """Returns what each field of a dataclass means, as its docstring and those that it inherits say."""
    meanings: dict[str, str] = {}
    for each in reversed(kind.__mro__):
        _, _, attributes = (inspect.cleandoc(vars(each).get("__doc__") or "")).partition("Attributes:\n")
        for name, words in re.findall(r"^    (\w+): ((?:.*\n?)(?:^     +.*\n?)*)", attributes, flags=re.MULTILINE):
            meanings[name] = " ".join(words.split())
    return meanings


def _values(kind: type[Any], name: str, default: object) -> str:
    """Returns what an option may be, in words: as those are refused that are beyond all bounds."""
    if isinstance(default, bool):
        return "true or false"
    try:
        kind(**{name: math.nan})
    except DocumentError as error:
        ((_, words),) = error.problems
        return words.removeprefix("must be from ").removesuffix(", not nan")
    raise AssertionError(f"{kind.__qualname__}.{name} has no bounds")


def rewrite(page: str, titles: tuple[str, ...], rows: Iterator[tuple[str, ...]]) -> str:
    """Returns a page with its table written anew, whose first column is names."""
    lines = "".join(f"| `{name}` | {' | '.join(words)} |\n" for name, *words in rows)
    head = f"| {' | '.join(titles)} |".replace("  ", " ") + f"\n|{'---|' * len(titles)}\n"
    return _TABLE.sub(lambda _: f"<!-- written by tools/reference_docs.py -->\n\n{head}{lines}\n<!-- end -->\n", page)


PAGES = {
    DOCS / "reference-cli.md": (("", ""), commands),
    DOCS / "reference-python.md": (("", ""), names),
    DOCS / "evolution.md": (("option", "of", "default", "values", "meaning"), options),
}
"""Of each page the titles of its table's columns, and what yields its rows."""

if __name__ == "__main__":
    for path, (titles, rows) in PAGES.items():
        path.write_text(rewrite(path.read_text("utf-8"), titles, rows()), "utf-8")
