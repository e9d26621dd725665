"""The observer and the judge of a creature whose parts come and go.

Hides that an engine keeps the rows of one set of cubes only, and what energy parts bring along and take with them. What
a part has of motion and height when it comes counts as work of the creature, in what it used and in its balance of
energy: so nobody rises or runs on parts that are free. What it has when it goes is gone: so nobody is flung by a part
that is cut off. What a creature sheds by itself is told to the trajectory: so nobody is flung by kicking off from it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from nmes.backend import Array
from nmes.backend.rotation import total
from nmes.backend.shapes import Shape
from nmes.evaluation.balance import Balance, Excess
from nmes.evaluation.judge import Judge, Observer, Watched
from nmes.evaluation.task import ALONE, Place, Task
from nmes.genome.body import Body
from nmes.objective.changing import ChangingTrajectory
from nmes.objective.trajectory import ObservedBodies
from nmes.world import World
from nmes.world.creature import Creature

__all__ = ["ChangingJudge", "ChangingObserver"]

Columns = npt.NDArray[np.intp]
_BOX: Shape = "box"


@dataclass(frozen=True, eq=False, slots=True)
class _Change:
    """What is other from a row on.

    Attributes:
        came: The energy of what came, and the columns of that.
        went: The energy of what went, when it went, J.
        jolt: The energy of motion that what stayed got by what came, J.
        stopped: The columns of the motors that went, and what each gave in the tick at whose end that was, (2, k), W.
        sprung: The columns of the joints with springs that came: where lost parts are taken up again, bent ones may.
    """

    came: tuple[Balance, Columns]
    went: float
    jolt: float
    stopped: tuple[Columns, Array]
    sprung: Columns


class ChangingJudge(Judge):
    """Decides how an episode comes out whose creature changes.

    Args:
        task: What is asked.
        seed: The episode's.
        balance: Of the energy of what is there at the start.
        trajectory: Where to keep what is told.
    """

    trajectory: ChangingTrajectory

    def __init__(self, task: Task, seed: int, balance: Balance, trajectory: ChangingTrajectory) -> None:
        super().__init__(task, seed, balance, trajectory)
        self._energies = np.zeros(len(trajectory.states))
        self._now, self._rise = balance, balance.rise
        self._change: _Change | None = None

    def change(self, balance: Balance, columns: Columns, change: _Change | None, **body: Any) -> None:
        """Takes note of what is there from the next row on.

        Args:
            balance: Of the energy of what is there then.
            columns: Where that is in the rows.
            change: What is other than before; None at the start.
            body: About the body, as `ChangingTrajectory.change` takes it.
        """
        self.trajectory.change(balance.bodies, columns, **body)
        self._now, self._change = balance, change
        self._rise = min(self._rise, balance.rise)  # of the lightest body that it was

    def take(self, states: Array, powers: Array, positions: Array) -> str | None:
        """As `Judge.take`, of all cubes and motors that may be there, with zeros for those that are not."""
        begin, end, change = self.trajectory.rows, self.trajectory.rows + len(states), self._change
        if begin == end:
            return None
        powers = np.concatenate([powers, np.zeros((len(states), 2, 1))], axis=2)
        if change is not None:
            came, went = _energy(change.came, states[0]), change.went
            bent = self.balance.stiffnesses[change.sprung] * positions[0, change.sprung] * positions[0, change.sprung]
            came = max(came, 0.0) + total(bent.tolist()) / 2.0
            rate = self.trajectory.bodies.tick_rate
            given, used = came - went + change.jolt, came + max(-went, 0.0) + max(change.jolt, 0.0)
            powers[0, 0, -1], powers[0, 1, -1] = given * rate, used * rate
            stopped, last = change.stopped
            powers[0][:, stopped] = last
            self._change = None
        self._energies[begin:end] = self._now.energy(states[:, self.trajectory.there], positions)
        return super().take(states, powers, positions)

    def _excess(self, rows: int) -> Excess | None:
        return self.balance.excess_of(self._energies[:rows], self._powers[:rows], self._rise)


class ChangingObserver(Observer):
    """Tells a judge what one creature does in a world, whatever it loses or gains; `watched` is what is there now."""

    judge: ChangingJudge

    def __init__(self, world: World, creature: Creature, task: Task, seed: int, place: Place = ALONE) -> None:
        self.creature, self._world, self._place = creature, world, place
        self._props: Sequence[Mapping[str, Any]] = task.document["props"]
        self._rate, self._target, self._room = task.tick_rate, task.target(seed, place), task.ticks + 1
        self._limit = task.limits.size
        self._springs = [joint for joint in creature.body.joints if joint.stiffness]
        self._stiffnesses = [joint.stiffness for joint in self._springs]
        self._motors = [joint for joint in creature.body.joints if joint.motor is not None]
        self._ended: str | None = None
        whole = self._bodies(range(len(creature.form.cubes) + len(self._props)))
        trajectory = ChangingTrajectory(whole, task.ticks, len(self._motors), contacts=task.touchy)
        columns = self._columns()
        self._balance = start = Balance.of(self._bodies(columns), world.config, self._stiffnesses)
        self.judge = ChangingJudge(task, seed, start, trajectory)
        self._parts: dict[int, tuple[str, int]] = {}  # the names and numbers of what is there, by the columns
        self._lost: set[int] = set()  # the columns of what went since the last row, and its energy, J
        self._went = self._jolted = 0.0
        self._loose: dict[tuple[str, int], float] = {}  # the parts that it has shed by itself, and their masses, kg
        self._shrunk = 0.0  # the mass of what is gone since parts became smaller, kg
        self._driven = self._moved = np.zeros(0, np.intp)
        self.note = self._note
        self._follow()

    def _bodies(self, columns: Sequence[int]) -> ObservedBodies:
        """Returns the bodies in some columns of all that may be there, with their sizes of now."""
        cubes, props = self.creature.form.cubes, self._props
        body = [cubes[column] for column in columns if column < len(cubes)]
        others = [props[column - len(cubes)] for column in columns if column >= len(cubes)]
        sizes = [*(cube.size for cube in body), *(tuple(map(float, prop["size"])) for prop in others)]
        return ObservedBodies(
            (*(cube.id for cube in body), *(prop["id"] for prop in others)),
            len(body),
            np.array(sizes, float).reshape(-1, 3),
            np.array([*(cube.mass for cube in body), *(prop["mass"] for prop in others)], float),
            self._rate,
            self._target,
            (*(cube.shape for cube in body), *(_BOX for _ in others)),
        )

    def _columns(self) -> list[int]:
        """Returns the columns of what is there."""
        cubes = self.creature.form.cubes
        there = [column for column, cube in enumerate(cubes) if cube.id in self.creature.cubes]
        return there + [len(cubes) + number for number in range(len(self._props))]

    def _there(self) -> dict[int, tuple[str, int]]:
        """Returns the names in the world, and the numbers in the engine, of what is there now, by the columns."""
        creature, cubes, entities = self.creature, self.creature.form.cubes, self._world.entities
        props = [self._place.prop(prop["id"]) for prop in self._props]
        columns = self._columns()
        names = [creature.cubes[cubes[each].id] if each < len(cubes) else props[each - len(cubes)] for each in columns]
        return {each: (name, entities.cube(name).body) for each, name in zip(columns, names, strict=True)}

    def _follow(self) -> None:
        """Begins to keep the rows of what is there now."""
        creature, world, entities = self.creature, self._world, self._world.entities
        old, parts = self._parts, self._there()
        columns = [*parts]
        if old:
            self._leave(parts)
            self._lose(parts)
        springs, motors = (
            np.array([at for at, joint in enumerate(joints) if joint.id in creature.joints], np.intp)
            for joints in (self._springs, self._motors)
        )
        balance = Balance.of(self._bodies(columns), world.config, self._stiffnesses)
        change = None
        if old:
            # Also what a task cut off and a rule took up again within a tick: it is the same cube.
            came = [each for each, part in parts.items() if old.get(each) != part or each in self._lost]
            change = _Change(
                (Balance.of(self._bodies(came), world.config, ()), np.array(came, np.intp)),
                self._went,
                self.creature.jolted - self._jolted,
                self._stopped({entities.joint(name).number for name in creature.joints.values()}),
                np.setdiff1d(springs, self._moved),
            )
            self._lost, self._went = set(), 0.0
        self._jolted = creature.jolted
        shed, present = self._shrunk + total(self._loose.values()), creature.present
        self.judge.change(
            balance,
            np.array(columns, np.intp),
            change,
            shed=shed,
            stature=_stature(present),
            oversized=self._limit is not None and present.size > self._limit,
        )
        self._parts, self._balance, self._layout = parts, balance, creature.layout
        self._moved, self._driven, self._seen = springs, motors, self.judge.trajectory.rows
        kinds = (self._springs, springs), (self._motors, motors)
        joints = [[entities.joint(creature.joints[each[at].id]).number for at in some] for each, some in kinds]
        self._cubes = [name for name, _ in parts.values()]
        self.watched = Watched([number for _, number in parts.values()], *joints)
        self._track = world.simulation.track(*self.watched, self._room - self._seen)

    def cut(self) -> None:
        """Takes note of what was cut off after the last row, before it moves; it is still in the world."""
        self._lose(self._there())

    def _leave(self, there: Mapping[int, tuple[str, int]]) -> None:
        """Takes note of the mass that the creature has left behind by itself since the last row, or taken up again."""
        cubes, masses = self._world.entities.cubes, self._balance.bodies.masses.tolist()
        for (column, part), mass in zip(self._parts.items(), masses, strict=True):
            if column in self._lost or there.get(column) == part:  # the task has cut it off, or it is there
                continue
            name, number = part
            if name in cubes and cubes[name].body == number:
                self._loose[part] = mass
            elif column in there:  # of another size
                self._shrunk += max(mass - self.creature.form.cubes[column].mass, 0.0)
        for part in there.values():
            self._loose.pop(part, None)

    def _lose(self, there: Mapping[int, tuple[str, int]]) -> None:
        """Adds what went since the last row or `cut`: what it has now, or had in that row if it is nowhere any more."""
        lost = {
            column: row
            for row, (column, part) in enumerate(self._parts.items())
            if column not in self._lost and there.get(column) != part
        }
        trajectory, cubes = self.judge.trajectory, self._world.entities.cubes
        states = trajectory.states[trajectory.rows - 1].copy()
        for column in lost:
            name, number = self._parts[column]
            if name in cubes and cubes[name].body == number:
                states[column] = self._world.simulation.states([number])[0]
        bodies = _some(self._balance.bodies, [*lost.values()])
        self._went += _energy((Balance.of(bodies, self._world.config, ()), np.array([*lost], np.intp)), states)
        self._lost |= {*lost}

    def _stopped(self, joints: Collection[int]) -> tuple[Columns, Array]:
        """Returns which motors went, and what they gave in the tick that has just ended, as a change has it."""
        meter, motors = self._world.entities.meter, zip(self._driven.tolist(), self.watched.motors, strict=True)
        went = {column: meter.latest(number) for column, number in motors if number not in joints}
        return np.array([*went], np.intp), np.array([*went.values()], float).reshape(-1, 2).T

    def _note(self) -> None:
        """Keeps a row, after each tick that counts and at the start, for `look`."""
        if self.creature.layout != self._layout:
            self.look()
            self._follow()
        judge = self.judge
        if judge.touchy:
            columns, body = judge.trajectory.there, self._balance.bodies.body
            judge.touches[self._seen + self._track.rows, columns] = self._world.touches(self._cubes, body)
        self._track.note()

    def look(self) -> str | None:
        """Has the new rows judged; returns the name of the condition that has ended the episode, if one has."""
        judge, track = self.judge, self._track
        begin, end = judge.trajectory.rows - self._seen, track.rows
        if self._ended is None and begin < end:
            columns, whole = judge.trajectory.there, len(judge.trajectory.bodies.cubes)
            states = np.zeros((end - begin, whole, 13))
            powers = np.zeros((end - begin, 2, len(self._motors)))
            positions = np.zeros((end - begin, len(self._springs)))
            states[:, columns] = track.states(begin, end)
            powers[:, :, self._driven] = track.powers(begin, end)
            positions[:, self._moved] = track.positions(begin, end)
            self._ended = judge.take(states, powers, positions)
        return self._ended


def _stature(body: Body) -> float:
    """Returns how high the centre of mass of a body is above its lowest point in the pose of its document, m."""
    return total(cube.mass * cube.position[1] for cube in body.cubes) / body.mass - body.bounds[0][1]


def _some(bodies: ObservedBodies, rows: list[int]) -> ObservedBodies:
    """Returns some of the bodies."""
    ids, shapes = tuple(bodies.cubes[row] for row in rows), tuple(bodies.shapes[row] for row in rows)
    return ObservedBodies(ids, len(rows), bodies.sizes[rows], bodies.masses[rows], bodies.tick_rate, shapes=shapes)


def _energy(of: tuple[Balance, Columns], states: Array) -> float:
    """Returns the energy of some bodies in a row of all, J."""
    balance, columns = of
    return float(balance.energy(states[np.newaxis, columns], np.zeros((1, 0)))[0]) if len(columns) else 0.0
