"""Many cubes in one place, and heaps of them: they come apart in bounded steps, and come to rest."""

from __future__ import annotations

import random
from typing import Any

import mujoco
import numpy as np
import pytest

from lockstep import Say, world_of
from nmes import World
from nmes.backends.mujoco3d import MujocoSimulation
from nmes.cli._serve_settings import DIALECTS
from random_bodies import unit


def heap_in_one_place(count: int, ticks: int, *, each: bool) -> MujocoSimulation:
    """Spawns cubes in one place, all at once or one a tick, and sees every step bounded and none fail.

    All pairs of them would have 4 contacts each: at 60 cubes 120 a cube, and a step of seconds.
    """
    world, say = world_of()
    simulation = world.simulation
    assert isinstance(simulation, MujocoSimulation)
    highest = 0.0
    for _ in range(count):
        say("spawn_cube", position=[0, 0.5, 0], list=False)
        if each:
            say("step")
    for _ in range(ticks):
        say("step")
        assert world.fault is None
        assert simulation.running.data.ncon < 8 * count  # each has 4 on the ground
        states = simulation.states(range(1, count + 1))
        highest = max(highest, float(states[:, 1].max()))
        fall = (2.0 * 9.81 * highest) ** 0.5
        assert np.linalg.norm(states[:, 7:10], axis=1).max() < fall + 8.0  # m/s: what they gain apart from falling
    again = World({"mode": "lockstep"})
    again.restore(world.snapshot())
    for one in (world, again):
        one.tick()
    assert again.digest() == world.digest()
    masks = simulation.running.model.geom_conaffinity
    assert set(masks.tolist()) <= {0, 1}  # those that glide touch nobody only within a step
    return simulation


def closest(simulation: MujocoSimulation, count: int) -> float:
    """Returns the distance (m) of the two cubes that are nearest to each other."""
    places = simulation.states(range(1, count + 1))[:, :3]
    return float((np.linalg.norm(places[:, None] - places, axis=2) + 9.0 * np.eye(count)).min())


def test_what_sleeps_feels_only_its_own_island_while_cubes_glide_through_it() -> None:
    world, say = world_of()
    places = [(x, z) for x in (-1.5, 0.0, 1.5) for z in (-1.5, 0.0, 1.5) if x or z]
    sleepers = [say("spawn_cube", position=[x, 0.5, z], list=False)["spawned"] for x, z in places]
    while not all(say("get_cube_info", cube_name=name)["sleeping"] for name in sleepers):
        say("step")
    for _ in range(40):
        say("spawn_cube", position=[0, 0.5, 0], list=False)
    asked = 0
    for tick in range(60):
        say("spawn_cube", position=[50.0 + 2.0 * tick, 0.5, 0], list=False)  # after which all is computed anew
        say("step")
        infos = [say("get_cube_info", cube_name=name) for name in sleepers]
        for contacts in (info["contacts"] for info in infos if info["sleeping"]):
            assert {(contact["cube_name"], contact["face"]) for contact in contacts} == {(None, "-y")}
            assert sum(contact["force"] for contact in contacts) == pytest.approx(9.81, rel=0.01)
            asked += 1
    assert asked > 100
    assert world.fault is None


@pytest.mark.parametrize(("count", "ticks", "each"), [(40, 240, False), (40, 240, True), (300, 4, False)])
def test_cubes_in_one_place_part_in_bounded_steps(count: int, ticks: int, each: bool) -> None:
    simulation = heap_in_one_place(count, ticks, each=each)
    assert ticks < 100 or closest(simulation, count) > 0.9


@pytest.mark.long
@pytest.mark.parametrize(("count", "ticks"), [(60, 900), (150, 1200), (300, 1500), (600, 2400)])
@pytest.mark.parametrize("each", [False, True])
def test_hundreds_of_cubes_in_one_place_come_apart_in_the_end(count: int, ticks: int, each: bool) -> None:
    simulation = heap_in_one_place(count, ticks, each=each)
    assert closest(simulation, count) > 0.9
    asleep = sum(map(simulation.sleeping, range(1, count + 1)))
    assert asleep > 0.9 * count  # a heap at rest costs next to nothing; a few that lean on each other may tremble


def test_those_that_glide_stand_still_where_there_is_room_and_go_no_further() -> None:
    world, say = world_of()
    for _ in range(12):
        say("spawn_cube", position=[0, 40, 0], list=False)
    fastest = 0.0
    for _ in range(120):
        say("step")
        speeds = world.simulation.states(range(1, 13))[:, [7, 9]]
        fastest = max(fastest, float(np.linalg.norm(speeds, axis=1).max()))
    assert 2.5 < fastest < 3.1
    assert np.abs(speeds).max() < 0.1  # they fall straight down


def test_a_cube_that_is_moved_while_it_glides_glides_no_more() -> None:
    _, say = world_of()
    for number in range(12):
        say("spawn_cube", cube_name=f"c{number}", position=[0, 40, 0], list=False)
    say("step", ticks=3)
    say("set_cube_state", cube_name="c11", position=[50, 40, 0], linear_velocity=[9, 0, 0])
    say("step")
    assert say("get_cube_state", cube_name="c11")["linear_velocity"][0] == pytest.approx(9.0)
    assert say("despawn_cube", cube_name="c10")["type"] == "cube_despawned"
    assert say("step", ticks=60)["type"] == "stepped"


