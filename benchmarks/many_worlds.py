"""Many worlds on one host: opening them, some awake, waking others, and what a kill leaves of their recordings.

`python benchmarks/many_worlds.py [WORLDS] [--ticks N] [--at-once N] [--workers N]` runs a host of its own on this
machine's loopback, in a folder that takes 100 KB a world. It prints its figures as JSON, and as they come on standard
error. Beside the wall's time stands the processor's, which says what a machine would take on which nothing else runs.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import random
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Coroutine, Iterable, Mapping
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, Self

from fleet import CUBES, PASSWORD, Host
from nmes.protocol import DELIMITER, decode, encode
from nmes.recording import Recording

WORLDS = 2000  # unless told otherwise
MOST = 100_000
AWAKE = 200  # worlds that tick in real time meanwhile, with a client in each
WATCH = 30.0  # s: for how long it is watched how late they are
EVERY = 15  # ticks: how often each of them tells its frame, four times a second
RATE = 60  # Hz
WOKEN = 500  # sleeping worlds that are entered
SETTLE = 600.0  # s: within which all are to be asleep


class Wire:
    """A connection that sends a message and waits for the answer, with as little work as there can be."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Begins with a socket; `open` makes one."""
        self._reader, self._writer = reader, writer

    @classmethod
    async def open(cls, port: int) -> Self:
        """Connects to the host."""
        return cls(*await asyncio.open_connection("127.0.0.1", port, limit=1 << 20))

    def send(self, *messages: Mapping[str, Any]) -> None:
        """Sends messages, in one write."""
        self._writer.write(b"".join(encode(dict(message)) + DELIMITER for message in messages))

    async def read(self) -> dict[str, Any]:
        """Returns the next message; raises RuntimeError where it is an error."""
        frame = await self._reader.readuntil(DELIMITER)
        message: dict[str, Any] = decode(frame[: -len(DELIMITER)])
        if message["type"] == "error":
            raise RuntimeError(f"the host says {message}")
        return message

    def close(self) -> None:
        """Hangs up."""
        self._writer.close()


def auth(**more: Any) -> dict[str, Any]:
    """Returns the first message of a connection."""
    return {"type": "auth", "password": PASSWORD, **more}


async def open_world(port: int, name: str, ticks: int) -> None:
    """Creates a world, enters it, puts ten cubes into it that fall for some ticks, and leaves."""
    wire = await Wire.open(port)
    wire.send(auth(create={"world": name}))
    await wire.read()
    wire.close()
    wire = await Wire.open(port)
    wire.send(auth(world=name), {"type": "batch", "commands": [*CUBES, {"type": "step", "ticks": ticks}]})
    await wire.read()
    await wire.read()
    wire.close()


async def at_once(work: Iterable[Coroutine[Any, Any, Any]], lanes: int) -> None:
    """Does all work, so much of it at once."""
    rest = iter(work)

    async def lane() -> None:
        for each in rest:
            await each

    await asyncio.gather(*(lane() for _ in range(lanes)))


class Awake:
    """A client in a world that ticks in real time, and when it heard of which frame."""

    def __init__(self, wire: Wire) -> None:
        """Begins with a connection that is in the world."""
        self.wire = wire
        self.heard: list[tuple[float, int]] = []
        self._task = asyncio.create_task(self._listen())

    @classmethod
    async def enter(cls, port: int, name: str) -> Self:
        """Enters a world and has it tick."""
        wire = await Wire.open(port)
        subscribe = {"type": "subscribe", "events": ["tick"], "every": EVERY}
        wire.send(auth(world=name), {"type": "set_mode", "mode": "realtime"}, subscribe)
        for _ in range(3):
            await wire.read()
        return cls(wire)

    async def _listen(self) -> None:
        while True:
            event = await self.wire.read()
            if event["type"] == "tick":
                self.heard.append((time.perf_counter(), event["frame"]))

    def lateness(self, since: float, until: float) -> list[float]:
        """Returns how late (ticks) each frame was heard of between two moments, behind the earliest of all."""
        shifts = [(at, at - frame / RATE) for at, frame in self.heard]
        earliest = min(shift for _, shift in shifts)
        return [RATE * (shift - earliest) for at, shift in shifts if since <= at < until]

    def leave(self) -> None:
        """Ends listening, and hangs up."""
        self._task.cancel()
        self.wire.close()


def lateness(clients: list[Awake], since: float, until: float) -> dict[str, float]:
    """Returns how late (ticks) all frames were that some clients heard of between two moments."""
    return spread([late for client in clients for late in client.lateness(since, until)])


async def entering(port: int, names: list[str]) -> list[float]:
    """Returns how long (ms) it took to enter each world, from the connection to the answer to the first command."""
    times = []
    for name in names:
        began = time.perf_counter()
        wire = await Wire.open(port)
        wire.send(auth(world=name), {"type": "ping"})
        await wire.read()
        await wire.read()
        times.append(1000 * (time.perf_counter() - began))
        wire.close()
    return times


def spread(values: list[float]) -> dict[str, float]:
    """Returns median, 99th percentile and maximum."""
    cuts = statistics.quantiles(values, n=1000)
    return {
        "p50": round(cuts[499], 2),
        "p99": round(cuts[989], 2),
        "p999": round(cuts[998], 2),
        "max": round(max(values), 2),
    }


