"""Who wins a match: what the creatures of its roles did, tick by tick, and what that is worth to each of them.

The rules, which hold in every task with roles:

- A creature that is beyond a limit of its role, that never comes to rest, over one of whose cubes the engine fails, or
  whose objective has no finite value has lost: it has no score, and its fault says why. The others are scored as it was
  at the tick before; where the engine fails before the start, as it was there.
- Where several are beyond limits at the same tick, and one is ten times as fast as others, these are not blamed: it has
  blown up, and struck them.
- Who is too fast, or spins too fast, by what others gave is not beyond a limit: as long as it has so much of them as is
  at least half of the energy with which its cubes move that are too fast. So nobody wins by a stroke that is too hard.
- All bodies together are audited, since who is pushed gains what another's motors gave. Where they had energy that no
  motor gave them, whoever had most of that first, beyond the work of its own motors, has lost likewise: energy is first
  where it is made.
- A match that fails otherwise is void, since it cannot be said whose doing that is: nobody has a score.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from nmes.backend import Array
from nmes.errors import WorldError
from nmes.evaluation.balance import Balance
from nmes.evaluation.judge import MEASURED, Result
from nmes.evaluation.match_task import MatchTask, Role
from nmes.objective.trajectories import Trajectories
from nmes.objective.trajectory import Flags, ObservedBodies, Trajectory, beyond, earliest, in_order, lengths
from nmes.world import World
from nmes.world.creature import Creature

__all__ = ["Referee", "culprit", "void_results"]

_BLAST = 10.0  # how many times as fast as others a creature is that has blown up
_DRIVEN = ("speed", "spin")  # limits that others may take a creature beyond
_GIVEN = 0.5  # of the energy of cubes that are too fast, what others give whoever is not to be blamed


def void_results(task: MatchTask, seed: int, fault: str) -> dict[str, Result]:
    """Returns the results of a match in which nobody has a score, since it could not begin."""
    return {role: Result(seed, None, 0.0, 0.0, 0, fault=fault) for role in task.roles}


def culprit(world: World, task: MatchTask) -> str | None:
    """Returns the role over one of whose cubes the engine has failed; None where it has not, or over nobody's."""
    name = "" if world.fault is None else (world.fault.cube or "").partition(".")[0]
    return name if name in task.roles else None


