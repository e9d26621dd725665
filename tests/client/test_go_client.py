"""The Go client: as fresh as the schemas, and good by its own tests; skipped, and says so, where there is no Go."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

import go_messages
from go_programs import BUILDING, CLIENT, GO, go

STATICCHECK = shutil.which(
    "staticcheck", path=os.pathsep.join([os.environ.get("PATH", os.defpath), str(Path.home() / "go" / "bin")])
)

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
    tested = go("test", "./...")
    assert tested.returncode == 0, tested.stdout + tested.stderr


@pytest.mark.long  # all of the standard library is compiled anew for it
@pytest.mark.skipif(shutil.which("gcc") is None, reason="races are found by what a C compiler links; there is none")
def test_its_tests_have_no_race() -> None:
    tested = go("test", "-race", "./...")
    assert tested.returncode == 0, tested.stdout + tested.stderr


@pytest.mark.skipif(STATICCHECK is None, reason="staticcheck is not installed: the Go client was not judged by it")
def test_staticcheck_finds_nothing() -> None:
    assert STATICCHECK is not None and GO is not None
    path = f"{Path(GO).parent}{os.pathsep}{os.environ.get('PATH', os.defpath)}"
    checked = subprocess.run(
        [STATICCHECK, "./..."],
        cwd=CLIENT,
        env={**os.environ, "PATH": path, "GOFLAGS": "-mod=readonly", "GOPROXY": "off"},
        timeout=BUILDING,
        capture_output=True,
        text=True,
        check=False,
    )
    assert checked.returncode == 0, checked.stdout + checked.stderr
