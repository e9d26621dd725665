"""What cubes feel and see, against physics and geometry; and that looking changes nothing."""

from __future__ import annotations

import base64
import math
import random
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nmes import World
from nmes.backend import Array
from nmes.backend.rotation import conjugate, euler_from_quaternion, normalize, quaternion_from_euler, rotate
from nmes.playback import replay
from nmes.world import readings
from recordings import record, rewrite, send

Reply = dict[str, Any]
G = 9.81
UP = (0.0, 1.0, 0.0)
FACES = ["+x", "-x", "+y", "-y", "+z", "-z"]


class Place:
    """A lockstep world and one client in it."""

    def __init__(self, **config: Any) -> None:
        self.world = World({"mode": "lockstep", "backend": "mujoco", **config})
        self.client = self.world.join()

    def __call__(self, type: str, **fields: Any) -> Reply:
        reply = self.world.execute(self.client, {"type": type, **fields})
        assert reply["type"] != "error", reply
        return reply

    def refused(self, type: str, **fields: Any) -> tuple[str, str | None]:
        reply = self.world.execute(self.client, {"type": type, **fields})
        assert reply["type"] == "error", reply
        return reply["code"], reply.get("field")

    def spawn(self, name: str, position: Any, **fields: Any) -> str:
        return str(self("spawn_cube", cube_name=name, position=position, **fields)["spawned"])

    def info(self, name: str, **fields: Any) -> Reply:
        return self("get_cube_info", cube_name=name, **fields)

    def settle(self, name: str) -> None:
        """Ticks until the cube sleeps."""
        for _ in range(300):
            self("step")
            if self.info(name)["sleeping"]:
                return
        raise AssertionError(f"{name} does not come to rest")


def pushes(info: Reply) -> dict[tuple[str, str | None], float]:
    """The normal force by face and partner, N."""
    total: dict[tuple[str, str | None], float] = {}
    for contact in info["contacts"]:
        key = contact["face"], contact["cube_name"]
        total[key] = total.get(key, 0.0) + contact["force"]
    return total


def turned(face: str) -> list[float]:
    """The rotation (Euler) that turns a face of a cube downwards, and the cube about the vertical."""
    down = {"+x": (0, 0, -1), "-x": (0, 0, 1), "+y": (1, 0, 0), "-y": (0, 0, 0), "+z": (1, 0, 0), "-z": (-1, 0, 0)}
    angle = math.pi if face == "+y" else math.pi / 2
    axis = down[face]
    half = math.sin(angle / 2)
    tip = (axis[0] * half, axis[1] * half, axis[2] * half, math.cos(angle / 2)) if any(axis) else (0.0, 0.0, 0.0, 1.0)
    about = quaternion_from_euler(0.0, 0.7, 0.0)
    w = [about[3] * tip[i] + tip[3] * about[i] for i in range(3)]
    x = w[0] + about[1] * tip[2] - about[2] * tip[1]
    y = w[1] + about[2] * tip[0] - about[0] * tip[2]
    z = w[2] + about[0] * tip[1] - about[1] * tip[0]
    q = (x, y, z, about[3] * tip[3] - sum(about[i] * tip[i] for i in range(3)))
    return list(euler_from_quaternion(normalize(q)))


# -- contacts --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("asleep", [False, True])
@pytest.mark.parametrize("face", FACES)
def test_a_resting_cube_is_pushed_at_the_face_that_is_down_by_its_weight(face: str, asleep: bool) -> None:
    place = Place(engine={"sleep": asleep})
    place.spawn("a", [2, 0.5, -1], mass=3, rotation=turned(face))
    place.settle("a") if asleep else place("step", ticks=120)
    info = place.info("a")
    assert info["sleeping"] is asleep
    assert pushes(info) == {(face, None): pytest.approx(3 * G, rel=0.01)}
    for contact in info["contacts"]:
        assert contact["normal"] == pytest.approx(UP)
        assert contact["position"][1] == pytest.approx(0, abs=0.005)
    assert len(info["contacts"]) == 4


@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
@pytest.mark.parametrize("asleep", [False, True])
def test_each_cube_of_a_stack_feels_the_weight_above_it(asleep: bool, cone: str) -> None:
    place = Place(engine={"sleep": asleep, "cone": cone})
    for i, name in enumerate("abc"):
        place.spawn(name, [0, 0.5 + i, 0], mass=i + 1)
    place.settle("a") if asleep else place("step", ticks=240)
    assert [place.info(name)["sleeping"] for name in "abc"] == [asleep] * 3
    assert pushes(place.info("a")) == {
        ("-y", None): pytest.approx(6 * G, rel=0.01),
        ("+y", "b"): pytest.approx(5 * G, rel=0.01),
    }
    assert pushes(place.info("b")) == {
        ("-y", "a"): pytest.approx(5 * G, rel=0.01),
        ("+y", "c"): pytest.approx(3 * G, rel=0.01),
    }
    assert pushes(place.info("c")) == {("-y", "b"): pytest.approx(3 * G, rel=0.01)}


