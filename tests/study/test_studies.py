"""The studies of this tree: their reports follow from their results, and their runs come out again."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

import paper
from layout import ROOT
from nmes.study import Plan, Study, verify_study

DONE = sorted(path.parent for path in ROOT.glob("studies/*/*/results.parquet"))


def nothing(done: int, total: int) -> None:
    pass


def plan_of(folder: Path) -> Plan:
    return Study.load(folder.parent).plan(folder.name)


def test_every_study_can_be_planned_with_each_budget_and_is_listed() -> None:
    for path in ROOT.glob("studies/*/study.toml"):
        study = Study.load(path.parent)
        assert all(study.plan(budget).runs for budget in study.document["budgets"])
    assert DONE
    listed = re.findall(
        r"^\| \[(\w+)\]\(\.\./studies/.*\| (.*) \|$", (ROOT / "docs/studies.md").read_text(), re.MULTILINE
    )
    assert dict(listed) == {
        path.parent.name: Study.load(path.parent).document["question"] for path in ROOT.glob("studies/*/study.toml")
    }


@pytest.mark.parametrize("folder", DONE, ids=lambda folder: f"{folder.parent.name}-{folder.name}")
def test_reports_say_what_the_results_say(folder: Path) -> None:
    found = verify_study(plan_of(folder), 0, 1, nothing)
    assert (found.verdict, found.findings) == ("holds", ())


def test_what_a_run_comes_to_follows_from_its_settings_and_its_seed() -> None:
    found = verify_study(Study.load(ROOT / "studies" / "determinism").plan("small"), 0, 1, nothing)
    assert set(found.verdicts.values()) == {"holds"}


@pytest.mark.long
@pytest.mark.parametrize("folder", DONE, ids=lambda folder: f"{folder.parent.name}-{folder.name}")
def test_runs_come_out_again(folder: Path) -> None:
    found = verify_study(plan_of(folder), 3, 2, nothing)
    if found.verdict == "not_comparable":
        pytest.skip("other numbers come out here than where the results were made")
    assert (found.verdict, found.findings) == ("holds", ())


def test_small_budgets_end_within_twenty_minutes() -> None:
    studies = [Study.load(path.parent) for path in ROOT.glob("studies/*/study.toml")]
    assert sum(study.document["budgets"]["small"]["minutes"] for study in studies) <= 20


def test_the_page_of_claims_says_what_the_studies_say() -> None:
    assert paper.PAGE.read_text("utf-8") == paper.written(), "out of date: .venv/bin/python tools/paper.py"


def test_every_claim_of_a_study_about_the_paper_is_on_its_page() -> None:
    listed = tomllib.loads((ROOT / "studies" / "paper.toml").read_text("utf-8"))["claims"]
    named = {(claim["study"], claim["claim"]) for claim in listed if "study" in claim}
    made = {
        (path.parent.name, claim["name"])
        for path in ROOT.glob("studies/*/study.toml")
        for claim in Study.load(path.parent).document["claims"]
        if re.match("the paper", claim["place"])
    }
    assert named == made
