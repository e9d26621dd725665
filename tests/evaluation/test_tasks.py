"""Tasks: which documents are tasks, what is said of those that are not, and what a seed decides."""

from __future__ import annotations

import json
import math
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from layout import ROOT
from nmes.cli import main
from nmes.errors import DocumentError
from nmes.evaluation import Limits, MatchTask, Task, evaluate, prove
from nmes.evaluation.match_task import load_task
from nmes.evaluation.task import Place
from nmes.genome import Genome
from nmes.genome.body import Body, BodyCube
from nmes.objective.trajectory import ObservedBodies, Trajectory

SHIPPED = [
    "carry", "dark", "eyes", "gaps", "growth", "injury", "jump-far", "jump-high", "metamorphosis", "planar-walk",
    "pole", "reach", "rough", "stairs", "swim", "walk",
]  # fmt: skip
PLAIN: dict[str, Any] = {
    "format": "nmes-task/1", "name": "sprint", "description": "Run.", "duration": 5, "seeds": [1, 2],
    "objective": "displacement.x",
}  # fmt: skip
PROP: dict[str, Any] = {"id": "a", "size": [1, 1, 1], "mass": 1, "target": True}
HASHES = {
    "carry": "c9c34d5d0fb38cca",
    "dark": "bbc051700161c51f",
    "eyes": "ce9055a61318ee1a",
    "gaps": "6908b5d77f80d399",
    "growth": "ce8b864aeb9f0413",
    "injury": "a29e14ecd0d59518",
    "jump-far": "3274bde6c5684498",
    "jump-high": "7ac536df24ef62c0",
    "metamorphosis": "4a40de3aad8425c9",
    "planar-walk": "32c90a37b5ac04b5",
    "pole": "14a4d2cbb5837f37",
    "reach": "67936d3dae572224",
    "rough": "59274cbbbf94f284",
    "stairs": "3fde555a19498184",
    "swim": "b5770ed665fd5a7f",
    "walk": "5bd2c6e7011f44eb",
    "chase": "e8a5d2adaac88149",
    "foraging": "8dac5a80703a515b",
    "interference": "566f89d34a5ce122",
    "interference-alone": "f7e504331c25d672",
    "relay": "852bca5b210d7b76",
    "scout": "f562f500a99ef008",
    "sumo": "b3e3585a78c94fe8",
}
"""How the hash of each task begins that ships."""
PILLAR: dict[str, Any] = {"id": "a", "size": [1, 2, 1], "mass": 1, "position": [1, 0, 2]}


def block(*ids: str, mass: float = 10.0, size: float = 1.0, low: float = 0.0) -> Body:
    """A body of cubes all in one place, which is all one to a task."""
    place, turn = (0.0, low + size / 2, 0.0), (0.0, 0.0, 0.0, 1.0)
    parts = ids or ("root",)
    cubes = (BodyCube(part, (size,) * 3, mass / len(parts), place, turn, None, None, None) for part in parts)
    return Body(tuple(cubes), (), ())


def test_these_tasks_come_with_the_package() -> None:
    assert list(Task.names()) == SHIPPED
    assert {path.stem for path in (ROOT / "nmes" / "evaluation" / "tasks").glob("*.json")} == set(SHIPPED)


@pytest.mark.parametrize("name", SHIPPED)
def test_each_shipped_task_is_complete(name: str) -> None:
    task = Task.load(name)
    assert task.name == name
    assert len(task.seeds) >= 3
    assert None not in astuple(task.limits)
    configs = [task.world_config(seed) for seed in task.seeds]
    assert all((config["name"], config["mode"]) == (name, "lockstep") for config in configs)
    # Seeds make different episodes, and the same seed the same.
    episodes = [json.dumps([task.world_config(s), task.target(s), task.entry(s, {}, block())]) for s in task.seeds * 2]
    assert len(set(episodes)) == len(task.seeds)


def test_a_task_is_loaded_from_a_file_and_hashed_by_what_it_says(tmp_path: Path) -> None:
    path = tmp_path / "mine.json"
    path.write_text(json.dumps(PLAIN, indent=4))
    task = Task.load(path)
    assert (task.name, task.duration, task.ticks, task.settle_ticks) == ("sprint", 5.0, 300, 30)
    assert task.limits == Limits(friction=(0.5, 2.0))
    assert task.hash == Task(dict(reversed(PLAIN.items()))).hash
    assert task.hash != Task({**PLAIN, "duration": 6}).hash


