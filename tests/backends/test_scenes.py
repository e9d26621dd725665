"""Scenes as a whole, arenas, damping and settings: what the config makes, and whether it is the same again."""

from __future__ import annotations

import base64
import io
import json
import math
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import programs
import recordings
from layout import ROOT, SUPPORT
from nmes import World, protocol, schemas
from nmes.backend import Arena, Array, Heightfield, SceneSpec, load_backend
from nmes.backends.mujoco3d import MujocoBackend, MujocoSimulation, arenas
from nmes.backends.mujoco3d.arenas import parts
from nmes.errors import RejectedMessage
from nmes.playback import replay
from nmes.world import scenery

Reply = dict[str, Any]
G = 9.81
DOCUMENT = (ROOT / "docs" / "scenes.md").read_text()
DAMPING = {"linear": 0.4, "angular": 0.1}
ARENAS = ["bowl", "corridor", "gaps", "walls", "maze"] if arenas.missing() is None else []
with_arenas = pytest.mark.skipif(not ARENAS, reason="what makes arenas has no wheels for this Python")


def png(pixels: Array, *, mode: str = "L") -> str:
    """Returns an image in base64, as a config holds it."""
    kind = np.uint16 if mode == "I;16" else np.uint8
    file = io.BytesIO()
    Image.fromarray(pixels.astype(kind)).save(file, "PNG")
    return base64.b64encode(file.getvalue()).decode()


HILLS = {"type": "heightfield", "heightfield": {"size": [20, 20], "samples": [41, 41], "height": 2, "hill": 5}}
IMAGE = png(np.add.outer(np.arange(0, 160, 20), np.arange(0, 80, 10)))
SCENES: dict[str, Reply] = {
    "heightfield": HILLS,
    "image": {"type": "heightfield", "heightfield": {"size": [30, 30], "image": IMAGE}},
    "obstacles": {
        "obstacles": [
            {"type": "stairs", "position": [1, 0, 0], "length": 3, "width": 3, "height": 1.5, "steps": 5},
            {"type": "ramp", "position": [-1, 0, 0], "length": 3, "width": 3, "height": 1, "heading": 3.0},
            {"type": "gap", "position": [0, 0, 3], "length": 4, "width": 2, "depth": 1},
            {"type": "wall", "position": [0, 0, -3], "length": 6, "width": 0.2, "height": 2},
            {"type": "box", "position": [3, 3, 3], "size": [2, 1, 2], "rotation": [0.3, 0.2, 0.1]},
        ]
    },
    "planets": {"type": "planets"},
    "corner": {"type": "planets", "planets": {"layout": "corner", "count": 5}},
    **{name: {"type": "arena", "arena": {"name": name}} for name in ARENAS},
}


class Driver:
    """A world in lockstep with one client that takes no refusal."""

    def __init__(self, scene: Reply, **config: Any) -> None:
        self.world = World({"mode": "lockstep", "backend": "mujoco", "scene": scene, **config})
        self.client = self.world.join()

    def __call__(self, type: str, **fields: Any) -> Reply:
        reply = self.world.execute(self.client, {"type": type, **fields})
        assert reply["type"] != "error", reply
        return reply

    def drop(self, name: str, *position: float, size: Any = 1.0, **fields: Any) -> str:
        self("spawn_cube", cube_name=name, position=list(position), size=size, list=False, **fields)
        return name

    def where(self, name: str) -> list[float]:
        position: list[float] = self("get_cube_state", cube_name=name)["position"]
        return position


def spec_of(scene: Reply, seed: int = 0) -> SceneSpec:
    return scenery.scene_spec(protocol.complete_config({"scene": scene}), seed)


def surface(field: Heightfield, x: float, z: float) -> float:
    """The height between the four samples around a place."""
    rows, columns = field.heights.shape
    at = (x / field.size[0] + 0.5) * (columns - 1), (z / field.size[1] + 0.5) * (rows - 1)
    k, i = int(at[0]), int(at[1])
    u, v = at[0] - k, at[1] - i
    a, b, c, d = field.heights[i, k], field.heights[i, k + 1], field.heights[i + 1, k], field.heights[i + 1, k + 1]
    return float((a * (1 - u) + b * u) * (1 - v) + (c * (1 - u) + d * u) * v)


