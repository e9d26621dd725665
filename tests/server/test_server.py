from __future__ import annotations

import asyncio
import json
import socket
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import pytest

import nmes.server.connection
from nmes import protocol
from nmes.errors import NmesError, WorldError
from nmes.protocol import DELIMITER, Limits
from nmes.server import Host
from nmes.server.door import Door
from servers import PASSWORD, PATIENCE, Peer, Served, served, types, until

PING = json.dumps({"type": "ping"}).encode() + DELIMITER


@pytest.fixture
def server() -> Iterator[Served]:
    with served() as running:
        yield running


# -- authentication ---------------------------------------------------------------------------------------------------


def test_the_json_dialect_answers_auth_with_a_welcome(server: Served) -> None:
    with server.peer(None) as peer:
        welcome = peer.ask({"type": "auth", "password": PASSWORD, "id": [1, None]})
        protocol.validate_reply(welcome)
        assert welcome["world"] == "main"
        assert welcome["backend"] == "ballistic"
        assert welcome["id"] == [1, None]
        assert peer.ask({"type": "ping", "id": 7}) == {"type": "pong", "id": 7}


def test_the_raw_dialect_is_silent_after_most_commands(server: Served) -> None:
    with server.peer("raw") as peer:
        peer.say(
            {"type": "spawn_cube", "cube_name": "a"},
            {"type": "spawn_cube", "cube_name": "a"},  # fails, as do the next
            {"type": "despawn_cube", "cube_name": "nobody"},
            {"type": "apply_force", "force": [1, 0, 0]},
            {"type": "apply_physics", "cube_name": "nobody"},
            {"type": "freeze_cube", "cube_name": "a"},
            {"type": "get_cube_list"},
            {"type": "no_such_command"},
        )
        assert peer.hear() == {"type": "cube_list", "cubes": ["a"]}
        assert peer.hear()["code"] == "unknown_type"


@pytest.mark.parametrize("dialect", ["json", "raw"])
def test_a_wrong_password_is_answered_late_and_closed(dialect: str) -> None:
    with served(auth_delay=0.3) as server, server.peer(None) as peer:
        began = time.monotonic()
        if dialect == "json":
            peer.say({"type": "auth", "password": "guess", "id": 1})
            (answer,) = peer.rest()
            assert json.loads(answer)["code"] == "auth_failed"
            assert json.loads(answer)["id"] == 1
        else:
            peer.send(b"guess" + DELIMITER)
            assert peer.rest() == [b"auth_failed"]
        assert time.monotonic() - began >= 0.3


async def test_by_default_a_wrong_password_is_answered_after_a_second() -> None:
    async with Host("x") as host:
        host.add({"backend": "ballistic"})
        address = await host.listen("127.0.0.1", 0)
        waits = {}
        for password in ("guess", "x"):
            reader, writer = await asyncio.open_connection(*address)
            began = time.monotonic()
            writer.write(json.dumps({"type": "auth", "password": password}).encode() + DELIMITER)
            answer = await asyncio.wait_for(reader.readuntil(DELIMITER), PATIENCE)
            waits[json.loads(answer.removesuffix(DELIMITER))["type"]] = time.monotonic() - began
            writer.close()
            await writer.wait_closed()
    assert waits.keys() == {"error", "auth_success"} and waits["error"] >= 1.0


async def test_a_host_has_the_limits_of_the_protocol_by_default() -> None:
    async with Host("x") as host:
        assert host.limits == Limits()


@pytest.mark.parametrize(
    ("first", "code"),
    [
        (b'{"type":"spawn_cube"}', "auth_failed"),
        (b'{"type":"auth"}', "invalid"),
        (b'{"type":"auth","password":"x",}', "bad_json"),
    ],
)
def test_a_first_frame_that_is_no_auth_is_refused(server: Served, first: bytes, code: str) -> None:
    with server.peer(None) as peer:
        peer.send(first + DELIMITER + b'{"type":"spawn_cube"}' + DELIMITER)
        (answer,) = peer.rest()
        assert json.loads(answer)["code"] == code
    assert server.call(server.hosted.world.cubes) == []


def test_a_half_closed_guess_is_answered() -> None:
    with served(auth_delay=0.2) as server, server.peer(None) as peer:
        peer.send(b"guess" + DELIMITER)
        peer.hang_up()
        assert peer.rest() == [b"auth_failed"]


