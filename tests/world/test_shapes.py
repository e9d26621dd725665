"""Bodies that are no boxes: over the wire, in genomes, in scenery, recorded, run together, and drawn."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from creatures import snake
from lockstep import ask, joined, refused
from nmes import World
from nmes.evaluation import Evaluator, Task, evaluate, evaluator, population
from nmes.evaluation.identity import creature_hash
from nmes.genome import Genome
from nmes.genome.preview import render_cutout
from nmes.playback import replay
from nmes.recording.viewer_messages import Painter, decode_shapes
from recordings import record

Reply = dict[str, Any]
SIZES = {"sphere": [0.6, 0.6, 0.6], "capsule": [0.9, 0.3, 0.3], "cylinder": [0.6, 0.6, 0.2]}


@pytest.mark.parametrize("backend", ["mujoco", "pymunk", "ballistic"])
@pytest.mark.parametrize("shape", SIZES)
def test_a_cube_may_have_another_shape_which_it_tells(backend: str, shape: str) -> None:
    made, client = joined(backend)
    ask(made, client, "spawn_cube", cube_name="a", shape=shape, size=SIZES[shape], position=[0, 1, 0])
    ask(made, client, "spawn_cube", cube_name="b", shape="box", position=[3, 1, 0])
    info = ask(made, client, "get_cube_info", cube_name="a")
    assert (info["shape"], list(info["size"])) == (shape, SIZES[shape])
    assert "shape" not in ask(made, client, "get_cube_info", cube_name="b")
    ask(made, client, "step", ticks=60)
    assert ask(made, client, "get_cube_info", cube_name="a")["position"][1] == pytest.approx(
        SIZES[shape][1] / 2, abs=0.005
    )


@pytest.mark.parametrize(
    ("shape", "size", "words"),
    [
        ("sphere", [1, 1, 0.5], "three equal edges"),
        ("capsule", 1, "longer than it is wide"),
        ("capsule", [1, 0.5, 1], "longer than it is wide"),
        ("capsule", [1, 0.5, 0.6], "two equal edges"),
        ("cylinder", [1, 0.5, 0.6], "two equal edges"),
    ],
)
def test_a_size_that_a_shape_cannot_have_is_refused_and_nothing_is_made(shape: str, size: Any, words: str) -> None:
    made, client = joined()
    before = made.digest()
    reply = refused(made, client, "spawn_cube", shape=shape, size=size)
    assert (reply["code"], reply["field"]) == ("invalid", "size") and words in reply["message"]
    assert made.digest() == before and not made.cubes()


def test_a_shape_that_the_engine_lacks_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    from nmes.backends.pymunk2d import PymunkBackend

    few = PymunkBackend.capabilities - {"shape.capsule"}
    monkeypatch.setattr(PymunkBackend, "capabilities", few)
    made, client = joined("pymunk")
    reply = refused(made, client, "spawn_cube", shape="capsule", size=SIZES["capsule"])
    assert (reply["code"], reply["field"]) == ("unsupported", "shape")
    genome = snake(None)
    genome["body"]["cubes"][1] |= {"shape": "capsule", "size": [0.3, 0.14, 0.14]}
    reply = refused(made, client, "spawn_creature", genome=genome)
    assert (reply["code"], reply["field"]) == ("unsupported", "genome/body")
    scene = {"obstacles": [{"type": "sphere"}, {"type": "capsule", "size": [2, 1, 1]}]}
    with pytest.raises(Exception, match="capsule") as caught:
        World({"backend": "pymunk", "scene": scene})
    assert (caught.value.code, caught.value.path) == ("unsupported", "scene/obstacles/1/type")  # type: ignore[attr-defined]


def test_a_ball_in_the_ground_is_set_down_on_its_lowest_point_however_it_is_turned() -> None:
    made, client = joined()
    moved = ask(made, client, "spawn_cube", shape="sphere", position=[0, -1, 0], rotation=[0.4, 0.3, 0.2])["moved_to"]
    assert moved == pytest.approx([0, 0.5, 0], abs=1e-12)


def test_an_obstacle_of_a_size_that_it_cannot_have_is_refused() -> None:
    with pytest.raises(Exception, match="two equal edges") as caught:
        World({"scene": {"obstacles": [{"type": "box"}, {"type": "cylinder", "size": [1, 2, 3]}]}})
    assert (caught.value.code, caught.value.path) == ("invalid", "scene/obstacles/1/size")  # type: ignore[attr-defined]


def play(made: World, client: int) -> None:
    """Lets shapes fall on each other, has one turned into another's way, and takes one away."""
    for i, (shape, size) in enumerate([*SIZES.items(), ("box", [0.4, 0.4, 0.4]), *SIZES.items()]):
        command = {"type": "spawn_cube", "shape": shape, "size": size, "position": [0.1 * i, 0.5 + 0.7 * i, 0]}
        made.execute(client, {**command, "cube_name": f"c{i}", "rotation": [0, 0, 0.3 * i]})
        made.execute(client, {"type": "step", "ticks": 20})
    made.execute(client, {"type": "despawn_cube", "cube_name": "c2"})
    made.execute(client, {"type": "step", "ticks": 40})


