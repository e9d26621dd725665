"""The arithmetic of learners is that of mathematics, and does not depend on how many rows are computed at once."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nmes.learning.learners.arithmetic import average, dot, exp, gathered, spread, tanh, weighed

NUMBERS = np.concatenate([np.linspace(-40.0, 40.0, 4001), [0.0, -0.0, 1e-9, -1e-300, 1e300, -1e300]])


def test_exp_is_that_of_the_c_library_to_the_last_bits() -> None:
    expected = [math.exp(min(max(value, -700.0), 700.0)) for value in NUMBERS.tolist()]
    np.testing.assert_allclose(exp(NUMBERS), expected, rtol=1e-15)


def test_tanh_is_that_of_the_c_library_to_the_last_bits() -> None:
    np.testing.assert_allclose(tanh(NUMBERS), [math.tanh(value) for value in NUMBERS.tolist()], rtol=0, atol=4e-16)
    assert math.copysign(1.0, tanh(np.array([-0.0]))[0]) == -1.0


def test_sums_are_products_of_matrices_whatever_the_number_of_rows() -> None:
    draw = np.random.default_rng(1)
    rows, weights, sums = draw.normal(size=(33, 26)), draw.normal(size=(64, 26)), draw.normal(size=(33, 64))
    np.testing.assert_allclose(weighed(rows, weights), rows @ weights.T, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(spread(sums, weights), sums @ weights, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(gathered(sums, rows), sums.T @ rows, rtol=1e-12, atol=1e-12)
    for function, left, right in ((weighed, rows, weights), (spread, sums, weights)):
        alone = np.concatenate([function(left[row : row + 1], right) for row in range(len(left))])
        assert (alone == function(left, right)).all()
    assert dot(rows, rows) == pytest.approx(float((rows * rows).sum()))
    assert average(np.array([1.0, 2.0, 6.0])) == 3.0 and average(np.empty(0)) == 0.0
