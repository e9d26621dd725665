"""The same body and the same learner here and in a plain environment of Gymnasium.

Hides the plain environment, which is what anybody writes who has a model of MuJoCo: it steps the very model that our
world compiled, from the state in which our episode begins; what is observed are the positions and velocities of
the model, as in Gymnasium's own Ant. The task is the same in both: how far along x the centre of mass gets. Where
something is learned, the plain environment observes what the body's sensors read, so that both learn alike.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, distribution
from statistics import fmean
from typing import Any, Final

import gymnasium
import mujoco
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv

from nmes.backend import Array, BodyState
from nmes.errors import SimulationFault, WorldError
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

__all__ = ["OTHERS", "Learned", "LearningCosts", "PeerCosts", "StructuralChange", "measure_learning", "measure_peers"]

OTHERS: Final = ("evogym", "playground", "godot-rl", "mlagents", "isaacgym")
"""Packages of other peers: Evolution Gym, MuJoCo Playground, Godot RL Agents, ML-Agents, Isaac Gym."""
_ROWS: Final = 8  # environments side by side, where there are several
_TICKS: Final = 300  # of an episode
_TRIAL: Final = 150  # steps of a round: less than an episode
_UNREADABLE: Final = ("touch", "effort")  # sensors that a plain environment does not have
_OPTIONS: Final = Ppo.Options(rows=_ROWS, ticks=_TICKS, rate=1e-3)
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
class Learned:
    """What came of learning.

    Attributes:
        steps: After how many steps the episodes of a block were worth the goal or more, in the mean; None: never.
        seconds: How long that took by the clock, s; None likewise. The other learner's blocks are not in it.
        score: What was learned: the mean of how far along x the policy then gets without chance, m.
    """

    steps: int | None
    seconds: float | None
    score: float


@dataclass(frozen=True, slots=True)
class LearningCosts:
    """What it takes to learn here and in Gymnasium.

    Attributes:
        ours: What came of learning here.
        plain: The same in the plain environment.
        ratio: Our time to the goal over the other's; None where one did not come to it.
        alike: Whether both have learned the same policy, to the last bit.
        digest: Of both policies.
    """

    ours: Learned
    plain: Learned
    ratio: float | None
    alike: bool
    digest: str


@dataclass(frozen=True, slots=True)
class PeerCosts:
    """What is measured beside Gymnasium.

    Attributes:
        rate: Our steps a second over the plain environment's, one environment.
        rate_rows: The same of eight side by side.
        rate_remote: Steps a second in a world of a host, over those in this process.
        steps_per_second: Of ours, one environment.
        exact: Whether the same actions lead to the same states again, and a recording replays to the last bit.
        exact_plain: Whether the same actions lead to the same states again in the plain environment.
        change: A part that comes and goes in mid-episode. The plain environment has no such thing.
        others: How many of `OTHERS` are installed. None of them is measured.
        gymnasium_mujoco: Whether Gymnasium's own environments of MuJoCo can be made, which take more packages.
        digest: Of what both came to.
    """

    rate: float
    rate_rows: float
    rate_remote: float
    steps_per_second: float
    exact: bool
    exact_plain: bool
    change: StructuralChange
    others: int
    gymnasium_mujoco: bool
    digest: str


class _Plain(gymnasium.Env[Array, Any]):
    """A body as a plain environment of Gymnasium."""

    def __init__(self, genome: Genome, task: Task) -> None:
        self._scene = scene = Scene.of(genome, task, task.seeds[0], touchy=False)
        row: Any = scene.row
        if row is None:
            raise WorldError("unsupported", f"{genome.name!r} is no single row of MuJoCo: take another body", "genome")
        motors = genome.body.motors
        self._model, self._substeps = row.model, task.substeps
        self._start = np.array(row.state)
        self._columns = [row.compiled.actuator[number] for number in sorted(row.compiled.actuator)]
        self._low, self._high = (np.array([getattr(motor, end) for motor in motors]) for end in ("low", "high"))
        self._data = mujoco.MjData(self._model)
        self._cubes = [row.compiled.body_index[body] for body in scene.watched.bodies]
        masses = np.array([cube.mass for cube in genome.body.cubes])
        self._shares = masses / np.add.accumulate(masses)[-1]
        self._ticks, self._origin, self._paid = 0, 0.0, 0.0
        self.action_space = Box(-1.0, 1.0, (len(motors),), np.float32)
        self.observation_space = Box(-np.inf, np.inf, (self._model.nq - 2 + self._model.nv,), np.float64)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begins an episode, which is always the same."""
        super().reset(seed=seed)
        mujoco.mj_setState(self._model, self._data, self._start, mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_kinematics(self._model, self._data)
        self._ticks, self._origin, self._paid = 0, self._along(), 0.0
        return self._observed(), {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Goes a tick on; the reward is by how much the centre of mass came forward."""
        share = (np.asarray(action, np.float64) + 1.0) * 0.5
        self._data.ctrl[self._columns] = self._low + share * (self._high - self._low)
        mujoco.mj_step(self._model, self._data, self._substeps)
        mujoco.mj_kinematics(self._model, self._data)  # places are else those before the last engine step
        reward = self._along() - self._origin - self._paid
        self._paid += reward
        self._ticks += 1
        return self._observed(), reward, False, self._ticks >= _TICKS, {}

    def _along(self) -> float:
        return float(np.add.accumulate(self._data.xpos[self._cubes, 0] * self._shares)[-1])

    def _observed(self) -> Array:
        return np.concatenate([self._data.qpos[2:], self._data.qvel])


class _Sensed(_Plain):
    """A body as a plain environment of Gymnasium, which observes what the body's sensors read."""

    def __init__(self, genome: Genome, task: Task) -> None:
        super().__init__(genome, task)
        compiled: Any = self._scene.row.compiled  # type: ignore[union-attr]
        self._senses = senses = self._scene.creature.senses
        slots = [compiled.joint[number] for number in senses.joint_numbers]
        self._q, self._v = ([getattr(slot, name) for slot in slots] for name in "qv")
        self._felt = [(read, compiled.body_index[body], rows, picked) for read, body, rows, picked in senses.felt]
        self._count = len(genome.body.sensors)
        self.observation_space = Box(-np.inf, np.inf, (self._count,), np.float64)

    def _observed(self) -> Array:
        senses, data, out = self._senses, self._data, np.zeros(self._count)  # of what is around it: nothing is
        mujoco.mj_comPos(self._model, data)
        mujoco.mj_comVel(self._model, data)
        readings = np.zeros((len(self._q), 3))
        readings[:, 0], readings[:, 1] = data.qpos[self._q], data.qvel[self._v]
        out[senses.joint_rows] = readings.take(senses.joint_columns) * senses.joint_scale
        for read, body, rows, picked in self._felt:
            felt = read(self._state(body))
            out[rows] = felt if picked is None else [felt[number] for number in picked]
        return out

    def _state(self, body: int) -> BodyState:
        """Returns the pose of a body and the velocity of its centre: MuJoCo has that of the whole tree's centre."""
        data = self._data
        x, y, z = data.xpos[body].tolist()
        qw, qx, qy, qz = data.xquat[body].tolist()
        wx, wy, wz, vx, vy, vz = data.cvel[body].tolist()
        cx, cy, cz = data.subtree_com[self._model.body_rootid[body]].tolist()
        rx, ry, rz = x - cx, y - cy, z - cz
        velocity = vx + (wy * rz - wz * ry), vy + (wz * rx - wx * rz), vz + (wx * ry - wy * rx)
        return BodyState((x, y, z), (qx, qy, qz, qw), velocity, (wx, wy, wz))


def measure_peers(genome: str, seed: int, rounds: int) -> PeerCosts:
    """Measures a body here and in a plain environment.

    Args:
        genome: The creature: its file, or the name of one that ships.
        seed: Of the actions.
        rounds: How often steps are measured.

    Raises:
        DocumentError: It is no genome.
        MachineError: No host begins (`cannot_measure`).
        SimulationFault: A part cannot be joined to the body.
        WorldError: It is no single row of MuJoCo (`unsupported`).
    """
    body, task = Genome.load(genome), Task(_TASK)
    rates, ours, plain = _rates(body, task, seed, rounds)
    return PeerCosts(
        rate=ratio(rates, "plain", "ours"),
        rate_rows=ratio(rates, "plain rows", "rows"),
        rate_remote=ratio(rates, "ours", "remote"),
        steps_per_second=1.0 / sorted(rates["ours"])[rounds // 2],
        exact=_comes_again(lambda: TaskEnv(body, task), seed) and _replays(body, task, seed),
        exact_plain=_comes_again(lambda: _Plain(body, task), seed),
        change=_change(body, task),
        others=sum(_there(name) for name in OTHERS),
        gymnasium_mujoco=_there("imageio"),
        digest=_digest(ours, plain),
    )


def measure_learning(genome: str, steps: int, goal: float, seed: int) -> LearningCosts:
    """Measures how long the same learner takes to a score here and in a plain environment.

    Args:
        genome: The creature: its file, or the name of one that ships.
        steps: To learn from at most.
        goal: How far along x the episodes of a block must get in the mean for the learning to end, m.
        seed: Of the learning.

    Raises:
        DocumentError: It is no genome.
        WorldError: It is no single row of MuJoCo, or has sensors that a plain environment cannot read (`unsupported`).
    """
    body, task = Genome.load(genome), Task(_TASK)
    sensors = body.body.sensors
    strange = sorted({sensor.type for sensor in sensors if sensor.solitary or sensor.type in _UNREADABLE})
    if strange:
        told = f"a plain environment cannot read {', '.join(strange)}: take a body without such sensors"
        raise WorldError("unsupported", told, "genome")
    learner, other = _learn(body, task, steps, goal, seed)
    ours, plain = learner.ended(), other.ended()
    return LearningCosts(
        ours=ours,
        plain=plain,
        ratio=None if ours.seconds is None or plain.seconds is None else ours.seconds / plain.seconds,
        alike=learner.policy == other.policy,
        digest=_digest(learner.policy, other.policy),
    )


def _digest(*found: object) -> str:
    return sha256(repr(found).encode()).hexdigest()[:32]


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


def _plain_rows(body: Genome, task: Task, kind: type[_Plain] = _Plain) -> VectorEnv[Any, Any, Any]:
    made = [lambda: kind(body, task)] * _ROWS
    return SyncVectorEnv(made, autoreset_mode=AutoresetMode.SAME_STEP)


class _Learner:
    """A learner over rows of its own, which learns until it comes to the goal.

    Attributes:
        there: Whether it has come to the goal.
    """

    def __init__(self, envs: VectorEnv[Any, Any, Any], goal: float, seed: int) -> None:
        self._envs, self._rows, self._goal, self._seed = envs, GymnasiumRows(envs), goal, seed
        self._learner, self._collector = Ppo(self._rows.spaces, _OPTIONS, Draw(seed)), Collector(self._rows, seed)
        self._steps, self._seconds, self.there = 0, 0.0, False

    def learn(self, block: int, rest: float) -> None:
        """Learns from a block of steps."""
        began = time.perf_counter()
        report = self._learner.learn(self._collector, _TICKS, Draw(self._seed, block), rest)
        self._seconds += time.perf_counter() - began
        self._steps += report.steps
        self.there = fmean(report.returns) >= self._goal

    @property
    def policy(self) -> list[float]:
        """All that was learned."""
        return list(self._learner.parameters.tolist())

    def ended(self) -> Learned:
        """Tries what was learned, and ends the environments."""
        with closing(self._envs):
            observations, total = self._rows.reset(1000 + self._seed), np.zeros(_ROWS)
            for _ in range(_TICKS):
                observations, rewards, *_ = self._rows.step(self._learner.policy.act(self._learner.best(observations)))
                total += rewards
        score = fmean(total.tolist())
        return Learned(self._steps, self._seconds, score) if self.there else Learned(None, None, score)


def _learn(body: Genome, task: Task, steps: int, goal: float, seed: int) -> tuple[_Learner, _Learner]:
    """Has two learners that are the same learn here and in the plain environment: they take turns, block by block."""
    ours = TaskVectorEnv(body, task, _ROWS, autoreset_mode=AutoresetMode.SAME_STEP)
    learner, other = (_Learner(envs, goal, seed) for envs in (ours, _plain_rows(body, task, _Sensed)))
    blocks = max(1, steps // (_ROWS * _TICKS))
    for block in range(blocks):
        for each in (learner, other) if block % 2 == 0 else (other, learner):
            if not each.there:
                each.learn(block, 1.0 - block / blocks)
    return learner, other


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


def _there(name: str) -> bool:
    try:
        distribution(name)
    except PackageNotFoundError:
        return False
    return True
