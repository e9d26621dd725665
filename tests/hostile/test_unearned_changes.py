"""Who changes its body, throws parts of it away or stretches it out without end scores nothing for that."""

from __future__ import annotations

from typing import Any

import pytest

from nmes.evaluation import Task, evaluate, play
from nmes.genome import Genome

Json = dict[str, Any]


def cube(name: str, size: Any, mass: float, position: list[float], **more: Any) -> Json:
    return {"id": name, "size": size, "mass": mass, "position": position, **more}


def slide(one: str, two: str, anchor: list[float], axis: list[float], speed: float, effort: float, **more: Any) -> Json:
    motor = {"mode": "velocity", "range": [-speed, speed], "max_effort": effort}
    ends = {"id": "slide", "cube1": one, "cube2": two, "type": "slide"}
    return {**ends, "anchor": anchor, "axis": axis, "motor": motor, **more}


def genome(cubes: list[Json], joints: list[Json], offset: float = 1.0, **more: Any) -> Genome:
    """Returns a creature that pushes each of its slides outwards, unless it has another brain."""
    brain = {"kind": "sine", "oscillators": [{"motor": "*", "frequency": 0, "amplitude": 0, "offset": offset}]}
    body = {"cubes": cubes, "joints": joints}
    return Genome({"format": "nmes-genome/1", "name": "cheat", "body": body, "brain": brain, **more})


def task_with(name: str, **limits: Any) -> Task:
    """Returns a task that ships with other limits: it is not by its friction that a cheat is refused here."""
    document = Task.load(name).document
    return Task({**document, "limits": {**document["limits"], **limits}, "name": f"wide-{name}"})


# -- height that is not grown -----------------------------------------------------------------------------------------


def rocket() -> Genome:
    """Returns one that grows a block under itself in the air, kicks off from it and sheds it, again and again."""
    loaded, spent = 'sense("slide.position") > 0.1', 'has("gun") < 1 && sense("root.velocity.y") < 14'
    return genome(
        [cube("root", [0.2, 0.1, 0.2], 0.5, [0, 0.35, 0]), cube("gun", [0.24, 0.3, 0.24], 2, [0, 0.15, 0])],
        [slide("gun", "root", [0, 0.3, 0], [0, 1, 0], 4, 45, limits=[0, 100])],
        sensors=[{"type": "position", "joint": "slide"}, {"type": "velocity", "cube": "root"}],
        development=[
            {"when": f'has("gun") > 0 && {loaded}', "shed": ["gun"], "times": 64, "every": 0.1},
            {"when": spent, "grow": ["gun"], "times": 64, "every": 0.1},
        ],
    )


def mast() -> Genome:
    """Returns a weight on a slide as long as one likes."""
    return genome(
        [cube("base", [0.5, 0.1, 0.5], 10, [0, 0.05, 0]), cube("top", [0.4, 0.3, 0.4], 90, [0, 0.25, 0])],
        [slide("base", "top", [0, 0.1, 0], [0, 1, 0], 10, 2943, limits=[0, 60])],
    )


def hopper(back: float) -> Genome:
    """Returns two cubes that jump; where they draw the leg in fast, that is beyond the limit of speed."""
    return genome(
        [cube("torso", [0.3, 0.3, 0.3], 5, [0, 0.25, 0]), cube("foot", [0.45, 0.1, 0.45], 1, [0, 0.05, 0])],
        [slide("foot", "torso", [0, 0.1, 0], [0, 1, 0], 60, 559.17, limits=[0, 3])],
        sensors=[{"type": "height", "cube": "torso"}],
        brain={
            "kind": "graph",
            "nodes": [
                {"id": "up", "activation": "step", "bias": -1200},
                {"id": "leg", "motor": "slide", "activation": "identity", "bias": 0.3},
            ],
            "links": [
                {"sensor": "torso.height", "to": "up", "weight": 100},
                {"from": "up", "to": "up", "weight": 1000},
                {"from": "up", "to": "leg", "weight": back},
            ],
        },
    )


