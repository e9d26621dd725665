"""Commands of strangers, at random and at every bound: none may stop a world that others are in.

What may stop a world is what its engine makes of its bodies, and that alone: forces, speeds and joints that it cannot
integrate, more contacts than it has room for. Whatever else a client does is its own error.
"""

from __future__ import annotations

import logging
import random
from collections.abc import Callable
from typing import Any

import pytest

from nmes import World, protocol
from nmes.objective import CUBE_QUANTITIES, FOLDS, QUANTITIES
from nmes.objective.trajectory import RunningQuantities
from nmes.world.subscription import Subscription

Json = dict[str, Any]

# Of these, an engine says by itself that it cannot go on.
PHYSICS = {"diverged", "contact_overflow", "constraint_overflow", "arena_exhausted"}
NAMES = ["a", "b", "c", "d", "x" * 128, "no_such_thing"]
EXPRESSIONS = [
    "height < sqrt(position.x) ? 1.0 : 2.0",
    "mean.height / (max.speed - max.speed)",
    "exp(exp(energy)) - exp(exp(time))",
    "log(-distance) == log(-distance) ? 1 : contacts",
    'cube("a").lowest + min.cube("b").reach * time_upright',
    "-" * 99 + "mass",
]
LEG = {"id": "hip", "cube1": "torso", "cube2": "leg", "type": "hinge", "anchor": [0.2, 0.2, 0]}
PAIR = {
    "cubes": [
        {"id": "torso", "size": 0.4, "mass": 1, "position": [0, 0.2, 0]},
        {"id": "leg", "size": [0.4, 0.2, 0.2], "mass": 0.01, "position": [0.4, 0.2, 0]},
    ],
    "joints": [{**LEG, "motor": {"mode": "position", "range": [-1, 1], "max_effort": 1e4}}],
}
CHAIN = {
    "graph": {
        "root": "torso",
        "parts": [{"id": "torso", "size": 0.4, "recursive_limit": 9, "joint": {"type": "slide"}}],
        "connections": [{"from": "torso", "to": "torso", "face": "+y", "scale": 1.2, "mirror": "x"}],
    }
}


class Stranger:
    """Makes up commands, most of them valid and about what is there, with numbers at and between their bounds."""

    def __init__(self, seed: int, world: World) -> None:
        self.choice = random.Random(seed)
        self._world = world
        often = [
            "create_joint",
            "set_joint_param",
            "spawn_creature",
            "drive",
            "set_objective",
            "compute_reward",
            "step",
        ]
        self._kinds = [*sorted(protocol.COMMANDS), *often, *often]

    def command(self, within: bool = False) -> Json:
        kind = self.choice.choice(self._kinds)
        if (kind == "batch" and within) or (kind in ("reset", "despawn_cube") and self.choice.random() < 0.9):
            kind = "create_joint"
        schema = protocol.COMMANDS[kind].schema
        command: Json = {"type": kind}
        for name, part in schema["properties"].items():
            wanted = name in schema["required"] or self.choice.random() < 0.5
            if name not in ("type", "id") and wanted:
                command[name] = self.field(kind, name, part)
        return command

    def field(self, kind: str, name: str, part: Json) -> Any:
        choose = self.choice.choice
        there = {
            **{"creature": self._world.creatures, "joint_name": self._world.joints},
            **dict.fromkeys(["cube", "cube1", "cube2", "cube_name"] if kind != "spawn_cube" else [], self._world.cubes),
        }
        if name in there and (names := there[name]()) and self.choice.random() < 0.95:
            return choose(names)
        match name:
            case "cubes":
                return self.choice.sample(names := self._world.cubes(), min(len(names), 3)) or ["a"]
            case "controls":
                return [choose([-1, 0, 0.5, 1])] * choose([1, 1, 8])
            case "commands":
                return [self.command(within=True) for _ in range(self.choice.randint(0, 6))]
            case "ticks" | "agents":
                return self.choice.randint(1, 3)
            case "width" | "height":
                return choose([1, 7])
            case "genome":
                return {"format": "nmes-genome/1", "name": "x", "body": choose([PAIR, PAIR, CHAIN, {}, {"cubes": []}])}
            case "value" if kind == "set_joint_param":
                return choose([True, False, 0, -1, 1e6, 1e15, 1e-300, self.choice.uniform(-3, 3)])
            case "expression":
                fold, quantity = choose([*FOLDS]), choose([*QUANTITIES, *CUBE_QUANTITIES])
                return choose([*EXPRESSIONS, f"{fold}.{quantity} / {fold}.{quantity}", "no good"])
        return self.value(part)

    def value(self, part: Json) -> Any:
        choose = self.choice.choice
        if "anyOf" in part:
            return self.value(choose(part["anyOf"]))
        if "enum" in part or "const" in part:
            return choose(part.get("enum", [part.get("const")]))
        match part.get("type"):
            case "boolean":
                return choose([True, False])
            case "string":
                return choose(NAMES)
            case "array":
                count = self.choice.randint(part.get("minItems", 0), min(part.get("maxItems", 4), 4))
                items = [self.value(part["items"]) for _ in range(count)]
                return list(dict.fromkeys(items)) if part.get("uniqueItems") else items
            case "number" | "integer":
                low, high = part.get("minimum", -1e6), part.get("maximum", 1e6)
                middle = self.choice.uniform(max(low, -4), min(high, 4))
                number = choose([low, high, 0, 1, middle, middle, middle, middle, 1e-300])
                number = min(max(number, low), high)
                return int(number) if part["type"] == "integer" else number
        return choose([None, 1, "x", {"y": []}])


