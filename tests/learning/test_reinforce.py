"""REINFORCE: its gradient by differences, and that it learns."""

from __future__ import annotations

import numpy as np
import pytest

from nmes.learning.learners.reinforce import Reinforce, policy_loss
from nmes.learning.learners.rows import Spaces
from nmes.variation.draw import Draw
from slopes import slopes
from teaching import Follow, mean_returns

SMALL = Reinforce.Options(rows=32, ticks=20, units=16, rate=1e-2, critic_rate=1e-2, gamma=0.5, spread=0.3)


@pytest.mark.parametrize("spaces", [Spaces(3, 2), Spaces(3, 4, choices=True)], ids=["controls", "choices"])
def test_the_gradient_of_its_loss_is_that_by_differences(spaces: Spaces) -> None:
    learner, draw = Reinforce(spaces, Reinforce.Options(units=5), Draw(1)), Draw(2)
    parameters = learner.parameters + 0.3 * draw.normals(len(learner.parameters))
    seen = draw.normals(60).reshape(20, 3)
    actions = (
        np.floor(3.0 * draw.normals(20 * learner.policy.width).reshape(20, -1)) % 4 if spaces.choices else seen[:, :2]
    )
    better = draw.normals(20)
    gradient, _ = policy_loss(learner, parameters, seen, actions, better)
    found = slopes(lambda point: policy_loss(learner, point, seen, actions, better)[1], parameters)
    np.testing.assert_allclose(gradient, found, rtol=1e-5, atol=1e-6)
    assert not gradient[-learner.critic_count :].any() and gradient.any()


@pytest.mark.parametrize("choices", [False, True], ids=["controls", "choices"])
def test_it_learns_what_is_rewarded(choices: bool) -> None:
    rows = Follow(SMALL.rows, choices=choices)
    returns = mean_returns(Reinforce(rows.spaces, SMALL, Draw(1)), rows, 80, SMALL.ticks)
    assert returns[0] < 14.0
    assert returns[-1] > 16.0


def test_it_goes_on_from_its_arrays() -> None:
    whole, first = Reinforce(Spaces(2, 1), SMALL, Draw(1)), Reinforce(Spaces(2, 1), SMALL, Draw(1))
    for learner in (whole, first):
        mean_returns(learner, Follow(SMALL.rows), 2, SMALL.ticks)
    other = Reinforce(Spaces(2, 1), SMALL, Draw(9))
    for name, array in other.arrays().items():
        array[...] = first.arrays()[name]
    for learner in (whole, other):
        mean_returns(learner, Follow(SMALL.rows), 2, SMALL.ticks)
    assert all(array.tobytes() == other.arrays()[name].tobytes() for name, array in whole.arrays().items())
