"""`nmes doctor`: each thing that can be wrong is made wrong once, in a process of its own."""

from __future__ import annotations

import json
import os
import socket
import subprocess
from pathlib import Path

import pytest

from nmes.backend import load_backend
from nmes.backend.probe import probe
from opengl import OPENGL
from processes import NMES

Findings = dict[str, dict[str, str]]

BLIND = [] if OPENGL else ["graphics"]
"""What is wrong with this machine itself."""


def examine(*options: str, cwd: Path | str, shell: str = "", **environment: str) -> tuple[int, Findings]:
    """Runs `nmes doctor --json`; returns its exit status, and the findings by name."""
    command = ["bash", "-c", f'{shell}exec "$0" "$@"', NMES, "doctor", "--json", *options]
    result = subprocess.run(command, cwd=cwd, env={**os.environ, **environment}, capture_output=True, text=True)
    assert "Traceback" not in result.stderr, result.stderr
    return result.returncode, {finding["name"]: finding for finding in json.loads(result.stdout)}


@pytest.fixture
def plant(tmp_path: Path) -> dict[str, str]:
    """Variables that make Python run `sitecustomize.py` in the test's folder when it starts."""
    return {"PYTHONPATH": str(tmp_path)}


def wrong(findings: Findings) -> list[str]:
    return [name for name, finding in findings.items() if finding["status"] == "wrong"]


def test_where_all_is_well_nothing_is_wrong(tmp_path: Path) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        free = other.getsockname()[1]
    status, findings = examine("--port", str(free), cwd=tmp_path)
    assert (status, wrong(findings)) == (1 if BLIND else 0, BLIND)
    assert findings[f"port {free}"]["status"] == "ok"
    assert findings["probe of mujoco"]["value"] == probe(load_backend("mujoco"))
    assert findings["engine pymunk"]["value"] == load_backend("pymunk").version()
    assert "film" in findings["extras"]["value"]
    assert BLIND or findings["graphics"]["value"].startswith("OpenGL through ")
    assert {"nmes", "python", "arenas", "this folder", "temporary folder", "open files"} <= findings.keys()


def test_a_table_shows_the_same_and_a_port_that_is_taken_is_a_note(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        result = subprocess.run(
            [NMES, "doctor", "--port", port], cwd=tmp_path, capture_output=True, text=True, check=not BLIND
        )
    lines = [line.split() for line in result.stdout.splitlines()]
    assert ["ok", "engine", "mujoco", load_backend("mujoco").version()] in lines
    (at,) = [index for index, line in enumerate(lines) if line[:3] == ["note", "port", port]]
    assert "--port 0" in " ".join(lines[at + 1])


LACKING = """
import math, os, sys
sys.modules |= {'mujoco.egl': None, 'mujoco.osmesa': None, 'labmaze': None}
math.cbrt = lambda x: x + os.getpid()
if os.environ.pop('PLANT', None):  # not in the processes that importing mujoco starts
    import mujoco
    mujoco.__version__ = '4.0.0'
"""


def test_what_a_machine_lacks_or_gets_wrong_is_told(tmp_path: Path, plant: dict[str, str]) -> None:
    (tmp_path / "sitecustomize.py").write_text(LACKING)
    status, findings = examine(cwd="/proc", shell="ulimit -n 200; ", PLANT="1", **plant)  # where nobody may write
    probes = [f"probe of {name}" for name in ("ballistic", "mujoco", "pymunk")]
    assert (status, wrong(findings)) == (1, ["engine mujoco", *probes, "graphics", "this folder"])
    assert "issue 3767" in findings["engine mujoco"]["value"] and "install" in findings["engine mujoco"]["hint"]
    assert "in another process" in findings["probe of mujoco"]["value"]
    assert "no OpenGL" in findings["graphics"]["value"]
    assert findings["arenas"]["status"] == findings["open files"]["status"] == "note"
    assert findings["open files"]["value"] == "at most 200"


def test_files_of_the_working_folder_are_not_in_the_way(tmp_path: Path) -> None:
    (tmp_path / "random.py").write_text("raise RuntimeError('not yours')")
    (tmp_path / "nmes").mkdir()
    (tmp_path / "nmes" / "__init__.py").write_text("raise RuntimeError('not yours')")
    _, findings = examine(cwd=tmp_path)
    assert wrong(findings) == BLIND


NO_CHILD = """
import os, sys
if any("take_probes" in word for word in sys.orig_argv):
    os.write(2, b"no such luck\\nno room for \\x1b[31mmore\\n")
    os._exit(3)
"""


def test_a_process_that_does_not_begin_is_told_with_what_it_said(tmp_path: Path, plant: dict[str, str]) -> None:
    (tmp_path / "sitecustomize.py").write_text(NO_CHILD)
    status, findings = examine(cwd=tmp_path, **plant)
    assert (status, wrong(findings)) == (1, ["another process", *BLIND])
    assert findings["another process"]["value"] == r"ended with status 3: no room for \x1b[31mmore"
    assert findings["probe of mujoco"] == {
        "name": "probe of mujoco",
        "status": "ok",
        "value": probe(load_backend("mujoco")),
        "hint": "",
    }


HIDE = """
import importlib.metadata as m
version = m.version
def hidden(name):
    if name in ("mcap", "av"): raise m.PackageNotFoundError(name)
    return version(name)
m.version = hidden
"""
ENGINES = """
from nmes.backends.ballistic import BallisticBackend
def exiting(): raise SystemExit(3)
class Dividing(BallisticBackend):
    def create(self, scene): 1 / 0
"""


def install(folder: Path, source: str, *names: str) -> None:
    """Installs engines of a module in a folder."""
    package = folder / "odd_engines-1.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: odd-engines\nVersion: 1\n")
    lines = [f"{name} = odd_engines:{name}" for name in names]
    (package / "entry_points.txt").write_text("\n".join(["[nmes.backends]", *lines, ""]))
    (folder / "odd_engines.py").write_text(source)


def test_engines_that_break_and_packages_that_are_missing_are_wrong(tmp_path: Path, plant: dict[str, str]) -> None:
    (tmp_path / "sitecustomize.py").write_text(HIDE)
    install(tmp_path, ENGINES, "Absent", "Dividing", "exiting")
    status, findings = examine(cwd=tmp_path, **plant)
    assert status == 1
    assert wrong(findings) == ["packages", "engine Absent", "engine exiting", "probe of Dividing", *BLIND]
    assert "cannot be loaded" in findings["engine Absent"]["value"]
    assert "SystemExit: 3" in findings["engine exiting"]["value"]
    assert "ZeroDivisionError" in findings["probe of Dividing"]["value"]
    assert findings["packages"]["hint"] == "pip install mcap"
    assert "film" not in findings["extras"]["value"] and "film" in findings["extras"]["hint"]


TALKING = """
import atexit, os
from nmes.backends.ballistic import BallisticBackend
class Talking(BallisticBackend): pass
print("my engine 1.0")
os.write(1, b"of a library\\n")
atexit.register(print, "goodbye")
"""


def test_what_an_engine_prints_is_not_taken_for_its_probe(tmp_path: Path, plant: dict[str, str]) -> None:
    install(tmp_path, TALKING, "Talking")
    command = [NMES, "doctor", "--port", "1"]
    result = subprocess.run(command, cwd=tmp_path, env={**os.environ, **plant}, capture_output=True, text=True)
    assert result.stderr == "" and "my engine 1.0" in result.stdout
    lines = [line.split() for line in result.stdout.splitlines()]
    assert ["ok", "probe", "of", "Talking", probe(load_backend("ballistic"))] in lines
