"""Creatures that develop: rules of their genomes grow, shed, adopt and resize their parts while they live."""

from __future__ import annotations

from math import fsum
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from creatures import SINE, snake
from nmes import World, protocol
from nmes.errors import WorldError
from nmes.genome import Genome
from nmes.genome.development import hanging, resized
from nmes.playback import replay
from nmes.recording import Recorder
from nmes.world.snapshot import pack, unpack

Json = dict[str, Any]
FLOAT: Json = {"gravity": [0, 0, 0]}


def rules(*development: Json, later: tuple[str, ...] = (), **changes: Any) -> Json:
    """Returns a snake that develops by some rules."""
    return {**snake(**changes), "later": list(later), "development": list(development)}


class Place:
    """A world in lockstep with one creature, `s`, and a client who hears of it."""

    def __init__(self, genome: Json, recording: Path | None = None, autonomous: bool = False, **config: Any) -> None:
        self.world = World({"mode": "lockstep", "seed": 4, **config})
        self.recorder = None if recording is None else Recorder(recording, self.world)
        self.world.journal = self.recorder
        self.events: list[Json] = []
        self.world.emit = lambda _, event: self.events.append(protocol.decode(event))
        self.client = self.world.join()
        self("subscribe", events=["creatures"])
        self("spawn_creature", genome=genome, name="s", position=[0, 1, 0], autonomous=autonomous)

    def __call__(self, kind: str, **fields: Any) -> Json:
        reply = self.world.execute(self.client, {"type": kind, **fields})
        protocol.validate_reply(reply)
        assert reply["type"] != "error", reply
        return reply

    def motion(self) -> tuple[float, list[float]]:
        """Returns the mass and the momentum of all cubes of the creature, kg and kg m/s."""
        names = self.world.creature("s").cubes.values()
        infos = [self("get_cube_info", cube_name=name) for name in names]
        momentum = [fsum(info["mass"] * info["linear_velocity"][at] for info in infos) for at in range(3)]
        return fsum(info["mass"] for info in infos), momentum

    def drive(self) -> None:
        creature = self.world.creature("s")
        self("drive", creature="s", controls=[0.0] * len(creature.body.outputs))

    def live(self, seconds: float) -> list[Json]:
        """Lets time pass; returns the events of it."""
        before = len(self.events)
        self("step", ticks=round(seconds * 60))
        assert self.world.fault is None
        for event in self.events[before:]:
            protocol.validate_event(event)
        return self.events[before:]

    @property
    def parts(self) -> list[str]:
        return list(self.world.creature("s").cubes)

    def state(self, part: str) -> Json:
        return self("get_cube_state", cube_name=self.world.creature("s").cubes[part])


def test_a_part_grows_at_an_age_that_begins_with_the_first_drive() -> None:
    place = Place(rules({"when": "age >= 0.5", "grow": ["c3"]}, later=("c3",)), **FLOAT)
    assert place.live(2) == []
    place.drive()
    assert place.live(0.4) == []
    (event,) = place.live(0.2)
    assert event["layout"] == 5 and event["lost_cubes"] == [] and event["stage"] == 1 and "refused" not in event
    assert event["frame"] == 120 + 30 and place.parts == ["c0", "c1", "c2", "c3"]
    assert place.live(3) == []


def test_a_rule_that_is_of_use_no_more_is_not_followed() -> None:
    regrow = {"when": 'has("c3") < 1', "grow": ["c3"], "every": 0.5, "times": 2}
    place = Place(rules(regrow), **FLOAT)
    place.drive()
    grown = []
    for _ in range(3):
        place("shed", creature="s", part="c3", remove=True)
        grown.append([event["lost_cubes"] for event in place.live(1)])
    assert grown == [[["c3"], []], [["c3"], []], [["c3"]]]


def test_stages_follow_each_other() -> None:
    place = Place(
        rules(
            {"when": "age > 1", "stage": 1, "shed": ["c3"], "enter": 2},
            {"when": "true", "stage": 2, "adopt": ["c3"], "enter": 3},
            {"when": "stage == 2", "shed": ["c1"]},
            {"when": "age > 2", "stage": 3, "enter": 4},
        ),
        **FLOAT,
    )
    place.drive()
    events = place.live(3)
    assert [(event["stage"], event["lost_cubes"]) for event in events] == [(3, []), (4, [])]
    assert len(place.world.cubes()) == 4


