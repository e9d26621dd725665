"""Forged snapshots: refused, or taken up by a world that goes on soundly; never half taken up."""

from __future__ import annotations

import base64
import copy
import json
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import orjson
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lockstep import Say, world_of
from nmes import World
from nmes.errors import WorldError


def told_world(backend: str) -> tuple[World, Say]:
    """Returns a world with all that a snapshot may hold: cubes asleep, frozen, pushed and parked, joints, clients."""
    world, say = world_of(backend=backend, seed=3)
    kinds = ["fixed"] if backend == "ballistic" else ["hinge", "slide", "conetwist", "fixed", "pin", "hinge"]
    for number in range(8):
        say("spawn_cube", cube_name=f"c{number}", position=[1.2 * number, 0.5, 0], is_base=number == 0)
    say("step", ticks=100)
    names = world.cubes()
    for number, kind in enumerate(kinds, 1):
        fields = {"limits": [0.5, 0.5]} if kind == "conetwist" else {}
        reply = say("create_joint", joint_type=kind, cube1=names[number % 6], cube2=names[(number + 1) % 6], **fields)
        assert reply["type"] == "joint_created", reply
    if backend == "mujoco":
        say("set_joint_param", joint_name=world.joints()[0], param_name="motor_target_velocity", value=1)
    say("set_objective", expression="displacement.x", cubes=["c3", "c4"])
    say("subscribe", events=["state", "tick"])
    say("step", ticks=2)
    say("apply_physics", cube_name="c7", force=[1, 0, 0], impulse=[0, 1, 0])
    return world, say


ODD: list[Any] = [
    None,
    True,
    -1,
    0,
    1,
    2,
    7,
    10**6,
    10**30,
    1e300,
    -1e9,
    0.5,
    "",
    "c1",
    "hinge",
    [],
    {},
    [0] * 40,
    [1e9] * 3,
]


