"""Brains for tests: a body's names, the schemas' examples fitted to it, and arbitrary brains for Hypothesis."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
from hypothesis import strategies as st

from nmes import schemas
from nmes.brain import KINDS, Brain, load_brain
from onnx_models import DOUBLE, FLOAT, layer

SENSORS = ("hip.position", "hip.velocity", "knee.position", "root.up.y", "foot.contact")
MOTORS = ("hip", "hip_left", "hip_right", "knee", "tail")
DT = 1 / 60

Made = tuple[dict[str, Any], list[str], list[str]]  # a document, the sensors and the motors that it fits


def load(document: dict[str, Any], inputs: Any = SENSORS, outputs: Any = MOTORS) -> Brain:
    return load_brain(document, inputs, outputs)


def bits(values: Any) -> bytes:
    """Distinguishes 0 from -0, and makes a copy."""
    return np.ascontiguousarray(values).tobytes()


def run(brain: Brain, inputs: Any, seed: int = 0) -> bytes:
    """Returns all outputs of an episode, with inputs (ticks, sensors)."""
    brain.reset(seed, DT)
    return b"".join(bits(brain.step(row)) for row in inputs)


def examples_of(kind: str) -> list[dict[str, Any]]:
    """Returns a schema's examples, fitted to this page's body."""
    text = json.dumps(schemas.load(f"brain-{kind}.json")["examples"])
    for name, ours in (("knee_left", "knee"), ("knee_right", "knee"), ("foot_left.contact", "foot.contact")):
        text = text.replace(name, ours)
    examples: list[dict[str, Any]] = json.loads(text)
    return examples


# -- arbitrary brains -------------------------------------------------------------------------------------------------


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high) | st.sampled_from([low, high])


def table(draw: st.DrawFn, rows: int, columns: int) -> Any:
    """Draws a matrix: of modest numbers from a seed, or of anything that is allowed."""
    if draw(st.integers(0, 3)):
        return np.random.default_rng(draw(st.integers(0, 1000))).normal(size=(rows, columns)) * 2
    some = draw(st.lists(numbers(-(2.0**19), 2.0**19), min_size=1, max_size=8))
    return np.resize(np.array(some), (rows, columns))


@st.composite
def oscillators(draw: st.DrawFn, outputs: list[str]) -> list[dict[str, Any]]:
    motors = draw(st.just(["*"]) | st.lists(st.sampled_from(outputs), min_size=1, unique=True))
    fields = {
        "frequency": (0, 100),
        "amplitude": (-10, 10),
        "phase": (-100, 100),
        "step": (-100, 100),
        "offset": (-10, 10),
    }
    return [
        {"motor": motor, **draw(st.fixed_dictionaries({}, optional={k: numbers(*v) for k, v in fields.items()}))}
        for motor in motors
    ]


@st.composite
def brains(draw: st.DrawFn, *kinds: str) -> Made:
    kind = draw(st.sampled_from(kinds or [*KINDS]))
    inputs = [f"s{i}" for i in range(draw(st.integers(0, 12)))]
    outputs = [f"m{i}" for i in range(draw(st.integers(1, 9)))]
    return MAKERS[kind](draw, inputs, outputs), inputs, outputs


def make_sine(draw: st.DrawFn, inputs: list[str], outputs: list[str]) -> dict[str, Any]:
    return {"kind": "sine", "oscillators": draw(oscillators(outputs))}


def make_cpg(draw: st.DrawFn, inputs: list[str], outputs: list[str]) -> dict[str, Any]:
    driven = draw(oscillators(outputs))
    document: dict[str, Any] = {"kind": "cpg", "oscillators": driven, "start_jitter": draw(numbers(0, 4))}
    motors = [oscillator["motor"] for oscillator in driven]
    ties = st.fixed_dictionaries({}, optional={"weight": numbers(-100, 100), "lag": numbers(-100, 100)})
    if draw(st.booleans()):
        document["chains"] = [{"motors": "*", **draw(ties)}]
    if len(motors) > 1:
        pairs = draw(st.lists(st.lists(st.sampled_from(motors), min_size=2, max_size=2, unique=True), max_size=4))
        document["links"] = [{"from": source, "to": target, **draw(ties)} for source, target in pairs]
    if inputs:
        term = st.fixed_dictionaries(
            {"sensor": st.sampled_from([*inputs, "s*"]), "motor": st.sampled_from(["*", *motors])},
            optional={"rate": numbers(-1000, 1000), "offset": numbers(-1000, 1000)},
        )
        document["feedback"] = draw(st.lists(term, max_size=3))
    return document


ACTIVATIONS: list[str] = schemas.load("brain-mlp.json")["properties"]["layers"]["items"]["properties"]["activation"][
    "enum"
]


def make_mlp(draw: st.DrawFn, inputs: list[str], outputs: list[str]) -> dict[str, Any]:
    entries = inputs or ["none"]
    inputs[:] = entries
    widths = [len(entries), *draw(st.lists(st.integers(1, 33), max_size=2)), len(outputs)]
    layers = [
        {
            "weights": table(draw, after, before),
            "biases": table(draw, 1, after)[0],
            "activation": draw(st.sampled_from(ACTIVATIONS)),
        }
        for before, after in pairwise(widths)
    ]
    return {"kind": "mlp", "layers": layers}


def make_ctrnn(draw: st.DrawFn, inputs: list[str], outputs: list[str]) -> dict[str, Any]:
    n = len(outputs) + draw(st.integers(0, 5))
    return {
        "kind": "ctrnn",
        "time_constants": draw(st.lists(st.floats(0.001, 1000), min_size=n, max_size=n)),
        "biases": table(draw, 1, n)[0],
        "weights": table(draw, n, n),
        "input_weights": table(draw, n, len(inputs)),
    }


def make_graph(draw: st.DrawFn, inputs: list[str], outputs: list[str]) -> dict[str, Any]:
    n = draw(st.integers(1, 12))
    weight = numbers(-(2.0**19), 2.0**19) | st.floats(-3, 3, width=16)
    nodes = [{"id": f"n{i}", "activation": draw(st.sampled_from(ACTIVATIONS)), "bias": draw(weight)} for i in range(n)]
    for number, motor in enumerate(outputs[:n]):
        if number == 0 or draw(st.booleans()):
            nodes[number]["motor"] = motor
    ids = [node["id"] for node in nodes]
    pairs = draw(st.lists(st.tuples(st.sampled_from(ids), st.sampled_from(ids)), unique=True, max_size=30))
    links = [{"from": source, "to": target, "weight": draw(weight)} for source, target in pairs]
    if inputs:
        sensed = st.tuples(st.sampled_from(["*", *inputs]), st.sampled_from(ids))
        links += [
            {"sensor": s, "to": to, "weight": draw(weight)} for s, to in draw(st.lists(sensed, unique=True, max_size=9))
        ]
    return {"kind": "graph", "nodes": nodes, "links": links}


def make_onnx(draw: st.DrawFn, inputs: list[str], outputs: list[str]) -> dict[str, Any]:
    inputs[:] = inputs or ["none"]
    kind = draw(st.sampled_from([FLOAT, DOUBLE]))
    way = draw(st.sampled_from(["raw", "packed", "loose"])) if kind == FLOAT else "raw"
    shape: Any = draw(st.sampled_from([[1, len(inputs)], [len(inputs)], ["batch", len(inputs)]]))
    weights, biases = table(draw, len(inputs), len(outputs)), table(draw, 1, len(outputs))
    return {"kind": "onnx", "model": b64encode(layer(weights, biases, shape=shape, kind=kind, way=way)).decode()}


MAKERS: dict[str, Callable[[st.DrawFn, list[str], list[str]], dict[str, Any]]] = {
    "sine": make_sine,
    "cpg": make_cpg,
    "mlp": make_mlp,
    "ctrnn": make_ctrnn,
    "graph": make_graph,
    "onnx": make_onnx,
}


@st.composite
def episodes(draw: st.DrawFn, sensors: int, ticks: int = 5) -> Any:
    """Draws inputs (ticks, sensors), any finite numbers."""
    some = draw(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=12))
    return np.resize(np.array(some), (ticks, sensors))