class Referee:
    """Watches a match from its start on.

    Args:
        world: The match's, with all creatures at their start.
        task: What is played.
        seed: The match's.

    Attributes:
        trajectories: All that was looked at.
        ended: What ended the match early: a condition, or who was beyond which limit; None where nothing has.
    """

    def __init__(self, world: World, task: MatchTask, seed: int) -> None:
        self._world, self._task, self._seed = world, task, seed
        self._sides = {role: _Side(world, world.creature(role)) for role in task.roles}
        props, sides = task.prop_ids(), self._sides.values()
        names = [*(cube for side in sides for cube in side.cubes), *props]
        self._numbers = [world.entities.cube(name).body for name in names]
        bodies = _observed(world, names, len(names) - len(props), task.tick_rate)
        self._columns = _slices([*(len(side.cubes) for side in sides), len(props)])
        parts = [self._part(side, bodies, columns) for side, columns in zip(sides, self._columns, strict=False)]
        things = Trajectory(_picked(bodies, self._columns[-1], props, 1), task.ticks, 0, contacts=task.counts_contacts)
        self._things = things if props else None
        targets = {role.name: role.target for role in task.roles.values() if isinstance(role.target, str)}
        named = dict(zip(task.roles, parts, strict=True))
        self.trajectories = Trajectories(named, self._things, targets, task.ticks, touches=task.touchy)
        self._watch(bodies)
        self._losses: dict[str, str] = {}
        self.ended: str | None = None

    def _part(self, side: _Side, bodies: ObservedBodies, columns: slice) -> Trajectory:
        target, ids = self._task.roles[side.role].target, side.ids
        observed = _picked(bodies, columns, ids, len(ids))
        observed = replace(observed, target=None if isinstance(target, str) else target)
        return Trajectory(observed, self._task.ticks, len(side.motors), contacts=self._task.counts_contacts)

    def _watch(self, bodies: ObservedBodies) -> None:
        """Has the engine keep what the rows are made of, and makes room for what the balance of energy is drawn of."""
        sides, rows = self._sides.values(), self._task.ticks + 1
        springs, motors = ([number for side in sides for number in numbers(side)] for numbers in (_springs, _motors))
        self._balance = Balance.of(bodies, self._world.config, [s for side in sides for s in side.stiffnesses])
        self._track = self._world.simulation.track(self._numbers, springs, motors, rows)
        self._driven = _slices([len(side.motors) for side in sides])
        self._sprung = _slices([len(side.springs) for side in sides])
        self._states, self._powers = np.zeros((rows, len(self._numbers), 13)), np.zeros((rows, 2, len(motors)))
        self._positions = np.zeros((rows, len(springs)))
        owners = [index for index, side in enumerate(sides) for _ in side.cubes]
        things = range(len(self._sides), len(self._sides) + len(self._task.prop_ids()))
        self._owners = dict(zip(self._numbers, [*owners, *things], strict=True))

    def note(self) -> None:
        """Keeps a row, for `look`: at the start, and after each tick that counts."""
        if self._task.touchy or self._task.counts_contacts:
            self._note_touches(self._track.rows)
        self._track.note()

    def _note_touches(self, row: int) -> None:
        trajectories, simulation = self.trajectories, self._world.simulation
        parts = [*trajectories.of.values(), *([] if self._things is None else [self._things])]
        for index, (part, columns) in enumerate(zip(parts, self._columns, strict=False)):
            for column, number in enumerate(self._numbers[columns]):
                others = [contact.other for contact in simulation.contacts(number)]
                touched = {None if other is None else self._owners.get(other) for other in others}
                if self._task.counts_contacts:
                    part.touches[row, column] = bool(touched), bool(touched - {index})
                if self._task.touchy and index < len(trajectories.of):
                    for other in touched - {None, index}:
                        trajectories.touching[row, index, other] = True

    def look(self) -> bool:
        """Has the new rows judged; returns whether the match is over."""
        trajectories, track = self.trajectories, self._track
        begin, end = trajectories.rows, track.rows
        if begin == end:
            return self.ended is not None
        rows = slice(begin, end)
        self._powers[rows], self._positions[rows] = track.powers(begin, end), track.positions(begin, end)
        self._take(track.states(begin, end), begin, end)
        self._stop(max(begin, 1), end)
        return self.ended is not None

    def look_at_failed_start(self) -> None:
        """Judges the match as over at its start, since the engine failed before: of that it tells only the states."""
        self._take(self._world.simulation.states(self._numbers)[np.newaxis], 0, 1)

    def _take(self, states: Array, begin: int, end: int) -> None:
        """Hands the states of new rows, whose powers are known, to the trajectories."""
        trajectories, rows = self.trajectories, slice(begin, end)
        self._states[rows] = states
        for part, columns, motors in zip(trajectories.of.values(), self._columns, self._driven, strict=False):
            part.states[rows] = self._states[rows, columns]
            part.meter(begin, self._powers[rows, 1, motors])
        if self._things is not None:
            self._things.states[rows] = self._states[rows, self._columns[-1]]
        self._count(end)

    def _count(self, rows: int) -> None:
        """Says how many rows count, of everybody."""
        things = [] if self._things is None else [self._things]
        for part in (*self.trajectories.of.values(), *things, self.trajectories):
            part.rows = rows

    def _stop(self, begin: int, end: int) -> None:
        """Looks for what ended the match: where a condition holds that row still counts, beyond a limit it does not."""
        trajectories = self.trajectories
        held = [
            (row + 1, name)
            for name, condition in self._task.ends
            if (row := trajectories.first(condition, begin, end)) is not None
        ]
        lost = {
            role: stop
            for role, part in trajectories.of.items()
            if (stop := self._beyond(role, part, begin, end)) is not None
        }
        if not held and not lost:
            return
        rows = min(row for row, _ in (*held, *lost.values()))
        self.ended = next((name for row, name in held if row == rows), None)
        if self.ended is None:
            losses = {role: limit for role, (row, limit) in lost.items() if row == rows}
            speeds = {role: _fastest(trajectories.of[role], rows) for role in losses}
            slowest = max(speeds.values()) / _BLAST
            self._losses = {role: limit for role, limit in losses.items() if speeds[role] >= slowest}
            self.ended = ", ".join(f"{role}: {limit}" for role, limit in self._losses.items())
        self._count(rows)

    def results(self, restless: Mapping[str, str]) -> dict[str, Result]:
        """Returns how the match came out for each role, once: after all steps are done, it ends where it must have.

        Args:
            restless: Of the roles whose creatures never came to rest, why.
        """
        losses = {role: f"beyond: it was beyond its limit of {limit}" for role, limit in self._losses.items()}
        losses |= restless
        void, fault = None, self._world.fault
        if fault is not None and self.ended is None:
            loser, reason = culprit(self._world, self._task), f"{fault.code}: {fault.message}"
            void = reason if loser is None else None
            losses |= {} if loser is None else {loser: reason}
        losses |= self._audit()
        return {role.name: self._result(role, void or losses.get(role.name)) for role in self._task.roles.values()}

    def _audit(self) -> dict[str, str]:
        """Draws the balance of energy; where it does not hold, the match was over at the tick before.

        Returns:
            Who has made energy of nothing, with the reason.
        """
        rows = slice(0, self.trajectories.rows)
        excess = self._balance.excess(self._states[rows], self._powers[rows], self._positions[rows])
        if excess is None:
            return {}
        last = round(excess.time * self._task.tick_rate)
        rows, own = slice(0, last + 1), []
        for role in self._sides:
            balance, *parts = self._own(role, last + 1)
            own.append(balance.free(*parts))
        gains = self._balance.gains(self._states[rows], self._powers[rows], self._positions[rows])[0]
        # Since all together had the least, each rise is of whoever has risen most in that tick: who is struck by others
        # rises too, but all together do not.
        least = int(np.flatnonzero(gains == 0.0)[-1])
        each = np.nan_to_num(np.diff(np.array([*own, gains])[:, least:]), nan=np.inf)  # what is no number is beyond all
        rises, firsts = np.maximum(each[-1], 0.0), each[:-1] == each[:-1].max(axis=0)
        made = [float(rises[first].sum()) for first in firsts]
        self._count(last)
        makers = [role for role, gain in zip(self._sides, made, strict=True) if gain == max(made)]
        self.ended = ", ".join(f"{role}: energy of nothing" for role in makers)
        return dict.fromkeys(makers, str(excess))

    def _beyond(self, role: str, part: Trajectory, begin: int, end: int) -> tuple[int, str] | None:
        """As `Trajectory.first_beyond`, but for rows in which others made it as fast as it is."""
        bounds = self._task.roles[role].bounds
        stop = part.first_beyond(begin, end, **bounds)
        if stop is None or stop[1] not in _DRIVEN:
            return stop
        flagged = beyond(part.bodies, part.states[begin:end], part.work[begin:end], **bounds)
        struck = self._struck(role, begin, end)
        return earliest(flagged | {name: flagged[name] & ~struck for name in _DRIVEN}, begin)

    def _struck(self, role: str, begin: int, end: int) -> Flags:
        """Returns in which rows a creature has of others the energy of its cubes that are too fast, shape (k,).

        Where all together have energy of nothing, it has not.
        """
        all_gains, all_allowed = self._balance.gains(self._states[:end], self._powers[:end], self._positions[:end])
        balance, states, *rest = self._own(role, end)
        gains, allowed = balance.gains(states, *rest)
        bounds, motion = self._task.roles[role].bounds, states[begin:, :, 7:13]
        fast = (lengths(motion[..., :3]) > bounds["speed"]) | (lengths(motion[..., 3:]) > bounds["spin"])
        needed = _GIVEN * in_order(np.where(fast, balance.kinetic(states[begin:]), 0.0))
        given = (gains - allowed)[begin:]
        return np.asarray((given >= needed) & (all_gains <= all_allowed)[begin:])

    def _own(self, role: str, rows: int) -> tuple[Balance, Array, Array, Array]:
        """Returns the balance of energy of one creature, and what it is drawn of in the first rows."""
        side, index = self._sides[role], [*self._sides].index(role)
        balance = Balance.of(self.trajectories.of[role].bodies, self._world.config, side.stiffnesses)
        states, powers = self._states[:rows, self._columns[index]], self._powers[:rows, :, self._driven[index]]
        return balance, states, powers, self._positions[:rows, self._sprung[index]]

    def _result(self, role: Role, fault: str | None) -> Result:
        measured = [replace(quantity, role=role.name) for quantity in MEASURED]
        values = self.trajectories.values(dict.fromkeys((*measured, *role.objective.needs)))
        score = None
        if fault is None:
            try:
                score = role.objective.value(values)
            except WorldError as error:
                fault = f"{error.code}: {error.message}"
        energy, distance = (values[quantity] for quantity in measured)
        return Result(self._seed, score, energy, distance, self.trajectories.rows - 1, ended=self.ended, fault=fault)


