"""Small plots as SVG or PNG: panels of curves and of bars, one below the other, over the same time."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import click

from nmes.cli._output import whole_file
from nmes.errors import visible
from nmes.view.chart import in_reach, round_numbers, text
from nmes.view.raster import write_png

__all__ = ["Bars", "Curves", "write_plot"]

COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
WIDTH, LEFT, RIGHT, TOP, GAP, BOTTOM = 980, 70, 230, 40, 44, 40
LINE = 16  # of text, and the height of a bar
BARS = 40  # at most
_LETTERS = 32  # of a name, at its right

Points = Sequence[tuple[float, float]]


@dataclass(frozen=True, slots=True)
class Curves:
    """A panel of curves over time.

    Attributes:
        title: What they show, with its unit.
        lines: By name: times (s) and values; a value that is no finite number is left out.
        floor: The lowest value of a logarithmic scale, at which all smaller ones are drawn; None for a linear scale.
        height: The panel's, in pixels.
    """

    title: str
    lines: Mapping[str, Points]
    floor: float | None = None
    height: int = 150

    @property
    def empty(self) -> bool:
        """Whether there is nothing to draw."""
        return not any(math.isfinite(value) for line in self.lines.values() for _, value in line)

    @property
    def end(self) -> float:
        """The last time."""
        return max((time for line in self.lines.values() for time, _ in line), default=0.0)

    def draw(self, top: int, width: float, end: float) -> Iterator[str]:
        """Yields the panel's SVG elements.

        Args:
            top: Where it begins, pixels from the top.
            width: How wide `end` seconds are, pixels.
            end: The last time of all panels, s.
        """
        values = [value for line in self.lines.values() for _, value in line if math.isfinite(value)]
        ticks = self._ticks(values)
        low, high = ticks[0], ticks[-1]

        def y(value: float) -> float:
            return top + self.height * (1.0 - (self._scaled(value) - low) / (high - low))

        for tick in ticks:
            level = top + self.height * (1.0 - (tick - low) / (high - low))
            label = f"1e{tick:.0f}" if self.floor is not None else f"{tick:g}"
            yield f'<path d="M{LEFT} {level:.1f}H{LEFT + width}" stroke="#ddd"/>'
            yield f'<text x="{LEFT - 6}" y="{level + 4:.1f}" text-anchor="end">{label}</text>'
        for i, (name, line) in enumerate(self.lines.items()):
            color = COLORS[i % len(COLORS)]
            finite = [(time, value) for time, value in line if math.isfinite(value)]
            points = " ".join(f"{LEFT + width * time / end:.1f},{y(value):.1f}" for time, value in finite)
            yield f'<polyline points="{points}" fill="none" stroke="{color}"/>'
            if i < self.height // LINE:
                place = f'x="{LEFT + width + 8}" y="{top + LINE * i + 12}"'
                yield f'<text {place} fill="{color}">{text(_fitting(name))}</text>'

    def _scaled(self, value: float) -> float:
        return in_reach(value) if self.floor is None else math.log10(max(value, self.floor))

    def _ticks(self, values: Sequence[float]) -> list[float]:
        """Returns the numbers at the scale: two or more round ones, round all values."""
        if self.floor is not None:
            low = math.floor(math.log10(self.floor))
            high = max(low + 1, math.ceil(self._scaled(max(values, default=self.floor))))
            return [float(power) for power in range(low, high + 1)]
        return round_numbers(min(values, default=0.0), max(values, default=1.0))


@dataclass(frozen=True, slots=True)
class Bars:
    """A panel of bars: when something held, such as a foot on the ground.

    Attributes:
        title: What they show.
        rows: By name: the spans of time, each its beginning and end, s.
    """

    title: str
    rows: Mapping[str, Points]

    @property
    def height(self) -> int:
        """The panel's, in pixels."""
        return LINE * min(len(self.rows), BARS)

    @property
    def empty(self) -> bool:
        """Whether there is nothing to draw."""
        return not any(self.rows.values())

    @property
    def end(self) -> float:
        """The last time."""
        return max((last for row in self.rows.values() for _, last in row), default=0.0)

    def draw(self, top: int, width: float, end: float) -> Iterator[str]:
        """Yields the panel's SVG elements; the arguments are those of `Curves.draw`."""
        for i, (name, spans) in enumerate(list(self.rows.items())[:BARS]):
            y = top + LINE * i
            yield f'<path d="M{LEFT} {y + LINE - 1}H{LEFT + width}" stroke="#eee"/>'
            yield f'<text x="{LEFT + width + 8}" y="{y + 12}">{text(_fitting(name))}</text>'
            for first, last in spans:
                x, wide = LEFT + width * first / end, max(width * (last - first) / end, 0.5)
                color = COLORS[i % len(COLORS)]
                yield f'<rect x="{x:.1f}" y="{y + 2}" width="{wide:.1f}" height="{LINE - 4}" fill="{color}"/>'


def write_plot(path: Path, title: str, panels: Sequence[Curves | Bars]) -> None:
    """Writes panels, one below the other, over the same time: as a PNG where the path ends in .png, else as an SVG.

    Those with nothing to show are left out; where all are, it says so on standard error and writes nothing.

    Raises:
        ClickException: The file cannot be written.
    """
    shown = [panel for panel in panels if not panel.empty]
    if not shown:
        titles = ", ".join(panel.title for panel in panels)
        click.echo(visible(f"nothing to plot: there is no {titles}; {path} was not written"), err=True)
        return
    svg = "\n".join(_svg(title, shown)) + "\n"
    with whole_file(path) as unfinished:
        if path.suffix == ".png":
            write_png(svg, unfinished)
        else:
            unfinished.write_text(svg, "utf-8")


def _fitting(name: str) -> str:
    """Returns a name with its middle left out where there is no room for it: names often differ at their ends."""
    return name if len(name) <= _LETTERS else f"{name[: _LETTERS // 2]}…{name[-_LETTERS // 2 + 1 :]}"


def _svg(title: str, panels: Sequence[Curves | Bars]) -> Iterator[str]:
    height = TOP + sum(panel.height + GAP for panel in panels) + BOTTOM
    width, end = float(WIDTH - LEFT - RIGHT), max((panel.end for panel in panels), default=0.0) or 1.0
    yield f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="sans-serif">'
    yield f'<rect width="{WIDTH}" height="{height}" fill="white"/><g font-size="12" stroke-width="1.5">'
    yield f'<text x="{LEFT}" y="24" font-size="16">{text(title)}</text>'
    top = TOP
    for panel in panels:
        yield f'<text x="{LEFT}" y="{top + 14}" font-weight="bold">{text(panel.title)}</text>'
        top += 22
        yield from panel.draw(top, width, end)
        top += panel.height + GAP - 22
    for part in range(6):
        x = LEFT + width * part / 5
        yield f'<text x="{x:.1f}" y="{top}" text-anchor="middle">{end * part / 5:,.5g} s</text>'
    yield "</g></svg>"
