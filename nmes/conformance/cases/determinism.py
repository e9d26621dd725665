"""Determinism: the same commands in the same order give the same answers. Needs a test world that may be reset."""

from __future__ import annotations

import math
from typing import Any

from nmes.conformance.case import Category, Row, Scope
from nmes.conformance.trial import Trial

DETERMINISM = Category(14, "determinism")
case, table = DETERMINISM.case, DETERMINISM.table

NEEDS = ("lockstep", "reset", "step")


def script(t: Trial, length: int) -> list[dict[str, Any]]:
    """Returns commands drawn from the case's seed: cubes, joints, pushes, ticks, and much looking."""
    draw = t.random
    names = [f"d{n}" for n in range(6)]
    commands: list[dict[str, Any]] = [
        {"type": "spawn_cube", "cube_name": name, "position": [1.5 * n, draw.uniform(0.5, 4), 0]}
        for n, name in enumerate(names)
    ]
    commands.append({"type": "spawn_cube", "position": [-3, 2, 0]})
    if t.probe.claims("joint.fixed"):
        commands.append({"type": "create_joint", "cube1": names[0], "cube2": names[1], "joint_type": "fixed"})
    if t.probe.claims("joint.hinge"):
        commands.append({"type": "create_joint", "cube1": names[2], "cube2": names[3], "joint_type": "hinge"})
    for _ in range(length):
        name = draw.choice(names)
        push = [draw.uniform(-20, 20) for _ in range(3)]
        commands += draw.choice(
            [
                [{"type": "apply_physics", "cube_name": name, "force": push}],
                [{"type": "apply_physics", "cube_name": name, "impulse": [value / 10 for value in push]}],
                [{"type": "step", "ticks": draw.randint(1, 10)}, {"type": "get_cube_info", "cube_name": name}],
                [{"type": "spawn_cube", "position": [draw.uniform(-8, -4), draw.uniform(1, 5), 0]}],
                [{"type": "despawn_cube", "cube_name": "nobody"}, {"type": "get_cube_list"}],
            ]
        )
    return [*commands, {"type": "step", "ticks": 60}, *({"type": "get_cube_info", "cube_name": name} for name in names)]


def played(t: Trial, commands: list[dict[str, Any]], seed: int, in_one_write: bool = False) -> list[Any]:
    """Returns the answers to commands in a world that was just reset, but for the player whose cubes are: a new one."""
    wire = t.join()
    t.ask(wire, {"type": "reset", "seed": seed}, "world_reset")
    numbered = [{**command, "id": n} for n, command in enumerate(commands)]
    if in_one_write:
        wire.say(*numbered)
        answers = [wire.reply(f"reply {n}") for n in range(len(commands))]
    else:
        answers = [wire.ask(command) for command in numbered]
    return [{name: value for name, value in answer.items() if name != "player"} for answer in answers]


@table(1, "3.6.1", [Row(str(n), n) for n in range(3)], needs=NEEDS, scope=Scope.WORLD)
def the_same_again(t: Trial, number: int) -> None:
    """The same commands in a world that was reset with the same seed get the same answers, bit for bit."""
    commands = script(t, 40 + 20 * number)
    first, second = (played(t, commands, seed=11 + number) for _ in range(2))
    for n, (one, two) in enumerate(zip(first, second, strict=True)):
        t.equal(two, one, f"the answer to command {n}, {commands[n]['type']}, the second time")


@case(2, "1.2.1", needs=NEEDS, scope=Scope.WORLD)
def one_by_one_or_together(t: Trial) -> None:
    """Commands in one write get the answers that they get one by one."""
    commands = script(t, 60)
    first, second = played(t, commands, 5), played(t, commands, 5, in_one_write=True)
    for n, (one, two) in enumerate(zip(first, second, strict=True)):
        t.equal(two, one, f"the answer to command {n}, {commands[n]['type']}, in one write")


