"""A host that faces a network keeps serving whatever arrives.

The host runs in a process of its own, with limits that are met soon. While each thing happens to it, a well-behaved
client goes on; its latency before and meanwhile is among the figures that are printed at the end of a test run. No
figure is a condition, for machines differ: what is asserted is that everybody got what is theirs.

What else belongs here is in `test_server.py`: half-closed sockets that get their last replies, clients that never read
and worlds that tick on, guesses that are answered late, idle clients; and in `test_shutdown.py`: signals under load.
"""

from __future__ import annotations

import hmac
import json
import math
import os
import random
import selectors
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Self

import pytest
from hypothesis import given
from hypothesis import strategies as st

import json_cases
from nmes import protocol
from nmes.protocol import COMMANDS, DELIMITER, Auth, Limits, Session
from nmes.recording import Recording
from nmes.server import Host
from nmes.server.connection import Connection
from nmes.server.hibernation import Hibernation
from nmes.server.hosted_world import HostedWorld
from nmes.server.memory import Memory
from nmes.server.retention import Retention
from servers import PASSWORD, PATIENCE, Peer, served, until

Figures = Callable[[str, object], None]
MIB = 1 << 20

HOST = """
import asyncio, json, logging, resource, signal, sys
from pathlib import Path
from nmes.protocol import Limits
from nmes.server import Host

async def main(password, limits, config, record_to):
    stop = asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, stop.set)
    async with Host(password, limits=Limits(**limits), auth_delay=0.1, record_to=record_to and Path(record_to)) as host:
        host.add({"backend": "ballistic", "mode": "lockstep", **config})
        print((await host.listen("127.0.0.1", 0))[1], flush=True)
        await stop.wait()

logging.basicConfig(level=logging.DEBUG)
hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
resource.setrlimit(resource.RLIMIT_NOFILE, (hard if hard < 0 or hard < 4096 else 4096, hard))
asyncio.run(main(*json.load(sys.stdin)))
"""


class Victim:
    """A host in a process of its own."""

    def __init__(self, process: subprocess.Popen[bytes], port: int, log: Path) -> None:
        self.process = process
        self.port = port
        self._log = log

    def peer(self, authenticate: bool = True, **options: Any) -> Peer:
        peer = Peer(self.port, **options)
        if authenticate:
            assert peer.ask({"type": "auth", "password": PASSWORD})["type"] == "auth_success"
        return peer

    @property
    def log(self) -> str:
        return self._log.read_text()

    @property
    def resident(self) -> int:
        """Its resident memory, bytes; 0 where the system does not tell."""
        statistics = Path(f"/proc/{self.process.pid}/statm")
        return int(statistics.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") if statistics.exists() else 0


@contextmanager
def victim(
    folder: Path, config: dict[str, Any] | None = None, record_to: Path | None = None, **limits: float
) -> Iterator[Victim]:
    """Runs a host; in the end it must stop when told to, without ever having been at a loss."""
    log = folder / "log"
    command = [sys.executable, "-c", HOST]
    with (
        log.open("wb") as out,
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=out) as process,
    ):
        try:
            assert process.stdin and process.stdout
            options = [PASSWORD, limits, config or {}, record_to and str(record_to)]
            process.stdin.write(json.dumps(options).encode())
            process.stdin.close()
            line = process.stdout.readline()
            assert line, log.read_text()
            running = Victim(process, int(line), log)
            yield running
            process.terminate()
            assert process.wait(PATIENCE) == 0, running.log
            assert "Traceback" not in running.log, running.log
            assert PASSWORD not in running.log
        finally:
            process.kill()


