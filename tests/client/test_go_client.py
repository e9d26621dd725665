"""The Go client: as fresh as the schemas, and good by its own tests; skipped, and says so, where there is no Go."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

import go_messages
from go_programs import CLIENT, GO, go

pytestmark = pytest.mark.skipif(GO is None, reason="Go is not installed: the Go client was not built and not run")


def test_its_messages_are_those_of_the_schemas(monkeypatch: pytest.MonkeyPatch) -> None:
    assert GO is not None
    monkeypatch.setenv("PATH", str(Path(GO).parent), prepend=os.pathsep)
    assert go_messages.PATH.read_text() == go_messages.written(), "run make clients"


def test_it_needs_the_standard_library_only() -> None:
    assert "require" not in (CLIENT / "go.mod").read_text() and not (CLIENT / "go.sum").exists()


def test_it_is_good_by_its_own_tests() -> None:
    vetted = go("vet", "./...")
    assert vetted.returncode == 0, vetted.stderr
    race = ["-race"] if shutil.which("gcc") else []  # the detector is linked by a C compiler
    tested = go("test", *race, "./...")
    assert tested.returncode == 0, tested.stdout + tested.stderr
