from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from math import pi
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from nmes.backend.rotation import euler_from_quaternion, multiply, quaternion_from_euler
from nmes.cli import main
from nmes.client import Client
from nmes.errors import CommandFailed, Disconnected
from nmes.playback.remote import RemoteConnection, RemoteReplayReport, replay_remotely
from nmes.protocol import parse
from nmes.recording import Recording
from nmes.world import World
from recordings import busy, record, send
from servers import served

Spoil = Callable[[dict[str, Any], dict[str, Any]], dict[str, Any]]


@pytest.fixture(scope="module")
def busy_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("against") / "busy.mcap", busy)


def against(path: Path, client: Callable[[], RemoteConnection], **options: Any) -> RemoteReplayReport:
    return replay_remotely(Recording(path), client, **options)


def jointed(world: World, client: int) -> None:
    """Two cubes and a hinge, all named by the world; a batch; errors; a fault; a reset; ticks with nobody there."""
    one = send(world, client, type="spawn_cube", position=[0, 3, 0])["spawned"]
    two = send(world, client, type="spawn_cube", position=[0, 5, 0])["spawned"]
    joint = send(world, client, type="create_joint", cube1=one, cube2=two, joint_type="hinge")["joint_name"]
    parts = [{"type": "apply_physics", "cube_name": two, "force": [1, 2, 3]}, {"type": "step", "ticks": 3}]
    send(world, client, type="batch", commands=parts)
    send(world, client, type="get_joint_info", joint_name=joint)
    send(world, client, type="get_world_state")
    send(world, client, type="get_cube_info", cube_name="nobody")
    send(world, client, type="despawn_cube", cube_name=one)
    world.leave(client)
    for _ in range(7):
        world.tick()
    client = world.join()
    send(world, client, type="get_world_info")
    send(world, client, type="set_mode", mode="fast")
    send(world, client, type="step")  # wrong mode: no tick
    send(world, client, type="get_cube_info", cube_name=two)
    send(world, client, type="reset", seed=9)
    send(world, client, type="get_cube_list")


@pytest.mark.parametrize(
    ("backend", "play"), [("ballistic", busy), ("mujoco", busy), ("mujoco", jointed), ("pymunk", jointed)]
)
def test_the_same_engine_answers_the_same(tmp_path: Path, backend: str, play: Callable[[World, int], None]) -> None:
    path = record(tmp_path / "x.mcap", play, {"backend": backend, "seed": 4})
    summary = Recording(path).summary()
    # As a host is by default: with a clock, and it is not new any more.
    with served({"backend": backend, "mode": "realtime"}) as server:
        with server.client() as other:
            other.spawn_cube("in_the_way")
        report = against(path, lambda: server.client().connect(), tolerance=0.0)
        assert (report.verdict, report.fields) == ("equal", [])
        kept_back = sum(report.kept_back.values())
        assert report.commands == report.equal == summary.commands.total() + summary.refused - kept_back
        assert report.ticks == summary.ticks > 0
        assert report.values > 50
        assert report.differences == {} and report.renamed == {} and report.ended is None
        with server.client() as other:
            assert other.get_world_info()["mode"] == "lockstep"


def test_another_engine_differs_and_shows_where(busy_file: Path) -> None:
    with served({"backend": "mujoco"}) as server:
        report = against(busy_file, lambda: server.client().connect(), tolerance=1e-9)
        assert report.verdict == "different"
        assert 0 < report.equal < report.commands
        fields = {(item.command, item.field): item for item in report.fields}
        place = fields["get_cube_info", "position/1"]
        assert place.count == 8
        assert place.first.cube == "one" and place.first.frame == 1 and place.first.client == 1
        assert place.first.difference is not None and place.worst.difference is not None
        assert place.worst.difference >= place.first.difference > 0
        assert place.first.difference == abs(place.first.actual - place.first.expected)
        assert ("step", "frame") not in fields
        # What is near enough is equal.
        near = against(busy_file, lambda: server.client().connect(), tolerance=10.0)
        assert not any("position" in item.field for item in near.fields)
        assert near.equal > report.equal


class Stranger:
    """A server of another's making: a world of ours behind other names, with what it is told to do wrong."""

    def __init__(self, spoil: Spoil) -> None:
        self.world = World({"backend": "ballistic", "mode": "lockstep"})
        self.spoil = spoil
        self.heard: list[dict[str, Any]] = []

    def connect(self) -> RemoteConnection:
        return Line(self, self.world.join())


