"""How a run is proved: its log is told to the algorithm again, and some of its evaluations are done again.

Invariants: nothing that the log or the index says is believed, and what is compared is compared to the last bit. A
verdict does not depend on who evaluates.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import orjson

from nmes.errors import DocumentError, RunError, VariationError
from nmes.evaluation.again import MODEL, drawn, has_model, unforeseen
from nmes.evaluation.contest import Rivals
from nmes.evaluation.parallel import Pool
from nmes.evaluation.population import ROWS
from nmes.evaluation.queue import EvaluationQueue
from nmes.evolution.algorithm import Candidate
from nmes.evolution.run import Order, Run
from nmes.evolution.run_entry import Entry, told
from nmes.schemas.documents import write_json
from nmes.variation.draw import Draw

__all__ = ["RunVerdict", "verify_run"]

_MOST: Final = 20  # findings that are kept
_WINDOW: Final = 256  # candidates that are evaluated again at once, at least: of others nothing is kept in memory

Progress = Callable[[str, int, int], None]
Verdict = Literal["holds", "broken", "not_comparable"]


@dataclass(frozen=True, slots=True)
class RunVerdict:
    """What came out when a run was verified.

    Attributes:
        verdict: It `holds`; it is `broken`, since something did not come out as the log has it; or it is
            `not_comparable`: that may be because the run was begun where other numbers come out, or has ONNX brains.
        findings: What did not, the first of them, in words.
        told: How many candidates the log has.
        asked: How many of them candidates the algorithm was asked for again.
        evaluated: How many were evaluated again.
        seed: Of the draw by which these were chosen.
        digest: The run's.
    """

    verdict: Verdict
    findings: tuple[str, ...]
    told: int
    asked: int
    evaluated: int
    seed: int
    digest: str


def verify_run(folder: Path, pool: Pool, sample: int | None, progress: Progress, seed: int | None = None) -> RunVerdict:
    """Verifies a run.

    Args:
        folder: The run's.
        pool: Who evaluates.
        sample: How many candidates are evaluated again beside the elites and the best, drawn by the seed and the run's
            digest; None: all are.
        progress: Called with what is being done, how much of it is done, and how much there is.
        seed: Of the draw; None: one that nobody can foresee.

    Raises:
        RunError: There is no run, or it cannot be read (`no_run`).
        MissingPackage: The algorithm needs a package that is not installed.
        MachineError: Workers are killed (`worker_killed`).
    """
    seed = unforeseen(seed)
    try:
        run = Run.open(folder)
    except RunError as error:
        if error.code != "log_damaged":
            raise
        return RunVerdict("broken", (error.message,), 0, 0, 0, seed, "")
    verification = _Verification(run, progress)
    chosen: list[int] = []
    try:
        for finding in verification.ask_again():
            verification.found(finding)
        chosen = verification.choose(sample, seed)
        for finding, excused in verification.evaluate_again(chosen, pool):
            verification.found(finding, excused)
    except RunError as error:  # the log cannot be read on
        verification.found(error.message)
    findings = tuple(verification.findings)
    beyond = bool(findings) and (verification.excused or bool(run.differences()))
    verdict: Verdict = "holds" if not findings else "not_comparable" if beyond else "broken"
    return RunVerdict(verdict, findings, len(run), verification.order.told, len(chosen), seed, run.digest)


class _Verification:
    def __init__(self, run: Run, progress: Progress) -> None:
        self._run, self._progress = run, progress
        self.order = Order(run.settings.begin(), len(run))
        self.findings: list[str] = []
        self.excused = True  # all that came out otherwise is of ONNX brains
        self._rivals: list[Rivals | None] = []  # of each candidate that was asked for again

    def found(self, finding: str, excused: bool = False) -> None:
        """Keeps a finding, if there are not many already."""
        self.excused = self.excused and excused
        if len(self.findings) < _MOST:
            self.findings.append(finding)

    def ask_again(self) -> Iterator[str]:
        """Tells the algorithm the log; yields in what it is not what the algorithm asks for, and the index not it."""
        run, order = self._run, self.order
        asked: dict[int, Candidate] = {}
        yield from self._compare_state()  # what the index says may be of any time, also of before the first was told
        for record, (line, entry) in zip(run.records, run.entries(), strict=False):
            self._progress("asking again", order.told, len(run))
            try:
                asked.update(order.due())
            except VariationError as error:
                yield f"candidate {order.asked - 1}: the algorithm asks for none: {error.message}"
                return
            again = asked.pop(record.index)
            self._rivals.append(again.rivals)
            yield from _differences(again, entry)
            if entry.record(line) != record:
                yield f"candidate {record.index}: the index has something else of it than the log: delete the index"
            try:
                _ = entry.candidate
            except DocumentError as error:
                yield f"candidate {record.index}: its genome is none: {error.message}"
                return
            order.tell(again, entry.score)  # with another's it might not go on, and in what it is another is told
            yield from self._compare_state()

    def _compare_state(self) -> Iterator[str]:
        """Yields in what the index has something else of the algorithm than it says of itself now."""
        indexed, algorithm = self._run.indexed, self.order.algorithm
        if indexed is None or indexed.told != self.order.told:
            return
        figures = orjson.loads(orjson.dumps(dict(algorithm.figures())))
        for name, there, now in (
            ("elites", indexed.elites, tuple(algorithm.elites())),
            ("figures", orjson.loads(orjson.dumps(dict(indexed.figures))), figures),
        ):
            if there != now:
                what = f"the index has other {name} than the algorithm: delete the index"
                yield f"after {indexed.told} candidates: {what}"

    def choose(self, sample: int | None, seed: int) -> list[int]:
        """Returns the candidates that are to be evaluated again: the elites, the best, and others."""
        run, count = self._run, self.order.told
        if sample is None:
            return list(range(count))
        best = [] if run.best is None else [run.best.index]
        kept = {index for index in (*self.order.algorithm.elites(), *best) if index < count}
        others = [index for index in range(count) if index not in kept]
        return sorted([*kept, *drawn(others, sample, Draw(seed, "verify", run.digest))])

    def evaluate_again(self, chosen: list[int], pool: Pool) -> Iterator[tuple[str, bool]]:
        """Evaluates candidates; yields what comes out otherwise, and whether that may be for an ONNX brain."""
        run, expressions = self._run, self._run.settings.expressions()
        queue = EvaluationQueue(run.settings.task, run.settings.seeds, pool)
        window = max(_WINDOW, 2 * ROWS * pool.jobs)  # a full portion for each process, and the next
        given = done = 0
        while done < len(chosen):
            for index in chosen[given : done + window]:
                queue.put(index, run.entry(index).genome, self._rivals[index])
                given += 1
            for index, evaluation in queue.take():
                done += 1
                self._progress("evaluating again", done, len(chosen))
                entry = run.entry(index)
                again = told(index, entry.candidate, evaluation, run.settings, expressions)
                rivals = self._rivals[index]
                met = [] if rivals is None else [genome for lineup in rivals.lineups for genome in lineup]
                excused = has_model([entry.content["genome"], *(genome.document for genome in met)])
                for name, value in orjson.loads(write_json(again.content)).items():
                    if entry.content[name] != value:
                        what = f"{name} is {entry.content[name]!r} in the log, and comes out as {value!r}"
                        yield f"candidate {index}: {what}{f'; {MODEL}' if excused else ''}", excused


def _differences(candidate: Candidate, entry: Entry) -> Iterator[str]:
    """Yields in what an entry is not the candidate that the algorithm asks for."""
    content = entry.content
    asked = {
        "genome_hash": candidate.genome.hash,
        "operator": candidate.operator,
        "parents": list(candidate.parents),
        "generation": candidate.generation,
        "group": candidate.group,
        "opponents": [[each.index for each in lineup] for lineup in candidate.lineups] or None,
    }
    for name, value in asked.items():
        if content.get(name) != value:
            what = f"{name} is {content.get(name)!r} in the log, and {value!r} is asked for"
            yield f"candidate {content['index']}: {what}"
    if content["genome"] != candidate.genome.document and content["genome_hash"] == asked["genome_hash"]:
        yield f"candidate {content['index']}: its genome is not the one that is asked for"
