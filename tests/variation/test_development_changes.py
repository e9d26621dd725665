"""Children of genomes that develop: what is later stays later, and rules go along with the body."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from functools import cache
from itertools import count, islice
from typing import Any

import orjson
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from creatures import SINE, snake
from nmes import World
from nmes.errors import VariationError
from nmes.genome import Genome
from nmes.genome.development import deeds
from nmes.genome.limits import Limits
from nmes.variation import KINDS, Draw, Requirements, cross, mutate, random_genome
from nmes.variation.development_changes import carry_over_development
from nmes.variation.distance import distance
from random_bodies import valid_genomes

Json = dict[str, Any]

NEEDS = Requirements(Limits(cubes=40, mass=400.0), development=True, senses=("touch", "range"))
GRAPH: Json = {
    "root": "trunk",
    "parts": [
        {"id": "trunk", "size": [0.4, 0.1, 0.2], "recursive_limit": 3, "joint": {"type": "hinge"}},
        {"id": "leg", "size": [0.2, 0.05, 0.05], "recursive_limit": 3, "joint": {"type": "hinge"}},
    ],
    "connections": [
        {"from": "trunk", "to": "trunk", "face": "+x"},
        {"from": "trunk", "to": "leg", "face": "+z", "mirror": "z"},
    ],
}


@cache
def founders() -> list[Genome]:
    """Returns genomes without rules: those that ship, and random ones."""
    random = (Genome(document) for _, document in islice(valid_genomes(count(7_100), Counter()), 8))
    return [*map(Genome.load, Genome.names()), *random]


def tried(parent: Genome, draw: Draw, kind: str | None, needs: Requirements = NEEDS) -> Genome | None:
    try:
        return mutate(parent, draw, kind=kind, requirements=needs).genome
    except VariationError as error:
        assert error.code == "no_offspring"
        return None


def developing(document: Json, *rules: Json, later: tuple[str, ...] = ()) -> Json:
    return {**document, "later": list(later), "development": list(rules)}


def carried(document: Json, body: Json) -> Json:
    """Returns a document whose body has become another, with what is left of its development."""
    changed = {**document, "body": body}
    bare = {name: value for name, value in changed.items() if name not in ("later", "development", "brain")}
    carry_over_development(changed, Genome(bare).body)
    return changed


def require_good_child(parent: Genome, child: Genome, kind: str | None) -> None:
    read = Genome.parse(orjson.dumps(child.document))  # as from a file
    assert read.hash == child.hash and NEEDS.check(read.body) == []
    if "brain" in read.document:
        assert read.brain().outputs == read.body.outputs
    document, before = child.document, parent.document
    assert document.get("later", [""]) and document.get("development", [""]), "an empty list is left"
    if kind in (None, "development"):
        return
    # Another kind decides nothing about what is later, nor about rules: it takes away only what no longer fits.
    cubes = {cube.id for cube in child.body.cubes}
    kept = [name for name in parent.body.later if name in cubes]
    assert list(child.body.later[: len(kept)]) == kept
    new = set(child.body.later) - {*kept}
    moves = ("move-part", "recursion", "symmetry", "cross")  # what then hangs on a later part is later, too
    assert not new & {cube.id for cube in parent.body.born.cubes} or kind in moves
    conditions = [rule["when"] for rule in before.get("development", ())]
    left = iter(conditions)
    assert all(rule["when"] in left for rule in document.get("development", ())), "rules came, or changed places"
    if child.body.cubes == parent.body.cubes and child.body.sensors == parent.body.sensors:
        assert document.get("development") == before.get("development")


@given(st.integers(0, 10**6), st.lists(st.sampled_from([None, *KINDS]), min_size=1, max_size=4))
@settings(max_examples=40)
def test_children_of_genomes_with_rules_are_good_genomes(seed: int, kinds: list[str | None]) -> None:
    descend(seed, kinds)


@pytest.mark.long
@pytest.mark.timeout(20_000)
def test_a_hundred_thousand_children_of_genomes_with_rules_are_good_genomes() -> None:
    for seed in range(25_000):
        draw = Draw(seed, "kinds")
        descend(seed, [draw.one_of((None, *KINDS)) for _ in range(4)])


def descend(seed: int, kinds: list[str | None]) -> None:
    """Gives a founder rules, and looks at a line of its descendants."""
    parent: Genome | None = Draw(seed).one_of(founders())
    for step, kind in enumerate(["development"] * 3 + kinds):
        child = None if parent is None else tried(parent, Draw(seed, step), kind)
        if child is None:
            continue
        assert parent is not None
        require_good_child(parent, child, kind)
        parent = child
    assert parent is not None
    other = Draw(seed, "other").one_of(founders())
    try:
        bred = cross(parent, other, Draw(seed, "cross"), requirements=NEEDS)
    except VariationError:
        return
    require_good_child(parent, bred, "cross")


def test_every_change_of_development_comes_about() -> None:
    parent = Genome(
        developing(
            snake(),
            {"when": "age > 2", "grow": ["c3"]},
            {"when": 'sense("j0.position") < -1', "resize": [{"part": "c2", "scale": 2}], "stage": 2},
            {"when": "age > 1.5", "enter": 2},
            later=("c3",),
        )
    )
    seen = Counter[str]()
    for number in range(300):
        child = mutate(parent, Draw(3, number), kind="development").genome
        rules, before = child.document.get("development", []), parent.document["development"]
        seen["later"] += len(child.body.later) > 1
        seen["at birth"] += not child.body.later
        if len(rules) == len(before):
            pairs = [(old, new) for old, new in zip(before, rules, strict=True) if old != new]
            seen.update(
                f"change {name}" for old, new in pairs for name in {**old, **new} if old.get(name) != new.get(name)
            )
        elif len(rules) < len(before):
            seen["remove"] += 1
        elif child.body.later == parent.body.later:
            added = next(rule for rule in rules if rule not in before)
            seen.update(f"add {name}" for name in added if name not in ("when", "every", "times", "stage"))
    wanted = {"later", "at birth", "remove", *(f"add {kind}" for kind in ("grow", "shed", "adopt", "resize", "enter"))}
    assert seen.keys() >= wanted | {f"change {name}" for name in ("when", "every", "times", "grow", "resize", "stage")}


def test_a_number_is_changed_and_no_id() -> None:
    parent = Genome(
        developing(snake(), {"when": 'has("c3") < 1 && age > 2.5 && sense("j0.position") < 1', "shed": ["c3"]})
    )
    whens = {
        mutate(parent, Draw(4, n), kind="development").genome.document.get("development", [{}])[0].get("when")
        for n in range(80)
    }
    changed = [when for when in whens - {None} if when.startswith('has("c3") < 1 && age > ')]
    assert len(changed) > 8 and all('sense("j0.position") < ' in when for when in changed)


def test_it_is_drawn_only_where_bodies_may_come_to_develop() -> None:
    def kinds(needs: Requirements) -> set[str]:
        return {mutate(Genome.load("walker"), Draw(5, n), requirements=needs).kind for n in range(80)}

    assert "development" not in kinds(Requirements()) and "development" in kinds(Requirements(development=True))


def test_a_body_of_one_cube_has_nothing_to_develop() -> None:
    cube = {"id": "cube", "size": 0.2, "mass": 1, "position": [0, 0.1, 0]}
    genome = Genome({"format": "nmes-genome/1", "name": "cube", "body": {"cubes": [cube]}})
    with pytest.raises(VariationError, match="there is nothing of that kind to change"):
        mutate(genome, Draw(1), kind="development")


def test_a_body_with_a_loop_is_never_resized() -> None:
    document = snake()
    joint = {"id": "loop", "cube1": "c0", "cube2": "c2", "type": "pin", "anchor": [0, 1, 0]}
    document["body"] = {**document["body"], "joints": [*document["body"]["joints"], joint]}
    genome = Genome(document)
    for number in range(60):
        genome = mutate(genome, Draw(6, number), kind="development").genome
        assert not any(rule.resize for rule in genome.body.development)


# -- with a body that changes -----------------------------------------------------------------------------------------


def without(document: Json, *gone: str) -> Json:
    body = document["body"]
    cubes = [cube for cube in body["cubes"] if cube["id"] not in gone]
    return {"cubes": cubes, "joints": [each for each in body["joints"] if not {each["cube1"], each["cube2"]} & {*gone}]}


def test_rules_lose_the_parts_and_sensors_that_are_gone() -> None:
    document = developing(
        snake(),
        {"when": "age > 1", "grow": ["c3"]},
        {"when": "age > 2", "grow": ["c2", "c3"], "shed": ["c3"]},
        {"when": "age > 3", "shed": ["c3"], "enter": 2},
        {"when": 'has("c3") < 1', "shed": ["c1"]},
        {"when": 'sense("j2.position") > 1', "enter": 3},
        {"when": "age > 4", "resize": [{"part": "c3", "scale": 2}, {"part": "c1", "scale": 2}]},
        later=("c3",),
    )
    assert Genome(document).body.later == ("c3",)
    child = carried(document, without(document, "c3"))
    assert "later" not in child
    assert child["development"] == [
        {"when": "age > 2", "grow": ["c2"]},
        {"when": "age > 3", "enter": 2},
        {"when": "age > 4", "resize": [{"part": "c1", "scale": 2}]},
    ]


def test_parts_and_sensors_that_rules_name_may_be_taken_away() -> None:
    rules = [{"when": f'sense("{name}.up.y") < 0', "shed": [name]} for name in ("c1", "c2", "c3")]
    sensors = [{"type": "up", "cube": name, "axis": "y"} for name in ("c1", "c2", "c3")]
    document = {**snake(None), "sensors": sensors}
    parent = Genome(developing(document, {"when": "age > 1", "grow": ["c1", "c2", "c3"]}, *rules, later=("c3",)))
    for number in range(8):
        smaller = mutate(parent, Draw(11, number), kind="remove-part").genome
        there = [cube.id for cube in smaller.body.cubes[1:]]
        assert [rule.shed for rule in smaller.body.development if rule.shed] == [(name,) for name in there]
        mutants = (mutate(parent, Draw(12, number, n), kind="sensors").genome for n in count())
        blind = next(each for each in mutants if len(each.document["sensors"]) == 2)
        assert len(blind.body.development) == 3 and blind.body.later == ("c3",)


def test_what_hangs_on_a_later_part_comes_with_it() -> None:
    document = developing(
        snake(), {"when": "age > 1", "grow": ["c2"]}, {"when": "age > 2", "shed": ["c1"]}, later=("c2",)
    )
    body = document["body"]
    document["body"] = without(document, "c3")
    Genome(document)
    child = carried(document, body)
    assert child["later"] == ["c2", "c3"]
    assert child["development"] == [{"when": "age > 1", "grow": ["c2", "c3"]}, {"when": "age > 2", "shed": ["c1"]}]


def test_parts_that_grow_of_a_graph_keep_their_rules_by_their_names() -> None:
    rules = [{"when": "age > 1", "grow": ["leg.2", "leg.2.mirror"]}, {"when": "age > 2", "shed": ["trunk.3"]}]
    later = ("leg.2", "leg.2.mirror")
    document = developing({"format": "nmes-genome/1", "name": "g", "body": {"graph": GRAPH}}, *rules, later=later)
    assert Genome(document).body.later == later
    plain = {**GRAPH, "connections": [GRAPH["connections"][0], {"from": "trunk", "to": "leg", "face": "+z"}]}
    assert carried(document, {"graph": plain})["later"] == ["leg.2"]
    short = {**GRAPH, "parts": [{**GRAPH["parts"][0], "recursive_limit": 1}, GRAPH["parts"][1]]}
    assert not {"later", "development"} & carried(document, {"graph": short}).keys()


def test_a_child_of_two_has_the_development_of_whose_body_it_has() -> None:
    first = Genome(developing(snake(), {"when": "age > 1", "grow": ["c3"]}, later=("c3",)))
    other = Genome(developing(Genome.load("walker").document, {"when": "age > 9", "shed": ["front_left_shin"]}))
    whens = {
        rule.when for n in range(30) for rule in cross(first, other, Draw(7, n)).body.development
    }  # fmt: skip
    assert whens == {"age > 1"}


# -- random creatures, distances, and what lives ----------------------------------------------------------------------


def test_random_creatures_develop_where_they_may_and_are_born_as_small_as_they_must() -> None:
    drawn = [random_genome(Draw(8, n), NEEDS, "random") for n in range(40)]
    assert 8 < sum(bool(genome.body.later) for genome in drawn) < 32

    def too_large(body: Any) -> list[str]:
        low, high = body.born.bounds
        edges = [b - a for a, b in zip(low, high, strict=True)]
        return ["it is born too large"] if len(body.born.cubes) > 2 or max(edges) > 0.5 else []

    needs = Requirements(further=too_large, development=True)
    for number in range(40):
        body = random_genome(Draw(9, number), needs, "random").body
        grown = {name for rule in body.development for name in rule.grow}
        assert len(body.born.cubes) <= 2 and grown == {*body.later}


def test_who_develops_otherwise_is_farther_away() -> None:
    plain = Genome(snake()).body
    rule = {"when": "age > 1", "grow": ["c3"]}
    later = Genome(developing(snake(), rule, later=("c3",))).body
    sheds = Genome(developing(snake(), rule, {"when": "age > 2", "shed": ["c1"]}, later=("c3",))).body
    assert distance(later, later) == 0.0 < distance(later, sheds) < distance(plain, sheds)


def test_a_part_that_became_later_grows_in_a_world() -> None:
    parent = Genome({**snake(), "brain": SINE})
    children = (mutate(parent, Draw(10, n), kind="development").genome for n in count())
    child = next(each for each in children if each.body.later)
    (rule,) = child.body.development
    world = World({"mode": "lockstep", "gravity": [0, 0, 0]})
    client = world.join()
    spawn = {"type": "spawn_creature", "genome": child.document, "name": "s", "position": [0, 2, 0], "autonomous": True}
    assert world.execute(client, spawn)["type"] != "error"
    assert {*world.creature("s").cubes} == {cube.id for cube in child.body.born.cubes}
    world.execute(client, {"type": "step", "ticks": round((float(rule.when.removeprefix("age > ")) + 0.2) * 60)})
    assert {*world.creature("s").cubes} == {cube.id for cube in child.body.cubes} and world.fault is None


# -- the same children ------------------------------------------------------------------------------------------------

DEVELOPING = """
from nmes.genome import Genome
from nmes.variation import Draw, Requirements, cross, mutate, random_genome
needs = Requirements(development=True)
for name in ("walker", "centipede", "roller", "lurcher"):
    genome = Genome.load(name)
    for number in range(16):
        genome = mutate(genome, Draw(11, number), kind=("development", None)[number % 2], requirements=needs).genome
    print(genome.hash, cross(genome, Genome.load("seeker"), Draw(12)).hash, random_genome(Draw(13), needs, "r").hash)
