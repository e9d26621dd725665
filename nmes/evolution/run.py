"""A run of evolution: candidates of an algorithm, evaluated by any number of workers, told in one order, and kept.

    settings = RunSettings.read({"format": "nmes-run/1", "task": "walk", "algorithm": "ga", "budget": 99})
    run = Run.create("runs/mine", settings)
    with Workers(2) as workers:
        for record in run.advance(workers):
            print(record.index, record.score)
    print(run.digest)

Hides the order of asking and telling, what waits for its turn, and how log and index are kept in step. Invariants:

- The log follows from the settings alone: neither the number of workers nor where a run was interrupted shows in it.
- A candidate is in the log before the algorithm is told of it. What a kill takes away is what was in no log.
- Whoever reads a run takes no lock and changes nothing; one process at a time goes on with it.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import count
from math import isfinite
from pathlib import Path
from typing import Final

from nmes.backend.fingerprint import differences
from nmes.errors import DocumentError, RunError
from nmes.evaluation.contest import Rivals
from nmes.evaluation.evaluation import Evaluation
from nmes.evaluation.parallel import Pool
from nmes.evaluation.queue import EvaluationQueue
from nmes.evaluation.setting import task_identity
from nmes.evolution.algorithm import Algorithm, Candidate, Score
from nmes.evolution.run_entry import Entry, told
from nmes.evolution.run_folder import SETTINGS, begin_run, open_run, require_no_run, text_of
from nmes.evolution.run_index import MADE_ANEW, IndexWriter, Record, RunIndex, State
from nmes.evolution.run_log import Line, RunLog, RunWriter, write_whole
from nmes.evolution.run_settings import FORMAT, RunSettings
from nmes.genome import Genome
from nmes.schemas.documents import JsonObject, canonical_hash

__all__ = ["Order", "Run"]

Telling = Callable[[int, int], None]

_INDEXED: Final = 32  # records that are put into the index at once


class Order:
    """Asks an algorithm for candidates, and tells it scores, in the one order of a run.

    Args:
        algorithm: The algorithm, at its beginning.
        budget: How many candidates there are.
        first: The index of the first that is asked for: those before it are known.
    """

    def __init__(self, algorithm: Algorithm, budget: int, first: int = 0) -> None:
        self.algorithm, self._budget = algorithm, budget
        self.asked, self.told = first, 0

    def due(self) -> Iterator[tuple[int, Candidate]]:
        """Yields the candidates that are to be asked for before another score is told."""
        while self.asked < self._budget and self.algorithm.needs(self.asked) <= self.told:
            index, self.asked = self.asked, self.asked + 1
            yield index, self.algorithm.ask(index)

    def tell(self, candidate: Candidate, score: Score) -> None:
        """Tells the score of the next candidate."""
        self.algorithm.tell(self.told, candidate, score)
        self.told += 1


class Run:
    """A run in a folder; `create` and `open` give one.

    Attributes:
        folder: The folder.
        settings: What the run is about.
        fingerprint: Of what computes it.
        records: The candidates that were told, in order.
    """

    def __init__(self, folder: Path, document: JsonObject) -> None:
        self.folder = folder
        self.settings = RunSettings.reopen(document)
        self.fingerprint: dict[str, str] = document.get("fingerprint", {})
        self._document = document
        decisive = {name: value for name, value in document.items() if name not in ("budget", "fingerprint")}
        decisive["task"] = task_identity(document["task"])
        self._log = RunLog(folder / "log.jsonl", canonical_hash(decisive))
        self._index = RunIndex(folder / "index.sqlite")
        self._expressions = self.settings.expressions()
        self.records: list[Record] = []
        self._state: State | None = None
        self._read()

    @classmethod
    def create(cls, folder: str | os.PathLike[str], settings: RunSettings) -> Run:
        """Makes a folder for a run that has not begun yet.

        Raises:
            RunError: There is a run in it (`run_exists`), or it cannot be written (`cannot_write`).
        """
        require_no_run(Path(folder), "index.sqlite")
        document = {**settings.document, "fingerprint": settings.fingerprint()}
        begin_run(Path(folder), document)
        return cls(Path(folder), document)

    @classmethod
    def open(cls, folder: str | os.PathLike[str]) -> Run:
        """Reads the run in a folder, also one that another process goes on with.

        Raises:
            RunError: There is none, or none of this format (`no_run`), or its log is damaged (`log_damaged`).
        """
        return open_run(folder, FORMAT, cls)

    # -- what is there ---------------------------------------------------------------------------------------------

    def __len__(self) -> int:
        return len(self.records)

    @property
    def digest(self) -> str:
        """Of settings and all that was told, 32 hexadecimal digits: equal digests, equal histories."""
        return self.records[-1].digest if self.records else self._log.origin[:32]

    @property
    def finished(self) -> bool:
        """Whether as many were told as the budget says."""
        return len(self) >= self.settings.budget

    @property
    def best(self) -> Record | None:
        """The first of those with the highest score; None where there is no score.

        None too in a run of several populations, whose scores are of matches against others: see `champions`.
        """
        if self.settings.populations:
            return None
        scored = (record for record in self.records if record.score is not None)
        return max(scored, key=lambda record: (record.score or 0.0, -record.index), default=None)

    def champions(self) -> dict[str, Record]:
        """Returns the champion of each population by its role: of its last era that is over, or the best so far.

        Those of which nobody has a score are left out; a run of one population has none.
        """
        champions: dict[str, Record] = {}
        for index in self.elites() if self.settings.populations else ():
            champions.setdefault(self.records[index].group, self.records[index])
        return champions

    def genome(self, index: int) -> Genome:
        """Returns the genome of a candidate.

        Raises:
            RunError: It is no good genome (`log_damaged`).
        """
        with self._whole(index):
            return self.entry(index).genome

    def rivals(self, index: int) -> Rivals | None:
        """Returns the opponents that a candidate met, as the log has it; None where it met nobody.

        Raises:
            RunError: It met somebody whom it cannot have met (`log_damaged`).
        """
        entry = self.entry(index)
        if not entry.opponents:
            return None
        lineups = tuple(tuple(map(self._opponent, lineup)) for lineup in entry.opponents)
        return Rivals(self.records[index].group, lineups)

    def _opponent(self, index: int) -> Genome:
        """Returns the genome of somebody's opponent: founders may be met before they are told, or beyond a budget."""
        if index < len(self):
            return self.genome(index)
        algorithm = self.settings.begin()
        if algorithm.needs(index):
            raise RunError("log_damaged", f"{self.folder}: nobody can have met candidate {index}, who is not told yet")
        return algorithm.ask(index).genome

    def evaluation(self, index: int) -> Evaluation:
        """Returns the evaluation of a candidate, as the log has it."""
        return self.entry(index).evaluation(self.settings.task)

    def elites(self) -> Sequence[int]:
        """Returns the indices of the algorithm's elites, the best first.

        While another process goes on with the run, or before one that was killed is resumed, they may be those of a few
        candidates ago.
        """
        return self._told_state().elites

    def figures(self) -> Mapping[str, float | None]:
        """Returns the algorithm's figures, as of `elites`; the index has None for one that is no finite number."""
        return self._told_state().figures

    @property
    def indexed(self) -> State | None:
        """What the index has of the algorithm; None where it has nothing."""
        return self._indexed_state

    @property
    def up_to_date(self) -> bool:
        """Whether the index has all that was told."""
        return self._indexed == len(self) and self.indexed is not None and self.indexed.told == len(self)

    def _told_state(self) -> State:
        if self._state is None or (self.finished and self._state.told != len(self)):
            order = Order(self.settings.begin(), len(self), len(self))
            for _ in self.replay(order, lambda: None):
                pass
            self._state = State(order.told, tuple(order.algorithm.elites()), dict(order.algorithm.figures()))
        return self._state

    def replay(self, order: Order, ask: Callable[[], None]) -> Iterator[Record]:
        """Tells an algorithm what the log has.

        Args:
            order: The algorithm, at its beginning.
            ask: What to call before each is told.

        Yields:
            Each record, once it is told.

        Raises:
            RunError: The log is damaged (`log_damaged`).
        """
        for record, (_, entry) in zip(self.records, self.entries(), strict=False):
            with self._whole(record.index):
                candidate = entry.candidate
            ask()
            try:
                order.tell(candidate, entry.score)
            except (DocumentError, LookupError, ValueError) as error:
                what = f"candidate {record.index} is none that {self.settings.algorithm!r} can have asked for"
                raise self._log.damaged(record.index + 1, what) from error
            yield record

    # -- reading the log -------------------------------------------------------------------------------------------

    def _read(self) -> None:
        """Reads what the index has, and what it lacks from the log."""
        self.records, self._indexed_state = self._index.read()
        if not self._is_indexed():
            self.records, self._indexed_state = [], None
        self._state = self._indexed_state
        self._indexed = len(self)
        last = self.records[-1] if self.records else None
        begin, digest = (0, None) if last is None else (last.end, last.digest)
        for line, entry in self.entries(len(self), begin, digest):
            self.records.append(entry.record(line))

    def _is_indexed(self) -> bool:
        """Whether the index is one of this log, up to some line, and has only what some run could have come to.

        The first line follows from the settings, and the last one from all others.
        """
        ends = [0, *(record.end for record in self.records)]
        places = zip(self.records, enumerate(ends), strict=False)
        if any((record.index, record.begin) != place for record, place in places):
            return False
        elites = self._indexed_state.elites if self._indexed_state is not None else ()
        if not all(_is_possible(each, self.settings) for each in self.records) or any(
            self.records[each].score is None for each in elites
        ):
            return False
        try:
            return not self.records or all(self._line(index) is not None for index in (0, len(self) - 1))
        except RunError:
            return False

    def _line(self, index: int) -> Line | None:
        """Reads the line of a candidate; None where it is not the one that the index has.

        Raises:
            RunError: It is damaged (`log_damaged`), or cannot be read (`no_run`).
        """
        record, before = self.records[index], self.records[index - 1].digest if index else None
        line = next(self._log.lines(index, record.begin, before), None)
        same = line is not None and (line.end, line.digest) == (record.end, record.digest)
        return line if same else None

    def entries(self, number: int = 0, begin: int = 0, digest: str | None = None) -> Iterator[tuple[Line, Entry]]:
        """Reads the log itself, from a place on that `RunLog.lines` describes.

        Yields:
            Each line, and the entry in it.

        Raises:
            RunError: A line is damaged (`log_damaged`), or the log cannot be read (`no_run`).
        """
        for index, line in enumerate(self._log.lines(number, begin, digest), number):
            with self._whole(index):
                entry = Entry.parse(line.content, index, self.settings)
            yield line, entry

    def entry(self, index: int) -> Entry:
        """Returns the log's entry of a candidate.

        Raises:
            RunError: Its line is damaged (`log_damaged`).
        """
        line = self._line(index)
        if line is None:
            raise self._log.damaged(index + 1, "it is not the line of which the index was made")
        with self._whole(index):
            return Entry.parse(line.content, index, self.settings)

    @contextmanager
    def _whole(self, index: int) -> Iterator[None]:
        """Says of a document in the log that is none that the log is damaged."""
        try:
            yield
        except DocumentError as error:
            raise self._log.damaged(index + 1, f"it is no record of candidate {index}: {error.message}") from error

    # -- going on --------------------------------------------------------------------------------------------------

    def extend(self, budget: int) -> None:
        """Gives the run another budget, which is kept once `advance` has told the algorithm what the log has.

        Raises:
            RunError: It has been told more already (`budget_spent`).
            DocumentError: No run may have it.
        """
        if budget < len(self):
            raise RunError("budget_spent", f"{self.folder} has {len(self):,} candidates already, more than {budget:,}")
        self.settings = self.settings.with_budget(budget)

    def differences(self) -> dict[str, tuple[str, str]]:
        """Returns the decisive items of the fingerprint that are otherwise here than in the run, with both values."""
        then, now = self.fingerprint, self.settings.fingerprint()
        ours = {name: (then.get(name, ""), now[name]) for name in ("draws", "algorithm")}
        return differences(then, now) | {name: pair for name, pair in ours.items() if pair[0] != pair[1]}

    def advance(self, pool: Pool, telling: Telling | None = None) -> Generator[Record, None, None]:
        """Goes on until the budget is spent. Whoever takes no more records interrupts the run.

        Args:
            pool: Who evaluates.
            telling: Called while the algorithm is told what the log has, with how much it was told and how much it
                will be.

        Yields:
            The record of each candidate once it is told.

        Raises:
            RunError: Another process goes on with the run (`run_busy`), other numbers would come out here
                (`not_comparable`), the log is damaged (`log_damaged`), or the folder cannot be written
                (`cannot_write`). What was told before is kept.
            VariationError: The algorithm finds no candidate.
            MachineError: Workers are killed (`worker_killed`).
        """
        if different := self.differences():
            pairs = "; ".join(
                f"{name}: {then or 'none'}, here {now or 'none'}" for name, (then, now) in different.items()
            )
            raise RunError("not_comparable", f"{self.folder} was begun where other numbers come out ({pairs})")
        writer = RunWriter(self._log)
        try:
            self._read()  # another process may have gone on since
            end, digest = (self.records[-1].end, self.records[-1].digest) if self.records else (0, self._log.origin)
            writer.resume(end, digest, f'{{"index":{len(self)},'.encode())
            index = self._index.write(anew=not self._indexed)
            try:
                yield from self._advance(pool, writer, index, telling)
            finally:
                index.close()
        except sqlite3.Error as error:
            what = f"cannot write the index in {self.folder}: {error}; make room, if there is none; {MADE_ANEW}"
            raise RunError("cannot_write", what) from error
        finally:
            pool.stop()
            writer.close()

    def _advance(self, pool: Pool, writer: RunWriter, index: IndexWriter, telling: Telling | None) -> Iterator[Record]:
        order = Order(self.settings.begin(), self.settings.budget, len(self))
        queue = EvaluationQueue(self.settings.task, self.settings.seeds, pool)
        asked: dict[int, Candidate] = {}
        early: dict[int, Evaluation] = {}

        def ask() -> None:
            for number, candidate in order.due():
                asked[number] = candidate
                queue.put(number, candidate.genome, candidate.rivals)

        for record in self.replay(order, ask):
            if telling is not None:
                telling(record.index + 1, len(self))
        self._keep_budget()  # now, as a log that is damaged changes nothing
        try:
            while order.told < self.settings.budget:
                ask()
                early.update(queue.take())
                ready = range(order.told, next(number for number in count(order.told) if number not in early))
                settings, expressions = self.settings, self._expressions
                entries = [told(each, asked[each], early.pop(each), settings, expressions) for each in ready]
                for entry, line in zip(entries, writer.append([entry.content for entry in entries]), strict=True):
                    ask()
                    record = entry.record(line)
                    self.records.append(record)
                    order.tell(asked.pop(record.index), entry.score)
                    yield record
                if len(self) >= self._indexed + _INDEXED:
                    self._put(index, order)
        finally:
            if order.told == len(self):
                self._put(index, order)

    def _keep_budget(self) -> None:
        """Writes the run's budget into its folder, where that has another."""
        if self._document["budget"] != self.settings.budget:
            self._document = {**self._document, "budget": self.settings.budget}
            write_whole(self.folder / SETTINGS, text_of(self._document))

    def _put(self, index: IndexWriter, order: Order) -> None:
        """Brings the index up to what was told."""
        self._state = State(order.told, tuple(order.algorithm.elites()), dict(order.algorithm.figures()))
        index.put(self.records[self._indexed :], self._state)
        self._indexed, self._indexed_state = len(self), self._state


def _is_possible(record: Record, settings: RunSettings) -> bool:
    """Whether a record is one that a candidate of a run with these settings could have."""
    numbers = (*record.objectives, *record.measures)
    if record.score is None:
        return record.error is not None and not numbers and settings.in_turn(record.index, record.group)
    counts = len(record.objectives), len(record.measures)
    return (
        counts == (len(settings.objectives), len(settings.measures))
        and all(map(isfinite, (record.score, *numbers)))
        and settings.in_turn(record.index, record.group)
    )
