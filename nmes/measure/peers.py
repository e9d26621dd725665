"""The same body and the same learner here and in a plain environment of Gymnasium.

Hides the plain environment, which is what anybody writes who has a model of MuJoCo: it steps the very model that our
world compiled, from the state in which our episode begins; what is observed are the positions and velocities of
the model, as in Gymnasium's own Ant. The task is the same in both: how far along x the centre of mass gets.
"""

from __future__ import annotations

import re
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from statistics import fmean
from typing import Any, Final

import gymnasium
import mujoco
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv

from nmes.backend import Array
from nmes.errors import SimulationFault
from nmes.evaluation import Task
from nmes.evaluation.driven import Scene
from nmes.genome import Genome
from nmes.learning.environment import TaskEnv
from nmes.learning.learners.experience import Collector
from nmes.learning.learners.ppo import Ppo
from nmes.learning.learners.rows import GymnasiumRows
from nmes.learning.remote_env import Remote
from nmes.learning.vector import TaskVectorEnv
from nmes.measure.hosts import running_host
from nmes.measure.turns import in_turns, ratio
from nmes.playback import replay
from nmes.variation.draw import Draw
from nmes.world import World

__all__ = ["OTHERS", "PeerCosts", "StructuralChange", "measure_peers"]

OTHERS: Final = ("evogym", "playground", "godot-rl", "mlagents", "isaacgym")
"""Packages of other peers: Evolution Gym, MuJoCo Playground, Godot RL Agents, ML-Agents, Isaac Gym."""
_NAME: Final = re.compile(r"[A-Za-z0-9._-]+")  # of a package, where a requirement begins
_ROWS: Final = 8  # environments side by side, where there are several
_TICKS: Final = 300  # of an episode
_TRIAL: Final = 150  # steps of a round: less than an episode
_OPTIONS: Final = Ppo.Options(rows=_ROWS, ticks=_TICKS)
_TASK: Final[Mapping[str, Any]] = {
    "format": "nmes-task/1",
    "name": "forward",
    "description": "Get as far along x as you can in five seconds.",
    "duration": 5,
    "seeds": [1],
    "objective": "displacement.x",
}


@dataclass(frozen=True, slots=True)
class StructuralChange:
    """A part that comes and goes while an episode goes on.

    Attributes:
        grown: Whether the body had one part more, and after that as many as before, and no tick was lost.
        unmoved: Whether no other cube was anywhere else or any faster after an edit than before it.
        milliseconds: What joining the part and the tick after that took, ms.
    """

    grown: bool
    unmoved: bool
    milliseconds: float


@dataclass(frozen=True, slots=True)
class PeerCosts:
    """What is measured beside Gymnasium.

    Attributes:
        rate: Our steps a second over the plain environment's, one environment.
        rate_rows: The same of eight side by side.
        rate_remote: Steps a second in a world of a host, over those in this process.
        steps_per_second: Of ours, one environment.
        learning: What it takes to learn, our time over the other's.
        score: What was learned here: the mean of how far along x the policy gets without chance, m.
        score_plain: The same in the plain environment.
        exact: Whether the same actions lead to the same states again, and a recording replays to the last bit.
        exact_plain: Whether the same actions lead to the same states again in the plain environment.
        change: A part that comes and goes in mid-episode. The plain environment has no such thing.
        megabytes: Of all files that NMES installs, with the packages that it needs. (What is installed for editing is
            not counted.)
        megabytes_plain: Of Gymnasium and MuJoCo likewise.
        others: How many of `OTHERS` are installed. None of them is measured.
        gymnasium_mujoco: Whether Gymnasium's own environments of MuJoCo can be made, which take more packages.
        digest: Of what both came to.
    """

    rate: float
    rate_rows: float
    rate_remote: float
    steps_per_second: float
    learning: float
    score: float
    score_plain: float
    exact: bool
    exact_plain: bool
    change: StructuralChange
    megabytes: float
    megabytes_plain: float
    others: int
    gymnasium_mujoco: bool
    digest: str


