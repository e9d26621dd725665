"""A stranger's engine, in a distribution of its own: installed, listed, held to the contract, served and replayed."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from layout import ROOT
from nmes import Client
from servers import PATIENCE

NMES = str(Path(sys.executable).parent / "nmes")
SOURCE = ROOT / "examples" / "example-backend"

BROKEN = """
[nmes.backends]
broken = nmes_broken:Engine
quitter = nmes_quitter:Engine
stranger = json:JSONDecoder
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that holds the example's distribution, as pip installs it, and three that do not work."""
    folder = tmp_path_factory.mktemp("installed")
    copy = shutil.copytree(SOURCE, tmp_path_factory.mktemp("source") / "example")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "-q", "--no-deps"]
    subprocess.run([*pip, "--no-build-isolation", "--target", str(folder), str(copy)], check=True, timeout=PATIENCE)
    metadata = folder / "broken_engines-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: broken-engines\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(BROKEN)
    (folder / "nmes_broken.py").write_text("import an_engine_that_is_not_there\n")
    (folder / "nmes_quitter.py").write_text("raise SystemExit('no licence')\n")
    return folder


@pytest.fixture(scope="module")
def environment(installed: Path) -> Mapping[str, str]:
    return {**os.environ, "PYTHONPATH": str(installed), "NMES_PASSWORD": "moon"}


def run(environment: Mapping[str, str], *command: str, cwd: Path | None = None) -> str:
    done = subprocess.run(
        command, capture_output=True, text=True, env=environment, cwd=cwd, check=False, timeout=PATIENCE
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_example_engine_is_listed_and_broken_engines_say_why(environment: Mapping[str, str]) -> None:
    listed = {row["name"]: row for row in json.loads(run(environment, NMES, "backends", "--json"))}
    assert list(listed) == sorted(listed)
    assert {"ballistic", "mujoco", "pymunk", "example"} <= set(listed)
    assert listed["example"] == {
        "name": "example",
        "version": "0.1.0",
        "dims": 2,
        "capabilities": [],
        "defect": None,
        "package": "nmes-example-backend 0.1.0",
        "error": None,
    }
    assert "an_engine_that_is_not_there" in listed["broken"]["error"]
    assert "pip install broken-engines" in listed["broken"]["error"]
    assert "no licence" in listed["quitter"]["error"]
    assert "not an nmes Backend" in listed["stranger"]["error"]
    table = run({**environment, "COLUMNS": "200"}, NMES, "backends")
    for name, row in listed.items():
        (line,) = re.findall(rf"^{name} .*$", table, flags=re.MULTILINE)
        assert (row["version"] or "cannot be loaded") in line


def test_the_example_engine_keeps_the_contract(environment: Mapping[str, str]) -> None:
    output = run(environment, sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(SOURCE))
    assert re.search(r"^\d\d passed", output, flags=re.MULTILINE), output


def test_the_example_engine_is_served_recorded_and_replayed(environment: Mapping[str, str], tmp_path: Path) -> None:
    command = [NMES, "serve", "--port", "0", "--json", "--backend", "example", "--mode", "lockstep"]
    with subprocess.Popen(
        [*command, "--record", str(tmp_path)], env=environment, stdout=subprocess.PIPE, text=True
    ) as server:
        try:
            assert server.stdout is not None
            ready = json.loads(server.stdout.readline())
            assert ready["backend"] == "example"
            with Client(port=ready["port"], password="moon") as client:
                name = client.spawn_cube(position=[0, 5, 3])["spawned"]
                client.apply_physics(name, impulse=[2, 0, 0])
                client.step(ticks=120)
                x, y, z = client.get_cube_info(name)["position"]
                assert x == pytest.approx(4.0)
                assert z == 0.0
                assert y == pytest.approx(0.5)
            server.send_signal(signal.SIGTERM)
            assert server.wait(PATIENCE) == 0
        finally:
            server.kill()
    output = run(environment, NMES, "replay", ready["recording"])
    assert output.startswith("reproduced: 120 ticks"), output