def wall(rows: int = 8, **config: Any) -> tuple[World, Say]:
    """Returns a world with cubes in rows of ten, each on two of the row below, and its commands, after two ticks."""
    world, say = world_of(**config)
    for number in range(10 * rows):
        row, column = divmod(number, 10)
        say("spawn_cube", cube_name=f"w{number}", position=[column + row % 2 / 2, 0.5 + row, 0], list=False)
    say("step", ticks=2)
    return world, say


def friction_cone(world: World) -> int:
    assert isinstance(world.simulation, MujocoSimulation)
    return int(world.simulation.running.model.opt.cone)


def test_a_heap_has_friction_of_its_own_comes_to_rest_and_goes_on_from_a_snapshot() -> None:
    world, say = wall()
    before = world.simulation.states(range(1, 81))
    assert friction_cone(world) == mujoco.mjtCone.mjCONE_PYRAMIDAL
    again = World({"mode": "lockstep"})
    again.restore(world.snapshot())
    assert again.digest() == world.digest()
    say("step", ticks=5)
    for _ in range(5):
        again.tick()
    assert again.digest() == world.digest()
    say("step", ticks=55)
    assert all(map(world.simulation.sleeping, range(1, 81)))
    assert np.abs(world.simulation.states(range(1, 81)) - before)[:, :3].max() < 0.01


@pytest.mark.parametrize("asleep", [False, True])
def test_a_heap_ends_where_too_few_are_left(asleep: bool) -> None:
    world, say = wall()
    if asleep:
        say("step", ticks=60)
    assert friction_cone(world) == mujoco.mjtCone.mjCONE_PYRAMIDAL
    for number in range(10, 80):
        say("despawn_cube", cube_name=f"w{number}")
    say("step", ticks=60)
    assert all(map(world.simulation.sleeping, range(1, 11)))
    assert friction_cone(world) == mujoco.mjtCone.mjCONE_ELLIPTIC


def test_some_twenty_cubes_that_hold_each_other_are_a_heap() -> None:
    world, _ = wall(rows=2)
    assert friction_cone(world) == mujoco.mjtCone.mjCONE_PYRAMIDAL


def test_a_crowd_on_a_planet_glides_away_from_it_and_comes_to_rest() -> None:
    world, say = world_of(**{**DIALECTS["original"], "mode": "lockstep"})
    simulation = world.simulation
    assert isinstance(simulation, MujocoSimulation)
    for _ in range(40):
        say("spawn_cube", position=[2, 0, 101], list=False)
    lowest = 999.0
    for _ in range(300):
        say("step")
        lowest = min(lowest, float(np.linalg.norm(simulation.states(range(1, 41))[:, :3], axis=1).min()))
    assert world.fault is None
    assert lowest > 100.3  # who falls from higher up lands hard
    assert closest(simulation, 40) > 0.9
    assert not simulation.running.depenetration.bodies


def test_a_world_whose_config_says_which_cone_keeps_it() -> None:
    assert friction_cone(wall(engine={"cone": "elliptic"})[0]) == mujoco.mjtCone.mjCONE_ELLIPTIC


@pytest.mark.parametrize("count", [60, 200])
def test_cubes_thrown_into_one_place_have_bounded_contacts(count: int) -> None:
    world, say = world_of()
    draw = random.Random(1)
    for number in range(count):
        x, y, z = (20.0 * part for part in unit(draw))
        turn = [draw.uniform(-3.0, 3.0) for _ in range(3)]
        say("spawn_cube", cube_name=f"c{number}", position=[x, y + 60, z], rotation=turn, list=False)
        flight = [-240 * x, -240 * y, -240 * z]  # they are all in one place after one engine step
        assert say("set_cube_state", cube_name=f"c{number}", linear_velocity=flight)["type"] != "error"
    simulation = world.simulation
    assert isinstance(simulation, MujocoSimulation)
    for _ in range(2):
        simulation.step(1)
        assert simulation.running.data.ncon < 8 * count
    assert say("step")["type"] == "stepped"


def test_plates_that_lie_on_each_other_are_not_in_one_place() -> None:
    world, say = world_of()
    for number in range(24):
        height = 0.025 + 0.05 * number
        say("spawn_cube", cube_name=f"p{number}", size=[1, 0.05, 1], position=[0, height, 0], list=False)
    say("step", ticks=60)
    assert np.diff(world.simulation.states(range(1, 25))[:, 1]).min() > 0.04


def test_a_push_on_a_cube_that_is_then_frozen_is_in_its_snapshot() -> None:
    world, say = world_of()
    say("spawn_cube", cube_name="a", position=[0, 3, 0])
    say("step")
    say("apply_physics", cube_name="a", force=[1, 0, 0])
    say("freeze_cube", cube_name="a", freeze=True)
    again = World({"mode": "lockstep"})
    again.restore(world.snapshot())
    for one in (world, again):
        one.tick()
    assert again.digest() == world.digest()
