"""The examples of CONTRIBUTING.md that add an engine and a sensor work: each is applied to a copy of the tree."""

from __future__ import annotations

import configparser
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from layout import ROOT

PAGE = (ROOT / "CONTRIBUTING.md").read_text()


def section(title: str) -> str:
    """Returns a section of the page."""
    return PAGE.partition(f"\n## {title}\n")[2].partition("\n## ")[0]


def blocks(text: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)


def apply(root: Path, diff: str) -> str:
    """Replaces the one place that a diff's old lines are at by its new lines; returns the file's path."""
    head, *lines = diff.splitlines()
    name = head.removeprefix("--- ")
    old = "\n".join(line[1:] for line in lines if line[0] in " -")
    new = "\n".join(line[1:] for line in lines if line[0] in " +")
    path = root / name
    text = path.read_text()
    assert text.count(old) == 1, f"CONTRIBUTING.md changes a line that {name} does not have once:\n{old}"
    path.write_text(text.replace(old, new))
    return name


def run(root: Path, *command: str) -> str:
    """Runs a program in the copy, with the copy's package; returns what it printed."""
    # Not from the working folder, where `nmes` lacks the folders that are mapped into it.
    environment = {**os.environ, "PYTHONPATH": str(root / "build" / "layout"), "PYTHONSAFEPATH": "1"}
    done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def register_entry_points(root: Path) -> None:
    """Makes the copy's entry points known beside its package, as installing it would."""
    groups = tomllib.loads((root / "pyproject.toml").read_text())["project"]["entry-points"]
    metadata = root / "build" / "layout" / "nmes-0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: nmes\nVersion: 0\n")
    points = configparser.ConfigParser()
    points.read_dict(groups)
    with (metadata / "entry_points.txt").open("w") as file:
        points.write(file)


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A copy of the tree."""
    junk = shutil.ignore_patterns(".*", "build", "dist", "*.egg-info", "__pycache__", "recordings", "replays")
    return Path(shutil.copytree(ROOT, tmp_path / "copy", ignore=junk))


def files_touched(text: str) -> list[str]:
    """Returns the files that a section's table says are touched."""
    return re.findall(r"^\| `([^`]+)` \|", text, flags=re.MULTILINE)


@pytest.mark.parametrize("title", ["Adding a backend", "Adding a sensor"])
def test_no_more_than_four_files_are_touched(title: str) -> None:
    assert 0 < len(files_touched(section(title))) <= 4


def test_a_backend_is_added(copy: Path) -> None:
    text = section("Adding a backend")
    changed = {apply(copy, diff) for diff in blocks(text, "diff")}
    (cp,) = [line for block in blocks(text, "console") for line in block.splitlines() if line.startswith("$ cp ")]
    _, _, source, target = shlex.split(cp)
    shutil.copy(copy / source, copy / target)
    assert changed | {target} == set(files_touched(text))
    run(copy, sys.executable, "tools/layout.py", "build/layout")
    register_entry_points(copy)
    find = "from nmes.backend import load_backend; backend = load_backend('example'); print(type(backend).__module__)"
    assert run(copy, sys.executable, "-c", find) == "nmes.backends.example\n"
    tests = ["tests/backends/test_backends.py", "tests/backends/test_capabilities.py"]
    checks = "TestExample or (capabilit and example) or row"
    output = run(copy, sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *tests, "-k", checks)
    assert re.search(r"^[3-9]\d passed", output, flags=re.MULTILINE), output


def test_a_sensor_is_added(copy: Path) -> None:
    text = section("Adding a sensor")
    changed = {apply(copy, diff) for diff in blocks(text, "diff")}
    (code,) = blocks(text, "python")
    tests = copy / "tests/world/test_creatures.py"
    tests.write_text(tests.read_text() + "\n\n" + code)
    assert changed | {"tests/world/test_creatures.py"} == set(files_touched(text))
    run(copy, sys.executable, "tools/layout.py", "build/layout")
    page = copy / "docs/messages.md"
    page.write_text(run(copy, sys.executable, "-m", "nmes.schemas"))
    assert "speed (m/s)" in page.read_text()
    files = ["tests/schemas/test_schemas.py", "tests/genome/test_genomes.py", "tests/world/test_creatures.py"]
    chosen = "reference_page or many_kinds or falling_cube_reads"
    output = run(copy, sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *files, "-k", chosen)
    assert re.search(r"^[3-9] passed", output, flags=re.MULTILINE), output