def test_both_cubes_of_a_contact_report_the_same_force() -> None:
    place = Place()
    place.spawn("base", [0, 2, 0], is_base=True, rotation=[0, 0.4, 0])
    place.spawn("a", [0.2, 3, 0.1])
    for asleep in (False, True):
        place.settle("a") if asleep else place("step", ticks=5)
        one, other = place.info("a")["contacts"], place.info("base_BASE")["contacts"]
        assert {(c["cube_name"], c["face"]) for c in one} == {("base_BASE", "-y")}
        assert {(c["cube_name"], c["face"]) for c in other} == {("a", "+y")}
        assert [(c["position"], c["force"]) for c in one] == [(c["position"], c["force"]) for c in other]
        assert [c["normal"] for c in one] == [[-x for x in c["normal"]] for c in other]
    place.world.simulation.snapshot()
    assert (place.info("a")["contacts"], place.info("base_BASE")["contacts"]) == (one, other)


def test_a_cube_that_hits_a_wall_is_pushed_back_from_there() -> None:
    place = Place(gravity=[0, 0, 0])
    place.spawn("wall", [3, 5, 0], is_base=True)
    place.spawn("a", [0, 5, 0], linear_velocity=[6, 0, 0])
    seen: set[tuple[str, str | None]] = set()
    for _ in range(60):
        place("step")
        seen |= set(pushes(place.info("a")))
    assert seen == {("+x", "wall_BASE")}


def test_a_sleeping_cube_woken_by_an_edit_keeps_its_contacts() -> None:
    place = Place()
    place.spawn("a", [0, 0.5, 0])
    place.spawn("b", [1.1, 0.5, 0])
    joint = place("create_joint", cube1="a", cube2="b", joint_type="hinge", axis=[0, 1, 0])["joint_name"]
    place.settle("b")
    before = [place.info(name, sensors=True) for name in "ab"]
    place("set_joint_param", joint_name=joint, param_name="damping", value=0.5)
    after = [place.info(name, sensors=True) for name in "ab"]
    assert [cube.pop("sleeping") for cube in before + after] == [True, True, False, False]
    assert after == before and all(cube["contacts"] for cube in after)


def test_a_removed_cube_is_no_contact_any_more() -> None:
    place = Place()
    place.spawn("a", [0, 0.5, 0])
    place.spawn("b", [0, 1.5, 0])
    place.settle("b")
    assert set(pushes(place.info("a"))) == {("-y", None), ("+y", "b")}
    place("despawn_cube", cube_name="b")
    assert set(pushes(place.info("a"))) == {("-y", None)}
    place("step")
    assert set(pushes(place.info("a"))) == {("-y", None)}


def heaps(count: int = 12) -> Place:
    """A world in which heaps of one to four cubes sleep, some on frozen ones, and one cube is awake."""
    place = Place()
    draw = random.Random(count)
    for i in range(count):
        for k in range(1 + i % 4):
            where = [3.0 * i + draw.uniform(-0.1, 0.1), 0.5 + k, draw.uniform(-0.1, 0.1)]
            place.spawn(f"{i}.{k}", where, is_base=k == 0 and i % 5 == 4)
    place.spawn("late", [0, 500, 20])
    for _ in range(600):
        place("step")
        cubes = [place.info(name) for name in place.world.cubes()]
        if all(cube["sleeping"] or cube["frozen"] for cube in cubes if cube["cube_name"] != "late"):
            return place
    raise AssertionError("they do not come to rest")


def test_contacts_of_sleeping_cubes_do_not_depend_on_the_order_of_queries() -> None:
    places = [heaps(), heaps(), heaps()]
    names = places[0].world.cubes()
    together = {cube["cube_name"]: cube["contacts"] for cube in places[0]("get_world_state", sensors=True)["cubes"]}
    forwards = {name: places[1].info(name)["contacts"] for name in names}
    backwards = {}
    for name in reversed(names):
        places[2]("step")
        backwards[name] = places[2].info(name)["contacts"]
    assert together == forwards
    del backwards["late"], forwards["late"]
    assert backwards == forwards
    assert [name for name, contacts in forwards.items() if not contacts] == ["4.0_BASE"]


