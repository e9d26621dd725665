"""Tests of what counts as the same creature: every field of a genome either makes another one, or is known not to."""

from __future__ import annotations

import copy
from base64 import b64encode
from collections.abc import Iterator
from importlib.resources import files
from typing import Any, Final

import numpy as np
import orjson
import pytest

from boards import DASH
from creatures import SINE, mlp, seedling, snake
from ecosystems import cart
from modelled import modelled
from nmes.evaluation import Task
from nmes.evaluation.identity import creature_hash
from nmes.genome import Genome
from onnx_models import FLOAT, field, model, node, tensor, value_info

Json = dict[str, Any]

MOTOR: Final = {"mode": "position", "range": [-1, 1], "max_effort": 5, "flaws": {"noise": 0.1, "delay": 1}}
BONES: Final[Json] = {
    "cubes": [
        {"id": "a", "size": 0.3, "mass": 1, "position": [0, 2, 0]},
        {"id": "b", "size": 0.3, "mass": 1, "position": [0.5, 2, 0]},
        {"id": "c", "size": 0.3, "mass": 1, "position": [1, 2, 0]},
        {"id": "d", "size": 0.3, "mass": 1, "position": [0, 3, 0]},
    ],
    "joints": [
        {"id": "j", "cube1": "a", "cube2": "b", "type": "hinge", "anchor": [0.25, 2, 0], "motor": MOTOR},
        {"id": "k", "cube1": "b", "cube2": "c", "type": "hinge", "anchor": [0.75, 2, 0], "motor": MOTOR},
        {"id": "l", "cube1": "d", "cube2": "a", "type": "fixed", "anchor": [0, 2.5, 0]},
    ],
}
GRAPH: Final[Json] = {
    "graph": {
        "root": "a",
        "parts": [
            {"id": "a", "size": 0.3, "recursive_limit": 2, "joint": {"type": "hinge", "motor": MOTOR}},
            {"id": "b", "size": 0.2, "joint": {"type": "hinge", "limits": [-1, 1], "motor": MOTOR}},
            {"id": "c", "size": 0.1, "joint": {"type": "hinge", "motor": MOTOR}},
        ],
        "connections": [
            {"from": "a", "to": "a", "face": "+x"},
            {"from": "a", "to": "b", "face": "+y"},
            {"from": "b", "to": "c", "face": "+x"},
        ],
    }
}
RULES: Final[list[Json]] = [
    {"when": 'age > 1 && sense("a.height") > 0.5', "stage": 1, "shed": ["b"], "enter": 2, "every": 2, "times": 3},
    {"when": 'has("c") == 0', "adopt": ["c"], "grow": ["c"], "resize": [{"part": "c", "scale": 2}]},
]
SENSORS: Final[list[Json]] = [
    {"type": "height", "cube": "a"},
    {"type": "position", "joint": "j"},
    {"type": "up", "axis": "x", "cube": "a", "flaws": {"noise": 0.1}},
    {"type": "touch", "face": "+x", "cube": "b"},
    {"type": "camera", "cube": "a", "width": 4, "height": 2, "fov": 1, "colors": "grey", "range": 9},
    {"type": "range", "cube": "a", "direction": [1, 0, 0], "range": 5},
    {"type": "hear", "cube": "a", "channel": "call", "number": 1},
]
ABOUT: Final[Json] = {"format": "nmes-genome/1", "name": "x", "later": ["c"], "brain": SINE, "development": RULES}
WHOLE: Final[Json] = ABOUT | {"body": BONES, "sensors": SENSORS, "voices": [{"channel": "call", "number": 1}]}
GROWN: Final[Json] = {"format": "nmes-genome/1", "name": "x", "body": GRAPH, "brain": SINE}

