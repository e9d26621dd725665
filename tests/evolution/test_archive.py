"""The archive of the best of every kind: which cell a candidate is in, and who stays there."""

from __future__ import annotations

import pytest

from nmes.evolution.algorithm import Measure
from nmes.evolution.archive import Archive, Elite, cell
from vectors import vector_genome

GENOME = vector_genome([0.0] * 4)
MEASURES = (Measure("legs", 0.0, 4.0, 4), Measure("mass", -1.0, 1.0, 5))


@pytest.mark.parametrize(
    ("values", "place"),
    [
        ((0.0, -1.0), (0, 0)),
        ((0.99, -0.61), (0, 0)),
        ((1.0, 0.0), (1, 2)),
        ((4.0, 1.0), (3, 4)),
        ((-7.0, 1e300), (0, 4)),
        ((1e308, -1e308), (3, 0)),
    ],
)
def test_cells_are_equal_parts_of_the_ranges_and_those_at_the_ends_hold_what_is_beyond(
    values: tuple[float, ...], place: tuple[int, ...]
) -> None:
    assert cell(MEASURES, values) == place


def test_the_best_of_each_cell_stays_and_of_equals_the_first() -> None:
    archive = Archive(MEASURES)
    told = [(3.0, (1.0, 0.0)), (5.0, (3.5, 0.9)), (4.0, (1.5, 0.1)), (4.0, (1.2, 0.0)), (1.0, (3.1, 0.8))]
    gains = [archive.add(Elite(index, GENOME, score), values) for index, (score, values) in enumerate(told)]
    assert gains == [None, None, 1.0, 0.0, -4.0]
    assert archive.indices() == [1, 2]
    assert len(archive) == 2 and [archive[number].index for number in range(2)] == [2, 1]
    assert archive.coverage == 0.1
    assert archive.quality == 9.0
