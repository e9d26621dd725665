"""Populations beside bare engines: `mujoco.batch` with the same models, controls and cores, and a loop of `mj_step`.

W are world-steps a second: episodes times engine steps. The bare sides step models that worlds compiled, from the
states in which episodes begin, with controls that brains gave; ours make the worlds, set the creatures down, sense,
think, judge at every tick and score. Processes are started before what is measured, as they are kept from generation
to generation.

Time is processor time, of all processes and threads, by the number of cores that a side uses: wall time would measure
who else is on the machine. That no core waits is a figure of its own. Each side is the least of some tries, in turns.

`python benchmarks/population.py` does the same at full length: episodes of ten seconds, and 10,000 of them.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from math import inf
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from evaluation import CPG, CUBES, SUBSTEPS, TASK, Bare, crawler, mlp
from measure import Figure
from nmes.evaluation import Environments, Evaluation, Evaluator, Task
from nmes.genome import Genome

CORES = 2
ROWS = 256
BODIES = 64
TRIES = 2
SAMPLES = 8  # episodes whose models and controls are kept; the rows of the bare sides share them
SHORT, FULL = 1.0, 10.0  # s of an episode

Models = Sequence[mujoco.MjModel]


def task_of(seconds: float) -> Task:
    """Returns the task, so long."""
    return Task({**TASK, "duration": seconds})


def with_brains(brain: dict[str, Any], count: int) -> list[Genome]:
    """Returns one body with so many brains."""
    first = crawler(brain)
    vector = first.brain().to_vector()
    brains = [first.brain().with_vector(vector * (1.0 + 0.2 * number / count)).document for number in range(count)]
    return [crawler(other) for other in brains]


def with_sizes(count: int) -> list[Genome]:
    """Returns one topology with so many sizes and masses."""
    genomes = []
    for number in range(count):
        document = crawler({**CPG}).document
        for cube in document["body"]["cubes"]:
            cube["size"] = [0.26, 0.14, 0.2 + 0.1 * number / count]
            cube["mass"] = 0.4 + 0.2 * number / count
        genomes.append(Genome(document))
    return genomes


def with_shapes(count: int) -> list[Genome]:
    """Returns so many trees of cubes that lie flat, no two of the same topology."""
    draw, seen, genomes = np.random.default_rng(0), set[tuple[int, ...]](), list[Genome]()
    while len(genomes) < count:
        places, parents = [(0, 0)], [0]
        while len(places) < CUBES:
            parent, (dx, dz) = int(draw.integers(len(places))), [(1, 0), (-1, 0), (0, 1), (0, -1)][draw.integers(4)]
            place = places[parent][0] + dx, places[parent][1] + dz
            if place not in places:
                places.append(place)
                parents.append(parent)
        if tuple(parents) not in seen:
            seen.add(tuple(parents))
            genomes.append(_tree(places, parents))
    return genomes


def _tree(places: Sequence[tuple[int, int]], parents: Sequence[int]) -> Genome:
    cubes, joints = [], []
    for number, (x, z) in enumerate(places):
        place = [0.36 * x, 0.07, 0.36 * z]
        cubes.append({"id": f"c{number}", "size": [0.26, 0.14, 0.26], "mass": 0.5, "position": place})
    for number, parent in enumerate(parents[1:], 1):
        (x, z), (px, pz) = places[number], places[parent]
        ends = {"cube1": f"c{parent}", "cube2": f"c{number}", "type": "hinge"}
        where = {"anchor": [0.18 * (x + px), 0.07, 0.18 * (z + pz)], "axis": [float(z != pz), 0, float(x != px)]}
        motor = {"mode": "position", "range": [-0.6, 0.6], "max_effort": 6}
        joints.append({"id": f"j{number}", **ends, **where, "motor": motor})
    body = {"cubes": cubes, "joints": joints}
    brain = {"kind": "cpg", "oscillators": CPG["oscillators"]}
    return Genome({"format": "nmes-genome/1", "name": "tree", "body": body, "brain": brain})


# -- the bare sides ---------------------------------------------------------------------------------------------------


def sleepless(model: mujoco.MjModel) -> mujoco.MjModel:
    """Returns a model without what no creature here does, so that rows need no data of their own."""
    model.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    return model


class BareBatch:
    """The engine's batch alone, on some episodes that were run once."""

    def __init__(self, episodes: Sequence[Bare], count: int) -> None:
        """Shares the episodes' models and controls out among so many rows."""
        shared = [episodes[row % len(episodes)] for row in range(count)]
        self._batch = Batch(sleepless(shared[0].model), count, CORES)
        self._batch.set_models([sleepless(episode.model) for episode in shared])
        self._starts = np.array([_state(episode) for episode in shared])
        self._controls: NDArray[np.float64] = np.stack([episode.controls for episode in shared], axis=1)

    def run(self) -> None:
        """Steps through all episodes."""
        batch = self._batch
        batch.state[:] = self._starts
        controls = batch.bind("ctrl")
        for row in self._controls:
            controls[:] = row
            batch.step(None, SUBSTEPS)


