"""Creatures that lose parts: what is left of them goes on, and so do recordings, keyframes and brains."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import pytest

from nmes.errors import WorldError
from nmes.genome import Genome
from nmes.playback import replay
from nmes.recording import Recorder
from nmes.world import World
from nmes.world.snapshot import pack, unpack

Json = dict[str, Any]
ENGINES = ("mujoco", "pymunk")
# A trunk, to its left and right a leg of two cubes; the right foot also hangs on the trunk.
CUBES = {"trunk": (0, 0), "left": (-0.5, 0), "leftfoot": (-1, 0), "right": (0.5, 0), "rightfoot": (1, 0)}
HINGES = {"a": ("trunk", "left"), "b": ("left", "leftfoot"), "c": ("trunk", "right"), "d": ("right", "rightfoot")}


def genome(loop: bool = False) -> Json:
    cubes = [
        {"id": name, "size": [0.3, 0.3, 0.3], "mass": 1, "position": [x, 0.3, z]} for name, (x, z) in CUBES.items()
    ]
    motor = {"mode": "velocity", "range": [-4, 4], "max_effort": 5}
    joints: list[Json] = [
        {"id": name, "type": "hinge", "cube1": one, "cube2": two, "axis": [0, 0, 1], "motor": motor}
        | {"anchor": [(CUBES[one][0] + CUBES[two][0]) / 2, 0.3, 0]}
        for name, (one, two) in HINGES.items()
    ]
    if loop:
        joints.append({"id": "e", "type": "pin", "cube1": "trunk", "cube2": "rightfoot", "anchor": [0.5, 0.3, 0]})
    sensors = [{"type": "position", "joint": name} for name in HINGES]
    sensors += [{"type": kind, "cube": name} for name in CUBES for kind in ("height", "velocity")]
    nodes = [{"id": name, "motor": name, "bias": 0.1} for name in HINGES]
    links = [{"sensor": f"{name}.position", "to": name, "weight": 0.7} for name in HINGES]
    brain = {"kind": "graph", "nodes": nodes, "links": links}
    body = {"cubes": cubes, "joints": joints}
    return {"format": "nmes-genome/1", "name": "bat", "body": body, "sensors": sensors, "brain": brain}


class Place:
    """A world with one creature, a client, and the events that it is told."""

    def __init__(self, loop: bool = False, autonomous: bool = False, path: Path | None = None, **config: Any) -> None:
        self.events: list[Json] = []
        asked = {"mode": "lockstep", **config}
        self.world = World(asked, emit=lambda _, event: self.events.append(orjson.loads(event)))
        self.recorder = None if path is None else Recorder(path, self.world)
        self.world.journal = self.recorder
        self.client = self.world.join()
        self("subscribe", events=["creatures"])
        self("spawn_creature", genome=genome(loop), name="bat", position=[0, 2, 0], autonomous=autonomous)

    def __call__(self, kind: str, **fields: Any) -> Json:
        return self.world.execute(self.client, {"type": kind, **fields})

    @property
    def values(self) -> dict[str, float]:
        names = [sensor.id for sensor in Genome(genome()).body.sensors]
        return dict(zip(names, np.asarray(self("sense", creature="bat")["values"]).tolist(), strict=True))


@pytest.mark.parametrize("backend", ENGINES)
@pytest.mark.parametrize(
    ("cut", "cubes", "joints"),
    [
        ({"kind": "despawn_cube", "cube_name": "bat.leftfoot"}, {"leftfoot"}, {"b"}),
        ({"kind": "despawn_cube", "cube_name": "bat.left"}, {"left", "leftfoot"}, {"a", "b"}),
        ({"kind": "remove_joint", "joint_name": "bat.a"}, {"left", "leftfoot"}, {"a", "b"}),
        ({"kind": "shed", "creature": "bat", "part": "left"}, {"left", "leftfoot"}, {"a", "b"}),
        ({"kind": "shed", "creature": "bat", "part": "rightfoot", "remove": True}, {"rightfoot"}, {"d"}),
    ],
)
def test_what_hangs_on_the_root_remains_the_creature(
    cut: Json, cubes: set[str], joints: set[str], backend: str
) -> None:
    place = Place(backend=backend)
    before, twin = place.values, Place(backend=backend)
    assert place(**cut)["type"] != "error"
    after = place.values
    for name, value in after.items():
        owner = name.partition(".")[0]
        assert value == (0.0 if owner in cubes | joints else before[name]), name
    place.world.tick()
    (event,) = place.events
    layout = 1 + len(cubes) + len(joints)
    assert event == {
        "type": "creature_changed", "frame": 1, "creature": "bat", "layout": layout,
        "lost_cubes": [name for name in CUBES if name in cubes],
        "lost_joints": [name for name in HINGES if name in joints],
    }  # fmt: skip
    # What is left is driven as ever, and what is lost is not.
    for each in (place, twin):
        assert each("drive", creature="bat", controls=[0.5] * 4).get("layout", 1) == (layout if each is place else 1)
    for name in HINGES:
        for each in (place, twin):
            info = each("get_joint_info", joint_name=f"bat.{name}")
            if info["type"] != "error":
                target = info["params"]["motor_target_velocity"]
                assert target == (0.0 if each is place and name in joints else 2.0), name


def test_a_part_on_two_joints_hangs_on_either() -> None:
    place = Place(loop=True)
    place("remove_joint", joint_name="bat.c")
    assert place("sense", creature="bat")["layout"] == 2
    assert place("shed", creature="bat", part="right")["cubes"] == ["bat.right"]
    place("remove_joint", joint_name="bat.e")
    place.world.tick()
    assert place.events[-1]["lost_cubes"] == ["right", "rightfoot"] and place.events[-1]["layout"] == 1 + 2 + 3


def test_what_is_cut_off_stays_lost_whatever_it_is_joined_to() -> None:
    place = Place()
    place("shed", creature="bat", part="left")
    ends = {"cube1": "bat.trunk", "cube2": "bat.left", "joint_type": "hinge", "joint_name": "bat.a"}
    assert place("create_joint", **ends)["type"] == "joint_created"
    assert place.values["left.height"] == 0.0
    place("drive", creature="bat", controls=[1.0] * 4)
    assert place("get_joint_info", joint_name="bat.a")["params"]["motor_target_velocity"] == 0.0


def test_what_cannot_be_shed_is_refused_and_nothing_changes() -> None:
    place = Place()
    place("shed", creature="bat", part="leftfoot")
    digest = place.world.digest()
    for fields, code in (
        ({"creature": "bat", "part": "trunk"}, "invalid"),
        ({"creature": "bat", "part": "leftfoot"}, "cube_not_found"),
        ({"creature": "bat", "part": "bat.left"}, "cube_not_found"),
        ({"creature": "owl", "part": "left"}, "creature_not_found"),
    ):
        reply = place("shed", **fields)
        assert (reply["code"], reply["field"]) == (code, "creature" if code.startswith("creature") else "part")
    reply = place("drive", creature="bat", controls=[0.0] * 4, layout=1)
    assert (reply["code"], reply["field"]) == ("layout_changed", "layout")
    assert place.world.digest() == digest


def test_a_brain_of_the_world_goes_on_with_what_is_left() -> None:
    place = Place(autonomous=True)
    for _ in range(20):
        place.world.tick()
    place("shed", creature="bat", part="left")
    for _ in range(60):
        place.world.tick()
    assert place.world.fault is None and place.world.creatures() == ["bat"]
    speed = place("get_joint_info", joint_name="bat.c")["params"]["motor_target_velocity"]
    left = place("get_joint_info", joint_name="bat.b")["params"]["motor_target_velocity"]
    place.world.tick()
    assert place("get_joint_info", joint_name="bat.c")["params"]["motor_target_velocity"] != speed
    assert place("get_joint_info", joint_name="bat.b")["params"]["motor_target_velocity"] == left


def program(place: Place, seed: int, ticks: int = 40) -> None:
    """Cuts, sheds, joins, drives and takes away whatever there is, at random."""
    draw = random.Random(seed)
    for _ in range(ticks):
        kind = draw.choice(["shed", "despawn_cube", "remove_joint", "create_joint", "drive", "spawn", "tick", "tick"])
        cubes, joints = place.world.cubes(), place.world.joints()
        if kind == "shed":
            place(kind, creature="bat", part=draw.choice(list(CUBES)), remove=draw.random() < 0.5)
        elif kind == "despawn_cube" and cubes and draw.random() < 0.4:
            place(kind, cube_name=draw.choice(cubes))
        elif kind == "remove_joint" and joints:
            place(kind, joint_name=draw.choice(joints))
        elif kind == "create_joint" and len(cubes) > 1:
            one, two = draw.sample(cubes, 2)
            place(kind, cube1=one, cube2=two, joint_type=draw.choice(["hinge", "fixed"]))
        elif kind == "drive":
            place(kind, creature="bat", controls=[draw.uniform(-1, 1) for _ in range(4)])
        elif kind == "spawn" and "bat" not in place.world.creatures() and "bat.trunk" not in cubes:
            place("spawn_creature", genome=genome(draw.random() < 0.5), position=[0, 3 + 3 * draw.random(), 0])
        place.world.tick()
        assert place.world.fault is None, (seed, place.world.fault)


def check_programs(seeds: range, folder: Path, backend: str) -> None:
    for seed in seeds:
        path = folder / f"{backend}-{seed}.mcap"
        place, again = (
            Place(loop=seed % 2 == 1, path=each, backend=backend, keyframes=0.2, seed=seed) for each in (None, path)
        )
        program(place, seed)
        program(again, seed)
        assert again.recorder is not None
        again.recorder.close()
        assert place.world.digest() == again.world.digest(), seed
        assert place.events == again.events, seed
        assert replay(path).verdict == "reproduced", seed
        if backend == "mujoco":  # which has snapshots
            assert replay(path, first=25).verdict == "reproduced", seed
            check_restored(place.world)


def check_restored(world: World) -> None:
    restored = World(world.config)
    restored.restore(world.snapshot())
    for _ in range(10):
        assert restored.digest() == world.digest()
        restored.tick()
        world.tick()


@pytest.mark.parametrize("backend", ENGINES)
def test_random_programs_of_loss_are_repeated_and_restored(backend: str, tmp_path: Path) -> None:
    check_programs(range(10), tmp_path, backend)


@pytest.mark.long
@pytest.mark.parametrize("backend", ENGINES)
def test_five_hundred_random_programs_of_loss(backend: str, tmp_path: Path) -> None:
    check_programs(range(10, 510), tmp_path, backend)


@pytest.mark.parametrize("lost", [{"cubes": ["trunk"], "joints": []}, {"cubes": [], "joints": ["zzz"]}, {"cubes": 3}])
def test_a_keyframe_that_says_nonsense_of_lost_parts_is_refused(lost: Any) -> None:
    place = Place()
    place("shed", creature="bat", part="left")
    state, engine = unpack(place.world.snapshot(), place.world.config)
    del state["version"], state["config"]
    state["creatures"]["creatures"][0]["lost"] = lost
    with pytest.raises(WorldError) as caught:
        World(place.world.config).restore(pack(place.world.config, state, engine))
    assert caught.value.code == "bad_snapshot"
