"""What hosting worlds side by side yields: two busy ones in one process, beside one of them alone, and two processes.

Each world has 500 cubes that stand on the ground and do not sleep, ticks as fast as it can, and is recorded. The two
processes tell what of the gain the machine withholds, and what our one process does.
"""

from __future__ import annotations

import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from measure import Figure, in_turns, ratio, summary
from nmes import Client

PASSWORD = "benchmark"
CUBES = 500
SECONDS = 0.5  # a trial
ROUNDS = 12
PINGS = 400


@contextmanager
def served(folder: Path, config: Mapping[str, Any], *worlds: str) -> Iterator[int]:
    """Runs `nmes serve` with worlds in lockstep that it records; yields the port."""
    file = folder / "config.json"
    file.write_text(json.dumps({"mode": "lockstep", **config}))
    options = ["--worlds", ",".join(worlds), "--config", str(file), "--record", str(folder)]
    server = subprocess.Popen(
        [str(Path(sys.executable).parent / "nmes"), "serve", "--json", "--port", "0", *options],
        env={**os.environ, "NMES_PASSWORD": PASSWORD},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    try:
        assert server.stdout is not None
        yield int(json.loads(server.stdout.readline())["port"])
    finally:
        server.send_signal(signal.SIGTERM)
        server.wait(30)


def busy(port: int, world: str) -> Client:
    """Returns a client of a world that has its cubes now."""
    client = Client(port=port, password=PASSWORD, world=world, timeout=60).connect()
    with client.pipeline() as many:
        for n in range(CUBES):
            many.spawn_cube(position=[1.5 * (n % 25), 0.5, 1.5 * (n // 25)], list=False)
    client.step(60)
    return client


def rate(clients: Sequence[Client]) -> float:
    """Returns the ticks per second of worlds that all tick as fast as they can."""
    for client in clients:
        client.set_mode("fast")
    first = [client.get_world_info() for client in clients]
    began = time.perf_counter()
    time.sleep(SECONDS)
    last = [client.get_world_info() for client in clients]
    took = time.perf_counter() - began
    for client in clients:
        client.set_mode("lockstep")
    return sum(after["frame"] - before["frame"] for before, after in zip(first, last, strict=True)) / took


def latency(client: Client) -> float:
    """Returns the 99th percentile of a ping, s."""
    times = []
    for _ in range(PINGS):
        began = time.perf_counter()
        client.ping()
        times.append(time.perf_counter() - began)
        time.sleep(0.001)
    return statistics.quantiles(times, n=100)[98]


def figures() -> Iterator[Figure]:
    """Measures."""
    with ExitStack() as stack:
        folders = [Path(stack.enter_context(tempfile.TemporaryDirectory())) for _ in range(2)]
        config = {"engine": {"sleep": False}}
        port = stack.enter_context(served(folders[0], config, "red", "green", "blue"))
        red, green = (stack.enter_context(busy(port, name)) for name in ("red", "green"))
        other = stack.enter_context(Client(port=port, password=PASSWORD, world="blue", timeout=60))
        apart = stack.enter_context(busy(stack.enter_context(served(folders[1], config, "red")), "red"))
        samples = in_turns(
            {"one": lambda: rate([red]), "two": lambda: rate([red, green]), "apart": lambda: rate([red, apart])}, ROUNDS
        )
        details = {"ticks per second": summary(samples, 1.0), "cores": os.cpu_count()}
        yield Figure("two busy worlds / one: ticks", ratio(samples, "two", "one"), "x", at_least=1.6, details=details)
        yield Figure("two busy worlds / two processes: ticks", ratio(samples, "two", "apart"), "x", details=details)

        def beside() -> float:
            red.set_mode("fast")
            taken = latency(other)
            red.set_mode("lockstep")
            return taken

        samples = in_turns({"idle": lambda: latency(other), "busy": beside}, 5)
        times = summary(samples, 1e-3)
        yield Figure(
            "p99 of a ping beside a busy world", times["busy"]["median"], "ms", details={"milliseconds": times}
        )
