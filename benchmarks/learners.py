"""How well learners learn, and beside whom: runs of minutes to an hour, each asked for by its name.

    python benchmarks/learners.py cube                 # Q-learning of the paper's cube, 30 seeds
    python benchmarks/learners.py CartPole-v1          # PPO, 10 seeds
    python benchmarks/learners.py Pendulum-v1 --peer   # Stable-Baselines3's PPO, where it is installed
    python benchmarks/learners.py arithmetic           # what sums in one order cost beside BLAS

Each line is a seed; behind ten of them, or all of the cube's, stand the mean and a 95 % interval. What is compared is a
policy without chance, on episodes that were not learned from.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Iterable, Iterator
from math import sqrt
from typing import Any

import numpy as np

from nmes.evaluation import Environments, Task
from nmes.genome import Genome
from nmes.learning.learners import arithmetic
from nmes.learning.learners.cube import TargetCube, arrivals, learn_to_arrive
from nmes.learning.learners.experience import Collector
from nmes.learning.learners.networks import Network
from nmes.learning.learners.ppo import Ppo
from nmes.learning.learners.rows import GymnasiumRows, Spaces
from nmes.variation.draw import Draw

EPISODES, TESTS = 1200, 30  # of the cube: learned from, and tried
STEPS, TRIED = 100_000, 20  # of Gymnasium's tasks: steps learned from, and episodes tried
SEEDS, T95 = 10, 2.262  # Student's t for so many
Z95 = 1.96
# Those of RL Baselines3 Zoo, which Stable-Baselines3's policies are tuned with, as far as ours has them:
# docs/learning.md says what differs.
OPTIONS = {
    "CartPole-v1": Ppo.Options(
        rows=8, ticks=32, rate=1e-3, epochs=20, batch=256, gamma=0.98, decay=0.8, normalise=False
    ),
    "Pendulum-v1": Ppo.Options(rows=4, ticks=1024, rate=1e-3, epochs=10, batch=64, gamma=0.9, spread=1.0),
}


def cube(seeds: Iterable[int]) -> None:
    """Prints in how many episodes the cube arrives within half a metre, with Wilson's interval."""
    arrived = tried = 0
    for seed in seeds:
        there = TargetCube(seed)
        count = arrivals(there, learn_to_arrive(there, EPISODES), range(EPISODES, EPISODES + TESTS))
        there.close()
        arrived, tried = arrived + count, tried + TESTS
        print(f"seed {seed}: {count} of {TESTS}", flush=True)
    low, high = wilson(arrived, tried)
    print(f"{arrived} of {tried}: {arrived / tried:.1%}, 95 % interval {low:.1%} to {high:.1%}")


def wilson(hits: int, tries: int) -> tuple[float, float]:
    """Returns the 95 % interval of a proportion (E. B. Wilson, 1927)."""
    part, spread = hits / tries, Z95 * Z95 / tries
    middle = part + spread / 2.0
    half = sqrt(spread * (part * (1.0 - part) + spread / 4.0))
    return (middle - half) / (1.0 + spread), (middle + half) / (1.0 + spread)


# -- Gymnasium --------------------------------------------------------------------------------------------------------


def vector(name: str, count: int) -> Any:
    """Returns a vector environment that resets rows in the step in which they are done."""
    import gymnasium
    from gymnasium.vector import AutoresetMode, SyncVectorEnv

    return SyncVectorEnv([lambda: gymnasium.make(name)] * count, autoreset_mode=AutoresetMode.SAME_STEP)


def ours(name: str, seed: int) -> float:
    """Trains our PPO; returns the mean return without chance."""
    options = OPTIONS[name]
    rows = GymnasiumRows(vector(name, options.rows))
    learner, collector = Ppo(rows.spaces, options, Draw(seed)), Collector(rows, seed)
    blocks = STEPS // (options.rows * options.ticks)
    for block in range(blocks):
        learner.learn(collector, options.ticks, Draw(seed, block), 1.0 - block / blocks)
    tries = GymnasiumRows(vector(name, TRIED))
    return tried(tries.reset(1000 + seed), lambda seen: tries.step(learner.policy.act(learner.best(seen))))


