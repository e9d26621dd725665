"""Episodes of creatures whose parts come and go: what is measured, what it costs, and that it is proved."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pytest import MonkeyPatch

from command_line import run as run_nmes
from creatures import SINE, mlp, snake
from nmes import World
from nmes.backend.shapes import Shape
from nmes.brain import Brain
from nmes.errors import DocumentError, ProofError, WorldError
from nmes.evaluation import Environments, Evaluator, Task, changing, episode, evaluate, prove, retrace
from nmes.evaluation.changing import ChangingObserver
from nmes.evaluation.episode import Episode
from nmes.genome import Genome
from nmes.objective import QUANTITIES, Quantity
from nmes.objective.changing import ChangingTrajectory
from nmes.objective.trajectory import ObservedBodies, Trajectory
from nmes.playback import replay
from nmes.world.energy import EnergyMeter

Json = dict[str, Any]
FREE: Json = {"gravity": [0, 0, 0]}


def task(objective: str = "displacement.x", **changes: Any) -> Task:
    document = {
        "format": "nmes-task/1",
        "name": "change",
        "description": "Change.",
        "duration": 3,
        "seeds": [1, 2],
        "settle": 0.1,
        "development": True,
        "objective": objective,
    }
    return Task({**document, **changes})


def growing(*rules: Json, later: tuple[str, ...] = (), **changes: Any) -> Json:
    return {**snake(**changes), "later": list(later), "development": list(rules)}


def run(genome: Json, asked: Task, seed: int = 1) -> Episode:
    world = World(asked.world_config(seed))
    creature = Genome(genome)
    ran = Episode(world, creature, creature.brain(), asked, seed)
    ran.run()
    return ran


def series(ran: Episode, name: str, cube: str | None = None) -> np.ndarray:
    assert ran._observer is not None
    return ran._observer.judge.trajectory.series(Quantity(name, cube))


GROW: Json = {"when": "age >= 1", "grow": ["c2", "c3"]}
SHED: Json = {"when": "age >= 1", "shed": ["c2"]}


def test_to_grow_ahead_is_no_way_and_to_shed_what_is_behind_neither() -> None:
    for rule, later in ((GROW, ("c2", "c3")), (SHED, ())):
        ran = run(growing(rule, later=later, brain={**SINE, "oscillators": [{"motor": "*", "amplitude": 0}]}), task())
        way, place = series(ran, "displacement.x"), series(ran, "position.x")
        assert np.abs(np.diff(place)).max() > 0.15  # the centre of mass is another's
        assert np.abs(np.diff(way)).max() < 0.005
        assert abs(way[-1]) < 0.02


def shares(ran: Episode) -> list[tuple[float, float]]:
    """Returns the masses that a body had, one after the other, and what part of its centre's way was its own then."""
    way, place, mass = (series(ran, name) for name in ("displacement.x", "position.x", "mass"))
    same = (np.diff(mass) == 0) & (np.abs(np.diff(place)) > 1e-5)
    told = zip(mass[1:][same].round(6).tolist(), (np.diff(way) / np.diff(place))[same].round(6).tolist(), strict=True)
    return [each for each, _ in itertools.groupby(told)]


def test_what_is_shed_counts_as_if_it_stayed_there_until_it_is_taken_up_again() -> None:
    shed = {"when": "age >= 1", "stage": 1, "shed": ["c2"], "enter": 2}
    adopt = {"when": "age >= 2", "stage": 2, "adopt": ["c2"]}
    assert shares(run(growing(shed, adopt), task())) == [(2.0, 1.0), (1.0, 0.5), (2.0, 1.0)]


def test_what_is_lost_by_becoming_smaller_counts_likewise() -> None:
    shrink = {"when": "age >= 1", "resize": [{"part": "c2", "scale": 0.5}]}
    assert shares(run(growing(shrink, segments=3), task())) == [(1.5, 1.0), (1.0625, 0.708333)]


