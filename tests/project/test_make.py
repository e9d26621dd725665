"""What `make` installs, and when: seen in what it would do."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from layout import ROOT


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A folder in which nothing is installed yet."""
    for name in ("Makefile", "pyproject.toml", "setup.py", "constraints.txt"):
        shutil.copy(ROOT / name, tmp_path)
        os.utime(tmp_path / name, (1, 1))
    return tmp_path


def installs(clone: Path, target: str, *options: str) -> list[str]:
    """Returns what `make` would install for a target, a line for each call of the installer."""
    command = ["make", "--dry-run", target, *options]
    plan = subprocess.run(command, cwd=clone, capture_output=True, text=True, check=True).stdout
    return [line for line in plan.splitlines() if " install " in line]


def installed(clone: Path, *stamps: str) -> None:
    (clone / ".venv").mkdir()
    for stamp in stamps:
        (clone / ".venv" / stamp).touch()


def test_the_demo_installs_only_what_it_needs(clone: Path) -> None:
    first, second = installs(clone, "demo", "UV=")
    assert first.endswith("-c constraints.txt -q setuptools") and "python -m pip install" in first
    assert second.endswith("-c constraints.txt --no-build-isolation -e '.[film]'")


def test_the_tests_install_the_rest(clone: Path) -> None:
    assert installs(clone, "test", "UV=")[-1].endswith("-c constraints.txt --no-build-isolation -e '.[all,dev]'")
    installed(clone, ".demo-ready")
    assert len(installs(clone, "test", "UV=")) == 1


def test_nothing_is_installed_twice(clone: Path) -> None:
    installed(clone, ".demo-ready", ".ready")
    assert installs(clone, "demo", "UV=") == installs(clone, "test", "UV=") == []
    (clone / "pyproject.toml").touch()
    os.utime(clone / "pyproject.toml", (2e9, 2e9))
    assert len(installs(clone, "test", "UV=")) == 3


def test_uv_installs_where_it_is(clone: Path) -> None:
    for line in installs(clone, "test", "UV=/somewhere/uv"):
        assert line.startswith("/somewhere/uv pip install --python .venv/bin/python -c constraints.txt ")
