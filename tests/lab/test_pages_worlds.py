"""The pages of the lab, as a browser shows them: worlds, recordings, brains, leaderboards, and what is around them."""

from __future__ import annotations

import json
import math
import re
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import nmes
from boards import DASH
from command_line import run
from creatures import SINE, cpg, snake
from lab_browser import PASSWORD, PATIENCE, Lab, opened, running_browser, serious, served_lab
from layout import ROOT
from nmes.evaluation import Task, evaluate, prove
from nmes.evaluation.leaderboard import Leaderboard
from nmes.genome import Genome
from opengl import OPENGL

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, WebSocket, WebSocketRoute

MARKUP = "<b>bold</b>"
PHONE = {"width": 360, "height": 740}
PAGES = (
    "worlds",
    "worlds/main",
    "recordings",
    "recordings/old",
    "brain",
    "brain/main/flea",
    "brain/table",
    "leaderboard",
)
FLEA: dict[str, Any] = {
    "format": "nmes-genome/1",
    "name": "<b>flea</b>",
    "body": {
        "cubes": [
            {"id": "body", "size": 0.4, "mass": 1, "position": [0, 0.2, 0]},
            {"id": "leg", "size": [0.4, 0.1, 0.1], "mass": 0.3, "position": [0.4, 0.3, 0]},
        ],
        "joints": [
            {
                "id": "hip",
                "cube1": "body",
                "cube2": "leg",
                "type": "hinge",
                "anchor": [0.2, 0.3, 0],
                "motor": {"mode": "position", "range": [-0.5, 0.5], "max_effort": 5},
            }
        ],
    },
    "sensors": [{"type": "position", "joint": "hip"}],
    "brain": {"kind": "mlp", "layers": [{"weights": [[0.5]], "biases": [1.0]}]},
}


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with running_browser() as running:
        yield running


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    """A lab whose world has two creatures, one with markup in its name, with a recording and a leaderboard."""
    folder = tmp_path_factory.mktemp("lab")
    (folder / "recordings").mkdir()
    shutil.copy(sorted((ROOT / "replays").glob("*.mcap"))[0], folder / "recordings" / "old.mcap")
    (folder / "tables").mkdir()
    assert (
        run("learn", "cube", "--episodes", "40", "--test", "1", "-q", "-o", folder / "tables" / "table.json").exit_code
        == 0
    )
    (folder / "leaderboards").mkdir()
    Leaderboard(folder / "leaderboards" / "board.sqlite", create=True).close()
    with served_lab(folder) as running:
        with nmes.Client(port=running.host_port, password=PASSWORD) as client:
            client.spawn_creature(FLEA, name="flea", autonomous=True)
            client.spawn_creature(FLEA, name=MARKUP, position=[2, 0, 0])
        yield running


def frames(page: Page) -> int:
    panes = page.locator(".pane")
    return int((panes.first.get_attribute("data-frames") if panes.count() > 0 else None) or 0)


def show(page: Page, lab: Lab, path: str) -> None:
    """Goes to a page of the lab, and waits until it has loaded what it is about."""
    page.goto(lab.at(path))
    page.wait_for_selector(f"main .page[data-page={path.split('/')[0]}] h1")
    page.wait_for_selector(".loading", state="detached")


def until(page: Page, happened: Callable[[], bool]) -> None:
    """Waits for something that no selector tells; the pages let nobody evaluate text, as Playwright would."""
    end = time.monotonic() + PATIENCE / 1000
    while not happened():
        assert time.monotonic() < end, "it did not happen"
        page.wait_for_timeout(50)


def draw_on(page: Page, change: Callable[[], Any] = lambda: None) -> None:
    """Waits until the world is drawn once more, after a change of what is seen where it stands still."""
    stage = page.locator(".stage")

    def drawn() -> int:
        return int(stage.get_attribute("data-drawn") or 0)

    before = drawn()
    change()
    until(page, lambda: drawn() > before)