def test_an_invalid_task_is_refused_with_all_its_mistakes(tmp_path: Path) -> None:
    document = {
        **PLAIN,
        "world": {"seed": 3, "gravity": [0, -9.81], "friction": 1},
        "duration": "long",
        "vary": {"yaw": [1, -1]},
        "objective": "heigth",
        "ends": [{"name": "up", "when": "height"}],
        "colour": 1,
    }
    with pytest.raises(DocumentError) as caught:
        Task(document)
    assert {path for path, _ in caught.value.problems} == {"duration", "colour", "world/gravity"}
    del document["colour"]
    with pytest.raises(DocumentError) as caught:
        Task({**document, "duration": 5, "world": {"seed": 3}})
    messages = dict(caught.value.problems)
    assert set(messages) == {"world/seed", "vary/yaw", "objective", "ends/0/when"}
    assert messages["objective"] == "line 1, column 1: there is no quantity 'heigth'; did you mean height?"
    assert "it must give true or false" in messages["ends/0/when"]


@pytest.mark.parametrize(
    ("changed", "place", "word"),
    [
        ({"props": [{"id": "a", "size": [1, 1, 1], "mass": 1}] * 2}, "props/1/id", "already"),
        ({"props": [{"id": "creature.a", "size": [1, 1, 1], "mass": 1}]}, "props/0/id", "creature"),
        ({"target": {"distance": [2, 1]}}, "target/distance", "the lowest first"),
        ({"target": {"distance": [1, 2]}, "props": [PROP]}, "props/0/target", "a target already"),
        ({"props": [{**PROP, "id": "b"}, PROP]}, "props/1/target", "a target already"),
        ({"props": [{**PROP, "frozen": True}]}, "props/0/frozen", "only a prop with a position"),
        ({"props": [{**PROP, "away": {"distance": [1, 2]}}]}, "props/0/away", "only a prop with a position"),
        ({"props": [{**PILLAR, "hinge": True}]}, "props/0/hinge", "upon the creature"),
        ({"props": [{**PILLAR, "lean": [0, 1]}]}, "props/0/lean", "upon the creature"),
        ({"props": [{**PILLAR, "away": {"distance": [2, 1]}}]}, "props/0/away/distance", "the lowest first"),
        ({"props": [{**PILLAR, "hidden": True}]}, "props/0/hidden", "only a target"),
        ({"senses": ["up"]}, "senses/0", "touch"),
        ({"flaws": {"motors": {"delay": 65}}}, "flaws/motors/delay", "64"),
        ({"world": {"scene": {"type": "flat", "heightfield": {}}}}, "world/scene/heightfield", "only where type is"),
        ({"seeds": [1, 1]}, "seeds", "different seeds"),
        ({"limits": {"cubes": 0}}, "limits/cubes", "from 1"),
        ({"limits": {"friction": [2, 1]}}, "limits/friction", "the lowest first"),
        ({"limits": {"friction": [0, 11]}}, "limits/friction/1", "10"),
    ],
)
def test_a_mistake_in_a_task_has_a_path(changed: dict[str, Any], place: str, word: str) -> None:
    with pytest.raises(DocumentError) as caught:
        Task({**PLAIN, **changed})
    ((path, message),) = caught.value.problems
    assert path == place and word in message


def test_a_unit_is_told_and_makes_no_other_task(tmp_path: Path) -> None:
    metres = Task({**PLAIN, "unit": "m"})
    assert (metres.unit, Task(PLAIN).unit) == ("m", "")
    assert metres.hash == Task(PLAIN).hash == Task({**PLAIN, "unit": "ft"}).hash
    assert metres.document["unit"] == "m"
    units = {name: Task.load(name).unit for name in SHIPPED}
    assert units == dict.fromkeys(SHIPPED, "m") | {"pole": "s", "reach": "", "eyes": ""}
    (tmp_path / "sprint.json").write_text(json.dumps({**PLAIN, "unit": "furlong"}))
    shown = CliRunner().invoke(main, ["tasks", str(tmp_path / "sprint.json")]).stdout
    assert "unit of scores  furlong" in shown
    for unit in ("", "m\n", "x" * 17, 3):
        with pytest.raises(DocumentError, match="a unit of 1 to 16 printable characters"):
            Task({**PLAIN, "unit": unit})


