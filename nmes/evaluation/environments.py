"""Episodes of one creature that are driven from outside, side by side: what a learner steps.

    environments = Environments(genome, task, count=256, threads=2)
    observations = environments.reset(seed=1)
    observations, rewards, terminated, truncated = environments.step(actions)

Hides that scenes are set once and then taken over as rows of an engine, when a row begins its next episode, and where
no row can go on as one: there the episode has a world of its own.

Invariants: an episode with given actions has the same bits as a world driven with them, and its result is that of an
`Episode`. Which scene an episode has follows from its row's seed and the number of the row's episodes before.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from operator import index
from pathlib import Path
from typing import Final, Literal, SupportsIndex

import numpy as np

from nmes.backend import Array, Places
from nmes.backend.arrays import ArrayLike
from nmes.errors import WorldError
from nmes.evaluation.driven import DrivenWorld, EngineRows, Scene
from nmes.evaluation.evaluator import episode_metadata, recorded
from nmes.evaluation.judge import Result
from nmes.evaluation.judging import JudgeRows
from nmes.evaluation.progress import read_reward
from nmes.evaluation.seeding import RowSeeds, check_actions, read_seeds
from nmes.evaluation.task import Task
from nmes.genome import Genome
from nmes.objective.trajectory import Flags

__all__ = ["AUTORESET", "Autoreset", "Environments"]

Autoreset = Literal["same_step", "next_step", "disabled"]
AUTORESET: Final[tuple[Autoreset, ...]] = ("same_step", "next_step", "disabled")
"""When a row whose episode is over begins its next: in the same step, in the next one, or when it is reset."""


class Environments:
    """Rows of a creature on a task, each with one episode after the other.

    Attributes:
        genome: The creature.
        task: What it is asked to do.
        sensors: The ids of the sensors, the columns of observations.
        motors: The ids of the motors and voices, the columns of actions.
        observations: Array (count, sensors): what the sensors read.
        rewards: Array (count,). By how much the objective grew in this tick: those of an episode add up to its score;
            where it has none, what it was given is taken back at its end. Or what the expression of `reward` is.
        terminated: Array (count,), whether the episode was ended by the task's ends and limits, or by a fault.
        truncated: Array (count,), whether the episode has lasted its time.
        last_observations: Array (count, sensors): where an episode is over, what was sensed at its end; with the
            autoreset `same_step`, `observations` are then those of the start of the next.
        results: Of each row, how the episode came out that was over last; None where none was yet.
    """

    def __init__(
        self,
        genome: Genome,
        task: Task,
        count: int,
        *,
        seeds: Iterable[SupportsIndex] | None = None,
        threads: int = 1,
        reward: str | None = None,
        autoreset: Autoreset = "same_step",
    ) -> None:
        """Sets all scenes.

        Args:
            genome: The creature; its brain, if it has one, is not asked.
            task: What it is asked to do, and for how long.
            count: The number of rows.
            seeds: Of the scenes that episodes take; the task's if left out.
            threads: How many threads step the engine.
            reward: An objective's expression, whose value at a tick is that tick's reward; its folds are over the
                episode so far. Where it is no finite number, there is no reward. None: the task's objective's growth.
            autoreset: When a row whose episode is over begins its next: in the `same_step`; in the `next_step`, whose
                action it ignores; or, `disabled`, when it is reset.

        Raises:
            TypeError: The number of rows, or a seed, is no whole number.
            ValueError: There are no rows, or no seeds, or no such autoreset.
            WorldError: The creature may not take part, or cannot begin; or the reward cannot be read
                (`bad_expression`).
        """
        self.genome, self.task = genome, task
        seeds, count = task.seeds if seeds is None else read_seeds(seeds), index(count)
        if count < 1 or not seeds:
            raise ValueError(f"there must be 1 row and 1 seed or more, not {count} and {len(seeds)}")
        if autoreset not in AUTORESET:
            raise ValueError(f"autoreset is one of {', '.join(AUTORESET)}, not {autoreset!r}")
        reasons = task.check_driven(genome.body)
        if reasons:
            raise WorldError("invalid", "; ".join(reasons))
        paid = None if reward is None else read_reward(reward, genome, task)
        touchy = task.touchy or (paid is not None and any(quantity.name == "contacts" for quantity in paid.needs))
        self._scenes = [Scene.of(genome, task, seed, touchy=touchy) for seed in seeds]
        first = self._scenes[0]
        self.sensors = tuple(sensor.id for sensor in first.creature.sensors)
        self.motors = first.creature.body.outputs
        self._judge, self._touchy = JudgeRows(task, first, count, paid), touchy
        self._engine = None if first.row is None else EngineRows(first, task, count, threads, touchy=touchy)
        self._rows = [_Row(first) for _ in range(count)]
        self._worlds: dict[int, DrivenWorld] = {}
        self._autoreset: Autoreset = autoreset
        self._waits: Flags = np.ones(count, np.bool_)  # rows that have no episode now
        self._actions = np.zeros((task.ticks, count, len(self.motors)))  # of the episodes so far
        self._all, self._seeds = np.arange(count), RowSeeds(count)
        self.observations, self.last_observations = np.zeros((2, count, len(self.sensors)))
        self.rewards: Array = self._judge.rewards
        self.terminated: Flags = np.zeros(count, np.bool_)
        self.truncated: Flags = np.zeros(count, np.bool_)
        self.results: list[Result | None] = [None] * count

    @property
    def seeds(self) -> list[int]:
        """Of each row, the seed of the scene that its episode has."""
        return [row.scene.start.seed for row in self._rows]

    def reset(
        self, seed: SupportsIndex | Iterable[SupportsIndex | None] | None = None, rows: Flags | None = None
    ) -> Array:
        """Begins an episode in every row, or in some.

        Args:
            seed: From which, and from the number of its episodes since, a row draws the scenes of its episodes. A
                number, from 0, is that of the first row, and each has one more than the row before; or one for each
                row. None: the row goes on with its next episode.
            rows: In which rows, array (count,); in all if left out.

        Returns:
            `observations`.

        Raises:
            TypeError: A seed is no whole number.
            ValueError: A row has never had a seed, or there are not as many seeds as rows, or one is below 0; nothing
                has begun.
        """
        places = self._all[slice(None) if rows is None else rows].tolist()
        self._seeds.take(seed, places)
        for place in places:
            self.results[place] = None
        self._begin(places)
        for place in places:
            self._rows[place].last = None
        self.rewards[places], self.terminated[places], self.truncated[places] = 0.0, False, False
        return self.observations

    def step(self, actions: ArrayLike) -> tuple[Array, Array, Flags, Flags]:
        """Goes one tick on in every row.

        Args:
            actions: Array (count, motors), each from -1 to 1.

        Returns:
            `observations`, `rewards`, `terminated` and `truncated`, which the next step overwrites.

        Raises:
            ValueError: The actions have another shape, or are beyond -1 or 1, or no numbers, or a row must be reset
                before; nothing has moved.
        """
        actions = self._check(actions)
        judge, going = self._judge, ~self._waits
        begin = self._all[self._waits].tolist()
        places = self._all if not begin else self._all[going]
        self._actions[judge.ticks[places], places] = actions[places]
        faults = self._move(places, actions)
        judge.take(going)
        self.terminated[:] = judge.over
        self.terminated[list(faults)] = True
        np.equal(judge.ticks, self.task.ticks, out=self.truncated)
        self.truncated &= going & ~self.terminated
        over = np.flatnonzero(self.terminated | self.truncated).tolist()
        if over:
            self._end(over, faults)
        judge.turn()
        due = over if self._autoreset == "same_step" else begin
        if due:
            self._begin(due)
        return self.observations, self.rewards, self.terminated, self.truncated

    def close(self) -> None:
        """Ends all episodes, and the worlds of those that have one; `reset` begins others."""
        for world in self._worlds.values():
            world.close()
        self._worlds.clear()
        self._waits[:] = True
        self._seeds.forget()
        for row in self._rows:
            row.last = None

    def record(self, row: int, path: str | os.PathLike[str]) -> None:
        """Records the episode that a row's last step belonged to: in a world that is driven with its actions.

        Args:
            row: Which.
            path: The file; one that is there is replaced when the new one is whole.

        Raises:
            ValueError: The row has made no step since it was reset.
            RecordingError: The file cannot be written.
        """
        episode, ticks, over = self._rows[row], int(self._judge.ticks[row]), bool(self._waits[row])
        scene = episode.scene
        if over or not ticks:
            if episode.last is None:
                raise ValueError(f"row {row} has made no step since it was reset: there is nothing to record")
            (scene, ticks), over = episode.last, True
        actions = self._actions[:ticks, row]
        if over:  # an evaluation is stopped when its judge looks, which is once a second
            rate, task = self.task.tick_rate, self.task
            rest = min(-(-ticks // rate) * rate, task.ticks) - ticks
            actions = np.concatenate([actions, np.repeat(actions[-1:], rest, axis=0)])
        with recorded(Path(path), episode_metadata(self.genome, self.task, scene.start.seed)) as journal:
            world = DrivenWorld(self.genome, self.task, scene.start.seed, journal)
            try:
                for action in actions:
                    if world.step(action) is not None:
                        break
                world.leave()
            finally:
                world.close()

    def _check(self, actions: ArrayLike) -> Array:
        if not self._seeds.complete:
            raise ValueError("no episodes have begun: reset comes first")
        if self._autoreset == "disabled" and self._waits.any():
            raise ValueError(f"the episode of row {int(self._waits.argmax())} is over: reset it first")
        return check_actions(actions, len(self._rows), self.motors)

    # -- one tick -----------------------------------------------------------------------------------------------------

    def _move(self, places: Places, actions: Array) -> dict[int, str]:
        """Moves some rows, and reads them; returns of those that fault why."""
        parts, touches, worlds = self._judge.parts, self._judge.touches, self._worlds
        if self._engine is not None:
            rows = places if not worlds else places[~np.isin(places, list(worlds))]
            if len(rows):
                lost = self._engine.step(rows, actions)
                for place in lost:  # what becomes of them only worlds can tell
                    self._leave(place)
                rows = rows if not lost else rows[~np.isin(rows, lost)]
            if len(rows):
                self._engine.read(rows, self.observations, parts)
                if self._touchy:
                    self._engine.touch(rows, touches)
        faults = {}
        for place in places.tolist() if worlds else ():
            if place not in worlds:
                continue
            world = worlds[place]
            fault = world.step(actions[place])
            if fault is not None:
                faults[place] = fault
                continue
            self.observations[place] = world.creature.sense()
            world.read(place, parts)
            if self._touchy:
                touches[place] = world.touches()
        return faults

    def _leave(self, place: int) -> None:
        """Gives an episode a world of its own, in which it has done all but the actions of this tick."""
        self._worlds[place] = world = DrivenWorld(self.genome, self.task, self._rows[place].scene.start.seed)
        for action in self._actions[: self._judge.ticks[place], place]:
            world.step(action)

    def _end(self, places: Sequence[int], faults: Mapping[int, str]) -> None:
        """Has some episodes come out, at their ends."""
        for place, result in zip(places, self._judge.results(places, faults), strict=True):
            self.results[place] = result
            row = self._rows[place]
            row.last = row.scene, int(self._judge.ticks[place])
        self.last_observations[places] = self.observations[places]
        self._waits[places] = True

    def _begin(self, places: Sequence[int]) -> None:
        """Begins the next episode in some rows."""
        rows = []
        for place in places:
            row = self._rows[place]
            row.scene = scene = self._seeds.draw(place, self._scenes)
            self._seeds.count(place)
            self._judge.begin(place, scene)
            self.observations[place] = scene.senses
            self._release(place)
            if self._engine is not None and self._engine.takes(scene):
                rows.append((place, scene))
            else:
                self._worlds[place] = DrivenWorld(self.genome, self.task, scene.start.seed)
        self._waits[list(places)] = False
        if self._engine is not None and rows:
            self._engine.put(rows)

    def _release(self, place: int) -> None:
        """Ends the world of a row, if it has one."""
        world = self._worlds.pop(place, None)
        if world is not None:
            world.close()


class _Row:
    """One row: its scene, and its last episode."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.last: tuple[Scene, int] | None = None  # the scene and the ticks of the episode that was over last
