"""The score of a creature on a task: the same figure every time, alone or beside others, here or in many processes.

An evaluation runs an `Episode` for each seed, in a world of its own, from a genome's brain instead of a socket.

Invariants:

- The score is a function of genome, task and seed, and of the fingerprint (versions, binaries, probe): never of
  what was evaluated before or beside it.
- A creature that cannot be evaluated, or an episode that fails however it may, is a result like any other, with its
  reason.
"""

from __future__ import annotations

import os
import re
import secrets
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Final, Self, SupportsIndex

import orjson

from nmes import protocol
from nmes.backend import load_backend
from nmes.backend.fingerprint import decisive, fingerprint
from nmes.brain import Brain
from nmes.errors import MACHINE_ERRORS, DocumentError, MissingPackage, NmesError, RecordingError
from nmes.evaluation.episode import METADATA, Episode
from nmes.evaluation.evaluation import Evaluation
from nmes.evaluation.judge import Result
from nmes.evaluation.parallel import Here, Lost, Workers, open_pool
from nmes.evaluation.population import admit, guarded, run_alone, run_population
from nmes.evaluation.portions import cut
from nmes.evaluation.seeding import read_seeds
from nmes.evaluation.task import Task, TaskLike
from nmes.genome import Genome
from nmes.genome.genome import GenomeLike
from nmes.recording import Recorder
from nmes.recording.signed import require_unsigned
from nmes.schemas.documents import write_json
from nmes.world import World

__all__ = [
    "Evaluator",
    "Job",
    "episode_metadata",
    "evaluate",
    "evaluate_portion",
    "file_name",
    "recorded",
    "recording_name",
]

_POSE_RATE: Final = 1.0  # Hz; pictures for viewers cost as much as all else that is recorded, and follow from it


def evaluate(
    genome: GenomeLike,
    task: TaskLike,
    *,
    seeds: Iterable[SupportsIndex] | None = None,
    record: str | os.PathLike[str] | None = None,
) -> Evaluation:
    """Runs a creature on a task, once a seed, in this process; an `Evaluator` does it in several.

    Args:
        genome: The creature: a Genome, a document, a file, or the name of one that ships.
        task: What it is asked to do, told likewise.
        seeds: Instead of the task's.
        record: An existing directory, in which a recording of each episode is left, named after genome and task,
            with their hashes, and seed. One of that name is replaced when the new one is whole, unless it is signed.

    Returns:
        The scores, in whatever the task's objective measures, and more; `error` says why a creature could not be
        evaluated, as when it is larger than the task allows.

    Raises:
        DocumentError: The genome is none, or the task.
        TypeError: A seed is no whole number.
        RecordingError: A recording cannot be written, or would replace one that is signed (`signed`): nothing has run.
        MissingPackage: The brain needs a package that is not installed, which says nothing of the creature.
    """
    genome, task = Genome.load(genome), Task.load(task)
    chosen = task.seeds if seeds is None else read_seeds(seeds)
    places = {} if record is None else _places(genome, task, chosen, record)
    for place in places.values():
        require_unsigned(place)
    begin = time.perf_counter()
    results: list[Result] = []
    recordings: list[str] = []
    error: str | None = None

    def recorded(brain: Brain | None, seed: int, path: Path) -> Result:
        result = _recorded(genome, brain, task, seed, path)
        recordings.append(str(path))
        return result

    try:
        brain = admit(genome, task)
        for seed in chosen:
            run = partial(run_alone, genome, brain, task, seed)
            if seed in places:
                run = partial(recorded, brain, seed, places[seed])
            results.append(guarded(run, seed))
    except (MissingPackage, RecordingError):
        raise
    except NmesError as refusal:
        error, results, recordings = refusal.message, [], []
    names = genome.name, genome.hash, task.name, task.hash
    return Evaluation(*names, tuple(results), error, tuple(recordings), time.perf_counter() - begin)


def file_name(name: str) -> str:
    """Returns a name as a part of a file's name."""
    return re.sub(r"[^A-Za-z0-9_]+", "-", name).strip("-").lower()[:40] or "genome"


