"""The source distribution is the whole repository; the wheel made of it, installed elsewhere, holds all that it needs:
it serves, is driven, records, and replays."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import venv
from email import message_from_string
from importlib.metadata import distribution, distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from layout import PROJECT, ROOT

# Run by the new environment's Python: imports all of nmes, and prints where it lies.
IMPORT_ALL = """
import importlib, json, pkgutil
import nmes
names = [module.name for module in pkgutil.walk_packages(nmes.__path__, "nmes.")]
without = {}
for name in names:
    if not name.rpartition(".")[2].startswith("test_"):  # pytest comes with who wants to run those
        try:
            importlib.import_module(name)
        except ModuleNotFoundError as error:
            without[name] = error.name
print(json.dumps({"modules": ["nmes", *names], "without": without, "root": nmes.__file__}))
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


JUNK = (".*", "build", "dist", "*.egg-info", "__pycache__", "recordings", "node_modules")


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of an unpacked source distribution."""
    folder = tmp_path_factory.mktemp("sdist")
    source = folder / "source"
    shutil.copytree(ROOT, source, ignore=shutil.ignore_patterns(*JUNK))
    build = f"from setuptools import build_meta; build_meta.build_sdist({str(folder)!r})"
    subprocess.run([sys.executable, "-c", build], cwd=source, check=True, capture_output=True)
    shutil.rmtree(source)
    (archive,) = folder.glob("nmes-*.tar.gz")
    # Python's own way to unpack asks for a filter, which Python 3.11.3 and older do not know.
    subprocess.run(["tar", "-xzf", archive], cwd=folder, check=True)
    return folder / archive.name.removesuffix(".tar.gz")


@pytest.fixture(scope="module")
def environment(unpacked: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The `bin` folder of a virtual environment that has the wheel and what a plain install of it brings, no more.

    The wheel is built from the source distribution. Dependencies are links to this environment's, so that nothing is
    fetched; nmes itself comes from the wheel.
    """
    folder = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    build = [*pip, "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", str(folder), str(unpacked)]
    subprocess.run(build, check=True)
    (wheel,) = folder.glob("nmes-*.whl")
    home = folder / "environment"
    venv.create(home, with_pip=False)
    python = home / "bin" / "python"
    subprocess.run([*pip, "--python", str(python), "install", "-q", "--no-deps", str(wheel)], check=True)
    (packages,) = home.glob("lib/python3*/site-packages")
    for dependency in dependencies():
        installed = distribution(dependency)
        for entry in {file.parts[0] for file in installed.files or () if file.parts[0] not in ("..", "__pycache__")}:
            if not (packages / entry).exists():
                (packages / entry).symlink_to(str(installed.locate_file(entry)))
    return python.parent


def dependencies() -> set[str]:
    """Returns the distributions that a plain install brings, as pyproject.toml and they themselves declare it."""
    names: set[str] = set()
    todo = [(Requirement(line), "") for line in PROJECT["project"]["dependencies"]]
    while todo:
        requirement, extra = todo.pop()
        if requirement.marker is None or requirement.marker.evaluate({"extra": extra}):
            name = normal(requirement.name)
            if name not in names or requirement.extras:
                names.add(name)
                lines = distribution(name).requires or []
                todo += [(Requirement(line), extra) for line in lines for extra in ("", *requirement.extras)]
    return names


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def run(environment: Path, *command: str, cwd: Path) -> str:
    """Runs a program of the new environment, away from the tree; returns what it printed."""
    result = subprocess.run(
        [str(environment / command[0]), *command[1:]], cwd=cwd, capture_output=True, text=True, check=False, timeout=60
    )
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="only a clone knows which files are the repository's")
def test_a_source_distribution_has_every_file(unpacked: Path) -> None:
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    files = [name for name in tracked.splitlines() if not name.startswith(".") and (ROOT / name).exists()]
    assert len(files) > 500
    assert [name for name in files if not (unpacked / name).is_file()] == []


def test_a_source_distribution_knows_its_version(unpacked: Path) -> None:
    (found,) = distributions(name="nmes", path=[str(unpacked)])
    assert found.version == PROJECT["project"]["version"]
    assert "nmes" in {entry.name for entry in found.entry_points}


def test_tests_of_a_source_distribution_run_in_it(unpacked: Path) -> None:
    result = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/schemas/test_documents.py"],
        cwd=unpacked,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stdout
    assert re.search(r"^\d{2,} passed in", result.stdout, flags=re.MULTILINE)


def test_the_packaged_readme_has_no_relative_links_and_all_else(unpacked: Path) -> None:
    described = (unpacked / "PKG-INFO").read_text().partition("\n\n")[2]
    readme = (ROOT / "README.md").read_text()
    targets = re.findall(r"\]\(([^)]*)\)", described)
    assert targets and [target for target in targets if "://" not in target] == []
    assert described.startswith("# NMES\n") and "![" not in described
    blocks = re.compile(r"^```.*?^```", flags=re.DOTALL | re.MULTILINE)
    assert blocks.findall(described) == blocks.findall(readme)
    assert headings(described) == headings(readme)


def headings(text: str) -> list[str]:
    return re.findall(r"^#+ .*", text, flags=re.MULTILINE)


def test_the_metadata_says_who_what_and_for_which_pythons(unpacked: Path) -> None:
    fields = message_from_string((unpacked / "PKG-INFO").read_text())
    assert fields["License-Expression"] == "Apache-2.0"
    assert fields["Author"] and fields["Keywords"] and fields["Description-Content-Type"] == "text/markdown"
    citation = (ROOT / "CITATION.cff").read_text().splitlines()
    assert f"version: {fields['Version']}" in citation and f"license: {fields['License-Expression']}" in citation
    assert f"  - name: {fields['Author']}" in citation
    classifiers = fields.get_all("Classifier", [])
    pythons = [name.rpartition(" ")[2] for name in classifiers if re.search(r"Python :: 3\.", name)]
    install = (ROOT / "docs" / "install.md").read_text()
    assert pythons == re.findall(r"^\| (3\.\d+) \|", install, flags=re.MULTILINE)


def test_every_module_is_in_the_wheel_and_can_be_imported(environment: Path, tmp_path: Path) -> None:
    installed = json.loads(run(environment, "python", "-I", "-c", IMPORT_ALL, cwd=tmp_path))
    assert Path(installed["root"]).is_relative_to(environment.parent)
    expected = set()
    for package, folder in PROJECT["tool"]["setuptools"]["package-dir"].items():
        for file in (ROOT / folder).rglob("*.py"):
            parts = file.relative_to(ROOT / folder).with_suffix("").parts
            expected.add(".".join((package, *(part for part in parts if part != "__init__"))))
    assert set(installed["modules"]) == expected
    # Classes of environments are those of packages that an extra brings, dm_env with dm-control too where there are
    # wheels of that; nothing else may miss anything.
    assert set(installed["without"].values()) <= {"gymnasium", "pettingzoo", "dm_env"}
    assert all(name.startswith(("nmes.learning.", "nmes.measure.")) for name in installed["without"])
    assert "nmes.learning.run" not in installed["without"]


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
