"""Ecosystems: food grows and is eaten, creatures pay, starve and breed; recorded, restored and replayed bit for bit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from ecosystems import cart, config, of, run, watched
from nmes import World
from nmes.errors import RejectedMessage, WorldError
from nmes.genome import Genome
from nmes.playback import replay
from nmes.recording import Kind, Recorder, Recording
from nmes.schemas import load
from nmes.variation import Draw, mutate
from nmes.variation.distance import distance
from nmes.world.snapshot import pack, unpack

Json = dict[str, Any]
STILL = {"food": {"start": 0, "rate": 0}, "cost": "0", "population": {"start": 1}, "species": 0.1}


def living(world: World, client: int) -> list[Json]:
    creatures: list[Json] = world.execute(client, {"type": "get_life"})["living"]
    return creatures


# -- food -------------------------------------------------------------------------------------------------------------


def test_food_grows_where_and_as_often_as_the_config_says() -> None:
    places = [{"position": [10, -4], "radius": 2}]
    food = {"places": places, "start": 7, "rate": 2.5, "most": 20, "energy": 11}
    world, client, _ = watched(config(food=food, population={"start": 0}))
    counts = []
    for _ in range(6):
        counts.append(len(world.execute(client, {"type": "get_life"})["food"]))
        run(world, 20)
    assert counts == [0, 9, 12, 14, 17, 19]
    run(world, 40)
    items = world.execute(client, {"type": "get_life"})["food"]
    assert len(items) == 20 and {item["energy"] for item in items} == {11}
    far = [(item["position"][0] - 10) ** 2 + (item["position"][2] + 4) ** 2 for item in items]
    assert max(far) <= 4.0 and min(far) < 1.5 < max(far) and {item["position"][1] for item in items} == {0.0}


def test_a_creature_eats_what_its_first_cube_reaches_and_no_more() -> None:
    world, client, events = watched(config(**STILL, genomes=[cart(forward=0.0)]))
    run(world, 1)
    name = of(events, "creature_born")[0]["creature"]
    x, _, z = world.execute(client, {"type": "get_cube_state", "cube_name": f"{name}.trunk"})["position"]
    before = living(world, client)[0]["energy"]
    for dx in (0.3, 1.2):
        reply = world.execute(client, {"type": "feed", "position": [x + dx, 5, z], "energy": 40})
        assert reply["type"] == "fed"
    run(world, 1)
    (meal,) = of(events, "food_eaten")
    assert (meal["creature"], meal["energy"], meal["position"]) == (name, 40, [x + 0.3, 0.0, z])
    assert living(world, client)[0]["energy"] == before + 40 and living(world, client)[0]["meals"] == 1
    assert len(world.execute(client, {"type": "get_life"})["food"]) == 1


def test_creatures_sense_the_nearest_food_in_the_directions_of_the_cube() -> None:
    world, client, _ = watched(config(**STILL))
    genome = cart() | {"sensors": [{"type": kind, "cube": "trunk"} for kind in ("food_direction", "food_distance")]}
    genome.pop("brain")
    world.execute(client, {"type": "spawn_creature", "name": "it", "genome": genome, "position": [50, 0, 50]})
    assert world.creature("it").sense().tolist() == [0.0, 0.0, 0.0, 0.0]
    for z in (53, 60):
        world.execute(client, {"type": "feed", "position": [50, 0, z]})
    x, y, ahead, far = world.creature("it").sense().tolist()
    assert (round(x, 3), round(far, 1)) == (0.0, 3.0) and y < 0.0 and ahead == pytest.approx(1.0, abs=0.01)


def test_food_on_a_planet_is_among_its_resources() -> None:
    scene = {"type": "planets", "planets": {"count": 2, "radius": 50, "spacing": 200}}
    world = World(config(population={"start": 0}) | {"scene": scene})
    client = world.join()
    run(world, 1)
    first, second = world.execute(client, {"type": "get_planets"})["planets"]
    assert len(first["ResourceLocations"]) == 30 and second["ResourceLocations"] == []
    for place, item in zip(
        first["ResourceLocations"], world.execute(client, {"type": "get_life"})["food"], strict=True
    ):
        ground = [first["Position"][axis] + 100 * place[axis] for axis in "xyz"]
        assert ground == pytest.approx(item["position"]) and sum(v * v for v in place.values()) == pytest.approx(0.25)


@pytest.mark.parametrize(
    ("scene", "heights"),
    [
        ({"obstacles": [{"type": "box", "position": [0, 0.5, 0], "size": 4}]}, {2.5}),
        ({"type": "heightfield", "heightfield": {"heights": [[-1, -1], [-1, -1]]}}, {-1.0}),
    ],
)
def test_food_lies_on_the_ground_and_on_what_stands_there(scene: Json, heights: set[float]) -> None:
    food = {"places": [{"radius": 1}], "start": 20}
    world, client, _ = watched(config(food=food, population={"start": 0}) | {"scene": scene})
    run(world, 1)
    items = world.execute(client, {"type": "get_life"})["food"]
    assert {round(item["position"][1], 6) for item in items} == heights


def test_life_in_a_plane_stays_in_it() -> None:
    rules = {"genomes": [], "population": {"start": 3}, "limits": {"cubes": 6, "size": 1.5}}
    world, client, events = watched(config(**rules) | {"backend": "pymunk"})
    run(world, 40)
    life = world.execute(client, {"type": "get_life"})
    assert len(of(events, "creature_born")) >= 3 and life["living"]
    assert {item["position"][2] for item in life["food"]} == {0.0}


def test_what_is_fed_is_bounded() -> None:
    world, client, _ = watched(config(food={"start": 0, "rate": 0, "most": 2}, population={"start": 0}))
    replies = [world.execute(client, {"type": "feed", "position": [0, 0, 0]}) for _ in range(3)]
    assert [reply.get("code") for reply in replies] == [None, None, "limit_reached"]
    assert world.execute(client, {"type": "feed", "position": [0, 0, 0], "energy": -1})["code"] == "invalid"


def test_a_world_without_life_has_no_commands_of_it() -> None:
    world = World({"mode": "lockstep"})
    client = world.join()
    for command in ({"type": "get_life"}, {"type": "feed", "position": [0, 0, 0]}):
        assert world.execute(client, command)["code"] == "unsupported"
    claimed = world.execute(client, {"type": "get_world_info"})["capabilities"]
    assert not {"get_life", "feed"} & set(claimed)
    alive = World(config())
    assert {"get_life", "feed"} <= set(alive.execute(alive.join(), {"type": "get_world_info"})["capabilities"])


# -- energy and death -------------------------------------------------------------------------------------------------


def test_a_creature_pays_by_its_mass_senses_and_motors() -> None:
    spent = []
    for cost in ("mass", "sensors", "motors + cubes", "power", "age"):
        world, client, _ = watched(config(**STILL | {"cost": cost}))
        run(world, 1)
        before = living(world, client)[0]["energy"]
        work = world.motor_work()
        run(world, 20)
        work = world.motor_work() - work
        spent.append(before - living(world, client)[0]["energy"])
    assert spent[:3] == pytest.approx([9.2, 3, 9])
    assert spent[4] == pytest.approx(sum(range(1, 21)) / 400)
    assert 20 < spent[3] < 100


def test_power_is_the_work_of_a_creatures_own_motors() -> None:
    sums = []
    for loose in (False, True):
        world, client, _ = watched(config(**STILL | {"cost": "power"}))
        run(world, 1)
        start, worked = living(world, client)[0]["energy"], world.motor_work()
        idle = {**cart("idle"), "brain": {"kind": "sine", "oscillators": [{"motor": "*", "amplitude": 0}]}}
        world.execute(client, {"type": "spawn_creature", "name": "idle", "genome": idle, "position": [80, 0, 0]})
        if loose:  # a motor that is no creature's
            for name, x in (("one", 0), ("two", 1)):
                world.execute(client, {"type": "spawn_cube", "cube_name": name, "position": [x, 0.5, -90]})
            motor = {"motor_max_force": 50, "motor_target_velocity": 9}
            ends = {"cube1": "one", "cube2": "two", "joint_type": "hinge", "axis": [1, 0, 0]}
            assert world.execute(client, {"type": "create_joint", **ends, **motor})["type"] == "joint_created"
        run(world, 30)
        spent = [start - living(world, client)[0]["energy"], 300 - living(world, client)[1]["energy"]]
        assert spent[1] < 0.1 * spent[0]
        sums.append((sum(spent), world.motor_work() - worked))
    assert sums[0][0] == pytest.approx(sums[0][1])
    assert sums[1][0] == pytest.approx(sums[0][0], rel=1e-3) and sums[1][1] > 1.2 * sums[1][0]


def test_who_has_no_energy_left_dies_and_becomes_food() -> None:
    world, client, events = watched(config(**STILL | {"cost": "100", "death": {"carrion": 5}}))
    run(world, 41)
    assert world.creatures() and not of(events, "creature_died")
    run(world, 39)
    (death,) = of(events, "creature_died")
    assert (death["cause"], death["frame"], death["meals"]) == ("starved", 80, 0)
    assert death["age"] == pytest.approx(79 / 20)
    assert world.cubes() == [] and world.joints() == [] and living(world, client) == []
    (food,) = world.execute(client, {"type": "get_life"})["food"]
    assert food["energy"] == pytest.approx(5 * 9.2)


def test_who_is_too_old_dies_and_is_gone() -> None:
    world, client, events = watched(config(**STILL | {"death": {"age": 1.5}}))
    run(world, 45)
    (death,) = of(events, "creature_died")
    assert (death["cause"], death["frame"]) == ("old", 40)
    assert world.execute(client, {"type": "get_life"})["food"] == []


def test_who_adopts_a_cube_pays_for_the_mass_and_size_that_it_has_and_leaves_that() -> None:
    rules = STILL | {"cost": "mass + 100 * size", "death": {"age": 1, "carrion": 5}, "birth": {"start": 9000}}
    world, client, _ = watched(config(**rules, genomes=[{**cart(), "later": ["right.back"]}]))
    run(world, 1)
    (name,) = world.creatures()
    x, _, z = world.execute(client, {"type": "get_cube_state", "cube_name": f"{name}.trunk"})["position"]
    stone = {"cube_name": "stone", "size": [0.2, 9, 0.2], "mass": 1000, "position": [x - 0.6, 4.5, z + 0.23]}
    world.execute(client, {"type": "spawn_cube", **stone})
    world.execute(client, {"type": "adopt", "creature": name, "part": "right.back", "cube_name": "stone"})
    before = living(world, client)[0]["energy"]
    run(world, 1)
    assert before - living(world, client)[0]["energy"] == pytest.approx((8.4 + 1000 + 100 * 9) / 20)
    run(world, 40)
    (food,) = world.execute(client, {"type": "get_life"})["food"]
    assert food["energy"] == pytest.approx(5 * 1008.4)


def test_hunters_take_energy_from_those_they_touch() -> None:
    rules = STILL | {"catch": "mass > prey_mass ? 40.0 : 0.0", "population": {"start": 0}}
    world, client, events = watched(config(**rules))
    for name, mass, height in (("prey", 1, 0.25), ("hunter", 9, 0.76)):
        cube = {"id": "it", "size": 0.5, "mass": mass, "position": [0, height, 0]}
        genome = {"format": "nmes-genome/1", "name": name, "body": {"cubes": [cube]}}
        world.execute(client, {"type": "spawn_creature", "name": name, "genome": genome})
    run(world, 59)
    prey, hunter = (each["energy"] for each in living(world, client))
    assert prey + hunter == pytest.approx(600) and 180 < prey < 230
    run(world, 201)
    assert [(each["creature"], each["cause"]) for each in of(events, "creature_died")] == [("prey", "starved")]
    assert living(world, client)[0]["energy"] == pytest.approx(600)


def taken() -> tuple[World, int, list[Json]]:
    """Returns a world in which a creature came and had its name taken by another since the last tick."""
    world, client, events = watched(config(**STILL | {"cost": "20"}))
    world.execute(client, {"type": "spawn_creature", "name": "x", "genome": cart(), "position": [40, 0, 0]})
    run(world, 30)
    for name in world.creature("x").cubes.values():
        world.execute(client, {"type": "despawn_cube", "cube_name": name})
    cube = {"id": "it", "size": 0.5, "mass": 1, "position": [0, 0.25, 0]}
    other = {"format": "nmes-genome/1", "name": "other", "body": {"cubes": [cube]}}
    world.execute(client, {"type": "spawn_creature", "name": "x", "genome": other, "position": [40, 0, 0]})
    events.clear()
    return world, client, events


def test_who_takes_the_name_of_one_that_is_gone_is_another() -> None:
    world, client, events = taken()
    run(world, 1)
    death, birth = events
    assert (death["type"], death["creature"], death["cause"]) == ("creature_died", "x", "gone")
    assert (birth["type"], birth["creature"], birth["cause"]) == ("creature_born", "x", "entered")
    assert birth["species"] != death["species"]
    assert (living(world, client)[1]["creature"], living(world, client)[1]["energy"]) == ("x", 299)


def test_who_takes_a_name_and_cannot_be_followed_is_not_the_one_that_is_gone() -> None:
    world, _, events = taken()
    assert world.life is not None
    (cube,) = world.creature("x").cubes.values()
    assert world.life.lose(world.entities.cube(cube).body, world.frame + 1) == []
    run(world, 1)
    assert [event["cause"] for event in events] == ["gone", "entered"]


def test_who_takes_a_name_is_another_in_a_restored_ecosystem_too() -> None:
    world, _, _ = taken()
    other = World(world.config)
    other.restore(world.snapshot())
    assert (other.snapshot(), other.digest()) == (world.snapshot(), world.digest())
    for each in (world, other):
        run(each, 1)
        assert each.life is not None and each.life.died == 1
    assert other.digest() == world.digest()


@pytest.mark.parametrize("gone", [False, True])
def test_a_keyframe_of_old_does_not_tell_whose_name_is_anothers_and_is_read(gone: bool) -> None:
    world, client, _ = taken()
    if gone:
        world.execute(client, {"type": "despawn_cube", "cube_name": "x.it"})
    state, engine = unpack(world.snapshot(), world.config)
    del state["life"]["living"][0]["root"], state["version"], state["config"]
    old = pack(world.config, state, engine)
    other = World(world.config)
    other.restore(old)
    assert other.snapshot() == old
    run(other, 1)
    assert other.life is not None and other.life.died == gone


def test_the_census_counts_the_parts_that_are_there() -> None:
    world, client, events = watched(config(**STILL, genomes=[{**cart(), "later": ["right.back"]}]))
    run(world, 1)
    (name,) = world.creatures()
    world.execute(client, {"type": "shed", "creature": name, "part": "left.back", "remove": True})
    run(world, 19)
    means = [each["means"] for each in of(events, "census")]
    assert [each["cubes"] for each in means] == [4, 3] and [each["motors"] for each in means] == [3, 2]
    assert [each["mass"] for each in means] == pytest.approx([8.4, 7.6])


# -- birth ------------------------------------------------------------------------------------------------------------


def test_who_has_energy_enough_has_a_child_that_inherits() -> None:
    world, client, events = watched(config(**STILL | {"birth": {"start": 900, "energy": 800, "gift": 300}}))
    run(world, 20)
    first, child = of(events, "creature_born")
    assert (first["cause"], first["parents"], first["generation"]) == ("founder", [], 0)
    assert (child["cause"], child["parents"], child["generation"]) == ("birth", [first["creature"]], 1)
    assert [each["energy"] for each in living(world, client)] == [600, 300]
    document = world.execute(client, {"type": "get_genome", "creature": child["creature"]})["genome"]
    assert Genome(document).hash == child["genome"]
    assert document["parents"] == [Genome(cart()).hash] or Genome(document).hash == Genome(cart()).hash
    run(world, 1)
    controls = world.creature(child["creature"]).controls
    assert controls is not None and abs(controls).max() > 0.1


def test_a_child_of_two_parents_names_both() -> None:
    birth = {"start": 900, "energy": 800, "gift": 100, "crossover": 1, "mutation": 0, "reach": 100}
    other = mutate(Genome(cart()), Draw(2), kind="resize-part").genome.document
    world, _, events = watched(
        config(**STILL | {"birth": birth, "population": {"start": 2}, "genomes": [cart(), other]})
    )
    run(world, 20)
    born = of(events, "creature_born")
    founders = [each["creature"] for each in born[:2]]
    assert [each["cause"] for each in born] == ["founder", "founder", "birth", "birth"]
    # The second breeds with who is nearest: the child that has just been born beside it, or the first.
    assert born[2]["parents"] == founders and born[3]["parents"][0] == founders[1]
    assert born[3]["parents"][1] in (founders[0], born[2]["creature"])


@pytest.mark.parametrize("most", [2, 5])
def test_there_are_never_more_than_the_config_allows(most: int) -> None:
    birth = {"start": 5000, "energy": 10, "gift": 20}
    world, _, events = watched(config(**STILL | {"birth": birth, "population": {"start": 1, "most": most}}))
    run(world, 120)
    assert len(world.creatures()) == most == max(each["population"] for each in of(events, "census"))


def test_a_birth_for_which_the_world_has_no_room_does_not_happen() -> None:
    birth = {"start": 5000, "energy": 10, "gift": 20, "mutation": 0}
    full = config(**STILL | {"birth": birth}) | {"limits": {"cubes": 12}}
    world, client, _ = watched(full)
    run(world, 60)
    assert len(world.creatures()) == 2 and len(world.cubes()) == 10 and len(world.joints()) == 8
    assert sum(each["energy"] for each in living(world, client)) == pytest.approx(5000)


def test_the_newborn_overlap_nobody() -> None:
    world, _, _ = watched(config())
    born = 0
    for _ in range(25):
        before = set(world.creatures())
        world.tick()
        new = [name for name in world.creatures() if name not in before]
        born += len(new)
        names, states = world.poses()
        middles = {name: state[:3] for name, state in zip(names, states, strict=True)}
        for name in new:
            mine = [middles[cube] for cube in world.creature(name).cubes.values()]
            for other, place in middles.items():
                if not other.startswith(f"{name}."):
                    assert min(float(((place - cube) ** 2).sum()) for cube in mine) > 0.04
    assert born > 3


def test_newcomers_come_where_there_are_too_few() -> None:
    world, _, events = watched(config(**STILL | {"population": {"start": 0, "least": 3}}))
    run(world, 100)
    assert [each["cause"] for each in of(events, "creature_born")] == ["newcomer"] * 3
    assert [each["frame"] for each in of(events, "creature_born")] == [20, 40, 60]


def test_without_genomes_life_begins_with_random_creatures() -> None:
    limits = {"cubes": 6, "size": 2, "density": 2000}
    world, client, _ = watched(config(**STILL | {"genomes": [], "limits": limits, "population": {"start": 3}}))
    run(world, 2)
    documents = [world.execute(client, {"type": "get_genome", "creature": name}) for name in world.creatures()]
    hashes = {Genome(each["genome"]).hash for each in documents}
    assert len(hashes) == 3 and all(len(Genome(each["genome"]).body.cubes) <= 6 for each in documents)


def test_a_species_is_who_is_built_alike() -> None:
    body = Genome(cart()).body
    assert distance(body, body) == 0.0
    grown = mutate(Genome(cart()), Draw(1), kind="add-part").genome.body
    assert distance(body, grown) == distance(grown, body) == pytest.approx(2 / 11)
    sized = cart()
    sized["body"]["cubes"][0]["size"] = [1.0, 0.16, 0.34]
    assert distance(body, Genome(sized).body) == pytest.approx(0.6931471805599453 / 15)
    other = cart()
    other["body"]["cubes"][0]["size"] = [5, 0.16, 0.34]
    genomes = [cart(), sized, other, other]
    world, _, events = watched(config(**STILL | {"genomes": genomes, "population": {"start": 4}}))
    run(world, 1)
    assert [each["species"] for each in of(events, "creature_born")] == [1, 1, 2, 2]


# -- clients ----------------------------------------------------------------------------------------------------------


def test_clients_enter_with_creatures_of_their_own_and_take_them_away() -> None:
    world, client, events = watched(config(**STILL))
    run(world, 5)
    world.execute(client, {"type": "spawn_creature", "name": "mine", "genome": cart(), "position": [40, 0, 0]})
    run(world, 5)
    entered = of(events, "creature_born")[-1]
    assert (entered["creature"], entered["cause"], entered["frame"]) == ("mine", "entered", 6)
    world.execute(client, {"type": "despawn_cube", "cube_name": "mine.trunk"})
    run(world, 1)
    (death,) = of(events, "creature_died")
    assert (death["creature"], death["cause"]) == ("mine", "gone")


def test_events_are_as_their_schemas_say_and_only_for_those_who_ask() -> None:
    world, client, events = watched(config())
    other = world.join()
    seen: list[int] = []
    tell = world.emit
    assert tell is not None

    def noting(client: int, event: bytes) -> None:
        seen.append(client)
        tell(client, event)

    world.emit = noting
    world.execute(other, {"type": "subscribe", "events": ["tick"], "every": 1000000})
    run(world, 300)
    assert {event["type"] for event in events} == {"creature_born", "creature_died", "food_eaten", "census"}
    assert set(seen) == {client}
    for event in events:
        jsonschema.validate(event, load(f"events/{event['type']}.json"))


# -- history ----------------------------------------------------------------------------------------------------------


def recorded(path: Path, ticks: int = 240) -> tuple[list[Json], str]:
    world, client, events = watched(config())
    world.journal = Recorder(path, world, pose_rate=2)
    for _ in range(ticks // 40):
        run(world, 30)
        world.execute(client, {"type": "feed", "position": [1, 0, 1]})
        world.execute(client, {"type": "step", "ticks": 10})
    digest = world.digest().hex()
    world.close()
    world.journal.close()
    return events, digest


def test_a_recording_holds_what_happened_and_comes_out_again_from_everywhere(tmp_path: Path) -> None:
    events, _ = recorded(tmp_path / "life.mcap")
    lines = [record.about for record in Recording(tmp_path / "life.mcap") if record.kind is Kind.LIFE]
    told = [event for line in lines if line is not None for event in line["events"]]
    assert told == [event for event in events if event["type"] != "world_closed"]
    assert {event["type"] for event in told} == {"creature_born", "creature_died", "food_eaten", "census"}
    assert any(event["parents"] for event in of(told, "creature_born"))
    whole = replay(tmp_path / "life.mcap")
    assert (whole.verdict, whole.ticks) == ("reproduced", 240)
    for first in (45, 120, 230):
        part = replay(tmp_path / "life.mcap", first=first)
        assert part.verdict == "reproduced" and part.frames[0] > first - 41


class Liar(Recorder):
    """A recorder that says of the third meal that it fed more."""

    meals = 0

    def lived(self, frame: int, events: Sequence[Mapping[str, Any]]) -> None:
        told = [dict(event) for event in events]
        for event in told:
            self.meals += event["type"] == "food_eaten"
            if event["type"] == "food_eaten" and self.meals == 3:
                event["energy"] += 1
        super().lived(frame, told)


def test_a_recording_that_tells_another_life_diverges_there(tmp_path: Path) -> None:
    world, _, events = watched(config())
    liar = world.journal = Liar(tmp_path / "liar.mcap", world)
    run(world, 100)
    liar.close()
    report = replay(tmp_path / "liar.mcap")
    third = of(events, "food_eaten")[2]["frame"]
    assert report.verdict == "diverged" and report.divergence is not None
    assert report.divergence.kind == "life" and f"at frame {third}" in report.divergence.message


def test_the_same_start_gives_the_same_last_tick(tmp_path: Path) -> None:
    assert recorded(tmp_path / "a.mcap")[1] == recorded(tmp_path / "b.mcap")[1]


@pytest.mark.parametrize("frame", [0, 1, 20, 157])
def test_a_restored_ecosystem_goes_on_exactly(frame: int) -> None:
    world = World(config())
    client = world.join()
    run(world, frame)
    if frame > 20:  # somebody is taken apart, whose absence the next tick is to find
        world.execute(client, {"type": "despawn_cube", "cube_name": world.cubes()[0]})
    other = World(config())
    other.restore(world.snapshot())
    for _ in range(100):
        world.tick()
        other.tick()
        assert other.digest() == world.digest()
    assert other.snapshot() == world.snapshot()


def test_a_restored_ecosystem_adds_the_powers_of_motors_in_the_same_order() -> None:
    genome = cart()
    del genome["body"]["joints"][0]["motor"]
    rules = STILL | {"genomes": [genome], "cost": "power"}
    world, client, events = watched(config(**rules))
    run(world, 2)
    late = f"{of(events, 'creature_born')[0]['creature']}.left.front"
    params = {"motor_enabled": True, "motor_target_velocity": 7, "motor_max_force": 9}
    reply = world.execute(client, {"type": "set_joint_params", "joint_name": late, "params": params})
    assert reply["type"] == "joint_params_set"
    run(world, 2)
    other = World(config(**rules))
    other.restore(world.snapshot())
    for _ in range(40):
        world.tick()
        other.tick()
        assert other.digest() == world.digest()


def test_a_reset_ecosystem_begins_again() -> None:
    world, client, events = watched(config())
    run(world, 60)
    first = list(events)
    digest = world.digest()
    world.execute(client, {"type": "reset"})
    events.clear()
    run(world, 60)
    assert events == first and world.digest() == digest


def test_the_digest_tells_of_energy_and_food() -> None:
    world = World(config(**STILL))
    client = world.join()
    run(world, 5)
    before = world.digest()
    world.execute(client, {"type": "feed", "position": [100, 0, 100]})
    fed = world.digest()
    assert world.life is not None
    world.life.living[0].energy += 1e-9
    assert len({before, fed, world.digest()}) == 3


# -- what strangers write ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("life", "path"),
    [
        ({"cost": "mass +"}, "life/cost"),
        ({"cost": "prey_mass"}, "life/cost"),
        ({"catch": "nothing"}, "life/catch"),
        ({"genomes": [{"format": "nmes-genome/1"}]}, "life/genomes/0"),
        ({"genomes": [cart(), {**cart(), "brain": {"kind": "sine", "oscillators": []}}]}, "life/genomes/1"),
        ({"genomes": [cart()], "limits": {"cubes": 4}}, "life/genomes/0"),
        ({"food": {"rate": -1}}, "life/food/rate"),
        ({"population": {"most": 5000}}, "life/population/most"),
        ({"hunger": 1}, "life/hunger"),
    ],
)
def test_rules_that_are_none_are_refused_with_their_place(life: Json, path: str) -> None:
    with pytest.raises(RejectedMessage) as caught:
        World({"life": life})
    assert caught.value.path == path


def damaged(state: Json, how: str) -> Json:
    life = state["life"]
    match how:
        case "species":
            life["species"].clear()
        case "food":
            life["food"]["items"] = "AAAA"
        case "energy":
            life["living"][0]["energy"] = "much"
        case "parents":
            life["living"][0]["parents"] = 3
        case "gone":
            del state["life"]
    return state


@pytest.mark.parametrize("how", ["species", "food", "energy", "parents", "gone"])
def test_a_keyframe_whose_life_does_not_fit_together_is_refused(how: str) -> None:
    world = World(config())
    world.join()
    run(world, 3)
    state, engine = unpack(world.snapshot(), world.config)
    del state["version"], state["config"]
    fresh = World(config())
    before = fresh.digest()
    with pytest.raises(WorldError) as caught:
        fresh.restore(pack(world.config, damaged(state, how), engine))
    assert caught.value.code == "bad_snapshot" and fresh.digest() == before
