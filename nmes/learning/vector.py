"""Many copies of a creature on a task, as a vector environment of Gymnasium, stepped by the engine at once.

    envs = gymnasium.make_vec("nmes/walk-v0", num_envs=64, genome="walker")

Hides the core's own arrays, which the next step overwrites: what is returned is the caller's. Row i does what the
single environment does that is reset with the seed of row i, in each mode of autoreset, `info` included.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any, Final

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from nmes.backend import Array
from nmes.backend.arrays import floats
from nmes.evaluation import Environments
from nmes.evaluation.environments import Autoreset
from nmes.evaluation.task import Task, TaskLike
from nmes.genome import Genome
from nmes.genome.genome import GenomeLike
from nmes.learning import spaces
from nmes.learning.cores import Core, Records, closed_on_failure, told
from nmes.learning.environment import check_options
from nmes.objective.trajectory import Flags

__all__ = ["AUTORESET", "CreatureVectorEnv", "TaskVectorEnv"]

AUTORESET: Final[dict[AutoresetMode, Autoreset]] = {
    AutoresetMode.NEXT_STEP: "next_step",
    AutoresetMode.SAME_STEP: "same_step",
    AutoresetMode.DISABLED: "disabled",
}
"""What Gymnasium's modes are called by a core."""


class CreatureVectorEnv(gymnasium.vector.VectorEnv[Array, Array, Any]):
    """A vector environment of Gymnasium over the rows of a core.

    Attributes:
        genome: The creature.
        task: What it is asked to do.
        sensors: The ids of the sensors, the columns of observations.
        motors: The ids of the motors, the columns of actions.
        units: The unit in which each sensor reads, by its id.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012  as its base has it

    def __init__(
        self,
        core: Core,
        autoreset_mode: AutoresetMode | str,
        *,
        record: str | os.PathLike[str] | None = None,
        copy: bool = True,
    ) -> None:
        """Makes an environment.

        Args:
            core: What it stands on, with the same mode of autoreset; closed where nothing comes of the environment.
            autoreset_mode: When a row whose episode is over begins its next.
            record: A folder in which every episode that comes to its end is recorded; None: none is.
            copy: Whether each call returns arrays of its own; else those that the next call overwrites.

        Raises:
            ValueError: There is no such mode.
            WorldError: The creature has no motors, or no sensors.
            RecordingError: The folder cannot be made.
        """
        with closed_on_failure(core):
            self._mode = AutoresetMode(autoreset_mode)
            self.single_observation_space, self.single_action_space = spaces.of(core.genome)
            self._records = None if record is None else Records(record, len(core.results))
        self._core, self._copy = core, copy
        self.genome, self.task, self.sensors, self.motors = core.genome, core.task, core.sensors, core.motors
        self.units, self.num_envs = spaces.units(core.genome), len(core.results)
        fps = core.task.tick_rate
        self.metadata = {**type(self).metadata, "autoreset_mode": self._mode, "render_fps": fps}
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._begun: Flags = np.zeros(self.num_envs, np.bool_)

    def reset(
        self,
        *,
        seed: int | np.integer[Any] | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Array, dict[str, Any]]:
        """Begins an episode in every row, or in those of a mask.

        Args:
            seed: Of the first row, each other having one more than the row before; or one for each row. None goes on to
                the row's next episode; of a seed that the system draws, where there was none.
            options: `reset_mask`, an array (num_envs,) of bool: the rows that begin, one or more.

        Raises:
            ValueError: An option is not known, or is not such; or there are not as many seeds as rows. Nothing has
                changed.
        """
        check_options(options, ["reset_mask"])
        mask = np.ones(self.num_envs, np.bool_) if not options else _mask(options["reset_mask"], self.num_envs)
        seed = int(seed) if isinstance(seed, np.integer) else seed
        super().reset(seed=seed if isinstance(seed, int) else None)
        observations = self._core.reset(self._seeds(seed), mask)
        self.closed = False  # what was closed is there again, and is to be closed again
        self._begun |= mask
        infos: dict[str, Any] = {}
        for row in np.flatnonzero(mask).tolist():
            infos = self._started(infos, row)
        return self._own(observations), infos

    def step(self, actions: Array) -> tuple[Array, Array, Flags, Flags, dict[str, Any]]:
        """Goes one tick on in every row.

        Where an episode is over, `info` has its `result`, and its `recording` if there is one; with the autoreset of
        the same step these are in `final_info`, beside the observation at its end, `final_obs`.

        Raises:
            ValueError: The actions have another shape, or are beyond -1 or 1, or are no numbers; or a row must be reset
                before. Nothing has moved.
        """
        core = self._core
        done = floats(actions, "actions")
        waiting = self._over()
        core.step(done)
        infos: dict[str, Any] = {}
        if self._records is not None:
            for row in np.flatnonzero(~waiting).tolist():
                self._records.note(row, done[row])
        if self._mode is AutoresetMode.NEXT_STEP:
            for row in np.flatnonzero(waiting).tolist():
                infos = self._started(infos, row)
        for row in np.flatnonzero(core.terminated | core.truncated).tolist():
            infos = self._ended(infos, row)
        return (
            self._own(core.observations),
            self._own(core.rewards),
            self._own(core.terminated),
            self._own(core.truncated),
            infos,
        )

    def record(self, row: int, path: str | os.PathLike[str]) -> None:
        """Records the episode that a row's last step belonged to, as far as it has come, in a file.

        Raises:
            ValueError: The row has made no step since it was reset.
            RecordingError: The file cannot be written.
        """
        self._core.record(row, path)

    def close_extras(self, **kwargs: Any) -> None:
        """Ends all episodes; `reset` begins the first once more."""
        self._core.close()
        self._begun[:] = False

    def _seeds(self, seed: int | Sequence[int | None] | None) -> Sequence[int | None]:
        """Returns the seed of each row; None where it goes on with the one it has, which it has had then."""
        count = self.num_envs
        if isinstance(seed, int):
            return [seed + row for row in range(count)]
        seeds: list[int | None] = (
            [None] * count if seed is None else [None if given is None else int(given) for given in seed]
        )
        for row in np.flatnonzero(~self._begun).tolist() if len(seeds) == count else ():
            if seeds[row] is None:
                seeds[row] = int(self.np_random.integers(2**63))
        return seeds

    def _own(self, array: Any) -> Any:
        return array.copy() if self._copy else array

    def _over(self) -> Flags:
        """Returns which rows had their end at the last step, and do nothing in the next."""
        over: Flags = self._core.terminated | self._core.truncated
        return over if self._mode is AutoresetMode.NEXT_STEP else np.zeros_like(over)

    def _started(self, infos: dict[str, Any], row: int) -> dict[str, Any]:
        if self._records is not None:
            self._records.begin(row)
        return self._add_info(infos, {"seed": self._core.seeds[row]}, row)

    def _ended(self, infos: dict[str, Any], row: int) -> dict[str, Any]:
        result = self._core.results[row]
        assert result is not None
        info: dict[str, Any] = {"result": told(result)}
        if self._records is not None:
            info["recording"] = self._records.keep(self._core, row)
        if self._mode is not AutoresetMode.SAME_STEP:
            return self._add_info(infos, info, row)
        last = {"final_obs": self._core.last_observations[row].copy(), "final_info": info}
        return self._started(self._add_info(infos, last, row), row)


class TaskVectorEnv(CreatureVectorEnv):
    """Copies of a creature on a task of this machine: what `gymnasium.make_vec` makes."""

    def __init__(
        self,
        genome: GenomeLike,
        task: TaskLike,
        num_envs: int = 1,
        *,
        reward: str | None = None,
        seeds: Sequence[int] | None = None,
        threads: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        record: str | os.PathLike[str] | None = None,
        copy: bool = True,
    ) -> None:
        """Makes an environment.

        Args:
            genome: The creature: the name of one that ships, a file, a document, or a `Genome`.
            task: What it is asked to do, likewise.
            num_envs: The number of copies.
            reward: An expression whose value at a tick is its reward; None: by how much the task's objective grew.
            seeds: Of the scenes that episodes take; the task's if left out.
            threads: How many threads step the engine.
            autoreset_mode: As for `CreatureVectorEnv`.
            record: As for `CreatureVectorEnv`.
            copy: As for `CreatureVectorEnv`.

        Raises:
            DocumentError: Genome or task cannot be read, or is not as it must be.
            WorldError: The creature does not fit the task, or cannot begin; or the reward is no expression.
            ValueError: There is no such mode, or there are no copies, or no seeds.
            RecordingError: The folder cannot be made.
        """
        mode = AutoresetMode(autoreset_mode)
        core = Environments(
            Genome.load(genome),
            Task.load(task),
            num_envs,
            seeds=seeds,
            threads=threads,
            reward=reward,
            autoreset=AUTORESET[mode],
        )
        super().__init__(core, mode, record=record, copy=copy)


def _mask(mask: Any, count: int) -> Flags:
    """Returns a mask of rows.

    Raises:
        ValueError: It is none, or has no row.
    """
    if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != (count,) or not mask.any():
        raise ValueError(f"reset_mask is an array ({count},) of bool, of which one or more are true")
    return mask
