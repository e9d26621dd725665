"""What the page for programs of the original server says is so: its tables are read, and tried on a server."""

from __future__ import annotations

import json
import math
import re
import signal
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from layout import ROOT
from nmes.cli import main
from nmes.playback import replay
from nmes.protocol import DELIMITER
from nmes.recording import Recording
from processes import process, ready
from servers import PASSWORD, PATIENCE, Peer

PAGE = (ROOT / "docs" / "deployed-clients.md").read_text()
NUMBERS = {"pi": math.pi, "pi/2": math.pi / 2, "-pi/2": -math.pi / 2, "pi/4": math.pi / 4}


def _table(heading: str) -> list[list[str]]:
    """Returns the cells of the table whose head begins so."""
    (rows,) = re.findall(rf"^\| {re.escape(heading)}.*\n\|[-|]+\n((?:\|.*\n)+)", PAGE, flags=re.MULTILINE)
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows.splitlines()]


@contextmanager
def _original(directory: Path, log: list[str]) -> Iterator[Peer]:
    """Serves a world as the page says; yields a program's connection, and puts what was logged into `log`."""
    options = ["--port", "0", "--mode", "lockstep", "--record", str(directory), "--json"]
    with process("serve", "--dialect", "original", *options, NMES_PASSWORD=PASSWORD) as server:
        with Peer(ready(server)["port"]) as peer:
            peer.send(PASSWORD.encode() + DELIMITER)
            assert peer.frame() == b"auth_success"
            yield peer
        server.send_signal(signal.SIGTERM)
        assert server.stderr is not None
        log += server.stderr.read().splitlines()
        assert server.wait(PATIENCE) == 0


def _join(peer: Peer, kind: str, name: str, **joint: Any) -> dict[str, Any]:
    """Joins two new cubes; returns what is told of the joint."""
    for side in ("a", "b"):
        peer.say({"type": "spawn_cube", "cube_name": f"{name}_{side}", "position": [2.0 * (side == "b"), 120, 0]})
    cubes = {"cube1": f"{name}_a", "cube2": f"{name}_b"}
    created = peer.ask({"type": "create_joint", "joint_type": kind, "joint_name": name, **cubes, **joint})
    assert created == {"type": "joint_created", "joint_name": name}
    told = peer.ask({"type": "get_joint_info", "joint_name": name})
    assert isinstance(told["params"], dict)
    return told["params"]


def test_the_world_and_its_joints_are_those_of_the_page(tmp_path: Path) -> None:
    expected: dict[str, dict[str, object]] = {"pin": {}}
    for kind, parameter, default, _ in _table("joint | parameter"):
        value = NUMBERS[default] if default in NUMBERS else float(default)
        expected.setdefault(kind, {})[parameter.strip("`")] = pytest.approx(value)
    with _original(tmp_path, []) as peer:
        assert len(peer.ask({"type": "get_planets"})) == 27
        assert {kind: _join(peer, kind, f"my_{kind}") for kind in expected} == expected
    (recording,) = tmp_path.iterdir()
    config = Recording(recording).config
    planets = config["scene"]["planets"]
    assert (planets["layout"], planets["radius"], planets["spacing"]) == ("corner", 100, 800)
    assert config["gravity"] == [0, -9.8, 0] and config["damping"] == {"linear": 0.1, "angular": 0.1}
    assert (config["friction"], config["restitution"], config["tick_rate"]) == (1, 0, 60)


def test_what_is_without_effect_or_not_understood_is_logged_once_and_counted(tmp_path: Path) -> None:
    log: list[str] = []
    without_effect = {kind: re.findall(r"`(\w+)`", names) for kind, names in _table("of | without effect")}
    with _original(tmp_path, log) as peer:
        for kind, names in without_effect.items():
            params = {name: 0.25 for name in names}
            for time in ("first", "second"):
                assert _join(peer, kind, f"{kind}_{time}", joint_params=params).items() >= params.items()
        for mas in (2.0, 3.0):
            peer.say({"type": "spawn_cube", "cube_name": f"heavy_{mas:g}", "mas": mas})
        peer.ask({"type": "get_cube_list"})
    (recording,) = tmp_path.iterdir()
    about = json.loads(CliRunner().invoke(main, ["info", "--json", str(recording)]).output)
    given = Counter(f"create_joint {name}" for names in without_effect.values() for name in names for _ in range(2))
    assert about["without_effect"] == given
    assert about["ignored"] == {"spawn_cube mas": 2}
    said = [line.split(" says ")[1] for line in log if " says " in line]
    told = [f"{name.replace(' ', ': ')} is kept and told back, and has no effect" for name in given]
    assert sorted(said) == sorted([*told, "spawn_cube: mas is not understood"])
    assert replay(recording).verdict == "reproduced"


def test_all_that_the_page_names_in_its_last_column_is_there() -> None:
    shown = {name for *_, names in _table("it does |") for name in re.findall(r"`(\w+)`", names)}
    go = "".join(path.read_text() for path in sorted((ROOT / "tests" / "deployed" / "programs").glob("*.go")))
    programs = set(re.findall(r'^\t"(\w+)": +\w+,$', go, flags=re.MULTILINE))
    tests = re.findall(r"^def (test_\w+)", (ROOT / "tests/server/test_deployed_clients.py").read_text(), re.MULTILINE)
    assert {name for name in shown if not name.startswith("test_")} == programs
    assert {name for name in shown if name.startswith("test_")} <= set(tests)
    run = (ROOT / "tests" / "deployed" / "test_programs.py").read_text()
    assert all(re.search(rf"\b{name}\b", run) for name in programs)
