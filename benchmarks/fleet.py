"""What many worlds cost a host: empty ones, ones of ten cubes awake and asleep, and how long it takes to wake one.

`python benchmarks/fleet.py [WORLDS]` runs hosts of its own on this machine's loopback, and prints its figures as JSON.
Every world is recorded.
"""

from __future__ import annotations

import json
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from nmes import Client

PASSWORD = "benchmark"
EMPTY = 100  # worlds
AWAKE = 200  # worlds of ten cubes that are measured awake
SLEEPING = 2000  # and asleep, unless told otherwise
WOKEN = 500  # of those that are entered again
WATCH = 10.0  # s: for how long the time of an idle host is taken
CUBES: list[dict[str, Any]] = [
    {"type": "spawn_cube", "cube_name": f"c{number}", "position": [2.0 * number, 0.6, 0.0]} for number in range(10)
]


class Host:
    """A host in a process of its own."""

    def __init__(self, process: subprocess.Popen[str], port: int) -> None:
        self.port = port
        self._process = process

    def client(self, world: str | None = None) -> Client:
        """Returns a client, of a world or, to ask the host, of none."""
        return Client(port=self.port, password=PASSWORD, world=world, timeout=120.0)

    @property
    def processes(self) -> list[int]:
        """The numbers of the process and of its workers."""
        own = self._process.pid
        workers = Path(f"/proc/{own}/task/{own}/children").read_text().split()
        return [own, *map(int, workers)]

    @property
    def memory(self) -> float:
        """The memory of the processes, MB."""
        pages = sum(int(Path(f"/proc/{each}/statm").read_text().split()[1]) for each in self.processes)
        return pages * os.sysconf("SC_PAGE_SIZE") / 1e6

    def load(self) -> float:
        """Returns the part of a core that the processes take while nobody asks them for anything."""
        before = self.used
        time.sleep(WATCH)
        return (self.used - before) / WATCH

    @property
    def used(self) -> float:
        """The processor's time that the processes have taken, s."""
        fields = [Path(f"/proc/{each}/stat").read_text().rpartition(")")[2].split() for each in self.processes]
        return sum(int(field) for each in fields for field in each[11:13]) / os.sysconf("SC_CLK_TCK")

    def kill(self) -> None:
        """Kills all processes at once, such that none of them can do anything about it."""
        for each in self.processes:
            with suppress(ProcessLookupError):
                os.kill(each, signal.SIGKILL)

    def wait_for_sleep(self) -> None:
        """Returns when all worlds are asleep."""
        while not all(world["asleep"] for world in self.client().worlds()):
            time.sleep(0.5)


@contextmanager
def hosting(*options: str) -> Iterator[Host]:
    """Runs `nmes serve` with these options."""
    with tempfile.TemporaryDirectory() as folder:
        program = str(Path(sys.executable).parent / "nmes")
        command = [program, "serve", "--json", "--port", "0", "--record", folder, *options]
        environment = {**os.environ, "NMES_PASSWORD": PASSWORD}
        with subprocess.Popen(
            command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        ) as process:
            try:
                assert process.stdout is not None
                yield Host(process, json.loads(process.stdout.readline())["port"])
            finally:
                process.send_signal(signal.SIGTERM)
                process.wait(120)


def empty(worlds: int, hibernate_after: float) -> tuple[float, float]:
    """Returns what a host of empty realtime worlds, each used once, takes: memory (MB), and of a core."""
    with hosting("--worlds", str(worlds), "--port-step", "0", "--hibernate-after", str(hibernate_after)) as host:
        for number in range(1, worlds + 1):
            host.client(f"main-{number}").connect().close()
        if hibernate_after:
            host.wait_for_sleep()
        return host.memory, host.load()


def open_worlds(host: Host, count: int) -> list[str]:
    """Creates worlds of ten cubes that have ticked for a second, one by one; returns their names."""
    names = [f"w{number}" for number in range(count)]
    for name in names:
        host.client().create_world(name)
        with host.client(name) as client:
            client.request({"type": "batch", "commands": [*CUBES, {"type": "step", "ticks": 60}]})
    return names


def entering(host: Host, names: list[str]) -> dict[str, float]:
    """Returns how long (ms) it takes to enter worlds, from the connection to the answer to the first command."""
    times = []
    for name in names:
        began = time.perf_counter()
        with host.client(name) as client:
            client.ping()
            times.append(1000 * (time.perf_counter() - began))
    cuts = statistics.quantiles(times, n=100)
    return {"p50_ms": round(cuts[49], 2), "p99_ms": round(cuts[98], 2), "max_ms": round(max(times), 2)}


def figures(count: int) -> dict[str, Any]:
    """Returns all figures; `count` is the number of worlds that sleep."""
    one, many = empty(1, 1.0), empty(EMPTY, 1.0)
    never = empty(EMPTY, 0.0)
    told: dict[str, Any] = {
        "empty_worlds": EMPTY,
        "asleep_core": round(many[1], 4),
        "asleep_mb_over_one": round(many[0] - one[0], 1),
        "one_world_core": round(one[1], 4),
        "awake_core": round(never[1], 4),
        "awake_mb_over_one": round(never[0] - one[0], 1),
    }
    with hosting("--mode", "lockstep", "--hibernate-after", "0") as host:
        before = host.memory
        names = open_worlds(host, AWAKE)
        told["awake_kb_a_world"] = round(1000 * (host.memory - before) / AWAKE, 1)
        told["enter_awake"] = entering(host, names)
    with hosting("--mode", "lockstep", "--hibernate-after", "2", "--max-worlds", str(count + 1)) as host:
        before, began = host.memory, time.perf_counter()
        names = open_worlds(host, count)
        told["worlds"] = count
        told["opened_s"] = round(time.perf_counter() - began, 1)
        host.wait_for_sleep()
        told["asleep_kb_a_world"] = round(1000 * (host.memory - before) / count, 1)
        told["core_of_all_asleep"] = round(host.load(), 4)
        told["wake"] = entering(host, random.Random(1).sample(names, min(WOKEN, count)))
    return told


if __name__ == "__main__":
    print(json.dumps(figures(int(sys.argv[1]) if len(sys.argv) > 1 else SLEEPING), indent=2))