def _state(episode: Bare) -> NDArray[np.float64]:
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(episode.model, kind))
    mujoco.mj_getState(episode.model, episode.start, state, kind)
    return state


def bare_loop(episodes: Sequence[Bare]) -> None:
    """Steps through some episodes, one after the other."""
    for episode in episodes:
        episode.loop()


# -- ours -------------------------------------------------------------------------------------------------------------


def population(genomes: Sequence[Genome], task: Task, workers: Evaluator) -> None:
    """Evaluates all."""
    for evaluation in workers.evaluate_population(genomes, task):
        assert evaluation.score is not None, evaluation


# -- time -------------------------------------------------------------------------------------------------------------


def spent() -> float:
    """Returns the processor time of this process and its children with all their threads, s."""
    ticks = 0
    for process in _processes():
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        ticks += int(fields[11]) + int(fields[12])  # for the program, and for it in the kernel
    return ticks / os.sysconf("SC_CLK_TCK")


def _processes() -> list[str]:
    children = [task.read_text().split() for task in Path("/proc/self/task").glob("*/children")]
    return ["self", *(number for numbers in children for number in numbers)]


def least(trials: Mapping[str, Callable[[], None]]) -> dict[str, float]:
    """Runs trials in turns; returns of each the least processor time, s."""
    times: dict[str, list[float]] = {name: [] for name in trials}
    for _ in range(TRIES):
        for name, trial in trials.items():
            before = spent()
            trial()
            times[name].append(spent() - before)
    return {name: min(some) for name, some in times.items()}


# -- figures ----------------------------------------------------------------------------------------------------------


def figures(seconds: float = SHORT) -> Iterator[Figure]:
    """Measures, with episodes of so many seconds."""
    task = task_of(seconds)
    with Evaluator(CORES) as workers:
        population(with_brains({**CPG}, 2 * CORES), task, workers)  # starts the processes, and loads what they need
        yield from _rows(task, workers)
        yield from _all_different(task, workers)
        yield from _one_long(task, workers)
        yield from _beside_ants(task, workers)


