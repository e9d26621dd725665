"""The proof of a study: the report says what the results say, and runs that are done again come out as there."""

from __future__ import annotations

import tempfile
from collections.abc import Collection
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

from nmes.errors import StudyError
from nmes.schemas.documents import JsonObject
from nmes.study.claims import evaluate
from nmes.study.document import Plan
from nmes.study.report import REPORT, verdicts, written
from nmes.study.results import Results, row_of
from nmes.study.run import Progress, do_runs
from nmes.variation.draw import Draw

__all__ = ["StudyVerdict", "verify_study"]

_MOST: Final = 20  # findings that are kept
_SHOWN: Final = 60  # characters of a value in a finding


@dataclass(frozen=True, slots=True)
class StudyVerdict:
    """What came of the proof.

    Attributes:
        verdict: Whether everything came out again, or something did not; `not_comparable`: runs came out otherwise,
            but other numbers come out here than where the results were made.
        findings: What did not, the first of them, in words.
        runs: How many rows there are.
        again: How many runs were done again.
        measured: How many rows are of measured arms, which do not come out again and are not done again.
        not_judged: The columns that are measured, which do not come out again in the runs that are done again.
        verdicts: The verdict on each claim, by its name, as the results have it.
        digest: Of the results.
    """

    verdict: Literal["holds", "broken", "not_comparable"]
    findings: tuple[str, ...]
    runs: int
    again: int
    measured: int
    not_judged: tuple[str, ...]
    verdicts: dict[str, str]
    digest: str


def verify_study(plan: Plan, sample: int | None, jobs: int, progress: Progress) -> StudyVerdict:
    """Makes report and figures again, does some runs again, and compares.

    Args:
        plan: Of which study and budget.
        sample: How many runs, drawn by the digest of the results; None: all that are not measured.
        jobs: How many at once.
        progress: Called now and then with how many are done, and how many there are.

    Raises:
        StudyError: There are no results (`no_results`), or a command fails (`command_failed`).
        MissingPackage: pyarrow is not installed.
    """
    try:
        results = Results.read(plan)
        found = dict[str, str](verdicts(plan, evaluate(plan, results)))
        findings = _compare_files(plan.folder, written(plan, results))
    except StudyError as error:
        if error.code not in ("bad_results", "bad_discussion"):
            raise
        return StudyVerdict("broken", (error.message,), 0, 0, 0, (), {}, "")
    exact = [run for run in plan.runs if not run.arm["measured"]]
    measured, not_judged = len(plan.runs) - len(exact), tuple(plan.study.document["measured"])
    if sample is not None and sample < len(exact):
        order = Draw(0, "study", "verify", results.digest).order(len(exact))[:sample]
        exact = [exact[place] for place in sorted(order.tolist())]
    again: list[str] = []
    with (
        tempfile.TemporaryDirectory(prefix="nmes-study-") as folder,
        closing(do_runs(plan, exact, jobs, Path(folder, "runs"), lambda count: progress(count, len(exact)))) as done,
    ):
        for run, columns in done:
            again += _differences(str(run), results.rows[run.number], row_of(run, columns), not_judged)
    verdict: Any = "broken" if findings else "holds"
    if again and not findings:
        verdict = "not_comparable" if results.differences() else "broken"
    every = tuple([*findings, *sorted(again)][:_MOST])
    return StudyVerdict(verdict, every, len(plan.runs), len(exact), measured, not_judged, found, results.digest)


def _compare_files(folder: Path, expected: dict[str, bytes]) -> list[str]:
    """Returns in which files a report is not what comes of the results, in words."""
    findings = []
    for name, content in expected.items():
        path = folder / name
        try:
            there = path.read_bytes()
        except OSError as error:
            findings.append(f"{path} cannot be read: {error.strerror}")
            continue
        if there != content:
            lines, others = content.splitlines(), there.splitlines()
            place = next(
                (place for place, (a, b) in enumerate(zip(lines, others, strict=False), 1) if a != b),
                min(len(lines), len(others)) + 1,
            )
            findings.append(f"{path}, line {place}: it is not what the results say")
    known = {*expected, REPORT}
    findings += [f"{path}: no such figure comes of the results" for path in _figures(folder) if path.name not in known]
    return findings


def _figures(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.svg"))


def _differences(run: str, told: JsonObject, now: JsonObject, not_judged: Collection[str]) -> list[str]:
    """Returns in which columns a run did not come out as its row has it, in words."""
    names = [name for name in now if name not in not_judged and now[name] != told[name]]
    return [f"{run}: {name} is {_short(now[name])}, not {_short(told[name])}" for name in names]


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= _SHOWN else text[: _SHOWN - 1] + "…"
