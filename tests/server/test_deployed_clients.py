"""The habits of programs that were written for the original server, each as a small program over a real socket.

They speak the raw dialect, they know nothing of this package, and each has a way of its own to read. What they have in
common: one read is one answer, so one frame that they do not expect puts them out of step for good.
"""

from __future__ import annotations

import json
import os
import random
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from servers import PASSWORD, PATIENCE, Served, served, until

END = b"<???DONE???---"
WAIT = 0.25  # s; theirs is 1 to 3 s
WORLD = {"backend": "mujoco", "mode": "realtime"}  # what `nmes serve` serves when nothing is asked for
Message = dict[str, Any]


class Program:
    """Reads as most do: 1,024 bytes at a time, and throws away all that follows the first delimiter of the read."""

    def __init__(self, port: int) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=PATIENCE)
        self.socket.sendall(PASSWORD.encode() + END)
        assert self.read() == b"auth_success"

    def __enter__(self) -> Program:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def send(self, **command: Any) -> None:
        self.socket.sendall(json.dumps(command).encode() + END)

    def read(self) -> bytes:
        answer = b""
        while END not in answer:
            data = self.socket.recv(1024)
            assert data, "the server hung up"
            answer += data
        return answer.split(END)[0]

    def ask(self, **command: Any) -> Message:
        self.send(**command)
        answer = json.loads(self.read())
        assert isinstance(answer, dict)
        return answer

    def names(self) -> list[str]:
        answer = self.ask(type="get_cube_list")
        assert answer["type"] == "cube_list"
        names: list[str] = answer["cubes"]
        return names

    def wait_in_vain(self) -> None:
        """Waits for an answer until its own time-out, and holds that for a success."""
        self.socket.settimeout(WAIT)
        with pytest.raises(TimeoutError):
            self.socket.recv(1024)
        self.socket.settimeout(PATIENCE)

    def spawn(self, **cube: Any) -> str:
        """Spawns a cube and polls until exactly one name is new."""
        before = sorted(self.names())
        self.send(type="spawn_cube", **cube)
        while True:
            new = [name for name in sorted(self.names()) if name not in before]
            if len(new) == 1:
                return new[0]
            assert not new
            time.sleep(0.2)


class ByteReader(Program):
    """Reads a byte at a time until what it has ends in the delimiter."""

    def read(self) -> bytes:
        answer = b""
        while not answer.endswith(END):
            byte = self.socket.recv(1)
            assert byte, "the server hung up"
            answer += byte
        return answer.removesuffix(END)


class DashReader(Program):
    """Reads up to each `-` with a buffered reader, and looks whether that was the delimiter's."""

    def __init__(self, port: int) -> None:
        self._buffer = b""
        super().__init__(port)

    def _read_to_dash(self) -> bytes:
        while b"-" not in self._buffer:
            data = self.socket.recv(4096)
            assert data, "the server hung up"
            self._buffer += data
        piece, dash, self._buffer = self._buffer.partition(b"-")
        return piece + dash

    def read(self) -> bytes:
        answer = b""
        while not answer.endswith(END):
            answer += self._read_to_dash()
        return answer.removesuffix(END)


PROGRAMS = [Program, ByteReader, DashReader]


@pytest.fixture
def server() -> Iterator[Served]:
    with served(WORLD) as running:
        yield running


# -- how they read ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("program", PROGRAMS)
def test_every_way_of_reading_finds_the_reply_to_its_command(server: Served, program: type[Program]) -> None:
    with program(server.port) as client:
        first = client.spawn(cube_name="first", position=[0, 5, 0])
        second = client.spawn(cube_name="second", position=[-1.5, 5, 0])
        assert (first, second) == ("first", "second")
        assert client.ask(type="create_joint", cube1=first, cube2=second, joint_type="hinge")["type"] == "joint_created"
        for _ in range(60):
            client.send(type="spawn_cube", position=[-30, 5, -30])  # so that lists no longer fit into one read
        assert len(client.names()) == 62
        client.send(type="freeze_cube", cube_name=second, freeze=True)
        state = client.ask(type="get_cube_state", cube_name=second)
        assert (state["type"], state["cube_name"], state["position"][0] < -1) == ("cube_state", second, True)
        for name in client.names()[2:]:
            client.send(type="despawn_cube", cube_name=name)
        assert client.names() == [first, second]


