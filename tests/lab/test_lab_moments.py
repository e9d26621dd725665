"""What a lab shows of a recording at one moment: inside of a long step, its food, and where the recording fails."""

from __future__ import annotations

import asyncio
import json
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.websockets import WebSocket

from browsers import Socket
from ecosystems import config
from labs import Frame, running_lab
from nmes.lab.folder import Folder
from nmes.lab.lab import open_lab
from nmes.lab.recordings import show_recording
from nmes.playback.watch import states
from nmes.recording import Recording
from nmes.world import World
from recordings import misled, record, rewrite, send

LONG = 1200  # ticks of one step
WRONG = 20  # the frame that does not come out as recorded


@contextmanager
def player(folder: Path) -> Iterator[Socket]:
    """Plays the recording `it` of a lab's folder."""
    with running_lab(folder) as lab, lab.socket("/ws/recording?name=it") as socket:
        assert socket.hear()["type"] == "recording"
        yield socket


def moment(socket: Socket, frame: int, *kinds: str) -> tuple[dict[str, Any], Frame]:
    """Returns the texts that come before the poses of a frame, by type, and these."""
    socket.say({"frame": frame, "show": list(kinds)})
    texts = {}
    while not isinstance(message := socket.hear(), bytes):
        assert message["type"] != "error", message
        texts[message["type"]] = message
    return texts, Frame.read(message)


def place(tmp_path: Path) -> Path:
    """Returns where the recording `it` of a lab in a folder lies."""
    (tmp_path / "recordings").mkdir()
    return tmp_path / "recordings" / "it.mcap"


def test_each_moment_of_a_batch_has_its_own_scene(tmp_path: Path) -> None:
    def play(world: World, client: int) -> None:
        spawns = [{"type": "spawn_cube", "cube_name": name, "position": [0, 9, n]} for n, name in enumerate("abc")]
        send(world, client, type="batch", commands=[each for spawn in spawns for each in (spawn, {"type": "step"})])

    record(place(tmp_path), play)
    with player(tmp_path) as socket:
        shown: Any = None
        for frame in (1, 2, 3, 2, 1, 3):
            texts, poses = moment(socket, frame)
            shown = texts.get("scene", shown)
            assert [cube["name"] for cube in shown["cubes"]] == list("abc"[:frame])
            assert (poses.scene, poses.frame, len(poses.poses)) == (shown["scene"], frame, frame)


def test_any_moment_of_a_long_step_is_shown_with_what_is_asked_for(tmp_path: Path) -> None:
    heights = {}

    def play(world: World, client: int) -> None:
        send(world, client, type="spawn_cube", cube_name="a", position=[0, 900, 0])
        send(world, client, type="apply_physics", cube_name="a", force=[1, 0, 0])
        send(world, client, type="step", ticks=LONG)

    path = record(place(tmp_path), play)
    for frame, _, _, values in states(Recording(path)):
        heights[frame] = values[0, 1]
    with player(tmp_path) as socket:
        for frame in (1, 2, 3, LONG - 1, LONG, 2, 299, 300, 301, 302, 601, 500):
            texts, poses = moment(socket, frame)
            assert poses.frame == frame and poses.poses[0, 1] == np.float32(heights[frame])
            assert "pushes" not in texts
            texts, poses = moment(socket, frame + 1 if frame < LONG else 1, "pushes")
            assert texts["pushes"]["frame"] == poses.frame


def test_the_food_of_each_moment_is_told_where_it_is_another_than_before(tmp_path: Path) -> None:
    foods: list[Any] = []

    def play(world: World, client: int) -> None:
        assert world.life is not None
        for _ in range(60):
            foods.append(world.life.food.items[:, :3].copy())
            send(world, client, type="step")

    record(place(tmp_path), play, {**config(), "backend": "mujoco"})
    known = None
    with player(tmp_path) as socket:
        for frame in (0, 1, 2, 3, 40, 41, 59, 1):
            texts, _ = moment(socket, frame)
            known = texts["food"]["food"] if "food" in texts else known
            assert np.array(known).reshape(-1, 3) == pytest.approx(foods[frame], abs=1e-3)
        assert "food" not in moment(socket, 1)[0]


async def first_tick(folder: Path) -> list[Any]:
    """Returns what a page is sent that asks a lab for the first tick of `it`, and hangs up when it has it."""
    asked = [{"type": "websocket.connect"}, {"type": "websocket.receive", "text": '{"frame":1}'}]
    sent: list[Any] = []
    shown = asyncio.Event()

    async def receive() -> dict[str, Any]:
        if asked:
            return asked.pop(0)
        await shown.wait()
        return {"type": "websocket.disconnect"}

    async def answer(message: Any) -> None:
        sent.append(message)
        if "bytes" in message:
            shown.set()

    async with open_lab(Folder(folder), "", 1) as lab:
        scope = {"type": "websocket", "path": "/", "query_string": b"name=it", "headers": []}
        await show_recording(lab, WebSocket(scope, receive, answer))
    return sent


@pytest.mark.parametrize(("rate", "most"), [(0, 20e6), pytest.param(20, 50e6, marks=pytest.mark.long)])
def test_of_a_long_step_no_more_is_kept_however_much_food_there_is(tmp_path: Path, rate: int, most: float) -> None:
    # 8,000 pieces are 190 kB of text, of 400 ticks 78 MB; the tracing of memory makes this slow.
    food = {"places": [{"radius": 500}], "start": 8000, "rate": rate, "most": 10000, "energy": 300}
    life = config(food=food, population={"start": 1, "most": 1})
    play = partial(send, type="step", ticks=400)
    record(place(tmp_path), play, {**life, "backend": "mujoco"})
    tracemalloc.start()
    try:
        *_, food_told, poses = asyncio.run(first_tick(tmp_path))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(json.loads(food_told["text"])["food"]) >= 8000 and "bytes" in poses
    assert peak < most


def test_a_recording_that_fails_is_shown_up_to_there(tmp_path: Path) -> None:
    def play(world: World, client: int) -> None:
        send(world, client, type="spawn_cube", cube_name="a", position=[0, 9, 0])
        for _ in range(2 * WRONG):
            send(world, client, type="step")

    whole = record(tmp_path / "whole.mcap", play)
    rewrite(whole, place(tmp_path), lambda lines: misled(lines, WRONG))
    with player(tmp_path) as socket:
        for frame in (2 * WRONG, WRONG, WRONG + 1, WRONG):
            for _ in range(2):  # no less the second time
                socket.say({"frame": frame})
                assert socket.hear()["code"] == "diverged"
            assert moment(socket, WRONG - 1)[1].frame == WRONG - 1
