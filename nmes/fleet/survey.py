"""A survey: a creature in each of thousands of worlds, all of them scored, in a folder like a run's.

It hides which world has which task, seed and creature, how worlds are shared among workers, and how the log stays in
their order. Invariants: what is known of a world follows from the settings and its number alone, so the digest is the
same for any number of workers and after any kill; any world can be evaluated again by itself.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from itertools import takewhile
from pathlib import Path
from typing import Any, Final, Literal

import orjson

from nmes.backend import load_backend
from nmes.backend.fingerprint import differences, fingerprint
from nmes.errors import DocumentError, MachineError, RunError
from nmes.evaluation.again import MODEL, drawn, has_model, unforeseen
from nmes.evaluation.evaluation import Evaluation
from nmes.evaluation.evaluator import Job, evaluate_portion
from nmes.evaluation.judge import Result
from nmes.evaluation.parallel import Lost, Pool
from nmes.evaluation.queue import CRASHES
from nmes.evaluation.task import Task
from nmes.evolution.run_folder import begin_run, open_run
from nmes.evolution.run_log import Line, RunLog, RunWriter
from nmes.fleet.atlas import GRAVITIES, HEIGHTS, atlas
from nmes.genome import Genome
from nmes.schemas.documents import JsonObject, canonical_hash, check, compile_schema, complete, write_json
from nmes.variation.draw import Draw
from nmes.variation.random_genomes import random_genome

__all__ = ["FORMAT", "Survey", "SurveySettings", "SurveyVerdict", "SurveyedWorld", "verify_survey"]

FORMAT: Final = "nmes-survey/1"
_SURVEY: Final = compile_schema("survey.json")
_RECORD: Final = compile_schema("survey_record.json")
_SEEDS: Final = 1_000_000  # of each survey: none has more worlds
_CHUNK: Final = 600  # worlds that are shared out at once, and written to the log together
_TOGETHER: Final = 10  # worlds of one task and creature that a worker is given at once
_TRIES: Final = 2
_MOST: Final = 20  # findings that are kept

Progress = Callable[[int, int], None]


class SurveySettings:
    """What a survey is about.

    Attributes:
        document: All of it, as `schemas/survey.json` says, but for the fingerprint.
        tasks: The tasks, row by row.
        genomes: The creatures; none: random ones.
        worlds: How many there are.
        seed: The survey's.
        rows: What rows of tasks have in common.
        columns: What columns have.
    """

    def __init__(self, document: JsonObject) -> None:
        """Reads a document that the schema has checked.

        Raises:
            DocumentError: A task or a genome is none, or rows and columns are not those of the tasks.
        """
        self.document = document
        self.worlds: int = document["worlds"]
        self.seed: int = document["seed"]
        self.tasks = [Task(task) for task in document["tasks"]]
        self.genomes = [Genome(genome) for genome in document["genomes"]]
        self.rows: list[str] = document["rows"]
        self.columns: list[str] = document["columns"]
        if len(self.rows) * len(self.columns) != len(self.tasks):
            told = f"{len(self.rows)} rows of {len(self.columns)} columns are not {len(self.tasks)} tasks"
            raise DocumentError([("rows", told)])

    @classmethod
    def of(cls, genomes: Sequence[Genome], tasks: Sequence[Task], worlds: int, seed: int) -> SurveySettings:
        """Makes settings: of the atlas, where there are no tasks; of random creatures, where there are no genomes.

        Raises:
            DocumentError: There are too many of something, or a brain is none for its body.
            MissingPackage: A brain needs a package that is not installed.
        """
        for genome in genomes:
            genome.check_brain()
        rows, columns = [""], [task.name for task in tasks]
        if not tasks:
            rows = [f"gravity {gravity:g}" for gravity in GRAVITIES]
            columns = [f"hills of {height:g} m" for height in HEIGHTS]
        document = {
            "format": FORMAT,
            "worlds": worlds,
            "seed": seed,
            "tasks": [task.document for task in tasks] or [Task(task).document for task in atlas()],
            "rows": rows,
            "columns": columns,
            "genomes": [genome.document for genome in genomes],
        }
        check(_SURVEY, {**document, "fingerprint": {}})
        return cls(document)

    def fingerprint(self) -> dict[str, str]:
        """Returns the fingerprint of this machine: of the engines, and of the draws of random creatures."""
        items: dict[str, str] = {}
        engines = sorted({task.world_config(0)["backend"] for task in self.tasks})
        for engine in engines:
            for name, value in fingerprint(load_backend(engine)).items():
                own = len(engines) > 1 and (name == "probe" or name.startswith("engine."))
                items[f"engine.{engine}.{name.removeprefix('engine.')}" if own else name] = value
        items["backend"] = ", ".join(engines)
        if not self.genomes:
            draw = Draw(0, "fingerprint")
            drawn = [[draw.normal(), draw.uniform(-1.0, 1.0), draw.count(0, 1 << 40)] for _ in range(100)]
            items["draws"] = sha256(orjson.dumps(drawn)).hexdigest()
        return items

    def task(self, world: int) -> Task:
        """Returns the task of a world."""
        return self.tasks[world % len(self.tasks)]

    def seed_of(self, world: int) -> int:
        """Returns the seed of a world, which no other world of any survey has."""
        return self.seed * _SEEDS + world

    def genome(self, world: int) -> Genome:
        """Returns the creature of a world."""
        if self.genomes:
            return self.genomes[world // len(self.tasks) % len(self.genomes)]
        draw = Draw(self.seed, "survey", world)
        return random_genome(draw, self.task(world).requirements, f"random-{world}")


@dataclass(frozen=True, slots=True)
class SurveyedWorld:
    """How the creature of a world did.

    Attributes:
        world: The number of the world.
        genome_hash: Of the creature's genome.
        result: How the episode came out; None where the creature could not be evaluated.
        error: Why it could not.
        end: Where its line in the log ends, bytes.
        digest: Of all lines up to this one.
    """

    world: int
    genome_hash: str
    result: Result | None
    error: str | None
    end: int = 0
    digest: str = ""

    @property
    def score(self) -> float | None:
        """The score; None where there is none."""
        return None if self.result is None else self.result.score

    @classmethod
    def of_line(cls, line: Line) -> SurveyedWorld:
        """Reads a line of a log.

        Raises:
            DocumentError: It is none of a survey.
        """
        try:
            record = orjson.loads(line.content)
        except orjson.JSONDecodeError as error:
            raise DocumentError([("", f"not strict JSON: {error}")]) from error
        check(_RECORD, record)
        record = complete(_RECORD.schema, record)
        result = None if record["result"] is None else Result(**record["result"])
        return cls(record["world"], record["genome_hash"], result, record["error"], line.end, line.digest)

    def record(self) -> JsonObject:
        """Returns its record in the log."""
        result = None if self.result is None else self.result.to_json()
        return {"world": self.world, "genome_hash": self.genome_hash, "result": result, "error": self.error}


class Survey:
    """A survey in a folder; `create` and `open` give one.

    Attributes:
        folder: The folder.
        settings: What it is about.
        fingerprint: Of what computes it.
        worlds: Those that are done, in order.
    """

    def __init__(self, folder: Path, document: JsonObject) -> None:
        """Reads what is there; `document` is what the folder's `run.json` holds."""
        check(_SURVEY, document)
        document = complete(_SURVEY.schema, document)
        self.folder = folder
        self.settings = SurveySettings({name: value for name, value in document.items() if name != "fingerprint"})
        self.fingerprint: dict[str, str] = document["fingerprint"]
        self._log = RunLog(folder / "log.jsonl", canonical_hash(self.settings.document))
        self.worlds: list[SurveyedWorld] = []
        self._read()

    @classmethod
    def create(cls, folder: str | os.PathLike[str], settings: SurveySettings) -> Survey:
        """Makes a folder for a survey that has not begun yet.

        Raises:
            RunError: There is a run in it (`run_exists`), or it cannot be written (`cannot_write`).
        """
        document = {**settings.document, "fingerprint": settings.fingerprint()}
        begin_run(Path(folder), document)
        return cls(Path(folder), document)

    @classmethod
    def open(cls, folder: str | os.PathLike[str]) -> Survey:
        """Reads the survey in a folder, also one that another process goes on with.

        Raises:
            RunError: There is none, or none of this format (`no_run`), or its log is damaged (`log_damaged`).
        """
        return open_run(folder, FORMAT, cls)

    def __len__(self) -> int:
        return len(self.worlds)

    @property
    def digest(self) -> str:
        """Of settings and all worlds that are done, 32 hexadecimal digits: equal digests, equal surveys."""
        return self.worlds[-1].digest if self.worlds else self._log.origin[:32]

    @property
    def finished(self) -> bool:
        """Whether all worlds are done."""
        return len(self) >= self.settings.worlds

    @property
    def best(self) -> SurveyedWorld | None:
        """The first world of those with the highest score; None where there is no score."""
        scored = [(world.score, -world.world, world) for world in self.worlds if world.score is not None]
        return max(scored, key=lambda each: each[:2])[2] if scored else None

    def differences(self) -> dict[str, tuple[str, str]]:
        """Returns the decisive items of the fingerprint that are otherwise here than there, with both values."""
        then, now = self.fingerprint, self.settings.fingerprint()
        draws = then.get("draws", ""), now.get("draws", "")
        return differences(then, now) | ({"draws": draws} if draws[0] != draws[1] else {})

    def departure(self, world: int) -> RunError:
        """Returns the error for a world that does not come out as the log has it: `diverged`, or `not_comparable`."""
        what = f"world {world} does not come out again as the log of {self.folder} has it"
        if self.differences():
            return RunError("not_comparable", f"{what}: it was begun where other numbers come out")
        if has_model([self.settings.genome(world).document]):
            return RunError("not_comparable", f"{what}: {MODEL}")
        return RunError("diverged", what)

    def _read(self) -> None:
        """Reads what the log has more than is known."""
        last = self.worlds[-1] if self.worlds else None
        begin, digest = (0, None) if last is None else (last.end, last.digest)
        for line in self._log.lines(len(self.worlds), begin, digest):
            number = len(self.worlds)
            try:
                world = SurveyedWorld.of_line(line)
                if world.world != number:
                    raise DocumentError([("world", f"must be {number}, not {world.world}")])
                if number >= self.settings.worlds:
                    raise DocumentError([("world", f"there are {self.settings.worlds:,} worlds")])
            except DocumentError as error:
                message = f"it is no record of world {number} ({error.message})"
                raise self._log.damaged(number + 1, message) from error
            self.worlds.append(world)

    def advance(self, pool: Pool, progress: Progress) -> Generator[list[SurveyedWorld], None, None]:
        """Goes on until all worlds are done. Whoever takes no more interrupts the survey.

        Args:
            pool: Who evaluates.
            progress: Called with how many worlds are done, those included that are not in the log yet, and how many
                there are.

        Yields:
            Worlds once they are in the log, as soon as all before them are done.

        Raises:
            RunError: Another process goes on with it (`run_busy`), other numbers would come out here
                (`not_comparable`), the log is damaged (`log_damaged`), or the folder cannot be written
                (`cannot_write`). What was done before is kept.
            MachineError: Workers are killed (`worker_killed`).
            MissingPackage: A brain needs a package that is not installed.
            VariationError: There is no random creature that meets what a task requires.
        """
        if different := self.differences():
            pairs = "; ".join(f"{name}: {a or 'none'}, here {b or 'none'}" for name, (a, b) in different.items())
            raise RunError("not_comparable", f"{self.folder} was begun where other numbers come out ({pairs})")
        writer = RunWriter(self._log)
        try:
            self._read()  # another process may have gone on since
            last = self.worlds[-1] if self.worlds else None
            end, digest = (0, self._log.origin) if last is None else (last.end, last.digest)
            writer.resume(end, digest, f'{{"world":{len(self)},'.encode())
            while not self.finished:
                begin = len(self)
                numbers = range(begin, min(begin + _CHUNK, self.settings.worlds))
                for done in survey_worlds(
                    self.settings, numbers, pool, partial(_tell, progress, begin, self.settings.worlds)
                ):
                    lines = writer.append([world.record() for world in done])
                    written = [
                        replace(world, end=line.end, digest=line.digest)
                        for world, line in zip(done, lines, strict=True)
                    ]
                    self.worlds += written
                    yield written
        finally:
            writer.close()