def frame(page: Page) -> int:
    """Returns the frame of the world that is shown."""
    return int(page.locator(".clock").inner_text().split("·")[1].replace(",", ""))


def dropped(page: Page, name: str) -> tuple[float, float]:
    """Creates a world with a cube, and returns where it is on the page when it has come to rest."""
    page.get_by_role("button", name="New world").click()
    page.get_by_label("Name", exact=True).fill(name)
    page.get_by_role("button", name="Create and watch").click()
    page.get_by_role("button", name="Drop a cube").click()
    until(page, lambda: frames(page) > 3)  # an empty world is told once or twice: the cube is there
    rests = frame(page) + 90
    until(page, lambda: frame(page) > rests)
    page.get_by_role("button", name="Show all").click()
    page.wait_for_timeout(300)
    box = page.locator("canvas").bounding_box()
    assert box is not None
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def at_frame(page: Page, expected: int) -> None:
    page.wait_for_selector(f".pane[data-frame='{expected}']")


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
        page.get_by_role("button", name="Menu").click()
        page.get_by_role("link", name="Recordings", exact=True).click()
        page.wait_for_selector("[data-page=recordings]")
        assert not page.get_by_role("navigation").is_visible()


def test_a_world_is_watched_as_it_moves(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "worlds/main") as page:
        told: list[int] = []  # the frames whose poses came, by the world's count

        def hear(socket: WebSocket) -> None:
            if "/ws/poses" in socket.url:
                socket.on(
                    "framereceived",
                    lambda sent: told.append(int.from_bytes(sent[4:8], "little")) if isinstance(sent, bytes) else None,
                )

        page.on("websocket", hear)
        page.reload()
        until(page, lambda: frames(page) > 20)
        until(page, lambda: int(page.locator(".stage").get_attribute("data-drawn") or 0) > 5)
        page.get_by_role("button", name="Pause").click()
        page.get_by_role("button", name="Resume").wait_for()
        with nmes.Client(port=lab.host_port, password=PASSWORD, world="main") as client:
            stopped = client.get_world_info()["frame"]
        until(page, lambda: frame(page) == told[-1] == stopped)  # what was on its way has come
        page.wait_for_timeout(500)
        assert told[-1] == stopped and told == sorted(set(told)), "frames come while nothing moves"
        page.get_by_label("How many ticks").fill("3")
        page.get_by_role("button", name="Step").click()
        page.get_by_text(re.compile(f"· {stopped + 3:,}$")).wait_for()
        assert page.locator("#command").inner_text() == '{"type":"step","ticks":3}'
        page.get_by_role("button", name="Resume").click()
        page.get_by_role("button", name="Pause").wait_for()


def test_a_cube_is_inspected_and_pushed_with_the_mouse(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "worlds/new") as page:
        page.goto(lab.at("worlds"))
        x, y = dropped(page, "pushed")
        page.mouse.click(x, y)
        position = page.locator(".facts dt", has_text="Position").locator("+ dd")
        position.wait_for()
        before = position.inner_text()
        page.get_by_label("Pushes").check()
        assert page.locator("#command").inner_text().endswith("pushed-*.mcap --to jsonl")
        page.get_by_role("button", name="Push by dragging").click()
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 60, y - 40, steps=4)
        stage = page.locator(".stage")
        until(page, lambda: int(stage.get_attribute("data-pushes") or 0) > 0)
        page.wait_for_timeout(600)
        page.mouse.move(x + 90, y - 40, steps=4)
        page.mouse.up()
        until(page, lambda: stage.get_attribute("data-pushes") == "0")
        position.filter(has_not_text=before).wait_for()
        assert json.loads(page.locator("#command").inner_text())["type"] == "apply_force"


