from __future__ import annotations

import asyncio
import json
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any

import numpy as np
import pytest

from nmes import protocol
from nmes.client import AsyncClient, Client
from nmes.client.commands import BlockingCommands
from nmes.client.conversation import EVENT_BACKLOG
from nmes.client.replies import Event
from nmes.errors import CommandFailed, Disconnected
from nmes.protocol import DELIMITER
from servers import PASSWORD, PATIENCE, Served, served


@pytest.fixture
def server() -> Iterator[Served]:
    with served() as running:
        yield running


@pytest.fixture
def client(server: Served) -> Iterator[Client]:
    with server.client() as connected:
        yield connected


def async_client(server: Served, **options: Any) -> AsyncClient:
    return AsyncClient(port=server.port, **{"password": PASSWORD, "timeout": PATIENCE, **options})


class Scripted:
    """The server's end of a connection, played by a test: any client gets in, then the script goes on."""

    def __init__(self, connection: socket.socket) -> None:
        self._socket = connection
        self._buffer = b""
        self.hear()
        self.say({"type": "auth_success"})

    def hear(self) -> Any:
        while DELIMITER not in self._buffer:
            data = self._socket.recv(1 << 16)
            if not data:
                raise EOFError
            self._buffer += data
        frame, self._buffer = self._buffer.split(DELIMITER, 1)
        return json.loads(frame)

    def say(self, *messages: Any) -> None:
        self.send(b"".join(json.dumps(message).encode() + DELIMITER for message in messages))

    def send(self, data: bytes) -> None:
        self._socket.sendall(data)


@contextmanager
def scripted(script: Callable[[Scripted], None]) -> Iterator[int]:
    """Serves each connection with a script and then hangs up; yields the port."""
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        while True:
            try:
                connection, _ = listener.accept()
            except OSError:
                return
            with connection:
                try:
                    script(Scripted(connection))
                except (EOFError, OSError):
                    pass

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield listener.getsockname()[1]
    finally:
        listener.shutdown(socket.SHUT_RDWR)
        listener.close()
        thread.join(PATIENCE)


# -- every command ----------------------------------------------------------------------------------------------------


