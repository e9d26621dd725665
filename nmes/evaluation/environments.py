"""Episodes of one creature that are driven from outside, side by side: what a learner steps.

    environments = Environments(genome, task, count=256, threads=2)
    observations = environments.reset(seed=1)
    observations, rewards, terminated, truncated = environments.step(actions)

Hides that scenes are set once and then taken over as rows of an engine, that a row whose episode is over begins the
next one at once, and where no row can go on as one: there the episode has a world of its own.

Invariants: an episode with given actions has the same bits as a world driven with them, and its result is that of an
`Episode`. Which scene an episode has follows from the seed, the row and the number of its episodes before.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from nmes import protocol
from nmes.backend import Array, Places, Row
from nmes.errors import WorldError
from nmes.evaluation.cohort import PlaceOfRows
from nmes.evaluation.episode import Episode, Judge, Result, Watched
from nmes.evaluation.task import CREATURE, Task
from nmes.genome import Genome
from nmes.objective import Quantity
from nmes.objective.trajectory import Flags, QuantityRows, beyond, touches
from nmes.world import World
from nmes.world.creature import Creature, CreatureRows

__all__ = ["Environments"]


class Environments:
    """Rows of a creature on a task, each of which begins its next episode as soon as one is over.

    Attributes:
        sensors: The ids of the sensors, the columns of observations.
        motors: The ids of the motors, the columns of actions.
        observations: Array (count, sensors): what the sensors read.
        rewards: Array (count,): by how much the objective grew in this tick. Those of an episode add up to its score;
            where it has none, what it was given is taken back at its end.
        terminated: Array (count,), whether the episode was ended by the task's ends and limits, or by a fault.
        truncated: Array (count,), whether the episode has lasted its time.
        last_observations: Array (count, sensors): where an episode is over, what was sensed at its end; `observations`
            are then those of the start of the next.
        results: Of each row, how the episode came out that was over last; None where none was yet.
    """

    def __init__(
        self, genome: Genome, task: Task, count: int, *, seeds: Sequence[int] | None = None, threads: int = 1
    ) -> None:
        """Sets all scenes.

        Args:
            genome: The creature; its brain, if it has one, is not asked.
            task: What it is asked to do, and for how long.
            count: The number of rows.
            seeds: Of the scenes that episodes take; the task's if left out.
            threads: How many threads step the engine.

        Raises:
            ValueError: There are no rows, or no seeds.
            WorldError: The creature may not take part, or cannot begin.
        """
        self._genome, self._task = genome, task
        seeds = task.seeds if seeds is None else seeds
        if count < 1 or not seeds:
            raise ValueError(f"there must be 1 row and 1 seed or more, not {count} and {len(seeds)}")
        reasons = task.check(genome.body)
        if reasons:
            raise WorldError("invalid", "; ".join(reasons))
        self._scenes = [_Scene.of(genome, task, seed) for seed in seeds]
        first = self._scenes[0]
        self.sensors = tuple(sensor.id for sensor in first.creature.sensors)
        self.motors = tuple(motor.id for motor in first.creature.motors)
        self._episodes = [_Running(first) for _ in range(count)]
        self._engine = None if first.row is None else _Engine(first, task, count, threads)
        bodies = first.judge.trajectory.bodies
        self._quantities = QuantityRows(bodies, task.needs, count)
        self._tick = _Parts((count,), first)
        self._block = _Parts((count, task.tick_rate), first)
        self._touches: Flags = np.zeros((count, len(bodies.cubes) if first.judge.touchy else 0, 2), np.bool_)
        self._ticks, self._watts = np.zeros(count, np.intp), np.zeros((count, len(self.motors)))
        self._actions = np.zeros((task.ticks, count, len(self.motors)))  # of the episodes so far
        self._all, self._seed = np.arange(count), 0
        self.observations, self.last_observations = np.zeros((2, count, len(self.sensors)))
        self.rewards: Array = np.zeros(count)
        self.terminated: Flags = np.zeros(count, np.bool_)
        self.truncated: Flags = np.zeros(count, np.bool_)
        self.results: list[Result | None] = [None] * count

    def reset(self, seed: int) -> Array:
        """Begins an episode in every row.

        Args:
            seed: From which, with its number, each row draws the scenes of its episodes; from 0.

        Returns:
            `observations`.
        """
        self._seed = seed
        self.results = [None] * len(self._episodes)
        for episode in self._episodes:
            episode.number = 0
        self._begin(self._all.tolist())
        return self.observations

    def step(self, actions: Array) -> tuple[Array, Array, Flags, Flags]:
        """Goes one tick on in every row.

        Args:
            actions: Array (count, motors), each from -1 to 1.

        Returns:
            `observations`, `rewards`, `terminated` and `truncated`, which the next step overwrites.

        Raises:
            ValueError: The actions have another shape, or are beyond -1 or 1, or no `reset` came before; nothing has
                moved.
        """
        self._check(actions)
        self._actions[self._ticks, self._all] = actions
        faults = self._move(actions)
        self._block.write((self._all, self._ticks % self._task.tick_rate), self._tick)
        self._ticks += 1
        over = self._judge(faults)
        if over:
            self.last_observations[over] = self.observations[over]
            self._begin(over)
        return self.observations, self.rewards, self.terminated, self.truncated

    def close(self) -> None:
        """Ends all episodes, and the worlds of those that have one; `reset` begins others."""
        for episode in self._episodes:
            episode.leave()
            episode.number = 0

    def _check(self, actions: Array) -> None:
        if not self._episodes[0].number:
            raise ValueError("no episodes have begun: reset comes first")
        shape = len(self._episodes), len(self.motors)
        if actions.shape != shape:
            raise ValueError(f"actions have the shape {shape}, for each row and motor, not {actions.shape}")
        kept = np.abs(actions) <= 1.0
        if not kept.all():
            row, motor = np.argwhere(~kept)[0].tolist()
            value = actions[row, motor]
            raise ValueError(f"actions are from -1 to 1; that of row {row} for {self.motors[motor]!r} is {value}")

    # -- one tick -----------------------------------------------------------------------------------------------------

    def _move(self, actions: Array) -> dict[int, str]:
        """Moves every row, and reads it; returns of those that fault why."""
        places = np.array([place for place, episode in enumerate(self._episodes) if episode.world is None], np.intp)
        if self._engine is not None and len(places):
            lost = self._engine.step(places, actions)
            for place in lost:  # what becomes of them only worlds can tell
                self._leave(place)
            places = places[~np.isin(places, lost)]
            self._engine.read(places, self.observations, self._tick)
            if self._touches.size:
                self._engine.touch(places, self._touches)
        faults = {}
        for place, episode in enumerate(self._episodes):
            world = episode.world
            if world is None:
                continue
            fault = world.step(actions[place])
            if fault is not None:
                faults[place] = fault
                continue
            self.observations[place] = world.creature.sense()
            world.read(place, self._tick)
            if self._touches.size:
                self._touches[place] = world.touches()
        return faults

    def _leave(self, place: int) -> None:
        """Gives an episode a world of its own, in which it has done all but the actions of this tick."""
        episode = self._episodes[place]
        episode.world = _World(self._genome, self._task, episode.scene.seed)
        for action in self._actions[: self._ticks[place], place]:
            episode.world.step(action)

    def _judge(self, faults: Mapping[int, str]) -> list[int]:
        """Rewards every row; returns those whose episode is over."""
        task, over = self._task, []
        self._watts += self._tick.powers[:, 1]
        work = self._watts / task.tick_rate
        values = self._quantities.add(self._tick.states, work, self._touches)
        columns = {quantity: column.tolist() for quantity, column in values.items()}
        flagged = beyond(self._quantities.bodies, self._tick.states, work, **task.bounds)
        far = np.logical_or.reduce(list(flagged.values()))
        for place, (episode, tick) in enumerate(zip(self._episodes, self._ticks.tolist(), strict=True)):
            now = {quantity: column[place] for quantity, column in columns.items()}
            fault = faults.get(place)
            ended = fault is not None or far[place] or any(condition.holds(now) for _, condition in task.ends)
            if fault is None and self._touches.size:
                episode.judge.touches[tick] = self._touches[place]
            if ended or tick % task.tick_rate == 0 or tick == task.ticks:
                self._tell(place, tick if fault is None else tick - 1)
            self.terminated[place], self.truncated[place] = ended, not ended and tick == task.ticks
            if ended or tick == task.ticks:
                result = self.results[place] = episode.judge.result(episode.ended, fault)
                self.rewards[place] = episode.reward(result.score or 0.0)
                over.append(place)
            else:
                self.rewards[place] = episode.reward(self._worth(now))
        return over

    def _worth(self, values: Mapping[Quantity, float]) -> float | None:
        """Returns the episode's score so far; None where that is no finite number."""
        try:
            return self._task.objective.value(values)
        except WorldError:
            return None

    def _tell(self, place: int, tick: int) -> None:
        """Tells the judge of a row what it has not been told yet, up to a tick."""
        episode, block = self._episodes[place], self._block
        rows = slice(0, tick - (episode.judge.trajectory.rows - 1))
        episode.ended = episode.judge.take(
            block.states[place, rows], block.powers[place, rows], block.positions[place, rows]
        )

    def _begin(self, places: list[int]) -> None:
        """Begins the next episode in some rows."""
        rows = []
        for place in places:
            episode = self._episodes[place]
            draw = np.random.SeedSequence(self._seed, spawn_key=(place, episode.number))
            scene = self._scenes[int(draw.generate_state(1)[0]) % len(self._scenes)]
            episode.begin(scene)
            episode.number += 1
            trajectory = scene.judge.trajectory
            self._quantities.begin(place, trajectory.states[0], trajectory.touches[:1].reshape(-1, 2), scene.target)
            self.observations[place] = scene.senses
            if self._engine is not None and self._engine.takes(scene):
                rows.append((place, scene))
            else:
                episode.world = _World(self._genome, self._task, scene.seed)
        self._ticks[places], self._watts[places] = 0, 0.0
        if self._engine is not None and rows:
            self._engine.put(rows)


