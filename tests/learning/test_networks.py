"""Networks: their gradients by differences, their first weights, their brains, and Adam."""

from __future__ import annotations

import numpy as np
import pytest

from nmes.brain import load_brain
from nmes.learning.learners.networks import Adam, Network, clipped, read_layers
from nmes.variation.draw import Draw
from slopes import slopes

NETWORK = Network((5, 7, 6, 3))


def test_a_gradient_is_that_by_differences() -> None:
    draw = Draw(1, "test")
    parameters = NETWORK.initial(draw, 1.0) + 0.1 * draw.normals(NETWORK.count)
    rows, weights = draw.normals(40).reshape(8, 5), draw.normals(24).reshape(8, 3)

    def worth(values: np.ndarray) -> float:
        return float((weights * NETWORK.forward(values, rows).outputs).sum())

    found = NETWORK.backward(parameters, NETWORK.forward(parameters, rows), weights)
    np.testing.assert_allclose(found, slopes(worth, parameters), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("sizes", [(5, 7), (7, 5), (6, 6)])
def test_first_weights_are_at_right_angles(sizes: tuple[int, int]) -> None:
    network = Network((*sizes, 2))
    (weights, biases), (last, _) = network.layers(network.initial(Draw(3), 0.01))
    few = weights if len(weights) <= weights.shape[1] else weights.T
    np.testing.assert_allclose(few @ few.T, 2.0 * np.eye(len(few)), atol=1e-12)
    np.testing.assert_allclose(last @ last.T, 1e-4 * np.eye(2), atol=1e-15)
    assert not biases.any()


def test_its_brain_does_what_it_does() -> None:
    draw = Draw(2, "test")
    parameters = 0.5 * draw.normals(NETWORK.count)
    means, scales = 10.0 * draw.normals(5), np.abs(draw.normals(5)) + 0.01
    brain = load_brain(NETWORK.document(parameters, means, scales), [*"abcde"], [*"xyz"])
    brain.reset(seed=0, dt=0.1)
    for _ in range(20):
        read = means + scales * draw.normals(5)
        expected = np.clip(NETWORK.forward(parameters, ((read - means) / scales)[None]).outputs[0], -1.0, 1.0)
        np.testing.assert_allclose(brain.step(read), expected, rtol=0, atol=1e-9)


def test_a_brain_is_read_as_the_network_that_it_was_made_of() -> None:
    parameters = Draw(4).normals(NETWORK.count)
    found = read_layers(NETWORK.document(parameters, np.zeros(5), np.ones(5)), 5)
    assert found is not None
    assert found[0].sizes == NETWORK.sizes
    np.testing.assert_array_equal(found[1], parameters)


@pytest.mark.parametrize("change", [{"activation": "relu"}, {"activation": "tanh"}])
def test_layers_of_another_kind_are_no_such_network(change: dict[str, str]) -> None:
    document = NETWORK.document(np.ones(NETWORK.count), np.zeros(5), np.ones(5))
    place = 0 if change["activation"] == "relu" else -1
    document["layers"][place] |= change
    assert read_layers(document, 5) is None
    document["layers"][place]["activation"] = "identity" if place else "tanh"
    assert read_layers(document, 5) is not None
    assert read_layers({**document, "outputs": [*"xyz"]}, 5) is None
    assert read_layers({"kind": "sine", "oscillators": []}, 5) is None


def test_rescaled_parameters_give_what_they_gave_before() -> None:
    draw = Draw(5)
    parameters, rows = draw.normals(NETWORK.count), draw.normals(10).reshape(2, 5)
    before = NETWORK.forward(parameters, rows).outputs
    ratios, shifts = np.abs(draw.normals(5)) + 0.1, draw.normals(5)
    NETWORK.rescaled(parameters, ratios, shifts)
    np.testing.assert_allclose(NETWORK.forward(parameters, (rows - shifts) / ratios).outputs, before, atol=1e-12)


def test_adam_goes_as_its_paper_says() -> None:
    point, adam = np.array([1.0, -2.0]), Adam(2)
    first, second, there = np.zeros(2), np.zeros(2), point.copy()
    for step, gradient in enumerate(([0.5, -3.0], [0.25, 1.0], [-4.0, 0.0]), 1):
        slope = np.array(gradient)
        adam.step(point, slope, 0.1)
        first, second = 0.9 * first + 0.1 * slope, 0.999 * second + 0.001 * slope**2
        there -= 0.1 * (first / (1 - 0.9**step)) / (np.sqrt(second / (1 - 0.999**step)) + 1e-5)
        np.testing.assert_allclose(point, there, rtol=1e-12)


def test_a_gradient_that_is_too_long_is_shortened_and_keeps_its_direction() -> None:
    np.testing.assert_allclose(clipped(np.array([3.0, 4.0]), 0.5), [0.3, 0.4])
    np.testing.assert_array_equal(clipped(np.array([3.0, 4.0]), 5.0), [3.0, 4.0])
