"""Policies: probabilities by their formulas, slopes by differences, and actions as often as they are probable."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np
import pytest

from nmes.learning.learners.policies import Policy, policy_of
from nmes.learning.learners.rows import Spaces
from nmes.variation.draw import Draw
from slopes import slopes

CONTROLS, CHOICES = policy_of(Spaces(4, 3)), policy_of(Spaces(4, 3, choices=True))
OWN = np.log([0.5, 1.0, 2.0])


def outputs(count: int) -> np.ndarray:
    return Draw(1, "outputs").normals(3 * count).reshape(count, 3)


def test_controls_are_as_probable_as_the_normal_distribution_says() -> None:
    means, actions = outputs(5), outputs(10)[5:]
    found = CONTROLS.likelihood(means, OWN, actions)
    for row in range(5):
        normals = [NormalDist(mean, math.exp(own)) for mean, own in zip(means[row], OWN, strict=True)]
        densities = [math.log(each.pdf(action)) for each, action in zip(normals, actions[row], strict=True)]
        assert found.logs[row] == pytest.approx(sum(densities))
    entropy = sum(0.5 * math.log(2 * math.pi * math.e * math.exp(2 * own)) for own in OWN)
    np.testing.assert_allclose(found.entropies, entropy)


def test_choices_are_as_probable_as_softmax_says() -> None:
    given = 30.0 * outputs(5)
    parts = np.exp(given - given.max(axis=1, keepdims=True))
    parts /= parts.sum(axis=1, keepdims=True)
    actions = np.array([[0.0], [1.0], [2.0], [1.0], [0.0]])
    found = CHOICES.likelihood(given, np.empty(0), actions)
    chosen = parts[np.arange(5), actions[:, 0].astype(int)]
    np.testing.assert_allclose(np.exp(found.logs), chosen, rtol=1e-12)
    np.testing.assert_allclose(found.entropies, [-(row[row > 0] * np.log(row[row > 0])).sum() for row in parts])


@pytest.mark.parametrize("policy", [CONTROLS, CHOICES], ids=["controls", "choices"])
def test_slopes_are_those_by_differences(policy: Policy) -> None:
    own = OWN if policy.count else np.empty(0)
    given, weights = outputs(6), Draw(2).normals(12).reshape(2, 6)
    actions = policy.draw(given, own, Draw(3))

    def worth(outputs: np.ndarray, own: np.ndarray) -> float:
        found = policy.likelihood(outputs, own, actions)
        return float((weights[0] * found.logs + weights[1] * found.entropies).sum())

    by_outputs, by_own = policy.likelihood(given, own, actions).slopes(*weights)
    np.testing.assert_allclose(by_outputs, slopes(lambda point: worth(point, own), given), rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(by_own, slopes(lambda point: worth(given, point), own), rtol=1e-6, atol=1e-7)


def test_choices_are_drawn_as_often_as_they_are_probable() -> None:
    parts = np.array([0.7, 0.1, 0.2])
    drawn = CHOICES.draw(np.tile(np.log(parts), (4000, 1)), np.empty(0), Draw(1))[:, 0]
    np.testing.assert_allclose(np.bincount(drawn.astype(int), minlength=3) / 4000, parts, atol=0.025)
    assert (CHOICES.best(np.log(parts)[None]) == [[0.0]]).all()


def test_controls_are_drawn_around_their_means_and_done_within_bounds() -> None:
    means = np.array([0.5, -0.25, 3.0])
    drawn = CONTROLS.draw(np.tile(means, (4000, 1)), OWN, Draw(1))
    np.testing.assert_allclose(drawn.mean(axis=0), means, atol=0.1)
    np.testing.assert_allclose(drawn.std(axis=0), np.exp(OWN), rtol=0.05)
    assert (CONTROLS.act(np.array([[-3.0, 0.5, 1.5]])) == [[-1.0, 0.5, 1.0]]).all()
    assert (CONTROLS.best(means[None]) == [[0.5, -0.25, 1.0]]).all()
