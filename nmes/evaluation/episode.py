"""One episode: a creature set down in a task's world, then sensed, driven and ticked until the task says stop.

An episode yields its steps. Whoever evaluates does them; whoever proves compares them with a recording. They are the
world's ordinary inputs, so that the recording of an episode replays like any other, without the brain.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np

from nmes import protocol
from nmes.backend import Array, Row
from nmes.brain import Brain
from nmes.errors import WorldError
from nmes.evaluation.balance import Balance, Excess
from nmes.evaluation.steps import ANY_CONTROLS, Drive, Step, perform, settle
from nmes.evaluation.task import ALONE, CREATURE, Place, Task
from nmes.genome import Genome
from nmes.objective import Quantity
from nmes.objective.trajectory import Flags, ObservedBodies, Trajectory
from nmes.world import World
from nmes.world.creature import Creature

__all__ = [
    "MEASURED",
    "METADATA",
    "Entrant",
    "Episode",
    "Handover",
    "Judge",
    "Observer",
    "Result",
    "Watched",
    "brain_of",
    "result_of",
    "set_scene",
]

METADATA: Final = "nmes.evaluation"
"""The metadata record of an episode's recording: its `task`, the `genome`'s hash and its `seed`."""
_ENERGY, _DISTANCE = Quantity("energy"), Quantity("displacement.horizontal")
MEASURED: Final = (_ENERGY, _DISTANCE)
"""What each result tells besides the score."""


@dataclass(frozen=True, slots=True)
class Result:
    """How one episode came out.

    Attributes:
        seed: The world's seed.
        score: The objective's value; None where the world faulted, the creature did not come to rest or had energy of
            nothing, or the value is no finite number.
        energy: Work of the motors, J.
        distance: Between where the creature's centre of mass began and where it ended, over the ground, m.
        ticks: How many the creature was scored for.
        ended: Which condition or limit of the task ended it early; None where it lasted its time.
        fault: Why there is no score (`code: message`); None where there is one. The codes are those of a world's faults
            and `bad_expression`, `restless` and `energy`.
        duty: The duty factor; see `Trajectory.duty`. None where it was not asked for.
    """

    seed: int
    score: float | None
    energy: float
    distance: float
    ticks: int
    ended: str | None = None
    fault: str | None = None
    duty: float | None = None

    def to_json(self) -> dict[str, Any]:
        """Returns the fields as plain data, `duty` only where it was asked for."""
        return {name: value for name, value in asdict(self).items() if name != "duty" or value is not None}


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
        note, sense, controls = observer.note, observer.creature.sense, None
        note()
        self._leaves = self._leaves and not observer.creature.solitary
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
        """Returns the result, once all steps are done."""
        world, fault = self._world, None
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
        Who observes each of them; nobody where the world faulted, or where creatures never came to rest. These are told
        by name, with the reason.
    """
    names = [entrant.place.creature for entrant in entrants]
    commands = [
        command
        for entrant in entrants
        for command in task.entry(seed, entrant.genome.document, entrant.genome.body, entrant.place)
    ]
    rests = yield from settle(world, task, names, commands)
    if world.fault is not None:
        return [], {}
    late = {name: rest.why(world.frame) for name, rest in rests.items() if not rest.reached}
    if late:
        return [], late
    for entrant, rest in zip(entrants, rests.values(), strict=True):
        for command in task.props(seed, entrant.genome.body, rest.states[0], entrant.place):
            yield protocol.encode(command)
    return [Observer(world, world.creature(e.place.creature), task, seed, e.place) for e in entrants], {}


class Observer:
    """Tells a judge what one creature does in a world.

    Attributes:
        creature: Whom.
        judge: Whom it tells.
        watched: What it tells of.
        note: Called after each tick that counts, and at the start: keeps a row, for `look`.
    """

    def __init__(self, world: World, creature: Creature, task: Task, seed: int, place: Place = ALONE) -> None:
        body, props = creature.body, task.document["props"]
        cubes = [creature.cubes[cube.id] for cube in body.cubes] + [place.prop(name) for name in task.prop_ids()]
        sizes, _, shapes = zip(*map(world.cube_shape, cubes), strict=True)
        masses = [*(cube.mass for cube in body.cubes), *(prop["mass"] for prop in props)]
        ids = (*(cube.id for cube in body.cubes), *task.prop_ids())
        bodies = ObservedBodies(
            ids,
            len(body.cubes),
            np.array(sizes),
            np.array(masses, float),
            task.tick_rate,
            task.target(seed, place),
            shapes,
        )
        motors = [joint for joint in body.joints if joint.motor is not None]
        sprung = [joint for joint in body.joints if joint.stiffness]
        balance = Balance.of(bodies, world.config, [joint.stiffness for joint in sprung])
        self.creature, self.judge = creature, Judge(task, seed, balance, len(motors))
        self.watched = Watched(
            [world.entities.cube(name).body for name in cubes],
            [world.entities.joint(creature.joints[joint.id]).number for joint in sprung],
            [world.entities.joint(creature.joints[joint.id]).number for joint in motors],
        )
        self._track = world.simulation.track(*self.watched, task.ticks + 1)
        self._world, self._cubes = world, cubes
        self.note = self._note_with_touches if self.judge.touchy else self._track.note

    def _note_with_touches(self) -> None:
        judge = self.judge
        judge.touches[self._track.rows] = self._world.touches(self._cubes, judge.trajectory.bodies.body)
        self._track.note()

    def latest(self) -> tuple[Array, Array, Flags]:
        """Returns the last note: states (1, n, 13), each motor's power (1, m), W, and touches (1, n or 0, 2).

        What motors gave is the mean size of their power in the tick.
        """
        row = self._track.rows - 1
        states, powers = self._track.states(row, row + 1), self._track.powers(row, row + 1)
        touches = self.judge.touches[row : row + 1] if self.judge.touchy else np.zeros((1, 0, 2), np.bool_)
        return states, powers[:, 1], touches

    def look(self) -> str | None:
        """Has the new rows judged; returns the name of the condition that has ended the episode, if one has."""
        track, begin, end = self._track, self.judge.trajectory.rows, self._track.rows
        return self.judge.take(track.states(begin, end), track.powers(begin, end), track.positions(begin, end))


