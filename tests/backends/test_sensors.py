"""What cubes feel and see, against physics and geometry; and that looking changes nothing."""

from __future__ import annotations

import math
import random
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nmes.backend import Array
from nmes.backend.rotation import conjugate, euler_from_quaternion, normalize, quaternion_from_euler, rotate
from opengl import OPENGL
from sensing import Place, Reply

G = 9.81
UP = (0.0, 1.0, 0.0)
FACES = ["+x", "-x", "+y", "-y", "+z", "-z"]


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
    able = {"sensors.inertial", "sensors.range"} | ({"get_camera", "camera"} if OPENGL else set())
    assert able <= set(Place()("get_world_info")["capabilities"])
