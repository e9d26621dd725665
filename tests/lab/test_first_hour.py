"""Somebody who has never seen the lab: a creature with four legs is built, evolved, and watched as it walks."""

from __future__ import annotations

import time
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

import nmes
from lab_browser import PASSWORD, Lab, opened, running_browser, served_lab
from nmes.cli import main
from nmes.genome import Genome

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator, Page

CLICKS = 40
CONFINED = {"width": 1280, "height": 800}
WATCHED = 4 * 60  # ticks: four seconds


class Person:
    """Somebody with a mouse, whose clicks are counted."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.clicks = 0

    def click(self, target: Locator) -> None:
        self.clicks += 1
        target.click()

    def press(self, name: str) -> None:
        self.click(self.page.get_by_role("button", name=name, exact=True))

    def write(self, label: str, text: str) -> None:
        self.click(self.page.get_by_label(label))
        self.page.keyboard.press("Control+A")
        self.page.keyboard.type(text)

    def click_trunk(self, share: float) -> None:
        """Clicks the side of the trunk, which is blue, so far from its left end to its right."""
        canvas = self.page.locator(".bench canvas")
        pixels = np.asarray(Image.open(BytesIO(canvas.screenshot())).convert("RGB"), int)
        blue = (pixels[:, :, 2] > 100) & (pixels[:, :, 2] > 1.7 * pixels[:, :, 0])
        columns = np.flatnonzero(blue.sum(axis=0) > 10)
        x = int(columns[0] + share * (columns[-1] - columns[0]))
        rows = np.flatnonzero(blue[:, x])
        y = int(rows[0] + 0.7 * (rows[-1] - rows[0]))  # the side is below the top
        self.clicks += 1
        canvas.click(position={"x": x, "y": y})


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    with served_lab(tmp_path) as running:
        yield running


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with running_browser() as running:
        yield running


def build(person: Person, lab: Lab) -> None:
    """Builds a creature with four legs, and saves it on the way to evolution."""
    page = person.page
    person.click(page.get_by_role("link", name="Build"))
    page.get_by_text("A good genome").wait_for()
    for share, parts in ((0.7, 3), (0.12, 5)):
        person.click_trunk(share)
        page.get_by_text(f"Parts ({parts})").wait_for()
    page.get_by_text("A good genome").wait_for()
    person.press("Evolve this")
    page.get_by_text("nmes evolve").first.wait_for()
    file = lab.folder / "genomes" / "mine.json"
    body = Genome.load(file).body
    below = [cube for cube in body.cubes if cube.position[1] - cube.size[1] / 2 < 1e-6]
    assert len(below) == 4 and len(body.motors) == 4, "four legs stand on the ground, each with a motor"
    checked = CliRunner().invoke(main, ["genome", "check", str(file)])
    assert checked.exit_code == 0, checked.output


def watch(person: Person, lab: Lab, world: str) -> float:
    """Watches the champion, whose picture must move; returns how far it comes along x in four seconds of its world."""
    page = person.page
    person.press("Watch it")
    stage = page.locator(".watched canvas")
    stage.wait_for()
    with nmes.Client(port=lab.host_port, password=PASSWORD, world=world) as client:
        page.wait_for_function("() => Number(document.querySelector('.watched .stage')?.dataset.drawn) > 5")
        first, before = stage.screenshot(), client.get_cube_state("creature.trunk")["position"][0]
        seen = client.get_world_info()["frame"] + WATCHED
        end = time.monotonic() + 60
        while client.get_world_info()["frame"] < seen:
            assert time.monotonic() < end, "the world is slower than a tenth of its pace"
            page.wait_for_timeout(100)
        last, after = stage.screenshot(), client.get_cube_state("creature.trunk")["position"][0]
    assert first != last, "the picture stands still"
    return float(after - before)


def test_a_creature_is_built_evolved_and_watched(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "worlds", viewport=CONFINED) as page:
        person = Person(page)
        build(person, lab)
        person.write("Budget, in candidates", "6")
        person.press("Start")
        page.get_by_text("finished", exact=True).wait_for(timeout=180_000)
        page.get_by_text("6 of 6 candidates").wait_for()
        far = watch(person, lab, "run-walk-ga-1")
        assert far > 0.5, f"it came {far} m far"
        assert person.clicks < 10
        assert (lab.folder / "runs" / "walk-ga-1" / "log.jsonl").read_text().count("\n") == 6


@pytest.mark.long
def test_two_minutes_of_evolution_take_a_creature_farther(browser: Browser, lab: Lab) -> None:
    """The bar itself: less than 40 clicks and ten minutes, of which evolution has two."""
    began = time.monotonic()
    with opened(browser, lab, "worlds", viewport=CONFINED) as page:
        person = Person(page)
        build(person, lab)
        person.write("Budget, in candidates", "100000")
        person.press("Start")
        page.wait_for_timeout(120_000)
        person.press("Pause")
        page.get_by_text("paused", exact=True).wait_for()
        far = watch(person, lab, "run-walk-ga-1")
        assert far > 1.0, f"it came {far} m far"
        assert person.clicks < CLICKS and time.monotonic() - began < 600
        print(f"{person.clicks} clicks, {time.monotonic() - began:.0f} s, {far:.2f} m in 4 s")