def test_a_sleeping_cube_that_was_moved_has_the_contacts_of_its_new_place() -> None:
    place = Place()
    place.spawn("a", [0, 0.5, 0])
    place.spawn("b", [5, 0.5, 0])
    place.settle("a")
    before = place.info("a")["contacts"]
    place("apply_physics", cube_name="a", impulse=[2, 0, 0])
    place("step")
    place.settle("a")
    here = place.info("a")
    assert here["position"][0] > 0.05
    assert [c["position"][0] for c in here["contacts"]] == pytest.approx(
        [c["position"][0] + here["position"][0] for c in before], abs=0.01
    )


def test_queries_change_nothing_and_a_restored_world_senses_the_same() -> None:
    looked, left_alone = heaps(), heaps()
    names = looked.world.cubes()

    def look(place: Place) -> list[Reply]:
        rays = [[1, 0, 0], [0, -1, 0], [-0.3, 0.2, 1]]
        return [place("get_world_state", sensors=True)] + [place.info(n, sensors=True, rays=rays) for n in names]

    look(looked)
    looked("step", ticks=3)
    left_alone("step", ticks=3)
    assert looked.world.digest() == left_alone.world.digest()
    snapshot = looked.world.simulation.snapshot()
    left_alone.world.simulation.snapshot()
    left_alone.world.simulation.restore(snapshot)
    assert look(looked) == look(left_alone)
    for place in (looked, left_alone):
        place("apply_physics", cube_name="7.1", impulse=[1, 2, 0])
        place("step", ticks=7)
    assert look(looked) == look(left_alone)
    assert looked.world.digest() == left_alone.world.digest()


# -- accelerometer and gyro ------------------------------------------------------------------------------------------


def felt(place: Place, name: str) -> Array:
    reading = place.info(name, sensors=True)["accelerometer"]
    one = place("get_world_state", cubes=[name], sensors=True)["cubes"][0]
    assert one["accelerometer"] == reading
    return np.array(reading)


def own(place: Place, name: str, vector: npt.ArrayLike) -> Array:
    """A world vector in the frame of a cube."""
    x, y, z = np.asarray(vector, float).tolist()
    return np.array(rotate(conjugate(tuple(place.info(name)["quaternion"])), (x, y, z)))


def test_an_accelerometer_reads_zero_in_free_fall_and_a_thrust_by_its_mass() -> None:
    place = Place()
    place.spawn("a", [0, 200, 0], mass=2.5, rotation=[0.3, 1.1, -0.4], angular_velocity=[0.5, 3, -2])
    assert felt(place, "a") == pytest.approx([0, 0, 0])
    place("step", ticks=30)
    assert felt(place, "a") == pytest.approx([0, 0, 0], abs=1e-9)
    place("apply_physics", cube_name="a", force=[5, -10, 2.5])
    place("step")
    assert felt(place, "a") == pytest.approx(own(place, "a", [2, -4, 1]), abs=1e-9)
    place("step")
    assert felt(place, "a") == pytest.approx([0, 0, 0], abs=1e-9)


@pytest.mark.parametrize("asleep", [False, True])
def test_an_accelerometer_reads_gravity_upwards_at_rest(asleep: bool) -> None:
    place = Place(engine={"sleep": asleep})
    place.spawn("a", [0, 0.5, 0], rotation=turned("+z"))
    place.spawn("b", [3, 4, 0], rotation=[0.3, 0.4, 0.5], is_base=True)
    place.settle("a") if asleep else place("step", ticks=240)
    assert felt(place, "a") == pytest.approx([0, 0, -G], abs=0.01)
    assert felt(place, "b_BASE") == pytest.approx(own(place, "b_BASE", [0, G, 0]))


def test_an_accelerometer_on_an_arm_reads_the_centripetal_acceleration() -> None:
    place = Place(gravity=[0, 0, 0])
    place.spawn("hub", [0, 5, 0], is_base=True)
    place.spawn("a", [2, 5, 0], size=0.5)
    place.spawn("b", [4, 5, 0], size=0.5)
    motor = {"motor_target_velocity": 3, "motor_max_force": 1e6}
    place("create_joint", cube1="hub_BASE", cube2="a", joint_type="hinge", position=[0, 5, 0], axis=[0, 1, 0], **motor)
    place("create_joint", cube1="a", cube2="b", joint_type="fixed")
    place("step", ticks=90)
    for name, radius in (("a", 2), ("b", 4)):
        info = place.info(name, sensors=True)
        assert info["gyro"] == pytest.approx([0, 3, 0], abs=1e-3)
        # The arm ran along its x axis, and the hub is at the lower end.
        assert felt(place, name) == pytest.approx([-9 * radius, 0, 0], abs=0.15)