@pytest.mark.parametrize("beginning", [b"", b'{"type":"auth"', PASSWORD.encode()])
def test_auth_must_come_in_time(beginning: bytes) -> None:
    with served(limits=Limits(auth_timeout=0.2)) as server, server.peer(None) as peer:
        peer.send(beginning)
        (answer,) = peer.rest()
        assert json.loads(answer)["code"] == "auth_timeout"


def test_a_client_may_name_its_world() -> None:
    with served({"name": "one"}, {"name": "two"}) as server:
        with server.client() as one, server.client(world="two") as two:
            assert one.welcome["world"] == "one"
            assert two.welcome["world"] == "two"
            one.spawn_cube("a")
            assert two.get_cube_list()["cubes"] == []
        with server.peer(None) as peer:
            peer.say({"type": "auth", "password": PASSWORD, "world": "three"})
            (answer,) = peer.rest()
            assert json.loads(answer)["code"] == "world_not_found"


async def test_what_is_sent_does_not_wait_until_what_was_sent_before_is_acknowledged() -> None:
    held_up: asyncio.Future[bool] = asyncio.get_running_loop().create_future()

    class Came(asyncio.Protocol):
        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            held_up.set_result(
                not transport.get_extra_info("socket").getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
            )

    door = Door(4, None, 5.0, 2.0)
    _, port = await door.listen("127.0.0.1", 0, Came)
    with socket.create_connection(("127.0.0.1", port)):
        assert not await held_up
    await door.close()


def test_commands_right_behind_the_password_are_executed(server: Served) -> None:
    with server.peer(None) as peer:
        auth = json.dumps({"type": "auth", "password": PASSWORD}).encode()
        peer.send(auth + DELIMITER + PING * 3)
        assert [peer.hear()["type"] for _ in range(4)] == ["auth_success", "pong", "pong", "pong"]


# -- framing ----------------------------------------------------------------------------------------------------------


def test_a_thousand_messages_in_one_write_are_answered(server: Served) -> None:
    with server.peer() as peer:
        peer.say(*({"type": "ping", "id": n} for n in range(1000)))
        assert [peer.hear()["id"] for _ in range(1000)] == list(range(1000))


def test_messages_may_come_byte_by_byte(server: Served) -> None:
    with server.peer(None) as peer:
        for byte in PASSWORD.encode() + DELIMITER:
            peer.send(bytes([byte]))
        assert peer.frame() == b"auth_success"
        for cut in range(1, len(DELIMITER)):
            whole = json.dumps({"type": "ping", "id": cut}).encode() + DELIMITER
            peer.send(whole[: cut - len(DELIMITER)])
            peer.send(whole[cut - len(DELIMITER) :])
            assert peer.hear()["id"] == cut


def test_invalid_messages_are_refused_and_change_nothing(server: Served) -> None:
    with server.peer() as peer:
        for frame, code in [
            (b"[1]", "bad_frame"),
            (b'"\xff"', "bad_frame"),
            (b'{"type":"ping","x":NaN}', "bad_json"),
            (b'{"type":"spawn_cube","mass":1e400}', "bad_json"),
            (b'{"type":"ping","type":"ping"}', "bad_json"),
            (b'{"type":"fly"}', "unknown_type"),
            (b'{"type":"spawn_cube","mass":"heavy"}', "invalid"),
        ]:
            peer.send(frame + DELIMITER)
            reply = peer.hear()
            protocol.validate_reply(reply)
            assert reply["code"] == code, frame
        assert peer.ask({"type": "get_cube_list"})["cubes"] == []


def test_an_oversize_frame_ends_the_connection_after_the_frames_before_it(server: Served) -> None:
    with server.peer() as peer:
        peer.send(PING + b"x" * (32 << 20))  # goes on long after the server has given up, and is not reset
        first, last = peer.rest()
        assert json.loads(first)["type"] == "pong"
        assert json.loads(last)["code"] == "frame_too_large"
    with server.peer(None) as peer:
        peer.send(b"x" * (17 << 10))
        (answer,) = peer.rest()
        assert json.loads(answer)["code"] == "frame_too_large"


# -- the end of a connection ------------------------------------------------------------------------------------------