def test_conditions_are_about_senses_parts_mass_and_count() -> None:
    mass = sum(cube["mass"] for cube in snake()["body"]["cubes"])
    place = Place(
        rules(
            {"when": 'sense("c0.height") > 3', "shed": ["c3"]},
            {"when": f'cubes == 4 && abs(mass - {mass}) < 0.001 && has("c2") == 1', "enter": 2},
            {"when": "energy > 0", "enter": 9},
        ),
        **FLOAT,
    )
    place.drive()
    assert [event["stage"] for event in place.live(1)] == [2]
    place("set_cube_state", cube_name="s.c0", position=[0, 4, 0])
    assert [event["lost_cubes"] for event in place.live(0.2)] == [["c3"]]


def test_an_adopted_cube_has_the_mass_that_it_has() -> None:
    place = Place(rules({"when": "mass > 900", "shed": ["c3"]}), **FLOAT)
    place.drive()
    place("shed", creature="s", part="c3", remove=True)
    x, y, z = place.state("c2")["position"]
    for name, mass in (("light", 500), ("heavy", 1000)):
        place("spawn_cube", cube_name=name, position=[x + 0.4, y, z], size=0.2, mass=mass)
        place("adopt", creature="s", part="c3", cube_name=name)
        place.live(0.2)
        assert ("c3" in place.parts) == (name == "light")
        if name == "light":
            place("shed", creature="s", part="c3", remove=True)


def test_what_there_is_no_room_for_is_told_and_tried_again() -> None:
    place = Place(rules({"when": "true", "grow": ["c3"], "every": 0.5}, later=("c3",)), **FLOAT)
    x, y, z = place.state("c2")["position"]
    place("spawn_cube", cube_name="wall", position=[x + 0.35, y, z], size=0.3, frozen=True)
    place.drive()
    events = place.live(1.2)
    assert [event["frame"] for event in events] == [6, 36, 66]
    assert all(event["refused"] == [{"rule": 0, "part": "c3", "code": "no_room"}] for event in events)
    place("despawn_cube", cube_name="wall")
    (event,) = place.live(1)
    assert "refused" not in event and "c3" in place.parts


def test_a_lost_part_is_joined_again_where_it_lies_near() -> None:
    place = Place(rules({"when": "age > 1", "adopt": ["c3"], "times": 9}), **FLOAT)
    place.drive()
    place("shed", creature="s", part="c3")
    x, y, z = place.state("c2")["position"]
    place("set_cube_state", cube_name="s.c3", position=[x + 2, y, z])
    assert place.live(2)[1:] == []  # it is out of reach
    place("set_cube_state", cube_name="s.c3", position=[x + 0.4, y, z])
    (event,) = place.live(0.2)
    assert event["lost_cubes"] == [] and place.world.creature("s").cubes["c3"] == "s.c3"


def test_it_takes_up_nothing_that_is_not_its_own_or_is_a_part_of_another() -> None:
    place = Place(rules({"when": "age > 1", "adopt": ["c3"]}), **FLOAT)
    place.drive()
    place("shed", creature="s", part="c3", remove=True)
    x, y, z = place.state("c2")["position"]
    place("spawn_cube", cube_name="s.c3x", position=[x + 0.36, y, z], size=[0.3, 0.2, 0.2], mass=1)
    assert place.live(2)[1:] == []


@pytest.mark.parametrize("name", ["7", "s.c3.x", "s.c37", "c3"])
def test_it_takes_up_no_cube_that_is_called_otherwise_than_its_part(name: str) -> None:
    place = Place(rules({"when": "age > 1", "adopt": ["c3"]}), **FLOAT)
    place.drive()
    place("shed", creature="s", part="c3", remove=True)
    x, y, z = place.state("c2")["position"]
    place("spawn_cube", cube_name=name, position=[x + 0.36, y, z], size=[0.26, 0.14, 0.26], mass=0.5)
    assert place.live(2)[1:] == [] and "c3" not in place.parts


