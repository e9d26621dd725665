"""Many creatures on one task, in this process: what can be run together is, and every figure is that of `evaluate`.

Bodies of one plan (the same body, or one of other sizes, masses and motors) are likely to be rows of one engine: their
scenes are set in worlds, once for each body and seed, and the episodes go on in a `cohort`. Whatever cannot be run so
is run in a world of its own: bodies with few of their kind, engines without rows, and rows that fault.
"""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final, TypeVar

from nmes.brain import Brain
from nmes.errors import MACHINE_ERRORS, MissingPackage, NmesError, WorldError
from nmes.evaluation.cohort import Entry, run_cohort
from nmes.evaluation.episode import Episode, Handover, brain_of
from nmes.evaluation.judge import Result
from nmes.evaluation.task import Task
from nmes.genome import Genome
from nmes.genome.body import Body
from nmes.world import World

__all__ = ["ROWS", "Outcome", "admit", "guarded", "run_alone", "run_in_world", "run_population"]

ROWS: Final = 64
"""How many episodes are run together: with more the costs of a tick hardly fall, and each keeps its trajectory."""
_FEW = 4  # episodes; fewer of a kind are faster each in a world of its own

T = TypeVar("T")

logger = logging.getLogger(__name__)


@dataclass(slots=True)
class Outcome:
    """How a creature fared.

    Attributes:
        index: Its place among the genomes.
        results: By seed.
        refusals: Why it could not be evaluated, by seed.
        seconds: How long it took; what many were run in together is shared evenly.
    """

    index: int
    results: dict[int, Result] = field(default_factory=dict)
    refusals: dict[int, str] = field(default_factory=dict)
    seconds: float = 0.0


def admit(genome: Genome, task: Task) -> Brain | None:
    """Returns the brain of a creature that may take part; None where it has none.

    Raises:
        NmesError: It may not, or its brain is none for its body; the message has every reason.
    """
    brain = brain_of(genome)
    reasons = task.check(genome.body)
    if reasons:
        raise WorldError("invalid", "; ".join(reasons))
    return brain


def guarded(run: Callable[[], T], seed: int) -> T | Result:
    """Calls what runs an episode; where that fails in a way that nobody foresaw, returns the result that says so.

    Raises:
        NmesError: The creature cannot be evaluated.
        MemoryError, OSError: The machine lacks something for it, which says nothing of the creature.
    """
    try:
        return run()
    except (NmesError, *MACHINE_ERRORS):
        raise
    except Exception as failure:  # of an engine, an expression, a brain: this episode's, and no other's
        return Result(seed, None, 0.0, 0.0, 0, fault=f"failed: {type(failure).__name__}: {failure}")


def run_alone(genome: Genome, brain: Brain | None, task: Task, seed: int) -> Result:
    """Runs an episode by itself: as a row, where a brain that senses nothing lets many ticks be taken in one call.

    Raises:
        NmesError: The creature cannot be evaluated.
    """
    if brain is None or brain.open_loop:
        start = _begin(genome, brain, task, seed)
        if isinstance(start, Result):
            return start
        result = _together([Entry.of(start, brain, seed)], task)[0]
        if result is not None:
            return result
    return run_in_world(genome, brain, task, seed)


def run_in_world(genome: Genome, brain: Brain | None, task: Task, seed: int) -> Result:
    """Runs an episode in a world of its own, all of it; the figures are those of `run_alone`.

    Raises:
        NmesError: The creature cannot be evaluated.
    """
    world = World(task.world_config(seed))
    try:
        return Episode(world, genome, brain, task, seed).run()
    finally:
        world.close()


def _begin(genome: Genome, brain: Brain | None, task: Task, seed: int) -> Result | Handover:
    """Sets the scene in a world, and hands it over; where that cannot be, runs all of the episode there."""
    world = World(task.world_config(seed))
    try:
        return Episode(world, genome, brain, task, seed).begin()
    finally:
        world.close()


def _plan(body: Body) -> Hashable:
    """Returns a body's plan, all but its numbers: bodies of one plan may be rows of one engine."""
    cubes = tuple(cube.id for cube in body.cubes)
    joints = tuple(
        (joint.id, joint.kind, joint.cube1, joint.cube2, bool(joint.stiffness), joint.motor is None)
        for joint in body.joints
    )
    return cubes, joints, body.sensors


def _together(entries: Sequence[Entry], task: Task) -> Sequence[Result | None]:
    try:
        return run_cohort(entries, task)
    except Exception as failure:
        # Of one brain, maybe: whose it is, and what it says, comes out where each is run alone.
        logger.warning("%d episodes are run in worlds of their own, since as rows they fail: %r", len(entries), failure)
        return [None] * len(entries)


