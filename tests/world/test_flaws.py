"""Flaws of sensors and motors: noise, delays and failures, their laws, and that they repeat."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Callable
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nmes import World
from nmes.errors import WorldError
from nmes.evaluation import Evaluator, Task, evaluate
from nmes.genome import Genome
from nmes.playback import replay
from nmes.recording import Recorder

Document = dict[str, Any]
TICKS = 600


def arm(sensors: Document | None = None, motors: Document | None = None, **changes: Any) -> Document:
    """A body on the ground with an arm that a strong servo turns, and sensors of the arm and of the root."""
    cubes = [
        {"id": "root", "size": [0.4, 0.4, 0.4], "mass": 10, "position": [0, 0.2, 0]},
        {"id": "arm", "size": [0.4, 0.05, 0.05], "mass": 0.1, "position": [0, 0.6, 0]},
    ]
    motor = {"mode": "position", "range": [-1, 1], "max_effort": 50, **({} if motors is None else {"flaws": motors})}
    joint = {"id": "hip", "cube1": "root", "cube2": "arm", "type": "hinge", "anchor": [0, 0.6, 0], "axis": [0, 1, 0]}
    readings = [{"type": "position", "joint": "hip"}, {"type": "height", "cube": "root"}]
    flawed = [{**reading, **({} if sensors is None else {"flaws": sensors})} for reading in readings]
    body = {"cubes": cubes, "joints": [{**joint, "motor": motor}]}
    return {"format": "nmes-genome/1", "name": "arm", "body": body, "sensors": flawed, **changes}


class Place:
    """A world in lockstep and one client in it."""

    def __init__(self, **config: Any) -> None:
        self.world = World({"mode": "lockstep", "tick_rate": 20, **config})
        self.client = self.world.join()

    def __call__(self, kind: str, **fields: Any) -> Document:
        reply = self.world.execute(self.client, {"type": kind, **fields})
        assert reply["type"] != "error", reply
        return reply

    def spawn(self, genome: Document, name: str = "me", **fields: Any) -> None:
        self("spawn_creature", genome=genome, name=name, **fields)

    def sense(self, name: str = "me") -> list[float]:
        values: list[float] = self.world.creature(name).sense().tolist()
        assert values == self("sense", creature=name)["values"]
        return values

    def sensed(self, ticks: int) -> list[list[float]]:
        """Ticks, and returns what is sensed before each tick."""
        values = []
        for _ in range(ticks):
            values.append(self.sense())
            self("step")
        return values

    def target(self) -> float:
        """Returns where the servo aims."""
        params: Document = self("get_joint_info", joint_name="me.hip")["params"]
        return float(params["target_position"])


def heights(ticks: int, flaws: Document | None, **config: Any) -> np.ndarray[Any, Any]:
    place = Place(**config)
    place.spawn(arm(flaws))
    return np.array(place.sensed(ticks))[:, 1]


def test_noise_has_the_spread_that_is_asked_for() -> None:
    values = heights(TICKS, {"noise": 0.25}) - heights(TICKS, None)
    assert abs(values.mean()) < 4 * 0.25 / math.sqrt(TICKS)
    assert values.std() == pytest.approx(0.25, rel=0.1)
    beyond = [np.mean(np.abs(values) > 0.25 * spreads) for spreads in (1, 2, 3)]
    assert beyond == pytest.approx([0.317, 0.0455, 0.0027], abs=0.04)  # of a normal distribution
    assert abs(np.corrcoef(values[1:], values[:-1])[0, 1]) < 4 / math.sqrt(TICKS)  # each tick's is its own


def philox(counter: list[int], key: list[int]) -> list[int]:
    """Returns four words of Philox 4x64-10, as Salmon et al. (2011) write it."""
    word = 2**64 - 1
    for _ in range(10):
        one, two = counter[0] * 0xD2E7470EE14C6C93, counter[2] * 0xCA5A826395121157
        counter = [(two >> 64) ^ counter[1] ^ key[0], two & word, (one >> 64) ^ counter[3] ^ key[1], one & word]
        key = [(key[0] + 0x9E3779B97F4A7C15) & word, (key[1] + 0xBB67AE8584CAA73B) & word]
    return counter


def test_noise_is_twelve_even_draws_of_a_generator_that_counts_ticks() -> None:
    place, bare = Place(seed=7), Place(seed=7)
    place.spawn(arm({"noise": 1.0}))
    bare.spawn(arm())
    root = place.world.entities.cube("me.root").body
    digest = blake2b(f"7:{root}:flaws".encode(), digest_size=16).digest()
    key = [int.from_bytes(digest[:8], "little"), int.from_bytes(digest[8:], "little")]
    for tick in range(3):
        for number, (noisy, true) in enumerate(zip(place.sense(), bare.sense(), strict=True)):
            words = philox([number + 1, tick, 0, 0], key)  # numpy counts before it draws
            draws = [(words[place // 4] >> 16 * (place % 4) & 0xFFFF) + 0.5 for place in range(12)]
            assert noisy == true + (sum(draws) / 65536 - 6)
        place("step")
        bare("step")


def test_noise_is_asked_for_as_often_as_one_likes() -> None:
    place = Place()
    place.spawn(arm({"noise": 1.0}))
    assert place.sense() == place.sense() and place.sense()[0] != place.sense()[1]


def test_a_sensor_that_drops_out_reads_nothing_as_often_as_it_says() -> None:
    values = heights(TICKS, {"drop_out": 0.3})
    assert set(values == 0.0) == {True, False}
    assert np.mean(values == 0.0) == pytest.approx(0.3, abs=4 * math.sqrt(0.3 * 0.7 / TICKS))
    assert (values[values != 0.0] > 0.19).all()


@pytest.mark.parametrize("delay", [1, 3, 64])
def test_a_delayed_sensor_reads_what_was(delay: int) -> None:
    courses = []
    for flaws in (None, {"delay": delay}):
        place = Place()
        place.spawn(arm(flaws), position=[0, 2, 0])
        courses.append(place.sensed(delay + 20))
    now, late = courses
    assert late[delay:] == now[:20]
    assert late[:delay] == [now[0]] * delay  # as long ago as is known
    assert now[1] != now[0]


def test_a_delayed_motor_does_what_it_was_told_before() -> None:
    place = Place()
    place.spawn(arm(None, {"delay": 2}))
    aimed = []
    for control in (0.5, -0.5, 0.25, 0.75):
        place("drive", creature="me", controls=[control])
        place("step")
        aimed.append(place.target())
    assert aimed == [0, 0, 0.5, -0.5]
    place("step", ticks=2)
    assert place.target() == 0.75


def test_a_noisy_motor_errs_anew_in_each_tick_and_stays_in_its_range() -> None:
    place = Place()
    place.spawn(arm(None, {"noise": 0.4}))
    place("step")
    assert place.target() == 0  # nobody has driven it yet
    place("drive", creature="me", controls=[0.5])
    aimed = []
    for _ in range(200):
        place("step")
        aimed.append(place.target())
    assert max(aimed) == 1.0 and len(set(aimed)) > 150
    inside = [value for value in aimed if value < 1.0]
    assert np.median(aimed) == pytest.approx(0.5, abs=0.08) and min(inside) > -1.0


def test_a_motor_that_drops_out_goes_on_as_it_was() -> None:
    place = Place()
    place.spawn(arm(None, {"drop_out": 0.4}))
    kept, before = 0, 0.0
    for tick in range(200):
        control = math.sin(tick)
        place("drive", creature="me", controls=[control])
        place("step")
        now = place.target()
        assert now in (before, pytest.approx(control, abs=1e-12))
        kept, before = kept + (now == before), now
    assert kept / 200 == pytest.approx(0.4, abs=4 * math.sqrt(0.4 * 0.6 / 200))


def test_what_is_drawn_is_another_for_each_seed_creature_and_sensor() -> None:
    place, other = Place(seed=1), Place(seed=2)
    for name, x in (("me", 0.0), ("you", 9.0)):
        place.spawn(arm({"noise": 1.0}), name, position=[x, 0, 0])
    other.spawn(arm({"noise": 1.0}))
    values = [*place.sense(), *place.sense("you"), *other.sense()]
    assert len(set(values)) == 6


def test_a_motor_does_not_err_as_a_sensor_does() -> None:
    place = Place()
    place.spawn(arm({"noise": 0.1}, {"noise": 0.1}))
    place("drive", creature="me", controls=[0])
    felt = place.sense()[0]  # of an arm that has not turned
    place("step")
    assert felt != 0 and place.target() not in (0, pytest.approx(felt))


def test_all_sensors_and_motors_may_be_flawed_and_the_worse_counts() -> None:
    place = Place()
    flaws = {"sensors": {"delay": 1}, "motors": {"delay": 3}}
    place.spawn(arm({"delay": 2}, {"delay": 2}), position=[0, 3, 0], flaws=flaws)
    bare = Place()
    bare.spawn(arm(), position=[0, 3, 0])
    assert place.sensed(6)[5] == bare.sensed(6)[3]  # the genome's two ticks
    place("drive", creature="me", controls=[1])
    aimed = []
    for _ in range(4):
        place("step")
        aimed.append(place.target())
    assert aimed == [0, 0, 0, 1]  # the three of all


FLAWS = {"noise": 0.1, "delay": 5, "drop_out": 0.2}


def run(place: Place, ticks: int) -> list[Any]:
    """Drives and ticks, and returns what was sensed and the digest after each tick."""
    course: list[Any] = []
    for tick in range(ticks):
        if tick % 3 == 0:
            place("drive", creature="me", controls=[math.cos(tick)])
        place("step")
        course.append((place.sense(), place.world.digest()))
    return course


@pytest.mark.parametrize("before", [0, 1, 2, 7])
def test_a_restored_world_errs_as_the_first_would(before: int) -> None:
    config = {"seed": 5}
    place, again = Place(**config), Place(**config)
    place.spawn(arm(FLAWS, FLAWS), flaws={"sensors": {"delay": 6}})
    run(place, before)
    again.world.restore(place.world.snapshot())
    again.client = max(again.world._clients)
    assert run(again, 12) == run(place, 12)


def test_a_sensor_of_what_is_lost_reads_nothing_and_no_noise() -> None:
    place = Place()
    place.spawn(arm({"noise": 1.0, "delay": 2}, FLAWS))
    run(place, 5)
    assert 0 not in place.sense()
    place("remove_joint", joint_name="me.hip")
    place("step")
    lost, kept = place.sense()
    assert lost == 0 != kept
    place("drive", creature="me", controls=[1])
    place("step", ticks=3)
    assert place.sense()[0] == 0 and place.world.fault is None


FORGED: dict[str, Callable[[Document], object]] = {
    "an age beyond all": lambda creature: creature["disturbance"].update(age=10**30),
    "more ticks than a delay holds back": lambda creature: creature["disturbance"].update(
        sensors=base64.b64encode(np.zeros(2 * 7).tobytes()).decode()
    ),
    "what is no number": lambda creature: creature["disturbance"].update(
        motors=base64.b64encode(np.full(5, np.nan).tobytes()).decode()
    ),
    "a control beyond its range": lambda creature: creature["disturbance"].update(
        driven=base64.b64encode(np.array([2.0, 0.0]).tobytes()).decode()
    ),
    "nothing that is remembered": lambda creature: creature.pop("disturbance"),
    "flaws that it has not": lambda creature: creature.update(flaws={"sensors": {"delay": 3}}),
}


@pytest.mark.parametrize("what", FORGED)
def test_a_snapshot_with_forged_flaws_is_refused(what: str) -> None:
    place = Place()
    place.spawn(arm(FLAWS, FLAWS), flaws={"sensors": {"delay": 6}})
    run(place, 9)
    snapshot = place.world.snapshot()
    line, _, engine = snapshot.partition(b"\n")
    state = json.loads(line)
    FORGED[what](state["creatures"]["creatures"][0])
    again = World({"mode": "lockstep", "tick_rate": 20})
    with pytest.raises(WorldError) as caught:
        again.restore(json.dumps(state).encode() + b"\n" + engine)
    assert caught.value.code == "bad_snapshot"
    again.restore(snapshot)
    assert again.snapshot() == snapshot


def test_what_a_delay_holds_back_is_in_the_digest() -> None:
    digests = []
    for control in (0.5, -0.5):
        place = Place()
        place.spawn(arm(None, {"delay": 4}))
        place("drive", creature="me", controls=[control])
        place("step")
        digests.append(place.world.digest())
    assert digests[0] != digests[1]


def test_a_recording_of_flaws_replays(tmp_path: Path) -> None:
    path = tmp_path / "flaws.mcap"
    place = Place(keyframes=0.5)
    place.world.journal = recorder = Recorder(path, place.world)
    place.spawn(arm(FLAWS, FLAWS))
    run(place, 40)
    recorder.close()
    assert replay(path).verdict == "reproduced"


def task(**fields: Any) -> Task:
    document = {"format": "nmes-task/1", "name": "flawed", "description": "Turn.", "duration": 2, "seeds": [1, 2]}
    return Task({**document, "world": {"tick_rate": 20}, "objective": "energy", **fields})


def reflex(gain: float, **parts: Document) -> Genome:
    """Returns an arm that follows its own angle, so that each error shows in what it does."""
    nodes, links = [{"id": "n", "motor": "hip", "bias": 0.5}], [{"sensor": "hip.position", "to": "n", "weight": gain}]
    return Genome(arm(**parts, brain={"kind": "graph", "nodes": nodes, "links": links}))


@pytest.mark.parametrize("where", ["genome", "task"])
def test_flawed_creatures_fare_in_a_population_as_alone(where: str) -> None:
    parts = {"sensors": FLAWS, "motors": FLAWS}
    asked = task(flaws=parts) if where == "task" else task()
    genomes = [reflex(gain, **(parts if where == "genome" else {})) for gain in (-2.0, -1.0, 0.5, 1.0, 2.0, 3.0)]
    alone = [[result.score for result in evaluate(genome, asked).results] for genome in genomes]
    with Evaluator(jobs=1) as evaluator:
        rows = evaluator.evaluate_population(genomes, asked)
    together = [[result.score for result in evaluation.results] for evaluation in rows]
    assert together == alone
    sound = [[result.score for result in evaluate(reflex(gain), task()).results] for gain in (-2.0, -1.0)]
    assert all(flawed[seed] != whole[seed] for flawed, whole in zip(alone, sound, strict=False) for seed in (0, 1))
    assert alone[0][0] != alone[0][1]  # seeds err differently


def test_a_task_without_flaws_has_the_hash_that_it_had() -> None:
    assert task().hash == task().hash != task(flaws={"motors": {"noise": 0.1}}).hash
    assert "flaws" not in task().document
