"""What a creature scores on a task, the same figure every time, and the recording that proves it.

An evaluation feeds worlds from a genome's brain instead of a socket: a world a seed, in which the creature is set down
and then senses, thinks, drives and ticks until the task says stop. What is to be done next is said by the course of an
`Episode`; here it is done, in `prove` it is compared with what a recording holds. All of it passes through the world's
ordinary doors, so that a recording replays like any other, without the brain.

Invariants:

- The score is a function of genome, task and seed, and of the fingerprint (versions, binaries, processor): never of
  what was evaluated before or beside it.
- A creature that cannot be evaluated, or whose world faults, is a result like any other, with its reason.
- What `prove` returns was reproduced tick by tick, in the very world of the task, and nothing but the creature's own
  motors was touched.
"""

from __future__ import annotations

import os
import re
import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import Enum
from hashlib import file_digest, sha256
from itertools import chain, islice
from math import fsum
from pathlib import Path
from typing import Any, Final

import numpy as np
import orjson

from nmes import protocol
from nmes.backend import Array, load_backend
from nmes.backend.fingerprint import fingerprint
from nmes.brain import Brain, load_brain
from nmes.errors import DocumentError, NmesError, ProofError, RecordingError, WorldError
from nmes.evaluation.parallel import Lost, in_processes, on_ray
from nmes.evaluation.task import CREATURE, Task
from nmes.genome import Genome
from nmes.objective import Quantity
from nmes.objective.trajectory import ObservedBodies, Trajectory
from nmes.playback.compare import replay
from nmes.protocol import Request
from nmes.recording import Kind, Recording
from nmes.recording.recorder import Recorder
from nmes.world import World
from nmes.world.creature import Creature

__all__ = [
    "Episode",
    "Evaluation",
    "Job",
    "Proof",
    "Result",
    "brain_of",
    "evaluate",
    "evaluate_all",
    "prove",
    "scores_so_far",
]

_ABOUT: Final = "nmes.evaluation"  # the metadata record of a recording that says what it was for
_POSE_RATE: Final = 1.0  # Hz; pictures for viewers cost as much as all else that is recorded, and follow from it
_ENERGY, _DISTANCE = Quantity("energy"), Quantity("displacement.horizontal")


@dataclass(frozen=True, slots=True)
class Result:
    """How one episode came out.

    Attributes:
        seed: The world's seed.
        score: The objective's value; None where the world faulted, or the value is no finite number.
        energy: Work of the motors, J.
        distance: Between where the creature's centre of mass began and where it ended, over the ground, m.
        ticks: How many the creature was scored for.
        ended: Which condition of the task ended it early; None where it lasted its time.
        fault: Why there is no score (`code: message`); None where there is one.
    """

    seed: int
    score: float | None
    energy: float
    distance: float
    ticks: int
    ended: str | None = None
    fault: str | None = None


