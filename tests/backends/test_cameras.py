"""Pictures from cameras on cubes, and replays of recordings that hold such pictures."""

from __future__ import annotations

import base64
import math
import struct
import subprocess
import sys
import zlib
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from nmes import World
from nmes.playback import replay
from nmes.world import readings
from recordings import record, rewrite, send
from sensing import Place, Reply

# -- camera ----------------------------------------------------------------------------------------------------------


def pixels(reply: Reply) -> npt.NDArray[np.uint8]:
    """Reads a PNG file as the standard has it, as far as ours go."""
    data = base64.b64decode(reply["image"])
    assert data.startswith(b"\x89PNG\r\n\x1a\n")
    at, parts = 8, {}
    while at < len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        body = data[at + 8 : at + 8 + length]
        assert struct.unpack_from(">I", data, at + 8 + length) == (zlib.crc32(kind + body),)
        parts[kind] = body
        at += 12 + length
    assert list(parts) == [b"IHDR", b"IDAT", b"IEND"]
    width, height, depth, color, *rest = struct.unpack(">IIBBBBB", parts[b"IHDR"])
    assert (width, height, depth, color, rest) == (reply["width"], reply["height"], 8, 2, [0, 0, 0])
    rows = np.frombuffer(zlib.decompress(parts[b"IDAT"]), np.uint8).reshape(height, 1 + 3 * width)
    assert not rows[:, 0].any()
    return rows[:, 1:].reshape(height, width, 3)


@pytest.fixture
def studio() -> Place:
    """A cube that looks along -z at a red cube, with a green one at its right and a blue one behind it."""
    place = Place(gravity=[0, 0, 0])
    place.spawn("eye", [0, 5, 0], color=[1, 1, 1])
    place.spawn("red", [0, 5, -5], color=[1, 0, 0])
    place.spawn("green", [5, 5, 0], color=[0, 1, 0])
    place.spawn("blue", [0, 5, 5], color=[0, 0, 1])
    place("step")
    reply = place.world.execute(place.client, {"type": "get_camera", "cube_name": "eye", "width": 8, "height": 8})
    if reply["type"] == "error":
        assert reply["code"] == "unsupported"
        pytest.skip(f"no picture to judge: {reply['message']}")
    return place


def hue(image: npt.NDArray[np.uint8]) -> int | None:
    """Which of red, green and blue an image shows alone, if it does."""
    strong = [int(channel) for channel in range(3) if image[..., channel].max() > 60]
    return strong[0] if len(strong) == 1 else None


def test_a_camera_shows_what_is_in_front_of_it(studio: Place) -> None:
    for turn, color in (([0, 0, 0], 0), ([0, -math.pi / 2, 0], 1), ([0, math.pi, 0], 2)):
        image = pixels(studio("get_camera", cube_name="eye", rotation=turn, width=64, height=48, fov=1.0))
        assert image.shape == (48, 64, 3)
        assert hue(image[22:26, 30:34]) == color
        assert hue(image[:4, :4]) is None
    assert pixels(studio("get_camera", cube_name="eye")).shape == (240, 320, 3)
    studio("spawn_cube", list=False)
    assert studio("get_camera", width=2, height=1)["cube_name"] not in ("eye", "red")


def test_a_narrower_view_shows_it_larger_and_upright(studio: Place) -> None:
    def share(fov: float) -> float:
        image = pixels(studio("get_camera", cube_name="eye", width=60, height=60, fov=fov))
        return float(((image[..., 0] > 60) & (image[..., 1] < 40)).mean())

    # The cube's face is 4.5 m away and 1 m wide.
    for fov in (0.5, 1.0, 1.5):
        assert share(fov) == pytest.approx((0.5 / 4.5 / math.tan(fov / 2)) ** 2, abs=0.03)
    above = pixels(studio("get_camera", cube_name="eye", width=40, height=40, rotation=[0.2, 0, 0]))
    red = np.argwhere((above[..., 0] > 60) & (above[..., 1] < 40))
    assert red[:, 0].mean() > 22  # rows count from the top, and the camera looks up


def test_a_camera_moves_with_its_cube(studio: Place) -> None:
    studio("set_cube_state", cube_name="eye", rotation=[0, math.pi, 0])
    studio("step")
    for turn, color in (([0, 0, 0], 2), ([0, math.pi / 2, 0], 1)):
        image = pixels(studio("get_camera", cube_name="eye", width=32, height=32, rotation=turn))
        assert hue(image[14:18, 14:18]) == color
    studio("set_cube_state", cube_name="eye", position=[5, 5, 4], rotation=[0, 0, 0])
    studio("step")
    image = pixels(studio("get_camera", cube_name="eye", width=32, height=32))
    assert hue(image[14:18, 14:18]) == 1
    outside = pixels(studio("get_camera", cube_name="eye", width=32, height=32, position=[0, 0, 3]))
    assert outside[16, 16].min() > 60  # the white cube itself, seen from behind