# What MuJoCo says of masses that are too unequal, which only pytest makes an error: tests/hostile/test_engines.py.
diverging = pytest.mark.filterwarnings("ignore:Inertia matrix:UserWarning")


def campaign(seed: int, commands: int, backend: str) -> None:
    config: Json = {"backend": backend, "mode": "lockstep", "limits": {"cubes": 60}}
    world = World(config, emit=lambda client, event: protocol.validate_event(protocol.decode(event)))
    hostile, neighbour = world.join(), world.join()
    stranger = Stranger(seed, world)
    world.execute(neighbour, {"type": "subscribe"})
    for number in range(commands):
        if number % 100 == 0 or not world.cubes():
            world.execute(neighbour, {"type": "reset", "seed": number})
            for name in "abc":
                place = [1.5 * ord(name) - 147, 1, 0]
                world.execute(hostile, {"type": "spawn_cube", "cube_name": name, "position": place})
        command = stranger.command()
        before = None if world.fault is not None else (world.digest(), world.structure_version)
        reply = world.execute(hostile, command)
        protocol.validate_reply(reply)
        assert reply.get("code") != "internal", (seed, number, command)
        if reply["type"] == "error" and command["type"] not in ("batch", "step") and before is not None:
            assert (world.digest(), world.structure_version) == before, (seed, number, command)
        if number % 3 == 0:
            world.tick()
        assert world.execute(neighbour, {"type": "ping"}) == {"type": "pong"}
        if world.fault is not None:
            assert world.fault.code in PHYSICS, (seed, number, command, world.fault)
            world.execute(neighbour, {"type": "reset"})
    world.close()


@diverging
@pytest.mark.parametrize("backend", ["mujoco", "ballistic", "pymunk"])
@pytest.mark.parametrize("seed", range(3))
def test_nothing_that_a_stranger_sends_stops_a_world_but_its_physics(seed: int, backend: str) -> None:
    campaign(seed, 400, backend)


@diverging
@pytest.mark.long
@pytest.mark.parametrize("backend", ["mujoco", "ballistic", "pymunk"])
@pytest.mark.parametrize("seed", range(100, 140))
def test_nothing_of_very_much_that_a_stranger_sends_stops_a_world_but_its_physics(seed: int, backend: str) -> None:
    campaign(seed, 2_000, backend)


# -- mistakes of ours -------------------------------------------------------------------------------------------------


def broken(*arguments: object, **fields: object) -> None:
    raise ZeroDivisionError("a mistake of ours")