class Bystander:
    """A well-behaved client that asks and waits for the answer, again and again."""

    def __init__(self, host: Victim) -> None:
        self._peer = host.peer()
        self._latencies: list[float] = []
        self._before: list[float] = []
        self._stop = threading.Event()
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        try:
            while not self._stop.wait(0.002):
                began = time.perf_counter()
                assert self._peer.ask({"type": "ping"})["type"] == "pong"
                self._latencies.append(time.perf_counter() - began)
        except BaseException as failure:  # told when the test ends
            self._failure = failure

    def _more(self, count: int) -> None:
        enough = len(self._latencies) + count
        until(lambda: len(self._latencies) >= enough or self._failure is not None)
        assert self._failure is None

    def __enter__(self) -> Self:
        self._thread.start()
        self._more(200)
        self._before, self._latencies = self._latencies, []
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None:
                self._more(20)  # it goes on
        finally:
            self._stop.set()
            self._thread.join(PATIENCE)
            self._peer.socket.close()

    @property
    def latency(self) -> str:
        """The 99th percentiles."""
        before, during = (
            sorted(times)[math.ceil(0.99 * len(times)) - 1] * 1000 for times in (self._before, self._latencies)
        )
        return f"{before:.2f} ms before, {during:.2f} ms meanwhile ({len(self._latencies)} pings)"


@pytest.fixture
def figures(record_property: Callable[[str, object], None]) -> Figures:
    """Notes a figure, which is printed at the end of the run."""
    return record_property


@pytest.fixture(autouse=True)
def _room_for_sockets() -> Iterator[None]:
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = 4096 if hard == resource.RLIM_INFINITY else min(4096, hard)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, wanted), hard))
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def _last_words(peers: list[Peer]) -> list[bytes]:
    """Reads what each peer is still sent until it is hung up on."""
    words = dict.fromkeys(peers, b"")
    with selectors.DefaultSelector() as selector:
        for peer in peers:
            selector.register(peer.socket, selectors.EVENT_READ, peer)
        left = len(peers)
        while left:
            ready = selector.select(PATIENCE)
            assert ready, f"{left} connections are still open"
            for key, _ in ready:
                try:
                    data = key.data.socket.recv(1 << 16)
                except ConnectionResetError:
                    data = b""
                words[key.data] += data
                if not data:
                    selector.unregister(key.fileobj)
                    key.data.socket.close()
                    left -= 1
    return list(words.values())


def _codes(words: list[bytes]) -> set[str]:
    return {json.loads(frame)["code"] for word in words for frame in word.split(DELIMITER) if frame}


def test_the_limits_are_those_of_the_protocol() -> None:
    limits = Host(PASSWORD).limits
    assert (limits.auth_frame, limits.auth_timeout) == (16 << 10, 5.0)
    assert (limits.frame, limits.idle_timeout) == (MIB, 300.0)
    assert (limits.pending, limits.stall_timeout, limits.connections) == (8 * MIB, 10.0, 1024)
    assert limits.unauthenticated == 128


# -- connections ------------------------------------------------------------------------------------------------------


def test_a_thousand_connections_are_served_and_one_more_is_refused(tmp_path: Path, figures: Figures) -> None:
    with victim(tmp_path, connections=1001) as host, ExitStack() as stack:
        with Bystander(host) as good:
            before = host.resident
            peers = [stack.enter_context(host.peer()) for _ in range(1000)]
            for n, peer in enumerate(peers):
                peer.say({"type": "ping", "id": n})
            assert [peer.hear()["id"] for peer in peers] == list(range(1000))
            with host.peer(authenticate=False) as one_too_many:
                one_too_many.say({"type": "auth", "password": PASSWORD})
                (answer,) = one_too_many.rest()
                assert json.loads(answer)["code"] == "too_many_connections"
            each = (host.resident - before) / 1000
            assert each < 4 * MIB
        figures("memory of a connection", f"{each / 1024:.1f} KiB")
        figures("p99 latency, 1,000 connections", good.latency)


