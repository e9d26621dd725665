"""What JSON costs: the same decisions in the same world by JSON over TCP, MessagePack over TCP, and shared memory.

Hides three channels between two processes. One of them has the world and does what comes: a push on one cube, a tick,
and the state of all cubes back. Over TCP these are the protocol's own messages, judged by its schemas, in either
encoding; frames end as the protocol has it, or begin with their length. In shared memory they are numbers at fixed
places, and both sides look until there is something new.
"""

from __future__ import annotations

import os
import socket
import statistics
import struct
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory
from types import ModuleType
from typing import Any, Final

import numpy as np

from nmes import protocol
from nmes.backend import Array
from nmes.errors import MissingPackage
from nmes.evaluation.processes import start_process
from nmes.measure.turns import in_turns
from nmes.protocol import COMMANDS, DELIMITER, Request
from nmes.schemas.documents import JsonObject, canonical_hash
from nmes.variation.draw import Draw
from nmes.world import World

__all__ = ["CHANNELS", "EncodingCosts", "measure_encodings"]

CHANNELS: Final = ("json", "msgpack", "shared")
_TRIPS: Final = 100  # decisions in a round
_STATE: Final = 13  # numbers of a cube: position, quaternion, linear and angular velocity
_APART: Final = 3.0  # m between cubes
_PUSH: Final = 4.0  # N at most
_SIZE: Final = struct.Struct("<I")  # of what comes, before a frame of MessagePack
_TICK: Final = 1.0 / 60.0  # s
_GLANCES: Final = 1 << 16  # at the memory, before it is seen to whether anybody is there

Force = tuple[float, float, float]
Observed = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class EncodingCosts:
    """What a decision takes.

    Attributes:
        cubes: How many cubes are observed.
        microseconds: Of a decision by channel, the median of all rounds: `json`, `msgpack`, `shared`.
        over_msgpack: The time by JSON over that by MessagePack, the median of the ratios of the same round.
        over_shared: The time by JSON over that in shared memory.
        of_tick: By how much JSON takes longer than shared memory, as a part of a 60th of a second.
        bytes: Of the answers to one decision by JSON.
        alike: Whether all channels gave the same states, at the end of each round.
        digest: Of these states.
    """

    cubes: int
    microseconds: dict[str, float]
    over_msgpack: float
    over_shared: float
    of_tick: float
    bytes: int
    alike: bool
    digest: str


def measure_encodings(cubes: int, seed: int, rounds: int) -> EncodingCosts:
    """Measures what a decision takes by each channel.

    Args:
        cubes: How many there are in the world, all of which are observed.
        seed: Of the pushes.
        rounds: How often each channel is measured, for a hundred decisions each.

    Raises:
        MissingPackage: msgpack is not installed.
    """
    _msgpack()
    with ExitStack() as stack:
        callers = {
            "json": stack.enter_context(_over_tcp(cubes, "json")),
            "msgpack": stack.enter_context(_over_tcp(cubes, "msgpack")),
            "shared": stack.enter_context(_in_shared_memory(cubes)),
        }
        draws = {name: Draw(seed, "encodings") for name in CHANNELS}
        seen: dict[str, list[Observed]] = {name: [] for name in CHANNELS}

        def seconds(name: str) -> float:
            draw, call = draws[name], callers[name].decide
            forces = [(draw.uniform(-_PUSH, _PUSH), 0.0, draw.uniform(-_PUSH, _PUSH)) for _ in range(_TRIPS)]
            began = time.perf_counter()
            for force in forces:
                states = call(force)
            took = (time.perf_counter() - began) / _TRIPS
            seen[name].append(states)
            return took

        samples = in_turns({name: partial(seconds, name) for name in CHANNELS}, rounds)
        size = callers["json"].size
    pairs = list(zip(samples["json"], samples["msgpack"], samples["shared"], strict=True))
    middle = {name: 1e6 * statistics.median(times) for name, times in samples.items()}
    return EncodingCosts(
        cubes,
        middle,
        statistics.median(json / msgpack for json, msgpack, _ in pairs),
        statistics.median(json / shared for json, _, shared in pairs),
        statistics.median((json - shared) / _TICK for json, _, shared in pairs),
        size,
        seen["json"] == seen["msgpack"] == seen["shared"],
        canonical_hash({"seen": [list(each) for each in seen["json"]]})[:32],
    )