class Watched(NamedTuple):
    """The numbers, in the engine, of the bodies, the joints with springs and the joints with motors that are judged."""

    bodies: list[int]
    springs: list[int]
    motors: list[int]


class Judge:
    """Decides how an episode comes out from what is told it of each tick, wherever the creature is run.

    Args:
        task: What is asked.
        seed: The episode's.
        balance: Of the energy of the creature and of the task's props.
        motors: The number of the creature's motors.

    Attributes:
        balance: Of the energy.
        touchy: Whether it must be told what touches what.
        touches: Where to write that, row by row, before the row is taken: see `Trajectory.touches`.
        trajectory: All that was taken.
    """

    def __init__(self, task: Task, seed: int, balance: Balance, motors: int) -> None:
        self._task, self._seed, self.balance = task, seed, balance
        self.touchy = task.touchy
        self.trajectory = Trajectory(balance.bodies, task.ticks, motors, contacts=self.touchy)
        self.touches = self.trajectory.touches
        self._powers = np.zeros((task.ticks + 1, 2, motors))
        self._positions = np.zeros((task.ticks + 1, len(balance.stiffnesses)))

    @property
    def start(self) -> tuple[Array, Array]:
        """What it was told of the start: states, array (n, 13), and positions, array (s,)."""
        return self.trajectory.states[0].copy(), self._positions[0].copy()

    def again(self) -> Judge:
        """Returns a judge of the same scene, who has seen what this one has."""
        judge = Judge(self._task, self._seed, self.balance, self._powers.shape[2])
        rows = self.trajectory.rows
        judge.touches[:rows] = self.touches[:rows]
        judge.take(self.trajectory.states[:rows], self._powers[:rows], self._positions[:rows])
        return judge

    def take(self, states: Array, powers: Array, positions: Array) -> str | None:
        """Takes the rows that come next; returns the name of the condition that has ended the episode, if one has.

        How many rows are taken at a time changes nothing, but what comes after such an end is dropped.

        Args:
            states: Of the bodies, shape (k, n, 13), as `Simulation.states`.
            powers: Of the motors in the ticks that led there, shape (k, 2, m), as `Simulation.powers`.
            positions: Of the joints with springs, shape (k, s), rad or m.
        """
        trajectory, begin = self.trajectory, self.trajectory.rows
        end = begin + len(states)
        if begin == end:
            return None
        trajectory.states[begin:end], self._powers[begin:end], self._positions[begin:end] = states, powers, positions
        trajectory.meter(begin, powers[:, 1])
        trajectory.rows = end
        stop = self._task.ended(trajectory, max(begin, 1), end)
        if stop is None:
            return None
        trajectory.rows, name = stop
        return name

    def result(self, ended: str | None, fault: str | None) -> Result:
        """Returns how the episode came out.

        Args:
            ended: The condition that ended it early, if one did.
            fault: Why the world could not go on, if it could not.
        """
        trajectory = self.trajectory
        rows, values = trajectory.rows, trajectory.values(dict.fromkeys((*MEASURED, *self._task.objective.needs)))
        excess = self.balance.excess(trajectory.states[:rows], self._powers[:rows], self._positions[:rows])
        result = result_of(self._task, self._seed, values, rows - 1, ended, fault, excess)
        return replace(result, duty=trajectory.duty()) if self._task.duty else result


def result_of(
    task: Task,
    seed: int,
    values: Mapping[Quantity, float],
    ticks: int,
    ended: str | None,
    fault: str | None,
    excess: Excess | None,
) -> Result:
    """Returns how an episode came out.

    Args:
        task: What was asked.
        seed: The episode's.
        values: Of `MEASURED` and of what the objective needs, over the rows that count.
        ticks: How many count, after the start.
        ended: The condition that ended it early, if one did.
        fault: Why the world could not go on, if it could not.
        excess: Where the body had energy of nothing, if it had.
    """
    score, fault = None, fault or (None if excess is None else str(excess))
    if fault is None:
        try:
            score = task.objective.value(values)
        except WorldError as error:
            fault = f"{error.code}: {error.message}"
    return Result(seed, score, values[_ENERGY], values[_DISTANCE], ticks, ended=ended, fault=fault)
