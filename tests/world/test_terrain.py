"""Nothing begins inside the ground: what is put there is set down on top of it, and the reply says where that is."""

from __future__ import annotations

import math
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import creatures
import recordings
from nmes import World, protocol
from nmes.backend.rotation import conjugate, rotate
from nmes.backends.mujoco3d import MujocoSimulation
from nmes.playback import replay
from nmes.world import scenery
from servers import served

Reply = dict[str, Any]
CORNER = {"type": "planets", "planets": {"layout": "corner"}}
TILT = [0.4, 0.3, 0.2]


class Driver:
    """A world in lockstep with one client that takes no refusal."""

    def __init__(self, scene: Reply | None = None, backend: str = "mujoco", **config: Any) -> None:
        self.world = World({"mode": "lockstep", "backend": backend, "scene": scene or {}, **config})
        self.client = self.world.join()

    def __call__(self, type: str, **fields: Any) -> Reply:
        reply = self.world.execute(self.client, {"type": type, **fields})
        assert reply["type"] != "error", reply
        protocol.validate_reply(reply)
        return reply

    def moved_to(self, *position: float, **fields: Any) -> list[float] | None:
        """Spawns a cube; returns where it was moved, which is where it is then, or None where it was not."""
        reply = self("spawn_cube", position=list(position), **fields)
        state = self("get_cube_state", cube_name=reply["spawned"])
        assert state["position"] == reply.get("moved_to", list(position))
        return reply.get("moved_to")


