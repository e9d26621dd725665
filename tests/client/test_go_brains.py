"""Brains in Go: they do what Python's do, to the last bit, and refuse what those refuse."""

from __future__ import annotations

import copy
import json
import math
import re
import struct
from base64 import b64encode
from collections.abc import Iterable, Iterator
from functools import cache
from hashlib import sha256
from typing import Any

import numpy as np
import pytest

import go_schemas
from drawn_brains import Drawn, drawn_brains
from go_programs import CLIENT, GO, go
from layout import ROOT
from nmes.brain import load_brain
from nmes.errors import DocumentError
from nmes.schemas.documents import parse_document
from onnx_models import FLOAT, INT64, field, layer, model, node, tensor, value_info

pytestmark = pytest.mark.skipif(GO is None, reason="Go is not installed: the Go client was not built and not run")

_DRAWN, _SPOILED = 1000, 600
_SINGLES, _DOUBLES = 1e-5, 1e-13  # how far controls of models may be from onnxruntime's

_PAGE = (ROOT / "docs" / "go.md").read_text()

Problems = tuple[bool, list[str]]  # whether a document was refused, and where


# -- what brains do ---------------------------------------------------------------------------------------------------


def _expected(drawn: Drawn) -> list[bytes]:
    """Returns the bits of what Python's brain does, step by step."""
    brain = load_brain(drawn.document, drawn.inputs, drawn.outputs)
    brain.reset(drawn.seed, drawn.dt)
    return [brain.step(np.array(row)).tobytes() for row in drawn.sensors]


def _of_go(lines: Iterable[str]) -> list[dict[str, Any]]:
    """Returns what the program in Go answers to each line."""
    ran = go("run", "./brain/compute", told="".join(line + "\n" for line in lines))
    assert ran.returncode == 0, ran.stderr
    return [json.loads(line, parse_int=float) for line in ran.stdout.splitlines()]  # -0 is a number of its own


@cache
def _both() -> list[tuple[Drawn, list[bytes], list[bytes]]]:
    """Returns drawn brains, what Python's do, and what Go's do."""
    brains = list(drawn_brains(_DRAWN, seed=24))
    answers = _of_go(json.dumps(brain._asdict()) for brain in brains)
    assert len(answers) == _DRAWN
    given = [[struct.pack(f"{len(row)}d", *row) for row in answer.get("controls", ())] for answer in answers]
    return [(brain, _expected(brain), bits) for brain, bits in zip(brains, given, strict=True)]


def _library() -> str:
    """Returns the digest of this machine's C library over the inputs of the client's own test."""
    digest = sha256()
    sin, cos, exp, tanh = math.sin, math.cos, math.exp, math.tanh
    for i in range(1, 5001):
        part = (i * 0x9E3779B97F4A7C15 % 2**64 >> 11) / 2.0**53
        near, far = 80.0 * part - 40.0, math.ldexp(part - 0.5, i % 200 - 30)
        values = (sin(near), cos(near), sin(far), cos(far), exp(near), exp(-(750.0 * part)), tanh(near))
        digest.update(struct.pack("<9d", *values, tanh(near / 40.0), tanh(far)))
    return digest.hexdigest()


def test_a_thousand_drawn_brains_do_the_same_to_the_last_bit() -> None:
    ported = re.search(r'digest = "(\w+)"', (CLIENT / "internal" / "elementary" / "elementary_test.go").read_text())
    assert ported is not None
    if _library() != ported[1]:
        pytest.skip("this C library rounds otherwise than the one whose functions the Go client has")
    others = [
        (number, brain.document["kind"])
        for number, (brain, wanted, given) in enumerate(_both())
        if brain.document["kind"] != "onnx" and wanted != given
    ]
    assert not others, f"{len(others)} differ: {others[:10]}"


