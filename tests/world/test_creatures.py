"""Creatures over the wire and in process: spawned whole or not at all, driven, felt, recorded, saved, dissolved."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nmes import World, protocol
from nmes.backends.pymunk2d import PymunkBackend
from nmes.errors import WorldError
from nmes.playback import replay
from nmes.recording import Recorder, Recording

Command = dict[str, Any]


def crawler(segments: int = 4, **changes: Any) -> Command:
    """A chain of cubes on the ground, with servos between them."""
    cubes = [
        {"id": f"s{i}", "size": [0.28, 0.2, 0.2], "mass": 1, "position": [0.3 * i, 0.1, 0]} for i in range(segments)
    ]
    joints = [
        {
            "id": f"j{i}",
            "cube1": f"s{i}",
            "cube2": f"s{i + 1}",
            "type": "hinge",
            "anchor": [0.3 * i + 0.15, 0.1, 0],
            "axis": [0, 1, 0],
            "limits": [-1, 1],
            "motor": {"mode": "position", "range": [-0.5, 0.5], "max_effort": 5},
        }
        for i in range(segments - 1)
    ]
    return {"format": "nmes-genome/1", "name": "crawler", "body": {"cubes": cubes, "joints": joints}, **changes}


def wheel() -> Command:
    """A block on the ground with a motored wheel of its own at its side."""
    return {
        "format": "nmes-genome/1",
        "name": "wheel",
        "body": {
            "cubes": [
                {"id": "hull", "size": 0.4, "mass": 5, "position": [0, 0.2, 0]},
                {"id": "rotor", "size": [0.1, 0.3, 0.3], "mass": 0.2, "position": [0, 0.8, 0]},
            ],
            "joints": [
                {
                    "id": "axle",
                    "cube1": "hull",
                    "cube2": "rotor",
                    "type": "hinge",
                    "anchor": [0, 0.8, 0],
                    "axis": [1, 0, 0],
                    "motor": {"mode": "velocity", "range": [-4, 8], "max_effort": 0.1},
                }
            ],
        },
        "sensors": [
            {"type": "velocity", "joint": "axle"},
            {"type": "effort", "joint": "*"},
            {"type": "touch", "cube": "*"},
            {"id": "head_up", "type": "up", "cube": "hull", "axis": "y"},
            {"type": "spin", "cube": "rotor", "axis": "x"},
        ],
    }


class Place:
    """A world in lockstep and one client in it; every reply is checked against its schema."""

    def __init__(self, recording: Path | None = None, **config: Any) -> None:
        self.world = World({"mode": "lockstep", **config})
        self.recorder = None if recording is None else Recorder(recording, self.world)
        self.world.journal = self.recorder
        self.client = self.world.join()

    def __call__(self, kind: str, **fields: Any) -> Command:
        reply = self.world.execute(self.client, {"type": kind, **fields})
        protocol.validate_reply(reply)
        return reply


def test_a_creature_is_spawned_with_its_origin_at_the_position() -> None:
    place = Place()
    reply = place("spawn_creature", genome=crawler(), position=[1, 0.5, -2], name="worm")
    assert reply == {
        "type": "creature_spawned",
        "creature": "worm",
        "cubes": {f"s{i}": f"worm.s{i}" for i in range(4)},
        "joints": {f"j{i}": f"worm.j{i}" for i in range(3)},
        "motors": ["j0", "j1", "j2"],
        "sensors": [
            *(f"j{i}.{kind}" for i in range(3) for kind in ("position", "velocity")),
            "s0.height", *(f"s0.{kind}.{axis}" for kind in ("up", "velocity", "spin") for axis in "xyz"),
        ],
    }  # fmt: skip
    assert place("get_cube_info", cube_name="worm.s2")["position"] == pytest.approx([1.6, 0.6, -2])
    info = place("get_joint_info", joint_name="worm.j1")
    assert info["anchor"] == pytest.approx([1.45, 0.6, -2])
    assert info["params"]["motor_enabled"] and info["params"]["target_position"] == 0
    assert (place.world.cubes(), place.world.joints()) == ([*reply["cubes"].values()], [*reply["joints"].values()])


def test_names_are_drawn_from_the_seed_and_never_twice() -> None:
    first, again, other = Place(seed=3), Place(seed=3), Place(seed=4)
    names = [place("spawn_creature", genome=crawler())["creature"] for place in (first, again, other)]
    assert names[0] == names[1] != names[2]
    assert first("spawn_creature", genome=crawler())["creature"] not in names
    assert len(set(first.world.cubes())) == 8


def test_driving_sets_motor_targets_that_last() -> None:
    place = Place(gravity=[0, 0, 0])
    place("spawn_creature", genome=crawler(), name="worm", position=[0, 1, 0])
    assert place("drive", creature="worm", controls=[1, -0.5, 0]) == {"type": "driven", "creature": "worm"}
    place("step", ticks=120)
    values = place("sense", creature="worm")["values"]
    assert values[0:6:2] == pytest.approx([0.5, -0.25, 0], abs=0.03)
    assert [place("get_joint_info", joint_name=f"worm.j{i}")["params"]["target_position"] for i in range(3)] == [
        0.5, -0.25, 0,
    ]  # fmt: skip


def test_sensors_read_the_quantities_of_their_names() -> None:
    place = Place()
    place("spawn_creature", genome=wheel(), name="w")
    place("drive", creature="w", controls=[1])
    place("step", ticks=120)
    velocity, effort, hull, rotor, up, spin = place("sense", creature="w")["values"]
    assert velocity == pytest.approx(0.8, abs=0.01)  # 8 rad/s, the end of the range, in 10 rad/s
    assert abs(effort) < 0.05
    assert (hull, rotor) == (1, 0)
    assert up == pytest.approx(1, abs=1e-3)
    assert spin == pytest.approx(0.8, abs=0.02)
    place("drive", creature="w", controls=[-1])
    place("step", ticks=1)
    assert place("sense", creature="w")["values"][1] == pytest.approx(-1)
    tilt = 0.3
    place("set_cube_state", cube_name="w.hull", position=[0, 5, 0], rotation=[tilt, 0, 0], linear_velocity=[0, 0, 2])
    place.world.tick()
    state = place("get_cube_state", cube_name="w.hull")
    assert place("sense", creature="w")["values"][4] == pytest.approx(math.cos(state["rotation"][0]), abs=1e-6)


def test_readings_of_a_cube_are_along_its_own_axes() -> None:
    genome = crawler(sensors=[{"type": kind, "cube": "s0"} for kind in ("height", "up", "velocity", "spin")])
    place = Place(gravity=[0, 0, 0])
    place("spawn_creature", genome=genome, name="w", position=[0, 3, 0])
    quarter = math.pi / 2
    place(
        "set_cube_state",
        cube_name="w.s0",
        rotation=[0, 0, quarter],
        linear_velocity=[2, 0, 0],
        angular_velocity=[0, 0, 3],
    )
    values = place("sense", creature="w")["values"]
    assert values == pytest.approx([3.1, 1, 0, 0, 0, -2, 0, 0, 0, 0.3], abs=1e-9)


_AIM = [{"type": f"target_{kind}", "cube": "s0"} for kind in ("direction", "distance", "velocity")]


def test_a_target_is_sensed_along_the_cube_s_own_axes() -> None:
    """A cube that lies on its side, its x upwards and its y along -x, flies at 2 m/s along x."""
    genome = crawler(sensors=[*_AIM, {"type": "target_distance", "cube": "s2"}, {"type": "height", "cube": "s0"}])
    place = Place(gravity=[0, 0, 0])
    names = place("spawn_creature", genome=genome, name="w", target=[3, 7.1, 0])["sensors"]
    assert names == [
        *(f"s0.target_direction.{axis}" for axis in "xyz"), "s0.target_distance",
        *(f"s0.target_velocity.{axis}" for axis in "xyz"), "s2.target_distance", "s0.height",
    ]  # fmt: skip
    place("spawn_creature", genome=genome, name="v", position=[0, 0, 9], target="ball")
    place("spawn_creature", genome=genome, name="u", position=[0, 0, 20])
    side = {"rotation": [0, 0, math.pi / 2], "linear_velocity": [2, 0, 0]}
    for name, z in (("w", 0), ("v", 9)):
        place("set_cube_state", cube_name=f"{name}.s0", position=[0, 3.1, z], **side)

    def felt(name: str) -> Any:
        return place("sense", creature=name)["values"]

    assert felt("w") == pytest.approx([0.8, -0.6, 0, 5, 0, 2, 0, np.hypot(3, 3.4), 3.1], abs=1e-9)
    # Without a target, and as long as there is no such cube, there is nothing to feel of it.
    assert felt("v") == [0] * 8 + [pytest.approx(3.1)]
    assert felt("u") == [0] * 8 + [pytest.approx(0.1)]
    place("spawn_cube", cube_name="ball", position=[0, 3.1, 5])
    place("set_cube_state", cube_name="ball", linear_velocity=[2, 1, -3])
    assert felt("v")[:7] == pytest.approx([0, 0, -1, 4, 1, 0, -3], abs=1e-9)
    place("step", ticks=60)
    assert felt("v")[3] == pytest.approx(math.hypot(1, 7), rel=1e-3)  # it is where the cube is now
    place("despawn_cube", cube_name="ball")
    assert felt("v")[:8] == [0] * 8
    place("spawn_creature", genome=genome, name="t", position=[0, 0, 30], target="t.s0")
    assert felt("t")[:7] == [0] * 7  # its own self is in no direction


@pytest.mark.parametrize("target", [[1, 2, 0], "ball"])
def test_a_target_is_part_of_what_is_recorded_and_saved(target: Any, tmp_path: Path) -> None:
    genome = crawler(1, sensors=_AIM)
    place = Place(tmp_path / "a.mcap")
    place("spawn_creature", genome=genome, name="w", position=[0, 1, 0], target=target)
    place("spawn_cube", cube_name="ball", position=[1, 2, 0])
    before = place("sense", creature="w")
    assert before["values"][:4] == pytest.approx([1 / math.sqrt(2), math.sqrt(0.5) * 0.9, 0, 1.345], abs=0.05)
    place("step", ticks=30)
    restored = Place()
    restored.world.restore(place.world.snapshot())
    for _ in range(3):
        assert place("sense", creature="w") == restored("sense", creature="w") != before
        place("step", ticks=2)
        restored("step", ticks=2)
    place.world.close()
    assert place.recorder is not None
    place.recorder.close()
    assert replay(tmp_path / "a.mcap").verdict == "reproduced"


@pytest.mark.parametrize("target", [[1, 2], [1, 2, "3"], "two words", 7, [1, 2, 3e6]])
def test_a_target_is_a_point_or_a_name(target: Any) -> None:
    place = Place()
    reply = place("spawn_creature", genome=crawler(), target=target)
    assert reply["code"] == "invalid" and reply["field"].split("/")[0] == "target"
    assert place.world.cubes() == []


@pytest.mark.parametrize(
    ("fields", "code", "field"),
    [
        ({"genome": crawler(), "name": "worm"}, "creature_exists", "name"),
        ({"genome": crawler(), "name": "x"}, "cube_exists", "name"),
        ({"genome": crawler(), "name": "n" * 127}, "invalid", "name"),
        ({"genome": crawler(40)}, "limit_reached", None),
        ({"genome": {**crawler(), "format": "other"}}, "invalid", "genome/format"),
        ({"genome": {**crawler(), "sensors": [{"type": "up", "cube": "s9"}]}}, "invalid", "genome/sensors/0/cube"),
    ],
)
def test_a_creature_that_cannot_be_spawned_leaves_no_trace(fields: Command, code: str, field: str | None) -> None:
    place = Place(limits={"cubes": 20})
    place("spawn_creature", genome=crawler(), name="worm")
    place("spawn_cube", cube_name="x.s2", position=[0, 9, 0])
    before = place.world.digest(), place.world.cubes(), place.world.joints(), place.world.structure_version
    reply = place("spawn_creature", **fields)
    assert (reply["type"], reply["code"], reply.get("field")) == ("error", code, field)
    assert before == (place.world.digest(), place.world.cubes(), place.world.joints(), place.world.structure_version)
    assert place.world.creatures() == ["worm"]


def test_all_mistakes_of_a_genome_are_reported_at_once() -> None:
    genome = crawler()
    genome["body"]["cubes"][1]["size"], genome["body"]["joints"][0]["motor"]["max_effort"] = 0, -1
    reply = Place()("spawn_creature", genome=genome)
    assert "body/cubes/1/size: expected an edge" in reply["message"]
    assert "body/joints/0/motor/max_effort: expected a number from 0" in reply["message"]


def test_a_body_with_many_mistakes_is_refused_quickly_and_briefly() -> None:
    cubes = [{"id": f"c{i}", "size": [9, 0.1, 0.1], "mass": 1, "position": [0, 0.05, 0.0001 * i]} for i in range(256)]
    reply = Place()("spawn_creature", genome={**crawler(), "body": {"cubes": cubes}})
    lines = reply["message"].splitlines()
    assert len(lines) == 21 and lines[-1].startswith("and ")
    reply = Place()("spawn_creature", genome={**crawler(), "x" * 100_000: 1})
    assert len(reply["message"]) < 400


def test_an_engine_that_lacks_what_a_body_needs_says_so() -> None:
    reply = Place(backend="ballistic")("spawn_creature", genome=crawler())
    assert (reply["code"], reply["field"]) == ("unsupported", "genome/body")
    reply = Place(backend="pymunk")("spawn_creature", genome=crawler())  # it bends about y
    assert (reply["code"], reply["field"]) == ("unsupported", "genome/body")


@pytest.mark.parametrize(
    ("lacks", "value", "code"),
    [
        ("capabilities", PymunkBackend.capabilities - {"motor"}, "unsupported"),
        ("capabilities", PymunkBackend.capabilities - {"servo"}, "unsupported"),
        ("most_joined", 3, "limit_reached"),
    ],
    ids=["no_motors", "no_servos", "no_structure_of_four"],
)
def test_an_engine_that_lacks_what_a_body_needs_gets_none_of_it(
    lacks: str, value: Any, code: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    genome = crawler(4)
    for joint in genome["body"]["joints"]:
        joint["axis"] = [0, 0, 1]
    monkeypatch.setattr(PymunkBackend, lacks, value)
    place = Place(backend="pymunk")
    reply = place("spawn_creature", genome=genome)
    assert (reply["code"], reply["field"]) == (code, "genome/body")
    assert not place.world.cubes()
    if lacks == "most_joined":
        assert place("spawn_creature", genome={**genome, "later": ["s3"]})["type"] == "creature_spawned"


def test_a_planar_body_can_be_spawned_in_the_planar_engine() -> None:
    genome = crawler()
    for joint in genome["body"]["joints"]:
        joint["axis"] = [0, 0, 1]
    place = Place(backend="pymunk")
    place("spawn_creature", genome=genome, name="worm", position=[0, 1, 0])
    place("drive", creature="worm", controls=[1, 1, 1])
    place("step", ticks=60)
    assert place("sense", creature="worm")["values"][0:6:2] == pytest.approx([0.5] * 3, abs=0.05)


@pytest.mark.parametrize("axis", [[1, 0, 0], [0, 0, 1], [0, 0.000001, -1000]])
@pytest.mark.parametrize("kind", ["hinge", "slide", "fixed", "pin", "conetwist"])
def test_a_planar_world_has_all_of_a_body_or_nothing_whatever_the_axes_of_its_joints(
    kind: str, axis: list[float]
) -> None:
    genome = crawler(2)
    (joint,) = genome["body"]["joints"]
    genome["body"]["joints"] = [
        {**{end: joint[end] for end in ("id", "cube1", "cube2", "anchor")}, "type": kind, "axis": axis}
    ]
    place = Place(backend="pymunk")
    before, reply = place.world.digest(), place("spawn_creature", genome=genome, name="it")
    if reply["type"] == "error":
        assert kind not in ("fixed", "pin") and (reply["code"], reply["field"]) == ("unsupported", "genome/body")
        assert place.world.digest() == before and not place.world.cubes()
        return
    assert (len(place.world.cubes()), len(place.world.joints())) == (2, 1)
    place("spawn_creature", genome={**genome, "later": ["s1"]}, name="bud", position=[5, 0, 0])
    assert place("grow", creature="bud", part="s1")["type"] == "part_grown"
    assert (len(place.world.cubes()), len(place.world.joints())) == (4, 2)


@pytest.mark.parametrize("kind", ["conetwist", "fixed", "pin"])
def test_a_joint_of_a_planar_world_has_the_part_of_its_axis_that_lies_in_the_plane(kind: str) -> None:
    def end(*axis: float) -> bytes:
        place = Place(backend="pymunk", gravity=[0, 0, 0])
        for x, name in enumerate("ab"):
            place("spawn_cube", cube_name=name, position=[x, 5, 0])
        spans = {"swing_span": 0.1, "twist_span": 1.0} if kind == "conetwist" else {}
        assert "joint_name" in place("create_joint", cube1="a", cube2="b", joint_type=kind, axis=axis, **spans)
        place("apply_physics", cube_name="b", angular_impulse=[0, 0, 3])
        place("step", ticks=60)
        return place.world.digest()

    assert end(1, 0, 0) == end(1, 0, 2) and end(0, 1, 0) == end(0, 0.000001, -1000)
    assert end(0, 0, 2) not in (end(1, 0, 0), end(0, 1, 0))


def test_a_conetwist_of_a_planar_world_has_an_axis_along_z() -> None:
    place = Place(backend="pymunk", gravity=[0, 0, 0])
    place("spawn_cube", cube_name="a", position=[0, 5, 0])
    place("spawn_cube", cube_name="b", position=[1, 5, 0])
    joint = place("create_joint", cube1="a", cube2="b", joint_type="conetwist", axis=[0, 0, 2])
    assert place("get_joint_info", joint_name=joint["joint_name"])["axis"] == [0, 0, 1]
    for kind, axis in (("hinge", [1, 0, 0]), ("slide", [0, 0, 1])):
        reply = place("create_joint", cube1="a", cube2="b", joint_type=kind, axis=axis)
        assert (reply["code"], reply["field"]) == ("invalid", "axis")


@pytest.mark.parametrize("backend", ["mujoco", "pymunk", "ballistic"])
def test_a_creature_s_history_is_reproduced_on_any_engine(backend: str, tmp_path: Path) -> None:
    genome = crawler(2)
    genome["body"]["joints"][0] = {**genome["body"]["joints"][0], "type": "fixed"}
    for field in ("axis", "limits", "motor"):
        del genome["body"]["joints"][0][field]
    place = Place(tmp_path / "a.mcap", backend=backend)
    place("spawn_creature", genome=genome, name="brick", position=[0, 1, 0])
    place("spawn_creature", genome=crawler(1), name="die", position=[3, 2, 0])
    place("set_objective", creature="brick", expression='min.cube("s1").height - energy + max.contacts')
    place("step", ticks=40)
    assert place("drive", creature="brick", controls=[])["type"] == "driven"
    assert place("sense", creature="die")["values"][0] == pytest.approx(0.1, abs=0.05)
    assert place("compute_reward")["value"] == pytest.approx(2.1, abs=0.05)
    assert place("compute_reward", metric="energy", cube="die.s0")["value"] == 0
    if "snapshot" in place.world.backend.capabilities:
        restored = Place(backend=backend)
        restored.world.restore(place.world.snapshot())
        assert restored.world.creatures() == ["brick", "die"]
        for command in ({"kind": "step", "ticks": 9}, {"kind": "sense", "creature": "die"}, {"kind": "compute_reward"}):
            assert restored(**command) == place(**command)
    else:
        with pytest.raises(WorldError, match="no snapshots"):
            place.world.snapshot()
    place.world.close()
    assert place.recorder is not None
    place.recorder.close()
    assert replay(tmp_path / "a.mcap").verdict == "reproduced"


def test_a_creature_exists_until_its_root_is_removed() -> None:
    place = Place()
    for name in "ab":
        place("spawn_creature", genome=crawler(), name=name)
    place("despawn_cube", cube_name="a.s0")
    assert place.world.creatures() == ["b"]
    for command in ({"kind": "sense"}, {"kind": "drive", "controls": [0, 0, 0]}):
        assert place(**command, creature="a")["code"] == "creature_not_found"
    assert len(place.world.cubes()) == 7
    place("reset")
    place("spawn_creature", genome=crawler(), name="a")
    place("reset")
    assert place.world.creatures() == []


@pytest.mark.parametrize("controls", [[0, 0], [0, 0, 1.01], [0, 0, "x"], [0, 0, None]])
def test_controls_are_as_many_as_motors_and_within_bounds(controls: list[Any]) -> None:
    place = Place()
    place("spawn_creature", genome=crawler(), name="worm")
    before = place.world.digest()
    assert place("drive", creature="worm", controls=controls)["code"] == "invalid"
    assert place.world.digest() == before


def test_driving_restores_a_motor_that_was_switched_off_or_retuned() -> None:
    place = Place(gravity=[0, 0, 0])
    place("spawn_creature", genome=crawler(), name="worm", position=[0, 1, 0])
    place("drive", creature="worm", controls=[0, 0, 0])
    place("set_joint_param", joint_name="worm.j0", param_name="motor_enabled", value=False)
    place("set_joint_param", joint_name="worm.j1", param_name="motor_target_velocity", value=3)
    place("set_joint_param", joint_name="worm.j2", param_name="motor_max_force", value=0)
    place("drive", creature="worm", controls=[1, 1, 1])
    place("step", ticks=120)
    values = place("sense", creature="worm")["values"]
    assert values[0:4:2] == pytest.approx([0.5, 0.5], abs=0.03)
    assert abs(values[4] - 0.5) > 0.2  # it has no strength any more
    assert place("get_joint_info", joint_name="worm.j2")["params"]["motor_max_force"] == 0


# -- the doors for callers in the process -----------------------------------------------------------------------------


def wander(place: Place, in_process: bool, ticks: int = 40) -> list[bytes]:
    """Drives a creature in either way, with other commands in between."""
    digests = []
    for tick in range(ticks):
        controls = np.sin(0.3 * tick + np.arange(3.0))
        if in_process:
            place.world.drive(place.client, "worm", controls)
        else:
            place("drive", creature="worm", controls=controls.tolist())
        if tick == 10:
            place("spawn_cube", position=[0, 1, 0], size=0.3)
        if tick == 20:
            place("set_joint_param", joint_name="worm.j1", param_name="motor_max_force", value=2)
        if tick == 30:
            assert place("get_joint_info", joint_name="worm.j1")["params"]["target_position"] == 0.5 * controls[1]
        place.world.tick()
        digests.append(place.world.digest())
    return digests


def test_a_creature_with_frozen_cubes_still_senses_and_is_driven() -> None:
    place = Place(gravity=[0, 0, 0])
    place("spawn_creature", genome=crawler(), name="w", position=[0, 1, 0])
    place("drive", creature="w", controls=[1, 1, 1])
    place("step", ticks=60)
    for cube in ("w.s0", "w.s1"):
        place("freeze_cube", cube_name=cube, freeze=True)
    place("step", ticks=2)
    place("drive", creature="w", controls=[-1, -1, -1])
    place("step", ticks=120)
    bent, _, *others = place("sense", creature="w")["values"][:6]
    assert bent == pytest.approx(place("get_joint_info", joint_name="w.j0")["position"])
    assert bent == pytest.approx(0.5, abs=0.01)  # where it was when both its cubes were frozen
    assert others[::2] == pytest.approx([-0.5, -0.5], abs=0.03)
    place("freeze_cube", cube_name="w.s1", freeze=False)
    place("step", ticks=240)
    assert place("sense", creature="w")["values"][0] == pytest.approx(-0.5, abs=0.03)


_UNIT = st.floats(-1, 1)
_STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("drive"), _UNIT, _UNIT),
        st.tuples(st.just("tick"), _UNIT, _UNIT),
        st.tuples(st.just("drive"), _UNIT, _UNIT),
        st.tuples(st.just("tick"), _UNIT, _UNIT),
        st.tuples(
            st.sampled_from(["force", "off", "speed", "limits", "freeze", "move", "spawn", "snapshot"]), _UNIT, _UNIT
        ),
    ),
    max_size=25,
)


@given(_STEPS)
@settings(max_examples=60, deadline=None)
def test_driving_equals_setting_each_motor_s_target(steps: list[tuple[str, float, float]]) -> None:
    """Two worlds get the same commands, but one is driven as a whole and the other joint by joint."""
    driven, single = Place(), Place()
    for place in (driven, single):
        place("spawn_creature", genome=crawler(), name="w")
    for number, (kind, a, b) in enumerate(steps):
        controls = [a, b, (a + b) / 2]
        which = int((a + 1) * 1.4999)
        others: dict[str, Command] = {
            "force": {"kind": "set_joint_param", "param_name": "motor_max_force", "value": max(0.0, 6 * b)},
            "off": {"kind": "set_joint_param", "param_name": "motor_enabled", "value": b > 0},
            "speed": {"kind": "set_joint_param", "param_name": "motor_target_velocity", "value": 3 * b},
            "limits": {"kind": "set_joint_param", "param_name": "limit_upper", "value": 1 + b},
            "freeze": {"kind": "freeze_cube", "cube_name": f"w.s{int((a + 1) * 1.9999)}", "freeze": b > -0.5},
            "move": {
                "kind": "set_cube_state",
                "cube_name": "w.s1",
                "position": [a, 1, b],
                "linear_velocity": [b, a, 0],
            },
            "spawn": {"kind": "spawn_cube", "position": [a, 2, b], "is_base": a > 0.5},
        }
        command = others.get(kind)
        if command is not None and command["kind"] == "set_joint_param":
            command["joint_name"] = f"w.j{which}"
        if kind == "drive":
            driven.world.drive(driven.client, "w", np.array(controls))
            for i, control in enumerate(controls):
                single(
                    "set_joint_param",
                    joint_name=f"w.j{i}",
                    param_name="target_position",
                    value=(control + 1) * 0.5 - 0.5,
                )
        elif kind == "snapshot":
            for place in (driven, single):
                other = Place()
                other.world.restore(place.world.snapshot())
                place.world, place.client = other.world, other.client
        elif command is None:
            for place in (driven, single):
                place.world.tick()
        else:
            assert driven(**command) == single(**command)
        assert driven.world.digest() == single.world.digest(), f"after step {number}, {kind}"
        assert driven("sense", creature="w") == single("sense", creature="w")
        for i in range(3):
            infos = [place("get_joint_info", joint_name=f"w.j{i}") for place in (driven, single)]
            assert infos[0] == infos[1]
    assert driven.world.fault is None


def test_driving_in_process_equals_driving_over_the_wire(tmp_path: Path) -> None:
    digests = []
    for in_process in (True, False):
        place = Place(tmp_path / f"{in_process}.mcap")
        place("spawn_creature", genome=crawler(), name="worm")
        digests.append(wander(place, in_process))
        if in_process:
            with pytest.raises(WorldError):
                place.world.drive(place.client, "worm", np.array([0.0, 1.5, 0.0]))
        else:
            place("drive", creature="worm", controls=[0.0, 1.5, 0.0])
        place.world.close()
        assert place.recorder is not None
        place.recorder.close()
    assert digests[0] == digests[1]
    one, other = (Recording(tmp_path / f"{in_process}.mcap") for in_process in (True, False))
    assert [(r.kind, r.data) for r in one] == [(r.kind, r.data) for r in other]
    for in_process in (True, False):
        report = replay(tmp_path / f"{in_process}.mcap")
        assert (report.verdict, report.ticks) == ("reproduced", 40)


@pytest.mark.parametrize(
    ("name", "controls", "code"),
    [
        ("nobody", np.zeros(3), "creature_not_found"),
        ("worm", np.zeros(2), "invalid"),
        ("worm", np.array([0.0, 2.0, 0.0]), "invalid"),
        ("worm", np.array([0.0, np.nan, 0.0]), "invalid"),
    ],
)
def test_driving_in_process_refuses_what_the_wire_would(name: str, controls: Any, code: str) -> None:
    place = Place()
    place("spawn_creature", genome=crawler(), name="worm")
    before = place.world.digest()
    with pytest.raises(WorldError) as refused:
        place.world.drive(place.client, name, controls)
    assert refused.value.code == code
    assert place.world.digest() == before
    with pytest.raises(WorldError, match="no creature"):
        place.world.creature("nobody")


def test_sensing_in_process_equals_the_wire_and_changes_nothing() -> None:
    place, other = Place(), Place()
    for each in (place, other):
        each("spawn_creature", genome=wheel(), name="worm")
        each("drive", creature="worm", controls=[0.3])
    creature = place.world.creature("worm")
    for _ in range(20):
        place.world.tick()
        other.world.tick()
        values = creature.sense()
        assert values.tolist() == place("sense", creature="worm")["values"]
        values[:] = np.nan
        assert place.world.digest() == other.world.digest()


def test_a_creature_survives_a_snapshot() -> None:
    place = Place()
    place("spawn_creature", genome=crawler(), name="worm")
    wander(place, in_process=True, ticks=25)
    restored = Place()
    restored.world.restore(place.world.snapshot())
    assert restored.world.creatures() == ["worm"]
    assert place("sense", creature="worm") == restored("sense", creature="worm")
    for _ in range(10):
        place.world.tick()
        restored.world.tick()
        assert place.world.digest() == restored.world.digest()
    assert wander(place, True, ticks=20)[11:] == wander(restored, False, ticks=20)[11:]
