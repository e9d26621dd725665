"""The page that says which client has what names only what is there."""

from __future__ import annotations

import re
from importlib import import_module
from typing import Any

import pytest

from layout import ROOT

PAGE = ROOT / "docs" / "clients.md"
GO, TYPESCRIPT = ROOT / "clients" / "go", ROOT / "clients" / "typescript" / "src"


def rows() -> list[list[list[str]]]:
    """Returns the names in each cell of the table, by rows: Python, Go, TypeScript in Node, in a browser."""
    lines = [line for line in PAGE.read_text().splitlines() if line.startswith("|")][2:]
    return [[re.findall(r"`([^`]+)`", cell) for cell in line.strip("|").split("|")[1:]] for line in lines]


def named(column: int) -> list[str]:
    return sorted({name for row in rows() for name in row[column]})


def test_every_row_has_a_cell_for_each_client() -> None:
    assert len(rows()) > 15 and {len(row) for row in rows()} == {4}


@pytest.mark.parametrize("name", [name for name in named(0) if not name.startswith("nmes ")])
def test_python_has_what_is_named(name: str) -> None:
    parts = name.split(".")
    thing: Any = import_module(parts[0])
    for end, part in enumerate(parts[1:], start=2):
        thing = getattr(thing, part) if hasattr(thing, part) else import_module(".".join(parts[:end]))


@pytest.mark.parametrize("name", named(1))
def test_go_has_what_is_named(name: str) -> None:
    package, _, rest = name.rpartition(".")
    receiver = r"\(c \*?Client\) " if package == "Client" else ""
    folder = GO / package if package and package != "Client" else GO
    sources = "\n".join(path.read_text() for path in folder.glob("*.go") if not path.name.endswith("_test.go"))
    assert re.search(rf"^(func {receiver}|type ){rest}\b", sources, flags=re.MULTILINE)


@pytest.mark.parametrize("name", sorted({*named(2), *named(3)}))
def test_typescript_has_what_is_named(name: str) -> None:
    sources = "\n".join(path.read_text() for path in TYPESCRIPT.glob("*.ts"))
    member = rf"^  (?:override |async |\*|async \*)*{name}(<.*>)?\("
    assert re.search(rf"^export (async )?(function|class) {name}\b|{member}", sources, flags=re.MULTILINE)
