"""What may take long is known before it is done, be it a command or ticks, and is done away from the event loop."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from nmes.backend import Array
from nmes.server.threads import BRIEF, LONG_COMMANDS, SLICE, Worker, WorkerPool
from nmes.world import World
from nmes.world.commands import COMMANDS
from nmes.world.costs import BUILDING
from nmes.world.life import Life
from servers import Served, served

Json = dict[str, Any]

# These take a few milliseconds at most in a world that is as full as a config that sets no limits lets it be. One that
# is not here is in LONG_COMMANDS, and has its estimate in nmes/world/costs.py. Not counted is that the first command
# about a creature after an edit finds out what still hangs together, of all creatures.
BOUNDED = {
    "apply_force",
    "apply_physics",
    "compute_reward",
    "create_bone",
    "create_joint",
    "drive",
    "feed",
    "freeze_cube",
    "get_cube_state",
    "get_genome",
    "get_joint_info",
    "pause",
    "ping",
    "remove_joint",
    "resume",
    "say",
    "set_color",
    "set_joint_param",
    "set_joint_params",
    "set_mode",
    "subscribe",
    "unsubscribe",
}

CUBES: list[Json] = [
    {"id": "a", "size": 0.2, "mass": 1, "position": [0, 0.1, 0]},
    {"id": "b", "size": 0.2, "mass": 1, "position": [0.25, 0.1, 0]},
]
JOINT = {"id": "j", "type": "fixed", "cube1": "a", "cube2": "b", "anchor": [0.125, 0.1, 0]}


def pair(*sensors: Json) -> Json:
    body = {"cubes": CUBES, "joints": [JOINT]}
    return {"format": "nmes-genome/1", "name": "pair", "body": body, "sensors": list(sensors)}


class Nobody:
    """The owner of a world that is asked how long things take, and goes nowhere."""

    def prepare_thread(self) -> bool:
        return False

    def end_slice(self) -> None:
        raise AssertionError

    def take_back(self, finish: Callable[[], None]) -> None:
        raise AssertionError


def worker(world: World) -> Worker:
    return Worker(world, WorkerPool(), Nobody())


def crowded(count: int, *sensors: Json, **config: Any) -> tuple[World, int]:
    """Returns a world of a creature `x` and many cubes, in which an engine has taken up all of them."""
    world = World({"mode": "lockstep", "backend": "ballistic", **config})
    client = world.join()
    spawned = world.execute(client, {"type": "spawn_creature", "genome": pair(*sensors), "name": "x"})
    assert spawned["type"] == "creature_spawned", spawned
    for number in range(count):
        place = {"position": [3 + number % 50, 1, number // 50], "size": 0.2}
        world.execute(client, {"type": "spawn_cube", "cube_name": f"c{number}", "list": False, **place})
    world.tick()
    return world, client


def chain(world: World, count: int) -> None:
    """Joins the first so many cubes in a row."""
    for number in range(count - 1):
        world.entities.connect({"cube1": f"c{number}", "cube2": f"c{number + 1}"}, "fixed", "joint")


# -- commands ---------------------------------------------------------------------------------------------------------


def test_every_command_may_take_long_or_is_known_to_be_bounded() -> None:
    assert LONG_COMMANDS.isdisjoint(BOUNDED)
    assert COMMANDS.keys() == LONG_COMMANDS | BOUNDED


@pytest.mark.parametrize("kind", sorted(BOUNDED))
def test_what_is_bounded_has_no_estimate(kind: str) -> None:
    world, _ = crowded(200)
    world.entities.food = world.entities.states()[:, :3]
    assert world.cost({"type": kind, "creature": "x", "cube_name": "c1"}) == 0.0


@pytest.mark.parametrize("kind", ["adopt", "grow", "hear", "sense", "shed"])
def test_what_looks_at_all_cubes_is_expected_to_take_longer_the_more_there_are(kind: str) -> None:
    ear: Json = {"type": "hear", "cube": "a", "channel": "talk"}
    few, many = (crowded(count, ear, channels={"talk": {}})[0] for count in (10, 800))
    chain(few, 8)
    chain(many, 800 if kind in ("adopt", "shed") else 8)
    command = {"type": kind, "creature": "x", "part": "b", "cube_name": "c5", "channel": "talk"}
    assert few.cost(command) < BRIEF < many.cost(command)
    assert not worker(few).takes_long(command) and worker(many).takes_long(command)


def floor(backend: str) -> tuple[World, int]:
    """Returns a world with a frozen `floor`, and 144 cubes on it that move about."""
    world = World({"mode": "lockstep", "backend": backend, "limits": {"cubes": 200}})
    client = world.join()
    world.execute(client, {"type": "spawn_cube", "cube_name": "floor", "position": [0, 0.5, 0], "size": [60, 1, 10]})
    world.execute(client, {"type": "freeze_cube", "cube_name": "floor", "freeze": True})
    for number in range(144):
        x, z = (number * 0.4 - 29, 0) if world.backend.dims == 2 else (number % 12 - 6, number // 12 * 0.7 - 4)
        cube = {"type": "spawn_cube", "cube_name": f"c{number}", "position": [x, 1.1, z], "size": 0.2}
        world.execute(client, cube)
    world.execute(client, {"type": "step", "ticks": 12})
    return world, client


@pytest.mark.parametrize("backend", ["mujoco", "pymunk"])
def test_a_floor_with_much_on_it_is_expected_to_take_long_to_tell_of(backend: str) -> None:
    world, client = floor(backend)
    of_floor, of_cube = ({"type": "get_cube_info", "cube_name": name} for name in ("floor", "c5"))
    world.execute(client, of_cube)  # from when on contacts are sorted
    told = world.execute(client, of_floor)
    assert len(told["contacts"]) > 100
    assert worker(world).takes_long(of_floor)
    if backend == "mujoco":
        assert world.cost(of_floor) > SLICE > BRIEF > world.cost(of_cube)


def test_what_sleeps_is_expected_to_take_long_to_tell_of_until_it_is_known() -> None:
    world, client = floor("mujoco")
    world.execute(client, {"type": "step", "ticks": 120})
    command = {"type": "get_cube_info", "cube_name": "c5"}
    assert world.simulation.sleeping(world.entities.cube("c5").body)
    assert world.cost(command) > SLICE
    world.execute(client, command)
    assert world.cost(command) < BRIEF
    world.execute(client, {"type": "step"})
    assert world.cost(command) < BRIEF


def test_a_full_larder_is_expected_to_take_long_to_tell_of() -> None:
    world, _ = crowded(0)
    world.entities.food = many_places(10_000)
    assert min(world.cost({"type": kind}) for kind in ("get_life", "get_planets")) > SLICE


def many_places(count: int) -> Array:
    world, _ = crowded(1)
    places: Array = world.entities.states()[:1, :3].repeat(count, axis=0)
    return places


@pytest.mark.parametrize("kind", ["other_distance", "other_smell", "food_distance", "food_smell"])
def test_senses_of_food_and_of_others_are_expected_to_take_their_time(kind: str) -> None:
    command = {"type": "sense", "creature": "x"}
    blind, seeing = crowded(300)[0], crowded(300, *({"type": kind, "cube": cube} for cube in "ab"))[0]
    before = seeing.cost(command)
    assert blind.cost(command) == 0.0 < before
    seeing.entities.food = many_places(2000)
    assert seeing.cost(command) > before


def test_a_batch_in_which_creatures_are_looked_at_anew_each_time_is_expected_to_take_long() -> None:
    world, _ = crowded(200)
    chain(world, 200)
    paint: Json = {"type": "set_color", "cube_name": "c1", "color": [1, 0, 0]}
    look: Json = {"type": "sense", "creature": "x"}
    in_turn = world.cost({"type": "batch", "commands": [paint, look] * 50})
    assert in_turn > 10 * world.cost({"type": "batch", "commands": [paint] * 50 + [look] * 50}) > 0.0


def test_a_cube_that_carries_many_joints_is_expected_to_take_long_to_remove() -> None:
    world, _ = crowded(600)
    for number in range(1, 600):
        world.entities.connect({"cube1": "c0", "cube2": f"c{number}"}, "fixed", "joint")
    assert world.cost({"type": "despawn_cube", "cube_name": "c0"}) > BRIEF
    assert world.cost({"type": "despawn_cube", "cube_name": "c1"}) < BRIEF


def test_a_batch_that_ticks_after_it_has_edited_is_expected_to_take_long() -> None:
    world, client = crowded(0)
    asked, part = worker(world), {"creature": "x", "part": "b"}
    edits: list[Json] = [
        {"type": "shed", **part},
        {"type": "adopt", **part, "cube_name": "x.b"},
        {"type": "shed", **part, "remove": True},
        {"type": "grow", **part},
    ]
    for edit in edits:
        assert asked._expected({"type": "batch", "commands": [edit, {"type": "step"}]}) > SLICE, edit
        assert world.execute(client, edit)["type"] != "error"
        world.tick()


def test_commands_after_which_an_engine_builds_anew_are_known() -> None:
    world, client = crowded(3)
    edits: list[Json] = [
        {"type": "shed", "creature": "x", "part": "b"},
        {"type": "adopt", "creature": "x", "part": "b", "cube_name": "x.b"},
        {"type": "shed", "creature": "x", "part": "b", "remove": True},
        {"type": "grow", "creature": "x", "part": "b"},
        {"type": "freeze_cube", "cube_name": "c0", "freeze": True},
        {"type": "set_cube_state", "cube_name": "c0", "position": [0, 9, 0]},
        {"type": "create_joint", "joint_type": "fixed", "cube1": "c1", "cube2": "c2", "joint_name": "k"},
        {"type": "remove_joint", "joint_name": "k"},
        {"type": "despawn_cube", "cube_name": "c1"},
    ]
    for edit in edits:
        world.tick()
        assert world.rebuild_cost == 0.0
        reply = world.execute(client, edit)
        assert reply["type"] != "error" and world.rebuild_cost > 0.0, reply
        assert edit["type"] in BUILDING


def test_a_batch_that_switches_a_motor_on_and_ticks_is_expected_to_take_long() -> None:
    world = World({"mode": "lockstep", "backend": "mujoco"})
    client = world.join()
    for number in range(2):
        world.execute(client, {"type": "spawn_cube", "cube_name": f"c{number}", "position": [2 * number, 2, 0]})
    world.execute(
        client, {"type": "create_joint", "joint_type": "hinge", "cube1": "c0", "cube2": "c1", "joint_name": "j"}
    )
    world.tick()
    asked, joint = worker(world), {"joint_name": "j"}
    one: Json = {"type": "set_joint_param", **joint, "param_name": "motor_target_velocity", "value": 1.0}
    several: Json = {"type": "set_joint_params", **joint, "params": {"motor_target_velocity": 1.0}}
    off: Json = {"type": "set_joint_params", **joint, "params": {"motor_enabled": False}}

    def long(*commands: Json) -> bool:
        return asked._expected({"type": "batch", "commands": [*commands, {"type": "step"}]}) > SLICE

    assert long(one) and long(several)
    world.execute(client, one)
    world.tick()
    assert not long(one) and not long(several) and long(off)
    assert not long({**one, "joint_name": "gone"})


# -- ecosystems -------------------------------------------------------------------------------------------------------

FEW: Json = {"food": {"start": 0, "rate": 0}, "population": {"start": 1, "most": 2}}


@contextmanager
def watched(config: Json, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Served, list[tuple[int, bool]]]]:
    """Serves an ecosystem, and notes the frame of each tick and whether it was in the event loop."""
    tick, ticks, loop = Life.tick, list[tuple[int, bool]](), list[threading.Thread]()

    def noted(life: Life, frame: int) -> list[Json]:
        ticks.append((frame, threading.current_thread() is loop[0]))
        return tick(life, frame)

    monkeypatch.setattr(Life, "tick", noted)
    with served(config) as server:
        loop.append(server.call(threading.current_thread))
        yield server, ticks


def test_the_ticks_in_which_many_come_are_done_away_from_the_event_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    config = {"backend": "mujoco", "mode": "lockstep", "tick_rate": 10, "life": FEW}
    with watched(config, monkeypatch) as (server, ticks), server.peer() as peer:
        for _ in range(20):
            assert peer.ask({"type": "step"})["type"] == "stepped"
        peer.ask({"type": "reset"})
        assert peer.ask({"type": "step"})["type"] == "stepped"
    assert [frame for frame, _ in ticks] == [*range(1, 21), 1]
    assert [frame for frame, in_loop in ticks if in_loop and frame in (1, 10, 20)] == []


def life_world(**rules: Any) -> World:
    return World({"mode": "lockstep", "tick_rate": 10, "life": {**FEW, **rules}})


def test_what_is_to_come_in_an_ecosystem_is_expected_to_take_long() -> None:
    asked = worker(life_world())
    assert asked.takes_long({"type": "step"}), "the first come"
    asked = worker(world := life_world(population={"start": 0}))
    world.tick()
    asked._measure(1, 0.0)  # its ticks take no time by themselves
    assert not asked.takes_long({"type": "step", "ticks": 8})
    assert asked.takes_long({"type": "step", "ticks": 9}), "a second is over"
    for _ in range(8):
        world.tick()
    assert asked.takes_long({"type": "step"})
    world.tick()
    assert not asked.takes_long({"type": "step"})


def test_much_food_is_expected_to_take_long_to_grow() -> None:
    food = {"start": 500, "rate": 0, "most": 1000}
    life, other = (life_world(population={"start": 0}, food=each).life for each in (food, {**food, "rate": 500}))
    assert life is not None and other is not None
    assert life.cost(0, 1) > life.cost(20, 1) == 0.0
    assert other.cost(20, 1) > BRIEF
    assert life.cost(5, 0) == life.cost(0, 0) == 0.0 < life.cost(5, float("inf"))


def test_a_world_that_is_behind_its_clock_does_no_births_in_the_event_loop() -> None:
    world = life_world(population={"start": 0})
    world.tick()
    asked, done = worker(world), list[int]()
    asked._pool.last = asked
    asked._cost = 2e-5  # so few that some are done at once, however many are due
    for _ in range(4):
        asked._cost = 2e-5
        asked.advance(5000.0, done.append)
    assert 1 + sum(done) == world.frame < 10


def test_rules_of_development_are_expected_to_take_long_when_they_are_looked_at() -> None:
    resize = [{"part": "b", "scale": 0.9}, {"part": "b", "scale": 0.8}]
    rules = [{"when": "age > 0.15", "resize": resize * 8, "times": 1} for _ in range(64)]
    world = World({"mode": "lockstep", "backend": "ballistic", "tick_rate": 60})
    client = world.join()
    genome = {**pair(), "development": rules}
    spawned = world.execute(client, {"type": "spawn_creature", "genome": genome, "name": "x"})
    assert spawned["type"] == "creature_spawned", spawned
    asked = worker(world)
    world.tick()
    asked._measure(1, 0.0)  # its ticks take no time by themselves
    assert not asked.takes_long({"type": "step", "ticks": 6}), "it is not driven yet"
    world.execute(client, {"type": "drive", "creature": "x", "controls": []})
    assert not asked.takes_long({"type": "step", "ticks": 5})
    assert asked.takes_long({"type": "step", "ticks": 6}), "rules are looked at every tenth of a second"
    for _ in range(13):
        world.tick()
    assert not asked.takes_long({"type": "step", "ticks": 6}), "all of them are used up"


def test_to_tell_many_subscribers_of_a_tick_is_expected_to_take_long() -> None:
    world, _ = crowded(20)
    for _ in range(40):
        world.execute(world.join(), {"type": "subscribe", "events": ["state"], "every": 60})
    asked = worker(world)
    while world.frame % 60:
        world.tick()
    asked._measure(1, 0.0)
    assert not asked.takes_long({"type": "step", "ticks": 59})
    assert asked.takes_long({"type": "step", "ticks": 60})