def shedder() -> Genome:
    """Returns one that sheds the heavy foot it stands on, and goes on standing on it."""
    return genome(
        [cube("root", 0.24, 0.5, [0, 0.36, 0]), cube("foot", 0.24, 50, [0, 0.12, 0])],
        [slide("foot", "root", [0, 0.24, 0], [0, 1, 0], 1, 100)],
        offset=0.0,
        development=[{"when": "age >= 0", "shed": ["foot"]}],
    )


GROWTH = Task.load("growth")


@pytest.mark.parametrize(
    ("cheat", "had"),
    [(rocket(), 10.0), (mast(), 1.5), (hopper(-0.3), 5.0), (hopper(-2.0), 5.0), (shedder(), 0.2)],
    ids=["rocket", "mast", "hopper", "who-breaks-off-on-the-way-up", "shedder"],
)
def test_height_that_is_not_grown_is_worth_nothing(cheat: Genome, had: float) -> None:
    (result,) = evaluate(cheat, GROWTH, seeds=[1]).results
    assert result.fault is None and result.score == 0.0
    before = Task({**GROWTH.document, "objective": "max(0, mean.height - start.height - 0.01)"})
    (fooled,) = evaluate(cheat, before, seeds=[1]).results
    assert fooled.score is not None and fooled.score > had


def folded() -> Genome:
    """Returns a mast up, down and up again that fits a size of 4 m, until it makes the part that goes down smaller."""

    def fixed(one: str, two: str, anchor: list[float]) -> Json:
        return {"id": f"to_{two}", "cube1": one, "cube2": two, "type": "fixed", "anchor": anchor}

    foot = {"id": "slide", "cube1": "root", "cube2": "foot", "type": "hinge", "anchor": [0.22, 0.05, 0]}
    motor = {"mode": "position", "range": [-0.1, 0.1], "max_effort": 0.5}
    return genome(
        [
            cube("root", [0.44, 0.1, 0.48], 4, [0, 0.05, 0]),
            cube("foot", [0.04, 0.04, 0.04], 0.3, [0.24, 0.05, 0]),
            cube("up", [0.1, 3.7, 0.1], 2.5, [0, 1.95, 0]),
            cube("down", [0.1, 3.65, 0.1], 40, [0.1, 1.975, 0]),
            cube("again", [0.1, 3.65, 0.1], 3, [0.2, 1.975, 0]),
            cube("top", [0.38, 0.1, 0.38], 280, [0.075, 3.85, 0]),
        ],
        [
            {**foot, "axis": [0, 0, 1], "motor": motor},
            fixed("root", "up", [0, 0.1, 0]),
            fixed("up", "down", [0.05, 3.8, 0]),
            fixed("down", "again", [0.15, 0.15, 0]),
            fixed("again", "top", [0.2, 3.8, 0]),
        ],
        later=["up", "down", "again", "top"],
        development=[
            {"when": "true", "grow": ["up", "down"], "resize": [{"part": "down", "scale": 0.25}]},
            {"when": "true", "grow": ["again", "top"]},
        ],
    )


def test_a_body_that_resizing_unfolds_beyond_its_size_has_not_grown() -> None:
    (result,) = evaluate(folded(), GROWTH, seeds=[1]).results
    assert (result.ended, result.score, result.fault) == ("size", 0.0, None)
    (free,) = evaluate(folded(), task_with("growth", size=8), seeds=[1]).results
    assert free.ended is None and free.score is not None and free.score > 4.0


