"""Our charts as pixels: what an SVG of `nmes.view.chart` or of `--plot` shows, with a font of its own.

It hides how the elements are drawn that those charts are made of. It reads no other SVG: what it does not know is a
mistake of ours, and an error.
"""

from __future__ import annotations

import base64
import io
import os
import re
from collections.abc import Iterator, Mapping
from xml.etree import ElementTree

from PIL import Image, ImageColor, ImageDraw, ImageFont

__all__ = ["write_png"]

_FINE = 4  # drawn pixels for one of the chart's
_SHARP = 2  # pixels of the picture for one of the chart's
_SVG = "{http://www.w3.org/2000/svg}"
_WORDS = frozenset({"title", "desc", "style"})
_RULE = re.compile(r"\.([\w-]+)\{([^}]*)\}")
_STEP = re.compile(r"([MmLlHhVv])([^MmLlHhVv]*)")
_ASIDE = re.compile(r"translate\(([-\d.]+) ([-\d.]+)\) rotate\(-90\)")
_ANCHORS = {"start": "ls", "middle": "ms", "end": "rs"}

Style = Mapping[str, str]
Point = tuple[float, float]


def write_png(svg: str, path: str | os.PathLike[str]) -> None:
    """Writes a chart as a PNG, two pixels for each of its own in both directions, as in light surroundings.

    Args:
        svg: The text of the chart, as its file has it.
        path: The file.
    """
    root = ElementTree.fromstring(svg)
    _, _, width, height = map(float, root.attrib["viewBox"].split())
    painter = _Painter(round(_FINE * width), round(_FINE * height), _classes(root))
    painter.draw(root, {"fill": "#000", "stroke": "none", "stroke-width": "1", "font-size": "12"})
    painter.image.reduce(_FINE // _SHARP).save(path, "PNG")


def _classes(root: ElementTree.Element) -> dict[str, dict[str, str]]:
    """Returns the properties of the classes that a chart has, those in light surroundings."""
    style = root.findtext(f"{_SVG}style", "").partition("@media")[0]
    classes: dict[str, dict[str, str]] = {}
    for name, body in _RULE.findall(style):
        pairs = (part.partition(":") for part in body.split(";"))
        classes.setdefault(name, {}).update({name: value for name, _, value in pairs})
    return classes


class _Painter:
    """One picture in the making."""

    def __init__(self, width: int, height: int, classes: Mapping[str, Style]) -> None:
        self.image = Image.new("RGB", (width, height), "white")
        self._pen = ImageDraw.Draw(self.image, "RGBA")
        self._classes = classes

    def draw(self, element: ElementTree.Element, around: Style) -> None:
        """Draws an element with all that is in it; `around` is the style of what it is in."""
        kind = element.tag.removeprefix(_SVG)
        if kind in _WORDS:
            return
        style = dict(around)
        for name in element.get("class", "").split():
            style |= self._classes.get(name, {})
        style |= element.attrib
        if kind in ("svg", "g"):
            for child in element:
                self.draw(child, style)
        else:
            getattr(self, f"_{kind}")(element, style)

    def _rect(self, element: ElementTree.Element, style: Style) -> None:
        x, y, width, height = (_FINE * float(element.get(name, 0)) for name in ("x", "y", "width", "height"))
        stroke = self._color(style, "stroke")
        self._pen.rounded_rectangle(
            (x, y, x + max(width - 1.0, 0.0), y + max(height - 1.0, 0.0)),
            _FINE * float(element.get("rx", 0)),
            fill=self._color(style, "fill"),
            outline=stroke,
            width=self._width(style) if stroke else 0,
        )

    def _circle(self, element: ElementTree.Element, style: Style) -> None:
        x, y, radius = (_FINE * float(element.attrib[name]) for name in ("cx", "cy", "r"))
        self._pen.ellipse((x - radius, y - radius, x + radius, y + radius), fill=self._color(style, "fill"))

    def _polyline(self, element: ElementTree.Element, style: Style) -> None:
        self._line(_points(element), style)

    def _polygon(self, element: ElementTree.Element, style: Style) -> None:
        points = _points(element)
        if len(points) > 1:
            self._pen.polygon(points, fill=self._color(style, "fill"))

    def _path(self, element: ElementTree.Element, style: Style) -> None:
        for points in _strokes(element.attrib["d"]):
            self._line(points, style)

    def _line(self, points: list[Point], style: Style) -> None:
        color = self._color(style, "stroke")
        if color and len(points) > 1:
            self._pen.line(points, fill=color, width=self._width(style), joint="curve")

    def _image(self, element: ElementTree.Element, style: Style) -> None:
        x, y, width, height = (round(_FINE * float(element.attrib[name])) for name in ("x", "y", "width", "height"))
        with Image.open(io.BytesIO(base64.b64decode(element.attrib["href"].partition(",")[2]))) as source:
            drawn = source.convert("RGBA")
        if element.get("preserveAspectRatio") == "none":
            drawn = drawn.resize((width, height), Image.Resampling.NEAREST)
        else:
            part = min(width / drawn.width, height / drawn.height)
            drawn = drawn.resize((round(part * drawn.width), round(part * drawn.height)))
        place = x + (width - drawn.width) // 2, y + (height - drawn.height) // 2
        self.image.paste(drawn, place, drawn)

    def _text(self, element: ElementTree.Element, style: Style) -> None:
        words, size = element.text or "", _FINE * float(style["font-size"])
        font = ImageFont.load_default(size)
        ink, anchor = self._color(style, "fill"), _ANCHORS[style.get("text-anchor", "start")]
        bold = "bold" in style.get("font-weight", "") or style.get("font-weight") == "600"
        halo = self._color(style, "stroke") if style.get("paint-order") == "stroke" else None
        edge = {"stroke_width": _FINE * 3 // 2, "stroke_fill": halo} if halo else {"stroke_width": _FINE // 3 * bold}
        if (aside := _ASIDE.fullmatch(element.get("transform", ""))) is None:
            place = _FINE * float(element.attrib["x"]), _FINE * float(element.attrib["y"])
            self._pen.text(place, words, ink, font, anchor=anchor, **edge)
            return
        length, height = round(self._pen.textlength(words, font)) + 2, round(2 * size)
        sheet = Image.new("RGBA", (length, height))
        ImageDraw.Draw(sheet).text((length / 2, height / 2), words, ink, font, anchor="ms", **edge)
        sheet = sheet.rotate(90, expand=True)
        place = (round(_FINE * float(aside[1])) - height // 2, round(_FINE * float(aside[2])) - length // 2)
        self.image.paste(sheet, place, sheet)

    def _width(self, style: Style) -> int:
        return max(1, round(_FINE * float(style["stroke-width"])))

    def _color(self, style: Style, name: str) -> tuple[int, ...] | None:
        if style[name] == "none":
            return None
        return (*ImageColor.getrgb(style[name])[:3], round(255 * float(style.get("opacity", 1))))


def _points(element: ElementTree.Element) -> list[Point]:
    pairs = (pair.split(",") for pair in element.attrib["points"].split())
    return [(_FINE * float(x), _FINE * float(y)) for x, y in pairs]


def _strokes(path: str) -> Iterator[list[Point]]:
    """Yields the lines of a path, each without a gap."""
    x = y = 0.0
    line: list[Point] = []
    for letter, rest in _STEP.findall(path):
        numbers = [float(number) for number in re.findall(r"-?[\d.]+(?:e-?\d+)?", rest)]
        base_x, base_y = (x, y) if letter.islower() else (0.0, 0.0)
        match letter.lower():
            case "h":
                x = base_x + numbers[0]
            case "v":
                y = base_y + numbers[0]
            case _:
                x, y = base_x + numbers[0], base_y + numbers[1]
        if letter in "Mm":
            yield line
            line = []
        line.append((_FINE * x, _FINE * y))
    yield line
