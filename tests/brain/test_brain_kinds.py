"""What each kind of brain computes, how names and wildcards are dealt out, and what is said of mistakes."""

from __future__ import annotations

from collections.abc import Callable
from math import exp, pi, sin, tanh
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from brain_documents import DT, MOTORS, SENSORS, Made, bits, brains, examples_of, load
from nmes.brain import load_brain, stack
from nmes.errors import DocumentError

# -- names ------------------------------------------------------------------------------------------------------------


def sine(*entries: str) -> dict[str, Any]:
    """Returns a brain that says which entry has which motor: the second's controls are 0.2."""
    count = len(entries)
    return {
        "kind": "sine",
        "oscillators": [
            {"motor": entry, "amplitude": 0, "offset": (number + 1) / 10}
            for number, entry in zip(range(count), entries, strict=True)
        ],
    }


@pytest.mark.parametrize(
    ("entries", "owners"),
    [
        (["*"], [1, 1, 1, 1, 1]),
        (["knee"], [0, 0, 0, 1, 0]),
        (["hip*"], [1, 1, 1, 0, 0]),
        (["*", "hip"], [2, 1, 1, 1, 1]),  # its own name first, wherever it stands
        (["hip_*", "*"], [2, 1, 1, 2, 2]),  # then the first wildcard
        (["*_left", "*_????t", "t*l"], [0, 1, 2, 0, 3]),
        (["hip?right"], [0, 0, 1, 0, 0]),
    ],
)
def test_motors_are_assigned_by_names_and_wildcards(entries: list[str], owners: list[int]) -> None:
    brain = load(sine(*entries))
    brain.reset(0, DT)
    assert [round(control * 10) for control in brain.step(np.zeros(5))] == owners


def test_a_name_may_look_like_a_pattern() -> None:
    brain = load_brain(sine("a.b[c]*", "*"), [], ["a.b[c]*", "a.b[c]d", "axbc"])
    brain.reset(0, DT)
    assert [round(control * 10) for control in brain.step(np.zeros(0))] == [1, 2, 2]


def test_a_wildcard_covers_the_sensors_and_motors_of_a_larger_body() -> None:
    wave = {"kind": "cpg", "oscillators": [{"motor": "seg*"}], "chains": [{"motors": "seg*", "lag": 0.5}]}
    mlp = {
        "kind": "mlp",
        "inputs": ["*.contact", "root.up.y"],
        "outputs": ["seg*", "jaw"],
        "layers": [{"weights": [[1, 0], [0, 1]], "biases": [0, 0]}],
    }
    for count in (2, 3, 9):
        sensors = [f"seg{i}.contact" for i in range(count)] + ["root.up.y", "root.height"]
        motors = [f"seg{i}" for i in range(count)] + ["jaw", "tail"]
        assert len(load_brain(wave, sensors, motors).to_vector()) == 7
        brain = load_brain(mlp, sensors, motors)
        brain.reset(0, DT)
        values = np.array([0.1] * count + [0.5, 99.0])
        out = brain.step(values)
        np.testing.assert_allclose(out, [tanh(0.1 * count)] * count + [tanh(0.5), 0.0], rtol=1e-12)


# -- what each kind computes ------------------------------------------------------------------------------------------


def test_a_sine_brain_computes_a_sine() -> None:
    document = {
        "kind": "sine",
        "oscillators": [
            {"motor": "hip*", "frequency": 1.5, "amplitude": 0.6, "phase": 0.3, "step": 0.7, "offset": 0.1},
            {"motor": "tail", "frequency": 2, "amplitude": 3},
        ],
    }
    brain = load(document)
    assert brain.open_loop
    brain.reset(0, DT)
    for tick in range(200):
        t = tick * DT
        wanted = [0.1 + 0.6 * sin(2 * pi * 1.5 * t + 0.3 - 0.7 * rank) for rank in range(3)]
        wanted += [0.0, min(max(3 * sin(2 * pi * 2 * t), -1), 1)]
        np.testing.assert_allclose(brain.step(np.zeros(5)), wanted, atol=1e-12)