"""
PLAIN = """
from hashlib import sha256
from nmes.errors import VariationError
from nmes.evaluation import Task
from nmes.genome import Genome
from nmes.variation import Draw, cross, mutate, random_genome
kinds = ["add-part", "remove-part", "resize-part", "move-part", "joint", "limits", "axis", "motor", "symmetry"]
kinds += ["recursion", "sensors", "weights", "oscillators", "topology", "voices", "shape", None, None, None]
seen = sha256()
for task in ("walk", "swim"):
    needs = Task.load(task).requirements
    for name in ("walker", "centipede", "roller", "seeker", "tumbler"):
        genome, other = Genome.load(name), Genome.load("centipede" if name == "walker" else "walker")
        for number, kind in enumerate(kinds):
            try:
                child = mutate(genome, Draw(22, task, number), kind=kind, requirements=needs).genome
                seen.update(child.hash.encode())
            except VariationError as error:
                seen.update(error.message.encode())
        seen.update(cross(genome, other, Draw(22, task), requirements=needs).hash.encode())
        seen.update(random_genome(Draw(22, name), needs, "random").hash.encode())
print(seen.hexdigest())
"""


def printed(program: str, seed: str) -> list[str]:
    environment = {**os.environ, "PYTHONHASHSEED": seed}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, check=True, text=True)
    return done.stdout.split()


def test_children_that_develop_are_the_same_in_fresh_processes() -> None:
    assert printed(DEVELOPING, "1") == printed(DEVELOPING, "2")


def test_children_of_those_who_do_not_develop_are_what_they_were() -> None:
    """Runs of evolution are asked again by those who verify them: what came before there were rules comes still."""
    assert printed(PLAIN, "3") == ["2bfb77371e8843bf5c9fefff9c7294914cafc254bee8ab21e8ce8d33e936125f"]


def test_what_a_rule_does_is_told_in_words() -> None:
    rule = {"when": "age > 1", "shed": ["a"], "grow": ["b", "c"], "resize": [{"part": "d", "scale": 1.5}], "enter": 2}
    assert deeds(rule) == "shed a; grow b, c; resize d to 1.5 times its size; enter stage 2"