# What each field becomes so that there is another creature: where in the documents above, and the new value.
BODY: Final = {
    "cubes.id": None,
    "cubes.size": ("body/cubes/0/size", 0.31),
    "cubes.shape": ("body/cubes/0/shape", "sphere"),
    "cubes.mass": ("body/cubes/0/mass", 2),
    "cubes.friction": ("body/cubes/0/friction", 0.1),
    "cubes.restitution": ("body/cubes/0/restitution", 0.1),
    "cubes.color": None,
    "cubes.group": ("body/cubes/0/group", "ghosts"),
    "cubes.position": ("body/cubes/2/position", [1, 2.1, 0]),
    "cubes.rotation": ("body/cubes/0/rotation", [0, 0, 0.1]),
    "joints.id": None,
    "joints.cube1": ("body/joints/1/cube1", "a"),
    "joints.cube2": ("body/joints/2/cube2", "b"),
    "joints.type": ("body/joints/0/type", "slide"),
    "joints.anchor": ("body/joints/0/anchor", [0.2, 2, 0]),
    "joints.axis": ("body/joints/0/axis", [0, 1, 0]),
    "joints.limits": ("body/joints/0/limits", [-1, 1]),
    "joints.stiffness": ("body/joints/0/stiffness", 1),
    "joints.damping": ("body/joints/0/damping", 1),
}
PARTS: Final = {
    "root": ("body/graph/root", "b"),
    "parts.id": None,
    "parts.size": ("body/graph/parts/0/size", 0.31),
    "parts.shape": ("body/graph/parts/0/shape", "sphere"),
    "parts.density": ("body/graph/parts/0/density", 600),
    "parts.friction": ("body/graph/parts/0/friction", 0.1),
    "parts.restitution": ("body/graph/parts/0/restitution", 0.1),
    "parts.color": None,
    "parts.group": ("body/graph/parts/0/group", "ghosts"),
    "parts.joint.type": ("body/graph/parts/1/joint/type", "slide"),
    "parts.joint.axis": ("body/graph/parts/1/joint/axis", [0, 1, 0]),
    "parts.joint.limits": ("body/graph/parts/1/joint/limits", [-1, 0.5]),
    "parts.joint.stiffness": ("body/graph/parts/1/joint/stiffness", 1),
    "parts.joint.damping": ("body/graph/parts/1/joint/damping", 1),
    "parts.recursive_limit": ("body/graph/parts/0/recursive_limit", 3),
    "connections.from": ("body/graph/connections/1/from", "b"),
    "connections.to": ("body/graph/connections/0/to", "b"),
    "connections.face": ("body/graph/connections/1/face", "-y"),
    "connections.at": ("body/graph/connections/1/at", [0.5, 0]),
    "connections.rotation": ("body/graph/connections/1/rotation", [0.5, 0, 0]),
    "connections.scale": ("body/graph/connections/1/scale", 1.1),
    "connections.mirror": ("body/graph/connections/1/mirror", "y"),
    "connections.terminal": ("body/graph/connections/1/terminal", True),
}
DRIVES: Final = {
    "mode": "velocity",
    "range": [-1, 0.5],
    "max_effort": 6,
    "flaws.noise": 0.2,
    "flaws.delay": 2,
    "flaws.drop_out": 0.1,
}
ABOVE: Final = {
    "format": None,
    "name": None,
    "author": None,
    "license": None,
    "description": None,
    "parents": None,
    "later": ("later", []),
    "development.when": ("development/0/when", 'age > 2 && sense("a.height") > 0.5'),
    "development.stage": ("development/0/stage", 2),
    "development.shed": ("development/0/shed", ["c"]),
    "development.adopt": ("development/1/adopt", ["b"]),
    "development.grow": ("development/1/grow", ["b"]),
    "development.resize.part": ("development/1/resize/0/part", "b"),
    "development.resize.scale": ("development/1/resize/0/scale", 3),
    "development.enter": ("development/0/enter", 3),
    "development.every": ("development/0/every", 3),
    "development.times": ("development/0/times", 4),
    "sensors.id": None,
    "sensors.type": ("sensors/1/type", "velocity"),
    "sensors.joint": ("sensors/1/joint", "k"),
    "sensors.cube": ("sensors/2/cube", "b"),
    "sensors.axis": ("sensors/2/axis", "y"),
    "sensors.range": ("sensors/5/range", 6),
    "sensors.face": ("sensors/3/face", "-x"),
    "sensors.direction": ("sensors/5/direction", [0, 1, 0]),
    "sensors.width": ("sensors/4/width", 3),
    "sensors.height": ("sensors/4/height", 3),
    "sensors.fov": ("sensors/4/fov", 0.5),
    "sensors.colors": ("sensors/4/colors", "rgb"),
    "sensors.flaws.noise": ("sensors/2/flaws/noise", 0.2),
    "sensors.flaws.delay": ("sensors/2/flaws/delay", 2),
    "sensors.flaws.drop_out": ("sensors/2/flaws/drop_out", 0.2),
    "sensors.channel": ("sensors/6/channel", "other"),
    "sensors.number": ("sensors/6/number", 2),
    "voices.id": None,
    "voices.channel": ("voices/0/channel", "other"),
    "voices.number": ("voices/0/number", 2),
    "brain.kind": ("brain", {"kind": "sine", "oscillators": [{"motor": "j"}]}),
}


