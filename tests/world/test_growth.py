"""Creatures that gain parts: they grow where the body has them, or adopt cubes; what is refused changes nothing."""

from __future__ import annotations

from math import fsum
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from creatures import mlp, snake
from nmes import World, protocol
from nmes.backend.rotation import rotate
from nmes.errors import DocumentError, WorldError
from nmes.genome import Genome
from nmes.playback import replay
from nmes.recording import Recorder
from nmes.world.snapshot import pack, unpack

Json = dict[str, Any]
FLOAT: dict[str, Any] = {"gravity": [0, 0, 0]}


def young(*later: str, **changes: Any) -> Json:
    """Returns a snake of which some segments are not there at birth."""
    return {**snake(**changes), "later": list(later)}


class Place:
    """A world in lockstep with one client, who hears of creatures; every message is checked against its schema."""

    def __init__(self, genome: Json, recording: Path | None = None, autonomous: bool = False, **config: Any) -> None:
        self.world = World({"mode": "lockstep", "seed": 4, **config})
        self.recorder = None if recording is None else Recorder(recording, self.world)
        self.world.journal = self.recorder
        self.events: list[Json] = []
        self.world.emit = lambda _, event: self.events.append(protocol.decode(event))
        self.client = self.world.join()
        self("subscribe", events=["creatures"])
        self.born = self("spawn_creature", genome=genome, name="s", position=[0, 1, 0], autonomous=autonomous)

    def __call__(self, kind: str, **fields: Any) -> Json:
        reply = self.world.execute(self.client, {"type": kind, **fields})
        protocol.validate_reply(reply)
        return reply

    def grow(self, part: str) -> Json:
        return self("grow", creature="s", part=part)

    def state(self, cube: str) -> Json:
        return self("get_cube_state", cube_name=cube)

    def senses(self) -> dict[str, float]:
        names = [sensor.id for sensor in self.world.creature("s").sensors]
        return dict(zip(names, self("sense", creature="s")["values"], strict=True))

    def again(self) -> Place:
        other = Place.__new__(Place)
        other.world, other.client, other.events = World(self.world.config), self.client, []
        other.world.restore(self.world.snapshot())
        return other


def test_what_is_later_is_not_there_at_birth_but_its_senses_and_controls_are() -> None:
    place = Place(young("c2", "c3"), **FLOAT)
    assert place.world.cubes() == ["s.c0", "s.c1"] and place.world.joints() == ["s.j0"]
    assert place.born["motors"] == ["j0", "j1", "j2"]
    assert place("drive", creature="s", controls=[1, 1, 1])["layout"] == 5
    assert place.senses()["j1.position"] == 0


def test_a_part_grows_where_the_body_has_it_and_moves_along() -> None:
    place = Place(young("c3"), **FLOAT)
    place("set_cube_state", cube_name="s.c0", rotation=[0.3, 0.8, -0.4], linear_velocity=[1, 2, 3])
    place("set_cube_state", cube_name="s.c0", angular_velocity=[0, 0, 2])
    before = momentum(place)
    assert place.grow("c3") == {"type": "part_grown", "creature": "s", "part": "c3", "cube": "s.c3", "layout": 5}
    base, part = place.state("s.c2"), place.state("s.c3")
    arm = rotate(tuple(base["quaternion"]), (0.36, 0, 0))
    assert part["position"] == pytest.approx(np.add(base["position"], arm))
    assert part["quaternion"] == pytest.approx(base["quaternion"])
    assert part["linear_velocity"] == pytest.approx(np.add(base["linear_velocity"], np.cross([0, 0, 2], arm)))
    assert momentum(place) == pytest.approx(before)
    assert part["angular_velocity"] == pytest.approx([0, 0, 2])
    work = place.world.motor_work()
    place("step", ticks=30)
    assert abs(place.senses()["j2.position"]) < 0.05 and place.world.motor_work() - work < 0.5, "nothing was flung"
    (event,) = place.events
    assert (event["layout"], event["lost_cubes"], event["lost_joints"]) == (5, [], [])


def momentum(place: Place) -> list[float]:
    """Returns the momentum of all cubes of a creature, kg m/s."""
    cubes = place.world.creature("s").cubes.values()
    infos = [place("get_cube_info", cube_name=name) for name in cubes]
    return [fsum(info["mass"] * info["linear_velocity"][at] for info in infos) for at in range(3)]


