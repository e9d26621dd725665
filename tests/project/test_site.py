"""The documentation as a site: it builds without a warning, has every page, and fetches nothing from elsewhere."""

from __future__ import annotations

import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import urlsplit

import pytest

import reference_docs
from layout import ROOT


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    result = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert result.returncode == 0, result.stderr
    return folder


class FetchedAddresses(HTMLParser):
    """Collects the addresses that a page makes a browser fetch."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        attributes = dict(attrs)
        if tag in ("script", "img", "iframe"):
            self.addresses.append(attributes.get("src") or "")
        if tag == "link" and attributes.get("rel") in ("stylesheet", "icon", "preload"):
            self.addresses.append(attributes.get("href") or "")


def test_the_site_has_every_page(site: Path) -> None:
    pages = {path.stem for pattern in ("*.md", "*.html") for path in (ROOT / "docs").glob(pattern)}
    assert {path.stem for path in site.glob("*.html")} - {"404"} == pages


def test_the_site_fetches_nothing_from_elsewhere(site: Path) -> None:
    for page in site.glob("*.html"):
        parser = FetchedAddresses()
        parser.feed(page.read_text())
        assert parser.addresses
        assert [address for address in parser.addresses if urlsplit(address).netloc] == []


def test_files_outside_docs_that_pages_link_to_are_copied(site: Path) -> None:
    assert (site / "repository/schemas/task.json").read_bytes() == (ROOT / "schemas/task.json").read_bytes()


def test_the_references_list_every_command_and_the_python_interface(site: Path) -> None:
    commands = (site / "reference-cli.html").read_text()
    for name in reference_docs.commands():
        assert f'id="{name[0].replace(" ", "-")}"' in commands
    python = (site / "reference-python.html").read_text()
    for full, _ in reference_docs.names():
        assert re.search(rf'id="nmes\.[\w.]*\b{full.rpartition(".")[2]}"', python), full
    for member in (
        "nmes.client.Client.connect",
        "nmes.client.cube_commands.CubeCommands.spawn_cube",
        "nmes.world.World.tick",
        "nmes.evaluation.Evaluator.evaluate_population",
        "nmes.errors.WorldError",
    ):
        assert f'id="{member}"' in python
