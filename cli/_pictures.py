"""The pictures of runs as files."""

from __future__ import annotations

from pathlib import Path

from nmes.cli._output import whole_file
from nmes.view.chart import Picture
from nmes.view.raster import write_png

__all__ = ["write_picture"]


def write_picture(picture: Picture, folder: Path) -> None:
    """Writes a picture into a folder twice: as an SVG, and as a PNG for where no SVG can be shown."""
    svg = picture.file()
    with whole_file(folder / f"{picture.name}.svg") as file:
        file.write_text(svg, "utf-8")
    with whole_file(folder / f"{picture.name}.png") as file:
        write_png(svg, file)