def paths(value: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Returns where the values of a JSON document are."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [at, *(path for key, part in inner for path in paths(part, (*at, key)))]


def edit(document: Any, path: tuple[Any, ...], how: int, value: Any) -> None:
    """Replaces, removes or doubles the value at a path; the bytes of base64 are changed within."""
    *way, last = path
    for key in way:
        document = document[key]
    old = document[last]
    if how == 1:
        del document[last]
    elif how == 2 and isinstance(document, list):
        document.insert(last, old)
    elif how == 3 and isinstance(old, str) and len(old) > 100:
        numbers = np.frombuffer(base64.b64decode(old)).copy()
        kind = len(str(value))
        numbers[kind * 31 % len(numbers)] = (np.nan, np.inf, -1e300, 1e12)[kind % 4]
        document[last] = base64.b64encode(numbers.tobytes()).decode()
    elif how == 4 and isinstance(old, str) and len(old) > 100:
        document[last] = old[: len(old) // 8 * 4]
    else:
        document[last] = value


def written(document: Any, backend: str = "mujoco") -> bytes:
    """Returns a document as the world, or that engine, writes it."""
    if backend == "ballistic":
        return json.dumps(document).encode()
    try:
        return orjson.dumps(document)
    except TypeError:  # an integer of more than 64 bits
        return json.dumps(document, separators=(",", ":")).encode()


@cache
def saved(backend: str) -> tuple[bytes, dict[str, Any], Any]:
    """Returns a snapshot, and its two documents."""
    snapshot = told_world(backend)[0].snapshot()
    line, _, engine = snapshot.partition(b"\n")
    return snapshot, json.loads(line), json.loads(engine)


def assert_refused_or_sound(backend: str, snapshot: bytes) -> None:
    """A snapshot is refused and changes nothing, or is taken up and then never fails but by its own physics."""
    world, say = world_of(backend=backend, seed=3)
    say("spawn_cube", cube_name="here")
    before = world.digest()
    try:
        world.restore(snapshot)
    except WorldError as error:
        assert error.code == "bad_snapshot"
        assert (world.cubes(), world.digest()) == (["here"], before)
        return
    for _ in range(3):
        world.tick()
    for number in range(8):
        say("set_cube_state", cube_name=f"c{number}", position=[number, 3, 1])
        say("spawn_cube", list=False)
    for kind in ("get_world_state", "get_joint_list", "step", "step"):
        say(kind)
    for joint in world.joints() if world.fault is None else ():
        say("get_joint_info", joint_name=joint)
        say("set_joint_param", joint_name=joint, param_name="stiffness", value=1)
        say("remove_joint", joint_name=joint)
    world.tick()
    if world.fault is None:
        world.snapshot()
    else:
        assert world.fault.code == "diverged", world.fault


@settings(max_examples=120)
@given(st.data(), st.sampled_from(["mujoco", "mujoco", "ballistic"]))
def test_an_edited_snapshot_is_refused_or_sound(data: st.DataObject, backend: str) -> None:
    _, *documents = copy.deepcopy(saved(backend))
    part = data.draw(st.integers(0, 1))
    places = paths(documents[part])[1:]
    edit(
        documents[part],
        data.draw(st.sampled_from(places)),
        data.draw(st.integers(0, 4)),
        data.draw(st.sampled_from(ODD)),
    )
    assert_refused_or_sound(backend, written(documents[0]) + b"\n" + written(documents[1], backend))


FORGED: dict[str, Callable[[Any], object]] = {
    "a tree that sleeps with one that is not there": lambda e: e["asleep"].__setitem__(0, 10**6),
    "trees that sleep in no ring": lambda e: e.update(asleep=[1] * len(e["asleep"])),
    "a count beyond all": lambda e: e["asleep"].__setitem__(0, -(10**6)),
    "too few trees": lambda e: e["asleep"].pop(),
    "a force on nobody": lambda e: e["force"].append([99, [0.0] * 6]),
    "a force of five numbers": lambda e: e["force"].append([2, [0.0] * 5]),
    "a watched body that is not there": lambda e: e["parting"].append(99),
    "one that glides and is not watched": lambda e: e.update(gliding=[2]),
    "a heap that is neither there nor not": lambda e: e.update(heaped=1),
    "a root that is none": lambda e: e["roots"].append(99),
    "a million parked bodies": lambda e: e["roots"].extend([-1] * 10**6),
    "a joint to nowhere": lambda e: e["joints"][0].update(body2=99),
    "a joint of one body": lambda e: e["joints"][0].update(body2=e["joints"][0]["body1"]),
    "a joint that the world does not know": lambda e: e["joints"].append({**e["joints"][0], "number": 77}),
    "a joint of another kind": lambda e: e["joints"][0].update(kind="slide"),
    "a body that the world does not know": lambda e: (
        e["bodies"].append({**e["bodies"][5], "number": 77}),
        e["roots"].append(77),
        e["asleep"].append(-2),
    ),
    "a body twice": lambda e: e["bodies"].append(e["bodies"][0]),
    "a body that is thawed": lambda e: e["bodies"][0].update(frozen=False),
    "a size of nothing": lambda e: e["bodies"][1].update(size=[1, 1, 0]),
    "a state of no numbers": lambda e: e.update(state=base64.b64encode(bytes.fromhex("7ff8") * 4 * 40).decode()),
    "another word": lambda e: e.update(more=1),
}


def refused(snapshot: bytes, forged: bytes) -> None:
    """Fails unless a world refuses a forged snapshot, and takes up the true one after it."""
    world = World({"mode": "lockstep", "seed": 3})
    with pytest.raises(WorldError) as caught:
        world.restore(forged)
    assert caught.value.code == "bad_snapshot"
    world.restore(snapshot)
    assert world.snapshot() == snapshot


@pytest.mark.parametrize("what", FORGED)
def test_a_forged_snapshot_is_refused(what: str) -> None:
    snapshot, _, engine = saved("mujoco")
    engine = copy.deepcopy(engine)
    FORGED[what](engine)
    refused(snapshot, snapshot.partition(b"\n")[0] + b"\n" + written(engine))


FORGED_WORLDS: dict[str, Callable[[Any], object]] = {
    "parameters left out": lambda w: w["assembly"]["joints"][0]["params"].clear(),
    "a parameter of another type": lambda w: w["assembly"]["joints"][0]["params"].update(stiffness="high"),
    "a number given away again": lambda w: w["assembly"].update(spawned=2),
    "cubes out of order": lambda w: w["assembly"]["cubes"].reverse(),
    "a cube that the engine does not have": lambda w: w["assembly"]["cubes"].append(
        {**w["assembly"]["cubes"][0], "name": "new", "body": 99}
    ),
    "a frame that is no integer": lambda w: w.update(frame=1e300),
    "more frames than ticks": lambda w: w.update(ticks=0),
    "a client to come who is in": lambda w: w.update(next_client=1),
}


@pytest.mark.parametrize("what", FORGED_WORLDS)
def test_a_snapshot_with_a_forged_world_is_refused(what: str) -> None:
    snapshot, state, _ = saved("mujoco")
    state = copy.deepcopy(state)
    FORGED_WORLDS[what](state)
    refused(snapshot, written(state) + b"\n" + snapshot.partition(b"\n")[2])
