"""Many cubes joined by one command: which ones, all or none, and no more than may be."""

from __future__ import annotations

from collections.abc import Iterator
from math import pi

import pytest

from nmes.schemas.documents import JsonObject
from nmes.world import World


class Builder:
    """One client of a world."""

    def __init__(self, **config: object) -> None:
        self.world = World({"backend": "mujoco", "mode": "lockstep", "gravity": [0, 0, 0], **config})
        self.client = self.world.join()

    def __call__(self, kind: str, **fields: object) -> JsonObject:
        return self.world.execute(self.client, {"type": kind, **fields})

    def spawn(self, name: str, *position: float, **fields: object) -> None:
        assert self("spawn_cube", cube_name=name, position=position, list=False, **fields)["type"] == "cube_list"


@pytest.fixture
def build() -> Iterator[Builder]:
    builder = Builder()
    yield builder
    builder.world.close()


@pytest.mark.parametrize(
    ("place", "more", "linked"),
    [
        ([1.0, 0, 0], {}, True),
        ([1.1, 0, 0], {}, True),
        ([1.2, 0, 0], {}, False),
        ([0, 1.1, 0.5], {}, True),
        ([0, 1.1, 0.95], {}, False),  # only an edge is opposite
        ([1.0, 1.0, 0], {}, False),  # a diagonal neighbour
        ([1.15, 0, 0], {"rotation": [0, 0, pi / 4]}, True),  # its edge comes nearer
        ([1.6, 0, 0], {"size": [2, 1, 1]}, True),
        ([0.2, 0.1, 0], {}, True),  # one in the other
    ],
)
def test_cubes_are_neighbours_where_their_faces_nearly_touch(
    build: Builder, place: list[float], more: JsonObject, linked: bool
) -> None:
    build.spawn("part_1", 0, 5, 0)
    build.spawn("part_2", place[0], 5 + place[1], place[2], **more)
    assert len(build("link_body_cubes", prefix="part_")["joints"]) == linked
    assert len(build("link_body_cubes", prefix="part_", gap=1.0)["joints"]) == (not linked and place[1:] == [0, 0])


def test_a_chain_that_cannot_be_linked_whole_is_not_linked_at_all(build: Builder) -> None:
    for n in range(4):
        build.spawn(f"c{n}", 1.1 * n, 5, 0)
    before = build.world.snapshot()
    for chains, code, field in (
        ([["c0", "c1", "nobody"]], "cube_not_found", "chains/0/2"),
        ([["c0", "c1"], ["c2", "c2"]], "self_joint", "chains/1"),
        ([["c0", "c1"]] * 600 + [["c0", "c1", "c2"]] * 300, "limit_reached", "chains"),
    ):
        reply = build("link_cube_chains", chains=chains)
        assert (reply["code"], reply["field"]) == (code, field)
    assert build("link_cube_chains", chains=[["c0", "c1"]], joint_type="pin", joint_params={"stiffness": 1})[
        "code"
    ] == ("unsupported")
    assert build.world.snapshot() == before


def test_joints_stay_within_the_limits_of_world_and_engine() -> None:
    build = Builder(limits={"cubes": 2000, "joints": 1200})
    for n in range(1100):
        build.spawn(f"c{n}", 1.1 * (n % 40), 5, 1.1 * (n // 40))
    names = [f"c{n}" for n in range(1100)]
    assert len(build("link_cube_chains", chains=[names[:900]])["joints"]) == 899
    too_large = build("link_cube_chains", chains=[names[899:1050]])
    assert (too_large["code"], "1000 cubes" in too_large["message"]) == ("limit_reached", True)
    too_many = build("link_cube_chains", chains=[["c1000", "c1001"]] * 302)
    assert (too_many["code"], "1200" in too_many["message"]) == ("limit_reached", True)
    assert len(build.world.joints()) == 899
    assert build("link_body_cubes", prefix="c")["code"] == "limit_reached"  # more than 1,000 cubes
    build.world.close()


def test_a_joint_keeps_a_few_notes(build: Builder) -> None:
    build.spawn("a", 0, 5, 0)
    build.spawn("b", 1.1, 5, 0)
    build("create_joint", cube1="a", cube2="b", joint_type="fixed", joint_name="ab", notes={"age": 3})
    assert build("set_joint_params", joint_name="ab", params={}, notes={"weight": 2.5})["params"] == {}
    assert build("get_joint_info", joint_name="ab")["notes"] == {"age": 3, "weight": 2.5}
    over = build("set_joint_params", joint_name="ab", params={}, notes={f"n{n}": n for n in range(31)})
    assert (over["code"], over["field"]) == ("limit_reached", "notes")
    assert build("get_joint_info", joint_name="ab")["notes"] == {"age": 3, "weight": 2.5}


def test_a_cube_changes_its_colour_and_nothing_else(build: Builder) -> None:
    build.spawn("a", 0, 5, 0, color=[1, 0, 0])
    digest, version = build.world.digest(), build.world.structure_version
    assert build("set_color", cube_name="a", color=[0, 0.5, 1])["color"] == [0, 0.5, 1, 1]
    assert build("get_cube_info", cube_name="a")["color"] == [0, 0.5, 1, 1]
    assert build.world.digest() == digest
    assert build.world.structure_version > version  # viewers look again
    build.world.tick()
    build("set_color", cube_name="a", color=[0, 1, 0])
    assert build.world.rebuild_cost == 0.0  # the engine has nothing to take up


def test_a_push_that_names_nothing_that_acts_is_invalid(build: Builder) -> None:
    build.spawn("a", 0, 5, 0)
    for fields in ({}, {"at": [0, 0, 0]}, {"forze": [0, 1, 0]}):
        reply = build("apply_physics", cube_name="a", **fields)
        assert (reply["code"], reply.get("ignored")) == ("invalid", ["forze"] if "forze" in fields else None)
    assert build("apply_physics", torque=[0, 0, 0])["type"] == "physics_applied"
