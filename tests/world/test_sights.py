"""Senses of what rays meet, faces touch, accelerometers feel and noses smell, each by its formula."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from nmes import World
from nmes.errors import DocumentError
from nmes.evaluation import Evaluator, Task, evaluate
from nmes.genome import Genome
from nmes.playback import replay
from nmes.recording import Recorder

Document = dict[str, Any]
RED, GREEN = [0.9, 0.1, 0.2], [0.1, 0.8, 0.3]
SKY, GROUND = [0.7, 0.8, 0.9], [0.4, 0.4, 0.4]


def block(*sensors: Document, **changes: Any) -> Document:
    """A creature of one cube of 0.4 m with sensors on it."""
    cubes = [{"id": "root", "size": 0.4, "mass": 1, "position": [0, 0.2, 0]}]
    on_root = [{"cube": "root", **sensor} for sensor in sensors]
    return {"format": "nmes-genome/1", "name": "block", "body": {"cubes": cubes}, "sensors": on_root, **changes}


class Place:
    """A world in lockstep, without gravity unless it is given, and one client in it."""

    def __init__(self, **config: Any) -> None:
        self.world = World({"mode": "lockstep", "gravity": [0, 0, 0], **config})
        self.client = self.world.join()

    def __call__(self, kind: str, **fields: Any) -> Document:
        reply = self.world.execute(self.client, {"type": kind, **fields})
        assert reply["type"] != "error", reply
        return reply

    def spawn(self, *sensors: Document, name: str = "me", x: float = 0.0, y: float = 5.0, **fields: Any) -> Document:
        return self("spawn_creature", genome=block(*sensors), name=name, position=[x, y - 0.2, 0], **fields)

    def wall(self, name: str, position: list[float], size: Any = 1.0, **fields: Any) -> None:
        self("spawn_cube", cube_name=name, position=position, size=size, frozen=True, **fields)

    def sense(self, name: str = "me") -> list[float]:
        values: list[float] = self("sense", creature=name)["values"]
        return values


def test_a_range_finder_reads_how_far_it_is_along_its_direction() -> None:
    place = Place()
    below, aside = {"direction": [0, -2, 0], "id": "below"}, {"direction": [0, 0, 1], "id": "aside", "range": 3}
    place.spawn(*({"type": "range", **more} for more in ({}, below, aside)))
    place.wall("wall", [4, 5, 0])
    place("step")
    assert place.sense() == pytest.approx([3.5, 5.0, 3.0])  # nothing is aside: what it reads at its end
    place("set_cube_state", cube_name="me.root", rotation=[0, math.pi / 2, 0])  # its z is where the wall is
    assert place.sense() == pytest.approx([10.0, 5.0, 3.0])
    place("set_cube_state", cube_name="me.root", position=[1, 5, 0])
    assert place.sense() == pytest.approx([10.0, 5.0, 2.5])


def test_a_range_finder_sees_other_parts_of_its_own_body() -> None:
    place, genome = Place(), block({"type": "range"})
    genome["body"]["cubes"].append({"id": "nose", "size": 0.2, "mass": 1, "position": [1, 0.2, 0]})
    genome["body"]["joints"] = [
        {"id": "neck", "cube1": "root", "cube2": "nose", "type": "fixed", "anchor": [0.5, 0.2, 0]}
    ]
    place("spawn_creature", genome=genome, name="me", position=[0, 5, 0])
    place("step")
    assert place.sense() == pytest.approx([0.9])


def test_an_accelerometer_feels_what_holds_or_pushes_it_in_its_own_axes() -> None:
    place = Place(gravity=[0, -10, 0])
    place.spawn({"type": "acceleration"}, name="resting", y=0.2)
    place.spawn({"type": "acceleration"}, name="falling", x=50.0, y=100.0)
    place.spawn({"type": "acceleration", "axis": "x"}, name="pushed", x=90.0, y=100.0)
    place("step", ticks=60)
    place("apply_physics", cube_name="pushed.root", force=[6, 0, 0])
    place("step")
    assert place.sense("resting") == pytest.approx([0, 1, 0], abs=0.02)
    assert place.sense("falling") == pytest.approx([0, 0, 0], abs=1e-9)
    assert place.sense("pushed") == pytest.approx([0.6])
    place("set_cube_state", cube_name="resting.root", rotation=[0, 0, math.pi / 2])  # its x is up
    place("step", ticks=30)
    assert place.sense("resting") == pytest.approx([1, 0, 0], abs=0.02)


@pytest.mark.parametrize("backend", ["mujoco", "pymunk"])
def test_a_face_feels_only_what_touches_it(backend: str) -> None:
    place = Place(gravity=[0, -10, 0], backend=backend)
    faces = ("-y", "+y", "+x", "-x")
    place.spawn({"type": "touch"}, *({"type": "touch", "face": face} for face in faces), y=0.2)
    place("step", ticks=30)
    assert place.sense() == [1, 1, 0, 0, 0]
    place("spawn_cube", cube_name="hat", position=[0, 0.52, 0], size=0.2)
    place("step", ticks=30)
    assert place.sense() == [1, 1, 1, 0, 0]
    place("despawn_cube", cube_name="hat")
    place("set_cube_state", cube_name="me.root", rotation=[0, 0, math.pi / 2])  # its -x is below
    place("step", ticks=30)
    assert place.sense() == [1, 0, 0, 0, 1]


def test_a_camera_shows_the_colours_of_what_its_rays_meet() -> None:
    place = Place()
    place.spawn({"type": "camera", "width": 3, "height": 3, "fov": 2 * math.atan(1.5), "colors": "rgb"})
    # Along x, pixels are 1 m apart at a distance of 1 m: the left one looks along -z.
    place.wall("red", [4, 5, -4], 2.0, color=[*RED, 1])
    place.wall("green", [4, 5, 4], 2.0, color=[*GREEN, 1])
    place("step")
    values = place.sense()
    pixels = [values[i : i + 3] for i in range(0, len(values), 3)]
    assert pixels == [SKY, SKY, SKY, RED, SKY, GREEN, GROUND, GROUND, GROUND]


def test_two_cameras_of_one_cube_need_names() -> None:
    with pytest.raises(DocumentError, match=r"there is a sensor 'root\.camera\.1\.1' already"):
        Genome(
            block(*({"type": "camera", "width": 1, "height": 1, "direction": way} for way in ([0, 0, 1], [0, 1, 0])))
        )


def test_the_brightness_of_a_camera_is_that_of_television() -> None:
    place = Place()
    ways = {"left": [0, 0, -1], "down": [0, -1, 0], "far": [1, 0, 0]}
    cameras = [{"type": "camera", "width": 1, "height": 1, "direction": way, "id": id} for id, way in ways.items()]
    place.spawn(*cameras[:2], {**cameras[2], "range": 3})
    place.wall("red", [0, 5, -4], color=RED)
    place.wall("green", [4, 5, 0], color=GREEN)
    place("step")
    brightness = [0.299 * red + 0.587 * green + 0.114 * blue for red, green, blue in (RED, GROUND, SKY)]
    assert place.sense() == pytest.approx(brightness)


def test_the_others_smell_by_their_distances() -> None:
    place = Place()
    place.spawn({"type": "other_smell", "range": 2}, {"type": "other_smell", "id": "keen"})
    assert place.sense() == [0, 0]
    place.spawn(name="one", x=2.0)
    assert place.sense() == pytest.approx([1 / 2, 1 / 5])
    place.spawn(name="two", x=-4.0)
    assert place.sense() == pytest.approx([1 / 2 + 1 / 5, 1 / 5 + 1 / 17])


@pytest.mark.parametrize("backend", ["mujoco", "pymunk", "ballistic"])
def test_the_target_smells_wherever_it_is(backend: str) -> None:
    place = Place(backend=backend)
    place.spawn({"type": "target_smell", "range": 3}, target="prey")
    assert place.sense() == [0]
    place.wall("prey", [0, 9, 0])
    assert place.sense() == pytest.approx([9 / (9 + 16)])


def test_food_smells_by_its_distances() -> None:
    place = Place(life={"food": {"places": [{"radius": 3}], "start": 5, "rate": 0, "energy": 1}})
    place.spawn({"type": "food_smell", "range": 2}, y=6.0)
    assert place.sense() == [0]
    place("step")
    food = place.world.entities.food.tolist()
    assert len(food) == 5
    place("set_cube_state", cube_name="me.root", position=[1, 2, 3])
    apart = [math.dist(each, (1, 2, 3)) for each in food]
    assert place.sense() == pytest.approx([math.fsum(4 / (4 + each * each) for each in apart)])


def test_what_does_not_fit_a_sensor_is_told_with_its_place() -> None:
    wrong: dict[str, Document] = {
        "face": {"type": "up", "face": "+x"},
        "direction": {"type": "touch", "direction": [1, 0, 0]},
        "width": {"type": "range", "width": 3},
        "range": {"type": "acceleration", "range": 3},
        "axis": {"type": "range", "axis": "x"},
    }
    document = block(*wrong.values())
    places = [place for place, _ in Genome.problems(document)]
    assert places == [f"sensors/{index}/{field}" for index, field in enumerate(wrong)]


def test_a_body_sends_a_thousand_rays_at_most() -> None:
    cameras = [{"type": "camera", "width": 16, "height": 16, "colors": "rgb", "id": f"eye{i}"} for i in range(5)]
    finder = {"type": "range"}
    assert not Genome.problems(block(*cameras[:4]))
    for one_too_many in (cameras[4], finder):
        problems = Genome.problems(block(*cameras[:4], one_too_many))
        assert problems == [("sensors/4", "with it there are over 1,024 rays of cameras and range finders")]


@pytest.mark.parametrize(("kind", "backend"), [("range", "pymunk"), ("camera", "pymunk"), ("acceleration", "pymunk")])
def test_what_an_engine_cannot_sense_is_refused(kind: str, backend: str) -> None:
    place = Place(backend=backend)
    reply = place.world.execute(place.client, {"type": "spawn_creature", "genome": block({"type": kind})})
    assert (reply["type"], reply["code"], reply["field"]) == ("error", "unsupported", "genome/sensors")
    assert not place.world.entities.cubes


def test_names_of_pixels_are_rows_and_columns() -> None:
    camera = {"type": "camera", "width": 2, "height": 2, "colors": "rgb"}
    names = [sensor.id for sensor in Genome(block(camera, {"type": "touch", "face": "-y"})).body.sensors]
    assert names[:4] == ["root.camera.1.1.r", "root.camera.1.1.g", "root.camera.1.1.b", "root.camera.1.2.r"]
    assert names[-2:] == ["root.camera.2.2.b", "root.touch.-y"]
    assert [sensor.id for sensor in Genome(block({**camera, "id": "eye", "colors": "grey"})).body.sensors] == [
        "eye.1.1",
        "eye.1.2",
        "eye.2.1",
        "eye.2.2",
    ]


ALL = (
    {"type": "range", "direction": [0, -1, 0]},
    {"type": "camera", "width": 4, "height": 2, "direction": [1, -0.5, 0]},
    {"type": "acceleration"},
    {"type": "touch", "face": "-y"},
    {"type": "other_smell"},
    {"type": "target_smell"},
)


def looker(gain: float) -> Document:
    """A creature with every sense of what is around it, whose one slide follows all of them."""
    genome = block(*ALL)
    genome["body"]["cubes"].append({"id": "leg", "size": 0.3, "mass": 1, "position": [0.5, 0.2, 0]})
    motor = {"mode": "velocity", "range": [-3, 3], "max_effort": 40}
    joint = {"id": "hip", "cube1": "root", "cube2": "leg", "type": "hinge", "anchor": [0.3, 0.2, 0], "motor": motor}
    genome["body"]["joints"] = [joint]
    links = [{"sensor": "root.*", "to": "n", "weight": gain}]
    return {**genome, "brain": {"kind": "graph", "nodes": [{"id": "n", "motor": "hip", "bias": 0.4}], "links": links}}


def test_creatures_that_look_around_fare_in_a_population_as_alone(tmp_path: Path) -> None:
    task = Task({"format": "nmes-task/1", "name": "t", "description": "d", "world": {}, "duration": 1, "seeds": [1, 2],
                 "vary": {"drop": [0, 0.3]}, "target": {"distance": [2, 3]}, "objective": "energy"})  # fmt: skip
    genomes = [looker(gain) for gain in (-0.4, -0.2, 0.1, 0.3, 0.5)]
    with Evaluator(jobs=1) as evaluator:
        rows = evaluator.evaluate_population(genomes, task)
    alone = [evaluate(genome, task) for genome in genomes]
    assert [each.results for each in rows] == [each.results for each in alone]
    assert len({each.score for each in alone}) == len(genomes)
    evaluate(genomes[0], task, record=str(tmp_path))
    assert {replay(path).verdict for path in tmp_path.glob("*.mcap")} == {"reproduced"}


def test_what_is_seen_in_a_restored_world_is_what_was_seen(tmp_path: Path) -> None:
    place = Place(gravity=[0, -9.81, 0])
    place("spawn_creature", genome=looker(0.3), name="me", position=[0, 0.1, 0], target=[3, 0, 0], autonomous=True)
    place.spawn(name="other", x=2.0, y=0.2)
    place.wall("wall", [1.5, 0.5, 0.4], color=RED)
    place("step", ticks=17)
    again = Place(gravity=[0, -9.81, 0])
    again.world.restore(place.world.snapshot())
    again.client = again.world.join()
    for _ in range(20):
        assert again.sense() == place.sense() and again.world.digest() == place.world.digest()
        place.world.tick()
        again.world.tick()


def test_a_recording_of_a_creature_that_looks_around_replays(tmp_path: Path) -> None:
    place, path = Place(gravity=[0, -9.81, 0], keyframes=0.5), tmp_path / "looks.mcap"
    place.world.journal = recorder = Recorder(path, place.world)
    place("spawn_creature", genome=looker(0.3), name="me", autonomous=True)
    for _ in range(40):
        place("sense", creature="me")
        place("step")
    recorder.close()
    assert replay(path).verdict == "reproduced"


def test_a_host_is_told_what_cameras_cost() -> None:
    place, command = Place(), {"type": "sense", "creature": "me"}
    place.spawn({"type": "range"}, name="poor", x=5.0)
    few = place.world.cost(command)
    place.spawn(*({"type": "camera", "width": 16, "height": 16, "id": f"eye{i}"} for i in range(4)))
    assert 0 < few * 1024 == pytest.approx(place.world.cost(command), rel=0.1)
    assert place.world.cost(command) > 0.002
