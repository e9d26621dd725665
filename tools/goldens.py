"""The corpus of recordings in `replays/`: what each shows, and how it is made. Run as a program, it makes them anew.

Beside each recording lies a description in JSON: what it shows, and what a replay must reproduce. They are made anew
only when a world is meant to behave otherwise than before; until then they hold it to what it did.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from layout import ROOT
from nmes.protocol import parse
from nmes.recording import Kind, Recorder, Recording
from nmes.world import World

REPLAYS = ROOT / "replays"

Play = Callable[[World, int], None]


@dataclass(frozen=True)
class Golden:
    """One recording of the corpus.

    Attributes:
        name: Of its file.
        shows: What it is there for.
        play: The script of its first client, which may let others join.
        config: The world's.
        tolerance: How far (m) a cube may be from where it was recorded, at any time, on another machine.
    """

    name: str
    shows: str
    play: Play
    config: Mapping[str, Any] = field(default_factory=dict)
    tolerance: float = 0.02

    @property
    def recording(self) -> Path:
        """The recording's file."""
        return REPLAYS / f"{self.name}.mcap"

    @property
    def description(self) -> Path:
        """The JSON file that says what it shows and must reproduce."""
        return REPLAYS / f"{self.name}.json"

    def world(self) -> World:
        """Returns a new world for it."""
        return World({"mode": "lockstep", "name": self.name, **self.config})


def do(world: World, client: int, kind: str, **fields: Any) -> dict[str, Any]:
    """Sends a command that must succeed."""
    reply = world.execute(client, {"type": kind, **fields})
    assert reply["type"] != "error", reply
    return reply


def spawn(world: World, client: int, name: str, position: list[float], **fields: Any) -> str:
    """Spawns a cube and returns the name that it has got."""
    spawned = do(world, client, "spawn_cube", cube_name=name, position=position, **fields)["spawned"]
    assert isinstance(spawned, str)
    return spawned


def fail(world: World, client: int, code: str, **command: Any) -> None:
    """Sends a command that must be answered by an error."""
    reply = world.execute(client, command)
    assert reply.get("code") == code, reply


# -- what is played --------------------------------------------------------------------------------------------------


def target(world: World, client: int) -> None:
    """A cube is pushed towards a point, in proportion to its distance."""
    walker = spawn(world, client, "walker", [0, 0.5, 0])
    for _ in range(90):
        state = do(world, client, "get_cube_state", cube_name=walker)
        push = 8 * (3 - state["position"][0]) - 4 * state["linear_velocity"][0]
        do(world, client, "apply_physics", cube_name=walker, force=[push, 0, 0])
        do(world, client, "step")


def pole(world: World, client: int) -> None:
    """A pole of motored hinges swings on a frozen base."""
    edges = [0.4, 0.4, 0.4]
    joints, below = [], spawn(world, client, "base", [0, 0.2, 0], size=edges, is_base=True)
    for i in range(1, 4):
        cube = spawn(world, client, f"pole_{i}", [0, 0.2 + i / 2, 0], size=edges, mass=0.5)
        place = {"position": [0, i / 2 - 0.05, 0], "axis": [0, 0, 1]}
        joint = do(
            world, client, "create_joint", cube1=below, cube2=cube, joint_type="hinge", motor_max_force=200, **place
        )
        joints.append(joint["joint_name"])
        below = cube
    for tick in range(90):
        speed = 0.6 if tick % 60 < 30 else -0.6
        for joint in joints:
            do(world, client, "set_joint_param", joint_name=joint, param_name="motor_target_velocity", value=speed)
        do(world, client, "step")
    do(world, client, "get_joint_info", joint_name=joints[0])


def swarm(world: World, client: int) -> None:
    """Nine cubes hold a formation, each pushed by its own client's springs to its neighbours."""
    clients = [client, *(world.join() for _ in range(8))]
    cubes = [
        spawn(world, owner, f"c{i}", [1.6 * i, 0.5, 0], linear_velocity=[0.2 * i, 0, 0])
        for i, owner in enumerate(clients)
    ]
    for _ in range(20):
        x = [state["position"][0] for state in do(world, client, "get_world_state")["cubes"]]
        for i, owner in enumerate(clients):
            force = sum(6 * (x[j] - x[i] - 1.6 * (j - i)) for j in (i - 1, i + 1) if 0 <= j < len(x))
            do(world, owner, "apply_physics", cube_name=cubes[i], force=[force, 0, 0])
        do(world, client, "step", ticks=3)
    for other in clients[1:5]:
        world.leave(other)
    do(world, client, "step", ticks=30)