@dataclass(frozen=True, slots=True)
class Evaluation:
    """What a genome came to on a task. Two are equal when all but their time and recordings is.

    Attributes:
        genome: The genome's name.
        genome_hash: Its hash; empty where it is none.
        task: The task's name.
        task_hash: Its hash.
        results: One a seed, in the order of the seeds; none where the creature could not be evaluated.
        error: Why it could not be; None where it could.
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
        """Returns what the recordings of one genome on one task prove; seeds are in the order that the task has."""
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
    def faults(self) -> int:
        """How many episodes have no score."""
        return sum(result.fault is not None for result in self.results)

    def to_json(self) -> dict[str, Any]:
        """Returns it as plain data: the fields, and what is computed from them."""
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
            "results": [asdict(result) for result in self.results],
            "recordings": list(self.recordings),
            "wall_seconds": self.wall_seconds,
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Evaluation:
        """Reads what `to_json` returned."""
        return cls(
            genome=data["genome"],
            genome_hash=data["genome_hash"],
            task=data["task"],
            task_hash=data["task_hash"],
            results=tuple(Result(**result) for result in data["results"]),
            error=data["error"],
            recordings=tuple(data["recordings"]),
            wall_seconds=data["wall_seconds"],
        )


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return fsum(known) / len(known) if known and len(known) == len(values) else None


# -- an episode -------------------------------------------------------------------------------------------------------


class _Anything(Enum):
    CONTROLS = "any controls"


Step = bytes | Array | _Anything | None
"""What comes next: a command, controls to drive the creature with (or any at all), or a tick."""


class Episode:
    """One run of a creature on a task, in a world of its own.

    Args:
        world: The world, new and empty, with the config that the task has for the seed.
        genome: The creature.
        brain: What drives it; None for a creature that does not move, or one that is driven by a log.
        task: What it is asked to do.
        seed: The world's, of what the task draws, and of what the brain does.
        logged: Whether it is a log that drives the creature.
    """

    def __init__(
        self, world: World, genome: Genome, brain: Brain | None, task: Task, seed: int, *, logged: bool = False
    ) -> None:
        self._world, self._genome, self._brain = world, genome, brain
        self._task, self._seed, self._logged = task, seed, logged
        self._trace: Trajectory | None = None
        self._ended: str | None = None

    def run(self) -> Result:
        """Runs all of it."""
        world = self._world
        client = world.join()
        drive, tick = world.drive, world.tick
        for step in self.steps():
            if step is None:
                tick()
            elif isinstance(step, np.ndarray):
                drive(client, CREATURE, step)
            else:
                assert isinstance(step, bytes)
                reply = protocol.decode(world.handle(client, protocol.parse(step)))
                if reply["type"] == "error":
                    raise WorldError(reply["code"], reply["message"], reply.get("field"))
        world.leave(client)
        return self.result()

    def steps(self) -> Iterator[Step]:
        """Yields what is to be done, one thing after the other; each must be done before the next is asked for."""
        world, task, genome, seed = self._world, self._task, self._genome, self._seed
        for command in task.entry(seed, genome.document, genome.body):
            yield protocol.encode(command)
        for _ in range(task.settle_ticks):
            yield None
            if world.fault is not None:
                return
        creature = world.creature(CREATURE)
        cubes = [creature.cubes[cube.id] for cube in genome.body.cubes]
        root = world.track(cubes[:1], [], 1)
        root.note()
        for command in task.props(seed, genome.body, root.states(0, 1)[0, 0]):
            yield protocol.encode(command)
        observer = _Observer(world, creature, task, seed)
        self._trace = observer.trace
        note = observer.note
        note()
        ticks, block = task.ticks, task.tick_rate
        brain, sense, controls = self._brain, creature.sense, None
        if brain is not None:
            brain.reset(seed, 1.0 / task.tick_rate)
            if brain.open_loop:
                controls = brain.controls(ticks)
        for tick in range(ticks):
            if brain is not None:
                yield brain.step(sense()) if controls is None else controls[tick]
            elif self._logged:
                yield _Anything.CONTROLS
            yield None
            if world.fault is not None:
                self._ended = observer.look()
                return
            note()
            if (tick + 1) % block == 0 or tick + 1 == ticks:
                # How it was at a tick is looked at a second later, many ticks at a time; what came after is dropped.
                self._ended = observer.look()
                if self._ended is not None:
                    return

    def result(self) -> Result:
        """Returns what came of it, when the course is over."""
        world, trace = self._world, self._trace
        fault = None
        if world.fault is not None and self._ended is None:
            fault = f"{world.fault.code}: {world.fault.message}"
        if trace is None:
            return Result(self._seed, None, 0.0, 0.0, 0, fault=fault)
        measured = trace.values((_ENERGY, _DISTANCE))
        score = None
        if fault is None:
            try:
                score = trace.value(self._task.objective)
            except WorldError as error:
                fault = f"{error.code}: {error.message}"
        rest = measured[_ENERGY], measured[_DISTANCE], trace.rows - 1
        return Result(self._seed, score, *rest, ended=self._ended, fault=fault)

    def scores_so_far(self) -> Array:
        """Returns the objective's value at the start and after each tick, array (n,); NaN where there is none."""
        return np.zeros(0) if self._trace is None else self._trace.values_so_far(self._task.objective)


