"""What a decision costs over the wire: one environment in a world of a host on this machine, and eight side by side.

`nmes serve` runs as a process of its own, and records. A decision drives, goes one tick on, senses, and computes reward
and ends. Rates are by the clock, the best of several trials, and so depend on what else the machine does; beside them
stands the processor time of either side, and that of the engine's own step of the same creature, which any server
needs.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from measure import Figure
from nmes import World
from nmes.evaluation import Task
from nmes.genome import Genome
from nmes.learning import Remote, RemoteVector

PASSWORD = "benchmark"
ROWS = 8
TICKS = 500  # a trial: less than an episode
TRIALS = 6
CREATURES = ("walker", "jumper")  # nine cubes and eight motors; three and two
TASK = "walk"


@contextmanager
def served(worlds: int) -> Iterator[tuple[str, int]]:
    """Runs `nmes serve`, which records; yields its address, and the number of its process."""
    nmes = str(Path(sys.executable).parent / "nmes")
    with tempfile.TemporaryDirectory() as folder:
        server = subprocess.Popen(
            [nmes, "serve", "--json", "--port", "0", "--mode", "lockstep", "--worlds", str(worlds), "--record", folder],
            env={**os.environ, "NMES_PASSWORD": PASSWORD},
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        try:
            assert server.stdout is not None
            yield f"127.0.0.1:{json.loads(server.stdout.readline())['port']}", server.pid
        finally:
            server.send_signal(signal.SIGTERM)
            server.wait(30)


def processor_time(process: int) -> float:
    """Returns the processor time that a process has used, s; Linux tells it."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def engine(name: str) -> float:
    """Returns the processor time of the engine's own step of a creature that stands, s."""
    task, genome = Task.load(TASK), Genome.load(name)
    world = World(task.world_config(1))
    client = world.join()
    for command in task.entry(1, genome.document, genome.body):
        world.execute(client, command)
    world.step(task.settle_ticks)
    times = []
    for _ in range(TRIALS):
        began = time.process_time()
        for _ in range(TICKS):
            world.simulation.step(task.substeps)
        times.append((time.process_time() - began) / TICKS)
    return min(times)


def measured(env: Remote | RemoteVector, actions: Any, process: int) -> dict[str, float]:
    """Returns what the decisions of the best trial cost: their rate, and the time of either side, µs."""
    best: dict[str, float] = {"per second": 0.0}
    decisions = actions.size // len(env.motors)
    for _ in range(TRIALS):
        env.reset(seed=1)
        server, client, began = processor_time(process), time.process_time(), time.perf_counter()
        for action in actions:
            env.step(action)
        rate = decisions / (time.perf_counter() - began)
        if rate > best["per second"]:
            best = {
                "per second": rate,
                "server": 1e6 * (processor_time(process) - server) / decisions,
                "client": 1e6 * (time.process_time() - client) / decisions,
            }
    return best


def figures() -> Iterator[Figure]:
    """Measures."""
    numbers = np.random.default_rng(1)
    for name in CREATURES:
        least = {"engine": 1e6 * engine(name)}
        settings: dict[str, Any] = {"task": TASK, "genome": name, "password": PASSWORD}
        with served(1) as (address, process):
            env = Remote(address, **settings)
            actions = numbers.uniform(-0.3, 0.3, (TICKS, len(env.motors)))
            costs = measured(env, actions, process)
            env.close()
        title = f"decisions of a remote {name}, recorded"
        yield Figure(title, costs["per second"], "/s", at_least=2000, details={**costs, **least})
        with served(ROWS) as (address, process):
            envs = RemoteVector(address, count=ROWS, **settings)
            actions = numbers.uniform(-0.3, 0.3, (TICKS, ROWS, len(envs.motors)))
            costs = measured(envs, actions, process)
            envs.close()
        title = f"decisions of {ROWS} remote {name}s, recorded"
        yield Figure(title, costs["per second"], "/s", at_least=8000, details={**costs, **least})