def test_drawing_does_not_change_the_world(studio: Place) -> None:
    digest = studio.world.digest()
    first = studio("get_camera", cube_name="eye")
    assert studio.world.digest() == digest
    assert studio("get_camera", cube_name="eye") == first
    other = Place(gravity=[0, 0, 0])
    for name, position in (("eye", [0, 5, 0]), ("red", [0, 5, -5]), ("green", [5, 5, 0]), ("blue", [0, 5, 5])):
        other.spawn(name, position)
    other("step")
    for place in (studio, other):
        place("apply_physics", cube_name="red", impulse=[1, 0, 2], angular_impulse=[0.1, 0.2, 0])
        place("step", ticks=20)
    assert studio.world.digest() == other.world.digest()


def test_a_picture_of_a_transparent_cube_does_not_hide_it_from_rays(studio: Place) -> None:
    studio.spawn("glass", [0, 5, -2], color=[1, 1, 1, 0])
    studio("step")
    for _ in range(2):
        image = pixels(studio("get_camera", cube_name="eye", width=9, height=9))
        assert hue(image[4:5, 4:5]) == 0
        assert studio.info("eye", rays=[[0, 0, -1]])["ranges"] == pytest.approx([1.5])


@pytest.mark.parametrize("frozen", [False, True])
def test_touching_cubes_of_one_color_show_where_one_ends(studio: Place, frozen: bool) -> None:
    def row() -> list[int]:
        """Returns how green the pixels across the middle of a wall are."""
        studio("step")
        view = {"width": 90, "height": 60, "fov": 0.8, "rotation": [0, -math.pi / 2, 0]}
        return [int(value) for value in pixels(studio("get_camera", cube_name="eye", **view))[30, 20:70, 1]]

    green = [0, 1, 0]
    studio("despawn_cube", cube_name="green")
    for z in (-1, 0, 1):
        studio.spawn(f"part{z}", [4, 5, z], color=green, is_base=frozen)
    dark = [column for column, value in enumerate(row()) if value < 60]
    lines = [column for column in dark if column - 1 not in dark]  # where each begins: it is a pixel or two wide
    assert len(lines) == 2 and len(dark) <= 4
    assert lines[1] - lines[0] == pytest.approx(60 / 3.5 / (2 * math.tan(0.4)), abs=1.5)
    for z in (-1, 0, 1):
        studio("despawn_cube", cube_name=f"part{z}{'_BASE' * frozen}")
    studio.spawn("whole", [4, 5, 0], size=[1, 1, 3], color=green, is_base=frozen)
    assert min(row()) > 60


def from_above(scene: Reply, height: float, width: int = 81) -> npt.NDArray[np.int_]:
    """Returns how green the pixels are along x, seen straight from above in the middle of a scene."""
    place = Place(gravity=[0, 0, 0], scene=scene)
    place.spawn("eye", [0, height, 0], size=0.01)
    place("step")
    view = {"width": width, "height": 9, "fov": 0.1, "position": [0, -0.1, 0], "rotation": [-math.pi / 2, 0, 0]}
    return pixels(place("get_camera", cube_name="eye", **view))[4, :, 1].astype(int)


def test_steps_of_stairs_are_of_two_tones(studio: Place) -> None:
    stairs = {"type": "stairs", "position": [-2, 0, 0], "length": 4, "width": 2, "height": 0.4, "steps": 4}
    row = from_above({"obstacles": [stairs]}, 10)  # nine pixels a step
    tones = [int(row[40 + middle]) for middle in (-13, -4, 4, 13)]
    assert all(abs(one - other) > 15 for one, other in pairwise(tones))
    assert abs(tones[0] - tones[2]) < 10 and abs(tones[1] - tones[3]) < 10


def test_gaps_are_dark_and_the_ground_is_light(studio: Place) -> None:
    gap = {"type": "gap", "position": [0, 0, 0], "length": 2, "width": 100, "depth": 2}
    row = from_above({"obstacles": [gap]}, 10, 45)
    ground, bottom = np.concatenate([row[:12], row[-12:]]), row[20:25]
    assert ground.min() > 130 and bottom.max() < 0.6 * ground.min()