def test_a_gyro_reads_the_rotation_along_the_cube_s_own_axes() -> None:
    place = Place(gravity=[0, 0, 0])
    place.spawn("a", [0, 5, 0], rotation=[0.3, 1.1, -0.4], angular_velocity=[0.5, 3, -2])
    for _ in range(3):
        info = place.info("a", sensors=True)
        assert info["gyro"] == pytest.approx(own(place, "a", info["angular_velocity"]))
        assert math.hypot(*info["gyro"]) == pytest.approx(math.hypot(0.5, 3, 2))
        assert info["gyro"] != pytest.approx(info["angular_velocity"], abs=0.1)
        place("step", ticks=20)


def test_up_is_away_from_the_planet() -> None:
    place = Place(scene={"type": "planets", "planets": {"count": 1, "radius": 20}})
    (planet,) = place("get_planets")["planets"]
    x, y, z = (planet["Position"][axis] for axis in "xyz")
    place.spawn("a", [x + 20.5, y, z], mass=2)
    place.spawn("b", [x, y, z + 60], rotation=[0.5, 0, 0])
    place("step", ticks=20)
    assert felt(place, "b") == pytest.approx([0, 0, 0], abs=1e-6)
    place("step", ticks=300)
    info = place.info("a")
    assert felt(place, "a") == pytest.approx([G, 0, 0], abs=0.05)
    assert pushes(info) == {("-x", None): pytest.approx(2 * G, rel=0.02)}


# -- range finder ----------------------------------------------------------------------------------------------------


def test_ranges_are_measured_from_the_centre_to_the_nearest_obstacle() -> None:
    place = Place(gravity=[0, 0, 0])
    turn = math.pi / 6
    place.spawn("a", [0, 3, 0], rotation=[0, 0, turn])
    place.spawn("b", [0, 8, 0], is_base=True, size=[1, 2, 3])
    place("step")
    c, s = math.cos(turn), math.sin(turn)
    rays = [[-s, -c, 0], [s, c, 0], [-1, 0, 0], [0, 0, 1], [-7 * s, -7 * c, 0]]
    reply = place.info("a", rays=rays)
    # Straight down to the ground, up to the other cube, slanting down, level, and down again with another length.
    assert reply["ranges"] == pytest.approx([3, 4, 6, None, 3])
    assert place.info("a", rays=rays, max_range=3.5)["ranges"] == pytest.approx([3, None, None, None, 3])
    assert place.info("a", rays=[])["ranges"] == []
    assert "ranges" not in place.info("a")
    assert len(place.info("a", rays=[[0, -1, 0]] * 64)["ranges"]) == 64
    assert place.refused("get_cube_info", cube_name="a", rays=[[0, -1, 0]] * 65) == ("invalid", "rays")
    assert place.refused("get_cube_info", cube_name="a", rays=[[0, 0, 0]]) == ("invalid", "rays/0")


def test_a_ray_starts_at_the_cube_s_new_place_and_meets_others_at_their_last_tick() -> None:
    place = Place(gravity=[0, 0, 0])
    place.spawn("a", [0, 3, 0])
    assert place.info("a", rays=[[0, -1, 0]])["ranges"] == [3]
    place.spawn("b", [5, 3, 0])
    place("step")
    place("set_cube_state", cube_name="a", position=[0, 4, 0])
    assert place.info("a", rays=[[0, -1, 0], [1, 0, 0]])["ranges"] == [4, None]
    place("step")
    place("set_cube_state", cube_name="b", position=[9, 4, 0])
    place("step")
    assert place.info("a", rays=[[0, -1, 0], [1, 0, 0]])["ranges"] == pytest.approx([4, 8.5])
    place("despawn_cube", cube_name="b")
    place("step")
    assert place.info("a", rays=[[1, 0, 0]])["ranges"] == [None]


numbers = st.floats(-1, 1)
directions = st.tuples(numbers, numbers, numbers).filter(lambda v: math.hypot(*v) > 0.1)