@pytest.mark.parametrize("backend", ["mujoco", "pymunk", "ballistic"])
def test_worlds_of_shapes_replay_and_restore_bit_for_bit(backend: str, tmp_path: Path) -> None:
    obstacles = [{"type": "sphere", "position": [-1, 0, 0]}, {"type": "cylinder", "size": [3, 0.2, 0.2]}]
    scene = {} if backend == "ballistic" else {"scene": {"obstacles": obstacles}}
    config = {"mode": "lockstep", "backend": backend, **scene}
    path = record(tmp_path / "shapes.mcap", play, config)
    assert replay(path).verdict == "reproduced"
    if backend == "pymunk":
        return  # it has no snapshots
    made, client = joined(backend, **scene)
    play(made, client)
    again, _ = joined(backend, **scene)
    again.restore(made.snapshot())
    for _ in range(30):
        made.tick()
        again.tick()
        assert again.digest() == made.digest()
    assert [again.cube_shape(name) for name in again.cubes()] == [made.cube_shape(name) for name in made.cubes()]


def round_snake(shape: str = "capsule", **changes: Any) -> Reply:
    genome = snake(**changes)
    for i, cube in enumerate(genome["body"]["cubes"]):
        if i % 2:
            cube |= {"shape": shape, "size": {"capsule": [0.3, 0.14, 0.14], "sphere": 0.14, "cylinder": 0.14}[shape]}
    return genome


@pytest.mark.parametrize("shape", SIZES)
def test_creatures_of_shapes_are_run_together_as_each_is_alone(shape: str, monkeypatch: pytest.MonkeyPatch) -> None:
    head = {"format": "nmes-task/1", "name": "run", "description": "A test.", "duration": 1, "seeds": [3, 4]}
    task = Task({**head, "objective": "displacement.x + lowest + max.reach", "vary": {"yaw": [-1, 1]}})
    genomes = [Genome(round_snake(shape)), Genome(round_snake(shape, name="other")), Genome(snake())]
    together = Evaluator(1).evaluate_population(genomes, task)
    assert together == [evaluate(genome, task) for genome in genomes]
    monkeypatch.setattr(evaluator, "run_alone", population.run_in_world)
    assert together == [evaluate(genome, task) for genome in genomes]
    assert together[0].score != together[2].score


def test_the_mass_of_a_grown_part_is_by_the_volume_of_its_shape() -> None:
    volumes = {"sphere": math.pi / 6 * 0.027, "cylinder": math.pi / 4 * 0.09 * 0.6}
    volumes["capsule"] = math.pi / 4 * 0.09 * 0.3 + math.pi / 6 * 0.027
    for shape, volume in volumes.items():
        size = [0.6, 0.3, 0.3] if shape != "sphere" else 0.3
        part = {"id": "a", "size": size, "shape": shape, "density": 700}
        body = Genome({"format": "nmes-genome/1", "name": "x", "body": {"graph": {"root": "a", "parts": [part]}}}).body
        assert body.mass == pytest.approx(700 * volume, rel=1e-8)
        assert body.cubes[0].shape == shape


def test_a_genome_is_told_which_of_its_parts_cannot_have_their_size() -> None:
    genome = snake()
    genome["body"]["cubes"][2]["shape"] = "sphere"
    assert [path for path, _ in Genome.problems(genome)] == ["body/cubes/2/size"]
    part = {"id": "a", "size": [0.3, 0.2, 0.1], "shape": "capsule"}
    graph = {"root": "a", "parts": [{"id": "b", "size": 1}, part]}
    graph["connections"] = [{"from": "a", "to": "b", "face": "+x"}]
    grown = {"format": "nmes-genome/1", "name": "x", "body": {"graph": graph}}
    assert [path for path, _ in Genome.problems(grown)] == ["body/graph/parts/1/size"]