def test_clients_that_stall_in_auth_are_disconnected(tmp_path: Path, figures: Figures) -> None:
    count, limit = 500, 2.0
    with victim(tmp_path, auth_timeout=limit, unauthenticated=count) as host, Bystander(host) as good:
        began = time.monotonic()
        auth = json.dumps({"type": "auth", "password": PASSWORD}).encode()
        peers = [host.peer(authenticate=False) for _ in range(count)]
        for n, peer in enumerate(peers):
            peer.send([b"", auth[:20], auth + DELIMITER[:-1], PASSWORD.encode()][n % 4])
        slow = peers[::5]
        stop = threading.Event()

        def drip() -> None:  # slow-loris: a byte a second
            for n in range(60):
                for peer in slow:
                    try:
                        peer.socket.send(auth[n : n + 1])
                    except OSError:
                        continue  # it has been hung up on
                if stop.wait(1.0):
                    return

        dripping = threading.Thread(target=drip)
        dripping.start()
        try:
            words = _last_words(peers)
        finally:
            stop.set()
            dripping.join(PATIENCE)
        assert time.monotonic() - began >= limit
        assert _codes(words) == {"auth_timeout"}
        figures(f"{count} stallers closed", f"after {time.monotonic() - began:.2f} s, limit {limit:g} s")
    figures(f"p99 latency, {count} stallers", good.latency)


def test_bytes_that_make_no_command_do_not_keep_a_connection(tmp_path: Path) -> None:
    with victim(tmp_path, idle_timeout=3.0) as host, Bystander(host), host.peer() as peer:
        for _ in range(3000):
            try:
                peer.send(b" ")
            except OSError:
                break
            time.sleep(0.01)
        else:
            raise AssertionError("it was never hung up on")


def test_half_open_connections_are_closed_after_the_idle_limit(tmp_path: Path, figures: Figures) -> None:
    with victim(tmp_path, idle_timeout=4.0, connections=101) as host, ExitStack() as stack:
        with Bystander(host) as good:
            for _ in range(100):  # they say and read nothing more, and never hang up
                stack.enter_context(host.peer())

            def admitted() -> bool:
                with host.peer(authenticate=False) as peer:
                    peer.say({"type": "auth", "password": PASSWORD})
                    return bool(peer.hear()["type"] == "auth_success")

            assert not admitted()
            began = time.monotonic()
            until(admitted)
            figures("half-open peers made room", f"after {time.monotonic() - began:.2f} s, limit 4 s")
        figures("p99 latency, 100 half-open peers", good.latency)


def test_clients_that_never_read_are_cut(tmp_path: Path, figures: Figures) -> None:
    config = {"mode": "fast", "limits": {"cubes": 200}}
    with victim(tmp_path, config, pending=MIB, stall_timeout=1.0) as host, ExitStack() as stack:
        with Bystander(host) as good, host.peer() as watcher:
            watcher.say(*({"type": "spawn_cube", "position": [n, 9e5, 0], "list": False} for n in range(100)))
            assert [watcher.hear()["type"] for _ in range(100)] == ["cube_list"] * 100
            before = most = host.resident
            deaf = [stack.enter_context(host.peer(receive_buffer=64 << 10)) for _ in range(10)]
            for peer in deaf:
                peer.say({"type": "subscribe"})

            def info() -> Any:
                nonlocal most
                most = max(most, host.resident)
                return watcher.ask({"type": "get_world_info"})

            until(lambda: info()["counts"]["clients"] == 2)
            frame = info()["frame"]
            until(lambda: info()["frame"] > frame)
            assert most - before < len(deaf) * 4 * MIB
        figures("memory of a reader that never reads", f"{(most - before) / len(deaf) / MIB:.2f} MiB at most")
        figures("p99 latency, 10 readers that never read", good.latency)


# -- frames -----------------------------------------------------------------------------------------------------------