def test_clients_compare_or_search_the_answer_to_the_password(server: Served) -> None:
    for right in (lambda answer: answer == "auth_success", lambda answer: "auth_success" in answer):
        with socket.create_connection(("127.0.0.1", server.port), timeout=PATIENCE) as client:
            client.sendall(PASSWORD.encode() + END)
            answer = client.recv(1024)
            assert answer.endswith(END)
            assert right(answer.removesuffix(END).decode())


@pytest.mark.parametrize("program", PROGRAMS)
def test_silent_commands_are_silent_until_the_client_s_own_time_out(server: Served, program: type[Program]) -> None:
    with program(server.port) as client:
        for command in (
            {"type": "spawn_cube", "cube_name": "leg", "is_base": True},
            {"type": "freeze_cube", "cube_name": "leg_BASE", "freeze": False},
            {"type": "apply_force", "cube_name": "leg_BASE", "force": [0, 9, 0]},
            {"type": "apply_physics", "cube_name": "leg_BASE", "impulse": [0, 1, 0]},
            {"type": "despawn_cube", "cube_name": "leg_BASE"},
        ):
            client.send(**command)
            client.wait_in_vain()
            client.send(**{**command, "cube_name": "no such cube"})  # a failure is just as silent
            client.wait_in_vain()
        assert client.names() == []


# -- cubes ------------------------------------------------------------------------------------------------------------


def test_ten_cubes_spawned_blindly_are_the_last_ten_of_the_list(server: Served) -> None:
    with Program(server.port) as client, Program(server.port) as other:
        for n in range(7):
            other.spawn(cube_name=f"zz_{n}")
        for n in range(10):
            client.send(type="spawn_cube", position=[n, 2, n])
        mine = client.names()[-10:]
        assert len(set(mine)) == 10 and not any(name.startswith("zz") for name in mine)
        for n, name in enumerate(mine):  # in the order in which they were asked for
            position = client.ask(type="get_cube_state", cube_name=name)["position"]
            assert abs(position[0] - n) < 0.3 and abs(position[2] - n) < 0.3


def test_polling_the_list_finds_the_one_new_name(server: Served) -> None:
    with Program(server.port) as client:
        assert len({client.spawn(position=[2 * n, 1, 0]) for n in range(5)}) == 5


def test_despawning_without_reading_leaves_the_next_answer_the_first(server: Served) -> None:
    with Program(server.port) as client:
        for name in "abc":
            client.spawn(cube_name=name)
        client.send(type="despawn_cube", cube_name="b")
        client.send(type="despawn_cube", cube_name="b")  # is gone: an error that nobody reads
        assert client.names() == ["a", "c"]


def test_commands_without_a_name_mean_the_cube_spawned_last_by_this_connection(server: Served) -> None:
    with Program(server.port) as client, Program(server.port) as other:
        client.spawn(cube_name="mine_first", position=[-20, 0.5, 0])
        client.spawn(cube_name="mine", position=[0, 0.5, 0])
        other.spawn(cube_name="other", position=[20, 0.5, 0])

        def speed() -> float:
            client.send(type="apply_force", force=[200, 0, 0])
            state = client.ask(type="get_cube_state")
            assert state["cube_name"] == "mine"
            for field in ("position", "linear_velocity"):
                assert len(state[field]) == 3
                assert all(isinstance(float(number), float) for number in state[field])
            return float(state["linear_velocity"][0])

        until(lambda: speed() > 1)
        for name in ("mine_first", "other"):
            assert abs(client.ask(type="get_cube_state", cube_name=name)["linear_velocity"][0]) < 0.1


def test_a_whole_number_parses_as_a_float(server: Served) -> None:
    with Program(server.port) as client:
        client.send(type="spawn_cube", cube_name="still", position=[0, 3, 0], is_base=True)
        state = client.ask(type="get_cube_state", cube_name="still_BASE")
        assert [float(number) for number in state["position"]] == [0.0, 3.0, 0.0]
        assert [float(number) for number in state["linear_velocity"]] == [0.0, 0.0, 0.0]


