"""The import rules are checked by import-linter (`make lint`); here, that the rules themselves catch what they must."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
from collections import Counter
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from layout import PROJECT, ROOT, lay_out

# Module, a line that it must not hold, and the contract that says so: every layer against the one above it and the
# ones beside it, then the other contracts.
VIOLATIONS = [
    ("errors.py", "from nmes import schemas", "Layers"),
    ("schemas/__init__.py", "from nmes.backend import Vector", "Layers"),
    ("schemas/__init__.py", "from nmes import protocol", "Layers"),
    ("backend/specs.py", "from nmes import schemas", "Layers"),
    ("backend/specs.py", "import nmes.protocol", "Layers"),
    ("backend/contract/base.py", "from nmes.world import World", "Layers"),
    ("protocol/messages.py", "from nmes.objective import Objective", "Layers"),
    ("protocol/messages.py", "from nmes import brain", "Layers"),
    ("objective/trajectory.py", "from nmes.protocol import parse", "Layers"),
    ("brain/base.py", "from nmes.genome import Genome", "Layers"),
    ("genome/body.py", "from nmes.world import World", "Layers"),
    ("client/client.py", "from nmes.world import World", "Layers"),
    ("client/client.py", "from nmes.genome import Genome", "Layers"),
    ("conformance/runner.py", "from nmes.world import World", "Layers"),
    ("world/world.py", "from nmes.recording import Recorder", "Layers"),
    ("world/entities.py", "def late():\n    import nmes.cli", "Layers"),
    ("recording/reader.py", "import nmes.playback.recording_replay", "Layers"),
    ("recording/reader.py", "from nmes.server import Host", "Layers"),
    ("playback/recording_replay.py", "from nmes.evaluation import evaluate", "Layers"),
    ("playback/recording_replay.py", "from nmes.server import Host", "Layers"),
    ("server/host.py", "from nmes.evaluation import evaluate", "Layers"),
    ("evaluation/task.py", "from nmes.server import Host", "Layers"),
    ("evaluation/task.py", "from nmes.view import film", "Layers"),
    ("evaluation/task.py", "from nmes.evolution import mutate", "Layers"),
    ("variation/mutation.py", "from nmes.world import World", "Layers"),
    ("evolution/run.py", "from nmes.view import film", "Layers"),
    ("evolution/run.py", "from nmes.server import Host", "Evolution knows"),
    ("view/film.py", "from nmes.cli import main", "Layers"),
    ("newcomer.py", "", "Layers"),
    ("world/world.py", "from nmes.backends.mujoco3d import MujocoBackend", "Backends are looked up"),
    ("cli/serve.py", "from nmes.backends import mujoco3d", "Backends are looked up"),
    ("backends/ballistic.py", "from nmes.world import World", "Layers"),
    ("backends/ballistic.py", "from nmes.protocol import parse", "Backends import only"),
    ("backends/ballistic.py", "from nmes.backends import mujoco3d", "Backends do not import each other"),
    ("server/host.py", "from nmes.client import Client", "Only the command line"),
    ("conformance/wire.py", "from nmes.client import Client", "The conformance suite knows"),
    ("recording/chain.py", "from nmes.world import World", "Recordings are read"),
    ("recording/recorder.py", "from nmes.world.snapshot import pack", "Recordings are read"),
    ("server/host.py", "from nmes import World", "Modules import each other"),
]


def check(layout: Path) -> subprocess.CompletedProcess[str]:
    command = [str(Path(sys.executable).parent / "lint-imports"), "--no-cache", "--no-logo"]
    environment = {**os.environ, "PYTHONPATH": str(layout)}
    return subprocess.run(command, cwd=layout, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture
def layout(tmp_path: Path) -> Path:
    """A copy of the tree as it is once installed."""
    lay_out(tmp_path, copy=True)
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def test_planted_violations_are_caught_each_by_its_rule_and_the_tree_has_none(layout: Path) -> None:
    sound = check(layout)
    assert sound.returncode == 0, sound.stdout
    expected = []
    for module, line, contract in VIOLATIONS:  # all at once: each run reads the whole tree
        path = layout / "nmes" / module
        text = (path.read_text() if path.exists() else "") + f"\n{line}\n"
        path.write_text(text)
        importer = ".".join(("nmes", *Path(module).with_suffix("").parts)).removesuffix(".__init__")
        number = len(text.splitlines())
        found = rf"- +{importer} -> [\w.]+ \([^()]*\bl\.{number}\b" if line else f"- {importer}$"
        expected.append((module, line, contract, found))
    result = check(layout)
    assert result.returncode == 1
    said = {broken.partition("\n")[0]: broken for broken in re.split(r"\n\n(?=.+\n-+\n\n)", result.stdout)}
    missed = [
        (module, line, contract)
        for module, line, contract, found in expected
        if not any(name.startswith(contract) and re.search(found, said[name], re.MULTILINE) for name in said)
    ]
    assert not missed, result.stdout


def test_every_package_is_listed_in_pyproject() -> None:
    # Automatic discovery does not work with package-dir: a package that is not listed is missing from the wheel.
    mapping = PROJECT["tool"]["setuptools"]["package-dir"]
    packages = set()
    for package, folder in mapping.items():
        for init in (ROOT / folder).rglob("__init__.py"):
            packages.add(".".join((package, *init.parent.relative_to(ROOT / folder).parts)))
    assert packages == set(PROJECT["tool"]["setuptools"]["packages"])


def test_flat_modules_of_tests_examples_and_tools_have_unique_names() -> None:
    # Their folders all lie on sys.path, where the first of two modules of one name hides the other.
    folders = PROJECT["tool"]["pytest"]["ini_options"]["pythonpath"]
    names = Counter(file.stem for folder in folders for file in (ROOT / folder).glob("*.py"))
    names.update(file.stem for file in (ROOT / "tests").rglob("test_*.py"))
    assert [name for name, count in names.items() if count > 1] == []
    assert names.keys() & (sys.stdlib_module_names | packages_distributions().keys()) == set()


def test_bare_imports_of_the_mapped_folders_are_banned(tmp_path: Path) -> None:
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    (tmp_path / "sample.py").write_text(
        '"""A sample."""\n\nimport backends.mujoco3d\nfrom cli import main\nfrom schemas import x\n'
    )
    command = [str(Path(sys.executable).parent / "ruff"), "check", "--no-cache", "--output-format=concise", "."]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.stdout.count("TID251") == 3


@pytest.mark.parametrize("folder", PROJECT["tool"]["setuptools"]["package-dir"].values())
def test_modules_and_classes_stay_small(folder: str) -> None:
    for path in (ROOT / folder).rglob("*.py"):
        text = path.read_text()
        assert len(text.splitlines()) <= 600, path
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ClassDef):
                methods = [part for part in node.body if isinstance(part, ast.FunctionDef | ast.AsyncFunctionDef)]
                assert len(methods) <= 30, f"{path}: {node.name}"