def test_oversize_and_endless_frames_are_refused(tmp_path: Path, figures: Figures) -> None:
    with victim(tmp_path) as host, Bystander(host) as good:
        growth, warm = [], 0
        for n in range(20):
            if n == 4:  # the first ones warm it up
                warm = host.resident
            before = host.resident
            with host.peer() as peer:
                if n % 2:
                    peer.send(b'{"type":"ping","x":"' + b"x" * (3 * MIB) + b'"}' + DELIMITER)
                else:
                    peer.send(b'{"type":"ping","x":"' + b"x" * (8 * MIB))
                (answer,) = peer.rest()
            assert json.loads(answer)["code"] == "frame_too_large"
            growth.append(host.resident - before)
            with host.peer() as peer:
                assert peer.ask({"type": "ping"})["type"] == "pong"
        assert max(growth[4:]) < 4 * MIB
        # From end to end, when each connection's buffers are free again: keeping frames would hold 16 MiB.
        assert host.resident - warm < 4 * MIB
        figures("memory after 20 oversize frames", f"{(host.resident - warm) / MIB:+.2f} MiB since the fourth")
    figures("p99 latency, oversize frames", good.latency)


def _check_answers(peer: Peer, frames: list[bytes], mark: str) -> list[bytes]:
    """Sends frames and then a ping; returns what came before the pong, each checked to be a proper message."""
    ping = json.dumps({"type": "ping", "id": mark}).encode()
    peer.send(b"".join(frame + DELIMITER for frame in [*frames, b'{"type":"unsubscribe"}', ping]))
    answers: list[bytes] = []
    while True:
        answer = peer.frame()
        message = json.loads(answer)
        if message == {"type": "pong", "id": mark}:
            return answers
        assert b"Traceback" not in answer
        assert message.get("code") != "internal", answer
        if message["type"] in protocol.EVENTS:
            protocol.validate_event(message)
        else:
            protocol.validate_reply(message)
            answers.append(answer)


def test_unusual_json_is_accepted_or_refused_as_the_standard_says(tmp_path: Path) -> None:
    with victim(tmp_path) as host, Bystander(host), host.peer() as peer:
        for name, value in json_cases.VALID.items():
            peer.send(b'{"type":"ping","id":' + value + b"}" + DELIMITER)
            assert peer.hear() == {"type": "pong", "id": json.loads(value)}, name
        for name, value in json_cases.INVALID.items():
            bare, inside, _ = _check_answers(peer, [value, b'{"type":"ping","id":' + value + b"}"], name)
            assert json.loads(bare)["code"] in ("bad_json", "bad_frame"), name
            assert json.loads(inside)["code"] in ("bad_json", "bad_frame"), name
        for name, value in json_cases.EITHER.items():
            assert len(_check_answers(peer, [value, b'{"type":"ping","id":' + value + b"}"], name)) == 3


EXAMPLES = [json.dumps(example).encode() for schema in COMMANDS.values() for example in schema.schema["examples"]]
TOKENS = [
    b'"',
    b"{",
    b"}",
    b"[",
    b"]",
    b",",
    b":",
    b"null",
    b"-",
    b"1e308",
    b"1e-320",
    b"\\u",
    b"\xff",
    b"9" * 20,
    b"\0",
]


def _mutate(draw: random.Random) -> bytes:
    """Returns a frame that is random, or an example of a command that was damaged in a few places."""
    if draw.random() < 0.2:
        return draw.randbytes(draw.randrange(200))
    frame = bytearray(draw.choice(EXAMPLES))
    for _ in range(draw.randrange(4)):
        at = draw.randrange(len(frame) + 1)
        until_ = min(len(frame), at + draw.randrange(12))
        kind = draw.randrange(5)
        if kind == 0:
            del frame[at:until_]
        elif kind == 1:
            frame[at:at] = draw.choice(TOKENS)
        elif kind == 2:
            frame[at:until_] = draw.choice(EXAMPLES)[: draw.randrange(40)]
        elif kind == 3:
            frame[at:at] = frame[at:until_]
        elif at < len(frame):
            frame[at] ^= 1 << draw.randrange(8)
    return bytes(frame).replace(DELIMITER, b"")