@case(3, "3.6.1", needs=NEEDS, scope=Scope.WORLD)
def another_seed_other_names(t: Trial) -> None:
    """Made-up names are drawn from the seed: the same with the same seed, others with another."""
    commands: list[dict[str, Any]] = [{"type": "spawn_cube"}] * 5
    one, again, other = ([reply["spawned"] for reply in played(t, commands, seed)] for seed in (1, 1, 2))
    t.equal(again, one, "the names with the same seed")
    t.true(not set(one) & set(other), "other names with another seed", other)


@case(4, "4.reset", needs=(*NEEDS, "get_world_info"), scope=Scope.WORLD)
def resetting(t: Trial) -> None:
    """A reset world has no cubes, no joints, frame 0, and its mode."""
    wire = t.join()
    one, two = t.spawn(wire), t.spawn(wire, position=t.at(1.5))
    t.join_cubes(wire, one, two) if t.probe.claims("joint.fixed") else None
    t.ask(wire, {"type": "step", "ticks": 3}, "stepped")
    reply = t.ask(wire, {"type": "reset", "seed": 77}, "world_reset")
    t.equal([reply["frame"], reply["seed"]], [0, 77], "frame and seed of the reply")
    info = t.ask(wire, {"type": "get_world_info"}, "world_info")
    t.equal([info["frame"], info["t"], info["seed"], info["mode"]], [0, 0, 77, "lockstep"], "frame, t, seed, mode")
    t.equal([info["counts"]["cubes"], info["counts"]["joints"]], [0, 0], "counts of cubes and joints")
    t.equal(t.cubes(wire), [], "cubes")
    t.equal(t.ask(wire, {"type": "reset"}, "world_reset")["seed"], 77, "seed after a reset without one")


@case(5, "4.reset", needs=NEEDS, scope=Scope.WORLD)
def a_reset_is_for_all(t: Trial) -> None:
    """After a reset nobody owns a cube, and names are free again."""
    one, two = t.join(), t.join()
    name = t.spawn(one)
    t.ask(two, {"type": "reset"}, "world_reset")
    t.refused(one, {"type": "apply_physics", "force": [0, 1, 0]}, "nothing_owned")
    t.spawn(two, cube_name=name)
    t.refused(one, {"type": "apply_physics", "force": [0, 1, 0]}, "nothing_owned")


@case(6, "4.reset", needs=(*NEEDS, "subscribe"), scope=Scope.WORLD)
def subscriptions_outlive_a_reset(t: Trial) -> None:
    """Who subscribed still hears of ticks after a reset."""
    wire, driver = t.join(), t.join()
    t.ask(wire, {"type": "subscribe", "events": ["tick"]}, "subscribed")
    t.ask(driver, {"type": "reset"}, "world_reset")
    t.ask(driver, {"type": "step"}, "stepped")
    t.equal(wire.hear(what="a tick"), {"type": "tick", "frame": 1, "t": 1 / t.probe.tick_rate}, "the event")


@case(7, "3.4.4", needs=NEEDS, scope=Scope.WORLD)
def looking_changes_nothing(t: Trial) -> None:
    """To look at a cube again and again does not change what becomes of it."""
    commands = script(t, 30)
    plain = played(t, commands, 9)
    looked = [part for command in commands for part in (command, {"type": "get_cube_info", "cube_name": "d0"})]
    others = played(t, looked, 9)[::2]
    for n, (one, two) in enumerate(zip(plain, others, strict=True)):
        answers = [{key: value for key, value in reply.items() if key != "id"} for reply in (one, two)]
        t.equal(answers[1], answers[0], f"the answer to command {n}, {commands[n]['type']}, with much looking")


@case(8, "3.4.4", needs=NEEDS, scope=Scope.WORLD)
def numbers_are_numbers(t: Trial) -> None:
    """All numbers that come from a world in motion are finite."""

    def check(value: Any) -> None:
        if isinstance(value, float):
            t.true(math.isfinite(value), "a finite number", value)
        for inner in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
            check(inner)

    check(played(t, script(t, 60), 3))