class _Plain(gymnasium.Env[Array, Any]):
    """A body as a plain environment of Gymnasium."""

    def __init__(self, genome: Genome, task: Task) -> None:
        row: Any = Scene.of(genome, task, task.seeds[0], touchy=False).row
        motors = genome.body.motors
        self._model, self._substeps = row.model, task.substeps
        self._start = np.array(row.state)
        self._columns = [row.compiled.actuator[number] for number in sorted(row.compiled.actuator)]
        self._low, self._high = (np.array([getattr(motor, end) for motor in motors]) for end in ("low", "high"))
        self._data = mujoco.MjData(self._model)
        self._mass = self._model.body_mass / self._model.body_mass.sum()
        self._ticks, self._x = 0, 0.0
        self.action_space = Box(-1.0, 1.0, (len(motors),), np.float32)
        self.observation_space = Box(-np.inf, np.inf, self._observed().shape, np.float64)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begins an episode, which is always the same."""
        super().reset(seed=seed)
        mujoco.mj_setState(self._model, self._data, self._start, mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_forward(self._model, self._data)
        self._ticks, self._x = 0, self._along()
        return self._observed(), {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Goes a tick on; the reward is by how much the centre of mass came forward."""
        share = (np.asarray(action, np.float64) + 1.0) * 0.5
        self._data.ctrl[self._columns] = self._low + share * (self._high - self._low)
        mujoco.mj_step(self._model, self._data, self._substeps)
        mujoco.mj_kinematics(self._model, self._data)  # places are else those before the last engine step
        before, self._x = self._x, self._along()
        self._ticks += 1
        return self._observed(), self._x - before, False, self._ticks >= _TICKS, {}

    def _along(self) -> float:
        return float(self._mass @ self._data.xipos[:, 0])

    def _observed(self) -> Array:
        return np.concatenate([self._data.qpos[2:], self._data.qvel])