def test_a_whole_number_of_minus_0_is_0_and_a_fraction_of_it_is_not() -> None:
    for zero in ("-0", "-0.0", "-0e0"):
        wave = f'{{"motor": "m0", "frequency": {zero}, "phase": {zero}, "offset": {zero}}}'
        text = f'{{"kind": "sine", "oscillators": [{wave}]}}'
        drawn = Drawn(parse_document(text.encode()), *_BODY, seed=0, dt=0.1, sensors=[[0.0] * 3] * 2)
        told = {"document_text": text} | {key: value for key, value in drawn._asdict().items() if key != "document"}
        (answer,) = _of_go([json.dumps(told)])
        assert [struct.pack("3d", *row) for row in answer["controls"]] == _expected(drawn), zero


def test_who_does_without_brains_and_genomes_links_no_function_of_the_notice() -> None:
    told = go("list", "-deps", ".", "./fleet")
    needed = {name for name in told.stdout.splitlines() if name.startswith("nmes")}
    assert needed == {"nmes", "nmes/fleet"}, told.stderr
    notice = (CLIENT / "NOTICE").read_text()
    folders = re.findall(r"^internal/(\w+)", notice, re.MULTILINE)
    assert set(folders) == {"elementary", "random"}
    assert all((CLIENT / "internal" / folder).is_dir() for folder in folders)


def test_models_do_nearly_what_onnxruntime_does() -> None:
    models = [(wanted, given) for brain, wanted, given in _both() if brain.document["kind"] == "onnx"]
    assert len(models) == _DRAWN // 6
    for wanted, given in models:
        theirs, ours = np.frombuffer(b"".join(wanted)), np.frombuffer(b"".join(given))
        near = _SINGLES if (theirs == theirs.astype(np.float32)).all() else _DOUBLES
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=near)


# -- what is refused --------------------------------------------------------------------------------------------------

_BODY = (["s0", "s1", "foot.contact"], ["m0", "m1", "tail"])
_TEXTS = [
    b"",
    b"[1, 2",
    b'{"kind": "sine", "kind": "sine", "oscillators": [{"motor": "*"}]}',
    b'{"kind": "sine", "oscillators": [{"motor": "*", "phase": 1e999}]}',
    b'{"kind": "sine", "oscillators": [{"motor": "*", "phase": NaN}]}',
    b'{"kind": "sine", "oscillators": [{"motor": "\\ud800"}]}',
    b'{"kind": "sine", "oscillators": [{"motor": "\xff"}]}',
    b"[" * 100_000,
    b'{"kind": "sine", "oscillators": [{"motor": "*"}], "more": ' + b"[" * 250 + b"]" * 250 + b"}",
    b'{"kind": "sine", "oscillators": [' + b'{"motor": "*"},' * 70_000 + b'{"motor": "*"}]}',
]


