"""Water and air: over the wire, by formulas, recorded, in episodes, and never a source of energy."""

from __future__ import annotations

import math
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from creatures import snake
from lockstep import ask, joined
from nmes import World, protocol
from nmes.backend import Medium, Vector
from nmes.backend.medium import Immersion
from nmes.backend.rotation import multiply
from nmes.backend.shapes import Shape
from nmes.errors import NmesError
from nmes.evaluation import Evaluator, Task, evaluate, evaluator, population
from nmes.evaluation.balance import Balance
from nmes.genome import Genome
from nmes.objective.trajectory import ObservedBodies
from nmes.playback import replay
from recordings import record

Reply = dict[str, Any]
SOLIDS: list[tuple[Shape, Vector]] = [
    ("box", (1.0, 0.4, 0.7)),
    ("sphere", (0.8, 0.8, 0.8)),
    ("capsule", (0.4, 1.2, 0.4)),
    ("cylinder", (1.2, 0.4, 0.4)),
    ("cylinder", (0.8, 0.8, 0.2)),
]


@pytest.mark.parametrize("backend", ["mujoco", "pymunk"])
@pytest.mark.parametrize("level", [{}, {"level": 50}])
def test_what_weighs_as_much_as_its_water_hangs_in_it(backend: str, level: Reply) -> None:
    made, client = joined(backend, medium=level)
    for i, density in enumerate((1000, 500)):
        ask(made, client, "spawn_cube", cube_name=f"c{i}", position=[4 * i, 5, 0], mass=density)
    ask(made, client, "step", ticks=60)
    assert ask(made, client, "get_cube_state", cube_name="c0")["position"][1] == pytest.approx(5, abs=1e-6)
    assert ask(made, client, "get_cube_state", cube_name="c1")["position"][1] > 6


@pytest.mark.parametrize(
    ("config", "code", "path"),
    [
        ({"medium": {"level": 0}, "gravity": [1, -9, 0]}, "invalid", "medium/level"),
        ({"medium": {}, "scene": {"type": "planets"}}, "invalid", "medium"),
        ({"medium": {}, "backend": "ballistic"}, "unsupported", "medium"),
    ],
)
def test_a_medium_that_cannot_be_is_refused(config: Reply, code: str, path: str) -> None:
    with pytest.raises(NmesError) as caught:
        World(config)
    assert (caught.value.code, caught.value.path) == (code, path)


def dive(made: World, client: int) -> None:
    """Lets shapes fall into water, joined in a loop and alone, and takes one out of it."""
    for i, (shape, size) in enumerate(SOLIDS):
        command = {"type": "spawn_cube", "cube_name": f"c{i}", "shape": shape, "size": list(size), "mass": 50 + 40 * i}
        made.execute(client, {**command, "position": [0.9 * i, 1.5 + 0.2 * i, 0], "rotation": [0, 0, 0.4 * i]})
    for one, other in (("c0", "c1"), ("c1", "c2"), ("c2", "c0")):
        made.execute(client, {"type": "create_joint", "cube1": one, "cube2": other, "joint_type": "hinge"})
    made.execute(client, {"type": "step", "ticks": 60})
    made.execute(client, {"type": "despawn_cube", "cube_name": "c3"})
    made.execute(client, {"type": "step", "ticks": 60})


@pytest.mark.parametrize("backend", ["mujoco", "pymunk"])
@pytest.mark.parametrize("level", [{}, {"level": 1}])
def test_worlds_of_water_replay_and_restore_bit_for_bit(backend: str, level: Reply, tmp_path: Path) -> None:
    config = {"mode": "lockstep", "backend": backend, "medium": {"viscosity": 5, **level}}
    assert replay(record(tmp_path / "water.mcap", dive, config)).verdict == "reproduced"
    if backend == "pymunk":
        return  # it has no snapshots
    made, client = joined(medium=config["medium"])
    dive(made, client)
    again, _ = joined(medium=config["medium"])
    again.restore(made.snapshot())
    for _ in range(30):
        made.tick()
        again.tick()
        assert again.digest() == made.digest()


