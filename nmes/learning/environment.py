"""One creature on a task, as an environment of Gymnasium.

    env = gymnasium.make("nmes/walk-v0", genome="walker")

Hides how seeds become scenes, how an episode is drawn (in a world that follows it), and where it is recorded. Whatever
has rows can stand under it: `Environments` of this machine, or those of a live host.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np

from nmes.backend import Array, Image, load_backend
from nmes.backend.arrays import floats
from nmes.errors import WorldError
from nmes.evaluation import Environments, Task
from nmes.evaluation.driven import DrivenWorld
from nmes.evaluation.task import TaskLike
from nmes.genome import Genome
from nmes.genome.genome import GenomeLike
from nmes.learning import spaces
from nmes.learning.cores import Core, Records, closed_on_failure, told
from nmes.learning.registration import register
from nmes.learning.window import Window

__all__ = ["CreatureEnv", "TaskEnv", "check_options"]

_MODES = ("rgb_array", "human")
_SIZE = (640, 480)

register()  # whoever has one of these may make others by name


def _modes(mode: str | None, task: Task) -> list[str]:
    """Returns the modes in which a task can be drawn, once it is sure that the wanted one is among them.

    Raises:
        ValueError: There is no such mode.
        WorldError: `unsupported`: the task's engine draws no pictures, or not on this machine.
    """
    if mode is not None and mode not in _MODES:
        raise ValueError(f"render_mode is None or one of {', '.join(_MODES)}, not {mode!r}")
    engine = load_backend(task.world_config(0)["backend"])
    if "camera" in engine.capabilities:
        return list(_MODES)
    if mode is not None:
        raise WorldError("unsupported", f"{engine.refusal('camera', 'cameras')}; leave render_mode out", "render_mode")
    return []


def check_options(options: dict[str, Any] | None, known: Sequence[str] = ()) -> None:
    """Refuses options of `reset` that there are not.

    Raises:
        ValueError: There is one that is not known.
    """
    strange = sorted(set(options or ()) - set(known))
    if strange:
        raise ValueError(f"reset has the options {', '.join(known) or '(none)'}, not {strange[0]!r}")


class CreatureEnv(gymnasium.Env[Array, Array]):
    """An environment of Gymnasium over the one row of a core, whose autoreset is disabled.

    An observation is what the genome's sensors read, an array (sensors,); an action an array (motors,), each from -1 to
    1. Where an episode is over, `info["result"]` tells how it came out, as `nmes eval` would, and `info["recording"]`
    in which file it is, if it is recorded. `reset` tells in `info["seed"]` which of the task's scenes it is.

    Attributes:
        genome: The creature.
        task: What it is asked to do.
        sensors: The ids of the sensors, the columns of observations.
        motors: The ids of the motors, the columns of actions.
        units: The unit in which each sensor reads, by its id.
    """

    metadata: dict[str, Any] = {"render_modes": list(_MODES), "render_fps": 60}  # noqa: RUF012  as its base has it

    def __init__(
        self, core: Core, *, render_mode: str | None = None, record: str | os.PathLike[str] | None = None
    ) -> None:
        """Makes an environment.

        Args:
            core: What it stands on, which is closed where nothing comes of the environment.
            render_mode: `rgb_array`; `human`, for a window that shows every tick; or None where nobody draws it.
            record: A folder in which every episode that comes to its end is recorded; None: none is.

        Raises:
            ValueError: There is no such mode.
            WorldError: The creature has no motors, or no sensors; or the engine draws no pictures.
            RecordingError: The folder cannot be made.
        """
        with closed_on_failure(core):
            modes = _modes(render_mode, core.task)
            self.observation_space, self.action_space = spaces.of(core.genome)
            self._records = None if record is None else Records(record, 1)
        self._core, self.render_mode = core, render_mode
        self.genome, self.task, self.sensors, self.motors = core.genome, core.task, core.sensors, core.motors
        self.metadata = {"render_modes": modes, "render_fps": core.task.tick_rate}
        self.units = spaces.units(core.genome)
        self._window = Window(f"{core.genome.name} on {core.task.name}", core.task.tick_rate)
        self._begun = False
        self._done: list[Array] = []  # the actions of this episode, where it is drawn
        self._drawn: DrivenWorld | None = None
        self._drawn_ticks = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begins an episode.

        Args:
            seed: From 0: the same one gives the same episodes, everywhere. None goes on to the next episode of the seed
                before; of one that the system draws, where there was none.
            options: There are none.

        Raises:
            ValueError: An option is not known; nothing has changed.
            MissingPackage, WorldError: There is to be a window, and none can be opened.
        """
        check_options(options)
        super().reset(seed=seed)
        if seed is None and not self._begun:
            seed = self.np_random_seed
        self._core.reset([seed])
        self._begun = True
        self._forget()
        if self._records is not None:
            self._records.begin(0)
        self._show()
        return self._core.observations[0].copy(), {"seed": self._core.seeds[0]}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Goes one tick on.

        Raises:
            ValueError: The action has another shape, or is beyond -1 or 1, or is no number; or the episode is over, or
                none has begun. Nothing has moved.
        """
        done = floats(action, "actions")
        if done.shape != (len(self.motors),):
            raise ValueError(f"an action has the shape ({len(self.motors)},), for each motor, not {done.shape}")
        core = self._core
        core.step(done[np.newaxis])
        if self.render_mode is not None:
            self._done.append(done.copy())
        if self._records is not None:
            self._records.note(0, done)
        terminated, truncated = bool(core.terminated[0]), bool(core.truncated[0])
        info: dict[str, Any] = {}
        result = core.results[0]
        if result is not None and (terminated or truncated):
            info["result"] = told(result)
            if self._records is not None:
                info["recording"] = self._records.keep(core, 0)
        self._show()
        return core.observations[0].copy(), float(core.rewards[0]), terminated, truncated, info

    def record(self, path: str | os.PathLike[str]) -> None:
        """Records the present episode, as far as it has come, in a file.

        It is done again in a world, action by action, to the same bits; the environment is left as it is.

        Raises:
            ValueError: No step was made since the reset.
            RecordingError: The file cannot be written.
        """
        self._core.record(0, path)

    def render(self) -> Image | None:
        """Returns a picture of the creature now, an array (480, 640, 3) of bytes.

        None where `render_mode` is None, or `human`: then the window shows it already.

        Raises:
            ValueError: No episode has begun.
            WorldError: `unsupported`: no OpenGL works here.
        """
        if self.render_mode is None:
            gymnasium.logger.warn(f"this environment draws nothing: make it with render_mode={_MODES[0]!r}")
            return None
        if not self._begun:
            raise ValueError("no episode has begun: reset comes first")
        return self._picture() if self.render_mode == "rgb_array" else None

    def _show(self) -> None:
        if self.render_mode == "human":
            self._window.show(self._picture())

    def _picture(self) -> Image:
        if self._drawn is None:
            self._drawn = DrivenWorld(self.genome, self.task, self._core.seeds[0])
        for action in self._done[self._drawn_ticks :]:
            if self._drawn.step(action) is not None:
                break
        self._drawn_ticks = len(self._done)
        return self._drawn.picture(_SIZE)

    def close(self) -> None:
        """Ends the episode; `reset` begins another."""
        self._forget()
        self._window.close()
        self._core.close()
        self._begun = False

    def _forget(self) -> None:
        """Ends the world in which the episode was drawn."""
        if self._drawn is not None:
            self._drawn.close()
        self._drawn, self._drawn_ticks = None, 0
        self._done.clear()


class TaskEnv(CreatureEnv):
    """A creature on a task of this machine: what `gymnasium.make` makes."""

    def __init__(
        self,
        genome: GenomeLike,
        task: TaskLike,
        *,
        reward: str | None = None,
        seeds: Sequence[int] | None = None,
        render_mode: str | None = None,
        record: str | os.PathLike[str] | None = None,
    ) -> None:
        """Makes an environment.

        Args:
            genome: The creature: the name of one that ships, a file, a document, or a `Genome`.
            task: What it is asked to do, likewise.
            reward: An expression whose value at a tick is its reward; None: by how much the task's objective grew.
            seeds: Of the scenes that episodes take; the task's if left out.
            render_mode: As for `CreatureEnv`.
            record: As for `CreatureEnv`.

        Raises:
            DocumentError: Genome or task cannot be read, or is not as it must be.
            WorldError: The creature does not fit the task, or cannot begin; or the reward is no expression.
            ValueError: There is no such mode, or there are no seeds.
            RecordingError: The folder cannot be made.
        """
        core = Environments(Genome.load(genome), Task.load(task), 1, seeds=seeds, reward=reward, autoreset="disabled")
        super().__init__(core, render_mode=render_mode, record=record)