class Forces:
    """What a page sends to push cubes, and a line to it beside the host's.

    Attributes:
        cubes: The names of the cubes that were pushed, in order.
        held: Whether no answers to pushes come through.
    """

    def __init__(self, page: Page) -> None:
        self.cubes: list[str] = []
        self.held = False
        self._page = page
        self._kept: list[tuple[WebSocketRoute, str | bytes]] = []
        self._routes: list[WebSocketRoute] = []
        page.route_web_socket(re.compile("/ws$"), self._carry)
        page.reload()

    def _carry(self, route: WebSocketRoute) -> None:
        server = route.connect_to_server()
        self._routes.append(route)

        def passed(message: str | bytes) -> None:
            if '"apply_force"' in str(message):
                self.cubes.append(json.loads(message)["cube_name"])
            server.send(message)

        def answered(message: str | bytes) -> None:
            if self.held and '"physics_applied"' in str(message):
                self._kept.append((route, message))
            else:
                route.send(message)

        route.on_message(passed)
        server.on_message(answered)

    def release(self) -> None:
        """Lets the answers through that were held."""
        self.held = False
        for route, message in self._kept:
            route.send(message)
        self._kept = []

    def answered(self) -> bool:
        """Whether the page has all answers to its pushes that come through.

        More may be sent while the page is asked: ask this last, when nothing else will be.
        """
        return self.held or int(self._page.locator(".pane").first.get_attribute("data-pulls") or 0) == len(self.cubes)

    def tell(self, message: dict[str, Any]) -> None:
        """Tells the page something, on the newest connection that it has to a world."""
        self._routes[-1].send(json.dumps(message))


def test_a_cube_that_is_held_with_the_mouse_comes_to_it_and_no_further(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "worlds") as page:
        forces = Forces(page)
        x, y = dropped(page, "held")
        page.get_by_role("button", name="Push by dragging").click()
        page.get_by_role("button", name="Pause").click()
        page.get_by_role("button", name="Resume").wait_for()
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 60, y, steps=4)
        page.wait_for_timeout(500)
        assert forces.cubes == []  # they would all act in the next tick
        page.mouse.up()
        until(page, lambda: len(forces.cubes) == 1)
        assert page.locator("#command").inner_text().startswith('{"type":"apply_force"')
        page.get_by_role("button", name="Resume").click()
        page.get_by_role("button", name="Pause").wait_for()
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 60, y, steps=4)
        with nmes.Client(port=lab.host_port, password=PASSWORD, world="held") as client:
            (cube,) = client.get_world_state()["cubes"]

            def way() -> float:
                (moved,) = client.get_world_state()["cubes"]
                return math.dist(cube["position"], moved["position"])

            begun = frame(page)
            until(page, lambda: frame(page) > begun + 180 and way() > 0.05)  # the slower the page, the fewer pulls
            assert way() < 3
            assert len(forces.cubes) > 10
            for _ in range(3):  # a page that is held up, and then has all frames at once that it missed
                page.evaluate("() => { const end = performance.now() + 1000; while (performance.now() < end); }")
                page.wait_for_timeout(300)
                assert way() < 3
        page.mouse.up()


@contextmanager
def gripped(page: Page, lab: Lab, world: str) -> Iterator[nmes.Client]:
    """Shows a new world that stands still, with cubes a, b and c in a row, of which b is held with the mouse."""
    with nmes.Client(port=lab.host_port, password=PASSWORD) as maker:
        maker.create_world(world)
    with nmes.Client(port=lab.host_port, password=PASSWORD, world=world) as client:
        client.set_mode("lockstep")
        for place, name in enumerate("abc"):
            client.spawn_cube(cube_name=name, position=[3 * place - 3, 5, 0])
        page.goto(lab.at(f"worlds/{world}"))
        until(page, lambda: frames(page) > 0)
        page.get_by_role("button", name="Push by dragging").click()
        draw_on(page, page.get_by_role("button", name="Show all").click)
        box = page.locator("canvas").bounding_box()
        assert box is not None
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        page.mouse.down()
        page.mouse.move(box["x"] + box["width"] / 2 + 60, box["y"] + box["height"] / 2, steps=2)
        page.locator("#command", has_text="apply_force").wait_for()  # a page pulls when it draws
        yield client
        page.mouse.up()


