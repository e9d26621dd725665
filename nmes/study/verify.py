"""The proof of a study: the report says what the results say, and runs that are done again come out as there."""

from __future__ import annotations

import os
import re
import shlex
import tempfile
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

from nmes.errors import DocumentError, StudyError
from nmes.evaluation.again import MODEL, has_model, unforeseen
from nmes.schemas.documents import JsonObject, parse_document
from nmes.schemas.files import read_regular
from nmes.study.claims import evaluate
from nmes.study.document import Plan, PlannedRun, fill, settle
from nmes.study.report import REPORT, verdicts, written
from nmes.study.results import Results, row_of
from nmes.study.run import Progress, do_runs
from nmes.variation.draw import Draw

__all__ = ["StudyVerdict", "verify_study"]

_MOST: Final = 20  # findings that are kept
_LARGEST: Final = 64 << 20  # bytes of a file of a report
_SHOWN: Final = 60  # characters of a value in a finding


@dataclass(frozen=True, slots=True)
class StudyVerdict:
    """What came of the proof.

    Attributes:
        verdict: Whether everything came out again, or something did not; `not_comparable`: runs came out otherwise,
            but other numbers come out here than where the results were made, or they are of ONNX brains; or all was
            done again, and what is measured leads to another verdict on a claim here.
        findings: What did not, the first of them, in words.
        runs: How many rows there are.
        again: How many runs were done again.
        seed: Of the draw by which these were chosen.
        measured: How many rows are of measured arms, which do not come out again.
        not_judged: The columns that are measured, which do not come out again in the runs that are done again.
        verdicts: The verdict on each claim, by its name, as the results have it.
        verdicts_here: The same by the runs that were done again, if all were; else empty.
        digest: Of the results.
    """

    verdict: Literal["holds", "broken", "not_comparable"]
    findings: tuple[str, ...]
    runs: int
    again: int
    seed: int
    measured: int
    not_judged: tuple[str, ...]
    verdicts: dict[str, str]
    verdicts_here: dict[str, str]
    digest: str


def verify_study(
    plan: Plan, sample: int | None, jobs: int, progress: Progress, seed: int | None = None
) -> StudyVerdict:
    """Makes report and figures again, does some runs again, and compares.

    Args:
        plan: Of which study and budget.
        sample: How many runs that are not measured, drawn from all arms in turn; None: all runs, the measured ones too.
        jobs: How many at once.
        progress: Called now and then with how many are done, and how many there are.
        seed: Of the draw; None: one that nobody can foresee.

    Raises:
        StudyError: There are no results (`no_results`), or a command fails (`command_failed`).
        MissingPackage: pyarrow is not installed.
    """
    seed = unforeseen(seed)
    try:
        results = Results.read(plan)
        found = dict[str, str](verdicts(plan, evaluate(plan, results)))
        findings = _compare_files(plan.folder, written(plan, results))
    except StudyError as error:
        if error.code not in ("bad_results", "bad_discussion"):
            raise
        return StudyVerdict("broken", (error.message,), 0, 0, seed, 0, (), {}, {}, "")
    exact = [run for run in plan.runs if not run.arm["measured"]]
    measured, not_judged = len(plan.runs) - len(exact), tuple(plan.study.document["measured"])
    chosen = list(plan.runs) if sample is None else _drawn(exact, sample, Draw(seed, "study", "verify", results.digest))
    again: list[str] = []
    excused, models = True, _models(plan.study.folder)
    rows: dict[int, JsonObject] = {}
    with (
        tempfile.TemporaryDirectory(prefix="nmes-study-") as folder,
        closing(do_runs(plan, chosen, jobs, Path(folder, "runs"), lambda count: progress(count, len(chosen)))) as done,
    ):
        for run, columns in done:
            rows[run.number] = row_of(run, columns)
            if not run.arm["measured"]:
                found_again = _differences(str(run), results.rows[run.number], rows[run.number], not_judged)
                if found_again and _names_one(plan, run, models):
                    found_again = [f"{finding}; {MODEL}" for finding in found_again]
                elif found_again:
                    excused = False
                again += found_again
    here: dict[str, str] = {}
    if sample is None:
        here |= verdicts(plan, evaluate(plan, Results.here(plan, [rows[run.number] for run in plan.runs])))
    other = [
        f"claim {name}: {verdict} here, where the results say {found[name]}"
        for name, verdict in here.items()
        if verdict != found[name]
    ]
    verdict: Any = "broken" if findings else "holds"
    if (again or other) and not findings:
        verdict = "broken" if again and not excused and not results.differences() else "not_comparable"
    every = tuple([*findings, *sorted(again), *other][:_MOST])
    return StudyVerdict(
        verdict, every, len(plan.runs), len(chosen), seed, measured, not_judged, found, here, results.digest
    )


def _drawn(runs: Sequence[PlannedRun], count: int, draw: Draw) -> list[PlannedRun]:
    """Returns so many runs: one of each arm, another of each arm, and so on, in their order."""
    seen = Counter[str]()
    turns = list[tuple[int, PlannedRun]]()
    for place in draw.order(len(runs)).tolist():
        arm = str(runs[place].arm["name"])
        turns.append((seen[arm], runs[place]))
        seen[arm] += 1
    chosen = sorted(turns, key=lambda turn: turn[0])[:count]
    return sorted((run for _, run in chosen), key=lambda run: run.number)


def _models(folder: Path) -> list[Path]:
    """Returns the genomes beside a study that have an ONNX brain."""
    found = []
    for path in sorted(folder.glob("*.json")):
        with suppress(OSError, DocumentError):  # what is no genome is none of a creature that has such a brain
            genome = parse_document(path.read_bytes()) if path.is_file() else None
            if isinstance(genome, dict) and isinstance(genome.get("brain"), dict) and has_model([genome]):
                found.append(path)
    return found


def _names_one(plan: Plan, run: PlannedRun, documents: Sequence[Path]) -> bool:
    """Tells whether the commands of a run name one of some files beside its study: itself, its folder, or a pattern."""
    return any(
        path in (document, document.parent) or document.match(str(path))
        for path in _paths(plan, run)
        for document in documents
    )


def _paths(plan: Plan, run: PlannedRun) -> Iterator[Path]:
    """Yields all that could be a path in the commands of a run: `FILE`, `--genome=FILE`, `prey=FILE,hunter=FILE`."""
    # Folders stand for themselves until words are cut to pieces: their names may have what words are cut at.
    values = settle(run.values, {"run": "{run}", "study": "{study}"})
    for command in (*plan.study.arm_commands(run.arm).values(), *run.arm.get("beside", {}).values()):
        for word in shlex.split(command):
            try:
                filled = fill([word], values)
            except KeyError:
                continue  # what another command printed
            for piece in re.split("[=,]", ",".join(filled)):
                if piece:
                    yield Path(os.path.abspath(piece.replace("{study}", str(plan.study.folder))))


def _compare_files(folder: Path, expected: dict[str, bytes]) -> list[str]:
    """Returns in which files a report is not what comes of the results, in words."""
    findings = []
    for name, content in expected.items():
        path = folder / name
        try:
            there = read_regular(path, _LARGEST)
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
