"""Runs of creatures with ONNX brains, which may come out otherwise on another processor: who is excused by that."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from modelled import modelled
from nmes.study import Study, run_study, verify_study, write_report
from nmes.study.document import PlannedRun
from studies import make_bare_study, make_study


def nothing(*_: object) -> None:
    """Is told how far a study is."""


def test_what_a_model_rounds_otherwise_is_not_comparable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = make_study(tmp_path / "model")
    (folder / "swinging.json").write_text(json.dumps(modelled()))
    moved: set[object] = set()

    def perform(study: Study, run: PlannedRun, *others: object) -> dict[str, object]:
        return {"score": 2.0 if run.arm["name"] in moved else 1.0, "hash": ""}

    monkeypatch.setattr("nmes.study.run.perform", perform)
    plan = Study.load(folder).plan("small")
    run_study(plan, 1, nothing)
    write_report(plan)
    assert verify_study(plan, 2, 1, nothing).verdict == "holds"
    moved.add("swinging")
    found = verify_study(plan, 2, 1, nothing)
    assert found.verdict == "not_comparable" and "it has an ONNX brain" in found.findings[0]
    moved.add("still")
    assert verify_study(plan, 2, 1, nothing).verdict == "broken"


@pytest.mark.parametrize(
    ("name", "command", "named"),
    [
        ("e.json", "nmes eval walker --seeds {seed}", False),
        ("walk.json", "nmes eval walker --task walk --seeds {seed}", False),
        ("genome.json", "nmes eval {run}/best/genome.json", False),
        ("mine.json", "nmes eval elsewhere/mine.json", False),
        ("mine.json", "nmes eval {first/0/recordings/0} --record mine", False),
        ("mine.json", "nmes eval {study}/mine.json", True),
        ("mine.json", "nmes eval {creature} {first/0/recordings/0}", True),
        ("mine.json", "nmes eval {study}/{stem}.json", True),
        ("mine.json", "nmes eval {creatures}", True),
        ("mine.json", "nmes learn cube --genome={study}/mine.json", True),
        ("mine.json", "nmes serve --creatures prey=walker,hunter={study}/mine.json", True),
        ("mine.json", "nmes eval ../study/mine.json", True),
        ("mine.json", "nmes eval {study}", True),
        ("mine.json", "nmes eval '{study}/m*.json'", True),
        ("mine.json", "nmes eval '{study}/e*.json'", False),
    ],
)
def test_a_model_is_an_excuse_for_runs_that_name_its_file(
    name: str, command: str, named: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm = 'settings = { stem = "mine", creature = "{study}/mine.json", creatures = ["walker", "{study}/mine.json"] }'
    commands = {"first": "nmes eval walker", "score": command}
    folder = make_bare_study(tmp_path / "a=b, c" / "study", commands, {"score": "score /0/score"}, arm)
    (folder / name).write_text(json.dumps(modelled()))
    score = 1.0
    (folder.parent / "here").mkdir()
    monkeypatch.chdir(folder.parent / "here")
    monkeypatch.setattr("nmes.study.run.perform", lambda *_: {"score": score})
    plan = Study.load(folder).plan("small")
    run_study(plan, 1, nothing)
    write_report(plan)
    score = 2.0
    assert verify_study(plan, 3, 1, nothing).verdict == ("not_comparable" if named else "broken")
