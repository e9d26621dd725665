"""`nmes genome check` tells everything that is wrong with a genome at once, and nothing that only follows from it."""

from __future__ import annotations

import json
import random
from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from nmes.cli import main
from nmes.errors import DocumentError
from nmes.genome import Genome


def check(path: Path, document: Any) -> list[tuple[str, str]]:
    """Checks a document in a file; returns the place and message of each problem."""
    path.write_text(json.dumps(document))
    done = CliRunner().invoke(main, ["genome", "check", str(path), "--json"])
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    (row,) = json.loads(done.stdout)
    assert done.exit_code == (1 if row["problems"] else 0)
    return [(problem["path"], problem["message"]) for problem in row["problems"]]


def document_of(name: str) -> dict[str, Any]:
    return Genome.load(name).document


def test_independent_faults_of_all_parts_are_told_in_one_run(tmp_path: Path) -> None:
    document = document_of("walker")
    body, brain = document["body"], document["brain"]
    body["cubes"][1]["frction"] = 1
    body["cubes"][2]["position"][1] -= 1
    body["joints"][3]["motor"]["max_effort"] = -1
    body["joints"][4]["cube1"] = "trso"
    document["sensors"] = [{"type": "hight", "cube": "torso"}, {"type": "touch", "cube": "tors"}]
    brain["oscillators"][0]["motor"] = "front_*_hips"
    brain["convergnce"] = 1
    brain["links"][0]["weight"] = 1e9
    found = dict(check(tmp_path / "x.json", document))
    assert set(found) == {
        "body/cubes/1/frction",
        "body/cubes/2/position",
        "body/joints/3/motor/max_effort",
        "body/joints/4/cube1",
        "sensors/0/type",
        "sensors/1/cube",
        "brain/oscillators/0/motor",
        "brain/convergnce",
        "brain/links/0/weight",
    }
    assert found["body/cubes/1/frction"].endswith("did you mean friction?")
    assert found["body/joints/4/cube1"].endswith("did you mean torso?")
    assert found["sensors/1/cube"].endswith("did you mean torso?")


def test_a_fault_of_a_graph_does_not_hide_one_of_the_brain(tmp_path: Path) -> None:
    document = document_of("centipede")
    document["body"]["graph"]["parts"][0]["mas"] = 1
    document["brain"]["convergnce"] = 1
    places = [place for place, _ in check(tmp_path / "x.json", document)]
    assert places == ["body/graph/parts/0/mas", "brain/convergnce"]


def test_an_oscillator_that_fits_no_motor_is_not_told_again_at_each_link_to_its_motors(tmp_path: Path) -> None:
    document = document_of("walker")
    document["brain"]["oscillators"][0]["motor"] = "front_*_hipx"
    ((place, message),) = check(tmp_path / "x.json", document)
    assert place == "brain/oscillators/0/motor" and "no motor 'front_*_hipx'" in message


def test_a_link_to_a_motor_that_nothing_swings_says_so_and_names_no_other_motor(tmp_path: Path) -> None:
    document = document_of("walker")
    del document["brain"]["oscillators"][0]
    message = dict(check(tmp_path / "x.json", document))["brain/links/0/from"]
    assert message == "the motor 'front_left_hip' has no oscillator"


def test_a_misspelt_cube_is_one_problem_with_all_places_that_name_it(tmp_path: Path) -> None:
    document = document_of("walker")
    document["body"]["cubes"][0]["id"] = "torsox"
    ((place, message),) = check(tmp_path / "x.json", document)
    assert place == "body/joints/0/cube1"
    others = "body/joints/2/cube1, body/joints/4/cube1, body/joints/6/cube1"
    assert message == f"there is no cube 'torso' (nor at {others}); did you mean torsox?"


def test_what_names_a_part_that_is_itself_wrong_is_not_blamed(tmp_path: Path) -> None:
    document = document_of("walker")
    del document["body"]["cubes"][0]["mass"]
    document["body"]["cubes"][3]["color"] = "red"
    document["body"]["joints"][1]["anchor"] = "here"
    document["body"]["joints"][2]["motr"] = document["body"]["joints"][2].pop("motor")
    places = [place for place, _ in check(tmp_path / "x.json", document)]
    assert places == ["body/cubes/0/mass", "body/cubes/3/color", "body/joints/1/anchor", "body/joints/2/motr"]


