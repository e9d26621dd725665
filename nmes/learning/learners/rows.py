"""What learners step: rows of environments, side by side; and Gymnasium's vector environments as such rows.

`nmes.evaluation.Environments` are rows as they are. An array that a step returns may be written anew by the next.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from nmes.backend import Array
from nmes.objective.trajectory import Flags

if TYPE_CHECKING:
    from gymnasium.vector import VectorEnv

__all__ = ["GymnasiumRows", "Rows", "Spaces", "Step"]

Step = tuple[Array, Array, Flags, Flags]
"""Observations (n, sensors), rewards (n,), terminated (n,) and truncated (n,)."""


class Rows(Protocol):
    """Environments side by side, each of which begins its next episode in the step in which one is over.

    Attributes:
        last_observations: Array (n, sensors): where an episode is over, what was seen at its end; `step` returns what
            is seen at the start of the next.
    """

    last_observations: Array

    def reset(self, seed: int) -> Array:
        """Begins an episode in every row; returns observations (n, sensors)."""

    def step(self, actions: Array, /) -> Step:
        """Goes one step on in every row.

        Args:
            actions: Array (n, motors) of numbers from -1 to 1; where actions are choices, array (n, 1) of their
                numbers, from 0.
        """


@dataclass(frozen=True, slots=True)
class Spaces:
    """How many numbers go in and out of a policy.

    Attributes:
        sensors: The numbers that are observed.
        motors: The controls of an action; or, where actions are choices, how many there are to choose from.
        choices: Whether an action is one of some choices.
    """

    sensors: int
    motors: int
    choices: bool = False


class GymnasiumRows:
    """A vector environment of Gymnasium as rows.

    Args:
        environment: With observations of one axis, and actions that are a box of one axis or choices; it resets
            rows in the step in which they are done (`AutoresetMode.SAME_STEP`).

    Raises:
        ValueError: It is another.

    Attributes:
        spaces: What goes in and out of a policy.
        last_observations: See `Rows`.
    """

    def __init__(self, environment: VectorEnv[Any, Any, Any]) -> None:
        from gymnasium.spaces import Box, Discrete
        from gymnasium.vector import AutoresetMode

        if environment.metadata.get("autoreset_mode") != AutoresetMode.SAME_STEP:
            raise ValueError("rows reset in the step in which they are done: make it with AutoresetMode.SAME_STEP")
        seen, done = environment.single_observation_space, environment.single_action_space
        if not isinstance(seen, Box) or len(seen.shape) != 1:
            raise ValueError(f"observations must be a box of one axis, not {seen}")
        if isinstance(done, Discrete):
            self.spaces = Spaces(seen.shape[0], int(done.n), choices=True)
            self._first = int(done.start)
        elif isinstance(done, Box) and len(done.shape) == 1 and done.is_bounded("both"):
            self.spaces = Spaces(seen.shape[0], done.shape[0])
            self._low, self._high = done.low.astype(np.float64), done.high.astype(np.float64)
        else:
            raise ValueError(f"actions must be a box of one axis with bounds, or choices, not {done}")
        self._environment = environment
        self.last_observations = np.zeros((environment.num_envs, self.spaces.sensors))

    def reset(self, seed: int) -> Array:
        """Begins an episode in every row; see `Rows`."""
        observations, _ = self._environment.reset(seed=seed)
        return np.asarray(observations, np.float64)

    def step(self, actions: Array, /) -> Step:
        """Goes one step on in every row; see `Rows`."""
        if self.spaces.choices:
            given = actions[:, 0].astype(np.int64) + self._first
        else:
            box = self._environment.single_action_space
            given = (self._low + (actions + 1.0) * (0.5 * (self._high - self._low))).astype(box.dtype)
        observations, rewards, terminated, truncated, infos = self._environment.step(given)
        for row in np.flatnonzero(terminated | truncated).tolist():
            self.last_observations[row] = infos["final_obs"][row]
        return observations.astype(np.float64), rewards.astype(np.float64), terminated, truncated