def test_an_oscillator_without_links_is_a_sine_of_growing_amplitude() -> None:
    oscillators = [{"motor": "*", "frequency": 1.2, "amplitude": 0.8, "phase": 1, "offset": -0.1}]
    alone, plain = load({"kind": "cpg", "oscillators": oscillators}), load({"kind": "sine", "oscillators": oscillators})
    for brain in (alone, plain):
        brain.reset(0, DT)
    swelling, steady = alone.controls(600), plain.controls(600)
    # The second-order equation of the amplitude, r'' = a (a/4 (1 - r) - r'), in small steps of Euler's.
    r = speed = 0.0
    for tick in range(600):
        np.testing.assert_allclose(swelling[tick] + 0.1, r * (steady[tick] + 0.1), atol=2e-4)
        for _ in range(200):
            r, speed = r + speed * DT / 200, speed + 20 * (5 * (1 - r) - speed) * DT / 200
    assert 0.45 < swelling_share(swelling, steady, 3.36 / 20) < 0.55


def swelling_share(swelling: Any, steady: Any, t: float) -> float:
    tick = round(t / DT)
    return float((swelling[tick, 0] + 0.1) / (steady[tick, 0] + 0.1))


def phases(controls: Any, amplitude: float, frequency: float) -> Any:
    """Returns how far each motor is behind the first one at the end, in rad, from a fit to the last periods."""
    ticks = round(4 / frequency / DT)
    t = np.arange(ticks) * DT
    wave = np.exp(-2j * pi * frequency * t) @ controls[-ticks:]
    np.testing.assert_allclose(2 * np.abs(wave) / ticks, amplitude, rtol=0.05)
    return np.angle(wave[0] / wave)


@pytest.mark.parametrize("jitter", [0, 1.5])
def test_linked_oscillators_settle_at_the_lag_of_their_link(jitter: float) -> None:
    document = {
        "kind": "cpg",
        "oscillators": [{"motor": "*", "frequency": 1, "amplitude": 0.5}],
        "chains": [{"motors": "hip*", "weight": 5, "lag": 0.8}],
        "links": [
            {"from": "hip", "to": "knee", "weight": 5, "lag": 2},
            {"from": "hip", "to": "tail", "weight": 5, "lag": -1},
        ],
        "start_jitter": jitter,
    }
    brain = load(document)
    brain.reset(11, DT)
    np.testing.assert_allclose(phases(brain.controls(1200), 0.5, 1.0), [0, 0.8, 1.6, 2, -1], atol=1e-6)


def test_linked_oscillators_of_different_frequencies_run_in_step() -> None:
    def apart(weight: float) -> float:
        document = {
            "kind": "cpg",
            "oscillators": [{"motor": "hip", "frequency": 1}, {"motor": "knee", "frequency": 1.2}],
            "links": [{"from": "hip", "to": "knee", "weight": weight}],
        }
        brain = load(document)
        brain.reset(0, DT)
        return float(np.angle(np.exp(-2j * pi * np.arange(300) * DT) @ brain.controls(1500)[-300:, [0, 3]]) @ [-1, 1])

    # Adler: the lead is asin(difference of speeds / weight), 0.4 pi over the weight.
    assert apart(5) == pytest.approx(np.arcsin(0.4 * pi / 5), abs=0.01)
    assert apart(20) == pytest.approx(np.arcsin(0.4 * pi / 20), abs=0.01)


def test_the_seed_draws_the_initial_phases_and_nothing_else() -> None:
    document = {"kind": "cpg", "oscillators": [{"motor": "*", "frequency": 0, "phase": 0.1}], "start_jitter": 0.05}
    brain = load(document)
    ends = []
    for seed in range(8):
        brain.reset(seed, DT)
        ends.append(brain.controls(600)[-1] / 0.5)
    angles = np.arcsin(np.array(ends))
    assert np.all(np.abs(angles - 0.1) <= 0.05)
    assert len(np.unique(angles)) == angles.size
    assert np.ptp(angles) > 0.05