def test_it_takes_up_no_other_part_whose_name_is_its_own_with_a_number() -> None:
    genome = rules({"when": "age > 1", "adopt": ["c2"]})
    genome["body"]["cubes"][3]["id"] = genome["body"]["joints"][2]["cube2"] = "c2.2"
    place = Place(genome, **FLOAT)
    place.drive()
    x, y, z = place.state("c2")["position"]
    place("shed", creature="s", part="c2.2")
    place("shed", creature="s", part="c2", remove=True)
    place("set_cube_state", cube_name="s.c2.2", position=[x, y, z])
    assert place.live(2)[1:] == [] and "c2" not in place.parts


def test_it_takes_up_nothing_that_another_player_made() -> None:
    place = Place(rules({"when": "age > 1", "adopt": ["c3"]}), roles={"player": {}}, **FLOAT)
    place.drive()
    place("shed", creature="s", part="c3", remove=True)
    x, y, z = place.state("c2")["position"]
    stick = {"cube_name": "s.c3", "position": [x + 0.36, y, z], "size": [0.26, 0.14, 0.26], "mass": 0.5}
    stranger = place.world.join("player", None)
    assert place.world.execute(stranger, {"type": "spawn_cube", **stick})["spawned"] == "s.c3"
    assert place.live(2)[1:] == [] and "c3" not in place.parts
    place("give", cube_name="s.c3", player=1)
    assert [event["lost_cubes"] for event in place.live(1)] == [[]]


def test_it_takes_up_its_own_part_where_that_hangs_on_one_that_another_player_made() -> None:
    place = Place(rules({"when": "age > 1", "adopt": ["c3"]}), roles={"player": {}}, **FLOAT)
    place.drive()
    x, y, z = place.state("c2")["position"]
    place("shed", creature="s", part="c3")
    place("shed", creature="s", part="c2", remove=True)
    stranger = place.world.join("player", None)
    place.world.execute(stranger, {"type": "spawn_cube", "cube_name": "theirs", "position": [x, y, z], "size": 0.2})
    place("adopt", creature="s", part="c2", cube_name="theirs")
    assert place.state("c2")["position"] == [x, y, z] and place.world.entities.cube("theirs").player == 2
    assert [event["lost_cubes"] for event in place.live(2)][-1:] == [[]]
    assert place.world.creature("s").cubes["c3"] == "s.c3"


def test_a_part_of_another_size_is_as_dense_and_carries_what_hangs_on_it() -> None:
    place = Place(rules({"when": "age > 0.5", "resize": [{"part": "c1", "scale": 1.5}]}), **FLOAT)
    place("set_cube_state", cube_name="s.c0", rotation=[0.3, 0.8, -0.4], linear_velocity=[1, 2, 3])
    place.drive()
    before = [place.state(part) for part in ("c0", "c1", "c2", "c3")]
    (event,) = place.live(0.6)
    assert event["lost_cubes"] == [] and event["layout"] > 1
    cubes = {part: place.world.entities.cube(place.world.creature("s").cubes[part]) for part in ("c1", "c2")}
    was = snake()["body"]["cubes"]
    assert cubes["c1"].size == pytest.approx(np.multiply(was[1]["size"], 1.5))
    assert cubes["c1"].mass == pytest.approx(was[1]["mass"] * 1.5**3) and cubes["c2"].mass == was[2]["mass"]
    after = [place.state(part) for part in ("c0", "c1", "c2", "c3")]
    far = [np.linalg.norm(np.subtract(states[3]["position"], states[0]["position"])) for states in (before, after)]
    assert far[1] - far[0] == pytest.approx(0.36 * 0.5)  # from one joint to the other
    assert place.live(1) == []


@pytest.mark.parametrize(("scale", "kept"), [(1.5, 1.0), (0.5, 0.78125)])
def test_a_part_of_another_size_brings_no_momentum_and_takes_only_that_of_what_is_gone(
    scale: float, kept: float
) -> None:
    place = Place(rules({"when": "age > 0.5", "resize": [{"part": "c1", "scale": scale}]}), **FLOAT)
    place("set_cube_state", cube_name="s.c0", linear_velocity=[1, 2, 3])
    place.drive()
    mass, momentum = place.motion()
    (event,) = place.live(0.6)
    assert event["lost_cubes"] == []
    more, after = place.motion()
    assert more == pytest.approx(mass + 0.5 * (scale**3 - 1)) and min(more / mass, 1.0) == kept
    assert after == pytest.approx([each * kept for each in momentum])


