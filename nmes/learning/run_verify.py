"""How a run of learning is proved: its log is followed, and some of its legs are done again.

Invariants: nothing that the folder says is believed, and what is compared is compared to the last bit. A leg that is
done again begins at a state of the folder whose digest is that of the log, or with the run itself. Which legs are drawn
does not depend on which states the folder has: whoever made the run chose those.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from nmes.errors import RunError
from nmes.evaluation.again import drawn, unforeseen
from nmes.learning.legs import Learning
from nmes.learning.run import LearningRun
from nmes.variation.draw import Draw

__all__ = ["LearningVerdict", "verify_learning"]

Progress = Callable[[str, int, int], None]
Verdict = Literal["holds", "broken", "not_comparable"]


@dataclass(frozen=True, slots=True)
class LearningVerdict:
    """What came out when a run was verified.

    Attributes:
        verdict: It `holds`; it is `broken`, since something did not come out as the log has it; or it is
            `not_comparable`: that may be because the run was begun where other numbers come out.
        findings: What did not, in words.
        legs: How many legs the log has.
        again: How many were done again.
        seed: Of the draw by which these were chosen.
        digest: The run's.
    """

    verdict: Verdict
    findings: tuple[str, ...]
    legs: int
    again: int
    seed: int
    digest: str


def verify_learning(
    folder: Path, threads: int, sample: int | None, progress: Progress, seed: int | None = None
) -> LearningVerdict:
    """Verifies a run.

    Args:
        folder: The run's.
        threads: How many step the engine.
        sample: How many legs are done again beside the best: the last, the first, and others that are drawn by the
            seed and the run's digest, each with all legs since the last state that is kept; None: all are, from the
            beginning on.
        progress: Called with what is being done, how much of it is done, and how much there is.
        seed: Of the draw; None: one that nobody can foresee.

    Raises:
        RunError: There is no run, or it cannot be read (`no_run`), or recordings have changed (`recordings_changed`, or
            `not_comparable` where the run was begun where other numbers come out).
        WorldError, RecordingError, ProofError: As `Learning`.
    """
    seed = unforeseen(seed)
    try:
        run = LearningRun.open(folder)
    except RunError as error:
        if error.code != "log_damaged":
            raise
        return LearningVerdict("broken", (error.message,), 0, 0, seed, "")
    every = range(1, len(run.legs) + 1)
    chosen = list(every) if sample is None else _choose(run, sample, Draw(seed, "verify", run.digest))
    learning = _learning(run, threads)
    findings, again = [], 0
    try:
        for found in _again(run, learning, chosen):
            again += 1
            progress("learning again", again, len(chosen))
            if found:
                findings.append(found)
    finally:
        learning.close()
    try:
        run.genome()
    except RunError as error:
        findings.append(error.message)
    verdict: Verdict = "holds" if not findings else "not_comparable" if run.differences() else "broken"
    return LearningVerdict(verdict, tuple(findings[:20]), len(run.legs), again, seed, run.digest)


def _learning(run: LearningRun, threads: int) -> Learning:
    """Returns the learning of a run, before its first leg.

    Raises:
        RunError: Recordings come to something else (`recordings_changed` or `not_comparable`).
    """
    try:
        return Learning(run.settings, threads)
    except RunError as error:
        if error.code != "recordings_changed" or not run.differences():
            raise
        what = f"{error.message}, or come out otherwise here: {run.folder} was begun where other numbers come out"
        raise RunError("not_comparable", what) from error


def _choose(run: LearningRun, sample: int, draw: Draw) -> list[int]:
    """Returns legs to do again, in order: the best and so many others, each with those since a state that is kept."""
    every = range(1, len(run.legs) + 1)
    best = [] if run.best is None else [run.best.leg]
    ends = [number for number in dict.fromkeys([*every[-1:], *every[:1]]) if number not in best][:sample]
    between = [number for number in every if number not in (*best, *ends)]
    chosen: set[int] = set()
    for number in (*best, *ends, *drawn(between, sample - len(ends), draw)):
        chosen.update(range(run.nearest(number - 1)[0] + 1, number + 1))
    return sorted(chosen)


def _again(run: LearningRun, learning: Learning, chosen: list[int]) -> Iterator[str]:
    """Does legs again; yields of each in what it came out otherwise, or nothing."""
    for number in chosen:
        if learning.leg != number - 1:
            kept, state = run.nearest(number - 1)
            if state is not None and kept > learning.leg:
                try:
                    learning.restore(kept, state)
                except ValueError as error:
                    yield f"leg {number}: what the run knew before it is not what this learner knows: {error}"
                    continue
        while learning.leg < number:
            yield run.otherwise(learning.go())