def test_what_the_task_cuts_off_does_not_hold_a_body_back() -> None:
    (before, whole), (after, cut) = shares(run(Genome.load("walker").document, Task.load("injury")))
    assert before > after and whole == cut == 1.0


def test_quantities_are_those_of_what_is_there() -> None:
    ran = run(growing(GROW, later=("c2", "c3")), task())
    cubes, mass, reach = (series(ran, name) for name in ("cubes", "mass", "reach"))
    assert (cubes[0], cubes[-1]) == (2, 4) and mass[-1] == 2 * mass[0] and reach[-1] > reach[0] + 0.2
    (change,) = np.flatnonzero(np.diff(cubes)) + 1
    assert change == 60
    height = series(ran, "height", "c3")
    assert np.isnan(height[:change]).all() and np.isfinite(height[change:]).all()


def test_an_objective_of_a_part_that_is_not_there_has_no_value() -> None:
    asked = task('cube("c3").height')
    (result, *_) = evaluate(growing(SHED), asked).results
    assert result.score is None and result.fault is not None and "no finite number" in result.fault


def test_what_a_part_brings_along_counts_as_work() -> None:
    still = {**SINE, "oscillators": [{"motor": "*", "amplitude": 0}]}
    lifted = growing({"when": "age >= 1", "grow": ["c2"]}, later=("c2", "c3"), brain=still)
    for cube in lifted["body"]["cubes"]:
        cube["position"][1] += 2.0
    frozen_high = task("energy", world=FREE)
    flat = evaluate(lifted, frozen_high).results[0].energy
    heavy = evaluate(lifted, task("energy", world={"gravity": [0, -1e-3, 0]}, settle_limit=1)).results[0].energy
    assert flat == pytest.approx(0.0, abs=1e-6)
    assert heavy == pytest.approx(0.5 * 1e-3 * 0.07, rel=0.2)  # its mass, gravity, and how high its centre lies


def test_nobody_is_moved_by_parts_that_are_free() -> None:
    # A weight grows high up beside the root, and is dropped: what moves then is what it brought, and that is paid.
    weight = snake(segments=2)
    weight["body"]["cubes"][1] |= {"mass": 30.0, "position": [0.36, 1.07, 0]}
    weight["body"]["joints"][0] |= {"anchor": [0.0, 0.14, 0]}
    weight |= {"later": ["c1"], "development": [{"when": "age > 1", "grow": ["c1"]}]}
    asked = task("energy", duration=3)
    (result, *_) = evaluate(weight, asked).results
    assert result.fault is None
    assert result.energy > 30.0 * 9.81 * 1.0
    before = series(run(weight, asked), "energy")
    (bought,) = np.flatnonzero(np.diff(before) > 290)
    assert bought + 1 == 66


def test_without_that_payment_it_is_energy_of_nothing(monkeypatch: MonkeyPatch) -> None:
    monkeypatch.setattr(changing, "_energy", lambda *_: 0.0)
    weight = snake(segments=2)
    weight["body"]["cubes"][1] |= {"mass": 30.0, "position": [0.36, 1.07, 0]}
    weight["body"]["joints"][0] |= {"anchor": [0.0, 0.14, 0]}
    weight |= {"later": ["c1"], "development": [{"when": "age > 1", "grow": ["c1"]}]}
    (result, *_) = evaluate(weight, task("energy")).results
    assert result.fault is not None and result.fault.startswith("energy: ")


def settling(genome: Json, asked: Task) -> tuple[int, float]:
    """Runs a creature; returns how many joints it has then, and by how much the world's sum of work is more, J."""
    ran = run(genome, asked)
    assert ran._observer is not None
    entities, told = ran._world.entities, ran._observer.judge.trajectory.work[-1].sum()
    metered = [entities.work(entities.cube(name)) for name in entities.cubes]  # of each motor twice: it joins two cubes
    return len(ran._observer.creature.joints), sum(metered) / 2 - told


