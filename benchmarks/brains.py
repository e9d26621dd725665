"""What brains cost a control step, beside bare numpy that does the same sums with none of the promises.

The body has 7 motors and 20 sensors, as a crawler of 8 cubes has. The bare loops know their matrices, names and sizes,
take sums by BLAS in whatever order suits it, functions as the processor has them, and check nothing. The same bits on
every processor cost that much; beside a world that ticks it is little (`evaluation.py`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from measure import Figure, in_turns, ratio, summary
from nmes.brain import load_brain, stack

MOTORS = [f"hinge{i}" for i in range(7)]
SENSORS = [f"sensor{i}" for i in range(20)]
DT = 1 / 60
TICKS = 600
BATCH = 64
ROUNDS = 15

CPG: dict[str, Any] = {
    "kind": "cpg",
    "oscillators": [{"motor": "*"}],
    "chains": [{"motors": "*", "weight": 5, "lag": 0.8}],
}


def mlp() -> dict[str, Any]:
    """Returns a network of 20 inputs, 32 hidden units and 7 outputs."""
    draw = np.random.default_rng(0)
    sizes = [(32, 20), (7, 32)]
    layers = [{"weights": draw.normal(size=size), "biases": draw.normal(size=size[0])} for size in sizes]
    return {"kind": "mlp", "layers": layers}


def bare_mlp(document: dict[str, Any]) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """Returns the same network as plain numpy."""
    (w1, b1), (w2, b2) = ((layer["weights"], layer["biases"]) for layer in document["layers"])

    def step(x: NDArray[np.float64]) -> NDArray[np.float64]:
        out: NDArray[np.float64] = np.tanh(w2 @ np.tanh(w1 @ x + b1) + b2)
        return out

    return step


def bare_cpg() -> float:
    """Runs an episode of the same oscillators as plain numpy, all pairs at once; returns seconds a step."""
    count = len(MOTORS)
    near = np.eye(count, k=1) + np.eye(count, k=-1)
    weight, lag = 5 * near, 0.8 * (np.eye(count, k=-1) - np.eye(count, k=1))
    speed, phases = np.full(count, 2 * np.pi), np.zeros(count)
    controls = np.empty((TICKS, count))
    began = time.perf_counter()
    for tick in range(TICKS):
        controls[tick] = 0.5 * np.sin(phases)
        phases = phases + DT * (speed + np.sum(weight * np.sin(phases - phases[:, None] - lag), axis=1))
    return (time.perf_counter() - began) / TICKS


def stepped(step: Callable[[Any], Any], inputs: Any) -> float:
    """Steps through an episode; returns seconds a step."""
    began = time.perf_counter()
    for row in inputs:
        step(row)
    return (time.perf_counter() - began) / len(inputs)


def figures() -> Iterator[Figure]:
    """Measures."""
    draw = np.random.default_rng(1)
    inputs, batched = draw.normal(size=(TICKS, 20)), draw.normal(size=(100, BATCH, 20))
    network, oscillators = load_brain(mlp(), SENSORS, MOTORS), load_brain(CPG, SENSORS, MOTORS)
    many = stack([network.with_vector(network.to_vector() * (1 + i / BATCH)) for i in range(BATCH)])
    bare = bare_mlp(mlp())

    def episode() -> float:
        began = time.perf_counter()
        oscillators.reset(0, DT)
        oscillators.controls(TICKS)
        return (time.perf_counter() - began) / TICKS

    def network_alone() -> float:
        network.reset(0, DT)
        return stepped(network.step, inputs)

    def network_batch() -> float:
        many.reset([0] * BATCH, DT)
        return stepped(many.step, batched) / BATCH

    samples = in_turns(
        {
            "cpg": episode,
            "bare cpg": bare_cpg,
            "mlp": network_alone,
            "bare mlp": lambda: stepped(bare, inputs),
            "mlp in a batch of 64": network_batch,
        },
        ROUNDS,
    )
    times = {"microseconds a step": summary(samples, 1e-6)}
    yield Figure(
        "cpg, 7 motors: step / plain numpy", ratio(samples, "cpg", "bare cpg"), "x", at_most=1.3, details=times
    )
    yield Figure("mlp 20-32-7: step / plain numpy", ratio(samples, "mlp", "bare mlp"), "x", at_most=1.3, details=times)
    name = "mlp 20-32-7: a brain's step in a batch of 64 / plain numpy"
    yield Figure(name, ratio(samples, "mlp in a batch of 64", "bare mlp"), "x", at_most=0.5, details=times)
