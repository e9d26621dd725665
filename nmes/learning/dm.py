"""One creature on a task, in the terms of `dm_env`, by the conventions of dm-control.

    environment = dm_environment("walk", "walker", random=1)
    time_step = environment.reset()

An episode that the task ends has the discount 0 at its last step; one that has lasted its time has 1, as what comes
after it would be worth as much. `step` after the last step, and at first, begins an episode, and ignores its action.
"""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from typing import Any

import dm_env
import numpy as np
from dm_env import specs

from nmes.backend import Array
from nmes.backend.arrays import floats
from nmes.evaluation import Environments, Result
from nmes.evaluation.task import Task, TaskLike
from nmes.genome import Genome
from nmes.genome.body import Sensor
from nmes.genome.genome import GenomeLike
from nmes.learning import spaces
from nmes.learning.cores import Core, closed_on_failure

__all__ = ["DmEnvironment", "dm_environment"]


def dm_environment(
    task: TaskLike,
    genome: GenomeLike,
    *,
    random: int | None = None,
    reward: str | None = None,
    seeds: Sequence[int] | None = None,
) -> DmEnvironment:
    """Makes an environment of this machine.

    Args:
        task: What the creature is asked to do: the name of a task that ships, a file, a document, or a `Task`.
        genome: The creature, likewise.
        random: The seed, from 0, from which episodes draw their scenes; None: one that the system draws.
        reward: An expression whose value at a tick is its reward; None: by how much the task's objective grew.
        seeds: Of the scenes that episodes take; the task's if left out.

    Raises:
        DocumentError: Genome or task cannot be read, or is not as it must be.
        WorldError: The creature does not fit the task, cannot begin, or has no motors or sensors; or the reward is no
            expression.
        ValueError: There are no seeds.
    """
    core = Environments(Genome.load(genome), Task.load(task), 1, seeds=seeds, reward=reward, autoreset="disabled")
    return DmEnvironment(core, random)


class DmEnvironment(dm_env.Environment):  # type: ignore[misc]
    """An environment of `dm_env` over the one row of a core, whose autoreset is disabled.

    Observations are arrays by name: of joints together, by what is sensed (`position`, `velocity`, `effort`); of a cube
    each for itself (`torso.up`). An action is an array (motors,), each from -1 to 1.

    Attributes:
        sensors: The ids of the sensors that each observation is made of.
        result: How the last episode came out, as `nmes eval` would tell; None where none was over yet.
    """

    def __init__(self, core: Core, random: int | None = None) -> None:
        """Makes an environment.

        Args:
            core: What it stands on, which is closed where nothing comes of the environment.
            random: The seed; None: one that the system draws.

        Raises:
            WorldError: The creature has no motors, or no sensors.
        """
        with closed_on_failure(core):
            observed, acted = spaces.of(core.genome)
        self._core, self._seed = core, secrets.randbits(63) if random is None else random
        self._begun = False
        self._goes = False  # whether an episode goes on
        self.result: Result | None = None
        self._columns: dict[str, list[int]] = {}
        for column, sensor in enumerate(core.genome.body.sensors):
            self._columns.setdefault(_name(sensor), []).append(column)
        self.sensors = {name: tuple(core.sensors[i] for i in columns) for name, columns in self._columns.items()}
        self._observations = {
            name: specs.BoundedArray((len(columns),), np.float64, observed.low[columns], observed.high[columns], name)
            for name, columns in self._columns.items()
        }
        self._actions = specs.BoundedArray(acted.shape, np.float64, acted.low, acted.high, "\t".join(core.motors))

    def reset(self) -> dm_env.TimeStep:
        """Begins the next episode, and returns its first step."""
        self._core.reset([None if self._begun else self._seed])
        self._begun = self._goes = True
        return dm_env.restart(self._sensed())

    def step(self, action: Any) -> dm_env.TimeStep:
        """Goes one tick on, or begins the next episode where none goes on.

        Raises:
            ValueError: The action has another shape, or is beyond -1 or 1, or is no number. Nothing has moved.
        """
        if not self._goes:
            return self.reset()
        done = floats(action, "actions")
        if done.shape != self._actions.shape:
            raise ValueError(f"an action has the shape {self._actions.shape}, for each motor, not {done.shape}")
        core = self._core
        core.step(done[np.newaxis])
        reward, sensed = float(core.rewards[0]), self._sensed()
        self._goes = not (core.terminated[0] or core.truncated[0])
        if self._goes:
            return dm_env.transition(reward, sensed)
        self.result = core.results[0]
        return dm_env.termination(reward, sensed) if core.terminated[0] else dm_env.truncation(reward, sensed)

    def _sensed(self) -> dict[str, Array]:
        row = self._core.observations[0]
        return {name: row[columns] for name, columns in self._columns.items()}

    def observation_spec(self) -> dict[str, specs.BoundedArray]:
        """Returns the shapes, types and bounds of the observations, by name."""
        return dict(self._observations)

    def action_spec(self) -> specs.BoundedArray:
        """Returns the shape and bounds of actions; its name has the motors' ids with tabs between, as dm-control's."""
        return self._actions

    def control_timestep(self) -> float:
        """Returns the time of a tick, s."""
        return 1.0 / self._core.task.tick_rate

    def close(self) -> None:
        """Ends the episode; `reset` begins the first once more."""
        self._core.close()
        self._begun = self._goes = False


def _name(sensor: Sensor) -> str:
    return sensor.type if sensor.of == "joint" else f"{sensor.target}.{sensor.type}"