def recording_name(genome: Genome, task: Task, seed: int) -> str:
    """Returns the name of the file of an episode's recording: the same for the same episode, and no other's."""
    return f"{file_name(genome.name)}-{genome.hash[:16]}-{task.name}-{task.hash[:16]}-{seed}.mcap"


def _places(genome: Genome, task: Task, seeds: Sequence[int], folder: str | os.PathLike[str]) -> dict[int, Path]:
    """Returns where the episode of each seed is recorded."""
    return {seed: Path(folder, recording_name(genome, task, seed)) for seed in seeds}


def _recorded(genome: Genome, brain: Brain | None, task: Task, seed: int, path: Path) -> Result:
    with recorded(path, episode_metadata(genome, task, seed)) as journal:
        world = World(task.world_config(seed))
        world.journal = journal(world)
        try:
            result = Episode(world, genome, brain, task, seed).run()
        finally:
            world.close()
        if world.fault is not None and world.fault.code == "recording_failed":
            raise RecordingError(world.fault.code, world.fault.message)
    return result


def episode_metadata(genome: Genome, task: Task, seed: int) -> dict[str, dict[str, str]]:
    """Returns the metadata records of an episode's recording."""
    return {METADATA: {"task": protocol.encode(task.document).decode(), "genome": genome.hash, "seed": str(seed)}}


@contextmanager
def recorded(path: Path, about: Mapping[str, Mapping[str, str]]) -> Iterator[Callable[[World], Recorder]]:
    """Gives what makes the journal of an episode's world, which is a recording once all has gone well.

    Args:
        path: The file; one that is there is replaced when the new one is whole.
        about: Its metadata records.

    Raises:
        RecordingError: It cannot be written, or one that is there is signed (`signed`).
    """
    require_unsigned(path)
    # So that what has the name of a recording is one; and that of two who make it none takes the other's away.
    part = path.with_suffix(f".{secrets.token_hex(8)}.part")
    recorders: list[Recorder] = []

    def journal(world: World) -> Recorder:
        recorders.append(Recorder(part, world, pose_rate=_POSE_RATE, about=about))
        return recorders[-1]

    try:
        try:
            yield journal
        finally:
            for recorder in recorders:
                recorder.close()
        part.replace(path)
    finally:
        with suppress(OSError):  # where there is no such folder either; the error on its way says so
            part.unlink(missing_ok=True)


@dataclass(frozen=True, slots=True)
class _Unrecorded:
    """A RecordingError as plain data, which can be sent from process to process."""

    code: str
    message: str


@dataclass(frozen=True, slots=True)
class Job:
    """A genome to be evaluated somewhere else: plain data, the genome not looked at yet.

    Attributes:
        name: What to call it if it turns out to be no genome.
        genome: The bytes of its file.
        task: The task's document, as JSON.
        seeds: Instead of the task's, if any are given.
        record: As for `evaluate`.
        duty: Whether to tell the duty factor.
    """

    name: str
    genome: bytes
    task: bytes
    seeds: tuple[int, ...] | None = None
    record: str | None = None
    duty: bool = False

    @property
    def key(self) -> str:
        """A hash of everything that the result depends on, what this machine computes included."""
        task = self.read_task()
        here = decisive(fingerprint(load_backend(task.world_config(0)["backend"])))
        causes = [self.genome.hex(), task.hash, self.seeds, here, *([True] if self.duty else [])]
        return sha256(orjson.dumps(causes, option=orjson.OPT_SORT_KEYS)).hexdigest()

    def read_task(self) -> Task:
        """Reads the task."""
        task = Task(orjson.loads(self.task))
        return task.with_duty() if self.duty else task

    def parse(self) -> Genome | Evaluation:
        """Reads the genome; where it is none, returns the evaluation that says so."""
        try:
            return Genome.parse(self.genome)
        except DocumentError as error:
            return self.failed(error.message)
        except MACHINE_ERRORS:
            raise
        except Exception as error:  # a mistake of ours, which this genome has found
            return self.failed(f"{type(error).__name__}: {error}")

    def places(self) -> dict[int, Path]:
        """Returns where the episode of each seed is recorded; nothing where none is, or the genome is none."""
        if self.record is None or not isinstance(genome := self.parse(), Genome):
            return {}
        task = self.read_task()
        return _places(genome, task, task.seeds if self.seeds is None else self.seeds, self.record)

    def run(self) -> Evaluation | _Unrecorded:
        """Evaluates the genome on its own; where that cannot be recorded, returns why."""
        task, genome = self.read_task(), self.parse()
        if not isinstance(genome, Genome):
            return genome
        try:
            return evaluate(genome, task, seeds=self.seeds, record=self.record)
        except RecordingError as error:
            return _Unrecorded(error.code, error.message)
        except (MissingPackage, *MACHINE_ERRORS):
            raise
        except Exception as error:  # as above
            return self.failed(f"{type(error).__name__}: {error}")

    def failed(self, error: str) -> Evaluation:
        """Returns the evaluation of a genome that could not be evaluated."""
        task = self.read_task()
        return Evaluation(self.name, "", task.name, task.hash, error=error)


