"""Documents of any kind: what is found under a name, what completes them, what names them, where they are wrong."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nmes.errors import DocumentError
from nmes.evaluation import Task
from nmes.genome import Genome
from nmes.protocol import COMMANDS
from nmes.schemas.documents import (
    _abridged,
    canonical_hash,
    check,
    compile_schema,
    complete,
    parse_document,
    plain,
    problems,
)

KINDS: list[tuple[Callable[[str | Path], Genome | Task], str, str]] = [
    (Genome.load, "walker", "walkr"),
    (Task.load, "walk", "wlak"),
]
"""How a kind is loaded, a name that ships, and a name that nearly does."""
JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=20,
)  # fmt: skip


@pytest.mark.parametrize(("load", "name", "wrong"), KINDS)
def test_a_file_wins_over_what_ships_under_its_name(
    load: Callable[[str | Path], Genome | Task],
    name: str,
    wrong: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shipped = load(name)
    document = {**shipped.document, "name": "mine"}
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).mkdir()
    assert load(name).hash == shipped.hash  # a folder is no document
    (tmp_path / name).rmdir()
    (tmp_path / name).write_text(json.dumps(document))
    assert load(name).name == load(Path(name)).name == "mine"
    (tmp_path / name).write_text("{")
    with pytest.raises(DocumentError, match="not strict JSON"):
        load(name)
    (tmp_path / name).unlink()
    assert load(name).hash == shipped.hash


@pytest.mark.parametrize(("load", "name", "wrong"), KINDS)
def test_what_is_nowhere_is_answered_with_the_nearest_name(
    load: Callable[[str | Path], Genome | Task], name: str, wrong: str, tmp_path: Path
) -> None:
    with pytest.raises(DocumentError, match=rf"no (genome|task) '{wrong}', nor such a file.*; did you mean {name}\?"):
        load(wrong)
    with pytest.raises(DocumentError, match=f"; there are .*{name}"):
        load(tmp_path / "xyzzy.json")
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(DocumentError, match=r"cannot read .*loop: Too many levels"):
        load(tmp_path / "loop")


def test_whole_numbers_hash_alike_with_and_without_a_fraction() -> None:
    document = {**Task.load("walk").document, "duration": 10, "settle": 1, "limits": {"mass": 5}}
    fractions = {**document, "duration": 10.0, "settle": 1.0, "limits": {"mass": 5.0}}
    assert Task(fractions).hash == Task(document).hash
    assert Task({**document, "duration": 10.5}).hash != Task(document).hash
    assert canonical_hash({"a": [1.0, {"b": -0.0}]}) == canonical_hash({"a": [1, {"b": 0}]})
    assert canonical_hash(1) != canonical_hash(True) != canonical_hash("1")


def test_whole_numbers_beyond_64_bits_hash_as_what_they_are_read_as() -> None:
    assert canonical_hash([2**64, -(2**63) - 1]) == canonical_hash([2.0**64, -(2.0**63)])
    assert canonical_hash([2**64 - 1]) != canonical_hash([2**64])
    with pytest.raises(DocumentError, match="greater than any double"):
        canonical_hash({"a": 10**400})


@given(JSON)
def test_a_hash_survives_writing_and_the_order_of_keys(value: Any) -> None:
    def turned(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: turned(item) for key, item in reversed(value.items())}
        return [turned(item) for item in value] if isinstance(value, list) else value

    again = parse_document(json.dumps(turned(value), indent=2).encode())
    assert canonical_hash(again) == canonical_hash(value)


def test_what_ships_keeps_its_hashes() -> None:
    """Leaderboards and recordings name documents by these."""
    assert Genome.load("walker").hash == "55bce2113ea04f360c5682fade7a716aeccdd33cd0ed6a6af6d91cd8de7ddd70"
    assert Task.load("walk").hash == "5bd2c6e7011f44eba4b0ae7ddd707455aaf06e6aec49b5571cb112a4c5a7ce1c"
    assert Task.load("reach").hash == "67936d3dae572224b7a13950aa31360a12523af0fca1b4034a9b20e07ad87806"


def test_completing_fills_every_level_and_leaves_the_document_alone() -> None:
    config = compile_schema("world_config.json")
    document = {"seed": 7.0, "scene": {"obstacles": [{"type": "box"}, {"type": "wall", "length": 1, "width": 1}]}}
    document["scene"]["obstacles"][1]["height"] = 2  # type: ignore[index]
    before = json.dumps(document)
    full = complete(config.schema, document)
    assert json.dumps(document) == before
    assert full["seed"] == 7 and type(full["seed"]) is int
    assert full["limits"] == {"cubes": 10_000, "joints": 20_000}
    box, wall = full["scene"]["obstacles"]
    assert (box["size"], box["position"]) == (1, [0, 0, 0]) and "heading" not in box
    assert wall["heading"] == 0 and "size" not in wall
    box["position"][0] = 5  # each has defaults of its own
    assert wall["position"] == [0, 0, 0] == complete(config.schema, document)["scene"]["obstacles"][0]["position"]


@pytest.mark.parametrize(
    ("scene", "problems"),
    [
        ({"heightfield": {}}, {"scene/heightfield": "only where type is heightfield"}),
        (
            {"obstacles": [{"type": "box", "width": 1}, {"type": "gap", "length": 1, "depth": 1, "heading": 1}]},
            {
                "scene/obstacles/0/width": "only where type is wall or ramp or stairs or gap",
                "scene/obstacles/1/heading": "only where type is wall or ramp or stairs",
                "scene/obstacles/1/width": "is missing; expected a number from 0.001 to 1,000 m",
            },
        ),
        ({"type": "moon", "planets": {}}, {"scene/type": None}),
    ],
)
def test_fields_that_only_some_types_have_are_named_with_their_places(
    scene: dict[str, Any], problems: dict[str, str | None]
) -> None:
    with pytest.raises(DocumentError) as caught:
        check(compile_schema("world_config.json"), {"scene": scene})
    assert dict(caught.value.problems).keys() == problems.keys()
    for path, message in caught.value.problems:
        assert problems[path] in (None, message)


def test_what_is_no_json_data_is_no_document() -> None:
    endless: list[Any] = []
    endless.append(endless)
    for value in ({"a": object()}, "\ud800", endless):
        with pytest.raises(DocumentError, match="not JSON data"):
            plain(value)
    with pytest.raises(DocumentError, match="invalid UTF-8 at byte 1"):
        parse_document(b'"\xff"')


@pytest.mark.parametrize(
    ("kind", "field", "most"),
    [("spawn_cube", "size", 3), ("spawn_cube", "rotation", 4), ("create_bone", "snake_id", 0)],
)
def test_few_items_of_an_array_that_may_be_something_else_are_looked_at(kind: str, field: str, most: int) -> None:
    schema, command = COMMANDS[kind], {"type": kind, "cube1": "a", "cube2": "b", field: [[]] * 2700}
    assert len(_abridged(schema.schema, command)[field]) == most + 1
    (problem,) = problems(schema, command)
    assert problem.keys == (field,) and "got [[],[],[]," in problem.message