def test_what_is_held_with_the_mouse_is_the_same_cube_whoever_comes_and_goes(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "worlds") as page:
        forces = Forces(page)
        with gripped(page, lab, "shifted") as client:
            cubes = page.locator(".facts dt", has_text="Cubes").locator("+ dd")
            client.despawn_cube(cube_name="a")
            cubes.get_by_text("2", exact=True).wait_for()
            client.step()
            until(page, lambda: forces.cubes != [])
            client.despawn_cube(cube_name="b")
            cubes.get_by_text("1", exact=True).wait_for()
            now = client.step()["frame"]
            until(page, lambda: frame(page) == now)
        assert forces.cubes == ["b"]


def test_what_is_held_with_the_mouse_is_pulled_once_a_tick_whichever_socket_tells_it(
    browser: Browser, lab: Lab
) -> None:
    with opened(browser, lab, "worlds") as page:
        forces = Forces(page)
        with gripped(page, lab, "twice") as client:
            begun = frame(page)
            for _ in range(3):
                client.step()
                until(page, lambda: frame(page) - begun == len(forces.cubes) > 0 and forces.answered())
                forces.tell({"type": "tick", "t": 0, "frame": begun})  # which comes late
                until(page, lambda: frame(page) == begun)


def test_what_is_held_with_the_mouse_is_not_pulled_again_before_the_last_pull_is_answered(
    browser: Browser, lab: Lab
) -> None:
    with opened(browser, lab, "worlds") as page:
        forces = Forces(page)
        with gripped(page, lab, "slow") as client:

            def step(pulls: int) -> None:
                now = client.step()["frame"]
                until(page, lambda: len(forces.cubes) >= pulls and frame(page) == now and forces.answered())
                assert len(forces.cubes) == pulls

            forces.held = True
            for _ in range(5):
                step(1)
            forces.release()
            until(page, forces.answered)
            step(2)
            step(3)


def test_forces_are_drawn_on_demand(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "worlds/main") as page:
        page.reload()  # no page was open before
        until(page, lambda: frames(page) > 5)
        page.get_by_label("Pushes").check()
        expected = f"nmes export {lab.folder}/recordings/main-*.mcap --to jsonl"
        assert page.locator("#command").inner_text() == expected
        page.get_by_label("Pushes").uncheck()
        stage = page.locator(".stage")
        assert (stage.get_attribute("data-contacts"), stage.get_attribute("data-motors")) == ("0", "0")
        for what, message in (("Contacts", '{"type":"get_world_state","sensors":true}'), ("Motors", '{"type":"batch"')):
            attribute = f"data-{what.lower()}"
            page.get_by_label(what).check()
            assert page.locator("#command").inner_text().startswith(message)
            until(page, lambda attribute=attribute: int(stage.get_attribute(attribute) or 0) > 0)  # type: ignore[misc]
            page.get_by_label(what).uncheck()
            until(page, lambda attribute=attribute: stage.get_attribute(attribute) == "0")  # type: ignore[misc]


def test_what_was_not_done_is_not_shown_as_done(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "worlds") as page:
        page.on("dialog", lambda dialog: dialog.dismiss())
        page.get_by_role("button", name="Close main").click()
        assert page.locator(".origin").inner_text() == "same as · message"
        page.get_by_role("button", name="New world").click()
        create = page.get_by_role("button", name="Create and watch")
        create.click()  # it has no name yet
        page.get_by_label("Name", exact=True).fill("main")
        create.click()
        page.locator("main [role=alert]", has_text="main").wait_for()
        page.locator(".dock .past").wait_for(state="hidden")
        assert page.locator(".origin").inner_text() == "same as · command line"
        page.goto(lab.at("worlds/main"))
        page.get_by_role("button", name="Reset").click()
        page.get_by_role("button", name="Drop a cube").click()
        page.get_by_text("done · message to main").wait_for()
        assert page.locator(".dock .history li").count() == 1