class _Caller:
    """The side that decides.

    Attributes:
        decide: Pushes the first cube, ticks, and returns the states of all cubes, 13 numbers each.
        size: Bytes of the last answers.
    """

    def __init__(self) -> None:
        self.decide: Callable[[Force], Observed]
        self.size = 0


# -- the world --------------------------------------------------------------------------------------------------------


class _Place(World):
    """A world whose cubes stand in a row, and which answers requests that are read already."""

    def __init__(self, cubes: int) -> None:
        super().__init__({"mode": "lockstep"})
        self.me = self.join()
        for number in range(cubes):
            place = [_APART * number, 0.5, 0.0]
            self.execute(self.me, {"type": "spawn_cube", "cube_name": f"c{number}", "position": place, "list": False})
        self.execute(self.me, {"type": "step", "ticks": 30})

    def reply(self, request: Request) -> JsonObject:
        """Answers a request with a plain object."""
        return self.answer(self._clients[self.me], request)


def _commands(force: Force) -> list[JsonObject]:
    push = {"type": "apply_physics", "cube_name": "c0", "force": force}
    return [push, {"type": "step"}, {"type": "get_world_state"}]


def _flat(state: Mapping[str, Any]) -> Observed:
    """Returns the numbers of a reply `world_state`."""
    names = ("position", "quaternion", "linear_velocity", "angular_velocity")
    return tuple(float(number) for cube in state["cubes"] for name in names for number in cube[name])


# -- over TCP ---------------------------------------------------------------------------------------------------------


@contextmanager
def _over_tcp(cubes: int, encoding: str) -> Iterator[_Caller]:
    with socket.socket() as line, _other(_serve_tcp, cubes, encoding) as pipe:  # which is ended before its line closes
        line.connect(("127.0.0.1", pipe.recv()))
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        channel, caller = _CHANNELS[encoding](line), _Caller()

        def decide(force: Force) -> Observed:
            channel.send([channel.write(command) for command in _commands(force)])
            answers = channel.receive(3)
            caller.size = sum(map(len, answers))
            return _flat(channel.read(answers[2]))

        caller.decide = decide
        yield caller


def _serve_tcp(pipe: Connection, cubes: int, encoding: str) -> None:
    """Does what comes over TCP until nobody is there; what comes together is answered together."""
    world = _Place(cubes)
    with socket.create_server(("127.0.0.1", 0)) as server:
        pipe.send(server.getsockname()[1])
        line, _ = server.accept()
    line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    with line, suppress(ConnectionError):  # to whoever was killed
        channel = _CHANNELS[encoding](line)
        while requests := channel.receive(3):
            channel.send([channel.write(world.reply(channel.request(each))) for each in requests])


class _Json:
    """Messages as the protocol has them."""

    write = staticmethod(protocol.encode)
    read = staticmethod(protocol.decode)
    request = staticmethod(protocol.parse)

    def __init__(self, line: socket.socket) -> None:
        self._line, self._left = line, b""

    def send(self, messages: Sequence[bytes]) -> None:
        """Sends messages in one write."""
        self._line.sendall(DELIMITER.join([*messages, b""]))

    def receive(self, count: int) -> list[bytes]:
        """Returns so many messages; none where the other side has gone."""
        while self._left.count(DELIMITER) < count:
            if not (data := self._line.recv(1 << 18)):
                return []
            self._left += data
        *messages, self._left = self._left.split(DELIMITER, count)
        return messages