class Line:
    """A connection to a stranger: the names that it speaks of begin with `their_`."""

    def __init__(self, stranger: Stranger, client: int) -> None:
        self.stranger = stranger
        self.client = client

    def request(self, message: Mapping[str, Any]) -> Any:
        self.stranger.heard.append(dict(message))
        text = json.dumps(message).replace("their_", "")
        reply = json.loads(self.stranger.world.handle(self.client, parse(text.encode())))
        for name in ("one", "two", "hinge"):
            reply = json.loads(json.dumps(reply).replace(f'"{name}', f'"their_{name}'))
        answer = self.stranger.spoil(dict(message), reply)
        if answer["type"] == "error":
            raise CommandFailed(answer["code"], answer["message"], answer.get("field"))
        return answer

    def close(self) -> None:
        self.stranger.world.leave(self.client)


def honest(message: dict[str, Any], reply: dict[str, Any]) -> dict[str, Any]:
    return reply


def test_names_that_another_server_chose_are_no_mismatch(busy_file: Path) -> None:
    stranger = Stranger(honest)
    report = against(busy_file, stranger.connect)
    assert (report.verdict, report.fields) == ("equal", [])
    assert report.renamed == {"one": "their_one", "two": "their_two"}
    pushed = {message["cube_name"] for message in stranger.heard if message["type"] == "apply_physics"}
    assert pushed == {"their_one", "their_two"}
    wished = {message["cube_name"] for message in stranger.heard if message["type"] == "spawn_cube"}
    assert wished == {"one", "two"}
    assert report.kept_back == {"a frame that is no valid command": 9}
    assert stranger.world.clients() == []


def spoiled(kind: str, **change: Any) -> Spoil:
    return lambda message, reply: {**reply, **change} if message["type"] == kind else reply


@pytest.mark.parametrize(
    ("spoil", "command", "field", "expected", "actual"),
    [
        (spoiled("get_cube_info", mass=3), "get_cube_info", "mass", 1.0, 3),
        (spoiled("get_cube_info", frozen=0), "get_cube_info", "frozen", False, 0),
        (spoiled("get_cube_info", cube_name="two"), "get_cube_info", "cube_name", "one", "two"),
        (spoiled("step", frame=1.0000001), "step", "frame", 1, 1.0000001),
        (spoiled("get_world_state", cubes=[]), "get_world_state", "cubes", "there", None),
        (spoiled("ping", type="gnop"), "ping", "type", "pong", "gnop"),
        (
            lambda message, reply: {key: part for key, part in reply.items() if key != "sleeping"},
            "get_cube_info",
            "sleeping",
            False,
            None,
        ),
    ],
)
def test_wrong_answers_are_mismatches(
    busy_file: Path, spoil: Any, command: str, field: str, expected: object, actual: object
) -> None:
    report = against(busy_file, Stranger(spoil).connect, tolerance=1e-3)
    assert report.verdict == "different"
    fields = {(item.command, item.field): item for item in report.fields}
    assert (command, field) in fields
    mismatch = fields[command, field].first
    assert (mismatch.expected, mismatch.actual) == (expected, actual)


def test_equal_rotations_and_lists_in_another_order_match(busy_file: Path) -> None:
    def spoil(message: dict[str, Any], reply: dict[str, Any]) -> dict[str, Any]:
        if "quaternion" in reply:
            reply["quaternion"] = [-part for part in reply["quaternion"]]
        if message["type"] == "get_world_state":
            reply["cubes"].reverse()
        return reply

    assert against(busy_file, Stranger(spoil).connect).verdict == "equal"


def turned(quaternion: tuple[float, float, float, float], *angles: float) -> Spoil:
    q = multiply(quaternion_from_euler(*angles), quaternion)
    return spoiled("get_cube_info", rotation=list(euler_from_quaternion(q)), quaternion=list(q))


@pytest.mark.parametrize("rotation", [(0.1, pi - 1e-5, 0.2), (-0.3, 0.5, 1e-5 - pi), (pi / 2 - 1e-7, 1.0, 0.4)])
def test_angles_beyond_a_full_turn_are_compared_as_rotations(tmp_path: Path, rotation: tuple[float, ...]) -> None:
    def play(world: World, client: int) -> None:
        send(world, client, type="spawn_cube", cube_name="one", rotation=rotation)
        send(world, client, type="get_cube_info", cube_name="one")

    path = record(tmp_path / "x.mcap", play)
    q = quaternion_from_euler(*rotation)
    for angles in ((0, 5e-5, 0), (5e-5, 0, 0), (0, 0, -5e-5)):
        assert against(path, Stranger(turned(q, *angles)).connect, tolerance=1e-4).verdict == "equal"
        report = against(path, Stranger(turned(q, *angles)).connect, tolerance=1e-5)
        assert report.verdict == "different"
    if abs(rotation[0]) < 1:
        # What differs is the angle, and not by a whole turn.
        amounts = [item.worst.difference for item in report.fields if item.field.startswith("rotation")]
        assert all(amount is not None and amount < 1e-4 for amount in amounts) and amounts


