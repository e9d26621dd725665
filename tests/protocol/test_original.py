"""What the words of the original server do here: bytes into a raw session, its requests into a world."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest

from nmes.protocol import DELIMITER, Session
from nmes.world import World

Message = dict[str, Any]


class RawClient:
    """A client of a world that has logged in with the bare password."""

    def __init__(self, **config: Any) -> None:
        self.world = World({"backend": "mujoco", "mode": "lockstep", "gravity": [0, 0, 0], **config})
        self.number = self.world.join()
        self.session = Session()
        self.session.receive(b"open sesame" + DELIMITER)
        self.session.accept({})
        self.recorded: list[Message] = []

    def send(self, kind: str, **fields: Any) -> bytes:
        """Returns what the server answers, delimiter included; nothing where it is silent."""
        (frame,) = self.session.receive(json.dumps({"type": kind, **fields}).encode() + DELIMITER)
        assert isinstance(frame, bytes)
        request = self.session.parse(frame)
        self.recorded.append(json.loads(request.raw))
        return self.session.reply(request, self.world.handle(self.number, request))

    def ask(self, kind: str, **fields: Any) -> Message:
        """Returns the one answer."""
        answer, rest = self.send(kind, **fields).split(DELIMITER)
        assert rest == b""
        message = json.loads(answer)
        assert isinstance(message, dict)
        return message

    def spawn(self, name: str, *position: float, **fields: Any) -> None:
        assert self.send("spawn_cube", cube_name=name, position=position, **fields) == b""

    def velocity(self, name: str) -> list[float]:
        velocity: list[float] = self.ask("get_cube_state", cube_name=name)["linear_velocity"]
        return velocity


@pytest.fixture
def raw() -> Iterator[RawClient]:
    client = RawClient()
    yield client
    client.world.close()


# -- forces -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "field"),
    [("apply_force", "force"), ("apply_physics", "impulse"), ("apply_physics", "central_impulse")],
)
def test_a_force_of_the_original_changes_the_velocity_at_once_by_force_by_mass(
    raw: RawClient, kind: str, field: str
) -> None:
    raw.spawn("heavy", 0, 10, 0, mass=4.0)
    raw.spawn("mine", 5, 10, 0)
    assert raw.send(kind, **{field: [0, 2, 0]}) == b""
    assert raw.send(kind, cube_name="heavy", **{field: [2, 0, 0]}) == b""
    raw.world.tick()
    assert raw.velocity("mine") == pytest.approx([0, 2, 0], abs=1e-9)
    assert raw.velocity("heavy") == pytest.approx([0.5, 0, 0], abs=1e-9)
    raw.world.tick()
    assert raw.velocity("mine") == pytest.approx([0, 2, 0], abs=1e-9)


def test_a_force_in_a_batch_of_the_original_means_the_same(raw: RawClient) -> None:
    raw.spawn("mine", 5, 10, 0)
    assert raw.ask("batch", commands=[{"type": "apply_force", "force": [3, 0, 0]}])["results"][0]["type"] != "error"
    raw.world.tick()
    assert raw.velocity("mine") == pytest.approx([3, 0, 0], abs=1e-9)


def test_a_force_of_the_json_dialect_acts_throughout_one_tick() -> None:
    world = World({"backend": "mujoco", "mode": "lockstep", "gravity": [0, 0, 0]})
    client = world.join()
    world.execute(client, {"type": "spawn_cube", "cube_name": "a", "position": [0, 10, 0]})
    world.execute(client, {"type": "apply_force", "force": [60, 0, 0]})
    world.tick()
    state = world.execute(client, {"type": "get_cube_state"})
    assert state["linear_velocity"] == pytest.approx([1, 0, 0], abs=1e-6)


def test_what_is_recorded_is_the_command_in_our_words(raw: RawClient) -> None:
    raw.spawn("a", 0, 10, 0)
    raw.send("apply_force", cube_name="a", force=[1, 0, 0], id=7)
    raw.send("get_cube_list")
    assert raw.recorded[-2:] == [
        {"type": "apply_physics", "cube_name": "a", "impulse": [1, 0, 0], "id": 7},
        {"type": "get_cube_list"},
    ]