def test_a_motor_that_goes_has_worked_up_to_its_last_tick_and_no_longer() -> None:
    """Rules cut at the end of a tick, a task before it begins."""
    rule = {"when": "age >= 1", "shed": ["c1"]}
    joints, before = settling(snake(segments=2), task())
    shed, injured = growing(rule, segments=2), task(injury={"time": [0.9, 1.1]})
    cut = settling(shed, task()), settling(snake(segments=2), injured)
    assert joints == 1 and [joints for joints, _ in cut] == [0, 0]
    assert [work for _, work in cut] == pytest.approx([before] * 2, rel=1e-9)


def test_motors_work_on_while_parts_become_larger_and_smaller(monkeypatch: MonkeyPatch) -> None:
    """Each time the joint is another one in the engine, and what the last one gave in its last tick counts too."""
    rules = [
        {"when": f"stage == {stage}", "resize": [{"part": "c1", "scale": scale}], "enter": 3 - stage}
        for stage, scale in ((1, 1.02), (2, 1.0))
    ]
    metered, tick = list[float](), EnergyMeter.tick

    def noted(meter: EnergyMeter) -> None:
        tick(meter)
        metered.append(float(meter.powers().sum()))

    monkeypatch.setattr(EnergyMeter, "tick", noted)
    ran = run(growing(*({**rule, "every": 0.1, "times": 64} for rule in rules), segments=2), task())
    assert ran._observer is not None
    assert ran._observer.judge.trajectory.work[-1, 0] == pytest.approx(sum(metered) / 60, rel=1e-9)


def test_who_sheds_a_part_that_its_motor_brakes_has_no_energy_of_nothing() -> None:
    """The part has what it has at the end of the tick, and not what it had before the motor braked it."""
    brain = {"kind": "sine", "oscillators": [{"motor": "*", "frequency": 5, "amplitude": 1}]}
    shaker = growing({"when": "age >= 0.85", "shed": ["c1"]}, segments=2, brain=brain)
    shaker["body"]["cubes"][0]["mass"] = 1.0
    shaker["body"]["joints"][0] |= {
        "limits": [-1.4, 1.4],
        "motor": {"mode": "velocity", "range": [-40, 40], "max_effort": 100},
    }
    (result, *_) = evaluate(shaker, task(world=FREE, duration=1.5)).results
    assert result.fault is None


@pytest.mark.parametrize("tick", range(60, 66))  # rules are looked at every six ticks
def test_a_limb_that_is_cut_off_and_taken_up_again_in_one_tick_is_no_energy_of_nothing(tick: int) -> None:
    table = snake(segments=2)
    table["body"]["cubes"][0] |= {"size": [0.6, 0.6, 0.6], "mass": 30.0, "position": [0, 0.3, 0]}
    table["body"]["cubes"][1] |= {"size": [0.3, 0.3, 0.3], "mass": 30.0, "position": [0, 0.75, 0]}
    table["body"]["joints"][0] |= {"anchor": [0.0, 0.6, 0]}
    still = {**SINE, "oscillators": [{"motor": "*", "amplitude": 0}]}
    table |= {"later": [], "brain": still, "development": [{"when": "cubes < 2", "adopt": ["c1"]}]}
    ran = run(table, task(injury={"time": [tick / 60, tick / 60]}))
    assert ran.result().fault is None
    cubes = series(ran, "cubes")
    assert cubes[-1] == 2


def test_who_is_cut_in_the_middle_of_a_jump_has_got_no_energy_of_nothing() -> None:
    assert [result.fault for result in evaluate("jumper", "injury").results] == [None] * 3


