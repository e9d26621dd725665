"""The pages of runs, as a browser shows them: what is watched of them, and how they are gone on with."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import nmes
from lab_browser import PASSWORD, PATIENCE, Lab, opened, running_browser, serious, served_lab
from nmes.evaluation import Task
from nmes.evolution.run import Run
from processes import NMES
from recordings import busy, record

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Route


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with running_browser() as running:
        yield running


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    """A lab with a finished run over hills, and one of learning."""
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
    learning = ["--task", "walk", "--steps", "64", "--set", "rows=2", "--set", "ticks=16", "--every", "1", "-q"]
    subprocess.run([NMES, "learn", "walker", *learning, "-o", str(folder / "runs/taught")], check=True)
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


def test_of_candidates_that_are_clicked_at_once_the_last_is_watched(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "evolve/hills") as page:
        others = page.locator(".top button")
        others.nth(1).wait_for()
        last = others.nth(1).get_attribute("title")
        # In one go, as a double click on two of them: each is staged while the one before is.
        others.evaluate_all("buttons => [0, 1, 0, 1].forEach((each) => buttons[each].click())")
        page.get_by_role("heading", name=f"{str(last).removeprefix('Watch ').capitalize()}, live").wait_for()
        page.locator(".watched .stage").wait_for()
        with nmes.Client(port=lab.host_port, password=PASSWORD, world="run-hills") as client:
            creatures = {cube["cube_name"].split(".")[0] for cube in client.get_world_state()["cubes"]}
        assert len(creatures) == 1


def settings_of(lab: Lab, run: str) -> Any:
    """Returns what a run was begun with."""
    return json.loads((lab.folder / "runs" / run / "run.json").read_bytes())


def test_a_finished_run_goes_on_to_a_greater_budget(browser: Browser, lab: Lab, tmp_path: Path) -> None:
    options = ["--task", "rough", "--seeds", "3", "--jobs", "1", "-q", "-o"]
    for folder, budget in ((lab.folder / "runs/more", "3"), (tmp_path / "whole", "7")):
        subprocess.run([NMES, "evolve", "walker", "--budget", budget, *options, str(folder)], check=True)
    with opened(browser, lab, "evolve/more") as page:
        page.get_by_text("3 of 3 candidates").wait_for()
        page.get_by_label("Another budget, in candidates").fill("7")
        page.get_by_role("button", name="Go on to").hover()
        shown = f"nmes evolve resume {lab.folder}/runs/more --budget 7"
        assert page.locator("#command").inner_text() == shown
        page.get_by_role("button", name="Go on to").click()
        page.get_by_text("7 of 7 candidates").wait_for(timeout=4 * PATIENCE)
    assert Run.open(lab.folder / "runs/more").digest == Run.open(tmp_path / "whole").digest


def test_another_run_is_begun_like_one_with_its_settings_changed(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "evolve/hills") as page:
        page.get_by_role("link", name="Begin another like it").click()
        page.get_by_label("Name of the run").fill("hills-again")
        page.get_by_label("Budget, in candidates").fill("2")
        options = page.get_by_label("Options of the algorithm, as JSON")
        options.fill(json.dumps({**json.loads(options.input_value()), "population": 8}))
        assert serious(page) == []
        page.get_by_role("button", name="Start").click()
        page.get_by_text("2 of 2 candidates").wait_for(timeout=4 * PATIENCE)
    before, after = settings_of(lab, "hills"), settings_of(lab, "hills-again")
    changed = {name for name in before.keys() | after.keys() if before.get(name) != after.get(name)}
    assert changed == {"budget", "seed", "options"}
    assert (after["budget"], after["seed"], after["options"]["population"]) == (2, before["seed"] + 1, 8)


def test_the_command_line_of_a_run_has_all_that_it_is_begun_with(browser: Browser, lab: Lab) -> None:
    (lab.folder / "tasks").mkdir(exist_ok=True)
    own = {**Task.load("walk").document, "name": "own"}
    (lab.folder / "tasks" / "own.json").write_text(json.dumps(own))
    with opened(browser, lab, "evolve") as page:
        page.get_by_label("Task").select_option("own")
        assert f"--task {lab.folder}/tasks/own.json" in page.inner_text("code.as-command")
        page.goto(lab.at("evolve?like=taught"))
        page.get_by_label("Options of the algorithm, as JSON").wait_for()
        words = shlex.split(page.inner_text("code.as-command"))
        settings = settings_of(lab, "taught")
        assert words[words.index("--every") + 1] == str(settings["every"])
        options = [word.split("=") for before, word in pairwise(words) if before == "--set"]
        assert {name: json.loads(value) for name, value in options} == settings["options"]


def test_a_learning_is_begun_again_with_its_settings_changed(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "evolve/taught") as page:
        page.get_by_role("link", name="Begin another like it").click()
        page.get_by_label("Name of the run").fill("taught-again")
        assert page.get_by_label("Steps to learn from").input_value() == "64"
        options = page.get_by_label("Options of the algorithm, as JSON")
        options.fill(json.dumps({**json.loads(options.input_value()), "rate": 0.001}))
        page.get_by_role("button", name="Start").click()
        page.get_by_text("64 of 64 steps").wait_for(timeout=4 * PATIENCE)
    before, after = settings_of(lab, "taught"), settings_of(lab, "taught-again")
    changed = {name for name in before.keys() | after.keys() if before.get(name) != after.get(name)}
    assert changed == {"seed", "options"} and after["options"]["rate"] == 0.001


def test_a_learning_is_begun_again_on_a_task_of_elsewhere(browser: Browser, lab: Lab, tmp_path: Path) -> None:
    task = tmp_path / "far.json"
    task.write_text(json.dumps({**Task.load("walk").document, "name": "far", "duration": 2}))
    learning = ["--task", str(task), "--steps", "64", "--set", "rows=2", "--set", "ticks=16", "-q"]
    subprocess.run([NMES, "learn", "walker", *learning, "-o", str(lab.folder / "runs/far")], check=True)
    with opened(browser, lab, "evolve/far") as page:
        page.get_by_role("link", name="Begin another like it").click()
        page.get_by_label("Name of the run").fill("far-again")
        assert f"--task {lab.folder}/settings/far-again.json" in page.inner_text("code.as-command")
        page.get_by_role("button", name="Start").click()
        page.get_by_text("64 of 64 steps").wait_for(timeout=4 * PATIENCE)
        assert f"--task {lab.folder}/settings/far-again.json" in page.inner_text("#command")
    before, after = settings_of(lab, "far"), settings_of(lab, "far-again")
    assert {name for name in before if before[name] != after[name]} == {"seed"}


def test_recordings_made_meanwhile_are_offered_above_the_others(browser: Browser, lab: Lab) -> None:
    record(lab.folder / "recordings" / "offered-first.mcap", busy)
    with opened(browser, lab, "evolve") as page:
        page.get_by_role("button", name="Learn", exact=True).click()
        page.get_by_label("Algorithm").select_option("clone")
        choice = page.get_by_label("Recordings to learn from")
        choice.locator("option", has_text="offered-first").wait_for(state="attached")
        choice.select_option("offered-first")
        record(lab.folder / "recordings" / "offered-second.mcap", busy)
        choice.locator("option", has_text="offered-second").wait_for(state="attached")
        names = [name for name in choice.locator("option").all_inner_texts() if name.startswith("offered-")]
        assert names == ["offered-second", "offered-first"]
        assert choice.locator("option:checked").all_inner_texts() == ["offered-first"]


def test_a_brain_learns_from_recordings_that_are_chosen(browser: Browser, lab: Lab) -> None:
    recorded = ["--task", "walk", "--seeds", "1", "--record", str(lab.folder / "recordings"), "--quiet"]
    subprocess.run([NMES, "eval", "walker", *recorded], check=True)
    with opened(browser, lab, "evolve") as page:
        page.get_by_role("button", name="Learn", exact=True).click()
        assert page.get_by_label("Begin with").input_value() == "eel"  # who learns something in half a minute
        assert page.get_by_label("Task").input_value() == "swim"
        page.get_by_label("Algorithm").select_option("clone")
        assert not page.get_by_label("Begin with").is_visible() and not page.get_by_label("Task").is_visible()
        choice = page.get_by_label("Recordings to learn from")
        episode = choice.locator("option", has_text="walker-")
        episode.wait_for(state="attached")
        page.get_by_label("Steps to learn from").fill("600")
        page.get_by_label("Name of the run").fill("copy")
        page.get_by_role("button", name="Start").click()  # nothing is chosen yet: the page says so, and stays
        assert page.evaluate("() => document.querySelector('select[multiple]').matches(':invalid')")
        choice.select_option(episode.inner_text())
        assert re.search(
            r"nmes learn \S+walker-\S+mcap --algorithm clone --steps 600", page.inner_text("code.as-command")
        )
        assert serious(page) == []
        page.get_by_role("button", name="Start").click()
        page.get_by_text(re.compile("[1-9][0-9,]* of at least 600 steps")).wait_for(timeout=4 * PATIENCE)
        assert page.get_by_role("progressbar").get_attribute("aria-valuenow") == "100"
        assert settings_of(lab, "copy")["algorithm"] == "clone"
        page.get_by_role("link", name="Begin another like it").click()
        choice.locator("option", has_text="walker-").wait_for(state="attached")
        page.get_by_label("Name of the run").fill("copy-again")
        page.locator("code.as-command", has_text="walker-").wait_for()
        page.get_by_role("button", name="Start").click()
        page.get_by_text(re.compile("[1-9][0-9,]* of at least 600 steps")).wait_for(timeout=4 * PATIENCE)
    before, after = settings_of(lab, "copy"), settings_of(lab, "copy-again")
    assert {name for name in before if before[name] != after[name]} == {"seed"}


def test_a_run_like_one_of_cloning_has_all_of_its_recordings_and_no_others(browser: Browser, lab: Lab) -> None:
    record(lab.folder / "recordings" / "here.mcap", busy)
    before = [f"{lab.folder}/recordings/not-listed.mcap", "/elsewhere/here.mcap"]
    settings = {"task": {"name": "walk"}, "algorithm": "clone", "seed": 1, "steps": 600, "recordings": before}
    asked: list[Any] = []

    def begin(route: Route) -> None:
        if route.request.method == "POST":
            asked.append(route.request.post_data_json)
            route.fulfill(body="no JSON")
        else:
            route.continue_()

    with opened(browser, lab, "evolve") as page:
        page.route("**/api/runs/copied", lambda route: route.fulfill(json={"kind": "learn", "settings": settings}))
        page.route("**/api/runs", begin)
        page.goto(lab.at("evolve?like=copied"))
        choice = page.get_by_label("Recordings to learn from")
        choice.locator("option", has_text=re.compile("^here$")).wait_for(state="attached")
        assert choice.locator("option:checked").all_inner_texts() == ["not-listed", "/elsewhere/here.mcap"]
        assert f"nmes learn {' '.join(before)} --algorithm clone" in page.inner_text("code.as-command")
        choice.select_option(["not-listed", "here"])
        page.get_by_role("button", name="Start").click()
        page.get_by_text("what is no JSON").wait_for()
    assert asked[0]["settings"]["recordings"] == ["not-listed", "here"]


def test_a_run_that_fails_says_what_its_command_said(browser: Browser, lab: Lab) -> None:
    record(lab.folder / "recordings" / "no-episode.mcap", busy)
    with opened(browser, lab, "evolve") as page:
        page.get_by_role("button", name="Learn", exact=True).click()
        page.get_by_label("Algorithm").select_option("clone")
        choice = page.get_by_label("Recordings to learn from")
        choice.locator("option", has_text="no-episode").wait_for(state="attached")
        choice.select_option("no-episode")
        page.get_by_label("Name of the run").fill("none")
        page.get_by_role("button", name="Start").click()
        page.get_by_text("The command failed").wait_for(timeout=2 * PATIENCE)
        assert re.search(r"nmes learn \S+no-episode.mcap[^\n]*\n(.*\n)*Error: ", page.locator(".said").inner_text())
        job = page.url.split("?job=")[1]
        page.goto(lab.at(f"evolve/hills?job={job}"))  # of a lab before, whose jobs had the same numbers
        page.get_by_text("4 of 4 candidates").wait_for()
        page.get_by_role("button", name="Watch it").wait_for()
        assert not page.locator(".said").is_visible()


def test_a_run_is_shown_again_when_the_lab_answers_again(browser: Browser, lab: Lab) -> None:
    with opened(browser, lab, "evolve/hills") as page:
        best = page.get_by_role("button", name="Watch it")
        best.wait_for()
        page.route("**/api/runs/hills", lambda route: route.fulfill(body="no JSON"))
        page.get_by_text("what is no JSON").wait_for()
        page.unroute("**/api/runs/hills")
        best.wait_for()