# -- arenas ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ARENAS)
def test_a_cube_finds_ground_where_an_arena_begins(name: str) -> None:
    drive = Driver(SCENES[name])
    drive.drop("a", 0, 1, 0)
    drive("step", ticks=90)
    x, y, z = drive.where("a")
    assert math.hypot(x, z) < 0.1
    assert y == pytest.approx(0.5, abs=0.05 if name == "bowl" else 0.001)


@with_arenas
def test_the_bowl_has_a_rim() -> None:
    drive = Driver(SCENES["bowl"])
    for name, x, z in (("rim", 3, 0), ("opposite", 0, -3), ("outside", 8, 0)):
        drive.drop(name, x, 1, z, size=0.2, friction=5)
    drive("step", ticks=60)
    assert drive.where("rim")[1] > 0.3
    assert drive.where("opposite")[1] > 0.3
    assert drive.where("outside")[1] == pytest.approx(0.1, abs=0.001)


@with_arenas
def test_a_corridor_has_walls_on_all_sides() -> None:
    drive = Driver({"type": "arena", "arena": {"name": "corridor", "width": 6, "length": 10}})
    for name, velocity in {"left": [0, 0, -9], "right": [0, 0, 9], "back": [-9, 0, 0], "ahead": [9, 0, 0]}.items():
        drive.drop(name, 0, 0.6 + 1.1 * len(drive.world.cubes()), 0, friction=0, linear_velocity=velocity)
    drive("step", ticks=150)
    places = {name: drive.where(name) for name in ("left", "right", "back", "ahead")}
    assert all(-2 < x < 12 and -3 < z < 3 for x, _, z in places.values()), places


@with_arenas
def test_gaps_are_deep_and_platforms_are_not() -> None:
    drive = Driver(SCENES["gaps"])
    for i in range(36):
        drive.drop(f"c{i}", i, 0.3, 1.0, size=0.2)
    drive("step", ticks=120)
    heights = [drive.where(f"c{i}")[1] for i in range(36)]
    assert {round(y, 2) for y in heights} == {0.1, -9.9}


@with_arenas
def test_a_maze_is_closed_and_not_empty() -> None:
    arena = Arena("maze", 3, 40.0, 4.0, 11)
    boxes = [part for part in parts(arena) if len(part.size) == 3 and part.size[1] > 0 and part.position[1] == 1.0]
    assert len(boxes) > 4
    drive = Driver({"type": "arena", "arena": {"name": "maze", "seed": 3}})
    for i, velocity in enumerate([[20, 0, 0], [-20, 0, 0], [0, 0, 20], [0, 0, -20]]):
        drive.drop(f"c{i}", 0, 0.2 + 0.4 * i, 0, size=0.3, friction=0, linear_velocity=velocity)
    drive("step", ticks=120)
    for i in range(4):
        x, y, z = drive.where(f"c{i}")
        assert max(abs(x), abs(z)) < 22 and 0 < y < 2


@with_arenas
def test_making_an_arena_leaves_numpy_s_generator_alone() -> None:
    parts.cache_clear()
    np.random.seed(4)
    expected = np.random.RandomState(4).random_sample(3)
    for name in ARENAS:
        parts(Arena(name, 1, 40.0, 4.0, 11))
    assert np.random.random_sample(3).tolist() == expected.tolist()


# -- damping ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("backend", ["mujoco", "pymunk"])
def test_velocities_decay_as_the_config_says(backend: str) -> None:
    drive = Driver({}, backend=backend, damping=DAMPING, gravity=[0, 0, 0])
    drive.drop("a", 0, 5, 0, linear_velocity=[3, 1, 0], angular_velocity=[0, 0, 2])
    drive("step", ticks=120)
    state = drive("get_cube_state", cube_name="a")
    kept = math.exp(-0.8)
    assert state["linear_velocity"] == pytest.approx([3 * kept, kept, 0], abs=1e-3)
    assert state["angular_velocity"] == pytest.approx([0, 0, 2 * math.exp(-0.2)], abs=1e-3)


