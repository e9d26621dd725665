"""What algorithms need of a run: genomes to begin with, objectives, measures; and what they have no use for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import isfinite
from typing import Final

from nmes.errors import DocumentError
from nmes.evolution.algorithm import Measure, Problem

__all__ = ["check_problem", "require_ranges"]

_CELLS: Final = 1_000_000  # of a measure


def check_problem(
    problem: Problem, *, start: bool = False, brain: bool = False, objectives: int = 0, measures: int = 0
) -> None:
    """Returns if a problem is one for an algorithm.

    Args:
        problem: The problem.
        start: Whether the algorithm varies the brain of one genome.
        brain: Whether that must have a brain already.
        objectives: How many objectives it needs at least; 0 if it has no use for any.
        measures: The same of measures.

    Raises:
        DocumentError: It is not; with all that is missing or superfluous.
    """
    problems = [
        *_started(problem, start or brain),
        *_brained(problem, brain),
        *_counted("objectives", len(problem.objectives), objectives, "it maximises the task's score alone"),
        *_counted("measures", len(problem.measures), measures, "it keeps no archive"),
        *_ranged(problem.measures),
    ]
    if problems:
        raise DocumentError(problems)


def require_ranges(measures: Sequence[Measure]) -> None:
    """Raises a DocumentError where a measure has no range of cells."""
    if problems := list(_ranged(measures)):
        raise DocumentError(problems)


def _started(problem: Problem, start: bool) -> Iterator[tuple[str, str]]:
    count = len(problem.starts)
    if start and count != 1:
        given = f"not {count}" if count else "such as walker"
        yield "starts", f"this algorithm varies the brain of one genome: name one to begin with, {given}"


def _brained(problem: Problem, brain: bool) -> Iterator[tuple[str, str]]:
    if not brain or len(problem.starts) != 1:
        return
    try:
        size = problem.starts[0].brain().to_vector().size
    except DocumentError as error:
        yield from ((f"starts/0/{path}" if path else "starts/0/brain", words) for path, words in error.problems)
        return
    if size == 0:
        yield "starts/0/brain", "the brain has no parameters to be varied"


def _counted(what: str, count: int, least: int, otherwise: str) -> Iterator[tuple[str, str]]:
    if least == 0 and count:
        yield what, f"this algorithm has no use for {what}: {otherwise}"
    elif count < least:
        yield what, f"this algorithm needs {least} or more; {count or 'none'} given"


def _ranged(measures: Sequence[Measure]) -> Iterator[tuple[str, str]]:
    for place, measure in enumerate(measures):
        yield from _judged(measure, f"measures/{place}")


def _judged(measure: Measure, place: str) -> Iterator[tuple[str, str]]:
    if not (isfinite(measure.low) and isfinite(measure.high) and measure.low < measure.high):
        yield place, f"the range must be from a number to a greater one, not from {measure.low} to {measure.high}"
    if not 1 <= measure.cells <= _CELLS:
        yield f"{place}/cells", f"must be from 1 to {_CELLS:,}, not {measure.cells}"