class _Parts:
    """What judges are told of ticks: arrays (*lead, n, 13), (*lead, 2, m) and (*lead, s); see `Judge.take`."""

    def __init__(self, lead: tuple[int, ...], scene: _Scene) -> None:
        bodies, springs, motors = map(len, scene.watched)
        self.states = np.zeros((*lead, bodies, 13))
        self.powers = np.zeros((*lead, 2, motors))
        self.positions = np.zeros((*lead, springs))

    def write(self, at: tuple[Places, Places], parts: _Parts) -> None:
        """Writes the parts of a tick where they belong."""
        self.states[at], self.powers[at], self.positions[at] = parts.states, parts.powers, parts.positions


class _Running:
    """One row's episode: its scene, its judge, its world if it has one, and what it was given so far."""

    def __init__(self, scene: _Scene) -> None:
        self.number = 0  # of episodes that began
        self.world: _World | None = None
        self.begin(scene)

    def begin(self, scene: _Scene) -> None:
        """Begins the next episode."""
        self.leave()
        self.scene, self.judge, self._given = scene, scene.judge.again(), 0.0
        self.ended: str | None = None

    def reward(self, worth: float | None) -> float:
        """Returns by how much the episode is worth more than before; nothing where that is not known."""
        reward = 0.0 if worth is None else worth - self._given
        self._given += reward
        return reward

    def leave(self) -> None:
        """Ends its world."""
        if self.world is not None:
            self.world.close()
            self.world = None


