"""Generated programs of two players in one world: a victim who minds his own things, and an intruder who does not.

A program is a list of steps, each with who acts and a number from which all that it chooses is drawn. `Play` runs one,
and asserts on the way that nothing the intruder sends changes what is the victim's. It runs the world three times:
first without what the intruder sends, which gives what the victim and the owner say and what they are answered; then
with it; then without those commands of the intruder that were refused as not allowed.
"""

from __future__ import annotations

import copy
import random
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from creatures import snake
from nmes import World

__all__ = ["ATTEMPTS", "CONFIG", "INTRUDER", "OWNER", "VICTIM", "Play", "Said", "Step", "program"]

Command = dict[str, Any]

OWNER, VICTIM, INTRUDER = "owner", "victim", "intruder"
CONFIG: Command = {"mode": "lockstep", "seed": 5, "roles": {"player": {}}, "channels": {"alarm": {}}}
NUMBERS = {VICTIM: 2, INTRUDER: 3}  # of the players; the owner is the first
FAR = 1000.0  # m between what the two build, so that nothing touches


class Step(NamedTuple):
    """One step of a program: who acts, and what the rest is drawn from."""

    who: str
    number: int


class Said(NamedTuple):
    """What somebody said, and was answered; without a command, that he came back as another client."""

    who: str
    command: Command | None
    reply: Command


class _Draw:
    """The choices of one step, among what there is in a world, or what of it belongs to a player."""

    def __init__(self, world: World, number: int, player: int | None = None) -> None:
        self.source = random.Random(number)
        self.world = world
        self.mark = f"{number:x}"
        cubes = world.entities.cubes.values()
        self._cubes = [cube.name for cube in cubes if player in (None, cube.player)]

    def any(self, things: list[Any]) -> Any:
        return self.source.choice(things) if things else "nothing"

    def cube(self) -> Any:
        return self.any(self._cubes)

    def joint(self) -> Any:
        ends = {joint.name: (joint.cube1.name, joint.cube2.name) for joint in self.world.entities.joints.values()}
        return self.any([name for name, cubes in ends.items() if set(cubes) <= set(self._cubes)])

    def creature(self) -> Any:
        return self.any(self.world.creatures())

    def vector(self, middle: float = 0.0, size: float = 3.0) -> list[float]:
        return [middle + self.source.uniform(-size, size), self.source.uniform(2, 6), self.source.uniform(-size, size)]


_Made = Callable[[_Draw], Command]
_NOTES = {"params": {}, "notes": {"mine": 1}}
ATTEMPTS: Mapping[str, _Made] = {
    "spawn_cube": lambda d: {"cube_name": f"i{d.mark}", "position": d.vector(FAR), "list": False},
    "spawn_creature": lambda d: {"genome": _genome(d.world), "name": f"ic{d.mark}", "position": d.vector(FAR)},
    "despawn_cube": lambda d: {"cube_name": d.cube()},
    "create_joint": lambda d: {
        "joint_type": "fixed",
        "cube1": d.cube(),
        "cube2": d.cube(),
        "joint_name": f"ij{d.mark}",
    },
    "create_bone": lambda d: {"cube1": d.cube(), "cube2": d.cube(), "joint_name": f"ib{d.mark}"},
    "remove_joint": lambda d: {"joint_name": d.joint()},
    "link_body_cubes": lambda d: {"prefix": d.any(["v", "i", "vc"]), "gap": 1000, "joint_type": "fixed"},
    "link_cube_chains": lambda d: {"chains": [[d.cube(), d.cube()]], "joint_type": "fixed"},
    "apply_physics": lambda d: {"cube_name": d.cube(), "impulse": d.vector()},
    "apply_force": lambda d: {"cube_name": d.cube(), "force": d.vector()},
    "set_color": lambda d: {"cube_name": d.cube(), "color": [d.source.random(), 0.5, 0.5]},
    "set_cube_state": lambda d: {"cube_name": d.cube(), "position": d.vector(FAR), "linear_velocity": d.vector()},
    "freeze_cube": lambda d: {"cube_name": d.cube(), "freeze": d.source.random() < 0.7},
    "set_joint_param": lambda d: {"joint_name": d.joint(), "param_name": "damping", "value": d.source.random()},
    "set_joint_params": lambda d: {"joint_name": d.joint(), **_NOTES},
    "drive": lambda d: {"creature": (name := d.creature()), "controls": _controls(d, name)},
    "grow": lambda d: {"creature": d.creature(), "part": d.source.choice(["c1", "c2", "c3"])},
    "adopt": lambda d: {"creature": d.creature(), "part": d.source.choice(["c1", "c2"]), "cube_name": d.cube()},
    "shed": lambda d: {"creature": d.creature(), "part": d.source.choice(["c1", "c2", "c3"])},
    "say": lambda d: {"channel": "alarm", "value": d.source.uniform(-1, 1), "cube_name": d.cube()},
    "give": lambda d: {"cube_name": d.cube(), "player": d.source.randint(1, 4)},
    "step": lambda d: {"ticks": 2},
    "pause": lambda d: {},
    "resume": lambda d: {},
    "set_mode": lambda d: {"mode": "fast", "rate": 2},
    "reset": lambda d: {},
    "subscribe": lambda d: {},
    "set_objective": lambda d: {"expression": "displacement.x", "cubes": [d.cube()]},
    "get_cube_info": lambda d: {"cube_name": d.cube()},
}
"""What the intruder tries, with whatever is there, by type."""