def test_what_grows_on_one_that_is_held_moves_with_it() -> None:
    place = Place(young("c3"), **FLOAT)
    place("freeze_cube", cube_name="s.c0", freeze=True)
    place("drive", creature="s", controls=[1, 1, 0])
    place("step", ticks=5)
    before = place.state("s.c1")
    place.grow("c3")
    assert place.state("s.c1") == before and np.linalg.norm(place.state("s.c3")["linear_velocity"]) > 0.01


def test_a_grown_part_is_driven_and_felt() -> None:
    place = Place(young("c3"), **FLOAT)
    place.grow("c3")
    place("drive", creature="s", controls=[0, 0, 1], layout=5)
    place("step", ticks=60)
    assert place.senses()["j2.position"] > 0.3


@pytest.mark.parametrize(
    ("part", "code"), [("c3", "cube_not_found"), ("c0", "invalid"), ("tail", "cube_not_found"), ("c2", "no_room")]
)
def test_what_cannot_grow_changes_nothing(part: str, code: str) -> None:
    place = Place(young("c2", "c3"), **FLOAT)
    place("spawn_cube", cube_name="wall", size=0.1, position=[0.72, 1.1, 0], is_base=True)
    before = place.world.snapshot(), place.world.digest()
    reply = place.grow(part)
    assert (reply["code"], reply["field"]) == (code, "part")
    assert (place.world.snapshot(), place.world.digest()) == before


def test_there_must_be_room_in_the_world_and_above_the_ground() -> None:
    place = Place(young("c3"), limits={"cubes": 3, "joints": 3}, **FLOAT)
    assert place.grow("c3")["code"] == "limit_reached"
    few = Place(young("c3"), limits={"cubes": 9, "joints": 2}, **FLOAT)
    before = few.world.digest()
    assert few.grow("c3")["code"] == "limit_reached"
    assert few.world.digest() == before and len(few.world.cubes()) == 3, "a part without its joint is none"
    deep = Place(young("c3"), **FLOAT)
    deep("set_cube_state", cube_name="s.c0", position=[0, 1, 0], rotation=[0, 0, -1.5])
    deep("set_cube_state", cube_name="s.c0", position=[0, 0.9, 0])
    assert deep.grow("c3")["code"] == "no_room"


def test_what_was_lost_grows_again_under_another_name_if_it_must() -> None:
    place = Place(snake(), **FLOAT)
    place("shed", creature="s", part="c3")
    assert place.grow("c3")["code"] == "no_room", "what was cut off is still there"
    place("set_cube_state", cube_name="s.c3", position=[5, 1, 0])
    assert place.grow("c3")["cube"] == "s.c3.2"
    creature = place.world.creature("s")
    assert creature.cubes["c3"] == "s.c3.2" and creature.joints["j2"] == "s.j2"
    assert creature.layout == 5
    other = place.again()
    assert other.world.creature("s").cubes == creature.cubes
    place("despawn_cube", cube_name="s.c3.2")
    assert place.world.creature("s").layout == 7


def test_a_cube_is_adopted_where_it_is_with_what_hangs_on_it() -> None:
    place = Place(snake(), **FLOAT)
    place("shed", creature="s", part="c2")
    place("set_cube_state", cube_name="s.c2", position=[0.8, 1.1, 0.1])
    before = place.state("s.c2")
    assert place("adopt", creature="s", part="c2", cube_name="s.c2")["layout"] == 9
    assert place.state("s.c2") == before
    creature = place.world.creature("s")
    assert list(creature.cubes) == ["c0", "c1", "c2", "c3"] and list(creature.joints) == ["j0", "j1", "j2"]
    place("step", ticks=20)
    assert abs(place.senses()["j1.position"]) < 0.05
    place("spawn_cube", cube_name="stick", position=[3, 1, 0])
    for cube, part in (("s.c1", "c2"), ("stick", "c2"), ("stick", "tail"), ("nothing", "c3")):
        digest = place.world.digest()
        assert place("adopt", creature="s", part=part, cube_name=cube)["type"] == "error"
        assert place.world.digest() == digest
    place("shed", creature="s", part="c3", remove=True)
    assert place("adopt", creature="s", part="c3", cube_name="stick")["cube"] == "stick"
    assert place.world.creature("s").cubes["c3"] == "stick"