class Evaluator:
    """Evaluates creatures in processes that stay from call to call; every figure is that which `evaluate` gives.

    ```python
    with nmes.Evaluator(jobs=4) as evaluator:
        for generation in range(100):
            evaluations = evaluator.evaluate_population(genomes, "walk")
    ```

    Episodes are shared among the processes, those of one creature too. Bodies of one plan are stepped together, so
    that one body with many brains, or with many sizes, costs little more than the engine's own work; see
    docs/populations.md. A process that dies over a creature is that one's `error`.

    Args:
        jobs: How many processes at most, started when there is work for two; 1 is this process, which may die over a
            creature. None: one a core.
        ray: The address of a Ray cluster to use instead: `HOST:PORT`, `auto` or `local`. Recordings are then left on
            whichever machine did the work, in a directory of the name that is given.

    Raises:
        TypeError: The number of jobs is no whole number.
        ValueError: There is no job.
        MissingPackage: Ray is not installed.
        MachineError: There is no cluster (`no_cluster`).
    """

    def __init__(self, jobs: int | None = None, *, ray: str | None = None) -> None:
        self._pool = open_pool(jobs, ray)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Ends the processes, or parts from the cluster; processes are started anew where they are needed again."""
        self._pool.__exit__(None, None, None)

    def evaluate(
        self,
        genome: GenomeLike,
        task: TaskLike,
        *,
        seeds: Iterable[SupportsIndex] | None = None,
        record: str | os.PathLike[str] | None = None,
    ) -> Evaluation:
        """Runs a creature on a task; all is as with `nmes.evaluate`, but done by several processes where it is much."""
        return self.evaluate_population([genome], task, seeds=seeds, record=record)[0]

    def evaluate_population(
        self,
        genomes: Iterable[GenomeLike],
        task: TaskLike,
        *,
        seeds: Iterable[SupportsIndex] | None = None,
        record: str | os.PathLike[str] | None = None,
    ) -> list[Evaluation]:
        """Runs many creatures on a task.

        Args:
            genomes: Each a Genome, a document, a file, or the name of one that ships.
            task: What they are asked to do, told likewise.
            seeds: Instead of the task's.
            record: As for `evaluate`.

        Returns:
            An evaluation of each, in their order.

        Raises:
            DocumentError: A genome is none, or the task; nothing has run.
            TypeError: A seed is no whole number.
            RecordingError: A recording cannot be written.
            MissingPackage: A brain needs a package that is not installed.
        """
        asked, given = Task.load(task), None if seeds is None else read_seeds(seeds)
        document, folder = write_json(asked.document), None if record is None else os.fspath(record)
        work = [
            Job(genome.name, write_json(genome.document), document, given, folder, duty=asked.duty)
            for genome in map(Genome.load, genomes)
        ]
        evaluations = dict(self.run(work))
        return [evaluations[index] for index in range(len(work))]

    def run(
        self, work: Sequence[Job], *, progress: Callable[[int, int], None] | None = None
    ) -> Iterator[tuple[int, Evaluation]]:
        """Evaluates files' contents, which may turn out to be no genomes, on tasks that may differ.

        Args:
            work: What to do.
            progress: Called with how many episodes are done, and how many there are.

        Yields:
            The index of a job and its evaluation, as they are ready.

        Raises:
            RecordingError: A recording cannot be written, or would replace one that is signed (`signed`): nothing has
                run.
            MissingPackage: A brain needs a package that is not installed.
        """
        for place in (place for job in work for place in job.places().values()):
            require_unsigned(place)
        portions = _cut(work, self._pool.jobs)
        counts = Counter(part.index for portion in portions for part in portion)
        found: dict[int, dict[int, Evaluation]] = {index: {} for index in counts}
        done, total = 0, sum(part.episodes for portion in portions for part in portion)
        if progress is not None:
            progress(done, total)
        for part, evaluation in self._parts(portions):
            done += part.episodes
            if progress is not None:
                progress(done, total)
            parts = found[part.index]
            parts[part.number] = evaluation
            if len(parts) == counts[part.index]:
                yield part.index, Evaluation.joined([parts[number] for number in sorted(parts)])

    def _parts(self, portions: list[list[_Part]]) -> Iterator[tuple[_Part, Evaluation]]:
        """Yields the parts with their evaluations, as they are ready."""
        while portions:
            lost: list[list[_Part]] = []
            work = [[part.job for part in portion] for portion in portions]
            # To start a process takes longer than most creatures by themselves.
            pool = Here() if len(work) == 1 and isinstance(self._pool, Workers) else self._pool
            for number, results in pool.run(evaluate_portion, work):
                portion = portions[number]
                if isinstance(results, Lost) and len(portion) > 1:
                    lost += [[part] for part in portion]  # one of them did it; the others are done again without it
                    continue
                for place, part in enumerate(portion):
                    result = part.job.failed(results.reason) if isinstance(results, Lost) else results[place]
                    if isinstance(result, _Unrecorded):
                        raise RecordingError(result.code, result.message)
                    yield part, result
            portions = lost


@dataclass(frozen=True, slots=True)
class _Part:
    """A job, or those of its seeds that are evaluated for themselves.

    Attributes:
        index: Of the job.
        number: Which of its parts, in the order of the seeds.
        job: What to do.
        episodes: How many.
    """

    index: int
    number: int
    job: Job
    episodes: int


def _cut(work: Sequence[Job], jobs: int) -> list[list[_Part]]:
    """Cuts work into portions of parts that can be run together; each that is to be recorded is one for itself."""
    kinds: dict[tuple[bytes, bool, tuple[int, ...] | None, bool], list[int]] = {}
    for index, job in enumerate(work):
        kinds.setdefault((job.task, job.duty, job.seeds, job.record is None), []).append(index)
    portions: list[list[_Part]] = []
    numbers: Counter[int] = Counter()
    for (*_, given, together), indices in kinds.items():
        task = work[indices[0]].read_task()
        seeds = task.seeds if given is None else given
        for portion in cut([work[i].genome for i in indices], len(seeds), task.ticks, jobs, together=together):
            chosen = seeds[portion.seeds.start : portion.seeds.stop]
            portions.append([])
            for index in (indices[place] for place in portion.genomes):
                portions[-1].append(_Part(index, numbers[index], replace(work[index], seeds=chosen), len(chosen)))
                numbers[index] += 1
    return portions


def evaluate_portion(portion: Sequence[Job]) -> list[Evaluation | _Unrecorded]:
    """Evaluates jobs that are to be recorded, one by one, or jobs of one task and seeds, together."""
    if portion[0].record is not None:
        return [job.run() for job in portion]
    task = portion[0].read_task()
    seeds = task.seeds if portion[0].seeds is None else portion[0].seeds
    evaluations: dict[int, Evaluation | _Unrecorded] = {}
    genomes: dict[int, Genome] = {}
    for place, job in enumerate(portion):
        genome = job.parse()
        if isinstance(genome, Genome):
            genomes[place] = genome
        else:
            evaluations[place] = genome
    places = list(genomes)
    for outcome in run_population(list(genomes.values()), task, seeds):
        place = places[outcome.index]
        evaluations[place] = Evaluation.of_outcome(genomes[place], task, seeds, outcome)
    return [evaluations[place] for place in range(len(portion))]