def test_an_unknown_task_is_answered_with_the_nearest_name(tmp_path: Path) -> None:
    with pytest.raises(DocumentError, match=r"no task 'wlak'.*did you mean walk"):
        Task.load("wlak")
    (tmp_path / "bad.json").write_text('{"a": 1, "a": 2}')
    with pytest.raises(DocumentError, match="not strict JSON"):
        Task.load(tmp_path / "bad.json")


def test_a_creature_is_set_down_on_the_ground_and_turned() -> None:
    task = Task({**PLAIN, "vary": {"yaw": [0.5, 0.5], "drop": [0.25, 0.25], "friction": [0.7, 0.7]}})
    body = block(low=2.0)
    spawn, turn = task.entry(1, {"name": "x"}, body)
    assert (spawn["type"], spawn["genome"], spawn["position"]) == ("spawn_creature", {"name": "x"}, [0.0, -1.75, 0.0])
    assert (turn["type"], turn["cube_name"]) == ("set_cube_state", "creature.root")
    assert turn["rotation"] == pytest.approx([0.0, math.sin(0.25), 0.0, math.cos(0.25)])
    assert task.world_config(1)["friction"] == 0.7
    assert len(Task(PLAIN).entry(1, {}, body)) == 1


def test_targets_lie_within_their_range_and_fill_it() -> None:
    task = Task(
        {**PLAIN, "target": {"distance": [3, 5], "bearing": [-0.5, 1], "height": 0.25}, "seeds": list(range(200))}
    )
    points = np.array([task.target(seed) for seed in task.seeds])
    far, bearing = np.hypot(points[:, 0], points[:, 2]), np.arctan2(-points[:, 2], points[:, 0])
    assert 3 <= far.min() < 3.1 and 4.9 < far.max() <= 5
    assert -0.5 <= bearing.min() < -0.4 and 0.9 < bearing.max() <= 1
    assert (points[:, 1] == 0.25).all()
    assert abs(np.corrcoef(far, bearing)[0, 1]) < 0.2
    assert Task(PLAIN).target(1) is None
    assert task.entry(5, {}, block())[0]["target"] == task.target(5)
    assert "target" not in Task(PLAIN).entry(5, {}, block())[0]


def test_props_stand_on_the_top_of_the_root() -> None:
    stick = {"id": "stick", "size": [0.1, 2, 0.1], "mass": 1, "hinge": True, "lean": [0.3, 0.3]}
    task = Task({**PLAIN, "props": [stick, {"id": "cargo", "size": [0.2, 0.2, 0.2], "mass": 2}]})
    state = np.array([5.0, 1.0, 2.0, 0.0, 0.0, math.sin(math.pi / 8), math.cos(math.pi / 8), *[0.0] * 6])
    pole, joint, cargo = task.props(1, block(), state)
    top = 1.0 + math.sqrt(2) / 2  # of a cube that stands on its edge
    assert (joint["type"], joint["cube1"], joint["cube2"]) == ("create_joint", "creature.root", "stick")
    assert joint["position"] == pytest.approx([5.0, top, 2.0])
    assert pole["position"] == pytest.approx([5.0 - math.sin(0.3), top + math.cos(0.3), 2.0])
    assert cargo["position"] == pytest.approx([5.0, top + 0.1, 2.0], abs=0.002)
    assert cargo["position"][1] > top + 0.1


def test_props_with_a_position_stand_in_the_world_where_the_seed_draws_them() -> None:
    away = {"distance": [2, 4], "bearing": [-1, 1]}
    task = Task({**PLAIN, "props": [PILLAR, {**PILLAR, "id": "b", "frozen": True, "away": away}]})
    root = np.array([0, 0.5, 0, 0, 0, 0, 1.0])
    (still, moved), (_, other) = (task.props(seed, block(), root) for seed in (1, 2))
    assert still["position"] == [1, 1, 2] and "frozen" not in still and moved["frozen"]
    x, y, z = moved["position"]
    assert 2 <= math.hypot(x - 1, z - 2) <= 4 and abs(math.atan2(2 - z, x - 1)) <= 1 and y == 1
    assert other["position"] != moved["position"]
    aside = task.props(1, block(), root, Place("two", z=10))
    assert aside[0]["cube_name"] == "two.a" and aside[0]["position"] == [1, 1, 12]
    seen, unseen = (
        Task({**PLAIN, "props": [{**PILLAR, "target": True, **hidden}]}) for hidden in ({}, {"hidden": True})
    )
    assert [seen.target(1), unseen.target(1)] == ["a", "a"]
    assert ["target" in task.entry(1, {}, block())[0] for task in (seen, unseen)] == [True, False]
    aimed = Task({**PLAIN, "props": [{**PILLAR, "position": [4, 0, 0], "target": True, "frozen": True}],
                  "objective": "distance"})  # fmt: skip
    assert evaluate(BLOCK, aimed).score == pytest.approx(math.hypot(4, 1 - 0.15), abs=0.3)


