"""The example programs do what they say, over TCP, and their recordings are reproduced. They run as users run them."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

import demo
from layout import ROOT
from opengl import OPENGL

# What each must measure: a range for each figure. Stated here too, so that nobody relaxes an example unseen.
AIMS = {
    "tier1_target": {"distance at the start": (7.0, 7.5), "final distance": (0.0, 0.1), "final speed": (0.0, 0.05)},
    "tier2_grid": {"hinges": (12, 12), "hop height": (0.6, 1.0), "height after landing": (0.0, 0.1)},
    "tier2_pole": {
        "swing to the left": (0.5, 2.0),
        "swing to the right": (0.5, 2.0),
        "lowest tip, of upright": (0.6, 1.0),
        "base moved by": (0.0, 1e-9),
    },
    "tier3_swarm": {
        "spread at the start": (1.1, 1.3),
        "spread once driven apart": (3.0, 5.0),
        "cubes rammed": (5, 5),
        "least knocked away": (0.2, 100.0),
    },
    "tier3_creature": {
        "motors": (5, 5),
        "strongest control": (0.7, 1.0),
        "crawled forwards": (0.8, 5.0),
        "strayed sideways": (0.0, 0.3),
    },
}


def test_all_examples_are_tested() -> None:
    assert {path.stem for path in (ROOT / "examples").glob("tier*.py")} == set(AIMS) == set(demo.EXAMPLES)


@pytest.mark.parametrize("example", AIMS)
def test_an_example_measures_what_it_says_and_is_reproduced(example: str, tmp_path: Path) -> None:
    figures, recording = demo.drive(example, tmp_path)
    assert figures["ok"], figures
    measured = {figure["name"]: figure["value"] for figure in figures["figures"]}
    assert set(measured) == set(AIMS[example])
    for name, (low, high) in AIMS[example].items():
        assert low <= measured[name] <= high, f"{name}: {measured[name]}"
    report = demo.replay(recording)
    assert report["verdict"] == "reproduced", report


def test_an_example_gives_the_same_figures_every_time(tmp_path: Path) -> None:
    runs: list[Any] = []
    for number in ("1", "2"):
        (tmp_path / number).mkdir()
        runs.append(demo.drive("tier3_swarm", tmp_path / number)[0])
    assert runs[0] == runs[1]


def test_an_example_that_misses_its_aim_says_so(tmp_path: Path) -> None:
    with demo.served(tmp_path, "--mode", "lockstep", "--backend", "ballistic") as server:
        # A controller of the wrong sign drives the cube away.
        script = "import tier1_target as t, common; t.STIFFNESS = -t.STIFFNESS; common.main(t.measure, t.__doc__)"
        options = ["--port", str(server["port"]), "--password", server["password"]]
        result = subprocess.run(
            [sys.executable, "-c", script, *options], cwd=ROOT / "examples", capture_output=True, text=True, check=False
        )
    assert result.returncode == 1
    assert "MISSED (at most 0.1)" in result.stdout


def test_an_example_without_a_server_gives_a_message() -> None:
    script = [sys.executable, str(ROOT / "examples" / "tier1_target.py"), "--port", "1", "--password", "x", "--json"]
    result = subprocess.run(script, capture_output=True, text=True, check=False)
    assert result.returncode == 1
    assert "unreachable" in result.stderr and "Traceback" not in result.stderr


@pytest.fixture(scope="module")
def demonstrated(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A folder in which the demo has run, and what it printed."""
    folder = tmp_path_factory.mktemp("demo")
    script = [sys.executable, str(ROOT / "examples" / "demo.py"), "--record", "recordings"]
    result = subprocess.run(script, cwd=folder, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    return folder, result.stdout


def test_the_demo_reproduces_everything(demonstrated: tuple[Path, str]) -> None:
    folder, output = demonstrated
    table = output.partition("measured")[2]
    assert table.count("reproduced") == len(AIMS)
    assert [line.split()[1] for line in table.splitlines() if "│ tier" in line] == demo.EXAMPLES
    recordings = [path for path in folder.rglob("*.mcap") if path.parent.name != "proofs"]  # which another test makes
    for recording in recordings:
        info = subprocess.run(
            [*demo.NMES, "info", str(recording), "--json"], capture_output=True, text=True, check=True
        )
        assert json.loads(info.stdout)
    assert len(recordings) == len(AIMS)


def test_the_demo_ends_with_a_picture_of_something(demonstrated: tuple[Path, str]) -> None:
    folder, output = demonstrated
    if not OPENGL:
        assert re.search(r"^Here no picture is drawn\. Error: .*install libegl1", output, flags=re.MULTILINE)
        return
    (name,) = re.findall(r"^The creature at its end: (\S+\.png)$", output, flags=re.MULTILINE)
    with Image.open(folder / name) as picture:
        assert picture.size == (800, 450)
        colors = picture.convert("RGB").quantize(64).histogram()
    assert max(colors) < 0.8 * 800 * 450, "it is of one colour"


def next_steps(output: str) -> list[str]:
    return [line.strip() for line in output.splitlines() if line.startswith("    ")]


def test_the_demo_ends_with_three_commands_and_the_quick_one_works(demonstrated: tuple[Path, str]) -> None:
    folder, output = demonstrated
    assert [step.split()[1] for step in next_steps(output)] == ["render", "eval", "evolve"]
    subprocess.run(next_steps(output)[1], shell=True, cwd=folder, check=True, capture_output=True)
    assert len(list(folder.glob("proofs/*.mcap"))) == 3


@pytest.mark.long
def test_the_commands_that_the_demo_ends_with_work(demonstrated: tuple[Path, str]) -> None:
    folder, output = demonstrated
    for step in next_steps(output):
        subprocess.run(step, shell=True, cwd=folder, check=True, capture_output=True)
    assert (folder / "creature.mp4").exists() and (folder / "runs/first").is_dir()


def test_a_demo_that_cannot_draw_says_so(tmp_path: Path) -> None:
    with pytest.raises(demo.Failed, match=r"render .*\(exit 2\)(.|\n)*No such file"):
        demo.draw(tmp_path / "none.mcap", tmp_path / "none.png")