def test_feedback_turns_the_phase_and_shifts_the_control() -> None:
    document = {
        "kind": "cpg",
        "oscillators": [{"motor": "*", "frequency": 0, "phase": 0.2}],
        "feedback": [
            {"sensor": "hip.*", "motor": "hip", "rate": 3},
            {"sensor": "root.up.y", "motor": "knee", "offset": 0.25},
        ],
    }
    brain = load(document)
    assert not brain.open_loop
    brain.reset(0, DT)
    for _ in range(600):
        brain.step(np.zeros(5))
    values = np.array([0.5, 0.25, 9, 0.4, 9])
    for tick in range(10):
        out = brain.step(values)
        wanted = [0.5 * sin(0.2 + tick * DT * 3 * 0.75), *[0.5 * sin(0.2)] * 4]
        wanted[3] += 0.1
        np.testing.assert_allclose(out, wanted, atol=1e-9)


def test_feedback_of_zero_changes_nothing() -> None:
    document = examples_of("cpg")[0]
    listening = {**document, "feedback": [{"sensor": "*", "motor": "*"}]}
    still, moved = load(document), load(listening)
    still.reset(3, DT)
    moved.reset(3, DT)
    for row in np.random.default_rng(1).normal(size=(200, 5)):
        np.testing.assert_allclose(moved.step(row), still.step(row), atol=1e-12)


FORMULAS: dict[str, Callable[[float], float]] = {
    "tanh": tanh,
    "sigmoid": lambda s: 1 / (1 + exp(-s)),
    "sin": sin,
    "cos": lambda s: sin(s + pi / 2),
    "gauss": lambda s: exp(-s * s),
    "step": lambda s: float(s >= 0),
    "relu": lambda s: max(s, 0.0),
    "abs": abs,
    "identity": lambda s: s,
}


@pytest.mark.parametrize("name", FORMULAS)
def test_an_mlp_computes_layers_of_weighted_sums(name: str) -> None:
    draw = np.random.default_rng(5)
    w1, b1, w2, b2 = (
        draw.normal(size=(4, 3)),
        draw.normal(size=4),
        draw.normal(size=(2, 4)) * 0.1,
        draw.normal(size=2) * 0.1,
    )
    document = {
        "kind": "mlp",
        "inputs": ["foot.contact", "hip.position", "knee.*"],
        "outputs": ["tail", "hip"],
        "layers": [
            {"weights": w1, "biases": b1, "activation": name},
            {"weights": w2, "biases": b2, "activation": "identity"},
        ],
    }
    brain = load(document)
    np.testing.assert_array_equal(brain.to_vector(), np.concatenate([w1.ravel(), b1, w2.ravel(), b2]))
    brain.reset(0, DT)
    for values in draw.normal(size=(20, 5)):
        seen = values[[4, 0, 2]]
        hidden = np.array([FORMULAS[name](float(s)) for s in w1 @ seen + b1])
        tail, hip = np.clip(w2 @ hidden + b2, -1, 1)
        np.testing.assert_allclose(brain.step(values), [hip, 0, 0, 0, tail], atol=1e-12)


def test_a_ctrnn_follows_its_equation() -> None:
    draw = np.random.default_rng(8)
    n = 6
    taus, biases, w = draw.uniform(0.05, 0.5, n), draw.normal(size=n), draw.normal(size=(n, n)) * 2
    w_in = draw.normal(size=(n, 5))
    document = {"kind": "ctrnn", "time_constants": taus, "biases": biases, "weights": w, "input_weights": w_in}
    brain = load(document)
    small = 1e-4
    brain.reset(0, small)
    y = np.zeros(n)
    sigmoid = np.vectorize(FORMULAS["sigmoid"])
    values = draw.normal(size=5)
    for _ in range(10_000):
        out = brain.step(values)
        y = y + small / taus * (-y + w @ sigmoid(y + biases) + w_in @ values)
    np.testing.assert_allclose(out, 2 * sigmoid(y + biases)[:5] - 1, atol=1e-3)
    # Coarser steps tell the same story, and the longest are stable.
    brain.reset(0, DT)
    for _ in range(60):
        coarse = brain.step(values)
    np.testing.assert_allclose(coarse, out, atol=0.05)


