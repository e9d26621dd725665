"""What is shown of an ecosystem's recording: numbers, curves, and pictures with its food."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import pytest
from PIL import Image

from command_line import run
from ecosystems import config
from nmes import World
from nmes.recording import Kind, Recorder, Recording
from nmes.view.life_curves import life_curves
from opengl import with_opengl
from recordings import Line, rewrite

TICKS = 160


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("life") / "pond.mcap"
    world = World(config())
    recorder = world.journal = Recorder(path, world, pose_rate=1)
    client = world.join()
    for _ in range(TICKS // 2):
        world.tick()
    world.execute(client, {"type": "reset"})
    for _ in range(TICKS // 2):
        world.tick()
    recorder.close()
    return path


def test_info_tells_who_came_died_and_ate(recording: Path) -> None:
    events = [e for r in Recording(recording) if r.kind is Kind.LIFE and r.about for e in r.about["events"]]
    kinds = [event["type"] for event in events]
    about = json.loads(run("info", "--json", recording).stdout)
    assert about["life"] == {kind: kinds.count(kind) for kind in kinds}
    assert about["census"] == [event for event in events if event["type"] == "census"][-1]
    text = run("info", recording).stdout
    assert f"{kinds.count('creature_born'):,} came, {kinds.count('creature_died'):,} died" in text
    assert f"at last {about['census']['population']} of {about['census']['species']} species" in text


@pytest.mark.parametrize("changes", [{"means": None}, {"means": {"generation": "many"}}, {"born": "some"}])
def test_a_census_that_is_none_is_damage(changes: dict[str, Any], recording: Path, tmp_path: Path) -> None:
    def edited(lines: list[Line]) -> list[Line]:
        return [edit(line) if line.topic == "life" else line for line in lines]

    def edit(line: Line) -> Line:
        content = orjson.loads(line.data)
        for event in content["events"]:
            if event["type"] == "census":
                event |= changes
        return line._replace(data=orjson.dumps(content))

    file = rewrite(recording, tmp_path / "edited.mcap", edited)
    for options in ((), ("--json",), ("--plot", tmp_path / "curves.svg")):
        result = run("info", file, *options)
        assert result.exception is None or isinstance(result.exception, SystemExit)
        assert "does not have the shape of life" in result.stdout or "nothing to plot" in result.output
    assert not any(line for lines in life_curves(Recording(file)).values() for line in lines.values())


def test_curves_are_of_the_censuses_and_go_on_over_a_reset(recording: Path) -> None:
    curves = life_curves(Recording(recording))
    population = curves["creatures, and food"]["population"]
    assert [time for time, _ in population] == [1 / 20, 1, 2, 3, 4, 4 + 1 / 20, 5, 6, 7, 8]
    assert population[0][1] == population[5][1] == 6 and max(value for _, value in population) > 6
    births = [value for _, value in curves["births and deaths in the last minute"]["births"]]
    assert births[0] == births[5] == 0 and births[4] > 0
    assert all(len(line) == 10 for lines in curves.values() for line in lines.values())


def test_a_plot_of_an_ecosystem_has_its_curves(recording: Path, tmp_path: Path) -> None:
    assert run("info", recording, "--plot", tmp_path / "pond.svg").exit_code == 0
    picture = (tmp_path / "pond.svg").read_text()
    assert all(word in picture for word in ("population", "food", "species", "mass, mean (kg)", "generation, mean"))
    assert "contacts" not in picture


@with_opengl
def test_a_picture_shows_food_where_it_is(tmp_path: Path) -> None:
    pictures = []
    for start in (0, 40):
        food = {"places": [{"radius": 1.5}], "start": start, "rate": 0, "reach": 0.001}
        path = tmp_path / f"{start}.mcap"
        world = World(config(food=food, population={"start": 0}))
        recorder = world.journal = Recorder(path, world)
        client = world.join()
        world.execute(client, {"type": "spawn_cube", "position": [0, 0.5, 0], "size": 0.4, "color": [0, 0, 1]})
        world.tick()
        recorder.close()
        shot = run("render", path, "-o", tmp_path / f"{start}.png", "--size", "240x180")
        assert shot.exit_code == 0, shot.output
        pictures.append(np.asarray(Image.open(tmp_path / f"{start}.png")).astype(int))
    yellow = [int(((p[..., 0] > 150) & (p[..., 1] > 110) & (p[..., 2] < 90)).sum()) for p in pictures]
    assert yellow[0] == 0 and yellow[1] > 60
