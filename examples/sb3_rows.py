"""Rows of a creature as Stable-Baselines3 steps many environments: `gymnasium.make_vec` in its terms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecEnv

__all__ = ["Rows"]


class Rows(VecEnv):  # type: ignore[misc] # its package is not there where types are checked
    """Copies of a creature on a task that the engine steps at once.

    Args:
        environment: Such as `nmes/walk-v0`.
        count: How many.
        seed: Of the first episodes; each row goes on from there.
        options: As for `gymnasium.make_vec`: `genome`, `threads` and so on.
    """

    def __init__(self, environment: str, count: int, seed: int, **options: Any) -> None:
        # Stable-Baselines3 wants the first observation of the next episode in the step that ends one.
        mode = AutoresetMode.SAME_STEP
        self._envs = gymnasium.make_vec(environment, num_envs=count, autoreset_mode=mode, **options)
        super().__init__(count, self._envs.single_observation_space, self._envs.single_action_space)
        self._seed: int | None = seed
        self._actions = np.zeros((count, *self.action_space.shape))

    def reset(self) -> Any:
        """Begins an episode in every row."""
        observations, _ = self._envs.reset(seed=self._seed)
        self._seed = None
        return observations

    def step_async(self, actions: Any) -> None:
        """Takes the actions of the next step."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, Any, Any, list[dict[str, Any]]]:
        """Goes one tick on."""
        observations, rewards, terminated, truncated, told = self._envs.step(self._actions)
        over = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in over]
        for row in np.flatnonzero(over).tolist():
            infos[row] = {"terminal_observation": told["final_obs"][row], "TimeLimit.truncated": bool(truncated[row])}
        return observations, rewards, over, infos

    def close(self) -> None:
        """Ends all episodes."""
        self._envs.close()

    # What Stable-Baselines3 may ask of the single environments; there are none, but rows.

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Returns an attribute for each row: that of all."""
        return [getattr(self._envs, attr_name, None)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuses: rows have no attributes of their own."""
        raise NotImplementedError("rows have no attributes of their own")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Refuses: rows have no methods of their own."""
        raise NotImplementedError("rows have no methods of their own")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> Sequence[bool]:
        """Returns that no row is wrapped."""
        return [False] * len(list(self._get_indices(indices)))
