"""Two recordings side by side in the lab, as a browser shows them: one time line, and where they part."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import pytest

from ecosystems import config
from lab_browser import PATIENCE, Lab, opened, running_browser, serious, served_lab
from nmes.genome import Genome
from nmes.playback.watch import watch
from nmes.recording import Recording
from nmes.world import World
from processes import NMES
from recordings import misled, record, rewrite, send

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

PUSHED, TICKS = 60, 150  # after how many ticks, and of how many
WRONG = 20  # the frame of a recording that does not come out as recorded
CUBE = "w.torso"
MUJOCO = {"backend": "mujoco"}


def walked(force: float) -> Callable[[World, int], None]:
    """Returns what records a walker that is pushed so hard."""

    def play(world: World, client: int) -> None:
        send(world, client, type="spawn_creature", genome=Genome.load("walker").document, name="w", autonomous=True)
        for tick in range(TICKS):
            if tick == PUSHED:
                send(world, client, type="apply_physics", cube_name=CUBE, force=[force, 0, 0])
            send(world, client, type="step")

    return play


def ticked(world: World, client: int) -> None:
    """A world that ticks, in which food grows and is eaten if it is an ecosystem."""
    for _ in range(60):
        send(world, client, type="step")


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with running_browser() as running:
        yield running


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    """A lab with recordings that part, and one that is the same as another."""
    folder = tmp_path_factory.mktemp("lab")
    (folder / "recordings").mkdir()
    record(folder / "recordings" / "soft.mcap", walked(200.0), MUJOCO)
    record(folder / "recordings" / "hard.mcap", walked(900.0), MUJOCO)
    shutil.copy(folder / "recordings" / "soft.mcap", folder / "recordings" / "again.mcap")
    whole = record(folder / "recordings" / "whole.mcap", ticked)
    rewrite(whole, folder / "recordings" / "misled.mcap", lambda lines: misled(lines, WRONG))
    growing = {"places": [{"radius": 6}], "start": 30, "rate": 20, "most": 90}
    record(folder / "recordings" / "pond.mcap", ticked, {**config(food=growing), **MUJOCO})
    with served_lab(folder) as running:
        yield running


def standing(page: Page, *frames: int) -> None:
    """Waits until the two recordings are shown at these frames."""
    for pane, frame in enumerate(frames):
        page.locator(f".pane[data-frame='{frame}']").nth(pane if len(set(frames)) == 1 else 0).wait_for()


def test_two_recordings_are_moved_on_one_time_line(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "recordings/soft/hard") as page:
        line = page.get_by_label("Frame of both")
        page.wait_for_function("() => document.querySelector('[aria-label=\"Frame of both\"]').max === '150'")
        assert page.get_by_label("Frame", exact=True).count() == 2  # each has one of its own, which is not seen
        assert not page.get_by_label("Frame", exact=True).first.is_visible()
        line.fill("40")
        standing(page, 40, 40)
        page.get_by_label("Both one frame on").click()
        standing(page, 41, 41)
        page.get_by_label("Speed of both").select_option("8")
        page.get_by_role("button", name="Play both").click()
        standing(page, TICKS, TICKS)
        page.get_by_role("button", name="Play both").wait_for()
        page.get_by_label("Move together").uncheck()
        page.get_by_label("Frame", exact=True).first.fill("7")
        page.locator(".pane[data-frame='7']").wait_for()
        assert page.locator(f".pane[data-frame='{TICKS}']").count() == 1
        assert line.is_disabled()
        page.get_by_label("Move together").check()
        standing(page, 7, 7)


def test_where_two_recordings_part_is_marked_named_and_gone_to(browser: Browser, lab: Lab) -> None:
    paths = [str(lab.folder / "recordings" / f"{name}.mcap") for name in ("soft", "hard")]
    told = subprocess.run([NMES, "diff", *paths, "--json"], capture_output=True, check=False)
    expected = json.loads(told.stdout)
    assert (expected["inputs"]["ticks"], expected["states"]["tick"]) == (PUSHED, PUSHED + 1)
    with opened(browser, lab, "recordings/soft/hard") as page:
        button = page.get_by_role("button", name="Find where they part")
        button.hover()
        assert page.locator("#command").inner_text() == f"nmes diff {paths[0]} {paths[1]}"
        button.click()
        page.get_by_text("they part", exact=True).wait_for(timeout=2 * PATIENCE)
        standing(page, PUSHED, PUSHED)  # at the first difference
        assert page.locator(".ticks .parted").count() == 2
        shown = page.locator("[aria-label=Both]").inner_text()
        states = expected["states"]
        for fact in (expected["inputs"]["field"], states["cube"], states["field"], "200", "900"):
            assert fact in shown, (fact, shown)
        page.get_by_role("button", name=f"Go to frame {PUSHED + 1}").click()
        standing(page, PUSHED + 1, PUSHED + 1)
        page.get_by_text("cubes come apart").click()
        assert page.locator("[aria-label=Both] tbody tr").count() > 3
        assert serious(page) == []
        assert page.evaluate("document.documentElement.scrollWidth") <= 1280


def test_recordings_that_are_the_same_are_said_to_be(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "recordings/soft/again", viewport={"width": 360, "height": 740}) as page:
        page.get_by_role("button", name="Find where they part").click()
        page.get_by_text("the same", exact=True).wait_for(timeout=2 * PATIENCE)
        assert page.locator(".ticks .parted").count() == 0
        assert page.evaluate("document.documentElement.scrollWidth") <= 360


def test_forces_of_a_recording_are_drawn_for_those_who_ask(browser: Browser, lab: Lab) -> None:
    def drawn(kind: str) -> int:
        return int(page.locator(".stage").get_attribute(f"data-{kind}") or 0)

    with opened(browser, lab, "recordings/soft") as page:
        line = page.get_by_label("Frame", exact=True)
        page.wait_for_function("() => document.querySelector('[aria-label=Frame]').max === '150'")
        line.fill("140")
        page.locator(".pane[data-frame='140']").wait_for()
        assert [drawn(kind) for kind in ("contacts", "motors", "pushes")] == [0, 0, 0]
        for kind in ("Contacts", "Motors"):
            page.get_by_label(kind).check()
            page.wait_for_function(f"() => Number(document.querySelector('.stage').dataset.{kind.lower()}) > 0")
        line.fill(str(PUSHED + 1))  # when the push has acted, which is drawn until others are due
        page.get_by_label("Pushes").check()
        page.wait_for_function("() => document.querySelector('.stage').dataset.pushes === '1'")
        page.get_by_label("Contacts").uncheck()
        assert drawn("contacts") == 0
        line.fill("141")
        page.locator(".pane[data-frame='141']").wait_for()
        assert drawn("contacts") == 0 and drawn("motors") > 0 and drawn("pushes") == 0


def test_the_food_of_a_recording_is_that_of_its_moment(browser: Browser, lab: Lab) -> None:
    pond = Recording(lab.folder / "recordings" / "pond.mcap")
    foods = [0, *watch(pond, lambda world: len(world.entities.food))]
    assert len({foods[1], foods[30], foods[60]}) == 3
    with opened(browser, lab, "recordings/pond") as page:
        line = page.get_by_label("Frame", exact=True)
        page.wait_for_function("() => document.querySelector('[aria-label=Frame]').max === '60'")
        for frame in (1, 30, 60, 1):
            line.fill(str(frame))
            page.locator(f".pane[data-frame='{frame}'] .stage[data-food='{foods[frame]}']").wait_for()


def test_a_recording_that_does_not_come_out_as_recorded_is_shown_up_to_there(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "recordings/misled") as page:
        line = page.get_by_label("Frame", exact=True)
        page.wait_for_function("() => document.querySelector('[aria-label=Frame]').max === '60'")
        for frame in (WRONG - 1, 2):
            line.fill(str(WRONG + 5))
            page.locator(".hud .badge", has_text=f"tick {WRONG} does not come out as recorded").wait_for()
            line.fill(str(frame))
            page.locator(f".pane[data-frame='{frame}']").wait_for()
            assert not page.locator(".hud .badge").is_visible()
        page.get_by_role("button", name="Play", exact=True).click()
        page.locator(".hud .badge", has_text=f"tick {WRONG} does not come out as recorded").wait_for()
        page.get_by_role("button", name="Play", exact=True).wait_for()  # it has come to a stop
