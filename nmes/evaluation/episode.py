"""One episode: a creature set down in a task's world, then sensed, driven and ticked until the task says stop.

An episode yields its steps. Whoever evaluates does them; whoever proves compares them with a recording. They are the
world's ordinary inputs, so that the recording of an episode replays like any other, without the brain.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Final

import numpy as np

from nmes import protocol
from nmes.backend import Array
from nmes.brain import Brain
from nmes.errors import WorldError
from nmes.evaluation.balance import Balance
from nmes.evaluation.task import CREATURE, Task
from nmes.genome import Genome
from nmes.objective import Quantity
from nmes.objective.trajectory import ObservedBodies, Trajectory
from nmes.world import World
from nmes.world.creature import Creature

__all__ = ["ANY_CONTROLS", "METADATA", "Episode", "Result", "Step", "brain_of"]

METADATA: Final = "nmes.evaluation"
"""The metadata record of an episode's recording: its `task`, the `genome`'s hash and its `seed`."""
_REST_TIME = 0.25  # s
_REST_SPEED = 0.05  # of the body's size in a second: in a whole episode it would not come farther than that size
_ENERGY, _DISTANCE = Quantity("energy"), Quantity("displacement.horizontal")


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
    """

    seed: int
    score: float | None
    energy: float
    distance: float
    ticks: int
    ended: str | None = None
    fault: str | None = None


class _AnyControls(Enum):
    ANY_CONTROLS = "any controls"


ANY_CONTROLS: Final = _AnyControls.ANY_CONTROLS
"""A step that drives the creature, with whatever controls."""
Step = bytes | Array | _AnyControls | None
"""What comes next: a command, controls to drive the creature with (or any at all), or a tick."""


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
        self._observer: _Observer | None = None
        self._restless: str | None = None
        self._start = 0  # the frame
        self._ended: str | None = None

    def run(self) -> Result:
        """Runs all of it.

        Raises:
            WorldError: The world refuses a command that sets the scene.
        """
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
        """Yields the episode's steps; each must be done before the next is asked for."""
        yield from self._set_scene()
        observer, world, brain = self._observer, self._world, self._brain
        if observer is None:
            return
        note, sense, controls = observer.note, observer.creature.sense, None
        note()
        ticks, block = self._task.ticks, self._task.tick_rate
        if brain is not None:
            brain.reset(self._seed, 1.0 / block)
            if brain.open_loop:
                controls = brain.controls(ticks)
        for tick in range(ticks):
            if brain is not None:
                yield brain.step(sense()) if controls is None else controls[tick]
            elif self._logged:
                yield ANY_CONTROLS
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

    def _set_scene(self) -> Iterator[Step]:
        """Yields the steps before the start; makes the observer, unless the creature does not come to rest."""
        world, task, genome, seed = self._world, self._task, self._genome, self._seed
        for command in task.entry(seed, genome.document, genome.body):
            yield protocol.encode(command)
        creature = world.creature(CREATURE)
        rest = _Rest(world, creature, task)
        while world.frame < task.settle_ticks or not rest.reached:
            if world.frame == task.settle_limit_ticks:
                after = f"{world.frame / task.tick_rate:g} s"
                self._restless = f"restless: not yet at rest after {after}: a corner moved at {rest.speed:.2g} m/s"
                return
            yield None
            if world.fault is not None:
                return
            rest.look()
        for command in task.props(seed, genome.body, rest.states[0]):
            yield protocol.encode(command)
        self._observer, self._start = _Observer(world, creature, task, seed), world.frame

    def result(self) -> Result:
        """Returns the result, once all steps are done."""
        world, fault = self._world, None
        if world.fault is not None and self._ended is None:
            fault = f"{world.fault.code}: {world.fault.message}"
        if self._observer is None:
            return Result(self._seed, None, 0.0, 0.0, 0, fault=fault or self._restless)
        trajectory, score = self._observer.trajectory, None
        measured = trajectory.values((_ENERGY, _DISTANCE))
        fault = fault or self._observer.imbalance()
        if fault is None:
            try:
                score = trajectory.value(self._task.objective)
            except WorldError as error:
                fault = f"{error.code}: {error.message}"
        rest = measured[_ENERGY], measured[_DISTANCE], trajectory.rows - 1
        return Result(self._seed, score, *rest, ended=self._ended, fault=fault)

    def scores_so_far(self) -> Array:
        """Returns the objective's value at the start and after each tick; where there is none, NaN.

        Returns:
            Array (n, 2) of times since the world began, s, and of values.
        """
        if self._observer is None:
            return np.zeros((0, 2))
        values = self._observer.trajectory.values_so_far(self._task.objective)
        return np.stack([(self._start + np.arange(len(values))) / self._task.tick_rate, values], axis=1)


