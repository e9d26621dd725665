"""What a ping to one world takes while another world of the same host, or the host itself, is attacked.

Each attack is one that once stopped a host, or stalled it for seconds. The client that pings runs in a process of its
own; all runs on two cores at most, one of which the attack keeps busy.
"""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from importlib.resources import files
from pathlib import Path
from typing import Any

from hosting import PASSWORD, served
from measure import Figure
from nmes import Client
from nmes.protocol import DELIMITER

SECONDS = 4.0  # of each attack
AUTH = json.dumps({"type": "auth", "password": PASSWORD, "world": "victim"}).encode() + DELIMITER

# Run as a process: pings until a line comes in, then tells the percentiles, in ms.
BYSTANDER = """
import json, select, statistics, sys, time
from nmes import Client
with Client(port=int(sys.argv[1]), password=sys.argv[2], world="other", timeout=120) as client:
    times = []
    print("ready", flush=True)
    while not select.select([sys.stdin], [], [], 0.002)[0] or len(times) < 50:
        began = time.perf_counter()
        client.ping()
        times.append(1000 * (time.perf_counter() - began))
    cuts = statistics.quantiles(times, n=100)
    print(json.dumps({"p50": cuts[49], "p99": cuts[98], "max": max(times), "pings": len(times)}))
"""


class Attack:
    """Sockets of one attacker."""

    def __init__(self, port: int) -> None:
        self.port = port
        self._stop = threading.Event()

    @property
    def going(self) -> bool:
        """Whether it is to go on."""
        return not self._stop.is_set()

    def stop(self) -> None:
        """Ends it soon."""
        self._stop.set()

    def victim(self) -> Client:
        """Returns a client of the attacked world."""
        return Client(port=self.port, password=PASSWORD, world="victim", timeout=120).connect()

    def again(self, *frames: bytes) -> None:
        """Sends frames to the attacked world, one after another, and each time waits for the answer."""
        with socket.create_connection(("127.0.0.1", self.port)) as peer:
            peer.settimeout(0.2)
            peer.sendall(AUTH)
            self._hear(peer)
            while self.going:
                for frame in frames:
                    peer.sendall(frame + DELIMITER)
                    self._hear(peer)

    def _hear(self, peer: socket.socket) -> None:
        heard = b""
        while self.going and DELIMITER not in heard[-200:]:
            with suppress(TimeoutError):
                heard = heard[-200:] + (peer.recv(1 << 18) or DELIMITER)


def say(**command: Any) -> bytes:
    """Returns the frame of a command."""
    return json.dumps(command).encode()


def empty_genome(attack: Attack) -> None:
    """600 KB of a genome with 200,000 empty cubes."""
    genome = b'{"format":"nmes-genome/1","name":"x","body":{"cubes":[' + b",".join([b"{}"] * 200_000) + b"]}}"
    attack.again(b'{"type":"spawn_creature","genome":' + genome + b"}")


def small_genome(attack: Attack) -> None:
    """A genome as many have, again and again, and a reset."""
    genome = json.loads((files("nmes.genome") / "shipped/centipede.json").read_text())
    attack.again(say(type="spawn_creature", genome=genome), say(type="step"), say(type="reset"))


def one_name(attack: Attack) -> None:
    """The state of one cube, named 100,000 times."""
    attack.again(say(type="spawn_cube"), say(type="get_world_state", cubes=["cube"] * 100_000))


def empty_objects(attack: Attack) -> None:
    """A frame of 1 MB that is nothing but empty objects."""
    attack.again(b'{"type":"ping","x":[' + b",".join([b"{}"] * 330_000) + b"]}")


def pings(attack: Attack) -> None:
    """Batches of 10,000 pings."""
    attack.again(say(type="batch", commands=[{"type": "ping"}] * 10_000))


def _spawned(attack: Attack, count: int, gap: float) -> None:
    with attack.victim() as client, client.pipeline() as many:
        for n in range(count):
            many.spawn_cube(position=[gap * (n % 80), 0.5, gap * (n // 80)], list=False)


def big_build(attack: Attack) -> None:
    """A step after 3,000 spawns, again and again."""
    while attack.going:
        _spawned(attack, 3000, 3.0)
        attack.again(say(type="step"), say(type="reset"), *[say(type="spawn_cube", position=[0, 9, 0])] * 3)


def pile(attack: Attack) -> None:
    """300 cubes spawned on one spot, and steps."""
    _spawned(attack, 300, 0.0)
    attack.again(say(type="step"))


def big_state(attack: Attack) -> None:
    """The state of all of 5,000 cubes."""
    _spawned(attack, 5000, 3.0)
    attack.again(say(type="get_world_state"))


def resets(attack: Attack) -> None:
    """Resets."""
    attack.again(say(type="reset"))


def guesses(attack: Attack) -> None:
    """Wrong passwords over 400 connections."""

    def guess() -> None:
        while attack.going:
            with suppress(OSError), socket.create_connection(("127.0.0.1", attack.port)) as peer:
                peer.settimeout(2.0)
                peer.sendall(b"guess" + DELIMITER)
                peer.recv(1 << 10)

    threads = [threading.Thread(target=guess) for _ in range(400)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def silence(attack: Attack) -> None:
    """Sockets that say nothing, 2,000 at once, renewed as they are put out."""
    while attack.going:
        with ExitStack() as stack, suppress(OSError):
            for _ in range(900):
                stack.enter_context(socket.create_connection(("127.0.0.1", attack.port)))


def short_lives(attack: Attack) -> None:
    """Connections that log in, say something and go."""
    while attack.going:
        with socket.create_connection(("127.0.0.1", attack.port)) as peer:
            peer.sendall(AUTH + say(type="ping") + DELIMITER)
            peer.recv(1 << 16)


ATTACKS: dict[str, Callable[[Attack], None]] = {
    "nothing": lambda attack: None,
    "200,000 empty cubes": empty_genome,
    "genomes and resets": small_genome,
    "one name 100,000 times": one_name,
    "330,000 empty objects": empty_objects,
    "batches of 10,000": pings,
    "a step after 3,000 spawns": big_build,
    "300 cubes on one spot": pile,
    "the state of 5,000 cubes": big_state,
    "resets": resets,
    "guesses over 400 connections": guesses,
    "silent sockets": silence,
    "short connections": short_lives,
}


@contextmanager
def under(attack: Attack, act: Callable[[Attack], None]) -> Iterator[None]:
    """Attacks in a thread."""

    def run() -> None:
        with suppress(Exception):  # a host that hangs up on an attacker is right
            act(attack)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield
    finally:
        attack.stop()
        thread.join(10)


def figures() -> Iterator[Figure]:
    """Measures."""
    for name, act in ATTACKS.items():
        with ExitStack() as stack:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            port = stack.enter_context(served(folder, {"limits": {"cubes": 10_000}}, "victim", "other"))
            command = [sys.executable, "-c", BYSTANDER, str(port), PASSWORD]
            good = stack.enter_context(subprocess.Popen(command, stdin=-1, stdout=-1, text=True))
            stack.callback(good.kill)
            assert good.stdin is not None and good.stdout is not None
            good.stdout.readline()
            with under(Attack(port), act):
                time.sleep(SECONDS)
                good.stdin.write("\n")
                good.stdin.flush()
                line = good.stdout.readline()
            if line:
                times = json.loads(line)
                yield Figure(f"ping beside {name}: p99", times["p99"], "ms", at_most=50.0, details=times)
            else:  # it was shut out
                yield Figure(f"ping beside {name}: p99", float("nan"), "ms", at_most=50.0)