def _documents() -> Iterator[Any]:
    """Yields documents of which each is wrong in a way of its own."""
    one = [{"motor": "m0"}]
    yield from (None, 3, "sine", [], {}, {"kind": 3}, {"kind": "sinus"}, {"kind": "mlp"})
    for name, value in (("phase", 100.5), ("phase", -100.5), ("frequency", -0.01), ("amplitude", 10.1)):
        yield {"kind": "sine", "oscillators": [{"motor": "*", name: value}]}
    yield from ({"kind": "sine", "oscillators": part} for part in ([], [{"motor": ""}], [{"motor": "*" * 129}]))
    yield {"kind": "sine", "oscillators": [{"motor": f"m{i}"} for i in range(40)]}
    yield {"kind": "sine", "oscillators": [{"motor": "*"}] * 1025}
    yield {"kind": "sine", "oscillators": [{"motor": f"{i}*"} for i in range(257)]}
    yield {"kind": "sine", "oscillators": [{"motor": "m?"}, {"motor": "m*"}]}
    yield {"kind": "cpg", "oscillators": one, "links": [{"from": "m0", "to": "m1"}]}
    yield {"kind": "cpg", "oscillators": one, "links": [{"from": "m0", "to": "m0"}]}
    yield {
        "kind": "cpg",
        "oscillators": one,
        "feedback": [{"sensor": "s9", "motor": "m0"}, {"sensor": "s9", "motor": "m0"}],
    }
    layer = {"weights": [[1, 2, 3]] * 3, "biases": [0, 0, 0]}
    yield {"kind": "mlp", "layers": [{**layer, "weights": [[1, 2], [1], [2]]}]}
    yield {"kind": "mlp", "layers": [{**layer, "biases": [1]}, layer]}
    yield {"kind": "mlp", "layers": [layer, {"weights": [[1]] * 3, "biases": [0, 0, 0]}]}
    yield {"kind": "mlp", "inputs": ["s0"], "layers": [layer]}
    yield {"kind": "mlp", "outputs": ["m0"], "layers": [layer]}
    net = {"kind": "ctrnn", "time_constants": [1, 1, 1], "biases": [0, 0, 0]}
    square = [[0, 0, 0]] * 3
    yield {**net, "weights": [[0, 0]] * 3, "input_weights": square}
    yield {**net, "weights": square, "input_weights": [[0, 0, 0]] * 2}
    yield {**net, "time_constants": [1, 1], "biases": [0, 0], "weights": [[0, 0]] * 2, "input_weights": square[:2]}
    nodes = [{"id": "a", "motor": "m0"}, {"id": "b"}]
    yield {"kind": "graph", "nodes": [{"id": "a"}]}
    yield {"kind": "graph", "nodes": [*nodes, {"id": "a"}]}
    yield {"kind": "graph", "nodes": [{"id": "a b", "motor": "m0"}]}
    yield {"kind": "graph", "nodes": [{"id": "a\u2003b", "motor": "m0"}]}
    yield {"kind": "graph", "nodes": nodes, "links": [{"to": "a"}, {"from": "a", "sensor": "s0", "to": "a"}]}
    yield {"kind": "graph", "nodes": nodes, "links": [{"from": "a", "to": "b"}, {"from": "a", "to": "b", "weight": 2}]}
    yield {"kind": "graph", "nodes": nodes, "links": [{"from": "c", "to": "d"}, {"sensor": "x*", "to": "a"}]}
    yield {"kind": "onnx", "model": "no base64"}
    yield {"kind": "onnx", "model": "AAAA"}


def _spoiled() -> Iterator[tuple[Any, list[str], list[str]]]:
    """Yields drawn brains of which one value, anywhere, is another."""
    random = np.random.default_rng(24)
    junk: list[Any] = [None, True, -1, 0.5, 1e7, 2e9, "", "x", "*", "m0", [], {}, [1], [[1, 2]], {"motor": "m0"}]
    for brain in drawn_brains(_SPOILED, seed=25):
        document: Any = copy.deepcopy(brain.document)
        part = document
        while True:
            keys = list(part) if isinstance(part, dict) else list(range(len(part)))
            key = keys[random.integers(len(keys))]
            if not (isinstance(part[key], dict | list) and part[key]) or random.random() < 0.2:
                break
            part = part[key]
        match random.integers(4):
            case 0:
                del part[key]
            case 1 if isinstance(part, dict):
                part[str(key) + "s"] = part[key]
            case _:
                part[key] = junk[random.integers(len(junk))]
        yield document, brain.inputs, brain.outputs


def _line(text: bytes, inputs: list[str], outputs: list[str]) -> str:
    """Returns what the program in Go is told to judge a document."""
    return json.dumps({"document_text": text.decode("latin-1"), "inputs": inputs, "outputs": outputs})


def _refused(text: bytes, inputs: list[str], outputs: list[str]) -> Problems:
    """Returns whether Python refuses a document, and where something is wrong."""
    try:
        load_brain(parse_document(text), inputs, outputs, "")
    except DocumentError as error:
        return True, [path for path, _ in error.found]
    return False, []


def _compare(documents: Iterable[tuple[bytes, list[str], list[str]]]) -> int:
    """Holds Go's judgement of documents to Python's; returns how many were refused."""
    documents = list(documents)
    answers = _of_go(_line(*document) for document in documents)
    assert len(answers) == len(documents)
    for (text, inputs, outputs), answer in zip(documents, answers, strict=True):
        refused, places = _refused(text, inputs, outputs)
        problems = answer.get("problems", [])
        assert bool(problems) == refused, (text[:300], answer, places)
        assert len(problems) <= 20 and all(len(message) < 1000 for _, message in problems)
        if len(places) <= 20:  # of more, which are told is a matter of order
            assert {path for path, _ in problems} <= set(places), (text[:300], problems, places)
    return sum(1 for answer in answers if answer.get("problems"))