def test_who_breaks_off_early_has_grown_for_no_longer() -> None:
    """After five seconds it grows what is too heavy for its limit of energy, when it has grown and it is no higher."""
    beanstalk = Genome.load("beanstalk").document
    first, second = beanstalk["development"]
    late = Genome({**beanstalk, "development": [first, {**second, "when": "age > 5"}]})
    limits = {**GROWTH.document["limits"], "energy": 1500}
    (result,) = evaluate(late, Task({**GROWTH.document, "limits": limits}), seeds=[1]).results
    grown = Task({**GROWTH.document, "limits": limits, "objective": "mean.grown - 0.01"})
    (mean,) = evaluate(late, grown, seeds=[1]).results
    assert result.ended == "energy" and 300 < result.ticks < 330
    assert result.score is not None and mean.score is not None
    assert 0.5 < result.score == pytest.approx(mean.score * result.ticks / 600)


def test_no_body_that_keeps_its_parts_has_grown() -> None:
    asked = Task({**GROWTH.document, "newborn": {}, "objective": "max.grown - min.grown + (max.height > 0.0 ? 1 : 0)"})
    for name in ("jumper", "walker"):
        assert [result.score for result in evaluate(name, asked, seeds=[1]).results] == [1.0]


# -- ways that what was shed had to give ------------------------------------------------------------------------------


def cannon(ball: Json, gun: Json, barrel: Json, away: Json) -> Genome:
    """Returns a light ball that is shot off a heavy block, which goes away then."""
    return genome(
        [ball, gun],
        [barrel],
        sensors=[{"type": "position", "joint": "slide"}],
        development=[{"when": 'sense("slide.position") > 0.3', **away}],
    )


def puck(*, shrinks: bool = False) -> Genome:
    mass, speed, effort = (200, 10, 1700) if shrinks else (450, 19.4, 5000)
    ball = cube("ball", 0.3, 5, [0, 0.15, 0], shape="sphere", friction=0)
    gun = cube("gun", [0.6, 0.8, 0.6], mass, [-0.46, 0.4, 0], friction=2)
    away = {"resize": [{"part": "gun", "scale": 0.4}]} if shrinks else {"shed": ["gun"]}
    return cannon(ball, gun, slide("gun", "ball", [0, 0.15, 0], [1, 0, 0], speed, effort), away)


def missile() -> Genome:
    ball = cube("ball", [0.3, 0.1, 0.3], 5, [0, 1.36, 0], friction=0.3)
    gun = cube("gun", [0.26, 1.3, 0.26], 120, [0, 0.65, 0], friction=2)
    return cannon(ball, gun, slide("gun", "ball", [0, 1.36, 0], [0.98, 0.199, 0], 19.4, 10000), {"shed": ["gun"]})


@pytest.mark.parametrize(
    ("name", "cheat"),
    [("injury", puck()), ("injury", puck(shrinks=True)), ("metamorphosis", missile())],
    ids=["shed", "shrunk", "in-water"],
)
def test_who_is_shot_off_what_it_sheds_has_not_come_far(name: str, cheat: Genome) -> None:
    assert evaluate(cheat, task_with(name, friction=[0, 10]), seeds=[1]).score == 0.0
    # What became small is dragged along, farther behind than a body may stretch.
    (result,) = evaluate(cheat, task_with(name, friction=[0, 10], size=1000), seeds=[1]).results
    assert result.fault is None and not result.ended
    assert result.score == 0.0
    assert 0.0 < result.distance < 25.0


def thrower(*development: Json) -> Genome:
    """Returns one that throws its foot backwards, again and again, for it has it anew in front."""
    cubes = [cube("root", [0.6, 0.2, 0.6], 10, [0, 0.1, 0]), cube("foot", [0.2, 0.1, 0.6], 10, [-0.42, 0.1, 0])]
    cubes += [cube(f"ear{at}", [0.2, 0.1, 0.05], 0.2, [0, 0.1, side]) for at, side in enumerate((-0.35, 0.35))]
    ears = [
        {"id": each["id"], "cube1": "root", "cube2": each["id"], "type": "fixed", "anchor": each["position"]}
        for each in cubes[2:]
    ]
    back = slide("root", "foot", [-0.31, 0.1, 0], [-1, 0, 0], 4, 1800, limits=[0, 1.2])
    sensors = [{"type": "velocity", "cube": "root"}]
    return genome(cubes, [back, *ears], sensors=sensors, development=[*development])


