"""What two genomes differ in is told part by part."""

from __future__ import annotations

from copy import deepcopy

from nmes.evolution import Draw, differences, mutate
from nmes.genome import Genome


def test_a_genome_does_not_differ_from_itself_by_another_name_or_order() -> None:
    walker = Genome.load("walker")
    document = walker.document
    document |= {"name": "somebody else", "author": "me", "parents": [walker.hash]}
    document["body"]["cubes"][1:] = reversed(document["body"]["cubes"][1:])
    document["body"]["joints"].reverse()
    assert differences(walker, Genome(document)) == []


def test_each_difference_is_told_with_its_place() -> None:
    walker = Genome.load("walker")
    document = deepcopy(walker.document)
    document["body"]["cubes"][0]["mass"] = 7
    document["body"]["joints"][0]["motor"]["max_effort"] = 31
    document["body"]["cubes"] = [c for c in document["body"]["cubes"] if c["id"] != "rear_left_shin"]
    document["body"]["joints"] = [j for j in document["body"]["joints"] if j["cube2"] != "rear_left_shin"]
    del document["brain"]
    found = {each.path: (each.kind, each.before, each.after) for each in differences(walker, Genome(document))}
    assert found["body / cubes / torso / mass"] == ("changed", 6, 7)
    assert found["body / joints / front_left_hip / motor / max_effort"] == ("changed", 30, 31)
    assert found["body / cubes / rear_left_shin"][0] == "removed"
    assert found["body / joints / rear_left_knee"][0] == "removed"
    assert found["brain"][0] == "removed"
    assert len(found) == 5


def test_a_mutant_differs_where_it_was_changed() -> None:
    centipede = Genome.load("centipede")
    child = mutate(centipede, Draw(1), kind="add-part").genome
    paths = [each.path for each in differences(centipede, child)]
    assert any(path.startswith(("body / graph / parts / part1", "body / graph / connections / ")) for path in paths)
    back = differences(child, centipede)
    assert [each.path for each in back if each.kind != "changed"] and len(back) == len(paths)


def test_rules_are_told_apart_by_what_they_do() -> None:
    document = Genome.load("jumper").document
    rules = [{"when": "age > 1", "grow": ["foot"]}, {"when": "age > 2", "shed": ["foot"]}]
    changed = [{"when": "age > 9", "enter": 2}, {"when": "age > 3", "grow": ["foot"]}, rules[1]]
    one, other = (Genome({**document, "later": ["foot"], "development": each}) for each in (rules, changed))
    assert [(each.path, each.kind) for each in differences(one, other)] == [
        ("development / grow foot / when", "changed"),
        ("development / enter stage 2", "added"),
    ]
    plain = differences(Genome(document), one)
    assert [(each.path, each.kind) for each in plain] == [("later", "added"), ("development", "added")]