def test_what_python_refuses_is_refused_with_the_same_places() -> None:
    texts = [*_TEXTS, *(json.dumps(document).encode() for document in _documents())]
    assert _compare((text, *_BODY) for text in texts) == len(texts)


def test_a_document_with_one_other_value_is_judged_as_python_judges_it() -> None:
    refused = _compare((json.dumps(document).encode(), ins, outs) for document, ins, outs in _spoiled())
    assert _SPOILED // 4 < refused < _SPOILED


def _wide(*nodes: bytes) -> list[bytes]:
    """Returns a graph's nodes: those, and around them one from x to y."""
    return [*nodes, node("Identity", ["x"], ["y"])]


def _tensors(**shapes: list[int]) -> list[bytes]:
    return [tensor(name, np.ones(shape)) for name, shape in shapes.items()]


_SHAPE = "8 axes, none of them of 0"
_LONG = "takes more than 67108864 products"
_CONSTANT = "the shape of a Reshape must be constant, and of int64"
_HOSTILE: dict[str, tuple[list[bytes], list[bytes], str]] = {
    "rows of nothing": (_wide(node("MatMul", ["a", "b"], ["c"])), _tensors(a=[1 << 10, 0], b=[0, 0]), _SHAPE),
    "columns of nothing": (
        _wide(node("Gemm", ["a", "b"], ["c"], field(5, field(1, "transA") + field(3, 1)))),
        _tensors(a=[9, 9], b=[9, 0]),
        _SHAPE,
    ),
    "nine axes": (_wide(node("Add", ["a", "x"], ["c"])), _tensors(a=[1] * 9), _SHAPE),
    "nine axes of a Reshape": (
        _wide(node("Reshape", ["a", "shape"], ["c"])),
        [*_tensors(a=[1]), tensor("shape", [1] * 9, INT64)],
        _SHAPE,
    ),
    "axes that are walked over and over": (
        _wide(*(node("Add", ["a", "b"], [f"c{i}"]) for i in range(120))),
        _tensors(a=[1] * 7 + [1 << 16], b=[1]),
        _LONG,
    ),
    "numbers that are read over and over": (
        _wide(*(node("Clip", ["a"], [f"c{i}"]) for i in range(1025))),
        _tensors(a=[1 << 16]),
        _LONG,
    ),
    "a shape that is computed": (
        _wide(node("Add", ["x", "a"], ["s"]), node("Reshape", ["x", "s"], ["c"])),
        [tensor("a", [3, 1, 1])],  # which it fits while the sensors read 0
        _CONSTANT,
    ),
    "a shape of floats": (
        _wide(
            node("Constant", [], ["s"], field(5, field(1, "value") + field(5, tensor("", [3])))),
            node("Reshape", ["x", "s"], ["c"]),
        ),
        [],
        _CONSTANT,
    ),
    "a shape that becomes another": (
        _wide(node("Add", ["x", "a"], ["s"]), node("Reshape", ["x", "s"], ["c"])),
        [tensor("s", [3], INT64), *_tensors(a=[3])],
        'there are two of "s"',
    ),
    "a Dropout in training": (
        _wide(node("Dropout", ["x", "", "a"], ["c"])),
        _tensors(a=[]),
        "draws random numbers (Dropout)",
    ),
}


def _three(nodes: list[bytes], tensors: list[bytes], shape: tuple[int, ...] = (3,)) -> dict[str, Any]:
    """Returns a document of a model from three sensors to three motors."""
    sides = [[value_info(name, FLOAT, list(shape))] for name in "xy"]
    return {"kind": "onnx", "model": b64encode(model(nodes, tensors, *sides)).decode()}


def _problem(document: dict[str, Any]) -> tuple[str, str]:
    """Returns the one problem of a document, a place and what is wrong there; nothing of one that is taken."""
    found = _of_go([_line(json.dumps(document).encode(), *_BODY)])[0].get("problems", [("", "")])
    ((place, message),) = found
    return place, message


