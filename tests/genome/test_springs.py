"""Springs: the bound of how fast they let a body swing, and which ones a task's engine can follow."""

from __future__ import annotations

import math
from collections.abc import Sequence
from random import Random
from typing import Any

import numpy as np
import pytest

from nmes.evaluation import Task
from nmes.genome import Genome
from nmes.genome.body import Body
from nmes.genome.springs import slowing, swing
from nmes.world import World

Json = dict[str, Any]
STEP = 1 / 240  # s, an engine step of a task that says nothing else


def genome(cubes: Sequence[Json], joints: Sequence[Json], **more: Any) -> Genome:
    body = {"cubes": [*cubes], "joints": [*joints]}
    return Genome({"format": "nmes-genome/1", "name": "springs", "body": body, **more})


def cube(name: str, x: float = 0.0, y: float = 1.0, **more: Any) -> Json:
    return {"id": name, "size": 0.2, "mass": 1.5, "position": [x, y, 0], **more}


def spring(one: str, two: str, stiffness: float, kind: str = "slide", **more: Any) -> Json:
    return {
        "id": two, "cube1": one, "cube2": two, "type": kind, "anchor": [0, 1, 0], "stiffness": stiffness, **more
    }  # fmt: skip


def test_of_two_free_cubes_alike_it_is_their_frequency() -> None:
    pair = [cube("a"), cube("b")]
    frequency, joint = swing(genome(pair, [spring("a", "b", 300)]).body)
    assert frequency == pytest.approx(math.sqrt(300 * 2 / 1.5)) and joint == "b"
    inertia = 1.5 * 0.2**2 / 6
    assert swing(genome(pair, [spring("a", "b", 2, "hinge")]).body)[0] == pytest.approx(math.sqrt(2 * 2 / inertia))
    ball = [cube(name, shape="sphere") for name in "ab"]
    inertia = 1.5 * 0.2**2 / 10
    assert swing(genome(ball, [spring("a", "b", 2, "hinge")]).body)[0] == pytest.approx(math.sqrt(2 * 2 / inertia))
    assert swing(genome(pair, [spring("a", "b", 0)]).body) == (0.0, "")


def test_a_hinge_counts_with_the_inertia_about_its_axis_and_a_slide_with_what_it_turns() -> None:
    """About its length the rod is easy to turn, and however it lies its own axes count."""
    inertias = [1.5 * (0.1**2 + 0.1**2) / 12, 1.5 * (0.8**2 + 0.1**2) / 12]
    for turn in (0.0, math.pi / 2):
        rods = [cube(name, size=[0.8, 0.1, 0.1], rotation=[0, 0, turn]) for name in "ab"]
        along = [math.cos(turn), math.sin(turn), 0]
        for axis, inertia in zip((along, [0, 0, 3]), inertias, strict=True):
            body = genome(rods, [spring("a", "b", 5, "hinge", axis=axis)]).body
            assert swing(body)[0] == pytest.approx(math.sqrt(2 * 5 / inertia))
        aside = genome(rods, [spring("a", "b", 5, axis=along, anchor=[-0.3 * along[1], 1 + 0.3 * along[0], 0])]).body
        assert swing(aside)[0] == pytest.approx(math.sqrt(2 * 5 * (1 / 1.5 + 0.3**2 / inertias[1])))


def test_springs_at_one_cube_add_up_and_the_stiffest_is_named() -> None:
    cubes = [cube("a"), *(cube(name, x, mass=15) for x, name in enumerate("bcd", 1))]
    body = genome(cubes, [spring("a", "b", 100), spring("a", "c", 300), spring("a", "d", 200)]).body
    frequency, joint = swing(body)
    assert frequency == pytest.approx(math.sqrt(2 * 600 / 1.5)) and joint == "c"


