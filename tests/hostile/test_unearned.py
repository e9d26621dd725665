"""What rolls, falls or is flung without a motor of its own is worth nothing, on tasks and in matches."""

from __future__ import annotations

import math
import tracemalloc
from random import Random
from typing import Any

import pytest

from nmes.evaluation import MatchTask, Task, evaluate, play
from nmes.genome import Genome
from shakers import lead_shaker, shaker

Json = dict[str, Any]
BLOCK: Json = {"cubes": [{"id": "block", "size": [0.6, 0.3, 0.4], "mass": 10, "position": [0, 0.15, 0]}]}
MOTORLESS = [name for name in Task.names() if name not in ("growth", "pole", "swim")]  # who stands there, or floats


def genome(body: Json, **more: Any) -> Genome:
    return Genome({"format": "nmes-genome/1", "name": "still", "body": body, **more})


def unbalanced(draw: Random, longest: float) -> Genome:
    """Draws a light ball with a heavy weight nearly above its middle: it stands for a while, topples, and rolls on."""
    radius = longest / 2 * draw.uniform(0.5, 0.98)
    away, lean = radius * draw.uniform(0.15, 0.5), draw.uniform(0.02, 0.1)
    size = radius * draw.uniform(0.15, 0.3)
    shell = draw.uniform(3, 10)
    mass = min(40 * shell, 15_000 * size**3)
    middle = [away * math.sin(lean), radius + away * math.cos(lean), 0]
    cubes = [
        {"id": "shell", "shape": "sphere", "size": 2 * radius, "mass": shell, "position": [0, radius, 0]},
        {"id": "weight", "size": size, "mass": mass, "position": middle},
    ]
    joint = {"id": "j", "cube1": "shell", "cube2": "weight", "type": "fixed", "anchor": [0, radius, 0]}
    return genome({"cubes": cubes, "joints": [joint]})


@pytest.mark.parametrize("bodies", [4, pytest.param(300, marks=pytest.mark.long)])
@pytest.mark.parametrize("name", MOTORLESS)
def test_a_ball_out_of_balance_scores_nothing(name: str, bodies: int) -> None:
    task, draw = Task.load(name), Random(name)
    for number in range(bodies):
        evaluation = evaluate(unbalanced(draw, task.limits.size or 4.0), task, seeds=[task.seeds[0]])
        assert evaluation.error is None
        assert not evaluation.results[0].score, f"{number}: {evaluation.results[0]}"


def test_some_of_these_balls_roll_far() -> None:
    task, draw = Task.load("walk"), Random("walk")
    free = Task({**task.document, "objective": "max(0, displacement.x - 2 * max.reach)"})
    scores = [evaluate(unbalanced(draw, 4.0), free, seeds=[1]).results[0].score or 0.0 for _ in range(4)]
    assert max(scores) > 3.0


@pytest.mark.parametrize("name", MatchTask.names())
def test_a_ball_out_of_balance_has_nothing_of_a_match(name: str) -> None:
    task, draw = MatchTask.load(name), Random(name)
    for role in task.roles:
        players = {each: genome(BLOCK) for each in task.roles} | {role: unbalanced(draw, 2.0)}
        for match in play(task, players, seeds=[1]):
            result = match.results[role]
            assert result.score is None or result.score <= 0.0 or role == "prey", result  # whom no block catches


def test_who_falls_towards_the_middle_while_it_is_set_down_has_not_come_there() -> None:
    """Its foot is narrow and its head heavy: it falls at once, and is at rest when the match begins."""
    cubes: list[Json] = [
        {"id": "foot", "size": [0.3, 0.2, 1.2], "mass": 10, "position": [0, 0.1, 0]},
        {"id": "pole", "size": [0.3, 1.2, 1.2], "mass": 100, "position": [0.02, 0.8, 0]},
        {"id": "head", "size": [0.5, 0.58, 1.2], "mass": 380, "position": [0.25, 1.69, 0]},
    ]
    joints: list[Json] = [
        {"id": "a", "cube1": "foot", "cube2": "pole", "type": "fixed", "anchor": [0, 0.2, 0]},
        {"id": "b", "cube1": "pole", "cube2": "head", "type": "fixed", "anchor": [0, 1.4, 0]},
    ]
    tower = genome({"cubes": cubes, "joints": joints})
    for match in play("sumo", {"red": tower, "blue": genome(BLOCK)}):
        for result in match.results.values():
            assert result.fault is None and result.score is not None
            assert abs(result.score) < 0.05  # the margin below which nobody has won


