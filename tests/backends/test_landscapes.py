"""Landscapes and obstacles of scenes: what lies on them, slides over them and falls into them."""

from __future__ import annotations

import base64
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_scenes import HILLS, IMAGE, Driver, G, Reply, png, spec_of, surface

from nmes import World
from nmes.backend import Array, StaticBox
from nmes.backend.rotation import quaternion_from_euler
from nmes.errors import RejectedMessage, WorldError

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
