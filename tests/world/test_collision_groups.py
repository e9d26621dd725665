"""Collision groups: cubes that a world's config lets pass through each other, alive, recorded and saved."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from nmes import World, protocol
from nmes.errors import RejectedMessage, WorldError
from nmes.playback import replay
from nmes.recording import Recorder

GROUPS = {"ghosts": ["ghosts", "walls"], "walls": []}
ENGINES = ("mujoco", "pymunk")


class Place:
    """A world in lockstep, and one client in it."""

    def __init__(self, **config: Any) -> None:
        self.world = World({"mode": "lockstep", **config})
        self.client = self.world.join()

    def __call__(self, kind: str, **fields: Any) -> dict[str, Any]:
        return self.world.execute(self.client, {"type": kind, **fields})

    def spawn(self, name: str, y: float, group: str | None = None, **fields: Any) -> str:
        chosen = {} if group is None else {"group": group}
        reply = self("spawn_cube", cube_name=name, position=[0, y, 0], list=False, **chosen, **fields)
        return str(reply["spawned"])

    def height(self, name: str, seconds: float = 1.5) -> float:
        self("step", ticks=round(60 * seconds))
        return float(self("get_cube_state", cube_name=name)["position"][1])


def stacked(lower: str | None, upper: str | None, *, base: bool, **config: Any) -> float:
    """Returns how high a cube comes to rest that falls on another."""
    place = Place(collision_groups=GROUPS, **config)
    place.spawn("low", 0.5, lower, is_base=base)
    return place.height(place.spawn("high", 2.0, upper))


@pytest.mark.parametrize("backend", ENGINES)
@pytest.mark.parametrize("base", [False, True])
@pytest.mark.parametrize(
    ("lower", "upper", "height"),
    [
        ("ghosts", "ghosts", 0.5),
        ("walls", "ghosts", 0.5),
        ("ghosts", "walls", 0.5),  # named by either is enough
        ("walls", "walls", 1.5),
        (None, "ghosts", 1.5),
        ("ghosts", None, 1.5),
        (None, None, 1.5),
    ],
)
def test_cubes_pass_through_each_other_where_the_config_says_so(
    lower: str | None, upper: str | None, height: float, base: bool, backend: str
) -> None:
    # Side by side within the other, two free cubes of one shape would balance: the ground is what carries both.
    assert stacked(lower, upper, base=base, backend=backend) == pytest.approx(height, abs=0.02)


@pytest.mark.parametrize("meets", [True, False])
def test_a_crowd_that_glides_apart_passes_through_what_its_group_does(meets: bool) -> None:
    others: dict[str, list[str]] = {f"g{i}": [] for i in range(13)}  # walls are the last of all
    place = Place(collision_groups={"balls": [] if meets else ["walls"], "walls": [], **others})
    place.spawn("wall", 5.0, "walls", size=[4, 1, 4], is_base=True)
    names = [place.spawn(f"b{i}", 5.0, "balls", size=0.4) for i in range(8)]
    touched = set()
    for _ in range(20):
        place("step", ticks=1)
        infos = [place("get_cube_info", cube_name=name) for name in names]
        touched |= {contact["cube_name"] for info in infos for contact in info["contacts"]}
    assert ("wall_BASE" in touched) == meets
    assert max(abs(info["position"][0]) for info in infos) > 0.3  # they did glide


def test_cubes_in_one_place_that_pass_through_each_other_stay_there() -> None:
    place = Place(collision_groups=GROUPS)
    names = [place.spawn(f"g{i}", 0.5, "ghosts") for i in range(8)]
    place("step", ticks=60)
    assert [place(*("get_cube_state",), cube_name=name)["position"] for name in names] == [
        pytest.approx([0, 0.5, 0], abs=1e-2)
    ] * 8


def test_ghosts_in_a_big_world_take_parked_places_and_leave_them_clean() -> None:
    place = Place(collision_groups=GROUPS)
    for i in range(70):
        place("spawn_cube", cube_name=f"c{i}", position=[3 * (i % 10), 0.5, 3 + 3 * (i // 10)], list=False)
    place("step", ticks=2)
    place.spawn("wall", 0.5, "walls")
    place("step", ticks=2)
    assert place.height(place.spawn("ghost", 2.0, "ghosts")) == pytest.approx(0.5, abs=0.02)
    place("despawn_cube", cube_name="ghost")
    place("step", ticks=2)
    assert place.height(place.spawn("solid", 2.0)) == pytest.approx(1.5, abs=0.02)


@pytest.mark.parametrize("backend", ENGINES)
def test_a_group_that_the_world_has_not_is_refused(backend: str) -> None:
    place = Place(collision_groups=GROUPS, backend=backend)
    reply = place("spawn_cube", group="spirits")
    assert (reply["code"], reply["field"]) == ("invalid", "group")
    assert "ghosts, walls" in reply["message"]
    assert place.world.cubes() == []
    reply = Place(backend=backend)("spawn_cube", group="ghosts")
    assert (reply["code"], reply["field"]) == ("invalid", "group")


def test_a_config_of_groups_that_are_not_there_is_refused() -> None:
    with pytest.raises(RejectedMessage) as refusal:
        World({"collision_groups": {"ghosts": ["ghosts", "spirits"]}})
    assert refusal.value.path == "collision_groups/ghosts/1"
    with pytest.raises(RejectedMessage) as refusal:
        World({"collision_groups": {f"g{i}": [] for i in range(16)}})
    assert refusal.value.path == "collision_groups"


def test_an_engine_without_groups_refuses_the_config() -> None:
    with pytest.raises(RejectedMessage) as refusal:
        World({"backend": "ballistic", "collision_groups": GROUPS})
    assert (refusal.value.code, refusal.value.path) == ("unsupported", "collision_groups")


def test_the_group_of_a_cube_is_told() -> None:
    place = Place(collision_groups=GROUPS)
    place.spawn("ghost", 1.0, "ghosts")
    place.spawn("plain", 3.0)
    info = place("get_cube_info", cube_name="ghost")
    protocol.validate_reply(info)
    assert info["group"] == "ghosts"
    assert "group" not in place("get_cube_info", cube_name="plain")


def genome(group: str | None) -> dict[str, Any]:
    chosen = {} if group is None else {"group": group}
    cubes = [
        {"id": "a", "size": 0.5, "mass": 1, "position": [0, 0.25, 0], **chosen},
        {"id": "b", "size": 0.5, "mass": 1, "position": [0.6, 0.25, 0]},
    ]
    joint = {"id": "j", "cube1": "a", "cube2": "b", "type": "fixed", "anchor": [0.3, 0.25, 0]}
    return {"format": "nmes-genome/1", "name": "pair", "body": {"cubes": cubes, "joints": [joint]}}


def grown(group: str) -> dict[str, Any]:
    parts = [{"id": "a", "size": 0.5, "group": group, "recursive_limit": 2}]
    graph = {"root": "a", "parts": parts, "connections": [{"from": "a", "to": "a", "face": "+x"}]}
    return {"format": "nmes-genome/1", "name": "grown", "body": {"graph": graph}}


def test_parts_of_creatures_have_groups() -> None:
    place = Place(collision_groups=GROUPS)
    place("spawn_creature", genome=genome("ghosts"), name="one")
    place("spawn_creature", genome=grown("walls"), name="two", position=[0, 0, 4])
    groups = [cube.group for cube in place.world.entities.cubes.values()]
    assert groups == ["ghosts", None, "walls", "walls"]
    reply = place("spawn_creature", genome=genome("spirits"), name="three")
    assert (reply["code"], reply["field"]) == ("invalid", "genome/body")
    assert "spirits" in reply["message"] and len(place.world.cubes()) == 4


def test_groups_are_recorded_and_saved(tmp_path: Path) -> None:
    path = tmp_path / "ghosts.mcap"
    world = World({"mode": "lockstep", "collision_groups": GROUPS, "keyframes": 0.5})
    recorder = Recorder(path, world)
    world.journal = recorder
    client = world.join()
    for i in range(4):
        group = {"group": "ghosts"} if i % 2 else {}
        world.execute(client, {"type": "spawn_cube", "position": [0, 1 + 0.8 * i, 0], **group})
    world.execute(client, {"type": "step", "ticks": 50})
    saved = world.snapshot()
    other = World(world.config)
    other.restore(saved)
    for one in (world, other):
        for _ in range(30):
            one.tick()
    assert other.digest() == world.digest()
    assert other.snapshot() == world.snapshot()
    recorder.close()
    assert replay(path).verdict == "reproduced"


def test_a_snapshot_of_unknown_groups_is_refused() -> None:
    place = Place(collision_groups=GROUPS)
    place.spawn("ghost", 1.0, "ghosts")
    saved = place.world.snapshot()
    for forged in (
        saved.replace(b'"group":"ghosts"', b'"group":"phantom"'),
        saved.replace(b'"group":1', b'"group":9'),
        saved.replace(b'"group":1', b'"group":true'),
    ):
        assert forged != saved
        with pytest.raises(WorldError) as refusal:
            place.world.restore(forged)
        assert refusal.value.code == "bad_snapshot"


def test_a_world_without_groups_says_nothing_of_them() -> None:
    place = Place()
    place.spawn("plain", 1.0)
    assert b'"group"' not in place.world.snapshot()
    ballistic = Place(backend="ballistic")
    ballistic.spawn("plain", 1.0)
    assert b'"group"' not in ballistic.world.snapshot()
