"""Brains of all kinds with bodies, drawn from a seed: names with and without wildcards, numbers modest and extreme."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterator
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from brain_documents import ACTIVATIONS
from onnx_models import DOUBLE, FLOAT, layer

__all__ = ["Drawn", "drawn_brains"]

Random = np.random.Generator


class Drawn(NamedTuple):
    """A brain, the body that it fits, and an episode."""

    document: dict[str, Any]
    inputs: list[str]
    outputs: list[str]
    seed: int
    dt: float
    sensors: list[list[float]]  # a row for each step


def drawn_brains(count: int, seed: int) -> Iterator[Drawn]:
    """Yields brains, of each kind as many as of the others."""
    kinds = (_sine, _cpg, _mlp, _ctrnn, _graph, _onnx)
    for number in range(count):
        random = np.random.default_rng([seed, number])
        inputs = [f"s{i}" for i in range(int(random.integers(1, 14)))]
        outputs = [f"m{i}" for i in range(int(random.integers(1, 12)))]
        document = kinds[number % len(kinds)](random, inputs, outputs)
        steps, size = int(random.integers(2, 24)), 10.0 ** random.uniform(-3, 2)
        sensors = random.normal(size=(steps, len(inputs))) * size
        if random.random() < 0.1 and document["kind"] != "onnx":
            sensors[random.integers(steps)] = 10.0 ** random.uniform(5, 300) * random.choice([-1, 1])
        dt = float(random.choice([1 / 60, 1 / 240, 0.1, random.uniform(0.001, 1)]))
        # Every sixth is without a seed that is small.
        first = int(random.integers(0, 2**63)) if random.random() < 0.2 else int(random.integers(0, 1000))
        yield Drawn(document, inputs, outputs, first, dt, sensors.tolist())


def _numbers(random: Random, *shape: int) -> Any:
    size = 10.0 ** random.uniform(2, 5.9) if random.random() < 0.1 else 2.0
    return np.clip(random.normal(size=shape) * size, -1e6, 1e6).tolist()


def _some(random: Random, names: list[str]) -> list[str]:
    """Draws entries that differ: names and, at the end, perhaps a wildcard for all that are left."""
    chosen = [str(name) for name in random.permutation(names)[: int(random.integers(1, len(names) + 1))]]
    return [*chosen, names[0][0] + "*"] if len(chosen) < len(names) and random.random() < 0.4 else chosen


def _fields(random: Random, **bounds: tuple[float, float]) -> dict[str, float]:
    """Draws some of the fields, each within its bounds, and sometimes on one of them."""
    drawn = {}
    for name, (low, high) in bounds.items():
        if random.random() < 0.8:
            drawn[name] = float(random.choice([low, high]) if random.random() < 0.05 else random.uniform(low, high))
    return drawn


def _oscillators(random: Random, outputs: list[str]) -> list[dict[str, Any]]:
    entries = ["*"] if random.random() < 0.4 else _some(random, outputs)
    modest = random.random() < 0.5
    return [
        {
            "motor": motor,
            **_fields(
                random,
                frequency=(0, 3 if modest else 100),
                amplitude=(-1, 1) if modest else (-10, 10),
                phase=(-100, 100),
                step=(-3, 3),
                offset=(-0.3, 0.3) if modest else (-10, 10),
            ),
        }
        for motor in entries
    ]


def _sine(random: Random, inputs: list[str], outputs: list[str]) -> dict[str, Any]:
    return {"kind": "sine", "oscillators": _oscillators(random, outputs)}


def _cpg(random: Random, inputs: list[str], outputs: list[str]) -> dict[str, Any]:
    document: dict[str, Any] = {"kind": "cpg", "oscillators": _oscillators(random, outputs)}
    motors = [each["motor"] for each in document["oscillators"]]
    document |= _fields(random, convergence=(0.1, 1000))
    if random.random() < 0.5:
        document["start_jitter"] = float(random.uniform(0, 4))
    if random.random() < 0.6:
        document["chains"] = [{"motors": "*", **_fields(random, weight=(-100, 100), lag=(-100, 100))}]
    if len(motors) > 1:
        document["links"] = [
            {"from": source, "to": target, **_fields(random, weight=(-20, 20), lag=(-4, 4))}
            for source, target in zip(motors, random.permutation(motors).tolist(), strict=True)
            if source != target and random.random() < 0.7
        ]
    if random.random() < 0.5:
        document["feedback"] = [
            {"sensor": str(random.choice([*inputs, "s*"])), "motor": motor}
            | _fields(random, rate=(-1000, 1000), offset=(-0.01, 0.01))
            for motor in motors
            if random.random() < 0.7
        ]
    return document


def _sides(random: Random, inputs: list[str], outputs: list[str]) -> tuple[dict[str, Any], int, int]:
    """Draws lists of inputs and outputs, or none, and returns how many entries each has."""
    if random.random() < 0.5:
        return {}, len(inputs), len(outputs)
    ins, outs = _some(random, inputs), _some(random, outputs)
    return {"inputs": ins, "outputs": outs}, len(ins), len(outs)


def _mlp(random: Random, inputs: list[str], outputs: list[str]) -> dict[str, Any]:
    sides, first, last = _sides(random, inputs, outputs)
    widths = [first, *random.integers(1, 34, size=int(random.integers(0, 3))).tolist(), last]
    layers = [
        {"weights": _numbers(random, after, before), "biases": _numbers(random, after)}
        | ({"activation": str(random.choice(ACTIVATIONS))} if random.random() < 0.9 else {})
        for before, after in pairwise(widths)
    ]
    return {"kind": "mlp", **sides, "layers": layers}


def _ctrnn(random: Random, inputs: list[str], outputs: list[str]) -> dict[str, Any]:
    sides, first, last = _sides(random, inputs, outputs)
    count = last + int(random.choice([0, 1, 5, 20, 140], p=[0.2, 0.3, 0.3, 0.17, 0.03]))
    return {
        "kind": "ctrnn",
        **sides,
        "time_constants": (10.0 ** random.uniform(-3, 3, size=count)).tolist(),
        "biases": _numbers(random, count),
        "weights": _numbers(random, count, count),
        "input_weights": _numbers(random, count, first),
    }


def _graph(random: Random, inputs: list[str], outputs: list[str]) -> dict[str, Any]:
    ids = [f"n{i}" for i in range(int(random.integers(1, 15)))]
    nodes: list[dict[str, Any]] = [
        {"id": name, "activation": str(random.choice(ACTIVATIONS)), "bias": _numbers(random)} for name in ids
    ]
    for node, motor in zip(nodes, _some(random, outputs), strict=False):
        node["motor"] = motor
    pairs = {tuple(pair) for pair in random.choice(ids, size=(int(random.integers(0, 40)), 2)).tolist()}
    links = [{"from": source, "to": target, "weight": _numbers(random)} for source, target in sorted(pairs)]
    heard = {(str(random.choice([*inputs, "s*"])), str(random.choice(ids))) for _ in range(int(random.integers(0, 9)))}
    links += [{"sensor": sensor, "to": target, "weight": _numbers(random)} for sensor, target in sorted(heard)]
    return {"kind": "graph", "nodes": nodes, "links": [links[i] for i in random.permutation(len(links))]}


def _onnx(random: Random, inputs: list[str], outputs: list[str]) -> dict[str, Any]:
    kind = int(random.choice([FLOAT, DOUBLE]))
    way = str(random.choice(["raw", "packed", "loose"])) if kind == FLOAT else "raw"
    shapes: list[Any] = [[1, len(inputs)], [len(inputs)], ["batch", len(inputs)], [1, "width"]]
    weights, biases = random.normal(size=(len(inputs), len(outputs))), random.normal(size=len(outputs))
    model = layer(weights, biases, shape=shapes[random.integers(len(shapes))], kind=kind, way=way)
    return {"kind": "onnx", "model": b64encode(model).decode()}
