"""What every kind of brain promises, as laws over arbitrary ones."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from brain_documents import (
    ACTIVATIONS,
    DT,
    MAKERS,
    MOTORS,
    SENSORS,
    Made,
    bits,
    brains,
    episodes,
    examples_of,
    load,
    run,
)
from nmes import schemas
from nmes.brain import KINDS, load_brain, stack


def test_every_kind_has_a_schema_and_every_schema_a_kind() -> None:
    files = {path for path in schemas._texts() if path.startswith("brain-")}
    assert files == {f"brain-{kind}.json" for kind in KINDS}
    assert set(MAKERS) == set(KINDS)
    for kind in KINDS:
        schema = schemas.load(f"brain-{kind}.json")
        assert schema["title"] == f"brain-{kind}"
        assert schema["properties"]["kind"]["const"] == kind


@given(brains(), st.data())
def test_a_vector_and_a_document_give_the_same_brain_again(made: Made, data: st.DataObject) -> None:
    document, inputs, outputs = made
    brain = load(*made)
    vector = brain.to_vector()
    again = load_brain(brain.document, inputs, outputs)
    episode = data.draw(episodes(len(inputs)))
    expected = run(brain, episode)
    twin = brain.with_vector(vector)
    assert json.loads(json.dumps(twin.document, allow_nan=False)) == twin.document
    for other in (again, twin, load_brain(twin.document, inputs, outputs)):
        assert bits(other.to_vector()) == bits(vector)
        assert run(other, episode) == expected
    # What is within the bounds is kept as it is: here, the middle between two that are.
    low, high = brain.with_vector(np.full(len(vector), -1e300)), brain.with_vector(np.full(len(vector), 1e300))
    middle = 0.5 * (low.to_vector() + high.to_vector())
    assert bits(brain.with_vector(middle).to_vector()) == bits(middle)
    assert bits(brain.to_vector()) == bits(vector)
    assert document["kind"] == brain.kind


@given(brains())
def test_a_document_is_as_it_was_given_and_a_copy(made: Made) -> None:
    brain = load(*made)
    plain = orjson.loads(orjson.dumps(made[0], option=orjson.OPT_SERIALIZE_NUMPY))
    assert brain.document == plain
    brain.document.clear()
    assert brain.document == plain


@given(brains(), st.data())
def test_a_row_of_a_batch_equals_the_brain_alone(made: Made, data: st.DataObject) -> None:
    _, inputs, outputs = made
    brain = load(*made)
    count = data.draw(st.integers(1, 9))
    draw = np.random.default_rng(count)
    population = [brain.with_vector(brain.to_vector() + number * 0.1) for number in range(count)]
    batch = stack(population)
    assert (len(batch), batch.inputs, batch.outputs) == (count, brain.inputs, brain.outputs)
    batch.reset(range(count), DT)
    episode = draw.normal(size=(70, count, len(inputs)))
    episode[0] = data.draw(episodes(len(inputs), ticks=count))
    together = np.stack([batch.step(row).copy() for row in episode])
    assert together.shape == (70, count, len(outputs))
    for number, alone in enumerate(population):
        assert run(alone, episode[:, number], seed=number) == bits(together[:, number])
    if batch.open_loop:
        batch.reset(range(count), DT)
        assert bits(batch.controls(70)) == bits(together)


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_rows_of_single_units_far_apart_in_memory_equal_the_brain_alone(activation: str) -> None:
    layers = [{"weights": [[0.75]], "biases": [0.25], "activation": activation}] * 2
    brain = load_brain({"kind": "mlp", "layers": layers}, ["s"], ["m"])
    population = [brain.with_vector(brain.to_vector() - 0.1 * number) for number in range(9)]
    batch = stack(population)
    batch.reset([0] * 9, DT)
    values = np.linspace(-1, 1, 9)[:, None]
    together = batch.step(values).copy()
    for number, alone in enumerate(population):
        assert run(alone, values[[number]]) == bits(together[number])


@given(brains(), st.data())
def test_outputs_are_finite_and_within_bounds_for_any_finite_inputs_and_parameters(
    made: Made, data: st.DataObject
) -> None:
    brain = load(*made)
    size = len(brain.to_vector())
    some = data.draw(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=12))
    brain = brain.with_vector(np.resize(np.array(some), size))
    brain.reset(0, DT)
    for row in data.draw(episodes(len(made[1]), ticks=40)):
        out = brain.step(row)
        assert out.shape == (len(made[2]),)
        assert np.all(np.abs(out) <= 1.0)  # nor is any of them NaN


@given(brains(), st.data(), st.integers(0, 2**63))
def test_a_reset_starts_over_and_only_the_seed_decides_what_is_random(
    made: Made, data: st.DataObject, seed: int
) -> None:
    brain = load(*made)
    episode = data.draw(episodes(len(made[1]), ticks=8))
    first = run(brain, episode, seed)
    run(brain, episode[::-1], seed + 1)
    assert run(brain, episode, seed) == first == run(load(*made), episode, seed)


@given(brains("sine", "cpg"), st.lists(st.integers(0, 90), min_size=1, max_size=4))
def test_controls_of_many_steps_do_not_depend_on_how_they_are_grouped(made: Made, portions: list[int]) -> None:
    brain = load(*made)
    ticks = sum(portions) + 10
    stepped = run(brain, np.zeros((ticks, len(made[1]))))
    brain.reset(0, DT)
    if not brain.open_loop:
        with pytest.raises(ValueError, match="needs its sensors"):
            brain.controls(1)
        return
    got = []
    for number, portion in enumerate(portions):
        got.append(bits(brain.controls(portion)))
        if number == 0:
            got += [bits(brain.step(np.zeros(len(made[1])))) for _ in range(10)]
    assert b"".join(got) == stepped


PROGRAM = """
import json, sys
import numpy as np
from nmes.brain import load_brain, stack
draw = np.random.default_rng(7)
for document, inputs, outputs in json.load(sys.stdin):
    brain = load_brain(document, inputs, outputs)
    batch = stack([brain] * 3)
    brain.reset(5, 1 / 60)
    batch.reset([4, 5, 6], 1 / 60)
    for row in draw.normal(size=(50, len(inputs))):
        alone = brain.step(row).tobytes()
        assert alone == batch.step(np.stack([row * 2, row, row * 3]))[1].tobytes(), document
    print(alone.hex())
"""


def test_results_do_not_depend_on_process_threads_or_math_library() -> None:
    made = [(example, SENSORS, MOTORS) for kind in KINDS for example in examples_of(kind)]
    draw = np.random.default_rng(3)
    wide = {
        "kind": "mlp",
        "layers": [
            {"weights": draw.normal(size=(130, 5)).tolist(), "biases": [0.0] * 130},
            {"weights": draw.normal(size=(5, 130)).tolist(), "biases": [0.0] * 5},
        ],
    }

    def output(**environment: str) -> str:
        return subprocess.run(
            [sys.executable, "-c", PROGRAM],
            input=json.dumps([*made, (wide, SENSORS, MOTORS)]),
            env={**os.environ, **environment},
            capture_output=True,
            text=True,
            check=True,
        ).stdout

    assert len(output().splitlines()) == len(made) + 1
    assert output() == output(OPENBLAS_NUM_THREADS="1", PYTHONHASHSEED="1")
    assert output() == output(OPENBLAS_CORETYPE="Prescott")