def test_parts_that_may_shrink_count_as_small_as_they_may_come_to_be() -> None:
    task, joint = Task({**Task.load("growth").document, "limits": {}, "newborn": {}}), spring("a", "b", 10_000)
    pair = [cube("a"), cube("b", y=1.1)]
    assert task.check(genome(pair, [joint]).body) == []
    rules = [{"when": "age > 1", "resize": [{"part": "b", "scale": 0.4}]}]
    motor = {"mode": "velocity", "range": [-1, 1], "max_effort": 0}  # only who has a motor has a brain, and develops
    joint = {**joint, "anchor": [0, 1.1, 0], "motor": motor}
    (why,) = task.check(genome(pair, [joint], development=rules).body)
    assert "the spring of joint 'b' may swing at" in why and "as the body may develop, at most 240 are" in why


@pytest.mark.parametrize("world", [{}, {"substeps": 8}, {"tick_rate": 120}, {"backend": "pymunk", "substeps": 1}])
def test_a_task_allows_a_radian_in_a_step_of_its_engine(world: Json) -> None:
    task = Task({**Task.load("walk").document, "world": world, "limits": {}})
    most = task.tick_rate * task.substeps
    for part, allowed in ((0.999, True), (1.001, False)):
        body = genome([cube("a"), cube("b")], [spring("a", "b", (part * most) ** 2 * 1.5 / 2)]).body
        reasons = task.check(body)
        assert (reasons == []) == allowed
        assert allowed or f"at most {most} are allowed: the engine's steps are of {1 / most:.3g} s" in reasons[0]
        assert allowed or task.requirements.check(body) == reasons


def test_dampers_at_one_cube_add_up() -> None:
    cubes = [cube("a"), *(cube(name, x, mass=15) for x, name in enumerate("bc", 1))]
    body = genome(cubes, [spring("a", "b", 0, damping=100), spring("a", "c", 0, damping=300)]).body
    rate, joint = slowing(body)
    assert rate == pytest.approx(2 * 400 / 1.5) and joint == "c"
    assert slowing(genome(cubes[:2], [spring("a", "b", 100)]).body) == (0.0, "")


def test_dampers_are_bounded_where_the_engine_integrates_them_explicitly() -> None:
    staged = {"substeps": 8, "engine": {"integrator": "rk4", "sleep": False}}
    free, strict = (
        Task({**Task.load("walk").document, "name": "damped", "world": world, "limits": {}})
        for world in ({"substeps": 8}, staged)
    )
    for part, allowed in ((0.999, True), (1.001, False)):
        body = genome([cube("a"), cube("b")], [spring("a", "b", 0, damping=part * 2.5 * 480 * 1.5 / 2)]).body
        assert free.check(body) == []
        assert [why.split(",")[1] for why in strict.check(body)] == (
            [] if allowed else [" at most 1200 are allowed: the engine's steps are of 0.00208 s"]
        )


# -- held against engines ---------------------------------------------------------------------------------------------


def random_chain(draw: Random, kind: str) -> tuple[list[Json], list[Json]]:
    """Draws boxes of all forms in a row, each on a spring at the one before, apart from each other."""
    cubes: list[Json] = []
    joints: list[Json] = []
    end = 0.0
    for number in range(draw.randint(2, 5)):
        size = [draw.uniform(0.05, 0.5) for _ in range(3)]
        size[draw.randrange(3)] *= draw.choice([1.0, 0.2])
        place = [end + draw.uniform(0.02, 0.2) + size[0] / 2, 2 + draw.uniform(-0.2, 0.2), draw.uniform(-0.2, 0.2)]
        cubes.append({"id": f"c{number}", "size": size, "mass": 10 ** draw.uniform(-1, 1.5), "position": place})
        if number:
            joint = spring(f"c{number - 1}", f"c{number}", 10 ** draw.uniform(0, 2), kind)
            axis = [draw.gauss(0, 1) for _ in range(3)]
            joints.append({**joint, "axis": axis, "anchor": [end, 2 + draw.uniform(-0.1, 0.1), 0]})
        end = place[0] + size[0] / 2
    return cubes, joints


