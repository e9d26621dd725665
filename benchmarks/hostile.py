"""What a ping to one world takes while another world of the same host, or the host itself, is attacked.

Each attack is one that once stopped a host, or stalled it for seconds. The client that pings runs in a process of its
own; all runs on two cores at most, one of which the attack keeps busy.
"""

from __future__ import annotations

import json
import selectors
import socket
import ssl
import struct
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from importlib.resources import files
from pathlib import Path
from typing import Any, cast

import trustme

from hosting import PASSWORD, bystander, served
from measure import Figure
from nmes import Client
from nmes.errors import NmesError
from nmes.protocol import DELIMITER

SECONDS = 4.0  # of each attack
AUTH = json.dumps({"type": "auth", "password": PASSWORD, "world": "victim"}).encode() + DELIMITER
RAW = PASSWORD.encode() + DELIMITER  # of the raw dialect, for the first world, which is the victim


class Attack:
    """Sockets of one attacker."""

    def __init__(self, port: int, authority: trustme.CA) -> None:
        self.port = port
        self._trust = ssl.create_default_context()
        authority.configure_trust(self._trust)
        self._stop = threading.Event()

    @property
    def going(self) -> bool:
        """Whether it is to go on."""
        return not self._stop.is_set()

    def stop(self) -> None:
        """Ends it soon."""
        self._stop.set()

    def wait(self) -> None:
        """Does nothing until it is to end."""
        self._stop.wait()

    def victim(self) -> Client:
        """Returns a client of the attacked world."""
        return Client(port=self.port, password=PASSWORD, world="victim", timeout=120).connect()

    def peer(self) -> socket.socket:
        """Returns a socket that has said nothing."""
        return socket.create_connection(("127.0.0.1", self.port), timeout=2.0)

    def tls(self) -> Tls:
        """Returns the client's side of a TLS connection that has not begun."""
        return Tls(self._trust)

    def again(self, *frames: bytes, auth: bytes = AUTH) -> None:
        """Sends frames to the attacked world, one after another, and each time waits for the answer."""
        with socket.create_connection(("127.0.0.1", self.port)) as peer:
            peer.settimeout(0.2)
            peer.sendall(auth)
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


class Tls:
    """The client's side of a TLS connection, without a socket: it says which bytes to send."""

    def __init__(self, trust: ssl.SSLContext) -> None:
        self._incoming, self._outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._session = trust.wrap_bio(self._incoming, self._outgoing, server_hostname="127.0.0.1")

    def hello(self) -> bytes:
        """Returns what a handshake begins with."""
        with suppress(ssl.SSLWantReadError):
            self._session.do_handshake()
        return self._outgoing.read()

    def shake(self, peer: socket.socket) -> None:
        """Does the whole handshake over a socket."""
        peer.sendall(self.hello())
        while True:
            self._incoming.write(peer.recv(1 << 16))
            try:
                self._session.do_handshake()
                break
            except ssl.SSLWantReadError:
                continue
        peer.sendall(self._outgoing.read())

    def records(self, data: bytes, size: int = 1) -> bytes:
        """Returns data as records of so many bytes of it each."""
        for start in range(0, len(data), size):
            self._session.write(data[start : start + size])
        return self._outgoing.read()


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


def translations(attack: Attack) -> None:
    """Batches of the raw dialect with replies of 8 MiB, of which one is told in the original's words."""
    _spawned(attack, 5000, 3.0)
    joint = {"type": "get_joint_info", "joint_name": "none"}
    attack.again(say(type="batch", commands=[joint, *[{"type": "get_world_state"}] * 9]), auth=RAW)


def renamings(attack: Attack) -> None:
    """Batches of the raw dialect of 10,000 commands whose replies are all told in the original's words."""
    joint = {"type": "get_joint_info", "joint_name": "none"}
    attack.again(say(type="batch", commands=[joint] * 10_000), auth=RAW)


def big_build(attack: Attack) -> None:
    """A step after 3,000 spawns, again and again."""
    while attack.going:
        _spawned(attack, 3000, 3.0)
        with attack.victim() as client:
            client.step()
            client.reset()


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