def test_springs_that_are_taken_up_bent_are_paid_too() -> None:
    rules = [
        {"when": "age > 1", "stage": 1, "shed": ["c2"], "enter": 2},
        {"when": "age > 2", "stage": 2, "adopt": ["c2"], "enter": 3},
    ]
    bent = {"kind": "sine", "oscillators": [{"motor": "*", "amplitude": 0, "offset": 1}]}
    genome = growing(*rules, brain=bent)
    for joint in genome["body"]["joints"]:
        joint |= {"stiffness": 60.0, "damping": 1.0}
        joint["motor"]["max_effort"] = 300
    ran = run(genome, task(world=FREE))
    assert ran.result().fault is None
    assert ran._observer is not None
    brought = ran._observer.judge.trajectory.work[:, -1]
    (taken_up,) = np.flatnonzero(np.diff(series(ran, "cubes")) > 0) + 1
    assert brought[taken_up - 1] == 0.0
    # In motion there is 0.099 J; the rest is in the spring beyond the part, which its motor bends by 0.059 rad.
    assert brought[taken_up] == pytest.approx(0.099 + 60 * 0.059**2 / 2, rel=0.02)


def ratchet() -> Json:
    """Returns a creature that stays where it is: its arm swings a heavy load forwards, and a light one back."""
    load = [{"part": "load", "scale": scale} for scale in (0.25, 1)]
    return {
        "format": "nmes-genome/1",
        "name": "ratchet",
        "body": {
            "cubes": [
                {"id": "root", "size": [1.2, 0.3, 0.6], "mass": 200, "position": [0, 0.15, 0], "friction": 1},
                {"id": "arm", "size": [0.1, 0.1, 1], "mass": 4, "position": [0, 0.4, 0.5]},
                {"id": "load", "size": 0.4, "mass": 40, "position": [0, 0.45, 1.2]},
            ],
            "joints": [
                {
                    "id": "arm",
                    "cube1": "root",
                    "cube2": "arm",
                    "type": "hinge",
                    "axis": [0, 1, 0],
                    "anchor": [0, 0.35, 0],
                    "limits": [-1.3, 1.3],
                    "motor": {"mode": "velocity", "range": [-4, 4], "max_effort": 1500},
                },
                {"id": "hold", "cube1": "arm", "cube2": "load", "type": "fixed", "anchor": [0, 0.4, 1]},
            ],
        },
        "brain": {"kind": "sine", "oscillators": [{"motor": "*", "amplitude": 1, "frequency": 0.6}]},
        "development": [
            {"when": f"stage == {stage} && sense(\"arm.position\") {beyond}", "resize": [load[stage - 1]],
             "enter": 3 - stage, "every": 0.1, "times": 64}
            for stage, beyond in ((1, "> 0.78"), (2, "< -0.78"))
        ],
    }  # fmt: skip


def test_what_shipped_tasks_ask_cannot_be_had_by_a_ratchet() -> None:
    shipped = Task.load("injury").document
    assert Task.load("metamorphosis").document["objective"] == shipped["objective"]
    ways = {"seeds": [1], "duration": 20, "limits": {}}
    assert (evaluate(ratchet(), task("displacement.x", **ways)).score or 0.0) > 1.5
    assert evaluate(ratchet(), task(shipped["objective"], **ways)).score == 0.0


def test_the_newt_swims_sheds_its_tail_and_drives_on() -> None:
    ran = run(Genome.load("newt").document, Task.load("metamorphosis"))
    way, cubes = series(ran, "displacement.x"), series(ran, "cubes")
    assert (cubes[0], cubes[-1]) == (6, 5)
    ashore = int(np.flatnonzero(cubes == 5)[0])
    assert way[ashore] > 4 and way[-1] - way[ashore] > 11  # swum, and driven: less far by the mass of its tail


def test_limits_of_what_a_creature_does_hold_through_changes() -> None:
    fast = growing(GROW, later=("c2", "c3"))
    ended = evaluate(fast, task(limits={"energy": 0.01})).results[0]
    assert ended.ended == "energy"
    assert ended.energy <= 0.01


BODIES = st.integers(1, 4)


