"""The docstrings of the client's commands: written from the schemas, and true of what a server refuses."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from client_docs import MODULES, docstring, error_codes, rewrite
from nmes.client import AsyncClient, Client
from nmes.errors import CommandFailed
from nmes.protocol import COMMANDS
from nmes.world.commands import RIGHTS
from servers import served

ROCKER = COMMANDS["spawn_creature"].schema["examples"][0]["genome"]  # two cubes and a joint
CUBES = ("a", "b", "c", "taken.torso", "c2")
OBJECTIVES = 16  # as many as a client may have

# For each code, commands that a server refuses with it, in the world that `client` makes.
REFUSED: dict[str, list[dict[str, Any]]] = {
    "cube_exists": [
        {"type": "spawn_cube", "cube_name": "a"},
        {"type": "spawn_creature", "genome": ROCKER, "name": "taken"},
    ],
    "creature_exists": [{"type": "spawn_creature", "genome": ROCKER, "name": "r"}],
    "cube_not_found": [
        *({"type": kind, "cube_name": "x"} for kind in ("apply_physics", "despawn_cube", "get_cube_info")),
        *({"type": kind, "cube_name": "x"} for kind in ("get_cube_state", "set_cube_state", "get_camera")),
        {"type": "give", "cube_name": "x", "player": 1},
        {"type": "adopt", "creature": "r", "part": "arm", "cube_name": "x"},
        {"type": "say", "cube_name": "x", "channel": "talk", "value": 1},
        {"type": "hear", "cube_name": "x", "channel": "talk"},
        {"type": "apply_force", "cube_name": "x", "force": [1, 0, 0]},
        {"type": "freeze_cube", "cube_name": "x", "freeze": True},
        {"type": "get_world_state", "cubes": ["x"]},
        {"type": "create_joint", "cube1": "a", "cube2": "x", "joint_type": "fixed"},
        {"type": "create_bone", "cube1": "a", "cube2": "x"},
        {"type": "link_cube_chains", "chains": [["a", "b"], ["b", "x"]]},
        {"type": "link_body_cubes", "prefix": "x"},
        {"type": "set_color", "cube_name": "x", "color": [1, 0, 0]},
        {"type": "get_joints_for_cube", "cube_name": "x"},
        {"type": "set_objective", "expression": "time", "cubes": ["x"]},
        {"type": "compute_reward", "metric": "height", "cube": "x"},
    ],
    "joint_not_found": [
        *({"type": kind, "joint_name": "x"} for kind in ("get_joint_info", "remove_joint")),
        {"type": "set_joint_param", "joint_name": "x", "param_name": "damping", "value": 1},
        {"type": "set_joint_params", "joint_name": "x", "params": {}},
    ],
    "creature_not_found": [
        {"type": "drive", "creature": "x", "controls": []},
        {"type": "get_genome", "creature": "x"},
        {"type": "sense", "creature": "x"},
        {"type": "shed", "creature": "x", "part": "y"},
        {"type": "grow", "creature": "x", "part": "y"},
        {"type": "adopt", "creature": "x", "part": "y", "cube_name": "a"},
        {"type": "set_objective", "expression": "time", "creature": "x"},
        {"type": "give", "creature": "x", "player": 1},
        {"type": "say", "creature": "x", "channel": "talk", "value": 1},
        {"type": "hear", "creature": "x", "channel": "talk"},
    ],
    "nothing_owned": [
        *({"type": kind} for kind in ("apply_physics", "get_cube_state", "get_camera")),
        {"type": "set_objective", "expression": "time"},
        {"type": "say", "channel": "talk", "value": 1},
        {"type": "hear", "channel": "talk"},
        {"type": "apply_force", "force": [1, 0, 0]},
        {"type": "compute_reward", "metric": "height"},
    ],
    "joint_exists": [
        {"type": "create_joint", "cube1": "a", "cube2": "b", "joint_type": "fixed", "joint_name": "ab"},
        {"type": "create_bone", "cube1": "a", "cube2": "b", "joint_name": "ab"},
    ],
    "self_joint": [
        {"type": "create_joint", "cube1": "a", "cube2": "a", "joint_type": "fixed"},
        {"type": "create_bone", "cube1": "a", "cube2": "a"},
        {"type": "link_cube_chains", "chains": [["b", "a", "a"]]},
    ],
    "limit_reached": [
        {"type": "spawn_cube"},
        {"type": "spawn_creature", "genome": ROCKER},
        {"type": "create_joint", "cube1": "b", "cube2": "c", "joint_type": "fixed"},
        {"type": "create_bone", "cube1": "b", "cube2": "c"},
        {"type": "link_cube_chains", "chains": [["b", "c"]]},
        {"type": "link_body_cubes", "prefix": "c", "gap": 1000},
        {"type": "set_joint_params", "joint_name": "ab", "params": {}, "notes": {"one_too_many": 1}},
        {"type": "set_objective", "expression": "time", "cubes": ["a"], "name": "one-too-many"},
    ],
    "bad_expression": [
        {"type": "set_objective", "expression": "(", "cubes": ["a"]},
        {"type": "compute_reward", "objective": "endless"},
    ],
    "wrong_mode": [
        {"type": "step"},
        {"type": "set_mode", "mode": "realtime", "barrier": True},
    ],
    "unknown_type": [{"type": "batch", "commands": [{"type": "fly"}]}],
    "player_not_found": [{"type": "give", "cube_name": "a", "player": 9}],
    "not_allowed": [COMMANDS[kind].schema["examples"][0] for kind, right in RIGHTS.items() if right.kind is not None],
}


@contextmanager
def refusing(code: str) -> Iterator[Client]:
    """Gives a client of a world that refuses the commands of a code: some cubes, a joint and the creature r."""
    config: dict[str, Any] = {"backend": "mujoco", "mode": "realtime" if code == "wrong_mode" else "lockstep"}
    config["channels"] = {"talk": {}}
    if code == "limit_reached":
        config["limits"] = {"cubes": len(CUBES) + 2, "joints": 2}
    if any(command["type"] == "give" for command in REFUSED[code]):
        config["roles"] = {"guest": {"own": []}}
    role = "guest" if code == "not_allowed" else None
    with served(config) as server, server.client() as builder, server.client(role=role) as client:
        for number, name in enumerate(CUBES):
            builder.spawn_cube(name, position=[3 * number, 1, 0])
        builder.create_joint("a", "b", "fixed", joint_name="ab", notes={f"note_{n}": n for n in range(32)})
        builder.spawn_creature(ROCKER, name="r", position=[0, 5, 0])
        for name in ("endless", *map(str, range(1, OBJECTIVES))) if role is None else ():
            client.set_objective("1.0 / (time - time)", name=name, cubes=["a"])
        yield client


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.stem)
def test_the_docstrings_are_what_make_format_writes(path: Path) -> None:
    assert rewrite(path.read_text()) == path.read_text()


def test_a_docstring_tells_units_bounds_defaults_and_errors() -> None:
    text = docstring("step", ["ticks"], "Stepped")
    assert "ticks: How many ticks, from 1 to 10,000. Default: 1." in text
    assert "Stepped: The world has ticked." in text
    assert "refused it: `invalid`, `not_allowed`, `unsupported`, `world_faulted` or" in text


@pytest.mark.parametrize("kind", [Client, AsyncClient])
def test_every_method_of_a_client_explains_its_parameters_and_errors(kind: type) -> None:
    methods = {name: getattr(kind, name) for name in dir(kind) if not name.startswith("_")}
    for name, method in methods.items():
        if callable(method) and name not in ("close", "deliver"):  # which take and raise nothing
            text = inspect.getdoc(method) or ""
            parameters = list(inspect.signature(getattr(method, "__wrapped__", method)).parameters)[1:]
            assert "Raises:\n    " in text, f"{kind.__name__}.{name}"
            assert all(f"\n    {parameter}: " in text for parameter in parameters), f"{kind.__name__}.{name}"


@pytest.mark.parametrize("code", REFUSED)
def test_documented_errors_come(code: str) -> None:
    with refusing(code) as client:
        for command in REFUSED[code]:
            with pytest.raises(CommandFailed) as failed:
                client.request(command)
            assert failed.value.code == code, command


def test_every_documented_error_is_tried() -> None:
    tried = {(command["type"], code) for code, commands in REFUSED.items() for command in commands}
    typed = [kind for kind in COMMANDS if hasattr(Client, kind)]
    everywhere = {"invalid", "unsupported", "world_faulted"}
    assert tried == {(kind, code) for kind in typed for code in error_codes(kind) if code not in everywhere}


def test_only_the_commands_that_a_failed_world_answers_do_not_tell_of_it() -> None:
    with served({"backend": "mujoco", "mode": "lockstep"}) as server, server.client() as client:
        client.spawn_cube("a")
        client.apply_force("a", force=[1e15, 0, 0])
        with pytest.raises(CommandFailed, match="stopped at frame"):
            client.step()
        for kind, command in COMMANDS.items():
            if kind != "reset":  # brings the world back
                try:
                    code = client.request(command.schema["examples"][0])["type"]
                except CommandFailed as failed:
                    code = failed.code
                assert (code == "world_faulted") == ("world_faulted" in error_codes(kind)), kind