class _World:
    """An episode in a world of its own, at its start, where somebody else drives it."""

    def __init__(self, genome: Genome, task: Task, seed: int) -> None:
        """Sets the scene.

        Raises:
            WorldError: The creature cannot begin.
        """
        self._world = world = World(task.world_config(seed))
        self._client = client = world.join()
        episode = Episode(world, genome, None, task, seed, logged=True)
        for step in episode.steps():
            if step is None:
                world.tick()
            elif isinstance(step, bytes):
                reply = protocol.decode(world.handle(client, protocol.parse(step)))
                if reply["type"] == "error":
                    raise WorldError(reply["code"], reply["message"], reply.get("field"))
            else:
                break  # from here on it is driven
        start = episode.start()
        if start is None:
            raise WorldError("invalid", f"the creature cannot begin with seed {seed}: {episode.result().fault}")
        self.creature, self.watched, self.judge = start
        self._track = world.simulation.track(*self.watched, task.ticks)

    def hand_over(self) -> Row | None:
        """Gives the scene away as a row, if it can be one; then this world is done with."""
        return self._world.simulation.hand_over()

    def step(self, action: Array) -> str | None:
        """Goes one tick on; returns why it cannot, if it cannot."""
        world = self._world
        world.drive(self._client, CREATURE, action)
        world.tick()
        if world.fault is not None:
            return f"{world.fault.code}: {world.fault.message}"
        self._track.note()
        return None

    def read(self, place: int, parts: _Parts) -> None:
        """Writes what a judge is told of the last tick."""
        track = self._track
        rows = track.rows - 1, track.rows
        parts.states[place], parts.powers[place] = track.states(*rows)[0], track.powers(*rows)[0]
        parts.positions[place] = track.positions(*rows)[0]

    def touches(self) -> Flags:
        """Returns the touches of all rows, as `Trajectory.touches`."""
        return touches(self._world.simulation, self.watched.bodies, self.judge.trajectory.bodies.body)

    def close(self) -> None:
        """Ends the world."""
        self._world.close()


