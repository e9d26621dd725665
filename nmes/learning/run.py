"""A run of learning in a folder: its settings, a log of its legs, and the states from which it goes on.

    run = LearningRun.create("runs/mine", LearningSettings.read(document))
    for record in run.advance(threads=2):
        print(record.leg, record.returned, record.score)
    print(run.digest)

Hides which states are kept, and what is found again after a kill. Invariants:

- The log follows from the settings alone: neither threads nor where a run was interrupted shows in it.
- The state of a leg is kept before the leg is in the log. What a kill takes away is a leg that is in no log.
- What the folder holds is not believed: a state counts only where its digest is that of the log, and what is done
  again must come out as the log has it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import orjson

from nmes.backend.fingerprint import differences
from nmes.errors import DocumentError, RunError
from nmes.evaluation.setting import task_identity
from nmes.evolution.run_folder import begin_run, open_run, require_no_run, text_of
from nmes.evolution.run_log import Line, RunLog, RunWriter, write_whole
from nmes.genome import Genome
from nmes.learning.legs import Learning
from nmes.learning.settings import FORMAT, LearningSettings
from nmes.learning.state import State, read_state, state_digest, write_state
from nmes.schemas.documents import JsonObject, canonical_hash, check, compile_schema, complete
from nmes.schemas.files import read_regular

__all__ = ["LearningRun", "Leg"]

_RECORD: Final = compile_schema("learning_record.json")
_KEPT: Final = 16  # states beside the last: from each of them the run can be proved
_LARGEST: Final = 1 << 30  # bytes of a state, or of the best creature
_STATE: Final = re.compile(r"(\d{1,12})\.state")


@dataclass(frozen=True, slots=True)
class Leg:
    """What the log says of a leg; see `schemas/learning_record.json`.

    Attributes:
        leg: Its number, from 1 on.
        steps: How many steps were learned from up to its end.
        returned: The mean sum of rewards of the episodes that were over in it; None: there were none.
        score: Of the brain on the task's seeds; None: it was not scored, or has no score.
        content: All of it.
        end: Where its line ends, bytes.
        digest: Of all lines up to this one.
    """

    leg: int
    steps: int
    returned: float | None
    score: float | None
    content: JsonObject
    end: int
    digest: str

    @classmethod
    def of(cls, line: Line) -> Leg:
        """Reads a line.

        Raises:
            DocumentError: It is none of a run of learning.
        """
        try:
            content = orjson.loads(line.content)
        except orjson.JSONDecodeError as error:
            raise DocumentError([("", f"not strict JSON: {error}")]) from error
        check(_RECORD, content)
        content = complete(_RECORD.schema, content)
        leg, steps, returned, score = (content[name] for name in ("leg", "steps", "return", "score"))
        return cls(leg, steps, returned, score, content, line.end, line.digest)


class LearningRun:
    """A run in a folder; `create` and `open` give one.

    Attributes:
        folder: The folder.
        settings: What the run is about.
        fingerprint: Of what computes it.
        legs: Those that are done, in order.
    """

    def __init__(self, folder: Path, document: JsonObject) -> None:
        self.folder = folder
        self.settings = LearningSettings.reopen(document)
        self.fingerprint: dict[str, str] = document.get("fingerprint", {})
        decisive = {name: value for name, value in document.items() if name not in ("fingerprint", "recordings")}
        decisive["task"] = task_identity(document["task"])
        self._log = RunLog(folder / "log.jsonl", canonical_hash(decisive))
        self.legs: list[Leg] = []
        self._read()

    @classmethod
    def create(cls, folder: str | os.PathLike[str], settings: LearningSettings) -> LearningRun:
        """Makes a folder for a run that has not begun yet.

        Raises:
            RunError: There is a run in it (`run_exists`), or it cannot be written (`cannot_write`).
            WorldError, RecordingError, ProofError: It could not begin; see `Learning`. No folder is made.
        """
        path = Path(folder)
        require_no_run(path, "genome.json", "states")
        Learning(settings).close()
        document = {**settings.document, "fingerprint": settings.fingerprint()}
        begin_run(path, document)
        return cls(path, document)

    @classmethod
    def open(cls, folder: str | os.PathLike[str]) -> LearningRun:
        """Reads the run in a folder, also one that another process goes on with.

        Raises:
            RunError: There is none, or none of this format (`no_run`), or its log is damaged (`log_damaged`).
        """
        return open_run(folder, FORMAT, cls)

    # -- what is there ---------------------------------------------------------------------------------------------

    @property
    def digest(self) -> str:
        """Of settings and all legs, 32 hexadecimal digits: equal digests, equal histories."""
        return self.legs[-1].digest if self.legs else self._log.origin[:32]

    @property
    def steps(self) -> int:
        """How many steps were learned from: more than the settings say where the last leg went on beyond them."""
        return self.legs[-1].steps if self.legs else 0

    @property
    def finished(self) -> bool:
        """Whether as many steps were learned from as the settings say."""
        return self.steps >= self.settings.steps

    @property
    def progress(self) -> str:
        """How many steps were learned from, of how many, in words."""
        asked = f"{self.settings.steps:,}"
        return f"{self.steps:,} of {asked if self.steps <= self.settings.steps else f'at least {asked}'}"

    @property
    def best(self) -> Leg | None:
        """The first of the legs with the highest score; None where none has one."""
        scored = (leg for leg in self.legs if leg.score is not None)
        return max(scored, key=lambda leg: (leg.score or 0.0, -leg.leg), default=None)

    def genome(self) -> Genome | None:
        """Returns the creature with the best brain, from the run's folder; None where no brain has a score.

        Raises:
            RunError: It is not the one of which the log tells (`log_damaged`).
        """
        best = self.best
        if best is None:
            return None
        path = self.folder / "genome.json"
        try:
            genome = Genome.parse(read_regular(path, _LARGEST))
        except (OSError, DocumentError) as error:
            raise RunError("log_damaged", f"{path} is missing or damaged: resume the run, which writes it") from error
        if genome.hash != best.content["genome_hash"]:
            raise RunError("log_damaged", f"{path} is not the best of its run: resume the run, which writes it")
        return genome

    def has_genome(self) -> bool:
        """Whether the creature with the best brain is in the run's folder."""
        try:
            return self.genome() is not None
        except RunError:
            return False

    def _read(self) -> None:
        """Reads what the log has more than is known."""
        last = self.legs[-1] if self.legs else None
        begin, digest = (0, None) if last is None else (last.end, last.digest)
        for line in self._log.lines(len(self.legs), begin, digest):
            number = len(self.legs) + 1
            try:
                leg = Leg.of(line)
                if leg.leg != number:
                    raise DocumentError([("leg", f"must be {number}, not {leg.leg}")])
            except DocumentError as error:
                raise self._log.damaged(number, f"it is no record of leg {number} ({error.message})") from error
            self.legs.append(leg)

    # -- states ----------------------------------------------------------------------------------------------------

    def state(self, leg: int) -> State | None:
        """Returns the state after a leg that the log has; None where it is not kept, or is not that of the log."""
        try:
            state = read_state(read_regular(self._state_path(leg), _LARGEST))
        except (OSError, ValueError):
            return None  # what it was can be computed again
        return state if state_digest(state) == self.legs[leg - 1].content["state"] else None

    def kept(self) -> list[int]:
        """Returns the legs whose states are in the folder, in order."""
        try:
            names = sorted(os.listdir(self.folder / "states"))
        except OSError:
            return []
        numbers = [int(found[1]) for name in names if (found := _STATE.fullmatch(name))]
        return sorted(number for number in numbers if 1 <= number <= len(self.legs))

    def _state_path(self, leg: int) -> Path:
        return self.folder / "states" / f"{leg:06d}.state"

    def nearest(self, leg: int) -> tuple[int, State | None]:
        """Returns the last leg up to this one whose state is whole, and the state; 0 where the run must begin anew."""
        for number in reversed([number for number in self.kept() if number <= leg]):
            if (state := self.state(number)) is not None:
                return number, state
        return 0, None

    def _forget(self, learning: Learning) -> None:
        """Removes states that are needed no more: all but a few, evenly, and the last two."""
        apart = -(-learning.legs // _KEPT)
        for number in self.kept():
            if number % apart and number < len(self.legs) - 1:
                self._state_path(number).unlink(missing_ok=True)

    # -- going on --------------------------------------------------------------------------------------------------

    def differences(self) -> dict[str, tuple[str, str]]:
        """Returns the decisive items of the fingerprint that are otherwise here than in the run, with both values."""
        then, now = self.fingerprint, self.settings.fingerprint()
        ours = then.get("learner", ""), now["learner"]
        return differences(then, now) | ({"learner": ours} if ours[0] != ours[1] else {})

    def advance(self, threads: int = 1) -> Iterator[Leg]:
        """Goes on to the end. Whoever takes no more legs interrupts the run.

        Args:
            threads: How many step the engine.

        Yields:
            Each leg once it is in the log.

        Raises:
            RunError: Another process goes on with the run (`run_busy`), other numbers would come out here
                (`not_comparable`), what is done again comes out otherwise (`diverged`), the log is damaged
                (`log_damaged`), recordings have changed (`recordings_changed`), learning comes to numbers that are too
                large (`not_finite`), or the folder cannot be written (`cannot_write`). What was done before is kept.
            WorldError, RecordingError, ProofError: As `Learning`.
        """
        if different := self.differences():
            pairs = "; ".join(f"{name}: {a or 'none'}, here {b or 'none'}" for name, (a, b) in different.items())
            raise RunError("not_comparable", f"{self.folder} was begun where other numbers come out ({pairs})")
        writer = RunWriter(self._log)
        try:
            self._read()  # another process may have gone on since
            last = self.legs[-1] if self.legs else None
            end, digest = (0, self._log.origin) if last is None else (last.end, last.digest)
            writer.resume(end, digest, f'{{"leg":{len(self.legs) + 1},'.encode())
            learning = Learning(self.settings, threads)
            try:
                yield from self._advance(learning, writer)
            finally:
                learning.close()
        finally:
            writer.close()

    def _advance(self, learning: Learning, writer: RunWriter) -> Iterator[Leg]:
        self.catch_up(learning, len(self.legs))
        self._write_champion(learning)
        while learning.leg < learning.legs:
            content = learning.go()
            self._write_state(learning)
            if learning.champion is not None and learning.champion.leg == learning.leg:
                self._write_champion(learning)
            (line,) = writer.append([content])
            self.legs.append(Leg.of(line))
            self._forget(learning)
            yield self.legs[-1]

    def catch_up(self, learning: Learning, leg: int) -> None:
        """Brings learning to where the run was after a leg: from the nearest state, and doing again what is between.

        Raises:
            RunError: Something comes out otherwise than the log has it (`diverged`).
        """
        number, state = self.nearest(leg)
        if state is not None:
            try:
                learning.restore(number, state)
            except ValueError as error:
                raise RunError("log_damaged", f"{self._state_path(number)} is not of this run: {error}") from error
        while learning.leg < leg:
            again = learning.go()
            if found := self.otherwise(again):
                raise RunError("diverged", f"{self.folder} does not come out as its log says ({found})")

    def otherwise(self, again: Mapping[str, Any]) -> str:
        """Returns in what a leg that was done again is not as the log has it, in words; empty where it is the same."""
        logged = self.legs[again["leg"] - 1].content
        for name, value in orjson.loads(orjson.dumps(again)).items():
            if logged[name] != value:
                return f"leg {again['leg']}: {name} is {logged[name]!r} in the log, and comes out as {value!r}"
        return ""

    def _write_state(self, learning: Learning) -> None:
        path = self._state_path(learning.leg)
        try:
            path.parent.mkdir(exist_ok=True)
        except OSError as error:
            raise RunError("cannot_write", f"cannot make the folder {path.parent}: {error.strerror}") from error
        write_whole(path, write_state(learning.state()))

    def _write_champion(self, learning: Learning) -> None:
        if learning.champion is not None:
            write_whole(self.folder / "genome.json", text_of(learning.champion.genome.document))
