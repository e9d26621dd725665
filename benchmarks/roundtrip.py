"""What a conversation costs over TCP: act + step + observe beside a bare echo, and commands in a long row.

Three servers run as processes of their own: a bare asyncio echo, `nmes serve` that records, and one that does not. One
client, asyncio streams too, talks to all of them: it writes three messages at once and reads three. What the echo is
sent and sends back is as long as what the world is sent and answers. The engine's own step is that of a bare loop of
`mj_step` with the same cube. The same is measured with a blocking socket, which takes the client's part out of both
sides of the ratio and leaves the server's.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import mujoco

from measure import Figure, in_turns, ratio, summary
from nmes import World
from nmes.protocol import DELIMITER

PASSWORD = "benchmark"
TRIPS = 300  # a trial
ROUNDS = 40
IN_A_ROW = 500  # commands in one write
ROWS = 40  # a trial

# Run as a process: answers each request of a known size with a canned reply.
ECHO = """
import asyncio, sys
size, reply = int(sys.argv[1]), sys.stdin.buffer.read()
async def echo(reader, writer):
    try:
        while True:
            await reader.readexactly(size)
            writer.write(reply)
            await writer.drain()
    except asyncio.IncompleteReadError:
        writer.close()
async def main():
    server = await asyncio.start_server(echo, "127.0.0.1", 0)
    print(server.sockets[0].getsockname()[1], flush=True)
    await server.serve_forever()