@dataclass(frozen=True, eq=False, slots=True)
class _Scene:
    """A scene at the start of an episode: all that episodes of its seed have in common."""

    seed: int
    creature: Creature
    watched: Watched
    judge: Judge
    senses: Array
    row: Row | None
    target: tuple[float, float, float] | str | None

    @classmethod
    def of(cls, genome: Genome, task: Task, seed: int) -> _Scene:
        """Sets the scene in a world.

        Raises:
            WorldError: The creature cannot begin.
        """
        world = _World(genome, task, seed)
        try:
            row = world.hand_over()
            senses = world.creature.sense().copy()
            return cls(seed, world.creature, world.watched, world.judge, senses, row, task.target(seed))
        finally:
            world.close()


class _Engine:
    """The rows of an engine with creatures of one plan in them."""

    def __init__(self, first: _Scene, task: Task, count: int, threads: int) -> None:
        assert first.row is not None
        feels = any(sensor.type == "touch" for sensor in first.creature.sensors)
        self._first, self._substeps = first, task.substeps
        self._rows = first.row.rows(count, threads=threads, contacts=feels or first.judge.touchy)
        self._creatures = CreatureRows(self._rows, first.creature)
        self._track = self._rows.track(*first.watched, 1, task.substeps)

    def takes(self, scene: _Scene) -> bool:
        """Whether a scene can be one of the rows."""
        first, row = self._first, scene.row
        if row is None or first.row is None:
            return False
        mine = first.row.layout, first.creature.plan, first.watched
        return mine == (row.layout, scene.creature.plan, scene.watched)

    def put(self, scenes: Iterable[tuple[int, _Scene]]) -> None:
        """Begins scenes in places."""
        scenes = list(scenes)
        self._rows.put([place for place, _ in scenes], [scene.row for _, scene in scenes if scene.row is not None])
        for place, scene in scenes:
            self._creatures.put(place, scene.creature)

    def step(self, places: Places, actions: Array) -> list[int]:
        """Drives some places, and goes one tick on; returns those that cannot go on as rows."""
        self._creatures.drive(places, actions[places])
        return self._rows.step(places, self._substeps)

    def read(self, places: Places, observations: Array, parts: _Parts) -> None:
        """Writes what is sensed in some places, and what judges are told of them."""
        track = self._track
        track.note()
        observations[places] = self._creatures.sense()[places]
        parts.states[places] = track.states()[places, 0]
        parts.powers[places], parts.positions[places] = track.powers()[places, 0], track.positions()[places, 0]
        track.clear()

    def touch(self, places: Places, out: Flags) -> None:
        """Writes what touches what in some places."""
        bodies, body = self._first.watched.bodies, self._first.judge.trajectory.bodies.body
        for place in places.tolist():
            out[place] = touches(PlaceOfRows(self._rows, place), bodies, body)