def test_a_base_is_frozen_and_freed_by_its_longer_name(server: Served) -> None:
    with Program(server.port) as client:
        client.send(type="spawn_cube", cube_name="snake", position=[0, 50, 0], is_base=True)
        assert client.names() == ["snake_BASE"]

        def height() -> float:
            return float(client.ask(type="get_cube_state", cube_name="snake_BASE")["position"][1])

        client.wait_in_vain()
        assert height() == 50
        client.send(type="freeze_cube", cube_name="snake_BASE", freeze=False)
        until(lambda: height() < 49.5)
        client.send(type="freeze_cube", cube_name="snake_BASE", freeze=True)
        at = height()
        client.wait_in_vain()
        assert height() == at


# -- joints -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["pin", "hinge", "slider", "conetwist"])
def test_a_joint_needs_no_axis(server: Served, kind: str) -> None:
    with Program(server.port) as client:
        for n in range(2):
            client.spawn(cube_name=f"cube_{n}", position=[1.1 * n, 3, 0])
        joint = {"cube1": "cube_0", "cube2": "cube_1", "joint_type": kind, "position": [0.55, 3, 0]}
        answer = client.ask(type="create_joint", **joint)
        assert answer["type"] == "joint_created" and isinstance(answer["joint_name"], str) and answer["joint_name"]
        assert len(client.names()) == 2


@pytest.mark.parametrize("snake", ["snake_7", 7])
def test_bones_are_created_with_a_snake_id(server: Served, snake: object) -> None:
    with Program(server.port) as client:
        for n in range(3):
            client.spawn(cube_name=f"segment_{n}", position=[1.1 * n, 1, 0])
        bones = [
            client.ask(type="create_bone", cube1=f"segment_{n}", cube2=f"segment_{n + 1}", snake_id=snake)
            for n in range(2)
        ]
        assert [bone["type"] for bone in bones] == ["bone_created"] * 2
        assert bones[0]["bone_name"] != bones[1]["bone_name"]


def test_motors_that_are_set_turn_their_hinges(server: Served) -> None:
    with Program(server.port) as client:
        client.send(type="spawn_cube", cube_name="arm", position=[0, 5, 0], is_base=True)
        below, joints = "arm_BASE", []
        for n in range(1, 4):
            cube = client.spawn(cube_name=f"arm_{n}", position=[0, 5 + 1.1 * n, 0])
            joint = {"cube1": below, "cube2": cube, "joint_type": "hinge", "position": [0, 4.45 + 1.1 * n, 0]}
            joints.append(client.ask(type="create_joint", **joint)["joint_name"])
            below = cube
        for joint in joints:
            for param, value in (("motor_target_velocity", 1.5), ("motor_max_impulse", 100.0)):
                answer = client.ask(type="set_joint_param", joint_name=joint, param_name=param, value=value)
                assert (answer["type"], answer["param_name"]) == ("joint_param_set", param)

        def turned(cube: str) -> float:
            return abs(float(client.ask(type="get_cube_state", cube_name=cube)["rotation"][2]))

        # Each adds its own turn to those below, once it has made up for what they turned before its motor was set.
        until(lambda: 0.2 < turned("arm_1") < turned("arm_2"))
        assert turned("arm_BASE") == 0.0


# -- connections ------------------------------------------------------------------------------------------------------


def test_cubes_outlive_the_connection_that_made_them(server: Served) -> None:
    with Program(server.port) as client:
        client.send(type="spawn_cube", cube_name="orphan")
    with Program(server.port) as client:
        until(lambda: client.names() == ["orphan"])


def test_fifty_connections_at_once_with_a_cube_each(server: Served) -> None:
    together = threading.Barrier(50, timeout=PATIENCE)
    states: dict[int, Message] = {}
    failures: list[BaseException] = []

    def live(n: int) -> None:
        try:
            with Program(server.port) as client:
                together.wait()
                client.send(type="spawn_cube", position=[3 * n, 0.5, 0])
                client.send(type="apply_force", force=[0, 0, 5])
                states[n] = client.ask(type="get_cube_state")
                together.wait()
        except BaseException as failure:  # told by the test, not by the thread
            failures.append(failure)
            together.abort()

    threads = [threading.Thread(target=live, args=(n,)) for n in range(50)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE)
    assert not failures
    assert len({state["cube_name"] for state in states.values()}) == 50
    for n, state in states.items():
        assert abs(state["position"][0] - 3 * n) < 0.1