@pytest.mark.parametrize("count", [2_000, pytest.param(100_000, marks=pytest.mark.long)])
def test_random_and_mutated_frames_are_answered(tmp_path: Path, figures: Figures, count: int) -> None:
    draw = random.Random(count)
    calm = [b'{"type":"set_mode","mode":"lockstep"}', b'{"type":"reset","seed":1}']
    with victim(tmp_path, {"limits": {"cubes": 100, "joints": 100}}) as host, Bystander(host) as good:
        warm = 0
        with host.peer() as peer:
            peer.ask({"type": "spawn_cube"})  # expressions are loaded when the first one comes: now
            assert peer.ask({"type": "set_objective", "expression": "height"})["type"] == "objective_set"
            for n in range(0, count, 100):
                frames = [_mutate(draw) for _ in range(100)]
                empty = sum(not frame.strip(b" \t\r\n") for frame in frames)
                assert len(_check_answers(peer, [*frames, *calm], f"batch {n}")) == 100 - empty + len(calm) + 1
                if n == count // 10:
                    warm = host.resident
        growth = host.resident - warm
        assert growth < 4 * MIB
        figures(f"memory after {count:,} random frames", f"{growth / MIB:+.2f} MiB since the first tenth")
    figures(f"p99 latency, {count:,} random frames", good.latency)


def test_arbitrary_frames_are_answered() -> None:
    with served() as server, server.peer() as peer:
        values = st.recursive(
            st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
            lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
        )
        keys = st.sampled_from(["cube_name", "position", "force", "size", "value", "id", "commands", "cubes"])
        commands = st.dictionaries(keys, values).flatmap(
            lambda fields: st.sampled_from(sorted(COMMANDS)).map(
                lambda kind: json.dumps({**fields, "type": kind}).encode()
            )
        )

        @given(st.lists(st.binary().map(lambda frame: frame.replace(DELIMITER, b"")) | commands, max_size=5))
        def check(frames: list[bytes]) -> None:
            _check_answers(peer, [*frames, b'{"type":"reset"}', b'{"type":"set_mode","mode":"lockstep"}'], "the end")

        check()


def test_a_flood_of_spawns_stops_at_the_limit_and_despawning_makes_room(tmp_path: Path, figures: Figures) -> None:
    with victim(tmp_path, {"limits": {"cubes": 50}}) as host, Bystander(host) as good:
        with host.peer() as peer:
            peer.say(*[{"type": "spawn_cube", "list": False}] * 5000)
            answers = [peer.hear() for _ in range(5000)]
            assert [answer["type"] for answer in answers[:50]] == ["cube_list"] * 50
            assert {answer.get("code") for answer in answers[50:]} == {"limit_reached"}
            assert peer.ask({"type": "despawn_cube", "cube_name": answers[7]["spawned"]})["type"] == "cube_despawned"
            assert peer.ask({"type": "spawn_cube"})["type"] == "cube_list"
            assert peer.ask({"type": "spawn_cube"})["code"] == "limit_reached"
        with Peer(host.port) as raw:
            raw.send(PASSWORD.encode() + DELIMITER)
            assert raw.frame() == b"auth_success"
            raw.say(*[{"type": "spawn_cube"}] * 5000)
            assert len(raw.ask({"type": "get_cube_list"})["cubes"]) == 50
    figures("p99 latency, 10,000 spawns", good.latency)


# -- the password -----------------------------------------------------------------------------------------------------


