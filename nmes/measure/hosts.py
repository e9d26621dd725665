"""Conversations with a host over TCP: what agents cost it, how many decisions a second one makes, how cubes come.

Hides the host, which is a process of its own, `nmes serve` without recording, and how its processor's time is read.
"""

from __future__ import annotations

import asyncio
import json
import os
import secrets
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AsyncExitStack, ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any, Final

from nmes.client import AsyncClient, Client
from nmes.errors import MachineError
from nmes.evaluation.processes import signals_deferred
from nmes.measure.turns import in_turns, ratio
from nmes.schemas.documents import canonical_hash
from nmes.variation.draw import Draw

__all__ = [
    "AgentCost",
    "DecisionRates",
    "RunningHost",
    "SpawnTimes",
    "measure_agents",
    "measure_decisions",
    "measure_spawning",
    "running_host",
]

_PATIENCE: Final = 30.0  # s that a host is given to end
_APART: Final = 3.0  # m between agents, which never meet
_PUSH: Final = 4.0  # N at most
_SPREAD: Final = 2.0  # m between cubes that are spawned


@dataclass(frozen=True, slots=True)
class AgentCost:
    """What so many agents cost a host.

    Attributes:
        agents: How many, each with a connection and a cube of its own.
        milliseconds: Of the host's processor for a tick in which each of them observes and acts, ms.
        each: The part of one of them of that, over what a single agent takes.
    """

    agents: int
    milliseconds: float
    each: float


@dataclass(frozen=True, slots=True)
class DecisionRates:
    """How many decisions a second an agent makes: it observes, decides, and acts.

    Attributes:
        lockstep: A second of the clock, where the world waits for each of them.
        real_time: A second of the clock, where the world ticks by it and the agent decides at each tick that it hears.
        in_time: The part of the world's ticks, in real time, for each of which there was a decision.
    """

    lockstep: float
    real_time: float
    in_time: float


@dataclass(frozen=True, slots=True)
class SpawnTimes:
    """What it takes to spawn cubes.

    Attributes:
        one: Over one connection, each awaited, ms a cube.
        many: Over several side by side, each of which awaits its own, ms a cube.
        together: Over one connection, all sent together, ms a cube.
        one_over_many: The ratio of the first two, the median of all rounds.
        one_over_together: That of the first and the last.
    """

    one: float
    many: float
    together: float
    one_over_many: float
    one_over_together: float


class RunningHost:
    """A host that runs.

    Attributes:
        address: `HOST:PORT`.
        password: Its password.
        connect: Returns a client that is not connected yet.
        connect_async: The same, awaiting.
    """

    def __init__(self, process: subprocess.Popen[bytes], port: int, password: str) -> None:
        self._pid = process.pid
        self.address, self.password = f"127.0.0.1:{port}", password
        self.connect = partial(Client, port=port, password=password, timeout=_PATIENCE)
        self.connect_async = partial(AsyncClient, port=port, password=password, timeout=_PATIENCE)

    def seconds(self) -> float:
        """Returns the time (s) that its threads have had of processors so far.

        Raises:
            MachineError: The system does not tell (`cannot_measure`).
        """
        if sys.platform != "linux":
            raise MachineError("cannot_measure", "the processor's time of another process is read on Linux alone")
        return time.clock_gettime(~self._pid << 3 | 2)  # what clock_getcpuclockid(3) returns there


@contextmanager
def running_host(mode: str, rate: float = 1.0) -> Iterator[RunningHost]:
    """Runs a host of one world.

    Args:
        mode: How the world ticks.
        rate: How many seconds of the world there are in one of the clock, in real time.

    Raises:
        MachineError: It does not begin (`cannot_measure`).
    """
    password = secrets.token_hex(16)
    ticks = ["--mode", mode, "--rate", f"{rate:g}"]
    command = [sys.executable, "-P", "-m", "nmes", "serve", "--port", "0", "--no-record", *ticks, "--json"]
    environment = {**os.environ, "NMES_PASSWORD": password}
    process: subprocess.Popen[bytes] | None = None
    try:
        with signals_deferred():
            process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        assert process.stdout is not None
        line = process.stdout.readline()
        if not line:
            raise MachineError("cannot_measure", "a host does not begin here: see what `nmes serve` says")
        yield RunningHost(process, json.loads(line)["port"], password)
    finally:
        if process is not None:
            with process:
                process.terminate()
                process.wait(_PATIENCE)


# -- agents -----------------------------------------------------------------------------------------------------------