@given(st.data())
def test_a_body_that_never_changes_has_the_figures_of_a_plain_trajectory(data: st.DataObject) -> None:
    count, props, rows = data.draw(BODIES), data.draw(st.integers(0, 2)), data.draw(st.integers(1, 7))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    shapes: tuple[Shape, ...] = tuple(data.draw(st.sampled_from(["box", "sphere"])) for _ in range(count + props))
    ids = (*(f"c{i}" for i in range(count)), *(f"p{i}" for i in range(props)))
    sizes = np.repeat(rng.uniform(0.1, 1, (count + props, 1)), 3, axis=1)
    target = data.draw(st.sampled_from([None, (1.0, 2.0, 3.0), ids[-1]]))
    bodies = ObservedBodies(ids, count, sizes, rng.uniform(0.1, 9, count + props), 60, target, shapes)
    plain, changing = Trajectory(bodies, 8, 2, contacts=True), ChangingTrajectory(bodies, 8, 2, contacts=True)
    changing.change(bodies, np.arange(count + props))
    states, work = rng.normal(size=(rows, count + props, 13)), rng.uniform(size=(rows, 2))
    touches = rng.uniform(size=(rows, count + props, 2)) < 0.5
    for each, extra in ((plain, work), (changing, np.concatenate([work, np.zeros((rows, 1))], axis=1))):
        each.states[:rows], each.touches[:rows] = states, touches
        each.meter(0, extra)
        each.rows = rows
    for name, fold in itertools.product(QUANTITIES, ("final", "max", "mean")):
        quantity = Quantity(name, None, fold)
        assert plain.values([quantity]) == changing.values([quantity]), quantity
    assert plain.duty() == changing.duty()
    for limits in ({"energy": 0.01}, {"speed": 2.0}, {"spin": 2.0}, {"size": 1.0}):
        bounds = {**dict.fromkeys(("energy", "speed", "spin", "size"), math.inf), **limits}
        assert plain.first_beyond(0, rows, **bounds) == changing.first_beyond(0, rows, **bounds)


@pytest.mark.parametrize("name", ["walker", "jumper", "prowler"])
def test_an_episode_without_changes_comes_out_alike_either_way(name: str, monkeypatch: MonkeyPatch) -> None:
    asked = "dark" if name == "prowler" else "jump-high" if name == "jumper" else "walk"
    before = evaluate(name, asked).results
    plain = evaluate.__globals__["run_alone"]

    def in_world(genome: Genome, brain: Brain | None, task: Task, seed: int) -> Any:
        return Episode(World(task.world_config(seed)), genome, brain, task, seed).run()

    monkeypatch.setitem(evaluate.__globals__, "run_alone", in_world)
    monkeypatch.setattr(Task, "why_changing", lambda task, body: "for a test")
    monkeypatch.setattr(episode, "ChangingObserver", ChangingObserver)
    assert plain is not in_world
    assert evaluate(name, asked).results == before


# -- injury -----------------------------------------------------------------------------------------------------------


def injured(genome: str, folder: Path) -> Path:
    result = evaluate(genome, "injury", seeds=[1], record=folder)
    assert result.error is None
    return Path(result.recordings[0])


def commands(path: Path) -> list[Json]:
    from nmes.recording import Kind, Recording

    return [json.loads(entry.data) for entry in Recording(path) if entry.kind is Kind.COMMAND]


def test_a_limb_is_cut_off_when_and_where_the_seed_says() -> None:
    asked = Task.load("injury")
    body = Genome.load("walker").body
    there = [cube.id for cube in body.cubes]
    ticks = [asked.injury_tick(seed) for seed in range(40)]
    assert all(tick is not None and 180 <= tick <= 240 for tick in ticks) and len({*ticks}) > 20
    limbs = {asked.limb(seed, body, there) for seed in range(40)}
    root = body.cubes[0].id
    held = {end for joint in body.joints for end in (joint.cube1, joint.cube2) if root in (joint.cube1, joint.cube2)}
    assert limbs == held - {root}
    assert asked.limb(1, body, [root]) is None