def pendulum_ball(heading: float = 0.0) -> Json:
    """Returns a ball that rolls for metres while a weight on a damped hinge sinks, and is at rest then."""
    radius, lean, arm = 0.75, 0.6672771109409199, 0.6
    x, z = math.cos(heading), -math.sin(heading)
    middle = [arm * math.sin(lean) * x, radius + arm * math.cos(lean), arm * math.sin(lean) * z]
    cubes: list[Json] = [
        {"id": "ball", "shape": "sphere", "size": 2 * radius, "mass": 120, "position": [0, radius, 0], "friction": 2},
        {"id": "weight", "size": 0.26, "mass": 300, "position": middle},
    ]
    hinge = {"type": "hinge", "axis": [-z, 0, x], "anchor": [0, radius, 0], "damping": 2061.9}
    return {"cubes": cubes, "joints": [{"id": "j", "cube1": "ball", "cube2": "weight", **hinge}]}


@pytest.mark.parametrize(("role", "other"), [("red", "blue"), ("blue", "red")])
def test_who_comes_to_the_other_before_the_match_has_lost_it(role: str, other: str) -> None:
    (match,) = play("sumo", {role: genome(pendulum_ball()), other: "walker"}, seeds=[1])
    assert (match.results[role].fault or "").startswith("displaced: before the start a part of it came to the place of")
    assert match.results[other].fault is None and match.results[other].score == 0.0


@pytest.mark.parametrize(("role", "other"), [("red", "blue"), ("blue", "red")])
def test_who_is_moved_before_the_match_has_not_lost_it(role: str, other: str) -> None:
    """A bar on a hinge falls from a boom onto the other, and flings it farther than it moves itself."""
    cubes: list[Json] = [
        {"id": "root", "size": [0.3, 0.3, 1.2], "mass": 405, "position": [0, 0.15, 0], "friction": 2},
        {"id": "boom", "size": [1.264, 0.06, 0.3], "mass": 15, "position": [0.782, 0.05, 0], "friction": 1},
        {"id": "bar", "size": [0.06, 1.513, 1], "mass": 60, "position": [1.577, 0.906, 0], "rotation": [0, 0, -0.286]},
    ]
    joints: list[Json] = [
        {"id": "k", "cube1": "root", "cube2": "boom", "type": "fixed", "anchor": [0.15, 0.05, 0]},
        {"id": "j", "cube1": "boom", "cube2": "bar", "type": "hinge", "axis": [0, 0, 1], "anchor": [1.363, 0.08, 0]},
    ]
    for match in play("sumo", {role: genome({"cubes": cubes, "joints": joints}), other: "walker"}):
        assert "came to the place of another" in str(match.results[role].fault)
        assert match.results[other].fault is None


