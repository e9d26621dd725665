"""Statistics of runs: what they are by definition, and that intervals are as wide as theory has them."""

from __future__ import annotations

from collections.abc import Sequence
from math import isclose, sqrt

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from nmes.study.statistics import estimate, improvement, iqm, mean, median
from nmes.variation.draw import Draw

NUMBERS = st.floats(-1e6, 1e6)
STRATA = st.lists(st.lists(NUMBERS, min_size=3, max_size=8), min_size=1, max_size=4)


def arrays(strata: Sequence[Sequence[float]]) -> list[np.ndarray]:
    return [np.array(runs, np.float64) for runs in strata]


def test_the_interquartile_mean_is_that_of_the_middle_half_of_all_cells() -> None:
    assert iqm(arrays([[0, 1, 2, 3], [4, 5, 6, 700]])) == 3.5
    assert iqm(arrays([[1, 2, 6]])) == 3.0  # a quarter of three is none
    assert iqm(arrays([[-100, 1, 2, 3, 100]])) == 2.0
    assert median(arrays([[1, 9], [3, 5]])) == 4.0


def test_improvement_counts_pairs_of_each_cell_alone() -> None:
    assert improvement(arrays([[1, 2]]), arrays([[0, 1]])) == 0.875  # three of four better, one equal
    assert improvement(arrays([[5, 6], [100, 100]]), arrays([[1, 2], [200, 200]])) == 0.5


@given(STRATA)
def test_statistics_lie_between_the_least_and_the_greatest(strata: list[list[float]]) -> None:
    every = [value for runs in strata for value in runs]
    for statistic in (iqm, mean, median):
        found = estimate(statistic, [arrays(strata)], ["any"])
        slack = 1e-9 * max(map(abs, every))
        assert min(every) - slack <= found.low <= found.high <= max(every) + slack
        assert min(every) - slack <= found.value <= max(every) + slack
    assert found.runs == len(every)


@given(STRATA, st.data())
def test_one_of_two_arms_improves_on_the_other(strata: list[list[float]], data: st.DataObject) -> None:
    others = [data.draw(st.lists(NUMBERS, min_size=3, max_size=8)) for _ in strata]
    ours, theirs = arrays(strata), arrays(others)
    assert isclose(float(improvement(ours, theirs)) + float(improvement(theirs, ours)), 1.0)
    assert improvement(ours, ours) == 0.5


@given(STRATA)
def test_the_order_of_cells_changes_no_value_and_the_path_decides_the_interval(strata: list[list[float]]) -> None:
    runs = arrays(strata)
    assert isclose(float(iqm(runs)), float(iqm(runs[::-1])), abs_tol=1e-6)
    assert estimate(iqm, [runs], ["a"]) == estimate(iqm, [runs], ["a"])


def test_intervals_are_as_wide_as_theory_has_them() -> None:
    runs = Draw(1, "normal").normals(400)
    found = estimate(mean, [[runs]], ["width"])
    expected = 2 * 1.96 * float(runs.std()) / sqrt(len(runs))
    assert isclose(found.high - found.low, expected, rel_tol=0.05)
    assert found.low < found.value < found.high


def test_seeds_are_drawn_within_their_cells() -> None:
    """Between cells that differ much, but not in themselves, there is no doubt about the mean."""
    found = estimate(mean, [arrays([[0, 0, 0], [1000, 1000, 1000]])], ["strata"])
    assert found.low == found.value == found.high == 500.0