def test_names_with_markup_are_text(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "brain") as page:
        page.get_by_text("<b>flea</b>").first.wait_for()
        page.get_by_role("link", name=MARKUP).click()
        page.get_by_role("heading", name=MARKUP).wait_for()
        page.goto(lab.at("worlds"))
        page.get_by_role("button", name="New world").click()
        page.get_by_label("Name", exact=True).fill(MARKUP)
        page.get_by_role("button", name="Create and watch").click()
        page.get_by_role("heading", name=MARKUP).wait_for()
        page.goto(lab.at("worlds"))
        page.get_by_role("link", name=MARKUP).wait_for()
        assert page.locator("main b").count() == 0


def test_a_recording_is_scrubbed_judged_and_gone_on_from(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "recordings") as page:
        page.get_by_label("Find a recording by a part of its name").fill("old")
        page.get_by_role("link", name="old", exact=True).click()
        line = page.get_by_label("Frame", exact=True)
        until(page, lambda: int(line.get_attribute("max") or 0) > 10)
        middle = int(line.get_attribute("max") or 0) // 2
        line.fill(str(middle))
        at_frame(page, middle)
        page.get_by_role("button", name="One frame back").click()
        at_frame(page, middle - 1)
        page.get_by_role("button", name="Replay and compare").click()
        page.get_by_text(re.compile("^(reproduced|not comparable)$")).wait_for()
        assert page.locator("#command").inner_text().startswith("nmes replay ")
        page.get_by_label("Name of the new world").fill("forked")
        page.get_by_role("button", name="Go on from here").click()
        page.wait_for_url("**/#/worlds/forked")
        assert f"--at {middle - 1}" in page.locator("#command").inner_text()
        until(page, lambda: frames(page) > 0)


def test_a_brain_is_drawn_and_does_something(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "brain/main/flea") as page:
        page.get_by_role("heading", name="A brain of kind mlp").wait_for()
        unit = page.locator(".network .unit").last
        until(page, lambda: unit.evaluate("unit => Number(unit.style.fillOpacity)") > 0.5)
        assert page.locator(".bars li").count() == 2  # a sensor and a motor
        assert page.locator(".wire title").first.text_content() == "0.500"


def test_a_brain_with_a_memory_is_drawn_as_it_works(browser: Browser, lab: Lab) -> None:
    rest: dict[str, Any] = {"time_constants": [0.2, 0.2], "biases": [3.0, -3.0], "weights": [[0.0, 0.0], [0.0, 0.0]]}
    recurrent = {**FLEA, "brain": {"kind": "ctrnn", **rest, "input_weights": [[0.0], [0.0]]}}
    swinging = {**FLEA, "brain": {"kind": "cpg", "oscillators": [{"motor": "hip", "frequency": 1, "offset": 0.9}]}}
    with nmes.Client(port=lab.host_port, password=PASSWORD) as client:
        for place, (name, genome) in enumerate({"recurrent": recurrent, "swinging": swinging}.items()):
            client.spawn_creature(genome, name=name, autonomous=True, position=[0, 0, 3 + 2 * place])
    for name, units in (("recurrent", [0.905, 0.905]), ("swinging", [])):
        with opened(browser, lab, f"brain/main/{name}") as page:
            page.get_by_text("depends on their past").wait_for()
            dots = page.locator(".network .unit")
            until(page, lambda: dots.last.evaluate("unit => Number(unit.style.fillOpacity)") > 0.05)  # noqa: B023
            filled = dots.evaluate_all("units => units.map(unit => Number(unit.style.fillOpacity))")
            assert units == [] or filled[-2:] == pytest.approx(units, abs=0.01)
            motors = page.locator(".card", has_text="What its motors are told")
            until(page, lambda: motors.locator(".number").inner_text() != "")  # noqa: B023
            assert motors.get_by_text("hip").count() == 1
            assert serious(page) == []