def graph(nodes: list[dict[str, Any]], *links: tuple[str, str, float]) -> dict[str, Any]:
    documents = [
        {"sensor" if "." in source else "from": source, "to": target, "weight": weight}
        for source, target, weight in links
    ]
    return {"kind": "graph", "nodes": nodes, "links": documents}


def test_a_graph_of_sums_computes_exclusive_or() -> None:
    document = graph(
        [
            {"id": "out", "activation": "step", "bias": -0.5, "motor": "knee"},
            {"id": "or", "activation": "step", "bias": -0.5},
            {"id": "and", "activation": "step", "bias": -1.5},
        ],
        ("hip.position", "or", 1.0),
        ("knee.position", "or", 1.0),
        ("hip.position", "and", 1.0),
        ("knee.position", "and", 1.0),
        ("or", "out", 1.0),
        ("and", "out", -1.0),
    )
    brain = load(document)
    brain.reset(0, DT)
    for a in (0.0, 1.0):
        for b in (0.0, 1.0):
            values = np.array([a, 7, b, 7, 7])
            assert brain.step(values).tolist() == [0, 0, 0, float(a != b), 0]


def test_a_link_in_a_loop_carries_the_value_of_the_step_before() -> None:
    # A counter, a ring of two that passes a value to and fro, and a tap on it which is in no loop.
    document = graph(
        [
            {"id": "count", "activation": "identity", "bias": 0.01, "motor": "hip"},
            {"id": "tick", "activation": "identity", "motor": "knee"},
            {"id": "tock", "activation": "identity", "motor": "tail"},
            {"id": "tap", "activation": "identity", "motor": "hip_left"},
        ],
        ("count", "count", 1.0),
        ("tock", "tick", 1.0),
        ("tick", "tock", 1.0),
        ("root.up.y", "tick", 1.0),
        ("tock", "tap", 0.5),
    )
    brain = load(document)
    for _ in range(2):  # a reset forgets it all
        brain.reset(0, DT)
        got = [brain.step(np.array([0, 0, 0, 0.5 if tick == 0 else 0.0, 0])).copy() for tick in range(5)]
    hip, left, _, knee, tail = np.array(got).T
    np.testing.assert_allclose(hip, [0.01, 0.02, 0.03, 0.04, 0.05], atol=1e-12)
    assert knee.tolist() == [0.5, 0, 0.5, 0, 0.5]
    assert tail.tolist() == [0, 0.5, 0, 0.5, 0]
    assert left.tolist() == [0, 0.25, 0, 0.25, 0]


@given(brains("graph"), st.randoms(use_true_random=False))
def test_the_order_of_nodes_and_links_in_a_graph_does_not_matter(made: Made, random: Any) -> None:
    document, inputs, outputs = made
    for node in document["nodes"]:  # so that rounding, which the order may change, stays small
        node["activation"] = "tanh"
        node["bias"] %= 1
    for link in document["links"]:
        link["weight"] %= 1
    nodes, links = list(document["nodes"]), list(document["links"])
    random.shuffle(nodes)
    random.shuffle(links)
    one, other = load(*made), load_brain({**document, "nodes": nodes, "links": links}, inputs, outputs)
    one.reset(0, DT)
    other.reset(0, DT)
    for row in np.random.default_rng(0).uniform(-1, 1, size=(10, len(inputs))):
        np.testing.assert_allclose(one.step(row), other.step(row), atol=1e-9)


# -- mistakes ---------------------------------------------------------------------------------------------------------

LAYER = {"weights": [[1, 2, 3, 4, 5]] * 5, "biases": [0] * 5}


