"""The pages of runs, as a browser shows them: what is watched of them, and how they are gone on with."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

import nmes
from lab_browser import PASSWORD, Lab, opened, running_browser, served_lab
from processes import NMES

if TYPE_CHECKING:
    from playwright.sync_api import Browser


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with running_browser() as running:
        yield running


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    """A lab with a finished run over hills."""
    folder = tmp_path_factory.mktemp("lab")
    (folder / "runs").mkdir()
    options = [
        "--task",
        "rough",
        "--budget",
        "4",
        "--seeds",
        "3",
        "--jobs",
        "1",
        "-q",
        "-o",
        str(folder / "runs/hills"),
    ]
    subprocess.run([NMES, "evolve", "walker", *options], check=True)
    with served_lab(folder) as running:
        yield running


def test_a_champion_is_watched_in_the_world_of_its_task(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "evolve/hills") as page:
        for times in range(2):  # the second time in place of the first
            page.get_by_role("button", name="From the start" if times else "Watch it").click()
            page.get_by_text("In the world of rough, as seed 3 draws it.").wait_for()
            page.wait_for_function("() => Number(document.querySelector('.watched .stage')?.dataset.drawn) > 5")
            shown = r"nmes evolve best \S+hills --index \d+ && nmes play .* --seed 3"
            assert re.fullmatch(shown, page.locator("#command").inner_text())
            with nmes.Client(port=lab.host_port, password=PASSWORD, world="run-hills") as client:
                info = client.get_world_info()
                assert info["config"]["scene"]["type"] == "heightfield" and info["seed"] == 3
                assert 0 < info["counts"]["cubes"] < 40