def survey_worlds(
    settings: SurveySettings,
    numbers: Iterable[int],
    pool: Pool,
    progress: Callable[[int], None],
) -> Generator[list[SurveyedWorld], None, None]:
    """Evaluates the creatures of some worlds.

    Args:
        settings: The survey's.
        numbers: Of the worlds.
        pool: Who does it.
        progress: Called with how many are done.

    Yields:
        How they did, in the order of the numbers, as soon as all before are done.

    Raises:
        MachineError: Workers are killed (`worker_killed`).
        VariationError: There is no random creature that meets what a task requires.
    """
    numbers = list(numbers)
    genomes = {number: settings.genome(number) for number in numbers}
    texts = [write_json(task.document) for task in settings.tasks]
    alike: dict[tuple[int, str], list[int]] = {}
    for number in numbers:
        alike.setdefault((number % len(texts), genomes[number].hash), []).append(number)
    portions = [
        worlds[place : place + _TOGETHER] for worlds in alike.values() for place in range(0, len(worlds), _TOGETHER)
    ]

    def job(worlds: Sequence[int]) -> Job:
        genome, seeds = genomes[worlds[0]], tuple(map(settings.seed_of, worlds))
        return Job(genome.name, write_json(genome.document), texts[worlds[0] % len(texts)], seeds)

    found: dict[int, SurveyedWorld] = {}
    given = 0  # of the numbers, those that were yielded
    lost: dict[int, int] = {}  # how often worlds were lost by themselves
    while portions:
        again: list[list[int]] = []
        for index, results in pool.run(evaluate_portion, [[job(worlds)] for worlds in portions]):
            worlds = portions[index]
            if isinstance(results, Lost):
                if len(worlds) > 1:
                    again += [[world] for world in worlds]  # one of them did it; the others are done without it
                    continue
                lost[worlds[0]] = lost.get(worlds[0], 0) + 1
                if lost[worlds[0]] < _TRIES:
                    again.append(worlds)
                    continue
                if not any(crash in results.reason for crash in CRASHES):
                    # It may be the machine's doing, as where memory is short: then it says nothing of the creature.
                    what = f"over world {worlds[0]:,} {results.reason}, {_TRIES} times"
                    raise MachineError("worker_killed", f"{what}: is there memory enough, with fewer jobs?")
                evaluation = job(worlds).failed(results.reason)
            else:
                (outcome,) = results
                assert isinstance(outcome, Evaluation)  # nothing is recorded
                evaluation = outcome
            for place, world in enumerate(worlds):
                result = evaluation.results[place] if evaluation.error is None else None
                found[world] = SurveyedWorld(world, genomes[world].hash, result, evaluation.error)
            progress(len(found))
            if ready := [found[number] for number in takewhile(found.__contains__, numbers[given:])]:
                given += len(ready)
                yield ready
        portions = again