@pytest.mark.parametrize(
    ("document", "wanted"),
    [
        ([], {"brain": "a brain is an object with a 'kind': sine, cpg"}),
        ({"kind": "sin"}, {"brain/kind": "there is no such kind of brain; did you mean sine?"}),
        ({"kind": 3}, {"brain/kind": "there are sine, cpg"}),
        ({"kind": "sine"}, {"brain/oscillators": "is missing; expected an array of 1 to 1,024 oscillators"}),
        (
            {"kind": "sine", "oscillators": [{"motor": "hipp"}, {"motor": "fin*"}]},
            {
                "brain/oscillators/0/motor": "there is no motor 'hipp'; did you mean hip?",
                "brain/oscillators/1/motor": "there is no motor 'fin*'; there are hip, hip_left, hip_right, knee, tail",
            },
        ),
        (
            sine("hip*", "hip_*"),
            {"brain/oscillators/1/motor": "every motor that 'hip_*' stands for has another entry"},
        ),
        (
            {"kind": "sine", "oscillators": [{"motor": "hip", "frequency": 101, "amplitud": 1}, {"motor": "hip"}]},
            {
                "brain/oscillators/0/frequency": "expected a number from 0 to 100 Hz, got 101",
                "brain/oscillators/0/amplitud": "there is no such field; did you mean amplitude?",
            },
        ),
        (
            {"kind": "sine", "oscillators": [{"motor": "hip", "phase": float("nan")}]},
            {"brain/oscillators/0/phase": "nan is no number that JSON has"},
        ),
        ({"kind": "sine", "oscillators": {1, 2}}, {"brain": "this is not JSON data"}),
        (
            {
                "kind": "cpg",
                "oscillators": [{"motor": "hip*"}],
                "links": [{"from": "hip", "to": "knee"}, {"from": "hip", "to": "hip"}],
            },
            {
                "brain/links/0/to": "the motor 'knee' has no oscillator",
                "brain/links/1": "links an oscillator with itself",
            },
        ),
        (
            {"kind": "cpg", "oscillators": [{"motor": "*"}], "feedback": [{"sensor": "hip", "motor": "hip"}]},
            {"brain/feedback/0/sensor": "there is no sensor 'hip'"},
        ),
        ({"kind": "mlp", "layers": [LAYER, {"weights": [[1, 2]], "biases": [1, 2]}]}, {
            "brain/layers/1/weights": "has 2 columns, and there must be 5, one for each unit of the layer before",
            "brain/layers/1/biases": "has 2 numbers, and there must be 1, one for each row of the weights",
        }),
        ({"kind": "mlp", "layers": [{**LAYER, "weights": [[1, 2], [1, 2, 3]]}]}, {
            "brain/layers/0/weights/1": "has 3 numbers, the first row 2",
        }),
        ({"kind": "mlp", "layers": [{"weights": [[1, 2]], "biases": [1]}]}, {
            "brain/layers/0/weights": "has 2 columns, and the body has 5 sensors: a list 'inputs' would say",
        }),
        ({"kind": "mlp", "inputs": ["hip.*"], "outputs": ["nose"], "layers": [{"weights": [[1, 2]], "biases": [1]}]}, {
            "brain/outputs/0": "there is no motor 'nose'",
            "brain/layers/0/weights": "has 2 columns, and there must be 1, one for each entry of inputs",
        }),
        ({"kind": "ctrnn", "time_constants": [1, 0], "biases": [1], "weights": [[1]], "input_weights": [[1]]}, {
            "brain/time_constants/1": "expected a number from 0.001 to 1,000 s, got 0",
        }),
        ({"kind": "ctrnn", "time_constants": [1, 1], "biases": [1], "weights": [[1]], "input_weights": [[1] * 5]}, {
            "brain/biases": "has 1 numbers, and there must be 2, one for each neuron",
            "brain/time_constants": "has 2 neurons, too few for 5 outputs",
        }),
        (graph([{"id": "a"}, {"id": "a"}]), {
            "brain/nodes/1/id": "there is another node 'a'",
            "brain/nodes": "no node drives a motor",
        }),
        (graph([{"id": "a", "motor": "*"}], ("b", "a", 1), ("a", "*", 1), ("hip.x", "a", 1)), {
            "brain/links/0/from": "there is no node 'b'; there is a",
            "brain/links/1/to": "there is no node '*'",
            "brain/links/2/sensor": "there is no sensor 'hip.x'",
        }),
        ({**graph([{"id": "a", "motor": "*"}]), "links": [{"to": "a"}, *[{"from": "a", "to": "a"}] * 2]}, {
            "brain/links/0": "must have either 'from' or 'sensor'",
            "brain/links/2": "links what link 1 does",
        }),
    ],
)  # fmt: skip
def test_all_mistakes_of_a_document_are_reported_with_their_paths(document: Any, wanted: dict[str, str]) -> None:
    with pytest.raises(DocumentError) as caught:
        load_brain(document, SENSORS, MOTORS)
    findings = caught.value.problems
    for path, words in wanted.items():
        assert any(at == path and words in message for at, message in findings), findings
    assert (caught.value.code, caught.value.path) == ("invalid", caught.value.problems[0][0])


