"""Floods of what is cheap to send: long frames, frames of a byte, pings of WebSockets."""

from __future__ import annotations

import asyncio
import gc
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import ExitStack, suppress
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.frames import Frame, Opcode

from browsers import socket_to, web_port
from nmes.protocol import DELIMITER, Limits, Request, Session, messages, original
from nmes.server.reception import Reception
from nmes.server.threads import SLICE
from nmes.server.turns import Turns
from nmes.world import World
from servers import PATIENCE, served


def test_a_long_frame_that_was_answered_is_kept_by_nobody() -> None:
    with served() as server, server.peer() as peer:
        gc.disable()  # which finds what keeps itself, but only once there is much of it
        try:
            for number in range(5):
                assert peer.ask({"type": "ping", "id": number, "x": "long" * 10_000})["id"] == number
            kept = [each for each in gc.get_objects() if isinstance(each, Request) and b"longlong" in (each.raw or b"")]
        finally:
            gc.enable()
    assert len(kept) <= 1


def test_frames_of_a_byte_are_read_few_at_a_time() -> None:
    backlog: deque[bytes | Request] = deque([b"{"] * 5000)
    Session().read(backlog, 8 << 10)
    assert 1 <= sum(isinstance(each, Request) for each in backlog) <= 200


def test_a_websocket_of_pings_is_ended_and_one_with_some_is_not() -> None:
    with served() as server, socket_to(web_port(server)) as browser:
        stream = browser.connection.socket
        stream.sendall(Frame(Opcode.PING, b"").serialize(mask=True) * 20)
        assert browser.enter()["type"] == "auth_success"
        assert browser.ask({"type": "ping"}) == {"type": "pong"}
        with suppress(OSError):  # it may be ended while this is sent
            stream.sendall(Frame(Opcode.PING, b"x" * 125).serialize(mask=True) * 5000)
        with pytest.raises(ConnectionClosed):
            browser.hear()


def test_who_reads_no_pongs_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nmes.server.http.PINGS", 1 << 30)
    limits = Limits(stall_timeout=0.5)
    with served(limits=limits) as server, socket.create_connection(("127.0.0.1", web_port(server))) as stream:
        origin = "Host: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        stream.sendall(f"GET /ws HTTP/1.1\r\n{origin}Sec-WebSocket-Key: {'A' * 22}==\r\n\r\n".encode())
        pings, end = Frame(Opcode.PING, b"x" * 125).serialize(mask=True) * 500, time.monotonic() + PATIENCE
        with pytest.raises(OSError):
            while time.monotonic() < end:
                stream.sendall(pings)


def test_long_frames_wait_unread_while_their_world_is_busy(monkeypatch: pytest.MonkeyPatch) -> None:
    began, goes_on, reads = threading.Event(), threading.Event(), list[bytes]()
    tick, read, frame = World.tick, Reception.read, b'{"type":"ping","x":"%b"}' % (b"long" * 10_000)

    def slow(world: World) -> None:
        began.set()
        assert goes_on.wait(PATIENCE)
        tick(world)

    def noted(host: Reception, parse: Callable[[bytes], Request], frame: bytes) -> Future[Request]:
        reads.append(frame)
        return read(host, parse, frame)

    monkeypatch.setattr(World, "tick", slow)
    monkeypatch.setattr(Reception, "read", noted)
    with served() as server, ExitStack() as stack:
        peers = [stack.enter_context(server.peer()) for _ in range(6)]
        peers[0].send(b'{"type":"step","ticks":100}' + DELIMITER)
        assert began.wait(PATIENCE)
        for peer in peers[1:]:
            peer.send(frame + DELIMITER)
        while server.call(lambda: server.host.received) < 5 * len(frame):
            time.sleep(0.01)
        assert reads == []
        goes_on.set()
        assert peers[0].hear()["type"] == "stepped"
        assert [peer.hear() for peer in peers[1:]] == [{"type": "pong", "ignored": ["x"]}] * 5
    assert len(reads) == 5