def edits(world: World, client: int) -> None:
    """A structure is changed while it lives: cubes and joints come and go, are frozen, moved and freed."""
    cubes = [spawn(world, client, f"c{i}", [0, 0.5 + 1.2 * i, 0]) for i in range(4)]
    pairs = [("fixed", 0, 1), ("hinge", 1, 2), ("slide", 2, 3)]
    joints = []
    for kind, one, other in pairs:
        axis = {} if kind == "fixed" else {"axis": [0, 0, 1] if kind == "hinge" else [1, 0, 0]}
        names = {"cube1": cubes[one], "cube2": cubes[other]}
        joints.append(do(world, client, "create_joint", joint_type=kind, **names, **axis)["joint_name"])
    do(world, client, "step", ticks=20)
    do(world, client, "freeze_cube", cube_name=cubes[1], freeze=True)
    do(world, client, "apply_physics", cube_name=cubes[3], impulse=[2, 0, 0])
    do(world, client, "step", ticks=20)
    do(world, client, "remove_joint", joint_name=joints[2])
    do(world, client, "set_cube_state", cube_name=cubes[3], position=[4, 3, 0], linear_velocity=[-1, 2, 0])
    spawn(world, client, "late", [4, 0.5, 0], size=[2, 1, 1], mass=5)
    do(world, client, "step", ticks=20)
    do(world, client, "freeze_cube", cube_name=cubes[1], freeze=False)
    do(world, client, "despawn_cube", cube_name=cubes[2])
    do(world, client, "step", ticks=40)
    do(world, client, "get_joint_list")
    do(world, client, "get_world_state")


def fault(world: World, client: int) -> None:
    """The engine gives up, commands are refused, and a reset with another seed goes on."""
    far = spawn(world, client, "far", [0, 2, 0])
    do(world, client, "step", ticks=12)
    for _ in range(50):
        world.execute(client, {"type": "apply_physics", "cube_name": far, "impulse": [1e15, 1e15, 0]})
        world.execute(client, {"type": "step"})
        if world.fault is not None:
            break
    assert world.fault is not None
    fail(world, client, "world_faulted", type="spawn_cube")
    do(world, client, "get_world_info")
    do(world, client, "reset", seed=7)
    spawn(world, client, "again", [0, 2, 0])
    do(world, client, "step", ticks=40)


def refused(world: World, client: int) -> None:
    """Frames that are no commands, and commands that the world does not accept, change nothing."""
    for frame in (
        b"\xff\xfe",
        b"{",
        b"[]",
        b'{"type":"fly"}',
        b'{"type":"step","ticks":0}',
        b'{"type":"ping","a":1e400}',
    ):
        world.handle(client, parse(frame))
    cube = spawn(world, client, "a", [0, 3, 0])
    fail(world, client, "cube_not_found", type="get_cube_info", cube_name="b")
    fail(world, client, "joint_not_found", type="remove_joint", joint_name="none")
    for i in range(10):
        do(world, client, "step", ticks=2)
        world.handle(client, parse(b'{"type":"apply_force","force":["x"],"id":%d}' % i))
    do(world, client, "get_cube_info", cube_name=cube)


def clients(world: World, client: int) -> None:
    """Clients come and go, cubes stay; the clock ticks between commands; the world is paused, set to pace, resumed."""
    spawn(world, client, "mine", [0, 4, 0])
    do(world, client, "subscribe", events=["tick", "state"], every=3)
    other = world.join()
    yours = spawn(world, other, "yours", [0.4, 6, 0])
    do(world, client, "set_mode", mode="realtime", rate=2)
    for i in range(60):
        if i % 7 == 0:
            do(world, other, "apply_physics", cube_name=yours, force=[3, 0, 0])
        world.tick()
    do(world, client, "pause")
    do(world, client, "step", ticks=3)
    do(world, client, "resume")
    world.leave(other)
    for _ in range(20):
        world.tick()
    late = world.join()
    commands = [{"type": "apply_physics", "cube_name": yours, "impulse": [0, 4, 0]}, {"type": "get_cube_list"}]
    do(world, late, "batch", commands=commands)
    do(world, client, "set_mode", mode="lockstep")
    do(world, late, "step", ticks=20)


def sleep(world: World, client: int) -> None:
    """A tower comes to rest and sleeps; what falls on it wakes it."""
    below, *_ = [spawn(world, client, f"t{i}", [0, 0.5 + i, 0]) for i in range(4)]
    do(world, client, "step", ticks=300)
    assert do(world, client, "get_cube_info", cube_name=below)["sleeping"]
    spawn(world, client, "ball", [0.2, 6, 0], size=[0.5, 0.5, 0.5])
    do(world, client, "step", ticks=90)
    do(world, client, "get_world_state")


def planets(world: World, client: int) -> None:
    """Cubes fall towards the planets that are nearest to them."""
    do(world, client, "get_planets")
    places: list[list[float]] = [[0, 3, 0], [8, 0, 1], [-30, 10, 2]]
    for i, place in enumerate(places):
        spawn(world, client, f"c{i}", place, linear_velocity=[0, 0, 0.5])
    do(world, client, "step", ticks=120)
    do(world, client, "get_world_state")