class _Observer:
    """Fills the trace of an episode."""

    def __init__(self, world: World, creature: Creature, task: Task, seed: int) -> None:
        body, props = creature.body, task.document["props"]
        cubes = [creature.cubes[cube.id] for cube in body.cubes] + task.prop_ids()
        shapes = [world.cube_shape(name)[0] for name in cubes]
        masses = [*(cube.mass for cube in body.cubes), *(prop["mass"] for prop in props)]
        ids = (*(cube.id for cube in body.cubes), *task.prop_ids())
        cast = ObservedBodies(
            ids, len(body.cubes), np.array(shapes), np.array(masses, float), task.tick_rate, task.target(seed)
        )
        self._task = task
        touchy = any(quantity.name == "contacts" for quantity in task.needs)
        self.trace = Trajectory(cast, task.ticks, len(creature.motors), contacts=touchy)
        joints = [creature.joints[motor.id] for motor in creature.motors]
        self._track = world.track(cubes, joints, task.ticks + 1)
        self._world, self._cubes = world, cubes
        self.note = self._note_with_touches if touchy else self._track.note

    def _note_with_touches(self) -> None:
        trace = self.trace
        trace.touches[self._track.rows] = self._world.touches(self._cubes, trace.cast.body)
        self._track.note()

    def look(self) -> str | None:
        """Takes the new rows up into the trace; returns which condition has ended the episode, if one has."""
        trace, begin, end = self.trace, self.trace.rows, self._track.rows
        if begin == end:
            return None
        trace.states[begin:end] = self._track.states(begin, end)
        trace.meter(begin, *self._track.drives(begin, end))
        trace.rows = end
        stop = self._task.ended(trace, max(begin, 1), end)
        if stop is None:
            return None
        trace.rows = stop[0] + 1
        return stop[1]


# -- evaluations ------------------------------------------------------------------------------------------------------


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
        record: An existing directory, in which a recording of each episode is left, named after genome, task and
            seed. One of that name is replaced.

    Returns:
        The scores, in whatever the task's objective measures, and more; `error` says why a creature could not be
        evaluated, as when it is larger than the task allows.

    Raises:
        RecordingError: A recording cannot be written.
    """
    began = time.perf_counter()
    results: list[Result] = []
    recordings: list[str] = []
    error: str | None = None
    try:
        brain = brain_of(genome)
        refused = task.check(genome.body)
        error = "; ".join(refused) or None
        for seed in () if refused else task.seeds if seeds is None else seeds:
            if record is None:
                results.append(_episode(genome, brain, task, seed))
            else:
                path = Path(record, f"{_plain(genome.name)}-{genome.hash[:12]}-{task.name}-{seed}.mcap")
                results.append(_recorded(genome, brain, task, seed, path))
                recordings.append(str(path))
    except (DocumentError, WorldError) as refusal:
        error, results = refusal.message, []
    took = time.perf_counter() - began
    told = (genome.name, genome.hash, task.name, task.hash)
    return Evaluation(*told, tuple(results), error, tuple(recordings), took)


def brain_of(genome: Genome) -> Brain | None:
    """Returns what drives a creature, tied to its sensors and motors; None for one that has no brain.

    Raises:
        DocumentError: The brain is not as it must be, or does not fit the body.
    """
    body, document = genome.body, genome.document.get("brain")
    if document is None:
        return None
    return load_brain(document, [sensor.id for sensor in body.sensors], [motor.id for motor in body.motors])


def _plain(name: str) -> str:
    """Returns a name as a part of a file's name."""
    return re.sub(r"[^A-Za-z0-9_]+", "-", name).strip("-").lower()[:40] or "genome"


def _episode(genome: Genome, brain: Brain | None, task: Task, seed: int) -> Result:
    world = World(task.world_config(seed))
    try:
        return Episode(world, genome, brain, task, seed).run()
    finally:
        world.close()


def _recorded(genome: Genome, brain: Brain | None, task: Task, seed: int, path: Path) -> Result:
    world = World(task.world_config(seed))
    part = path.with_suffix(".part")  # so that what has the name of a recording is one
    part.unlink(missing_ok=True)
    about = {"task": protocol.encode(task.document).decode(), "genome": genome.hash, "seed": str(seed)}
    recorder = world.journal = Recorder(part, world, pose_rate=_POSE_RATE, about={_ABOUT: about})
    try:
        try:
            result = Episode(world, genome, brain, task, seed).run()
        finally:
            world.close()
            recorder.close()
    except NmesError:
        part.unlink(missing_ok=True)
        raise
    if world.fault is not None and world.fault.code == "recording_failed":
        raise RecordingError(world.fault.code, world.fault.message)
    part.replace(path)
    return result