def _drives(name: str, motor: str) -> dict[str, tuple[str, Any]]:
    return {f"{name}.{field}": (f"{motor}/{field.replace('.', '/')}", value) for field, value in DRIVES.items()}


# Every field of the schema: how it makes another creature, or None where it does not act, as names, words and colours.
FIELDS: Final[dict[str, tuple[str, Any] | None]] = {
    **ABOVE,
    **{f"body.{name}": change for name, change in BODY.items()},
    **{f"body.graph.{name}": change for name, change in PARTS.items()},
    **_drives("body.joints.motor", "body/joints/0/motor"),
    **_drives("body.graph.parts.joint.motor", "body/graph/parts/1/joint/motor"),
}


def _schema(name: str) -> Json:
    document: Json = orjson.loads((files("nmes.schemas") / name).read_bytes())
    return document


def _fields(schema: Json, document: Json, name: str = "") -> Iterator[str]:
    """Yields the names of all fields of a schema that have none below them."""
    if "$ref" in schema:
        file, _, place = schema["$ref"].partition("#/")
        document = _schema(file) if file else document
        schema = {**schema, **_found(document, place)}
        del schema["$ref"]
    if "properties" in schema:
        for key, below in schema["properties"].items():
            yield from _fields(below, document, f"{name}.{key}".lstrip("."))
    elif "properties" in schema.get("items", {}):
        yield from _fields(schema["items"], document, name)
    else:
        yield name


def _found(document: Any, place: str) -> Any:
    for key in place.split("/"):
        document = document[int(key) if isinstance(document, list) else key]
    return document


def _changed(place: str, value: Any) -> tuple[Genome, Genome]:
    """Returns a creature that has what is to be changed, and the same with the change."""
    before = copy.deepcopy(GROWN if place.startswith("body/graph") else WHOLE)
    after = copy.deepcopy(before)
    above, _, key = place.rpartition("/")
    parent: Any = _found(after, above) if above else after
    parent[int(key) if isinstance(parent, list) else key] = value
    return Genome(before), Genome(after)


def test_every_field_of_a_genome_is_known_to_act_or_not() -> None:
    schema = _schema("genome.json")
    assert sorted(_fields(schema, schema)) == sorted(FIELDS)


@pytest.mark.parametrize("field", [name for name, change in FIELDS.items() if change is not None])
def test_a_field_that_acts_makes_another_creature(field: str) -> None:
    change = FIELDS[field]
    assert change is not None
    before, after = _changed(*change)
    assert creature_hash(before) != creature_hash(after)


def _renamed(document: Json) -> Json:
    """Gives every cube, joint, sensor and voice another name; each word of JSON that is one of theirs is changed."""
    text = orjson.dumps(document).decode()
    for old, new in (("a", "trunk"), ("b", "arm"), ("c", "hand"), ("j", "shoulder"), ("k", "wrist")):
        text = text.replace(f'"{old}"', f'"{new}"').replace(f'\\"{old}', f'\\"{new}')
    renamed: Json = orjson.loads(text)
    renamed["voices"][0]["id"] = "cry"
    renamed["sensors"][1]["id"] = "bend"
    return renamed


def test_names_are_none_of_what_a_creature_does() -> None:
    renamed = Genome(_renamed(WHOLE))
    assert "hand" in renamed.body.later and 'sense("trunk.height")' in renamed.body.development[0].when
    assert creature_hash(renamed) == creature_hash(Genome(WHOLE))


@pytest.mark.parametrize(
    "when", ["age>1.0&&sense( 'a.height' )>.5", 'age > 1.0000000000001 && sense("a.height") > 5e-1']
)
def test_a_condition_that_is_written_otherwise_is_the_same(when: str) -> None:
    before, after = _changed("development/0/when", when)
    assert before.hash != after.hash and creature_hash(before) == creature_hash(after)