def landscape(world: World, client: int) -> None:
    """Cubes fall onto hills and a ramp."""
    for i in range(5):
        spawn(world, client, f"c{i}", [3 * i - 6, 7, 0])
    do(world, client, "step", ticks=100)
    do(world, client, "get_world_state")


def keyframes(world: World, client: int) -> None:
    """The world saves itself while a motored arm is hit and cut, and after a reset; any part of it replays."""
    do(world, client, "subscribe", events=["state"], every=5)
    base = spawn(world, client, "base", [0, 0.5, 0], is_base=True)
    arm = spawn(world, client, "arm", [0, 1.6, 0], size=[0.5, 1, 0.5])
    hinge = {"cube1": base, "cube2": arm, "joint_type": "hinge", "axis": [0, 0, 1], "position": [0, 1.05, 0]}
    joint = do(world, client, "create_joint", **hinge, motor_max_force=50)["joint_name"]
    do(world, client, "set_joint_param", joint_name=joint, param_name="motor_target_velocity", value=1.5)
    for i in range(20):
        if i == 4:
            spawn(world, client, "ball", [-4, 1.6, 0], linear_velocity=[8, 2, 0])
        if i == 12:
            do(world, client, "remove_joint", joint_name=joint)
        do(world, client, "step", ticks=1 + i % 7)
    do(world, client, "reset", seed=3)
    spawn(world, client, "again", [0, 2, 0], rotation=[0.3, 0.2, 0.1])
    other = world.join()
    do(world, other, "step", ticks=70)
    do(world, other, "get_world_state")


_HILLS = {
    "type": "heightfield",
    "heightfield": {"size": [40, 40], "height": 2, "hill": 9, "seed": 4},
    "obstacles": [{"type": "ramp", "position": [-3, 2, 0], "length": 4, "height": 1, "width": 2, "heading": 0}],
}
_PLANETS = {"type": "planets", "planets": {"count": 3, "spacing": 60, "radius": 10}}


def _corpus() -> Iterator[Golden]:
    for engine in ("mujoco", "pymunk"):
        for play in (target, pole, swarm, edits, fault, refused, clients, sleep):
            shows = " ".join((play.__doc__ or "").split())
            yield Golden(f"{engine}-{play.__name__}", shows, play, {"backend": engine, "seed": 11})
    shows = " ".join((planets.__doc__ or "").split())
    yield Golden("mujoco-planets", shows, planets, {"backend": "mujoco", "scene": _PLANETS})
    shows = " ".join((landscape.__doc__ or "").split())
    yield Golden("mujoco-landscape", shows, landscape, {"backend": "mujoco", "scene": _HILLS})
    shows = " ".join((keyframes.__doc__ or "").split())
    yield Golden("mujoco-keyframes", shows, keyframes, {"backend": "mujoco", "seed": 11, "keyframes": 0.25})


CORPUS = list(_corpus())


def make(golden: Golden) -> None:
    """Records a golden, and writes its description."""
    golden.recording.unlink(missing_ok=True)
    world = golden.world()
    recorder = world.journal = Recorder(golden.recording, world)
    golden.play(world, world.join())
    places = {name: [round(x, 6) for x in place] for name, place in positions(world).items()}
    recorder.close()
    world.close()
    description = {"shows": golden.shows, **contents(golden), "positions_at_the_end": places}
    golden.description.write_text(json.dumps(description, indent=2) + "\n")


def positions(world: World) -> dict[str, list[float]]:
    """Returns the position (m) of each cube."""
    names, states = world.poses()
    return dict(zip(names, states[:, :3].tolist(), strict=True))


def contents(golden: Golden) -> dict[str, Any]:
    """Summarizes a recording for its description: config, counts, errors, faults and the last digest."""
    recording = Recording(golden.recording)
    summary = recording.summary()
    digests = [d for r in recording if r.kind is Kind.TICKS and r.about is not None for d in r.about["digests"]]
    return {
        "config": dict(golden.config),
        "ticks": summary.ticks,
        "clients": summary.clients,
        "commands": dict(sorted(summary.commands.items())),
        "refused": summary.refused,
        "errors": summary.errors,
        "faults": summary.faults,
        "last_digest": digests[-1],
        "tolerance": golden.tolerance,
    }


if __name__ == "__main__":
    REPLAYS.mkdir(exist_ok=True)
    chosen = set(sys.argv[1:]) or {golden.name for golden in CORPUS}
    for each in CORPUS:
        if each.name in chosen:
            make(each)
            print(f"{each.recording.relative_to(ROOT)}  {each.recording.stat().st_size:,} bytes")
