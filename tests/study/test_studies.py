"""The studies of this tree: their reports follow from their results, and their runs come out again."""

from __future__ import annotations

import re
import shutil
import tomllib
from pathlib import Path

import pytest

import paper
from layout import ROOT
from nmes.study import Plan, Study, verify_study
from nmes.study.claims import VERDICTS

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


@pytest.mark.parametrize("folder", DONE, ids=lambda folder: f"{folder.parent.name}-{folder.name}")
@pytest.mark.parametrize("changed", ["verdict", "number"])
def test_a_report_of_these_that_its_results_do_not_support_is_found(folder: Path, changed: str, tmp_path: Path) -> None:
    shutil.copytree(folder.parent, tmp_path / folder.parent.name, ignore=shutil.ignore_patterns("work"))
    planted = tmp_path / folder.parent.name / folder.name
    report = planted / "REPORT.md"
    text = report.read_text("utf-8")
    if changed == "verdict":
        found = re.search(r"^Verdict: \*\*(.*)\*\*$", text, re.MULTILINE)
        assert found is not None
        other = next(each for each in VERDICTS if each != found[1])
        text = text.replace(found[0], f"Verdict: **{other}**", 1)
    else:
        rows = re.findall(r"^(\| `\w+`: .* \| )(-?[\d.e+-]+)( \|.*)$", text, re.MULTILINE)
        before, number, after = rows[-1]
        text = text.replace(f"{before}{number}{after}", f"{before}{float(number) + 1:.4g}{after}")
    report.write_text(text, "utf-8")
    found_broken = verify_study(plan_of(planted), 0, 1, nothing)
    assert found_broken.verdict == "broken" and "REPORT.md, line " in found_broken.findings[0]


def test_what_a_run_comes_to_follows_from_its_settings_and_its_seed() -> None:
    found = verify_study(Study.load(ROOT / "studies" / "determinism").plan("small"), 0, 1, nothing)
    assert set(found.verdicts.values()) == {"holds"}


@pytest.mark.long
@pytest.mark.parametrize("folder", DONE, ids=lambda folder: f"{folder.parent.name}-{folder.name}")
def test_runs_come_out_again(folder: Path) -> None:
    found = verify_study(plan_of(folder), None if folder.name == "small" else 3, 2, nothing)
    if found.verdict == "not_comparable":
        pytest.skip("other numbers come out here than where the results were made: " + "; ".join(found.findings))
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
