"""The pages on which creatures are built, evolved and taught about, as a browser shows them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import pytest

import nmes
from lab_browser import PASSWORD, Lab, opened, running_browser, serious, served_lab
from nmes.evaluation import Workers
from nmes.evolution.run import Run
from nmes.evolution.run_settings import RunSettings
from nmes.genome import Genome

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, Route, WebSocketRoute

MARKUP = "<img src=x onerror=alert(1)>"
PHONE = {"width": 360, "height": 740}
PAGES = ("build", "build/walker", "build/galloper", "evolve", "evolve/kinds", "lessons", "lessons/worlds")
SETTINGS = {
    "format": "nmes-run/1",
    "task": "jump-far",
    "algorithm": "map-elites",
    "budget": 12,
    "seeds": [1],
    "starts": ["lurcher"],
    "measures": [
        {"expression": "cubes", "low": 0, "high": 10, "cells": 10},
        {"expression": "mass", "low": 0, "high": 50, "cells": 10},
    ],
}


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with running_browser() as running:
        yield running


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    """A lab with a finished run that has an archive."""
    folder = tmp_path_factory.mktemp("lab")
    (folder / "runs").mkdir()
    with Workers(1) as workers:
        for _ in Run.create(folder / "runs" / "kinds", RunSettings.read(SETTINGS)).advance(workers):
            pass
    with served_lab(folder) as running:
        yield running


def show(page: Page, lab: Lab, path: str) -> None:
    page.goto(lab.at(path))
    page.wait_for_selector(f"main .page[data-page={path.split('/')[0]}] h1")
    page.wait_for_selector(".loading", state="detached")


def parts(page: Page, number: int) -> None:
    page.get_by_text(f"Parts ({number})", exact=True).wait_for()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_no_page_keeps_anybody_out(browser: Browser, lab: Lab, scheme: str) -> None:
    with opened(browser, lab, PAGES[0], color_scheme=scheme) as page:
        for path in PAGES:
            show(page, lab, path)
            assert serious(page) == [], path


def test_no_page_is_wider_than_a_telephone(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, PAGES[0], viewport=PHONE) as page:
        for path in PAGES:
            show(page, lab, path)
            assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"], path


def test_a_creature_is_built_with_the_keyboard_alone(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "build") as page:
        for name, number in (("trunk", 1), ("right", 3), ("bottom", 5)):
            parts(page, 1 if name == "trunk" else number - 2)
            page.get_by_role("button", name=name, exact=True).focus()
            page.keyboard.press("Enter")
        parts(page, 5)
        page.keyboard.press("Control+z")
        parts(page, 3)
        page.keyboard.press("Control+Shift+z")
        parts(page, 5)
        page.get_by_text("A good genome").wait_for()
        page.get_by_role("button", name="Save").focus()
        page.keyboard.press("Enter")
        page.get_by_text(re.compile("^Saved as mine")).wait_for()
        assert page.locator("#command").inner_text() == f"nmes genome check {lab.folder / 'genomes' / 'mine.json'}"
    genome = Genome.load(lab.folder / "genomes" / "mine.json")
    assert len(genome.body.motors) == 4 and genome.brain() is not None


def test_creatures_are_saved_under_names_of_any_script(browser: Browser, lab: Lab) -> None:
    names = {
        "Жук": "Жук",
        "Кот": "Кот",
        "海 馬": "海-馬",
        "Z\u0065\u0301bre": "Zébre",
        "…": "creature",
        "鯨" * 100: "鯨" * 66,
    }
    with opened(browser, lab, "build") as page:
        for name, file in names.items():
            page.get_by_label("Name", exact=True).fill(name)
            page.keyboard.press("Tab")
            page.get_by_text("A good genome").wait_for()
            page.get_by_role("button", name="Save").click()
            page.get_by_text(re.compile(f"^Saved as {file},")).wait_for()
            assert Genome.load(lab.folder / "genomes" / f"{file}.json").name == name


def test_problems_are_told_with_their_place(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "build/walker") as page:
        page.get_by_text("A good genome").wait_for()
        page.get_by_role("button", name="rear_left_thigh", exact=True).click()
        page.get_by_label("Place along x").first.fill("0.24")
        page.get_by_text(re.compile("problems?$")).wait_for()
        page.get_by_text("overlap by").first.wait_for()
        page.get_by_role("button", name=re.compile("^body.cubes")).first.wait_for()
        page.get_by_role("button", name="Undo").click()
        page.get_by_text("A good genome").wait_for()


def test_a_body_that_grows_is_shown_as_it_grows(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "build/centipede") as page:
        page.get_by_text("A good genome").wait_for()
        page.locator(".part", has_text="segment").click()
        with page.expect_response("**/api/genomes/check") as answer:
            page.get_by_label("Grown on one way").last.fill("2")
            page.keyboard.press("Tab")
        sent = json.loads(answer.value.request.post_data or "")
        grown = [cube["id"] for cube in answer.value.json()["body"]["cubes"]]
        assert grown == [cube.id for cube in Genome(sent).body.cubes]
        assert len(grown) < len(Genome.load("centipede").body.cubes)


def test_a_joint_turns_about_any_axis_and_its_twin_likewise(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "build/walker") as page:
        page.get_by_text("A good genome").wait_for()
        page.get_by_role("button", name="rear_left_thigh", exact=True).click()
        for name, value in (("x", "0.5"), ("y", "0.25"), ("z", "0"), ("z", "1")):
            number = page.locator(".slide", has_text=f"Axis along {name}").locator("input[type=number]")
            number.fill(value)
            page.keyboard.press("Tab")
        page.get_by_text("A good genome").wait_for()
        page.get_by_label("Name", exact=True).fill("askew")
        page.get_by_role("button", name="Save").click()
        page.get_by_text(re.compile("^Saved as askew")).wait_for()
    joints = {joint.cube2: joint for joint in Genome.load(lab.folder / "genomes" / "askew.json").body.joints}
    left, right = joints["rear_left_thigh"].axis, joints["rear_right_thigh"].axis
    assert left is not None and right is not None
    assert [each / left[2] for each in left] == pytest.approx([0.5, 0.25, 1])
    assert [each / right[2] for each in right] == pytest.approx([-0.5, -0.25, 1])


def test_the_joint_of_a_part_that_grows_is_changed_on_all_that_grew_of_it(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "build/centipede") as page:
        page.get_by_text("A good genome").wait_for()
        page.locator(".part", has_text="leg").first.click()
        with page.expect_response("**/api/genomes/check") as answer:
            page.locator(".slide", has_text="Axis along y").locator("input[type=number]").fill("0.75")
            page.keyboard.press("Tab")
        sent = Genome(json.loads(answer.value.request.post_data or ""))
        part = next(each for each in sent.document["body"]["graph"]["parts"] if each["id"].startswith("leg"))
        assert part["joint"]["axis"][1] == 0.75 and answer.value.json()["problems"] == []
        drawn = {joint["id"]: joint["axis"] for joint in answer.value.json()["body"]["joints"]}
        before = {joint.id: joint.axis for joint in Genome.load("centipede").body.joints}
        changed = [name for name, axis in drawn.items() if axis != pytest.approx(before[name])]
        assert len(changed) > 3, drawn


def test_names_with_markup_are_text(browser: Browser, lab: Lab) -> None:
    document = {**Genome.load("walker").document, "name": MARKUP}
    with opened(browser, lab, "build") as page:
        page.get_by_role("button", name="Open", exact=True).click()
        page.get_by_label("Or a file").set_input_files(
            {"name": "x.json", "mimeType": "application/json", "buffer": json.dumps(document).encode()}
        )
        parts(page, 9)
        assert page.get_by_label("Name", exact=True).input_value() == MARKUP
        page.get_by_role("button", name="Save").click()
        page.get_by_text(re.compile("^Saved as img-src-x")).wait_for()
        show(page, lab, "evolve")
        assert page.locator("main img").count() == 0


def test_a_creature_is_dropped_into_a_world(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "build/walker") as page:
        page.get_by_role("button", name="Drop into a world").click()
        page.wait_for_url("**/#/worlds/try-walker")
        page.wait_for_function("() => Number(document.querySelector('.pane')?.dataset.frames) > 10")


def test_an_elite_of_an_archive_is_watched_and_kept(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "evolve") as page:
        page.get_by_role("link", name="kinds").click()
        page.get_by_text("12 of 12 candidates").wait_for()
        page.locator(".curve canvas").wait_for()
        cells = page.locator(".heat button")
        cells.first.locator("svg").wait_for()
        label = cells.first.get_attribute("aria-label") or ""
        cells.first.click()
        number = int(re.findall(r"\d+", label)[0])
        page.get_by_role("heading", name=f"Candidate {number}, live").wait_for()
        page.wait_for_function("() => Number(document.querySelector('.watched .stage')?.dataset.drawn) > 5")
        page.locator(".watched ~ .actions").get_by_role("button", name="Save as a genome").click()
        page.get_by_text(f"Saved as kinds-{number}").wait_for()
        file = lab.folder / "genomes" / f"kinds-{number}.json"
        assert page.locator("#command").inner_text() == f"nmes genome check {file}"
    kept = Genome.load(lab.folder / "genomes" / f"kinds-{number}.json").document
    run = Run.open(lab.folder / "runs" / "kinds")
    assert {**kept, "name": ""} == {**run.genome(number).document, "name": ""}


def test_a_run_is_begun_paused_and_gone_on_with(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "evolve?genome=walker") as page:
        page.get_by_label("Budget, in candidates").fill("100000")
        page.get_by_label("Name of the run").fill("long")
        command = page.locator(".as-command").inner_text()
        run = f"-o {lab.folder / 'runs' / 'long'}"
        assert command == f"nmes evolve walker --task walk --algorithm ga --budget 100000 --seed 1 {run}"
        page.get_by_role("button", name="Start").click()
        page.get_by_role("button", name="Pause").click()
        page.get_by_text("paused", exact=True).wait_for()
        page.get_by_role("button", name="Resume").click()
        page.get_by_text("running", exact=True).wait_for()


def test_the_first_lesson_does_what_it_says(browser: Browser, lab: Lab) -> None:
    take(browser, lab, "worlds")


def test_a_lesson_waits_for_a_world_that_is_behind_the_clock(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "lessons/worlds") as page:
        page.get_by_role("button", name="Drop a cube").click()
        page.locator(".watched").wait_for()  # its world is there
        with nmes.Client(port=lab.host_port, password=PASSWORD, world="lesson-worlds") as client:
            while "cube" not in [cube["cube_name"] for cube in client.get_world_state()["cubes"]]:
                page.wait_for_timeout(10)
            client.pause()
            page.wait_for_timeout(2000)  # in which the cube would have come to rest
            client.resume()
        outcome = page.locator(".outcome.good, .outcome.bad")
        outcome.wait_for()
        assert "good" in (outcome.get_attribute("class") or ""), outcome.inner_text()


@pytest.mark.long
@pytest.mark.parametrize("lesson", ["bodies", "brains", "evolution", "senses"])
def test_every_other_lesson_does_what_it_says(browser: Browser, lab: Lab, lesson: str) -> None:
    take(browser, lab, lesson)


def take(browser: Browser, lab: Lab, lesson: str) -> None:
    """Does all steps of a lesson, each of which must come out as it says."""
    with opened(browser, lab, f"lessons/{lesson}") as page:
        steps = page.locator(".steps > li")
        for i in range(steps.count()):
            steps.nth(i).get_by_role("button").click()
            outcome = steps.nth(i).locator(".outcome.good, .outcome.bad")
            outcome.wait_for(timeout=180_000)
            assert "good" in (outcome.get_attribute("class") or ""), outcome.inner_text()
        page.get_by_role("heading", name="Done").wait_for()
        show(page, lab, "lessons")
        page.get_by_text("done", exact=True).wait_for()


PICTURES = """
const {getContext} = HTMLCanvasElement.prototype;
HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
  const {dataset} = document.documentElement;
  if (kind === "webgl2") dataset.pictures = Number(dataset.pictures ?? 0) + 1;
  return getContext.call(this, kind, ...more);
};
"""


def test_a_page_that_is_left_before_its_genome_has_come_draws_nothing(browser: Browser, lab: Lab) -> None:
    def count() -> int:
        return int(page.locator("html").get_attribute("data-pictures") or 0)

    with opened(browser, lab, "recordings") as page:
        page.add_init_script(PICTURES)
        page.reload()
        held: list[Route] = []
        page.route("**/api/genomes/walker", lambda route: held.append(route))
        page.goto(lab.at("build/walker"))
        while not held:
            page.wait_for_timeout(50)
        page.goto(lab.at("recordings"))
        page.wait_for_selector("main .page[data-page=recordings] h1")
        pictures = [count()]  # one looks at what the browser can do
        with page.expect_response("**/api/genomes/walker"):
            held[0].continue_()
        page.wait_for_timeout(300)
        pictures.append(count())
        page.unroute("**/api/genomes/walker")
        page.goto(lab.at("build/walker"))  # where it is waited for there is a picture
        page.get_by_text("A good genome").wait_for()
        assert [*pictures, count()] == [1, 1, 2]


def test_a_lesson_that_is_left_while_a_creature_comes_is_watched_no_more(browser: Browser, lab: Lab) -> None:
    held: list[Callable[[], None]] = []
    watched: list[WebSocketRoute] = []

    def carried(route: WebSocketRoute) -> None:
        server = route.connect_to_server()

        def passed(message: str | bytes) -> None:
            if '"spawn_creature"' in str(message):
                held.append(lambda: server.send(message))
            else:
                server.send(message)

        route.on_message(passed)

    def looked(route: WebSocketRoute) -> None:
        watched.append(route)
        route.connect_to_server()

    with opened(browser, lab, "lessons") as page:
        page.route_web_socket(re.compile("/ws$"), carried)
        page.route_web_socket(re.compile("/ws/poses"), looked)
        page.reload()
        page.goto(lab.at("lessons/bodies"))
        page.locator(".steps button").first.click()
        while not held:
            page.wait_for_timeout(50)
        page.goto(lab.at("recordings"))
        page.wait_for_selector("main .page[data-page=recordings] h1")
        before = len(watched)
        held[0]()
        page.locator("#command", has_text='"type":"spawn_creature"').wait_for()
        page.wait_for_timeout(300)
        assert len(watched) == before