def test_a_world_that_says_nothing_of_damping_has_none_and_one_that_says_half_of_it_has_half() -> None:
    def speeds(**config: Any) -> tuple[float, float]:
        drive = Driver({}, gravity=[0, 0, 0], **config)
        drive.drop("a", 0, 5, 0, linear_velocity=[1, 0, 0], angular_velocity=[0, 0, 1])
        drive("step", ticks=60)
        state = drive("get_cube_state", cube_name="a")
        return state["linear_velocity"][0], state["angular_velocity"][2]

    assert "damping" not in World({}).config
    assert speeds() == speeds(damping={}) == pytest.approx((1.0, 1.0), abs=1e-12)
    assert speeds(damping={"angular": 1}) == pytest.approx((1.0, math.exp(-1)), abs=1e-3)


def test_an_engine_without_damping_refuses_it_but_not_none() -> None:
    with pytest.raises(RejectedMessage) as refused:
        World({"backend": "ballistic", "damping": DAMPING})
    assert (refused.value.code, refused.value.path) == ("unsupported", "damping")
    assert World({"backend": "ballistic", "damping": {}}).config["damping"] == {"linear": 0, "angular": 0}


@pytest.mark.parametrize("damping", [{"linear": -0.1}, {"angular": 101}, {"linear": "much"}, {"spin": 1}])
def test_damping_has_bounds(damping: Reply) -> None:
    with pytest.raises(RejectedMessage) as refused:
        World({"damping": damping})
    assert refused.value.code == "invalid" and (refused.value.path or "").startswith("damping")


@pytest.mark.parametrize("damping", [DAMPING, {"linear": 0.1, "angular": 0.1}])
@pytest.mark.parametrize("scene", [{}, {"type": "planets"}])
def test_a_restored_world_with_damping_continues_like_the_saved_one(scene: Reply, damping: Reply) -> None:
    program = programs.draw(11, 60)
    config = {"mode": "lockstep", "seed": 3, "scene": scene, "damping": damping}
    first, second = World(config), World(config)
    for world in (first, second):
        programs.play(world, program[:30])
    snapshot = first.simulation.snapshot()
    second.simulation.snapshot()
    second.simulation.restore(snapshot)
    assert programs.play(first, program[30:]) == programs.play(second, program[30:])


# -- the same again --------------------------------------------------------------------------------------------------


def identity(scene: Reply, seed: int) -> int:
    parts.cache_clear()
    simulation = MujocoBackend().create(spec_of(scene, seed))
    assert isinstance(simulation, MujocoSimulation)
    return int.from_bytes(simulation.digest(), "little")


@pytest.mark.parametrize("name", ["heightfield", *ARENAS])
def test_a_seed_gives_the_same_scenery_and_another_gives_another(name: str) -> None:
    scene = SCENES[name]
    assert identity(scene, 7) == identity(scene, 7)
    drawn = name != "corridor"  # nothing in it is left to chance
    assert (identity(scene, 7) != identity(scene, 8)) == drawn
    part = scene["type"]
    fixed = {**scene, part: {**scene[part], "seed": 7}}
    assert identity(fixed, 1) == identity(fixed, 2) == identity(scene, 7)


def test_all_scenes_differ_in_their_digests() -> None:
    assert len({identity(scene, 7) for scene in SCENES.values()} | {identity({}, 7)}) == len(SCENES) + 1


def test_every_height_counts_in_the_digest() -> None:
    def field(*rows: list[float]) -> Reply:
        return {"type": "heightfield", "heightfield": {"heights": rows}}

    one, other = field([0, 1, 0], [0, 0, 0]), field([0, 0, 0], [0, 1, 0])
    assert identity(one, 1) == identity(one, 1) != identity(other, 1)


def test_reset_makes_the_scenery_of_its_seed() -> None:
    drive = Driver(HILLS, seed=1)
    first = drive.world.digest()
    drive("reset", seed=2)
    second = drive.world.digest()
    assert second == Driver(HILLS, seed=2).world.digest() != first
    drive("reset", seed=1)
    assert drive.world.digest() == first


@pytest.mark.parametrize("name", SCENES)
def test_a_program_gives_the_same_world_again_with_or_without_queries(name: str) -> None:
    program = programs.draw(5, 60)
    config = {"mode": "lockstep", "seed": 3, "scene": SCENES[name]}
    replies, digests = programs.play(World(config), program)
    assert programs.play(World(config), program) == (replies, digests)
    assert programs.play(World(config), program, queries=False)[1] == digests
    assert not [reply for reply in replies if reply.get("code") in ("internal", "world_faulted")]


