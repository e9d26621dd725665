"""The creatures that evolved and ship: recordings prove that they are better at their tasks than any made by hand."""

from __future__ import annotations

import re
from math import fsum

import pytest

from layout import ROOT
from nmes.errors import ProofError
from nmes.evaluation import Task, prove
from nmes.genome import Genome

FOLDER = ROOT / "replays" / "champions"
ROW = re.compile(r"^\| `(\w+)` \| `([\w-]+)` \| ([\d.]+)(?: m)? \| (?:`(\w+)`, ([\d.]+)(?: m)?|none) \|$", re.MULTILINE)
ROWS = ROW.findall((FOLDER / "README.md").read_text())


def test_each_has_a_recording_for_every_seed_of_its_task() -> None:
    there = {re.sub(r"-[0-9a-f]{16}", "", path.stem) for path in FOLDER.glob("*.mcap")}
    assert len(ROWS) == len(re.findall("^\\| `", (FOLDER / "README.md").read_text(), re.MULTILINE))
    assert there == {f"{name}-{task}-{seed}" for name, task, *_ in ROWS for seed in Task.load(task).seeds}


@pytest.mark.parametrize(("name", "task", "score", "other", "others"), ROWS)
def test_its_recordings_prove_the_score_of_the_genome_that_ships(
    name: str, task: str, score: str, other: str, others: str
) -> None:
    scores = []
    for path in sorted(FOLDER.glob(f"{name}-*.mcap")):
        try:
            proof = prove(path)
        except ProofError as error:
            if error.code == "not_comparable":  # on a machine that computes otherwise
                pytest.skip(error.message)
            raise
        assert proof.genome.hash == Genome.load(name).hash and proof.task.hash == Task.load(task).hash
        assert proof.result.score is not None
        scores.append(proof.result.score)
    decimals = len(score.partition(".")[2])
    assert round(fsum(scores) / len(scores), decimals) == float(score) > float(others or 0)
    assert not other or other in Genome.names()
