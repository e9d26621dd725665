"""What results say: the values of a study by name, and the verdict on each claim.

Hides how values come of rows: which rows, in which cells, what a missing number is worth. Both follow from the study
and the rows alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Final, Literal

import numpy as np

from nmes.backend import Array
from nmes.errors import StudyError
from nmes.objective.quantities import Quantity
from nmes.schemas.documents import JsonObject, canonical_hash
from nmes.study.document import Plan, PlannedRun, condition
from nmes.study.results import Results
from nmes.study.statistics import Estimate, estimate, improvement, iqm, mean, median

__all__ = ["VERDICTS", "Verdict", "arm_numbers", "evaluate", "judge"]

Verdict = Literal["holds", "holds in part", "refuted", "undecided at this budget"]
VERDICTS: Final = ("holds", "holds in part", "refuted", "undecided at this budget")

_STATISTICS: Final[Mapping[str, Callable[..., Array]]] = {
    "iqm": iqm,
    "mean": mean,
    "median": median,
    "improvement": improvement,
    "difference": lambda ours, theirs: iqm(ours) - iqm(theirs),
}


def evaluate(plan: Plan, results: Results) -> dict[str, Estimate]:
    """Returns the values of a study by name.

    Raises:
        StudyError: The rows have no numbers where a statistic needs some (`bad_results`).
    """
    values = {}
    for name, document in plan.study.document["values"].items():
        where: Mapping[str, object] = document.get("where", {})
        arms = [document["arm"], *([document["over"]] if "over" in document else [])]
        path = ("study", canonical_hash(document))  # what is asked twice has one interval
        statistic = document["statistic"]
        if statistic == "equal":
            values[name] = _equal(plan, results, document.get("column"), arms, where)
            continue
        strata = [arm_numbers(plan, results, document["column"], arm, where) for arm in arms]
        if statistic in ("min", "max"):
            every = np.concatenate(strata[0])
            value = float(every.min() if statistic == "min" else every.max())
            values[name] = Estimate(value, value, value, every.size, max(map(len, strata[0])))
        else:
            values[name] = estimate(_STATISTICS[statistic], strata, path)
    return values


def judge(claim: JsonObject, values: Mapping[str, Estimate]) -> Verdict:
    """Returns the verdict on a claim."""
    if _true(claim["refuted"], values):
        return "refuted"
    if _true(claim["holds"], values):
        return "holds"
    if _true(claim.get("partly", "false"), values):
        return "holds in part"
    return "undecided at this budget"


def arm_numbers(
    plan: Plan, results: Results, column: str, arm: str, where: Mapping[str, object] | None = None
) -> list[Array]:
    """Returns the numbers of an arm, an array for each cell, divided by the cell's scale.

    Raises:
        StudyError: One is no number, and the study does not say what that is worth (`bad_results`).
    """
    missing = plan.study.document["missing"].get(column)
    cells: dict[str, list[float]] = {}
    for run, row in _rows(plan, results, arm, where or {}):
        value = row[column] if row[column] is not None else missing
        if not isinstance(value, int | float):
            raise StudyError("bad_results", f"{run} has no number {column}, but {value!r}")
        cells.setdefault(canonical_hash(run.cell), []).append(float(value) / plan.study.scale(run.cell))
    # Of zeros of both signs, which is the least or in the middle depends on their order and on the processor.
    return [np.array(values, np.float64) + 0.0 for values in cells.values()]


def _equal(
    plan: Plan, results: Results, column: str | None, arms: Sequence[str], where: Mapping[str, object]
) -> Estimate:
    """Returns in which part of the runs a column, or every column, is there and the very same in two arms."""
    columns = plan.study.shared_columns(arms) if column is None else [column]
    ours, theirs = (
        {(canonical_hash(run.cell), run.seed): row for run, row in _rows(plan, results, arm, where)} for arm in arms
    )
    alike = [
        all(row[name] is not None and row[name] == theirs[key][name] for name in columns) for key, row in ours.items()
    ]
    part = alike.count(True) / len(alike)
    return Estimate(part, part, part, len(alike), len({seed for _, seed in ours}))


def _rows(
    plan: Plan, results: Results, arm: str, where: Mapping[str, object]
) -> Iterator[tuple[PlannedRun, JsonObject]]:
    """Yields the runs of an arm in some cells, each with its row."""
    for run, row in zip(plan.runs, results.rows, strict=True):
        if run.arm["name"] == arm and all(run.cell[factor] == value for factor, value in where.items()):
            yield run, row


def _true(text: str, values: Mapping[str, Estimate]) -> bool:
    read = condition(text, values)
    return read.holds({quantity: _number(quantity, values) for quantity in read.needs})


def _number(quantity: Quantity, values: Mapping[str, Estimate]) -> float:
    """Returns the number of a name in a condition: a value, or an end of its interval."""
    if quantity.cube is None:
        return values[quantity.name].value
    found = values[quantity.cube]
    return found.low if quantity.name == "low" else found.high