def test_an_injury_is_a_command_of_the_recording_and_proved(tmp_path: Path) -> None:
    path = injured("galloper", tmp_path)
    (cut,) = [command for command in commands(path) if command["type"] == "shed"]
    assert cut["creature"] == "creature"
    proof = prove(path, brain=True)
    assert proof.result == evaluate("galloper", "injury", seeds=[1]).results[0]
    assert replay(path).verdict == "reproduced"
    course = retrace(path)
    assert len(course.controls) == 600


def test_a_recording_without_the_cut_proves_nothing(tmp_path: Path, monkeypatch: MonkeyPatch) -> None:
    monkeypatch.setattr(Task, "limb", lambda *_: None)
    path = injured("galloper", tmp_path)
    monkeypatch.undo()
    with pytest.raises(ProofError, match="where there should be another shed"):
        prove(path)


def test_evaluations_of_bodies_that_change_are_the_same_everywhere() -> None:
    genomes = [
        growing(GROW, later=("c2", "c3"), brain=mlp(4, seed=seed)) if seed % 2 else snake(mlp(4, seed=seed))
        for seed in range(6)
    ]
    asked = task("displacement.x + 0.001 * energy", injury={"time": [0.5, 1.5]})
    alone = [evaluate(genome, asked).results for genome in genomes]
    with Evaluator(jobs=2) as evaluator:
        together = [each.results for each in evaluator.evaluate_population(genomes, asked)]
    assert together == alone
    assert all(result.score is not None for results in alone for result in results)


def test_a_recording_of_a_body_that_develops_is_proved_from_its_keyframes(tmp_path: Path) -> None:
    asked = task(world={"keyframes": 1})
    result = evaluate(growing(GROW, later=("c2", "c3")), asked, seeds=[1], record=tmp_path)
    path = Path(result.recordings[0])
    assert prove(path, brain=True).result == result.results[0]
    assert replay(path, first=100).verdict == "reproduced"


# -- who may take part ------------------------------------------------------------------------------------------------


def test_bodies_are_judged_at_birth_and_as_they_may_come_to_be() -> None:
    asked = task(limits={"size": 1.2, "cubes": 4}, newborn={"cubes": 2})
    whole = Genome(snake()).body
    assert asked.check(whole) == [
        "the body has 1.34 m from end to end, at most 1.2 are allowed",
        "at birth the body has 4 cubes, at most 2 are allowed",
    ]
    young = Genome(growing(GROW, later=("c2", "c3"), segments=3 + 1)).body
    assert asked.check(young) == ["the body has 1.34 m from end to end, at most 1.2 are allowed"]
    larger = growing({"when": "true", "resize": [{"part": "c2", "scale": 2}]}, segments=3)
    assert task(limits={"size": 1.2}).check(Genome(larger).body) == [
        "resized, the body has 1.29 m from end to end, at most 1.2 are allowed"
    ]


def cart(
    *rules: Json, mass: float = 1.0, ballast: float = 1.0, effort: float = 20.0, later: tuple[str, ...] = ()
) -> Json:
    """Returns a genome of two cubes that a motor joins, half a metre long, and a ballast on the first of them."""
    motor = {"mode": "position", "range": [-1, 1], "max_effort": effort}
    cubes = [
        {"id": "a", "size": 0.2, "mass": 1, "position": [0, 0.2, 0]},
        {"id": "b", "size": 0.2, "mass": mass, "position": [0.3, 0.2, 0]},
        {"id": "ballast", "size": 0.2, "mass": ballast, "position": [-0.2, 0.2, 0]},
    ]
    joints = [
        {"id": "h", "cube1": "a", "cube2": "b", "type": "hinge", "anchor": [0.15, 0.2, 0], "motor": motor},
        {"id": "f", "cube1": "a", "cube2": "ballast", "type": "fixed", "anchor": [-0.1, 0.2, 0]},
    ]
    body = {"cubes": cubes, "joints": joints}
    return {"format": "nmes-genome/1", "name": "cart", "body": body, "later": [*later], "development": [*rules]}


