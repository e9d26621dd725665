"""Writes docs/paper.md: the paper's claims, and what studies say of each.

`studies/paper.toml` lists the claims; what a study judges comes from its results, those of the full budget where there
are some.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from nmes.study.claims import evaluate, judge
from nmes.study.document import Study
from nmes.study.results import FILE, Results
from nmes.view.chart import number

__all__ = ["PAGE", "written"]

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "paper.md"
_HEAD = """\
# The paper's claims

Claims of the paper that can be tested, in its order, with the verdict of the [study](studies.md) that tests them:
`holds`, `holds in part`, `refuted`, or `undecided at this budget`. The figure is the value that the verdict rests on,
with its interval of 95 %. The command proves it: report and figures follow from the results, and runs that are done
again come out the same. What rests on times or memory is measured and judged anew where `--all` is added. *Changed*
stands where part of a criterion was written when results had been seen; the report tells which. What no study tests
says so.

This page is written by `tools/paper.py` from `studies/paper.toml` and the results of the studies.

| claim | verdict | figure | command |
|---|---|---|---|
"""


def written() -> str:
    """Returns the page."""
    claims = tomllib.loads((ROOT / "studies" / "paper.toml").read_text("utf-8"))["claims"]
    return _HEAD + "".join(f"| {' | '.join(row)} |\n" for row in map(_row, claims))


def _row(claim: dict[str, Any]) -> Iterator[str]:
    if "study" not in claim:
        yield from (_quoted(claim), f"not tested by a study: {claim['untested']}", "", "")
        return
    study = Study.load(ROOT / "studies" / claim["study"])
    done = [budget for budget in ("full", "small") if (study.folder / budget / FILE).exists()]
    (document,) = (each for each in study.document["claims"] if each["name"] == claim["claim"])
    if not done:
        yield from (_quoted(document), "not tested: the study is written, and was not run", "")
        yield f"`nmes study run {study.name}`"
        return
    budget = done[0]
    plan = study.plan(budget)
    values = evaluate(plan, Results.read(plan))
    found = values[claim["figure"]]
    interval = "" if found.low == found.high else f" ({number(found.low)} to {number(found.high)})"
    yield _quoted(document)
    report = f"../studies/{study.name}/{budget}/REPORT.md"
    changed = f" ([changed]({report}#what-would-count))" if "changed" in document else ""
    yield f"**{judge(document, values)}**{changed}"
    yield f"[`{claim['figure']}`]({report}) = {number(found.value)}{interval}, {found.runs} runs"
    yield f"`nmes study verify {study.name} --budget {budget}`"


def _quoted(claim: dict[str, Any]) -> str:
    says, place = claim["says"].replace("|", "\\|"), claim["place"].removeprefix("the paper, ")
    return f"“{says}” ({place})"


if __name__ == "__main__":
    PAGE.write_text(written(), "utf-8")