def test_parts_that_are_not_there_at_birth_have_no_order() -> None:
    one, other = (Genome({**WHOLE, "later": later}) for later in (["b", "c"], ["c", "b"]))
    assert one.hash != other.hash and creature_hash(one) == creature_hash(other)


@pytest.mark.parametrize("field", ["every", "times"])
def test_a_rule_that_writes_its_defaults_out_is_the_same(field: str) -> None:
    document = copy.deepcopy(WHOLE)
    document["development"][1][field] = 1
    assert creature_hash(Genome(document)) == creature_hash(Genome(WHOLE))


def test_a_group_is_not_taken_for_a_shape() -> None:
    ball, ghost = copy.deepcopy(WHOLE), copy.deepcopy(WHOLE)
    ball["body"]["cubes"][0]["shape"] = ghost["body"]["cubes"][0]["group"] = "sphere"
    assert creature_hash(Genome(ball)) != creature_hash(Genome(ghost))


# -- copies -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("field", "value"), [("restitution", 0), ("restitution", 0.0), ("friction", 0.7)])
def test_what_a_cube_writes_out_as_its_world_has_it_is_no_trait(field: str, value: float) -> None:
    task = Task({**DASH, "world": {"friction": 0.7}})
    document = copy.deepcopy(WHOLE)
    document["body"]["cubes"][0][field] = value
    assert creature_hash(Genome(document), task) == creature_hash(Genome(WHOLE), task)
    other = Task({**DASH, "vary": {"friction": [0.5, 1]}, "world": {"restitution": 0.3}})
    assert creature_hash(Genome(document), other) != creature_hash(Genome(WHOLE), other)


@pytest.mark.parametrize("kind", ["mlp", "onnx"])
def test_a_brain_that_lists_all_in_their_order_is_as_one_that_does_not(kind: str) -> None:
    document = modelled() if kind == "onnx" else snake(mlp(3), segments=3)
    brain = Genome(document).brain()
    same = {**document, "brain": {**document["brain"], "inputs": [*brain.inputs], "outputs": [*brain.outputs]}}
    other = {**document, "brain": {**same["brain"], "inputs": [*brain.inputs[::-1]]}}
    assert creature_hash(Genome(same)) == creature_hash(Genome(document)) != creature_hash(Genome(other))
    one, three = ({**other, "brain": {**other["brain"]}} for _ in range(2))
    del one["brain"]["outputs"]
    three["brain"]["outputs"] = [f"{name}*" for name in brain.outputs]
    assert creature_hash(Genome(one)) == creature_hash(Genome(three)) == creature_hash(Genome(other))


SEEDLING: Final = Genome(seedling())
WEIGHTS: Final = np.random.default_rng(0).normal(0.0, 1.0, (len(SEEDLING.body.sensors), 1))


def _model(
    x: str = "x", w: str = "w", b: str = "b", m: str = "m", s: str = "s", weights: Any = WEIGHTS, bias: float = 0.5,
    how: str = "Tanh", way: str = "raw", size: int | str = 1, nodes: tuple[bytes, ...] = (), seen: str | None = None,
    said: bytes = b"",
) -> bytes:  # fmt: skip
    """Returns a model of tanh(x . weights + bias) whose values may be called otherwise."""
    made = [*nodes, node("MatMul", [seen or x, w], [m], said), node("Add", [m, b], [s]), node(how, [s], ["y"])]
    tensors = [tensor(w, weights, way=way), tensor(b, [[bias]], way=way)]
    ends = [value_info(x, FLOAT, [size, len(weights)])], [value_info("y", FLOAT, [size, 1])]
    return model(made, tensors, *ends)


def _hash(made: bytes) -> str:
    brain = {"kind": "onnx", "model": b64encode(made).decode()}
    return creature_hash(Genome({**seedling(), "brain": brain}))