def test_a_part_that_has_no_room_to_be_larger_stays_as_it_is() -> None:
    place = Place(rules({"when": "age > 0.5", "resize": [{"part": "c1", "scale": 4}]}))
    place.drive()
    place.live(0.5)
    digest = place.world.creature("s").present
    (event,) = place.live(0.2)
    assert event["refused"] == [{"rule": 0, "part": "c1", "code": "no_room"}]
    assert place.world.creature("s").present == digest and event["layout"] == 1


LIFE: Json = rules(
    {"when": "age > 0.5", "grow": ["c2", "c3"]},
    {"when": "age > 1", "stage": 1, "shed": ["c1"], "enter": 2},
    {"when": "stage == 2 && age > 1.5", "adopt": ["c1"], "times": 3},
    {"when": 'has("c1") < 1 && age > 2', "grow": ["c1", "c2"], "times": 5},
    {"when": "age > 3", "resize": [{"part": "c1", "scale": 0.5}, {"part": "c2", "scale": 1.25}]},
    later=("c2", "c3"),
    brain=SINE,
)


@pytest.mark.parametrize("backend", ["mujoco", "pymunk"])
def test_a_life_replays(tmp_path: Path, backend: str) -> None:
    place = Place(LIFE, tmp_path / "life.mcap", autonomous=True, backend=backend, keyframes=0, gravity=[0, -1, 0])
    events = place.live(5)
    assert {event["stage"] for event in events} == {1, 2} and len(events) > 3
    place.world.close()
    assert place.recorder is not None
    place.recorder.close()
    report = replay(tmp_path / "life.mcap")
    assert report.verdict == "reproduced", report.divergence


@given(ticks=st.integers(1, 280))
def test_a_life_goes_on_from_anywhere(ticks: int) -> None:
    one = World({"mode": "lockstep", "seed": 4, "gravity": [0, -1, 0]})
    client = one.join()
    spawn = {"type": "spawn_creature", "genome": LIFE, "name": "s", "position": [0, 1, 0], "autonomous": True}
    one.execute(client, spawn)
    for _ in range(ticks):
        one.tick()
    other = World(one.config)
    other.restore(one.snapshot())
    while one.frame < 290:
        one.tick()
        other.tick()
        assert one.digest() == other.digest(), one.frame
    assert one.fault is None
    assert [*one.creature("s").cubes] == [*other.creature("s").cubes]
    one.close()
    other.close()


def test_whether_it_was_driven_yet_is_saved_too() -> None:
    place = Place(rules({"when": "age > 0.2", "shed": ["c3"]}), **FLOAT)
    place.drive()
    other = World(place.world.config)
    other.restore(place.world.snapshot())
    for _ in range(30):
        other.tick()
    assert "c3" not in other.creature("s").cubes


@pytest.mark.parametrize(
    "change",
    [
        {"scales": {"c1": 3.0}},
        {"scales": {"c9": 1.5}},
        {"uses": []},
        {"waits": [0, 0]},
    ],
)
def test_a_snapshot_of_another_development_is_refused(change: Json) -> None:
    place = Place(rules({"when": "age > 9", "resize": [{"part": "c1", "scale": 1.5}]}), **FLOAT)
    place.drive()
    place.live(1)
    state, engine = unpack(place.world.snapshot(), place.world.config)
    state["creatures"]["creatures"][0]["development"] |= change
    with pytest.raises(WorldError, match=r"development|no world would save"):
        World(place.world.config).restore(pack(place.world.config, state, engine))