def test_a_brain_that_ships_and_leaves_weights_out_is_drawn(browser: Browser, lab: Lab) -> None:
    bat = Genome.load("bat").document
    assert any("weight" not in link for link in bat["brain"]["links"])
    with nmes.Client(port=lab.host_port, password=PASSWORD) as client:
        client.spawn_creature(bat, name="bat", autonomous=True, position=[0, 0, 9])
    with opened(browser, lab, "brain/main/bat") as page:
        page.get_by_role("heading", name="A brain of kind graph").wait_for()
        assert page.locator(".wire").count() == len(bat["brain"]["links"])


def test_a_table_of_q_learning_is_a_map_of_states(browser: Browser, lab: Lab) -> None:
    table = json.loads((lab.folder / "tables" / "table.json").read_text())
    with opened(browser, lab, "brain/table") as page:
        page.get_by_role("heading", name=table["title"]).wait_for()
        states = page.locator(".state")
        assert states.count() == 7 * 7
        middle = (3 * 7 + 3) * 25 + 12  # of 7 x 7 ranges of where the target is, and 5 x 5 of velocity
        page.get_by_role("heading", name=f"State {middle:,}").wait_for()
        states.nth(3 * 7 + 3).focus()
        page.keyboard.press("ArrowRight")  # along the first dimension
        page.get_by_role("heading", name=f"State {middle + 7 * 25:,}").wait_for()
        page.get_by_label("velocity along z").select_option("0")
        state = middle + 7 * 25 - 2
        page.get_by_role("heading", name=f"State {state:,}").wait_for()
        rows = page.locator("tbody tr")
        shown = [
            (float(row.locator("td").nth(1).inner_text()), int(row.locator("td").nth(2).inner_text()))
            for row in rows.all()
        ]
        assert shown == [
            (round(value, 3), count)
            for value, count in zip(table["values"][state], table["visits"][state], strict=True)
        ]
        for place in range(49):
            seen = sum(table["visits"][((place % 7) * 7 + place // 7) * 25 + 10])
            assert ("never" in str(states.nth(place).get_attribute("class"))) == (seen == 0)
        boxes = [state.bounding_box() for state in states.all()]  # all are there, in seven rows of seven
        assert len({round(box["x"]) for box in boxes if box}) == len({round(box["y"]) for box in boxes if box}) == 7


def test_a_cube_is_taught_from_the_page(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "brain") as page:
        page.get_by_label("Episodes to learn from").fill("5")
        page.get_by_role("button", name="Teach a cube").click()
        page.get_by_role("heading", name="A cube that is pushed to a target").wait_for(timeout=60_000)
        assert "learn cube -o" in page.locator("#command").inner_text()
        assert json.loads((lab.folder / "tables" / "cube-1.json").read_text())["figures"]["episodes"] == 5


def test_an_empty_leaderboard_says_how_to_fill_it(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "leaderboard") as page:
        page.get_by_text("Nothing is listed yet").wait_for()
        assert str(lab.folder / "leaderboards" / "board.sqlite") in page.locator("main code").inner_text()


def test_one_entry_of_a_leaderboard_is_verified(browser: Browser, lab: Lab, tmp_path: Path) -> None:
    dash = Task(DASH)
    with Leaderboard(lab.folder / "leaderboards" / "dash.sqlite", create=True) as board:
        board.allow(dash)
        for brain, name in ((SINE, "wave"), (cpg(4), MARKUP)):
            recordings = evaluate(Genome(snake(brain, name=name, author="Ada")), dash, record=tmp_path).recordings
            board.add([prove(path) for path in recordings])
    with opened(browser, lab, "leaderboard/dash") as page:
        button = page.get_by_role("button", name="Verify wave")
        button.hover()
        page.get_by_text(re.compile(r"nmes leaderboard verify \S+dash.sqlite [12]")).wait_for()
        button.click()
        page.get_by_text("wave holds.").wait_for(timeout=1000 * PATIENCE)
        assert page.locator(".badge.good").count() == 1 and page.locator("tbody tr").count() == 2
        film = page.get_by_role("button", name="Film wave")
        film.hover()
        same = r"nmes render \S+dash.recordings/\w+.mcap -o \S+gif --to 8s --size 480x360 --fps 15$"
        page.get_by_text(re.compile(same)).first.wait_for()
        if OPENGL:
            film.click()
            picture = page.get_by_alt_text("A film of wave on dash")
            picture.wait_for(timeout=4 * PATIENCE)
            until(page, lambda: picture.evaluate("film => film.complete && film.naturalWidth") == 480)
            assert (lab.folder / "films").is_dir()
        assert serious(page) == []
        page.set_viewport_size({"width": 360, "height": 740})
        assert page.evaluate("document.documentElement.scrollWidth") <= 360


def test_the_keyboard_reaches_everything(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "worlds") as page:
        page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement.textContent") == "Skip to the page"
        page.keyboard.press("Enter")
        assert page.evaluate("document.activeElement.id") == "main"
        page.get_by_role("button", name="New world").focus()
        page.keyboard.press("Enter")
        assert page.evaluate("document.activeElement.placeholder") == "arena"
        page.keyboard.type("typed")
        page.keyboard.press("Enter")
        page.wait_for_url("**/#/worlds/typed")
        assert page.locator("#command").inner_text().startswith("nmes worlds 127.0.0.1:")


def test_the_theme_is_changed_and_kept(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "worlds", color_scheme="light") as page:
        page.get_by_role("button", name="Dark theme").click()
        assert page.evaluate("document.documentElement.dataset.theme") == "dark"
        page.reload()
        page.get_by_role("button", name="Light theme").wait_for()


COUNTED = """
const {createTexture: made, deleteTexture: gone} = WebGL2RenderingContext.prototype;
const count = (by) => {
  const {dataset} = document.documentElement;
  dataset.textures = Number(dataset.textures ?? 0) + by;
};
WebGL2RenderingContext.prototype.createTexture = function () { count(1); return made.call(this); };
WebGL2RenderingContext.prototype.deleteTexture = function (texture) { count(-1); return gone.call(this, texture); };
"""


def test_scenes_that_are_gone_leave_no_textures_behind(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "worlds/main") as page:
        page.add_init_script(COUNTED)
        page.reload()
        until(page, lambda: frames(page) > 0)
        counts = []
        cubes = page.locator(".facts dt", has_text="Cubes").locator("+ dd")
        with nmes.Client(port=lab.host_port, password=PASSWORD) as client:
            for number in range(8):
                client.spawn_cube(cube_name=f"brief{number}", position=[30, 1, 2 * number])
                cubes.get_by_text(str(len(client.get_world_state()["cubes"])), exact=True).wait_for()
                draw_on(page)
                counts.append(int(page.locator("html").get_attribute("data-textures") or 0))
            for number in range(8):
                client.despawn_cube(cube_name=f"brief{number}")
        assert counts[-1] == counts[1] > 0, counts


TWICE = """() => new MutationObserver((_, watcher) => {
  const now = [...document.querySelectorAll(".banner button")].find((button) => button.textContent === "Now");
  if (now !== undefined) {
    watcher.disconnect();
    now.click();
    if (now.isConnected) now.click();
  }
}).observe(document.body, { subtree: true, childList: true })"""  # it is there for half a second, however slow we are


def test_a_lost_connection_is_told_and_comes_back(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "worlds/main") as page:
        sockets: list[WebSocketRoute] = []

        def carried(route: WebSocketRoute) -> None:
            sockets.append(route)
            route.connect_to_server()

        page.route_web_socket(re.compile("/ws/poses"), carried)
        page.reload()
        until(page, lambda: frames(page) > 5)
        sockets[0].close(code=1001)
        page.get_by_text("The connection is lost.", exact=False).first.wait_for()
        page.wait_for_selector(".banner", state="hidden")
        assert len(sockets) == 2
        before = frames(page)
        until(page, lambda: frames(page) > before + 5)
        page.evaluate(TWICE)
        sockets[-1].close(code=1001)
        before = frames(page)
        until(page, lambda: frames(page) > before + 5)
        assert len(sockets) == 3