@pytest.mark.parametrize(
    ("body", "effort"),
    [
        (cart(), None),  # 20 / (3 kg * 9.81 m/s^2 * 0.7 m) is 0.97
        (cart(ballast=18.0), None),
        (cart({"when": "age > 0", "shed": ["ballast"]}, ballast=18.0), 2.03874),
        (cart({"when": "age > 0", "grow": ["ballast"]}, ballast=18.0, later=("ballast",)), 2.03874),
        (cart({"when": "age > 0", "shed": ["b"]}, ballast=18.0), None),  # and the motor with it
        (cart({"when": "age > 0", "shed": ["b", "ballast"]}, ballast=18.0), 2.03874),
        (cart({"when": "age > 0", "resize": [{"part": "ballast", "scale": 0.5}]}, ballast=2.0), 1.51017),
    ],
)
def test_a_motor_is_judged_by_the_lightest_body_that_rules_can_leave_it(body: Json, effort: float | None) -> None:
    asked, genome = task(limits={"effort": 1}), Genome(body)
    told = (
        f"the motor of joint 'h' has an effort of {effort:g} as the body may develop, at most 1 is allowed"
        if effort
        else ""
    )
    assert [reason for reason in asked.check(genome.body) if not reason.startswith("at birth")] == [told] * bool(effort)


@pytest.mark.parametrize(("scales", "ratio"), [((), None), ((0.5,), 80), ((0.5, 2), 80), ((3.0,), 270), ((0.9,), None)])
def test_neighbours_are_judged_in_all_sizes_that_rules_may_give_them(
    scales: tuple[float, ...], ratio: int | None
) -> None:
    rules = [{"when": "age > 0", "resize": [{"part": "b", "scale": scale}]} for scale in scales]
    mass = 10 if scales == (3.0,) else 0.1
    reasons = task(limits={"neighbours": 20}).check(Genome(cart(*rules, mass=mass)).body)
    told = f"joint 'h' joins masses of 1 to {ratio} as the body may develop, at most 1 to 20 are allowed"
    assert reasons[:1] == [told] * (ratio is not None)


def test_a_body_without_a_limb_cannot_be_injured() -> None:
    stump = {"format": "nmes-genome/1", "name": "stump", "body": {"cubes": snake()["body"]["cubes"][:1]}}
    assert evaluate(stump, "injury").error == "the task cuts off a limb, and the body has none at birth"


def test_bodies_do_not_develop_where_the_task_does_not_say_so() -> None:
    assert Task.load("jump-high").check(Genome(growing(later=("c3",))).body) == [
        "the body has parts that are later, or rules of development, and on this task bodies do not develop"
    ]


def test_an_injury_after_the_end_is_refused() -> None:
    with pytest.raises(DocumentError, match="injury/time: expected times before the end, at 3 s"):
        task(injury={"time": [1, 3]})


def test_learners_keep_to_bodies_that_keep_their_parts() -> None:
    with pytest.raises(WorldError, match="rules of development, and where others drive, bodies keep their parts"):
        Environments(Genome(growing(GROW)), task(), 1)
    with pytest.raises(WorldError, match="the task cuts off a limb, and where others drive"):
        Environments(Genome(snake()), Task.load("injury"), 1)


def test_a_task_tells_what_may_happen_to_bodies() -> None:
    assert "a limb is cut off 3 to 4 s after the start" in run_nmes("tasks", "injury").stdout
    shown = run_nmes("tasks", "growth").stdout
    assert "cubes 2, size 0.5" in shown and "may develop" in shown
    assert "sensors of use" in run_nmes("tasks", "dark").stdout
