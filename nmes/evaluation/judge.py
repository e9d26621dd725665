"""What is told of an episode, and how it comes out: an observer in the world, and a judge wherever the creature is run.

Invariant: how an episode comes out follows from what its judge is told of each tick, and not of how many at a time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np

from nmes.backend import Array
from nmes.errors import WorldError
from nmes.evaluation.balance import Balance, Excess
from nmes.evaluation.task import ALONE, Place, Task
from nmes.objective import Quantity
from nmes.objective.trajectory import Flags, ObservedBodies, Trajectory
from nmes.world import World
from nmes.world.creature import Creature

__all__ = ["MEASURED", "Judge", "Observer", "Result", "Watched", "result_of"]

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
            and `bad_expression`, `restless`, `displaced` and `energy`.
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
        trajectory = Trajectory(bodies, task.ticks, len(motors), contacts=task.touchy)
        self.creature, self.judge = creature, Judge(task, seed, balance, trajectory)
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
        trajectory: Where to keep what is told.

    Attributes:
        balance: Of the energy.
        touchy: Whether it must be told what touches what.
        touches: Where to write that, row by row, before the row is taken: see `Trajectory.touches`.
        trajectory: All that was taken.
    """

    def __init__(self, task: Task, seed: int, balance: Balance, trajectory: Trajectory) -> None:
        self._task, self._seed, self.balance = task, seed, balance
        self.touchy = task.touchy
        self.trajectory = trajectory
        self.touches = trajectory.touches
        self._powers = np.zeros((task.ticks + 1, 2, trajectory.work.shape[1]))
        self._positions = np.zeros((task.ticks + 1, len(balance.stiffnesses)))

    @property
    def start(self) -> tuple[Array, Array]:
        """What it was told of the start: states, array (n, 13), and positions, array (s,)."""
        return self.trajectory.states[0].copy(), self._positions[0].copy()

    def again(self) -> Judge:
        """Returns a judge of the same scene, who has seen what this one has."""
        motors, rows = self._powers.shape[2], self.trajectory.rows
        trajectory = Trajectory(self.balance.bodies, self._task.ticks, motors, contacts=self.touchy)
        judge = Judge(self._task, self._seed, self.balance, trajectory)
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
        result = result_of(self._task, self._seed, values, rows - 1, ended, fault, self._excess(rows))
        return replace(result, duty=trajectory.duty()) if self._task.duty else result

    def _excess(self, rows: int) -> Excess | None:
        """Returns where in the first so many rows the creature had energy of nothing, if it had."""
        states = self.trajectory.states[:rows]
        return self.balance.excess(states, self._powers[:rows], self._positions[:rows])


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
