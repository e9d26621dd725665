"""The page of engines says what each capability promises, and which engine has it."""

from __future__ import annotations

import re
from importlib.util import find_spec

import pytest

from layout import PROJECT, ROOT
from nmes.backend import CAPABILITIES, load_backend
from opengl import OPENGL

BUILT_IN = sorted(PROJECT["project"]["entry-points"]["nmes.backends"])


def table(head: str) -> dict[str, str]:
    """Returns the rows of the table of docs/engines.md that begins with a head, as their two cells."""
    page = (ROOT / "docs" / "engines.md").read_text()
    (rows,) = re.findall(rf"^\| {re.escape(head)} \|\n\|[-|]+\n((?:\|.*\n)+)", page, flags=re.MULTILINE)
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows.splitlines()]
    names = [name.strip("`") for name, _ in cells]
    assert len(set(names)) == len(names)
    return dict(zip(names, (cell for _, cell in cells), strict=True))


def test_every_capability_has_a_meaning() -> None:
    promises = table("capability | promise")
    assert set(promises) == CAPABILITIES
    assert all(len(promise.split()) >= 2 for promise in promises.values()), promises
    assert len(set(promises.values())) == len(promises)


def test_every_built_in_engine_has_a_row() -> None:
    assert sorted(table("engine | capabilities")) == BUILT_IN


@pytest.mark.parametrize("name", BUILT_IN)
def test_an_engine_has_the_capabilities_of_its_row(name: str) -> None:
    listed = re.findall(r"`([^`]+)`", table("engine | capabilities")[name])
    assert len(set(listed)) == len(listed)
    missing = set() if find_spec("labmaze") else {"scene.arena"}  # it has no wheels for Python 3.13
    missing |= set() if OPENGL else {"camera"}
    backend = load_backend(name)
    assert backend.lacking.keys() == missing & set(listed)
    assert set(listed) - missing == backend.capabilities
