"""The pictures of runs: what is drawn is what the candidates say, and a stranger's text stays text."""

from __future__ import annotations

import base64
import io
import re
from sys import float_info
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from nmes.errors import visible
from nmes.evolution.algorithm import Measure
from nmes.evolution.champions import Champion
from nmes.evolution.history import History
from nmes.genome import Genome
from nmes.genome.preview import render_cutout
from nmes.view.chart import Chart, Picture, png_source, round_numbers
from nmes.view.run_archive import archive_map
from nmes.view.run_curves import fitness_curves, groups_over_time
from nmes.view.run_eras import ancestors_map, era_curves
from nmes.view.run_front import front_plot
from nmes.view.run_tree import lineage_tree
from nmes.view.survey_map import survey_map
from run_rows import Row, history

HOSTILE = '<script>alert("x")</script>\u202e'
WALKER = Genome.load("walker").body


def parsed(picture: Picture) -> ElementTree.Element:
    """Reads a picture's file as XML; nothing in it leads elsewhere."""
    file = picture.file()
    root = ElementTree.fromstring(file)
    for element in root.iter():
        assert all(value.startswith("data:image/png;base64,") for name, value in element.items() if "href" in name)
    assert "<script" not in file and "http" not in file.replace('xmlns="http://www.w3.org/2000/svg"', "")
    told = [element.text for element in root if element.tag.endswith(("title", "desc"))]
    assert told == [visible(picture.title), visible(picture.description)] and all(told)
    return root


def elements(picture: Picture, tag: str) -> list[ElementTree.Element]:
    return [element for element in parsed(picture).iter() if element.tag.endswith("}" + tag)]


def words(picture: Picture) -> list[str]:
    return [element.text or "" for element in elements(picture, "text")]


def points(element: ElementTree.Element) -> list[tuple[float, float]]:
    pairs = (pair.split(",") for pair in element.get("points", "").split())
    return [(float(x), float(y)) for x, y in pairs]


def portrait(index: int, width: int, height: int) -> str:
    return f"data:image/png;base64,{index}-{width}x{height}"


def inside(picture: Picture) -> bool:
    """Whether all that has a place lies in the picture."""
    for element in parsed(picture).iter():
        x, y = float(element.get("x", 0)), float(element.get("y", 0))
        wide, high = (float(element.get(name, 0)) for name in ("width", "height"))
        if "transform" not in element.keys() and not (
            -0.1 <= x <= x + wide <= picture.width + 0.1 and -0.1 <= y <= y + high <= picture.height + 0.1
        ):
            return False
    return True


@pytest.mark.parametrize(
    ("least", "most", "numbers"),
    [
        (0.0, 1.0, [0.0, 0.25, 0.5, 0.75, 1.0]),
        (0.0, 0.0, [0.0, 0.25, 0.5, 0.75, 1.0]),
        (3.0, 3.0, [3.0, 3.1, 3.2, 3.3]),
        (-1e-12, 0.0, [-0.25, 0.0, 0.25, 0.5, 0.75, 1.0]),
        (-7.0, 12.0, [-10.0, -5.0, 0.0, 5.0, 10.0, 15.0]),
    ],
)
def test_the_numbers_of_an_axis_are_round_and_go_round_the_range(
    least: float, most: float, numbers: list[float]
) -> None:
    found = round_numbers(least, most)
    assert found[0] <= least and found[-1] >= most and len(found) >= 2
    assert found == pytest.approx(numbers)


def test_great_numbers_on_an_axis_are_written_out() -> None:
    chart = Chart((0.0, 5e6), (0.0, 4e6))
    axes = "".join(chart.axes("steps", "score"))
    assert ">5,000,000<" in axes and ">4,000,000<" in axes
    assert chart.x(5e6) + 6.5 * len("5,000,000") / 2 <= chart.width