def test_a_loop_is_slowed_like_the_same_cubes_held_without_one() -> None:
    """What closes a loop stands for a cube, and is not dragged and lifted once more."""
    speeds = []
    for closed in (False, True):
        made, client = joined(medium={"viscosity": 100}, scene={"obstacles": []})
        places = [(0, 50), (1.1, 50), (1.1, 51.1), (0, 51.1)]
        for i, (x, y) in enumerate(places):
            ask(made, client, "spawn_cube", cube_name=f"c{i}", position=[x, y, 0], mass=1500)
        joints = [(0, 1), (1, 2), (2, 3), *([(3, 0)] if closed else [])]
        for one, other in joints:
            ends = {"cube1": f"c{one}", "cube2": f"c{other}"}
            kind = "hinge" if (one, other) == (3, 0) else "fixed"
            ask(made, client, "create_joint", joint_type=kind, **ends)
        ask(made, client, "step", ticks=180)
        speeds.append(ask(made, client, "get_cube_state", cube_name="c0")["linear_velocity"][1])
    assert speeds[0] < -0.5 and speeds[1] == pytest.approx(speeds[0], rel=0.01)


@pytest.mark.parametrize(("shape", "size"), SOLIDS)
def test_buoyancy_is_the_slope_of_one_potential(shape: Shape, size: Vector) -> None:
    """Else something could be turned about in it and gain energy by it, for ever."""
    immersion = Immersion(Medium(1000.0, 0.0, 0.0), (0.0, -9.81, 0.0), 1e-3, [shape], [size], np.array([1e9]))
    draw, step = np.random.default_rng(4), 1e-5

    def potential(place: Any, turn: Any) -> float:
        state = np.zeros((13, 1, 1))
        state[:3, 0, 0], state[3:7, 0, 0] = place, turn
        return float(immersion.potentials(state)[0, 0])

    for _ in range(40):
        turn, place = draw.normal(size=4), draw.uniform(-0.5, 0.5, 3)
        turn /= np.linalg.norm(turn)
        state = np.array([[*place, *turn, *np.zeros(6)]])
        slopes = []
        for axis in np.eye(3):
            slopes.append(potential(place - step * axis, turn) - potential(place + step * axis, turn))
        for axis in np.eye(3) * math.sin(step / 2):
            ends = [multiply((*(way * axis), math.cos(step / 2)), tuple(turn)) for way in (-1, 1)]
            slopes.append(potential(place, ends[0]) - potential(place, ends[1]))
        expected = np.array(slopes) / (2 * step)
        assert immersion.wrenches(state)[:, 0] == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize(("shape", "size"), SOLIDS)
def test_the_submerged_part_is_that_of_the_shape(shape: Shape, size: Vector) -> None:
    draw = np.random.default_rng(5)
    points = draw.uniform(-0.5, 0.5, (40_000, 3)) * size
    lies = next(i for i in (1, 0, 2) if size[i - 1] == size[i - 2]) if shape != "box" else 0
    radius, half = size[lies - 1] / 2, size[lies] / 2
    along, aside = points[:, lies], (points**2).sum(axis=1) - points[:, lies] ** 2
    if shape == "cylinder":
        points = points[aside < radius**2]
    elif shape != "box":
        points = points[np.maximum(np.abs(along) - (half - radius), 0) ** 2 + aside < radius**2]
    immersion = Immersion(Medium(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), 1e-3, [shape], [size], np.array([1.0]))
    weight = math.prod(size) * len(points) / 40_000
    for _ in range(25):
        x, y, z, w = turn = draw.normal(size=4)
        x, y, z, w = turn / np.linalg.norm(turn)
        rise = np.array([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)])
        height = draw.uniform(-0.5, 0.5)
        state = np.array([[0, height, 0, x, y, z, w, *np.zeros(6)]])
        below = float((points @ rise + height < 0).mean())
        assert immersion.wrenches(state)[1, 0] / weight == pytest.approx(below, abs=0.04)


