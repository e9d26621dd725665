"""What a well-behaved client feels of those that are not: its ping before and while a host is put upon.

The client runs in a process of its own and asks for as long as it is let. What else happens to the host, `nmes serve`
with its usual limits, is done from here.
"""

from __future__ import annotations

import json
import random
import resource
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from hosting import PASSWORD, bystander, served
from measure import Figure
from nmes import Client
from nmes.protocol import COMMANDS, DELIMITER

SECONDS = 2.0  # of each trial, before and meanwhile
AUTH = json.dumps({"type": "auth", "password": PASSWORD, "world": "main"}).encode() + DELIMITER


def connect(port: int, first: bytes = AUTH) -> socket.socket:
    """Returns a socket that has sent something, the password or less."""
    peer = socket.create_connection(("127.0.0.1", port))
    peer.sendall(first)
    return peer


@contextmanager
def going_on(act: Callable[[], Any]) -> Iterator[None]:
    """Does something again and again in a thread."""
    stop = threading.Event()

    def run() -> None:
        while not stop.is_set():
            act()

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def ask(peer: socket.socket, frames: bytes) -> None:
    """Sends frames, and reads until the answer to a ping behind them."""
    peer.sendall(frames + b'{"type":"ping","id":"the last"}' + DELIMITER)
    heard = b""
    while b'"the last"' not in heard[-200:]:
        heard = heard[-200:] + peer.recv(1 << 18)


@contextmanager
def crowd(port: int) -> Iterator[None]:
    """A thousand connections, each of which says something now and then."""
    with ExitStack() as stack:
        peers = [stack.enter_context(connect(port)) for _ in range(1000)]
        turn = iter(range(1 << 60))
        with going_on(lambda: ask(peers[next(turn) % 1000], b"")):
            yield


@contextmanager
def stallers(port: int) -> Iterator[None]:
    """500 connections that stop in the middle of auth, or go on at a byte a second."""
    with ExitStack() as stack:
        peers = [stack.enter_context(connect(port, AUTH[: 40 * (n % 2)])) for n in range(500)]

        def drip() -> None:
            for peer in peers[::2]:
                with suppress(OSError):  # it was put out for others
                    peer.send(b" ")
            time.sleep(1)

        with going_on(drip):
            yield


@contextmanager
def deaf(port: int) -> Iterator[None]:
    """Ten subscribers that never read, of a world of 100 moving cubes that ticks as fast as it can."""
    with Client(port=port, password=PASSWORD, world="main") as client, ExitStack() as stack:
        for n in range(100):
            client.spawn_cube(position=[2 * n, 1e4, 0], list=False)
        for _ in range(10):
            stack.enter_context(connect(port, AUTH + b'{"type":"subscribe"}' + DELIMITER))
        client.set_mode("fast")
        yield


@contextmanager
def flood(port: int) -> Iterator[None]:
    """Spawns without end, 1,000 in a write, in a world that is full."""
    with connect(port) as peer, going_on(lambda: ask(peer, (b'{"type":"spawn_cube"}' + DELIMITER) * 1000)):
        yield


@contextmanager
def frames(port: int) -> Iterator[None]:
    """Frames that are random, or examples of commands with damage done to them, 1,000 in a write."""
    draw = random.Random(1)
    kinds = [schema for kind, schema in COMMANDS.items() if kind not in ("step", "set_mode", "batch", "get_camera")]
    examples = [json.dumps(example).encode() for schema in kinds for example in schema.schema["examples"]]

    def damaged() -> bytes:
        frame = bytearray(draw.choice(examples))
        for _ in range(draw.randrange(4)):
            frame[draw.randrange(len(frame))] ^= 1 << draw.randrange(8)
        return bytes(frame).replace(DELIMITER, b"")

    writes = [DELIMITER.join([*(damaged() for _ in range(1000)), b""]) for _ in range(10)]
    with connect(port) as peer, going_on(lambda: ask(peer, draw.choice(writes))):
        yield


@contextmanager
def long_step(port: int) -> Iterator[None]:
    """Another world of 100 cubes that is told to do 10,000 ticks in one step, again and again."""
    with Client(port=port, password=PASSWORD, world="other", timeout=60) as client:
        for n in range(100):
            client.spawn_cube(position=[2 * n, 1e4, 0], list=False)
        with connect(port, AUTH.replace(b"main", b"other")) as peer:
            peer.sendall((b'{"type":"step","ticks":10000}' + DELIMITER) * 100)
            yield


SCENES = {
    "1,000 connections": crowd,
    "500 stalled logins": stallers,
    "10 readers that never read": deaf,
    "a flood of spawns": flood,
    "a flood of damaged frames": frames,
    "long steps of another world": long_step,
}


def figures() -> Iterator[Figure]:
    """Measures."""
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard if hard != resource.RLIM_INFINITY and hard < 4096 else 4096, hard))
    for name, scene in SCENES.items():
        with ExitStack() as stack:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            port = stack.enter_context(served(folder, {"limits": {"cubes": 200}}, "main", "other"))
            good = stack.enter_context(bystander(port, "main"))
            time.sleep(1.0)
            good.percentiles()
            time.sleep(SECONDS)
            before = good.percentiles()
            with scene(port):
                good.percentiles()
                time.sleep(SECONDS)
                meanwhile = good.percentiles()
            details = {"before, ms": before, "meanwhile, ms": meanwhile}
            yield Figure(f"ping beside {name}: p99", meanwhile["p99"], "ms", details=details)
            yield Figure(f"ping beside {name}: p99 / before", meanwhile["p99"] / before["p99"], "x", details=details)
