"""Tasks with roles: which documents are such tasks, what is said of those that are not, and what a seed decides."""

from __future__ import annotations

import json
from typing import Any

import pytest

from duels import DUEL, duel, roles
from nmes.errors import DocumentError
from nmes.evaluation import MatchTask, Task
from nmes.evaluation.match_task import load_task
from nmes.genome import Genome

BALL = {"id": "ball", "size": [1, 1, 1], "mass": 1, "position": [0, 0, 5]}
WRONG: list[tuple[dict[str, Any], str]] = [
    (roles({"objective": "height"}, {}), "roles/0/objective: line 1, column 1: expected a role, found 'height': "),
    (roles({"objective": "height"}, {}), "one of red, blue goes before a quantity, as in red.height"),
    (roles({}, {"objective": "red.apart.red"}), "line 1, column 5: there is no quantity 'apart.red'; did you mean"),
    (roles({}, {"objective": "red.apart"}), "objective: line 1, column 5: apart is of several; take apart.blue"),
    (roles({}, {"objective": "blue.after_touch.red"}), "after_touch.red.z or after_touch.red.horizontal"),
    (roles({}, {"objective": "max."}), "column 5: expected a role, found the end"),
    (roles({}, {"objective": "max.red"}), "column 5: expected a role, found 'red'"),
    (roles({}, {"objective": "red.energy > 3"}), "it must give a number"),
    (roles({}, {"objective": 'red.cube("c0").energy'}), "there is energy of the whole only, not of one cube"),
    (roles({}, {"objective": 'cube("ball").height'}), "props: expressions name a prop 'ball', and there is none"),
    ({"ends": [{"name": "x", "when": "height > 1"}]}, "ends/0/when: line 1, column 1: expected a role"),
    (roles({"name": "max"}, {}), "roles/0/name: expressions have another meaning for 'max'"),
    (roles({"name": "time"}, {}), "roles/0/name: expressions have another meaning for 'time'"),
    (roles({}, {"name": "red"}), "roles/1/name: there is a role 'red' already"),
    (roles({"name": "Red"}, {}), "roles/0/name: expected a name of at most 32 small letters"),
    (roles({"target": "red"}, {}), "roles/0/target: expected another role, a prop or a point, got 'red'"),
    (roles({"target": "nobody"}, {}), "roles/0/target: expected another role, a prop or a point, got 'nobody'"),
    ({"roles": []}, "roles: expected an array of 1 to 8 roles"),
    ({"roles": [{"name": f"r{i}", "objective": "time"} for i in range(9)]}, "expected an array of 1 to 8 roles"),
    ({"objective": "red.height"}, "objective: in a task with roles each has its own: roles/0/objective"),
    ({"target": {"distance": [1, 2]}}, "target: in a task with roles each has its own: roles/0/target"),
    ({"props": [{**BALL, "position": [0, 0]}]}, "props/0/position: expected"),
    ({"props": [{key: value for key, value in BALL.items() if key != "position"}]}, "props/0/position: is missing"),
    ({"props": [{**BALL, "target": True}]}, "props/0/target: in a task with roles it is a role that names its target"),
    ({"props": [{**BALL, "hidden": True}]}, "props/0/hidden: in a task with roles no prop is a target"),
    ({"props": [{**BALL, "hinge": True}]}, "props/0/hinge: a prop does that upon a creature"),
    ({"props": [{**BALL, "lean": [0, 1]}]}, "props/0/lean: a prop does that upon a creature"),
    ({"props": [{**BALL, "id": "red"}]}, "props/0/id: in a task with roles it is small letters"),
    ({"props": [{**BALL, "id": "a b"}]}, "props/0/id: "),
    ({"props": [BALL, BALL]}, "props/1/id: there is a prop 'ball' already"),
    ({"duration": 600, "world": {"tick_rate": 240}}, "duration: makes with settle_limit episodes of 146,400 ticks"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "said"), WRONG, ids=range(len(WRONG)))
