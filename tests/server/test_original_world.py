"""What `nmes serve --dialect original` serves: the scene, the law of motion and the socket of the original server."""

from __future__ import annotations

import csv
import json
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from layout import ROOT, SUPPORT
from nmes import World
from nmes.cli import main
from nmes.cli._serve_settings import DIALECTS
from nmes.playback import replay
from nmes.protocol import DELIMITER
from nmes.recording import Recording
from processes import process, ready
from servers import PASSWORD, Peer

ORIGINAL = DIALECTS["original"]
TARGET = (69.58, 72.56, 30.29)


# -- the law of motion -----------------------------------------------------------------------------------------------


def saved_run() -> list[list[float]]:
    """Returns the rows of a run that was saved with the original server: step, position, velocity, force."""
    with (SUPPORT / "original-run.csv").open() as file:
        return [[float(value) for value in row] for row in list(csv.reader(file))[1:]]


def in_free_flight(before: list[float], after: list[float]) -> bool:
    """Tells whether a cube of edge 1 can have touched neither the planet nor what else hit it in the run."""
    clear = all(np.linalg.norm(row[1:4]) > 100.0 + math.sqrt(0.75) for row in (before, after))
    return clear and float(np.abs(np.subtract(after[4:7], before[4:7])).max()) < 3.0


def carried_on(world: World, row: list[float], law: str = "impulse") -> list[list[float]]:
    """Returns positions and velocities 6, 7 and 8 ticks after a row; its force is heard a tick after it was read."""
    client = world.join()
    world.execute(client, {"type": "spawn_cube", "cube_name": "a", "position": row[1:4], "linear_velocity": row[4:7]})
    states = []
    for tick in range(8):
        if tick == 1:
            assert world.execute(client, {"type": "apply_physics", law: row[7:10]})["type"] == "physics_applied"
        world.tick()
        state = world.execute(client, {"type": "get_cube_state", "cube_name": "a"})
        states.append([*state["position"], *state["linear_velocity"]])
    world.execute(client, {"type": "reset"})
    return states[5:]


def misses(world: World, **options: Any) -> list[tuple[float, float]]:
    """Returns by how much each step in free flight misses the saved run at best, in m and m/s."""
    rows, errors = saved_run(), []
    for before, after in pairwise(rows):
        if in_free_flight(before, after):
            difference = np.abs(np.subtract(carried_on(world, before, **options), after[1:7]))
            errors.append(min((float(part[:3].max()), float(part[3:].max())) for part in difference))
    return errors


def test_a_cube_moves_as_in_a_run_that_the_original_saved() -> None:
    errors = misses(World({**ORIGINAL, "mode": "lockstep"}))
    assert len(errors) >= 30
    assert max(position for position, _ in errors) < 0.02
    assert max(velocity for _, velocity in errors) < 0.01


@pytest.mark.parametrize(
    ("change", "options"),
    [
        ({}, {"law": "force"}),
        ({"damping": {"linear": 0, "angular": 0}}, {}),
        ({"gravity": [0, -8, 0]}, {}),
        ({"scene": {"type": "planets"}}, {}),
        ({"scene": {"type": "flat"}}, {}),
    ],
    ids=["force-for-a-tick", "no-damping", "other-gravity", "planets-below-the-origin", "no-planets"],
)
def test_another_law_would_miss_the_saved_run(change: dict[str, Any], options: dict[str, str]) -> None:
    errors = misses(World({**ORIGINAL, "mode": "lockstep", **change}), **options)
    assert max(velocity for _, velocity in errors) > 0.05


# -- the command line ------------------------------------------------------------------------------------------------


def raw_client(port: int) -> Peer:
    """Returns a peer that has logged in as programs for the original do, with the bare password."""
    peer = Peer(port)
    peer.send(PASSWORD.encode() + DELIMITER)
    assert peer.frame() == b"auth_success"
    return peer


def steer(program: Peer, cube: str) -> float:
    """Pushes a cube towards the target, the further away the harder; returns how far (m) it is from there."""
    error = np.subtract(TARGET, program.ask({"type": "get_cube_info", "cube_name": cube})["position"])
    distance = float(np.linalg.norm(error))
    force = error * min(0.05, 2.0 / distance)
    program.say({"type": "apply_force", "cube_name": cube, "force": force.tolist()})
    assert program.ask({"type": "ping"}) == {"type": "pong"}  # nothing comes before it, and the force has been heard
    return distance


def test_a_proportional_controller_reaches_its_target(tmp_path: Path) -> None:
    options = ("--mode", "lockstep", "--port", "0", "--record", str(tmp_path), "--json")
    with process("serve", "--dialect", "original", *options, NMES_PASSWORD=PASSWORD) as server:
        port = ready(server)["port"]
        with Peer(port) as clock, raw_client(port) as program:
            clock.ask({"type": "auth", "password": PASSWORD})
            program.say({"type": "spawn_cube", "cube_name": "a", "position": [0, 100, 40]})
            nearest = math.inf
            for _ in range(120):  # 12 s of the world, in tenths
                nearest = min(nearest, steer(program, "a"))
                clock.ask({"type": "step", "ticks": 6})
            assert nearest < 10.0
            assert clock.ask({"type": "get_world_info"})["frame"] == 720
        server.terminate()
        assert server.wait() == 0
    (path,) = tmp_path.glob("*.mcap")
    assert Recording(path).config["damping"] == {"linear": 0.1, "angular": 0.1}
    assert replay(path).verdict == "reproduced"


def served_config(tmp_path: Path, *options: str) -> dict[str, Any]:
    """Returns the config of a world that `nmes serve --dialect original` makes of more options."""
    record = tmp_path / "recordings"
    arguments = ("--json", "--port", "0", "--record", str(record), *options)
    with process("serve", "--dialect", "original", *arguments, NMES_PASSWORD=PASSWORD) as server:
        ready(server)
        server.terminate()
        assert server.wait() == 0
    (path,) = record.glob("*.mcap")
    return Recording(path).config


def test_the_dialect_of_the_original_is_the_documented_config(tmp_path: Path) -> None:
    section = (ROOT / "docs" / "cli.md").read_text().partition("With `--dialect original`")[2]
    documented = json.loads(section.partition("```json")[2].partition("```")[0])
    config = served_config(tmp_path)
    assert {field: config[field] for field in documented if field != "scene"} == {
        field: value for field, value in documented.items() if field != "scene"
    }
    assert config["scene"]["planets"] == documented["scene"]["planets"]
    assert documented == ORIGINAL


def test_other_options_win_over_the_dialect_field_by_field(tmp_path: Path) -> None:
    file = tmp_path / "config.json"
    file.write_text(json.dumps({"gravity": [0, -3, 0], "mode": "fast", "substeps": 2}))
    config = served_config(tmp_path, "--config", str(file), "--mode", "lockstep", "--seed", "5")
    assert (config["gravity"], config["mode"], config["seed"], config["substeps"]) == ([0, -3, 0], "lockstep", 5, 2)
    assert config["scene"]["planets"]["layout"] == "corner" and config["damping"]["linear"] == 0.1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--resume", str(ROOT / "replays" / "mujoco-clients.mcap")], "--dialect does not go with --resume"),
        (["--backend", "ballistic"], "ballistic backend has no"),
        (["--dialect", "french"], "is not 'original'"),
    ],
)
def test_what_does_not_go_with_the_dialect_is_said(options: list[str], message: str) -> None:
    arguments = ["serve", "--dialect", "original", "--no-record", "--port", "0", *options]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 2
    assert message in result.output
