"""The senses of the nearest other creature: in worlds, in rows, over snapshots."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from nmes import World
from nmes.evaluation import Evaluator, Task, evaluate
from nmes.genome import Genome

Document = dict[str, Any]
OTHERS = ("other_direction", "other_distance", "other_velocity")


def puck(*sensors: Document, **changes: Any) -> Document:
    """A creature of two cubes, the second two metres behind the root, with senses of others on either."""
    cubes = [
        {"id": "root", "size": 0.4, "mass": 1, "position": [0, 0.2, 0]},
        {"id": "tail", "size": 0.4, "mass": 1, "position": [-2, 0.2, 0]},
    ]
    joint = {"id": "j", "cube1": "root", "cube2": "tail", "type": "fixed", "anchor": [-1, 0.2, 0]}
    body = {"cubes": cubes, "joints": [joint]}
    chosen = sensors or tuple({"type": kind, "cube": "root"} for kind in OTHERS)
    return {"format": "nmes-genome/1", "name": "puck", "body": body, "sensors": list(chosen), **changes}


class Place:
    """A world in lockstep without gravity, and one client in it."""

    def __init__(self, **config: Any) -> None:
        self.world = World({"mode": "lockstep", "gravity": [0, 0, 0], **config})
        self.client = self.world.join()

    def __call__(self, kind: str, **fields: Any) -> dict[str, Any]:
        reply = self.world.execute(self.client, {"type": kind, **fields})
        assert reply["type"] != "error", reply
        return reply

    def spawn(self, name: str, x: float, z: float = 0.0, genome: Document | None = None) -> None:
        self("spawn_creature", genome=genome or puck(), name=name, position=[x, 5, z])

    def move(self, cube: str, **state: Any) -> None:
        self("set_cube_state", cube_name=cube, **state)

    def sense(self, name: str) -> list[float]:
        values: list[float] = self("sense", creature=name)["values"]
        return values


@pytest.mark.parametrize("backend", ["mujoco", "pymunk", "ballistic"])
def test_the_nearest_other_is_seen_in_the_cubes_own_directions(backend: str) -> None:
    place = Place(backend=backend)
    place.spawn("me", 0.0)
    assert place.sense("me") == [0.0] * 7  # nobody is there
    place.spawn("far", 20.0)
    place.spawn("near", 8.0)
    place.move("near.root", linear_velocity=[0, 3, 0])
    place.move("me.root", linear_velocity=[1, 0, 0])
    assert place.sense("me") == pytest.approx([1, 0, 0, 8, -1, 3, 0])
    place.move("me.root", rotation=[0, 0, math.pi / 2], linear_velocity=[0, 0, 0])  # its x is up now
    assert place.sense("me") == pytest.approx([0, -1, 0, 8, 3, 0, 0])


def test_others_are_where_their_roots_are_and_seen_from_the_cube_itself() -> None:
    place = Place()
    sensors = [{"type": "other_distance", "cube": cube} for cube in ("root", "tail")]
    place.spawn("me", 0.0, genome=puck(*sensors))
    place.spawn("left", -7.0)
    place.spawn("right", 6.0)
    # The tail of `right` is 4 m from the root, and that of `me` 5 m from the root of `left`.
    assert place.sense("me") == pytest.approx([6, 5])


def test_of_others_equally_far_the_first_is_seen() -> None:
    for first, second in (("a", "b"), ("b", "a")):
        place = Place()
        place.spawn("me", 0.0)
        place.spawn(first, 5.0 if first == "a" else -5.0)
        place.spawn(second, 5.0 if second == "a" else -5.0)
        assert place.sense("me")[0] == (1.0 if first == "a" else -1.0)


def test_what_moves_comes_and_goes_is_seen_at_once() -> None:
    place = Place()
    place.spawn("me", 0.0)
    place.spawn("other", 8.0)
    assert place.sense("me")[3] == pytest.approx(8)
    place.move("other.root", position=[6, 5.2, 0])
    assert place.sense("me")[3] == pytest.approx(6)
    place.move("other.root", linear_velocity=[6, 0, 0])
    place("step", ticks=10)
    assert place.sense("me")[3] == pytest.approx(7, abs=0.01)
    place.spawn("newcomer", 0.0, 3.0)
    assert place.sense("me")[3] == pytest.approx(3)
    place("despawn_cube", cube_name="newcomer.root")  # which leaves a cube, and no creature
    assert place.sense("me")[3] == pytest.approx(7, abs=0.01)
    place("reset")
    place.spawn("me", 0.0)
    assert place.sense("me") == [0.0] * 7


def test_who_looked_before_a_snapshot_sees_after_it_what_a_restored_world_does() -> None:
    """The engine takes up edits for a snapshot, by which places and velocities may come to have other bits."""
    place = Place()
    for name, x in (("me", 0.0), ("other", 3.1)):
        place.spawn(name, x)
    place("step", ticks=7)
    turned = {"rotation": [0.3, 0.7, 0.1], "linear_velocity": [0.1, 0.7, 0.3], "angular_velocity": [0.3, 0.1, 0.7]}
    place.move("other.tail", position=[1.1, 7.3, 2.7], **turned)
    before = place.sense("me")
    again = World(place.world.config)
    again.restore(place.world.snapshot())
    assert place.sense("me") == again.creature("me").sense().tolist()
    assert before == pytest.approx(place.sense("me"))


def test_with_a_range_none_is_seen_beyond_it() -> None:
    place = Place()
    sensors = [{"type": "other_distance", "cube": "root", "range": reach, "id": f"r{reach}"} for reach in (7, 8, 9)]
    place.spawn("me", 0.0, genome=puck(*sensors))
    place.spawn("other", 8.0)
    assert place.sense("me") == pytest.approx([0, 8, 8])


def test_a_range_is_only_of_others() -> None:
    document = puck({"type": "height", "cube": "root", "range": 3})
    assert [path for path, _ in Genome.problems(document)] == ["sensors/0/range"]


def test_a_restored_world_senses_the_same() -> None:
    place = Place()
    for name, x in (("me", 0.0), ("one", 5.0), ("two", -5.0)):
        place.spawn(name, x)
    place("step", ticks=3)
    again = World(place.world.config)
    again.restore(place.world.snapshot())
    assert [again.creature(name).sense().tolist() for name in again.creatures()] == [
        place.world.creature(name).sense().tolist() for name in place.world.creatures()
    ]


def test_alone_in_a_row_nobody_is_seen(tmp_path: Path) -> None:
    """A creature that is driven by what it sees of others scores alike as a row and in a world by itself."""
    sensors = [{"type": "other_distance", "cube": "root"}, {"type": "height", "cube": "root"}]
    joint: dict[str, Any] = {"id": "j", "cube1": "root", "cube2": "tail", "type": "slide", "anchor": [-1, 0.2, 0]}
    joint["motor"] = {"mode": "velocity", "range": [-1, 1], "max_effort": 20}
    document = puck(*sensors)
    document["body"]["joints"] = [joint]
    document["brain"] = {"kind": "mlp", "layers": [{"weights": [[1.0, 1.0]], "biases": [0.1]}]}
    task = Task({"format": "nmes-task/1", "name": "t", "description": "d", "world": {}, "duration": 1, "seeds": [1, 2],
                 "objective": "displacement.x"})  # fmt: skip
    with Evaluator(jobs=1) as evaluator:
        rows = evaluator.evaluate_population([document] * 3, task)
    scores = [evaluation.score for evaluation in rows]
    world = evaluate(document, task, record=str(tmp_path))  # what is recorded runs in a world
    assert scores == [world.score] * 3 and world.score not in (None, 0.0), rows