@pytest.mark.parametrize("name", ["heightfield", "obstacles", "planets"])
def test_a_restored_world_continues_like_the_saved_one(name: str) -> None:
    program = programs.draw(11, 60)
    config = {"mode": "lockstep", "seed": 3, "scene": SCENES[name]}
    first, second = World(config), World(config)
    for world in (first, second):
        programs.play(world, program[:30])
    snapshot = first.simulation.snapshot()
    second.simulation.snapshot()
    second.simulation.restore(snapshot)
    assert first.digest() == second.digest()
    assert programs.play(first, program[30:]) == programs.play(second, program[30:])


PLAY = """
import sys
import programs, test_scenes
from nmes import World
for scene in test_scenes.SCENES.values():
    world = World({"mode": "lockstep", "seed": int(sys.argv[1]), "scene": scene})
    print(programs.play(world, programs.draw(3, 40))[1][-1].hex())
"""


def test_fresh_processes_reach_the_same_digests() -> None:
    path = os.pathsep.join(map(str, (SUPPORT, ROOT / "tools", Path(__file__).parent)))

    def run(seed: str, hashes: str) -> list[str]:
        environment = {"PYTHONHASHSEED": hashes, "PYTHONPATH": path}
        command = [sys.executable, "-c", PLAY, seed]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        return done.stdout.split()

    assert run("7", "1") == run("7", "2")


@pytest.mark.parametrize("name", SCENES)
def test_a_recording_holds_its_scene_and_replays(name: str, tmp_path: Path) -> None:
    def play(world: World, client: int) -> None:
        for i in range(4):
            world.execute(client, {"type": "spawn_cube", "position": [0.3 * i, 1 + 1.1 * i, 0.2 * i]})
        world.execute(client, {"type": "step", "ticks": 60})
        world.execute(client, {"type": "get_planets"})

    config = {"backend": "mujoco", "seed": 12, "scene": SCENES[name]}
    report = replay(recordings.record(tmp_path / "world.mcap", play, config))
    assert report.verdict == "reproduced"


# -- what is refused -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scene", "field"),
    [
        ({"type": "moon"}, "scene/type"),
        ({"planets": {}}, "scene/planets"),
        ({"type": "planets", "heightfield": {}}, "scene/heightfield"),
        ({"type": "planets", "planets": {"spacing": 199}}, "scene/planets/spacing"),
        ({"type": "arena", "arena": {"name": "moon"}}, "scene/arena/name"),
        ({"type": "heightfield", "heightfield": {"heights": [[1, 2], [3]]}}, "scene/heightfield/heights/1"),
        ({"type": "heightfield", "heightfield": {"heights": [[1, 2]], "seed": 1}}, "scene/heightfield/heights"),
        (
            {"type": "heightfield", "heightfield": {"heights": [[1, 2], [3, 4]], "image": IMAGE}},
            "scene/heightfield/image",
        ),
        ({"type": "heightfield", "heightfield": {"image_file": "a.png"}}, "scene/heightfield/image_file"),
        ({"obstacles": [{"type": "box"}, {"type": "tree"}]}, "scene/obstacles/1/type"),
        ({"obstacles": [{"position": [0, 0, 0]}]}, "scene/obstacles/0/type"),
        ({"obstacles": [{"type": "box", "length": 3}]}, "scene/obstacles/0/length"),
        ({"obstacles": [{"type": "box"}, {"type": "ramp", "length": 3, "width": 3}]}, "scene/obstacles/1/height"),
        (
            {"type": "heightfield", "obstacles": [{"type": "gap", "length": 1, "width": 1, "depth": 1}]},
            "scene/obstacles/0/type",
        ),
    ],
)
def test_a_scene_that_makes_no_sense_is_refused(scene: Reply, field: str) -> None:
    with pytest.raises(RejectedMessage) as refused:
        World({"scene": scene})
    assert (refused.value.code, refused.value.path) == ("invalid", field)