def test_the_curve_of_the_best_rises_where_a_champion_came_and_the_band_is_round_the_median() -> None:
    scores = [None, *(float(index % 10 + index // 20) for index in range(199))]
    picture = fitness_curves(history(*scores), "score on walk")
    best, median = elements(picture, "polyline")[0], elements(picture, "polyline")[1]
    if best.get("class") != "s1":
        best, median = median, best
    heights = [y for _, y in points(best)]
    assert heights == sorted(heights, reverse=True) and len(set(heights)) == len(history(*scores).champions())
    (band,) = elements(picture, "polygon")
    corners = points(band)
    half = len(corners) // 2
    for (x, y), low, high in zip(points(median), corners[:half], corners[half:][::-1], strict=True):
        assert x == low[0] == high[0] and high[1] <= y <= low[1]
    assert "score on walk" in words(picture) and inside(picture)
    assert picture.description == "The best score rises from 0 to 18, which candidate 190 reached."


@pytest.mark.parametrize("scores", [(0.0, 5.0), (-0.0048, -0.0031), (-1.25e-300, 0.0), (12_345_678.0, 12_345_679.0)])
def test_the_numbers_of_the_left_axis_leave_room_for_its_title(scores: tuple[float, float]) -> None:
    texts = elements(fitness_curves(history(*scores), "score"), "text")
    (title,) = (text for text in texts if text.get("transform"))
    right_of_title = float(title.get("transform", "").removeprefix("translate(").split()[0]) + 4  # what hangs below
    numbers = [text for text in texts if text.get("text-anchor") == "end"]
    assert len({number.text for number in numbers}) == len(numbers) >= 2
    for number in numbers:
        assert float(number.get("x", "")) - 6.5 * len(number.text or "") >= right_of_title


@pytest.mark.parametrize("score", [2.0, 0.0, -1e20, 1e300])
def test_a_run_whose_scores_are_all_the_same_has_pictures(score: float) -> None:
    assert inside(fitness_curves(history(None, score), "score"))
    rows = [Row(0, score, objectives=(score, -score)), Row(1, score, objectives=(score, -score))]
    assert inside(front_plot(History(rows), rows, ("a", "b"), portrait))


@pytest.mark.parametrize("low", [-float_info.max, -1e300, 0.0, 1.6e308, float_info.max])
def test_scores_at_the_ends_of_what_numbers_there_are_have_pictures(low: float) -> None:
    """The distance of two such is greater than any number, and so is four times one of them, as quartiles want it."""
    scores, greatest = [low, float_info.max] * 6, float_info.max
    rows = [Row(i, score, objectives=(score, -score), measures=(i % 4, i % 3, 0.5)) for i, score in enumerate(scores)]
    teams = [Row(i, score, group="ab"[i % 2]) for i, score in enumerate(scores)]
    halls = {role: [Champion(i // 4, row) for i, row in enumerate(teams) if row.group == role] for role in "ab"}  # type: ignore[arg-type]
    first = halls["a"][:2]
    meetings = {(one.record.index, other.record.index): low for one in first for other in first}
    pictures = [
        fitness_curves(History(rows), "score"),
        front_plot(History(rows), rows[:4], ("a", "b"), portrait),
        drawn(rows),
        era_curves(teams, halls, 2, "score"),
        ancestors_map("eras", ("a", first), ("a", first), {**meetings, (0, 0): greatest}),
        survey_map([scores, [low]], [""], ["one", "two"], "m"),
    ]
    for picture in pictures:
        assert inside(picture) and not re.search(r"\b(nan|inf)\b", picture.content), picture.name
        for line in (*elements(picture, "polyline"), *elements(picture, "polygon")):
            assert all(-0.1 <= y <= picture.height + 0.1 for _, y in points(line))


def test_groups_are_stacked_to_the_whole() -> None:
    names = [f"species {number}" for number in range(12)]
    rows = [Row(index, 1.0, group=names[index % 5 if index < 600 else index % 12]) for index in range(1200)]
    picture = groups_over_time(History(rows))
    assert picture is not None and inside(picture)
    areas = [points(area) for area in elements(picture, "polygon")]
    assert len(areas) == 8  # the seven largest, and all others
    for x in {x for area in areas for x, _ in area}:
        assert any(abs(y - 16) < 0.11 for area in areas for at, y in area if at == x)  # up to the top
    assert "5 others" in words(picture) and sum("species" in word for word in words(picture)) == 7
    assert "12 groups" in picture.description and "'species 0'" in picture.description
    assert groups_over_time(history(1.0, 2.0)) is None and groups_over_time(history(1.0, 2.0, group="a")) is None


def test_the_tree_shows_who_the_winner_comes_from_and_how() -> None:
    rows = [
        Row(0, 1.0),
        Row(1, 0.5),
        Row(2, 2.0, "add-part", (0,)),
        Row(3, 1.5, "weights", (2,)),
        Row(4, 1.2, "weights", (3,)),
        Row(5, 3.0, "cross+joint", (4, 1)),
    ]
    picture = lineage_tree(History(rows), 5, portrait)
    shown = [image.get("href", "").split(",")[1].split("-")[0] for image in elements(picture, "image")]
    assert sorted(shown) == ["0", "1", "2", "5"]  # 3 and 4 got no further, 1 is the other parent
    said = words(picture)
    assert {"#0", "#2", "#5", "#1", "add-part", "weights x2", "cross", "joint"} <= set(said)
    assert inside(picture) and "candidate 0" in picture.description
    alone = lineage_tree(History(rows), 1, portrait)
    assert "has no parents" in alone.description and len(elements(alone, "image")) == 1


def test_a_long_line_is_told_by_its_greatest_gains() -> None:
    rows = [Row(0, 0.0)] + [Row(i, i + (100.0 if i == 150 else 0.0), "weights", (i - 1,)) for i in range(1, 300)]
    picture = lineage_tree(History(rows), 299, portrait)
    shown = {image.get("href", "").split(",")[1].split("-")[0] for image in elements(picture, "image")}
    assert len(shown) == 25 and {"0", "150", "299"} <= shown and inside(picture)


MEASURES = (Measure("mass", 0.0, 4.0, 4), Measure(HOSTILE, 0.0, 3.0, 3), Measure("legs", 0.0, 2.0, 2))


def cell(values: object) -> tuple[int, ...]:
    return tuple(int(value) for value in values)  # type: ignore[attr-defined]


def drawn(elites: list[Row], measures: tuple[Measure, ...] = MEASURES) -> Picture:
    return archive_map(elites, measures, cell, lambda index: WALKER, lambda done, total: None)


def test_the_archive_has_a_cell_for_each_elite_and_the_best_of_those_behind_each_other() -> None:
    elites = [
        Row(7, 1.0, measures=(0.5, 0.5, 0.5)),
        Row(8, 5.0, measures=(0.5, 0.5, 1.5)),
        Row(9, 3.0, measures=(3.5, 2.5, 0.5)),
    ]
    picture = drawn(elites)
    titles = [element.text or "" for element in elements(picture, "title")][1:]
    assert [title.split(",")[0] for title in titles] == ["candidate 8", "candidate 9"]
    cells = [element for element in elements(picture, "rect") if len(element) == 1]
    low, high = (points_of(element) for element in cells)
    assert low[0] < high[0] and low[1] > high[1]  # more mass to the right, more of the second upwards
    assert "3 of 24 cells" in picture.description and inside(picture)
    ((source,),) = [[image.get("href", "")] for image in elements(picture, "image")]
    pixels = np.asarray(Image.open(io.BytesIO(base64.b64decode(source.split(",")[1]))).convert("RGBA"))
    high_part, wide_part = pixels.shape[0] // 3, pixels.shape[1] // 4
    drawn_cells = {
        (column, row)
        for column in range(4)
        for row in range(3)
        if pixels[row * high_part : (row + 1) * high_part, column * wide_part : (column + 1) * wide_part, 3].any()
    }
    assert drawn_cells == {(0, 2), (3, 0)}


def test_cells_beyond_number_share_fields() -> None:
    measures = (Measure("mass", 0.0, 10_000.0, 10_000), Measure("legs", 0.0, 10_000.0, 10_000))
    rows = [Row(i, float(i), measures=(x, x)) for i, x in enumerate((0.0, 100.0, 200.0, 9_999.0))]
    picture = drawn(rows, measures)
    titles = [element.text or "" for element in elements(picture, "title")][1:]
    assert [title.split(",")[0] for title in titles] == ["candidate 1", "candidate 2", "candidate 3"]
    assert "4 of 100,000,000 cells" in picture.description and "best of several" in picture.description


def points_of(element: ElementTree.Element) -> tuple[float, float]:
    return float(element.get("x", "")), float(element.get("y", ""))


def test_an_archive_over_one_measure_is_a_row() -> None:
    picture = drawn([Row(1, 1.0, measures=(0.5,)), Row(2, None, measures=(1.5,))], MEASURES[:1])
    assert len([element for element in elements(picture, "rect") if len(element) == 1]) == 2 and inside(picture)


def test_the_front_is_a_line_among_all_candidates() -> None:
    rows = [Row(i, 1.0, objectives=(i / 10, -i * i / 9)) for i in range(100)] + [Row(100, None)]
    picture = front_plot(History(rows), [rows[5], rows[90], rows[50]], ("distance", HOSTILE), portrait)
    (line,) = elements(picture, "polyline")
    assert [x for x, _ in points(line)] == sorted(x for x, _ in points(line)) and len(points(line)) == 3
    assert len([dot for dot in elements(picture, "circle") if dot.get("class") == "dots"]) == 100
    assert len(elements(picture, "image")) == 3 and inside(picture)
    three = [Row(i, 1.0, objectives=(1.0 * i, -1.0 * i, 0.0)) for i in range(3)]
    assert elements(front_plot(History(three), three, ("a", "b", "c"), portrait), "polyline") == []


def test_what_strangers_named_is_text() -> None:
    rows = [Row(0, 1.0, HOSTILE, group=HOSTILE), Row(1, 2.0, HOSTILE, (0,), group=HOSTILE + "2")]
    told = History(rows)
    pictures = [
        fitness_curves(told, HOSTILE),
        lineage_tree(told, 1, portrait),
        groups_over_time(told),
        drawn([Row(1, 1.0, measures=(0.5, 0.5, 0.5))]),
    ]
    for picture in pictures:
        assert picture is not None
        parsed(picture)
        assert "\u202e" not in picture.file()


def test_a_cutout_is_the_body_and_nothing_else() -> None:
    pixels = render_cutout(WALKER, 120, 90)
    assert pixels.shape == (90, 120, 4) and pixels.dtype == np.uint8
    alpha = pixels[..., 3]
    assert 0.1 < (alpha > 128).mean() < 0.7
    assert alpha[[0, -1]].max() == 0 and alpha[:, [0, -1]].max() == 0  # a margin all round
    blue = pixels[(alpha == 255)].astype(int)
    assert (blue[:, 2] > blue[:, 0] + 40).any()  # its trunk
    again = Image.open(io.BytesIO(base64.b64decode(png_source(pixels).split(",")[1]))).convert("RGBA")
    assert abs(np.asarray(again).astype(int)[..., 3] - alpha).mean() < 12
    assert re.fullmatch(r"data:image/png;base64,[A-Za-z0-9+/=]+", png_source(pixels))
