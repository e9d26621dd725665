"""Scores that nobody earned: bodies that the solver flings, motors beyond all measure, bodies that never rest."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from creatures import snake
from nmes.errors import DocumentError
from nmes.evaluation import Result, Task, evaluate, prove
from nmes.genome import Genome

DASH = {
    "format": "nmes-task/1",
    "name": "dash",
    "description": "Get away from the start.",
    "duration": 2,
    "seeds": [1],
    "objective": "displacement.horizontal",
}


def pair(kind: str = "slide", brain: dict[str, Any] | None = None, mass: float = 1.0, **joint: Any) -> dict[str, Any]:
    """The genome of two cubes side by side, with a joint between them."""
    cubes = [
        {"id": "a", "size": 1, "mass": mass, "position": [0, 0.5, 0]},
        {"id": "b", "size": 1, "mass": mass, "position": [1, 0.5, 0]},
    ]
    axis = {} if kind in ("fixed", "pin") else {"axis": [1, 0, 0] if kind == "slide" else [0, 0, 1]}
    joints = [{"id": "j", "cube1": "a", "cube2": "b", "type": kind, "anchor": [0.5, 0.5, 0], **axis, **joint}]
    genome = {"format": "nmes-genome/1", "name": "pair", "body": {"cubes": cubes, "joints": joints}}
    return genome if brain is None else {**genome, "brain": brain}


# -- limits that exclude the pose at rest -----------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["hinge", "slide"])
@pytest.mark.parametrize("limits", [[56.7, 56.8], [-3, -1e-6], [1e-6, 2]])
def test_limits_that_exclude_the_pose_at_rest_are_refused(kind: str, limits: list[float]) -> None:
    with pytest.raises(DocumentError) as caught:
        Genome(pair(kind, limits=limits))
    ((path, message),) = caught.value.problems
    assert path == "body/joints/0/limits"
    assert message.startswith("the limits of joint 'j', ") and "exclude 0" in message


@pytest.mark.parametrize("kind", ["hinge", "slide"])
@pytest.mark.parametrize("limits", [[0, 0], [0, 1], [-1, 0], [-1, 2]])
def test_limits_may_end_at_the_pose_at_rest(kind: str, limits: list[float]) -> None:
    assert Genome(pair(kind, limits=limits)).body.joints[0].limits == tuple(limits)


def test_a_cone_contains_the_pose_at_rest_unless_it_is_negative() -> None:
    assert Genome(pair("conetwist", limits=[0, 0])).body.joints[0].limits == (0.0, 0.0)
    for limits in ([-0.1, 1], [1, -0.1]):
        with pytest.raises(DocumentError, match="must not be negative"):
            Genome(pair("conetwist", limits=limits))


def test_limits_of_a_graph_contain_the_pose_at_rest_after_growth_at_any_scale_and_in_mirrors() -> None:
    arm = {"id": "arm", "size": 0.2, "joint": {"type": "slide", "axis": [1, 0, 0], "limits": [0.1, 0.2]}}
    graph = {
        "root": "trunk",
        "parts": [{"id": "trunk", "size": 0.5}, arm],
        "connections": [{"from": "trunk", "to": "arm", "face": "+z", "mirror": "z", "scale": 0.5}],
    }
    genome = {"format": "nmes-genome/1", "name": "grown", "body": {"graph": graph}}
    with pytest.raises(DocumentError) as caught:
        Genome(genome)
    assert [path for path, _ in caught.value.problems] == ["body/graph"] * 2
    first, second = (message for _, message in caught.value.problems)
    assert "'arm', 0.05 to 0.1" in first and "'arm.mirror', 0.05 to 0.1" in second
    arm["joint"] = {"type": "slide", "axis": [1, 0, 0], "limits": [-0.1, 0.2]}
    assert [joint.limits for joint in Genome(genome).body.joints] == [(-0.05, 0.1)] * 2


# -- what a task allows -----------------------------------------------------------------------------------------------


def run(genome: dict[str, Any], **changes: Any) -> Result:
    """Returns the outcome of the one episode of a task that bounds nothing but what `changes` say."""
    evaluation = evaluate(Genome(genome), Task({**DASH, **changes}))
    assert evaluation.error is None, evaluation.error
    (result,) = evaluation.results
    return result


def drive(speed: float, effort: float) -> dict[str, Any]:
    """A motor that aims at a velocity."""
    return {"mode": "velocity", "range": [-speed, speed], "max_effort": effort}


def brain(amplitude: float = 0.0, **oscillator: float) -> dict[str, Any]:
    """A brain of one oscillator; without amplitude it says 1 all the time."""
    offset = 0.0 if amplitude else 1.0
    return {"kind": "sine", "oscillators": [{"motor": "j", "amplitude": amplitude, "offset": offset, **oscillator}]}


MONSTER = pair(limits=[-0.5, 0.5], motor=drive(1000, 1e6), brain=brain())


@pytest.mark.parametrize("name", Task.names())
def test_no_task_takes_a_motor_beyond_all_measure(name: str) -> None:
    evaluation = evaluate(Genome(MONSTER), Task.load(name))
    assert evaluation.score is None and not evaluation.results
    assert "the motor of joint 'j' has an effort of 50968.4, at most 10 is allowed" in (evaluation.error or "")


@pytest.mark.parametrize(
    ("limits", "genome", "words"),
    [
        ({"density": 10}, pair(mass=10.01), "cube 'a' has 10.01 kg/m^3, at most 10 are allowed"),
        ({"neighbours": 4}, "light", "joint 'j' joins masses of 1 to 5, at most 1 to 4 are allowed"),
        ({"effort": 1}, pair(motor=drive(1, 20)), "joint 'j' has an effort of 1.01937, at most 1 is allowed"),
        ({"restitution": 0.5}, "ball", "cube 'b' has a restitution of 0.6, at most 0.5 is allowed"),
        # The arm of a hinge is the body's longest edge, here 2 m.
        ({"effort": 1}, pair("hinge", motor=drive(1, 40)), "joint 'j' has an effort of 1.01937, at most 1 is allowed"),
    ],
)
def test_bodies_that_could_not_be_built_are_refused(limits: dict[str, float], genome: Any, words: str) -> None:
    if genome == "light":
        genome = pair(mass=5)
        genome["body"]["cubes"][1]["mass"] = 1
    if genome == "ball":
        genome = pair()
        genome["body"]["cubes"][1]["restitution"] = 0.6
    evaluation = evaluate(Genome(genome), Task({**DASH, "limits": limits}))
    assert words in (evaluation.error or "") and not evaluation.results
    ((name, limit),) = limits.items()
    assert evaluate(Genome(genome), Task({**DASH, "limits": {name: 1.3 * limit}})).error is None


@pytest.mark.parametrize(
    ("objective", "limits"),
    [("energy", {"energy": 10}), ('max.cube("b").speed', {"speed": 1}), ("time", {"spin": 1})],
)
def test_beyond_a_limit_an_episode_ends_and_is_scored_as_it_was_before(
    objective: str, limits: dict[str, float], tmp_path: Path
) -> None:
    kind = "hinge" if "spin" in limits else "slide"
    genome, weightless = pair(kind, motor=drive(20, 2), brain=brain()), {"world": {"gravity": [0, 0, 0]}}
    free = run(genome, objective=objective, **weightless)
    bounded = run(genome, objective=objective, limits=limits, **weightless)
    ((name, limit),) = limits.items()
    assert free.score is not None and bounded.score is not None and free.ended is None
    assert bounded.ended == name and 0 < bounded.ticks < 120
    # It would have been beyond at the next tick: the episode ended neither late nor early.
    later = run(genome, objective=objective, duration=(bounded.ticks + 1) / 60, **weightless)
    assert later.score is not None
    if name != "spin":
        assert bounded.score <= limit < later.score < free.score
    shorter = run(genome, objective=objective, duration=bounded.ticks / 60, limits=limits, **weightless)
    assert shorter.ended is None and shorter.score == bounded.score
    task = Task({**DASH, "objective": objective, "limits": limits, **weightless})
    (path,) = evaluate(Genome(genome), task, record=tmp_path).recordings
    assert prove(path).result == bounded


def test_an_end_is_looked_at_at_every_tick_and_its_tick_counts() -> None:
    ends = [{"name": "later", "when": "time > 0.4"}, {"name": "here", "when": "time > 0.39"}]
    result = run(snake(), objective="time", ends=ends)
    assert (result.ended, result.ticks, result.score) == ("here", 24, 0.4)


# -- rest -------------------------------------------------------------------------------------------------------------


def pendulum(damping: float) -> dict[str, Any]:
    """A cube that hangs, at first too high, in a spring above another: it swings by half a metre."""
    genome = pair(axis=[0, 1, 0], stiffness=10, damping=damping)
    genome["body"]["cubes"] = [
        {"id": "a", "size": 1, "mass": 10, "position": [0, 0.5, 0]},
        {"id": "b", "size": 0.5, "mass": 1, "position": [0, 2.0, 0]},
    ]
    return genome


def test_a_creature_that_does_not_come_to_rest_has_no_score_and_a_proof_says_so_too(tmp_path: Path) -> None:
    ball = pair("fixed")
    for cube in ball["body"]["cubes"]:
        cube["restitution"] = 1
    for genome, changes in ((pendulum(0), {}), (ball, {"vary": {"drop": [1, 1]}}), (pendulum(6), {"settle_limit": 1})):
        task = Task({**DASH, **changes})
        (result,) = (evaluation := evaluate(Genome(genome), task, record=tmp_path)).results
        assert result.score is None and result.ticks == 0
        limit = task.document["settle_limit"]
        assert (result.fault or "").startswith(f"restless: not yet at rest after {limit:g} s: a corner moved at ")
        assert prove(evaluation.recordings[0]).result == result


def test_settling_goes_on_until_the_creature_is_at_rest(tmp_path: Path) -> None:
    genome, task = Genome(pendulum(6)), Task({**DASH, "objective": 'abs(cube("b").displacement.y)'})
    (result,) = (evaluation := evaluate(genome, task, record=tmp_path)).results
    assert result.fault is None and result.ticks == 120
    assert result.score is not None and result.score < 0.05  # of half a metre
    assert prove(evaluation.recordings[0]).result == result


# -- energy -----------------------------------------------------------------------------------------------------------


def test_energy_that_no_motor_gave_is_worth_nothing(tmp_path: Path) -> None:
    """A plate is hurled against the limits of its slide ten times a second: the solver flings the whole body 14 m."""
    genome = pair(limits=[-0.24, 0.24], motor=drive(118, 2000), brain=brain(10.0, frequency=5))
    genome["body"]["cubes"][1]["mass"] = 0.05
    (result,) = (evaluation := evaluate(Genome(genome), Task(DASH), record=tmp_path)).results
    assert result.distance > 5 and result.score is None
    assert (result.fault or "").startswith("energy: by 0.10 s the body had 558 J that its motors did not give it")
    assert prove(evaluation.recordings[0]).result == result


@pytest.mark.parametrize("backend", ["mujoco", "pymunk"])
@pytest.mark.parametrize("kind", ["hinge", "slide"])
def test_the_energy_of_springs_and_falls_is_a_bodys_own(backend: str, kind: str) -> None:
    """A motor winds up a spring against gravity and lets it go, again and again."""
    motor = drive(4, 60) if kind == "slide" else {"mode": "position", "range": [-1, 1], "max_effort": 30}
    genome = pair(kind, stiffness=40, motor=motor, brain=brain(1.0, frequency=2))
    result = run(genome, world={"backend": backend})
    assert result.fault is None and result.energy > 10


def test_who_was_built_beside_the_origin_begins_at_it_all_the_same() -> None:
    genome = snake(None)
    for thing in genome["body"]["cubes"] + genome["body"]["joints"]:
        name = "position" if "position" in thing else "anchor"
        thing[name] = [thing[name][0] + 30, thing[name][1], thing[name][2] - 7]
    for axis in "xz":
        result = run(genome, objective=f"start.position.{axis}", duration=0.1)
        assert result.score is not None and abs(result.score) < 0.01


# -- doing nothing ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", Task.names())
def test_a_creature_that_does_nothing_scores_exactly_nothing(name: str) -> None:
    block = {"id": "a", "size": [0.6, 0.3, 0.4], "mass": 10, "position": [0, 0.15, 0]}
    tall = {"id": "a", "size": [0.2, 1.9, 0.2], "mass": 10, "position": [0, 0.95, 0]}
    edge = {"id": "a", "size": 0.4, "mass": 10, "position": [0, 0.283, 0], "rotation": [0, 0, 0.785398]}
    for cube in (block, tall, edge, {**edge, "friction": 0, "restitution": 0.5}):
        genome = {"format": "nmes-genome/1", "name": "still", "body": {"cubes": [cube]}}
        evaluation = evaluate(Genome(genome), Task.load(name), seeds=[1])
        scores = {result.score for result in evaluation.results}
        assert evaluation.error is not None or scores <= {0.0, None}
        refused = name in ("growth", "injury")  # it is too large for a newborn, and has no limb to lose
        assert cube is not block or scores == (set() if refused else {0.0})
