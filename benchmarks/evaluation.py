"""What evaluating creatures costs: a crawler of eight cubes and seven servos for ten seconds, beside bare `mj_step`.

The bare loop steps the very model that the world compiled, from where the episode's first tick left it, with the very
controls that it had at each tick, while it settled too; the evaluation makes the world and the creature in it as well,
senses, thinks, keeps every state and scores. Body-steps are moving bodies times engine steps.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import mujoco
import mujoco.rollout
import numpy as np
import orjson

from measure import Figure, in_turns, ratio, summary
from nmes import protocol
from nmes.evaluation import Episode, Evaluator, Job, Task, brain_of, evaluate
from nmes.genome import Genome
from nmes.world import World

CUBES = 8
SUBSTEPS = 4
ROUNDS = 15
CROWD = 200
TASK = {
    "format": "nmes-task/1",
    "name": "crawl",
    "description": "Get as far along x as you can in ten seconds.",
    "duration": 10,
    "settle": 0,
    "seeds": [1],
    "objective": "displacement.x",
}
WAVE = [{"motor": "*", "frequency": 1.0, "amplitude": 0.8, "step": 0.9}]
CPG = {
    "kind": "cpg",
    "oscillators": WAVE,
    "links": [{"from": f"j{i}", "to": f"j{i + 1}", "lag": 0.9} for i in range(CUBES - 2)],
}


def mlp(hidden: int = 32, seed: int = 0) -> dict[str, Any]:
    """Returns a network from all sensors that the crawler has by default to its motors."""
    draw, motors = np.random.default_rng(seed), CUBES - 1
    shapes = (hidden, 2 * motors + 10), (motors, hidden)
    layers = [{"weights": draw.normal(0.0, 0.5, shape).tolist(), "biases": [0.0] * shape[0]} for shape in shapes]
    return {"kind": "mlp", "layers": layers}


def crawler(brain: dict[str, Any]) -> Genome:
    """Returns cubes in a row with a servo between any two."""
    cubes, joints = [], []
    for i in range(CUBES):
        cubes.append({"id": f"c{i}", "size": [0.26, 0.14, 0.26], "mass": 0.5, "position": [0.36 * i, 0.07, 0]})
    for i in range(CUBES - 1):
        motor = {"mode": "position", "range": [-0.6, 0.6], "max_effort": 6}
        ends = {"cube1": f"c{i}", "cube2": f"c{i + 1}", "type": "hinge", "anchor": [0.36 * i + 0.18, 0.07, 0]}
        joints.append({"id": f"j{i}", **ends, "motor": motor})
    body = {"cubes": cubes, "joints": joints}
    return Genome({"format": "nmes-genome/1", "name": "crawler", "body": body, "brain": brain})


class Bare:
    """The engine alone on what a world did in an episode."""

    def __init__(self, genome: Genome, task: Task) -> None:
        """Runs the episode, and keeps the model, the state at its start and the controls."""
        world = World(task.world_config(1))
        client, simulation = world.join(), world.simulation
        controls: list[np.ndarray[Any, np.dtype[np.float64]]] = []
        self.start: mujoco.MjData | None = None
        for step in Episode(world, genome, brain_of(genome), task, 1).steps():
            if step is None:
                if self.start is not None:
                    controls.append(simulation.running.data.ctrl.copy())  # type: ignore[attr-defined]
                world.tick()
                # The model is compiled in the first tick, in which the servos hold still.
                if self.start is None:
                    self.model = simulation.running.model  # type: ignore[attr-defined]
                    self.start = mujoco.MjData(self.model)
                    mujoco.mj_copyData(self.start, self.model, simulation.running.data)  # type: ignore[attr-defined]
            elif isinstance(step, bytes):
                world.handle(client, protocol.parse(step))
            else:
                assert isinstance(step.controls, np.ndarray)
                world.drive(client, step.creature, step.controls)
        self.controls = np.array(controls)
        self.data = mujoco.MjData(self.model)

    def loop(self) -> float:
        """Steps through the episode; returns the seconds that it took."""
        mujoco.mj_copyData(self.data, self.model, self.start)
        control, step = self.data.ctrl, mujoco.mj_step
        began = time.perf_counter()
        for row in self.controls:
            control[:] = row
            step(self.model, self.data, SUBSTEPS)
        return time.perf_counter() - began

    def rollout(self) -> float:
        """Does the same in one call of `mujoco.rollout`; returns the seconds that it took."""
        kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
        state = np.empty(mujoco.mj_stateSize(self.model, kind))
        mujoco.mj_getState(self.model, self.start, state, kind)
        controls = np.repeat(self.controls, SUBSTEPS, axis=0)[np.newaxis]
        with mujoco.rollout.Rollout(nthread=0) as runner:
            began = time.perf_counter()
            runner.rollout(self.model, self.data, state[np.newaxis], controls)
            return time.perf_counter() - began


def _timed(call: Callable[[], object]) -> float:
    began = time.perf_counter()
    call()
    return time.perf_counter() - began


def figures() -> Iterator[Figure]:
    """Measures."""
    task = Task(TASK)
    cpg, net = crawler(CPG), crawler(mlp())
    bare_cpg, bare_net = Bare(cpg, task), Bare(net, task)
    with tempfile.TemporaryDirectory() as folder:
        trials = {
            "bare cpg": bare_cpg.loop,
            "cpg": lambda: _timed(lambda: evaluate(cpg, task)),
            "recorded cpg": lambda: _timed(lambda: evaluate(cpg, task, record=folder)),
            "rollout": bare_cpg.rollout,
            "bare mlp": bare_net.loop,
            "mlp": lambda: _timed(lambda: evaluate(net, task)),
        }
        samples = in_turns(trials, ROUNDS)
    times = {"milliseconds an episode": summary(samples, 1e-3)}
    name = "crawler, cpg: evaluation / mj_step"
    yield Figure(name, ratio(samples, "cpg", "bare cpg"), "x", at_most=1.2, details=times)
    recorded = ratio(samples, "recorded cpg", "bare cpg")
    yield Figure("crawler, cpg, recorded: evaluation / mj_step", recorded, "x", at_most=1.35, details=times)
    name = "crawler, mlp of 32: evaluation / mj_step"
    yield Figure(name, ratio(samples, "mlp", "bare mlp"), "x", at_most=1.3, details=times)
    yield Figure("crawler: mujoco.rollout (not used) / mj_step", ratio(samples, "rollout", "bare cpg"), "x")
    yield from _many(task)


def _many(task: Task) -> Iterator[Figure]:
    asked = orjson.dumps(task.document)
    work = [Job(f"{i}", orjson.dumps(crawler({**CPG}).document), asked) for i in range(CROWD)]
    # Processes are started within what is timed, as they are for whoever calls.
    one, two = (_timed(partial(_evaluate, work, jobs)) for jobs in (1, 2))
    steps = CROWD * CUBES * task.ticks * SUBSTEPS
    details = {"one process, s": one, "two processes, s": two}
    yield Figure(f"{CROWD} crawlers: two processes / one", one / two, "x", at_least=1.8, details=details)
    yield Figure(f"{CROWD} crawlers, two processes", two, "s", at_most=6.0, details=details)
    yield Figure("body-steps/s: nmes, 2 processes", steps / two, "")
    if find_spec("evogym") is None:
        yield Figure("body-steps/s: Evolution Gym", 0.0, "(not installed: pip install evogym)")
    else:
        yield Figure("body-steps/s: Evolution Gym's Walker, 1 process", _voxels(), "")


def _evaluate(work: list[Job], jobs: int) -> None:
    with Evaluator(jobs) as workers:
        list(workers.run(work))


def _voxels() -> float:
    """Returns the body-steps a second of Evolution Gym's walker, a voxel counting as a body."""
    gymnasium, evogym = import_module("gymnasium"), import_module("evogym")
    import_module("evogym.envs")  # registers them
    body, connections = evogym.sample_robot((5, 5))
    env = gymnasium.make("Walker-v0", body=body, connections=connections)
    env.reset(seed=0)
    actions = [env.action_space.sample() for _ in range(1000)]
    took = _timed(lambda: [env.step(action) for action in actions])
    env.close()
    return float(len(actions) * np.count_nonzero(body) / took)