asyncio.run(main())
"""


class Stream:
    """A client of asyncio streams, which reads reply by reply."""

    def __init__(self, port: int) -> None:
        """Connects."""
        self._runner = asyncio.Runner()
        self._reader, self._writer = self._runner.run(asyncio.open_connection("127.0.0.1", port))

    def ask(self, request: bytes, replies: int) -> bytes:
        """Sends, and receives that many replies."""

        async def ask() -> bytes:
            self._writer.write(request)
            return b"".join([await self._reader.readuntil(DELIMITER) for _ in range(replies)])

        return self._runner.run(ask())

    def trips(self, request: bytes, replies: int) -> float:
        """Returns the time of one round trip, s, as the mean of many."""

        async def trips() -> float:
            reader, writer = self._reader, self._writer
            began = time.perf_counter()
            for _ in range(TRIPS):
                writer.write(request)
                for _ in range(replies):
                    await reader.readuntil(DELIMITER)
            return (time.perf_counter() - began) / TRIPS

        return self._runner.run(trips())

    def close(self) -> None:
        """Disconnects."""
        self._writer.close()
        self._runner.close()


class Socket:
    """A client of a blocking socket, which counts delimiters and does nothing else."""

    def __init__(self, port: int) -> None:
        """Connects."""
        self._socket = socket.create_connection(("127.0.0.1", port))
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def ask(self, request: bytes, replies: int) -> bytes:
        """Sends, and receives until that many replies are there."""
        self._socket.sendall(request)
        received = self._socket.recv(65536)
        while received.count(DELIMITER) < replies:
            received += self._socket.recv(65536)
        return received

    def trips(self, request: bytes, replies: int) -> float:
        """Returns the time of one round trip, s, as the mean of many."""
        ask = self.ask
        began = time.perf_counter()
        for _ in range(TRIPS):
            ask(request, replies)
        return (time.perf_counter() - began) / TRIPS

    def row(self, request: bytes, replies: int) -> float:
        """Returns replies per second while requests are written without waiting."""
        writer = threading.Thread(target=self._socket.sendall, args=(request * ROWS,))
        began = time.perf_counter()
        writer.start()
        left, tail = replies * ROWS, b""
        while left:
            data = tail + self._socket.recv(1 << 18)
            left -= data.count(DELIMITER)
            tail = data[-len(DELIMITER) + 1 :]  # a delimiter may come in two parts, but is not counted twice
        writer.join()
        return replies * ROWS / (time.perf_counter() - began)

    def close(self) -> None:
        """Disconnects."""
        self._socket.close()


Connection = TypeVar("Connection", Stream, Socket)


def commands(*messages: dict[str, Any]) -> bytes:
    """Encodes commands for the wire."""
    return b"".join(json.dumps(message, separators=(",", ":")).encode() + DELIMITER for message in messages)


SPAWN: dict[str, Any] = {"type": "spawn_cube", "cube_name": "cube", "position": [0, 0.5, 0]}
ACT: dict[str, Any] = {"type": "apply_physics", "cube_name": "cube", "force": [1.5, 0, -0.5]}
STEP: dict[str, Any] = {"type": "step"}
OBSERVE: dict[str, Any] = {"type": "get_cube_info", "cube_name": "cube"}
TRIP = commands(ACT, STEP, OBSERVE)
ROW = commands(*[ACT, OBSERVE] * (IN_A_ROW // 2))


@contextmanager
def served(*options: str) -> Iterator[int]:
    """Runs `nmes serve` in lockstep with one cube on the ground; yields the port."""
    nmes = str(Path(sys.executable).parent / "nmes")
    server = subprocess.Popen(
        [nmes, "serve", "--json", "--port", "0", "--mode", "lockstep", *options],
        env={**os.environ, "NMES_PASSWORD": PASSWORD},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    try:
        assert server.stdout is not None
        port = int(json.loads(server.stdout.readline())["port"])
        with closing(authenticated(Socket, port)) as client:
            client.ask(commands(SPAWN), 1)
        yield port
    finally:
        server.send_signal(signal.SIGTERM)
        server.wait(30)


def authenticated(kind: type[Connection], port: int) -> Connection:
    """Returns a client that a world has let in."""
    client = kind(port)
    client.ask(commands({"type": "auth", "password": PASSWORD}), 1)
    return client


@contextmanager
def echoed(request: bytes, reply: bytes) -> Iterator[int]:
    """Runs the echo; yields the port."""
    command = [sys.executable, "-c", ECHO, str(len(request))]
    server = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        assert server.stdin is not None and server.stdout is not None
        server.stdin.write(reply)
        server.stdin.close()
        yield int(server.stdout.readline())
    finally:
        server.terminate()
        server.wait(30)


class Engine:
    """The engine alone, pushing the very cube that the servers have and stepping it."""

    def __init__(self) -> None:
        """Takes the model from a world."""
        world = World({"mode": "lockstep"})
        client = world.join()
        world.execute(client, SPAWN)
        world.execute(client, STEP)
        running = world.simulation.running  # type: ignore[attr-defined]
        self._model, self._data, self._substeps = running.model, running.data, world.config["substeps"]
        self._world = world  # whose engine it is: it lives as long

    def steps(self) -> float:
        """Returns the time of one step of the world, s, as the mean of many."""
        step, model, data = mujoco.mj_step, self._model, self._data
        pushed = data.xfrc_applied[-1, :3]
        began = time.perf_counter()
        for _ in range(TRIPS):
            pushed[:] = ACT["force"]
            step(model, data, self._substeps)
        return (time.perf_counter() - began) / TRIPS


def figures() -> Iterator[Figure]:
    """Measures."""
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        recorded = stack.enter_context(served("--record", folder))
        unrecorded = stack.enter_context(served("--no-record"))
        sockets = {
            "recorded": stack.enter_context(closing(authenticated(Socket, recorded))),
            "unrecorded": stack.enter_context(closing(authenticated(Socket, unrecorded))),
        }
        reply = sockets["recorded"].ask(TRIP, 3)
        echo = stack.enter_context(echoed(TRIP, reply))
        streams = {
            "recorded": stack.enter_context(closing(authenticated(Stream, recorded))),
            "unrecorded": stack.enter_context(closing(authenticated(Stream, unrecorded))),
            "echo": stack.enter_context(closing(Stream(echo))),
        }
        sockets["echo"] = stack.enter_context(closing(Socket(echo)))

        trials = {name: partial(client.trips, TRIP, 3) for name, client in streams.items()}
        samples = in_turns({**trials, "engine": Engine().steps}, ROUNDS)
        times = {"microseconds": summary(samples, 1e-6), "bytes sent": len(TRIP), "bytes received": len(reply)}
        samples["least"] = [echo + step for echo, step in zip(samples["echo"], samples["engine"], strict=True)]
        name = "act + step + observe / (bare echo + the engine's own step)"
        yield Figure(name, ratio(samples, "recorded", "least"), "x", at_most=1.8, details=times)
        name = "act + step + observe / bare echo"
        yield Figure(name, ratio(samples, "recorded", "echo"), "x", at_most=2.0, details=times)
        share = 100 * (ratio(samples, "recorded", "unrecorded") - 1)
        yield Figure("recording adds", share, "%", at_most=15.0, details=times)

        samples = in_turns({name: partial(client.trips, TRIP, 3) for name, client in sockets.items()}, ROUNDS)
        times = {"microseconds": summary(samples, 1e-6)}
        name = "act + step + observe / echo, sockets"
        yield Figure(name, ratio(samples, "recorded", "echo"), "x", details=times)

        del sockets["echo"]
        samples = in_turns({name: partial(client.row, ROW, IN_A_ROW) for name, client in sockets.items()}, ROUNDS // 4)
        rates = summary(samples, 1.0)
        rate = rates["recorded"]["median"]
        name = "pipelined commands"
        yield Figure(name, rate, "/s", at_least=40_000, details={"per second": rates})
