"""How a run of learning is proved: its log is followed, and some of its legs are done again.

Invariants: nothing that the folder says is believed, and what is compared is compared to the last bit. A leg that is
done again begins at a state of the folder whose digest is that of the log, or with the run itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from nmes.errors import RunError
from nmes.learning.legs import Learning
from nmes.learning.run import LearningRun

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
        digest: The run's.
    """

    verdict: Verdict
    findings: tuple[str, ...]
    legs: int
    again: int
    digest: str


def verify_learning(folder: Path, threads: int, sample: int | None, progress: Progress) -> LearningVerdict:
    """Verifies a run.

    Args:
        folder: The run's.
        threads: How many step the engine.
        sample: How many legs are done again, of those before which a state is kept: the first, the last, and others
            that are drawn by the run's seed and digest; None: all are, from the beginning on.
        progress: Called with what is being done, how much of it is done, and how much there is.

    Raises:
        RunError: There is no run, or it cannot be read (`no_run`), or recordings have changed (`recordings_changed`).
        WorldError, RecordingError, ProofError: As `Learning`.
    """
    try:
        run = LearningRun.open(folder)
    except RunError as error:
        if error.code != "log_damaged":
            raise
        return LearningVerdict("broken", (error.message,), 0, 0, "")
    chosen = list(range(1, len(run.legs) + 1)) if sample is None else _choose(run, sample)
    learning = Learning(run.settings, threads)
    findings = []
    try:
        for done, found in enumerate(_again(run, learning, chosen), 1):
            progress("learning again", done, len(chosen))
            if found:
                findings.append(found)
    finally:
        learning.close()
    try:
        run.genome()
    except RunError as error:
        findings.append(error.message)
    verdict: Verdict = "holds" if not findings else "not_comparable" if run.differences() else "broken"
    return LearningVerdict(verdict, tuple(findings[:20]), len(run.legs), len(chosen), run.digest)


def _choose(run: LearningRun, sample: int) -> list[int]:
    """Returns legs that can be done again at once, in order."""
    states = [0, *(number for number in run.kept() if run.state(number) is not None)]
    able = [number + 1 for number in states if number < len(run.legs)]
    draw = run.settings.draw("verify", run.digest)
    chosen = {able[0], able[-1]} if able and sample else set()
    left = [number for number in able if number not in chosen]
    while left and len(chosen) < sample:
        chosen.add(left.pop(draw.count(0, len(left) - 1)))
    return sorted(chosen)[-sample:] if sample else []


def _again(run: LearningRun, learning: Learning, chosen: list[int]) -> Iterator[str]:
    """Does legs again; yields of each in what it came out otherwise, or nothing."""
    for number in chosen:
        if learning.leg != number - 1:
            state = run.state(number - 1)
            assert state is not None, "only legs that can be done again are chosen"
            try:
                learning.restore(number - 1, state)
            except ValueError as error:
                yield f"leg {number}: what the run knew before it is not what this learner knows: {error}"
                continue
        yield run.otherwise(learning.go())