def refusing(*kinds: str) -> Spoil:
    refusal = {"type": "error", "code": "unknown_type", "message": "what?"}
    return lambda message, reply: refusal if message["type"] in kinds else reply


def test_commands_that_a_server_does_not_know_are_listed(busy_file: Path) -> None:
    report = against(busy_file, Stranger(refusing("get_world_state", "set_mode")).connect)
    assert (report.verdict, report.fields) == ("incomplete", [])
    assert report.unsupported == {"get_world_state": 1}
    assert "set_mode at the beginning, which the server refuses (unknown_type: what?)" in report.kept_back


def test_a_replay_to_a_server_that_cannot_step_ends_at_the_first_tick(busy_file: Path) -> None:
    report = against(busy_file, Stranger(refusing("step")).connect)
    assert report.verdict == "incomplete"
    assert report.ended == "at frame 1 the server does not know step, which made the world tick"
    assert (report.ticks, report.commands) == (0, 4)


def test_a_replay_to_a_server_that_hangs_up_ends(busy_file: Path) -> None:
    def spoil(message: dict[str, Any], reply: dict[str, Any]) -> dict[str, Any]:
        if message["type"] == "get_cube_info":
            raise Disconnected("disconnected", "gone")
        return reply

    report = against(busy_file, Stranger(spoil).connect)
    assert report.verdict == "incomplete"
    assert report.ended == "at frame 1, asked to get_cube_info: gone"


def test_a_world_of_another_config_is_reported(busy_file: Path) -> None:
    with served({"backend": "ballistic", "gravity": [0, -5, 0]}) as server:
        report = against(busy_file, lambda: server.client().connect())
        assert report.verdict == "different"
        assert report.differences["gravity"][1] == [0, -5, 0]


# -- the command -----------------------------------------------------------------------------------------------------


def run(*arguments: str | Path, password: str) -> tuple[int, str]:
    result = CliRunner().invoke(main, [str(argument) for argument in arguments], env={"NMES_PASSWORD": password})
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.output


def test_nmes_replay_against_a_server(busy_file: Path) -> None:
    with served({"backend": "ballistic"}) as server:
        client: Client = server.client()
        address, password = f"127.0.0.1:{server.port}", client._password
        code, output = run("replay", busy_file, "--against", address, password=password)
        assert code == 0
        assert output.startswith("equal: 38 commands, 40 ticks, ")
        assert "not sent: a frame that is no valid command (9 times)" in output
        code, output = run("replay", busy_file, "--against", address, "--json", password=password)
        report = json.loads(output)
        assert (code, report["verdict"], report["kept_back"]) == (0, "equal", {"a frame that is no valid command": 9})
        assert {"commands", "ticks", "wall_seconds", "differences", "damage"} <= set(report)
        code, output = run("replay", busy_file, "--against", address, "--backend", "x", password=password)
        assert code == 2 and "goes with none of" in output
        code, output = run("replay", busy_file, "--against", address, password="wrong")
        assert code == 2 and "Error: " in output
    code, output = run("replay", busy_file, "--against", address, password=password)
    assert code == 2 and "cannot connect" in output
    code, output = run("replay", busy_file, "--tolerance", "1", password=password)
    assert code == 2 and "need --against" in output
    with served({"name": "first", "backend": "ballistic"}, {"name": "other", "backend": "mujoco"}) as server:
        address, password = f"127.0.0.1:{server.port}", server.client()._password
        code, output = run("replay", busy_file, "--against", address, "--world", "first", password=password)
        assert code == 0
        code, output = run("replay", busy_file, "--against", address, "--world", "none", password=password)
        assert code == 2 and "none" in output
        code, output = run(
            "replay", busy_file, "--against", address, "--world", "other", "--tolerance", "1e-9", password=password
        )
        assert code == 1
        assert output.startswith("different: ")
        assert "position/1" in output and "worst" in output and "frame 1, one:" in output
