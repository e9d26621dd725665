"""The models of the pages, in Node: their own tests, and that the command line reads what the builder makes."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest
from click.testing import CliRunner

from layout import ROOT
from nmes.cli import main
from nmes.genome import Genome

BUNDLE = ROOT / "lab" / "node_modules" / ".bin" / "esbuild"
NODES = (str(ROOT / ".venv" / "bin" / "node"), "node")
OFFENCES = ("overlap by", "reaches")  # what steps of a person may lead to, and the page tells


@pytest.fixture(scope="module")
def bundled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tests of the model, and the program that prints creatures, as Node takes them."""
    assert BUNDLE.exists(), "the packages of the lab are not there: make lab"
    out = tmp_path_factory.mktemp("bundle")
    names = ("creature.test", "creatures", "charts.test", "network.test")
    sources = [str(ROOT / "lab" / "test" / f"{name}.ts") for name in names]
    options = ["--bundle", "--platform=node", "--format=esm", "--out-extension:.js=.mjs", "--log-level=error"]
    subprocess.run([BUNDLE, *sources, *options, f"--outdir={out}"], check=True, timeout=60)
    return out


def node(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    found = next(filter(None, map(shutil.which, NODES)), None)
    assert found is not None, "Node is missing: make lab"
    return subprocess.run([found, *arguments], capture_output=True, text=True, timeout=120)


@pytest.mark.parametrize("tests", ["creature", "charts", "network"])
def test_the_model_does_what_its_tests_say(bundled: Path, tests: str) -> None:
    result = node("--test", bundled / f"{tests}.test.mjs")
    assert result.returncode == 0, result.stdout + result.stderr


def test_creatures_of_the_builder_are_good_genomes_to_the_command_line(bundled: Path, tmp_path: Path) -> None:
    result = node(bundled / "creatures.mjs", "1")
    assert result.returncode == 0, result.stderr
    files = []
    for line in result.stdout.splitlines():
        files.append(tmp_path / f"{json.loads(line)['name']}.json")
        files[-1].write_text(line)
    rows = json.loads(CliRunner().invoke(main, ["genome", "check", "--json", *map(str, files)]).output)
    assert len(rows) == len(files) > 40
    for file, row in zip(files, rows, strict=True):
        problems = [problem["message"] for problem in row["problems"]]
        if file.stem.startswith("drawn-"):
            assert all(any(offence in problem for offence in OFFENCES) for problem in problems), (file.stem, problems)
        else:
            assert problems == [], file.stem
    assert sum(not row["problems"] for row in rows) > 12


def test_twins_of_the_builder_are_mirror_images(bundled: Path) -> None:
    quadruped = json.loads(node(bundled / "creatures.mjs").stdout.splitlines()[1])
    body = Genome(quadruped).body
    places = {cube.id: cube.position for cube in body.cubes}
    for name in ("leg", "leg2"):
        x, y, z = places[name]
        assert places[f"{name}.mirror"] == (x, y, -z)