SECOND_PROCESS = """
import json, socket, sys
END = b"<???DONE???---"
client = socket.create_connection(("127.0.0.1", int(sys.argv[1])), timeout=30)
def read():
    answer = b""
    while END not in answer:
        answer += client.recv(1024)
    return answer.split(END)[0]
client.sendall(sys.argv[2].encode() + END)
assert read() == b"auth_success"
def names():
    client.sendall(json.dumps({"type": "get_cube_list"}).encode() + END)
    return json.loads(read())["cubes"]
for name in names():
    client.sendall(json.dumps({"type": "despawn_cube", "cube_name": name}).encode() + END)
assert names() == []
"""


def test_a_second_process_despawns_what_the_first_made(server: Served) -> None:
    with Program(server.port) as client:
        for n in range(20):
            client.spawn(position=[2 * n, 1, 0])
        command = [sys.executable, "-c", SECOND_PROCESS, str(server.port), PASSWORD]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
        assert done.returncode == 0, done.stderr
        assert client.names() == []


def test_a_wrong_password_is_told_in_bare_text(server: Served) -> None:
    with socket.create_connection(("127.0.0.1", server.port), timeout=PATIENCE) as client:
        client.sendall(b"wrong" + END)
        answer = b""
        while data := client.recv(1024):
            answer += data
        assert answer == b"auth_failed" + END


# -- planets ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scene", ["flat", "planets"])
def test_each_planet_stands_alone_in_a_list_under_its_name(scene: str) -> None:
    with served({**WORLD, "scene": {"type": scene}}) as server, Program(server.port) as client:
        answer = client.ask(type="get_planets")
        for name, (planet,) in answer.items():
            assert planet["Name"] == name
            assert {axis: float(planet["Position"][axis]) for axis in "xyz"}
            assert type(planet["Seed"]) is int
        assert len(answer) == (27 if scene == "planets" else 0)
        assert client.names() == []


def test_a_field_that_is_not_understood_is_logged_once_a_connection(
    server: Served, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level("INFO", "nmes.server.connection"):
        for _ in range(2):
            with Program(server.port) as client:
                for padding in ("", "x" * 9000, ""):  # a long frame is read in a thread
                    assert client.ask(type="get_cube_list", order="name" + padding)["cubes"] == []
    told = [record.getMessage() for record in caplog.records if "not understood" in record.getMessage()]
    assert [line.partition(" says ")[2] for line in told] == ["get_cube_list: order is not understood"] * 2


# -- many ports -------------------------------------------------------------------------------------------------------


def _scan(first: int, step: int, count: int) -> tuple[dict[int, list[str]], list[int]]:
    """Authenticates on each port, lists, closes; returns the cubes by port, and the ports where nobody listens."""
    cubes: dict[int, list[str]] = {}
    refused = []
    for port in range(first, first + step * count, step):
        try:
            with Program(port) as client:
                cubes[port] = client.names()
        except ConnectionRefusedError:
            refused.append(port)
    return cubes, refused


@contextmanager
def _worlds(count: int, step: int) -> Iterator[int]:
    """Runs `nmes serve` with worlds on ports that are `step` apart; yields the first port."""
    nmes = str(Path(sys.executable).parent / "nmes")
    options = ["--worlds", str(count), "--port-step", str(step), "--no-record", "--json"]
    environment = {**os.environ, "NMES_PASSWORD": PASSWORD}
    while True:
        first = random.SystemRandom().randrange(15_000, 30_000)  # below those that the system gives to clients
        command = [nmes, "serve", *options, "--port", str(first)]
        with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
            try:
                assert process.stdout is not None
                if process.stdout.readline():  # none, if one of the ports is somebody else's
                    yield first
                    return
            finally:
                process.kill()


@pytest.mark.parametrize("step", [3, 5])
def test_a_scan_over_ports_finds_the_worlds_and_is_refused_elsewhere(step: int) -> None:
    with _worlds(4, step) as first:
        for n in range(4):
            with Program(first + n * step) as client:
                client.spawn(cube_name=f"of_{n}")
        cubes, refused = _scan(first, step, 6)
        assert cubes == {first + n * step: [f"of_{n}"] for n in range(4)}
        assert refused == [first + 4 * step, first + 5 * step]
        assert _scan(first + 1, step, 4)[0] == {}