def damage(path: Path) -> str:
    """Returns what a recording lacks; nothing where it is whole, or was only cut behind its last whole record."""
    found = Recording(path).damage
    return "" if found is None else "cut" if found.cut else found.message


def verify(folder: Path) -> dict[str, Any]:
    """Reads all recordings of a folder, in two processes, and returns how many are whole, cut, and damaged."""
    paths = sorted(folder.glob("*.mcap"))
    began = time.perf_counter()
    with ProcessPoolExecutor(2) as pool:
        found = list(pool.map(damage, paths, chunksize=64))
    told = [text for text in found if text not in ("", "cut")]
    return {
        "recordings": len(paths),
        "mb": round(sum(path.stat().st_size for path in paths) / 1e6),
        "whole": found.count(""),
        "cut": found.count("cut"),
        "damaged": told[:10],
        "verified_s": round(time.perf_counter() - began, 1),
    }


class Report:
    """The figures, phase by phase, with the time of the host's process and the load of the machine."""

    def __init__(self, host: Host) -> None:
        """Begins with a host that has just started."""
        self.figures: dict[str, Any] = {}
        self._host, self.began, self._used = host, time.perf_counter(), host.used

    def phase(self, name: str, **more: Any) -> None:
        """Ends a phase."""
        now, used = time.perf_counter(), self._host.used
        figures = {
            "wall_s": round(now - self.began, 1),
            "host_cpu_s": round(used - self._used, 1),
            "host_mb": round(self._host.memory),
            "load": round(os.getloadavg()[0], 1),
            **more,
        }
        self.figures[name] = figures
        print(f"{name}: {json.dumps(figures)}", file=sys.stderr, flush=True)
        self.began, self._used = time.perf_counter(), self._host.used


async def load(host: Host, count: int, ticks: int, lanes: int) -> dict[str, Any]:
    """Opens worlds, lets all sleep, wakes some of them; returns what that took."""
    report, port = Report(host), host.port
    names = [f"w{number}" for number in range(count)]
    await at_once((open_world(port, name, ticks) for name in names), lanes)
    report.phase("opened", ms_a_world=round(1000 * (time.perf_counter() - report.began) / count, 2))
    await asyncio.wait_for(asyncio.to_thread(host.wait_for_sleep), SETTLE)
    report.phase("asleep", kb_a_world=round(1000 * host.memory / count, 1))
    time.sleep(5.0)
    report.phase("idle")
    chosen = random.Random(1).sample(names, min(AWAKE + WOKEN, count))
    awake = [await Awake.enter(port, name) for name in chosen[:AWAKE]]
    await asyncio.sleep(2.0)
    report.phase("woke_some")
    began = time.perf_counter()
    await asyncio.sleep(WATCH)
    middle = time.perf_counter()
    report.phase("awake", late_ticks=lateness(awake, began, middle))
    middle = time.perf_counter()
    woken = await entering(port, chosen[AWAKE:])
    report.phase("entered", ms=spread(woken), late_ticks=lateness(awake, middle, time.perf_counter()))
    for client in awake:
        client.leave()
    report.phase("left", heard=sum(len(client.heard) for client in awake))
    return report.figures


def figures(count: int, ticks: int, lanes: int, workers: int) -> dict[str, Any]:
    """Runs a host and returns all figures."""
    with tempfile.TemporaryDirectory() as folder:
        program = str(Path(sys.executable).parent / "nmes")
        options = ["--mode", "lockstep", "--hibernate-after", "4", "--max-worlds", str(count + 1)]
        options += ["--workers", str(workers)] if workers else []
        command = [program, "serve", "--json", "--port", "0", "--record", folder, *options]
        environment = {**os.environ, "NMES_PASSWORD": PASSWORD}
        with subprocess.Popen(
            command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        ) as process:
            try:
                assert process.stdout is not None
                host = Host(process, json.loads(process.stdout.readline())["port"])
                told = asyncio.run(load(host, count, ticks, lanes))
                host.kill()
            finally:
                process.kill()
        asked = {"worlds": count, "ticks": ticks, "at_once": lanes, "workers": workers}
        return {**asked, **told, "after_kill": verify(Path(folder))}


def main() -> None:
    """Prints the figures."""
    parser = argparse.ArgumentParser(description="Open many worlds on one host, load it, and kill it.")
    parser.add_argument("worlds", type=int, nargs="?", default=WORLDS, help=f"up to {MOST:,}")
    parser.add_argument("--ticks", type=int, default=60, help="how long each ticks once it is made")
    parser.add_argument("--at-once", type=int, default=4, help="connections that open worlds at once")
    parser.add_argument("--workers", type=int, default=0, help="processes that host the worlds; 0: one, without them")
    asked = parser.parse_args()
    if not 1 <= asked.worlds <= MOST or not 1 <= asked.at_once <= 64 or not 0 <= asked.workers <= 64:
        parser.error(f"from 1 to {MOST:,} worlds, from 1 to 64 connections, and up to 64 workers")
    print(json.dumps(figures(asked.worlds, asked.ticks, asked.at_once, asked.workers), indent=2))


if __name__ == "__main__":
    main()