OWN: Mapping[str, _Made] = {
    "spawn_cube": lambda d: {"cube_name": f"v{d.mark}", "position": d.vector(-FAR), "list": False},
    "spawn_creature": lambda d: {"genome": _genome(d.world), "name": f"vc{d.mark}", "position": d.vector(-FAR)},
    "create_joint": lambda d: {
        "joint_type": "fixed",
        "cube1": d.cube(),
        "cube2": d.cube(),
        "joint_name": f"vj{d.mark}",
    },
    "set_joint_params": lambda d: {"joint_name": d.joint(), "params": {}, "notes": {"v": d.source.random()}},
    "apply_physics": lambda d: {"cube_name": d.cube(), "impulse": d.vector()},
    "set_cube_state": lambda d: {"cube_name": d.cube(), "linear_velocity": d.vector()},
    "freeze_cube": lambda d: {"cube_name": d.cube(), "freeze": d.source.random() < 0.3},
    "say": lambda d: {"channel": "alarm", "value": d.source.uniform(-1, 1), "cube_name": d.cube()},
    "compute_reward": lambda d: {"metric": "displacement", "cube": d.cube()},
    "get_cube_info": lambda d: {"cube_name": d.cube()},
    "give": lambda d: {"cube_name": d.cube(), "player": NUMBERS[INTRUDER]},
}
"""What the victim does with what is his when nobody disturbs him."""


def _controls(draw: _Draw, name: str) -> list[float]:
    creature = draw.world.all_creatures.get(name)
    return [draw.source.uniform(-1, 1) for _ in creature.motors] if creature is not None else [0.0]


def _genome(world: World) -> Command:
    """Returns a creature that the world's engine can make."""
    genome = snake(None, segments=2)
    if "joint.hinge" not in world.backend.capabilities:
        body = genome["body"]
        joints = [{name: joint[name] for name in ("id", "cube1", "cube2", "anchor")} for joint in body["joints"]]
        genome["body"] = {**body, "joints": [{**joint, "type": "fixed"} for joint in joints]}
        genome.pop("sensors", None)
    return genome


def program(seed: int, length: int = 40) -> list[Step]:
    """Returns a program that is drawn from a seed."""
    source = random.Random(seed)
    return [Step(source.choice([OWNER, *[VICTIM] * 2, *[INTRUDER] * 3]), source.getrandbits(32)) for _ in range(length)]


def _attempt(world: World, number: int) -> Command:
    """Returns what the intruder tries at a step: a command, or a batch of some."""
    draw = _Draw(world, number)
    if draw.source.random() < 0.2:
        return {"type": "batch", "commands": [_drawn(draw, ATTEMPTS) for _ in range(draw.source.randint(1, 4))]}
    return _drawn(draw, ATTEMPTS)


def _drawn(draw: _Draw, table: Mapping[str, _Made]) -> Command:
    new = draw.source.random() < 0.3  # so that there is something to try
    kind = draw.any(["spawn_cube", "spawn_creature"] if new else list(table))
    draw.mark += "x"  # so that each of a batch has names of its own
    return {"type": kind, **table[kind](draw)}


