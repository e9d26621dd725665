"""What learners gather: steps in their order, what they came to be worth by hand, and what normalises them."""

from __future__ import annotations

import numpy as np
import pytest

from nmes.learning.learners.experience import Collector, Experience, Scale, advantages, discounted


class Counting:
    """Rows that see their own step, and whose episodes are over after 2 and 3 steps; the second is cut off."""

    lasting = np.array([2, 3])

    def __init__(self) -> None:
        self.last_observations = np.full((2, 1), np.nan)
        self._step = np.zeros(2, int)

    def reset(self, seed: int) -> np.ndarray:
        self._step[...] = 0
        return self._step[:, None].astype(float)

    def step(self, actions: np.ndarray, /) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        self._step += 1
        over = self._step == self.lasting
        self.last_observations[over] = self._step[over, None]
        self._step[over] = 0
        first = np.array([True, False])
        return self._step[:, None].astype(float), actions[:, 0] + 1.0, over & first, over & ~first


def collected(*steps: int) -> list[Experience]:
    collector = Collector(Counting(), 1)
    return [collector.collect(each, 1, lambda seen: 10.0 * seen, lambda actions: actions) for each in steps]


def test_steps_are_gathered_in_order_and_episodes_go_on_between_blocks() -> None:
    one, two = collected(2, 2)
    assert one.observations[..., 0].tolist() == [[0, 0], [1, 1]]
    assert one.following[..., 0].tolist() == [[1, 1], [2, 2]]  # the end of the first row's, not the next start
    assert two.observations[..., 0].tolist() == [[0, 2], [1, 0]]
    assert two.following[..., 0].tolist() == [[1, 3], [2, 1]]
    assert one.actions[..., 0].tolist() == [[0, 0], [10, 10]]
    assert one.terminated.tolist() == [[False, False], [True, False]]
    assert two.over.tolist() == [[False, True], [True, False]]
    assert two.terminated.tolist() == [[False, False], [True, False]]
    assert (one.returns, one.lengths) == ((12.0,), (2,))
    assert (two.returns, two.lengths) == ((33.0, 12.0), (3, 2))


def test_advantages_are_those_by_hand() -> None:
    (experience,) = collected(3)
    rewards = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    values = np.array([[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]])
    after = np.array([[0.3, 0.4], [9.0, 0.6], [0.7, 0.8]])
    gamma, decay = 0.9, 0.8
    found = advantages(experience, rewards, values, after, gamma, decay)
    # The first row terminates in its second step: nothing comes after it. The second is cut off in its third, where the
    # critic's value goes on.
    second = 3.0 - 0.3
    assert found[:, 0].tolist() == pytest.approx([1.0 + 0.9 * 0.3 - 0.1 + 0.72 * second, second, 5.0 + 0.63 - 0.5])
    third = 6.0 + 0.9 * 0.8 - 0.6
    middle = 4.0 + 0.9 * 0.6 - 0.4 + 0.72 * third
    assert found[:, 1].tolist() == pytest.approx([2.0 + 0.9 * 0.4 - 0.2 + 0.72 * middle, middle, third])


def test_discounted_sums_begin_anew_with_an_episode() -> None:
    over = np.array([[False], [True], [False]])
    assert discounted(np.array([[1.0], [2.0], [4.0]]), over, 0.5)[:, 0].tolist() == [1.0, 2.5, 4.0]


def test_a_scale_knows_mean_and_deviation_of_all_rows() -> None:
    draw = np.random.default_rng(1)
    rows = draw.normal([5.0, -3.0, 0.0], [2.0, 0.1, 0.0], size=(700, 3))
    scale = Scale(3)
    assert (scale.apply(rows) == rows).all()
    for part in np.split(rows, [1, 30, 500]):
        scale.take(part)
    np.testing.assert_allclose(scale.means, rows.mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(scale.variances, rows.var(axis=0), atol=1e-12)
    applied = scale.apply(rows)
    np.testing.assert_allclose(applied[:, :2].std(axis=0), 1.0)
    assert (applied[:, 2] == 0.0).all()
