"""Scenes: what the config's `scene` makes, whether it carries, and whether it is the same again."""

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
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

import creatures
import programs
import recordings
from layout import ROOT, SUPPORT
from nmes import World, protocol, schemas
from nmes.backend import Arena, Array, Heightfield, SceneSpec, StaticBox
from nmes.backend.rotation import quaternion_from_euler
from nmes.backends.mujoco3d import MujocoBackend, MujocoSimulation, rebuild
from nmes.backends.mujoco3d.arenas import parts
from nmes.errors import RejectedMessage, WorldError
from nmes.playback import replay
from nmes.world import scenery

Reply = dict[str, Any]
G = 9.81
DOCUMENT = (ROOT / "docs" / "scenes.md").read_text()
DAMPING = {"linear": 0.4, "angular": 0.1}
ARENAS = ["bowl", "corridor", "gaps", "walls", "maze"]


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


# -- landscapes ------------------------------------------------------------------------------------------------------


def test_a_cube_rests_on_a_plateau_at_its_height() -> None:
    drive = Driver({"type": "heightfield", "heightfield": {"heights": [[3.25, 3.25], [3.25, 3.25]]}})
    drive.drop("a", 2.2, 5, -7.3)
    drive("step", ticks=90)
    assert drive.where("a") == pytest.approx([2.2, 3.75, -7.3], abs=0.005)
    info = drive("get_cube_info", cube_name="a")
    assert info["sleeping"] and {contact["cube_name"] for contact in info["contacts"]} == {None}
    carried = sum(contact["force"] * np.array(contact["normal"]) for contact in info["contacts"])
    assert carried == pytest.approx([0, G, 0], abs=0.5)


@pytest.mark.parametrize("heading", [0.0, 0.7])
def test_a_cube_slides_over_a_plateau_as_the_formula_says(heading: float) -> None:
    drive = Driver({"type": "heightfield", "heightfield": {"heights": [[1, 1], [1, 1]]}})
    velocity = [3 * math.cos(heading), 0, -3 * math.sin(heading)]
    drive.drop("a", 0.1, 1.5, 0.2, friction=0.1, linear_velocity=velocity, rotation=[0, heading, 0])
    drive("step", ticks=240)
    x, y, z = drive.where("a")
    assert y == pytest.approx(1.5, abs=0.005)
    # Seams between the engine's triangles cost some speed, and never give any.
    assert 0.6 < math.hypot(x - 0.1, z - 0.2) / (3**2 / (2 * 0.1 * G)) < 1.02


def test_rows_run_along_z_and_columns_along_x() -> None:
    # Four terraces: columns at x = -15 and 15 with a cliff in between, and likewise for rows.
    heights = np.repeat(np.repeat([[1.0, 2.0], [3.0, 4.0]], 2, axis=0), 2, axis=1)
    drive = Driver({"type": "heightfield", "heightfield": {"size": [30, 30], "heights": heights.tolist()}})
    places = {"a": (-10, -10, 1.0), "b": (10, -10, 2.0), "c": (-10, 10, 3.0), "d": (10, 10, 4.0)}
    for name, (x, z, height) in places.items():
        drive.drop(name, x, height + 1, z, size=0.5)
    drive("step", ticks=90)
    for name, (x, z, height) in places.items():
        assert drive.where(name) == pytest.approx([x, height + 0.25, z], abs=0.005)