class _Side:
    """The creature of one role, and its parts in the world."""

    def __init__(self, world: World, creature: Creature) -> None:
        self.role, self._world, self._creature = creature.name, world, creature
        self.ids = [cube.id for cube in creature.body.cubes]
        self.cubes = [creature.cubes[part] for part in self.ids]
        self.motors = [creature.joints[joint.id] for joint in creature.body.joints if joint.motor is not None]
        sprung = [joint for joint in creature.body.joints if joint.stiffness]
        self.springs = [creature.joints[joint.id] for joint in sprung]
        self.stiffnesses = [joint.stiffness for joint in sprung]

    def numbers(self, joints: list[str]) -> list[int]:
        """Returns the engine's numbers of joints."""
        return [self._world.entities.joint(name).number for name in joints]


def _fastest(part: Trajectory, row: int) -> float:
    """Returns how fast the fastest corner of a body is at a row, m/s; where that is no number, infinity."""
    body = part.bodies.columns(None)
    motion, sizes = part.states[row, body, 7:13], part.bodies.sizes[body]
    speeds, spins, diagonals = lengths(motion[:, :3]), lengths(motion[:, 3:]), lengths(sizes)
    corners = speeds + spins * diagonals / 2.0
    return float(np.nan_to_num(corners, nan=np.inf).max())


def _springs(side: _Side) -> list[int]:
    return side.numbers(side.springs)


def _motors(side: _Side) -> list[int]:
    return side.numbers(side.motors)


def _slices(counts: list[int]) -> list[slice]:
    ends = np.cumsum(counts).tolist()
    return [slice(end - count, end) for end, count in zip(ends, counts, strict=True)]


def _observed(world: World, names: list[str], body: int, tick_rate: int) -> ObservedBodies:
    cubes = [world.entities.cube(name) for name in names]
    sizes, masses = np.array([cube.size for cube in cubes]), np.array([cube.mass for cube in cubes], float)
    return ObservedBodies(tuple(names), body, sizes, masses, tick_rate, shapes=tuple(cube.shape for cube in cubes))


def _picked(bodies: ObservedBodies, columns: slice, ids: list[str], body: int) -> ObservedBodies:
    """Returns some of the bodies, by the ids that expressions have for them."""
    return ObservedBodies(
        tuple(ids),
        body,
        bodies.sizes[columns],
        bodies.masses[columns],
        bodies.tick_rate,
        shapes=bodies.shapes[columns],
    )
