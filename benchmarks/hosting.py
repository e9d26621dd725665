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
from contextlib import ExitStack, contextmanager, suppress
from math import nan
from pathlib import Path
from typing import Any

import trustme

from measure import Figure, in_turns, ratio, summary
from nmes import Client

PASSWORD = "benchmark"
CUBES = 500
SECONDS = 0.5  # a trial
ROUNDS = 12
PINGS = 400

# Run as a process: pings, and tells the percentiles in ms since the last time at every line that comes in.
_BYSTANDER = """
import json, select, ssl, statistics, sys, time
from nmes import Client
port, password, world, authority = sys.argv[1:]
tls = ssl.create_default_context(cafile=authority) if authority else None
with Client(port=int(port), password=password, world=world, timeout=120, tls=tls) as client:
    times = []
    while True:
        began = time.perf_counter()
        client.ping()
        times.append(1000 * (time.perf_counter() - began))
        if select.select([sys.stdin], [], [], 0.001)[0] and len(times) >= 50:
            if not sys.stdin.readline():
                break
            cuts = statistics.quantiles(times, n=100)
            told = {"p50": cuts[49], "p99": cuts[98], "max": max(times), "pings": len(times)}
            print(json.dumps(told), flush=True)
            times = []
"""


@contextmanager
def served(folder: Path, config: Mapping[str, Any], *worlds: str, authority: trustme.CA | None = None) -> Iterator[int]:
    """Runs `nmes serve` with worlds in lockstep that it records; yields the port.

    With an authority, it takes connections over TLS alone, with a certificate that this authority has issued.
    """
    file = folder / "config.json"
    file.write_text(json.dumps({"mode": "lockstep", **config}))
    options = ["--worlds", ",".join(worlds), "--config", str(file), "--record", str(folder)]
    if authority is not None:
        issued = authority.issue_cert("127.0.0.1")
        issued.private_key_pem.write_to_path(folder / "key.pem")
        issued.cert_chain_pems[0].write_to_path(folder / "certificate.pem")
        options += ["--tls-cert", str(folder / "certificate.pem"), "--tls-key", str(folder / "key.pem")]
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


class Bystander:
    """A well-behaved client, in a process of its own, that pings a world as long as it is let."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def percentiles(self) -> dict[str, float]:
        """Returns what its pings since the last call took, in ms: `p50`, `p99`, `max`, and how many `pings` they were.

        Without pings, all others are no number: it was shut out.
        """
        assert self._process.stdin is not None and self._process.stdout is not None
        with suppress(BrokenPipeError):
            self._process.stdin.write("\n")
            self._process.stdin.flush()
        line = self._process.stdout.readline()
        nothing = {"p50": nan, "p99": nan, "max": nan, "pings": 0}
        told: dict[str, float] = json.loads(line) if line else nothing
        return told


@contextmanager
def bystander(port: int, world: str, authority: str = "") -> Iterator[Bystander]:
    """Runs a client that pings a world, and has done so; over TLS where the file of an authority is named."""
    command = [sys.executable, "-P", "-c", _BYSTANDER, str(port), PASSWORD, world, authority]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        client = Bystander(process)
        client.percentiles()
        yield client
    finally:
        process.kill()
        process.communicate()


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