def test_of_several_creatures_each_has_its_own_scene_in_a_place_of_its_own() -> None:
    stick = {"id": "stick", "size": [0.1, 2, 0.1], "mass": 1, "hinge": True, "target": True}
    task = Task({**PLAIN, "props": [stick], "vary": {"yaw": [0.5, 0.5]}})
    place, body, state = Place("b", x=1.0, z=-2.0), block(), np.array([1.0, 0.5, -2.0, 0.0, 0.0, 0.0, 1.0, *[0.0] * 6])
    spawn, turn = task.entry(1, {}, body, place)
    assert (spawn["name"], spawn["position"], spawn["target"]) == ("b", [1.0, 0.0, -2.0], "b.stick")
    assert turn["cube_name"] == "b.root"
    pole, joint = task.props(1, body, state, place)
    assert (pole["cube_name"], joint["cube1"], joint["cube2"]) == ("b.stick", "b.root", "b.stick")
    assert task.target(1, place) == "stick"  # as expressions call it
    aimed = Task({**PLAIN, "target": {"distance": [3, 5], "bearing": [-1, 1], "height": 0.25}})
    moved, alone = np.array(aimed.target(1, place)), np.array(aimed.target(1))
    assert moved - alone == pytest.approx([1.0, 0.0, -2.0])
    # Who is alone has it where it always was, also where that is -0.0.
    level = Task({**PLAIN, "target": {"distance": [3, 3], "bearing": [0, 0], "height": 0}})
    assert str(level.target(1)) == "(3.0, 0.0, -0.0)"


def test_a_body_that_a_task_does_not_allow_is_refused_with_the_reason() -> None:
    limits = {"cubes": 2, "mass": 20, "size": 1.5}
    about = 'cube("tail").height + cube("cargo").height + cube("root").height'
    props = [{"id": "cargo", "size": [1, 1, 1], "mass": 1}]
    task = Task({**PLAIN, "limits": limits, "objective": about, "props": props})
    assert task.check(block("root", "tail")) == []
    assert task.check(block("root", "tail", "cargo", mass=21.0, size=2.0)) == [
        "the body has 3 cubes, at most 2 are allowed",
        "the body has 21 kg, at most 20 are allowed",
        "the body has 2 m from end to end, at most 1.5 are allowed",
        "the task puts a cube 'cargo' there, and the body has one of that id",
    ]
    assert task.check(block()) == ["the task is about a cube 'tail', which the body has not"]
    hat = BodyCube("tail", (0.2, 0.2, 0.2), 1.0, (0.5, 1.1, 0.5), (0.0, 0.0, 0.0, 1.0), None, None, None)
    for y, reasons in ((1.1, ["the task puts 'cargo' on the root, where the cube 'tail' is"]), (2.2, [])):
        body = Body((*block().cubes, replace(hat, position=(0.5, y, 0.5))), (), ())
        assert Task({**PLAIN, "objective": about, "props": props}).check(body) == reasons