@dataclass(frozen=True, slots=True)
class Job:
    """A genome to be evaluated somewhere else: plain data, the genome not looked at yet.

    Attributes:
        name: What to call it if it turns out to be no genome.
        genome: The bytes of its file.
        task: The task's document, as JSON.
        seeds: Instead of the task's, if any are given.
        record: As for `evaluate`.
    """

    name: str
    genome: bytes
    task: bytes
    seeds: tuple[int, ...] | None = None
    record: str | None = None

    @property
    def key(self) -> str:
        """Names all that the result depends on, this machine's fingerprint included."""
        task = Task(orjson.loads(self.task))
        here = fingerprint(load_backend(task.world_config(0)["backend"]))
        held = [self.genome.hex(), task.hash, self.seeds, here]
        return sha256(orjson.dumps(held, option=orjson.OPT_SORT_KEYS)).hexdigest()

    def run(self) -> Evaluation:
        """Evaluates it."""
        task = Task(orjson.loads(self.task))
        try:
            genome = Genome.parse(self.genome)
        except DocumentError as error:
            return self.failed(error.message)
        return evaluate(genome, task, seeds=self.seeds, record=self.record)

    def failed(self, error: str) -> Evaluation:
        """Returns the evaluation of a genome that could not be evaluated."""
        task = Task(orjson.loads(self.task))
        return Evaluation(self.name, "", task.name, task.hash, error=error)


def evaluate_all(work: Sequence[Job], *, jobs: int = 1, ray: str | None = None) -> Iterator[tuple[int, Evaluation]]:
    """Evaluates many genomes; what comes out does not depend on where, in which order and beside which others.

    Args:
        work: What to do.
        jobs: In how many processes.
        ray: The address of a Ray cluster to do it on instead. Recordings are then left in a directory of that name
            on whichever machine did the work.

    Yields:
        The index of a job and its evaluation, as they are ready. A process that dies over a job is its `error`.
    """
    found = in_processes(Job.run, work, jobs) if ray is None else on_ray(Job.run, work, ray)
    for index, result in found:
        yield index, work[index].failed(result.reason) if isinstance(result, Lost) else result


# -- proofs -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Proof:
    """What a recording proves: how one episode came out.

    Attributes:
        genome: The creature.
        task: The task.
        result: The episode's, computed from the log.
        path: The recording.
        recording_hash: SHA-256 of the file, hexadecimal.
        fingerprint: What the last bits depend on.
    """

    genome: Genome
    task: Task
    result: Result
    path: str
    recording_hash: str
    fingerprint: Mapping[str, str]


def prove(recording: str | os.PathLike[str], *, brain: bool = False) -> Proof:
    """Runs a recorded episode again and scores it, from its log alone.

    The commands must be those that set up the task's world with this creature in it, and then only drive its motors.

    Args:
        recording: The file.
        brain: Compare the controls too with what the genome's brain gives; else they may come from anywhere.

    Raises:
        RecordingError: It cannot be read.
        ProofError: It proves nothing: it is no recorded episode (`not_an_evaluation`), was made
            on another machine or with other versions (`not_comparable`), ends too early (`damaged`), or something in
            it comes out otherwise, or was done otherwise, than recorded (`diverged`); the message has the frame.
        DocumentError: Its task or its genome is not as it must be.
    """
    held = Recording(recording)
    checker, task, genome = _check(held, brain)
    with open(recording, "rb") as file:
        digest = file_digest(file, "sha256").hexdigest()
    return Proof(genome, task, checker.result(), str(recording), digest, held.fingerprint)


def scores_so_far(recording: Recording) -> Array:
    """Returns how an episode's score came about: what the objective is, tick by tick, over the ticks up to there.

    Args:
        recording: The episode's. It is run again as by `prove`.

    Returns:
        Array (n, 2) of times since the recording began, s, and of values; where there is none, NaN.

    Raises:
        RecordingError, ProofError, DocumentError: As by `prove`.
    """
    checker, task, _genome = _check(recording, False)
    values = checker.scores_so_far()
    ticks = task.settle_ticks + np.arange(len(values))
    return np.stack([ticks / task.tick_rate, values], axis=1)