def _rows(task: Task, workers: Evaluator) -> Iterator[Figure]:
    """Measures rows of one body, and of one topology."""
    steps = ROWS * task.ticks * SUBSTEPS
    kinds = {
        "cpg": (with_brains({**CPG}, ROWS), 0.90),
        "mlp of 32": (with_brains(mlp(), ROWS), 0.80),
        "sizes": (with_sizes(ROWS), 0.80),
    }
    for kind, (genomes, aim) in kinds.items():
        episodes = [Bare(genome, task) for genome in genomes[:: ROWS // SAMPLES]]
        took = least(
            {
                "ours": partial(population, genomes, task, workers),
                "batch": BareBatch(episodes, ROWS).run,
                "loop": partial(bare_loop, episodes),
            }
        )
        took["loop"] *= CORES * ROWS / SAMPLES  # on one core alone
        details = {f"W of {name}": CORES * steps / seconds for name, seconds in took.items()}
        what = f"{ROWS} rows, {kind}: W"
        yield Figure(f"{what} / bare batch", took["batch"] / took["ours"], "x", at_least=aim, details=details)
        least_ratio = 1.8 if kind == "cpg" else -inf
        yield Figure(f"{what} / bare loop on one core", took["loop"] / took["ours"], "x", at_least=least_ratio)


def _all_different(task: Task, workers: Evaluator) -> Iterator[Figure]:
    genomes = with_shapes(BODIES)
    episodes = [Bare(genome, task) for genome in genomes]
    trials = {"ours": partial(population, genomes, task, workers), "loop": partial(bare_loop, episodes)}
    took = least(trials)
    ratio = CORES * took["loop"] / took["ours"]
    yield Figure(f"{BODIES} topologies: W / bare loop on one core", ratio, "x", at_least=1.7, details=took)


def _one_long(task: Task, workers: Evaluator) -> Iterator[Figure]:
    """Measures how long cores wait for the last of a generation, of which one takes about ten times as long."""
    document = crawler({**CPG}).document
    cubes, joints = document["body"]["cubes"], document["body"]["joints"]
    for number in range(CUBES, 4 * CUBES):
        cubes.append({**cubes[0], "id": f"c{number}", "position": [0.36 * number, 0.07, 0]})
        ends = {"cube1": f"c{number - 1}", "cube2": f"c{number}", "anchor": [0.36 * number - 0.18, 0.07, 0]}
        joints.append({**joints[0], **ends, "id": f"j{number - 1}"})
    genomes = with_brains({**CPG}, ROWS)
    genomes[ROWS // 3] = Genome(document)
    idle, long, short = 1.0, 0.0, 1.0
    for _ in range(TRIES):
        began = time.perf_counter()
        evaluations = workers.evaluate_population(genomes, task)
        wall = time.perf_counter() - began
        busy = sum(evaluation.wall_seconds for evaluation in evaluations)
        if 1.0 - busy / (CORES * wall) < idle:
            idle = 1.0 - busy / (CORES * wall)
            long, short = evaluations[ROWS // 3].wall_seconds, _middle(evaluations)
    details = {"s of the long one": long, "s of the others, each": short}
    yield Figure("one long episode: idle share of cores", 100.0 * idle, "%", at_most=5.0, details=details)


def _middle(evaluations: Sequence[Evaluation]) -> float:
    return float(np.median([evaluation.wall_seconds for evaluation in evaluations]))


def _beside_ants(task: Task, workers: Evaluator) -> Iterator[Figure]:
    """Measures body-steps a second beside Gymnasium's vectorised Ant."""
    genomes, steps = with_brains({**CPG}, ROWS), CORES * ROWS * CUBES * task.ticks * SUBSTEPS
    stepped = Stepped(genomes[0], task)
    took = least({"evaluated": partial(population, genomes, task, workers), "environments": stepped.run})
    if find_spec("gymnasium") is None:
        yield Figure("body-steps/s: Gymnasium's Ant", 0.0, "(not installed: pip install 'nmes[bench]')")
        return
    ants = Ants(CORES)
    try:
        theirs = CORES * ants.body_steps / least({"ants": ants.run})["ants"]
    finally:
        ants.close()
    for what, seconds in took.items():
        ours = steps / seconds
        details = {"ours": ours, "Gymnasium's Ant": theirs}
        yield Figure(f"body-steps/s: {what} / Gymnasium's Ant", ours / theirs, "x", at_least=4.0, details=details)


class Stepped:
    """Our environments, driven by actions that were drawn before."""

    def __init__(self, genome: Genome, task: Task) -> None:
        self._environments = Environments(genome, task, ROWS, threads=CORES)
        draw = np.random.default_rng(0)
        self._actions = draw.uniform(-1.0, 1.0, (task.ticks, ROWS, len(self._environments.motors)))

    def run(self) -> None:
        """Goes through all actions, which are as many as an episode has ticks."""
        self._environments.reset(0)
        for actions in self._actions:
            self._environments.step(actions)


class Ants:
    """Gymnasium's vectorised Ant, which starts over as it ends, driven by actions that were drawn before."""

    _STEPS = 1000

    def __init__(self, processes: int) -> None:
        gymnasium = import_module("gymnasium")
        self._envs = gymnasium.make_vec("Ant-v5", num_envs=processes, vectorization_mode="async")
        self._envs.reset(seed=0)
        self._envs.action_space.seed(0)
        self._actions = [self._envs.action_space.sample() for _ in range(self._STEPS)]
        one = gymnasium.make("Ant-v5").unwrapped
        self.body_steps = processes * self._STEPS * (one.model.nbody - 1) * one.frame_skip
        one.close()

    def run(self) -> None:
        """Goes through all actions."""
        for action in self._actions:
            self._envs.step(action)

    def close(self) -> None:
        """Ends the processes."""
        self._envs.close()


def _many(count: int) -> Iterator[Figure]:
    """Measures many evaluations beside the bare batch, and the memory of all processes at their largest."""
    task, genomes = task_of(FULL), with_brains({**CPG}, count)
    bare = BareBatch([Bare(genome, task) for genome in genomes[:: count // SAMPLES]], ROWS)
    batch = least({"batch": bare.run})["batch"] * count / ROWS
    with Evaluator(CORES) as workers:
        population(genomes[: 2 * CORES], task, workers)
        began, before = time.perf_counter(), spent()
        population(genomes, task, workers)
        wall, took = time.perf_counter() - began, spent() - before
        memory = _most_memory()
    details = {"wall s": wall, "s of each core": took / CORES, "s of each core, bare batch": batch / CORES}
    yield Figure(f"{count:,} evaluations: time / bare batch", took / batch, "x", at_most=1.25, details=details)
    yield Figure(f"{count:,} evaluations: memory", memory, "MiB", at_most=600.0)


def _most_memory() -> float:
    """Returns the sum of what this process and its children had in memory at most, MiB."""
    statuses = [Path(f"/proc/{process}/status").read_text() for process in _processes()]
    peaks = [line.split()[1] for status in statuses for line in status.splitlines() if line.startswith("VmHWM")]
    return sum(map(int, peaks)) / 1024.0


def main() -> None:
    """Measures at full length, and prints."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    for figure in (*figures(FULL), *_many(count)):
        print(f"{figure.name}: {figure.value:.3g} {figure.unit} ({figure.aim or 'no aim'}) {dict(figure.details)}")


if __name__ == "__main__":
    main()
