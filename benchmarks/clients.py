"""What the clients in Python, Go and TypeScript cost: act + step + observe, and commands in a long row.

One server, one recorded world a client; the clients take turns. A trip is three commands, each of which waits for its
reply, as a controller does. In the row 1,000 commands are on their way at once. Go and Node are left out where they are
missing. In Go 1,000 goroutines also share the connection; the recording tells whether what each sent came whole, and in
order.
"""

from __future__ import annotations

import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from math import inf
from pathlib import Path
from typing import Protocol

from measure import Figure, in_turns, ratio, summary
from nmes.recording import Kind, Recording

PASSWORD = "benchmark"
ROUNDS = 10
TRIPS = 300  # a trial
COMMANDS = 20_000  # a trial
ON_THEIR_WAY = 1000
GOROUTINES = 1000
FIRST = 2  # the first goroutine's number; fewer are those of other trials (clients/go/bench)
CLIENTS = Path(__file__).parent.parent / "clients"
GO_ENVIRONMENT = {"GOTOOLCHAIN": "local", "GOFLAGS": "-mod=readonly", "GOPROXY": "off"}


class Runner(Protocol):
    """A client that does something so often, and says how long that took."""

    def __call__(self, what: str, count: int) -> float:
        """Returns the seconds."""


# Run as a process, like the others: what Python's client costs.
PYTHON = f"""
import sys, time
from nmes import Client
with Client(port=int(sys.argv[1])) as client:
    client.set_mode("lockstep")
    client.spawn_cube(cube_name="box")
    def trips(count):
        for _ in range(count):
            client.apply_physics("box", force=[1, 0, 0])
            client.step()
            client.get_cube_state("box")
    def pipelined(count):
        for _ in range(count // {ON_THEIR_WAY}):
            with client.pipeline() as together:
                for _ in range({ON_THEIR_WAY}):
                    together.apply_physics("box", force=[1, 0, 0])
    for line in sys.stdin:
        what, count = line.split()
        began = time.perf_counter()
        (trips if what == "trips" else pipelined)(int(count))
        print(time.perf_counter() - began, flush=True)
"""


@contextmanager
def process(*command: str) -> Iterator[Runner]:
    """Runs a client that is asked by lines."""
    environment = {**os.environ, "NMES_PASSWORD": PASSWORD}
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
    ) as running:
        stdin, stdout = running.stdin, running.stdout
        assert stdin is not None and stdout is not None

        def ask(what: str, count: int) -> float:
            stdin.write(f"{what} {count}\n")
            stdin.flush()
            return float(stdout.readline())

        try:
            yield ask
        finally:
            stdin.close()


@contextmanager
def served(worlds: int, folder: Path) -> Iterator[list[int]]:
    """Serves worlds that are recorded into a folder; gives their ports."""
    program = [str(Path(sys.executable).parent / "nmes"), "serve", "--json", "--record", str(folder / "recordings")]
    command = [*program, "--port", "0", "--worlds", str(worlds), "--mode", "lockstep"]
    environment = {**os.environ, "NMES_PASSWORD": PASSWORD}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as server:
        assert server.stdout is not None
        try:
            told = json.loads(server.stdout.readline())
            yield [world["port"] for world in told["worlds"]]
        finally:
            server.terminate()


def commands(folder: Path) -> Mapping[str, list[str]]:
    """Returns how each client is started, what has to be built in a folder."""
    found = {"Python": [sys.executable, "-c", PYTHON]}
    go = shutil.which("go", path=os.pathsep.join([os.environ.get("PATH", os.defpath), "/usr/local/go/bin"]))
    if go is not None:
        environment = {**os.environ, **GO_ENVIRONMENT}
        subprocess.run(
            [go, "build", "-o", folder / "bench", "./bench"], cwd=CLIENTS / "go", env=environment, check=True
        )
        found["Go"] = [str(folder / "bench")]
    node, compiler = shutil.which("node"), CLIENTS / "typescript" / "node_modules" / "typescript" / "bin" / "tsc"
    if node is not None and compiler.exists():
        subprocess.run([node, compiler, "-p", ".", "--outDir", folder / "dist"], cwd=CLIENTS / "typescript", check=True)
        (folder / "package.json").write_text('{"type": "module"}')
        found["Node"] = [node, str(folder / "dist" / "bench" / "bench.js")]
    return found


def astray(folder: Path, rounds: int) -> int:
    """Returns in how many places a folder's recordings differ from what goroutines sent: missing, doubled, overtaken.

    Each goroutine pushes with its number along x, and along y with how many commands it had sent in that round.
    """
    sent = defaultdict[int, list[int]](list)
    for path in folder.rglob("*.mcap"):
        for record in Recording(path):
            if record.kind is Kind.COMMAND and b'"apply_physics"' in record.data:
                goroutine, number, _ = json.loads(record.data)["force"]
                if goroutine >= FIRST:
                    sent[goroutine].append(number)
    numbers = list(range(COMMANDS // GOROUTINES)) * rounds
    apart = 0
    for goroutine in range(FIRST, FIRST + GOROUTINES):
        came = sent.pop(goroutine, [])
        apart += abs(len(came) - len(numbers)) + sum(one != other for one, other in zip(came, numbers, strict=False))
    return apart + sum(map(len, sent.values()))


def figures() -> Iterator[Figure]:
    """Measures."""
    with tempfile.TemporaryDirectory() as name:
        with ExitStack() as stack:
            started = commands(Path(name))
            ports = stack.enter_context(served(len(started), Path(name)))
            runners = {
                name: stack.enter_context(process(*command, str(port)))
                for (name, command), port in zip(started.items(), ports, strict=True)
            }
            trips = in_turns({name: partial(run, "trips", TRIPS) for name, run in runners.items()}, ROUNDS)
            rows = in_turns({name: partial(run, "pipelined", COMMANDS) for name, run in runners.items()}, ROUNDS)
            shared = [runners["Go"]("shared", COMMANDS) for _ in range(ROUNDS)] if "Go" in runners else []
        lost = astray(Path(name) / "recordings", len(shared)) if shared else 0
    rates = {name: [COMMANDS / seconds for seconds in values] for name, values in rows.items()}
    details = {"trips, us": summary(trips, TRIPS * 1e-6), "commands/s": summary(rates, 1)}
    for name in runners:
        middle = summary(rates, 1)[name]["median"]
        aim = 60_000 if name == "Go" else -inf
        yield Figure(f"{name}: commands in a row", middle, "commands/s", at_least=aim, details=details)
    for name in runners:
        middle = summary(trips, TRIPS * 1e-6)[name]["median"]
        yield Figure(f"{name}: act + step + observe", middle, "us", details=details)
    if "Go" in runners:
        rate = COMMANDS / statistics.median(shared)
        yield Figure(f"Go: commands of {GOROUTINES:,} goroutines over one connection", rate, "commands/s")
        yield Figure("Go: of these lost, doubled or out of order, in all rounds", lost, "commands", at_most=0)
        yield Figure("act + step + observe, Python's time over Go's", ratio(trips, "Python", "Go"), "x", at_least=1)
    if {"Go", "Node"} <= runners.keys():
        yield Figure("commands in a row, Node's rate over Go's", ratio(rates, "Node", "Go"), "x", at_least=0.7)