@dataclass(eq=False, slots=True)
class _Run:
    """One episode that is still to be run."""

    outcome: Outcome
    genome: Genome
    brain: Brain | None
    seed: int


def run_population(genomes: Sequence[Genome], task: Task, seeds: Sequence[int]) -> Iterator[Outcome]:
    """Runs every genome on every seed.

    Yields:
        The outcomes, as they are ready.

    Raises:
        MissingPackage: A brain needs a package that is not installed.
    """
    yield from _Population(genomes, task, seeds).run()


class _Population:
    def __init__(self, genomes: Sequence[Genome], task: Task, seeds: Sequence[int]) -> None:
        self._task, self._seeds = task, tuple(dict.fromkeys(seeds))
        self._genomes = genomes
        self._left: Counter[int] = Counter()  # episodes, by genome
        self._waiting: dict[Hashable, list[tuple[_Run, Entry]]] = {}
        self._starts: dict[int, Handover] = {}  # of the body at hand, by seed: the same whatever the brain

    def run(self) -> Iterator[Outcome]:
        """Runs all."""
        kinds: dict[Hashable, dict[Body, list[_Run]]] = {}
        for outcome in (Outcome(index) for index in range(len(self._genomes))):
            genome, began = self._genomes[outcome.index], time.perf_counter()
            runs = self._runs(outcome, genome)
            outcome.seconds = time.perf_counter() - began
            self._left[outcome.index] = len(runs)
            if runs:
                kinds.setdefault(_plan(genome.body), {}).setdefault(genome.body, []).extend(runs)
            else:
                yield outcome
        for bodies in kinds.values():
            few = sum(map(len, bodies.values())) < _FEW
            for runs in bodies.values():
                self._starts.clear()
                for run in runs:
                    yield from self._by_itself(run, run_alone) if few else self._start(run)
                    while sum(map(len, self._waiting.values())) >= ROWS:
                        yield from self._run_together()
            while self._waiting:
                yield from self._run_together()

    def _runs(self, outcome: Outcome, genome: Genome) -> list[_Run]:
        """Returns the episodes of a genome; none where it may not take part, or cannot.

        Raises:
            MissingPackage: Its brain needs a package that is not installed, which says nothing of it.
        """
        try:
            brain = admit(genome, self._task)
        except MissingPackage:
            raise
        except NmesError as refusal:
            outcome.refusals = dict.fromkeys(self._seeds, refusal.message)
            return []
        return [_Run(outcome, genome, brain, seed) for seed in self._seeds]

    def _start(self, run: _Run) -> Iterator[Outcome]:
        """Sets a scene, or takes that of another creature of this body; the episode then waits for others."""
        began = time.perf_counter()
        start: Result | Handover | None = self._starts.get(run.seed)
        if start is None:
            start = self._guarded(run, lambda: _begin(run.genome, run.brain, self._task, run.seed))
            if isinstance(start, Handover) and start.tick == 0:
                self._starts[run.seed] = start
        run.outcome.seconds += time.perf_counter() - began
        if isinstance(start, Handover):
            entry = Entry.of(start, run.brain, run.seed)
            self._waiting.setdefault(entry.kin, []).append((run, entry))
        else:
            yield from self._over(run, start)

    def _run_together(self) -> Iterator[Outcome]:
        """Runs the largest group of those that wait."""
        began = time.perf_counter()
        group = self._waiting.pop(max(self._waiting, key=lambda kin: len(self._waiting[kin])))
        results = _together([entry for _, entry in group], self._task)
        share = (time.perf_counter() - began) / len(group)
        for (run, _), result in zip(group, results, strict=True):
            run.outcome.seconds += share
            yield from self._by_itself(run, run_in_world) if result is None else self._over(run, result)

    def _by_itself(self, run: _Run, how: Callable[[Genome, Brain | None, Task, int], Result]) -> Iterator[Outcome]:
        began = time.perf_counter()
        result = self._guarded(run, lambda: how(run.genome, run.brain, self._task, run.seed))
        run.outcome.seconds += time.perf_counter() - began
        yield from self._over(run, result)

    def _guarded(self, run: _Run, call: Callable[[], T]) -> T | Result | None:
        """Returns the result of a call, or one that says how it failed; None where the creature is refused."""
        try:
            return guarded(call, run.seed)
        except MissingPackage:
            raise
        except NmesError as refusal:
            run.outcome.refusals[run.seed] = refusal.message
            return None

    def _over(self, run: _Run, result: Result | None) -> Iterator[Outcome]:
        """Adds an episode's result; yields the outcome of a genome once its last episode is there."""
        outcome = run.outcome
        if result is not None:
            outcome.results[run.seed] = result
        self._left[outcome.index] -= 1
        if not self._left[outcome.index]:
            yield outcome