def test_no_byte_of_a_password_is_in_any_log_recording_error_or_repr(tmp_path: Path) -> None:
    guess = "a guess at random <battery>"
    replies = b""
    with victim(tmp_path, record_to=tmp_path / "recordings") as host:
        for first in (
            guess.encode(),
            json.dumps({"type": "auth", "password": guess}).encode(),
            json.dumps({"type": "auth", "password": guess + PASSWORD, "world": 3}).encode(),
            json.dumps({"type": "auth", "password": [PASSWORD, guess]}).encode(),
            json.dumps({"type": "auth", "password": PASSWORD, "world": "nowhere"}).encode(),
            json.dumps({"type": "login", "password": PASSWORD}).encode(),
            b'{"type":"auth","password":"' + PASSWORD.encode() + b'","x":"' + guess.encode() + b'"',
            b'{"type":"auth","' + PASSWORD.encode() + b'":1,"' + PASSWORD.encode() + b'":2}',
        ):
            with host.peer(authenticate=False) as peer:
                peer.send(first + DELIMITER)
                replies += b"".join(peer.rest())
        with host.peer() as peer:
            peer.ask({"type": "spawn_cube"})
    recordings = b"".join(path.read_bytes() for path in (tmp_path / "recordings").iterdir())
    records = b"".join(record.data for path in (tmp_path / "recordings").iterdir() for record in Recording(path))
    log = (tmp_path / "log").read_bytes()
    assert b"failed to authenticate" in log and b"auth_failed" in replies
    for secret in (PASSWORD, guess):
        for place in (replies, recordings, records, log):
            assert secret.encode() not in place
            assert secret.split()[-1].encode() not in place  # nor a part of it
    host_here = Host(PASSWORD)
    for thing in (host_here, vars(host_here), Auth("raw", PASSWORD), Session()):
        assert PASSWORD not in repr(thing)


@pytest.mark.parametrize("guess", ["", "x", PASSWORD[:-1], PASSWORD, "x" * 10_000])
def test_passwords_are_compared_in_constant_time(guess: str, monkeypatch: pytest.MonkeyPatch) -> None:
    lengths = []
    compare = hmac.compare_digest

    def note(one: bytes, other: bytes) -> bool:
        lengths.append((len(one), len(other)))
        return compare(one, other)

    host = Host(PASSWORD)
    monkeypatch.setattr("hmac.compare_digest", note)
    assert host.keys.accepts(guess) == (guess == PASSWORD)
    assert lengths == [(64, 64)]  # digests, so that neither length nor beginning of the password makes a difference


@pytest.mark.parametrize(("owner", "method"), [(Memory, "tidy"), (Retention, "sweep")])
def test_what_a_host_does_now_and_then_goes_on_after_it_failed(
    owner: type, method: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    work, called = getattr(owner, method), 0

    def fail_once(*arguments: Any, **options: Any) -> Any:
        nonlocal called
        called += 1
        if called == 1:
            raise ValueError("planted")
        return work(*arguments, **options)

    monkeypatch.setattr(owner, method, fail_once)
    monkeypatch.setattr("nmes.server.host.SWEEP", 0.01)
    with served(record_to=tmp_path, hibernate_after=0.01, retention=Retention(tmp_path, 1, None)):
        until(lambda: called >= 3)
    assert "ValueError: planted" in caplog.text and caplog.text.count("tries again") == 1


@pytest.mark.parametrize(("owner", "method"), [(Connection, "inspect"), (HostedWorld, "flush"), (Hibernation, "begin")])
def test_one_that_fails_each_time_keeps_a_host_from_none_of_the_others(
    owner: type, method: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    work, seen = getattr(owner, method), dict[object, None]()

    def fail_for_the_first(each: object, *arguments: Any) -> Any:
        if isinstance(each, Connection) and each._world is None:  # who is cut off must have come in
            return work(each, *arguments)
        seen[each] = None
        if each is next(iter(seen)):
            raise ValueError("planted")
        return work(each, *arguments)

    monkeypatch.setattr(owner, method, fail_for_the_first)
    configs = [{"name": name} for name in ("red", "green", "blue")]
    paced = {"name": "paced", "mode": "realtime"}  # beside which worlds are put to sleep one by one
    options: dict[str, Any] = {"flush_interval": 0.02, "limits": Limits(stall_timeout=0.04), "hibernate_after": 0.01}
    with served(*configs, paced, record_to=tmp_path, **options) as server, ExitStack() as peers:
        for _ in range(4):
            peers.enter_context(server.peer())
        until(lambda: len(seen) >= 4)
        if owner is Connection:
            until(lambda: server.clients() == 3)  # that one is cut off
    assert "ValueError: planted" in caplog.text and "tries again" not in caplog.text
