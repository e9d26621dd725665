"""Objectives and metrics over the wire: what they are worth, whose they are, and that they come out again."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nmes import protocol
from nmes.objective import FOLDS, QUANTITIES, Objective
from nmes.objective.trajectory import ObservedBodies, RunningQuantities, Trajectory, touches
from nmes.playback import replay
from nmes.world import World
from recordings import record, send

GENOME = protocol.COMMANDS["spawn_creature"].schema["examples"][0]["genome"]
G = 9.81


class Wire:
    """A client of a world of its own."""

    def __init__(self, **config: Any) -> None:
        self.world = World({"mode": "lockstep", "gravity": [0, -G, 0], **config})
        self.client = self.world.join()

    def __call__(self, kind: str, **fields: Any) -> dict[str, Any]:
        reply = send(self.world, self.client, type=kind, **fields)
        protocol.validate_reply(reply)
        assert reply["type"] != "error", reply
        return reply

    def refused(self, kind: str, **fields: Any) -> tuple[str, str | None, str]:
        reply = send(self.world, self.client, type=kind, **fields)
        protocol.validate_reply(reply)
        return reply["code"], reply.get("field"), reply["message"]

    def worth(self, name: str = "objective") -> float:
        return float(self("compute_reward", objective=name)["value"])

    def metric(self, name: str, **fields: Any) -> float:
        return float(self("compute_reward", metric=name, **fields)["value"])


# -- figures ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("backend", ["mujoco", "pymunk", "ballistic"])
def test_a_thrown_cube_scores_what_the_formulas_say(backend: str) -> None:
    wire = Wire(backend=backend)
    wire("spawn_cube", cube_name="ball", position=[1, 20, 0], linear_velocity=[3, 4, 0])
    for name in (
        "height",
        "speed",
        "displacement.x",
        "displacement.y",
        "displacement.horizontal",
        "max.height",
        "time",
    ):
        wire("set_objective", name=name, expression=name)
    wire("set_objective", name="way", expression="distance", target=[1, 20, 4])
    wire("step", ticks=90)
    t = 1.5
    fall = 4 * t - G * t * t / 2
    coarse = 0.05  # a step of 1/240 s is off by up to g t dt / 2
    assert wire.worth("time") == t
    assert wire.worth("height") == pytest.approx(20 + fall, abs=coarse)
    assert wire.worth("displacement.y") == pytest.approx(fall, abs=coarse)
    assert wire.worth("displacement.x") == pytest.approx(3 * t, abs=coarse)
    assert wire.worth("displacement.horizontal") == pytest.approx(3 * t, abs=coarse)
    assert wire.worth("max.height") == pytest.approx(20 + 16 / (2 * G), abs=coarse)
    assert wire.worth("speed") == pytest.approx(math.hypot(3, 4 - G * t), abs=coarse)
    aside = 0 if backend == "pymunk" else 4
    assert wire.worth("way") == pytest.approx(math.dist((3 * t, fall, 0), (0, 0, aside)), abs=coarse)
    assert wire.metric("height") == wire.worth("height")
    assert wire.metric("speed") == pytest.approx(wire.worth("speed"))
    assert wire.metric("distance") == pytest.approx(math.hypot(3 * t, fall), abs=coarse)
    assert wire.metric("distance", target=[1, 20, 4]) == pytest.approx(wire.worth("way"))
    assert wire.metric("displacement") == pytest.approx(wire.worth("displacement.x"))
    assert wire.metric("displacement", axis=[0, -2, 0]) == pytest.approx(-wire.worth("displacement.y"))
    assert wire.metric("energy") == 0.0


def test_in_a_planar_world_z_of_targets_and_axes_is_ignored() -> None:
    wire = Wire(backend="pymunk", gravity=[0, 0, 0])
    wire("spawn_cube", cube_name="ball", position=[0, 1, 0])
    wire("set_objective", expression="distance", target=[3, 1, 4])
    assert wire.worth() == 3.0 == wire.metric("distance", target=[3, 1, 4])
    wire("set_cube_state", cube_name="ball", position=[2, 1, 0])
    assert wire.metric("displacement", axis=[1, 0, 5]) == 2.0
    code, field, _ = wire.refused("compute_reward", metric="displacement", axis=[0, 0, 5])
    assert (code, field) == ("invalid", "axis")
    genome = {
        "format": "nmes-genome/1",
        "name": "eye",
        "body": {"cubes": [{"id": "it", "size": 1, "mass": 1, "position": [0, 0.5, 0]}]},
        "sensors": [{"type": kind, "cube": "it"} for kind in ("target_distance", "target_direction")],
    }
    wire("spawn_creature", genome=genome, name="eye", position=[0, 5, 0], target=[3, 5.5, 4])
    assert wire("sense", creature="eye")["values"] == pytest.approx([3, 1, 0, 0])


def test_a_turned_cube_is_as_upright_as_it_is_turned() -> None:
    wire = Wire()
    wire("spawn_cube", cube_name="block", rotation=[0, 2, math.pi / 3 - 0.01])
    wire("set_objective", expression="uprightness")
    wire("set_objective", expression="time_upright", name="time")
    assert wire.metric("uprightness") == pytest.approx(math.cos(math.pi / 3 - 0.01))
    assert wire.worth() == pytest.approx(wire.metric("uprightness"))
    wire("freeze_cube", cube_name="block", freeze=True)
    wire("step", ticks=30)
    wire("set_cube_state", cube_name="block", rotation=[math.pi, 0, 0])
    wire("step", ticks=30)
    assert wire.metric("uprightness") == pytest.approx(-1)
    assert wire.worth("time") == 0.5


@pytest.mark.parametrize("backend", ["mujoco", "pymunk"])
@pytest.mark.parametrize("kind", ["hinge", "slide"])
def test_the_work_of_a_motor_is_the_energy_that_its_load_gains(backend: str, kind: str) -> None:
    wire = Wire(backend=backend, gravity=[0, 0, 0], tick_rate=240, substeps=4)
    wire("spawn_cube", cube_name="base", position=[0, 50, 0], is_base=True)
    wire("spawn_cube", cube_name="wheel", position=[3, 50, 0], size=[1, 1, 1], mass=2)
    wire("set_objective", expression="energy", cubes=["wheel"])
    inertia = 2 * (1 + 1) / 12 if kind == "hinge" else 2.0
    axis = [0, 0, 1] if kind == "hinge" else [1, 0, 0]
    fields = {"cube1": "base_BASE", "cube2": "wheel", "joint_type": kind, "axis": axis, "position": [3, 50, 0]}
    joint = wire("create_joint", **fields, motor_max_force=4 * inertia, motor_target_velocity=100)["joint_name"]
    wire("step", ticks=240)
    speed = wire("get_joint_info", joint_name=joint)["velocity"]
    assert speed == pytest.approx(4, rel=0.02)
    work = wire.worth()
    assert work == pytest.approx(inertia * speed**2 / 2, rel=0.03)
    assert wire.metric("energy") == pytest.approx(work) == pytest.approx(wire.metric("energy", cube="base_BASE"))
    # A motor that brakes works as much again; a joint that is gone has worked what it has.
    wire("set_joint_param", joint_name=joint, param_name="motor_target_velocity", value=0)
    wire("step", ticks=240)
    twice = wire.worth()
    assert twice == pytest.approx(2 * work, rel=0.03)
    wire("set_joint_param", joint_name=joint, param_name="motor_enabled", value=False)
    wire("remove_joint", joint_name=joint)
    wire("step", ticks=10)
    assert wire.worth() == twice
    assert wire.metric("energy") == pytest.approx(twice) == pytest.approx(wire.metric("energy", cube="base_BASE"))


def test_contacts_count_the_cubes_that_touch_something_outside_the_body() -> None:
    wire = Wire()
    for name, x, y in (("left", 0, 0.5), ("right", 3, 0.5), ("top", 0, 1.5)):
        wire("spawn_cube", cube_name=name, position=[x, y, 0])
    for name, cubes in (("all", ["left", "right", "top"]), ("pair", ["left", "top"]), ("one", ["top"])):
        wire("set_objective", name=name, expression="contacts", cubes=cubes)
    wire("set_objective", name="named", expression='cube("top").contacts + cube("right").contacts', cubes=["left"])
    wire("step", ticks=30)
    assert [wire.worth(name) for name in ("all", "pair", "one", "named")] == [2, 1, 1, 2]


def test_a_creature_scores_what_its_trajectory_scores_bit_for_bit() -> None:
    wire = Wire()
    spawned = wire("spawn_creature", genome=GENOME, name="it", position=[0, 0.2, 0])
    wire("spawn_cube", cube_name="ball", position=[2, 1, 0.5])
    ids, world = list(spawned["cubes"]), wire.world
    texts = [f"{fold}.{name}" for name in QUANTITIES for fold in FOLDS]
    texts += [f'max.cube("{ids[-1]}").height', 'mean.cube("ball").velocity.y', 'cube("ball").contacts']
    names = [*spawned["cubes"].values(), "ball"]
    sizes, masses = zip(
        *((i["size"], i["mass"]) for i in (wire("get_cube_info", cube_name=n) for n in names)), strict=True
    )
    bodies = ObservedBodies((*ids, "ball"), len(ids), np.array(sizes), np.array(masses), 60, (1.0, 2.0, 3.0))
    numbers = range(1, len(names) + 1)  # of bodies, and of the joints, in the engine
    joints = range(1, len(spawned["joints"]) + 1)
    trajectory = Trajectory(bodies, 60, len(joints), contacts=True)
    clients = [wire.client]
    for index, text in enumerate(texts):
        if index % 16 == 15:
            clients.append(world.join())
        set_ = {"type": "set_objective", "expression": text, "name": f"n{index}", "creature": "it", "target": [1, 2, 3]}
        assert send(world, clients[-1], **set_)["cubes"] == names[:-1]
    track = world.simulation.track(numbers, [], joints, 61)
    for row in range(61):
        if row:
            wire("drive", creature="it", controls=[math.sin(row / 4)] * len(spawned["motors"]))
            wire("step")
        track.note()
        trajectory.touches[row] = touches(world.simulation, numbers, len(ids))
    trajectory.states[:], trajectory.rows = track.states(0, 61), 61
    trajectory.meter(0, track.powers(0, 61)[:, 1])
    scores = {}
    for index, text in enumerate(texts):
        owner = clients[(index + 1) // 16]
        scores[text] = send(world, owner, type="compute_reward", objective=f"n{index}")["value"]
    assert scores == {text: trajectory.value(Objective(text)) for text in texts}
    assert scores["final.energy"] > 0.1


# -- whose they are, and what is refused ------------------------------------------------------------------------------


def test_objectives_are_a_clients_own_and_count_from_when_they_were_set() -> None:
    wire = Wire(gravity=[0, 0, 0])
    other = wire.world.join()
    wire("spawn_cube", cube_name="a", position=[0, 9, 0], linear_velocity=[1, 0, 0])
    assert wire("set_objective", expression="displacement.x")["cubes"] == ["a"]
    wire("step", ticks=60)
    assert send(wire.world, other, type="compute_reward")["code"] == "invalid"
    assert send(wire.world, other, type="set_objective", expression="time")["code"] == "nothing_owned"
    assert send(wire.world, other, type="set_objective", expression="2 * displacement.x", cubes=["a"])["needs"]
    wire("step", ticks=60)
    assert (wire.worth(), send(wire.world, other, type="compute_reward")["value"]) == pytest.approx((2, 2))
    wire("set_objective", expression="-displacement.x")
    wire("step", ticks=60)
    assert (wire.worth(), send(wire.world, other, type="compute_reward")["value"]) == pytest.approx((-1, 4))


def test_an_invalid_objective_is_refused_and_changes_nothing() -> None:
    wire = Wire()
    wire("spawn_cube", cube_name="a")
    wire("spawn_creature", genome=GENOME, name="it", position=[5, 0, 0])
    wire("set_objective", expression="height", cubes=["a"])
    assert wire.refused("set_objective", expression="height +") == (
        "bad_expression", "expression", "expression: line 1, column 9: expected a value, found the end",
    )  # fmt: skip
    assert wire.refused("set_objective", expression='cube("b").height')[:2] == ("cube_not_found", "expression")
    assert wire.refused("set_objective", expression="time", cubes=["a", "b"])[:2] == ("cube_not_found", "cubes/1")
    assert wire.refused("set_objective", expression="time", creature="is")[:2] == ("creature_not_found", "creature")
    assert wire.refused("set_objective", expression="time", creature="it", cubes=["a"])[:2] == ("invalid", "cubes")
    assert wire.refused("compute_reward", objective="x")[:2] == ("invalid", "objective")
    assert wire.refused("compute_reward", objective="x", metric="speed")[:2] == ("invalid", "objective")
    assert wire.refused("compute_reward", metric="speed", cube="b")[:2] == ("cube_not_found", "cube")
    assert wire.refused("compute_reward", metric="beauty")[:2] == ("invalid", "metric")
    assert wire.worth() == 1.0
    for i in range(15):
        wire("set_objective", name=f"more{i}", expression="time")
    assert wire.refused("set_objective", name="one too many", expression="time")[0] == "invalid"
    assert wire.refused("set_objective", name="one-too-many", expression="time")[0] == "limit_reached"
    wire("set_objective", name="more3", expression="1 / displacement.x")
    code, field, message = wire.refused("compute_reward", objective="more3")
    assert (code, field) == ("bad_expression", "objective")
    assert message == "objective 'more3': its value is inf, no finite number, where displacement.x = 0"


def test_an_engine_without_contacts_is_not_asked_for_any(monkeypatch: pytest.MonkeyPatch) -> None:
    wire = Wire(backend="ballistic")
    monkeypatch.setattr(wire.world.backend, "capabilities", frozenset())
    wire("spawn_cube")
    code, field, _ = wire.refused("set_objective", expression="max.contacts")
    assert (code, field) == ("unsupported", "expression")


def test_an_objective_with_a_removed_cube_is_refused_until_it_is_set_anew() -> None:
    wire = Wire()
    for name in ("a", "b"):
        wire("spawn_cube", cube_name=name, position=[0, 5, 0])
    wire("set_objective", expression='max.cube("a").height', cubes=["b"])
    wire("set_objective", expression="max.height", cubes=["b"], name="other")
    wire("despawn_cube", cube_name="a")
    wire("step")
    assert wire.refused("compute_reward") == (
        "cube_not_found", "objective", "objective 'objective' is about the cube 'a', which is gone",
    )  # fmt: skip
    wire("spawn_cube", cube_name="a")
    assert wire.refused("compute_reward")[0] == "cube_not_found"
    assert wire.worth("other") == 5.0
    wire("set_objective", expression='cube("a").height', cubes=["b"])
    assert wire.worth() == 1.0
    wire("reset")
    assert wire.refused("compute_reward")[:2] == ("invalid", "objective")


# -- what was recorded comes out again --------------------------------------------------------------------------------


def play(world: World, client: int) -> None:
    other = world.join()
    send(world, client, type="spawn_creature", genome=GENOME, name="it", position=[0, 0.1, 0])
    send(world, client, type="set_objective", expression="displacement.horizontal - energy / 100", creature="it")
    send(world, other, type="set_objective", expression="mean.height + time_upright", cubes=world.cubes())
    for i in range(12):
        send(world, client, type="drive", creature="it", controls=[(-1) ** i * 0.8])
        send(world, client, type="step", ticks=5)
        assert "value" in send(world, client, type="compute_reward")
        assert "value" in send(world, other, type="compute_reward")
        assert send(world, other, type="compute_reward", metric="energy", cube=world.cubes()[0])["value"] > 0.0
    send(world, other, type="set_objective", expression="heigth")


def test_rewards_are_reproduced(tmp_path: Path) -> None:
    path = record(tmp_path / "rewarded.mcap", play, {"backend": "mujoco", "keyframes": 0.25})
    assert replay(path).verdict == "reproduced"


def test_a_reward_that_differs_from_the_recorded_one_is_a_divergence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = record(tmp_path / "rewarded.mcap", play, {"backend": "mujoco"})
    values = RunningQuantities.values
    monkeypatch.setattr(
        RunningQuantities, "values", lambda *arguments: {q: v + 1e-9 for q, v in values(*arguments).items()}
    )
    report = replay(path)
    assert report.verdict == "diverged"
    assert report.divergence is not None and "reward" in str(report.divergence)


def test_a_restored_world_has_the_energy_and_objectives_of_the_saved_one() -> None:
    first = Wire()
    cubes = list(first("spawn_creature", genome=GENOME, name="it", position=[0, 0.1, 0])["cubes"].values())
    first("set_objective", expression="energy + mean.height + max.speed + time_upright + displacement.x", creature="it")
    first("set_objective", expression="height", name="lost", cubes=cubes[:1])
    first("drive", creature="it", controls=[1.0])
    first("step", ticks=20)
    snapshot = first.world.snapshot()
    second = Wire()
    second.world.restore(snapshot)

    def rewards(wire: Wire) -> list[float]:
        return [wire.worth(), *(wire.metric("energy", cube=name) for name in cubes)]

    assert rewards(first) == rewards(second)
    assert min(rewards(first)) > 0.0
    for wire in (first, second):
        wire("drive", creature="it", controls=[-1.0])
        wire("step", ticks=20)
    assert rewards(first) == rewards(second)
    joint = first("get_joint_list")["joints"][0]["joint_name"]
    for wire in (first, second):
        wire("remove_joint", joint_name=joint)
        wire("despawn_cube", cube_name=cubes[0])
    third = Wire()
    third.world.restore(first.world.snapshot())
    for wire in (first, second, third):
        assert wire.refused("compute_reward", objective="lost")[0] == "cube_not_found"
    assert first.metric("energy", cube=cubes[1]) == third.metric("energy", cube=cubes[1]) > 0.0