def test_a_task_with_roles_that_is_none_is_refused_with_the_place(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(DocumentError) as caught:
        duel(**changes)
    assert said in caught.value.message


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"margin": 1}, "margin: only a task with roles says this"),
        ({"interchangeable": False}, "interchangeable: only a task with roles says this"),
        ({"objective": None}, "objective: "),
    ],
    ids=str,
)
def test_what_only_matches_say_is_refused_elsewhere(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(DocumentError) as caught:
        Task({**Task.load("walk").document, **changes})
    assert said in caught.value.message


def test_a_task_for_one_creature_must_have_an_objective() -> None:
    document = {name: value for name, value in Task.load("walk").document.items() if name != "objective"}
    with pytest.raises(DocumentError, match="objective: is missing"):
        Task(document)


@pytest.mark.parametrize(("name", "said"), [("life", "neither starve nor breed"), ("roles", "nobody comes")])
def test_what_is_for_served_worlds_is_no_part_of_a_task(name: str, said: str) -> None:
    value: dict[str, Any] = {} if name == "life" else {"player": {}}
    for make in (lambda world: duel(world=world), lambda world: Task({**Task.load("walk").document, "world": world})):
        with pytest.raises(DocumentError, match=f"world/{name}: .*{said}"):
            make({name: value})


def test_a_role_has_the_limits_of_the_task_but_for_its_own() -> None:
    task = duel(limits={"cubes": 5, "mass": 10}, **roles({"limits": {"mass": 3}}, {}))
    assert (task.roles["red"].limits.cubes, task.roles["red"].limits.mass) == (5, 3)
    assert (task.roles["blue"].limits.cubes, task.roles["blue"].limits.mass) == (5, 10)
    assert task.roles["blue"].limits.friction == (0.5, 2.0)
    task = duel(limits={"friction": [1, 3]}, **roles({"limits": {"friction": [0, 4]}}, {}))
    assert [role.limits.friction for role in task.roles.values()] == [(0.0, 4.0), (1.0, 3.0)]
    with pytest.raises(DocumentError, match="roles/0/limits/friction: expected the lowest first, got 4 before 1"):
        duel(**roles({"limits": {"friction": [4, 1]}}, {}))


def test_defaults_unit_and_order_of_keys_change_no_hash_and_all_else_does() -> None:
    full = duel()
    assert MatchTask(json.loads(json.dumps(full.document, sort_keys=True))).hash == full.hash
    assert duel(unit="m").hash == full.hash
    others: list[dict[str, Any]] = [
        {"margin": 0.1},
        {"interchangeable": True},
        roles({"heading": 0.1}, {}),
        {"roles": DUEL["roles"][::-1]},
    ]
    assert len({full.hash, *(duel(**change).hash for change in others)}) == 5


def test_a_match_may_have_flaws_immovable_props_and_senses_of_its_own() -> None:
    flaws = {"motors": {"noise": 0.1}}
    task = duel(flaws=flaws, senses=["range"], props=[{**BALL, "frozen": True}])
    genomes = dict.fromkeys(task.roles, Genome.load("walker"))
    ball, *creatures = [command for command in task.entry(1, genomes) if command["type"].startswith("spawn")]
    assert ball["frozen"] and [creature["flaws"] for creature in creatures] == [flaws, flaws]
    senses = task.requirements("red").senses
    assert "range" in senses and {*senses} == {*duel().requirements("red").senses, "range"}


def test_where_roles_are_interchangeable_each_plays_each_and_who_begins_is_drawn() -> None:
    task = duel(interchangeable=True)
    sides = [task.sides(seed) for seed in range(40)]
    assert all(sorted(pair) == [(0, 1), (1, 0)] for pair in sides)
    assert 8 < sum(pair[0] == (0, 1) for pair in sides) < 32
    assert duel().sides(7) == [(0, 1)]
    part = DUEL["roles"][0]
    three = duel(
        interchangeable=True, roles=[{**part, "name": name, "target": [0, 0, 0]} for name in ("red", "a", "b")]
    )
    assert all(sorted(each) == [(0, 1, 2), (1, 2, 0), (2, 0, 1)] for each in map(three.sides, range(5)))


@pytest.mark.parametrize("name", MatchTask.names())
def test_each_shipped_match_is_complete(name: str) -> None:
    task = load_task(name)
    assert isinstance(task, MatchTask) and task.name == name and len(task.seeds) >= 3
    for role in task.roles.values():
        assert None not in [getattr(role.limits, field) for field in role.limits.__slots__]
    with pytest.raises(DocumentError, match="roles: this is a match"):
        Task.load(name)
