"""What worker processes are worth: awake worlds carried, how long worlds pause when a worker is killed, and entering.

`python benchmarks/workers.py [entering|carrying|killing ...]` runs hosts of its own on this machine's loopback, and
prints its figures as JSON. Every world is recorded.
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
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from nmes import Client
from nmes.errors import CommandFailed, Disconnected

PASSWORD = "benchmark"
ENTERED = 1000  # times
WORLDS = 600  # realtime worlds of ten cubes, more than either host can carry
PAIRS = 3  # of hosts that are measured one after the other
WATCH = 10.0  # s: for how long ticks are counted
KILLS = 100
DRIVEN = 8  # worlds that clients drive while workers are killed
CUBES: list[dict[str, Any]] = [
    {"type": "spawn_cube", "cube_name": f"c{number}", "position": [2.0 * number, 0.6, 0.0]} for number in range(10)
]


class Host:
    """A host in processes of its own."""

    def __init__(self, process: subprocess.Popen[str], about: dict[str, Any]) -> None:
        self.process = process
        self.port: int = about["port"]
        self._about = about

    def client(self, world: str | None = None, port: int | None = None) -> Client:
        """Returns a client, of a world or, to ask the host, of none."""
        return Client(port=port or self.port, password=PASSWORD, world=world, timeout=120.0)

    def workers(self) -> list[int]:
        """Returns the processes that the host has started."""
        found = []
        for stat in Path("/proc").glob("[0-9]*/stat"):
            try:
                fields = stat.read_text().rpartition(")")[2].split()
            except (FileNotFoundError, ProcessLookupError):
                continue
            if int(fields[1]) == self.process.pid and fields[0] != "Z":
                found.append(int(stat.parent.name))
        return sorted(found)

    def time(self) -> float:
        """Returns the processor time that all its processes have taken, s."""
        total = 0
        for pid in (self.process.pid, *self.workers()):
            fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
            total += int(fields[11]) + int(fields[12])
        return total / os.sysconf("SC_CLK_TCK")

    def whole(self, kills: int) -> bool:
        """Tells whether two workers run after so many kills."""
        url = f"http://127.0.0.1:{self._about['metrics_port']}/metrics"
        with urllib.request.urlopen(url, timeout=60.0) as page:
            lines: list[bytes] = page.read().split(b"\n")
        return b"nmes_workers 2.0" in lines and f"nmes_worker_restarts_total {kills}.0".encode() in lines

    def ticks(self) -> int:
        """Returns how often all worlds have ticked."""
        return sum(world["frame"] or 0 for world in self.client().worlds())


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
                yield Host(process, json.loads(process.stdout.readline()))
            finally:
                process.send_signal(signal.SIGTERM)
                process.wait(120)


def cuts(times: list[float]) -> dict[str, float]:
    """Returns what half and 99 of 100 times (s) do not exceed, and the longest, ms."""
    parts = statistics.quantiles([1000 * one for one in times], n=100)
    return {"p50_ms": round(parts[49], 2), "p99_ms": round(parts[98], 2), "max_ms": round(1000 * max(times), 2)}


# -- entering --------------------------------------------------------------------------------------------------------


def entering() -> dict[str, Any]:
    """Returns how long it takes to enter a world, from the connection to the answer to a first `ping`, in turn."""
    mode = ("--mode", "lockstep", "--hibernate-after", "0")
    with hosting(*mode, "--workers", "2") as many, hosting(*mode) as one:
        own = many.client().worlds()[0]["worker_port"]
        ways: dict[str, tuple[Host, int | None]] = {
            "handed_over": (many, None),
            "own_port": (many, own),
            "one_process": (one, None),
        }
        times: dict[str, list[float]] = {way: [] for way in ways}
        for _ in range(ENTERED):
            for way, (host, port) in ways.items():
                began = time.perf_counter()
                with host.client("main", port) as client:
                    client.ping()
                    times[way].append(time.perf_counter() - began)
    return {way: cuts(taken) for way, taken in times.items()}


# -- carrying --------------------------------------------------------------------------------------------------------


def carried(*options: str) -> tuple[float, float]:
    """Returns how many worlds at 60 Hz a host carries that has too many, and how many cores that takes."""
    shape = ("--worlds", str(WORLDS), "--port-step", "0", "--hibernate-after", "0")
    with hosting(*shape, *options) as host:
        for number in range(1, WORLDS + 1):
            with host.client(f"main-{number}") as client:
                client.request({"type": "batch", "commands": CUBES})
        time.sleep(WATCH / 4)
        began, ticks, used = time.perf_counter(), host.ticks(), host.time()
        time.sleep(WATCH)
        ticks, used, took = host.ticks() - ticks, host.time() - used, time.perf_counter() - began
    return ticks / took / 60, used / took


def carrying() -> dict[str, Any]:
    """Returns what two workers carry, against one process, pair by pair."""
    pairs = []
    for _ in range(PAIRS):
        (one, one_cores), (two, two_cores) = carried(), carried("--workers", "2")
        pairs.append(
            {
                "one_process": round(one, 1),
                "two_workers": round(two, 1),
                "ratio": round(two / one, 2),
                "one_process_cores": round(one_cores, 2),
                "two_workers_cores": round(two_cores, 2),
                "ratio_a_core": round((two / two_cores) / (one / one_cores), 2),
                "others_load": round(os.getloadavg()[0], 1),
            }
        )
    return {"worlds_offered": WORLDS, "pairs": pairs}


# -- killing ---------------------------------------------------------------------------------------------------------


class Driver(threading.Thread):
    """A client that ticks a world on and on, and counts how long it pauses whenever its worker is killed."""

    def __init__(self, host: Host, world: str) -> None:
        super().__init__()
        self.pauses: list[float] = []
        self.lost = 0  # ticks that were acknowledged, and are not there afterwards
        self.over = False
        self._client = host.client(world).connect()
        self._client.request({"type": "batch", "commands": CUBES})

    def run(self) -> None:
        """Ticks until it is over."""
        frame = 0
        since: float | None = None
        while not self.over:
            try:
                if since is not None:
                    self._client.reconnect()
                    self.lost += max(0, frame - self._client.get_world_info()["frame"])
                frame = self._client.step()["frame"]
            except (Disconnected, CommandFailed):
                since = since or time.perf_counter()
                continue
            if since is not None:
                self.pauses.append(time.perf_counter() - since)
                since = None
            time.sleep(0.005)
        self._client.close()


def killing() -> dict[str, Any]:
    """Returns how long worlds pause when workers are killed, one after the other, each when both are there."""
    draw = random.Random(1)
    names = [f"w{number}" for number in range(DRIVEN)]
    options = ("--mode", "lockstep", "--flush-interval", "0", "--worlds", ",".join(names))
    with hosting("--workers", "2", "--metrics-port", "0", *options) as host:
        drivers = [Driver(host, name) for name in names]
        for driver in drivers:
            driver.start()
        for number in range(1, KILLS + 1):
            while not host.whole(number - 1):
                time.sleep(0.05)
            time.sleep(draw.uniform(0.0, 1.0))
            os.kill(draw.choice(host.workers()), signal.SIGKILL)
            if number % 10 == 0:
                print(number, *sorted(round(p, 2) for each in drivers for p in each.pauses)[-5:], file=sys.stderr)
        time.sleep(5.0)
        for driver in drivers:
            driver.over = True
        for driver in drivers:
            driver.join()
        worlds = sorted(world["world"] for world in host.client().worlds() if world["fault"] is None)
    pauses = [pause for driver in drivers for pause in driver.pauses]
    return {
        "kills": KILLS,
        "worlds": DRIVEN,
        "worlds_left": len(worlds),
        "acknowledged_ticks_lost": sum(driver.lost for driver in drivers),
        "pauses": len(pauses),
        **cuts(pauses),
        "others_load": round(os.getloadavg()[0], 1),
    }


PARTS: dict[str, Callable[[], dict[str, Any]]] = {"entering": entering, "carrying": carrying, "killing": killing}

if __name__ == "__main__":
    print(json.dumps({part: PARTS[part]() for part in sys.argv[1:] or PARTS}, indent=2))