@pytest.mark.parametrize(
    ("backend", "scene", "field"),
    [
        ("ballistic", HILLS, "scene/type"),
        ("ballistic", {"obstacles": [{"type": "box"}]}, "scene/obstacles"),
        ("pymunk", {"type": "planets"}, "scene/type"),
        ("pymunk", {"type": "arena"}, "scene/type"),
    ],
)
def test_an_engine_is_not_asked_for_scenery_that_it_lacks(backend: str, scene: Reply, field: str) -> None:
    with pytest.raises(RejectedMessage) as refused:
        World({"backend": backend, "scene": scene})
    assert (refused.value.code, refused.value.path) == ("unsupported", field)
    assert backend in refused.value.message


@pytest.mark.parametrize("block", re.findall(r"```json\n(.*?)```", DOCUMENT, flags=re.DOTALL))
def test_the_documented_scenes_are_worlds(block: str, tmp_path: Path) -> None:
    config = {"scene": {}, **json.loads(block)}
    if config["scene"].get("type") == "arena" and not ARENAS:
        pytest.skip("what makes arenas has no wheels for this Python")
    if config["scene"].get("heightfield", {}).pop("image_file", None):
        config["scene"]["heightfield"]["image"] = IMAGE  # it is for config files
    world = World({"mode": "lockstep", **config})
    client = world.join()
    world.execute(client, {"type": "spawn_cube"})
    assert world.execute(client, {"type": "step", "ticks": 30})["type"] == "stepped"


def test_every_kind_of_scenery_and_every_setting_is_documented() -> None:
    scene = schemas.load("world_config.json")["properties"]["scene"]["properties"]
    kinds = [*scene["type"]["enum"], *scene["obstacles"]["items"]["properties"]["type"]["enum"]]
    for name in [*kinds, *scene["arena"]["properties"]["name"]["enum"], *scene]:
        assert f"`{name}`" in DOCUMENT, name
    engines = (ROOT / "docs" / "engines.md").read_text()
    for name in ("solver", "iterations", "tolerance", "cone", "impratio", "integrator", "sleep"):
        assert f"| `{name}` |" in engines, name


# -- in the plane ----------------------------------------------------------------------------------------------------


def test_the_planar_engine_has_the_slice_of_a_scene() -> None:
    obstacles = [
        {"type": "stairs", "position": [1, 0, 0], "length": 4, "width": 3, "height": 2, "steps": 4},
        {"type": "wall", "position": [-5, 0, 0], "length": 6, "width": 0.5, "height": 2, "heading": math.pi / 2},
        {"type": "gap", "position": [-2, 0, 0], "length": 2, "width": 1, "depth": 1},
        {"type": "box", "position": [8, 0, 5]},
    ]
    drive = Driver({"obstacles": obstacles}, backend="pymunk")
    expected = {}
    for step in range(4):
        name = drive.drop(f"c{step}", 1.5 + step, 0.5 * (step + 1) + 0.5, 0, size=0.4)
        expected[name] = 0.5 * (step + 1) + 0.2
    for name, x, y in (("wall", -5, 2.2), ("gap", -2, -0.8), ("past", 8, 0.2)):
        expected[drive.drop(name, x, y + 0.5, 0, size=0.4)] = y
    drive("step", ticks=120)
    assert {name: drive.where(name)[1] for name in expected} == pytest.approx(expected, abs=0.01)


def test_the_planar_engine_has_the_profile_of_a_landscape() -> None:
    drive = Driver(HILLS, backend="pymunk", seed=2)
    field = spec_of(HILLS, 2).heightfield
    assert field is not None
    for i in range(5):
        x = 4.0 * (i - 2)
        drive.drop(f"c{i}", x, surface(field, x, 0) + 0.3, 0, size=0.2, friction=5)
    drive("step", ticks=120)
    for i in range(5):
        x, y, _ = drive.where(f"c{i}")
        assert 0.05 < y - surface(field, x, 0) < 0.16


# -- before the first tick -------------------------------------------------------------------------------------------