def _check(held: Recording, brain: bool) -> tuple[_Checker, Task, Genome]:
    """Runs a recorded episode again; returns who followed it to its end, without finding fault."""
    about = held.metadata.get(_ABOUT)
    begun, first = islice(chain(held, (None, None)), 2)  # one that goes on from another would begin with a keyframe
    joined = begun is not None and begun.kind is Kind.JOINED
    entry = protocol.parse(first.data).command if joined and first is not None and first.kind is Kind.COMMAND else None
    if about is None or not {"task", "seed"} <= about.keys() or entry is None or entry["type"] != "spawn_creature":
        raise ProofError("not_an_evaluation", f"{held.path} is no recording of `nmes eval`")
    task, genome, seed = Task(orjson.loads(about["task"])), Genome(entry["genome"]), int(about["seed"])
    if held.config != protocol.complete_config(task.world_config(seed)):
        raise ProofError("diverged", f"{held.path}, frame 0: the world is not the task's")
    driver = brain_of(genome) if brain else None
    logged = not brain and "brain" in genome.document
    checker = _Checker(lambda world: Episode(world, genome, driver, task, seed, logged=logged))
    try:
        report = replay(held, watch=checker)
        if report.verdict == "not_comparable":
            unlike = ", ".join(f"{name} {was}, here {here}" for name, (was, here) in report.differences.items())
            raise ProofError("not_comparable", f"it was recorded with another {unlike}")
        if report.divergence is not None:
            at = f"it diverges at frame {report.divergence.frame}"
            raise ProofError("diverged", f"{at}: {report.divergence.message}")
        if report.damage is not None:
            raise ProofError("damaged", report.damage)
        checker.result()
    except (ProofError, RecordingError, WorldError) as error:
        raise ProofError(error.code, f"{held.path}: {error.message}") from error
    return checker, task, genome


class _Checker:
    """Follows a replay, and compares each of its inputs with the course of the episode."""

    def __init__(self, make: Callable[[World], Episode]) -> None:
        self._make = make
        self._episode: Episode | None = None
        self._course: Iterator[Step] = iter(())
        self._next: Step = None
        self._over = False

    def __call__(self, world: World, request: Request | None) -> None:
        """Takes one input, after it has acted."""
        if self._episode is None:
            self._episode = self._make(world)
            self._course = self._episode.steps()
            self._go_on()
        if self._over:
            raise _otherwise(world, f"{_said(request)} after the end of the episode")
        if not _agree(self._next, request):
            raise _otherwise(world, f"{_said(request)} where there should be {_expected(self._next)}")
        self._go_on()

    def _go_on(self) -> None:
        try:
            self._next = next(self._course)
        except StopIteration:
            self._over = True

    def result(self) -> Result:
        """Returns what came of it."""
        if self._episode is None or not self._over:
            raise ProofError("damaged", "the recording ends before the episode does")
        return self._episode.result()

    def scores_so_far(self) -> Array:
        """Returns what the score would have been, had the episode ended at each of its ticks."""
        assert self._episode is not None
        return self._episode.scores_so_far()


def _agree(step: Step, request: Request | None) -> bool:
    if step is None or request is None:
        return step is None and request is None
    if isinstance(step, bytes):
        return request.raw == step
    command = request.command
    if command is None or command["type"] != "drive" or command["creature"] != CREATURE:
        return False
    return step is _Anything.CONTROLS or np.array_equal(np.array(command["controls"], float), np.asarray(step))


def _otherwise(world: World, said: str) -> ProofError:
    return ProofError("diverged", f"at frame {world.frame} it has {said}")


def _said(request: Request | None) -> str:
    return "a tick" if request is None else f"the command {request.type or 'that was refused'}"


def _expected(step: Step) -> str:
    if step is None:
        return "a tick"
    if isinstance(step, bytes):
        return f"another {protocol.decode(step)['type']}"
    return "what the brain does" if isinstance(step, np.ndarray) else "a drive of the creature"