def test_to_look_for_who_comes_to_another_takes_little_memory() -> None:
    places = [[0.3 * (n % 16), 0.1, 0.3 * (n // 16)] for n in range(128)]
    cubes = [{"id": f"c{n}", "size": 0.2, "mass": 1, "position": place} for n, place in enumerate(places)]
    hangs = {"cube1": "c0", "type": "fixed", "anchor": [0, 0.1, 0]}
    many = genome({"cubes": cubes, "joints": [{"id": f"j{n}", "cube2": f"c{n}", **hangs} for n in range(1, 128)]})
    document = MatchTask.load("sumo").document
    roles = [{**role, "limits": {}} for role in document["roles"]]
    task = MatchTask({**document, "name": "crowds", "settle": 5, "duration": 0.1, "limits": {}, "roles": roles})
    tracemalloc.start()
    try:
        play(task, {"red": many, "blue": many}, seeds=[1])
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 60e6  # 300 ticks of 16,384 pairs of cubes are 118 MB


def test_who_comes_to_its_target_before_the_start_has_no_score() -> None:
    (result,) = evaluate(genome(pendulum_ball()), Task.load("reach"), seeds=[1]).results
    assert result.score is None
    assert (result.fault or "").startswith("displaced: before the start it came ")
    assert "farther than its size, 1.5 m" in str(result.fault)


def marble() -> Genome:
    """Returns a ball at the top of a ramp that is a limb of its own, and that a leg holds up."""
    radius, angle, long, thick = 0.3, 0.7, 3.0, 0.3
    c, s = math.cos(angle), math.sin(angle)
    height, along = long / 2 * s + thick / 2 * c + 0.001, 0.25 - long / 2
    top = [along * c + thick / 2 * s, height - along * s + thick / 2 * c, 0]
    place = [top[0] + (radius + 0.002) * s, top[1] + (radius + 0.002) * c, 0]
    tall = place[1] - radius - 0.6
    foot = 0.4 - long / 2 * c
    cubes = [
        {"id": "ball", "shape": "sphere", "size": 2 * radius, "mass": 20, "position": place},
        {"id": "ramp", "size": [long, thick, 2], "mass": 100, "position": [0, height, 0], "rotation": [0, 0, -angle]},
        {"id": "leg", "size": [0.3, tall, 1.8], "mass": 50, "position": [foot, tall / 2, 0]},
    ]
    joints = [
        {"id": "j", "cube1": "ball", "cube2": "ramp", "type": "fixed", "anchor": top},
        {"id": "k", "cube1": "ramp", "cube2": "leg", "type": "fixed", "anchor": [foot, tall, 0]},
    ]
    return genome({"cubes": cubes, "joints": joints})


def test_who_rolls_down_a_limb_that_is_cut_off_has_not_walked() -> None:
    evaluation = evaluate(marble(), Task.load("injury"))
    assert evaluation.error is None
    assert [result.score for result in evaluation.results] == [0.0] * 3
    assert min(result.distance for result in evaluation.results) > 10.0


def test_what_grew_and_is_cut_off_has_not_worked() -> None:
    """A lump grows high on the marble's leg, whose weight counts as energy of the creature; then both are cut off."""
    document = marble().document
    leg = document["body"]["cubes"][2]
    x, y, _ = leg["position"]
    top, foot = [x, 2 * y - 0.2, 0.9], [x - 0.15, 0.05, 0]
    lump: Json = {"id": "lump", "size": 0.3, "mass": 60, "position": [x, top[1], 1.17]}
    nub: Json = {"id": "nub", "size": 0.1, "mass": 1, "position": [foot[0] - 0.06, 0.05, 0]}
    motor = {"mode": "velocity", "range": [-1, 1], "max_effort": 0}  # only who has a motor has a brain, and develops
    document["body"]["cubes"] += [lump, nub]
    document["body"]["joints"] += [
        {"id": "l", "cube1": "leg", "cube2": "lump", "type": "fixed", "anchor": top},
        {"id": "m", "cube1": "leg", "cube2": "nub", "type": "hinge", "anchor": foot, "motor": motor},
    ]
    rules = [{"when": "cubes > 0", "grow": ["lump"]}]
    brain = {"kind": "sine", "oscillators": [{"motor": "*", "amplitude": 0}]}
    ripe = Genome({**document, "later": ["lump"], "development": rules, "brain": brain})
    evaluation = evaluate(ripe, Task.load("injury"))
    assert evaluation.error is None
    assert [result.score for result in evaluation.results] == [0.0] * 3
    assert min(result.energy for result in evaluation.results) > 500.0


@pytest.mark.parametrize("overlap", [0.1, 0.2, 0.28])
def test_who_is_flung_by_a_limb_that_is_cut_off_has_not_walked(overlap: float) -> None:
    """The root lies in the limb it hangs on: once they are apart the heavy one throws it."""
    cubes: list[Json] = [
        {"id": "root", "size": 0.3, "mass": 5, "position": [0.3 - overlap, 0.15, 0], "friction": 0.5},
        {"id": "limb", "size": 0.3, "mass": 400, "position": [0, 0.15, 0], "friction": 1},
    ]
    joint = {"id": "j", "cube1": "root", "cube2": "limb", "type": "fixed", "anchor": [0.1, 0.15, 0]}
    (result,) = evaluate(genome({"cubes": cubes, "joints": [joint]}), Task.load("injury"), seeds=[1]).results
    assert not result.score
    assert result.score is None or result.distance < 5.0


def test_who_throws_a_sea_anchor_back_has_not_swum() -> None:
    """A heavy bar pushes itself off from a plate, by 14 m and once, and glides: 10 m in ten seconds."""
    cubes: list[Json] = [
        {"id": "bar", "size": [3.2, 0.08, 0.3], "mass": 190, "position": [0, 0.04, 0]},
        {"id": "plate", "size": [0.05, 0.9, 0.9], "mass": 4, "position": [0, 0.53, 0]},
    ]
    motor = {"mode": "velocity", "range": [-30, 0], "max_effort": 1200}
    slide = {"type": "slide", "anchor": [0, 0.08, 0], "axis": [1, 0, 0], "limits": [-14, 0.1], "motor": motor}
    joint = {"id": "push", "cube1": "bar", "cube2": "plate", **slide}
    brain = {"kind": "sine", "oscillators": [{"motor": "push", "amplitude": 0, "offset": -1}]}
    swim = Task.load("swim")
    free = Task({**swim.document, "limits": {**swim.document["limits"], "size": 1000}})  # else that is beyond its size
    evaluation = evaluate(genome({"cubes": cubes, "joints": [joint]}, brain=brain), free)
    assert evaluation.error is None and [result.fault for result in evaluation.results] == [None] * 3
    assert min(result.distance for result in evaluation.results) > 5.0
    assert [result.score for result in evaluation.results] == [0.0] * 3


@pytest.mark.parametrize(("found", "substeps"), [(shaker(), 8), (lead_shaker(), 4)], ids=["stone", "lead"])
def test_who_shakes_does_not_swim_by_the_momentum_that_steps_make(found: Genome, substeps: int) -> None:
    """Where the forces of a step are those of its beginning they push such lumps along; those of `swim` do not."""
    swim = Task.load("swim").document
    dense = {**swim, "name": "dense", "limits": {**swim["limits"], "density": 20000}}
    coarse = {**dense, "world": {**swim["world"], "engine": {}, "substeps": substeps}}
    scores = [evaluate(found, Task(document), seeds=[1]).score for document in (coarse, dense)]
    assert scores[0] is not None and scores[0] > 15.0
    assert scores[1] is not None and scores[1] < 0.5


def test_lumps_as_dense_as_lead_may_not_swim() -> None:
    problems = Task.load("swim").check(lead_shaker().body)
    assert [why.split(", ")[1] for why in problems][:1] == ["at most 2500 are allowed"]


def test_who_stands_up_and_draws_its_leg_in_has_not_jumped() -> None:
    """Its lowest point rises by 1.5 m while it falls; its centre had risen by as much before, and slowly."""
    cubes: list[Json] = [
        {"id": "torso", "size": [1.2, 0.3, 1.2], "mass": 40, "position": [0, 0.22, 0]},
        {"id": "leg", "size": [0.1, 2.1, 0.1], "mass": 3, "position": [0, 1.1, 0]},
        {"id": "foot", "size": [1, 0.05, 1], "mass": 3, "position": [0, 0.025, 0]},
    ]
    motor = {"mode": "velocity", "range": [-15, 0.9], "max_effort": 1000}
    stand = {"type": "slide", "anchor": [0, 0.2, 0], "axis": [0, -1, 0], "limits": [0, 1.8], "motor": motor}
    joints = [
        {"id": "stand", "cube1": "torso", "cube2": "leg", **stand},
        {"id": "ankle", "cube1": "leg", "cube2": "foot", "type": "fixed", "anchor": [0, 0.05, 0]},
    ]
    brain = {"kind": "sine", "oscillators": [{"motor": "stand", "amplitude": 10, "frequency": 0.2}]}
    task = Task.load("jump-high")
    evaluation = evaluate(genome({"cubes": cubes, "joints": joints}, brain=brain), task, seeds=[1])
    assert evaluation.error is None
    (result,) = evaluation.results
    assert result.score is not None and result.score < 0.05
    lenient = Task({**task.document, "objective": "min(max.lowest - start.lowest, max.height - start.height)"})
    (fooled,) = evaluate(genome({"cubes": cubes, "joints": joints}, brain=brain), lenient, seeds=[1]).results
    assert fooled.score is not None and fooled.score > 1.0


def test_who_does_nothing_has_not_won_where_the_other_goes_by_itself() -> None:
    slab = {"id": "slab", "size": [1.9, 0.3, 1.9], "mass": 500, "position": [0, 0.15, 0], "friction": 2}
    (match,) = play("sumo", {"red": genome({"cubes": [slab]}), "blue": "seeker"}, seeds=[1])
    assert match.results["red"].ended == "out"
    assert [result.score for result in match.results.values()] == [0.0, 0.0]


def sled(low: float | None, high: float | None) -> Genome:
    """Returns a block that a foot kicks ahead once, by a slide, and that slides on; each with a friction of its own."""
    own = [{} if friction is None else {"friction": friction} for friction in (low, high)]
    cubes = [
        {"id": "block", "size": [1, 1, 0.6], "mass": 50, "position": [0, 0.5, 0], **own[0]},
        {"id": "foot", "size": 0.2, "mass": 2, "position": [-0.62, 0.1, 0], **own[1]},
    ]
    motor = {"mode": "velocity", "range": [-19, 19], "max_effort": 5050}
    slide = {"type": "slide", "anchor": [-0.62, 0.1, 0], "axis": [-0.84, -0.54, 0], "limits": [-0.3, 1.7]}
    joints = [{"id": "leg", "cube1": "block", "cube2": "foot", **slide, "motor": motor}]
    nodes: list[Json] = [
        {"id": "done", "activation": "step", "bias": -140},
        {"id": "kick", "motor": "leg", "activation": "identity", "bias": 1},
    ]
    links = [
        {"sensor": "leg.position", "to": "done", "weight": 100},
        {"from": "done", "to": "done", "weight": 1000},
        {"from": "done", "to": "kick", "weight": -1.1},
    ]
    return genome({"cubes": cubes, "joints": joints}, brain={"kind": "graph", "nodes": nodes, "links": links})


@pytest.mark.parametrize("name", ["walk", "gaps", "rough", "planar-walk"])
def test_who_sets_its_own_friction_sets_what_is_found_on_grounds(name: str) -> None:
    task = Task.load(name)
    for low, high, cube, friction in ((0, 10, "foot", 10), (0, 2, "block", 0), (0.5, 2.01, "foot", 2.01)):
        evaluation = evaluate(sled(low, high), task)
        why = f"cube '{cube}' has a friction of {friction:g}, from 0.5 to 2 is allowed"
        assert why in str(evaluation.error) and evaluation.results == ()
    for allowed in (sled(None, None), sled(0.5, 2), sled(None, 1.5)):
        assert task.check(allowed.body) == []


def test_a_sled_without_friction_would_slide_to_the_end() -> None:
    walk = Task.load("walk")
    lenient = Task({**walk.document, "limits": {**walk.document["limits"], "friction": [0, 10]}})
    (slippery,) = evaluate(sled(0, 10), lenient, seeds=[1]).results
    (allowed,) = evaluate(sled(0.5, 2), walk, seeds=[1]).results
    assert slippery.score is not None and slippery.score > 100.0
    assert allowed.score is not None and allowed.score < 40.0


def flapper(stiffness: float) -> Genome:
    """Returns a hull with a plate on a spring behind it, and a fin that the overlap of two cubes has set going."""
    cubes: list[Json] = [
        {"id": "hull", "size": [2, 0.2, 0.2], "mass": 22.14, "position": [0, 1, 0]},
        {"id": "plate", "size": [0.6415, 0.8914, 0.02], "mass": 0.2236, "position": [-1.33075, 1, 0]},
        {"id": "weight", "size": 0.1, "mass": 0.2236, "position": [0.5, 1, 0.15]},
        {"id": "fin", "size": 0.1, "mass": 0.2236, "position": [0.400027, 1, 0.15]},
    ]
    upright: Json = {"type": "hinge", "axis": [0, 1, 0]}
    joints = [
        {"id": "tail", "cube1": "hull", "cube2": "plate", "anchor": [-1, 1, 0], **upright, "stiffness": stiffness},
        {"id": "f", "cube1": "hull", "cube2": "weight", "type": "fixed", "anchor": [0.5, 1, 0.1]},
        {"id": "h", "cube1": "hull", "cube2": "fin", "anchor": [0.4, 1, 0.1], **upright, "damping": 0.10637},
    ]
    return genome({"cubes": cubes, "joints": joints})


def test_who_swings_on_a_spring_that_no_engine_can_follow_may_not_swim() -> None:
    """It has no motor: the spring alone, of two radians and more in a step of the engine, drove it."""
    task = Task.load("swim")
    evaluation = evaluate(flapper(10109), task)
    assert evaluation.results == () and "the spring of joint 'tail' may swing at " in str(evaluation.error)
    assert "at most 480 are allowed: the engine's steps are of 0.00208 s" in str(evaluation.error)
    soft = evaluate(flapper(220), task, seeds=[1])
    assert soft.error is None and soft.results[0].score == 0.0
    finer = Task({**task.document, "world": {**task.document["world"], "substeps": 28}})
    fine = evaluate(flapper(10109), finer, seeds=[1])
    assert fine.error is None and fine.results[0].score == 0.0


@pytest.mark.parametrize("name", MatchTask.names())
def test_matches_refuse_such_surfaces_and_springs_too(name: str) -> None:
    task = MatchTask.load(name)
    for role in task.roles:
        assert "cube 'foot' has a friction of 10, from 0.5 to 2 is allowed" in task.check(role, sled(0, 10).body)
        assert any("the spring of joint 'tail' may swing" in why for why in task.check(role, flapper(10109).body))