def test_a_task_says_what_friction_cubes_may_set_and_else_there_is_a_limit_that_is_no_part_of_it() -> None:
    def with_friction(*frictions: float | None) -> Body:
        body = block(*(f"c{number}" for number in range(len(frictions))))
        return replace(body, cubes=tuple(replace(c, friction=f) for c, f in zip(body.cubes, frictions, strict=True)))

    plain, wide, none = Task(PLAIN), *(Task({**PLAIN, "limits": {"friction": f}}) for f in ([0, 10], [1, 1]))
    assert "friction" not in plain.document["limits"]
    assert len({plain.hash, wide.hash, none.hash, Task({**PLAIN, "limits": {"friction": [0.5, 2]}}).hash}) == 4
    for frictions in ((None,), (0.5, 2.0), (None, 1.0)):
        assert plain.check(with_friction(*frictions)) == []
    assert plain.check(with_friction(1.0, 0.4, 2.05)) == ["cube 'c1' has a friction of 0.4, from 0.5 to 2 is allowed"]
    assert plain.check(with_friction(0.45, 3.0)) == ["cube 'c1' has a friction of 3, from 0.5 to 2 is allowed"]
    assert wide.check(with_friction(0.0, 10.0)) == []
    assert none.check(with_friction(1.0, 1.01)) == ["cube 'c1' has a friction of 1.01, from 1 to 1 is allowed"]
    assert "limits          cubes 32" in (shown := CliRunner().invoke(main, ["tasks", "walk"]).stdout)
    assert "friction 0.5 to 2" in " ".join(shown.split())


@pytest.mark.parametrize(("name", "digest"), HASHES.items())
def test_the_tasks_that_ship_are_the_same_as_ever(name: str, digest: str) -> None:
    """By their hashes they are known to the corpus and to leaderboards: whoever means another task calls it so."""
    task = load_task(name)
    assert task.hash.startswith(digest)


def test_the_duty_factor_is_of_those_that_touch_the_ground() -> None:
    bodies = ObservedBodies(("a", "b", "c", "other"), 3, np.ones((4, 3)), np.ones(4), 60)
    trajectory = Trajectory(bodies, 8, 1, contacts=True)
    trajectory.rows = 9
    assert trajectory.duty() == 0.0
    trajectory.touches[0] = trajectory.touches[:, 1, 0] = True  # the start; b touches the body
    trajectory.touches[:, 3] = True  # not of the body
    assert trajectory.duty() == 0.0
    trajectory.touches[1:3, 0, 1] = trajectory.touches[2:8, 2, 1] = True
    assert trajectory.duty() == (2 / 8 + 6 / 8) / 2
    trajectory.rows = 5  # what comes after an end does not count
    assert trajectory.duty() == (2 / 4 + 3 / 4) / 2


def test_an_episode_ends_at_the_first_tick_at_which_a_condition_holds_or_a_limit_does_not() -> None:
    ends = [
        {"name": "high", "when": "height > 2"},
        {"name": "higher", "when": "height > 1.5"},
        {"name": "odd", "when": "height > 2"},
    ]
    task = Task({**PLAIN, "ends": ends, "limits": {"energy": 6}})
    trajectory = Trajectory(ObservedBodies(("root",), 1, np.ones((1, 3)), np.ones(1), 60), 100, 1, contacts=True)
    trajectory.states[:, 0, 1] = np.arange(101) * 0.05
    trajectory.rows = 101
    assert task.ended(trajectory, 0, 101) == (32, "higher")  # rows, the one at which it holds included
    assert task.ended(trajectory, 32, 101) == (33, "higher")
    trajectory.meter(0, np.full((101, 1), 12.5))
    assert task.ended(trajectory, 0, 101) == (29, "energy")  # rows, the one beyond the limit left out
    assert task.ended(trajectory, 0, 29) is None
    trajectory.touches[33] = True
    ends = [{"name": "touched", "when": "contacts > 0"}]
    assert Task({**PLAIN, "ends": ends}).ended(trajectory, 0, 101) == (34, "touched")
    # Of as many rows, an end was there a row before a limit; of limits energy is before speed before spin before size.
    trajectory.states[30, 0, 7:13] = 5.0
    slow, late = ([{"name": name, "when": f"time >= {row} / 60"}] for name, row in (("slow", 29), ("late", 30)))
    for ends, limits, stop in (
        (slow, {"speed": 8.0, "spin": 8.0}, (30, "slow")),
        (late, {"speed": 8.0, "spin": 8.0}, (30, "speed")),
        (late, {"spin": 8.0}, (30, "spin")),
        (late, {"spin": 8.7}, (31, "late")),
        (slow, {"energy": 6, "spin": 8.0}, (29, "energy")),
    ):
        assert Task({**PLAIN, "ends": ends, "limits": limits}).ended(trajectory, 0, 101) == stop