class Play:
    """The three runs of a program, checked.

    Attributes:
        said: All that was said in the run with the intruder, in order, with what was answered.
    """

    def __init__(self, steps: list[Step], backend: str, *, alone: bool) -> None:
        """Runs the program; raises AssertionError where the intruder got at what is not his.

        Args:
            steps: The program.
            backend: The engine.
            alone: Whether, with this engine, what is far away has no effect at all, to the last bit.
        """
        self._backend = backend
        self._alone = alone
        self.said: list[Said] = []
        quiet, motions = self._without_intruder(steps)
        self._with_intruder(steps, quiet, motions)
        self._without_the_refused()

    def _world(self) -> tuple[World, dict[str, int]]:
        world = World({**CONFIG, "backend": self._backend})
        return world, {OWNER: world.join(), VICTIM: world.join("player"), INTRUDER: world.join("player")}

    def _without_intruder(self, steps: list[Step]) -> tuple[list[Said], list[dict[str, bytes]]]:
        """Returns what the others say and hear, and after each how the victim's cubes are."""
        world, clients = self._world()
        quiet, motions = [], []
        for who, number in steps:
            if who != INTRUDER:
                command = self._others(world, who, number)
                quiet.append(Said(who, command, world.execute(clients[who], command)))
                motions.append(_rows(world))
        world.close()
        return quiet, motions

    def _others(self, world: World, who: str, number: int) -> Command:
        if who == VICTIM:
            return _drawn(_Draw(world, number, NUMBERS[VICTIM]), OWN)
        if number % 13 == 0:
            return {"type": "reset" if number % 2 else "pause"}
        return {"type": "step", "ticks": 1 + number % 5}

    def _with_intruder(self, steps: list[Step], quiet: list[Said], motions: list[dict[str, bytes]]) -> None:
        world, clients = self._world()
        place = 0
        for who, number in steps:
            if who == INTRUDER:
                self._intrude(world, clients, number)
                continue
            expected, rows = quiet[place], motions[place]
            place += 1
            assert expected.command is not None
            reply = world.execute(clients[who], expected.command)
            self.said.append(Said(who, expected.command, reply))
            if self._alone:
                assert reply == expected.reply, (expected.command, reply, expected.reply)
                mine = _rows(world)
                assert {name: mine.get(name) for name in rows} == rows, "the victim's cubes move otherwise"
        self._digest = world.digest()
        world.close()

    def _intrude(self, world: World, clients: dict[str, int], number: int) -> None:
        if number % 13 == 0:  # he comes back
            world.leave(clients[INTRUDER])
            clients[INTRUDER] = world.join("player", NUMBERS[INTRUDER])
            self.said.append(Said(INTRUDER, None, {}))
            return
        before, whole = _possessions(world), _whole(world)
        command = _attempt(world, number)
        reply = world.execute(clients[INTRUDER], command)
        self.said.append(Said(INTRUDER, command, reply))
        after = _possessions(world)
        assert {name: after.get(name) for name in before} == before, (command, reply)
        assert _whole(world) == whole, (command, reply)
        assert {name for name in after if name not in before} <= _given(reply), (command, reply)

    def _without_the_refused(self) -> None:
        """Runs again what was not refused: it comes to the same last bit."""
        world, clients = self._world()
        for who, command, reply in self.said:
            if command is None:
                world.leave(clients[who])
                clients[who] = world.join("player", NUMBERS[who])
            elif reply.get("code") != "not_allowed":
                assert world.execute(clients[who], command) == reply, (command, reply)
        assert world.digest() == self._digest
        world.close()


def _rows(world: World) -> dict[str, bytes]:
    """Returns the states of the victim's cubes."""
    names, rows = world.poses()
    cubes = world.entities.cubes
    return {
        name: np.ascontiguousarray(row).tobytes()
        for name, row in zip(names, rows, strict=True)
        if cubes[name].player == NUMBERS[VICTIM]
    }


def _possessions(world: World) -> dict[str, Any]:
    """Returns all that there is to say of what is the victim's, by name."""
    entities, rows, things = world.entities, _rows(world), dict[str, Any]()
    told = copy.deepcopy(entities.assembly())
    joints = {joint["name"]: joint for joint in told["joints"]}
    voices = {voice["body"]: voice["value"] for voice in world.channels.snapshot()["channels"]["said"]}
    for cube in told["cubes"]:
        if cube["name"] in rows:
            held = [joints[name] for name in entities.cubes[cube["name"]].joints]
            things[cube["name"]] = rows[cube["name"]], cube, held, voices.get(cube["body"])
    for name in world.creatures():
        if set(world.creature(name).cubes.values()) <= rows.keys():
            things[f"creature {name}"] = world.creature(name).genome.document
    return things


def _whole(world: World) -> tuple[Any, ...]:
    """Returns what belongs to nobody: the world's time, mode and seed."""
    return world.ticks, world.frame, world.mode, world.rate, world.paused, world.barrier, world.seed, world.fault


def _given(reply: Command) -> set[str]:
    """Returns the names of what was given by a command, or by parts of a batch."""
    replies = reply.get("results", [reply])
    cubes = {name for one in replies if one["type"] == "given" for name in one["cubes"]}
    return cubes | {f"creature {name.split('.')[0]}" for name in cubes}