def peer(name: str, seed: int) -> float:
    """Trains Stable-Baselines3's PPO with the zoo's settings; returns the mean return without chance."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_util import make_vec_env

    torch.set_num_threads(1)
    settings: dict[str, dict[str, Any]] = {
        "CartPole-v1": {"n_steps": 32, "batch_size": 256, "gae_lambda": 0.8, "gamma": 0.98, "n_epochs": 20}
        | {"learning_rate": lambda rest: rest * 0.001, "clip_range": lambda rest: rest * 0.2},
        "Pendulum-v1": {"n_steps": 1024, "gae_lambda": 0.95, "gamma": 0.9, "n_epochs": 10}
        | {"learning_rate": 1e-3, "clip_range": 0.2, "use_sde": True, "sde_sample_freq": 4},
    }
    model = PPO(
        "MlpPolicy", make_vec_env(name, OPTIONS[name].rows, seed=seed), seed=seed, device="cpu", **settings[name]
    )
    model.learn(STEPS)
    environment = vector(name, TRIED)
    seen, _ = environment.reset(seed=1000 + seed)
    return tried(seen, lambda seen: environment.step(model.predict(seen, deterministic=True)[0])[:4])


def tried(seen: Any, step: Callable[[Any], Any]) -> float:
    """Returns the mean return of the first episode of each row."""
    gained, going = np.zeros(len(seen)), np.ones(len(seen), bool)
    while going.any():
        seen, rewards, terminated, truncated = step(seen)
        gained += rewards * going
        going &= ~(terminated | truncated)
    return float(gained.mean())


def compare(name: str, seeds: Iterable[int], train: Callable[[str, int], float]) -> None:
    """Prints what each seed comes to, and the mean with Student's interval."""
    scores = []
    for seed in seeds:
        began = time.process_time()
        scores.append(train(name, seed))
        print(f"seed {seed}: {scores[-1]:.1f} ({time.process_time() - began:.0f} s of CPU)", flush=True)
    if len(scores) == SEEDS:
        half = T95 * statistics.stdev(scores) / sqrt(len(scores))
        middle = statistics.fmean(scores)
        print(f"mean {middle:.1f}, 95 % interval {middle - half:.1f} to {middle + half:.1f}")


# -- arithmetic -------------------------------------------------------------------------------------------------------


def least(call: Callable[[], object], tries: int = 7) -> float:
    """Returns the least CPU time of a call, s."""
    times = []
    for _ in range(tries):
        began = time.process_time()
        call()
        times.append(time.process_time() - began)
    return min(times)


def blas() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Yields numpy's own functions in the place of those of learners."""
    yield "weighed", lambda rows, weights: rows @ weights.T
    yield "spread", lambda sums, weights: sums @ weights
    yield "gathered", lambda sums, rows: sums.T @ rows
    yield "tanh", np.tanh


def costs() -> None:
    """Prints what a pass forwards and backwards costs, with sums in one order and with BLAS, and a tick of a walker."""
    from nmes.learning.learners import networks

    network, draw = Network((26, 64, 64, 8)), Draw(1)
    parameters, rows = network.initial(draw, 1.0), draw.normals(26 * 512).reshape(512, 26)

    def both() -> None:
        forward = network.forward(parameters, rows)
        network.backward(parameters, forward, forward.outputs)

    exact = least(both, 50)
    for name, function in blas():
        setattr(networks, name, function)
    fast = least(both, 50)
    for name, _ in blas():
        setattr(networks, name, getattr(arithmetic, name))
    print(f"512 rows forwards and backwards: {1e6 * exact:.0f} us; with BLAS and numpy's tanh {1e6 * fast:.0f} us")
    options = Ppo.Options(rows=16)
    environments = Environments(Genome.load("walker"), Task.load("walk"), options.rows)
    spaces = Spaces(len(environments.sensors), len(environments.motors))
    learner, collector = Ppo(spaces, options, Draw(1)), Collector(environments, 1)
    learning = least(lambda: learner.learn(collector, 100, Draw(2), 1.0), 5)
    still = np.zeros((options.rows, spaces.motors))
    stepping = least(lambda: [environments.step(still) for _ in range(100)], 5)
    steps = 100 * options.rows
    print(
        f"a step of PPO on walk: {1e6 * learning / steps:.0f} us, of which the environment {1e6 * stepping / steps:.0f}"
    )
    environments.close()


def main() -> None:
    """Runs what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["cube", *OPTIONS, "arithmetic"])
    parser.add_argument("--seeds", type=int, help="how many")
    parser.add_argument("--peer", action="store_true", help="train Stable-Baselines3's PPO")
    given = parser.parse_args()
    if given.what == "arithmetic":
        costs()
    elif given.what == "cube":
        cube(range(1, 1 + (given.seeds or 30)))
    else:
        compare(given.what, range(given.seeds or SEEDS), peer if given.peer else ours)


if __name__ == "__main__":
    main()
