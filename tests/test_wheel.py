"""The wheel, installed elsewhere, holds all that it needs: it serves, is driven, records, and replays."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

from layout import PROJECT, ROOT

# Run by the new environment's Python: imports all of nmes, and prints where it lies and what it made Python load.
IMPORT_ALL = """
import importlib, json, pkgutil, sys
import nmes
names = [module.name for module in pkgutil.walk_packages(nmes.__path__, "nmes.")]
for name in names:
    importlib.import_module(name)
files = [module.__file__ for module in list(sys.modules.values()) if getattr(module, "__file__", None)]
print(json.dumps({"modules": ["nmes", *names], "root": nmes.__file__, "files": files}))
"""

DRIVE = """
import sys
import nmes
with nmes.Client(port=int(sys.argv[1]), password="wheel") as client:
    name = client.spawn_cube(position=[0, 2, 0])["spawned"]
    client.apply_physics(name, impulse=[1, 0, 0])
    client.step(ticks=60)
    print(client.get_cube_info(name)["position"][0])
"""


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The `bin` folder of a virtual environment that has the wheel, and sees the other packages of this one.

    Paths that a .pth file adds are not searched for .pth files, so the editable install of this environment is not
    among them: what is imported as nmes comes from the wheel.
    """
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    junk = shutil.ignore_patterns(".*", "build", "dist", "*.egg-info", "__pycache__", "recordings")
    shutil.copytree(ROOT, source, ignore=junk)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    build = [*pip, "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", str(folder), str(source)]
    subprocess.run(build, check=True)
    (wheel,) = folder.glob("nmes-*.whl")
    shutil.rmtree(source)
    home = folder / "environment"
    venv.create(home, with_pip=False)
    python = home / "bin" / "python"
    subprocess.run([*pip, "--python", str(python), "install", "-q", "--no-deps", str(wheel)], check=True)
    (packages,) = home.glob("lib/python3*/site-packages")
    (packages / "elsewhere.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return python.parent


def run(environment: Path, *command: str, cwd: Path) -> str:
    """Runs a program of the new environment, away from the tree; returns what it printed."""
    done = subprocess.run(
        [str(environment / command[0]), *command[1:]], cwd=cwd, capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def imported(environment: Path) -> dict[str, object]:
    found: dict[str, object] = json.loads(run(environment, "python", "-I", "-c", IMPORT_ALL, cwd=environment))
    return found


def test_every_module_is_in_the_wheel(environment: Path, imported: dict[str, object]) -> None:
    assert str(imported["root"]).startswith(str(environment.parent))
    expected = set()
    for package, folder in PROJECT["tool"]["setuptools"]["package-dir"].items():
        for file in (ROOT / folder).rglob("*.py"):
            parts = file.relative_to(ROOT / folder).with_suffix("").parts
            expected.add(".".join((package, *(part for part in parts if part != "__init__"))))
    assert set(imported["modules"]) == expected  # type: ignore[call-overload]


def test_the_base_install_names_all_that_is_imported(imported: dict[str, object]) -> None:
    # The new environment sees the packages of this one, the extras and the tools too: those must not be needed.
    needed = closure("nmes")
    packages = Path(sysconfig.get_path("purelib"))
    from importlib.metadata import packages_distributions

    owners = packages_distributions()
    for file in imported["files"]:  # type: ignore[attr-defined]
        if Path(file).is_relative_to(packages):
            top = Path(file).relative_to(packages).parts[0].split(".")[0]
            if top in owners:
                assert {normal(owner) for owner in owners[top]} & needed, f"{file} belongs to no declared dependency"


def closure(distribution: str) -> set[str]:
    """Returns the names of all distributions that a plain install of one brings."""
    from importlib.metadata import PackageNotFoundError, requires

    from packaging.requirements import Requirement

    found: set[str] = set()
    todo = [(distribution, frozenset[str]())]
    while todo:
        name, extras = todo.pop()
        if normal(name) in found and not extras:
            continue
        found.add(normal(name))
        try:
            lines = requires(name) or []
        except PackageNotFoundError:
            continue
        for requirement in map(Requirement, lines):
            marker = requirement.marker
            if marker is None or any(marker.evaluate({"extra": extra}) for extra in ("", *extras)):
                if normal(requirement.name) not in found:
                    todo.append((requirement.name, frozenset(requirement.extras)))
    return found


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def test_an_installed_wheel_serves_and_replays(environment: Path, tmp_path: Path) -> None:
    command = [str(environment / "nmes"), "serve", "--json", "--port", "0", "--mode", "lockstep"]
    variables = {**os.environ, "NMES_PASSWORD": "wheel"}
    server = subprocess.Popen(command, cwd=tmp_path, env=variables, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    try:
        ready = json.loads(server.stdout.readline())
        moved = run(environment, "python", "-I", "-c", DRIVE, str(ready["port"]), cwd=tmp_path)
    finally:
        server.send_signal(signal.SIGTERM)
        server.communicate(timeout=30)
    assert server.returncode == 0
    assert float(moved) > 0.1
    assert "reproduced" in run(environment, "nmes", "replay", ready["recording"], cwd=tmp_path)