def test_what_comes_along_with_a_cube_is_no_part_of_another() -> None:
    resize = {"when": "age > 0.5", "resize": [{"part": "c2", "scale": 0.5}]}
    place = Place({**snake(), "development": [resize]}, **FLOAT)
    watch = {"when": 'sense("c3.height") > 99', "shed": ["c3"]}
    sensors = [{"type": "height", "cube": "c3"}]
    other = {**snake(), "later": ["c3"], "sensors": sensors, "development": [watch]}
    place("spawn_creature", genome=other, name="o", position=[0, 1, 3])
    place("shed", creature="s", part="c2")
    assert place("adopt", creature="o", part="c3", cube_name="s.c3")["type"] == "part_grown"
    assert place("adopt", creature="s", part="c2", cube_name="s.c2")["type"] == "part_grown"
    assert list(place.world.creature("s").cubes) == ["c0", "c1", "c2"], "it is held, and yet no part"
    for name in ("s", "o"):
        place("drive", creature=name, controls=[0] * 3)
    place("step", ticks=60)
    assert place.world.fault is None
    assert place.world.creature("s").cubes["c2"] == "s.c2" and place.world.creature("o").cubes["c3"] == "s.c3"


def test_no_cube_becomes_two_parts() -> None:
    genome = snake()
    loop = {"type": "pin", "anchor": [0.72, 0.07, 0.2]}
    genome["body"]["joints"].append({"id": "loop", "cube1": "c1", "cube2": "c3", **loop})
    place = Place(genome, **FLOAT)
    for part in ("c3", "c2"):
        place("shed", creature="s", part=part)
    place("create_joint", joint_name="s.loop", joint_type="pin", cube1="s.c1", cube2="s.c3")
    place("adopt", creature="s", part="c2", cube_name="s.c3")
    assert place.world.creature("s").cubes == {"c0": "s.c0", "c1": "s.c1", "c2": "s.c3"}


PROGRAM: list[tuple[str, Json]] = [
    ("grow", {"part": "c2"}),
    ("grow", {"part": "c3"}),
    ("shed", {"part": "c3"}),
    ("adopt", {"part": "c3", "cube_name": "s.c3"}),
    ("shed", {"part": "c1", "remove": True}),
    ("grow", {"part": "c1"}),
]
# What grows is driven by a brain of the world, whose inputs and outputs are those of the whole body.
MINDFUL: Json = {"genome": young("c2", "c3", brain=mlp(4)), "autonomous": True, **FLOAT}


@pytest.mark.parametrize("backend", ["mujoco", "pymunk"])
def test_growth_with_a_brain_that_follows_replays(tmp_path: Path, backend: str) -> None:
    place = Place(recording=tmp_path / "a.mcap", backend=backend, keyframes=0.5, **MINDFUL)
    for kind, fields in PROGRAM:
        reply = place(kind, creature="s", **fields)
        assert reply["type"] in ("part_grown", "part_shed"), reply
        place("step", ticks=12)
    controls = place.world.creature("s").controls
    assert controls is not None and np.any(controls)
    place.world.close()
    assert place.recorder is not None
    place.recorder.close()
    assert replay(tmp_path / "a.mcap").verdict == "reproduced"


def test_growth_with_a_brain_that_follows_goes_on_from_wherever_it_was_saved() -> None:
    place = Place(**MINDFUL)
    for kind, fields in PROGRAM:
        place(kind, creature="s", **fields)
        copy = place.again()
        for each in (place, copy):
            each("step", ticks=12)
        assert copy.world.digest() == place.world.digest()


def test_a_keyframe_with_forged_growth_is_refused() -> None:
    place = Place(young("c3"), **FLOAT)
    place.grow("c3")
    state, engine = unpack(place.world.snapshot(), place.world.config)
    for forged in ({"count": 9, "cubes": {}, "joints": {}}, {"count": 2, "cubes": {"c3": "s.c0"}, "joints": {}}):
        creature = {**state["creatures"]["creatures"][0], "grown": forged}
        creatures = {**state["creatures"], "creatures": [creature]}
        bad = pack(place.world.config, {**state, "creatures": creatures}, engine)
        if forged["count"] == 2:
            with pytest.raises(WorldError, match="fit together"):
                World(place.world.config).restore(bad)
        else:
            other = World(place.world.config)
            other.restore(bad)
            assert other.digest() != place.world.digest(), "it is told from what it was made of"


@pytest.mark.parametrize(
    ("later", "path"), [(["c9"], "later/0"), (["c0"], "later/0"), (["c1"], "body/cubes/2"), (["c3", 3], "later/1")]
)
def test_parts_that_cannot_be_later_are_told(later: list[Any], path: str) -> None:
    with pytest.raises(DocumentError) as error:
        Genome({**snake(), "later": later})
    assert path in [where for where, _ in error.value.problems]
    assert Genome(young("c3")).hash != Genome(snake()).hash