def test_a_half_closed_socket_gets_its_last_replies(server: Served) -> None:
    with server.peer() as peer:
        peer.say(*[{"type": "step", "ticks": 10}] * 1000)
        peer.hang_up()
        assert types(peer.rest()) == ["stepped"] * 1000


def test_commands_of_a_client_that_leaves_at_once_are_executed(server: Served) -> None:
    with server.peer("raw") as peer:
        peer.say(*({"type": "spawn_cube"} for _ in range(1000)))
    until(lambda: len(server.call(server.hosted.world.cubes)) == 1000)


def test_commands_of_a_client_that_is_gone_before_its_replies_are_executed(server: Served) -> None:
    with server.peer() as peer:
        peer.say(*[{"type": "step", "ticks": 1000}] * 300)
        until(lambda: server.call(lambda: server.hosted.world.frame) > 0)
    until(lambda: server.call(lambda: server.hosted.world.frame) == 300 * 1000)
    until(lambda: server.clients() == 0)


def test_an_idle_client_is_closed_and_a_ping_keeps_one_open() -> None:
    with (
        served(limits=Limits(idle_timeout=1.0)) as server,
        server.peer() as idle,
        server.peer() as lively,
        server.peer("raw") as quiet,
    ):
        began = time.monotonic()
        while time.monotonic() < began + 1.5:
            quiet.say({"type": "apply_force", "force": [0, 0, 0]})  # unanswered, but a sign of life
            assert lively.ask({"type": "ping"})["type"] == "pong"
        assert quiet.ask({"type": "ping"})["type"] == "pong"
        assert idle.rest() == []
        assert time.monotonic() - began >= 1.0


def test_a_client_that_does_not_close_its_side_is_disconnected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nmes.server.connection, "LINGER", 0.1)
    with served() as server, server.peer(None) as peer:
        peer.send(b"guess" + DELIMITER)
        assert peer.frame() == b"auth_failed"
        until(lambda: server.call(lambda: server.host.connections) == 0)


def test_a_connection_over_the_limit_is_refused() -> None:
    with served(limits=Limits(connections=2)) as server:
        with server.peer(), server.peer("raw"), server.peer(None) as third:
            third.say({"type": "auth", "password": PASSWORD})
            (answer,) = third.rest()
            assert json.loads(answer)["code"] == "too_many_connections"
        until(lambda: _can_connect(server))


def _can_connect(server: Served) -> bool:
    with server.peer(None) as peer:
        peer.say({"type": "auth", "password": PASSWORD})
        return bool(peer.hear()["type"] == "auth_success")


def _never_reads(server: Served, *messages: dict[str, Any]) -> Peer:
    peer = server.peer(receive_buffer=256 << 10)
    peer.say(*messages)
    return peer


def test_a_subscriber_that_never_reads_is_cut_and_its_world_ticks_on() -> None:
    with (
        served({"mode": "fast"}, limits=Limits(pending=64 << 10, stall_timeout=1000)) as server,
        server.client() as good,
    ):
        with good.pipeline() as many:
            for n in range(50):
                many.spawn_cube(position=[0, 1000 + n, 0], linear_velocity=[1, 0, 0], list=False)
        with _never_reads(server, {"type": "subscribe"}) as peer:
            until(lambda: server.clients() == 1)
            frame = good.get_world_info()["frame"]
            until(lambda: good.get_world_info()["frame"] > frame)
            # When it reads at last, what was kept for it comes, and then the reason, unless it took too long.
            frames = peer.rest()
            assert set(types(frames[:-1])) <= {"tick", "state", "subscribed"}
            assert json.loads(frames[-1])["code"] == "slow_consumer"


def test_a_client_that_never_reads_its_replies_is_cut() -> None:
    with served(limits=Limits(pending=64 << 10, stall_timeout=0.3)) as server, server.client() as good:
        with good.pipeline() as many:
            for _ in range(100):
                many.spawn_cube(list=False)
        flood = [{"type": "get_world_state"}] * 4000  # a hundred megabytes of replies
        with _never_reads(server, *flood):
            until(lambda: server.clients() == 1)
            assert good.ping()["type"] == "pong"


