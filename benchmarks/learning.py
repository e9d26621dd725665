"""What stepping environments costs: a vector of walkers beside the engine's own batch and Gymnasium's Ant, and memory.

The bare batch steps the very models of the vector's rows, from the very states, with the very controls. Times are the
processor's, the least of several tries: other work on the machine makes all of them longer.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from typing import Any

import gymnasium
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from measure import Figure
from nmes.backends.mujoco3d.rows import MujocoRow
from nmes.evaluation import Task
from nmes.evaluation.driven import Scene
from nmes.genome import Genome
from nmes.learning import TaskVectorEnv

ROWS, TICKS, TRIES = 64, 60, 12
MANY = 1024
CUBES, ANT = 9, 13  # bodies that move
_MEMORY = """
import resource, numpy as np
from nmes.learning import TaskVectorEnv
envs = TaskVectorEnv("walker", "walk", {rows})
envs.reset(seed=0)
for _ in range(envs.task.ticks + 1):
    envs.step(np.zeros(envs.action_space.shape))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""


def spent(call: Callable[[], object]) -> float:
    """Returns the processor time of a call, s."""
    before = time.process_time()
    call()
    return time.process_time() - before


class Walkers:
    """A vector of walkers, and the engine's batch on what they do."""

    def __init__(self) -> None:
        """Makes both, and runs the vector once to learn its controls."""
        self.envs = TaskVectorEnv("walker", "walk", ROWS)
        task, genome = self.envs.task, self.envs.genome
        self._substeps = task.substeps
        draw = np.random.default_rng(0)
        self._actions = draw.uniform(-1.0, 1.0, (TICKS, ROWS, len(self.envs.motors))).astype(np.float32)
        _, info = self.envs.reset(seed=0)
        scenes = {seed: _row(genome, task, seed) for seed in set(info["seed"].tolist())}
        rows = [scenes[seed] for seed in info["seed"].tolist()]
        self._starts: NDArray[np.float64] = np.array([row.state for row in rows])
        self._batch = Batch(rows[0].model, ROWS, 1)
        self._batch.set_models([row.model for row in rows])
        motors = genome.body.motors
        low, high = (np.array([getattr(motor, end) for motor in motors]) for end in ("low", "high"))
        columns = [rows[0].compiled.actuator[number] for number in rows[0].compiled.actuator]
        self._controls = np.zeros((TICKS, ROWS, len(columns)))
        self._controls[:, :, columns] = low + (self._actions.astype(float) + 1.0) * ((high - low) / 2.0)

    def vector(self) -> float:
        """Steps the vector."""
        self.envs.reset(seed=0)
        return spent(lambda: [self.envs.step(actions) for actions in self._actions])

    def batch(self) -> float:
        """Steps the bare batch."""
        self._batch.state[:] = self._starts
        controls = self._batch.bind("ctrl")

        def run() -> None:
            for row in self._controls:
                controls[:] = row
                self._batch.step(None, self._substeps)

        return spent(run)


def _row(genome: Genome, task: Task, seed: int) -> MujocoRow:
    row = Scene.of(genome, task, seed, touchy=False).row
    assert isinstance(row, MujocoRow)
    return row


class Ant:
    """Gymnasium's Ant, which starts over as it ends."""

    _STEPS = 300

    def __init__(self) -> None:
        """Makes it."""
        self._env: gymnasium.Env[Any, Any] = gymnasium.make("Ant-v5")
        self._env.action_space.seed(0)
        self._actions = [self._env.action_space.sample() for _ in range(self._STEPS)]
        self.body_steps = self._STEPS * ANT * self._env.unwrapped.frame_skip  # type: ignore[attr-defined]

    def run(self) -> float:
        """Goes through all actions."""
        self._env.reset(seed=0)
        return spent(self._steps)

    def _steps(self) -> None:
        for action in self._actions:
            _, _, terminated, truncated, _ = self._env.step(action)
            if terminated or truncated:
                self._env.reset()


def figures() -> Iterator[Figure]:
    """Measures."""
    walkers = Walkers()
    ours, bare = np.array([(walkers.vector(), walkers.batch()) for _ in range(TRIES)]).min(axis=0).tolist()
    details = {"us a step of the vector": 1e6 * ours / TICKS, "us a step of the batch": 1e6 * bare / TICKS}
    yield Figure(f"make_vec, {ROWS} walkers / bare batch", bare / ours, "x", at_least=0.90, details=details)
    if find_spec("gymnasium.envs.mujoco") is None or find_spec("imageio") is None:
        yield Figure("body-steps/s: Gymnasium's Ant", 0.0, "(not installed: pip install 'nmes[bench]')")
    else:
        ant = Ant()
        theirs = ant.body_steps / min(ant.run() for _ in range(TRIES))
        rate = ROWS * TICKS * CUBES * walkers.envs.task.substeps / ours
        details = {"ours": rate, "Gymnasium's Ant": theirs}
        yield Figure("body-steps/s: make_vec / Gymnasium's Ant", rate / theirs, "x", at_least=1.4, details=details)
    program = _MEMORY.format(rows=MANY)
    done = subprocess.run(
        [sys.executable, "-P", "-c", program], capture_output=True, text=True, check=True, env=os.environ
    )
    yield Figure(f"make_vec, {MANY:,} walkers: memory of the process", float(done.stdout), "MiB", at_most=300.0)


def main() -> None:
    """Measures, and prints."""
    for figure in figures():
        print(f"{figure.name}: {figure.value:.3g} {figure.unit} ({figure.aim or 'no aim'}) {dict(figure.details)}")


if __name__ == "__main__":
    main()