def stiffened(cubes: list[Json], joints: list[Json], radians: float) -> Genome:
    """Returns a body whose springs are as stiff as makes the bound so many radians in a step."""
    factor = (radians / STEP / swing(genome(cubes, joints).body)[0]) ** 2
    return genome(cubes, [{**joint, "stiffness": joint["stiffness"] * factor} for joint in joints])


def greatest(body: Body, document: Json, speed: float, backend: str = "mujoco") -> tuple[float, float]:
    """Returns how far springs are ever stretched in 2 s without weight, as energy, J, and what pushes gave, J.

    Each cube is pushed along all axes once, to about a speed in m/s, and the next one the other way.
    """
    world = World({"gravity": [0, 0, 0], "mode": "lockstep", "backend": backend})
    world.join()
    spawn = {"type": "spawn_creature", "genome": document, "name": "c", "position": [0, 50, 0]}
    assert world.execute(1, spawn)["type"] != "error"
    given = 0.0
    for number, each in enumerate(body.cubes):
        push = [each.mass * speed * (-1.0) ** number] * (3 if backend == "mujoco" else 2)
        given += sum(x * x for x in push) / each.mass / 2
        push += [0.0] * (3 - len(push))
        assert world.execute(1, {"type": "apply_physics", "cube_name": f"c.{each.id}", "impulse": push})
    joints = [joint for joint in world.entities.joints.values() if joint.params["stiffness"]]
    stiffnesses = np.array([joint.params["stiffness"] for joint in joints])
    most = 0.0
    for _ in range(120):
        world.tick()
        positions = world.simulation.joint_readings(tuple(joint.number for joint in joints))[:, 0]
        most = max(most, float((stiffnesses * positions * positions).sum()) / 2)
        if not most < 1e9 * given:
            break
    return most, given


@pytest.mark.parametrize("kind", ["hinge", "slide"])
def test_within_the_bound_springs_make_no_energy_in_any_pose(kind: str) -> None:
    """At a radian a step what seems to be in a swing wavers by a half up and down."""
    draw = Random(kind)
    for number in range(8):
        chain = stiffened(*random_chain(draw, kind), 1.0)
        for speed in (0.05, 1.0):
            most, given = greatest(chain.body, chain.document, speed)
            assert most < 2.0 * given, number


@pytest.mark.parametrize("backend", ["mujoco", "pymunk"])
def test_beyond_two_radians_a_step_the_engine_makes_energy_of_nothing(backend: str) -> None:
    """Of two cubes alike on a slide through both centres the bound is their very frequency."""
    cubes, joints = [cube("a"), cube("b")], [spring("a", "b", 1.0)]
    for radians, sound in ((1.0, True), (2.05, False)):
        pair = stiffened(cubes, joints, radians)
        most, given = greatest(pair.body, pair.document, 0.05, backend)
        assert (most < 2.0 * given) == sound


def test_within_the_bound_dampers_slow_a_body_down_and_far_beyond_it_the_engine_goes_wrong() -> None:
    """Of two cubes alike on a slide through both centres the bound is their very rate."""
    config = {"gravity": [0, 0, 0], "mode": "lockstep", "engine": {"integrator": "rk4", "sleep": False}}
    for times, sound in ((2.5, True), (2.9, False)):
        pair = genome([cube("a"), cube("b")], [spring("a", "b", 0, damping=times / STEP * 1.5 / 2)])
        world = World(config)
        world.join()
        spawn = {"type": "spawn_creature", "genome": pair.document, "name": "c", "position": [0, 50, 0]}
        assert world.execute(1, spawn)["type"] != "error"
        push = {"type": "apply_physics", "cube_name": "c.a", "impulse": [1.5, 0, 0]}
        assert world.execute(1, push)["type"] == "physics_applied"
        for _ in range(60):
            world.tick()
        (joint,) = world.entities.joints.values()
        left = abs(world.simulation.joint_state(joint.number).velocity)
        assert (left < 1e-6) == sound and (left > 2.0) == (not sound)