def test_too_many_links_are_refused() -> None:
    names = [f"m{i}" for i in range(100)]
    document = {"kind": "cpg", "oscillators": [{"motor": "*"}], "links": [{"from": "*", "to": "*"}]}
    with pytest.raises(DocumentError, match="links/0: with it there are over 4,096 links between two"):
        load_brain(document, [], names)


def test_a_body_too_large_for_a_brain_is_refused() -> None:
    with pytest.raises(DocumentError, match="has 5,000 sensors; a brain can have 4,096\nbrain: the body has 2,000"):
        load_brain(sine("*"), [f"s{i}" for i in range(5000)], [f"m{i}" for i in range(2000)])


def test_a_parameter_vector_of_another_length_is_refused() -> None:
    brain = load(sine("*"))
    for vector, words in (
        ([1.0] * 4, r"5 parameters; the vector has shape \(4,\)"),
        ([1, 2, np.nan, 4, np.inf], "number 2 "),
    ):
        with pytest.raises(DocumentError, match=words):
            brain.with_vector(np.array(vector))


def test_only_brains_of_the_same_structure_are_stacked() -> None:
    with pytest.raises(ValueError, match="no brains"):
        stack([])
    with pytest.raises(ValueError, match="brain 1 differs"):
        stack([load(sine("*")), load(sine("hip"))])
    with pytest.raises(ValueError, match="brain 1 differs"):
        stack([load(sine("*")), load_brain(sine("*"), SENSORS, ["one"])])
    batch = stack([load(sine("*"))] * 3)
    with pytest.raises(ValueError, match="3 brains and 2 seeds"):
        batch.reset([1, 2], DT)


# -- memories ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("done", [0, 1, 63, 64, 65, 130])
@given(made=brains(), seed=st.integers(0, 2**40))
@settings(max_examples=20)
def test_a_brain_goes_on_from_its_memory_bit_for_bit(done: int, made: Made, seed: int) -> None:
    document, sensors, motors = made
    readings = np.random.default_rng(seed).normal(size=(done + 70, len(sensors)))
    first, second = load_brain(document, sensors, motors), load_brain(document, sensors, motors)
    first.reset(seed, DT)
    for row in readings[:done]:
        first.step(row)
    memory = first.memory()
    second.reset(seed, DT)
    second.recall(memory)
    assert bits(second.memory()) == bits(memory)
    for row in readings[done:]:
        assert bits(second.step(row)) == bits(first.step(row))
    assert bits(second.memory()) == bits(first.memory())


@pytest.mark.parametrize("kind", ["sine", "cpg", "ctrnn", "graph"])
def test_a_memory_that_is_none_is_refused(kind: str) -> None:
    brain = load(examples_of(kind)[0])
    brain.reset(0, DT)
    memory = brain.memory()
    wrong = [np.append(memory, 0.0), memory[:-1], np.full_like(memory, np.nan)]
    wrong += [np.full_like(memory, value) for value in (-1.0, 0.5, 2.0**60)] if kind == "sine" else []
    for other in wrong:
        with pytest.raises(ValueError, match="no memory"):
            brain.recall(other)