def test_commands_of_a_client_that_does_not_read_wait_until_it_does() -> None:
    with served(limits=Limits(pending=64 << 10, stall_timeout=1000)) as server, server.client() as good:
        with good.pipeline() as many:
            for _ in range(100):
                many.spawn_cube(list=False)
        with _never_reads(server, *[{"type": "step"}, {"type": "get_world_state"}] * 500) as peer:
            frames = [-2, -1]
            while frames[-2] != frames[-1]:
                time.sleep(0.2)
                frames.append(good.get_world_info()["frame"])
            assert frames[-1] < 500
            assert [peer.hear()["frame"] for _ in range(1000)][-1] == 500


def test_a_client_that_reads_gets_all_replies_however_much_they_are() -> None:
    with served(limits=Limits(pending=64 << 10)) as server, server.client() as client:
        with client.pipeline() as many:
            for _ in range(50):
                many.spawn_cube(list=False)
        with client.pipeline() as many:
            for _ in range(1000):
                many.get_world_state()
        assert {len(call.result()["cubes"]) for call in many.calls} == {50}


def test_an_exception_in_the_server_ends_one_connection_only(server: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    with server.peer() as peer, server.client() as good:
        good.ping()
        with monkeypatch.context() as broken:
            broken.setattr(protocol.Session, "reply", lambda *_: 1 / 0)
            peer.say({"type": "ping"})
            (answer,) = peer.rest()
        assert json.loads(answer)["code"] == "internal"
        assert b"ZeroDivision" not in answer
        assert good.ping()["type"] == "pong"


# -- worlds -----------------------------------------------------------------------------------------------------------


def test_clients_share_a_world_and_their_cubes_outlive_them(server: Served) -> None:
    with server.client() as one, server.client() as two:
        one.spawn_cube("a")
        two.spawn_cube("b")
        assert one.get_cube_list()["cubes"] == two.get_cube_list()["cubes"] == ["a", "b"]
        one.apply_force(force=[1, 0, 0])  # each acts on its own
        two.step()
        assert two.get_cube_state("a")["linear_velocity"][0] > 0.0
        assert two.get_cube_state()["linear_velocity"][0] == 0.0
        one.close()
        until(lambda: two.get_world_info()["counts"]["clients"] == 1)
        assert two.get_cube_list()["cubes"] == ["a", "b"]


def test_events_come_after_subscribe_only_and_before_the_reply_to_what_caused_them(server: Served) -> None:
    with server.peer() as peer, server.peer() as other:
        assert peer.ask({"type": "step"})["type"] == "stepped"
        assert peer.ask({"type": "subscribe", "events": ["tick"]})["type"] == "subscribed"
        peer.say({"type": "step", "ticks": 2})
        assert [peer.hear()["type"] for _ in range(3)] == ["tick", "tick", "stepped"]
        assert other.ask({"type": "step"})["frame"] == 4
        assert peer.hear() == {"type": "tick", "t": 4 / 60, "frame": 4}
        assert peer.ask({"type": "unsubscribe"})["type"] == "unsubscribed"
        assert other.ask({"type": "step"})["frame"] == 5
        assert peer.ask({"type": "ping"})["type"] == "pong"


def test_the_raw_dialect_may_subscribe_too(server: Served) -> None:
    with server.peer("raw") as peer:
        assert peer.ask({"type": "subscribe", "events": ["tick"]})["type"] == "subscribed"
        peer.say({"type": "step"})
        assert [peer.hear()["type"] for _ in range(2)] == ["tick", "stepped"]


def test_set_mode_changes_how_a_world_ticks() -> None:
    with served() as server, server.client() as client:

        def frame() -> int:
            return client.get_world_info()["frame"]

        assert frame() == frame() == 0
        client.set_mode("realtime", rate=50)
        until(lambda: frame() > 300)
        at = client.pause()["frame"]
        assert frame() == at
        assert client.step(3)["frame"] == at + 3
        client.resume()
        until(lambda: frame() > at + 100)
        assert client.reset()["frame"] == 0
        until(lambda: frame() > 10)
        client.set_mode("fast")
        until(lambda: frame() > 10_000)
        client.set_mode("lockstep")
        assert frame() == frame()


def test_realtime_keeps_to_the_clock() -> None:
    with served({"mode": "realtime", "tick_rate": 1000}) as server, server.client() as client:
        began, first = time.monotonic(), client.get_world_info()["frame"]
        until(lambda: client.get_world_info()["frame"] > first + 500)
        last = client.get_world_info()["frame"]
        # At most what the clock allows, and what the world may have been behind before.
        assert last - first <= (time.monotonic() - began + 0.25) * 1000 + 1


def test_a_reset_world_does_not_catch_up() -> None:
    with served({"mode": "realtime", "tick_rate": 1000}) as server, server.client() as client:
        until(lambda: client.get_world_info()["frame"] > 300)
        began = time.monotonic()
        client.reset()
        until(lambda: client.get_world_info()["frame"] > 10)
        last = client.get_world_info()["frame"]
        assert last <= (time.monotonic() - began) * 1000 + 1


def test_a_world_that_fell_far_behind_skips_the_lost_time() -> None:
    with served({"mode": "realtime", "tick_rate": 1000}) as server, server.client() as client:
        until(lambda: client.get_world_info()["frame"] > 10)
        began, first = time.monotonic(), client.get_world_info()["frame"]
        server.call(lambda: time.sleep(1.5))
        until(lambda: client.get_world_info()["frame"] > first + 100)
        last = client.get_world_info()["frame"]
        assert last - first <= (time.monotonic() - began - 1.5 + 2 * 0.25) * 1000 + 1


def test_a_flood_of_commands_does_not_delay_other_clients(server: Served) -> None:
    ticks = 300 * 200
    with server.peer() as flood, server.client() as good:
        flood.say(*[{"type": "step", "ticks": 200}] * 300)
        until(lambda: good.get_world_info()["frame"] > 0)
        assert good.get_world_info()["frame"] < ticks
        good.set_mode("fast")  # a clock's turn comes as well
        while types([flood.frame()]) != ["error"]:
            pass


def test_a_fault_is_reported_and_logged_and_reset_clears_it(server: Served, caplog: pytest.LogCaptureFixture) -> None:
    with server.client() as client, server.client() as watcher:
        watcher.subscribe(events=["tick"], every=1000)
        client.spawn_cube("a", mass=1e-6)
        client.apply_force("a", force=[1e15, 0, 0])
        with pytest.raises(NmesError):
            client.step(100)
        fault = next(watcher.events(timeout=PATIENCE))
        assert fault["type"] == "world_fault"
        assert "world 'main' stopped" in caplog.text
        assert client.reset()["frame"] == 0
        assert client.step()["frame"] == 1


# -- the end ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("turns", range(5))
async def test_a_client_that_connects_while_the_host_closes_is_hung_up_on(turns: int) -> None:
    async with Host("x") as host:
        peers = [socket.create_connection(await host.listen("127.0.0.1", 0), PATIENCE) for _ in range(3)]
        for _ in range(turns):  # of the event loop, which accepts them meanwhile
            await asyncio.sleep(0)
        await host.close()
        for peer in peers:
            with peer, suppress(ConnectionResetError):
                assert peer.recv(1) == b""


async def test_an_address_that_is_taken_is_an_error(server: Served) -> None:
    async with Host("x") as host:
        host.add({"backend": "ballistic"})
        with pytest.raises(NmesError, match=f"cannot listen on 127.0.0.1:{server.port}: .*in use") as failed:
            await host.listen("127.0.0.1", server.port)
        assert failed.value.code == "cannot_listen"
        with pytest.raises(NmesError, match="cannot listen"):
            await host.listen("no.such.host.invalid", 0)


async def test_two_worlds_of_one_name_are_an_error() -> None:
    async with Host("x") as host:
        host.add({"backend": "ballistic"})
        with pytest.raises(WorldError, match="two worlds are called 'main'"):
            host.add({"backend": "ballistic"})


async def test_a_fast_world_added_to_a_listening_host_ticks() -> None:
    async with Host("x") as host:
        await host.listen("127.0.0.1", 0)
        stepped = host.add({"backend": "ballistic", "mode": "lockstep", "name": "stepped"}).world
        fast = host.add({"backend": "ballistic", "mode": "fast", "name": "fast"}).world
        deadline = time.monotonic() + PATIENCE
        while fast.frame < 10 and time.monotonic() < deadline:
            await asyncio.sleep(0.001)
        assert fast.frame >= 10
        assert stepped.frame == 0