def test_creatures_that_differ_in_a_shape_alone_are_others() -> None:
    box, ball = snake(), snake()
    for genome in (box, ball):
        genome["body"]["cubes"][0] |= {"size": 0.14}
    ball["body"]["cubes"][0]["shape"] = "sphere"
    assert creature_hash(Genome(box)) != creature_hash(Genome(ball))


def test_the_lowest_and_the_farthest_point_are_those_of_the_shape() -> None:
    made, client = joined()
    turned = {"rotation": [0, 0, math.pi / 6]}
    cubes: dict[str, Reply] = {
        "ball": {"shape": "sphere", "size": 2, "position": [0, 3, 0], "rotation": [0.5, 0.2, 1]},
        "rod": {"shape": "capsule", "size": [3, 1, 1], "position": [9, 5, 0], **turned},
        "log": {"shape": "cylinder", "size": [3, 1, 1], "position": [18, 5, 0], **turned},
    }
    for name, fields in cubes.items():
        ask(made, client, "spawn_cube", cube_name=name, **fields)
    for name, lowest, reach in (
        ("ball", 2.0, 1.0),
        ("rod", 5 - 0.5 - 1.0 * 0.5, 1.5),
        ("log", 5 - 1.5 * 0.5 - 0.5 * math.cos(math.pi / 6), math.hypot(1.5, 0.5)),
    ):
        for quantity, expected in (("lowest", lowest), ("reach", reach)):
            ask(made, client, "set_objective", name="x", expression=quantity, cubes=[name])
            reply = ask(made, client, "compute_reward", objective="x")
            assert reply.get("value") == pytest.approx(expected, abs=1e-9), (name, quantity, reply)


def test_viewers_get_shapes_as_what_they_are() -> None:
    made, client = joined()
    for i, (shape, size) in enumerate([*SIZES.items(), ("box", [1, 2, 3])]):
        ask(made, client, "spawn_cube", cube_name=f"c{i}", shape=shape, size=size, position=[3 * i, 5, 0])
    painter = Painter(made)
    view = painter.draw(painter.look())
    assert view.scene is not None
    assert decode_shapes(view.scene, {}) == {name: made.cube_shape(name) for name in made.cubes()}
    assert b"sphere" in view.scene
    with pytest.raises(ValueError, match="not a scene message"):
        decode_shapes(view.scene.replace(b"sphere", b"sphero"), {})


def test_a_ball_is_drawn_as_large_as_a_circle_in_its_box() -> None:
    def seen(shape: str) -> float:
        cube = {"id": "a", "size": 1, "mass": 1, "position": [0, 0.5, 0], "shape": shape}
        body = Genome({"format": "nmes-genome/1", "name": "x", "body": {"cubes": [cube]}}).body
        return float((render_cutout(body, 200, 200)[..., 3] > 128).mean())

    # The picture is of the box: its outline from there is a hexagon, in which the circle takes so much.
    yaw, pitch = math.radians(32), math.radians(24)
    faces = math.sin(pitch) + math.cos(pitch) * (math.sin(yaw) + math.cos(yaw))
    assert seen("sphere") / seen("box") == pytest.approx(math.pi / 4 / faces, rel=0.03)
    assert seen("sphere") < seen("cylinder") < seen("box")


@pytest.mark.parametrize("text", [b"0.6 0.6", b"nan 0.6 0.6", b"0.6 0.6 0.7"])
def test_a_scene_message_with_a_size_that_no_shape_has_is_refused(text: bytes) -> None:
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

    update = SceneUpdate()
    entity = update.entities.add(id="a")
    entity.spheres.add()
    entity.metadata.add(key="shape", value="sphere")
    entity.metadata.add(key="size", value=text.decode())
    with pytest.raises(ValueError, match="not a scene message"):
        decode_shapes(update.SerializeToString(), {})


def test_the_slice_of_a_round_obstacle_is_what_a_planar_engine_has() -> None:
    """A ball that the plane cuts off its middle is a smaller circle there."""
    made, client = joined("pymunk", scene={"obstacles": [{"type": "sphere", "size": 2, "position": [0, 0, 0.8]}]})
    ask(made, client, "spawn_cube", cube_name="a", size=0.2, position=[0, 2, 0])
    ask(made, client, "step", ticks=90)
    height = ask(made, client, "get_cube_state", cube_name="a")["position"][1]
    assert height == pytest.approx(0.6 + 0.1, abs=0.01)
    assert np.isfinite(made.poses()[1]).all()
