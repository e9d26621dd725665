"""Scenes of planets: what they pull at, where they are, and that they are the same again."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from test_scenes import DAMPING, Driver, G, Reply, spec_of

import creatures
import programs
from nmes import World, protocol
from nmes.backends.mujoco3d import rebuild


def test_a_cube_stands_on_the_far_side_of_a_planet() -> None:
    drive = Driver({"type": "planets"})
    drive.drop("top", 0, 0.6, 0)
    drive.drop("bottom", 0, -202, 0)
    drive.drop("side", 100.6, -100, 0)
    drive.drop("another", 800, 802, -800)
    drive("step", ticks=180)
    for name, place in {
        "top": [0, 0.5, 0],
        "bottom": [0, -200.5, 0],
        "side": [100.5, -100, 0],
        "another": [800, 800.5, -800],
    }.items():
        assert drive.where(name) == pytest.approx(place, abs=0.005), name
    (contact, *_) = drive("get_cube_info", cube_name="bottom")["contacts"]
    assert contact["cube_name"] is None and contact["normal"] == pytest.approx([0, -1, 0], abs=1e-3)


def test_a_fall_towards_a_planet_follows_the_formula() -> None:
    drive = Driver({"type": "planets"}, gravity=[3, 0, 4])  # its strength alone counts
    drive.drop("a", -130, -100, 0)
    drive("step", ticks=60)
    x, y, z = drive.where("a")
    assert x == pytest.approx(-130 + 0.5 * 5 * 1.0, abs=0.02)
    assert (y, z) == pytest.approx((-100, 0), abs=1e-9)


def test_a_body_orbits_a_planet() -> None:
    drive = Driver({"type": "planets"})
    radius = 150.0
    drive.drop("a", radius, -100, 0, linear_velocity=[0, 0, math.sqrt(G * radius)])
    turned = 0.0
    for _ in range(10):
        drive("step", ticks=60)
        x, y, z = drive.where("a")
        assert math.hypot(x, y + 100, z) == pytest.approx(radius, abs=0.5)
        turned = math.atan2(z, x)
    expected = math.remainder(10 * math.sqrt(G / radius), 2 * math.pi)
    assert turned == pytest.approx(expected, abs=0.01)


def test_a_push_acts_beside_a_planet_s_pull() -> None:
    drive = Driver({"type": "planets"})
    drive.drop("a", 0, 20, 0, mass=2)
    drive.drop("b", 5, 20, 0, mass=2)
    for _ in range(30):
        drive("apply_force", cube_name="a", force=[0, 2 * G, 0])
        drive("step")
    assert drive.where("a")[1] == pytest.approx(20, abs=1e-6)
    assert drive.where("b")[1] == pytest.approx(20 - 0.5 * G * 0.25, abs=0.05)
    drive("step", ticks=1)
    assert drive("get_cube_state", cube_name="a")["linear_velocity"][1] == pytest.approx(-G / 60)


def test_a_cube_sleeps_on_a_planet_and_wakes_when_it_is_pushed() -> None:
    drive = Driver({"type": "planets"})
    drive.drop("a", 0, 0.6, 0)
    drive("step", ticks=120)
    assert drive("get_cube_info", cube_name="a")["sleeping"]
    before = drive.where("a")
    drive("step", ticks=30)
    info = drive("get_cube_info", cube_name="a")
    assert info["sleeping"] and info["position"] == before
    assert sum(contact["force"] for contact in info["contacts"]) == pytest.approx(G, abs=0.01)
    drive("apply_physics", cube_name="a", impulse=[1, 0, 0])
    drive("step", ticks=6)
    assert not drive("get_cube_info", cube_name="a")["sleeping"] and drive.where("a")[0] > before[0] + 0.02


def test_planets_pull_alike_at_bodies_that_may_sleep_and_that_may_not() -> None:
    places = []
    for sleep in (True, False):
        drive = Driver({"type": "planets"}, engine={"sleep": sleep})
        genome = creatures.snake(brain=None, segments=5)
        drive("spawn_creature", genome=genome, position=[3, 5, 2], name="s")
        base = drive("spawn_cube", cube_name="base", position=[-4, 6, 0], is_base=True)["spawned"]
        drive.drop("arm", -3, 6, 0.2)
        drive("create_joint", cube1=base, cube2="arm", joint_type="hinge")
        drive("step", ticks=24)
        assert drive.where("arm")[1] < 5.9  # it swings
        drive("step", ticks=36)
        places.append([cube["position"] for cube in drive("get_world_state")["cubes"]])
    assert np.allclose(places[0], places[1], rtol=0, atol=1e-6)


def test_planets_pull_at_cubes_that_come_without_a_model_being_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    places = []
    for parking_from in (2, 1000):
        monkeypatch.setattr(rebuild, "PARKING_FROM", parking_from)
        drive = Driver({"type": "planets"}, damping={"linear": 0.3, "angular": 0.1})
        drive.drop("resting", 9, 0.01, 0)
        for number in range(20):
            drive.drop(f"c{number}", 3.0 * number, 10, 5)
            drive("step", ticks=2)
        places.append([cube["position"] for cube in drive("get_world_state")["cubes"]])
    assert np.allclose(places[0], places[1], rtol=0, atol=1e-9)
    assert places[0][1][1] < 9


@pytest.mark.parametrize("number", range(100, 106))
def test_parked_bodies_do_not_affect_a_world_of_planets(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rebuild, "PARKING_FROM", 2)
    program = programs.draw(number, 80)
    config = {"mode": "lockstep", "seed": number, "scene": {"type": "planets"}, "damping": DAMPING}
    first, second = World(config), World(config)
    played = programs.play(first, program[:40])
    assert programs.play(second, program[:40]) == played
    snapshot = first.simulation.snapshot()
    second.simulation.snapshot()
    second.simulation.restore(snapshot)
    assert programs.play(first, program[40:]) == programs.play(second, program[40:])


def test_a_snapshot_does_not_change_contact_forces_on_a_planet() -> None:
    drive = Driver({"type": "planets"})
    drive.drop("a", 0, -200.5, 0)
    drive("step", ticks=60)
    drive.world.simulation.snapshot()
    force = sum(contact["force"] for contact in drive("get_cube_info", cube_name="a")["contacts"])
    assert force == pytest.approx(G, abs=0.01)


def test_planets_are_listed() -> None:
    drive = Driver({"type": "planets"})
    reply = drive("get_planets", id=3)
    protocol.validate_reply(reply)
    planets = reply["planets"]
    places = sorted((p["Position"]["x"], p["Position"]["y"], p["Position"]["z"]) for p in planets)
    line = (-800, 0, 800)
    assert places == sorted((x, y - 100, z) for x in line for y in line for z in line)
    assert planets[0]["Position"] == {"x": 0, "y": -100, "z": 0}
    assert len({p["Name"] for p in planets}) == len({p["Seed"] for p in planets}) == 27
    assert set(planets[0]) == {"Name", "Position", "Seed", "BiomeType", "ResourceLocations", "TreeLocations"}
    assert drive("get_planets")["planets"] == planets == Driver({"type": "planets"})("get_planets")["planets"]
    drive("reset", seed=5)
    assert drive("get_planets")["planets"] == Driver({"type": "planets"}, seed=5)("get_planets")["planets"] != planets
    assert Driver({})("get_planets") == {"type": "planets", "planets": []}


CORNER = {"type": "planets", "planets": {"layout": "corner"}}


def test_the_planets_of_the_original_are_a_grid_that_begins_at_the_origin() -> None:
    drive = Driver(CORNER)
    reply = drive("get_planets", id=3)
    protocol.validate_reply(reply)
    planets = reply["planets"]
    grid = [(x, y, z) for x in range(3) for y in range(3) for z in range(3)]
    assert [planet["Name"] for planet in planets] == [str(cell) for cell in grid]
    assert planets[5]["Name"] == "(0, 1, 2)" and planets[5]["Position"] == {"x": 0, "y": 800, "z": 1600}
    assert [tuple(planet["Position"].values()) for planet in planets] == [
        (800 * x, 800 * y, 800 * z) for x, y, z in grid
    ]
    seeds = [planet["Seed"] for planet in planets]
    assert len(set(seeds)) == 27 and min(seeds) < 0 < max(seeds)
    assert all(-(2**31) <= seed < 2**31 for seed in seeds)
    spec = spec_of(CORNER)
    assert [planet.position for planet in spec.planets] == [(800.0 * x, 800.0 * y, 800.0 * z) for x, y, z in grid]


def test_resources_and_trees_are_spread_over_their_planets() -> None:
    planets = Driver(CORNER)("get_planets")["planets"]
    places = []
    for planet in planets:
        assert (len(planet["ResourceLocations"]), len(planet["TreeLocations"])) == (20, 10)
        places += [tuple(place.values()) for place in planet["ResourceLocations"] + planet["TreeLocations"]]
    assert len(set(places)) == 27 * 30
    assert np.linalg.norm(places, axis=1) == pytest.approx(np.full(len(places), 0.5), abs=1e-12)
    # Even over a sphere of radius 1/2: means of 0, and of squares of 1/12; each within four standard deviations.
    assert np.mean(places, axis=0) == pytest.approx(np.zeros(3), abs=4 * math.sqrt(1 / 12 / len(places)))
    assert np.mean(np.square(places), axis=0) == pytest.approx(
        np.full(3, 1 / 12), abs=4 * 0.0745 / math.sqrt(len(places))
    )


def test_planets_of_the_original_follow_from_the_seed() -> None:
    def planets(number: int, **fields: Any) -> list[Reply]:
        scene = {"type": "planets", "planets": {"layout": "corner", **fields}}
        found: list[Reply] = Driver(scene, seed=number)("get_planets")["planets"]
        return found

    assert planets(1) == planets(1) != planets(2)
    assert planets(1, seed=9) == planets(2, seed=9)
    first = planets(1)[0]
    tree = {"x": 0.4650483862997031, "y": 0.17927688345891976, "z": -0.0398722642610004}
    assert (first["Seed"], first["BiomeType"], first["TreeLocations"][0]) == (901120952, 2, tree)  # for ever


def test_cubes_fall_towards_the_nearest_planet_of_the_original() -> None:
    drive = Driver(CORNER, gravity=[0, -9.8, 0])
    starts = {"a": (0.0, 130.0, 0.0), "b": (660.0, 0.0, 0.0), "c": (60.0, -60.0, 100.0)}
    for name, start in starts.items():
        drive.drop(name, *start)
    drive("step", ticks=30)
    centres = {"a": (0.0, 0.0, 0.0), "b": (800.0, 0.0, 0.0), "c": (0.0, 0.0, 0.0)}
    for name, start in starts.items():
        down = np.subtract(centres[name], start)
        fallen = np.subtract(drive.where(name), start)
        assert fallen == pytest.approx(down / np.linalg.norm(down) * 9.8 * 0.5**2 / 2, abs=0.02)


@pytest.mark.parametrize("count", [1, 2, 8, 9, 64, 65])
def test_planets_do_not_touch_and_the_first_one_is_below_the_origin(count: int) -> None:
    spec = spec_of({"type": "planets", "planets": {"count": count, "radius": 50, "spacing": 100}})
    places = np.array([planet.position for planet in spec.planets])
    assert len(places) == count
    assert places[0].tolist() == [0, -50, 0]
    apart = np.linalg.norm(places[:, None] - places[None], axis=2) + 1e9 * np.eye(count)
    assert count == 1 or apart.min() == 100
    assert abs(np.add(places, [0, 50, 0])).max() <= 100 * math.ceil(count ** (1 / 3))
