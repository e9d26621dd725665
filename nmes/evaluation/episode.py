"""One episode: a creature set down in a task's world, then sensed, driven and ticked until the task says stop.

An episode yields its steps. Whoever evaluates does them; whoever proves compares them with a recording. They are the
world's ordinary inputs, so that the recording of an episode replays like any other, without the brain.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Final

import numpy as np

from nmes import protocol
from nmes.backend import Array
from nmes.brain import Brain
from nmes.errors import WorldError
from nmes.evaluation.task import CREATURE, Task
from nmes.genome import Genome
from nmes.objective import Quantity
from nmes.objective.trajectory import ObservedBodies, Trajectory
from nmes.world import World
from nmes.world.creature import Creature

__all__ = ["ANY_CONTROLS", "METADATA", "Episode", "Result", "Step", "brain_of"]

METADATA: Final = "nmes.evaluation"
"""The metadata record of an episode's recording: its `task`, the `genome`'s hash and its `seed`."""
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
        """Yields the steps before the start; makes the observer, unless the world faults while the creature settles."""
        world, task, genome, seed = self._world, self._task, self._genome, self._seed
        for command in task.entry(seed, genome.document, genome.body):
            yield protocol.encode(command)
        for _ in range(task.settle_ticks):
            yield None
            if world.fault is not None:
                return
        creature = world.creature(CREATURE)
        root = world.track([creature.cubes[genome.body.cubes[0].id]], [], 1)
        root.note()
        for command in task.props(seed, genome.body, root.states(0, 1)[0, 0]):
            yield protocol.encode(command)
        self._observer = _Observer(world, creature, task, seed)

    def result(self) -> Result:
        """Returns the result, once all steps are done."""
        world, fault = self._world, None
        if world.fault is not None and self._ended is None:
            fault = f"{world.fault.code}: {world.fault.message}"
        if self._observer is None:
            return Result(self._seed, None, 0.0, 0.0, 0, fault=fault)
        trajectory, score = self._observer.trajectory, None
        measured = trajectory.values((_ENERGY, _DISTANCE))
        if fault is None:
            try:
                score = trajectory.value(self._task.objective)
            except WorldError as error:
                fault = f"{error.code}: {error.message}"
        rest = measured[_ENERGY], measured[_DISTANCE], trajectory.rows - 1
        return Result(self._seed, score, *rest, ended=self._ended, fault=fault)

    def scores_so_far(self) -> Array:
        """Returns the objective's value at the start and after each tick, array (n,); NaN where there is none."""
        if self._observer is None:
            return np.zeros(0)
        return self._observer.trajectory.values_so_far(self._task.objective)


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
        joints = [creature.joints[motor.id] for motor in creature.motors]
        self._track = world.track(cubes, joints, task.ticks + 1)
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
        trajectory.rows = stop[0] + 1
        return stop[1]
