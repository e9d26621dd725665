"""A small study for tests: two arms, of which one swings and the other does not, three seeds, seconds to run."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

__all__ = ["DISCUSSION", "STUDY", "make_bare_study", "make_study"]

STUDY = """\
format = "nmes-study/1"
title = "A small study"
question = "Does who swings get farther?"

[[claims]]
name = "farther"
says = "It gets farther."
place = "nowhere"
for = "Who swings is mostly better."
against = "Who swings is mostly worse."
holds = 'low("gain") > 0.5'
refuted = 'high("gain") < 0.5'

[[claims]]
name = "open"
says = "It is hard to tell."
place = "nowhere"
for = "Never."
against = "Never."
holds = 'gain > 2'
refuted = 'gain < -2'
partly = 'gain < -1'

[settings]
task = "{study}/slide.json"

[commands]
score = "nmes eval {study}/{genome}.json --task {task} --seeds {seed} --jobs 1 --json --quiet"

[columns]
score = "score /0/score"
hash = "score /0/genome_hash"

[[arms]]
name = "swinging"
about = "It swings."
settings = { genome = "swinging" }

[[arms]]
name = "still"
about = "It does not."
settings = { genome = "still" }

[values]
swinging = { statistic = "iqm", column = "score", arm = "swinging" }
gain = { statistic = "improvement", column = "score", arm = "swinging", over = "still" }
alike = { statistic = "equal", column = "hash", arm = "swinging", over = "still" }

[[figures]]
name = "scores"
title = "Scores"
column = "score"
unit = "m"

[budgets.small]
seeds = [1, 2, 3]
minutes = 0.1
"""
DISCUSSION = "Who swings gets {{swinging}} m ({{swinging.low}} to {{swinging.high}}): `farther` {{verdict.farther}}.\n"
_BARE = """\
format = "nmes-study/1"
title = "A bare study"
question = "What is done?"

[[claims]]
name = "same"
says = "It is the same."
place = "nowhere"
for = "It is."
against = "It is not."
holds = 'same == 1'
refuted = 'same < 1'

[commands]
COMMANDS

[columns]
COLUMNS

[[arms]]
name = "only"
about = "All of it."
ARM

[values]
same = { statistic = "equal", arm = "only", over = "only" }

[budgets.small]
seeds = [1, 2, 3]
minutes = 0.1
"""


def make_bare_study(folder: Path, commands: Mapping[str, str], columns: Mapping[str, str], arm: str = "") -> Path:
    """Writes a study of one arm to a new folder; `arm` is what that arm has of its own."""
    folder.mkdir(parents=True)
    text = _BARE.replace("ARM", arm)
    for place, lines in (("COMMANDS", commands), ("COLUMNS", columns)):
        text = text.replace(place, "\n".join(f"{name} = {json.dumps(line)}" for name, line in lines.items()))
    (folder / "study.toml").write_text(text)
    return folder


def make_study(folder: Path) -> Path:
    """Writes the study with its documents to a new folder."""
    folder.mkdir(parents=True)
    (folder / "study.toml").write_text(STUDY)
    (folder / "small").mkdir()
    (folder / "small/discussion.md").write_text(DISCUSSION)
    task = {
        "format": "nmes-task/1",
        "name": "slide",
        "description": "Slide.",
        "duration": 0.5,
        "settle": 0,
        "seeds": [1],
        "vary": {"friction": [0.5, 1.0]},
        "objective": "displacement.horizontal",
    }
    (folder / "slide.json").write_text(json.dumps(task))
    for name, amplitude in (("swinging", 1.0), ("still", 0.0)):
        (folder / f"{name}.json").write_text(json.dumps(_genome(name, amplitude)))
    return folder


def _genome(name: str, amplitude: float) -> dict[str, Any]:
    motor = {"mode": "position", "range": [-1, 1], "max_effort": 20}
    joint = {"id": "hinge", "cube1": "a", "cube2": "b", "type": "hinge", "anchor": [0.3, 0.15, 0], "axis": [0, 0, 1]}
    return {
        "format": "nmes-genome/1",
        "name": name,
        "body": {
            "cubes": [
                {"id": "a", "size": 0.3, "mass": 1, "position": [0, 0.15, 0]},
                {"id": "b", "size": 0.3, "mass": 1, "position": [0.6, 0.15, 0]},
            ],
            "joints": [{**joint, "motor": motor}],
        },
        "brain": {"kind": "sine", "oscillators": [{"motor": "hinge", "frequency": 3, "amplitude": amplitude}]},
    }


def edit(path: Path, old: str, new: str) -> None:
    """Changes the first place of a file that reads like that; there must be one."""
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
