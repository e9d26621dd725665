"""What the candidates of a run tell together."""

from __future__ import annotations

from statistics import median

from nmes.evolution.history import History, OperatorRecord, milestones
from run_rows import Row, history


def test_champions_are_those_that_beat_all_before_them() -> None:
    told = history(None, 1.0, 0.5, 1.0, -3.0, 2.5, None, 2.4)
    assert [row.index for row in told.champions()] == [1, 5]
    assert history(None, None).champions() == []


def test_of_equal_scores_the_earlier_is_better() -> None:
    told = history(1.0, 3.0, None, 3.0, 2.0)
    assert [row.index for row in told.top(3)] == [1, 3, 4]
    assert [row.index for row in told.top(10)] == [1, 3, 4, 0]


def test_a_lineage_follows_the_parent_that_each_is_mostly_like() -> None:
    rows = [Row(0), Row(1), Row(2, parents=(1, 0)), Row(3, parents=(0,)), Row(4, parents=(2, 3))]
    told = History(rows)
    assert [row.index for row in told.lineage(4)] == [1, 2, 4]
    assert [row.index for row in told.lineage(0)] == [0]


def test_a_log_that_makes_somebody_its_own_ancestor_has_an_end() -> None:
    told = History([Row(0, 1.0, parents=(1,)), Row(1, 2.0, parents=(0,)), Row(2, 3.0, parents=(7,))])
    assert [row.index for row in told.lineage(1)] == [0, 1] and [row.index for row in told.lineage(2)] == [2]
    assert sum(record.better for record in told.operators()) == 1


def test_milestones_are_the_ends_and_the_greatest_gains() -> None:
    rows = history(1.0, 2.0, None, 1.5, 7.0, 7.5, 9.0, 8.0).rows
    assert [row.index for row in milestones(rows, 9)] == [0, 1, 4, 5, 6, 7]
    assert [row.index for row in milestones(rows, 4)] == [0, 4, 6, 7]
    assert [row.index for row in milestones(rows, 2)] == [0, 7]
    assert milestones(rows[:1], 2) == [rows[0]]
    assert [row.index for row in milestones(history(1.0, 3.0, 3.0, 2.0).rows, 9)] == [0, 1, 3]  # as good is no gain


def test_operators_are_judged_by_the_first_parent() -> None:
    rows = [
        Row(0, 1.0),
        Row(1, 5.0),
        Row(2, 2.0, "cross", (0, 1)),
        Row(3, 2.0, "cross", (1, 0)),
        Row(4, None, "cross", (0, 1)),
        Row(5, 6.0, "add-part+cross+add-part", (1,)),
        Row(6, 1.0, "add-part", (4,)),
    ]
    assert History(rows).operators() == [
        OperatorRecord("cross", 4, without_score=1, better=2, champions=1),
        OperatorRecord("add-part", 2, without_score=0, better=1, champions=1),
        OperatorRecord("random", 2, without_score=0, better=0, champions=2),
    ]


def test_windows_cover_every_candidate_once_and_have_quartiles() -> None:
    told = history(*(float(index % 100) for index in range(1234)))
    windows = told.windows()
    assert [window.begin for window in windows[1:]] == [window.end for window in windows[:-1]]
    assert (windows[0].begin, windows[-1].end) == (0, 1234)
    for window in windows:
        scores = [row.score for row in told.rows[window.begin : window.end] if row.score is not None]
        assert window.quartiles is not None and window.quartiles[1] == median(scores)
        assert min(scores) <= window.quartiles[0] <= window.quartiles[1] <= window.quartiles[2] <= max(scores)
        assert window.groups == {"": len(scores)}


def test_windows_are_the_generations_where_these_do_not_mix() -> None:
    rows = [Row(index, 1.0, generation=index // 20) for index in range(90)]
    assert [(window.begin, window.end) for window in History(rows).windows()] == [
        (0, 20), (20, 40), (40, 60), (60, 80), (80, 90)
    ]  # fmt: skip
    mixed = [Row(index, 1.0, generation=index % 7) for index in range(90)]
    assert [window.end for window in History(mixed).windows()] == [10, 20, 30, 40, 50, 60, 70, 80, 90]


def test_a_window_without_two_scores_has_no_quartiles() -> None:
    assert history(None, 1.0, None).windows()[0].quartiles is None
    assert history().windows() == [history().windows()[0]] and history().windows()[0].end == 0