@pytest.mark.parametrize(("nodes", "tensors", "words"), _HOSTILE.values(), ids=_HOSTILE)
def test_a_model_that_would_take_too_long_or_fail_later_is_refused(
    nodes: list[bytes], tensors: list[bytes], words: str
) -> None:
    place, message = _problem(_three(nodes, tensors))
    assert place == "model" and words in message


@pytest.mark.parametrize("shape", [(3, 0), (1, 1, 1, 1, 1, 1, 1, 1, 3)])
def test_inputs_of_a_model_have_a_shape_that_a_tensor_may_have(shape: tuple[int, ...]) -> None:
    place, message = _problem(_three(_wide(), [], shape))
    assert place == "model" and f"of its inputs, a tensor may have {_SHAPE}" in message


def test_long_names_of_a_model_are_told_in_short() -> None:
    name = "Erf" * 100_000
    ones = np.ones(3)
    for nodes, tensors in (
        (_wide(node(name, ["x"], ["c"])), []),
        (_wide(node("Abs", ["x"], [name]), node("Neg", ["x"], [name])), []),
        (_wide(node("Abs", [name], ["c"])), []),
        (_wide(), [tensor(name, ones) + field(1, 2)]),
    ):
        _, message = _problem(_three(nodes, tensors))
        assert '"ErfErfErf' in message and len(message) < 1000


def test_a_model_may_have_as_many_axes_as_is_said_and_shapes_that_are_constant() -> None:
    shape = node("Constant", [], ["s"], field(5, field(1, "value") + field(5, tensor("", [1] * 7 + [-1], INT64))))
    nodes = [
        shape,
        node("Reshape", ["x", "s"], ["r"]),
        node("Dropout", ["r", "half"], ["d"]),
        node("Reshape", ["d", "t"], ["y"]),
    ]
    document = _three(nodes, [tensor("t", [3], INT64), tensor("half", 0.5)])
    drawn = Drawn(document, *_BODY, seed=0, dt=0.1, sensors=[[0.0, 0.5, -0.25], [5.0, 0.0, 0.125]])
    assert _of_go([json.dumps(drawn._asdict())])[0]["controls"] == [[0, 0.5, -0.25], [1, 0, 0.125]]


def test_an_operator_that_does_not_run_is_named_and_so_are_those_that_do() -> None:
    nodes = [node("Erf", ["x"], ["y"])]
    erf = model(nodes, [], [value_info("x", FLOAT, [1, 3])], [value_info("y", FLOAT, [1, 3])])
    document = {"kind": "onnx", "model": b64encode(erf).decode()}
    _, message = _problem(document)
    assert message.startswith('is no ONNX model that runs here: the operator "Erf" is not among those that run here: ')
    (listed,) = re.findall(r"a set of operators runs, that of feedforward policies:(.*?);", _PAGE, flags=re.DOTALL)
    assert re.findall(r"`(\w+)`", listed) == message.rpartition(": ")[2].split(", ")


def test_a_spoiled_model_does_no_harm() -> None:
    random = np.random.default_rng(26)
    whole = layer(random.normal(size=(3, 3)), random.normal(size=3))
    lines = []
    for number in range(400):
        spoiled = bytearray(whole)
        for place in random.integers(len(whole), size=1 + number % 3):
            spoiled[place] = random.choice([0, 1, 127, 128, 255, *random.integers(256, size=3)])
        if number % 2:
            del spoiled[random.integers(len(whole)) :]
        document = {"kind": "onnx", "model": b64encode(spoiled).decode()}
        lines.append(_line(json.dumps(document).encode(), *_BODY))
    answers = _of_go(lines)
    refused = sum(1 for answer in answers if answer.get("problems"))
    assert len(answers) == 400 and 100 < refused < 400


def test_the_schemas_are_those_of_the_protocol() -> None:
    assert go_schemas.PATH.read_text() == go_schemas.written(), "run python tools/go_schemas.py"