def test_of_a_great_batch_of_the_raw_dialect_a_thread_translates_what_is_told_otherwise(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    decode, read = messages.decode, list[tuple[str, int]]()

    def noted(message: bytes) -> dict[str, Any]:
        read.append((threading.current_thread().name, len(message)))
        return decode(message)

    monkeypatch.setattr(original, "decode", noted)
    with served() as server, server.peer("raw") as peer:
        for number in range(100):
            peer.send(b'{"type":"spawn_cube","cube_name":"c%d","position":[%d,1,0]}' % (number, 2 * number) + DELIMITER)
        rename = {"type": "set_joint_param", "joint_name": "none", "param_name": "limit_lower", "value": 1}
        states = [{"type": "get_world_state"}] * 50
        answer = peer.ask({"type": "batch", "commands": [rename, *states, rename], "id": 1 << 70})
        assert peer.ask({"type": "ping"}) == {"type": "pong"}
        loop = server.call(lambda: threading.current_thread().name)
    errors = [answer["results"][0], answer["results"][-1]]
    assert [(error["code"], error["command"]) for error in errors] == [("joint_not_found", "set_joint_param")] * 2
    assert answer["id"] == 1 << 70
    assert [len(state["cubes"]) for state in answer["results"][1:-1]] == [100] * 50
    assert len(read) == 2 and max(size for _, size in read) < 500
    assert loop not in {name for name, _ in read}


def test_objectives_about_cubes_that_are_gone_are_forgotten_in_the_end() -> None:
    world = World({"mode": "lockstep", "backend": "ballistic"})
    client = world.join()
    for number in range(200):
        world.execute(client, {"type": "spawn_cube", "cube_name": "c"})
        name = {"name": f"o{number}", "cubes": ["c"]}
        assert world.execute(client, {"type": "set_objective", "expression": "height", **name})["type"] != "error"
        world.execute(client, {"type": "despawn_cube", "cube_name": "c"})
        world.tick()
    asked = [world.execute(client, {"type": "compute_reward", "objective": f"o{number}"}) for number in range(200)]
    codes = [reply["code"] for reply in asked]
    assert codes == ["invalid"] * 184 + ["cube_not_found"] * 16
    assert len(world.snapshot()) < 20_000


@pytest.mark.parametrize("mode", ["lockstep", "fast"])
def test_connections_of_a_world_share_one_slice_of_each_turn_of_the_loop(
    mode: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each command takes two fifths of a slice by the clock that they are measured with: three fit in."""
    now, turns, handle = 0.0, list[list[int]](), World.handle

    def timed(world: World, client: int, request: Request) -> bytes:
        nonlocal now
        now += 0.4 * SLICE
        turns[-1].append(client)
        return handle(world, client, request)

    def turn() -> None:
        turns.append([])
        asyncio.get_running_loop().call_soon(turn)

    with served({"mode": mode}) as server, ExitStack() as stack:
        peers = [stack.enter_context(server.peer()) for _ in range(8)]
        for module in ("connection", "turns"):
            monkeypatch.setattr(f"nmes.server.{module}.monotonic", lambda: now)
        monkeypatch.setattr(World, "handle", timed)
        server.call(turn)

        def say() -> None:
            for peer in peers:
                peer.socket.sendall((b'{"type":"ping"}' + DELIMITER) * 60)

        server.call(say)  # in the thread of the host, so that none is read before all have sent
        for peer in peers:
            assert [peer.hear() for _ in range(60)] == [{"type": "pong"}] * 60
        server.call(monkeypatch.undo)
    assert max(map(len, turns)) == 3
    order = [client for clients in turns for client in clients]
    assert len(order) == 8 * 60
    first, last = (
        max(map(order.index, {*order})),
        min(n for n, _ in enumerate(order) if order[: n + 1].count(order[n]) == 60),
    )
    assert last > first + 200
    for place in range(first, last - 48):  # while all of them have something to do
        assert len({*order[place : place + 48]}) == 8, "one of them is passed over"


async def test_long_frames_of_a_world_are_read_in_turn() -> None:
    class Waiter:
        def __init__(self) -> None:
            self.resumed = 0

        def resume(self) -> None:
            self.resumed += 1

    turns, (one, two, three, four) = Turns(lambda: False), [Waiter() for _ in range(4)]
    assert [turns.begin_reading(each) for each in (one, two, three, four)] == [True, False, False, False]
    turns.end_reading()
    assert not turns.begin_reading(one), "behind those who wait"
    await asyncio.sleep(0)
    assert [each.resumed for each in (one, two, three, four)] == [0, 1, 0, 0]
    turns.forget_reader(two)
    await asyncio.sleep(0)
    assert [each.resumed for each in (one, two, three, four)] == [0, 1, 1, 0]
    assert turns.begin_reading(three)
    turns.forget_reader(four)
    turns.end_reading()
    await asyncio.sleep(0)
    assert turns.begin_reading(one)
