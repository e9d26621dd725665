"""One episode: a creature set down in a task's world, then sensed, driven and ticked until the task says stop.

An episode yields its steps. Whoever evaluates does them; whoever proves compares them with a recording. They are the
world's ordinary inputs, so that the recording of an episode replays like any other, without the brain.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from nmes import protocol
from nmes.backend import Array, Row
from nmes.brain import Brain
from nmes.errors import MACHINE_ERRORS
from nmes.evaluation.changing import ChangingObserver
from nmes.evaluation.judge import Judge, Observer, Result, Watched
from nmes.evaluation.steps import ANY_CONTROLS, Drive, Step, perform, settle
from nmes.evaluation.task import ALONE, CREATURE, Place, Task
from nmes.genome import Genome
from nmes.world import World
from nmes.world.creature import Creature

__all__ = [
    "METADATA",
    "Entrant",
    "Episode",
    "Handover",
    "brain_of",
    "set_scene",
]

METADATA: Final = "nmes.evaluation"
"""The metadata record of an episode's recording: its `task`, the `genome`'s hash and its `seed`."""


def brain_of(genome: Genome) -> Brain | None:
    """Returns a creature's brain, tied to its sensors and motors; None for one that has none.

    Raises:
        DocumentError: The brain is not as it must be, or does not fit the body.
    """
    return genome.brain() if "brain" in genome.document else None


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
        self._observer: Observer | None = None
        self._restless: str | None = None
        self._start = 0  # the frame
        self._ended: str | None = None
        self._leaves = False
        self._sensed: list[Array] = []
        self._handover: Handover | None = None

    def begin(self) -> Result | Handover:
        """Runs it until its scene can go on as a row of an engine: at its start, or once all is built; else all of it.

        Raises:
            WorldError: As by `run`.
        """
        self._leaves = True
        self._go()
        return self.result() if self._handover is None else self._handover

    def run(self) -> Result:
        """Runs all of it.

        Raises:
            WorldError: The world refuses a command that sets the scene.
        """
        self._go()
        return self.result()

    def _go(self) -> None:
        client = self._world.join()
        perform(self._world, client, self.steps())
        self._world.leave(client)

    def steps(self) -> Generator[Step, None, None]:
        """Yields the episode's steps; each must be done before the next is asked for."""
        yield from self._set_scene()
        observer, world, brain = self._observer, self._world, self._brain
        if observer is None:
            return
        cut = self._task.injury_tick(self._seed)
        note, sense, controls = observer.note, observer.creature.sense, None
        note()
        self._leaves = self._leaves and not observer.creature.solitary and cut is None
        if self._leaves and self._leave(0):
            return
        ticks, block = self._task.ticks, self._task.tick_rate
        if brain is not None:
            brain.reset(self._seed, 1.0 / block)
            if brain.open_loop:
                controls = brain.controls(ticks)
        for tick in range(ticks):
            if self._leaves and tick and self._leave(tick):
                return
            if tick == cut:
                assert isinstance(observer, ChangingObserver)
                yield from self._injure(observer.creature)
                observer.cut()
            if controls is not None:
                yield Drive(CREATURE, controls[tick])
            elif brain is not None:
                sensed = sense()
                if self._leaves:
                    self._sensed.append(sensed)
                yield Drive(CREATURE, brain.step(sensed))
            elif self._logged:
                yield Drive(CREATURE, ANY_CONTROLS, "brain" not in self._genome.document)
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

    def _injure(self, creature: Creature) -> Iterator[Step]:
        """Yields the step that cuts a limb off, if there is one."""
        limb = self._task.limb(self._seed, creature.body, creature.cubes)
        if limb is not None:
            yield protocol.encode({"type": "shed", "creature": CREATURE, "part": limb})

    def _leave(self, tick: int) -> bool:
        """Hands the scene over as a row, if that can be now; returns whether this world is done with."""
        observer = self._observer
        assert observer is not None
        row = self._world.simulation.hand_over()
        if row is None:
            return False
        self._ended = observer.look()
        if self._ended is None:
            creature = observer.creature
            now = creature, creature.sense(), observer.watched, observer.judge
            self._handover = Handover(row, tick, *now, self._sensed)
        return True

    def start(self) -> tuple[Creature, Watched, Judge] | None:
        """Returns the state to go on from at the first scored tick; None where the creature never came to rest.

        Returns:
            The creature, what its judge is told of, and the judge, who has seen the start.
        """
        if self._observer is None:
            return None
        self._observer.look()
        return self._observer.creature, self._observer.watched, self._observer.judge

    def _set_scene(self) -> Generator[Step, None, None]:
        """Yields the steps before the start; makes the observer, unless the creature does not come to rest."""
        observers, restless = yield from set_scene(self._world, self._task, self._seed, [Entrant(self._genome)])
        self._restless = restless.get(CREATURE)
        if observers:
            self._observer, self._start = observers[0], self._world.frame

    def result(self) -> Result:
        """Returns the result, once all steps are done.

        Raises:
            MemoryError, OSError: The world stopped for want of something, which says nothing of the creature.
        """
        world, fault = self._world, None
        if world.fault is not None and isinstance(world.fault.cause, MACHINE_ERRORS):
            raise world.fault.cause
        if world.fault is not None and self._ended is None:
            fault = f"{world.fault.code}: {world.fault.message}"
        if self._observer is None:
            return Result(self._seed, None, 0.0, 0.0, 0, fault=fault or self._restless)
        return self._observer.judge.result(self._ended, fault)

    def scores_so_far(self) -> Array:
        """Returns the objective's value at the start and after each tick; where there is none, NaN.

        Returns:
            Array (n, 2) of times since the world began, s, and of values.
        """
        if self._observer is None:
            return np.zeros((0, 2))
        values = self._observer.judge.trajectory.values_so_far(self._task.objective)
        return np.stack([(self._start + np.arange(len(values))) / self._task.tick_rate, values], axis=1)

    @property
    def driven_ticks(self) -> int:
        """How many ticks it had: those that it is scored for, and one at which it was beyond a limit or failed.

        What was done after its end, until that was noticed, does not count.
        """
        if self._observer is None:
            return 0
        trajectory = self._observer.judge.trajectory
        last = trajectory.rows - 1
        if self._ended is None:
            return last + (self._world.fault is not None)
        held = [trajectory.first(condition, max(last, 1), last + 1) for _, condition in self._task.ends]
        return last + all(row is None for row in held)  # nothing held at the last tick: a limit ended the next

    @property
    def lasted(self) -> bool:
        """Whether it went on to its last tick, neither ended nor failed."""
        return self._ended is None and self._world.fault is None