@pytest.fixture
def two() -> tuple[World, Callable[..., Json], Callable[..., Json], list[tuple[int, Json]]]:
    events: list[tuple[int, Json]] = []
    world = World({"mode": "lockstep"}, emit=lambda client, event: events.append((client, protocol.decode(event))))
    first, second = world.join(), world.join()
    assert (first, second) == (1, 2)

    def speaker(client: int) -> Callable[..., Json]:
        return lambda kind, **fields: world.execute(client, {"type": kind, **fields})

    speaker(2)("spawn_cube", cube_name="a", position=[0, 5, 0])
    return world, speaker(1), speaker(2), events


def test_the_objective_that_stopped_worlds_is_the_business_of_who_set_it(two: Any) -> None:
    world, first, second, _ = two
    assert first("set_objective", expression=EXPRESSIONS[0], cubes=["a"])["type"] == "objective_set"
    second("set_cube_state", cube_name="a", position=[-3, 5, 0])
    assert second("step", ticks=3)["frame"] == 3
    assert first("compute_reward")["value"] == 2.0
    assert first("set_objective", expression="sqrt(position.x)", cubes=["a"])["type"] == "objective_set"
    assert first("compute_reward")["code"] == "bad_expression"
    assert world.fault is None


@pytest.mark.parametrize(
    ("place", "kind", "fields"),
    [
        ("nmes.world.readings.cube_states", "get_world_state", {}),
        ("nmes.world.readings.cube_info", "get_cube_info", {"cube_name": "a"}),
        ("nmes.world.commands.clients.metric", "compute_reward", {"metric": "height", "cube": "a"}),
        ("nmes.world.client_objectives.Objective", "set_objective", {"expression": "1", "cubes": ["a"]}),
        ("nmes.world.commands.clients.Subscription", "subscribe", {}),
    ],
)
def test_a_mistake_of_ours_in_what_changes_nothing_stops_no_world(
    place: str, kind: str, fields: Json, two: Any, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    world, first, second, events = two
    second("subscribe", events=["tick"])
    monkeypatch.setattr(place, broken)
    assert first(kind, **fields)["code"] == "internal"
    assert "a mistake of ours" in caplog.text and world.fault is None
    assert second("step")["frame"] == 1 and [client for client, _ in events] == [2]


def test_a_mistake_of_ours_in_what_may_have_been_half_done_stops_the_world(
    two: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    world, first, _, _ = two
    monkeypatch.setattr("nmes.world.entities.Entities.spawn", broken)
    assert first("spawn_cube")["code"] == "internal"
    assert world.fault.code == "internal"


def test_an_objective_that_fails_at_a_tick_is_set_aside_and_the_others_go_on(
    two: Any, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    world, first, second, _ = two
    second("spawn_cube", cube_name="b", position=[0, 9, 0])
    first("set_objective", expression="max.height", cubes=["a", "b"], name="bad")
    second("set_objective", expression="max.speed", cubes=["a"], name="good")
    add = RunningQuantities.add
    monkeypatch.setattr(
        RunningQuantities, "add", lambda self, *row: broken() if len(self.bodies.cubes) == 2 else add(self, *row)
    )
    with caplog.at_level(logging.ERROR):
        assert second("step", ticks=2)["frame"] == 2
    assert caplog.text.count("objective 'bad' failed") == 1
    assert first("compute_reward", objective="bad")["code"] == "internal"
    assert second("compute_reward", objective="good")["value"] > 0
    restored = World({"mode": "lockstep"})
    restored.restore(world.snapshot())
    assert restored.execute(1, {"type": "compute_reward", "objective": "bad"})["code"] == "internal"
    assert first("set_objective", expression="height", cubes=["a"], name="bad")["type"] == "objective_set"
    assert first("compute_reward", objective="bad")["type"] == "reward"


def test_a_subscription_that_fails_ends_and_the_others_go_on(
    two: Any, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    world, first, second, events = two
    first("subscribe", every=1)
    second("subscribe", every=2)
    changes = Subscription.changes
    monkeypatch.setattr(
        Subscription, "changes", lambda self, *now: broken() if self.every == 1 else changes(self, *now)
    )
    assert second("step", ticks=4)["frame"] == 4
    assert world.fault is None and caplog.text.count("subscription of client 1 failed") == 1
    assert [event["frame"] for client, event in events if client == 2 and event["type"] == "state"] == [2, 4]
    assert not [event for client, event in events if client == 1 and event["type"] == "state"]