SLOW = 'sense("root.velocity.x") < 13'
OFTEN: Json = {"every": 0.1, "times": 64}
RESIZED = [
    {"when": SLOW, "stage": stage, "resize": [{"part": "foot", "scale": scale}], "enter": 3 - stage, **OFTEN}
    for stage, scale in ((1, 1.002), (1, 1.002), (2, 1), (2, 1))
]
REGROWN = [
    {"when": f'has("foot") > 0 && {SLOW}', "shed": ["foot"], **OFTEN},
    {"when": 'has("foot") < 1', "grow": ["foot"], **OFTEN},
]


@pytest.mark.parametrize("rules", [RESIZED, REGROWN], ids=["resized", "grown again"])
@pytest.mark.parametrize("name", ["injury", "metamorphosis"])
def test_who_throws_a_foot_back_and_has_it_anew_in_front_has_not_come_far(name: str, rules: list[Json]) -> None:
    assert not evaluate(thrower(*rules), name, seeds=[1, 2]).score


# -- bodies that stretch without end ----------------------------------------------------------------------------------


def gantry() -> Genome:
    """Returns one that stays where it is, and lays its heavy end upon the target along two slides."""
    cubes = [
        cube("end", [0.4, 0.2, 0.4], 250, [0, 0.1, 0], friction=0),
        cube("mid", [0.3, 0.2, 0.3], 10, [-0.5, 0.1, 0], friction=0),
        cube("base", [0.4, 0.2, 0.4], 10, [-1, 0.1, 0], friction=10),
    ]
    along = slide("base", "mid", [-1, 0.1, 0], [1, 0, 0], 10, 1324)
    across = slide("mid", "end", [-0.5, 0.1, 0], [0, 0, 1], 10, 1324)
    aims = [{"id": axis, "motor": axis, "activation": "identity", "bias": 0} for axis in "xz"]
    links = [{"sensor": f"end.target_direction.{axis}", "to": axis, "weight": 1} for axis in "xz"]
    return genome(
        cubes,
        [{**along, "id": "x"}, {**across, "id": "z"}],
        sensors=[{"type": "target_direction", "cube": "end"}],
        brain={"kind": "graph", "nodes": aims, "links": links},
    )


def harpoon() -> Genome:
    """Returns one that shoots a bar at the other, and keeps hold of it."""
    return genome(
        [cube("base", [0.6, 0.4, 0.6], 100, [0, 0.2, 0]), cube("tip", [0.1, 0.3, 1.8], 5, [0.36, 0.25, 0])],
        [slide("base", "tip", [0.3, 0.25, 0], [1, 0, 0], 19, 2000)],
    )


def test_who_stretches_farther_than_it_may_be_large_has_come_nowhere() -> None:
    evaluation = evaluate(gantry(), task_with("reach", friction=[0, 10]))
    assert [(result.ended, result.score) for result in evaluation.results] == [("size", 0.0)] * 6
    free = task_with("reach", friction=[0, 10], size=1000)
    assert (evaluate(gantry(), free, seeds=[1, 4]).score or 0.0) > 1.7  # more than the seeker has, which goes there


@pytest.mark.parametrize(("role", "other"), [("red", "blue"), ("blue", "red")])
def test_who_stretches_farther_than_it_may_be_large_has_lost_the_match(role: str, other: str) -> None:
    (match,) = play("sumo", {role: harpoon(), other: "seeker"}, seeds=[1])
    assert match.results[role].fault == "beyond: it was beyond its limit of size"
    assert match.results[role].ended == f"{role}: size" and match.results[other].score is not None