def _grown(count: int, **connection: Any) -> bytes:
    """Returns what spawns so many parts, each of which grows on the one before, round and round."""
    joint = {"type": "slide", "motor": {"mode": "position", "range": [-1, 1], "max_effort": 10}}
    names = [f"p{number}" for number in range(max(count // 64, 2))]
    parts = [{"id": name, "size": 0.5, "joint": joint, "recursive_limit": count // len(names)} for name in names]
    ends = zip(names, [*names[1:], names[0]], strict=True)
    connections = [{"from": one, "to": other, "face": "+x", **connection} for one, other in ends]
    body = {"graph": {"root": names[0], "parts": parts, "connections": connections}}
    return say(type="spawn_creature", genome={"format": "nmes-genome/1", "name": "x", "body": body})


def growth(attack: Attack) -> None:
    """A graph of two parts that grows ten times as large with each of 128."""
    attack.again(_grown(128, scale=10))


def chain(attack: Attack) -> None:
    """A graph of a few hundred bytes that grows to a chain of 256 cubes, and a reset."""
    attack.again(_grown(256), say(type="step"), say(type="reset"))


def patterns(attack: Attack) -> None:
    """Names with as many wildcards as they may have."""
    cubes = [
        {"id": "a" * 60 + f"{number:04}", "size": 0.1, "mass": 1, "position": [number, 0.05, 0]}
        for number in range(256)
    ]
    sensors = [{"type": "up", "cube": "*a" * 28 + f"*{number}*b"} for number in range(1024)]
    genome = {"format": "nmes-genome/1", "name": "x", "body": {"cubes": cubes}, "sensors": sensors}
    attack.again(say(type="spawn_creature", genome=genome))


def nothings(attack: Attack) -> None:
    """An objective that has no value, asked for again and again."""
    cube = say(type="spawn_cube", cube_name="a", position=[-1, 0.5, 0])
    objective = say(type="set_objective", expression="height < sqrt(position.x) ? 1.0 : 2.0", cubes=["a"])
    attack.again(cube, objective, say(type="step"), say(type="compute_reward"))


def joints(attack: Attack) -> None:
    """A chain of joints, one after another, beyond the 1,024 that there may be."""
    with attack.victim() as client, client.pipeline() as many:
        for number in range(1200):
            many.spawn_cube(position=[1.0 * number, 0.5, 0.0], cube_name=f"c{number}", list=False)
        for number in range(1199):
            many.create_joint(f"c{number}", f"c{number + 1}", "hinge")


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
    """Sockets that say nothing, 900 at once, renewed as they are put out."""
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


def half_handshakes(attack: Attack) -> None:
    """Sockets that say half of a TLS hello, 500 at once, renewed as they are put out."""
    while attack.going:
        with ExitStack() as stack, suppress(OSError):
            for _ in range(500):
                hello = attack.tls().hello()
                stack.enter_context(attack.peer()).sendall(hello[: len(hello) // 2])


def whole_handshakes(attack: Attack) -> None:
    """Handshakes that the host has to answer with its certificate and signature, and that nobody goes on with."""
    while attack.going:
        with suppress(OSError), attack.peer() as peer:
            peer.sendall(attack.tls().hello())
            peer.recv(1 << 16)


def small_records(attack: Attack) -> None:
    """A client whose every byte is a TLS record of its own."""
    with attack.peer() as peer:
        tls = attack.tls()
        tls.shake(peer)
        peer.sendall(tls.records(AUTH))
        ping = say(type="ping") + DELIMITER
        while attack.going:
            peer.sendall(tls.records(ping * 300))
            with suppress(BlockingIOError):
                while peer.recv(1 << 18, socket.MSG_DONTWAIT):
                    pass


def cut_off(attack: Attack) -> None:
    """Connections that end with a reset: at once, in the middle of a handshake, and behind it."""
    at_once = struct.pack("ii", 1, 0)
    while attack.going:
        for stage in range(3):
            with suppress(OSError), attack.peer() as peer:
                peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, at_once)
                if stage == 1:
                    peer.sendall(attack.tls().hello())
                if stage == 2:
                    attack.tls().shake(peer)


def drips(attack: Attack) -> None:
    """500 sockets that say a byte a second: every other one of a TLS hello, the rest, behind a handshake, of auth."""
    with ExitStack() as stack:
        drops: list[tuple[socket.socket, Iterator[bytes]]] = []
        for n in range(500):
            with suppress(OSError):
                peer, tls = stack.enter_context(attack.peer()), attack.tls()
                if n % 2:
                    drops.append((peer, iter([bytes([byte]) for byte in tls.hello()])))
                else:
                    tls.shake(peer)
                    drops.append((peer, iter([tls.records(bytes([byte])) for byte in AUTH])))
        while attack.going:
            for peer, drop in drops:
                with suppress(OSError):
                    peer.sendall(next(drop, b""))
            time.sleep(1.0)


def pipelines(attack: Attack) -> None:
    """100 connections that send pings without end, and read what is answered."""
    data = (say(type="ping") + DELIMITER) * 2000
    with ExitStack() as stack, selectors.DefaultSelector() as ready:
        for _ in range(100):
            peer = stack.enter_context(attack.peer())
            peer.sendall(AUTH)
            peer.setblocking(False)
            ready.register(peer, selectors.EVENT_READ | selectors.EVENT_WRITE)
        while attack.going:
            for key, events in ready.select(0.2):
                peer = cast(socket.socket, key.fileobj)
                with suppress(BlockingIOError):
                    if events & selectors.EVENT_READ:
                        peer.recv(1 << 20)
                    if events & selectors.EVENT_WRITE:
                        peer.send(data)


def development(attack: Attack) -> None:
    """A creature of 200 cubes with 1,024 changes of a part's size at once."""
    cubes = [
        {"id": f"c{n}", "size": 0.1, "mass": 1, "position": [0.3 * (n % 16), 0.05, 0.3 * (n // 16)]} for n in range(200)
    ]
    joints = [
        {"id": f"j{n}", "cube1": "c0", "cube2": f"c{n}", "type": "fixed", "anchor": [0, 0.05, 0]} for n in range(1, 200)
    ]
    places = [(1 + (16 * rule + n) % 199, 0.9 if (rule + n) % 2 else 0.95) for rule in range(64) for n in range(16)]
    changes = [{"part": f"c{part}", "scale": scale} for part, scale in places]
    rules = [{"when": "age > 0.5", "resize": changes[16 * rule :][:16]} for rule in range(64)]
    genome = {"format": "nmes-genome/1", "name": "x", "body": {"cubes": cubes, "joints": joints}, "development": rules}
    spawn, drive = say(type="spawn_creature", genome=genome, name="x"), say(type="drive", creature="x", controls=[])
    attack.again(spawn, drive, *[say(type="step")] * 40, say(type="reset"))


def subscribers(attack: Attack) -> None:
    """300 subscribers to 100 cubes that fall, told once a second; and steps."""
    with ExitStack() as stack, selectors.DefaultSelector() as ready:
        many = stack.enter_context(attack.victim())
        for n in range(100):
            many.spawn_cube(position=[3.0 * n, 500.0, 0.0], list=False)
        for _ in range(300):
            peer = stack.enter_context(attack.peer())
            peer.sendall(AUTH + say(type="subscribe", events=["state"], every=60) + DELIMITER)
            peer.setblocking(False)
            ready.register(peer, selectors.EVENT_READ)
        while attack.going:
            many.step()
            for key, _ in ready.select(0.0):
                with suppress(BlockingIOError):
                    cast(socket.socket, key.fileobj).recv(1 << 20)


ATTACKS: dict[str, Callable[[Attack], None]] = {
    "nothing": Attack.wait,
    "200,000 empty cubes": empty_genome,
    "genomes and resets": small_genome,
    "one name 100,000 times": one_name,
    "growth without end": growth,
    "a chain of 256 cubes": chain,
    "names with wildcards": patterns,
    "an objective without a value": nothings,
    "1,200 joints in a row": joints,
    "330,000 empty objects": empty_objects,
    "batches of 10,000": pings,
    "great batches of the raw dialect": translations,
    "batches of 10,000 of the raw dialect": renamings,
    "a step after 3,000 spawns": big_build,
    "300 cubes on one spot": pile,
    "the state of 5,000 cubes": big_state,
    "resets": resets,
    "guesses over 400 connections": guesses,
    "silent sockets": silence,
    "short connections": short_lives,
    "pings over 100 connections": pipelines,
    "1,024 changes of size": development,
    "300 subscribers": subscribers,
}

TLS_ATTACKS: dict[str, Callable[[Attack], None]] = {
    "nothing, over TLS": Attack.wait,
    "half handshakes": half_handshakes,
    "handshakes without end": whole_handshakes,
    "records of one byte": small_records,
    "resets of TLS connections": cut_off,
    "a byte a second": drips,
}


@contextmanager
def under(attack: Attack, act: Callable[[Attack], None]) -> Iterator[None]:
    """Attacks in a thread."""
    mistakes: list[Exception] = []

    def run() -> None:
        while attack.going:  # one that was over begins anew
            try:
                act(attack)
            except (OSError, NmesError):
                time.sleep(0.01)  # a host that hangs up on an attacker is right
            except Exception as error:
                mistakes.append(error)
                return

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield
    finally:
        attack.stop()
        thread.join(10)
    if mistakes:
        raise mistakes[0]  # else it would count as an attack that does no harm


def figures() -> Iterator[Figure]:
    """Measures."""
    for name, act in ATTACKS.items():
        yield _beside(name, act, secure=False)
    for name, act in TLS_ATTACKS.items():
        yield _beside(name, act, secure=True)


def _beside(name: str, act: Callable[[Attack], None], *, secure: bool) -> Figure:
    authority = trustme.CA()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        config, trust = {"limits": {"cubes": 10_000}}, folder / "authority.pem"
        authority.cert_pem.write_to_path(trust)
        port = stack.enter_context(served(folder, config, "victim", "other", authority=authority if secure else None))
        good = stack.enter_context(bystander(port, "other", str(trust) if secure else ""))
        with under(Attack(port, authority), act):
            time.sleep(SECONDS)
            times = good.percentiles()
        return Figure(f"ping beside {name}: p99", times["p99"], "ms", at_most=50.0, details=times)
