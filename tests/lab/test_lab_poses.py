"""Poses over WebSockets: of live worlds, and of any moment of a recording, as the protocol tells them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.applications import Starlette
from starlette.routing import WebSocketRoute

from browsers import Socket, socket_to
from creatures import SINE, snake
from ecosystems import config
from labs import Frame, RunningLab, running_lab
from nmes.genome import Genome
from nmes.lab.poses import Watchers
from nmes.lab.scene import FORCES
from servers import served, until

NONSENSE: list[str | bytes] = [
    *("{", '{"frame":"x"}', '{"frame":true}', "[]", b"\xff", '{"frame":1e999}'),
    *(f'{{"frame":1,"show":{show}}}' for show in ('"contacts"', '["scenes"]', "[[]]", "[null]", "{}", "1")),
]
"""What a page may not ask a recording for."""


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningLab]:
    with running_lab(tmp_path_factory.mktemp("lab")) as running:
        yield running


def told(world: Socket) -> dict[str, list[float]]:
    """Returns where cubes are, as the protocol tells it."""
    cubes = world.ask({"type": "get_world_state"})["cubes"]
    return {cube["cube_name"]: [*cube["position"], *cube["quaternion"]] for cube in cubes}


def same(told: dict[str, list[float]], scene: Any, frame: Frame) -> bool:
    names = [cube["name"] for cube in scene["cubes"]]
    return frame.scene == scene["scene"] and bool(
        np.array_equal(frame.poses, np.array([told[name] for name in names], "<f4").reshape(-1, 7))
    )


def newest(watcher: Socket, frame: int, scene: Any = None) -> tuple[Any, Frame]:
    """Returns the first frame from that one of the world on, and its scene."""
    while True:
        message = watcher.hear()
        if not isinstance(message, bytes):
            scene = message if message["type"] == "scene" else scene
        elif Frame.read(message).frame >= frame:
            return scene, Frame.read(message)


def iter_texts(player: Socket) -> Iterator[Any]:
    """Yields what comes before the next frame."""
    while not isinstance(message := player.hear(), bytes):
        yield message


def test_a_lockstep_world_is_shown_as_get_world_state_tells_it(lab: RunningLab) -> None:
    with lab.socket() as maker:
        assert maker.ask({"type": "auth", "create": {"world": "still"}})["type"] == "world_list"
    with lab.world(world="still") as world:
        world.ask({"type": "set_mode", "mode": "lockstep"})
        world.ask(
            {"type": "spawn_creature", "genome": Genome.load("walker").document, "name": "w", "position": [0, 0, 0]}
        )
        markup = {
            "type": "spawn_cube",
            "cube_name": "<img/src=x>",
            "color": [1, 0, 0],
            "size": [1, 2, 3],
            "list": False,
        }
        world.ask({**markup, "position": [5, 3, 0], "linear_velocity": [1, 0, 0], "angular_velocity": [0, 3, 1]})
        with lab.socket("/ws/poses?world=still&contacts=1") as watcher:
            scene, frame = newest(watcher, 0)
            cubes = {cube["name"]: cube for cube in scene["cubes"]}
            assert same(told(world), scene, frame)
            assert cubes["<img/src=x>"]["size"] == [1, 2, 3] and cubes["<img/src=x>"]["creature"] is None
            assert [each["name"] for each in scene["creatures"]] == ["w"]
            assert {cube["creature"] for cube in scene["cubes"]} == {"w", None}
            for ticks in (1, 7, 40):
                now = world.ask({"type": "step", "ticks": ticks})["frame"]
                scene, frame = newest(watcher, now, scene)
                assert frame.frame == now and same(told(world), scene, frame)
            for joint in scene["joints"]:
                info = world.ask({"type": "get_joint_info", "joint_name": joint["name"]})
                place, turn = frame.poses[joint["a"], :3], frame.poses[joint["a"], 3:]
                x, y, z, w = turn
                axis, anchor = np.array([x, y, z]), np.array(joint["anchor"])
                world_anchor = place + anchor + 2 * np.cross(axis, np.cross(axis, anchor) + w * anchor)
                assert world_anchor == pytest.approx(np.array(info["anchor"]), abs=1e-2)
            world.ask({"type": "despawn_cube", "cube_name": "<img/src=x>"})
            scene, frame = newest(watcher, 0)
            assert "<img/src=x>" not in {cube["name"] for cube in scene["cubes"]} and same(told(world), scene, frame)


def test_forces_are_told_to_those_alone_who_ask_for_them(lab: RunningLab) -> None:
    with lab.socket() as maker:
        maker.ask({"type": "auth", "create": {"world": "strong"}})
    with lab.world(world="strong") as world:
        world.ask({"type": "set_mode", "mode": "lockstep"})
        genome = Genome.load("walker").document
        spawned = world.ask({"type": "spawn_creature", "genome": genome, "name": "w", "autonomous": True})
        world.ask({"type": "step", "ticks": 60})
        with lab.socket("/ws/poses?world=strong&contacts=1&motors=1") as curious:
            told: dict[str, Any] = {}
            while told.keys() < {"scene", "contacts", "motors"}:
                message = curious.hear()
                told |= {} if isinstance(message, bytes) else {message["type"]: message}
        joints = [joint["name"] for joint in told["scene"]["joints"]]
        efforts = {joints[place]: effort for place, effort in told["motors"]["motors"]}
        assert efforts.keys() == set(spawned["joints"].values())
        for name, effort in efforts.items():
            joint = world.ask({"type": "get_joint_info", "joint_name": name})
            assert effort == pytest.approx(joint["effort"], abs=1e-4) and effort
        cubes = [cube["name"] for cube in told["scene"]["cubes"]]
        pressed = {name: 0.0 for name in cubes}
        for cube, other, *_, force in told["contacts"]["contacts"]:
            assert other == -1 or cubes[other] in pressed
            pressed[cubes[cube]] += force
        for name, force in pressed.items():
            touching = world.ask({"type": "get_cube_info", "cube_name": name})["contacts"]
            assert force == pytest.approx(sum(each["force"] for each in touching), abs=1e-3)
        assert any(pressed.values())
        with lab.socket("/ws/poses?world=strong&motors=yes") as watcher:
            with pytest.raises(TimeoutError):
                while True:
                    message = watcher.connection.recv(0.5)
                    assert isinstance(message, bytes) or json.loads(message)["type"] == "scene"


def test_pushes_are_told_while_they_are_new(lab: RunningLab) -> None:
    with lab.socket() as maker:
        maker.ask({"type": "auth", "create": {"world": "pushed"}})
    with lab.world(world="pushed") as world:
        world.ask({"type": "set_mode", "mode": "lockstep"})
        for place in range(3):
            world.ask({"type": "spawn_cube", "cube_name": f"c{place}", "position": [3 * place, 2, 0], "list": False})

        def pushes() -> list[list[float]]:
            with lab.socket("/ws/poses?world=pushed&pushes=1") as curious:
                while True:
                    message = curious.hear()
                    if not isinstance(message, bytes) and message["type"] == "pushes":
                        rows: list[list[float]] = message["pushes"]
                        return rows

        assert pushes() == []
        lasting = {"force": [1, 2, 3], "torque": [0, 0, 5], "at": [3.5, 2.5, 0]}
        world.ask({"type": "apply_physics", "cube_name": "c1", **lasting})
        world.ask({"type": "apply_force", "cube_name": "c2", "force": [9, 0, 0]})
        world.ask({"type": "apply_physics", "cube_name": "c2", "impulse": [0, 0.5, 0]})
        both = [[1, 3.5, 2.5, 0, 1, 2, 3, 0, 0, 5], [2, 6, 2, 0, 0, 30, 0, 0, 0, 0]]  # of several the last
        assert pushes() == both
        world.ask({"type": "step", "ticks": 6})
        assert [row[0] for row in pushes()] == [1, 2]
        world.ask({"type": "step", "ticks": 1})
        assert pushes() == []
        world.ask({"type": "apply_physics", "cube_name": "c0", "force": [1, 0, 0]})
        world.ask({"type": "despawn_cube", "cube_name": "c0"})
        assert pushes() == []


def test_food_is_told_anew_when_it_grows_or_is_eaten(lab: RunningLab) -> None:
    with lab.socket() as maker:
        maker.ask({"type": "auth", "create": {"world": "pond", "template": "ecosystem"}})
    with lab.world(world="pond") as world, lab.socket("/ws/poses?world=pond") as watcher:
        world.ask({"type": "set_mode", "mode": "lockstep"})
        seen: list[Any] = []
        for _ in range(3):
            world.ask({"type": "step", "ticks": 40})
            there = np.array([food["position"] for food in world.ask({"type": "get_life"})["food"]])
            told: Any = None
            while np.shape(told) != there.shape or not np.allclose(told, there, atol=1e-3):
                message = watcher.hear()
                told = message.get("food") if isinstance(message, dict) else None
            seen.append(told)
        assert seen[0] != seen[1] != seen[2]


def test_who_comes_while_a_world_hibernates_sees_what_was_there(tmp_path: Path) -> None:
    def seen() -> dict[str, Any]:
        texts: dict[str, Any] = {}
        while texts.keys() != {"scene", "food"}:
            message = watcher.hear()
            texts |= {} if isinstance(message, bytes) else {message["type"]: message}
        return texts

    with (
        served({**config(), "backend": "mujoco"}, record_to=tmp_path, hibernate_after=0.05) as server,
        ExitStack() as stack,
    ):
        watchers = Starlette(routes=[WebSocketRoute("/", Watchers(server.host).serve)])
        port = server.run(server.host.serve_http("127.0.0.1", 0, watchers))[1]
        with server.client() as client:
            client.step(ticks=3)
            watcher = stack.enter_context(socket_to(port, "/"))
            before = seen()
        until(lambda: server.call(lambda: server.hosted.hibernation.resting))
        watcher = stack.enter_context(socket_to(port, "/"))
        assert seen() == before and before["food"]["food"]


LOOP = {
    "kind": "graph",
    "nodes": [{"id": "out", "motor": "*"}, {"id": "hidden", "bias": 0.5}],
    "links": [{"from": "hidden", "to": "out", "weight": 1.0}, {"from": "out", "to": "out", "weight": 0.5}],
}


def test_what_a_brain_with_a_memory_does_is_told(lab: RunningLab) -> None:
    steps = 25
    with lab.socket() as maker:
        maker.ask({"type": "auth", "create": {"world": "minds"}})
    with lab.world(world="minds") as world:
        world.ask({"type": "set_mode", "mode": "lockstep"})
        ctrnn = {
            "kind": "ctrnn",
            "time_constants": [0.1, 0.3, 0.2, 0.5],
            "biases": [0.1, -0.4, 0.3, 0.2],
            "weights": np.linspace(-3, 3, 16).reshape(4, 4).tolist(),
            "input_weights": [[2.0], [-1.0], [0.5], [1.0]],
            "inputs": ["*"],
        }
        for name, brain in (("ctrnn", ctrnn), ("loop", LOOP), ("sine", SINE)):
            genome, place = snake(brain), [0, 0, 5 * len(name)]
            world.ask({"type": "spawn_creature", "genome": genome, "name": name, "position": place, "autonomous": True})
        alone = Genome(snake(ctrnn)).brain()
        alone.reset(0, 1 / 60)
        for _ in range(steps):
            outputs = alone.step(world.ask({"type": "sense", "creature": "ctrnn"})["values"]).copy()
            world.ask({"type": "step"})
        told = {}
        for name in ("ctrnn", "loop", "sine"):
            with lab.socket(f"/ws/poses?world=minds&mind={name}") as watcher:
                while (message := watcher.hear())["type"] != "mind":
                    pass
                told[name] = message
                with pytest.raises(TimeoutError):  # neither poses, nor anything else while nothing happens
                    watcher.connection.recv(0.5)
        hidden, out = np.tanh(0.5), 0.0
        for _ in range(steps):
            out = np.tanh(hidden + 0.5 * out)
        assert told["loop"]["units"] == pytest.approx([out, hidden])
        assert told["ctrnn"]["units"] == alone.activity().tolist() == pytest.approx(np.tanh(alone.memory()))
        assert told["ctrnn"]["controls"] == outputs.tolist()
        assert told["sine"]["units"] == [] and len(told["sine"]["controls"]) == len(outputs)
        with lab.socket("/ws/poses?world=minds&mind=none%00<b>") as watcher:
            assert watcher.hear()["type"] == "scene"


def test_a_running_world_is_shown_at_the_pace_of_its_ticks_and_not_where_nothing_moves(lab: RunningLab) -> None:
    with lab.socket() as maker:
        maker.ask({"type": "auth", "create": {"world": "running"}})
    with lab.world(world="running") as world, lab.socket("/ws/poses?world=running") as watcher:
        world.ask({"type": "spawn_cube", "cube_name": "high", "position": [0, 50, 0], "list": False})
        scene, first = newest(watcher, 0)
        while not len(first.poses):  # it was watched before anything was there
            scene, first = newest(watcher, 0, scene)
        frames = [first] + [newest(watcher, 0, scene)[1] for _ in range(30)]
        numbers = [frame.frame for frame in frames]
        assert numbers == sorted(set(numbers)) and numbers[-1] - numbers[0] < 120
        heights = [frame.poses[0, 1] for frame in frames]
        assert heights == sorted(heights, reverse=True) and heights[0] > heights[-1]
        world.ask({"type": "freeze_cube", "cube_name": "high", "freeze": True})
        with pytest.raises(TimeoutError):
            while True:
                watcher.connection.recv(0.7)


def test_there_is_nothing_to_see_of_no_world_and_the_end_of_a_world_ends_it(lab: RunningLab) -> None:
    with lab.socket("/ws/poses?world=none") as watcher:
        assert watcher.rest() == ([], 4404)
    with lab.socket() as maker:
        maker.ask({"type": "auth", "create": {"world": "brief"}})
    with lab.socket("/ws/poses?world=brief") as watcher:
        newest(watcher, 0)
        with lab.socket() as maker:
            maker.ask({"type": "auth", "close": "brief"})
        assert watcher.rest()[1] == 4404


def test_who_watches_says_what_he_likes(lab: RunningLab) -> None:
    with lab.world() as world, lab.socket("/ws/poses?world=main&contacts=%00&x=<b>") as watcher:
        watcher.say("nonsense", b"\xff", '{"frame":1}', "x" * 100_000)
        world.ask({"type": "spawn_cube", "list": False})
        assert newest(watcher, 0)[0]["type"] == "scene"


def test_a_recording_is_shown_at_any_moment_and_a_world_goes_on_from_there(lab: RunningLab) -> None:
    with lab.socket() as maker:
        maker.ask({"type": "auth", "create": {"world": "past"}})
    states: dict[int, dict[str, list[float]]] = {}
    with lab.world(world="past") as world:
        world.ask({"type": "set_mode", "mode": "lockstep"})
        for number in range(3):
            world.ask({"type": "spawn_cube", "cube_name": f"c{number}", "position": [number, 3, 0], "list": False})
            frame = world.ask({"type": "step", "ticks": 300})["frame"]
            states[frame] = told(world)
        world.ask({"type": "nonsense"})
    one, two, last = states  # from 300 on: the world may have ticked before it was told not to
    until(lambda: len(lab.good("/api/recordings?name=past")["items"]) == 1)
    (name,) = (each["name"] for each in lab.good("/api/recordings?name=past")["items"])
    until(lambda: lab.good(f"/api/recordings/{name}")["last"] == last)
    about = lab.good(f"/api/recordings/{name}")
    assert (about["first"], about["tick_rate"], about["world"]) == (0, 60, "past")
    assert len(about["keyframes"]) == 1 and 600 <= about["keyframes"][0] <= two
    commands = [(mark["frame"], mark["what"]) for mark in about["marks"] if mark["kind"] == "command"]
    began = one - 300
    assert commands == [(began, "set_mode"), (began, "spawn_cube"), (one, "spawn_cube"), (two, "spawn_cube")]
    with lab.socket(f"/ws/recording?name={name}") as player:
        assert player.hear() == {"type": "recording", "first": 0, "last": last, "tick_rate": 60, "world": "past"}
        scene: Any = None
        for number in (one, one + 1, last, two, one - 1, one, 5000, 0):
            player.say({"frame": number})
            message = player.hear()
            if not isinstance(message, bytes):
                scene, message = message, player.hear()
            frame = Frame.read(message)
            assert (frame.frame, frame.scene) == (min(number, last), scene["scene"])
            if frame.frame in states:
                assert same(states[frame.frame], scene, frame)
        lying: Any = None
        for kinds in (["contacts"], ["pushes", "contacts"], ["contacts", "motors", "pushes", "contacts"], []):
            player.say({"frame": 599, "show": kinds})
            texts = list(iter_texts(player))
            scene = next((text for text in texts if text["type"] == "scene"), scene)
            forces = [text for text in texts if text["type"] != "scene"]
            assert [text["type"] for text in forces] == [kind for kind in FORCES if kind in kinds]
            lying = lying or forces[0]["contacts"]
            assert not kinds or forces[0]["contacts"] == lying
        assert {row[0] for row in lying} == set(range(len(scene["cubes"])))  # all lie on the ground
        player.say({"frame": 0})
        assert [text["type"] for text in iter_texts(player)] == ["scene"]
        for nonsense in NONSENSE:
            player.say(nonsense)
            assert player.hear()["type"] == "error"
        player.say({"frame": -1})
        assert Frame.read(player.hear()).frame == 0
    forked = lab.good(f"/api/recordings/{name}/fork", {"world": "again", "frame": two})
    assert forked["frame"] == two and forked["command"].endswith(f"--at {two}")
    with lab.world(world="again") as world:
        assert told(world).items() > states[two].items()  # what was sent at that frame has acted: there is a third cube
        world.ask({"type": "step", "ticks": 300})
        assert told(world) == states[last]
    for asked, code in (
        ({"world": "again"}, "world_exists"),
        ({"world": "x", "frame": last + 1}, "no_such_frame"),
        ({"world": "a b"}, "invalid"),
        ({"world": "x", "frame": 1.5}, "invalid"),
        ({}, "invalid"),
    ):
        status, answer = lab.ask(f"/api/recordings/{name}/fork", asked)
        assert (status in (409, 422), answer["error"]["code"]) == (True, code)
    assert lab.ask(f"/api/recordings/{name}/file")[1][:8] == b"\x89MCAP0\r\n"
    verdict = lab.ended(lab.good(f"/api/recordings/{name}/replay", {})["id"])
    assert verdict["result"]["verdict"] == "reproduced" and verdict["command"].startswith("nmes replay ")
    until(lambda: len(lab.good("/api/recordings?name=again")["items"]) == 1)
    (fork,) = (each["name"] for each in lab.good("/api/recordings?name=again")["items"])
    difference = lab.ended(lab.good(f"/api/recordings/{name}/diff", {"other": fork})["id"])
    assert difference["command"].startswith("nmes diff ") and difference["result"]["states"] is None
    for other, status in ((None, 422), (["x"], 422), ("none", 404), ("../x", 400)):
        assert lab.ask(f"/api/recordings/{name}/diff", {"other": other})[0] == status


def test_a_lab_ends_well_while_pages_are_open(tmp_path: Path) -> None:
    with ExitStack() as pages, running_lab(tmp_path / "lab") as lab:
        with lab.world() as world:
            world.ask({"type": "spawn_cube", "list": False})
        until(lambda: len(lab.good("/api/recordings")["items"]) == 1)
        (name,) = (each["name"] for each in lab.good("/api/recordings")["items"])
        for path in ("/ws", "/ws/poses?world=main", f"/ws/recording?name={name}"):
            page = pages.enter_context(lab.socket(path))
            if path != "/ws":
                page.hear()