def test_in_an_ecosystem_energy_counts_and_what_is_shed_is_gone() -> None:
    genome = rules({"when": "energy < 1950", "shed": ["c3"]})
    life = {
        "food": {"places": [{"position": [0, 0], "radius": 9}]},
        "cost": "20",
        "birth": {"start": 2000, "energy": 1e6},
        "population": {"start": 3, "most": 3},
        "genomes": [genome],
    }
    world = World({"mode": "lockstep", "seed": 4, "tick_rate": 20, "life": life})
    for _ in range(100):
        world.tick()
        assert world.fault is None, world.fault
    creatures = [world.creature(name) for name in world.creatures()]
    assert len(creatures) == 3 and all("c3" not in creature.cubes for creature in creatures)
    owned = {name for creature in creatures for name in creature.cubes.values()}
    assert owned == {*world.cubes()}


# -- what a document may say ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rule", "place", "words"),
    [
        ({"when": "age > 1"}, "development/0", "it does nothing; expected shed, adopt, grow, resize or enter"),
        ({"when": "age > 1", "grow": ["c33"]}, "development/0/grow/0", "there is no cube 'c33'; did you mean"),
        ({"when": "age > 1", "shed": ["c0"]}, "development/0/shed/0", "'c0' is the root, on which all others hang"),
        ({"when": "ago > 1", "enter": 2}, "development/0/when", "did you mean age?"),
        ({"when": "age", "enter": 2}, "development/0/when", "it must give true or false, but gives a number"),
        ({"when": 'sense("c0.hight") > 1', "enter": 2}, "development/0/when", "did you mean c0.height?"),
        ({"when": "height > 1", "enter": 2}, "development/0/when", "there is no quantity 'height'"),
        ({"when": "true", "enter": 17}, "development/0/enter", "expected a whole number from 1 to 16"),
        ({"when": "true", "resize": [{"part": "c1", "scale": 9}]}, "development/0/resize/0/scale", "expected a number"),
        ({"when": "true", "grow": ["c1"] * 2}, "development/0/grow", "different"),
        ({"when": "true", "grow": ["c1"], "until": 3}, "development/0/until", "there is no such field"),
    ],
)
def test_rules_are_judged_with_their_places(rule: Json, place: str, words: str) -> None:
    problems = dict(Genome.problems(rules(rule)))
    assert list(problems) == [place]
    assert words in problems[place]


def test_parts_of_a_body_with_loops_keep_their_size() -> None:
    genome = rules({"when": "true", "resize": [{"part": "c1", "scale": 2}]})
    genome["body"]["joints"].append({"id": "loop", "cube1": "c0", "cube2": "c2", "type": "fixed", "anchor": [0, 1, 0]})
    assert dict(Genome.problems(genome)) == {
        "development/0/resize": "only in a body without loops a part can come to be of another size"
    }


@given(st.dictionaries(st.sampled_from(["c1", "c2", "c3"]), st.floats(0.25, 4.0)))
def test_a_resized_body_hangs_together_as_before(scales: dict[str, float]) -> None:
    body = Genome(snake()).body
    other = resized(body, scales)
    before, after = hanging(body), hanging(other)
    for cube, was in zip(other.cubes, body.cubes, strict=True):
        scale = scales.get(cube.id, 1.0)
        assert cube.size == pytest.approx(tuple(edge * scale for edge in was.size))
        assert cube.mass / cube.volume == pytest.approx(was.mass / was.volume)
        if cube.id in before:  # it touches its joint at the same place of its own
            arm = np.subtract(was.position, before[cube.id].anchor)
            assert np.subtract(cube.position, after[cube.id].anchor) == pytest.approx(arm * scale)
        for joint, old in zip(other.joints, body.joints, strict=True):
            if cube.id == joint.cube1:  # and so does what hangs on it
                arm = np.subtract(old.anchor, was.position)
                assert np.subtract(joint.anchor, cube.position) == pytest.approx(arm * scale)


def test_the_digest_is_of_development_too() -> None:
    place = Place(rules({"when": "age > 9", "shed": ["c3"]}), **FLOAT)
    place.drive()
    place.live(1)
    state, engine = unpack(place.world.snapshot(), place.world.config)
    state["creatures"]["creatures"][0]["development"]["age"] += 1
    older = World(place.world.config)
    older.restore(pack(place.world.config, state, engine))
    assert older.digest() != place.world.digest()
