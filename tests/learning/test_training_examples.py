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