@pytest.mark.parametrize("axis", [0, 2])
def test_a_cube_on_a_slope_touches_it(axis: int) -> None:
    slope = np.linspace(-4, 4, 33)
    heights = np.tile(slope, (33, 1)) if axis == 0 else np.tile(slope, (33, 1)).T
    drive = Driver({"type": "heightfield", "heightfield": {"size": [20, 20], "heights": heights.tolist()}})
    drive.drop("a", 1, 2, 1, friction=2)
    drive("step", ticks=300)
    at = drive.where("a")
    above = (at[1] - 0.4 * at[axis]) / math.hypot(1, 0.4)
    assert above == pytest.approx(0.5, abs=0.005)
    assert abs(at[2 - axis] - 1) < 0.01


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_small_cubes_lie_on_drawn_hills(seed: int) -> None:
    drive = Driver(HILLS, seed=seed)
    field = spec_of(HILLS, seed).heightfield
    assert field is not None
    assert surface(field, 0, 0) == 0.0
    assert field.heights.max() - field.heights.min() <= 2.0
    for i in range(9):
        x, z = 4.0 * (i % 3 - 1), 4.0 * (i // 3 - 1)
        drive.drop(f"c{i}", x, surface(field, x, z) + 0.3, z, size=0.2, friction=5)
    drive("step", ticks=240)
    for i in range(9):
        x, y, z = drive.where(f"c{i}")
        assert 0.06 < y - surface(field, x, z) < 0.16


def test_the_clearing_is_level_and_nothing_else() -> None:
    field = spec_of({"type": "heightfield", "heightfield": {"clearing": 5}}).heightfield
    assert field is not None
    axis = np.linspace(-50, 50, 101)
    near = np.hypot(*np.meshgrid(axis, axis)) <= 5
    assert not field.heights[near].any()
    assert field.heights[~near].any(axis=0).all()


@pytest.mark.parametrize(("mode", "white"), [("L", 255), ("I;16", 65535)])
def test_an_image_becomes_heights(mode: str, white: int) -> None:
    pixels = np.zeros((5, 9))
    pixels[1, 6] = white
    pixels[2, :] = white // 5
    scene = {"type": "heightfield", "heightfield": {"size": [8, 4], "height": 3, "image": png(pixels, mode=mode)}}
    field = spec_of(scene).heightfield
    assert field is not None and field.heights == pytest.approx(pixels / white * 3)
    drive = Driver(scene)
    assert drive.world.config["scene"]["heightfield"]["image"] == png(pixels, mode=mode)
    drive.drop("peak", 2, 4, -1, size=0.2)
    drive("step", ticks=20)
    assert drive.where("peak")[1] > 2.9


def test_a_colour_image_is_read_as_grey() -> None:
    colours = np.zeros((2, 2, 3))
    colours[0, 0] = 255
    scene = {"type": "heightfield", "heightfield": {"height": 1, "image": png(colours)}}
    field = spec_of(scene).heightfield
    assert field is not None and field.heights.tolist() == [[1, 0], [0, 0]]


HEADER = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"


@pytest.mark.parametrize(
    "image",
    [
        "not base64!",
        base64.b64encode(b"GIF89a" + bytes(40)).decode(),
        base64.b64encode(HEADER).decode(),
        base64.b64encode(HEADER + b"\xff\xff\xff\xff" * 2 + bytes(20)).decode(),
        base64.b64encode(HEADER + b"\0\0\0\x08" * 2 + bytes(20)).decode(),
        base64.b64encode(base64.b64decode(IMAGE)[:-30]).decode(),
        png(np.zeros((1, 5))),
    ],
)
def test_an_invalid_image_is_refused(image: str) -> None:
    with pytest.raises(RejectedMessage) as refused:
        World({"scene": {"type": "heightfield", "heightfield": {"image": image}}})
    assert (refused.value.code, refused.value.path) == ("invalid", "scene/heightfield/image")


@given(data=st.binary(max_size=80), place=st.integers(0, 80))
def test_broken_images_are_refused_or_read(data: bytes, place: int) -> None:
    whole = base64.b64decode(IMAGE)
    image = base64.b64encode(whole[:place] + data + whole[place + len(data) :]).decode()
    try:
        field = spec_of({"type": "heightfield", "heightfield": {"image": image}}).heightfield
        assert field is not None and np.isfinite(field.heights).all()
    except WorldError as error:
        assert error.path == "scene/heightfield/image"


def test_big_cubes_lie_on_a_fine_landscape() -> None:
    landscape = {"type": "heightfield", "heightfield": {"size": [40, 40], "samples": [401, 401], "hill": 2}}
    drive, field = Driver(landscape), spec_of(landscape).heightfield
    assert field is not None
    names = [drive.drop(f"c{i}", 5 * (i % 4 - 1.5), 4.5, 5 * (i // 4 - 0.5), size=5) for i in range(8)]
    drive("step", ticks=240)
    for name in names:
        x, y, z = drive.where(name)
        assert surface(field, x, z) + 2.48 < y < 4.5  # not in the ground, and fallen from where it was dropped
        assert drive("get_cube_info", cube_name=name)["linear_velocity"] == pytest.approx([0, 0, 0], abs=0.3)


# -- obstacles -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("heading", [0.0, math.pi / 2, 2.5])
def test_balls_of_cubes_lie_on_every_step_of_stairs(heading: float) -> None:
    stairs = {"type": "stairs", "position": [2, 1, 3], "length": 4, "width": 3, "height": 2, "steps": 5}
    drive = Driver({"obstacles": [{**stairs, "heading": heading}]})
    expected = {}
    for step in range(5):
        for side in (-1, 0, 1):
            along = 0.8 * (step + 0.5)
            # About y by the right hand rule, x turns towards -z.
            x = 2 + along * math.cos(heading) + side * math.sin(heading)
            z = 3 - along * math.sin(heading) + side * math.cos(heading)
            top = 1 + 0.4 * (step + 1)
            name = drive.drop(f"c{step}{side}", x, top + 0.4, z, size=0.3)
            expected[name] = [x, top + 0.15, z]
    drive("step", ticks=60)
    for name, place in expected.items():
        assert drive.where(name) == pytest.approx(place, abs=0.01)


def test_a_cube_slides_down_a_ramp_as_the_formula_says_and_one_that_grips_stays() -> None:
    # The ramp rises along -z: heading is a turn about y from x by the right hand rule.
    ramp = {"type": "ramp", "position": [0, 0, 10], "length": 20, "width": 6, "height": 10, "heading": math.pi / 2}
    drive = Driver({"obstacles": [ramp]})
    slope = math.atan2(10, 20)
    along, off = 15.0, 0.25
    z, y = 10 - along * math.cos(slope), along * math.sin(slope)
    start = [0.0, y + off * math.cos(slope), z + off * math.sin(slope)]
    for name, x, friction in (("slides", -1.5, 0.2), ("grips", 1.5, 1.0)):
        drive.drop(name, x, *start[1:], size=0.5, friction=friction, rotation=[slope, 0, 0])
    drive("step", ticks=90)
    way = 0.5 * G * (math.sin(slope) - 0.2 * math.cos(slope)) * 1.5**2
    moved = drive.where("slides")
    assert math.dist(moved, [-1.5, *start[1:]]) == pytest.approx(way, rel=0.05)
    assert moved[2] > start[2] and moved[1] < start[1]
    assert math.dist(drive.where("grips"), [1.5, *start[1:]]) < 0.02


def test_a_ramp_begins_at_its_foot_and_ends_at_its_height() -> None:
    (box,) = spec_of({"obstacles": [{"type": "ramp", "length": 4, "width": 2, "height": 3}]}).boxes
    edge = np.array(box.size) / 2
    corners = {
        tuple(np.round(np.add(box.position, rotate(box, (sx * edge[0], edge[1], 0.0))), 9).tolist()) for sx in (-1, 1)
    }
    assert corners == {(0.0, 0.0, 0.0), (4.0, 3.0, 0.0)}


def rotate(box: StaticBox, arm: tuple[float, float, float]) -> Array:
    x, y, z, w = box.quaternion
    u = np.array([x, y, z])
    return np.asarray(np.array(arm) + 2 * np.cross(u, np.cross(u, arm) + w * np.array(arm)))


def test_a_wall_stops_what_runs_into_it() -> None:
    wall = {"type": "wall", "position": [4, 0, 0], "length": 6, "width": 0.5, "height": 2, "heading": math.pi / 2}
    drive = Driver({"obstacles": [wall]})
    drive.drop("a", 0, 0.5, 2, friction=0, linear_velocity=[6, 0, 0])
    drive.drop("past", 0, 0.5, 5, friction=0, linear_velocity=[6, 0, 0])
    drive("step", ticks=120)
    assert drive.where("a")[0] < 3.3
    assert drive.where("past")[0] == pytest.approx(12, abs=0.1)


def test_a_box_has_the_position_and_rotation_of_its_config() -> None:
    drive = Driver({"obstacles": [{"type": "box", "position": [0, 2, 0], "size": [4, 1, 1], "rotation": [0, 0.5, 0]}]})
    drive.drop("on", 1.5 * math.cos(0.5), 3, -1.5 * math.sin(0.5), size=0.4)
    drive.drop("off", 1.5 * math.cos(0.5), 3, 1.5 * math.sin(0.5), size=0.4)
    drive("step", ticks=90)
    assert drive.where("on")[1] == pytest.approx(2.7, abs=0.005)
    assert drive.where("off")[1] == pytest.approx(0.2, abs=0.005)


def test_a_cube_falls_into_a_gap_and_only_there() -> None:
    gaps = [
        {"type": "gap", "position": [3, 0, 0], "length": 2, "width": 4, "depth": 2},
        {"type": "gap", "position": [6, 50, 0], "length": 2, "width": 4, "depth": 5},
    ]
    drive = Driver({"obstacles": gaps})
    for name, x, z in (("in", 3, 1), ("deep", 6, 1), ("beside", 0, 0), ("behind", 3, 4), ("far", -900, 900)):
        drive.drop(name, x, 1.0, z)
    drive.drop("slides", -4, 0.5, 1, friction=0.05, linear_velocity=[6, 0, 0])
    drive("step", ticks=40)
    over = drive.where("slides")
    assert over[1] == pytest.approx(0.5, abs=0.005) and over[0] < 0
    drive("step", ticks=140)
    heights = {"in": -1.5, "deep": -4.5, "beside": 0.5, "behind": 0.5, "far": 0.5}
    assert {name: drive.where(name)[1] for name in heights} == pytest.approx(heights, abs=0.005)


GAPS = st.lists(
    st.fixed_dictionaries(
        {
            "type": st.just("gap"),
            "position": st.tuples(st.integers(-1005, 1005), st.integers(-9, 9), st.integers(-1005, 1005)),
            "length": st.integers(1, 900),
            "width": st.integers(1, 900),
            "depth": st.integers(1, 9),
        }
    ),
    min_size=1,
    max_size=5,
)


@given(gaps=GAPS, x=st.integers(-999, 998), z=st.integers(-999, 998))
def test_the_ground_is_as_deep_as_the_deepest_gap_at_a_place(gaps: list[Reply], x: int, z: int) -> None:
    spec = spec_of({"obstacles": gaps})
    assert not spec.ground
    place = x + 0.25, z + 0.25  # edges are at whole and half metres
    depth = max(
        (
            gap["depth"]
            for gap in gaps
            if abs(place[0] - gap["position"][0]) < gap["length"] / 2
            and abs(place[1] - gap["position"][2]) < gap["width"] / 2
        ),
        default=0,
    )
    over = [
        box.position[1] + box.size[1] / 2
        for box in spec.boxes
        if abs(place[0] - box.position[0]) < box.size[0] / 2 and abs(place[1] - box.position[2]) < box.size[2] / 2
    ]
    assert over == [pytest.approx(-depth)]  # and nothing overlaps


@given(
    size=st.tuples(*[st.floats(0.1, 9)] * 3),
    position=st.tuples(*[st.floats(-5, 5)] * 3),
    turn=st.tuples(*[st.floats(-3, 3)] * 3),
    share=st.tuples(st.floats(0, 1), st.floats(0, 1)),
)
def test_the_section_of_a_box_is_what_lies_in_the_plane(size: Any, position: Any, turn: Any, share: Any) -> None:
    box = StaticBox(size, position, quaternion_from_euler(*turn))
    cut = box.section()
    corners = [
        np.add(position, rotate(box, (a * size[0], b * size[1], c * size[2])))
        for a in (-0.5, 0.5)
        for b in (-0.5, 0.5)
        for c in (-0.5, 0.5)
    ]
    reaches = min(corner[2] for corner in corners) < 0 <= max(corner[2] for corner in corners)
    assert bool(cut) == reaches
    for x, y in cut:  # on the surface: one of its own coordinates is as large as it may be
        x1, y1, z1, w1 = box.quaternion
        back = StaticBox(size, (0, 0, 0), (-x1, -y1, -z1, w1))
        own = np.abs(rotate(back, (x - position[0], y - position[1], -position[2]))) / (np.array(size) / 2)
        assert own.max() == pytest.approx(1, abs=1e-6)


def test_cubes_let_go_in_a_thousand_steps_are_pushed_out_of_them() -> None:
    stairs = {"type": "stairs", "position": [-0.5, 0, 0], "length": 1, "width": 2, "height": 1, "steps": 1000}
    drive = Driver({"obstacles": [stairs]})
    names = [drive.drop(f"c{i}", 0.3 * i, 0.5, 0, is_base=True) + "_BASE" for i in range(3)]  # held where it is put
    for name in names:
        drive("freeze_cube", cube_name=name, freeze=False)
    drive("step", ticks=120)
    for name in names:
        x, y, z = drive.where(name)
        assert abs(x) > 0.99 and (y, z) == pytest.approx((0.5, 0), abs=0.01)  # on the ground beside the stairs


# -- planets ---------------------------------------------------------------------------------------------------------


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
        return Driver(scene, seed=number)("get_planets")["planets"]  # type: ignore[no-any-return]

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


# -- arenas ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ARENAS)
def test_a_cube_finds_ground_where_an_arena_begins(name: str) -> None:
    drive = Driver(SCENES[name])
    drive.drop("a", 0, 1, 0)
    drive("step", ticks=90)
    x, y, z = drive.where("a")
    assert math.hypot(x, z) < 0.1
    assert y == pytest.approx(0.5, abs=0.05 if name == "bowl" else 0.001)


def test_the_bowl_has_a_rim() -> None:
    drive = Driver(SCENES["bowl"])
    for name, x, z in (("rim", 3, 0), ("opposite", 0, -3), ("outside", 8, 0)):
        drive.drop(name, x, 1, z, size=0.2, friction=5)
    drive("step", ticks=60)
    assert drive.where("rim")[1] > 0.3
    assert drive.where("opposite")[1] > 0.3
    assert drive.where("outside")[1] == pytest.approx(0.1, abs=0.001)


def test_a_corridor_has_walls_on_all_sides() -> None:
    drive = Driver({"type": "arena", "arena": {"name": "corridor", "width": 6, "length": 10}})
    for name, velocity in {"left": [0, 0, -9], "right": [0, 0, 9], "back": [-9, 0, 0], "ahead": [9, 0, 0]}.items():
        drive.drop(name, 0, 0.6 + 1.1 * len(drive.world.cubes()), 0, friction=0, linear_velocity=velocity)
    drive("step", ticks=150)
    places = {name: drive.where(name) for name in ("left", "right", "back", "ahead")}
    assert all(-2 < x < 12 and -3 < z < 3 for x, _, z in places.values()), places


def test_gaps_are_deep_and_platforms_are_not() -> None:
    drive = Driver(SCENES["gaps"])
    for i in range(36):
        drive.drop(f"c{i}", i, 0.3, 1.0, size=0.2)
    drive("step", ticks=120)
    heights = [drive.where(f"c{i}")[1] for i in range(36)]
    assert {round(y, 2) for y in heights} == {0.1, -9.9}


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
    config = json.loads(block)
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