def measure_agents(counts: Sequence[int], ticks: int, seed: int, rounds: int) -> tuple[list[AgentCost], str]:
    """Measures what agents cost a host that share a world, which waits for all of them.

    Args:
        counts: How many agents, several times.
        ticks: That each round lasts.
        seed: Of what they do.
        rounds: How often each number of agents is measured.

    Returns:
        What each number of agents costs, and a digest of where their cubes are in the end, which follows from the rest.

    Raises:
        MachineError: The processor's time of a host cannot be told here, or none begins (`cannot_measure`).
    """
    with running_host("lockstep") as host, ExitStack() as stack:
        clients = [stack.enter_context(host.connect()) for _ in range(max(counts))]
        names = [
            client.spawn_cube(position=[_APART * place, 0.5, 0.0], friction=0.1, list=False)["spawned"]
            for place, client in enumerate(clients)
        ]
        draw = Draw(seed, "agents")

        def spent(count: int) -> float:
            before = host.seconds()
            for _ in range(ticks):
                for client, name in zip(clients[:count], names, strict=False):
                    _decide(client, name, draw)
                clients[0].step()
            return (host.seconds() - before) / ticks

        samples = in_turns({f"{count:06}": partial(spent, count) for count in sorted({1, *counts})}, rounds)
        where = [client.get_cube_state(name)["position"] for client, name in zip(clients, names, strict=True)]
    found = []
    for count in counts:
        times = sorted(samples[f"{count:06}"])
        each = ratio(samples, f"{count:06}", f"{1:06}") / count
        found.append(AgentCost(count, 1e3 * times[len(times) // 2], each))
    return found, canonical_hash({"where": where})[:32]


def _decide(client: Client, name: str, draw: Draw) -> None:
    """Observes and acts, as one who must see before it acts does: in two trips."""
    client.get_cube_info(name)
    client.apply_physics(name, force=[draw.uniform(-_PUSH, _PUSH), 0.0, draw.uniform(-_PUSH, _PUSH)])


# -- decisions --------------------------------------------------------------------------------------------------------


def measure_decisions(seconds: float, seed: int) -> DecisionRates:
    """Measures how many decisions a second one agent makes.

    Args:
        seconds: For how long, in either mode.
        seed: Of what it does.

    Raises:
        MachineError: No host begins (`cannot_measure`).
    """
    draw = Draw(seed, "decisions")
    with running_host("lockstep") as host, host.connect() as client:
        name = client.spawn_cube(position=[0.0, 0.5, 0.0], friction=0.1, list=False)["spawned"]
        count, began = 0, time.perf_counter()
        while (took := time.perf_counter() - began) < seconds:
            _decide(client, name, draw)
            client.step()
            count += 1
        lockstep = count / took
    with running_host("realtime") as host, host.connect() as client:
        name = client.spawn_cube(position=[0.0, 0.5, 0.0], friction=0.1, list=False)["spawned"]
        client.subscribe(events=["tick"])
        frames, began = [], 0.0
        for event in client.events():
            if event["type"] != "tick":
                continue
            began = began or time.perf_counter()
            _decide(client, name, draw)
            frames.append(event["frame"])
            if (took := time.perf_counter() - began) >= seconds and len(frames) > 1:
                break
    apart = [after - before for before, after in pairwise(frames)]
    return DecisionRates(lockstep, len(apart) / took, apart.count(1) / sum(apart))


# -- spawning ---------------------------------------------------------------------------------------------------------


def measure_spawning(cubes: int, connections: int, rounds: int) -> SpawnTimes:
    """Measures how long it takes to spawn cubes in a world in real time, over one connection and over several.

    Args:
        cubes: How many.
        connections: Over how many side by side.
        rounds: How often each way is measured.

    Raises:
        MachineError: No host begins (`cannot_measure`).
    """
    samples = asyncio.run(_spawning(cubes, connections, rounds))
    middle = {name: 1e3 * sorted(times)[len(times) // 2] / cubes for name, times in samples.items()}
    shares = ratio(samples, "one", "many"), ratio(samples, "one", "together")
    return SpawnTimes(middle["one"], middle["many"], middle["together"], *shares)


async def _spawning(cubes: int, connections: int, rounds: int) -> dict[str, list[float]]:
    samples: dict[str, list[float]] = {"one": [], "many": [], "together": []}
    places = [[_SPREAD * number, 0.5, 0.0] for number in range(cubes)]
    with running_host("realtime") as host:
        async with AsyncExitStack() as stack:
            clients = [await stack.enter_async_context(host.connect_async()) for _ in range(connections)]

            async def spawn(client: AsyncClient, own: Sequence[Sequence[float]]) -> None:
                for place in own:
                    await client.spawn_cube(position=place, list=False)

            async def one() -> None:
                await spawn(clients[0], places)

            async def many() -> None:
                parts = [places[number::connections] for number in range(connections)]
                await asyncio.gather(*map(spawn, clients, parts))

            async def together() -> None:
                async with clients[0].pipeline() as pipeline:
                    for place in places:
                        pipeline.spawn_cube(position=place, list=False)

            ways: dict[str, Callable[[], Any]] = {"one": one, "many": many, "together": together}
            for number in range(rounds + 1):
                for name in sorted(ways, reverse=number % 2 == 1):
                    await clients[0].reset()
                    began = time.perf_counter()
                    await ways[name]()
                    if number:  # the first is for warmth
                        samples[name].append(time.perf_counter() - began)
    return samples