def test_where_a_part_has_no_good_name_unknown_names_are_not_blamed(tmp_path: Path) -> None:
    document = document_of("walker")
    document["body"]["cubes"][3]["id"] = "a name with spaces"
    assert [place for place, _ in check(tmp_path / "x.json", document)] == ["body/cubes/3/id"]


def test_places_are_those_of_the_document_also_behind_a_part_that_is_wrong(tmp_path: Path) -> None:
    document = document_of("walker")
    del document["body"]["joints"][0]["anchor"]
    document["body"]["joints"][2]["limits"] = [1, 2]
    document["sensors"] = [{"type": "hight", "cube": "torso"}, {"type": "touch", "cube": "tors"}]
    places = [place for place, _ in check(tmp_path / "x.json", document)]
    assert places == ["body/joints/0/anchor", "sensors/0/type", "body/joints/2/limits", "sensors/1/cube"]


def test_a_link_from_a_sensor_to_an_unknown_node_is_told(tmp_path: Path) -> None:
    document = document_of("seeker")
    link = next(i for i, link in enumerate(document["brain"]["links"]) if "sensor" in link)
    document["brain"]["links"][link]["to"] = "nowhere"
    ((place, message),) = check(tmp_path / "x.json", document)
    assert place == f"brain/links/{link}/to" and "no node 'nowhere'" in message


def typos(value: Any) -> Iterator[Any]:
    """Yields copies of a document with one letter too many in a key or a text."""

    def places(part: Any, keys: tuple[Any, ...]) -> Iterator[tuple[Any, ...]]:
        for key, item in part.items() if isinstance(part, dict) else enumerate(part):
            yield (*keys, key)
            if isinstance(item, dict | list):
                yield from places(item, (*keys, key))

    for *way, last in places(value, ()):
        copied = deepcopy(value)
        part = copied
        for key in way:
            part = part[key]
        if isinstance(part[last], str):
            part[last] += "x"
            yield deepcopy(copied)
            part[last] = part[last][:-1]
        if isinstance(last, str):
            part[f"{last}x"] = part.pop(last)
            yield copied


@pytest.mark.parametrize("name", ["walker", "seeker", "centipede"])
def test_one_letter_too_many_is_at_most_three_problems(name: str) -> None:
    counts = [len(Genome.problems(document)) for document in typos(document_of(name))]
    assert len(counts) > 50 and max(counts) <= 3 and sum(counts) / len(counts) < 2


VALUES: list[Any] = [None, True, 0, -1, 1e9, "x", "", [], {}, [1, 2, 3], {"a": 1}, "torso", "*", 1e300, [[]], [{}]]


def places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Yields each container of a document with each of its keys."""
    for key, item in value.items() if isinstance(value, dict) else enumerate(value):
        yield value, key
        if isinstance(item, dict | list):
            yield from places(item)


def good(document: Any) -> bool:
    """Whether a document is a genome whose brain can be run."""
    try:
        genome = Genome(document)
        if "brain" in document:
            genome.brain()
    except DocumentError:
        return False
    return True


@pytest.mark.parametrize("name", Genome.names())
def test_a_document_has_problems_if_and_only_if_it_is_no_good_genome(name: str) -> None:
    draw = random.Random(name)
    for _ in range(40):
        document = document_of(name)
        for _ in range(draw.choice((1, 2, 5))):
            container, key = draw.choice(list(places(document)))
            match draw.randrange(4):
                case 0 | 1:
                    container[key] = draw.choice(VALUES)
                case 2:
                    del container[key]
                case _ if isinstance(container, dict):
                    container[f"{key}x"] = container.pop(key)
                case _:
                    container.append(draw.choice(VALUES))
        assert bool(Genome.problems(document)) != good(document), document


@pytest.mark.parametrize("document", [3, None, [], {}, "x", {"body": 1}, {"body": {"cubes": [1]}, "brain": []}])
def test_what_is_no_genome_at_all_has_problems(document: Any) -> None:
    assert Genome.problems(document)
