"""Pictures of numbers as SVG: axes, text and colours for light and dark, as files and as parts of a page.

It hides how a picture is laid out and coloured. Nothing in one is fetched from elsewhere, no script is needed, and what
strangers named is text in it and nothing else.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from math import ceil, floor, isfinite, log10

from nmes.backend import Image as Pixels
from nmes.errors import visible

__all__ = [
    "STYLE",
    "Chart",
    "Picture",
    "between",
    "in_reach",
    "number",
    "png_source",
    "round_numbers",
    "short",
    "text",
]

WIDTH = 980
LEFT, RIGHT, TOP, BOTTOM = 72, 24, 16, 48  # round the plane of a chart, pixels
_FARTHEST = 1e300  # in a picture: the distance of numbers beyond may be greater than any number
_LETTER = 6.75  # mean width of a letter, pixels
_TITLE = 23  # of the left axis: what it takes of the left edge, pixels
SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#b8860b", "#56b4e9", "#7a5195", "#8a8d91")
_DARK_SERIES = ("#4aa8e0", "#ff8a4c", "#3cc79a", "#e29ac4", "#e2b84a", "#8fd0f5", "#b48ad0", "#a4a8ae")
STYLE = "\n".join(
    (
        ".paper{fill:#fff}.ink{fill:#1f2328}.soft{fill:#59636e}.plate{fill:#e6eaef}.dots{fill:#8b949e}",
        ".grid{stroke:#d8dee4}.edge{stroke:#8b949e;fill:none}.halo{stroke:#fff;stroke-width:3;paint-order:stroke}",
        *(f".f{i}{{fill:{color}}}.s{i}{{stroke:{color};fill:none}}" for i, color in enumerate(SERIES)),
        "@media (prefers-color-scheme: dark){",
        ".paper{fill:#0d1117}.ink{fill:#e6edf3}.soft{fill:#9aa4af}.plate{fill:#c3cad2}.dots{fill:#768390}",
        ".grid{stroke:#30363d}.edge{stroke:#768390}.halo{stroke:#0d1117}",
        *(f".f{i}{{fill:{color}}}.s{i}{{stroke:{color};fill:none}}" for i, color in enumerate(_DARK_SERIES)),
        "}",
    )
)
"""The colours of pictures by class, in light and in dark surroundings."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A drawing.

    Attributes:
        name: A short one of letters and hyphens, of which files are named.
        title: What it shows, for people.
        description: What can be seen in it, for who cannot see it.
        width: Pixels.
        height: Pixels.
        content: Its SVG elements.
        fine: Whether it has parts that are too small to be made out where all of it is seen.
    """

    name: str
    title: str
    description: str
    width: float
    height: float
    content: str
    fine: bool = False

    def element(self) -> str:
        """Returns it as an element of a page that has `STYLE`."""
        return self._svg("")

    def file(self) -> str:
        """Returns it as the text of an SVG file of its own."""
        paper = f'<rect class="paper" width="{self.width:g}" height="{self.height:g}"/>'
        return self._svg(f"<style>{STYLE}</style>{paper}") + "\n"

    def _svg(self, before: str) -> str:
        box = f'viewBox="0 0 {self.width:g} {self.height:g}" width="{self.width:g}" height="{self.height:g}"'
        names = f'role="img" aria-labelledby="{self.name}-title {self.name}-description"'
        told = (
            f'<title id="{self.name}-title">{text(self.title)}</title>'
            f'<desc id="{self.name}-description">{text(self.description)}</desc>'
        )
        head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" {box} font-family="system-ui, sans-serif" font-size="12" {names}>'
        )
        return f"{head}{told}{before}\n{self.content}\n</svg>"


class Chart:
    """The plane between two axes; numbers become places in it.

    Args:
        across: The least and the greatest number on the lower axis.
        upward: The least and the greatest number on the left axis.
        height: Of the plane, pixels.
        right: What is left free to its right, pixels.
        widened: Whether the left axis is widened to round numbers.
    """

    def __init__(
        self,
        across: tuple[float, float],
        upward: tuple[float, float],
        *,
        height: float = 300,
        right: float = RIGHT,
        widened: bool = True,
    ) -> None:
        across, upward = ((in_reach(least), in_reach(most)) for least, most in (across, upward))
        self._steps = round_numbers(*upward)
        numbers = round_numbers(*across)
        self._across = across if across[1] > across[0] else (numbers[0], numbers[-1])
        self._upward = upward if not widened and upward[1] > upward[0] else (self._steps[0], self._steps[-1])
        self._marks = round_numbers(*self._across, inside=True)
        self.left = max(LEFT, ceil(_TITLE + _widest(self._steps)) + 8)
        right = max(right, ceil(_widest(self._marks[-1:]) / 2))  # the last one may stand at the very end
        self.top, self.plane_width, self.plane_height = TOP, WIDTH - self.left - right, height
        self.width, self.height = float(WIDTH), TOP + height + BOTTOM

    def x(self, value: float) -> float:
        """Returns the place of a number of the lower axis, pixels from the left."""
        low, high = self._across
        return self.left + self.plane_width * (in_reach(value) - low) / (high - low)

    def y(self, value: float) -> float:
        """Returns the place of a number of the left axis, pixels from the top."""
        low, high = self._upward
        return self.top + self.plane_height * (1.0 - (in_reach(value) - low) / (high - low))

    def path(self, points: Sequence[tuple[float, float]]) -> str:
        """Returns the points of a line as `points` of an SVG element has them."""
        return " ".join(f"{self.x(across):.1f},{self.y(upward):.1f}" for across, upward in points)

    def axes(self, across: str, upward: str) -> Iterator[str]:
        """Yields the axes with their numbers and titles, and lines across the plane."""
        bottom, right = self.top + self.plane_height, self.left + self.plane_width
        for step in self._steps:
            if self._upward[0] <= step <= self._upward[1]:
                level = self.y(step)
                place = f'x="{self.left - 8}" y="{level + 4:.1f}" text-anchor="end"'
                yield f'<path class="grid" d="M{self.left} {level:.1f}H{right}"/>'
                yield f'<text class="soft" {place}>{_on_axis(step)}</text>'
        for step in self._marks:
            place = f'x="{self.x(step):.1f}" y="{bottom + 18}" text-anchor="middle"'
            yield f'<path class="grid" d="M{self.x(step):.1f} {bottom}v5"/>'
            yield f'<text class="soft" {place}>{_on_axis(step)}</text>'
        middle = self.left + self.plane_width / 2
        yield f'<text class="ink" x="{middle}" y="{bottom + 38}" text-anchor="middle">{text(short(across, 100))}</text>'
        turn = f'transform="translate(16 {self.top + self.plane_height / 2}) rotate(-90)"'
        yield f'<text class="ink" {turn} text-anchor="middle">{text(short(upward, 44))}</text>'


def _on_axis(step: float) -> str:
    """Returns a number of an axis as people read it, to as many digits as tell it from the next one."""
    return f"{step:,.10g}"


def _widest(steps: Sequence[float]) -> float:
    """Returns how wide the widest of the numbers of an axis is, pixels."""
    return _LETTER * max((len(_on_axis(step)) for step in steps), default=0)


def in_reach(value: float) -> float:
    """Returns a number, or the farthest that pictures have: the distance of farther ones may be greater than any."""
    return min(max(value, -_FARTHEST), _FARTHEST)


def between(value: float, least: float, most: float) -> float:
    """Returns how far a number is from one to another: 0 at the least, 1 at the most, or where both are one."""
    least, most = in_reach(least), in_reach(most)
    return (in_reach(value) - least) / (most - least) if most > least else 1.0


def round_numbers(least: float, most: float, *, inside: bool = False) -> list[float]:
    """Returns the numbers of an axis: two or more round ones at equal distances, round a range that is `in_reach`.

    Args:
        least: The lower end of the range.
        most: The upper end.
        inside: Whether those outside the range are left out.
    """
    least, most = in_reach(least), in_reach(most)
    length = most - least
    if length < 1e-9 * max(abs(least), abs(most), 1.0):  # they are one number, which has an axis of its own size
        length = abs(least) / 10 if abs(least) > 1e-9 else 1.0
    step = 10.0 ** floor(log10(length))
    step *= next(part for part in (0.25, 0.5, 1.0, 2.5) if length / (step * part) <= 5.0)
    first, last = floor(least / step), max(-floor(-(least + length) / step), floor(least / step) + 1)
    numbers = [step * number for number in range(first, last + 1)]
    return [number for number in numbers if least <= number <= most] if inside else numbers


def text(value: str) -> str:
    """Returns a stranger's text as text of SVG and HTML, with what does not print as escapes."""
    return escape(visible(value), quote=True)


def short(value: str, letters: int) -> str:
    """Returns a text that is cut where it is longer than so many letters."""
    return value if len(value) <= letters else value[: letters - 1] + "…"


def number(value: float | None, digits: int = 4) -> str:
    """Returns a score as people read it, to so many digits; a dash for none."""
    return "-" if value is None or not isfinite(value) else f"{value:.{digits}g}"


def png_source(pixels: Pixels, colors: int = 64) -> str:
    """Returns a picture of pixels (height, width, 3 or 4) as the address that holds all of it."""
    from PIL import Image  # what is told in words needs none

    image = Image.fromarray(pixels)
    image = image.quantize(colors, method=Image.Quantize.FASTOCTREE)  # the one that keeps what is transparent
    file = io.BytesIO()
    image.save(file, "PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(file.getvalue()).decode()