def corners(state: Reply, size: float = 1.0) -> list[np.ndarray[Any, Any]]:
    signs = [(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]
    turn = tuple(state["quaternion"])
    return [np.add(state["position"], rotate(turn, (x * size, y * size, z * size))) for x, y, z in signs]


# -- the flat ground -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("backend", ["mujoco", "pymunk", "ballistic"])
@pytest.mark.parametrize("y", [-120.0, -0.5, 0.0, 0.2, 0.48])
def test_a_cube_in_the_ground_is_set_down_on_it_and_stays_there(backend: str, y: float) -> None:
    drive = Driver(backend=backend)
    assert drive.moved_to(3, y, 0, cube_name="a") == [3, 0.5, 0]
    drive("step", ticks=60)
    state = drive("get_cube_state", cube_name="a")
    assert state["position"] == pytest.approx([3, 0.5, 0], abs=0.005)
    assert state["linear_velocity"] == pytest.approx([0, 0, 0], abs=0.01)


@pytest.mark.parametrize("y", [0.496, 0.5, 0.51, 7])
def test_a_cube_on_the_ground_or_in_it_by_less_than_a_hundredth_is_left_alone(y: float) -> None:
    assert Driver().moved_to(0, y, 0) is None


def test_a_turned_cube_stands_on_its_lowest_corner() -> None:
    drive = Driver()
    drive.moved_to(0, -3, 0, cube_name="a", rotation=TILT, size=2)
    lowest = min(corner[1] for corner in corners(drive("get_cube_state", cube_name="a"), 2))
    assert lowest == pytest.approx(0, abs=1e-12)


def test_a_frozen_cube_is_where_it_was_put() -> None:
    drive = Driver()
    assert drive.moved_to(0, -3, 0, is_base=True) is None


def test_the_distance_of_a_cube_that_was_moved_counts_from_where_it_is() -> None:
    drive = Driver()
    drive.moved_to(0, -3, 0, cube_name="a")
    assert drive("compute_reward", metric="distance", cube="a")["value"] == 0.0


# -- planets ---------------------------------------------------------------------------------------------------------


def gap_to_planet(state: Reply, centre: tuple[float, float, float], size: float = 1.0) -> float:
    """Returns how far (m) the nearest point of a cube is above a planet of radius 100."""
    back = rotate(conjugate(tuple(state["quaternion"])), tuple(np.subtract(centre, state["position"])))
    nearest = np.clip(back, -size / 2, size / 2)
    return float(np.linalg.norm(np.subtract(back, nearest))) - 100.0


@pytest.mark.parametrize(
    ("place", "expected"),
    [((0, 100, 0), (0, 100.5, 0)), ((0, -120, 0), None), ((0, -20, 0), (0, -100.5, 0)), ((0, 0, 0), (0, 100.5, 0))],
)
def test_a_cube_in_a_planet_is_set_down_on_the_nearest_surface(place: Any, expected: Any) -> None:
    drive = Driver(CORNER)
    moved = drive.moved_to(*place)
    assert moved is None if expected is None else moved == pytest.approx(expected, abs=1e-9)


def test_cubes_in_planets_touch_them_afterwards_however_they_are_turned() -> None:
    drive, draw = Driver(CORNER, gravity=[0, -9.8, 0]), random.Random(4)
    for number in range(20):
        centre = (800.0 * draw.randrange(2), 800.0 * draw.randrange(2), 0.0)
        place = [at + draw.uniform(-60, 60) for at in centre]
        turn = [draw.uniform(-3, 3) for _ in range(3)]
        assert drive.moved_to(*place, cube_name=f"c{number}", rotation=turn, size=2) is not None
        state = drive("get_cube_state", cube_name=f"c{number}")
        assert gap_to_planet(state, centre, 2) == pytest.approx(0, abs=1e-9)
        way, asked = np.subtract(state["position"], centre), np.subtract(place, centre)
        assert np.cross(way, asked) == pytest.approx(np.zeros(3), abs=1e-6)  # straight up
    drive("step", ticks=10)
    speeds = [cube["linear_velocity"] for cube in drive("get_world_state")["cubes"]]
    assert np.abs(speeds).max() < 4.0  # they tip over, and nothing is flung


def test_a_cube_where_the_original_s_run_begins_is_left_alone() -> None:
    assert Driver(CORNER).moved_to(0, 99.997475, 39.99899) is None


# -- landscapes ------------------------------------------------------------------------------------------------------

HILLS = {"type": "heightfield", "heightfield": {"size": [20, 20], "samples": [41, 41], "height": 2, "seed": 3}}


@pytest.mark.parametrize("rotation", [[0, 0, 0], TILT])
def test_a_cube_in_a_landscape_is_set_down_on_it(rotation: list[float]) -> None:
    drive, draw = Driver(HILLS), random.Random(8)
    field = scenery.scene_spec(drive.world.config, 0).heightfield
    assert field is not None
    grid = [(0.5 * i - 10, float(field.heights[k, i]), 0.5 * k - 10) for i in range(41) for k in range(41)]
    for number in range(12):
        x, z = draw.uniform(-8, 8), draw.uniform(-8, 8)
        moved = drive.moved_to(x, -5, z, cube_name=f"c{number}", rotation=rotation)
        assert moved is not None and (moved[0], moved[2]) == (x, z)
        state = drive("get_cube_state", cube_name=f"c{number}")
        # No point of the grid is inside; and one is but for a hair, or a corner of the cube touches the surface.
        inside = [(p, rotate(conjugate(tuple(state["quaternion"])), tuple(np.subtract(p, moved)))) for p in grid]
        assert not [p for p, part in inside if max(map(abs, part)) < 0.5 - 1e-6]
        near = [p for p, part in inside if max(map(abs, part)) < 0.5 + 1e-6]
        heights = [corner[1] - surface(field, corner[0], corner[2]) for corner in corners(state)]
        assert min(heights) > -1e-9
        assert near or min(heights) < 1e-9


def surface(field: Any, x: float, z: float) -> float:
    """Returns the height between the four samples around a place."""
    rows, columns = field.heights.shape
    u, v = (x / field.size[0] + 0.5) * (columns - 1), (z / field.size[1] + 0.5) * (rows - 1)
    i, k = int(v), int(u)
    a, b, c, d = field.heights[i, k], field.heights[i, k + 1], field.heights[i + 1, k], field.heights[i + 1, k + 1]
    return float((a * (1 + k - u) + b * (u - k)) * (1 + i - v) + (c * (1 + k - u) + d * (u - k)) * (v - i))


def test_a_cube_is_lifted_over_a_peak_that_is_under_none_of_its_corners() -> None:
    heights = [[0, 0, 0, 0, 0], [0, 0, 0, 0, 0], [0, 0, 1, 0, 0], [0, 0, 0, 0, 0], [0, 0, 0, 0, 0]]
    for backend in ("mujoco", "pymunk"):
        drive = Driver({"type": "heightfield", "heightfield": {"size": [4, 4], "heights": heights}}, backend)
        assert drive.moved_to(0, 0, 0, size=1.5) == [0, 1.75, 0]
        assert drive.moved_to(50, -5, 0) is None  # beyond the edge there is nothing


# -- obstacles -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("backend", ["mujoco", "pymunk"])
def test_a_cube_in_an_obstacle_is_set_down_on_what_is_on_top_of_it(backend: str) -> None:
    boxes = [
        {"type": "box", "position": [0, 1, 0], "size": [4, 2, 4]},
        {"type": "box", "position": [0.5, 2.5, 0], "size": [1, 1, 1]},
        {"type": "wall", "position": [10, 0, 0], "length": 0.2, "height": 2, "width": 6},
        {"type": "stairs", "position": [20, 0, 0], "length": 2, "height": 1, "width": 3, "steps": 2},
    ]
    drive = Driver({"obstacles": boxes}, backend)
    assert drive.moved_to(-1, 1, 0) == [-1, 2.5, 0]
    assert drive.moved_to(0.2, 0.3, 0) == [0.2, 3.5, 0]  # past both, which stand on each other
    assert drive.moved_to(-1, 1.9, 0) == [-1, 2.5, 0]
    assert drive.moved_to(10.5, 0.5, 0) is None  # a little in the wall's side: on top of it would be far away
    assert drive.moved_to(10, 0.5, 0) == pytest.approx([10, 2.5, 0])
    assert drive.moved_to(20.5, 0.2, 0, size=0.4) == pytest.approx([20.5, 0.7, 0])
    assert drive.moved_to(3, 0.5, 0) is None


def test_a_cube_that_is_pressed_into_a_side_or_an_underside_is_left_to_the_engine() -> None:
    step, slab = (
        {"type": "box", "position": [x, y, 0], "size": [2, h, 2]} for x, y, h in ((0, 0.15, 0.3), (9, 3.5, 1))
    )
    drive = Driver({"obstacles": [step, slab]})
    assert drive.moved_to(1.496, 0.5, 0) is None  # beside the step, and hardly in it
    assert drive.moved_to(1.4, 0.5, 0) == pytest.approx([1.4, 0.8, 0])
    assert drive.moved_to(9, 2.6, 0) is None  # under the slab
    assert drive.moved_to(9, 3.1, 0) == pytest.approx([9, 4.5, 0])


def test_a_planar_world_knows_only_the_slice_of_an_obstacle() -> None:
    behind = {"obstacles": [{"type": "box", "position": [0, 1, 0.7], "size": [4, 2, 1]}]}
    assert Driver(behind, "pymunk").moved_to(0, 2.1, 0) is None
    assert Driver(behind, "mujoco").moved_to(0, 2.1, 0) == [0, 2.5, 0]


def test_in_a_planar_world_what_is_round_is_beside_an_obstacle_that_is_not_in_the_plane() -> None:
    behind = {"obstacles": [{"type": "box", "position": [0, 1, 1], "size": [4, 2, 1]}]}
    assert Driver(behind, "pymunk").moved_to(0, 2.2, 0, size=2, shape="sphere") is None
    assert Driver(behind, "mujoco").moved_to(0, 2.2, 0, size=2, shape="sphere") == pytest.approx([0, 3, 0])


def test_a_cube_in_the_ground_beside_a_trench_is_set_down_and_one_in_the_trench_is_not() -> None:
    trench = {"obstacles": [{"type": "gap", "position": [0, 0, 0], "length": 4, "width": 4, "depth": 3}]}
    drive = Driver(trench)
    assert drive.moved_to(0, -1, 0) is None
    assert drive.moved_to(0, -3.2, 0) == pytest.approx([0, -2.5, 0])
    assert drive.moved_to(5, -1, 0) == pytest.approx([5, 0.5, 0])


def test_no_cube_begins_with_its_middle_in_an_obstacle() -> None:
    draw = random.Random(6)
    boxes = [
        {
            "type": "box",
            "position": [draw.uniform(-4, 4), draw.uniform(0, 4), draw.uniform(-4, 4)],
            "size": [draw.uniform(0.3, 3) for _ in range(3)],
            "rotation": [draw.uniform(-3, 3) for _ in range(3)],
        }
        for _ in range(25)
    ]
    drive, moved = Driver({"obstacles": boxes}), 0
    spec = scenery.scene_spec(drive.world.config, 0)
    for _ in range(60):
        place, turn = [draw.uniform(-4, 4) for _ in range(3)], [draw.uniform(-3, 3) for _ in range(3)]
        moved += drive.moved_to(*place, cube_name="a", rotation=turn, size=0.5) is not None
        state = drive("get_cube_state", cube_name="a")
        for box in spec.boxes:
            inside = rotate(conjugate(box.quaternion), tuple(np.subtract(state["position"], box.position)))
            assert any(abs(part) >= edge / 2 for part, edge in zip(inside, box.size, strict=True))
        assert min(corner[1] for corner in corners(state, 0.5)) > -0.006
        drive("despawn_cube", cube_name="a")
    assert 20 < moved < 60


def test_what_was_set_down_on_a_turned_obstacle_touches_it() -> None:
    drive = Driver({"obstacles": [{"type": "box", "position": [0, 2, 0], "size": [3, 1, 3], "rotation": TILT}]})
    x, y, z = drive.moved_to(0.3, 2, -0.2, cube_name="a", rotation=[0.1, 0.9, -0.4]) or (0, 0, 0)
    simulation = drive.world.simulation
    assert isinstance(simulation, MujocoSimulation)
    for lower, touches in ((-0.001, False), (0.001, True)):
        assert "moved_to" not in drive("set_cube_state", cube_name="a", position=[x, y - lower, z])
        simulation.snapshot()  # takes up the edit
        assert bool(len(simulation.running.data.contact.dist)) == touches


# -- what is moved ---------------------------------------------------------------------------------------------------


def test_a_cube_is_not_moved_into_the_ground_nor_what_is_joined_to_it() -> None:
    drive = Driver()
    a, b = (drive("spawn_cube", position=[x, 3, 0])["spawned"] for x in (0, 1))
    drive("create_joint", cube1=a, cube2=b, joint_type="fixed")
    down = drive("set_cube_state", cube_name=a, position=[5, -4, 2], rotation=[0, 0, -math.pi / 2])
    assert down["moved_to"] == pytest.approx([5, 1.5, 2])
    places = [cube["position"] for cube in drive("get_world_state")["cubes"]]
    assert places == [pytest.approx([5, 1.5, 2]), pytest.approx([5, 0.5, 2])]
    assert "moved_to" not in drive("set_cube_state", cube_name=a, position=[5, 9, 2])
    assert "moved_to" not in drive("set_cube_state", cube_name=a, linear_velocity=[0, -1, 0])


def test_a_cube_that_is_only_turned_into_the_ground_is_lifted() -> None:
    drive = Driver()
    a = drive("spawn_cube", position=[0, 0.5, 0])["spawned"]
    reply = drive("set_cube_state", cube_name=a, rotation=[0, 0, math.pi / 4])
    assert reply["moved_to"] == pytest.approx([0, math.sqrt(0.5), 0])


def test_a_structure_on_a_frozen_cube_goes_where_it_is_put() -> None:
    drive = Driver()
    base = drive("spawn_cube", position=[0, 3, 0], is_base=True)["spawned"]
    arm = drive("spawn_cube", position=[1, 3, 0])["spawned"]
    drive("create_joint", cube1=base, cube2=arm, joint_type="hinge")
    assert "moved_to" not in drive("set_cube_state", cube_name=base, position=[0, -3, 0])
    assert drive("get_cube_state", cube_name=arm)["position"] == [1, -3, 0]


def test_a_creature_is_set_down_whole() -> None:
    drive = Driver()
    above = drive("spawn_creature", genome=creatures.snake(), position=[0, 20, 0], name="above")
    below = drive("spawn_creature", genome=creatures.snake(), position=[9, -20, 0], name="below")
    assert "moved_to" not in above and below["moved_to"] == pytest.approx([9, 0, 0])
    states = {cube["cube_name"]: cube["position"] for cube in drive("get_world_state")["cubes"]}
    for part, name in below["cubes"].items():
        place = np.subtract(states[above["cubes"][part]], [0, 20, 0])
        assert states[name] == pytest.approx(place + below["moved_to"])


def test_a_creature_in_a_planet_is_set_down_as_a_whole_too() -> None:
    drive = Driver(CORNER)
    moved = drive("spawn_creature", genome=creatures.snake(), position=[30, 40, 50], name="a")["moved_to"]
    gaps = [gap_to_planet(cube, (0, 0, 0), 0.14) for cube in drive("get_world_state")["cubes"]]
    assert np.linalg.norm(moved) > 99.5 and -0.1 < min(gaps) < 0.2  # its cubes are 0.26 wide, 0.14 high


# -- elsewhere -------------------------------------------------------------------------------------------------------


def test_a_recording_with_cubes_that_were_set_down_replays(tmp_path: Path) -> None:
    def play(world: World, client: int) -> None:
        for command in (
            {"type": "spawn_cube", "position": [0, 20, 0], "cube_name": "a"},
            {"type": "spawn_creature", "genome": creatures.snake(), "position": [0, 80, 0]},
            {"type": "step", "ticks": 30},
            {"type": "set_cube_state", "cube_name": "a", "position": [40, 20, 0]},
            {"type": "step", "ticks": 30},
        ):
            assert world.execute(client, command)["type"] != "error"

    path = recordings.record(tmp_path / "world.mcap", play, {"backend": "mujoco", "scene": CORNER})
    assert replay(path).verdict == "reproduced"


def test_the_raw_dialect_is_silent_of_it() -> None:
    with served({"backend": "mujoco", "mode": "lockstep", "scene": CORNER}) as server, server.peer("raw") as program:
        program.say({"type": "spawn_cube", "cube_name": "a", "position": [0, 100, 0]})
        assert program.ask({"type": "get_cube_info", "cube_name": "a"})["position"] == [0, 100.5, 0]