class Checked(BlockingCommands):
    """Sends what a client sends, and checks each reply against its schema."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self.used: set[str] = set()

    def request(self, message: Any) -> Any:
        reply = self._client.request(message)
        protocol.validate_reply(reply)
        assert reply["type"] == protocol.COMMANDS[message["type"]].reply
        self.used.add(message["type"])
        return reply


def test_every_command_works_once() -> None:
    with served({"backend": "mujoco", "channels": {"alarm": {}}}) as server, server.client() as client:
        checked = Checked(client)
        assert checked.ping() == {"type": "pong"}
        assert checked.spawn_cube("a", position=[0, 2, 0], size=0.5, mass=2, is_base=True)["spawned"] == "a_BASE"
        assert checked.spawn_cube("b", position=np.array([1, 2, 0]), mass=None, list=False) == {
            "type": "cube_list",
            "spawned": "b",
        }
        joint = checked.create_joint("a_BASE", "b", "hinge", axis=[0, 0, 1], limits=[-1, 1])["joint_name"]
        assert checked.set_joint_param(joint, "motor_target_velocity", np.float64(1.5))["value"] == 1.5
        assert [j["joint_name"] for j in checked.get_joint_list()["joints"]] == [joint]
        assert checked.get_joint_info(joint)["params"]["limit_upper"] == 1
        assert checked.set_joint_params(joint, {"limit_upper": 0.5}, notes={"bias": 0.3})["params"] == {
            "limit_upper": 0.5
        }
        assert checked.get_joint_info(joint)["notes"] == {"bias": 0.3}
        assert checked.get_joints_for_cube("b")["joints"] == [joint]
        assert checked.link_cube_chains([["b", "a_BASE"]])["joints"] == ["joint_fixed_b_a_BASE"]
        checked.remove_joint("joint_fixed_b_a_BASE")
        assert checked.link_body_cubes("a_", gap=0)["joints"] == []
        assert checked.set_color("b", [1, 1, 0])["color"] == [1, 1, 0, 1]
        assert checked.apply_physics("b", torque=[0, 0, 1])["cube_name"] == "b"
        assert checked.apply_force(force=[0, 0, 1])["cube_name"] == "b"
        assert checked.step(2)["frame"] == 2
        assert checked.get_cube_state("b")["cube_name"] == "b"
        assert checked.get_cube_info("a_BASE")["frozen"]
        seen = checked.get_cube_info("b", sensors=True, rays=[[0, -1, 0]], max_range=9.5)
        assert seen["ranges"] == [pytest.approx(2, abs=1)]
        assert len(checked.get_world_state()["cubes"]) == 2
        assert [len(cube["gyro"]) for cube in checked.get_world_state(sensors=True)["cubes"]] == [3, 3]
        assert [cube["cube_name"] for cube in checked.get_world_state(cubes=["b"])["cubes"]] == ["b"]
        assert checked.remove_joint(joint)["joint_name"] == joint
        assert checked.set_cube_state("b", position=[5, 5, 5])["cube_name"] == "b"
        assert checked.freeze_cube("a_BASE", False)["freeze"] is False
        assert checked.get_cube_list()["cubes"] == ["a_BASE", "b"]
        assert checked.despawn_cube("b") == {"type": "cube_despawned", "cube_name": "b", "joints": []}
        assert checked.get_world_info()["counts"] == {"cubes": 1, "joints": 0, "clients": 1}
        assert checked.get_planets()["planets"] == []
        rocker = protocol.COMMANDS["spawn_creature"].schema["examples"][0]["genome"]
        assert checked.spawn_creature(rocker, name="r", position=[3, 0, 0])["motors"] == ["shoulder"]
        assert checked.drive("r", [0.5])["creature"] == "r"
        assert len(checked.sense("r")["values"]) == 12
        assert checked.get_genome("r")["genome"] == rocker
        assert checked.say("alarm", 0.5, creature="r")["cube_name"] == "r.torso"
        assert checked.say("alarm", [0.5], cube_name="a_BASE")["channel"] == "alarm"
        assert checked.hear("alarm", creature="r")["voices"] == []
        assert checked.set_objective("height", creature="r", target=[1, 0, 0])["needs"] == ["height"]
        assert checked.set_objective("time", name="b", cubes=["a_BASE"])["cubes"] == ["a_BASE"]
        assert checked.compute_reward(objective="b")["value"] == 0.0
        assert checked.shed("r", "arm")["cubes"] == ["r.arm"]
        assert checked.adopt("r", "arm", "r.arm")["layout"] == 5
        checked.shed("r", "arm", remove=True)
        assert checked.grow("r", "arm")["cube"] == "r.arm"
        assert checked.compute_reward(metric="displacement", cube="a_BASE", axis=[0, 0, 1])["metric"] == "displacement"
        assert checked.compute_reward(metric="distance", cube="a_BASE", target=[0, 0, 0])["value"] > 0.0
        assert checked.subscribe(events=["state"], every=2)["every"] == 2
        assert checked.unsubscribe()
        assert checked.batch([{"type": "ping"}, {"type": "step"}])["results"][1]["frame"] == 3
        assert checked.set_mode("realtime", rate=2) == {"type": "mode_set", "mode": "realtime", "rate": 2}
        checked.pause()
        checked.resume()
        assert checked.reset(seed=5)["seed"] == 5
        optional = {
            "create_bone",
            "feed",
            "get_camera",
            "get_life",
            "give",
        }  # an engine, the machine or the world may lack it
        assert set(protocol.COMMANDS) - checked.used == optional
        with pytest.raises(CommandFailed):
            checked.create_bone("a", "b", snake_id="s")


def test_wrong_arguments_raise_a_type_error(client: Client) -> None:
    with pytest.raises(TypeError, match="cube_name"):
        client.despawn_cube()  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="colour"):
        client.spawn_cube(colour=[1, 0, 0])  # type: ignore[call-arg]
    assert client.get_cube_list()["cubes"] == []


def test_a_refused_command_raises_its_code(client: Client) -> None:
    with pytest.raises(CommandFailed, match="there is no cube 'x'") as failed:
        client.get_cube_info("x")
    assert (failed.value.code, failed.value.path) == ("cube_not_found", "cube_name")
    with pytest.raises(CommandFailed) as failed:
        client.request({"type": "fly"})
    assert failed.value.code == "unknown_type"
    with pytest.raises(TypeError):
        client.request({"type": "ping", "x": object()})
    assert client.ping() == {"type": "pong"}


# -- connecting -------------------------------------------------------------------------------------------------------


def test_connecting_reads_the_welcome(server: Served) -> None:
    client = server.client()
    with pytest.raises(Disconnected) as lost:
        client.ping()
    assert lost.value.code == "not_connected"
    with pytest.raises(Disconnected):
        _ = client.welcome
    with client.connect():
        assert client.welcome["client"] == 1
        with pytest.raises(RuntimeError, match="connected already"):
            client.connect()
        with client as same:
            assert same is client
    client.close()
    with pytest.raises(Disconnected, match="was closed"):
        client.ping()
    assert PASSWORD not in repr(client)


def test_a_wrong_password_or_world_is_a_failed_command(server: Served) -> None:
    for options, code in [({"password": "guess"}, "auth_failed"), ({"world": "elsewhere"}, "world_not_found")]:
        with pytest.raises(CommandFailed) as failed:
            server.client(**options).connect()
        assert failed.value.code == code


def test_connecting_to_a_closed_port_raises() -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
        with pytest.raises(Disconnected, match=rf"cannot connect to 127\.0\.0\.1:{port}") as lost:
            Client(port=port, password="x").connect()
        assert lost.value.code == "unreachable"
        with pytest.raises(Disconnected, match="cannot connect"):
            asyncio.run(AsyncClient(port=port, password="x").connect())


def test_reconnecting_makes_another_client(server: Served, client: Client) -> None:
    client.spawn_cube("a")
    client.subscribe()
    client.step()
    assert client.reconnect().welcome["client"] == 2
    assert list(client.events(timeout=0)) == []
    with pytest.raises(CommandFailed) as failed:
        client.get_cube_state()
    assert failed.value.code == "nothing_owned"
    assert client.get_cube_list()["cubes"] == ["a"]


# -- pipelines --------------------------------------------------------------------------------------------------------


def test_a_pipeline_is_sent_before_any_reply_is_awaited() -> None:
    def script(end: Scripted) -> None:
        asked = [end.hear() for _ in range(3)]
        end.say(*({"type": "pong", "id": message["id"], "of": message["type"]} for message in asked))

    with scripted(script) as port, Client(port=port, password="x", timeout=PATIENCE) as client:
        with client.pipeline() as together:
            together.apply_physics("a", force=[1, 0, 0])
            together.step()
            seen = together.get_cube_info("a")
            with pytest.raises(RuntimeError, match="has not come"):
                seen.result()
        assert json.loads(json.dumps(seen.result()))["of"] == "get_cube_info"


def test_a_pipeline_raises_its_first_failure_and_keeps_the_other_results(client: Client) -> None:
    with pytest.raises(CommandFailed, match="'x'"), client.pipeline() as together:
        first = together.spawn_cube("a")
        together.get_cube_info("x")
        together.get_cube_info("y")
        last = together.get_cube_list()
    assert first.result()["spawned"] == "a"
    assert last.result()["cubes"] == ["a"]


def test_an_empty_and_an_abandoned_pipeline_send_nothing(client: Client) -> None:
    with client.pipeline():
        pass
    with pytest.raises(ZeroDivisionError), client.pipeline() as together:
        together.spawn_cube("a")
        _ = 1 / 0
    assert client.get_cube_list()["cubes"] == []


def test_a_pipeline_may_be_larger_than_all_buffers(client: Client) -> None:
    color = [0.123456789] * 3
    with client.pipeline() as many:
        for _ in range(10_000):
            many.spawn_cube(color=color, position=[0.123456789] * 3, list=False)
            many.get_cube_state()
    assert many.calls[-1].result()["cube_name"] == many.calls[-2].result()["spawned"]


# -- commands that nobody waits for yet -------------------------------------------------------------------------------


def test_commands_may_be_posted_to_many_before_the_first_reply_is_waited_for() -> None:
    with ExitStack() as stack:
        heard = [threading.Event() for _ in range(2)]

        def script(end: Scripted, mine: threading.Event, other: threading.Event) -> None:
            message = end.hear()
            mine.set()
            assert other.wait(PATIENCE), "the other has not been asked"
            end.say({"type": "pong", "id": message["id"], "of": message["type"]})

        ports = [stack.enter_context(scripted(partial(script, mine=heard[n], other=heard[1 - n]))) for n in range(2)]
        clients = [stack.enter_context(Client(port=port, password="x", timeout=PATIENCE)) for port in ports]
        posted = [client.post({"type": "ping"}) for client in clients]
        assert [client.wait(call)["of"] for client, call in zip(clients, posted, strict=True)] == ["ping", "ping"]


def test_what_was_posted_is_answered_in_order_and_may_be_refused(client: Client) -> None:
    first, second = client.post({"type": "spawn_cube", "cube_name": "a"}), client.post({"type": "nonsense"})
    assert client.get_cube_list()["cubes"] == ["a"]  # the others are there by then
    with pytest.raises(CommandFailed, match="nonsense"):
        client.wait(second)
    assert client.wait(first)["spawned"] == "a"
    client.close()
    with pytest.raises(Disconnected, match="closed"):
        client.post({"type": "ping"})


# -- what may go wrong ------------------------------------------------------------------------------------------------


def test_a_late_reply_is_not_mistaken_for_the_next() -> None:
    ready = threading.Event()

    def script(end: Scripted) -> None:
        late = end.hear()
        assert ready.wait(PATIENCE)
        end.say({"type": "pong", "id": late["id"], "n": 1})
        end.say({"type": "pong", "id": end.hear()["id"], "n": 2})

    with scripted(script) as port, Client(port=port, password="x", timeout=PATIENCE) as client:
        client.timeout = 0.05
        with pytest.raises(TimeoutError, match=r"did not answer within 0\.05 s"):
            client.ping()
        client.timeout = PATIENCE
        ready.set()
        assert client.request({"type": "ping"}) == {"type": "pong", "n": 2}


@pytest.mark.parametrize(
    ("answer", "code"),
    [
        (b"", "disconnected"),
        (b'{"type":"po', "disconnected"),
        (b'{"type":"error","code":"slow_consumer","message":"read!"}' + DELIMITER, "slow_consumer"),
        (b"nonsense" + DELIMITER, "bad_reply"),
        (b"[]" + DELIMITER, "bad_reply"),
        (b'{"type":"pong","id":99}' + DELIMITER, "bad_reply"),
    ],
)
def test_a_lost_connection_says_why(answer: bytes, code: str) -> None:
    def script(end: Scripted) -> None:
        end.hear()
        end.send(answer)

    async def by_await(port: int) -> None:
        async with AsyncClient(port=port, password="x", timeout=PATIENCE) as client:
            await client.ping()

    with scripted(script) as port:
        with pytest.raises(Disconnected) as lost, Client(port=port, password="x", timeout=PATIENCE) as client:
            client.ping()
        assert lost.value.code == code
        with pytest.raises(Disconnected) as lost:
            asyncio.run(by_await(port))
        assert lost.value.code == code


@pytest.mark.parametrize("last_word", [b"", b'{"type":"error","code":"slow_consumer","message":""}' + DELIMITER])
def test_a_connection_lost_while_sending_raises(last_word: bytes) -> None:
    with scripted(lambda end: end.send(last_word)) as port:
        with Client(port=port, password="x", timeout=PATIENCE) as client:
            with pytest.raises(Disconnected), client.pipeline() as many:
                for _ in range(100_000):
                    many.ping()


def test_a_server_that_never_answers_auth_times_out() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        with pytest.raises(TimeoutError):
            Client(port=port, password="x", timeout=0.05).connect()
        with pytest.raises(TimeoutError):
            asyncio.run(AsyncClient(port=port, password="x", timeout=0.05).connect())


# -- events -----------------------------------------------------------------------------------------------------------


def test_events_are_kept_until_asked_for(client: Client) -> None:
    client.subscribe(events=["tick"])
    client.step(3)
    assert [event["frame"] for event in client.events(timeout=0) if event["type"] == "tick"] == [1, 2, 3]


def test_events_that_nobody_takes_are_dropped_oldest_first(client: Client) -> None:
    client.subscribe(events=["tick"])
    with client.pipeline() as together:
        together.step(10_000)
        together.step(10)
    frames = [event["frame"] for event in client.events(timeout=0) if event["type"] == "tick"]
    assert len(frames) == EVENT_BACKLOG
    assert frames[-1] == 10_010


def test_events_go_to_the_callback_and_what_it_raises_loses_nothing(server: Served) -> None:
    seen: list[Event] = []

    def take(event: Event) -> None:
        seen.append(event)
        if len(seen) == 1:
            raise KeyError("mine")

    with server.client(on_event=take) as client:
        client.subscribe(events=["tick"])
        with pytest.raises(KeyError):
            client.step(3)
        assert client.ping() == {"type": "pong"}
        assert len(seen) == 3


def test_iteration_ends_with_the_world(server: Served, client: Client) -> None:
    client.subscribe()
    server.close()
    assert [event["type"] for event in client.events()] == ["world_closed"]
    with pytest.raises(Disconnected) as lost:
        client.ping()
    assert lost.value.code == "world_closed"


def test_iteration_over_a_lost_connection_raises() -> None:
    with scripted(lambda end: end.say({"type": "tick", "frame": 1, "t": 0})) as port:
        with Client(port=port, password="x") as client:
            events = client.events()
            assert next(events)["type"] == "tick"
            with pytest.raises(Disconnected):
                next(events)


# -- awaited ----------------------------------------------------------------------------------------------------------


async def test_many_tasks_share_a_connection(server: Served) -> None:
    async with async_client(server) as client:
        spawned = await asyncio.gather(*(client.spawn_cube(f"c{n}", list=False) for n in range(100)))
        assert [reply["spawned"] for reply in spawned] == [f"c{n}" for n in range(100)]
        with pytest.raises(CommandFailed):
            await client.get_cube_info("x")
        async with client.pipeline() as together:
            together.apply_physics("c1", force=[60, 0, 0])
            together.step()
            seen = together.get_cube_state("c1")
        assert seen.result()["linear_velocity"][0] == pytest.approx(1.0)
        with pytest.raises(RuntimeError, match="connected already"):
            await client.connect()
        await client.reconnect()
        assert client.welcome["client"] == 2
    with pytest.raises(Disconnected):
        await client.ping()


async def test_tasks_that_enter_at_once_make_one_connection(server: Served) -> None:
    client = async_client(server)
    outcomes = await asyncio.gather(*(client.connect() for _ in range(3)), return_exceptions=True)
    assert [type(outcome) for outcome in outcomes] == [AsyncClient, RuntimeError, RuntimeError]
    await asyncio.gather(*(client.reconnect() for _ in range(8)))
    assert client.welcome["client"] == 2
    assert await client.ping() == {"type": "pong"}
    await client.close()


@pytest.mark.parametrize("tasks", [1, 3])
async def test_a_client_that_is_closed_while_it_enters_is_closed(server: Served, tasks: int) -> None:
    outcomes: list[Any] = []
    client = async_client(server)
    async with async_client(server) as other:
        for turns in range(1, 25):
            await client.reconnect()
            entering = asyncio.gather(*(client.reconnect() for _ in range(tasks)), return_exceptions=True)
            for _ in range(turns):  # of the event loop, in each of which connecting may come further
                await asyncio.sleep(0)
            await client.close()
            outcomes += await entering
            with pytest.raises(Disconnected, match="the client was closed"):
                await client.ping()
        lost = [outcome for outcome in outcomes if outcome is not client]
        assert lost and {str(outcome) for outcome in lost} == {"the client was closed"}
        while (await other.get_world_info())["counts"]["clients"] > 1:
            pass
        connecting = asyncio.ensure_future(client.connect())
        await asyncio.sleep(0)
        await client.close()
        with pytest.raises(Disconnected, match="the client was closed"):
            await connecting
        assert await (await client.connect()).ping() == {"type": "pong"}
        await client.close()


async def test_events_can_be_awaited(server: Served) -> None:
    seen: list[Event] = []
    async with async_client(server) as client, async_client(server, on_event=seen.append) as other:
        await client.subscribe(events=["tick"])
        await other.subscribe(events=["tick"])
        asyncio.get_running_loop().call_later(0.05, asyncio.ensure_future, other.step(2))
        frames = []
        async for event in client.events():
            assert event["type"] == "tick"
            frames.append(event["frame"])
            if len(frames) == 2:
                break
        assert frames == [1, 2]
        await other.ping()
        assert len(seen) == 2
        assert [event async for event in client.events(timeout=0.01)] == []
        await asyncio.to_thread(server.close)
        assert [event["type"] async for event in client.events()] == ["world_closed"]


async def test_what_a_callback_raises_is_told_the_loop_and_loses_nothing(server: Served) -> None:
    seen: list[Any] = []
    told: list[Any] = []

    def take(event: Event) -> None:
        seen.append(event)
        raise KeyError("mine")

    asyncio.get_running_loop().set_exception_handler(lambda _, context: told.append(context["exception"]))
    async with async_client(server, on_event=take) as client:
        await client.subscribe(events=["tick"])
        assert (await client.step(3))["frame"] == 3
        assert await client.ping() == {"type": "pong"}
    assert [event["frame"] for event in seen] == [1, 2, 3]
    assert [repr(error) for error in told] == ["KeyError('mine')"] * 3


async def test_closing_while_a_reply_is_awaited_raises() -> None:
    with scripted(lambda end: end.hear() and end.hear()) as port:
        client = await AsyncClient(port=port, password="x", timeout=PATIENCE).connect()
        waiting = asyncio.ensure_future(client.ping())
        await asyncio.sleep(0)
        await client.close()
        with pytest.raises(Disconnected):
            await waiting


async def test_a_client_closes_though_the_server_has_stopped_reading() -> None:
    closed = threading.Event()

    def script(end: Scripted) -> None:
        closed.wait(PATIENCE)

    with scripted(script) as port:
        client = await AsyncClient(port=port, password="x", timeout=PATIENCE).connect()
        client.timeout = 0.05
        with pytest.raises(TimeoutError):
            await client.request({"type": "ping", "more": "x" * (64 << 20)})
        try:
            async with asyncio.timeout(PATIENCE):
                await client.close()
        finally:
            closed.set()


async def test_a_late_reply_is_dropped_by_the_awaiting_client_too() -> None:
    ready = threading.Event()

    def script(end: Scripted) -> None:
        late = end.hear()
        assert ready.wait(PATIENCE)
        end.say({"type": "pong", "id": late["id"], "n": 1})
        end.say({"type": "pong", "id": end.hear()["id"], "n": 2})

    with scripted(script) as port:
        async with AsyncClient(port=port, password="x", timeout=PATIENCE) as client:
            client.timeout = 0.05
            with pytest.raises(TimeoutError):
                await client.ping()
            client.timeout = PATIENCE
            ready.set()
            assert await client.request({"type": "ping"}) == {"type": "pong", "n": 2}
