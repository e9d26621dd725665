"""Fields that are not understood: told in the JSON dialect, bounded, and part of no recording's replies."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from test_original import RawClient

from nmes.cli import main
from nmes.playback import replay
from nmes.protocol import COMMANDS, DELIMITER, Session, encode, parse
from nmes.recording import Recorder
from nmes.world import World

Message = dict[str, Any]


def ignored(command: Message) -> list[str]:
    """What the reply to a valid command tells, in the JSON dialect."""
    session = Session()
    session.receive(b'{"type":"auth","password":"x"}' + DELIMITER)
    session.accept({})
    (frame,) = session.receive(encode(command) + DELIMITER)
    assert isinstance(frame, bytes)
    request = session.parse(frame)
    assert request.error is None
    told = json.loads(session.reply(request, b'{"type":"pong"}').removesuffix(DELIMITER))
    assert told.pop("type") == "pong"
    if "ignored" not in told:
        assert told == {}
        return []
    paths: list[str] = told["ignored"]
    return paths


PING = {"type": "ping"}
JOINT = {"type": "create_joint", "cube1": "a", "cube2": "b", "joint_type": "hinge"}


@pytest.mark.parametrize(
    ("command", "paths"),
    [
        ({"type": "ping", "id": 1}, []),
        ({"type": "ping", "": 1, "a/b~c": 2}, ["", "a~1b~0c"]),
        ({"type": "spawn_cube", "colour": [1, 0, 0], "color": [1, 0, 0]}, ["colour"]),
        ({**JOINT, "joint_params": {"limit_upper": 1, "speed": 3}, "notes": {"any": 1}}, ["joint_params/speed"]),
        ({"type": "set_joint_params", "joint_name": "j", "params": {"a": None, "b": {}}}, ["params/a", "params/b"]),
        (
            {
                "type": "batch",
                "commands": [{"type": "ping", "x": 1}, {"type": "ping"}, {**JOINT, "joint_params": {"y": 1}}],
            },
            ["commands/0/x", "commands/2/joint_params/y"],
        ),
    ],
)
def test_a_reply_tells_the_fields_that_are_not_known(command: Message, paths: list[str]) -> None:
    assert ignored(command) == paths
    client = RawClient()
    told = client.world.execute(client.number, command).get("ignored", [])
    assert told == paths
    client.world.close()


def test_no_more_is_told_than_a_little() -> None:
    assert ignored({"type": "ping", **{f"field_{n}": n for n in range(1000)}}) == [f"field_{n}" for n in range(20)]
    assert ignored({"type": "ping", "x" * 100_000: 1}) == ["x" * 64]


@pytest.mark.parametrize("kind", COMMANDS)
def test_no_field_of_a_schema_is_told(kind: str) -> None:
    for example in COMMANDS[kind].schema["examples"]:
        assert parse(encode({**example, "id": 5})).ignored == ()


def test_info_lists_what_was_not_understood_and_the_recording_replays(tmp_path: Path) -> None:
    client = RawClient()
    path = tmp_path / "run.mcap"
    client.world.journal = recorder = Recorder(path, client.world)
    for name, x in (("a", 0.0), ("b", 1.1)):
        client.spawn(name, x, 10, 0, flavour=3)
    for _ in range(3):
        client.ask("create_joint", cube1="a", cube2="b", joint_type="hinge", joint_params={"bias": 0.3, "foo": 1})
    client.send("apply_force", force=[1, 0, 0])
    client.ask("batch", commands=[{"type": "ping", "x": 1}, {"type": "ping", "x": 2}])
    for _ in range(5):
        client.world.tick()
    client.world.journal = None
    recorder.close()
    about = json.loads(CliRunner().invoke(main, ["info", str(path), "--json"]).output)
    assert about["ignored"] == {"create_joint joint_params/foo": 3, "spawn_cube flavour": 2, "batch commands/*/x": 2}
    assert about["without_effect"] == {"create_joint bias": 3}
    text = CliRunner().invoke(main, ["info", str(path)]).output
    assert "not understood" in text and "create_joint joint_params/foo" in text and "create_joint bias" in text
    assert replay(path).verdict == "reproduced"
    client.world.close()


def test_what_is_told_is_no_part_of_a_recorded_reply(tmp_path: Path) -> None:
    world = World({"backend": "ballistic", "mode": "lockstep"})
    path = tmp_path / "run.mcap"
    world.journal = recorder = Recorder(path, world)
    client = world.join()
    assert world.execute(client, {"type": "ping", "x": 1})["ignored"] == ["x"]
    recorder.close()
    assert b"ignored" not in path.read_bytes()
