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
import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from hashlib import sha256
from math import fsum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, get_type_hints

import orjson

from nmes import protocol
from nmes.backend import load_backend
from nmes.backend.fingerprint import decisive, fingerprint
from nmes.brain import Brain
from nmes.errors import DocumentError, NmesError, RecordingError
from nmes.evaluation.episode import METADATA, Episode, Result
from nmes.evaluation.parallel import Here, Lost, Pool, on_ray
from nmes.evaluation.population import Outcome, admit, guarded, run_alone, run_population
from nmes.evaluation.portions import cut
from nmes.evaluation.task import Task
from nmes.genome import Genome
from nmes.recording import Recorder
from nmes.world import World

if TYPE_CHECKING:
    from nmes.evaluation.proof import Proof

__all__ = ["Evaluation", "Job", "evaluate", "evaluate_all", "evaluate_population", "evaluate_portion", "recorded"]

_CLUSTER: Final = 64  # cores of a Ray cluster, of which one must not know more to cut work for it
_POSE_RATE: Final = 1.0  # Hz; pictures for viewers cost as much as all else that is recorded, and follow from it


@dataclass(frozen=True, slots=True)
class Evaluation:
    """The outcome of a genome on a task. Two are equal when all but their time and recordings are.

    Attributes:
        genome: The genome's name.
        genome_hash: Its hash; empty where it is none.
        task: The task's name.
        task_hash: Its hash.
        results: One a seed, in the order of the seeds; none where the creature could not be evaluated.
        error: Why the creature could not be evaluated; None where it could.
        recordings: Where the episodes' recordings are, one a result; none where nothing was recorded.
        wall_seconds: How long it took, s.
    """

    genome: str
    genome_hash: str
    task: str
    task_hash: str
    results: tuple[Result, ...] = ()
    error: str | None = None
    recordings: tuple[str, ...] = field(default=(), compare=False)
    wall_seconds: float = field(default=0.0, compare=False)

    @classmethod
    def of(cls, proofs: Sequence[Proof], *, wall_seconds: float = 0.0) -> Evaluation:
        """Returns the evaluation that recordings of one genome on one task prove; seeds are in the task's order."""
        task, genome = proofs[0].task, proofs[0].genome
        place = {seed: index for index, seed in enumerate(task.seeds)}
        ordered = sorted(proofs, key=lambda proof: (place.get(proof.result.seed, len(place)), proof.result.seed))
        return cls(
            genome=genome.name,
            genome_hash=genome.hash,
            task=task.name,
            task_hash=task.hash,
            results=tuple(proof.result for proof in ordered),
            recordings=tuple(proof.path for proof in ordered),
            wall_seconds=wall_seconds,
        )

    @classmethod
    def of_outcome(cls, genome: Genome, task: Task, seeds: Sequence[int], outcome: Outcome) -> Evaluation:
        """Returns the evaluation of a creature that was run with others."""
        names = genome.name, genome.hash, task.name, task.hash
        refusal = next((outcome.refusals[seed] for seed in seeds if seed in outcome.refusals), None)
        results = () if refusal else tuple(outcome.results[seed] for seed in seeds)
        return cls(*names, results, refusal, wall_seconds=outcome.seconds)

    @property
    def score(self) -> float | None:
        """The mean over the seeds; None where one of them has no score."""
        return _mean([result.score for result in self.results])

    @property
    def spread(self) -> float | None:
        """Standard deviation of the scores over the seeds, as of a whole population; None where there is no score."""
        scores = [result.score for result in self.results if result.score is not None]
        return None if self.score is None else statistics.pstdev(scores)

    @property
    def energy(self) -> float | None:
        """Mean work of the motors in an episode, J."""
        return _mean([result.energy for result in self.results])

    @property
    def distance(self) -> float | None:
        """Mean distance over the ground, m."""
        return _mean([result.distance for result in self.results])

    @property
    def duty(self) -> float | None:
        """Mean duty factor; None where it was not asked for, see `Task.with_duty`."""
        return _mean([result.duty for result in self.results])

    @property
    def faults(self) -> int:
        """How many episodes have no score."""
        return sum(result.fault is not None for result in self.results)

    def to_json(self) -> dict[str, Any]:
        """Returns the fields as plain data, with the figures computed from them."""
        return {
            "genome": self.genome,
            "genome_hash": self.genome_hash,
            "task": self.task,
            "task_hash": self.task_hash,
            "score": self.score,
            "spread": self.spread,
            "energy": self.energy,
            "distance": self.distance,
            "faults": self.faults,
            "error": self.error,
            "results": [result.to_json() for result in self.results],
            "recordings": list(self.recordings),
            "wall_seconds": self.wall_seconds,
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Evaluation:
        """Reads the plain data that `to_json` returned.

        Raises:
            KeyError, TypeError: They are something else.
        """
        results = tuple(Result(**result) for result in data["results"])
        plain = {name: data[name] for name in ("genome", "genome_hash", "task", "task_hash", "error", "wall_seconds")}
        evaluation = cls(**plain, results=results, recordings=tuple(data["recordings"]))
        _check_types(evaluation, plain)
        for result in results:
            _check_types(result, asdict(result))
        if not all(isinstance(recording, str) for recording in evaluation.recordings):
            raise TypeError("a recording is no text")
        return evaluation


def _check_types(value: Evaluation | Result, fields: Mapping[str, Any]) -> None:
    """Compares fields of a dataclass with their types; None stands for what JSON cannot say too."""
    kinds = get_type_hints(type(value))
    for name, field_value in fields.items():
        if not isinstance(field_value, kinds[name] | None):
            raise TypeError(f"{name} is a {type(field_value).__name__}")


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return fsum(known) / len(known) if known and len(known) == len(values) else None


def evaluate(
    genome: Genome,
    task: Task,
    *,
    seeds: Sequence[int] | None = None,
    record: str | os.PathLike[str] | None = None,
) -> Evaluation:
    """Runs a creature on a task, once a seed.

    Args:
        genome: The creature.
        task: What it is asked to do.
        seeds: Instead of the task's.
        record: An existing directory, in which a recording of each episode is left, named after genome and task,
            with their hashes, and seed. One of that name is replaced when the new one is whole.

    Returns:
        The scores, in whatever the task's objective measures, and more; `error` says why a creature could not be
        evaluated, as when it is larger than the task allows.

    Raises:
        RecordingError: A recording cannot be written.
    """
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
        for seed in task.seeds if seeds is None else seeds:
            run = partial(run_alone, genome, brain, task, seed)
            if record is not None:
                place = f"{_plain(genome.name)}-{genome.hash[:16]}-{task.name}-{task.hash[:16]}-{seed}.mcap"
                run = partial(recorded, brain, seed, Path(record, place))
            results.append(guarded(run, seed))
    except RecordingError:
        raise
    except NmesError as refusal:
        error, results, recordings = refusal.message, [], []
    names = genome.name, genome.hash, task.name, task.hash
    return Evaluation(*names, tuple(results), error, tuple(recordings), time.perf_counter() - begin)


def _plain(name: str) -> str:
    """Returns a name as a part of a file's name."""
    return re.sub(r"[^A-Za-z0-9_]+", "-", name).strip("-").lower()[:40] or "genome"


def _recorded(genome: Genome, brain: Brain | None, task: Task, seed: int, path: Path) -> Result:
    with recorded(genome, task, seed, path) as journal:
        world = World(task.world_config(seed))
        world.journal = journal(world)
        try:
            result = Episode(world, genome, brain, task, seed).run()
        finally:
            world.close()
        if world.fault is not None and world.fault.code == "recording_failed":
            raise RecordingError(world.fault.code, world.fault.message)
    return result


@contextmanager
def recorded(genome: Genome, task: Task, seed: int, path: Path) -> Iterator[Callable[[World], Recorder]]:
    """Gives what makes the journal of an episode's world, which is a recording once all has gone well.

    Args:
        genome: The creature.
        task: What it is asked to do.
        seed: The episode's.
        path: The file; one that is there is replaced when the new one is whole.

    Raises:
        RecordingError: It cannot be written.
    """
    # So that what has the name of a recording is one; and that of two who make it none takes the other's away.
    part = path.with_suffix(f".{secrets.token_hex(8)}.part")
    about = {"task": protocol.encode(task.document).decode(), "genome": genome.hash, "seed": str(seed)}
    recorders: list[Recorder] = []

    def journal(world: World) -> Recorder:
        recorders.append(Recorder(part, world, pose_rate=_POSE_RATE, about={METADATA: about}))
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
        except Exception as error:  # a mistake of ours, which this genome has found
            return self.failed(f"{type(error).__name__}: {error}")

    def run(self) -> Evaluation | _Unrecorded:
        """Evaluates the genome on its own; where that cannot be recorded, returns why."""
        task, genome = self.read_task(), self.parse()
        if not isinstance(genome, Genome):
            return genome
        try:
            return evaluate(genome, task, seeds=self.seeds, record=self.record)
        except RecordingError as error:
            return _Unrecorded(error.code, error.message)
        except Exception as error:  # as above
            return self.failed(f"{type(error).__name__}: {error}")

    def failed(self, error: str) -> Evaluation:
        """Returns the evaluation of a genome that could not be evaluated."""
        task = self.read_task()
        return Evaluation(self.name, "", task.name, task.hash, error=error)


def evaluate_population(
    genomes: Sequence[Genome], task: Task, *, seeds: Sequence[int] | None = None, workers: Pool | None = None
) -> list[Evaluation]:
    """Runs many creatures on a task: every figure is that which `evaluate` gives of the creature alone.

    Bodies of one plan are stepped together, so that one body with many brains, or with many sizes, costs little more
    than the engine's own work; see docs/populations.md.

    Args:
        genomes: The creatures.
        task: What they are asked to do.
        seeds: Instead of the task's.
        workers: The processes to do it in; None: in this one.

    Returns:
        An evaluation of each, in their order. A process that dies over a creature is that one's `error`.
    """
    asked, given = orjson.dumps(task.document), None if seeds is None else tuple(seeds)
    work = [Job(genome.name, orjson.dumps(genome.document), asked, given, duty=task.duty) for genome in genomes]
    evaluations = dict(evaluate_all(work, workers=workers))
    return [evaluations[index] for index in range(len(work))]


def evaluate_all(
    work: Sequence[Job], *, workers: Pool | None = None, ray: str | None = None
) -> Iterator[tuple[int, Evaluation]]:
    """Evaluates many genomes; their scores do not depend on where, in which order and beside which others they ran.

    Args:
        work: What to do.
        workers: The processes to do it in; None: in this one.
        ray: The address of a Ray cluster to do it on instead. Recordings are then left in a directory of that name
            on whichever machine did the work.

    Yields:
        The index of a job and its evaluation, as they are ready. A process that dies over a job is its `error`.

    Raises:
        RecordingError: A recording cannot be written.
    """
    workers = Here() if workers is None else workers
    run = workers.run if ray is None else partial(on_ray, address=ray)
    portions = _cut(work, workers.jobs if ray is None else _CLUSTER)
    while portions:
        lost: list[list[int]] = []
        for number, results in run(evaluate_portion, [[work[index] for index in portion] for portion in portions]):
            portion = portions[number]
            if isinstance(results, Lost) and len(portion) > 1:
                lost += [[index] for index in portion]  # one of them did it; the others are done again without it
                continue
            for place, index in enumerate(portion):
                result = work[index].failed(results.reason) if isinstance(results, Lost) else results[place]
                if isinstance(result, _Unrecorded):
                    raise RecordingError(result.code, result.message)
                yield index, result
        portions = lost


def _cut(work: Sequence[Job], jobs: int) -> list[list[int]]:
    """Cuts work into portions of jobs that can be run together; each that is to be recorded is one for itself."""
    portions: list[list[int]] = []
    kinds: dict[tuple[bytes, tuple[int, ...] | None, bool], list[int]] = {}
    for index, job in enumerate(work):
        if job.record is None:
            kinds.setdefault((job.task, job.seeds, job.duty), []).append(index)
        else:
            portions.append([index])
    for (document, seeds, _), indices in kinds.items():
        count = len(Task(orjson.loads(document)).seeds if seeds is None else seeds)
        for portion in cut([work[index].genome for index in indices], max(1, count), jobs):
            portions.append([indices[place] for place in portion])
    return portions


def evaluate_portion(portion: Sequence[Job]) -> list[Evaluation | _Unrecorded]:
    """Evaluates a job that is to be recorded, or jobs of one task and seeds, together."""
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
