"""Examples that train with torch end with a genome that is scored. They are skipped where torch is missing."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from layout import ROOT
from processes import NMES

EXAMPLES = {"train_sb3_ppo": 8192, "train_sb3_sac": 300, "train_cleanrl_ppo": 8192}


def test_all_examples_that_train_are_tested() -> None:
    assert {path.stem for path in (ROOT / "examples").glob("train_*.py")} == set(EXAMPLES)


PLAYED = """
import runpy, sys
from unittest.mock import MagicMock
sys.modules |= {name: MagicMock() for name in PACKAGES}
runpy.run_path(sys.argv.pop(1), run_name="__main__")
"""
PACKAGES = [
    *("torch", "torch.nn", "torch.nn.functional", "torch.distributions", "sb3_rows", "stable_baselines3"),
    *("stable_baselines3.common", "stable_baselines3.common.vec_env", "nmes.learning.stable_baselines"),
]


@pytest.mark.parametrize("example", EXAMPLES)
def test_a_folder_that_is_not_there_is_told_before_anything_is_trained(example: str, tmp_path: Path) -> None:
    program = f"PACKAGES = {PACKAGES}\n{PLAYED}"
    script, output = str(ROOT / "examples" / f"{example}.py"), str(tmp_path / "nowhere" / "g.json")
    process = subprocess.run([sys.executable, "-c", program, script, "-o", output], capture_output=True, text=True)
    assert process.returncode == 2 and f"there is no folder {tmp_path / 'nowhere'}" in process.stderr, process.stderr


@pytest.mark.long
@pytest.mark.parametrize("example", EXAMPLES)
def test_an_example_that_trains_ends_with_a_genome_that_is_scored(example: str, tmp_path: Path) -> None:
    for package in ("torch", *(["stable_baselines3"] if "sb3" in example else [])):
        pytest.importorskip(package, reason=f"{package} is not installed: pip install 'nmes[rl]'")
    arguments = ["--genome", "walker", "--task", "walk", "--steps", str(EXAMPLES[example]), "-o", tmp_path / "g.json"]
    script = [sys.executable, str(ROOT / "examples" / f"{example}.py"), *map(str, arguments)]
    process = subprocess.run(script, capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
    last = process.stdout.splitlines()[-1]
    assert last.startswith(f"wrote {tmp_path / 'g.json'}, which scores ")
    evaluated = subprocess.run([NMES, "eval", str(tmp_path / "g.json"), "--json"], capture_output=True, text=True)
    (evaluation,) = json.loads(evaluated.stdout)
    assert evaluation["score"] == float(last.rpartition(" ")[2])
    assert json.loads((tmp_path / "g.json").read_text())["brain"]["kind"] == "mlp"