def test_worlds_that_never_ticked_are_each_in_their_own_scene() -> None:
    tower = {"obstacles": [{"type": "box", "position": [0, 1, 0], "size": [2, 2, 2]}]}
    drives = [Driver(scene) for scene in ({}, tower, {}, tower)]
    for drive, height in zip(drives, (5, 5, 9, 9), strict=True):
        drive.drop("a", 0, height, 0)

    def below(drive: Driver) -> float:
        (distance,) = drive("get_cube_info", cube_name="a", sensors=True, rays=[[0, -1, 0]])["ranges"]
        return float(distance)

    assert [below(drive) for drive in drives] == [5, 3, 9, 7]
    drives[0]("step")
    assert [below(drive) for drive in drives[1:]] == [3, 9, 7]


# -- the engine's settings -------------------------------------------------------------------------------------------


def model_of(engine: Reply) -> Any:
    world = World({"engine": engine})
    world.tick()
    simulation = world.simulation
    assert isinstance(simulation, MujocoSimulation)
    return simulation.running.model


@pytest.mark.parametrize(
    ("engine", "field", "value"),
    [
        ({"solver": "cg"}, "solver", 1),
        ({"iterations": 7}, "iterations", 7),
        ({"tolerance": 1e-4}, "tolerance", 1e-4),
        ({"cone": "pyramidal"}, "cone", 0),
        ({"impratio": 2}, "impratio", 2),
        ({"integrator": "implicit"}, "integrator", 2),
        ({"integrator": "rk4", "sleep": False}, "integrator", 1),
    ],
)
def test_a_setting_reaches_the_engine(engine: Reply, field: str, value: float) -> None:
    assert getattr(model_of(engine).opt, field) == value != getattr(model_of({}).opt, field)


@pytest.mark.parametrize(
    ("engine", "field"),
    [
        ({"solver": "fast"}, "solver"),
        ({"solver": ["cg"]}, "solver"),
        ({"iterations": 0}, "iterations"),
        ({"iterations": 2.5}, "iterations"),
        ({"iterations": True}, "iterations"),
        ({"tolerance": -1}, "tolerance"),
        ({"tolerance": "small"}, "tolerance"),
        ({"cone": "round"}, "cone"),
        ({"impratio": 0}, "impratio"),
        ({"integrator": "rk4"}, "integrator"),
        ({"sleep": True, "integrator": "rk4"}, "integrator"),
        ({"sleep": 1}, "sleep"),
        ({"turbo": True}, "turbo"),
    ],
)
def test_a_setting_that_makes_no_sense_is_refused(engine: Reply, field: str) -> None:
    with pytest.raises(RejectedMessage) as refused:
        World({"engine": engine})
    assert (refused.value.code, refused.value.path) == ("invalid", f"engine/{field}")


@pytest.mark.parametrize(
    "engine",
    [
        {"solver": "cg", "iterations": 100},
        {"solver": "pgs", "iterations": 200},
        {"cone": "pyramidal", "impratio": 1},
        {"integrator": "implicit"},
        {"integrator": "euler"},
        {"integrator": "rk4", "sleep": False},
        {"sleep": False},
    ],
)
def test_a_stack_stands_whatever_the_settings(engine: Reply) -> None:
    drive = Driver({}, engine=engine)
    for i in range(4):
        drive.drop(f"c{i}", 0, 0.5 + i, 0)
    drive("step", ticks=180)
    for i in range(4):
        assert drive.where(f"c{i}") == pytest.approx([0, 0.5 + i, 0], abs=0.03)
    assert drive("get_cube_info", cube_name="c0")["sleeping"] == engine.get("sleep", True)
    drive("despawn_cube", cube_name="c1")
    drive("step", ticks=90)
    assert drive.where("c2")[1] == pytest.approx(1.5, abs=0.03)


@with_arenas
@pytest.mark.parametrize("missing", ["dm_control", "labmaze"])  # labmaze has no wheels for Python 3.13
def test_arenas_are_claimed_only_where_they_can_be_made(missing: str) -> None:
    program = f"""
import sys
sys.modules[{missing!r}] = None
from nmes import World
from nmes.errors import RejectedMessage
world = World({{"backend": "mujoco"}})
print("scene.arena" in world.execute(world.join(), {{"type": "get_world_info"}})["capabilities"])
try:
    World({{"backend": "mujoco", "scene": {{"type": "arena"}}}})
except RejectedMessage as error:
    print(error.code, error.path)
"""
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert result.stdout == "False\nunsupported scene/type\n"
    assert "scene.arena" in load_backend("mujoco").capabilities