def eel(shape: str = "box", name: str = "eel") -> Reply:
    genome = deepcopy(snake(name=name, segments=6))
    for cube in genome["body"]["cubes"]:
        cube |= {"size": [0.3, 0.3, 0.08], "mass": 5, "position": [-cube["position"][0], 0.15, 0]}
    for joint in genome["body"]["joints"]:
        joint |= {"axis": [0, 1, 0], "anchor": [-joint["anchor"][0], 0.15, 0]}
        joint["motor"] |= {"max_effort": 60, "range": [-0.9, 0.9]}
    if shape != "box":
        genome["body"]["cubes"][0] |= {"shape": "cylinder", "size": [0.3, 0.3, 0.08]}
    return genome


@pytest.mark.parametrize("config", [{"gravity": [0, 0, 0]}, {"medium": {"level": 1, "density": 400, "viscosity": 5}}])
def test_creatures_in_water_are_run_together_as_each_is_alone(config: Reply, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows have the water that is everywhere; where it has a level each goes on in a world."""
    head = {"format": "nmes-task/1", "name": "wet", "description": "A test.", "duration": 1, "seeds": [3, 4]}
    task = Task({**head, "world": {"medium": {}, **config}, "objective": "displacement.x", "settle_limit": 3})
    genomes = [Genome(eel()), Genome(eel("cylinder", "other")), Genome(eel(name="third"))]
    together = Evaluator(1).evaluate_population(genomes, task)
    assert together == [evaluate(genome, task) for genome in genomes]
    monkeypatch.setattr(evaluator, "run_alone", population.run_in_world)
    assert together == [evaluate(genome, task) for genome in genomes]
    assert not any(result.fault for one in together for result in one.results)


def excess(config: Reply, judged: Reply) -> Any:
    """Returns what bodies gain that fall, float up and bob in water, where the balance takes them to be in another."""
    made, client = joined(**config)
    for i, (shape, size) in enumerate(SOLIDS):
        fields = {"shape": shape, "size": list(size), "mass": 30 + 60 * i, "rotation": [0.3, 0.2, 0.7 * i]}
        ask(made, client, "spawn_cube", cube_name=f"c{i}", position=[3 * i, 1.5 + i, 0], **fields)
    track = made.track(made.cubes(), [], [], 300)
    for _ in range(300):
        made.tick()
        track.note()
    sizes, _, shapes = zip(*map(made.cube_shape, made.cubes()), strict=True)
    masses = np.array([30.0 + 60 * i for i in range(len(SOLIDS))])
    bodies = ObservedBodies(tuple(made.cubes()), len(sizes), np.array(sizes), masses, 60, shapes=shapes)
    balance = Balance.of(bodies, protocol.complete_config({**config, **judged}), [])
    return balance.excess(track.states(0, 300), np.zeros((300, 2, 0)), np.zeros((300, 0)))


@pytest.mark.parametrize("medium", [{}, {"level": 3}, {"level": 3, "viscosity": 100}, {"density": 50}])
def test_what_floats_up_and_bobs_gains_no_energy(medium: Reply) -> None:
    assert excess({"medium": medium}, {}) is None


def test_energy_from_nowhere_is_seen_in_water_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """A balance that knew of no buoyancy, or of too little, would call it a gain; and what pushes along is one."""
    assert excess({"medium": {}}, {"medium": {"density": 20}}) is not None
    right = Immersion.wrenches
    monkeypatch.setattr(Immersion, "wrenches", lambda self, states: right(self, states) * 2.0)
    assert excess({"medium": {"level": 3}}, {}) is not None


def test_an_eel_swims_the_shipped_task_and_a_dead_one_does_not() -> None:
    task = Task.load("swim")
    swimmer, dead = eel(), eel()
    swimmer["brain"]["oscillators"] = [{"motor": "*", "frequency": 1.6, "amplitude": 0.7, "step": 1.2}]
    dead["brain"]["oscillators"] = [{"motor": "*", "frequency": 1, "amplitude": 0}]
    seeds = [1]
    assert evaluate(Genome(dead), task, seeds=seeds).score == pytest.approx(0, abs=1e-6)
    score = evaluate(Genome(swimmer), task, seeds=seeds).score
    assert score is not None and score > 1.0
