"""What bodies that change while they live cost: many awake, many asleep, joints made and cut, cubes that keep coming.

Bare means MuJoCo alone on the very same model: its four steps for a tick, and building, compiling and allocating the
model for an edit of the structure.
"""

from __future__ import annotations

import gc
import random
import resource
import statistics
import time
from collections.abc import Iterator
from math import ceil, sqrt
from pathlib import Path

import mujoco

from measure import Figure, in_turns, ratio, summary
from nmes import World
from nmes.backend import BodySpec, JointSpec, SceneSpec
from nmes.backends.mujoco3d import MujocoBackend, MujocoSimulation
from nmes.backends.mujoco3d.compiler import compile_model
from nmes.backends.mujoco3d.forest import spanning_forest

SCENE = SceneSpec(timestep=1 / 240)
NOTHING = (0.0, 0.0, 0.0)
TICK = 1000 / 60  # ms
ROUNDS = 15


def spread(count: int) -> MujocoSimulation:
    """Returns a scene of unit cubes that stand on the ground, half a metre apart, after one tick."""
    simulation = MujocoBackend().create(SCENE)
    assert isinstance(simulation, MujocoSimulation)
    side = ceil(sqrt(count))
    for i in range(count):
        place = (1.5 * (i % side), 0.5, 1.5 * (i // side))
        simulation.add_body(i + 1, BodySpec((1.0, 1.0, 1.0), 1.0, 1.0, 0.0, place, (0.0, 0.0, 0.0, 1.0)))
    simulation.step(4)
    return simulation


def awake() -> Iterator[Figure]:
    """A thousand cubes that do not sleep: a tick beside the bare engine's four steps from the same state."""
    simulation = spread(1000)
    model, data = simulation.running.model, simulation.running.data
    model.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    twin = mujoco.MjData(model)

    def tick() -> float:
        began = time.perf_counter()
        for _ in range(5):
            simulation.step(4)
            simulation.digest()
        return (time.perf_counter() - began) / 5

    def bare() -> float:
        mujoco.mj_copyData(twin, model, data)
        began = time.perf_counter()
        for _ in range(5):
            mujoco.mj_step(model, twin, 4)
        return (time.perf_counter() - began) / 5

    samples = in_turns({"tick": tick, "bare": bare}, ROUNDS)
    details = summary(samples, 1e-3)
    yield Figure("1,000 awake cubes: tick / bare", ratio(samples, "tick", "bare"), "x", at_most=1.2, details=details)
    yield Figure("1,000 awake cubes: tick", details["tick"]["median"], "ms", at_most=TICK)


def asleep() -> Iterator[Figure]:
    """Five thousand cubes of which 4,900 sleep, the others being pushed about."""
    began = time.perf_counter()
    simulation = spread(5000)
    yield Figure("5,000 cubes: build, compile, first tick", time.perf_counter() - began, "s")
    for _ in range(60):
        simulation.step(4)
    samples = []
    for _ in range(60):
        for i in range(100):
            simulation.apply(1 + 50 * i, (0.0, 0.0, 8.0), NOTHING, NOTHING, NOTHING)
        began = time.perf_counter()
        simulation.step(4)
        simulation.digest()
        samples.append((time.perf_counter() - began) * 1e3)
    sleeping = sum(simulation.sleeping(i + 1) for i in range(5000))
    details = {"sleeping": sleeping, "worst": max(samples)}
    yield Figure("5,000 cubes, 4,900 asleep: tick", statistics.median(samples), "ms", at_most=TICK, details=details)
    for _ in range(120):
        simulation.step(4)
    steps = []
    for _ in range(60):
        began = time.perf_counter()
        mujoco.mj_step(simulation.running.model, simulation.running.data)
        steps.append((time.perf_counter() - began) * 1e3)
    yield Figure("5,000 cubes asleep: bare step", statistics.median(steps), "ms")


def edits(count: int) -> Iterator[Figure]:
    """A joint made or cut in a world of so many cubes, beside building, compiling and allocating that model."""
    simulation = spread(count)
    joint = 0

    def edit() -> float:
        nonlocal joint
        if joint % 2 == 0:
            simulation.add_joint(joint + 1, JointSpec("hinge", 1, 2, (0.75, 0.5, 0.0), (0.0, 0.0, 1.0)))
        else:
            simulation.remove_joint(joint)
        joint += 1
        began = time.perf_counter()
        simulation.step(0)
        return time.perf_counter() - began

    def bare() -> float:
        began = time.perf_counter()
        bodies, joints, scenery = simulation.structure.bodies, simulation.structure.joints, simulation.running.scenery
        forest = spanning_forest(bodies, joints.values())
        compiled = compile_model(SCENE, scenery, bodies, joints, forest, {}, list(forest.trees))
        mujoco.MjData(compiled.model)
        return time.perf_counter() - began

    samples = in_turns({"edit": edit, "bare": bare}, 2 * ROUNDS)
    details = summary(samples, 1e-3)
    name = f"a joint made or cut among {count} cubes"
    yield Figure(f"{name}: / bare", ratio(samples, "edit", "bare"), "x", at_most=1.5, details=details)
    yield Figure(name, details["edit"]["median"], "ms")


def arrivals() -> Iterator[Figure]:
    """One free cube a tick into a world of 500."""
    world = World({"mode": "lockstep"})
    client = world.join()

    def spawn(i: int, height: float) -> None:
        position = [1.5 * (i % 23), height, 1.5 * (i // 23 % 23)]
        world.execute(client, {"type": "spawn_cube", "position": position, "list": False})

    for i in range(500):
        spawn(i, 0.5)
    world.execute(client, {"type": "step", "ticks": 60})
    samples = []
    for i in range(150):
        began = time.perf_counter()
        spawn(i, 3.0 + i % 5)
        world.tick()
        samples.append((time.perf_counter() - began) * 1e3)
    late = [value for value in samples if value > TICK]
    details = {"median": statistics.median(samples), "late": late}
    # Room for more is made in one go, an eighth of what is there: twice here.
    yield Figure("a cube a tick into 500: median tick", statistics.median(samples), "ms", at_most=TICK, details=details)
    yield Figure("a cube a tick into 500: ticks late of 150", len(late), "", at_most=2)


def heap(count: int = 600) -> Iterator[Figure]:
    """Cubes spawned within a metre, until 19 of 20 sleep; and a tick of the heap beside four bare steps."""
    world, draw = World({"mode": "lockstep"}), random.Random(1)
    client, simulation = world.join(), world.simulation
    assert isinstance(simulation, MujocoSimulation)
    for _ in range(count):
        position = [draw.random(), 0.5 + draw.random(), draw.random()]
        world.execute(client, {"type": "spawn_cube", "position": position, "list": False})
    ticks, awake, spent, own, bare = 0, count, 0.0, 0.0, 0.0
    while awake > count / 20 and ticks < 3600:
        compared = ticks % 60 == 59 and not simulation.running.depenetration.bodies
        if compared:
            twin = mujoco.MjData(simulation.running.model)
            mujoco.mj_copyData(twin, simulation.running.model, simulation.running.data)
            began = time.process_time()
            mujoco.mj_step(simulation.running.model, twin, 4)
            bare += time.process_time() - began
        began = time.process_time()
        world.tick()
        took = time.process_time() - began
        spent, own = spent + took, own + took * compared
        ticks, awake = ticks + 1, simulation.running.data.ntree_awake
    details = {"seconds of the world": ticks / 60, "awake": awake}
    name = f"a heap of {count} cubes"
    yield Figure(f"{name}, until it sleeps: world / CPU time", ticks / 60 / spent, "x", at_least=0.5, details=details)
    yield Figure(f"{name}: tick / bare", own / bare, "x", at_most=1.2)
    began = time.process_time()
    for _ in range(60):
        world.tick()
    yield Figure(f"{name}, asleep: world / CPU time", 1.0 / (time.process_time() - began), "x", at_least=1.0)


def memory(worlds: int = 1000) -> Iterator[Figure]:
    """Resident memory of a world of ten cubes at rest, over many."""

    def resident() -> int:
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()

    def live() -> World:
        world = World({"mode": "lockstep"})
        client = world.join()
        for i in range(10):
            world.execute(client, {"type": "spawn_cube", "position": [1.2 * i, 0.5, 0], "list": False})
        world.execute(client, {"type": "step", "ticks": 60})
        return world

    population = [live()]
    gc.collect()
    before = resident()
    population += [live() for _ in range(worlds)]
    yield Figure("a world of 10 cubes", (resident() - before) / worlds / 1024, "KB", at_most=700)


def figures() -> Iterator[Figure]:
    """All figures of this suite."""
    yield from awake()
    yield from asleep()
    for count in (10, 100, 500):
        yield from edits(count)
    yield from arrivals()
    yield from heap()
    if Path("/proc/self/statm").exists():
        yield from memory()
