"""The archive of a run as a picture: a heat map of its cells, with a portrait of the elite in each.

All portraits are one picture, laid over the map: an archive of 50 x 50 cells is as large as a photograph.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from math import prod

import numpy as np

from nmes.backend import Image as Pixels
from nmes.evolution.algorithm import Measure
from nmes.evolution.history import Origin
from nmes.genome.body import Body
from nmes.genome.preview import render_cutout
from nmes.view.chart import LEFT, TOP, WIDTH, Chart, Picture, between, number, png_source, text

__all__ = ["archive_map"]

_RAMP = ((223, 230, 240), (176, 208, 230), (150, 214, 176), (226, 211, 110), (242, 158, 84))  # the last is best
_SHARP = 2400  # pixels of all portraits side by side, at most
_LARGEST, _SMALLEST = 140, 24  # pixels of one, across
_FINE = 16  # columns from which on portraits are too small to be made out without a glass
_TALLEST = 620.0  # pixels of the map
_KEY = 96  # pixels, for the scale of colours
_MOST = 64  # fields in a row or column: where an archive has more cells, several share a field
_NOTHING = Measure("", 0.0, 1.0, 1)  # in place of a second measure


def archive_map(
    elites: Sequence[Origin],
    measures: Sequence[Measure],
    cell_of: Callable[[Sequence[float]], tuple[int, ...]],
    body: Callable[[int], Body],
    progress: Callable[[int, int], None],
) -> Picture:
    """Returns the archive over the first two of its measures; of elites in one place the best is seen.

    Args:
        elites: The archive's contents, one or more.
        measures: The run's, one or more.
        cell_of: Returns the cell of the values of measures, an index a measure.
        body: Returns the body of a candidate, by its index.
        progress: Called with how many portraits are drawn and how many there are.
    """
    plane = _Plane(elites, measures, cell_of)
    chart = plane.chart
    place = f'x="{chart.left}" y="{chart.top}" width="{chart.plane_width}" height="{chart.plane_height}"'
    source = png_source(plane.portraits(body, progress), 128)
    parts = [
        *chart.axes(measures[0].expression, measures[1].expression if len(measures) > 1 else ""),
        *plane.fields(),
        f'<image {place} preserveAspectRatio="none" pointer-events="none" href="{source}"/>',
        *plane.key(),
    ]
    told = f"{len(elites):,} of {prod(measure.cells for measure in measures):,} cells are filled; "
    told += f"scores go from {number(plane.low)} to {number(plane.high)}."
    if len(measures) > 2 or max(measure.cells for measure in measures) > _MOST:
        told += f" Each of the {len(plane.best):,} fields that are shown has the best of several cells."
    size = chart.width, chart.height
    return Picture("archive", "The archive", told, *size, "\n".join(parts), fine=measures[0].cells > _FINE)


class _Plane:
    """The fields of an archive that are seen, and where they are; arguments are those of `archive_map`."""

    def __init__(
        self,
        elites: Sequence[Origin],
        measures: Sequence[Measure],
        cell_of: Callable[[Sequence[float]], tuple[int, ...]],
    ) -> None:
        self._measures = measures
        first, second = measures[0], (*measures, _NOTHING)[1]
        self._columns, self._rows = min(first.cells, _MOST), min(second.cells, _MOST)
        self.best: dict[tuple[int, int], Origin] = {}
        for elite in sorted(elites, key=lambda elite: (elite.score is not None, elite.score or 0.0)):
            column, row, *_ = (*cell_of(elite.measures), 0)
            self.best[column * self._columns // first.cells, row * self._rows // second.cells] = elite
        scores = [elite.score for elite in self.best.values() if elite.score is not None]
        self.low, self.high = min(scores, default=0.0), max(scores, default=0.0)
        height = min(_TALLEST, self._rows * (WIDTH - LEFT - _KEY) / self._columns * 0.75 + 40)
        span = (first.low, first.high), (second.low, second.high)
        self.chart = Chart(*span, height=height, right=_KEY, widened=False)
        self._wide, self._tall = self.chart.plane_width / self._columns, self.chart.plane_height / self._rows

    def fields(self) -> Iterator[str]:
        """Yields the fields, each in the colour of its elite's score."""
        for (column, row), elite in sorted(self.best.items()):
            x, y = self.chart.left + column * self._wide, self.chart.top + (self._rows - 1 - row) * self._tall
            values = zip(self._measures, elite.measures, strict=True)
            told = ", ".join(f"{measure.expression} {value:.4g}" for measure, value in values)
            name = text(f"candidate {elite.index}, score {number(elite.score)}: {told}")
            place = f'x="{x:.2f}" y="{y:.2f}" width="{self._wide:.2f}" height="{self._tall:.2f}"'
            yield f'<rect {place} fill="{self._color(elite.score)}"><title>{name}</title></rect>'

    def portraits(self, body: Callable[[int], Body], progress: Callable[[int, int], None]) -> Pixels:
        """Returns the portraits of all fields as one picture of the map's shape, (height, width, 4)."""
        across = max(_SMALLEST, min(_LARGEST, _SHARP // self._columns))
        down = max(1, round(across * self._tall / self._wide))
        pixels: Pixels = np.zeros((self._rows * down, self._columns * across, 4), np.uint8)
        for done, ((column, row), elite) in enumerate(sorted(self.best.items()), start=1):
            y, x = (self._rows - 1 - row) * down, column * across
            pixels[y : y + down, x : x + across] = render_cutout(body(elite.index), across, down)
            progress(done, len(self.best))
        return pixels

    def _color(self, score: float | None) -> str:
        """Returns the colour of a score; where there is none, that of the lowest."""
        place = between(self.low if score is None else score, self.low, self.high) * (len(_RAMP) - 1)
        index = min(int(place), len(_RAMP) - 2)
        mix = [a + (b - a) * (place - index) for a, b in zip(_RAMP[index], _RAMP[index + 1], strict=True)]
        return "#" + "".join(f"{round(part):02x}" for part in mix)

    def key(self, steps: int = 40) -> Iterator[str]:
        """Yields what the colours mean, on the right."""
        x, tall = WIDTH - _KEY + 16, min(200.0, self.chart.plane_height - 16)
        for step in range(steps):
            y = TOP + 16 + tall * (1 - (step + 1) / steps)
            part = step / (steps - 1)
            color = self._color(self.low * (1.0 - part) + self.high * part)
            yield f'<rect x="{x}" y="{y:.1f}" width="14" height="{tall / steps + 0.5:.1f}" fill="{color}"/>'
        for value, y in ((self.high, TOP + 26), (self.low, TOP + 16 + tall)):
            yield f'<text class="soft" x="{x + 20}" y="{y:.1f}">{number(value)}</text>'
        yield f'<text class="ink" x="{x}" y="{TOP + 6}">score</text>'