@dataclass(frozen=True, eq=False, slots=True)
class Handover:
    """An episode that goes on as a row of an engine.

    Attributes:
        row: The scene.
        tick: How many ticks of the episode are over.
        creature: The creature.
        senses: What it senses now.
        watched: What the judge is told of.
        judge: Who has seen what was so far; others go on from there (`Judge.again`).
        sensed: What the brain was given at the ticks that are over, if it senses.
    """

    row: Row
    tick: int
    creature: Creature
    senses: Array
    watched: Watched
    judge: Judge
    sensed: list[Array]


class Entrant(NamedTuple):
    """One of those that take part in an episode: the creature, and its place in the world."""

    genome: Genome
    place: Place = ALONE


def set_scene(
    world: World, task: Task, seed: int, entrants: Sequence[Entrant]
) -> Generator[Step, None, tuple[list[Observer], dict[str, str]]]:
    """Yields the steps that bring creatures to their start, where all of them are at rest.

    Returns:
        Who observes each of them; nobody where the world faulted, or where creatures cannot begin, since they never
        came to rest, or elsewhere. These are told by name, with the reason.
    """
    names = [entrant.place.creature for entrant in entrants]
    commands = [
        command
        for entrant in entrants
        for command in task.entry(seed, entrant.genome.document, entrant.genome.body, entrant.place)
    ]
    rests, restless = yield from settle(world, task, names, commands)
    if world.fault is not None:
        return [], {}
    if restless:
        return [], restless
    for entrant, rest in zip(entrants, rests.values(), strict=True):
        for command in task.props(seed, entrant.genome.body, rest.states[0], entrant.place):
            yield protocol.encode(command)
    return [_observer(world, task, seed, entrant) for entrant in entrants], {}


def _observer(world: World, task: Task, seed: int, entrant: Entrant) -> Observer:
    changes = task.why_changing(entrant.genome.body) is not None
    kind = ChangingObserver if changes else Observer
    return kind(world, world.creature(entrant.place.creature), task, seed, entrant.place)