def measure_peers(genome: str, steps: int, seed: int, rounds: int) -> PeerCosts:
    """Measures a body here and in a plain environment.

    Args:
        genome: The creature: its file, or the name of one that ships.
        steps: To learn from.
        seed: Of actions and learning.
        rounds: How often steps are measured.

    Raises:
        DocumentError: It is no genome, or cannot be a row of MuJoCo.
        MachineError: No host begins (`cannot_measure`).
        SimulationFault: A part cannot be joined to the body.
    """
    body, task = Genome.load(genome), Task(_TASK)
    rates, ours, plain = _rates(body, task, seed, rounds)
    rows = TaskVectorEnv(body, task, _ROWS, autoreset_mode=AutoresetMode.SAME_STEP)
    took, score, learned = _learned(rows, steps, seed)
    plain_took, plain_score, plain_learned = _learned(_plain_rows(body, task), steps, seed)
    return PeerCosts(
        rate=ratio(rates, "plain", "ours"),
        rate_rows=ratio(rates, "plain rows", "rows"),
        rate_remote=ratio(rates, "ours", "remote"),
        steps_per_second=1.0 / sorted(rates["ours"])[rounds // 2],
        learning=took / plain_took,
        score=score,
        score_plain=plain_score,
        exact=_comes_again(lambda: TaskEnv(body, task), seed) and _replays(body, task, seed),
        exact_plain=_comes_again(lambda: _Plain(body, task), seed),
        change=_change(body, task),
        megabytes=_installed(["nmes"]),
        megabytes_plain=_installed(["gymnasium", "mujoco"]),
        others=sum(_there(name) for name in OTHERS),
        gymnasium_mujoco=_there("imageio"),
        digest=sha256(repr((ours, plain, learned, plain_learned, score, plain_score)).encode()).hexdigest()[:32],
    )


# -- what is measured -------------------------------------------------------------------------------------------------


def _rates(body: Genome, task: Task, seed: int, rounds: int) -> tuple[dict[str, list[float]], list[float], list[float]]:
    """Returns the seconds of a step of each environment, and what was last observed in ours and in the plain one."""
    draw = np.random.Generator(np.random.PCG64(seed))
    motors = len(body.body.motors)
    actions = draw.uniform(-1.0, 1.0, (_TRIAL, _ROWS, motors)).astype(np.float32)
    seen: dict[str, list[float]] = {}
    with running_host("lockstep") as host:
        remote = Remote(host.address, task=task, genome=body, password=host.password)
        one = {"ours": TaskEnv(body, task), "plain": _Plain(body, task), "remote": remote}
        many = {"rows": TaskVectorEnv(body, task, _ROWS), "plain rows": _plain_rows(body, task)}

        def single(name: str) -> float:
            env = one[name]
            env.reset(seed=seed)
            began = time.perf_counter()
            for action in actions[:, 0]:
                observed = env.step(action)[0]
            took = (time.perf_counter() - began) / _TRIAL
            seen[name] = observed.tolist()
            return took

        def several(name: str) -> float:
            envs = many[name]
            envs.reset(seed=seed)
            began = time.perf_counter()
            for action in actions:
                envs.step(action)
            return (time.perf_counter() - began) / _TRIAL / _ROWS

        trials: dict[str, Callable[[], float]] = {name: lambda name=name: single(name) for name in one}  # type: ignore[misc]
        trials |= {name: lambda name=name: several(name) for name in many}  # type: ignore[misc]
        samples = in_turns(trials, rounds)
        remote.close()
    return samples, seen["ours"], seen["plain"]


def _plain_rows(body: Genome, task: Task) -> VectorEnv[Any, Any, Any]:
    made = [lambda: _Plain(body, task)] * _ROWS
    return SyncVectorEnv(made, autoreset_mode=AutoresetMode.SAME_STEP)


def _learned(envs: VectorEnv[Any, Any, Any], steps: int, seed: int) -> tuple[float, float, list[float]]:
    """Learns; returns the seconds that it took, the mean return of the policy without chance, and its last weights."""
    with closing(envs):
        rows = GymnasiumRows(envs)
        learner, collector = Ppo(rows.spaces, _OPTIONS, Draw(seed)), Collector(rows, seed)
        blocks = max(1, steps // (_ROWS * _TICKS))
        began = time.process_time()
        for block in range(blocks):
            learner.learn(collector, _TICKS, Draw(seed, block), 1.0 - block / blocks)
        took = time.process_time() - began
        observations, total = rows.reset(1000 + seed), np.zeros(_ROWS)
        for _ in range(_TICKS):
            observations, rewards, *_ = rows.step(learner.policy.act(learner.best(observations)))
            total += rewards
    return took, fmean(total.tolist()), learner.parameters[:8].tolist()


def _comes_again(make: Callable[[], gymnasium.Env[Array, Any]], seed: int) -> bool:
    """Whether two environments observe the same, to the last bit, after the same actions."""
    found = []
    for _ in range(2):
        with closing(make()) as env:
            draw = np.random.Generator(np.random.PCG64(seed))
            seen = [env.reset(seed=seed)[0].tobytes()]
            for _ in range(_TRIAL):
                action = draw.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32)
                seen.append(env.step(action)[0].tobytes())
            found.append(seen)
    return found[0] == found[1]


def _replays(body: Genome, task: Task, seed: int) -> bool:
    """Whether the recording of an episode that was driven from outside replays to the last bit."""
    draw = np.random.Generator(np.random.PCG64(seed))
    with tempfile.TemporaryDirectory() as folder:
        with closing(TaskEnv(body, task, record=folder)) as env:
            env.reset(seed=seed)
            over = False
            while not over:
                action = draw.uniform(-1.0, 1.0, env.action_space.shape)
                *_, ended, cut, info = env.step(action)
                over = ended or cut
        return replay(info["recording"]).verdict == "reproduced"


def _change(body: Genome, task: Task) -> StructuralChange:
    """Joins a part to a body in the middle of an episode, and takes it away again."""
    world = World(task.world_config(task.seeds[0]))
    client = world.join()

    def do(**command: Any) -> Mapping[str, Any]:
        reply = world.execute(client, command)
        if reply["type"] == "error":
            raise SimulationFault(reply["code"], reply["message"])
        return reply

    do(type="spawn_creature", name="body", genome=body.document)
    do(type="step", ticks=60)
    names, before = world.poses()
    root = before[0, :3]
    began = time.perf_counter()
    do(type="spawn_cube", cube_name="part", position=[root[0], root[1] + 0.6, root[2]], size=0.2, mass=0.1, list=False)
    do(type="create_joint", cube1=names[0], cube2="part", joint_type="fixed", joint_name="bond")
    joined, edited = world.poses()
    do(type="step")
    took = time.perf_counter() - began
    do(type="step", ticks=59)
    _, moved = world.poses()
    do(type="despawn_cube", cube_name="part")
    left, after = world.poses()
    do(type="step")
    unmoved = bool((edited[:-1] == before).all() and (after == moved[:-1]).all())
    grown = joined == [*names, "part"] and left == names and world.frame == 121
    return StructuralChange(grown, unmoved, 1e3 * took)


# -- what is installed ------------------------------------------------------------------------------------------------


def _there(name: str) -> bool:
    try:
        distribution(name)
    except PackageNotFoundError:
        return False
    return True


def _installed(names: Sequence[str]) -> float:
    """Returns the size (MB) of some packages as they are installed, with those that they need, extras left out."""
    waiting, found, size = list(names), set[str](), 0
    while waiting:
        name = waiting.pop()
        if name in found or not _there(name):
            continue
        found.add(name)
        package = distribution(name)
        for file in package.files or ():
            path = Path(str(package.locate_file(file)))
            size += path.stat().st_size if path.is_file() else 0
        for needed in package.requires or ():
            if "extra ==" not in needed:
                waiting.append(_NAME.match(needed)[0])  # type: ignore[index]
    return size / 1e6
