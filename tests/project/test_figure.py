"""The drawn figure of the architecture: that it is drawn from its source, and shows every package."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from html import unescape

from layout import PROJECT, ROOT

SOURCE = (ROOT / "docs/pictures/architecture.dot").read_text()
FIGURE = ROOT / "docs/pictures/architecture.svg"
SVG = "{http://www.w3.org/2000/svg}"


def drawn(kind: str) -> list[str]:
    """The titles of all nodes or edges that the figure has, sorted."""
    groups = ElementTree.parse(FIGURE).iter(f"{SVG}g")
    return sorted(unescape(group.findtext(f"{SVG}title", "")) for group in groups if group.get("class") == kind)


def test_the_figure_has_the_nodes_and_edges_of_its_source() -> None:
    nodes = re.findall(r"^ +(\w+) +\[label=", SOURCE, re.MULTILINE)
    edges = re.findall(r"^ +(\w+) -> (\w+)", SOURCE, re.MULTILINE)
    assert drawn("node") == sorted(nodes)
    assert drawn("edge") == sorted(f"{tail}->{head}" for tail, head in edges)


def test_the_figure_has_the_words_of_its_source() -> None:
    labels = re.findall(r'label=(?:"([^"]*)"|<(.*?)>[\],])', SOURCE)
    wanted = " ".join(re.sub(r"<[^>]*>", " ", plain or rich) for plain, rich in labels)
    shown = " ".join(unescape(text.text or "") for text in ElementTree.parse(FIGURE).iter(f"{SVG}text"))
    assert sorted(wanted.split()) == sorted(shown.split())


def test_every_package_is_in_the_figure() -> None:
    shown = " ".join(unescape(text.text or "") for text in ElementTree.parse(FIGURE).iter(f"{SVG}text"))
    packages = {name for name in PROJECT["tool"]["setuptools"]["packages"] if name.count(".") == 1}
    assert packages <= set(re.findall(r"nmes\.\w+", shown))