COPIES: Final = {
    "a producer": _model() + field(2, "Eve") + field(3, "1.0"),
    "words": _model() + field(6, "mine") + field(14, field(1, "by") + field(2, "Eve")),
    "names of weights": _model(w="v", b="offset"),
    "names of values": _model(x="in", m="product", s="sum"),
    "names of nodes": _model(said=field(3, "first") + field(6, "It multiplies.")),
    "the domain written out": _model(said=field(7, "ai.onnx")),
    "how numbers are stored": _model(way="packed"),
    "numbers one by one": _model(way="loose"),
    "a size left open": _model(size="batch"),
    "a node for nothing": _model(nodes=(node("Sin", ["x"], ["unused"]),)),
    "a step that does nothing": _model(nodes=(node("Identity", ["x"], ["again"]),), seen="again"),
    "less than a billionth": _model(bias=0.5 + 1e-12),
}


@pytest.mark.parametrize("made", COPIES.values(), ids=COPIES)
def test_a_model_that_computes_the_same_is_the_same_brain(made: bytes) -> None:
    assert _hash(made) == _hash(_model())


OTHERS: Final = {
    "weights": _model(weights=-WEIGHTS),
    "a bias": _model(bias=0.6),
    "another function": _model(how="Sin"),
    "another order": model(
        [node("MatMul", ["x", "w"], ["m"]), node("Sub", ["b", "m"], ["s"]), node("Tanh", ["s"], ["y"])],
        [tensor("w", WEIGHTS), tensor("b", [[0.5]])],
        [value_info("x", FLOAT, [1, len(WEIGHTS)])],
        [value_info("y", FLOAT, [1, 1])],
    ),
}


@pytest.mark.parametrize("made", OTHERS.values(), ids=OTHERS)
def test_a_model_that_computes_something_else_is_another_brain(made: bytes) -> None:
    assert _hash(made) != _hash(_model())


def test_models_whose_values_are_subtracted_the_other_way_round_are_others() -> None:
    def made(*names: str) -> bytes:
        nodes = [node("MatMul", ["x", "w"], ["m"]), node("Sub", [*names], ["y"])]
        tensors = [tensor("w", WEIGHTS), tensor("b", [[0.5]])]
        return model(nodes, tensors, [value_info("x", FLOAT, [1, len(WEIGHTS)])], [value_info("y", FLOAT, [1, 1])])

    assert _hash(made("m", "b")) != _hash(made("b", "m"))


def test_a_model_with_graphs_inside_is_known_again() -> None:
    def made(inner: str, weight: str = "w", ours: str = "Sin") -> bytes:
        def branch(how: str) -> bytes:
            nodes = field(1, node("MatMul", ["x", weight], [inner])) + field(1, node(how, [inner], [f"{inner}2"]))
            return nodes + field(2, f"of {inner}") + field(12, value_info(f"{inner}2", FLOAT, [1, 1]))

        branches = [("then_branch", branch(ours)), ("else_branch", branch("Tanh"))]
        said = b"".join(field(5, field(1, name) + field(6, each) + field(20, 5)) for name, each in branches)
        nodes = [node("If", ["yes"], ["y"], said)]
        yes = field(2, 9) + field(8, "yes") + field(9, b"\x01")  # a truth value
        ends = [value_info("x", FLOAT, [1, len(WEIGHTS)])], [value_info("y", FLOAT, [1, 1])]
        return model(nodes, [tensor(weight, WEIGHTS), yes], *ends)

    assert _hash(made("a")) == _hash(made("b")) == _hash(made("a", weight="v")) != _hash(made("a", ours="Cos"))


def test_a_long_model_is_known_again() -> None:
    def made(name: str) -> bytes:
        nodes = [node("MatMul", ["x", "w"], [f"{name}0"])]
        nodes += [node("Neg", [f"{name}{i}"], [f"{name}{i + 1}"]) for i in range(2000)]
        nodes.append(node("Tanh", [f"{name}2000"], ["y"]))
        ends = [value_info("x", FLOAT, [1, len(WEIGHTS)])], [value_info("y", FLOAT, [1, 1])]
        return model(nodes, [tensor("w", WEIGHTS)], *ends)

    assert _hash(made("a")) == _hash(made("b")) != _hash(_model())


def test_the_hash_of_a_creature_without_development_is_that_of_before_there_was_any() -> None:
    # Leaderboards and corpora keep them.
    assert creature_hash(Genome(cart())) == "fc1f44d5ad4b29fed56409cca5495ffb88208ef9e3fe08f0078072913ba6d7c9"
