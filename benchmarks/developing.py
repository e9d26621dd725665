"""What it costs that a creature develops: parts shed, grown and resized by its rules, among a hundred cubes.

A change takes two ticks: that at whose end the rule acts, and that which compiles. Bare means MuJoCo alone on the very
scene that comes of it: building, compiling and allocating the model, and the eight steps of two ticks.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import mujoco

from measure import Figure, Samples, ratio, summary
from nmes import World
from nmes.backend import SceneSpec
from nmes.backends.mujoco3d import MujocoSimulation
from nmes.backends.mujoco3d.compiler import compile_model
from nmes.backends.mujoco3d.forest import spanning_forest

SCENE = SceneSpec(timestep=1 / 240)
CUBES = 100
ROUNDS = 15
CYCLE = ("shed", "grow", "resize", "back")
RULES: list[dict[str, Any]] = [
    # The last stage first, so that no two changes come about at one look at the rules.
    {"when": "mass < 2.1", "stage": 4, "enter": 1},
    {"when": "mass > 2.1", "stage": 4, "resize": [{"part": "c1", "scale": 1.0}]},
    {"when": "true", "stage": 3, "resize": [{"part": "c1", "scale": 1.25}], "enter": 4},
    {"when": "true", "stage": 2, "grow": ["c3"], "enter": 3},
    {"when": "true", "stage": 1, "shed": ["c3"], "enter": 2},
]


def snake() -> dict[str, Any]:
    """Returns the genome of four cubes in a row: the last comes and goes, the second is resized."""
    cubes = [{"id": f"c{i}", "size": 0.2, "mass": 0.5, "position": [0.4 * i, 0.1, 0]} for i in range(4)]
    joints = [
        {"id": f"j{i}", "type": "hinge", "cube1": f"c{i}", "cube2": f"c{i + 1}", "anchor": [0.4 * i + 0.2, 0.1, 0]}
        for i in range(3)
    ]
    rules = [{**rule, "every": 0.1, "times": 64} for rule in RULES]
    body = {"cubes": cubes, "joints": joints}
    return {"format": "nmes-genome/1", "name": "snake", "body": body, "development": rules}


class Scene:
    """A hundred cubes at rest, without gravity, and among them a creature that changes at every look at its rules."""

    def __init__(self) -> None:
        self.world = World({"mode": "lockstep", "gravity": [0, 0, 0]})  # so that there is room for what grows
        self.client = self.world.join()
        for i in range(CUBES):
            position = [1.5 * (i % 10), 0.5, 2.0 + 1.5 * (i // 10)]
            self.execute(type="spawn_cube", position=position, list=False)
        self.execute(type="spawn_creature", genome=snake(), name="s", position=[0, 2, 0])
        self.execute(type="step", ticks=60)
        self.execute(type="drive", creature="s", controls=[])

    def execute(self, **command: Any) -> None:
        """Executes a command that must succeed."""
        reply = self.world.execute(self.client, command)
        assert reply["type"] != "error", reply

    def change(self) -> float:
        """Goes on to the next change; returns the seconds that its two ticks took."""
        layout, took, ticks = self.world.creature("s").layout, 0.0, 0
        while self.world.creature("s").layout == layout:
            assert ticks < 12, "its rules were looked at twice, and it has not changed"
            began = time.perf_counter()
            self.world.tick()
            took, ticks = time.perf_counter() - began, ticks + 1
        began = time.perf_counter()
        self.world.tick()
        return took + time.perf_counter() - began

    def bare(self) -> float:
        """Returns the seconds that the engine alone takes for the scene as it is."""
        simulation = self.world.simulation
        assert isinstance(simulation, MujocoSimulation)
        began = time.perf_counter()
        bodies, joints, scenery = simulation.structure.bodies, simulation.structure.joints, simulation.running.scenery
        forest = spanning_forest(bodies, joints.values())
        compiled = compile_model(SCENE, scenery, bodies, joints, forest, {}, list(forest.trees))
        mujoco.MjData(compiled.model)
        compiling = time.perf_counter() - began
        model, twin = simulation.running.model, mujoco.MjData(simulation.running.model)
        mujoco.mj_copyData(twin, model, simulation.running.data)
        began = time.perf_counter()
        mujoco.mj_step(model, twin, 8)
        return compiling + time.perf_counter() - began

    def clear(self) -> None:
        """Takes away what was shed, and lets that be compiled."""
        parts = {*self.world.creature("s").cubes.values()}
        for name in [each for each in self.world.entities.cubes if each.startswith("s.") and each not in parts]:
            self.execute(type="despawn_cube", cube_name=name)
        self.world.tick()


def figures() -> Iterator[Figure]:
    """Measures."""
    scene = Scene()
    samples: Samples = {name: [] for kind in CYCLE for name in (kind, f"{kind}, bare")}
    for number in range(ROUNDS + 1):
        for kind in CYCLE:
            took, bare = scene.change(), scene.bare()
            if number:  # the first is for warmth
                samples[kind].append(took)
                samples[f"{kind}, bare"].append(bare)
            if kind == "shed":
                scene.clear()
    details = summary(samples, 1e-3)
    for kind in CYCLE[:3]:
        name = f"{kind} by a rule among {CUBES} cubes"
        yield Figure(f"{name}: / bare", ratio(samples, kind, f"{kind}, bare"), "x", at_most=1.5, details=details)
        yield Figure(name, details[kind]["median"], "ms")
