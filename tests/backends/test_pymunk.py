"""The planar engine: what the contract cannot know of it."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from layout import ROOT, SUPPORT
from nmes import World
from nmes.backend import BodyState, Heightfield, JointParams, JointSpec, SceneSpec, StaticBox
from nmes.backend.contract.base import TIMESTEP, UPRIGHT, ZERO, about_z, assert_close, box, run
from nmes.backends.pymunk2d import PymunkBackend, PymunkSimulation
from nmes.errors import RejectedMessage, WorldError

sys.path.insert(0, str(ROOT / "examples"))

import demo

Z = (0.0, 0.0, 1.0)
X = (1.0, 0.0, 0.0)


def scene(**fields: Any) -> PymunkSimulation:
    return PymunkBackend().create(SceneSpec(TIMESTEP, **fields))


def test_bodies_stay_in_the_plane() -> None:
    sim = scene()
    tilted = (0.5, 0.5, 0.5, 0.5)
    sim.add_body(0, box((1.0, 5.0, 3.0), quaternion=tilted, linear_velocity=(1.0, 0.0, 2.0)))
    sim.apply(0, (0.0, 0.0, 9.0), (1.0, 1.0, 0.0), (0.0, 0.0, 5.0), (1.0, 1.0, 0.0))
    run(sim, 0.1)
    state = sim.body_state(0)
    assert state.position[2] == 0.0 and state.linear_velocity[2] == 0.0
    assert state.angular_velocity == ZERO
    assert_close(state.quaternion, about_z(math.pi / 2), 1e-9, "its rotation about z")


@pytest.mark.parametrize(("kind", "axis"), [("hinge", X), ("slide", Z)])
def test_joints_that_leave_the_plane_are_unsupported(kind: str, axis: tuple[float, float, float]) -> None:
    sim = scene()
    sim.add_body(0, box((0.0, 5.0, 0.0)))
    sim.add_body(1, box((1.0, 5.0, 0.0)))
    before = sim.digest()
    with pytest.raises(WorldError) as refused:
        sim.add_joint(0, JointSpec(kind, 0, 1, (0.5, 5.0, 0.0), axis))
    assert (refused.value.code, refused.value.path) == ("unsupported", "axis")
    assert sim.digest() == before


@pytest.mark.parametrize(("axis", "stop"), [(X, 0.3), (Z, 0.7)])
def test_a_conetwist_swings_and_twists_within_its_limits(axis: tuple[float, float, float], stop: float) -> None:
    sim = scene(ground=False)
    sim.add_body(0, box((0.0, 5.0, 0.0), frozen=True))
    sim.add_body(1, box((1.0, 5.0, 0.0)))
    sim.add_joint(0, JointSpec("conetwist", 0, 1, (0.5, 5.0, 0.0), axis, JointParams(limits=(0.3, 0.7))))
    run(sim, 3.0)
    assert_close(sim.body_state(1).quaternion, about_z(-stop), 0.01, "how far it hangs")


def test_a_joint_between_frozen_bodies_acts_once_they_are_freed() -> None:
    sim = scene()
    sim.add_body(0, box((0.0, 5.0, 0.0), frozen=True))
    sim.add_body(1, box((1.0, 5.0, 0.0), frozen=True))
    motor = JointParams("velocity", target_velocity=1.0, max_effort=100.0)
    sim.add_joint(0, JointSpec("hinge", 0, 1, (0.5, 5.0, 0.0), Z, motor))
    run(sim, 0.5)
    assert sim.joint_state(0).effort == 0.0
    sim.set_joint_params(0, JointParams("velocity", target_velocity=2.0, max_effort=100.0))
    sim.set_frozen(1, False)
    run(sim, 0.5)
    assert_close([sim.joint_state(0).velocity], [2.0], 0.01, "speed once one of them is free")
    sim.set_frozen(1, True)
    sim.remove_joint(0)
    sim.remove_body(0)
    run(sim, 0.1)


def test_a_structure_that_is_moved_keeps_its_turns() -> None:
    sim = scene(gravity=ZERO, ground=False)
    sim.add_body(0, box(ZERO, frozen=True))
    sim.add_body(1, box(X))
    motor = JointParams("velocity", target_velocity=5.0, max_effort=100.0)
    sim.add_joint(0, JointSpec("hinge", 0, 1, (0.5, 0.0, 0.0), Z, motor))
    run(sim, 2.0)
    base, position = 0.0, sim.joint_state(0).position
    assert position > math.tau
    for _ in range(20):
        base += math.pi  # half a turn is the same both ways round, and yet both must go the same way
        middle = 0.5 * math.cos(base), 0.5 * math.sin(base)
        angle = base + sim.joint_state(0).position
        centre = (middle[0] + 0.5 * math.cos(angle), middle[1] + 0.5 * math.sin(angle), 0.0)
        position = sim.joint_state(0).position
        sim.set_body_state(0, BodyState(ZERO, about_z(base), ZERO, ZERO))
        sim.set_body_state(1, BodyState(centre, about_z(angle), ZERO, ZERO))
        assert_close([sim.joint_state(0).position], [position], 1e-6, "position after the move")
        run(sim, 0.1)
        assert abs(sim.joint_state(0).position - position) < 1.0


def test_a_motor_keeps_its_bodies_awake_until_it_reaches_its_target() -> None:
    sim = scene(gravity=ZERO, ground=False)
    sim.add_body(0, box(ZERO, frozen=True))
    sim.add_body(1, box(X))
    slow = JointParams("velocity", target_velocity=0.001, max_effort=10.0)
    sim.add_joint(0, JointSpec("slide", 0, 1, (0.5, 0.0, 0.0), X, slow))
    run(sim, 5.0)
    assert not sim.sleeping(1)
    assert_close([sim.joint_state(0).position], [0.005], 1e-4, "way at 1 mm/s")
    sim.set_joint_params(0, JointParams("position", target_position=0.2, max_effort=10.0))
    run(sim, 5.0)
    assert_close([sim.joint_state(0).position], [0.2], 1e-3, "the servo's position")
    assert sim.sleeping(1)


def test_obstacles_and_a_heightfield_carry_what_falls_on_them() -> None:
    landscape = Heightfield((60.0, 8.0), np.tile([0.0, 1.0, 1.0, 1.0, 3.0, 3.0, 3.0], (3, 1)))
    boxes = (
        StaticBox((4.0, 1.0, 9.0), (-25.0, 4.0, 0.0)),
        StaticBox((4.0, 1.0, 9.0), (25.0, 4.0, 6.0)),  # does not reach the plane
        StaticBox((4.0, 4.0, 4.0), (-10.0, 0.0, 0.0), about_z(math.pi / 4)),
    )
    sim = scene(ground=False, heightfield=landscape, boxes=boxes, options={"iterations": 20})
    for body, x in enumerate((-25.0, -15.0, -10.0, 25.0)):
        sim.add_body(body, box((x, 8.0, 0.0)))
    run(sim, 4.0)
    assert_close(sim.states([0, 1, 3])[:, 1], (5.0, 1.5, 3.5), 0.01, "heights at rest")
    for body in (0, 1, 3):
        assert [contact.other for contact in sim.contacts(body)][:1] == [None]
    assert sim.body_state(2).position[1] > 1.5, "fell through the box that stands on its edge"


def test_a_box_glides_over_the_seams_of_a_heightfield() -> None:
    landscape = Heightfield((80.0, 8.0), np.ones((2, 161)))
    sim = scene(ground=False, heightfield=landscape)
    sim.add_body(0, box((0.0, 1.5, 0.0), friction=0.0, linear_velocity=(4.0, 0.0, 0.0)))
    run(sim, 5.0)
    row = sim.states([0])[0]
    assert_close(row[[0, 1, 7]], (20.0, 1.5, 4.0), 0.01, "where it is, and how fast")


@pytest.mark.parametrize("options", [{"solver": "newton"}, {"iterations": 0}, {"iterations": True}])
def test_bad_settings_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(WorldError) as refused:
        scene(options=options)
    assert (refused.value.code, refused.value.path) == ("invalid", f"engine/{next(iter(options))}")


def test_a_released_obstacle_lets_what_slept_on_it_fall() -> None:
    sim = scene()
    sim.add_body(0, box((0.0, 3.0, 0.0), frozen=True))
    sim.add_body(1, box((0.0, 4.0, 0.0)))
    run(sim, 3.0)
    assert sim.sleeping(1)
    sim.set_body_state(0, BodyState((9.0, 3.0, 0.0), UPRIGHT, ZERO, ZERO))
    run(sim, 0.2)
    assert sim.body_state(1).position[1] < 3.9
    sim.set_body_state(1, BodyState((9.0, 4.0, 0.0), UPRIGHT, ZERO, ZERO))
    run(sim, 3.0)
    assert sim.sleeping(1)
    sim.set_frozen(0, False)
    run(sim, 0.2)
    assert sim.body_state(1).position[1] < 3.9


def test_a_world_runs_on_the_planar_engine() -> None:
    """Every command that works in the plane works through the World, and the rest is `unsupported`."""
    world = World({"backend": "pymunk", "mode": "lockstep", "engine": {"iterations": 20}})
    client = world.join()

    def ok(type: str, **fields: Any) -> dict[str, Any]:
        reply = world.execute(client, {"type": type, **fields})
        assert reply["type"] != "error", reply
        return reply

    base = ok("spawn_cube", cube_name="base", position=[0, 5, 2], is_base=True)["spawned"]
    arm = ok("spawn_cube", cube_name="arm", position=[1.5, 5, 7], rotation=[0.1, 0.2, 0.0])["spawned"]
    hinge = ok("create_joint", cube1=base, cube2=arm, joint_type="hinge")["joint_name"]
    ok("set_joint_param", joint_name=hinge, param_name="motor_max_force", value=50)
    ok("set_joint_param", joint_name=hinge, param_name="target_position", value=0.5)
    ok("step", ticks=180)
    info = ok("get_joint_info", joint_name=hinge)
    assert info["position"] == pytest.approx(0.5, abs=0.02)
    assert info["effort"] > 1.0
    for kind in ("fixed", "slide", "pin", "conetwist"):
        other = ok("spawn_cube", position=[10, 10, 0])["spawned"]
        ok("create_joint", cube1=arm, cube2=other, joint_type=kind)
    ok("create_bone", cube1=base, cube2=other)
    ok("step", ticks=10)
    state = ok("get_world_state")
    assert all(cube["position"][2] == 0 and cube["rotation"][:2] == [0, 0] for cube in state["cubes"])
    assert ok("get_world_info")["dims"] == 2
    reply = world.execute(
        client, {"type": "create_joint", "cube1": base, "cube2": arm, "joint_type": "hinge", "axis": X}
    )
    assert reply["type"] == "error"
    with pytest.raises(RejectedMessage):
        World({"backend": "pymunk", "engine": {"solver": "newton"}})


@pytest.mark.parametrize("example", ["tier2_pole"])  # the one that stays in the plane
def test_an_example_in_the_plane_runs_unchanged(example: str, tmp_path: Path) -> None:
    with demo.served(tmp_path, "--mode", "lockstep", "--backend", "pymunk") as server:
        script = [sys.executable, str(ROOT / "examples" / f"{example}.py"), "--json", "--port", str(server["port"])]
        figures = demo.run(script, NMES_PASSWORD=server["password"])
    assert figures["ok"], figures
    report = demo.replay(Path(server["recording"]))
    assert report["verdict"] == "reproduced", report


RECORD = """
import os
import subprocess
import sys
import programs
from nmes import World
from nmes.recording import Recorder

for number in range(int(sys.argv[1])):
    world = World({"backend": "pymunk", "mode": "lockstep", "seed": number})
    world.journal = recorder = Recorder(f"{number}.mcap", world)
    programs.play(world, programs.draw(number, 60))
    recorder.close()
    world.close()
"""

REPLAY = """
import os
import subprocess
import sys
from nmes.playback import replay

for number in range(int(sys.argv[1])):
    report = replay(f"{number}.mcap")
    print(report.verdict, report.ticks, report.divergence)
"""


@pytest.mark.parametrize("count", [8, pytest.param(1000, marks=pytest.mark.long)])
def test_recordings_are_reproduced_in_another_process(count: int, tmp_path: Path) -> None:
    for seed, program in (("1", RECORD), ("2", REPLAY)):
        environment = {**os.environ, "PYTHONPATH": str(SUPPORT), "PYTHONHASHSEED": seed}
        command = [sys.executable, "-c", program, str(count)]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    verdicts = [line.split() for line in done.stdout.splitlines()]
    assert len(verdicts) == count
    assert [(number, *line) for number, line in enumerate(verdicts) if line[0] != "reproduced"] == []
    assert sum(int(ticks) for _, ticks, *_ in verdicts) > 50 * count