def test_no_body_that_is_as_large_as_may_be_is_too_large_as_it_stands() -> None:
    """Nearly all of its mass is in one corner of its box, and a speck in the other; a millimetre more ends it."""
    bodies = ObservedBodies(("root", "speck"), 2, np.ones((2, 3)), np.array([100.0, 1e-9]), 60)
    task = Task({**PLAIN, "limits": {"size": 2, "speed": 8.0}})
    for stretched, stop in ((0.0, None), (0.001, (5, "size"))):
        trajectory = Trajectory(bodies, 100, 1)
        trajectory.states[:, 1, :3] = 1.9999999
        trajectory.states[5:, 1, :3] += stretched
        trajectory.rows = 101
        assert task.ended(trajectory, 0, 101) == stop


# -- what they are worth ----------------------------------------------------------------------------------------------


def creature(cubes: list[dict[str, Any]], joint: dict[str, Any] | None = None, **oscillator: float) -> Genome:
    document: dict[str, Any] = {"format": "nmes-genome/1", "name": "it", "body": {"cubes": cubes}}
    if joint is not None:
        document["body"]["joints"] = [{"id": "j", "cube1": cubes[0]["id"], "cube2": cubes[1]["id"], **joint}]
        if "motor" in joint:
            document["brain"] = {"kind": "sine", "oscillators": [{"motor": "j", **oscillator}]}
    return Genome(document)


def cube(part: str, size: list[float], y: float, mass: float) -> dict[str, Any]:
    return {"id": part, "size": size, "mass": mass, "position": [0, y, 0]}


BLOCK = creature([cube("root", [0.6, 0.3, 0.4], 0.15, 10)])


def tower(effort: float) -> Genome:
    """A tower that throws itself over at the start."""
    motor = {"mode": "position", "range": [-1.6, 1.6], "max_effort": effort}
    return creature(
        [cube("root", [0.6, 0.1, 0.3], 0.05, 10), cube("mast", [0.1, 1.8, 0.1], 1.0, 20)],
        {"type": "hinge", "anchor": [0, 0.1, 0], "motor": motor},
        amplitude=0,
        offset=-1,
    )


HOPPER = creature(
    [cube("root", [0.5, 0.2, 0.5], 0.3, 8), cube("foot", [0.5, 0.1, 0.5], 0.05, 2)],
    {
        "type": "slide", "anchor": [0, 0.15, 0], "axis": [0, -1, 0],
        "motor": {"mode": "position", "range": [0, 0.4], "max_effort": 600},
    },
    amplitude=10,
)  # fmt: skip


PAIR = creature(
    [cube("root", [0.3, 0.2, 0.3], 0.1, 10), cube("lid", [0.3, 0.2, 0.3], 0.3, 5)],
    {"type": "fixed", "anchor": [0, 0.2, 0]},
)


@pytest.mark.parametrize("name", SHIPPED)
def test_a_creature_that_does_nothing_scores_next_to_nothing(name: str) -> None:
    evaluation = evaluate(PAIR if name in ("growth", "injury") else BLOCK, Task.load(name))
    assert evaluation.error is None
    assert [result.score for result in evaluation.results] == [0.0] * len(evaluation.results)
    assert {result.ended for result in evaluation.results} == ({"fallen"} if name == "pole" else {None})


LUNGER = creature(
    [
        {"id": "root", "size": [0.4, 0.2, 0.4], "mass": 480, "position": [-1.6, 0.21, 0]},
        {"id": "rail", "size": [3.8, 0.1, 0.4], "mass": 5, "position": [0, 0.05, 0]},
    ],
    {
        "type": "slide", "anchor": [0, 0.1, 0], "axis": [-1, 0, 0],
        "motor": {"mode": "position", "range": [-3, 3], "max_effort": 2000},
    },
    amplitude=0,
    offset=1,
)  # fmt: skip


@pytest.mark.parametrize(("name", "most"), [("walk", 0.0), ("carry", 0.1)])
def test_throwing_a_weight_along_a_rail_scores_nothing(name: str, most: float) -> None:
    evaluation = evaluate(LUNGER, Task.load(name))
    assert evaluation.error is None
    assert min(result.distance for result in evaluation.results) > 1.5  # it did
    assert max(result.score or 0.0 for result in evaluation.results) <= most