class _MessagePack:
    """The same messages in MessagePack, each behind its length."""

    def __init__(self, line: socket.socket) -> None:
        self._line, self._left, msgpack = line, b"", _msgpack()
        self.write: Callable[[Any], bytes] = msgpack.Packer().pack
        self.read: Callable[[bytes], Any] = msgpack.unpackb

    def request(self, data: bytes) -> Request:
        """Reads a command, and judges it by its schema."""
        command = self.read(data)
        if not COMMANDS[command["type"]].validator.is_valid(command):
            raise ValueError(f"it is no command: {command}")
        return Request(data, command, None, command["type"])

    def send(self, messages: Sequence[bytes]) -> None:
        """Sends messages in one write."""
        self._line.sendall(b"".join(_SIZE.pack(len(message)) + message for message in messages))

    def receive(self, count: int) -> list[bytes]:
        """Returns so many messages; none where the other side has gone."""
        messages: list[bytes] = []
        while len(messages) < count:
            size = _SIZE.unpack_from(self._left)[0] if len(self._left) >= _SIZE.size else None
            if size is not None and len(self._left) >= _SIZE.size + size:
                messages.append(self._left[_SIZE.size : _SIZE.size + size])
                self._left = self._left[_SIZE.size + size :]
            elif data := self._line.recv(1 << 18):
                self._left += data
            else:
                return []
        return messages


_CHANNELS: Final[Mapping[str, type[_Json] | type[_MessagePack]]] = {"json": _Json, "msgpack": _MessagePack}


def _msgpack() -> ModuleType:
    try:
        import msgpack
    except ImportError as error:
        raise MissingPackage("to compare encodings takes msgpack: pip install 'nmes[bench]'") from error
    found: ModuleType = msgpack
    return found


# -- in shared memory -------------------------------------------------------------------------------------------------


class _Memory:
    """Numbers at fixed places: how many requests and answers there were, a force, and the states of all cubes."""

    def __init__(self, memory: SharedMemory, cubes: int) -> None:
        self.counts: np.ndarray[Any, np.dtype[np.int64]] = np.ndarray(2, np.int64, memory.buf)
        self.force: Array = np.ndarray(3, np.float64, memory.buf, 16)
        self.states: Array = np.ndarray(_STATE * cubes, np.float64, memory.buf, 40)

    def release(self) -> None:
        """Lets go of the memory, which cannot be closed before; a frame that was interrupted may still know of this."""
        del self.counts, self.force, self.states

    @staticmethod
    def size(cubes: int) -> int:
        """Returns how many bytes it takes."""
        return 40 + 8 * _STATE * cubes


@contextmanager
def _in_shared_memory(cubes: int) -> Iterator[_Caller]:
    memory = SharedMemory(create=True, size=_Memory.size(cubes))
    shared = _Memory(memory, cubes)
    try:
        with _other(_serve_memory, cubes, memory.name) as pipe:
            pipe.recv()
            caller = _Caller()

            def decide(force: Force) -> Observed:
                shared.force[:] = force
                shared.counts[0] += 1
                while shared.counts[1] != shared.counts[0]:
                    os.sched_yield()
                return tuple(shared.states.tolist())

            caller.decide = decide
            yield caller
    finally:
        shared.release()
        memory.close()
        memory.unlink()


def _serve_memory(pipe: Connection, cubes: int, name: str) -> None:
    """Does what comes through shared memory until nobody is there."""
    world, memory = _Place(cubes), SharedMemory(name)
    shared = _Memory(memory, cubes)
    pipe.send(True)
    done, looked = 0, 0
    while True:
        while (asked := int(shared.counts[0])) == done:
            os.sched_yield()
            looked += 1
            if looked % _GLANCES == 0 and pipe.poll():  # it has ended: whoever measures was killed
                return
        command = {"type": "apply_physics", "cube_name": "c0", "force": shared.force.tolist()}
        world.reply(Request(b"", command, None, command["type"]))
        world.tick()
        shared.states[:] = world.poses()[1].ravel()
        done = asked
        shared.counts[1] = done


@contextmanager
def _other(serve: Callable[..., None], *arguments: Any) -> Iterator[Connection]:
    """Runs a function in a process of its own, with a pipe to it; the process ignores Ctrl-C, and is ended."""
    process, pipe = start_process(serve, *arguments)
    try:
        yield pipe
    finally:
        process.kill()  # it has nothing to end in good order
        process.join()
        pipe.close()