@dataclass(frozen=True, slots=True)
class SurveyVerdict:
    """What came out when a survey was verified.

    Attributes:
        verdict: It `holds`; it is `broken`, since something did not come out as the log has it; or it is
            `not_comparable`: that may be because it was begun where other numbers come out, or has ONNX brains.
        findings: What did not, the first of them, in words.
        worlds: How many the log has.
        evaluated: How many were evaluated again.
        seed: Of the draw by which these were chosen.
        digest: The survey's.
    """

    verdict: Literal["holds", "broken", "not_comparable"]
    findings: tuple[str, ...]
    worlds: int
    evaluated: int
    seed: int
    digest: str


def verify_survey(
    folder: Path, pool: Pool, sample: int | None, progress: Progress, seed: int | None = None
) -> SurveyVerdict:
    """Evaluates worlds of a survey again, and compares every figure, to the last bit, with its log.

    Args:
        folder: The survey's.
        pool: Who evaluates.
        sample: How many worlds beside the best, drawn by the seed and the survey's digest; None: all.
        progress: Called with how many are done, and how many there are.
        seed: Of the draw; None: one that nobody can foresee.

    Raises:
        RunError: There is no survey, or it cannot be read (`no_run`).
        MachineError: Workers are killed (`worker_killed`).
    """
    seed = unforeseen(seed)
    try:
        survey = Survey.open(folder)
    except RunError as error:
        if error.code != "log_damaged":
            raise
        return SurveyVerdict("broken", (error.message,), 0, 0, seed, "")
    chosen = list(range(len(survey)))
    if sample is not None:
        best = [] if survey.best is None else [survey.best.world]
        others = [world for world in chosen if world not in best]
        chosen = sorted([*best, *drawn(others, sample, Draw(seed, "verify", survey.digest))])
    findings: list[str] = []
    excused = True  # all that came out otherwise is of ONNX brains
    for begin in range(0, len(chosen), _CHUNK):
        numbers = chosen[begin : begin + _CHUNK]
        for again in survey_worlds(survey.settings, numbers, pool, partial(_tell, progress, begin, len(chosen))):
            for world in again:
                found = _compare(survey.worlds[world.world], world)
                if found and has_model([survey.settings.genome(world.world).document]):
                    found = [f"{text}; {MODEL}" for text in found]
                elif found:
                    excused = False
                findings += found
    findings = findings[:_MOST]
    beyond = bool(findings) and (excused or bool(survey.differences()))
    verdict: Any = "holds" if not findings else "not_comparable" if beyond else "broken"
    return SurveyVerdict(verdict, tuple(findings), len(survey), len(chosen), seed, survey.digest)


def _compare(told: SurveyedWorld, again: SurveyedWorld) -> list[str]:
    """Returns in what a world did not come out as the log has it, in words."""
    if told.record() == again.record():
        return []
    if told.genome_hash != again.genome_hash:
        return [f"world {told.world}: its creature is another than the log says"]
    if told.result is None or again.result is None:
        return [f"world {told.world}: {again.error or 'it has a result'}, where the log has {told.error or 'a result'}"]
    then, now = told.result.to_json(), again.result.to_json()
    name = next(name for name in then if then[name] != now[name])
    return [f"world {told.world}: {name} is {now[name]}, not {then[name]}"]


def _tell(progress: Progress, before: int, total: int, done: int) -> None:
    progress(before + done, total)