@pytest.mark.parametrize("name", ["walk", "gaps", "reach", "stairs"])
def test_falling_over_scores_nothing(name: str) -> None:
    evaluation = evaluate(tower(3000), Task.load(name))
    assert min(result.energy for result in evaluation.results) > 10  # it did
    assert min(result.distance for result in evaluation.results) > 0.3
    assert evaluation.score is not None and evaluation.score < 0.001


def test_jumping_scores_its_height_and_toppling_next_to_nothing() -> None:
    jumped, reared = (evaluate(genome, Task.load("jump-high")).score for genome in (HOPPER, tower(40)))
    assert jumped is not None and reared is not None
    assert jumped > 0.5 > 0.1 > reared
    far = [evaluate(genome, Task.load("jump-far")) for genome in (HOPPER, tower(40))]
    assert [evaluation.score for evaluation in far] == [0.0, 0.0]  # up is not far
    assert {result.ended for result in far[0].results} == {"landed"}


def blind(genome: Genome) -> Genome:
    """The same creature without its sense of a target, or of what is around it: what there was of it reads 0."""
    document = genome.document
    document["sensors"] = [
        {"id": sensor.id, "type": "spin", "cube": sensor.target, "axis": "y"} if sensor.solitary else entry
        for entry in document["sensors"]
        for sensor in Genome({**document, "sensors": [entry], "brain": {"kind": "constant"}}).body.sensors
    ]
    for sensor in document["sensors"]:
        if sensor["type"].startswith("target_"):
            sensor["id"] = f"{sensor['cube']}.{sensor['type']}.{sensor['axis']}"
            sensor["type"], sensor["axis"] = "spin", "y"
    return Genome(document)


@pytest.mark.parametrize(
    ("name", "task", "least", "most"),
    [
        ("seeker", "reach", 1.5, 0.5), ("centipede", "reach", 1.4, 0.5), ("juggler", "pole", 18.5, 1),
        ("prowler", "dark", 10, 1.5), ("moth", "eyes", 1.3, 0.1),
    ],
)  # fmt: skip
def test_a_creature_that_senses_what_a_task_is_about_does_it_and_not_without(
    name: str, task: str, least: float, most: float, tmp_path: Path
) -> None:
    genome, trial = Genome.load(name), Task.load(task)
    seeds = [*trial.seeds, *range(100, 106)]
    evaluation = evaluate(genome, trial, seeds=seeds)
    assert min(result.score or 0.0 for result in evaluation.results) >= least
    # Whoever does the same without that sense comes to next to nothing.
    unseen = evaluate(blind(genome), trial, seeds=seeds)
    assert unseen.score is not None and unseen.score < most
    # The recording holds the target, and the brain does the same with what it felt.
    (path,) = evaluate(genome, trial, seeds=seeds[2:3], record=tmp_path).recordings
    assert prove(path, brain=True).result == evaluation.results[2]


def test_the_distance_to_a_prop_follows_the_prop() -> None:
    """A block does nothing, and a stick that is hinged to it falls on its side."""
    stick = {**PROP, "size": [0.1, 0.6, 0.1], "hinge": True, "lean": [0.3, 0.3]}
    task = Task({**PLAIN, "duration": 2, "props": [stick], "objective": "start.distance - distance"})
    score = evaluate(BLOCK, task).score
    assert score is not None and score > 0.1


def test_nmes_tasks_lists_and_shows_tasks(tmp_path: Path) -> None:
    def run(*arguments: str) -> Any:
        return CliRunner().invoke(main, ["tasks", *arguments], env={"COLUMNS": "200"})

    assert [line.split()[0] for line in run().output.splitlines()[1:]] == [*SHIPPED, *MatchTask.names()]
    assert [document["name"] for document in json.loads(run("--json").output)] == [*SHIPPED, *MatchTask.names()]
    shown = run("pole").output
    pole = Task.load("pole")
    for text in (pole.objective.text, *(condition.text for _, condition in pole.ends), "drop 0 to 0.02", pole.hash):
        assert text in shown
    path = tmp_path / "mine.json"
    path.write_text(run("walk", "--json").output)
    assert Task.load(path).document == Task.load("walk").document
    assert json.loads(run(str(path), "--json").output)["name"] == "walk"
    path.write_text(json.dumps({**PLAIN, "objective": "heigth", "duration": 0}))
    refused = run(str(path))
    assert refused.exit_code == 2 and "duration: expected" in refused.output