@given(
    eye=st.tuples(numbers, numbers, numbers),
    turn=directions,
    boxes=st.lists(st.tuples(directions, st.tuples(*[st.floats(0.2, 2)] * 3), directions), min_size=1, max_size=6),
    rays=st.lists(directions, min_size=1, max_size=12),
)
def test_ranges_equal_those_computed_by_geometry(
    eye: tuple[float, float, float],
    turn: tuple[float, float, float],
    boxes: list[tuple[Any, Any, Any]],
    rays: list[tuple[float, float, float]],
) -> None:
    place = Place(gravity=[0, 0, 0])
    place.spawn("eye", [eye[0], 20 + eye[1], eye[2]], rotation=list(turn), is_base=True)
    for i, (where, size, rotation) in enumerate(boxes):
        x, y, z = (4 * part for part in where)
        place.spawn(f"box{i}", [x, y + 20, z], size=list(size), rotation=list(rotation), is_base=True)
    place("step")
    got = place.info("eye_BASE", rays=[list(ray) for ray in rays], max_range=10)["ranges"]
    here = place.info("eye_BASE")
    origin, view = np.array(here["position"]), here["quaternion"]
    others = [place.info(f"box{i}_BASE") for i in range(len(boxes))]
    for ray, distance in zip(rays, got, strict=True):
        unit = np.array(ray) / np.linalg.norm(ray)
        heading = np.array(rotate(view, tuple(unit.tolist())))
        hits = [hit for other in others for hit in crossings(other, origin, heading) if hit > 0]
        nearest = min(hits, default=math.inf)
        if nearest > 10 + 1e-6:
            assert distance is None
        elif distance is None:
            assert any(grazes(other, origin, heading) for other in others) or nearest > 10 - 1e-6
        else:
            assert distance == pytest.approx(nearest, abs=1e-6) or any(
                grazes(other, origin, heading) for other in others
            )


def crossings(box: Reply, origin: Array, heading: Array, margin: float = 0.0) -> list[float]:
    """Where a ray goes into a box and out of it (slab by slab)."""
    back = conjugate(tuple(box["quaternion"]))
    start = np.array(rotate(back, tuple((origin - box["position"]).tolist())))
    way = np.array(rotate(back, tuple(heading.tolist())))
    way = np.where(np.abs(way) < 1e-300, 1e-300, way)
    half = np.array(box["size"]) / 2 + margin
    ends = np.sort([(-half - start) / way, (half - start) / way], axis=0)
    into, out = ends[0].max(), ends[1].min()
    return [float(into), float(out)] if into <= out else []


def grazes(box: Reply, origin: Array, heading: Array) -> bool:
    """Whether a ray passes so close to an edge that rounding decides."""
    inner, outer = (bool(crossings(box, origin, heading, margin)) for margin in (-1e-6, 1e-6))
    return inner != outer


def test_rays_in_a_big_world_meet_only_bodies_on_their_way() -> None:
    place = Place(gravity=[0, 0, 0])
    for i in range(80):
        place.spawn(f"c{i}", [3.0 * i, 60, 0])
    place("step")
    for i in range(80, 84):
        place.spawn(f"c{i}", [3.0 * i, 60, 0])
    place("step")
    place("despawn_cube", cube_name="c1")
    place("set_cube_state", cube_name="c0", position=[0, 5, 0])
    place("step")
    assert place.info("c0", rays=[[0, -1, 0], [1, 0, 0]])["ranges"] == pytest.approx([5, None])
    assert place.info("c83", rays=[[-1, 0, 0]])["ranges"] == pytest.approx([2.5])
    assert place.info("c2", rays=[[-1, 0, 0]])["ranges"] == [None]


# -- engines without -------------------------------------------------------------------------------------------------


def test_an_engine_without_a_sensor_says_so() -> None:
    place = Place(backend="ballistic")
    place.spawn("a", [0, 0.5, 0])
    place("step", ticks=5)
    assert pushes(place.info("a")) == {("-y", None): pytest.approx(G)}
    assert place.refused("get_cube_info", cube_name="a", sensors=True) == ("unsupported", "sensors")
    assert place.refused("get_world_state", sensors=True) == ("unsupported", "sensors")
    assert place.refused("get_cube_info", cube_name="a", rays=[[0, -1, 0]]) == ("unsupported", "rays")
    assert place.refused("get_camera") == ("unsupported", None)
    assert "get_camera" not in place("get_world_info")["capabilities"]
    assert {"get_camera", "camera", "sensors.inertial", "sensors.range"} <= set(
        Place()("get_world_info")["capabilities"]
    )


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
    lines = [column for column, value in enumerate(row()) if value < 60]
    assert len(lines) == 2 and lines[1] - lines[0] == pytest.approx(60 / 3.5 / (2 * math.tan(0.4)), abs=1.5)
    for z in (-1, 0, 1):
        studio("despawn_cube", cube_name=f"part{z}{'_BASE' * frozen}")
    studio.spawn("whole", [4, 5, 0], size=[1, 1, 3], color=green, is_base=frozen)
    assert min(row()) > 60


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