def test_the_sky_round_planets_has_no_horizon(studio: Place) -> None:
    place = Place(scene={"type": "planets", "planets": {"count": 1}}, gravity=[0, 0, 0])
    place.spawn("eye", [0, 500, 0])
    place("step")
    view = {"width": 9, "height": 64, "fov": 2.5, "position": [0, 5, 0]}
    sky = pixels(place("get_camera", cube_name="eye", **view))[:48, 4].astype(int)
    assert np.ptp(sky, axis=0).max() < 50 and sky.max() < 90


def test_pictures_are_right_after_changes_of_structure_and_beside_other_worlds(studio: Place) -> None:
    other = Place()
    other.spawn("a", [0, 1, 0])
    for size in (16, 64, 24):
        studio.spawn(f"wall{size}", [0, 5 + size, -3])
        studio("step")
        image = pixels(studio("get_camera", cube_name="eye", width=size, height=size))
        assert hue(image[size // 2 - 1 : size // 2 + 1, size // 2 - 1 : size // 2 + 1]) == 0
        pixels(other("get_camera", cube_name="a", width=5, height=7))
    other.world.close()
    studio("reset")
    studio.spawn("eye", [0, 5, 0])
    assert studio("get_camera", cube_name="eye", width=4, height=4)["width"] == 4


def test_a_machine_without_a_renderer_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    from nmes.backends.mujoco3d import rendering

    monkeypatch.setattr(rendering, "opengl_context", lambda: None)
    place = Place()
    place.spawn("a", [0, 1, 0])
    assert place.refused("get_camera", cube_name="a") == ("unsupported", None)
    assert place.refused("get_camera", cube_name="b") == ("cube_not_found", "cube_name")
    assert place.world.fault is None


def test_cameras_are_claimed_only_where_a_library_may_draw() -> None:
    program = """
import ctypes
load = ctypes.CDLL
def hidden(name, *rest, **more):
    if name and ("EGL" in name or "OSMesa" in name):
        raise OSError(f"{name}: cannot open shared object file")
    return load(name, *rest, **more)
ctypes.CDLL = hidden
from nmes import World
world = World({"backend": "mujoco"})
client = world.join()
print({"camera", "get_camera"} & set(world.execute(client, {"type": "get_world_info"})["capabilities"]))
world.execute(client, {"type": "spawn_cube", "cube_name": "a"})
reply = world.execute(client, {"type": "get_camera", "cube_name": "a"})
print(reply["code"], reply["message"])
"""
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    claimed, answer = result.stdout.splitlines()
    assert claimed == "set()"
    assert answer.startswith("unsupported the mujoco backend has no cameras here: this machine has no OpenGL")
    assert "libegl1" in answer


# -- replay ----------------------------------------------------------------------------------------------------------


def photograph(world: World, client: int) -> None:
    send(world, client, type="spawn_cube", cube_name="a")
    send(world, client, type="step", ticks=3)
    send(world, client, type="get_camera", cube_name="a", width=4, height=4)
    parts = [{"type": "get_camera", "cube_name": "a", "width": 4, "height": 4}, {"type": "get_cube_state"}]
    send(world, client, type="batch", commands=parts)
    send(world, client, type="get_cube_info", cube_name="a", sensors=True, rays=[[0, -1, 0]])


def test_a_replay_does_not_compare_pixels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = record(tmp_path / "a.mcap", photograph, {"backend": "mujoco"})
    assert replay(source).verdict == "reproduced"
    monkeypatch.setattr(readings, "png", lambda image: "AAAA")
    report = replay(source)
    assert (report.verdict, report.commands) == ("reproduced", 5)


def test_a_replay_without_a_renderer_reproduces_all_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from nmes.backends.mujoco3d import rendering

    source = record(tmp_path / "a.mcap", photograph, {"backend": "mujoco"})
    monkeypatch.setattr(rendering, "opengl_context", lambda: None)
    assert replay(source).verdict == "reproduced"


def test_a_replay_compares_the_other_fields_of_a_reply_with_a_picture(tmp_path: Path) -> None:
    source = record(tmp_path / "a.mcap", photograph, {"backend": "mujoco"})
    changed = rewrite(
        source,
        tmp_path / "b.mcap",
        lambda lines: [
            line._replace(data=line.data.replace(b'"linear_velocity":[0.0', b'"linear_velocity":[0.5'))
            if b"batch_result" in line.data
            else line
            for line in lines
        ],
    )
    divergence = replay(changed).divergence
    assert divergence is not None and divergence.value is not None
    assert (divergence.kind, divergence.command, divergence.value.field) == ("reply", "batch", "linear_velocity/0")