class _Rest:
    """Tells when a creature is at rest: for a while none of its corners was faster than a part of its size a second.

    Args:
        world: The world, where it has just been set down.
        creature: The creature.
        task: The task.
    """

    def __init__(self, world: World, creature: Creature, task: Task) -> None:
        cubes = creature.body.cubes
        self._track = world.track([creature.cubes[cube.id] for cube in cubes], [], [], task.settle_limit_ticks)
        self._arms = np.array([math.hypot(*cube.size) / 2.0 for cube in cubes])
        low, high = creature.body.bounds()
        self._limit = _REST_SPEED * max(b - a for a, b in zip(low, high, strict=True))
        self._ticks, self._still = max(1, round(_REST_TIME * task.tick_rate)), 0
        self.speed = 0.0  # of the fastest corner, when one was too fast last, m/s

    @property
    def reached(self) -> bool:
        """Whether it has been at rest for long enough."""
        return self._still >= self._ticks

    def look(self) -> None:
        """Takes the tick that has just ended."""
        track = self._track
        track.note()
        self.states = track.states(track.rows - 1, track.rows)[0]
        squares = self.states[:, 7:13] * self.states[:, 7:13]
        speeds, spins = (np.sqrt(squares[:, i] + squares[:, i + 1] + squares[:, i + 2]) for i in (0, 3))
        speed = float((speeds + spins * self._arms).max())
        if speed <= self._limit:
            self._still += 1
        else:
            self._still, self.speed = 0, speed


class _Observer:
    """Fills the trajectory of an episode."""

    def __init__(self, world: World, creature: Creature, task: Task, seed: int) -> None:
        body, props = creature.body, task.document["props"]
        cubes = [creature.cubes[cube.id] for cube in body.cubes] + task.prop_ids()
        shapes = [world.cube_shape(name)[0] for name in cubes]
        masses = [*(cube.mass for cube in body.cubes), *(prop["mass"] for prop in props)]
        ids = (*(cube.id for cube in body.cubes), *task.prop_ids())
        bodies = ObservedBodies(
            ids, len(body.cubes), np.array(shapes), np.array(masses, float), task.tick_rate, task.target(seed)
        )
        self.creature = creature
        self._task = task
        touchy = any(quantity.name == "contacts" for quantity in task.needs)
        self.trajectory = Trajectory(bodies, task.ticks, len(creature.motors), contacts=touchy)
        motors = [creature.joints[joint.id] for joint in body.joints if joint.motor is not None]
        sprung = [joint for joint in body.joints if joint.stiffness]
        springs = [creature.joints[joint.id] for joint in sprung]
        self._track = world.track(cubes, springs, motors, task.ticks + 1)
        self._balance = Balance.of(bodies, world.config, [joint.stiffness for joint in sprung])
        self._world, self._cubes = world, cubes
        self.note = self._note_with_touches if touchy else self._track.note

    def _note_with_touches(self) -> None:
        trajectory = self.trajectory
        trajectory.touches[self._track.rows] = self._world.touches(self._cubes, trajectory.bodies.body)
        self._track.note()

    def look(self) -> str | None:
        """Takes the new rows up; returns the name of the condition that has ended the episode, if one has."""
        trajectory, begin, end = self.trajectory, self.trajectory.rows, self._track.rows
        if begin == end:
            return None
        trajectory.states[begin:end] = self._track.states(begin, end)
        trajectory.meter(begin, self._track.powers(begin, end)[:, 1])
        trajectory.rows = end
        stop = self._task.ended(trajectory, max(begin, 1), end)
        if stop is None:
            return None
        trajectory.rows, name = stop
        return name

    def imbalance(self) -> str | None:
        """Returns why the body's energy was not earned, over the rows that count; None where it was."""
        rows = self.trajectory.rows
        powers, positions = self._track.powers(0, rows), self._track.positions(0, rows)
        excess = self._balance.excess(self.trajectory.states[:rows], powers, positions)
        if excess is None:
            return None
        return (
            f"energy: by {excess.time:.2f} s the body had {excess.gain:.3g} J that its motors did not give it, and "
            f"{excess.allowed:.3g} J are allowed"
        )
